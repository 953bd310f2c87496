"""Whether the torques of a log are those that moved the vehicle: their sign, side and size.

Before anything is fitted, they are compared with what a tracked vehicle needs, by non-negative
least squares over means of 0.2 s, with F = torque / r and s the sign, smoothed:
    F_L + F_R             = m a_x + R [s(V_L) + s(V_R)] / 2
    (F_R - F_L) B / 2     = I dw/dt + N s(w) + R B [s(V_R) - s(V_L)] / 4
Signs and sides of the torques are tried in all eight ways. Where another way leaves much less of
both equations unexplained, the log is refused and the way named; so is one whose torques nothing
explains, and one whose mass or inertia is far from those of the vehicle.
"""

import itertools
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import nnls

from baselines.identify.csv_log import UNITS, Floats
from tracked_env.physics.parameters import PlantParameters

MEAN = 0.2  # [s] over which all is averaged
MOVING = 0.15  # [m/s] of a track: slower ones may be held by the soil
SIGN = 0.1  # [m/s] and [rad/s] smoothing of the signs
LEAST = 20  # means, below which nothing is said
EXPLAINED = 0.6  # [-] share of the square of a force that the motion explains at least
PRESENT = 0.03  # [-] share of the forces from which on an equation is looked at
BETTER = 0.5  # [-] another way is believed that leaves this share of the residuals, or less
LEFT = 0.02  # [-] of the square that noise leaves unexplained
DELAYS = 1.0, 0.12  # [s] of torques that are tried, and the largest that is accepted
LATER = 0.55  # [-] another moment is believed that leaves this share of the residuals, or less
FROZEN = 5.0  # [s] a torque that is measured does not hold its last digit for longer
SIZE = 3.5  # [-] factor between the mass of the log and the nominal one, either way
ALIKE = 2.5  # [-] factor between the torques of both sides for the same motion
TOLD = 0.15  # [-] relative standard error below which a coefficient counts as told


class Fit(NamedTuple):
    """Non-negative least squares of one equation."""

    explained: float  # [-] share of the square of the force
    values: Floats  # (P,) coefficients
    errors: Floats  # (P,) their relative standard errors


def _fit(matrix: Floats, force: Floats) -> Fit:
    values, rest = nnls(matrix, force)
    scale = np.sqrt(np.mean(matrix**2, axis=0)) + 1e-12
    scaled = matrix / scale
    inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True, rcond=1e-6)
    # Neighbouring means share their errors: as if there were a third of them.
    deviations = np.sqrt(3.0 * rest**2 / len(force) * np.diag(inverse)) / scale
    power = float(force @ force) or 1.0
    return Fit(1.0 - rest**2 / power, values, deviations / np.maximum(values, 1e-12))


def _means(column: Floats, samples: int) -> Floats:
    """Means (T // samples,) of stretches, NaN where a value is missing."""
    count = len(column) // samples
    return np.asarray(column[: count * samples].reshape(count, samples).mean(axis=1))


def _motion(
    values: dict[str, Floats], period: float, vehicle: PlantParameters, delay: int = 0
) -> dict[str, Any]:
    """Means of what the torques are compared with, of the stretches in which a track moves.

    delay: [steps] by which torques are taken later.
    """
    samples = max(round(MEAN / period), 1)
    names = ("acceleration_x", "yaw_acceleration", "yaw_rate", "torque_left", "torque_right",
             "sprocket_speed_left", "sprocket_speed_right")  # fmt: skip
    ends = np.clip(np.arange(len(values["yaw_rate"])) + delay, 0, len(values["yaw_rate"]) - 1)
    mean = {
        name: _means(values[name][ends] if name.startswith("torque") else values[name], samples)
        for name in names
    }
    left, right = (vehicle.sprocket_radius * mean[f"sprocket_speed_{s}"] for s in ("left", "right"))
    moving = np.maximum(np.abs(left), np.abs(right)) > MOVING
    use = moving & np.isfinite(sum(mean.values()))
    return {name: column[use] for name, column in mean.items()} | {
        "left": left[use], "right": right[use]
    }  # fmt: skip


def _equations(mean: Any, vehicle: PlantParameters) -> tuple[Floats, Floats]:
    """Regressors (K, 2) of m, R and (K, 3) of I, N, R."""
    left, right = (mean[side] / np.hypot(mean[side], SIGN) for side in ("left", "right"))
    rate = mean["yaw_rate"]
    return (
        np.column_stack([mean["acceleration_x"], 0.5 * (left + right)]),
        np.column_stack([
            mean["yaw_acceleration"], rate / np.hypot(rate, SIGN),
            0.25 * vehicle.track_gauge * (right - left),
        ]),
    )  # fmt: skip


def check_torques(
    values: dict[str, Floats], period: float, vehicle: PlantParameters, path: Path
) -> list[str]:
    """Raise ValueError where the torques contradict the motion; returns doubts, a sentence each.

    values: of a grid of steps of `period` [s], with accelerations.
    """
    mean = _motion(values, period, vehicle)
    if len(mean["left"]) < LEAST:
        return []
    forces = [mean[f"torque_{side}"] / vehicle.sprocket_radius for side in ("left", "right")]
    equations = _equations(mean, vehicle)
    _check_sides(forces, equations, vehicle, path)
    fits: dict[tuple[bool, int, int], list[Fit | None]] = {}
    for swapped, *signs in itertools.product((False, True), (1, -1), (1, -1)):
        left, right = forces[::-1] if swapped else forces
        left, right = signs[0] * left, signs[1] * right
        total, moment = left + right, 0.5 * vehicle.track_gauge * (right - left)
        least = PRESENT * float(np.mean(left**2 + right**2))
        fits[swapped, signs[0], signs[1]] = [
            _fit(matrix, of) if float(np.mean((of / arm) ** 2)) > least else None
            for matrix, of, arm in zip(
                equations, (total, moment), (1.0, 0.5 * vehicle.track_gauge), strict=True
            )
        ]  # fmt: skip
    _check_signs(fits, path)
    own = fits[False, 1, 1]
    for of, what in zip(own, ("sum", "difference"), strict=True):
        if of is not None and of.explained < EXPLAINED:
            raise ValueError(
                f"{path}: accelerations and turns explain {of.explained:.0%} of the square of the "
                f"{what} of both torques; must be {EXPLAINED:.0%} or more. Are the torques of "
                "another log or another time, zero, demands that the drives did not follow, or "
                "has one side the wrong sign or unit?"
            )
    _check_delay(values, period, vehicle, [of is not None for of in own], path)
    return _check_sizes(own, vehicle, path)


def _check_delay(
    values: dict[str, Floats], period: float, vehicle: PlantParameters, present: list[bool],
    path: Path,
) -> None:  # fmt: skip
    """Raise ValueError where torques of another moment explain the motion much better.

    present: which of both equations are looked at.
    """
    steps = np.arange(-round(DELAYS[0] / period), round(DELAYS[0] / period) + 1)
    steps = steps[:: max(len(steps) // 40, 1)]
    steps = np.unique(np.append(steps, 0))
    rest = []
    for delay in steps:
        mean = _motion(values, period, vehicle, int(delay))
        left, right = (mean[f"torque_{side}"] for side in ("left", "right"))
        forces = (left + right) / vehicle.sprocket_radius, (right - left) / vehicle.sprocket_radius
        fits = [
            _fit(matrix, arm * force)
            for matrix, force, arm in zip(
                _equations(mean, vehicle), forces, (1.0, 0.5 * vehicle.track_gauge), strict=True
            )
        ]  # fmt: skip
        rest.append([1.0 - fit.explained for fit in fits])
    left_over = np.array(rest)
    now = left_over[int(np.flatnonzero(steps == 0)[0])]
    for k in np.flatnonzero(present):
        best = int(np.argmin(left_over[:, k]))
        late = float(steps[best]) * period
        if abs(late) > DELAYS[1] and left_over[best, k] < LATER * now[k] and now[k] > LEFT:
            raise ValueError(
                f"{path}: the torques fit accelerations and turns best {abs(late):.2g} s "
                f"{'later' if late > 0 else 'earlier'} than logged, which leaves "
                f"{left_over[best, k] / now[k]:.0%} of the residuals; must be within "
                f"{DELAYS[1]:g} s. Do they come from another device? Shift their columns by "
                f"{-late:.2g} s"
            )


def check_frozen(torque: Floats, side: str, period: float, path: Path) -> None:
    """Raise ValueError where a sensor repeats a value that is no limit of the drive.

    torque: rows of the file, `period` [s] apart.
    """
    known = torque[np.isfinite(torque)]
    if len(known) < 2:
        return
    breaks = np.flatnonzero(np.diff(known) != 0.0)
    ends = np.concatenate([[-1], breaks, [len(known) - 1]])
    longest = int(np.argmax(np.diff(ends)))
    lasts, value = float(np.diff(ends)[longest]) * period, float(known[ends[longest] + 1])
    at_limit = len(breaks) > 0 and abs(value) >= 0.999 * float(np.abs(known).max())
    if lasts > FROZEN and not at_limit and (value != 0.0 or len(breaks) == 0):
        raise ValueError(
            f"{path}: torque_{side} is {value:.6g} N m for {lasts:.3g} s without a change; must "
            f"change within {FROZEN:g} s. Did the sensor stop, or is it another column?"
        )


def _check_sides(
    forces: list[Floats], equations: tuple[Floats, Floats], vehicle: PlantParameters, path: Path
) -> None:
    """Raise ValueError where one side has other torques for the same motion than the other."""
    straight, turning = equations
    sides = []
    for force, turn in zip(forces, (-1.0, 1.0), strict=True):
        of_turns = turn * turning[:, :2] / vehicle.track_gauge
        matrix = np.column_stack([0.5 * straight, of_turns])
        sides.append(_fit(matrix * (np.sign(matrix.T @ force) + (matrix.T @ force == 0.0)), force))
    left, right = sides
    told = (np.maximum(left.errors, right.errors) < TOLD) & (left.values * right.values > 0.0)
    if not told.any():
        return
    ratio = float(np.exp(np.median(np.log(left.values[told] / right.values[told]))))
    if not 1.0 / ALIKE <= ratio <= ALIKE:
        raise ValueError(
            f"{path}: for the same motion torque_left is {ratio:.3g} times torque_right; must "
            f"be within a factor of {ALIKE:g}. Is one of them in another unit (--units "
            "torque_left=..), or of another place in the drive?"
        )


def _check_signs(fits: dict[tuple[bool, int, int], list[Fit | None]], path: Path) -> None:
    """Raise ValueError where other signs or sides explain the torques much better."""

    def left(way: tuple[bool, int, int]) -> float:
        """What is not explained, the geometric mean of the equations."""
        rest = [1.0 - of.explained + LEFT for of in fits[way] if of is not None]
        return math.exp(sum(map(math.log, rest)) / max(len(rest), 1)) if rest else 1.0

    own = (False, 1, 1)
    best = min(fits, key=lambda way: (left(way), way != own))
    if left(best) > BETTER * left(own):
        return
    swapped, *signs = best
    sides = ("right", "left") if swapped else ("left", "right")
    wrong = [f"torque_{side}" for side, sign in zip(sides, signs, strict=True) if sign < 0]
    said = ["torque_left and torque_right are swapped"] if swapped else []
    if wrong:
        plural = "have" if len(wrong) > 1 else "has"
        said.append(f"{' and '.join(wrong)} {plural} the wrong sign")
    advice = "exchange them with --columns" if swapped else ""
    advice += " and " if swapped and wrong else ""
    advice += "turn the sign in the file" if wrong else ""
    raise ValueError(
        f"{path}: the torques contradict accelerations and turns: {' and '.join(said)}. Then "
        f"{max(1.0 - left(best), 0.0):.0%} of their square is explained, as they are "
        f"{max(1.0 - left(own), 0.0):.0%}; "
        f"a torque that drives forward must be positive on both sides. Please {advice}"
    )


def _check_sizes(own: list[Fit | None], vehicle: PlantParameters, path: Path) -> list[str]:
    """Doubts. Raises ValueError for torques of a size that moves another vehicle."""
    doubts = []
    for fit, name, unit in zip(own, ("mass", "inertia"), ("kg", "kg m^2"), strict=True):
        if fit is None or not fit.errors[0] < TOLD:
            continue
        value, nominal = float(fit.values[0]), float(getattr(vehicle, name))
        ratio = value / nominal
        if not 1.0 / SIZE <= ratio <= SIZE:
            raise ValueError(
                f"{path}: torques and accelerations are those of a vehicle of {value:.4g} {unit}; "
                f"must be within a factor of {SIZE:g} of the {name} of --vehicle, {nominal:g} "
                f"{unit}. {_cause(ratio, name)}"
            )
        if name == "mass" and not 0.5 <= ratio <= 2.0:
            doubts.append(
                f"The log is of a vehicle of about {value:.3g} kg and --vehicle of {nominal:g} kg. "
                "Torques on a wrong scale (a gear that was left out, a percentage) look the same: "
                "weigh the vehicle, or check --gear and the unit of the torques."
            )
    return doubts


def _cause(ratio: float, name: str) -> str:
    """What may make torques too large or too small by a ratio."""
    likely = [
        f"in {unit} (--units torque={unit})" for unit, of in UNITS["N m"].items()
        if of != 1.0 and unit != "Nm" and abs(math.log(ratio * of)) < math.log(1.8)
    ]  # fmt: skip
    if ratio < 1.0:
        likely += ["of the motors (--gear RATIO)", "in per cent or per mille of the largest"]
    return (
        f"Are the torques {', '.join(likely) or 'in another unit'}, the accelerations in another "
        f"unit, or is the vehicle another one (--vehicle with its {name})?"
    )
