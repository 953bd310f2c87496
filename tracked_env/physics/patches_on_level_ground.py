"""Shear of the level soil under two tracks that are divided into patches.

Equations (F = Focchi et al. 2025 section 2.1; symbols in NOTATION.md), for a patch at (x, y) of a
track whose belt moves at v_s = r omega over a vehicle that moves at v_x, v_y, w:
    s   = (v_x - w y - v_s, v_y + w x)             shear velocity, F (2)
    t   = (l_e - x) / v_s,  l_e = sign(v_s) l      time since the patch touched the soil, F (3)
    th  = w t                                      rotation of the vehicle meanwhile, F (4)
    j_x = t [ b S - v_s - (v_y + w x) th C ]       shear displacement, b = v_x - w y,
    j_y = t [ b th C + (v_y + w x) S ]             S = sin(th)/th, C = (1 - cos(th))/th^2
    tau A = (c A + N tan(phi)) (1 - exp(-j/K))     Janosi-Hanamoto over the patch's area A
    f   = -tau A s / |s|                           force on the vehicle
F (6) is misprinted: this is the integral of F (5) in body axes; here without 1/w, so that w -> 0
needs no special case. F (1) prints the cohesion outside the bracket.
Limits: K -> 0 is Coulomb friction; v_s -> 0 gives t -> inf, full sliding friction. Beyond
HISTORY_TURN of rotation the formula would claim that soil comes back under the patch unsheared:
there the displacement is raised, so that a belt that stands tends to full sliding in every motion.

A force is returned as a resistance: with k = tau A / |s| of each patch the sums of k, k x, k y
and k (x^2 + y^2) give force, moment and their steepest slope alike.

Assumptions: level ground, uniform pressure, steady motion while a patch is in contact.
References: [1] Focchi et al. (2025). [2] Wong, Theory of Ground Vehicles, shear displacement.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.elementary import exponential, rotation
from tracked_env.physics.jit import formula

BELT_SPEED_FLOOR = 1e-6  # [m/s] a slower belt counts as this fast: keeps 1/0 out of the time
SHEAR_SPEED_FLOOR = 1e-9  # [m/s] added in squares to |s|: keeps 0/0 out at exact rolling
HISTORY_TURN = 4.0 * math.pi  # [rad] two whole turns in contact: no history is left
HISTORY_RISE = 0.1  # [1/rad] extra displacement over half a track length, beyond HISTORY_TURN
TURN_LIMIT = 1e5  # [rad] larger rotations add nothing, and would lose digits
SMALLEST_TURN = 1e-150  # [rad] below it sin(x)/x is 1
COLUMN_LIMIT = 64  # [-] patches along a track
_WIDE = 8  # lanes are filled up to a multiple of this: the vectors of the processor
LANES = 4 * COLUMN_LIMIT

# Rows of the scratch array: one lane per side, half of the rows, and column.
(_TIME, _SINE, _VERSINE, _LATERAL, _FORWARD, _BELT, _STRENGTH, _MIRROR) = range(8)
(_EXTRA, _X, _MODULUS, _K, _KY, _KYY) = range(8, 14)
SCRATCH_ROWS = 14


class Patches(NamedTuple):
    """How each track is divided; the same for every vehicle of a batch."""

    columns: NDArray[np.float64]  # (C,) middle of a patch over half the contact length, entry first
    rows: NDArray[np.float64]  # (H,) its distance from the centre line over the track width
    weights: NDArray[np.float64]  # (H,) 1, or 1/2 for the middle row, which counts twice


class Contact(NamedTuple):
    """What the shear of a track's soil needs, the motion apart."""

    half_length: float  # [m] l
    half_gauge: float  # [m] B/2
    track_width: float  # [m] w
    strength: float  # [N] c A + N tan(phi) of one patch
    inverse_modulus: float  # [1/m] 1/K


class Resistance(NamedTuple):
    """Sums over patches of k = tau A / |s| [N s/m], the sides apart where belts enter."""

    left: float  # [N s/m] sum of k
    right: float  # [N s/m]
    left_arm: float  # [N s] sum of k y
    right_arm: float  # [N s]
    forward: float  # [N s] sum of k x, both sides
    polar: float  # [N m s] sum of k (x^2 + y^2), both sides


class Belts(NamedTuple):
    """One number for each side: belt speeds r omega [m/s], their rates, or torques [N m]."""

    left: float
    right: float


def middles(count: int) -> NDArray[np.float64]:
    """(count,) middles of equal parts of [-1, 1], the largest first; exactly antisymmetric."""
    places = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    return np.ascontiguousarray(0.5 * (places - places[::-1]))


def make_patches(along: int = 10, across: int = 4) -> Patches:
    """Divide each track into `along` x `across` equal patches, forces at their middles.

    Both are whole numbers in [1, COLUMN_LIMIT].
    """
    rows = (np.arange((across + 1) // 2) + 0.5 * (1 - across % 2)) / across
    return Patches(middles(along), rows, np.where(rows == 0.0, 0.5, 1.0))


@formula
def patch_count(patches):
    """Patches of one track, as their weights have it [-]."""
    total = 0.0
    for weight in patches.weights:
        total += 2.0 * weight
    return total * patches.columns.size


@formula
def contact_of(p, k, drive, patches):
    """Contact from parameters, coefficients and drive limits: the soil's strength is shared."""
    strength = drive.effort_maximum / patch_count(patches)
    inverse_modulus = 1.0 / p.shear_deformation_modulus
    return Contact(0.5 * p.contact_length, k.half_gauge, p.track_width, strength, inverse_modulus)


@formula
def _place(w, belt, half_length, patches, base, mirror):
    """Lanes base .. base + C - 1: where the patches of one half of a side are."""
    ahead = belt >= 0.0  # which end of the track is the first to touch the soil
    speed = max(abs(belt), BELT_SPEED_FLOOR)
    moving = abs(belt) / speed  # 1, or less below the floor: a belt that stands has no first end
    for c in range(patches.columns.size):
        position = patches.columns[c]
        w[_X, base + c] = (position if ahead else -position) * half_length
        w[_TIME, base + c] = (1.0 - position * moving) * half_length / speed
        w[_BELT, base + c] = belt
        w[_MIRROR, base + c] = mirror


@formula
def _columns(w, lanes, motion, belts, contacts, patches):
    """All that does not depend on the row: positions, times and rotations."""
    count = patches.columns.size
    for side in range(2):
        belt = belts.right if side else belts.left
        contact = contacts[1] if side else contacts[0]
        arm = -contact.half_gauge if side else contact.half_gauge
        forward = motion.v_x - motion.yaw_rate * arm
        for half in range(2):
            base = (2 * side + half) * count
            _place(w, belt, contact.half_length, patches, base, 1.0 if side == half else -1.0)
            for c in range(base, base + count):
                w[_FORWARD, c] = forward
                w[_STRENGTH, c] = contact.strength
                w[_MODULUS, c] = contact.inverse_modulus
    for lane in range(4 * count, lanes):
        for row in range(_K):
            w[row, lane] = 0.0
    rise = HISTORY_RISE * contacts[0].half_length
    for lane in range(lanes):
        turn = min(max(motion.yaw_rate * w[_TIME, lane], -TURN_LIMIT), TURN_LIMIT)
        half_turn = 0.5 * turn
        cosine, sine = rotation(half_turn)
        small = abs(half_turn) < SMALLEST_TURN
        ratio = 1.0 if small else sine / (1.0 if small else half_turn)
        w[_SINE, lane] = ratio * cosine  # S
        w[_VERSINE, lane] = 0.5 * turn * ratio * ratio  # th C
        w[_LATERAL, lane] = motion.v_y + motion.yaw_rate * w[_X, lane]
        w[_EXTRA, lane] = rise * max(abs(turn) - HISTORY_TURN, 0.0)
        w[_K, lane] = 0.0
        w[_KY, lane] = 0.0
        w[_KYY, lane] = 0.0


@formula
def _row(w, lanes, offset, weight, yaw_rate):
    """Add the patches at `offset` [m] from the centre lines, outside on one half of the lanes."""
    for lane in range(lanes):
        y = offset * w[_MIRROR, lane]
        b = w[_FORWARD, lane] - yaw_rate * y
        lateral, belt = w[_LATERAL, lane], w[_BELT, lane]
        slip = b - belt
        sine, versine = w[_SINE, lane], w[_VERSINE, lane]
        j_x = w[_TIME, lane] * (b * sine - belt - lateral * versine)
        j_y = w[_TIME, lane] * (b * versine + lateral * sine)
        j = math.sqrt(j_x * j_x + j_y * j_y) + w[_EXTRA, lane]
        speed = math.sqrt(slip * slip + lateral * lateral + SHEAR_SPEED_FLOOR * SHEAR_SPEED_FLOOR)
        mobilised = 1.0 - exponential(-j * w[_MODULUS, lane])
        k = weight * w[_STRENGTH, lane] * mobilised / speed
        w[_K, lane] += k
        w[_KY, lane] += k * y
        w[_KYY, lane] += k * y * y


@formula
def _pair(w, c, base, count, arm):
    """Sums over both halves of columns c and its mirror: (k, k x, k y, k (x^2 + y^2))."""
    d = count - 1 - c
    k1, k2 = w[_K, base + c] + w[_K, base + count + c], w[_K, base + d] + w[_K, base + count + d]
    y1 = w[_KY, base + c] + w[_KY, base + count + c]
    y2 = w[_KY, base + d] + w[_KY, base + count + d]
    yy1 = w[_KYY, base + c] + w[_KYY, base + count + c]
    yy2 = w[_KYY, base + d] + w[_KYY, base + count + d]
    x1, x2 = w[_X, base + c], w[_X, base + d]
    k, ky = k1 + k2, y1 + y2
    polar = k1 * x1 * x1 + k2 * x2 * x2 + (yy1 + yy2) + arm * (2.0 * ky + arm * k)
    half = 0.5 if c == d else 1.0  # the middle column is its own mirror
    return half * k, half * (k1 * x1 + k2 * x2), half * (ky + arm * k), half * polar


@formula
def resistance(w, motion, belts, contacts, patches):
    """Resistance of the soils to `motion` with belts at r omega [m/s].

    contacts: under the left and the right track; they differ in soil, not in geometry. w: scratch
    (SCRATCH_ROWS, LANES). Mirrored columns are summed in pairs: mirrored motions, mirrored bits.
    """
    count = patches.columns.size
    lanes = (4 * count + _WIDE - 1) // _WIDE * _WIDE
    contact = contacts[0]
    _columns(w, lanes, motion, belts, contacts, patches)
    for row in range(patches.rows.size):
        offset = patches.rows[row] * contact.track_width
        _row(w, lanes, offset, patches.weights[row], motion.yaw_rate)
    left, right, left_arm, right_arm, forward, polar = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range((count + 1) // 2):
        k_l, kx_l, ky_l, polar_l = _pair(w, c, 0, count, contact.half_gauge)
        k_r, kx_r, ky_r, polar_r = _pair(w, c, 2 * count, count, -contact.half_gauge)
        left += k_l
        right += k_r
        left_arm += ky_l
        right_arm += ky_r
        forward += kx_l + kx_r
        polar += polar_l + polar_r
    return Resistance(left, right, left_arm, right_arm, forward, polar)
