"""Exported networks: onnxruntime acts as `predict`, and a robot drives with them."""

import io
import json
import re
import zipfile

import gymnasium
import numpy as np
import pytest

from baselines.learned.agent_policy import V0_GROUPS
from baselines.learned.trained_agent import WEIGHTS, open_agent
from baselines.registry import shipped_agents
from tests.baselines.learned.test_forward_pass import CONTEXTS, FAMILIES, OPTIONS, random_weights
from tracked_env import TORQUE_ID, arrays
from tracked_env import observation as obs
from tracked_env.sensors import CHANNELS, make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

pytest.importorskip("onnx", reason="ONNX needs the extra `export`")
onnxruntime = pytest.importorskip("onnxruntime", reason="ONNX needs the extra `export`")

from baselines.learned.onnx_agent import Graph, Observer, write_nodes, write_onnx  # noqa: E402

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

    def __call__(self, values, start, features=None):
        """Outputs by name after SI values by name."""
        shown = np.stack([values[name] for name in self.fields], axis=1).astype(np.float32)
        feed = {"observation": shown, "features": features, "start": start, **self.state}
        for name, shape in self.inputs.items():
            if name not in feed:  # anything does where an episode starts
                feed[name] = np.full((len(shown), *shape), 7.0, np.float32)
        outputs = self.session.run(None, {name: feed[name] for name in self.inputs})
        named = dict(zip(self.outputs, outputs, strict=True))
        self.state = {f"state_{name[5:]}": named[name] for name in named if name[:5] == "next_"}
        return named


def recording(policy, drive, steps, count=VEHICLES, **changed):
    """Observations, starts and features of the policy's own drive, over several episodes."""
    options = {**OPTIONS[drive], "duration": 10.0, "autoreset_mode": "SameStep", **changed}
    env = TrackedVehicleVectorEnv(count, **options)
    observation, _ = env.reset(seed=3)
    start, state, records = np.ones(count, dtype=bool), None, []
    for _ in range(steps):
        action, state = policy.predict(observation, state, start)
        records.append((observation.copy(), start, policy._last_call[0]))
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


# The network of the other one feeds back into the filter: refused, see test_slip_training.
EXPORTED = [(drive, name) for drive, name in FAMILIES if name != "learned-slip"]


@pytest.mark.slow
@pytest.mark.parametrize(("drive", "name"), EXPORTED)
def test_every_shipped_agent_acts_as_predict_over_1e5_steps_in_onnxruntime(drive, name, tmp_path):
    """The first seed drives; the networks of all seeds see what it saw."""
    paths, context = shipped_agents(drive)[name], CONTEXTS[drive]
    steps = -(-100_000 // VEHICLES)
    layout, records = recording(open_agent(paths[0]).make(context), drive, steps)
    for path in paths:
        largest = largest_difference(path, tmp_path / "agent.onnx", context, layout, records)
        print(f"{path.parent.name} {largest:.2e}")
        assert largest < 1e-6, path


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
        **{"format": 2, "algorithm": algorithm, "network": network, "control_period": 0.02},
        **{"augmentation": kind, "augmentation_options": options, "observation": groups},
        "normalisation": scaling if normalised else None,
    }
    with zipfile.ZipFile(folder / "agent.zip", "w") as archive:
        archive.writestr("recipe.json", json.dumps(recipe))
        np.savez(content := io.BytesIO(), **weights)
        archive.writestr(WEIGHTS, content.getvalue())
    return folder / "agent.zip"


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
