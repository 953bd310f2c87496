"""The feedback-linearizing controller: its formulas one by one, the policy, what it refuses."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from baselines.linearizing import linearizing_law as law
from baselines.linearizing.linearizing_law import Gains
from baselines.linearizing.linearizing_policy import (
    LATERAL_MODELS,
    STATE,
    FeedbackLinearizingController,
)
from tracked_env import observation as layout
from tracked_env.physics import lumped
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.parameters import PARAMETER_INDEX, plant_parameters

CLAY = plant_parameters()
PRINTED = CLAY._replace(turning_resistance_factor=2.0)  # S (20) to the letter
NO_LIMITS = lumped.TractionLimits(-1e9, 1e9, -1e9, 1e9)
RNG = np.random.default_rng(3)
MIRROR = (1.0, 1.0, -1.0, 1.0)  # on xi, the integral along body x and y, what comes first


def observations(count, seed=0):
    """Random observations of a vehicle near its path."""
    return np.random.default_rng(seed).normal(0.0, 0.7, (count, layout.SIZE)).astype(np.float32)


def test_the_default_gains_give_the_published_poles():
    slow, fast, conjugate = Gains().poles()
    assert slow == pytest.approx(-0.87, abs=0.01)
    assert fast == pytest.approx(conjugate.conjugate())
    assert (fast.real, abs(fast.imag)) == pytest.approx((-7.1, 2.8), abs=0.1)


def test_the_inverse_speed_is_exact_above_its_floor_and_fades_smoothly_to_zero():
    floor = law.MINIMUM_SPEED
    for v in (floor, 0.3, 2.0, -0.5):
        assert law.inverse_speed(v) == pytest.approx(1.0 / v, rel=1e-14)
    assert law.inverse_speed(0.0) == 0.0
    v, h = np.linspace(-2 * floor, 2 * floor, 4001), 1e-3 * floor
    values = np.array([law.inverse_speed(x) for x in v])
    assert np.all(np.abs(values) <= 1.1 / floor)
    assert np.array_equal(values, -np.array([law.inverse_speed(-x) for x in v]))
    assert np.abs(np.diff(values)).max() <= 2.1 * h / floor**2  # slope at 0 is the largest


def test_a_load_against_resistance_leaves_exactly_the_net_load():
    for scale in (1.0, 1e-3, 0.0):
        for _ in range(200):
            speed, net = scale * RNG.uniform(-0.2, 0.2), RNG.uniform(-9e3, 9e3)
            load = law.against_resistance(net, speed, 4e3, 10.0)
            assert load - soil.resisting(speed, load, 4e3, 10.0) == pytest.approx(net, abs=1e-6)
            assert law.against_resistance(-net, -speed, 4e3, 10.0) == -load
    assert law.against_resistance(0.0, 0.0, 4e3, 10.0) == 0.0


def test_the_steady_lateral_velocity_balances_friction_and_centrifugal_force():
    k = lumped.coefficients(CLAY, False)
    for speed, yaw_rate in ((2.0, 0.2), (2.0, -0.5), (-1.5, 0.3), (4.0, 0.02), (4.0, 0.05)):

        def excess(v_y, speed=speed, yaw_rate=yaw_rate):
            force, _ = soil.lateral_friction(v_y, yaw_rate, k.friction_intensity, k.contact_length)
            return force - CLAY.mass * yaw_rate * speed

        exact = brentq(excess, -0.9, 0.9, xtol=1e-14)
        assert law.steady_lateral_velocity(speed, yaw_rate, k) == pytest.approx(exact, rel=1e-3)
    assert law.steady_lateral_velocity(2.0, 0.0, k) == 0.0
    slippery = lumped.coefficients(CLAY._replace(lateral_resistance=0.0), False)
    assert law.steady_lateral_velocity(2.0, 0.5, slippery) == -1.0  # the bound: drifting


def demanded_point(t, speed, yaw_rate, d, v_y, constrained):
    """Demand on D in the world at time t, from the path of constant speed and yaw rate."""
    ref = law.Reference(speed, 0.0, 0.0, yaw_rate, 0.0)
    x = speed / yaw_rate * math.sin(yaw_rate * t)
    y = speed / yaw_rate * (1.0 - math.cos(yaw_rate * t))
    demand = law.demanded_motion(x, y, yaw_rate * t, ref, v_y, d, constrained)
    return np.array(demand).reshape(4, 2)


@pytest.mark.parametrize("d", [0.05, 0.3])
@pytest.mark.parametrize("constrained", [True, False])
def test_the_derivatives_of_the_demanded_point_are_consistent_on_a_circle(d, constrained):
    v_y, h = (-d * 0.4 if constrained else -0.03), 1e-4
    for t in (0.0, 1.3, 4.0):
        args = (2.0, 0.4, d, v_y, constrained)
        before, now, after = (demanded_point(t + s * h, *args) for s in (-1, 0, 1))
        assert (after - before)[:3] / (2 * h) == pytest.approx(now[1:], abs=1e-7)


@pytest.mark.parametrize("d", [0.0, 0.3])
def test_the_derivatives_of_the_demanded_point_are_consistent_while_speed_and_turn_change(d):
    def demand(t):  # v of second, w of first degree in time; no side slip, hence no delta
        ref = law.Reference(1.0 + 0.4 * t**2, 0.8 * t, 0.8, 0.3 - 0.5 * t, -0.5)
        yaw = 0.3 * t - 0.25 * t**2
        return np.array(law.demanded_motion(0.0, 0.0, yaw, ref, 0.0, d, False)).reshape(4, 2)

    for t in (0.0, 0.7, 1.5):
        slope = (demand(t + 1e-4) - demand(t - 1e-4)) / 2e-4
        assert slope[1:3] == pytest.approx(demand(t)[2:], abs=1e-6)


@pytest.mark.parametrize("speed", [2.0, -1.0])
def test_the_demand_of_the_constrained_lateral_model_moves_along_the_heading_to_come(speed):
    d, yaw_rate = 0.2, 0.3
    demand = demanded_point(1.0, speed, yaw_rate, d, -d * yaw_rate, True)
    arm = demand[0] - demanded_point(1.0, speed, yaw_rate, 0.0, 0.0, True)[0] + [d, 0.0]
    assert np.hypot(*arm) == pytest.approx(d, rel=1e-12)
    along, across = arm @ demand[1] / d, (arm[0] * demand[1, 1] - arm[1] * demand[1, 0]) / d
    assert across == pytest.approx(0.0, abs=1e-12)
    assert along**2 + (d * yaw_rate) ** 2 == pytest.approx(speed**2, rel=1e-12)
    assert np.sign(along) == np.sign(speed)


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_the_static_feedback_gives_the_demanded_accelerations(lateral_model):
    constrained = lateral_model == "constrained"
    p = PRINTED._replace(icr_forward=0.2)
    k = lumped.coefficients(p, constrained)
    rates = lumped.constrained_accelerations if constrained else lumped.sliding_accelerations
    for _ in range(300):
        scale = 10.0 ** RNG.uniform(-2.0, 0.5)
        v_x, v_y, yaw_rate, u_1, u_2 = scale * RNG.uniform(-1.0, 1.0, 5)
        motion = lumped.Motion(v_x, -0.2 * yaw_rate if constrained else v_y, yaw_rate)
        left, right = law.track_efforts(motion, u_1, u_2, p, k, constrained)
        r = p.sprocket_radius
        forward, _, turning = rates(motion, left * r, right * r, k, NO_LIMITS)
        assert (forward, turning) == pytest.approx((u_1, u_2), abs=1e-9)


def test_the_effort_limits_keep_the_sum_before_the_difference():
    assert law.within_limits(1.0, 2.0, 5.0, 5.0) == (1.0, 2.0)
    assert law.within_limits(-20.0, 26.0, 5.0, 5.0) == (1.0, 5.0)  # mean 3 kept, difference cut
    assert law.within_limits(20.0, 21.0, 5.0, 5.0) == (5.0, 5.0)
    assert law.within_limits(8.0, 0.0, 5.0, 3.0) == (5.0, 3.0)
    assert law.within_limits(-2.0, 6.0, 5.0, 3.0) == (1.0, 3.0)
    for _ in range(100):
        left, right = RNG.uniform(-20.0, 20.0, 2)
        for most in ((5.0, 5.0), (5.0, 2.0), (2.0, 5.0)):
            limited = law.within_limits(left, right, *most)
            assert all(abs(x) <= limit + 1e-12 for x, limit in zip(limited, most, strict=True))
            assert sum(limited) == pytest.approx(np.clip(left + right, -sum(most), sum(most)))


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_exchanging_left_and_right_exchanges_the_torques_exactly(lateral_model):
    gains = Gains(bound=0.3, k_i=20.0)
    controller = FeedbackLinearizingController(CLAY, gains=gains, lateral=lateral_model)
    seen, memory = observations(200), RNG.normal(size=(200, STATE))
    seen[:, layout.INDEX["heading_error"]] *= 4.0  # some face backwards
    action, state = controller.predict(seen, memory)
    mirrored, mirrored_state = controller.predict(layout.mirror(seen), memory * MIRROR)
    assert np.array_equal(mirrored, action[:, ::-1])
    assert np.array_equal(mirrored_state, state * MIRROR)
    assert np.abs(action).max() <= 1.0
    assert np.std(action) > 0.1


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_a_row_of_a_batch_equals_one_vehicle_with_its_own_parameters(lateral_model):
    masses = RNG.uniform(800.0, 2000.0, 9)
    batch = FeedbackLinearizingController(CLAY._replace(mass=masses), lateral=lateral_model)
    seen, memory = observations(9), RNG.normal(size=(9, STATE))
    action, state = batch.predict(seen, memory)
    for i, mass in enumerate(masses):
        one = FeedbackLinearizingController(CLAY._replace(mass=float(mass)), lateral=lateral_model)
        own_action, own_state = one.predict(seen[i], memory[i : i + 1])
        assert np.array_equal(own_action, action[i])
        assert np.array_equal(own_state, state[i : i + 1])


def test_parameters_set_later_act_like_parameters_given_at_the_start():
    seen, masses = observations(3), np.array([900.0, 1400.0, 2000.0])
    controller = FeedbackLinearizingController(CLAY)
    controller.set_parameters(mass=masses, lateral_resistance=0.5)
    expected = FeedbackLinearizingController(CLAY._replace(mass=masses, lateral_resistance=0.5))
    assert np.array_equal(controller.predict(seen)[0], expected.predict(seen)[0])
    controller.parameters[PARAMETER_INDEX["mass"]] = 1450.0
    controller.set_parameters(lateral_resistance=0.8)
    same = FeedbackLinearizingController(CLAY).predict(seen)[0]
    assert np.array_equal(controller.predict(seen)[0], same)


def test_the_compensator_does_not_wind_up_while_the_torque_is_limited():
    controller = FeedbackLinearizingController(CLAY)
    values = dict.fromkeys(layout.NAMES, 0.0) | {"position_error_x": 20.0, "v_x": 0.5}
    state = None
    for _ in range(2000):  # 40 s of a vehicle that hangs back
        action, state = controller.predict(layout.pack(values), state)
    strongest = 2.0 * CLAY.torque_limit / CLAY.sprocket_radius / CLAY.mass
    assert action == pytest.approx([1.0, 1.0])
    assert 0.5 * strongest < state[0, 0] < strongest


def test_torque_beyond_the_nominal_traction_is_not_asked_for():
    sand = CLAY._replace(cohesion=0.0)
    values = dict.fromkeys(layout.NAMES, 0.0) | {"position_error_x": 20.0}
    action, _ = FeedbackLinearizingController(sand).predict(layout.pack(values))
    limit = lumped.drive_limits(sand).effort_limit * sand.sprocket_radius / sand.torque_limit
    assert limit < 0.3
    assert action == pytest.approx([law.TRACTION * limit] * 2, rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gains": Gains(50.0, 1.0, 15.0)}, "not Hurwitz"),
        ({"gains": Gains(k_a=-1.0)}, "positive"),
        ({"gains": Gains(k_p=math.nan)}, "positive"),
        ({"gains": Gains(bound=0.0)}, "positive"),
        ({"gains": Gains(50.0, 70.0, 15.0, k_i=223.0)}, r"k_i = 223 .* \[0, 222.222\)"),
        ({"control_period": 50.0}, "Did you pass a rate"),
        ({"lateral": "slippery"}, "lateral = 'slippery'"),
        ({"parameters": CLAY._replace(mass=1.45)}, r"mass = 1.45 kg.*Did you pass tonnes"),
        ({"parameters": CLAY._replace(mass=np.array([1450.0, math.nan]))}, "mass = nan"),
        ({"parameters": CLAY._replace(mass=np.ones((2, 2)))}, r"shape \(2, 2\)"),
        (
            {"parameters": CLAY._replace(mass=np.full(2, 1e3), inertia=np.full(3, 1e3))},
            r"parameters for \[2, 3\] vehicles",
        ),
    ],
)
def test_an_argument_that_makes_no_sense_is_refused_with_its_reason(arguments, message):
    with pytest.raises(ValueError, match=message):
        FeedbackLinearizingController(**({"parameters": CLAY} | arguments))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_observation_that_is_not_finite_is_refused(value):
    observation = observations(3)
    observation[1, layout.INDEX["v_x"]] = value
    with pytest.raises(ValueError, match=rf"observation\[1\]: v_x = {value}"):
        FeedbackLinearizingController(CLAY).predict(observation)


def test_parameters_of_other_vehicles_and_names_are_refused():
    controller = FeedbackLinearizingController(CLAY._replace(mass=np.full(3, 1450.0)))
    with pytest.raises(ValueError, match="2 observations but parameters of 3"):
        controller.predict(observations(2))
    with pytest.raises(ValueError, match="unknown parameter 'weight'"):
        controller.set_parameters(weight=1.0)
