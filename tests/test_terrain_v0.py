"""`tracked_env/Terrain-v0`: errors, endings, sensors and drawn ground on slopes and hills."""

import copy

import gymnasium
import numpy as np
import pytest

from tests import driving
from tests.driving import ON_PATH, STILL, run
from tracked_env import SPEED_ID, TERRAIN, TERRAIN_ID
from tracked_env import arrays as b
from tracked_env import observation as obs
from tracked_env.physics.parameters import VehicleState
from tracked_env.physics.rigid_body import matrix_of, quaternion_of
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.plants.terrain import RELIEF
from tracked_env.sb3 import make_vec_env
from tracked_env.sensors import CHANNELS, signals
from tracked_env.vector_env import TrackedVehicleVectorEnv

GRADE = 0.2
UPHILL = {"terrain": {"kind": "plane", "slope_x": GRADE}}
ROUGH = {"soil": {"friction_angle": 0.7}}
CALM = {
    "reference": {"kind": "straight", "speed": 0.3},
    "uncertainty": "nominal",
    "sensors": "ideal",
    "expose_truth": True,
    "duration": 4.0,
}
ENDINGS = ("ended_off_path", "ended_tilted", "ended_off_map", "ended_overloaded")


def make(**arguments):
    return driving.make(TERRAIN_ID, **arguments)


def parked(terrain, yaw=0.0, steps=150, **arguments):
    """Observation by name and info of a vehicle that stands with locked belts."""
    reference = {"kind": "straight", "speed": 0.0, "yaw": yaw}
    options = {"plant_options": {"terrain": terrain}}
    env = make(**{**CALM, "reference": reference, **options, **arguments})
    still = {"start": STILL, **ROUGH}
    observations, _, info = run(env, steps, np.zeros((steps, 2)), options=still)
    return env.layout.unpack(observations[-1]), info


def test_the_observation_is_that_of_speed_v0_with_attitude_and_tangent_error():
    layout = make().layout
    assert layout.groups == (*obs.V0.groups, "attitude", "tangent_error")
    assert layout.names[: obs.SIZE] == obs.NAMES


def test_every_vehicle_and_episode_has_ground_of_its_own():
    env = TrackedVehicleVectorEnv(3, **{**TERRAIN, "uncertainty": "hills"})
    env.reset(seed=0)
    first = env.simulation.batch.floats[:, RELIEF:].copy()
    assert len({row.tobytes() for row in first}) == 3
    env.reset()
    again = env.simulation.batch.floats[:, RELIEF:]
    assert not any(np.array_equal(one, other) for one, other in zip(first, again, strict=True))


@pytest.mark.parametrize("name, steepest, spread", [("slope", 0.3, 0.0), ("hills", 0.2, 0.105)])
def test_drawn_ground_follows_its_law(name, steepest, spread):
    env = TrackedVehicleVectorEnv(400, **{**TERRAIN, "uncertainty": name})
    env.reset(seed=1)
    relief = env.simulation.batch.floats[:, RELIEF:]
    grade = np.hypot(relief[:, 0], relief[:, 1])
    assert grade.max() < steepest and grade.max() > 0.95 * steepest and grade.min() < 0.02
    directions = np.arctan2(relief[:, 1], relief[:, 0])
    assert np.histogram(directions, 4, (-np.pi, np.pi))[0].min() > 70
    height = np.sqrt(0.5 * (relief[:, 2::4] ** 2).sum(axis=1))
    assert height.max() <= spread * (1 + 1e-12)
    if spread:
        k = np.hypot(relief[:, 3::4], relief[:, 4::4])
        np.testing.assert_allclose(k[:, 0], 2 * np.pi / 9.8)
        np.testing.assert_allclose(k[:, -1], 2 * np.pi / 2.45)
        np.testing.assert_allclose(relief[:, 6] / relief[:, 2], (k[:, 1] / k[:, 0]) ** -0.8)
        assert height.min() > 0.05 * 0.7 and height.max() > 0.95 * spread


def test_plants_on_level_ground_draw_the_same_vehicles_without_the_ground():
    flat = driving.make(SPEED_ID, uncertainty="hills", expose_truth=True)
    hilly = make(uncertainty="hills", expose_truth=True)
    one, other = (env.reset(seed=3)[1]["truth"] for env in (flat, hilly))
    assert one["mass"] == other["mass"] and one["friction_angle"] == other["friction_angle"]
    assert one["z"] == 0.0 != other["z"]


def test_the_error_is_that_of_the_vehicles_plane_with_the_yaw_in_it_once():
    env = make(**{**CALM, "plant_options": {"terrain": {"kind": "plane", "slope_y": 0.4}}})
    start = {"offset_x": -0.5, "offset_y": 0.3, "offset_yaw": 0.6, "speed": 0.0}
    readings, info = env.reset(seed=0, options={"start": start, **ROUGH})
    truth = info["truth"]
    attitude = quaternion_of(truth["yaw"], truth["pitch"], truth["roll"])
    axes = np.array(matrix_of(attitude)).reshape(3, 3)
    reference = env.simulation.batch.floats[0, [b.REFERENCE_X, b.REFERENCE_Y]]
    world = np.array([*(reference - [truth["x"], truth["y"]]), 0.0])
    expected = axes.T @ world
    turn = axes[2, 2] * -0.6
    distance, heading = info["tracking_error"]
    assert distance == pytest.approx(np.hypot(*expected[:2]), rel=1e-12)
    assert heading == pytest.approx(turn, rel=1e-12)
    fields = env.layout.unpack(readings)
    assert fields["tangent_error_x"] == pytest.approx(expected[0], rel=1e-6)
    assert fields["tangent_error_y"] == pytest.approx(expected[1], rel=1e-6)
    assert fields["tangent_heading_error"] == pytest.approx(turn, rel=1e-6)
    assert fields["position_error_x"] == pytest.approx(
        np.hypot(0.5, 0.3) * np.cos(np.arctan2(-0.3, 0.5) - 0.6), rel=1e-5
    )  # horizontal, as everywhere


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.0])
def test_a_vehicle_that_stands_on_a_slope_feels_gravity_and_nothing_else(yaw):
    readings, info = parked({"kind": "plane", "slope_x": GRADE}, yaw)
    force = np.array(
        [readings["acceleration_x"], readings["acceleration_y"], readings["specific_force_z"]]
    )
    assert np.linalg.norm(force) == pytest.approx(GRAVITY, rel=1e-4)
    truth = info["truth"]
    axes = np.array(matrix_of(quaternion_of(truth["yaw"], truth["pitch"], truth["roll"])))
    np.testing.assert_allclose(force, GRAVITY * axes.reshape(3, 3)[2], atol=2e-3)
    along = GRAVITY * GRADE / np.hypot(1.0, GRADE)  # up the slope
    assert force[:2] @ [np.cos(yaw), -np.sin(yaw)] == pytest.approx(along, rel=0.05)
    assert abs(readings["roll_rate"]) + abs(readings["pitch_rate"]) < 1e-3


def test_two_lateral_accelerometers_measure_the_product_of_roll_and_pitch_rate_too():
    names = {"roll_rate": 0.7, "pitch_rate": -0.4, "yaw_rate": 0.5, "yaw_acceleration": 0.3}
    state = VehicleState(pitch=0.1, **names)
    measured = signals.py_func(np.array([state]), 0, 0.1, 0.0, 1.0)[
        CHANNELS.index("yaw_acceleration")
    ]
    turning, turned = np.array([0.7, -0.4, 0.5]), np.array([0.0, 0.0, 0.3])
    arm = np.array([2.0, 0.0, 0.0])  # from one to the other, ahead
    difference = np.cross(turned, arm) + np.cross(turning, np.cross(turning, arm))
    assert measured == pytest.approx(difference[1] / 2.0, rel=1e-12)


def test_on_level_ground_the_accelerometer_is_that_of_the_flat_plant_and_reads_g_upward():
    readings, _ = parked("flat")
    assert readings["specific_force_z"] == pytest.approx(GRAVITY, rel=1e-5)
    assert abs(readings["acceleration_x"]) + abs(readings["acceleration_y"]) < 1e-5


def test_gyros_measure_body_rates_and_attitude_errs_as_the_yaw_does():
    arguments = {**TERRAIN, "sensors": "rtk", "expose_truth": True, "error_limit": 1e3}
    env = TrackedVehicleVectorEnv(64, **arguments)
    env.reset(seed=2)
    errors = []
    for _ in range(60):
        readings, _, _, _, info = env.step(np.tile(np.float32([0.3, 0.4]), (64, 1)))
        fields = env.layout.unpack(readings)
        errors.append([fields[n] - info["truth"][n] for n in ("roll", "pitch", "roll_rate")])
    spread = np.std(errors, axis=0)
    assert spread[:2].mean() == pytest.approx(np.radians(0.3), rel=0.1)
    assert spread[2].mean() == pytest.approx(0.002, rel=0.1)
    bias = np.mean(errors, axis=0)[2]
    assert np.abs(np.abs(bias) - 0.001).max() < 4 * 0.002 / np.sqrt(60)


def test_a_copy_draws_a_picture_of_its_own_ground():
    env = make(render_mode="rgb_array")
    env.reset(seed=1)
    first = env.render()
    other = copy.deepcopy(env)
    env.reset(seed=9)
    assert env.render().shape == other.render().shape == first.shape == (800, 960, 3)
    assert not np.array_equal(env.render(), other.render())


def test_a_law_of_ones_own_may_draw_ground():
    def ridge(rng, nominal, profile, duration):
        return nominal, [], (0.1, 0.0, *[0.0] * 32)

    env = make(uncertainty=ridge, expose_truth=True)
    _, info = env.reset(seed=0, options={"start": {**ON_PATH, "offset_x": 1.0}})
    expected = 0.1 * info["truth"]["x"]
    assert info["truth"]["z"] == pytest.approx(expected, abs=5e-3)

    def cliff(rng, nominal, profile, duration):
        return nominal, [], (9.0, 0.0, *[0.0] * 32)

    with pytest.raises(ValueError, match="relief with a slope of up to 9"):
        make(uncertainty=cliff)


# --- why episodes end -------------------------------------------------------------------------

EDGE = {"terrain": {"kind": "map", "heights": np.zeros((9, 9)).tolist(), "cell": 0.25}}
STEEP = {"terrain": {"kind": "ramp", "slope": 0.5, "start": 0.5}, "tilt_limit": 0.3}
OFF_PATH = {"error_limit": 0.4, "reference": {"kind": "straight", "speed": 0.5}}


@pytest.mark.parametrize(
    ("arguments", "action", "reason"),
    [
        ({"plant_options": EDGE}, 0.5, "ended_off_map"),
        ({"plant_options": STEEP}, 0.5, "ended_tilted"),
        (OFF_PATH, 0.0, "ended_off_path"),
        ({"duration": 0.5}, 0.35, None),
    ],
)
def test_an_episode_ends_with_its_reason_and_by_time_with_none(arguments, action, reason):
    env = make(**{**CALM, **arguments})
    env.reset(seed=0, options={"start": ON_PATH, **ROUGH})
    terminated = truncated = False
    while not (terminated or truncated):
        *_, terminated, truncated, info = env.step(np.full(2, action, np.float32))
        truth = info["truth"]
        tilt = np.arccos(np.cos(truth["pitch"]) * np.cos(truth["roll"]))
        assert info["ended_tilted"] == (reason == "ended_tilted" and tilt > 0.3)
        assert terminated or not any(info[name] for name in ENDINGS)
    assert (terminated, truncated) == (reason is not None, reason is None)
    assert [name for name in ENDINGS if info[name]] == ([reason] if reason else [])
    assert not (terminated and info["is_success"])


def test_the_same_step_reset_keeps_the_reason_in_final_info():
    arguments = {**TERRAIN, **CALM, "plant_options": EDGE, "autoreset_mode": "SameStep"}
    env = TrackedVehicleVectorEnv(2, **arguments)
    env.reset(seed=0, options={"start": ON_PATH, **ROUGH})
    terminated = np.zeros(2, bool)
    while not terminated.any():
        *_, terminated, _, info = env.step(np.full((2, 2), 0.5, np.float32))
    assert info["final_info"]["ended_off_map"].all() and not info["ended_off_map"].any()


def test_stable_baselines_reads_the_reason_too():
    env = make_vec_env(TERRAIN_ID, 2, env_kwargs={**CALM, "plant_options": EDGE})
    env.reset()
    dones = [False]
    while not any(dones):
        *_, dones, infos = env.step(np.full((2, 2), 0.8, np.float32))
    flags = {name: infos[int(np.argmax(dones))][name] for name in ENDINGS}
    assert flags == {name: name == "ended_off_map" for name in ENDINGS}


def test_other_environments_have_no_such_flags():
    env = gymnasium.make("tracked_env/Speed-v0")
    _, info = env.reset(seed=0)
    assert not any(name.startswith("ended_") for name in info)


def test_off_map_and_tilt_do_not_outlive_their_episode():
    env = make(**{**CALM, "plant_options": {**UPHILL, "tilt_limit": 0.1}})
    env.reset(seed=0)
    assert env.simulation.batch.floats[0, b.FAILURE] == 1.0
    *_, terminated, _, info = env.step(np.zeros(2, np.float32))
    assert terminated and info["ended_tilted"]
    _, info = env.reset(seed=0)
    assert not any(info[name] for name in ENDINGS)
