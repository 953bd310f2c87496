"""Teacher and student: who sees the truth, what the student learns, and that it drives alone."""

import zipfile
from dataclasses import replace

import numpy as np
import pytest

from agents import checkpoint
from agents.algorithms import StudentSettings
from agents.archive import StudentModel, agent_entry, inference_weights, make_inference, to_npz
from agents.environments import AgentVectorEnv, Privileged, TruthfulVectorEnv
from agents.folder import Progress
from agents.learners import RolloutCallback, StudentLearner
from agents.run import resolve
from baselines.learned.agent_archive import INFERENCE, from_npz, read_entry, read_recipe
from baselines.learned.agent_policy import PRIVILEGED, Normalisation, privileged
from baselines.learned.augmentation import History
from baselines.learned.student import read_student
from tests.agents.agent_cases import actor, same_parameters, small
from tests.agents.test_agents import STEPS, Recorded, as_evaluated
from tracked_env import SPEED_ID
from tracked_env import observation as obs
from tracked_env.benchmark import PolicyContext
from tracked_env.benchmark.policy_interface import checked_policy, needs_truth
from tracked_env.physics.parameters import VEHICLES
from tracked_env.vector_env import TrackedVehicleVectorEnv
from train import main

CONTEXT = PolicyContext(0.02, "sliding")
SETTINGS = StudentSettings(n_steps=32, gradient_steps=30, batch_size=128, hidden=(16,))


def vehicles(uncertainty="payload", **more):
    return TrackedVehicleVectorEnv(
        3, uncertainty=uncertainty, duration=1.0, autoreset_mode="SameStep", **more
    )


@pytest.fixture(scope="module")
def teacher(tmp_path_factory):
    folder = tmp_path_factory.mktemp("teacher")
    assert main(small(folder, augmentation="teacher")) == 0
    return folder / "agent.zip"


def student_config(output, teacher, **changes):
    return small(output, augmentation="student", teacher=teacher, student=SETTINGS, **changes)


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
    model = actor(teacher)
    augmentation, inner = (
        Privileged(3, 0.02, VEHICLES["strawa"]),
        Recorded(vehicles(expose_truth=True)),
    )
    env = AgentVectorEnv(TruthfulVectorEnv(inner, augmentation), augmentation)
    observation, _ = env.reset(seed=5)
    for _ in range(STEPS):
        observation = env.step(model.predict(observation, deterministic=True)[0])[0]
    policy, plain = agent_entry(teacher).make(CONTEXT), Recorded(vehicles(expose_truth=True))
    observation, info = plain.reset(seed=5)
    state = None
    for _ in range(STEPS):
        policy.observe_truth(info["truth"])
        action, state = policy.predict(observation, state)
        observation, _, _, _, info = plain.step(action)
    assert np.ptp(plain.commands) > 0.0
    np.testing.assert_array_equal(inner.commands, plain.commands)


def test_a_teacher_goes_on_after_an_interruption_as_if_nothing_had_been(teacher, tmp_path):
    def interrupt(self, text=None):
        if self.model.num_timesteps >= 384:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RolloutCallback, "_on_step", lambda self: interrupt(self) or True)
        assert main(small(tmp_path, augmentation="teacher")) == 130
    assert main(small(tmp_path, augmentation="teacher", resume=True)) == 0
    assert same_parameters(tmp_path / "last.zip", teacher.parent / "last.zip")


def test_the_regression_loss_falls(teacher, tmp_path):
    config = student_config(tmp_path, teacher)
    student = StudentLearner(resolve(config))
    losses = [student.collect()]
    seen, true = student._seen[:32].flatten(0, 1).numpy(), student._true[:32].flatten(0, 1).numpy()
    for _ in range(3):
        student.regress(3e-3)
        losses.append(np.mean((student.model.infer(seen) - true) ** 2))
    assert (np.diff(losses) < 0.0).all() and losses[-1] < 0.3 * losses[0]


def test_a_student_drives_with_its_teachers_network_and_says_whose(student, teacher):
    curve = np.genfromtxt(student / "curve.csv", delimiter=",", names=True)
    assert np.isfinite(curve["loss"]).all()
    assert np.isfinite(curve["held_out_rmse"][-1]) and curve["steps"][-1] == 4096
    assert same_parameters(student / "agent.zip", teacher)
    recipe = read_recipe(student / "agent.zip")
    assert recipe["augmentation"] == "student" and recipe["teacher"]["augmentation"] == "teacher"
    assert recipe["config"]["student"]["n_steps"] == 32 and "ppo" not in recipe["config"]
    assert (student / "config.json").is_file()


def test_the_inference_is_regressed_on_the_truth_of_the_moment(teacher, tmp_path):
    config = student_config(tmp_path, teacher)
    student = StudentLearner(resolve(config))
    truth = privileged(student.env.env.unwrapped.simulation.truth(), VEHICLES["strawa"])
    shown = student._observation.copy()
    student.collect()
    np.testing.assert_array_equal(student._true[0].numpy(), truth)
    np.testing.assert_array_equal(student._seen[0].numpy(), shown)
    np.testing.assert_array_equal(student.model.infer(shown), np.zeros_like(truth))


def test_the_inference_is_regressed_on_what_the_teachers_network_sees(tmp_path):
    """Normalised and clipped where its inputs are, and driving hands it the same values."""
    assert main(small(tmp_path, augmentation="teacher", normalise=True, steps=256)) == 0
    config = student_config(tmp_path / "student", tmp_path / "agent.zip", steps=1024)
    student = StudentLearner(resolve(config))
    scaling = student.model.normalisation
    scaling = student.model.normalisation = scaling._replace(clip=0.5)
    observation = student._observation[:, : obs.SIZE].copy()
    truth = np.concatenate([augmentation.present for augmentation in student.truths])
    shown = scaling(np.concatenate([observation, truth], axis=1))
    assert np.abs(shown).max() == 0.5 and np.ptp(shown[:, obs.SIZE :]) > 0.0
    np.testing.assert_array_equal(student.truth, shown[:, obs.SIZE :])
    student.collect()
    np.testing.assert_array_equal(student._true[0].numpy(), shown[:, obs.SIZE :])

    class Echo:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return observation, state

    width = student.model.inference[0].in_features
    history = np.zeros((len(shown), width - obs.SIZE), np.float32)
    student.model.teacher = Echo()
    given, _ = student.model.predict(np.concatenate([observation, history], axis=1))
    np.testing.assert_array_equal(given[:, : obs.SIZE], shown[:, : obs.SIZE])


def test_a_normalised_inference_of_the_former_scale_is_refused(student):
    recipe = read_recipe(student / "agent.zip")
    options, path = recipe["augmentation_options"], student / "agent.zip"
    width = obs.SIZE + len(PRIVILEGED)
    scaling = Normalisation(np.zeros(width), np.ones(width), 1e-8, 10.0)
    content = read_entry(path, INFERENCE)
    read_student(content, options, None, scaling)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("baselines.learned.student.INFERENCE_FORMAT", 3)
        with pytest.raises(ValueError, match="inference of format 2; must be 3"):
            read_student(content, options, None, scaling)
    stored = from_npz(content, INFERENCE)
    del stored["format"]
    content = to_npz(stored)
    read_student(content, options, None, None)  # of format 1, without normalisation
    with pytest.raises(ValueError, match="inference of format 1; must be 2"):
        read_student(content, options, None, scaling)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"env": SPEED_ID, "uncertainty": ("friction",)}, "drive = torque; its student .* speed"),
        ({"env_args": '{"vehicle": "focchi"}'}, "vehicle = strawa; its student .* focchi"),
        ({"env_args": '{"control_rate": 25}'}, r"control_period = 0\.02; its student .* 0\.04"),
    ],
)
def test_a_teacher_of_another_vehicle_drive_or_rate_is_refused(changes, message, teacher, tmp_path):
    config = student_config(tmp_path / "none", teacher, **changes)
    with pytest.raises(ValueError, match=message):
        StudentLearner(resolve(config))


def test_a_saved_student_acts_as_in_training(teacher, tmp_path):
    config = student_config(tmp_path, teacher, steps=1024)
    run = resolve(config)
    student = StudentLearner(run)
    student.learn(Progress(run, student))
    inner = Recorded(vehicles())
    env = AgentVectorEnv(inner, History(3, 0.02))
    content = inference_weights(student.model.inference)
    model = read_student(
        content, dict(run.augmentation.options), actor(teacher), student.model.normalisation
    )
    observation, _ = env.reset(seed=5)
    for _ in range(STEPS):
        command, _ = model.predict(observation)
        in_training, _ = student.model.predict(observation, deterministic=True)
        np.testing.assert_allclose(command, in_training, rtol=0.0, atol=1e-6)
        observation = env.step(command)[0]
    assert np.abs(student.model.infer(observation)).max() > 0.0
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


def stored(path):
    """The parameters of the inference in an archive."""
    with zipfile.ZipFile(path) as archive, np.load(archive.open(INFERENCE)) as file:
        return {name: file[name] for name in file}


def same(one, other):
    first, second = stored(one), stored(other)
    return all(np.array_equal(first[name], second[name]) for name in first)


def test_the_same_seed_gives_the_same_student(student, teacher, tmp_path):
    for name in ("one", "two"):
        assert main(student_config(tmp_path / name, teacher, steps=256)) == 0
    assert same(tmp_path / "one" / "last.zip", tmp_path / "two" / "last.zip")


@pytest.mark.parametrize("sensors", [None, ("rtk", "strawa")], ids=["one", "several"])
def test_a_student_goes_on_after_an_interruption_as_if_nothing_had_been(
    sensors, teacher, tmp_path, monkeypatch
):
    given = {"steps": 1024, "checkpoint_every": 256, "sensors": sensors}
    assert main(student_config(tmp_path / "whole", teacher, **given)) == 0
    collect = StudentLearner.collect

    def interrupted(self):
        if self.steps >= 640:  # between two checkpoints, after 512 and 768
            raise KeyboardInterrupt
        return collect(self)

    with monkeypatch.context() as patch:
        patch.setattr(StudentLearner, "collect", interrupted)
        assert main(student_config(tmp_path / "parts", teacher, **given)) == 130
    assert main(student_config(tmp_path / "parts", teacher, **given)) == 2  # would overwrite it
    assert main(student_config(tmp_path / "parts", teacher, **given, resume=True)) == 0
    assert same(tmp_path / "whole" / "last.zip", tmp_path / "parts" / "last.zip")
    curves = [
        np.genfromtxt(tmp_path / name / "curve.csv", delimiter=",", names=True)
        for name in ("whole", "parts")
    ]
    for column in ("steps", "loss", "held_out_rmse"):
        np.testing.assert_array_equal(curves[0][column], curves[1][column])
    assert not list((tmp_path / "parts").glob("*checkpoint*"))


@pytest.mark.parametrize("name", ["_filled", "_observation", "_start", "steps"])
def test_a_checkpoint_of_another_shape_is_one_line(name, teacher, tmp_path, monkeypatch, capsys):
    config = student_config(tmp_path, teacher, steps=1024, checkpoint_every=128)
    between = Progress.between

    def interrupted(progress, value):
        between(progress, value)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Progress, "between", interrupted)
        assert main(config) == 130
    state = checkpoint.read(tmp_path)[0]
    state["learner"][name] = np.zeros((3, 5), np.float32)
    checkpoint.write(tmp_path, state)
    capsys.readouterr()
    assert main(replace(config, resume=True)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "does not fit this training" in line and name in line


def test_another_seed_gives_another_student_of_the_same_teacher(teacher, tmp_path):
    first = []
    for seed in (3, 4):
        config = student_config(tmp_path, teacher, seed=seed)
        student = StudentLearner(resolve(config))
        first.append(student.model.inference[0].weight.detach().numpy().copy())
    assert not np.array_equal(*first)


def test_the_teachers_network_is_fed_the_observation_and_what_was_inferred():
    class Echo:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return observation, state

    inference = make_inference((1, 2), (8,))
    inference[-1].bias.data += 0.5
    width = inference[0].in_features
    observation = np.random.default_rng(0).normal(size=(3, width)).astype(np.float32)
    given, _ = StudentModel(inference, Echo(), None).predict(observation)
    np.testing.assert_array_equal(given[:, : obs.SIZE], observation[:, : obs.SIZE])
    np.testing.assert_array_equal(given[:, obs.SIZE :], np.full((3, len(PRIVILEGED)), 0.5))


def test_what_makes_no_student_is_a_clear_error(teacher, student, tmp_path, capsys):
    for changes, message in (
        ({"teacher": None}, "needs --teacher"),
        ({"teacher": tmp_path / "none.zip"}, "no such file"),
        ({"teacher": student / "agent.zip"}, "augmentation 'student'; a student needs a teacher"),
    ):
        given = {"augmentation": "student", **changes}
        assert main(small(tmp_path / "out", **given)) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    with pytest.raises(ValueError, match="expose_truth = True"):
        TruthfulVectorEnv(vehicles(), Privileged(3, 0.02, VEHICLES["strawa"]))


def test_a_student_without_its_weights_is_refused(student, tmp_path):
    path = tmp_path / "agent.zip"
    with zipfile.ZipFile(student / "agent.zip") as whole, zipfile.ZipFile(path, "w") as archive:
        for name in whole.namelist():
            if name != INFERENCE:
                archive.writestr(name, whole.read(name))
    with pytest.raises(ValueError, match=r"as a student: student\.npz in it is missing"):
        agent_entry(path)
