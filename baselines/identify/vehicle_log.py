"""Whether the columns of a log are of one vehicle in one set of units and signs.

A gyro says how far the heading turned, belts how far the vehicle went: where the two differ by a
factor that a unit or a gear explains, the log is refused and the factor named.

A log of a vehicle as the columns of a CSV file: which there are, and what is done to them.

`read_log` brings the columns to SI units at the sprocket, checks that they agree with each other,
and places the samples on a grid of steps of one length, as the estimators take them:
    pose      x, y, yaw, v_x, v_y                  may be rarer than the rest, NaN or held between
    inertial  accelerations, yaw rate, roll, pitch
    drive     sprocket speeds and torques
What is not measured is derived where that can be: accelerations from velocities and gyro by local
straight lines (`slopes`), over which torques and accelerations that are measured are then averaged
with the same weights, so that force and acceleration are of the same moments. Derived quantities
have the noise that follows, and one sample a stretch.
"""

import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.identify.csv_log import (
    UNITS,
    Column,
    Floats,
    check_speeds,
    in_order,
    middle_step,
    on_grid,
    read,
)
from baselines.identify.torque_checks import check_frozen, check_torques
from tracked_env.physics.parameters import PlantParameters
from tracked_env.sensors import CHANNELS, GROUP_START, GROUPS, UNMEASURED, Sensors

STRETCH = 0.5  # [s] over which ways and turns are compared
TURNING = 0.05  # [rad/s] mean yaw rate from which on turns are compared
MOVING = 0.1  # [m/s] likewise of the speed
SLIPPED = (0.75, 2.5)  # [-] belts over ground, in the median: braked and nearly spinning
TWISTED = 1.4  # [-] yaw rate over that of belts without slip: no vehicle turns faster than those
AGREED = 0.8  # [-] length of the mean direction between heading and course
OFF_COURSE = 0.35  # [rad] between heading and course on the straight
LAGS = 5.0, 0.3  # [s] delays of the heading that are tried, and the largest that is accepted
SAME = 2.5  # [-] factor within which two measurements of one quantity agree
CLEAR = 0.1  # [m/s^2], [rad/s^2] standard deviation from which on accelerations are compared
SPINNING = 1.6  # [-] belts over ground that a fifth of the straight driving stays below
TURNED = (0.6, 1.6)  # [-] heading over gyro
DEGREES = 180.0 / math.pi


def unwrapped(yaw: Floats, time: Floats, yaw_rate: Floats, path: Path) -> Floats:
    """The heading without jumps by full turns. Raises ValueError where it is in degrees."""
    known = np.isfinite(yaw)
    rows = np.flatnonzero(known)
    if len(rows) < 2:
        raise ValueError(f"{path}: yaw has {len(rows)} numbers; must have two or more")
    turned = np.diff(np.interp(time[rows], time, _integral(time, yaw_rate)))

    def mismatch(factor: float) -> float:
        change = (factor * np.diff(yaw[rows]) + math.pi) % (2.0 * math.pi) - math.pi
        return float(np.median(np.abs(change - turned)) / max(np.median(np.abs(turned)), 1e-6))

    spread = float(np.ptp(yaw[known]))
    if spread > 2.0 * math.pi + 0.5 and mismatch(1.0 / DEGREES) < 0.3 * mismatch(1.0):
        raise ValueError(
            f"{path}: yaw covers {spread:.4g} rad and turns {DEGREES:.3g} times as far as yaw_rate "
            "says. Is it in deg? Then --units yaw=deg"
        )
    result = np.full(len(yaw), math.nan)
    result[rows] = np.unwrap(yaw[rows])
    return result


def _integral(time: Floats, rate: Floats) -> Floats:
    """Integral of a rate over time, zero first; missing values count as 0."""
    known = np.nan_to_num(rate)
    steps = np.minimum(np.diff(time), STRETCH)  # nothing is known of a longer gap
    return np.concatenate([[0.0], np.cumsum(0.5 * (known[1:] + known[:-1]) * steps)])


def check_agreement(values: dict[str, Floats], vehicle: PlantParameters, path: Path) -> None:
    """Raise ValueError where columns contradict each other; adds `belts`, their mean speed."""
    time = values["time"]
    left, right = values["sprocket_speed_left"], values["sprocket_speed_right"]
    belts = 0.5 * vehicle.sprocket_radius * (left + right)
    values["belts"] = belts
    marks = np.arange(time[0], time[-1], STRETCH)
    if len(marks) < 4:
        return
    _check_sides(values, (right - left) * vehicle.sprocket_radius / vehicle.track_gauge, path)
    rows = np.flatnonzero(np.isfinite(values["x"] + values["y"] + values["yaw"]))
    if len(rows) < 2:
        raise ValueError(f"{path}: x, y and yaw have fewer than two common rows; must have more")
    x, y, yaw = (np.interp(marks, time[rows], values[name][rows]) for name in ("x", "y", "yaw"))
    way = np.hypot(np.diff(x), np.diff(y)) / STRETCH
    turn = np.diff(yaw) / STRETCH
    gyro = np.diff(np.interp(marks, time, _integral(time, values["yaw_rate"]))) / STRETCH
    driven = np.diff(np.interp(marks, time, _integral(time, belts))) / STRETCH
    _check_lag("yaw", "yaw_rate", time[rows], values["yaw"][rows], time, values["yaw_rate"], path)
    _check_turns(turn, gyro, path)
    twist = (right - left) * vehicle.sprocket_radius / vehicle.track_gauge
    belt_turn = np.diff(np.interp(marks, time, _integral(time, twist))) / STRETCH
    turning = np.abs(gyro) > TURNING
    if turning.sum() >= 4 and np.sum(belt_turn[turning] * gyro[turning]) < 0.0:
        raise ValueError(
            f"{path}: where the right sprocket is faster, yaw_rate is negative; must be positive. "
            "Are left and right swapped, or are heading and yaw_rate positive to the right?"
        )
    _check_signs([right, left], [x, y, yaw, gyro], marks, time, vehicle, path)
    if turning.sum() >= 4:
        _check_twist(float(np.sum(gyro[turning] ** 2) / np.sum((belt_turn * gyro)[turning])), path)
    straight = np.abs(turn) < 0.3 * way / vehicle.track_gauge
    moving = (way > MOVING) & (np.abs(driven) > MOVING) & straight
    if moving.sum() >= 4:
        middle, course = 0.5 * (yaw[1:] + yaw[:-1]), np.arctan2(np.diff(y), np.diff(x))
        _check_course(middle[moving], course[moving], driven[moving], path)
        gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff([x, y])))])
        _check_lag("x, y", "the sprockets", marks, gone, time, np.abs(belts), path)
        ratios = np.abs(driven[moving]) / way[moving]
        _check_way(float(np.median(ratios)), float(np.percentile(ratios, 20.0)), path)
        if "v_x" in values:
            speed = np.diff(np.interp(marks, time, _integral(time, values["v_x"]))) / STRETCH
            _check_speed(float(np.median(np.abs(speed[moving]) / way[moving])), path)
    elif np.median(np.abs(driven)) > 10.0 * max(MOVING, float(np.median(way))):
        ratio = float(np.median(np.abs(driven)) / max(np.median(way), 1e-6))
        _check_way(ratio, ratio, path)
    if "v_y" in values and np.isfinite(values["v_y"]).any():
        known = np.isfinite(values["v_y"])
        _check_drift([x, y, yaw], np.interp(marks, time[known], values["v_y"][known]), path)


def _check_signs(
    sprockets: list[Floats], pose: list[Floats], marks: Floats, time: Floats,
    vehicle: PlantParameters, path: Path,
) -> None:  # fmt: skip
    """Raise ValueError where one sprocket turns against its track; right and left."""
    x, y, yaw, gyro = pose
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    forward = (np.cos(middle) * np.diff(x) + np.sin(middle) * np.diff(y)) / STRETCH
    wrong = []
    for side, speed, turn in zip(("right", "left"), sprockets, (0.5, -0.5), strict=True):
        belt = np.diff(np.interp(marks, time, _integral(time, speed))) / STRETCH
        track = forward + turn * vehicle.track_gauge * gyro
        spread = float(np.linalg.norm(belt) * np.linalg.norm(track))
        if spread > 0.0 and float(belt @ track) < -0.5 * spread:
            wrong.append(side)
    if len(wrong) == 1:
        raise ValueError(
            f"{path}: sprocket_speed_{wrong[0]} is negative where its track goes forward; must be "
            "positive on both sides. Is that motor mounted the other way round?"
        )


def _check_drift(pose: list[Floats], v_y: Floats, path: Path) -> None:
    """Raise ValueError where v_y has the sign opposite to the way of the pose to the left."""
    x, y, yaw = pose
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    drift = (np.cos(middle) * np.diff(y) - np.sin(middle) * np.diff(x)) / STRETCH
    stated = 0.5 * (v_y[1:] + v_y[:-1])
    spread = float(np.linalg.norm(drift) * np.linalg.norm(stated))
    if len(drift) >= 20 and spread > 0.0 and float(drift @ stated) < -0.4 * spread:
        raise ValueError(
            f"{path}: v_y is negative where x, y go to the left of yaw; must be positive to the "
            "left, in the axes of the vehicle"
        )


def _check_twist(ratio: float, path: Path) -> None:
    """Yaw rate over that which the belts would give without slip."""
    if ratio <= TWISTED:
        return
    cause = "are yaw and yaw_rate in deg (--units yaw=deg,yaw_rate=deg/s), or "
    raise ValueError(
        f"{path}: the vehicle turns {ratio:.3g} times as fast as its belts say; must be "
        f"{TWISTED:g} or less, and slip makes it less than 1. "
        f"{(cause if 30.0 < ratio < 90.0 else '').capitalize()}"
        f"{'is' if 30.0 < ratio < 90.0 else 'Is'} the track_gauge of --vehicle too large, its "
        "sprocket_radius too small, or the sprocket speed in another unit?"
    )


def _check_course(yaw: Floats, course: Floats, driven: Floats, path: Path) -> None:
    """Heading and course (K,) [rad] of straight driving, by the way of the belts (K,) [m/s]."""
    ahead = course + np.where(driven < 0.0, math.pi, 0.0)
    same, mirrored = (complex(np.mean(np.exp(1j * (ahead - k * yaw)))) for k in (1.0, -1.0))
    off = math.atan2(same.imag, same.real)
    if abs(same) > AGREED and abs(off) <= OFF_COURSE:
        return
    if abs(same) <= AGREED:
        cause = "Do x, y and yaw belong together, or does the heading come late?"
        if abs(mirrored) > 0.8:
            cause = (
                "They are mirrored: is the heading positive to the right, as that of a compass, or "
                "are x and y swapped? y must be x turned to the left"
            )
        raise ValueError(
            f"{path}: straight ahead the course of x, y does not go with yaw, not even with a "
            f"constant angle between them (they agree by {abs(same):.2f}; must be {AGREED} or "
            f"more). {cause}"
        )
    cause = "Is yaw counted from another axis than x?"
    if abs(off) > math.pi - OFF_COURSE:
        cause = "Are sprocket speeds negative where the vehicle drives forward, or yaw turned?"
    raise ValueError(
        f"{path}: straight ahead the course of x, y is {math.degrees(off):.0f} deg from yaw; must "
        f"be within {math.degrees(OFF_COURSE):.0f} deg. {cause}"
    )


def _check_lag(
    name: str, other: str, at: Floats, way: Floats, time: Floats, rate: Floats, path: Path
) -> None:
    """Raise ValueError where a way or heading, at the times `at`, comes long before or after its
    rate."""
    step = 0.05
    marks = np.arange(max(at[0], time[0]), min(at[-1], time[-1]), step)
    shifts = round(LAGS[0] / step)
    if len(marks) < 4 * shifts:
        return
    wide = round(STRETCH / step)
    covered = np.interp(marks, at, way)
    expected = np.interp(marks, time, _integral(time, rate))
    a, b = (of[wide:] - of[:-wide] for of in (covered, expected))
    if float(np.std(b)) < TURNING * STRETCH:
        return
    inner = b[shifts:-shifts]

    def mismatch(shift: int) -> float:
        return float(np.mean((a[shifts + shift : len(a) - shifts + shift] - inner) ** 2))

    rest = [mismatch(k) for k in range(-shifts, shifts + 1)]
    best = int(np.argmin(rest)) - shifts
    clear = min(rest) < 0.2 * min(rest[shifts], float(np.var(inner)))
    if clear and LAGS[1] < abs(best) * step < LAGS[0]:
        late = best * step
        raise ValueError(
            f"{path}: {name} comes {abs(late):.2g} s {'after' if late > 0 else 'before'} {other}; "
            f"must be within {LAGS[1]:g} s. Does the pose have a delay? Shift x, y, yaw (and v_x, "
            f"v_y of the same device) by {-late:.2g} s in the file"
        )


def check_accelerations(values: dict[str, Floats], period: float, path: Path) -> None:
    """Raise ValueError where accelerations contradict the speeds of belts, hull and gyro.

    values: of a grid of steps of `period` [s]; those that are not measured are left out.
    """
    samples = max(round(STRETCH / period), 1)
    count = len(values["belts"]) // samples

    def means(column: Floats) -> Floats:
        return np.asarray(np.nanmean(column[: count * samples].reshape(count, samples), axis=1))

    speed = values.get("v_x", values["belts"])
    if count < 10 or np.isfinite(speed).mean() < 0.5:
        speed = values["belts"]
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # stretches without a number
        rate, forward = means(values["yaw_rate"]), means(speed)

        def change(of: Floats) -> Floats:  # of means: the slope over both neighbours
            return np.asarray((of[2:] - of[:-2]) / (2.0 * samples * period))

        slow = np.array([0.25, 0.5, 0.25])  # what such a slope averages
        expected = {
            "acceleration_x": change(forward), "acceleration_y": (rate * forward)[1:-1],
            "yaw_acceleration": change(rate),
        }  # fmt: skip
        for name, other in expected.items():
            if name not in values or count < 10:
                continue
            felt = means(values[name])
            felt = felt[1:-1] if name == "acceleration_y" else np.convolve(felt, slow, "valid")
            use = np.isfinite(felt + other)
            if use.sum() >= 10:
                _check_same(name, felt[use], other[use], path)


def _check_same(name: str, felt: Floats, other: Floats, path: Path) -> None:
    """One acceleration against what speeds say of it, (K,) each."""
    unit = "rad/s^2" if name == "yaw_acceleration" else "m/s^2"
    mean = float(np.median(felt))
    if abs(mean) > 5.0 and unit == "m/s^2":
        raise ValueError(
            f"{path}: {name} is {mean:.3g} m/s^2 in the median; must be near 0. Is it the vertical "
            "axis, which feels gravity?"
        )
    if float(np.std(other)) < CLEAR:
        return
    felt, other = felt - felt.mean(), other - other.mean()
    ratio = float(felt @ other / (other @ other))
    # Gravity on slopes comes on top: then the ratio is as uncertain as that makes it.
    doubt = 4.0 * float(np.std(felt - ratio * other) / np.std(other)) / math.sqrt(0.5 * len(felt))
    if 1.0 / SAME - doubt <= ratio <= SAME + doubt:
        return
    axis = {"acceleration_x": "forward", "acceleration_y": "to the left"}.get(name, "to the left")
    cause = f"Must be positive {axis}" if ratio < 0.0 else "Is it another column?"
    units = [u for u, of in UNITS[unit].items() if of != 1.0 and 0.5 < ratio * of < 2.0]
    if units:
        cause = f"Is it in {units[0]}? Then --units {name}={units[0]}"
    raise ValueError(
        f"{path}: {name} is {ratio:.3g} times that of the speeds; must be in [{1.0 / SAME:g}, "
        f"{SAME:g}]. {cause}"
    )


def _check_sides(values: dict[str, Floats], twist: Floats, path: Path) -> None:
    """Raise ValueError where a column does not change while the vehicle turns, or stands for both
    sides; twist (T,) [rad/s] of the belts."""
    if max(float(np.nanstd(values["yaw_rate"])), float(np.nanstd(twist))) < TURNING:
        return
    for name in ("x", "y", "yaw", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right"):
        column = values[name][np.isfinite(values[name])]
        if len(column) and float(np.ptp(column)) == 0.0:
            raise ValueError(
                f"{path}: {name} is {column[0]:.6g} in every row, while the vehicle turns; must "
                "change. Did the sensor stop, or is it another column?"
            )
    for name in ("sprocket_speed", "torque"):
        left, right = values[f"{name}_left"], values[f"{name}_right"]
        if np.array_equal(left, right, equal_nan=True):
            raise ValueError(
                f"{path}: {name}_left and {name}_right are the same in every row, while the "
                "vehicle turns; must differ. Is one column mapped twice?"
            )


def _check_turns(turn: Floats, gyro: Floats, path: Path) -> None:
    """Heading against gyro, (K,) [rad/s] each."""
    turning = np.abs(gyro) > TURNING
    if turning.sum() < 4:
        return
    ratio = float(np.sum(turn[turning] * gyro[turning]) / np.sum(gyro[turning] ** 2))
    if TURNED[0] <= ratio <= TURNED[1]:
        return
    cause = "Are they of the same log?"
    if -TURNED[1] <= ratio <= -TURNED[0]:
        cause = "One of them is positive to the right: both must be positive to the left."
    elif 0.7 < ratio * DEGREES < 1.4:
        cause = "Is yaw_rate in deg/s? Then --units yaw_rate=deg/s"
    elif 0.7 < ratio / DEGREES < 1.4:
        cause = "Is yaw in deg? Then --units yaw=deg"
    raise ValueError(
        f"{path}: yaw turns {ratio:.3g} times as far as yaw_rate says; must be in "
        f"[{TURNED[0]}, {TURNED[1]}]. {cause}"
    )


def _check_way(ratio: float, least: float, path: Path) -> None:
    """Belts over ground on the straight: the median, and what a fifth of it stays below."""
    if SLIPPED[0] <= ratio <= SLIPPED[1] and least <= SPINNING:
        return
    causes = {f"sprocket_speed={unit}": 1.0 / of for unit, of in UNITS["rad/s"].items() if of != 1}
    causes |= {f"x={unit},y={unit}": of for unit, of in UNITS["m"].items() if of != 1}
    likely = [text for text, of in causes.items() if 0.7 < ratio / of < 1.4]
    advice = f"Does --units {likely[0]} explain it" if likely else "Is it the motor's speed"
    raise ValueError(
        f"{path}: on the straight the belts run {ratio:.3g} times as far as the vehicle; must be "
        f"in [{SLIPPED[0]}, {SLIPPED[1]}], and at times below {SPINNING}. {advice}, or --gear "
        f"{ratio:.3g}, or another sprocket_radius of --vehicle?"
    )


def _check_speed(ratio: float, path: Path) -> None:
    """v_x over the speed of the position."""
    if not TURNED[0] <= ratio <= TURNED[1]:
        likely = [u for u, f in UNITS["m/s"].items() if f != 1.0 and 0.7 < ratio * f < 1.4]
        advice = f"Is it in {likely[0]}? Then --units v_x={likely[0]}" if likely else "Whose is it?"
        raise ValueError(
            f"{path}: v_x is {ratio:.3g} times the speed of x, y; must be in "
            f"[{TURNED[0]}, {TURNED[1]}]. {advice}"
        )


COLUMNS = (
    Column("time", "s", 1e10, "rising"),
    Column("x", "m", 1e8, "position, any fixed frame", others=("pos_x", "east")),
    Column("y", "m", 1e8, "position, x turned to the left", others=("pos_y", "north")),
    Column("yaw", "rad", 1e4, "heading from x to the left, wrapped or not", others=("heading",)),
    Column("yaw_rate", "rad/s", 20.0, "gyro, positive to the left", others=("wz", "gyro_z")),
    Column("sprocket_speed_left", "rad/s", 200.0, "or that of the motor, with --gear",
           others=("omega_l", "motor_speed_left")),
    Column("sprocket_speed_right", "rad/s", 200.0, "the same of the right sprocket",
           others=("omega_r", "motor_speed_right")),
    Column("torque_left", "N m", 1e5, "or currents; of the motor with --gear", False),
    Column("torque_right", "N m", 1e5, "the same of the right side", False),
    Column("current_left", "A", 1e4, "of the motor, with --torque-per-ampere", False),
    Column("current_right", "A", 1e4, "the same of the right motor", False),
    Column("v_x", "m/s", 40.0, "forward velocity of the hull", False, ("vx", "speed")),
    Column("v_y", "m/s", 40.0, "velocity to the left", False, ("vy",)),
    Column("acceleration_x", "m/s^2", 100.0, "forward accelerometer", False, ("ax", "accel_x")),
    Column("acceleration_y", "m/s^2", 100.0, "lateral accelerometer, to the left", False,
           ("ay", "accel_y")),
    Column("yaw_acceleration", "rad/s^2", 400.0, "of two accelerometers", False),
    Column("roll", "rad", 2.0, "left side up; with pitch: the ground is no plane", False),
    Column("pitch", "rad", 2.0, "nose down", False),
)  # fmt: skip
DRIVE_PAIRS = ("sprocket_speed", "torque", "current")
WINDOW = 0.1  # [s] of the straight lines whose slopes are accelerations
TORQUES = ("torque_left", "torque_right")
FAULTS = 5  # lines of the file that are named


class Drivetrain(NamedTuple):
    """From what was logged to the sprocket."""

    gear: float = 1.0  # [-] motor speed over sprocket speed; 1: the log is of the sprocket
    torque_per_ampere: float = 0.0  # [N m/A] of the motor; 0: torques are logged
    efficiency: float = 1.0  # [-] of the gear


class Log(NamedTuple):
    """Samples on a grid of T steps."""

    period: float  # [s]
    time: Floats  # (T,) [s] from the first step on
    # (T,) by channel, SI, the latest sample, NaN where it has none; raw_torque_*: not averaged
    values: dict[str, Floats]
    fresh: NDArray[np.bool_]  # (T, 3) whether pose, inertial, drive have a new sample
    age: Floats  # (T, 3) [s] of the latest sample of each group
    sensors: Sensors  # with the noise of derived channels
    attitude: bool  # whether roll and pitch are there
    averaged: bool  # whether torques were averaged
    notes: list[str]  # what was done, one sentence each
    faults: list[str]  # what is wrong in the file, and doubts, one sentence each


def slopes(values: Floats, period: float, samples: int) -> Floats:
    """Slopes (T,) [1/s] of straight lines through `samples` neighbours, an odd number; NaN at both
    ends, where neighbours are missing."""
    half = samples // 2
    weights = np.arange(half, -half - 1, -1) / (period * np.sum(np.arange(-half, half + 1) ** 2))
    return np.pad(np.convolve(values, weights, mode="valid"), half, constant_values=math.nan)


def averages(values: Floats, samples: int) -> Floats:
    """Means (T,) with the weights by which a slope averages the derivative: a parabola."""
    half = samples // 2
    weights = np.array([half * (half + 1) - k * (k + 1) for k in range(-half, half)], dtype=float)
    # The derivative between two samples is the mean over both.
    both = np.convolve(weights / weights.sum(), [0.5, 0.5])
    return np.pad(np.convolve(values, both, mode="valid"), half, constant_values=math.nan)


def read_log(
    path: Path,
    mapping: Mapping[str, str],
    units: Mapping[str, str],
    drivetrain: Drivetrain,
    vehicle: PlantParameters,
    sensors: Sensors,
) -> Log:
    """A log from a CSV file. Raises ValueError for what makes no sense."""
    # Of a motor, speeds may be as large as the gear makes them.
    wider = tuple(
        c._replace(largest=c.largest * drivetrain.gear) if c.name.startswith("sprocket_speed")
        else c for c in COLUMNS
    )  # fmt: skip
    table = read(path, wider, mapping, units)
    notes = [f"Read: {table.said}."]
    values = _at_the_sprocket(table.values, drivetrain, path, notes)
    values, dropped = in_order(values, path)
    faults = [(table.truncated, "truncated lines"), (table.unreadable, "cells that are no numbers"),
              (dropped, "rows whose time does not rise, which were left out")]  # fmt: skip
    said = [f"{count} {what}." for count, what in faults if count]
    said += table.faults[:FAULTS]
    step = middle_step(values["time"], path)
    for side in ("left", "right"):
        check_frozen(values[f"torque_{side}"], side, step, path)
    speeds = [values[f"sprocket_speed_{side}"] for side in ("left", "right")]
    check_speeds(np.concatenate(speeds), vehicle, path)
    values["yaw"] = unwrapped(values["yaw"], values["time"], values["yaw_rate"], path)
    check_agreement(values, vehicle, path)
    period, grid, seen = on_grid(values, path, notes)
    check_accelerations(grid, period, path)
    log = _complete(period, grid, seen, sensors, notes)
    # Torques and accelerations of the same moments, before the first of either is repeated.
    said += check_torques(log.values, period, vehicle, path)
    return log._replace(notes=[*notes, *said], faults=said)


def _at_the_sprocket(
    given: dict[str, Floats], drivetrain: Drivetrain, path: Path, notes: list[str]
) -> dict[str, Floats]:
    """Speeds and torques of the sprockets. Raises ValueError where there are no torques."""
    values = dict(given)
    if drivetrain.gear != 1.0:
        for side in ("left", "right"):
            values[f"sprocket_speed_{side}"] = values[f"sprocket_speed_{side}"] / drivetrain.gear
        notes.append(
            f"Speeds and torques of the motors became those of the sprockets by the gear "
            f"{drivetrain.gear:g}, with an efficiency of {drivetrain.efficiency:g}."
        )
    ratio = drivetrain.gear * drivetrain.efficiency
    for side in ("left", "right"):
        torque, current = values.get(f"torque_{side}"), values.pop(f"current_{side}", None)
        if torque is None and current is not None:
            if drivetrain.torque_per_ampere <= 0.0:
                raise ValueError(
                    f"{path} has currents and no torques; needs --torque-per-ampere, the torque "
                    "constant of the motor in N m/A, and --gear"
                )
            torque = drivetrain.torque_per_ampere * current
        if torque is None:
            raise ValueError(
                f"{path} lacks torque_{side}, and current_{side} in its place. Mass, inertia and "
                "resistance are what torques make of the motion; without them there is slip alone: "
                "`tracked-env slip`. Map a column with --columns torque_left=NAME"
            )
        values[f"torque_{side}"] = ratio * torque
    return values


def _held(columns: list[Floats], seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where a group has a new sample: all columns finite, and not just those of before."""
    finite = np.all([np.isfinite(column) for column in columns], axis=0)
    places = np.flatnonzero(finite)
    same = np.all([np.diff(column[places]) == 0.0 for column in columns], axis=0)
    new = finite & seen
    new[places[1:][same]] = False
    return new


def _complete(
    period: float, grid: dict[str, Floats], seen: NDArray[np.bool_], sensors: Sensors,
    notes: list[str],
) -> Log:  # fmt: skip
    """The log with derived channels, freshness and ages."""
    values = dict(grid)
    changes: dict[str, Any] = {}
    filled = {name: _filled(column) for name, column in grid.items()}
    w, v_x, v_y = filled["yaw_rate"], filled.get("v_x"), filled.get("v_y")
    derived = [name for name in ("acceleration_x", "yaw_acceleration") if name not in grid]
    half = max(round(0.5 * WINDOW / period), 1)
    samples = 2 * half + 1
    spread = 1.0 / (period * math.sqrt(sum(k * k for k in range(-half, half + 1))))
    if not {"v_x", "v_y"} <= grid.keys():
        changes["velocity_noise"] = UNMEASURED
        notes.append("Not both velocities of the hull are there: they are found from the pose.")
    if "acceleration_x" in derived:
        if v_x is None:
            raise ValueError("the log has neither acceleration_x nor v_x; must have one of them")
        values["acceleration_x"] = slopes(v_x, period, samples) - (0.0 if v_y is None else w * v_y)
        changes["acceleration_noise"] = sensors.velocity_noise * spread
        changes["acceleration_bias"] = 0.0
    if "acceleration_y" not in grid:
        forward = filled["belts"] if v_x is None else v_x
        drift = 0.0 if v_y is None else slopes(v_y, period, samples)
        values["acceleration_y"] = w * forward + drift
        notes.append("acceleration_y is yaw_rate times the forward speed.")
    if "yaw_acceleration" in derived:
        values["yaw_acceleration"] = slopes(w, period, samples)
        bend = max(sensors.gyro_noise * spread, 1e-6)
        # The data sheet states it by the distance of two accelerometers.
        noise = changes.get("acceleration_noise", sensors.acceleration_noise)
        changes["accelerometer_distance"] = min(max(math.sqrt(2.0) * noise / bend, 1e-2), 1e4)
    raw = {name: grid[name] for name in TORQUES}
    if derived:
        notes.append(f"{' and '.join(derived)}: slopes of straight lines over {samples} steps.")
        averaged = [n for n in (*TORQUES, "acceleration_x", "acceleration_y") if n in grid]
        weights = averages(np.eye(2 * samples)[samples], samples)
        changes["torque_noise"] = sensors.torque_noise * float(np.sqrt(np.nansum(weights**2)))
        for name in averaged:  # all that a force and an acceleration are compared with
            found = averages(filled[name], samples)
            values[name] = np.where(np.isfinite(grid[name]), found, math.nan)
    attitude = {"roll", "pitch"} <= grid.keys()
    if attitude:
        values["pitch_rate"] = slopes(filled["pitch"], period, samples)
    inertial = seen & np.isfinite(values["yaw_rate"] + values["acceleration_x"])
    if derived:  # slopes of one stretch each, so that their errors are independent
        inertial &= np.arange(len(seen)) % samples == 0
    drive = [values[f"{name}_{side}"] for name in DRIVE_PAIRS[:2] for side in ("left", "right")]
    fresh = {
        "pose": _held([grid["x"], grid["y"], grid["yaw"]], seen), "inertial": inertial,
        "drive": seen & np.all(np.isfinite(drive), axis=0),
    }  # fmt: skip
    values |= {f"raw_{name}": column for name, column in raw.items()}
    stated = sensors._replace(**changes)
    return _latest(period, values, fresh, stated, attitude, bool(derived), notes)


def _filled(column: Floats) -> Floats:
    """A column without gaps, for slopes: what is missing lies between its neighbours."""
    known = np.flatnonzero(np.isfinite(column))
    if not len(known):
        raise ValueError("a column of the log has no number at all; leave it out or map another")
    return np.interp(np.arange(len(column)), known, column[known])


def _latest(
    period: float, values: dict[str, Floats], fresh: dict[str, Any], sensors: Sensors,
    attitude: bool, averaged: bool, notes: list[str],
) -> Log:  # fmt: skip
    """Each group at its latest sample, from the step on at which all have one."""
    steps = np.arange(len(fresh["pose"]))
    last = {g: np.maximum.accumulate(np.where(fresh[g], steps, -1)) for g in GROUPS}
    begun = np.min([last[g] for g in GROUPS], axis=0) >= 0
    if not begun.any():
        raise ValueError("the log has no moment from which on pose, gyro and drives are all known")
    first = int(np.argmax(begun))
    held = {}
    for number, group in enumerate(GROUPS):
        names = CHANNELS[GROUP_START[number] : GROUP_START[number + 1]]
        extra: tuple[str, ...] = ()
        if group == "inertial" and attitude:
            extra = ("roll", "pitch", "pitch_rate")
        elif group == "drive":
            extra = tuple(f"raw_{name}" for name in TORQUES)
        for name in (*names, *extra):
            column = values.get(name, np.full(len(steps), math.nan))
            held[name] = column[np.maximum(last[group], 0)][first:]
    age = np.empty((len(steps), len(GROUPS)))
    for number, group in enumerate(GROUPS):
        age[:, number] = period * (steps - last[group])
    age = age[first:]
    new = np.stack([fresh[g] for g in GROUPS], axis=1)[first:]
    shares = " ".join(
        f"{g} {share:.0%}," for g, share in zip(GROUPS, new.mean(axis=0), strict=True)
    )
    notes.append(f"Steps with a new sample: {shares[:-1]}.")
    time = np.arange(len(age), dtype=np.float64) * period
    return Log(period, time, held, new, age, sensors, attitude, averaged, notes, [])
