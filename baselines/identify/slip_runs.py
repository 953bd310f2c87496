"""Runs for the slip of a vehicle, from CSV files of a user, as steady samples.

Two kinds of files, told apart by the column `time`:
    a row a run     sprocket speeds and beta_left, beta_right, alpha, or v_x, v_y, yaw_rate; without
                    a header the first five in this order
    rows over time  sprocket speeds and x, y, yaw, or v_x, v_y, yaw_rate; a column `run` parts
                    several runs in a file, else a file is a run
Rows over time give a sample for each stretch in which both sprocket speeds hold, its beginning left
out. Samples of one run stay together where data are held out. Faults of a few rows are left out and
counted; what more rows have refuses the run, with the reason in words.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.identify.csv_log import Column, Columns, Floats, Table, check_speeds, errors_of, read
from baselines.identify.log_checks import SIDES, advice_on_belts, check_ratio
from tracked_env.physics.parameters import PlantParameters

COLUMNS = (
    Column(
        "sprocket_speed_left", "rad/s", 2e4, "or motor", True, "omega_l motor_speed_left wheel_l"
    ),
    Column(
        "sprocket_speed_right", "rad/s", 2e4, "or motor", True, "omega_r motor_speed_right wheel_r"
    ),
    Column("time", "s", 1e10, "of rows over time; without it every row is a run", False, "t"),
    Column("run", "-", 1e9, "number of the run", False),
    Column("x", "m", 1e8, "position, any fixed frame", False),
    Column("y", "m", 1e8, "position, x turned to the left", False),
    Column("yaw", "rad", 1e4, "heading, positive to the left", False, "heading"),
    Column("v_x", "m/s", 40.0, "forward velocity of the hull", False, "vx"),
    Column("v_y", "m/s", 40.0, "velocity to the left", False, "vy"),
    Column("yaw_rate", "rad/s", 20.0, "positive to the left", False, "wz"),
    Column("beta_left", "m/s", 10.0, "slip velocity, belt less track speed", False, "beta_l"),
    Column("beta_right", "m/s", 10.0, "the same of the right track", False, "beta_r"),
    Column("alpha", "rad", 6.3, "slip angle, of atan or atan2 of v_y and v_x", False),
)
ORDER = ("sprocket_speed_left", "sprocket_speed_right", "beta_left", "beta_right", "alpha")
MOTIONS = (("x", "y", "yaw"), ("v_x", "v_y", "yaw_rate"))

STRETCH = 0.5  # [s] whose mean speeds are compared
HOLDS = 0.05, 0.1  # [-] of the speed and [rad/s]: within this a sprocket speed holds
SETTLING = 0.5  # [s] at the start of a stretch that is left out
LARGEST = 10.0  # [-] of the largest of most sprocket speeds
STRAIGHT = 0.5  # [-] difference over sum of belt speeds, below which tracks slip little
LEAST_STRAIGHT = 5  # [-] runs
BELTS_OVER_TRACKS = (0.85, 2.0), (0.85, 5.0)  # [-] in straight runs and in all

LEAST_ROWS = 20
LEAST_TIME = 1.0  # [s] of a run
BAD_ROWS = 0.1  # [-] share of rows with a fault that refuses a run
DUPLICATES = 0.02  # [-] share of stamps that stand twice
MOVING = 0.05  # [m/s] of a belt or of the vehicle
JUMP = 0.1  # [m] beyond what belts could have driven between two rows
TWIST = 0.3  # [rad] likewise of the heading
OVERRUN = 1.5  # [-] track over belt speed; more is no braking but another unit
FASTER = 0.15  # [m/s] beyond that

Sample = tuple[float, float, Floats, str]  # sprockets left, right, motion (3,), name of the run


class Fault(ValueError):
    """Why a run is not used."""


class Refused(NamedTuple):
    """A run that is not used."""

    run: str
    reason: str


class Runs(NamedTuple):
    """Steady samples, (N,) each, and what became of the others."""

    sprocket_left: Floats  # [rad/s]
    sprocket_right: Floats  # [rad/s]
    motion: Floats  # (N, 3) v_x, v_y [m/s], yaw rate [rad/s]
    run: NDArray[np.str_]  # (N,) name of the run of each
    refused: list[Refused]
    rows_left_out: int  # of runs that are used

    def without(self, reasons: Mapping[int, str]) -> "Runs":
        """The same without the samples of these numbers, whose runs are refused for the reasons."""
        keep = np.ones(len(self.run), dtype=bool)
        keep[[*reasons]] = False
        refused = [Refused(str(self.run[k]), reason) for k, reason in reasons.items()]
        columns: Any = (column[keep] for column in self[:4])
        return Runs._make([*columns, [*self.refused, *refused], self.rows_left_out])


def read_runs(
    files: Sequence[Path],
    mapping: Mapping[str, str],
    units: Mapping[str, str],
    gear: float,
    vehicle: PlantParameters,
) -> Runs:
    """All samples of some files. Raises ValueError for a file of another layout or unit."""
    samples, refused, left_out = list[Sample](), list[Refused](), 0
    for path in files:
        with errors_of(path):
            table = read(path, COLUMNS, mapping, units, ORDER)
            for name in ORDER[:2]:
                table.values[name] = table.values[name] / gear
            if "time" in table.values:
                left_out += _over_time(table, path.stem, vehicle, samples, refused)
            else:
                _rows_as_runs(table.values, path.stem, vehicle, samples, refused)
    speeds = np.array([sample[:2] for sample in samples]).reshape(-1, 2)
    motion = np.array([sample[2] for sample in samples]).reshape(-1, 3)
    with errors_of(files[0]):
        _check_units(speeds, motion, vehicle, gear)
        check_speeds(speeds, vehicle)
    names = np.array([sample[3] for sample in samples])
    return Runs(speeds[:, 0], speeds[:, 1], motion, names, refused, left_out)


def _check_units(speeds: Floats, motion: Floats, vehicle: PlantParameters, gear: float) -> None:
    """Raise ValueError where the belts of most runs have nothing to do with the motion.

    Straight ahead tracks slip little, and no slip lets them move faster than their belts.
    """
    if not len(speeds):
        return
    belts, turning = vehicle.sprocket_radius * speeds, 0.5 * vehicle.track_gauge * motion[:, 2]
    tracks = 0.5 * (np.abs(motion[:, 0] - turning) + np.abs(motion[:, 0] + turning))
    moving = tracks > 0.02
    runs = moving & (np.abs(belts @ [-1.0, 1.0]) < STRAIGHT * np.abs(belts.sum(axis=1)))
    straight = runs.sum() >= LEAST_STRAIGHT
    runs = runs if straight else moving
    ratios = 0.5 * np.abs(belts).sum(axis=1)[runs] / tracks[runs]
    ratio = float(np.median(ratios)) if runs.any() else math.inf
    what = f"in the median {'straight ' if straight else ''}run the belts run {{:.3g}} times"
    limits = BELTS_OVER_TRACKS[0 if straight else 1]
    check_ratio(f"{what} as fast as the tracks move", ratio, limits, advice_on_belts(ratio, gear))


# --- a row a run ----------------------------------------------------------------------------


def _rows_as_runs(
    values: Columns,
    file: str,
    vehicle: PlantParameters,
    samples: list[Sample],
    refused: list[Refused],
) -> None:
    """Add samples and refused runs of a file with a row a run."""
    slips = set(ORDER[2:]) <= values.keys()
    if not slips and not set(MOTIONS[1]) <= values.keys():
        raise ValueError(
            "there is no `time`, so a row is a run, which needs beta_left, beta_right, alpha, "
            "or v_x, v_y, yaw_rate. Map columns with --columns, time too for rows over time"
        )
    names = (*ORDER[:2], *(ORDER[2:] if slips else MOTIONS[1]))
    rows = np.stack([values[name] for name in names], axis=1)
    first_run: dict[tuple[float, ...], str] = {}
    largest = LARGEST * float(np.nanpercentile(np.abs(rows[:, :2]), 90.0))
    for number, row in enumerate(rows):
        name, key = f"{file} row {number + 1}", tuple(row[2:])
        fastest = float(max(abs(row[0]), abs(row[1])))
        try:
            if not np.isfinite(row).all():
                lacking = [n for n, value in zip(names, row, strict=True) if not np.isfinite(value)]
                raise Fault(f"no number for {', '.join(lacking)}")
            if key in first_run and any(key):
                raise Fault(f"the same motion as {first_run[key]}, to the last digit")
            if fastest > largest:
                raise Fault(f"a sprocket speed of {fastest:.4g} rad/s")
            motion = _motion_of(row, vehicle) if slips else row[2:]
            check_steady(row[0], row[1], motion, vehicle)
        except Fault as fault:
            refused.append(Refused(name, str(fault)))
        else:
            first_run[key] = name
            samples.append((float(row[0]), float(row[1]), motion, name))


def _motion_of(row: Floats, vehicle: PlantParameters) -> Floats:
    """v_x, v_y, yaw rate of a row with both slip velocities and the slip angle. Raises Fault."""
    if abs(row[4]) > 2.0 * math.pi:
        raise Fault(f"alpha = {row[4]:.4g} rad, more than a full turn")
    tracks = vehicle.sprocket_radius * row[:2] - row[2:4]
    v_x = 0.5 * float(tracks.sum())
    yaw_rate = float(tracks[1] - tracks[0]) / vehicle.track_gauge
    return np.array([v_x, v_x * math.tan(row[4]), yaw_rate])


def check_steady(left: float, right: float, motion: Floats, vehicle: PlantParameters) -> None:
    """Raise Fault where no belts could have moved a vehicle so; motion: v_x, v_y, yaw rate."""
    belts = vehicle.sprocket_radius * left, vehicle.sprocket_radius * right
    half, fastest = 0.5 * vehicle.track_gauge * motion[2], max(map(abs, belts))
    tracks = motion[0] - half, motion[0] + half
    for side, belt, track in zip(SIDES, belts, tracks, strict=True):
        if abs(track) > OVERRUN * fastest + FASTER:
            raise Fault(
                f"the {side} track moves at {track:.3g} m/s over the ground, its belt at "
                f"{belt:.3g} m/s: faster than a belt can drive or drag it"
            )
        if belt * track < 0.0 and abs(track) > 0.5 * abs(belt) + FASTER:
            raise Fault(f"the {side} belt runs at {belt:.3g} m/s and its track at {track:.3g} m/s")


# --- rows over time -------------------------------------------------------------------------


def _over_time(
    table: Table, file: str, vehicle: PlantParameters, samples: list[Sample], refused: list[Refused]
) -> int:
    """Add samples and refused runs of a file with rows over time; returns how many rows of runs
    that are used are left out."""
    values = table.values
    kind = next((names for names in MOTIONS if set(names) <= values.keys()), None)
    if kind is None:
        raise ValueError(
            "there is `time` and neither x, y, yaw nor v_x, v_y, yaw_rate; must have one of the "
            "two. Map columns with --columns"
        )
    number = values.get("run", np.zeros(len(values["time"])))
    left_out = int(np.sum(~np.isfinite(number)))
    for run in np.unique(number[np.isfinite(number)]):
        name, lines = file, (table.truncated, len(number))
        if "run" in values:
            name, lines = f"{file} run {run:g}", (0, 1)
        try:
            rows = {n: values[n][number == run] for n in ("time", *ORDER[:2], *kind)}
            usable, dropped = _checked(rows, vehicle, lines)
            samples += [(*sample, name) for sample in steady(usable, vehicle)]
            left_out += dropped
        except Fault as fault:
            refused.append(Refused(name, str(fault)))
    return left_out


def steady(rows: Columns, vehicle: PlantParameters) -> list[tuple[float, float, Floats]]:
    """(sprocket left, right, motion (3,)) of each stretch at constant speeds. Raises Fault."""
    time = rows["time"] - rows["time"][0]
    speeds = [rows[name] for name in ORDER[:2]]
    bins = np.floor(time / STRETCH).astype(int)
    stretches: list[NDArray[np.int64]] = []
    for piece in (np.flatnonzero(bins == k) for k in np.unique(bins)):
        if len(piece) < 3:
            continue
        if stretches:
            pair = (piece, stretches[-1])
            means, level = (np.array([c[at].mean() for c in speeds]) for at in pair)
            if (np.abs(means - level) <= np.maximum(HOLDS[0] * np.abs(level), HOLDS[1])).all():
                stretches[-1] = np.concatenate([stretches[-1], piece])
                continue
        stretches.append(piece)
    samples, wrong = [], ""
    for stretch in stretches:
        settled = stretch[time[stretch] >= time[stretch[0]] + SETTLING]
        if len(settled) < 5 or time[settled[-1]] - time[settled[0]] < 0.8 * STRETCH:
            continue
        part = {name: column[settled] for name, column in rows.items()}
        left, right = (float(part[name].mean()) for name in ORDER[:2])
        motion = mean_motion(part)
        try:
            check_steady(left, right, motion, vehicle)
        except Fault as fault:
            wrong = str(fault)
        else:
            samples.append((left, right, motion))
    if not samples:
        raise Fault(
            wrong or f"no stretch of {STRETCH + SETTLING:g} s in which both sprocket speeds hold"
        )
    return samples


def mean_motion(part: Columns) -> Floats:
    """Mean v_x, v_y [m/s], yaw rate [rad/s] of a stretch, in the body's axes."""
    if "x" not in part:
        return np.array([part[name].mean() for name in MOTIONS[1]])
    time, yaw = part["time"], np.unwrap(part["yaw"])
    lasts = float(time[-1] - time[0])
    # A straight line through the heading, whose noise would turn every step of the way.
    rate, first = np.polyfit(time - time[0], yaw, 1)
    middle = first + rate * 0.5 * (time[1:] + time[:-1] - 2.0 * time[0])
    c, s, d_x, d_y = np.cos(middle), np.sin(middle), np.diff(part["x"]), np.diff(part["y"])
    return np.array([np.sum(c * d_x + s * d_y) / lasts, np.sum(c * d_y - s * d_x) / lasts, rate])


# --- faults of a run over time --------------------------------------------------------------


def _checked(run: Columns, vehicle: PlantParameters, lines: tuple[int, int]) -> tuple[Columns, int]:
    """The rows of a run that can be used, and how many were left out.

    lines: truncated lines of the run, and all. Raises Fault.
    """
    count = len(run["time"])
    if lines[0] > BAD_ROWS * max(lines[1], 1):
        raise Fault(f"{lines[0]} of {lines[1]} lines are truncated")
    finite = np.all([np.isfinite(column) for column in run.values()], axis=0)
    if np.mean(~finite) > BAD_ROWS:
        worst = max(run, key=lambda name: int(np.sum(~np.isfinite(run[name]))))
        raise Fault(f"{int(np.sum(~finite))} of {count} rows lack numbers, most of {worst}")
    steps = np.diff(run["time"][finite])
    if (steps < 0.0).any():
        at = int(np.argmax(steps < 0.0)) + 1
        raise Fault(f"time goes backward at row {at + 1}, by {-steps[at - 1]:.3g} s")
    twice = np.concatenate([[False], steps == 0.0])
    if len(steps) and np.mean(twice) > DUPLICATES:
        raise Fault(f"{int(twice.sum())} of {count} time stamps stand twice")
    rows = {name: column[finite][~twice] for name, column in run.items()}
    time = rows["time"]
    lasts = time[-1] - time[0] if len(time) else 0.0
    if len(time) < LEAST_ROWS or lasts < LEAST_TIME:
        least = f"{LEAST_ROWS} in {LEAST_TIME:g} s"
        raise Fault(f"{len(time)} rows in {lasts:.2g} s; must be {least} or more")
    belts = {side: vehicle.sprocket_radius * rows[f"sprocket_speed_{side}"] for side in SIDES}
    _check_encoders(rows, belts, vehicle)
    if "x" in rows:
        fastest = np.max(np.abs([*belts.values()]), axis=0)
        _check_pose(rows, np.diff(time), fastest, vehicle)
    return rows, int(count - len(time))


def _moves(rows: Columns, vehicle: PlantParameters) -> bool:
    """Whether the vehicle goes or turns in most of the run."""
    if "x" in rows:
        lasts = rows["time"][-1] - rows["time"][0]
        turned = abs(float(np.unwrap(rows["yaw"])[-1] - rows["yaw"][0])) / lasts
        way = math.hypot(float(np.ptp(rows["x"])), float(np.ptp(rows["y"]))) / lasts
    else:
        turned = float(np.median(np.abs(rows["yaw_rate"])))
        way = float(np.median(np.hypot(rows["v_x"], rows["v_y"])))
    return bool(max(way, 0.5 * vehicle.track_gauge * turned) > MOVING)


def _check_encoders(rows: Columns, belts: Columns, vehicle: PlantParameters) -> None:
    """Raise Fault for a sprocket speed, or a motion, that stands still; belts [m/s]."""
    stuck = [side for side, belt in belts.items() if float(np.ptp(belt)) == 0.0]
    fastest = max(np.abs(belt).max() for belt in belts.values())
    if len(stuck) == 1:
        value = rows[f"sprocket_speed_{stuck[0]}"][0]
        raise Fault(
            f"the {stuck[0]} sprocket speed is {value:.4g} rad/s in every row and the other "
            "varies: a stuck encoder"
        )
    if _moves(rows, vehicle) and fastest < 0.1 * MOVING:
        raise Fault("both sprocket speeds are 0 while the vehicle moves: no encoder")
    names = [name for name in ("x", "y", "yaw", "v_x", "yaw_rate") if name in rows]
    without_noise = len(stuck) == 2 and "x" not in rows
    still = all(float(np.ptp(rows[name])) == 0.0 for name in names)
    if fastest > MOVING and still and not without_noise:
        raise Fault(f"{', '.join(names)} are the same in every row while the belts run: no motion")


def _check_pose(rows: Columns, steps: Floats, fastest: Floats, vehicle: PlantParameters) -> None:
    """Raise Fault for a pose that jumps or holds; fastest (T,) [m/s] of both belts."""
    reach = OVERRUN * np.maximum(fastest[1:], fastest[:-1]) * steps
    way = np.hypot(np.diff(rows["x"]), np.diff(rows["y"]))
    if (way > reach + JUMP).any():
        at = int(np.argmax(way - (reach + JUMP))) + 1
        jump = f"{way[at - 1]:.2f} m in {steps[at - 1]:.3g} s"
        raise Fault(f"the position jumps by {jump} at row {at + 1}")
    turned = np.abs(np.diff(np.unwrap(rows["yaw"])))
    twisted = 2.0 * reach / vehicle.track_gauge
    if (turned > twisted + TWIST).any():
        at = int(np.argmax(turned - twisted)) + 1
        raise Fault(f"the heading jumps by {turned[at - 1]:.2f} rad at row {at + 1}")
    same = (way == 0.0) & (turned == 0.0) & (fastest[1:] > MOVING)
    longest = np.diff(np.flatnonzero(np.concatenate([[True], ~same, [True]]))).max() - 1
    if longest > 0.3 * len(way):
        raise Fault(f"the pose is the same in {longest} rows on end while the belts run")
