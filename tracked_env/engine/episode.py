"""What one vehicle meets in one episode: what it is drawn from, and what options put in its place.

The draws of an episode, always in this order, from the vehicle's own generator:
    noise seed      = integer in [0, 2^63)
    start           offset_x, offset_y = U(-0.15, 0.15) contact lengths (0.3 m for 2 m),
                    offset_yaw = U(-0.1, 0.1) rad, speed = reference speed *U(0.8, 1.2),
                    yaw rate = that of the reference
    vehicle         by laws that draw it (`uncertainty.any_vehicle`): the nominal one
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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine.env_config import EnvConfig, Solver
from tracked_env.events import encode_schedule
from tracked_env.observation import Layout
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import ParametersRead, PlantParameters, Range, VehicleState
from tracked_env.physics.reference_profile import COURSE_COLUMNS
from tracked_env.references import ReferenceProfile, make_reference
from tracked_env.references.profile import PLAN
from tracked_env.sensors import SensorDraw, Sensors, make_sensors, sensor_draw
from tracked_env.uncertainty import CheckedLaw, Draw, Law, draws_vehicles, make_uncertainty
from tracked_env.validation import (
    checked_effect,
    checked_keys,
    checked_number,
    checked_parameter,
    checked_whole,
)

OPTION_KEYS = (*s.GROUPS, "reference", "sensors", "schedule", "start", "terrain")
DURATION_RANGE = Range(0.1, 3600.0, "s", "Did you pass control steps?")
_OFFSET = Range(-100.0, 100.0, "m", "It is an offset, not a position.")
START_RANGES = {
    "offset_x": _OFFSET,
    "offset_y": _OFFSET,
    "offset_yaw": Range(-3.15, 3.15, "rad", "Did you pass degrees?"),
    "speed": Range(-20.0, 20.0, "m/s", "Did you pass km/h?"),
    "yaw_rate": Range(-10.0, 10.0, "rad/s", "Did you pass degrees per second?"),
}


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


class EpisodeSettings(NamedTuple):
    """What the episodes of an environment are drawn from."""

    solver: Solver  # with the nominal parameters, around which the law draws
    layout: Layout
    reference: str | Mapping[str, Any]
    law: Law
    sensors: Sensors
    duration: float  # [s]
    reference_rows: int = 0  # of the table of a reference that was drawn as a trial
    reference_columns: int = 0  # of its table: knots of its own need more

    @property
    def max_steps(self) -> int:
        """Control steps of an episode."""
        return max(round(self.duration / self.solver.control_period), 1)

    def sensor_draw(self, sensors: Sensors) -> SensorDraw:
        """The draw of these sensors, biases without their signs."""
        return sensor_draw(sensors, self.solver.control_period, self.layout.channels)

    def make_reference(
        self, spec: str | Mapping[str, Any], rng: np.random.Generator, nominal: PlantParameters
    ) -> ReferenceProfile:
        """A reference. Raises ValueError, also for one without the goal that is shown."""
        profile = make_reference(self.written(spec), self.duration, rng, nominal)
        if any(group.goal for group in self.layout.parts) and not profile.knots.size:
            raise ValueError(
                "observation group 'goal': the reference has no goal; must be of the kind "
                '"plan": reference={"kind": "plan", "goals": "halton"}'
            )
        return profile

    def written(self, spec: Any) -> Any:
        """A reference, whose numbers are for the environment's vehicle where others are drawn."""
        its_own = not isinstance(spec, Mapping) or spec.get("kind") == PLAN
        if its_own or not draws_vehicles(self.law):
            return spec
        return {"vehicle": self.solver.nominal, **spec}

    def draw_truth(
        self, rng: np.random.Generator, profile: ReferenceProfile, nominal: PlantParameters
    ) -> Draw:
        """The truth of one episode by the law, as a function of Python."""
        return self.law(rng, nominal, profile, self.duration)


def make_settings(config: EnvConfig, solver: Solver, layout: Layout) -> EpisodeSettings:
    """Check what the episodes of an environment are drawn from. Raises ValueError."""
    law = make_uncertainty(config.uncertainty, solver.reads)
    sheet = make_sensors(config.sensors, torque_limit=solver.nominal.torque_limit)
    duration = checked_number("duration", config.duration, DURATION_RANGE)
    settings = EpisodeSettings(solver, layout, config.reference, law, sheet, duration)
    settings = settings._replace(reference=settings.written(config.reference))
    rng = np.random.default_rng(0)
    profile = settings.make_reference(config.reference, rng, solver.nominal)
    if isinstance(law, CheckedLaw):  # an error in a user's law shows here
        settings.draw_truth(rng, profile, solver.nominal)
    rows, columns = profile.table.shape
    return settings._replace(reference_rows=rows, reference_columns=columns)


class Overrides(NamedTuple):
    """What stands in the place of draws by kernels; None: they draw it.

    First what the options of a reset say, then what Python has drawn.
    """

    parameters: Mapping[str, float]
    reference: ReferenceProfile | None
    sensors: SensorDraw | None  # biases without their signs
    start: NDArray[np.float64]  # (5,) in the order of START_RANGES, NaN: as it is drawn
    terrain: int | None
    events: NDArray[np.float64] | None  # (E, 8), of the options or of `truth`
    profile: ReferenceProfile | None = None
    truth: Draw | None = None  # of a law of the user's own


def checked_overrides(
    options: Mapping[str, Any] | None,
    settings: EpisodeSettings,
    noise_seed: int,
    nominal: PlantParameters,
) -> Overrides:
    """The overrides that `options` (see OPTION_KEYS) ask for; noise_seed: of a random reference.

    nominal: the vehicle for which a reference is made.
    Raises ValueError for an unknown key and for a value outside its range.
    """
    options = checked_keys("options", options, OPTION_KEYS)
    reads, values = settings.solver.reads, {}
    for group, names in s.GROUPS.items():
        for name, value in checked_keys(f"options['{group}']", options.get(group), names).items():
            values[name] = checked_parameter(name, value)
            checked_effect("option", name, value, reads)
    sensors, events, draw = options.get("sensors"), options.get("schedule"), None
    if sensors is not None:
        limit = settings.solver.nominal.torque_limit
        draw = settings.sensor_draw(make_sensors(sensors, settings.sensors, limit))
    if events is not None:
        events = _checked_schedule(events, reads)
    start = checked_keys("options['start']", options.get("start"), START_RANGES)
    beginning = [
        checked_number(f"start {name}", start[name], allowed) if name in start else np.nan
        for name, allowed in START_RANGES.items()
    ]
    terrain, reference = options.get("terrain"), options.get("reference")
    if terrain is not None:
        terrain = _checked_terrain(terrain, settings.solver.prepared.terrains)
    if reference is not None:
        reference = settings.make_reference(reference, np.random.default_rng(noise_seed), nominal)
        columns = reference.table.shape[1]
        if columns > settings.reference_columns:
            frame = ' and "frame": "body"' if columns > COURSE_COLUMNS else ""
            raise ValueError(
                "options['reference'] is a plan, for which this environment keeps no knots: make "
                f'it with reference={{"kind": "plan", ...}}{frame}, then options may give another'
            )
    return Overrides(values, reference, draw, np.array(beginning), terrain, events)


def _checked_schedule(schedule: Any, reads: ParametersRead) -> NDArray[np.float64]:
    """Rows of a schedule whose changes the plant reads. Raises ValueError."""
    rows = encode_schedule(schedule)
    for name, target in ((s.PARAMETER_NAMES[int(row[1])], float(row[2])) for row in rows):
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
