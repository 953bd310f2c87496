"""Observations with identified features: spaces, every autoreset mode, what is forgotten when."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3

from baselines.estimators.stack import FEATURES, IdentificationStack
from tests.driving import wild_actions
from tracked_env import observation as layout
from tracked_env.env import TrackedVehicleEnv
from tracked_env.sb3 import make_vec_env
from tracked_env.vector_env import TrackedVehicleVectorEnv
from tracked_env.wrappers import FEATURE_BOUND, IdentifiedObservation, IdentifiedVectorObservation

WIDTH = layout.SIZE + len(FEATURES)
HARD = {"uncertainty": "mixed", "duration": 1.0, "error_limit": 0.5}


def vector(count, mode=AutoresetMode.NEXT_STEP, **options):
    env = TrackedVehicleVectorEnv(count, autoreset_mode=mode, **{**HARD, **options})
    return IdentifiedVectorObservation(env, IdentificationStack(count=count))


class Twin:
    """The features of one row, found by a stack of its own that sees one episode at a time."""

    def __init__(self):
        self.stack, self.start = IdentificationStack(), True

    def features(self, observation):
        shown = self.stack.observe(observation[None, : layout.SIZE], np.array([self.start]))[0]
        self.start = False
        return np.clip(shown, -FEATURE_BOUND, FEATURE_BOUND)

    def forget(self):
        self.stack, self.start = IdentificationStack(), True


# --- spaces ---------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")
def test_both_checkers_accept_the_wrapped_environment():
    env = IdentifiedObservation(gymnasium.make("tracked_env/Torque-v0"), IdentificationStack())
    check_env(env, skip_render_check=True)
    check_env_of_sb3(env)


def test_the_space_is_that_of_the_environment_and_then_the_features():
    single = IdentifiedObservation(TrackedVehicleEnv(), IdentificationStack())
    many = vector(3)
    for space in (single.observation_space, many.single_observation_space):
        assert space.shape == (WIDTH,)
        assert space.dtype == np.float32
        assert np.array_equal(space.low[: layout.SIZE], layout.LOW)
        assert (space.high[layout.SIZE :] == FEATURE_BOUND).all()
    assert many.observation_space.shape == (3, WIDTH)
    assert single.reset(seed=0)[0] in single.observation_space
    assert many.reset(seed=0)[0] in many.observation_space
    assert many.step(np.zeros((3, 2), np.float32))[0] in many.observation_space


def test_features_beyond_the_bound_or_missing_stay_inside_the_space():
    class Wild(IdentificationStack):
        def observe(self, observation, start):
            features = super().observe(observation, start)
            features[:, :3] = np.nan, np.inf, -1e9
            return features

    env = IdentifiedObservation(TrackedVehicleEnv(), Wild())
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    values = observation[layout.SIZE :][:3].tolist()
    assert values == [0.0, FEATURE_BOUND, -FEATURE_BOUND]


# --- numbers --------------------------------------------------------------------------------


def test_a_new_episode_of_one_environment_starts_with_nothing_known():
    env = IdentifiedObservation(TrackedVehicleEnv(), IdentificationStack())
    first, _ = env.reset(seed=5)
    for _ in range(40):
        last, *_ = env.step(np.array([0.1, 0.4], np.float32))
    assert not np.array_equal(first[layout.SIZE :], last[layout.SIZE :])
    assert np.array_equal(first, env.reset(seed=5)[0])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_no_feature_of_an_ended_row_leaks_into_its_next_episode(mode):
    count = 5
    env = vector(count, mode)
    twins = [Twin() for _ in range(count)]
    observation, _ = env.reset(seed=3)
    over, ends = np.zeros(count, dtype=bool), np.zeros(count, dtype=int)
    for actions in [None, *wild_actions(160, count)]:
        if actions is not None:
            observation, _, terminated, truncated, info = env.step(actions)
            ended = terminated | truncated
            ends += ended
            for i in np.flatnonzero(ended if mode is AutoresetMode.SAME_STEP else over):
                if mode is AutoresetMode.SAME_STEP:
                    last = info["final_obs"][i]
                    assert last.shape == (WIDTH,)
                    assert np.array_equal(last[layout.SIZE :], twins[i].features(last))
                twins[i].forget()
            over = ended
        for i in range(count):
            assert np.array_equal(observation[i, layout.SIZE :], twins[i].features(observation[i]))
    assert ends.min() >= 2
    assert len(set(ends)) > 1  # rows end at different times


def test_without_autoreset_an_ended_row_rests_and_a_mask_starts_it_anew():
    count = 4
    env = vector(count, AutoresetMode.DISABLED)
    twins = [Twin() for _ in range(count)]
    observation, _ = env.reset(seed=3)
    resting, resets = np.zeros(count, dtype=bool), 0
    for step, actions in enumerate([None, *wild_actions(160, count)]):
        before = observation
        if actions is not None:
            observation, _, terminated, truncated, _ = env.step(actions)
        for i in range(count):
            if resting[i]:
                assert np.array_equal(observation[i], before[i])
            else:
                expected = twins[i].features(observation[i])
                assert np.array_equal(observation[i, layout.SIZE :], expected)
        resting = resting if actions is None else terminated | truncated
        if step % 7 == 6 and resting.any():
            before = observation
            observation, _ = env.reset(options={"reset_mask": resting})
            assert np.array_equal(observation[~resting], before[~resting])
            for i in np.flatnonzero(resting):
                twins[i].forget()
                expected = twins[i].features(observation[i])
                assert np.array_equal(observation[i, layout.SIZE :], expected)
            resets += resting.sum()
            resting = np.zeros(count, dtype=bool)
    assert resets > count


def test_rows_reset_in_mid_episode_forget_and_the_others_do_not():
    env = vector(3, duration=5.0, error_limit=5.0)
    env.reset(seed=1)
    for actions in wild_actions(30, 3):
        before, *_ = env.step(0.2 * actions)
    mask = np.array([True, False, False])
    after, _ = env.reset(options={"reset_mask": mask})
    assert np.array_equal(after[~mask], before[~mask])
    assert np.array_equal(after[0, layout.SIZE :], Twin().features(after[0]))
    again, _ = env.reset(seed=1)
    assert np.array_equal(again, vector(3, duration=5.0, error_limit=5.0).reset(seed=1)[0])


# --- Stable-Baselines3 ----------------------------------------------------------------------


def test_ppo_trains_on_identified_observations():
    count = 4
    env = make_vec_env(
        n_envs=count,
        seed=0,
        env_kwargs={"duration": 0.4},
        wrapper=lambda env: IdentifiedVectorObservation(env, IdentificationStack(count=count)),
    )
    assert env.observation_space.shape == (WIDTH,)
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=64, device="cpu", seed=0)
    model.learn(256)
    assert model.ep_info_buffer[0]["l"] == 20
    env.reset()
    for _ in range(20):
        observation, _, dones, infos = env.step(np.full((count, 2), 0.2, np.float32))
    assert dones.all()
    for i in range(count):
        assert infos[i]["terminal_observation"].shape == (WIDTH,)
        assert np.array_equal(observation[i, layout.SIZE :], Twin().features(observation[i]))


# --- errors ---------------------------------------------------------------------------------


def test_an_observer_that_does_not_fit_is_refused():
    single, many = TrackedVehicleEnv(), TrackedVehicleVectorEnv(3)
    with pytest.raises(ValueError, match=r"an observer of 2 vehicles for 1; pass count=1"):
        IdentifiedObservation(single, IdentificationStack(count=2))
    with pytest.raises(ValueError, match=r"an observer of 1 vehicles for 3; pass count=3"):
        IdentifiedVectorObservation(many, IdentificationStack())
    slow = IdentificationStack(control_period=0.05)
    with pytest.raises(ValueError, match=r"period is 0.05 s, that of the environment 0.02 s"):
        IdentifiedObservation(single, slow)
    fitting = IdentifiedObservation(TrackedVehicleEnv(control_rate=20.0), slow)
    assert fitting.reset(seed=0)[0].shape == (WIDTH,)


def test_an_environment_that_is_not_ours_is_refused():
    with pytest.raises(ValueError, match="is no environment of this project"):
        IdentifiedObservation(gymnasium.make("CartPole-v1"), IdentificationStack())
