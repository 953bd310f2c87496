"""The simulation core: N vehicles, each with its own random stream, stepped together.

`Simulation` owns the arrays: `reset` starts episodes (`engine.reset`), `step` runs the plant's
kernel of a control step (`tracked_env.step`). `env.py` is this core with N = 1, `vector_env.py`
with N; neither holds an equation.

Streams: vehicle i draws from its own generator. Its episode draws come in a fixed order and
its sensor noise from a generator of its own, seeded by the episode: what a policy does never
changes what the vehicle, the soil, the reference and the noise are.
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
from tracked_env import streams
from tracked_env.engine.env_config import EnvConfig, make_solver, self_contained
from tracked_env.engine.episode import Episode, make_settings
from tracked_env.engine.reset import EpisodeLoader, complete_starts, running_arrays
from tracked_env.physics.jit import bound
from tracked_env.physics.parameters import PARAMETER_NAMES, STATE_NAMES, PlantParameters, Range
from tracked_env.plants import NO_COMMANDS
from tracked_env.references import reference_scale
from tracked_env.step import SOME_ENDED, Clock, Rows
from tracked_env.uncertainty import draws_vehicles
from tracked_env.validation import checked_whole

RESETS_SHARED_FROM = 8  # [vehicles] whose resets take longer than to hand half to another thread
# Attributes that change while episodes run, beside the composer's:
_RUNNING = (
    *("batch", "observations", "rngs", "running", "_episodes", "_until_refill", "some_ended"),
    "reference_scale",
)


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


class Threads:
    """Runs a function over equal shares of the rows; kernels release the interpreter lock."""

    def __init__(self, count: int) -> None:
        """count: threads, with that of the caller. They start with the first run."""
        self.count = count
        self._pool: ThreadPoolExecutor | None = None

    def run(self, function: Callable[[int, int], Any], size: int, lanes: int = 1) -> list[Any]:
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


class Simulation:
    """N vehicles. All arrays have one row per vehicle; all values are SI, angles in rad.

    What is read of them between the steps is a copy.
    """

    def __init__(self, count: int, config: EnvConfig) -> None:
        """Allocate `count` vehicles. Raises ValueError for a wrong argument."""
        self.count = count = checked_whole("num_envs", count, Range(1, 10**6, "-", "A count."))
        config = copy.deepcopy(config)  # what the caller changes later stays outside
        self.solver = solver = make_solver(config)
        self.layout = obs.make_layout(config.observation)
        self.settings = make_settings(config, solver, self.layout)
        self.config = EnvConfig(**self_contained(config._asdict()))  # of copies, too
        rows, columns = self.settings.reference_rows, self.settings.reference_columns
        self._scoring: Any = None  # of a reward or costs that the kernels do not compute
        self.cost_names: tuple[str, ...] = ()  # of `costs`, the last columns of the batch
        self.cost_budget: float | None = None
        if str(config.reward) != "default" or config.costs is not None:
            from tracked_env.rewards import Scoring  # here: few environments need it

            self._scoring = Scoring(config.reward, config.costs, solver.nominal)
            self.cost_names = self._scoring.costs.names
            self.cost_budget = self._scoring.costs.budget
        own = solver.plant.columns + len(self.cost_names)
        self.batch = b.allocate(count, rows, own, columns)
        self.observations: NDArray[np.float32] = np.zeros((count, self.layout.size), np.float32)
        self.composer: Any = None  # of a layout that the kernels do not write
        if self.layout.groups != obs.V0.groups:
            from tracked_env.engine.extra_groups import Composer  # here: V0 does not need it

            ground = solver.prepared.ground
            self.composer = Composer(self.layout, count, solver.control_period, ground)
        self.rngs: list[np.random.Generator | None] = [None] * count
        self.running = running_arrays(count, solver.nominal)
        self._loader = EpisodeLoader(self.settings, self.batch)
        # Those loaded with options, and those that have been read since they began:
        self._episodes: list[Episode | None] = [None] * count
        self.all = np.arange(count)
        # Of the coming step. A kernel is compiled for the type and order of this one array.
        self.actions: NDArray[np.float32] = np.zeros((count, 2), dtype=np.float32)
        self._threads = Threads(solver.threads)
        self._threads_from = solver.plant.threads_from if solver.threads > 1 else count + 1
        self._tail = (
            Clock(solver.substeps, solver.substep),
            (NO_COMMANDS, solver.prepared.options),
        )
        # (N,) The episode has ended, and none was started since: such rows are not to be stepped.
        self.ended = np.zeros(count, dtype=bool)
        self._draws_vehicles = draws_vehicles(self.settings.law)
        scale = reference_scale(self.settings.reference, solver.nominal)
        # (N, 3) of the references, as `reference_scale` has them; replaced, never written into.
        self.reference_scale = self._usual_scale = np.tile(scale, (count, 1))
        self._bound: b.Batch | None = None  # that `_call` holds
        self._all_started = False
        self._until_refill = 0
        self.some_ended = False  # by the last step
        failures = solver.plant.failures
        # Of `info`, where a plant has more than one reason to end an episode.
        self.ending_flags = [f"ended_{n}" for n in ("off_path", *failures)] if failures else []

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles are built anew, without threads, and go on bit for bit."""
        return type(self), (self.count, self.config), self._state()

    def _state(self) -> dict[str, Any]:
        composer = None if self.composer is None else self.composer.state()
        return {**{name: getattr(self, name) for name in _RUNNING}, "composer": composer}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        if self.composer is not None:
            self.composer.resume(state["composer"])
        for name in _RUNNING:
            setattr(self, name, state[name])
        self.ended = self.terminated | self.truncated
        self._all_started = False  # to be looked up

    def _bind(self) -> None:
        """Prepare the call that moves every vehicle, and the views of what it reports of the first.

        Anew whenever `batch` is another one: after a copy, `resume`, and where arrays have grown.
        """
        self._written = self.observations if self.composer is None else self.composer.written
        rows = Rows(self.all, self.actions, self._written, 0, self.count, True)
        self._call = (self.batch, rows, *self._tail)
        self._kernel = bound(self.solver.prepared.advance, self._call)
        self.first_report, self.first_observation = self.batch.row_report(0), self.observations[0]
        self._bound = self.batch

    # --- an episode starts ----------------------------------------------------------------
    def reset(
        self, vehicles: NDArray[np.int64], options: Sequence[Mapping[str, Any] | None] | None = None
    ) -> NDArray[np.float32]:
        """Start an episode on the chosen vehicles; options: one entry per chosen vehicle.

        Returns all observations (N, D) in the layout of the config. Everything is drawn and checked
        before any vehicle is touched, so a wrong option loses nothing, no random number either.
        Raises ValueError as `EpisodeLoader.load` does, and for a vehicle without a random stream.
        """
        vehicles = np.ascontiguousarray(vehicles, dtype=np.int64)
        rngs: list[Any] = [self.rngs[i] for i in vehicles.tolist()]
        if None in rngs:
            missing = vehicles[rngs.index(None)]
            raise ValueError(f"vehicle {missing} has no random stream: call reset(seed=...) first")
        self.batch, episodes = self._loader.load(
            rngs, vehicles, options, self.batch, self.running, self._share_resets
        )
        for i in vehicles.tolist():
            self._episodes[i] = episodes.get(i)
            if self.composer is not None:
                sensors = episodes[i].sensors if i in episodes else self._loader.sensors
                nominal = self.running.nominals[i]
                self.composer.start(i, int(self.running.seeds[i]), sensors, nominal)
        options = options if options and any(options) else None
        if options or self._draws_vehicles or self.reference_scale is not self._usual_scale:
            self._note_scales(vehicles, options)
        complete_starts(self.batch, vehicles, self.solver.prepared)
        self.ended[vehicles] = False
        self._until_refill = min(self._until_refill, b.NOISE_BLOCK - 1)
        self._advance(vehicles, 0, vehicles.size, False)
        return self.observations

    def _note_scales(
        self, vehicles: NDArray[np.int64], options: Sequence[Mapping[str, Any] | None] | None
    ) -> None:
        """Factors of the references that have just been loaded."""
        scales, of_paths = self.reference_scale.copy(), self._loader.path_scales(vehicles)
        scales[vehicles] = self._usual_scale[vehicles] if of_paths is None else of_paths
        for k, i in enumerate(vehicles.tolist()):
            other = ((options[k] if options else None) or {}).get("reference")
            spec = self.settings.reference if other is None else self.settings.written(other)
            if other is not None or (self._draws_vehicles and of_paths is None):
                scales[i] = reference_scale(spec, self.nominal(i))
        is_usual = np.array_equal(scales, self._usual_scale)
        self.reference_scale = self._usual_scale if is_usual else scales

    @property
    def threads(self) -> int:
        """How many threads a step of all vehicles runs on."""
        return 1 if self.count < self._threads_from else self._threads.count

    def _share_resets(self, function: Callable[[int, int], None], size: int) -> None:
        """Call function(first, last) for shares of `size` vehicles, or for all at once."""
        if self.count < self._threads_from or size < RESETS_SHARED_FROM:
            function(0, size)
        else:
            self._threads.run(function, size)

    # --- an episode runs ------------------------------------------------------------------
    def step(
        self, actions: NDArray[np.float32], vehicles: NDArray[np.int64] | None = None
    ) -> NDArray[np.float32]:
        """Advance the chosen vehicles (default: all) by one control step.

        A vehicle whose episode has ended is stepped on unless it is left out.

        actions: (N, 2) float32, left and right sprocket torque over the torque limit, or speed
        over the speed limit, clipped to [-1, 1]. Raises ValueError for a wrong shape or type
        or a non-finite value, and ResetNeeded for a vehicle that was never reset, before moving.
        Returns all observations (N, D) in the layout of the config.
        """
        self.actions[:] = checked_actions(actions, self.actions.shape)
        return self.advance(vehicles)

    def advance(self, vehicles: NDArray[np.int64] | None = None) -> NDArray[np.float32]:
        """The same with the actions that stand in `actions` (N, 2) float32."""
        if not self._all_started:
            self._check_started(self.all if vehicles is None else vehicles)
        if self.batch is not self._bound:
            self._bind()
        refill = self._until_refill <= 0
        if vehicles is None and not refill and self.count < self._threads_from:
            result = self._kernel(*self._call)
            self._until_refill -= 1
            if result < 0 and self.composer is not None:
                self.composer.write(self.batch, self.observations, self.all, 0, self.count)
        else:
            result = self._advance_some(self.all if vehicles is None else vehicles, refill)
        self.some_ended = result == SOME_ENDED
        if self.some_ended:
            self.ended = self.terminated | self.truncated
        elif result >= 0:
            raise ValueError(
                f"action[{result}] = {self.actions[result].tolist()}; must be finite, in [-1, 1]. "
                "Did the policy diverge, or divide by zero? No vehicle was moved."
            )
        if self._scoring is not None:
            self._scoring.write(self.batch, self.all if vehicles is None else vehicles)
        return self.observations

    def _advance_some(self, vehicles: NDArray[np.int64], refill: bool) -> int:
        """Some of the vehicles, on one thread or several, with new noise where it is due."""
        vehicles, its = np.ascontiguousarray(vehicles, dtype=np.int64), self.running
        size = vehicles.size
        remaining = [] if refill else [self._until_refill]

        def run(first: int, last: int) -> int:
            if refill:
                rows = vehicles[first:last]
                remaining.append(streams.refill(self.batch, its.noise_states, its.noisy, rows))
            return self._advance(vehicles, first, last, True)

        if size < self._threads_from:
            result = run(0, size)
        elif np.isfinite(self.actions[vehicles]).all():
            result = min(self._threads.run(run, size, self.solver.plant.lanes))
        else:  # before a thread moves any: the first one with such an action
            result = int(vehicles[~np.isfinite(self.actions[vehicles]).all(axis=1)][0])
        self._until_refill = min(remaining, default=0) - 1
        return result

    def _check_started(self, vehicles: NDArray[np.int64]) -> None:
        """Raise ResetNeeded when one of the chosen vehicles has no episode."""
        started = self.batch.counters[:, b.MAX_STEP] > 0
        missing = vehicles[~started[vehicles]]
        if missing.size:
            raise ResetNeeded(
                f"vehicle {missing[0]} has no episode ({missing.size} of {self.count} have none); "
                "call reset() before step(), and without reset_mask the first time"
            )
        self._all_started = bool(started.all())

    def _advance(self, vehicles: NDArray[np.int64], first: int, last: int, moving: bool) -> int:
        """Run the kernel for vehicles[first:last]; its types are those of `_bind`."""
        if self.batch is not self._bound:
            self._bind()
        rows = Rows(vehicles, self.actions, self._written, first, last, moving)
        result: int = self._kernel(self.batch, rows, *self._tail)
        if result < 0 and self.composer is not None and first < last:
            self.composer.write(self.batch, self.observations, vehicles, first, last)
        return result

    # --- what is read between the steps ---------------------------------------------------
    def column(self, name: str) -> NDArray[np.float64]:
        """A copy (N,) of one column of the floats; names: `arrays.COLUMN`."""
        return self.batch.column(name).copy()

    def report(self) -> b.Report:
        """A copy of tracking error, reward and its terms."""
        values = self.batch.floats.T[b.ERROR_DISTANCE : b.SQUARED_ERROR_SUM].copy()
        return b.Report(values[:2].T, values[2], values[3:])

    def costs(self) -> dict[str, NDArray[np.float64]]:
        """Cost of the last step and its terms by name, (N,) each; empty without limits."""
        first = self.batch.floats.shape[1] - len(self.cost_names)
        columns = self.batch.floats[:, first:].T.copy()
        return dict(zip(self.cost_names, columns, strict=True))

    @property
    def steps(self) -> NDArray[np.int64]:
        """(N,) control steps since reset."""
        return self.batch.counter("step").copy()

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """(N,) off the path, or non-finite."""
        return self.batch.counter("terminated") != 0

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """(N,) out of time."""
        return self.batch.counter("truncated") != 0

    @property
    def rmse(self) -> NDArray[np.float64]:
        """(N,) root mean square distance to the reference since reset [m]."""
        steps = np.maximum(self.batch.counter("step"), 1)
        return np.sqrt(self.batch.column("squared_error_sum") / steps)

    @property
    def success(self) -> NDArray[np.bool_]:
        """(N,) the episode has ended by time with an RMSE below SUCCESS_RMSE."""
        return self.truncated & (self.rmse < b.SUCCESS_RMSE * self.batch.column("contact_length"))

    def endings(self) -> dict[str, NDArray[np.bool_]]:
        """Why episodes have terminated, (N,) each of `ending_flags`: off the path, or as it says.

        A state that is not finite has no flag.
        """
        over = self.terminated
        if not np.count_nonzero(over):  # nearly always: nothing to look up
            return {name: np.zeros_like(over) for name in self.ending_flags}
        code = self.batch.floats[:, b.FAILURE]
        finite = np.isfinite(self.batch.state()).all(axis=1)
        return {name: over & finite & (code == k) for k, name in enumerate(self.ending_flags)}

    def nominal(self, i: int) -> PlantParameters:
        """Vehicle i as its controllers may know it: of the environment, or as its law drew it."""
        return PlantParameters(*self.running.nominals[i].item())

    def truth(self) -> dict[str, NDArray[np.float64]]:
        """True state and parameters in force, and pose of the reference, by name; each (N,)."""
        names = (*STATE_NAMES, *PARAMETER_NAMES, "reference_x", "reference_y", "reference_yaw")
        return {name: self.column(name) for name in names}

    @property
    def episodes(self) -> list[Episode | None]:
        """The truth of the episode of every vehicle, None before its first.

        An episode is one object until the next one begins.
        """
        for i in (i for i, episode in enumerate(self._episodes) if episode is None):
            if self.batch.counters[i, b.MAX_STEP] > 0:
                sensors = self._loader.sensors
                self._episodes[i] = self._loader.read(i, self.batch, self.running, sensors)
        return [*self._episodes]

    def snapshot(self) -> dict[str, Any]:
        """All that changes while episodes run; can be pickled. `resume` goes on from it."""
        return copy.deepcopy(self._state())

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on from what `snapshot` returned, bit for bit; of the same count and config."""
        if len(snapshot["observations"]) != self.count:
            raise ValueError(
                f"snapshot of {len(snapshot['observations'])} vehicles; must be of {self.count}"
            )
        self.__setstate__(copy.deepcopy(dict(snapshot)))

    def close(self) -> None:
        """Release the threads."""
        self._threads.close()
