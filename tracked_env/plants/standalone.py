"""A plant without an environment: vehicles that are driven by given sprocket torques or speeds.

    rig = Rig("distributed", parameters, count=2, drive="speed", step=1e-3)
    rig.states[:, :6] = x, y, yaw, v_x, v_y, yaw_rate        columns as in `physics.state`
    rig.advance(sprocket_speeds, 0.1)                        (2, 2) [rad/s] held for 0.1 s
    rig.state.v_x                                            (2,) [m/s]

No reference, no sensors, no reward, uniform soil. The commands are in SI units and in double
precision, while actions are shares of a limit in single precision.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.state import VehicleState
from tracked_env.plants import find, prepared
from tracked_env.plants.base import Plant

Floats = NDArray[np.float64]
STEP = 0.0025  # [s] longest integration step, by default


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
        """(N, STATE_ROWS) states, to be read and written; columns: `physics.state`."""
        return self._batch.state()

    @property
    def state(self) -> VehicleState:
        """The same by name, each (N,)."""
        return VehicleState(*self.states.T)

    def advance(self, commands: Floats, duration: float) -> None:
        """Hold commands (N, 2) for `duration` [s]: torques [N m] or sprocket speeds [rad/s].

        Raises ValueError for commands of another shape or that are not finite.
        """
        commands = np.ascontiguousarray(commands, dtype=np.float64)
        if commands.shape != (self._chosen.size, 2) or not np.isfinite(commands).all():
            raise ValueError(
                f"commands of shape {commands.shape}; must be finite numbers of shape "
                f"({self._chosen.size}, 2): left and right, in N m or rad/s"
            )
        self._hold(commands, duration)

    def _hold(self, commands: Floats, duration: float) -> None:
        """The plant's kernel over `duration` [s], with commands as it takes them."""
        steps = max(round(duration / self._step), 1) if duration > 0.0 else 0
        assert self._prepared.hold is not None
        self._prepared.hold(
            *self._batch, self._chosen, 0, self._chosen.size, steps, duration / max(steps, 1),
            commands, *self._prepared.options,
        )  # fmt: skip
