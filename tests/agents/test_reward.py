"""The reward of the training: the values of its terms, at the end of an episode too."""

import numpy as np
import pytest

from agents.environments import ScaledReward, TrainingReward, make_environment
from agents.run import resolve
from tests.agents.agent_cases import small
from tracked_env.sb3 import make_vec_env
from tracked_env.vector_env import TrackedVehicleVectorEnv


def vehicles():
    return TrackedVehicleVectorEnv(
        3, uncertainty="payload", duration=0.5, autoreset_mode="SameStep"
    )


def driven(actions, **terms):
    """What the terms add to the reward, and the true distances, where both end twice."""
    plain, shaped = vehicles(), TrainingReward(vehicles(), **terms)
    plain.reset(seed=0)
    shaped.reset(seed=0)
    added, distances, endings = [], [], 0
    for action in actions:
        _, reward, terminated, truncated, info = plain.step(action)
        ended = terminated | truncated
        assert ended.all() or not ended.any()
        endings += ended.all()
        shown = info["final_info"] if ended.all() else info
        distances.append(shown["tracking_error"][:, 0])
        added.append(shaped.step(action)[1] - reward)
    assert endings == 2
    return np.array(added), np.array(distances)


def test_the_precise_term_is_of_the_true_distance_also_where_an_episode_ends():
    actions = np.full((60, 3, 2), 0.2, np.float32)
    added, distance = driven(actions, precision=0.1, smoothness=0.0)
    np.testing.assert_allclose(added, 1.0 / (1.0 + (distance / 0.1) ** 2), rtol=1e-9)


def test_the_smooth_term_is_the_mean_square_of_the_change_also_where_an_episode_ends():
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 3, 2)).astype(np.float32)
    added, _ = driven(actions, precision=0.0, smoothness=3.0)
    before = np.concatenate([np.zeros((1, 3, 2)), actions[:-1]])
    before[[25, 50]] = 0.0  # the first step of an episode of 25
    np.testing.assert_allclose(added, -3.0 * np.mean((actions - before) ** 2, axis=-1), rtol=1e-6)


def test_terms_of_weight_0_add_nothing():
    actions = np.full((60, 3, 2), 0.2, np.float32)
    added, _ = driven(actions, precision=0.0, smoothness=0.0)
    np.testing.assert_array_equal(added, 0.0)


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("term", ["precision", "smoothness"])
def test_a_term_without_sense_is_a_clear_error(term, value):
    with pytest.raises(ValueError, match=f"{term} = .*; must be at least 0"):
        TrainingReward(vehicles(), **{"precision": 0.15, term: value})


def trained_and_plain(config):
    """The environment of a training and a plain one, at the start of the same episodes."""
    run = resolve(config)
    plain = make_vec_env(n_envs=config.vehicles, seed=run.seed, env_kwargs=run.arguments)
    trained = make_environment(run)
    plain.reset()
    trained.reset()
    return trained, plain


def test_the_learner_gets_rewards_whose_discounted_sum_is_a_mean_and_the_curve_plain_ones(tmp_path):
    config = small(tmp_path, precision=0.0, smoothness=0.0, staggered=False)
    scaled, plain = trained_and_plain(config)
    total = np.zeros(config.vehicles)
    for _ in range(50):  # an episode of 1 s
        action = np.full((config.vehicles, 2), 0.2, np.float32)
        _, expected, _, _ = plain.step(action)
        _, found, ended, infos = scaled.step(action)
        np.testing.assert_allclose(found, (1.0 - config.ppo.gamma) * expected, rtol=1e-6)
        total += expected
    assert ended.all()
    np.testing.assert_allclose([info["episode"]["r"] for info in infos], total, rtol=1e-5)


@pytest.mark.parametrize("gamma", [1.0, -0.1, float("nan")])
def test_a_horizon_without_end_is_a_clear_error(gamma):
    with pytest.raises(ValueError, match=r"must be in \[0, 1\)"):
        ScaledReward(make_vec_env(n_envs=1), gamma)


@pytest.mark.parametrize(
    ("agent", "given", "price"),
    [("ppo", None, 1.0), ("sac", None, 0.0), ("td3", None, 0.0), ("td3", 2.0, 2.0)],
)
def test_agents_with_a_replay_buffer_pay_for_changes_only_when_told_to(
    agent, given, price, tmp_path
):
    config = small(tmp_path, agent=agent, precision=0.0, smoothness=given, staggered=False)
    env, plain = trained_and_plain(config)
    action = np.random.default_rng(1).uniform(-1.0, 1.0, (config.vehicles, 2)).astype(np.float32)
    expected = plain.step(action)[1] - price * np.mean(action**2, axis=1)
    run = resolve(config)
    scale = 1.0 - run.settings.gamma if run.algorithm.scaled else 1.0
    np.testing.assert_allclose(env.step(action)[1], scale * expected, rtol=1e-5)
    assert run.recipe["config"]["smoothness"] == price
