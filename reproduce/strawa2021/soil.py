"""Section 8.3.3: F_max and K of the soil, and their observability on firm ground.

The paper names neither soil nor path. Chosen: circle (R = 10 m, 2 m/s, steady) and manoeuvre
(8.3.1), turning factor 1, over three grounds that follow each other in time: sandy loam of 8.2.3,
at 10 s a stiffer and stronger one, at 20 s a softer one; and over heavy clay (Table 2). Slips and
torques are the true ones, as the accuracy of the paper suggests, or measured: torque with the
noise of the sensors and slip from the UKF.

The generalised Newton-Raphson method of section 7.3 as it is printed, for one vehicle.

For the last fifty control steps (`window`), both tracks, f = F_max g(K) - tau / r with
g = 1 - K / (i l) (1 - exp(-i l / K)); (F_max, K) <- (F_max, K) - J^+ f, J the printed derivatives,
J^+ the least-squares inverse, at most twenty times; not converged -> the last converged values.
No weights, no damping, no prior: what the estimators of this project add.

References: [1] Strawa et al., Electronics 10 (2021) 187, 7.3 and 8.3.3.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.measurement import DataSheet, ObservationReader
from baselines.estimators.soil_estimator import SLIP_CORRELATION, SoilEstimator
from reproduce.strawa2021.control import ICR_FORWARD, PATHS, PERIOD, SCENARIOS, Drive, drive, rms
from reproduce.strawa2021.control import Floats as Floats_drive
from reproduce.strawa2021.identification import SPEED, filtered_policy, manoeuvre
from reproduce.strawa2021.slip import estimated_slips
from tracked_env.events import Event, ramp_events
from tracked_env.physics import terramechanics
from tracked_env.physics.parameters import LateralModelParameters, PlantParameters, plant_parameters
from tracked_env.sensors import PRESETS

Floats = NDArray[np.float64]

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
    known = first_guess
    for k in range(steps):
        rows = slice(max(k + 1 - window, 0), k + 1)
        distance, force = np.abs(slip[rows].ravel()) * contact_length, effort[rows].ravel()
        used = (slip[rows].ravel() * force > 0.0) & (distance > 1e-12)
        found, count, done = _newton(distance[used], np.abs(force[used]), known)
        if done:
            known = found
        fit.effort_maximum[k], fit.modulus[k] = known
        fit.iterations[k], fit.converged[k] = count, done
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


DURATION = 30.0  # [s]
CHANGES = (10.0, 20.0)  # [s]
RECOVERY = 1.0  # [s] after a change; the window of fifty samples takes 0.5 s
LOAM: dict[str, float] = SCENARIOS["sandy-loam"].options["soil"]
GROUNDS: dict[str, tuple[dict[str, float], list[Event]]] = {
    "changing": (
        LOAM,
        [
            *ramp_events({"cohesion": 15e3, "shear_deformation_modulus": 0.01}, CHANGES[0], 0.0),
            *ramp_events({"cohesion": 12e3, "shear_deformation_modulus": 0.03}, CHANGES[1], 0.0),
        ],
    ),
    "heavy clay": ({}, []),
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

    method: str
    time: Floats_drive  # (T,)
    true_effort: Floats_drive  # (T, N) [N]
    true_modulus: Floats_drive  # (T, N) [m]
    effort: Floats_drive  # (T, N) estimated
    modulus: Floats_drive
    iterations: Floats_drive  # (T, N)
    converged: NDArray[np.bool_]
    ratio_only: NDArray[np.bool_]  # (T, N) only F_max / K is determined
    slip: Floats_drive  # (T, N, 2) true
    force: Floats_drive  # (T, N, 2) [N] true efforts


def _drive(sensors: str, cases: Sequence[Case], duration: float) -> Drive:
    lateral_model = LateralModelParameters(turning_resistance_factor=1.0, icr_forward=ICR_FORWARD)
    rows: list[dict[str, Any]] = [
        {
            "reference": WAYS[case.way],
            "soil": GROUNDS[case.ground][0],
            "schedule": GROUNDS[case.ground][1],
            "vehicle": {"drive_time_constant": 0.0},
            "lateral_model": lateral_model._asdict(),
            "start": {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0, "speed": SPEED},
        }
        for case in cases
    ]
    policy = filtered_policy(
        plant_parameters(lateral_model=lateral_model), PRESETS[sensors], "fixed"
    )
    return drive(policy, rows, duration, sensors, keep=True)


def true_maximum(result: Drive) -> Floats_drive:
    """F_max of one track, (T, N) [N]."""
    truth, nominal = result.truth, plant_parameters()
    of_each: Any = np.vectorize(terramechanics.maximum_tractive_effort, otypes=[np.float64])
    return np.asarray(
        of_each(
            truth["cohesion"],
            truth["friction_angle"],
            nominal.track_width,
            nominal.contact_length,
            truth["mass"],
        )
    )


def parameters_of_guess() -> PlantParameters:
    """Nominal parameters, but for a soil with the F_max and K of FIRST_GUESS."""
    nominal = plant_parameters()
    of_friction = terramechanics.maximum_tractive_effort(
        0.0, nominal.friction_angle, nominal.track_width, nominal.contact_length, nominal.mass
    )
    return nominal._replace(
        cohesion=(FIRST_GUESS[0] - of_friction) / (nominal.track_width * nominal.contact_length),
        shear_deformation_modulus=FIRST_GUESS[1],
    )


def estimated_soil(
    result: Drive, slips: Floats_drive, variances: Floats_drive, sensors: str
) -> dict[str, Floats_drive]:
    """Estimates of this project's estimator by name, (T, N): F_max [N], K [m], iterations, and the
    flags `converged` and `ratio_only`, 0 or 1.

    slips, variances: (T, N, 2); with ideal sensors the true ones, else those of the filter, whose
    errors are correlated in time.
    """
    count = slips.shape[1]
    reader = ObservationReader(PERIOD, count)
    soil = SoilEstimator(
        parameters_of_guess(),
        PERIOD,
        DataSheet.of(PRESETS[sensors]),
        count,
        residual="total",
        correlation_steps=1.0 if sensors == "ideal" else SLIP_CORRELATION,
    )
    rows: list[dict[str, Floats_drive]] = []
    for observation, slip, variance in zip(result.observations, slips, variances, strict=True):
        soil.provide_slip(slip, variance)
        estimate = soil.update(reader.read(observation).latest)
        flags = {"converged": soil.converged, "ratio_only": soil.ratio_only}
        rows.append(
            {name: estimate.of(name) for name in estimate.names}
            | {"iterations": soil.iterations.astype(np.float64)}
            | {name: flag.astype(np.float64) for name, flag in flags.items()}
        )
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def run_all(cases: Sequence[Case] = tuple(CASES), duration: float = DURATION) -> dict[str, Soil]:
    """Every method on every case; by name of the method."""
    found = {}
    for sensors in SENSORS:
        result = _drive(sensors, cases, duration)
        slip = np.stack([result.truth["slip_left"], result.truth["slip_right"]], axis=-1)
        force = np.stack([result.truth["effort_left"], result.truth["effort_right"]], axis=-1)
        common = (result.time, true_maximum(result), result.truth["shear_deformation_modulus"])
        if sensors == "ideal":
            seen, variances = slip, np.zeros_like(slip)
        else:
            seen, variances = estimated_slips(
                result.observations, parameters_of_guess(), PRESETS[sensors], velocity=True
            )
        rows = estimated_soil(result, seen, variances, sensors)
        found[sensors] = Soil(
            sensors, *common, rows["effort_maximum"], rows["shear_deformation_modulus"],
            rows["iterations"], rows["converged"] > 0.5, rows["ratio_only"] > 0.5, slip, force,
        )  # fmt: skip
    found["printed"] = _printed(found["ideal"], range(len(cases)), found["ideal"].slip)
    return found


def _printed(exact: Soil, cases: Sequence[int], slip: Floats_drive, window: int = WINDOW) -> Soil:
    """The method as printed on the true efforts of some cases and the slips given."""
    length, cases = plant_parameters().contact_length, list(cases)
    fits = [
        printed_gnr(slip[:, k], exact.force[:, i], length, FIRST_GUESS, window)
        for k, i in enumerate(cases)
    ]
    maximum, modulus, iterations = (
        np.stack([np.asarray(fit[k], dtype=np.float64) for fit in fits], axis=-1) for k in range(3)
    )
    converged = np.stack([fit.converged for fit in fits], axis=-1)
    return exact._replace(
        method="printed", true_effort=exact.true_effort[:, cases],
        true_modulus=exact.true_modulus[:, cases], effort=maximum, modulus=modulus,
        iterations=iterations, converged=converged,
        ratio_only=np.zeros(maximum.shape, dtype=bool), slip=slip, force=exact.force[:, cases],
    )  # fmt: skip


def with_noise(exact: Soil, case: int) -> dict[float, Soil]:
    """The printed method on one case of `exact`, slips with white noise, by its sigma [-]."""
    noise = np.random.default_rng(0).standard_normal(exact.slip[:, [case]].shape)
    return {
        sigma: _printed(exact, [case], exact.slip[:, [case]] + sigma * noise) for sigma in NOISES
    }


def by_window(exact: Soil, case: int, sigma: float = WINDOW_NOISE) -> dict[int, Soil]:
    """The printed method on one case of `exact`, by its window; slips with white noise sigma."""
    noise = np.random.default_rng(0).standard_normal(exact.slip[:, [case]].shape)
    slip = exact.slip[:, [case]] + sigma * noise
    return {window: _printed(exact, [case], slip, window) for window in WINDOWS}


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
    used = soil.iterations[:, case] > 0
    done = soil.converged[:, case]

    return Quality(
        rms(effort[calm]), rms(modulus[calm]), rms(stiffness[calm]), longest,
        float(soil.iterations[used, case].mean()), float(soil.iterations[:, case].max()),
        float(1.0 - done.mean()), rms(effort[done]), rms(effort[~done]),
        float(soil.ratio_only[calm, case].mean()),
    )  # fmt: skip
