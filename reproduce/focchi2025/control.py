"""A closed loop around any plant: the pseudo-kinematic model (27), the patches with either
integrator, or the plant on terrain, on any reference: all that `plants.standalone` calls `Driven`.

Figure 10: unicycle and slippage-aware controller on the pseudo-kinematic model, on a spiral.

F prints v_d = 0.3 m/s and w_d = 4 t, on a model without limits. In rad/s that takes the outer
sprocket within half a second beyond the 10 rad/s up to which slip was identified (`beyond_after`).
Here w_d = 0.05 t: a radius of 0.3 m after 20 s.

Section 7.1: the chicane F (53) on the distributed model, figures 12 to 14.

As printed the speed starts at -2 v_max; read as a ramp v = v_max t it reaches 2 v_max at t_1 and
jumps back. Chosen: that ramp, mu = 0.1, actuation noise as the standard deviation of the sprocket
speeds, drawn anew at every control step, ideal sensors. The paper controls at 1 kHz in simulation
and its vehicle at 200 Hz.
"""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

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
from baselines.slip.slip_sweep import identified_slip, sweep, upsample
from reproduce.focchi2025.identification import MEASURED_LIMIT, within
from reproduce.focchi2025.runs import FRICTION, LENGTHS, RESISTANCE, Floats, Numbers, Run, vehicle
from tracked_env import observation as layout
from tracked_env.arrays import columns
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.rigid_body import in_body_plane
from tracked_env.plants.standalone import Driven, Rig
from tracked_env.references import make_reference
from tracked_env.references.catalogue import ReferenceProfile, constant, knot_times, sample
from tracked_env.sensors import PRESETS
from tracked_env.vector_env import TrackedVehicleVectorEnv

Samples = Mapping[str, Floats]


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
    noise: float = 0.0,
    seed: int = 0,
    shown: layout.Layout = layout.V0,
    sprockets: Floats | None = None,
) -> Run:
    """Drive one vehicle per reference from rest at `start` (x, y [m], yaw [rad]); plant: as many.

    reference: at the T control steps. start: None, from where and as the plant has them. rate
    [Hz] of control. shown: what the policy sees; with the attitude the run has z, roll and pitch
    too. noise [rad/s]: sigma on the sprocket speeds, new at every control step. sprockets [rad/s]
    (N, 2): in force before the first step, None at rest.
    """
    steps, count = reference["x"].shape
    limit, period = parameters.sprocket_speed_limit, 1.0 / rate
    time = np.arange(steps, dtype=np.float64) * period
    rng, memory = np.random.default_rng(seed), None
    state = plant.states
    sprockets = np.zeros((count, 2)) if sprockets is None else sprockets
    kept = [*range(6), *((s.Z, s.ROLL, s.PITCH) if "attitude" in shown.groups else ())]
    if start is not None:
        state[:, :6] = (*start, 0.0, 0.0, 0.0)
    states, speeds = np.empty((steps, len(kept), count)), np.empty((steps, 2, count))
    for k in range(steps):
        states[k], speeds[k] = state[:, kept].T, sprockets.T
        seen = _observations(shown, state, sprockets, reference, k)
        action, memory = policy.predict(seen, memory)
        sprockets = limit * action.astype(np.float64) + noise * rng.standard_normal((count, 2))
        sprockets = np.clip(sprockets, -limit, limit)
        plant.advance(sprockets, period)
    goal = np.stack([reference[name] for name in ("x", "y", "yaw")], axis=1)
    return Run(time, states, speeds, goal, {})


SPEED = 0.3  # [m/s] v_d
YAW_ACCELERATION = 0.05  # [rad/s^2] w_d / t
PRINTED = 4.0  # [rad/s^2]
START = (0.3, 0.3, 0.2)  # [m, m, rad]
DURATION = 20.0  # [s]
RATE = 200.0  # [Hz]


class Spiral(NamedTuple):
    """One controller on the spiral."""

    run: Run
    value: Floats  # (T,) Lyapunov function (38), or (45) for the slippage-aware controller

    @property
    def rises(self) -> float:
        """Largest rise of the value above its least one so far [-]."""
        return float(np.max(self.value - np.minimum.accumulate(self.value)))


def profile() -> ReferenceProfile:
    """The reference of figure 10."""
    starts = knot_times(DURATION)[:-1]
    turn = constant(0.0, len(starts))
    turn[:, 0], turn[:, 1] = YAW_ACCELERATION * starts, YAW_ACCELERATION
    return ReferenceProfile(constant(SPEED, len(starts)), turn)


def beyond_after(parameters: PlantParameters, slope: float = PRINTED) -> float:
    """Time [s] at which w_d = slope t, without slip, takes the outer sprocket beyond its limit."""
    fastest = parameters.sprocket_radius * parameters.sprocket_speed_limit
    return (fastest - SPEED) / (0.5 * parameters.track_gauge * slope)


def run_all(length: float = LENGTHS[-1], duration: float = DURATION) -> dict[str, Spiral]:
    """Both controllers, {"uc", "slc"}; the slippage-aware one knows the slip of the model."""
    parameters = vehicle(length)
    model = identified_slip(parameters)
    sheet, period = DataSheet.of(PRESETS["ideal"]), 1.0 / RATE
    aware = SlippageAwarePolicy(parameters, period, model, data_sheet=sheet)
    policies = {"uc": UnicyclePolicy(parameters, period, data_sheet=sheet), "slc": aware}
    found = {}
    for kind, policy in policies.items():
        plant = Kinematic(PseudoKinematicModel(parameters, model))
        reference = sampled([profile()], RATE, duration)
        run = follow(policy, plant, reference, START, parameters, RATE)
        alpha: Floats = np.zeros(len(run.time))
        if policy is aware:
            rows = np.zeros((len(run.time), 4))
            rows[:, 0], rows[:, 1] = SPEED, YAW_ACCELERATION * run.time
            rows[:, 3] = YAW_ACCELERATION
            alpha = aware.reference_slip(rows)[0]
        errors = zip(run.distance[:, 0], run.heading[:, 0], alpha, strict=True)
        gains = LyapunovGains()
        value = [
            lyapunov_value(PoseError(e_xy, 0.0, e_h), slip, gains) for e_xy, e_h, slip in errors
        ]
        found[kind] = Spiral(run, np.array(value))
    return found


SPEED_CHICANE, TURN = 0.2, 0.3  # [m/s] v_max, [rad/s] w_max
TURN_TIME, SWITCH_TIME, DURATION = 2.0, 12.0, 20.0  # [s] t_1, t_2, t_end
START_CHICANE = (0.05, 0.03, 0.01)  # [m, m, rad]
NOISE = 0.02  # [rad/s] sigma on the sprocket speeds
SEEDS = 4  # vehicles per case
RATES = (1000, 200, 50)  # [Hz]
REFERENCE: dict[str, Any] = {
    "kind": "chicane",
    "speed": SPEED_CHICANE,
    "yaw_rate": TURN,
    "turn_time": TURN_TIME,
    "switch_time": SWITCH_TIME,
}
_STATES = columns(("x", "y", "yaw", "v_x", "v_y", "yaw_rate"))
_SPROCKETS = columns(("sprocket_speed_left", "sprocket_speed_right"))
_GOAL = columns(("reference_x", "reference_y", "reference_yaw"))


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
    return {
        "vehicle": {"contact_length": true.contact_length},
        "soil": {
            "friction_angle": true.friction_angle,
            "longitudinal_resistance": true.longitudinal_resistance,
        },
        "sensors": case.sensors,
        "start": {
            "offset_x": START_CHICANE[0],
            "offset_y": START_CHICANE[1],
            "offset_yaw": START_CHICANE[2],
            "speed": 0.0,
            "yaw_rate": 0.0,
        },
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
        state[k], sprockets[k] = floats[:, _STATES].T, floats[:, _SPROCKETS].T
        goal[k] = floats[:, _GOAL].T
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
        speed[ramp, 0] -= SPEED_CHICANE * TURN_TIME
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
                run = follow(made, plant, reference, START_CHICANE, true, rate)
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
            found[name, kind] = follow(made, plant, reference, START_CHICANE, true, case.rate)
    return found
