"""The distributed plant: reference runs, power, steady motion, strength, batches, presets."""

import math

import numpy as np
import pytest

from tests.physics import patch_cases as cases
from tests.physics.patch_cases import EASY, FOCCHI, MILLISECOND, PATCHES
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.level_motion import (
    FADE,
    SPEED_DRIVEN,
    Pose,
    Rates,
    damped,
    driving_torque,
    rates_of,
)
from tracked_env.physics.lumped import Motion, track_speeds
from tracked_env.physics.parameters import FIRM_FLOOR, VEHICLES
from tracked_env.physics.patches_on_level_ground import HISTORY_TURN, Belts, make_patches

STRAWA = VEHICLES["strawa"]
AT_ORIGIN = Pose(0.0, 0.0, 0.0, 1.0, 0.0)
REST = Motion(0.0, 0.0, 0.0)
NO_TORQUE = Belts(0.0, 0.0)


def _chicane(milliseconds):
    """Sprocket speeds (n, 2) of F (53) at every millisecond: 0.2 t, then 0.2 m/s, +-0.3 rad/s."""
    t = MILLISECOND * np.arange(milliseconds)
    forward = np.where(t < 2.0, 0.2 * t, 0.2)
    turn = np.where(t < 12.0, 0.3, -0.3) * (t >= 2.0)
    side = 0.5 * 0.606 * turn
    return np.stack([forward - side, forward + side], axis=1) / FOCCHI.sprocket_radius


@pytest.mark.parametrize(
    "name", ["03_gentle_left", "06_left_stopped", "09_pivot_fast", "13_paper_chicane_ol"]
)
def test_explicit_steps_of_a_millisecond_repeat_the_reference_runs(name, reference_data):
    file = reference_data / "flat" / f"{name}_mu0.4.csv"
    if not file.is_file():
        pytest.skip(f"reference run {file} is absent")
    data = np.genfromtxt(file, delimiter=",", names=True)
    commands = np.stack([data["omega_L"], data["omega_R"]], axis=1)[:-1]
    speeds = np.repeat(commands, 10, axis=0)
    if "chicane" in name:
        speeds = _chicane(len(speeds))
        assert speeds[::10] == pytest.approx(commands, abs=1e-6)
    result = cases.trajectory(speeds, EASY, euler=True)[::10]
    expected = np.stack([data[key] for key in ("x", "y", "yaw", "vx", "vy", "wz")], axis=1)
    assert np.abs(result[:, :3] - expected[:, :3]).max() < 1e-6
    assert np.abs(result[:, 3:] - expected[:, 3:]).max() < 1e-6


@pytest.mark.parametrize("by_torque", [False, True], ids=["speed", "torque"])
@pytest.mark.parametrize("vehicle", ["focchi", "strawa"])
def test_sprocket_power_is_kinetic_energy_rate_plus_rolling_plus_what_the_soil_dissipates(
    vehicle, by_torque
):
    p = VEHICLES[vehicle]
    k, drive, contact = cases.parts(p)
    inverse_belt_mass = p.sprocket_radius**2 / p.sprocket_inertia if by_torque else SPEED_DRIVEN
    compared = 0
    for motion, left, right in cases.random_motions(400, 11, slowest=-2.0):
        if abs(motion.yaw_rate) * p.contact_length > HISTORY_TURN * min(abs(left), abs(right)):
            continue
        belts, torques = Belts(left, right), Belts(0.3 * p.torque_limit, -0.2 * p.torque_limit)
        loads = cases.loads_at(motion, left, right, p)
        rates = rates_of(loads, motion, belts, torques, k, drive, inverse_belt_mass)
        dissipated = cases.forces_patch_by_patch(motion, left, right, contact).dissipation
        speeds = track_speeds(motion, k.half_gauge)
        rolling = loads.resistance_left * speeds[0] + loads.resistance_right * speeds[1]
        stored = p.mass * (motion.v_x * rates.v_x + motion.v_y * rates.v_y)
        stored += p.inertia * motion.yaw_rate * rates.yaw_rate
        if by_torque:
            power = [
                driving_torque(torque, belt, drive.inverse_belt_limit) * belt / p.sprocket_radius
                for torque, belt in zip(torques, belts, strict=True)
            ]
            stored += (left * rates.left + right * rates.right) / inverse_belt_mass
        else:
            power = [loads.effort_left * left, loads.effort_right * right]
        largest = max(abs(power[0]), abs(power[1]), dissipated, abs(rolling), abs(stored))
        assert abs(sum(power) - stored - rolling - dissipated) <= 1e-9 * largest
        assert dissipated >= 0.0
        compared += 1
    assert compared > 250


@pytest.mark.parametrize("h", [pytest.param(1e-3, marks=pytest.mark.slow), 2.5e-3, 5e-3])
@pytest.mark.parametrize("vehicle", ["focchi", "strawa"])
def test_with_belts_that_stand_kinetic_energy_never_grows_and_the_vehicle_comes_to_rest(vehicle, h):
    p = VEHICLES[vehicle]
    draws = np.random.default_rng(12)
    states = np.zeros((300, 6))
    size = 10.0 ** draws.uniform(-6.0, 0.3, (300, 3))
    states[:, 3:] = size * draws.choice([-1.0, 1.0], (300, 3))

    def energy():
        squares = states[:, 3:] ** 2
        return 0.5 * (p.mass * (squares[:, 0] + squares[:, 1]) + p.inertia * squares[:, 2])

    for _ in range(int(2.5 / h)):
        before = energy()
        states, _ = cases.run(states, (0.0, 0.0), p, 1, h)
        assert np.all(energy() <= before * (1.0 + 1e-12) + 1e-15)
    assert np.abs(states[:, 3:]).max() < 1e-8


@pytest.mark.parametrize("vehicle", ["focchi", "strawa"])
def test_torques_that_end_at_some_belt_speeds_move_the_vehicle_as_these_speeds_do(vehicle):
    p = VEHICLES[vehicle]
    share = {"focchi": (-0.2, 0.25), "strawa": (-0.1, 0.6)}[vehicle]
    torques = tuple(s * p.torque_limit for s in share)
    moved = cases.drive_by_torque((AT_ORIGIN, REST, Belts(0.0, 0.0)), torques, p, 12000, 2.5e-3)
    assert max(abs(rate) for rate in moved.rates) < 1e-6
    assert abs(moved.motion.yaw_rate) > 0.05
    start = [0.0, 0.0, 0.0, 0.9 * moved.motion.v_x, 0.0, 0.0]
    speeds = np.array(moved.belts) / p.sprocket_radius
    states, loads = cases.run(start, speeds, p, 8000, 2.5e-3)
    assert states[0, 3:] == pytest.approx(moved.motion, rel=1e-6, abs=1e-9)
    assert loads[0] == pytest.approx(moved.loads, rel=1e-5, abs=1e-5 * p.mass)


def test_a_vehicle_that_turns_in_place_feels_the_resistance_of_the_slower_track_too():
    # F (11) prints the sum of both resistances in the yaw equation: zero for a pivot.
    k, drive, _ = cases.parts(FOCCHI)
    motion, belts = Motion(0.0, 0.0, 1.0), Belts(-0.5, 0.5)
    loads = cases.loads_at(motion, *belts, FOCCHI)
    rolling = 0.5 * 0.025 * 62.0 * 9.81
    assert (loads.resistance_left, loads.resistance_right) == pytest.approx((-rolling, rolling))
    free = cases.loads_at(motion, *belts, EASY).turning_moment
    assert loads.turning_moment - free == pytest.approx(-0.606 * rolling)
    rates = rates_of(loads, motion, belts, NO_TORQUE, k, drive, SPEED_DRIVEN)
    assert rates.yaw_rate == pytest.approx(loads.turning_moment / 4.5)


def test_rolling_resistance_opposes_the_motion_of_a_track():
    for speed in (-0.5, 0.5):
        loads = cases.loads_at(Motion(speed, 0.0, 0.0), speed, speed, FOCCHI)
        assert (loads.effort_left, loads.effort_right) == (0.0, 0.0)
        assert loads.resistance_left * speed > 0.0
        assert loads.resistance_right * speed > 0.0


def test_the_drive_torque_fades_at_the_top_speed_and_brakes_in_full():
    top = 4.0
    assert driving_torque(10.0, 0.0, 1.0 / top) == 10.0
    assert driving_torque(10.0, (1.0 - FADE) * top, 1.0 / top) == pytest.approx(10.0)
    assert driving_torque(10.0, (1.0 - 0.5 * FADE) * top, 1.0 / top) == pytest.approx(5.0)
    assert driving_torque(10.0, 1.1 * top, 1.0 / top) == 0.0
    for belt in (-top, -1.5 * top):
        assert driving_torque(10.0, belt, 1.0 / top) == 10.0
        assert driving_torque(-10.0, belt, 1.0 / top) == 0.0


def test_damping_solves_the_linear_equations_of_body_and_belts():
    for p in (FOCCHI, STRAWA):
        k, _, contact = cases.parts(p)
        inverse_belt_mass = p.sprocket_radius**2 / p.sprocket_inertia
        for motion, left, right in cases.random_motions(100, 13, slowest=-1.0):
            r = cases.soil_resistance(motion, left, right, contact)
            both, arm = r.left + r.right, r.left_arm + r.right_arm
            drag = np.array(
                [
                    [both, 0.0, -arm, -r.left, -r.right],
                    [0.0, both, r.forward, 0.0, 0.0],
                    [-arm, r.forward, r.polar, r.left_arm, r.right_arm],
                    [-r.left, 0.0, r.left_arm, r.left, 0.0],
                    [-r.right, 0.0, r.right_arm, 0.0, r.right],
                ]
            )
            for belt in (inverse_belt_mass, SPEED_DRIVEN):
                inverse_masses = np.array(
                    [[1.0 / p.mass]] * 2 + [[1.0 / p.inertia], [belt], [belt]]
                )
                system = np.eye(5) + 0.002 * inverse_masses * drag
                expected = np.linalg.solve(system, [1.0, -2.0, 0.5, 0.3, -4.0])
                rates = damped(r, Rates(1.0, -2.0, 0.5, 0.3, -4.0), k, belt, 0.002)
                assert rates == pytest.approx(expected, rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("vehicle", ["focchi", "strawa"])
def test_a_million_random_states_have_finite_loads_within_the_strength_of_the_soil(vehicle):
    p, count, draws = VEHICLES[vehicle], 50_000, np.random.default_rng(14)
    names = p._fields
    for block in range(10):
        size = 10.0 ** draws.uniform(-14.0, 2.0, (count, 5)) * draws.choice([-1, 1], (count, 5))
        size[draws.random((count, 5)) < 0.15] = 0.0
        rolling = draws.random(count) < 0.1
        size[rolling, 3:] = size[rolling, :1] / p.sprocket_radius
        states = np.concatenate([draws.uniform(-9.0, 9.0, (count, 3)), size[:, :3]], axis=1)
        table = np.tile(np.array(p), (count, 1))
        if vehicle == "focchi":
            table[:, names.index("friction_angle")] = np.arctan(draws.uniform(0.05, 1.0, count))
        modulus = 10.0 ** draws.uniform(-4.0, -1.0, count)
        table[:, names.index("shear_deformation_modulus")] = modulus
        tangent = np.tan(table[:, names.index("friction_angle")])
        # c A + N tan(phi) of one side
        strength = p.cohesion * p.contact_length * p.track_width + 0.5 * p.mass * 9.81 * tangent
        _, loads = cases.run(states, size[:, 3:], table, 0)
        bound = strength * (1.0 + 1e-9) + 1e-9
        assert np.all(np.abs(loads[:, :2]) <= bound[:, None])
        together = np.hypot(loads[:, 0] + loads[:, 1], loads[:, 4])
        assert np.all(together <= 2.0 * bound)
        reach = math.hypot(0.5 * p.contact_length, 0.5 * (p.track_gauge + p.track_width))
        rolling_moment = 0.5 * p.track_gauge * p.longitudinal_resistance * p.mass * 9.81
        assert np.all(np.abs(loads[:, 5]) <= 2.0 * bound * reach + rolling_moment)
        moved, loads = cases.run(states, size[:, 3:], table, 1, 2.5e-3, euler=block % 2 == 0)
        assert np.all(np.isfinite(moved)) and np.all(np.isfinite(loads))


@pytest.mark.parametrize("euler", [False, True], ids=["rosenbrock", "euler"])
def test_every_row_of_a_batch_is_the_vehicle_alone_bit_for_bit(euler):
    draws = np.random.default_rng(15)
    states = draws.uniform(-3.0, 3.0, (17, 6)) / [1.0, 1.0, 1.0, 3.0, 3.0, 3.0]
    speeds = draws.uniform(-8.0, 8.0, (17, 2))
    table = np.array([STRAWA if i % 3 else FOCCHI for i in range(17)])
    together = np.hstack(cases.run(states, speeds, table, 50, 2.5e-3, euler))
    assert together.all()  # all loads of every vehicle
    for row, (state, speed, p) in enumerate(zip(states, speeds, table, strict=True)):
        alone = np.hstack(cases.run(state, speed, p, 50, 2.5e-3, euler))
        assert np.array_equal(alone[0], together[row])


def test_the_presets_are_those_of_the_table():
    # F Table 2: l = 2 * 0.35 m, B is its "track width", A_t = 0.07 m^2, A_p = 0.00175 m^2.
    p = VEHICLES["focchi"]
    assert (p.mass, p.inertia, p.track_gauge, p.contact_length) == (62.0, 4.5, 0.606, 0.7)
    assert (p.sprocket_radius, p.longitudinal_resistance, p.cohesion) == (0.0856, 0.025, 0.0)
    assert p.shear_deformation_modulus == 0.001
    assert p.contact_length * p.track_width == pytest.approx(0.07)
    assert p.contact_length * p.track_width / (10 * 4) == pytest.approx(0.00175)
    assert (PATCHES.columns.size, 2 * PATCHES.rows.size) == (10, 4)
    assert math.tan(p.friction_angle) == pytest.approx(0.4)
    assert VEHICLES["focchi-short"] == p._replace(contact_length=0.5)
    assert FIRM_FLOOR.cohesion == 0.0
    assert soil.GRAVITY == 9.81


def test_a_vehicle_without_speed_stays_where_it_is_and_one_that_rolls_keeps_rolling():
    for patches in (make_patches(1, 1), make_patches(9, 3), PATCHES):
        for euler in (False, True):
            still, _ = cases.run(
                [1.0, 2.0, 0.5, 0, 0, 0], (0, 0), FOCCHI, 1000, 5e-3, euler, patches
            )
            assert still[0].tolist() == [1.0, 2.0, 0.5, 0.0, 0.0, 0.0]
            speeds = 0.5 / FOCCHI.sprocket_radius
            rolled, loads = cases.run(
                [0.0, 0.0, 0.0, 0.5, 0.0, 0.0], (speeds, speeds), EASY, 400, 2.5e-3, euler, patches
            )
            assert rolled[0] == pytest.approx([0.5, 0.0, 0.0, 0.5, 0.0, 0.0], rel=1e-12)
            assert np.abs(loads).max() < 1e-9
