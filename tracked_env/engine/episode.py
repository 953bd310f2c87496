"""What one vehicle meets in one episode: what it is drawn from, and what options put in its place.

The draws of an episode, always in this order, from the vehicle's own generator:
    noise seed      = integer in [0, 2^63)
    start           offset_x, offset_y = U(-0.15, 0.15) contact lengths (0.3 m for 2 m),
                    offset_yaw = U(-0.1, 0.1) rad, speed = reference speed *U(0.8, 1.2),
                    yaw rate = that of the reference
    reference       as `tracked_env.references` says for its kind
    uncertainty     as `tracked_env.uncertainty` says for its set
    sensors         bias of gyro and accelerometers = s b, s = -1 or +1, b the data-sheet bias
    terrain         where the plant has several: which one, an integer
`options` override any value for one episode; the draws are made all the same, so that
overriding one thing leaves the others as they were. A set draws the same for every plant; of its
changes an episode has those of parameters that the plant reads (`plants`). An option or a
schedule that names another parameter is a ValueError.

What sensors draw at every sample comes from the noise of the vehicle (`tracked_env.streams`):
noise N(0, sigma^2), loss with probability p (then the last sample stays), and outages of the pose,
a renewal process U(gap), U(length), U(gap), ... [s]; the first sample of an episode comes always.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tracked_env.engine.env_config import EnvConfig, Solver
from tracked_env.events import encode_schedule
from tracked_env.observation import Layout
from tracked_env.physics.parameters import GROUPS as PARAMETER_GROUPS
from tracked_env.physics.parameters import (
    PARAMETER_NAMES,
    ParametersRead,
    PlantParameters,
    Range,
    VehicleState,
)
from tracked_env.physics.reference_profile import COURSE_COLUMNS
from tracked_env.references import ReferenceProfile, make_reference
from tracked_env.sensors import (
    ADDED,
    DELAY_LIMIT,
    GROUPS,
    PERIOD_LIMIT,
    TABLE,
    Channel,
    Sensors,
    make_sensors,
)
from tracked_env.uncertainty import CheckedLaw, Law, make_uncertainty
from tracked_env.validation import (
    checked_effect,
    checked_keys,
    checked_number,
    checked_parameter,
    checked_whole,
)

OPTION_KEYS = (*PARAMETER_GROUPS, "reference", "sensors", "schedule", "start", "terrain")
DURATION_RANGE = Range(0.1, 3600.0, "s", "Did you pass control steps?")
_OFFSET = Range(-100.0, 100.0, "m", "It is an offset, not a position.")
START_RANGES = {
    "offset_x": _OFFSET,
    "offset_y": _OFFSET,
    "offset_yaw": Range(-3.15, 3.15, "rad", "Did you pass degrees?"),
    "speed": Range(-20.0, 20.0, "m/s", "Did you pass km/h?"),
    "yaw_rate": Range(-10.0, 10.0, "rad/s", "Did you pass degrees per second?"),
}


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


class Episode(NamedTuple):
    """The truth of one episode."""

    parameters: PlantParameters  # at its start
    events: NDArray[np.float64]  # (E, 8) what changes, as the kernels take it
    profile: ReferenceProfile
    sensors: SensorDraw
    state: VehicleState  # at its start
    noise_seed: int
    relief: tuple[float, ...] = ()  # drawn ground, see `terrain.pool`; empty: none
    terrain: int = 0  # member of `terrain.pool` on which it takes place


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


def longest_delay_steps(control_period: float) -> int:
    """Control steps that the longest allowed delay takes."""
    return round(DELAY_LIMIT / control_period)


class EpisodeSettings(NamedTuple):
    """What the episodes of an environment are drawn from."""

    reference: str | Mapping[str, Any]
    law: Law
    nominal: PlantParameters  # around which the law draws
    sensors: Sensors
    duration: float  # [s]
    control_period: float  # [s]
    reads: ParametersRead  # by the plant
    layout: Layout
    relief_column: int  # where the plant reads a drawn relief; 0: nowhere
    terrains: int  # of which an episode draws one
    reference_rows: int = 0  # of the table of a reference that was drawn as a trial
    reference_columns: int = 0  # of its table: knots of its own need more

    @property
    def max_steps(self) -> int:
        """Control steps of an episode."""
        return max(round(self.duration / self.control_period), 1)

    def sensor_draw(self, sensors: Sensors) -> SensorDraw:
        """The draw of these sensors, biases without their signs."""
        draw = _own_channels(sensors, self.control_period)
        added = (ADDED[name] for name in self.layout.channels)
        errors = ((c.name, _error(sensors, c, c.noise), _error(sensors, c, c.bias)) for c in added)
        return draw._replace(added=tuple(errors))

    def make_reference(
        self, spec: str | Mapping[str, Any], rng: np.random.Generator
    ) -> ReferenceProfile:
        """A reference. Raises ValueError, also for one without the goal that is shown."""
        profile = make_reference(spec, self.duration, rng, self.nominal)
        if any(group.goal for group in self.layout.parts) and not profile.knots.size:
            raise ValueError(
                "observation group 'goal': the reference has no goal; must be of the kind "
                '"plan": reference={"kind": "plan", "goals": "halton"}'
            )
        return profile


def make_settings(config: EnvConfig, solver: Solver, layout: Layout) -> EpisodeSettings:
    """Check what the episodes of an environment are drawn from. Raises ValueError."""
    settings = EpisodeSettings(
        reference=config.reference,
        law=make_uncertainty(config.uncertainty, solver.reads),
        nominal=solver.nominal,
        sensors=make_sensors(config.sensors),
        duration=checked_number("duration", config.duration, DURATION_RANGE),
        control_period=solver.control_period,
        reads=solver.reads,
        layout=layout,
        relief_column=solver.plant.relief_column,
        terrains=solver.prepared.terrains,
    )
    profile = settings.make_reference(config.reference, np.random.default_rng(0))
    if isinstance(settings.law, CheckedLaw):  # an error in a user's law shows here
        settings.law(np.random.default_rng(0), solver.nominal, profile, settings.duration)
    rows, columns = profile.table.shape
    return settings._replace(reference_rows=rows, reference_columns=columns)


class Overrides(NamedTuple):
    """What the options of a reset put in the place of draws, checked; None: as it is drawn."""

    parameters: Mapping[str, float]
    reference: ReferenceProfile | None
    sensors: SensorDraw | None  # biases without their signs
    events: NDArray[np.float64] | None  # (E, 8)
    start: NDArray[np.float64]  # (5,) in the order of START_RANGES, NaN: as it is drawn
    terrain: int | None


def checked_overrides(
    options: Mapping[str, Any] | None, settings: EpisodeSettings, noise_seed: int
) -> Overrides:
    """The overrides that `options` (see OPTION_KEYS) ask for; noise_seed: of a random reference.

    Raises ValueError for an unknown key and for a value outside its range.
    """
    options = checked_keys("options", options, OPTION_KEYS)
    values = {}
    for group, names in PARAMETER_GROUPS.items():
        for name, value in checked_keys(f"options['{group}']", options.get(group), names).items():
            values[name] = checked_parameter(name, value)
            checked_effect("option", name, value, settings.reads)
    sensors, events, draw = options.get("sensors"), options.get("schedule"), None
    if sensors is not None:
        draw = settings.sensor_draw(make_sensors(sensors, base=settings.sensors))
    if events is not None:
        events = _checked_schedule(events, settings.reads)
    start = checked_keys("options['start']", options.get("start"), START_RANGES)
    beginning = [
        checked_number(f"start {name}", start[name], allowed) if name in start else np.nan
        for name, allowed in START_RANGES.items()
    ]
    terrain, reference = options.get("terrain"), options.get("reference")
    if terrain is not None:
        terrain = _checked_terrain(terrain, settings.terrains)
    if reference is not None:
        reference = settings.make_reference(reference, np.random.default_rng(noise_seed))
        columns = reference.table.shape[1]
        if columns > settings.reference_columns:
            frame = ' and "frame": "body"' if columns > COURSE_COLUMNS else ""
            raise ValueError(
                "options['reference'] is a plan, for which this environment keeps no knots: make "
                f'it with reference={{"kind": "plan", ...}}{frame}, then options may give another'
            )
    return Overrides(values, reference, draw, events, np.array(beginning), terrain)


def _checked_schedule(schedule: Any, reads: ParametersRead) -> NDArray[np.float64]:
    """Rows of a schedule whose changes the plant reads. Raises ValueError."""
    rows = encode_schedule(schedule)
    for name, target in ((PARAMETER_NAMES[int(row[1])], float(row[2])) for row in rows):
        checked_effect("schedule target of", name, target, reads)
        if name == reads.limit:
            raise ValueError(
                f"schedule target of {name} = {target!r}; it cannot change inside an episode of "
                f"the {reads.plant}: the action is measured in it. Change the action instead."
            )
    return rows


def _checked_terrain(number: Any, count: int) -> int:
    if count == 1:
        raise ValueError(
            f"options['terrain'] = {number!r}; there is only one terrain. Did you mean the "
            'argument terrain={"kind": "drawn", ...}, of which an episode takes one by its number?'
        )
    allowed = Range(0, count - 1, "-", "It is the number of a terrain.")
    return checked_whole("options['terrain']", number, allowed)
