"""No plan touches an obstacle: the vehicle's rectangle against the obstacles, by exact distances.

The distances here are those of a rectangle from circles and segments, in the frame of the vehicle,
without any map; the plans are sampled far finer than the planner checks them.
"""

import itertools
import math

import numpy as np
import pytest

from baselines.planners.chain import RouteSearch
from baselines.planners.obstacles import Obstacles
from baselines.planners.plan import plan
from baselines.planners.trajectory import Limits
from tests.baselines.planners.pairs import missed
from tracked_env.physics.parameters import VEHICLES

FOCCHI = VEHICLES["focchi"]
BRAKING = Limits.of(FOCCHI, sprocket_acceleration=20.0)
PIVOTING = BRAKING._replace(v_min=0.0)
FIXED = Limits(sprocket_speed=10.0, v_min=0.4, v_max=0.4)


def box(x, y, x_end, y_end):
    return [(x, y), (x_end, y), (x_end, y_end), (x, y_end)]


def poses_of(made, step=0.005):
    """Poses (M, 3) between the samples of a trajectory, in steps of 5 mm and 5 mrad."""
    rows = np.stack([made.x, made.y, made.yaw], axis=1)
    parts = np.ceil(np.abs(np.diff(rows, axis=0)).max(axis=1) / step).astype(int) + 1
    pieces = [np.linspace(a, b, n) for a, b, n in zip(rows[:-1], rows[1:], parts, strict=True)]
    return np.vstack(pieces)


def rectangle_distance(points, vehicle):
    """Distance [m] of points (..., 2) of the vehicle's frame from its rectangle."""
    half = 0.5 * np.array([vehicle.contact_length, vehicle.track_gauge + vehicle.track_width])
    return np.hypot(*np.moveaxis(np.maximum(np.abs(points) - half, 0.0), -1, 0))


def least_distance(made, vehicle, circles=(), polygons=()):
    """Least distance [m] between the vehicle and obstacles; polygons by points each 5 mm."""
    x, y, yaw = poses_of(made).T
    points, radii = [], []
    for cx, cy, radius in circles:
        points.append([(cx, cy)])
        radii.append([radius])
    for polygon in polygons:
        edges = zip(polygon, np.roll(polygon, -1, axis=0), strict=True)
        dots = np.vstack([
            np.linspace(a, b, 2 + int(math.dist(a, b) / 0.005)) for a, b in edges
        ])  # fmt: skip
        points.append(dots)
        radii.append(np.zeros(len(dots)))
    least = math.inf
    for group, radius in zip(points, radii, strict=True):
        for (px, py), r in zip(np.asarray(group), radius, strict=True):
            near = np.hypot(px - x, py - y) < r + 2.0 * vehicle.contact_length
            dx, dy, c, s = (px - x)[near], (py - y)[near], np.cos(yaw)[near], np.sin(yaw)[near]
            body = np.stack([c * dx + s * dy, c * dy - s * dx], axis=1)
            away = rectangle_distance(body, vehicle) - r
            least = min(least, float(np.min(away, initial=math.inf)))
    return least


@pytest.mark.parametrize("name", ["focchi", "strawa"])
def test_plans_of_random_scenes_touch_nothing_wherever_they_lead(name):
    """Circles of every size, near and far from start and goal: plans leave the box around both."""
    vehicle, rng, reached = VEHICLES[name], np.random.default_rng(7), 0
    size = vehicle.contact_length
    limits = Limits.of(vehicle, **({} if name == "focchi" else {"v_min": 0.5, "v_max": 2.0}))
    methods = itertools.cycle(["dubins", "clothoid", "reeds-shepp", "optimal"])
    for method in itertools.islice(methods, 40):
        goal = (*rng.uniform(-6.0, 6.0, 2) * size, rng.uniform(-3.1, 3.1))
        middle, radius = rng.uniform(-10.0, 10.0, (25, 2)) * size, rng.uniform(0.01, 0.6, 25) * size
        clear = [
            min(np.hypot(*(middle[k])), np.hypot(*(middle[k] - goal[:2]))) > radius[k] + 1.6 * size
            for k in range(25)
        ]
        circles = np.column_stack([middle, radius])[clear]
        search = RouteSearch(time_limit=1.0)
        obstacles = Obstacles.of(circles=circles)
        made = plan(
            (0, 0, 0), goal, limits, method=method, vehicle=vehicle, obstacles=obstacles,
            search=search,
        )  # fmt: skip
        if made.converged:
            reached += 1
            assert missed(np.array([made.x[-1], made.y[-1], made.yaw[-1]]), goal) < 1e-6
            assert least_distance(made, vehicle, circles) > 0.0, (method, goal)
    assert reached >= 30


@pytest.mark.parametrize("method", ["dubins", "clothoid", "optimal"])
def test_the_way_does_not_depend_on_the_time_between_samples(method):
    wall = box(1.5, -2.0, 1.7, 1.5)
    options = {"method": method, "obstacles": Obstacles.of(polygons=[wall])}
    fine = plan((0, 0, 0), (3.5, 0, 0), FIXED, **options)
    coarse = plan((0, 0, 0), (3.5, 0, 0), FIXED, period=10.0, **options)
    assert fine.converged and coarse.converged
    assert coarse.duration == pytest.approx(fine.duration, abs=1e-9)
    assert len(coarse.time) < 0.2 * len(fine.time)
    assert least_distance(fine, FOCCHI, polygons=[wall]) > 0.0


def test_an_obstacle_thinner_than_the_map_is_not_driven_through():
    wire = box(1.6, -1.0, 1.601, 1.0)
    made = plan((0, 0, 0), (3.5, 0, 0), BRAKING, obstacles=Obstacles.of(polygons=[wire]))
    assert made.converged and least_distance(made, FOCCHI, polygons=[wire]) > 0.0


GARAGE = [box(-1.2, -0.8, 0.8, -0.7), box(-1.2, 0.7, 0.8, 0.8), box(0.7, -0.8, 0.8, 0.8)]
CORRIDOR = [
    box(-1.0, -0.65, 3.0, -0.55), box(-1.0, 0.55, 1.9, 0.65), box(3.0, -0.65, 3.1, 4.0),
    box(1.8, 0.55, 1.9, 4.0),
]  # fmt: skip
CARS = [box(-2.0, -0.4, -0.9, 0.4), box(0.9, -0.4, 2.0, 0.4), box(-2.0, -0.7, 2.0, -0.6)]
NICHE = [box(-0.6, -0.9, 0.6, -0.8), box(-0.7, -0.9, -0.6, 2.0), box(0.6, -0.9, 0.7, 2.0)]


@pytest.mark.parametrize(
    ("polygons", "start", "goal", "limits", "options"),
    [
        ([box(5.9, -2.0, 6.1, 2.0)], (0, 0, 0), (12, 0, 0), BRAKING, {}),
        ([box(5.9, -2.0, 6.1, 2.0)], (0, 0, 0), (12, 0, 0), FIXED, {}),
        ([box(59.0, -4.0, 59.2, 4.0)], (0, 0, 0), (120, 0, 0), FIXED, {}),
        (GARAGE, (0, 0, 0), (-3, 2, 1.5), BRAKING, {"reverse": True}),
        (GARAGE, (0, 0, 0), (-3, 2, 1.5), PIVOTING, {}),
        (GARAGE, (0, 0, 0), (-3, 2, 1.5), None, {"method": "reeds-shepp"}),
        (GARAGE, (-3, 0, math.pi), (0, 0, 0.0), BRAKING, {"reverse": True}),
        (CORRIDOR, (0, 0, 0), (2.45, 3, math.pi / 2), BRAKING, {}),
        (CORRIDOR, (0, 0, math.pi), (2.45, 3, -math.pi / 2), BRAKING, {"reverse": True}),
        (CARS, (-1.0, 1.2, 0.0), (0.0, 0.0, 0.0), BRAKING, {"reverse": True}),
        (NICHE, (0, 0, -math.pi / 2), (0, 3, math.pi / 2), PIVOTING, {"reverse": True}),
    ],
)
def test_a_way_that_exists_is_found_and_free(polygons, start, goal, limits, options):
    """Walls beyond the first room, a garage, a bend, a gap between cars, a niche to turn in."""
    made = plan(start, goal, limits, obstacles=Obstacles.of(polygons=polygons), **options)
    assert made.converged, made.message
    assert missed(np.array([made.x[-1], made.y[-1], made.yaw[-1]]), goal) < 1e-6
    assert least_distance(made, FOCCHI, polygons=polygons) > 0.0
    assert made.duration < 3.0 * (60.0 + math.dist(start, goal) / 0.4)


def test_what_was_searched_is_said_and_a_hopeless_scene_ends_in_time():
    made = plan((0, 0, 0), (-3, 2, 1.5), BRAKING, obstacles=Obstacles.of(polygons=GARAGE))
    assert not made.converged and "forwards only" in made.message and "all of it" in made.message
    closed = [*GARAGE, box(-1.3, -0.8, -1.2, 0.8)]
    search = RouteSearch(room=20.0, time_limit=0.2)
    obstacles = Obstacles.of(polygons=closed)
    made = plan((-3, 3, 0), (0, 0, 0), PIVOTING, obstacles=obstacles, search=search, reverse=True)
    assert not made.converged and "margin 0.05 m" in made.message
    assert "time limit of 0.2 s" in made.message or "all of it" in made.message


def test_margin_and_footprint_are_the_users():
    gap = [box(1.5, -3.0, 1.7, -0.6), box(1.5, 0.6, 1.7, 3.0)]  # 1.2 m wide; the vehicle 0.71 m
    obstacles, goal = Obstacles.of(polygons=gap), (3.5, 0, 0)
    assert plan((0, 0, 0), goal, FIXED, obstacles=obstacles).length == pytest.approx(3.5, abs=1e-6)
    for search in (RouteSearch(margin=0.3), RouteSearch(footprint=(0.7, 1.3))):
        made = plan((0, 0, 0), goal, FIXED, obstacles=obstacles, search=search)
        assert made.converged and made.length > 6.0  # around the end of the walls
    with pytest.raises(ValueError, match="search margin = -1"):
        plan((0, 0, 0), goal, FIXED, obstacles=obstacles, search=RouteSearch(margin=-1.0))
    with pytest.raises(TypeError, match=r"Obstacles\.of"):
        plan((0, 0, 0), goal, FIXED, obstacles=[(1.0, 0.0, 0.2)])
