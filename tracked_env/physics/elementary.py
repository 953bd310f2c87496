"""Branch-free elementary functions that the compiler can vectorise over vehicles.

A loop that calls the C library's `exp` runs one element at a time. The functions here use only +,
-, *, /, square roots, integer shifts and selections, hence one vector instruction serves several
vehicles, and the result does not depend on how many vehicles share the loop. The exponential:
Cody-Waite range reduction, polynomial on the reduced argument, exponent set by an integer shift.

Reference: [1] J.-M. Muller, "Elementary Functions", 3rd ed., ch. 11 (range reduction).
"""

import math
from fractions import Fraction
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from tracked_env.physics.jit import COMPILED, formula

LOG2_E = 1.4426950408889634  # [-] log2(e)
LN2_HIGH = 6.93147180369123816490e-01  # [-] ln 2, upper 32 bits: k * LN2_HIGH is exact
LN2_LOW = 1.90821492927058770002e-10  # [-] ln 2 - LN2_HIGH
ROUND_MAGIC = 6755399441055744.0  # [-] 1.5 * 2**52: adding it rounds to the nearest integer
EXP_ARGUMENT_LIMIT = 700.0  # [-] |x| is clipped here: exp(700) is still finite
ROOT_GUESS = 0x5FE6EB50C7B537A9  # [-] less half the bits of x: about the bits of 1 / sqrt(x)
TWO_PI = 2.0 * math.pi  # [rad] one turn
TWO_OVER_PI = 2.0 / math.pi  # [1/rad]
HALF_PI_HIGH = 1.57079632673412561417e00  # [rad] pi/2, upper 33 bits: k * it is exact
HALF_PI_MIDDLE = 6.07710050630396597660e-11  # [rad] the next 33 bits
HALF_PI_LOW = 2.02226624879595063154e-21  # [rad] the rest
_F2, _F3, _F4, _F5, _F6, _F7, _F8 = (1.0 / math.factorial(n) for n in range(2, 9))
_F9, _F10, _F11, _F12, _F13, _F14, _F15 = (1.0 / math.factorial(n) for n in range(9, 16))


def _fused(typing_context, a, b, c):
    """a b + c, rounded once, whatever the processor."""

    def code(context, builder, signature, arguments):
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), code


def _fused_in_python(a: float, b: float, c: float) -> float:
    return float(Fraction(a) * Fraction(b) + Fraction(c))


fused: Any = intrinsic(_fused) if COMPILED else _fused_in_python


def _apart(typing_context):
    """Keep the function that calls this out of its callers, where its loops might be compiled
    otherwise."""

    def code(context, builder, signature, arguments):
        attributes = builder.function.attributes
        attributes.discard("alwaysinline")  # of the caller, where that is compiled first
        attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), code


apart: Any = intrinsic(_apart) if COMPILED else lambda: None


@formula
def exponential(x):
    """Return exp(x) with relative error < 1e-14 for |x| <= 700; x outside is clipped.

    Limits: exponential(0) = 1 exactly; strictly positive; never inf. NaN gives NaN.
    """
    x = min(max(x, -EXP_ARGUMENT_LIMIT), EXP_ARGUMENT_LIMIT)
    shifted = x * LOG2_E + ROUND_MAGIC
    k = shifted - ROUND_MAGIC
    f = (x - k * LN2_HIGH) - k * LN2_LOW  # |f| <= ln(2)/2
    p = _F12 + f * _F13
    p = _F10 + f * (_F11 + f * p)
    p = _F8 + f * (_F9 + f * p)
    p = _F6 + f * (_F7 + f * p)
    p = _F4 + f * (_F5 + f * p)
    p = 1.0 + f * (1.0 + f * (_F2 + f * (_F3 + f * p)))
    # The low bits of `shifted` hold k as an integer: move them into the exponent field.
    bits = (np.float64(shifted).view(np.int64) << 52) + np.float64(1.0).view(np.int64)
    return p * np.int64(bits).view(np.float64)


@formula
def inverse_root(x):
    """Return 1/sqrt(x) with relative error < 4e-16 for normal x > 0: neither root nor division.

    Finite and of no meaning for others; NaN gives NaN. A guess y from the bits of x is 3.5 % off;
    two series in e = 1 - x y^2 leave e^5 and then e^3 of it.
    """
    x = max(x, 0.0)
    bits = ROOT_GUESS - (np.float64(x).view(np.int64) >> 1)
    y = np.int64(bits).view(np.float64)
    e = 1.0 - x * y * y
    y *= 1.0 + e * (1 / 2 + e * (3 / 8 + e * (5 / 16 + e * (35 / 128))))
    e = 1.0 - x * y * y
    return y * (1.0 + e * (1 / 2 + e * (3 / 8)))


@formula
def small_rotation(angle):
    """Return (cos, sin) of a small angle [rad] by Taylor series of order 6 and 7.

    Error < 1.1e-15 for |angle| <= 0.05 rad (2.5 ms at 20 rad/s), < 3e-13 for 0.1 rad.
    """
    z = angle * angle
    cosine = 1.0 - z * (1 / 2 - z * (1 / 24 - z * (1 / 720)))
    sine = angle * (1.0 - z * (1 / 6 - z * (1 / 120 - z * (1 / 5040))))
    return cosine, sine


@formula
def rotation(angle):
    """Return (cos, sin) of an angle [rad]; error < 1e-15 (1 + |angle|) for |angle| < 1e6.

    Cody-Waite reduction to |r| <= pi/4, Taylor polynomials, quadrant by selection.
    """
    quarter = angle * TWO_OVER_PI + ROUND_MAGIC
    k = quarter - ROUND_MAGIC
    r = ((angle - k * HALF_PI_HIGH) - k * HALF_PI_MIDDLE) - k * HALF_PI_LOW
    z = r * r
    c = _F12 - z * _F14
    c = _F8 - z * (_F10 - z * c)
    c = 1.0 - z * (1 / 2 - z * (_F4 - z * (_F6 - z * c)))
    s = _F11 - z * (_F13 - z * _F15)
    s = _F5 - z * (_F7 - z * (_F9 - z * s))
    s = r * (1.0 - z * (1 / 6 - z * s))
    quadrant = np.float64(quarter).view(np.int64)
    odd = quadrant & 1
    cosine = s if odd else c
    sine = c if odd else s
    cosine = -cosine if (quadrant + 1) & 2 else cosine
    sine = -sine if quadrant & 2 else sine
    return cosine, sine


@formula
def wrap_angle(angle):
    """Return the angle [rad] less whole turns, in [-pi, pi]; of one angle or an array.

    Exact within half a turn, and odd: symmetric situations stay symmetric.
    """
    return angle - TWO_PI * np.rint(angle / TWO_PI)


@formula
def regularised_sign(speed, width):
    """Return g(u) = u (u^2 + 3/2 eps^2) / (u^2 + eps^2)^(3/2) [-], a smooth sign(u).

    eps = `width` has the unit of `speed`. Odd, monotone, slope 3 / (2 eps) at 0, |g| < 1,
    1 - |g| -> 3/8 (eps/u)^4. Its first and second antiderivative are algebraic, which gives the
    friction integrals over a track in closed form.
    """
    square = speed * speed
    width2 = width * width
    inverse = 1.0 / math.sqrt(square + width2)
    return speed * (square + 1.5 * width2) * (inverse * inverse * inverse)


@formula
def saturated_sign(speed, inverse_width):
    """Return a differentiable sign(u) that IS sign(u) for |u| >= 1 / `inverse_width`.

    With x = clip(u * inverse_width, -1, 1): s = (3 x - x^3) / 2. Odd, monotone.
    """
    x = min(max(speed * inverse_width, -1.0), 1.0)
    return x * (1.5 - 0.5 * x * x)


@formula
def signed(magnitude, direction):
    """Return `magnitude` with the sign of `direction`; zero counts as positive."""
    return magnitude if direction >= 0.0 else -magnitude
