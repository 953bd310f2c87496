"""Policies over the Lyapunov laws: slip neglected, identified beforehand, identified under way.

    UnicyclePolicy       uc: slip is not known, none is fed forward
    SlippageAwarePolicy  slc: the slip of a model that was identified beforehand
    AdaptiveSlipPolicy   slip of the friction that is estimated on line (friction_estimator)
    OracleSlipPolicy     slip of the true friction and shear modulus, from `observe_truth`
Action: sprocket speed demands over sprocket_speed_limit, left then right. One step:
    error      the measured pose error e, or what pose_filter makes of it with a data sheet
    alpha      f(sprocket speeds), measured ones, or the last demanded where these are missing
    alpha_d    f(sprocket speeds that drive v_d cos(alpha_d), w_d - alpha_d'): F maps v_d, w_d,
               which the vehicle does not drive even on its path
    alpha_d'   central difference along the reference by its accelerations
    law        slippage_aware_law, of uc with all slip angles 0: v_x and w
    sprockets  r omega = v_x -+ w B/2 + beta, beta at those sprocket speeds (fixed point)
Where the observation shows the attitude, error and reference are those in the vehicle's plane
(pose_filter), and slip is that on the slope it feels, if the slip model knows slopes. There the
steady slip angle reaches 1 rad and jumps with the demanded yaw rate, and the demand would
oscillate: it follows with SLIP_TIME, and it and its rate along the reference are bounded. Without
any pose or reference: standstill.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 5, 5.2, 5.3 and 7.1.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from baselines.batch_policy import (
    BatchPolicy,
    Bools,
    Floats,
    LearningPolicy,
    check_columns,
    shows_attitude,
)
from baselines.estimators.measurement import DataSheet
from baselines.lyapunov import lyapunov_laws as law
from baselines.lyapunov import pose_filter
from baselines.lyapunov.lyapunov_laws import Geometry, LyapunovGains
from baselines.slip.friction_estimator import PLACE, RecursiveSlipEstimator
from baselines.slip.slip_models import LEVEL, Array, NoSlip, Slip, SlipModel, grades
from baselines.slip.slip_sweep import (
    FRICTIONS,
    slip_family,
    slope_slip_family,
    strength_over_weight,
)
from tracked_env import observation as layout
from tracked_env.physics.parameters import PARAMETER_NAMES, PlantParameters
from tracked_env.validation import CONTROL_PERIOD, checked_number

PASSES = 3  # evaluations of the slip in the feed-forward; the next step starts where it ended
PATH_PASSES = 6  # the same for alpha_d, which starts from nothing: 0.4^6 = 0.4 % is left of beta
LOOK_ASIDE = 0.05  # [s] to both sides, for alpha_d': short against a turn, long against the grid
SLIP_TIME = 0.2  # [s] in which slip settles, about its velocity over mu g
LARGEST_SLIP_ANGLE = 0.4  # [rad] that the law uses on slopes
LARGEST_SLIP_RATE = 0.3  # [rad/s] of alpha_d', which has a jump where the reference begins to turn
LATE = 0.05  # [s] an older velocity gives no information on the present slip
MODULI = (0.5, 1.0, 2.0, 4.0, 8.0)  # [-] of the nominal K, of the families that the oracle has
SLOPE_MODULI = (0.5, 8.0)  # the same on slopes, where slip on the straight is linear in K
# [-] of the friction that a slope is taken to need at most. Slip grows without bound towards 1, and
# shear over a longer way than the nominal one looks like little friction: an estimate that is too
# low does more harm than one that is too high.
LARGEST_SHARE = 0.5

_BELTS = ("sprocket_speed_left", "sprocket_speed_right")
NEEDS = (*pose_filter.POSE, "pose_age", *_BELTS, *pose_filter.PATH)
_SCALE = layout.SCALE
_AGE = layout.INDEX["pose_age"]
_SPROCKETS = [layout.INDEX[name] for name in _BELTS]
_MOTION = [layout.INDEX[n] for n in ("v_x", "v_y", "yaw_rate", "pose_age")]


def tuned_gains(observation: Sequence[str]) -> LyapunovGains:
    """Gains of the registered policies: of slopes where these names show the attitude."""
    return law.GAINS_ON_SLOPES if shows_attitude(observation) else law.GAINS_ON_FLOORS


def at_least(friction: Array, grade: Array) -> Array:
    """Friction (N,) [-] that is not below what slopes of grades (N, 2) are taken to need."""
    return np.maximum(friction, np.linalg.norm(grade, axis=1) / LARGEST_SHARE)


class LyapunovState(NamedTuple):
    """State of the policy between two calls; never changed in place."""

    error: Array  # (N, 3) vehicle minus reference, body axes [m, m, rad]
    age: Array  # (N,) [s] age of the latest pose sample
    sprockets: Array  # (N, 2) [rad/s] last demanded
    mean: Array  # (N, 3) v_x, v_y [m/s], yaw rate [rad/s], averaged over the age of the pose
    located: Bools  # (N,) whether there was a pose
    attitude: Array  # (N, 2) roll, pitch [rad]; 0 where it is not measured
    drift: Array  # (N,) slip angle [rad] that has settled on a slope
    gyro: Array  # (N, GYRO) bias of the gyro, as pose_filter learns it

    @classmethod
    def at_rest(cls, count: int) -> "LyapunovState":
        """Of vehicles whose episode begins."""
        poses = pose_filter.PoseMemory.blank(count)._asdict()
        pair, one = np.zeros((count, 2)), np.zeros(count)
        return cls(sprockets=pair, attitude=pair.copy(), drift=one, **poses)


class SlippageAwarePolicy(BatchPolicy[LyapunovState]):
    """The slippage-aware controller of F 5.2 (slc), for one vehicle or a batch.

    parameters: track_gauge, sprocket_radius and sprocket_speed_limit are used, each a number
    or (N,). control_period [s]: between two calls. slip_model: beta and alpha from sprocket
    speeds, of any slope if it has `on` and is `sloped`. gains: of the law. data_sheet: noise of the
    sensors, for the filter of the pose; None: no filter. observation: fields that are shown.
    Raises ValueError for arguments that make no sense, and for a field of NEEDS that is missing.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        slip_model: SlipModel,
        gains: LyapunovGains | None = None,
        data_sheet: DataSheet | None = None,
        observation: Sequence[str] = layout.NAMES,
    ) -> None:
        self._tilted = tilted = shows_attitude(observation)
        default = law.GAINS_ON_SLOPES if tilted else LyapunovGains()
        self.gains = LyapunovGains(*(float(gain) for gain in gains or default))
        if not (all(0.0 < gain < math.inf for gain in self.gains[:-1]) and self.gains.reach > 0.0):
            raise ValueError(f"{self.gains}: all must be positive, and gains finite")
        control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        if self.gains.k_p * control_period >= 1.0:
            raise ValueError(
                f"k_p control_period = {self.gains.k_p * control_period:g}; must be below 1, or "
                "every step overshoots. Is the controller called too rarely?"
            )
        self.needs = (*NEEDS, *pose_filter.ATTITUDE) if tilted else NEEDS
        self._view = layout.View(observation, self.needs)
        self.control_period = float(control_period)
        self.slip_model: SlipModel = slip_model
        self._local_slip = slip_model  # the same on the slope of the moment
        self._knows_slopes = False
        self.model_velocity: Array | None = None  # (N, 2) v_x, v_y [m/s] of a plant under the belts
        self.geometry = Geometry.of(parameters)
        sheet = DataSheet(*(0.0 for _ in DataSheet._fields)) if data_sheet is None else data_sheet
        noise = sheet.yaw_noise, sheet.gyro_noise, sheet.gyro_bias
        self._attitude_gain = law.steady_gain(*noise, self.control_period) if tilted else 0.0
        # On slopes the heading turns by more than the gyro: no bias is learned.
        self.pose_filter = pose_filter.PoseFilter.of(sheet, self.control_period, not tilted)

    def act(
        self, observation: Floats, state: LyapunovState | None, start: Bools
    ) -> tuple[Floats, LyapunovState]:
        """Sprocket speeds over their limit, and the new state."""
        count, geometry = len(observation), self.geometry
        check_columns(count, len(geometry.radius))
        if state is None:
            state = LyapunovState.at_rest(count)
        else:
            self.same_count(len(state.age), count)
            state = LyapunovState._make(values.copy() for values in state)
            for values in state:
                values[start] = 0
        error, age, last, mean, located, attitude, drift, gyro = state
        if self._tilted:
            filtering = start, self._attitude_gain, self.control_period
            attitude = pose_filter.filtered_attitude(observation, attitude, *filtering)
            observation = pose_filter.in_vehicle_plane(observation, attitude)
        model: Any = self.slip_model
        sloped = getattr(model, "sloped", False)
        self._local_slip = model.on(grades(*attitude.T)) if sloped else model
        self._knows_slopes = sloped and self._tilted
        measured = observation[:, _SPROCKETS] * _SCALE[_SPROCKETS]
        actual = np.where(np.isfinite(measured), measured, last)
        beta, alpha, belt_motion = self._slip(actual)
        reference = np.empty((count, 4))
        memory = pose_filter.PoseMemory(error, age, mean, gyro, located)
        prediction = self._without_pose(observation, belt_motion, alpha)
        pose_filter.locate(observation, *prediction, self.pose_filter, memory, reference)
        moving = located & np.isfinite(reference[:, 0])
        reference[~moving] = 0.0
        path_error, reference, moving = self._path_error(
            observation, error, reference, moving, belt_motion
        )
        if self._knows_slopes:  # the slip angle follows that of the belts
            share = np.where(start, 1.0, min(self.control_period / SLIP_TIME, 1.0))
            bounded = np.clip(alpha, -LARGEST_SLIP_ANGLE, LARGEST_SLIP_ANGLE)
            alpha = drift = drift + share * (bounded - drift)
        motion = self._law(path_error, reference, alpha)
        sprockets = self._feed_forward(motion, beta)
        sprockets[~moving] = 0.0
        action = np.clip(sprockets / geometry.limit[:, None], -1.0, 1.0).astype(np.float32)
        state = LyapunovState(error, age, sprockets, mean, located, attitude, drift, gyro)
        return action, state

    def _path_error(
        self, observation: Floats, error: Array, reference: Array, moving: Bools, belt_motion: Array
    ) -> tuple[Array, Array, Bools]:
        """Error, reference and moving vehicles for the law; a subclass may have its own reference.

        belt_motion (N, 2): v_x and w by the slip model.
        """
        return error, reference, moving

    def _without_pose(
        self, observation: Floats, motion: Array, alpha: Array
    ) -> tuple[Array, Array]:
        """Motion (N, 2) and slip angle (N,) of dead reckoning; in an outage of `model_velocity`."""
        blind = observation[:, _AGE] * _SCALE[_AGE] > pose_filter.OUTAGE
        if self.model_velocity is None or not blind.any():
            return motion, alpha
        v_x, v_y = self.model_velocity.T
        angle = np.arctan(v_y / np.where(np.abs(v_x) < law.SLOW, np.inf, v_x))
        forward = np.where(blind, v_x, motion[:, 0])
        return np.stack([forward, motion[:, 1]], axis=1), np.where(blind, angle, alpha)

    def _slip(self, sprockets: Array) -> tuple[Array, Array, Array]:
        """beta (N, 2) [m/s], alpha (N,) [rad] and motion (N, 2) at sprockets (N, 2); N may be a
        multiple of the number of vehicles."""
        count = len(sprockets)
        slip, beta, motion = np.empty((count, 3)), np.empty((count, 2)), np.empty((count, 2))
        left, right = sprockets.T.copy()
        slip[:, 0], slip[:, 1], slip[:, 2] = self._local_slip.slip(left, right)
        alpha = np.empty(count)
        law.settle(sprockets, slip, *self.geometry[:2], beta, alpha, motion)
        return beta, alpha, motion

    def _sprockets(self, motion: Array, beta: Array) -> Array:
        """Sprocket speeds (N, 2) within their limit for motion and beta, (N, 2) each."""
        sprockets = np.empty_like(motion)
        law.sprockets_for(motion, beta, *self.geometry, sprockets)
        return sprockets

    def _feed_forward(self, motion: Array, beta: Array) -> Array:
        """Sprocket speeds whose slip leaves `motion` over; beta: first guess of that slip."""
        sprockets = self._sprockets(motion, beta)
        for _ in range(PASSES):
            sprockets = self._sprockets(motion, self._slip(sprockets)[0])
        return sprockets

    def _on_the_path(
        self, reference: Array, rate: Array, beta: Array, alpha: Array
    ) -> tuple[Array, Array]:
        """beta (N, 2) and alpha_d (N,) on the path; rate: alpha_d'; beta, alpha: first guess."""
        motion = np.empty_like(beta)
        for _ in range(PATH_PASSES):
            law.along_slip(reference, alpha, rate, motion)
            beta, alpha, _motion = self._slip(self._sprockets(motion, beta))
        return beta, alpha

    def reference_slip(self, reference: Array) -> tuple[Array, Array]:
        """alpha_d [rad] and its rate [rad/s], (N,), of reference (N, 4) v_d, w_d, v_d', w_d'."""
        count = len(reference)
        change = LOOK_ASIDE * reference[:, 2:]
        rows = np.concatenate([reference[:, :2] + sign * change for sign in (0.0, -1.0, 1.0)])
        none = np.zeros(3 * count)
        beta, alpha = self._on_the_path(rows, none, np.zeros((3 * count, 2)), none)
        now, before, after = alpha.reshape(3, count)
        rate = (after - before) / (2.0 * LOOK_ASIDE)
        _beta, alpha = self._on_the_path(reference[:, :2], rate, beta[:count], now)
        if not self._knows_slopes:
            return alpha, rate
        inside = np.abs(alpha) <= LARGEST_SLIP_ANGLE
        rate = np.where(inside, np.clip(rate, -LARGEST_SLIP_RATE, LARGEST_SLIP_RATE), 0.0)
        return np.clip(alpha, -LARGEST_SLIP_ANGLE, LARGEST_SLIP_ANGLE), rate

    def _law(self, error: Array, reference: Array, alpha: Array) -> Array:
        """Motion demanded (N, 2)."""
        slip, motion = np.empty((len(error), 3)), np.empty((len(error), 2))
        slip[:, 0] = alpha
        slip[:, 1], slip[:, 2] = self.reference_slip(reference)
        law.laws(error, reference, slip, self.gains, motion)
        return motion


class UnicyclePolicy(SlippageAwarePolicy):
    """The unicycle controller of F 5.1 (uc); arguments as SlippageAwarePolicy, without slip."""

    def __init__(
        self, parameters: PlantParameters, control_period: float, *arguments: Any, **options: Any
    ) -> None:
        super().__init__(parameters, control_period, NoSlip(), *arguments, **options)

    def reference_slip(self, reference: Array) -> tuple[Array, Array]:
        """Zeros."""
        return np.zeros(len(reference)), np.zeros(len(reference))


class AdaptiveSlipState(NamedTuple):
    """State of the policy between two calls."""

    driving: LyapunovState
    memory: Array  # of the estimator, (N, columns)


class AdaptiveSlipPolicy(SlippageAwarePolicy, LearningPolicy[Any]):
    """slc with unknown friction; arguments as SlippageAwarePolicy, without the slip model.

    The friction of the nominal parameters is where the estimate starts.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        gains: LyapunovGains | None = None,
        observation: Sequence[str] = layout.NAMES,
        **options: Any,
    ) -> None:
        options |= {"observation": observation}
        super().__init__(parameters, control_period, NoSlip(), gains, data_sheet, **options)
        self.parameters, self._sheet = parameters, data_sheet
        self.nominal_friction = strength_over_weight(parameters)
        self._build(1)

    def _build(self, count: int) -> None:
        """An estimator for `count` vehicles."""
        self.estimator = RecursiveSlipEstimator(
            self.parameters, self.control_period, self._sheet, count, slopes=self._tilted
        )
        self._frozen = None

    @property
    def observer(self) -> RecursiveSlipEstimator:
        """The estimator of the friction, whose `update` each call of `predict` runs."""
        return self.estimator

    def _learned(self) -> tuple[Array, ...]:
        """The friction and how sure it is."""
        return (self.estimator.memory[:, PLACE:],)

    def estimates(self) -> dict[str, tuple[Array, Array]]:
        """(value, standard deviation), (N,), of the angle phi of the friction mu = tan(phi)."""
        mu, sigma = self.estimator.estimates()["friction"]
        return {"friction_angle": (np.arctan(mu), sigma / (1.0 + mu * mu))}

    def act(self, observation: Floats, state: Any, start: Bools) -> tuple[Floats, Any]:
        """As SlippageAwarePolicy.act, after the slip since the last call has been identified."""
        count, driving = len(observation), None if state is None else state.driving
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
        attitude = None if driving is None else driving.attitude
        self.estimator.update(left, right, v_x, v_y, yaw_rate, attitude)
        self._hold_frozen(start)
        friction = self.estimator.friction
        if attitude is not None:
            friction = at_least(friction, grades(*attitude.T))
        self.slip_model = self.estimator.family.at(friction)
        # On level ground the drag of the belts makes their plant forget its errors; on a slope they
        # add up: there the steady slip bridges an outage, as in the other policies.
        self.model_velocity = None if self._tilted else self.estimator.velocities()
        action, driving = super().act(observation, driving, start)
        return action, AdaptiveSlipState(driving, self.estimator.memory.copy())


class KnownSlip:
    """Slip of each vehicle on soil of known friction and shear modulus; a SlipModel.

    parameters: nominal. slopes: whether vehicles are on slopes. moduli: of the families, over the
    nominal K, and frictions [-] of each on level ground, where not the usual ones. Between the
    moduli of the families it is linear in K.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        slopes: bool = False,
        moduli: Sequence[float] | None = None,
        frictions: tuple[float, ...] = FRICTIONS,
    ) -> None:
        nominal = parameters.shear_deformation_modulus
        self.moduli = nominal * np.array(moduli or (SLOPE_MODULI if slopes else MODULI))
        soils = [parameters._replace(shear_deformation_modulus=float(k)) for k in self.moduli]
        self.families = [
            slope_slip_family(p) if slopes else slip_family(p, frictions) for p in soils
        ]
        self.friction: Array = np.array([strength_over_weight(parameters)])
        self.modulus: Array = np.array([nominal])
        self.grade: Array = LEVEL
        self.sloped = slopes

    def on(self, grade: Array) -> "KnownSlip":
        """The same where vehicles feel grades (N, 2); without effect if made for level ground."""
        self.grade = grade
        return self

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> Slip:
        """(beta_left, beta_right [m/s], alpha [rad]), (N,), or a multiple of N."""
        friction = at_least(self.friction, self.grade)
        times = len(sprocket_left) // len(self.modulus)
        place = np.interp(self.modulus, self.moduli, np.arange(len(self.moduli)))
        total = np.zeros((3, len(sprocket_left)))
        for number, family in enumerate(self.families):
            share = np.maximum(1.0 - np.abs(place - number), 0.0)
            if share.any():
                slip = family.at(friction).on(self.grade).slip(sprocket_left, sprocket_right)
                total += np.tile(share, times) * slip
        return total[0], total[1], total[2]


class OracleSlipPolicy(SlippageAwarePolicy):
    """slc with the slip of the true soil; arguments as AdaptiveSlipPolicy. model: of that slip,
    where not the one for all soils."""

    needs_truth = True
    slip_model: KnownSlip

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        model: KnownSlip | None = None,
        **options: Any,
    ) -> None:
        if model is None:
            model = KnownSlip(parameters, shows_attitude(options.get("observation", ())))
        super().__init__(parameters, control_period, model, data_sheet=data_sheet, **options)

    def observe_truth(self, truth: Mapping[str, Any]) -> None:
        """Take over the true parameters, {name: number or (N,)}; other names are ignored."""
        table = np.stack([np.atleast_1d(truth[name]) for name in PARAMETER_NAMES], axis=1)
        each = [PlantParameters(*row) for row in table]
        self.slip_model.friction = np.array([strength_over_weight(p) for p in each])
        self.slip_model.modulus = np.array([p.shear_deformation_modulus for p in each])
