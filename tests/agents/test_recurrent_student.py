"""A student with an LSTM: what it learns from, what its teacher is shown, that it drives alone."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from agents.algorithms import StudentSettings
from agents.archive import RecurrentInference, RecurrentStudentModel, agent_entry, inference_weights
from agents.folder import Learner, Progress
from agents.learners import RecurrentStudentLearner
from agents.run import resolve
from baselines.learned.agent_archive import INFERENCE, from_npz, read_entry, read_recipe
from baselines.learned.agent_policy import MOTION, PRIVILEGED
from baselines.learned.augmentation import FILTERED, RECKONED, SHEET
from baselines.learned.controller_augmentation import ESTIMATED, FEATURES
from baselines.learned.student import OUTPUTS, features_of, read_recurrent_student
from tests.agents.agent_cases import actor, same_parameters, small
from tests.agents.test_agents import as_evaluated
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


@pytest.fixture(scope="module")
def teacher(tmp_path_factory):
    folder = tmp_path_factory.mktemp("teacher")
    assert main(small(folder, augmentation="teacher", sensors=("ideal",))) == 0
    return folder / "agent.zip"


def configured(folder, teacher, **changes):
    given = {
        "steps": 1024, "data_sheet": True, "sensors": ("rtk", "rtk-outages"), "student": SETTINGS,
        **changes,
    }  # fmt: skip
    return small(folder, augmentation="student", teacher=teacher, **given)


def test_the_true_motion_is_what_ideal_sensors_show(teacher, tmp_path):
    student = RecurrentStudentLearner(
        resolve(configured(tmp_path, teacher, sensors=("ideal",), duration=2.0))
    )
    student.env.seed(0)
    observation, ended = student.env.reset(), 0
    for _ in range(150):  # over the end of an episode
        motion = np.concatenate([truth.motion() for truth in student.truths])
        np.testing.assert_allclose(motion, observation[:, COLUMNS], atol=2e-6)
        observation, _, over, _ = student.env.step(np.full((4, 2), [0.1, 0.2], np.float32))
        ended += int(np.sum(over))
    assert ended >= 4 and np.ptp(motion) > 0.1


def test_an_untrained_student_shows_its_teacher_dead_reckoning_and_the_nominal_vehicle(
    teacher, tmp_path
):
    student = RecurrentStudentLearner(resolve(configured(tmp_path, teacher)))

    class Echo:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return observation, state

    student.model.teacher = Echo()
    seen = np.random.default_rng(0).normal(size=(3, WIDTH)).astype(np.float32)
    shown, _ = student.model.predict(seen)
    reckoned = seen[:, obs.SIZE :] * [*RECKONED.values(), *[1.0] * len(SHEET)]
    np.testing.assert_allclose(shown[:, COLUMNS[0]], reckoned[:, 0], rtol=1e-6)  # [m], shown as m
    np.testing.assert_allclose(shown[:, COLUMNS[1]], reckoned[:, 1], rtol=1e-6)
    np.testing.assert_allclose(shown[:, COLUMNS[2]], reckoned[:, 2] / 0.5, rtol=1e-6)
    np.testing.assert_allclose(shown[:, COLUMNS[3]], reckoned[:, 3] / 2.0, rtol=1e-6)
    assert (shown[:, COLUMNS[4]] == 0.0).all()  # lateral velocity
    np.testing.assert_array_equal(shown[:, COLUMNS[5]], seen[:, COLUMNS[5]])  # the gyro
    assert (shown[:, obs.INDEX["pose_age"]] == 0.0).all()
    np.testing.assert_array_equal(shown[:, obs.SIZE :], np.zeros((3, len(PRIVILEGED))))
    others = [k for k in range(obs.SIZE) if k not in (*COLUMNS, obs.INDEX["pose_age"])]
    np.testing.assert_array_equal(shown[:, others], seen[:, others])


def test_an_untrained_student_on_estimates_shows_its_teacher_the_filtered_motion(teacher, tmp_path):
    """With ideal sensors, on the nominal vehicle and soil: the true motion, to a centimetre."""
    config = configured(
        tmp_path, teacher, student=ON_ESTIMATES, sensors=("ideal",), uncertainty=("nominal",)
    )
    student = RecurrentStudentLearner(resolve(config))
    student.env.seed(0)
    observation = student.env.reset()
    for _ in range(100):
        observation, _, _, _ = student.env.step(np.full((4, 2), [0.1, 0.2], np.float32))
    motion = np.concatenate([truth.motion() for truth in student.truths])
    scale = obs.SCALE[COLUMNS]
    np.testing.assert_allclose(student.model._said(observation) * scale, motion * scale, atol=0.01)
    largest = dict(zip(MOTION, np.abs(motion * scale).max(axis=0), strict=True))
    assert largest.pop("v_y") == 0.0  # it slides to the side on no nominal path
    assert min(largest.values()) > 0.02


def test_a_student_on_estimates_drives_as_in_training_from_an_archive_that_says_so(
    teacher, tmp_path
):
    config = configured(tmp_path, teacher, student=ON_ESTIMATES, steps=256)
    assert main(config) == 0
    recipe = read_recipe(tmp_path / "last.zip")
    assert recipe["augmentation_options"] == {
        "hidden": [16], "lstm_hidden": 8, "features": "estimates", "data_sheet": True
    }  # fmt: skip
    assert recipe["config"]["student"]["features"] == "estimates"
    policy = agent_entry(tmp_path / "last.zip").make(resolve(config).parts[0].context)
    assert policy.augmentation.feature_names == (*ESTIMATED, *SHEET) and not needs_truth(policy)
    assert policy.augmentation.learned == FEATURES  # what is kept where it learns no more
    env = make_vec_env("tracked_env/Torque-v0", 2, 0, {"sensors": "rtk"})
    observation, state = env.reset(), None
    for _ in range(20):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
    filtered = policy.augmentation.observe(observation, np.zeros(2, bool))[:, : len(FILTERED)]
    said = policy.model._said(np.concatenate([observation, filtered], axis=1))
    wanted = observation[:, [obs.INDEX["reference_speed"], obs.INDEX["reference_yaw_rate"]]]
    wanted = wanted * obs.SCALE[[obs.INDEX["reference_speed"], obs.INDEX["reference_yaw_rate"]]]
    x, y, heading, slower, v_y, turning_less = (filtered * [*FILTERED.values()]).T
    expected = [x, y, heading, wanted[:, 0] - slower, v_y, wanted[:, 1] - turning_less]
    np.testing.assert_allclose(
        said * obs.SCALE[COLUMNS], np.transpose(expected), rtol=1e-5, atol=1e-6
    )
    assert (np.abs(expected).max(axis=1) > 1e-4).all()


@pytest.mark.parametrize("settings", [SETTINGS, ON_ESTIMATES], ids=["reckoned", "estimates"])
def test_the_right_inference_makes_the_teacher_see_the_truth(settings, teacher, tmp_path):
    """Whatever the features say: what is wanted is the difference from it."""
    student = RecurrentStudentLearner(resolve(configured(tmp_path, teacher, student=settings)))
    for _ in range(40):
        action = np.full((4, 2), [0.1, 0.3], np.float32)
        student._observation, _, student._start, _ = student.env.step(action)
    wanted, model = student.truth, student.model
    seen = []

    class Watching:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            seen.append(observation)
            return observation[:, :2], state

    model.teacher, model.infer = Watching(), lambda *_: (wanted, None)
    model.predict(student._observation)
    motion = np.concatenate([truth.motion() for truth in student.truths])
    np.testing.assert_allclose(seen[0][:, COLUMNS], motion, atol=1e-5)
    hidden = np.concatenate([truth.present for truth in student.truths])
    np.testing.assert_array_equal(seen[0][:, obs.SIZE :], hidden)
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


def test_the_regression_loss_falls(teacher, tmp_path):
    settings = replace(SETTINGS, gradient_steps=40)
    student = RecurrentStudentLearner(
        resolve(replace(configured(tmp_path, teacher), student=settings))
    )
    losses = [student.collect()]
    for _ in range(4):
        student.regress(3e-3)
    with torch.no_grad():
        found = student.model.inference(
            student._seen[:32], student._began[:32], student.model.inference.blank(4)
        )[0]
    losses.append(float(torch.nn.functional.smooth_l1_loss(found, student._true[:32])))
    assert losses[1] < 0.5 * losses[0]


def test_sequences_are_regressed_from_what_was_carried_when_their_block_began(
    teacher, tmp_path, monkeypatch
):
    student = RecurrentStudentLearner(resolve(configured(tmp_path, teacher)))
    said = []
    student.collect()
    student.regress(1e-2)
    student._filled, network = 0, student.model.inference  # block 0 is what drives from here on
    carried = [torch.from_numpy(values.copy()) for values in student._state[0]]
    assert min(float(values.abs().max()) for values in carried) > 0.01
    student.collect()
    for kept, values in zip(student._carried[:, 0], carried, strict=True):
        torch.testing.assert_close(kept, values, rtol=0.0, atol=0.0)
    forward = network.forward

    def told(inputs, start, begun):
        said.append(begun)
        return forward(inputs, start, begun)

    monkeypatch.setattr(network, "forward", told)
    student.regress(1e-2)
    assert len(said) == SETTINGS.gradient_steps
    for hidden, cell in said:  # of each sequence, one of the four vehicles
        for one, other in zip(hidden, cell, strict=True):
            same = [
                torch.equal(one, carried[0][row]) and torch.equal(other, carried[1][row])
                for row in range(4)
            ]
            assert any(same)


def test_a_saved_student_acts_as_in_training_and_needs_no_truth(teacher, tmp_path):
    run = resolve(configured(tmp_path, teacher))
    student = RecurrentStudentLearner(run)
    learner: Learner = student
    learner.learn(Progress(run, student))
    content = inference_weights(student.model.inference)
    options = dict(run.augmentation.options)
    names = [*obs.NAMES]
    alone = read_recurrent_student(content, options, WIDTH, actor(teacher), None, names)
    random = np.random.default_rng(2)
    states, start = [None, None], np.zeros(3, bool)
    for _ in range(40):
        seen = random.normal(size=(3, WIDTH)).astype(np.float32)
        start = random.random(3) < 0.1
        commands = []
        for k, model in enumerate((alone, student.model)):
            command, states[k] = model.predict(seen, states[k], start, deterministic=True)
            commands.append(command)
        np.testing.assert_allclose(commands[0], commands[1], atol=2e-6)
    assert np.abs(student.model.found).max() > 0.1 and student.model.found.shape == (3, OUTPUTS)
    policy = agent_entry(tmp_path / "last.zip").make(run.parts[0].context)
    assert not needs_truth(policy) and np.ptp(as_evaluated(tmp_path / "last.zip")) > 0.0
    assert same_parameters(tmp_path / "last.zip", teacher)
    recipe = read_recipe(tmp_path / "last.zip")
    assert recipe["augmentation_options"] == {
        "hidden": [16], "lstm_hidden": 8, "data_sheet": True
    }  # fmt: skip


def test_a_row_has_the_action_of_that_row_alone_and_all_memory_is_in_the_state(teacher, tmp_path):
    run = resolve(configured(tmp_path, teacher, steps=256))
    assert main(configured(tmp_path, teacher, steps=256)) == 0
    entry = agent_entry(tmp_path / "last.zip")
    together, alone = (entry.make(run.parts[1].context) for _ in range(2))
    env = make_vec_env("tracked_env/Torque-v0", 3, 0, {"sensors": "rtk-outages"})
    observation, state, single = env.reset(), None, None
    for _ in range(30):
        kept = state
        action, state = together.predict(observation, state)
        one, single = alone.predict(observation[1:2], single)
        np.testing.assert_array_equal(action[1:2], one)
        last, observation = observation, env.step(action)[0]
    fresh = entry.make(run.parts[1].context)
    np.testing.assert_array_equal(fresh.predict(last, kept)[0], action)


def test_a_student_goes_on_after_an_interruption_as_if_nothing_had_been(
    teacher, tmp_path, monkeypatch
):
    """The buffer wraps meanwhile: 512 samples are kept of 1536."""
    given = {"steps": 1536, "checkpoint_every": 256}
    assert main(configured(tmp_path / "whole", teacher, **given)) == 0
    collect = RecurrentStudentLearner.collect

    def interrupted(self):
        if self.steps >= 1024:
            raise KeyboardInterrupt
        return collect(self)

    with monkeypatch.context() as patch:
        patch.setattr(RecurrentStudentLearner, "collect", interrupted)
        assert main(configured(tmp_path / "parts", teacher, **given)) == 130
    assert main(configured(tmp_path / "parts", teacher, **given, resume=True)) == 0
    one, other = (
        from_npz(read_entry(tmp_path / name / "last.zip", INFERENCE), INFERENCE)
        for name in ("whole", "parts")
    )
    assert set(one) == set(other)
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)


def test_what_makes_no_recurrent_student_is_a_clear_error(teacher, tmp_path, capsys):
    names = [name for name in obs.NAMES if name != "v_y"]
    with pytest.raises(ValueError, match=r"reads v_y, .* Add the groups pose_error, motion and"):
        RecurrentStudentModel(RecurrentInference(40, (8,), 4), None, None, names)
    config = configured(tmp_path / "none", teacher, lags=(1, 2))
    assert main(config) == 2
    assert "--lags has no effect with --student.lstm-hidden 8" in capsys.readouterr().err
    config = configured(tmp_path / "none", teacher, student=StudentSettings(features="estimates"))
    assert main(config) == 2
    assert "--student.features estimates has no effect" in capsys.readouterr().err
    with pytest.raises(ValueError, match="driven by its sprocket speed; must be reckoned"):
        features_of({"features": "estimates"}, "speed")
    content = inference_weights(RecurrentInference(WIDTH, (16,), 8))
    options = {"hidden": [16], "lstm_hidden": 9}
    with pytest.raises(ValueError, match="weights"):
        read_recurrent_student(content, options, WIDTH, None, None, [*obs.NAMES])
