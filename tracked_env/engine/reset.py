"""How a new episode comes into the arrays of a vehicle, and how it is read from there.

`load_episode` writes an `Episode` (options, laws of one's own); many vehicles at once are drawn and
loaded by `engine.batch_reset`. Both draw by the same laws, so the bits are the same.

`origins` (N, ORIGIN_COLUMNS) keeps where reference and vehicle began: x, y, yaw, cos, sin of the
reference, then x, y, yaw, v_x, yaw_rate of the vehicle as it is drawn.

Episodes of many vehicles at once, drawn and loaded in kernels.

`BatchReset` draws and loads the episodes of many vehicles: beginnings, references, uncertainty,
sensors, starts, noise, each in one kernel over the chosen rows, from the generators' own streams.
What only Python can draw (a reference of another kind than "random") is drawn there in its place.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from tracked_env import arrays as b
from tracked_env.engine import noise
from tracked_env.engine.episode import (
    Episode,
    EpisodeSettings,
    SensorDraw,
    draw_beginnings,
    draw_signs,
    fixed_part,
    longest_delay_steps,
    placed,
    start_beside,
)
from tracked_env.engine.noise import addresses, integer
from tracked_env.physics import parameters as s
from tracked_env.physics.jit import copy_entries, loop
from tracked_env.physics.parameters import (
    PARAMETER_NAMES,
    PARAMETER_ROWS,
    PlantParameters,
    VehicleState,
)
from tracked_env.physics.reference_profile import START as START_TIME
from tracked_env.physics.reference_profile import UNIFORM_COLUMNS
from tracked_env.plants.base import Prepared, unchanged
from tracked_env.references import ReferenceProfile, batch_reference, make_reference
from tracked_env.references.catalogue import of_table, with_knots
from tracked_env.sensors import CHANNEL_COUNT
from tracked_env.terrain.pool import RELIEF_SIZE
from tracked_env.uncertainty.drawing_laws import (
    CHANGE_FIELDS,
    CHANGES_LIMIT,
    RECORD,
    ArrayLaw,
    Draws,
    numbers,
)

ORIGIN_COLUMNS = 10
Drawn = TypeVar("Drawn")
START = 5  # first column of origins that is the vehicle's
STARTED = np.array([s.X, s.Y, s.YAW, s.V_X, s.YAW_RATE])  # entries of the state that are drawn


class Running(NamedTuple):
    """What a vehicle keeps of its episode beside the batch, one row each."""

    origins: NDArray[np.float64]  # (N, ORIGIN_COLUMNS)
    seeds: NDArray[np.int64]  # (N,) of the noise
    noise_states: NDArray[np.uint64]  # (N, noise.STATE)
    noisy: NDArray[np.bool_]  # (N,) whether random numbers are needed


def running_arrays(count: int) -> Running:
    """Zeroed arrays of `count` vehicles."""
    return Running(
        np.zeros((count, ORIGIN_COLUMNS)),
        np.zeros(count, dtype=np.int64),
        np.zeros((count, noise.STATE), dtype=np.uint64),
        np.zeros(count, dtype=np.bool_),
    )


def generators(
    rngs: Sequence[np.random.Generator | None], chosen: NDArray[np.int64]
) -> list[np.random.Generator]:
    """The random streams of the chosen vehicles. Raises ValueError where there is none."""
    found = []
    for i in chosen.tolist():
        rng = rngs[i]
        if rng is None:
            raise ValueError(f"vehicle {i} has no random stream: call reset(seed=...) first")
        found.append(rng)
    return found


def states_of(rngs: Sequence[np.random.Generator]) -> list[tuple[Any, Any]]:
    """Bit generators and their states, to be put back."""
    return [(rng.bit_generator, rng.bit_generator.state) for rng in rngs]


def each_drawn(
    draw: Callable[[int], Drawn],
    before: Sequence[tuple[Any, Any]],
    chosen: NDArray[np.int64],
    batch: b.Batch,
) -> list[Drawn]:
    """draw(k) for the k-th chosen vehicle.

    Where one raises ValueError, all generators are as `before` (`states_of`) and the message names
    the vehicle.
    """
    drawn = []
    for k, i in enumerate(chosen):
        try:
            drawn.append(draw(k))
        except ValueError as error:
            for generator, state in before:
                generator.state = state
            where = f"vehicle {i}: " if len(batch.floats) > 1 else ""
            raise ValueError(f"{where}{error}") from error
    return drawn


def write_profile(batch: b.Batch, i: int, profile: ReferenceProfile) -> None:
    """Write a reference into the arrays of vehicle i."""
    if batch.profile.shape[2] == UNIFORM_COLUMNS:
        batch.profile[:, i, :6], batch.profile[:, i, 6:] = profile.speed, profile.yaw_rate
        return
    table = with_knots(profile, batch.profile.shape[2])
    batch.profile[: len(table), i] = table
    batch.profile[len(table) :, i] = 0.0
    batch.profile[len(table) :, i, START_TIME] = np.inf


def with_rows(batch: b.Batch, profiles: Sequence[ReferenceProfile]) -> b.Batch:
    """The batch with room for the rows of these references."""
    own = batch.profile
    if own.shape[2] == UNIFORM_COLUMNS:
        return batch
    rows = max(len(profile.speed) + (not profile.knots.size) for profile in profiles)
    if rows <= len(own):
        return batch
    more = np.zeros((rows, *own.shape[1:]))
    more[: len(own)], more[len(own) :, :, START_TIME] = own, np.inf
    return batch._replace(profile=more)


def fitted(batch: b.Batch, events: int, delay: int, control_period: float) -> b.Batch:
    """The batch with room for so many events and control steps of delay."""
    if events > batch.events.shape[1]:
        wider = np.zeros((batch.events.shape[0], events, b.EVENT_FIELDS))
        wider[:, : batch.events.shape[1]] = batch.events
        batch = batch._replace(events=wider)
    if delay >= batch.history.shape[1]:
        # The ring is indexed by step modulo its length: refill it from the latest samples.
        slots = longest_delay_steps(control_period) + 1
        history = np.empty((batch.history.shape[0], slots, b.DELIVERED_COUNT))
        history[:] = batch.floats[:, None, b.SAMPLE : b.SAMPLE + b.DELIVERED_COUNT]
        batch = batch._replace(history=history)
    return batch


def load_episode(
    batch: b.Batch, running: Running, i: int, episode: Episode, settings: EpisodeSettings
) -> None:
    """Write an episode into the arrays of vehicle i."""
    f, c, sensors = batch.floats[i], batch.counters[i], episode.sensors
    f[:], c[:] = fresh_row(f.size, sensors), fresh_counters(sensors, settings.max_steps)
    if episode.relief:
        first = settings.relief_column
        f[first : first + RELIEF_SIZE] = episode.relief
    if settings.relief_column:
        f[settings.relief_column + RELIEF_SIZE] = episode.terrain
    batch.base()[i] = batch.parameters()[i] = episode.parameters
    write_profile(batch, i, episode.profile)
    running.origins[i, :START] = pose(*episode.profile[2:5])
    running.origins[i, START:] = f[b.STATE + STARTED] = np.array(episode.state)[STARTED]
    f[b.REFERENCE_X : b.REFERENCE_X + START] = running.origins[i, :START]
    c[b.EVENT_COUNT] = len(episode.events)
    batch.events[i, : len(episode.events)] = episode.events
    running.seeds[i], running.noisy[i] = episode.noise_seed, sensors.noisy
    noise.seed_state(running.noise_states[i], episode.noise_seed)
    if sensors.noisy:
        noise.draw_block(batch.noise, running.noise_states, i)


def load_each(
    batch: b.Batch,
    running: Running,
    chosen: NDArray[np.int64],
    drawn: Sequence[Episode],
    settings: EpisodeSettings,
) -> b.Batch:
    """Write an episode for each chosen vehicle; returns the batch, with more room where needed."""
    events = max(len(episode.events) for episode in drawn)
    delay = max(int(episode.sensors.delay.max()) for episode in drawn)
    batch = fitted(batch, events, delay, settings.control_period)
    batch = with_rows(batch, [episode.profile for episode in drawn])
    for i, episode in zip(chosen.tolist(), drawn, strict=True):
        load_episode(batch, running, i, episode, settings)
    return batch


def complete_starts(
    batch: b.Batch,
    chosen: NDArray[np.int64],
    prepared: Prepared,
) -> None:
    """Let the plant complete the states that were drawn, where it has a say."""
    start, ground = prepared.start, prepared.ground
    if ground is not None:
        ground.place(batch.floats, chosen)
        return
    if start is unchanged:
        return
    parameters, states = batch.base(), batch.state()
    for i in chosen.tolist():
        drawn = VehicleState(*states[i].tolist())
        states[i] = start(PlantParameters(*parameters[i].tolist()), drawn)


class Episodes(Sequence[Episode | None]):
    """The truth of the episode of every vehicle, None before its first.

    given: those that were loaded from an Episode. Others are read from the arrays, with `sensors`,
    and kept there, so that an episode is one object until the next one begins.
    """

    def __init__(
        self,
        batch: b.Batch,
        running: Running,
        given: list[Episode | None],
        sensors: SensorDraw | None,
        relief_column: int,
    ) -> None:
        self._batch, self._running, self._given, self._sensors = batch, running, given, sensors
        self._relief = slice(relief_column, relief_column + (RELIEF_SIZE if relief_column else 0))
        self._terrain = relief_column + RELIEF_SIZE if relief_column else None

    def __len__(self) -> int:
        return len(self._given)

    def __getitem__(self, i: Any) -> Any:
        if isinstance(i, slice):
            return [self[k] for k in range(*i.indices(len(self)))]
        batch, origins, given = self._batch, self._running.origins, self._given[i]
        if given is not None or self._sensors is None or batch.counters[i, b.MAX_STEP] == 0:
            return given
        x, y, yaw, v_x, yaw_rate = origins[i, START:].tolist()
        relief = batch.floats[i, self._relief]
        self._given[i] = Episode(
            PlantParameters(*batch.base()[i].tolist()),
            batch.events[i, : batch.counters[i, b.EVENT_COUNT]].copy(),
            of_table(batch.profile[:, i], *origins[i, :3].tolist()),
            self._sensors._replace(bias=batch.floats[i, b.BIAS : b.BIAS + CHANNEL_COUNT].copy()),
            VehicleState(x, y, yaw, v_x, yaw_rate=yaw_rate),
            int(self._running.seeds[i]),
            tuple(relief.tolist()) if relief.any() else (),
            0 if self._terrain is None else int(batch.floats[i, self._terrain]),
        )
        return self._given[i]


def pose(x: float, y: float, yaw: float) -> tuple[float, ...]:
    """x, y, yaw, cos, sin where a reference begins."""
    return x, y, yaw, np.cos(yaw), np.sin(yaw)


def fresh_row(size: int, sensors: SensorDraw) -> NDArray[np.float64]:
    """The floats of a vehicle of which only the sensors are known."""
    row = np.zeros(size)
    row[b.SIGMA : b.SIGMA + CHANNEL_COUNT] = sensors.sigma
    row[b.BIAS : b.BIAS + CHANNEL_COUNT] = sensors.bias
    row[b.CROSS_COUPLING], row[b.VELOCITY] = sensors.cross_coupling, sensors.velocity
    row[b.DROPOUT : b.DROPOUT + b.GROUP_COUNT] = sensors.dropout
    if sensors.outage:
        row[b.OUTAGE : b.OUTAGE + len(sensors.outage)] = sensors.outage
    return row


def fresh_counters(sensors: SensorDraw, max_steps: int) -> NDArray[np.int64]:
    """The counters of a vehicle at the start of an episode without events."""
    row = np.zeros(b.COUNTER_COLUMNS, dtype=np.int64)
    row[b.PERIOD : b.PERIOD + b.GROUP_COUNT] = sensors.period
    row[b.DELAY : b.DELAY + b.GROUP_COUNT] = sensors.delay
    row[b.MAX_STEP] = max_steps
    row[b.OUTAGE_FROM] = 0 if sensors.outage else -1
    return row


@loop
def _write_pose(origins, chosen, pose):
    """Let the references of the chosen vehicles begin at pose (START,)."""
    for k in range(chosen.size):
        copy_entries(pose, origins[chosen[k]])


@loop
def _load(
    rngs, chosen, draws, origins, truths, changes, counts, length, row, clocks,
    floats, counters, profile, events, block, states, seeds, noisy, needed, reliefs, first,
    terrains,
):  # fmt: skip
    """Load the chosen vehicles: sensors, parameters, reference, start, events, noise, relief.

    draws (N, 4) behind the starts; length l [m]; row, clocks: of `fresh_row`, `fresh_counters`;
    needed: whether there is noise; first: column of the relief, or 0; terrains: of which one is
    drawn. Returns the largest number of events, which are not written where there is no room for
    them.
    """
    most = 0
    for k in range(chosen.size):
        i = chosen[k]
        copy_entries(row, floats[i])
        copy_entries(clocks, counters[i])
        draw_signs(rngs[k], floats[i, b.BIAS : b.BIAS + CHANNEL_COUNT])
        for p in range(PARAMETER_ROWS):
            floats[i, b.BASE + p] = floats[i, b.PARAMETERS + p] = truths[i, p]
        for j in range(START):
            floats[i, b.REFERENCE_X + j] = origins[i, j]
        drawn = start_beside(draws[i], length, profile[0, i, 0], profile[0, i, 6])
        x, y, yaw = placed(origins[i], drawn[0], drawn[1], drawn[2])
        start = (x, y, yaw, drawn[3], drawn[4])
        for j in range(len(start)):
            origins[i, START + j] = start[j]
            floats[i, b.STATE + STARTED[j]] = start[j]
        if first > 0:
            copy_entries(reliefs[i], floats[i, first:])
            floats[i, first + RELIEF_SIZE] = integer(rngs[k], terrains)
        counters[i, b.EVENT_COUNT] = counts[i]
        if counts[i] <= events.shape[1]:
            for n in range(counts[i]):
                copy_entries(changes[i, n, : b.EVENT_FIELDS], events[i, n])
        most = max(most, counts[i])
        noise.seed_state(states[i], seeds[i])
        noisy[i] = needed
        if needed:
            noise.draw_block(block, states, i)
    return most


class BatchReset:
    """Draws and loads episodes of many vehicles of N; the law of `settings` is an ArrayLaw."""

    def __init__(self, settings: EpisodeSettings, batch: b.Batch) -> None:
        count, width = batch.floats.shape
        law = settings.law
        assert isinstance(law, ArrayLaw)
        self._law, self._settings = law, settings
        found = batch_reference(settings.reference, settings.nominal)
        self._reference = None if found is None else found[0]
        self._pose = np.array(pose(*(found[1] if found else (0.0, 0.0, 0.0))))
        self.sensors = fixed_part(settings.sensors, settings.control_period, settings.channels)
        self._read = np.array([name in settings.reads.names for name in PARAMETER_NAMES])
        self._nominal = np.array([tuple(settings.nominal)], dtype=RECORD)
        self._truths = np.zeros(count, dtype=RECORD)
        self._numbers = numbers(self._truths)
        self._changes = np.zeros((count, CHANGES_LIMIT, CHANGE_FIELDS))
        self._counts = np.zeros(count, dtype=np.int64)
        self._reliefs = np.zeros((count, RELIEF_SIZE))
        self._starts = np.zeros((count, 4))
        self._row = fresh_row(width, self.sensors)
        self._clocks = fresh_counters(self.sensors, settings.max_steps)
        self._delay = int(self.sensors.delay.max())
        self._known: list[np.random.Generator | None] = [None] * count
        self._addresses = np.zeros(count, dtype=np.int64)  # of those that are known

    def load(
        self,
        rngs: Sequence[np.random.Generator],
        chosen: NDArray[np.int64],
        batch: b.Batch,
        running: Running,
        share: Callable[[Callable[[int, int], int], int], list[int]],
    ) -> b.Batch:
        """Draw and load an episode of each chosen vehicle from its generator.

        share: (function, size) -> results of function(first, last) for shares of `size` vehicles,
        see `Threads.run`. No two vehicles have the same generator, so that all shares may be drawn
        at the same time. Returns the batch, with more room where that was needed. Raises ValueError
        as `make_reference` does, before any vehicle is touched.
        """
        settings, streams = self._settings, self._streams(rngs, chosen)
        batch = fitted(batch, 0, self._delay, settings.control_period)
        if self._reference is None:
            batch = self._draw_references(rngs, streams, chosen, batch, running)

        def load(first: int, last: int) -> int:
            own = slice(first, last)
            return self._load_share(streams[own], chosen[own], batch, running)

        most = max(share(load, chosen.size))
        if most > batch.events.shape[1]:
            batch = fitted(batch, most, self._delay, settings.control_period)
            for i in chosen:
                own = slice(0, self._counts[i])
                batch.events[i, own] = self._changes[i, own, : b.EVENT_FIELDS]
        return batch

    def _streams(
        self, rngs: Sequence[np.random.Generator], chosen: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Addresses of the generators `rngs`; to ask one for it takes longer than a draw."""
        for i, rng in zip(chosen.tolist(), rngs, strict=True):
            if self._known[i] is not rng:
                self._known[i], self._addresses[i] = rng, addresses([rng])[0]
        return self._addresses[chosen]

    def _load_share(
        self,
        streams: NDArray[np.int64],
        chosen: NDArray[np.int64],
        batch: b.Batch,
        running: Running,
    ) -> int:
        """Some of the chosen vehicles; returns the largest number of events of one."""
        settings, origins = self._settings, running.origins
        if self._reference is not None:
            draw_beginnings(streams, chosen, running.seeds, self._starts)
            self._reference.fill(streams, chosen, batch.profile)
            _write_pose(origins, chosen, self._pose)
        self._law.fill(
            Draws(
                streams, chosen, self._nominal, batch.profile, origins, settings.duration,
                self._truths, self._changes, self._counts, self._read, self._reliefs,
            )
        )  # fmt: skip
        most: int = _load(
            streams, chosen, self._starts, origins, self._numbers, self._changes, self._counts,
            settings.nominal.contact_length, self._row, self._clocks, batch.floats, batch.counters,
            batch.profile, batch.events, batch.noise, running.noise_states, running.seeds,
            running.noisy, self.sensors.noisy, self._reliefs, settings.relief_column,
            settings.terrains,
        )  # fmt: skip
        return most

    def _draw_references(
        self,
        rngs: Sequence[np.random.Generator],
        streams: NDArray[np.int64],
        chosen: NDArray[np.int64],
        batch: b.Batch,
        running: Running,
    ) -> b.Batch:
        """Beginnings and references, where only Python can draw these. Raises ValueError.

        Returns the batch, with more room where references need it.
        """
        settings, before = self._settings, states_of(rngs)
        seeds, starts = np.empty(chosen.size, dtype=np.int64), np.empty((chosen.size, 4))
        draw_beginnings(streams, np.arange(chosen.size), seeds, starts)
        profiles = each_drawn(
            lambda k: make_reference(
                settings.reference, settings.duration, rngs[k], settings.nominal
            ),
            before, chosen, batch,
        )  # fmt: skip
        batch = with_rows(batch, profiles)
        running.seeds[chosen], self._starts[chosen] = seeds, starts
        for i, profile in zip(chosen, profiles, strict=True):
            write_profile(batch, i, profile)
            running.origins[i, :START] = pose(*profile[2:5])
        return batch
