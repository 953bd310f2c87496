"""A tracked vehicle that shares no code with this package: logs of known truth for its commands.

    m (dv_x/dt - w v_y) = sum of (F_k - R_k),   m (dv_y/dt + w v_x) = F_y
    I dw/dt = (B / 2) (F_R - R_R - F_L + R_L) + M,   F_k = torque_k / r,  R_k = mu_l m g/2 s(V_k)
    F_y, M = -(mu_t m g / l) integral over the contact of s(v_y + x w) {1, x} dx, by quadrature
    s(v) = v / sqrt(v^2 + smoothing^2), or tanh(v / smoothing)
    slip of a track: Janosi-Hanamoto, F = F_max (1 - (1 - exp(-u)) / u), u = i l / K, by brentq
The smoothing of friction is an argument. Torques follow a wanted speed and yaw rate. Integrated by
LSODA of SciPy. Equations: Strawa et al. (2021) sections 4.1 to 4.1.3, without a track's inertia.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

GRAVITY = 9.81
NODES, WEIGHTS = np.polynomial.legendre.leggauss(96)
Columns = dict[str, Any]


class Vehicle(NamedTuple):
    """True values, SI."""

    mass: float = 1650.0
    inertia: float = 1400.0
    gauge: float = 1.7
    length: float = 2.0
    width: float = 0.3
    radius: float = 0.3
    mu_l: float = 0.1
    mu_t: float = 0.7
    effort_maximum: float = 20e3  # of a track
    shear_modulus: float = 0.03
    smoothing: float = 0.005  # [m/s] of all friction
    law: str = "algebraic"  # of the smoothing, or "tanh"
    torque_limit: float = 5000.0
    speed: float = 2.0  # [m/s] of its references


class Noise(NamedTuple):
    """Standard deviations: the data sheet `rtk`."""

    position: float = 0.02
    yaw: float = np.radians(0.3)
    velocity: float = 0.03
    acceleration: float = 0.05
    bias: float = 0.02
    gyro: float = 0.002
    gyro_bias: float = 0.001
    sprocket: float = 0.02
    torque: float = 10.0


def references(seed, vehicle, kind="mixed"):
    """Wanted (speed, yaw rate) over time: "mixed", "reverse", "straight" or "pivot"."""
    draw = np.random.default_rng(seed)
    rates, phases = draw.uniform(0.25, 1.2, (2, 3)), draw.uniform(0.0, 6.28, (2, 3))
    turn = 0.7 if kind != "straight" else 0.0

    def reference(time):
        waves = np.sin(rates * time + phases).mean(axis=1)
        forward = {"reverse": -0.7, "pivot": 0.0}.get(kind, 0.7) + 0.6 * waves[0] * (
            kind != "pivot"
        )
        return vehicle.speed * forward, turn * vehicle.speed / 2.0 * 2.0 * waves[1]

    return reference


def friction(speed, vehicle):
    """Sign of a sliding speed [m/s], smoothed."""
    if vehicle.law == "tanh":
        return np.tanh(speed / vehicle.smoothing)
    return speed / np.sqrt(speed * speed + vehicle.smoothing**2)


def _torques(motion, time, v, reference):
    """Of both sprockets, that bring speed and yaw rate to the wanted ones."""
    speed, rate = reference(time)
    push = v.mass * (2.0 * (speed - motion[3]) + GRAVITY * v.mu_l * np.tanh(speed / 0.1))
    turn = 0.25 * v.mu_t * v.mass * GRAVITY * v.length * np.tanh(8.0 * rate)
    turn += 4.0 * v.inertia * (rate - motion[5])
    left, right = 0.5 * push - turn / v.gauge, 0.5 * push + turn / v.gauge
    limit = 0.9 * v.effort_maximum * v.radius
    limit = min(limit, v.torque_limit)
    return tuple(float(limit * np.tanh(v.radius * f / limit)) for f in (left, right))


def _rates(time, motion, v, reference, payload):
    """Derivatives of x, y, yaw, v_x, v_y, yaw rate."""
    _, _, yaw, v_x, v_y, w = motion
    left, right = _torques(motion, time, v, reference)
    tracks = np.array([v_x - 0.5 * v.gauge * w, v_x + 0.5 * v.gauge * w])
    mass = v.mass + payload(time)
    pull = np.array([left, right]) / v.radius
    pull = pull - 0.5 * v.mu_l * mass * GRAVITY * friction(tracks, v)
    stations = 0.5 * v.length * NODES
    sliding = friction(v_y + stations * w, v) * (0.5 * v.mu_t * mass * GRAVITY * WEIGHTS)
    lateral, moment = -sliding.sum(), -(sliding * stations).sum()
    c, s = np.cos(yaw), np.sin(yaw)
    turn = (0.5 * v.gauge * (pull[1] - pull[0]) + moment) / v.inertia
    acceleration = pull.sum() / mass + w * v_y, lateral / mass - w * v_x
    return np.array([c * v_x - s * v_y, s * v_x + c * v_y, w, *acceleration, turn])


def slip(effort, v):
    """Slip ratio at which Janosi-Hanamoto gives the effort [N]; the sign is that of the effort."""
    share = min(abs(effort) / v.effort_maximum, 0.97)

    def lacking(i):
        u = i * v.length / v.shear_modulus
        return 1.0 - (1.0 - np.exp(-u)) / u - share

    if lacking(1.0) < 0.0:
        return float(np.sign(effort)) * 0.97
    return float(np.sign(effort) * brentq(lacking, 1e-9, 1.0, xtol=1e-9)) if share > 1e-6 else 0.0


def drive(vehicle=None, seed=0, duration=40.0, rate=50.0, kind="mixed", noise=None, payload=None):
    """Columns of a log with the names of `tracked-env identify`. payload: [kg] over time [s]."""
    v, sheet = vehicle or Vehicle(), noise or Noise()
    extra = payload or (lambda time: 0.0)
    reference = references(seed, v, kind)
    time = np.arange(int(duration * rate) + 1) / rate
    start = np.array([3.0, -2.0, 0.4, 0.0, 0.0, 0.0])
    options = {"args": (v, reference, extra), "rtol": 1e-6, "atol": 1e-8, "max_step": 0.2}
    states = solve_ivp(_rates, (0.0, time[-1]), start, "LSODA", time, **options).y.T
    steps = [*zip(time, states, strict=True)]
    change = np.array([_rates(t, s, v, reference, extra) for t, s in steps])
    torques = np.array([_torques(s, t, v, reference) for t, s in steps])
    draw = np.random.default_rng(seed + 1000)

    def noisy(value, sigma):
        return value + sigma * draw.standard_normal(len(time))

    x, y, yaw, v_x, v_y, w = states.T
    bias = draw.choice([-1.0, 1.0], 4)
    bend = np.sqrt(2.0) * sheet.acceleration
    columns = {
        "time": time,
        "x": noisy(x, sheet.position),
        "y": noisy(y, sheet.position),
        "yaw": noisy(yaw, sheet.yaw),
        "v_x": noisy(v_x, sheet.velocity),
        "v_y": noisy(v_y, sheet.velocity),
        "yaw_rate": noisy(w, sheet.gyro) + sheet.gyro_bias * bias[0],
        "acceleration_x": noisy(change[:, 3] - w * v_y, sheet.acceleration) + sheet.bias * bias[1],
        "acceleration_y": noisy(change[:, 4] + w * v_x, sheet.acceleration) + sheet.bias * bias[2],
        "yaw_acceleration": noisy(change[:, 5], bend) + np.sqrt(2.0) * sheet.bias * bias[3],
    }
    for k, side in enumerate(("left", "right")):
        track = v_x + (k - 0.5) * v.gauge * w
        ratio = np.array([slip(of / v.radius, v) for of in torques[:, k]])
        signed = np.sign(track) * ratio  # > 0: driving, belt = V / (1 - i); < 0: V (1 + i)
        belt = np.where(signed >= 0.0, track / (1.0 - np.abs(signed)), track * (1.0 + signed))
        columns[f"sprocket_speed_{side}"] = noisy(belt / v.radius, sheet.sprocket)
        columns[f"torque_{side}"] = noisy(torques[:, k], sheet.torque)
    return columns


def write(columns, path=Path("log.csv"), header=""):
    """The columns as a CSV file with a header."""
    table, names = np.column_stack([*columns.values()]), header or ",".join(columns)
    np.savetxt(path, table, delimiter=",", comments="", header=names, fmt="%.14g")
    return path
