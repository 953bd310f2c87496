"""Normal load and shear of the patches under two tracks on uneven ground.

Equations, for the patch at r = (x, y, -h) from the centre of mass in body axes, at P in the world
(symbols in NOTATION.md; x_m = x + c_x is from the middle of the tracks, c ahead of it the centre
of mass; k_A, d_A those of the patch):
    n    = (-h_x, -h_y, 1) / sqrt(1 + h_x^2 + h_y^2)          normal of the ground
    rho  = (h(P) - P_z) n_z,  u = v + W x r,  rho' = -n . u    sinkage and its rate
    N    = A_p max(0, k_A s rho + d_A rho'),  s = 1 + K_tp v_x (x_m + sign(v_x) l);  0 if rho <= 0
    t    = unit of P_n x_b,  q = n x t,  P_n a = a - (a . n) n  axes of the contact plane
    s    = (u_t - v', u_q),  v' = v_s |P_n x_b|                shear velocity
    T    = (l - sign(v_s) x_m) / |v_s|,  th = T n . W          time and turn since first contact
    j    = T |(u_t S - v' - u_q C, u_t C + u_q S)|,  S = sin(th)/th,  C = (1 - cos(th))/th
    k    = (c A_p + mu N) (1 - exp(-j/K)) / |s|                shear resistance [N s/m]
    f    = N n - k s - c_r N g(u_t) t,  g(u) = u / sqrt(u^2 + w^2)
A patch without contact (rho <= 0 or N = 0) has no force, cohesion included. All forces act at P, so
each has the moment r x f. On level ground this is `patch_forces`, and beyond HISTORY_TURN the
displacement is raised as it is there.

The passes, one loop each, because short loops keep more patches in flight: `locate` says where the
patches are, a terrain fills heights and slopes, `orient` makes the axes of contact; at a motion,
`press` gives the loads, `slide` and `resist` the shear; `contact_totals` adds up. In body axes with
n = (a, b, c) and g = |P_n x_b| = sqrt(b^2 + c^2):  t = (g, -a b/g, -a c/g),  q = (0, c, -b)/g.

Assumptions: the ground is a plane under each patch, motion is steady during contact, a patch meets
the soil at the leading end of its track even where that hangs free.
References: [1] Focchi et al. (2025) sections 2.1 to 2.3, whose load model is corrected here; see
docs/terrain.md.
"""

import math
from typing import NamedTuple

from tracked_env.physics.elementary import exponential, rotation
from tracked_env.physics.jit import formula, summation
from tracked_env.physics.patch_forces import (
    BELT_SPEED_FLOOR,
    HISTORY_RISE,
    HISTORY_TURN,
    SHEAR_SPEED_FLOOR,
    SMALLEST_TURN,
    TURN_LIMIT,
)

ROLLING_SPEED = 0.01  # [m/s] w: slower patches meet less rolling resistance
AXIS_FLOOR = 1e-24  # [-] keeps 0/0 out where the body's x axis is along the normal
SHORT_TURN = 0.5 * math.pi  # [rad] up to it a short series does for S and C
WIDE = 8  # lanes are filled up to a multiple of this: the vectors of the processor
LANES = 1288  # two tracks of 80 x 8 patches; an odd number of cache lines from row to row

# Rows of the scratch array; a lane is a patch, the left track first.
(
    PLACE_X, PLACE_Y, HEIGHT, SLOPE_X, SLOPE_Y,  # of the terrain
    X, Y, PLACE_Z, FRICTION, ADHESION, INVERSE_MODULUS, ROLLING, FIRMNESS, BELT, TIME,
    SINKAGE, N_X, N_Y, N_Z, AHEAD, INVERSE_AHEAD, LOAD, FORWARD, SLIDE, ASIDE, SHEARED,
    OLD_SLIDE, OLD_ASIDE, THRUST, LATERAL, ROLLED, K_TT, K_TQ, K_QQ, K_ROLL,
) = range(35)  # fmt: skip
SCRATCH_ROWS = 35


class Twist(NamedTuple):
    """Velocity of the centre of mass and angular velocity, body axes; or six of their rates."""

    x: float  # [m/s]
    y: float  # [m/s]
    z: float  # [m/s]
    roll: float  # [rad/s]
    pitch: float  # [rad/s]
    yaw: float  # [rad/s]


class Footing(NamedTuple):
    """Geometry of the tracks and springs of the soil, the same for all patches."""

    height: float  # [m] h, centre of mass above the plane of the tracks
    half_length: float  # [m] l
    patch_area: float  # [m^2] A_p
    stiffness: float  # [N/m^3] k_A, per area
    damping: float  # [N s/m^3] d_A, per area
    stiffening: float  # [s/m^2] K_tp
    ahead: float  # [m] c_x, centre of mass ahead of the middle of the tracks
    aside: float  # [m] c_y, to the left of it


@formula
def padded(count):
    """Lanes of `count` patches, filled up."""
    return (count + WIDE - 1) // WIDE * WIDE


@formula
def place_patches(w, columns, rows, half_gauge, track_width, f):
    """Rows X, Y [m] of the patches from the centre of mass; f: Footing.

    columns, rows: their middles over half the length and over the width of a track.
    Returns the number of lanes; those after the last patch have no sinkage ever.
    """
    lane = 0
    for side in range(2):
        middle = -half_gauge if side else half_gauge
        for row in range(rows.size):
            for column in range(columns.size):
                w[X, lane] = columns[column] * f.half_length - f.ahead
                w[Y, lane] = middle + rows[row] * track_width - f.aside
                lane += 1
    lanes = padded(lane)
    for row in range(SCRATCH_ROWS):
        for empty in range(lane, lanes):
            w[row, empty] = 0.0
    return lanes


@formula
def set_belt(w, first, last, speed, f):
    """Rows BELT, TIME of the lanes of one track whose belt moves at `speed` [m/s]; f: Footing."""
    size = max(abs(speed), BELT_SPEED_FLOOR)
    moving = abs(speed) / size  # 1, or less below the floor: a belt that stands has no first end
    ahead = moving if speed >= 0.0 else -moving
    inverse = 1.0 / size
    first_end = f.half_length - ahead * f.ahead  # from the centre of mass, along the motion
    for lane in range(first, last):
        w[BELT, lane] = speed
        w[TIME, lane] = (first_end - ahead * w[X, lane]) * inverse


@formula
def locate(w, lanes, p, r, height):
    """Rows PLACE_X, PLACE_Y, PLACE_Z [m]: the patches in the world; centre of mass p, axes r."""
    low_x, low_y = p[0] - r.xz * height, p[1] - r.yz * height
    low_z = p[2] - r.zz * height
    for lane in range(lanes):
        x, y = w[X, lane], w[Y, lane]
        w[PLACE_X, lane] = low_x + (r.xx * x + r.xy * y)
        w[PLACE_Y, lane] = low_y + (r.yx * x + r.yy * y)
        w[PLACE_Z, lane] = low_z + (r.zx * x + r.zy * y)


@summation
def orient(w, lanes, r):
    """Rows SINKAGE [m], N_X, N_Y, N_Z, AHEAD, INVERSE_AHEAD [-] from heights and slopes."""
    for lane in range(lanes):
        a, b = w[SLOPE_X, lane], w[SLOPE_Y, lane]
        steep = math.sqrt(1.0 + a * a + b * b)
        n_x = r.zx - (r.xx * a + r.yx * b)
        n_y = r.zy - (r.xy * a + r.yy * b)
        n_z = r.zz - (r.xz * a + r.yz * b)
        across = math.sqrt(n_y * n_y + n_z * n_z + AXIS_FLOOR)
        inverse = 1.0 / (steep * across)  # one division for both
        upright = across * inverse
        w[SINKAGE, lane] = (w[HEIGHT, lane] - w[PLACE_Z, lane]) * upright
        w[N_X, lane] = n_x * upright
        w[N_Y, lane] = n_y * upright
        w[N_Z, lane] = n_z * upright
        w[AHEAD, lane] = across * upright
        w[INVERSE_AHEAD, lane] = steep * steep * inverse


@summation
def _turn_factors(turn, short):
    """S = sin(th)/th and C = (1 - cos(th))/th of the turn th [rad].

    short: |th| <= SHORT_TURN, and a series does.
    """
    half = 0.5 * turn
    if short:
        z = half * half
        ratio = 1 / 39916800 - z * (1 / 6227020800 - z * (1 / 1307674368000))
        ratio = 1 / 120 - z * (1 / 5040 - z * (1 / 362880 - z * ratio))
        ratio = 1.0 - z * (1 / 6 - z * ratio)
        cosine = 1 / 3628800 - z * (1 / 479001600 - z * (1 / 87178291200))
        cosine = 1 / 24 - z * (1 / 720 - z * (1 / 40320 - z * cosine))
        cosine = 1.0 - z * (1 / 2 - z * cosine)
    else:
        cosine, sine = rotation(half)
        small = abs(half) < SMALLEST_TURN
        ratio = 1.0 if small else sine / (1.0 if small else half)
    return ratio * cosine, half * ratio * ratio


@summation
def shear_displacement(turn, time, u_t, u_q, belt, half_length, short):
    """j [m] of a patch that has been in contact for `time` [s] and turned by `turn` [rad].

    u_t, u_q [m/s]: velocity along and across the track in the contact plane; belt [m/s]: v'.
    """
    turn = min(max(turn, -TURN_LIMIT), TURN_LIMIT)
    s, c = _turn_factors(turn, short)
    j_t = u_t * s - belt - u_q * c
    j_q = u_t * c + u_q * s
    j = time * math.sqrt(j_t * j_t + j_q * j_q)
    if short:
        return j
    return j + HISTORY_RISE * half_length * max(abs(turn) - HISTORY_TURN, 0.0)


@formula
def normal_load(sinkage, rate, area, stiffness, damping):
    """Load [N] of the spring and damper of a patch: pushes only, and only where it has sunk in."""
    load = area * (stiffness * sinkage + damping * rate)
    return max(load, 0.0) if sinkage > 0.0 else 0.0


@summation
def press(w, lanes, twist, f):
    """Row LOAD [N]: every patch on its own springs."""
    length = f.half_length
    low_x, low_y = twist.x - f.height * twist.pitch, twist.y + f.height * twist.roll
    leading = f.ahead + (length if twist.x > 0.0 else (-length if twist.x < 0.0 else 0.0))
    rise = f.stiffening * twist.x
    for lane in range(lanes):
        x, y = w[X, lane], w[Y, lane]
        u_x, u_y = low_x - twist.yaw * y, low_y + twist.yaw * x
        u_z = twist.z + (twist.roll * y - twist.pitch * x)
        stiffness = f.stiffness * (1.0 + rise * (x + leading))
        closing = -(w[N_X, lane] * u_x + w[N_Y, lane] * u_y + w[N_Z, lane] * u_z)
        area = f.patch_area * w[FIRMNESS, lane]
        w[LOAD, lane] = normal_load(w[SINKAGE, lane], closing, area, stiffness, f.damping)


@summation
def _slide(w, lanes, twist, f, short):
    """See `slide`; short: no patch turns by more than SHORT_TURN."""
    length = f.half_length
    low_x, low_y = twist.x - f.height * twist.pitch, twist.y + f.height * twist.roll
    for lane in range(lanes):
        x, y = w[X, lane], w[Y, lane]
        a, b, c = w[N_X, lane], w[N_Y, lane], w[N_Z, lane]
        g, inverse_g = w[AHEAD, lane], w[INVERSE_AHEAD, lane]
        u_x, u_y = low_x - twist.yaw * y, low_y + twist.yaw * x
        u_z = twist.z + (twist.roll * y - twist.pitch * x)
        u_t = g * u_x - a * inverse_g * (b * u_y + c * u_z)
        u_q = (c * u_y - b * u_z) * inverse_g
        belt, time = w[BELT, lane] * g, w[TIME, lane]
        turn = time * (a * twist.roll + b * twist.pitch + c * twist.yaw)
        w[SHEARED, lane] = shear_displacement(turn, time, u_t, u_q, belt, length, short)
        w[FORWARD, lane] = u_t
        w[SLIDE, lane] = u_t - belt
        w[ASIDE, lane] = u_q


@formula
def slide(w, lanes, twist, f, longest):
    """Rows FORWARD, SLIDE, ASIDE [m/s] and SHEARED [m] at a motion.

    longest [s]: contact time of the last patch.
    """
    spin2 = twist.roll * twist.roll + twist.pitch * twist.pitch + twist.yaw * twist.yaw
    if spin2 * longest * longest < SHORT_TURN * SHORT_TURN:
        _slide(w, lanes, twist, f, True)
    else:
        _slide(w, lanes, twist, f, False)


@summation
def resist(w, lanes, again):
    """Rows ALONG, ASIDE_PUSH [N], EFFORT, ROLLED [N] and K_TT, K_TQ, K_QQ [N s/m] from the slide.

    again: rows OLD_SLIDE and OLD_ASIDE have the slide of the motion before. A patch that slides
    faster now has as its drag along the motion the slope of the force, which is flat, and not the
    secant.
    """
    for lane in range(lanes):
        load, u_t = w[LOAD, lane], w[FORWARD, lane]
        s_t, s_q = w[SLIDE, lane], w[ASIDE, lane]
        strength = w[ADHESION, lane] + w[FRICTION, lane] * load if load > 0.0 else 0.0
        decay = exponential(-w[SHEARED, lane] * w[INVERSE_MODULUS, lane])
        speed = math.sqrt(s_t * s_t + s_q * s_q + SHEAR_SPEED_FLOOR * SHEAR_SPEED_FLOOR)
        roll_speed = math.sqrt(u_t * u_t + ROLLING_SPEED * ROLLING_SPEED)
        inverse = 1.0 / (speed * roll_speed)  # one division for both
        inverse_speed = roll_speed * inverse
        k = strength * (1.0 - decay) * inverse_speed
        rolling = w[ROLLING, lane] * load * (speed * inverse)
        old_t, old_q = w[OLD_SLIDE, lane], w[OLD_ASIDE, lane]
        faster = again and old_t * s_t + old_q * s_q > old_t * old_t + old_q * old_q
        slope = strength * decay * w[TIME, lane] * w[INVERSE_MODULUS, lane]
        less = (min(slope, k) - k) * (inverse_speed * inverse_speed) if faster else 0.0
        w[OLD_SLIDE, lane] = s_t
        w[OLD_ASIDE, lane] = s_q
        w[THRUST, lane] = -k * s_t
        w[ROLLED, lane] = rolling * u_t
        w[LATERAL, lane] = -k * s_q
        w[K_TT, lane] = k + less * s_t * s_t
        w[K_TQ, lane] = less * s_t * s_q
        w[K_QQ, lane] = k + less * s_q * s_q
        w[K_ROLL, lane] = rolling
