"""The integrator in the loop of a simulation: order, an independent solver, stability, rest."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.physics import step_halving as halving
from tests.physics.step_halving import (
    CONTROL_PERIOD,
    MANOEUVRES,
    SANDY_LOAM,
    Command,
    constant,
    run,
)
from tracked_env.physics import lumped
from tracked_env.physics.lumped import Motion
from tracked_env.physics.parameters import SoilParameters, plant_parameters

CLAY = plant_parameters()
SUBSTEPS = 8  # of 2.5 ms in one control period of 20 ms
X, Y, YAW, V_X, V_Y, YAW_RATE, TORQUE_LEFT, TORQUE_RIGHT = range(8)


def _smooth_turn(constrained, steps=50):
    """A turn that stays clear of standstill and of the traction limits, and its start."""
    command = constant(300.0, 2300.0, 2.0, 0.6, (1000.0, 2000.0), steps)
    command.torque[steps // 2 :] = (500.0, 2400.0)
    return command, Motion(2.0, -0.05 * 0.6 if constrained else -0.02, 0.6)


@pytest.mark.parametrize("constrained", [False, True])
@pytest.mark.parametrize("rows", [slice(X, V_X), slice(V_X, TORQUE_LEFT)], ids=["pose", "velocity"])
def test_halving_the_step_divides_the_error_by_sixteen_down_to_rounding(constrained, rows):
    command, start = _smooth_turn(constrained)
    counts = (1, 2, 4, 8, 16, 32, 64, 128)
    truth = run(command, 512, CLAY, constrained, start)[:, rows]
    errors = np.array(
        [np.abs(run(command, n, CLAY, constrained, start)[:, rows] - truth).max() for n in counts]
    )
    ratios = (errors[:-1] / errors[1:])[errors[1:] > 1e-12]
    assert len(ratios) >= 3
    assert np.all((ratios > 14.0) & (ratios < 19.0)), errors
    assert errors[-1] < 1e-13


@pytest.mark.parametrize("constrained", [False, True])
def test_the_loop_solves_the_equations_of_motion_that_an_independent_solver_solves(constrained):
    _, start = _smooth_turn(constrained)
    command = constant(300.0, 2300.0, steps=30)
    demand = np.array([500.0, 2400.0])
    k, drive = lumped.coefficients(CLAY, constrained), lumped.drive_limits(CLAY)
    formula = lumped.constrained_accelerations if constrained else lumped.sliding_accelerations

    def rate(t, z):
        motion = Motion(*(float(v) for v in z[V_X:]))
        torque = demand + (command.torque[0] - demand) * math.exp(-t / CLAY.drive_time_constant)
        limits = lumped.traction_limits(motion, k.half_gauge, drive)
        accelerations = formula(motion, float(torque[0]), float(torque[1]), k, limits)
        c, s = math.cos(z[YAW]), math.sin(z[YAW])
        moves = c * motion.v_x - s * motion.v_y, s * motion.v_x + c * motion.v_y
        return [*moves, motion.yaw_rate, *accelerations]

    # The motors start at the first demand; from then on the demand is another one.
    command.torque[1:] = demand
    first = run(Command(command.torque[:1], command.speed[:1]), 64, CLAY, constrained, start)[-1]
    accuracy = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12}
    solution = solve_ivp(rate, (0.0, 29 * CONTROL_PERIOD), first[:TORQUE_LEFT], **accuracy)
    result = run(command, 64, CLAY, constrained, start)[-1]
    assert result[:TORQUE_LEFT] == pytest.approx(solution.y[:, -1], abs=1e-8)
    decay = math.exp(-29 * CONTROL_PERIOD / CLAY.drive_time_constant)
    assert result[TORQUE_LEFT] == pytest.approx(500.0 - 200.0 * decay, rel=1e-12)


@pytest.mark.parametrize("constrained", [False, True])
def test_a_coasting_vehicle_comes_to_rest_after_the_distance_of_its_kinetic_energy(constrained):
    start = Motion(3.0, 0.0, 0.0)
    end = run(constant(0.0, 0.0), SUBSTEPS, CLAY, constrained, start)[-1]
    # v^2 / (2 mu_l g) = 0.76 m, and below 0.1 m/s the resistance fades: a few mm more.
    assert end[X] == pytest.approx(9.0 / (2.0 * 0.6 * 9.81), abs=0.003)
    assert np.abs(end[V_X:TORQUE_LEFT]).max() < 1e-12
    turning = run(constant(0.0, 0.0), SUBSTEPS, CLAY, False, Motion(1.0, 0.3, 2.0))[-1]
    assert np.abs(turning[V_X:TORQUE_LEFT]).max() < 1e-12


def test_the_icr_of_a_driven_circle_emerges_at_five_centimetres():
    # m w v_x = 2 q x_icr at R = 10 m and 2 m/s.
    end = run(halving.circle_entry(), SUBSTEPS)[-1]
    assert end[V_X] == pytest.approx(2.0, rel=0.02)
    assert end[V_X] / end[YAW_RATE] == pytest.approx(10.0, rel=0.05)
    expected = end[YAW_RATE] * end[V_X] * 2.0 / (2.0 * 0.8 * 9.81)
    assert -end[V_Y] / end[YAW_RATE] == pytest.approx(expected, rel=0.03)
    assert expected == pytest.approx(0.05, rel=0.06)


def test_the_constrained_lateral_model_keeps_its_icr_through_a_manoeuvre():
    trajectory = run(halving.circle_entry(), SUBSTEPS, CLAY, True)
    assert trajectory[:, V_Y] == pytest.approx(-0.05 * trajectory[:, YAW_RATE], abs=1e-14)


@pytest.mark.parametrize(("factor", "torque"), [(1.0, 3500.0), (2.0, 4800.0)])
def test_a_pivot_turn_from_rest_is_stable_at_the_default_step_on_rough_ground(factor, torque):
    p = CLAY._replace(lateral_resistance=1.0, turning_resistance_factor=factor)
    # One control period per sub-step shows every sub-step.
    command = constant(-torque, torque, steps=400)
    coarse = run(command, 1, p, period=0.0025)
    fine = run(command, 8, p, period=0.0025)
    assert coarse[-1, YAW] > 0.1
    assert coarse[:, YAW_RATE] == pytest.approx(fine[:, YAW_RATE], abs=1e-3)
    assert np.abs(coarse[:, [X, Y]]).max() < 1e-6
    assert np.abs(np.diff(coarse[50:, YAW_RATE], 2)).max() < 1e-4  # what a ripple shows


def test_sideways_sliding_is_unstable_beyond_the_limit_step_and_stable_below():
    # Decay rate 1.5 mu_t g / eps = 490 / s at mu_t = 1; RK4 needs h < 2.785 / 490 = 5.68 ms.
    p = plant_parameters(soil=SoilParameters(lateral_resistance=1.0))
    command, start = constant(0.0, 0.0, steps=300), Motion(0.0, 1e-6, 0.0)
    stable = run(command, 1, p, start=start, period=0.0055)
    unstable = run(command, 1, p, start=start, period=0.0060)
    assert abs(stable[-1, V_Y]) < 1e-9
    assert abs(unstable[-1, V_Y]) > 1e-3


@pytest.mark.parametrize("soil", [SoilParameters(), SANDY_LOAM], ids=["clay", "loam"])
def test_full_torque_ends_at_the_speed_where_slip_carries_the_resistance(soil):
    p = plant_parameters(soil=soil)
    end = run(constant(8000.0, 8000.0), SUBSTEPS, p)
    drive = lumped.drive_limits(p)
    top = p.sprocket_radius * p.sprocket_speed_limit
    assert end[:, V_X].max() < top
    # F(i) = R = 4.27 kN at the end: i from S (7) and v = V_t (1 - i).
    assert lumped.traction_limits(Motion(*end[-1, V_X:TORQUE_LEFT]), 0.85, drive)[
        1
    ] == pytest.approx(0.3 * 1450.0 * 9.81, rel=1e-3)
    assert np.abs(np.diff(end[-20:, V_X])).max() < 1e-6


@pytest.mark.parametrize("constrained", [False, True])
def test_at_the_default_step_one_traction_limit_costs_half_a_millimetre_at_most(constrained):
    for name, (command, p, start) in list(MANOEUVRES.items())[:5]:
        distance, turn = halving.errors(command, p, start, constrained, counts=(SUBSTEPS,))[0]
        smooth = name in list(MANOEUVRES)[:3] and not constrained  # 20 times better there
        assert distance < (1e-4 if smooth else 0.5e-3), name
        assert turn < (1e-4 if smooth else 0.6e-3), name


def test_full_torque_from_one_traction_limit_into_another_costs_millimetres_to_first_order():
    # The error that docs/numerics.md states: neither better nor worse.
    command, p, start = MANOEUVRES["2.5 m/s, into reverse at top speed, pivot"]
    coarse, fine = halving.errors(command, p, start, counts=(SUBSTEPS, 80))
    assert 3.5e-3 < coarse[0] < 4.5e-3
    assert 1.8e-3 < coarse[1] < 2.4e-3
    assert 0.1e-3 < fine[0] < 0.25e-3
    assert 0.06e-3 < fine[1] < 0.15e-3
    speed = run(command, SUBSTEPS, p, start=start)[:, V_X]
    assert speed[0] == 2.5 and speed.min() < -5.9  # the belts reach their top speed, 6 m/s


def test_random_full_torques_cost_millimetres_in_the_median_and_centimetres_at_worst():
    result = halving.random_errors("heavy_clay", 0.6, SUBSTEPS)
    assert 3e-3 < np.median(result[:, 0]) < 7e-3
    assert 0.04 < result[:, 0].max() < 0.09
    assert 0.7e-3 < np.median(result[:, 1]) < 2e-3
    assert 0.01 < result[:, 1].max() < 0.02
