"""The vehicles of a training, as its agent sees them, and those of the held-out episodes.

config: of train.py. arguments: of the environment, with one entry of `sensors` or a list. Of
several, each gets its part of the vehicles (`agents.joined`) and of the held-out episodes.
"""

from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import gymnasium
from gymnasium.envs.registration import load_env_creator
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

from agents.joined import JoinedVecEnv, shares
from agents.memory import AgentVectorEnv, History, Memory, make_memory
from agents.privileged import TEACHER, Privileged, TruthfulVectorEnv
from agents.reward import ScaledReward, TrainingReward
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.benchmark import PolicyContext
from tracked_env.engine.env_config import EnvConfig, make_solver
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sb3 import make_vec_env
from tracked_env.sensors import make_sensors
from tracked_env.validation import checked_keys, name_or_json
from tracked_env.vector_env import TrackedVehicleVectorEnv

Vehicles = gymnasium.vector.VectorEnv[Any, Any, Any]

FIRST_SEED, ROWS, TRAININGS = 2**24, 2**16, 2**15  # of trainings, and how far apart they are
# `mixture` of uncertainty: everything that the benchmark calls in distribution; `ood` stays out.
MIXTURE = {
    TORQUE_ID: (
        "soil-and-mass", "payload", "resistance-map", "weak-soil", "terrain-transition", "drift",
        "mixed",
    ),
    SPEED_ID: ("friction", "friction-step", "friction-drift", "floor-mixed"),
}  # fmt: skip
# `mixture` of sensors: good ones, and what asks for memory.
SENSOR_MIXTURE: dict[str, tuple[str | Mapping[str, Any], ...]] = {
    TORQUE_ID: (
        "rtk",
        {"preset": "rtk", "pose_delay": 0.2},
        "strawa",
        {"preset": "rtk", "velocity_measured": 0.0},
    ),
    SPEED_ID: ("mocap", {"preset": "mocap", "pose_delay": 0.1}),
}
# What an environment draws from where its registration does not say so.
_DEFAULTS = {"uncertainty": "soil-and-mass", "sensors": "rtk", "reference": "random"}
_OPTIONS = ("uncertainty", "sensors", "reference", "duration", "lateral")  # of train.py


def _named(known: Mapping[str, Any], env: str) -> Any:
    """What is known of an environment id. Raises ValueError."""
    if env not in known:
        raise ValueError(f"no mixture for {env}; name the entries one by one")
    return known[env]


def _entries(given: Sequence[str] | None, what: str, env: str, mixtures: Mapping[str, Any]) -> Any:
    """One entry, or a list; None where nothing is given. Raises ValueError."""
    if given is None:
        return None
    if not given:
        raise ValueError(f"--{what} needs at least one entry")
    parts = [
        part
        for text in given
        for part in (_named(mixtures, env) if text == "mixture" else (name_or_json(text, what),))
    ]
    return parts[0] if len(parts) == 1 else parts


def defaults_of(env: str) -> dict[str, Any]:
    """Arguments that an environment id is registered with, and the class's own where it is not."""
    return {**_DEFAULTS, **gymnasium.spec(env).kwargs}


def driven(env: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """What a policy must know of an environment id and its arguments: drive and vehicle."""
    made = {**defaults_of(env), **arguments}
    return {name: made[name] for name in ("drive", "vehicle") if name in made}


def control_period(env: str, arguments: Mapping[str, Any]) -> float:
    """Of an environment id with arguments [s]. Raises ValueError for arguments that are wrong."""
    made = {**defaults_of(env), **arguments}
    known = {name: made[name] for name in EnvConfig._fields if name in made}
    return make_solver(EnvConfig(**known)).control_period


def _further(text: str | None, env: str) -> Mapping[str, Any]:
    """Arguments without an option of their own, from JSON. Raises ValueError."""
    given = name_or_json(text, "env-args")
    for name in _OPTIONS:
        if isinstance(given, Mapping) and name in given:
            raise ValueError(f"--env-args: {name} has an option of its own, --{name}")
    # Recipes do not say which groups an agent has seen, so all are trained on those of v0.
    allowed = sorted({*EnvConfig._fields} - {*_OPTIONS, "observation"})
    further = checked_keys("--env-args", given, allowed)
    try:
        control_period(env, further)
    except (TypeError, ValueError) as error:
        raise ValueError(f"--env-args {text}: {error}") from error
    return further


def check_environment(env: str) -> None:
    """Raises ValueError for an id that is unknown, or not of an environment of this project."""
    try:
        made: Any = gymnasium.spec(env).vector_entry_point
        made = load_env_creator(made) if isinstance(made, str) else made
    except (gymnasium.error.Error, ImportError) as error:
        raise ValueError(f"--env {env}: {error}") from error
    if not (isinstance(made, type) and issubclass(made, TrackedVehicleVectorEnv)):
        raise ValueError(
            f"--env {env} is not an environment of tracked vehicles; must be {TORQUE_ID}, "
            f"{SPEED_ID}, or an id registered with their vector_entry_point"
        )


def environment_arguments(config: Any) -> dict[str, Any]:
    """Arguments of the environment; `sensors` is a list where there are several.

    What the command line leaves open is as the environment id is registered. Raises ValueError.
    """
    check_environment(config.env)
    defaults = defaults_of(config.env)
    given = {
        "uncertainty": _entries(config.uncertainty, "uncertainty", config.env, MIXTURE),
        "sensors": _entries(config.sensors, "sensors", config.env, SENSOR_MIXTURE),
        "reference": name_or_json(config.reference, "reference"),
    }
    chosen = {key: defaults[key] if value is None else value for key, value in given.items()}
    further = _further(config.env_args, config.env)
    return {**chosen, "duration": config.duration, "lateral": config.lateral, **further}


class Part(NamedTuple):
    """The rows of one kind of sensors."""

    arguments: dict[str, Any]  # of their environment
    context: PolicyContext  # what a policy may know of it
    rows: int
    first: int  # rows before them


def parts_of(config: Any, arguments: Mapping[str, Any], count: int) -> list[Part]:
    """`count` rows, shared among the kinds of sensors. Raises ValueError."""
    given = arguments["sensors"]
    period, known = control_period(config.env, arguments), driven(config.env, arguments)
    kinds = given if isinstance(given, list) else [given]
    counts = shares(count, len(kinds))
    firsts = accumulate(counts, initial=0)
    return [
        Part(
            {**arguments, "sensors": sensors},
            PolicyContext(period, config.lateral, make_sensors(sensors), **known),
            *where,
        )
        for sensors, *where in zip(kinds, counts, firsts, strict=False)  # one more of `firsts`
    ]


def random_seed(seed: int) -> int:
    """Of everything random in the training number `seed`; its row i is seeded that + i.

    Trainings share no episode with one another, with the held-out ones or with the benchmark's,
    whose seeds are below FIRST_SEED. Raises ValueError for a number out of range.
    """
    if not 0 <= seed < TRAININGS:
        raise ValueError(f"seed = {seed}; must be in [0, {TRAININGS})")
    return FIRST_SEED + ROWS * seed


def joined(parts: Sequence[VecEnv], seed: int) -> VecEnv:
    """All parts as one, of the training number `seed`."""
    env = parts[0] if len(parts) == 1 else JoinedVecEnv(parts)
    env.seed(random_seed(seed))
    return env


def make_privileged(part: Part) -> Privileged:
    """What a teacher sees of a part's vehicles."""
    context = part.context
    return Privileged(part.rows, context.control_period, VEHICLES[context.vehicle])


def make_part(config: Any, part: Part) -> VecEnv:
    """The vehicles of one kind of sensors as the agent sees them. Raises ValueError."""
    memory: Memory
    arguments = part.arguments
    if config.memory == TEACHER:
        memory = make_privileged(part)
        arguments = {**arguments, "expose_truth": True}
    else:
        memory = make_memory(config.memory, config.memory_options, part.context, part.rows)

    def wrapper(env: Vehicles) -> AgentVectorEnv:
        if isinstance(memory, Privileged):
            env = TruthfulVectorEnv(env, memory)
        precision = config.precision * VEHICLES[part.context.vehicle].contact_length
        return AgentVectorEnv(TrainingReward(env, precision, config.change_price), memory)

    return make_vec_env(config.env, part.rows, None, arguments, False, wrapper, config.staggered)


def make_environment(config: Any, arguments: Mapping[str, Any]) -> VecEnv:
    """All vehicles as the agent sees them. Raises ValueError."""
    parts = [make_part(config, part) for part in parts_of(config, arguments, config.vehicles)]
    monitored = VecMonitor(joined(parts, config.seed), info_keywords=("is_success",))
    scaled = config.settings.scaled
    env: VecEnv = ScaledReward(monitored, config.settings.gamma) if scaled else monitored
    return VecNormalize(env, norm_reward=False) if config.normalise else env


def make_taught(config: Any, arguments: Mapping[str, Any]) -> tuple[VecEnv, list[Privileged]]:
    """All vehicles as a student sees them, and each part's truth, which they fill in.

    Raises ValueError.
    """
    made, truths = [], []
    for part in parts_of(config, {**arguments, "expose_truth": True}, config.vehicles):
        truth = make_privileged(part)
        history = History(part.rows, part.context.control_period, tuple(config.lags))

        def wrapper(
            env: Vehicles, truth: Privileged = truth, history: History = history
        ) -> AgentVectorEnv:
            return AgentVectorEnv(TruthfulVectorEnv(env, truth), history)

        made.append(make_vec_env(config.env, part.rows, None, part.arguments, False, wrapper))
        truths.append(truth)
    return joined(made, config.seed), truths


def make_vehicles(config: Any, part: Part, **more: Any) -> TrackedVehicleVectorEnv:
    """A plain batch of a part's vehicles. Raises ValueError."""
    env: Any = gymnasium.make_vec(
        config.env, part.rows, "vector_entry_point", **part.arguments, **more
    )
    vehicles: TrackedVehicleVectorEnv = env.unwrapped
    return vehicles


class HeldOut(NamedTuple):
    """Held-out episodes of one kind of sensors."""

    env: TrackedVehicleVectorEnv  # in DISABLED mode, one row per episode
    context: PolicyContext
    first: int  # episodes before them, which their seeds go on from


def make_held_out(config: Any, arguments: Mapping[str, Any]) -> list[HeldOut]:
    """The vehicles of the held-out episodes, none where there are to be none.

    Only a teacher's show the truth. Raises ValueError.
    """
    if config.held_out <= 0:
        return []
    told = config.memory == TEACHER
    return [
        HeldOut(
            make_vehicles(config, part, expose_truth=told, autoreset_mode="Disabled"),
            part.context,
            part.first,
        )
        for part in parts_of(config, arguments, config.held_out)
    ]
