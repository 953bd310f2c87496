"""A trajectory from a path and the speed along it, with the sprocket speeds that drive it.

The path is that of the centre: its direction is the course. Slip is added to the belts: with the
speed v_k = V cos(alpha) -+ w B / 2 of each track over the ground,

    r omega_k = v_k + beta_k(omega_L, omega_R)        yaw = course - alpha(omega_L, omega_R)
solved by repeated substitution. The yaw rate in v_k is that of the course, as if alpha were steady.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), (29) to (31) with beta = r omega - v.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.lyapunov.pseudo_kinematic import NoSlip, SlipModel
from baselines.planners.path import Path, end_errors, places
from baselines.planners.speed_profile import SpeedProfile
from baselines.planners.trajectory import Limits, Trajectory, checked_sample_count
from tracked_env.physics.parameters import PlantParameters

Array = NDArray[np.float64]

SUBSTITUTIONS = 60  # at most; slip of identified surfaces converges in 5 to 20
SETTLED = 1e-9  # [rad/s] change of sprocket speeds that ends them
JUMP = 1e-3  # [rad/s] of a sprocket at once, above which a trajectory says so


def sample_times(duration: float, period: float) -> Array:
    """0, period, 2 period, ... and the duration [s]."""
    if duration == 0.0:
        return np.zeros(1)
    whole = np.arange(math.floor(duration / period * (1.0 - 1e-12)) + 1) * period
    return np.append(whole, duration)


def driven(
    path: Path, profile: SpeedProfile, goal: ArrayLike, limits: Limits, vehicle: PlantParameters,
    method: str, slip_model: SlipModel | None = None, message: str = "", period: float = 0.02,
) -> Trajectory:  # fmt: skip
    """The trajectory along `path` with `profile`, sampled every `period` [s] and at its end.

    It has `converged` unset, with a reason, where the sprockets would exceed the limits.
    """
    checked_sample_count(float(profile.time[-1]), period)
    times = sample_times(float(profile.time[-1]), period)
    distance, fast, u = _at(profile, times)
    place = places(path, distance)
    speed, acceleration = place.gear * fast, place.gear * u
    rate = place.curvature * speed
    bend = place.curvature * acceleration + place.sharpness * speed * speed
    left, right, alpha = sprockets(fast * place.gear, rate, vehicle, slip_model)
    alpha_rate = np.gradient(alpha, times) if len(times) > 1 else np.zeros_like(alpha)
    alpha_bend = np.gradient(alpha_rate, times) if len(times) > 1 else np.zeros_like(alpha)
    notes = [message] if message else []
    fastest = max(np.max(np.abs(left)), np.max(np.abs(right)))
    feasible = fastest <= limits.sprocket_used * (1.0 + 1e-9)
    if not feasible:
        notes.append(
            f"with slip the sprockets reach {fastest:.3g} rad/s of {limits.sprocket_used:.3g}"
        )
    if not profile.reached:
        notes.append("the start speed is too high for the limits")
    jump = _largest_jump(path, profile, vehicle)
    if jump > JUMP and math.isfinite(limits.sprocket_acceleration):
        notes.append(f"sprocket speeds jump by {jump:.3g} rad/s where the curvature jumps")
    missed, turned = end_errors(path, goal)
    return Trajectory(
        times, place.x, place.y, place.yaw - alpha, place.yaw, speed, acceleration, rate, bend,
        rate - alpha_rate, bend - alpha_bend, left, right, float(times[-1]),
        feasible and profile.reached, 0, missed, turned, method, "; ".join(notes),
    )  # fmt: skip


def sprockets(
    speed: Array, rate: Array, vehicle: PlantParameters, slip_model: SlipModel | None
) -> tuple[Array, Array, Array]:
    """Sprocket speeds (left, right) [rad/s] and slip angle alpha [rad], (M,) each.

    speed: [m/s] (M,) along the course, rate: [rad/s] (M,) of it.
    """
    turn, radius = 0.5 * vehicle.track_gauge * rate, vehicle.sprocket_radius
    left, right = (speed - turn) / radius, (speed + turn) / radius
    alpha = np.zeros_like(speed)
    if slip_model is None or isinstance(slip_model, NoSlip):
        return left, right, alpha
    for _ in range(SUBSTITUTIONS):
        beta_left, beta_right, alpha = slip_model.slip(left, right)
        forward = speed * np.cos(alpha)
        new = (forward - turn + beta_left) / radius, (forward + turn + beta_right) / radius
        change = max(np.max(np.abs(new[0] - left)), np.max(np.abs(new[1] - right)))
        left, right = new
        if change < SETTLED:
            break
    return left, right, alpha


def _at(profile: SpeedProfile, times: Array) -> tuple[Array, Array, Array]:
    """Distance [m], speed [m/s] and acceleration [m/s^2] at times (M,) [s]."""
    part = np.clip(np.searchsorted(profile.time, times, side="right") - 1, 0, len(profile.time) - 2)
    since, u = times - profile.time[part], profile.acceleration[part]
    speed = np.maximum(profile.speed[part] + u * since, 0.0)
    distance = profile.distance[part] + (profile.speed[part] + 0.5 * u * since) * since
    return np.clip(distance, 0.0, profile.distance[-1]), speed, u


def _largest_jump(path: Path, profile: SpeedProfile, vehicle: PlantParameters) -> float:
    """Largest jump of a sprocket speed [rad/s] where the curvature jumps, ends included."""
    ends = np.cumsum(np.abs(path.length))
    before = np.append(0.0, path.curvature + path.sharpness * path.length)
    jumps = np.abs(np.append(path.curvature, 0.0) - before)
    speed = np.interp(np.append(0.0, ends), profile.distance, profile.speed)
    per_curvature = 0.5 * vehicle.track_gauge / vehicle.sprocket_radius
    return float(np.max(jumps * speed, initial=0.0) * per_curvature)
