"""From a name or a JSON-able dictionary to a reference: the registry and its checks.

    "circle"
    {"kind": "circle", "radius": 12.0, "speed": [1.0, 2.0], "x": 5.0, "yaw": 0.5}
A number may be given as [low, high]: it is drawn, =U(low, high), on a 0.5 s grid for times
that must lie on it. `direction` may be given as [-1, 1]: either, with equal probability.
Draws follow the order of the builder's arguments, so the order of the keys has no effect.

Default speeds are for the vehicle "strawa"; those in the dictionary are meant as they stand, unless
{"vehicle": name} says for which vehicle. For another nominal vehicle
    v -> v v_top / v_top',  w -> w min(1, (v_top / B) / (v_top' / B'))
with v_top of `physics.parameters.top_speed`, the gauge B, and ' of the vehicle that they are for:
v is what has the unit m/s, w what has rad/s. Lengths, in m, grow as the contact length. Where that
were more than the vehicle can accelerate beside its turning, v and w of a random path are less: its
largest dv/dt and dw/dt together take at most ACCELERATING m g of a track. `register` adds a kind,
"module:kind" imports the module first; a planner makes the references of `plans`.
"""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import Any, NamedTuple, cast

import numpy as np

from tracked_env.entry_points import registered_name
from tracked_env.physics.parameters import PlantParameters, Range, top_speed
from tracked_env.physics.reference_profile import SEGMENT_DURATION, YAW_RATE_LIMIT
from tracked_env.references import catalogue
from tracked_env.references.profile import (
    ANGLE,
    DEGREE,
    PLAN,
    START_POSE,
    FloatArray,
    ReferenceProfile,
    number_of_segments,
)
from tracked_env.validation import (
    checked_interval,
    checked_keys,
    checked_number,
)
from tracked_env.vehicles import find_vehicle

DURATION = Range(0.01, 3600.0, "s", "Use SI units.")
POINTS_LIMIT = 1000  # [-] way-points of one reference
POSITION_LIMIT = 1e5  # [m] beyond it the coordinates lose digits

DEFAULT_VEHICLE = "strawa"  # for which the defaults of the builders are
_GRID_HINT = f"Profiles can change their law only at multiples of {SEGMENT_DURATION} s."
_SI = "Use SI units."
_REQUIRED = inspect.Parameter.empty  # default of a parameter that must be given
_NO_NUMBER = Range(0.0, 0.0, "", "")
_SPEED = Range(-catalogue.SPEED_LIMIT, catalogue.SPEED_LIMIT, "m/s", "Did you pass km/h?")
_RADIUS = Range(1.0, 1e4, "m", "Left or right is chosen by direction, not by the sign.")
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
    **{"x": _COORDINATE, "y": _COORDINATE, "yaw": ANGLE},
}
SCALED_UNITS = ("m/s", "rad/s", "m")
ON_GRID = ("turn_time", "switch_time", "knot_interval")  # multiples of SEGMENT_DURATION
WRITTEN = ("speed_range", "yaw_rate_limit")  # of random paths, what is scaled
FORWARD_ONLY = {"figure_eight", "waypoints"}
FORWARD_SPEED = Range(0.1, 5.0, "m/s", "This path cannot be driven in reverse. Did you pass km/h?")
# "mixed": one of these with equal probability, lateral acceleration <= 1.5 m/s^2. Way-points
# need points, and the chicane cannot be followed by design: neither is drawn.
MIXED: Sequence[str | Mapping[str, Any]] = [
    {**one, "vehicle": DEFAULT_VEHICLE}
    for one in (
        {"kind": "straight", "speed": [1.0, 3.0], "initial_speed": [1.0, 3.0]},
        {"kind": "circle", "speed": [1.0, 3.0], "radius": [6.0, 30.0], "direction": [-1, 1]},
        {"kind": "figure_eight", "speed": [1.0, 2.5], "size": [25.0, 60.0], "direction": [-1, 1]},
        {"kind": "spiral", "speed": [1.0, 3.0], "direction": [-1, 1]}
        | {"radius_start": [15.0, 60.0], "radius_end": [6.0, 15.0]},
        {"kind": "identification", "speed": [1.5, 2.5], "radius_end": [6.0, 12.0]},
        {"kind": "random"},
    )
]


def mixed(
    duration: float,
    rng: np.random.Generator,
    vehicle: PlantParameters | None = None,
    of: Sequence[str | Mapping[str, Any]] = MIXED,
) -> ReferenceProfile:
    """One of `of` with equal probability, its parameters drawn as its entry says."""
    return make_reference(of[int(rng.integers(len(of)))], duration, rng, vehicle)


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


class Kind(NamedTuple):
    """A kind of reference that was registered."""

    build: Callable[..., ReferenceProfile]
    ranges: Mapping[str, Range]  # of parameters that QUANTITIES does not have, or has otherwise
    vehicle: str | None  # for which its defaults are; None: for any


_REGISTERED: dict[str, Kind] = {}
_CONTEXT = ("duration", "rng", "vehicle", "law")  # arguments of builders that are no parameters


def register(
    kind: str,
    build: Callable[..., ReferenceProfile],
    ranges: Mapping[str, Range | Sequence[Any]] | None = None,
    vehicle: str | None = DEFAULT_VEHICLE,
) -> None:
    """Add a kind of reference, from then on for environments, sets and options of a reset.

    build: (duration [s], parameters with or without default) -> ReferenceProfile of
    `number_of_segments(duration)` rows from the origin; it draws from the argument `rng` and reads
    the nominal `vehicle` where it has these. Parameters are numbers, given or drawn, `direction`
    or `points`. ranges: {parameter: (low, high, unit)} of those that QUANTITIES does not have.
    vehicle: for which defaults in m/s, rad/s and m are; for others they change as in the head of
    this file. None: they stay.

    Raises ValueError for a kind that is taken, a parameter without a range, a default outside it.
    """
    taken = sorted((*REFERENCES, *_REGISTERED, PLAN))
    if kind in ("", *taken) or kind != str(kind):
        raise ValueError(f"reference kind = {kind!r}; must be text, and none of {taken}")
    own = {}
    for name, one in (ranges or {}).items():
        if not isinstance(one, (list, tuple)) or len(one) not in (3, 4) or not one[0] <= one[1]:
            raise ValueError(f"range of {name} = {one!r}; must be (low, high, unit), low <= high")
        low, high, unit, hint = (*one, _SI)[:4]
        own[name] = Range(low, high, unit, hint)
    if not callable(build):
        raise ValueError(f"reference kind {kind!r}: {build!r}; must be a function of duration")
    if vehicle is not None:
        find_vehicle(vehicle)
    arguments = {**inspect.signature(build).parameters}
    ranged = (*QUANTITIES, *own, "direction", "points")
    for name in (each for each in arguments if each not in ("duration", "rng", "vehicle")):
        if name in ("kind", *START_POSE) or name not in ranged:
            raise ValueError(
                f"parameter {name!r} of reference kind {kind!r}; must have a range in `ranges` and "
                f"be none of {['kind', *START_POSE]}, which every kind has"
            )
    if "duration" not in arguments:
        raise ValueError(f"reference kind {kind!r}: the function must have the argument `duration`")
    _ARGUMENTS[kind], _REGISTERED[kind] = arguments, Kind(build, own, vehicle)
    try:
        for name, default in _defaults(kind).items():
            if isinstance(default, (list, tuple)) and name not in ("speed_range", "points"):
                raise ValueError(
                    f"{name} = {default!r} is a default of {kind!r}; must be one number. Ranges "
                    f"are drawn where they are given: {{'kind': {kind!r}, {name!r}: {[*default]}}}"
                )
            if default is not None and default is not _REQUIRED:
                _resolve(kind, name, default, np.random.default_rng(0))
    except ValueError:
        del _ARGUMENTS[kind], _REGISTERED[kind]
        raise


def builder_of(spec: str | Mapping[str, Any]) -> Callable[..., ReferenceProfile] | None:
    """The function of a kind that was registered; None for those of this package."""
    kind = spec if isinstance(spec, str) else spec.get("kind", "random")
    name = str(kind).rpartition(":")[2]
    return _REGISTERED[name].build if name in _REGISTERED else None


def _defaults(kind: str) -> dict[str, Any]:
    """Parameters of a kind, without its start pose, in the order in which they are drawn."""
    return {name: a.default for name, a in _ARGUMENTS[kind].items() if name not in _CONTEXT}


def _range(kind: str, name: str) -> Range:
    """What a parameter of a kind may be; no unit for a direction and points."""
    ranges = {**QUANTITIES, **(_REGISTERED[kind].ranges if kind in _REGISTERED else {})}
    return ranges.get(name, _NO_NUMBER)


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


def _of(value: Any) -> Sequence[str | Mapping[str, Any]]:
    """References of which one is drawn."""
    if not isinstance(value, (list, tuple)) or not value:
        raise ValueError(f"of = {value!r:.100}; must be a list of references, one at least")
    for one in value:
        options = {"kind": one} if isinstance(one, str) else one
        if not isinstance(options, Mapping) or options.get("kind") in ("mixed", PLAN):
            must = "must be a name or a dictionary with a 'kind', neither of mixed nor of a plan"
            raise ValueError(f"one of `of`: {one!r:.100}; {must}")
        own = {name: value for name, value in options.items() if name != "kind"}
        _parameters(known_kind(options.get("kind", "random")), own, np.random.default_rng(0), None)
    return value


def known_kind(kind: Any, *further: str) -> str:
    """A kind of reference, or one of `further`. Raises ValueError for an unknown one."""
    names = *further, *REFERENCES, PLAN
    return registered_name("reference kind", kind, lambda: (*names, *_REGISTERED))


def _resolve(kind: str, name: str, value: Any, rng: np.random.Generator) -> Any:
    """Return the checked, drawn value of one parameter."""
    if name == "of":
        return _of(value)
    if name in ("direction", "points"):
        return _direction(value, rng) if name == "direction" else _points(value)
    if value is None and _defaults(kind).get(name, 0.0) is None:
        return None
    forward = name == "speed" and kind in FORWARD_ONLY
    quantity = FORWARD_SPEED if forward else _range(kind, name)
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


def _checked_profile(kind: str, profile: Any, duration: float) -> ReferenceProfile:
    """What the function of a registered kind returns. Raises ValueError where it is no profile."""
    if kind not in _REGISTERED:
        return cast(ReferenceProfile, profile)
    shape = (number_of_segments(duration), DEGREE + 1)
    tables = profile[:2] if isinstance(profile, ReferenceProfile) else ()
    if len(tables) < 2 or not all(np.shape(t) == shape and np.isfinite(t).all() for t in tables):
        raise ValueError(
            f"reference {kind!r} has tables of shape {[np.shape(t) for t in tables]}; must be a "
            f"ReferenceProfile of two finite ones {shape}. Did you fit other times than "
            "knot_times(number_of_segments(duration))?"
        )
    speed, yaw_rate = (np.ascontiguousarray(table, dtype=np.float64) for table in tables)
    return ReferenceProfile(speed, yaw_rate, *profile[2:5])


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
    kind: str, values: Mapping[str, Any], vehicle: PlantParameters | None, written_for: str | None
) -> dict[str, Any]:
    """Parameters with speeds, yaw rates and lengths for `vehicle` in place of the one they are for.

    Speeds grow as the top speed, lengths as the contact length. They stay where either vehicle is
    None. Nothing is scaled beyond what may be given.
    """
    if vehicle is None or written_for is None:
        return dict(values)
    other = find_vehicle(written_for)
    numbers = {n: v for n, v in values.items() if v is not None and v is not _REQUIRED}
    speeds = {n: v for n, v in numbers.items() if _range(kind, n).unit == "m/s"}
    fastest = max((float(np.abs(value).max()) for value in speeds.values()), default=0.0)
    faster, turning = catalogue.pace.py_func(vehicle, other, fastest)
    pairs = {name: value for name, value in speeds.items() if isinstance(value, (list, tuple))}
    scaled = {name: faster * value for name, value in speeds.items() if name not in pairs}
    scaled |= {name: tuple(faster * v for v in pair) for name, pair in pairs.items()}
    turns = {n: turning * v for n, v in numbers.items() if _range(kind, n).unit == "rad/s"}
    longer = vehicle.contact_length / other.contact_length
    lengths = {n: longer * v for n, v in numbers.items() if _is_length(kind, n)}
    lengths = {n: max(length, _range(kind, n).low) for n, length in lengths.items()}
    return {**values, **scaled, **turns, **lengths}


def _gentler(values: dict[str, Any], p: PlantParameters, scaled: Sequence[str]) -> dict[str, Any]:
    """Parameters of a random path, with those that were `scaled` no larger than is gentle."""
    low, high = values["speed_range"]
    turn, interval = values["yaw_rate_limit"], values["knot_interval"]
    factor = catalogue.gentleness.py_func(p, (low, high, turn), interval)
    less = {"speed_range": (factor * low, factor * high), "yaw_rate_limit": factor * turn}
    return {**values, **{name: value for name, value in less.items() if name in scaled}}


def reference_scale(spec: str | Mapping[str, Any], vehicle: PlantParameters) -> FloatArray:
    """Factors (3,) by which `vehicle` changes the speeds, yaw rates and lengths of a reference.

    1: they stand as they are written. Where some of them change, or by different factors, the one
    farthest from 1; of a range, that of its fastest speed.
    """
    options = {"kind": spec} if isinstance(spec, str) else dict(spec)
    kind = str(options.pop("kind", "random")).rpartition(":")[2]
    if kind == PLAN:
        from tracked_env.references.plans import plan_scale  # here: few references need it

        return np.array(plan_scale(options, vehicle))
    scales = [np.ones(3)]
    if kind == "mixed":
        scales += [reference_scale(one, vehicle) for one in _of(options.get("of", MIXED))]
    own, written = (
        _parameters(kind, options, np.random.default_rng(0), of)[0] for of in (vehicle, None)
    )
    for name in (n for n in written if _range(kind, n).unit in SCALED_UNITS):
        if written[name] is not None and np.any(written[name]):
            one = np.ones(3)
            ratio = np.abs(own[name]).max() / np.abs(written[name]).max()
            one[SCALED_UNITS.index(_range(kind, name).unit)] = ratio
            scales.append(one)
    table = np.array(scales)
    return table[np.abs(np.log(table)).argmax(axis=0), np.arange(3)]


def _is_length(kind: str, name: str) -> bool:
    return _range(kind, name).unit == "m" and name not in START_POSE


def _parameters(
    kind: str, options: Mapping[str, Any], rng: np.random.Generator, vehicle: PlantParameters | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Checked and drawn arguments of a builder, and what the options say of the start pose."""
    defaults = _defaults(kind)
    names = [*defaults] if kind == "waypoints" else [*defaults, *START_POSE]
    checked_keys(f"reference {kind!r}:", options, (*names, "vehicle"))
    for name in (n for n, of in defaults.items() if of is _REQUIRED and n not in options):
        must = "a list of [x, y] [m]" if name == "points" else f"in {_range(kind, name)[:3]}"
        raise ValueError(f"reference {kind!r}: {name} missing; must be {must}.")
    default = _REGISTERED[kind].vehicle if kind in _REGISTERED else DEFAULT_VEHICLE
    values = _scaled(kind, defaults, vehicle, default)
    choices = {name: _resolve(kind, name, options[name], rng) for name in names if name in options}
    written_for = options.get("vehicle")
    values |= _scaled(kind, choices, vehicle, written_for)
    if vehicle is not None and "knot_interval" in values:
        for_others = dict.fromkeys(values, default) | dict.fromkeys(choices, written_for)
        scaled = [n for n, of in for_others.items() if of and find_vehicle(of) != vehicle]
        values = _gentler(values, vehicle, scaled)
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
    "random"; "plan" is made by a planner for the nominal `vehicle`, see `plans`.
    vehicle: None leaves all speeds as they are. Raises ValueError for whatever is unknown or out of
    range.
    """
    if not isinstance(spec, (str, Mapping)):
        raise ValueError(f"reference = {spec!r}; must be a name or a dictionary with a 'kind'.")
    options = {"kind": spec} if isinstance(spec, str) else dict(spec)
    kind = known_kind(options.pop("kind", "random"))
    horizon = checked_number("duration", duration, DURATION)
    if kind == PLAN:
        from tracked_env.references.plans import plan_reference  # likewise

        profile = plan_reference(options, horizon, rng, vehicle)
    else:
        values, pose = _parameters(kind, options, rng, vehicle)
        context = {"rng": rng, "vehicle": vehicle}
        context = {name: value for name, value in context.items() if name in _ARGUMENTS[kind]}
        build = _REGISTERED[kind].build if kind in _REGISTERED else REFERENCES[kind]
        profile = _checked_profile(kind, build(duration=horizon, **context, **values), horizon)
        profile = profile._replace(**pose)
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
    numbers = (v for n, v in options.items() if n not in ("speed_range", "vehicle"))
    drawn = (isinstance(v, (list, tuple)) for v in numbers)
    if kind != "random" or any(drawn):
        return None
    values, pose = _parameters(kind, options, np.random.default_rng(), vehicle)
    if vehicle is not None:
        low, high = sorted(abs(speed) for speed in values["speed_range"])
        speeds = np.linspace(low, high, 50)
        lateral = values["lateral_acceleration_limit"] / np.maximum(speeds, catalogue.SLOWEST)
        turns = 0.5 * vehicle.track_gauge * np.minimum(values["yaw_rate_limit"], lateral)
        _check_belts(kind, float((speeds + turns).max()), vehicle)
    return catalogue.random_paths(**values), [pose.get(name, 0.0) for name in START_POSE]


def written_limits(
    spec: str | Mapping[str, Any],
) -> tuple[FloatArray, list[PlantParameters], float]:
    """Limits (4,) of a reference of `batch_reference` as they are written, before any scaling.

    Then the vehicles for which its speeds and its yaw rate are, and its knot interval [s].
    """
    options: dict[str, Any] = {} if isinstance(spec, str) else dict(spec)
    options.pop("kind", None)
    own = find_vehicle(options.get("vehicle", DEFAULT_VEHICLE))
    others = [own if n in options else find_vehicle(DEFAULT_VEHICLE) for n in WRITTEN]
    values, _ = _parameters("random", options, np.random.default_rng(), None)
    return catalogue.random_paths(**values).limits[0], others, values["knot_interval"]
