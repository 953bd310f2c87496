"""What makes a run of a vehicle useless: found from its own numbers, with the reason in words.

A run is a stretch of rows with time, both sprocket speeds and the motion, as a pose or as
velocities. What a few rows have is left out and counted; what more have refuses the run.
"""

import math

import numpy as np

from tracked_env.cli.user_data.csv_columns import Floats
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
