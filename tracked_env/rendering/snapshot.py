"""What one picture shows: the numbers of one vehicle at one instant, and the terrain around it.

    R = R_z(yaw) R_y(pitch) R_x(roll),   p_world = c + R p_body        c: centre of mass
    tilt = arccos(R_zz), the angle between the vehicle's up axis and the vertical
World frame x, y, z up; body frame x forward, y left, z up (NOTATION.md). The body's origin is the
centre of mass; the underside of the tracks is the plane z = -centre_height.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from scipy.spatial.transform import Rotation

from tracked_env import arrays as b
from tracked_env.arrays import columns
from tracked_env.engine.episode import Episode
from tracked_env.engine.simulation import Simulation
from tracked_env.physics.parameters import PlantParameters, VehicleState
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.plants import Drive, Plant
from tracked_env.references import sample
from tracked_env.rendering.canvas import Floats, Sizes, sizes_of

LOAD_SHARE = 4.0  # [-] times the mean load of a patch at rest: end of the scale of loads
TILT_LIMIT = math.radians(45.0)  # [rad] marked in the indicators unless the terrain has another
Heights = Callable[[Floats, Floats], Floats]


class Pose(NamedTuple):
    """Where something stands, world frame."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # [rad]


class BodyPose(NamedTuple):
    """Position of the centre of mass and attitude, world frame."""

    x: float  # [m]
    y: float  # [m]
    z: float  # [m] height of the centre of mass
    yaw: float  # [rad]
    pitch: float  # [rad] positive: nose down
    roll: float  # [rad] positive: left side up

    @property
    def axes(self) -> Floats:
        """Rotation matrix R (3, 3), body to world."""
        angles = [self.yaw, self.pitch, self.roll]
        return np.asarray(Rotation.from_euler("ZYX", angles).as_matrix())

    @property
    def tilt(self) -> float:
        """Angle between the vehicle's up axis and the vertical [rad], in [0, pi]."""
        return math.acos(min(max(math.cos(self.pitch) * math.cos(self.roll), -1.0), 1.0))

    def place(self, points: Floats) -> Floats:
        """World coordinates (P, 3) [m] of points (P, 3) [m] of the body."""
        return points @ self.axes.T + (self.x, self.y, self.z)


def placed(points: Any, pose: Pose | BodyPose) -> Floats:
    """World places (..., 2) [m] of points (..., 2) [m] in the frame of a pose, seen from above."""
    cosine, sine = math.cos(pose.yaw), math.sin(pose.yaw)
    world: Floats = np.asarray(points) @ np.array([[cosine, sine], [-sine, cosine]])
    return world + np.array([pose.x, pose.y])


def level(x: Floats, y: Floats) -> Floats:
    """Height 0 [m] at all places."""
    return np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))


class TerrainSource(NamedTuple):
    """The terrain of one environment, as pictures ask for it.

    heights: (x, y) [m], two arrays of one shape -> heights [m] of that shape, world frame.
    loads: (simulation, row) -> normal load [N] per patch (2, nx, ny): left and right track, from
    the rear to the front, from the right to the left edge of the track; None: not known.
    """

    heights: Heights = level
    loads: Callable[[Simulation, int], Floats] | None = None
    tilt_limit: float = TILT_LIMIT  # [rad] between the vehicle's up axis and the vertical
    centre_height: float = 0.0  # [m] h, centre of mass above the underside of the tracks

    def checked_heights(self, x: Floats, y: Floats) -> Floats:
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

    def pose(self, state: VehicleState) -> BodyPose:
        """Pose in space: the state counts z from the height of the centre of mass at rest."""
        z = state.z + self.centre_height
        return BodyPose(state.x, state.y, z, state.yaw, state.pitch, state.roll)


def _ground_heights(simulation: Simulation, row: int, x: Floats, y: Floats) -> Floats:
    """Heights [m] of the ground of a vehicle as it is now, at places (x, y) [m] of one shape."""
    places = (np.asarray(values, dtype=np.float64).reshape(1, -1) for values in (x, y))
    ground: Any = simulation.solver.prepared.ground
    heights: Floats = ground.heights(simulation.batch.floats, np.array([row]), *places)
    return heights.reshape(np.shape(x))


def _patch_loads(simulation: Simulation, row: int) -> Floats:
    """(2, nx, ny) normal load [N] of each patch of the left and the right track."""
    ground: Any = simulation.solver.prepared.ground
    loads: Floats = ground.loads(simulation.batch, row)
    return loads


def source_of(simulation: Simulation, row: int) -> TerrainSource | None:
    """The ground of vehicle `row` as it is now; None where the plant knows level ground alone."""
    ground = simulation.solver.prepared.ground
    if ground is None:
        return None
    heights = partial(_ground_heights, simulation, row)  # copied together with the simulation
    height = ground.centre_height(simulation.nominal(row))
    return TerrainSource(heights, _patch_loads, ground.tilt_limit, height)


class Snapshot(NamedTuple):
    """One vehicle at one instant."""

    episode: Episode
    events: Floats  # (1, E, 8) what changes, as the kernels take it
    time: float  # [s] since reset
    duration: float  # [s] of the episode
    state: VehicleState
    parameters: PlantParameters  # in force now
    parameters_at_start: PlantParameters
    reference: Pose
    reference_speed: float  # [m/s]
    reference_yaw_rate: float  # [rad/s]
    distance: float  # [m] to the reference
    heading_error: float  # [rad] reference minus vehicle
    reward: float
    action: tuple[float, float]  # [-] left, right
    resistance: tuple[float, float]  # [N] motion resistance of the left and the right track
    lateral_force: float  # [N] of the soil on the vehicle, to its left
    ending: str  # why the episode is over, or empty
    nominal: PlantParameters  # of the environment's vehicle and soil, or as drawn
    plant: Plant
    drive: Drive  # what the action is
    reads: frozenset[str]  # parameters that matter to the motion
    loads: Floats | None = None  # [N] normal load of each patch (2, nx, ny) of a TerrainSource

    @property
    def pose(self) -> Pose:
        """Of the vehicle."""
        return Pose(self.state.x, self.state.y, self.state.yaw)

    @property
    def load_shown(self) -> float:
        """[N] of a patch at the end of the scale of loads: LOAD_SHARE times the mean at rest."""
        patches = 2 if self.loads is None else self.loads.size
        return LOAD_SHARE * self.parameters.mass * GRAVITY / patches

    @property
    def sizes(self) -> Sizes:
        """Of what is drawn."""
        return sizes_of(self.nominal)


def path_of(shot: Snapshot, times: Floats) -> Floats:
    """The reference (P, 2) [m] at these times (P,) [s] of the episode."""
    path = sample(shot.episode.profile, times)
    return np.stack([path.x, path.y], axis=1)


def _ending(simulation: Simulation, row: int, finite: bool) -> str:
    reason = ""
    if not finite:
        reason = "the state is not finite"
    elif simulation.terminated[row]:
        code, solver = int(simulation.batch.floats[row, b.FAILURE]), simulation.solver
        limit = simulation.batch.column("error_limit")[row]
        reason = f"more than {limit:g} m off the path"
        if code:
            reason = solver.plant.failures[code - 1].replace("_", " ")
    elif simulation.truncated[row]:
        reason = "time is up"
    return reason and f"{reason}: episode over"


def take(simulation: Simulation, row: int) -> Snapshot:
    """Read vehicle `row`. Numbers that are not finite read as 0, and `ending` says so.

    Raises gymnasium.error.ResetNeeded before the first episode.
    """
    episode = simulation.episodes[row]
    if episode is None:
        raise gymnasium.error.ResetNeeded("nothing to draw: call reset() before render()")
    batch, solver = simulation.batch, simulation.solver

    def finite_values(values: Floats) -> list[float]:
        return np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0).tolist()

    def values_of(*names: str) -> list[float]:
        return finite_values(batch.floats[row, columns(names)])

    finite = bool(np.isfinite(batch.state()[row]).all())
    state = VehicleState(*finite_values(batch.state()[row]))
    parameters = PlantParameters(*finite_values(batch.parameters()[row]))
    names = ("reference_speed", "reference_yaw_rate", "distance", "heading_error", "reward")
    motion: Any = dict(zip(names, values_of(*names), strict=True))
    left, right = values_of("action_left", "action_right")
    return Snapshot(
        episode=episode,
        events=batch.events[row : row + 1, : int(batch.counter("event_count")[row])],
        time=int(batch.counter("step")[row]) * solver.control_period,
        duration=simulation.settings.duration,
        state=state,
        parameters=parameters,
        parameters_at_start=PlantParameters(*finite_values(batch.base()[row])),
        reference=Pose(*values_of("reference_x", "reference_y", "reference_yaw")),
        **motion,
        action=(left, right),
        resistance=solver.plant.motion_resistances(batch.floats, row) if finite else (0.0, 0.0),
        lateral_force=parameters.mass * state.acceleration_y,
        ending=_ending(simulation, row, finite),
        nominal=simulation.nominal(row),
        plant=solver.plant,
        drive=solver.drive,
        reads=solver.reads.names,
    )
