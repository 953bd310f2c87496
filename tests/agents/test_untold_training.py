"""The training of the policy for any vehicle: its teacher, its targets, its archive."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from agents import (  # noqa: E402  needs torch
    fine_tuning,
    regression,
    slip_training,
    untold_training,
)
from agents.untold_training import KNOWN, AnyVehicle, Teacher  # noqa: E402
from baselines import registry  # noqa: E402
from baselines.learned import onnx_agent  # noqa: E402
from baselines.learned.agent_policy import ANY_VEHICLE  # noqa: E402
from baselines.learned.trained_agent import (  # noqa: E402
    apart_at,
    layers_at,
    open_agent,
    read_recipe,
)
from baselines.learned.untold_policy import AnyVehiclePolicy  # noqa: E402
from baselines.learned.vehicle_features import FEATURES, TOLD  # noqa: E402
from tracked_env import TORQUE_ID  # noqa: E402
from tracked_env.benchmark.policy_interface import PolicyContext  # noqa: E402
from tracked_env.vector_env import TrackedVehicleVectorEnv  # noqa: E402

TINY = "--episodes 16 --further 16 --rounds 1 --last-epochs 1 --batch 8 --chunk 40 --seed 3"
CONTEXT = PolicyContext(0.02, "sliding")


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(regression, "DURATION", 3.0)
    monkeypatch.setattr(AnyVehicle, "job", 16)


def options(folder, more=""):
    return untold_training.parse([*TINY.split(), "--output", str(folder), *more.split()])


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["lumped", "distributed"])
def test_the_teacher_keeps_every_vehicle_on_its_path(plant):
    """Heavy ones with weak drives too, from half a contact length beside it."""
    count = 48
    env = TrackedVehicleVectorEnv(
        count, uncertainty="any-vehicle", sensors="ideal", duration=10.0, plant=plant
    )
    simulation = env.simulation
    observation, _ = env.reset(seed=4)
    teacher = Teacher([simulation.nominal(i) for i in range(count)], plant == "distributed")
    start, column, away = np.ones(count, bool), simulation.batch.column, []
    for _ in range(490):
        action = teacher.act(observation, simulation.batch.floats, start)
        start = np.zeros(count, bool)
        observation, *_ = env.step(np.clip(action, -1.0, 1.0).astype(np.float32))
        gone = np.hypot(column("reference_x") - column("x"), column("reference_y") - column("y"))
        away.append(gone / column("contact_length"))
    settled = np.sqrt(np.mean(np.square(away[250:]), axis=0))
    env.close()
    limits = {"lumped": (0.005, 0.05), "distributed": (0.02, 0.15)}[plant]
    assert np.median(settled) < limits[0]
    assert np.sort(settled)[-2] < limits[1]  # one in a hundred swings about its path at first


def test_what_is_taken_down_is_what_the_policy_sees_and_the_teachers_action():
    job = regression.Job(0, 2**41, 16, False)
    driven = untold_training.drive(TORQUE_ID, None, job)
    assert driven.features.shape == (16, 150, len(FEATURES))
    assert driven.targets.shape == (16, 150, 3 + len(KNOWN))
    assert (np.abs(driven.targets[..., :2]) <= 1.0).all()
    assert (driven.lengths > 50).all()
    again = untold_training.drive(TORQUE_ID, None, job)
    assert all(np.array_equal(one, other) for one, other in zip(driven, again, strict=True))
    weight = driven.targets[:, 0, 2].astype(float)  # torque limit over r m g
    zero = np.array([*KNOWN.values()])
    known = zero * np.exp(2.0 * driven.targets[:, 0, 3:].astype(float))
    mass, limit, radius = (
        known[:, [*KNOWN].index(n)] for n in ("mass", "torque_limit", "sprocket_radius")
    )
    np.testing.assert_allclose(weight, limit / (radius * mass * 9.81), rtol=0.02)


@pytest.mark.parametrize("drawn", [True, False])
def test_by_speed_the_teacher_keeps_vehicles_on_their_path(drawn, monkeypatch):
    """Of one drawn vehicle, or that of the id, on ground that it is told; and what the network is
    to say is what it commands beyond the action to begin with."""
    monkeypatch.setattr(regression, "DURATION", 10.0)
    monkeypatch.setattr(untold_training, "DRAWN", float(drawn))
    scene = untold_training.SpeedScene(regression.Job(0, 2**41, 8, False))
    column, away = scene.simulation.batch.column, []
    assert (column("contact_length") == 0.7).all() != drawn
    for _ in range(490):
        scene.seen.see(scene.observation, scene.start)
        right = scene.teach()
        said = scene.target(right)[:, :2]
        known = np.abs(said).max(axis=1) < slip_training.LARGEST_TARGET
        np.testing.assert_allclose(
            (scene.seen.begin + scene.seen.unit * said)[known], right[known], atol=1e-6
        )
        scene.step(right)
        gone = np.hypot(column("reference_x") - column("x"), column("reference_y") - column("y"))
        away.append(gone / column("contact_length"))
    scene.env.close()
    settled = np.sqrt(np.mean(np.square(away[250:]), axis=0))
    assert np.median(settled) < 0.015
    assert np.quantile(settled, 0.8) < 0.05


def test_half_of_the_vehicles_show_a_sheet_that_errs_as_drawn():
    rng = np.random.default_rng(0)
    vehicles = [CONTEXT.vehicle] * 600
    told = untold_training.sheets(rng, vehicles)
    shown = told[:, 0] > 0.0
    assert 0.4 < shown.mean() < 0.6
    assert not told[~shown].any()
    errors = np.abs(2.0 * (told[shown, 1:] - untold_training.told_of(vehicles[:1])[0, 1:]))
    assert errors.shape[1] == len(TOLD)
    found = np.unique(np.round(np.expm1(errors), 6))
    np.testing.assert_allclose(found, untold_training.SHEET_ERRORS, atol=1e-6)


def test_a_training_makes_an_archive_that_drives_without_torch(tmp_path, monkeypatch):
    folder = tmp_path / "Torque-v0" / "any-vehicle-seed3"
    chosen = options(folder)
    regression.train(chosen, AnyVehicle(chosen))
    policy = open_agent(folder / "agent.zip").make(CONTEXT)
    assert isinstance(policy, AnyVehiclePolicy)
    assert not policy.features.told.any()
    monkeypatch.setattr(registry, "PRETRAINED", tmp_path)
    known = registry.policies()
    assert known["torque"]["any-vehicle"] == [folder / "agent.zip"]
    assert known[None]["any-vehicle-told"](CONTEXT).features.told.any()
    with pytest.raises(ValueError, match="takes its speed"):
        open_agent(folder / "agent.zip").make(CONTEXT._replace(drive="speed"))
    recipe = {"augmentation": "blind", "augmentation_options": {}}
    with pytest.raises(ValueError, match=r"is of the kind 'blind'; must be of 'any-vehicle'"):
        apart_at(folder / "agent.zip", recipe, ANY_VEHICLE)
    curve = (folder / "curve.csv").read_text(encoding="utf-8").splitlines()
    assert curve[0] == "round,epoch,loss,left,slow,told,untold"
    assert len(curve) == 3
    # The network that drives is the one that was trained.
    rng = np.random.default_rng(1)
    task = AnyVehicle(chosen)
    trained = regression.Regression(chosen, task)
    trained.mean.load_state_dict(torch.load(folder / "checkpoint.pt", weights_only=True)["mean"])
    x = rng.normal(size=(20, 1, len(FEATURES))).astype(np.float32)
    expected = trained.best(torch.from_numpy(x))[0].detach().numpy()
    hidden = np.zeros((1, regression.HIDDEN), np.float32)
    found = np.array([policy._infer(each, hidden).copy() for each in x])
    assert found == pytest.approx(expected, abs=5e-3)  # of half precision


def test_a_training_by_speed_makes_an_agent_of_speeds(tmp_path):
    folder = tmp_path / "Speed-v0" / "any-vehicle-seed3"
    chosen = options(folder, "--env Speed-v0")
    assert options(folder).batch == chosen.batch == 8  # what is said stands
    assert untold_training.parse(["--output", "x", "--env", "Speed-v0"]).rounds == 8
    regression.train(chosen, AnyVehicle(chosen))
    context = CONTEXT._replace(drive="speed")
    policy = open_agent(folder / "agent.zip").make(context)
    assert isinstance(policy, AnyVehiclePolicy) and policy.features.drive.by_speed
    with pytest.raises(ValueError, match="takes its torque"):
        open_agent(folder / "agent.zip").make(CONTEXT)
    # The file of ONNX bounds what the network says, too.
    onnxruntime = pytest.importorskip("onnxruntime")
    recipe, file = read_recipe(folder / "agent.zip"), tmp_path / "agent.onnx"
    layers = layers_at(folder / "agent.zip", recipe)
    far = np.array([9.0, -9.0], np.float32)
    onnx_agent._write_apart(layers._replace(last_bias=layers.last_bias + far), recipe, file, "a")
    session = onnxruntime.InferenceSession(str(file))
    feed = {one.name: np.zeros((1, *one.shape[1:]), np.float32) for one in session.get_inputs()}
    feed |= {"start": np.ones(1, bool), "unit": np.full((1, 2), 0.1, np.float32)}
    said, action = session.run(["outputs", "action"], feed)
    assert (np.abs(said) > 3.0).all()
    np.testing.assert_allclose(action, [[0.3, -0.3]], atol=1e-6)
    with pytest.raises(ValueError, match="drives by torque alone"):
        fine_tuning.load(folder / "agent.zip")
