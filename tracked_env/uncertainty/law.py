"""What a law of uncertainty is: it draws the truth of one episode around nominal parameters.

A law of one's own is any function of that signature. `checked` wraps it: what it draws is compared
with the physical ranges, so that a mistake in it is an error and not a strange episode.
"""

import hashlib
import inspect
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tracked_env.events import Event, encode_schedule
from tracked_env.physics.parameters import PARAMETER_NAMES, PlantParameters
from tracked_env.references import ReferenceProfile
from tracked_env.terrain.drawn_relief import checked_relief
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
        source = Path(inspect.getfile(kind)).read_bytes()
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
