"""L1 adaptive augmentation of one channel: predictor, piecewise-constant adaptation, filter.

Channel, with x measured, f the acceleration of the nominal model under the input that was applied,
s what the model lacks (the matched uncertainty; it contains the unknown input gain):
    x'  = f + s                                     the vehicle
    p'  = f + s^ - a (p - x)                        state predictor, error e = p - x
    e'  = -a e + s^ - s
    s^  = -exp(-a T) e / P,  P = (1 - exp(-a T)) / a        at every sample, held for T
    d'  = w (s^ - d)                                low-pass filter C(s) = w / (s + w)
The law demands u - d where it demanded u. Over a period the error equation is integrated exactly
for x that is linear in time and f that is its mean, so that what was saturated or is delayed in the
drive is in f and nothing winds up.

Properties, for constant s: e settles at -P s within one period, of order T; s^ at exp(-a T) s, so
that d tends to s with a and T to 0. d is kept within +-bound: the projection of this scheme.
Input gain: with x' = b f_u + .., b the true over the assumed gain, s holds (b - 1) f_u, and the
loop of estimate and control is stable for |b - 1| < 1 at any bandwidth (small gain, |C| <= 1);
beyond that only as far as drive and sensors are fast against w. See docs/augmented.md.

References: [1] Hovakimyan, Cao, L1 Adaptive Control Theory (SIAM 2010), sections 2.1 and 3.3.
"""

import math
from typing import NamedTuple

from tracked_env.physics.jit import formula


class Estimate(NamedTuple):
    """What one channel remembers, in the unit of its acceleration but for the first."""

    error: float  # e = p - x, prediction less measurement [of x]
    uncertainty: float  # s^, held since the last sample
    cancelled: float  # d, its low-pass


@formula
def predictor_gains(rate, period):
    """(exp(-a T) [-], P = (1 - exp(-a T)) / a [s]) for a [1/s] and T [s]; a = 0 gives (1, T)."""
    decay = math.exp(-rate * period)
    return decay, (1.0 - decay) / rate if rate > 0.0 else period


@formula
def sampled(known, change, modelled, rate, bandwidth, bound, period):
    """Estimate after one period [s]; known: before it.

    change: of the measured x over it. modelled: mean of f over it. rate a and bandwidth w [1/s];
    w = inf passes s^ on as it is. bound: of d, >= 0.
    """
    decay, hold = predictor_gains(rate, period)
    error = decay * known.error + hold * (known.uncertainty + modelled - change / period)
    uncertainty = -decay * error / hold
    share = 1.0 - math.exp(-bandwidth * period)
    cancelled = known.cancelled + share * (uncertainty - known.cancelled)
    return Estimate(error, uncertainty, min(max(cancelled, -bound), bound))
