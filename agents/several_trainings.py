"""Several trainings, one task each: where they run, what is said, what is lost.

A training that is lost with its process or node begins again from its last checkpoint, which lies
on a disk that all of them see, and makes the agent that it would have made.
"""

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from agents.sweep_file import Sweep, parse_seeds, read_sweep
from agents.training.options import Options
from tracked_env.benchmark.executors import Executor, make_executor
from tracked_env.benchmark.executors.shard import Shard, parse_shard


@dataclass(frozen=True)
class Several:
    """Several trainings, and where they run."""

    seeds: str | None = None
    """Train one agent for each of these seeds: FIRST:END without the end, as 0:5, or 1,3.
    OUTPUT is then the folder of their folders."""

    sweep: Path | None = None
    """Train what a file (TOML or JSON) says: agents x augmentations x uncertainty x seeds, then
    compare them in one table. The same command goes on where it was. All other options but
    WORKERS, SHARD and RAY are in the file."""

    workers: int | None = None
    """Of SEEDS and SWEEP: trainings at the same time, in processes of this machine.
    Default: 1."""

    shard: str | None = None
    """Of SEEDS and SWEEP: train part I of N alone, as I/N, for arrays of SLURM."""

    ray: str | None = None
    """Of SEEDS and SWEEP: a Ray cluster (extra `cluster`) that trains, one processor each:
    local, auto or HOST:PORT."""


class Place(NamedTuple):
    """What all trainings share: the command that the user gave, and where."""

    command: list[str]
    folder: str


class Job(NamedTuple):
    """One training."""

    name: str
    options: Mapping[str, Any]

    def __str__(self) -> str:
        return f"training {self.name}"


class Trained(NamedTuple):
    """How a training ended."""

    line: str  # what to say
    failed: bool


def asked(options: Options) -> bool:
    """Whether a command line asks for several trainings. Raises ValueError for half of it."""
    several = [each.name for each in fields(Several) if getattr(options, each.name) is not None]
    if several and not {"seeds", "sweep"} & set(several):
        raise ValueError(f"--{several[0]} is of several trainings; give --seeds or --sweep too")
    if {"seeds", "sweep"} <= set(several):
        raise ValueError("--seeds and --sweep are given; the seeds of a sweep are in its file")
    return bool(several)


def one(options: Options, kind: type[Options], **changes: Any) -> Options:
    """The options of one training, without those of `Several`."""
    return kind(**{each.name: getattr(options, each.name) for each in fields(kind)} | changes)


def planned(options: Any, kind: type[Options]) -> tuple[dict[str, Options], Sweep | None]:
    """Trainings by name, and the sweep that they are of. Raises ValueError."""
    if options.sweep is not None:
        given = one(options, kind)
        usual, names = kind(), [each.name for each in fields(kind)]
        changed = [name for name in names if getattr(given, name) != getattr(usual, name)]
        if changed:
            raise ValueError(f"--{changed[0]} beside --sweep; write it into {options.sweep}")
        sweep = read_sweep(options.sweep, kind)
        all_of_it = [each for of in sweep.trainings.values() for each in of]
        return {f"{each.folder}": replace(each, resume=True) for each in all_of_it}, sweep
    trainings = {}
    for seed in parse_seeds(options.seeds):
        each = one(options, kind, seed=seed, output=None)
        if options.output is not None:
            each = replace(each, output=options.output / each.folder.name)
        trainings[f"{each.folder}"] = each
    return trainings, None


def executor_of(options: Any) -> tuple[Executor, Shard | None]:
    """Where the trainings run, and the part of them that does. Raises ValueError."""
    shard = None if options.shard is None else parse_shard(options.shard)
    executor = make_executor(options.workers, options.ray, shard)
    return executor or make_executor(workers=1), shard  # type: ignore[return-value]


def train_all(
    trainings: Mapping[str, Options],
    executor: Executor,
    train_one: Callable[[Place, Job], Trained],
    quiet: bool = False,
) -> int:
    """Train; returns how many have failed.

    train_one: of an importable module. Raises OSError for a training that is lost again and again.
    """
    place = Place(list(sys.argv), os.getcwd())
    jobs = [Job(name, _values(options)) for name, options in trainings.items()]
    failures = 0
    with (
        tqdm(total=len(jobs), unit=" trainings", disable=quiet, dynamic_ncols=True) as bar,
        closing(executor.results(train_one, place, jobs)) as results,
    ):
        for number, trained in results:
            failures += trained.failed
            bar.update(1)
            text = f"{jobs[number].name}: {trained.line}"
            bar.write(text, file=sys.stderr if trained.failed else sys.stdout)
    return failures


def _values(options: Options) -> dict[str, Any]:
    """Options for a training that may begin more than once."""
    values = {each.name: getattr(options, each.name) for each in fields(options)}
    return {**values, "resume": True, "overwrite": False, "quiet": True}


def part_of(trainings: Mapping[str, Options], shard: Shard | None) -> dict[str, Options]:
    """The trainings of a shard."""
    items: Sequence[tuple[str, Options]] = list(trainings.items())
    return dict(items if shard is None else shard.of(items))
