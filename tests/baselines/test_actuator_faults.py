"""Weak, failing and slow drives in closed loop: tracking, and no confusion with the soil."""

import numpy as np
import pytest

from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.registry import OraclePolicy, adaptive, nominal, oracle
from tests.baselines.observer_runs import (
    DRIVES,
    FAULT_SEED,
    GAINS,
    PARAMETERS,
    alarms,
    fault_run,
    soil_errors,
)
from tracked_env import observation as layout
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.benchmark.metrics import evaluate
from tracked_env.benchmark.runner import drive
from tracked_env.physics.parameters import PARAMETER_INDEX

COUNT, DURATION = 12, 14.0  # [-], [s]
FACTORIES = {"nominal": nominal, "adaptive": adaptive, "oracle": oracle}


def tracked(name, policy, sensors=None):
    """(RMSE [m], RMSE after the start [m]) of COUNT episodes of a set, (COUNT,) each."""
    config = BenchmarkConfig(sets=(name,), episodes=COUNT, duration=DURATION, sensors=sensors)
    built = FACTORIES[policy](config.context(name)) if isinstance(policy, str) else policy
    env = config.environment(name, COUNT, truth=isinstance(built, OraclePolicy))
    trace, _ = drive(built, env, [FAULT_SEED + i for i in range(COUNT)], lambda: None)
    found = evaluate(trace)
    return found["tracking_rmse"], found["settled_rmse"]


class Uncompensated(AdaptivePolicy):
    """The adaptive policy that takes its drives for nominal ones."""

    def _adapt(self, known):
        super()._adapt(known)
        rows = [PARAMETER_INDEX[name] for name in DRIVES]
        self.controller.parameters[rows] = self._nominal[rows, None]


@pytest.mark.parametrize("name", ["weak-actuator", "actuator-fault"])
def test_a_weak_drive_costs_nothing_where_it_is_identified_or_known(name):
    sound, _ = tracked("soil-and-mass", "adaptive")
    for policy in ("adaptive", "oracle"):
        rmse, _ = tracked(name, policy)
        assert np.median(rmse) < 1.15 * np.median(sound)
        assert rmse.max() < 0.2
    for policy in (Uncompensated(), "nominal"):
        rmse, _ = tracked(name, policy)
        assert np.median(rmse) > 3.0 * np.median(sound)


def test_a_slow_drive_is_led_as_well_by_the_estimate_as_by_the_truth():
    _, settled = tracked("slow-drive", "adaptive")
    _, known = tracked("slow-drive", "oracle")
    _, without = tracked("slow-drive", Uncompensated())
    assert np.median(settled) < 0.45 * np.median(without)
    assert np.median(settled) < 1.5 * np.median(known)


@pytest.mark.parametrize("name", ["weak-soil", "terrain-transition", "resistance-map"])
def test_no_soil_is_taken_for_a_weak_drive(name):
    found = alarms(fault_run(name, COUNT, DURATION))
    assert found["alarmed"] == 0.0
    assert found["median"] < 0.004 and found["largest"] < 0.05
    assert found["in_three_sigma"] > 0.99


def test_no_weak_drive_is_taken_for_another_soil_or_load():
    sound = soil_errors(fault_run("soil-and-mass", COUNT, DURATION))
    for name in ("weak-actuator", "actuator-fault"):
        found = soil_errors(fault_run(name, COUNT, DURATION))
        for quantity in PARAMETERS:
            assert found[quantity][0] < sound[quantity][0] + 0.005, (name, quantity)
            assert found[quantity][1] > 0.97, (name, quantity)
        for gain in GAINS:
            assert found[gain][0] < 0.005 and found[gain][1] > 0.98


def test_the_policy_works_with_bad_torques_and_lost_samples():
    class Spoilt:
        """The adaptive policy behind a torque sensor with outliers and a drive that drops out."""

        def __init__(self):
            self.policy, self.rng = AdaptivePolicy(), np.random.default_rng(FAULT_SEED)

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            seen = np.array(observation)
            wild = self.rng.random((len(seen), 2)) < 0.005
            columns = [layout.INDEX["torque_left"], layout.INDEX["torque_right"]]
            seen[:, columns] = np.where(wild, 3.0, seen[:, columns])
            lost = self.rng.random(len(seen)) < 0.01
            seen[np.ix_(lost, columns)] = np.nan
            return self.policy.predict(seen, state, episode_start)

    clean, _ = tracked("weak-actuator", "adaptive")
    spoilt = Spoilt()
    rmse, _ = tracked("weak-actuator", spoilt)
    assert np.median(rmse) < 1.1 * np.median(clean)
    estimates = spoilt.policy.estimates()
    assert all((estimates[gain][1] < 0.01).all() for gain in GAINS)


def test_without_the_commands_in_the_observation_the_drives_count_as_nominal():
    names = tuple(name for name in layout.NAMES if not name.startswith("previous_action"))
    policy, state = AdaptivePolicy(observation=names), None
    for _ in range(3):
        _, state = policy.predict(np.zeros((2, len(names)), dtype=np.float32), state)
    assert not set(DRIVES) & set(policy.estimates())
    rows = policy.controller.parameters[[PARAMETER_INDEX[name] for name in DRIVES]]
    np.testing.assert_allclose(rows, [[1.0] * 2, [1.0] * 2, [0.05] * 2], rtol=1e-12)
