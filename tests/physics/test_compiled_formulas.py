"""Every formula gives the same bits compiled and as plain Python."""

import math

import numpy as np
import pytest
from numba import njit
from numba.core.registry import CPUDispatcher

from tests.physics.patch_cases import FOCCHI, PATCHES, parts
from tracked_env.physics import (
    elementary,
    level_motion,
    lumped,
    parameters,
    patches_on_level_ground,
    terramechanics,
)
from tracked_env.physics.jit import formula, loop, prefetch, summation
from tracked_env.physics.level_motion import Drives, Pose, Rates
from tracked_env.physics.lumped import Loads, Motion
from tracked_env.physics.parameters import plant_parameters
from tracked_env.physics.patches_on_level_ground import LANES, SCRATCH_ROWS, Belts

CLAY = plant_parameters()
DRIVE = lumped.drive_limits(CLAY)
K = lumped.coefficients(CLAY, False)
K_FIXED = lumped.coefficients(CLAY, True)
TURN = Motion(2.0, -0.013, 0.23)
BACK = Motion(-0.03, 0.4, -1.7)
LIMITS = lumped.traction_limits(TURN, K.half_gauge, DRIVE)
TORQUES = ((300.0, 2300.0), (-900.0, 7e3))
LOADS = [(m, *t, k, LIMITS) for m in (TURN, BACK) for t in TORQUES for k in (K, K_FIXED)]
NUMBERS = (-650.3, -1.0, -1e-9, 0.0, 0.03, 0.7, 33.3)
POSITIVE = np.random.default_rng(0).uniform(0.01, 3.0, (20, 5))
RK4_TORQUES = ((300.0, 2300.0), (310.0, 2290.0), (320.0, 2280.0))

FLOOR, FLOOR_DRIVE, CONTACT = parts(FOCCHI)
SCRATCH = np.zeros((SCRATCH_ROWS, LANES))
BELTS, COMMAND, DEMAND = Belts(1.7, 2.3), Belts(20.0, -3.0), Belts(9.0, 0.5)
RATES, OTHER_RATES = Rates(1.0, -2.0, 0.5, 0.3, -4.0), Rates(0.3, 0.1, -0.7, -2.0, 9.0)
SHEAR = [
    (SCRATCH, m, b, (CONTACT, c), PATCHES)
    for m in (TURN, BACK)
    for b in (BELTS, Belts(0.0, -1.0))
    for c in (CONTACT, CONTACT._replace(strength=0.5 * CONTACT.strength))
]
DRAGS = [patches_on_level_ground.resistance(*arguments) for arguments in SHEAR]
INVERSE_BELT_MASSES = (0.0, 0.147)
POSE = Pose(1.0, 2.0, 0.7, math.cos(0.7), math.sin(0.7))
VEHICLES = [
    level_motion.on_one_soil(FLOOR, FLOOR_DRIVE, CONTACT, mass) for mass in INVERSE_BELT_MASSES
]
MOVES = [
    (SCRATCH, (POSE, m, BELTS), Drives(COMMAND, DEMAND, decay), 3, 0.0025, vehicle, PATCHES, euler)
    for m in (TURN, BACK)
    for decay in (0.0, 0.7)
    for vehicle in VEHICLES
    for euler in (False, True)
]

ARGUMENTS = {
    lumped: {
        "track_limits": [(v, DRIVE) for v in NUMBERS],
        "traction_limits": [(TURN, 0.85, DRIVE), (BACK, 0.85, DRIVE)],
        "safe_effort": [(TURN, 5e3, 0.85, DRIVE), (TURN, 5e5, 0.85, DRIVE)],
        "sliding_loads": LOADS,
        "constrained_loads": LOADS,
        "sliding_accelerations": LOADS,
        "constrained_accelerations": LOADS,
        "track_slip": [(f, v, DRIVE) for f in (-5e4, 4e3) for v in NUMBERS],
        "drive_limits": [(CLAY,)],
        "track_speeds": [(TURN, 0.85)],
        "coefficients": [(CLAY, False), (CLAY, True)],
        "inertial_acceleration": [(TURN, 0.3, -0.2)],
        "torque_decay": [(0.00125, 0.05), (0.00125, 0.0)],
        "kinetic_energy": [(TURN, CLAY)],
        "rk4_step": [
            (lumped.sliding_accelerations, TURN, *RK4_TORQUES, K, LIMITS, 0.0025),
            (lumped.constrained_accelerations, TURN, *RK4_TORQUES, K_FIXED, LIMITS, 0.0025),
        ],
    },
    parameters: {"row_parameters": [(np.arange(60.0).reshape(2, 30), 1, 3)]},
    patches_on_level_ground: {
        "patch_count": [(PATCHES,)],
        "resistance": SHEAR,
        "contact_of": [(FOCCHI, FLOOR, FLOOR_DRIVE, PATCHES)],
    },
    level_motion: {
        "damped": [(r, RATES, FLOOR, c, 0.001) for r in DRAGS for c in INVERSE_BELT_MASSES],
        "pushed": [(TURN, RATES, 0.01)],
        "combined": [(RATES, OTHER_RATES, 1.5, -0.5)],
        "departure": [
            (r, RATES, OTHER_RATES, FLOOR, c, 0.001) for r in DRAGS for c in INVERSE_BELT_MASSES
        ],
        "followed": [(BELTS, COMMAND, decay) for decay in (0.0, 0.7)],
        "on_one_soil": [(FLOOR, FLOOR_DRIVE, CONTACT, 0.147)],
        "loads_of": [(r, m, BELTS, FLOOR, (9.0, 3.0)) for r in DRAGS for m in (TURN, BACK)],
        "driving_torque": [(t, v, 0.25) for t in (-3.0, 7.0) for v in NUMBERS],
        "rates_of": [
            (Loads(3.0, 9.0, 1.0, 1.0, -7.0, 2.0), TURN, BELTS, BELTS, FLOOR, FLOOR_DRIVE, c)
            for c in INVERSE_BELT_MASSES
        ],
        "advance": MOVES,
    },
}
LOOPS = {"hold_speeds"}  # they write into arrays: compared below


def formulas(module):
    """Names of the public compiled functions of a module."""
    return {
        name
        for name, value in vars(module).items()
        if isinstance(value, CPUDispatcher) and value.py_func.__module__ == module.__name__
        if not name.startswith("_")
    }


for of_numbers in (elementary, terramechanics):  # at positive numbers, the first of either sign
    counts = {n: getattr(of_numbers, n).py_func.__code__.co_argcount for n in formulas(of_numbers)}
    ARGUMENTS[of_numbers] = {
        name: [tuple(row[:count]) for row in POSITIVE]
        + [(x, *POSITIVE[0, : count - 1]) for x in NUMBERS if "shear" not in name]
        for name, count in counts.items()
    }


def _flat(value):
    return [x for part in value for x in _flat(part)] if isinstance(value, tuple) else [value]


@pytest.mark.parametrize("module", ARGUMENTS, ids=lambda module: module.__name__.split(".")[-1])
def test_every_public_formula_of_the_module_is_sampled(module):
    assert formulas(module) - LOOPS == set(ARGUMENTS[module])


@pytest.mark.parametrize(
    ("module", "name"),
    [(module, name) for module, names in ARGUMENTS.items() for name in names],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_compiled_equals_pure_python_bit_for_bit(module, name):
    formula = getattr(module, name)
    for arguments in ARGUMENTS[module][name]:
        compiled, pure = _flat(formula(*arguments)), _flat(formula.py_func(*arguments))
        assert np.array_equal(compiled, pure), arguments


@pytest.mark.parametrize("euler", [False, True], ids=["rosenbrock", "euler"])
def test_the_loop_over_vehicles_equals_pure_python_bit_for_bit(euler):
    speeds, table = np.array([[3.0, 4.0], [0.0, -5.0]]), np.array([FOCCHI, CLAY])
    start = np.array([[1.0, 2.0, 0.7, 0.3, 0.0, 0.1], [0.0, 0.0, -3.0, -0.4, 0.2, 1.0]])
    results = []
    for kernel in (level_motion.hold_speeds, level_motion.hold_speeds.py_func):
        states, loads = start.copy(), np.zeros((2, 6))
        kernel(states, speeds, table, PATCHES, 4, 0.0025, euler, loads)
        results.append(np.concatenate([states, loads], axis=1))
    assert np.array_equal(*results)
    assert not np.array_equal(results[0][:, :6], start)


def test_the_resistance_of_the_soil_equals_pure_python_all_the_way_down(monkeypatch):
    inner = ("_place", "_columns", "_row", "_pair", "patch_count", "exponential", "rotation")
    compiled = [patches_on_level_ground.resistance(*arguments) for arguments in SHEAR]
    for name in inner:
        monkeypatch.setattr(
            patches_on_level_ground, name, getattr(patches_on_level_ground, name).py_func
        )
    for arguments, expected in zip(SHEAR, compiled, strict=True):
        assert patches_on_level_ground.resistance.py_func(*arguments) == expected


@formula
def _to_integer(x):
    """Round x to an integer: the sum has no bits left for fractions."""
    return (x + elementary.ROUND_MAGIC) - elementary.ROUND_MAGIC


@summation
def _sum_of_integers(x):
    total = 0.0
    for k in range(x.size):
        total += _to_integer(x[k])
    return total


@loop
def _called_first(x):
    return _sum_of_integers(x)


def test_a_formula_keeps_its_rounding_when_a_sum_that_may_be_reordered_compiles_it_first():
    """What a formula leaves open of its options it would take from the caller being compiled."""
    assert _called_first(np.array([0.3, 1.4, 2.6])) == 4.0


@formula
def _doubled(x):
    return 2.0 * x


@loop
def _calls_it(x):
    return _doubled(x)


def test_a_formula_gets_an_entry_for_python_only_where_python_calls_it():
    assert _calls_it(1.5) == 3.0
    assert not _doubled.signatures, "it was compiled for Python because a kernel calls it"
    assert _doubled(1.5) == 3.0
    assert len(_doubled.signatures) == 1


@njit  # not from disk, where the code cannot be looked at
def _fetch(values, i, j):
    prefetch(values, (i, j))


def test_a_prefetch_is_one_instruction_that_changes_nothing_wherever_it_points():
    values = np.arange(12.0).reshape(3, 4)
    for place in (2, 3, -1, 10**12, -(10**12)):
        _fetch(values, place, 3)
    assert np.array_equal(values, np.arange(12.0).reshape(3, 4))
    (code,) = _fetch.inspect_llvm().values()
    assert "call void @llvm.prefetch" in code
