"""What one vehicle meets in one episode, and how it is drawn or overridden.

The draws of an episode, always in this order, from the vehicle's own generator:
    noise seed      = integer in [0, 2^63)
    start           offset_x, offset_y = U(-0.15, 0.15) contact lengths (0.3 m for 2 m),
                    offset_yaw = U(-0.1, 0.1) rad, speed = reference speed *U(0.8, 1.2),
                    yaw rate = that of the reference
    reference       as `tracked_env.references` says for its kind
    uncertainty     as `tracked_env.uncertainty` says for its set
    sensors         signs of the biases
    terrain         where the plant has several: which one, an integer
`options` override any value for one episode; the draws are made all the same, so that
overriding one thing leaves the others as they were. A set draws the same for every plant; of its
changes an episode has those of parameters that the plant reads (`plants.base`). An option or a
schedule that names another parameter is a ValueError.

The draw of one vehicle's sensors for one episode, as the kernels take it.

Laws of the draws, once per episode and vehicle:
    gyro and accelerometer bias     = s b, s = -1 or +1 with equal odds, b the data-sheet bias
    noise, every sample             = N(0, sigma^2)
    dropout, every sample and group : lost with probability p; the last sample stays
    outages of the pose = U(gap), U(length), U(gap), ... [s], a renewal process; the first sample of
                          an episode comes always
Outages are drawn while the episode runs (`engine.observing.outage`), by numbers of its noise that
no sample uses, so that all other numbers stay what they are.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tracked_env.engine.noise import addresses, random, seed, uniform
from tracked_env.events import encode_schedule
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import (
    GROUPS,
    PARAMETER_NAMES,
    ParametersRead,
    PlantParameters,
    Range,
    VehicleState,
)
from tracked_env.physics.reference_profile import COURSE_COLUMNS, UNIFORM_COLUMNS
from tracked_env.references import ReferenceProfile, make_reference
from tracked_env.sensors import (
    ADDED,
    DELAY_LIMIT,
    PERIOD_LIMIT,
    TABLE,
    Channel,
    Sensors,
    make_sensors,
)
from tracked_env.sensors import GROUPS as GROUPS_channels
from tracked_env.uncertainty import CheckedLaw, Law, Spec, make_uncertainty
from tracked_env.validation import (
    checked_effect,
    checked_keys,
    checked_number,
    checked_parameter,
    checked_whole,
)

_BIASED = np.array([column for column, channel in enumerate(TABLE) if channel.bias])


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


def _steps(sensors: Sensors, control_period: float) -> tuple[list[int], list[int]]:
    rates = [getattr(sensors, f"{group}_rate") for group in GROUPS_channels]
    delays = [getattr(sensors, f"{group}_delay") for group in GROUPS_channels]
    longest = round(PERIOD_LIMIT / control_period)
    periods = [
        1 if rate <= 0.0 else min(max(round(1.0 / (rate * control_period)), 1), longest)
        for rate in rates
    ]
    return periods, [round(delay / control_period) for delay in delays]


def fixed_part(sensors: Sensors, control_period: float, added: tuple[str, ...]) -> SensorDraw:
    """The draw with the magnitudes of its biases, which get a sign."""
    further = (
        (name, _error(sensors, ADDED[name], ADDED[name].noise),
         _error(sensors, ADDED[name], ADDED[name].bias))
        for name in added
    )  # fmt: skip
    return _own_part(sensors, control_period)._replace(added=tuple(further))


@lru_cache(maxsize=256)
def _own_part(sensors: Sensors, control_period: float) -> SensorDraw:
    """The same without registered channels."""
    probability = np.array([getattr(sensors, f"{group}_dropout") for group in GROUPS_channels])
    periods, delays = _steps(sensors, control_period)
    bounds = (*sensors.pose_outage_gap, *sensors.pose_outage_length)
    outage = tuple(time / control_period for time in bounds) if any(bounds) else ()
    sigma = np.array([_error(sensors, channel, channel.noise) for channel in TABLE])
    # The two accelerometers' biases differ by sqrt(2) of one, in the mean square.
    bias = np.array([_error(sensors, channel, channel.bias) for channel in TABLE])
    return SensorDraw(
        sigma,
        bias,
        sensors.cross_coupling,
        ndtri(probability),
        np.array(periods, dtype=np.int64),
        np.array(delays, dtype=np.int64),
        bool(np.any(sigma > 0.0) or np.any(probability > 0.0) or outage),
        sensors.velocity_measured,
        outage=outage,
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


# Option -> group of parameters; `closure` is the former name of `lateral_model`.
PARAMETER_KEYS = {**{group: group for group in GROUPS}, "closure": "lateral_model"}
OPTION_KEYS = (*PARAMETER_KEYS, "reference", "sensors", "schedule", "start", "terrain")
START_OFFSET = 0.15  # [-] of the nominal contact length, to either side
DURATION_RANGE = Range(0.1, 3600.0, "s", "Did you pass control steps?")
_START_RANGES = {
    "offset_x": Range(-100.0, 100.0, "m", "It is an offset, not a position."),
    "offset_y": Range(-100.0, 100.0, "m", "It is an offset, not a position."),
    "offset_yaw": Range(-3.15, 3.15, "rad", "Did you pass degrees?"),
    "speed": Range(-20.0, 20.0, "m/s", "Did you pass km/h?"),
    "yaw_rate": Range(-10.0, 10.0, "rad/s", "Did you pass degrees per second?"),
}


class EpisodeSettings(NamedTuple):
    """What the episodes of an environment are drawn from."""

    reference: str | Mapping[str, Any]
    law: Law
    nominal: PlantParameters  # around which the law draws
    sensors: Sensors
    duration: float  # [s]
    control_period: float  # [s]
    reads: ParametersRead  # by the plant
    channels: tuple[str, ...] = ()  # registered sensor channels that are sampled
    relief_column: int = 0  # where the plant reads a drawn relief; 0: nowhere
    terrains: int = 1  # of which an episode draws one
    reference_rows: int = 0  # of the table of a reference that was drawn as a trial
    reference_columns: int = UNIFORM_COLUMNS  # of its table: knots of its own need more
    shows_goal: bool = False  # in the observation: then a reference has to have one

    @property
    def max_steps(self) -> int:
        """Control steps of an episode."""
        return max(round(self.duration / self.control_period), 1)


class Episode(NamedTuple):
    """The truth of one episode."""

    parameters: PlantParameters  # at its start
    events: NDArray[np.float64]  # (E, 8) what changes, as the kernels take it
    profile: ReferenceProfile
    sensors: SensorDraw
    state: VehicleState  # at its start
    noise_seed: int
    relief: tuple[float, ...] = ()  # drawn ground, see `terrain.drawn_relief`; empty: none
    terrain: int = 0  # member of `terrain.pool` on which it takes place


def make_settings(
    reference: str | Mapping[str, Any],
    uncertainty: Spec,
    sensors: str | Mapping[str, Any] | Sensors,
    duration: float,
    control_period: float,
    nominal: PlantParameters,
    reads: ParametersRead,
    channels: tuple[str, ...] = (),
    relief_column: int = 0,
    terrains: int = 1,
    shows_goal: bool = False,
) -> EpisodeSettings:
    """Check everything that an environment is built from. Raises ValueError."""
    length = checked_number("duration", duration, DURATION_RANGE)
    profile = make_reference(reference, length, np.random.default_rng(0), nominal)
    _check_goal(profile, shows_goal)
    law = make_uncertainty(uncertainty, reads)
    if isinstance(law, CheckedLaw):  # somebody's own: an error in it shows here, not in an episode
        law(np.random.default_rng(0), nominal, profile, length)
    return EpisodeSettings(
        reference, law, nominal, make_sensors(sensors), length, control_period, reads, channels,
        relief_column, terrains, len(profile.table), profile.table.shape[1], shows_goal,
    )  # fmt: skip


def _check_goal(profile: ReferenceProfile, shows_goal: bool) -> None:
    """Raise ValueError where a goal is to be shown of a reference that has none."""
    if shows_goal and not profile.knots.size:
        raise ValueError(
            "observation group 'goal': the reference has no goal; must be of the kind \"plan\": "
            'reference={"kind": "plan", "goals": "halton"}'
        )


def _overridden(
    parameters: PlantParameters, options: Mapping[str, Any], reads: ParametersRead
) -> PlantParameters:
    values = {}
    for given, group in PARAMETER_KEYS.items():
        chosen = checked_keys(f"options['{given}']", options.get(given), GROUPS[group])
        for name, value in chosen.items():
            values[name] = checked_parameter(name, value)
            checked_effect("option", name, value, reads)
    return parameters._replace(**values) if values else parameters


@loop
def draw_beginnings(rngs, rows, seeds, draws):
    """What comes before all else, into the rows of the generators `rngs`.

    seeds (N,) of the noise, draws (N, 4) in [-1, 1) behind the start.
    """
    for k in range(rngs.size):
        seeds[rows[k]] = seed(rngs[k])
        for j in range(draws.shape[1]):
            draws[rows[k], j] = uniform(rngs[k], -1.0, 1.0)


@formula
def start_beside(draws, length, speed, yaw_rate):
    """Offsets x, y [m] and yaw [rad] from the reference, speed and yaw rate, from its own."""
    return (
        START_OFFSET * length * draws[0],
        START_OFFSET * length * draws[1],
        0.1 * draws[2],
        speed * (1.0 + 0.2 * draws[3]),
        yaw_rate,
    )


@formula
def placed(pose, offset_x, offset_y, offset_yaw):
    """x, y, yaw of a vehicle at these offsets from pose: x, y, yaw, cos, sin."""
    x = pose[0] + pose[3] * offset_x - pose[4] * offset_y
    y = pose[1] + pose[4] * offset_x + pose[3] * offset_y
    return x, y, pose[2] + offset_yaw


def _start(
    profile: ReferenceProfile, draws: NDArray[np.float64], options: Mapping[str, Any], length: float
) -> VehicleState:
    """Vehicle of that contact length at the start: beside the reference, moving nearly as it
    does."""
    given = checked_keys("options['start']", options.get("start"), _START_RANGES)
    drawn = start_beside(draws, length, profile.speed[0, 0], profile.yaw_rate[0, 0])
    values = dict(zip(_START_RANGES, drawn, strict=True))
    for name, value in given.items():
        values[name] = checked_number(f"start {name}", value, _START_RANGES[name])
    pose = (profile.x, profile.y, profile.yaw, np.cos(profile.yaw), np.sin(profile.yaw))
    x, y, yaw = placed(pose, *(values[name] for name in ("offset_x", "offset_y", "offset_yaw")))
    return VehicleState(x, y, yaw, v_x=values["speed"], yaw_rate=values["yaw_rate"])


def _schedule(
    options: Mapping[str, Any], drawn: Sequence[Mapping[str, Any]], reads: ParametersRead
) -> NDArray[np.float64]:
    """The changes of the episode: those given, or those drawn that change what the plant reads."""
    given = options.get("schedule")
    if given is None:
        return encode_schedule([event for event in drawn if event["parameter"] in reads.names])
    rows = encode_schedule(given)
    for name, target in ((PARAMETER_NAMES[int(row[1])], float(row[2])) for row in rows):
        checked_effect("schedule target of", name, target, reads)
        if name == reads.limit:
            raise ValueError(
                f"schedule target of {name} = {target!r}; it cannot change inside an episode of "
                f"the {reads.plant}: the action is measured in it. Change the action instead."
            )
    return rows


def _terrain(options: Mapping[str, Any], drawn: int, count: int) -> int:
    """Which terrain of the pool: the one that is given, or the drawn one. Raises ValueError."""
    given = options.get("terrain")
    if given is None:
        return drawn
    if count == 1:
        raise ValueError(
            f"options['terrain'] = {given!r}; there is only one terrain. Did you mean the argument "
            'terrain={"kind": "drawn", ...}, of which an episode takes one by its number?'
        )
    return checked_whole(
        "options['terrain']", given, Range(0, count - 1, "-", "It is the number of a terrain.")
    )


def _given_reference(
    spec: str | Mapping[str, Any], settings: EpisodeSettings, noise_seed: int
) -> ReferenceProfile:
    """A reference of the options. Raises ValueError where the environment has no room for it."""
    rng = np.random.default_rng(noise_seed)
    profile = make_reference(spec, settings.duration, rng, settings.nominal)
    _check_goal(profile, settings.shows_goal)
    columns = profile.table.shape[1]
    if columns > settings.reference_columns:
        frame = ' and "frame": "body"' if columns > COURSE_COLUMNS else ""
        raise ValueError(
            "options['reference'] is a plan, for which this environment keeps no knots: make it "
            f'with reference={{"kind": "plan", ...}}{frame}, then options may give another one'
        )
    return profile


def draw_episode(
    rng: np.random.Generator, settings: EpisodeSettings, options: Mapping[str, Any] | None
) -> Episode:
    """Draw one episode from `rng`; `options` (see OPTION_KEYS) override what they name.

    Raises ValueError for an unknown key and for a value outside its range.
    """
    options = checked_keys("options", options, OPTION_KEYS)
    seeds, start_draws = np.empty(1, dtype=np.int64), np.empty((1, 4))
    draw_beginnings(addresses([rng]), np.zeros(1, dtype=np.int64), seeds, start_draws)
    noise_seed = int(seeds[0])
    profile = make_reference(settings.reference, settings.duration, rng, settings.nominal)
    truth = settings.law(rng, settings.nominal, profile, settings.duration)
    if options.get("reference") is not None:
        profile = _given_reference(options["reference"], settings, noise_seed)
    sensors = settings.sensors
    if options.get("sensors") is not None:
        sensors = make_sensors(options["sensors"], base=sensors)
    its_sensors = draw_sensors(sensors, settings.control_period, rng, settings.channels)
    terrain = int(rng.integers(settings.terrains)) if settings.terrains > 1 else 0
    return Episode(
        _overridden(truth.parameters, options, settings.reads),
        _schedule(options, truth.events, settings.reads),
        profile,
        its_sensors,
        _start(profile, start_draws[0], options, settings.nominal.contact_length),
        noise_seed,
        truth.relief if settings.relief_column else (),
        _terrain(options, terrain, settings.terrains),
    )
