"""Printed equations of sections 2.2 and 5.3 of Focchi et al. (2025): what they would do."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baselines.lyapunov.lyapunov_laws import LyapunovGains, PoseError
from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025.control import vehicle
from tests.baselines.lyapunov.lyapunov_function import unicycle_law
from tracked_env.physics.rigid_body import in_body_plane
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.plants.standalone import TerrainRig

ANGLE, SPEED = math.radians(20.0), 0.5  # [rad], [m/s]


def test_the_printed_damper_lifts_a_vehicle_that_drives_downhill():
    weight = vehicle().mass * GRAVITY
    vertical = -SPEED * math.sin(ANGLE)  # z . p' of (17) for motion along the ground
    lift = -2.0 * loads.DAMPING["Table 2"] * vertical  # (18), both tracks
    assert lift == pytest.approx(1.71e3, rel=0.01) and lift > 2.0 * weight
    parameters = vehicle(friction=loads.FRICTION)
    rig = TerrainRig(parameters, {"terrain": {"kind": "plane", "slope_x": -math.tan(ANGLE)}})
    rig.stand(0.0, 0.0, 0.0)
    rig.advance([[SPEED / parameters.sprocket_radius] * 2], 4.0)
    assert rig.load[0] == pytest.approx(weight * math.cos(ANGLE), rel=1e-4)


@pytest.mark.parametrize("yaw", [0.5, 1.5, -2.0])
def test_a_tilt_taken_from_the_rotation_vector_is_turned_by_half_the_yaw(yaw):
    tilt = np.array([0.0, 1e-4, 0.0])  # of the ground, which (15) gives no yaw
    ground, body = Rotation.from_rotvec(tilt), Rotation.from_euler("z", yaw)
    error = (ground * body.inv()).as_rotvec()[:2]
    turned = math.remainder(math.atan2(error[1], error[0]) - 0.5 * math.pi, 2.0 * math.pi)
    assert turned == pytest.approx(0.5 * yaw, abs=1e-3)
    assert np.hypot(*error) == pytest.approx(1e-4 * 0.5 * yaw / math.sin(0.5 * yaw), rel=1e-3)


def printed_speed(error, yaw, gains):
    """delta_v of (42) with the error of (49): rotated by the yaw, then with the yaw once more."""
    x, y = Rotation.from_euler("z", yaw).inv().apply([*error, 0.0])[:2]
    return -gains.k_p * math.hypot(x, y) * math.cos(math.atan2(y, x) - yaw)


@pytest.mark.parametrize("yaw", [0.0, 1.0, math.pi])
def test_the_printed_error_in_the_body_depends_on_where_north_is(yaw):
    gains = LyapunovGains()
    behind = (-0.1 * math.cos(yaw), -0.1 * math.sin(yaw))  # vehicle less reference
    level = ((1.0, 0.0), (1.0, 0.0))
    ahead, left, turn = in_body_plane.py_func(0.1, 0.0, 0.0, *level)
    right = unicycle_law(PoseError(-ahead, -left, -turn), 0.0, 0.0, gains)
    assert right.speed == pytest.approx(0.1 * gains.k_p)
    assert printed_speed(behind, yaw, gains) == pytest.approx(right.speed * math.cos(yaw))
