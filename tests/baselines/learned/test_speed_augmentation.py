"""Observation augmentation for agents that drive by sprocket speeds."""

import numpy as np
import pytest

from baselines.learned.augmentation import make_augmentation
from baselines.learned.controller_augmentation import KNOWN
from baselines.lyapunov.slippage_aware import tuned_gains
from baselines.registry import slc_adaptive
from tracked_env import SPEED, TERRAIN
from tracked_env.benchmark import PolicyContext
from tracked_env.observation import View, make_layout
from tracked_env.sensors import MOCAP
from tracked_env.vector_env import TrackedVehicleVectorEnv

CONTEXT = PolicyContext(0.02, "sliding", MOCAP, "speed", "focchi")
ON_SLOPES = CONTEXT._replace(observation=make_layout(TERRAIN["observation"]).names)


def driven(augmentation, steps=60, seed=0, count=2):
    """Features (steps, N, F) while random actions drive."""
    env = TrackedVehicleVectorEnv(count, **SPEED)
    observation, _ = env.reset(seed=seed)
    rng, start, shown = np.random.default_rng(seed), np.ones(count, dtype=bool), []
    for _ in range(steps):
        shown.append(augmentation.observe(observation, start).copy())
        start[:] = False
        action = rng.uniform(0.2, 0.7, (count, 2)).astype(np.float32)
        observation, *_ = env.step(augmentation.command(action, shown[-1]))
    return np.array(shown), observation


@pytest.mark.parametrize("kind", ["estimates", "residual"])
def test_features_are_named_finite_and_of_order_one(kind):
    augmentation = make_augmentation(kind, {}, CONTEXT, 2)
    shown, _ = driven(augmentation)
    assert shown.shape[2] == len(augmentation.feature_names)
    assert np.isfinite(shown).all()
    assert np.abs(shown).max() < 20.0
    named = dict(zip(augmentation.feature_names, shown[-1].T, strict=True))
    assert set(KNOWN) <= set(named)
    assert (np.abs(named["log_friction"]) > 0.01).any()  # one has left the nominal floor


def test_the_residual_corrects_the_controller_within_its_scale():
    augmentation = make_augmentation("residual", {"scale": 0.1}, CONTEXT, 1)
    features = np.array([[0.5, 0.98, *np.zeros(len(KNOWN))]], np.float32)
    command = augmentation.command(np.array([[-1.0, 1.0]], np.float32), features)
    np.testing.assert_allclose(command, [[0.4, 1.0]], atol=1e-6)
    with pytest.raises(ValueError, match="residual scale"):
        make_augmentation("residual", {"scale": 0.0}, CONTEXT, 1)


def test_a_row_that_is_put_back_goes_on_as_if_nothing_had_happened():
    augmentation = make_augmentation("residual", {}, CONTEXT, 2)
    _, observation = driven(augmentation)
    kept = augmentation.memories()
    first = augmentation.observe(observation, np.zeros(2, dtype=bool))
    augmentation.observe(observation, np.ones(2, dtype=bool))
    augmentation.restore(kept, np.array([True, False]))
    again = augmentation.observe(observation, np.zeros(2, dtype=bool))
    np.testing.assert_array_equal(again[0], first[0])
    assert not np.array_equal(again[1], first[1])


@pytest.mark.parametrize(("context", "arguments"), [(CONTEXT, SPEED), (ON_SLOPES, TERRAIN)])
def test_a_residual_of_nothing_drives_as_the_adaptive_controller_of_its_environment(
    context, arguments
):
    """On slopes that is the one that knows them: its observation shows the attitude."""
    env = TrackedVehicleVectorEnv(2, **arguments)
    options = {"gains": list(tuned_gains(context.observation))}
    augmentation = make_augmentation("residual", options, context, 2)
    controller = slc_adaptive(context)
    view, state = View(context.observation, augmentation.needs), None
    observation, _ = env.reset(seed=3)
    start = np.ones(2, dtype=bool)
    for _ in range(40):
        features = augmentation.observe(view(observation), start)
        command = augmentation.command(np.zeros((2, 2), np.float32), features)
        action, state = controller.predict(observation, state, start)
        np.testing.assert_array_equal(command, action)
        start = np.zeros(2, dtype=bool)
        observation, *_ = env.step(action)
