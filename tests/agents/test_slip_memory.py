"""Memory and help for agents that drive by sprocket speeds."""

import numpy as np
import pytest

import train
from agents.loading import agent_entry
from agents.memory import make_memory
from agents.slip_memory import KNOWN
from tests.agents.agent_cases import small
from tracked_env import SPEED, SPEED_ID
from tracked_env import observation as obs
from tracked_env.benchmark import PolicyContext
from tracked_env.env import TrackedVehicleEnv
from tracked_env.sensors import MOCAP
from tracked_env.vector_env import TrackedVehicleVectorEnv

CONTEXT = PolicyContext(0.02, "sliding", MOCAP, "speed", "focchi")


def driven(memory, steps=60, seed=0, count=2):
    """Features (steps, N, F) while random actions drive."""
    env = TrackedVehicleVectorEnv(count, **SPEED)
    observation, _ = env.reset(seed=seed)
    rng, start, shown = np.random.default_rng(seed), np.ones(count, dtype=bool), []
    for _ in range(steps):
        shown.append(memory.observe(observation, start).copy())
        start[:] = False
        action = rng.uniform(0.2, 0.7, (count, 2)).astype(np.float32)
        observation, *_ = env.step(memory.command(action, shown[-1]))
    return np.array(shown), observation


@pytest.mark.parametrize("kind", ["estimates", "residual"])
def test_features_are_named_finite_and_of_order_one(kind):
    memory = make_memory(kind, {}, CONTEXT, 2)
    shown, _ = driven(memory)
    assert shown.shape[2] == len(memory.feature_names)
    assert np.isfinite(shown).all()
    assert np.abs(shown).max() < 20.0
    named = dict(zip(memory.feature_names, shown[-1].T, strict=True))
    assert set(KNOWN) <= set(named)
    assert (np.abs(named["log_friction"]) > 0.01).any()  # one has left the nominal floor


def test_the_residual_corrects_the_controller_within_its_scale():
    memory = make_memory("residual", {"scale": 0.1}, CONTEXT, 1)
    features = np.array([[0.5, 0.98, *np.zeros(len(KNOWN))]], np.float32)
    command = memory.command(np.array([[-1.0, 1.0]], np.float32), features)
    np.testing.assert_allclose(command, [[0.4, 1.0]], atol=1e-6)
    with pytest.raises(ValueError, match="residual scale"):
        make_memory("residual", {"scale": 0.0}, CONTEXT, 1)


def test_a_row_that_is_put_back_goes_on_as_if_nothing_had_happened():
    memory = make_memory("residual", {}, CONTEXT, 2)
    _, observation = driven(memory)
    kept = memory.memories()
    first = memory.observe(observation, np.zeros(2, dtype=bool))
    memory.observe(observation, np.ones(2, dtype=bool))
    memory.restore(kept, np.array([True, False]))
    again = memory.observe(observation, np.zeros(2, dtype=bool))
    np.testing.assert_array_equal(again[0], first[0])
    assert not np.array_equal(again[1], first[1])


@pytest.mark.parametrize("kind", ["blind", "history", "estimates", "residual", "teacher"])
def test_every_kind_of_agent_trains_on_speed_v0(kind, tmp_path):
    config = small(tmp_path, env=SPEED_ID, memory=kind, uncertainty=("mixture",))
    assert train.main(config) == 0
    if kind == "teacher":
        return
    policy = agent_entry(tmp_path / "agent.zip").make(CONTEXT)
    observation, _ = TrackedVehicleEnv(**SPEED).reset(seed=0)
    action, _ = policy.predict(observation)
    assert action.shape == (2,)
    assert np.isfinite(action).all()
    assert observation.shape == (obs.SIZE,)
    with pytest.raises(ValueError, match="trained to command"):
        agent_entry(tmp_path / "agent.zip").make(CONTEXT._replace(drive="torque"))
