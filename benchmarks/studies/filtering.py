"""How well the position is known: by the filter, by the learned observer, and by a smoother.

    python -m benchmarks.studies.filtering

`mpc-learned-observer` drives the sets of Torque-v0. From the same samples come four positions: that
of the identification stack, that of the learned observer behind it, that of the filter without a
model of the vehicle (`baselines.learned.kinematic_filter`), and that of the same equations once
the whole episode is known (Rauch-Tung-Striebel smoother [1], each late pose at its own time). The
table has their RMSE from 5 s on, median over the episodes of a set [mm]. What a smoother finds no
filter can: it is the reference for what is left.

References: [1] Rauch, Tung, Striebel, AIAA J. 3 (1965) 1445.
"""

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.batch_policy import body_errors
from baselines.estimators.measurement import COLUMN, DRIVE, POSE, DataSheet
from baselines.learned import kinematic_filter as kinematic
from baselines.learned.kinematic_filter import MOVED, SIZE, Noise
from baselines.learned.trained_agent import open_agent
from baselines.registry import LEARNED, shipped_agents
from benchmarks.studies import Cells, show, study_parser, write_csv
from tracked_env import TORQUE_ID
from tracked_env.benchmark import BenchmarkConfig, default_sets
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT
from tracked_env.benchmark.runner import steps_of
from tracked_env.cli.command_line import reported

SETTLED = 250  # control steps
Floats = NDArray[np.float64]
_POSE = [COLUMN[name] for name in ("x", "y", "yaw", "v_x", "v_y")]
_FELT = [COLUMN[name] for name in ("acceleration_x", "acceleration_y", "yaw_rate")]
OF = slice(kinematic.TURNING)  # of the state; the rest is known, 0, where torques turn the belts
_BELTS = [COLUMN[f"sprocket_speed_{side}"] for side in ("left", "right")]


class Notes:
    """Samples and positions of a batch, step by step, in the frame of the samples."""

    def __init__(self, column: Any) -> None:
        self.column = column
        self.samples: list[Any] = []  # values, fresh and age of a step
        self.places: list[Floats] = []  # (3, N, 2) true, of the stack, of the learned observer

    def take(self, policy: Any, floats: Any) -> None:
        """See `steps_of`."""
        reading, of, c = policy.identification.reading, policy.corrector, self.column
        reference = [c(f"reference_{name}") for name in ("x", "y", "yaw")]
        true = np.stack(body_errors(reference, c("x"), c("y"), c("yaw")), axis=1)
        places = []
        for ahead, left, turn in (true.T, of.before[:, :3].T, of.shown[:, :3].T):
            yaw = reading.reference[:, 2] - turn
            cosine, sine = np.cos(yaw), np.sin(yaw)
            moved = np.stack([cosine * ahead - sine * left, sine * ahead + cosine * left], axis=1)
            places.append(reading.reference[:, :2] - moved)
        self.places.append(np.array(places))
        self.samples.append(tuple(each.copy() for each in reading.latest))


def derivative(z: Floats, w: float, h: float) -> Floats:
    """dz'/dz of `kinematic.move`."""
    f, (c, s) = np.eye(SIZE), (np.cos(z[2] + 0.5 * h * w), np.sin(z[2] + 0.5 * h * w))
    f[0, 2:5] = -h * (z[3] * s + z[4] * c), h * c, -h * s
    f[1, 2:5] = h * (z[3] * c - z[4] * s), h * s, h * c
    f[2, 7] = -h
    f[3, [4, 5, 7]] = h * w, -h, -h * z[4]
    f[4, [3, 6, 7]] = -h * w, -h, h * z[3]
    return f


def smoothed(values: Floats, fresh: Any, age: Floats, k: Noise) -> tuple[Floats, Floats]:
    """Positions (T, 2) of one vehicle by the filter and by the smoother, from samples (T, ..)."""
    count, h, room = len(values), k.period, np.empty((MOVED, SIZE))
    taken = np.arange(count) - np.rint(age[:, POSE] / h).astype(int)
    poses = {int(taken[t]): values[t, _POSE] for t in np.flatnonzero(fresh[:, POSE])}
    z, p = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    p[OF, OF] = np.diag([1.0] * 5 + [k.bias[0] ** 2] * 2 + [k.bias[1] ** 2, 1.0, 0.09])
    z[:3], z[8] = values[0, _POSE[:3]], np.log(kinematic.USUAL_RADIUS)
    states, spreads, ahead = np.empty((count, SIZE)), np.empty((count, SIZE, SIZE)), []
    felt = values[:, _FELT]
    for t in range(count):
        if t > 0:
            mean = 0.5 * (felt[t] + felt[t - 1])
            f = derivative(z, mean[2] - z[7], h)
            kinematic.move(z, p, *mean, 0.0, k, room)
            ahead.append((f, z.copy(), p.copy()))
        seen = poses.get(t, np.full(MOVED, np.nan))
        for a in np.flatnonzero(np.isfinite(seen) & (k.pose < kinematic.UNSEEN)):
            missed = seen[a] - z[a]
            missed = np.arctan2(np.sin(missed), np.cos(missed)) if a == 2 else missed
            kinematic.correct(z, p, a, 1.0, a, 0.0, missed, k.pose[a] ** 2, room)
        if fresh[t, DRIVE]:
            kinematic.use_belts(z, p, *values[t, _BELTS], 0.0, 0.0, k.rules, 0.0, room)
        kinematic.use_side(z, p, felt[t, 2] - z[7], room)
        states[t], spreads[t] = z, p
    filtered = states[:, :2].copy()
    for t in range(count - 2, -1, -1):
        f, before, spread = ahead[t]
        gain = np.linalg.solve(spread[OF, OF], f[OF, OF] @ spreads[t][OF, OF]).T
        off = (states[t + 1] - before)[OF]
        off[2] = np.arctan2(np.sin(off[2]), np.cos(off[2]))
        states[t, OF] += gain @ off
    return filtered, states[:, :2]


def errors_of(name: str, episodes: int) -> list[float]:
    """Median RMSE [m] of the four positions in a set."""
    config = BenchmarkConfig((name,), episodes, seed=DEVELOPMENT)
    env = config.environment(name, episodes, truth=False)
    context = config.context(name)
    policy: Any = open_agent(shipped_agents(TORQUE_ID)[LEARNED][0]).make(context)
    first = config.first_seed(name)
    notes: Any = Notes(env.simulation.batch.column)
    for _ in steps_of(policy, env, range(first, first + episodes), notes):
        pass
    env.close()
    places = np.array(notes.places)  # (T, 3, N, 2)
    samples = [np.array(each) for each in zip(*notes.samples, strict=True)]
    noise = Noise.of(DataSheet.of(context.sensors), context.control_period)
    rows = []
    for i in range(episodes):
        length = int(env.simulation.steps[i])
        if length <= SETTLED:
            continue
        values, fresh, age = (each[:length, i] for each in samples)
        both = smoothed(values, fresh, age, noise)
        found = [places[:length, 1, i], places[:length, 2, i], *both]
        missed = [np.hypot(*(of - places[:length, 0, i])[SETTLED:].T) for of in found]
        rows.append([float(np.sqrt(np.mean(each**2))) for each in missed])
    median: list[float] = np.median(rows, axis=0).tolist()
    return median


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Drive, print and write the table."""
    parser = study_parser(program, (__doc__ or "").split("\n")[0], 8)
    options = parser.parse_args(arguments)
    cells: Cells = [["set", "stack", "learned observer", "without a model", "smoother"]]
    for name in default_sets():
        cells.append([name, *(f"{1e3 * each:.1f}" for each in errors_of(name, options.episodes))])
        print(" | ".join(cells[-1]), flush=True)
    write_csv(options.output / "filtering.csv", cells)
    show(cells, 1)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "filtering"))
