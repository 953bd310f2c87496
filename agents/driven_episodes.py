"""Driven episodes for the training of a learned observer: what it sees, and what it should say.

Every job has one kind of sensors, reference and plant, and one controller whose gains are drawn;
its episodes follow any of LAWS. What is taken down is what `LearnedObserver` computes in the loop,
so that training and driving cannot differ.
"""

import math
from functools import partial
from typing import Any

import numpy as np

from agents import regression
from agents.regression import PERIOD, Episodes, Job, one_of
from baselines.batch_policy import body_errors
from baselines.learned.learned_observer import FEATURES, MOTION, LearnedObserver
from baselines.registry import POLICIES
from tracked_env.arrays import columns
from tracked_env.benchmark.policy_interface import PolicyContext
from tracked_env.benchmark.runner import steps_of
from tracked_env.vector_env import TrackedVehicleVectorEnv

JOB = 16  # [episodes] driven together, of one kind
LAWS = (
    "soil-and-mass", "payload", "resistance-map", "weak-soil", "terrain-transition", "drift",
    "mixed", "alternating-soils", "weak-actuator", "actuator-fault", "alternating-gains",
    "loose-soil", "slow-drive", "alternating-loads", "alternating-resistances", "alternating-all",
    "flickering-drive",
)  # fmt: skip
SENSORS = ("rtk", "outages", "late", "rare", "noisy", "no-velocity")  # in turn, see `sensors_of`
_LIMITS = {"yaw_rate_limit": 0.8, "lateral_acceleration_limit": 3.0}
REFERENCES: tuple[tuple[float, Any], ...] = (  # odds
    (0.6, "random"),
    (0.2, {"kind": "random", "speed_range": [2.0, 5.0], **_LIMITS}),
    (0.2, {"kind": "random", "speed_range": [-3.0, -1.0]}),
)
PLANTS = ((0.8, "lumped"), (0.2, "distributed"))
BASE = "mpc-adaptive"  # the policy of the archive
BASES = ((0.75, BASE), (0.25, "adaptive"))
GAIN_SPREAD = 0.7  # [-] gains are the tuned ones times exp(U(-this, this)), of all that have one
DRIVEN = 0.8  # [-] of the episodes of a later round with the network
LARGEST_TARGET = 20.0  # [-] in units of the filter
PARAMETERS = ("mass", "longitudinal_resistance", "inertia", "lateral_resistance")
GAINS = ("actuator_gain_left", "actuator_gain_right")


def sensors_of(kind: str, rng: np.random.Generator) -> Any:
    """Sensors of one of SENSORS, by what they are drawn from."""
    if kind == "late":
        return {"preset": "rtk", "pose_delay": float(rng.choice([0.1, 0.2, 0.2, 0.3, 0.5]))}
    if kind == "rare":
        return {"preset": "rtk", "pose_rate": float(rng.choice([1.0, 1.0, 2.0]))}
    if kind == "no-velocity":
        preset = str(rng.choice(["rtk", "rtk-outages"]))
        return {"preset": preset, "velocity_measured": 0.0}
    return {"rtk": "rtk", "outages": "rtk-outages", "noisy": "strawa"}[kind]


def drawn_gains(base: str, context: PolicyContext, rng: np.random.Generator) -> dict[str, float]:
    """Gains of a controller around the tuned ones."""
    factory: Any = POLICIES[base]
    tuned, changes = factory.SETTINGS(context)._asdict(), {}
    for name, (low, high, logarithmic) in factory.TUNABLE.items():
        if logarithmic and math.isfinite(tuned[name]) and tuned[name] > 0.0:
            value = tuned[name] * math.exp(rng.uniform(-GAIN_SPREAD, GAIN_SPREAD))
            changes[name] = min(max(value, low), high)
    return changes


_POSES = ("reference_x", "reference_y", "reference_yaw", "x", "y", "yaw")
_COLUMNS, _TRUE = columns((*_POSES, "v_x", "v_y", "yaw_rate")), columns((*PARAMETERS, *GAINS))
_LOGARITHMS = {"mass": "log_mass", "inertia": "log_inertia"}
_SHOWN = [FEATURES.index(_LOGARITHMS.get(name, name)) for name in (*PARAMETERS, *GAINS)]


class Notes:
    """Takes down features and targets of every control step, see `runner.steps_of`."""

    def __init__(self, count: int, vehicle: Any) -> None:
        steps = round(regression.DURATION / PERIOD)
        self.features = np.zeros((count, steps, len(FEATURES)), np.float16)
        self.targets = np.zeros((count, steps, len(MOTION) + len(_SHOWN)), np.float16)
        self._vehicle, self._step = vehicle, 0

    def take(self, policy: Any, floats: Any) -> None:
        """One step; floats: the rows of the simulation."""
        of, values = policy.corrector, floats[:, _COLUMNS]
        errors = body_errors(values[:, :3].T, *values[:, 3:6].T)
        missed = np.stack([*errors, *values[:, 6:].T], axis=1) - of.before
        missed[:, 2] = np.arctan2(np.sin(missed[:, 2]), np.cos(missed[:, 2]))
        mass, along, inertia, across, *gains = floats[:, _TRUE].T
        true = [
            2.0 * np.log(mass / self._vehicle.mass), 2.0 * along,
            2.0 * np.log(inertia / self._vehicle.inertia), 2.0 * across,
            *(3.0 * (gain - 1.0) for gain in gains),
        ]  # fmt: skip
        wrong = np.stack(true, axis=1) - of.features[:, _SHOWN]
        both = np.concatenate([missed / of.units, wrong], axis=1)
        bounded = np.clip(np.nan_to_num(both), -LARGEST_TARGET, LARGEST_TARGET)
        self.features[:, self._step], self.targets[:, self._step] = of.features, bounded
        self._step += 1


def drive(network: Any, job: Job) -> Episodes:
    """The episodes of a job. network: of `layers_of`, or None before the first regression."""
    rng = np.random.default_rng(job.first)
    kind = SENSORS[job.number % len(SENSORS)]
    sensors, base = sensors_of(kind, rng), one_of(rng, BASES)
    env = TrackedVehicleVectorEnv(
        job.count,
        uncertainty=list(LAWS),
        sensors=sensors,
        reference=one_of(rng, REFERENCES),
        plant=one_of(rng, PLANTS),
        duration=regression.DURATION,
        autoreset_mode="Disabled",
    )
    simulation = env.simulation
    vehicle, sheet = simulation.solver.nominal, simulation.settings.sensors
    context = PolicyContext(simulation.solver.control_period, "sliding", sheet, vehicle=vehicle)
    policy: Any = POLICIES[base](context, **drawn_gains(base, context, rng))
    policy.correct_motion(partial(LearnedObserver, network if job.driven else None))
    notes: Any = Notes(job.count, vehicle)
    for _ in steps_of(policy, env, range(job.first, job.first + job.count), notes):
        pass
    lengths = np.array(simulation.steps)
    env.close()
    return Episodes(notes.features, notes.targets, lengths)
