"""Plants without an environment: vehicles that are driven by commanded sprocket torques or speeds.

    rig = Rig("distributed", parameters, count=2, drive="speed", step=1e-3)
    rig.states[:, :6] = x, y, yaw, v_x, v_y, yaw_rate        columns as in `physics.parameters`
    rig.advance(sprocket_speeds, 0.1)                        (2, 2) [rad/s] held for 0.1 s
    rig.state.v_x                                            (2,) [m/s]

    rig = TerrainRig(VEHICLES["focchi"], {"terrain": {"kind": "plane", "slope_x": 0.2}})
    rig.place(position=(0.0, 0.0, 0.25), quaternion=(1.0, 0.0, 0.0, 0.0))     at rest
    rig.advance([[0.0, 0.0]], 1.0, to=[[5.0, 5.0]])       rad/s, linear in time over 1 s
    rig.positions, rig.quaternions, rig.twists            (N, 3), (N, 4), (N, 6)
    rig.load, rig.largest_load                            (N,) normal loads [N]

No reference, no sensors, no reward, uniform soil. The commands are in SI units and in double
precision, while actions are shares of a limit in single precision. On terrain the world axes are
x, y, z up; position of the nominal centre of mass, a point of the hull; quaternion (w, x, y, z)
from body to world; twist (v_x, v_y, v_z, roll, pitch, yaw rate) in body axes.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env import arrays as b
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import PlantParameters, VehicleState
from tracked_env.physics.rigid_body import Quaternion, angles_of, quaternion_of
from tracked_env.physics.terrain_motion import height_at_rest
from tracked_env.plants import Plant, find, prepared, terrain
from tracked_env.step import Pace
from tracked_env.terrain.pool import make_pool

Floats = NDArray[np.float64]
STEP = 0.0025  # [s] longest integration step, by default
_TWIST = [s.V_X, s.V_Y, s.V_Z, s.ROLL_RATE, s.PITCH_RATE, s.YAW_RATE]


class Driven(Protocol):
    """N vehicles that follow commands for their drives; `Rig`, or a model of one's own."""

    def advance(self, commands: Floats, duration: float) -> None:
        """Hold commands (N, 2), left and right, for `duration` [s]."""

    @property
    def states(self) -> Floats:
        """(N, >= 6) x, y [m], yaw [rad], v_x, v_y [m/s], yaw rate [rad/s]; may be written."""


class Rig:
    """N vehicles of a plant, each with the same parameters."""

    def __init__(
        self,
        plant: str | Plant,
        parameters: PlantParameters,
        count: int = 1,
        drive: str = "torque",
        step: float = STEP,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """At rest at the origin.

        step [s]: longest integration step; options: of the plant. Raises ValueError for a drive
        that the plant does not accept, for a wrong option, and for a plant with no such kernel.
        """
        self.plant = find(plant)
        self._prepared = prepared(self.plant, drive, options or {})
        if self._prepared.hold is None:
            raise ValueError(f"plant = {self.plant.name!r}; it has no kernel to hold commands")
        self._step, self._batch = step, b.allocate(count, 1, self.plant.columns)
        self._batch.base()[:] = self._batch.parameters()[:] = parameters
        self._chosen = np.arange(count)

    @property
    def states(self) -> Floats:
        """(N, STATE_ROWS) states, to be read and written; columns: `physics.parameters`."""
        return self._batch.state()

    @property
    def state(self) -> VehicleState:
        """The same by name, each (N,)."""
        return VehicleState(*self.states.T)

    def advance(self, commands: ArrayLike, duration: float) -> None:
        """Hold commands (N, 2) for `duration` [s]: torques [N m] or sprocket speeds [rad/s].

        Raises ValueError for commands of another shape or that are not finite.
        """
        self._hold([commands], duration)

    def _hold(self, ends: Sequence[ArrayLike], duration: float) -> None:
        """The plant's kernel over `duration` [s], with commands at its beginning and at its end."""
        arrays, shape = [np.asarray(end, dtype=np.float64) for end in ends], (self._chosen.size, 2)
        for end in arrays:
            if end.shape != shape or not np.isfinite(end).all():
                raise ValueError(
                    f"commands of shape {end.shape}; must be finite numbers of shape {shape}: "
                    "left and right, in N m or rad/s"
                )
        commands = np.ascontiguousarray(np.concatenate(arrays, axis=1))
        steps = max(round(duration / self._step), 1) if duration > 0.0 else 0
        pace = Pace(steps, duration / max(steps, 1), steps * (duration / max(steps, 1)))
        assert self._prepared.hold is not None
        self._prepared.hold(self._batch, self._chosen, pace, (commands, self._prepared.options))


def _column(column: int, about: str) -> Any:
    """Property: one column of the plant."""
    return property(lambda rig: rig._batch.floats[:, column].copy(), doc=about)


def _flag(column: int, about: str) -> Any:
    return property(lambda rig: rig._batch.floats[:, column] > 0.0, doc=about)


class TerrainRig(Rig):
    """N vehicles on one terrain, the first of a pool, each with the same parameters."""

    def __init__(
        self,
        parameters: PlantParameters,
        options: Mapping[str, Any] | None = None,
        count: int = 1,
        drive: str = "speed",
        step: float = terrain.LONGEST_STEP,
    ) -> None:
        """On the ground at (0, 0), at rest.

        options: of the plant. step [s]: longest integration step, instead of the option. Raises
        ValueError for a wrong option.
        """
        options = {**(options or {}), "longest_step": step}
        super().__init__(terrain.PLANT, parameters, count, drive, step, options)
        self.field = make_pool(options.get("terrain", "flat")).fields[0]
        self._body = terrain.body_options({**terrain.PLANT.options, **options})
        self._parameters = parameters
        self._rest = float(height_at_rest(parameters, self._body))
        for row in range(count):
            self.stand(0.0, 0.0, 0.0, row)

    def stand(self, x: float, y: float, yaw: float, row: int = 0) -> None:
        """Put a vehicle on the ground at (x, y) [m] with that yaw [rad], at rest."""
        pose = terrain.resting(self.field.at, self._parameters, self._body, x, y, yaw)
        self.states[row] = 0.0
        self.states[row, [s.X, s.Y, s.YAW, s.Z, s.PITCH, s.ROLL]] = x, y, yaw, *pose
        self._settle()

    def place(
        self,
        position: Sequence[float],
        quaternion: Sequence[float],
        twist: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        row: int = 0,
    ) -> None:
        """Give a vehicle a state; its belts stand."""
        q, (x, y, z) = np.array(quaternion, dtype=float), position
        angles = angles_of(Quaternion(*(q / np.linalg.norm(q))), 0.0)
        self.states[row] = 0.0
        self.states[row, [s.X, s.Y, s.Z, s.YAW, s.PITCH, s.ROLL]] = x, y, z - self._rest, *angles
        self.states[row, _TWIST] = twist
        self._settle()

    def advance(self, commands: ArrayLike, duration: float, to: ArrayLike | None = None) -> None:
        """Hold commands (N, 2) for `duration` [s], or change them linearly `to` others by its end.

        Sprocket speeds [rad/s] or torques [N m]. Raises ValueError for commands of another shape
        or that are not finite.
        """
        self._hold([commands] if to is None else [commands, to], duration)

    def _settle(self) -> None:
        """Bring loads and efforts up to date with the states."""
        self._hold([np.zeros((self._chosen.size, 2))], 0.0)

    @property
    def positions(self) -> Floats:
        """(N, 3) nominal centre of mass [m], world."""
        return self.states[:, [s.X, s.Y, s.Z]] + [0.0, 0.0, self._rest]

    @property
    def quaternions(self) -> Floats:
        """(N, 4) w, x, y, z, body to world."""
        return np.array([quaternion_of(*row) for row in self.states[:, [s.YAW, s.PITCH, s.ROLL]]])

    @property
    def twists(self) -> Floats:
        """(N, 6) velocity [m/s] and angular velocity [rad/s], body axes."""
        return self.states[:, _TWIST]

    @property
    def track_loads(self) -> Floats:
        """(N, 2) normal load [N] of the left and the right track."""
        return self._batch.floats[:, [terrain.LOAD_LEFT, terrain.LOAD_RIGHT]]

    @property
    def load(self) -> Floats:
        """(N,) normal load [N] of both tracks."""
        return self.track_loads.sum(axis=1)

    largest_load = _column(terrain.LARGEST_LOAD, "(N,) largest normal load [N] of a patch.")
    touching = _column(terrain.TOUCHING, "(N,) share [-] of patches in contact: 0 in flight.")
    off_map = _flag(terrain.OFF_MAP, "(N,) whether a patch is off the map.")
    saturated = _flag(terrain.SATURATED, "(N,) whether the uniform load tips the vehicle.")
