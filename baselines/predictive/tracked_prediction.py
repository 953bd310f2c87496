"""Prediction of a torque-driven vehicle over the horizon: its model, reference and cost.

Model. State s = (x, y, e_L, e_R, yaw, v, w): pose of the centre of mass in body axes of the
present, efforts of the drives in units of g c (gain, and torque limit over r), forward speed, yaw
rate. Input u = (u_L, u_R): the command, constant over a stage of h seconds. With a' the value at
its end
    F_k   = g_k c [u_k + (e_k - u_k) T (1 - exp(-h/T)) / h],   e_k' = u_k + (e_k - u_k) exp(-h/T)
    v'    = v + h [(F_L + F_R - R_L - R_R) / m + w v_y + g s_p]          R at v', w
    w'    = w + (h / I) [(B/2) (F_R - R_R - F_L + R_L) + f M(v_y, w')]   R at v', w'
    yaw'  = yaw + h (w + w') / 2,       x', y' by the mean velocity along the mean heading
The lag of the drives is exact, the side slip algebraic, v_y = v_y(v, w) of a steady turn. Friction
is taken at the end of the stage, where an explicit step would oscillate near standstill: v' and w'
are roots of increasing functions, each between 0 and its value without friction. Loads are those of
`tracked_env.physics`, friction smoothed: M(s v_y, s w) has the limits of M and a wider transition.

Assumptions: those of lumped_forces, `sliding`; sprockets below their top speed; on a slope that of
linearizing_law, a plane. Validity: stages shorter than the time in which the path bends.
"""

from typing import NamedTuple

from baselines.linearizing import linearizing_law as law
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import rotation, saturated_sign
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.lumped import Coefficients, torque_decay

X, Y, EFFORT_LEFT, EFFORT_RIGHT, YAW, SPEED, YAW_RATE, LEFT, RIGHT = range(9)  # places in (s, u)
STATES, ROWS, COLUMNS = 7, 5, 7  # of the Riccati stages; rows of `forward` are x, y, yaw, v, w
D_X, D_Y, D_YAW, D_SPEED, D_YAW_RATE = range(5)
# Columns of `forward`, see baselines.riccati; those of the right input and effort are one further.
BY_YAW, BY_SPEED, BY_YAW_RATE, BY_INPUT, BY_EFFORT = 0, 1, 2, 3, 5
RESISTANCE_WIDTH = 0.2  # [m/s] slower tracks meet less motion resistance; twice that of the plant
SMALL = 1e-7  # [rad/s] and [m/s]: differences for slopes of the friction
ROOT_STEPS = 30  # bisection alone ends within 1e-9 of its bracket
ROOT_TOLERANCE = 1e-11  # [rad/s] and [m/s]


class Prediction(NamedTuple):
    """What one stage needs of one vehicle."""

    k: Coefficients  # of the normal load on the vehicle's plane
    duration: float  # [s] h
    decay: float  # [-] exp(-h / T)
    mean_decay: float  # [-] T (1 - exp(-h / T)) / h, mean of that over the stage
    force_left: float  # [N] g_L c
    force_right: float  # [N] g_R c
    smoothing: float  # [-] s
    pull_x: float  # [m/s^2] gravity along the body's x axis
    pull_y: float  # [m/s^2] and y axis
    ahead: float  # [m] of the centre of mass before the middle of the contact


@formula
def prediction(p, k, duration, smoothing, pull_x, pull_y):
    """Prediction from PlantParameters and Coefficients."""
    decay = torque_decay(duration, p.drive_time_constant)
    force = p.torque_limit * k.inverse_radius
    mean = p.drive_time_constant * (1.0 - decay) / duration
    left, right = p.actuator_gain_left * force, p.actuator_gain_right * force
    ahead = p.centre_of_mass_x
    return Prediction(k, duration, decay, mean, left, right, smoothing, pull_x, pull_y, ahead)


@formula
def side_velocity(speed, yaw_rate, m):
    """v_y [m/s] of a steady turn."""
    return law.steady_lateral_velocity(speed, yaw_rate, m.k, m.pull_y, m.ahead)


@formula
def friction_moment(v_y, yaw_rate, m):
    """f M [N m], smoothed, odd and falling in the yaw rate."""
    _force, moment = soil.lateral_friction(
        m.smoothing * v_y, m.smoothing * yaw_rate, m.k.friction_intensity, m.k.contact_length
    )
    return m.k.turning_resistance_factor * moment


@formula
def resistances(speed, yaw_rate, m):
    """(R_L, R_R) [N]."""
    turn = yaw_rate * m.k.half_gauge
    left = saturated_sign(speed - turn, 1.0 / RESISTANCE_WIDTH)
    right = saturated_sign(speed + turn, 1.0 / RESISTANCE_WIDTH)
    return m.k.resistance * left, m.k.resistance * right


@formula
def _resistance_slope(track_speed, m):
    """dR/dV [N s/m] of one track."""
    x = track_speed / RESISTANCE_WIDTH
    return m.k.resistance * max(1.5 * (1.0 - x * x), 0.0) / RESISTANCE_WIDTH


@formula
def _away_from_zero(value):
    """A small difference with the sign of `value`: mirrored motions have mirrored slopes."""
    return SMALL if value >= 0.0 else -SMALL


@formula
def _narrowed(at, excess, slope, low, high):
    """Next guess at the root of an increasing function, its bracket, and whether it is the last.

    A Newton step within the bracket, else its middle.
    """
    low, high = (low, at) if excess > 0.0 else (at, high)
    after = at - excess / slope
    after = after if low <= after <= high else 0.5 * (low + high)
    return after, low, high, abs(after - at) <= ROOT_TOLERANCE


@loop
def end_speed(speed, free, yaw_rate, m):
    """(v', slope): the root of v' = free - (h / m) (R_L + R_R) at v' and w, and dv' / d free [-].

    free [m/s]: speed without resistance; speed [m/s]: where the search begins. Newton steps within
    a bracket that shrinks: at v' = 0 the resistances of both tracks cancel.
    """
    factor, turn = m.duration * m.k.inverse_mass, yaw_rate * m.k.half_gauge
    low, high = min(free, 0.0), max(free, 0.0)
    v, slope = min(max(speed, low), high), 1.0
    for _ in range(ROOT_STEPS):
        left, right = resistances(v, yaw_rate, m)
        slope = 1.0 + factor * (_resistance_slope(v - turn, m) + _resistance_slope(v + turn, m))
        excess = v - free + factor * (left + right)
        v, low, high, done = _narrowed(v, excess, slope, low, high)
        if done:
            break
    return v, 1.0 / slope


@loop
def end_yaw_rate(yaw_rate, free, speed, v_y, m):
    """(w', slope): the root of w' = free + (h / I) [f M(v_y, w') - (B/2) (R_R - R_L)], R at v', w',
    and d w' / d free [-].

    free [rad/s]: yaw rate without friction; yaw_rate [rad/s]: where the search begins; speed: v'.
    """
    k, factor = m.k, m.duration * m.k.inverse_inertia
    low, high = min(free, 0.0), max(free, 0.0)
    w, slope = min(max(yaw_rate, low), high), 1.0
    for _ in range(ROOT_STEPS):
        moment, small, turn = friction_moment(v_y, w, m), _away_from_zero(w), w * k.half_gauge
        left, right = resistances(speed, w, m)
        steep = _resistance_slope(speed - turn, m) + _resistance_slope(speed + turn, m)
        bend = min((friction_moment(v_y, w + small, m) - moment) / small, 0.0)
        slope = 1.0 + factor * (k.half_gauge * k.half_gauge * steep - bend)
        excess = w - free - factor * (moment - k.half_gauge * (right - left))
        w, low, high, done = _narrowed(w, excess, slope, low, high)
        if done:
            break
    return w, 1.0 / slope


@formula
def efforts(effort_left, effort_right, left, right, m):
    """Mean tractive efforts (F_L, F_R) [N] of a stage."""
    return (
        m.force_left * (left + (effort_left - left) * m.mean_decay),
        m.force_right * (right + (effort_right - right) * m.mean_decay),
    )


@formula
def needed_efforts(speed, yaw_rate, next_speed, next_yaw_rate, v_y, m):
    """Mean efforts (F_L, F_R) [N] that take (v, w) to (v', w') in one stage."""
    left, right = resistances(next_speed, yaw_rate, m)
    forward = (next_speed - speed) / m.duration - yaw_rate * v_y - m.pull_x
    total = forward / m.k.inverse_mass + left + right
    left, right = resistances(next_speed, next_yaw_rate, m)
    turning = (next_yaw_rate - yaw_rate) / (m.duration * m.k.inverse_inertia)
    turning -= friction_moment(v_y, next_yaw_rate, m)
    difference = turning / m.k.half_gauge + right - left
    return 0.5 * (total - difference), 0.5 * (total + difference)


@loop
def drive(s, u, m, after):
    """State after one stage, (STATES,) out, from s (STATES,) and u (2,).

    Returns what `differentiate` needs: v_y at both ends, dv' and dw' over those without friction.
    """
    h, k, v, w = m.duration, m.k, s[SPEED], s[YAW_RATE]
    y = side_velocity(v, w, m)
    left, right = efforts(s[EFFORT_LEFT], s[EFFORT_RIGHT], u[0], u[1], m)
    free = v + h * ((left + right) * k.inverse_mass + w * y + m.pull_x)
    next_v, share_v = end_speed(v, free, w, m)
    lever = h * k.inverse_inertia * k.half_gauge
    next_w, share_w = end_yaw_rate(w, w + lever * (right - left), next_v, y, m)
    next_y = side_velocity(next_v, next_w, m)
    mean_v, mean_y, half_turn = 0.5 * (v + next_v), 0.5 * (y + next_y), 0.25 * h * (w + next_w)
    cosine, sine = rotation(s[YAW] + half_turn)
    after[X] = s[X] + h * (mean_v * cosine - mean_y * sine)
    after[Y] = s[Y] + h * (mean_v * sine + mean_y * cosine)
    after[YAW] = s[YAW] + 2.0 * half_turn
    after[SPEED], after[YAW_RATE] = next_v, next_w
    after[EFFORT_LEFT] = u[0] + (s[EFFORT_LEFT] - u[0]) * m.decay
    after[EFFORT_RIGHT] = u[1] + (s[EFFORT_RIGHT] - u[1]) * m.decay
    return y, next_y, share_v, share_w


@formula
def _side_slopes(v, w, y, m):
    """d v_y / dv [-] and d v_y / dw [m] at v_y = y."""
    small_v, small_w = _away_from_zero(v), _away_from_zero(w)
    return (
        (side_velocity(v + small_v, w, m) - y) / small_v,
        (side_velocity(v, w + small_w, m) - y) / small_w,
    )


@loop
def differentiate(s, after, sides, m, forward):
    """forward (COLUMNS, ROWS) out: derivatives of `drive` from s to after, `sides` its answer.

    Columns BY_.., rows D_..; x and y shift x' and y' alone.
    """
    y, next_y, share_v, share_w = sides
    h, k, v, w = m.duration, m.k, s[SPEED], s[YAW_RATE]
    next_v, next_w = after[SPEED], after[YAW_RATE]
    y_v, y_w = _side_slopes(v, w, y, m)
    next_y_v, next_y_w = _side_slopes(next_v, next_w, next_y, m)
    lever = h * k.inverse_inertia * k.half_gauge
    front, back = friction_moment(y + SMALL, next_w, m), friction_moment(y - SMALL, next_w, m)
    by_y = h * k.inverse_inertia * (front - back) / (2.0 * SMALL)
    cosine, sine = rotation(0.5 * (s[YAW] + after[YAW]))
    way_x, way_y = after[X] - s[X], after[Y] - s[Y]

    by_yaw, by_speed, by_turn = forward[BY_YAW], forward[BY_SPEED], forward[BY_YAW_RATE]
    by_yaw[D_X], by_yaw[D_Y], by_yaw[D_YAW] = -way_y, way_x, 1.0
    by_yaw[D_SPEED], by_yaw[D_YAW_RATE] = 0.0, 0.0
    turn, next_turn = w * k.half_gauge, next_w * k.half_gauge
    uneven = _resistance_slope(next_v + turn, m) - _resistance_slope(next_v - turn, m)
    by_speed[D_SPEED] = share_v * (1.0 + h * w * y_v)
    drop = uneven * k.half_gauge * k.inverse_mass
    by_turn[D_SPEED] = share_v * h * (y + w * y_w - drop)
    uneven = _resistance_slope(next_v + next_turn, m) - _resistance_slope(next_v - next_turn, m)
    by_speed[D_YAW_RATE], by_turn[D_YAW_RATE] = by_y * y_v, 1.0 + by_y * y_w
    for side in range(2):
        force = m.force_right if side else -m.force_left
        push, spin = share_v * h * k.inverse_mass * abs(force), lever * force
        by_input, by_effort = forward[BY_INPUT + side], forward[BY_EFFORT + side]
        by_effort[D_SPEED], by_effort[D_YAW_RATE] = push * m.mean_decay, spin * m.mean_decay
        by_input[D_SPEED] = push * (1.0 - m.mean_decay)
        by_input[D_YAW_RATE] = spin * (1.0 - m.mean_decay)
    for c in range(1, COLUMNS):
        column = forward[c]
        column[D_YAW_RATE] = share_w * (column[D_YAW_RATE] - lever * uneven * column[D_SPEED])
        d_v, d_w = column[D_SPEED], column[D_YAW_RATE]
        d_y = next_y_v * d_v + next_y_w * d_w
        if c == BY_SPEED:
            d_v += 1.0
            d_y += y_v
        elif c == BY_YAW_RATE:
            d_w += 1.0
            d_y += y_w
        turned = 0.25 * h * d_w
        column[D_X] = 0.5 * h * (cosine * d_v - sine * d_y) - way_y * turned
        column[D_Y] = 0.5 * h * (sine * d_v + cosine * d_y) + way_x * turned
        column[D_YAW] = 2.0 * turned
