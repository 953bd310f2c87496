"""A trained agent as a file of ONNX [1], which drives where neither Python nor this package is.

    write_onnx(Path("runs/ppo-blind-seed0/agent.zip"), Path("ppo-blind.onnx"))
    inputs    observation (N, D): fields in SI units, NaN for what is not measured
              features (N, F): of an agent with an observer beside it, which `Observer` makes
              start (N,): rows that begin an episode, and state_NAME: what next_NAME was one
              period before (at the start anything); of an agent that remembers
    outputs   action (N, 2): left, right over the limit; command (N, 2): in N m or rad/s; next_NAME
Scaling, clipping, normalisation, past samples, and the correction of a residual agent are in the
graph. What the columns mean is in its metadata (`metadata_of`).

Three kinds (APART) stand among filters and controllers of this package. Their graph has no
`observation`, and `open_onnx` makes the whole policy of it. Outputs are `outputs`, what the network
says, without units, and
    observer        corrections (N, 6) of what the controller sees, deviations (N, 6) [SI]
    any-vehicle     action, with the input steady (N, 2), which `VehicleFeatures` adds to it, and
                    by speed unit (N, 2), by which it multiplies outputs
    learned-slip    action, command, motion (N, 3) [SI] that is added in the filter of the pose

References: [1] https://onnx.ai
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from baselines.learned import learned_observer, learned_slip, vehicle_features
from baselines.learned.agent_policy import (
    ANY_VEHICLE,
    OBSERVER,
    AgentPolicy,
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
from baselines.learned.gated_network import Infer, Layers
from baselines.learned.onnx_graph import Graph, write_nodes
from baselines.learned.trained_agent import (
    APART,
    Drive,
    drive_of,
    groups_of,
    layers_at,
    open_agent,
    policy_around,
    read_recipe,
)
from tracked_env import observation as layout
from tracked_env.physics.parameters import VEHICLES, PlantParameters

TORQUE, SLOPES = "tracked_env/Torque-v0", "tracked_env/Terrain-v0"
COMMANDS = {"torque": ("torque_limit", "N m"), "speed": ("sprocket_speed_limit", "rad/s")}


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


def _write_commands(graph: Graph, action: str, known: Drive) -> None:
    graph.output("action", action, 2)
    command = graph.times(action, getattr(known.vehicle, COMMANDS[known.drive][0]))
    graph.output("command", command, 2)


def _write_apart(network: Layers, recipe: Mapping[str, Any], file: Path, name: str) -> Any:
    """Write an agent of APART; returns its metadata."""
    kind, options = recipe["augmentation"], recipe["augmentation_options"]
    of: Any = {OBSERVER: learned_observer, ANY_VEHICLE: vehicle_features}.get(kind, learned_slip)
    heights = of.HEIGHTS if options.get("heights") else ()
    names, shown = [*of.FEATURES, *heights], [*layout.NAMES, *heights]
    graph, in_si, action = Graph(), dict[str, Sequence[str]](), ""
    seen = graph.input("features", len(names))
    said = write_nodes(network, graph, seen)
    graph.output("outputs", said, len(network.last_bias))
    if kind == OBSERVER:
        action = f"none: it corrects the filtered motion that {options['base']} sees"
        in_si = dict.fromkeys(("corrections", "deviations"), of.MOTION)
        pose, yaw = names.index("position_log_deviation"), names.index("yaw_log_deviation")
        # `u` of the pose are behind logarithms in the features, those of the speeds are constants.
        logarithms = graph.columns(seen, [pose, pose, yaw, yaw, yaw, yaw])
        units = graph.node("Exp", graph.times(logarithms, [2.0] * 3 + [0.0] * 3))
        units = graph.times(units, [*np.repeat(of.UNITS_AS_ZERO, [2, 1]), *of.SPEED_UNITS])
        limited = graph.clipped(graph.columns(said, range(6)), of.LIMIT)
        graph.output("corrections", graph.node("Mul", limited, units), 6)
        bounds = map(graph.constant, of.SPREADS)
        spread = graph.node("Exp", graph.node("Clip", graph.columns(said, range(6, 12)), *bounds))
        graph.output("deviations", graph.node("Mul", spread, units), 6)
    elif kind == ANY_VEHICLE:
        drive = drive_of(recipe).drive
        action = f"{drive} of the left and right sprocket over the limit of the vehicle it drives"
        scaled = said
        if drive == "speed":
            names = [*of.FEATURES_BY_SPEED]
            limited = graph.clipped(said, of.DRIVES[drive].most)
            scaled = graph.node("Mul", limited, graph.input("unit", 2))
        total = graph.node("Add", scaled, graph.input("steady", 2))
        graph.output("action", graph.clipped(total, 1.0), 2)
    else:
        if recipe["environment"]["id"] == SLOPES:
            shown[layout.SIZE : layout.SIZE] = of.ATTITUDE
        in_si = {"motion": [*of.MOTION]}
        uc = graph.columns(seen, [names.index("uc_left"), names.index("uc_right")])
        added = graph.times(graph.columns(said, range(2)), of.ACTION)
        total = graph.node("Add", graph.times(uc, 1.0 / of.UC_SHOWN), added)
        _write_commands(graph, graph.clipped(total, 1.0), drive_of(recipe))
        motion = graph.columns(said, range(2, of.OUTPUTS))
        graph.output("motion", graph.times(motion, of.UNITS), len(of.MOTION))
    metadata = metadata_of(recipe, name, shown, names, (kind, options))
    metadata["action"] = action or metadata["action"]
    metadata["vehicle"] = "any" if kind == ANY_VEHICLE else metadata["vehicle"]
    metadata["scaling"] = f"without units, as {of.__name__} has it, within {of.BOUND:g} of 0"
    outputs = {one: [(f.name, f.unit) for f in _fields(each)] for one, each in in_si.items()}
    metadata["outputs"] = json.dumps(outputs)
    graph.write(file, metadata)
    return metadata


def write_onnx(agent: Path, file: Path, name: str) -> dict[str, str]:
    """Write the agent of an archive as ONNX; returns its metadata.

    name: of the agent. Raises ImportError without the library onnx, ValueError for an archive that
    cannot be opened and a network of an unknown type; OSError.
    """
    opened, recipe = open_agent(agent), read_recipe(agent)
    assert recipe is not None  # of what has been opened
    kind, options = recipe["augmentation"], recipe["augmentation_options"]
    if kind in APART:
        return _write_apart(layers_at(agent, recipe), recipe, file, name)
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
    _write_commands(graph, action, known)
    metadata = metadata_of(recipe, name, shown, features, (kind, options))
    graph.write(file, metadata)
    return metadata


def context_of(metadata: Mapping[str, str], sensors: Any) -> PlainContext:
    """What a policy needs to know: sensors are the vehicle's own, with the attributes of
    `DataSheet`."""
    vehicle = PlantParameters(**json.loads(metadata["parameters"]))
    period, names = 1.0 / float(metadata["control_rate"]), json.loads(metadata["observation"])
    shown = tuple(name for name, *_ in names)
    return PlainContext(metadata["drive"], vehicle, period, metadata["lateral"], sensors, shown)


class Observer(AgentPolicy):
    """What makes the features of an exported agent, for one vehicle, from its metadata alone.

    sensors: the vehicle's own, an object with the attributes of `DataSheet`.
    """

    def __init__(self, metadata: Mapping[str, str], sensors: Any) -> None:
        context = context_of(metadata, sensors)
        self._scale, self._bound = _scales(context.observation)
        kind, options = json.loads(metadata["observer"])
        network: Any = None  # it is in the file
        super().__init__(network, kind, options, context, groups={"shown": context.observation})

    def __call__(self, observation: ArrayLike, start: bool) -> Floats:
        """Features (1, F) after an observation (D,) in SI units; `start` begins an episode."""
        scaled = np.clip(np.asarray(observation) / self._scale, -self._bound, self._bound)
        return self.features(self._view(scaled), np.array([start]))


class OnnxNetwork:
    """The network of a file in the place of `Layers`. session: of onnxruntime."""

    def __init__(self, session: Any) -> None:
        self._run, self._inputs = session.run, [one.name for one in session.get_inputs()]
        self.size = session.get_inputs()[self._inputs.index("state_hidden")].shape[1]

    def batch(self, count: int) -> Infer:
        """The network of `count` vehicles, whose hidden values the policy sets to 0 at a start."""
        added = np.zeros((count, 2), np.float32)  # what only `action` depends on
        other = {"steady": added, "unit": added, "start": np.zeros(count, bool)}

        def infer(features: Floats, hidden: Floats) -> Any:
            feed = {**other, "features": features, "state_hidden": hidden}
            feed = {name: feed[name] for name in self._inputs}
            outputs, hidden[:] = self._run(["outputs", "next_hidden"], feed)
            return outputs

        return infer


def open_onnx(file: Path, sensors: Any) -> Any:
    """The whole policy of a file of APART, whose network onnxruntime computes.

    sensors: as for `Observer`. Raises ImportError without the library onnxruntime, OSError, and
    ValueError for a file of another kind or of another program.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise ImportError(f"{error}; ONNX needs pip install 'tracked-env[export]'") from error

    content = Path(file).read_bytes()
    try:
        session = onnxruntime.InferenceSession(content)
    except Exception as error:  # its errors have no class of their own but this
        raise ValueError(f"{file} cannot be read as ONNX: {error}") from error
    metadata = session.get_modelmeta().custom_metadata_map
    if "observer" not in metadata:
        raise ValueError(f"{file} has no metadata of an agent; must be of `tracked-env export`")
    kind, options = json.loads(metadata["observer"])
    if kind not in APART:
        raise ValueError(f"{file} has an action of its own; features are made by `Observer`")
    return policy_around(OnnxNetwork(session), kind, options, context_of(metadata, sensors))
