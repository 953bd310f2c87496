"""A plan as a command line asks for it: a vehicle on its soil, limits, and the slip of both.

`planned` is registered in the group `tracked_env.commands` under the name `plan`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.planners.obstacles import Obstacles
from baselines.planners.plan import plan
from baselines.planners.trajectory import Limits, Trajectory
from baselines.slip.slip_sweep import identified_slip, with_friction
from baselines.slip.slope_sweep import identified_slope_slip
from tracked_env.physics.parameters import VEHICLES, PlantParameters
from tracked_env.validation import checked_choice

Array = NDArray[np.float64]


class Planned(NamedTuple):
    """A trajectory with what is drawn beside it."""

    trajectory: Trajectory
    slip: tuple[Array, Array, Array]  # beta left, right [m/s], alpha [rad], (M,) each
    limits: Limits
    vehicle: PlantParameters


def planned(
    goal: Sequence[float],
    start: Sequence[float] = (0.0, 0.0, 0.0),
    method: str = "optimal",
    vehicle: str = "focchi",
    friction: float | None = None,
    slips: bool = True,
    limits: Mapping[str, float] | None = None,
    via: Sequence[Sequence[float]] = (),
    circles: Sequence[Sequence[float]] = (),
    reverse: bool = False,
    slope: Sequence[float] | None = None,
    around: Mapping[str, Any] | None = None,
) -> Planned:
    """Plan from a start to a goal, x, y [m], yaw [rad].

    vehicle: a key of VEHICLES. friction: mu [-] of the soil, that of the vehicle by default. slips:
    whether the plan knows the slip, identified on the distributed plant. limits: fields of
    `Limits`. via: way points. circles: obstacles, x, y, radius [m]. reverse: whether it may be
    driven backwards. slope: of the ground in x and y [-]; None: level. around: margin, room, time
    limit of `plan` around obstacles. Raises ValueError.
    """
    body = VEHICLES[checked_choice("vehicle", vehicle, VEHICLES)]
    if friction is not None:
        body = with_friction(body, friction)
    allowed = Limits.of(body, **dict(limits or {}))
    if slope is not None and not slips:
        raise ValueError("slope without slip; a plan on a slope must know slip. Drop one of them")
    identified = identified_slip if slope is None else identified_slope_slip
    made = plan(
        tuple(start), goal, allowed, identified(body) if slips else None, method, body,
        via=via, obstacles=Obstacles.of(circles=circles) if len(circles) else None,
        reverse=reverse, ground=slope, **dict(around or {}),
    )  # fmt: skip
    assert isinstance(made, Trajectory)
    return Planned(made, made.slip(body), allowed, body)
