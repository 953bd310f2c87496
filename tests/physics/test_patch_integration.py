"""Both integrators of the distributed plant: order, an independent solver, no chatter."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.physics import patch_cases as cases
from tests.physics.patch_cases import EASY, FOCCHI
from tests.physics.step_halving import PATCH_MANOEUVRES, error, torque_errors
from tests.physics.step_halving import run_patches as drive
from tracked_env.physics.level_motion import SPEED_DRIVEN, Pose, rates_of
from tracked_env.physics.lumped import Motion
from tracked_env.physics.parameters import VEHICLES
from tracked_env.physics.patches_on_level_ground import Belts

STRAWA = VEHICLES["strawa"]
# Soft and easy to roll on: smooth at every step tried, and nothing that has a kink.
SOFT = STRAWA._replace(sprocket_inertia=500.0, cohesion=5e3, shear_deformation_modulus=0.1)
SOFT = SOFT._replace(longitudinal_resistance=0.0)
START = np.array([0.4, -0.3, 0.2, 1.5, -0.02, 0.25])
TURN = np.array([4.5, 6.5])  # [rad/s]
TORQUES = Belts(300.0, 1500.0)  # [N m]


def _pose(state):
    return Pose(*state[:3], math.cos(state[2]), math.sin(state[2]))


def _smooth_end(by_torque, steps, duration=1.0):
    """State after a smooth turn in `steps` steps of the Rosenbrock method."""
    h = duration / steps
    if not by_torque:
        return cases.run(START, TURN, SOFT, steps, h)[0][0]
    belts = Belts(*(TURN * SOFT.sprocket_radius))
    start = (_pose(START), Motion(*START[3:]), belts)
    moved = cases.drive_by_torque(start, TORQUES, SOFT, steps, h)
    return np.array([*moved.pose[:3], *moved.motion, *moved.belts])


@pytest.mark.parametrize("by_torque", [False, True], ids=["speed", "torque"])
def test_halving_the_step_divides_the_error_by_four_in_smooth_motion(by_torque):
    truth = _smooth_end(by_torque, 25600)
    counts = (100, 200, 400, 800, 1600)
    gaps = np.array([np.abs(_smooth_end(by_torque, n) - truth) for n in counts])
    for rows in (slice(0, 3), slice(3, None)):
        errors = gaps[:, rows].max(axis=1)
        ratios = errors[:-1] / errors[1:]
        assert np.all((ratios[1:] > 3.4) & (ratios[1:] < 4.6)), (rows, errors)
        assert errors[-1] < 2e-6


def test_halving_the_step_of_the_explicit_method_divides_the_error_by_two():
    truth = _smooth_end(False, 25600)
    errors = [
        np.abs(cases.run(START, TURN, SOFT, n, 1.0 / n, euler=True)[0][0] - truth).max()
        for n in (400, 800, 1600)
    ]
    ratios = np.array(errors[:-1]) / errors[1:]
    assert np.all((ratios > 1.8) & (ratios < 2.2)), errors


@pytest.mark.parametrize("by_torque", [False, True], ids=["speed", "torque"])
def test_the_steps_solve_the_equations_that_an_independent_solver_solves(by_torque):
    k, limits, _ = cases.parts(SOFT)
    inverse_belt_mass = (
        SOFT.sprocket_radius**2 / SOFT.sprocket_inertia if by_torque else SPEED_DRIVEN
    )

    def rate(_, z):
        motion, belts = Motion(*(float(v) for v in z[3:6])), Belts(float(z[6]), float(z[7]))
        loads = cases.loads_at(motion, *belts, SOFT)
        rates = rates_of(loads, motion, belts, TORQUES, k, limits, inverse_belt_mass)
        c, s = math.cos(z[2]), math.sin(z[2])
        moves = c * motion.v_x - s * motion.v_y, s * motion.v_x + c * motion.v_y
        return [*moves, motion.yaw_rate, *rates]

    start = [*START, *(TURN * SOFT.sprocket_radius)]
    solution = solve_ivp(rate, (0.0, 1.0), start, method="DOP853", rtol=1e-10, atol=1e-11)
    result = _smooth_end(by_torque, 12800)
    assert result == pytest.approx(solution.y[: len(result), -1], abs=5e-8)


def test_the_default_step_stays_within_a_millimetre_in_the_tabulated_manoeuvres():
    for name, speeds in PATCH_MANOEUVRES.items():
        truth = drive(speeds, 1e-4, False, FOCCHI)
        distance, turn = error(drive(speeds, 2.5e-3, False, FOCCHI), truth)
        assert distance < 1e-3, name
        assert turn < 2e-3, name


LENGTHS = [1e-3, 2.5e-3, 5e-3]


def _ripple(states):
    """Largest second difference of the velocities: what alternates from step to step."""
    return np.abs(np.diff(states[:, 3:], 2, axis=0)).max()


@pytest.mark.parametrize("h", LENGTHS)
@pytest.mark.parametrize("vehicle", ["focchi", "strawa"])
@pytest.mark.parametrize(
    "belts", [(0.5, 0.5), (1e-3, 1e-3), (1e-3, 3e-3), (0.0, 1e-3), (0.0, 0.5), (-0.3, 0.3)]
)
def test_held_belts_end_in_steady_motion(vehicle, belts, h):
    p = VEHICLES[vehicle]
    speeds = np.tile(np.array(belts) / p.sprocket_radius, (int(2.5 / h), 1))
    states = cases.trajectory(speeds, p, h)
    last = states[-int(0.1 / h) :]
    assert _ripple(last) < 2e-5  # mu g h is 4 mm/s and more
    if belts[0] == belts[1]:
        # What carries the rolling resistance: j = -(K / l) (l / n) sum ..., within one percent.
        assert last[-1, 3] == pytest.approx(belts[0], rel=0.01)
        assert not last[:, 4:].any()


@pytest.mark.parametrize("h", LENGTHS)
@pytest.mark.parametrize("vehicle", ["focchi", "strawa"])
def test_a_vehicle_that_brakes_comes_to_rest_with_steady_loads(vehicle, h):
    p = VEHICLES[vehicle]
    states, _ = cases.run([0.0, 0.0, 0.0, 0.2, 0.05, 0.3], (0.0, 0.0), p, int(1.0 / h), h)
    later, loads = cases.run(states, (0.0, 0.0), p, 1, h)
    assert np.abs(later[0, 3:]).max() < 1e-8
    assert np.abs(later[0, :3] - states[0, :3]).max() < 1e-9
    # The soil and the held rolling resistance balance: nothing accelerates.
    assert loads[0, 0] + loads[0, 1] == pytest.approx(loads[0, 2] + loads[0, 3], abs=1e-3)
    assert np.abs(loads[0, 4:]).max() < 1e-3


@pytest.mark.parametrize("h", LENGTHS)
def test_explicit_steps_chatter_by_up_to_mu_g_h_and_the_others_do_not(h):
    # The reason for the implicit steps: creeping at 1 mm/s.
    speeds = np.full((int(2.0 / h), 2), 1e-3 / FOCCHI.sprocket_radius)
    explicit = cases.trajectory(speeds, EASY, h, euler=True)[-100:]
    limit = 0.4 * 9.81 * h
    assert 0.1 * limit < np.ptp(explicit[:, 3]) <= 2.0 * limit
    implicit = cases.trajectory(speeds, EASY, h)[-100:]
    assert np.ptp(implicit[:, 3]) < 1e-12


@pytest.mark.parametrize("h", LENGTHS)
@pytest.mark.parametrize("vehicle", ["focchi", "strawa"])
def test_driven_by_torques_the_vehicle_stands_drives_and_stops_without_chatter(vehicle, h):
    p = VEHICLES[vehicle]
    moved = (Pose(0.0, 0.0, 0.0, 1.0, 0.0), Motion(0.0, 0.0, 0.0), Belts(0.0, 0.0))
    still = cases.drive_by_torque(moved, (0.0, 0.0), p, int(1.0 / h), h)
    assert not any(still.motion) and not any(still.belts) and not any(still.pose[:3])
    history = []
    for torque, duration in (((0.3, 0.3), 1.0), ((0.1, 0.4), 1.0), ((0.0, 0.0), 6.0)):
        torques = tuple(share * p.torque_limit for share in torque)
        for _ in range(int(duration / h)):
            end = cases.drive_by_torque(moved, torques, p, 1, h)
            moved = (end.pose, end.motion, end.belts)
            history.append([0.0, 0.0, 0.0, *end.motion, *end.belts])
    assert np.abs(history).max() < 1.1 * p.sprocket_radius * p.sprocket_speed_limit
    assert _ripple(np.array(history)[-int(0.2 / h) :]) < 1e-4
    assert np.all(np.isfinite(end.rates))


@pytest.mark.slow
def test_random_torques_on_patches_cost_millimetres_in_the_median_and_centimetres_at_worst():
    # The error of the default step that docs/distributed.md states: neither better nor worse.
    result = torque_errors("heavy_clay", 0.6, 2.5e-3)
    assert 3e-3 < np.median(result[:, 0]) < 8e-3
    assert 0.015 < result[:, 0].max() < 0.035
    assert 2e-3 < result[:, 1].max() < 5e-3
