"""What makes a run of a vehicle useless: found from its own numbers, with the reason in words.

A run is a stretch of rows with time, both sprocket speeds and the motion, as a pose or as
velocities. What a few rows have is left out and counted; what more have refuses the run.

Runs for the slip of a vehicle, from CSV files of a user, as steady samples.

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

from baselines.identify.csv_log import Column, Floats, Table, check_speeds, read
from tracked_env.physics.parameters import PlantParameters

LEAST_ROWS = 20
LEAST_TIME = 1.0  # [s] of a run
SPOILT = 0.1  # [-] share of rows with a fault that refuses a run
DUPLICATES = 0.02  # [-] share of stamps that stand twice
MOVING = 0.05  # [m/s] of a belt or of the vehicle
JUMP = 0.1  # [m] beyond what belts could have driven between two rows
TWIST = 0.3  # [rad] likewise of the heading
OVERRUN = 1.5  # [-] track over belt speed; more is no braking but another unit
FASTER = 0.15  # [m/s] beyond that


class Fault(ValueError):
    """Why a run is not used."""


def checked(
    run: dict[str, Floats], vehicle: PlantParameters, lines: tuple[int, int] = (0, 0)
) -> tuple[dict[str, Floats], int]:
    """The rows of a run that can be used, and how many were left out.

    lines: truncated lines of the run, and all. Raises Fault.
    """
    count = len(run["time"])
    if lines[0] > SPOILT * max(lines[1], 1):
        raise Fault(f"{lines[0]} of {lines[1]} lines are truncated")
    finite = np.all([np.isfinite(column) for column in run.values()], axis=0)
    if np.mean(~finite) > SPOILT:
        worst = max(run, key=lambda name: int(np.sum(~np.isfinite(run[name]))))
        raise Fault(f"{int(np.sum(~finite))} of {count} rows lack numbers, most of {worst}")
    rows = {name: column[finite] for name, column in run.items()}
    steps = np.diff(rows["time"])
    if (steps < 0.0).any():
        at = int(np.argmax(steps < 0.0)) + 1
        raise Fault(f"time goes backward at row {at + 1}, by {-steps[at - 1]:.3g} s")
    twice = np.concatenate([[False], steps == 0.0])
    if len(steps) and np.mean(twice) > DUPLICATES:
        raise Fault(f"{int(twice.sum())} of {count} time stamps stand twice")
    rows = {name: column[~twice] for name, column in rows.items()}
    time = rows["time"]
    if len(time) < LEAST_ROWS or time[-1] - time[0] < LEAST_TIME:
        lasts = time[-1] - time[0] if len(time) else 0.0
        raise Fault(
            f"{len(time)} rows in {lasts:.2g} s; must be {LEAST_ROWS} in {LEAST_TIME:g} s or more"
        )
    _check_encoders(rows, vehicle)
    if "x" in rows:
        _check_pose(rows, vehicle)
    return rows, int(count - len(time))


def _varies(column: Floats) -> bool:
    return float(np.ptp(column)) > 0.0


def ground_speed(rows: dict[str, Floats]) -> Floats:
    """Speed [m/s] of the vehicle, of each row, or between rows of a pose."""
    if "x" in rows:
        way = np.hypot(np.diff(rows["x"]), np.diff(rows["y"]))
        return way / np.diff(rows["time"])
    return np.hypot(rows["v_x"], rows["v_y"])


def _moves(rows: dict[str, Floats], vehicle: PlantParameters) -> bool:
    """Whether the vehicle goes or turns in most of the run."""
    if "x" in rows:
        lasts = rows["time"][-1] - rows["time"][0]
        turned = abs(float(np.unwrap(rows["yaw"])[-1] - rows["yaw"][0])) / lasts
        way = math.hypot(float(np.ptp(rows["x"])), float(np.ptp(rows["y"]))) / lasts
        return bool(max(way, 0.5 * vehicle.track_gauge * turned) > MOVING)
    turned = float(np.median(np.abs(rows["yaw_rate"])))
    return bool(max(np.median(ground_speed(rows)), 0.5 * vehicle.track_gauge * turned) > MOVING)


def _check_encoders(rows: dict[str, Floats], vehicle: PlantParameters) -> None:
    """Raise Fault for a sprocket speed that stands still."""
    belts = {
        side: vehicle.sprocket_radius * rows[f"sprocket_speed_{side}"] for side in ("left", "right")
    }
    stuck = [side for side, belt in belts.items() if not _varies(belt)]
    moves, driven = _moves(rows, vehicle), max(np.abs(belt).max() for belt in belts.values())
    if len(stuck) == 1:
        value = rows[f"sprocket_speed_{stuck[0]}"][0]
        raise Fault(
            f"the {stuck[0]} sprocket speed is {value:.4g} rad/s in every row and the other "
            "varies: a stuck encoder"
        )
    if moves and driven < 0.1 * MOVING:
        raise Fault("both sprocket speeds are 0 while the vehicle moves: no encoder")
    still = [name for name in ("x", "y", "yaw", "v_x", "yaw_rate") if name in rows]
    if driven > MOVING and not any(_varies(rows[name]) for name in still):
        if len(stuck) == 2 and "x" not in rows:
            return  # a steady motion without noise
        raise Fault(f"{', '.join(still)} are the same in every row while the belts run: no motion")


def _check_pose(rows: dict[str, Floats], vehicle: PlantParameters) -> None:
    """Raise Fault for a pose that jumps or holds."""
    steps = np.diff(rows["time"])
    fastest = vehicle.sprocket_radius * np.max(
        [np.abs(rows["sprocket_speed_left"]), np.abs(rows["sprocket_speed_right"])], axis=0
    )
    allowed = OVERRUN * np.maximum(fastest[1:], fastest[:-1]) * steps + JUMP
    way = np.hypot(np.diff(rows["x"]), np.diff(rows["y"]))
    if (way > allowed).any():
        at = int(np.argmax(way - allowed)) + 1
        raise Fault(
            f"the position jumps by {way[at - 1]:.2f} m in {steps[at - 1]:.3g} s at row {at + 1}"
        )
    turned = np.abs(np.diff(np.unwrap(rows["yaw"])))
    twisted = 2.0 * OVERRUN * np.maximum(fastest[1:], fastest[:-1]) * steps / vehicle.track_gauge
    if (turned > twisted + TWIST).any():
        at = int(np.argmax(turned - twisted)) + 1
        raise Fault(f"the heading jumps by {turned[at - 1]:.2f} rad at row {at + 1}")
    held = (way == 0.0) & (turned == 0.0) & (fastest[1:] > MOVING)
    longest = np.diff(np.flatnonzero(np.concatenate([[True], ~held, [True]]))).max() - 1
    if longest > 0.3 * len(way):
        raise Fault(f"the pose is the same in {longest} rows on end while the belts run")


def check_steady(left: float, right: float, motion: Floats, vehicle: PlantParameters) -> None:
    """Raise Fault where no belts could have moved a vehicle so; motion: v_x, v_y, yaw rate."""
    half = 0.5 * vehicle.track_gauge * motion[2]
    for side, omega, track in (
        ("left", left, motion[0] - half),
        ("right", right, motion[0] + half),
    ):
        belt = vehicle.sprocket_radius * omega
        other = vehicle.sprocket_radius * (right if side == "left" else left)
        if abs(track) > OVERRUN * max(abs(belt), abs(other)) + FASTER:
            raise Fault(
                f"the {side} track moves at {track:.3g} m/s over the ground, its belt at "
                f"{belt:.3g} m/s: faster than a belt can drive or drag it"
            )
        if belt * track < 0.0 and abs(track) > 0.5 * abs(belt) + FASTER:
            raise Fault(f"the {side} belt runs at {belt:.3g} m/s and its track at {track:.3g} m/s")


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
FASTER_SLIP_RUNS = (0.85, 2.0), (0.85, 5.0)  # [-] belts than tracks, in straight runs and in all


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
    low, high = FASTER_SLIP_RUNS[0 if straight else 1]
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
