"""All estimators together: from observations to the parameters of vehicle and soil.

    observation -> reader -> measurement -> slip observer (UKF)        pose, velocities, slips
                                         -> steady side slip           1/m         (with m mu_t)
                         -> longitudinal least squares 1/m, mu_l
                                         -> turning least squares      I, mu_t     (with m, mu_l)
                                         -> soil estimator (GNR)       F_max, K    (with the slips)
                                         -> actuators (gains, lag), and those that are
                                            registered, where they are asked for
The regressions get the filtered velocities: they need no more of them than signs. So they take the
inertial and drive samples of now, also where poses are late and the filter waits for them. Names
and features follow from what each estimator declares (`measurement.BatchEstimator`). Those of a
registered one come last: the columns of an agent trained without it stay where they are.

An estimator answers with bare arrays; an `Estimate` is made of them when it is read. A policy that
needs two numbers of each answer does not pay for the rest.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.actuators import COMMANDS, ActuatorEstimator
from baselines.estimators.longitudinal import LongitudinalEstimator, SideslipRow
from baselines.estimators.measurement import (
    BatchEstimator,
    DataSheet,
    Estimate,
    Measurement,
    Pair,
    Quantity,
    Setting,
    Status,
)
from baselines.estimators.motion_filter import BODY_VELOCITY, Memories, MotionFilter
from baselines.estimators.observation_reader import Reading
from baselines.estimators.slip_observer import Motion, SlipObserver
from baselines.estimators.soil_estimator import SoilEstimator
from baselines.estimators.turning import TurningEstimator
from tracked_env import observation as layout
from tracked_env.physics.parameters import PlantParameters
from tracked_env.sensors import CHANNELS

_BASIC: dict[str, type[BatchEstimator]] = {
    "longitudinal": LongitudinalEstimator,
    "turning": TurningEstimator,
    "slip": SlipObserver,
    "soil": SoilEstimator,
}
ESTIMATORS = tuple(_BASIC)  # of every stack
Quantities = Mapping[str, tuple[Quantity, ...]]  # by estimator


def _blocks(quantities: Quantities) -> list[tuple[str, ...]]:
    """Estimators whose features stand together: those of every stack, then one by one."""
    return [ESTIMATORS, *((name,) for name in quantities if name not in ESTIMATORS)]


def feature_names(quantities: Quantities) -> tuple[str, ...]:
    """Names of features: of each block estimates, their deviations, then excitations."""
    names: list[str] = []
    for block in _blocks(quantities):
        values = [quantity.name for name in block for quantity in quantities[name]]
        names += [*values, *(f"{name}_deviation" for name in values)]
        names += [f"{name}_excitation" for name in block]
    return tuple(names)


QUANTITIES = tuple(quantity.name for part in _BASIC.values() for quantity in part.provides)
FEATURES = feature_names({name: part.provides for name, part in _BASIC.items()})


class Estimates(Mapping[str, Estimate]):
    """Estimates by estimator, each made of its bare answer when it is first read."""

    def __init__(self, parts: Mapping[str, Any]) -> None:
        self.answers: dict[str, Any] = {}  # bare, or an Estimate
        self.estimates: dict[str, Estimate] = {}  # made so far
        self._parts = parts

    def __getitem__(self, name: str) -> Estimate:
        if name not in self.estimates:
            answer = self.answers[name]
            is_made = isinstance(answer, Estimate)
            self.estimates[name] = answer if is_made else self._parts[name].estimate(answer)
        return self.estimates[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.answers)

    def __len__(self) -> int:
        return len(self.answers)


@dataclass
class Identification:
    """What is known after a control step of N vehicles."""

    reading: Reading  # the observation
    motion_rows: NDArray[np.float64]  # (N, 6) columns of the filtered Motion
    parts: Estimates  # by estimator
    quantities: Quantities  # what each provides: the four of ESTIMATORS, then further ones
    traction_determined: NDArray[np.bool_]  # (N,) the data determine what effort the soil carries

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
        return {name: tuple(q.name for q in each) for name, each in self.quantities.items()}

    def estimates(self) -> dict[str, Pair]:
        """(value, standard deviation) by name, each (N,), SI."""
        return {
            quantity.name: quantity.read(self.parts[name])
            for name, each in self.quantities.items()
            for quantity in each
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
    identification: Identification, nominal: PlantParameters, further: bool = True
) -> NDArray[np.float32]:
    """Estimates, standard deviations and excitations as numbers of order one, (N, F) float32.

    Each estimator says how its quantities are shown: over the nominal value, as the logarithm of
    that, or as they are. Excitation e is shown as e / (1 + e). further: False shows the four of
    ESTIMATORS alone.
    """
    columns: list[NDArray[np.float64]] = []
    for block in _blocks(identification.quantities) if further else [ESTIMATORS]:
        pairs = [
            quantity.normalized(identification.parts[name], nominal)
            for name in block
            for quantity in identification.quantities[name]
        ]
        columns += [value for value, _ in pairs] + [deviation for _, deviation in pairs]
        excitation = [identification.parts[name].excitation for name in block]
        columns += [e / (1.0 + e) for e in excitation]
    out = np.empty((len(identification.motion_rows), len(columns)), dtype=np.float32)
    for column, values in enumerate(columns):
        out[:, column] = values
    return out


Factory = Callable[[Setting], Any]
REGISTERED: dict[str, Factory] = {  # further estimators, by name
    "actuators": lambda setting: ActuatorEstimator(*setting)
}


def register(name: str, factory: Factory) -> None:
    """Add an estimator, from then on a name for `IdentificationStack(further=[...])`.

    factory(setting) makes one. Raises ValueError for a name that is taken.
    """
    if name in _BASIC or name in REGISTERED:
        raise ValueError(f"estimator {name!r} is registered already")
    REGISTERED[name] = factory


class IdentificationStack(MotionFilter):
    """The estimators of N vehicles, fed with observations; arguments as those of MotionFilter.

    further: registered estimators that run after the others, in this order.
    slip: "batched" or "filterpy", the same filter, slower, one vehicle after the other.
    Raises ValueError for arguments that make no sense, and for an estimator that needs what
    neither a sensor nor an estimator before it gives.
    """

    # Other regressions, and whether the equation of the side slip goes with them.
    longitudinal_kind: type[LongitudinalEstimator] = LongitudinalEstimator
    turning_kind: type[TurningEstimator] = TurningEstimator
    uses_sideslip = True

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        count: int = 1,
        lateral: str = "sliding",
        further: Sequence[str] = (),
        attitude: bool = False,
        slip: Literal["batched", "filterpy"] = "batched",
    ) -> None:
        if slip not in ("batched", "filterpy"):
            raise ValueError(f"slip = {slip!r}; must be 'batched' or 'filterpy'")
        if slip == "filterpy":  # imported where it is used: it loads matplotlib
            from baselines.estimators.slip_filterpy import FilterpySlipObserver

            self.slip_kind = FilterpySlipObserver
        super().__init__(parameters, control_period, data_sheet, count, lateral, attitude)
        setting = self.setting
        self.longitudinal = self.longitudinal_kind(*setting)
        self.turning = self.turning_kind(*setting)
        self.soil = SoilEstimator(*setting)
        basic = self.longitudinal, self.turning, self.slip, self.soil
        self.parts: dict[str, Any] = dict(zip(ESTIMATORS, basic, strict=True))
        for name in further:
            if name not in REGISTERED or name in self.parts:
                raise ValueError(
                    f"estimator {name!r} is not registered, or named twice; registered are "
                    f"{sorted(REGISTERED)}"
                )
            self.parts[name] = REGISTERED[name](setting)
        sliding = self.uses_sideslip and lateral == "sliding"
        self._sideslip = SideslipRow(setting) if sliding else None
        # The filter comes first: its velocities are what the regressions see.
        self._after = [(name, part) for name, part in self.parts.items() if name != "slip"]
        # Those that take samples of now: the regressions, and what compares with commands.
        self._of_now = {"longitudinal", "turning"} | {
            name for name, part in self._after if part.paired and set(part.needs) & set(COMMANDS)
        }
        self._use_fields(self._fields_needed(("slip", *(name for name, _ in self._after))))
        self.quantities = {name: part.provides for name, part in self.parts.items()}
        self._features = feature_names(self.quantities)
        apart = () if self._sideslip is None else (self._sideslip,)
        self._hold_state_of([self.reader, *self.parts.values(), *apart])

    def _fields_needed(self, order: Sequence[str]) -> list[str]:
        """Fields besides sensors that are needed: commands, and registered ones. Raises ValueError
        unless all that an estimator needs is there when it runs."""
        shown = {field.name for group in layout.GROUPS.values() for field in group.fields}
        beside = (shown - set(layout.NAMES)) | set(COMMANDS)
        available = set(CHANNELS) | beside
        fields: list[str] = []
        for name in order:
            part = self.parts[name]
            provided = {quantity.name for quantity in part.provides}
            if lacking := sorted(set(part.needs) - available):
                raise ValueError(
                    f"estimator {name!r} needs {lacking}; that is no sensor channel, no command, "
                    "no registered field of the observation, and no estimator before it provides "
                    f"it. Available are {sorted(available)}"
                )
            fields += [need for need in part.needs if need in beside - {*fields}]
            if twice := sorted(provided & available):
                raise ValueError(f"estimator {name!r} provides {twice}, which is known already")
            available |= provided
        return fields

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of what `observe` returns: estimates, their deviations, then excitations."""
        return self._features

    def observe(
        self, observation: NDArray[np.float32], start: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """`update`, and what is known then as features (N, F); see `features`."""
        return features(self.update(observation, start), self.parameters)

    def update(
        self, observation: NDArray[np.float32], start: NDArray[np.bool_] | None = None
    ) -> Identification:
        """Take one observation of every vehicle; rows with `start` begin anew.

        observation: as for MotionFilter. NaN of a sensor is skipped. Raises ValueError for a wrong
        shape, and for a reference, action or age that is not finite; the state is then unchanged.
        """
        reading, moment = self.read(observation, self._none if start is None else start)
        late = self.reader.lag > 0
        samples = (moment.samples, moment.paired, *((reading.paired,) if late else ()))
        latest, paired, *rest = self._with_fields(observation, *samples)
        present = rest[0] if late else paired
        if self._sideslip is not None:
            self._sideslip.compute(latest, self.longitudinal, self.turning)
        motion, answer = self.filter(latest, paired, moment)
        estimates = Estimates(self.parts)
        answers = estimates.answers
        answers["slip"] = answer
        if late:
            present.values[:, BODY_VELOCITY] = motion[:, 3:5]
            values = reading.latest.values
            estimates.estimates["slip"] = self.estimate_now(answer, motion, moment, values)
        for name, part in self._after:
            part.take_over(self.parts, estimates)
            pair = present if name in self._of_now else paired
            answers[name] = _run(part, pair if part.paired else latest)
        # In an outage the filter itself allows for a soil that changes.
        soil, friction = answers["soil"]["value"], answers["turning"]["value"][:, 1]
        self.slip.take_ground(soil, self.soil.fitted, friction)
        determined = self.soil.limit_determined
        return Identification(reading, motion, estimates, self.quantities, determined)

    def compile_kernels(self) -> None:
        """Compile what `update` calls, the last estimators first; the state is then meaningless.

        A process that does this beside one that drives meets it half way.
        """
        nothing = np.zeros(self._shape, dtype=np.float32)
        reading = self.reader.read(nothing)
        latest, paired = self._with_fields(nothing, reading.latest, reading.paired)
        for _, part in reversed(self._after):
            _run(part, paired if part.paired else latest)


def _run(part: Any, measurement: Measurement) -> Any:
    """The bare answer of an estimator, or its Estimate."""
    return (
        part.compute(measurement) if isinstance(part, BatchEstimator) else part.update(measurement)
    )


__all__ = [
    "ESTIMATORS", "FEATURES", "QUANTITIES", "Identification", "IdentificationStack", "Memories",
    "Status", "features", "register",
]  # fmt: skip
