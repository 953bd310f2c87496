"""What one picture shows: the numbers of one vehicle at one instant, by name, in SI units."""

from typing import NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.engine.columns import columns
from tracked_env.engine.episode import Episode
from tracked_env.engine.simulation import Simulation
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.state import VehicleState
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.plants import Drive, Plant
from tracked_env.rendering.sizes import Sizes, sizes_of

LOAD_SHARE = 4.0  # [-] times the mean load of a patch at rest: end of the scale of loads


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
    plant: Plant
    drive: Drive  # what the action is
    reads: frozenset[str]  # parameters that matter to the motion
    # [N] normal load of each patch (2, nx, ny), as `terrain_source.TerrainSource` has it, if known.
    loads: NDArray[np.float64] | None = None

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


def _ending(simulation: Simulation, row: int, finite: bool) -> str:
    if not finite:
        return "the state is not finite: episode over"
    if simulation.terminated[row]:
        code = int(simulation.batch.floats[row, b.FAILURE])
        if code:
            return f"{simulation.solver.plant.failures[code - 1].replace('_', ' ')}: episode over"
        return f"more than {simulation.solver.error_limit:g} m off the path: episode over"
    return "time is up: episode over" if simulation.truncated[row] else ""


def take(simulation: Simulation, row: int) -> Snapshot:
    """Read vehicle `row`. Numbers that are not finite read as 0, and `ending` says so.

    Raises gymnasium.error.ResetNeeded before the first episode.
    """
    episode = simulation.episodes[row]
    if episode is None:
        raise gymnasium.error.ResetNeeded("nothing to draw: call reset() before render()")
    batch, solver = simulation.batch, simulation.solver

    def finite_list(values: NDArray[np.float64]) -> list[float]:
        return np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0).tolist()

    names = (
        "reference_x", "reference_y", "reference_yaw", "reference_speed", "reference_yaw_rate",
        "distance", "heading_error", "reward", "action_left", "action_right",
    )  # fmt: skip
    number = dict(zip(names, finite_list(batch.floats[row, columns(names)]), strict=True))
    finite = bool(np.isfinite(batch.state()[row]).all())
    state = VehicleState(*finite_list(batch.state()[row]))
    parameters = PlantParameters(*finite_list(batch.parameters()[row]))
    resistances = solver.plant.motion_resistances(batch.floats, row)
    return Snapshot(
        episode=episode,
        events=batch.events[row : row + 1, : int(batch.counter("event_count")[row])],
        time=int(batch.counter("step")[row]) * solver.control_period,
        duration=simulation.settings.duration,
        state=state,
        parameters=parameters,
        parameters_at_start=PlantParameters(*finite_list(batch.base()[row])),
        reference=Pose(number["reference_x"], number["reference_y"], number["reference_yaw"]),
        reference_speed=number["reference_speed"],
        reference_yaw_rate=number["reference_yaw_rate"],
        distance=number["distance"],
        heading_error=number["heading_error"],
        reward=number["reward"],
        action=(number["action_left"], number["action_right"]),
        resistance=resistances if finite else (0.0, 0.0),
        lateral_force=parameters.mass * state.acceleration_y,
        ending=_ending(simulation, row, finite),
        nominal=solver.nominal,
        plant=solver.plant,
        drive=solver.drive,
        reads=solver.reads.names,
    )
