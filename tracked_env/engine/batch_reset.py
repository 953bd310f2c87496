"""Episodes of many vehicles at once, drawn and loaded in kernels.

`BatchReset` draws and loads the episodes of many vehicles: beginnings, references, uncertainty,
sensors, starts, noise, each in one kernel over the chosen rows, from the generators' own streams.
What only Python can draw (a reference of another kind than "random") is drawn there in its place.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.engine import noise
from tracked_env.engine.episode import EpisodeSettings, draw_beginnings, placed, start_beside
from tracked_env.engine.episode_loading import (
    START,
    STARTED,
    Running,
    each_drawn,
    fitted,
    fresh_counters,
    fresh_row,
    pose,
    states_of,
    with_rows,
    write_profile,
)
from tracked_env.physics.channels import CHANNEL_COUNT
from tracked_env.physics.jit import copy_entries, loop
from tracked_env.physics.parameters import PARAMETER_NAMES, PARAMETER_ROWS
from tracked_env.references import batch_reference, make_reference
from tracked_env.sensor_draws import draw_signs, fixed_part
from tracked_env.streams import addresses, integer
from tracked_env.terrain.drawn_relief import RELIEF_SIZE
from tracked_env.uncertainty.compiled import (
    CHANGE_FIELDS,
    CHANGES_LIMIT,
    RECORD,
    ArrayLaw,
    Draws,
    numbers,
)


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
