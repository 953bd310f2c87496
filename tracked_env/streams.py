"""Random numbers inside kernels: NumPy's generators, and the sensor noise of every vehicle.

A kernel draws from a `Generator` by the address of its `bitgen_t`, NumPy's documented C interface
[1]: a pointer to the state and the functions that draw from it. The generator itself moves on, so
that Python continues where a kernel has stopped. Any bit generator will do.

Noise has one row of state per vehicle, (STATE,) uint64: four words of SFC64, the unused half of its
last number, and whether there is one. Its numbers are those of
`Generator(SFC64(seed)).standard_normal(dtype=float32)`, bit for bit:
    seed -> SeedSequence [3] -> 192 bits -> SFC64 [4] -> 32 bits r -> ziggurat [5] of 256 layers
Layer k = r mod 256, sign = bit 8, m = the 23 bits above: x = m w_k is accepted where m < k_k, else
the wedge below exp(-x^2 / 2) or, in layer 0, the tail beyond r = 3.654 decides. Layers have the
area v and edges x_255 = r, exp(-x_{k-1}^2 / 2) = exp(-x_k^2 / 2) + v / x_k.

References: [1] NumPy, "Random: extending" and `BitGenerator.ctypes`. [2] Lemire, ACM TOMACS 29
(2019) 1, integers without bias. [3] O'Neill, "Developing a seed_seq alternative" (2015), as in
NumPy's SeedSequence. [4] Doty-Humphrey, PractRand (2014). [5] Marsaglia, Tsang, J. Stat. Software 5
(2000) 8; r, the 256 layers and the use of the bits as in NumPy's distributions.c.
"""

import ctypes
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from tracked_env import arrays as b
from tracked_env.physics.jit import COMPILED, formula, loop

STATE = 6  # words of a vehicle's noise
LAYERS = 256
TAIL = 3.6541528853610087963519472518  # [-] r, where the tail begins
MANTISSA = 2.0**23  # [-] numbers m below it

_U32 = np.uint64(0xFFFFFFFF)
_ONE = np.uint64(1)
_SIXTEEN = np.uint32(16)


# --- NumPy's generators ---------------------------------------------------------------------
class _BitGenerator(ctypes.Structure):
    """NumPy's `bitgen_t`, for kernels that run as plain Python."""

    _fields_ = (
        ("state", ctypes.c_void_p),
        ("uint64", ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p)),
        ("uint32", ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_void_p)),
        ("float64", ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p)),
    )


def addresses(generators: Iterable[np.random.Generator]) -> NDArray[np.int64]:
    """Addresses (n,) for kernels; valid while the generators live."""
    interfaces = [generator.bit_generator.ctypes.bit_generator for generator in generators]
    return np.array([interface.value for interface in interfaces], dtype=np.int64)


def _next(field: int, kind: Any, lowered: ir.Type) -> Any:
    """A function of kernels, address -> the next number, by that field of the bitgen_t."""

    def plain(rng):
        source = _BitGenerator.from_address(int(rng))
        return getattr(np, kind.name)(getattr(source, kind.name)(source.state))

    def draw(typing_context, rng):
        def code(context, builder, signature, arguments):
            pointer = ir.IntType(8).as_pointer()
            fields = builder.inttoptr(arguments[0], pointer.as_pointer())
            function = builder.load(builder.gep(fields, [ir.Constant(ir.IntType(32), field)]))
            call = builder.bitcast(function, ir.FunctionType(lowered, [pointer]).as_pointer())
            return builder.call(call, [builder.load(fields)])

        return kind(types.int64), code

    return intrinsic(draw) if COMPILED else plain


_next_uint64 = _next(1, types.uint64, ir.IntType(64))
_next_uint32 = _next(2, types.uint32, ir.IntType(32))
_next_double = _next(3, types.float64, ir.DoubleType())


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
    product = np.uint64(_next_uint32(rng)) * span
    low = product & _U32
    if low < span:
        least = (np.uint64(0x100000000) - span) % span
        while low < least:
            product = np.uint64(_next_uint32(rng)) * span
            low = product & _U32
    return np.int64(product >> np.uint64(32))


@formula
def seed(rng):
    """Generator.integers(2**63)."""
    return np.int64(_next_uint64(rng) >> _ONE)


# --- noise ----------------------------------------------------------------------------------
def _layers() -> tuple[NDArray[np.uint32], NDArray[np.float32], NDArray[np.float32]]:
    """k (256,) accepted at once below it, w (256,) widths over 2^23, f (256,) of the edges."""

    def density(x: float) -> float:
        return math.exp(-0.5 * x * x)

    area = TAIL * density(TAIL) + math.sqrt(0.5 * math.pi) * math.erfc(TAIL / math.sqrt(2.0))
    edges = np.zeros(LAYERS)
    edges[-1] = TAIL
    for k in range(LAYERS - 2, 0, -1):
        edges[k] = math.sqrt(-2.0 * math.log(area / edges[k + 1] + density(edges[k + 1])))
    widths = edges.copy()
    widths[0] = area / density(TAIL)  # of the layer that the tail belongs to
    accepted = np.zeros(LAYERS)
    accepted[0] = TAIL / widths[0]
    accepted[2:] = edges[1:-1] / edges[2:]
    heights = np.array([density(x) for x in edges], dtype=np.float32)
    return (
        np.rint(accepted * MANTISSA).astype(np.uint32),
        (widths / MANTISSA).astype(np.float32),
        heights,
    )


_ACCEPTED, _WIDTH, _HEIGHT = _layers()
_TAIL = np.float32(TAIL)
_TAIL_INVERSE = np.float32(1.0 / TAIL)
_UNIT = np.float32(2.0**-24)


@formula
def _hashed(value, constant):
    """One word of the entropy, and the next constant."""
    value = np.uint32(value ^ constant)
    constant = np.uint32(constant * np.uint32(0x931E8875))
    value = np.uint32(value * constant)
    return np.uint32(value ^ (value >> _SIXTEEN)), constant


@formula
def _mixed(x, y):
    result = np.uint32(np.uint32(np.uint32(0xCA01F9DD) * x) - np.uint32(np.uint32(0x4973F715) * y))
    return np.uint32(result ^ (result >> _SIXTEEN))


@formula
def _next64(s):
    result = s[0] + s[1] + s[3]
    s[3] += _ONE
    s[0] = s[1] ^ (s[1] >> np.uint64(11))
    s[1] = s[2] + (s[2] << np.uint64(3))
    s[2] = ((s[2] << np.uint64(24)) | (s[2] >> np.uint64(40))) + result
    return result


@formula
def _next32(s):
    """Next 32 bits: the lower half of a number first, its upper half afterwards."""
    if s[5] != 0:
        s[5] = np.uint64(0)
        return np.uint32(s[4])
    result = _next64(s)
    s[4], s[5] = result >> np.uint64(32), _ONE
    return np.uint32(result & _U32)


@formula
def _next_float(s):
    return np.float32(_next32(s) >> np.uint32(8)) * _UNIT


@loop
def seed_state(s, seed):
    """Seed the state s (STATE,) as SFC64(seed) does; 0 <= seed < 2^63."""
    s[2], s[3] = np.uint64(seed) & _U32, np.uint64(seed) >> np.uint64(32)
    s[4], s[5] = np.uint64(0), np.uint64(0)
    constant = np.uint32(0x43B0D7E5)
    for k in range(2, 6):  # the pool of entropy
        s[k], constant = _hashed(np.uint32(s[k]), constant)
    for source in range(2, 6):
        for target in range(2, 6):
            if source != target:
                word, constant = _hashed(np.uint32(s[source]), constant)
                s[target] = _mixed(np.uint32(s[target]), word)
    constant = np.uint32(0x8B51F9DD)
    for k in range(3):
        both = np.uint64(0)
        for half in range(2):
            word = np.uint32(np.uint32(s[2 + (2 * k + half) % 4]) ^ constant)
            constant = np.uint32(constant * np.uint32(0x58F38DED))
            word = np.uint32(word * constant)
            word = np.uint32(word ^ (word >> _SIXTEEN))
            both |= np.uint64(word) << np.uint64(32 * half)
        s[k] = both
    s[3], s[4], s[5] = _ONE, np.uint64(0), np.uint64(0)
    for _ in range(12):
        _next64(s)


@formula
def _rejected(s, k, m, x):
    """(accepted, value) of a draw that layer k did not accept at once: 1 in 150."""
    if k == 0:
        while True:
            beyond = np.float32(-_TAIL_INVERSE * np.float32(math.log1p(-_next_float(s))))
            height = np.float32(-np.float32(math.log1p(-_next_float(s))))
            if np.float32(height + height) > np.float32(beyond * beyond):
                tail = np.float32(_TAIL + beyond)
                return True, -tail if (m >> np.uint32(8)) & np.uint32(1) else tail
    between = np.float32(np.float32(_HEIGHT[k - 1] - _HEIGHT[k]) * _next_float(s))
    wide = np.float64(x)
    return np.float32(between + _HEIGHT[k]) < math.exp(-0.5 * wide * wide), x


@formula
def _normal(s):
    while True:
        r = _next32(s)
        k = np.int64(r & np.uint32(0xFF))
        m = r >> np.uint32(9)
        x = np.float32(np.float32(m) * _WIDTH[k])
        x = -x if r & np.uint32(0x100) else x
        if m < _ACCEPTED[k]:
            return x
        accepted, x = _rejected(s, k, m, x)
        if accepted:
            return x


@loop
def fill_normal(s, out):
    """Fill out (M, K) float32, row by row, from the state s (STATE,)."""
    for row in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[row, j] = _normal(s)


@loop
def draw_block(noise, states, i):
    """Draw the next noise block of vehicle i; noise as in `arrays.Batch`, states (N, STATE)."""
    for run in range(noise.shape[0]):
        fill_normal(states[i], noise[run, i])


@loop
def refill(batch, states, noisy, vehicles):
    """Draw the next block of those chosen vehicles that have used up theirs.

    noisy (N,) bool: which need random numbers. The next step moves a cursor of -1 to the first row.
    Returns how many steps the chosen vehicles can take until one of them has used up its block.
    """
    last = -1
    for j in range(vehicles.size):
        i = vehicles[j]
        if batch.counters[i, b.NOISE_CURSOR] >= b.NOISE_BLOCK - 1:
            if noisy[i]:
                draw_block(batch.noise, states, i)
            batch.counters[i, b.NOISE_CURSOR] = -1
        last = max(last, batch.counters[i, b.NOISE_CURSOR])
    return b.NOISE_BLOCK - 1 - last
