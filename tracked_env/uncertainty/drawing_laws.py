"""What a law of uncertainty is, and laws as kernels that draw a batch of episodes at once.

A law draws the truth of one episode around nominal parameters: any function `Law`. `CheckedLaw`
compares what a user's law draws with the physical ranges, so that a mistake in it is an error and
not a strange episode. The laws of this package are kernels, decorated with `law(name)`:

    @law("payload")
    def _payload(rng, nominal, path, truth, changes):
        truth.mass = nominal.mass * uniform(rng, 0.8, 1.5)
        ramp(changes, (ROW.mass,), (2.0 * truth.mass,), start, duration)

`truth` has the fields of PlantParameters and begins as the nominal one. Changes are rows as
`tracked_env.events` encodes them, without those of parameters that the plant does not read; a ninth
number keeps the direction of a line. As a function of Python such a law draws one episode.
"""

import hashlib
import inspect
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env import streams
from tracked_env.arrays import DRAWN_WAVES, RELIEF_SIZE, STEEPEST
from tracked_env.events import LINE, RAMP, REGION, Event, decode_event, encode_schedule
from tracked_env.physics.jit import fill_entries, formula, loop, template
from tracked_env.physics.parameters import PARAMETER_NAMES, PlantParameters
from tracked_env.physics.reference_profile import UNIFORM_COLUMNS, advance
from tracked_env.references import ReferenceProfile
from tracked_env.streams import uniform
from tracked_env.validation import checked_parameter

Floats = NDArray[np.float64]
# Fields of a record are attributes, in kernels as where laws run as plain Python.
RECORD = np.dtype((np.record, [(name, np.float64) for name in PARAMETER_NAMES]))
ROW = PlantParameters(*range(len(PARAMETER_NAMES)))  # row of a parameter, by its name
LOAD, RESISTANCES = (ROW.mass, ROW.inertia), (ROW.longitudinal_resistance, ROW.lateral_resistance)
SOIL = (ROW.cohesion, ROW.friction_angle, ROW.shear_deformation_modulus)
HURST = 0.8  # [-] of drawn hills: 1 is smooth, 0 is rough
CHANGES_LIMIT = 48  # [-] of one episode, drawn by a law
CHANGE_FIELDS = 9  # eight as `events` has them, and the direction of a line [rad]


class Draw(NamedTuple):
    """The truth of one episode."""

    parameters: PlantParameters
    events: list[Event]
    relief: tuple[float, ...] = ()  # drawn ground, see `terrain.pool`; empty: none


# (random stream, nominal parameters, reference, duration [s]) -> truth
Law = Callable[[np.random.Generator, PlantParameters, ReferenceProfile, float], Draw]
ARGUMENTS = ("rng", "nominal", "profile", "duration")
UNCERTAINTY_SETS: dict[str, Law] = {}  # by name


def label(law: Any) -> str:
    """What a law is called in messages and results."""
    return str(getattr(law, "__qualname__", type(law).__qualname__))


class CheckedLaw:
    """A user's law, whose every draw is checked. It can be pickled where `law` can.

    Raises ValueError for what cannot be called with ARGUMENTS, and, when it draws, for another
    result than a Draw, an unknown parameter and a value outside its physical range.
    """

    def __init__(self, law: Law) -> None:
        self.law = law
        signature, arguments = inspect.signature(law), ", ".join(ARGUMENTS)
        try:
            signature.bind(*ARGUMENTS)
        except TypeError as error:
            reason = f"law {label(law)}{signature}; must take ({arguments}): {error}"
            raise ValueError(reason) from error

    def __call__(self, *arguments: Any) -> Draw:
        """Draw one episode; arguments: as ARGUMENTS says."""
        nominal: PlantParameters = arguments[1]
        draw: Any = self.law(*arguments)
        try:
            if not isinstance(draw, tuple) or len(draw) not in (2, 3):
                raise ValueError(f"it returned {draw!r}; must be Draw(parameters, events)")
            parameters, events, relief = (*draw, ())[:3]
            values = parameters._asdict() if hasattr(parameters, "_asdict") else parameters
            if not isinstance(values, dict):
                raise ValueError(f"parameters = {values!r}; must be nominal._replace(...)")
            values = {key: checked_parameter(key, value) for key, value in values.items()}
            encode_schedule(events)
            return Draw(nominal._replace(**values), list(events), checked_relief(relief))
        except ValueError as error:
            raise ValueError(f"law {label(self.law)}: {error}") from error


def checked_relief(relief: Any) -> tuple[float, ...]:
    """A drawn relief as numbers; empty for none. Raises ValueError."""
    numbers = tuple(float(value) for value in relief)
    if len(numbers) not in (0, RELIEF_SIZE) or not all(math.isfinite(value) for value in numbers):
        raise ValueError(
            f"relief of {len(numbers)} numbers; must be {RELIEF_SIZE} finite ones, two slopes and "
            f"{DRAWN_WAVES} rows [A, kx, ky, phi], or none"
        )
    steep = math.hypot(*numbers[:2]) if numbers else 0.0
    for k in range(2, len(numbers), 4):
        steep += abs(numbers[k]) * math.hypot(numbers[k + 1], numbers[k + 2])
    if steep > STEEPEST:
        raise ValueError(
            f"relief with a slope of up to {steep:.3g}; must be at most {STEEPEST:g}. "
            "Are the wave numbers in rad/m?"
        )
    return numbers


def fingerprint(law: Law) -> str:
    """Digest of a law: of the source of its file and, where it is an object, of what it holds."""
    target: Any = law.law if isinstance(law, CheckedLaw) else law
    kind, content = target if inspect.isfunction(target) else type(target), b""
    try:
        source = Path(inspect.getfile(kind)).read_bytes()
    except (OSError, TypeError):  # typed into an interpreter: the code itself
        code = getattr(kind, "__code__", None)
        source = b"" if code is None else code.co_code + repr(code.co_consts).encode()
    if not inspect.isfunction(target):
        try:
            content = pickle.dumps(target)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise ValueError(f"law {label(target)} cannot be pickled: {error}") from error
    return hashlib.sha256(label(target).encode() + source + content).hexdigest()[:12]


class Draws(NamedTuple):
    """What a law draws into, and from, for the chosen vehicles of a batch of N."""

    streams: NDArray[np.int64]  # (n,) addresses of the generators of the chosen vehicles
    vehicles: NDArray[np.int64]  # (n,) rows of the arrays below
    nominal: NDArray[np.void]  # (N,) of RECORD
    profile: Floats  # (S, N, W) references
    poses: Floats  # (N, >= 5) x, y, yaw, cos, sin where they begin
    duration: float  # [s] of the episode
    truths: NDArray[np.void]  # (N,) of RECORD
    changes: Floats  # (N, CHANGES_LIMIT, CHANGE_FIELDS)
    counts: NDArray[np.int64]  # (N,) changes of each
    read: NDArray[np.bool_]  # (PARAMETER_ROWS,) parameters whose changes are kept
    reliefs: Floats  # (N, RELIEF_SIZE) drawn ground, see `terrain.pool`


class DrivenPath(NamedTuple):
    """The reference of one episode, inside a kernel."""

    profile: Floats  # (S, W) of one vehicle, see `physics.reference_profile`
    pose: Floats  # (>= 5,) x, y, yaw, cos, sin where it begins
    duration: float  # [s]


class Changes(NamedTuple):
    """The changes of one episode, inside a kernel."""

    rows: Floats  # (CHANGES_LIMIT, CHANGE_FIELDS)
    used: NDArray[np.int64]  # (1,) how many
    read: NDArray[np.bool_]
    there: np.void  # of RECORD, the nominal one: room for parameters that are changed to
    relief: Floats  # (RELIEF_SIZE,) level ground until a law writes into it


@formula
def _change(changes, kind, parameters, targets, numbers):
    """A row for each of the parameters, `numbers` behind its target; for one not read: none."""
    for k in range(len(parameters)):
        row = changes.rows[changes.used[0]]
        fill_entries(row, 0.0)
        row[0], row[1], row[2] = kind, parameters[k], targets[k]
        for j in range(len(numbers)):
            row[3 + j] = numbers[j]
        if changes.read[parameters[k]]:
            changes.used[0] += 1


@formula
def ramp(changes, parameters, targets, start, duration):
    """Changes in time, of all these parameters at once; start, duration [s]."""
    _change(changes, RAMP, parameters, targets, (start, duration))


@formula
def border(path, time):
    """(x, y, direction): where the reference is at `time` [s], and where it heads."""
    pose = path.pose
    x, y = pose[0], pose[1]
    if path.profile.shape[1] == UNIFORM_COLUMNS:
        x, y = 0.0, 0.0
    start = (x, y, pose[3], pose[4], pose[2])
    x, y, _, _, yaw = advance(path.profile, 0.0, time, time, start)
    if path.profile.shape[1] == UNIFORM_COLUMNS:
        x, y = x + pose[0], y + pose[1]
    return x, y, yaw


@formula
def line(changes, parameters, targets, place, edge):
    """Changes square to the path at `place`, see `border`; edge [m]."""
    x, y, direction = place
    numbers = (x, y, math.cos(direction), math.sin(direction), edge, direction)
    _change(changes, LINE, parameters, targets, numbers)


@formula
def patch(changes, parameters, targets, place, radius, edge):
    """Changes inside a disc around place[:2] [m]; radius, edge [m]."""
    _change(changes, REGION, parameters, targets, (place[0], place[1], radius, edge))


@formula
def fixed(changes, rows):
    """Changes that are always the same, rows (M, 8)."""
    for k in range(rows.shape[0]):
        row = rows[k]
        parameter, numbers = np.int64(row[1]), (row[3], row[4], row[5], row[6], row[7])
        _change(changes, row[0], (parameter,), (row[2],), numbers)


@formula
def slope(changes, grade, direction):
    """A plane that rises by the grade tan(s) [-] along a direction [rad] of the world."""
    changes.relief[0] = grade * math.cos(direction)
    changes.relief[1] = grade * math.sin(direction)


@formula
def hills(rng, changes, height, longest, shortest):
    """Hills of a standard deviation `height` [m], wavelengths from longest to shortest [m].

    Sinusoids as those of the kind "fractal" of `terrain.height_field` with the exponent HURST:
    wave numbers k in equal ratios, amplitudes ~ k^-HURST, directions and phases =U(0, 2 pi).
    """
    ratio = math.pow(longest / shortest, 1.0 / (DRAWN_WAVES - 1))
    fall = math.pow(ratio, -HURST)
    square, amplitude = 0.0, 1.0
    for _ in range(DRAWN_WAVES):
        square += 0.5 * amplitude * amplitude
        amplitude *= fall
    amplitude, k = height / math.sqrt(square), 2.0 * math.pi / longest
    for wave in range(DRAWN_WAVES):
        direction, phase = uniform(rng, 0.0, 2.0 * math.pi), uniform(rng, 0.0, 2.0 * math.pi)
        at = 2 + 4 * wave
        changes.relief[at], changes.relief[at + 3] = amplitude, phase
        changes.relief[at + 1] = k * math.cos(direction)
        changes.relief[at + 2] = k * math.sin(direction)
        amplitude *= fall
        k *= ratio


@template
def _draw_each(law, draws):
    """Draw an episode of each chosen vehicle by `law`."""
    there = np.empty(1, dtype=RECORD)
    for k in range(draws.vehicles.size):
        i = draws.vehicles[k]
        draws.truths[i] = there[0] = draws.nominal[i]
        draws.counts[i] = 0
        fill_entries(draws.reliefs[i], 0.0)
        path = DrivenPath(draws.profile[:, i], draws.poses[i], draws.duration)
        changes = Changes(
            draws.changes[i], draws.counts[i : i + 1], draws.read, there[0], draws.reliefs[i]
        )
        law(draws.streams[k], draws.nominal[i], path, draws.truths[i], changes)


def numbers(records: NDArray[np.void]) -> Floats:
    """A view (N, PARAMETER_ROWS) of records (N,)."""
    return records.view(np.float64).reshape(-1, len(PARAMETER_NAMES))


class ArrayLaw:
    """A law that draws whole batches: `fill`. As a function it draws one episode by the same."""

    def fill(self, draws: Draws) -> None:
        """Draw an episode of each chosen vehicle."""
        raise NotImplementedError

    def __call__(
        self,
        rng: np.random.Generator,
        nominal: PlantParameters,
        profile: ReferenceProfile | None,
        duration: float,
    ) -> Draw:
        """Draw one episode. A law that changes nothing along the path needs no profile."""
        if profile is None:
            profile = ReferenceProfile(np.zeros((1, 6)), np.zeros((1, 6)))
        yaw = profile.yaw
        draws = Draws(
            streams=streams.addresses([rng]),
            vehicles=np.zeros(1, dtype=np.int64),
            nominal=np.array([tuple(nominal)], dtype=RECORD),
            profile=profile.table[:, None],
            poses=np.array([[profile.x, profile.y, yaw, math.cos(yaw), math.sin(yaw)]]),
            duration=float(duration),
            truths=np.zeros(1, dtype=RECORD),
            changes=np.zeros((1, CHANGES_LIMIT, CHANGE_FIELDS)),
            counts=np.zeros(1, dtype=np.int64),
            read=np.ones(len(PARAMETER_NAMES), dtype=np.bool_),
            reliefs=np.zeros((1, RELIEF_SIZE)),
        )
        self.fill(draws)
        events = [decode_event(row) for row in draws.changes[0, : draws.counts[0]].tolist()]
        relief = tuple(draws.reliefs[0].tolist()) if draws.reliefs.any() else ()
        return Draw(PlantParameters(*draws.truths[0].item()), events, relief)


class CompiledLaw(ArrayLaw):
    """A law of this package: a kernel, named as its uncertainty set.

    vehicles: (streams (n,), rows (n,), nominal (N,) of RECORD) draws the nominal vehicles of the
    chosen rows, before their references; None: all have that of the environment.
    """

    def __init__(
        self,
        name: str,
        kernel: Callable[[Draws], None],
        description: str | None,
        vehicles: Callable[..., None] | None = None,
    ) -> None:
        self.name, self.kernel, self.__doc__ = name, kernel, description
        self.vehicles = vehicles

    def __reduce__(self) -> tuple[Any, ...]:
        return _by_name, (self.name,)

    def fill(self, draws: Draws) -> None:
        self.kernel(draws)


def known_laws(name: str = "") -> dict[str, Law]:
    """UNCERTAINTY_SETS, with those of `any_vehicle`, which few environments need, unless `name` is
    among the others."""
    if name not in UNCERTAINTY_SETS:
        from tracked_env.uncertainty import any_vehicle  # noqa: F401  its laws enter
    return UNCERTAINTY_SETS


def _by_name(name: str) -> Law:
    return known_laws(name)[name]


def law(name: str) -> Callable[[Callable[..., None]], Any]:
    """Decorator: the function is the law of the uncertainty set `name`, told by its docstring."""

    def decorated(function: Callable[..., None]) -> Any:
        drawing = formula(function)

        def each(draws: Draws) -> None:
            _draw_each(drawing, draws)

        each.__module__ = function.__module__
        each.__qualname__ = f"each.{function.__name__}"  # its files in the cache
        UNCERTAINTY_SETS[name] = CompiledLaw(name, loop(each), function.__doc__)
        return drawing

    return decorated
