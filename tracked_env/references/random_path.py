"""Random smooth paths: v and w are cubic B-splines with random coefficients, drawn in a kernel.

    v(t) = sum_n V_n B((t - t_n) / T),  w likewise;  B the cubic B-spline on knots of spacing T
Coefficients are drawn = clip(1.5 U(-1, 1), -1, 1), so that a third of them is at a limit, first
those of v, then those of w. Per interval of T four neighbours times `_spline_segments` give the
polynomials of the profile; sums are fused (one rounding a term) in the order of the four, so that
the bits depend neither on the processor nor on the number of paths.

References: [1] de Boor, A Practical Guide to Splines, ch. IX-XI (B-splines stay in their hull).
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.elementary import fused
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.reference_profile import SEGMENT_DURATION
from tracked_env.references.profile import (
    DEGREE,
    FloatArray,
    ReferenceProfile,
    fit,
    number_of_segments,
)
from tracked_env.streams import addresses, uniform

RANDOM_STRETCH = 1.5  # [-] of the uniform draws before clipping, so that limits are visited
SLOWEST = 1e-9  # [m/s] below it the lateral acceleration limits nothing


@lru_cache
def _spline_segments(per_interval: int) -> FloatArray:
    """Map (4, 6 per_interval): four B-spline coefficients @ it = the segments of an interval."""
    u = np.arange(per_interval + 1) / per_interval
    rate = 1.0 / (per_interval * SEGMENT_DURATION)
    one = np.ones_like(u)
    value = [(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]
    first = [-3 * (1 - u) ** 2, 9 * u**2 - 12 * u, -9 * u**2 + 6 * u + 3, 3 * u**2]
    second = [6 * (1 - u), 18 * u - 12 * one, 6 * one - 18 * u, 6 * u]
    rows = [
        fit(f / 6, df * rate / 6, ddf * rate**2 / 6)
        for f, df, ddf in zip(value, first, second, strict=True)
    ]
    return np.stack([row.ravel() for row in rows])


@formula
def _clipped_draws(rng, out):
    """=clip(1.5 U(-1, 1), -1, 1) each; steady at the start, where derivatives are zero."""
    for n in range(out.size):
        out[n] = min(max(RANDOM_STRETCH * uniform(rng, -1.0, 1.0), -1.0), 1.0)
    out[1] = out[2] = out[0]


@formula
def _limited(v, w, lateral_acceleration):
    """Reduce w (C,) where |v w| could exceed the limit: V_n meets W_m for |n - m| <= 3."""
    for n in range(v.size):
        fastest = SLOWEST
        for m in range(max(n - 3, 0), min(n + 4, v.size)):
            fastest = max(fastest, abs(v[m]))
        bound = lateral_acceleration / fastest
        w[n] = min(max(w[n], -bound), bound)


@formula
def _write(coefficients, segments, row, out):
    """Fill out (S, 6) with the polynomials of the spline; row: room for those of an interval."""
    width = DEGREE + 1
    per_interval = row.size // width
    for n in range(coefficients.size - 3):
        for j in range(row.size):
            total = coefficients[n] * segments[0, j]
            for m in range(1, 4):
                total = fused(coefficients[n + m], segments[m, j], total)
            row[j] = total
        for k in range(n * per_interval, min((n + 1) * per_interval, out.shape[0])):
            for j in range(width):
                out[k, j] = row[(k - n * per_interval) * width + j]


@loop
def _draw_paths(rngs, chosen, profile, limits, segments):
    """Draw the profiles of the chosen vehicles; limits as RandomPaths, profile (S, N, 12)."""
    per_interval = segments.shape[1] // (DEGREE + 1)
    count = -(-profile.shape[0] // per_interval) + 3
    v, w, row = np.empty(count), np.empty(count), np.empty(segments.shape[1])
    middle, half = 0.5 * (limits[0] + limits[1]), 0.5 * (limits[1] - limits[0])
    for k in range(chosen.size):
        _clipped_draws(rngs[k], v)
        _clipped_draws(rngs[k], w)
        for n in range(count):
            v[n] = middle + half * v[n]
            w[n] = limits[2] * w[n]
        _limited(v, w, limits[3])
        _write(v, segments, row, profile[:, chosen[k], :6])
        _write(w, segments, row, profile[:, chosen[k], 6:])


class RandomPaths(NamedTuple):
    """Paths of one law for a batch of vehicles."""

    limits: FloatArray  # (4,) speed low, high [m/s], yaw rate [rad/s], lateral acc. [m/s^2]
    segments: FloatArray  # of `_spline_segments`

    def fill(
        self, streams: NDArray[np.int64], chosen: NDArray[np.int64], profile: FloatArray
    ) -> None:
        """Draw the profiles of the chosen vehicles into profile (S, N, 12)."""
        _draw_paths(streams, chosen, profile, *self)


def random_paths(
    speed_range: tuple[float, float] = (1.0, 3.0),
    yaw_rate_limit: float = 0.5,
    lateral_acceleration_limit: float = 1.5,
    knot_interval: float = 2.0,
) -> RandomPaths:
    """The law of `random_smooth` with these parameters."""
    limits = np.array([*speed_range, yaw_rate_limit, lateral_acceleration_limit], dtype=float)
    return RandomPaths(limits, _spline_segments(round(knot_interval / SEGMENT_DURATION)))


def random_smooth(
    duration: float,
    rng: np.random.Generator,
    speed_range: tuple[float, float] = (1.0, 3.0),
    yaw_rate_limit: float = 0.5,
    lateral_acceleration_limit: float = 1.5,
    knot_interval: float = 2.0,
) -> ReferenceProfile:
    """Random smooth path: v and w are cubic B-splines, C2, with one coefficient an interval.

    Coefficients of v =clip(..) over `speed_range` [m/s], of w =clip(..) within +-
    `yaw_rate_limit` [rad/s], reduced where |v w| could exceed `lateral_acceleration_limit`
    [m/s^2]. A B-spline never leaves the hull of its coefficients, so all limits hold exactly
    at all times, and |v'| <= (high - low) / knot_interval.
    """
    profile = np.empty((number_of_segments(duration), 1, 2 * (DEGREE + 1)))
    paths = random_paths(speed_range, yaw_rate_limit, lateral_acceleration_limit, knot_interval)
    paths.fill(addresses([rng]), np.zeros(1, np.int64), profile)
    return ReferenceProfile(profile[:, 0, :6].copy(), profile[:, 0, 6:].copy())
