"""How the trajectory of each plant depends on the step: tables of three pages.

    python -m tests.physics.step_halving [lumped | patches | terrain]    prints the Markdown tables

The pages are numerics.md, distributed.md and terrain.md. Each manoeuvre is repeated with ever
shorter steps. Its error is the largest distance, and the largest rotation, to the same manoeuvre
with a far shorter step, over all control instants.
    lumped   5 s under a 50 Hz law (torque = feedforward + gain * speed error); then random torques
             on three soils
    patches  belts driven by speeds that change every 20 ms, with both integrators; then random
             torques of the heavy vehicle on the same soils
    terrain  the light vehicle from rest; the number of patches
"""

import math
import sys
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from tracked_env.engine.env_config import EnvConfig
from tracked_env.engine.simulation import Simulation
from tracked_env.physics import parameters as names
from tracked_env.physics.level_motion import hold_speeds
from tracked_env.physics.lumped import Motion
from tracked_env.physics.parameters import plant_parameters
from tracked_env.physics.patches_on_level_ground import make_patches
from tracked_env.plants.standalone import Rig, TerrainRig
from tracked_env.uncertainty import SOILS

CONTROL_PERIOD = 0.02  # [s] one command
STEPS = 250  # control periods of one manoeuvre: 5 s
SUBSTEPS = (2, 4, 8, 16, 32)  # per control period: 10, 5, 2.5, 1.25, 0.625 ms
REFERENCE_SUBSTEPS = 400  # 0.05 ms
LENGTHS = (5e-3, 2.5e-3, 1e-3, 0.5e-3)  # [s] of a step on patches
PATCH_REFERENCE, TORQUE_REFERENCE = 1e-5, 5e-5  # [s] driven by speeds, by torques
TERRAIN_LENGTHS = (5e-3, 2.5e-3, 2e-3, 1e-3, 0.5e-3)  # [s]
TERRAIN_REFERENCE = 5e-5  # [s]
REST = Motion(0.0, 0.0, 0.0)
SANDY_LOAM = names.HEAVY_CLAY._replace(cohesion=9.65e3, friction_angle=math.radians(35.0))
RANDOM_SOILS = {"heavy_clay": 0.6, "sandy_loam": 0.3, "lete_sand": 0.13}  # and their mu_l [-]
RANDOM_RUNS, RANDOM_PATCH_RUNS = 40, 16  # of each soil
PATCHES = make_patches()


class Command(NamedTuple):
    """What the control law of the lumped plant wants, per control period."""

    torque: np.ndarray  # (n, 2) [N m] feedforward, left and right
    speed: np.ndarray  # (n, 2) [m/s, rad/s] forward speed and yaw rate
    speed_gain: float = 0.0  # [N m s/m] on both sprockets
    yaw_rate_gain: float = 0.0  # [N m s/rad] minus on the left, plus on the right


def run(command, substeps, p=None, constrained=False, start=REST, period=CONTROL_PERIOD):
    """Trajectory (n + 1, 8): x, y [m], yaw [rad], v_x, v_y, yaw rate, torque left, right.

    period [s] of one control step, cut into `substeps`. The vehicle starts at the origin, heading
    along x, with the velocities `start`; the motors start at the first demand. p: heavy clay.
    """
    p, lateral = p or plant_parameters(), "constrained" if constrained else "sliding"
    rig = Rig("lumped", p, step=period / substeps, options={"lateral": lateral})
    state, steps, trajectory = rig.states[0], len(command.torque), []
    state[names.V_X : names.TORQUE_LEFT] = start
    for n in range(steps + 1):
        last = min(n, steps - 1)
        (speed, yaw_rate), torque = command.speed[last], command.torque[last]
        push = command.speed_gain * (speed - state[names.V_X])
        turn = command.yaw_rate_gain * (yaw_rate - state[names.YAW_RATE])
        demand = np.add(torque, (push - turn, push + turn)).clip(-p.torque_limit, p.torque_limit)
        if n == 0:
            state[names.TORQUE_LEFT : names.TORQUE_RIGHT + 1] = demand
        trajectory.append(state[: names.TORQUE_RIGHT + 1].copy())
        if n < steps:
            rig.advance([demand], period)
    return np.array(trajectory)


def constant(left, right, forward=0.0, yaw_rate=0.0, gains=(0.0, 0.0), steps=STEPS):
    """A Command that never changes."""
    torque = np.tile((float(left), float(right)), (steps, 1))
    speed = np.tile((float(forward), float(yaw_rate)), (steps, 1))
    return Command(torque, speed, *map(float, gains))


def circle_entry():
    """From rest to 2 m/s on a straight line, then into a circle of 10 m radius at t = 2 s."""
    command, begin = constant(1280.0, 1280.0, 2.0, 0.0, (2000.0, 4000.0)), int(2.0 / CONTROL_PERIOD)
    command.torque[begin:] += (-1000.0, 1000.0)
    command.speed[begin:, 1] = 0.2
    return command


def reversal():
    """Full torque backwards for 1.5 s, which ends at top speed in reverse, then full torque in
    opposite senses: both tracks leave one traction limit and run into the other."""
    command = constant(-8000.0, -8000.0)
    command.torque[int(1.5 / CONTROL_PERIOD) :] = (-8000.0, 8000.0)
    return command


_CLAY, _LOAM = plant_parameters(), plant_parameters(soil=SANDY_LOAM)
_BRAKING = constant(0, 0, gains=(8000.0, 0.0))
MANOEUVRES = {  # Command, PlantParameters, start
    "circle entry, R = 10 m at 2 m/s": (circle_entry(), _CLAY, REST),
    "pivot turn from rest, ±2500 N m": (constant(-2500, 2500), _CLAY, REST),
    "hard braking from 4 m/s": (_BRAKING, _CLAY, Motion(4.0, 0.0, 0.0)),
    "full torque on the right track, sandy loam": (constant(0, 8000), _LOAM, REST),
    "full torque to top speed, heavy clay": (constant(8000, 8000), _CLAY, REST),
    "2.5 m/s, into reverse at top speed, pivot": (reversal(), _CLAY, Motion(2.5, 0.0, 0.0)),
}


def random_torques(seed, steps=STEPS):
    """Torques that jump every 0.1 to 1 s; a third of them at the limit. From 2 m/s on."""
    rng = np.random.default_rng(seed)
    hold = int(rng.integers(5, 50))
    shares = np.clip(rng.uniform(-1.5, 1.5, (steps // hold + 1, 2)), -1.0, 1.0)
    torque = np.repeat(8000.0 * shares, hold, axis=0)[:steps]
    return Command(torque, np.zeros((steps, 2)))


def error(poses, truth):
    """(largest distance [m], largest heading difference [rad]) of poses (n, 3 or more)."""
    gap = poses - truth
    return np.hypot(gap[:, 0], gap[:, 1]).max(), np.abs(gap[:, 2]).max()


def errors(command, p, start, constrained=False, counts=SUBSTEPS):
    """[(position error [m], heading error [rad]) for each of `counts` sub-steps]."""
    truth = run(command, REFERENCE_SUBSTEPS, p, constrained, start)
    return [error(run(command, count, p, constrained, start), truth) for count in counts]


def random_errors(soil, resistance, substeps, runs=RANDOM_RUNS):
    """(runs, 2): position error [m] and heading error [rad] of every random run."""
    p = plant_parameters(soil=SOILS[soil]._replace(longitudinal_resistance=resistance))
    start, counts = Motion(2.0, 0.0, 0.0), (substeps,)
    return np.array([errors(random_torques(k), p, start, counts=counts)[0] for k in range(runs)])


def commanded(forward, yaw_rate, vehicle=names.FOCCHI_VEHICLE):
    """Sprocket speeds (n, 2) [rad/s] of forward speeds [m/s] and yaw rates [rad/s]."""
    turn = 0.5 * vehicle.track_gauge * np.asarray(yaw_rate)
    return np.stack([forward - turn, forward + turn], axis=1) / vehicle.sprocket_radius


def _chicane():
    """F (53): v = 0.2 t for 2 s, then 0.2 m/s in turns of +-0.3 rad/s; 20 s."""
    t = CONTROL_PERIOD * np.arange(int(20.0 / CONTROL_PERIOD))
    turns = np.where(t < 2.0, 0.0, np.where(t < 12.0, 0.3, -0.3))
    return commanded(np.minimum(0.2 * t, 0.2), turns)


_PAIRS = np.random.default_rng(0).uniform(-10.0, 10.0, (20, 2))  # a new one every half second
PATCH_MANOEUVRES = {  # sprocket speeds (n, 2) [rad/s], from rest
    "turn, 4 and 6 rad/s": np.tile((4.0, 6.0), (STEPS, 1)),
    "turn about one belt, 0 and 5 rad/s": np.tile((0.0, 5.0), (STEPS, 1)),
    "pivot, ±8 rad/s": np.tile((-8.0, 8.0), (STEPS, 1)),
    "chicane, 20 s": _chicane(),
    "random commands, 10 s": np.repeat(_PAIRS, 25, axis=0),
}


def run_patches(speeds, h, euler, p, patches=PATCHES):
    """Poses (n + 1, 3) every CONTROL_PERIOD, from rest, with steps of h [s]."""
    state, loads, table = np.zeros((1, 6)), np.zeros((1, 6)), np.array([p], dtype=float)
    poses, steps = np.zeros((len(speeds) + 1, 3)), round(CONTROL_PERIOD / h)
    for n, row in enumerate(speeds):
        hold_speeds(state, row[None].copy(), table, patches, steps, h, euler, loads)
        poses[n + 1] = state[0, :3]
    return poses


def run_torques(soil, resistance, h):
    """Poses (n, RANDOM_PATCH_RUNS, 3) of the strawa vehicle under `random_torques`."""
    options = {"uncertainty": "nominal", "sensors": "ideal", "reference": "straight"}
    config = EnvConfig(**options, plant="distributed", time_step=h, error_limit=1e6)
    simulation = Simulation(RANDOM_PATCH_RUNS, config)
    simulation.rngs = [np.random.default_rng(i) for i in range(RANDOM_PATCH_RUNS)]
    ground = SOILS[soil]._replace(longitudinal_resistance=resistance)._asdict()
    del ground["lateral_resistance"], ground["ground_stiffness_factor"]  # it reads neither
    simulation.reset(simulation.all, [{"soil": ground}] * RANDOM_PATCH_RUNS)
    limit, runs = simulation.solver.nominal.torque_limit, range(RANDOM_PATCH_RUNS)
    poses = []
    for action in np.stack([random_torques(i).torque / limit for i in runs], axis=1):
        simulation.step(action.astype(np.float32))
        poses.append(simulation.batch.floats[:, :3].copy())
    return np.array(poses)


def torque_errors(soil, resistance, h):
    """(RANDOM_PATCH_RUNS, 2): largest distance [m] and heading difference [rad] of every run."""
    poses, truth = (run_torques(soil, resistance, x) for x in (h, TORQUE_REFERENCE))
    return np.array([error(poses[:, k], truth[:, k]) for k in range(RANDOM_PATCH_RUNS)])


FLOOR = names.VEHICLES["focchi"]._replace(longitudinal_resistance=0.0)
WAVES = [
    [0.06, 1.1, 0.4, 0.3], [0.05, -0.5, 1.2, 1.0], [0.04, 1.7, -0.9, 2.1], [0.03, 0.8, 2.2, 0.7],
    [0.02, 2.9, 1.1, 4.0], [0.015, -2.4, 2.6, 5.1], [0.01, 3.9, -2.7, 0.2], [0.008, 3.1, 4.2, 2.9],
]  # fmt: skip
FIELD = {"kind": "waves", "waves": WAVES}
UP, ACROSS = {"kind": "plane", "slope_x": 0.176}, {"kind": "plane", "slope_y": 0.3}
DOWN = {"kind": "plane", "slope_x": -0.364}
STEP = {"kind": "step", "height": 0.1, "start": 0.8, "length": 0.6}
RAMP = {"kind": "ramp", "slope": 0.3, "start": 0.8, "length": 1.0}
EVEN, UNEVEN, STIFF = {"load": "uniform"}, {"load": "nonuniform"}, {"stiffening": 5.5}
# Name: (terrain, mu, options of the plant, sprocket speeds [rad/s] at whole seconds).
TERRAIN_MANOEUVRES = {
    "up 10 deg": (UP, 0.4, UNEVEN, [(0, 0), (5, 5), (5, 5), (5, 5), (5, 5)]),
    "down 20 deg, turning": (DOWN, 0.5, UNEVEN, [(0, 0), (4, 6), (4, 6), (4, 6)]),
    "across 17 deg": (ACROSS, 0.6, EVEN, [(0, 0), (6, 3), (6, 3), (5, 5), (5, 5)]),
    "eight waves": (FIELD, 0.6, UNEVEN, [(0, 0), (5, 5), (3, 6), (6, 3), (5, 5)]),
    "eight waves, uniform": (FIELD, 0.6, EVEN, [(0, 0), (5, 5), (3, 6), (6, 3), (5, 5)]),
    "reverse on waves": (FIELD, 0.5, UNEVEN, [(0, 0), (-5, -5), (-3, -6), (-5, -4)]),
    "over a step": (STEP, 0.6, UNEVEN, [(0, 0), (5, 5), (5, 5), (4, 5), (5, 5)]),
    "over a step, uniform": (STEP, 0.6, EVEN, [(0, 0), (5, 5), (5, 5), (4, 5), (5, 5)]),
    "ramp, stiffening": (RAMP, 0.6, UNEVEN | STIFF, [(0, 0), (5, 5), (5, 6), (5, 5), (5, 6)]),
    "pivots, belts through zero": (ACROSS, 0.4, UNEVEN, [(0, 0), (4, -4), (-4, 4), (0, 0), (0, 3)]),
}


def run_terrain(terrain, mu, options, speeds, step, patches=(10, 4)):
    """Positions (n, 3) and quaternions (n, 4) every CONTROL_PERIOD, side by side."""
    parameters = FLOOR._replace(friction_angle=math.atan(mu))
    rig = TerrainRig(parameters, {"terrain": terrain, "patches": patches, **options}, step=step)
    times = CONTROL_PERIOD * np.arange(round((len(speeds) - 1) / CONTROL_PERIOD) + 1)
    sides = np.array(speeds, dtype=float).T
    commands = np.stack([np.interp(times, np.arange(len(speeds)), side) for side in sides], axis=1)
    poses = []
    for k in range(len(times) - 1):
        rig.advance(commands[k : k + 1], CONTROL_PERIOD, to=commands[k + 1 : k + 2])
        poses.append(np.concatenate([rig.positions[0], rig.quaternions[0]]))
    return np.array(poses)


def error_in_space(poses, truth):
    """(largest distance [m], largest rotation [rad])."""
    distance = np.linalg.norm(poses[:, :3] - truth[:, :3], axis=1).max()
    cosine = np.minimum(np.abs((poses[:, 3:] * truth[:, 3:]).sum(axis=1)), 1.0)
    return distance, 2.0 * np.sqrt(1.0 - cosine**2).max()


def cell(distance_and_rotation):
    """Errors [m, rad] in mm / mrad."""
    return "{:.2g} / {:.2g}".format(*(1e3 * error for error in distance_and_rotation))


def random_cell(run_errors):
    """Errors (runs, 2) of random runs: median / worst."""
    middle, worst = 1e3 * np.median(run_errors, axis=0), 1e3 * run_errors.max(axis=0)
    return f"{middle[0]:.2g}, {middle[1]:.2g} / {worst[0]:.2g}, {worst[1]:.2g}"


Rows = Iterator[list[str]]  # labels, then a cell per length


def lumped_rows() -> Rows:
    """Of numerics.md: manoeuvres."""
    for name, (command, p, start) in MANOEUVRES.items():
        for constrained, lateral in ((False, "sliding"), (True, "constrained")):
            yield [name, lateral, *map(cell, errors(command, p, start, constrained))]


def patch_rows() -> Rows:
    """Of distributed.md: manoeuvres of the light vehicle."""
    for name, speeds in PATCH_MANOEUVRES.items():
        for mu in (0.1, 0.4, 0.8):
            floor = names.FIRM_FLOOR._replace(friction_angle=math.atan(mu))
            p = plant_parameters(names.FOCCHI_VEHICLE, floor)
            truth = run_patches(speeds, PATCH_REFERENCE, False, p)
            for euler, integrator in ((True, "Euler"), (False, "Rosenbrock")):
                gaps = [error(run_patches(speeds, h, euler, p), truth) for h in LENGTHS]
                yield [name, f"{mu}", integrator, *map(cell, gaps)]


def terrain_rows() -> Rows:
    """Of terrain.md: manoeuvres."""
    for name, case in TERRAIN_MANOEUVRES.items():
        truth = run_terrain(*case, TERRAIN_REFERENCE)
        gaps = [error_in_space(run_terrain(*case, h), truth) for h in TERRAIN_LENGTHS]
        yield [name, case[2]["load"], *map(cell, gaps)]


def random_rows(errors_of, steps) -> Rows:
    """Of random torques; errors_of: `random_errors` or `torque_errors`."""
    for soil, mu in RANDOM_SOILS.items():
        cells = [random_cell(errors_of(soil, mu, step)) for step in steps]
        yield [soil.replace("_", " "), *cells]


def patch_count_rows() -> Rows:
    """Of terrain.md: eight waves on fewer patches."""
    case = TERRAIN_MANOEUVRES["eight waves"]
    truth = run_terrain(*case, 1e-3, (80, 8))
    for patches in ((5, 2), (10, 4), (20, 4), (40, 4), (40, 8)):
        gap = error_in_space(run_terrain(*case, 1e-3, patches), truth)
        yield ["{} x {}".format(*patches), cell(gap)]


PERIODS = [CONTROL_PERIOD / n for n in SUBSTEPS]  # [s]
RANDOM, RANDOM_PATCHES = f"{RANDOM_RUNS} random runs", f"{RANDOM_PATCH_RUNS} random runs"
# Labels of the rows, steps [s] of the cells, and what makes the rows.
TABLES = {
    "lumped": [
        (["manoeuvre", "lateral model"], PERIODS, lumped_rows),
        ([RANDOM], PERIODS, partial(random_rows, random_errors, SUBSTEPS)),
    ],
    "patches": [
        (["manoeuvre", "friction", "integrator"], LENGTHS, patch_rows),
        ([RANDOM_PATCHES], LENGTHS, partial(random_rows, torque_errors, LENGTHS)),
    ],
    "terrain": [
        (["manoeuvre", "load"], TERRAIN_LENGTHS, terrain_rows),
        (["patches", "error"], (), patch_count_rows),
    ],
}


if __name__ == "__main__":  # distance in mm / rotation in mrad
    for labels, steps, rows in (table for name in sys.argv[1:] or TABLES for table in TABLES[name]):
        print(f"| {' | '.join([*labels, *(f'{1e3 * h:g} ms' for h in steps)])} |")
        print("|---" * len(labels) + "|---:" * len(steps) + "|")
        for row in rows():
            print(f"| {' | '.join(row)} |", flush=True)
        print()
