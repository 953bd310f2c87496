"""Uniform load: a vehicle on one foot with springs against tilt, the load shared by all patches.

Equations, at the foot r0 = (-c_x, -c_y, -h) in the middle of the tracks (symbols in NOTATION.md):
    F   = A max(0, k_A rho + d_A rho') if rho > 0, along n;  N = F / patches
    M_x = -K_x n_y - D_x W_x,   M_y = K_y n_x - D_y W_y          n in body axes; 0 when F = 0
    K_x = k_A A (B^2/4 + w^2/12),  K_y = k_A A l^2/3,  D = K d_A / k_A
    |M_x| <= F (B + w)/2,  |M_y| <= F l                  and r0 x F n beside M
These are the rocking stiffnesses of the springs that the nonuniform load has under its patches. The
ground under the foot stands for all ground under the vehicle: a plane that touches it.

Validity: beyond the bounds of M the vehicle would tip; here its patches in the air still carry
load. Reaching a bound (`Tilt.saturated`) is a failure of the model.
References: [1] Focchi et al. (2025) section 2.2, corrected; see docs/terrain.md.
"""

from typing import NamedTuple

from tracked_env.physics.contact_totals import Drag, Wrench
from tracked_env.physics.ground_contact import (
    AHEAD,
    HEIGHT,
    INVERSE_AHEAD,
    LOAD,
    N_X,
    N_Y,
    N_Z,
    PLACE_X,
    PLACE_Y,
    PLACE_Z,
    SINKAGE,
    normal_load,
)
from tracked_env.physics.jit import formula


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
def rocking_of(footing, half_gauge, track_width, count):
    """Rocking of two tracks with `count` patches in all."""
    area = footing.patch_area * count
    spring = footing.stiffness * area
    length = footing.half_length
    return Rocking(
        area,
        spring * (half_gauge * half_gauge + track_width * track_width / 12.0),
        spring * length * length / 3.0,
        half_gauge + 0.5 * track_width,
        footing.damping / footing.stiffness,
    )


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
def share_load(w, patches, load):
    """Row LOAD: the load [N] in equal parts on all patches."""
    for lane in range(patches):
        w[LOAD, lane] = load / patches


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
    roll, in_roll = _bounded(-k.roll * (b + k.retardation * twist.roll), load * k.half_width)
    pitch, in_pitch = _bounded(
        k.pitch * (a - k.retardation * twist.pitch), load * footing.half_length
    )
    return Tilt(
        load, roll, pitch, touching * in_roll * k.roll * k.retardation,
        touching * in_pitch * k.pitch * k.retardation, touching * (1.0 - in_roll * in_pitch),
    )  # fmt: skip


@formula
def held(w, tilt, footing, k, wrench, drag):
    """Wrench and Drag of the shear of all patches, and those of load and tilt added."""
    a, b, c = w[N_X, 0], w[N_Y, 0], w[N_Z, 0]
    # r0 x n, the moment of a force of 1 N along the normal at the foot.
    roll = footing.height * b - footing.aside * c
    pitch = footing.ahead * c - footing.height * a
    yaw = footing.aside * a - footing.ahead * b
    wrench = Wrench(
        wrench.x + tilt.load * a,
        wrench.y + tilt.load * b,
        wrench.z + tilt.load * c,
        wrench.roll + tilt.roll + tilt.load * roll,
        wrench.pitch + tilt.pitch + tilt.load * pitch,
        wrench.yaw + tilt.load * yaw,
    )
    d = k.area * footing.damping if tilt.load > 0.0 else 0.0
    x, y, z, turn, nod = d * a, d * b, d * c, d * roll, d * pitch
    return wrench, Drag(
        drag.xx + x * a, drag.yx + x * b, drag.yy + y * b,
        drag.zx + x * c, drag.zy + y * c, drag.zz + z * c,
        drag.rx + turn * a, drag.ry + turn * b, drag.rz + turn * c,
        drag.rr + turn * roll + tilt.roll_drag,
        drag.px + nod * a, drag.py + nod * b, drag.pz + nod * c,
        drag.pr + nod * roll, drag.pp + nod * pitch + tilt.pitch_drag,
        drag.wx + yaw * x, drag.wy + yaw * y, drag.wz + yaw * z,
        drag.wr + yaw * turn, drag.wp + yaw * nod, drag.ww + d * yaw * yaw,
    )  # fmt: skip
