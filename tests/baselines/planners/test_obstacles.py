"""Obstacles: exact distances, swept motions, bad input; routes and plans around them."""

import math
import time

import numpy as np
import pytest

from baselines.planners.hybrid_a_star import Motions
from baselines.planners.legs import end_of
from baselines.planners.motion_planning import plan
from baselines.planners.obstacles import (
    Footprint,
    Obstacles,
    Scene,
    clearance_along,
    clearances,
    place_clearance,
    vehicle_clearance,
)
from baselines.planners.route import Search, find_route
from baselines.planners.speed_along_path import moved, places
from baselines.planners.trajectory import Limits
from baselines.slip.slip_sweep import identified_slip, identified_slope_slip
from tests.baselines.planners.planner_cases import (
    bar,
    cells_of,
    end_of_plan,
    least_distance,
    missed,
    poses_of,
    random_scene,
    refused,
)
from tracked_env.physics.parameters import VEHICLES

FOCCHI = VEHICLES["focchi"]
FOOTPRINT = Footprint.of(FOCCHI)
WALL = [(1.5, -2.0), (1.7, -2.0), (1.7, 1.5), (1.5, 1.5)]
BEHIND = (3.5, 0.0, 0.0)
FIXED = Limits(sprocket_speed=10.0, v_min=0.4, v_max=0.4)
BOX = [
    [(2, -1), (5, -1), (5, -0.9), (2, -0.9)],
    [(2, 1), (5, 1), (5, 1.1), (2, 1.1)],
    [(2, -1), (2.1, -1), (2.1, 1.1), (2, 1.1)],
    [(4.9, -1), (5, -1), (5, 1.1), (4.9, 1.1)],
]


def around(obstacles, footprint=FOOTPRINT, margin=0.05, low=(-4, -4), high=(8, 6)):
    """Obstacles for a vehicle."""
    return Scene.of(obstacles.capsules(), footprint, margin, np.array(low), np.array(high))


def searched(obstacles, goal, radius=0.4, gears=1, spot=False, room=None):
    """A route from the origin."""
    motions = Motions(radius, gears, spot, 0.3)
    search = Search(obstacles.capsules(), FOOTPRINT, 0.05, motions, room, 5.0)
    return find_route(np.zeros(3), np.array(goal, dtype=float), search)


def test_places_are_as_far_from_circles_and_edges_as_they_are():
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    obstacles = Obstacles.of(circles=[(4.0, 0.5, 0.3)], polygons=[square])
    points = [(-1.0, 0.5), (0.9, 0.5), (1.5, 1.5), (3.0, 0.5), (4.0, 0.5)]
    distance = [place_clearance(around(obstacles), *point) for point in points]
    cap = 2.0 * FOOTPRINT.radius + 0.05
    assert distance == pytest.approx([1.0, 0.1, math.hypot(0.5, 0.5), 0.7, -0.3])
    assert place_clearance(around(obstacles), -3.0, 0.5) == cap
    inside = [obstacles.contain(*point) for point in points]
    assert inside == [False, True, False, False, True]


@pytest.mark.parametrize("low", [(-4, -4), (20, 20)], ids=["in buckets", "outside of them"])
def test_the_clearance_of_a_vehicle_is_that_of_separating_axes(low):
    rng = np.random.default_rng(1)
    box = Footprint(0.6, 0.2, 0.3, 0.4)  # not symmetric
    circles = np.column_stack([rng.uniform(-2, 4, (6, 2)), rng.uniform(0.01, 0.4, 6)])
    bars = [bar(*rng.uniform(-2, 4, 3), *rng.uniform(0.001, 2, 2)) for _ in range(6)]
    occupied = rng.random((20, 20)) < 0.05
    squares = cells_of(occupied, 0.2, (-1.0, 0.5, 0.7))
    obstacles = Obstacles.of(circles, bars, occupied, 0.2, (-1.0, 0.5, 0.7))
    scene = around(obstacles, box, 0.1, low, np.add(low, 10))
    looked_at = 0
    for pose in rng.uniform((-3, -3, -4), (5, 5, 4), (400, 3)):
        exact = least_distance(pose[None], box, circles, [*bars, *squares])
        if exact > 0.0:
            expected = min(exact - 0.1, box.radius)
            assert vehicle_clearance(scene, *pose) == pytest.approx(expected, abs=1e-9)
            looked_at += 1
        else:
            assert vehicle_clearance(scene, *pose) <= -0.1 or obstacles.contain(*pose[:2])
    assert looked_at > 80


def test_nothing_is_thin_enough_to_be_driven_through():
    rng = np.random.default_rng(2)
    blocked = 0
    for _ in range(300):
        wall = bar(*rng.uniform(-2, 2, 2), rng.uniform(0, 3), rng.uniform(0.001, 1.0), 1e-6)
        scene, pose = around(Obstacles.of(polygons=[wall])), rng.uniform(-2, 2, 3)
        way, turn = rng.choice([-1, 0, 1]) * rng.uniform(0, 4), rng.uniform(-3, 3)
        free = clearance_along(scene, *pose, way, turn) >= 0.0
        shares = np.linspace(0.0, 1.0, 4000)
        poses = np.array([moved(*pose, way * share, turn * share) for share in shares[::8]])
        exact = least_distance(poses, FOOTPRINT, convex=[wall])
        assert not free or exact > 0.05
        assert free or exact < 0.05 + 0.012  # as far as poses of the oracle are apart
        blocked += not free
    assert 30 < blocked < 270


def test_a_route_goes_around_a_wall_and_ends_at_the_goal():
    obstacles = Obstacles.of(polygons=[WALL])
    route = searched(obstacles, BEHIND)
    path = route.path()
    at = places(path, np.linspace(0.0, path.whole_length, 2000))
    poses = np.stack([at.x, at.y, at.yaw], axis=1)
    assert missed(poses[-1], BEHIND) < 1e-9
    assert clearances(around(obstacles), poses).min() > 0.0
    assert path.largest_curvature <= 1.0 / 0.4 + 1e-9
    # over a corner of the wall: the way of a thread around a disc of the vehicle's half width
    shortest = min(math.hypot(1.6, edge) + math.hypot(1.9, edge) for edge in (1.5, 2.0))
    assert shortest < path.whole_length < 1.7 * shortest


@pytest.mark.parametrize("gear", [1, -1])
def test_a_route_in_one_gear_keeps_it(gear):
    route = searched(Obstacles.of(polygons=[WALL]), BEHIND, gears=gear)
    assert np.all(np.sign(route.pieces[:, 0]) == gear)
    pose = (0.0, 0.0, 0.0)
    for piece in route.pieces:
        pose = moved(*pose, *piece)
    assert missed(np.array(pose), BEHIND) < 1e-9


@pytest.mark.parametrize(
    ("method", "limits"),
    [
        *(("optimal", FIXED), ("optimal", Limits.of(FOCCHI, sprocket_acceleration=20.0))),
        *(("dubins", FIXED), ("clothoid", Limits.of(FOCCHI, v_min=0.0))),
    ],
)
def test_a_goal_behind_a_wall_is_reached_around_it(method, limits):
    obstacles = Obstacles.of(circles=[(2.8, 1.5, 0.4)], polygons=[WALL])
    motion = plan((0, 0, 0), BEHIND, limits, method=method, obstacles=obstacles)
    assert motion.converged
    assert missed(end_of_plan(motion), BEHIND) < 1e-6
    shapes = {"circles": [(2.8, 1.5, 0.4)], "convex": [WALL]}
    assert least_distance(poses_of(motion), FOOTPRINT, **shapes) > 0.05
    straight_on = plan((0, 0, 0), BEHIND, limits, method=method)
    assert least_distance(poses_of(straight_on), FOOTPRINT, **shapes) == 0.0
    assert np.all(np.diff(motion.time) > 0.0)
    assert np.abs(np.diff(motion.yaw)).max() < 0.2


def test_a_free_goal_is_reached_by_the_plan_without_obstacles():
    obstacles = Obstacles.of(circles=[(0.0, 3.0, 0.4)])
    motion = plan((0, 0, 0), BEHIND, FIXED, obstacles=obstacles)
    assert motion.duration == plan((0, 0, 0), BEHIND, FIXED).duration


def test_a_goal_in_a_closed_box_is_not_reached_and_says_so():
    motion = plan((0, 0, 0), BEHIND, FIXED, obstacles=Obstacles.of(polygons=BOX))
    assert not motion.converged
    texts = "no way around", "searched x -6 to 9.5 m", "forwards only", "margin 0.05 m"
    for text in (*texts, "areas that the vehicle cannot go between"):
        assert text in motion.message


def test_a_hopeless_search_ends_within_its_time_and_says_what_was_searched():
    """The goal is in a corridor in which the vehicle cannot turn round."""
    sides = [bar(3, y, 0, 6, 0.05) for y in (-0.45, 0.45)]
    task = {"obstacles": Obstacles.of(polygons=[*sides, bar(6, 0, np.pi / 2, 1.2, 0.05)])}
    task |= {"reverse": True, "room": 2.0}
    plan((0, 0, 0), (3, 0, np.pi), Limits.of(FOCCHI), time_limit=0.01, **task)  # compiles
    begun = time.perf_counter()
    motion = plan((3, 0, 0), (3, 0, np.pi), Limits.of(FOCCHI), time_limit=0.5, **task)
    assert time.perf_counter() - begun < 1.5
    assert not motion.converged
    assert "forwards and in reverse, without turns on the spot" in motion.message
    assert "searched x 1 to 5 m, y -2 to 2 m" in motion.message


def test_a_chain_passes_its_way_points_and_goes_on_in_motion():
    points = np.array([(1.0, 1.0, 1.0), (0.0, 2.0, 3.0), (-2.0, 0.0, -1.0)])
    limits = Limits.of(FOCCHI, sprocket_acceleration=20.0)
    motion = plan((0, 0, 0), points[-1], limits, via=points[:-1])
    assert motion.converged
    for point in points:
        assert min(missed(pose, point) for pose in poses_of(motion)) < 1e-6
    assert np.abs(np.diff(motion.sprocket_left)).max() < 20.0 * np.diff(motion.time).max() * 40
    end = end_of(motion)
    assert (end.x, end.y, end.yaw) == (motion.x[-1], motion.y[-1], motion.yaw[-1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"circles": [(0, 0, -1.0)]}, "circle radius = -1.0"),
        ({"polygons": [[(0, 0), (1, 1)]]}, "has no area"),
        ({"polygons": [[(0, 0), (1, math.nan), (2, 2)]]}, "polygon y = nan"),
        ({"occupied": np.ones((3, 3))}, "Did you pass probabilities"),
        ({"occupied": np.ones((3, 3), dtype=bool), "cell": 0.0}, "cell = 0.0"),
        ({"origin": (math.nan, 0.0)}, "origin x = nan"),
        ({"origin": (0.0, 0.0, math.inf)}, "origin yaw = inf"),
        ({"origin": (0.0,)}, "origin has shape"),
        ({"origin": 3.0}, "origin has shape"),
        ({"polygons": [[(0, 0), (1, 1), (1, 0), (0, 1)]]}, "polygon crosses itself"),
        ({"polygons": [[(0, 0), (1, 1), (2, 2)]]}, "has no area"),
        ({"polygons": [[(0, 0), (1, 0), (1, 0), (0, 0)]]}, "has no area"),
        ({"polygons": [[(0, 0), (1e9, 0), (1, 1)]]}, "polygon x = 1000000000.0 m"),
        ({"polygons": [["a", "b"]]}, "must be numbers x, y"),
        ({"circles": [(0, 0, 1, 2)]}, r"circle has shape \(1, 4\)"),
        ({"circles": "here"}, "circle = 'here'"),
        ({"circles": [(0, math.nan, 1)]}, "circle y = nan"),
        ({"occupied": np.broadcast_to(True, (20_000, 20_000))}, "cells of the map = 400000000"),
    ],
)
def test_bad_obstacles_are_refused_in_one_line(options, message):
    refused(lambda: Obstacles.of(**options), message)


def test_a_ring_may_be_closed_and_may_be_an_l():
    corners = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    (ring,) = Obstacles.of(polygons=[[*corners, corners[0]]]).polygons
    assert sorted(map(tuple, ring)) == sorted(corners)


def test_noise_in_a_map_is_refused_before_it_takes_the_memory():
    noise = np.random.default_rng(0).random((2200, 2200)) < 0.5
    refused(Obstacles.of(occupied=noise, cell=0.01).capsules, "edges of the obstacles = ")


POLYGON = Obstacles.of(polygons=[WALL])
CELLS = Obstacles.of(occupied=np.ones((350, 20), bool), cell=0.01, origin=(1.505, -1.995))
HOUSE = Obstacles.of(polygons=[bar(0, 0, 0, 9, 9)])


@pytest.mark.parametrize(
    ("obstacles", "start", "goal", "message"),
    [
        *((each, (1.6, 0, 0), BEHIND, "the vehicle at its start") for each in (POLYGON, CELLS)),
        *((each, (0, 0, 0), (1.6, 0, 0), "vehicle at its goal") for each in (POLYGON, CELLS)),
        *((each, (0, 0, 0), (1.1, 0, 0), "at its goal is 0.05 m") for each in (POLYGON, CELLS)),
        (HOUSE, (0, 0, 0), (30, 0, 0), "at its start is in an obstacle"),
    ],
)
def test_a_start_or_goal_in_an_obstacle_or_its_margin_is_refused(obstacles, start, goal, message):
    refused(lambda: plan(start, goal, FIXED, obstacles=obstacles), message)


STRAWA = VEHICLES["strawa"]
MARGIN = 0.05
RESTING = Limits.of(FOCCHI, reserve=0.1, sprocket_acceleration=20.0)
SPOT = Limits.of(FOCCHI, v_min=0.0, reserve=0.1)
FAST = Limits.of(STRAWA, v_min=0.5, v_max=2.0)
SLIP = {"slip_model": identified_slip(FOCCHI)}
# Name, vehicle, limits, arguments, share of the scenes below that must get a plan.
CASES = [
    ("dubins", FOCCHI, Limits.of(FOCCHI, v_min=0.4, v_max=0.4), {"method": "dubins"}, 0.75),
    ("reeds-shepp", FOCCHI, Limits.of(FOCCHI), {"method": "reeds-shepp"}, 0.9),
    ("clothoid", FOCCHI, Limits.of(FOCCHI, v_min=0.0), {"method": "clothoid"}, 0.75),
    ("fixed", FOCCHI, Limits.of(FOCCHI, v_min=0.4, v_max=0.4, reserve=0.1), SLIP, 0.7),
    ("to rest", FOCCHI, RESTING, SLIP, 0.7),
    ("both gears", FOCCHI, RESTING, {**SLIP, "reverse": True}, 0.9),
    ("on the spot", FOCCHI, SPOT, SLIP, 0.9),
    ("large", STRAWA, FAST, {"method": "dubins"}, 0.75),
    ("large, both gears", STRAWA, FAST._replace(v_min=0.2), {"reverse": True}, 0.9),
]


def motion_is_free(arguments, scene, box, margin=MARGIN):
    """The plan, its motion sampled every 4 ms, and that this keeps the margin all along."""
    motion = plan(**arguments)
    if motion.converged:
        fine = plan(**{**arguments, "period": 0.004, "time_limit": 60.0})
        assert fine.converged
        for poses in (poses_of(motion), poses_of(fine)):
            assert least_distance(poses, box, scene[0], scene[1]) > margin
        goal = np.asarray(arguments["goal"], dtype=float)
        assert math.hypot(motion.x[-1] - goal[0], motion.y[-1] - goal[1]) < 1e-3
        assert abs(math.remainder(motion.yaw[-1] - goal[2], 2.0 * math.pi)) < 0.3
    return motion


def random_scenes_are_free(case, seeds):
    """Share of scenes with a plan."""
    _, vehicle, limits, more, _ = case
    box = Footprint.of(vehicle)
    size, converged = 5.0 * box.radius, 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        goal = np.array([*rng.uniform(-1.2, 1.2, 2) * size, rng.uniform(-3, 3)])
        scene = random_scene(rng, box, (0, 0, 0), goal, size, MARGIN)
        task = {"start": (0, 0, 0), "goal": goal, "limits": limits, "vehicle": vehicle, **more}
        task |= {"period": rng.choice([0.02, 0.3, 10.0]), "time_limit": 1.0}
        converged += motion_is_free({**task, "obstacles": scene.obstacles}, scene, box).converged
    return converged / len(seeds)


@pytest.mark.parametrize("case", CASES, ids=[case[0] for case in CASES])
@pytest.mark.parametrize(
    "seeds", [range(2000, 2004), pytest.param(range(3000, 3060), marks=pytest.mark.slow)]
)
def test_no_plan_of_any_kind_touches_anything(case, seeds):
    assert random_scenes_are_free(case, seeds) >= (case[-1] if len(seeds) > 10 else 0.41)


TRAP = [bar(1.5, 0, np.pi / 2, 3, 0.1), bar(0.5, 1.5, 0, 2, 0.1), bar(0.5, -1.5, 0, 2, 0.1)]
GARAGE = [bar(0.1, 0.75, 0, 1.4, 0.1), bar(0.1, -0.75, 0, 1.4, 0.1), bar(0.75, 0, 1.5708, 1.6, 0.1)]
BEND = [
    bar(2, 0.6, 0, 4, 0.05),
    bar(2.5, -0.6, 0, 5, 0.05),
    bar(5.05, 1.2, np.pi / 2, 3.6, 0.05),
    bar(4.0, 2, np.pi / 2, 2.75, 0.05),
]
PARKED = [bar(1.0, -0.95, 0, 0.8, 0.7), bar(3.2, -0.95, 0, 0.8, 0.7), bar(2, -1.55, 0, 5, 0.1)]
LONG = {"vehicle": STRAWA, "limits": Limits.of(STRAWA, v_min=0.5, v_max=3.0)}
TOUCHING = [bar(2, y, np.pi / 2, 1, 0.1) for y in (-1.0, 0.0, 1.0)]
SCENES = {  # goal, walls, options of the plan
    "a wall of 4 m before a goal at 12 m": ((12, 0, 0), [bar(6, 0, np.pi / 2, 4, 0.2)], {}),
    "a wall of 8 m": ((12, 0, 0), [bar(6, 0, np.pi / 2, 8, 0.2)], {}),
    "out of a garage in reverse": ((3, 0, 0), GARAGE, {"reverse": True}),
    "out of a garage, turning in it": ((3, 0, 0), GARAGE, {"limits": SPOT}),
    "out of a garage, Reeds-Shepp": ((3, 0, 0), GARAGE, {"method": "reeds-shepp"}),
    "out of a trap": ((4, 0, 0), TRAP, {"reverse": True}),
    "a corridor with a bend": ((4.5, 3.5, np.pi / 2), BEND, {}),
    "a thin wall behind": ((-3, 0, 0), [bar(-1.5, 0, np.pi / 2, 2, 1e-4)], {}),
    "parallel parking": ((2.1, -0.95, 0), PARKED, {"reverse": True, "start": (2.1, 0.4, 0)}),
    "200 m": ((200, 0, 0), [bar(100, 0, np.pi / 2, 20, 0.1)], LONG),
    "touching walls": ((4, 0, 0), TOUCHING, {}),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_way_that_exists_is_taken(name):
    goal, walls, more = SCENES[name]
    task = {"start": (0, 0, 0), "goal": goal, "limits": RESTING, "vehicle": FOCCHI, **more}
    obstacles, box = Obstacles.of(polygons=walls), Footprint.of(task["vehicle"])
    motion = motion_is_free({**task, "obstacles": obstacles}, ((), walls), box)
    assert motion.converged, motion.message


def test_a_bulldozer_goes_round_cells_of_5_cm_in_a_turned_map_with_its_own_footprint():
    rng = np.random.default_rng(3)
    occupied = rng.random((800, 800)) < 4e-5
    origin, box = (-12.0, -20.0, 0.3), (3.5, 2.0, 1.6, 1.6)
    squares = cells_of(occupied, 0.05, origin)
    goal = (14.0, 3.0, 0.5)
    near = least_distance(np.array([(0, 0, 0), goal], dtype=float), box, convex=squares)
    assert near > 0.3
    obstacles = Obstacles.of(occupied=occupied, cell=0.05, origin=origin)
    task = {"start": (0, 0, 0), "goal": goal, "limits": FAST, "vehicle": STRAWA, "period": 1.0}
    task |= {"obstacles": obstacles, "footprint": box, "margin": 0.2, "method": "reeds-shepp"}
    motion = motion_is_free(task, ((), squares), box, 0.2)
    assert motion.converged, motion.message


@pytest.mark.slow
def test_plans_on_a_slope_keep_their_margin():
    slip = identified_slope_slip(FOCCHI, speed_step=2.5, slope_step=0.21875)
    wall = bar(1.5, -0.5, np.pi / 2, 2.0, 0.1)
    task = {"start": (0, 0, 0), "goal": (3, 0, 0), "limits": Limits.of(FOCCHI, reserve=0.1)}
    task |= {"slip_model": slip, "ground": (0.1, 0.05), "obstacles": Obstacles.of(polygons=[wall])}
    motion = motion_is_free(task, ((), [wall]), FOOTPRINT)
    assert motion.converged, motion.message


def test_samples_far_apart_are_of_the_same_motion():
    wall = bar(1.6, -0.25, np.pi / 2, 3.5, 0.2)
    task = {"obstacles": Obstacles.of(polygons=[wall]), "method": "dubins"}
    coarse = plan((0, 0, 0), (3.5, 0, 0), RESTING, period=10.0, **task)
    fine = plan((0, 0, 0), (3.5, 0, 0), RESTING, period=0.02, **task)
    assert len(coarse.time) == 2 + int(coarse.duration / 10.0)
    assert coarse.duration == pytest.approx(fine.duration)
    for column in ("x", "y", "yaw"):
        at = np.interp(coarse.time, fine.time, getattr(fine, column))
        assert getattr(coarse, column) == pytest.approx(at, abs=1e-6)
