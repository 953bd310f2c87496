"""What the nominal model says of the last control period, in the two channels of the vehicle.

    v_x' = thrust - resistance + pull               each over the nominal mass
    w'   = twist - turning + carried                each over the nominal inertia
from the measured motion and the efforts that the drives have given: the torques measured at the
sprockets, with the loop of `drive_loop` around each drive. Loads of the ground,
those of `lumped_forces`, are the mean of both ends of the period. v_y is that of a steady turn with
the measured speed and yaw rate: the measured one is noisier than it is informative.
"""

from typing import NamedTuple

from baselines.augmented.drive_loop import DRIVE_COLUMNS, drive_period
from baselines.linearizing import linearizing_law as law
from baselines.linearizing.linearizing_policy import incline_seen
from tracked_env.observation import INDEX, SCALE
from tracked_env.physics import lumped_forces as plant
from tracked_env.physics import terramechanics as soil
from tracked_env.physics import vehicle
from tracked_env.physics.jit import formula

# Columns of a row of the adaptation: both drives, the measured motion, whether there is one; then
# those of the adaptation.
SPEED = 2 * DRIVE_COLUMNS
YAW_RATE, MEASURED, OWN = SPEED + 1, SPEED + 2, SPEED + 3
_V_X, _W, _COMMAND = INDEX["v_x"], INDEX["yaw_rate"], INDEX["previous_action_left"]
_FREE = plant.TractionLimits(-1e30, 1e30, -1e30, 1e30)


class Channels(NamedTuple):
    """Terms of both channels, at one moment or as a mean."""

    thrust: float  # [m/s^2] of both tracks
    resistance: float  # [m/s^2] of both tracks, subtracted
    pull: float  # [m/s^2] w v_y, and gravity on a slope
    twist: float  # [rad/s^2] of the difference of the efforts
    turning: float  # [rad/s^2] moment that resists the turn, subtracted
    carried: float  # [rad/s^2] coupling with the speed, `constrained` only


@formula
def channels_of(v_x, yaw_rate, torque_left, torque_right, k, constrained, incline):
    """Channels at a measured motion under these torques [N m] with the nominal Coefficients."""
    across = soil.GRAVITY * incline.down_y
    v_y = law.steady_lateral_velocity(v_x, yaw_rate, k, across)
    v_y = -k.icr_forward * yaw_rate if constrained else v_y
    motion = vehicle.Motion(v_x, v_y, yaw_rate)
    if constrained:
        f = plant.constrained_loads(motion, torque_left, torque_right, k, _FREE)
    else:
        f = plant.sliding_loads(motion, torque_left, torque_right, k, _FREE)
    arm = k.icr_forward if constrained else 0.0
    uneven = k.half_gauge * (f.resistance_right - f.resistance_left)
    return Channels(
        (f.effort_left + f.effort_right) * k.inverse_mass,
        (f.resistance_left + f.resistance_right) * k.inverse_mass,
        yaw_rate * v_y + soil.GRAVITY * incline.down_x,
        k.half_gauge * (f.effort_right - f.effort_left) * k.inverse_inertia,
        (uneven - f.turning_moment + arm * f.lateral_force) * k.inverse_inertia,
        arm * yaw_rate * v_x * k.inverse_inertia / k.inverse_mass,
    )  # fmt: skip


@formula
def _mean(first, second):
    """Mean of the Channels at both ends of a period."""
    return Channels(
        0.5 * (first.thrust + second.thrust),
        0.5 * (first.resistance + second.resistance),
        0.5 * (first.pull + second.pull),
        0.5 * (first.twist + second.twist),
        0.5 * (first.turning + second.turning),
        0.5 * (first.carried + second.carried),
    )  # fmt: skip


class Period(NamedTuple):
    """The last control period of one vehicle."""

    mean: Channels
    speed_change: float  # [m/s] of v_x
    yaw_rate_change: float  # [rad/s]
    known: bool  # False in the first call of an episode


@formula
def last_period(observation, i, torques, memory, p, drive_bandwidth, period, constrained, sloped):
    """Period of vehicle i since the last call; its row of memory (N, >= OWN) is brought up to now.

    observation (N, >= SIZE) filtered; torques (N, 2) [N m] measured or NaN; p: nominal.
    """
    incline = incline_seen(observation, i, sloped)
    k = law.pressed(vehicle.coefficients(p, constrained), incline.press)
    lag, limit = p.drive_time_constant, p.torque_limit
    decay = vehicle.torque_decay(period, lag)
    left = limit * drive_period(
        memory, i, 0, observation[i, _COMMAND], torques[i, 0] / limit, decay, lag,
        drive_bandwidth, period,
    )  # fmt: skip
    right = limit * drive_period(
        memory, i, DRIVE_COLUMNS, observation[i, _COMMAND + 1], torques[i, 1] / limit, decay, lag,
        drive_bandwidth, period,
    )  # fmt: skip
    v_x, yaw_rate = observation[i, _V_X] * SCALE[_V_X], observation[i, _W] * SCALE[_W]
    before_v, before_w = memory[i, SPEED], memory[i, YAW_RATE]
    first = channels_of(before_v, before_w, left, right, k, constrained, incline)
    second = channels_of(v_x, yaw_rate, left, right, k, constrained, incline)
    known = memory[i, MEASURED] > 0.0
    memory[i, SPEED], memory[i, YAW_RATE], memory[i, MEASURED] = v_x, yaw_rate, 1.0
    return Period(_mean(first, second), v_x - before_v, yaw_rate - before_w, known)
