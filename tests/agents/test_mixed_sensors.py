"""Vehicles with several kinds of sensors: each drives as it would alone; terms of the reward."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

import train
from agents import folder
from agents.archive import agent_entry
from agents.checkpoint import layers
from agents.environments import (
    JoinedVecEnv,
    TrainingReward,
    make_environment,
    make_part,
)
from agents.run import MIXTURE, SENSOR_MIXTURE, resolve
from baselines.learned.augmentation import KINDS
from baselines.learned.trained_agent import read_recipe
from tests.agents.agent_cases import small, torn_in_two, vehicles
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env import observation as obs
from tracked_env.benchmark.statistics import interquartile_mean
from tracked_env.environment_ids import arguments_of
from tracked_env.references import make_reference
from tracked_env.sb3 import make_vec_env

BY_SPEED = '{"plant": "distributed", "drive": "speed", "error_limit": 2, "control_rate": 25}'


ROOT = Path(__file__).resolve().parents[2]
ROWS = 6  # 2, 1, 1, 1, 1


def mixed(output, **changes):
    """A training with the mixture of sensors."""
    return small(output, **{"vehicles": ROWS, "held_out": 9, "sensors": ("mixture",), **changes})


def actions(steps):
    return np.random.default_rng(1).uniform(-0.5, 0.5, (steps, ROWS, 2)).astype(np.float32)


@pytest.mark.parametrize("kind", KINDS)
def test_a_joined_row_is_that_of_its_own_environment_bit_for_bit(kind, tmp_path):
    config = mixed(tmp_path, augmentation=kind)
    run = resolve(config)
    together = make_environment(run)
    alone = []
    for part in run.parts:
        alone.append((make_part(run, part), slice(part.first, part.first + part.rows)))
        alone[-1][0].seed(run.seed + part.first)
    shown = together.reset()
    for env, rows in alone:
        np.testing.assert_array_equal(env.reset(), shown[rows])
    ended, scale = 0, np.float32(1.0 - run.settings.gamma)
    for action in actions(70):
        shown, rewards, dones, infos = together.step(action)
        for env, rows in alone:
            seen, earned, over, told = env.step(action[rows])
            np.testing.assert_array_equal(seen, shown[rows])
            np.testing.assert_array_equal(scale * earned, rewards[rows])
            np.testing.assert_array_equal(over, dones[rows])
            for one, other in zip(told, infos[rows], strict=True):
                assert one.get("is_success") == other.get("is_success")
                if "terminal_observation" in one:
                    ended += 1
                    np.testing.assert_array_equal(
                        one["terminal_observation"], other["terminal_observation"]
                    )
                    assert "episode" in other
    assert ended >= ROWS


def test_the_mixture_is_good_late_noisy_without_velocity_with_outages_and_rare(tmp_path):
    config = mixed(tmp_path, sensors=("ideal", "mixture"), vehicles=7)
    run = resolve(config)
    assert run.arguments["sensors"] == ["ideal", *SENSOR_MIXTURE[TORQUE_ID]]
    shown = make_environment(run).reset()
    column = {name: shown[:, obs.INDEX[name]] for name in ("v_x", "position_error_x")}
    assert (column["v_x"][[0, 1, 2, 3, 5, 6]] != 0.0).all() and column["v_x"][4] == 0.0
    contexts = [part.context.sensors for part in run.parts]
    assert [sheet.position_noise for sheet in contexts] == [0.0, 0.02, 0.02, 1.0, 0.02, 0.02, 0.02]
    assert [sheet.pose_delay for sheet in contexts] == [0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.0]
    outages = [sheet.pose_outage_length for sheet in contexts]
    assert outages == [(0.0, 0.0)] * 5 + [(3.0, 10.0), (0.0, 0.0)]
    assert [sheet.pose_rate for sheet in contexts][-2:] == [contexts[0].pose_rate, 1.0]


def test_the_mixture_of_laws_is_what_its_page_says():
    """In distribution, quick changes among it; what agents must not have met stays out."""
    page = (ROOT / "docs" / "agents.md").read_text(encoding="utf-8")
    said = " ".join(page.partition("## What is trained")[2].partition("`--sensors`")[0].split())
    for env, laws in MIXTURE.items():
        listed = said.partition(f"{env.rpartition('/')[2]}: ")[2].partition(".")[0]
        assert listed.split(", ") == [f"`{name}`" for name in laws]
    left_out = {"nominal", "ood", "floor-ood", "hills-ood"}
    assert not left_out & {name for laws in MIXTURE.values() for name in laws}
    assert all(f"`{name}`" in said for name in left_out)


@pytest.mark.parametrize("env", [TORQUE_ID, SPEED_ID, TERRAIN_ID])
def test_the_mixture_of_references_goes_as_the_id_faster_and_backward(env, tmp_path):
    run = resolve(mixed(tmp_path, env=env, reference="mixture"))
    of = run.arguments["reference"]["of"]
    usual = arguments_of(env)["reference"]
    assert of[:3] == [{"kind": "random"} if env == TORQUE_ID else usual] * 3
    fast, back = (one["speed_range"] for one in of[3:])
    assert back[1] < 0.0 < fast[0]
    if env != TORQUE_ID:
        assert fast[1] > usual["speed_range"][1] and of[3]["vehicle"] == "focchi"
    speeds = []
    for seed in range(60):
        profile = make_reference(run.arguments["reference"], 5.0, np.random.default_rng(seed))
        speeds.append(profile.speed[:, 0].mean())
    assert 4 <= np.sum(np.array(speeds) < 0.0) <= 22  # of 12 expected


def test_a_wrong_kind_of_reference_is_told_that_there_is_the_mixture(tmp_path):
    with pytest.raises(ValueError, match=r"'mixed', 'mixture', 'plan'.* Did you mean 'mixture'"):
        resolve(mixed(tmp_path, reference="mixtur"))


def test_vehicles_are_shared_evenly_and_one_kind_stays_one_environment(tmp_path):
    four = {"sensors": ("ideal", "rtk", "strawa", "mocap"), "held_out": 4}
    parts = resolve(small(tmp_path, vehicles=10, **four)).parts
    assert [(part.rows, part.first) for part in parts] == [(3, 0), (3, 3), (2, 6), (2, 8)]
    with pytest.raises(ValueError, match="3 vehicles or held-out episodes for 4 kinds"):
        resolve(small(tmp_path, vehicles=3, **four))
    config = small(tmp_path, sensors=("strawa",))
    env = make_environment(resolve(config))
    assert not any(isinstance(layer, JoinedVecEnv) for layer in layers(env))


def test_the_rows_of_a_joined_environment_can_be_asked_and_seeded():
    def part(count):
        return DummyVecEnv([lambda: gymnasium.make("Pendulum-v1")] * count)

    env, whole = JoinedVecEnv([part(2), part(1)]), part(3)
    env.seed(7)
    whole.seed(7)
    np.testing.assert_array_equal(env.reset(), whole.reset())
    assert env.get_attr("g", [2]) == [10.0]
    env.set_attr("g", 1.0, [0, 2])
    assert env.get_attr("g") == [1.0, 10.0, 1.0]
    assert env.env_method("get_wrapper_attr", "m", indices=[1]) == [1.0]
    assert env.env_is_wrapped(gymnasium.wrappers.TimeLimit) == [True] * 3
    env.close()


@pytest.mark.parametrize(
    ("algorithm", "kind"),
    [("ppo", "residual"), pytest.param("sac", "history", marks=pytest.mark.slow)],
)
def test_a_resumed_training_with_several_sensors_is_the_uninterrupted_one(
    algorithm, kind, tmp_path, monkeypatch
):
    changes = {"agent": algorithm, "augmentation": kind, "normalise": True}
    whole = mixed(tmp_path / "whole", steps=768, checkpoint_every=100, **changes)
    assert torn_in_two(400, whole, tmp_path / "torn", monkeypatch)


def test_held_out_episodes_have_all_sensors_and_each_kind_counts_the_same(tmp_path):
    config = mixed(tmp_path, augmentation="estimates", steps=192)
    assert train.main(config) == 0
    recipe = read_recipe(tmp_path / "last.zip")
    assert recipe["config"]["sensors"] == ["mixture"]
    assert recipe["environment"]["sensors"] == [
        entry if isinstance(entry, str) else dict(entry) for entry in SENSOR_MIXTURE[TORQUE_ID]
    ]
    held_out = folder.make_held_out(resolve(config))
    entry = agent_entry(tmp_path / "last.zip")
    assert [part.env.num_envs for part in held_out] == [2, 2, 2, 1, 1, 1]
    means = [
        interquartile_mean(
            folder.held_out_errors(entry.make(part.context), part.env, folder.HELD_OUT_SEED + first)
        )
        for part, first in zip(held_out, (0, 2, 4, 6, 7, 8), strict=True)
    ]
    found = folder.held_out_rmse(entry.make, held_out)
    assert found == pytest.approx(np.mean(means), rel=1e-12)
    assert found == pytest.approx(recipe["held_out_rmse"], rel=1e-6)
    assert np.isnan(folder.held_out_rmse(entry.make, []))


# The reward of the training, at the end of an episode too


def drive_with(actions, **terms):
    """What the terms add to the reward, and the true distances, where both end twice."""
    plain, shaped = vehicles(duration=0.5), TrainingReward(vehicles(duration=0.5), **terms)
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
    added, distance = drive_with(actions, precision=0.1, smoothness=0.0)
    np.testing.assert_allclose(added, 1.0 / (1.0 + (distance / 0.1) ** 2), rtol=1e-9)


def test_the_smooth_term_is_the_mean_square_of_the_change_also_where_an_episode_ends():
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 3, 2)).astype(np.float32)
    added, _ = drive_with(actions, precision=0.0, smoothness=3.0)
    before = np.concatenate([np.zeros((1, 3, 2)), actions[:-1]])
    before[[25, 50]] = 0.0  # the first step of an episode of 25
    np.testing.assert_allclose(added, -3.0 * np.mean((actions - before) ** 2, axis=-1), rtol=1e-6)


def test_terms_of_weight_0_add_nothing():
    actions = np.full((60, 3, 2), 0.2, np.float32)
    added, _ = drive_with(actions, precision=0.0, smoothness=0.0)
    np.testing.assert_array_equal(added, 0.0)


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
