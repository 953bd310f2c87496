"""`tracked_env/Terrain-v0`: errors, endings, sensors and drawn ground on slopes and hills."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from tests.test_env import run
from tests.test_vector_env import assert_same, wild_actions
from tracked_env import TERRAIN, TERRAIN_ID
from tracked_env import observation as obs
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics.parameters import VehicleState
from tracked_env.physics.rigid_body import matrix_of, quaternion_of
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.plants.terrain import RELIEF
from tracked_env.sensors import CHANNELS, signals
from tracked_env.vector_env import TrackedVehicleVectorEnv

GRADE = 0.2
UPHILL = {"terrain": {"kind": "plane", "slope_x": GRADE}}
ON_PATH = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0}
STANDING = {"start": {**ON_PATH, "speed": 0.0, "yaw_rate": 0.0}}
ROUGH = {"soil": {"friction_angle": 0.7}}
CALM = {
    "reference": {"kind": "straight", "speed": 0.3},
    "uncertainty": "nominal",
    "sensors": "ideal",
    "expose_truth": True,
    "duration": 4.0,
}
SETS = ("slope", "hills", "slope-step", "slope-payload", "soft-patches", "hills-ood")
ENDINGS = ("ended_off_path", "ended_tilted", "ended_off_map", "ended_overloaded")


def make(**arguments):
    return gymnasium.make(TERRAIN_ID, **arguments).unwrapped


def parked(terrain, yaw=0.0, steps=150, **arguments):
    """Observation by name and info of a vehicle that stands with locked belts."""
    reference = {"kind": "straight", "speed": 0.0, "yaw": yaw}
    env = make(
        **{**CALM, "reference": reference, "plant_options": {"terrain": terrain}, **arguments}
    )
    options = {**STANDING, **ROUGH}
    observations, _, info = run(env, steps, np.zeros((steps, 2)), options=options)
    return env.layout.unpack(observations[-1]), info


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "arguments",
    [
        {},
        *({"uncertainty": name} for name in SETS[2:]),
        {"drive": "torque", "plant_options": {"terrain": "crossing"}},
        {"vehicle": "strawa", "drive": "torque", "sensors": "rtk", "error_limit": 5.0},
        {"plant_options": {"load": "uniform", "soil_at": "patches"}},
        {"observation": ["tangent_error", "attitude"], "patches": [8, 2], "expose_truth": True},
    ],
    ids=str,
)
def test_both_environment_checkers_pass_without_a_warning(arguments):
    check_env(make(duration=2.0, **arguments), skip_render_check=True)
    sb3_check_env(make(duration=2.0, **arguments), skip_render_check=True)


def test_the_observation_is_that_of_speed_v0_with_attitude_and_tangent_error():
    layout = make().layout
    assert layout.groups == (*obs.V0.groups, "attitude", "tangent_error")
    assert layout.names[: obs.SIZE] == obs.NAMES


@pytest.mark.parametrize("arguments", [{}, {"drive": "torque", "uncertainty": ["hills", "slope"]}])
def test_rows_threads_and_single_environments_agree_to_the_bit(arguments):
    hard = {**TERRAIN, **arguments, "duration": 1.0, "error_limit": 0.5, "expose_truth": True}
    count, mode = 20, AutoresetMode.SAME_STEP
    threaded = TrackedVehicleVectorEnv(count, **hard, autoreset_mode=mode, threads=3)
    plain = TrackedVehicleVectorEnv(count, **hard, autoreset_mode=mode, threads=1)
    single = TrackedVehicleEnv(**hard)
    first, _ = threaded.reset(seed=5)
    assert_same(first, plain.reset(seed=5)[0])
    assert_same(first[7], single.reset(seed=12)[0])
    alive, ends = True, 0
    for actions in wild_actions(80, count):
        one, other = threaded.step(actions), plain.step(actions)
        for left, right in zip(one[:4], other[:4], strict=True):
            assert_same(left, right)
        for name in ENDINGS:
            np.testing.assert_array_equal(one[4][name], other[4][name])
        ends += int((one[2] | one[3]).sum())
        if alive:
            seen, reward, terminated, truncated, info = single.step(actions[7])
            alive = not (terminated or truncated)
            if alive:
                assert_same(seen, one[0][7])
                assert reward == one[1][7]
                assert all(info[name] == one[4][name][7] for name in ENDINGS)
    assert ends > 0


def test_an_episode_with_options_is_drawn_on_the_same_ground_as_without():
    plain, given = make(uncertainty="soft-patches"), make(uncertainty="soft-patches")
    seen, _ = plain.reset(seed=4)
    other, _ = given.reset(seed=4, options={"start": {}, "vehicle": {"drive_time_constant": 0.0}})
    assert_same(seen, other)
    one, two = (env.simulation.episodes[0].relief for env in (plain, given))
    assert one == two and len(one) == 34 and any(one)


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
    flat = gymnasium.make("tracked_env/Speed-v0", uncertainty="hills", expose_truth=True)
    hilly = make(uncertainty="hills", expose_truth=True)
    one, other = (env.reset(seed=3)[1]["truth"] for env in (flat, hilly))
    assert one["mass"] == other["mass"] and one["friction_angle"] == other["friction_angle"]
    assert one["z"] == 0.0 != other["z"]


def test_the_error_is_that_of_the_vehicles_plane_with_the_yaw_in_it_once():
    env = make(**{**CALM, "plant_options": {"terrain": {"kind": "plane", "slope_y": 0.4}}})
    start = {"offset_x": -0.5, "offset_y": 0.3, "offset_yaw": 0.6, "speed": 0.0}
    seen, info = env.reset(seed=0, options={"start": start, **ROUGH})
    truth = info["truth"]
    attitude = quaternion_of(truth["yaw"], truth["pitch"], truth["roll"])
    axes = np.array(matrix_of(attitude)).reshape(3, 3)
    reference = env.simulation.reference_position(0)
    world = np.array([*(reference - [truth["x"], truth["y"]]), 0.0])
    expected = axes.T @ world
    turn = axes[2, 2] * -0.6
    distance, heading = info["tracking_error"]
    assert distance == pytest.approx(np.hypot(*expected[:2]), rel=1e-12)
    assert heading == pytest.approx(turn, rel=1e-12)
    known = env.layout.unpack(seen)
    assert known["tangent_error_x"] == pytest.approx(expected[0], rel=1e-6)
    assert known["tangent_error_y"] == pytest.approx(expected[1], rel=1e-6)
    assert known["tangent_heading_error"] == pytest.approx(turn, rel=1e-6)
    assert known["position_error_x"] == pytest.approx(
        np.hypot(0.5, 0.3) * np.cos(np.arctan2(-0.3, 0.5) - 0.6), rel=1e-5
    )  # horizontal, as everywhere


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.0])
def test_a_vehicle_that_stands_on_a_slope_feels_gravity_and_nothing_else(yaw):
    seen, info = parked({"kind": "plane", "slope_x": GRADE}, yaw)
    force = np.array([seen["acceleration_x"], seen["acceleration_y"], seen["specific_force_z"]])
    assert np.linalg.norm(force) == pytest.approx(GRAVITY, rel=1e-4)
    truth = info["truth"]
    axes = np.array(matrix_of(quaternion_of(truth["yaw"], truth["pitch"], truth["roll"])))
    np.testing.assert_allclose(force, GRAVITY * axes.reshape(3, 3)[2], atol=2e-3)
    along = GRAVITY * GRADE / np.hypot(1.0, GRADE)  # up the slope
    assert force[:2] @ [np.cos(yaw), -np.sin(yaw)] == pytest.approx(along, rel=0.05)
    assert abs(seen["roll_rate"]) + abs(seen["pitch_rate"]) < 1e-3


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
    seen, _ = parked("flat")
    assert seen["specific_force_z"] == pytest.approx(GRAVITY, rel=1e-5)
    assert abs(seen["acceleration_x"]) + abs(seen["acceleration_y"]) < 1e-5


def test_gyros_measure_body_rates_and_attitude_errs_as_the_yaw_does():
    arguments = {**TERRAIN, "sensors": "rtk", "expose_truth": True, "error_limit": 1e3}
    env = TrackedVehicleVectorEnv(64, **arguments)
    env.reset(seed=2)
    errors = []
    for _ in range(60):
        seen, _, _, _, info = env.step(np.tile(np.float32([0.3, 0.4]), (64, 1)))
        known = env.layout.unpack(seen)
        errors.append([known[n] - info["truth"][n] for n in ("roll", "pitch", "roll_rate")])
    spread = np.std(errors, axis=0)
    assert spread[:2].mean() == pytest.approx(np.radians(0.3), rel=0.1)
    assert spread[2].mean() == pytest.approx(0.002, rel=0.1)
    bias = np.mean(errors, axis=0)[2]
    assert np.abs(np.abs(bias) - 0.001).max() < 4 * 0.002 / np.sqrt(60)


@pytest.mark.parametrize(
    "options, says",
    [
        ({"tilt_limit": 90.0}, "tilt_limit = 90.0 rad; must be .* Did you pass degrees"),
        ({"terrain": "moon"}, "unknown terrain kind 'moon'"),
        ({"terrain": {"kind": "plane", "slope_x": np.nan}}, "slope_x = nan; must be"),
    ],
)
def test_wrong_options_of_the_terrain_are_one_line(options, says):
    with pytest.raises(ValueError, match=says) as caught:
        make(plant_options=options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_bit_for_bit_and_draws_its_own_ground(copied):
    env = make(render_mode="rgb_array", duration=2.0)
    env.reset(seed=1)
    actions = np.random.default_rng(0).uniform(-0.2, 0.8, (60, 2)).astype(np.float32)
    for action in actions[:20]:
        env.step(action)
    first = env.render()
    other = copied(env)
    for action in actions[20:40]:
        one, two = env.step(action), other.step(action)
        assert_same(one[0], two[0])
        assert one[1:4] == two[1:4]
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
