"""The catalogue of references: each function turns a few numbers into a profile.

With kappa = w / v the curvature of the path, left positive:
    straight         kappa = 0
    circle           kappa = +-1 / R
    spiral           kappa linear in time: at constant speed a clothoid
    figure_eight     yaw = a (1 - cos(Omega t)), a = first zero of the Bessel function J0: the
                     sine-generated curve that closes into an eight
    identification   straight, then a spiral from kappa = 0, with a speed that oscillates
    chicane          F (53), jumps in v and w
    random_smooth    v and w are cubic B-splines with random coefficients (C2)
Parameters are those that `specification` has checked; nothing is checked again here. Angles
in rad, the start is the origin, yaw 0, unless the pose is set afterwards. Every profile goes
on by its own law until one segment after `duration` and keeps v and w from there.

References: [1] Focchi et al. 2025, (53). [2] Strawa et al., Electronics 10 (2021) 187, 8.3.
[3] Langbein, Leopold, River Meanders, USGS Prof. Paper 422-H, 1966 (sine-generated curve).
[4] de Boor, A Practical Guide to Splines, ch. IX-XI (B-splines stay in their convex hull).
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.reference_profile import SEGMENT_DURATION
from tracked_env.references.profile import (
    DEGREE,
    FloatArray,
    ReferenceProfile,
    constant,
    fit,
    knot_times,
    number_of_segments,
)

EIGHT_AMPLITUDE = 2.404825557695773  # [rad] a, first zero of J0
EIGHT_EXTENT = 0.7497418431069495  # [-] Struve H0(a): tip to tip over half the length
SMOOTHSTEP_SLOPE = 1.875  # [-] largest slope of 10 s^3 - 15 s^4 + 6 s^5
SPIRAL_ONSET = 2.0  # [s] over which the identification spiral begins to curve
SPIRAL_SHORTEST = 5.0  # [s] least time over which it reaches its final curvature
CHICANE_RAMP_TIME = 1.0  # [s] F (53) prints v = v_max t: v_max is reached after 1 s
RANDOM_STRETCH = 1.5  # [-] of the uniform draws before clipping, so that limits are visited


def _smooth_ramp(
    times: FloatArray, start: float, end: float, acceleration: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Value, first and second derivative (T,) of a C2 change with that peak rate [1/s]."""
    least = SMOOTHSTEP_SLOPE * abs(end - start) / acceleration
    duration = max(math.ceil(least / SEGMENT_DURATION), 1) * SEGMENT_DURATION
    s = np.minimum(times / duration, 1.0)
    change = end - start
    value = start + change * s * s * s * (10.0 - s * (15.0 - 6.0 * s))
    first = change / duration * 30.0 * s * s * (1.0 - s) ** 2
    second = change / duration**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    return value, first, second


def straight(
    duration: float,
    speed: float = 2.0,
    initial_speed: float | None = None,
    acceleration: float = 1.0,
) -> ReferenceProfile:
    """Straight ahead at `speed` [m/s]; from `initial_speed` by a C2 ramp if that is given.

    acceleration: largest of the ramp [m/s^2].
    """
    times = knot_times(duration)
    start = speed if initial_speed is None else initial_speed
    v = fit(*_smooth_ramp(times, start, speed, acceleration))
    return ReferenceProfile(v, constant(0.0, len(v)))


def circle(
    duration: float, speed: float = 2.0, radius: float = 10.0, direction: float = 1.0
) -> ReferenceProfile:
    """Circle of `radius` [m]; its centre is to the left for direction +1, right for -1."""
    segments = number_of_segments(duration)
    yaw_rate = constant(direction * speed / radius, segments)
    return ReferenceProfile(constant(speed, segments), yaw_rate)


def figure_eight(
    duration: float, speed: float = 2.0, size: float = 30.0, direction: float = 1.0
) -> ReferenceProfile:
    """An eight from its crossing point; `size` [m] is the distance between its two tips.

    One round is 2 size / H0(a) = 2.668 size long and takes 2 pi / Omega = length / speed; the
    first lobe is to the left for direction +1. Largest curvature a pi H0(a) / size =
    5.66 / size, at the tips; none at the crossing, which is passed at +-a from the tips'
    heading.
    """
    times = knot_times(duration)
    omega = math.pi * EIGHT_EXTENT * speed / size
    amplitude = direction * EIGHT_AMPLITUDE * omega
    sine, cosine = np.sin(omega * times), np.cos(omega * times)
    w = fit(amplitude * sine, amplitude * omega * cosine, -amplitude * omega**2 * sine)
    return ReferenceProfile(constant(speed, len(w)), w)


def spiral(
    duration: float,
    speed: float = 2.0,
    radius_start: float = 30.0,
    radius_end: float = 8.0,
    direction: float = 1.0,
) -> ReferenceProfile:
    """Clothoid: curvature linear in time from 1 / radius_start to 1 / radius_end [1/m].

    The end value is reached at the first knot at or after `duration`, then kept.
    """
    times = knot_times(duration)
    start, end = direction * speed / radius_start, direction * speed / radius_end
    slope = (end - start) / times[-2]
    w = constant(0.0, len(times) - 1)
    w[:, 0] = start + slope * times[:-1]
    w[:-1, 1] = slope
    return ReferenceProfile(constant(speed, len(w)), w)


def identification(
    duration: float,
    speed: float = 2.0,
    initial_speed: float = 0.5,
    straight_duration: float = 7.0,
    radius_end: float = 6.0,
    direction: float = 1.0,
    speed_amplitude: float = 0.2,
    speed_period: float = 4.0,
) -> ReferenceProfile:
    """The manoeuvre of [2] 8.3: straight, then a spiral, both with an oscillating speed.

    v = C2 ramp from `initial_speed` with 1 m/s^2 at most + speed_amplitude sin(2 pi t /
    speed_period). The curvature is 0 for `straight_duration`, grows from 0 and reaches
    1 / radius_end at the end of the profile (or after SPIRAL_SHORTEST); it grows linearly
    but for a C3 onset. The paper prints neither radius nor speed: both are this project's.
    """
    times = knot_times(duration)
    v, dv, ddv = _smooth_ramp(times, initial_speed, speed, acceleration=1.0)
    rate = 2.0 * math.pi / speed_period
    sine, cosine = np.sin(rate * times), np.cos(rate * times)
    v = v + speed_amplitude * sine
    dv = dv + speed_amplitude * rate * cosine
    ddv = ddv - speed_amplitude * rate**2 * sine

    elapsed = np.maximum(times - straight_duration, 0.0)
    growth = max(times[-1] - straight_duration, SPIRAL_SHORTEST)
    slope = direction / (radius_end * (growth - 0.5 * SPIRAL_ONSET))  # [1/(m s)] d kappa / dt
    u = np.minimum(elapsed / SPIRAL_ONSET, 1.0)  # integral of the smoothstep, then linear
    onset = SPIRAL_ONSET * u**4 * (2.5 - u * (3.0 - u))
    kappa = slope * (onset + np.maximum(elapsed - SPIRAL_ONSET, 0.0))
    dkappa = slope * u**3 * (10.0 - u * (15.0 - 6.0 * u))
    ddkappa = slope / SPIRAL_ONSET * 30.0 * (u * (1.0 - u)) ** 2
    w = fit(v * kappa, dv * kappa + v * dkappa, ddv * kappa + 2.0 * dv * dkappa + v * ddkappa)
    return ReferenceProfile(fit(v, dv, ddv), w)


def chicane(
    duration: float,
    speed: float = 1.0,
    yaw_rate: float = 0.3,
    turn_time: float = 2.0,
    switch_time: float = 12.0,
) -> ReferenceProfile:
    """The deliberately discontinuous chicane F (53): ramp, left turn, right turn.

    v = speed t / (1 s) until `turn_time` [s], then `speed`: as printed, v overshoots by
    turn_time / (1 s) and jumps back. w = 0, then `yaw_rate` [rad/s], from `switch_time` [s]
    on -yaw_rate. The paper has 0.2 m/s, 0.3 rad/s and 20 s, for a vehicle of 62 kg.
    """
    starts = knot_times(duration)[:-1]
    before = starts < turn_time - 0.5 * SEGMENT_DURATION
    v, w = constant(speed, len(starts)), constant(-yaw_rate, len(starts))
    v[before, 0] = speed / CHICANE_RAMP_TIME * starts[before]
    v[before, 1] = speed / CHICANE_RAMP_TIME
    w[starts < switch_time - 0.5 * SEGMENT_DURATION, 0] = yaw_rate
    w[before, 0] = 0.0
    return ReferenceProfile(v, w)


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


@lru_cache
def _window_indices(count: int, width: int) -> NDArray[np.int64]:
    """Indices (count, width) of `count` neighbouring windows."""
    return np.arange(count)[:, None] + np.arange(width)


def _spline(coefficients: FloatArray, per_interval: int, segments: int) -> FloatArray:
    """Coefficients (S, 6) of the uniform cubic B-spline with those coefficients."""
    windows = coefficients[_window_indices(coefficients.size - 3, 4)]
    return (windows @ _spline_segments(per_interval)).reshape(-1, DEGREE + 1)[:segments]


def _clipped_draws(rng: np.random.Generator, count: int) -> FloatArray:
    """=clip(1.5 U(-1, 1), -1, 1): a third of the draws is at a limit."""
    draws = np.minimum(np.maximum(RANDOM_STRETCH * rng.uniform(-1.0, 1.0, count), -1.0), 1.0)
    draws[1:3] = draws[0]  # steady at the start: derivatives are zero there
    return draws


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
    segments = number_of_segments(duration)
    per_interval = round(knot_interval / SEGMENT_DURATION)
    count = -(-segments // per_interval) + 3
    low, high = speed_range
    v = 0.5 * (low + high) + 0.5 * (high - low) * _clipped_draws(rng, count)
    w = yaw_rate_limit * _clipped_draws(rng, count)
    # Coefficient n shares an interval with those from n - 3 to n + 3.
    padded = np.zeros(count + 6)
    padded[3:-3] = np.abs(v)
    fastest = padded[_window_indices(count, 7)].max(axis=1)
    bound = lateral_acceleration_limit / np.maximum(fastest, 1e-9)
    w = np.minimum(np.maximum(w, -bound), bound)
    return ReferenceProfile(_spline(v, per_interval, segments), _spline(w, per_interval, segments))
