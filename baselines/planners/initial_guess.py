"""Starts of optimal plans: words of Dubins as belt speeds over equal intervals.

On the lines of a word both belts run at the speed of the setting. An arc is turned with SPARE of
what the belts can do with slip; where the speed is free, as slowly as that takes to turn as
tightly as wanted. Near goals have words as small as they are near. From rest and to rest, short
words are driven as slowly as the accelerations allow.

Samples of a plan with held belt speeds, and its end as the pseudo-kinematic model finds it.

From one sample to the next sprocket speeds, ground speed and yaw rate hold, and so does
alpha = course - yaw: poses at the samples are exact. Derivatives are slopes between the middles of
the intervals. The end is integrated by Runge-Kutta steps of the model (lyapunov_laws), which
share nothing with the arcs but the surface.
"""

import math
from typing import NamedTuple

import numpy as np

from baselines.lyapunov.lyapunov_laws import BodyMotion, pose_step
from baselines.planners.planning_problem import chord
from baselines.planners.slip_surface import COLUMNS, ROWS, motion_jets
from tracked_env.physics.jit import copy_entries, formula, loop

SPARE = 0.7  # [-] of the fastest turn of the belts: on the arcs of the words
HALVINGS = 12  # of the interval in which the belts of an arc are found
SLOW_ARC, SLOWER = 0.6, 0.9  # [-] of the speed of the words: on their arcs at least; a step to it
NEAREST = 1e-3  # [-] of their radius: that of the words to the nearest goals
SLOWEST_TURN = 1e-3  # [rad/s] of the words


class Setting(NamedTuple):
    """What the plans of a batch have in common."""

    radius: float  # [m] of the words, at least
    speed: float  # [m/s] of the belts' mean along their lines, and on their arcs at most
    before_p: float  # [m/s] belt speeds at the start
    before_q: float
    ramp: bool  # whether the first interval must be reached from them
    smoothing: float  # [-] w_s
    turning: float  # [rad] change of yaw, of which words differ by less than a half turn; NaN: any


@formula
def _arc_at(p, wanted, surface, bounds, w):
    """Radius [m] of a turn at belts' mean p [m/s] and (p, q, ground speed [m/s]) in it.

    The radius is at least `wanted`, and so wide that with slip SPARE of what the belts can do is
    enough.
    """
    low, high = 0.0, SPARE * (bounds.belt - p)
    for step in range(HALVINGS + 1):
        q = high if step == 0 else 0.5 * (low + high)
        v_x, v_y, turn = motion_jets(surface, p, q, w.rows, w.columns)
        speed = math.hypot(v_x.value, v_y.value)
        if turn.value * wanted < speed:  # a wider turn than wanted
            if step == 0:
                return speed / max(turn.value, SLOWEST_TURN), (p, q, speed)
            low = q
        else:
            high = q
    return wanted, (p, q, speed)


@loop
def arc_of(distance, surface, bounds, setting, w):
    """The arcs of the words to a goal at a distance [m].

    Where its speed is free, the vehicle turns more slowly as far as needed for setting.radius, but
    not below SLOW_ARC of the speed of the words and v_min; near goals have words as small as they
    are near.
    """
    if bounds.fixed:
        return _arc_at(setting.speed, setting.radius, surface, bounds, w)
    near = max(min(0.5 * distance / setting.radius, 1.0), NEAREST)
    wanted, p = near * setting.radius, setting.speed
    least = max(SLOW_ARC * near * p, bounds.slowest)
    radius, arc = _arc_at(p, wanted, surface, bounds, w)
    while radius > wanted and p > least:
        p = max(SLOWER * p, least)
        radius, arc = _arc_at(p, wanted, surface, bounds, w)
    return radius, arc


@formula
def tight_arc(radius, bounds, setting):
    """(p, q, speed) [m/s] on arcs of a radius [m] without slip, or as tight as SPARE allows."""
    p = setting.speed
    return p, min(p * bounds.half_gauge / radius, SPARE * (bounds.belt - p)), p


@formula
def one_arc(start, goal, other, bounds, setting):
    """One arc towards a goal: its turn [rad], two durations [s] and (p, q, speed) [m/s].

    It turns by less than a half turn, if the setting wants no other; other: the other way round.
    The first duration is that of the start of a plan, at least of the turns to the goal and to the
    yaw there; the second has turns and way one after the other, as few goals are on one arc.
    """
    turning = goal[2] - start[2]
    wanted = 0.0 if math.isnan(setting.turning) else setting.turning
    turning -= 2.0 * math.pi * round((turning - wanted) / (2.0 * math.pi))
    if other:
        turning -= math.copysign(2.0 * math.pi, turning - wanted)
    away = math.hypot(goal[0] - start[0], goal[1] - start[1])
    bearing = math.atan2(goal[1] - start[1], goal[0] - start[0]) - start[2]
    bearing -= 2.0 * math.pi * round(bearing / (2.0 * math.pi))
    turned = (abs(bearing) + abs(turning - bearing)) * bounds.half_gauge
    turned /= SPARE * (bounds.belt - setting.speed)
    total = max(away / setting.speed, turned, 1e-9)
    p = setting.speed if bounds.fixed else max(away / total, bounds.slowest)
    one_by_one = away / setting.speed + turned
    return turning, total, one_by_one, (p, turning * bounds.half_gauge / total, p)


@formula
def duration_of(angles, signs, radius, arc, setting):
    """Duration [s] of a word of segments [radii]."""
    total = 0.0
    for part in range(3):
        total += radius * angles[part] / (setting.speed if signs[part] == 0.0 else arc[2])
    return total


@formula
def guess(segments, signs, on_arc, on_line, total, least, belts):
    """Belts (N, 2) of a word, means over equal times; the duration.

    on_arc, on_line: belts p, q and ground speed [m/s] there. total: duration [s] of the word.
    least: duration [s] below which it is driven more slowly.
    """
    n = len(belts)
    step, slowed = total / n, min(total / least, 1.0) if least > 0.0 else 1.0
    for k in range(n):
        p, q, begin = 0.0, 0.0, 0.0
        for part in range(3):
            there = on_line if signs[part] == 0.0 else on_arc
            end = begin + segments[part] / there[2]
            share = max(min(end, (k + 1) * step) - max(begin, k * step), 0.0) / step
            p += share * there[0]
            q += share * signs[part] * there[1]
            begin = end
        belts[k, 0], belts[k, 1] = slowed * p, slowed * q
    return total / slowed


@formula
def gathering(length, bounds, setting):
    """Least duration [s] of a way [m] from the speed of the start, and to rest with `stop`."""
    rate = min(bounds.belt_rate, bounds.rate)
    if not setting.ramp or rate == math.inf:
        return 0.0
    if bounds.stop:
        return 2.0 * math.sqrt(length / rate) - setting.before_p / rate
    p = max(setting.before_p, 0.0)
    return (math.sqrt(p * p + 2.0 * rate * length) - p) / rate


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
