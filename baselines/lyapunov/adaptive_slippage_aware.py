"""The slippage-aware controller with identified slip, or with the true one.

    AdaptiveSlipPolicy   slip of the friction that is estimated on line (friction_estimator)
    OracleSlipPolicy     slip of the true friction and shear modulus, from `observe_truth`
The law is that of SlippageAwarePolicy; only the slip model differs. Where the observation shows the
attitude, both know slopes.

References: [F] Focchi et al. (2025), section 5.2.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.batch_policy import BatchPolicy
from baselines.estimators.measurement import DataSheet
from baselines.lyapunov.lyapunov_laws import LyapunovGains
from baselines.lyapunov.pose_filter import ATTITUDE, shows_attitude
from baselines.lyapunov.slippage_aware import NEEDS, LyapunovState, SlippageAwarePolicy
from baselines.slip.friction_estimator import CURVE, PLACE, RecursiveSlipEstimator
from baselines.slip.slip_models import LEVEL, Array, SlipFamily, SlipModel, TableSlipModel, grades
from baselines.slip.slip_sweep import slip_family, slope_slip_family, strength_over_weight
from tracked_env import observation as layout
from tracked_env.physics.parameters import PARAMETER_NAMES, PlantParameters

LEARNED = (PLACE, CURVE)  # columns of the estimator's memory: the friction and how sure it is
LATE = 0.05  # [s] an older velocity gives no information on the present slip
MODULI = (0.5, 1.0, 2.0, 4.0, 8.0)  # [-] of the nominal K, of the families that the oracle knows
# [-] of the friction that a slope is taken to need at most. Slip grows without bound towards 1, and
# shear over a longer way than the nominal one looks like little friction: an estimate that is too
# low does more harm than one that is too high.
LARGEST_SHARE = 0.5
SLOPE_MODULI = (0.5, 8.0)  # the same on slopes, where slip on the straight is linear in K
_MOTION = [layout.INDEX[n] for n in ("v_x", "v_y", "yaw_rate", "pose_age")]
_SPROCKETS = [layout.INDEX[n] for n in ("sprocket_speed_left", "sprocket_speed_right")]


def at_least(friction: Array, grade: Array) -> Array:
    """Friction (N,) [-] that is not below what slopes of grades (N, 2) are taken to need."""
    return np.maximum(friction, np.linalg.norm(grade, axis=1) / LARGEST_SHARE)


class AdaptiveSlipState(NamedTuple):
    """State of the policy between two calls."""

    driving: LyapunovState
    memory: NDArray[np.float64]  # of the estimator, (N, columns)


class AdaptiveSlipPolicy(BatchPolicy[AdaptiveSlipState]):
    """slc with unknown friction; arguments as SlippageAwarePolicy, without the slip model.

    parameters: nominal; the friction in them is where the estimate starts. controller: that of the
    arguments by default; its slip model is set at every step.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        gains: LyapunovGains | None = None,
        observation: Sequence[str] = layout.NAMES,
        controller: SlippageAwarePolicy | None = None,
    ) -> None:
        self.parameters = parameters
        self.control_period = control_period
        self.nominal_friction = strength_over_weight(parameters)
        self._sheet = data_sheet
        self._slopes = shows_attitude(observation)
        self.needs = (*NEEDS, *ATTITUDE) if self._slopes else NEEDS
        self._view = layout.View(observation, self.needs)
        self._build(1)
        fields = (*layout.NAMES, *ATTITUDE) if self._slopes else layout.NAMES
        self._policy = controller or SlippageAwarePolicy(
            parameters, control_period, self.estimator, gains, data_sheet, fields
        )

    def _build(self, count: int) -> None:
        """An estimator for `count` vehicles."""
        self.estimator = RecursiveSlipEstimator(
            self.parameters, self.control_period, self._sheet, count, slopes=self._slopes
        )
        self._frozen: NDArray[np.bool_] | None = None  # rows whose friction is held
        self._frozen_friction = self.estimator.memory[:, LEARNED]

    def freeze(self, rows: NDArray[np.bool_]) -> None:
        """Keep the friction that is known now in these rows (N,), until they start anew."""
        self._frozen_friction = self.estimator.memory[:, LEARNED].copy()
        self._frozen = rows.copy() if self._frozen is None else self._frozen | rows

    def estimates(self) -> dict[str, tuple[Array, Array]]:
        """(value, standard deviation), (N,), of the angle phi of the friction mu = tan(phi)."""
        mu, sigma = self.estimator.estimates()["friction"]
        return {"friction_angle": (np.arctan(mu), sigma / (1.0 + mu * mu))}

    def act(
        self,
        observation: NDArray[np.float32],
        state: AdaptiveSlipState | None,
        start: NDArray[np.bool_],
    ) -> tuple[NDArray[np.float32], AdaptiveSlipState]:
        """As SlippageAwarePolicy.act, after the slip since the last call has been identified."""
        count = len(observation)
        if state is not None:
            self.same_count(len(state.memory), count)
        if len(self.estimator.memory) != count:
            self._build(count)
        if state is not None:
            self.estimator.memory[:] = state.memory
        self.estimator.reset(np.flatnonzero(start))
        batch = observation.astype(np.float64)
        v_x, v_y, yaw_rate, age = (batch[:, _MOTION] * layout.SCALE[_MOTION]).T
        left, right = (batch[:, _SPROCKETS] * layout.SCALE[_SPROCKETS]).T
        v_x, v_y = np.where(age <= LATE, (v_x, v_y), np.nan)
        attitude = None if state is None else state.driving.attitude
        self.estimator.update(left, right, v_x, v_y, yaw_rate, attitude)
        if self._frozen is not None:
            self._frozen &= ~start
            rows = np.flatnonzero(self._frozen)
            self.estimator.memory[rows[:, None], LEARNED] = self._frozen_friction[rows]
        # The friction is worked out once; the controller asks for the slip many times.
        friction = self.estimator.friction
        if state is not None:
            friction = at_least(friction, grades(*state.driving.attitude.T))
        self._policy.slip_model = self.estimator.family.at(friction)
        # On level ground the drag of the belts makes their plant forget its errors; on a slope they
        # add up, and an outage is bridged with the steady slip as by the other policies.
        self._policy.driven = None if self._slopes else self.estimator.velocities()
        driving = None if state is None else state.driving
        action, driving = self._policy.act(observation, driving, start)
        return action, AdaptiveSlipState(driving, self.estimator.memory.copy())


class KnownSlip:
    """Slip of each vehicle on soil of known friction and shear modulus; a SlipModel.

    parameters: nominal. slopes: whether it is asked on slopes. Between the moduli of the families
    it is linear in K.
    """

    def __init__(self, parameters: PlantParameters, slopes: bool = False) -> None:
        nominal = parameters.shear_deformation_modulus
        self.moduli = nominal * np.array(SLOPE_MODULI if slopes else MODULI)
        soils = [parameters._replace(shear_deformation_modulus=float(k)) for k in self.moduli]
        self.families: list[SlipFamily] = [
            slope_slip_family(soil) if slopes else slip_family(soil) for soil in soils
        ]
        self.friction: Array = np.array([strength_over_weight(parameters)])
        self.modulus: Array = np.array([nominal])
        self.grade: Array = LEVEL
        self.sloped = slopes

    def on(self, grade: Array) -> "KnownSlip":
        """The same where vehicles feel grades (N, 2); without effect if made for level ground."""
        self.grade = grade
        return self

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> tuple[Array, Array, Array]:
        """(beta_left, beta_right [m/s], alpha [rad]), (N,), or a multiple of N."""
        friction = at_least(self.friction, self.grade)
        times = len(sprocket_left) // len(self.modulus)
        place = np.interp(self.modulus, self.moduli, np.arange(len(self.moduli)))
        total = np.zeros((3, len(sprocket_left)))
        for number, family in enumerate(self.families):
            share = np.maximum(1.0 - np.abs(place - number), 0.0)
            if share.any():
                model: SlipModel = family.at(friction)
                if isinstance(model, TableSlipModel):
                    model = model.on(self.grade)
                slip = model.slip(sprocket_left, sprocket_right)
                share = np.concatenate([share] * times)
                for channel in range(3):
                    total[channel] += share * slip[channel]
        return total[0], total[1], total[2]


class OracleSlipPolicy(SlippageAwarePolicy):
    """slc with the slip of the true soil; arguments as AdaptiveSlipPolicy."""

    needs_truth = True
    slip_model: KnownSlip

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        gains: LyapunovGains | None = None,
        observation: Sequence[str] = layout.NAMES,
    ) -> None:
        model = KnownSlip(parameters, shows_attitude(observation))
        super().__init__(parameters, control_period, model, gains, data_sheet, observation)

    def observe_truth(self, truth: Mapping[str, Any]) -> None:
        """Take over the true parameters, {name: number or (N,)}; other names are ignored."""
        table = np.stack([np.atleast_1d(truth[name]) for name in PARAMETER_NAMES], axis=1)
        each = [PlantParameters(*row) for row in table]
        self.slip_model.friction = np.array([strength_over_weight(p) for p in each])
        self.slip_model.modulus = np.array([p.shear_deformation_modulus for p in each])
