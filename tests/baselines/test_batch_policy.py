"""Every controller takes one vehicle or a batch, and refuses wrong shapes before it changes."""

import gymnasium
import numpy as np
import pytest

from baselines.batch_policy import BatchPolicy
from baselines.registry import POLICIES
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyContext
from tracked_env.sensors import PRESETS

TORQUE = PolicyContext(0.02, "sliding")
SPEED = PolicyContext(0.02, "sliding", PRESETS["mocap"], "speed", "focchi")
CASES = [("nominal", TORQUE), ("adaptive", TORQUE), ("uc", SPEED), ("slc-adaptive", SPEED)]
CASES += [("mpc-adaptive", TORQUE), ("mpc-adaptive", SPEED)]
every_policy = pytest.mark.parametrize(
    ("name", "context"), CASES, ids=[f"{name}-{context.drive}" for name, context in CASES]
)


def observations(context, count, steps):
    """Observations (steps, count, SIZE) of vehicles whose actions are small."""
    env = gymnasium.make_vec(TORQUE_ID if context is TORQUE else SPEED_ID, num_envs=count)
    seen = [env.reset(seed=4)[0]]
    for _ in range(steps - 1):
        seen.append(env.step(np.full((count, 2), 0.1, np.float32))[0])
    return np.array(seen)


@every_policy
def test_one_vehicle_gets_the_action_of_a_batch_of_one_without_its_axis(name, context):
    seen = observations(context, 1, 5)
    one, batch = POLICIES[name](context), POLICIES[name](context)
    assert isinstance(one, BatchPolicy)
    own = other = None
    for observation in seen:
        single, own = one.predict(observation[0], own)
        several, other = batch.predict(observation, other)
        assert single.shape == (2,) and several.shape == (1, 2)
        assert single.dtype == several.dtype == np.float32
        assert np.array_equal(single, several[0])
    assert np.abs(single).max() > 0.0


@every_policy
def test_without_a_state_every_row_begins_whatever_episode_start_says(name, context):
    seen = observations(context, 3, 6)
    used, fresh = POLICIES[name](context), POLICIES[name](context)
    state = None
    for observation in seen:
        _, state = used.predict(observation, state)
    again, _ = used.predict(seen[-1], None, np.array([False, True, False]))
    assert np.array_equal(again, fresh.predict(seen[-1])[0])
    some, _ = used.predict(seen[-1], state, np.array([False, True, False]))
    assert np.array_equal(some[1], again[1]) and not np.array_equal(some[[0, 2]], again[[0, 2]])
    assert np.array_equal(used.predict(seen[-1], state, True)[0], again)


@every_policy
def test_a_wrong_shape_is_refused_and_changes_nothing(name, context):
    seen = observations(context, 3, 4)
    policy, state = POLICIES[name](context), None
    for observation in seen:
        _, state = policy.predict(observation, state)
    expected, _ = policy.predict(seen[-1], state)
    estimates = getattr(policy, "estimates", dict)
    before = estimates()
    width = layout.SIZE
    for wrong in (np.zeros(width + 1), np.zeros((3, 5)), np.zeros((1, 3, width)), np.zeros(())):
        with pytest.raises(ValueError, match=rf"observation has shape .* must be \({width},\)"):
            policy.predict(wrong, state)
    with pytest.raises(ValueError, match=r"episode_start has shape \(2,\); must be \(3,\)"):
        policy.predict(seen[-1], state, np.array([True, False]))
    with pytest.raises(ValueError, match=r"state of 3 vehicles"):
        policy.predict(seen[-1][:2], state)
    for key, values in estimates().items():
        assert np.array_equal(values, before[key], equal_nan=True)
    assert np.array_equal(policy.predict(seen[-1], state)[0], expected)


@every_policy
def test_what_is_passed_in_is_not_written_to(name, context):
    seen = observations(context, 2, 3)
    policy, state = POLICIES[name](context), None
    for observation in seen:
        observation[0, layout.INDEX["v_y"]] = 0.01
        before = observation.copy()
        _, state = policy.predict(observation, state)
        assert np.array_equal(observation, before)
