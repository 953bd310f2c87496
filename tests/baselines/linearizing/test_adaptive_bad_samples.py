"""The adaptive policy in closed loop with sensors that lie, are lost and are missing."""

from functools import cache

import numpy as np
import pytest

from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.registry import adaptive
from tracked_env import observation as layout
from tracked_env.benchmark import BenchmarkConfig, metrics
from tracked_env.benchmark.identification_metrics import Recorder
from tracked_env.benchmark.runner import drive
from tracked_env.physics.parameters import plant_parameters
from tracked_env.sensors import CHANNELS

OUTLIERS, DROPOUTS, MISSING = 0.005, 0.01, 0.005  # [-] of the samples
EPISODES, SEED = 32, 73_000
BEGUN = 1.0  # [s] the first samples of all cannot be told from what is expected
COLUMNS = [layout.INDEX[name] for name in layout.NAMES if name in CHANNELS]
TORQUES = [layout.INDEX["torque_left"], layout.INDEX["torque_right"]]
# Torques that the drives could give: no gate on the torque itself sees them.
LARGEST = plant_parameters().torque_limit / layout.SCALE[TORQUES[0]]


class Spoiled(AdaptivePolicy):
    """Sees torques that are not there and numbers that are missing."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        rng = np.random.default_rng(0) if state is None else self.rng
        self.rng, seen = rng, observation.copy()
        count = len(seen)
        wrong = rng.random((count, 2)) < OUTLIERS
        lies = rng.uniform(-LARGEST, LARGEST, (count, 2))
        seen[:, TORQUES] = np.where(wrong, lies, seen[:, TORQUES])
        gone = rng.random((count, len(COLUMNS))) < MISSING
        seen[:, COLUMNS] = np.where(gone, np.nan, seen[:, COLUMNS])
        action, state = super().predict(seen, state, episode_start, deterministic)
        assert np.isfinite(action).all()
        for value, deviation in self.estimates().values():
            assert np.isfinite(value).all() and (deviation > 0.0).all()
        return action, state


@cache
def outcome(name, spoiled):
    """(relative errors and errors over their deviations (T, N) by parameter, tracking RMSE (N,))
    of one set, from BEGUN on."""
    lost = {f"{group}_dropout": DROPOUTS for group in ("pose", "inertial", "drive")}
    sensors = {"preset": "rtk", **lost} if spoiled else "rtk"
    config = BenchmarkConfig(sets=(name,), episodes=EPISODES, seed=SEED, sensors=sensors)
    policy = adaptive(config.context(name))
    if spoiled:
        policy.__class__ = Spoiled
    env = config.environment(name, EPISODES, truth=False)
    recorder = Recorder(EPISODES, env.simulation.settings.max_steps)
    seeds = [SEED + i for i in range(EPISODES)]
    trace, _ = drive(policy, env, seeds, lambda: None, recorder)
    beliefs, first = recorder.beliefs(), round(BEGUN / trace.control_period)
    errors = {}
    for parameter in ("mass", "inertia", "longitudinal_resistance", "lateral_resistance"):
        j = beliefs.names.index(parameter)
        value, truth = beliefs.value[first:, j], beliefs.truth[first:, j]
        errors[parameter] = (value / truth - 1.0, (value - truth) / beliefs.deviation[first:, j])
    return errors, metrics.evaluate(trace)["tracking_rmse"]


@pytest.mark.parametrize(("name", "error"), [("soil-and-mass", 0.015), ("drift", 0.06)])
def test_outliers_dropouts_and_missing_numbers_neither_move_the_mass_nor_its_claim(name, error):
    errors, rmse = outcome(name, True)
    clean, before = outcome(name, False)
    assert np.median(np.abs(errors["mass"][0][-1])) < error
    for parameter, (_relative, normalised) in errors.items():
        assert np.mean(normalised**2) < 2.5, parameter
        inside, undisturbed = (np.mean(np.abs(z) < 3.0) for z in (normalised, clean[parameter][1]))
        assert inside > min(undisturbed, 0.97) - 0.01, parameter
    assert np.median(rmse) < 1.02 * np.median(before)
