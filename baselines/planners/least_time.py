"""Plans of least time for a vehicle whose tracks slip: F 6.3.

The interior point method starts from Dubins words of the start and the goal: left and right turns
are different minima, and the whole turns of a word are the yaw that its plan ends at. The plan of
least cost is taken, of these attempts:
    words    in the order of their durations, until one has led to a plan; then those with other
             whole turns and a duration below LONGER of the least plus EXTRA, of which wide words
             have more, as their arcs tell little of the plan. Each has at most LATER_ITERATIONS
             then, all together at most MAX_ITERATIONS, and an attempt is given up while it costs
             more than WORSE times the best plan
    tight    wide arcs hide plans to near goals, which are one bend, or have tighter turns. Where
             the best plan costs more than DOUBTFUL times the duration of a single arc, or of a word
             with arcs of TIGHT track gauges, these are tried too: words of three arcs first, as
             they are slow and most plans are found from them
    patient  where nothing led to a plan, all words again with more iterations

Samples. From one to the next sprocket speeds, ground speed, yaw rate and alpha = course - yaw hold.
Derivatives are slopes between the middles of the intervals. The end is integrated by Runge-Kutta
steps of the model (`lyapunov_laws`), which share nothing with the arcs but the surface.

Constant speed (v_min = v_max): the belts' mean is prescribed from the first moment to the last.
Otherwise, with a limit on sprocket acceleration, the first interval must be reached from the
sprocket speeds of the start, within one interval, and with `stop` rest from the last one; v_min
does not hold while the vehicle gathers speed there. The ground speed is at most v_max too.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 6.3, 7.2.
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.lyapunov.lyapunov_laws import BodyMotion, pose_step
from baselines.planners import planning_problem as problem
from baselines.planners import trajectory
from baselines.planners.curves import SIGNS, SNAP, relative, segments_of_words
from baselines.planners.interior_point import solve
from baselines.planners.slip_surface import COLUMNS, ROWS, SlipSurface, motion_jets, surface_of
from baselines.slip.slip_models import SlipModel
from tracked_env.physics.jit import copy_entries, copy_table, formula, loop
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.validation import checked_number, checked_whole

Array = NDArray[np.float64]

INTERVALS = Range(2, 2000, "-", "It is the number of intervals, not their duration.")
SMOOTHING = Range(1e-6, 1e6, "-", "It is the weight w_s.")
PERIOD = Range(1e-4, 10.0, "s", "It is the time between samples.")
THREADS = Range(1, 256, "-", "It is the number of threads.")
ITERATIONS, PATIENT_ITERATIONS = 100, 200  # from a word, until a plan is found; if none led to one
LATER_ITERATIONS, MAX_ITERATIONS = 30, 80  # from a word once a plan was found; from all words then
LONGER, LONGER_FREE = 1.1, 1.4  # [-] of the least duration: words tried further; at free speed
EXTRA, WIDE = 0.3, 2.0  # [m], [-] of the radius of the words: on top, at the speed of the words
DOUBTFUL, TIGHT = 1.35, (0.66, 0.165)  # [-] of the duration of a tight word; of the track gauge
TIGHT_ITERATIONS, MAX_TIGHT_ITERATIONS = 150, 400  # from a tight word; from all of them
WORSE = 1.2  # [-] of the least cost yet: a plan from a later word is given up above it
SHORT_WORD = 0.3  # [s] duration of a word below which it is tried at constant speed too
RADIUS = 0.4  # [-] of the track gauge: turning radius of the words
INSIDE = 0.9  # [-] of the way from v_min to v_max: speed along the words
SAME = 1e-9  # [m, rad] poses that differ by less are one
SAME_TURNING = 0.1  # [rad] yaws at the end that differ by less have the same whole turns
BLOCKS = 4  # of a batch per thread: plans take different times
LARGEST_TURN = 0.05  # [rad] of a Runge-Kutta step
# Columns of what a row of a batch gives.
DURATION, COST, CONVERGED, USED, RESULTS = 0, 1, 2, 3, 4


class Common(NamedTuple):
    """What the plans of a batch share."""

    surface: SlipSurface
    bounds: problem.Bounds
    constant: problem.Bounds  # the same at constant speed, for short words
    setting: problem.Setting


@formula
def _task(start, goal, turning, step, bounds, setting):
    """The plan from start (3,) to goal (3,) with a change of yaw; step: about an interval [s]."""
    rising = bounds.slowest - setting.before_p if setting.ramp else 0.0
    falling = bounds.slowest if bounds.stop else 0.0
    gain = min(bounds.belt_rate, bounds.rate) * step  # of the belts in an interval; two to spare
    rises = 0 if rising <= 0.0 else int(min(rising / gain, 1e6)) + 2
    falls = 0 if falling <= 0.0 else int(min(falling / gain, 1e6)) + 2
    pose = start[2], goal[0] - start[0], goal[1] - start[1], turning
    before = setting.before_p, setting.before_q, setting.ramp
    return problem.Task(*pose, *before, rises, falls, setting.smoothing)


@formula
def _attempt(pair, word, most, short, common, w, row):
    """A plan from a word, in at most `most` iterations; the best plan yet into row; whether it is.

    pair: start and goal (3,). short: whether a short word is tried at constant speed too. row:
    belts (N, 2) and results of the best.
    """
    (start, goal), (belts, best) = pair, row
    bounds, setting = common.bounds, common.setting
    line = setting.speed, 0.0, setting.speed
    least = problem.gathering(np.sum(word.segments), bounds, setting)
    first = problem.guess(word, word.arc, line, least, w.belts)
    task = _task(start, goal, word.turning, first / len(w.belts), bounds, setting)
    limit = WORSE * best[COST]
    duration, cost, converged, used = solve(task, bounds, common.surface, first, w, most, limit)
    best[USED] += used
    short = short and word.total < SHORT_WORD and not setting.ramp and not bounds.fixed
    if short and not converged:
        problem.guess(word, line, line, least, w.belts)
        duration, cost, converged, used = solve(
            task, common.constant, common.surface, first, w, most, limit
        )
        best[USED] += used
    if (converged and cost < best[COST]) or (not converged and best[COST] == math.inf):
        best[DURATION], best[CONVERGED] = duration, 1.0 if converged else 0.0
        best[COST] = cost if converged else math.inf
        copy_table(w.belts, belts)
    return converged


@loop
def _solve_words(pair, totals, angles, on_arc, iterations, common, w, row):
    """Plans from the words of totals (6,) [s], shortest first; the best into row.

    on_arc: radius [m], and belts p, q and ground speed [m/s] there.
    """
    bounds, setting, best = common.bounds, common.setting, row[1]
    radius, arc = on_arc
    left, plans, turnings = totals.copy(), 0, np.empty(6)
    enough = (LONGER if bounds.fixed else LONGER_FREE) * np.min(totals)
    enough += max(EXTRA, WIDE * radius) / setting.speed
    for _ in range(6):
        word = np.argmin(left)
        if left[word] == math.inf:
            break
        if plans > 0 and (left[word] > enough or best[USED] >= MAX_ITERATIONS):
            break
        left[word] = math.inf
        turning = np.sum(SIGNS[word] * angles[word])
        tried = abs(turning - setting.turning) > math.pi
        for i in range(plans):
            tried = tried or abs(turnings[i] - turning) < SAME_TURNING
        if tried:
            continue
        first = problem.Word(angles[word] * radius, SIGNS[word], turning, totals[word], arc)
        later = min(LATER_ITERATIONS, MAX_ITERATIONS - int(best[USED]))
        if _attempt(pair, first, later if plans > 0 else iterations, True, common, w, row):
            turnings[plans] = turning
            plans += 1


@loop
def _solve_tight(pair, totals, angles, common, w, row):
    """Plans from one arc, either way round, and words of the TIGHT radii, if the best is doubtful.

    totals: durations (14,) [s], of which the last two are for those of arcs; angles (12, 3) [rad].
    """
    (start, goal), best, bounds, setting = pair, row[1], common.bounds, common.setting
    gauge = 2.0 * bounds.half_gauge
    totals[12] = problem.one_arc(start, goal, False, bounds, setting)[2]
    totals[13] = problem.one_arc(start, goal, True, bounds, setting)[2]
    allowed = best[USED] + MAX_TIGHT_ITERATIONS
    order = totals.copy()
    for word in (4, 5):  # three arcs of the first radius: slow starts, from which most are found
        order[word] = min(totals[word], np.min(totals))
    for _ in range(14):
        word = int(np.argmin(order))
        if DOUBTFUL * order[word] >= best[COST] or best[USED] >= allowed:
            break
        total, order[word] = totals[word], math.inf
        turning, duration, _, arc = problem.one_arc(start, goal, word == 13, bounds, setting)
        segments, signs = np.zeros(3), np.array([1.0, 0.0, 0.0])
        if word >= 12:
            total = duration
            segments[0] = total * arc[0]
        else:
            turning = np.sum(SIGNS[word % 6] * angles[word])
            radius = TIGHT[word // 6] * gauge
            arc = problem.tight_arc(radius, bounds, setting)
            segments[:], signs[:] = radius * angles[word], SIGNS[word % 6]
        if abs(turning - setting.turning) > math.pi:
            continue
        most = min(TIGHT_ITERATIONS, int(allowed - best[USED]))
        first = problem.Word(segments, signs, turning, total, arc)
        _attempt(pair, first, most, False, common, w, row)


@formula
def _words_of(pair, radius, arc, setting, angles, totals):
    """Angles (6, 3) [rad] and durations (6,) [s] of the words of a radius [m]; infinite: none."""
    x, y, phi = relative(pair[0], pair[1], radius)
    segments_of_words(x, y, phi, SNAP / max(1.0, radius), angles)
    for word in range(6):
        totals[word] = problem.duration_of(angles[word], SIGNS[word], radius, arc, setting)
        if not totals[word] > 0.0:  # NaN: no such word
            totals[word] = math.inf


@loop
def _solve_rows(starts, goals, common, first, last, belts, results):
    """Plans of the rows first to last of a batch: belts (M, N, 2), results (M, RESULTS)."""
    bounds, setting = common.bounds, common.setting
    w = problem.make_work(belts.shape[1])
    angles, totals = np.empty((6, 3)), np.empty(6)
    tight_angles, tight_totals = np.empty((12, 3)), np.empty(14)
    for row in range(first, last):
        away_x, away_y = goals[row, 0] - starts[row, 0], goals[row, 1] - starts[row, 1]
        on_arc = problem.arc_of(math.hypot(away_x, away_y), common.surface, bounds, setting, w)
        pair, out = (starts[row], goals[row]), (belts[row], results[row])
        _words_of(pair, *on_arc, setting, angles, totals)
        best = results[row]
        best[COST], best[CONVERGED], best[USED] = math.inf, 0.0, 0.0
        for iterations in (ITERATIONS, PATIENT_ITERATIONS):
            _solve_words(pair, totals, angles, on_arc, iterations, common, w, out)
            tight_totals[:] = math.inf
            for i in range(1 if bounds.fixed else 2):  # no tight turns where the speed is fixed
                radius, part = TIGHT[i] * 2.0 * bounds.half_gauge, slice(6 * i, 6 * i + 6)
                arc = problem.tight_arc(radius, bounds, setting)
                _words_of(pair, radius, arc, setting, tight_angles[part], tight_totals[part])
            _solve_tight(pair, tight_totals, tight_angles, common, w, out)
            if best[COST] < math.inf:
                break


@formula
def _slope(values, k, later, step):
    """Slope of values (N,), N >= 2, between the middles of intervals, before or after that of k."""
    first = min(max(k if later else k - 1, 0), len(values) - 2)
    return (values[first + 1] - values[first]) / step


@formula
def _moved(knot, alpha, speed, turn, since):
    """Place (complex) of the centre [s] after a knot (x, y, yaw), at held speeds."""
    sigma, _first, _second, _end = problem.chord(turn * since)
    course = knot[2] + alpha
    return sigma * complex(math.cos(course), math.sin(course)) * (speed * since)


@loop
def samples(pose, duration, belts, surface, times, out):
    """Samples (M, SAMPLED) of belts (N, 2) from pose (3,) at times (M,), into out.

    Returns the pose at the end by Runge-Kutta steps of the model.
    """
    n, radius = len(belts), surface.radius
    step = duration / n
    rows, columns = np.empty((3, ROWS)), np.empty((3, 2 * COLUMNS))
    alpha, speed, turn = np.empty(n), np.empty(n), np.empty(n)
    knots = np.empty((n + 1, 3))
    copy_entries(pose, knots[0])
    x, y, yaw = pose[0], pose[1], pose[2]
    for k in range(n):
        v_x, v_y, w = motion_jets(surface, belts[k, 0], belts[k, 1], rows, columns)
        turn[k] = w.value
        alpha[k] = math.atan(v_y.value / v_x.value) if v_x.value != 0.0 else 0.0
        speed[k] = math.copysign(math.hypot(v_x.value, v_y.value), v_x.value)
        parts = int(abs(w.value) * step / LARGEST_TURN) + 1
        motion = BodyMotion(v_x.value, w.value)
        for _ in range(parts):
            x, y, yaw = pose_step(x, y, yaw, motion, alpha[k], step / parts)
        move = _moved(knots[k], alpha[k], speed[k], turn[k], step)
        knots[k + 1, 0] = knots[k, 0] + move.real
        knots[k + 1, 1] = knots[k, 1] + move.imag
        knots[k + 1, 2] = knots[k, 2] + turn[k] * step
    for m in range(len(times)):
        k = min(int(times[m] / step * (1.0 + 1e-12)), n - 1)
        since = times[m] - k * step
        later = since > 0.5 * step
        move = _moved(knots[k], alpha[k], speed[k], turn[k], since)
        now, o = knots[k, 2] + turn[k] * since, out[m]
        o[0], o[1], o[2], o[3] = times[m], knots[k, 0] + move.real, knots[k, 1] + move.imag, now
        o[4], o[5], o[6] = now + alpha[k], speed[k], _slope(speed, k, later, step)
        o[7] = turn[k] + _slope(alpha, k, later, step)
        bend = 0.0
        if 0 < k < n - 1:
            bend = (alpha[k + 1] - 2.0 * alpha[k] + alpha[k - 1]) / (step * step)
        o[8] = _slope(turn, k, later, step) + bend
        o[9], o[10] = turn[k], _slope(turn, k, later, step)
        o[11] = (belts[k, 0] - belts[k, 1]) / radius
        o[12] = (belts[k, 0] + belts[k, 1]) / radius
    return x, y, yaw


def optimal(
    start: trajectory.Start | Sequence[trajectory.Start] | ArrayLike,
    goal: ArrayLike,
    limits: trajectory.Limits | Mapping[str, float] | None,
    vehicle: PlantParameters,
    slip_model: SlipModel | None = None,
    *,
    intervals: int = 40,
    smoothing: float = 1.0,
    stop: bool = False,
    period: float | None = None,
    threads: int = 1,
    turning: float | None = None,
) -> trajectory.Trajectory | list[trajectory.Trajectory]:
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
    begins, goals, single = trajectory.checked_starts(start, goal)
    limits = trajectory.checked_limits(limits, vehicle)
    count = checked_whole("intervals", intervals, INTERVALS)
    checked_number("smoothing", smoothing, SMOOTHING)
    if period is not None:
        checked_number("period", period, PERIOD)
    turned = math.nan if turning is None else checked_number("turning", turning, trajectory.ANGLE)
    workers = checked_whole("threads", threads, THREADS)
    if len({begin[3:] for begin in begins}) > 1:  # each motion at the start has bounds of its own
        options: Any = {"intervals": intervals, "smoothing": smoothing, "stop": stop}
        options |= {"period": period, "turning": turning}
        world = limits, vehicle, slip_model
        pairs = zip(begins, goals, strict=True)
        each: Any = (optimal([one], row[None], *world, **options) for one, row in pairs)
        return [plan for plans in each for plan in plans]
    begin = begins[0] if begins else trajectory.Start()
    most = [allowed.high for allowed in trajectory.POSE.values()]
    possible = np.all(np.abs(goals) <= most, axis=1, keepdims=True)  # NaN is not
    targets = np.where(possible, goals, begin[:3])  # what is planned to the others is not returned
    bounds, setting = _prepared(begin, limits, vehicle, stop, float(smoothing), turned)
    surface = surface_of(slip_model, vehicle, limits.sprocket_used, limits.v_max)
    common = Common(surface, bounds, bounds._replace(fixed=True, stop=False), setting)
    starts = np.array([one[:3] for one in begins], dtype=np.float64).reshape(-1, 3)
    belts, results = np.zeros((len(goals), count, 2)), np.zeros((len(goals), RESULTS))

    def block(first: int, last: int) -> None:
        _solve_rows(starts, targets, common, first, last, belts, results)

    workers = min(workers, len(goals))
    if workers <= 1:
        block(0, len(goals))
    else:
        edges = np.linspace(0, len(goals), BLOCKS * workers + 1).astype(int)
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(block, edges[:-1], edges[1:]))
    plans = []
    for row, pose in enumerate(starts):
        try:
            trajectory.checked_table("goal", goals[row])
            pair = np.array([pose, goals[row]])
            plans.append(_trajectory(pair, results[row], belts[row], surface, period))
        except ValueError as error:
            if single:
                raise
            plans.append(trajectory.failed_plan(begins[row], goals[row], "optimal", str(error)))
    return plans[0] if single else plans


def _prepared(
    start: trajectory.Start,
    limits: trajectory.Limits,
    vehicle: PlantParameters,
    stop: bool,
    smoothing: float,
    turning: float,
) -> tuple[problem.Bounds, problem.Setting]:
    """Limits of the intervals, and what the plans of a batch have in common. Raises ValueError."""
    radius, half_gauge = vehicle.sprocket_radius, 0.5 * vehicle.track_gauge
    belt, fixed = radius * limits.sprocket_used, limits.fixed
    limited = math.isfinite(limits.sprocket_acceleration)
    if stop and (fixed or not limited):
        raise ValueError(
            "stop = True; must be False at constant speed, and without a finite limit of the "
            f"sprocket acceleration ({limits.sprocket_acceleration:g} rad/s^2): nothing to brake by"
        )
    rates = radius * limits.sprocket_acceleration, limits.acceleration
    values = belt, limits.v_min, limits.v_max, limits.lateral_acceleration, limits.curvature, *rates
    bounds = problem.Bounds._make((*map(float, values), half_gauge, fixed, bool(stop)))
    speed = limits.v_max
    if not fixed:
        speed = min(limits.v_min + INSIDE * (limits.v_max - limits.v_min), INSIDE * belt)
    widest = max(RADIUS * vehicle.track_gauge, 1.0 / (INSIDE * limits.curvature_at(speed, vehicle)))
    left, right = start.sprockets(vehicle)
    before = 0.5 * radius * (left + right), 0.5 * radius * (right - left)
    return bounds, problem.Setting(
        float(widest), float(speed), *before, limited and not fixed, smoothing, turning
    )


def _trajectory(
    pair: Array, result: Array, belts: Array, surface: SlipSurface, period: float | None
) -> trajectory.Trajectory:
    """The trajectory of one plan from start to goal (2, 3)."""
    start, goal = pair
    duration, converged, used = float(result[DURATION]), bool(result[CONVERGED]), int(result[USED])
    message, error = "", math.hypot(goal[0] - start[0], goal[1] - start[1])
    if error < SAME and abs(math.remainder(goal[2] - start[2], 2.0 * math.pi)) < SAME:
        out = np.zeros((1, trajectory.SAMPLED))
        out[0, 1:5] = *start, start[2]
        outcome: Any = 0.0, True, 0, error, 0.0
        message = "start and goal are one pose"
    else:
        times = duration * np.arange(len(belts) + 1) / len(belts)
        if period is not None and converged:
            trajectory.checked_sample_count(duration, period)
            between = np.arange(1, int(duration / period) + 1) * period
            near = np.abs(np.remainder(between / duration * len(belts) + 0.5, 1.0) - 0.5) > 1e-6
            times = np.sort(np.append(times, between[near & (between < duration)]))
        out = np.empty((len(times), trajectory.SAMPLED))
        x, y, yaw = samples(start, duration, belts, surface, times, out)
        error = math.hypot(x - goal[0], y - goal[1])
        off = abs(math.remainder(yaw - goal[2], 2.0 * math.pi))
        outcome = float(result[COST]), converged, used, error, off
        if not converged:
            message = f"no plan in {used} iterations, {error:.3g} m from the goal. Is it in reach?"
    return trajectory.Trajectory._make((*out.T.copy(), *outcome, "optimal", message))
