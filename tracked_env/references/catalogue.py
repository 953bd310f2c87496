"""The catalogue of references: each function turns a few numbers into a profile; `random_path` has
the random ones.

With kappa = w / v the curvature of the path, left positive:
    straight         kappa = 0
    circle           kappa = +-1 / R
    spiral           kappa linear in time: at constant speed a clothoid
    figure_eight     yaw = a (1 - cos(Omega t)), a = first zero of the Bessel function J0: the
                     sine-generated curve that closes into an eight
    identification   straight, then a spiral from kappa = 0, with a speed that oscillates
    chicane          F (53), jumps in v and w
Parameters are those that `specification` has checked; nothing is checked again here. Angles
in rad, the start is the origin, yaw 0, unless the pose is set afterwards. Every profile goes
on by its own law until one segment after `duration` and keeps v and w from there.

References: [1] Focchi et al. 2025, (53). [2] Strawa et al., Electronics 10 (2021) 187, 8.3.
[3] Langbein, Leopold, River Meanders, USGS Prof. Paper 422-H, 1966 (sine-generated curve).
"""

import math

import numpy as np

from tracked_env.physics.reference_profile import SEGMENT_DURATION
from tracked_env.references.profile import (
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
