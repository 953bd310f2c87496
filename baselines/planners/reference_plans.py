"""Plans for others: as references of the environments, and as a command line asks for them.

References are rows of `physics.reference_profile`, exact where a plan is made of pieces:
    optimal   belts are held over intervals. Course frame: V is held, the course turns steadily
              between the middles of the intervals, see `Trajectory.at`. Body frame: belts, v_x, v_y
              and w are held, the pose is exact
    paths     curvature is linear in the way and the speed in time, so V is linear and chi' = k V a
              cubic in time, from one change of either to the next
With slip, the body of a path has v_b, w_b and alpha fitted by polynomials through NODES points, on
rows of LONGEST at most. Every row begins at its own pose. The last row stands at the goal, with the
yaw of the vehicle. Where a plan starts from rest, a row before the first says so. These are entry
points of the group `tracked_env.planners`; `planned` is the command `plan`.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.planners.least_time import optimal
from baselines.planners.legs import timed_path
from baselines.planners.motion_planning import plan
from baselines.planners.obstacles import Obstacles
from baselines.planners.speed_along_path import Path, SpeedProfile, end_errors, places, sprockets
from baselines.planners.trajectory import Limits, Start, Trajectory, checked_limits, held_intervals
from baselines.slip.slip_sweep import identified_slip, identified_slope_slip, with_friction
from tracked_env.physics import reference_profile as knots
from tracked_env.physics.elementary import wrap_angle
from tracked_env.physics.parameters import PlantParameters
from tracked_env.vehicles import Spec, find_vehicle

Array = NDArray[np.float64]
Pose = tuple[float, float, float]  # x, y [m], yaw [rad]

LONGEST = 0.5  # [s] of a row whose polynomials are fitted
SAME = 1e-9  # [m/s^2] accelerations that differ by less are one
REACHED = 1e-3  # [m] and [rad] from the goal within which a path ends
NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(6) / 5.0)  # [-] of a row, its ends included
_FIT = np.linalg.inv(np.vander(NODES, increasing=True))  # (6, 6): values at NODES


class Planned(NamedTuple):
    """A trajectory with what is drawn beside it."""

    trajectory: Trajectory
    slip: tuple[Array, Array, Array]  # beta left, right [m/s], alpha [rad], (M,) each
    limits: Limits
    vehicle: PlantParameters


def planned(
    goal: Sequence[float],
    start: Sequence[float] = (0.0, 0.0, 0.0),
    method: str = "optimal",
    vehicle: Spec = "focchi",
    friction: float | None = None,
    slips: bool = True,
    limits: Mapping[str, float] | None = None,
    *,
    slope: Sequence[float] | None = None,
    circles: Sequence[Sequence[float]] = (),
    **options: Any,
) -> Planned:
    """Plan from a start to a goal, x, y [m], yaw [rad].

    vehicle: name, file or values. friction: mu [-] of the soil, by default the vehicle's. slips:
    whether the plan knows the slip, identified on the distributed plant. limits: fields of
    `Limits`. slope: of the ground in x and y [-]; None: level. circles: obstacles, x, y, radius
    [m]. options: others of `plan`: via, reverse, margin, room, time_limit. Raises ValueError.
    """
    body = find_vehicle(vehicle)
    if friction is not None:
        body = with_friction(body, friction)
    allowed = Limits.of(body, **dict(limits or {}))
    if slope is not None and not slips:
        raise ValueError("slope without slip; a plan on a slope must know slip. Drop one of them")
    identified = identified_slip if slope is None else identified_slope_slip
    slip_model = identified(body) if slips else None
    options["obstacles"] = Obstacles.of(circles=circles) if len(circles) else None
    trajectory: Any = plan(
        tuple(start), goal, allowed, slip_model, method, body, ground=slope, **options
    )
    return Planned(trajectory, trajectory.slip(body), allowed, body)


def optimal_plan(
    vehicle: PlantParameters, limits: Mapping[str, float], slip: bool, frame: str, goal: Pose
) -> knots.PlannedRows:
    """The optimal plan from rest to rest, or at constant speed, see `references.plans`."""
    allowed, model = Limits.of(vehicle, **limits), identified_slip(vehicle) if slip else None
    plan: Any = optimal(Start(), np.array(goal), allowed, vehicle, model, stop=not allowed.fixed)
    if len(plan.time) == 1:
        return knots.PlannedRows(_ended(_rows(0, frame), 0.0, goal, 0.0), True, plan.message)
    times = plan.time[:-1]
    if frame == "course":
        times = np.sort(np.append(times, held_intervals(plan).middle))
    motion = plan.at(times, frame, vehicle)
    rows = _rows(len(times), frame)
    rows[:, 0], rows[:, 6], rows[:, knots.START] = motion.speed, motion.yaw_rate, times
    rows[:, knots.POSE : knots.POSE + 3] = np.column_stack([motion.x, motion.y, motion.yaw])
    if frame == "body":
        alpha = (plan.course - plan.yaw)[:-1]
        rows[:, knots.FORWARD] = plan.speed[:-1] * np.cos(alpha)
        rows[:, knots.SIDEWAYS] = plan.speed[:-1] * np.sin(alpha)
        rows[:, knots.TURN] = plan.yaw_rate[:-1]
    rows = _ended(rows, plan.duration, goal, float(plan.yaw[-1]))
    if not allowed.fixed:
        standing = np.zeros_like(rows[:1])
        standing[0, knots.START : knots.POSE + 3] = rows[0, knots.START : knots.POSE + 3]
        rows = np.vstack([standing, rows])
    return knots.PlannedRows(rows, plan.converged, plan.message)


def _path_plan(
    method: str,
    vehicle: PlantParameters,
    limits: Mapping[str, float],
    slip: bool,
    frame: str,
    goal: Pose,
) -> knots.PlannedRows:
    """A plan along the path of a planner."""
    allowed = checked_limits(Limits.of(vehicle, **limits), vehicle)
    path, speed, _, message = timed_path(Start(), np.array(goal), allowed, vehicle, method)
    if not len(path.length):
        return knots.PlannedRows(_ended(_rows(0, frame), 0.0, goal, 0.0), True, message)
    rows = _along(path, speed, LONGEST if frame == "body" and slip else np.inf)
    begins = rows[:, knots.START, None]
    ends = np.append(rows[1:, knots.START], speed.time[-1])[:, None]
    powers = ((begins + NODES * (ends - begins)) - begins)[:, :, None] ** np.arange(6)
    v, w = (np.einsum("kn,kmn->km", rows[:, n : n + 6], powers) for n in (0, 6))
    model = identified_slip(vehicle) if slip else None
    belts = sprockets(v.ravel(), w.ravel(), vehicle, model)
    left, right, alpha = (each.reshape(v.shape) for each in belts)
    fastest = float(max(np.abs(left).max(), np.abs(right).max()))
    feasible = fastest <= allowed.sprocket_used * (1.0 + 1e-9)
    if not feasible:
        message = (
            f"with slip the sprockets reach {fastest:.3g} rad/s of {allowed.sprocket_used:.3g}; "
            "lower v_max or curvature, or let slip be false"
        )
    if frame == "body":
        rows = _as_body(rows, ends - begins, (v, left, right, alpha), vehicle)
    course = float(places(path, [path.whole_length]).yaw[0])  # at the end
    rows = _ended(rows, float(speed.time[-1]), goal, float(course - alpha[-1, -1]))
    missed = max(end_errors(path, goal))
    if missed > REACHED:
        message = f"the path ends {missed:.3g} m or rad from the goal"
    return knots.PlannedRows(rows, feasible and speed.reached and missed <= REACHED, message)


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
    lasting = np.append(np.diff(times) > 1e-9, speed.time[-1] - times[-1] > 1e-9)
    lasting[0] = True
    ways, times = ways[lasting], times[lasting]
    if np.isfinite(longest):
        counts = np.ceil(np.diff(np.append(times, speed.time[-1])) / longest - 1e-9).astype(int)
        spans = zip(times, np.append(times[1:], speed.time[-1]), counts, strict=True)
        times = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in spans])
    cell = np.clip(np.searchsorted(speed.time, times + 1e-12, "right") - 1, 0, len(u) - 1)
    tau = times - speed.time[cell]
    pace = np.maximum(speed.speed[cell] + u[cell] * tau, 0.0)
    ways = speed.distance[cell] + (speed.speed[cell] + 0.5 * u[cell] * tau) * tau
    at = places(path, np.maximum(ways, 0.0) + 1e-12)  # a place at a change is in the piece after it
    rows = _rows(len(times), "course")
    v, a = at.gear * pace, at.gear * u[cell]
    rows[:, 0], rows[:, 1], rows[:, knots.START] = v, a, times
    k, sharp = at.curvature, at.sharpness
    # k(s) V with the signed way s = v tau + a tau^2 / 2 since the row began:
    rows[:, 6], rows[:, 7] = k * v, k * a + sharp * v * v
    rows[:, 8], rows[:, 9] = 1.5 * sharp * v * a, 0.5 * sharp * a * a
    rows[:, knots.POSE : knots.POSE + 3] = np.column_stack([at.x, at.y, at.yaw])
    return rows


def _as_body(
    rows: Array, lasting: Array, at_nodes: tuple[Array, ...], vehicle: PlantParameters
) -> Array:
    """Rows that last so long [s] in the body frame, from V, sprocket speeds, alpha at the nodes."""
    v, left, right, alpha = at_nodes
    powers = np.maximum(lasting, 1e-12) ** np.arange(6)

    def fit(values: Array) -> Array:
        return np.asarray(values @ _FIT.T / powers)

    wide, bend = _rows(len(rows), "body"), fit(alpha)
    wide[:, : knots.COURSE_COLUMNS] = rows
    wide[:, :6] = fit(0.5 * vehicle.sprocket_radius * (left + right))
    wide[:, 6:12] = fit(vehicle.sprocket_radius * (right - left) / vehicle.track_gauge)
    wide[:, knots.FORWARD : knots.SIDEWAYS] = fit(v * np.cos(alpha))
    wide[:, knots.SIDEWAYS : knots.TURN] = fit(v * np.sin(alpha))
    wide[:, knots.TURN :] = rows[:, 6:12]
    wide[:, knots.TURN : knots.TURN + 5] -= bend[:, 1:] * np.arange(1, 6)
    wide[:, knots.POSE + 2] -= alpha[:, 0]
    return wide


def _rows(count: int, frame: str) -> Array:
    return np.zeros((count, knots.COURSE_COLUMNS if frame == "course" else knots.BODY_COLUMNS))


def _ended(rows: Array, time: float, goal: Pose, yaw: float) -> Array:
    """Rows, and a stand at the goal from `time` [s] on; yaw: of the vehicle when it arrives."""
    last = np.zeros((1, rows.shape[1]))
    last[0, knots.START], last[0, knots.POSE : knots.POSE + 2] = time, goal[:2]
    last[0, knots.POSE + 2] = yaw + wrap_angle(goal[2] - yaw)
    return np.vstack([rows, last])


dubins_plan = partial(_path_plan, "dubins")
reeds_shepp_plan = partial(_path_plan, "reeds-shepp")
clothoid_plan = partial(_path_plan, "clothoid")
