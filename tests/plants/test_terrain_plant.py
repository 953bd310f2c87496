"""The plant on terrain: closed forms on slopes, standing friction, tipping, flight."""

import math

import numpy as np
import pytest

from tests.plants import terrain_runs as cases
from tracked_env.arrays import RELIEF_COLUMNS
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import STATE_NAMES, VEHICLES
from tracked_env.physics.terrain_motion import NOMINAL_BODY
from tracked_env.plants.standalone import Rig, TerrainRig
from tracked_env.plants.terrain import RELIEF

ODD = ("y", "yaw", "v_y", "yaw_rate", "roll", "roll_rate", "acceleration_y", "yaw_acceleration")
# [rad/s^2] The yaw acceleration is a sum over 80 patches whose order is the compiler's: 600 N at
# 0.35 m over 4.5 kg m^2, 47 rad/s^2, times the rounding unit 1.1e-16 and the root of 80.
YAW_ACCELERATION = 4.7e-14
# [m/s^2] sums of 40 patches add in another order with the vector width of the processor:
ACCELERATION = 5e-14  # 40 eps / 2 times g


def assert_mirrored(rigs, allowed):
    """The states of two rigs are mirror images, within `allowed` in SI units."""
    for name in STATE_NAMES:
        if name.endswith(("_left", "_right")):
            continue
        one, other = (getattr(rig.state, name)[0] for rig in rigs)
        within = allowed
        if "acceleration" in name:
            within = YAW_ACCELERATION if name.startswith("yaw") else max(ACCELERATION, allowed)
        assert one == pytest.approx(-other if name in ODD else other, abs=within), name


STEEP = math.radians(20.0)
FIELD = [{"kind": "plane", "slope_x": 0.15, "slope_y": 0.1}, {"kind": "hills", "height": 0.3}]


def with_belts_at(rig, speed, duration=4.0):
    """The rig with both belts at `speed` [m/s], reached within the first second."""
    command = [[speed / cases.RADIUS] * 2]
    rig.advance(cases.STILL, 1.0, to=command)
    rig.advance(command, duration - 1.0)
    return rig


@pytest.mark.parametrize(
    ("load", "aside", "tilt"),
    [("nonuniform", False, 6.56e-3), ("uniform", False, 6.47e-3), ("uniform", True, 2.827e-3)],
)
def test_a_vehicle_holds_on_a_slope_and_leans_as_its_springs_allow(load, aside, tilt):
    rig = cases.rig_with(slope=STEEP, load=load, aside=aside)
    rig.advance(cases.STILL, 4.0)
    assert rig.load[0] == pytest.approx(62.0 * cases.GRAVITY * math.cos(STEEP), rel=1e-9)
    angle = rig.state.roll[0] if aside else -rig.state.pitch[0]
    assert angle - STEEP == pytest.approx(tilt, rel=2e-3)
    # sin(tilt) K_y (1 - 1/n_x^2) = m g cos(s) x_cp, x_cp = h tan(s + tilt); the foot of the uniform
    # load takes the whole weight: m g h sin(s + tilt).
    if not aside:
        area, patches = 0.14, 1.0 - (0.01 if load == "nonuniform" else 0.0)
        stiff = 1e5 / 0.07 * area * cases.HALF_LENGTH**2 / 3.0 * patches
        moment = 62.0 * cases.GRAVITY * cases.HEIGHT * math.cos(STEEP) * math.tan(angle)
        if load == "uniform":
            moment = 62.0 * cases.GRAVITY * cases.HEIGHT * math.sin(angle)
        assert stiff * math.sin(angle - STEEP) == pytest.approx(moment, rel=2e-3)
    assert np.abs(rig.twists).max() < 1e-6


def test_the_lower_track_carries_the_moment_of_the_height_of_the_centre_of_mass():
    rig = cases.rig_with(slope=STEEP, aside=True)
    rig.advance(cases.STILL, 4.0)
    left, right = rig.track_loads[0]
    arm = cases.HEIGHT * math.tan(rig.state.roll[0])
    assert 0.303 * (right - left) == pytest.approx((left + right) * arm, rel=2e-2)


@pytest.mark.parametrize("load", ["nonuniform", "uniform"])
def test_on_a_steeper_slope_than_its_friction_holds_a_vehicle_slides(load):
    slope, mu = math.radians(30.0), 0.4
    rig = cases.rig_with(slope=slope, mu=mu, load=load)
    speeds = []
    for _ in range(2):
        rig.advance(cases.STILL, 1.0)
        speeds.append(np.linalg.norm(rig.twists[0, :3]))
    expected = cases.GRAVITY * (math.sin(slope) - mu * math.cos(slope))
    assert speeds[1] - speeds[0] == pytest.approx(expected, rel=1e-3)


def test_a_vehicle_breaks_away_within_one_percent_of_its_friction():
    for mu in (0.3, 0.6):
        for share, moves in ((0.99, False), (1.01, True)):
            slope = math.atan(share * mu)
            settled = cases.rig_with(slope=slope, mu=2.0)
            settled.advance(cases.STILL, 2.0)
            rig = cases.rig_with(slope=slope, mu=mu)
            rig.states[:] = settled.states
            rig.advance(cases.STILL, 3.0)
            speed = np.linalg.norm(rig.twists[0, :3])
            slid = 3.0 * cases.GRAVITY * (math.sin(slope) - mu * math.cos(slope))
            assert speed == pytest.approx(slid, rel=0.02) if moves else speed < 1e-6


@pytest.mark.parametrize("step", [5e-4, 2e-3])
def test_a_settled_vehicle_that_loses_its_grip_is_not_held_back(step):
    slope = math.radians(22.1)
    settled = cases.rig_with(slope=slope, mu=1.0, step=step)
    settled.advance(cases.STILL, 3.0)
    rig = cases.rig_with(slope=slope, mu=0.4, step=step)
    rig.states[:] = settled.states
    rig.advance(cases.STILL, 2.0)
    assert np.linalg.norm(rig.twists[0, :3]) == pytest.approx(0.110, abs=5e-4)


def test_a_parked_vehicle_does_not_creep():
    rig = cases.rig_with(slope=STEEP)
    rig.advance(cases.STILL, 3.0)
    before = rig.positions
    rig.advance(cases.STILL, 10.0)
    assert np.linalg.norm(rig.positions - before) < 1e-6


@pytest.mark.parametrize(
    ("load", "slope", "speed", "slip"),
    [
        ("uniform", STEEP, 0.428, 3.261e-3),
        ("nonuniform", STEEP, 0.428, 2.31e-3),
        ("nonuniform", -STEEP, 0.428, -4.8e-3),
        ("nonuniform", STEEP, -0.428, -4.8e-3),
    ],
)
def test_the_slip_of_a_steady_climb_is_that_of_the_shear_under_the_load(load, slope, speed, slip):
    rig = with_belts_at(cases.rig_with(slope=slope, load=load), speed)
    twist, tilt = rig.twists[0], -rig.state.pitch[0] - slope
    along = (twist[0] - cases.HEIGHT * twist[4]) * math.cos(tilt) - twist[2] * math.sin(tilt)
    belt = speed * math.cos(tilt)
    assert (belt - along) / belt == pytest.approx(slip, rel=5e-3)


def test_across_a_slope_the_vehicle_drifts_and_its_nose_turns_downhill():
    rig = with_belts_at(cases.rig_with(slope=STEEP, aside=True), 0.5, 2.0)
    v_x, v_y, *_, yaw_rate = rig.twists[0]
    assert -math.atan2(v_y, v_x) == pytest.approx(3.00e-3, rel=5e-3)
    assert -yaw_rate == pytest.approx(1.17e-3, rel=5e-3)


@pytest.mark.parametrize(("aside", "holds", "tips"), [(False, 43.5, 44.5), (True, 49.5, 50.5)])
def test_a_vehicle_tips_at_the_slope_that_its_springs_allow(aside, holds, tips):
    for degrees, stays in ((holds, True), (tips, False)):
        rig = cases.rig_with(slope=math.radians(degrees), mu=3.0, aside=aside)
        rig.advance(cases.STILL, 6.0)
        angle = rig.state.roll[0] if aside else -rig.state.pitch[0]
        assert (abs(angle - math.radians(degrees)) < 0.1) == stays
        assert np.isfinite(rig.states).all()


@pytest.mark.parametrize("load", ["nonuniform", "uniform"])
@pytest.mark.parametrize(("shift", "allowed"), [((0.0,) * 3, 1e-14), ((0.05, 0.06, 0.02), 2e-14)])
def test_mirrored_mass_ground_and_commands_mirror_the_motion(load, shift, allowed):
    rigs = []
    for side in (1.0, -1.0):
        terrain = {"kind": "waves", "waves": [[0.05, 1.1, side * 0.7, 0.3]]}
        rig = cases.rig_with(shift * np.array([1.0, side, 1.0]), terrain=terrain, load=load)
        rig.advance(cases.STILL, 0.2, to=[[6.0, 4.0] if side > 0 else [4.0, 6.0]])
        rigs.append(rig)
    assert_mirrored(rigs, allowed)
    assert rigs[0].state.effort_left == pytest.approx(rigs[1].state.effort_right, abs=1e-11)


@pytest.mark.parametrize("drive", ["speed", "torque"])
def test_without_height_on_level_ground_it_is_the_distributed_plant(drive):
    parameters = cases.FOCCHI._replace(drive_time_constant=0.1)
    command = np.array([[4.0, 6.0]]) if drive == "speed" else np.array([[5.0, 9.0]])
    flat = Rig("distributed", parameters, 1, drive, step=1e-3)
    rig = TerrainRig(parameters, {"centre_of_mass_height": 1e-4}, drive=drive, step=1e-3)
    for _ in range(10):
        flat.advance(command, 0.3)
        rig.advance(command, 0.3)
    here, there = rig.states[0], flat.states[0]
    assert here[:2] == pytest.approx(there[:2], abs=5e-4)
    assert here[s.YAW] == pytest.approx(there[s.YAW], abs=2e-3)
    assert here[s.SPROCKET_SPEED_LEFT] == pytest.approx(there[s.SPROCKET_SPEED_LEFT], rel=2e-3)
    assert here[s.EFFORT_LEFT] == pytest.approx(there[s.EFFORT_LEFT], rel=1e-2, abs=0.5)
    assert abs(here[s.Z]) < 1e-6


def test_belts_driven_by_torque_take_up_the_torque_that_the_ground_does_not():
    by_torque = TerrainRig(
        cases.FOCCHI, {"terrain": {"kind": "plane", "slope_x": math.tan(0.1)}}, drive="torque"
    )
    holding = 0.5 * 62.0 * cases.GRAVITY * math.sin(0.1) * cases.RADIUS
    by_torque.advance([[holding, holding]], 3.0)
    assert by_torque.state.effort_left[0] * cases.RADIUS == pytest.approx(holding, rel=1e-3)
    before = by_torque.state.sprocket_speed_left[0]
    by_torque.advance([[holding + 1.0, holding + 1.0]], 0.5)
    gained = by_torque.state.sprocket_speed_left[0] - before
    # The belts' inertia is added to the vehicle's: m + 2 J / r^2.
    mass = 62.0 + 2.0 * cases.FOCCHI.sprocket_inertia / cases.RADIUS**2
    assert gained * cases.RADIUS == pytest.approx(2.0 / cases.RADIUS / mass * 0.5, rel=0.05)


@pytest.mark.parametrize("count", [300, pytest.param(1500, marks=pytest.mark.slow)])
@pytest.mark.parametrize("load", ["nonuniform", "uniform"])
def test_random_states_stay_finite_in_every_attitude(load, count):
    rng = np.random.default_rng(1)
    rig = TerrainRig(cases.FOCCHI, {"terrain": FIELD, "load": load}, count)
    rig.states[:] = 0.0
    rig.states[:, [s.X, s.Y]] = rng.uniform(-20.0, 20.0, (count, 2))
    height = rig.field.at(rig.states[:, s.X], rig.states[:, s.Y])[0]
    rig.states[:, s.Z] = height + rng.uniform(-0.3, 0.5, count)
    rig.states[:, [s.YAW, s.PITCH, s.ROLL]] = rng.uniform(-3.2, 3.2, (count, 3))
    speeds = [s.V_X, s.V_Y, s.V_Z, s.ROLL_RATE, s.PITCH_RATE, s.YAW_RATE]
    rig.states[:, speeds] = rng.uniform(-3.0, 3.0, (count, 6))
    rig.advance(rng.uniform(-10.0, 10.0, (count, 2)), 0.1)
    assert np.isfinite(rig.states).all()
    assert np.abs(rig.twists).max() < 1e3


def test_a_vehicle_flies_off_a_step_and_lands_on_its_tracks():
    step = {"kind": "step", "height": -0.6, "start": 0.6, "length": 0.3}
    rig = TerrainRig(cases.FOCCHI._replace(friction_angle=0.7), {"terrain": step})
    rig.advance(cases.STILL, 0.5, to=[[25.0, 25.0]])
    touching = []
    for _ in range(150):
        rig.advance([[25.0, 25.0]], 0.02)
        touching.append(rig.touching[0])
        assert np.isfinite(rig.states).all()
    assert min(touching) == 0.0 and rig.load[0] > 0.0
    assert touching[-1] == 1.0 and abs(rig.state.pitch[0]) < 0.05
    assert rig.state.z[0] == pytest.approx(-0.6, abs=2e-3)


def test_leaving_the_map_is_said():
    heights = np.zeros((21, 21))
    rig = TerrainRig(cases.FOCCHI, {"terrain": {"kind": "map", "heights": heights, "cell": 0.1}})
    assert not rig.off_map[0]
    rig.advance([[6.0, 6.0]], 2.0)
    assert rig.off_map[0] and rig.positions[0, 0] > 0.65


def test_height_and_inertias_are_scaled_with_the_vehicle_unless_they_are_given():
    for name in ("focchi", "strawa"):
        length = VEHICLES[name].contact_length
        rig = TerrainRig(VEHICLES[name])
        sunk = (
            rig._parameters.mass
            * cases.GRAVITY
            / (2.0 * rig._body.stiffness * length * VEHICLES[name].track_width)
        )
        assert rig.positions[0, 2] == pytest.approx(NOMINAL_BODY.height_ratio * length - sunk)
        assert rig.load[0] == pytest.approx(rig._parameters.mass * cases.GRAVITY)
    low = TerrainRig(cases.FOCCHI, {"centre_of_mass_height": 0.1})
    assert low.positions[0, 2] == pytest.approx(0.1 - 62.0 * cases.GRAVITY / (1e5 / 0.07 * 0.14))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"load": "point"}, "unknown load 'point'"),
        ({"soil_at": "tracks"}, "unknown soil_at 'tracks'"),
        ({"patches": (81, 4)}, "patches along the track = 81.0; must be"),
        ({"patches": (80, 80)}, "must be at most 644 a track in all"),
        ({"stiffness": 1.0}, "stiffness = 1.0 N/m.3; must be a number in"),
        ({"longest_step": 1.0}, "Did you pass milliseconds"),
        ({"centre_of_mass_height": -0.1}, "centre_of_mass_height = -0.1 m"),
        ({"terrain": "hils"}, "Did you mean 'hills'"),
        ({"friction": 0.4}, "unknown plant_options of terrain key 'friction'"),
    ],
)
def test_a_wrong_option_is_refused(options, says):
    with pytest.raises(ValueError, match=says):
        TerrainRig(cases.FOCCHI, options, step=options.get("longest_step", 2e-3))


def test_the_columns_of_its_own_are_its_loads():
    rig = cases.rig_with()
    assert rig._batch.floats.shape[1] == RELIEF + RELIEF_COLUMNS
    assert rig.track_loads[0] == pytest.approx([0.5 * 62.0 * cases.GRAVITY] * 2)
    assert rig.largest_load[0] == pytest.approx(62.0 * cases.GRAVITY / 80)
