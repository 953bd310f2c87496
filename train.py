"""Train an RL agent on randomized tracked vehicles and soils, in minutes on two cores.

All vehicles of a batch are stepped in one process. OUTPUT gets agent.zip (the best on held-out
episodes), last.zip, config.json and curve.csv. Killed? The same command with --resume goes on
from the last checkpoint. Compare the agent with the controllers afterwards:

    python evaluate.py --policies nominal adaptive oracle runs/ppo-blind-seed0/agent.zip
"""

import sys

from agents.ending import Refused, failed, interrupted, raise_again, refusing, stop_at_once

if __name__ == "__main__":
    stop_at_once()  # Ctrl-C; the imports take seconds

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

try:
    import gymnasium
    import torch
    import tyro
    from tqdm import tqdm
    from tyro.constructors import PrimitiveConstructorSpec

    from agents import checkpoints, configs, training
    from agents.algorithms import make_model
    from agents.environment import (
        environment_arguments,
        make_environment,
        make_held_out,
        random_seed,
    )  # fmt: skip
    from agents.folder import AlreadyFinished, begin, finish, going_on
    from agents.inference import STUDENT
    from agents.loading import exact, recipe_of
    from agents.lock import locked
    from agents.memory import LAGS, RESIDUAL_SCALE
    from agents.reward import PRECISION
    from agents.student import make_student
except ImportError as error:
    sys.exit(f"train.py: {error}. Run `make install`, or pip install 'tracked-env[rl,cli]'")

from tracked_env import TORQUE_ID

FREE = ("resume", "overwrite", "output", "tensorboard", "quiet", "trust")  # may differ
WRONG = (ValueError, OSError, gymnasium.error.Error)  # what wrong settings raise


def folder_of(text: str) -> Path:
    """A folder that the command line names. Raises ValueError for an empty name."""
    if not text.strip():
        raise ValueError("--output is empty; name a folder, or `.` for the working directory")
    return Path(text)


Folder = Annotated[
    Path,
    PrimitiveConstructorSpec(
        1, "PATH", lambda words: folder_of(words[0]), lambda given: isinstance(given, Path),
        lambda given: [str(given)],
    ),
]  # fmt: skip


@dataclass(frozen=True)
class Config:
    """Agent, environment and folder of a training."""

    agent: Literal["ppo", "sac", "td3", "tqc", "recurrent-ppo"] = "ppo"
    """Algorithm; its settings are the options that start with its name."""

    memory: Literal["blind", "history", "estimates", "residual", "teacher", "student"] = "blind"
    """Observation augmentation: inputs besides the present observation.
    blind: none (recurrent-ppo has a memory of its own).
    history: past samples. estimates: the identified parameters.
    residual: corrects the action of the adaptive controller.
    teacher: the true parameters. student: drives with TEACHER's network,
    and infers the true parameters from past samples."""

    teacher: Path | None = None
    """Of augmentation student: agent.zip of the teacher."""

    trust: bool = False
    """Open a teacher of a former version too. It is unpickled, which runs any
    code that its author put there: only for authors whom you trust."""

    steps: int | None = None
    """Environment steps, over all vehicles. Default:
    2 000 000 for PPO, 1 000 000 for recurrent PPO,
    300 000 for agents with a replay buffer,
    500 000 for a student."""

    seed: int = 0
    """Of the networks and of the vehicles: same seed, same machine, same agent.
    Trainings with different seeds share no episode."""

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
    """First episodes end at different times: otherwise all vehicles are at the same
    time of their episodes for the whole training."""

    lateral: Literal["sliding", "constrained"] = "sliding"
    """Lateral model of the lumped plant."""

    env_args: str | None = None
    """Further arguments of the environment, as JSON:
    '{"plant": "distributed"}'."""

    output: Folder | None = None
    """Folder of the training. Default:
    runs/AGENT-MEMORY-seedSEED, and of Speed-v0
    runs/Speed-v0/AGENT-MEMORY-seedSEED."""

    resume: bool = False
    """Go on from the last checkpoint in OUTPUT; starts
    where there is none, does nothing where it is finished."""

    overwrite: bool = False
    """Train anew, though OUTPUT holds a training: its files are deleted."""

    evaluate_every: int | None = None
    """Steps between evaluations on held-out episodes;
    default is a tenth of all."""

    held_out: int = 64
    """Held-out episodes; 0 evaluates never and keeps the last agent."""

    checkpoint_every: int | None = None
    """Steps between checkpoints; default is every rollout,
    or 20 000 for students and agents with a replay buffer."""

    normalise: bool = False
    """Normalise the inputs of the network by their running mean and
    deviation. They are of order one already."""

    precision: float = PRECISION
    """Distance of an additional reward term, steeper near the path, in training only,
    over the contact length; 0 leaves it out."""

    smoothness: float | None = None
    """Weight of the action-rate penalty, the mean square of the change of the action per
    control step, in training only; 0 leaves it out. Default: 1 for PPO, 0 for agents with
    a replay buffer, which hardly learn with it."""

    lags: tuple[int, ...] = LAGS
    """Of augmentation history and student: ages of the samples [control steps]."""

    residual_scale: float = RESIDUAL_SCALE
    """Of augmentation residual: largest correction, over the torque limit."""

    tensorboard: bool = False
    """Also write TensorBoard logs to OUTPUT."""

    threads: int = 1
    """Threads of PyTorch; one is often faster than two for networks of this size."""

    quiet: bool = False
    """Show no progress bar."""

    ppo: configs.PPOConfig = field(default_factory=configs.PPOConfig)
    """Settings of PPO."""

    sac: configs.SACConfig = field(default_factory=configs.SACConfig)
    """Settings of SAC."""

    td3: configs.TD3Config = field(default_factory=configs.TD3Config)
    """Settings of TD3."""

    tqc: configs.TQCConfig = field(default_factory=configs.TQCConfig)
    """Settings of TQC."""

    recurrent_ppo: configs.RecurrentPPOConfig = field(default_factory=configs.RecurrentPPOConfig)
    """Settings of RecurrentPPO."""

    student: configs.StudentConfig = field(default_factory=configs.StudentConfig)
    """Settings of augmentation student."""

    def __post_init__(self) -> None:
        configs.check(self)
        if self.teacher is not None and self.memory != STUDENT:
            raise ValueError(
                f"teacher = {self.teacher} with memory {self.memory}; only a student has a "
                "teacher. Did you mean --memory student?"
            )

    @property
    def settings(self) -> Any:
        """Settings of the chosen algorithm."""
        return getattr(self, self.agent.replace("-", "_"))

    @property
    def total_steps(self) -> int:
        """`steps`, or what the chosen algorithm has."""
        learner = self.student if self.memory == STUDENT else self.settings
        return int(learner.steps if self.steps is None else self.steps)

    @property
    def evaluation_interval(self) -> int:
        """`evaluate_every`, or a tenth of all steps."""
        every = self.evaluate_every
        return max(self.total_steps // 10, 1) if every is None else every

    @property
    def change_price(self) -> float:
        """`smoothness`, or what the chosen algorithm has."""
        return float(self.settings.smoothness if self.smoothness is None else self.smoothness)

    @property
    def folder(self) -> Path:
        """Where everything goes."""
        track = "" if self.env == TORQUE_ID else self.env.rpartition("/")[2]
        return self.output or Path("runs", track, f"{self.agent}-{self.memory}-seed{self.seed}")

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


def bar_of(config: Config, done: int) -> "tqdm[Any]":
    """The progress bar of a training of which so many steps are done."""
    return tqdm(
        total=config.total_steps, initial=done, unit=" steps", unit_scale=True,
        disable=config.quiet, dynamic_ncols=True,
    )  # fmt: skip


def teach(config: Config, arguments: Mapping[str, Any], captured: Any) -> int:
    """Train a student of `config.teacher`; returns the exit status. Raises Refused."""
    folder = config.folder
    with refusing(*WRONG):
        student, taught = make_student(config, arguments, captured)
    recipe = {**recipe_of(config, arguments), **taught}
    begin(folder, recipe, student.steps)
    asked = config.checkpoint_every
    every = training.CHECKPOINT_EVERY if asked is None else asked
    schedule = training.Schedule(config.total_steps, config.evaluation_interval, every)
    with bar_of(config, student.steps) as bar:
        show = lambda text: bar.set_postfix_str(text, refresh=False)  # noqa: E731
        student.learn(schedule, folder, recipe, bar.update, show)
    finish(folder, recipe)
    print(
        f"done: {student.steps:,} steps in {student.curve[-1][1]:.0f} s, best "
        f"{student.best:.4f} m held out; {folder / 'agent.zip'}"
    )
    return 0


def learn(config: Config, arguments: Mapping[str, Any], captured: Any) -> int:
    """Train any other agent; returns the exit status. Raises Refused."""
    folder = config.folder
    with refusing(*WRONG):
        env = make_environment(config, arguments)
        log = str(folder) if config.tensorboard else None
        model = make_model(config.agent, config.settings, env, random_seed(config.seed), log)
        held_out = make_held_out(config, arguments)
        if captured is not None:
            checkpoints.resume(model, captured)
    recipe = recipe_of(config, arguments)
    begin(folder, recipe, model.num_timesteps)
    every = training.checkpoint_interval(model, config.checkpoint_every)
    with bar_of(config, model.num_timesteps) as bar:
        trainer = training.Trainer(
            folder, training.Schedule(config.total_steps, config.evaluation_interval, every),
            recipe, (config.memory, config.memory_options), held_out, captured,
            bar.update, lambda text: bar.set_postfix_str(text, refresh=False),
        )  # fmt: skip
        training.learn(model, trainer)
    finish(folder, recipe)
    best = f"best {trainer.best:.4f} m held out, " if held_out else ""
    print(
        f"done: {model.num_timesteps:,} steps in {trainer.seconds:.0f} s, {best}"
        f"{trainer.throughput:,.0f} steps/s with the learner; {folder / 'agent.zip'}"
    )
    return 0


def main(config: Config) -> int:
    """Train and save, alone in the folder; returns the exit status."""
    with ExitStack() as held:
        try:
            held.enter_context(locked(config.folder))
        except ValueError as error:
            return failed(error)
        return train(config)


def train(config: Config) -> int:
    """Train and save; returns the exit status."""
    torch.set_num_threads(config.threads)
    folder = config.folder
    learner = STUDENT if config.memory == STUDENT else config.agent
    try:
        with refusing(*WRONG):
            captured = going_on(folder, exact(config), FREE, config.resume, config.overwrite)
            arguments = environment_arguments(config)
        return (teach if learner == STUDENT else learn)(config, arguments, captured)
    except AlreadyFinished as notice:
        print(notice)
        return 0
    except KeyboardInterrupt:
        return interrupted(folder, checkpoints.exist(folder))
    except Refused as error:
        return failed(error)
    except training.Diverged as error:
        settings = config.student if learner == STUDENT else config.settings
        return failed(
            f"{error}. Lower --{learner}.learning-rate (now {settings.learning_rate:g}) and train "
            f"anew with --overwrite; {folder} keeps the agent and the checkpoint of before"
        )
    except OSError as error:
        return failed(
            f"--output {folder} cannot be written ({error}). Make room or choose another folder; "
            "a checkpoint there is kept, and --resume goes on from it"
        )


if __name__ == "__main__":
    chosen = tyro.cli(Config, description=__doc__)
    raise_again()
    sys.exit(main(chosen))
