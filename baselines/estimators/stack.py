"""All estimators together: from observations to the parameters of vehicle and soil.

    observation -> reader -> measurement -> slip observer (UKF)        pose, velocities, slips
                                         -> steady side slip           1/m         (with m mu_t)
                         -> longitudinal least squares 1/m, mu_l
                                         -> turning least squares      I, mu_t     (with m, mu_l)
                                         -> soil estimator (GNR)       F_max, K    (with the slips)
                                         -> actuators (gains, lag), and those that are
                                            registered, where they are asked for
The regressions get the filtered velocities: they need no more of them than signs. Names and
features follow from what each estimator declares (`measurement.Estimator`); those of a registered
one come after all others, so that the columns of an agent trained without it stay where they are.

An estimator answers with bare arrays; an `Estimate` is made of them when it is read. A policy that
needs two numbers of each answer does not pay for the rest.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators.actuators import COMMANDS, ActuatorEstimator
from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import (
    BatchEstimator,
    DataSheet,
    Estimate,
    Estimator,
    Measurement,
    Pair,
    Quantity,
    Setting,
    Status,
    WiderMeasurement,
    arrays_of,
)
from baselines.estimators.motion_filter import (
    MotionFilter,
    check_finite,
    put_velocity,
    restore_arrays,
)
from baselines.estimators.observation_reader import NEEDS, Reading
from baselines.estimators.sideslip import SideslipRow
from baselines.estimators.slip_observer import Motion, SlipObserver
from baselines.estimators.soil_estimator import SoilEstimator
from baselines.estimators.turning import TurningEstimator
from tracked_env import observation as layout
from tracked_env.physics.parameters import PlantParameters, plant_parameters
from tracked_env.sensors import CHANNELS

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
        self._estimates: dict[str, Estimate] = {}

    def add(self, name: str, answer: Any, make: Callable[[Any], Estimate]) -> None:
        """Take an answer; make(answer) is its Estimate."""
        self.answers[name] = answer
        self._make[name] = make

    def show(self, name: str, estimate: Estimate) -> None:
        """Show an Estimate in place of the one of the answer, which stays."""
        self._estimates[name] = estimate

    def add_made(self, name: str, estimate: Estimate) -> None:
        """Take an Estimate."""
        self.answers[name] = self._estimates[name] = estimate

    def __getitem__(self, name: str) -> Estimate:
        if name not in self._estimates:
            self._estimates[name] = self._make[name](self.answers[name])
        return self._estimates[name]

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


Memories = tuple[NDArray[np.float64], ...]
Factory = Callable[[Setting], Estimator]

_OWN: dict[str, Any] = {
    "longitudinal": LongitudinalEstimator, "turning": TurningEstimator, "slip": SlipObserver,
    "soil": SoilEstimator,
}  # fmt: skip
QUANTITIES = tuple(quantity.name for part in _OWN.values() for quantity in part.provides)
FEATURES = feature_names({name: part.provides for name, part in _OWN.items()})
REGISTERED: dict[str, Factory] = {  # further estimators, by name
    "actuators": ActuatorEstimator.for_stack
}


def register(name: str, factory: Factory) -> None:
    """Add an estimator, from then on a name for `IdentificationStack(further=[...])`.

    factory(setting) makes one. Raises ValueError for a name that is taken.
    """
    if name in _OWN or name in REGISTERED:
        raise ValueError(f"estimator {name!r} is registered already")
    REGISTERED[name] = factory


class IdentificationStack:
    """The estimators of N vehicles, fed with observations.

    parameters: nominal ones; the start of every estimate. control_period [s]: between two
    observations. data_sheet: noise of the sensors (default: `rtk`). lateral: lateral model of the
    nominal model. slip: "batched" or "filterpy", the same filter, slower, one vehicle after the
    other. further: registered estimators that run after the others, in this order. attitude: True
    where roll, pitch and rate of pitch are observed; else the ground counts as level.
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
        slip: Literal["batched", "filterpy"] = "batched",
        further: Sequence[str] = (),
        attitude: bool = False,
    ) -> None:
        if slip not in ("batched", "filterpy"):
            raise ValueError(f"slip = {slip!r}; must be 'batched' or 'filterpy'")
        p = plant_parameters() if parameters is None else parameters
        sheet = DataSheet() if data_sheet is None else data_sheet
        self.parameters, self.data_sheet = p, sheet
        self.control_period, self.lateral = float(control_period), lateral
        observer = SlipObserver
        if slip == "filterpy":
            from baselines.estimators.slip_filterpy import FilterpySlipObserver

            observer = FilterpySlipObserver
        self._filter = MotionFilter(p, control_period, sheet, count, lateral, attitude, observer)
        self.reader, self.slip = self._filter.reader, self._filter.slip
        setting = Setting(p, self.control_period, sheet, int(count), lateral, bool(attitude))
        self.longitudinal = self.longitudinal_kind.for_stack(setting)
        self.turning = self.turning_kind.for_stack(setting)
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
        sliding = self.uses_sideslip and lateral == "sliding"
        self._sideslip = SideslipRow(setting) if sliding else None
        # The filter comes first: its velocities are what the regressions see.
        self._after = [(name, part) for name, part in self.parts.items() if name != "slip"]
        self._of_commands = {
            name for name, part in self._after if part.paired and set(part.needs) & set(COMMANDS)
        }
        # Fields besides sensors that are needed: commands, and registered ones, behind those of v0.
        self._added: list[str] = []
        self._check_needs(("slip", *(name for name, _ in self._after)))
        self.quantities = {name: part.provides for name, part in self.parts.items()}
        self._features = feature_names(self.quantities)
        scales = {f.name: f.scale for group in layout.GROUPS.values() for f in group.fields}
        behind = [name for name in self._added if name not in layout.INDEX]
        places = {**layout.INDEX, **{name: layout.SIZE + k for k, name in enumerate(behind)}}
        self._from = [(name, places[name], scales[name]) for name in self._added]
        self._shape = (self.reader.memory.shape[0], layout.SIZE + len(behind))
        self._none = np.zeros(self._shape[0], dtype=bool)
        apart = () if self._sideslip is None else (self._sideslip,)
        self._parts_with_state: tuple[Any, ...] = (self.reader, *self.parts.values(), *apart)

    def _check_needs(self, order: Sequence[str]) -> None:
        """Raise ValueError unless all that an estimator needs is there when it runs."""
        shown = {field.name for group in layout.GROUPS.values() for field in group.fields}
        registered = shown - set(layout.NAMES)
        beside = registered | set(COMMANDS)
        available = set(CHANNELS) | beside
        for name in order:
            part = self.parts[name]
            own = {quantity.name for quantity in part.provides}
            if lacking := sorted(set(part.needs) - available):
                raise ValueError(
                    f"estimator {name!r} needs {lacking}; that is no sensor channel, no command, "
                    "no registered field of the observation, and no estimator before it provides "
                    f"it. Given are {sorted(available)}"
                )
            self._added += [need for need in part.needs if need in beside - {*self._added}]
            if twice := sorted(own & available):
                raise ValueError(f"estimator {name!r} provides {twice}, which is known already")
            available |= own

    @property
    def needs(self) -> tuple[str, ...]:
        """Fields of the observation that are read; registered ones come last."""
        return (*NEEDS, *self._added)

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

    def _arrays(self) -> list[NDArray[np.float64]]:
        """The whole state."""
        return [array for part in self._parts_with_state for array in arrays_of(part)]

    def memories(self) -> Memories:
        """A copy of the whole state; `restore` puts it back."""
        return tuple(array.copy() for array in self._arrays())

    def restore(self, memories: Memories, rows: NDArray[np.bool_] | None = None) -> None:
        """Go on from what `memories` returned, in the rows marked (N,) or in all.

        Raises ValueError for the state of another stack.
        """
        restore_arrays(self._arrays(), memories, rows)

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        for part in self._parts_with_state:
            part.reset(rows)

    def update(
        self, observation: NDArray[np.float32], start: NDArray[np.bool_] | None = None
    ) -> Identification:
        """Take one observation of every vehicle; rows with `start` begin anew.

        observation: (N, SIZE), then a column for each registered field of `needs`, as
        `observation.View` gives it. NaN of a sensor is skipped. Raises ValueError for a wrong
        shape, and for a reference, action or age that is not finite; the state is then unchanged.
        """
        start = self._none if start is None else start
        if self._check(observation, start):
            self.reset(start)
        reading, moment = self._filter.read(observation, start)
        latest, paired, present = self._widened(
            observation, moment.samples, moment.paired, reading.paired
        )
        if self._sideslip is not None:
            self._sideslip.compute(latest, self.longitudinal, self.turning)
        motion, answer = self._filter.filter(latest, paired, moment)
        estimates = Estimates()
        estimates.add("slip", answer, self.slip.estimate)
        if self.reader.lag > 0:
            put_velocity(motion, present.values)
            values = reading.latest.values
            estimates.show("slip", self._filter.estimate_now(answer, motion, moment, values))
        for name, part in self._after:
            part.take_over(self.parts, estimates)
            measurement = paired if part.paired else latest
            if name in self._of_commands:  # they are those of now
                measurement = present
            if isinstance(part, BatchEstimator):
                estimates.add(name, part.compute(measurement), part.estimate)
            else:
                estimates.add_made(name, part.update(measurement))
        soil = estimates.answers["soil"][0]
        # In an outage the filter itself allows for a soil that changes.
        friction = estimates.answers["turning"]["value_2"].copy()
        self.slip.take_ground(soil, self.soil.fitted, friction)
        determined = self.soil.limit_determined
        return Identification(reading, motion, estimates, self.quantities, determined)

    def compile_kernels(self) -> None:
        """Compile what `update` calls, the last estimators first; the state is then meaningless.

        A process that does this beside one that drives meets it half way.
        """
        nothing = np.zeros(self._shape, dtype=np.float32)
        reading = self.reader.take(nothing)
        latest, paired = self._widened(nothing, reading.latest, reading.paired)
        for _, part in reversed(self._after):
            measurement = paired if part.paired else latest
            compute = part.compute if isinstance(part, BatchEstimator) else part.update
            compute(measurement)

    def _widened(
        self, observation: NDArray[np.float32], *measurements: Measurement
    ) -> list[Measurement]:
        """The measurements with the fields besides sensors, (N,) SI by name, if there are any."""
        if not self._added:
            return list(measurements)
        added = {
            name: observation[:, column].astype(np.float64) * scale
            for name, column, scale in self._from
        }
        return [WiderMeasurement.of(measurement, added) for measurement in measurements]

    def _check(self, observation: NDArray[np.float32], start: NDArray[np.bool_]) -> bool:
        """Whether any row starts. Raises ValueError for what `update` cannot take."""
        if observation.shape != self._shape:
            last = [name for name in self._added if name not in layout.INDEX]
            behind = f" (the last for {', '.join(last)})" if last else ""
            raise ValueError(
                f"observation has shape {observation.shape}; must be {self._shape}{behind}. "
                "Is the stack made for another count?"
            )
        return check_finite(observation, start)


__all__ = [
    "ESTIMATORS", "FEATURES", "QUANTITIES", "Identification", "IdentificationStack", "Memories",
    "Status", "features", "register",
]  # fmt: skip
