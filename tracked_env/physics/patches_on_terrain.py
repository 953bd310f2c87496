"""Normal load and shear of the patches under two tracks on uneven ground, and their sums.

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
each has the moment r x f. On level ground this is `patches_on_level_ground`, and beyond
HISTORY_TURN the displacement is raised as it is there. In body axes with n = (a, b, c) and
g = |P_n x_b| = sqrt(b^2 + c^2):  t = (g, -a b/g, -a c/g),  q = (0, c, -b)/g.

Sums, with the force f_k of a patch at r_k and its slope K_k over the patch's velocity:
    wrench = sum (f_k, r_k x f_k)
    drag   = sum J_k^T K_k J_k,   J_k = [1, -[r_k] x]        of v + W x r_k
    belts  = sum J_k^T K_k x_b,   the coupling of a belt's speed to the vehicle, one sum per track
The slope of a force in its contact plane is (K_TT, K_TQ; K_TQ, K_QQ) along t and q, K_ROLL is added
along t, and the damper of the ground acts along n, with the firmness of its patch.

Uniform load: instead of springs under each patch one foot, at r0 = (-c_x, -c_y, -h) in the middle
of the tracks, with springs against tilt; its load is shared by all patches, and the ground under it
stands for all ground under the vehicle: a plane that touches it.
    F   = A max(0, k_A rho + d_A rho') if rho > 0, along n;  N = F / patches
    M_x = -K_x n_y - D_x W_x,   M_y = K_y n_x - D_y W_y          n in body axes; 0 when F = 0
    K_x = k_A A (B^2/4 + w^2/12),  K_y = k_A A l^2/3,  D = K d_A / k_A
    |M_x| <= F (B + w)/2,  |M_y| <= F l                  and r0 x F n beside M
These are the rocking stiffnesses of the springs that the nonuniform load has under its patches.
Beyond the bounds of M the vehicle would tip: reaching one (`Tilt.saturated`) is a failure of the
model.

The passes, one loop each: `locate` says where the patches are, a terrain fills heights and slopes,
`orient` makes the axes of contact; at a motion, `press` gives the loads, `slide` and `resist` the
shear; `total_wrench` and `total_drag` add up.

Assumptions: the ground is a plane under each patch, motion is steady during contact, a patch meets
the soil at the leading end of its track even where that hangs free.
References: [1] Focchi et al. (2025) sections 2.1 to 2.3, whose load model is corrected here; see
docs/terrain.md.
"""

import math
from typing import NamedTuple

from tracked_env.physics import patches_on_level_ground as level
from tracked_env.physics.elementary import exponential, inverse_root, rotation
from tracked_env.physics.jit import contraction, formula, summation
from tracked_env.physics.rigid_body import BeltDrag, Drag, Wrench

SLOWEST = level.SHEAR_SPEED_FLOOR  # [m/s]
ROLLING_SPEED = 0.01  # [m/s] w: slower patches meet less rolling resistance
AXIS_FLOOR = 1e-24  # [-] keeps 0/0 out where the body's x axis is along the normal
SHORT_TURN = 0.5 * math.pi  # [rad] up to it a short series does for S and C
WIDE = 8  # lanes are filled up to a multiple of this: the vectors of the processor
LANES = 1288  # two tracks of 80 x 8 patches; an odd number of cache lines from row to row

# Rows of the scratch array; a lane is a patch, the left track first.
(PLACE_X, PLACE_Y, HEIGHT, SLOPE_X, SLOPE_Y) = range(5)  # of the terrain
(X, Y, PLACE_Z, FRICTION, ADHESION, INVERSE_MODULUS, ROLLING, FIRMNESS) = range(5, 13)
(BELT, TIME, SINKAGE, N_X, N_Y, N_Z, AHEAD, INVERSE_AHEAD, LOAD) = range(13, 22)
(FORWARD, SLIDE, ASIDE, SHEARED, OLD_SLIDE, OLD_ASIDE) = range(22, 28)
(THRUST, LATERAL, ROLLED, K_TT, K_TQ, K_QQ, K_ROLL) = range(28, 35)
SCRATCH_ROWS = 35


# A product and a sum in it are rounded as one where the processor can: a quarter of `resist`.
_exponential = contraction(exponential.py_func)


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


class Rocking(NamedTuple):
    """Springs of the whole contact against sinking and tilting."""

    area: float  # [m^2] A, both tracks
    roll: float  # [N m/rad] K_x
    pitch: float  # [N m/rad] K_y
    half_width: float  # [m] (B + w)/2, where the vehicle would tip sideways
    retardation: float  # [s] d_A / k_A


class Tilt(NamedTuple):
    """What holds the vehicle up and level."""

    load: float  # [N] F
    roll: float  # [N m] M_x
    pitch: float  # [N m] M_y
    roll_drag: float  # [N m s] slope of -M_x over the roll rate
    pitch_drag: float  # [N m s]
    saturated: float  # [-] 1 where a bound of M is reached


@formula
def padded(count):
    """Lanes of `count` patches, filled up."""
    return (count + WIDE - 1) // WIDE * WIDE


@formula
def place_patches(w, columns, rows, half_gauge, track_width, f):
    """Rows X, Y [m] of the patches from the centre of mass; f: Footing. Returns how many lanes.

    columns, rows: their middles over half the length and over the width of a track.
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
    size = max(abs(speed), level.BELT_SPEED_FLOOR)
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
        steep2 = 1.0 + a * a + b * b
        n_x = r.zx - (r.xx * a + r.yx * b)
        n_y = r.zy - (r.xy * a + r.yy * b)
        n_z = r.zz - (r.xz * a + r.yz * b)
        across2 = n_y * n_y + n_z * n_z + AXIS_FLOOR
        # one by division and the other by iteration, which run side by side
        upright, inverse_across = 1.0 / math.sqrt(steep2), inverse_root(across2)
        w[SINKAGE, lane] = (w[HEIGHT, lane] - w[PLACE_Z, lane]) * upright
        w[N_X, lane] = n_x * upright
        w[N_Y, lane] = n_y * upright
        w[N_Z, lane] = n_z * upright
        w[AHEAD, lane] = across2 * inverse_across * upright
        w[INVERSE_AHEAD, lane] = steep2 * upright * inverse_across


@summation
def _turn_factors(turn, short):
    """S = sin(th)/th and C = (1 - cos(th))/th of the turn th [rad]; short: |th| <= SHORT_TURN."""
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
        small = abs(half) < level.SMALLEST_TURN
        ratio = 1.0 if small else sine / (1.0 if small else half)
    return ratio * cosine, half * ratio * ratio


@summation
def shear_displacement(turn, time, u_t, u_q, belt, half_length, short):
    """j [m] of a patch in contact for `time` [s], turned by `turn` [rad]; velocities u_t, u_q in
    the contact plane, belt v' [m/s]."""
    turn = min(max(turn, -level.TURN_LIMIT), level.TURN_LIMIT)
    s, c = _turn_factors(turn, short)
    j_t = u_t * s - belt - u_q * c
    j_q = u_t * c + u_q * s
    j = time * math.sqrt(j_t * j_t + j_q * j_q)
    if short:
        return j
    return j + level.HISTORY_RISE * half_length * max(abs(turn) - level.HISTORY_TURN, 0.0)


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
    """Rows FORWARD, SLIDE, ASIDE [m/s] and SHEARED [m]; longest [s]: contact of the last patch."""
    spin2 = twist.roll * twist.roll + twist.pitch * twist.pitch + twist.yaw * twist.yaw
    if spin2 * longest * longest < SHORT_TURN * SHORT_TURN:
        _slide(w, lanes, twist, f, True)
    else:
        _slide(w, lanes, twist, f, False)


@summation
def resist(w, lanes, again):
    """Rows THRUST, LATERAL, ROLLED [N] and K_TT, K_TQ, K_QQ, K_ROLL [N s/m] from the slide.

    again: rows OLD_SLIDE and OLD_ASIDE have the slide of the motion before. The drag of a patch
    that slides faster now is the slope of the force along the motion, and not the secant.
    """
    for lane in range(lanes):
        load, u_t = w[LOAD, lane], w[FORWARD, lane]
        s_t, s_q = w[SLIDE, lane], w[ASIDE, lane]
        strength = w[ADHESION, lane] + w[FRICTION, lane] * load if load > 0.0 else 0.0
        decay = _exponential(-w[SHEARED, lane] * w[INVERSE_MODULUS, lane])
        speed = math.sqrt(s_t * s_t + s_q * s_q + SLOWEST * SLOWEST)
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


@summation
def total_wrench(w, lanes, h, carrying):
    """Sum of the forces of all patches and of their moments."""
    fx, fy, fz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for lane in range(lanes):
        x, y = w[X, lane], w[Y, lane]
        a, b, c = w[N_X, lane], w[N_Y, lane], w[N_Z, lane]
        inverse_g = w[INVERSE_AHEAD, lane]
        along = w[THRUST, lane] - w[ROLLED, lane]
        leaning, aside = a * along * inverse_g, w[LATERAL, lane] * inverse_g
        push = carrying * w[LOAD, lane]
        f_x = along * w[AHEAD, lane] + push * a
        f_y = aside * c - leaning * b + push * b
        f_z = push * c - leaning * c - aside * b
        fx += f_x
        fy += f_y
        fz += f_z
        mx += y * f_z + h * f_y
        my -= h * f_x + x * f_z
        mz += x * f_y - y * f_x
    return Wrench(fx, fy, fz, mx, my, mz)


@summation
def total_drag(w, lanes, h, damping):
    """Sum of J^T K J over the patches: K in their axes of contact, J = [1, -[r]x].

    K = k_qq + (k_n - k_qq) n n^T + t e^T + k_tq q t^T,  e = (k_tt - k_qq) t + k_tq q
    """
    xx, yx, yy, zx, zy, zz, rr, pr, pp = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    y_zx, y_zy, y_zz, x_zx, x_zy, x_zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # sums of y K_zx, ...
    wx, wy, wr, wp, ww = 0.0, 0.0, 0.0, 0.0, 0.0
    for lane in range(lanes):
        x, y = w[X, lane], w[Y, lane]
        a, b, c = w[N_X, lane], w[N_Y, lane], w[N_Z, lane]
        g, inverse_g, k_qq = w[AHEAD, lane], w[INVERSE_AHEAD, lane], w[K_QQ, lane]
        k_n = damping * w[FIRMNESS, lane] if w[LOAD, lane] > 0.0 else 0.0
        leaning, across = a * inverse_g, w[K_TQ, lane] * inverse_g
        t_y, t_z, i_y, i_z = -leaning * b, -leaning * c, across * c, -across * b  # t, k_tq q
        along = w[K_TT, lane] + w[K_ROLL, lane] - k_qq
        e_y, e_z = along * t_y + i_y, along * t_z + i_z
        n_x, n_y, n_z = (k_n - k_qq) * a, (k_n - k_qq) * b, (k_n - k_qq) * c
        a_xx = k_qq + n_x * a + along * g * g
        a_yx, a_zx = n_x * b + g * e_y, n_x * c + g * e_z
        a_yy = k_qq + n_y * b + t_y * (e_y + i_y)
        a_zy = n_y * c + t_z * e_y + t_y * i_z
        a_zz = k_qq + n_z * c + t_z * (e_z + i_z)
        x_times_zz, y_times_zz = x * a_zz, y * a_zz
        x_times_zy, y_times_zx = x * a_zy, y * a_zx
        b_wx, b_wy, b_wz = x * a_yx - y * a_xx, x * a_yy - y * a_yx, x_times_zy - y_times_zx
        xx += a_xx
        yx += a_yx
        yy += a_yy
        zx += a_zx
        zy += a_zy
        zz += a_zz
        y_zx += y_times_zx
        y_zy += y * a_zy
        y_zz += y_times_zz
        x_zx += x * a_zx
        x_zy += x_times_zy
        x_zz += x_times_zz
        wx += b_wx
        wy += b_wy
        rr += y * y_times_zz
        pr -= y * x_times_zz
        pp += x * x_times_zz
        wr += y * b_wz
        wp -= x * b_wz
        ww += x * b_wy - y * b_wx
    rx, ry, rz = y_zx + h * yx, y_zy + h * yy, y_zz + h * zy
    px, py, pz = -h * xx - x_zx, -h * yx - x_zy, -h * zx - x_zz
    rr += h * (y_zy + ry)
    pr += h * (py - y_zx)
    pp += h * (x_zx - px)
    wr, wp, wz = wr + h * wy, wp - h * wx, x_zy - y_zx
    return Drag(xx, yx, yy, zx, zy, zz, rx, ry, rz, rr, px, py, pz, pr, pp, wx, wy, wz, wr, wp, ww)


@summation
def belt_drag(w, first, last, height):
    """BeltDrag of the track in lanes first .. last - 1, after `resist`."""
    fx, fy, fz, mx, my, mz, itself, effort = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for lane in range(first, last):
        x, y = w[X, lane], w[Y, lane]
        a, b, c = w[N_X, lane], w[N_Y, lane], w[N_Z, lane]
        g, inverse_g = w[AHEAD, lane], w[INVERSE_AHEAD, lane]
        along, across = g * w[K_TT, lane], g * w[K_TQ, lane]
        f_x = along * g
        f_y = (across * c - along * a * b) * inverse_g
        f_z = -(across * b + along * a * c) * inverse_g
        fx += f_x
        fy += f_y
        fz += f_z
        mx += y * f_z + height * f_y
        my -= height * f_x + x * f_z
        mz += x * f_y - y * f_x
        itself += along * g
        effort += w[THRUST, lane] * g
    return BeltDrag(fx, fy, fz, mx, my, mz, itself, effort)


@summation
def track_totals(w, first, last):
    """(normal load, tractive effort, motion resistance) [N] of the track in these lanes."""
    load, effort, rolled = 0.0, 0.0, 0.0
    for lane in range(first, last):
        load += w[LOAD, lane]
        effort += w[THRUST, lane] * w[AHEAD, lane]
        rolled += w[ROLLED, lane] * w[AHEAD, lane]
    return load, effort, rolled


@formula
def rocking_of(footing, half_gauge, track_width, count):
    """Rocking of two tracks with `count` patches in all."""
    area, length = footing.patch_area * count, footing.half_length
    spring = footing.stiffness * area
    roll = spring * (half_gauge * half_gauge + track_width * track_width / 12.0)
    pitch, half_width = spring * length * length / 3.0, half_gauge + 0.5 * track_width
    return Rocking(area, roll, pitch, half_width, footing.damping / footing.stiffness)


@formula
def locate_foot(w, lanes, p, r, f):
    """Rows PLACE_X, PLACE_Y, PLACE_Z of lanes 0 .. lanes - 1: all of them the foot; f: Footing."""
    for lane in range(lanes):
        w[PLACE_X, lane] = p[0] - r.xz * f.height - (r.xx * f.ahead + r.xy * f.aside)
        w[PLACE_Y, lane] = p[1] - r.yz * f.height - (r.yx * f.ahead + r.yy * f.aside)
        w[PLACE_Z, lane] = p[2] - r.zz * f.height - (r.zx * f.ahead + r.zy * f.aside)


@formula
def share_plane(w, lanes):
    """The axes of contact of lane 0 in all lanes."""
    for row in (SINKAGE, N_X, N_Y, N_Z, AHEAD, INVERSE_AHEAD, HEIGHT):
        value = w[row, 0]
        for lane in range(lanes):
            w[row, lane] = value


@formula
def _bounded(moment, limit):
    """(moment within +-limit, 1 where it is inside, else 0)."""
    clipped = min(max(moment, -limit), limit)
    return clipped, (1.0 if clipped == moment else 0.0)


@formula
def tilt_of(w, twist, footing, k):
    """Tilt at a motion; k: Rocking."""
    a, b, c = w[N_X, 0], w[N_Y, 0], w[N_Z, 0]
    u_x = twist.x - footing.height * twist.pitch + footing.aside * twist.yaw
    u_y = twist.y + footing.height * twist.roll - footing.ahead * twist.yaw
    u_z = twist.z - footing.aside * twist.roll + footing.ahead * twist.pitch
    closing = -(a * u_x + b * u_y + c * u_z)
    load = normal_load(w[SINKAGE, 0], closing, k.area, footing.stiffness, footing.damping)
    touching = 1.0 if load > 0.0 else 0.0
    spring_roll = -k.roll * (b + k.retardation * twist.roll)
    spring_pitch = k.pitch * (a - k.retardation * twist.pitch)
    roll, in_roll = _bounded(spring_roll, load * k.half_width)
    pitch, in_pitch = _bounded(spring_pitch, load * footing.half_length)
    roll_drag = touching * in_roll * k.roll * k.retardation
    pitch_drag = touching * in_pitch * k.pitch * k.retardation
    return Tilt(load, roll, pitch, roll_drag, pitch_drag, touching * (1.0 - in_roll * in_pitch))


@formula
def with_tilt(w, tilt, footing, k, wrench, drag):
    """Wrench and Drag of the shear of all patches, and those of load and tilt added."""
    a, b, c = w[N_X, 0], w[N_Y, 0], w[N_Z, 0]
    # r0 x n, the moment of a force of 1 N along the normal at the foot.
    roll = footing.height * b - footing.aside * c
    pitch = footing.ahead * c - footing.height * a
    yaw = footing.aside * a - footing.ahead * b
    f_x, f_y, f_z = wrench.x + tilt.load * a, wrench.y + tilt.load * b, wrench.z + tilt.load * c
    m_x, m_y = wrench.roll + tilt.roll + tilt.load * roll, wrench.pitch + tilt.pitch
    wrench = Wrench(f_x, f_y, f_z, m_x, m_y + tilt.load * pitch, wrench.yaw + tilt.load * yaw)
    d = k.area * footing.damping if tilt.load > 0.0 else 0.0
    x, y, z, turn, nod = d * a, d * b, d * c, d * roll, d * pitch
    xx, yx, yy = drag.xx + x * a, drag.yx + x * b, drag.yy + y * b
    zx, zy, zz = drag.zx + x * c, drag.zy + y * c, drag.zz + z * c
    rx, ry, rz = drag.rx + turn * a, drag.ry + turn * b, drag.rz + turn * c
    rr = drag.rr + turn * roll + tilt.roll_drag
    px, py, pz = drag.px + nod * a, drag.py + nod * b, drag.pz + nod * c
    pr, pp = drag.pr + nod * roll, drag.pp + nod * pitch + tilt.pitch_drag
    wx, wy, wz = drag.wx + yaw * x, drag.wy + yaw * y, drag.wz + yaw * z
    wr, wp, ww = drag.wr + yaw * turn, drag.wp + yaw * nod, drag.ww + d * yaw * yaw
    drag = Drag(xx, yx, yy, zx, zy, zz, rx, ry, rz, rr, px, py, pz, pr, pp, wx, wy, wz, wr, wp, ww)
    return wrench, drag
