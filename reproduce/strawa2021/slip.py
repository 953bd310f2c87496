"""Section 8.3.2: the unscented Kalman filter for the slips, under the paper's noise.

The paper says that the filter is unbiased except on rapid changes of speed (figure 33), and states
neither the path nor the rates of the sensors. Chosen: the manoeuvre of 8.3.1 with a gentle speed (2
+- 0.2 m/s, at most 0.3 m/s^2) and a brisk one (2 +- 1 m/s, up to 3.1 m/s^2), each on heavy clay,
where the slip is a fraction of a percent, and on sandy loam; all sensors at 100 Hz, and the pose at
lower rates as well. As in the paper, controller and filter receive noisy measurements; the
controller has the true parameters. The measurement is z = [X, Y, yaw] as in the paper, or
velocities and yaw rate as well.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.measurement import DataSheet, ObservationReader
from baselines.estimators.slip_observer import SlipObserver
from reproduce.strawa2021.control import ICR_FORWARD, PERIOD, SCENARIOS, Drive, Floats, drive, rms
from reproduce.strawa2021.identification import SPEED, filtered_policy, manoeuvre
from tracked_env.physics.parameters import LateralModelParameters, PlantParameters, plant_parameters
from tracked_env.sensors import PRESETS, Sensors

DURATION = 30.0  # [s]
BEGUN = 5.0  # [s] from here on the initial error of the filter has decayed
STEADY, RAPID = 0.4, 2.0  # [m/s^2] of |dv/dt|: below steady, above rapid
SEEDS = 8  # vehicles per case
SPEEDS = {  # amplitude [m/s] and period [s] of the speed
    "gentle": {"amplitude": 0.2, "period": 4.0},
    "brisk": {"amplitude": 1.0, "period": 2.0},
}
SOILS: dict[str, dict[str, Any]] = {
    "heavy clay": {},
    "sandy loam": SCENARIOS["sandy-loam"].options["soil"],
}
RATES = (100.0, 50.0, 20.0, 10.0)  # [Hz] of the pose
MEASURED = {"pose": False, "pose and velocities": True}
SIDES = ("left", "right")


class Case(NamedTuple):
    """One vehicle on one soil with one rate of the pose."""

    speed: str
    soil: str
    rate: float


CASES = [
    *(Case(speed, soil, RATES[0]) for speed in SPEEDS for soil in SOILS),
    *(Case("gentle", "sandy loam", rate) for rate in RATES[1:]),
]


class Slips(NamedTuple):
    """Estimates of one batch: SEEDS vehicles per case, in the order of `cases`."""

    cases: list[Case]
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
        slips[k], variances[k] = observer.slips, observer.slip_variances
    return slips, variances


def run_all(
    cases: list[Case] | None = None, seeds: int = SEEDS, duration: float = DURATION
) -> Slips:
    """Drive every case and filter what was observed."""
    chosen = CASES if cases is None else cases
    lateral_model = LateralModelParameters(turning_resistance_factor=1.0, icr_forward=ICR_FORWARD)
    parameters = plant_parameters(lateral_model=lateral_model)
    rows = [
        {
            "reference": manoeuvre(**SPEEDS[case.speed]),
            "soil": SOILS[case.soil],
            "vehicle": {"drive_time_constant": 0.0},
            "lateral_model": lateral_model._asdict(),
            "sensors": {"pose_rate": case.rate},
            "start": {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0, "speed": SPEED},
        }
        for case in chosen
        for _ in range(seeds)
    ]
    sensors = PRESETS["strawa"]
    policy = filtered_policy(parameters, sensors, "fixed")
    result = drive(policy, rows, duration, "strawa", keep=True)
    estimate = {
        name: estimated_slips(result.observations, parameters, sensors, velocity)[0]
        for name, velocity in MEASURED.items()
    }
    speed = result.truth["v_x"]
    return Slips(chosen, seeds, result, estimate, np.gradient(speed, PERIOD, axis=0))


class Quality(NamedTuple):
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


def quality(slips: Slips, case: int, measured: str, side: str, rapid: bool) -> Quality:
    """Numbers of one case; nan where it has no such window."""
    part = slice(case * slips.seeds, (case + 1) * slips.seeds)
    truth = slips.result.truth[f"slip_{side}"][:, part]
    error = slips.estimate[measured][:, part, SIDES.index(side)] - truth
    inside = windows(slips, case, rapid)
    if not inside.any():
        return Quality(*(4 * [float("nan")]))
    means = np.array([error[inside[:, k], k].mean() for k in range(slips.seeds)])
    spread = float(means.std(ddof=1) / np.sqrt(slips.seeds)) if slips.seeds > 1 else 0.0
    return Quality(float(means.mean()), spread, rms(error[inside]), float(truth[inside].mean()))
