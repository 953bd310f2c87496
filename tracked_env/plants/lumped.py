"""The lumped plant: closed-form forces of each track, after Strawa et al. (2021).

Forces and equations of motion are in `physics.lumped_forces`; the torques follow their demand by
the drive's lag. Option `lateral`: "sliding", or "constrained" to v_y = -d w at all times.

Vehicles are copied into a scratch array, `LANES` at a time, moved there (`lumped_block`), and
copied back.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tracked_env.engine import columns as b
from tracked_env.engine.columns import Batch
from tracked_env.engine.kernels import advance_blocks, hold_blocks
from tracked_env.physics import lumped_forces, vehicle
from tracked_env.physics import state as s
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop, template
from tracked_env.physics.parameters import (
    IN_SPACE,
    PARAMETER_INDEX,
    PARAMETER_NAMES,
    PlantParameters,
)
from tracked_env.physics.state import VehicleState
from tracked_env.plants.base import Plant, Prepared
from tracked_env.plants.derived import derive, derive_free, derived
from tracked_env.plants.lumped_block import (
    COSINE,
    DECAY,
    DEMAND_LEFT,
    DEMAND_RIGHT,
    DERIVED,
    INTEGRATED,
    LANES,
    PLANAR,
    SCRATCH_ROWS,
    SINE,
    integrate_constrained,
    integrate_sliding,
    settle_constrained,
    settle_sliding,
)
from tracked_env.validation import checked_choice

WIDTH = 8  # lanes that the loops do at once; the rest of a block would go one by one
LATERAL = ("sliding", "constrained")
_TORQUE_LIMIT = b.PARAMETERS + PARAMETER_INDEX["torque_limit"]
_GAIN_LEFT = b.PARAMETERS + PARAMETER_INDEX["actuator_gain_left"]
_GAIN_RIGHT = b.PARAMETERS + PARAMETER_INDEX["actuator_gain_right"]


@formula
def _asked(floats, i, options):
    """Torques [N m] that the action of vehicle i asks for, left and right."""
    limit = floats[i, _TORQUE_LIMIT]
    return limit * floats[i, b.ACTION], limit * floats[i, b.ACTION + 1]


@formula
def _held(floats, i, options):
    """Torques [N m] that are given for vehicle i, left and right: options[0] (N, 2)."""
    return options[0][i, 0], options[0][i, 1]


@formula
def _load(demand, floats, w, block, options):
    """Copy the vehicles of the block into the scratch array; demand: `_asked` or `_held`."""
    for lane in range(block.lanes):
        i = block.chosen[block.first + lane]
        for row in range(INTEGRATED):
            w[row, lane] = floats[i, b.STATE + row]
        for row in range(b.COEFFICIENT_COUNT + b.DRIVE_COUNT):
            w[DERIVED + row, lane] = floats[i, b.COEFFICIENTS + row]
        left, right = demand(floats, i, options)
        w[DEMAND_LEFT, lane] = floats[i, _GAIN_LEFT] * left
        w[DEMAND_RIGHT, lane] = floats[i, _GAIN_RIGHT] * right
        w[DECAY, lane] = floats[i, b.TORQUE_DECAY]
    for lane in range(block.lanes):
        w[COSINE, lane], w[SINE, lane] = rotation(w[s.YAW, lane])


@formula
def _filled(w, lanes):
    """Lanes of the block with copies of the last one up to a multiple of WIDTH; 1 stays 1."""
    if lanes == 1:
        return 1
    filled = -(-lanes // WIDTH) * WIDTH
    for row in range(SCRATCH_ROWS):
        for lane in range(lanes, filled):
            w[row, lane] = w[row, lanes - 1]
    return filled


@formula
def _store(floats, w, block):
    """Copy the state of the scratch block back."""
    for lane in range(block.lanes):
        i = block.chosen[block.first + lane]
        for row in range(PLANAR):
            floats[i, b.STATE + row] = w[row, lane]


@template
def _move(demand, integrate, settle, floats, w, block, pace, options):
    """Advance (pace.substeps > 0) and settle one block of vehicles in the scratch array w.

    integrate, settle: of one lateral model, so that a kernel does not compile the other as well.
    """
    _load(demand, floats, w, block, options)
    lanes = _filled(w, block.lanes)
    integrate(w, lanes, pace.substeps, pace.h)
    settle(w, lanes)
    _store(floats, w, block)


@formula
def _move_sliding(batch, w, block, pace, options):
    """As `advance_blocks` takes it."""
    _move(_asked, integrate_sliding, settle_sliding, batch.floats, w, block, pace, options)


@formula
def _move_constrained(batch, w, block, pace, options):
    """The same with the lateral motion constrained."""
    _move(_asked, integrate_constrained, settle_constrained, batch.floats, w, block, pace, options)


@formula
def _hold_sliding(batch, w, block, pace, options):
    """As `hold_blocks` takes it."""
    _move(_held, integrate_sliding, settle_sliding, batch.floats, w, block, pace, options)


@formula
def _hold_constrained(batch, w, block, pace, options):
    """The same with the lateral motion constrained."""
    _move(_held, integrate_constrained, settle_constrained, batch.floats, w, block, pace, options)


@formula
def _derive_constrained(floats, i, substep):
    """Refresh what follows from the parameters of vehicle i where v_y = -d w."""
    derive(floats, i, substep, True)


@loop
def advance_sliding(
    floats, counters, profile, events, noise, history, chosen, actions, observations,
    start, stop, moving, substeps, substep, error_limit,
):  # fmt: skip
    """Kernel of the control step, see `engine.kernels`."""
    scratch = np.empty((SCRATCH_ROWS, LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
    rest = (start, stop, moving, substeps, substep, error_limit)
    return advance_blocks(derive_free, _move_sliding, LANES, scratch, batch, given, rest)


@loop
def advance_constrained(
    floats, counters, profile, events, noise, history, chosen, actions, observations,
    start, stop, moving, substeps, substep, error_limit,
):  # fmt: skip
    """The same with the lateral motion constrained."""
    scratch = np.empty((SCRATCH_ROWS, LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
    rest = (start, stop, moving, substeps, substep, error_limit)
    return advance_blocks(
        _derive_constrained, _move_constrained, LANES, scratch, batch, given, rest
    )


@loop
def hold_sliding(*call):
    """Kernel of the plant alone."""
    scratch = np.empty((SCRATCH_ROWS, LANES))
    return hold_blocks(derive_free, _hold_sliding, LANES, scratch, call)


@loop
def hold_constrained(*call):
    """The same with the lateral motion constrained."""
    scratch = np.empty((SCRATCH_ROWS, LANES))
    return hold_blocks(_derive_constrained, _hold_constrained, LANES, scratch, call)


@loop
def motion_resistances(floats, i):
    """Motion resistance [N] of the left and the right track of vehicle i."""
    state = b.STATE
    motion = vehicle.Motion(
        floats[i, state + s.V_X], floats[i, state + s.V_Y], floats[i, state + s.YAW_RATE]
    )
    k, drive = derived(floats, i)
    limits = lumped_forces.traction_limits(motion, k.half_gauge, drive)
    left, right = floats[i, state + s.TORQUE_LEFT], floats[i, state + s.TORQUE_RIGHT]
    loads = lumped_forces.sliding_loads(motion, left, right, k, limits)
    return loads.resistance_left, loads.resistance_right


def _start_constrained(parameters: PlantParameters, state: VehicleState) -> VehicleState:
    """The lateral velocity is what the yaw rate makes it."""
    return state._replace(v_y=-parameters.icr_forward * state.yaw_rate)


def _prepare(drive: str, options: Mapping[str, Any]) -> Prepared:
    if checked_choice("lateral model", options["lateral"], LATERAL) == "constrained":
        return Prepared(
            advance_constrained, hold_constrained, (), _start_constrained,
            variant=" with constrained tracks",
        )  # fmt: skip
    emerging = frozenset({"icr_forward"})  # the instantaneous centre of rotation follows
    return Prepared(advance_sliding, hold_sliding, unread=emerging, variant=" with sliding tracks")


LUMPED = Plant(
    name="lumped",
    reads={"torque": frozenset(PARAMETER_NAMES) - {"sprocket_inertia"} - IN_SPACE},
    prepare=_prepare,
    motion_resistances=motion_resistances,
    options={"lateral": "sliding"},
    lanes=LANES,
    threads_from=512,
    panel=(
        "mass", "inertia", "lateral_resistance", "longitudinal_resistance", "cohesion",
        "friction_angle", "shear_deformation_modulus",
    ),
    soil_map=(
        "lateral_resistance", "longitudinal_resistance", "cohesion", "friction_angle",
        "shear_deformation_modulus",
    ),
)  # fmt: skip
