"""Sections 8.1 and 8.2 of Strawa et al. (2021) as scenarios that can be run again, and figure 17.

The paper states neither the radius, nor the speed, nor the place of its circle; chosen here: R =
10 m around the origin of the maps, 2 m/s, start 1 m to the side at 0.3 m/s, ideal sensors, no motor
lag, the lateral constraint of S (28). S (20) is run with the printed factor 2 and with 1, the
factor of its integral. Figure 17: the RMSE over a run is that of the distance to the vehicle whose
controller knows mass and inertia; all grid points are one batch, a controller with its own
parameters per vehicle, on the paths of 8.2.1 and the manoeuvre of 8.3.1.

Row k of every history of `drive` belongs to the time k h, h the control period: the true state
then, and the estimates of the policy after the observation of that time.

References: [S] Strawa et al., Electronics 10 (2021) 187.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from tracked_env.arrays import columns
from tracked_env.benchmark.policy_interface import Policy
from tracked_env.env import TrackedVehicleEnv
from tracked_env.events import Event
from tracked_env.physics.parameters import (
    PARAMETER_NAMES,
    PARAMETER_ROWS,
    STATE_NAMES,
    STATE_ROWS,
    LateralModelParameters,
    PlantParameters,
    plant_parameters,
)
from tracked_env.uncertainty import STRAWA_MAPS
from tracked_env.vector_env import TrackedVehicleVectorEnv

Floats = NDArray[np.float64]

CONTROL_RATE = 100.0  # [Hz] the paper's step is 0.01 s
PERIOD = 1.0 / CONTROL_RATE  # [s]
ICR_FORWARD = 0.2  # [m] d of the constrained runs; the paper names none
SETTLED = 30.0  # [s] from here on a run counts as steady
SIDES = ("left", "right")
_REFERENCE = columns(("reference_x", "reference_y"))
STRAIGHT = 7.0  # [s] length of the straight part of the manoeuvre
SPEED = 2.0  # [m/s]
FACTORS = np.linspace(0.5, 1.5, 11)  # [-] of the true value; the middle one is right

PATHS: dict[str, dict[str, Any]] = {
    # A circle of 10 m around the origin, entered at its lowest point.
    "circle": {"kind": "circle", "radius": 10.0, "speed": SPEED, "x": 0.0, "y": -10.0, "yaw": 0.0},
    "straight": {"kind": "straight", "speed": SPEED},
}
START = {"offset_x": 0.0, "offset_y": 1.0, "offset_yaw": 0.0, "speed": 0.3, "yaw_rate": 0.0}
ON_PATH = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0, "speed": SPEED}
NO_LAG = {"drive_time_constant": 0.0}  # of the vehicle


def manoeuvre(
    speed: float = SPEED,
    radius_end: float = 6.0,
    amplitude: float = 0.2,
    period: float = 4.0,
    start: float | None = None,
) -> Event:
    """The reference of 8.3: along +Y, then a spiral to the left; the speed oscillates.

    start [m/s]: speed at the beginning, `speed` unless given.
    """
    return {
        "kind": "identification", "speed": speed,
        "initial_speed": speed if start is None else start,
        "straight_duration": STRAIGHT, "radius_end": radius_end,
        "speed_amplitude": amplitude, "speed_period": period,
        "x": 0.0, "y": 0.0, "yaw": 0.5 * math.pi,
    }  # fmt: skip


WAYS: dict[str, Any] = {**PATHS, "manoeuvre": manoeuvre()}


class Drive(NamedTuple):
    """Time histories of N vehicles over T control steps, SI units."""

    time: Floats  # (T,)
    truth: dict[str, Floats]  # (T, N) by name of state or parameter
    reference: Floats  # (T, N, 2) [m]
    error: Floats  # (T, N) distance to the reference [m]
    belief: dict[str, Floats]  # (T, N) estimates by name, empty when the policy has none
    observations: NDArray[np.float32]  # (T, N, SIZE), empty unless asked for

    def rmse(self, start: float = 0.0) -> Floats:
        """Root mean square distance to the reference from `start` [s] on, (N,) [m]."""
        late = self.error[self.time >= start]
        return np.asarray(np.sqrt(np.mean(late**2, axis=0)))


def drive(
    policy: Policy,
    rows: Sequence[Mapping[str, Any]],
    duration: float,
    sensors: str | Mapping[str, Any] = "ideal",
    lateral: str = "constrained",
    seed: int = 0,
    keep: bool = False,
) -> Drive:
    """Drive one vehicle per entry of `rows` (options of reset), all by `policy`.

    policy: its `estimates`, where it has them, are kept. duration [s]. sensors: of all rows, which
    their options may change. seed: row i has seed + i. keep: whether the observations are kept.
    Raises ValueError for options that are unknown or out of range.
    """
    count, steps = len(rows), round(duration * CONTROL_RATE)
    env = TrackedVehicleVectorEnv(
        count, reference="straight", uncertainty="nominal", sensors=sensors,
        duration=duration + 1.0, control_rate=CONTROL_RATE, lateral=lateral, error_limit=1e3,
    )  # fmt: skip
    observation, _ = env.reset(seed=seed, options={"rows": [dict(row) for row in rows]})
    truth = np.empty((steps, STATE_ROWS + PARAMETER_ROWS, count))
    reference = np.empty((steps, count, 2))
    kept = np.empty((steps if keep else 0, *observation.shape), dtype=np.float32)
    belief: dict[str, Floats] = {}
    state: Any = None
    for k in range(steps):
        batch = env.simulation.batch
        truth[k, :STATE_ROWS] = batch.state().T
        truth[k, STATE_ROWS:] = batch.parameters().T
        reference[k] = batch.floats[:, _REFERENCE]
        if keep:
            kept[k] = observation
        action, state = policy.predict(observation, state)
        if hasattr(policy, "estimates"):
            for name, (value, _) in policy.estimates().items():
                belief.setdefault(name, np.empty((steps, count)))[k] = value
        observation = env.step(action)[0]
    env.close()
    by_name = dict(zip((*STATE_NAMES, *PARAMETER_NAMES), truth.transpose(1, 0, 2), strict=True))
    error: Floats = np.hypot(reference[:, :, 0] - by_name["x"], reference[:, :, 1] - by_name["y"])
    time: Floats = np.arange(steps, dtype=np.float64) * PERIOD
    return Drive(time, by_name, reference, error, belief, kept)


def rms(values: Floats) -> float:
    """Root mean square of all values; nan of none."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan


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

    time: Floats
    error: Floats  # distance to the reference [m]
    truth: dict[str, Floats]
    reference: Floats  # (2, T) [m]
    sprocket_torque: Floats  # (2, T) demanded, left and right [N m]
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


def run(scenario: Scenario, path: str, turning_factor: float, duration: float = 60.0) -> Run:
    """Drive one scenario on "circle" or "straight" for `duration` [s]."""
    env = TrackedVehicleEnv(
        reference=PATHS[path], uncertainty="nominal", sensors="ideal", duration=duration,
        control_rate=CONTROL_RATE, lateral=scenario.lateral, error_limit=1e3, expose_truth=True,
    )  # fmt: skip
    options = {
        **scenario.options,
        "vehicle": NO_LAG,
        "lateral_model": lateral_model_options(turning_factor, scenario.lateral),
        "start": START,
    }
    believed = believed_parameters(scenario, turning_factor)
    policy = FeedbackLinearizingController(believed, PERIOD, lateral=scenario.lateral)
    observation, _ = env.reset(seed=0, options=options)
    state: Any = None
    rows, errors, references, demands = [], [], [], []
    ended = False
    while not ended:
        action, state = policy.predict(observation, state)
        observation, _, terminated, truncated, info = env.step(action)
        truth, ended = info["truth"], terminated or truncated
        rows.append(list(truth.values()))
        errors.append(info["tracking_error"][0])
        demands.append(np.clip(action, -1.0, 1.0) * truth["torque_limit"])
        references.append(env.simulation.reference_position(0))
    error = np.array(errors, dtype=np.float64)
    time = np.array([PERIOD * (k + 1) for k in range(len(errors))], dtype=np.float64)
    late = error[time >= SETTLED]
    return Run(
        time, error, dict(zip(truth, np.array(rows).T, strict=True)), np.array(references).T,
        np.array(demands).T, rms(late), float(late.max()) if late.size else math.nan,
    )  # fmt: skip


def run_all(duration: float = 60.0) -> dict[tuple[str, str, float], Run]:
    """Every scenario on both paths with each turning factor: {(scenario, path, factor): Run}."""
    return {
        (name, path, factor): run(scenario, path, factor, duration)
        for name, scenario in SCENARIOS.items()
        for path in PATHS
        for factor in scenario.turning_factors
    }


class Surface(NamedTuple):
    """RMSE [m] over mass (rows) and inertia (columns): assumed by the controller over true."""

    factors: Floats
    rmse: Floats  # (F, F)

    def along(self) -> tuple[float, float]:
        """Largest RMSE with only the mass wrong, and with only the inertia wrong [m]."""
        middle = len(self.factors) // 2
        return float(self.rmse[:, middle].max()), float(self.rmse[middle].max())


def surface(
    way: str, turning_factor: float, factors: Floats = FACTORS, duration: float = 30.0
) -> Surface:
    """The grid for one path. factors: odd in number, the middle one 1."""
    believed = believed_parameters(SCENARIOS["exact"], turning_factor)
    mass, inertia = (grid.ravel() for grid in np.meshgrid(factors, factors, indexing="ij"))
    arrays: Any = {"mass": believed.mass * mass, "inertia": believed.inertia * inertia}
    policy = FeedbackLinearizingController(
        believed._replace(**arrays), PERIOD, lateral="constrained"
    )
    row = {
        "reference": WAYS[way],
        "vehicle": NO_LAG,
        "lateral_model": {"turning_resistance_factor": turning_factor, "icr_forward": ICR_FORWARD},
        "start": START,
    }
    truth = drive(policy, [row] * mass.size, duration).truth
    right = mass.size // 2
    square = sum((truth[name] - truth[name][:, [right]]) ** 2 for name in ("x", "y"))
    rmse = np.sqrt(np.mean(square, axis=0))
    return Surface(factors, rmse.reshape(len(factors), len(factors)))


def sweep_all() -> dict[tuple[str, float], Surface]:
    """Every path with both turning factors."""
    return {(way, factor): surface(way, factor) for way in WAYS for factor in (2.0, 1.0)}
