"""How the trajectory of the distributed plant depends on the step: the table of distributed.md.

    python -m docs.step_halving_patches        prints the Markdown table

Each manoeuvre is repeated with ever shorter steps of both integrators. Its error is the largest
distance, and the largest heading difference, to the same manoeuvre with steps of 0.01 ms of the
Rosenbrock method, over all instants 20 ms apart. Belts are driven by speeds that change every
20 ms only, so that all steps see the same commands. A second table has the heavy vehicle driven by
random torques, on the soils of `step_halving`, against steps of 0.05 ms: median and worst.
"""

import math

import numpy as np

from docs.step_halving import RANDOM_SOILS, random_torques
from tracked_env.engine.env_config import EnvConfig
from tracked_env.engine.simulation import Simulation
from tracked_env.physics.parameters import FIRM_FLOOR, FOCCHI_VEHICLE, plant_parameters
from tracked_env.physics.patch_dynamics import hold_speeds
from tracked_env.physics.patch_forces import make_patches
from tracked_env.uncertainty import SOILS

PERIOD = 0.02  # [s] one command
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


def constant(left, right, duration=5.0):
    """The same sprocket speeds [rad/s] all the time, from rest."""
    return np.tile((left, right), (int(duration / PERIOD), 1))


def random_commands(duration=10.0):
    """A new pair of sprocket speeds within 10 rad/s every half second, from a fixed seed."""
    hold = int(0.5 / PERIOD)
    drawn = np.random.default_rng(0).uniform(-10.0, 10.0, (int(duration / PERIOD) // hold, 2))
    return np.repeat(drawn, hold, axis=0)


MANOEUVRES = {
    "turn, 4 and 6 rad/s": constant(4.0, 6.0),
    "turn about one belt, 0 and 5 rad/s": constant(0.0, 5.0),
    "pivot, ±8 rad/s": constant(-8.0, 8.0),
    "chicane, 20 s": chicane(),
    "random commands, 10 s": random_commands(),
}


def run(speeds, h, euler, p, patches=PATCHES):
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


RANDOM_RUNS = 16  # of each soil
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
    simulation = Simulation(RANDOM_RUNS, config)
    simulation.rngs = [np.random.default_rng(i) for i in range(RANDOM_RUNS)]
    ground = SOILS[soil]._replace(longitudinal_resistance=resistance)._asdict()
    del ground["lateral_resistance"], ground["ground_stiffness_factor"]  # it reads neither
    simulation.reset(simulation.all, [{"soil": ground}] * RANDOM_RUNS)
    limit = simulation.solver.nominal.torque_limit
    demands = np.stack([random_torques(i).torque / limit for i in range(RANDOM_RUNS)], axis=1)
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


def main():
    """Print the tables: position error in mm / heading error in mrad."""
    lengths = " | ".join(f"{1e3 * h:g} ms" for h in LENGTHS)
    print(f"| manoeuvre | friction | integrator | {lengths} |")
    print("|---|---|---" + "|---:" * len(LENGTHS) + "|")
    for name, speeds in MANOEUVRES.items():
        for mu in FRICTIONS:
            floor = FIRM_FLOOR._replace(friction_angle=math.atan(mu))
            p = plant_parameters(FOCCHI_VEHICLE, floor)
            truth = run(speeds, REFERENCE, False, p)
            for euler in (True, False):
                cells = []
                for h in LENGTHS:
                    distance, turn = error(run(speeds, h, euler, p), truth)
                    cells.append(f"{1e3 * distance:.2g} / {1e3 * turn:.2g}")
                integrator = "Euler" if euler else "Rosenbrock"
                print(f"| {name} | {mu} | {integrator} | " + " | ".join(cells) + " |")
    lengths = " | ".join(f"{1e3 * h:g} ms" for h in TORQUE_LENGTHS)
    print(f"\n| {RANDOM_RUNS} random runs | {lengths} |")
    print("|---" + "|---:" * len(TORQUE_LENGTHS) + "|")
    for soil, resistance in RANDOM_SOILS.items():
        cells = []
        for h in TORQUE_LENGTHS:
            found = 1e3 * torque_errors(h, soil, resistance)
            middle, worst = np.median(found, axis=0), found.max(axis=0)
            cells.append(f"{middle[0]:.2g}, {middle[1]:.2g} / {worst[0]:.2g}, {worst[1]:.2g}")
        print(f"| {soil.replace('_', ' ')} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
