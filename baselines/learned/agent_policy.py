"""A trained agent as a policy: everything it remembers is in its state.

    action, state = policy.predict(observation (N, D), state, episode_start)
Observation augmentation, running normalisation and network are those of the training. What the
network sees of an observation is looked up by the names of the fields, `Shown`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.learned.augmentation import Augmentation, make_augmentation, seen
from baselines.learned.held_policy import chosen
from baselines.learned.privileged_inputs import TEACHER, Truth, privileged
from baselines.registry import Context
from tracked_env import observation as layout
from tracked_env.physics.parameters import VEHICLES, PlantParameters

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]


Groups = Mapping[str, Sequence[str]]  # fields of an observation by group, in their order


def groups_in(shown: layout.Layout) -> Groups:
    """The groups of a layout and their fields."""
    return {part.name: [field.name for field in part.fields] for part in shown.parts}


V0_GROUPS = groups_in(layout.V0)


class Shown:
    """What an agent sees of observations with the fields `names`: those of `groups`, by name.

    needs: fields of `observation.V0` that its augmentation reads. Raises ValueError, which names
    the missing groups.
    """

    def __init__(self, groups: Groups, names: Sequence[str], needs: Sequence[str]) -> None:
        missing = [name for name, fields in groups.items() if not set(fields) <= set(names)]
        unknown = [name for name in missing if name not in layout.GROUPS]
        if unknown:
            raise ValueError(
                f"it sees the observation group {' and '.join(unknown)}, which is not registered. "
                "Import the module that registers it, and make the environment with it"
            )
        fields = [field for of_group in groups.values() for field in of_group]
        self._columns = layout.columns(names, fields)
        self._same = fields == list(names)
        self._view = layout.View(names, needs, hint="The agent widens it by itself.")

    def __call__(self, observation: NDArray[np.floating[Any]]) -> tuple[Floats, Floats]:
        """What the network sees (N, fields), and the same as V0 (N, SIZE) for the augmentation.

        Raises ValueError for an observation of another shape.
        """
        of_v0 = self._view(observation)
        if self._same and self._view.same:
            return of_v0, of_v0
        given = np.asarray(observation, dtype=np.float32).reshape(len(of_v0), -1)
        return (given if self._same else given[:, self._columns]), of_v0


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
    """A network: `forward_pass.Actor`, a student, or a model of Stable-Baselines3."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Action and the state of the recurrent network."""
        ...


class AgentState(NamedTuple):
    """What the policy remembers between two calls."""

    memories: Any  # of the augmentation
    recurrent: Any  # hidden and cell values of the LSTM, or None


class AgentPolicy:
    """Network, augmentation and normalisation as one policy, for one vehicle or a batch.

    model: a network, for the fields of `groups`; they are looked up by name in what the
    environment of `context` gives. kind, options: of `make_augmentation`. Raises ValueError where
    it does not give them all.
    """

    def __init__(
        self,
        model: Predictor,
        kind: str,
        options: Mapping[str, Any],
        context: Context,
        normalisation: Normalisation | None = None,
        groups: Groups = V0_GROUPS,
    ) -> None:
        self.model = model
        self.normalisation = normalisation
        self._recipe = (kind, dict(options), context)
        self._given: AgentState | None = None
        self._seen: tuple[Floats, Any] | None = None  # features and recurrent values of last time
        self._held: tuple[Bools, Floats, Any] | None = (
            None  # rows that learn no more, what they keep
        )
        self.augmentation: Augmentation = make_augmentation(*self._recipe, 1)
        self._shown = Shown(groups, context.observation, self.augmentation.needs)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: AgentState | None = None,
        episode_start: NDArray[np.bool_] | bool | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], AgentState]:
        """Sprocket torques over their limit, and the state to pass to the next call.

        observation: (D,) or (N, D), in the layout of the environment. state: None begins.
        episode_start: (N,) or a bool; those rows forget. deterministic: the mean action.
        Returns action float32, (2,) or (N, 2), in [-1, 1], left then right, and the new state.
        Raises ValueError for a wrong shape.
        """
        present, batch = self._shown(observation)
        count = len(batch)
        start = np.full(count, state is None)
        if episode_start is not None:
            start |= np.asarray(episode_start, dtype=bool)
        if state is None or count != self.augmentation.count:
            self.augmentation = make_augmentation(*self._recipe, count)
            self._held = None
        if state is not None and state is not self._given:
            self.augmentation.restore(state.memories)
        self._given = None  # until this call has ended well, `augmentation` is in no known state
        features = self.augmentation.observe(batch, start)
        before = None if state is None else state.recurrent
        if self._held is not None:
            features, before = self._with_held(features, before, start)
        shown = seen(present, features)
        if self.normalisation is not None:
            shown = self.normalisation(shown)
        action, recurrent = self.model.predict(shown, before, start, deterministic)
        self._seen = features, recurrent
        commands = self.augmentation.command(np.asarray(action, np.float32), features)
        self._given = AgentState(self.augmentation.memories(), recurrent)
        return (commands[0] if np.ndim(observation) == 1 else commands), self._given

    def freeze(self, rows: Bools) -> None:
        """Keep what has been learned of the vehicle in these rows (N,), until they start anew.

        That is the features of the augmentation that it calls `learned` (a history as a whole, of
        estimates the parameters and not the motion), and what a recurrent network remembers.
        """
        self.augmentation.freeze(rows)
        if self._seen is not None:
            features, recurrent = self._seen
            if self._held is not None and recurrent is not None:
                recurrent = chosen(self._held[2], recurrent, self._held[0])
            held = rows.copy() if self._held is None else self._held[0] | rows
            self._held = held, features.copy(), recurrent

    def _with_held(self, features: Floats, recurrent: Any, start: Bools) -> tuple[Floats, Any]:
        """Features and recurrent values with those held in the rows that learn no more."""
        assert self._held is not None
        rows, kept, remembered = self._held
        rows &= ~start
        names = self.augmentation.feature_names
        columns = np.isin(names, self.augmentation.learned)
        features = np.where(rows[:, None] & columns, kept, features)
        if recurrent is not None and remembered is not None:
            recurrent = chosen(remembered, recurrent, rows)
        return features, recurrent


class TeacherPolicy:
    """A teacher as a policy of the benchmark, which must be handed the truth.

    model: a network that sees observation and privileged inputs. nominal: the vehicle and soil
    that these are relative to. normalisation: of both. names: fields that the environment shows.
    groups: those of them that the network sees. Raises ValueError where they are not shown.
    """

    needs_truth = True

    def __init__(
        self,
        model: Predictor,
        nominal: PlantParameters,
        normalisation: Normalisation | None = None,
        names: Sequence[str] = layout.NAMES,
        groups: Groups = V0_GROUPS,
    ) -> None:
        self.model, self.nominal, self.normalisation = model, nominal, normalisation
        self._shown = Shown(groups, names, ())
        self._inputs: Floats | None = None

    def observe_truth(self, truth: Truth) -> None:
        """Take over the truth, {name: number or (N,)}; other names are ignored."""
        values = {name: np.atleast_1d(value) for name, value in truth.items() if name[0] != "_"}
        self._inputs = privileged(values, self.nominal)

    def predict(
        self,
        observation: Floats,
        state: AgentState | None = None,
        episode_start: Bools | bool | None = None,
        deterministic: bool = True,
    ) -> tuple[Floats, AgentState]:
        """Action and state as AgentPolicy. Raises ValueError for a wrong shape or no truth."""
        present, _ = self._shown(observation)
        if self._inputs is None or len(present) != len(self._inputs):
            raise ValueError(
                f"observation has shape {np.shape(observation)}, but the truth of "
                f"{0 if self._inputs is None else len(self._inputs)} vehicles was observed; a "
                "teacher needs `observe_truth` before each `predict`. A student drives without."
            )
        start = np.full(len(present), state is None)
        if episode_start is not None:
            start |= np.asarray(episode_start, dtype=bool)
        shown = seen(present, self._inputs)
        if self.normalisation is not None:
            shown = self.normalisation(shown)
        action, recurrent = self.model.predict(
            shown, None if state is None else state.recurrent, start, deterministic
        )
        commands = np.asarray(action, np.float32)
        return (commands[0] if np.ndim(observation) == 1 else commands), AgentState((), recurrent)


def policy_of(
    model: Predictor,
    kind: str,
    options: Mapping[str, Any],
    context: Context,
    normalisation: Normalisation | None = None,
    groups: Groups = V0_GROUPS,
) -> AgentPolicy | TeacherPolicy:
    """A model as the policy that its kind makes of it; arguments as AgentPolicy."""
    if kind == TEACHER:
        nominal = VEHICLES[context.vehicle]
        return TeacherPolicy(model, nominal, normalisation, context.observation, groups)
    return AgentPolicy(model, kind, options, context, normalisation, groups)
