"""Print the tables of docs/terrain.md: step halving of the plant on terrain, patches, and cost.

    python -m docs.step_halving_terrain

Errors are the largest distance [mm] and the largest rotation [mrad] to the same manoeuvre with
steps of 0.05 ms, light vehicle, from rest. Cost is the process time of one step in microseconds,
the least of several runs.
"""

import math
from time import process_time

import numpy as np

from tracked_env.physics.parameters import VEHICLES
from tracked_env.plants.terrain_rig import TerrainRig

LENGTHS = (5e-3, 2.5e-3, 2e-3, 1e-3, 0.5e-3)  # [s]
REFERENCE = 5e-5  # [s]
PERIOD = 0.02  # [s] between the poses that are compared
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
MANOEUVRES = {
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


def run(terrain, load, mu, options, speeds, step, patches=(10, 4)):
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


def error(found, truth):
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


def main():
    """Print the tables."""
    print("| manoeuvre | load | " + " | ".join(f"{1e3 * h:g} ms" for h in LENGTHS) + " |")
    print("|---|---" + "|---:" * len(LENGTHS) + "|")
    for name, given in MANOEUVRES.items():
        truth = run(*given, REFERENCE)
        cells = ["{:.2g} / {:.2g}".format(*error(run(*given, h), truth)) for h in LENGTHS]
        print(f"| {name} | {given[1]} | " + " | ".join(cells) + " |")
    print("\n| patches | error |\n|---|---:|")
    given = MANOEUVRES["eight waves"]
    truth = run(*given, 1e-3, (80, 8))
    for patches in ((5, 2), (10, 4), (20, 4), (40, 4), (40, 8)):
        distance, rotation = error(run(*given, 1e-3, patches), truth)
        print(f"| {patches[0]} x {patches[1]} | {distance:.2g} / {rotation:.2g} |")
    print("\n| terrain | load | one vehicle | each of 64 |\n|---|---|---:|---:|")
    for name, terrain in TERRAINS.items():
        for load in ("nonuniform", "uniform"):
            one, many = cost(terrain, load, 1), cost(terrain, load, 64)
            print(f"| {name} | {load} | {one:.2f} | {many:.2f} |")


if __name__ == "__main__":
    main()
