"""Vehicles with several kinds of sensors: each drives as it would alone, and is resumed so."""

from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

import train
from agents.archive import agent_entry
from agents.checkpoint import layers
from agents.environments import JoinedVecEnv, joined, make_environment, make_part
from agents.folder import HELD_OUT_SEED, held_out_errors, held_out_rmse, make_held_out
from agents.run import MIXTURE, SENSOR_MIXTURE, resolve, shares
from baselines.learned.trained_agent import read_recipe
from baselines.learned.augmentation import KINDS
from tests.agents.agent_cases import same_parameters, small
from tests.agents.test_checkpoints import killed_after
from tracked_env import TORQUE_ID
from tracked_env import observation as obs
from tracked_env.benchmark.statistics import interquartile_mean

ROOT = Path(__file__).resolve().parents[2]
VEHICLES = 6  # 2, 1, 1, 1, 1


def mixed(output, **changes):
    """A training with the mixture of sensors."""
    given = {"vehicles": VEHICLES, "held_out": 9, "sensors": ("mixture",), **changes}
    return small(output, **given)


def actions(steps):
    return np.random.default_rng(1).uniform(-0.5, 0.5, (steps, VEHICLES, 2)).astype(np.float32)


@pytest.mark.parametrize("kind", [*KINDS, "teacher"])
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
    assert ended >= VEHICLES


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
    """In distribution, weak drives and faults among it; what agents must not have met stays out."""
    page = (ROOT / "docs" / "agents.md").read_text(encoding="utf-8")
    said = " ".join(page.partition("## What is trained")[2].partition("`--sensors`")[0].split())
    for env, laws in MIXTURE.items():
        listed = said.partition(f"{env.rpartition('/')[2]}: ")[2].partition(".")[0]
        assert listed.split(", ") == [f"`{name}`" for name in laws]
    left_out = {
        "nominal",
        "ood",
        "slow-drive",
        "slow-floor-drive",
        "loose-soil",
        "floor-ood",
        "hills-ood",
    }
    assert not left_out & {name for laws in MIXTURE.values() for name in laws}
    assert all(f"`{name}`" in said for name in left_out)


def test_vehicles_are_shared_evenly_and_one_kind_stays_one_environment(tmp_path):
    assert shares(10, 4) == [3, 3, 2, 2] and shares(4, 4) == [1, 1, 1, 1]
    with pytest.raises(ValueError, match="3 vehicles or held-out episodes for 4 kinds"):
        shares(3, 4)
    config = small(tmp_path, sensors=("strawa",))
    env = make_environment(resolve(config))
    assert not any(isinstance(layer, JoinedVecEnv) for layer in layers(env))


def test_environments_with_other_spaces_are_not_joined():
    two = [
        DummyVecEnv([lambda name=name: gymnasium.make(name)])
        for name in ("Pendulum-v1", "CartPole-v1")
    ]
    with pytest.raises(ValueError, match="different spaces"):
        JoinedVecEnv(two)


def test_the_rows_of_a_joined_environment_can_be_asked_and_seeded():
    def part(count):
        return DummyVecEnv([lambda: gymnasium.make("Pendulum-v1")] * count)

    env, whole = joined([part(2), part(1)], 7), part(3)
    whole.seed(7)
    np.testing.assert_array_equal(env.reset(), whole.reset())
    assert env.get_attr("g", [2]) == [10.0]
    env.set_attr("g", 1.0, [0, 2])
    assert env.get_attr("g") == [1.0, 10.0, 1.0]
    assert env.env_method("get_wrapper_attr", "m", indices=[1]) == [1.0]
    assert env.env_is_wrapped(gymnasium.wrappers.TimeLimit) == [True] * 3
    env.set_options([{}, {}, {"x_init": 0.0, "y_init": 0.0}])
    np.testing.assert_allclose(env.reset()[2], [1.0, 0.0, 0.0])
    env.close()


@pytest.mark.parametrize(("algorithm", "kind"), [("ppo", "residual"), ("sac", "history")])
def test_a_resumed_training_with_several_sensors_is_the_uninterrupted_one(
    algorithm, kind, tmp_path, monkeypatch
):
    whole = mixed(
        tmp_path / "whole", agent=algorithm, augmentation=kind, steps=768, checkpoint_every=100,
        normalise=True,
    )  # fmt: skip
    assert train.main(whole) == 0
    torn = replace(whole, output=tmp_path / "torn")
    killed_after(400, torn, monkeypatch)
    assert train.main(replace(torn, resume=True)) == 0
    assert same_parameters(whole.folder / "last.zip", torn.folder / "last.zip")


def test_held_out_episodes_have_all_sensors_and_each_kind_counts_the_same(tmp_path):
    config = mixed(tmp_path, augmentation="estimates", steps=192)
    assert train.main(config) == 0
    recipe = read_recipe(tmp_path / "last.zip")
    assert recipe["config"]["sensors"] == ["mixture"]
    assert recipe["environment"]["sensors"] == [
        entry if isinstance(entry, str) else dict(entry) for entry in SENSOR_MIXTURE[TORQUE_ID]
    ]
    held_out = make_held_out(resolve(config))
    entry = agent_entry(tmp_path / "last.zip")
    assert [part.env.num_envs for part in held_out] == [2, 2, 2, 1, 1, 1]
    means = [
        interquartile_mean(
            held_out_errors(entry.make(part.context), part.env, HELD_OUT_SEED + first)
        )
        for part, first in zip(held_out, (0, 2, 4, 6, 7, 8), strict=True)
    ]
    found = held_out_rmse(entry.make, held_out)
    assert found == pytest.approx(np.mean(means), rel=1e-12)
    assert found == pytest.approx(recipe["held_out_rmse"], rel=1e-6)
    assert np.isnan(held_out_rmse(entry.make, []))


def test_a_student_learns_from_several_sensors_too(tmp_path):
    assert train.main(mixed(tmp_path / "teacher", augmentation="teacher")) == 0
    config = mixed(
        tmp_path / "student", augmentation="student", teacher=tmp_path / "teacher" / "agent.zip",
        steps=VEHICLES * 64,
    )  # fmt: skip
    assert train.main(config) == 0
    assert np.isfinite(read_recipe(tmp_path / "student" / "agent.zip")["held_out_rmse"])
