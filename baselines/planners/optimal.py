"""Plans of least time for a vehicle whose tracks slip: F 6.3.

Belt speeds are held over N equal intervals, and slip is a smooth surface over them (surface_fit).
The interior point method starts from Dubins words of the start and the goal (start_words), in the
order of their durations: left and right turns are different minima, and the whole turns of a word
are the yaw that its plan ends at. All words are tried as long as none has led to a plan, then those
with other whole turns and a duration below LONGER of the least plus EXTRA, of which wide words have
more, as their arcs tell little of the plan; FURTHER iterations each while ALTOGETHER are not spent,
and not on while their plan costs DEARER than the best. Wide arcs hide plans to near goals, which
are one bend, or have tighter turns. A plan that costs DOUBTED times the duration of one arc, or of
a word of arcs of TIGHT track gauges, is doubted: these are tried too, words of three arcs first, as
they are slow and most plans are found from them. Where nothing leads to a plan, all words are tried
again with more patience. The plan of least cost is taken.

Constant speed (v_min = v_max): the belts' mean is given from the first moment to the last. Other-
wise, with a limit on sprocket acceleration, the first interval must be reached from the sprocket
speeds of the start, within one interval, and with `stop` rest from the last one; v_min does not
hold while the vehicle gathers speed there. The ground speed is at most v_max too, as with slip the
vehicle would else drift faster than its belts run.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 6.3, 7.2.

Optimal plans that may drive in reverse: the cheapest of one gear, and of changes between both.

A vehicle in reverse is one that drives forwards with its ends exchanged: turned by pi, with the
left track for the right one and sprockets that run the other way. Slip is mirrored with it, as the
tracks are symmetric from front to back: p -> -p, v_x -> -v_x, v_y -> -v_y at the same q and w. So a
plan in reverse is the forward plan from the turned start to the turned goal, exactly.

Changes of gear are those of Reeds-Shepp paths, of RADII times the radius at which the belts
can turn: their cusps are poses that legs in alternating gears join, each a plan of least time that
ends at rest, if the limits say how to brake. The cusps are not optimized further.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.curves import (
    SIGNS,
    SNAP,
    Path,
    places,
    reeds_shepp,
    relative,
    segments_of_words,
)
from baselines.planners.initial_guess import (
    COLUMN_COUNT,
    Setting,
    arc_of,
    duration_of,
    gathering,
    guess,
    one_arc,
    samples,
    tight_arc,
)
from baselines.planners.interior_point import make_stages, solve
from baselines.planners.legs import end_of, joined
from baselines.planners.planning_problem import Bounds, Task, make_work
from baselines.planners.slip_surface import SlipSurface, surface_of
from baselines.planners.trajectory import (
    ANGLE,
    Limits,
    Start,
    Trajectory,
    checked_limits,
    checked_poses,
    checked_sample_count,
    checked_starts,
    failed_plan,
)
from baselines.slip.slip_models import SlipModel
from tracked_env.physics.jit import copy_table, formula, loop
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.validation import checked_number, checked_whole

Array = NDArray[np.float64]


INTERVALS = Range(2, 2000, "-", "It is the number of intervals, not their duration.")
SMOOTHING = Range(1e-6, 1e6, "-", "It is the weight w_s.")
PERIOD = Range(1e-4, 10.0, "s", "It is the time between samples.")
THREADS = Range(1, 256, "-", "It is the number of threads.")
ITERATIONS, PATIENT = 100, 200  # from a word, as long as no plan is found; where none led to one
FURTHER, ALTOGETHER = 30, 80  # from a word once a plan was found; from all words then
LONGER, LONGER_FREE = 1.1, 1.4  # [-] of the least duration: words tried further; at free speed
EXTRA, WIDE = 0.3, 2.0  # [m], [-] of the radius of the words: on top, at the speed of the words
DOUBTED, TIGHT = 1.35, (0.66, 0.165)  # [-] of the duration of a tight word; of the track gauge
TIGHTER, TIGHTER_ALTOGETHER = 150, 400  # iterations from a tight word; from all of them
DEARER = 1.2  # [-] of the least cost found: a plan from a further word is given up above it
BRIEF = 0.3  # [s] duration of a word below which it is tried at constant speed too
RADIUS = 0.4  # [-] of the track gauge: turning radius of the words
INSIDE = 0.9  # [-] of the way from v_min to v_max: speed along the words
SAME = 1e-9  # [m, rad] poses that differ by less are one
FOUND = 0.1  # [rad] yaws at the end that differ by less have the same whole turns
SHARE = 4  # blocks of a batch per thread: plans take different times
# Columns of what a row of a batch gives.
DURATION, COST, CONVERGED, USED, RESULTS = 0, 1, 2, 3, 4


@formula
def _was_found(turnings, found, turning):
    """Whether one of the first `found` of turnings [rad] has the whole turns of `turning`."""
    same = False
    for i in range(found):
        same = same or abs(turnings[i] - turning) < FOUND
    return same


@formula
def _slow_intervals(missing, bounds, step):
    """Intervals of `step` [s] in which the belts gain `missing` [m/s], and two to spare."""
    rate = min(bounds.belt_rate, bounds.rate)
    return 0 if missing <= 0.0 else int(min(missing / (rate * step), 1e6)) + 2


@formula
def _task(start, goal, turning, step, bounds, setting):
    """The plan from start (3,) to goal (3,) with a change of yaw; step: about an interval [s]."""
    rising = bounds.slowest - setting.before_p if setting.ramp else 0.0
    return Task(
        start[2], goal[0] - start[0], goal[1] - start[1], turning, setting.before_p,
        setting.before_q, setting.ramp, _slow_intervals(rising, bounds, step),
        _slow_intervals(bounds.slowest if bounds.stop else 0.0, bounds, step), setting.smoothing,
    )  # fmt: skip


@formula
def _keep_better(duration, cost, converged, w, belts, best):
    """The plan in w.belts into belts and `best`: the cheapest yet, or nothing has led to one."""
    if (converged and cost < best[COST]) or (not converged and best[COST] == math.inf):
        best[DURATION], best[CONVERGED] = duration, 1.0 if converged else 0.0
        best[COST] = cost if converged else math.inf
        copy_table(w.belts, belts)


@loop
def _solve_words(start, goal, totals, angles, on_arc, iterations, surface, bounds, given, setting,
                 w, a, turnings, belts, best):  # fmt: skip
    """Plans from the words of totals (6,) [s], shortest first; the best into belts and `best`.

    on_arc: radius [m], and belts p, q and ground speed [m/s] there. given: the bounds at constant
    speed, with which brief plans are made that are not found otherwise.
    """
    radius, arc = on_arc
    line = setting.speed, 0.0, setting.speed
    left, found = totals.copy(), 0
    enough = (LONGER if bounds.fixed else LONGER_FREE) * np.min(totals)
    enough += max(EXTRA, WIDE * radius) / setting.speed
    for _ in range(6):
        word = np.argmin(left)
        if left[word] == math.inf:
            break
        if found > 0 and (left[word] > enough or best[USED] >= ALTOGETHER):
            break
        left[word] = math.inf
        turning = np.sum(SIGNS[word] * angles[word])
        if _was_found(turnings, found, turning) or abs(turning - setting.turning) > math.pi:
            continue
        total, segments = totals[word], angles[word] * radius
        least = gathering(np.sum(segments), bounds, setting)
        first = guess(segments, SIGNS[word], arc, line, total, least, w.belts)
        task = _task(start, goal, turning, first / len(w.belts), bounds, setting)
        most = min(FURTHER, ALTOGETHER - int(best[USED])) if found > 0 else iterations
        limit = DEARER * best[COST]
        duration, cost, converged, used = solve(task, bounds, surface, first, w, a, most, limit)
        best[USED] += used
        if not converged and total < BRIEF and not setting.ramp and not bounds.fixed:
            guess(segments, SIGNS[word], line, line, total, least, w.belts)
            duration, cost, converged, used = solve(task, given, surface, first, w, a, most, limit)
            best[USED] += used
        if converged:
            turnings[found] = turning
            found += 1
        _keep_better(duration, cost, converged, w, belts, best)


@loop
def _solve_tight(start, goal, totals, angles, surface, bounds, setting, w, a, belts, best):
    """Plans from one arc, either way round, and words of the TIGHT radii, if the best is doubted.

    totals: durations (14,) [s], of which the last two are for those of arcs; angles (12, 3) [rad].
    """
    gauge = 2.0 * bounds.half_gauge
    line, signs = (setting.speed, 0.0, setting.speed), np.array([1.0, 0.0, 0.0])
    segments = np.zeros(3)
    totals[12] = one_arc(start, goal, False, bounds, setting)[2]
    totals[13] = one_arc(start, goal, True, bounds, setting)[2]
    allowed = best[USED] + TIGHTER_ALTOGETHER
    order = totals.copy()
    for word in (4, 5):  # three arcs of the first radius: slow starts, from which most are found
        order[word] = min(totals[word], np.min(totals))
    for _ in range(14):
        word = int(np.argmin(order))
        if DOUBTED * order[word] >= best[COST] or best[USED] >= allowed:
            break
        total, order[word] = totals[word], math.inf
        bend, brief, _one_by_one, arc = one_arc(start, goal, word == 13, bounds, setting)
        turning = bend if word >= 12 else np.sum(SIGNS[word % 6] * angles[word])
        if abs(turning - setting.turning) > math.pi:
            continue
        if word >= 12:
            total = brief
            segments[0], segments[1], segments[2] = total * arc[0], 0.0, 0.0
            signs[0], signs[1], signs[2] = 1.0, 0.0, 0.0
            on_arc = arc
        else:
            radius = TIGHT[word // 6] * gauge
            on_arc = tight_arc(radius, bounds, setting)
            for part in range(3):
                segments[part] = radius * angles[word, part]
                signs[part] = SIGNS[word % 6, part]
        least = gathering(np.sum(segments), bounds, setting)
        first = guess(segments, signs, on_arc, line, total, least, w.belts)
        task = _task(start, goal, turning, first / len(w.belts), bounds, setting)
        most = min(TIGHTER, int(allowed - best[USED]))
        limit = DEARER * best[COST]
        duration, cost, converged, used = solve(task, bounds, surface, first, w, a, most, limit)
        best[USED] += used
        _keep_better(duration, cost, converged, w, belts, best)


@formula
def _words_of(starts, goals, row, radius, arc, setting, angles, totals):
    """Angles (6, 3) [rad] and durations (6,) [s] of the words of a radius [m]; infinite: none."""
    x, y, phi = relative(starts, goals, row, radius)
    segments_of_words(x, y, phi, SNAP / max(1.0, radius), angles)
    for word in range(6):
        total = angles[word, 0] + angles[word, 1] + angles[word, 2]
        totals[word] = math.inf  # NaN: no such word
        if total > 0.0:
            totals[word] = duration_of(angles[word], SIGNS[word], radius, arc, setting)


@loop
def _solve_rows(starts, goals, surface, bounds, given, setting, first, last, belts, results):
    """Plans of rows first to last: belts (B, N, 2) and results (B, RESULTS)."""
    n = belts.shape[1]
    w, a = make_work(n), make_stages(n)
    angles, totals, turnings = np.empty((6, 3)), np.empty(6), np.empty(6)
    tight_angles, tight_totals = np.empty((12, 3)), np.empty(14)
    for row in range(first, last):
        away_x, away_y = goals[row, 0] - starts[row, 0], goals[row, 1] - starts[row, 1]
        on_arc = arc_of(math.hypot(away_x, away_y), surface, bounds, setting, w)
        _words_of(starts, goals, row, on_arc[0], on_arc[1], setting, angles, totals)
        best = results[row]
        best[COST], best[CONVERGED], best[USED] = math.inf, 0.0, 0.0
        for iterations in (ITERATIONS, PATIENT):
            _solve_words(
                starts[row], goals[row], totals, angles, on_arc, iterations, surface, bounds,
                given, setting, w, a, turnings, belts[row], best,
            )  # fmt: skip
            tight_totals[:] = math.inf
            for i in range(1 if bounds.fixed else 2):  # no tight turns where the speed is fixed
                radius, arc = TIGHT[i] * 2.0 * bounds.half_gauge, slice(6 * i, 6 * i + 6)
                _words_of(starts, goals, row, radius, tight_arc(radius, bounds, setting), setting,
                          tight_angles[arc], tight_totals[arc])  # fmt: skip
            _solve_tight(
                starts[row], goals[row], tight_totals, tight_angles, surface, bounds,
                setting, w, a, belts[row], best,
            )  # fmt: skip
            if best[COST] < math.inf:
                break


def optimal(
    start: Start | Sequence[Start] | ArrayLike, goal: ArrayLike,
    limits: Limits | Mapping[str, float] | None, vehicle: PlantParameters,
    slip_model: SlipModel | None = None, *, intervals: int = 40, smoothing: float = 1.0,
    stop: bool = False, period: float | None = None, threads: int = 1,
    turning: float | None = None,
) -> Trajectory | list[Trajectory]:  # fmt: skip
    """Plans of least time from a start to a goal (3,), or of N pairs: (N, 3), or N `Start`s.

    One start goes to all goals, one goal is that of all starts. limits: or a dict of their fields.

    slip_model: None plans as if the tracks did not slip. intervals: N. smoothing: w_s of F (51a),
    for any number of intervals. stop: rest one interval after the end. period [s]: samples are
    taken so often and at the ends of the intervals, which None are all. threads: for N goals.
    turning [rad]: change of yaw of the plan to within half a turn, for its whole turns.
    Returns a Trajectory, or a list of N; look at `converged` before one is driven, and at
    `message`, which is the reason where one of N goals cannot be planned.
    Raises ValueError for what is not finite, out of range or contradictory.
    """
    begins, goals, single = checked_starts(start, goal)
    allowed = checked_limits(limits, vehicle)
    count = checked_whole("intervals", intervals, INTERVALS)
    checked_number("smoothing", smoothing, SMOOTHING)
    if period is not None:
        checked_number("period", period, PERIOD)
    wanted = math.nan if turning is None else checked_number("turning", turning, ANGLE)
    workers = checked_whole("threads", threads, THREADS)
    if len({begin[3:] for begin in begins}) > 1:  # each motion at the start has bounds of its own
        plans: list[Trajectory] = []
        for begin, row in zip(begins, goals, strict=True):
            several = optimal(
                [begin], row[None], allowed, vehicle, slip_model, intervals=intervals,
                smoothing=smoothing, stop=stop, period=period, turning=turning,
            )  # fmt: skip
            assert isinstance(several, list)
            plans.extend(several)
        return plans
    begin = begins[0] if begins else Start()
    reasons = [_reason(row) for row in goals]
    targets = goals.copy()
    targets[[bool(why) for why in reasons]] = begin[:3]  # what is planned there is not returned
    bounds, setting = _prepared(begin, allowed, vehicle, stop, float(smoothing), wanted)
    given = bounds._replace(fixed=True, stop=False)
    surface = surface_of(slip_model, vehicle, allowed.sprocket_used, allowed.v_max)
    starts = np.array([each[:3] for each in begins], dtype=np.float64).reshape(-1, 3)
    belts, results = np.zeros((len(goals), count, 2)), np.zeros((len(goals), RESULTS))

    def block(first: int, last: int) -> None:
        _solve_rows(starts, targets, surface, bounds, given, setting, first, last, belts, results)

    workers = min(workers, len(goals))
    if workers <= 1:
        block(0, len(goals))
    else:
        edges = np.linspace(0, len(goals), SHARE * workers + 1).astype(int)
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(block, edges[:-1], edges[1:]))
    made = []
    for row, why in enumerate(reasons):
        try:
            if why:
                raise ValueError(why)
            parts = starts[row], goals[row], results[row], belts[row]
            made.append(_trajectory(*parts, surface, vehicle, period))
        except ValueError as error:
            if single:
                raise
            made.append(failed_plan(begins[row], goals[row], "optimal", str(error)))
    return made[0] if single else made


def _reason(goal: Array) -> str:
    """Why a goal (3,) cannot be planned; empty: it can."""
    try:
        checked_poses("goal", goal)
    except ValueError as error:
        return str(error)
    return ""


def _prepared(
    start: Start, limits: Limits, vehicle: PlantParameters, stop: bool, smoothing: float,
    turning: float,
) -> tuple[Bounds, Setting]:  # fmt: skip
    """Limits of the intervals, and what the plans of a batch have in common. Raises ValueError."""
    radius, half_gauge = vehicle.sprocket_radius, 0.5 * vehicle.track_gauge
    belt, fixed = radius * limits.sprocket_used, limits.fixed
    limited = math.isfinite(limits.sprocket_acceleration)
    if stop and (fixed or not limited):
        raise ValueError(
            "stop = True; must be False at constant speed, and without a finite limit of the "
            f"sprocket acceleration ({limits.sprocket_acceleration:g} rad/s^2): nothing to brake by"
        )
    bounds = Bounds(
        float(belt), float(limits.v_min), float(limits.v_max), float(limits.lateral_acceleration),
        float(limits.curvature), float(radius * limits.sprocket_acceleration),
        float(limits.acceleration), half_gauge, fixed, bool(stop),
    )  # fmt: skip
    speed = limits.v_max
    if not fixed:
        speed = min(limits.v_min + INSIDE * (limits.v_max - limits.v_min), INSIDE * belt)
    widest = max(RADIUS * vehicle.track_gauge, 1.0 / (INSIDE * limits.curvature_at(speed, vehicle)))
    left, right = start.sprockets(vehicle)
    return bounds, Setting(
        float(widest), float(speed), 0.5 * radius * (left + right), 0.5 * radius * (right - left),
        limited and not fixed, smoothing, turning,
    )  # fmt: skip


def _trajectory(
    start: Array, goal: Array, result: Array, belts: Array, surface: SlipSurface,
    vehicle: PlantParameters, period: float | None,
) -> Trajectory:  # fmt: skip
    """The trajectory of one plan."""
    turn = 2.0 * math.pi
    distance = math.hypot(goal[0] - start[0], goal[1] - start[1])
    if distance < SAME and abs(math.remainder(goal[2] - start[2], turn)) < SAME:
        out = np.zeros((1, COLUMN_COUNT))
        out[0, 1:5] = *start, start[2]
        return _of_samples(
            out, cost=0.0, converged=True, iterations=0, end_error=distance, end_yaw_error=0.0,
            message="start and goal are one pose",
        )  # fmt: skip
    duration = float(result[DURATION])
    times = duration * np.arange(len(belts) + 1) / len(belts)
    if period is not None and result[CONVERGED]:
        checked_sample_count(duration, period)
        between = np.arange(1, int(duration / period) + 1) * period
        near = np.abs(np.remainder(between / duration * len(belts) + 0.5, 1.0) - 0.5) > 1e-6
        times = np.sort(np.append(times, between[near & (between < duration)]))
    out = np.empty((len(times), COLUMN_COUNT))
    x, y, yaw = samples(start, duration, belts, surface, vehicle.sprocket_radius, times, out)
    error = math.hypot(x - goal[0], y - goal[1])
    converged, used = bool(result[CONVERGED]), int(result[USED])
    message = ""
    if not converged:
        message = (
            f"no plan in {used} iterations: the last one ends {error:.3g} m from the goal. Is the "
            "goal out of reach of the limits?"
        )
    return _of_samples(
        out, cost=float(result[COST]), converged=converged, iterations=used, end_error=error,
        end_yaw_error=abs(math.remainder(yaw - goal[2], turn)), message=message,
    )  # fmt: skip


def _of_samples(out: Array, **rest: Any) -> Trajectory:
    """The trajectory of samples (M, COLUMN_COUNT)."""
    columns: dict[str, Any] = dict(zip(Trajectory._fields, out.T.copy(), strict=False))
    return Trajectory(**columns, method="optimal", **rest)


Drive = Callable[
    [Start, Array, bool], Trajectory
]  # forwards to a goal (3,), whether it is the last

RADII = 1.0, 2.0  # [-] of the least radius: of the Reeds-Shepp paths that are tried
SHORTEST = 1e-6  # [m] of a leg


def turned_start(start: Start) -> Start:
    """The start as the vehicle sees it whose front is the back of this one."""
    left, right = start.sprocket_left, start.sprocket_right
    return Start(
        start.x, start.y, start.yaw + math.pi, -start.speed, start.yaw_rate,
        None if right is None else -right, None if left is None else -left,
    )  # fmt: skip


def turned(made: Trajectory) -> Trajectory:
    """The same motion of the vehicle whose front is the back of this one."""
    return made._replace(
        yaw=made.yaw - math.pi, course=made.course - math.pi,
        speed=-made.speed, acceleration=-made.acceleration,
        sprocket_left=-made.sprocket_right, sprocket_right=-made.sprocket_left,
    )  # fmt: skip


def in_reverse(drive: Drive, start: Start, goal: Array, last: bool) -> Trajectory:
    """The plan that drives backwards all the way."""
    return turned(drive(turned_start(start), goal + np.array([0.0, 0.0, math.pi]), last))


def cheapest(
    drive: Drive, start: Start, goal: Array, radius: float | None, last: bool
) -> Trajectory:
    """The plan of least cost among one gear and changes between both.

    drive: plans forwards. radius: at which the belts can turn [m]; None: the gear cannot change, as
    at constant speed the belts would jump. The first plan is returned where none converged.
    """
    found = [drive(start, goal, last), in_reverse(drive, start, goal, last)]
    for share in RADII if radius is not None else ():
        assert radius is not None
        legs = _legs(drive, start, goal, share * radius, last)
        if legs:
            found.append(joined(legs))
    plans = [made for made in found if made.converged]
    return min(plans, key=lambda made: made.cost) if plans else found[0]


def _legs(drive: Drive, start: Start, goal: Array, radius: float, last: bool) -> list[Trajectory]:
    """Plans from cusp to cusp of the Reeds-Shepp path; none where it has no cusp."""
    made = reeds_shepp(start[:3], goal, radius)
    path = Path.of(start[:3], made.segments[0], made.curvature[0])
    cusps = np.flatnonzero(np.diff(np.sign(path.length)))
    if not len(cusps):
        return []
    ends = np.cumsum(np.abs(path.length))
    at = places(path, ends[cusps])
    targets = [*np.stack([at.x, at.y, at.yaw], axis=1), goal]
    gears = np.sign(path.length)[[*cusps, -1]]
    legs, begin = [], start
    for target, gear in zip(targets, gears, strict=True):
        if math.hypot(target[0] - begin.x, target[1] - begin.y) < SHORTEST:
            continue
        final = last or target is not goal
        leg = (drive if gear > 0.0 else _backwards(drive))(begin, target, final)
        legs.append(leg)
        if not leg.converged:
            break
        begin = end_of(leg)
    return legs


def _backwards(drive: Drive) -> Drive:
    return lambda start, goal, last: in_reverse(drive, start, goal, last)
