"""Sensors of the vehicle: what they measure, how they err, data sheets and presets.

Channels, in the order of `CHANNELS`, in three groups that share a sampling clock:
    pose      INS/GNSS: position (world), yaw, body velocity          white noise
    inertial  IMU: accelerations, yaw rate, yaw acceleration          bias, noise, cross-coupling
    drive     sprocket speeds and transmitted torques                 additive noise
The yaw acceleration is the difference of two lateral accelerometers a distance D apart:
    dw/dt = (a_1 - a_2) / D, so its noise is sqrt(2) sigma_a / D      S section 5.2.1
Accelerometers feel the specific force, f = a - g_vec in body axes: on a slope a part of gravity,
and two lateral ones a distance apart also W_x W_y; on level ground f_x, f_y are the accelerations.
Model of one channel: measured = true + coupling (other axis) + bias + sigma n, n ~ N(0, 1).
`TABLE` and `ATTITUDE` say all of a channel but its true value, which `signals` and
`attitude_signals` compute. `register` adds a channel, which carries its true value as a function;
its noise and bias are then fields of the presets like the others.

Presets of the data sheet, `Sensors`:
    ideal   no error at all
    rtk     RTK-GNSS and a tactical IMU, the default
    strawa  the low-cost set of Strawa et al. (2021), section 5.2
    mocap   motion capture and encoders indoors, the default of Speed-v0
    rtk-outages, mocap-outages      the same, with outages of the pose
In an outage position, heading and velocity are missing; inertial and drive group go on.
`SensorDraw` is what an episode has of it, `tracked_env.engine.episode` how it is drawn.

References: [1] Strawa et al., Electronics 10 (2021) 187, section 5.2.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tracked_env.physics import parameters as s
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import Range
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.validation import (
    SIGMA,
    checked_choice,
    checked_interval,
    checked_keys,
    checked_number,
)

DELAY_LIMIT = 1.0  # [s] longest delay of a sensor group
PERIOD_LIMIT = 10.0  # [s] longest sampling period
OUTAGE_LIMIT = 3600.0  # [s] longest outage of the pose, and time between two
UNMEASURED = 1e3  # [m/s] velocity noise that a data sheet states where nothing is measured
SHEET = "data_sheet"  # group of the observation: the vehicle's own data sheet


# --- channels -------------------------------------------------------------------------------
class Channel(NamedTuple):
    """One sensor channel: what it measures, when, and how it errs."""

    name: str
    group: str  # one of GROUPS: sampling clock, delay and dropouts
    unit: str
    noise: str = ""  # field of the sensor presets: sigma [unit] of its white noise; "" = none
    bias: str = ""  # likewise, the magnitude [unit] of its bias
    differential: bool = False  # the difference of two sensors over their distance
    switch: str = ""  # field of the presets that is 0 where the channel is not measured
    # Of a registered channel: true value [unit], (N,), from true state and parameters by name,
    # and {preset: {field: value}}; what a preset does not name is 0.
    truth: Callable[[Mapping[str, Any]], Any] | None = None
    presets: Mapping[str, Mapping[str, float]] = MappingProxyType({})


GROUPS = ("pose", "inertial", "drive")
_ACCELERATION = ("inertial", "m/s^2", "acceleration_noise", "acceleration_bias")
_GYRO = ("inertial", "rad/s", "gyro_noise", "gyro_bias")
TABLE = (
    Channel("x", "pose", "m", "position_noise"),
    Channel("y", "pose", "m", "position_noise"),
    Channel("yaw", "pose", "rad", "yaw_noise"),
    Channel("v_x", "pose", "m/s", "velocity_noise", switch="velocity_measured"),
    Channel("v_y", "pose", "m/s", "velocity_noise", switch="velocity_measured"),
    Channel("acceleration_x", *_ACCELERATION),
    Channel("acceleration_y", *_ACCELERATION),
    Channel("yaw_rate", *_GYRO),
    Channel("yaw_acceleration", "inertial", "rad/s^2", *_ACCELERATION[2:], differential=True),
    Channel("sprocket_speed_left", "drive", "rad/s", "sprocket_speed_noise"),
    Channel("sprocket_speed_right", "drive", "rad/s", "sprocket_speed_noise"),
    Channel("torque_left", "drive", "N m", "torque_noise"),
    Channel("torque_right", "drive", "N m", "torque_noise"),
)
# Of the attitude, sampled where an observation shows them: roll and pitch err as the yaw of the
# same INS does, the gyros and accelerometers as those of TABLE.
ATTITUDE = (
    Channel("roll", "inertial", "rad", "yaw_noise"),
    Channel("pitch", "inertial", "rad", "yaw_noise"),
    Channel("roll_rate", *_GYRO),
    Channel("pitch_rate", *_GYRO),
    Channel("specific_force_z", *_ACCELERATION),
)
CHANNELS = tuple(channel.name for channel in TABLE)
CHANNEL_COUNT = len(CHANNELS)
# Channels of group g: GROUP_START[g] .. GROUP_START[g + 1]; the table is sorted by group.
GROUP_START = (*([c.group for c in TABLE].index(group) for group in GROUPS), CHANNEL_COUNT)
NOISE_COUNT = CHANNEL_COUNT + len(GROUPS)  # normal numbers per step: channels, then dropouts
ADDED = {channel.name: channel for channel in ATTITUDE}  # sampled where shown, and registered


@formula
def signals(state, i, sprocket_radius, cross_coupling, velocity):
    """Noise-free value of every channel of vehicle i, in the order of CHANNELS.

    state: (N, >= STATE_ROWS), its first columns the state; sprocket_radius r [m];
    cross_coupling [-] between the two accelerometer axes; velocity [-] 1, or 0 where the body
    velocity is not measured and reads 0.
    The torque that is measured is the one that reaches the soil, F r. In the lumped plant sprocket
    and track have no inertia, and it is all that the drive can give. In the distributed plant
    driven by torque they have `sprocket_inertia`: what speeds them up is not in the reading.
    """
    forward, lateral = state[i, s.ACCELERATION_X], state[i, s.ACCELERATION_Y]
    turning = state[i, s.YAW_ACCELERATION]
    pitch, roll = state[i, s.PITCH], state[i, s.ROLL]
    if pitch != 0.0 or roll != 0.0:
        c_pitch, s_pitch = rotation(pitch)
        forward -= GRAVITY * s_pitch
        lateral += GRAVITY * c_pitch * rotation(roll)[1]
        turning += state[i, s.ROLL_RATE] * state[i, s.PITCH_RATE]
    return (
        state[i, s.X],
        state[i, s.Y],
        state[i, s.YAW],
        velocity * state[i, s.V_X],
        velocity * state[i, s.V_Y],
        forward + cross_coupling * lateral,
        lateral + cross_coupling * forward,
        state[i, s.YAW_RATE],
        turning,
        state[i, s.SPROCKET_SPEED_LEFT],
        state[i, s.SPROCKET_SPEED_RIGHT],
        state[i, s.EFFORT_LEFT] * sprocket_radius,
        state[i, s.EFFORT_RIGHT] * sprocket_radius,
    )


@formula
def attitude_signals(state, i):
    """Noise-free value of every channel of ATTITUDE of vehicle i, in its order.

    state: as of `signals`. The vertical accelerometer feels f_z = a_z + g cos(pitch) cos(roll).
    """
    pitch, roll = state[i, s.PITCH], state[i, s.ROLL]
    force = state[i, s.ACCELERATION_Z] + GRAVITY * (rotation(pitch)[0] * rotation(roll)[0])
    return roll, pitch, state[i, s.ROLL_RATE], state[i, s.PITCH_RATE], force


# --- data sheets ----------------------------------------------------------------------------
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
    pose_outage_gap: tuple[float, float] = (0.0, 0.0)  # [s] = U(low, high) with a pose, then
    pose_outage_length: tuple[float, float] = (0.0, 0.0)  # [s] = U(low, high) without; 0, 0: none
    data_sheet_error: float = 0.0  # [-] of each number of the group `data_sheet`, random sign
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
MOCAP = RTK._replace(
    position_noise=0.001, yaw_noise=float(np.radians(0.1)), velocity_noise=0.01, torque_noise=0.1
)
# Behind trees or a wall without satellites, behind an obstacle without markers.
_OUTAGES: dict[str, Any] = {"pose_outage_gap": (5.0, 10.0), "pose_outage_length": (3.0, 10.0)}
PRESETS = {
    **{"ideal": IDEAL, "rtk": RTK, "strawa": STRAWA, "mocap": MOCAP},
    **{"rtk-outages": RTK._replace(**_OUTAGES), "mocap-outages": MOCAP._replace(**_OUTAGES)},
}
# [N m] of the torque sensors of the presets: that of the vehicle they were chosen for. Those of
# another vehicle err by the same share of its torque limit.
TORQUE_RANGE = {name: 40.0 if "mocap" in name else 8000.0 for name in PRESETS}
_OF_A_GROUP = {
    "rate": Range(0.0, 1e4, "Hz", "0 means every control step."),
    "delay": Range(0.0, DELAY_LIMIT, "s", "Did you pass milliseconds?"),
    "dropout": Range(0.0, 1.0, "-", "It is a probability, not a percentage."),
}
_RANGES = {
    "cross_coupling": Range(0.0, 1.0, "-", "Did you pass a percentage?"),
    "accelerometer_distance": Range(0.01, 10.0, "m", "Did you pass millimetres?"),
    **{f"{group}_{of}": allowed for group in GROUPS for of, allowed in _OF_A_GROUP.items()},
    "velocity_measured": Range(0.0, 1.0, "-", "It is 1, measured, or 0, not measured."),
    "data_sheet_error": Range(0.0, 10.0, "-", "Did you pass a percentage?"),
}  # all others: SIGMA
_OUTAGE = Range(0.0, OUTAGE_LIMIT, "s", "Did you pass control steps?")
_FIELDS = tuple(name for name in Sensors._fields if name != "further")


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
    fields = [name for name in (channel.noise, channel.bias) if name and name not in _FIELDS]
    for name in fields:
        if not name.endswith(("_noise", "_bias")):
            raise ValueError(f"channel {channel.name!r}: {name!r} must end in _noise or _bias")
    for preset, values in channel.presets.items():
        checked_choice(f"sensor preset of channel {channel.name!r}", preset, PRESETS)
        for name, value in checked_keys(f"presets of {channel.name!r}", values, fields).items():
            checked_number(name, value, SIGMA)
    ADDED[channel.name] = channel
    return channel


def _added_fields() -> dict[str, Mapping[str, Mapping[str, float]]]:
    """Fields of the registered channels that are not fields of Sensors, with their presets."""
    pairs = ((name, c.presets) for c in ADDED.values() for name in (c.noise, c.bias))
    return {name: presets for name, presets in pairs if name and name not in _FIELDS}


def _preset(name: str, torque_limit: float | None) -> Sensors:
    """A preset with what registered channels say of it, its torque sensors for another limit."""
    preset = PRESETS[checked_choice("sensor preset", name, PRESETS)]
    share = 1.0 if torque_limit is None else torque_limit / TORQUE_RANGE[name]
    preset = preset._replace(torque_noise=share * preset.torque_noise)
    further = {field: of.get(name, {}).get(field, 0.0) for field, of in _added_fields().items()}
    return preset._replace(further=tuple(further.items()))


def _checked(name: str, value: Any) -> Any:
    if name.startswith("pose_outage"):
        return checked_interval(name, value, _OUTAGE)
    return checked_number(name, value, _RANGES.get(name, SIGMA))


def make_sensors(
    spec: str | Mapping[str, Any] | Sensors,
    base: Sensors | None = None,
    torque_limit: float | None = None,
) -> Sensors:
    """Sensors from a preset name, or a dict {"preset": name, field: value, ...}.

    Without "preset" the fields override `base`, by default `rtk`. torque_limit [N m]: of the
    vehicle, to which the torque noise of a preset is in proportion; None: as the preset has it.
    Where the velocity is not measured the result says so twice: velocity_measured is 0, and
    velocity_noise is UNMEASURED, so that an estimator which weighs by the data sheet is right
    without knowing of it. Outages need both a length and a gap. Raises ValueError for an unknown
    preset or field and for a value outside its range.
    """
    if spec is None:
        raise ValueError(
            "sensors = None; must be a preset by name or a dict. "
            "Did you mean 'ideal', sensors without error?"
        )
    if isinstance(spec, str):
        return _preset(spec, torque_limit)
    added: set[str] = {*_added_fields()}
    if isinstance(spec, Sensors):
        base, added = Sensors(), added | {name for name, _ in spec.further}
        spec = spec._asdict()
    # As `Sensors._asdict()` has it, the fields of registered channels may stand together.
    fields = dict(checked_keys("sensors", spec, ("preset", *Sensors._fields, *added)))
    fields = {**checked_keys("sensors", dict(fields.pop("further", ())), added), **fields}
    if "preset" in fields:
        base = _preset(fields.pop("preset"), torque_limit)
    base = _preset("rtk", torque_limit) if base is None else base
    checked = {name: _checked(name, value) for name, value in fields.items()}
    values = {name: checked.pop(name) for name in _FIELDS if name in checked}
    again = values.get("velocity_measured", 0.0) > base.velocity_measured
    if again and "velocity_noise" not in values:
        raise ValueError("velocity_measured = 1 again; name its velocity_noise [m/s] as well")
    sensors = base._replace(**values, further=tuple({**dict(base.further), **checked}.items()))
    gap, length = sensors.pose_outage_gap, sensors.pose_outage_length
    if (gap[1] > 0.0) != (length[1] > 0.0):
        raise ValueError(
            f"pose_outage_gap = {list(gap)} s and pose_outage_length = {list(length)} s; outages "
            "need both, and [0, 0] of both means none. Did you forget one?"
        )
    if sensors.velocity_measured not in (0.0, 1.0):
        raise ValueError(f"velocity_measured = {sensors.velocity_measured!r}; must be 0 or 1")
    unmeasured = sensors.velocity_measured == 0.0
    return sensors._replace(velocity_noise=UNMEASURED) if unmeasured else sensors


# --- of an episode --------------------------------------------------------------------------
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
    # Registered channels, then SHEET where it errs: name, sigma, |bias|
    added: tuple[tuple[str, float, float], ...] = ()
    outage: tuple[float, ...] = ()  # [control steps] gap low, high, length low, high; empty: none


def _error(sensors: Sensors, channel: Channel, field: str) -> float:
    """Sigma or bias magnitude of a channel, from a field of the sensors.

    Two sensors a distance D apart, each with that error: sqrt(2) times it, over D.
    """
    if not field or (channel.switch and not sensors.value(channel.switch)):
        return 0.0
    if channel.differential:
        return float(np.sqrt(2.0)) * sensors.value(field) / sensors.accelerometer_distance
    return sensors.value(field)


@lru_cache(maxsize=256)
def _own_channels(sensors: Sensors, control_period: float) -> SensorDraw:
    """The draw with the magnitudes of its biases, which get a sign; no registered channels."""
    probability = np.array([getattr(sensors, f"{group}_dropout") for group in GROUPS])
    rates = [getattr(sensors, f"{group}_rate") for group in GROUPS]
    delays = [getattr(sensors, f"{group}_delay") for group in GROUPS]
    longest = round(PERIOD_LIMIT / control_period)
    periods = [
        1 if rate <= 0.0 else min(max(round(1.0 / (rate * control_period)), 1), longest)
        for rate in rates
    ]
    bounds = (*sensors.pose_outage_gap, *sensors.pose_outage_length)
    outage = tuple(time / control_period for time in bounds) if any(bounds) else ()
    sigma = np.array([_error(sensors, channel, channel.noise) for channel in TABLE])
    return SensorDraw(
        sigma,
        np.array([_error(sensors, channel, channel.bias) for channel in TABLE]),
        sensors.cross_coupling,
        ndtri(probability),
        np.array(periods, dtype=np.int64),
        np.array([round(delay / control_period) for delay in delays], dtype=np.int64),
        bool(np.any(sigma > 0.0) or np.any(probability > 0.0) or outage),
        sensors.velocity_measured,
        outage=outage,
    )


def sensor_draw(sensors: Sensors, control_period: float, added: Iterable[str]) -> SensorDraw:
    """The draw of these sensors, biases without their signs; added: registered channels."""
    channels = [ADDED[name] for name in added]
    errors = [(c.name, _error(sensors, c, c.noise), _error(sensors, c, c.bias)) for c in channels]
    if sensors.data_sheet_error > 0.0:
        errors.append((SHEET, 0.0, math.log1p(sensors.data_sheet_error)))
    return _own_channels(sensors, control_period)._replace(added=tuple(errors))


def longest_delay_steps(control_period: float) -> int:
    """Control steps that the longest allowed delay takes."""
    return round(DELAY_LIMIT / control_period)
