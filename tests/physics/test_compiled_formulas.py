"""Every formula gives the same bits compiled and as plain Python, all the way down."""

import math
from types import FunctionType, ModuleType, SimpleNamespace

import numpy as np
import pytest
from numba import njit
from numba.core.registry import CPUDispatcher

from tests.physics.patch_cases import FOCCHI, PATCHES, parts
from tracked_env.physics import elementary, level_motion, lumped, terramechanics
from tracked_env.physics import patches_on_level_ground as level
from tracked_env.physics.jit import formula, loop, prefetch, summation
from tracked_env.physics.level_motion import Drives, Pose
from tracked_env.physics.lumped import Motion
from tracked_env.physics.parameters import plant_parameters
from tracked_env.physics.patches_on_level_ground import Belts

CLAY = plant_parameters()
DRIVE = lumped.drive_limits(CLAY)
TURN, BACK = Motion(2.0, -0.013, 0.23), Motion(-0.03, 0.4, -1.7)
NUMBERS = (-650.3, -1.0, -1e-9, 0.0, 0.03, 0.7, 33.3)
POSITIVE = np.random.default_rng(0).uniform(0.01, 3.0, (20, 5)).tolist()
TORQUES = [((300.0, 2300.0), (310.0, 2290.0), (320.0, 2280.0)), ((-900.0, 7e3),) * 3]
MODELS = [(lumped.sliding_accelerations, False), (lumped.constrained_accelerations, True)]

FLOOR, FLOOR_DRIVE, CONTACT = parts(FOCCHI)
SCRATCH = np.zeros((level.SCRATCH_ROWS, level.LANES))
BELTS, COMMAND, DEMAND = Belts(1.7, 2.3), Belts(20.0, -3.0), Belts(9.0, 0.5)
POSE = Pose(1.0, 2.0, 0.7, math.cos(0.7), math.sin(0.7))
VEHICLES = [level_motion.on_one_soil(FLOOR, FLOOR_DRIVE, CONTACT, mass) for mass in (0.0, 0.147)]
# Formulas that no other one of the list calls, with arguments.
CALLS = {
    lumped.rk4_step: [
        (model, motion, *torques, lumped.coefficients(CLAY, fixed), limits, 0.0025)
        for model, fixed in MODELS
        for motion in (TURN, BACK)
        for torques in TORQUES
        for limits in (lumped.traction_limits(motion, 0.85, DRIVE),)
    ],
    lumped.traction_limits: [(motion, 0.85, DRIVE) for motion in (TURN, BACK)],
    lumped.safe_effort: [(TURN, 5e3, 0.85, DRIVE), (TURN, 5e5, 0.85, DRIVE)],
    lumped.track_slip: [(f, v, DRIVE) for f in (-5e4, 4e3) for v in NUMBERS],
    lumped.inertial_acceleration: [(TURN, 0.3, -0.2)],
    lumped.torque_decay: [(0.00125, 0.05), (0.00125, 0.0)],
    lumped.drive_limits: [(CLAY,), (FOCCHI,)],
    lumped.turning_effort: [(CLAY,), (FOCCHI,)],
    lumped.coefficients: [(CLAY, False), (CLAY, True)],
    level_motion.advance: [
        (SCRATCH, (POSE, m, BELTS), Drives(COMMAND, DEMAND, decay), 3, 0.0025, v, PATCHES, euler)
        for m in (TURN, BACK)
        for decay in (0.0, 0.7)
        for v in VEHICLES
        for euler in (False, True)
    ],
    level.resistance: [
        (SCRATCH, m, b, (CONTACT, CONTACT._replace(strength=share * CONTACT.strength)), PATCHES)
        for m in (TURN, BACK)
        for b in (BELTS, Belts(0.0, -1.0))
        for share in (1.0, 0.5)
    ],
}
MODULES = (elementary, terramechanics, lumped, level, level_motion)


def formulas(module):
    """The public compiled functions of a module."""
    public = (f for name, f in vars(module).items() if name[0] != "_")
    kernels = (f for f in public if isinstance(f, CPUDispatcher))
    return {f for f in kernels if f.py_func.__module__ == module.__name__}


BARE = formulas(elementary) | formulas(terramechanics)
# The first number of either sign. Sorted: workers must find the tests in one order.
for each in sorted(BARE, key=lambda one: one.__name__):
    count = each.py_func.__code__.co_argcount
    CALLS[each] = [tuple(row[:count]) for row in POSITIVE]
    if "shear" not in each.__name__:
        CALLS[each] += [(x, *POSITIVE[0][: count - 1]) for x in NUMBERS]


def pure(value, reached):
    """A kernel, or a module of kernels, as plain Python with all that it calls; else the value.

    reached: {kernel: its plain function}, gets those that were met.
    """
    if not isinstance(value, CPUDispatcher):
        return value
    if value not in reached:
        code, scope = value.py_func.__code__, dict(value.py_func.__globals__)
        reached[value] = FunctionType(code, scope, value.__name__, value.py_func.__defaults__)
        for name in code.co_names:
            if isinstance(scope.get(name), ModuleType) and "tracked_env" in scope[name].__name__:
                inside = {n: vars(scope[name])[n] for n in code.co_names if n in vars(scope[name])}
                scope[name] = SimpleNamespace(**{n: pure(v, reached) for n, v in inside.items()})
            elif name in scope:
                scope[name] = pure(scope[name], reached)
    return reached[value]


def _flat(value):
    return [x for part in value for x in _flat(part)] if isinstance(value, tuple) else [value]


def test_every_public_formula_is_called_by_those_that_are_compared():
    reached = {}
    for function in (*CALLS, *(model for model, _ in MODELS), level_motion.hold_speeds):
        pure(function, reached)
    assert {f.__name__ for m in MODULES for f in formulas(m) - reached.keys()} == set()


@pytest.mark.parametrize("function", CALLS, ids=lambda function: function.__name__)
def test_compiled_equals_pure_python_bit_for_bit(function):
    for arguments in CALLS[function]:
        plain = pure(function, {})(*(pure(argument, {}) for argument in arguments))
        assert np.array_equal(_flat(function(*arguments)), _flat(plain)), arguments


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
