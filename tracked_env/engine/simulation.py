"""The simulation core: N vehicles, each with its own random stream, stepped together.

`Simulation` owns the arrays and knows how an episode starts (draw reference, uncertainty,
sensors, start; or take them from options) and how a control step runs. `env.py` is this core
with N = 1, `vector_env.py` with N; neither holds an equation.

Streams: vehicle i draws from its own generator. Its episode draws come in a fixed order and
its sensor noise from a generator of its own, seeded by the episode: what a policy does never
changes what the vehicle, the soil, the reference and the noise are.

A function over many rows, on several threads. Kernels release the interpreter lock.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from tracked_env import arrays as b
from tracked_env import observation as obs
from tracked_env.arrays import Readings
from tracked_env.engine import noise
from tracked_env.engine.env_config import EnvConfig, make_solver
from tracked_env.engine.episode import Episode, draw_episode, make_settings
from tracked_env.engine.extra_groups import Composer
from tracked_env.engine.reset import (
    BatchReset,
    Episodes,
    complete_starts,
    each_drawn,
    generators,
    load_each,
    running_arrays,
    states_of,
)
from tracked_env.physics.jit import bound
from tracked_env.physics.parameters import Range
from tracked_env.step import CALM, SOME_ENDED, Clock
from tracked_env.uncertainty import ArrayLaw
from tracked_env.validation import checked_whole


class Threads:
    """Runs a function over equal shares of the rows; threads start with the first run."""

    def __init__(self, count: int) -> None:
        """count: threads, with that of the caller."""
        self.count = count
        self._pool: ThreadPoolExecutor | None = None

    @property
    def started(self) -> bool:
        """Whether there are threads beside that of the caller."""
        return self._pool is not None

    def run(self, function: Callable[[int, int], int], size: int, lanes: int = 1) -> list[int]:
        """Results of function(first, last) for shares of `size` rows, the caller's share first.

        lanes: rows that belong together; a share begins at a multiple of it.
        """
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.count - 1, "tracked_env")
        blocks = -(-size // lanes)
        share = -(-blocks // self.count) * lanes
        parts = [
            self._pool.submit(function, first, min(first + share, size))
            for first in range(share, size, share)
        ]
        return [function(0, min(share, size)), *(part.result() for part in parts)]

    def close(self) -> None:
        """End the threads; a later run starts new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None


RESETS_SHARED_FROM = 8  # [vehicles] whose resets take longer than to hand half to another thread
_RUNNING = (  # attributes that change while episodes run
    "batch", "observations", "rngs", "running", "_given", "_until_refill", "some_ended",
    "composer",
)  # fmt: skip


def checked_actions(actions: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """Actions as an array of real numbers. Raises ValueError for another shape or type."""
    try:
        actions = np.asarray(actions)
    except ValueError as error:
        raise ValueError(f"action = {actions!r:.100}; must be an array {shape}: {error}") from error
    if actions.shape != shape:
        raise ValueError(
            f"action has shape {actions.shape}; must be {shape}: sprocket torque (or speed) left, "
            "right over its limit, in [-1, 1]"
        )
    if actions.dtype.kind not in "fiub":
        raise ValueError(
            f"action = {actions.tolist()!r:.100} of type {actions.dtype}; must be real numbers in "
            "[-1, 1]. Did you pass text, None or complex numbers?"
        )
    return actions


class Simulation(Readings):
    """N vehicles. All arrays have one row per vehicle; all values are SI, angles in rad."""

    def __init__(self, count: int, config: EnvConfig) -> None:
        """Allocate `count` vehicles. Raises ValueError for a wrong argument."""
        self.count = count = checked_whole("num_envs", count, Range(1, 10**6, "-", "A count."))
        self.config = config = copy.deepcopy(config)  # what the caller changes later stays outside
        self.solver = make_solver(config)
        solver = self.solver
        self.layout = obs.make_layout(config.observation)
        self.settings = make_settings(
            config.reference, config.uncertainty, config.sensors, config.duration,
            solver.control_period, solver.nominal, solver.reads, self.layout.channels,
            solver.plant.relief_column, solver.prepared.terrains,
            any(group.goal for group in self.layout.parts),
        )  # fmt: skip
        self.batch = b.allocate(
            count, self.settings.reference_rows, solver.plant.columns,
            reference_columns=self.settings.reference_columns,
        )  # fmt: skip
        self.observations: NDArray[np.float32] = np.zeros((count, self.layout.size), np.float32)
        # Where the layout is not the one that the kernels write:
        self.composer: Composer | None = None
        if self.layout.groups != obs.V0.groups:
            self.composer = Composer(self.layout, count, solver.control_period)
        self.rngs: list[np.random.Generator | None] = [None] * count
        self.running = running_arrays(count)
        # Those loaded from options or a law of one's own, and those that have been read since:
        self._given: list[Episode | None] = [None] * count
        self._batch_reset: BatchReset | None = None
        if isinstance(self.settings.law, ArrayLaw):
            self._batch_reset = BatchReset(self.settings, self.batch)
        self.all = np.arange(count)
        self._action_shape = (count, 2)
        self._idle: NDArray[np.float32] = np.zeros((count, 2), dtype=np.float32)
        # Of the coming step. A kernel is compiled for the type and order of this one array.
        self.actions: NDArray[np.float32] = np.zeros((count, 2), dtype=np.float32)
        self._kernel = solver.prepared.advance
        self._threads = Threads(solver.threads)
        clock = Clock(solver.substeps, solver.substep, solver.error_limit)
        self._tail: tuple[Any, ...] = (*clock, *solver.prepared.options)
        self._ended = np.zeros(count, dtype=bool)
        self._ended_known, self._some_resting = True, True
        self._threads_from = solver.plant.threads_from if solver.threads > 1 else count + 1
        self._bound: b.Batch | None = None  # that `_call` holds
        self._all_started = False
        self._until_refill = 0
        self.some_ended = False  # by the last step

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles are built anew, without threads, and go on bit for bit."""
        running = {name: getattr(self, name) for name in _RUNNING}
        return type(self), (self.count, self.config), {**running, "_ended": self.ended}

    def _bind(self) -> None:
        """Prepare the call that moves every vehicle, and the views of what it reports of the first.

        Anew whenever `batch` is another one: after a copy, `resume`, and where arrays have grown.
        """
        out = self.observations if self.composer is None else self.composer.written
        self._call = (*self.batch, self.all, self.actions, out, 0, self.count, True, *self._tail)
        self._call_kernel = bound(self._kernel, self._call)
        self.first_report, self.first_observation = self.batch.row_report(0), self.observations[0]
        self._bound = self.batch

    # --- an episode starts ----------------------------------------------------------------
    def reset(
        self,
        chosen: NDArray[np.int64],
        options: Sequence[Mapping[str, Any] | None] | None = None,
    ) -> NDArray[np.float32]:
        """Start an episode on the chosen vehicles; options: one entry per chosen vehicle.

        Returns all observations (N, D) in the layout of the config. Everything is drawn and checked
        before any vehicle is touched, so a wrong option loses nothing, no random number either.
        Raises ValueError as `draw_episode` does.
        """
        chosen = np.asarray(chosen, dtype=np.int64)
        rngs = generators(self.rngs, chosen)
        plain = options is None or not any(given is not None and given != {} for given in options)
        if plain and self._batch_reset is not None:
            self.batch = self._batch_reset.load(
                rngs, chosen, self.batch, self.running, self._share_resets
            )
            for i in chosen.tolist():
                self._given[i] = None
        else:
            settings, given = self.settings, options or [None] * chosen.size
            drawn = each_drawn(
                lambda k: draw_episode(rngs[k], settings, given[k]),
                states_of(rngs), chosen, self.batch,
            )  # fmt: skip
            self.batch = load_each(self.batch, self.running, chosen, drawn, settings)
            for i, episode in zip(chosen.tolist(), drawn, strict=True):
                self._given[i] = episode
        complete_starts(self.batch, chosen, self.solver.prepared)
        self.ended[chosen] = False
        self._until_refill = min(self._until_refill, b.NOISE_BLOCK - 1)
        self._advance(self._idle, chosen, 0, chosen.size, False)
        if self.composer is not None:
            episodes = [self.episodes[i] for i in chosen]
            self.composer.start(
                self.batch, self.observations, chosen, episodes, self.solver.prepared.ground
            )
        return self.observations

    def _share_resets(self, function: Callable[[int, int], int], size: int) -> list[int]:
        """Results of function(first, last) for shares of `size` vehicles, or for all at once."""
        if self.count < self._threads_from or size < RESETS_SHARED_FROM:
            return [function(0, size)]
        return self._threads.run(function, size)

    # --- an episode runs ------------------------------------------------------------------
    def step(
        self, actions: NDArray[np.float32], chosen: NDArray[np.int64] | None = None
    ) -> NDArray[np.float32]:
        """Advance the chosen vehicles (default: all) by one control step.

        A vehicle whose episode has ended is stepped on unless it is left out.

        actions: (N, 2) float32, left and right sprocket torque over the torque limit, or speed
        over the speed limit, clipped to [-1, 1]. Raises ValueError for a wrong shape or type
        or a non-finite value, and ResetNeeded for a vehicle that was never reset, before moving.
        Returns all observations (N, D) in the layout of the config.
        """
        self.actions[:] = checked_actions(actions, self._action_shape)
        return self.advance(chosen)

    def advance(self, chosen: NDArray[np.int64] | None = None) -> NDArray[np.float32]:
        """The same with the actions that stand in `actions` (N, 2) float32."""
        if not self._all_started:
            self._check_started(self.all if chosen is None else chosen)
        if self.batch is not self._bound:
            self._bind()
        refill = self._until_refill <= 0
        if chosen is None and not refill and self.count < self._threads_from:
            result = self._call_kernel(*self._call)
            self._until_refill -= 1
            if result < 0:
                self._compose(self.all, 0, self.count)
        else:
            result = self._advance_chosen(self.all if chosen is None else chosen, refill)
        self.some_ended = result == SOME_ENDED
        if self.some_ended:
            self._ended_known, self._some_resting = False, True
        elif result >= 0:
            raise ValueError(
                f"action[{result}] = {self.actions[result].tolist()}; must be finite, in [-1, 1]. "
                "Did the policy diverge, or divide by zero? No vehicle was moved."
            )
        return self.observations

    def _advance_chosen(self, chosen: NDArray[np.int64], refill: bool) -> int:
        """Some of the vehicles, on one thread or several, with new noise where it is due."""
        size = chosen.size
        left = [] if refill else [self._until_refill]

        def run(first: int, last: int) -> int:
            if refill:
                left.append(self._refill(chosen[first:last]))
            result = self._advance(self.actions, chosen, first, last, True)
            if result < 0:
                self._compose(chosen, first, last)
            return result

        if size < self._threads_from:
            result = run(0, size)
        elif (result := self._refused(chosen)) == CALM:
            result = min(self._threads.run(run, size, self.solver.plant.lanes))
        self._until_refill = min(left, default=0) - 1
        return result

    def _check_started(self, chosen: NDArray[np.int64]) -> None:
        """Raise ResetNeeded when one of the chosen vehicles has no episode."""
        started = self.batch.counters[:, b.MAX_STEP] > 0
        missing = chosen[~started[chosen]]
        if missing.size:
            raise ResetNeeded(
                f"vehicle {missing[0]} has no episode ({missing.size} of {self.count} have none); "
                "call reset() before step(), and without reset_mask the first time"
            )
        self._all_started = bool(started.all())

    def _advance(
        self,
        actions: NDArray[np.float32],
        chosen: NDArray[np.int64],
        start: int,
        stop: int,
        moving: bool,
    ) -> int:
        out = self.observations if self.composer is None else self.composer.written
        return self._kernel(*self.batch, chosen, actions, out, start, stop, moving, *self._tail)

    def _compose(self, chosen: NDArray[np.int64], start: int, stop: int) -> None:
        """Observations of vehicles chosen[start:stop] in a layout that the kernels do not write."""
        if self.composer is not None:
            ground = self.solver.prepared.ground
            self.composer.write(self.batch, self.observations, chosen, start, stop, ground)

    def _refused(self, chosen: NDArray[np.int64]) -> int:
        """The first chosen vehicle with a non-finite action, before a thread moves any; or CALM."""
        if np.isfinite(self.actions).all():  # of whatever vehicle
            return CALM
        finite = np.isfinite(self.actions[chosen]).all(axis=1)
        return CALM if finite.all() else int(chosen[np.argmin(finite)])

    def _refill(self, chosen: NDArray[np.int64]) -> int:
        """Draw the next noise block of those chosen vehicles that have used up theirs.

        Returns the steps that all of them can take until then.
        """
        data, its = self.batch, self.running
        left: int = noise.refill(data.noise, data.counters, its.noise_states, its.noisy, chosen)
        return left

    def snapshot(self) -> dict[str, Any]:
        """All that changes while episodes run; can be pickled. `resume` goes on from it."""
        return copy.deepcopy({name: getattr(self, name) for name in _RUNNING})

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on from what `snapshot` returned, bit for bit; of the same count and config."""
        if len(snapshot["observations"]) != self.count:
            raise ValueError(
                f"snapshot of {len(snapshot['observations'])} vehicles; must be of {self.count}"
            )
        for name, value in copy.deepcopy(dict(snapshot)).items():
            setattr(self, name, value)
        self._ended_known, self._some_resting = False, True
        self._all_started = False  # to be looked up

    @property
    def episodes(self) -> Episodes:
        """The truth of the episode of every vehicle, made when it is asked for."""
        sensors = None if self._batch_reset is None else self._batch_reset.sensors
        first = self.settings.relief_column
        return Episodes(self.batch, self.running, self._given, sensors, first)

    def close(self) -> None:
        """Release the threads."""
        self._threads.close()
