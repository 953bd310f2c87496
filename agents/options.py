"""The options of train.py: one dataclass, whose docstrings are its help.

`options_of_train` adds the settings of every registered algorithm, `--NAME.FIELD`; `parse` reads a
command line. Options that the training would not read are refused: settings belong to the algorithm
whose name they begin with, a few options to an augmentation.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import Any, Literal, NoReturn, cast

from agents.algorithms import ALGORITHMS, LIMITS, check
from tracked_env import TORQUE_ID
from tracked_env.benchmark.executors import Shard, parse_shard
from tracked_env.cli.command_line import (
    EnvironmentOptions,
    Parser,
    add_fields,
    as_argument,
    from_fields,
)
from tracked_env.environment_ids import PUBLISHED, bare

DEFAULT = "ppo"  # the algorithm where --agent is not given


def _folder(text: str) -> Path:
    """A path that the command line names."""
    if not text.strip():
        raise argparse.ArgumentTypeError("is empty; name one, or `.` for the working directory")
    return Path(text)


@dataclass(frozen=True)
class Options(EnvironmentOptions):
    """Agent, environment and folder of a training."""

    agent: str | None = None
    """Algorithm, by default ppo; its settings are the options that start with its name."""
    augmentation: Literal["blind", "history", "reckoned", "estimates", "residual"] = "blind"
    """Observation augmentation: inputs besides the present observation. blind: none (recurrent-ppo
    remembers by itself). history: past samples. reckoned: the pose error by dead reckoning.
    estimates: the identified parameters. residual: corrects the action of BASE."""
    steps: int | None = None
    """Environment steps, over all vehicles. Default: 2 000 000 for PPO, 1 000 000 for recurrent
    PPO, 300 000 for agents with a replay buffer."""
    seed: int = 0
    """Of the networks and of the vehicles, 0 or more: same seed, same machine, same agent.
    Trainings with different seeds share no episode."""
    vehicles: int = 64
    """Vehicles stepped together."""
    env: str = TORQUE_ID
    """Id of the environment, ours with or without `tracked_env/`, or one of your own, as
    module:namespace/Name-v0."""
    uncertainty: tuple[str, ...] | None = None
    """Uncertainty sets to train on (default: that of ENV), or `mixture` for all that the benchmark
    calls in distribution; of several, every episode draws one."""
    sensors: tuple[str, ...] | None = None
    """Sensor presets ideal, rtk, strawa or mocap, or JSON overrides: '{"preset": "rtk",
    "pose_delay": 0.1}'; of several, each gets its part of the vehicles. `mixture`: rtk; rtk 0.2 s
    late; strawa; rtk without velocity; rtk-outages; rtk with one pose a second (on Speed-v0 and
    Terrain-v0: mocap; mocap 0.1 s late; mocap with noise of 5 cm; mocap without velocity;
    mocap-outages; mocap with one pose a second)."""
    reference: str | None = None
    """Kind of reference to follow, or JSON. `mixture`: three episodes of five as ENV has it, one
    faster, one backward."""
    duration: float | None = None
    """Length of an episode [s], 0.1 to 3600. Default: that of ENV, 30 of ours."""
    staggered: bool = True
    """First episodes end at different times: otherwise all vehicles are at the same time of their
    episodes for the whole training."""
    lateral: Literal["sliding", "constrained"] | None = None
    """Lateral model of the lumped plant. Default: that of ENV, sliding of ours."""
    output: Path | None = field(default=None, metadata={"type": _folder})
    """Folder of the training. Default: runs/AGENT-AUGMENTATION-seedSEED, and of another id, as
    Speed-v0, runs/Speed-v0/AGENT-AUGMENTATION-seedSEED."""
    resume: bool = False
    """Go on from the last checkpoint in OUTPUT; starts where there is none, does nothing where it
    is finished."""
    overwrite: bool = False
    """Train anew, though OUTPUT holds a training: its files are deleted."""
    evaluate_every: int | None = None
    """Steps between evaluations on held-out episodes; default is a tenth of all."""
    held_out: int = 64
    """Held-out episodes; 0 evaluates never and keeps the last agent."""
    checkpoint_every: int | None = None
    """Steps between checkpoints; default is every rollout, or 20 000 for agents with a replay
    buffer."""
    normalise: bool = False
    """Normalise the inputs of the network by their running mean and deviation. They are of order
    one already."""
    precision: float | None = None
    """Distance of an additional reward term, steeper near the path, in training only, over the
    contact length; 0 leaves it out. Default: 0.075."""
    smoothness: float | None = None
    """Weight of the action-rate penalty, the mean square of the change of the action per control
    step, in training only; 0 leaves it out. Default: 1 for PPO, 0 for agents with a replay buffer,
    which hardly learn with it."""
    lags: tuple[int, ...] | None = None
    """Of augmentation history: ages of the samples [control steps]. Default: 1 2 4 8 16 32."""
    residual_scale: float | None = None
    """Of augmentation residual: largest correction, over the torque limit. Default: 0.3."""
    base: str | None = None
    """Of augmentation residual: the policy that the agent corrects, adaptive or mpc-adaptive, on
    vehicles driven by torque. Default: adaptive."""
    data_sheet: bool = False
    """Show the agent the noise of its sensors, which the controllers know as well: it tells sensors
    apart that a single sample does not."""
    tensorboard: bool = False
    """Also write TensorBoard logs to OUTPUT."""
    threads: int = 1
    """Threads of PyTorch; one is often faster than two for networks of this size."""
    quiet: bool = False
    """Show no progress bar."""

    def __post_init__(self) -> None:
        short = {bare(env): env for env in PUBLISHED}
        object.__setattr__(self, "env", short.get(self.env, self.env))
        check(self)
        if self.agent is not None and self.agent not in ALGORITHMS:
            raise ValueError(f"agent = {self.agent!r}; must be one of {', '.join(ALGORITHMS)}")

    @property
    def algorithm(self) -> str:
        """Name of the algorithm: `agent`, or the default one."""
        return DEFAULT if self.agent is None else self.agent

    @property
    def settings(self) -> Any:
        """Settings of the algorithm."""
        return getattr(self, self.algorithm.replace("-", "_"))

    @property
    def folder(self) -> Path:
        """Where everything goes."""
        track = "" if self.env == TORQUE_ID else bare(self.env)
        name = f"{self.algorithm}-{self.augmentation}-seed{self.seed}"
        return self.output or Path("runs", track, name)


@dataclass(frozen=True)
class Several:
    """Several trainings, and where they run."""

    seeds: str | None = None
    """Train one agent for each of these seeds: FIRST:END without the end, as 0:5, or 1,3. OUTPUT is
    then the folder of their folders."""
    sweep: Path | None = None
    """Train what a file (TOML or JSON) says: agents x augmentations x uncertainty x seeds, then
    evaluate them all. The same command goes on where it was. All other options but WORKERS,
    SHARD and RAY are in the file."""
    workers: int | None = None
    """Of SEEDS and SWEEP: trainings at the same time, in processes of this machine, 1 or more.
    Default: 1."""
    shard: Shard | None = field(default=None, metadata={"type": as_argument(parse_shard)})
    """Of SEEDS and SWEEP: train part I of N alone, as I/N, for arrays of SLURM."""
    ray: str | None = None
    """Of SEEDS and SWEEP: a Ray cluster (extra `cluster`) that trains, one processor each: local,
    auto or HOST:PORT."""

    def __post_init__(self) -> None:
        names = [one.name for one in fields(self) if getattr(self, one.name) is not None]
        if names and not {"seeds", "sweep"} & set(names):
            raise ValueError(f"--{names[0]} is of several trainings; give --seeds or --sweep too")
        if {"seeds", "sweep"} <= set(names):
            raise ValueError("--seeds and --sweep are given; the seeds of a sweep are in its file")


def options_of_train() -> type[Options]:
    """`Options` with a choice of, and the settings of, every algorithm that is registered now.

    Raises ValueError for an algorithm that is called like another option.
    """
    names = {option.name for option in fields(Options)}
    for name in ALGORITHMS:
        if name.replace("-", "_") in names:
            raise ValueError(f"algorithm {name!r}: --{name} is another option; rename it")
    choice: Any = Literal[tuple(ALGORITHMS)]
    own = [("agent", choice | None, None)]
    own += [
        (name.replace("-", "_"), of.settings, field(default_factory=of.settings))
        for name, of in ALGORITHMS.items()
    ]
    whole = make_dataclass("Config", own, bases=(Options,), frozen=True)
    return cast(type[Options], whole)


# From command lines


class _Arguments(Parser):
    """The parser of train.py: what is wrong is a ValueError."""

    def exit(self, status: int = 0, message: str | None = None) -> NoReturn:
        """Raises ValueError for a message of an error."""
        if status:
            raise ValueError(str(message).strip().removeprefix("train.py: "))
        super().exit(status, message)


def parse(
    arguments: Sequence[str], kind: type[Options], description: str = ""
) -> tuple[Options, Several]:
    """The options of a command line; kind: of `options_of_train`.

    Raises ValueError for a command line that makes no sense.
    """
    form = {"formatter_class": argparse.RawDescriptionHelpFormatter}
    parser = _Arguments("train.py", description, usage="train.py [-h] [OPTIONS]", **form)
    add_fields(parser, Several)
    add_fields(parser, kind, ranges=LIMITS)
    namespace = parser.parse_args(arguments)
    return from_fields(kind, namespace), from_fields(Several, namespace)


def words_of(options: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Options from a file, {name: value or settings}, as words of a command line."""
    for name, value in options.items():
        flag = f"{prefix}{name}".replace("_", "-")
        if isinstance(value, Mapping):
            yield from words_of(value, f"{flag}.")
        elif isinstance(value, bool):
            yield f"--{flag}" if value else f"--no-{flag}"
        elif isinstance(value, list):
            yield from (f"--{flag}", *map(str, value))
        else:
            yield f"--{flag}={value}"


# Options without effect

_READ_BY = {"lags": "history", "residual_scale": "residual", "base": "residual"}


def changed_options(options: Options) -> list[str]:
    """Names of the options that have another value than by default."""
    usual, names = type(options)(), [one.name for one in fields(options)]
    return [name for name in names if getattr(options, name) != getattr(usual, name)]


def check_read(options: Options) -> None:
    """Raises ValueError for an option that has another value than by default, and no effect."""
    changed = changed_options(options)
    for name, kind in _READ_BY.items():
        if name in changed and options.augmentation != kind:
            flag = name.replace("_", "-")
            raise ValueError(
                f"--{flag} has no effect with augmentation {options.augmentation}: it is an option "
                f"of augmentation {kind}. Give that, or leave it out"
            )
    for name in ALGORITHMS:
        if name.replace("-", "_") in changed and name != options.algorithm:
            raise ValueError(
                f"--{name} options have no effect: what learns is {options.algorithm}. Give "
                f"--agent {name}, or leave them out"
            )
