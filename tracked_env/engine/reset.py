"""How new episodes come into the arrays of a batch, and how they are read from there.

`EpisodeLoader.load` draws and loads the episodes of the chosen vehicles, one or many, in this
order: beginnings, nominal vehicles, references, uncertainty, sensors, starts, noise. Kernels draw
from the generators of the vehicles and write whole shares of the batch. What only Python can draw
(a reference of another kind than "random", a law of the user's own) is drawn before, and what
options put in the place of draws is written where it belongs: before the start for a reference,
behind the kernel for a schedule. Whatever can fail comes before any vehicle is touched; then the
generators are put back.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env import arrays as b
from tracked_env import streams
from tracked_env.arrays import RELIEF_SIZE
from tracked_env.engine.episode import Episode, EpisodeSettings, Overrides, checked_overrides
from tracked_env.events import encode_schedule
from tracked_env.physics import parameters as s
from tracked_env.physics.jit import bound, copy_entries, loop
from tracked_env.physics.reference_profile import START as START_TIME
from tracked_env.physics.reference_profile import UNIFORM_COLUMNS
from tracked_env.plants import Prepared, unchanged
from tracked_env.references import ReferenceProfile, batch_reference
from tracked_env.references.catalogue import draw_paths, scale_limits
from tracked_env.references.profile import of_table, with_knots
from tracked_env.references.specification import written_limits
from tracked_env.sensors import CHANNEL_COUNT, TABLE, SensorDraw, longest_delay_steps
from tracked_env.uncertainty import ArrayLaw
from tracked_env.uncertainty import drawing_laws as laws

START_OFFSET = 0.15  # [-] of the nominal contact length, to either side
START = 5  # first column of origins that is the vehicle's
STARTED = np.array([s.X, s.Y, s.YAW, s.V_X, s.YAW_RATE])  # entries of the state that are drawn
ORIGIN_COLUMNS = START + len(STARTED)
_BIASED = np.array([column for column, channel in enumerate(TABLE) if channel.bias])
_TORQUES = b.SIGMA + CHANNEL_COUNT - 2  # noise of both torques, the last channels


class Running(NamedTuple):
    """What a vehicle keeps of its episode beside the batch, one row each."""

    # x, y, yaw, cos, sin where the reference began, then x, y, yaw, v_x, yaw_rate of the vehicle
    origins: NDArray[np.float64]  # (N, ORIGIN_COLUMNS)
    seeds: NDArray[np.int64]  # (N,) of the noise
    noise_states: NDArray[np.uint64]  # (N, streams.STATE)
    noisy: NDArray[np.bool_]  # (N,) whether random numbers are needed
    nominals: NDArray[np.void]  # (N,) of `drawing_laws.RECORD`, around which laws draw


def running_arrays(count: int, nominal: s.PlantParameters) -> Running:
    """Zeroed arrays of `count` vehicles, all with this nominal one."""
    return Running(
        np.zeros((count, ORIGIN_COLUMNS)),
        np.zeros(count, dtype=np.int64),
        np.zeros((count, streams.STATE), dtype=np.uint64),
        np.zeros(count, dtype=np.bool_),
        np.full(count, np.array(tuple(nominal), dtype=laws.RECORD)),
    )


class Drawn(NamedTuple):
    """What was drawn for the vehicles of a batch, before it is loaded."""

    seeds: NDArray[np.int64]  # (N,) of the noise
    offsets: NDArray[np.float64]  # (N, 4) in [-1, 1), behind the start
    fixed_starts: NDArray[np.float64]  # (N, 5) of options, NaN: as it is drawn
    truths: NDArray[np.float64]  # (N, s.PARAMETER_ROWS)
    changes: NDArray[np.float64]  # (N, CHANGES_LIMIT, CHANGE_FIELDS)
    counts: NDArray[np.int64]  # (N,) of the changes
    reliefs: NDArray[np.float64]  # (N, RELIEF_SIZE)


class Fresh(NamedTuple):
    """Rows of vehicles of which only the sensors are known: one for all, or one each."""

    floats: NDArray[np.float64]  # (1 or M, columns)
    counters: NDArray[np.int64]  # (1 or M, COUNTER_COLUMNS)
    noisy: NDArray[np.bool_]  # (1 or M,) whether random numbers are needed


@loop
def _draw_beginnings(rngs, rows, seeds, offsets):
    """What comes before all else: seeds (N,) of the noise, offsets (N, 4) behind the start."""
    for k in range(rngs.size):
        seeds[rows[k]] = streams.seed(rngs[k])
        for j in range(offsets.shape[1]):
            offsets[rows[k], j] = streams.uniform(rngs[k], -1.0, 1.0)


@loop
def _load(rngs, vehicles, drawn, fresh, constants, running, batch):
    """Load the chosen vehicles: sensors, parameters, reference, start, events, noise, relief.

    constants: error limit [m], contact length [m] and torque limit [N m] of the environment's
    vehicle, column of the relief or 0, number of terrains. Of a vehicle that was drawn, the error
    limit is in proportion to its length and the torque noise to its torque limit.
    """
    floats, counters, profile, events = batch.floats, batch.counters, batch.profile, batch.events
    error_limit, usual_length, usual_torque, relief_column, terrains = constants
    start = np.empty(START)
    for k in range(vehicles.size):
        i, row = vehicles[k], min(k, fresh.floats.shape[0] - 1)
        copy_entries(fresh.floats[row], floats[i])
        copy_entries(fresh.counters[row], counters[i])
        length = running.nominals[i].contact_length
        floats[i, b.ERROR_LIMIT] = error_limit * (length / usual_length)
        for n in range(_TORQUES, _TORQUES + 2):
            floats[i, n] *= running.nominals[i].torque_limit / usual_torque
        for n in range(_BIASED.size):  # also of zero biases: keeps the stream aligned
            if streams.random(rngs[k]) < 0.5:
                floats[i, b.BIAS + _BIASED[n]] = -floats[i, b.BIAS + _BIASED[n]]
        for p in range(s.PARAMETER_ROWS):
            floats[i, b.BASE + p] = floats[i, b.PARAMETERS + p] = drawn.truths[i, p]
        origin = running.origins[i]
        for j in range(START):
            floats[i, b.REFERENCE_X + j] = origin[j]
        offsets, fixed = drawn.offsets[i], drawn.fixed_starts[i]
        start[0] = START_OFFSET * length * offsets[0]
        start[1] = START_OFFSET * length * offsets[1]
        start[2], start[4] = 0.1 * offsets[2], profile[0, i, 6]
        start[3] = profile[0, i, 0] * (1.0 + 0.2 * offsets[3])
        for j in range(START):
            start[j] = start[j] if np.isnan(fixed[j]) else fixed[j]
        x, y = start[0], start[1]
        start[0] = origin[0] + origin[3] * x - origin[4] * y
        start[1] = origin[1] + origin[4] * x + origin[3] * y
        start[2] = origin[2] + start[2]
        for j in range(START):
            origin[START + j] = floats[i, b.STATE + STARTED[j]] = start[j]
        if relief_column > 0:
            copy_entries(drawn.reliefs[i], floats[i, relief_column:])
            floats[i, relief_column + RELIEF_SIZE] = streams.integer(rngs[k], terrains)
        counters[i, b.EVENT_COUNT] = drawn.counts[i]
        for n in range(drawn.counts[i]):
            copy_entries(drawn.changes[i, n, : b.EVENT_FIELDS], events[i, n])
        running.seeds[i], running.noisy[i] = drawn.seeds[i], fresh.noisy[row]
        streams.seed_state(running.noise_states[i], drawn.seeds[i])
        if running.noisy[i]:
            streams.draw_block(batch.noise, running.noise_states, i)


def _pose(x: float, y: float, yaw: float) -> tuple[float, ...]:
    return x, y, yaw, np.cos(yaw), np.sin(yaw)


class EpisodeLoader:
    """Draws and loads episodes of the vehicles of a batch of N."""

    def __init__(self, settings: EpisodeSettings, batch: b.Batch) -> None:
        count, width = batch.floats.shape
        self._settings, solver = settings, settings.solver
        self._law = settings.law if isinstance(settings.law, ArrayLaw) else None
        # A law of the user's own reads the reference in Python: then it is drawn there, too.
        paths = batch_reference(settings.reference, solver.nominal) if self._law else None
        self._paths = paths and paths[0]._replace(limits=np.tile(paths[0].limits, (count, 1)))
        self._origin = np.zeros(ORIGIN_COLUMNS)
        self._origin[:START] = _pose(*(paths[1] if paths else (0.0, 0.0, 0.0)))
        self.sensors = settings.sensor_draw(settings.sensors)
        self._delay = int(self.sensors.delay.max())
        self._fresh = _fresh([self.sensors], width, settings.max_steps)
        self._read = np.array([name in solver.reads.names for name in s.PARAMETER_NAMES])
        self._draw_vehicles = getattr(settings.law, "vehicles", None)
        if self._draw_vehicles is not None and paths is not None:
            limits, others, interval = written_limits(settings.reference)
            records = np.array([tuple(each) for each in others], dtype=laws.RECORD)
            self._written = limits, records, interval
        self._truths = np.zeros(count, dtype=laws.RECORD)
        self._drawn = Drawn(
            np.zeros(count, dtype=np.int64),
            np.zeros((count, 4)),
            np.full((count, START), np.nan),
            laws.numbers(self._truths),
            np.zeros((count, laws.CHANGES_LIMIT, laws.CHANGE_FIELDS)),
            np.zeros(count, dtype=np.int64),
            np.zeros((count, RELIEF_SIZE)),
        )
        self._relief_column = solver.plant.relief_column
        nominal, terrains = solver.nominal, solver.prepared.terrains
        usual = solver.error_limit, nominal.contact_length, nominal.torque_limit
        self._constants = *usual, self._relief_column, terrains
        self._generators: list[np.random.Generator | None] = [None] * count
        self._addresses = np.zeros(count, dtype=np.int64)  # of `_generators`
        self._kernel: Callable[..., None] | None = None  # `_load`, bound
        self._fill: Callable[[laws.Draws], None] | None = None  # of the law, likewise

    def load(
        self,
        rngs: Sequence[np.random.Generator],
        vehicles: NDArray[np.int64],
        options: Sequence[Mapping[str, Any] | None] | None,
        batch: b.Batch,
        running: Running,
        share: Callable[[Callable[[int, int], None], int], Any],
    ) -> tuple[b.Batch, dict[int, Episode]]:
        """Draw and load an episode of each chosen vehicle from its generator.

        share: (function, size) calls function(first, last) for shares of `size` vehicles, see
        `Threads.run`. No two vehicles have the same generator, so that all shares may be drawn
        at the same time. Returns the batch, with more room where that was needed, and the episodes
        of vehicles with options. Raises ValueError as `checked_overrides` and `make_reference` do,
        before any vehicle is touched.
        """
        drawn, addresses = self._drawn, self._streams(rngs, vehicles)
        options = options if options and any(options) else None
        special: list[Overrides] = []  # of every chosen vehicle, or none
        if options is None and self._paths is not None:
            _draw_beginnings(addresses, vehicles, drawn.seeds, drawn.offsets)
            self._draw_nominals(addresses, vehicles, running)
        else:
            special = self._draw_in_python(rngs, addresses, vehicles, options, running)
        sensors, fresh, delay = [self.sensors], self._fresh, self._delay
        if options is not None:
            sensors = [one.sensors or self.sensors for one in special]
            fresh = _fresh(sensors, batch.floats.shape[1], self._settings.max_steps)
            delay = max(int(one.delay.max()) for one in sensors)
        batch = self._fitted(batch, special, delay)

        def load(first: int, last: int) -> None:
            rows, its = slice(first, last), fresh
            if options is not None:
                its = Fresh(fresh.floats[rows], fresh.counters[rows], fresh.noisy[rows])
            self._load_share(addresses[rows], vehicles[rows], its, special[rows], batch, running)

        share(load, vehicles.size)
        episodes = {}
        for k, one in enumerate(special):
            i = int(vehicles[k])
            if one.events is not None:
                batch.events[i, : len(one.events)] = one.events
                batch.counters[i, b.EVENT_COUNT] = len(one.events)
            if one.terrain is not None:
                batch.floats[i, self._relief_column + RELIEF_SIZE] = one.terrain
            if options is not None and options[k]:
                episode = self.read(i, batch, running, sensors[k])
                episodes[i] = episode._replace(profile=one.reference or episode.profile)
        return batch, episodes

    def _streams(
        self, rngs: Sequence[np.random.Generator], vehicles: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Addresses of the generators `rngs`; to ask one for it takes longer than a draw."""
        for i, rng in zip(vehicles.tolist(), rngs, strict=True):
            if self._generators[i] is not rng:
                self._generators[i], self._addresses[i] = rng, streams.addresses([rng])[0]
        return self._addresses[vehicles]

    def _draw_nominals(
        self, addresses: NDArray[np.int64], vehicles: NDArray[np.int64], running: Running
    ) -> None:
        """Nominal vehicles where the law draws them, and the limits of their references."""
        if self._draw_vehicles is None:
            return
        self._draw_vehicles(addresses, vehicles, running.nominals)
        if self._paths is not None:
            scale_limits(vehicles, running.nominals, *self._written, self._paths.limits)

    def path_scales(self, vehicles: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """As `reference_scale`, (n, 3), of paths that are scaled for vehicles that were drawn."""
        if self._draw_vehicles is None or self._paths is None:
            return None
        limits, written = self._paths.limits[vehicles], self._written[0]
        sizes = np.column_stack([np.abs(limits[:, :2]).max(axis=1), limits[:, 2]])
        as_written, scales = (
            np.array([np.abs(written[:2]).max(), written[2]]),
            np.ones((len(vehicles), 3)),
        )
        np.divide(sizes, as_written, out=scales[:, :2], where=as_written > 0.0)
        return scales

    def _draw_in_python(
        self,
        rngs: Sequence[np.random.Generator],
        addresses: NDArray[np.int64],
        vehicles: NDArray[np.int64],
        options: Sequence[Mapping[str, Any] | None] | None,
        running: Running,
    ) -> list[Overrides]:
        """Beginnings, and all that can fail, of each chosen vehicle; generators as before then.

        The message of a ValueError names the vehicle.
        """
        before = [(rng.bit_generator, rng.bit_generator.state) for rng in rngs]
        nominals = running.nominals[vehicles]
        _draw_beginnings(addresses, vehicles, self._drawn.seeds, self._drawn.offsets)
        self._draw_nominals(addresses, vehicles, running)
        special = []
        for k, i in enumerate(vehicles.tolist()):
            its, nominal = options[k] if options else None, _nominal(running, i)
            try:
                special.append(self._draw_one(rngs[k], its, i, nominal))
            except ValueError as error:
                for generator, state in before:
                    generator.state = state
                running.nominals[vehicles] = nominals
                where = f"vehicle {i}: " if len(self._generators) > 1 else ""
                raise ValueError(f"{where}{error}") from error
        return special

    def _draw_one(
        self,
        rng: np.random.Generator,
        options: Mapping[str, Any] | None,
        i: int,
        nominal: s.PlantParameters,
    ) -> Overrides:
        settings, profile = self._settings, None
        overrides = checked_overrides(options, settings, int(self._drawn.seeds[i]), nominal)
        if self._paths is None:
            profile = settings.make_reference(settings.reference, rng, nominal)
        if profile is None or self._law is not None:
            return overrides._replace(profile=profile)
        truth, events = settings.draw_truth(rng, profile, nominal), overrides.events
        if events is None:
            names = settings.solver.reads.names
            events = encode_schedule([e for e in truth.events if e["parameter"] in names])
        return overrides._replace(profile=profile, truth=truth, events=events)

    def _fitted(self, batch: b.Batch, special: Sequence[Overrides], delay: int) -> b.Batch:
        """The batch with room for this delay [steps], these events and rows of references."""
        if delay >= batch.history.shape[1]:
            # The ring is indexed by step modulo its length: refill it from the latest samples.
            slots = longest_delay_steps(self._settings.solver.control_period) + 1
            latest = batch.floats[:, None, b.SAMPLE : b.SAMPLE + b.DELIVERED_COUNT]
            batch = batch._replace(history=np.repeat(latest, slots, axis=1))
        room = laws.CHANGES_LIMIT
        for one in special:
            room = max(room, 0 if one.events is None else len(one.events))
        more = room - batch.events.shape[1]
        if more > 0:
            batch = batch._replace(events=np.pad(batch.events, ((0, 0), (0, more), (0, 0))))
        if not special:
            return batch
        profiles = [p for one in special for p in (one.profile, one.reference) if p]
        rows = max((len(p.speed) + (not p.knots.size) for p in profiles), default=0)
        profile = batch.profile
        if profile.shape[2] == UNIFORM_COLUMNS or rows <= len(profile):
            return batch
        longer = np.zeros((rows, *profile.shape[1:]))
        longer[: len(profile)], longer[len(profile) :, :, START_TIME] = profile, np.inf
        return batch._replace(profile=longer)

    def _load_share(
        self,
        addresses: NDArray[np.int64],
        vehicles: NDArray[np.int64],
        fresh: Fresh,
        special: Sequence[Overrides],
        batch: b.Batch,
        running: Running,
    ) -> None:
        """Some of the chosen vehicles."""
        drawn, origins = self._drawn, running.origins
        if self._paths is not None:
            draw_paths(addresses, vehicles, batch.profile, *self._paths)
            origins[vehicles] = self._origin
        for one, i in zip(special, vehicles, strict=False):
            if one.profile is not None:
                _write_profile(batch, origins, i, one.profile)
        if self._law is not None:
            duration: Any = self._settings.duration
            begun = (running.nominals, batch.profile, origins, duration)
            results = (self._truths, drawn.changes, drawn.counts, self._read, drawn.reliefs)
            chosen: tuple[Any, ...] = (addresses, vehicles, *begun, *results)
            draws = laws.Draws(*chosen)
            if self._fill is None:  # the types are those of every call
                kernel = getattr(self._law, "kernel", None)
                self._fill = self._law.fill if kernel is None else bound(kernel, (draws,))
            self._fill(draws)
        for one, i in zip(special, vehicles, strict=False):
            if one.truth is not None:
                drawn.truths[i], drawn.counts[i] = one.truth.parameters, 0
                drawn.reliefs[i] = one.truth.relief or 0.0
            for name, value in one.parameters.items():
                drawn.truths[i, s.PARAMETER_INDEX[name]] = value
            if one.reference is not None:
                _write_profile(batch, origins, i, one.reference)
            drawn.fixed_starts[i] = one.start
        call = (addresses, vehicles, drawn, fresh, self._constants, running, batch)
        if self._kernel is None:  # likewise
            self._kernel = bound(_load, call)
        self._kernel(*call)
        if special:
            drawn.fixed_starts[vehicles] = np.nan

    def read(self, i: int, batch: b.Batch, running: Running, sensors: SensorDraw) -> Episode:
        """The truth of the episode of vehicle i, from its arrays; sensors without their signs."""
        floats, first = batch.floats[i], self._relief_column
        x, y, yaw, v_x, yaw_rate = running.origins[i, START:].tolist()
        relief = floats[first : first + (RELIEF_SIZE if first else 0)]
        return Episode(
            s.PlantParameters(*batch.base()[i].tolist()),
            batch.events[i, : batch.counters[i, b.EVENT_COUNT]].copy(),
            of_table(batch.profile[:, i], *running.origins[i, :3].tolist()),
            sensors._replace(bias=floats[b.BIAS : b.BIAS + CHANNEL_COUNT].copy()),
            s.VehicleState(x, y, yaw, v_x, yaw_rate=yaw_rate),
            int(running.seeds[i]),
            tuple(relief.tolist()) if relief.any() else (),
            int(floats[first + RELIEF_SIZE]) if first else 0,
        )


def _nominal(running: Running, i: int) -> s.PlantParameters:
    return s.PlantParameters(*running.nominals[i].item())


def _fresh(sensors: Sequence[SensorDraw], width: int, max_steps: int) -> Fresh:
    floats = np.zeros((len(sensors), width))
    counters = np.zeros((len(sensors), b.COUNTER_COLUMNS), dtype=np.int64)
    counters[:, b.MAX_STEP] = max_steps
    for row, clock, one in zip(floats, counters, sensors, strict=True):
        row[b.SIGMA : b.SIGMA + CHANNEL_COUNT] = one.sigma
        row[b.BIAS : b.BIAS + CHANNEL_COUNT] = one.bias
        row[b.CROSS_COUPLING], row[b.VELOCITY] = one.cross_coupling, one.velocity
        row[b.DROPOUT : b.DROPOUT + b.GROUP_COUNT] = one.dropout
        row[b.OUTAGE : b.OUTAGE + len(one.outage)] = one.outage
        clock[b.PERIOD : b.PERIOD + b.GROUP_COUNT] = one.period
        clock[b.DELAY : b.DELAY + b.GROUP_COUNT] = one.delay
        clock[b.OUTAGE_FROM] = 0 if one.outage else -1
    return Fresh(floats, counters, np.array([one.noisy for one in sensors]))


def _write_profile(
    batch: b.Batch, origins: NDArray[np.float64], i: int, profile: ReferenceProfile
) -> None:
    """Write a reference and its pose into the arrays of vehicle i."""
    origins[i, :START] = _pose(profile.x, profile.y, profile.yaw)
    if batch.profile.shape[2] == UNIFORM_COLUMNS:
        batch.profile[:, i, :6], batch.profile[:, i, 6:] = profile.speed, profile.yaw_rate
        return
    table = with_knots(profile, batch.profile.shape[2])
    batch.profile[: len(table), i] = table
    batch.profile[len(table) :, i] = 0.0
    batch.profile[len(table) :, i, START_TIME] = np.inf


def complete_starts(batch: b.Batch, vehicles: NDArray[np.int64], prepared: Prepared) -> None:
    """Let the plant complete the states that were drawn, where it has a say."""
    start, ground = prepared.start, prepared.ground
    if ground is not None:
        ground.place(batch.floats, vehicles)
    elif start is not unchanged:
        parameters, states = batch.base(), batch.state()
        for i in vehicles.tolist():
            drawn = s.VehicleState(*states[i].tolist())
            states[i] = start(s.PlantParameters(*parameters[i].tolist()), drawn)
