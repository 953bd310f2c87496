"""A trained agent as a policy of the benchmark: everything it remembers is in its state.

    action, state = policy.predict(observation (N, SIZE), state, episode_start)
The memory (`agents.memory`), the running normalisation and the network are those of the training.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from agents.memory import Memory, make_memory, seen
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyContext


class Normalisation(NamedTuple):
    """Running mean and variance of what the network sees, as VecNormalize of SB3 applies them."""

    mean: NDArray[np.float64]  # (D,)
    variance: NDArray[np.float64]  # (D,)
    epsilon: float
    clip: float

    def __call__(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Values (N, D) less their mean, over their standard deviation, clipped."""
        scaled = (values - self.mean) / np.sqrt(self.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)


class Predictor(Protocol):
    """The part of a model of Stable-Baselines3 that is used."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Action and the state of the recurrent network."""
        ...


class AgentState(NamedTuple):
    """What the policy remembers between two calls."""

    memories: Any  # of agents.memory
    recurrent: Any  # hidden and cell values of the LSTM, or None


class AgentPolicy:
    """Network, memory and normalisation as one policy, for one vehicle or a batch.

    model: of Stable-Baselines3, which sees the fields of `observation.V0`; they are looked up by
    name in what the environment of `context` shows. kind, options: of `make_memory`.
    Raises ValueError where it does not show them all.
    """

    def __init__(
        self,
        model: Predictor,
        kind: str,
        options: Mapping[str, Any],
        context: PolicyContext,
        normalisation: Normalisation | None = None,
    ) -> None:
        self.model = model
        self.normalisation = normalisation
        self._recipe = (kind, dict(options), context)
        self._view = layout.View(context.observation, hint="The agent widens it by itself.")
        self._given: AgentState | None = None
        self.memory: Memory = make_memory(*self._recipe, 1)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: AgentState | None = None,
        episode_start: NDArray[np.bool_] | bool | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], AgentState]:
        """Sprocket torques over their limit, and the state to pass to the next call.

        observation: (SIZE,) or (N, SIZE) as in tracked_env.observation. state: None begins.
        episode_start: (N,) or a bool; those rows forget. deterministic: the mean action.
        Returns action float32, (2,) or (N, 2), in [-1, 1], left then right, and the new state.
        Raises ValueError for a wrong shape.
        """
        batch = self._view(observation)
        count = len(batch)
        start = np.full(count, state is None)
        if episode_start is not None:
            start |= np.asarray(episode_start, dtype=bool)
        if state is None or count != self.memory.count:
            self.memory = make_memory(*self._recipe, count)
        if state is not None and state is not self._given:
            self.memory.restore(state.memories)
        self._given = None  # until this call has ended well, `memory` is in no known state
        features = self.memory.observe(batch, start)
        shown = seen(batch, features)
        if self.normalisation is not None:
            shown = self.normalisation(shown)
        action, recurrent = self.model.predict(
            shown, None if state is None else state.recurrent, start, deterministic
        )
        commands = self.memory.command(np.asarray(action, np.float32), features)
        self._given = AgentState(self.memory.memories(), recurrent)
        return (commands[0] if np.ndim(observation) == 1 else commands), self._given
