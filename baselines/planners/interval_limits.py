"""Limits of a plan on each of its intervals as inequalities g >= 0, all in m/s.

Belt speeds p (mean) and q (half the difference); p_, q_ of the interval before; h = B / 2,
d = T / N. `Bounds` names the values.

    0, 1    sprockets             belt - p -+ q >= 0
    2, 3    belts on the mean     p - slowest >= 0,  fastest - p >= 0
    4       ground speed          (fastest^2 - v_x^2 - v_y^2) / (2 fastest) >= 0
    5, 6    lateral acceleration  (lateral -+ v_x w) h / fastest >= 0
    7, 8    curvature             h (curvature v_x -+ w) >= 0
    9..12   sprocket acceleration belt_rate d -+ (p - p_) -+ (q - q_) >= 0
    13, 14  acceleration          rate d -+ (p - p_) >= 0
    15, 16  stop, last interval   belt_rate d - p -+ q >= 0: at rest one interval later
With |q| <= belt - p neither sprocket exceeds its limit in reverse, as p >= 0. The ground speed is
bounded only where p is free: at a given p it follows from the turning rate.
"""

import math
from typing import NamedTuple

from tracked_env.physics.jit import formula, loop

COUNT = 17  # inequalities of an interval
FREE_SPEED = (2, 3, 4, 13, 14, 15, 16)  # those that have no meaning where p is given
NONE = 1.0  # [m/s] value of an inequality that does not exist on an interval


class Bounds(NamedTuple):
    """Values of the limits; infinite: no such limit."""

    belt: float  # [m/s] of either belt
    slowest: float  # [m/s] of the mean of both
    fastest: float  # [m/s] of the mean of both, and of the ground speed
    lateral: float  # [m/s^2] |v_x w|
    curvature: float  # [1/m] |w / v_x|
    belt_rate: float  # [m/s^2] of either belt
    rate: float  # [m/s^2] of the mean of both
    half_gauge: float  # [m] h
    fixed: bool  # whether p is given
    stop: bool  # whether the vehicle rests at the end


@formula
def choose(bounds, chosen):
    """Indices of the inequalities that these bounds need into chosen (COUNT,); their number."""
    n = 0
    for i in range(COUNT):
        needed = not (bounds.fixed and i in FREE_SPEED)
        if i == 5 or i == 6:
            needed = bounds.lateral < math.inf
        elif i == 7 or i == 8:
            needed = bounds.curvature < math.inf
        elif 9 <= i <= 12:
            needed = bounds.belt_rate < math.inf
        elif i == 13 or i == 14:
            needed = needed and bounds.rate < math.inf
        elif i >= 15:
            needed = needed and bounds.stop
        if needed:
            chosen[n] = i
            n += 1
    return n


@formula
def _put(row, bend, before_p, before_q, t, p, q):
    """Gradient in (p_, q_, T, p, q); no second derivatives."""
    row[0], row[1], row[2], row[3], row[4] = before_p, before_q, t, p, q
    bend[0], bend[1], bend[2] = 0.0, 0.0, 0.0


@formula
def _of_speeds(i, b, v_x, v_y, w, row, bend):
    """Inequalities 4 to 8, on the motion over the ground."""
    h = b.half_gauge
    if i == 4:
        f = 1.0 / b.fastest
        _put(row, bend, 0.0, 0.0, 0.0, -f * (v_x.value * v_x.p + v_y.value * v_y.p),
             -f * (v_x.value * v_x.q + v_y.value * v_y.q))  # fmt: skip
        bend[0] = -f * (v_x.p * v_x.p + v_x.value * v_x.pp + v_y.p * v_y.p + v_y.value * v_y.pp)
        bend[1] = -f * (v_x.p * v_x.q + v_x.value * v_x.pq + v_y.p * v_y.q + v_y.value * v_y.pq)
        bend[2] = -f * (v_x.q * v_x.q + v_x.value * v_x.qq + v_y.q * v_y.q + v_y.value * v_y.qq)
        return 0.5 * f * (b.fastest * b.fastest - v_x.value * v_x.value - v_y.value * v_y.value)
    if i <= 6:
        f = (1.0 if i == 6 else -1.0) * h / b.fastest
        _put(row, bend, 0.0, 0.0, 0.0, f * (v_x.p * w.value + v_x.value * w.p),
             f * (v_x.q * w.value + v_x.value * w.q))  # fmt: skip
        bend[0] = f * (v_x.pp * w.value + 2.0 * v_x.p * w.p + v_x.value * w.pp)
        bend[1] = f * (v_x.pq * w.value + v_x.p * w.q + v_x.q * w.p + v_x.value * w.pq)
        bend[2] = f * (v_x.qq * w.value + 2.0 * v_x.q * w.q + v_x.value * w.qq)
        return b.lateral * h / b.fastest + f * v_x.value * w.value
    f, k = (h if i == 8 else -h), h * b.curvature
    _put(row, bend, 0.0, 0.0, 0.0, k * v_x.p + f * w.p, k * v_x.q + f * w.q)
    bend[0], bend[1] = k * v_x.pp + f * w.pp, k * v_x.pq + f * w.pq
    bend[2] = k * v_x.qq + f * w.qq
    return k * v_x.value + f * w.value


@loop
def inequality(i, b, speeds, before, place, interval, v_x, v_y, w, row, bend):
    """Value of inequality i, with its derivatives.

    row (5,): gradient in (p_, q_, T, p, q); bend (3,): second derivatives pp, pq, qq, both out.
    speeds = (p, q); before = (p_, q_). place: whether there is an interval before, whether the
    vehicle may be slower than `slowest`, whether it is the last. interval = (d, 1 / N).
    """
    p, q = speeds
    has_before, slow, last = place
    if i <= 1:
        side = 1.0 if i == 0 else -1.0
        _put(row, bend, 0.0, 0.0, 0.0, -1.0, -side)
        return b.belt - p - side * q
    if i <= 3:
        side = 1.0 if i == 2 else -1.0
        _put(row, bend, 0.0, 0.0, 0.0, side, 0.0)
        slowest = 0.0 if slow else b.slowest
        return side * (p - (slowest if i == 2 else b.fastest))
    if i <= 8:
        return _of_speeds(i, b, v_x, v_y, w, row, bend)
    if not (last if i >= 15 else has_before):
        _put(row, bend, 0.0, 0.0, 0.0, 0.0, 0.0)
        return NONE
    if i >= 15:
        side = 1.0 if i == 15 else -1.0
        _put(row, bend, 0.0, 0.0, b.belt_rate * interval[1], -1.0, -side)
        return b.belt_rate * interval[0] - p - side * q
    along = 1.0 if i % 2 == 1 else -1.0
    across = 0.0 if i >= 13 else (1.0 if i <= 10 else -1.0)
    rate = b.rate if i >= 13 else b.belt_rate
    _put(row, bend, along, across, rate * interval[1], -along, -across)
    return rate * interval[0] - along * (p - before[0]) - across * (q - before[1])
