"""A log of a vehicle as the columns of a CSV file: which there are, and what is done to them.

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
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.identify.csv_log import (
    Column,
    Columns,
    Floats,
    check_speeds,
    errors_of,
    read,
    unit_advice,
)
from baselines.identify.log_checks import SIDES, check_accelerations, check_agreement, unwrapped
from baselines.identify.log_torques import check_frozen, check_torques
from tracked_env.physics.parameters import PlantParameters
from tracked_env.sensors import CHANNELS, GROUP_START, GROUPS, UNMEASURED, Sensors

COLUMNS = (
    Column("time", "s", 1e10, "rising"),
    Column("x", "m", 1e8, "position, any fixed frame", synonyms="pos_x east"),
    Column("y", "m", 1e8, "position, x turned to the left", synonyms="pos_y north"),
    Column("yaw", "rad", 1e4, "heading from x to the left, wrapped or not", synonyms="heading"),
    Column("yaw_rate", "rad/s", 20.0, "gyro, positive to the left", synonyms="wz gyro_z"),
    Column("sprocket_speed_left", "rad/s", 200.0, "or motor", True, "omega_l motor_speed_left"),
    Column("sprocket_speed_right", "rad/s", 200.0, "or motor", True, "omega_r motor_speed_right"),
    Column("torque_left", "N m", 1e5, "or currents; of the motor with --gear", False),
    Column("torque_right", "N m", 1e5, "the same of the right side", False),
    Column("current_left", "A", 1e4, "of the motor, with --torque-per-ampere", False),
    Column("current_right", "A", 1e4, "the same of the right motor", False),
    Column("v_x", "m/s", 40.0, "forward velocity of the hull", False, "vx speed"),
    Column("v_y", "m/s", 40.0, "velocity to the left", False, "vy"),
    Column("acceleration_x", "m/s^2", 100.0, "forward accelerometer", False, "ax accel_x"),
    Column("acceleration_y", "m/s^2", 100.0, "accelerometer to the left", False, "ay accel_y"),
    Column("yaw_acceleration", "rad/s^2", 400.0, "of two accelerometers", False),
    Column("roll", "rad", 2.0, "left side up; with pitch: the ground is no plane", False),
    Column("pitch", "rad", 2.0, "nose down", False),
)
TORQUES = ("torque_left", "torque_right")
RAW_TORQUES = ("raw_torque_left", "raw_torque_right")  # not averaged
WINDOW = 0.1  # [s] of the straight lines whose slopes are accelerations
FAULTS = 5  # lines of the file that are named
EVEN = 0.1  # [-] of a step: farther off the grid in more than one row of a hundred is uneven
STEPS = (1e-3, 0.2)  # [s] of a log
LEAST = 5.0  # [s] a log lasts at least
LOST = 0.1  # [-] share of rows with a wrong time that is too much
JUMP = 60.0  # [s] between two rows: a longer one is no gap of a log, but another clock


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
    values: Columns
    fresh: NDArray[np.bool_]  # (T, 3) whether pose, inertial, drive have a new sample
    age: Floats  # (T, 3) [s] of the latest sample of each group
    sensors: Sensors  # with the noise of derived channels
    attitude: bool  # whether roll and pitch are there
    averaged: bool  # whether torques were averaged
    notes: list[str]  # what was done, one sentence each
    faults: list[str]  # what is wrong in the file, and doubts, one sentence each


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
    wider = [
        c._replace(largest=c.largest * drivetrain.gear) if "sprocket_speed" in c.name else c
        for c in COLUMNS
    ]
    with errors_of(path):
        table = read(path, wider, mapping, units)
        notes = [f"Read: {table.summary}."]
        values, dropped = _in_order(_at_the_sprocket(table.values, drivetrain, notes))
        counts = {
            "truncated lines": table.truncated,
            "cells that are no numbers": table.unreadable,
            "rows whose time does not rise, which were left out": dropped,
        }
        faults = [f"{count} {what}." for what, count in counts.items() if count]
        faults += table.faults[:FAULTS]
        step = _middle_step(values["time"])
        for side in SIDES:
            check_frozen(values[f"torque_{side}"], side, step)
        check_speeds([values[f"sprocket_speed_{side}"] for side in SIDES], vehicle)
        values["yaw"] = unwrapped(values["yaw"], values["time"], values["yaw_rate"])
        check_agreement(values, vehicle)
        period, grid, present = _on_grid(values, step, notes)
        check_accelerations(grid, period)
        log = _complete(period, grid, present, sensors, notes)
        # Torques and accelerations of the same moments, before the first of either is repeated.
        faults += check_torques(log.values, period, vehicle)
    return log._replace(notes=[*notes, *faults], faults=faults)


def _at_the_sprocket(columns: Columns, drivetrain: Drivetrain, notes: list[str]) -> Columns:
    """Speeds and torques of the sprockets. Raises ValueError where there are no torques."""
    values, (gear, per_ampere, efficiency) = dict(columns), drivetrain
    if gear != 1.0:
        notes.append(
            "Speeds and torques of the motors became those of the sprockets by the gear "
            f"{gear:g}, with an efficiency of {efficiency:g}."
        )
    for side in SIDES:
        if gear != 1.0:
            values[f"sprocket_speed_{side}"] = values[f"sprocket_speed_{side}"] / gear
        torque, current = values.get(f"torque_{side}"), values.pop(f"current_{side}", None)
        if torque is None and current is not None:
            if per_ampere <= 0.0:
                raise ValueError(
                    "the log has currents and no torques; needs --torque-per-ampere, the torque "
                    "constant of the motor in N m/A, and --gear"
                )
            torque = per_ampere * current
        if torque is None:
            raise ValueError(
                f"the log lacks torque_{side}, and current_{side} in its place. Mass, inertia and "
                "resistance are what torques make of the motion; without them there is slip alone: "
                "`tracked-env slip`. Map a column with --columns torque_left=NAME"
            )
        values[f"torque_{side}"] = gear * efficiency * torque
    return values


# --- the rows on a grid ---------------------------------------------------------------------


def _in_order(values: Columns) -> tuple[Columns, int]:
    """Rows whose time rises, and how many were left out."""
    time = values["time"]
    stamped = np.isfinite(time)
    latest = np.maximum.accumulate(np.where(stamped, time, -math.inf))
    late = time > np.concatenate([[-math.inf], latest[:-1]])
    # One row ahead of all others would leave out the others: then it is that row.
    earliest = np.minimum.accumulate(np.where(stamped, time, math.inf)[::-1])[::-1]
    early = time < np.concatenate([earliest[1:], [math.inf]])
    rows = np.flatnonzero(stamped & (late if late.sum() >= early.sum() else early))
    dropped = len(time) - len(rows)
    if dropped > LOST * len(time):
        raise ValueError(
            f"in {dropped} of {len(time)} rows the time does not rise; must be less than "
            f"{LOST:.0%}. Are several logs in one file, or is `time` another column?"
        )
    gaps = np.diff(time[rows])
    if len(gaps) and (longest := float(gaps.max())) > JUMP:
        at = int(np.argmax(gaps))
        raise ValueError(
            f"the clock jumps by {longest:.4g} s between the rows {rows[at] + 1} and "
            f"{rows[at + 1] + 1}; must be {JUMP:g} s or less. Was the clock set while logging? "
            "Then cut the log there"
        )
    return {name: column[rows] for name, column in values.items()}, dropped


def _middle_step(time: Floats) -> float:
    """Median [s] between two rows. Raises ValueError for one that no log has, and a short log."""
    middle = float(np.median(np.diff(time))) if len(time) > 1 else math.nan
    if not STEPS[0] <= middle <= STEPS[1]:
        advice = unit_advice("time", "s", lambda f: STEPS[0] <= middle * f <= STEPS[1])
        allowed = f"[{STEPS[0]:g}, {STEPS[1]:g}] s"
        raise ValueError(f"a row every {middle:.3g} s; must be in {allowed}. {advice}")
    if (lasts := float(time[-1] - time[0])) < LEAST:
        raise ValueError(f"the log lasts {lasts:.3g} s; must be {LEAST:g} s or more")
    return middle


def _on_grid(
    values: Columns, middle: float, notes: list[str]
) -> tuple[float, Columns, NDArray[np.bool_]]:
    """(step [s], columns (T,), (T,) whether a row is there); middle: the median step [s]."""
    time = values["time"] - values["time"][0]
    gaps = np.diff(time)
    period = float(np.mean(gaps[gaps < 1.5 * middle]))
    steps = np.maximum(np.round(gaps / period), 1.0)
    even = np.mean(np.abs(gaps / period - steps) > EVEN) < 0.01
    place = np.concatenate([[0.0], np.cumsum(steps)]).astype(np.int64)
    count = int(place[-1]) + 1 if even else int(time[-1] / period) + 1
    present, at = np.zeros(count, dtype=bool), period * np.arange(count)
    if even:
        present[place] = True
    else:
        nearest = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
        present = time[nearest] - time[nearest - 1] < 2.5 * period
    grid: Columns = {}
    for name, column in values.items():
        if name != "time":
            grid[name] = np.full(count, math.nan)
            grid[name][present] = column if even else np.interp(at, time, column)[present]
    lost = int(count - present.sum())
    notes.append(
        f"{count} steps of {1e3 * period:.4g} ms, {'as logged' if even else 'resampled'}"
        + (f", {lost} of them without a row" if lost else "")
        + ("." if even else ": rows are unevenly spaced, and were interpolated linearly.")
    )
    return period, grid, present


# --- channels that are derived --------------------------------------------------------------


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


def _filled(column: Floats) -> Floats:
    """A column without gaps, for slopes: what is missing lies between its neighbours."""
    rows = np.flatnonzero(np.isfinite(column))
    if not len(rows):
        raise ValueError("a column of the log has no number at all; leave it out or map another")
    return np.interp(np.arange(len(column)), rows, column[rows])


def _is_new(columns: list[Floats], present: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where a group has a new sample: all columns finite, and not just those of before."""
    new = present & np.all([np.isfinite(column) for column in columns], axis=0)
    places = np.flatnonzero(np.all([np.isfinite(column) for column in columns], axis=0))
    same = np.all([np.diff(column[places]) == 0.0 for column in columns], axis=0)
    new[places[1:][same]] = False
    return new


def _complete(
    period: float, grid: Columns, present: NDArray[np.bool_], sensors: Sensors, notes: list[str]
) -> Log:
    """The log with derived channels, freshness and ages."""
    values, changes = dict(grid), dict[str, Any]()
    filled = {name: _filled(column) for name, column in grid.items()}
    w, v_x, v_y = filled["yaw_rate"], filled.get("v_x"), filled.get("v_y")
    derived = [name for name in ("acceleration_x", "yaw_acceleration") if name not in grid]
    half = max(round(0.5 * WINDOW / period), 1)
    samples = 2 * half + 1
    spread = 1.0 / (period * math.sqrt(sum(k * k for k in range(-half, half + 1))))
    if v_x is None or v_y is None:
        changes["velocity_noise"] = UNMEASURED
        notes.append("Not both velocities of the hull are there: they are found from the pose.")
    if "acceleration_x" in derived:
        if v_x is None:
            raise ValueError("the log has neither acceleration_x nor v_x; must have one of them")
        values["acceleration_x"] = slopes(v_x, period, samples) - (0.0 if v_y is None else w * v_y)
        changes["acceleration_noise"] = sensors.velocity_noise * spread
        changes["acceleration_bias"] = 0.0
    if "acceleration_y" not in grid:
        drift = 0.0 if v_y is None else slopes(v_y, period, samples)
        values["acceleration_y"] = w * (filled["belts"] if v_x is None else v_x) + drift
        notes.append("acceleration_y is yaw_rate times the forward speed.")
    if "yaw_acceleration" in derived:
        values["yaw_acceleration"] = slopes(w, period, samples)
        bend = max(sensors.gyro_noise * spread, 1e-6)
        # The data sheet states it by the distance of two accelerometers.
        noise = changes.get("acceleration_noise", sensors.acceleration_noise)
        changes["accelerometer_distance"] = min(max(math.sqrt(2.0) * noise / bend, 1e-2), 1e4)
    values |= {raw: grid[name] for raw, name in zip(RAW_TORQUES, TORQUES, strict=True)}
    if derived:
        notes.append(f"{' and '.join(derived)}: slopes of straight lines over {samples} steps.")
        weights = averages(np.eye(2 * samples)[samples], samples)
        changes["torque_noise"] = sensors.torque_noise * float(np.sqrt(np.nansum(weights**2)))
        for name in (*TORQUES, "acceleration_x", "acceleration_y"):
            if name in grid:  # all that a force and an acceleration are compared with
                mean = averages(filled[name], samples)
                values[name] = np.where(np.isfinite(grid[name]), mean, math.nan)
    if attitude := {"roll", "pitch"} <= grid.keys():
        values["pitch_rate"] = slopes(filled["pitch"], period, samples)
    inertial = present & np.isfinite(values["yaw_rate"] + values["acceleration_x"])
    if derived:  # slopes of one stretch each, so that their errors are independent
        inertial &= np.arange(len(present)) % samples == 0
    drives = [values[f"{name}_{side}"] for name in ("sprocket_speed", "torque") for side in SIDES]
    pose = _is_new([grid["x"], grid["y"], grid["yaw"]], present)
    fresh = np.stack([pose, inertial, present & np.all(np.isfinite(drives), axis=0)], axis=1)
    # Each group at its latest sample, from the step on at which all have one.
    steps = np.arange(len(fresh))
    last = np.maximum.accumulate(np.where(fresh, steps[:, None], -1), axis=0)
    complete = last.min(axis=1) >= 0
    if not complete.any():
        raise ValueError("the log has no moment from which on pose, gyro and drives are all known")
    first = int(np.argmax(complete))
    added = ((), ("roll", "pitch", "pitch_rate") if attitude else (), RAW_TORQUES)
    latest: Columns = {}
    for k, names in enumerate(added):
        for name in (*CHANNELS[GROUP_START[k] : GROUP_START[k + 1]], *names):
            column = values.get(name, np.full(len(steps), math.nan))
            latest[name] = column[np.maximum(last[:, k], 0)][first:]
    age = np.asarray(period * (steps[:, None] - last), dtype=np.float64)[first:]
    fresh = fresh[first:]
    shares = ", ".join(f"{g} {s:.0%}" for g, s in zip(GROUPS, fresh.mean(axis=0), strict=True))
    notes.append(f"Steps with a new sample: {shares}.")
    time = np.arange(len(age), dtype=np.float64) * period
    sheet = sensors._replace(**changes)
    return Log(period, time, latest, fresh, age, sheet, attitude, bool(derived), notes, [])
