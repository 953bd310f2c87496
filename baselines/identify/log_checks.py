"""Whether the columns of a log are of one vehicle in one set of units and signs.

A gyro says how far the heading turned, belts how far the vehicle went. Where the two differ
by a factor that a unit or a gear explains, the log is refused and the factor named.

Functions that refuse raise ValueError; the message lacks the name of the file.
"""

import math
import warnings

import numpy as np

from baselines.identify.csv_log import Columns, Floats, explained, unit_advice
from tracked_env.physics.parameters import PlantParameters

SIDES = ("left", "right")

STRETCH = 0.5  # [s] over which ways and turns are compared
TURNING = 0.05  # [rad/s] mean yaw rate from which on turns are compared
MOVING = 0.1  # [m/s] likewise of the speed
BELTS_OVER_GROUND = (0.75, 2.5)  # [-] in the median: braked and nearly spinning
SPINNING = 1.6  # [-] belts over ground that a fifth of the straight driving stays below
TWISTED = (0.0, 1.4)  # [-] yaw rate over that of belts without slip: slip makes it less than 1
AGREEMENT = 0.8  # [-] length of the mean direction between heading and course
OFF_COURSE = 0.35  # [rad] between heading and course on the straight
LAGS = 5.0, 0.3  # [s] delays of the heading that are tried, and the largest that is accepted
SAME = 2.5  # [-] factor within which two measurements of one quantity agree
CLEAR = 0.1  # [m/s^2], [rad/s^2] standard deviation from which on accelerations are compared
SAME_WAY = (0.6, 1.6)  # [-] heading over gyro, v_x over the speed of x, y
DEGREES = 180.0 / math.pi


def check_ratio(what: str, ratio: float, limits: tuple[float, float], cause: str) -> None:
    """Refuse a ratio outside its limits; what: a sentence with a place for it."""
    if not limits[0] <= ratio <= limits[1]:
        allowed = f"[{limits[0]:.3g}, {limits[1]:.3g}]"
        raise ValueError(f"{what.format(ratio)}; must be in {allowed}. {cause}")


# --- heading, ways and speeds ---------------------------------------------------------------


def unwrapped(yaw: Floats, time: Floats, yaw_rate: Floats) -> Floats:
    """The heading without jumps by full turns, refused where it is in degrees."""
    rows = np.flatnonzero(np.isfinite(yaw))
    if len(rows) < 2:
        raise ValueError(f"yaw has {len(rows)} numbers; must have two or more")
    turned = np.diff(np.interp(time[rows], time, _integral(time, yaw_rate)))

    def mismatch(factor: float) -> float:
        change = (factor * np.diff(yaw[rows]) + math.pi) % (2.0 * math.pi) - math.pi
        return float(np.median(np.abs(change - turned)) / max(np.median(np.abs(turned)), 1e-6))

    spread = float(np.ptp(yaw[rows]))
    if spread > 2.0 * math.pi + 0.5 and mismatch(1.0 / DEGREES) < 0.3 * mismatch(1.0):
        raise ValueError(
            f"yaw covers {spread:.4g} rad and turns {DEGREES:.3g} times as far as yaw_rate "
            "says. Is it in deg? Then --units yaw=deg"
        )
    result = np.full(len(yaw), math.nan)
    result[rows] = np.unwrap(yaw[rows])
    return result


def _integral(time: Floats, rate: Floats) -> Floats:
    """Integral of a rate over time, zero first; missing values count as 0."""
    rate = np.nan_to_num(rate)
    steps = np.minimum(np.diff(time), STRETCH)  # nothing is known of a longer gap
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * steps)])


def check_agreement(values: Columns, vehicle: PlantParameters) -> None:
    """Refuse columns that contradict each other; adds `belts`, their mean speed [m/s]."""
    time, radius, gauge = values["time"], vehicle.sprocket_radius, vehicle.track_gauge
    left, right = (values[f"sprocket_speed_{side}"] for side in SIDES)
    belts = values["belts"] = 0.5 * radius * (left + right)
    marks = np.arange(time[0], time[-1], STRETCH)
    if len(marks) < 4:
        return
    twist = (right - left) * radius / gauge
    _check_constant(values, twist)
    rows = np.flatnonzero(np.isfinite(values["x"] + values["y"] + values["yaw"]))
    if len(rows) < 2:
        raise ValueError("x, y and yaw have fewer than two common rows; must have more")

    def mean(rate: Floats) -> Floats:
        """(K,) means of a rate over the stretches."""
        return np.diff(np.interp(marks, time, _integral(time, rate))) / STRETCH

    pose = np.array([np.interp(marks, time[rows], values[n][rows]) for n in ("x", "y", "yaw")])
    (d_x, d_y, turned), middle = np.diff(pose), 0.5 * (pose[2, 1:] + pose[2, :-1])
    way, turn = np.hypot(d_x, d_y) / STRETCH, turned / STRETCH
    forward = (np.cos(middle) * d_x + np.sin(middle) * d_y) / STRETCH
    drift = (np.cos(middle) * d_y - np.sin(middle) * d_x) / STRETCH
    gyro, belt_speed, belt_turn = mean(values["yaw_rate"]), mean(belts), mean(twist)
    _check_lag("yaw, yaw_rate", (time[rows], values["yaw"][rows]), time, values["yaw_rate"])
    turning = np.abs(gyro) > TURNING
    if turning.sum() >= 4:
        ratio = float(np.sum((turn * gyro)[turning]) / np.sum(gyro[turning] ** 2))
        cause = unit_advice("yaw", "rad", lambda f: explained(ratio * f), "Are they of one log?")
        cause = unit_advice("yaw_rate", "rad/s", lambda f: explained(ratio / f), cause)
        if explained(-ratio):
            cause = "One of them is positive to the right: both must be positive to the left."
        check_ratio("yaw turns {:.3g} times as far as yaw_rate says", ratio, SAME_WAY, cause)
        if np.sum((belt_turn * gyro)[turning]) < 0.0:
            raise ValueError(
                "where the right sprocket is faster, yaw_rate is negative; must be positive. "
                "Are left and right swapped, or are heading and yaw_rate positive to the right?"
            )
    tracks = {
        "right": (right, forward + 0.5 * gauge * gyro),
        "left": (left, forward - 0.5 * gauge * gyro),
    }
    wrong = [side for side, (speed, track) in tracks.items() if _opposed(mean(speed), track, 0.5)]
    if len(wrong) == 1:
        raise ValueError(
            f"sprocket_speed_{wrong[0]} is negative where its track goes forward; must be "
            "positive on both sides. Is that motor mounted the other way round?"
        )
    if turning.sum() >= 4:
        check_ratio(
            "the vehicle turns {:.3g} times as fast as its belts say",
            float(np.sum(gyro[turning] ** 2) / np.sum((belt_turn * gyro)[turning])),
            TWISTED,
            "Is the track_gauge of --vehicle too large, its sprocket_radius too small, or are "
            "the sprocket speeds, or both yaws (--units yaw=deg,yaw_rate=deg/s), in other units?",
        )
    straight = np.abs(turn) < 0.3 * way / gauge
    moving = (way > MOVING) & (np.abs(belt_speed) > MOVING) & straight
    if moving.sum() >= 4:
        backward = np.where(belt_speed < 0.0, math.pi, 0.0)
        _check_course(middle[moving], (np.arctan2(d_y, d_x) + backward)[moving])
        length = np.concatenate([[0.0], np.cumsum(np.hypot(d_x, d_y))])
        _check_lag("x, y, the sprockets", (marks, length), time, np.abs(belts))
        ratios = np.abs(belt_speed[moving]) / way[moving]
        _check_way(float(np.median(ratios)), float(np.percentile(ratios, 20.0)))
        if "v_x" in values:
            ratio = float(np.median(np.abs(mean(values["v_x"])[moving]) / way[moving]))
            cause = unit_advice("v_x", "m/s", lambda f: explained(ratio * f), "Whose is it?")
            check_ratio("v_x is {:.3g} times the speed of x, y", ratio, SAME_WAY, cause)
    elif np.median(np.abs(belt_speed)) > 10.0 * max(MOVING, float(np.median(way))):
        ratio = float(np.median(np.abs(belt_speed)) / max(np.median(way), 1e-6))
        _check_way(ratio, ratio)
    valid = np.isfinite(values.get("v_y", [math.nan]))
    if valid.any():
        v_y = np.interp(marks, time[valid], values["v_y"][valid])
        if len(drift) >= 20 and _opposed(drift, 0.5 * (v_y[1:] + v_y[:-1]), 0.4):
            raise ValueError(
                "v_y is negative where x, y go to the left of yaw; must be positive to the "
                "left, in the axes of the vehicle"
            )


def _opposed(one: Floats, other: Floats, share: float) -> bool:
    """Whether two rates have opposite signs, by a correlation below -share."""
    spread = float(np.linalg.norm(one) * np.linalg.norm(other))
    return spread > 0.0 and float(one @ other) < -share * spread


def _check_constant(values: Columns, twist: Floats) -> None:
    """Refuse a column that does not change while the vehicle turns, or stands for both sides;
    twist (T,) [rad/s] of the belts."""
    if max(float(np.nanstd(values["yaw_rate"])), float(np.nanstd(twist))) < TURNING:
        return
    for name in ("x", "y", "yaw", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right"):
        column = values[name][np.isfinite(values[name])]
        if len(column) and float(np.ptp(column)) == 0.0:
            raise ValueError(
                f"{name} is {column[0]:.6g} in every row, while the vehicle turns; must "
                "change. Did the sensor stop, or is it another column?"
            )
    for name in ("sprocket_speed", "torque"):
        if np.array_equal(values[f"{name}_left"], values[f"{name}_right"], equal_nan=True):
            raise ValueError(
                f"{name}_left and {name}_right are the same in every row, while the "
                "vehicle turns; must differ. Is one column mapped twice?"
            )


def _check_course(yaw: Floats, course: Floats) -> None:
    """Heading and course (K,) [rad] of straight driving."""
    same, mirrored = (complex(np.mean(np.exp(1j * (course - k * yaw)))) for k in (1.0, -1.0))
    off = math.atan2(same.imag, same.real)
    if abs(same) <= AGREEMENT:
        cause = "Do x, y and yaw belong together, or does the heading come late?"
        if abs(mirrored) > 0.8:
            cause = (
                "They are mirrored: is the heading positive to the right, as that of a compass, or "
                "are x and y swapped? y must be x turned to the left"
            )
        raise ValueError(
            "straight ahead the course of x, y does not go with yaw, not even with a constant "
            f"angle between them (they agree by {abs(same):.2f}; must be {AGREEMENT} or more). "
            f"{cause}"
        )
    if abs(off) > OFF_COURSE:
        cause = "Is yaw counted from another axis than x?"
        if abs(off) > math.pi - OFF_COURSE:
            cause = "Are sprocket speeds negative where the vehicle drives forward, or yaw turned?"
        raise ValueError(
            f"straight ahead the course of x, y is {math.degrees(off):.0f} deg from yaw; must "
            f"be within {math.degrees(OFF_COURSE):.0f} deg. {cause}"
        )


def _check_lag(names: str, way: tuple[Floats, Floats], time: Floats, rate: Floats) -> None:
    """Refuse a way or heading, (times, values), that comes long before or after its rate."""
    (at, covered), step = way, 0.05
    marks = np.arange(max(at[0], time[0]), min(at[-1], time[-1]), step)
    shifts, wide = round(LAGS[0] / step), round(STRETCH / step)
    if len(marks) < 4 * shifts:
        return
    both = np.interp(marks, at, covered), np.interp(marks, time, _integral(time, rate))
    a, b = (column[wide:] - column[:-wide] for column in both)
    if float(np.std(b)) < TURNING * STRETCH:
        return
    inner = b[shifts:-shifts]
    shifted = (a[shifts + k : len(a) - shifts + k] for k in range(-shifts, shifts + 1))
    rest = [float(np.mean((one - inner) ** 2)) for one in shifted]
    late = (int(np.argmin(rest)) - shifts) * step
    clear = min(rest) < 0.2 * min(rest[shifts], float(np.var(inner)))
    if clear and LAGS[1] < abs(late) < LAGS[0]:
        name, _, other = names.rpartition(", ")
        raise ValueError(
            f"{name} comes {abs(late):.2g} s {'after' if late > 0 else 'before'} {other}; "
            f"must be within {LAGS[1]:g} s. Does the pose have a delay? Shift x, y, yaw (and v_x, "
            f"v_y of the same device) by {-late:.2g} s in the file"
        )


def advice_on_belts(ratio: float, gear: float = 1.0) -> str:
    """Causes of belts that run `ratio` times as far as the vehicle goes; gear: as logged."""
    cause = unit_advice("x y", "m", lambda f: explained(ratio / f), "Are units others")
    cause = unit_advice("sprocket_speed", "rad/s", lambda f: explained(ratio * f), cause)
    about = f"of about {gear * ratio:.3g} (--gear {gear * ratio:.3g})"
    return f"{cause}, or has a motor a gear {about}, or --vehicle another sprocket_radius?"


def _check_way(ratio: float, least: float) -> None:
    """Belts over ground on the straight: the median, and what a fifth of it stays below."""
    cause = advice_on_belts(ratio)
    what = "on {} the belts run {{:.3g}} times as far as the vehicle"
    check_ratio(what.format("the straight"), ratio, BELTS_OVER_GROUND, cause)
    check_ratio(what.format("most of the straight"), least, (0.0, SPINNING), cause)


def check_accelerations(values: Columns, period: float) -> None:
    """Refuse accelerations that contradict the speeds of belts, hull and gyro.

    values: of a grid of steps of `period` [s]; those that are not measured are left out.
    """
    samples = max(round(STRETCH / period), 1)
    count = len(values["belts"]) // samples
    if count < 10:
        return
    speed = values.get("v_x", values["belts"])
    speed = values["belts"] if np.isfinite(speed).mean() < 0.5 else speed

    def means(column: Floats) -> Floats:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # stretches without a number
            table = column[: count * samples].reshape(count, samples)
            return np.asarray(np.nanmean(table, axis=1))

    def change(mean: Floats) -> Floats:  # the slope over both neighbours
        return np.asarray((mean[2:] - mean[:-2]) / (2.0 * samples * period))

    with np.errstate(invalid="ignore"):
        rate, forward = means(values["yaw_rate"]), means(speed)
        lateral, slow = (rate * forward)[1:-1], np.array([0.25, 0.5, 0.25])
        expected = {
            "acceleration_x": change(forward),
            "acceleration_y": lateral,
            "yaw_acceleration": change(rate),
        }
        for name, other in expected.items():
            if name in values:
                column = means(values[name])
                column = column[1:-1] if other is lateral else np.convolve(column, slow, "valid")
                use = np.isfinite(column + other)
                if use.sum() >= 10:
                    _check_same(name, column[use], other[use])


def _check_same(name: str, column: Floats, other: Floats) -> None:
    """One acceleration against what speeds say of it, (K,) each."""
    unit = "rad/s^2" if name == "yaw_acceleration" else "m/s^2"
    mean = float(np.median(column))
    if abs(mean) > 5.0 and unit == "m/s^2":
        raise ValueError(
            f"{name} is {mean:.3g} m/s^2 in the median; must be near 0. Is it the vertical "
            "axis, which feels gravity?"
        )
    if float(np.std(other)) < CLEAR:
        return
    column, other = column - column.mean(), other - other.mean()
    ratio = float(column @ other / (other @ other))
    # Gravity on slopes comes on top: then the ratio is as uncertain as that makes it.
    doubt = 4.0 * float(np.std(column - ratio * other) / np.std(other))
    doubt /= math.sqrt(0.5 * len(column))
    limits = 1.0 / SAME - doubt, SAME + doubt
    axis = "forward" if name == "acceleration_x" else "to the left"
    cause = f"Must be positive {axis}" if ratio < 0.0 else "Is it another column?"
    cause = unit_advice(name, unit, lambda f: explained(ratio * f), cause)
    check_ratio(f"{name} is {{:.3g}} times that of the speeds", ratio, limits, cause)
