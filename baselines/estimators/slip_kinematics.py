"""Kinematics of a slipping tracked vehicle as an observer needs it: process and sensors.

State x = [X, Y, psi, i_L, i_R, alpha]; input: belt speeds V_t = omega r. With the gain of a track
g = V / V_t (terramechanics.track_speed_from_belt at V_t = 1), t = tan(alpha):
    V_L = g_L V_tL, V_R = g_R V_tR,  v_x = (V_L + V_R) / 2,  w = (V_R - V_L) / B,  v_y = t v_x
    X+   = X + dt v_x (cos(psi_m) - t sin(psi_m)),   psi_m = psi + w dt / 2
    Y+   = Y + dt v_x (sin(psi_m) + t cos(psi_m)),   psi+ = psi + w dt      S 7.2.2, ISO sign
    i_L, i_R, alpha: random walks
On a slope X, Y, psi are those of the map: (v_x, t v_x) -> `attitude.on_map`, w -> d psi/dt by the
measured roll, pitch and rate of pitch; belts, velocities and the gyro stay in the vehicle's plane.
    z    = [X, Y, psi, v_x, v_y, w], taken `age` ago (see dead_reckoning)
Belt speeds act as the mean over the step, with noise s = r sigma_omega (see slip_covariance).
Errors in variables: the same noise is in z - h and in dh/di = -V_t, whose product would not average
to zero (0.003 of slip with 0.1 rad/s). So the belt speed one step earlier multiplies what depends
on the sigma point, as an instrumental variable: V = g_mean V_t + (g - g_mean) V_t,earlier.

A track that stands tells nothing about its slip: noise of its sprocket would pass for full slip.
So deviations of the sigma points from the mean fade out with the belt speed (the sample then
does not change what is held). The same holds for alpha and v_x.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 3 and 7.2.
"""

import math
from typing import NamedTuple

from baselines.estimators.dead_reckoning import Way
from baselines.estimators.sensor_samples import DataSheet
from tracked_env.physics.attitude import heading_rate, on_map
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.terramechanics import track_speed_from_belt

NAMES = ("x", "y", "yaw", "slip_left", "slip_right", "side_slip")
STATES = len(NAMES)
X, Y, YAW, SLIP_LEFT, SLIP_RIGHT, SIDE_SLIP = range(STATES)
ROWS = 6  # of z: X, Y, psi, v_x, v_y, w

SLIP_LIMIT = 0.98  # [-] bound of the estimated slips, inside the physical +-1
SIDE_SLIP_LIMIT = 1.0  # [rad] bound of the estimated alpha
SIDE_SLIP_MODELLED = 1.2  # [rad] sigma points beyond it count as this: tan must stay moderate
PRIOR_SLIP = 0.3  # [-] sigma of a slip nothing is known about: most soils stay below it
PRIOR_SIDE_SLIP = 0.3  # [rad] the same for alpha
STANDING_BELT = 0.03  # [m/s] a belt slower than this plus 3 sigma of its noise stands
STANDING_VEHICLE = 0.1  # [m/s] v_x below which alpha = atan(v_y / v_x) is not observed
BELT_SIGMAS = 5.0  # [-] of its noise: a belt that changes by more within a step really moves
BIAS_WINDOW = 0.5  # [s] over it the gyro's bias does not average out, the noise does
SILENCE = 0.25  # [s] a pose that is only late or rare comes within it, see slip_outage
BLENDING = 0.5  # [s] time constant with which what is shown follows the first pose after an outage
LEAST_SIGMA = 1e-4  # [m, rad, m/s, rad/s] of ideal sensors: keeps the covariance well conditioned


class Constants(NamedTuple):
    """All numbers of the model, as the kernels take them."""

    period: float  # [s] dt
    radius: float  # [m] r
    inverse_gauge: float  # [1/m] 1 / B
    belt_variance: float  # [m^2/s^2] s^2
    standing_belt: float  # [m/s]
    position_variance: float  # [m^2]
    yaw_variance: float  # [rad^2]
    velocity_variance: float  # [m^2/s^2]
    yaw_rate_variance: float  # [rad^2/s^2]
    position_drift: float  # [m^2] variance per step
    yaw_drift: float  # [rad^2] per step
    slip_drift: float  # [-] per step
    side_slip_drift: float  # [rad^2] per step
    gate: float  # [-] NIS of an outlier
    rows: float  # [-] of z that are used: 3 or 6
    silence: float  # [steps] without pose that are more than a late or rare one
    acceleration_variance: float  # [m^2/s^4]
    bias_variance: float  # [m^2/s^4] of the accelerometer, before anything is known of it
    gyro_variance: float  # [rad^2/s^2] white
    turn_bias_variance: float  # [rad^2/s^2] of the gyro
    contact_length: float  # [m] l
    constrained: float  # [-] 1 with the constrained lateral model, else 0
    icr_forward: float  # [m] d, of that model
    fading: float  # [-] share of the gap behind an outage that is left after a step


class Inputs(NamedTuple):
    """What drives one step of one vehicle: belts [m/s], their directions, and the fading."""

    belt_left: float  # mean over the step
    belt_right: float
    direction_left: float  # [-] -1 or 1
    direction_right: float
    slip_left: float  # [-] mean of the state, from which sigma points deviate
    slip_right: float
    side_slip: float  # [rad]
    fade_left: float  # [-] 0 = the track stands, 1 = it moves
    fade_right: float
    fade_side: float
    gain_left: float  # [-] g at the mean
    gain_right: float
    ahead: float  # [-] way on the map along the heading per way forward; 1 on level ground
    cross: float  # [-] the same per way to the left; 0
    aside: float  # [-] way on the map to the left per way to the left; 1
    turn: float  # [-] d psi/dt = turn w + carried; 1
    carried: float  # [rad/s] 0
    steep: float  # [-] squared sine of the tilt
    press: float  # [-] normal load over the weight
    common: float  # [-] variance per step of what both slips share; -1: they walk on their own


def make_constants(
    parameters: PlantParameters,
    period: float,
    sheet: DataSheet,
    drifts: tuple[float, float, float, float],
    gate: float,
    rows: int,
    lateral: str,
) -> Constants:
    """Constants from the nominal parameters, the data sheet and drifts per sqrt(second)."""
    radius = parameters.sprocket_radius
    belt_sigma = radius * sheet.sprocket_speed_noise
    bias = sheet.gyro_bias**2 * max(BIAS_WINDOW / period, 1.0)
    numbers = (
        period,
        radius,
        1.0 / parameters.track_gauge,
        belt_sigma**2,
        STANDING_BELT + 3.0 * belt_sigma,
        max(sheet.position_noise, LEAST_SIGMA) ** 2,
        max(sheet.yaw_noise, LEAST_SIGMA) ** 2,
        max(sheet.velocity_noise, LEAST_SIGMA) ** 2,
        max(sheet.gyro_noise, LEAST_SIGMA) ** 2 + bias,
        *(drift * drift * period for drift in drifts),
        gate,
        rows,
        SILENCE / period if rows == ROWS else math.inf,
        sheet.acceleration_noise**2,
        max(sheet.acceleration_bias, LEAST_SIGMA) ** 2,
        max(sheet.gyro_noise, LEAST_SIGMA) ** 2,
        max(sheet.gyro_bias, LEAST_SIGMA) ** 2,
        parameters.contact_length,
        lateral == "constrained",
        parameters.icr_forward,
        math.exp(-period / BLENDING),
    )
    return Constants(*(float(number) for number in numbers))


@formula
def ramp(speed, standing):
    """0 [-] below the speed `standing`, 1 from twice that speed on, linear between."""
    return min(max(abs(speed) / standing - 1.0, 0.0), 1.0)


@formula
def make_inputs(
    last_left, last_right, left, right, slip_left, slip_right, side_slip, incline, pitch_rate,
    common, k,
):  # fmt: skip
    """Inputs of a step in which the belts went from `last` to the present speeds [m/s]."""
    ahead, _ = on_map(1.0, 0.0, incline)
    cross, aside = on_map(0.0, 1.0, incline)
    turn, carried = heading_rate(incline, pitch_rate)
    mean_left, mean_right = 0.5 * (last_left + left), 0.5 * (last_right + right)
    forward = 0.5 * (mean_left + mean_right)
    direction_left = 1.0 if mean_left >= 0.0 else -1.0
    direction_right = 1.0 if mean_right >= 0.0 else -1.0
    return Inputs(
        mean_left, mean_right, direction_left, direction_right, slip_left, slip_right, side_slip,
        ramp(mean_left, k.standing_belt),
        ramp(mean_right, k.standing_belt),
        ramp(forward, max(STANDING_VEHICLE, k.standing_belt)),
        track_speed_from_belt(1.0, direction_left * slip_left),
        track_speed_from_belt(1.0, direction_right * slip_right),
        ahead, cross, aside, turn, carried,
        incline.down_x * incline.down_x + incline.down_y * incline.down_y,
        incline.press,
        common,
    )  # fmt: skip


@formula
def gains(slip_left, slip_right, side_slip, u):
    """(g_L, g_R, tan alpha) [-] of a sigma point, its deviations faded."""
    left = u.slip_left + u.fade_left * (slip_left - u.slip_left)
    right = u.slip_right + u.fade_right * (slip_right - u.slip_right)
    angle = u.side_slip + u.fade_side * (side_slip - u.side_slip)
    c, s = rotation(min(max(angle, -SIDE_SLIP_MODELLED), SIDE_SLIP_MODELLED))
    return (
        track_speed_from_belt(1.0, u.direction_left * left),
        track_speed_from_belt(1.0, u.direction_right * right),
        s / c,
    )


@formula
def body_velocity(left, right, belt_left, belt_right, tangent, k):
    """(v_x, v_y [m/s], w [rad/s]) from the gains and belt speeds of both tracks."""
    v_left, v_right = left * belt_left, right * belt_right
    forward = 0.5 * (v_left + v_right)
    return forward, tangent * forward, (v_right - v_left) * k.inverse_gauge


@formula
def process(x, y, yaw, slip_left, slip_right, side_slip, u, k):
    """(X, Y, psi) one step later; the other states stay."""
    left, right, tangent = gains(slip_left, slip_right, side_slip, u)
    forward, side, w = body_velocity(left, right, u.belt_left, u.belt_right, tangent, k)
    v_x, v_y, rate = u.ahead * forward + u.cross * side, u.aside * side, u.turn * w + u.carried
    c, s = rotation(yaw + 0.5 * rate * k.period)
    return (
        x + k.period * (v_x * c - v_y * s),
        y + k.period * (v_x * s + v_y * c),
        yaw + k.period * rate,
    )


@formula
def measured(x, y, yaw, slip_left, slip_right, side_slip, u, way, gyro, k):
    """z = (X, Y, psi, v_x, v_y, w): the pose group when `way` began, w when `gyro` began."""
    left, right, tangent = gains(slip_left, slip_right, side_slip, u)
    east = 0.5 * (left * way.c_left + right * way.c_right)
    north = 0.5 * (left * way.s_left + right * way.s_right)
    more_left, more_right = left - u.gain_left, right - u.gain_right
    v_left = u.gain_left * way.belt_left + more_left * way.instrument_left
    v_right = u.gain_right * way.belt_right + more_right * way.instrument_right
    w_left = u.gain_left * gyro.belt_left + more_left * gyro.instrument_left
    w_right = u.gain_right * gyro.belt_right + more_right * gyro.instrument_right
    forward = 0.5 * (v_left + v_right)
    return (
        x - east + tangent * north,
        y - north - tangent * east,
        yaw - (right * way.d_right - left * way.d_left) * k.inverse_gauge,
        forward,
        tangent * forward,
        (w_right - w_left) * k.inverse_gauge,
    )


@formula
def instrument(earlier, belt, k):
    """`earlier`, unless the belt [m/s] has really changed since: then its noise matters less."""
    return earlier if abs(belt - earlier) < BELT_SIGMAS * math.sqrt(k.belt_variance) else belt


@formula
def step_way(yaw, left, right, u, k):
    """Way of one step with heading `yaw` in its middle and belts `left`, `right` at its end."""
    c, s = rotation(yaw)
    d_left, d_right = k.period * u.belt_left, k.period * u.belt_right
    c, s = u.ahead * c, u.ahead * s
    return Way(
        u.turn * d_left, u.turn * d_right, c * d_left, s * d_left, c * d_right, s * d_right,
        left, right, left, right,
    )  # fmt: skip
