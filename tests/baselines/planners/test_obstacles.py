"""Clearance of obstacles in closed form, routes and plans around them."""

import math

import numpy as np
import pytest

from baselines.planners.chain import end_of
from baselines.planners.obstacles import Footprint, Obstacles, clearances
from baselines.planners.path import places
from baselines.planners.plan import plan
from baselines.planners.route import find_route
from baselines.planners.trajectory import Limits
from tests.baselines.planners.pairs import missed
from tracked_env.physics.parameters import VEHICLES

FOCCHI = VEHICLES["focchi"]
FOOTPRINT = Footprint.of(FOCCHI)
WALL = [(1.5, -2.0), (1.7, -2.0), (1.7, 1.5), (1.5, 1.5)]
BEHIND = (3.5, 0.0, 0.0)
FIXED = Limits(sprocket_speed=10.0, v_min=0.4, v_max=0.4)
BOX = [
    [(2, -1), (5, -1), (5, -0.9), (2, -0.9)], [(2, 1), (5, 1), (5, 1.1), (2, 1.1)],
    [(2, -1), (2.1, -1), (2.1, 1.1), (2, 1.1)], [(4.9, -1), (5, -1), (5, 1.1), (4.9, 1.1)],
]  # fmt: skip


def free(made, obstacles):
    """Least distance [m] between the vehicle's rectangle, without margin, and the obstacles."""
    field = obstacles.clearance((-4, -6), (8, 6), 0.02)
    along, across = np.meshgrid(np.linspace(-0.5, 0.5, 15), np.linspace(-0.5, 0.5, 15))
    ahead = along.ravel() * FOCCHI.contact_length
    aside = across.ravel() * (FOCCHI.track_gauge + FOCCHI.track_width)
    cos, sin = np.cos(made.yaw)[:, None], np.sin(made.yaw)[:, None]
    x, y = made.x[:, None] + cos * ahead - sin * aside, made.y[:, None] + sin * ahead + cos * aside
    return field.at(x, y).min()


def test_clearance_of_circles_and_polygons_is_their_distance():
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    field = Obstacles.of(circles=[(4.0, 0.5, 0.3)], polygons=[square]).clearance((-2, -2), (6, 3))
    points = [(-1.0, 0.5), (0.5, 0.5), (0.9, 0.5), (1.5, 1.5), (3.0, 0.5), (4.0, 0.5), (100.0, 0)]
    expected = [1.0, -0.5, -0.1, math.hypot(0.5, 0.5), 0.7, -0.3, math.inf]
    np.testing.assert_allclose(field.at(*np.transpose(points)), expected, atol=5e-3)


def test_cells_of_a_grid_are_as_far_as_their_edges():
    occupied = np.zeros((40, 60), dtype=bool)
    occupied[10:20, 30:40] = True  # x 2.95 to 3.95, y 0.95 to 1.95
    obstacles = Obstacles.of(occupied=occupied, cell=0.1)
    square = [(2.95, 0.95), (3.95, 0.95), (3.95, 1.95), (2.95, 1.95)]
    low, high = (-1.0, -1.0), (7.0, 5.0)
    exact = Obstacles.of(polygons=[square]).clearance(low, high).distance
    found = obstacles.clearance(low, high).distance
    inside_grid = (slice(22, 98), slice(22, 138))
    assert np.abs(found - exact)[inside_grid].max() < 0.08  # less than a cell
    assert np.all(found[:, :20] > 1.0)  # beyond the grid nothing is known to be occupied


def test_the_discs_cover_the_vehicle():
    along = np.linspace(-0.5, 0.5, 41) * FOCCHI.contact_length
    across = 0.5 * (FOCCHI.track_gauge + FOCCHI.track_width)
    away = np.hypot(along[:, None] - FOOTPRINT.offset, across).min(axis=1)
    assert np.all(away < FOOTPRINT.radius - 0.05)  # with the margin


def test_a_route_goes_around_a_wall_and_ends_at_the_goal():
    field = Obstacles.of(polygons=[WALL]).clearance((-3, -3), (6, 4))
    route = find_route((0, 0, 0), BEHIND, 0.4, field, FOOTPRINT)
    assert route.path is not None
    at = places(route.path, np.linspace(0.0, route.path.whole_length, 2000))
    assert missed(np.array([at.x[-1], at.y[-1], at.yaw[-1]]), BEHIND) < 1e-9
    assert clearances(field, FOOTPRINT, np.stack([at.x, at.y, at.yaw], axis=1)).min() > -0.01
    assert route.path.largest_curvature <= 1.0 / 0.4 + 1e-12
    # over a corner of the wall: the way of a thread around a disc of the vehicle's half width
    shortest = min(math.hypot(1.6, edge) + math.hypot(1.9, edge) for edge in (1.5, 2.0))
    assert shortest < route.path.whole_length < 1.7 * shortest


@pytest.mark.parametrize(
    ("method", "limits"),
    [
        ("optimal", FIXED),
        ("optimal", Limits.of(FOCCHI, sprocket_acceleration=20.0)),
        ("dubins", FIXED),
        ("clothoid", Limits.of(FOCCHI, v_min=0.0)),
    ],
)
def test_a_goal_behind_a_wall_is_reached_around_it(method, limits):
    obstacles = Obstacles.of(circles=[(2.8, 1.5, 0.4)], polygons=[WALL])
    made = plan((0, 0, 0), BEHIND, limits, method=method, obstacles=obstacles)
    assert made.converged
    assert missed(np.array([made.x[-1], made.y[-1], made.yaw[-1]]), BEHIND) < 1e-6
    assert free(made, obstacles) > 0.0
    assert free(plan((0, 0, 0), BEHIND, limits, method=method), obstacles) < 0.0  # straight on
    assert np.all(np.diff(made.time) > 0.0)
    assert np.abs(np.diff(made.yaw)).max() < 0.2


def test_a_free_goal_is_reached_by_the_plan_without_obstacles():
    obstacles = Obstacles.of(circles=[(0.0, 3.0, 0.4)])
    made = plan((0, 0, 0), BEHIND, FIXED, obstacles=obstacles)
    assert made.duration == plan((0, 0, 0), BEHIND, FIXED).duration


def test_a_goal_in_a_closed_box_is_not_reached_and_says_so():
    made = plan((0, 0, 0), BEHIND, FIXED, obstacles=Obstacles.of(polygons=BOX))
    assert not made.converged
    assert "no way around" in made.message


def test_a_chain_passes_its_way_points_and_goes_on_in_motion():
    points = np.array([(1.0, 1.0, 1.0), (0.0, 2.0, 3.0), (-2.0, 0.0, -1.0)])
    limits = Limits.of(FOCCHI, sprocket_acceleration=20.0)
    made = plan((0, 0, 0), points[-1], limits, via=points[:-1])
    assert made.converged
    poses = np.stack([made.x, made.y, made.yaw], axis=1)
    for point in points:
        assert min(missed(pose, point) for pose in poses) < 1e-6
    assert np.abs(np.diff(made.sprocket_left)).max() < 20.0 * np.diff(made.time).max() * 40
    end = end_of(made)
    assert (end.x, end.y, end.yaw) == (made.x[-1], made.y[-1], made.yaw[-1])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"circles": [(0, 0, -1.0)]}, "circle radius = -1.0"),
        ({"polygons": [[(0, 0), (1, 1)]]}, r"polygon of shape \(2, 2\)"),
        ({"polygons": [[(0, 0), (1, math.nan), (2, 2)]]}, "must be finite"),
        ({"occupied": np.ones((3, 3))}, "Did you pass probabilities"),
        ({"occupied": np.ones((3, 3), dtype=bool), "cell": 0.0}, "cell = 0.0"),
    ],
)
def test_bad_obstacles_are_refused_in_one_line(given, message):
    with pytest.raises(ValueError, match=message) as error:
        Obstacles.of(**given)
    assert "\n" not in str(error.value)


def test_a_start_in_an_obstacle_is_refused():
    with pytest.raises(ValueError, match="the vehicle at its start"):
        plan((1.6, 0, 0), BEHIND, FIXED, obstacles=Obstacles.of(polygons=[WALL]))


def test_a_field_that_is_too_large_is_refused():
    with pytest.raises(ValueError, match="Plan in parts"):
        Obstacles.of(circles=[(0, 0, 1)]).clearance((-1000, -1000), (1000, 1000))
