"""Whether the torques of a log are those that moved the vehicle, and how they resist its turns.

Before anything is fitted, they are compared with what a tracked vehicle needs, by non-negative
least squares over means of 0.2 s, with F = torque / r and s the sign, smoothed:
    F_L + F_R             = m a_x + R [s(V_L) + s(V_R)] / 2
    (F_R - F_L) B / 2     = I dw/dt + N s(w) + R B [s(V_R) - s(V_L)] / 4
Signs and sides of the torques are tried in all eight ways. Where another way leaves much less of
both equations unexplained, the log is refused and the way named; so is one whose torques nothing
explains, and one whose mass or inertia is far from those of the vehicle. What is refused raises
ValueError, without the name of the file.

The turning resistance, where the smoothing of friction near rest is not known:
    M = I dw/dt + C g S(v_y, w; e) + opposite resistances,    C = m mu_t
    S = (1 / l) integral over the contact of s g(v_y + s w) ds,   g: the sign of the sliding speed,
smoothed over a width e [m/s] in one of two shapes, E = sqrt(u^2 + e^2):
    soft   g = u / E                      sharp  g = u / E + e^2 u / (2 E^3), that of the plants
The equations of the identification know one shape and width. Here all widths of a grid are fitted,
each with its I and C; its weight is its likelihood, of residuals as large and as correlated as they
are. What the mean law of the log differs by is taken off the torques, and the scatter of I and C
over the widths belongs into their intervals.
"""

import itertools
import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from baselines.identify.csv_log import Columns, Floats, unit_advice
from baselines.identify.log_checks import SIDES, check_ratio
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.terramechanics import GRAVITY, LATERAL_FRICTION_REGULARISATION
from tracked_env.sensors import Sensors

MEAN = 0.2  # [s] over which torques and motion are averaged
TRACK_MOVING = 0.15  # [m/s] of a track: slower ones may be held by the soil
SIGN = 0.1  # [m/s] and [rad/s] smoothing of the signs
LEAST = 20  # means, below which nothing is said
EXPLAINED = 0.6  # [-] share of the square of a force that the motion explains at least
PRESENT = 0.03  # [-] share of the forces from which on an equation is looked at
BETTER = 0.5  # [-] another way is believed that leaves this share of the residuals, or less
NOISE = 0.02  # [-] of the square that noise leaves unexplained
DELAYS = 1.0, 0.12  # [s] of torques that are tried, and the largest that is accepted
LATER = 0.55  # [-] another moment is believed that leaves this share of the residuals, or less
FROZEN = 5.0  # [s] a torque that is measured does not hold its last digit for longer
SIZE = 3.5  # [-] factor between the mass of the log and the nominal one, either way
ALIKE = 2.5  # [-] factor between the torques of both sides for the same motion
CERTAIN = 0.15  # [-] relative standard error below which a coefficient is certain

WIDTHS = np.geomspace(1e-3, 0.2, 25)  # [m/s] e
SHAPES = (0.0, 0.5)  # factor of e^2 u / E^3: soft, sharp
PLANT_SMOOTHING = (LATERAL_FRICTION_REGULARISATION, 0.5)  # width and shape of the estimators' law
SLOWEST = 0.2  # [m/s] of a track
LEAST_TURNING = 200  # samples
INSIDE = 0.8  # [-] of the half contact, where the centre of rotation is sought
MODEL_NOISE = 20.0  # [N m]
TEMPERED = 5.0  # [-] on the misfit, since widths lie apart and no shape is quite that of a soil
TRUSTED = 0.25  # [-] of the change by the smoothing: its standard deviation, for other shapes

Way = tuple[bool, int, int]  # whether the sides are swapped, signs of the left and right torque


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


def _motion(
    values: Columns, period: float, vehicle: PlantParameters, delay: int = 0
) -> tuple[list[Floats], tuple[Floats, Floats]]:
    """Torques (K,) of both sides [N m], and regressors (K, 2) of m, R and (K, 3) of I, N, R: means
    of the stretches in which a track moves. delay: [steps] by which torques are taken later."""
    samples, count = max(round(MEAN / period), 1), len(values["yaw_rate"])
    later = np.clip(np.arange(count) + delay, 0, count - 1)

    def mean(column: Floats) -> Floats:
        """NaN where a value is missing."""
        whole = column[: count // samples * samples]
        return np.asarray(whole.reshape(-1, samples).mean(axis=1))

    names = "acceleration_x", "yaw_acceleration", "yaw_rate"
    forward, bend, rate = (mean(values[name]) for name in names)
    torques = [mean(values[f"torque_{side}"][later]) for side in SIDES]
    speeds = [mean(values[f"sprocket_speed_{side}"]) for side in SIDES]
    left, right = (vehicle.sprocket_radius * speed for speed in speeds)
    use = np.isfinite(forward + bend + rate + torques[0] + torques[1] + speeds[0] + speeds[1])
    use &= np.maximum(np.abs(left), np.abs(right)) > TRACK_MOVING
    forward, bend, rate, left, right = (c[use] for c in (forward, bend, rate, left, right))
    left, right = left / np.hypot(left, SIGN), right / np.hypot(right, SIGN)
    straight = np.column_stack([forward, 0.5 * (left + right)])
    opposite = 0.25 * vehicle.track_gauge * (right - left)
    turning = np.column_stack([bend, rate / np.hypot(rate, SIGN), opposite])
    return [torque[use] for torque in torques], (straight, turning)


def check_torques(values: Columns, period: float, vehicle: PlantParameters) -> list[str]:
    """Refuse torques that contradict the motion; returns doubts, a sentence each.

    values: of a grid of steps of `period` [s], with accelerations.
    """
    torques, equations = _motion(values, period, vehicle)
    if len(torques[0]) < LEAST:
        return []
    forces, half = [t / vehicle.sprocket_radius for t in torques], 0.5 * vehicle.track_gauge
    _check_sides(forces, equations, vehicle)
    fits: dict[Way, list[Fit | None]] = {}
    for swapped, *signs in itertools.product((False, True), (1, -1), (1, -1)):
        left, right = (k * f for k, f in zip(signs, forces[:: -1 if swapped else 1], strict=True))
        least = PRESENT * float(np.mean(left**2 + right**2))
        loads = (left + right, half * (right - left))
        fits[swapped, signs[0], signs[1]] = [
            _fit(matrix, load) if float(np.mean((load / arm) ** 2)) > least else None
            for matrix, load, arm in zip(equations, loads, (1.0, half), strict=True)
        ]
    _check_signs(fits)
    fit_of_log = fits[False, 1, 1]
    for fit, what in zip(fit_of_log, ("sum", "difference"), strict=True):
        if fit is not None and fit.explained < EXPLAINED:
            raise ValueError(
                f"accelerations and turns explain {fit.explained:.0%} of the square of the "
                f"{what} of both torques; must be {EXPLAINED:.0%} or more. Are the torques of "
                "another log or another time, zero, demands that the drives did not follow, or "
                "has one side the wrong sign or unit?"
            )
    _check_delay(values, period, vehicle, [fit is not None for fit in fit_of_log])
    return _check_sizes(fit_of_log, vehicle)


def _check_delay(
    values: Columns, period: float, vehicle: PlantParameters, present: list[bool]
) -> None:
    """Refuse torques that fit the motion much better at another moment.

    present: which of both equations are looked at.
    """
    most = round(DELAYS[0] / period)
    steps = np.arange(-most, most + 1)
    steps = np.unique(np.append(steps[:: max(len(steps) // 40, 1)], 0))
    rest = np.empty((len(steps), 2))
    for k, delay in enumerate(steps):
        (left, right), equations = _motion(values, period, vehicle, int(delay))
        force = (left + right) / vehicle.sprocket_radius
        moment = 0.5 * vehicle.track_gauge * ((right - left) / vehicle.sprocket_radius)
        pairs = zip(equations, (force, moment), strict=True)
        rest[k] = [1.0 - _fit(*pair).explained for pair in pairs]
    now = rest[steps == 0][0]
    for equation in np.flatnonzero(present):
        best = int(np.argmin(rest[:, equation]))
        late, left_over = float(steps[best]) * period, rest[best, equation]
        better = left_over < LATER * now[equation] and now[equation] > NOISE
        if abs(late) > DELAYS[1] and better:
            raise ValueError(
                f"the torques fit accelerations and turns best {abs(late):.2g} s "
                f"{'later' if late > 0 else 'earlier'} than logged, which leaves "
                f"{left_over / now[equation]:.0%} of the residuals; must be within {DELAYS[1]:g} "
                "s. Do they come from another device? Shift their columns by "
                f"{-late:.2g} s"
            )


def check_frozen(torque: Floats, side: str, period: float) -> None:
    """Refuse a sensor that repeats a value that is no limit of the drive.

    torque: rows of the file, `period` [s] apart.
    """
    torque = torque[np.isfinite(torque)]
    if len(torque) < 2:
        return
    breaks = np.flatnonzero(np.diff(torque) != 0.0)
    ends = np.concatenate([[-1], breaks, [len(torque) - 1]])
    longest = int(np.argmax(np.diff(ends)))
    lasts, value = float(np.diff(ends)[longest]) * period, float(torque[ends[longest] + 1])
    at_limit = len(breaks) > 0 and abs(value) >= 0.999 * float(np.abs(torque).max())
    if lasts > FROZEN and not at_limit and (value != 0.0 or len(breaks) == 0):
        raise ValueError(
            f"torque_{side} is {value:.6g} N m for {lasts:.3g} s without a change; must "
            f"change within {FROZEN:g} s. Did the sensor stop, or is it another column?"
        )


def _check_sides(forces: list[Floats], equations: Any, vehicle: PlantParameters) -> None:
    """Refuse one side that has other torques for the same motion than the other."""
    (straight, turning), sides = equations, []
    for force, turn in zip(forces, (-1.0, 1.0), strict=True):
        matrix = np.column_stack([0.5 * straight, turn * turning[:, :2] / vehicle.track_gauge])
        sides.append(_fit(matrix * (np.sign(matrix.T @ force) + (matrix.T @ force == 0.0)), force))
    left, right = sides
    certain = (np.maximum(left.errors, right.errors) < CERTAIN) & (left.values * right.values > 0.0)
    if not certain.any():
        return
    ratio = float(np.exp(np.median(np.log(left.values[certain] / right.values[certain]))))
    cause = "Is one of them in another unit (--units torque_left=..), or of another place?"
    what = "for the same motion torque_left is {:.3g} times torque_right"
    check_ratio(what, ratio, (1.0 / ALIKE, ALIKE), cause)


def _check_signs(fits: dict[Way, list[Fit | None]]) -> None:
    """Refuse torques that other signs or sides explain much better."""

    def unexplained(way: Way) -> float:
        """The geometric mean of the equations."""
        rest = [1.0 - fit.explained + NOISE for fit in fits[way] if fit is not None]
        return math.exp(sum(map(math.log, rest)) / max(len(rest), 1)) if rest else 1.0

    logged = (False, 1, 1)
    best = min(fits, key=lambda way: (unexplained(way), way != logged))
    if unexplained(best) > BETTER * unexplained(logged):
        return
    swapped, *signs = best
    sides = SIDES[::-1] if swapped else SIDES
    wrong = [f"torque_{side}" for side, sign in zip(sides, signs, strict=True) if sign < 0]
    faults = ["torque_left and torque_right are swapped"] if swapped else []
    advice = ["exchange them with --columns"] if swapped else []
    if wrong:
        faults.append(f"{' and '.join(wrong)} {'have' if wrong[1:] else 'has'} the wrong sign")
        advice.append("turn the sign in the file")
    raise ValueError(
        f"the torques contradict accelerations and turns: {' and '.join(faults)}. Then "
        f"{max(1.0 - unexplained(best), 0.0):.0%} of their square is explained, as they are "
        f"{max(1.0 - unexplained(logged), 0.0):.0%}; a torque that drives forward must be positive "
        f"on both sides. Please {' and '.join(advice)}"
    )


def _explains(ratio: float, factor: float) -> bool:
    """Whether torques in a unit of this factor would be of the right size."""
    return abs(math.log(ratio * factor)) < math.log(1.8)


def _check_sizes(fits: list[Fit | None], vehicle: PlantParameters) -> list[str]:
    """Doubts. Refuse torques of a size that moves another vehicle."""
    doubts = []
    for fit, name, unit in zip(fits, ("mass", "inertia"), ("kg", "kg m^2"), strict=True):
        if fit is None or not fit.errors[0] < CERTAIN:
            continue
        value, nominal = float(fit.values[0]), float(getattr(vehicle, name))
        ratio = value / nominal
        if not 1.0 / SIZE <= ratio <= SIZE:
            cause = "Are the torques those of the motors (--gear RATIO), or in per cent"
            cause = unit_advice("torque", "N m", partial(_explains, ratio), cause)
            raise ValueError(
                f"torques and accelerations are those of a vehicle of {value:.4g} {unit}; must be "
                f"within a factor of {SIZE:g} of the {name} of --vehicle, {nominal:g} {unit}. "
                f"{cause}, or is it another vehicle, or are the accelerations in another unit?"
            )
        if name == "mass" and not 0.5 <= ratio <= 2.0:
            doubts.append(
                f"The log is of a vehicle of about {value:.3g} kg and --vehicle of {nominal:g} kg. "
                "Torques on a wrong scale (a gear that was left out, a percentage) look the same: "
                "weigh the vehicle, or check --gear and the unit of the torques."
            )
    return doubts


# --- the turning resistance -----------------------------------------------------------------


class Turning(NamedTuple):
    """What the smoothing does to the turning resistance."""

    excess: Floats  # (T,) [N m] moment beyond that of the law the estimators have
    inertia_spread: float  # [-] standard deviation over the mean
    resistance_spread: float  # [-]


def unit_moment(v_y: Floats, rate: Floats, length: float, width: float, shape: float) -> Floats:
    """S [m] of v_y [m/s] and w [rad/s], odd in w."""
    w = np.where(np.abs(rate) < 1e-4, np.copysign(1e-4, rate), rate)
    half, e2 = 0.5 * length * w, width * width

    def integrals(u: Floats) -> tuple[Floats, Floats]:
        """Of g(u) and of u g(u)."""
        root, bend = np.hypot(u, width), np.arcsinh(u / width)
        first = 0.5 * (u * root - e2 * bend) + shape * e2 * (bend - u / root)
        return root - shape * e2 / root, first

    rear, front = integrals(v_y - half), integrals(v_y + half)
    return np.asarray((front[1] - rear[1] - v_y * (front[0] - rear[0])) / (length * w * w))


def side_speed(
    a_y: Floats, rate: Floats, friction: float, length: float, smoothing: tuple[float, float]
) -> Floats:
    """v_y [m/s] at which friction mu_t gives the lateral acceleration a_y [m/s^2]."""
    width, shape = smoothing
    half = 0.5 * length * rate
    reach = INSIDE * np.hypot(half, width)
    v_y = np.zeros(len(a_y))
    for _ in range(4):
        one, two = (np.hypot(v_y + k * half, width) for k in (-1.0, 1.0))
        lever = 0.5 * (one + two) / (1.0 + shape * width * width / (one * two))
        v_y = np.clip(-a_y / (max(friction, 0.05) * GRAVITY) * lever, -reach, reach)
    return v_y


def turning_of(
    values: Columns, fresh: NDArray[np.bool_], sheet: Sensors, vehicle: PlantParameters
) -> Turning | None:
    """The turning resistance of a log, or None where it turns too little to say anything.

    values, fresh, sheet: of a `Log`.
    """
    radius, length = vehicle.sprocket_radius, vehicle.contact_length
    half = 0.5 * vehicle.track_gauge
    rate, bend, a_y = (values[n] for n in ("yaw_rate", "yaw_acceleration", "acceleration_y"))
    left, right = (radius * values[f"sprocket_speed_{side}"] for side in SIDES)
    moment = half / radius * (values["torque_right"] - values["torque_left"])
    usable = fresh[:, 1] & fresh[:, 2] & np.isfinite(moment + bend + a_y + rate)
    usable &= np.minimum(np.abs(left), np.abs(right)) > SLOWEST
    usable &= np.abs(rate) > 2.0 * LATERAL_FRICTION_REGULARISATION / length
    if usable.sum() < LEAST_TURNING:
        return None
    opposite = 0.5 * (np.sign(right) - np.sign(left))[usable]
    weight = vehicle.mass * GRAVITY
    noise = math.sqrt(2.0) * sheet.acceleration_noise / sheet.accelerometer_distance
    variance = 2.0 * (half / radius * sheet.torque_noise) ** 2
    variance = variance + MODEL_NOISE**2 + (vehicle.inertia * noise) ** 2
    turn = np.hypot(sheet.gyro_noise, 1e-4)
    friction = vehicle.lateral_resistance
    results, laws = list[tuple[float, float, float]](), list[Floats]()
    for smoothing in [PLANT_SMOOTHING, *((float(w), s) for s in SHAPES for w in WIDTHS)]:
        for _ in range(2):  # v_y needs mu_t
            v_y = side_speed(a_y, rate, friction, length, smoothing)
            law = weight * unit_moment(v_y, rate, length, *smoothing)
            columns = [bend[usable], law[usable]]
            if np.abs(opposite).mean() > 0.01:
                columns.append(half * weight * opposite)
            matrix = np.column_stack(columns)
            if not results:  # the same weights for all: likelihoods are compared
                more, less = (
                    unit_moment(v_y, rate + k * turn, length, *smoothing) for k in (1, -1)
                )
                slope = friction * weight * (more - less)[usable] / 2.0
                root = 1.0 / np.sqrt(variance + slope**2)
            solution = np.linalg.lstsq(root[:, None] * matrix, root * moment[usable], rcond=None)[0]
            friction = min(max(float(solution[1]), 0.05), 2.0)
        residuals = root * (moment[usable] - matrix @ solution)
        results.append((float(solution[0]), float(solution[1]), float(residuals @ residuals)))
        laws.append(law)
        if results[-1][2] <= min(misfit for _, _, misfit in results):
            best = residuals
    inertia, resistance, misfit = np.array(results).T
    correlation = float(np.clip(best[1:] @ best[:-1] / (best @ best), 0.0, 0.95))
    scale = max(misfit.min() / len(best), 1.0) * (1.0 + correlation) / (1.0 - correlation)
    scale *= TEMPERED
    weights = np.exp(-0.5 * (misfit - misfit.min()) / scale)
    weights /= weights.sum()
    law = sum(p * c * s for p, c, s in zip(weights, resistance, laws, strict=True))

    def spread(values: Floats) -> float:
        mean = float(weights @ values)
        variance = float(weights @ (values - mean) ** 2) + (TRUSTED * (mean - values[0])) ** 2
        return math.sqrt(variance) / max(abs(mean), 1e-9)

    excess = np.nan_to_num(np.asarray(law) - float(weights @ resistance) * laws[0])
    return Turning(excess, spread(inertia), spread(resistance))
