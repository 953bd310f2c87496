"""Policies over the Lyapunov laws: the unicycle controller and the slippage-aware one.

Action: sprocket speed demands over sprocket_speed_limit, left then right. One step:
    error      the measured pose error e, or what pose_filter makes of it with a data sheet
    alpha      f(sprocket speeds), measured ones, or the last demanded where these are missing
    alpha_d    f(sprocket speeds that drive v_d cos(alpha_d), w_d - alpha_d'): F maps v_d, w_d,
               which the vehicle does not drive even on its path, and then alpha != alpha_d
    alpha_d'   central difference along the reference by its accelerations. A difference from
               step to step would turn a jump of the reference into a blow of the tracks.
    law        lyapunov.slippage_aware_law or unicycle_law: v_x and w
    sprockets  r omega = v_x -+ w B/2 + beta, beta at those sprocket speeds (fixed point)
Where the observation shows the attitude, error and reference are those in the vehicle's plane
(slope_errors), and slip is that on the slope it feels, if the slip model knows slopes.
Without any pose or reference: standstill.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 5 and 7.1.

Pose error of the Lyapunov policies: dead reckoning, pulled towards the samples of the pose.

Dead reckoning is with velocity and gyro, the pull the steady Kalman gain K of a data sheet.
A pose sample that comes late is first carried forward by the mean motion over its age. (By the
motion now, k_p age >= 1 would make the vehicle rattle: the demand enters its own measurement.)
A missing sample (NaN) is made up from the belts.
While poses come, a Kalman filter of two states learns the bias of the gyro from the heading error,
    h+ = h + dt (w - b - w_ref)
(the filter of slip_outage). In an outage the bias is taken off the gyro: 0.001 rad/s would be 25 mm
to the side after 10 s at 0.5 m/s.

What a slope changes for the Lyapunov laws: errors and reference in the vehicle's plane, F 5.3.

    e_b    = R_x(roll)^T R_y(pitch)^T (e_x, e_y, 0),  e_psi,b = cos(pitch) cos(roll) e_psi     (49)
    v_d,b  = v_d / cos(pitch),   w_d,b = cos(pitch) cos(roll) w_d
with the yaw counted once (`physics.attitude.in_body_plane`). The reference is horizontal, so that a
vehicle above or below it has to drive faster along its own plane to keep up. Roll and pitch come
from their samples and from two gyros, filtered as the heading is; level ground changes no bit.

On slopes the steady slip angle is no longer small: a slow vehicle that turns where a side slope
takes half of the friction drifts at 1 rad, and the angle jumps with the demanded yaw rate, while
the vehicle needs its time to drift. Fed back at once it makes the law chatter. So the angle follows
with SLIP_TIME, and it and its rate along the reference are bounded.

References: [F] Focchi et al. (2025), section 5.3.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.batch_policy import BatchPolicy
from baselines.estimators import pose_outages as inertial
from baselines.estimators.measurement import DataSheet
from baselines.lyapunov import lyapunov_laws
from baselines.lyapunov.lyapunov_laws import (
    GAINS_ON_FLOORS,
    GAINS_ON_SLOPES,
    Array,
    Geometry,
    LyapunovGains,
    NoSlip,
    SlipModel,
    SlopeAwareSlipModel,
    steady_gain,
)
from baselines.slip.slip_models import grades
from tracked_env import observation as layout
from tracked_env.physics.elementary import wrap_angle
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.rigid_body import in_body_plane
from tracked_env.validation import CONTROL_PERIOD, checked_number

VELOCITY_NOISE_LIMIT = 1.0  # [m/s] a data sheet above it has no velocity: the belts give it
OUTAGE = 0.25  # [s] a pose that is older is missing, a younger one only late
BELT_DRIFT = 0.05  # [m/s] slow error of the belts' velocity: slip that the model does not know

# What is remembered of the gyro: heading error and bias, [rad] and [rad/s], and their covariance.
TURNED, TURN_BIAS, P_TT, _P_TG, P_GG = range(5)
GYRO = 5

# Fields of the observation that the filter reads.
POSE = ("position_error_x", "position_error_y", "heading_error", "v_x", "v_y", "yaw_rate")
PATH = ("reference_speed", "reference_yaw_rate", "reference_acceleration",
        "reference_yaw_acceleration")  # fmt: skip
_I, _SCALE = layout.INDEX, layout.SCALE
_X, _Y, _HEADING, _V_X, _V_Y, _YAW_RATE = (_I[name] for name in POSE)
_AGE_POSE_FILTER = _I["pose_age"]
_REFERENCE = np.array([_I[name] for name in PATH])


def filter_of(sheet: DataSheet, control_period: float) -> tuple[bool, tuple[float, float]]:
    """Whether the velocity is measured, and the gains of position and heading [-]."""
    measured = sheet.velocity_noise <= VELOCITY_NOISE_LIMIT
    rate = (sheet.velocity_noise, 0.0) if measured else (0.0, BELT_DRIFT)
    return measured, (
        lyapunov_laws.steady_gain(sheet.position_noise, *rate, control_period),
        lyapunov_laws.steady_gain(
            sheet.yaw_noise, sheet.gyro_noise, sheet.gyro_bias, control_period
        ),
    )


class GyroNoise(NamedTuple):
    """Variances of which the bias of the gyro is learned."""

    heading: float  # [rad^2] of a sample of the heading
    gyro: float  # [rad^2/s^2] white
    bias: float  # [rad^2/s^2]; 0: none is learned


def gyro_noise_of(sheet: DataSheet, learned: bool) -> GyroNoise:
    """From a data sheet; learned: whether there is a bias to be learned."""
    bias = sheet.gyro_bias**2 if learned and sheet.yaw_noise > 0.0 else 0.0
    return GyroNoise(sheet.yaw_noise**2, sheet.gyro_noise**2, bias)


@formula
def _si(observation, i, column):
    return observation[i, column] * _SCALE[column]


@formula
def _blend(predicted, sample, gain):
    return sample if gain >= 1.0 else predicted + gain * (sample - predicted)


@formula
def _turned(gyro, i, w, turn, noise, period):
    """Heading error in gyro (N, GYRO) after a step with the gyro at w and the reference at turn."""
    gyro[i, TURNED] += period * (w - gyro[i, TURN_BIAS] - turn)
    inertial.drift(gyro, i, P_TT, noise.gyro, period)


@formula
def _seen(gyro, i, heading, begins, noise):
    """A sample of the heading error [rad]; begins: it is the first."""
    if begins or gyro[i, P_TT] == 0.0:
        gyro[i, TURNED], gyro[i, P_TT], gyro[i, _P_TG] = heading, noise.heading, 0.0
        gyro[i, P_GG] = noise.bias if begins else gyro[i, P_GG]
        return
    error = wrap_angle(heading - gyro[i, TURNED])
    inertial.compare(gyro, i, TURNED, error, noise.heading)


@loop
def locate(
    observation, motion, alpha, measured, gains, noise, period, error, age, mean, gyro, located,
    reference,
):  # fmt: skip
    """Bring error, mean (N, 3), gyro (N, GYRO), age, located (N,) up to date; reference (N, 4) out.

    motion (N, 2), alpha (N,): what the belts say. measured: whether velocity is, with the pose.
    gains (2,): of position and heading. reference: v_d, w_d, v_d', w_d', all NaN where one is.
    """
    for i in range(observation.shape[0]):
        check = 0.0
        for k in range(4):
            reference[i, k] = _si(observation, i, _REFERENCE[k])
            check += reference[i, k] * 0.0
        for k in range(4):
            reference[i, k] += check
        old = _si(observation, i, _AGE_POSE_FILTER)
        fresh = not located[i] or old < age[i] + 0.5 * period
        v_x, v_y = _si(observation, i, _V_X), _si(observation, i, _V_Y)
        if not (measured and fresh and old < 1.5 * period and np.isfinite(v_x + v_y)):
            v_x, v_y = lyapunov_laws.pose_rate(0.0, motion[i, 0], alpha[i])
        w = _si(observation, i, _YAW_RATE)
        learns = noise.bias > 0.0 and located[i]
        if learns and check == 0.0:
            felt = w if np.isfinite(w) else motion[i, 1] + gyro[i, TURN_BIAS]
            _turned(gyro, i, felt, reference[i, 1], noise, period)
        w = w if np.isfinite(w) else motion[i, 1]
        if learns and old > OUTAGE:
            w -= gyro[i, TURN_BIAS]
        e = lyapunov_laws.PoseError(error[i, 0], error[i, 1], error[i, 2])
        if check == 0.0:
            e = lyapunov_laws.carried(e, v_x, v_y, w, reference[i, 0], reference[i, 1], period)
        seen = lyapunov_laws.PoseError(
            -_si(observation, i, _X), -_si(observation, i, _Y), -_si(observation, i, _HEADING)
        )
        if fresh and np.isfinite(seen.x + seen.y + seen.heading + old):
            share = period / (0.5 * old + period)  # exponential, of the same mean delay
            mean[i, 0] += share * (v_x - mean[i, 0])
            mean[i, 1] += share * (v_y - mean[i, 1])
            mean[i, 2] += share * (w - mean[i, 2])
            if noise.bias > 0.0 and old < 1.5 * period:
                _seen(gyro, i, seen.heading, not located[i], noise)
            if old > 0.0:
                seen = lyapunov_laws.carried(
                    seen, mean[i, 0], mean[i, 1], mean[i, 2], 0.0, 0.0, old
                )  # fmt: skip
            share, share_yaw = (gains[0], gains[1]) if located[i] else (1.0, 1.0)
            turned = e.heading + wrap_angle(seen.heading - e.heading)
            e = lyapunov_laws.PoseError(
                _blend(e.x, seen.x, share),
                _blend(e.y, seen.y, share),
                seen.heading if share_yaw >= 1.0 else _blend(e.heading, turned, share_yaw),
            )
            located[i] = True
        age[i] = old if np.isfinite(old) else age[i] + period
        error[i, 0], error[i, 1], error[i, 2] = e.x, e.y, wrap_angle(e.heading)


ATTITUDE = ("roll", "pitch", "roll_rate", "pitch_rate")
STEEPEST_ATTITUDE = 1.4  # [rad] beyond it a vehicle lies on its side
SLIP_TIME = 0.2  # [s] in which slip settles, about its velocity over mu g
LARGEST_SLIP_ANGLE = 0.4  # [rad] that the law is told on slopes
LARGEST_SLIP_RATE = 0.3  # [rad/s] of alpha_d', which has a jump where the reference begins to turn
_FIRST = layout.SIZE  # a View puts fields that are not of V0 behind those of V0
_POSE = [layout.INDEX[n] for n in ("position_error_x", "position_error_y", "heading_error")]
_ALONG = [layout.INDEX[n] for n in ("reference_speed", "reference_acceleration")]
_ABOUT = [layout.INDEX[n] for n in ("reference_yaw_rate", "reference_yaw_acceleration")]
_ATTITUDE_LAYOUT = layout.make_layout(["attitude"])
_SCALE_SLOPE_ERRORS = _ATTITUDE_LAYOUT.scale[_ATTITUDE_LAYOUT.columns(ATTITUDE)]
_POSE_SCALE = layout.SCALE[_POSE]


def shows_attitude(observation: Sequence[str]) -> bool:
    """Whether an observation of these fields tells roll and pitch."""
    return all(name in observation for name in ATTITUDE)


def tuned_gains(observation: Sequence[str]) -> LyapunovGains:
    """Gains of the registered policies: of slopes where these names show the attitude."""
    return GAINS_ON_SLOPES if shows_attitude(observation) else GAINS_ON_FLOORS


class AttitudeFilter:
    """Roll and pitch of N vehicles from observations with the fields ATTITUDE behind those of V0.

    sheet: noise of the sensors. control_period [s]: between two samples.
    """

    def __init__(self, sheet: DataSheet, control_period: float) -> None:
        self.control_period = control_period
        self.gain = steady_gain(sheet.yaw_noise, sheet.gyro_noise, sheet.gyro_bias, control_period)

    def update(
        self, observation: NDArray[np.float32], last: Array, start: NDArray[np.bool_]
    ) -> Array:
        """(N, 2) roll, pitch [rad]; last: the same of the step before, where not `start`.

        A sample that is missing (NaN) is carried on by the gyros, a missing gyro stands still.
        """
        seen = observation[:, _FIRST : _FIRST + 4] * _SCALE_SLOPE_ERRORS
        turned = self.control_period * np.nan_to_num(seen[:, 2:])
        predicted = np.where(start[:, None], 0.0, last + turned)
        sample = np.where(np.isfinite(seen[:, :2]), seen[:, :2], predicted)
        share = np.where(start[:, None], 1.0, self.gain)
        attitude = np.where(share >= 1.0, sample, predicted + share * (sample - predicted))
        return np.clip(attitude, -STEEPEST_ATTITUDE, STEEPEST_ATTITUDE)


def in_vehicle_plane(observation: NDArray[np.float32], attitude: Array) -> NDArray[np.float32]:
    """The observation with pose error and reference in the plane of vehicles at roll, pitch [rad];
    rows of level vehicles are as they were, to the bit."""
    roll, pitch = attitude.T
    level = (roll == 0.0) & (pitch == 0.0)
    cosines = np.cos(pitch), np.cos(roll)
    ahead, left, turn = (observation[:, _POSE] * _POSE_SCALE).T
    sines = np.sin(pitch), np.sin(roll)
    error = in_body_plane.py_func(ahead, left, turn, (cosines[0], sines[0]), (cosines[1], sines[1]))
    tilted = observation.copy()
    tilted[:, _POSE] = np.stack(error, axis=1) / _POSE_SCALE
    tilted[:, _ALONG] /= cosines[0][:, None]
    tilted[:, _ABOUT] *= (cosines[0] * cosines[1])[:, None]
    return np.where(level[:, None], observation, tilted)


def settled_slip(alpha: Array, last: Array, start: NDArray[np.bool_], period: float) -> Array:
    """Slip angle (N,) [rad] that follows the one of the belts, alpha, from `last` for a period."""
    bounded = np.clip(alpha, -LARGEST_SLIP_ANGLE, LARGEST_SLIP_ANGLE)
    share = np.where(start, 1.0, min(period / SLIP_TIME, 1.0))
    return last + share * (bounded - last)


def bounded_slip(alpha: Array, rate: Array) -> tuple[Array, Array]:
    """alpha_d [rad] and alpha_d' [rad/s], (N,), within what the law is told."""
    inside = np.abs(alpha) <= LARGEST_SLIP_ANGLE
    return (
        np.clip(alpha, -LARGEST_SLIP_ANGLE, LARGEST_SLIP_ANGLE),
        np.where(inside, np.clip(rate, -LARGEST_SLIP_RATE, LARGEST_SLIP_RATE), 0.0),
    )


PASSES = 3  # evaluations of the slip in the feed-forward; the next step starts where it ended
PATH_PASSES = 6  # the same for alpha_d, which starts from nothing: 0.4^6 = 0.4 % is left of beta
LOOK_ASIDE = 0.05  # [s] to both sides, for alpha_d': short against a turn, long against the grid

_BELTS = ("sprocket_speed_left", "sprocket_speed_right")
NEEDS = (*POSE, "pose_age", *_BELTS, *PATH)
_SCALE = layout.SCALE
_AGE = layout.INDEX["pose_age"]
_SPROCKETS = [layout.INDEX[name] for name in _BELTS]


class LyapunovState(NamedTuple):
    """State of the policy between two calls; never changed in place."""

    error: Array  # (N, 3) vehicle minus reference, body axes [m, m, rad]
    age: Array  # (N,) [s] age of the pose sample last seen
    sprockets: Array  # (N, 2) [rad/s] last demanded
    mean: Array  # (N, 3) v_x, v_y [m/s], yaw rate [rad/s], averaged over the age of the pose
    located: NDArray[np.bool_]  # (N,) whether a pose has been seen
    attitude: Array  # (N, 2) roll, pitch [rad]; 0 where it is not shown
    drift: Array  # (N,) slip angle [rad] that has settled on a slope
    gyro: Array  # (N, GYRO) bias of the gyro, as pose_filter learns it


class SlippageAwarePolicy(BatchPolicy[LyapunovState]):
    """The slippage-aware controller of F 5.2 (slc) as a policy, for one vehicle or a batch.

    parameters: track_gauge, sprocket_radius and sprocket_speed_limit are used, each a number
    or (N,). control_period [s]: between two calls. slip_model: beta and alpha from sprocket
    speeds, of any slope if it is a SlopeAwareSlipModel. gains: of the law. data_sheet: noise of the
    sensors; it sets the filter of the pose. None: no noise, hence no filter. observation: names of
    the fields that the environment shows. Raises ValueError for arguments that make no sense, and
    for an observation that lacks a field of NEEDS.
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
        tilted = shows_attitude(observation)
        if gains is None:
            gains = lyapunov_laws.GAINS_ON_SLOPES if tilted else LyapunovGains()
        self.gains = LyapunovGains(*(float(gain) for gain in gains))
        if not (all(0.0 < gain < math.inf for gain in self.gains[:-1]) and self.gains.reach > 0.0):
            raise ValueError(f"{self.gains}: all must be positive, and gains finite")
        control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        if self.gains.k_p * control_period >= 1.0:
            raise ValueError(
                f"k_p control_period = {self.gains.k_p * control_period:g}; must be below 1, or "
                "every step overshoots. Is the controller called too rarely?"
            )
        self._view = layout.View(observation, (*NEEDS, *ATTITUDE) if tilted else NEEDS)
        self.control_period = float(control_period)
        self.slip_model = self._felt = slip_model
        self._knows_slopes = False
        self.driven: Array | None = None  # (N, 2) v_x, v_y [m/s] of a model that the belts drive
        self.geometry = Geometry.of(parameters)
        self._repeated = (Geometry(*(np.empty((3, 0)))),) * 2  # for the count last seen
        none = DataSheet(*(0.0 for _ in DataSheet._fields))
        sheet = none if data_sheet is None else data_sheet
        self._attitude = AttitudeFilter(sheet, self.control_period) if tilted else None
        self.velocity_measured, self.filter_gains = filter_of(sheet, self.control_period)
        # On slopes the heading turns by more than the gyro: no bias is learned.
        self._gyro_noise = gyro_noise_of(sheet, self._attitude is None)

    def act(
        self,
        observation: NDArray[np.float32],
        state: LyapunovState | None,
        start: NDArray[np.bool_],
    ) -> tuple[NDArray[np.float32], LyapunovState]:
        """Sprocket speeds over their limit, and the new state.

        Raises ValueError for a state of another number of vehicles.
        """
        count = len(observation)
        geometry, _thrice = self._rows(count)
        error, age, last, mean, located, attitude, drift, gyro = self._start(state, start)
        if self._attitude is not None:
            attitude = self._attitude.update(observation, attitude, start)
            observation = in_vehicle_plane(observation, attitude)
        model = self.slip_model
        self._knows_slopes = self._attitude is not None and isinstance(model, SlopeAwareSlipModel)
        self._felt = (
            model.on(grades(*attitude.T)) if isinstance(model, SlopeAwareSlipModel) else model
        )
        measured = observation[:, _SPROCKETS] * _SCALE[_SPROCKETS]
        actual = np.where(np.isfinite(measured), measured, last)
        beta, alpha, driven = self._slip(actual, geometry)
        reference = np.empty((count, 4))
        locate(
            observation, *self._without_pose(observation, driven, alpha), self.velocity_measured,
            self.filter_gains, self._gyro_noise, self.control_period, error, age, mean, gyro,
            located, reference,
        )  # fmt: skip
        moving = located & np.isfinite(reference[:, 0])
        reference[~moving] = 0.0
        followed, reference, moving = self._followed(observation, error, reference, moving, driven)
        if self._knows_slopes:
            alpha = drift = settled_slip(alpha, drift, start, self.control_period)
        wanted = self._law(followed, reference, alpha, geometry)
        sprockets = self._feed_forward(wanted, beta, geometry)
        sprockets[~moving] = 0.0
        action = np.clip(sprockets / geometry.limit[:, None], -1.0, 1.0).astype(np.float32)
        return action, LyapunovState(
            error, age, sprockets, mean, located, attitude, drift, gyro
        )  # fmt: skip

    def _followed(
        self, observation: NDArray[np.float32], error: Array, reference: Array,
        moving: NDArray[np.bool_], driven: Array,
    ) -> tuple[Array, Array, NDArray[np.bool_]]:  # fmt: skip
        """Error, reference and moving vehicles for the law; a subclass may have its own reference.

        driven (N, 2): motion that the belts say.
        """
        return error, reference, moving

    def _without_pose(
        self, observation: NDArray[np.float32], motion: Array, alpha: Array
    ) -> tuple[Array, Array]:
        """Motion (N, 2) and slip angle (N,) that carry the pose on; in an outage, of `driven`."""
        blind = observation[:, _AGE] * _SCALE[_AGE] > OUTAGE
        if self.driven is None or not blind.any():
            return motion, alpha
        v_x, v_y = self.driven.T
        angle = np.arctan(v_y / np.where(np.abs(v_x) < lyapunov_laws.SLOW, np.inf, v_x))
        forward = np.where(blind, v_x, motion[:, 0])
        return np.stack([forward, motion[:, 1]], axis=1), np.where(blind, angle, alpha)

    def _rows(self, count: int) -> tuple[Geometry, Geometry]:
        """Geometry of `count` vehicles, and the same three times over."""
        if len(self._repeated[0].radius) != count:
            rows = self.geometry.rows(count)
            self._repeated = rows, Geometry(*(np.tile(value, 3) for value in rows))
        return self._repeated

    def _start(self, state: LyapunovState | None, start: NDArray[np.bool_]) -> LyapunovState:
        """A copy of the state, its rows new where an episode starts."""
        if state is None:
            rows, nowhere = np.zeros((len(start), 3)), np.zeros(len(start), dtype=bool)
            one, pair = rows[:, 0], rows[:, :2]
            return LyapunovState(
                rows, one.copy(), pair.copy(), rows.copy(), nowhere, pair.copy(), one.copy(),
                np.zeros((len(start), GYRO)),
            )  # fmt: skip
        self.same_count(len(state.age), len(start))
        copies = LyapunovState._make(values.copy() for values in state)
        for values in copies:
            values[start] = 0
        return copies

    def _slip(self, sprockets: Array, geometry: Geometry) -> tuple[Array, Array, Array]:
        """beta (N, 2) [m/s], alpha (N,) [rad] and motion (N, 2) at sprockets (N, 2)."""
        count = len(sprockets)
        slip, beta, motion = np.empty((count, 3)), np.empty((count, 2)), np.empty((count, 2))
        left, right = sprockets.T.copy()
        slip[:, 0], slip[:, 1], slip[:, 2] = self._felt.slip(left, right)
        alpha = np.empty(count)
        lyapunov_laws.settle(sprockets, slip, *geometry[:2], beta, alpha, motion)
        return beta, alpha, motion

    def _sprockets(self, motion: Array, beta: Array, geometry: Geometry) -> Array:
        """Sprocket speeds (N, 2) within their limit for motion and beta, (N, 2) each."""
        sprockets = np.empty_like(motion)
        lyapunov_laws.sprockets_for(motion, beta, *geometry, sprockets)
        return sprockets

    def _feed_forward(self, motion: Array, beta: Array, geometry: Geometry) -> Array:
        """Sprocket speeds whose slip leaves `motion` over; beta: first guess of that slip."""
        sprockets = self._sprockets(motion, beta, geometry)
        for _ in range(PASSES):
            beta, _alpha, _motion = self._slip(sprockets, geometry)
            sprockets = self._sprockets(motion, beta, geometry)
        return sprockets

    def _on_the_path(
        self, reference: Array, rate: Array, geometry: Geometry, beta: Array, alpha: Array
    ) -> tuple[Array, Array]:
        """beta (N, 2) and alpha_d (N,) on the path; rate: alpha_d'; beta, alpha: first guess."""
        motion = np.empty_like(beta)
        for _ in range(PATH_PASSES):
            lyapunov_laws.along_slip(reference, alpha, rate, motion)
            beta, alpha, _motion = self._slip(self._sprockets(motion, beta, geometry), geometry)
        return beta, alpha

    def reference_slip(self, reference: Array) -> tuple[Array, Array]:
        """alpha_d [rad] and its rate [rad/s], (N,), of reference (N, 4) v_d, w_d, v_d', w_d'."""
        count = len(reference)
        geometry, thrice = self._rows(count)
        change = LOOK_ASIDE * reference[:, 2:]
        rows = np.empty((3 * count, 2))
        for k, sign in enumerate((0.0, -1.0, 1.0)):
            rows[k * count : (k + 1) * count] = reference[:, :2] + sign * change
        none = np.zeros(3 * count)
        beta, alpha = self._on_the_path(rows, none, thrice, np.zeros((3 * count, 2)), none)
        rate = (alpha[2 * count :] - alpha[count : 2 * count]) / (2.0 * LOOK_ASIDE)
        _beta, alpha = self._on_the_path(
            reference[:, :2], rate, geometry, beta[:count], alpha[:count]
        )
        return bounded_slip(alpha, rate) if self._knows_slopes else (alpha, rate)

    def _law(self, error: Array, reference: Array, alpha: Array, geometry: Geometry) -> Array:
        """Motion demanded (N, 2)."""
        slip, motion = np.empty((len(error), 3)), np.empty((len(error), 2))
        slip[:, 0] = alpha
        slip[:, 1], slip[:, 2] = self.reference_slip(reference)
        lyapunov_laws.laws(error, reference, slip, True, self.gains, motion)
        return motion


class UnicyclePolicy(SlippageAwarePolicy):
    """The unicycle controller of F 5.1 (uc) as a policy: no slip is known, none is fed forward.

    Arguments as SlippageAwarePolicy, without the slip model.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        gains: LyapunovGains | None = None,
        data_sheet: DataSheet | None = None,
        observation: Sequence[str] = layout.NAMES,
    ) -> None:
        super().__init__(parameters, control_period, NoSlip(), gains, data_sheet, observation)

    def _law(self, error: Array, reference: Array, alpha: Array, geometry: Geometry) -> Array:
        slip, motion = np.empty((0, 3)), np.empty((len(error), 2))
        lyapunov_laws.laws(error, reference, slip, False, self.gains, motion)
        return motion
