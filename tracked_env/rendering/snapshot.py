"""What one picture shows: the numbers of one vehicle at one instant, by name, in SI units."""

from typing import NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.engine.episode import Episode
from tracked_env.engine.simulation import Simulation
from tracked_env.physics import lumped_forces
from tracked_env.physics import state as s
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PARAMETER_ROWS, PlantParameters
from tracked_env.physics.state import STATE_ROWS, VehicleState
from tracked_env.rendering.sizes import Sizes, sizes_of

HALF_GAUGE = lumped_forces.Coefficients._fields.index("half_gauge")
RESISTANCE = lumped_forces.Coefficients._fields.index("resistance")


class Pose(NamedTuple):
    """Where something stands, world frame."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # [rad]


class Snapshot(NamedTuple):
    """One vehicle at one instant."""

    episode: Episode
    events: NDArray[np.float64]  # (1, E, 8) what changes, as the kernels take it
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
    nominal: PlantParameters  # of the environment's vehicle and soil
    distributed: bool  # the plant has patches under the tracks
    by_torque: bool  # what the action is: torques, or else sprocket speeds

    @property
    def pose(self) -> Pose:
        """Of the vehicle."""
        return Pose(self.state.x, self.state.y, self.state.yaw)

    @property
    def sizes(self) -> Sizes:
        """Of what is drawn."""
        return sizes_of(self.nominal)


@loop
def motion_resistances(floats, i):
    """Motion resistance [N] of the left and the right track of vehicle i, by the lumped plant."""
    motion = lumped_forces.Motion(
        floats[i, b.STATE + s.V_X], floats[i, b.STATE + s.V_Y], floats[i, b.STATE + s.YAW_RATE]
    )
    c, d = b.COEFFICIENTS, b.DRIVE
    k = lumped_forces.Coefficients(
        floats[i, c], floats[i, c + 1], floats[i, c + 2], floats[i, c + 3], floats[i, c + 4],
        floats[i, c + 5], floats[i, c + 6], floats[i, c + 7], floats[i, c + 8],
    )  # fmt: skip
    drive = lumped_forces.DriveLimits(
        floats[i, d], floats[i, d + 1], floats[i, d + 2], floats[i, d + 3]
    )
    limits = lumped_forces.traction_limits(motion, k.half_gauge, drive)
    loads = lumped_forces.sliding_loads(
        motion, floats[i, b.STATE + s.TORQUE_LEFT], floats[i, b.STATE + s.TORQUE_RIGHT], k, limits
    )
    return loads.resistance_left, loads.resistance_right


@loop
def motion_resistances_on_patches(floats, i):
    """The same by the distributed plant, from its tractive efforts."""
    motion = lumped_forces.Motion(
        floats[i, b.STATE + s.V_X], floats[i, b.STATE + s.V_Y], floats[i, b.STATE + s.YAW_RATE]
    )
    half_gauge = floats[i, b.COEFFICIENTS + HALF_GAUGE]
    resistance = floats[i, b.COEFFICIENTS + RESISTANCE]
    left, right = lumped_forces.track_speeds(motion, half_gauge)
    inverse_width = 1.0 / soil.MOTION_RESISTANCE_REGULARISATION
    return (
        soil.resisting(left, floats[i, b.STATE + s.EFFORT_LEFT], resistance, inverse_width),
        soil.resisting(right, floats[i, b.STATE + s.EFFORT_RIGHT], resistance, inverse_width),
    )


def _ending(simulation: Simulation, row: int, finite: bool) -> str:
    counters = simulation.batch.counters[row]
    if not finite:
        return "the state is not finite: episode over"
    if counters[b.TERMINATED]:
        return f"more than {simulation.solver.error_limit:g} m off the path: episode over"
    return "time is up: episode over" if counters[b.TRUNCATED] else ""


def take(simulation: Simulation, row: int) -> Snapshot:
    """Read vehicle `row`. Numbers that are not finite read as 0, and `ending` says so.

    Raises gymnasium.error.ResetNeeded before the first episode.
    """
    episode = simulation.episodes[row]
    if episode is None:
        raise gymnasium.error.ResetNeeded("nothing to draw: call reset() before render()")
    floats, counters = simulation.batch.floats, simulation.batch.counters
    finite = bool(np.isfinite(floats[row, b.STATE : b.STATE + STATE_ROWS]).all())
    values = np.nan_to_num(floats[row], nan=0.0, posinf=0.0, neginf=0.0).tolist()
    state = VehicleState(*values[b.STATE : b.STATE + STATE_ROWS])
    parameters = PlantParameters(*values[b.PARAMETERS : b.PARAMETERS + PARAMETER_ROWS])
    count = int(counters[row, b.EVENT_COUNT])
    distributed = simulation.solver.distributed
    resistances = motion_resistances_on_patches if distributed else motion_resistances
    return Snapshot(
        episode,
        simulation.batch.events[row : row + 1, :count],
        int(counters[row, b.STEP]) * simulation.solver.control_period,
        simulation.settings.duration,
        state,
        parameters,
        PlantParameters(*values[b.BASE : b.BASE + PARAMETER_ROWS]),
        Pose(*values[b.REFERENCE_X : b.REFERENCE_X + 3]),
        values[b.REFERENCE_MOTION],
        values[b.REFERENCE_MOTION + 3],
        values[b.ERROR_DISTANCE],
        values[b.ERROR_YAW],
        values[b.REWARD],
        (values[b.PREVIOUS_ACTION], values[b.PREVIOUS_ACTION + 1]),
        resistances(floats, row) if finite else (0.0, 0.0),
        parameters.mass * state.acceleration_y,
        _ending(simulation, row, finite),
        simulation.solver.nominal,
        simulation.solver.distributed,
        simulation.solver.by_torque,
    )
