"""Sums over patches: what the ground does to a vehicle, and how that changes with its motion.

With the force f_k of a patch at r_k and its slope K_k over the patch's velocity, both from the rows
that `ground_contact` fills, in body axes:
    wrench = sum (f_k, r_k x f_k)
    drag   = sum J_k^T K_k J_k,   J_k = [1, -[r_k] x]        of v + W x r_k
    belts  = sum J_k^T K_k x_b,   the coupling of a belt's speed to the vehicle, one sum per track
The slope of a force in its contact plane is (K_TT, K_TQ; K_TQ, K_QQ) along t and q, K_ROLL is added
along t, and the damper of the ground acts along n, with the firmness of its patch.
"""

from typing import NamedTuple

from tracked_env.physics.ground_contact import (
    AHEAD,
    FIRMNESS,
    INVERSE_AHEAD,
    K_QQ,
    K_ROLL,
    K_TQ,
    K_TT,
    LATERAL,
    LOAD,
    N_X,
    N_Y,
    N_Z,
    ROLLED,
    THRUST,
    X,
    Y,
)
from tracked_env.physics.jit import summation


class Wrench(NamedTuple):
    """Force [N] and moment [N m] about the centre of mass, body axes."""

    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float


class Drag(NamedTuple):
    """Lower triangle of the symmetric matrix A in wrench = -A twist + ..., row by row."""

    xx: float  # [N s/m]
    yx: float
    yy: float
    zx: float
    zy: float
    zz: float
    rx: float  # [N s] moment about the body's x axis by v_x, v_y, v_z
    ry: float
    rz: float
    rr: float  # [N m s]
    px: float
    py: float
    pz: float
    pr: float
    pp: float
    wx: float  # yaw
    wy: float
    wz: float
    wr: float
    wp: float
    ww: float


class BeltDrag(NamedTuple):
    """How the belt of one track is coupled to the vehicle: the last row of its Drag."""

    x: float  # [N s/m] force of the belt's speed on the vehicle, body axes
    y: float
    z: float
    roll: float  # [N s] and its moment
    pitch: float
    yaw: float
    own: float  # [N s/m] resistance to the belt itself
    effort: float  # [N] tractive effort of the track


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
    """Sum of J^T K J over the patches: K in their axes of contact, J = [1, -[r]x]."""
    xx, yx, yy, zx, zy, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    rx, ry, rz, px, py, pz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    wx, wy, wz, rr, pr, pp = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    wr, wp, ww = 0.0, 0.0, 0.0
    for lane in range(lanes):
        x, y = w[X, lane], w[Y, lane]
        a, b, c = w[N_X, lane], w[N_Y, lane], w[N_Z, lane]
        g, inverse_g = w[AHEAD, lane], w[INVERSE_AHEAD, lane]
        t_y, t_z = -a * b * inverse_g, -a * c * inverse_g
        q_y, q_z = c * inverse_g, -b * inverse_g
        k_tt, k_tq, k_qq = w[K_TT, lane] + w[K_ROLL, lane], w[K_TQ, lane], w[K_QQ, lane]
        stiff = damping * w[FIRMNESS, lane] if w[LOAD, lane] > 0.0 else 0.0
        o_x, o_y, o_z = k_tt * g, k_tt * t_y + k_tq * q_y, k_tt * t_z + k_tq * q_z
        i_x, i_y, i_z = k_tq * g, k_tq * t_y + k_qq * q_y, k_tq * t_z + k_qq * q_z
        d_x, d_y, d_z = stiff * a, stiff * b, stiff * c
        a_xx = o_x * g + d_x * a
        a_yx = o_x * t_y + i_x * q_y + d_x * b
        a_zx = o_x * t_z + i_x * q_z + d_x * c
        a_yy = o_y * t_y + i_y * q_y + d_y * b
        a_zy = o_y * t_z + i_y * q_z + d_y * c
        a_zz = o_z * t_z + i_z * q_z + d_z * c
        b_rx, b_ry, b_rz = y * a_zx + h * a_yx, y * a_zy + h * a_yy, y * a_zz + h * a_zy
        b_px, b_py, b_pz = -h * a_xx - x * a_zx, -h * a_yx - x * a_zy, -h * a_zx - x * a_zz
        b_wx, b_wy, b_wz = x * a_yx - y * a_xx, x * a_yy - y * a_yx, x * a_zy - y * a_zx
        xx += a_xx
        yx += a_yx
        yy += a_yy
        zx += a_zx
        zy += a_zy
        zz += a_zz
        rx += b_rx
        ry += b_ry
        rz += b_rz
        px += b_px
        py += b_py
        pz += b_pz
        wx += b_wx
        wy += b_wy
        wz += b_wz
        rr += y * b_rz + h * b_ry
        pr += y * b_pz + h * b_py
        pp += -h * b_px - x * b_pz
        wr += y * b_wz + h * b_wy
        wp += -h * b_wx - x * b_wz
        ww += x * b_wy - y * b_wx
    return Drag(xx, yx, yy, zx, zy, zz, rx, ry, rz, rr, px, py, pz, pr, pp, wx, wy, wz, wr, wp, ww)


@summation
def belt_drag(w, first, last, height):
    """BeltDrag of the track in lanes first .. last - 1, after `load_patches`."""
    fx, fy, fz, mx, my, mz, own, effort = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
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
        own += along * g
        effort += w[THRUST, lane] * g
    return BeltDrag(fx, fy, fz, mx, my, mz, own, effort)


@summation
def track_totals(w, first, last):
    """(normal load, tractive effort, motion resistance) [N] of the track in these lanes."""
    load, effort, rolled = 0.0, 0.0, 0.0
    for lane in range(first, last):
        load += w[LOAD, lane]
        effort += w[THRUST, lane] * w[AHEAD, lane]
        rolled += w[ROLLED, lane] * w[AHEAD, lane]
    return load, effort, rolled
