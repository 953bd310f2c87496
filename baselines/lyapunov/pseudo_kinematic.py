"""Pseudo-kinematic model of a tracked vehicle: a unicycle whose belts slip and which drifts.

    x'   = v_x / cos(alpha) cos(yaw + alpha) = v_x (cos(yaw) - tan(alpha) sin(yaw))   (27)
    y'   = v_x / cos(alpha) sin(yaw + alpha) = v_x (sin(yaw) + tan(alpha) cos(yaw))
    yaw' = w
    v_x  = (r omega_L - beta_L + r omega_R - beta_R) / 2                              (29)
    w    = (r omega_R - beta_R - r omega_L + beta_L) / B
Slip velocity beta = r omega - v_track [m/s] is positive when driving; (29) and (31) of F print
the opposite sign. alpha = atan(v_y / v_x) [rad], for both directions of v_x, so it is negative
in a left turn driving forward, and changes sign with both sprocket speeds.
A slip model gives beta_L, beta_R and alpha from the two sprocket speeds, (32) and (33).

Within a step the sprocket speeds are held. Then yaw is linear in time, and fourth-order
Runge-Kutta is Simpson's rule for the position.

Assumption: slip in steady state; no inertia. Validity: |alpha| < pi / 2.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), section 3.2.
"""

import math
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.lyapunov import lyapunov_laws as law
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import RANGES, PlantParameters

MAXIMUM_SLIP_ANGLE = 1.0  # [rad] |alpha| is bounded here: cos(alpha) stays away from 0
SLOW = 0.05  # [m/s] below this speed alpha fades out: at standstill it has no sign and no use
DRIFT_TIME = 1.0  # [s] over which such an error keeps its sign
SPIRAL_SPEED = 0.3  # [m/s] v_d of the spiral of F, figure 10
SPIRAL_YAW_ACCELERATION = 0.05  # [rad/s^2] its yaw rate over t; F prints 4 t, see `Spiral`

Array = NDArray[np.float64]


class SlipModel(Protocol):
    """Steady slip of a vehicle as a function of its sprocket speeds."""

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> tuple[Array, Array, Array]:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], (N,) each."""


@runtime_checkable
class SlopeAwareSlipModel(Protocol):
    """The same on any slope."""

    def on(self, grade: Array) -> SlipModel:
        """The slip model of vehicles that feel grades (N, 2), see `slip.slope_models`."""


class NoSlip:
    """The slip model of a unicycle: none."""

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> tuple[Array, Array, Array]:
        """Three arrays of zeros, (N,)."""
        none = np.zeros(np.shape(sprocket_left))
        return none, none.copy(), none.copy()


class Geometry(NamedTuple):
    """Lengths and limits of a vehicle for the kinematics, (N,) each, or (1,) for all alike."""

    half_gauge: Array  # [m] B / 2
    radius: Array  # [m] r
    limit: Array  # [rad/s] of a sprocket, both directions

    @classmethod
    def of(cls, parameters: PlantParameters) -> "Geometry":
        """From the parameters of a plant, each a number or (N,).

        Raises ValueError for a value outside its physical range, or lengths that disagree.
        """
        names = ("track_gauge", "sprocket_radius", "sprocket_speed_limit")
        arrays = [np.atleast_1d(np.asarray(getattr(parameters, n), dtype=float)) for n in names]
        for name, array in zip(names, arrays, strict=True):
            low, high, unit, hint = RANGES[name]
            inside = (array >= low) & (array <= high)  # NaN is outside
            if not inside.all():
                raise ValueError(
                    f"{name} = {array[~inside][0]:g} {unit}; must be in [{low:g}, {high:g}] "
                    f"{unit}. {hint}"
                )
        try:
            gauge, radius, limit = (np.array(a) for a in np.broadcast_arrays(*arrays))
        except ValueError as error:
            raise ValueError(
                f"{names} have lengths {[len(a) for a in arrays]}; must be 1 or one N"
            ) from error
        return cls(0.5 * gauge, radius, limit)

    def rows(self, count: int) -> "Geometry":
        """The same for `count` vehicles. Raises ValueError where it is that of another number."""
        if len(self.radius) not in (1, count):
            raise ValueError(f"{count} vehicles but parameters of {len(self.radius)}")
        return Geometry(*(np.array(np.broadcast_to(a, (count,))) for a in self))


@formula
def pose_rate(yaw, v_x, alpha):
    """World velocity (x', y') [m/s] of (27); v_x [m/s] signed, yaw and alpha [rad]."""
    cosine, sine = rotation(yaw)
    slip_cosine, slip_sine = rotation(alpha)
    v_y = v_x * slip_sine / slip_cosine
    return v_x * cosine - v_y * sine, v_x * sine + v_y * cosine


@formula
def pose_step(x, y, yaw, motion, alpha, duration):
    """Pose (x, y [m], yaw [rad]) after `duration` [s] of (27) at constant BodyMotion and alpha.

    One step of RK4; error v_x duration (w duration)^4 / 2880 [m].
    """
    turn = motion.yaw_rate * duration
    x_0, y_0 = pose_rate(yaw, motion.speed, alpha)
    x_1, y_1 = pose_rate(yaw + 0.5 * turn, motion.speed, alpha)
    x_2, y_2 = pose_rate(yaw + turn, motion.speed, alpha)
    sixth = duration / 6.0
    return x + sixth * (x_0 + 4.0 * x_1 + x_2), y + sixth * (y_0 + 4.0 * y_1 + y_2), yaw + turn


@formula
def carried(error, v_x, v_y, yaw_rate, speed, turn, duration):
    """PoseError after `duration` [s]: vehicle at (v_x, v_y [m/s], yaw_rate [rad/s]), reference
    at (speed, turn). Midpoint rule; position in the body axes of the end."""
    half = 0.5 * duration
    c, s = rotation(yaw_rate * half)
    c_h, s_h = rotation(error.heading + (yaw_rate - turn) * half)
    x = c * error.x + s * error.y + (v_x - speed * c_h) * duration
    y = c * error.y - s * error.x + (v_y + speed * s_h) * duration
    return law.PoseError(c * x + s * y, c * y - s * x, error.heading + (yaw_rate - turn) * duration)


def steady_gain(noise: float, rate_noise: float, drift: float, period: float) -> float:
    """Kalman gain K [-] for dead reckoning against samples of `noise`, in steady state.

    The rate has white noise `rate_noise` every `period` [s], and an error `drift` of both signs
    over DRIFT_TIME. 1 without noise: the sample is taken as it is.
    """
    if noise <= 0.0:
        return 1.0
    grown = (rate_noise * period) ** 2 + drift * drift * period * DRIFT_TIME
    ratio = grown / (noise * noise)
    return 0.5 * (math.sqrt(ratio * ratio + 4.0 * ratio) - ratio)


@formula
def faded(alpha, speed):
    """Slip angle [rad] to work with: bounded, smoothly 0 towards standstill, 0 for NaN."""
    x = min(abs(speed) / SLOW, 1.0)
    bounded = min(max(alpha, -MAXIMUM_SLIP_ANGLE), MAXIMUM_SLIP_ANGLE)
    return bounded * (x * x * (3.0 - 2.0 * x)) if alpha == alpha else 0.0


@loop
def step_all(pose, motion, alpha, duration):
    """`pose_step` of N vehicles: pose (N, 3) in and out, motion (N, 2), alpha (N,)."""
    for i in range(pose.shape[0]):
        pose[i, 0], pose[i, 1], pose[i, 2] = pose_step(
            pose[i, 0], pose[i, 1], pose[i, 2],
            law.BodyMotion(motion[i, 0], motion[i, 1]), alpha[i], duration,
        )  # fmt: skip


@loop
def settle(sprockets, slip, half_gauge, radius, beta, alpha, motion):
    """What sprockets (N, 2) [rad/s] and a model's slip (N, 3) mean: (N, 2) beta, (N,) alpha faded,
    (N, 2) motion, all out; beta is 0 where the model knows none."""
    for i in range(sprockets.shape[0]):
        for side in range(2):
            beta[i, side] = slip[i, side] if math.isfinite(slip[i, side]) else 0.0
        r = radius[i]
        m = law.body_motion(
            sprockets[i, 0] * r, sprockets[i, 1] * r, beta[i, 0], beta[i, 1], half_gauge[i]
        )
        motion[i, 0], motion[i, 1] = m.speed, m.yaw_rate
        alpha[i] = faded(slip[i, 2], m.speed)


@loop
def along_slip(reference, alpha, alpha_rate, motion):
    """BodyMotion (N, 2) of a vehicle on its path: v_d cos(alpha_d), w_d - alpha_d'."""
    for i in range(alpha.shape[0]):
        cosine, _sine = rotation(alpha[i])
        motion[i, 0] = reference[i, 0] * cosine
        motion[i, 1] = reference[i, 1] - alpha_rate[i]


class PseudoKinematicModel:
    """N vehicles that obey (27) and (29) with the slip of a model.

    parameters: track_gauge, sprocket_radius and sprocket_speed_limit are used. slip_model:
    None is a unicycle. Raises ValueError for parameters outside their physical range.
    """

    def __init__(self, parameters: PlantParameters, slip_model: SlipModel | None = None) -> None:
        self.geometry = Geometry.of(parameters)
        self.slip_model: SlipModel = NoSlip() if slip_model is None else slip_model

    def motion(self, sprockets: Array) -> tuple[Array, Array]:
        """Motion (N, 2) of v_x [m/s] and w [rad/s], and alpha (N,), at sprockets (N, 2)."""
        geometry = self.geometry.rows(len(sprockets))
        left, right, alpha = self.slip_model.slip(sprockets[:, 0], sprockets[:, 1])
        motion = np.empty((len(sprockets), 2))
        law.motions_of(
            sprockets, np.stack([left, right], axis=1), geometry.half_gauge, geometry.radius, motion
        )
        return motion, alpha

    def step(self, pose: ArrayLike, sprockets: Array, duration: float) -> Array:
        """Pose (N, 3) after `duration` [s] at held sprocket speeds (N, 2) [rad/s].

        Raises ValueError for a duration that is not positive and finite.
        """
        if not 0.0 < duration < math.inf:
            raise ValueError(f"duration = {duration} s; must be positive. Is the step reversed?")
        after = np.array(pose, dtype=np.float64)
        motion, alpha = self.motion(sprockets)
        step_all(after, motion, alpha, duration)
        return after


class Spiral(NamedTuple):
    """The reference of F, figure 10: constant speed, yaw rate w_d = yaw_acceleration t.

    F prints w_d = 4 t in no unit. In rad/s it needs sprockets of 10 rad/s, the end of F's own
    data, after 0.5 s and a radius of 1 cm after 8 s. The default reaches 1 rad/s, a radius of
    0.3 m, in 20 s.
    """

    speed: float = SPIRAL_SPEED  # [m/s] v_d
    yaw_acceleration: float = SPIRAL_YAW_ACCELERATION  # [rad/s^2] dw_d / dt

    def yaw_rate(self, time: float) -> float:
        """w_d [rad/s] at `time` [s]."""
        return self.yaw_acceleration * time

    def advance(self, pose: Array, time: float, duration: float) -> Array:
        """Reference pose (3,) at time + duration [s]; `pose` is that at `time`. RK4 of (35)."""
        middle, end = time + 0.5 * duration, time + duration
        start, bend = pose[2], 0.5 * self.yaw_acceleration
        halfway = start + bend * (middle * middle - time * time)
        final = start + bend * (end * end - time * time)
        yaws = np.array([start, halfway, final])
        weights = np.array([1.0, 4.0, 1.0]) * self.speed * duration / 6.0
        return np.array([pose[0] + weights @ np.cos(yaws), pose[1] + weights @ np.sin(yaws), final])
