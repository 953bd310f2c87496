"""What a law of uncertainty is: it draws the truth of one episode around nominal parameters.

A law of one's own is any function of that signature. `checked` wraps it: what it draws is compared
with the physical ranges, so that a mistake in it is an error and not a strange episode.

Laws as kernels: one form that draws a batch of episodes, or one episode for Python.

A law is a `formula` (rng, nominal, path, truth, changes) that draws with `tracked_env.streams`:
    truth.mass = nominal.mass * uniform(rng, 0.8, 1.5)
    ramp(changes, MASS, truth.mass, start, duration)
`truth` has the fields of PlantParameters and begins as the nominal one. Changes are kept in rows as
`tracked_env.events` encodes them, those of parameters that the plant does not read left out; a
ninth number keeps the direction of a line. A law's `loop` stands beside it at module level, where
the kernel cache finds it:
    @loop
    def _each_payload(*call):
        draw_each(_payload, call)
"""

import hashlib
import inspect
import math
import pickle
from collections.abc import Callable
from pathlib import Path as Path_
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env import events, streams
from tracked_env.events import Event, decode_event, encode_schedule
from tracked_env.physics.jit import copy_entries, fill_entries, formula, template
from tracked_env.physics.parameters import PARAMETER_INDEX, PARAMETER_NAMES, PlantParameters
from tracked_env.physics.reference_profile import UNIFORM_COLUMNS, advance
from tracked_env.references import ReferenceProfile
from tracked_env.streams import uniform
from tracked_env.terrain.ground import DRAWN_WAVES, RELIEF_SIZE, checked_relief
from tracked_env.validation import checked_parameter, unknown


class Draw(NamedTuple):
    """The truth of one episode."""

    parameters: PlantParameters
    events: list[Event]
    relief: tuple[float, ...] = ()  # drawn ground, see `terrain.drawn_relief`; empty: none


# (random stream, nominal parameters, reference, duration [s]) -> truth
Law = Callable[[np.random.Generator, PlantParameters, ReferenceProfile, float], Draw]
ARGUMENTS = ("rng", "nominal", "profile", "duration")


def label(law: Any) -> str:
    """What a law is called in messages and results."""
    return str(getattr(law, "__qualname__", type(law).__qualname__))


class CheckedLaw:
    """A law of one's own, whose every draw is checked. It can be pickled where `law` can.

    Raises ValueError for what cannot be called with ARGUMENTS, and, when it draws, for another
    result than a Draw, an unknown parameter and a value outside its physical range.
    """

    def __init__(self, law: Law) -> None:
        self.law = law
        try:
            inspect.signature(law).bind(*ARGUMENTS)
        except TypeError as error:
            raise ValueError(
                f"law {label(law)}{inspect.signature(law)}; must take ({', '.join(ARGUMENTS)}): "
                f"{error}"
            ) from error

    def __call__(
        self,
        rng: np.random.Generator,
        nominal: PlantParameters,
        profile: ReferenceProfile,
        duration: float,
    ) -> Draw:
        """Draw one episode."""
        name = label(self.law)
        drawn: Any = self.law(rng, nominal, profile, duration)
        if not isinstance(drawn, tuple) or len(drawn) not in (2, 3):
            raise ValueError(f"law {name} returned {drawn!r}; must be Draw(parameters, events)")
        parameters, events = drawn[:2]
        given = parameters._asdict() if hasattr(parameters, "_asdict") else parameters
        if not isinstance(given, dict):
            raise ValueError(f"law {name}: parameters = {given!r}; must be nominal._replace(...)")
        for wrong in given.keys() - set(PARAMETER_NAMES):
            raise ValueError(f"law {name}: {unknown('parameter', wrong, PARAMETER_NAMES)}")
        try:
            values = {key: checked_parameter(key, value) for key, value in given.items()}
            encode_schedule(events)
            relief = checked_relief(drawn[2] if len(drawn) == 3 else ())
        except ValueError as error:
            raise ValueError(f"law {name}: {error}") from error
        return Draw(nominal._replace(**values), list(events), relief)


def fingerprint(law: Law) -> str:
    """Digest of a law: of the source of its file and, where it is an object, of what it holds."""
    own: Any = law.law if isinstance(law, CheckedLaw) else law
    kind = own if inspect.isfunction(own) else type(own)
    try:
        source = Path_(inspect.getfile(kind)).read_bytes()
    except (OSError, TypeError):  # typed into an interpreter: the code itself
        code = getattr(kind, "__code__", None)
        source = (
            label(kind).encode() if code is None else code.co_code + repr(code.co_consts).encode()
        )
    held = b""
    if not inspect.isfunction(own):
        try:
            held = pickle.dumps(own)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise ValueError(f"law {label(own)} cannot be pickled: {error}") from error
    return hashlib.sha256(label(own).encode() + source + held).hexdigest()[:12]


def checked(law: Law) -> Law:
    """`law`, if it is one of one's own wrapped in a CheckedLaw."""
    return law if isinstance(law, CheckedLaw) else CheckedLaw(law)


# Fields of a record are attributes, in kernels as where laws run as plain Python.
RECORD = np.dtype((np.record, [(name, np.float64) for name in PARAMETER_NAMES]))
HURST = 0.8  # [-] of drawn hills: 1 is smooth, 0 is rough
CHANGES_LIMIT = 48  # [-] of one episode, drawn by a law
CHANGE_FIELDS = 9  # eight as `events` has them, and the direction of a line [rad]

MASS, INERTIA = PARAMETER_INDEX["mass"], PARAMETER_INDEX["inertia"]
COHESION = PARAMETER_INDEX["cohesion"]
FRICTION_ANGLE = PARAMETER_INDEX["friction_angle"]
SHEAR_DEFORMATION_MODULUS = PARAMETER_INDEX["shear_deformation_modulus"]
LONGITUDINAL_RESISTANCE = PARAMETER_INDEX["longitudinal_resistance"]
LATERAL_RESISTANCE = PARAMETER_INDEX["lateral_resistance"]
CENTRE_OF_MASS_X = PARAMETER_INDEX["centre_of_mass_x"]
CENTRE_OF_MASS_Y = PARAMETER_INDEX["centre_of_mass_y"]
CENTRE_OF_MASS_Z = PARAMETER_INDEX["centre_of_mass_z"]
ROLL_INERTIA_RATIO = PARAMETER_INDEX["roll_inertia_ratio"]
PITCH_INERTIA_RATIO = PARAMETER_INDEX["pitch_inertia_ratio"]
GROUND_STIFFNESS_FACTOR = PARAMETER_INDEX["ground_stiffness_factor"]
ACTUATOR_GAIN_LEFT = PARAMETER_INDEX["actuator_gain_left"]
ACTUATOR_GAIN_RIGHT = PARAMETER_INDEX["actuator_gain_right"]


class Draws(NamedTuple):
    """What a law draws into, and from, for the chosen vehicles of a batch of N."""

    streams: NDArray[np.int64]  # (n,) addresses of the generators of the chosen vehicles
    chosen: NDArray[np.int64]  # (n,) rows of the arrays below
    nominal: NDArray[np.void]  # (1,) of RECORD
    profile: NDArray[np.float64]  # (S, N, W) references
    poses: NDArray[np.float64]  # (N, >= 5) x, y, yaw, cos, sin where they begin
    duration: float  # [s] of the episode
    truths: NDArray[np.void]  # (N,) of RECORD
    changes: NDArray[np.float64]  # (N, CHANGES_LIMIT, CHANGE_FIELDS)
    counts: NDArray[np.int64]  # (N,) changes of each
    read: NDArray[np.bool_]  # (PARAMETER_ROWS,) parameters whose changes are kept
    reliefs: NDArray[np.float64]  # (N, RELIEF_SIZE) drawn ground, see `terrain.drawn_relief`


class Path(NamedTuple):
    """The reference of one episode, inside a kernel."""

    profile: NDArray[np.float64]  # (S, W) of one vehicle, see `physics.reference_knots`
    pose: NDArray[np.float64]  # (>= 5,) x, y, yaw, cos, sin where it begins
    duration: float  # [s]


class Changes(NamedTuple):
    """The changes of one episode, inside a kernel."""

    rows: NDArray[np.float64]  # (CHANGES_LIMIT, CHANGE_FIELDS)
    used: NDArray[np.int64]  # (1,) how many
    read: NDArray[np.bool_]
    there: np.void  # of RECORD, the nominal one: room for parameters that are changed to
    relief: NDArray[np.float64]  # (RELIEF_SIZE,) level ground until a law writes into it


@formula
def _added(changes, kind, parameter, target):
    """A new row, or the last one, which is free, for a parameter that is not read."""
    row = changes.rows[changes.used[0]]
    fill_entries(row, 0.0)
    row[0], row[1], row[2] = kind, parameter, target
    if changes.read[parameter]:
        changes.used[0] += 1
    return row


@formula
def ramp(changes, parameter, target, start, duration):
    """A change in time; start, duration [s]."""
    row = _added(changes, events.RAMP, parameter, target)
    row[3], row[4] = start, duration


@formula
def given(changes, rows):
    """Changes that are always the same, rows (M, 8)."""
    for k in range(rows.shape[0]):
        row = _added(changes, rows[k, 0], np.int64(rows[k, 1]), rows[k, 2])
        copy_entries(rows[k, 3:8], row[3:])


@formula
def border(path, time):
    """(x, y, direction): where the reference is at `time` [s], and where it heads."""
    pose = path.pose
    if path.profile.shape[1] == UNIFORM_COLUMNS:
        x, y, _, _, yaw = advance(
            path.profile, 0.0, time, time, 0.0, 0.0, pose[3], pose[4], pose[2]
        )
        return x + pose[0], y + pose[1], yaw
    x, y, _, _, yaw = advance(
        path.profile, 0.0, time, time, pose[0], pose[1], pose[3], pose[4], pose[2]
    )
    return x, y, yaw


@formula
def line(changes, parameter, target, place, edge):
    """A change square to the path at `place`, see `border`; edge [m]."""
    row = _added(changes, events.LINE, parameter, target)
    row[3], row[4], row[8] = place
    row[5], row[6], row[7] = math.cos(row[8]), math.sin(row[8]), edge


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
        changes.relief[at] = amplitude
        changes.relief[at + 1], changes.relief[at + 2] = (
            k * math.cos(direction), k * math.sin(direction),
        )  # fmt: skip
        changes.relief[at + 3] = phase
        amplitude *= fall
        k *= ratio


@formula
def patch(changes, parameter, target, place, radius, edge):
    """A change inside a disc around place[:2] [m]; radius, edge [m]."""
    row = _added(changes, events.REGION, parameter, target)
    row[3], row[4], row[5], row[6] = place[0], place[1], radius, edge


@template
def draw_each(law, call):
    """Draw an episode of each chosen vehicle by `law`; call: the fields of Draws."""
    rngs, chosen, nominal, profile, poses = call[0], call[1], call[2], call[3], call[4]
    duration, truths, rows, counts, read = call[5], call[6], call[7], call[8], call[9]
    reliefs = call[10]
    there = np.empty(1, dtype=RECORD)
    for k in range(chosen.size):
        i = chosen[k]
        truths[i] = there[0] = nominal[0]
        counts[i] = 0
        fill_entries(reliefs[i], 0.0)
        path = Path(profile[:, i], poses[i], duration)
        changes = Changes(rows[i], counts[i : i + 1], read, there[0], reliefs[i])
        law(rngs[k], nominal[0], path, truths[i], changes)


def numbers(records: NDArray[np.void]) -> NDArray[np.float64]:
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
        both = profile.table[:, None]
        yaw = profile.yaw
        draws = Draws(
            streams.addresses([rng]),
            np.zeros(1, dtype=np.int64),
            np.array([tuple(nominal)], dtype=RECORD),
            both,
            np.array([[profile.x, profile.y, yaw, math.cos(yaw), math.sin(yaw)]]),
            float(duration),
            np.zeros(1, dtype=RECORD),
            np.zeros((1, CHANGES_LIMIT, CHANGE_FIELDS)),
            np.zeros(1, dtype=np.int64),
            np.ones(len(PARAMETER_NAMES), dtype=np.bool_),
            np.zeros((1, RELIEF_SIZE)),
        )
        self.fill(draws)
        events = [decode_event(row) for row in draws.changes[0, : draws.counts[0]].tolist()]
        relief = tuple(draws.reliefs[0].tolist()) if draws.reliefs.any() else ()
        return Draw(PlantParameters(*draws.truths[0].item()), events, relief)


class CompiledLaw(ArrayLaw):
    """A law of this package: a kernel, named as its uncertainty set."""

    def __init__(self, name: str, kernel: Callable[..., None], description: str) -> None:
        self.name, self._kernel, self.__doc__ = name, kernel, description

    def __reduce__(self) -> tuple[Any, ...]:
        from tracked_env.uncertainty import make_uncertainty

        return make_uncertainty, (self.name,)

    def fill(self, draws: Draws) -> None:
        """Draw an episode of each chosen vehicle."""
        self._kernel(*draws)


def laws(*entries: tuple[str, Callable[..., None], Any]) -> dict[str, ArrayLaw]:
    """Laws by name, from (name, its loop, its formula: the docstring describes it)."""
    return {name: CompiledLaw(name, kernel, law.__doc__) for name, kernel, law in entries}
