"""The plant on terrain with a shifted centre of mass, inertias of its own and softer ground."""

import math

import gymnasium
import numpy as np
import pytest

from tests.driving import ON_PATH
from tests.plants import terrain_runs as cases
from tracked_env import TERRAIN, TERRAIN_ID
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import PARAMETER_NAMES, VEHICLES
from tracked_env.physics.rigid_body import Inertia, Quaternion, matrix_of, with_payload
from tracked_env.plants.standalone import TerrainRig
from tracked_env.vector_env import TrackedVehicleVectorEnv

SINKAGE = cases.MASS * cases.GRAVITY / 2e5  # [m] on level ground
SLOPE = math.radians(15.0)


def axes_of(rig):
    """Rotation (3, 3) of the vehicle of a rig, body to world."""
    return np.array(matrix_of(Quaternion(*rig.quaternions[0]))).reshape(3, 3)


def rocking(load, across):
    """Stiffness [N m/rad] of the springs of 10 x 4 patches a track against pitch or roll."""
    nx2, ny2 = (100.0, 16.0) if load == "nonuniform" else (math.inf, math.inf)
    square = cases.HALF_LENGTH**2 / 3.0 * (1.0 - 1.0 / nx2)
    if across:
        square = cases.HALF_GAUGE**2 + cases.WIDTH**2 / 12.0 * (1.0 - 1.0 / ny2)
    return 2e5 * square


@pytest.mark.parametrize("load", ["nonuniform", "uniform"])
@pytest.mark.parametrize("slope", [0.0, SLOPE])
@pytest.mark.parametrize("ahead", [0.06, -0.04])
def test_the_centre_of_pressure_of_a_standing_vehicle_is_under_its_centre_of_mass(
    load, slope, ahead
):
    rig = cases.rig_with((ahead, 0.0, 0.0), slope, load=load)
    rig.advance(cases.STILL, 4.0)
    weight = cases.MASS * cases.GRAVITY * math.cos(slope)
    assert rig.load[0] == pytest.approx(weight, rel=1e-7)
    nose_up = -rig.state.pitch[0]
    result = rocking(load, False) * math.sin(slope - nose_up) / weight
    assert result == pytest.approx(ahead - cases.HEIGHT * math.tan(nose_up), rel=5e-3, abs=1e-5)


@pytest.mark.parametrize("load", ["nonuniform", "uniform"])
def test_a_load_to_the_left_presses_on_the_left_track_and_tilts_the_vehicle(load):
    rig = cases.rig_with((0.0, 0.05, 0.1), load=load)
    rig.advance(cases.STILL, 4.0)
    left, right = rig.track_loads[0]
    roll = rig.state.roll[0]
    arm = 0.05 - (cases.HEIGHT + 0.1) * math.tan(roll)  # lower on the left
    assert roll < 0.0
    assert -rocking(load, True) * math.sin(roll) == pytest.approx(
        cases.MASS * cases.GRAVITY * arm, rel=2e-3
    )
    if load == "nonuniform":
        share = cases.HALF_GAUGE**2 / (
            cases.HALF_GAUGE**2 + cases.WIDTH**2 / 12.0 * (1.0 - 1.0 / 16.0)
        )
        assert cases.HALF_GAUGE * (left - right) == pytest.approx(
            cases.MASS * cases.GRAVITY * arm * share, rel=2e-3
        )


@pytest.mark.parametrize("load", ["nonuniform", "uniform"])
@pytest.mark.parametrize("shift", [(0.06, 0.04, 0.05), (-0.08, -0.03, -0.05)])
def test_a_vehicle_starts_as_it_stands_later(load, shift):
    rig = cases.rig_with(shift, load=load, factor=0.5)
    first = rig.states[0, [s.Z, s.PITCH, s.ROLL]]
    rig.advance(cases.STILL, 4.0)
    last = rig.states[0, [s.Z, s.PITCH, s.ROLL]]
    assert np.abs(last[1:]).min() > 1.9e-3
    assert first == pytest.approx(last, abs=1e-3)


@pytest.mark.parametrize("load", ["nonuniform", "uniform"])
def test_softer_ground_sinks_in_proportion(load):
    for factor in (0.25, 2.0):
        rig = cases.rig_with(factor=factor, load=load)
        rig.advance(cases.STILL, 3.0)
        assert cases.HEIGHT - rig.positions[0, 2] == pytest.approx(SINKAGE / factor, rel=1e-6)
        assert abs(rig.state.z[0]) < 1e-6


@pytest.mark.parametrize(
    ("aside", "shift"),
    [(False, (0.08, 0.0, 0.0)), (False, (-0.1, 0.0, 0.05)), (True, (0.0, 0.06, 0.0))],
)
def test_on_stiff_ground_it_tips_where_its_weight_leaves_the_outermost_patches(aside, shift):
    stiff = {"stiffness": 1e7 / 0.07, "damping": 2.5e5 / 0.07, "step": 5e-4, "mu": 3.0}
    for side in (1.0, -1.0):  # it tips backward, to the right; forward, to the left
        edge = cases.HALF_GAUGE + 0.75 * 0.5 * cases.WIDTH if aside else 0.9 * cases.HALF_LENGTH
        limit = math.atan((edge + side * shift[int(aside)]) / (cases.HEIGHT + shift[2]))
        for degrees, stays in ((-0.9, True), (0.3, False)):
            slope = side * (limit + math.radians(degrees))
            rig = cases.rig_with(shift, slope, aside, **stiff)
            rig.advance(cases.STILL, 3.0)
            tilt = rig.state.roll[0] if aside else -rig.state.pitch[0]
            assert (abs(tilt - slope) < 0.1) == stays, (side, degrees)


@pytest.mark.parametrize("load", ["nonuniform", "uniform"])
def test_a_shift_upward_is_a_higher_centre_of_mass(load):
    terrain = [{"kind": "hills", "height": 0.3}, {"kind": "plane", "slope_y": 0.1}]
    low = cases.rig_with((0.0, 0.0, 0.07), terrain=terrain, load=load)
    high = cases.rig_with(terrain=terrain, load=load, centre_of_mass_height=cases.HEIGHT + 0.07)
    up = np.array([0.0, 0.0, 0.07])
    high.place(low.positions[0] + axes_of(low) @ up, low.quaternions[0])
    for rig in (low, high):
        rig.advance(cases.STILL, 0.5, to=[[6.0, 4.0]])
        rig.advance([[6.0, 4.0]], 1.0)
    assert low.positions[0] + axes_of(low) @ up == pytest.approx(high.positions[0], abs=1e-10)
    spin = low.twists[0, 3:]
    assert low.twists[0, :3] + np.cross(spin, up) == pytest.approx(high.twists[0, :3], abs=1e-10)
    assert low.state.effort_left == pytest.approx(high.state.effort_left, abs=1e-6)
    assert low.state.slip_left == pytest.approx(high.state.slip_left, abs=1e-9)


def test_in_flight_the_hull_turns_about_its_true_centre_of_mass_and_sensors_feel_it():
    rig = cases.rig_with((0.1, 0.05, 0.0))
    rig.place((0.0, 0.0, 5.0), (1.0, 0.0, 0.0, 0.0), (0.4, 0.1, 0.0, 0.0, 0.0, 2.0))
    arm, spin = np.array([0.1, 0.05, 0.0]), np.array([0.0, 0.0, 2.0])
    start, velocity = rig.positions[0] + arm, np.array([0.4, 0.1, 0.0]) + np.cross(spin, arm)
    rig.advance(cases.STILL, 0.5)
    fallen = np.array([0.0, 0.0, -0.5 * cases.GRAVITY * 0.25])
    centre = rig.positions[0] + axes_of(rig) @ arm
    assert centre == pytest.approx(start + 0.5 * velocity + fallen, abs=1e-6)
    assert rig.state.yaw[0] == pytest.approx(1.0, abs=1e-9)
    felt = [rig.state.acceleration_x[0], rig.state.acceleration_y[0], rig.state.acceleration_z[0]]
    assert felt == pytest.approx([4.0 * 0.1, 4.0 * 0.05, -cases.GRAVITY], abs=1e-9)


def test_a_load_that_leaves_in_flight_leaves_the_hull_where_and_as_fast_as_it_was():
    rig = cases.rig_with((0.1, -0.05, 0.08))
    rig.place((0.0, 0.0, 8.0), (1.0, 0.0, 0.0, 0.0), (0.4, 0.1, 0.0, 0.3, -0.2, 1.0))
    rig.advance(cases.STILL, 0.2)
    place, twist = rig.positions[0].copy(), rig.twists[0].copy()
    empty = cases.FOCCHI._replace(mass=50.0, inertia=4.0)
    rig._batch.parameters()[:] = empty
    rig._settle()
    assert rig.positions[0] == pytest.approx(place, abs=1e-12)
    assert rig.twists[0] == pytest.approx(twist, abs=1e-12)
    velocity = axes_of(rig) @ twist[:3]
    rig.advance(cases.STILL, 0.1)
    fallen = np.array([0.0, 0.0, -0.5 * cases.GRAVITY * 0.01])
    assert rig.positions[0] == pytest.approx(place + 0.1 * velocity + fallen, abs=1e-6)


def test_a_load_put_down_in_an_episode_moves_no_sensor():
    env = gymnasium.make(
        TERRAIN_ID,
        uncertainty="nominal",
        sensors="ideal",
        expose_truth=True,
        reference={"kind": "straight", "speed": 0.4},
    ).unwrapped
    at = [{"parameter": name, "kind": "ramp", "target": 0.0, "start": 1.0} for name in cases.CENTRE]
    shift = dict(zip(cases.CENTRE, (0.1, 0.08, 0.1), strict=True))
    env.reset(seed=0, options={"vehicle": shift, "schedule": at, "soil": {"friction_angle": 0.7}})
    readings = []
    for _ in range(100):
        *_, info = env.step(np.float32([0.4, 0.5]))
        readings.append([info["truth"][name] for name in ("x", "y", "v_x", "v_y", "yaw", "roll")])
    steps = np.abs(np.diff(readings, axis=0))
    assert info["truth"]["centre_of_mass_x"] == 0.0
    assert steps[:, :2].max() < 0.015, "the hull jumps"
    assert steps[45:, 2:4].max() < 0.05, "its velocity jumps"
    assert abs(readings[-1][5]) < 0.3 * abs(readings[40][5])


def test_roll_and_pitch_inertia_are_ratios_to_the_yaw_inertia_unless_an_option_says_them():
    def rates(parameters, **options):
        rig = TerrainRig(parameters, options)
        rig.place((0.0, 0.0, 5.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0, 2.0, 3.0))
        rig.advance(cases.STILL, 1e-3)
        return rig.twists[0, 3:] - (1.0, 2.0, 3.0)

    arguments = cases.FOCCHI._replace(inertia=5.0, roll_inertia_ratio=0.4, pitch_inertia_ratio=0.9)
    roll, pitch, yaw = 2.0, 4.5, 5.0
    expected = 1e-3 * np.array(
        [(pitch - yaw) * 6.0 / roll, (yaw - roll) * 3.0 / pitch, (roll - pitch) * 2.0 / yaw]
    )
    assert rates(arguments) == pytest.approx(expected, rel=5e-3)
    own = rates(cases.FOCCHI._replace(inertia=5.0), roll_inertia=2.0, pitch_inertia=4.5)
    assert own == pytest.approx(rates(arguments), rel=1e-12)
    env = {"plant_options": {"roll_inertia": 2.0}}
    with pytest.raises(ValueError, match=r"roll_inertia_ratio = 0.4; the terrain plant"):
        gymnasium.make(TERRAIN_ID, **env).reset(options={"vehicle": {"roll_inertia_ratio": 0.4}})


def payload_episodes(count=400):
    env = TrackedVehicleVectorEnv(count, **{**TERRAIN, "uncertainty": "slope-payload"})
    env.reset(seed=0)
    return env.simulation.episodes


def test_the_payload_of_a_slope_is_a_box_that_steps_on_or_off_with_all_that_it_changes():
    nominal, starts, masses = VEHICLES["focchi"], [], []
    names = ("mass", "inertia", *cases.CENTRE, "roll_inertia_ratio", "pitch_inertia_ratio")
    for episode in payload_episodes():
        after = episode.parameters._replace(
            **{PARAMETER_NAMES[int(row[1])]: row[2] for row in episode.events}
        )
        assert [PARAMETER_NAMES[int(row[1])] for row in episode.events] == list(names)
        (start,) = {row[3] for row in episode.events}
        starts.append(start)
        empty, loaded = sorted((episode.parameters, after), key=lambda p: p.mass)
        assert empty[:17] == pytest.approx(nominal[:17]) and empty[17:] == pytest.approx(
            nominal[17:]
        )
        box = loaded.mass - 62.0
        masses.append(box)
        shift = np.array([getattr(loaded, name) for name in cases.CENTRE])
        place = shift * loaded.mass / box
        assert np.abs(place[0]) < 0.3 * 0.7 and np.abs(place[1]) < 0.2 * 0.606
        assert 0.1 * 0.7 < place[2] < 0.3 * 0.7
        # A cube adds the same of its own about every axis.
        vehicle = Inertia(62.0, 2.18, 2.81, 4.5)
        point, _ = with_payload(vehicle, box, tuple(place), (0.0, 0.0, 0.0))
        inertias = np.array([loaded.roll_inertia_ratio, loaded.pitch_inertia_ratio, 1.0])
        own = inertias * loaded.inertia - np.array(point[1:])
        assert own == pytest.approx(np.full(3, own[0]), rel=1e-6)
        assert box * (0.2 * 0.7) ** 2 / 6.0 <= own[0] <= box * (0.5 * 0.7) ** 2 / 6.0
    assert 9.0 <= min(starts) < 9.5 and 17.5 < max(starts) <= 18.0
    assert 0.2 * 62 <= min(masses) < 13.0 and 30.0 < max(masses) <= 0.5 * 62
    assert 150 < sum(e.parameters.mass > 62.1 for e in payload_episodes()) < 250


def test_soft_patches_are_softer_than_the_ground_around_them():
    env = TrackedVehicleVectorEnv(300, **{**TERRAIN, "uncertainty": "soft-patches"})
    env.reset(seed=0)
    row = PARAMETER_NAMES.index("ground_stiffness_factor")
    around = np.array([e.parameters.ground_stiffness_factor for e in env.simulation.episodes])
    assert 0.5 <= around.min() < 0.52 and 1.48 < around.max() <= 1.5
    for base, episode in zip(around, env.simulation.episodes, strict=True):
        shares = [event[2] / base for event in episode.events if event[1] == row]
        assert len(shares) == 2 and min(shares) >= 0.2 and max(shares) <= 0.6
        assert len(episode.events) == 8


@pytest.mark.parametrize("soil_at", ["centre", "patches"])
def test_a_vehicle_sinks_into_soft_ground_where_it_is_soft(soil_at):
    env = gymnasium.make(
        TERRAIN_ID, uncertainty="nominal", sensors="ideal", expose_truth=True,
        reference={"kind": "straight", "speed": 0.0}, plant_options={"soil_at": soil_at},
    ).unwrapped  # fmt: skip
    soft = {"parameter": "ground_stiffness_factor", "kind": "line", "target": 0.25, "x": 0.0,
            "y": 0.0, "direction": 0.5 * math.pi, "edge": 0.01}  # fmt: skip
    still = {**ON_PATH, "offset_y": 0.02, "speed": 0.0, "yaw_rate": 0.0}
    env.reset(seed=0, options={"start": still, "schedule": [soft]})
    for _ in range(100):
        *_, info = env.step(np.zeros(2, np.float32))
    if soil_at == "centre":  # all of it stands on what is under its centre
        assert info["truth"]["z"] == pytest.approx(-3.0 * SINKAGE, rel=1e-3)
        assert abs(info["truth"]["roll"]) < 1e-6
    else:  # the left track sinks four times as far as the right one
        assert info["truth"]["z"] == pytest.approx(-1.5 * SINKAGE, rel=0.2)
        assert info["truth"]["roll"] == pytest.approx(-3.0 * SINKAGE / 0.606, rel=0.2)
