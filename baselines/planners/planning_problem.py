"""The optimal control problem of a plan: unknowns, cost, limits, and initial guess.

    minimise   T + w_s N / 40 sum_k [(p_{k+1} - p_k)^2 + (w_{k+1} - w_k)^2]     w = 2 q / B
    subject to pose_N = goal,  g(p_k, q_k, p_{k-1}, q_{k-1}, T) >= 0
F (51a) sums over N = 40 intervals; the factor N / 40 makes the smoothing that of F for any N. The
speeds in it are those of the belts, as in the code of F.

Motion. The unknowns are T and the belt speeds alone. At held belt speeds v = v_x + i v_y and w are
constant, so that over a duration d the position in the axes of its beginning moves by
    a = d sigma(w d) v      sigma(theta) = (exp(i theta) - 1) / (i theta)
and the yaw by theta = w d, exactly. All intervals are equally long, d = T / N.

Limits, all in m/s; belt speeds p (mean) and q (half the difference), p_, q_ of the interval before,
h = B / 2. `Bounds` names the values.
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

Initial guess: a word as belt speeds over equal intervals. An arc is turned with SPARE of what the
belts can do with slip; where the speed is free, as slowly as that takes to turn as tightly as
wanted. From rest and to rest, short words are as slow as the accelerations demand.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), section 3.2 (27), 6.3 (which integrates by sub-steps of RK4).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.planners.slip_surface import COLUMNS, ROWS, motion_jets
from baselines.riccati import Stages, make_stages
from tracked_env.physics.jit import formula, loop

Array = NDArray[np.float64]

NODES = 40.0  # [-] intervals for which w_s is that of F
SMALL = 0.2  # [rad] below it sigma is a series: the closed forms lose digits like 1e-16 / theta^2
# Columns of the derivatives of a move (complex) and a turn; a turn is linear in T.
MOVE, MOVE_T, MOVE_P, MOVE_Q, MOVE_TT, MOVE_TP, MOVE_TQ, MOVE_PP, MOVE_PQ, MOVE_QQ = range(10)
TURN, TURN_T, TURN_P, TURN_Q, TURN_TP, TURN_TQ, TURN_PP, TURN_PQ, TURN_QQ = range(9)
COUNT = 17  # inequalities of an interval
FREE_SPEED = (2, 3, 4, 13, 14, 15, 16)  # those that have no meaning where p is prescribed
NO_LIMIT = 1.0  # [m/s] value of an inequality that does not exist on an interval
SPARE = 0.7  # [-] of the fastest turn of the belts: on the arcs of the words
HALVINGS = 12  # of the interval in which the belts of an arc are found
SLOW_ARC, SLOWER = 0.6, 0.9  # [-] of the speed of the words: on their arcs at least; a step to it
NEAREST = 1e-3  # [-] of their radius: that of the words to the nearest goals
SLOWEST_TURN = 1e-3  # [rad/s] of the words


class Task(NamedTuple):
    """A plan to be made, from (0, 0) at `yaw`."""

    yaw: float  # [rad] at the start
    goal_x: float  # [m] from the start, world axes
    goal_y: float
    turning: float  # [rad] change of yaw, whole turns included
    before_p: float  # [m/s] belt speeds at the start
    before_q: float
    ramp: bool  # whether the first interval must be reached from these
    rising: int  # first intervals that may be slower than the slowest
    falling: int  # last intervals that may
    smoothing: float  # [-] w_s


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
    fixed: bool  # whether p is prescribed
    stop: bool  # whether the vehicle rests at the end


class Work(NamedTuple):
    """Work space of a solver for N intervals."""

    belts: Array  # (N, 2) p, q
    trial: Array  # (N, 2)
    moves: NDArray[np.complex128]  # (N, 10) moves of the intervals with derivatives, world
    turns: Array  # (N, 9) turns with derivatives
    values: Array  # (N, COUNT) g
    slopes: Array  # (N, COUNT, 5) its gradient in p_, q_, T, p, q
    bends: Array  # (N, COUNT, 3) its second derivatives
    slacks: Array  # (N, COUNT) s
    old_slacks: Array  # (N, COUNT) s before a step
    duals: Array  # (N, COUNT) y
    slack_steps: Array  # (N, COUNT)
    dual_steps: Array  # (N, COUNT)
    rows: Array  # (3, ROWS)
    columns: Array  # (3, 2 COLUMNS)
    chosen: NDArray[np.int64]  # (COUNT,)
    error: Array  # (3,) terminal error: x, y [m], yaw [rad]
    nu: Array  # (3,)
    new_nu: Array  # (3,)
    terminal: Array  # (3, 4) what the terminal pose gains from multipliers
    stages: Stages  # of the Newton step


@formula
def make_work(n):
    """Work space for n intervals."""
    c, per = COUNT, (n, COUNT)
    belts = np.empty((n, 2)), np.empty((n, 2))
    motion = np.empty((n, 10), np.complex128), np.empty((n, 9))
    limits = np.empty(per), np.empty((n, c, 5)), np.empty((n, c, 3))
    slacks = np.empty(per), np.empty(per), np.empty(per), np.empty(per), np.empty(per)
    slip = np.empty((3, ROWS)), np.empty((3, 2 * COLUMNS))
    goal = np.empty(c, np.int64), np.empty(3), np.empty(3), np.empty(3), np.empty((3, 4))
    stages = make_stages(n, 6, 3, 4, 4)
    return Work(*belts, *motion, *limits, *slacks, *slip, *goal, stages)  # type: ignore[arg-type]


@formula
def _chord_series(x):
    """sigma, sigma', sigma'' for |x| <= SMALL, error below 1e-15."""
    t = x * x
    s = 1.0 - t / 6.0 * (1.0 - t / 20.0 * (1.0 - t / 42.0 * (1.0 - t / 72.0)))
    c = 0.5 * x * (1.0 - t / 12.0 * (1.0 - t / 30.0 * (1.0 - t / 56.0 * (1.0 - t / 90.0))))
    s_1 = x * (
        -1.0 / 3.0 + t * (1.0 / 30.0 - t * (1.0 / 840.0 - t * (1.0 / 45360.0 - t / 3991680.0)))
    )
    c_1 = 0.5 - t * (0.125 - t * (1.0 / 144.0 - t * (1.0 / 5760.0 - t / 403200.0)))
    s_2 = -1.0 / 3.0 + t * (0.1 - t * (1.0 / 168.0 - t * (1.0 / 6480.0 - t / 443520.0)))
    c_2 = x * (-0.25 + t * (1.0 / 36.0 - t * (1.0 / 960.0 - t * (1.0 / 50400.0 - t / 4354560.0))))
    return complex(s, c), complex(s_1, c_1), complex(s_2, c_2)


@formula
def chord(x):
    """sigma, its first and second derivative, and exp(i x), at an angle x [rad]."""
    cosine, sine = math.cos(x), math.sin(x)
    if abs(x) <= SMALL:
        sigma, sigma_1, sigma_2 = _chord_series(x)
    else:
        s, c = sine / x, (1.0 - cosine) / x
        s_1, c_1 = (cosine - s) / x, (sine - c) / x
        sigma, sigma_1 = complex(s, c), complex(s_1, c_1)
        sigma_2 = complex((-sine - 2.0 * s_1) / x, (cosine - 2.0 * c_1) / x)
    return sigma, sigma_1, sigma_2, complex(cosine, sine)


@loop
def arc_jet(v_x, v_y, w, duration, per_interval, direction, move, turn):
    """Move [m] and turn [rad] of an interval with their derivatives in T, p, q.

    v_x, v_y, w: jets in p, q. per_interval = 1 / N. direction = exp(i yaw) at its beginning: turns
    the moves into the world. move (10,), turn (9,): out. Returns `direction` at its end.
    """
    d, n, u = duration, per_interval, direction
    sigma, sigma_1, sigma_2, end = chord(w.value * d)
    v = complex(v_x.value, v_y.value)
    v_p, v_q = complex(v_x.p, v_y.p), complex(v_x.q, v_y.q)
    a, b = u * (d * sigma), u * (d * d * sigma_1)
    bv, cv, last = b * v, u * (d * d * d * sigma_2) * v, n * u * end
    move[MOVE] = a * v
    move[MOVE_T] = last * v
    move[MOVE_P] = a * v_p + w.p * bv
    move[MOVE_Q] = a * v_q + w.q * bv
    move[MOVE_TT] = last * v * complex(0.0, n * w.value)
    move[MOVE_TP] = last * (v_p + v * complex(0.0, d * w.p))
    move[MOVE_TQ] = last * (v_q + v * complex(0.0, d * w.q))
    move[MOVE_PP] = a * complex(v_x.pp, v_y.pp) + 2.0 * w.p * b * v_p + w.pp * bv + w.p * w.p * cv
    move[MOVE_PQ] = (
        a * complex(v_x.pq, v_y.pq) + b * (w.p * v_q + w.q * v_p) + w.pq * bv + w.p * w.q * cv
    )
    move[MOVE_QQ] = a * complex(v_x.qq, v_y.qq) + 2.0 * w.q * b * v_q + w.qq * bv + w.q * w.q * cv
    turn[TURN], turn[TURN_T] = w.value * d, n * w.value
    turn[TURN_P], turn[TURN_Q] = d * w.p, d * w.q
    turn[TURN_TP], turn[TURN_TQ] = n * w.p, n * w.q
    turn[TURN_PP], turn[TURN_PQ], turn[TURN_QQ] = d * w.pp, d * w.pq, d * w.qq
    return u * end


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
        by_p, by_q = v_x.value * v_x.p + v_y.value * v_y.p, v_x.value * v_x.q + v_y.value * v_y.q
        _put(row, bend, 0.0, 0.0, 0.0, -f * by_p, -f * by_q)
        bend[0] = -f * (v_x.p * v_x.p + v_x.value * v_x.pp + v_y.p * v_y.p + v_y.value * v_y.pp)
        bend[1] = -f * (v_x.p * v_x.q + v_x.value * v_x.pq + v_y.p * v_y.q + v_y.value * v_y.pq)
        bend[2] = -f * (v_x.q * v_x.q + v_x.value * v_x.qq + v_y.q * v_y.q + v_y.value * v_y.qq)
        return 0.5 * f * (b.fastest * b.fastest - v_x.value * v_x.value - v_y.value * v_y.value)
    if i <= 6:
        f = (1.0 if i == 6 else -1.0) * h / b.fastest
        by_p, by_q = v_x.p * w.value + v_x.value * w.p, v_x.q * w.value + v_x.value * w.q
        _put(row, bend, 0.0, 0.0, 0.0, f * by_p, f * by_q)
        bend[0] = f * (v_x.pp * w.value + 2.0 * v_x.p * w.p + v_x.value * w.pp)
        bend[1] = f * (v_x.pq * w.value + v_x.p * w.q + v_x.q * w.p + v_x.value * w.pq)
        bend[2] = f * (v_x.qq * w.value + 2.0 * v_x.q * w.q + v_x.value * w.qq)
        return b.lateral * h / b.fastest + f * v_x.value * w.value
    f, k = (h if i == 8 else -h), h * b.curvature
    _put(row, bend, 0.0, 0.0, 0.0, k * v_x.p + f * w.p, k * v_x.q + f * w.q)
    bend[0], bend[1] = k * v_x.pp + f * w.pp, k * v_x.pq + f * w.pq
    bend[2] = k * v_x.qq + f * w.qq
    return k * v_x.value + f * w.value


class Interval(NamedTuple):
    """What the limits of one interval depend on."""

    p: float  # [m/s] belt speeds
    q: float
    before_p: float  # [m/s] of the interval before
    before_q: float
    ramp: bool  # whether there is one, or a motion at the start
    slow: bool  # whether the vehicle may be slower than the slowest
    last: bool
    duration: float  # [s] d
    share: float  # [-] 1 / N


@loop
def inequality(i, b, at, motion, row, bend):
    """Value of inequality i on an Interval, with its derivatives; motion: jets of v_x, v_y, w.

    row (5,): gradient in (p_, q_, T, p, q); bend (3,): second derivatives pp, pq, qq, both out.
    """
    if i <= 1:
        side = 1.0 if i == 0 else -1.0
        _put(row, bend, 0.0, 0.0, 0.0, -1.0, -side)
        return b.belt - at.p - side * at.q
    if i <= 3:
        side = 1.0 if i == 2 else -1.0
        _put(row, bend, 0.0, 0.0, 0.0, side, 0.0)
        slowest = 0.0 if at.slow else b.slowest
        return side * (at.p - (slowest if i == 2 else b.fastest))
    if i <= 8:
        return _of_speeds(i, b, *motion, row, bend)
    if not (at.last if i >= 15 else at.ramp):
        _put(row, bend, 0.0, 0.0, 0.0, 0.0, 0.0)
        return NO_LIMIT
    if i >= 15:
        side = 1.0 if i == 15 else -1.0
        _put(row, bend, 0.0, 0.0, b.belt_rate * at.share, -1.0, -side)
        return b.belt_rate * at.duration - at.p - side * at.q
    along = 1.0 if i % 2 == 1 else -1.0
    across = 0.0 if i >= 13 else (1.0 if i <= 10 else -1.0)
    rate = b.rate if i >= 13 else b.belt_rate
    _put(row, bend, along, across, rate * at.share, -along, -across)
    return rate * at.duration - along * (at.p - at.before_p) - across * (at.q - at.before_q)


@loop
def evaluate(task, bounds, surface, duration, belts, active, w):
    """Cost [s] at a duration and belts (N, 2); terminal error, motion and limits into `w`."""
    n = len(belts)
    share = 1.0 / n
    d = duration * share
    place, yaw = 0j, 0.0
    direction = complex(math.cos(task.yaw), math.sin(task.yaw))
    weight = task.smoothing * n / NODES
    turn_weight = weight / (bounds.half_gauge * bounds.half_gauge)
    cost, b_p, b_q = duration, task.before_p, task.before_q
    for k in range(n):
        p, q = belts[k, 0], belts[k, 1]
        motion = motion_jets(surface, p, q, w.rows, w.columns)
        direction = arc_jet(*motion, d, share, direction, w.moves[k], w.turns[k])
        place += w.moves[k, MOVE]
        yaw += w.turns[k, TURN]
        if k > 0:
            b_p, b_q = belts[k - 1, 0], belts[k - 1, 1]
            cost += weight * (p - b_p) ** 2 + turn_weight * (q - b_q) ** 2
        slow = k < task.rising or k >= n - task.falling
        at = Interval(p, q, b_p, b_q, k > 0 or task.ramp, slow, k == n - 1, d, share)
        for a in range(active):
            w.values[k, a] = inequality(
                w.chosen[a], bounds, at, motion, w.slopes[k, a], w.bends[k, a]
            )
    w.error[0] = place.real - task.goal_x
    w.error[1] = place.imag - task.goal_y
    w.error[2] = yaw - task.turning
    return cost


class Setting(NamedTuple):
    """What the plans of a batch have in common."""

    radius: float  # [m] of the words, at least
    speed: float  # [m/s] of the belts' mean along their lines, and on their arcs at most
    before_p: float  # [m/s] belt speeds at the start
    before_q: float
    ramp: bool  # whether the first interval must be reached from them
    smoothing: float  # [-] w_s
    turning: float  # [rad] change of yaw, of which words differ by less than a half turn; NaN: any


class Word(NamedTuple):
    """Where a plan starts from."""

    segments: Array  # [m] (3,)
    signs: Array  # (3,) 1: left, -1: right, 0: straight
    turning: float  # [rad]
    total: float  # [s] its duration
    arc: tuple[float, float, float]  # [m/s] belts p, q and ground speed on its arcs


@formula
def _arc_at(p, target, surface, bounds, w):
    """Radius [m] of a turn at belts' mean p [m/s] and (p, q, ground speed [m/s]) in it.

    The radius is at least `target`, and so wide that with slip SPARE of what the belts can do is
    enough.
    """
    low, high = 0.0, SPARE * (bounds.belt - p)
    for step in range(HALVINGS + 1):
        q = high if step == 0 else 0.5 * (low + high)
        v_x, v_y, turn = motion_jets(surface, p, q, w.rows, w.columns)
        speed = math.hypot(v_x.value, v_y.value)
        if turn.value * target < speed:  # a wider turn than target
            if step == 0:
                return speed / max(turn.value, SLOWEST_TURN), (p, q, speed)
            low = q
        else:
            high = q
    return target, (p, q, speed)


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
    target, p = near * setting.radius, setting.speed
    least = max(SLOW_ARC * near * p, bounds.slowest)
    radius, arc = _arc_at(p, target, surface, bounds, w)
    while radius > target and p > least:
        p = max(SLOWER * p, least)
        radius, arc = _arc_at(p, target, surface, bounds, w)
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
    target = 0.0 if math.isnan(setting.turning) else setting.turning
    turning -= 2.0 * math.pi * round((turning - target) / (2.0 * math.pi))
    if other:
        turning -= math.copysign(2.0 * math.pi, turning - target)
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
def guess(word, on_arc, on_line, least, belts):
    """Belts (N, 2) of a word, means over equal times; the duration.

    on_arc, on_line: belts p, q and ground speed [m/s] there.
    least: duration [s] below which it is driven more slowly.
    """
    n, total = len(belts), word.total
    step, slowed = total / n, min(total / least, 1.0) if least > 0.0 else 1.0
    for k in range(n):
        p, q, begin = 0.0, 0.0, 0.0
        for part in range(3):
            there = on_line if word.signs[part] == 0.0 else on_arc
            end = begin + word.segments[part] / there[2]
            share = max(min(end, (k + 1) * step) - max(begin, k * step), 0.0) / step
            p += share * there[0]
            q += share * word.signs[part] * there[1]
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
