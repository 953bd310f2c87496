"""All estimators together: from observations to what is known of vehicle and soil.

    observation -> reader -> measurement -> slip observer (UKF)        pose, velocities, slips
                                         -> steady side slip           1/m         (with m mu_t)
                         -> longitudinal least squares 1/m, mu_l
                                         -> turning least squares      I, mu_t     (with m, mu_l)
                                         -> soil estimator (GNR)       F_max, K    (with the slips)
                                         -> actuators (gains, lag), and those that are
                                            registered, where they are asked for
The regressions get the filtered velocities: they need no more of them than signs. Names and
features follow from what each estimator declares (`estimate.Estimator`); those of a registered one
come after all others, so that the columns of an agent trained without it stay where they are.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators import late_pose
from baselines.estimators import stack_links as links
from baselines.estimators.actuators import COMMANDS, ActuatorEstimator
from baselines.estimators.estimate import AnsweringEstimator, Estimator, Setting, Status
from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.observation_reader import NEEDS, ObservationReader
from baselines.estimators.sensor_samples import DataSheet, WiderMeasurement, attitude_of
from baselines.estimators.sideslip import SideslipRow
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.soil_estimator import SoilEstimator
from baselines.estimators.stack_identification import (
    ESTIMATORS,
    Estimates,
    Identification,
    feature_names,
    features,
)
from baselines.estimators.turning import TurningEstimator
from tracked_env import observation as layout
from tracked_env.physics.channels import CHANNELS
from tracked_env.physics.parameters import PlantParameters, plant_parameters

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
    nominal model. regression: "coupled" (default), "paper" or "printed" least squares, see
    two_parameters. slip: "batched" or "filterpy", the same filter, slower, one vehicle after the
    other. further: registered estimators that run after the others, in this order. attitude: True
    where roll, pitch and rate of pitch are observed; else the ground counts as level.
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
        attitude: bool = False,
    ) -> None:
        if slip not in ("batched", "filterpy"):
            raise ValueError(f"slip = {slip!r}; must be 'batched' or 'filterpy'")
        p = plant_parameters() if parameters is None else parameters
        sheet = DataSheet() if data_sheet is None else data_sheet
        self.parameters, self.data_sheet = p, sheet
        self.control_period, self.lateral = float(control_period), lateral
        self.reader = ObservationReader(control_period, count, sheet.pose_delay)
        setting = Setting(
            p, self.control_period, sheet, int(count), lateral, regression, bool(attitude)
        )  # fmt: skip
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
        own_law = regression == "coupled" and lateral == "sliding"
        self._sideslip = SideslipRow(setting) if own_law else None
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
        self._behind = np.empty(self._shape[0])
        apart = () if self._sideslip is None else (self._sideslip,)
        self._remembering: tuple[Any, ...] = (self.reader, *self.parts.values(), *apart)

    def _check_needs(self, order: Sequence[str]) -> None:
        """Raise ValueError unless all that an estimator needs is there when it runs."""
        shown = {field.name for group in layout.GROUPS.values() for field in group.fields}
        registered = shown - set(layout.NAMES)
        beside = registered | set(COMMANDS)
        given = set(CHANNELS) | beside
        for name in order:
            part = self.parts[name]
            own = {quantity.name for quantity in part.provides}
            if lacking := sorted(set(part.needs) - given):
                raise ValueError(
                    f"estimator {name!r} needs {lacking}; that is no sensor channel, no command, "
                    "no registered field of the observation, and no estimator before it provides "
                    f"it. Given are {sorted(given)}"
                )
            self._added += [need for need in part.needs if need in beside - {*self._added}]
            if twice := sorted(own & given):
                raise ValueError(f"estimator {name!r} provides {twice}, which is known already")
            given |= own

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
        """Take one observation of every vehicle; rows with `start` begin anew.

        observation: (N, SIZE), then a column for each registered field of `needs`, as
        `observation.View` gives it. NaN of a sensor is skipped. Raises ValueError for a wrong
        shape, and for a reference, action or age that is not finite; then nothing has been
        remembered.
        """
        start = self._none if start is None else start
        if self._check(observation, start):
            self.reset(start)
        reading = self.reader.take(observation, start)
        moment = late_pose.moment_of(self.reader, reading)
        latest, paired, present = moment.samples, moment.paired, reading.paired
        if self._added:
            added = self._samples(observation)
            latest, paired, present = (
                WiderMeasurement.of(one, added) for one in (latest, paired, present)
            )
        if self._sideslip is not None:
            self._sideslip.compute(latest, self.longitudinal, self.turning)
        links.date(latest.age, moment.drive_delay, self._behind)
        estimates = Estimates()
        answer = late_pose.filtered(self.slip, latest, moment.held)
        estimates.add("slip", answer, self.slip.estimate)
        motion = self.slip.motion_rows()
        links.put_velocity(motion, paired.values)
        links.advance(motion, self._behind, paired.values, attitude_of(latest))
        late_pose.to_present(motion, self.reader, self.slip, moment, attitude_of(latest))
        if self.reader.lag > 0:
            links.put_velocity(motion, present.values)
            now = late_pose.estimate_now(
                self.slip, answer, motion, reading.latest.values, moment.steps
            )  # fmt: skip
            estimates.show("slip", now)
        for name, part in self._after:
            part.take_over(self.parts, estimates)
            measurement = paired if part.paired else latest
            if name in self._of_commands:  # they are those of now
                measurement = present
            if isinstance(part, AnsweringEstimator):
                estimates.add(name, part.compute(measurement), part.estimate)
            else:
                estimates.add_made(name, part.update(measurement))
        soil = estimates.answers["soil"][0]
        # In an outage the filter itself allows for a soil that changes.
        self.slip.take_ground(soil, self.soil.fitted, estimates.answers["turning"][:, 1].copy())
        return Identification(reading, motion, estimates, self.quantities, self.soil.limit_known)

    def compile_kernels(self) -> None:
        """Compile what `update` calls, the last estimators first; what is known then is no matter.

        A process that does this beside one that drives meets it half way.
        """
        nothing = np.zeros(self._shape, dtype=np.float32)
        reading = self.reader.take(nothing, ~self._none)
        latest, paired = reading.latest, reading.paired
        if self._added:
            added = self._samples(nothing)
            latest, paired = (WiderMeasurement.of(one, added) for one in (latest, paired))
        for _, part in reversed(self._after):
            measurement = paired if part.paired else latest
            compute = part.compute if isinstance(part, AnsweringEstimator) else part.update
            compute(measurement)

    def _samples(self, observation: NDArray[np.float32]) -> Mapping[str, NDArray[np.float64]]:
        """The fields besides sensors by name, (N,) SI."""
        return {
            name: observation[:, column].astype(np.float64) * scale
            for name, column, scale in self._from
        }

    def _check(self, observation: NDArray[np.float32], start: NDArray[np.bool_]) -> bool:
        """Whether any row starts. Raises ValueError for what `update` cannot take."""
        if observation.shape != self._shape:
            last = [name for name in self._added if name not in layout.INDEX]
            behind = f" (the last for {', '.join(last)})" if last else ""
            raise ValueError(
                f"observation has shape {observation.shape}; must be {self._shape}{behind}. "
                "Is the stack made for another count?"
            )
        row, column, starts = links.inspect(observation, start)
        if row >= 0:
            raise ValueError(
                f"observation[{row}]: {layout.NAMES[column]} = {observation[row, column]}; must be "
                "finite. Only sensors may be NaN. Did a wrapper divide by zero?"
            )
        return bool(starts)


__all__ = [
    "ESTIMATORS", "FEATURES", "QUANTITIES", "Identification", "IdentificationStack", "Memories",
    "Status", "features", "register",
]  # fmt: skip
