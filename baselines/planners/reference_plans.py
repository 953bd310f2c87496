"""Plans as references of the environments: rows of `physics.reference_knots` from planners.

A reference is exact where a plan is made of pieces:
    optimal   belts are held over intervals. Course frame: V is held, the course turns steadily
              between the middles of the intervals, see `hand_over`. Body frame: belts, v_x, v_y
              and w are held, the pose is exact
    paths     curvature is linear in the way and the speed in time, so V is linear and chi' = k V a
              cubic in time, from one change of either to the next
With slip, the body of a path has v_b, w_b and alpha fitted by polynomials through NODES points, on
rows of LONGEST at most. Every row begins at its own pose. The last row stands at the goal, in both
frames with the yaw of the vehicle there. Where a plan starts from rest, a row before the first
says so.

These are the entry points of the group `tracked_env.planners`.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from baselines.planners.curves import Path, end_errors, places
from baselines.planners.optimal import optimal
from baselines.planners.plan import timed_path
from baselines.planners.speed_along_path import SpeedProfile, sprockets
from baselines.planners.trajectory import (
    Limits,
    Start,
    Trajectory,
    checked_limits,
    hand_over,
    held_intervals,
)
from baselines.slip.slip_sweep import identified_slip
from tracked_env.physics.elementary import wrap_angle
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.reference_profile import (
    BODY_COLUMNS,
    COURSE_COLUMNS,
    FORWARD,
    POSE,
    SIDEWAYS,
    START,
    TURN,
    PlannedRows,
)

Array = NDArray[np.float64]

LONGEST = 0.5  # [s] of a row whose polynomials are fitted
SAME = 1e-9  # [m/s^2] accelerations that differ by less are one
REACHED = 1e-3  # [m] and [rad] from the goal within which a path ends
NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(6) / 5.0)  # [-] of a row, its ends included
_FIT = np.linalg.inv(np.vander(NODES, increasing=True))  # (6, 6): values at NODES


def optimal_plan(
    vehicle: PlantParameters, limits: Mapping[str, float], slip: bool, frame: str,
    goal: tuple[float, float, float],
) -> PlannedRows:  # fmt: skip
    """The optimal plan from rest to rest, or at constant speed; `references.specification` says more."""
    allowed, model = Limits.of(vehicle, **limits), identified_slip(vehicle) if slip else None
    plan = optimal(
        Start(), np.array(goal), allowed, vehicle, model, stop=not allowed.fixed
    )  # at all ends of intervals
    assert isinstance(plan, Trajectory)
    if len(plan.time) == 1:
        return PlannedRows(_ended(np.zeros((0, _width(frame))), 0.0, goal, 0.0), True, plan.message)
    times = plan.time[:-1]
    if frame == "course":
        times = np.sort(np.append(times, held_intervals(plan).middle))
    shown = hand_over(plan, times, vehicle, frame)
    rows = np.zeros((len(times), _width(frame)))
    rows[:, 0], rows[:, 6], rows[:, START] = shown.speed, shown.yaw_rate, times
    rows[:, POSE : POSE + 3] = np.column_stack([shown.x, shown.y, shown.yaw])
    if frame == "body":
        alpha = (plan.course - plan.yaw)[:-1]
        rows[:, FORWARD] = plan.speed[:-1] * np.cos(alpha)
        rows[:, SIDEWAYS] = plan.speed[:-1] * np.sin(alpha)
        rows[:, TURN] = plan.yaw_rate[:-1]
    rows = _ended(rows, plan.duration, goal, float(plan.yaw[-1]))
    if not allowed.fixed:
        rows = np.vstack([_standing(rows[0]), rows])
    return PlannedRows(rows, plan.converged, plan.message)


def _path_plan(
    method: str, vehicle: PlantParameters, limits: Mapping[str, float], slip: bool, frame: str,
    goal: tuple[float, float, float],
) -> PlannedRows:  # fmt: skip
    """A plan along the path of a planner."""
    allowed = checked_limits(Limits.of(vehicle, **limits), vehicle)
    made = timed_path(Start(), np.array(goal), allowed, vehicle, method)
    path, speed, message = made.path, made.speed, made.message
    if not len(path.length):
        return PlannedRows(_ended(np.zeros((0, _width(frame))), 0.0, goal, 0.0), True, message)
    rows = _along(path, speed, LONGEST if frame == "body" and slip else np.inf)
    ends = np.append(rows[1:, START], speed.time[-1])
    nodes = rows[:, START, None] + NODES * (ends - rows[:, START])[:, None]
    v, w = (_values(rows[:, first : first + 6], nodes - rows[:, START, None]) for first in (0, 6))
    model = identified_slip(vehicle) if slip else None
    left, right, alpha = (
        each.reshape(v.shape) for each in sprockets(v.ravel(), w.ravel(), vehicle, model)
    )
    fastest = float(max(np.abs(left).max(), np.abs(right).max()))
    feasible = fastest <= allowed.sprocket_used * (1.0 + 1e-9)
    if not feasible:
        message = (
            f"with slip the sprockets reach {fastest:.3g} rad/s of {allowed.sprocket_used:.3g}; "
            "lower v_max or curvature, or let slip be false"
        )
    if frame == "body":
        rows = _as_body(rows, ends, (v, left, right, alpha), vehicle)
    rows = _ended(rows, float(speed.time[-1]), goal, float(_end_course(path) - alpha[-1, -1]))
    missed = max(end_errors(path, goal))
    if missed > REACHED:
        message = f"the path ends {missed:.3g} m or rad from the goal"
    return PlannedRows(rows, feasible and speed.reached and missed <= REACHED, message)


def _end_course(path: Path) -> float:
    """Course at the end of a path [rad]."""
    return float(places(path, [path.whole_length]).yaw[0])


def _width(frame: str) -> int:
    return COURSE_COLUMNS if frame == "course" else BODY_COLUMNS


def _values(coefficients: Array, tau: Array) -> Array:
    """Polynomials (K, 6) at tau (K, M) [s]."""
    return np.einsum("kn,kmn->km", coefficients, tau[:, :, None] ** np.arange(6))


def _along(path: Path, speed: SpeedProfile, longest: float) -> Array:
    """Rows of a path in the course frame: one from each change of its pieces or of V'."""
    u, changed = speed.acceleration, np.abs(np.diff(speed.acceleration)) > SAME
    begins = np.append(0, np.flatnonzero(changed) + 1)  # grid points at which V' changes
    inner = np.cumsum(np.abs(path.length))[:-1]  # [m] at which pieces change
    part = np.clip(np.searchsorted(speed.distance, inner, "right") - 1, 0, len(u) - 1)
    gone = inner - speed.distance[part]
    reach = np.sqrt(np.maximum(speed.speed[part] ** 2 + 2.0 * u[part] * gone, 0.0))
    pace = reach + speed.speed[part]
    since = np.where(pace > 0.0, 2.0 * gone / np.where(pace > 0.0, pace, 1.0), 0.0)
    times = np.append(speed.time[begins], speed.time[part] + since)
    order = np.argsort(times, kind="stable")
    ways, times = np.append(speed.distance[begins], inner)[order], times[order]
    kept = np.append(np.diff(times) > 1e-9, speed.time[-1] - times[-1] > 1e-9)
    kept[0] = True
    ways, times = ways[kept], times[kept]
    if np.isfinite(longest):
        counts = np.ceil(np.diff(np.append(times, speed.time[-1])) / longest - 1e-9).astype(int)
        spans = zip(times, np.append(times[1:], speed.time[-1]), counts, strict=True)
        times = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in spans])
    cell = np.clip(np.searchsorted(speed.time, times + 1e-12, "right") - 1, 0, len(u) - 1)
    tau = times - speed.time[cell]
    pace = np.maximum(speed.speed[cell] + u[cell] * tau, 0.0)
    ways = speed.distance[cell] + (speed.speed[cell] + 0.5 * u[cell] * tau) * tau
    at = places(path, np.maximum(ways, 0.0) + 1e-12)  # a place at a change is in the piece after it
    rows = np.zeros((len(times), COURSE_COLUMNS))
    v, a = at.gear * pace, at.gear * u[cell]
    rows[:, 0], rows[:, 1], rows[:, START] = v, a, times
    k, sharp = at.curvature, at.sharpness
    # k(s) V with the signed way s = v tau + a tau^2 / 2 since the row began:
    rows[:, 6], rows[:, 7] = k * v, k * a + sharp * v * v
    rows[:, 8], rows[:, 9] = 1.5 * sharp * v * a, 0.5 * sharp * a * a
    rows[:, POSE : POSE + 3] = np.column_stack([at.x, at.y, at.yaw])
    return rows


def _as_body(
    rows: Array, ends: Array, at_nodes: tuple[Array, Array, Array, Array], vehicle: PlantParameters
) -> Array:
    """Rows in the body frame, from V, sprocket speeds (left, right) and alpha at the nodes."""
    v, left, right, alpha = at_nodes
    lasting = np.maximum(ends - rows[:, START], 1e-12)[:, None]

    def fitted(values: Array) -> Array:
        made: Array = values @ _FIT.T / lasting ** np.arange(6)
        return made

    wide = np.zeros((len(rows), BODY_COLUMNS))
    wide[:, :COURSE_COLUMNS] = rows
    bend = fitted(alpha)
    wide[:, :6] = fitted(0.5 * vehicle.sprocket_radius * (left + right))
    wide[:, 6:12] = fitted(vehicle.sprocket_radius * (right - left) / vehicle.track_gauge)
    wide[:, FORWARD:SIDEWAYS] = fitted(v * np.cos(alpha))
    wide[:, SIDEWAYS:TURN] = fitted(v * np.sin(alpha))
    wide[:, TURN:] = rows[:, 6:12]
    wide[:, TURN : TURN + 5] -= bend[:, 1:] * np.arange(1, 6)
    wide[:, POSE + 2] -= alpha[:, 0]
    return wide


def _standing(row: Array) -> Array:
    """A row at the pose of another one, at rest."""
    still = np.zeros_like(row)
    still[START : POSE + 3] = row[START : POSE + 3]
    return still


def _ended(rows: Array, time: float, goal: tuple[float, float, float], yaw: float) -> Array:
    """Rows, and a stand at the goal from `time` [s] on; yaw: of the vehicle when it arrives."""
    last = np.zeros((1, rows.shape[1]))
    last[0, START], last[0, POSE : POSE + 2] = time, goal[:2]
    last[0, POSE + 2] = yaw + wrap_angle(goal[2] - yaw)
    return np.vstack([rows, last])


dubins_plan = partial(_path_plan, "dubins")
reeds_shepp_plan = partial(_path_plan, "reeds-shepp")
clothoid_plan = partial(_path_plan, "clothoid")
