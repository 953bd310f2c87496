"""A recurrent network of one gated layer, from its weights to its outputs, in single precision.

    h' = GRU(x, h),   y = W relu(V [h', x] + c) + b          gates [1], order as torch.nn.GRU
A network that is not recurrent has h = 0 in every step. Weights have the names and shapes of
PyTorch. Sums run in the same order for any number of vehicles, so a batch has the bits of its
single rows.

References: [1] Cho et al., arXiv:1406.1078.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from baselines.batch_policy import Floats
from baselines.learned.agent_policy import Arrays, check_weights
from baselines.learned.matrix_product import linear
from tracked_env.physics.jit import BoundOnce, copy_entries, fill_entries, formula, loop

# Outputs (N, Y) of inputs (N, F) and hidden (N, H), float32; hidden in and out.
Infer = Callable[[Floats, Floats], Floats]


class RecurrentNetwork(Protocol):
    """What policies take: `Layers`, or what another library computes in their place."""

    @property
    def size(self) -> int: ...
    def batch(self, count: int) -> Infer: ...


class Layers(NamedTuple):
    """The network, float32, columns by output."""

    from_inputs: Floats  # (F, 3 H) gates r, z, n
    input_bias: Floats
    from_hidden: Floats  # (H, 3 H)
    hidden_bias: Floats
    middle: Floats  # (H + F, M)
    middle_bias: Floats
    last: Floats  # (M, Y)
    last_bias: Floats
    recurrent: bool

    @property
    def size(self) -> int:
        """H, how many numbers it carries on."""
        return len(self.from_hidden)

    def batch(self, count: int) -> "BatchNetwork":
        """The network of `count` vehicles."""
        return BatchNetwork(self, count)


# tanh x = x P(x^2) / Q(x^2) in single precision, the approximation of Eigen (3 ulp); |x| beyond
# FLAT is 1 there.
FLAT = np.float32(7.905311)
TANH_P = _P0, _P1, _P2, _P3, _P4, _P5, _P6 = np.array(
    [4.89352455891786e-03, 6.37261928875436e-04, 1.48572235717979e-05, 5.12229709037114e-08,
     -8.60467152213735e-11, 2.00018790482477e-13, -2.76076847742355e-16], np.float32,
)  # fmt: skip
TANH_Q = _Q0, _Q1, _Q2, _Q3 = np.array(
    [4.89352518554385e-03, 2.26843463243900e-03, 1.18534705686654e-04, 1.19825839466702e-06],
    np.float32,
)
_HALF, _ZERO = np.float32(0.5), np.float32(0.0)


@formula
def _tanh(x):
    x = min(max(x, -FLAT), FLAT)
    y = x * x
    p = _P0 + y * (_P1 + y * (_P2 + y * (_P3 + y * (_P4 + y * (_P5 + y * _P6)))))
    return x * p / (_Q0 + y * (_Q1 + y * (_Q2 + y * _Q3)))


@formula
def _sigmoid(x):
    return _HALF * _tanh(_HALF * x) + _HALF


@loop
def infer(inputs, hidden, net, gates, joined, between, outputs):
    """outputs (N, Y) from inputs (N, F); hidden (N, H) in and out. Room: gates (2, N, 3 H), joined
    (N, H + F), between (N, M)."""
    size = hidden.shape[1]
    if not net.recurrent:
        for i in range(hidden.shape[0]):
            fill_entries(hidden[i], _ZERO)
    linear(inputs, net.from_inputs, net.input_bias, gates[0])
    linear(hidden, net.from_hidden, net.hidden_bias, gates[1])
    for i in range(hidden.shape[0]):
        h, a, b = hidden[i], gates[0, i], gates[1, i]
        for j in range(2 * size):
            a[j] = _sigmoid(a[j] + b[j])
        for j in range(size):
            n = _tanh(a[2 * size + j] + a[j] * b[2 * size + j])
            h[j] = n + a[size + j] * (h[j] - n)
        copy_entries(h, joined[i])
        copy_entries(inputs[i], joined[i, size:])
    linear(joined, net.middle, net.middle_bias, between)
    for i in range(hidden.shape[0]):
        for j in range(between.shape[1]):
            between[i, j] = max(between[i, j], _ZERO)
    linear(between, net.last, net.last_bias, outputs)


def layers_of(weights: Arrays, inputs: int, outputs: int, recurrent: bool = True) -> Layers:
    """A network from its WEIGHTS, named and shaped as PyTorch has them. Raises ValueError."""
    weights = {name: value.astype(np.float32) for name, value in weights.items()}
    hidden, middle = weights["gru.weight_hh_l0"].shape[-1], weights["middle.bias"].shape[0]
    shapes = {
        "gru.weight_ih_l0": (3 * hidden, inputs), "gru.weight_hh_l0": (3 * hidden, hidden),
        "gru.bias_ih_l0": (3 * hidden,), "gru.bias_hh_l0": (3 * hidden,),
        "middle.weight": (middle, hidden + inputs), "middle.bias": (middle,),
        "last.weight": (outputs, middle), "last.bias": (outputs,),
    }  # fmt: skip
    check_weights(weights, shapes)
    order = (
        "gru.weight_ih_l0", "gru.bias_ih_l0", "gru.weight_hh_l0", "gru.bias_hh_l0",
        "middle.weight", "middle.bias", "last.weight", "last.bias",
    )  # fmt: skip
    parts: list[Any] = [np.ascontiguousarray(weights[name].T) for name in order]
    return Layers(*parts, bool(recurrent))  # type: ignore[call-arg]


class BatchNetwork:
    """The network for `count` vehicles, with the room that it needs."""

    def __init__(self, layers: Layers, count: int) -> None:
        self.layers = layers
        hidden, inputs = layers.from_hidden.shape[0], layers.from_inputs.shape[0]
        sizes = (2, count, 3 * hidden), (count, hidden + inputs), (count, len(layers.middle_bias))
        self._room = tuple(np.empty(size, dtype=np.float32) for size in sizes)
        self.outputs = np.zeros((count, len(layers.last_bias)), dtype=np.float32)
        self._infer = BoundOnce(infer)

    def __call__(self, inputs: Floats, hidden: Floats) -> Floats:
        """Outputs (N, M) of inputs (N, F), which the next call overwrites; hidden (N, H) in and
        out."""
        self._infer(inputs, hidden, self.layers, *self._room, self.outputs)
        return self.outputs
