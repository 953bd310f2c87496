"""Wrappers that append what an observer has identified to the observation.

An observer watches the observations of N vehicles and returns features; the identification
stack of `baselines` is one:
    IdentifiedObservation(env, IdentificationStack())
    IdentifiedVectorObservation(vector_env, IdentificationStack(count=64))
It sees what an agent sees, never the truth, and forgets when an episode ends. Whatever groups the
environment shows, an observer gets the fields of `observation.V0`, looked up by name; it may
declare those that it `needs`, else it needs them all.
"""

from typing import Any, Protocol

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from tracked_env.observation import FEATURE_BOUND, NAMES, View, append_features

Observations = NDArray[np.float32]


class Observer(Protocol):
    """What the wrappers need of an observer of N vehicles."""

    @property
    def count(self) -> int:
        """Number of vehicles."""

    @property
    def control_period(self) -> float:
        """Time [s] between two observations."""

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of the F features."""

    def observe(self, observation: Observations, start: NDArray[np.bool_]) -> Observations:
        """Features (N, F) after observations (N, D); rows with `start` begin an episode."""

    def memories(self) -> Any:
        """A copy of all that is remembered."""

    def restore(self, memories: Any, rows: NDArray[np.bool_] | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""


def _checked(env: Any, count: int, observer: Observer) -> tuple[Any, View]:
    """The widened space of one vehicle, and what the observer sees of its observations.

    Raises ValueError when env and observer do not fit.
    """
    if observer.count != count:
        raise ValueError(
            f"an observer of {observer.count} vehicles for {count}; pass count={count}"
        )
    simulation = getattr(env.unwrapped, "simulation", None)
    if simulation is None:
        raise ValueError(f"{env.unwrapped} is no environment of this project")
    period = simulation.solver.control_period
    if not abs(observer.control_period - period) <= 1e-9:
        raise ValueError(
            f"the observer's control period is {observer.control_period:g} s, that of the "
            f"environment {period:g} s. Did you set control_rate in only one of them?"
        )
    space = getattr(env, "single_observation_space", env.observation_space)
    bound = np.full(len(observer.feature_names), FEATURE_BOUND, dtype=np.float32)
    low, high = np.concatenate([space.low, -bound]), np.concatenate([space.high, bound])
    widened = gymnasium.spaces.Box(low, high, dtype=np.float32)
    return widened, View(simulation.layout.names, getattr(observer, "needs", NAMES))


class IdentifiedObservation(
    gymnasium.ObservationWrapper[Observations, NDArray[np.float32], Observations],
    gymnasium.utils.RecordConstructorArgs,
):
    """Appends the features of an observer of one vehicle to the observation of one env.

    Raises ValueError for an observer of another size or control period.
    """

    def __init__(self, env: gymnasium.Env[Observations, NDArray[np.float32]], observer: Observer):
        gymnasium.utils.RecordConstructorArgs.__init__(self, observer=observer)
        gymnasium.ObservationWrapper.__init__(self, env)
        self.observation_space, self._view = _checked(env, 1, observer)
        self.observer = observer
        self._start = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Start an episode; the observer forgets the last one."""
        self._start = True
        return super().reset(seed=seed, options=options)

    def observation(self, observation: Observations) -> Observations:
        """Observation and features, (D + F,)."""
        features = self.observer.observe(self._view(observation), np.array([self._start]))
        self._start = False
        return append_features(observation, features[0])


class IdentifiedVectorObservation(gymnasium.vector.VectorWrapper):
    """The same for a vector env, in every autoreset mode, `final_obs` included.

    Raises ValueError for an observer of another size or control period.
    """

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], observer: Observer) -> None:
        super().__init__(env)
        self.single_observation_space, self._view = _checked(env, env.num_envs, observer)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self.observer = observer
        self._simulation: Any = getattr(env.unwrapped, "simulation", None)
        self._mode = AutoresetMode(env.metadata["autoreset_mode"])
        shape = (env.num_envs, len(observer.feature_names))
        self._features: Observations = np.zeros(shape, dtype=np.float32)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Start episodes; with `options["reset_mask"]` only the rows marked."""
        observation, info = self.env.reset(seed=seed, options=options)
        mask = (options or {}).get("reset_mask")
        started = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        self._observe(observation, started, started)
        return append_features(observation, self._features), info

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observations, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Any]:
        """Advance all rows; an ended row's features come before those of its next episode."""
        over = self._simulation.ended.copy()  # before this step
        observation, reward, terminated, truncated, info = self.env.step(actions)
        ended = terminated | truncated
        every, none = np.ones_like(ended), np.zeros_like(ended)
        if self._mode is AutoresetMode.SAME_STEP:
            rows, last = np.flatnonzero(ended), observation.copy()
            for i in rows:
                last[i] = info["final_obs"][i]
            self._observe(last, every, none)
            for i in rows:
                info["final_obs"][i] = append_features(last[i], self._features[i])
            if rows.size:
                self._observe(observation, ended, ended)
        elif self._mode is AutoresetMode.NEXT_STEP:
            self._observe(observation, every, over)
        else:  # DISABLED: ended rows wait for a reset
            self._observe(observation, ~over, none)
        features = append_features(observation, self._features)
        return features, reward, terminated, truncated, info

    def _observe(
        self, observation: Observations, rows: NDArray[np.bool_], start: NDArray[np.bool_]
    ) -> None:
        """Features after an observation of the rows marked; the others keep theirs."""
        if rows.all():
            self._features = self.observer.observe(self._view(observation), start)
            return
        before = self.observer.memories()
        features = self.observer.observe(self._view(observation), start)
        self.observer.restore(before, ~rows)
        self._features = np.where(rows[:, None], features, self._features)
