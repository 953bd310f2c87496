"""Teacher and student: who sees the truth, what the student learns, and that it drives alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents import checkpoint
from agents.archive import agent_entry, inference_weights
from agents.environments import AgentVectorEnv, TruthfulVectorEnv
from agents.folder import Progress
from agents.learners import StudentLearner
from agents.run import resolve
from baselines.learned.augmentation import History
from baselines.learned.student import INFERENCE, privileged
from baselines.learned.trained_agent import read_recipe
from tests.agents.agent_cases import (
    CONTEXT,
    STEPS,
    STUDENT,
    Echo,
    Recorded,
    actor,
    as_evaluated,
    assert_same_curves,
    commands,
    entries,
    interrupted_at,
    one_line,
    packed,
    same_arrays,
    same_parameters,
    small,
    student_config,
    vehicles,
)
from tracked_env import SPEED_ID
from tracked_env import observation as obs
from tracked_env.benchmark.policy_interface import checked_policy, needs_truth
from tracked_env.physics.parameters import VEHICLES
from train import main


@pytest.fixture(scope="module")
def student(teacher, tmp_path_factory):
    folder = tmp_path_factory.mktemp("student")
    assert main(student_config(folder, teacher, steps=4096, evaluate_every=2048)) == 0
    return folder


def test_a_teacher_is_declared_privileged_and_refuses_to_drive_without_the_truth(teacher):
    policy = checked_policy(agent_entry(teacher), CONTEXT)
    assert needs_truth(policy)
    with pytest.raises(ValueError, match="needs `observe_truth`"):
        policy.predict(np.zeros((3, obs.SIZE), np.float32))
    _, info = vehicles(expose_truth=True).reset(seed=0)
    policy.observe_truth(info["truth"])
    with pytest.raises(ValueError, match="truth of 3 vehicles"):
        policy.predict(np.zeros((2, obs.SIZE), np.float32))


def test_a_teacher_acts_in_the_benchmark_as_in_training(teacher):
    model, inner = actor(teacher), Recorded(vehicles(expose_truth=True))
    told = TruthfulVectorEnv(inner)
    env = AgentVectorEnv(told, told.truth)
    observation, _ = env.reset(seed=5)
    for _ in range(STEPS):
        observation = env.step(model.predict(observation, deterministic=True)[0])[0]
    driven = commands(agent_entry(teacher).make(CONTEXT), vehicles(expose_truth=True))
    assert np.ptp(driven) > 0.0
    np.testing.assert_array_equal(inner.commands, driven)


def test_a_teacher_goes_on_after_an_interruption_as_if_nothing_had_been(teacher, tmp_path):
    interrupted_at(384, small(tmp_path, augmentation="teacher"))
    assert main(small(tmp_path, augmentation="teacher", resume=True)) == 0
    assert same_parameters(tmp_path / "last.zip", teacher.parent / "last.zip")


def test_the_inference_is_regressed_on_the_truth_of_the_moment_and_its_loss_falls(
    teacher, tmp_path
):
    student = StudentLearner(resolve(student_config(tmp_path, teacher)))
    truth = privileged(student.env.env.unwrapped.simulation.truth(), VEHICLES["strawa"])
    shown, nothing = student._observation.copy(), np.zeros(4, bool)
    losses = [student.collect()]
    np.testing.assert_array_equal(student._true[0].numpy(), truth)
    np.testing.assert_array_equal(student._seen[0].numpy(), shown)
    np.testing.assert_array_equal(student.model.infer(shown, None, nothing)[0], 0.0 * truth)
    seen, true = (each[:32].flatten(0, 1).numpy() for each in (student._seen, student._true))
    for _ in range(3):
        student.regress(3e-3)
        losses.append(np.mean((student.model.infer(seen, None, nothing)[0] - true) ** 2))
    assert (np.diff(losses) < 0.0).all() and losses[-1] < 0.3 * losses[0]


def test_a_student_drives_with_its_teachers_network_and_says_whose(student, teacher):
    curve = np.genfromtxt(student / "curve.csv", delimiter=",", names=True)
    assert np.isfinite(curve["loss"]).all()
    assert np.isfinite(curve["held_out_rmse"][-1]) and curve["steps"][-1] == 4096
    assert same_parameters(student / "agent.zip", teacher)
    recipe = read_recipe(student / "agent.zip")
    assert recipe["augmentation"] == "student" and recipe["teacher"]["augmentation"] == "teacher"
    assert recipe["config"]["student"]["n_steps"] == 32 and "ppo" not in recipe["config"]


def test_the_inference_is_regressed_on_what_the_teachers_network_sees(tmp_path):
    """Normalised and clipped where its inputs are, and driving hands it the same values."""
    assert main(small(tmp_path, augmentation="teacher", normalise=True, steps=256)) == 0
    config = student_config(tmp_path / "student", tmp_path / "agent.zip", steps=1024)
    student = StudentLearner(resolve(config))
    scaling = student.model.normalisation = student.model.normalisation._replace(clip=0.5)
    widened = student._observation.copy()
    truth = np.concatenate([of.truth.present for of in student.truths])
    shown = scaling(np.concatenate([widened[:, : obs.SIZE], truth], axis=1))
    assert np.abs(shown).max() == 0.5 and np.ptp(shown[:, obs.SIZE :]) > 0.0
    np.testing.assert_array_equal(student.truth, shown[:, obs.SIZE :])
    student.collect()
    np.testing.assert_array_equal(student._true[0].numpy(), shown[:, obs.SIZE :])
    student.model.teacher = Echo()
    echo, _ = student.model.predict(widened)
    np.testing.assert_array_equal(echo[:, : obs.SIZE], shown[:, : obs.SIZE])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"env": SPEED_ID, "uncertainty": ("friction",)}, "drive = torque; its student .* speed"),
        ({"env_args": '{"vehicle": "focchi"}'}, "vehicle = strawa; its student .* focchi"),
        ({"env_args": '{"control_rate": 25}'}, r"control_period = 0\.02; its student .* 0\.04"),
        ({"teacher": None}, "needs --teacher"),
        ({"teacher": Path("none.zip")}, "no such file"),
        ({"teacher": "student"}, "augmentation 'student'; a student needs a teacher"),
        ({"student": replace(STUDENT, buffer_size=127)}, "buffer_size = 127; must be at least 128"),
    ],
)
def test_what_makes_no_student_is_a_clear_error(
    changes, message, teacher, student, tmp_path, capsys
):
    if changes.get("teacher") == "student":
        changes = {"teacher": student / "agent.zip"}
    config = student_config(tmp_path / "none", **{"teacher": teacher, **changes})
    with pytest.raises(ValueError, match=message):
        StudentLearner(resolve(config))
    assert main(config) == 2
    assert one_line(capsys) and not config.folder.exists()


def test_a_teacher_needs_an_environment_that_shows_the_truth():
    with pytest.raises(ValueError, match="expose_truth = True"):
        TruthfulVectorEnv(vehicles())


def test_a_saved_student_acts_as_in_training(teacher, tmp_path):
    run = resolve(student_config(tmp_path, teacher, steps=1024))
    student = StudentLearner(run)
    student.learn(Progress(run, student))
    inner = Recorded(vehicles())
    env = AgentVectorEnv(inner, History(3, 0.02))
    policy = agent_entry(tmp_path / "last.zip").make(CONTEXT)
    observation, _ = env.reset(seed=5)
    for _ in range(STEPS):
        command, _ = policy.model.predict(observation)
        in_training, _ = student.model.predict(observation, deterministic=True)
        np.testing.assert_allclose(command, in_training, rtol=0.0, atol=1e-6)
        observation = env.step(command)[0]
    assert np.abs(student.model.inferred).max() > 0.0
    np.testing.assert_array_equal(inner.commands, as_evaluated(tmp_path / "last.zip"))


def test_a_student_drives_without_truth_and_remembers_all_in_its_state(student):
    entry = agent_entry(student / "agent.zip")
    policy, fresh = checked_policy(entry, CONTEXT), entry.make(CONTEXT)
    assert not needs_truth(policy) and not hasattr(policy, "observe_truth")
    env = vehicles()  # shows no truth
    observation, info = env.reset(seed=1)
    assert "truth" not in info
    state = None
    for _ in range(10):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
    np.testing.assert_array_equal(
        policy.predict(observation, state)[0], fresh.predict(observation, state)[0]
    )


@pytest.mark.parametrize(
    "sensors",
    [None, pytest.param(("rtk", "strawa"), marks=pytest.mark.slow)],
    ids=["one", "several"],
)
def test_a_student_goes_on_after_an_interruption_as_if_nothing_had_been(sensors, teacher, tmp_path):
    whole = student_config(
        tmp_path / "whole", teacher, steps=1024, checkpoint_every=256, sensors=sensors
    )
    assert main(whole) == 0
    parts = replace(whole, output=tmp_path / "parts")
    interrupted_at(640, parts)  # between two checkpoints, after 512 and 768
    assert main(parts) == 2  # would overwrite it
    assert main(replace(parts, resume=True)) == 0
    assert same_arrays(tmp_path / "whole" / "last.zip", tmp_path / "parts" / "last.zip", INFERENCE)
    assert_same_curves(tmp_path / "whole", tmp_path / "parts", "loss")
    assert not list((tmp_path / "parts").glob("*checkpoint*"))


@pytest.mark.parametrize("name", ["_filled", "_observation", "_start", "steps"])
def test_a_checkpoint_of_another_shape_is_one_line(name, teacher, tmp_path, capsys):
    config = student_config(tmp_path, teacher, steps=1024, checkpoint_every=128)
    interrupted_at(128, config)
    state = checkpoint.read(tmp_path)
    state["learner"][name] = np.zeros((3, 5), np.float32)
    checkpoint.write(tmp_path, state)
    capsys.readouterr()
    assert main(replace(config, resume=True)) == 2
    line = one_line(capsys)
    assert "does not fit this training" in line and name in line


def test_another_seed_gives_another_student_of_the_same_teacher(teacher, tmp_path):
    first, again, other = (
        inference_weights(StudentLearner(resolve(config)).model.inference)
        for config in (student_config(tmp_path, teacher, seed=seed) for seed in (3, 3, 4))
    )
    assert first == again != other


def test_a_student_without_its_weights_is_refused(student, tmp_path):
    files = entries(student / "agent.zip")
    del files[INFERENCE]
    with pytest.raises(ValueError, match=r"cannot be loaded: student\.npz in it is missing"):
        agent_entry(packed(tmp_path / "agent.zip", files))
