"""Train an RL agent on randomized tracked vehicles and soils, in minutes on two cores.

All vehicles of a batch are stepped in one process. OUTPUT gets agent.zip (the best on held-out
episodes), last.zip, config.json and curve.csv. Killed? The same command with --resume goes on
from the last checkpoint. Compare the agent with the controllers afterwards:

    python evaluate.py --policies nominal adaptive oracle runs/ppo/agent.zip
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

try:
    import gymnasium
    import torch
    import tyro
    from stable_baselines3.common.base_class import BaseAlgorithm
    from tqdm import tqdm

    from agents import checkpoints
    from agents.algorithms import make_model
    from agents.configs import (
        PPOConfig,
        RecurrentPPOConfig,
        SACConfig,
        StudentConfig,
        TD3Config,
        TQCConfig,
    )  # fmt: skip
    from agents.environment import environment_arguments, make_environment, make_held_out
    from agents.inference import STUDENT
    from agents.loading import exact, recipe_of
    from agents.memory import LAGS, RESIDUAL_SCALE
    from agents.reward import PRECISION
    from agents.student import make_student
    from agents.training import CHECKPOINT_EVERY, Schedule, Trainer, checkpoint_interval
except ImportError as error:
    sys.exit(f"train.py: {error}. Run `make install`, or pip install 'tracked-env[rl,cli]'")

from tracked_env import TORQUE_ID
from tracked_env.benchmark.store import write_atomically

INTERRUPTED = 130  # exit status, as shells have it for Ctrl-C
FREE = ("resume", "output", "tensorboard", "quiet")  # may differ when a training is resumed


@dataclass(frozen=True)
class Config:
    """What to train, on what, and where it goes."""

    agent: Literal["ppo", "sac", "td3", "tqc", "recurrent-ppo"] = "ppo"
    """Algorithm; its settings are the options that start with its name."""

    memory: Literal["blind", "history", "estimates", "residual", "teacher", "student"] = "blind"
    """What the agent has besides the present observation.
    blind: nothing (recurrent-ppo remembers by itself).
    history: past samples. estimates: the identified parameters.
    residual: corrects the action of the adaptive controller.
    teacher: the true parameters. student: drives with TEACHER's network,
    and infers from past samples what that was told."""

    teacher: Path | None = None
    """Of memory student: agent.zip of the teacher."""

    steps: int = 2_000_000
    """Environment steps, over all vehicles."""

    seed: int = 0
    """Of the networks and of the vehicles: same seed, same machine, same agent."""

    vehicles: int = 64
    """Vehicles stepped together."""

    env: str = TORQUE_ID
    """Id of the environment."""

    uncertainty: tuple[str, ...] | None = None
    """Uncertainty sets to train on (default: that of ENV), or `mixture` for all but ood;
    of several, every episode draws one."""

    sensors: tuple[str, ...] | None = None
    """Sensor presets ideal, rtk, strawa or mocap, or JSON overrides:
    '{"preset": "rtk", "pose_delay": 0.1}'; of several, each gets its part of
    the vehicles. `mixture`: rtk; rtk 0.2 s late; strawa; rtk without velocity."""

    reference: str | None = None
    """Kind of reference to follow, or JSON."""

    duration: float = 30.0
    """Length of an episode [s]."""

    staggered: bool = True
    """First episodes end at different times: else all vehicles are beside their
    path at once, and settled at once, for the whole training."""

    lateral: Literal["sliding", "constrained"] = "sliding"
    """Lateral closure of the plant."""

    output: Path | None = None
    """Folder of the training; default is runs/AGENT-MEMORY-seedSEED."""

    resume: bool = False
    """Go on from the last checkpoint in OUTPUT; starts where there is none."""

    evaluate_every: int = 200_000
    """Steps between evaluations on held-out episodes."""

    held_out: int = 64
    """Held-out episodes; 0 evaluates never and keeps the last agent."""

    checkpoint_every: int | None = None
    """Steps between checkpoints; default is every rollout,
    or 50 000 for students and agents with a replay buffer."""

    normalise: bool = False
    """Normalise what the network sees by its running mean and
    deviation. It is of order one already."""

    precision: float = PRECISION
    """Distance of a sharper reward term that only the training sees,
    over the contact length; 0 leaves it out."""

    smoothness: float | None = None
    """Price of a change of the action, only in training: times its mean
    square per control step. More drives calmer, less accurately; 0 leaves it out.
    Default: 1 for PPO, 0 for agents with a replay buffer, which it keeps from learning."""

    lags: tuple[int, ...] = LAGS
    """Of memory history and student: ages of the samples [control steps]."""

    residual_scale: float = RESIDUAL_SCALE
    """Of memory residual: largest correction, over the torque limit."""

    tensorboard: bool = False
    """Also write TensorBoard logs to OUTPUT."""

    threads: int = 1
    """Threads of PyTorch; one is often faster than two for networks of this size."""

    quiet: bool = False
    """Show no progress bar."""

    ppo: PPOConfig = field(default_factory=PPOConfig)
    """Settings of PPO."""

    sac: SACConfig = field(default_factory=SACConfig)
    """Settings of SAC."""

    td3: TD3Config = field(default_factory=TD3Config)
    """Settings of TD3."""

    tqc: TQCConfig = field(default_factory=TQCConfig)
    """Settings of TQC."""

    recurrent_ppo: RecurrentPPOConfig = field(default_factory=RecurrentPPOConfig)
    """Settings of RecurrentPPO."""

    student: StudentConfig = field(default_factory=StudentConfig)
    """Settings of memory student."""

    @property
    def settings(self) -> Any:
        """Settings of the chosen algorithm."""
        return getattr(self, self.agent.replace("-", "_"))

    @property
    def change_price(self) -> float:
        """`smoothness`, or what the chosen algorithm has."""
        return float(self.settings.smoothness if self.smoothness is None else self.smoothness)

    @property
    def folder(self) -> Path:
        """Where everything goes."""
        return self.output or Path("runs") / f"{self.agent}-{self.memory}-seed{self.seed}"

    @property
    def memory_options(self) -> dict[str, Any]:
        """Options of the chosen kind of memory."""
        lags = list(self.lags)
        options: dict[str, dict[str, Any]] = {
            "history": {"lags": lags},
            "residual": {"scale": self.residual_scale},
            "student": {"lags": lags, "hidden": list(self.student.hidden)},
        }
        return options.get(self.memory, {})


def learn(config: Config, model: BaseAlgorithm, trainer: Trainer) -> bool:
    """Train to the end; False when interrupted."""
    left = config.steps - model.num_timesteps
    if left <= 0:
        return True
    try:
        model.learn(left, callback=trainer, reset_num_timesteps=model.num_timesteps == 0)
    except KeyboardInterrupt:
        return False
    return True


def bar_of(config: Config, done: int) -> "tqdm[Any]":
    """The progress bar of a training of which so many steps are done."""
    return tqdm(
        total=config.steps, initial=done, unit=" steps", unit_scale=True, disable=config.quiet,
        dynamic_ncols=True,
    )  # fmt: skip


def interrupted(folder: Path) -> int:
    """Say how to go on; returns the exit status."""
    print(f"\ninterrupted; go on with --resume --output {folder}", file=sys.stderr)
    return INTERRUPTED


def begin(folder: Path, recipe: Mapping[str, Any], done: int) -> None:
    """Write the configuration; say so where a training goes on."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / "config.json", json.dumps(recipe, indent=2).encode())
    if done:
        print(f"going on after {done:,} steps")


def teach(config: Config, arguments: Mapping[str, Any], captured: Any) -> int:
    """Train a student of `config.teacher`; returns the exit status. Raises ValueError."""
    folder = config.folder
    student, taught = make_student(config, arguments, captured)
    recipe = {**recipe_of(config, arguments), **taught}
    begin(folder, recipe, student.steps)
    every = CHECKPOINT_EVERY if config.checkpoint_every is None else config.checkpoint_every
    schedule = Schedule(config.steps, config.evaluate_every, every)
    with bar_of(config, student.steps) as bar:
        show = lambda text: bar.set_postfix_str(text, refresh=False)  # noqa: E731
        try:
            student.learn(schedule, folder, recipe, bar.update, show)
        except KeyboardInterrupt:
            return interrupted(folder)
    checkpoints.remove(folder)
    print(
        f"done: {student.steps:,} steps in {student.curve[-1][1]:.0f} s, best "
        f"{student.best:.4f} m held out; {folder / 'agent.zip'}"
    )
    return 0


def main(config: Config) -> int:
    """Train and save; returns the exit status."""
    torch.set_num_threads(config.threads)
    folder = config.folder
    try:
        if config.steps < 1:
            raise ValueError(f"steps = {config.steps}; must be at least 1")
        captured = checkpoints.going_on(folder, config.resume, exact(config), FREE)
        arguments = environment_arguments(config)
        if config.memory == STUDENT:
            return teach(config, arguments, captured)
        env = make_environment(config, arguments)
        log = str(folder) if config.tensorboard else None
        model = make_model(config.agent, config.settings, env, config.seed, log)
        held_out = make_held_out(config, arguments)
    except (ValueError, gymnasium.error.Error) as error:
        print(f"train.py: {error}", file=sys.stderr)
        return 2
    recipe = recipe_of(config, arguments)
    if captured is not None:
        checkpoints.resume(model, captured)
    begin(folder, recipe, model.num_timesteps)
    every = checkpoint_interval(model, config.checkpoint_every)
    with bar_of(config, model.num_timesteps) as bar:
        trainer = Trainer(
            folder, Schedule(config.steps, config.evaluate_every, every), recipe,
            (config.memory, config.memory_options), held_out, captured,
            bar.update, lambda text: bar.set_postfix_str(text, refresh=False),
        )  # fmt: skip
        finished = learn(config, model, trainer)
    if not finished:
        return interrupted(folder)
    checkpoints.remove(folder)
    best = f"best {trainer.best:.4f} m held out, " if held_out else ""
    print(
        f"done: {model.num_timesteps:,} steps in {trainer.seconds:.0f} s, {best}"
        f"{trainer.throughput:,.0f} steps/s with the learner; {folder / 'agent.zip'}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Config, description=__doc__)))
