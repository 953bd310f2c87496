"""The plant on terrain without an environment: from a given state, with given sprocket speeds.

    rig = TerrainRig(VEHICLES["focchi"], {"terrain": {"kind": "plane", "slope_x": 0.2}})
    rig.place(position=(0.0, 0.0, 0.25), quaternion=(1.0, 0.0, 0.0, 0.0))     at rest
    rig.advance([[0.0, 0.0]], 1.0, to=[[5.0, 5.0]])       rad/s, linear in time over 1 s
    rig.advance([[5.0, 5.0]], 2.0)                        held for 2 s
    rig.positions, rig.quaternions, rig.twists            (N, 3), (N, 4), (N, 6)
    rig.load, rig.largest_load                            (N,) normal loads [N]

World axes x, y, z up; position of the nominal centre of mass, a point of the hull; quaternion
(w, x, y, z) from body to world; twist (v_x, v_y, v_z, roll, pitch, yaw rate) in body axes.
`plants.standalone` drives every plant.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.physics import state as s
from tracked_env.physics.attitude import Quaternion, angles_of, quaternion_of
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.tracked_body import height_at_rest
from tracked_env.plants import terrain, terrain_state
from tracked_env.plants.standalone import Rig
from tracked_env.plants.terrain_options import LONGEST_STEP, made_of, resting
from tracked_env.terrain.pool import make_pool

Floats = NDArray[np.float64]
_TWIST = [s.V_X, s.V_Y, s.V_Z, s.ROLL_RATE, s.PITCH_RATE, s.YAW_RATE]


class TerrainRig(Rig):
    """N vehicles on one terrain, the first of a pool, each with the same parameters."""

    def __init__(
        self,
        parameters: PlantParameters,
        options: Mapping[str, Any] | None = None,
        count: int = 1,
        drive: str = "speed",
        step: float = LONGEST_STEP,
    ) -> None:
        """On the ground at (0, 0), at rest.

        options: of the plant. step [s]: longest integration step, instead of the option. Raises
        ValueError for a wrong option.
        """
        options = {**(options or {}), "longest_step": step}
        super().__init__(terrain.TERRAIN, parameters, count, drive, step, options)
        self.field = make_pool(options.get("terrain", "flat")).fields[0]
        self._made = made_of({**terrain.TERRAIN.options, **options})
        self._parameters = parameters
        self._rest = float(height_at_rest(parameters, self._made))
        for row in range(count):
            self.stand(0.0, 0.0, 0.0, row)

    def stand(self, x: float, y: float, yaw: float, row: int = 0) -> None:
        """Put a vehicle on the ground at (x, y) [m] with that yaw [rad], at rest."""
        pose = resting(self.field.at, self._parameters, self._made, x, y, yaw)
        self.states[row] = 0.0
        names = [s.X, s.Y, s.YAW, s.Z, s.PITCH, s.ROLL]
        self.states[row, names] = x, y, yaw, pose.z, pose.pitch, pose.roll
        self._settle()

    def place(
        self,
        position: Sequence[float],
        quaternion: Sequence[float],
        twist: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        row: int = 0,
    ) -> None:
        """Give a vehicle a state; its belts stand."""
        q = np.array(quaternion, dtype=float)
        yaw, pitch, roll = angles_of(Quaternion(*(q / np.linalg.norm(q))), 0.0)
        self.states[row] = 0.0
        names = [s.X, s.Y, s.Z, s.YAW, s.PITCH, s.ROLL]
        self.states[row, names] = *position[:2], position[2] - self._rest, yaw, pitch, roll
        self.states[row, _TWIST] = twist
        self._settle()

    def advance(self, commands: ArrayLike, duration: float, to: ArrayLike | None = None) -> None:
        """Hold commands (N, 2) for `duration` [s], or change them linearly `to` others by its end.

        Sprocket speeds [rad/s] or torques [N m]. Raises ValueError for commands of another shape
        or that are not finite.
        """
        ends = [commands] if to is None else [commands, to]
        given = [np.asarray(end, dtype=np.float64) for end in ends]
        shape = (self._chosen.size, 2)
        for end in given:
            if end.shape != shape or not np.isfinite(end).all():
                raise ValueError(
                    f"commands of shape {end.shape}; must be finite numbers of shape {shape}: "
                    "left and right, in N m or rad/s"
                )
        self._hold(np.ascontiguousarray(np.concatenate(given, axis=1)), duration)

    def _settle(self) -> None:
        """Bring loads and efforts up to date with the states."""
        self._hold(np.zeros((self._chosen.size, 2)), 0.0)

    @property
    def positions(self) -> Floats:
        """(N, 3) nominal centre of mass [m], world."""
        xyz = self.states[:, [s.X, s.Y, s.Z]]
        xyz[:, 2] += self._rest
        return xyz

    @property
    def quaternions(self) -> Floats:
        """(N, 4) w, x, y, z, body to world."""
        angles = self.states[:, [s.YAW, s.PITCH, s.ROLL]]
        return np.array([quaternion_of(*row) for row in angles])

    @property
    def twists(self) -> Floats:
        """(N, 6) velocity [m/s] and angular velocity [rad/s], body axes."""
        return self.states[:, _TWIST]

    def _own(self, *columns: int) -> Floats:
        return self._batch.floats[:, list(columns)].sum(axis=1)

    @property
    def load(self) -> Floats:
        """(N,) normal load [N] of both tracks."""
        return self._own(terrain_state.LOAD_LEFT, terrain_state.LOAD_RIGHT)

    @property
    def track_loads(self) -> Floats:
        """(N, 2) normal load [N] of the left and the right track."""
        return self._batch.floats[:, [terrain_state.LOAD_LEFT, terrain_state.LOAD_RIGHT]]

    @property
    def largest_load(self) -> Floats:
        """(N,) largest normal load [N] of a patch."""
        return self._own(terrain_state.LARGEST_LOAD)

    @property
    def touching(self) -> Floats:
        """(N,) share [-] of the patches in contact: 0 in flight."""
        return self._own(terrain_state.TOUCHING)

    @property
    def off_map(self) -> NDArray[np.bool_]:
        """(N,) whether a patch is off the map."""
        return self._own(terrain_state.OFF_MAP) > 0.0

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """(N,) whether the uniform load has reached the moment at which a vehicle tips."""
        return self._own(terrain_state.SATURATED) > 0.0
