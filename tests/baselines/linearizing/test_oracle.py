"""The oracle: true parameters where the plant has them, identified ones where it has not."""

import numpy as np
import pytest

from baselines.registry import POLICIES
from tracked_env.benchmark import BenchmarkConfig, PolicyEntry, Store, run
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT
from tracked_env.benchmark.policy_interface import tell_plant
from tracked_env.benchmark.statistics import interquartile_mean
from tracked_env.physics.parameters import PARAMETER_NAMES

SHEARED = "distributed"  # the set of patches, whose shear takes up the turns


def driven(name, steps=150, count=4):
    """The oracle after some steps on a set, and the truth that it was told."""
    config = BenchmarkConfig(sets=(name,))
    env = config.environment(name, count, truth=True)
    oracle = POLICIES["oracle"](config.context(name))
    tell_plant(oracle, env.simulation.solver.reads.names)
    observation, info = env.reset(seed=list(range(DEVELOPMENT, DEVELOPMENT + count)))
    state = None
    for _ in range(steps):
        truth = info["truth"]
        oracle.observe_truth(truth)
        action, state = oracle.predict(observation, state)
        observation, *_, info = env.step(action)
    env.close()
    return dict(zip(PARAMETER_NAMES, oracle.controller.parameters, strict=True)), truth


def test_where_the_plant_reads_them_all_parameters_are_the_true_ones():
    used, truth = driven("soil-and-mass")
    for name in PARAMETER_NAMES:
        np.testing.assert_array_equal(used[name], truth[name], err_msg=name)


def test_where_shear_takes_up_the_turns_their_two_parameters_are_identified_and_finite():
    used, truth = driven(SHEARED)
    identified = {name for name in PARAMETER_NAMES if not np.array_equal(used[name], truth[name])}
    assert identified == {"inertia", "lateral_resistance"}
    assert all(np.all(np.isfinite(used[name])) for name in identified)


def test_knowing_the_soil_of_patches_is_no_worse_than_identifying_a_lateral_resistance(tmp_path):
    config = BenchmarkConfig(sets=(SHEARED,), episodes=12, seed=DEVELOPMENT)
    entries = [PolicyEntry(name, POLICIES[name], "0") for name in ("adaptive", "oracle")]
    records = run(config, entries, Store(tmp_path, config.identity()))
    errors = [
        np.array([r["tracking_rmse"] for r in records if r["policy"] == entry.name])
        for entry in entries
    ]
    adaptive, oracle = map(interquartile_mean, errors)
    assert oracle == pytest.approx(adaptive, rel=0.1)
