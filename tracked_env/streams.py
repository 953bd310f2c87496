"""NumPy's generators inside kernels: the numbers of `Generator` methods, drawn from its stream.

A kernel takes the address of a generator's `bitgen_t`, NumPy's documented C interface [1]: a
pointer to its state and the functions that draw from it. The generator itself moves on, so what
Python draws afterwards continues where the kernel has stopped. Any bit generator will do.

References: [1] NumPy, "Random: extending" and `BitGenerator.ctypes`. [2] Lemire, ACM TOMACS 29
(2019) 1, integers without bias.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from tracked_env.physics.jit import formula


def addresses(generators: Iterable[np.random.Generator]) -> NDArray[np.int64]:
    """Addresses (n,) for kernels; valid while the generators live."""
    found = [generator.bit_generator.ctypes.bit_generator.value for generator in generators]
    return np.array(found, dtype=np.int64)


def _drawn(builder, address, field, result):
    """Call a function of the bitgen_t at `address` with its state."""
    pointer = ir.IntType(8).as_pointer()
    fields = builder.inttoptr(address, pointer.as_pointer())
    state = builder.load(fields)
    draw = builder.load(builder.gep(fields, [ir.Constant(ir.IntType(32), field)]))
    draw = builder.bitcast(draw, ir.FunctionType(result, [pointer]).as_pointer())
    return builder.call(draw, [state])


def _drawing(field: int, result: types.Type, lowered: ir.Type) -> Any:
    """An intrinsic (address) -> the next number, by that function of the bitgen_t."""

    def draw(typing_context, rng):
        def code(context, builder, signature, arguments):
            return _drawn(builder, arguments[0], field, lowered)

        return result(types.int64), code

    return intrinsic(draw)


_next64 = _drawing(1, types.uint64, ir.IntType(64))
_next32 = _drawing(2, types.uint32, ir.IntType(32))
_next_double = _drawing(3, types.float64, ir.DoubleType())


@formula
def random(rng):
    """Generator.random(): uniform in [0, 1)."""
    return _next_double(rng)


@formula
def uniform(rng, low, high):
    """Generator.uniform(low, high)."""
    return low + (high - low) * _next_double(rng)


@formula
def integer(rng, count):
    """Generator.integers(count), 1 <= count < 2^32, by Lemire's multiplication [2]."""
    if count == 1:
        return 0
    span = np.uint64(count)
    product = np.uint64(_next32(rng)) * span
    low = product & np.uint64(0xFFFFFFFF)
    if low < span:
        least = (np.uint64(0x100000000) - span) % span
        while low < least:
            product = np.uint64(_next32(rng)) * span
            low = product & np.uint64(0xFFFFFFFF)
    return np.int64(product >> np.uint64(32))


@formula
def seed(rng):
    """Generator.integers(2**63)."""
    return np.int64(_next64(rng) >> np.uint64(1))
