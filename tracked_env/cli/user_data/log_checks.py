"""Whether the columns of a log are of one vehicle in one set of units and signs.

A gyro says how far the heading turned, belts how far the vehicle went: where the two differ by a
factor that a unit or a gear explains, the log is refused and the factor named.
"""

import math
from pathlib import Path

import numpy as np

from tracked_env.cli.user_data.csv_columns import UNITS, Floats
from tracked_env.physics.parameters import PlantParameters

STRETCH = 0.5  # [s] over which ways and turns are compared
TURNING = 0.05  # [rad/s] mean yaw rate from which on turns are compared
MOVING = 0.1  # [m/s] likewise of the speed
SLIPPED = (0.4, 3.0)  # [-] belts over ground: braked hard and nearly spinning
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
    return np.concatenate([[0.0], np.cumsum(0.5 * (known[1:] + known[:-1]) * np.diff(time))])


def check_agreement(values: dict[str, Floats], vehicle: PlantParameters, path: Path) -> None:
    """Raise ValueError where columns contradict each other; adds `belts`, their mean speed."""
    time = values["time"]
    left, right = values["sprocket_speed_left"], values["sprocket_speed_right"]
    belts = 0.5 * vehicle.sprocket_radius * (left + right)
    values["belts"] = belts
    marks = np.arange(time[0], time[-1], STRETCH)
    if len(marks) < 4:
        return
    rows = np.flatnonzero(np.isfinite(values["x"] + values["y"] + values["yaw"]))
    if len(rows) < 2:
        raise ValueError(f"{path}: x, y and yaw have fewer than two common rows; must have more")
    x, y, yaw = (np.interp(marks, time[rows], values[name][rows]) for name in ("x", "y", "yaw"))
    way = np.hypot(np.diff(x), np.diff(y)) / STRETCH
    turn = np.diff(yaw) / STRETCH
    gyro = np.diff(np.interp(marks, time, _integral(time, values["yaw_rate"]))) / STRETCH
    driven = np.diff(np.interp(marks, time, _integral(time, belts))) / STRETCH
    _check_turns(turn, gyro, path)
    twist = (right - left) * vehicle.sprocket_radius / vehicle.track_gauge
    belt_turn = np.diff(np.interp(marks, time, _integral(time, twist))) / STRETCH
    turning = np.abs(gyro) > TURNING
    if turning.sum() >= 4 and np.sum(belt_turn[turning] * gyro[turning]) < 0.0:
        raise ValueError(
            f"{path}: where the right sprocket is faster, yaw_rate is negative; must be positive. "
            "Are left and right swapped, or are heading and yaw_rate positive to the right?"
        )
    straight = np.abs(turn) < 0.3 * way / vehicle.track_gauge
    moving = (way > MOVING) & straight
    if moving.sum() >= 4:
        _check_way(float(np.median(np.abs(driven[moving]) / way[moving])), path)
        if "v_x" in values:
            speed = np.diff(np.interp(marks, time, _integral(time, values["v_x"]))) / STRETCH
            _check_speed(float(np.median(np.abs(speed[moving]) / way[moving])), path)
    elif np.median(np.abs(driven)) > 10.0 * max(MOVING, float(np.median(way))):
        _check_way(float(np.median(np.abs(driven)) / max(np.median(way), 1e-6)), path)


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


def _check_way(ratio: float, path: Path) -> None:
    """Belts over ground on the straight."""
    if SLIPPED[0] <= ratio <= SLIPPED[1]:
        return
    causes = {f"sprocket_speed={unit}": 1.0 / of for unit, of in UNITS["rad/s"].items() if of != 1}
    causes |= {f"x={unit},y={unit}": of for unit, of in UNITS["m"].items() if of != 1}
    likely = [text for text, of in causes.items() if 0.7 < ratio / of < 1.4]
    advice = f"Does --units {likely[0]} explain it" if likely else "Is it the motor's speed"
    raise ValueError(
        f"{path}: on the straight the belts run {ratio:.3g} times as far as the vehicle; must be "
        f"in [{SLIPPED[0]}, {SLIPPED[1]}]. {advice}, or --gear {ratio:.3g}, or another "
        "sprocket_radius of --vehicle?"
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
