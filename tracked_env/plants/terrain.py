"""The plant on terrain: six degrees of freedom, patches under the tracks on uneven ground.

Contact and shear are in `physics.ground_contact` and `physics.uniform_load`, equations of motion
and integrator in `physics.terrain_motion`, terrains in `terrain.height_field`. Options:
    terrain       a kind, a dict or a list of them, see `terrain.height_field`, or a choice of
                  terrains of which each episode draws one, see `terrain.pool`
    load          "nonuniform": every patch on its own springs; "uniform": one foot on the tangent
                  plane, its load shared by all patches
    patches       (along, across) a track
    soil_at       "centre": one soil under the vehicle, that of its centre of mass; "patches": under
                  each patch the soil of its place at the beginning of the control step
    stiffness     [N/m^3] k_A of the ground, per area;  damping [N s/m^3] d_A; both times the
                  parameter `ground_stiffness_factor`
    stiffening    [s/m^2] K_tp of the stiffness with speed
    centre_of_mass_height [m], nominal, roll_inertia, pitch_inertia [kg m^2]: numbers, or None
    longest_step  [s] longer integration steps are divided
    tilt_limit    [rad] of the up axis against the vertical, beyond which an episode ends
Defaults and their sources are in `plants.terrain_options`.
How a row of the batch becomes a moving body, and back, is in `plants.terrain_state`.
References: [1] Focchi et al. (2025), table 2 and section 8.
"""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.engine.columns import Batch
from tracked_env.engine.kernels import Block, Pace, advance_blocks, hold_blocks
from tracked_env.physics import ground_contact as g
from tracked_env.physics import state as s
from tracked_env.physics import terrain_motion, vehicle
from tracked_env.physics.attitude import matrix_of
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import (
    OF_TORQUE_DRIVES,
    PARAMETER_NAMES,
    PlantParameters,
    row_parameters,
)
from tracked_env.physics.patch_dynamics import Belts
from tracked_env.physics.state import VehicleState
from tracked_env.physics.terrain_motion import LINEAR
from tracked_env.physics.tracked_body import body_of, height_at_rest, set_soil
from tracked_env.plants.base import Ground, Plant, Prepared
from tracked_env.plants.derived import derive_free
from tracked_env.plants.distributed import DISTRIBUTED, LATERAL_LAW, given_by_drives, rolling
from tracked_env.plants.terrain_options import (
    DEFAULTS,
    LOADS,
    ROTATIONAL,
    SOIL_AT,
    made_of,
    patches_of,
    resting,
)
from tracked_env.plants.terrain_state import (
    FAILURES,
    OWN_COLUMNS,
    RELIEF,
    RESISTANCE_LEFT,
    RESISTANCE_RIGHT,
    moving_body,
    write,
)
from tracked_env.terrain import ground as terrain_ground
from tracked_env.terrain.drawn_relief import RELIEF_SIZE, fill_there, ground_at
from tracked_env.terrain.flat import level
from tracked_env.terrain.pool import make_pool, member_of
from tracked_env.validation import checked_choice

Floats = NDArray[np.float64]
_TORQUE_LEFT, _TORQUE_RIGHT = b.STATE + s.TORQUE_LEFT, b.STATE + s.TORQUE_RIGHT
_NOTHING_HELD = np.zeros((1, 0))  # commands come from the actions


@formula
def _soil_under_patches(batch, i, period, w, pose, body):
    """The same, each patch with the soil of its place; pose: of the centre of mass."""
    terrain = terrain_ground.Terrain(
        batch.floats, batch.events, i, batch.counters[i, b.EVENT_COUNT],
        batch.counters[i, b.STEP] * period,
    )  # fmt: skip
    g.locate(w, 2 * body.patches, (pose.x, pose.y, pose.z), matrix_of(pose.q), body.footing.height)
    for lane in range(2 * body.patches):
        there = terrain_ground.at(level, terrain, w[g.PLACE_X, lane], w[g.PLACE_Y, lane])
        set_soil(w, lane, lane + 1, there.soil, body.footing.patch_area)


@formula
def _demanded(floats, i, p, by_torque, held):
    """What the drives of vehicle i are to give: belt speeds [m/s] or torques [N m].

    held: sprocket speeds [rad/s] or torques of all vehicles, (N, 2), or (N, 4) with those at the
    beginning first and those at the end last; empty where the action says it. Returns (at the
    beginning, at the end, whether the change is linear in time).
    """
    last = held.shape[1] - 2
    if last < 0:
        largest = p.torque_limit if by_torque else p.sprocket_speed_limit * p.sprocket_radius
        asked = Belts(floats[i, b.ACTION] * largest, floats[i, b.ACTION + 1] * largest)
        asked = given_by_drives(asked, p, by_torque)
        return asked, asked, False
    factor = 1.0 if by_torque else p.sprocket_radius
    begin = Belts(held[i, 0] * factor, held[i, 1] * factor)
    end = Belts(held[i, last] * factor, held[i, last + 1] * factor)
    return given_by_drives(begin, p, by_torque), given_by_drives(end, p, by_torque), last > 0


@formula
def _move(batch, w, block, pace, options):
    """Advance (pace.substeps > 0) and settle the vehicle of the block.

    options: held commands as in `_demanded`, reliefs of the pool, columns and rows of the patches,
    numbers of the plant's options, by_torque, uniform, per_patch.
    """
    i = block.chosen[block.first]
    held, reliefs, columns, rows, made, by_torque, uniform, per_patch = options
    floats = batch.floats
    relief = member_of(reliefs, int(floats[i, RELIEF + RELIEF_SIZE]))
    p = row_parameters(floats, i, b.PARAMETERS)
    base, count = row_parameters(floats, i, b.BASE), columns.size * rows.size
    body = body_of(p, g.padded(2 * count), count, made, by_torque, uniform)
    lanes = g.place_patches(w, columns, rows, 0.5 * p.track_gauge, p.track_width, body.footing)
    rest_height = height_at_rest(base, made)
    pose, twist, belts = moving_body(floats, i, p, rest_height)
    set_soil(w, 0, lanes, p, body.footing.patch_area)
    if per_patch and batch.counters[i, b.EVENT_COUNT] > 0:
        _soil_under_patches(batch, i, pace.period, w, pose, body)
    command = belts
    if by_torque:
        command = Belts(floats[i, _TORQUE_LEFT], floats[i, _TORQUE_RIGHT])
    demand, decay, steps, h = command, 0.0, 0, 0.0
    if pace.substeps > 0:
        begin, demand, linear = _demanded(floats, i, p, by_torque, held)
        steps = math.ceil(pace.substeps * pace.h / made[9] - 1e-9)
        h = pace.substeps * pace.h / steps
        decay = vehicle.torque_decay(h, p.drive_time_constant)
        if linear:
            command, decay = begin, LINEAR
    end, command, kick, off = terrain_motion.advance(
        fill_there, (relief, floats, i, RELIEF), w, (pose, twist, belts), command, demand, decay,
        steps, h, body,
    )  # fmt: skip
    settled = terrain_motion.settled_of(w, kick, off, body)
    write(floats, i, end, command, settled, p, body, rest_height, made[10])


@loop
def advance(
    floats, counters, profile, events, noise, history, chosen, actions, observations,
    start, stop, moving, substeps, substep, error_limit,
    held, reliefs, columns, rows, made, by_torque, uniform, per_patch,
):  # fmt: skip
    """Kernel of the control step, see `engine.kernels`."""
    scratch = np.empty((g.SCRATCH_ROWS, g.LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
    clock = (start, stop, moving, substeps, substep, error_limit)
    rest = (*clock, held, reliefs, columns, rows, made, by_torque, uniform, per_patch)
    return advance_blocks(derive_free, _move, 1, scratch, batch, given, rest)


@loop
def hold(*call):
    """Kernel of the plant alone, on uniform soil; what is held comes before the plant's options."""
    scratch = np.empty((g.SCRATCH_ROWS, g.LANES))
    return hold_blocks(derive_free, _move, 1, scratch, call[:12] + call[13:])


@loop
def settle(
    floats, counters, profile, events, noise, history, period,
    held, reliefs, columns, rows, made, by_torque, uniform, per_patch,
):  # fmt: skip
    """Settle vehicle 0 of a batch; returns the load [N] of each patch (2, rows, columns)."""
    scratch = np.empty((g.SCRATCH_ROWS, g.LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    rest = (held, reliefs, columns, rows, made, by_torque, uniform, per_patch)
    _move(batch, scratch, Block(np.zeros(1, dtype=np.int64), 0, 1), Pace(0, 0.0, period), rest)
    found = scratch[g.LOAD, : 2 * rows.size * columns.size].copy()
    return found.reshape(2, rows.size, columns.size)


@loop
def motion_resistances(floats, i):
    """Motion resistance [N] of the left and the right track of vehicle i."""
    return floats[i, RESISTANCE_LEFT], floats[i, RESISTANCE_RIGHT]


def _prepare(drive: str, options: Mapping[str, Any]) -> Prepared:
    pool = make_pool(options["terrain"])
    columns, rows = patches_of(options["patches"])
    uniform = checked_choice("load", options["load"], LOADS) == "uniform"
    per_patch = checked_choice("soil_at", options["soil_at"], SOIL_AT) == "patches"
    made = made_of(options)

    def at(floats: Floats, row: int, x: float, y: float) -> Floats:
        places = np.array([[x]]), np.array([[y]])
        return ground_at(pool.reliefs, floats, RELIEF, np.array([row]), *places)[0, :, 0]

    def place(floats: Floats, chosen: NDArray[np.int64]) -> None:
        """Belts that roll over the ground without slip, the vehicle on its slope."""
        for i in chosen.tolist():
            own = floats[i]
            parameters = PlantParameters(*own[b.BASE : b.BASE + len(PARAMETER_NAMES)].tolist())
            state = VehicleState(*own[b.STATE : b.STATE + s.STATE_ROWS].tolist())
            pose = resting(partial(at, floats, i), parameters, made, state.x, state.y, state.yaw)
            placed = rolling(parameters, state)._replace(z=pose.z, pitch=pose.pitch, roll=pose.roll)
            own[b.STATE : b.STATE + s.STATE_ROWS] = placed

    def heights(floats: Floats, chosen: NDArray[np.int64], x: Floats, y: Floats) -> Floats:
        return ground_at(pool.reliefs, floats, RELIEF, chosen, x, y)[:, 0]

    def loads(batch: Batch, row: int) -> Floats:
        own = b.allocate(1, 1, OWN_COLUMNS)._replace(
            floats=batch.floats[[row]], counters=batch.counters[[row]], events=batch.events[[row]]
        )  # a copy of the row: nothing of the episode changes
        along = np.argsort(columns)  # from the rear to the front
        return settle(*own, 0.0, *chosen)[:, :, along].transpose(0, 2, 1)

    def centre_height(p: PlantParameters) -> float:
        return float(height_at_rest(p, made))

    unread = frozenset(name + "_ratio" for name in ROTATIONAL if options[name] is not None)
    flags = (drive == "torque", uniform, per_patch)
    chosen = (_NOTHING_HELD, pool.reliefs, columns, rows, made, *flags)
    ground = Ground(place, heights, loads, centre_height, float(made[10]))
    terrains = len(pool.fields)
    return Prepared(advance, hold, chosen, unread=unread, ground=ground, terrains=terrains)


_READ = frozenset(PARAMETER_NAMES) - LATERAL_LAW
TERRAIN = Plant(
    name="terrain",
    reads={"torque": _READ, "speed": _READ - OF_TORQUE_DRIVES},
    prepare=_prepare,
    motion_resistances=motion_resistances,
    options=DEFAULTS,
    columns=OWN_COLUMNS,
    failures=FAILURES,
    relief_column=RELIEF,
    threads_from=16,
    panel=DISTRIBUTED.panel,
    soil_map=(*DISTRIBUTED.soil_map, "ground_stiffness_factor"),
)
