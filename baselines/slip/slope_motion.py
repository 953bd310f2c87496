"""Motion of a vehicle on a plane whose slope, seen from the vehicle, stays what it is.

A vehicle that turns on a slope has no steady motion: the direction of gravity in its axes turns
with it. F 4.5 identifies slip as a function of that direction, so here it is held: after every
few steps the world is turned about the centre of mass until gravity is back where it was, the
ground and all motion with it. What is then steady is the motion of a vehicle at that moment of a
turn, as long as its direction changes slowly against the time in which slip settles.

State (STATE_SIZE): twist v_x, v_y, v_z, roll, pitch, yaw rate; n_x, n_y of the ground's normal in
body axes; distance of the centre of mass from the ground along that normal. The model is that of
`physics.terrain_motion`, springs, load transfer and all. Attitude: (roll, pitch), the yaw is 0.

References: [F] Focchi et al. (2025), section 4.5.
"""

import math

import numpy as np

from tracked_env.physics import ground_contact as g
from tracked_env.physics import terrain_motion
from tracked_env.physics.attitude import matrix_of, quaternion_of, turned
from tracked_env.physics.ground_contact import Twist
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import row_parameters
from tracked_env.physics.patch_dynamics import Belts
from tracked_env.physics.terrain_motion import Pose3
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.physics.tracked_body import body_of, set_soil

NORMAL_X, NORMAL_Y, DISTANCE = 6, 7, 8
STATE_SIZE = 9
PLANAR, CONTACT = [0, 1, 5], [2, 3, 4, 6, 7, 8]  # v_x, v_y, yaw rate; and all the rest


@formula
def _fill_plane(plane, w, count):
    """The ground a x + b y in lanes 0 .. count - 1; plane: (a, b). Nothing is off it."""
    a, b = plane
    for lane in range(count):
        w[g.HEIGHT, lane] = a * w[g.PLACE_X, lane] + b * w[g.PLACE_Y, lane]
        w[g.SLOPE_X, lane] = a
        w[g.SLOPE_Y, lane] = b
    return 0.0


@formula
def _rest(states, i, body, upright):
    """Set the contact of vehicle i: sunk in as far as a load m g `upright` needs, no tilt."""
    sink = GRAVITY * body.inertia.mass * upright / (body.rocking.area * body.footing.stiffness)
    states[i, NORMAL_X], states[i, NORMAL_Y] = 0.0, 0.0
    states[i, DISTANCE] = body.footing.height - sink


@formula
def _move(states, i, w, q, belts, steps, h, body):
    """Advance vehicle i by `steps` steps of h [s]; q: its attitude in the middle of them."""
    twist = Twist(
        states[i, 0], states[i, 1], states[i, 2], states[i, 3], states[i, 4], states[i, 5]
    )  # fmt: skip
    back = -0.5 * steps * h
    q = turned(q, back * twist.roll, back * twist.pitch, back * twist.yaw)
    r = matrix_of(q)
    n_x, n_y = states[i, NORMAL_X], states[i, NORMAL_Y]
    n_z = math.sqrt(max(1.0 - n_x * n_x - n_y * n_y, 0.0))
    up_x = r.xx * n_x + r.xy * n_y + r.xz * n_z
    up_y = r.yx * n_x + r.yy * n_y + r.yz * n_z
    up_z = r.zx * n_x + r.zy * n_y + r.zz * n_z
    plane = (-up_x / up_z, -up_y / up_z)
    pose = Pose3(0.0, 0.0, states[i, DISTANCE] / up_z, q)
    (pose, twist, _belts), _command, _kick, _off = terrain_motion.advance(
        _fill_plane, plane, w, (pose, twist, belts), belts, belts, 0.0, steps, h, body
    )
    r = matrix_of(pose.q)
    states[i, 0], states[i, 1], states[i, 2] = twist.x, twist.y, twist.z
    states[i, 3], states[i, 4], states[i, 5] = twist.roll, twist.pitch, twist.yaw
    states[i, NORMAL_X] = r.xx * up_x + r.yx * up_y + r.zx * up_z
    states[i, NORMAL_Y] = r.xy * up_x + r.yy * up_y + r.zy * up_z
    states[i, DISTANCE] = up_x * pose.x + up_y * pose.y + up_z * pose.z


@loop
def hold_on_slope(
    states, attitude, sprockets, rows, columns, lines, made, uniform, steps, h,
    tolerance, most, taken,
):  # fmt: skip
    """Hold sprocket speeds (N, 2) [rad/s] on slopes: `most` times `steps` steps of h [s].

    states (N, STATE_SIZE) in and out; a DISTANCE of 0 begins with a contact at rest. attitude
    (N, 2) roll, pitch [rad]. rows: PlantParameters (N, ...). columns, lines: middles of the
    patches, see `ground_contact.place_patches`; made: numbers of `tracked_body.body_of`; uniform:
    load model. A vehicle ends early when its motion changes by less than `tolerance` [m/s^2, of
    the outer track]. taken (N,) [s] out: time held, or infinity where it was not steady by then.
    """
    w = np.empty((g.SCRATCH_ROWS, g.padded(2 * columns.size * lines.size)))
    for i in range(states.shape[0]):
        p = row_parameters(rows, i, 0)
        count = columns.size * lines.size
        half_gauge = 0.5 * p.track_gauge
        lanes = g.place_patches(
            w, columns, lines, 0.5 * p.contact_length, half_gauge, p.track_width
        )
        body = body_of(p, lanes, count, made, False, uniform)
        set_soil(w, 0, lanes, p, body.footing.patch_area)
        roll, pitch = attitude[i, 0], attitude[i, 1]
        if states[i, DISTANCE] == 0.0:
            _rest(states, i, body, math.cos(pitch) * math.cos(roll))
        q = quaternion_of(0.0, pitch, roll)
        belts = Belts(p.sprocket_radius * sprockets[i, 0], p.sprocket_radius * sprockets[i, 1])
        taken[i] = math.inf
        for k in range(most):
            v_x, v_y, yaw_rate = states[i, 0], states[i, 1], states[i, 5]
            _move(states, i, w, q, belts, steps, h, body)
            change = abs(states[i, 0] - v_x) + abs(states[i, 1] - v_y)
            change += half_gauge * abs(states[i, 5] - yaw_rate)
            if change < tolerance * steps * h:
                taken[i] = (k + 1) * steps * h
                break
