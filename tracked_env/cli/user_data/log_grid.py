"""The rows of a log on a grid of steps of one length."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tracked_env.cli.user_data.csv_columns import UNITS, Floats

EVEN = 0.1  # [-] of a step: farther off the grid in more than one row of a hundred is uneven
STEPS = (1e-3, 0.2)  # [s] of a log
LEAST = 5.0  # [s] a log lasts at least
LOST = 0.1  # [-] share of rows with a wrong time that is too much
JUMP = 60.0  # [s] between two rows: a longer one is no gap of a log, but another clock


def in_order(values: dict[str, Floats], path: Path) -> tuple[dict[str, Floats], int]:
    """Rows whose time rises, and how many were left out."""
    time = values["time"]
    known = np.isfinite(time)
    latest = np.maximum.accumulate(np.where(known, time, -math.inf))
    late = time > np.concatenate([[-math.inf], latest[:-1]])
    # One row ahead of all others would leave out the others: then it is that row.
    earliest = np.minimum.accumulate(np.where(known, time, math.inf)[::-1])[::-1]
    early = time < np.concatenate([earliest[1:], [math.inf]])
    rising = known & (late if late.sum() >= early.sum() else early)
    dropped = int(len(time) - rising.sum())
    if dropped > LOST * len(time):
        raise ValueError(
            f"{path}: in {dropped} of {len(time)} rows the time does not rise; must be less than "
            f"{LOST:.0%}. Are several logs in one file, or is `time` another column?"
        )
    rows = np.flatnonzero(rising)
    gaps = np.diff(time[rows])
    if len(gaps) and (longest := float(gaps.max())) > JUMP:
        at = int(np.argmax(gaps))
        raise ValueError(
            f"{path}: the clock jumps by {longest:.4g} s between the rows {rows[at] + 1} and "
            f"{rows[at + 1] + 1}; must be {JUMP:g} s or less. Was the clock set while logging? "
            "Then cut the log there"
        )
    return {name: column[rows] for name, column in values.items()}, dropped


def middle_step(time: Floats, path: Path) -> float:
    """Median [s] between two rows. Raises ValueError for one that no log has, and a short log."""
    middle = float(np.median(np.diff(time))) if len(time) > 1 else math.nan
    if not STEPS[0] <= middle <= STEPS[1]:
        likely = [u for u, f in UNITS["s"].items() if STEPS[0] <= middle * f <= STEPS[1]]
        advice = f" Is the time in {likely[0]}? Then --units time={likely[0]}" if likely else ""
        allowed = f"[{STEPS[0]:g}, {STEPS[1]:g}] s"
        raise ValueError(f"{path}: a row every {middle:.3g} s; must be in {allowed}.{advice}")
    if (lasts := float(time[-1] - time[0])) < LEAST:
        raise ValueError(f"{path} lasts {lasts:.3g} s; must be {LEAST:g} s or more")
    return middle


def on_grid(
    values: dict[str, Floats], path: Path, notes: list[str]
) -> tuple[float, dict[str, Floats], NDArray[np.bool_]]:
    """(step [s], columns (T,), (T,) whether a row is there)."""
    time = values["time"] - values["time"][0]
    values = {name: column for name, column in values.items() if name != "time"}
    gaps, middle = np.diff(time), middle_step(time, path)
    period = float(np.mean(gaps[gaps < 1.5 * middle]))
    place = np.concatenate([[0.0], np.cumsum(np.maximum(np.round(gaps / period), 1.0))])
    off = np.abs(gaps / period - np.maximum(np.round(gaps / period), 1.0))
    even = np.mean(off > EVEN) < 0.01
    count = int(place[-1]) + 1 if even else int(time[-1] / period) + 1
    seen = np.zeros(count, dtype=bool)
    grid = {}
    if even:
        where = place.astype(np.int64)
        seen[where] = True
        for name, column in values.items():
            grid[name] = np.full(count, math.nan)
            grid[name][where] = column
    else:
        at = period * np.arange(count)
        nearest = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
        seen = time[nearest] - time[nearest - 1] < 2.5 * period
        for name, column in values.items():
            grid[name] = np.where(seen, np.interp(at, time, column), math.nan)
    lost = int(count - seen.sum())
    notes.append(
        f"{count} steps of {1e3 * period:.4g} ms, {'as logged' if even else 'resampled'}"
        + (f", {lost} of them without a row" if lost else "")
        + ("." if even else ": rows are unevenly spaced, and were interpolated linearly.")
    )
    return period, grid, seen
