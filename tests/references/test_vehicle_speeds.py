"""Speeds of references are in proportion to the top speed of the vehicle that is to drive them."""

import copy

import gymnasium
import numpy as np
import pytest

import tracked_env
from tests.driving import assert_equal
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import SETS, BenchmarkSet
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics.parameters import VEHICLES, top_speed
from tracked_env.references import (
    REFERENCES,
    batch_reference,
    make_reference,
    reference_scale,
    sample,
)
from tracked_env.references.specification import DEFAULT_VEHICLE
from tracked_env.vehicles import find_vehicle

TIMES = np.arange(0.0, 20.0, 0.05)
STRAWA, FOCCHI = VEHICLES["strawa"], VEHICLES["focchi"]
SLOW = FOCCHI._replace(sprocket_speed_limit=2.0, track_gauge=1.2)
FAST = STRAWA._replace(sprocket_speed_limit=1000.0)
ROBOT = {"mass": 60.0, "inertia": 4.0, "contact_length": 0.6, "track_gauge": 0.5}
_AS_FOCCHI = ("track_width", "sprocket_radius", "sprocket_speed_limit", "torque_limit")
_AS_FOCCHI += ("sprocket_inertia", "drive_time_constant")
ROBOT |= {name: getattr(FOCCHI, name) for name in _AS_FOCCHI}


def belts(profile, vehicle):
    """Largest speed [m/s] of a belt that does not slip."""
    at = sample(profile, TIMES)
    return (np.abs(at.speed) + 0.5 * vehicle.track_gauge * np.abs(at.yaw_rate)).max()


def reference(spec, vehicle=None, seed=0):
    changes = {"kind": spec} if isinstance(spec, str) else spec
    points = {"points": [[0.0, 0.0], [8.0, 1.0], [16.0, 0.0]]} if spec == "waypoints" else {}
    return make_reference({**changes, **points}, 20.0, np.random.default_rng(seed), vehicle)


@pytest.mark.parametrize("kind", REFERENCES)
@pytest.mark.parametrize("vehicle", [FOCCHI, SLOW, STRAWA], ids=["focchi", "slow", "strawa"])
def test_no_default_reference_is_faster_than_the_belts(kind, vehicle):
    for seed in range(8):
        assert belts(reference(kind, vehicle, seed), vehicle) <= top_speed(vehicle)


@pytest.mark.parametrize("kind", REFERENCES)
def test_references_of_the_own_vehicle_have_the_bits_they_had_without_one(kind):
    base = reference(kind, VEHICLES[DEFAULT_VEHICLE], 3)
    np.testing.assert_array_equal(base.table, reference(kind, None, 3).table)
    heavier = reference(kind, STRAWA._replace(mass=3000.0), 3)
    np.testing.assert_array_equal(heavier.table, base.table)


def test_half_the_sprocket_speed_is_half_the_speed_and_the_same_curvature():
    half = STRAWA._replace(sprocket_speed_limit=0.5 * STRAWA.sprocket_speed_limit)
    changes = {"kind": "random", "lateral_acceleration_limit": 20.0}
    whole, slow = (sample(reference(changes, vehicle), TIMES) for vehicle in (STRAWA, half))
    np.testing.assert_allclose(slow.speed, 0.5 * whole.speed, rtol=1e-12)
    np.testing.assert_allclose(slow.yaw_rate, 0.5 * whole.yaw_rate, atol=1e-12)


def test_speeds_that_are_given_stay_and_those_for_a_vehicle_do_not():
    changes = {"kind": "circle", "speed": 0.4}
    assert reference(changes, STRAWA).speed[0, 0] == 0.4
    scaled = reference({**changes, "vehicle": "focchi"}, STRAWA).speed[0, 0]
    assert scaled == pytest.approx(0.4 * top_speed(STRAWA) / top_speed(FOCCHI))
    assert reference({**changes, "vehicle": "focchi"}, FOCCHI).speed[0, 0] == 0.4
    assert np.abs(reference("random", FAST).speed[:, 0]).max() <= 5.0
    with pytest.raises(ValueError, match="Did you mean 'focchi'"):
        reference({**changes, "vehicle": "foci"}, STRAWA)


def test_the_batch_draws_from_the_same_speeds():
    for spec in ("random", tracked_env.SPEED["reference"]):
        for vehicle in (FOCCHI, SLOW, STRAWA):
            paths, _ = batch_reference(spec, vehicle)
            speeds = np.concatenate([reference(spec, vehicle, k).speed[:, 0] for k in range(30)])
            ends = [speeds.min(), speeds.max()]  # a third of the coefficients is at a limit
            np.testing.assert_allclose(ends, paths.limits[0, :2], rtol=1e-9)


DRIVES = [("lumped", "torque"), ("distributed", "torque"), ("distributed", "speed")]


@pytest.mark.parametrize("plant, drive", DRIVES)
@pytest.mark.parametrize("vehicle", ["strawa", "focchi"])
def test_full_action_drives_a_vehicle_at_its_top_speed_and_no_faster(plant, drive, vehicle):
    top = top_speed(VEHICLES[vehicle])
    reference = {"kind": "straight", "speed": min(top, 5.0)}
    options = {"expose_truth": True, "error_limit": 1e3, "control_rate": 20.0}
    options |= {"vehicle": vehicle, "plant": plant, "drive": drive}
    env = TrackedVehicleEnv(reference, "nominal", "ideal", **options)
    env.reset(seed=0, options={"start": {"speed": 0.0, "offset_yaw": 0.0}})
    for _ in range(400):
        info = env.step(np.ones(2, dtype=np.float32))[-1]
    assert 0.93 * top < info["truth"]["v_x"] <= top * (1.0 + 1e-9)


@pytest.mark.parametrize("env", [TORQUE_ID, SPEED_ID, TERRAIN_ID])
def test_a_vehicle_without_a_base_is_based_on_that_of_its_id(env):
    base = VEHICLES["strawa" if env == TORQUE_ID else "focchi"]
    changes = {"mass": 0.9 * base.mass}
    single = gymnasium.make(env, vehicle=changes).unwrapped
    for each in (single, gymnasium.make_vec(env, 2, vehicle=changes)):
        assert each.simulation.solver.nominal == base._replace(**changes)
        assert each.simulation.solver.nominal == find_vehicle(changes, each.simulation.config[-2])
    named = gymnasium.make(env, vehicle={"base": "focchi-short"}).unwrapped
    assert named.simulation.solver.nominal == VEHICLES["focchi-short"]


@pytest.mark.parametrize(
    "changes, lacking",
    [
        ({"mass": 60.0}, "inertia = 1180 kg m^2"),
        ({"contact_length": 0.7, "mass": 1400.0}, "inertia = 1180 kg m^2"),
        ({"base": "focchi", "track_gauge": 0.4}, "mass = 62 kg, inertia = 4.5 kg m^2"),
        ({n: v for n, v in ROBOT.items() if n != "inertia"}, "inertia = 1180 kg m^2. "),
    ],
)
def test_a_vehicle_of_another_size_is_told_what_it_has_of_its_base(changes, lacking):
    with pytest.warns(UserWarning, match="differs by more than 30%") as warned:
        find_vehicle(changes)
    assert lacking in str(warned[0].message)


@pytest.mark.parametrize("changes", [ROBOT, {"mass": 1800.0, "inertia": 900.0}, {"cohesion": 0.0}])
def test_a_vehicle_of_its_own_or_of_its_base_is_told_nothing(changes, recwarn):
    find_vehicle(changes)
    assert not recwarn.list


PATHS = [(SPEED_ID, {"reference": "mixed"}), (TERRAIN_ID, {"reference": "identification"})]


@pytest.mark.parametrize("env, more", [(TORQUE_ID, {}), (SPEED_ID, {}), *PATHS])
def test_no_episode_asks_a_small_robot_for_more_than_it_can_do(env, more):
    options = {"vehicle": {"base": "focchi", **ROBOT}, **more}
    single = gymnasium.make(env, **options).unwrapped
    several = gymnasium.make_vec(env, 8, **options)
    several.reset(seed=0)
    for seed in range(8):
        single.reset(seed=seed)
        profile = single.simulation.episodes[0].profile
        batch = several.simulation.episodes[seed].profile
        np.testing.assert_array_equal(profile.table, batch.table)
        assert belts(profile, find_vehicle(ROBOT)) <= 0.856


def test_a_set_of_ones_own_has_the_base_of_its_id(monkeypatch):
    arguments = {"vehicle": {"mass": 55.0}, "plant": "distributed", "drive": "speed"}
    base = BenchmarkSet("own", "nominal", env=SPEED_ID, arguments=arguments)
    monkeypatch.setitem(SETS, "own", base)
    simulated = BenchmarkConfig(sets=("own",)).environment("own", 2, truth=False)
    assert simulated.simulation.solver.nominal == FOCCHI._replace(mass=55.0)


@pytest.mark.parametrize("vehicle", [FOCCHI, SLOW, FAST], ids=["focchi", "slow", "fast"])
def test_info_says_by_what_speeds_and_lengths_are_scaled(vehicle):
    env = gymnasium.make(TORQUE_ID, vehicle=vehicle, reference="circle", duration=1.0)
    _, info = env.reset(seed=0)
    own, base = reference("circle", vehicle), reference("circle", STRAWA)
    faster = own.speed[0, 0] / base.speed[0, 0]
    longer = faster * base.yaw_rate[0, 0] / own.yaw_rate[0, 0]  # radius = speed / yaw rate
    np.testing.assert_allclose(info["reference_scale"], [faster, 1.0, longer], rtol=1e-12)
    *_, later = env.step(np.zeros(2, np.float32))
    assert later["reference_scale"] == info["reference_scale"]


def as_given(vehicle):
    return {"kind": "random", "speed_range": [0.1, 0.2], "vehicle": vehicle}


@pytest.mark.parametrize(
    ("spec", "vehicle", "expected"),
    [
        ("random", STRAWA, [1.0, 1.0, 1.0]),
        ({"kind": "circle", "speed": 0.3, "radius": 3.0}, FOCCHI, [1.0, 1.0, 1.0]),
        (as_given("strawa"), FOCCHI, [FOCCHI, STRAWA]),
        ({**as_given("focchi"), "yaw_rate_limit": 0.5}, SLOW, [SLOW, FOCCHI]),
        ("mixed", FOCCHI, [FOCCHI, STRAWA]),
        ({"kind": "plan", "goals": "halton"}, STRAWA, [2.8, 1.0, 2.8]),
        ({"kind": "plan", "goal": [1, 0, 0], "limits": {"v_max": 1}}, STRAWA, [2.8, 1.0, 1.0]),
        ({"kind": "plan", "goal": [1, 0, 0], "limits": {"v_max": 1, "v_min": 1}}, STRAWA, [1] * 3),
    ],
)
def test_the_factors_are_ratios_of_top_speeds_and_gauges_where_numbers_are_not_as_given(
    spec, vehicle, expected
):
    scale = reference_scale(spec, vehicle)
    if isinstance(expected[0], type(STRAWA)):
        one, other = expected
        ratio = top_speed(one) / top_speed(other)
        turning = min(ratio * other.track_gauge / one.track_gauge, 1.0)
        np.testing.assert_allclose(scale[:2], [ratio, turning], rtol=1e-12)
    else:
        np.testing.assert_allclose(scale, expected, rtol=0.01)


def test_a_row_whose_options_have_another_reference_has_its_own_factors_in_that_episode():
    of_focchi = {"kind": "circle", "speed": 0.3, "radius": 9.0, "vehicle": "focchi"}
    arguments = {"vehicle": STRAWA, "duration": 1.0, "reference": of_focchi}
    envs = tracked_env.make_vec(SPEED_ID, 3, **arguments)
    usual = envs.reset(seed=0)[1]["reference_scale"]
    ratio = top_speed(STRAWA) / top_speed(FOCCHI)
    np.testing.assert_allclose(usual[:, 0], ratio, rtol=1e-12)
    plain = {"reference": {"kind": "circle", "speed": 0.3, "radius": 9.0}}
    options = {"rows": [None, plain, None]}
    info = envs.reset(options=options)[1]
    assert info["reference_scale"][:, 0].tolist() == pytest.approx([ratio, 1.0, ratio])
    assert info["_reference_scale"].all()
    twin = copy.deepcopy(envs)
    step = twin.step(np.zeros((3, 2), np.float32))[4]
    assert_equal(step["reference_scale"], info["reference_scale"])
    mask = np.array([False, True, False])
    assert_equal(envs.reset(options={"reset_mask": mask})[1]["reference_scale"], usual)
    single = gymnasium.make(SPEED_ID, **arguments)
    single.reset(seed=1)
    assert single.reset(options=plain)[1]["reference_scale"][0] == 1.0
    assert single.reset()[1]["reference_scale"] == tuple(usual[0])


STRAIGHT = {"kind": "random", "yaw_rate_limit": 0.0, "vehicle": "strawa"}


@pytest.mark.parametrize("kind", ["random", "circle", "mixed", STRAIGHT], ids=str)
def test_info_has_the_factors_for_the_vehicle_that_an_episode_draws(kind):
    envs = tracked_env.make_vec(
        TORQUE_ID, 6, uncertainty="any-vehicle", reference=kind, duration=1.0
    )
    for seed in (0, 1):
        info = envs.reset(seed=seed)[1]
        nominals = [envs.unwrapped.simulation.nominal(i) for i in range(6)]
        expected = [reference_scale(kind, nominal) for nominal in nominals]
        np.testing.assert_allclose(info["reference_scale"], expected, rtol=1e-9)
    assert len({*info["reference_scale"][:, 0]}) > 1
    single = gymnasium.make(TORQUE_ID, uncertainty="any-vehicle", reference=kind, duration=1.0)
    assert single.reset(seed=1)[1]["reference_scale"] == tuple(info["reference_scale"][0])
