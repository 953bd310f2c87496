"""From a name or a JSON-able dictionary to a reference: the registry, its checks, and plans.

    "circle"
    {"kind": "circle", "radius": 12.0, "speed": [1.0, 2.0], "x": 5.0, "yaw": 0.5}
A number may be given as [low, high]: it is drawn, =U(low, high), on a 0.5 s grid for times
that must lie on it. `direction` may be given as [-1, 1]: either, with equal probability.
Draws follow the order of the builder's arguments, so the order of the keys has no effect.

Default speeds are for the vehicle "strawa"; those in the dictionary are meant as they stand, unless
{"vehicle": name} says for which vehicle. For another nominal vehicle
    v -> v v_top / v_top',  w -> w min(1, (v_top / B) / (v_top' / B'))
with v_top of `physics.parameters.top_speed`, the gauge B, and ' of the vehicle that they are for.

A planner makes references from a start to a goal, where they stand until the episode ends:
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

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.entry_points import declared
from tracked_env.physics import reference_profile as columns
from tracked_env.physics.parameters import VEHICLES, PlantParameters, Range, top_speed
from tracked_env.physics.reference_profile import SEGMENT_DURATION, YAW_RATE_LIMIT, PlannedRows
from tracked_env.references import catalogue
from tracked_env.references.profile import FloatArray, ReferenceProfile, of_table
from tracked_env.validation import (
    checked_choice,
    checked_flag,
    checked_interval,
    checked_keys,
    checked_number,
)
from tracked_env.vehicles import find_vehicle

DURATION = Range(0.01, 3600.0, "s", "Use SI units.")
POINTS_LIMIT = 1000  # [-] way-points of one reference
POSITION_LIMIT = 1e5  # [m] beyond it the coordinates lose digits

START_POSE = ("x", "y", "yaw")
PLAN = "plan"  # the kind that a planner makes
SPEEDS = ("speed", "initial_speed", "speed_range", "speed_amplitude")
YAW_RATES = ("yaw_rate", "yaw_rate_limit")
LENGTHS = ("radius", "radius_start", "radius_end", "size")
DEFAULT_VEHICLE = "strawa"  # for which the defaults of the builders are


_GRID_HINT = f"Profiles can change their law only at multiples of {SEGMENT_DURATION} s."
_SI = "Use SI units."
_SPEED = Range(-5.0, 5.0, "m/s", "Did you pass km/h?")
_RADIUS = Range(1.0, 1e4, "m", "Left or right is chosen by direction, not by the sign.")
_ANGLE = Range(-100.0, 100.0, "rad", "Did you pass degrees?")
_COORDINATE = Range(-POSITION_LIMIT, POSITION_LIMIT, "m", _SI)
QUANTITIES = {
    **dict.fromkeys(("speed", "initial_speed", "speed_range"), _SPEED),
    "speed_amplitude": Range(0.0, 2.0, "m/s", _SI),
    "speed_period": Range(1.0, 100.0, "s", "Shorter ones are not resolved by the segments."),
    "acceleration": Range(0.01, 10.0, "m/s^2", "It is a magnitude: the speeds set the sign."),
    **dict.fromkeys(("radius", "radius_start", "radius_end"), _RADIUS),
    "size": Range(5.0, 1e4, "m", "It is the distance between the two tips."),
    "straight_duration": Range(0.0, 3600.0, "s", _SI),
    "yaw_rate": Range(-3.0, 3.0, "rad/s", "Did you pass deg/s?"),
    "yaw_rate_limit": Range(0.0, 3.0, "rad/s", "Did you pass deg/s?"),
    "lateral_acceleration_limit": Range(0.0, 20.0, "m/s^2", _SI),
    "turn_time": Range(0.0, 3600.0, "s", _GRID_HINT),
    "switch_time": Range(0.0, 3600.0, "s", _GRID_HINT),
    "knot_interval": Range(0.5, 60.0, "s", _GRID_HINT),
    **{"x": _COORDINATE, "y": _COORDINATE, "yaw": _ANGLE},
}
ON_GRID = ("turn_time", "switch_time", "knot_interval")  # multiples of SEGMENT_DURATION
FORWARD_ONLY = {"figure_eight", "waypoints"}
FORWARD_SPEED = Range(0.1, 5.0, "m/s", "This path cannot be driven in reverse. Did you pass km/h?")
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

# "mixed": one of these with equal probability, lateral acceleration <= 1.5 m/s^2. Way-points
# need points, and the chicane cannot be followed by design: neither is drawn.
MIXED: list[dict[str, Any]] = [
    {"kind": "straight", "speed": [1.0, 3.0], "initial_speed": [1.0, 3.0]},
    {"kind": "circle", "speed": [1.0, 3.0], "radius": [6.0, 30.0], "direction": [-1, 1]},
    {"kind": "figure_eight", "speed": [1.0, 2.5], "size": [25.0, 60.0], "direction": [-1, 1]},
    {"kind": "spiral", "speed": [1.0, 3.0], "direction": [-1, 1]}
    | {"radius_start": [15.0, 60.0], "radius_end": [6.0, 15.0]},
    {"kind": "identification", "speed": [1.5, 2.5], "radius_end": [6.0, 12.0]},
    {"kind": "random"},
]


def mixed(
    duration: float, rng: np.random.Generator, vehicle: PlantParameters | None = None
) -> ReferenceProfile:
    """One of `MIXED`, with equal probability, its parameters drawn as listed there."""
    spec = {**MIXED[rng.integers(len(MIXED))], "vehicle": DEFAULT_VEHICLE}
    return make_reference(spec, duration, rng, vehicle)


REFERENCES: dict[str, Callable[..., ReferenceProfile]] = {
    "straight": catalogue.straight,
    "circle": catalogue.circle,
    "figure_eight": catalogue.figure_eight,
    "spiral": catalogue.spiral,
    "identification": catalogue.identification,
    "chicane": catalogue.chicane,
    "random": catalogue.random_smooth,
    "waypoints": catalogue.waypoints,
    "mixed": mixed,
}
_ARGUMENTS = {kind: {**inspect.signature(build).parameters} for kind, build in REFERENCES.items()}
_ARGUMENTS["random"] |= inspect.signature(catalogue.random_paths).parameters


def _defaults(kind: str) -> dict[str, Any]:
    """Parameters of a kind, without its start pose, in the order in which they are drawn."""
    others = ("duration", "rng", "vehicle", "law")
    return {name: a.default for name, a in _ARGUMENTS[kind].items() if name not in others}


def _direction(value: Any, rng: np.random.Generator) -> float:
    if isinstance(value, (list, tuple)) and list(value) in ([-1, 1], [1, -1]):
        return float(rng.choice([-1.0, 1.0]))
    if isinstance(value, bool) or not isinstance(value, Real) or abs(value) != 1:
        raise ValueError(
            f"direction = {value!r}; must be +1 (left), -1 (right) or [-1, 1] (either). "
            "How sharp the turn is, is set by a radius or a size."
        )
    return float(value)


def _points(value: Any) -> FloatArray:
    try:
        points = np.array(value)
        points = points.astype(np.float64) if points.dtype.kind in "iuf" else np.empty(0)
    except (TypeError, ValueError):
        points = np.empty(0)
    shaped = points.ndim == 2 and points.shape[1] == 2 and 2 <= len(points) <= POINTS_LIMIT
    if not shaped or not np.all(np.abs(points) <= POSITION_LIMIT):
        raise ValueError(
            f"points: shape {points.shape}; must be (M, 2) numbers [m], 2 <= M <= {POINTS_LIMIT}, "
            f"within +-{POSITION_LIMIT:g} m. Did you pass (2, M), or a NaN?"
        )
    gaps = np.hypot(*np.diff(points, axis=0).T)
    if gaps.min() < 1e-3:
        raise ValueError(
            f"points: way-points {gaps.argmin()} and {gaps.argmin() + 1} are {gaps.min():.2g} m "
            "apart; must be >= 0.001 m. Remove the repeated one."
        )
    return points


def _resolve(kind: str, name: str, value: Any, rng: np.random.Generator) -> Any:
    """Return the checked, drawn value of one parameter."""
    if name in ("direction", "points"):
        return _direction(value, rng) if name == "direction" else _points(value)
    if value is None and _defaults(kind).get(name, 0.0) is None:
        return None
    quantity = FORWARD_SPEED if name == "speed" and kind in FORWARD_ONLY else QUANTITIES[name]
    is_pair = isinstance(value, (list, tuple))
    if name == "speed_range":
        return checked_interval(name, value if is_pair else (value, value), quantity)
    if is_pair:
        number = rng.uniform(*checked_interval(name, value, quantity))
        on_grid = round(number / SEGMENT_DURATION) * SEGMENT_DURATION
        return on_grid if name in ON_GRID else number
    number = checked_number(name, value, quantity)
    if name in ON_GRID and math.remainder(number, SEGMENT_DURATION) != 0.0:
        raise ValueError(
            f"{name} = {value!r} {quantity.unit}; must be a multiple of {SEGMENT_DURATION} s. "
            f"{quantity.hint}"
        )
    return number


def _check_belts(kind: str, belts: float, vehicle: PlantParameters | None) -> None:
    """Raise ValueError where belts would have to run faster [m/s] than those of the vehicle."""
    if vehicle is not None and not belts <= top_speed(vehicle) * (1.0 + 1e-9):
        raise ValueError(
            f"reference {kind!r}: a belt would have to run at {belts:.3g} m/s; must be at most "
            f"{top_speed(vehicle):.3g} m/s, sprocket_radius * sprocket_speed_limit of the vehicle. "
            "Lower the speed or widen the turns, or leave both out: they then suit the vehicle."
        )


def _check(kind: str, profile: ReferenceProfile, vehicle: PlantParameters | None) -> None:
    """Raise ValueError for parameters that are valid one by one but not together."""
    if vehicle is not None:
        turn = 0.5 * vehicle.track_gauge * np.abs(profile.yaw_rate[:, 0])
        _check_belts(kind, float((np.abs(profile.speed[:, 0]) + turn).max()), vehicle)
    fastest = float(np.abs(profile.yaw_rate[:, 0]).max())
    if not fastest <= YAW_RATE_LIMIT:
        raise ValueError(
            f"yaw rate of {kind!r} = {fastest:.3g} rad/s; must be <= {YAW_RATE_LIMIT} rad/s. "
            "The path is too tight for the speed: lower the speed or widen the path."
        )


def _scaled(
    values: Mapping[str, Any], vehicle: PlantParameters | None, written_for: str | None
) -> dict[str, Any]:
    """Parameters with speeds, yaw rates and lengths for `vehicle` in place of the one they are for.

    Speeds grow as the top speed, lengths as the contact length. They stay where either vehicle is
    None. Nothing is scaled beyond what may be given.
    """
    if vehicle is None or written_for is None:
        return dict(values)
    other = find_vehicle(written_for)
    ratio = top_speed(vehicle) / top_speed(other)
    speeds = {name: values[name] for name in SPEEDS if values.get(name) is not None}
    fastest = max((float(np.abs(value).max()) for value in speeds.values()), default=0.0)
    faster = min(ratio, max(QUANTITIES["speed"].high / fastest, 1.0)) if fastest else ratio
    turning = min(ratio * other.track_gauge / vehicle.track_gauge, 1.0)
    pairs = {name: value for name, value in speeds.items() if isinstance(value, (list, tuple))}
    scaled = {name: faster * value for name, value in speeds.items() if name not in pairs}
    scaled |= {name: tuple(faster * v for v in pair) for name, pair in pairs.items()}
    scaled |= {name: turning * values[name] for name in YAW_RATES if name in values}
    longer = vehicle.contact_length / other.contact_length
    lengths = ((name, longer * values[name]) for name in LENGTHS if name in values)
    return {**values, **scaled, **{n: max(length, QUANTITIES[n].low) for n, length in lengths}}


def _parameters(
    kind: str, options: Mapping[str, Any], rng: np.random.Generator, vehicle: PlantParameters | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Checked and drawn arguments of a builder, and what the options say of the start pose."""
    defaults = _defaults(kind)
    names = [*defaults] if kind == "waypoints" else [*defaults, *START_POSE]
    checked_keys(f"reference {kind!r}:", options, (*names, "vehicle"))
    if kind == "waypoints" and "points" not in options:
        raise ValueError("reference 'waypoints': points missing; must be a list of [x, y] [m].")
    values = _scaled(defaults, vehicle, DEFAULT_VEHICLE)
    choices = {name: _resolve(kind, name, options[name], rng) for name in names if name in options}
    values |= _scaled(choices, vehicle, options.get("vehicle"))
    return values, {name: values.pop(name) for name in START_POSE if name in values}


def make_reference(
    spec: str | Mapping[str, Any],
    duration: float,
    rng: np.random.Generator,
    vehicle: PlantParameters | None = None,
) -> ReferenceProfile:
    """Return the reference that `spec` describes, for an episode of `duration` [s].

    spec: a name of `REFERENCES`, or {"kind": name, parameter: value, ...}; parameters and defaults
    are the arguments of the builder, and the start pose x, y [m], yaw [rad]. A missing "kind" is
    "random"; "plan" is made by a planner for the nominal `vehicle`, see the head of this file.
    vehicle: None leaves all speeds as they are. Raises ValueError for whatever is unknown or out of
    range.
    """
    if not isinstance(spec, (str, Mapping)):
        raise ValueError(f"reference = {spec!r}; must be a name or a dictionary with a 'kind'.")
    options = {"kind": spec} if isinstance(spec, str) else dict(spec)
    kind = checked_choice("reference kind", options.pop("kind", "random"), (*REFERENCES, PLAN))
    horizon = checked_number("duration", duration, DURATION)
    if kind == PLAN:
        profile = plan_reference(options, horizon, rng, vehicle)
    else:
        values, pose = _parameters(kind, options, rng, vehicle)
        context = {"rng": rng, "vehicle": vehicle}
        context = {name: value for name, value in context.items() if name in _ARGUMENTS[kind]}
        profile = REFERENCES[kind](duration=horizon, **context, **values)._replace(**pose)
    _check(kind, profile, vehicle)
    return profile


def batch_reference(
    spec: str | Mapping[str, Any], vehicle: PlantParameters | None = None
) -> tuple[catalogue.RandomPaths, list[float]] | None:
    """Paths of a reference that can be drawn for many vehicles at once, and their start pose.

    None for kinds other than "random", and where parameters of the law are drawn as well.
    """
    options: dict[str, Any] = {} if isinstance(spec, str) else dict(spec)
    kind = options.pop("kind", spec if isinstance(spec, str) else "random")
    drawn = (isinstance(v, (list, tuple)) for n, v in options.items() if n != "speed_range")
    if kind != "random" or any(drawn):
        return None
    values, pose = _parameters(kind, options, np.random.default_rng(), vehicle)
    if vehicle is not None:
        speeds = np.linspace(*np.sort(np.abs(values["speed_range"])), 50)
        lateral = values["lateral_acceleration_limit"] / np.maximum(speeds, catalogue.SLOWEST)
        turns = 0.5 * vehicle.track_gauge * np.minimum(values["yaw_rate_limit"], lateral)
        _check_belts(kind, float((speeds + turns).max()), vehicle)
    return catalogue.random_paths(**values), [pose.get(name, 0.0) for name in START_POSE]


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
    return x, y, checked_number(f"{what} yaw", numbers[2], _ANGLE)


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
    scale = vehicle.track_gauge / _INDOOR.track_gauge
    name = options.get("planner", "optimal")
    frame = checked_choice("frame", options.get("frame", "course"), FRAMES)
    slip = checked_flag("slip", options.get("slip", name == "optimal"))
    limits = _limits(options.get("limits"), min(scale, top_speed(vehicle) / top_speed(_INDOOR)))
    planner = _planner(name)
    start = _pose("start", [options.get(key, 0.0) for key in START_POSE])
    goals, several = _goals(options, scale), "goals" in options
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
