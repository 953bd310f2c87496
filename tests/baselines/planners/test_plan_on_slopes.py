"""Plans on slopes: they end at the goal where plans that know no gravity miss it."""

import math

import numpy as np
import pytest

from baselines.planners.motion_planning import plan
from baselines.planners.plan_on_slopes import Terrain, grade_at, slopes_of
from baselines.planners.trajectory import Limits
from baselines.slip.slip_models import grades
from baselines.slip.slip_sweep import identified_slope_slip, with_friction
from tests.baselines.planners.planner_cases import ORIGIN, missed, refused
from tracked_env.physics.parameters import VEHICLES
from tracked_env.plants.standalone import TerrainRig
from tracked_env.terrain.height_field import make_height_field

FOCCHI = with_friction(VEHICLES["focchi"], 0.4)
LIMITS = Limits.of(FOCCHI, reserve=0.1, sprocket_acceleration=20.0)
GOALS = [(2.0, 2.5, -0.4), (2.5, -1.0, -1.0), (-1.0, 1.5, 2.0)]
PLANE = (0.15, 0.1)


@pytest.fixture(scope="module")
def slip():
    """Slip on slopes, on a coarse grid, which takes a third of the time."""
    return identified_slope_slip(FOCCHI, speed_step=2.5, slope_step=0.21875)


def drive(goal, slip, ground=None, **options):
    return plan(ORIGIN, goal, LIMITS, slip, vehicle=FOCCHI, ground=ground, **options)


def replayed(model, motion, slope, steps=16):
    """The pose at the end of held sprocket speeds on a plane, in coordinates of the plane.

    Axes a (up the slope), b (level) in the plane; the vehicle at yaw psi points along the direction
    whose horizontal part is (cos psi, sin psi). Gravity along the plane pulls towards -a.
    """
    steep = math.hypot(*slope)
    up = np.array(slope) / steep
    stretch, normal = math.sqrt(1.0 + steep * steep), 1.0 / math.sqrt(1.0 + steep * steep)
    east = np.array([up[0], up[1]]), np.array([-up[1], up[0]])

    def heading(yaw):  # in the plane, from a towards b
        u = np.array([math.cos(yaw), math.sin(yaw)])
        return math.atan2(u @ east[1], u @ east[0] * stretch)

    a, b, theta = 0.0, 0.0, heading(motion.yaw[0])
    for k, duration in enumerate(np.diff(motion.time)):
        step = duration / steps
        for _ in range(steps):
            turn = 0.0
            for _ in range(3):  # at the middle of the step
                middle = theta + 0.5 * step * turn
                pull = -steep * normal * np.array([math.cos(middle), -math.sin(middle)]) / normal
                left, right, alpha = model.on(pull[None]).slip(
                    np.array([motion.sprocket_left[k]]), np.array([motion.sprocket_right[k]])
                )
                radius = FOCCHI.sprocket_radius
                v_left = radius * motion.sprocket_left[k] - left[0]
                v_right = radius * motion.sprocket_right[k] - right[0]
                turn = (v_right - v_left) / FOCCHI.track_gauge
            v_x = 0.5 * (v_left + v_right)
            v_y = v_x * math.tan(alpha[0])
            a += step * (v_x * math.cos(middle) - v_y * math.sin(middle))
            b += step * (v_x * math.sin(middle) + v_y * math.cos(middle))
            theta += step * turn
    place = a / stretch * east[0] + b * east[1]
    along = math.cos(theta) / stretch * east[0] + math.sin(theta) * east[1]
    return np.array([*place, math.atan2(along[1], along[0])])


@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.0, -1.3])
def test_the_grade_is_that_of_the_attitude_on_the_plane(yaw):
    """Roll and pitch of axes that lie in the plane, x over yaw."""
    a, b = 0.2, -0.3
    x_axis = np.array([math.cos(yaw), math.sin(yaw), a * math.cos(yaw) + b * math.sin(yaw)])
    normal = np.array([-a, -b, 1.0])
    x_axis, normal = x_axis / np.linalg.norm(x_axis), normal / np.linalg.norm(normal)
    y_axis = np.cross(normal, x_axis)
    pitch, roll = math.asin(-x_axis[2]), math.atan2(y_axis[2], normal[2])
    np.testing.assert_allclose(grade_at(yaw, a, b)[:2], grades(roll, pitch)[0], atol=1e-12)


@pytest.mark.parametrize("goal", GOALS)
def test_a_plan_on_a_plane_ends_at_the_goal_in_another_computation(goal, slip):
    motion = drive(goal, slip, PLANE)
    assert motion.converged, motion.message
    assert motion.end_error < 1e-3 and motion.end_yaw_error < 1e-3
    assert missed(replayed(slip, motion, PLANE), goal) < 3e-3


def test_a_plan_that_knows_no_gravity_misses_by_decimetres(slip):
    off = []
    for goal in GOALS:
        blind = drive(goal, slip)
        off.append(np.hypot(*(replayed(slip, blind, PLANE)[:2] - goal[:2])))
    assert min(off) > 0.05
    assert np.mean(off) > 0.1


def test_on_level_ground_it_is_the_plan_without_ground_up_to_the_fit(slip):
    flat, level = drive(GOALS[0], slip, (0.0, 0.0)), drive(GOALS[0], slip)
    assert flat.converged
    assert flat.duration == pytest.approx(level.duration, rel=0.01)
    level_right = level.sprocket_right[: len(flat.time)]
    assert np.abs(flat.sprocket_right[::20] - level_right[::20]).max() < 1


def test_a_mirrored_slope_has_the_mirrored_plan(slip):
    left = drive(GOALS[0], slip, PLANE)
    right = drive((GOALS[0][0], -GOALS[0][1], -GOALS[0][2]), slip, (PLANE[0], -PLANE[1]))
    assert right.duration == pytest.approx(left.duration, rel=1e-3)
    assert right.y[len(right.y) // 2] == pytest.approx(-left.y[len(left.y) // 2], abs=5e-3)


def test_hills_are_climbed_to_the_goal_and_the_height_field_is_their_ground(slip):
    hills = make_height_field("hills").at
    for goal in GOALS:
        motion = drive(goal, slip, hills)
        assert motion.converged, motion.message
        again = Terrain(hills, slip, FOCCHI).replay(motion)
        assert missed(again[-1, :3], goal) < 2e-3


def test_the_terrain_plant_ends_nearer_to_the_goal_of_a_plan_that_knows_gravity(slip):
    """From rest to rest on a plane; the rest is inertia, which no plan of these knows."""
    rig_options = {"terrain": {"kind": "plane", "slope_x": PLANE[0], "slope_y": PLANE[1]}}
    off = {}
    for name, ground in (("blind", None), ("knows", PLANE)):
        distances = []
        for goal in GOALS:
            motion = drive(goal, slip, ground, period=10.0)
            rig = TerrainRig(FOCCHI, rig_options)
            begin = rig.positions[0, :2]
            for k, duration in enumerate(np.diff(motion.time)):
                rig.advance([[motion.sprocket_left[k], motion.sprocket_right[k]]], duration)
            distances.append(np.hypot(*(rig.positions[0, :2] - begin - goal[:2])))
        off[name] = np.mean(distances)
    assert off["knows"] < 0.5 * off["blind"]


def test_a_slope_that_friction_does_not_hold_is_said(slip):
    motion = drive((2.0, 0.0, 0.0), slip, (0.0, 0.38))
    assert "slides" in motion.message or not motion.converged


@pytest.mark.parametrize(
    ("ground", "message"),
    [
        ((0.1,), "ground slope has shape .*rows of x, y"),
        (0.1, "ground slope has shape"),
        ((20.0, 0.0), "ground slope x = 20.0.*not an angle in degrees"),
        ((math.nan, 0.0), "ground slope x = nan"),
    ],
)
def test_what_is_no_slope_is_refused_in_one_line(ground, message):
    refused(lambda: slopes_of(ground), message)


def test_a_plane_is_its_height_and_its_slopes():
    z, along_x, along_y = slopes_of((0.2, -0.1))(np.array([1.0, 2.0]), np.array([0.0, 3.0]))
    np.testing.assert_allclose(z, [0.2, 0.1])
    assert (along_x == 0.2).all() and (along_y == -0.1).all()
