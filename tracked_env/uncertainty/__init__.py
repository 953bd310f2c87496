"""What is uncertain: named sets of vehicles, soils and in-episode changes, with every law.

A set draws the true parameters of one vehicle for one episode around the nominal ones of that
vehicle (`tracked_env.physics.parameters.VEHICLES`) and a schedule of changes that act inside the
episode. Notation of the laws: U(a, b) uniform; `=` replaces the nominal value, `*` multiplies it.
`soils` are the sets of a heavy vehicle in the field, `laws` those of late and weak drives, of a
light vehicle on floors, and of one on slopes; `register` adds one.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PARAMETER_INDEX, RANGES, ParametersRead
from tracked_env.streams import integer, uniform
from tracked_env.uncertainty import drawing_laws, laws  # noqa: F401  they enter UNCERTAINTY_SETS
from tracked_env.uncertainty.drawing_laws import (
    UNCERTAINTY_SETS,
    ArrayLaw,
    CheckedLaw,
    Draw,
    Law,
    known_laws,
)
from tracked_env.uncertainty.soils import SOILS, STRAWA_MAPS
from tracked_env.validation import checked_choice, checked_effect, checked_interval, checked_keys

# What `uncertainty=` takes: a name, ranges, a list of these, or a law.
Spec = str | Mapping[str, Any] | Sequence[Any] | Callable[..., Draw]
DESCRIPTIONS: dict[str, str] = {}  # of the sets that were registered
fingerprint = drawing_laws.fingerprint


def register(name: str, law: Law, description: str = "") -> None:
    """Add a set, from then on a name for `uncertainty=` and for the sets of the benchmark.

    Raises ValueError for a name that is taken, and for a law with another signature.
    """
    if name in known_laws() or not name.isprintable() or not name:
        raise ValueError(f"uncertainty set {name!r} is taken, or no name")
    UNCERTAINTY_SETS[name] = law if isinstance(law, CheckedLaw) else CheckedLaw(law)
    DESCRIPTIONS[name] = description or (law.__doc__ or "").partition("\n")[0]


@dataclass(frozen=True)
class _Mixture:
    """Each episode follows one of `laws`, all with the same odds."""

    laws: tuple[Law, ...]

    def __call__(self, rng: np.random.Generator, *others: Any) -> Draw:
        return self.laws[int(rng.integers(len(self.laws)))](rng, *others)


@loop
def _choose(rngs, choices):
    for k in range(rngs.size):
        choices[k] = integer(rngs[k], choices[k])


@dataclass(frozen=True)
class _ArrayMixture(ArrayLaw):
    """The same of laws that draw batches."""

    laws: tuple[ArrayLaw, ...]

    def fill(self, draws: drawing_laws.Draws) -> None:
        choices = np.full(draws.vehicles.size, len(self.laws))
        _choose(draws.streams, choices)
        for number in np.unique(choices):
            mask = choices == number
            part = draws._replace(streams=draws.streams[mask], vehicles=draws.vehicles[mask])
            self.laws[number].fill(part)


@loop
def _draw_ranges(rngs, vehicles, truths, columns, lows, highs):
    for k in range(vehicles.size):
        for j in range(columns.size):
            truths[vehicles[k], columns[j]] = uniform(rngs[k], lows[j], highs[j])


@dataclass(frozen=True)
class _Ranges(ArrayLaw):
    """Each parameter of `bounds` is drawn = U(low, high), no change."""

    bounds: dict[str, tuple[float, float]]

    def fill(self, draws: drawing_laws.Draws) -> None:
        columns = np.array([PARAMETER_INDEX[name] for name in self.bounds], dtype=np.int64)
        lows, highs = np.array(list(self.bounds.values()), dtype=np.float64).reshape(-1, 2).T.copy()
        nominal: Any = UNCERTAINTY_SETS["nominal"]
        nominal.fill(draws)
        truths = drawing_laws.numbers(draws.truths)
        _draw_ranges(draws.streams, draws.vehicles, truths, columns, lows, highs)


def draws_vehicles(law: Law) -> bool:
    """Whether a law draws the nominal vehicle of each episode."""
    return getattr(law, "vehicles", None) is not None


def make_uncertainty(spec: Spec, reads: ParametersRead | None = None) -> Law:
    """A set by name, or {parameter: [low, high]}: each drawn = U(low, high), no change.

    A list of those is a mixture: every episode draws one of them, all with the same odds. A
    function is a law of one's own; its draws are checked. reads: what the plant reads, or None for
    any plant. A law may draw what the plant does not read; ranges of it are refused.

    Raises ValueError for an unknown set or parameter, a value outside its range, a range of a
    parameter that the plant does not read, and a function that takes other arguments than a law.
    """
    if isinstance(spec, str):
        return known_laws(spec)[checked_choice("uncertainty set", spec, known_laws(spec))]
    if isinstance(spec, ArrayLaw):
        return spec
    if callable(spec):
        return spec if isinstance(spec, CheckedLaw) else CheckedLaw(spec)
    if isinstance(spec, (list, tuple)):
        if not spec:
            raise ValueError("uncertainty = []; a mixture needs at least one set")
        parts = tuple(make_uncertainty(part, reads) for part in spec)
        if any(draws_vehicles(part) for part in parts):
            raise ValueError(
                f'uncertainty = {spec!r:.100}; "any-vehicle" must stand alone: it draws the '
                "vehicle before the reference, when a mixture has not chosen yet. Did you mean "
                '"any-soil"?'
            )
        arrays = tuple(part for part in parts if isinstance(part, ArrayLaw))
        return _ArrayMixture(arrays) if len(arrays) == len(parts) else _Mixture(parts)
    if spec is None:
        raise ValueError(
            "uncertainty = None; must be a set by name, a dict, a function or a list of them. "
            "Did you mean 'nominal', where nothing is uncertain?"
        )
    ranges: dict[str, tuple[float, float]] = {}
    for name, bounds in checked_keys("uncertainty", spec, PARAMETER_INDEX).items():
        ranges[name] = checked_interval(f"uncertainty of {name}", bounds, RANGES[name])
        if reads is not None:
            checked_effect("uncertainty of", name, bounds, reads)
    return _Ranges(ranges)


__all__ = ["DESCRIPTIONS", "SOILS", "STRAWA_MAPS", "UNCERTAINTY_SETS", "ArrayLaw", "CheckedLaw"]
__all__ += [
    "Draw",
    "Law",
    "Spec",
    "draws_vehicles",
    "fingerprint",
    "known_laws",
    "make_uncertainty",
    "register",
]
