"""Every algorithm with every kind of augmentation: trains, is saved, and acts as it was trained."""

import json
import shlex
from itertools import product

import numpy as np
import pytest

from agents.algorithms import ALGORITHMS
from agents.archive import agent_entry, load_network
from agents.environments import AgentVectorEnv, make_environment
from agents.folder import HELD_OUT_SEED
from agents.run import resolve
from baselines.learned.agent_policy import make_augmentation
from baselines.learned.augmentation import KINDS
from baselines.learned.trained_agent import RECIPE, normalisation_of, read_recipe
from baselines.linearizing.linearizing_law import TUNED_GAINS
from tests.agents import agent_cases as cases
from tracked_env import observation as obs
from tracked_env import sensors
from tracked_env.sensors import Channel
from tracked_env.vector_env import TrackedVehicleVectorEnv
from train import main


def as_trained(path):
    """Commands of the agent inside the wrapper of its training."""
    recipe, model, inner = read_recipe(path), cases.actor(path), cases.Recorded(cases.vehicles())
    normalise, predict = normalisation_of(recipe) or (lambda values: values), model.predict
    model.predict = lambda shown, *more, **options: predict(normalise(shown), *more, **options)
    kind, options = recipe["augmentation"], recipe["augmentation_options"]
    cases.commands(model, AgentVectorEnv(inner, make_augmentation(kind, options, cases.CONTEXT, 3)))
    return np.array(inner.commands)


PAIRS = [*product(ALGORITHMS, KINDS)]
# Every augmentation with PPO, every algorithm with the history.
FEW = {("ppo", kind) for kind in KINDS} | {(algorithm, "history") for algorithm in ALGORITHMS}


@pytest.mark.parametrize(
    ("algorithm", "kind"),
    [pytest.param(*pair, marks=[pytest.mark.slow] * (pair not in FEW)) for pair in PAIRS],
)
def test_an_agent_acts_in_the_benchmark_as_in_training(algorithm, kind, tmp_path):
    assert main(cases.small(tmp_path, agent=algorithm, augmentation=kind, steps=256)) == 0
    trained, evaluated = (
        as_trained(tmp_path / "last.zip"),
        cases.as_evaluated(tmp_path / "last.zip"),
    )
    assert np.ptp(trained) > 0.0
    np.testing.assert_array_equal(trained, evaluated)


def test_running_normalisation_is_saved_with_the_agent_and_used(tmp_path):
    path = cases.archive_of(cases.small(tmp_path, normalise=True, augmentation="history"))
    stored = normalisation_of(read_recipe(path))
    assert stored.mean.shape == stored.variance.shape and np.abs(stored.mean).max() > 0.01
    np.testing.assert_array_equal(as_trained(path), cases.as_evaluated(path))


@pytest.mark.parametrize("kind", ["history", "residual"])
def test_the_state_is_all_that_an_agent_remembers(kind, tmp_path):
    """Going on from a state kept earlier gives the same action, in a fresh policy too."""
    path = cases.archive_of(
        cases.small(tmp_path, agent="recurrent-ppo", augmentation=kind, steps=256)
    )
    entry = agent_entry(path)
    policy, fresh = entry.make(cases.CONTEXT), entry.make(cases.CONTEXT)
    env = cases.vehicles()
    observation, _ = env.reset(seed=1)
    state = None
    for _ in range(10):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
    first, _ = policy.predict(observation, state)
    policy.predict(np.zeros((3, obs.SIZE), np.float32), state)
    again, _ = policy.predict(observation, state)
    elsewhere, _ = fresh.predict(observation, state)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, elsewhere)


def test_an_agent_drives_one_vehicle_or_many(tmp_path):
    entry = agent_entry(cases.archive_of(cases.small(tmp_path, augmentation="history", steps=256)))
    batch = np.random.default_rng(0).normal(size=(4, obs.SIZE)).astype(np.float32)
    together, _ = entry.make(cases.CONTEXT).predict(batch)
    for row, observation in zip(together, batch, strict=True):
        alone, _ = entry.make(cases.CONTEXT).predict(observation)
        assert alone.shape == (2,)
        np.testing.assert_array_equal(alone, row)
    with pytest.raises(ValueError, match="widens it by itself"):
        entry.make(cases.CONTEXT).predict(np.zeros((4, obs.SIZE + 1), np.float32))


def test_the_archive_says_how_the_agent_came_about(tmp_path, monkeypatch):
    typed = ["train.py", "--sensors", '{"preset": "rtk", "pose_delay": 0.2}']
    monkeypatch.setattr("sys.argv", typed)
    path = cases.archive_of(
        cases.small(tmp_path, agent="td3", augmentation="residual", residual_scale=0.2)
    )
    recipe = read_recipe(path)
    assert recipe["algorithm"] == "td3" and recipe["augmentation_options"] == {
        "scale": 0.2,
        "gains": list(TUNED_GAINS),
    }
    assert recipe["config"]["seed"] == 3 and recipe["config"]["td3"]["batch_size"] == 32
    assert "ppo" not in recipe["config"]
    assert shlex.split(recipe["command"]) == ["python", *typed]
    assert recipe["versions"]["torch"] and recipe["seconds"] > 0 and recipe["steps"] <= 512
    assert recipe["environment"]["uncertainty"][0] == "soil-and-mass"
    assert "ood" not in recipe["environment"]["uncertainty"]
    assert json.loads((tmp_path / "config.json").read_text())["config"] == recipe["config"]


def test_trainings_share_no_episode_with_each_other_the_held_out_ones_or_the_benchmark(
    tmp_path, monkeypatch
):
    seeded = []
    original = TrackedVehicleVectorEnv._seed

    def watched(self, chosen, seed):
        seeds = [seed + i for i in chosen] if isinstance(seed, int) else list(seed or [])
        seeded.extend(s for s in seeds if s is not None)
        original(self, chosen, seed)

    monkeypatch.setattr(TrackedVehicleVectorEnv, "_seed", watched)
    used = {}
    for seed, presets in ((0, None), (1, ("rtk", "strawa"))):
        seeded.clear()
        config = cases.small(tmp_path / str(seed), seed=seed, sensors=presets, held_out=4, steps=64)
        assert main(config) == 0
        used[seed] = set(seeded)
    benchmark, held_out = set(range(10_000)), set(range(HELD_OUT_SEED, HELD_OUT_SEED + 4))
    assert used[0] & used[1] == held_out
    trained = (used[0] | used[1]) - held_out
    assert len(trained) == 8 and not trained & benchmark
    assert main(cases.small(tmp_path / "none", seed=-1)) == 2


# Agents see the fields that they were trained on, whatever else an environment shows


V0 = obs.VERSIONS["v0"]
WHEEL = Channel(
    "wheel_speed", "drive", "m/s", "wheel_noise", "wheel_bias", truth=lambda truth: truth["v_x"],
    presets={"rtk": {"wheel_noise": 0.05, "wheel_bias": 0.02}},
)  # fmt: skip
FIFTH = obs.Group("fifth_wheel", (obs.Field("wheel_speed", "m/s", 2.0, 40.0, "fifth wheel"),))


def belt_speed(read, shown):
    shown[:, 0] = 0.15 * (read[:, 0] + read[:, 1])


LEFT = obs.Group(
    "belt",
    (obs.Field("belt_speed", "m/s", 2.0, 40.0, "mean speed of the belts"),),
    compute=belt_speed,
    reads=("sprocket_speed_left", "sprocket_speed_right"),
)
TRAINED = (*V0, "fifth_wheel")
SHOWN = ("belt", "fifth_wheel", *reversed(V0))  # more, and in another order


@pytest.fixture(autouse=True)
def wheel(registries):
    """Two groups that are not in v0, one of them of a registered channel."""
    sensors.register(WHEEL)
    obs.register(FIFTH)
    obs.register(LEFT)


def as_option(groups):
    return json.dumps({"observation": groups})


def context(groups):
    return cases.CONTEXT._replace(observation=obs.make_layout(groups).names)


def drive(entry, groups):
    """Actions of an agent on vehicles that show these groups, over more than an episode."""
    policy = entry.make(context(groups))
    return cases.commands(policy, cases.vehicles(observation=groups), 70)


@pytest.mark.parametrize("kind", KINDS)
def test_an_agent_acts_the_same_where_more_is_shown_in_another_order(kind, tmp_path):
    config = cases.small(
        tmp_path, augmentation=kind, env_args=as_option(TRAINED), normalise=True, steps=256
    )
    path = cases.archive_of(config)
    recipe = read_recipe(path)
    assert list(recipe["observation"]) == list(TRAINED)
    assert recipe["observation"]["fifth_wheel"] == ["wheel_speed"]
    there = drive(agent_entry(path), TRAINED)
    assert np.ptp(there) > 0.0
    here = drive(agent_entry(path), SHOWN)
    np.testing.assert_array_equal(here, there)


def test_the_network_of_an_agent_uses_the_added_channel(tmp_path):
    """Otherwise equal actions elsewhere would say nothing about it."""
    path = cases.archive_of(cases.small(tmp_path, env_args=as_option(TRAINED), steps=256))
    policy = agent_entry(path).make(context(SHOWN))
    shown = np.zeros((1, obs.make_layout(SHOWN).size), np.float32)
    changed = shown.copy()
    changed[:, obs.make_layout(SHOWN).index["wheel_speed"]] = 1.0
    assert (policy.predict(shown)[0] != policy.predict(changed)[0]).any()
    changed = shown.copy()
    changed[:, obs.make_layout(SHOWN).index["belt_speed"]] = 1.0
    np.testing.assert_array_equal(policy.predict(shown)[0], policy.predict(changed)[0])


def test_an_agent_that_misses_a_group_says_which_in_one_line(tmp_path):
    entry = agent_entry(
        cases.archive_of(cases.small(tmp_path, env_args=as_option(TRAINED), steps=128))
    )
    with pytest.raises(ValueError, match="lacks group fifth_wheel") as refused:
        entry.make(context(V0))
    assert "\n" not in str(refused.value) and str(tmp_path) in str(refused.value)
    del obs.GROUPS["fifth_wheel"]
    with pytest.raises(ValueError, match="group fifth_wheel, which is not registered") as refused:
        entry.make(context(V0))
    assert "\n" not in str(refused.value) and str(tmp_path) in str(refused.value)


def test_an_agent_can_see_less_than_v0_and_drive_on_v0(tmp_path):
    groups = [name for name in V0 if name != "look_ahead"]
    config = cases.small(tmp_path, augmentation="residual", env_args=as_option(groups), steps=128)
    recipe = read_recipe(cases.archive_of(config))
    fields = sum(map(len, recipe["observation"].values()))
    assert fields == obs.make_layout(groups).size < obs.SIZE
    assert load_network(tmp_path / "agent.zip", recipe).observation_space.shape[0] > fields
    entry = agent_entry(tmp_path / "agent.zip")
    there = drive(entry, groups)
    np.testing.assert_array_equal(drive(entry, V0), there)


@pytest.mark.parametrize(
    ("kind", "lacking", "field"),
    [("history", "drive", "torque_left"), ("estimates", "reference", "reference_speed")],
)
def test_an_augmentation_without_the_fields_that_it_reads_is_refused(
    kind, lacking, field, tmp_path, refused
):
    groups = [name for name in V0 if name != lacking]
    line = refused(cases.small(tmp_path / "out", augmentation=kind, env_args=as_option(groups)))
    assert f"lacks group {lacking}" in line and field in line
    assert not (tmp_path / "out").exists()


def test_a_recipe_without_groups_is_that_of_v0(tmp_path):
    path, old = cases.archive_of(cases.small(tmp_path, steps=128)), tmp_path / "old.zip"
    files = cases.entries(path)
    recipe = json.loads(files[RECIPE])
    assert list(recipe.pop("observation")) == list(V0)
    recipe["memory"] = recipe.pop("augmentation")  # as former versions called it
    recipe["memory_options"] = recipe.pop("augmentation_options")
    cases.packed(old, {**files, RECIPE: json.dumps(recipe)})
    assert read_recipe(old)["augmentation"] == "blind"
    expected = drive(agent_entry(path), V0)
    np.testing.assert_array_equal(drive(agent_entry(old), SHOWN), expected)


def test_a_resumed_training_with_a_registered_channel_is_the_uninterrupted_one(
    tmp_path, monkeypatch
):
    config = cases.small(tmp_path / "whole", env_args=as_option(SHOWN), checkpoint_every=100)
    assert cases.torn_in_two(330, config, tmp_path / "torn", monkeypatch)


def test_the_environment_of_a_training_shows_the_groups_that_are_asked_for(tmp_path):
    run = resolve(cases.small(tmp_path, env_args=as_option(TRAINED)))
    assert make_environment(run).observation_space.shape == (obs.SIZE + 1,)
    assert run.parts[0].context.observation == obs.make_layout(TRAINED).names
