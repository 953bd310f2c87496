"""What is known after a control step, and how an agent is shown it.

An estimator answers with bare arrays; an `Estimate` is made of them when it is read. A policy
that needs two numbers of each answer does not pay for the rest.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.estimate import Estimate, Pair, Quantity
from baselines.estimators.observation_reader import Reading
from baselines.estimators.slip_observer import Motion
from tracked_env.physics.parameters import PlantParameters

ESTIMATORS = ("longitudinal", "turning", "slip", "soil")  # of every stack
Quantities = Mapping[str, tuple[Quantity, ...]]  # by estimator


def blocks(quantities: Quantities) -> list[tuple[str, ...]]:
    """Estimators whose features stand together: those of every stack, then one by one."""
    return [ESTIMATORS, *((name,) for name in quantities if name not in ESTIMATORS)]


def feature_names(quantities: Quantities) -> tuple[str, ...]:
    """Names of features: of each block estimates, their deviations, then excitations."""
    names: list[str] = []
    for block in blocks(quantities):
        own = [quantity.name for name in block for quantity in quantities[name]]
        names += [*own, *(f"{name}_deviation" for name in own)]
        names += [f"{name}_excitation" for name in block]
    return tuple(names)


class Estimates(Mapping[str, Estimate]):
    """Estimates by estimator, each made of its bare answer when it is first read."""

    def __init__(self) -> None:
        self.answers: dict[str, Any] = {}  # bare, or an Estimate
        self._make: dict[str, Callable[[Any], Estimate]] = {}
        self._made: dict[str, Estimate] = {}

    def add(self, name: str, answer: Any, make: Callable[[Any], Estimate]) -> None:
        """Take an answer; make(answer) is its Estimate."""
        self.answers[name] = answer
        self._make[name] = make

    def show(self, name: str, estimate: Estimate) -> None:
        """Show an Estimate in place of the one of the answer, which stays."""
        self._made[name] = estimate

    def add_made(self, name: str, estimate: Estimate) -> None:
        """Take an Estimate."""
        self.answers[name] = self._made[name] = estimate

    def __getitem__(self, name: str) -> Estimate:
        if name not in self._made:
            self._made[name] = self._make[name](self.answers[name])
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.answers)

    def __len__(self) -> int:
        return len(self.answers)


class Identification:
    """What is known after a control step of N vehicles.

    reading: the observation. motion_rows: columns of the filtered Motion, (N, 6). parts: Estimate
    by estimator. quantities: what each provides, in order: the four of ESTIMATORS, then further
    ones. traction_known (N,): the data determine what effort the soil carries.
    """

    def __init__(
        self,
        reading: Reading,
        motion_rows: NDArray[np.float64],
        parts: Estimates,
        quantities: Quantities,
        traction_known: NDArray[np.bool_],
    ) -> None:
        self.reading, self.motion_rows, self.parts = reading, motion_rows, parts
        self.quantities, self.traction_known = quantities, traction_known

    @cached_property
    def motion(self) -> Motion:
        """Filtered pose and velocities."""
        return Motion(*self.motion_rows.T)

    @property
    def longitudinal(self) -> Estimate:
        """1/m, mu_l."""
        return self.parts["longitudinal"]

    @property
    def turning(self) -> Estimate:
        """I, mu_t."""
        return self.parts["turning"]

    @property
    def slip(self) -> Estimate:
        """Pose, slips, side slip."""
        return self.parts["slip"]

    @property
    def soil(self) -> Estimate:
        """F_max, K."""
        return self.parts["soil"]

    @property
    def provided(self) -> dict[str, tuple[str, ...]]:
        """Names of the quantities that each estimator provides."""
        return {name: tuple(q.name for q in own) for name, own in self.quantities.items()}

    @property
    def mass(self) -> NDArray[np.float64]:
        """Mass [kg], (N,)."""
        return self.estimates()["mass"][0]

    @property
    def mass_deviation(self) -> NDArray[np.float64]:
        """Its standard deviation [kg], to first order, (N,)."""
        return self.estimates()["mass"][1]

    def estimates(self) -> dict[str, Pair]:
        """(value, standard deviation) by name, each (N,), SI."""
        return {
            quantity.name: quantity.read(self.parts[name])
            for name, own in self.quantities.items()
            for quantity in own
        }

    def excitation(self) -> dict[str, NDArray[np.float64]]:
        """Excitation [-] of each estimator, (N,)."""
        return {name: self.parts[name].excitation for name in self.quantities}

    def nis(self) -> dict[str, NDArray[np.float64]]:
        """Normalised innovation squared of each estimator, NaN without a sample, (N,)."""
        return {name: self.parts[name].nis for name in self.quantities}

    def status(self) -> dict[str, NDArray[np.int64]]:
        """Status of each estimator, (N,)."""
        return {name: self.parts[name].status for name in self.quantities}


def features(
    known: Identification, nominal: PlantParameters, further: bool = True
) -> NDArray[np.float32]:
    """Estimates, standard deviations and excitations as numbers of order one, (N, F) float32.

    Each estimator says how its quantities are shown: over the nominal value, as the logarithm of
    that, or as they are. Excitation e is shown as e / (1 + e). further: False shows the four of
    ESTIMATORS alone.
    """
    columns: list[NDArray[np.float64]] = []
    for block in blocks(known.quantities) if further else [ESTIMATORS]:
        shown = [
            quantity.normalized(known.parts[name], nominal)
            for name in block
            for quantity in known.quantities[name]
        ]
        columns += [value for value, _ in shown] + [deviation for _, deviation in shown]
        excitation = [known.parts[name].excitation for name in block]
        columns += [e / (1.0 + e) for e in excitation]
    out = np.empty((len(known.motion_rows), len(columns)), dtype=np.float32)
    for column, values in enumerate(columns):
        out[:, column] = values
    return out
