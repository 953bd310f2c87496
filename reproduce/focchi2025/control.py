"""Sections 5.2 and 7.1: the controllers on a spiral and on the chicane F (53), figures 10 to 14.

Spiral, on the pseudo-kinematic model: F prints v_d = 0.3 m/s and w_d = 4 t, on a model without
limits. In rad/s that takes the outer sprocket within half a second beyond the 10 rad/s up to which
slip was identified (`beyond_after`). Here w_d = 0.05 t: a radius of 0.3 m after 20 s.

Chicane, on the distributed model: as printed the speed starts at -2 v_max; read as a ramp v = v_max
t it reaches 2 v_max at t_1 and jumps back. Chosen: that ramp, mu = 0.1, actuation noise as the
standard deviation of the sprocket speeds, drawn anew at every control step, ideal sensors. The
paper controls at 1 kHz in simulation and its vehicle at 200 Hz.

`Run` has the time histories of vehicles and their errors F (36), (37); `follow` closes the loop
around any plant that `plants.standalone` calls `Driven`, on any reference.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.measurement import DataSheet
from baselines.lyapunov.adaptive_slippage_aware import AdaptiveSlipPolicy
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
from tracked_env import observation as layout
from tracked_env.arrays import columns
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import VEHICLES, PlantParameters
from tracked_env.physics.rigid_body import in_body_plane
from tracked_env.plants.standalone import Driven, Rig
from tracked_env.references import ReferenceProfile, make_reference, sample
from tracked_env.references.profile import constant, knot_times, number_of_segments
from tracked_env.sensors import PRESETS
from tracked_env.vector_env import TrackedVehicleVectorEnv

Floats = NDArray[np.float64]
Samples = Mapping[str, Floats]

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
    "kind": "chicane", "speed": SPEED, "yaw_rate": TURN, "turn_time": TURN_TIME,
    "switch_time": SWITCH_TIME,
}  # fmt: skip
STATES = columns(("x", "y", "yaw", "v_x", "v_y", "yaw_rate"))
SPROCKETS = columns(("sprocket_speed_left", "sprocket_speed_right"))
REFERENCES = columns(("reference_x", "reference_y", "reference_yaw"))


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


class Run(NamedTuple):
    """Time histories of N vehicles over T control steps, at the beginning of each step."""

    time: Floats  # (T,) [s]
    state: Floats  # (T, 6 or 9, N) x, y [m], yaw [rad], v_x, v_y [m/s], yaw rate [rad/s], and of
    # a plant that moves in space z [m], roll, pitch [rad]
    sprockets: Floats  # (T, 2, N) [rad/s] in force before that time, left and right
    reference: Floats  # (T, 3, N) x, y [m], yaw [rad]
    belief: dict[str, Floats]  # (T, N) estimates by name, empty when the policy has none

    @property
    def distance(self) -> Floats:
        """e_xy of F (37), (T, N) [m]."""
        apart = self.state[:, :2] - self.reference[:, :2]
        return np.asarray(np.hypot(apart[:, 0], apart[:, 1]))

    @property
    def heading(self) -> Floats:
        """e_phi of F (36), (T, N) [rad] in [-pi, pi)."""
        turned = self.state[:, 2] - self.reference[:, 2]
        return np.asarray((turned + math.pi) % (2.0 * math.pi) - math.pi)

    def numbers(self) -> Numbers:
        """Errors after BEGUN."""
        late = self.time >= BEGUN
        distance = self.distance[late]
        largest = distance.max(axis=0)
        rmse, heading = np.sqrt(np.mean(distance**2)), np.abs(self.heading[late]).max()
        return Numbers(float(largest.mean()), float(largest.std()), float(rmse), float(heading))

    def only(self, rows: slice) -> "Run":
        """Some of the vehicles."""
        belief = {name: values[:, rows] for name, values in self.belief.items()}
        state, sprockets, reference = (values[:, :, rows] for values in self[1:4])
        return Run(self.time, state, sprockets, reference, belief)

    def slip(self, parameters: PlantParameters) -> tuple[Floats, Floats, Floats]:
        """Actual slip of the vehicles, (T, N): beta_left, beta_right [m/s] of F (31), alpha [rad]
        of (28), nan where |v_x| is below SLOWEST."""
        shape, (left, right) = self.state[:, 0].shape, self.sprockets.transpose(1, 0, 2)
        motion = self.state[:, 3:6].transpose(0, 2, 1).reshape(-1, 3)
        data = slip_data(parameters, left.ravel(), right.ravel(), motion)
        alpha = np.where(np.abs(data.v_x) > SLOWEST, data.alpha, np.nan).reshape(shape)
        return data.beta_left.reshape(shape), data.beta_right.reshape(shape), alpha


def within(runs: SlipData, limit: float) -> SlipData:
    """Runs with both sprockets within +-limit [rad/s]."""
    fastest = np.maximum(np.abs(runs.sprocket_left), np.abs(runs.sprocket_right))
    return runs.rows(fastest <= limit)


# A closed loop around any plant


def patches(parameters: PlantParameters, count: int, euler: bool, step: float = 1e-3) -> Rig:
    """The distributed plant driven by its speeds: euler explicit, else as the environment; [s]."""
    integrator = "euler" if euler else "rosenbrock"
    return Rig("distributed", parameters, count, "speed", step, {"integrator": integrator})


class Kinematic:
    """The pseudo-kinematic model as a `Driven`."""

    def __init__(self, model: Any, count: int = 1) -> None:
        self._model = model
        self.states: Floats = np.zeros((count, 6))

    def advance(self, commands: Floats, duration: float) -> None:
        """Sprocket speeds [rad/s] held for `duration` [s]."""
        state = self.states
        state[:, :3] = self._model.step(state[:, :3], commands, duration)
        motion, alpha = self._model.motion(commands)
        state[:, 3], state[:, 4] = motion[:, 0], motion[:, 0] * np.tan(alpha)
        state[:, 5] = motion[:, 1]


def _observations(
    shown: layout.Layout, state: Floats, sprockets: Floats, reference: Samples, k: int
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """What ideal sensors show at step k."""
    cosine, sine = np.cos(state[:, 2]), np.sin(state[:, 2])
    ahead_x, ahead_y = reference["x"][k] - state[:, 0], reference["y"][k] - state[:, 1]
    turn = reference["yaw"][k] - state[:, 2]
    values: dict[str, Any] = dict.fromkeys(shown.names, np.zeros(len(state))) | {
        "position_error_x": cosine * ahead_x + sine * ahead_y,
        "position_error_y": cosine * ahead_y - sine * ahead_x,
        "heading_error": (turn + np.pi) % (2.0 * np.pi) - np.pi,
        "v_x": state[:, 3],
        "v_y": state[:, 4],
        "yaw_rate": state[:, 5],
        "sprocket_speed_left": sprockets[:, 0],
        "sprocket_speed_right": sprockets[:, 1],
    }
    for name in ("speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration"):
        values[f"reference_{name}"] = reference[name][k]
    if "attitude" in shown.groups:
        values |= {"roll": state[:, s.ROLL], "pitch": state[:, s.PITCH]}
    if "tangent_error" in shown.groups:
        ahead, left = values["position_error_x"], values["position_error_y"]
        pitch, roll = ((np.cos(values[n]), np.sin(values[n])) for n in ("pitch", "roll"))
        shown_errors = in_body_plane(ahead, left, values["heading_error"], pitch, roll)
        values |= dict(
            zip((f.name for f in layout.GROUPS["tangent_error"].fields), shown_errors, strict=True)
        )
    return shown.pack(values)


def sampled(profiles: Sequence[ReferenceProfile], rate: float, duration: float) -> Samples:
    """References of N vehicles at the control steps, each field (T, N); rate [Hz]."""
    time = np.arange(round(duration * rate), dtype=np.float64) * (1.0 / rate)
    each = [sample(profile, time)._asdict() for profile in profiles]
    return {name: np.stack([one[name] for one in each], axis=1) for name in each[0]}


def follow(
    policy: Any,
    plant: Driven,
    reference: Samples,
    start: tuple[float, float, float] | None,
    parameters: PlantParameters,
    rate: float,
    shown: layout.Layout = layout.V0,
    sprockets: Floats | None = None,
) -> Run:
    """Drive one vehicle per reference from rest at `start` (x, y [m], yaw [rad]); plant: as many.

    reference: at the T control steps. start: None, from where and as the plant has them. rate
    [Hz] of control. shown: what the policy sees; with the attitude the run has z, roll and pitch
    too. sprockets [rad/s] (N, 2): in force before the first step, None at rest.
    """
    steps, count = reference["x"].shape
    limit, period = parameters.sprocket_speed_limit, 1.0 / rate
    time = np.arange(steps, dtype=np.float64) * period
    state, memory = plant.states, None
    sprockets = np.zeros((count, 2)) if sprockets is None else sprockets
    kept = [*range(6), *((s.Z, s.ROLL, s.PITCH) if "attitude" in shown.groups else ())]
    if start is not None:
        state[:, :6] = (*start, 0.0, 0.0, 0.0)
    states, speeds = np.empty((steps, len(kept), count)), np.empty((steps, 2, count))
    for k in range(steps):
        states[k], speeds[k] = state[:, kept].T, sprockets.T
        seen = _observations(shown, state, sprockets, reference, k)
        action, memory = policy.predict(seen, memory)
        sprockets = np.clip(limit * action.astype(np.float64), -limit, limit)
        plant.advance(sprockets, period)
    goal = np.stack([reference[name] for name in ("x", "y", "yaw")], axis=1)
    return Run(time, states, speeds, goal, {})


# Spiral


class Spiral(NamedTuple):
    """One controller on the spiral."""

    run: Run
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


def spirals(length: float = LENGTHS[-1], duration: float = SPIRAL_TIME) -> dict[str, Spiral]:
    """Both controllers, {"uc", "slc"}; the slippage-aware one knows the slip of the model."""
    parameters = vehicle(length)
    model = identified_slip(parameters)
    sheet, period = DataSheet.of(PRESETS["ideal"]), 1.0 / SPIRAL_RATE
    aware = SlippageAwarePolicy(parameters, period, model, data_sheet=sheet)
    policies = {"uc": UnicyclePolicy(parameters, period, data_sheet=sheet), "slc": aware}
    found = {}
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
        found[kind] = Spiral(run, np.array(value))
    return found


# Chicane


class Case(NamedTuple):
    """A vehicle, and what its controller assumes."""

    kind: str  # uc; slc with the slip of a table or of REGRESSED; online
    length: float = LENGTHS[-1]  # [m]
    rate: int = 200  # [Hz] of control
    friction: float = FRICTION  # [-] true mu
    believed: float = FRICTION  # [-] mu that the controller assumes
    resistance: float = RESISTANCE  # [-] c_r, true
    believed_resistance: float = RESISTANCE
    noise: float = NOISE  # [rad/s]
    sensors: str = "ideal"


KINDS = ("uc", "table")  # of the paper's comparison; the table stands for its regressor
PAPER = [Case(kind, length, rate) for rate in RATES for length in LENGTHS for kind in KINDS]
REGRESSED = ("trees", "exponential", "exponential, slow")
MODELS = [Case(kind, length) for length in LENGTHS for kind in REGRESSED]
SOILS = ((0.1, 0.4), (0.4, 0.1))  # [-] mu: (true, assumed)
ONLINE = [
    Case(kind, length, friction=true, believed=believed)
    for length in LENGTHS
    for true, assumed in SOILS
    for kind, believed in (("table", true), ("table", assumed), ("online", assumed))
]
RESISTANCES = [
    Case(kind, length, resistance=true, believed_resistance=assumed)
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


def policy(case: Case) -> SlippageAwarePolicy | AdaptiveSlipPolicy:
    """The controller of a case, for any number of vehicles."""
    believed = vehicle(case.length, case.believed, case.believed_resistance)
    sheet, period = DataSheet.of(PRESETS[case.sensors]), 1.0 / case.rate
    if case.kind == "online":
        return AdaptiveSlipPolicy(believed, period, sheet)
    if case.kind == "uc":
        return UnicyclePolicy(believed, period, data_sheet=sheet)
    model = slip_model(believed, case.kind)
    return SlippageAwarePolicy(believed, period, model, data_sheet=sheet)


def knowledge(case: Case) -> tuple[Any, ...]:
    """What a controller is made from: cases with the same knowledge share one controller."""
    if case.kind == "uc":
        return ("uc", case.sensors)
    return (case.kind, case.length, case.believed, case.believed_resistance, case.sensors)


def options(case: Case) -> dict[str, Any]:
    """Options of reset for a vehicle of a case."""
    true = vehicle(case.length, case.friction, case.resistance)
    soil = ("friction_angle", "longitudinal_resistance")
    offsets = dict(zip(("offset_x", "offset_y", "offset_yaw"), START, strict=True))
    return {
        "vehicle": {"contact_length": true.contact_length},
        "soil": {name: getattr(true, name) for name in soil},
        "sensors": case.sensors,
        "start": {**offsets, "speed": 0.0, "yaw_rate": 0.0},
    }


def drive(cases: Sequence[Case], seeds: int = SEEDS, duration: float = DURATION) -> dict[Case, Run]:
    """Drive `seeds` vehicles of every case; the noise of seed k is the same for all cases."""
    found: dict[Case, Run] = {}
    for rate in dict.fromkeys(case.rate for case in cases):
        alike = sorted((c for c in cases if c.rate == rate), key=knowledge)
        found |= _drive(alike, rate, seeds, duration)
    return {case: found[case] for case in cases}


def _drive(cases: Sequence[Case], rate: int, seeds: int, duration: float) -> dict[Case, Run]:
    """All cases of one control rate as one batch; those that share a controller are neighbours."""
    count, steps = seeds * len(cases), round(duration * rate)
    env = TrackedVehicleVectorEnv(
        count, reference=REFERENCE, uncertainty="nominal", sensors="ideal",
        duration=DURATION + 1.0, control_rate=rate, vehicle="focchi", plant="distributed",
        drive="speed", error_limit=1e3,
    )  # fmt: skip
    rows = [options(case) for case in cases for _ in range(seeds)]
    observation, _ = env.reset(seed=0, options={"rows": rows})
    parts = [slice(i * seeds, (i + 1) * seeds) for i in range(len(cases))]
    policies, shares = [], []
    for _, group in groupby(range(len(cases)), lambda i: knowledge(cases[i])):
        members = list(group)
        shares.append(slice(parts[members[0]].start, parts[members[-1]].stop))
        policies.append(policy(cases[members[0]]))
    memories: list[Any] = [None] * len(policies)
    sigma = np.repeat([case.noise for case in cases], seeds)[:, None]
    scale = sigma / vehicle().sprocket_speed_limit
    rng = np.random.default_rng(0)
    state, sprockets = np.empty((steps, 6, count)), np.empty((steps, 2, count))
    goal = np.empty((steps, 3, count))
    belief: dict[str, Floats] = {}
    action = np.empty((count, 2), dtype=np.float32)
    for k in range(steps):
        floats = env.simulation.batch.floats
        state[k], sprockets[k] = floats[:, STATES].T, floats[:, SPROCKETS].T
        goal[k] = floats[:, REFERENCES].T
        for i, (one, share) in enumerate(zip(policies, shares, strict=True)):
            action[share], memories[i] = one.predict(observation[share], memories[i])
            if hasattr(one, "estimates"):
                angle = one.estimates()["friction_angle"][0]
                belief.setdefault("friction", np.full((steps, count), np.nan))
                belief["friction"][k, share] = np.tan(angle)
        noise = np.tile(rng.standard_normal((seeds, 2)), (len(cases), 1))
        noisy = np.clip(action + scale * noise, -1.0, 1.0).astype(np.float32)
        observation = env.step(noisy)[0]
    env.close()
    time: Floats = np.arange(steps, dtype=np.float64) / rate
    whole = Run(time, state, sprockets, goal, belief)
    return {case: whole.only(part) for case, part in zip(cases, parts, strict=True)}


READINGS = {
    "v_max t": "ramp to 2 v_max, jump back",
    "v_max t / t_1": "ramp to v_max",
    "v_max (t - t_1)": "as printed: backwards from -2 v_max",
}


def reading(name: str) -> ReferenceProfile:
    """The chicane under one reading of the ramp in (53)."""
    profile = make_reference(REFERENCE, DURATION, np.random.default_rng(0))
    ramp = profile.speed[:, 1] != 0.0
    speed = profile.speed.copy()
    if name == "v_max t / t_1":
        speed[ramp] /= TURN_TIME
    elif name == "v_max (t - t_1)":
        speed[ramp, 0] -= SPEED * TURN_TIME
    return profile._replace(speed=speed)


def readings(
    rate: int = 50, resistances: Sequence[float] = (RESISTANCE, 0.0)
) -> dict[tuple[str, float, float, str], Numbers]:
    """{(reading, length, c_r, kind): errors}, without noise."""
    found = {}
    profiles = [reading(name) for name in READINGS]
    for length in LENGTHS:
        for resistance in resistances:
            for kind in KINDS:
                case = Case(kind, length, rate, believed_resistance=resistance)
                true = vehicle(length, FRICTION, resistance)
                made = policy(case)
                plant = patches(true, len(profiles), False, 2.5e-3)
                reference = sampled(profiles, rate, DURATION)
                run = follow(made, plant, reference, START, true, rate)
                for i, name in enumerate(READINGS):
                    found[name, length, resistance, kind] = run.only(slice(i, i + 1)).numbers()
    return found


INTEGRATORS = {
    "explicit Euler, 1 ms": (True, 1e-3),
    "Rosenbrock, 1 ms": (False, 1e-3),
    "Rosenbrock, 2.5 ms": (False, 2.5e-3),
}


def integrators(length: float = LENGTHS[-1]) -> dict[tuple[str, str], Run]:
    """{(integrator, kind): run} without noise, 200 Hz."""
    found = {}
    true, profile = vehicle(length), reading("v_max t")
    for name, (euler, step) in INTEGRATORS.items():
        for kind in KINDS:
            case = Case(kind, length)
            made, plant = policy(case), patches(true, 1, euler, step)
            reference = sampled([profile], case.rate, DURATION)
            found[name, kind] = follow(made, plant, reference, START, true, case.rate)
    return found
