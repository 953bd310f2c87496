"""A trained agent as a policy: everything it remembers is in its state.

Observation augmentation, running normalisation and network are those of the training. What the
network sees of an observation is looked up by the names of the fields.

The networks of trained agents: from their weights to an action, in single precision.

    layer        y = f(x W^T + b)
    LSTM [1]     a = x W_x^T + b_x + h W_h^T + b_h
                 i, f, o = sigmoid(a_i, a_f, a_o),  g = tanh(a_g),  c' = f c + i g,  h' = o tanh(c')
    actor        of PPO: clip(MLP(x));  of SAC, TQC and TD3: tanh(MLP(x));
                 of recurrent PPO: clip(MLP([h', x]))
Weights have the names and shapes of PyTorch. Sums run in the same order for any number of rows,
so a batch has the bits of its single rows. The action is the mean of the distribution.

References: [1] Hochreiter and Schmidhuber (1997), gates and their order as torch.nn.LSTM.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.batch_policy import Array, BatchPolicy, Context
from baselines.estimators.measurement import DataSheet
from baselines.learned.augmentation import (
    KINDS,
    LAGS,
    Augmentation,
    Bools,
    Floats,
    History,
    merge_rows,
    network_inputs,
)
from baselines.learned.matrix_product import linear
from tracked_env import observation as layout

Arrays = dict[str, NDArray[Any]]
Shapes = dict[str, tuple[int, ...]]
Carried = tuple[Floats, Floats]  # hidden and cell values of an LSTM, (N, H) each

ACTIONS = 2  # left and right sprocket
ALGORITHMS = ("ppo", "sac", "td3", "tqc", "recurrent-ppo")
RECURRENT = "recurrent-ppo"
# Where the layers of the action stand in a policy of Stable-Baselines3: hidden ones, the last one.
_GAUSSIAN = "mlp_extractor.policy_net.", "action_net"
_SQUASHED = "actor.latent_pi.", "actor.mu"
_HIDDEN_AND_LAST = {
    "ppo": _GAUSSIAN,
    RECURRENT: _GAUSSIAN,
    "sac": _SQUASHED,
    "tqc": _SQUASHED,
    "td3": ("actor.mu.", ""),
}
_LSTM = "lstm_actor."


def _relu(x: Floats) -> Floats:
    return np.maximum(x, 0.0)


ACTIVATIONS: dict[str, Callable[[Floats], Floats]] = {"tanh": np.tanh, "relu": _relu}


def _sigmoid(x: Floats) -> Floats:
    return 0.5 * (np.tanh(0.5 * x) + 1.0)  # exp(-x) would overflow


class Linear:
    """An affine map. weight: (M, K), bias: (M,)."""

    def __init__(self, weight: NDArray[Any], bias: NDArray[Any]) -> None:
        self.weights = np.ascontiguousarray(weight.T, dtype=np.float32)
        self.bias = np.ascontiguousarray(bias, dtype=np.float32)

    def __call__(self, inputs: Floats) -> Floats:
        """Outputs (N, M) of inputs (N, K)."""
        out = np.empty((len(inputs), len(self.bias)), dtype=np.float32)
        linear(np.ascontiguousarray(inputs, dtype=np.float32), self.weights, self.bias, out)
        return out


class Network:
    """An LSTM beside the inputs, if there is one, and layers with `activation` (of ACTIVATIONS)
    behind all but the last."""

    def __init__(
        self,
        weights: Mapping[str, Any],
        names: Sequence[str],
        activation: str,
        lstm: str | None = None,
    ) -> None:
        """names: of the layers, whose parameters are NAME.weight and NAME.bias; lstm: prefix of
        parameters that are called as those of torch.nn.LSTM."""
        self.layers = [Linear(weights[f"{n}.weight"], weights[f"{n}.bias"]) for n in names]
        self.activation = activation
        self._apply = ACTIVATIONS[activation]
        self.gates: list[Linear] = []  # of the inputs, of the hidden values
        if lstm is not None:
            self.gates = [
                Linear(weights[f"{lstm}weight_{of}_l0"], weights[f"{lstm}bias_{of}_l0"])
                for of in ("ih", "hh")
            ]
            self.size = weights[f"{lstm}weight_hh_l0"].shape[1]

    def __call__(
        self, inputs: Floats, carried: Carried | None, start: Bools
    ) -> tuple[Floats, Carried | None]:
        """Outputs (N, M) of inputs (N, K), and what the LSTM carries on; it forgets at `start`."""
        if self.gates:
            carried = self._remember(inputs, carried, start)
            inputs = np.concatenate([carried[0], inputs], axis=1)
        for layer in self.layers[:-1]:
            inputs = self._apply(layer(inputs))
        return self.layers[-1](inputs), carried

    def _remember(self, inputs: Floats, carried: Carried | None, start: Bools) -> Carried:
        """Hidden and cell values after inputs (N, K)."""
        if carried is None:
            hidden = cell = np.zeros((len(start), self.size), dtype=np.float32)
        else:
            hidden, cell = (np.where(start[:, None], np.float32(0.0), of) for of in carried)
        gates = self.gates[0](inputs) + self.gates[1](hidden)
        admit, forget, candidate, release = np.split(gates, 4, axis=1)
        cell = _sigmoid(forget) * cell + _sigmoid(admit) * np.tanh(candidate)
        return _sigmoid(release) * np.tanh(cell), cell


def network_shapes(
    names: Sequence[str], sizes: Sequence[int], lstm: str = "", carried: int = 0
) -> Shapes:
    """Parameters of layers of these names, from sizes[0] inputs to sizes[-1] outputs, beside an
    LSTM of `carried` hidden values with this prefix, if any."""
    shapes: Shapes = {}
    inputs, *following = sizes
    for name, (size, outputs) in zip(names, pairwise((inputs + carried, *following)), strict=True):
        shapes |= {f"{name}.weight": (outputs, size), f"{name}.bias": (outputs,)}
    for of, size in (("ih", inputs), ("hh", carried)) if carried else ():
        shapes[f"{lstm}weight_{of}_l0"] = 4 * carried, size
        shapes[f"{lstm}bias_{of}_l0"] = (4 * carried,)
    return shapes


def _layer_names(algorithm: str, hidden: int) -> list[str]:
    """Of the layers of an action with this number of hidden ones."""
    prefix, last = _HIDDEN_AND_LAST[algorithm]
    names = [f"{prefix}{2 * number}" for number in range(hidden)]  # activations stand between
    return [*names, last or f"{prefix}{2 * hidden}"]


def actor_shapes(algorithm: str, network: Mapping[str, Any]) -> Shapes:
    """The parameters that an archive of this architecture holds."""
    inputs, hidden, carried = network["inputs"], network["hidden"], network["lstm_hidden"] or 0
    names = _layer_names(algorithm, len(hidden))
    shapes = network_shapes(names, (inputs, *hidden, ACTIONS), _LSTM, carried)
    if _HIDDEN_AND_LAST[algorithm] == _GAUSSIAN:
        shapes["log_std"] = (ACTIONS,)  # of the exploration; the mean does not need it
    elif _HIDDEN_AND_LAST[algorithm] == _SQUASHED:
        width = hidden[-1] if hidden else inputs
        shapes |= network_shapes(["actor.log_std"], (width, ACTIONS))
    return shapes


def check_weights(weights: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raises ValueError for parameters of another name, shape or type, and for one not finite."""
    if set(weights) != set(shapes):
        changed = sorted(set(weights) ^ set(shapes))
        raise ValueError(f"its weights lack or have too much: {', '.join(changed)[:200]}")
    for name, value in weights.items():
        if value.shape != shapes[name] or value.dtype != np.float32:
            raise ValueError(
                f"weights {name} are {value.dtype} {value.shape}; must be float32 "
                f"{shapes[name]}, as its recipe says"
            )
        if not np.isfinite(value).all():
            raise ValueError(f"weights {name} are not finite. Did its training diverge?")


class Actor:
    """The network of an agent, with the `predict` of Stable-Baselines3."""

    def __init__(
        self, algorithm: str, network: Mapping[str, Any], weights: Mapping[str, Any]
    ) -> None:
        """Of checked architecture; weights: of an archive. Raises ValueError if they do not fit."""
        check_weights(weights, actor_shapes(algorithm, network))
        names = _layer_names(algorithm, len(network["hidden"]))
        lstm = _LSTM if network["lstm_hidden"] else None
        self.network = Network(weights, names, network["activation"], lstm)
        self.squashed = _HIDDEN_AND_LAST[algorithm] != _GAUSSIAN

    def predict(
        self,
        observation: Floats,
        state: Carried | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Floats, Carried | None]:
        """Action (N, 2) in [-1, 1] after inputs (N, K), and what the LSTM carries on.

        episode_start: (N,), rows whose LSTM forgets. deterministic: has no effect.
        """
        none = np.zeros(len(observation), dtype=bool)
        start = none if episode_start is None else np.asarray(episode_start, dtype=bool)
        action, state = self.network(observation, state, start)
        return (np.tanh(action) if self.squashed else np.clip(action, -1.0, 1.0)), state


OBSERVER = "observer"  # corrects what a controller sees, see `learned_observer`
ANY_VEHICLE = "any-vehicle"  # drives a vehicle that it is not told, see `untold_policy`
LEARNED_SLIP = "learned-slip"  # corrects a controller without slip, see `learned_slip`
Groups = Mapping[str, Sequence[str]]  # fields of an observation by group, in their order


def groups_in(inputs: layout.Layout) -> Groups:
    """The groups of a layout and their fields."""
    return {part.name: [field.name for field in part.fields] for part in inputs.parts}


def fields_of(groups: Groups) -> list[str]:
    """The fields of all groups."""
    return [field for of_group in groups.values() for field in of_group]


V0_GROUPS = groups_in(layout.V0)


class Normalisation(NamedTuple):
    """Running mean and variance of what the network sees, as VecNormalize of SB3 applies them."""

    mean: Array  # (D,)
    variance: Array  # (D,)
    epsilon: float
    clip: float

    def __call__(self, values: Floats) -> Floats:
        """Values (N, D) less their mean, over their standard deviation, clipped."""
        scaled = (values - self.mean) / np.sqrt(self.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)


class Predictor(Protocol):
    """A network: `Actor`, or a model of Stable-Baselines3."""

    def predict(
        self, observation: Any, state: Any, episode_start: Any, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Action and the state of the recurrent network."""


class AgentState(NamedTuple):
    """What the policy remembers between two calls."""

    memories: Any  # of the augmentation
    recurrent: Any  # hidden and cell values of the LSTM, or None


def make_augmentation(
    kind: str, options: Mapping[str, Any], context: Context, count: int
) -> Augmentation:
    """A fresh augmentation of `count` vehicles.

    options: `lags` of history, `scale` and `base` of residual, `data_sheet` of all: whether that of
    the sensors is shown. `gains` of residual are by default the paper's (on slopes
    GAINS_ON_SLOPES), on which agents without them in their archive were trained.
    Raises ValueError for an unknown kind or option.
    """
    allowed = {"history": {"lags"}, "residual": {"scale", "base", "gains"}}.get(kind, set())
    if kind not in KINDS or set(options) - {*allowed, "data_sheet"}:
        raise ValueError(
            f"augmentation {kind!r} with options {dict(options)}; kinds are {', '.join(KINDS)}, "
            "options `lags` of history, `scale`, `base` and `gains` of residual, `data_sheet` of "
            "all"
        )
    if kind == "blind":
        augmentation = Augmentation(count, context.control_period)
    elif kind == "history":
        augmentation = History(count, context.control_period, tuple(options.get("lags", LAGS)))
    else:  # imported here: filters and controllers are many files, which a blind agent needs not
        from baselines.learned.controller_augmentation import make_controlled

        augmentation = make_controlled(kind, options, context, count)
    if options.get("data_sheet", False):
        augmentation.show_sheet(DataSheet.of(context.sensors))
    return augmentation


class AgentPolicy(BatchPolicy[AgentState]):
    """Network, augmentation and normalisation as one policy, for one vehicle or a batch.

    model: a network, for the fields of `groups`; they are looked up by name in what the
    environment of `context` gives. kind, options: of `make_augmentation`. Raises ValueError, which
    names the missing groups, where it does not give them all.
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
        self.model, self.normalisation = model, normalisation
        self._recipe = (kind, dict(options), context)
        self._latest: AgentState | None = None  # that `augmentation` is in
        self._last_call: tuple[Floats, Any] | None = None  # features and recurrent values
        self._frozen: tuple[Bools, Floats, Any] | None = None  # rows that learn no more, theirs
        self.augmentation = self._augmentation(1)
        shown = context.observation
        missing = [name for name, fields in groups.items() if not set(fields) <= set(shown)]
        unknown = [name for name in missing if name not in layout.GROUPS]
        if unknown:
            raise ValueError(
                f"it sees the observation group {' and '.join(unknown)}, which is not registered. "
                "Import the module that registers it, and make the environment with it"
            )
        fields = fields_of(groups)
        needs = self.augmentation.needs
        hint = "The agent widens it by itself."
        self._view = layout.View(shown, (*needs, *fields), hint=hint)
        # The augmentation reads the fields of V0 and those that it needs behind them.
        behind = [name for name in dict.fromkeys((*needs, *fields)) if name not in layout.INDEX]
        self._read = layout.SIZE + len(set(needs) - set(layout.INDEX))
        present = [*layout.NAMES, *behind]
        same = fields == present  # then no copy is made
        self._columns = slice(None) if same else layout.columns(present, fields)

    def _augmentation(self, count: int) -> Augmentation:
        """A fresh one of `count` vehicles."""
        return make_augmentation(*self._recipe, count)

    def features(self, observation: Floats, start: Bools) -> Floats:
        """What the augmentation makes (N, F) of observations as `act` takes them."""
        read = np.ascontiguousarray(observation[:, : self._read])
        return self.augmentation.observe(read, start)

    def act(
        self, observation: Floats, state: AgentState | None, start: Bools
    ) -> tuple[Floats, AgentState]:
        """Sprocket torques or speeds over their limit, and the new state."""
        count = len(observation)
        if state is None or count != self.augmentation.count:
            self.augmentation = self._augmentation(count)
            self._frozen = None
        if state is not None and state is not self._latest:
            self.augmentation.restore(state.memories)
        self._latest = None  # until this call has ended well, `augmentation` is in no known state
        features = self.features(observation, start)
        before = None if state is None else state.recurrent
        if self._frozen is not None:
            rows, features_then, before_then = self._frozen
            rows &= ~start
            learned = np.isin(self.augmentation.feature_names, self.augmentation.learned)
            features = np.where(rows[:, None] & learned, features_then, features)
            before = merge_rows(before_then, before, rows)
        inputs = network_inputs(observation[:, self._columns], features)
        if self.normalisation is not None:
            inputs = self.normalisation(inputs)
        action, recurrent = self.model.predict(inputs, before, start, deterministic=True)
        self._last_call = features, recurrent
        commands = self.augmentation.command(np.asarray(action, np.float32), features)
        self._latest = AgentState(self.augmentation.memories(), recurrent)
        return commands, self._latest

    def freeze(self, rows: Bools) -> None:
        """Keep what has been learned of the vehicle in these rows (N,), until they start anew.

        That is the features of the augmentation that it calls `learned` (a history as a whole, of
        estimates the parameters and not the motion), and what a recurrent network remembers.
        """
        self.augmentation.freeze(rows)
        if self._last_call is not None:
            before, *values = self._frozen or (np.zeros_like(rows), *self._last_call)
            features, recurrent = merge_rows(tuple(values), self._last_call, before)
            self._frozen = rows | before, features, recurrent
