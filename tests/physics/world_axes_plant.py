"""A second implementation of the plant on terrain, to compare with: world axes, implicit Euler.

Written from the equations alone, patch by patch, with 3 x 3 matrices and a dense solve; it shares
nothing with `tracked_env.physics`. First order in the step, so it is run with short ones.
"""

import math

import numpy as np
from numba import njit

SOIL = ("mu", "cohesion_Pa", "shear_modulus_m", "stiffness_N_per_m3", "damping_Ns_per_m3")
SOIL += ("rolling_resistance", "stiffening_s_per_m2")


@njit(cache=True)
def ground(plane, edges, waves, x, y):
    """Height and slopes."""
    h, a, b = plane[0] * x + plane[1] * y, plane[0], plane[1]
    for e in range(edges.shape[0]):
        u = (x - edges[e, 2]) / edges[e, 3]
        if edges[e, 0] == 0.0:  # ramp
            rise, length = edges[e, 1], edges[e, 3]
            if u > 1.0:
                h += rise * (x - edges[e, 2] - 0.5 * length)
                a += rise
            elif u > 0.0:
                h += rise * length * (u / 2 - math.sin(math.pi * u) / (2 * math.pi))
                a += rise * (1 - math.cos(math.pi * u)) / 2
        else:
            if u > 1.0:
                h += edges[e, 1]
            elif u > 0.0:
                h += edges[e, 1] * (u - math.sin(2 * math.pi * u) / (2 * math.pi))
                a += edges[e, 1] * (1 - math.cos(2 * math.pi * u)) / edges[e, 3]
    for s in range(waves.shape[0]):
        phase = waves[s, 1] * x + waves[s, 2] * y + waves[s, 3]
        h += waves[s, 0] * math.sin(phase)
        a += waves[s, 0] * waves[s, 1] * math.cos(phase)
        b += waves[s, 0] * waves[s, 2] * math.cos(phase)
    return h, a, b


@njit(cache=True)
def skew(r):
    """Matrix of the vector product."""
    return np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])


@njit(cache=True)
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


@njit(cache=True)
def euler_step(p, q, motion, belts, h, v, s, n_x, n_y, uniform, terrain, loads, shift):
    """One step; motion (6,) world axes. v: m, I, height, 2l, B, w; s: mu, c, K, kA, dA, cr, Ktp.

    loads[0], loads[1]: total and largest normal load at the beginning of the step. shift (3,): of
    the centre of mass, which p is.
    """
    plane, edges, waves = terrain
    m, g = v[0], 9.81
    rot = matrix(q)
    body = rot.T @ motion[3:]
    inertia = rot @ np.diag(v[1:4]) @ rot.T
    z_c, half, gauge, width = v[4], 0.5 * v[5], v[6], v[7]
    mu, c, modulus, k_a, d_a, c_r, k_tp = s
    a_p = 2 * half * width / (n_x * n_y)
    area = 4 * half * width
    left = np.zeros((6, 6))
    left[0, 0] = left[1, 1] = left[2, 2] = m
    left[3:, 3:] = inertia
    right = left @ motion
    right[2] -= h * m * g
    right[3:] -= h * np.cross(motion[3:], inertia @ motion[3:])
    forward = rot[:, 0].copy()
    v_x = np.dot(forward, motion[:3])
    total, largest = 0.0, 0.0
    normal, share = np.zeros(3), 0.0
    if uniform:
        arm = rot @ (np.array([0.0, 0.0, -z_c]) - shift)
        place = p + arm
        height, a, b = ground(plane, edges, waves, place[0], place[1])
        normal = np.array([-a, -b, 1.0]) / math.sqrt(1 + a * a + b * b)
        rho = (height - place[2]) * normal[2]
        u = motion[:3] + np.cross(motion[3:], arm)
        force = area * (k_a * rho - d_a * np.dot(normal, u))
        if rho > 0 and force > 0:
            jac = np.zeros((3, 6))
            jac[:, :3] = np.eye(3)
            jac[:, 3:] = -skew(arm)
            along = normal @ jac
            left += (h * d_a * area + h * h * k_a * area) * np.outer(along, along)
            right += h * k_a * area * rho * along
            k_x = k_a * area * (gauge**2 / 4 + width**2 / 12)
            k_y = k_a * area * half * half / 3
            n_b = rot.T @ normal
            total, share = force, force / (2 * n_x * n_y)
            largest = share
            for axis in range(2):
                stiff = k_x if axis == 0 else k_y
                limit = force * (gauge + width) / 2 if axis == 0 else force * half
                lean = -n_b[1] if axis == 0 else n_b[0]
                e = rot[:, axis].copy()
                moment = stiff * lean - stiff * d_a / k_a * body[axis]
                if abs(moment) > limit:
                    right[3:] += h * math.copysign(limit, moment) * e
                else:
                    right[3:] += h * stiff * lean * e
                    left[3:, 3:] += (h * stiff * d_a / k_a + h * h * stiff) * np.outer(e, e)
    for side in range(2):
        for i in range(n_x):
            for k_row in range(n_y):
                x = half * (1 - (2 * i + 1) / n_x)
                y = (0.5 - side) * gauge + width * ((k_row + 0.5) / n_y - 0.5)
                arm = rot @ (np.array([x, y, -z_c]) - shift)
                place = p + arm
                u = motion[:3] + np.cross(motion[3:], arm)
                jac = np.zeros((3, 6))
                jac[:, :3] = np.eye(3)
                jac[:, 3:] = -skew(arm)
                if uniform:
                    n, load = normal, share
                    if share <= 0:
                        continue
                else:
                    height, a, b = ground(plane, edges, waves, place[0], place[1])
                    n = np.array([-a, -b, 1.0]) / math.sqrt(1 + a * a + b * b)
                    rho = (height - place[2]) * n[2]
                    f = 1 + k_tp * v_x * (x + np.sign(v_x) * half)
                    load = a_p * (k_a * f * rho - d_a * np.dot(n, u))
                    if rho <= 0 or load <= 0:
                        continue
                    total += load
                    largest = max(largest, load)
                    along = n @ jac
                    left += (h * d_a * a_p + h * h * k_a * f * a_p) * np.outer(along, along)
                    right += h * k_a * f * rho * a_p * along
                belt = belts[side]
                tangent = forward - np.dot(forward, n) * n
                size = math.sqrt(np.dot(tangent, tangent))
                t = tangent / size
                side_way = np.cross(n, t)
                u_t, u_q = np.dot(u, t), np.dot(u, side_way)
                speed = belt * size
                slow = max(abs(belt), 1e-6)
                time = (half - (1.0 if belt >= 0 else -1.0) * x * abs(belt) / slow) / slow
                turn = min(max(np.dot(n, motion[3:]) * time, -1e5), 1e5)
                s_f = math.sin(turn) / turn if turn != 0 else 1.0
                c_f = (1 - math.cos(turn)) / turn if turn != 0 else 0.0
                j = time * math.hypot(u_t * s_f - speed - u_q * c_f, u_t * c_f + u_q * s_f)
                j += 0.1 * half * max(abs(turn) - 4 * math.pi, 0.0)
                slip = math.sqrt((u_t - speed) ** 2 + u_q**2 + 1e-18)
                k = (c * a_p + mu * load) * (1 - math.exp(-j / modulus)) / slip
                k_r = c_r * load / math.sqrt(u_t * u_t + 1e-4)
                drag = k * (np.eye(3) - np.outer(n, n)) + k_r * np.outer(t, t)
                left += h * (jac.T @ drag @ jac)
                right += h * k * (tangent * belt @ jac)
    loads[0], loads[1] = total, largest
    new = np.linalg.solve(left, right)
    p = p + h * new[:3]
    turn = h * new[3:]
    angle = math.sqrt(np.dot(turn, turn))
    ratio = 0.5 if angle < 1e-9 else math.sin(angle / 2) / angle
    w, v_q = math.cos(angle / 2), ratio * turn
    turned = np.empty(4)
    turned[0] = w * q[0] - np.dot(v_q, q[1:])
    turned[1:] = w * q[1:] + q[0] * v_q + np.cross(v_q, q[1:])
    return p, turned / math.sqrt((turned * turned).sum()), new


def _run(p, q, belts, h, every, v, s, n_x, n_y, uniform, terrain, shift, out):
    motion, loads = np.zeros(6), np.zeros(2)
    p = p + matrix(q) @ shift
    for k in range(len(belts)):
        before_p, before_q, before = p, q, motion
        p, q, motion = euler_step(
            p, q, motion, belts[k], h, v, s, n_x, n_y, uniform, terrain, loads, shift
        )
        if k % every == 0:
            row, rot = out[k // every], matrix(before_q)
            row[:3], row[3:7] = before_p - rot @ shift, before_q
            row[7:10], row[10:13] = rot.T @ before[:3], rot.T @ before[3:]
            row[13], row[14] = loads


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
    patches = vehicle["patches_along"], vehicle["patches_across"], spec["load"] == "uniform"
    shift = np.array(vehicle.get("shift", [0.0, 0.0, 0.0]))
    _run(*pose, belts, h, every, v, s, *patches, arrays, shift, out)
    return out[: round(duration / 0.01) + 1]
