"""References that a planner makes, from a start to a goal, where they stand until the episode ends.

    {"kind": "plan", "goal": [2.0, 2.5, -0.4]}
    {"kind": "plan", "goals": "halton", "planner": "dubins", "frame": "body", "limits": {...}}
Planners are entry points of the group `tracked_env.planners`, functions
    planner(vehicle, limits, slip, frame, goal) -> physics.reference_profile.PlannedRows
from rest (or v_min, at constant speed) in the origin to a goal (x, y [m], yaw [rad]) in its axes;
vehicle: the nominal PlantParameters, limits: {name of LIMITS: value}, slip: whether the plan knows
the slip of the nominal vehicle. The goals of "halton" are those of the published code of [1] 7.2:
Halton points in a square, as far from the start as `annulus` says, with any yaw. Lengths and speeds
are for the indoor vehicle of [1] and grow with the track gauge for another, speeds no more than its
top speed does.

References: [1] Focchi et al. (2025), section 7.2 and its code.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.entry_points import declared
from tracked_env.physics import reference_profile as columns
from tracked_env.physics.parameters import VEHICLES, PlantParameters, Range, top_speed
from tracked_env.physics.reference_profile import PlannedRows
from tracked_env.references.profile import ANGLE, START_POSE, ReferenceProfile, of_table
from tracked_env.validation import (
    checked_choice,
    checked_flag,
    checked_interval,
    checked_keys,
    checked_number,
)

Pose = tuple[float, float, float]
Limits = tuple[tuple[str, float], ...]
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
ANNULUS = (1.0, 4.0)  # [m] from the start, of the same vehicle
GOALS = 100  # [-] of "halton", the first ones in the annulus
ATTEMPTS = 10  # [-] goals that are tried, where a drawn one has no plan
_INDOOR = VEHICLES["focchi"]
_PLACE = Range(-1e4, 1e4, "m", "Did you pass millimetres?")
_DISTANCE = Range(0.0, 1e4, "m", "It is [nearest, farthest], from the start.")
_PLAN_KEYS = ("goal", "goals", "annulus", "planner", "frame", "slip", "limits", *START_POSE)


@lru_cache(maxsize=8)
def halton_goals(nearest: float, farthest: float) -> NDArray[np.float64]:
    """GOALS poses (GOALS, 3) in an annulus [m] around the origin, yaw in [0, 2 pi).

    Raises ValueError for an annulus that holds too few of them.
    """
    from scipy.stats import qmc  # a second to import: only when used

    points = qmc.Halton(d=3, scramble=True, seed=0).random(10 * GOALS)
    places = farthest * (2.0 * points[:, :2] - 1.0)
    distance = np.hypot(*places.T)
    inside = (nearest < distance) & (distance < farthest)
    goals = np.column_stack([places, 2.0 * np.pi * points[:, 2]])[inside][:GOALS]
    if len(goals) < GOALS:
        raise ValueError(
            f"annulus = [{nearest:g}, {farthest:g}] m holds {len(goals)} goals; must hold {GOALS}. "
            "Widen it."
        )
    return goals


@lru_cache(maxsize=32)
def _planner(name: str) -> Planner:
    """A registered planner. Raises ValueError for an unknown name."""
    entries = {entry.name: entry for _, entry in reversed(declared(PLANNERS))}
    if not entries:
        raise ValueError(f"planner {name!r}: no installed package registers {PLANNERS}")
    planner: Planner = entries[checked_choice("planner", name, entries)].load()
    return planner


@lru_cache(maxsize=256)
def _planned(
    planner: Planner, vehicle: PlantParameters, limits: Limits, slip: bool, frame: str, goal: Pose
) -> PlannedRows:
    """A plan; goals that come again in later episodes find it here."""
    return planner(vehicle, dict(limits), slip, frame, goal)


def _pose(what: str, numbers: Any) -> Pose:
    if isinstance(numbers, (str, Mapping)) or np.shape(numbers) != (3,):
        raise ValueError(f"{what} = {numbers!r}; must be [x, y, yaw] in m and rad")
    x, y = (checked_number(f"{what} {name}", numbers[k], _PLACE) for k, name in enumerate("xy"))
    return x, y, checked_number(f"{what} yaw", numbers[2], ANGLE)


def _goals(options: Mapping[str, Any], scale: float) -> Sequence[Pose]:
    """The goals that an episode may have."""
    if ("goal" in options) == ("goals" in options):
        raise ValueError("reference 'plan': must have one of 'goal': [x, y, yaw] and 'goals'")
    if "annulus" in options and options.get("goals") != "halton":
        raise ValueError('reference \'plan\': annulus is of "goals": "halton", not of given ones')
    if "goal" in options:
        return [_pose("goal", options["goal"])]
    goals = options["goals"]
    if isinstance(goals, str):
        checked_choice("goals", goals, ("halton",))
        ends = options.get("annulus", [scale * end for end in ANNULUS])
        annulus = checked_interval("annulus", ends, _DISTANCE)
        return [(x, y, yaw) for x, y, yaw in halton_goals(*annulus).tolist()]
    if not isinstance(goals, (list, tuple, np.ndarray)) or not len(goals):
        raise ValueError(f'goals = {goals!r}; must be "halton" or a list of [x, y, yaw]')
    return [_pose("goals", goal) for goal in goals]


def _limits(limits: Any, scale: float) -> Limits:
    limits = checked_keys("limits", limits, LIMITS)
    defaults = {k: v * (scale if k[:2] == "v_" else 1.0) for k, v in DEFAULT_LIMITS.items()}
    if "v_max" in limits and "v_min" not in limits:
        highest = checked_number("limits v_max", limits["v_max"], LIMITS["v_max"])
        defaults["v_min"] = min(defaults["v_min"], highest)
    values = {**defaults, **limits}
    return tuple((k, checked_number(f"limits {k}", v, LIMITS[k])) for k, v in values.items())


def _scales(vehicle: PlantParameters) -> tuple[float, float]:
    """Factors on the default speeds and on the default annulus."""
    scale = vehicle.track_gauge / _INDOOR.track_gauge
    return min(scale, top_speed(vehicle) / top_speed(_INDOOR)), scale


def plan_scale(options: Mapping[str, Any], vehicle: PlantParameters) -> tuple[float, float, float]:
    """`reference_scale` of a plan: factors on what is left out of speeds, yaw rates and lengths."""
    faster, longer = _scales(vehicle)
    are_said = {"v_max", "v_min"} <= {*(options.get("limits") or {})}
    is_drawn = options.get("goals") == "halton" and "annulus" not in options
    return 1.0 if are_said else faster, 1.0, longer if is_drawn else 1.0


def plan_reference(
    options: Mapping[str, Any],
    duration: float,
    rng: np.random.Generator,
    vehicle: PlantParameters | None,
) -> ReferenceProfile:
    """The reference of a plan for the nominal `vehicle`, see the head of this file.

    Of drawn goals, the next one is taken where one has no plan, ATTEMPTS times at most. Raises
    ValueError also where no plan reaches a goal within `duration` [s].
    """
    options = checked_keys("reference 'plan'", options, _PLAN_KEYS)
    if vehicle is None:
        raise ValueError("reference 'plan': a plan needs the vehicle; pass it to make_reference")
    faster, longer = _scales(vehicle)
    name = options.get("planner", "optimal")
    frame = checked_choice("frame", options.get("frame", "course"), FRAMES)
    slip = checked_flag("slip", options.get("slip", name == "optimal"))
    limits = _limits(options.get("limits"), faster)
    planner = _planner(name)
    start = _pose("start", [options.get(key, 0.0) for key in START_POSE])
    goals, several = _goals(options, longer), "goals" in options
    first = int(rng.integers(len(goals))) if several else 0
    for attempt in range(min(ATTEMPTS, len(goals))):
        goal = goals[(first + attempt) % len(goals)]
        plan = _planned(planner, vehicle, limits, slip, frame, goal)
        end = float(plan.rows[-1, columns.START])
        refusal = f"it takes {end:.1f} s of an episode of {duration:g} s: raise duration or v_max"
        if not plan.converged:
            refusal = plan.message or "it did not converge"
        elif end <= duration:
            return _placed(plan.rows, start)
    where = f"none of {attempt + 1} goals drawn, the last" if several else "no plan to the goal"
    x, y, yaw = goal
    raise ValueError(
        f"reference 'plan': {where} ({x:.3g} m, {y:.3g} m, {yaw:.3g} rad) by {name!r}: {refusal}"
    )


def _placed(rows: NDArray[np.float64], start: Pose) -> ReferenceProfile:
    """The reference of rows from the origin, from another start."""
    x, y, yaw = start
    rows, at = rows.copy(), columns.POSE
    places = (rows[:, at] + 1j * rows[:, at + 1]) * np.exp(1j * yaw)
    rows[:, at], rows[:, at + 1] = places.real + x, places.imag + y
    rows[:, at + 2] += yaw
    return of_table(rows, *rows[0, at : at + 3].tolist())
