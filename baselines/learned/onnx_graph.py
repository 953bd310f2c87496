"""The graph of an ONNX file [1], and the nodes of the networks in it.

A network of another type needs a function that writes its nodes, registered with `write_nodes`.

References: [1] https://onnx.ai/onnx/operators
"""

from collections.abc import Mapping
from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from baselines.learned.agent_policy import Actor, Linear, Network
from baselines.learned.gated_network import FLAT, TANH_P, TANH_Q, Layers

OPERATORS, FILE_FORMAT = 18, 9  # versions of ONNX, of 2022 and 2023: what most runtimes read


class Graph:
    """Nodes of ONNX in the order in which they are computed; a value is known by its name."""

    def __init__(self) -> None:
        try:
            from onnx import TensorProto, helper, numpy_helper
        except ImportError as error:
            raise ImportError(f"{error}; ONNX needs pip install 'tracked-env[export]'") from error
        self._types, self._helper, self._as_tensor = TensorProto, helper, numpy_helper.from_array
        self._nodes: list[Any] = []
        self._constants: list[Any] = []
        self.inputs: dict[str, Any] = {}
        self._outputs: dict[str, Any] = {}

    def constant(self, values: ArrayLike, kind: Any = np.float32) -> str:
        """A constant of the file."""
        name = f"constant_{len(self._constants)}"
        self._constants.append(self._as_tensor(np.asarray(values, kind), name))
        return name

    def node(self, operator: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """The result of an operator, under a name of its own unless `output` is given."""
        name = output or f"{operator}_{len(self._nodes)}"
        node = self._helper.make_node(operator, list(inputs), [name], name, **attributes)
        self._nodes.append(node)
        return name

    def input(self, name: str, *shape: int, kind: str = "FLOAT") -> str:
        """An input (N, *shape)."""
        self.inputs[name] = self._value(name, shape, kind)
        return name

    def output(self, name: str, value: str, *shape: int) -> None:
        """A value (N, *shape) as an output."""
        self.node("Identity", value, output=name)
        self._outputs[name] = self._value(name, shape, "FLOAT")

    def _value(self, name: str, shape: tuple[int, ...], kind: str) -> Any:
        sizes = ["N", *shape]
        return self._helper.make_tensor_value_info(name, getattr(self._types, kind), sizes)

    def state(self, name: str, initial: str, *shape: int) -> str:
        """What `carry` has handed on under this name; `initial` in the rows that start."""
        before = self.input(f"state_{name}", *shape)
        if "start" not in self.inputs:
            self.input("start", kind="BOOL")
        axes = self.constant(range(1, 1 + len(shape)), np.int64)
        return self.node("Where", self.node("Unsqueeze", "start", axes), initial, before)

    def carry(self, name: str, value: str, *shape: int) -> None:
        """Hand a value (N, *shape) on to the next call."""
        self.output(f"next_{name}", value, *shape)

    def affine(self, value: str, weights: ArrayLike, bias: ArrayLike) -> str:
        """value (N, K) weights (K, M) + bias (M,)."""
        return self.node("Gemm", value, self.constant(weights), self.constant(bias))

    def times(self, value: str, factor: ArrayLike) -> str:
        """A value times one number or one of each column."""
        return self.node("Mul", value, self.constant(factor))

    def columns(self, value: str, columns: ArrayLike) -> str:
        """Some columns of a value (N, K)."""
        return self.node("Gather", value, self.constant(columns, np.int64), axis=1)

    def beside(self, *values: str) -> str:
        """Values (N, K) beside each other."""
        return self.node("Concat", *values, axis=1) if len(values) > 1 else values[0]

    def cast(self, value: str, kind: str) -> str:
        """A value as FLOAT or DOUBLE."""
        return self.node("Cast", value, to=getattr(self._types, kind))

    def clipped(self, value: str, bound: ArrayLike) -> str:
        """A value within [-bound, bound], which is one number or one of each column."""
        high = np.asarray(bound, np.float32)
        return self.node("Max", self.node("Min", value, self.constant(high)), self.constant(-high))

    def measured(self, value: str) -> str:
        """A value with 0 for NaN."""
        return self.node("Where", self.node("IsNaN", value), self.constant(0.0), value)

    def write(self, file: Path, metadata: Mapping[str, str]) -> None:
        """Write the file. Raises OSError."""
        import onnx

        graph = self._helper.make_graph(
            self._nodes,
            metadata["agent"],
            [*self.inputs.values()],
            [*self._outputs.values()],
            self._constants,
        )
        operators = [self._helper.make_opsetid("", OPERATORS)]
        model = self._helper.make_model(graph, opset_imports=operators, ir_version=FILE_FORMAT)
        model.producer_name = "tracked-env"
        self._helper.set_model_props(model, dict(metadata))
        onnx.checker.check_model(model, full_check=True)
        file.write_bytes(model.SerializeToString())


# Nodes of the networks


@singledispatch
def write_nodes(model: Any, graph: Graph, inputs: str) -> str:
    """Write the nodes of a network into the graph; returns the name of its outputs.

    inputs: what the network sees, (N, K). Raises ValueError for a type that is not registered.
    """
    raise ValueError(f"a network of the type {type(model).__name__} cannot be written as ONNX")


@write_nodes.register(Linear)
def _linear(model: Linear, graph: Graph, inputs: str) -> str:
    return graph.affine(inputs, model.weights, model.bias)


def _tanh(graph: Graph, value: str) -> str:
    """As `gated_network` has it: gates near 1 are so long a memory that its last bit counts."""
    x = graph.clipped(value, FLAT)
    square = graph.node("Mul", x, x)

    def polynomial(coefficients: Any) -> str:
        value = graph.constant(coefficients[-1])
        for number in coefficients[-2::-1]:
            value = graph.node("Add", graph.node("Mul", square, value), graph.constant(number))
        return value

    return graph.node("Div", graph.node("Mul", x, polynomial(TANH_P)), polynomial(TANH_Q))


def _sigmoid(graph: Graph, value: str, tanh: Any = None) -> str:
    """As `agent_policy` has it, or with another tanh as `gated_network`."""
    half = graph.constant(0.5)
    scaled = graph.node("Mul", half, value)
    wave = graph.node("Tanh", scaled) if tanh is None else tanh(graph, scaled)
    return graph.node("Mul", half, graph.node("Add", wave, graph.constant(1.0)))


@write_nodes.register(Layers)
def _gated(model: Layers, graph: Graph, inputs: str) -> str:
    size = model.size
    hidden = graph.state("hidden", graph.constant(0.0), size)
    if not model.recurrent:
        hidden = graph.times(hidden, 0.0)
    sums = (
        graph.affine(inputs, model.from_inputs, model.input_bias),
        graph.affine(hidden, model.from_hidden, model.hidden_bias),
    )
    gates = graph.node("Add", *(graph.columns(each, range(2 * size)) for each in sums))
    gates = _sigmoid(graph, gates, _tanh)
    r, z = graph.columns(gates, range(size)), graph.columns(gates, range(size, 2 * size))
    x_n, h_n = (graph.columns(each, range(2 * size, 3 * size)) for each in sums)
    n = _tanh(graph, graph.node("Add", x_n, graph.node("Mul", r, h_n)))
    hidden = graph.node("Add", n, graph.node("Mul", z, graph.node("Sub", hidden, n)))
    graph.carry("hidden", hidden, size)
    middle = graph.affine(graph.beside(hidden, inputs), model.middle, model.middle_bias)
    return graph.affine(graph.node("Relu", middle), model.last, model.last_bias)


@write_nodes.register(Network)
def _network(model: Network, graph: Graph, inputs: str) -> str:
    if model.gates:
        number = sum(name.startswith("state_hidden") for name in graph.inputs)
        size, zero = model.size, graph.constant(0.0)
        hidden, cell = (graph.state(f"{of}_{number}", zero, size) for of in ("hidden", "cell"))
        of_inputs, of_hidden = model.gates
        gates = graph.node(
            "Add", write_nodes(of_inputs, graph, inputs), write_nodes(of_hidden, graph, hidden)
        )
        admit, forget, candidate, release = (
            graph.columns(gates, range(k * size, (k + 1) * size)) for k in range(4)
        )
        kept = graph.node("Mul", _sigmoid(graph, forget), cell)
        added = graph.node("Mul", _sigmoid(graph, admit), graph.node("Tanh", candidate))
        cell = graph.node("Add", kept, added)
        hidden = graph.node("Mul", _sigmoid(graph, release), graph.node("Tanh", cell))
        for name, value in (("hidden", hidden), ("cell", cell)):
            graph.carry(f"{name}_{number}", value, size)
        inputs = graph.beside(hidden, inputs)
    for layer in model.layers[:-1]:
        operator = {"tanh": "Tanh", "relu": "Relu"}[model.activation]
        inputs = graph.node(operator, write_nodes(layer, graph, inputs))
    return write_nodes(model.layers[-1], graph, inputs)


@write_nodes.register(Actor)
def _actor(model: Actor, graph: Graph, inputs: str) -> str:
    action = write_nodes(model.network, graph, inputs)
    return graph.node("Tanh", action) if model.squashed else graph.clipped(action, 1.0)
