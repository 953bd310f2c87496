"""Sections 8.1 and 8.2 of Strawa et al. (2021) as scenarios that can be run again, and figure 17.

The paper states neither the radius, nor the speed, nor the place of its circle; chosen here: R =
10 m around the origin of the maps, 2 m/s, start 1 m to the side at 0.3 m/s, ideal sensors, no motor
lag, the lateral constraint of S (28). S (20) is run with the printed factor 2 and with 1, the
factor of its integral. Figure 17: the RMSE over a run is that of the distance to the vehicle whose
controller knows mass and inertia; all grid points are one batch, a controller with its own
parameters per vehicle, on the paths of 8.2.1 and the manoeuvre of 8.3.1.

References: [S] Strawa et al., Electronics 10 (2021) 187.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from reproduce import policy_runs
from reproduce.policy_runs import Drive, Floats
from tracked_env.benchmark.policy_interface import Policy
from tracked_env.events import Event
from tracked_env.physics.parameters import PlantParameters, plant_parameters
from tracked_env.uncertainty import STRAWA_MAPS

RATE = 100.0  # [Hz] of control: the paper's step is 0.01 s
PERIOD = 1.0 / RATE  # [s]
ICR_FORWARD = 0.2  # [m] d of the constrained runs; the paper names none
SETTLED = 30.0  # [s] from here on a run counts as steady
SIDES = ("left", "right")
STRAIGHT = 7.0  # [s] length of the straight part of the manoeuvre
SPEED = 2.0  # [m/s]
TURNING_FACTORS = (2.0, 1.0)  # [-] of S (20): as printed, and of its integral
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

    start [m/s]: speed at the beginning, by default `speed`.
    """
    return {
        "kind": "identification",
        "speed": speed,
        "initial_speed": speed if start is None else start,
        "straight_duration": STRAIGHT,
        "radius_end": radius_end,
        "speed_amplitude": amplitude,
        "speed_period": period,
        **{"x": 0.0, "y": 0.0, "yaw": 0.5 * math.pi},
    }


WAYS: dict[str, Any] = {**PATHS, "manoeuvre": manoeuvre()}


def drive(
    policy: Policy,
    rows: Sequence[Mapping[str, Any]],
    duration: float,
    sensors: str | Mapping[str, Any] = "ideal",
    lateral: str = "constrained",
    keep: bool = False,
) -> Drive:
    """One vehicle without motor lag per entry of `rows` (options of reset), all by `policy`."""
    settings: dict[str, Any] = {"reference": "straight", "sensors": sensors, "lateral": lateral}
    every = [{"vehicle": NO_LAG, **row} for row in rows]
    return policy_runs.drive([(policy, slice(None))], every, duration, RATE, keep=keep, **settings)


def rms(values: Floats) -> float:
    """Root mean square of all values; nan of none."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan


class Scenario(NamedTuple):
    """The true plant, and what the controller assumes of it."""

    options: dict[str, Any]  # of reset(): the truth where it differs from Tables 1 and 2
    assumed: dict[str, float]  # factors of the assumed on the true parameters of Tables 1 and 2


LOAM: dict[str, float] = {"cohesion": 9650.0, "friction_angle": math.radians(35.0)}
SCENARIOS: dict[str, Scenario] = {  # sections and titles in page.toml
    "exact": Scenario({}, {}),
    "mass-inertia": Scenario({}, {"mass": 0.55, "inertia": 1.10}),
    "resistance-maps": Scenario({"schedule": STRAWA_MAPS}, {}),
    "sandy-loam": Scenario({"soil": LOAM}, {}),
}
Case = tuple[str, str, float]  # of SCENARIOS, of PATHS, turning factor
CASES: list[Case] = [
    (name, path, factor) for name in SCENARIOS for path in PATHS for factor in TURNING_FACTORS
]


class Run(Drive):
    """Time histories (T,) of one vehicle at the ends of its control steps."""

    @property
    def settled(self) -> Floats:
        """Distance to the reference after SETTLED [m]."""
        return self.distance[self.time >= SETTLED]

    @property
    def settled_rms(self) -> float:
        """Of that distance [m]."""
        return rms(self.settled)

    @property
    def settled_max(self) -> float:
        """Of that distance [m]; nan of a shorter run."""
        return float(self.settled.max()) if self.settled.size else math.nan


def lateral_model(factor: float, lateral: str = "constrained") -> dict[str, float]:
    """Options of reset for the turning resistance; d exists with the lateral constraint only."""
    constrained = {"icr_forward": ICR_FORWARD} if lateral == "constrained" else {}
    return {"turning_resistance_factor": factor, **constrained}


def assumed_parameters(scenario: str, factor: float) -> PlantParameters:
    """Parameters that the controller of a scenario assumes, with a turning factor."""
    nominal = plant_parameters()._replace(**lateral_model(factor))
    factors = SCENARIOS[scenario].assumed
    return nominal._replace(**{name: getattr(nominal, name) * f for name, f in factors.items()})


def run_all(cases: Sequence[Case] = tuple(CASES), duration: float = 60.0) -> dict[Case, Run]:
    """Every case as one batch, each controller with its own parameters."""
    rows = [
        {
            "reference": PATHS[path],
            "lateral_model": lateral_model(factor),
            "start": START,
            **SCENARIOS[name].options,
        }
        for name, path, factor in cases
    ]
    each = np.array([assumed_parameters(name, factor) for name, _, factor in cases])
    policy = FeedbackLinearizingController(PlantParameters(*each.T), PERIOD, lateral="constrained")
    batch = drive(policy, rows, duration + PERIOD)
    truth = {name: values[1:] for name, values in batch.truth.items()}
    ends = batch._replace(time=batch.time[1:], truth=truth)
    return {case: Run(*ends.part(i)) for i, case in enumerate(cases)}


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
    exact = assumed_parameters("exact", turning_factor)
    mass, inertia = (grid.ravel() for grid in np.meshgrid(factors, factors, indexing="ij"))
    arrays: Any = {"mass": exact.mass * mass, "inertia": exact.inertia * inertia}
    policy = FeedbackLinearizingController(exact._replace(**arrays), PERIOD, lateral="constrained")
    model = lateral_model(turning_factor)
    row = {"reference": WAYS[way], "lateral_model": model, "start": START}
    truth = drive(policy, [row] * mass.size, duration).truth
    right = mass.size // 2
    square = sum((truth[name] - truth[name][:, [right]]) ** 2 for name in ("x", "y"))
    rmse = np.sqrt(np.mean(square, axis=0))
    return Surface(factors, rmse.reshape(len(factors), len(factors)))


def sweep_all() -> dict[tuple[str, float], Surface]:
    """Every path with both turning factors."""
    return {(way, factor): surface(way, factor) for way in WAYS for factor in TURNING_FACTORS}
