"""The policy that learned slip: its motion, its filter, its features, its state."""

import numpy as np
import pytest

from baselines.learned import learned_slip
from baselines.learned.learned_slip import (
    FEATURES,
    HEIGHTS,
    OUTPUTS,
    LearnedSlipPolicy,
    inputs_of,
    motion_between,
    slip_layers,
)
from baselines.lyapunov import lyapunov_laws as law
from baselines.registry import POLICIES
from tests.baselines.learned.networks import random_weights
from tracked_env import SPEED, TERRAIN
from tracked_env import observation as layout
from tracked_env.benchmark.policy_interface import PolicyContext
from tracked_env.vector_env import TrackedVehicleVectorEnv

SHOWN = [*TERRAIN["observation"], "height_scan"]
USUAL = {**TERRAIN, "observation": SHOWN, "uncertainty": "changing-hills"}


def slopes(count, **arguments):
    """An environment, and the context of its policies."""
    env = TrackedVehicleVectorEnv(count, duration=10.0, **{**USUAL, **arguments})
    simulation = env.simulation
    sheet, vehicle = simulation.settings.sensors, simulation.solver.nominal
    names = simulation.layout.names
    return env, PolicyContext(0.02, "sliding", sheet, "speed", vehicle, names)


def network(heights=False, size=1.0, hidden=16):
    """A network of random numbers; size: of its outputs."""
    weights = random_weights(inputs_of(heights), OUTPUTS, hidden)
    weights["last.weight"] *= np.float32(size)
    weights["last.bias"] *= np.float32(size)
    return slip_layers(weights, True, heights)


def actions(count, steps=60, heights=False, size=1.0, each=None, **arguments):
    """Actions (steps, count, 2) of a policy."""
    env, context = slopes(count, **arguments)
    policy = LearnedSlipPolicy(network(heights, size), context, heights)
    observation, _ = env.reset(seed=11)
    state, taken = None, []
    for _ in range(steps):
        seen = observation if each is None else each(observation.copy())
        action, state = policy.predict(seen, state)
        taken.append(action)
        observation, *_ = env.step(action)
    env.close()
    return np.array(taken)


def test_the_motion_between_two_errors_is_the_one_that_carries_them():
    rng = np.random.default_rng(0)
    before, reference = rng.normal(size=(50, 3)), rng.normal(size=(50, 2))
    motion = rng.normal(size=(50, 3)) * (1.0, 0.3, 2.0)
    after = np.array([
        law.carried(law.PoseError(*e), *m, *r, 0.02)
        for e, m, r in zip(before, motion, reference, strict=True)
    ])  # fmt: skip
    found = motion_between(before, after, reference, 0.02)
    np.testing.assert_allclose(found, motion, atol=1e-10)


def test_a_network_that_says_nothing_leaves_the_unicycle_controller():
    """Where the pose comes in every step and is exact, so that no filter has a say."""
    silent = actions(3, size=0.0, sensors="ideal")
    env, context = slopes(3, sensors="ideal")
    policy, state, taken = POLICIES["uc"](context), None, []
    observation, _ = env.reset(seed=11)
    for _ in range(len(silent)):
        action, state = policy.predict(observation, state)
        taken.append(action)
        observation, *_ = env.step(action)
    env.close()
    np.testing.assert_allclose(silent, taken, atol=1e-6)


def test_without_a_pose_the_error_goes_on_with_the_motion_that_the_network_says():
    env, context = slopes(2, sensors={"preset": "ideal", "pose_rate": 0.1})
    weights = random_weights(inputs_of(False), OUTPUTS, 16)
    weights["last.weight"] *= np.float32(0.0)
    weights["last.bias"][:] = (0.0, 0.0, 0.0, 2.0, 0.0)
    said = LearnedSlipPolicy(slip_layers(weights, True, False), context)
    quiet = LearnedSlipPolicy(network(size=0.0), context)
    observation, _ = env.reset(seed=5)
    errors, states = [], [None, None]
    for _ in range(100):
        for k, policy in enumerate((said, quiet)):
            action, states[k] = policy.predict(observation, states[k])
        errors.append(states[0].driving.error - states[1].driving.error)
        observation, *_ = env.step(action)
    env.close()
    moved = np.hypot(errors[-1][:, 0], errors[-1][:, 1])
    # 0.04 m/s to the side over 2 s; slow vehicles have no slip angle
    assert (moved > 0.02).all() and (moved < 0.09).all()


def test_a_pose_that_comes_after_a_second_counts_as_much_as_fifty_would():
    env, context = slopes(4, sensors={"preset": "mocap", "pose_rate": 1.0})
    policy, state = LearnedSlipPolicy(network(size=0.0), context), None
    columns = layout.columns(context.observation, ("tangent_error_x", "tangent_error_y"))
    observation, _ = env.reset(seed=5)
    left = []
    for _ in range(52):
        action, state = policy.predict(observation, state)
        left.append(np.abs(state.driving.error[:, :2] + observation[:, columns]).max(axis=1))
        observation, *_ = env.step(action)
    env.close()
    assert (left[49] > 0.01).all()  # belts that slip were wrong for a second
    assert (left[50] < 0.002).all()


@pytest.mark.parametrize("heights", [False, True])
def test_a_batch_has_the_bits_of_its_single_vehicles(heights):
    together = actions(4, heights=heights)
    assert np.array_equal(together[:, :1], actions(1, heights=heights))


def test_it_goes_on_from_an_earlier_state():
    env, context = slopes(3)
    policy = LearnedSlipPolicy(network(), context)
    observation, _ = env.reset(seed=2)
    states, observations, expected = [None], [], []
    for _ in range(40):
        observations.append(observation)
        action, state = policy.predict(observation, states[-1])
        expected.append(action)
        states.append(state)
        observation, *_ = env.step(action)
    env.close()
    state = states[20]
    for k in range(20, 40):
        action, state = policy.predict(observations[k], state)
        assert np.array_equal(action, expected[k])


def test_a_row_that_starts_forgets_and_the_others_go_on():
    env, context = slopes(2)
    policy, state = LearnedSlipPolicy(network(), context), None
    observation, _ = env.reset(seed=2)
    fresh = observation.copy()
    first, _ = LearnedSlipPolicy(network(), context).predict(fresh)
    for _ in range(20):
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
    env.close()
    mixed = np.stack([fresh[0], observation[1]])
    again, _ = policy.predict(mixed, state, np.array([True, False]))
    alone, _ = policy.predict(observation, state)
    assert np.array_equal(again[0], first[0])
    assert np.array_equal(again[1], alone[1])


def test_what_is_not_measured_stops_nothing():
    def without(observation):
        observation[0, :3] = np.nan
        observation[1] = np.nan
        return observation

    assert np.isfinite(actions(3, each=without)).all()


def test_heights_reach_only_a_network_that_sees_them():
    def higher(observation):
        observation[:, -len(HEIGHTS) :] += 1.0
        return observation

    assert np.array_equal(actions(2, each=higher), actions(2))
    assert not np.array_equal(actions(2, heights=True, each=higher), actions(2, heights=True))
    _, context = slopes(1, observation=TERRAIN["observation"])
    with pytest.raises(ValueError, match="lacks group height_scan"):
        LearnedSlipPolicy(network(True), context, True)


def test_features_are_finite_bounded_as_many_as_their_names_and_change():
    env, context = slopes(16, sensors={"preset": "mocap", "pose_rate": 1.0})
    policy, state, start = LearnedSlipPolicy(network(), context), None, np.ones(16, bool)
    observation, _ = env.reset(seed=3)
    seen = []
    for _ in range(120):
        x, uc, state = policy.see(policy._view(observation).copy(), state, start)
        state = state._replace(added=0.01 * np.ones((16, 3)))
        seen.append(x)
        start = np.zeros(16, bool)
        observation, *_ = env.step(uc)
    env.close()
    values = np.array(seen)
    assert values.shape == (120, 16, len(FEATURES))
    assert (np.abs(values) <= learned_slip.BOUND).all()
    changes = np.ptp(values, axis=(0, 1)) > 0.0
    constant = {name for name, moves in zip(FEATURES, changes, strict=True) if not moves}
    assert constant == {"velocity_is_measured"}


def test_it_drives_on_level_ground_where_no_attitude_is_shown():
    env = TrackedVehicleVectorEnv(2, duration=10.0, **{**SPEED, "uncertainty": "friction"})
    simulation = env.simulation
    sheet, vehicle = simulation.settings.sensors, simulation.solver.nominal
    context = PolicyContext(0.02, "sliding", sheet, "speed", vehicle, simulation.layout.names)
    policy = LearnedSlipPolicy(network(size=0.0), context)
    observation, _ = env.reset(seed=3)
    state = None
    for _ in range(100):
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
    column = simulation.batch.column
    away = np.hypot(column("reference_x") - column("x"), column("reference_y") - column("y"))
    env.close()
    assert (away < 0.2).all()


def test_a_policy_of_speeds_refuses_an_environment_of_torques():
    _, context = slopes(1)
    with pytest.raises(ValueError, match="it commands speeds"):
        LearnedSlipPolicy(network(), context._replace(drive="torque"))
