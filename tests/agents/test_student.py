"""Teacher and student: who sees the truth, what the student learns, and that it drives alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from agents import checkpoint
from agents.algorithms import StudentSettings
from agents.archive import RecurrentInference, StudentModel, agent_entry, inference_weights
from agents.environments import AgentVectorEnv, TruthfulVectorEnv
from agents.folder import Progress
from agents.learners import StudentLearner
from agents.run import resolve
from baselines.learned.augmentation import FILTERED, RECKONED, SHEET, History
from baselines.learned.controller_augmentation import ESTIMATED, FEATURES
from baselines.learned.student import INFERENCE, MOTION, PRIVILEGED, privileged, widened_by
from baselines.learned.trained_agent import read_recipe
from tests.agents import agent_cases as cases
from tracked_env import SPEED_ID
from tracked_env import observation as obs
from tracked_env.benchmark.policy_interface import checked_policy, needs_truth
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sb3 import make_vec_env
from train import main


@pytest.fixture(scope="module")
def student(teacher, tmp_path_factory):
    folder = tmp_path_factory.mktemp("student")
    assert main(cases.student_config(folder, teacher, steps=4096, evaluate_every=2048)) == 0
    return folder


def test_a_teacher_is_declared_privileged_and_refuses_to_drive_without_the_truth(teacher):
    policy = checked_policy(agent_entry(teacher), cases.CONTEXT)
    assert needs_truth(policy)
    with pytest.raises(ValueError, match="needs `observe_truth`"):
        policy.predict(np.zeros((3, obs.SIZE), np.float32))
    _, info = cases.vehicles(expose_truth=True).reset(seed=0)
    policy.observe_truth(info["truth"])
    with pytest.raises(ValueError, match="truth of 3 vehicles"):
        policy.predict(np.zeros((2, obs.SIZE), np.float32))


def test_a_teacher_acts_in_the_benchmark_as_in_training(teacher):
    model, inner = cases.actor(teacher), cases.Recorded(cases.vehicles(expose_truth=True))
    told = TruthfulVectorEnv(inner)
    cases.commands(model, AgentVectorEnv(told, told.truth))
    driven = cases.commands(
        agent_entry(teacher).make(cases.CONTEXT), cases.vehicles(expose_truth=True)
    )
    assert np.ptp(driven) > 0.0
    np.testing.assert_array_equal(inner.commands, driven)


def test_a_teacher_goes_on_after_an_interruption_as_if_nothing_had_been(teacher, tmp_path):
    cases.interrupted_at(384, cases.small(tmp_path, augmentation="teacher"))
    assert main(cases.small(tmp_path, augmentation="teacher", resume=True)) == 0
    assert cases.same_arrays(tmp_path / "last.zip", teacher.parent / "last.zip")


def test_the_inference_is_regressed_on_the_truth_of_the_moment_and_its_loss_falls(
    teacher, tmp_path
):
    student = StudentLearner(resolve(cases.student_config(tmp_path, teacher)))
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
    assert cases.same_arrays(student / "agent.zip", teacher)
    recipe = read_recipe(student / "agent.zip")
    assert recipe["augmentation"] == "student" and recipe["teacher"]["augmentation"] == "teacher"
    assert recipe["config"]["student"]["n_steps"] == 32 and "ppo" not in recipe["config"]


def test_the_inference_is_regressed_on_what_the_teachers_network_sees(tmp_path):
    """Normalised and clipped where its inputs are, and driving hands it the same values."""
    path = cases.archive_of(
        cases.small(tmp_path, augmentation="teacher", normalise=True, steps=256)
    )
    config = cases.student_config(tmp_path / "student", path, steps=1024)
    student = StudentLearner(resolve(config))
    scaling = student.model.normalisation = student.model.normalisation._replace(clip=0.5)
    widened = student._observation.copy()
    truth = np.concatenate([of.truth.present for of in student.truths])
    shown = scaling(np.concatenate([widened[:, : obs.SIZE], truth], axis=1))
    assert np.abs(shown).max() == 0.5 and np.ptp(shown[:, obs.SIZE :]) > 0.0
    np.testing.assert_array_equal(student.truth, shown[:, obs.SIZE :])
    student.collect()
    np.testing.assert_array_equal(student._true[0].numpy(), shown[:, obs.SIZE :])
    student.model.teacher = cases.Echo()
    echo, _ = student.model.predict(widened)
    np.testing.assert_array_equal(echo[:, : obs.SIZE], shown[:, : obs.SIZE])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"env": SPEED_ID, "uncertainty": ("friction",)}, "drive = torque; its student .* speed"),
        ({"vehicle": "focchi"}, "vehicle = strawa; its student .* focchi"),
        ({"env_args": '{"control_rate": 25}'}, r"control_period = 0\.02; its student .* 0\.04"),
        ({"teacher": None}, "needs --teacher"),
        ({"teacher": Path("none.zip")}, "no such file"),
        ({"teacher": "student"}, "augmentation 'student'; a student needs a teacher"),
        (
            {"student": replace(cases.STUDENT, buffer_size=127)},
            "buffer_size = 127; must be at least 128",
        ),
    ],
)
def test_what_makes_no_student_is_a_clear_error(
    changes, message, teacher, student, tmp_path, capsys
):
    if changes.get("teacher") == "student":
        changes = {"teacher": student / "agent.zip"}
    config = cases.student_config(tmp_path / "none", **{"teacher": teacher, **changes})
    with pytest.raises(ValueError, match=message):
        StudentLearner(resolve(config))
    assert main(config) == 2
    assert cases.one_line(capsys) and not config.folder.exists()


def test_a_teacher_needs_an_environment_that_shows_the_truth():
    with pytest.raises(ValueError, match="expose_truth = True"):
        TruthfulVectorEnv(cases.vehicles())


def test_a_saved_student_acts_as_in_training(teacher, tmp_path):
    run = resolve(cases.student_config(tmp_path, teacher, steps=1024))
    student = StudentLearner(run)
    student.learn(Progress(run, student))
    inner = cases.Recorded(cases.vehicles())
    env = AgentVectorEnv(inner, History(3, 0.02))
    policy = agent_entry(tmp_path / "last.zip").make(cases.CONTEXT)
    observation, _ = env.reset(seed=5)
    for _ in range(cases.STEPS):
        command, _ = policy.model.predict(observation)
        in_training, _ = student.model.predict(observation, deterministic=True)
        np.testing.assert_allclose(command, in_training, rtol=0.0, atol=1e-6)
        observation = env.step(command)[0]
    assert np.abs(student.model.inferred).max() > 0.0
    np.testing.assert_array_equal(inner.commands, cases.as_evaluated(tmp_path / "last.zip"))


@pytest.mark.parametrize(
    "sensors",
    [None, pytest.param(("rtk", "strawa"), marks=pytest.mark.slow)],
    ids=["one", "several"],
)
def test_a_student_goes_on_after_an_interruption_as_if_nothing_had_been(sensors, teacher, tmp_path):
    whole = cases.student_config(
        tmp_path / "whole", teacher, steps=1024, checkpoint_every=256, sensors=sensors
    )
    # between two checkpoints, after 512 and 768
    cases.interrupted_and_resumed(640, whole, tmp_path / "parts", INFERENCE)


@pytest.mark.parametrize("name", ["_filled", "_observation", "_start", "steps"])
def test_a_checkpoint_of_another_shape_is_one_line(name, teacher, tmp_path, capsys, refused):
    config = cases.student_config(tmp_path, teacher, steps=1024, checkpoint_every=128)
    cases.interrupted_at(128, config)
    state = checkpoint.read(tmp_path)
    state["learner"][name] = np.zeros((3, 5), np.float32)
    checkpoint.write(tmp_path, state)
    capsys.readouterr()
    line = refused(replace(config, resume=True))
    assert "does not fit this training" in line and name in line


def test_another_seed_gives_another_student_of_the_same_teacher(teacher, tmp_path):
    first, again, other = (
        inference_weights(StudentLearner(resolve(config)).model.inference)
        for config in (cases.student_config(tmp_path, teacher, seed=seed) for seed in (3, 3, 4))
    )
    assert first == again != other


def test_a_student_without_its_weights_is_refused(student, tmp_path):
    files = cases.entries(student / "agent.zip")
    del files[INFERENCE]
    with pytest.raises(ValueError, match=r"cannot be loaded: student\.npz in it is missing"):
        agent_entry(cases.packed(tmp_path / "agent.zip", files))


# A student with an LSTM: what it learns from, what its teacher is shown, that it drives alone

SETTINGS = StudentSettings(
    n_steps=32, gradient_steps=4, batch_size=256, buffer_size=512, hidden=(16,), lstm_hidden=8
)
ON_ESTIMATES = replace(SETTINGS, features="estimates")
WIDTH = obs.SIZE + len(RECKONED) + len(SHEET)
COLUMNS = [obs.INDEX[name] for name in MOTION]
TURNING = np.full((4, 2), [0.1, 0.2], np.float32)


@pytest.fixture(scope="module")
def ideal_teacher(tmp_path_factory):
    folder = tmp_path_factory.mktemp("teacher")
    return cases.archive_of(cases.small(folder, augmentation="teacher", sensors=("ideal",)))


@pytest.fixture
def configured(ideal_teacher, tmp_path):
    """Makes the configuration of a student, in the folder of the test or below it."""

    def make(name=".", **changes):
        options = {
            "steps": 1024,
            "data_sheet": True,
            "sensors": ("rtk", "rtk-outages"),
            "student": SETTINGS,
            **changes,
        }
        return cases.student_config(tmp_path / name, ideal_teacher, **options)

    return make


@pytest.fixture
def learner(configured):
    """Makes a student that has learned nothing."""
    return lambda **changes: StudentLearner(resolve(configured(**changes)))


def true_motion(student):
    return np.concatenate([truth.motion() for truth in student.truths])


def test_the_true_motion_is_what_ideal_sensors_show(learner):
    student = learner(sensors=("ideal",), duration=2.0)
    student.env.seed(0)
    observation, ended = student.env.reset(), 0
    for _ in range(150):  # over the end of an episode
        motion = true_motion(student)
        np.testing.assert_allclose(motion, observation[:, COLUMNS], atol=2e-6)
        observation, _, over, _ = student.env.step(TURNING)
        ended += int(np.sum(over))
    assert ended >= 4 and np.ptp(motion) > 0.1


def test_an_untrained_student_shows_its_teacher_dead_reckoning_and_the_nominal_vehicle(learner):
    student = learner()
    student.model.teacher = cases.Echo()
    seen = np.random.default_rng(0).normal(size=(3, WIDTH)).astype(np.float32)
    shown, _ = student.model.predict(seen)
    reckoned = seen[:, obs.SIZE :] * [*RECKONED.values(), *[1.0] * len(SHEET)]
    for column, unit in enumerate((1.0, 1.0, 0.5, 2.0)):  # what the observation shows as 1
        expected = reckoned[:, column] / unit
        np.testing.assert_allclose(shown[:, COLUMNS[column]], expected, rtol=1e-6)
    assert (shown[:, COLUMNS[4]] == 0.0).all()  # lateral velocity
    np.testing.assert_array_equal(shown[:, COLUMNS[5]], seen[:, COLUMNS[5]])  # the gyro
    assert (shown[:, obs.INDEX["pose_age"]] == 0.0).all()
    np.testing.assert_array_equal(shown[:, obs.SIZE :], np.zeros((3, len(PRIVILEGED))))
    others = [k for k in range(obs.SIZE) if k not in (*COLUMNS, obs.INDEX["pose_age"])]
    np.testing.assert_array_equal(shown[:, others], seen[:, others])


def test_an_untrained_student_on_estimates_shows_its_teacher_the_filtered_motion(learner):
    """With ideal sensors, on the nominal vehicle and soil: the true motion, to a centimetre."""
    student = learner(student=ON_ESTIMATES, sensors=("ideal",), uncertainty=("nominal",))
    student.env.seed(0)
    observation = student.env.reset()
    for _ in range(100):
        observation, _, _, _ = student.env.step(TURNING)
    scale, motion = obs.SCALE[COLUMNS], true_motion(student)
    np.testing.assert_allclose(student.model.motion(observation) * scale, motion * scale, atol=0.01)
    largest = dict(zip(MOTION, np.abs(motion * scale).max(axis=0), strict=True))
    assert largest.pop("v_y") == 0.0  # it slides to the side on no nominal path
    assert min(largest.values()) > 0.02


def test_a_student_on_estimates_drives_as_in_training_from_an_archive_that_says_so(configured):
    config = configured(student=ON_ESTIMATES, steps=256)
    assert main(config) == 0
    path = config.folder / "last.zip"
    assert read_recipe(path)["augmentation_options"] == {
        "hidden": [16],
        "lstm_hidden": 8,
        "features": "estimates",
        "data_sheet": True,
    }
    policy = agent_entry(path).make(resolve(config).parts[0].context)
    assert policy.augmentation.feature_names == (*ESTIMATED, *SHEET) and not needs_truth(policy)
    assert policy.augmentation.learned == FEATURES  # what is kept where it learns no more
    env = make_vec_env("tracked_env/Torque-v0", 2, 0, {"sensors": "rtk"})
    observation, state = env.reset(), None
    for _ in range(20):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
    filtered = policy.augmentation.observe(observation, np.zeros(2, bool))[:, : len(FILTERED)]
    motion = policy.model.motion(np.concatenate([observation, filtered], axis=1))
    columns = [obs.INDEX["reference_speed"], obs.INDEX["reference_yaw_rate"]]
    speed, yaw_rate = (observation[:, columns] * obs.SCALE[columns]).T
    x, y, heading, slower, v_y, turning_less = (filtered * [*FILTERED.values()]).T
    expected = np.transpose([x, y, heading, speed - slower, v_y, yaw_rate - turning_less])
    np.testing.assert_allclose(motion * obs.SCALE[COLUMNS], expected, rtol=1e-5, atol=1e-6)
    assert (np.abs(expected).max(axis=0) > 1e-4).all()


@pytest.mark.parametrize("settings", [SETTINGS, ON_ESTIMATES], ids=["reckoned", "estimates"])
def test_the_right_inference_makes_the_teacher_see_the_truth(settings, learner):
    """Whatever the features say: what is wanted is the difference from it."""
    student = learner(student=settings)
    for _ in range(40):
        action = np.full((4, 2), [0.1, 0.3], np.float32)
        student._observation, _, student._start, _ = student.env.step(action)
    wanted, model = student.truth, student.model
    model.teacher, model.infer = cases.Echo(), lambda *_: (wanted, None)
    shown, _ = model.predict(student._observation)
    np.testing.assert_allclose(shown[:, COLUMNS], true_motion(student), atol=1e-5)
    hidden = np.concatenate([of.truth.present for of in student.truths])
    np.testing.assert_array_equal(shown[:, obs.SIZE :], hidden)
    least = 0.1 if settings is SETTINGS else 0.01
    assert np.abs(wanted[:, len(PRIVILEGED) :]).max() > least


def test_rows_that_start_forget_and_others_remember():
    torch.manual_seed(0)
    network = RecurrentInference(5, (6,), 4)
    torch.nn.init.normal_(network.layers[-1].weight)
    inputs, start = torch.randn(9, 2, 5), torch.zeros(9, 2, 1)
    start[4, 0] = 1.0
    with torch.no_grad():
        whole = network(inputs, start, network.blank(2))[0]
        fresh = network(inputs[4:], start[4:], network.blank(2))[0]
        first, carried = network(inputs[:4], start[:4], network.blank(2))
        second = network(inputs[4:], start[4:], carried)[0]
    torch.testing.assert_close(whole[4:, 0], fresh[:, 0])
    assert not torch.allclose(whole[4:, 1], fresh[:, 1], atol=1e-3)
    torch.testing.assert_close(whole, torch.cat([first, second]))


def test_the_regression_loss_falls(learner):
    student = learner(student=replace(SETTINGS, gradient_steps=40))
    before = student.collect()
    for _ in range(4):
        student.regress(3e-3)
    network = student.model.inference
    with torch.no_grad():
        inferred = network(student._seen[:32], student._began[:32], network.blank(4))[0]
    after = float(torch.nn.functional.smooth_l1_loss(inferred, student._true[:32]))
    assert after < 0.5 * before


def test_sequences_are_regressed_from_what_was_carried_when_their_block_began(learner, monkeypatch):
    student = learner()
    states = []
    student.collect()
    student.regress(1e-2)
    student._filled, network = 0, student.model.inference  # block 0 is what drives from here on
    carried = [torch.from_numpy(values.copy()) for values in student._state[0]]
    assert min(float(values.abs().max()) for values in carried) > 0.01
    student.collect()
    for stored, values in zip(student._carried[:, 0], carried, strict=True):
        torch.testing.assert_close(stored, values, rtol=0.0, atol=0.0)
    forward = network.forward

    def recorded(inputs, start, state):
        states.append(state)
        return forward(inputs, start, state)

    monkeypatch.setattr(network, "forward", recorded)
    student.regress(1e-2)
    assert len(states) == SETTINGS.gradient_steps
    for hidden, cell in states:  # of each sequence, one of the four vehicles
        for one, other in zip(hidden, cell, strict=True):
            assert any(
                torch.equal(one, carried[0][row]) and torch.equal(other, carried[1][row])
                for row in range(4)
            )


def test_a_saved_student_acts_as_in_training_and_needs_no_truth(configured, ideal_teacher):
    run = resolve(configured())
    student, path = StudentLearner(run), run.options.folder / "last.zip"
    student.learn(Progress(run, student))
    policy = agent_entry(path).make(run.parts[0].context)
    random = np.random.default_rng(2)
    states, start = [None, None], np.zeros(3, bool)
    for _ in range(40):
        seen = random.normal(size=(3, WIDTH)).astype(np.float32)
        start = random.random(3) < 0.1
        commands = []
        for k, model in enumerate((policy.model, student.model)):
            command, states[k] = model.predict(seen, states[k], start, deterministic=True)
            commands.append(command)
        np.testing.assert_allclose(commands[0], commands[1], atol=2e-6)
    assert np.abs(student.model.inferred).max() > 0.1
    assert not needs_truth(policy) and np.ptp(cases.as_evaluated(path)) > 0.0
    assert cases.same_arrays(path, ideal_teacher)


def test_a_row_has_the_action_of_that_row_alone_and_all_memory_is_in_the_state(configured):
    config = configured(steps=256)
    assert main(config) == 0
    entry, context = agent_entry(config.folder / "last.zip"), resolve(config).parts[1].context
    together, alone, fresh = (entry.make(context) for _ in range(3))
    env = make_vec_env("tracked_env/Torque-v0", 3, 0, {"sensors": "rtk-outages"})
    observation, state, single = env.reset(), None, None
    for _ in range(30):
        before = state
        action, state = together.predict(observation, state)
        one, single = alone.predict(observation[1:2], single)
        np.testing.assert_array_equal(action[1:2], one)
        last, observation = observation, env.step(action)[0]
    np.testing.assert_array_equal(fresh.predict(last, before)[0], action)


def test_a_student_with_an_lstm_goes_on_after_an_interruption_too(configured, tmp_path):
    """The buffer wraps meanwhile: 512 samples are kept of 1536."""
    whole = configured("whole", steps=1536, checkpoint_every=256)
    cases.interrupted_and_resumed(1024, whole, tmp_path / "parts", INFERENCE)


def test_what_makes_no_recurrent_student_is_a_clear_error():
    names = [name for name in obs.NAMES if name != "v_y"]
    with pytest.raises(ValueError, match=r"reads v_y, .* Add the groups pose_error, motion and"):
        StudentModel(RecurrentInference(40, (8,), 4), None, None, names, "reckoned")
    with pytest.raises(ValueError, match="driven by its sprocket speed; must be reckoned"):
        widened_by({"lstm_hidden": 8, "features": "estimates"}, "speed")
