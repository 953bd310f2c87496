"""What is uncertain: named sets of vehicles, soils and in-episode changes, with every law.

A set draws the true parameters of one vehicle for one episode around the nominal ones of that
vehicle (`tracked_env.physics.parameters.VEHICLES`) and a schedule of changes that act inside the
episode. Notation of the laws: U(a, b) uniform; `=` replaces the nominal value, `*` multiplies it.
A controller that trusts the nominal parameters is right in the set `nominal` only. `soils` are the
sets of a heavy vehicle in the field, `floors` those of a light one indoors.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tracked_env.physics.parameters import PARAMETER_INDEX, ParametersRead, PlantParameters
from tracked_env.references import ReferenceProfile
from tracked_env.uncertainty import floors, soils
from tracked_env.uncertainty.law import Draw, Law
from tracked_env.uncertainty.soils import SOILS, STRAWA_MAPS
from tracked_env.validation import (
    checked_choice,
    checked_effect,
    checked_keys,
    checked_parameter,
)


def _nominal(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """The nominal vehicle on the nominal soil, no change."""
    return Draw(nominal, [])


UNCERTAINTY_SETS: dict[str, Law] = {"nominal": _nominal, **soils.LAWS, **floors.LAWS}


def _one_of(laws: Sequence[Law]) -> Law:
    """Each episode follows one of `laws`, all with the same odds."""

    def law(
        rng: np.random.Generator,
        nominal: PlantParameters,
        profile: ReferenceProfile,
        duration: float,
    ) -> Draw:
        return laws[int(rng.integers(len(laws)))](rng, nominal, profile, duration)

    return law


def make_uncertainty(
    spec: str | Mapping[str, Any] | Sequence[Any], reads: ParametersRead | None = None
) -> Law:
    """A set by name, or {parameter: [low, high]}: each drawn = U(low, high), no change.

    A list of those is a mixture: every episode draws one of them, all with the same odds.
    reads: what the plant reads, or None for any plant. A set by name may draw what the plant does
    not read; ranges of it are refused.

    Raises ValueError for an unknown set or parameter, for a value outside its range, and for a
    range of a parameter that the plant does not read.
    """
    if isinstance(spec, str):
        return UNCERTAINTY_SETS[checked_choice("uncertainty set", spec, UNCERTAINTY_SETS)]
    if isinstance(spec, (list, tuple)):
        if not spec:
            raise ValueError("uncertainty = []; a mixture needs at least one set")
        return _one_of([make_uncertainty(part, reads) for part in spec])
    if spec is None:
        raise ValueError(
            "uncertainty = None; must be a set by name, a dict or a list of them. "
            "Did you mean 'nominal', where nothing is uncertain?"
        )
    ranges: dict[str, tuple[float, float]] = {}
    for name, bounds in checked_keys("uncertainty", spec, PARAMETER_INDEX).items():
        if not isinstance(bounds, (list, tuple)) or len(bounds) != 2:
            raise ValueError(f"uncertainty of {name} = {bounds!r}; must be [low, high]")
        low, high = (checked_parameter(name, bound) for bound in bounds)
        if low > high:
            raise ValueError(f"uncertainty of {name} = [{low}, {high}]; low must be <= high")
        if reads is not None:
            checked_effect("uncertainty of", name, bounds, reads)
        ranges[name] = (low, high)

    def law(
        rng: np.random.Generator,
        nominal: PlantParameters,
        profile: ReferenceProfile,
        duration: float,
    ) -> Draw:
        drawn = {name: rng.uniform(*bounds) for name, bounds in ranges.items()}
        return Draw(nominal._replace(**drawn), [])

    return law


__all__ = ["SOILS", "STRAWA_MAPS", "UNCERTAINTY_SETS", "Draw", "Law", "make_uncertainty"]
