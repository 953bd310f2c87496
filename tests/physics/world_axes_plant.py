"""A second implementation of the plant on terrain, to compare with: world axes, implicit Euler.

Written from the equations alone, patch by patch, with 3 x 3 matrices and a dense solve; it shares
nothing with `tracked_env.physics`. First order in the step, so it is run with short ones.
"""

import math

import numpy as np

SOIL = ("mu", "cohesion_Pa", "shear_modulus_m", "stiffness_N_per_m3", "damping_Ns_per_m3")
SOIL += ("rolling_resistance", "stiffening_s_per_m2")


def ground(terrain, x, y):
    """Heights and unit normals (P, 3) at places (P,)."""
    plane, edges, waves = terrain
    h, a, b = plane[0] * x + plane[1] * y, plane[0] + 0.0 * x, plane[1] + 0.0 * x
    for kind, rise, begin, length in edges:
        u = np.clip((x - begin) / length, 0.0, 1.0)
        beyond = np.maximum(x - begin - length, 0.0)
        if kind == 0.0:  # ramp
            h += rise * (length * (u / 2 - np.sin(math.pi * u) / (2 * math.pi)) + beyond)
            a += rise * (1 - np.cos(math.pi * u)) / 2
        else:
            h += rise * (u - np.sin(2 * math.pi * u) / (2 * math.pi))
            a += rise * (1 - np.cos(2 * math.pi * u)) / length
    for size, along, across, phase in waves:
        angle = along * x + across * y + phase
        h += size * np.sin(angle)
        a += size * along * np.cos(angle)
        b += size * across * np.cos(angle)
    normals = np.stack([-a, -b, np.ones_like(a)], axis=1)
    return h, normals / np.sqrt(1 + a * a + b * b)[:, None]


def dot(a, b):
    """Products of rows (P, 3)."""
    return (a * b) @ np.ones(3)


def skew(r):
    """Matrices (P, 3, 3) of the vector product with rows (P, 3)."""
    out = np.zeros((len(r), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -r[:, 2], r[:, 1], -r[:, 0]
    return out - out.transpose(0, 2, 1)


def matrix(q):
    """Rotation matrix of a quaternion."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def jacobian(arms):
    """Velocities of points at arms (P, 3) from that of the vehicle, (P, 3, 6)."""
    return np.concatenate([np.broadcast_to(np.eye(3), (len(arms), 3, 3)), -skew(arms)], axis=2)


def bear_evenly(place, arm, rot, motion, h, v, s, terrain, left, right):
    """The load of one elastic plane under the vehicle, added to both sides; normal and load."""
    half, gauge, width = 0.5 * v[5], v[6], v[7]
    k_a, d_a, area = s[3], s[4], 4 * half * width
    body, (height, normals) = rot.T @ motion[3:], ground(terrain, place[:1], place[1:2])
    normal, jac = normals[0], jacobian(arm[None])[0]
    rho = (height[0] - place[2]) * normal[2]
    force = area * (k_a * rho - d_a * normal @ jac @ motion)
    if rho <= 0 or force <= 0:
        return normal, 0.0
    along = normal @ jac
    left += (h * d_a * area + h * h * k_a * area) * np.outer(along, along)
    right += h * k_a * area * rho * along
    n_b = rot.T @ normal
    springs = (
        (k_a * area * (gauge**2 / 4 + width**2 / 12), force * (gauge + width) / 2, -n_b[1]),
        (k_a * area * half * half / 3, force * half, n_b[0]),
    )
    for axis, (stiff, limit, lean) in enumerate(springs):
        moment, e = stiff * lean - stiff * d_a / k_a * body[axis], rot[:, axis]
        if abs(moment) > limit:
            right[3:] += h * math.copysign(limit, moment) * e
        else:
            right[3:] += h * stiff * lean * e
            left[3:, 3:] += (h * stiff * d_a / k_a + h * h * stiff) * np.outer(e, e)
    return normal, force


def euler_step(p, q, motion, belts, h, v, s, grid, uniform, terrain, loads, shift):
    """One step; motion (6,) world axes. v: m, I, height, 2l, B, w; s: mu, c, K, kA, dA, cr, Ktp.

    grid: x, y (P,) of the patches and which belt they are on. loads[0], loads[1]: total and largest
    normal load at the beginning of the step. shift (3,): of the centre of mass, which p is.
    """
    m, g = v[0], 9.81
    rot = matrix(q)
    inertia = rot @ np.diag(v[1:4]) @ rot.T
    z_c, half, width = v[4], 0.5 * v[5], v[7]
    mu, c, modulus, k_a, d_a, c_r, k_tp = s
    x, y, side = grid
    a_p = 4 * half * width / len(x)
    left = np.zeros((6, 6))
    left[:3, :3], left[3:, 3:] = m * np.eye(3), inertia
    right = left @ motion
    right[2] -= h * m * g
    right[3:] -= h * np.cross(motion[3:], inertia @ motion[3:])
    forward = rot[:, 0]
    arms = (np.stack([x, y, np.full_like(x, -z_c)], axis=1) - shift) @ rot.T
    jac = jacobian(arms)
    u = jac @ motion
    if uniform:
        arm = rot @ (np.array([0.0, 0.0, -z_c]) - shift)
        normal, total = bear_evenly(p + arm, arm, rot, motion, h, v, s, terrain, left, right)
        n, load = np.broadcast_to(normal, u.shape), np.full_like(x, total / len(x))
        bears = load > 0
    else:
        places, v_x = p + arms, forward @ motion[:3]
        height, n = ground(terrain, places[:, 0], places[:, 1])
        rho = (height - places[:, 2]) * n[:, 2]
        f = 1 + k_tp * v_x * (x + np.sign(v_x) * half)
        load = a_p * (k_a * f * rho - d_a * dot(n, u))
        bears = (rho > 0) & (load > 0)
        along = (n[:, None, :] @ jac)[bears, 0]
        stiff = ((h * d_a + h * h * k_a * f) * a_p)[bears]
        left += (stiff[:, None] * along).T @ along
        right += (h * k_a * f * rho * a_p)[bears] @ along
        load = np.where(bears, load, 0.0)
    loads[0], loads[1] = load.sum(), load.max()
    n, u, jac, load, x = n[bears], u[bears], jac[bears], load[bears], x[bears]
    belt = belts[side[bears]]
    tangent = forward - (n @ forward)[:, None] * n
    size = np.sqrt(dot(tangent, tangent))
    t = tangent / size[:, None]
    u_t, u_q = dot(u, t), dot(np.cross(u, n), t)
    speed, slow = belt * size, np.maximum(np.abs(belt), 1e-6)
    time = (half - np.where(belt >= 0, 1.0, -1.0) * x * np.abs(belt) / slow) / slow
    turn = np.clip((n @ motion[3:]) * time, -1e5, 1e5)
    safe = np.where(turn == 0.0, 1.0, turn)
    s_f, c_f = np.where(turn == 0.0, 1.0, np.sin(turn) / safe), (1 - np.cos(turn)) / safe
    j = time * np.hypot(u_t * s_f - speed - u_q * c_f, u_t * c_f + u_q * s_f)
    j += 0.1 * half * np.maximum(np.abs(turn) - 4 * math.pi, 0.0)
    slip = np.sqrt((u_t - speed) ** 2 + u_q**2 + 1e-18)
    k = (c * a_p + mu * load) * (1 - np.exp(-j / modulus)) / slip
    k_r = c_r * load / np.sqrt(u_t * u_t + 1e-4)
    drag = k[:, None, None] * (np.eye(3) - n[:, :, None] * n[:, None, :])
    drag += k_r[:, None, None] * t[:, :, None] * t[:, None, :]
    rows = jac.reshape(-1, 6)
    left += h * rows.T @ (drag @ jac).reshape(-1, 6)
    right += h * ((k * belt)[:, None] * tangent).ravel() @ rows
    new = np.linalg.solve(left, right)
    p = p + h * new[:3]
    turn = h * new[3:]
    angle = math.sqrt(turn @ turn)
    ratio = 0.5 if angle < 1e-9 else math.sin(angle / 2) / angle
    w, v_q = math.cos(angle / 2), ratio * turn
    turned = np.empty(4)
    turned[0] = w * q[0] - v_q @ q[1:]
    turned[1:] = w * q[1:] + q[0] * v_q + np.cross(v_q, q[1:])
    return p, turned / math.sqrt((turned * turned).sum()), new


def _run(p, q, belts, h, every, v, s, grid, uniform, terrain, shift, out):
    motion, loads = np.zeros(6), np.zeros(2)
    p = p + matrix(q) @ shift
    for k in range(len(belts)):
        before_p, before_q, before = p, q, motion
        p, q, motion = euler_step(
            p, q, motion, belts[k], h, v, s, grid, uniform, terrain, loads, shift
        )
        if k % every == 0:
            row, rot = out[k // every], matrix(before_q)
            row[:3], row[3:7] = before_p - rot @ shift, before_q
            row[7:10], row[10:13] = rot.T @ before[:3], rot.T @ before[3:]
            row[13], row[14] = loads


def grid_of(vehicle):
    """Patches of both tracks: x and y (P,) in body axes and on which belt they are, left 0."""
    n_x, n_y, half = (
        vehicle["patches_along"],
        vehicle["patches_across"],
        vehicle["track_length"] / 2,
    )
    side, i, k = (each.ravel() for each in np.indices((2, n_x, n_y)))
    x = half * (1 - (2 * i + 1) / n_x)
    y = (0.5 - side) * vehicle["track_gauge"] + vehicle["track_width"] * ((k + 0.5) / n_y - 0.5)
    return x, y, side


def euler_run(spec, h, duration=None):
    """Rows of x, y, z, q, v, W (body axes), N_total, N_patch_max every 10 ms, of a dict as in
    `runs.json`, or with a `shift` of the centre of mass; positions are those of the nominal one."""
    vehicle, soil, terrain = spec["vehicle"], spec["soil"], spec["terrain"]
    duration = spec["duration"] if duration is None else duration
    every, steps = round(0.01 / h), round(duration / h)
    times = (np.arange(steps + every) + 1) * h
    command = spec["command"]
    belts = vehicle["sprocket_radius"] * np.stack(
        [np.interp(times, command["t"], command[side]) for side in "LR"], axis=1
    )
    edges = [[k, *terrain[name]] for k, name in enumerate(("ramp", "step")) if name in terrain]
    rows = (
        np.array(each, dtype=float).reshape(-1, 4) for each in (edges, terrain.get("sines", []))
    )
    arrays = (np.array([terrain.get("a", 0.0), terrain.get("b", 0.0)]), *rows)
    sizes = ("com_height", "track_length", "track_gauge", "track_width")
    v = np.array([vehicle["m"], *vehicle["inertia"], *(vehicle[name] for name in sizes)])
    s = np.array([soil[name] for name in SOIL])
    out = np.zeros((-(-len(belts) // every), 15))
    start = spec["initial"]
    pose = (np.array(start[name], dtype=float) for name in "pq")
    shift = np.array(vehicle.get("shift", [0.0, 0.0, 0.0]))
    uniform = spec["load"] == "uniform"
    _run(*pose, belts, h, every, v, s, grid_of(vehicle), uniform, arrays, shift, out)
    return out[: round(duration / 0.01) + 1]
