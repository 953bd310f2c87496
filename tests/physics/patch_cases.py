"""What the tests of the distributed plant share: the law patch by patch, runs and random cases."""

import math
from typing import NamedTuple

import numpy as np

from tracked_env.physics import patches_on_level_ground as patch_forces
from tracked_env.physics.level_motion import Drives, advance, hold_speeds, loads_of, on_one_soil
from tracked_env.physics.lumped import Motion, coefficients, drive_limits
from tracked_env.physics.parameters import FIRM_FLOOR, FOCCHI_VEHICLE, plant_parameters
from tracked_env.physics.patches_on_level_ground import Belts, contact_of, make_patches, resistance

PATCHES = make_patches()
FOCCHI = plant_parameters(FOCCHI_VEHICLE, FIRM_FLOOR)
EASY = FOCCHI._replace(longitudinal_resistance=0.0)  # as focchi, rolls without resistance
MILLISECOND = 1e-3


class Forces(NamedTuple):
    """What the soil does to the vehicle, as sums over the patches."""

    left: float  # [N] forward force of the left track
    right: float  # [N]
    lateral: float  # [N] of both tracks
    moment: float  # [N m] about the centre of mass
    dissipation: float  # [W] stress times shear velocity


def loads_at(motion, left, right, p, patches=PATCHES):
    """Loads on a vehicle with belts at these speeds [m/s]."""
    k, _, contact = parts(p, patches)
    r = soil_resistance(motion, left, right, contact, patches)
    return loads_of(r, motion, Belts(left, right), k, (k.resistance, k.resistance))


def parts(p, patches=PATCHES):
    """(coefficients, drive limits, contact) of a vehicle."""
    k, drive = coefficients(p, False), drive_limits(p)
    return k, drive, contact_of(p, k, drive, patches)


def soil_resistance(motion, left, right, contact, patches=PATCHES):
    """`resistance` with a scratch array of its own."""
    scratch = np.full((patch_forces.SCRATCH_ROWS, patch_forces.LANES), np.nan)
    return resistance(scratch, motion, Belts(left, right), (contact, contact), patches)


def forces(motion, left, right, contact, patches=PATCHES):
    """Forces from the sums that the plant works with."""
    r = soil_resistance(motion, left, right, contact, patches)
    v_x, v_y, w = motion
    f_left = r.left * (left - v_x) + r.left_arm * w
    f_right = r.right * (right - v_x) + r.right_arm * w
    lateral = -(r.left + r.right) * v_y - r.forward * w
    moment = r.left_arm * (v_x - left) + r.right_arm * (v_x - right)
    moment -= r.polar * w + r.forward * v_y
    dissipation = -(f_left * (v_x - left) + f_right * (v_x - right) + lateral * v_y + moment * w)
    return Forces(f_left, f_right, lateral, moment, dissipation)


def shear_displacement(motion, belt, x, y, half_length):
    """(j_x, j_y) [m] in the axes of the first contact, from the closed form with 1/w."""
    v_x, v_y, w = motion
    entry = math.copysign(half_length, belt)
    turn = w * (entry - x) / belt
    b, lateral = v_x - w * y, v_y + w * x
    j_x = (b * np.sin(turn) + lateral * np.cos(turn) - (v_y + w * entry)) / w
    return j_x, (b * (1.0 - np.cos(turn)) + lateral * np.sin(turn)) / w


def forces_patch_by_patch(motion, left, right, contact, patches=PATCHES):
    """The same in plain NumPy: every patch of both tracks by itself; needs w != 0."""
    v_x, v_y, w = motion
    x = patches.columns[:, None] * contact.half_length
    across = np.concatenate([-patches.rows[::-1], patches.rows]) * contact.track_width
    share = np.concatenate([patches.weights[::-1], patches.weights])
    total = np.zeros(5)
    for side, belt in enumerate((left, right)):
        y = (contact.half_gauge if side == 0 else -contact.half_gauge) + across
        j = np.hypot(*shear_displacement(motion, belt, x, y, contact.half_length))
        s_x, s_y = v_x - w * y - belt + 0.0 * x, v_y + w * x + 0.0 * y
        speed = np.hypot(s_x, s_y)
        stress = share * contact.strength * -np.expm1(-j * contact.inverse_modulus)
        f_x, f_y = -stress * s_x / speed, -stress * s_y / speed
        total[side] += f_x.sum()
        total[2:] += f_y.sum(), (x * f_y - y * f_x).sum(), (stress * speed).sum()
    return Forces(*total)


def random_motions(count, seed, slowest=-3.0):
    """Random motions and belt speeds: (motion, left, right), over orders of magnitude."""
    draws = np.random.default_rng(seed)
    for _ in range(count):
        size = 10.0 ** draws.uniform(slowest, 0.5, 5) * draws.choice([-1.0, 1.0], 5)
        yield Motion(*(float(v) for v in size[:3])), float(size[3]), float(size[4])


def run(states, speeds, p=FOCCHI, steps=1, h=MILLISECOND, euler=False, patches=PATCHES):
    """States (N, 6) and loads (N, 6) after `steps` steps with sprocket speeds (N, 2) held."""
    moved = np.array(np.atleast_2d(states), dtype=float)
    commands = np.broadcast_to(np.asarray(speeds, dtype=float), (len(moved), 2)).copy()
    table = np.atleast_2d(np.asarray(p, dtype=float))
    table = np.broadcast_to(table, (len(moved), table.shape[1])).copy()
    loads = np.zeros((len(moved), 6))
    hold_speeds(moved, commands, table, patches, steps, h, euler, loads)
    return moved, loads


def trajectory(speeds, p=FOCCHI, h=MILLISECOND, euler=False, patches=PATCHES, start=None, each=1):
    """States (n + 1, 6) of one vehicle: row k of speeds (n, 2) is held for `each` steps."""
    states = [np.zeros(6) if start is None else np.array(start, dtype=float)]
    for row in np.asarray(speeds, dtype=float):
        states.append(run(states[-1], row, p, each, h, euler, patches)[0][0])
    return np.array(states)


def drive_by_torque(moved, torques, p, steps, h, euler=False, patches=PATCHES, decay=0.0):
    """`Moved` after `steps` steps of the torque-driven plant from (pose, motion, belts)."""
    k, drive, contact = parts(p, patches)
    inverse_belt_mass = p.sprocket_radius**2 / p.sprocket_inertia
    scratch = np.zeros((patch_forces.SCRATCH_ROWS, patch_forces.LANES))
    vehicle = on_one_soil(k, drive, contact, inverse_belt_mass)
    drives = Drives(Belts(*torques), Belts(*torques), decay)
    return advance(scratch, moved, drives, steps, h, vehicle, patches, euler)[0]
