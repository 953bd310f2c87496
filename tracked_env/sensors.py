"""Sensor presets and the draw of one vehicle's sensors for one episode.

Three groups share a sampling clock each: `pose` (INS/GNSS), `inertial` (IMU), `drive`
(sprocket encoders and torque sensors); the channels and error model are in
`tracked_env.physics.channels`. Presets:
    ideal   no error at all
    rtk     RTK-GNSS and a tactical IMU, the default
    strawa  the low-cost set of Strawa et al. (2021), section 5.2
    mocap   motion capture and encoders indoors, the default of Speed-v0
Laws of the draws, once per episode and vehicle:
    gyro and accelerometer bias     = s b, s = -1 or +1 with equal odds, b the data-sheet bias
    noise, every sample             = N(0, sigma^2)
    dropout, every sample and group : lost with probability p; the last sample stays
`register` adds a channel: its noise and bias are then fields of the presets like the others.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tracked_env.physics.channels import ATTITUDE, CHANNELS, GROUPS, TABLE, Channel
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import Range
from tracked_env.streams import addresses, random
from tracked_env.validation import SIGMA, checked_choice, checked_keys, checked_number

DELAY_LIMIT = 1.0  # [s] longest delay of a sensor group
PERIOD_LIMIT = 10.0  # [s] longest sampling period
UNMEASURED = 1e3  # [m/s] velocity noise that a data sheet states where nothing is measured


class Sensors(NamedTuple):
    """Errors of all sensors; defaults are the ideal ones.

    Rates of 0 mean every control step; others, and delays, are rounded to whole control steps.
    """

    position_noise: float = 0.0  # [m] sigma of x and of y
    yaw_noise: float = 0.0  # [rad] sigma
    velocity_noise: float = 0.0  # [m/s] sigma, per body axis
    acceleration_noise: float = 0.0  # [m/s^2] sigma, per body axis
    acceleration_bias: float = 0.0  # [m/s^2] magnitude, random sign per axis and episode
    cross_coupling: float = 0.0  # [-] of the accelerometer axes
    gyro_noise: float = 0.0  # [rad/s] sigma
    gyro_bias: float = 0.0  # [rad/s] magnitude, random sign per episode
    accelerometer_distance: float = 1.0  # [m] D, between the two that give the yaw acceleration
    sprocket_speed_noise: float = 0.0  # [rad/s] sigma
    torque_noise: float = 0.0  # [N m] sigma, at the sprocket
    pose_rate: float = 0.0  # [Hz] 0 = every control step
    inertial_rate: float = 0.0  # [Hz]
    drive_rate: float = 0.0  # [Hz]
    pose_delay: float = 0.0  # [s] rounded to whole control steps
    inertial_delay: float = 0.0  # [s]
    drive_delay: float = 0.0  # [s]
    pose_dropout: float = 0.0  # [-] probability that a sample is lost
    inertial_dropout: float = 0.0  # [-]
    drive_dropout: float = 0.0  # [-]
    velocity_measured: float = 1.0  # [-] 0: v_x and v_y read 0, and velocity_noise is UNMEASURED
    further: tuple[tuple[str, float], ...] = ()  # (field, value) of registered channels, SI

    def value(self, field: str) -> float:
        """A field by name, also of a registered channel; 0 where nothing is said of it."""
        if field in self._fields:
            return float(getattr(self, field))
        return dict(self.further).get(field, 0.0)


IDEAL = Sensors()
RTK = Sensors(
    position_noise=0.02,
    yaw_noise=float(np.radians(0.3)),
    velocity_noise=0.03,
    acceleration_noise=0.05,
    acceleration_bias=0.02,
    cross_coupling=0.001,
    gyro_noise=0.002,
    gyro_bias=0.001,
    sprocket_speed_noise=0.02,
    torque_noise=10.0,
)
STRAWA = Sensors(
    position_noise=1.0,
    yaw_noise=float(np.radians(1.0)),
    velocity_noise=0.1,
    acceleration_noise=0.02,  # S names none; a data-sheet value of that class of IMU
    acceleration_bias=0.002,
    cross_coupling=0.001,
    gyro_noise=0.002,  # likewise
    gyro_bias=0.01,
    sprocket_speed_noise=0.1,
    torque_noise=0.1,
)
# Focchi et al. (2025), section 4.1: marker-based motion capture at 200 Hz, differentiated and
# filtered, encoders, and an IMU; they state no noise: values of such a system's data sheet.
MOCAP = Sensors(
    position_noise=0.001,
    yaw_noise=float(np.radians(0.1)),
    velocity_noise=0.01,
    acceleration_noise=0.05,
    acceleration_bias=0.02,
    cross_coupling=0.001,
    gyro_noise=0.002,
    gyro_bias=0.001,
    sprocket_speed_noise=0.02,
    torque_noise=0.1,
)
PRESETS = {"ideal": IDEAL, "rtk": RTK, "strawa": STRAWA, "mocap": MOCAP}

_RANGES = {
    **{name: SIGMA for name in Sensors._fields if name.endswith(("_noise", "_bias"))},
    "cross_coupling": Range(0.0, 1.0, "-", "Did you pass a percentage?"),
    "accelerometer_distance": Range(0.01, 10.0, "m", "Did you pass millimetres?"),
    **{f"{group}_rate": Range(0.0, 1e4, "Hz", "0 means every control step.") for group in GROUPS},
    **{
        f"{group}_delay": Range(0.0, DELAY_LIMIT, "s", "Did you pass milliseconds?")
        for group in GROUPS
    },
    **{
        f"{group}_dropout": Range(0.0, 1.0, "-", "It is a probability, not a percentage.")
        for group in GROUPS
    },
    "velocity_measured": Range(0.0, 1.0, "-", "It is 1, measured, or 0, not measured."),
}

_BIASED = np.array([column for column, channel in enumerate(TABLE) if channel.bias])
_FIELDS = tuple(name for name in Sensors._fields if name != "further")
ADDED = {channel.name: channel for channel in ATTITUDE}  # sampled where shown, and registered


class SensorDraw(NamedTuple):
    """The sensors of one vehicle in one episode, as the kernels take them."""

    sigma: NDArray[np.float64]  # (CHANNEL_COUNT,)
    bias: NDArray[np.float64]  # (CHANNEL_COUNT,)
    cross_coupling: float
    dropout: NDArray[np.float64]  # (3,) a standard normal number below it loses the sample
    period: NDArray[np.int64]  # (3,) [control steps]
    delay: NDArray[np.int64]  # (3,) [control steps]
    noisy: bool  # False: no random number is needed
    velocity: float  # 1, or 0 where v_x and v_y are not measured
    added: tuple[tuple[str, float, float], ...] = ()  # registered channels: name, sigma, |bias|


def register(channel: Channel) -> Channel:
    """Add a sensor channel, from then on for groups of the observation to show; returns it.

    It shares the clock of its group. Its errors are drawn from a stream of its own, so that
    nothing else changes. Raises ValueError for a name that is taken, an unknown group or preset,
    and without a function for its true value.
    """
    if channel.name in CHANNELS or channel.name in ADDED:
        raise ValueError(f"sensor channel {channel.name!r} is registered already")
    checked_choice(f"group of channel {channel.name!r}", channel.group, GROUPS)
    if not callable(channel.truth):
        raise ValueError(f"channel {channel.name!r}: truth = {channel.truth!r}; must be a function")
    own = [name for name in (channel.noise, channel.bias) if name and name not in _FIELDS]
    for name in own:
        if not name.endswith(("_noise", "_bias")):
            raise ValueError(f"channel {channel.name!r}: {name!r} must end in _noise or _bias")
    for preset, values in channel.presets.items():
        checked_choice(f"sensor preset of channel {channel.name!r}", preset, PRESETS)
        for name, value in checked_keys(f"presets of {channel.name!r}", values, own).items():
            checked_number(name, value, SIGMA)
    ADDED[channel.name] = channel
    fixed_part.cache_clear()
    return channel


def _added_fields() -> dict[str, Mapping[str, Mapping[str, float]]]:
    """Fields of the registered channels that are not fields of Sensors, with their presets."""
    return {
        name: channel.presets
        for channel in ADDED.values()
        for name in (channel.noise, channel.bias)
        if name and name not in _FIELDS
    }


def _preset(name: str) -> Sensors:
    """A preset with what registered channels say of it."""
    preset = PRESETS[checked_choice("sensor preset", name, PRESETS)]
    further = {field: of.get(name, {}).get(field, 0.0) for field, of in _added_fields().items()}
    return preset._replace(further=tuple(further.items()))


def make_sensors(spec: str | Mapping[str, Any] | Sensors, base: Sensors = RTK) -> Sensors:
    """Sensors from a preset name, or a dict {"preset": name, field: value, ...}.

    Without "preset" the fields override `base`. Where the velocity is not measured the result
    says so twice: velocity_measured is 0, and velocity_noise is UNMEASURED, so that an estimator
    which weighs by the data sheet is right without knowing of it. Raises ValueError for an unknown
    preset or field and for a value outside its range.
    """
    if isinstance(spec, Sensors):
        fields = {
            name: checked_number(name, getattr(spec, name), _RANGES[name]) for name in _FIELDS
        }
        registered = ((name, checked_number(name, value, SIGMA)) for name, value in spec.further)
        return _stated(Sensors(**fields, further=tuple(registered)))
    if spec is None:
        raise ValueError(
            "sensors = None; must be a preset by name or a dict. "
            "Did you mean 'ideal', sensors without error?"
        )
    if isinstance(spec, str):
        return _preset(spec)
    added = _added_fields()
    # As `Sensors._asdict()` has it, the fields of registered channels may stand together.
    given = dict(checked_keys("sensors", spec, ("preset", *Sensors._fields, *added)))
    given = {**checked_keys("sensors", dict(given.pop("further", ())), added), **given}
    if "preset" in given:
        base = _preset(given.pop("preset"))
    checked = {
        name: checked_number(name, value, _RANGES.get(name, SIGMA)) for name, value in given.items()
    }
    values = {name: value for name, value in checked.items() if name in _FIELDS}
    own = {name: value for name, value in checked.items() if name in added}
    again = values.get("velocity_measured", 0.0) > base.velocity_measured
    if again and "velocity_noise" not in values:
        raise ValueError("velocity_measured = 1 again; name its velocity_noise [m/s] as well")
    further = tuple({**dict(base.further), **own}.items())
    return _stated(base._replace(**values, further=further))


def _stated(sensors: Sensors) -> Sensors:
    """Sensors whose data sheet is true where the velocity is not measured. Raises ValueError."""
    if sensors.velocity_measured == 0.0:
        return sensors._replace(velocity_noise=UNMEASURED)
    if sensors.velocity_measured != 1.0:
        raise ValueError(f"velocity_measured = {sensors.velocity_measured!r}; must be 0 or 1")
    return sensors


def _error(sensors: Sensors, channel: Channel, field: str) -> float:
    """Sigma or bias magnitude of a channel, from a field of the sensors.

    Two sensors a distance D apart, each with that error: sqrt(2) times it, over D.
    """
    if not field or (channel.switch and not sensors.value(channel.switch)):
        return 0.0
    if channel.differential:
        return float(np.sqrt(2.0)) * sensors.value(field) / sensors.accelerometer_distance
    return sensors.value(field)


def _steps(sensors: Sensors, control_period: float) -> tuple[list[int], list[int]]:
    rates = [getattr(sensors, f"{group}_rate") for group in GROUPS]
    delays = [getattr(sensors, f"{group}_delay") for group in GROUPS]
    longest = round(PERIOD_LIMIT / control_period)
    periods = [
        1 if rate <= 0.0 else min(max(round(1.0 / (rate * control_period)), 1), longest)
        for rate in rates
    ]
    return periods, [round(delay / control_period) for delay in delays]


@lru_cache(maxsize=256)
def fixed_part(sensors: Sensors, control_period: float, added: tuple[str, ...]) -> SensorDraw:
    """The draw with the magnitudes of its biases, which get a sign."""
    probability = np.array([getattr(sensors, f"{group}_dropout") for group in GROUPS])
    periods, delays = _steps(sensors, control_period)
    sigma = np.array([_error(sensors, channel, channel.noise) for channel in TABLE])
    # The two accelerometers' biases differ by sqrt(2) of one, in the mean square.
    bias = np.array([_error(sensors, channel, channel.bias) for channel in TABLE])
    further = [
        (name, _error(sensors, ADDED[name], ADDED[name].noise),
         _error(sensors, ADDED[name], ADDED[name].bias))
        for name in added
    ]  # fmt: skip
    return SensorDraw(
        sigma,
        bias,
        sensors.cross_coupling,
        ndtri(probability),
        np.array(periods, dtype=np.int64),
        np.array(delays, dtype=np.int64),
        bool(np.any(sigma > 0.0) or np.any(probability > 0.0)),
        sensors.velocity_measured,
        tuple(further),
    )


@formula
def draw_signs(rng, bias):
    """Give the magnitudes of the biases (CHANNEL_COUNT,) their signs for one episode."""
    for k in range(_BIASED.size):  # also of zero biases: keeps the stream aligned
        if random(rng) < 0.5:
            bias[_BIASED[k]] = -bias[_BIASED[k]]


def draw_sensors(
    sensors: Sensors, control_period: float, rng: np.random.Generator, added: tuple[str, ...] = ()
) -> SensorDraw:
    """Draw biases; turn rates and delays [s] into control steps of `control_period` [s].

    added: registered channels that are sampled.
    """
    fixed = fixed_part(sensors, control_period, added)
    bias = fixed.bias.copy()
    draw_signs(addresses([rng])[0], bias)
    return fixed._replace(bias=bias)


def longest_delay_steps(control_period: float) -> int:
    """Control steps that the longest allowed delay takes."""
    return round(DELAY_LIMIT / control_period)
