"""The vehicles of a training, as its agent sees them, and those of the held-out episodes."""

from collections.abc import Sequence
from typing import Any

import gymnasium
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

from agents.held_out import HeldOut
from agents.options import Part
from agents.reward import ScaledReward, TrainingReward
from agents.run import Run
from agents.vector_envs import AgentVectorEnv, JoinedVecEnv, Privileged, TruthfulVectorEnv
from baselines.learned.agent_policy import TEACHER
from baselines.learned.augmentation import Augmentation, make_augmentation
from baselines.learned.student import widened_by
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sb3 import make_vec_env
from tracked_env.vector_env import TrackedVehicleVectorEnv

Vehicles = gymnasium.vector.VectorEnv[Any, Any, Any]


def joined(parts: Sequence[VecEnv], seed: int) -> VecEnv:
    """All parts as one; row i is seeded seed + i."""
    env = parts[0] if len(parts) == 1 else JoinedVecEnv(parts)
    env.seed(seed)
    return env


def make_privileged(part: Part) -> Privileged:
    """What a teacher sees of a part's vehicles."""
    context = part.context
    return Privileged(part.rows, context.control_period, VEHICLES[context.vehicle])


def make_part(run: Run, part: Part) -> VecEnv:
    """The vehicles of one kind of sensors as the agent sees them. Raises ValueError."""
    augmentation: Augmentation
    arguments, (kind, options) = part.arguments, run.augmentation
    if kind == TEACHER:
        augmentation = make_privileged(part)
        arguments = {**arguments, "expose_truth": True}
    else:
        augmentation = make_augmentation(kind, options, part.context, part.rows)

    def wrapper(env: Vehicles) -> AgentVectorEnv:
        if isinstance(augmentation, Privileged):
            env = TruthfulVectorEnv(env, augmentation)
        precision = run.reward.precision * VEHICLES[part.context.vehicle].contact_length
        rewarded = TrainingReward(env, precision, run.reward.smoothness)
        return AgentVectorEnv(rewarded, augmentation)

    return make_vec_env(run.env, part.rows, None, arguments, False, wrapper, run.staggered)


def make_environment(run: Run) -> VecEnv:
    """All vehicles as the agent sees them. Raises ValueError."""
    parts = [make_part(run, part) for part in run.parts]
    env: VecEnv = VecMonitor(joined(parts, run.seed), info_keywords=("is_success",))
    if run.algorithm.scaled:
        env = ScaledReward(env, run.settings.gamma)
    return VecNormalize(env, norm_reward=False) if run.normalise else env


def make_taught(run: Run) -> tuple[VecEnv, list[Privileged]]:
    """All vehicles as a student sees them, and each part's truth, which they fill in.

    Raises ValueError.
    """
    made, truths = [], []
    for part in run.parts:
        truth = make_privileged(part)
        widening = widened_by(run.augmentation.options)
        memory = make_augmentation(*widening, part.context, part.rows)

        def wrapper(
            env: Vehicles, truth: Privileged = truth, memory: Augmentation = memory
        ) -> AgentVectorEnv:
            return AgentVectorEnv(TruthfulVectorEnv(env, truth), memory)

        arguments = {**part.arguments, "expose_truth": True}
        made.append(make_vec_env(run.env, part.rows, None, arguments, False, wrapper))
        truths.append(truth)
    return joined(made, run.seed), truths


def make_vehicles(run: Run, part: Part, **more: Any) -> TrackedVehicleVectorEnv:
    """A plain batch of a part's vehicles. Raises ValueError."""
    env: Any = gymnasium.make_vec(
        run.env, part.rows, "vector_entry_point", **part.arguments, **more
    )
    vehicles: TrackedVehicleVectorEnv = env.unwrapped
    return vehicles


def make_held_out(run: Run) -> list[HeldOut]:
    """The vehicles of the held-out episodes, none where there are to be none.

    Only a teacher's show the truth. Raises ValueError.
    """
    truth = run.augmentation.kind == TEACHER
    return [
        HeldOut(
            make_vehicles(run, part, expose_truth=truth, autoreset_mode="Disabled"),
            part.context,
            part.first,
        )
        for part in run.held_out
    ]
