"""A student with an LSTM: what it learns from, what its teacher is shown, that it drives alone."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from agents.algorithms import StudentSettings
from agents.archive import RecurrentInference, StudentModel, agent_entry
from agents.folder import Progress
from agents.learners import StudentLearner
from agents.run import resolve
from baselines.learned.augmentation import FILTERED, RECKONED, SHEET
from baselines.learned.controller_augmentation import ESTIMATED, FEATURES
from baselines.learned.student import INFERENCE, MOTION, PRIVILEGED, widened_by
from baselines.learned.trained_agent import read_recipe
from tests.agents.agent_cases import (
    Echo,
    as_evaluated,
    interrupted_at,
    one_line,
    same_arrays,
    same_parameters,
    small,
    student_config,
)
from tracked_env import observation as obs
from tracked_env.benchmark.policy_interface import needs_truth
from tracked_env.sb3 import make_vec_env
from train import main

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
    assert main(small(folder, augmentation="teacher", sensors=("ideal",))) == 0
    return folder / "agent.zip"


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
        return student_config(tmp_path / name, ideal_teacher, **options)

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
    student.model.teacher = Echo()
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
    model.teacher, model.infer = Echo(), lambda *_: (wanted, None)
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
    assert not needs_truth(policy) and np.ptp(as_evaluated(path)) > 0.0
    assert same_parameters(path, ideal_teacher)


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


def test_a_student_goes_on_after_an_interruption_as_if_nothing_had_been(configured):
    """The buffer wraps meanwhile: 512 samples are kept of 1536."""
    changes = {"steps": 1536, "checkpoint_every": 256}
    whole, parts = configured("whole", **changes), configured("parts", **changes)
    assert main(whole) == 0
    interrupted_at(1024, parts)
    assert main(replace(parts, resume=True)) == 0
    assert same_arrays(whole.folder / "last.zip", parts.folder / "last.zip", INFERENCE)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lags": (1, 2)}, "--lags has no effect with --student.lstm-hidden 8"),
        (
            {"student": StudentSettings(features="estimates")},
            "--student.features estimates has no effect",
        ),
    ],
)
def test_options_that_a_recurrent_student_does_not_read_are_refused(
    changes, message, configured, capsys
):
    assert main(configured("none", **changes)) == 2
    assert message in one_line(capsys)


def test_what_makes_no_recurrent_student_is_a_clear_error():
    names = [name for name in obs.NAMES if name != "v_y"]
    with pytest.raises(ValueError, match=r"reads v_y, .* Add the groups pose_error, motion and"):
        StudentModel(RecurrentInference(40, (8,), 4), None, None, names, "reckoned")
    with pytest.raises(ValueError, match="driven by its sprocket speed; must be reckoned"):
        widened_by({"lstm_hidden": 8, "features": "estimates"}, "speed")
