"""The training of the policy that learned slip: its teacher, its targets, its archive."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from agents import fine_tuning, regression, slip_training  # noqa: E402  needs torch
from agents.slip_training import KNOWN, LearnedSlip, Scene  # noqa: E402
from baselines import registry  # noqa: E402
from baselines.learned.learned_slip import FEATURES, OUTPUTS, UNITS, LearnedSlipPolicy  # noqa: E402
from baselines.learned.trained_agent import open_agent, read_recipe  # noqa: E402
from tracked_env import SPEED_ID, TERRAIN, TERRAIN_ID  # noqa: E402
from tracked_env.benchmark.policy_interface import PolicyContext  # noqa: E402
from tracked_env.observation import make_layout  # noqa: E402
from tracked_env.physics.parameters import VEHICLES  # noqa: E402
from tracked_env.sensors import PRESETS  # noqa: E402

TINY = "--episodes 16 --further 16 --rounds 1 --last-epochs 1 --batch 8 --chunk 40 --seed 3"
SHOWN = (*TERRAIN["observation"], "height_scan")
CONTEXT = PolicyContext(
    0.02, "sliding", PRESETS["mocap"], "speed", VEHICLES["focchi"], make_layout(SHOWN).names
)


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(regression, "DURATION", 3.0)
    monkeypatch.setattr(LearnedSlip, "job", 16)


def only(monkeypatch, sensors, env=TERRAIN_ID):
    """Every job of an environment has these sensors, and no goals, which 3 s are too short for."""
    world = slip_training.WORLDS[env]
    changed = world._replace(sensors=((1.0, sensors),), references=((1.0, world.references[0][1]),))
    monkeypatch.setitem(slip_training.WORLDS, env, changed)


def options(folder, more=""):
    return slip_training.parse([*TINY.split(), "--output", str(folder), *more.split()])


def job(count=16, number=0):
    return regression.Job(number, 2**41 + 16 * number, count, False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "median", "most"),
    [(TERRAIN_ID, 0.02, 0.05), (SPEED_ID, 0.008, 0.02)],  # some are stuck on soft ground of hills
)
def test_the_teacher_keeps_every_vehicle_on_its_path(env, median, most, tmp_path, monkeypatch):
    """Told pose and soil, without a fresh pose in what the policy sees."""
    monkeypatch.setattr(regression, "DURATION", 9.0)
    only(monkeypatch, {"preset": "mocap", "pose_rate": 0.1}, env)
    chosen = options(tmp_path, f"--env {env}")
    task = LearnedSlip(chosen)
    scene = Scene(task.layers(task.network.weights()), job(24), chosen)
    column, away = scene.simulation.batch.column, []
    for _ in range(440):
        scene.step(scene.teach()[0])
        gone = np.hypot(column("reference_x") - column("x"), column("reference_y") - column("y"))
        away.append(gone)
    settled = np.sqrt(np.mean(np.square(away[250:]), axis=0))
    scene.env.close()
    assert np.median(settled) < median
    assert np.quantile(settled, 0.8) < most


def test_what_is_taken_down_is_the_teachers_action_and_the_motion_that_sensors_lack(tmp_path):
    task = LearnedSlip(options(tmp_path))
    driven = task.drive(None, job())
    assert driven.features.shape == (16, 150, len(FEATURES))
    assert driven.targets.shape == (16, 150, OUTPUTS + len(KNOWN))
    assert (np.abs(driven.targets) <= slip_training.LARGEST_TARGET).all()
    assert (driven.lengths > 50).all()
    again = task.drive(None, job())
    assert all(np.array_equal(one, other) for one, other in zip(driven, again, strict=True))
    # Uc drives some; where tracks do not slip, belts and gyro lack nothing.
    motion = driven.targets[:, 20:-1, 2:OUTPUTS].astype(float) * UNITS
    assert 0.001 < np.abs(motion).mean() < 0.1


def test_filter_and_target_fit_together(tmp_path, monkeypatch):
    """With the target as what the network says, the carried error stays the true one."""
    only(monkeypatch, {"preset": "ideal", "pose_rate": 0.1})
    chosen = options(tmp_path)
    task = LearnedSlip(chosen)
    scene = Scene(task.layers(task.network.weights()), job(8), chosen)
    exact, before = np.zeros((8, 3)), None
    for _ in range(140):
        _, uc = scene.see()
        _, true = scene.teach()
        if before is not None:  # the next motion is about the last one
            exact = scene.policy.unknown_motion(before, true)
        before = true
        scene.learner = scene.learner._replace(added=exact)
        left = np.abs(scene.learner.driving.error - true)
        scene.step(uc)
    scene.env.close()
    assert np.median(left[:, :2]) < 0.005
    assert np.median(left[:, 2]) < 0.01


def test_a_training_makes_an_archive_that_drives_without_torch(tmp_path, monkeypatch):
    folder = tmp_path / "Terrain-v0" / "learned-slip-seed3"
    chosen = options(folder, "--heights")
    regression.train(chosen, LearnedSlip(chosen))
    policy = open_agent(folder / "agent.zip").make(CONTEXT)
    assert isinstance(policy, LearnedSlipPolicy)
    monkeypatch.setattr(registry, "PRETRAINED", tmp_path)
    known = registry.policies()["tracked_env/Terrain-v0"]
    assert known["learned-slip"] == [folder / "agent.zip"]
    with pytest.raises(ValueError, match="takes its torque"):
        open_agent(folder / "agent.zip").make(CONTEXT._replace(drive="torque"))
    with pytest.raises(ValueError, match="is no policy for any vehicle"):
        fine_tuning.load(folder / "agent.zip")
    curve = (folder / "curve.csv").read_text(encoding="utf-8").splitlines()
    assert curve[0] == "round,epoch,loss,action,motion,slow_action,slow_motion"
    # The network that drives is the one that was trained.
    rng, task = np.random.default_rng(1), LearnedSlip(chosen)
    trained = regression.Regression(chosen, task)
    trained.mean.load_state_dict(torch.load(folder / "checkpoint.pt", weights_only=True)["mean"])
    x = rng.normal(size=(20, 1, slip_training.inputs_of(True))).astype(np.float32)
    expected = trained.best(torch.from_numpy(x))[0].detach().numpy()
    hidden = np.zeros((1, regression.HIDDEN), np.float32)
    found = np.array([policy.infer(each, hidden).copy() for each in x])
    assert found == pytest.approx(expected, abs=5e-3)  # of half precision


def test_on_level_ground_the_teacher_goes_on_from_the_action_that_was_sent(tmp_path, monkeypatch):
    """The price of a change is that of the change from it, whoever drives."""
    only(monkeypatch, {"preset": "mocap"}, SPEED_ID)
    chosen = options(tmp_path, "--env Speed-v0")
    task = LearnedSlip(chosen)
    scene = Scene(task.layers(task.network.weights()), job(8), chosen)
    for _ in range(40):
        scene.see()
        scene.teach()
        scene.step(np.full((8, 2), 0.6))
    after_own, _ = scene.teach()
    names = scene.simulation.layout.index
    shown = scene.observation.copy()
    shown[:, [names[f"previous_action_{side}"] for side in ("left", "right")]] = 0.0
    scene.observation = shown
    after_none, _ = scene.teach()
    scene.env.close()
    assert np.median(after_own - after_none) > 0.01  # it is held near what was sent


def test_a_training_on_level_ground_makes_an_agent_of_speed(tmp_path, monkeypatch):
    only(monkeypatch, {"preset": "mocap"}, SPEED_ID)
    folder = tmp_path / "floors"
    chosen = options(folder, "--env Speed-v0")
    regression.train(chosen, LearnedSlip(chosen))
    agent = open_agent(folder / "agent.zip")
    shown = make_layout("v0").names
    assert isinstance(agent.make(CONTEXT._replace(observation=shown)), LearnedSlipPolicy)
    assert read_recipe(folder / "agent.zip")["environment"]["id"] == SPEED_ID
    other = CONTEXT._replace(observation=shown, vehicle=VEHICLES["strawa"])
    with pytest.raises(ValueError, match="of another size: mass = 1450 is not within 10% of 62"):
        agent.make(other)
    faster = CONTEXT.vehicle._replace(sprocket_speed_limit=12.0)
    with pytest.raises(ValueError, match="another size: sprocket_speed_limit = 12 is not within"):
        agent.make(other._replace(vehicle=faster))


def test_heights_on_level_ground_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        options(tmp_path, "--env Speed-v0 --heights")
    assert "only those of Terrain-v0 differ" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["episodes", "further", "epochs", "batch", "chunk"])
def test_a_count_below_one_is_refused_before_anything_is_driven(name, tmp_path, capsys):
    with pytest.raises(SystemExit):
        slip_training.parse(["--output", str(tmp_path / "out"), f"--{name}", "0"])
    assert f"--{name}: '0'; must be a whole number of at least 1" in capsys.readouterr().err
