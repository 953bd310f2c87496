"""Writes what the sensors of an environment say as a CSV log, as a vehicle of a user would.

Columns are those that `tracked-env identify` reads, one row a control step. A sensor without a new
sample leaves its cells empty; a delay is taken off, so that every row is of one moment.
"""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from tracked_env.engine import columns
from tracked_env.physics.channels import CHANNEL_COUNT, CHANNELS, GROUP_START, GROUPS

IDENTIFIED = ("mass", "inertia", "longitudinal_resistance", "lateral_resistance",
              "effort_maximum", "shear_deformation_modulus")  # fmt: skip


def record_log(
    env: Any, policy: Any, path: Path | str, seed: int | None = None
) -> dict[str, float]:
    """Drive one episode and write its log; returns the true values at its end, SI by name.

    env: an environment of this package, single or a vector of one, perhaps wrapped. policy: any
    object with `predict(observation, state, episode_start)`, as Stable-Baselines3 has it.
    Raises ValueError for a vector of several vehicles.
    """
    inner = env.unwrapped
    batch = inner.simulation.batch
    if len(batch.floats) != 1:
        raise ValueError(f"the environment has {len(batch.floats)} vehicles; a log is of one")
    observation, _ = env.reset(seed=seed)
    period = inner.simulation.solver.control_period
    rows, state, start, over = [_row(batch, period)], None, np.ones(1, dtype=bool), False
    while not over:
        action, state = policy.predict(observation, state, start)
        observation, _reward, terminated, truncated, _info = env.step(action)
        rows.append(_row(batch, period))
        start, over = np.zeros(1, dtype=bool), bool(np.any(terminated | truncated))
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time", *CHANNELS])
        writer.writerows(rows)
    return {name: float(batch.floats[0, columns.COLUMN[name]]) for name in IDENTIFIED}


def _row(batch: Any, period: float) -> list[str]:
    """Time and samples; empty where a group has no new one."""
    step = int(batch.counters[0, columns.STEP])
    samples = batch.floats[0, columns.SAMPLE : columns.SAMPLE + CHANNEL_COUNT]
    taken = batch.floats[0, columns.SAMPLE + CHANNEL_COUNT : columns.SAMPLE + CHANNEL_COUNT + 3]
    new = [
        round(float(taken[group])) == step
        for group in range(len(GROUPS))
        for _ in range(GROUP_START[group + 1] - GROUP_START[group])
    ]
    cells = [f"{value:.9g}" if is_new else "" for value, is_new in zip(samples, new, strict=True)]
    return [f"{step * period:.6f}", *cells]
