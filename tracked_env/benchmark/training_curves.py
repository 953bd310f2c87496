"""What the training of an agent has left beside its archives: learning curves, and what it cost.

A training writes a curve.csv with the columns `steps`, `cpu_seconds` and `held_out_rmse`; a curve
of another kind, or none, is left out.
"""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple


class TrainingCost(NamedTuple):
    """Of one seed, the mean over those that are known."""

    steps: float  # of the environment
    cpu_seconds: float  # [s] of processor time

    def __str__(self) -> str:
        return f"{self.steps / 1e6:.2g} M steps, {self.cpu_seconds:.0f} s"


def _rows(folder: Path, columns: Sequence[str]) -> list[tuple[float, ...]]:
    """These columns of the curve in a folder; none where it lacks one."""
    path = folder / "curve.csv"
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        try:
            return [tuple(float(row[name]) for name in columns) for row in csv.DictReader(file)]
        except (KeyError, TypeError, ValueError):
            return []  # a curve of another kind


def read_curves(
    folders: Mapping[str, Sequence[Path]],
) -> dict[str, list[list[tuple[float, float]]]]:
    """Learning curves [(steps, RMSE on held-out episodes [m]), ...], one per seed, by agent.

    folders: those of an agent's archives. Agents without a curve are left out.
    """
    found: dict[str, list[list[tuple[float, float]]]] = {}
    for agent, places in folders.items():
        for folder in places:
            rows = _rows(folder, ("steps", "held_out_rmse"))
            known = [(steps, rmse) for steps, rmse in rows if rmse == rmse]
            if known:
                found.setdefault(agent, []).append(known)
    return found


def read_costs(folders: Mapping[str, Sequence[Path]]) -> dict[str, TrainingCost]:
    """Cost of training a seed, by agent; folders as `read_curves`."""
    found = {}
    for agent, places in folders.items():
        last = [rows[-1] for rows in (_rows(f, ("steps", "cpu_seconds")) for f in places) if rows]
        if last:
            steps, seconds = (sum(values) / len(last) for values in zip(*last, strict=True))
            found[agent] = TrainingCost(steps, seconds)
    return found
