"""Sections 5.2 and 7.1: the controllers on a spiral and on the chicane F (53), figures 10 to 14.

Spiral, on the pseudo-kinematic model: F prints v_d = 0.3 m/s and w_d = 4 t, on a model without
limits. In rad/s that takes the outer sprocket within half a second beyond the 10 rad/s up to which
slip was identified (`beyond_after`). Here w_d = 0.05 t: a radius of 0.3 m after 20 s.

Chicane, on the distributed model: as printed the speed starts at -2 v_max; read as a ramp v = v_max
t it reaches 2 v_max at t_1 and jumps back. Chosen: that ramp, mu = 0.1, actuation noise as the
standard deviation of the sprocket speeds, drawn anew at every control step, ideal sensors. The
paper controls at 1 kHz in simulation and its vehicle at 200 Hz.
"""

import math
from collections.abc import Sequence
from itertools import groupby, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.measurement import DataSheet
from baselines.lyapunov import slippage_aware as laws
from baselines.lyapunov.lyapunov_laws import (
    LyapunovGains,
    PoseError,
    PseudoKinematicModel,
    lyapunov_value,
)
from baselines.lyapunov.slippage_aware import SlippageAwarePolicy, UnicyclePolicy
from baselines.slip.slip_models import SlipModel
from baselines.slip.slip_regression import fit_exponential, train_trees
from baselines.slip.slip_sweep import SlipData, identified_slip, slip_data, sweep, upsample
from reproduce import policy_runs
from reproduce.policy_runs import GOAL, MOTION, SPROCKETS, Drive, Floats, follow, sampled
from tracked_env.physics.parameters import VEHICLES, PlantParameters
from tracked_env.plants.standalone import Rig
from tracked_env.references import ReferenceProfile, make_reference
from tracked_env.references.profile import constant, knot_times, number_of_segments
from tracked_env.sensors import PRESETS

LENGTHS = (0.5, 0.7)  # [m] contact length: nearest to figure 13, and Table 2
FRICTION = 0.1  # [-] mu of figures 6, 7, 9, 12 to 14
RESISTANCE = 0.025  # [-] c_r of Table 2
MEASURED_LIMIT = 4.6  # [rad/s] reach of the real sprockets, figure 9
SLOWEST = 1e-3  # [m/s] a slower v_x has no alpha
BEGUN = 3.0  # [s] from here on errors count: the start is 5.8 cm off
SPIRAL_SPEED, SPIRAL_TIME, SPIRAL_RATE = 0.3, 20.0, 200.0  # [m/s] v_d, [s], [Hz] of control
YAW_ACCELERATION, PRINTED_ACCELERATION = 0.05, 4.0  # [rad/s^2] w_d / t
SPIRAL_START = (0.3, 0.3, 0.2)  # [m, m, rad]
SPEED, TURN = 0.2, 0.3  # [m/s] v_max, [rad/s] w_max
TURN_TIME, SWITCH_TIME, DURATION = 2.0, 12.0, 20.0  # [s] t_1, t_2, t_end
START = (0.05, 0.03, 0.01)  # [m, m, rad]
NOISE = 0.02  # [rad/s] sigma on the sprocket speeds
SEEDS = 4  # vehicles per case
RATES = (1000, 200, 50)  # [Hz]
REFERENCE: dict[str, Any] = {
    "kind": "chicane",
    "speed": SPEED,
    "yaw_rate": TURN,
    "turn_time": TURN_TIME,
    "switch_time": SWITCH_TIME,
}


def vehicle(
    length: float = LENGTHS[-1], friction: float = FRICTION, resistance: float = RESISTANCE
) -> PlantParameters:
    """Table 2 of F with a contact length [m], mu [-] and c_r [-]."""
    soil = {"friction_angle": math.atan(friction), "longitudinal_resistance": resistance}
    return VEHICLES["focchi"]._replace(contact_length=length, **soil)


class Numbers(NamedTuple):
    """Errors after BEGUN, mean and standard deviation over the vehicles of a run."""

    largest: float  # [m] max Cartesian error
    largest_spread: float  # [m]
    rmse: float  # [m]
    heading: float  # [rad] max heading error

    @property
    def text(self) -> str:
        """The largest error in cm."""
        return f"{100.0 * self.largest:.2f} ± {100.0 * self.largest_spread:.2f}"


def numbers(run: Drive) -> Numbers:
    """Errors of a run after BEGUN."""
    late = run.time >= BEGUN
    distance = run.distance[late]
    largest = distance.max(axis=0)
    rmse, heading = np.sqrt(np.mean(distance**2)), np.abs(run.heading[late]).max()
    return Numbers(float(largest.mean()), float(largest.std()), float(rmse), float(heading))


def slip_of(run: Drive, parameters: PlantParameters) -> tuple[Floats, Floats, Floats]:
    """Actual slip of the vehicles, (T, N): beta_left, beta_right [m/s] of F (31), alpha [rad]
    of (28), nan where |v_x| is below SLOWEST."""
    motion = np.stack([run.truth[name].ravel() for name in MOTION[3:]], axis=1)
    left, right = (run.truth[name].ravel() for name in SPROCKETS)
    data, shape = slip_data(parameters, left, right, motion), run.truth["x"].shape
    alpha = np.where(np.abs(data.v_x) > SLOWEST, data.alpha, np.nan).reshape(shape)
    return data.beta_left.reshape(shape), data.beta_right.reshape(shape), alpha


def within(runs: SlipData, limit: float) -> SlipData:
    """Runs with both sprockets within +-limit [rad/s]."""
    fastest = np.maximum(np.abs(runs.sprocket_left), np.abs(runs.sprocket_right))
    return runs.rows(fastest <= limit)


def patches(parameters: PlantParameters, count: int, euler: bool, step: float = 1e-3) -> Rig:
    """The distributed plant driven by its speeds: euler explicit, else as the environment; [s]."""
    integrator = "euler" if euler else "rosenbrock"
    return Rig("distributed", parameters, count, "speed", step, {"integrator": integrator})


# Spiral


class Kinematic:
    """The pseudo-kinematic model as a `Driven`."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self.states: Floats = np.zeros((1, 6))

    def advance(self, commands: Floats, duration: float) -> None:
        """Sprocket speeds [rad/s] held for `duration` [s]."""
        state = self.states
        state[:, :3] = self._model.step(state[:, :3], commands, duration)
        motion, alpha = self._model.motion(commands)
        state[:, 3], state[:, 4] = motion[:, 0], motion[:, 0] * np.tan(alpha)
        state[:, 5] = motion[:, 1]


class Spiral(NamedTuple):
    """One controller on the spiral."""

    run: Drive
    value: Floats  # (T,) Lyapunov function (38), or (45) for the slippage-aware controller

    @property
    def rises(self) -> float:
        """Largest rise of the value above its least one so far [-]."""
        return float(np.max(self.value - np.minimum.accumulate(self.value)))


def spiral_profile() -> ReferenceProfile:
    """The reference of figure 10."""
    starts = knot_times(number_of_segments(SPIRAL_TIME))[:-1]
    turn = constant(0.0, len(starts))
    turn[:, 0], turn[:, 1] = YAW_ACCELERATION * starts, YAW_ACCELERATION
    return ReferenceProfile(constant(SPIRAL_SPEED, len(starts)), turn)


def beyond_after(parameters: PlantParameters, slope: float = PRINTED_ACCELERATION) -> float:
    """Time [s] at which w_d = slope t, without slip, takes the outer sprocket beyond its limit."""
    fastest = parameters.sprocket_radius * parameters.sprocket_speed_limit
    return (fastest - SPIRAL_SPEED) / (0.5 * parameters.track_gauge * slope)


def spirals(duration: float = SPIRAL_TIME) -> dict[str, Spiral]:
    """Both controllers, {"uc", "slc"}; the slippage-aware one knows the slip of the model."""
    parameters = vehicle(LENGTHS[-1])
    model = identified_slip(parameters)
    sheet, period = DataSheet.of(PRESETS["ideal"]), 1.0 / SPIRAL_RATE
    aware = SlippageAwarePolicy(parameters, period, model, data_sheet=sheet)
    policies = {"uc": UnicyclePolicy(parameters, period, data_sheet=sheet), "slc": aware}
    runs = {}
    for kind, policy in policies.items():
        plant = Kinematic(PseudoKinematicModel(parameters, model))
        reference = sampled([spiral_profile()], SPIRAL_RATE, duration)
        run = follow(policy, plant, reference, SPIRAL_START, parameters, SPIRAL_RATE)
        alpha: Floats = np.zeros(len(run.time))
        if policy is aware:
            rows = np.zeros((len(run.time), 4))
            rows[:, 0], rows[:, 1] = SPIRAL_SPEED, YAW_ACCELERATION * run.time
            rows[:, 3] = YAW_ACCELERATION
            alpha = aware.reference_slip(rows)[0]
        errors = zip(run.distance[:, 0], run.heading[:, 0], alpha, strict=True)
        gains = LyapunovGains()
        value = [
            lyapunov_value(PoseError(e_xy, 0.0, e_h), slip, gains) for e_xy, e_h, slip in errors
        ]
        runs[kind] = Spiral(run, np.array(value))
    return runs


# Chicane


class Case(NamedTuple):
    """A vehicle, and what its controller assumes."""

    kind: str  # uc; slc with the slip of a table or of REGRESSED; online
    length: float = LENGTHS[-1]  # [m]
    rate: int = 200  # [Hz] of control
    friction: float = FRICTION  # [-] true mu
    assumed: float = FRICTION  # [-] mu that the controller assumes
    resistance: float = RESISTANCE  # [-] c_r, true
    assumed_resistance: float = RESISTANCE
    noise: float = NOISE  # [rad/s]
    sensors: str = "ideal"


KINDS = ("uc", "table")  # of the paper's comparison; the table stands for its regressor
PAPER = [Case(kind, length, rate) for rate in RATES for length in LENGTHS for kind in KINDS]
REGRESSED = ("trees", "exponential", "exponential, slow")
MODELS = [Case(kind, length) for length in LENGTHS for kind in REGRESSED]
SOILS = ((0.1, 0.4), (0.4, 0.1))  # [-] mu: (true, assumed)
ONLINE = [
    Case(kind, length, friction=true, assumed=friction)
    for length in LENGTHS
    for true, assumed in SOILS
    for kind, friction in (("table", true), ("table", assumed), ("online", assumed))
]
RESISTANCES = [
    Case(kind, length, resistance=true, assumed_resistance=assumed)
    for length in LENGTHS
    for kind in KINDS
    for true, assumed in ((0.0, 0.0), (0.0, RESISTANCE), (RESISTANCE, 0.0))
    if kind != "uc" or true == assumed
]
LOUD = [Case(kind, length, noise=0.02**0.5) for length in LENGTHS for kind in KINDS]


def slip_model(parameters: PlantParameters, kind: str) -> SlipModel:
    """Slip of a vehicle on its soil: "table", or one of REGRESSED."""
    if kind == "table":
        return identified_slip(parameters)
    runs = sweep(parameters)
    if kind == "trees":
        return train_trees(upsample(runs, parameters)[0], parameters)[0]
    if kind == "exponential, slow":
        runs = within(runs, MEASURED_LIMIT)
    return fit_exponential(runs, parameters)[0]


def policy(case: Case) -> SlippageAwarePolicy | laws.AdaptiveSlipPolicy:
    """The controller of a case, for any number of vehicles."""
    assumed = vehicle(case.length, case.assumed, case.assumed_resistance)
    sheet, period = DataSheet.of(PRESETS[case.sensors]), 1.0 / case.rate
    if case.kind == "online":
        return laws.AdaptiveSlipPolicy(assumed, period, sheet)
    if case.kind == "uc":
        return UnicyclePolicy(assumed, period, data_sheet=sheet)
    model = slip_model(assumed, case.kind)
    return SlippageAwarePolicy(assumed, period, model, data_sheet=sheet)


def knowledge(case: Case) -> tuple[Any, ...]:
    """What a controller is made from: cases with the same knowledge share one controller."""
    assumed = (case.length, case.assumed, case.assumed_resistance) if case.kind != "uc" else ()
    return (case.kind, *assumed, case.sensors)


def options(case: Case) -> dict[str, Any]:
    """Options of reset for a vehicle of a case."""
    soil = {"friction_angle": math.atan(case.friction), "longitudinal_resistance": case.resistance}
    start = dict(zip(("offset_x", "offset_y", "offset_yaw"), START, strict=True))
    return {
        "vehicle": {"contact_length": case.length},
        "soil": soil,
        "sensors": case.sensors,
        "start": {**start, "speed": 0.0, "yaw_rate": 0.0},
    }


def drive(
    cases: Sequence[Case], seeds: int = SEEDS, duration: float = DURATION
) -> dict[Case, Drive]:
    """Drive `seeds` vehicles of every case; the noise of seed k is the same for all cases."""
    runs: dict[Case, Drive] = {}
    for rate in dict.fromkeys(case.rate for case in cases):
        alike = sorted((c for c in cases if c.rate == rate), key=knowledge)
        runs |= _drive(alike, rate, seeds, duration)
    return {case: runs[case] for case in cases}


def _drive(cases: Sequence[Case], rate: int, seeds: int, duration: float) -> dict[Case, Drive]:
    """All cases of one control rate as one batch; those that share a controller are neighbours."""
    parts = [slice(i * seeds, (i + 1) * seeds) for i in range(len(cases))]
    policies = []
    for _, group in groupby(range(len(cases)), lambda i: knowledge(cases[i])):
        members = list(group)
        share = slice(parts[members[0]].start, parts[members[-1]].stop)
        policies.append((policy(cases[members[0]]), share))
    sigma = np.repeat([case.noise for case in cases], seeds)[:, None]
    scale = sigma / vehicle().sprocket_speed_limit
    rng = np.random.default_rng(0)

    def disturb(action: NDArray[np.float32]) -> NDArray[np.float32]:
        noise = np.tile(rng.standard_normal((seeds, 2)), (len(cases), 1))
        return np.clip(action + scale * noise, -1.0, 1.0).astype(np.float32)

    rows = [options(case) for case in cases for _ in range(seeds)]
    run = policy_runs.drive(
        policies, rows, duration, rate, (*MOTION, *SPROCKETS, *GOAL), disturb, reference=REFERENCE,
        sensors="ideal", vehicle="focchi", plant="distributed", drive="speed",
    )  # fmt: skip
    return {case: run.part(part) for case, part in zip(cases, parts, strict=True)}


READINGS = {
    "v_max t": "ramp to 2 v_max, jump back",
    "v_max t / t_1": "ramp to v_max",
    "v_max (t - t_1)": "as printed: backwards from -2 v_max",
}


def chicane(duration: float, speed: float = SPEED, yaw_rate: float = TURN) -> ReferenceProfile:
    """(53) from the origin."""
    options = REFERENCE | {"speed": speed, "yaw_rate": yaw_rate}
    return make_reference(options, duration, np.random.default_rng(0))


def reading(name: str) -> ReferenceProfile:
    """The chicane under one reading of the ramp in (53)."""
    profile = chicane(DURATION)
    ramp = profile.speed[:, 1] != 0.0
    speed = profile.speed.copy()
    if name == "v_max t / t_1":
        speed[ramp] /= TURN_TIME
    elif name == "v_max (t - t_1)":
        speed[ramp, 0] -= SPEED * TURN_TIME
    return profile._replace(speed=speed)


def without_noise(
    case: Case, profiles: Sequence[ReferenceProfile], euler: bool = False, step: float = 2.5e-3
) -> Drive:
    """A vehicle of a case per profile, on the plant alone; step [s] of integration."""
    true = vehicle(case.length, case.friction, case.resistance)
    plant = patches(true, len(profiles), euler, step)
    reference = sampled(profiles, case.rate, DURATION)
    return follow(policy(case), plant, reference, START, true, case.rate)


def readings() -> dict[tuple[str, float, float, str], Numbers]:
    """{(reading, length, c_r, kind): errors}, without noise, 50 Hz."""
    errors = {}
    profiles = [reading(name) for name in READINGS]
    for length, resistance, kind in product(LENGTHS, (RESISTANCE, 0.0), KINDS):
        case = Case(kind, length, 50, resistance=resistance, assumed_resistance=resistance)
        run = without_noise(case, profiles)
        for i, name in enumerate(READINGS):
            errors[name, length, resistance, kind] = numbers(run.part(slice(i, i + 1)))
    return errors


INTEGRATORS = {
    "explicit Euler, 1 ms": (True, 1e-3),
    "Rosenbrock, 1 ms": (False, 1e-3),
    "Rosenbrock, 2.5 ms": (False, 2.5e-3),
}


def integrators() -> dict[tuple[str, str], Numbers]:
    """{(integrator, kind): errors} without noise, 200 Hz."""
    profile = reading("v_max t")
    return {
        (name, kind): numbers(without_noise(Case(kind, LENGTHS[-1]), [profile], *integrator))
        for name, integrator in INTEGRATORS.items()
        for kind in KINDS
    }
