"""A trained agent as a file of ONNX [1], which drives where neither Python nor this package is.

    write_onnx(Path("runs/ppo-blind-seed0/agent.zip"), Path("ppo-blind.onnx"))
    inputs    observation (N, D): fields in SI units, NaN for what is not measured
              features (N, F): of an agent with an observer beside it, which `Observer` makes
              start (N,): rows that begin an episode, and state_NAME: what next_NAME was one
              period before (at the start anything); of an agent that remembers
    outputs   action (N, 2): left, right over the limit; command (N, 2): in N m or rad/s; next_NAME
Scaling, clipping, normalisation, past samples, and the correction of a residual agent are in the
graph. What the columns mean is in its metadata (`metadata_of`).
A network of another type needs a function that writes its nodes, registered with `write_nodes`.

References: [1] https://onnx.ai/onnx/operators
"""

import json
from collections.abc import Mapping, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from baselines.learned.agent_policy import (
    ANY_VEHICLE,
    LEARNED_SLIP,
    OBSERVER,
    Actor,
    AgentPolicy,
    Linear,
    Network,
    Normalisation,
    fields_of,
)
from baselines.learned.augmentation import (
    BASE,
    REMEMBERED,
    RESIDUAL_SCALE,
    Floats,
    History,
    PlainContext,
)
from baselines.learned.trained_agent import drive_of, groups_of, open_agent, read_recipe
from tracked_env import observation as layout
from tracked_env.physics.parameters import VEHICLES, PlantParameters

OPERATORS, FILE_FORMAT = 18, 9  # versions of ONNX, of 2022 and 2023: what most runtimes read
TORQUE = "tracked_env/Torque-v0"
COMMANDS = {"torque": ("torque_limit", "N m"), "speed": ("sprocket_speed_limit", "rad/s")}


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
    weights, bias = graph.constant(model.weights), graph.constant(model.bias)
    return graph.node("Gemm", inputs, weights, bias)


def _sigmoid(graph: Graph, value: str) -> str:
    """As `agent_policy` has it."""
    half = graph.constant(0.5)
    wave = graph.node("Tanh", graph.node("Mul", half, value))
    return graph.node("Mul", half, graph.node("Add", wave, graph.constant(1.0)))


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


def _normalised(graph: Graph, values: str, by: Normalisation) -> str:
    """In double precision, as in training."""
    deviation = graph.constant(np.sqrt(by.variance + by.epsilon), np.float64)
    mean = graph.constant(by.mean, np.float64)
    centred = graph.node("Sub", graph.cast(values, "DOUBLE"), mean)
    scaled = graph.cast(graph.node("Div", centred, deviation), "FLOAT")
    return graph.clipped(scaled, by.clip)


def _past_samples(graph: Graph, observation: str, names: list[str], lags: Any) -> str:
    """The features of `History` (N, lags * fields)."""
    shape = (int(lags[-1]) + 1, len(REMEMBERED))
    now = graph.columns(observation, [names.index(name) for name in REMEMBERED])
    now = graph.node("Unsqueeze", now, graph.constant([1], np.int64))
    before = graph.columns(graph.state("samples", now, *shape), range(shape[0] - 1))
    samples = graph.beside(now, before)
    graph.carry("samples", samples, *shape)
    width = graph.constant([0, len(lags) * shape[1]], np.int64)
    return graph.node("Reshape", graph.columns(samples, lags), width)


# The agent


def _fields(names: Sequence[str]) -> list[layout.Field]:
    known = {field.name: field for group in layout.GROUPS.values() for field in group.fields}
    return [known[name] for name in names]


def _scales(names: Sequence[str]) -> tuple[Floats, Floats]:
    """What is shown as 1, and at how much of it a field is clipped, (D,) each."""
    fields = _fields(names)
    scale = np.array([field.scale for field in fields])
    bound = np.array([field.bound for field in fields]) / scale
    return scale.astype(np.float32), bound.astype(np.float32)


def metadata_of(
    recipe: Mapping[str, Any], name: str, shown: Sequence[str], features: Sequence[str],
    observer: tuple[str, Mapping[str, Any]],
) -> dict[str, str]:  # fmt: skip
    """What the file says of an agent; lists and numbers as JSON.

    shown, features: the columns of the inputs. observer: kind and options of the augmentation that
    makes the features.
    """
    known, environment = drive_of(recipe), recipe.get("environment", {})
    config = recipe.get("config", {})
    limit, unit = COMMANDS[known.drive]
    size = f"{getattr(known.vehicle, limit):g} {unit}"
    action = (
        f"{known.drive} of the left and right sprocket over {size}; command: the same in {unit}"
    )
    kind, options = observer
    if kind == "residual":
        base = options.get("base", BASE) if known.drive == "torque" else "slc-adaptive"
        scale = options.get("scale", RESIDUAL_SCALE)
        action += f". It is that of {base}, the first two features, plus at most {scale:g} of the "
        action += "network's, within [-1, 1]"
    fields = [(field.name, field.unit, field.meaning) for field in _fields(shown)]
    vehicles = [one for one, values in VEHICLES.items() if values == known.vehicle]
    return {
        "agent": name,
        "seed": json.dumps(config.get("seed") if isinstance(config, dict) else None),
        "environment": str(environment.get("id", TORQUE)),
        "vehicle": vehicles[0] if vehicles else "of its own",
        "parameters": json.dumps(known.vehicle._asdict()),
        "drive": known.drive,
        "lateral": str(environment.get("lateral") or "sliding"),
        "control_rate": f"{1.0 / recipe['control_period']:.12g}",  # [Hz]
        "action": action,
        "observation": json.dumps(fields),
        "features": json.dumps([*features]),
        "observer": json.dumps(observer),
    }


def write_onnx(agent: Path, file: Path, name: str) -> dict[str, str]:
    """Write the agent of an archive as ONNX; returns its metadata.

    name: of the agent. Raises ImportError without the library onnx, ValueError for an archive that
    cannot be opened, for a learned observer, a policy for any vehicle or one that learned slip, and
    a network of an unknown type; OSError.
    """
    opened, recipe = open_agent(agent), read_recipe(agent)
    assert recipe is not None  # of what has been opened
    kind, options = recipe["augmentation"], recipe["augmentation_options"]
    if kind == OBSERVER:
        raise ValueError(
            f"agent {agent} is a learned observer: it corrects the filtered motion in front of a "
            "controller and commands nothing, so that alone it drives no robot"
        )
    if kind == ANY_VEHICLE:
        raise ValueError(
            f"agent {agent} is a policy for any vehicle: its network sees what a Kalman filter and "
            "regressions in compiled loops make of the observation. Use it from Python"
        )
    if kind == LEARNED_SLIP:
        raise ValueError(
            f"agent {agent} learned slip: its network corrects the filter of the pose and the "
            "controller that make what it sees, both in compiled loops. Use it from Python"
        )
    known, fields = drive_of(recipe), fields_of(groups_of(recipe))
    period, offered = recipe["control_period"], tuple(dict.fromkeys((*fields, *layout.NAMES)))
    policy = opened.make(PlainContext(*known, period, observation=offered))
    augmentation = policy.augmentation
    # The augmentation may read what the network does not see.
    shown = [*dict.fromkeys((*fields, *augmentation.needs))]
    features, graph, further = [*augmentation.feature_names], Graph(), list[str]()
    scale, bound = _scales(shown)
    observation = graph.measured(graph.input("observation", len(shown)))
    observation = graph.clipped(graph.node("Div", observation, graph.constant(scale)), bound)
    if isinstance(augmentation, History):
        kind = "blind"  # of the observer: the graph remembers
        options = {key: value for key, value in options.items() if key == "data_sheet"}
        features = features[len(augmentation.lags) * len(REMEMBERED) :]
        further.append(_past_samples(graph, observation, shown, augmentation.lags))
    if features:
        further.append(graph.measured(graph.input("features", len(features))))
    inputs = graph.columns(observation, range(len(fields)))
    if further:
        bounded = graph.clipped(graph.beside(*further), layout.FEATURE_BOUND)
        inputs = graph.beside(inputs, bounded)
    if policy.normalisation is not None:
        inputs = _normalised(graph, inputs, policy.normalisation)
    action = write_nodes(policy.model, graph, inputs)
    if kind == "residual":
        largest = graph.constant(options.get("scale", RESIDUAL_SCALE))
        base = graph.columns("features", range(2))
        action = graph.clipped(graph.node("Add", base, graph.node("Mul", action, largest)), 1.0)
    graph.output("action", action, 2)
    limit = graph.constant(getattr(known.vehicle, COMMANDS[known.drive][0]))
    graph.output("command", graph.node("Mul", action, limit), 2)
    metadata = metadata_of(recipe, name, shown, features, (kind, options))
    graph.write(file, metadata)
    return metadata


class Observer(AgentPolicy):
    """What makes the features of an exported agent, for one vehicle, from its metadata alone.

    sensors: the vehicle's own, an object with the attributes of `DataSheet`.
    """

    def __init__(self, metadata: Mapping[str, str], sensors: Any) -> None:
        self._names = [name for name, *_ in json.loads(metadata["observation"])]
        self._scale, self._bound = _scales(self._names)
        vehicle = PlantParameters(**json.loads(metadata["parameters"]))
        period, model = 1.0 / float(metadata["control_rate"]), metadata["lateral"]
        context = PlainContext(metadata["drive"], vehicle, period, model, sensors, self._names)
        kind, options = json.loads(metadata["observer"])
        network: Any = None  # it is in the file
        super().__init__(network, kind, options, context, groups={"shown": self._names})

    def __call__(self, observation: ArrayLike, start: bool) -> Floats:
        """Features (1, F) after an observation (D,) in SI units; `start` begins an episode."""
        scaled = np.clip(np.asarray(observation) / self._scale, -self._bound, self._bound)
        return self.features(self._view(scaled), np.array([start]))
