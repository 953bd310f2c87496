"""Runs for the slip of a vehicle, from CSV files of a user, as steady samples.

Two kinds of files, told apart by the column `time`:
    a row a run     sprocket speeds and beta_left, beta_right, alpha, or v_x, v_y, yaw_rate; without
                    a header the first five in this order
    rows over time  sprocket speeds and x, y, yaw, or v_x, v_y, yaw_rate; a column `run` parts
                    several runs in a file, else a file is a run
Rows over time give a sample for each stretch in which both sprocket speeds hold, its beginning left
out. Samples of one run stay together where data are held out.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tracked_env.cli.user_data.csv_columns import Column, Floats, Table, check_speeds, read
from tracked_env.cli.user_data.run_faults import Fault, check_steady, checked, ground_speed
from tracked_env.physics.parameters import PlantParameters

COLUMNS = (
    Column("sprocket_speed_left", "rad/s", 2e4, "or that of the motor, with --gear",
           others=("omega_l", "motor_speed_left", "wheel_l")),
    Column("sprocket_speed_right", "rad/s", 2e4, "the same of the right sprocket",
           others=("omega_r", "motor_speed_right", "wheel_r")),
    Column("time", "s", 1e10, "of rows over time; without it every row is a run", False, ("t",)),
    Column("run", "-", 1e9, "number of the run", False),
    Column("x", "m", 1e8, "position, any fixed frame", False),
    Column("y", "m", 1e8, "position, x turned to the left", False),
    Column("yaw", "rad", 1e4, "heading, positive to the left", False, ("heading",)),
    Column("v_x", "m/s", 40.0, "forward velocity of the hull", False, ("vx",)),
    Column("v_y", "m/s", 40.0, "velocity to the left", False, ("vy",)),
    Column("yaw_rate", "rad/s", 20.0, "positive to the left", False, ("wz",)),
    Column("beta_left", "m/s", 10.0, "slip velocity, belt less track over the ground", False,
           ("beta_l",)),
    Column("beta_right", "m/s", 10.0, "the same of the right track", False, ("beta_r",)),
    Column("alpha", "rad", 6.3, "slip angle, of atan or atan2 of v_y and v_x", False),
)  # fmt: skip
ORDER = ("sprocket_speed_left", "sprocket_speed_right", "beta_left", "beta_right", "alpha")
MOTIONS = (("x", "y", "yaw"), ("v_x", "v_y", "yaw_rate"))
STRETCH = 0.5  # [s] whose mean speeds are compared
HELD = 0.05, 0.1  # [-] of the speed and [rad/s]: within this a sprocket speed holds
SETTLING = 0.5  # [s] at the start of a stretch that is left out
LARGEST = 10.0  # [-] of the largest of most sprocket speeds
STRAIGHT = 0.5  # [-] difference over sum of belt speeds, below which tracks slip little
LEAST_STRAIGHT = 5  # [-] runs
FASTER = (0.85, 2.0), (0.85, 5.0)  # [-] belts than tracks, in straight runs and in all


class Refused(NamedTuple):
    """A run that is not used."""

    run: str
    reason: str


class Runs(NamedTuple):
    """Steady samples, (N,) each, and what became of the others."""

    sprocket_left: Floats  # [rad/s]
    sprocket_right: Floats  # [rad/s]
    motion: Floats  # (N, 3) v_x, v_y [m/s], yaw rate [rad/s]
    run: Any  # (N,) name of the run of each
    refused: list[Refused]
    rows_left_out: int  # of runs that are used
    said: list[str]

    def without(self, outliers: Any, reasons: Sequence[Refused]) -> "Runs":
        """The same without the samples marked (N,)."""
        keep = ~outliers
        return self._replace(
            sprocket_left=self.sprocket_left[keep], sprocket_right=self.sprocket_right[keep],
            motion=self.motion[keep], run=self.run[keep], refused=[*self.refused, *reasons],
        )  # fmt: skip


def read_runs(
    files: Sequence[Path],
    mapping: Mapping[str, str],
    units: Mapping[str, str],
    gear: float,
    vehicle: PlantParameters,
) -> Runs:
    """All samples of some files. Raises ValueError for a file of another layout or unit."""
    parts: list[tuple[float, float, Floats, str]] = []
    refused: list[Refused] = []
    left_out, said = 0, []
    for path in files:
        table = read(path, COLUMNS, mapping, units, ORDER)
        for side in ("left", "right"):
            table.values[f"sprocket_speed_{side}"] = table.values[f"sprocket_speed_{side}"] / gear
        said.append(f"{path.name}: {table.said}")
        if "time" not in table.values:
            found, bad = _rows_as_runs(table, path, vehicle)
        else:
            found, bad, out = _over_time(table, path, vehicle, len(files) > 1)
            left_out += out
        parts += found
        refused += bad
    _check_units(parts, vehicle, files[0], gear)
    check_speeds([s for p in parts for s in p[:2]], vehicle, files[0])
    return Runs(
        np.array([p[0] for p in parts]), np.array([p[1] for p in parts]),
        np.array([p[2] for p in parts]).reshape(-1, 3), np.array([p[3] for p in parts]),
        refused, left_out, said,
    )  # fmt: skip


def _check_units(parts: Sequence[Any], vehicle: PlantParameters, path: Path, gear: float) -> None:
    """Raise ValueError where the belts of most runs have nothing to do with the motion.

    Straight ahead tracks slip little, and no slip lets them move faster than their belts.
    """
    if not parts:
        return
    speeds = vehicle.sprocket_radius * np.array([p[:2] for p in parts])
    motion = np.array([p[2] for p in parts])
    turning = 0.5 * vehicle.track_gauge * motion[:, 2]
    tracks = 0.5 * (np.abs(motion[:, 0] - turning) + np.abs(motion[:, 0] + turning))
    moving = tracks > 0.02
    chosen = moving & (np.abs(speeds @ [-1.0, 1.0]) < STRAIGHT * np.abs(speeds.sum(axis=1)))
    straight = chosen.sum() >= LEAST_STRAIGHT
    chosen = chosen if straight else moving
    belts = 0.5 * np.abs(speeds).sum(axis=1)
    ratio = float(np.median(belts[chosen] / tracks[chosen])) if chosen.any() else math.inf
    low, high = FASTER[0 if straight else 1]
    if low <= ratio <= high:
        return
    units = {"rpm (--units sprocket_speed=rpm)": 9.549, "deg/s (--units sprocket_speed=deg/s)":
             57.3, "mm (--units x=mm,y=mm or v_x=mm/s,v_y=mm/s)": 1e-3}  # fmt: skip
    advice = [f"in {unit}" for unit, of in units.items() if low < ratio / of < 1.3]
    if ratio > high:
        advice.insert(0, f"of motors with a gear of about {gear * ratio:.3g} (--gear "
                         f"{gear * ratio:.3g}; the data sheet has the exact ratio)")  # fmt: skip
    raise ValueError(
        f"{path}: in the median {'straight ' if straight else ''}run the belts run {ratio:.3g} "
        f"times as fast as the tracks move; must be in [{low:g}, {high:g}]. Are the speeds "
        f"{', or '.join([*advice, 'of a vehicle with another sprocket_radius'])}?"
    )


def _rows_as_runs(table: Table, path: Path, vehicle: PlantParameters) -> tuple[list[Any], Any]:
    """Samples and refused runs of a file with a row a run."""
    values, radius = table.values, vehicle.sprocket_radius
    direct = set(ORDER[2:]) <= values.keys()
    if not direct and not set(MOTIONS[1]) <= values.keys():
        raise ValueError(
            f"{path} has no `time`, so a row is a run, which needs beta_left, beta_right, alpha, "
            "or v_x, v_y, yaw_rate. Map columns with --columns, time too for rows over time"
        )
    names = (*ORDER[:2], *(ORDER[2:] if direct else MOTIONS[1]))
    rows = np.stack([values[name] for name in names], axis=1)
    found, refused = [], []
    seen: dict[tuple[float, ...], str] = {}
    largest = LARGEST * float(np.nanpercentile(np.abs(rows[:, :2]), 90.0))
    for number, row in enumerate(rows):
        name = f"{path.stem} row {number + 1}"
        lacking = [n for n, value in zip(names, row, strict=True) if not np.isfinite(value)]
        try:
            if lacking:
                raise Fault(f"no number for {', '.join(lacking)}")
            if (key := tuple(row[2:])) in seen and any(key):
                raise Fault(f"the same motion as {seen[key]}, to the last digit")
            if max(abs(row[0]), abs(row[1])) > largest:
                raise Fault(f"a sprocket speed of {max(abs(row[:2])):.4g} rad/s")
            motion = row[2:]
            if direct:
                tracks = radius * row[:2] - row[2:4]
                v_x = 0.5 * float(tracks.sum())
                if abs(row[4]) > 2.0 * math.pi:
                    raise Fault(f"alpha = {row[4]:.4g} rad, more than a full turn")
                yaw_rate = float(tracks[1] - tracks[0]) / vehicle.track_gauge
                motion = np.array([v_x, v_x * math.tan(row[4]), yaw_rate])
            check_steady(row[0], row[1], motion, vehicle)
            seen[key] = name
            found.append((float(row[0]), float(row[1]), motion, name))
        except Fault as fault:
            refused.append(Refused(name, str(fault)))
    return found, refused


def _over_time(
    table: Table, path: Path, vehicle: PlantParameters, several: bool
) -> tuple[list[Any], list[Refused], int]:
    """Samples, refused runs and rows left out, of a file with rows over time."""
    values = table.values
    kind = next((names for names in MOTIONS if set(names) <= values.keys()), None)
    if kind is None:
        raise ValueError(
            f"{path} has `time` and neither x, y, yaw nor v_x, v_y, yaw_rate; must have one of the "
            "two. Map columns with --columns"
        )
    number = values.get("run", np.zeros(len(values["time"])))
    found, refused, left_out = [], [], 0
    for one in np.unique(number[np.isfinite(number)]):
        rows = number == one
        name = f"{path.stem} run {one:g}" if "run" in values else path.stem
        run = {n: values[n][rows] for n in ("time", *ORDER[:2], *kind)}
        lines = (0, 1) if "run" in values else (table.truncated, len(number))
        try:
            usable, out = checked(run, vehicle, lines)
            samples = steady(usable, vehicle)
            found += [(*sample, name) for sample in samples]
            left_out += out
        except Fault as fault:
            refused.append(Refused(name, str(fault)))
    if lost := int(np.sum(~np.isfinite(number))):
        left_out += lost
    return found, refused, left_out


def steady(rows: dict[str, Floats], vehicle: PlantParameters) -> list[tuple[float, float, Floats]]:
    """(sprocket left, right, motion (3,)) of each stretch at constant speeds. Raises Fault."""
    time = rows["time"] - rows["time"][0]
    left, right = rows["sprocket_speed_left"], rows["sprocket_speed_right"]
    bins = np.floor(time / STRETCH).astype(int)
    pieces = [np.flatnonzero(bins == k) for k in np.unique(bins)]
    groups: list[list[Any]] = []
    for piece in pieces:
        if len(piece) < 3:
            continue
        means = np.array([left[piece].mean(), right[piece].mean()])
        if groups:
            before = np.concatenate(groups[-1])
            level = np.array([left[before].mean(), right[before].mean()])
            if (np.abs(means - level) <= np.maximum(HELD[0] * np.abs(level), HELD[1])).all():
                groups[-1].append(piece)
                continue
        groups.append([piece])
    found, wrong = [], ""
    for group in groups:
        chosen = np.concatenate(group)
        chosen = chosen[time[chosen] >= time[chosen[0]] + SETTLING]
        if len(chosen) < 5 or time[chosen[-1]] - time[chosen[0]] < 0.8 * STRETCH:
            continue
        part = {name: column[chosen] for name, column in rows.items()}
        speeds = float(part["sprocket_speed_left"].mean()), float(
            part["sprocket_speed_right"].mean()
        )  # fmt: skip
        motion = mean_motion(part)
        try:
            check_steady(*speeds, motion, vehicle)
        except Fault as fault:
            wrong = str(fault)
            continue
        found.append((*speeds, motion))
    if not found:
        raise Fault(
            wrong or f"no stretch of {STRETCH + SETTLING:g} s in which both sprocket speeds hold"
        )
    return found


def mean_motion(part: dict[str, Floats]) -> Floats:
    """Mean v_x, v_y [m/s], yaw rate [rad/s] of a stretch, in the body's axes."""
    if "x" not in part:
        return np.array([part[name].mean() for name in MOTIONS[1]])
    yaw = np.unwrap(part["yaw"])
    lasts = float(part["time"][-1] - part["time"][0])
    # A straight line through the heading, whose noise would turn every step of the way.
    rate, first = np.polyfit(part["time"] - part["time"][0], yaw, 1)
    middle = first + rate * 0.5 * (part["time"][1:] + part["time"][:-1] - 2.0 * part["time"][0])
    c, s = np.cos(middle), np.sin(middle)
    d_x, d_y = np.diff(part["x"]), np.diff(part["y"])
    return np.array([np.sum(c * d_x + s * d_y) / lasts, np.sum(c * d_y - s * d_x) / lasts, rate])


__all__ = ["COLUMNS", "Refused", "Runs", "ground_speed", "read_runs"]
