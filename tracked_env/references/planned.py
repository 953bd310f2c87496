"""References that a planner makes: from a start to a goal, where they stand until the episode ends.

    {"kind": "plan", "goal": [2.0, 2.5, -0.4]}
    {"kind": "plan", "goals": "halton", "planner": "dubins", "frame": "body", "limits": {...}}
Planners are entry points of the group `tracked_env.planners`, functions

    planner(vehicle, limits, slip, frame, goal) -> physics.reference_knots.PlannedRows
from rest (or v_min, at constant speed) in the origin to a goal (x, y [m], yaw [rad]) in its axes;
vehicle: the nominal PlantParameters, limits: {name of LIMITS: value}, slip: whether the plan knows
the slip of the nominal vehicle. They raise ValueError for what contradicts itself.

The goals of "halton" are those of the published code of [1] 7.2: Halton points in a square, as far
from the start as `annulus` says, with any yaw. Lengths and speeds are for the indoor vehicle of [1]
and grow with the track gauge for another, speeds no more than its top speed does.

References: [1] Focchi et al. (2025), section 7.2 and its code.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.entry_points import declared
from tracked_env.physics.parameters import VEHICLES, PlantParameters, Range, top_speed
from tracked_env.physics.reference_knots import POSE, START, UNIFORM_COLUMNS, PlannedRows
from tracked_env.references.profile import ReferenceProfile
from tracked_env.validation import checked_choice, checked_flag, checked_keys, checked_number

Pose = tuple[float, float, float]
Planner = Callable[[PlantParameters, Mapping[str, float], bool, str, Pose], PlannedRows]  # as above

PLANNERS = "tracked_env.planners"  # group of entry points
FRAMES = ("course", "body")
LIMITS = {
    "v_max": Range(0.01, 20.0, "m/s", "Did you pass km/h?"),
    "v_min": Range(0.0, 20.0, "m/s", "Did you pass km/h?"),
    "reserve": Range(0.0, 0.9, "-", "It is a share of the sprocket speed. Did you pass a percent?"),
    "sprocket_speed": Range(0.01, 1e3, "rad/s", "Did you pass rpm?"),
    "sprocket_acceleration": Range(0.01, 1e6, "rad/s^2", "Did you pass rpm/s?"),
    "acceleration": Range(0.01, 1e3, "m/s^2", "It is along the path."),
    "curvature": Range(0.01, 1e3, "1/m", "Did you pass a radius?"),
    "lateral_acceleration": Range(0.01, 1e3, "m/s^2", "Friction allows mu g at most."),
}
# Of the indoor vehicle; speeds grow as the track gauge, but no more than the top speed.
DEFAULT_LIMITS = {"v_max": 0.4, "v_min": 0.15, "reserve": 0.1, "sprocket_acceleration": 20.0}
SPEEDS = ("v_max", "v_min")
ANNULUS = (1.0, 4.0)  # [m] from the start, of the same vehicle
GOALS = 100  # [-] of "halton", the first ones in the annulus
ATTEMPTS = 10  # [-] goals that are tried, where a drawn one has no plan
_INDOOR = VEHICLES["focchi"]
_PLACE = Range(-1e4, 1e4, "m", "Did you pass millimetres?")
_YAW = Range(-100.0, 100.0, "rad", "Did you pass degrees?")
_DISTANCE = Range(0.0, 1e4, "m", "It is [nearest, farthest], from the start.")
KEYS = (
    "goal", "goals", "annulus", "planner", "frame", "slip", "limits", "x", "y", "yaw",
)  # fmt: skip


def halton_goals(nearest: float, farthest: float) -> NDArray[np.float64]:
    """GOALS poses (GOALS, 3) in an annulus [m] around the origin, yaw in [0, 2 pi).

    Raises ValueError for an annulus that holds too few of them.
    """
    from scipy.stats import qmc  # a second to import: only when used

    drawn = qmc.Halton(d=3, scramble=True, seed=0).random(10 * GOALS)
    places = farthest * (2.0 * drawn[:, :2] - 1.0)
    distance = np.hypot(*places.T)
    inside = (nearest < distance) & (distance < farthest)
    goals = np.column_stack([places, 2.0 * np.pi * drawn[:, 2]])[inside][:GOALS]
    if len(goals) < GOALS:
        raise ValueError(
            f"annulus = [{nearest:g}, {farthest:g}] m holds {len(goals)} goals; must hold {GOALS}. "
            "Widen it."
        )
    return goals


@lru_cache(maxsize=32)
def _planner(name: str) -> Planner:
    """A registered planner. Raises ValueError for an unknown name."""
    known = {entry.name: entry for _, entry in reversed(declared(PLANNERS))}
    if not known:
        raise ValueError(f"planner {name!r}: no installed package registers {PLANNERS}")
    planner: Planner = known[checked_choice("planner", name, known)].load()
    return planner


@lru_cache(maxsize=256)
def _planned(
    planner: Planner, vehicle: PlantParameters, limits: tuple[tuple[str, float], ...], slip: bool,
    frame: str, goal: Pose,
) -> PlannedRows:  # fmt: skip
    """A plan; goals that come again in later episodes find it here."""
    return planner(vehicle, dict(limits), slip, frame, goal)


def _pose(what: str, given: Any) -> Pose:
    if isinstance(given, (str, Mapping)) or np.shape(given) != (3,):
        raise ValueError(f"{what} = {given!r}; must be [x, y, yaw] in m and rad")
    x, y = (checked_number(f"{what} {name}", given[k], _PLACE) for k, name in enumerate("xy"))
    return x, y, checked_number(f"{what} yaw", given[2], _YAW)


@lru_cache(maxsize=8)
def _halton_poses(nearest: float, farthest: float) -> Sequence[Pose]:
    return [(x, y, yaw) for x, y, yaw in halton_goals(nearest, farthest).tolist()]


def _goals(given: Mapping[str, Any], scale: float) -> tuple[Sequence[Pose], bool]:
    """The goals that an episode may have, and whether it draws one of them."""
    if ("goal" in given) == ("goals" in given):
        raise ValueError("reference 'plan': must have one of 'goal': [x, y, yaw] and 'goals'")
    if "annulus" in given and given.get("goals") != "halton":
        raise ValueError('reference \'plan\': annulus is of "goals": "halton", not of given ones')
    if "goal" in given:
        return [_pose("goal", given["goal"])], False
    if isinstance(given["goals"], str):
        checked_choice("goals", given["goals"], ("halton",))
        ends = given.get("annulus", [scale * end for end in ANNULUS])
        if np.shape(ends) != (2,):
            raise ValueError(f"annulus = {ends!r}; must be [nearest, farthest] in m")
        near, far = (checked_number("annulus", end, _DISTANCE) for end in ends)
        if not near < far:
            raise ValueError(f"annulus = {ends!r} m; must be [nearest, farthest]. Swap the two.")
        return _halton_poses(near, far), True
    if not isinstance(given["goals"], (list, tuple, np.ndarray)) or not len(given["goals"]):
        raise ValueError(f'goals = {given["goals"]!r}; must be "halton" or a list of [x, y, yaw]')
    return [_pose("goals", goal) for goal in given["goals"]], True


def _limits(given: Any, scale: float) -> tuple[tuple[str, float], ...]:
    own = checked_keys("limits", given, LIMITS)
    defaults = {k: v * (scale if k in SPEEDS else 1.0) for k, v in DEFAULT_LIMITS.items()}
    if "v_max" in own and "v_min" not in own:
        highest = checked_number("limits v_max", own["v_max"], LIMITS["v_max"])
        defaults["v_min"] = min(defaults["v_min"], highest)
    values = {**defaults, **own}
    return tuple((k, checked_number(f"limits {k}", v, LIMITS[k])) for k, v in values.items())


def _refusal(plan: PlannedRows, duration: float) -> str:
    """Why a plan cannot be the reference of an episode, or nothing."""
    if not plan.converged:
        return plan.message or "it did not converge"
    if (end := float(plan.rows[-1, START])) > duration:
        return f"it takes {end:.1f} s of an episode of {duration:g} s: raise duration or v_max"
    return ""


def plan_reference(
    given: Mapping[str, Any], duration: float, rng: np.random.Generator,
    vehicle: PlantParameters | None,
) -> ReferenceProfile:  # fmt: skip
    """The reference of a plan for the nominal `vehicle`, see the head of this file.

    Of drawn goals, the next one is taken where one has no plan, ATTEMPTS times at most. Raises
    ValueError for what is unknown or out of range, and where no plan reaches a goal within
    `duration` [s].
    """
    given = checked_keys("reference 'plan'", given, KEYS)
    if vehicle is None:
        raise ValueError("reference 'plan': a plan needs the vehicle; pass it to make_reference")
    scale = vehicle.track_gauge / _INDOOR.track_gauge
    name = given.get("planner", "optimal")
    frame = checked_choice("frame", given.get("frame", "course"), FRAMES)
    slip = checked_flag("slip", given.get("slip", name == "optimal"))
    limits = _limits(given.get("limits"), min(scale, top_speed(vehicle) / top_speed(_INDOOR)))
    planner = _planner(name)
    start = _pose("start", [given.get(key, 0.0) for key in ("x", "y", "yaw")])
    goals, drawn = _goals(given, scale)
    first = int(rng.integers(len(goals))) if drawn else 0
    for attempt in range(min(ATTEMPTS, len(goals))):
        goal = goals[(first + attempt) % len(goals)]
        plan = _planned(planner, vehicle, limits, slip, frame, goal)
        refusal = _refusal(plan, duration)
        if not refusal:
            return _placed(plan.rows, start)
    where = f"none of {attempt + 1} goals drawn, the last" if drawn else "no plan to the goal"
    x, y, yaw = goal
    raise ValueError(
        f"reference 'plan': {where} ({x:.3g} m, {y:.3g} m, {yaw:.3g} rad) by {name!r}: {refusal}"
    )


def _placed(rows: NDArray[np.float64], start: Pose) -> ReferenceProfile:
    """The reference of rows from the origin, from another start."""
    x, y, yaw = start
    knots = rows[:, UNIFORM_COLUMNS:].copy()
    own = POSE - UNIFORM_COLUMNS
    places = (rows[:, POSE] + 1j * rows[:, POSE + 1]) * np.exp(1j * yaw)
    knots[:, own], knots[:, own + 1] = places.real + x, places.imag + y
    knots[:, own + 2] += yaw
    begin = knots[0, own : own + 3].tolist()
    speed, yaw_rate = rows[:, :6].copy(), rows[:, 6:UNIFORM_COLUMNS].copy()
    return ReferenceProfile(speed, yaw_rate, begin[0], begin[1], begin[2], knots)
