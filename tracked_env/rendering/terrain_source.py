"""What pictures need of a terrain: heights at places, the pose in space, loads under the tracks.

    R = R_z(yaw) R_y(pitch) R_x(roll),   p_world = c + R p_body        c: centre of mass
    tilt = arccos(R_zz), the angle between the vehicle's up axis and the vertical
World frame x, y, z up; body frame x forward, y left, z up (NOTATION.md). The body's origin is the
centre of mass; the underside of the tracks is the plane z = -centre_height.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tracked_env.engine.simulation import Simulation
from tracked_env.physics.state import VehicleState

FloatArray = NDArray[np.float64]
Heights = Callable[[FloatArray, FloatArray], FloatArray]

TILT_LIMIT = math.radians(45.0)  # [rad] marked in the indicators unless the terrain has another


def level(x: FloatArray, y: FloatArray) -> FloatArray:
    """Height 0 [m] at all places."""
    return np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))


class TerrainSource(NamedTuple):
    """The terrain of one environment, as pictures ask for it.

    heights: (x, y) [m], two arrays of one shape -> heights [m] of that shape, world frame.
    loads: (simulation, row) -> normal load [N] per patch (2, nx, ny): left and right track, from
    the rear to the front, from the right to the left edge of the track; None: not known.
    """

    heights: Heights = level
    loads: Callable[[Simulation, int], FloatArray] | None = None
    tilt_limit: float = TILT_LIMIT  # [rad] between the vehicle's up axis and the vertical
    centre_height: float = 0.0  # [m] h, centre of mass above the underside of the tracks

    def checked_heights(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Heights [m] at places; raises ValueError for another shape or a number not finite."""
        heights = np.asarray(self.heights(x, y), dtype=np.float64)
        if heights.shape != np.shape(x):
            raise ValueError(
                f"heights have shape {heights.shape}; must be {np.shape(x)}, that of the places. "
                "Does the function return one height for many places?"
            )
        if not np.isfinite(heights).all():
            bad = np.flatnonzero(~np.isfinite(heights.ravel()))[0]
            raise ValueError(
                f"height = {heights.ravel()[bad]} m at x = {np.ravel(x)[bad]:g} m, "
                f"y = {np.ravel(y)[bad]:g} m; must be finite. Is the place off the map?"
            )
        return heights


class PlantGround:
    """Heights of the ground of one vehicle as they are now; copied together with its simulation."""

    def __init__(self, simulation: Simulation, row: int) -> None:
        self._simulation, self._row = simulation, row

    def __call__(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Heights [m] at places (x, y) [m], two arrays of one shape."""
        ground = self._simulation.solver.prepared.ground
        assert ground is not None
        places = (np.asarray(values, dtype=np.float64).reshape(1, -1) for values in (x, y))
        found = ground.heights(self._simulation.batch.floats, np.array([self._row]), *places)
        return found.reshape(np.shape(x))


def _patch_loads(simulation: Simulation, row: int) -> FloatArray:
    """(2, nx, ny) normal load [N] of each patch of the left and the right track."""
    ground = simulation.solver.prepared.ground
    assert ground is not None
    return ground.loads(simulation.batch, row)


def source_of(simulation: Simulation, row: int) -> TerrainSource | None:
    """The ground of vehicle `row` as it is now; None where the plant knows level ground alone."""
    ground = simulation.solver.prepared.ground
    if ground is None:
        return None
    height = ground.centre_height(simulation.solver.nominal)
    return TerrainSource(PlantGround(simulation, row), _patch_loads, ground.tilt_limit, height)


class BodyPose(NamedTuple):
    """Position of the centre of mass and attitude, world frame."""

    x: float  # [m]
    y: float  # [m]
    z: float  # [m] height of the centre of mass
    yaw: float  # [rad]
    pitch: float  # [rad] positive: nose down
    roll: float  # [rad] positive: left side up

    @property
    def axes(self) -> FloatArray:
        """Rotation matrix R (3, 3), body to world."""
        angles = [self.yaw, self.pitch, self.roll]
        return np.asarray(Rotation.from_euler("ZYX", angles).as_matrix())

    @property
    def tilt(self) -> float:
        """Angle between the vehicle's up axis and the vertical [rad], in [0, pi]."""
        return math.acos(min(max(math.cos(self.pitch) * math.cos(self.roll), -1.0), 1.0))

    def place(self, points: FloatArray) -> FloatArray:
        """World coordinates (P, 3) [m] of points (P, 3) [m] of the body."""
        return points @ self.axes.T + (self.x, self.y, self.z)


def pose_of(state: VehicleState, terrain: TerrainSource) -> BodyPose:
    """Pose in space: the state counts z from the height of the centre of mass at rest."""
    z = state.z + terrain.centre_height
    return BodyPose(state.x, state.y, z, state.yaw, state.pitch, state.roll)
