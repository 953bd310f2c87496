"""Sections 8.1 and 8.2 of Strawa et al. (2021) as scenarios that can be run again.

The paper states neither the radius, nor the speed, nor the place of its circle; chosen here: R =
10 m around the origin of the maps, 2 m/s, start 1 m to the side at 0.3 m/s, ideal sensors, no motor
lag, the lateral constraint of S (28). S (20) is run with the printed factor 2 and with 1, the
factor of its integral.

References: [1] Strawa et al., Electronics 10 (2021) 187.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics.parameters import LateralModelParameters, PlantParameters, plant_parameters
from tracked_env.uncertainty import STRAWA_MAPS

ICR_FORWARD = 0.2  # [m] d of the constrained runs; the paper names none
SETTLED = 30.0  # [s] from here on a run counts as steady

PATHS: dict[str, dict[str, Any]] = {
    # A circle of 10 m around the origin, entered at its lowest point.
    "circle": {"kind": "circle", "radius": 10.0, "speed": 2.0, "x": 0.0, "y": -10.0, "yaw": 0.0},
    "straight": {"kind": "straight", "speed": 2.0},
}
START = {"offset_x": 0.0, "offset_y": 1.0, "offset_yaw": 0.0, "speed": 0.3, "yaw_rate": 0.0}


class Scenario(NamedTuple):
    """The true plant, and what the controller assumes of it."""

    section: str
    title: str
    options: dict[str, Any]  # of reset(): the truth where it differs from Tables 1 and 2
    believed: dict[str, float]  # factors of the assumed on the true parameters of Tables 1 and 2
    turning_factors: tuple[float, ...] = (2.0, 1.0)
    lateral: str = "constrained"


SCENARIOS: dict[str, Scenario] = {
    "exact": Scenario("8.1", "all parameters known", {}, {}),
    "mass-inertia": Scenario(
        "8.2.1",
        "controller has 55 % of the mass, 110 % of the inertia",
        {},
        {"mass": 0.55, "inertia": 1.10},
    ),
    "resistance-maps": Scenario(
        "8.2.2", "resistance maps (44), (45)", {"schedule": STRAWA_MAPS}, {}
    ),
    "sandy-loam": Scenario(
        "8.2.3",
        "controller expects heavy clay, soil is sandy loam",
        {"soil": {"cohesion": 9650.0, "friction_angle": math.radians(35.0)}},
        {},
    ),
}


class Run(NamedTuple):
    """Time histories of one run; all shape (T,), SI units."""

    time: NDArray[np.float64]
    error: NDArray[np.float64]  # distance to the reference [m]
    truth: dict[str, NDArray[np.float64]]
    reference: NDArray[np.float64]  # (2, T) [m]
    sprocket_torque: NDArray[np.float64]  # (2, T) demanded, left and right [N m]
    settled_rms: float  # of the error after SETTLED [m]
    settled_max: float


def believed_parameters(scenario: Scenario, turning_factor: float) -> PlantParameters:
    """Parameters that the controller of a scenario assumes."""
    lateral_model = LateralModelParameters(
        turning_resistance_factor=turning_factor, icr_forward=ICR_FORWARD
    )
    nominal = plant_parameters(lateral_model=lateral_model)
    factors = {name: getattr(nominal, name) * f for name, f in scenario.believed.items()}
    return nominal._replace(**factors)


def lateral_model_options(turning_factor: float, lateral: str) -> dict[str, float]:
    """Options of reset for the turning resistance; d exists with the lateral constraint only."""
    if lateral == "sliding":
        return {"turning_resistance_factor": turning_factor}
    return {"turning_resistance_factor": turning_factor, "icr_forward": ICR_FORWARD}


def run(
    scenario: Scenario,
    path: str,
    turning_factor: float,
    duration: float = 60.0,
) -> Run:
    """Drive one scenario on "circle" or "straight" for `duration` [s]."""
    env = TrackedVehicleEnv(
        reference=PATHS[path],
        uncertainty="nominal",
        sensors="ideal",
        duration=duration,
        control_rate=100.0,
        lateral=scenario.lateral,
        error_limit=1e3,
        expose_truth=True,
    )
    options = {
        **scenario.options,
        "vehicle": {"drive_time_constant": 0.0},
        "lateral_model": lateral_model_options(turning_factor, scenario.lateral),
        "start": START,
    }
    policy = FeedbackLinearizingController(
        believed_parameters(scenario, turning_factor), 0.01, lateral=scenario.lateral
    )
    observation, info = env.reset(seed=0, options=options)
    state: Any = None
    rows, errors, references, demands = [], [], [], []
    truncated = terminated = False
    while not (truncated or terminated):
        action, state = policy.predict(observation, state)
        observation, _, terminated, truncated, info = env.step(action)
        truth = info["truth"]
        rows.append(list(truth.values()))
        errors.append(info["tracking_error"][0])
        demands.append(np.clip(action, -1.0, 1.0) * truth["torque_limit"])
        references.append(env.simulation.reference_position(0))
    names = list(info["truth"])
    error = np.array(errors, dtype=np.float64)
    time = np.array([0.01 * (k + 1) for k in range(len(errors))], dtype=np.float64)
    late = error[time >= SETTLED]
    return Run(
        time,
        error,
        dict(zip(names, np.array(rows).T, strict=True)),
        np.array(references).T,
        np.array(demands).T,
        float(np.sqrt(np.mean(late**2))) if late.size else math.nan,
        float(late.max()) if late.size else math.nan,
    )


def run_all(duration: float = 60.0) -> dict[tuple[str, str, float], Run]:
    """Every scenario on both paths with each turning factor: {(scenario, path, factor): Run}."""
    return {
        (name, path, factor): run(scenario, path, factor, duration)
        for name, scenario in SCENARIOS.items()
        for path in PATHS
        for factor in scenario.turning_factors
    }


def table(runs: dict[tuple[str, str, float], Run]) -> list[list[str]]:
    """One line per run, header first: errors after SETTLED, saturation, top slip."""
    lines = [
        ["section", "scenario", "path", "factor of (20)", "rms error [m]", "max error [m]",
         "at the soil's limit", "max slip"],
    ]  # fmt: skip
    for (name, path, factor), result in runs.items():
        truth, late = result.truth, result.time >= 1.0
        limited = np.zeros(late.sum(), dtype=bool)
        slip = 0.0
        for row, side in enumerate(("left", "right")):
            asked = np.abs(result.sprocket_torque[row])
            given = np.abs(truth[f"effort_{side}"] * truth["sprocket_radius"])
            limited |= (asked > given + 1.0)[late]
            slip = max(slip, float(np.abs(truth[f"slip_{side}"][late]).max()))
        lines.append(
            [SCENARIOS[name].section, SCENARIOS[name].title, path, f"{factor:g}",
             f"{result.settled_rms:.2g}", f"{result.settled_max:.2g}",
             f"{100.0 * limited.mean():.0f} %", f"{100.0 * slip:.1f} %"],
        )  # fmt: skip
    return lines
