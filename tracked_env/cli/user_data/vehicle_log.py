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

from tracked_env.cli.user_data.csv_columns import Column, Floats, check_speeds, read
from tracked_env.cli.user_data.log_checks import check_accelerations, check_agreement, unwrapped
from tracked_env.cli.user_data.log_grid import in_order, middle_step, on_grid
from tracked_env.cli.user_data.torque_checks import check_frozen, check_torques
from tracked_env.physics.channels import CHANNELS, GROUP_START, GROUPS
from tracked_env.physics.parameters import PlantParameters
from tracked_env.sensors import UNMEASURED, Sensors

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
