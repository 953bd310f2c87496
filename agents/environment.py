"""The vehicles of a training, as its agent sees them, and those of the held-out episodes.

config: of train.py. arguments: of the environment.
"""

import json
from collections.abc import Mapping
from typing import Any

import gymnasium
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from agents.memory import AgentVectorEnv, Memory, make_memory
from agents.precision import PreciseReward
from agents.privileged import TEACHER, Privileged, TruthfulVectorEnv
from tracked_env.benchmark import PolicyContext
from tracked_env.sb3 import make_vec_env
from tracked_env.sensors import make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

# `mixture`: everything that the benchmark calls in distribution; `ood` stays out of every training.
MIXTURE = (
    "soil-and-mass", "payload", "resistance-map", "weak-soil", "terrain-transition", "drift",
    "mixed",
)  # fmt: skip


def name_or_json(text: str, what: str) -> str | Mapping[str, Any]:
    """`text` itself, or the JSON object that it holds. Raises ValueError."""
    if not text.lstrip().startswith("{"):
        return text
    try:
        return dict(json.loads(text))
    except ValueError as error:
        raise ValueError(f"--{what} {text}: not a JSON object ({error})") from error


def environment_arguments(config: Any) -> dict[str, Any]:
    """Arguments of the environment. Raises ValueError."""
    sets = [
        part for name in config.uncertainty for part in (MIXTURE if name == "mixture" else (name,))
    ]
    return {
        "uncertainty": sets[0] if len(sets) == 1 else sets,
        "sensors": name_or_json(config.sensors, "sensors"),
        "reference": name_or_json(config.reference, "reference"),
        "duration": config.duration,
        "lateral": config.lateral,
    }


def context_of(config: Any, arguments: Mapping[str, Any]) -> PolicyContext:
    """What a policy may know of the environment. Raises ValueError."""
    return PolicyContext(0.02, config.lateral, make_sensors(arguments["sensors"]))


def make_environment(config: Any, arguments: Mapping[str, Any]) -> tuple[VecEnv, PolicyContext]:
    """The vehicles as the agent sees them, and their context. Raises ValueError."""
    context = context_of(config, arguments)
    memory: Memory
    if config.memory == TEACHER:
        memory = Privileged(config.vehicles, context.control_period)
        arguments = {**arguments, "expose_truth": True}
    else:
        memory = make_memory(config.memory, config.memory_options, context, config.vehicles)

    def wrapper(env: gymnasium.vector.VectorEnv[Any, Any, Any]) -> AgentVectorEnv:
        if isinstance(memory, Privileged):
            env = TruthfulVectorEnv(env, memory)
        return AgentVectorEnv(
            PreciseReward(env, config.precision) if config.precision else env, memory
        )

    env = make_vec_env(config.env, config.vehicles, config.seed, arguments, wrapper=wrapper)
    return (VecNormalize(env, norm_reward=False) if config.normalise else env), context


def make_vehicles(
    config: Any, arguments: Mapping[str, Any], count: int, **more: Any
) -> TrackedVehicleVectorEnv:
    """A plain batch of `count` vehicles. Raises ValueError."""
    env: Any = gymnasium.make_vec(config.env, count, "vector_entry_point", **arguments, **more)
    vehicles: TrackedVehicleVectorEnv = env.unwrapped
    return vehicles


def make_held_out(config: Any, arguments: Mapping[str, Any]) -> TrackedVehicleVectorEnv | None:
    """The vehicles of the held-out episodes, None where there are to be none.

    Only a teacher's show the truth. Raises ValueError.
    """
    if config.held_out <= 0:
        return None
    told = config.memory == TEACHER
    return make_vehicles(
        config, arguments, config.held_out, expose_truth=told, autoreset_mode="Disabled"
    )
