"""The position error that the law sees is bounded, and integral action removes what is constant."""

import math

import numpy as np
import pytest

from baselines.linearizing import linearizing_law as law
from baselines.linearizing.adaptive_policy import INTEGRAL_GAINS, IntegralPolicy
from baselines.linearizing.linearizing_law import Gains
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from tests.baselines.closed_loop import drive, starts, steady
from tests.baselines.episodes import replay
from tracked_env import observation as layout
from tracked_env.physics.parameters import plant_parameters

CLAY = plant_parameters()._replace(drive_time_constant=0.0)
UNBOUNDED = Gains(100.0, 70.0, 15.0, math.inf)
BOUNDED = UNBOUNDED._replace(bound=0.2)
INTEGRAL = Gains(50.0, 70.0, 15.0, math.inf, 50.0)
NOTHING = law.Integral(0.0, 0.0)


def demand(x, y):
    """Demand of a point that is off by (x, y) [m], otherwise at rest."""
    return law.Demand(x, y, *(0.0,) * 6)


def test_the_bounded_error_keeps_its_direction_and_stays_below_the_bound():
    for x, y in np.random.default_rng(1).normal(0.0, 1.0, (50, 2)):
        seen = law.bounded_error(demand(x, y), 0.2)
        length = math.hypot(x, y)
        expected = 0.2 * length / math.hypot(0.2, length)
        assert math.hypot(*seen) == pytest.approx(expected, rel=1e-12)
        assert seen[0] * y - seen[1] * x == pytest.approx(0.0, abs=1e-14)
        assert law.bounded_error(demand(-x, -y), 0.2) == (-seen[0], -seen[1])
        assert math.hypot(*seen) < 0.2
    assert math.hypot(*law.bounded_error(demand(1e6, -1e6), 0.2)) == pytest.approx(0.2)
    assert law.bounded_error(demand(-3.7, 12.1), math.inf) == (-3.7, 12.1)


def test_near_the_path_the_bounded_law_is_the_unbounded_one_to_rounding():
    for gains in (BOUNDED, UNBOUNDED):
        inputs = law.linearizing_inputs(demand(1e-9, -2e-9), 1.5, 0.2, 0.0, 0.3, gains, NOTHING)
        reference = law.linearizing_inputs(demand(0.0, 0.0), 1.5, 0.2, 0.0, 0.3, gains, NOTHING)
        change = np.subtract(inputs, reference)
        assert change == pytest.approx([100.0 * 1e-9, 100.0 * -2e-9 / 1.5], rel=1e-5)


def test_far_from_the_path_the_demand_is_that_of_an_error_of_the_bound():
    rest = law.linearizing_inputs(demand(0.0, 0.0), 1.5, 0.0, 0.0, 0.0, BOUNDED, NOTHING)
    far = law.linearizing_inputs(demand(0.0, 50.0), 1.5, 0.0, 0.0, 0.0, BOUNDED, NOTHING)
    assert far[1] - rest[1] == pytest.approx(100.0 * 0.2 / 1.5, rel=1e-4)
    assert far[0] - rest[0] == 0.0


def test_a_bound_keeps_the_approach_to_the_path_flat():
    """Far off, the error across shrinks with k_p b / k_v: here 0.29 m/s at a speed of 1 m/s."""
    path, start = steady(1.0, 0.0), starts(y=3.0, v_x=1.0)
    flat, steep = (
        drive(FeedbackLinearizingController(CLAY, gains=gains), CLAY, path, start, 3.0)
        for gains in (BOUNDED, UNBOUNDED)
    )
    across = 100.0 * 0.2 / 70.0
    assert (flat.error[100, 0] - flat.error[149, 0]) / 0.98 == pytest.approx(across, rel=0.05)
    assert -math.tan(flat.state[0, 2]) == pytest.approx(across, rel=0.1)
    # Without it no heading gives what is demanded, 4.3 m/s across: the vehicle turns across.
    turned = drive(FeedbackLinearizingController(CLAY, gains=UNBOUNDED), CLAY, path, start, 1.0)
    assert abs(turned.state[0, 2]) > math.radians(60.0)
    assert steep.error[-1, 0] < flat.error[-1, 0]


@pytest.mark.parametrize("yaw_rate", [0.0, 0.2])
def test_integral_action_takes_what_wrong_parameters_leave_to_zero(yaw_rate):
    believed = CLAY._replace(mass=0.8 * CLAY.mass, longitudinal_resistance=0.5)
    believed = believed._replace(lateral_resistance=0.6)
    path, start = steady(1.5, yaw_rate), starts(v_x=1.5, yaw_rate=yaw_rate)
    left, removed = (
        drive(FeedbackLinearizingController(believed, gains=gains), CLAY, path, start, 60.0)
        for gains in (INTEGRAL._replace(k_i=0.0), INTEGRAL)
    )
    assert left.error[-1, 0] > 0.02
    assert removed.error[-1, 0] < 1e-4


class Pushed:
    """A controller whose drives give constant torques besides those that it asks for."""

    def __init__(self, controller, left, right):
        self.controller, self.control_period = controller, controller.control_period
        self.push = np.array([left, right], np.float32)

    def predict(self, observation, state):
        action, state = self.controller.predict(observation, state)
        return action + self.push, state


def test_integral_action_removes_a_constant_torque_of_one_drive_exactly():
    path, start = steady(1.5, 0.0), starts(v_x=1.5)
    errors = []
    for gains in (INTEGRAL._replace(k_i=0.0), INTEGRAL):
        controller = Pushed(FeedbackLinearizingController(CLAY, gains=gains), -0.1, 0.0)
        errors.append(drive(controller, CLAY, path, start, 40.0).error[-1, 0])
    assert errors[0] > 0.05 and errors[1] < 1e-4


def held_back(gains, seconds):
    """State of the policy of a vehicle that stands 3 m behind a reference at full torque."""
    controller = FeedbackLinearizingController(CLAY, gains=gains)
    values, state = dict.fromkeys(layout.NAMES, 0.0), None
    values |= {"position_error_x": 30.0, "v_x": 0.5, "reference_speed": 4.0}
    for _ in range(round(seconds / controller.control_period)):
        action, state = controller.predict(layout.pack(values), state)
    return action, state[0]


def test_the_integral_does_not_wind_up_while_the_torque_is_limited():
    action, state = held_back(INTEGRAL._replace(bound=30.0), 20.0)
    assert action == pytest.approx([1.0, 1.0])
    later = held_back(INTEGRAL._replace(bound=30.0), 40.0)[1]
    assert later[1] == state[1]
    assert state[1] < 1.0  # [m s]; without the limit 15 m for 20 s


def test_the_integral_is_taken_back_at_the_limit_by_an_error_of_the_other_sign():
    integral = law.Integral(2.0, -1.0)
    assert law.integrated(integral, -0.1, 0.1, 5.0, -5.0, 0.5) == pytest.approx((1.95, -0.95))
    assert law.integrated(integral, 0.1, -0.1, 5.0, -5.0, 0.5) == integral
    assert law.integrated(integral, 0.1, -0.1, 0.0, 0.0, 0.5) == pytest.approx((2.05, -1.05))


def test_the_integral_policy_keeps_the_nominal_parameters_and_says_nothing_of_them():
    policy = IntegralPolicy(control_period=0.02)
    seen = np.random.default_rng(2).normal(0.0, 0.3, (5, 2, layout.SIZE)).astype(np.float32)
    replay(policy, seen)
    assert np.array_equal(policy.controller.parameters[:, 0], plant_parameters())
    assert policy.controller.gains == INTEGRAL_GAINS and INTEGRAL_GAINS.k_i > 0.0
    assert not hasattr(policy, "estimates")
