"""The prediction model: derivatives, lag, friction at standstill, and agreement with the plant."""

import numpy as np
import pytest

from baselines.predictive import tracked_prediction as prediction
from baselines.predictive.tracked_prediction import BY_EFFORT, COLUMNS, ROWS, SPEED, STATES, YAW
from tests.baselines.predictive.predictive_cases import STAGE, model
from tracked_env.physics.parameters import plant_parameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.plants.standalone import Rig

MOTIONS = [  # v, w, u_L, u_R: cruise, turn, standstill, spin, reverse, drift through zero
    (2.0, 0.02, 0.2, 0.25),
    (1.5, 0.4, -0.1, 0.6),
    (0.02, 0.01, 0.16, 0.2),
    (0.1, -0.5, 0.4, -0.4),
    (-1.5, 0.2, -0.3, -0.1),
    (0.3, 0.02, 0.1, 0.05),
]


def after(s, u, m):
    out = np.empty(STATES)
    return out, prediction.drive(s, u, m, out)


def state(v, w, *efforts):
    return np.array([0.3, -0.2, *(efforts or (0.1, 0.3)), 0.4, v, w])


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("pull", [0.0, 0.7])
def test_derivatives_are_those_of_differences(motion, pull):
    v, w, left, right = motion
    m = model(pull_x=0.5 * pull, pull_y=pull)
    s, u = state(v, w), np.array([left, right])
    result, sides = after(s, u, m)
    forward = np.zeros((COLUMNS, ROWS))
    prediction.differentiate(s, result, sides, m, forward)
    for c in range(COLUMNS):
        ends = []
        for sign in (1.0, -1.0):
            z = np.concatenate([s, u])
            z[c + 4 if c < BY_EFFORT else c - BY_EFFORT + 2] += sign * 1e-5
            ends.append(after(z[:STATES], z[STATES:], m)[0][[0, 1, 4, 5, 6]])
        np.testing.assert_allclose(forward[c], (ends[0] - ends[1]) / 2e-5, atol=2e-6)


def test_the_lag_is_exact_for_a_command_that_is_held():
    m = model(drive_time_constant=0.3)
    s, u = state(1.0, 0.1, -0.2, 0.4), np.array([0.5, 0.1])
    reached = after(s, u, m)[0][2:4]
    np.testing.assert_allclose(reached, u + (s[2:4] - u) * np.exp(-STAGE / 0.3))
    time = np.linspace(0.0, STAGE, 20001)
    course = u[:, None] + (s[2:4] - u)[:, None] * np.exp(-time / 0.3)
    mean = prediction.efforts(*s[2:4], *u, m)
    wanted = np.trapezoid(course, time) / STAGE * np.array([m.force_left, m.force_right])
    np.testing.assert_allclose(mean, wanted, rtol=1e-9)


def test_a_weak_drive_pushes_with_its_gain():
    whole, weak = model(), model(actuator_gain_left=0.5)
    assert prediction.efforts(0.4, 0.4, 0.4, 0.4, weak) == pytest.approx(
        (0.5 * whole.force_left * 0.4, whole.force_right * 0.4)
    )


@pytest.mark.parametrize("speed", [0.01, 0.1, -0.3])
@pytest.mark.parametrize("yaw_rate", [0.005, -0.1, 0.3])
def test_without_effort_friction_brings_it_to_rest_and_never_turns_it_round(speed, yaw_rate):
    m, s = model(), state(speed, yaw_rate, 0.0, 0.0)
    for _ in range(100):
        new = after(s, np.zeros(2), m)[0]
        for k in (SPEED, prediction.YAW_RATE):
            assert new[k] * s[k] >= 0.0
            assert abs(new[k]) <= abs(s[k]) + 1e-12
        s = new
    assert abs(s[SPEED]) < 1e-3
    assert abs(s[prediction.YAW_RATE]) < 1e-3


def test_the_efforts_that_a_motion_needs_drive_that_motion():
    m = model()
    for v, w, next_v, next_w in [(2.0, 0.3, 2.02, 0.29), (0.1, 0.0, 0.05, 0.02), (-1, 0.2, -1, 0)]:
        s = state(v, w, 0.0, 0.0)
        side = prediction.side_velocity(v, w, m)
        needed = prediction.needed_efforts(v, w, next_v, next_w, side, m)
        # With a lag, the command that has this mean over the stage.
        u = np.array(needed) / np.array([m.force_left, m.force_right]) / (1.0 - m.mean_decay)
        new = after(s, u, m)[0]
        assert new[SPEED] == pytest.approx(next_v, abs=1e-9)
        assert new[prediction.YAW_RATE] == pytest.approx(next_w, abs=1e-9)


def test_it_foretells_the_plant_over_a_second():
    p = plant_parameters()
    m = model(smoothing=1.0)
    k = np.arange(25)
    course = np.stack([0.15 + 0.1 * np.sin(0.3 * k), 0.3 + 0.1 * np.cos(0.2 * k)], axis=1)
    rig = Rig("lumped", p)
    rig.states[0, [3, 5]] = 1.5, 0.3  # v_x, yaw rate
    s = state(1.5, 0.3, 0.0, 0.0) * (np.arange(STATES) > YAW)
    for u in course:
        rig.advance(p.torque_limit * u[None, :], STAGE)
        s = after(s, u, m)[0]
    assert np.hypot(*(rig.states[0, :2] - s[:2])) < 0.02  # of 1.6 m
    assert abs(rig.state.yaw[0] - s[YAW]) < 0.02
    assert abs(rig.state.v_x[0] - s[SPEED]) < 0.03


def mirrored(s):
    return (s * [1, -1, 1, 1, -1, 1, -1])[[0, 1, 3, 2, 4, 5, 6]]


def test_mirrored_states_move_in_a_mirror():
    m = model()
    s, u = state(1.2, 0.3), np.array([0.1, 0.4])
    one = after(s, u, m)[0]
    other = after(mirrored(s), u[::-1].copy(), m)[0]
    np.testing.assert_allclose(other, mirrored(one), atol=1e-14)


@pytest.mark.parametrize("motion", MOTIONS)
def test_mirrored_states_have_mirrored_derivatives(motion):
    """Differences of the friction are taken away from zero, so the kink at zero is none of them."""
    v, w, left, right = motion
    m, result = model(), []
    for s, turn in ((state(v, w), 1), (mirrored(state(v, w)), -1)):
        forward = np.zeros((COLUMNS, ROWS))
        reached, sides = after(s, np.array([left, right])[::turn].copy(), m)
        prediction.differentiate(s, reached, sides, m, forward)
        result.append(forward)
    one, other = result
    columns, flip = [0, 1, 2, 4, 3, 6, 5], np.array([1.0, -1.0, -1.0, 1.0, -1.0])
    signs = np.array([-1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(other, signs[:, None] * one[columns] * flip, atol=1e-13)


@pytest.mark.parametrize(("speed", "turn"), [(0.0, 0.5), (0.0, -0.5), (0.3, 0.1), (-0.3, 0.1)])
def test_each_track_meets_resistance_against_its_own_motion(speed, turn):
    m = model()
    most = 0.5 * plant_parameters().longitudinal_resistance * plant_parameters().mass * GRAVITY
    half = m.k.half_gauge * turn
    expected = most * np.sign([speed - half, speed + half])
    np.testing.assert_allclose(prediction.resistances(speed, turn, m), expected, rtol=1e-12)


def test_gravity_along_the_body_accelerates_it():
    level, slope = model(), model(pull_x=1.0)
    s, u = state(2.0, 0.0), np.full(2, 0.2)
    gain = after(s, u, slope)[0][SPEED] - after(s, u, level)[0][SPEED]
    assert gain == pytest.approx(STAGE * 1.0)
