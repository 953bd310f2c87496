"""Samples of a plan with held belt speeds, and its end as the pseudo-kinematic model finds it.

From one sample to the next sprocket speeds, ground speed and yaw rate hold, and so does
alpha = course - yaw: poses at the samples are exact. Derivatives are slopes between the middles of
the intervals. The end is integrated by Runge-Kutta steps of the model (pseudo_kinematic), which
share nothing with the arcs but the surface.
"""

import math

import numpy as np

from baselines.lyapunov.lyapunov_laws import BodyMotion
from baselines.lyapunov.pseudo_kinematic import pose_step
from baselines.planners.arc_motion import chord
from baselines.planners.slip_surface import COLUMNS, ROWS, motion_jets
from tracked_env.physics.jit import copy_entries, formula, loop

# Columns of a sample, in the order of Trajectory.
COLUMN_COUNT = 13
LARGEST_TURN = 0.05  # [rad] of a Runge-Kutta step


@formula
def _slope(values, k, later, step):
    """Slope of values (N,) between the middles of intervals, before or after that of k."""
    n = len(values)
    if n < 2:
        return 0.0
    first = min(max(k if later else k - 1, 0), n - 2)
    return (values[first + 1] - values[first]) / step


@formula
def _bend(values, k, step):
    """Second derivative of values (N,) at interval k."""
    if k < 1 or k >= len(values) - 1:
        return 0.0
    return (values[k + 1] - 2.0 * values[k] + values[k - 1]) / (step * step)


@loop
def samples(pose, duration, belts, surface, radius, times, out):
    """Samples (M, COLUMN_COUNT) of belts (N, 2) from pose (3,) at times (M,), into out.

    Returns the pose at the end by Runge-Kutta steps of the model.
    """
    n = len(belts)
    step = duration / n
    rows, columns = np.empty((3, ROWS)), np.empty((3, 2 * COLUMNS))
    forward, alpha, speed, turn = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    knots = np.empty((n + 1, 3))
    copy_entries(pose, knots[0])
    x, y, yaw = pose[0], pose[1], pose[2]
    for k in range(n):
        v_x, v_y, w = motion_jets(surface, belts[k, 0], belts[k, 1], rows, columns)
        forward[k], turn[k] = v_x.value, w.value
        alpha[k] = math.atan(v_y.value / v_x.value) if v_x.value != 0.0 else 0.0
        speed[k] = math.copysign(math.hypot(v_x.value, v_y.value), v_x.value)
        parts = int(abs(w.value) * step / LARGEST_TURN) + 1
        motion = BodyMotion(v_x.value, w.value)
        for _ in range(parts):
            x, y, yaw = pose_step(x, y, yaw, motion, alpha[k], step / parts)
        sigma, _first, _second, _end = chord(turn[k] * step)
        course = knots[k, 2] + alpha[k]
        move = sigma * complex(math.cos(course), math.sin(course)) * (speed[k] * step)
        knots[k + 1, 0] = knots[k, 0] + move.real
        knots[k + 1, 1] = knots[k, 1] + move.imag
        knots[k + 1, 2] = knots[k, 2] + turn[k] * step
    for m in range(len(times)):
        k = min(int(times[m] / step * (1.0 + 1e-12)), n - 1)
        since = times[m] - k * step
        later = since > 0.5 * step
        sigma, _first, _second, _end = chord(turn[k] * since)
        course = knots[k, 2] + alpha[k]
        move = sigma * complex(math.cos(course), math.sin(course)) * (speed[k] * since)
        now, o = knots[k, 2] + turn[k] * since, out[m]
        o[0], o[1], o[2], o[3] = times[m], knots[k, 0] + move.real, knots[k, 1] + move.imag, now
        o[4], o[5], o[6] = now + alpha[k], speed[k], _slope(speed, k, later, step)
        o[7] = turn[k] + _slope(alpha, k, later, step)
        o[8] = _slope(turn, k, later, step) + _bend(alpha, k, step)
        o[9], o[10] = turn[k], _slope(turn, k, later, step)
        o[11] = (belts[k, 0] - belts[k, 1]) / radius
        o[12] = (belts[k, 0] + belts[k, 1]) / radius
    return x, y, yaw
