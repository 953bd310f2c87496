"""All estimators together: from observations to what is known of vehicle and soil.

    observation -> reader -> measurement -> slip observer (UKF)        pose, velocities, slips
                                         -> longitudinal least squares 1/m, mu_l
                                         -> turning least squares      I, mu_t     (with m, mu_l)
                                         -> soil estimator (GNR)       F_max, K    (with the slips)
                                         -> those that are registered, where they are asked for
The regressions get the filtered velocities: they need no more of them than signs. Names and
features follow from what each estimator declares (`estimate.Estimator`); those of a registered one
come after all others, so that the columns of an agent trained without it stay where they are.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators import stack_links as links
from baselines.estimators.estimate import Estimate, Estimator, Pair, Quantity, Setting, Status
from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.observation_reader import NEEDS, ObservationReader, Reading
from baselines.estimators.sensor_samples import COLUMN, DataSheet
from baselines.estimators.slip_observer import Motion, SlipObserver
from baselines.estimators.soil_estimator import SoilEstimator
from baselines.estimators.turning import TurningEstimator
from tracked_env import observation as layout
from tracked_env.physics.channels import CHANNELS
from tracked_env.physics.parameters import PlantParameters, plant_parameters

_V_X, _V_Y = COLUMN["v_x"], COLUMN["v_y"]

Memories = tuple[NDArray[np.float64], ...]
Factory = Callable[[Setting], Estimator]

_OWN: dict[str, Any] = {
    "longitudinal": LongitudinalEstimator, "turning": TurningEstimator, "slip": SlipObserver,
    "soil": SoilEstimator,
}  # fmt: skip
ESTIMATORS = tuple(_OWN)
QUANTITIES = tuple(quantity.name for part in _OWN.values() for quantity in part.provides)
REGISTERED: dict[str, Factory] = {}  # further estimators, by name


def register(name: str, factory: Factory) -> None:
    """Add an estimator, from then on a name for `IdentificationStack(further=[...])`.

    factory(setting) makes one. Raises ValueError for a name that is taken.
    """
    if name in _OWN or name in REGISTERED:
        raise ValueError(f"estimator {name!r} is registered already")
    REGISTERED[name] = factory


def _blocks(further: Sequence[str]) -> list[tuple[str, ...]]:
    """Estimators whose features stand together: those of every stack, then one by one."""
    return [ESTIMATORS, *((name,) for name in further)]


def _names(quantities: Mapping[str, tuple[Quantity, ...]]) -> tuple[str, ...]:
    """Names of features: of each block estimates, their deviations, then excitations."""
    names: list[str] = []
    for block in _blocks([name for name in quantities if name not in _OWN]):
        own = [quantity.name for name in block for quantity in quantities[name]]
        names += [*own, *(f"{name}_deviation" for name in own)]
        names += [f"{name}_excitation" for name in block]
    return tuple(names)


FEATURES = _names({name: part.provides for name, part in _OWN.items()})


class Identification(NamedTuple):
    """What is known after a control step."""

    reading: Reading
    motion: Motion  # filtered
    parts: Mapping[str, Estimate]  # by estimator
    # That each provides, in order: the four of ESTIMATORS, then further ones.
    quantities: Mapping[str, tuple[Quantity, ...]]
    traction_known: NDArray[np.bool_]  # (N,) the data determine what effort the soil carries

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


class IdentificationStack:
    """The estimators of N vehicles, fed with observations.

    parameters: nominal ones; the start of every estimate. control_period [s]: between two
    observations. data_sheet: noise of the sensors (default: `rtk`). lateral: lateral model of the
    nominal model. regression: "coupled" (default), "paper" or "printed" least squares, see
    two_parameters. slip: "batched" or "filterpy", the same filter, slower, one vehicle after the
    other. further: registered estimators that run after the others, in this order.
    Raises ValueError for arguments that make no sense, and for an estimator that needs what
    neither a sensor nor an estimator before it gives.
    """

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        count: int = 1,
        lateral: str = "sliding",
        regression: str = "coupled",
        slip: Literal["batched", "filterpy"] = "batched",
        further: Sequence[str] = (),
    ) -> None:
        if slip not in ("batched", "filterpy"):
            raise ValueError(f"slip = {slip!r}; must be 'batched' or 'filterpy'")
        p = plant_parameters() if parameters is None else parameters
        sheet = DataSheet() if data_sheet is None else data_sheet
        self.parameters, self.data_sheet = p, sheet
        self.control_period, self.lateral = float(control_period), lateral
        self.reader = ObservationReader(control_period, count)
        setting = Setting(p, self.control_period, sheet, int(count), lateral, regression)
        slip_observer = SlipObserver
        if slip == "filterpy":
            from baselines.estimators.slip_filterpy import FilterpySlipObserver

            slip_observer = FilterpySlipObserver
        self.longitudinal = LongitudinalEstimator.for_stack(setting)
        self.turning = TurningEstimator.for_stack(setting)
        self.slip = slip_observer.for_stack(setting)
        self.soil = SoilEstimator.for_stack(setting)
        own: tuple[Estimator, ...] = (self.longitudinal, self.turning, self.slip, self.soil)
        self.parts: dict[str, Estimator] = dict(zip(ESTIMATORS, own, strict=True))
        for name in further:
            if name not in REGISTERED or name in self.parts:
                raise ValueError(
                    f"estimator {name!r} is not registered, or named twice; registered are "
                    f"{sorted(REGISTERED)}"
                )
            self.parts[name] = REGISTERED[name](setting)
        # The filter comes first: its velocities are what the regressions see.
        self._after = [(name, part) for name, part in self.parts.items() if name != "slip"]
        self._check_needs(("slip", *(name for name, _ in self._after)))
        self.quantities = {name: part.provides for name, part in self.parts.items()}
        self._features = _names(self.quantities)
        self._remembering: tuple[Any, ...] = (self.reader, *self.parts.values())

    def _check_needs(self, order: Sequence[str]) -> None:
        """Raise ValueError unless all that an estimator needs is there when it runs."""
        given = set(CHANNELS)
        for name in order:
            part = self.parts[name]
            own = {quantity.name for quantity in part.provides}
            if lacking := sorted(set(part.needs) - given):
                raise ValueError(
                    f"estimator {name!r} needs {lacking}; that is no sensor channel, and no "
                    f"estimator before it provides it. Given are {sorted(given)}"
                )
            if twice := sorted(own & given):
                raise ValueError(f"estimator {name!r} provides {twice}, which is known already")
            given |= own

    @property
    def needs(self) -> tuple[str, ...]:
        """Fields of the observation that are read."""
        return NEEDS

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of what `observe` returns: estimates, their deviations, then excitations."""
        return self._features

    def observe(
        self, observation: NDArray[np.float32], start: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """`update`, and what is known then as features (N, F); see `features`."""
        return features(self.update(observation, start), self.parameters)

    @property
    def count(self) -> int:
        """Number of vehicles."""
        return len(self.reader.memory)

    def memories(self) -> Memories:
        """A copy of everything that is remembered; `restore` puts it back."""
        return tuple(part.memory.copy() for part in self._remembering)

    def restore(self, memories: Memories, rows: NDArray[np.bool_] | None = None) -> None:
        """Go on from what `memories` returned, in the rows marked (N,) or in all.

        Raises ValueError for the state of another stack.
        """
        for part, memory in zip(self._remembering, memories, strict=True):
            if len(memory) != self.count:
                raise ValueError(f"state of {len(memory)} vehicles; must be of {self.count}")
            if memory.shape != part.memory.shape:
                raise ValueError(
                    f"state with {memory.shape[1]} columns; must have {part.memory.shape[1]}. "
                    "Is it of a stack with another control period?"
                )
        for part, memory in zip(self._remembering, memories, strict=True):
            where = slice(None) if rows is None else rows
            part.memory[where] = memory[where]

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        for part in self._remembering:
            part.reset(rows)

    def update(
        self, observation: NDArray[np.float32], start: NDArray[np.bool_] | None = None
    ) -> Identification:
        """Take one observation of every vehicle, (N, SIZE); rows with `start` begin anew.

        NaN of a sensor is skipped. Raises ValueError for a wrong shape, and for a reference,
        action or age that is not finite; then nothing has been remembered.
        """
        self._check(observation)
        if start is not None and start.any():
            self.reset(start)
        reading = self.reader.read(observation)
        latest, paired = reading.latest, reading.paired
        behind = np.empty(self.count)
        links.date(latest.age, reading.drive_delay, behind)
        estimates = {"slip": self.slip.update(latest)}
        motion = self.slip.motion()
        paired.values[:, _V_X], paired.values[:, _V_Y] = motion.v_x, motion.v_y
        for name, part in self._after:
            part.take_over(self.parts, estimates)
            estimates[name] = part.update(paired if part.paired else latest)
        _limit, traction_known = self.soil.effort_limit()
        links.advance(*motion, behind, paired.values)
        return Identification(reading, motion, estimates, self.quantities, traction_known)

    def _check(self, observation: NDArray[np.float32]) -> None:
        """Raise ValueError for what `update` cannot take."""
        if observation.shape != (self.count, layout.SIZE):
            raise ValueError(
                f"observation has shape {observation.shape}; must be ({self.count}, "
                f"{layout.SIZE}). Is the stack made for another count?"
            )
        row, column = links.first_bad(observation)
        if row >= 0:
            raise ValueError(
                f"observation[{row}]: {layout.NAMES[column]} = {observation[row, column]}; must be "
                "finite. Only sensors may be NaN. Did a wrapper divide by zero?"
            )


def features(known: Identification, nominal: PlantParameters) -> NDArray[np.float32]:
    """Estimates, standard deviations and excitations as numbers of order one, (N, F) float32.

    Each estimator says how its quantities are shown: over the nominal value, as the logarithm of
    that, or as they are. Excitation e is shown as e / (1 + e).
    """
    columns: list[NDArray[np.float64]] = []
    for block in _blocks([name for name in known.quantities if name not in _OWN]):
        shown = [
            quantity.normalized(known.parts[name], nominal)
            for name in block
            for quantity in known.quantities[name]
        ]
        columns += [value for value, _ in shown] + [deviation for _, deviation in shown]
        excitation = [known.parts[name].excitation for name in block]
        columns += [e / (1.0 + e) for e in excitation]
    return np.stack(columns, axis=-1).astype(np.float32)


__all__ = [
    "ESTIMATORS", "FEATURES", "QUANTITIES", "Identification", "IdentificationStack", "Memories",
    "Status", "features", "register",
]  # fmt: skip
