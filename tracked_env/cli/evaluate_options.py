"""Options of `tracked-env evaluate` and evaluate.py, and a configuration from them."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.executors.shard import Shard, parse_shard

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
SHORT = "{" + ",".join(env.rpartition("/")[2] for env in ENVIRONMENTS) + "}"  # as helps show them
PAPERS = ("none", "strawa2021", "focchi2025")


def short_env(text: str) -> str:
    """An environment id, with or without the name space `tracked_env/`."""
    return text if "/" in text else f"tracked_env/{text}"


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas, empty ones left out; a file whose name has a comma is one."""
    given = text.rpartition("=")[2]
    parts = (text,) if Path(given).exists() else text.split(",")
    return tuple(part for part in parts if part)


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

    env: str = option(
        TORQUE_ID, "environment id, with or without `tracked_env/`: sprocket torques as actions, "
        "or speeds, on level ground or on slopes", type=short_env, choices=ENVIRONMENTS,
        metavar=SHORT,
    )  # fmt: skip
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
        nargs="+", type=names, metavar="POLICY",
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
        nargs="+", type=names, metavar="SET",
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


def add_options(parser: argparse.ArgumentParser, without: Sequence[str] = ()) -> None:
    """The fields of Config as options."""
    for each in fields(Config):
        if each.name in without:
            continue
        more = {key: value for key, value in each.metadata.items() if key != "help"}
        is_shown = each.default is not None and not isinstance(each.default, bool)
        text = each.metadata["help"] + (f" (default: {each.default})" if is_shown else "")
        parser.add_argument(
            f"--{each.name.replace('_', '-')}", default=each.default, help=text, **more
        )


def config_of(given: argparse.Namespace) -> Config:
    """The options of a command line; lists of lists, as `names` makes them, are joined."""
    values = {each.name: getattr(given, each.name) for each in fields(Config) if each.name in given}
    for name in ("policies", "sets"):
        if values.get(name):
            values[name] = tuple(dict.fromkeys(one for part in values[name] for one in part))
    return Config(**values)


def parsed(arguments: Sequence[str] | None, program: str) -> Config:
    """The configuration of a command line; exits with a message for one that is wrong."""
    parser = argparse.ArgumentParser(
        prog=program,
        allow_abbrev=False,
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser)
    return config_of(parser.parse_args(arguments))
