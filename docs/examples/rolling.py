"""Rolls without slip: v = r (omega_L + omega_R) / 2, w = r (omega_R - omega_L) / B."""

import numpy as np

from tracked_env import arrays, plants
from tracked_env.physics import parameters as state
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import row_parameters
from tracked_env.plants import Plant, Prepared
from tracked_env.step import advance_blocks


@formula
def derive(floats, i, substep):
    """Nothing follows from the parameters alone."""


@formula
def move(batch, scratch, block, pace, options):
    """Vehicle i over pace.substeps sub-steps of pace.h [s]; with none its state is settled."""
    i, floats = block.vehicles[block.first], batch.floats
    p = row_parameters(floats, i, arrays.PARAMETERS)
    if pace.substeps > 0:
        floats[i, state.SPROCKET_SPEED_LEFT] = p.sprocket_speed_limit * floats[i, arrays.ACTION]
        right = p.sprocket_speed_limit * floats[i, arrays.ACTION + 1]
        floats[i, state.SPROCKET_SPEED_RIGHT] = right
    left, right = floats[i, state.SPROCKET_SPEED_LEFT], floats[i, state.SPROCKET_SPEED_RIGHT]
    speed = 0.5 * p.sprocket_radius * (left + right)
    yaw_rate = p.sprocket_radius * (right - left) / p.track_gauge
    for _ in range(pace.substeps):
        cosine, sine = rotation(floats[i, state.YAW] + 0.5 * pace.h * yaw_rate)
        floats[i, state.X] += pace.h * speed * cosine
        floats[i, state.Y] += pace.h * speed * sine
        floats[i, state.YAW] += pace.h * yaw_rate
    if pace.substeps > 0:
        floats[i, state.ACCELERATION_X] = (speed - floats[i, state.V_X]) / pace.period
        floats[i, state.YAW_ACCELERATION] = (yaw_rate - floats[i, state.YAW_RATE]) / pace.period
    floats[i, state.ACCELERATION_Y] = speed * yaw_rate
    floats[i, state.V_X], floats[i, state.YAW_RATE] = speed, yaw_rate


@loop
def advance(batch, rows, clock, options):
    """The kernel of the control step, compiled in this file."""
    return advance_blocks(derive, move, 1, np.empty((1, 1)), batch, rows, clock, options)


@loop
def no_resistances(floats, i):
    """Motion resistance [N] of the left and the right track."""
    return 0.0, 0.0


def rolling(parameters, drawn):
    """The drawn state, with the sprocket speeds at which nothing slides."""
    turn = 0.5 * parameters.track_gauge * drawn.yaw_rate
    return drawn._replace(
        v_y=0.0,
        sprocket_speed_left=(drawn.v_x - turn) / parameters.sprocket_radius,
        sprocket_speed_right=(drawn.v_x + turn) / parameters.sprocket_radius,
    )


READ = frozenset({"sprocket_radius", "track_gauge", "sprocket_speed_limit"})
ROLLING = plants.register(
    Plant(
        name="rolling",
        reads={"speed": READ},
        prepare=lambda drive, options: Prepared(advance, start=rolling),
        motion_resistances=no_resistances,
        panel=("track_gauge",),  # shown in pictures
    )
)
