"""Options of `tracked-env evaluate` and evaluate.py, and a configuration from them."""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.evaluation_sets import SETS, default_sets
from tracked_env.benchmark.executors import Shard, parse_shard
from tracked_env.cli.exit_status import Parser
from tracked_env.validation import checked_choice, known

DESCRIPTION = """Compare policies on the same randomized tracked vehicles, soils and references.

Every policy meets the same vehicles, soils, references and sensor noise. The summary says, per
uncertainty set, how far each policy is from the reference, and whether the first one is clearly
worse than the others; the leaderboard orders them by score. Results go to a folder named after
the configuration, under OUTPUT: results.json, episodes.csv, summary.md, leaderboard.html and
figures.

Where neither policies nor sets are named, a few policies drive a few episodes of four sets, in
about a minute: a first look. --all compares everything that is registered, on all sets.

An interrupted run loses at most the chunk of episodes in progress; run it again to continue.
"""
ENVIRONMENTS = (TORQUE_ID, SPEED_ID, TERRAIN_ID)  # those with evaluation sets
EPISODES, EPISODES_AT_FIRST = 32, 16  # of each set; with fewer than 16 there is no verdict
PAPERS = ("none", "strawa2021", "focchi2025")
# Options of what drives a single episode.
EPISODE = ("env", "seed", "sensors", "reference", "duration", "lateral")


def short_env(text: str) -> str:
    """An environment id, with or without the name space `tracked_env/`."""
    return text if "/" in text else f"tracked_env/{text}"


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas, empty ones left out; a file whose name has a comma is one."""
    given = text.rpartition("=")[2]
    parts = (text,) if Path(given).exists() else text.split(",")
    return tuple(part for part in parts if part)


class JoinedNames(argparse.Action):
    """Stores what `names` made of each argument as one tuple, every name once."""

    def __call__(
        self, parser: object, given: argparse.Namespace, values: Any, option: object = None
    ) -> None:
        """Store the names."""
        joined = tuple(dict.fromkeys(name for part in values for name in part))
        setattr(given, self.dest, joined)


def env_of(env: str | None, sets: Sequence[str] | None, option: str = "--sets") -> str:
    """The environment id that is named, else that of the first named set, else Torque-v0.

    option: that names the sets. Raises ValueError for unknown sets and for those of another id.
    """
    for name in sets or ():
        if name not in SETS:
            own = [each.name for each in SETS.values() if env in (None, each.env)]
            near = known(name, own).rpartition("].")[2]
            raise ValueError(
                f"unknown evaluation set {name!r}; `tracked-env envs` lists the {len(own)} sets "
                f"of {env or 'the environments'}.{near}"
            )
    if not sets:
        return env or TORQUE_ID
    first, chosen = sets[0], env or SETS[sets[0]].env
    for name in sets:
        if SETS[name].env != chosen:
            cause = f"--env {_bare(chosen)}" if env else f"{first!r} of {_bare(chosen)}"
            raise ValueError(
                f"{option} {name!r} is of {_bare(SETS[name].env)}, which contradicts {cause}; must "
                "be of one environment: `tracked-env envs` lists them"
                + (". Leave --env out, or name another set" if env else "")
            )
    return chosen


def _bare(env: str) -> str:
    return env.rpartition("/")[2]


def env_type(allowed: Sequence[str]) -> Callable[[str], str]:
    """What makes one of the allowed environment ids of an argument."""

    short = [env.rpartition("/")[2] for env in allowed]

    def env_of(text: str) -> str:
        try:
            return short_env(checked_choice("environment", text.rpartition("/")[2], short))
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return env_of


def shard_of(text: str) -> Shard:
    """A part of the work, I/N."""
    try:
        return parse_shard(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def option(default: Any, text: str, **more: Any) -> Any:
    """A field of Config: its default, its help, and what else argparse needs."""
    return field(default=default, metadata={"help": text, **more})


def flag(default: bool, text: str) -> Any:
    """A field of Config that is switched by --NAME and --no-NAME."""
    return option(default, text, action=argparse.BooleanOptionalAction)


@dataclass(frozen=True)
class Config:
    """What to compare, on what, and where the results go."""

    env: str | None = option(
        None,
        "environment id, with or without `tracked_env/`: sprocket torques as actions, "
        "or speeds, on level ground or on slopes (default: that of the sets that are named, "
        "else Torque-v0)",
    )
    policies: tuple[str, ...] | None = option(
        None,
        "policies to compare, separated by spaces or commas; the first one is the baseline. By "
        "default, where sets are named, all that are registered for the environment: `tracked-env "
        "policies` lists them. NAME: a registered controller or agent, with all its seeds. "
        "NAME@SEED: one of them. path/to/agent.zip: an agent "
        "of train.py, or, with --trust, any other archive of Stable-Baselines3. "
        "NAME=runs/ppo-*/agent.zip: the seeds of one agent, summarised together. "
        "module:attribute: any object with a `predict` as in Stable-Baselines3, or what makes one; "
        "it is imported and run",
        nargs="+", type=names, action=JoinedNames, metavar="POLICY",
    )  # fmt: skip
    trust: bool = flag(
        False,
        "open archives that hold pickled objects too: those of Stable-Baselines3 itself, and of "
        "former versions of train.py. Opening one runs any code that its author put there: only "
        "for authors whom you trust. Agents of train.py hold none and need it not",
    )
    sets: tuple[str, ...] | None = option(
        None,
        "evaluation sets: laws of vehicle, soil and changes, and sensors, separated by spaces or "
        "commas. By default, where policies are named, all of the environment but the known ones: "
        "`tracked-env envs` lists them",
        nargs="+", type=names, action=JoinedNames, metavar="SET",
    )  # fmt: skip
    all: bool = flag(
        False, "all policies that are registered, unless some are named, on all sets, unless some "
        "are named",
    )  # fmt: skip
    sets_version: str | None = option(
        None, "version of the frozen sets, such as v2; by default the newest one that holds them",
        metavar="VERSION",
    )  # fmt: skip
    episodes: int | None = option(
        None,
        f"episodes per set (default: {EPISODES}, and {EPISODES_AT_FIRST} where neither policies "
        "nor sets are named); the frozen ones are the first 100 of each",
        type=int, metavar="N",
    )  # fmt: skip
    seed: int = option(0, "seed of the first episode; of the frozen ones it is 0", type=int)
    sensors: str | None = option(
        None,
        "instead of the sensors of each set: ideal, rtk, strawa, mocap, or JSON: "
        '\'{"preset": "rtk", "pose_delay": 0.1}\'',
    )
    reference: str | None = option(
        None,
        "instead of the reference of each set: random, mixed, circle, figure_eight, straight, "
        "spiral, chicane, identification, or JSON: "
        '\'{"kind": "circle", "radius": 10, "speed": 2}\'',
    )
    duration: float | None = option(
        None, "instead of the length of the episodes of each set [s]", type=float
    )
    lateral: str = option(
        "sliding",
        "lateral constraint of the plant: sliding tracks, or the ICR held at a constant distance "
        "as in the original paper",
        choices=("sliding", "constrained"),
    )
    output: Path = option(  # noqa: RUF009, a field, and a path does not change
        Path("results"),
        "folder for results; each configuration gets its own in it, which one evaluation at a "
        "time may write",
        type=Path,
    )
    figures: bool = flag(True, "draw paths, errors, torque and slip as SVG, on the page too")
    video: bool = flag(False, "record the first episode of the first set, every policy")
    quiet: bool = flag(False, "show neither progress nor tables: only where the results are")
    paper: str = option(
        "none",
        "instead of the benchmark, run a paper's experiments again: its claims beside what comes "
        "out, its figures, one page; needs a clone of the repository",
        choices=PAPERS,
    )
    chunk: int = option(
        64, "episodes run and stored together, at most; numbers do not change", type=int
    )
    workers: int | None = option(
        None, "processes of this machine that run chunks at the same time", type=int, metavar="N"
    )
    shard: Shard | None = option(  # noqa: RUF009, a field
        None,
        "run part I of N of the chunks, in one of N independent processes, as in an array of "
        "SLURM; the same command without it merges them and writes the tables",
        type=shard_of, metavar="I/N",
    )  # fmt: skip
    ray: str | None = option(
        None,
        "run the chunks on a Ray cluster (extra `cluster`): local, auto or HOST:PORT",
        metavar="ADDRESS",
    )

    @property
    def is_first_look(self) -> bool:
        """Whether neither policies nor sets are named, nor all of them asked for."""
        return not (self.policies or self.sets or self.sets_version or self.all)

    @property
    def episodes_per_set(self) -> int:
        """How many episodes of each set are run."""
        if self.episodes is not None:
            return self.episodes
        return EPISODES_AT_FIRST if self.is_first_look else EPISODES


FIELDS = {each.name: each for each in fields(Config)}


def add_option(
    parser: argparse.ArgumentParser, name: str, text: str | None = None, **changed: Any
) -> None:
    """A field of Config as an option.

    text: its help, where it is not that of the field. changed: what else argparse gets in place of
    what the field says, as `default`.
    """
    of = FIELDS[name]
    more = {"default": of.default, **of.metadata, **changed}
    told = more.pop("help")
    said = told if text is None else text
    default = more["default"]
    if default is not None and not isinstance(default, bool):
        said += f" (default: {default})"
    parser.add_argument(f"--{name.replace('_', '-')}", help=said.lstrip(), **more)


def add_env(
    parser: argparse.ArgumentParser, envs: Sequence[str] = ENVIRONMENTS, **changed: Any
) -> None:
    """The option --env of a command for these environments; changed: as in `add_option`."""
    short = "{" + ",".join(env.rpartition("/")[2] for env in envs) + "}"
    add_option(parser, "env", type=env_type(envs), metavar=short, **changed)


def add_options(
    parser: argparse.ArgumentParser,
    only: Sequence[str] = tuple(FIELDS),
    without: Sequence[str] = (),
) -> None:
    """The fields of Config as options."""
    for name in (each for each in FIELDS if each in only and each not in without):
        if name == "env":
            add_env(parser)
        else:
            add_option(parser, name)


def add_episode_options(parser: argparse.ArgumentParser) -> None:
    """Options of what drives a single episode: those of EPISODE, and --set."""
    parser.add_argument("--set", help="evaluation set (default: the first one of the environment)")
    add_options(parser, only=EPISODE)


def config_of(given: argparse.Namespace) -> Config:
    """The options of a command line; one set where `given.set` names it."""
    values = {name: getattr(given, name) for name in FIELDS if name in given}
    if "set" in given:
        env = env_of(given.env, None if given.set is None else (given.set,), "--set")
        values.update(env=env, sets=(given.set or default_sets(env)[0],))
    return Config(**values)


def parsed(arguments: Sequence[str] | None, program: str) -> Config:
    """The configuration of a command line; exits with a message for one that is wrong."""
    parser = Parser(program, DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser)
    config = config_of(parser.parse_args(arguments))
    try:
        env_of(config.env, config.sets)
    except ValueError as error:
        parser.error(str(error))
    return config
