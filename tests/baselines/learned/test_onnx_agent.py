"""Exported networks: onnxruntime acts as `predict`, and a robot drives with them."""

import io
import json
import re
import zipfile

import gymnasium
import numpy as np
import pytest

from baselines.learned.agent_policy import ANY_VEHICLE, LEARNED_SLIP, OBSERVER, V0_GROUPS
from baselines.learned.learned_slip import OUTPUTS, UNITS, inputs_of
from baselines.learned.trained_agent import (
    APART,
    WEIGHTS,
    layers_at,
    open_agent,
    policy_around,
    read_recipe,
)
from baselines.learned.vehicle_features import DRIVES
from baselines.registry import shipped_agents
from tests.baselines.learned import networks
from tests.baselines.learned.test_forward_pass import CONTEXTS, OPTIONS, random_weights
from tracked_env import TERRAIN_ID, TORQUE_ID, arrays
from tracked_env import observation as obs
from tracked_env.physics.elementary import wrap_angle
from tracked_env.sensors import CHANNELS, make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

pytest.importorskip("onnx", reason="ONNX needs the extra `export`")
onnxruntime = pytest.importorskip("onnxruntime", reason="ONNX needs the extra `export`")

from baselines.learned.onnx_agent import Observer, open_onnx, write_onnx  # noqa: E402
from baselines.learned.onnx_graph import Graph, write_nodes  # noqa: E402

VEHICLES = 64


class Exported:
    """An exported agent that remembers by itself."""

    def __init__(self, file, threads=1):
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        self.session = onnxruntime.InferenceSession(str(file), options)
        self.metadata = self.session.get_modelmeta().custom_metadata_map
        self.fields = [name for name, *_ in json.loads(self.metadata["observation"])]
        self.features = len(json.loads(self.metadata["features"]))
        self.inputs = {one.name: one.shape[1:] for one in self.session.get_inputs()}
        self.outputs = [one.name for one in self.session.get_outputs()]
        self.state = {}

    def __call__(self, values, start, features=None, **further):
        """Outputs by name after SI values by name."""
        feed = {"features": features, "start": start, **further, **self.state}
        if "observation" in self.inputs:
            shown = [values[name] for name in self.fields]
            feed["observation"] = np.stack(shown, axis=1).astype(np.float32)
        for name, shape in self.inputs.items():
            if name not in feed:  # anything does where an episode starts
                feed[name] = np.full((len(start), *shape), 7.0, np.float32)
        outputs = self.session.run(None, {name: feed[name] for name in self.inputs})
        named = dict(zip(self.outputs, outputs, strict=True))
        self.state = {f"state_{name[5:]}": named[name] for name in named if name[:5] == "next_"}
        return named


def recording(policy, drive, steps, count=VEHICLES, seen=None, **changed):
    """Observations, starts and features of the policy's own drive, over several episodes; or what
    `seen` returns of action and state."""
    options = {**OPTIONS[drive], "duration": 10.0, "autoreset_mode": "SameStep", **changed}
    env = TrackedVehicleVectorEnv(count, **options)
    observation, _ = env.reset(seed=3)
    start, state, records = np.ones(count, dtype=bool), None, []
    for _ in range(steps):
        action, state = policy.predict(observation, state, start)
        noted = policy._last_call[0] if seen is None else seen(action, state)
        records.append((observation.copy(), start, noted))
        observation, _, terminated, truncated, _ = env.step(action)
        start = terminated | truncated
    return env.layout, records


def largest_difference(path, file, context, layout, records):
    """Of the exported network's actions from those of the agent's `predict`, with its features."""
    write_onnx(path, file, "agent")
    exported, policy, state, largest = Exported(file), open_agent(path).make(context), None, 0.0
    policy.augmentation = policy._augmentation(len(records[0][0]))
    limit = getattr(
        context.vehicle, f"{'torque' if context.drive == 'torque' else 'sprocket_speed'}_limit"
    )
    for observation, start, features in records:
        policy.augmentation.observe = lambda *_, features=features: features
        action, state = policy.predict(observation, state, start)
        split = features.shape[1] - exported.features
        named = exported(layout.unpack(observation), start, features[:, split:])
        largest = max(largest, float(np.abs(named["action"] - action).max()))
        np.testing.assert_allclose(named["command"], named["action"] * limit, rtol=1e-6)
    return largest


@pytest.mark.parametrize("name", ["ppo-blind", "ppo-estimates"])
def test_an_exported_agent_acts_as_predict(name, tmp_path):
    path, context = shipped_agents("torque")[name][0], CONTEXTS["torque"]
    layout, records = recording(open_agent(path).make(context), "torque", 600, 8, duration=4.0)
    assert sum(start.any() for _, start, _ in records) > 2  # episodes begin under way
    largest = largest_difference(path, tmp_path / "agent.onnx", context, layout, records)
    assert 0.0 < largest < 1e-6


class Witness:
    """The network of an archive; `last` has its latest inputs and outputs."""

    def __init__(self, path):
        self.layers = layers_at(path, read_recipe(path))
        self.size = self.layers.size

    def batch(self, count):
        network = self.layers.batch(count)

        def infer(features, hidden):
            self.last = features.copy(), network(features, hidden).copy()
            return self.last[1]

        return infer


def recording_apart(path, drive, steps, **changed):
    """Starts, inputs of the graph, and by name outputs and their scales, of the drive of an agent
    whose network stands among filters. SI are those that its policy works with."""
    recipe, network, context = read_recipe(path), Witness(path), CONTEXTS[drive]
    kind = recipe["augmentation"]
    policy = policy_around(network, kind, recipe["augmentation_options"], context)

    def seen(action, state):
        features, outputs = network.last
        inputs, expected = {"features": features}, {"outputs": (outputs, 1.0)}
        if kind == OBSERVER:
            of = policy.corrector
            corrections = of.shown - of.before
            corrections[:, 2] = wrap_angle(corrections[:, 2])
            expected["corrections"] = corrections, of.units.copy()
            expected["deviations"] = of.deviations.copy(), of.deviations.copy()
            return inputs, expected
        expected["action"] = action, 1.0
        if kind == ANY_VEHICLE:
            seen = policy.features
            inputs["steady"] = seen.steady.astype(np.float32)
            if drive == "speed":
                inputs["unit"] = seen.unit.astype(np.float32)
        else:
            limit = context.vehicle.sprocket_speed_limit
            expected |= {"command": (limit * action, limit), "motion": (state.added, UNITS)}
        return inputs, expected

    _, records = recording(policy, drive, steps, seen=seen, **changed)
    return [(start, *noted) for _, start, noted in records]


def with_network_of(path, records):
    """The same inputs with the outputs of another archive's network."""
    network, count = Witness(path), len(records[0][0])
    infer, hidden = network.batch(count), np.zeros((count, network.size), np.float32)
    for start, inputs, _ in records:
        hidden[start] = 0.0
        outputs = infer(inputs["features"], hidden).copy()
        expected = {"outputs": (outputs, 1.0)}
        if "unit" in inputs:
            most = DRIVES["speed"].most
            action = inputs["unit"] * np.clip(outputs, -most, most) + inputs["steady"]
            expected["action"] = np.clip(action, -1.0, 1.0), 1.0
        yield start, inputs, expected


def largest_differences(path, file, records):
    """Of outputs of the exported network by name from those of the built-in one, over scales."""
    write_onnx(path, file, "agent")
    exported, largest = Exported(file), {}
    for start, inputs, expected in records:
        named = exported({}, start, **inputs)
        for name, (values, scale) in expected.items():
            difference = float(np.abs((named[name] - values) / scale).max())
            largest[name] = max(largest.get(name, 0.0), difference)
    return largest


SHIPPED = [(drive, name) for drive in CONTEXTS for name in shipped_agents(drive)]
NO_ACTION = 2e-5  # bound of differences over what an output of 1 is


@pytest.mark.slow
@pytest.mark.parametrize(("drive", "name"), SHIPPED)
def test_every_shipped_agent_acts_as_predict_over_1e5_steps_in_onnxruntime(drive, name, tmp_path):
    """The first seed drives; the networks of all seeds see what it saw."""
    paths, context, file = shipped_agents(drive)[name], CONTEXTS[drive], tmp_path / "agent.onnx"
    steps = -(-100_000 // VEHICLES)
    kind = read_recipe(paths[0])["augmentation"]
    if kind in APART:
        records = recording_apart(paths[0], drive, steps)
    else:
        layout, records = recording(open_agent(paths[0]).make(context), drive, steps)
    for path in paths:
        if kind in APART:
            seen = records if path == paths[0] else with_network_of(path, records)
            largest = largest_differences(path, file, seen)
        else:
            largest = {"action": largest_difference(path, file, context, layout, records)}
        print(path.parent.name, {key: f"{value:.1e}" for key, value in largest.items()})
        for key, value in largest.items():
            is_action = key in ("action", "command") or (kind, drive) == (ANY_VEHICLE, "torque")
            assert value < (1e-6 if is_action else NO_ACTION), (path, key)


APART_AGENTS = [
    ("torque", "any-vehicle"),
    ("speed", "any-vehicle"),
    ("torque", "mpc-learned-observer"),
    ("speed", "learned-slip"),
    (TERRAIN_ID, "learned-slip"),
]


@pytest.mark.parametrize(("drive", "name"), APART_AGENTS)
def test_a_policy_made_of_its_file_alone_drives_as_the_shipped_one(drive, name, tmp_path):
    path, context = shipped_agents(drive)[name][0], CONTEXTS[drive]
    about = write_onnx(path, tmp_path / "agent.onnx", name)
    policy, state = open_onnx(tmp_path / "agent.onnx", context.sensors), None
    shipped, differences = open_agent(path).make(context), []
    layout, records = recording(shipped, drive, 120, 3, lambda action, _: action, duration=2.0)
    columns = layout.columns([field for field, *_ in json.loads(about["observation"])])
    for observation, start, expected in records:
        action, state = policy.predict(observation[:, columns], state, start)
        differences.append(np.abs(action - expected).max(axis=1))
    # Predictive control sometimes amplifies a difference in the last bit.
    share = 0.9 if "mpc" in name else 1.0
    assert 0.0 < np.quantile(differences, share) < 1e-6


def test_a_file_with_an_action_of_its_own_is_no_network_among_filters(tmp_path):
    write_onnx(shipped_agents("torque")["ppo-blind"][0], tmp_path / "a.onnx", "a")
    with pytest.raises(ValueError, match="has an action of its own"):
        open_onnx(tmp_path / "a.onnx", CONTEXTS["torque"].sensors)


def test_what_is_no_file_of_an_agent_is_one_line(tmp_path):
    file, sensors, graph = tmp_path / "a.onnx", CONTEXTS["torque"].sensors, Graph()
    with pytest.raises(FileNotFoundError):
        open_onnx(file, sensors)
    file.write_bytes(b"no")
    with pytest.raises(ValueError, match="cannot be read as ONNX"):
        open_onnx(file, sensors)
    graph.output("double", graph.times(graph.input("one", 1), 2.0), 1)
    graph.write(file, {"agent": "of another program"})
    with pytest.raises(ValueError, match="has no metadata of an agent"):
        open_onnx(file, sensors)


def archive(folder, recipe, weights):
    """An archive as train.py writes it."""
    with zipfile.ZipFile(folder / "agent.zip", "w") as file:
        file.writestr("recipe.json", json.dumps({"format": 2, "control_period": 0.02, **recipe}))
        np.savez(content := io.BytesIO(), **weights)
        file.writestr(WEIGHTS, content.getvalue())
    return folder / "agent.zip"


@pytest.mark.parametrize("recurrent", [True, False])
def test_a_network_that_forgets_and_one_that_sees_heights_are_in_their_files(recurrent, tmp_path):
    options = {"recurrent": recurrent, "heights": True}
    recipe = {"algorithm": None, "normalisation": None, "environment": {"id": TERRAIN_ID}}
    recipe |= {"augmentation": LEARNED_SLIP, "augmentation_options": options}
    weights = networks.random_weights(inputs_of(True), OUTPUTS)
    path = archive(tmp_path, recipe, weights)
    about, random = write_onnx(path, tmp_path / "a.onnx", "a"), np.random.default_rng(2)
    assert json.loads(about["features"])[-1] == json.loads(about["observation"])[-1][0]
    assert json.loads(about["outputs"])["motion"][2] == ["yaw_rate", "rad/s"]
    exported, network = Exported(tmp_path / "a.onnx"), layers_at(path, read_recipe(path))
    infer, hidden = network.batch(4), np.zeros((4, network.size), np.float32)
    for step in range(20):
        features = random.normal(size=(4, inputs_of(True))).astype(np.float32)
        found = exported({}, np.full(4, step == 0), features)
        np.testing.assert_allclose(found["outputs"], infer(features, hidden), atol=2e-6)
        np.testing.assert_allclose(found["next_hidden"], hidden, atol=1e-6)


SPLIT = {  # the network sees less than the augmentation reads, in an order of its own
    "reference": ["reference_yaw_rate", "reference_speed"],
    "pose_error": ["heading_error", "position_error_y", "position_error_x"],
    "drive": ["sprocket_speed_left", "sprocket_speed_right"],
}
WIDENED = {
    "history": ("history", {"lags": [1, 3]}, 30),
    "sheet": ("blind", {"data_sheet": True}, 5),
    "residual": ("residual", {"base": "mpc-adaptive", "scale": 0.05}, 32),
    "blind": ("blind", {}, 0),
}


def own_agent(folder, algorithm, activation, widened, groups, normalised):
    """The archive of an agent with random weights, as train.py writes it."""
    kind, options, width = WIDENED[widened]
    count, random = sum(map(len, groups.values())) + width, np.random.default_rng(5)
    spec = {"inputs": count, "hidden": [16, 8], "activation": activation}
    network, weights = random_weights(algorithm, spec)
    scaling = {"mean": random.normal(size=count).tolist(), "epsilon": 1e-8, "clip": 2.0}
    scaling["variance"] = (random.random(count) + 0.1).tolist()
    recipe = {
        **{"algorithm": algorithm, "network": network},
        **{"augmentation": kind, "augmentation_options": options, "observation": groups},
        "normalisation": scaling if normalised else None,
    }
    return archive(folder, recipe, weights)


@pytest.mark.parametrize(
    ("algorithm", "activation", "widened", "groups", "normalised"),
    [
        ("td3", "relu", "history", SPLIT, True),
        ("recurrent-ppo", "tanh", "sheet", V0_GROUPS, True),
        ("tqc", "relu", "history", V0_GROUPS, False),
        ("ppo", "tanh", "residual", V0_GROUPS, True),
    ],
)
def test_a_network_of_any_kind_acts_as_predict_in_its_file(
    algorithm, activation, widened, groups, normalised, tmp_path
):
    path = own_agent(tmp_path, algorithm, activation, widened, groups, normalised)
    sensors = {"preset": "rtk-outages", "pose_outage_gap": [0.5, 1.0], "velocity_measured": 0.0}
    layout, records = recording(
        open_agent(path).make(CONTEXTS["torque"]), "torque", 300, 8, duration=2.0, sensors=sensors
    )
    actions = tmp_path / "agent.onnx"
    assert 0.0 < largest_difference(path, actions, CONTEXTS["torque"], layout, records) < 1e-6


def test_what_is_not_measured_is_nan_and_counts_as_zero_and_fields_have_bounds(tmp_path):
    path = own_agent(tmp_path, "recurrent-ppo", "tanh", "blind", V0_GROUPS, True)
    write_onnx(path, tmp_path / "a.onnx", "a")
    start, actions = np.ones(1, dtype=bool), []
    for value in (0.0, np.nan, 1.0, 40.0, np.inf):
        values = {name: np.array([0.3]) for name in obs.NAMES}
        values["v_x"] = np.array([value])
        actions.append(Exported(tmp_path / "a.onnx")(values, start)["action"])
    np.testing.assert_array_equal(actions[0], actions[1])
    np.testing.assert_array_equal(actions[3], actions[4])
    assert np.isfinite(actions).all() and len(np.unique(actions, axis=0)) == 3


@pytest.mark.parametrize(
    ("drive", "name"),
    [
        ("torque", "ppo-estimates"),
        ("speed", "ppo-reckoned"),
    ],
)
def test_an_observer_from_the_metadata_makes_the_features_of_the_agent(drive, name, tmp_path):
    path, context = shipped_agents(drive)[name][0], CONTEXTS[drive]
    exported = write_onnx(path, tmp_path / "agent.onnx", name)
    observer = Observer(exported, context.sensors)
    layout, records = recording(open_agent(path).make(context), drive, 150, 1, duration=2.0)
    fields = [field for field, *_ in json.loads(exported["observation"])]
    for observation, start, features in records:
        values = layout.unpack(observation[0])
        made = observer([values[field] for field in fields], bool(start[0]))
        width = len(json.loads(exported["features"]))
        assert made.shape == (1, width)
        np.testing.assert_allclose(made, features[:, features.shape[1] - width :], atol=1e-5)


def test_metadata_say_what_goes_in_and_what_comes_out(tmp_path):
    path = own_agent(tmp_path, "ppo", "tanh", "residual", V0_GROUPS, True)
    write_onnx(path, tmp_path / "agent.onnx", "residual")
    exported = Exported(tmp_path / "agent.onnx")
    about, vehicle = exported.metadata, CONTEXTS["torque"].vehicle
    expected = {"agent": "residual", "vehicle": "strawa"}
    expected |= {"environment": "tracked_env/Torque-v0", "drive": "torque", "control_rate": "50"}
    expected["lateral"] = "sliding"
    assert expected.items() <= about.items()
    fields = json.loads(about["observation"])
    assert fields == [[f.name, f.unit, f.meaning] for f in obs.FIELDS]
    assert json.loads(about["features"])[:2] == ["adaptive_left", "adaptive_right"]
    assert json.loads(about["parameters"]) == vehicle._asdict()
    assert "that of mpc-adaptive, the first two features, plus at most 0.05" in about["action"]
    assert f"over {vehicle.torque_limit:g} N m" in about["action"]


def test_a_network_of_an_unknown_type_is_refused():
    with pytest.raises(ValueError, match="type int cannot be written"):
        write_nodes(3, Graph(), "inputs")


# The page


class Robot:
    """An environment in the place of a robot: samples as its sensors hold them, SI commands."""

    def __init__(self, env, policy):
        self.env, self.policy = env, policy
        self.observation, _ = env.reset(seed=5)
        self.floats = env.unwrapped.simulation.batch.floats[0]
        self.state, self.errors, self.differences, self.ages, self.time = None, [], [], [], 0.0
        self.action = self.over = self.stopped = False

    def values(self):
        return obs.unpack(self.observation)

    def read(self):
        shown = self.values()
        names = ("x", "y", "yaw")
        pose = [self.floats[arrays.SAMPLE + CHANNELS.index(name)] for name in names]
        read = {
            name: shown[name] for group in ("motion", "drive", "age") for name in V0_GROUPS[group]
        }
        return {**read, "pose": pose}

    def path(self, time):
        shown = self.values()
        groups = ("reference", "look_ahead")
        wanted = {name: shown[name] for group in groups for name in V0_GROUPS[group]}
        names = ("reference_x", "reference_y", "reference_yaw")
        return {**wanted, "pose": [self.floats[arrays.COLUMN[name]] for name in names]}

    def command(self, left, right):
        expected, self.state = self.policy.predict(self.observation, self.state)
        action = np.float32([left, right]) / CONTEXTS["torque"].vehicle.torque_limit
        self.differences.append(np.abs(expected - action).max())
        self.ages.append(self.values()["pose_age"])
        self.observation, _, ended, timed_out, info = self.env.step(action)
        self.errors.append(info["tracking_error"][0])
        self.over = ended or timed_out

    def stop(self):
        self.stopped = self.over = True

    def wait(self, period):
        self.time += period
        return not self.over


@pytest.mark.parametrize(("length", "ends_early"), [([3.0, 3.0], False), ([30.0, 30.0], True)])
def test_the_loop_of_the_page_drives_a_robot_through_outages_of_its_pose(
    length, ends_early, tmp_path, repository
):
    path = shipped_agents("torque")["ppo-estimates"][0]
    write_onnx(path, tmp_path / "agent.onnx", "agent")
    code = re.findall(
        r"```python\n(.*?)```", (repository / "docs/deploy.md").read_text(), re.DOTALL
    )
    exec(compile(code[0], "deploy.md", "exec"), page := {})
    sensors = {"preset": "rtk-outages", "pose_outage_gap": [2, 2], "pose_outage_length": length}
    env = gymnasium.make(TORQUE_ID, uncertainty="payload", sensors=sensors, duration=20.0)
    context = CONTEXTS["torque"]._replace(sensors=make_sensors(sensors))
    robot = Robot(env, open_agent(path).make(context))
    page["follow"](str(tmp_path / "agent.onnx"), robot, robot.path, context.sensors)
    assert robot.stopped == ends_early
    assert max(robot.differences) < 1e-5  # it sees the samples in double precision
    if ends_early:
        assert max(robot.ages) == pytest.approx(page["LONGEST_OUTAGE"], abs=0.05)
    else:
        assert max(robot.ages) > 2.5 and len(robot.errors) == 1000
        assert np.mean(robot.errors[500:]) < 0.15
