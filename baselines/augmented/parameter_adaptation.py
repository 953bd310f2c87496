"""Model-reference adaptation of one channel with three parameters, by a Lyapunov update law.

Channel: thrust h (over the nominal mass or inertia) moves x against the parts r and 1 of the load,
    h   = q_1 x' + q_2 r + q_3                      the vehicle, q unknown, q_1 > 0
    h   = p_1 a + p_2 r + p_3                       the law: a is what it asks of its parameters p
    x_m'= a + l (x - x_m)                           reference model, fed with the error e = x - x_m
    e'  = -l e + (p - q)' y / q_1,  y = (a, r, 1)
    p'  = -G y E(e) / (1 + y' G y / l^2) - k (p - p_0)
With V = q_1 e^2 + (p - q)' (p - q) / G and neither k nor dead zone, V' = -2 q_1 l e^2 <= 0 before
normalization. E(e) = e - clip(e, -z, z): dead zone z. k: sigma modification, a pull towards the
nominal p_0. p stays in the box [low, high]: for a diagonal G that clipping is the projection.
The normalization keeps adaptation slower than the reference model: y' G y / (1 + ..) < l^2.
Where the input y is constant, (p - p_0) moves along G y only; without excitation no parameter is
claimed to be right, the prediction is.
Here a follows from the effort that was applied, limits and lag included (the deficit of the drives
is hedged in the reference model), so that a saturated drive teaches nothing wrong.

References: [1] Lavretsky, Wise, Robust and Adaptive Control (2013), chapters 9 to 11. [2] Gibson,
Annaswamy, Lavretsky, IEEE Access 1 (2013), closed-loop reference models. [3] Johnson, Calise,
J. Guidance 26 (2003), pseudo-control hedging.
"""

import math
from typing import NamedTuple

from tracked_env.physics.jit import formula


class Load(NamedTuple):
    """Three numbers of a channel: parameters, gains, bounds, or regressors."""

    inertial: float  # of x'
    resisting: float  # of r
    constant: float  # of 1


class Adaptation(NamedTuple):
    """Numbers of the law, for one channel."""

    gain: Load  # G, diagonal
    low: Load  # projection bounds
    high: Load
    nominal: Load  # p_0
    rate: float  # [1/s] l
    leak: float  # [1/s] k
    dead_zone: float  # [of x] z


@formula
def demanded(parameters, thrust, resisting):
    """a: the x' that `thrust` gives by the parameters."""
    p = parameters
    return (thrust - p.resisting * resisting - p.constant) / p.inertial


@formula
def beyond(error, dead_zone):
    """What of an error exceeds the dead zone; odd."""
    return error - min(max(error, -dead_zone), dead_zone)


@formula
def within(value, low, high):
    """value in [low, high]."""
    return min(max(value, low), high)


@formula
def _moved(p, middle, error, change, thrust, resisting, law, period):
    """(Load, error e) after one period, with a of the parameters `middle` all through it."""
    a = demanded(middle, thrust, resisting)
    decay = math.exp(-law.rate * period)
    later = decay * error + (1.0 - decay) / law.rate * (change / period - a)
    g = law.gain
    size = a * a * g.inertial + resisting * resisting * g.resisting + g.constant
    effect = beyond(0.5 * (error + later), law.dead_zone)
    keep = math.exp(-law.leak * period)
    held_for = (1.0 - keep) / law.leak if law.leak > 0.0 else period
    step = -held_for * effect / (1.0 + size / (law.rate * law.rate))
    low, high, at = law.low, law.high, law.nominal
    inertial = at.inertial + keep * (p.inertial - at.inertial) + step * g.inertial * a
    held = at.resisting + keep * (p.resisting - at.resisting) + step * g.resisting * resisting
    constant = at.constant + keep * (p.constant - at.constant) + step * g.constant
    moved = Load(
        within(inertial, low.inertial, high.inertial),
        within(held, low.resisting, high.resisting),
        within(constant, low.constant, high.constant),
    )
    return moved, later


@formula
def adapted(p, error, change, thrust, resisting, law, period):
    """(Load p, error e) after one period [s].

    change: of the measured x over it; thrust, resisting: means over it; law: Adaptation. Of second
    order in the period (midpoint rule): e by its exact solution for constant a, p by the mean of e.
    """
    ahead, _error = _moved(p, p, error, change, thrust, resisting, law, period)
    middle = Load(
        0.5 * (p.inertial + ahead.inertial),
        0.5 * (p.resisting + ahead.resisting),
        0.5 * (p.constant + ahead.constant),
    )
    return _moved(p, middle, error, change, thrust, resisting, law, period)
