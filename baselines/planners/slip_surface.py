"""Steady slip as smooth surfaces over the belt speeds, with first and second derivatives.

    p = r (omega_R + omega_L) / 2      q = r (omega_R - omega_L) / 2 = w_b B / 2       [m/s]
    v_x = p - S(p, q)     w = 2 (q - D(p, q)) / B     v_y = Y(p, q)                  F (29), (30)
    S = (beta_L + beta_R) / 2     D = (beta_R - beta_L) / 2
    beta = r omega - v_track is subtracted; F (29) prints the opposite sign
A left turn is a right turn mirrored: S is even in q, D and Y are odd. A vehicle that turns on the
spot (p = 0) goes nowhere: S and Y are p times a smooth function.
    identified   Chebyshev products in (p, q), ROWS x COLUMNS of the parity of each, fitted to a
                 slip model by least squares at SAMPLES pairs of belt speeds that its sprockets can
                 drive; v_y = v_x tan(alpha) instead of alpha, which jumps at v_x = 0
    exponential  F (54): beta, alpha = -+ c_1 exp(-c_2 |R|), R = p B / (2 q); v_y = v_x tan(alpha)
    none         S = D = Y = 0
Friction: coefficients are linear in 1 / mu between those of the layers of a family.
Validity: 0 <= p <= fastest, |q| <= fastest_turn; the fit is coarsest where one belt stands.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 3.2, 4, 7.2.3.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray

from baselines.slip.slip_models import NoSlip, SlipFamily, SlipModel, layers
from baselines.slip.slip_regression import ExponentialSlipModel, TreeSlipModel
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.validation import checked_number

Array = NDArray[np.float64]

ROWS, COLUMNS = 7, 8  # Chebyshev terms in p, and in q of one parity (degree 15)
CHEBYSHEV, EXPONENTIAL = 0, 1  # kinds of surface
STEEPEST = 700.0  # [-] argument of exp() below which slip is 0
SAMPLES = 25, 49  # speeds p, and q, at which a model is fitted
# Of c_1 of alpha: its tangent must stay finite, and a vehicle drifts more slowly than it drives.
_TILT = Range(0.0, 1.4, "rad", "Is it in degrees?")
UNBOUNDED = 1e6  # [m/s] up to which a surface holds that was not fitted


class SlipSurface(NamedTuple):
    """Slip of one vehicle on one soil for the kernels of the planner."""

    kind: int  # CHEBYSHEV or EXPONENTIAL
    terms: Array  # (3, ROWS, COLUMNS) [m/s] of S, D, Y; constants of F (54): [:, 0, :2]
    fastest: float  # [m/s] p up to which it holds
    fastest_turn: float  # [m/s] |q| up to which it holds
    half_gauge: float  # [m] B / 2
    radius: float  # [m] r


class Jet(NamedTuple):
    """A quantity with its derivatives in p and q."""

    value: float
    p: float
    q: float
    pp: float
    pq: float
    qq: float


@formula
def _chebyshev(x, n, terms):
    """T_n, T_n', T_n'' at x into terms (3, n), by recurrence."""
    terms[0, 0], terms[1, 0], terms[2, 0] = 1.0, 0.0, 0.0
    terms[0, 1], terms[1, 1], terms[2, 1] = x, 1.0, 0.0
    for k in range(2, n):
        terms[0, k] = 2.0 * x * terms[0, k - 1] - terms[0, k - 2]
        terms[1, k] = 2.0 * (terms[0, k - 1] + x * terms[1, k - 1]) - terms[1, k - 2]
        terms[2, k] = 4.0 * terms[1, k - 1] + 2.0 * x * terms[2, k - 1] - terms[2, k - 2]


@formula
def _product(coefficients, odd, rows, columns, scale, turn_scale):
    """Jet of sum c_ij T_i(P) T_2j+odd(Q) from terms (3, n) of P and Q."""
    value, p, q, pp, pq, qq = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(ROWS):
        a, b, c = 0.0, 0.0, 0.0
        for j in range(COLUMNS):
            k = 2 * j + odd
            a += coefficients[i, j] * columns[0, k]
            b += coefficients[i, j] * columns[1, k]
            c += coefficients[i, j] * columns[2, k]
        value += rows[0, i] * a
        p += rows[1, i] * a
        pp += rows[2, i] * a
        q += rows[0, i] * b
        pq += rows[1, i] * b
        qq += rows[0, i] * c
    s, t = scale, turn_scale
    return Jet(value, s * p, t * q, s * s * pp, s * t * pq, t * t * qq)


@formula
def _times(jet, p, scale):
    """Jet of (scale p) f from the jet of f."""
    x = scale * p
    pp, pq = x * jet.pp + 2.0 * scale * jet.p, x * jet.pq + scale * jet.q
    return Jet(x * jet.value, x * jet.p + scale * jet.value, x * jet.q, pp, pq, x * jet.qq)


@formula
def _identified(surface, p, q, rows, columns):
    """Jets of S, D, Y of a Chebyshev surface."""
    scale, turn_scale = 2.0 / surface.fastest, 1.0 / surface.fastest_turn
    _chebyshev(scale * p - 1.0, ROWS, rows)
    _chebyshev(turn_scale * q, 2 * COLUMNS, columns)
    s = _product(surface.terms[0], 0, rows, columns, scale, turn_scale)
    d = _product(surface.terms[1], 1, rows, columns, scale, turn_scale)
    y = _product(surface.terms[2], 1, rows, columns, scale, turn_scale)
    return _times(s, p, 1.0 / surface.fastest), d, _times(y, p, 1.0 / surface.fastest)


@formula
def _decay(c_1, c_2, p, q):
    """Jet of -sign(q) c_1 exp(-c_2 p / |q|); flat at q = 0."""
    side = 1.0 if q > 0.0 else -1.0
    if q == 0.0 or c_2 * p > STEEPEST * abs(q):
        return Jet(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    value = -side * c_1 * math.exp(-c_2 * p / abs(q))
    z_p, z_q = -c_2 / abs(q), c_2 * p * side / (q * q)
    z_pq, z_qq = c_2 * side / (q * q), -2.0 * c_2 * p / abs(q * q * q)
    pp, pq, qq = value * z_p * z_p, value * (z_p * z_q + z_pq), value * (z_q * z_q + z_qq)
    return Jet(value, value * z_p, value * z_q, pp, pq, qq)


@formula
def _half(a, sign, b):
    """Jet of (a + sign b) / 2."""
    value, p, q = a.value + sign * b.value, a.p + sign * b.p, a.q + sign * b.q
    pp, pq, qq = a.pp + sign * b.pp, a.pq + sign * b.pq, a.qq + sign * b.qq
    return Jet(0.5 * value, 0.5 * p, 0.5 * q, 0.5 * pp, 0.5 * pq, 0.5 * qq)


@formula
def _exponential(surface, p, q):
    """Jets of S, D, Y of F (54)."""
    c, b = surface.terms, surface.half_gauge
    left = _decay(c[0, 0, 0], c[0, 0, 1] * b, p, q)
    right = _decay(c[1, 0, 0], c[1, 0, 1] * b, p, q)
    a = _decay(c[2, 0, 0], c[2, 0, 1] * b, p, q)
    s, d = _half(left, 1.0, right), _half(right, -1.0, left)
    t = math.tan(a.value)
    m = 1.0 + t * t
    v, v_p, v_q = p - s.value, 1.0 - s.p, -s.q
    pp = -s.pp * t + m * (2.0 * v_p * a.p + v * (a.pp + 2.0 * t * a.p * a.p))
    pq = -s.pq * t + m * (v_p * a.q + v_q * a.p + v * (a.pq + 2.0 * t * a.p * a.q))
    qq = -s.qq * t + m * (2.0 * v_q * a.q + v * (a.qq + 2.0 * t * a.q * a.q))
    return s, d, Jet(v * t, v_p * t + v * m * a.p, v_q * t + v * m * a.q, pp, pq, qq)


@loop
def motion_jets(surface, p, q, rows, columns):
    """Jets of v_x, v_y [m/s] and w [rad/s] at belt speeds p, q [m/s].

    rows (3, ROWS), columns (3, 2 COLUMNS): work space.
    """
    if surface.kind == EXPONENTIAL:
        s, d, y = _exponential(surface, p, q)
    else:
        s, d, y = _identified(surface, p, q, rows, columns)
    i = 1.0 / surface.half_gauge
    v_x = Jet(p - s.value, 1.0 - s.p, -s.q, -s.pp, -s.pq, -s.qq)
    turn = Jet(i * (q - d.value), -i * d.p, i * (1.0 - d.q), -i * d.pp, -i * d.pq, -i * d.qq)
    return v_x, y, turn


def surface_of(
    slip_model: SlipModel | None, vehicle: PlantParameters, sprocket_speed: float, fastest: float
) -> SlipSurface:
    """The surface of a slip model of `vehicle`.

    sprocket_speed [rad/s], fastest [m/s]: up to which plans go. None is no slip; F (54) is taken as
    it is; others are fitted, a table or a layer of a family at first in 3 ms, then it is cached.
    A family needs a friction: `family.at(mu)`, or an estimator that has both.
    Raises ValueError for a table that ends below `sprocket_speed`, or a friction that is not one
    number.
    """
    radius, half_gauge = vehicle.sprocket_radius, 0.5 * vehicle.track_gauge
    terms = np.zeros((3, ROWS, COLUMNS))
    if slip_model is None or isinstance(slip_model, NoSlip):
        return SlipSurface(CHEBYSHEV, terms, UNBOUNDED, UNBOUNDED, half_gauge, radius)
    if isinstance(slip_model, ExponentialSlipModel):
        checked_number("c_1 of alpha", float(np.abs(slip_model.constants[2, 0])), _TILT)
        terms[:, 0, :2] = slip_model.constants
        half_gauge = 0.5 * slip_model.track_gauge
        return SlipSurface(EXPONENTIAL, terms, UNBOUNDED, UNBOUNDED, half_gauge, radius)
    reach = radius * sprocket_speed, min(fastest, radius * sprocket_speed)
    family = getattr(slip_model, "family", None)  # of an estimator of friction too
    if family is not None:
        end = family.grid.spacing * family.grid.zero_left
        if sprocket_speed > end * (1.0 + 1e-9):
            raise ValueError(
                f"sprocket speed = {sprocket_speed:g} rad/s; the slip model ends at {end:g} rad/s. "
                "Identify slip up to the limit of the plan."
            )
        friction = np.asarray(slip_model.friction)  # type: ignore[attr-defined]
        terms = _of_friction(family, friction, radius, *reach)
    elif isinstance(slip_model, TreeSlipModel):
        terms = _fitted_once(slip_model, radius, *reach)
    else:  # one that learns is another model each time
        terms = _fitted(slip_model, radius, *reach)
    return SlipSurface(CHEBYSHEV, terms, reach[1], reach[0], half_gauge, radius)


def _of_friction(family: SlipFamily, friction: Array, *reach: float) -> Array:
    """Coefficients at the friction of a family, linear in 1 / mu."""
    if len(family.frictions) == 1:
        return _fitted_layer(family, 0, *reach)
    if friction.size != 1 or np.isnan(friction).any():
        raise ValueError(
            f"friction = {friction}; must be one number for a plan. Plan for one vehicle at a time."
        )
    layer, share = np.empty(1, dtype=np.int64), np.empty(1)
    layers(family.frictions, friction.reshape(1), layer, share)
    low, high = (_fitted_layer(family, int(layer[0]) + k, *reach) for k in (0, 1))
    return (1.0 - share[0]) * low + share[0] * high


@lru_cache(maxsize=64)
def _fitted_layer(family: SlipFamily, k: int, *reach: float) -> Array:
    return _fitted(family.at(family.frictions[k]), *reach)


def _fitted(model: SlipModel, radius: float, belt: float, fastest: float) -> Array:
    along, across = np.linspace(0.0, fastest, SAMPLES[0]), np.linspace(0.0, belt, SAMPLES[1])
    p, q = (a.ravel() for a in np.meshgrid(along, across, indexing="ij"))
    possible = p + q <= belt * (1.0 + 1e-9)  # the others need a faster sprocket
    p, q = p[possible], q[possible]
    left, right, alpha = model.slip((p - q) / radius, (p + q) / radius)
    rows = chebvander(2.0 * p / fastest - 1.0, ROWS - 1)
    columns = chebvander(q / belt, 2 * COLUMNS - 1)
    share = (p / fastest)[:, None]
    half_sum = 0.5 * (left + right)
    targets = (
        (share * rows, columns[:, 0::2], half_sum),
        (rows, columns[:, 1::2], 0.5 * (right - left)),
        (share * rows, columns[:, 1::2], (p - half_sum) * np.tan(alpha)),
    )
    terms = np.empty((3, ROWS, COLUMNS))
    for c, (factor, other, values) in enumerate(targets):
        products = (factor[:, :, None] * other[:, None, :]).reshape(len(values), -1)
        terms[c] = np.linalg.lstsq(products, values, rcond=None)[0].reshape(ROWS, COLUMNS)
    return terms


_fitted_once = lru_cache(maxsize=64)(_fitted)
