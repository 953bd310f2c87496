"""How the trajectory of the torque plant depends on the sub-step: the table of docs/numerics.md.

    python -m docs.step_halving        prints the Markdown table

Each manoeuvre lasts 5 s under a 50 Hz control law (torque = feedforward + gain * speed error)
and is repeated with ever shorter sub-steps. Its error is the largest distance, and the largest
heading difference, to the same manoeuvre with a sub-step of 0.05 ms, over all control instants. A
second table has random torques: median and worst over 40 runs.
The loop is the one a simulation runs around `rk4_step`, for one vehicle.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tracked_env.physics.elementary import small_rotation
from tracked_env.physics.lumped_forces import (
    constrained_accelerations,
    sliding_accelerations,
    traction_limits,
)
from tracked_env.physics.parameters import PlantParameters, SoilParameters, plant_parameters
from tracked_env.physics.rk4 import rk4_step
from tracked_env.physics.vehicle import Motion, coefficients, drive_limits, torque_decay
from tracked_env.uncertainty import SOILS

CONTROL_PERIOD = 0.02  # [s] one torque demand
DURATION = 5.0  # [s] of one manoeuvre
STEPS = int(DURATION / CONTROL_PERIOD)
SUBSTEPS = (2, 4, 8, 16, 32)  # per control period: 10, 5, 2.5, 1.25, 0.625 ms
REFERENCE_SUBSTEPS = 400  # 0.05 ms
REST = Motion(0.0, 0.0, 0.0)
SANDY_LOAM = SoilParameters(cohesion=9.65e3, friction_angle=math.radians(35.0))


class Command(NamedTuple):
    """What the control law wants, per control period."""

    torque: np.ndarray  # (n, 2) [N m] feedforward, left and right
    speed: np.ndarray  # (n, 2) [m/s, rad/s] forward speed and yaw rate
    speed_gain: float = 0.0  # [N m s/m] on both sprockets
    yaw_rate_gain: float = 0.0  # [N m s/rad] minus on the left, plus on the right


@njit(cache=False, error_model="numpy")
def substep(constrained, motion, torque, demand, decay, k, drive, h):
    """One sub-step: traction limits, torque at the three stage times, RK4."""
    limits = traction_limits(motion, k.half_gauge, drive)
    middle = (
        demand[0] + decay * (torque[0] - demand[0]),
        demand[1] + decay * (torque[1] - demand[1]),
    )
    end = (
        demand[0] + decay * (middle[0] - demand[0]),
        demand[1] + decay * (middle[1] - demand[1]),
    )
    if constrained:
        moved = rk4_step(constrained_accelerations, motion, torque, middle, end, k, limits, h)
    else:
        moved = rk4_step(sliding_accelerations, motion, torque, middle, end, k, limits, h)
    return moved, end


@njit(cache=False, error_model="numpy")
def drive_vehicle(
    p, constrained, start, torque, speed, speed_gain, yaw_rate_gain, period, substeps
):
    """Trajectory (n + 1, 8): x, y [m], yaw [rad], v_x, v_y, yaw rate, torque left, right.

    torque, speed: (n, 2) as in Command; period [s] of one control step, cut into `substeps`.
    The vehicle starts at the origin, heading along x, with the velocities `start`; the motors
    start at the first demand.
    """
    steps = torque.shape[0]
    trajectory = np.zeros((steps + 1, 8))
    k, drive = coefficients(p, constrained), drive_limits(p)
    h = period / substeps
    decay = torque_decay(0.5 * h, p.drive_time_constant)
    motion, x, y, yaw, cosine, sine = start, 0.0, 0.0, 0.0, 1.0, 0.0
    motor = (0.0, 0.0)
    for n in range(steps + 1):
        row = min(n, steps - 1)
        push = speed_gain * (speed[row, 0] - motion.v_x)
        turn = yaw_rate_gain * (speed[row, 1] - motion.yaw_rate)
        bound = p.torque_limit
        demand = (
            min(max(torque[row, 0] + push - turn, -bound), bound),
            min(max(torque[row, 1] + push + turn, -bound), bound),
        )
        motor = demand if n == 0 else motor
        trajectory[n, :3] = x, y, yaw
        trajectory[n, 3:] = motion.v_x, motion.v_y, motion.yaw_rate, motor[0], motor[1]
        if n == steps:
            break
        for _ in range(substeps):
            moved, motor = substep(constrained, motion, motor, demand, decay, k, drive, h)
            motion = moved[0]
            x += cosine * moved[1] - sine * moved[2]
            y += sine * moved[1] + cosine * moved[2]
            yaw += moved[3]
            c, s = small_rotation(moved[3])
            cosine, sine = cosine * c - sine * s, sine * c + cosine * s
    return trajectory


def run(command, substeps, p=None, constrained=False, start=REST, period=CONTROL_PERIOD):
    """`drive_vehicle` under a Command; heavy clay unless `p` (PlantParameters) is given."""
    p = plant_parameters() if p is None else p
    return drive_vehicle(
        p, constrained, start, command.torque, command.speed,
        command.speed_gain, command.yaw_rate_gain, period, substeps,
    )  # fmt: skip


def constant(left, right, forward=0.0, yaw_rate=0.0, gains=(0.0, 0.0), steps=STEPS):
    """A Command that never changes."""
    torque = np.tile((float(left), float(right)), (steps, 1))
    return Command(torque, np.tile((float(forward), float(yaw_rate)), (steps, 1)), *gains)


def circle_entry():
    """From rest to 2 m/s on a straight line, then into a circle of 10 m radius at t = 2 s."""
    command = constant(1280.0, 1280.0, 2.0, 0.0, (2000.0, 4000.0))
    turning = slice(int(2.0 / CONTROL_PERIOD), None)
    command.torque[turning] += (-1000.0, 1000.0)
    command.speed[turning, 1] = 0.2
    return command


def reversal():
    """Full torque backwards for 1.5 s, which ends at top speed in reverse, then full torque in
    opposite senses: both tracks leave one traction limit and run into the other."""
    command = constant(-8000.0, -8000.0)
    command.torque[int(1.5 / CONTROL_PERIOD) :] = (-8000.0, 8000.0)
    return command


MANOEUVRES: dict[str, tuple[Command, PlantParameters, Motion]] = {
    "circle entry, R = 10 m at 2 m/s": (circle_entry(), plant_parameters(), REST),
    "pivot turn from rest, ±2500 N m": (constant(-2500, 2500), plant_parameters(), REST),
    "hard braking from 4 m/s": (
        constant(0, 0, gains=(8000.0, 0.0)), plant_parameters(), Motion(4.0, 0.0, 0.0)
    ),
    "full torque on the right track, sandy loam": (
        constant(0, 8000), plant_parameters(soil=SANDY_LOAM), REST
    ),
    "full torque to top speed, heavy clay": (constant(8000, 8000), plant_parameters(), REST),
    "2.5 m/s, into reverse at top speed, pivot": (
        reversal(), plant_parameters(), Motion(2.5, 0.0, 0.0)
    ),
}  # fmt: skip


RANDOM_RUNS = 40  # of each soil
RANDOM_SOILS = {"heavy_clay": 0.6, "sandy_loam": 0.3, "lete_sand": 0.13}  # and their mu_l [-]


def random_torques(seed, steps=STEPS):
    """Torques that jump every 0.1 to 1 s; a third of them at the limit. From 2 m/s on."""
    rng = np.random.default_rng(seed)
    hold = int(rng.integers(5, 50))
    drawn = np.clip(rng.uniform(-1.5, 1.5, (steps // hold + 1, 2)), -1.0, 1.0)
    torque = np.repeat(8000.0 * drawn, hold, axis=0)[:steps]
    return Command(torque, np.zeros((steps, 2)))


def random_errors(soil, resistance, substeps, runs=RANDOM_RUNS):
    """(runs, 2): position error [m] and heading error [rad] of every random run."""
    p = plant_parameters(soil=SOILS[soil]._replace(longitudinal_resistance=resistance))
    start = Motion(2.0, 0.0, 0.0)
    return np.array(
        [errors(random_torques(seed), p, start, counts=(substeps,))[0] for seed in range(runs)]
    )


def errors(command, p, start, constrained=False, counts=SUBSTEPS):
    """[(position error [m], heading error [rad]) for each of `counts` sub-steps]."""
    truth = run(command, REFERENCE_SUBSTEPS, p, constrained, start)
    found = []
    for substeps in counts:
        gap = run(command, substeps, p, constrained, start) - truth
        found.append((np.hypot(gap[:, 0], gap[:, 1]).max(), np.abs(gap[:, 2]).max()))
    return found


def main():
    """Print the table: position error in mm / heading error in mrad."""
    lengths = [f"{1e3 * CONTROL_PERIOD / n:g} ms" for n in SUBSTEPS]
    print("| manoeuvre | lateral model | " + " | ".join(lengths) + " |")
    print("|---|---" + "|---:" * len(lengths) + "|")
    for name, (command, p, start) in MANOEUVRES.items():
        for constrained in (False, True):
            found = errors(command, p, start, constrained)
            cells = [f"{1e3 * distance:.2g} / {1e3 * turn:.2g}" for distance, turn in found]
            lateral_model = "constrained" if constrained else "sliding"
            print(f"| {name} | {lateral_model} | " + " | ".join(cells) + " |")
    print(f"\n| {RANDOM_RUNS} random runs | " + " | ".join(lengths) + " |")
    print("|---" + "|---:" * len(lengths) + "|")
    for soil, resistance in RANDOM_SOILS.items():
        cells = []
        for substeps in SUBSTEPS:
            found = 1e3 * random_errors(soil, resistance, substeps)
            middle, worst = np.median(found, axis=0), found.max(axis=0)
            cells.append(f"{middle[0]:.2g}, {middle[1]:.2g} / {worst[0]:.2g}, {worst[1]:.2g}")
        print(f"| {soil.replace('_', ' ')} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
