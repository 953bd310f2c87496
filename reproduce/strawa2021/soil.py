"""Sections 8.3.2 and 8.3.3: slip by an unscented Kalman filter, and F_max and K of the soil.

Slip. The paper says that the filter is unbiased except on rapid changes of speed (figure 33), and
states neither the path nor the rates of the sensors. Chosen: the manoeuvre of 8.3.1 with a gentle
speed (2 +- 0.2 m/s, at most 0.3 m/s^2) and a brisk one (2 +- 1 m/s, up to 3.1 m/s^2), each on heavy
clay, where the slip is a fraction of a percent, and on sandy loam; all sensors at 100 Hz, and the
pose at lower rates as well. As in the paper, controller and filter receive noisy measurements; the
controller has the true parameters. The measurement is z = [X, Y, yaw] as in the paper, or
velocities and yaw rate as well.

Soil. The paper names neither soil nor path. Chosen: circle (R = 10 m, 2 m/s, steady) and manoeuvre
(8.3.1), turning factor 1, over three grounds that follow each other in time: sandy loam of 8.2.3,
at 10 s a stiffer and stronger one, at 20 s a softer one; and over heavy clay (Table 2). Slips and
torques are the true ones, as the accuracy of the paper suggests, or measured: torque with the
noise of the sensors and slip from the UKF. The generalised Newton-Raphson method of 7.3 as it is
printed, for one vehicle: for the last fifty control steps (`window`), both tracks, f = F_max g(K)
- tau / r with g = 1 - K / (i l) (1 - exp(-i l / K)); (F_max, K) <- (F_max, K) - J^+ f, J the
printed derivatives, J^+ the least-squares inverse, at most twenty times; not converged -> the last
converged values. No weights, no damping, no prior: what the estimators of this project add.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 7.3 and 8.3.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.measurement import DataSheet
from baselines.estimators.observation_reader import ObservationReader
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.soil_estimator import SLIP_CORRELATION, SoilEstimator
from reproduce.policy_runs import Drive, Floats
from reproduce.strawa2021 import control
from reproduce.strawa2021.control import LOAM, ON_PATH, PATHS, PERIOD, SIDES, manoeuvre, rms
from reproduce.strawa2021.identification import filtered_policy
from tracked_env.events import Event, ramp_events
from tracked_env.physics import terramechanics
from tracked_env.physics.parameters import PlantParameters, plant_parameters
from tracked_env.sensors import PRESETS, Sensors

DURATION = 30.0  # [s]
TRUE = control.assumed_parameters("exact", 1.0)


def drive(rows: Sequence[Mapping[str, Any]], sensors: str, duration: float) -> Drive:
    """Vehicles with the options of `rows`, from the path; the controller has their true parameters
    behind the filter."""
    common = {"lateral_model": control.lateral_model(1.0), "start": ON_PATH}
    policy = filtered_policy(TRUE, PRESETS[sensors], "fixed")
    return control.drive(policy, [{**common, **row} for row in rows], duration, sensors, keep=True)


# Slip

BEGUN = 5.0  # [s] from here on the initial error of the filter has decayed
STEADY, RAPID = 0.4, 2.0  # [m/s^2] of |dv/dt|: below steady, above rapid
SEEDS = 8  # vehicles per case
SPEEDS = {  # amplitude [m/s] and period [s] of the speed
    "gentle": {"amplitude": 0.2, "period": 4.0},
    "brisk": {"amplitude": 1.0, "period": 2.0},
}
SOILS: dict[str, dict[str, Any]] = {"heavy clay": {}, "sandy loam": LOAM}
RATES = (100.0, 50.0, 20.0, 10.0)  # [Hz] of the pose
MEASURED = {"pose": False, "pose and velocities": True}


class SlipCase(NamedTuple):
    """One vehicle on one soil with one rate of the pose."""

    speed: str
    soil: str
    rate: float


SLIP_CASES = [
    *(SlipCase(speed, soil, RATES[0]) for speed in SPEEDS for soil in SOILS),
    *(SlipCase("gentle", "sandy loam", rate) for rate in RATES[1:]),
]


class Slips(NamedTuple):
    """Estimates of one batch: SEEDS vehicles per case, in the order of `cases`."""

    cases: list[SlipCase]
    seeds: int
    result: Drive
    estimate: dict[str, Floats]  # by MEASURED, (T, N, 2)
    acceleration: Floats  # (T, N) dv/dt [m/s^2]


def estimated_slips(
    observations: NDArray[np.float32], parameters: PlantParameters, sensors: Sensors, velocity: bool
) -> tuple[Floats, Floats]:
    """Slips i_L, i_R of the filter and their variances, (T, N, 2) each.

    observations: (T, N, SIZE). velocity: whether the filter measures velocities and yaw rate too;
    without them z = [X, Y, yaw], as in the paper.
    """
    steps, count = observations.shape[:2]
    reader = ObservationReader(PERIOD, count)
    observer = SlipObserver(parameters, PERIOD, DataSheet.of(sensors), count, velocity=velocity)
    slips, variances = np.empty((2, steps, count, 2))
    for k, observation in enumerate(observations):
        observer.update(reader.read(observation).latest)
        slips[k], variances[k] = observer.slips_and_variances()
    return slips, variances


def slip_runs(
    cases: Sequence[SlipCase] = tuple(SLIP_CASES), seeds: int = SEEDS, duration: float = DURATION
) -> Slips:
    """Drive every case and filter what was observed."""
    rows = [
        {
            "reference": manoeuvre(**SPEEDS[case.speed]),
            "soil": SOILS[case.soil],
            "sensors": {"pose_rate": case.rate},
        }
        for case in cases
        for _ in range(seeds)
    ]
    result = drive(rows, "strawa", duration)
    estimate = {
        name: estimated_slips(result.observations, TRUE, PRESETS["strawa"], velocity)[0]
        for name, velocity in MEASURED.items()
    }
    speed = result.truth["v_x"]
    return Slips(list(cases), seeds, result, estimate, np.gradient(speed, PERIOD, axis=0))


class SlipQuality(NamedTuple):
    """Error of the slip of one track over all windows of one kind [-]."""

    bias: float
    uncertainty: float  # standard error of the bias, from the spread between the vehicles
    rms: float
    true: float  # mean of the true slip


def windows(slips: Slips, case: int, rapid: bool) -> NDArray[np.bool_]:
    """(T, seeds) whether the sample belongs to a window of rapid change, or of steady speed."""
    part = slice(case * slips.seeds, (case + 1) * slips.seeds)
    rate = np.abs(slips.acceleration[:, part])
    inside = rate > RAPID if rapid else rate < STEADY
    inside[slips.result.time < BEGUN] = False
    return np.asarray(inside)


def slip_quality(slips: Slips, case: int, measured: str, side: str, rapid: bool) -> SlipQuality:
    """Numbers of one case; nan where it has no such window."""
    part = slice(case * slips.seeds, (case + 1) * slips.seeds)
    truth = slips.result.truth[f"slip_{side}"][:, part]
    error = slips.estimate[measured][:, part, SIDES.index(side)] - truth
    inside = windows(slips, case, rapid)
    if not inside.any():
        return SlipQuality(*(4 * [float("nan")]))
    means = np.array([error[inside[:, k], k].mean() for k in range(slips.seeds)])
    spread = float(means.std(ddof=1) / np.sqrt(slips.seeds)) if slips.seeds > 1 else 0.0
    return SlipQuality(float(means.mean()), spread, rms(error[inside]), float(truth[inside].mean()))


# The method of 7.3 as printed

WINDOW = 50  # [control steps] 8.3.3
ITERATIONS = 20  # at most, 8.3.3
CONVERGED = 1e-6  # [-] relative step; the paper names none


class Fit(NamedTuple):
    """Time histories (T,)."""

    effort_maximum: Floats  # [N]
    modulus: Floats  # [m] K
    iterations: Floats
    converged: NDArray[np.bool_]


def printed_gnr(
    slip: Floats,
    effort: Floats,
    contact_length: float,
    first_guess: tuple[float, float],
    window: int = WINDOW,
) -> Fit:
    """Fit every window of slip [-] and effort tau / r [N], both (T, 2) for left and right.

    Samples with an effort and slip of opposite sign or without slip are left out.
    """
    steps = len(slip)
    fit = Fit(np.empty(steps), np.empty(steps), np.zeros(steps), np.zeros(steps, dtype=bool))
    last = first_guess
    for k in range(steps):
        rows = slice(max(k + 1 - window, 0), k + 1)
        distance, force = np.abs(slip[rows].ravel()) * contact_length, effort[rows].ravel()
        valid = (slip[rows].ravel() * force > 0.0) & (distance > 1e-12)
        solution, count, success = _newton(distance[valid], np.abs(force[valid]), last)
        last = solution if success else last
        fit.effort_maximum[k], fit.modulus[k] = last
        fit.iterations[k], fit.converged[k] = count, success
    return fit


def _newton(
    distance: Floats, force: Floats, guess: tuple[float, float]
) -> tuple[tuple[float, float], int, bool]:
    """(F_max, K), iterations, converged; distance = |i| l [m]."""
    maximum, modulus = guess
    if distance.size < 2:
        return guess, 0, False
    for count in range(1, ITERATIONS + 1):
        u = distance / modulus
        decay = np.exp(-u)
        share = 1.0 + np.expm1(-u) / u  # df/dF_max
        slope = maximum * (decay + np.expm1(-u) / u) / modulus  # df/dK
        residual = maximum * share - force
        a, b, c = float(share @ share), float(share @ slope), float(slope @ slope)
        determinant = a * c - b * b
        if not determinant > 1e-12 * a * c:
            return guess, count, False
        p, q = float(share @ residual), float(slope @ residual)
        step = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        maximum, modulus = maximum - step[0], modulus - step[1]
        if not (0.0 < maximum < 1e7 and 1e-5 < modulus < 10.0):
            return guess, count, False
        if abs(step[0]) < CONVERGED * maximum and abs(step[1]) < CONVERGED * modulus:
            return (maximum, modulus), count, True
    return guess, ITERATIONS, False


# Soil

CHANGES = (10.0, 20.0)  # [s]
RECOVERY = 1.0  # [s] after a change; the window of fifty samples takes 0.5 s
SECOND = {"cohesion": 15e3, "shear_deformation_modulus": 0.01}
THIRD = {"cohesion": 12e3, "shear_deformation_modulus": 0.03}
SCHEDULE: list[Event] = [
    *ramp_events(SECOND, CHANGES[0], 0.0),
    *ramp_events(THIRD, CHANGES[1], 0.0),
]
GROUNDS: dict[str, dict[str, Any]] = {
    "changing": {"soil": LOAM, "schedule": SCHEDULE},
    "heavy clay": {"soil": {}, "schedule": []},
}
WAYS = {"circle": PATHS["circle"], "manoeuvre": manoeuvre()}
SENSORS = ("ideal", "rtk", "strawa")
FIRST_GUESS = (20e3, 0.015)  # F_max [N], K [m] of every method, wrong on every ground
NOISES = (0.0, 1e-5, 1e-4, 1e-3)  # [-] sigma of white noise on the slips
WINDOWS = (5, 15, 50, 150)  # [control steps] around the fifty of the paper
WINDOW_NOISE = 1e-4  # [-] sigma of the slips, with which the windows are compared


class Case(NamedTuple):
    """One vehicle."""

    way: str
    ground: str


CASES = [Case(way, ground) for ground in GROUNDS for way in WAYS]


class Soil(NamedTuple):
    """Estimates of one method in every case."""

    time: Floats  # (T,)
    true_effort: Floats  # (T, N) [N]
    true_modulus: Floats  # (T, N) [m]
    effort: Floats  # (T, N) estimated
    modulus: Floats
    iterations: Floats  # (T, N)
    converged: NDArray[np.bool_]
    ratio_only: NDArray[np.bool_]  # (T, N) only F_max / K is determined
    slip: Floats  # (T, N, 2) true
    force: Floats  # (T, N, 2) [N] true efforts


def true_maximum(truth: Mapping[str, Floats]) -> Floats:
    """F_max of one track, (T, N) [N]."""
    of_each: Any = np.vectorize(terramechanics.maximum_tractive_effort, otypes=[np.float64])
    cohesion, angle, mass = (truth[name] for name in ("cohesion", "friction_angle", "mass"))
    return np.asarray(of_each(cohesion, angle, TRUE.track_width, TRUE.contact_length, mass))


def parameters_of_guess() -> PlantParameters:
    """Nominal parameters, but for a soil with the F_max and K of FIRST_GUESS."""
    nominal = plant_parameters()
    width, length = nominal.track_width, nominal.contact_length
    of_friction = terramechanics.maximum_tractive_effort(
        0.0, nominal.friction_angle, width, length, nominal.mass
    )
    cohesion = (FIRST_GUESS[0] - of_friction) / (width * length)
    return nominal._replace(cohesion=cohesion, shear_deformation_modulus=FIRST_GUESS[1])


def estimated_soil(result: Drive, slips: Floats, variances: Floats, sensors: str) -> dict[str, Any]:
    """Estimates of this project's estimator, (T, N), by their names in Soil.

    slips, variances: (T, N, 2); with ideal sensors the true ones, else those of the filter, whose
    errors are correlated in time.
    """
    count = slips.shape[1]
    reader, sheet = ObservationReader(PERIOD, count), DataSheet.of(PRESETS[sensors])
    steps = 1.0 if sensors == "ideal" else SLIP_CORRELATION
    soil = SoilEstimator(
        parameters_of_guess(), PERIOD, sheet, count, window=WINDOW, correlation_steps=steps
    )
    rows = []
    for observation, slip, variance in zip(result.observations, slips, variances, strict=True):
        soil.provide_slip(slip, variance)
        estimate = soil.update(reader.read(observation).latest)
        values = (estimate.of(name) for name in ("effort_maximum", "shear_deformation_modulus"))
        flags = soil.iterations.astype(np.float64), soil.converged.copy(), soil.ratio_only.copy()
        rows.append((*values, *flags))
    names = ("effort", "modulus", "iterations", "converged", "ratio_only")
    return dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))


def run_all(cases: Sequence[Case] = tuple(CASES), duration: float = DURATION) -> dict[str, Soil]:
    """Every method on every case; by name of the method."""
    methods = {}
    for sensors in SENSORS:
        rows = [{"reference": WAYS[case.way], **GROUNDS[case.ground]} for case in cases]
        result = drive(rows, sensors, duration)
        truth = result.truth
        slip, force = (
            np.stack([truth[f"{name}_{side}"] for side in SIDES], axis=-1)
            for name in ("slip", "effort")
        )
        measured, variances = slip, np.zeros_like(slip)
        if sensors != "ideal":
            guess = parameters_of_guess()
            measured, variances = estimated_slips(
                result.observations, guess, PRESETS[sensors], True
            )
        estimates = estimated_soil(result, measured, variances, sensors)
        true = true_maximum(truth), truth["shear_deformation_modulus"]
        methods[sensors] = Soil(result.time, *true, slip=slip, force=force, **estimates)
    exact = methods["ideal"]
    methods["printed"] = _printed(exact, range(len(cases)), exact.slip)
    return methods


def _printed(exact: Soil, cases: Sequence[int], slip: Floats, window: int = WINDOW) -> Soil:
    """The method as printed on the true efforts of some cases, with their slips (T, C, 2)."""
    cases = list(cases)
    force, length = exact.force[:, cases], TRUE.contact_length
    fits = [
        printed_gnr(slip[:, k], force[:, k], length, FIRST_GUESS, window) for k in range(len(cases))
    ]
    effort, modulus, iterations, converged = (
        np.stack(column, axis=-1) for column in zip(*fits, strict=True)
    )
    return Soil(
        exact.time, exact.true_effort[:, cases], exact.true_modulus[:, cases], effort, modulus,
        iterations, converged, np.zeros(effort.shape, dtype=bool), slip, force,
    )  # fmt: skip


def noisy(exact: Soil, case: int, sigma: float, window: int = WINDOW) -> Soil:
    """The printed method on one case of `exact`, slips with white noise sigma [-]."""
    slip = exact.slip[:, [case]]
    noise = np.random.default_rng(0).standard_normal(slip.shape)
    return _printed(exact, [case], slip + sigma * noise, window)


class Quality(NamedTuple):
    """Relative errors [-] of one case."""

    effort: float  # F_max: rms more than RECOVERY after a change
    modulus: float
    stiffness: float  # of F_max l / (2 K)
    adapted: float  # [s] longest time after a change until F_max and K are within 10 % for good
    iterations: float  # mean
    most_iterations: float
    failed: float  # part of the steps without convergence
    error_converged: float  # rms of the error of F_max over converged steps
    error_failed: float  # and over the others, nan when there are none
    ratio_only: float  # part of the time after RECOVERY


def quality(soil: Soil, case: int) -> Quality:
    """Numbers of one case."""
    effort = soil.effort[:, case] / soil.true_effort[:, case] - 1.0
    modulus = soil.modulus[:, case] / soil.true_modulus[:, case] - 1.0
    true_stiffness = soil.true_effort[:, case] / soil.true_modulus[:, case]
    stiffness = soil.effort[:, case] / soil.modulus[:, case] / true_stiffness - 1.0
    starts = [0.0, *(time for time in CHANGES if np.ptp(soil.true_modulus[:, case]) > 0.0)]
    calm, longest = np.ones(len(effort), dtype=bool), 0.0
    for start, end in zip(starts, [*starts[1:], math.inf], strict=True):
        rows = (soil.time >= start - 1e-9) & (soil.time < end - 1e-9)
        calm &= ~(rows & (soil.time < start + RECOVERY))
        outside = (np.maximum(np.abs(effort), np.abs(modulus)) > 0.1)[rows]
        last = outside.nonzero()[0]
        if last.size == 0:
            continue
        never = last[-1] == len(outside) - 1
        longest = math.inf if never else max(longest, (last[-1] + 1) * PERIOD)
    valid = soil.iterations[:, case] > 0
    success = soil.converged[:, case]

    return Quality(
        rms(effort[calm]), rms(modulus[calm]), rms(stiffness[calm]), longest,
        float(soil.iterations[valid, case].mean()), float(soil.iterations[:, case].max()),
        float(1.0 - success.mean()), rms(effort[success]), rms(effort[~success]),
        float(soil.ratio_only[calm, case].mean()),
    )  # fmt: skip
