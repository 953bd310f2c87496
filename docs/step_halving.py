"""How the trajectory of the torque plant depends on the sub-step: the table of docs/numerics.md.

    python -m docs.step_halving        prints the Markdown table

Each manoeuvre lasts 5 s under a 50 Hz control law (torque = feedforward + gain * speed error)
and is repeated with ever shorter sub-steps. Its error is the largest distance, and the largest
heading difference, to the same manoeuvre with a sub-step of 0.05 ms, over all control instants. A
second table has random torques: median and worst over 40 runs.
The loop is the one a simulation runs around `rk4_step`, for one vehicle.

How the trajectory of the distributed plant depends on the step: the table of distributed.md.

    python -m docs.step_halving        prints the Markdown table

Each manoeuvre is repeated with ever shorter steps of both integrators. Its error is the largest
distance, and the largest heading difference, to the same manoeuvre with steps of 0.01 ms of the
Rosenbrock method, over all instants 20 ms apart. Belts are driven by speeds that change every
20 ms only, so that all steps see the same commands. A second table has the heavy vehicle driven by
random torques, on the soils of `step_halving`, against steps of 0.05 ms: median and worst.

Print the tables of docs/terrain.md: step halving of the plant on terrain, patches, and cost.

    python -m docs.step_halving

Errors are the largest distance [mm] and the largest rotation [mrad] to the same manoeuvre with
steps of 0.05 ms, light vehicle, from rest. Cost is the process time of one step in microseconds,
the least of several runs.
"""

import math
from time import process_time
from typing import NamedTuple

import numpy as np
from numba import njit

from tracked_env.engine.env_config import EnvConfig
from tracked_env.engine.simulation import Simulation
from tracked_env.physics.elementary import small_rotation
from tracked_env.physics.lumped import (
    Motion,
    coefficients,
    constrained_accelerations,
    drive_limits,
    rk4_step,
    sliding_accelerations,
    torque_decay,
    traction_limits,
)
from tracked_env.physics.parameters import (
    FIRM_FLOOR,
    FOCCHI_VEHICLE,
    VEHICLES,
    PlantParameters,
    SoilParameters,
    plant_parameters,
)
from tracked_env.physics.patches_on_level_ground import hold_speeds, make_patches
from tracked_env.plants.standalone import TerrainRig
from tracked_env.uncertainty import SOILS

PERIOD = 0.02


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


# [s] one command
LENGTHS = (5e-3, 2.5e-3, 1e-3, 0.5e-3)  # [s] of a step
REFERENCE = 1e-5  # [s]
FRICTIONS = (0.1, 0.4, 0.8)  # [-]
PATCHES = make_patches()


def commanded(forward, yaw_rate, vehicle=FOCCHI_VEHICLE):
    """Sprocket speeds (n, 2) [rad/s] of forward speeds [m/s] and yaw rates [rad/s]."""
    turn = 0.5 * vehicle.track_gauge * np.asarray(yaw_rate)
    belts = np.stack([forward - turn, forward + turn], axis=1)
    return belts / vehicle.sprocket_radius


def chicane():
    """F (53): v = 0.2 t for 2 s, then 0.2 m/s in turns of +-0.3 rad/s; 20 s."""
    t = PERIOD * np.arange(int(20.0 / PERIOD))
    return commanded(
        np.minimum(0.2 * t, 0.2), np.where(t < 2.0, 0.0, np.where(t < 12.0, 0.3, -0.3))
    )


def constant_step_halving_patches(left, right, duration=5.0):
    """The same sprocket speeds [rad/s] all the time, from rest."""
    return np.tile((left, right), (int(duration / PERIOD), 1))


def random_commands(duration=10.0):
    """A new pair of sprocket speeds within 10 rad/s every half second, from a fixed seed."""
    hold = int(0.5 / PERIOD)
    drawn = np.random.default_rng(0).uniform(-10.0, 10.0, (int(duration / PERIOD) // hold, 2))
    return np.repeat(drawn, hold, axis=0)


MANOEUVRES_STEP_HALVING_PATCHES = {
    "turn, 4 and 6 rad/s": constant_step_halving_patches(4.0, 6.0),
    "turn about one belt, 0 and 5 rad/s": constant_step_halving_patches(0.0, 5.0),
    "pivot, ±8 rad/s": constant_step_halving_patches(-8.0, 8.0),
    "chicane, 20 s": chicane(),
    "random commands, 10 s": random_commands(),
}


def run_step_halving_patches(speeds, h, euler, p, patches=PATCHES):
    """Poses (n + 1, 3) every PERIOD, from rest, with steps of h [s]."""
    state, loads = np.zeros((1, 6)), np.zeros((1, 6))
    table = np.array([p], dtype=float)
    poses = np.zeros((len(speeds) + 1, 3))
    for n, row in enumerate(speeds):
        hold_speeds(state, row[None].copy(), table, patches, round(PERIOD / h), h, euler, loads)
        poses[n + 1] = state[0, :3]
    return poses


def error(found, truth):
    """(largest distance [m], largest heading difference [rad])."""
    gap = found - truth
    return np.hypot(gap[:, 0], gap[:, 1]).max(), np.abs(gap[:, 2]).max()


RANDOM_RUNS_STEP_HALVING_PATCHES = 16  # of each soil
TORQUE_LENGTHS = (5e-3, 2.5e-3, 1e-3, 0.5e-3)  # [s]
TORQUE_REFERENCE = 5e-5  # [s]


def driven_by_torque(h, soil, resistance):
    """Poses (n, RANDOM_RUNS, 3) every PERIOD of the strawa vehicle under `random_torques`."""
    config = EnvConfig(
        uncertainty="nominal",
        sensors="ideal",
        reference="straight",
        plant="distributed",
        time_step=h,
        error_limit=1e6,
    )
    simulation = Simulation(RANDOM_RUNS_STEP_HALVING_PATCHES, config)
    simulation.rngs = [np.random.default_rng(i) for i in range(RANDOM_RUNS_STEP_HALVING_PATCHES)]
    ground = SOILS[soil]._replace(longitudinal_resistance=resistance)._asdict()
    del ground["lateral_resistance"], ground["ground_stiffness_factor"]  # it reads neither
    simulation.reset(simulation.all, [{"soil": ground}] * RANDOM_RUNS_STEP_HALVING_PATCHES)
    limit = simulation.solver.nominal.torque_limit
    demands = np.stack(
        [random_torques(i).torque / limit for i in range(RANDOM_RUNS_STEP_HALVING_PATCHES)], axis=1
    )
    poses = []
    for action in demands.astype(np.float32):
        simulation.step(action)
        poses.append(simulation.batch.floats[:, :3].copy())
    return np.array(poses)


def torque_errors(h, soil, resistance):
    """(RANDOM_RUNS, 2): largest distance [m] and heading difference [rad] of every run."""
    gap = driven_by_torque(h, soil, resistance)
    gap -= driven_by_torque(TORQUE_REFERENCE, soil, resistance)
    distance = np.hypot(gap[..., 0], gap[..., 1]).max(axis=0)
    return np.stack([distance, np.abs(gap[..., 2]).max(axis=0)], axis=1)


def main_step_halving_patches():
    """Print the tables: position error in mm / heading error in mrad."""
    lengths = " | ".join(f"{1e3 * h:g} ms" for h in LENGTHS)
    print(f"| manoeuvre | friction | integrator | {lengths} |")
    print("|---|---|---" + "|---:" * len(LENGTHS) + "|")
    for name, speeds in MANOEUVRES_STEP_HALVING_PATCHES.items():
        for mu in FRICTIONS:
            floor = FIRM_FLOOR._replace(friction_angle=math.atan(mu))
            p = plant_parameters(FOCCHI_VEHICLE, floor)
            truth = run_step_halving_patches(speeds, REFERENCE, False, p)
            for euler in (True, False):
                cells = []
                for h in LENGTHS:
                    distance, turn = error(run_step_halving_patches(speeds, h, euler, p), truth)
                    cells.append(f"{1e3 * distance:.2g} / {1e3 * turn:.2g}")
                integrator = "Euler" if euler else "Rosenbrock"
                print(f"| {name} | {mu} | {integrator} | " + " | ".join(cells) + " |")
    lengths = " | ".join(f"{1e3 * h:g} ms" for h in TORQUE_LENGTHS)
    print(f"\n| {RANDOM_RUNS_STEP_HALVING_PATCHES} random runs | {lengths} |")
    print("|---" + "|---:" * len(TORQUE_LENGTHS) + "|")
    for soil, resistance in RANDOM_SOILS.items():
        cells = []
        for h in TORQUE_LENGTHS:
            found = 1e3 * torque_errors(h, soil, resistance)
            middle, worst = np.median(found, axis=0), found.max(axis=0)
            cells.append(f"{middle[0]:.2g}, {middle[1]:.2g} / {worst[0]:.2g}, {worst[1]:.2g}")
        print(f"| {soil.replace('_', ' ')} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main_step_halving_patches()


LENGTHS_STEP_HALVING_TERRAIN = (5e-3, 2.5e-3, 2e-3, 1e-3, 0.5e-3)  # [s]
REFERENCE_STEP_HALVING_TERRAIN = 5e-5  # [s]
# [s] between the poses that are compared
FLOOR = VEHICLES["focchi"]._replace(longitudinal_resistance=0.0)
WAVES = [
    [0.06, 1.1, 0.4, 0.3], [0.05, -0.5, 1.2, 1.0], [0.04, 1.7, -0.9, 2.1], [0.03, 0.8, 2.2, 0.7],
    [0.02, 2.9, 1.1, 4.0], [0.015, -2.4, 2.6, 5.1], [0.01, 3.9, -2.7, 0.2], [0.008, 3.1, 4.2, 2.9],
]  # fmt: skip
FIELD = {"kind": "waves", "waves": WAVES}
UP, ACROSS = {"kind": "plane", "slope_x": 0.176}, {"kind": "plane", "slope_y": 0.3}
DOWN = {"kind": "plane", "slope_x": -0.364}
STEP = {"kind": "step", "height": 0.1, "start": 0.8, "length": 0.6}
RAMP = {"kind": "ramp", "slope": 0.3, "start": 0.8, "length": 1.0}
# Name: (terrain, load, mu, further options, sprocket speeds [rad/s] at whole seconds).
MANOEUVRES_STEP_HALVING_TERRAIN = {
    "up 10 deg": (UP, "nonuniform", 0.4, {}, [(0, 0), (5, 5), (5, 5), (5, 5), (5, 5)]),
    "down 20 deg, turning": (DOWN, "nonuniform", 0.5, {}, [(0, 0), (4, 6), (4, 6), (4, 6)]),
    "across 17 deg": (ACROSS, "uniform", 0.6, {}, [(0, 0), (6, 3), (6, 3), (5, 5), (5, 5)]),
    "eight waves": (FIELD, "nonuniform", 0.6, {}, [(0, 0), (5, 5), (3, 6), (6, 3), (5, 5)]),
    "eight waves, uniform": (FIELD, "uniform", 0.6, {}, [(0, 0), (5, 5), (3, 6), (6, 3), (5, 5)]),
    "reverse on waves": (FIELD, "nonuniform", 0.5, {}, [(0, 0), (-5, -5), (-3, -6), (-5, -4)]),
    "over a step": (STEP, "nonuniform", 0.6, {}, [(0, 0), (5, 5), (5, 5), (4, 5), (5, 5)]),
    "over a step, uniform": (STEP, "uniform", 0.6, {}, [(0, 0), (5, 5), (5, 5), (4, 5), (5, 5)]),
    "ramp, stiffening": (
        RAMP, "nonuniform", 0.6, {"stiffening": 5.5}, [(0, 0), (5, 5), (5, 6), (5, 5), (5, 6)],
    ),
    "pivots, belts through zero": (
        ACROSS, "nonuniform", 0.4, {}, [(0, 0), (4, -4), (-4, 4), (0, 0), (0, 3)],
    ),
}  # fmt: skip
TERRAINS = {
    "plane": UP, "ramp": RAMP, "eight waves": FIELD,
    "map, bilinear": {"kind": "map", "heights": np.zeros((401, 401)), "cell": 0.1},
    "map, bicubic": {
        "kind": "map", "heights": np.zeros((401, 401)), "cell": 0.1, "interpolation": "bicubic",
    },
}  # fmt: skip


def run_step_halving_terrain(terrain, load, mu, options, speeds, step, patches=(10, 4)):
    """Positions (n, 3) and quaternions (n, 4) every PERIOD."""
    parameters = FLOOR._replace(friction_angle=math.atan(mu))
    given = {"terrain": terrain, "load": load, "patches": patches, **options}
    rig = TerrainRig(parameters, given, step=step)
    times = PERIOD * np.arange(round((len(speeds) - 1) / PERIOD) + 1)
    sides = np.array(speeds, dtype=float).T
    commands = np.stack([np.interp(times, np.arange(len(speeds)), side) for side in sides], axis=1)
    poses = []
    for k in range(len(times) - 1):
        rig.advance(commands[k : k + 1], PERIOD, to=commands[k + 1 : k + 2])
        poses.append(np.concatenate([rig.positions[0], rig.quaternions[0]]))
    return np.array(poses)


def error_step_halving_terrain(found, truth):
    """(largest distance [mm], largest rotation [mrad])."""
    distance = np.linalg.norm(found[:, :3] - truth[:, :3], axis=1).max()
    cosine = np.minimum(np.abs((found[:, 3:] * truth[:, 3:]).sum(axis=1)), 1.0)
    return 1e3 * distance, 2e3 * np.sqrt(1.0 - cosine**2).max()


def cost(terrain, load, count):
    """[us] process time of one step of 1 ms and vehicle, 2 x 40 patches."""
    rig = TerrainRig(FLOOR, {"terrain": terrain, "load": load}, count, step=1e-3)
    command = np.full((count, 2), 5.0)
    rig.advance(command, 1.0)
    steps = max(2000 // count, 100)
    least = math.inf
    for _ in range(15):
        start = process_time()
        rig.advance(command, 1e-3 * steps)
        least = min(least, process_time() - start)
    return 1e6 * least / (steps * count)


def main_step_halving_terrain():
    """Print the tables."""
    print(
        "| manoeuvre | load | "
        + " | ".join(f"{1e3 * h:g} ms" for h in LENGTHS_STEP_HALVING_TERRAIN)
        + " |"
    )
    print("|---|---" + "|---:" * len(LENGTHS_STEP_HALVING_TERRAIN) + "|")
    for name, given in MANOEUVRES_STEP_HALVING_TERRAIN.items():
        truth = run_step_halving_terrain(*given, REFERENCE_STEP_HALVING_TERRAIN)
        cells = [
            "{:.2g} / {:.2g}".format(
                *error_step_halving_terrain(run_step_halving_terrain(*given, h), truth)
            )
            for h in LENGTHS_STEP_HALVING_TERRAIN
        ]
        print(f"| {name} | {given[1]} | " + " | ".join(cells) + " |")
    print("\n| patches | error |\n|---|---:|")
    given = MANOEUVRES_STEP_HALVING_TERRAIN["eight waves"]
    truth = run_step_halving_terrain(*given, 1e-3, (80, 8))
    for patches in ((5, 2), (10, 4), (20, 4), (40, 4), (40, 8)):
        distance, rotation = error_step_halving_terrain(
            run_step_halving_terrain(*given, 1e-3, patches), truth
        )
        print(f"| {patches[0]} x {patches[1]} | {distance:.2g} / {rotation:.2g} |")
    print("\n| terrain | load | one vehicle | each of 64 |\n|---|---|---:|---:|")
    for name, terrain in TERRAINS.items():
        for load in ("nonuniform", "uniform"):
            one, many = cost(terrain, load, 1), cost(terrain, load, 64)
            print(f"| {name} | {load} | {one:.2f} | {many:.2f} |")


if __name__ == "__main__":
    main_step_halving_terrain()
