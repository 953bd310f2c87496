"""All estimators together: from observations to what is known of vehicle and soil.

    observation -> reader -> measurement -> slip observer (UKF)        pose, velocities, slips
                                         -> longitudinal least squares 1/m, mu_l
                                         -> turning least squares      I, mu_t     (with m, mu_l)
                                         -> soil estimator (GNR)       F_max, K    (with the slips)
The regressions get the filtered velocities: they need no more of them than signs. When the mass
has jumped, the turning estimator lets its inertia go too: payload changes both.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.
"""

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators import least_squares as ls
from baselines.estimators import stack_links as links
from baselines.estimators.estimate import Estimate, Status
from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.observation_reader import ObservationReader, Reading
from baselines.estimators.sensor_samples import COLUMN, DataSheet
from baselines.estimators.slip_observer import Motion, SlipObserver
from baselines.estimators.soil_estimator import SoilEstimator
from baselines.estimators.turning import TurningEstimator
from tracked_env import observation as layout
from tracked_env.physics import vehicle
from tracked_env.physics.parameters import PlantParameters, plant_parameters

# The UKF's slip errors hang together over some samples: variance counts that much more.
SLIP_CORRELATION = 10.0  # [control steps]
_V_X, _V_Y = COLUMN["v_x"], COLUMN["v_y"]

Memories = tuple[NDArray[np.float64], ...]

# What is estimated, by name.
QUANTITIES = (
    "mass", "longitudinal_resistance", "inertia", "lateral_resistance",
    "slip_left", "slip_right", "side_slip", "effort_maximum", "shear_deformation_modulus",
)  # fmt: skip
ESTIMATORS = ("longitudinal", "turning", "slip", "soil")
FEATURES = (
    *QUANTITIES,
    *(f"{name}_deviation" for name in QUANTITIES),
    *(f"{name}_excitation" for name in ESTIMATORS),
)


class Identification(NamedTuple):
    """What is known after a control step."""

    reading: Reading
    motion: Motion  # filtered
    longitudinal: Estimate  # 1/m, mu_l
    turning: Estimate  # I, mu_t
    slip: Estimate  # pose, slips, side slip
    soil: Estimate  # F_max, K
    traction_known: NDArray[np.bool_]  # (N,) the data determine what effort the soil carries

    @property
    def mass(self) -> NDArray[np.float64]:
        """Mass [kg], (N,)."""
        return 1.0 / self.longitudinal.value[:, 0]

    @property
    def mass_deviation(self) -> NDArray[np.float64]:
        """Its standard deviation [kg], to first order, (N,)."""
        return np.sqrt(self.longitudinal.covariance[:, 0, 0]) * self.mass**2

    def estimates(self) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """(value, standard deviation) by name, each (N,), SI; names as in QUANTITIES."""
        known = {"mass": (self.mass, self.mass_deviation)}
        for estimate, names in (
            (self.longitudinal, {"longitudinal_resistance": "longitudinal_resistance"}),
            (self.turning, {"inertia": "inertia", "lateral_resistance": "lateral_resistance"}),
            (self.slip, {name: name for name in self.slip.names[3:]}),
            (self.soil, {name: name for name in self.soil.names}),
        ):
            for name, own in names.items():
                known[name] = (estimate.of(own), estimate.deviation(own))
        return {name: known[name] for name in QUANTITIES}

    def excitation(self) -> dict[str, NDArray[np.float64]]:
        """Excitation [-] of each of ESTIMATORS, (N,)."""
        return {name: getattr(self, name).excitation for name in ESTIMATORS}

    def nis(self) -> dict[str, NDArray[np.float64]]:
        """Normalised innovation squared of each of ESTIMATORS, NaN without a sample, (N,)."""
        return {name: getattr(self, name).nis for name in ESTIMATORS}

    def status(self) -> dict[str, NDArray[np.int64]]:
        """Status of each of ESTIMATORS, (N,)."""
        return {name: getattr(self, name).status for name in ESTIMATORS}


class IdentificationStack:
    """The estimators of N vehicles, fed with observations.

    parameters: nominal ones; the start of every estimate. control_period [s]: between two
    observations. data_sheet: noise of the sensors (default: `rtk`). lateral: closure of the
    nominal model. regression: "coupled" (default), "paper" or "printed" least squares, see
    two_parameters. slip: "batched" or "filterpy", the same filter, slower, one vehicle after the
    other.
    Raises ValueError for arguments that make no sense.
    """

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        count: int = 1,
        lateral: str = "sliding",
        regression: Literal["coupled", "paper", "printed"] = "coupled",
        slip: Literal["batched", "filterpy"] = "batched",
    ) -> None:
        if slip not in ("batched", "filterpy"):
            raise ValueError(f"slip = {slip!r}; must be 'batched' or 'filterpy'")
        p = plant_parameters() if parameters is None else parameters
        sheet = DataSheet() if data_sheet is None else data_sheet
        self.parameters, self.data_sheet = p, sheet
        self.control_period, self.lateral = float(control_period), lateral
        self.reader = ObservationReader(control_period, count)
        self.longitudinal = LongitudinalEstimator(p, control_period, sheet, count, regression)
        self.turning = TurningEstimator(p, control_period, sheet, count, lateral, regression)
        if slip == "filterpy":
            from baselines.estimators.slip_filterpy import FilterpySlipObserver

            self.slip: SlipObserver = FilterpySlipObserver(p, control_period, sheet, count)
        else:
            self.slip = SlipObserver(p, control_period, sheet, count)
        self.soil = SoilEstimator(
            p, control_period, sheet, count, correlation_steps=SLIP_CORRELATION
        )
        self._parts: tuple[Any, ...] = (
            self.reader,
            self.longitudinal,
            self.turning,
            self.slip,
            self.soil,
        )

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of what `observe` returns: estimates, their deviations, then excitations."""
        return FEATURES

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
        return tuple(part.memory.copy() for part in self._parts)

    def restore(self, memories: Memories, rows: NDArray[np.bool_] | None = None) -> None:
        """Go on from what `memories` returned, in the rows marked (N,) or in all.

        Raises ValueError for the state of another stack.
        """
        for part, memory in zip(self._parts, memories, strict=True):
            if len(memory) != self.count:
                raise ValueError(f"state of {len(memory)} vehicles; must be of {self.count}")
            if memory.shape != part.memory.shape:
                raise ValueError(
                    f"state with {memory.shape[1]} columns; must have {part.memory.shape[1]}. "
                    "Is it of a stack with another control period?"
                )
        for part, memory in zip(self._parts, memories, strict=True):
            where = slice(None) if rows is None else rows
            part.memory[where] = memory[where]

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        for part in self._parts:
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
        slip = self.slip.update(latest)
        motion = self.slip.motion()
        paired.values[:, _V_X], paired.values[:, _V_Y] = motion.v_x, motion.v_y
        jumps = self.longitudinal.memory[:, ls.JUMPS].copy()
        longitudinal = self.longitudinal.update(paired)
        turning, jumped = self.turning, np.empty(self.count, dtype=bool)
        if links.hand_on(
            self.longitudinal.memory, jumps, longitudinal.value, longitudinal.covariance,
            turning.mass, turning.mass_variance, turning.resistance, jumped,
        ):  # fmt: skip
            turning.release_inertia(jumped)
        self.soil.provide_slip(self.slip.slips, self.slip.slip_variances)
        soil = self.soil.update(latest)
        _limit, traction_known = self.soil.effort_limit()
        links.advance(*motion, behind, paired.values)
        return Identification(
            reading, motion, longitudinal, turning.update(paired), slip, soil, traction_known
        )

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

    Mass, inertia, K and F_max over their nominal values (F_max and K as logarithm of that);
    the others as they are. Excitation e is shown as e / (1 + e).
    """
    maximum = vehicle.drive_limits(nominal).effort_maximum
    scales = {
        "mass": nominal.mass, "inertia": nominal.inertia,
        "effort_maximum": maximum,
        "shear_deformation_modulus": nominal.shear_deformation_modulus,
    }  # fmt: skip
    logarithmic = ("effort_maximum", "shear_deformation_modulus")
    values, deviations = [], []
    for name, (value, deviation) in known.estimates().items():
        scale = scales.get(name, 1.0)
        if name in logarithmic:
            values.append(np.log(value / scale))
            deviations.append(deviation / value)
        else:
            values.append(value / scale)
            deviations.append(deviation / scale)
    excitations = [e / (1.0 + e) for e in known.excitation().values()]
    return np.stack([*values, *deviations, *excitations], axis=-1).astype(np.float32)


__all__ = [
    "ESTIMATORS", "FEATURES", "QUANTITIES", "Identification", "IdentificationStack", "Memories",
    "Status", "features",
]  # fmt: skip
