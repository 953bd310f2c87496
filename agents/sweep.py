"""Several trainings: seeds, or a sweep from a file, one task each, and one table at the end.

    output = "runs/history"                 # folder of everything; resume = the same command again
    agents = ["ppo", "sac"]                 # algorithms
    augmentations = ["blind", "history"]    # as --augmentation of train.py
    uncertainty = ["payload", ["drift", "mixed"]]  # trained on: one set, or several together
    seeds = "0:5"                           # 0 to 4; or a list
    sets = ["payload", "ood"]               # evaluated on; default: all of the environment
    episodes = 100                          # of each set
    compare = ["nominal", "adaptive", "oracle"]  # beside the agents; default: by environment
    [options]                               # of train.py, for all trainings
    steps = 200000
    ppo.n_steps = 256
TOML, or JSON with the same names. All but `output` and `agents` has a default. A training that is
lost with its process or node begins again from its last checkpoint, which lies on a disk that all
of them see, and makes the agent that it would have made.
"""

import os
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from agents.options import Options, Several, parse, words_of
from baselines.learned.trained_agent import read_recipe
from tracked_env import SPEED_ID, TERRAIN_ID
from tracked_env.benchmark.executors import Executor, Shard, make_executor, parse_shard
from tracked_env.benchmark.files import write_atomically
from tracked_env.validation import checked_keys, parsed_json

KEYS = (
    "output", "agents", "augmentations", "uncertainty", "seeds", "sets", "episodes", "compare",
    "options",
)  # fmt: skip
# Controllers that give a score its 0 and its 1: of ids driven by speeds, and of others.
SPEED_ANCHORS, ANCHORS = ("uc", "slc-adaptive", "slc-oracle"), ("nominal", "adaptive", "oracle")
# Options that a sweep gives by itself.
_OWN = ("agent", "augmentation", "uncertainty", "seed", "output", "resume", "overwrite", "quiet")
TABLE = "table.md"


class Sweep(NamedTuple):
    """What to train and how to compare it."""

    output: Path
    trainings: dict[str, list[Options]]  # by name of the agent, one for each seed
    sets: tuple[str, ...] | None
    episodes: int
    compare: tuple[str, ...]


def parse_seeds(text: Any) -> tuple[int, ...]:
    """Seeds from `0:5` (0 to 4), `1,3` or a list of numbers. Raises ValueError."""
    try:
        if isinstance(text, str) and ":" in text:
            first, last = text.split(":")
            seeds = tuple(range(int(first or 0), int(last)))
        elif isinstance(text, str):
            seeds = tuple(int(part) for part in text.split(","))
        else:
            seeds = tuple(text) if all(type(seed) is int for seed in text) else ()
    except (TypeError, ValueError):
        seeds = ()
    if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds):
        raise ValueError(
            f"seeds = {text!r:.60}; must be FIRST:END without the end, as 0:5, or different "
            "numbers >= 0, as 1,3"
        )
    return seeds


def read_sweep(path: Path, kind: type[Options]) -> Sweep:
    """A sweep from a file; kind: the options of train.py. Raises ValueError."""
    try:
        text = path.read_text(encoding="utf-8")
        content = parsed_json(text) if path.suffix == ".json" else tomllib.loads(text)
        return _sweep(content, kind)
    except (OSError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"sweep file {path}: {error}") from error


def _sweep(content: Any, kind: type[Options]) -> Sweep:
    keys = checked_keys("sweep", content, KEYS)
    for name in ("output", "agents"):
        if name not in keys:
            raise ValueError(f"{name} is missing; must be there, as in agents = ['ppo']")
    output, episodes = keys["output"], keys.get("episodes", 32)
    if not isinstance(output, str) or not output.strip():
        raise ValueError(f"output = {output!r}; must name a folder")
    if type(episodes) is not int or episodes < 1:
        raise ValueError(f"episodes = {episodes!r}; must be a whole number of at least 1")
    options = checked_keys(
        "options", keys.get("options"), [one.name for one in fields(kind) if one.name not in _OWN]
    )
    seeds = parse_seeds(keys.get("seeds", [0]))
    uncertainty = _entries(keys, "uncertainty", [None])
    agents, augmentations = _entries(keys, "agents", ()), _entries(keys, "augmentations", ["blind"])
    trainings: dict[str, list[Options]] = {}
    for agent, augmentation, laws in product(agents, augmentations, uncertainty):
        laws = [laws] if isinstance(laws, str) else laws or []
        # Settings of another algorithm of the sweep are not for this one.
        others = {other.replace("-", "_") for other in agents if other != agent}
        words = words_of({key: value for key, value in options.items() if key not in others})
        own = [f"--agent={agent}", f"--augmentation={augmentation}"]
        chosen, _ = parse([*words, *own, *(["--uncertainty", *laws] if laws else [])], kind)
        name = "-".join([agent, augmentation, *(laws if len(uncertainty) > 1 else ())])
        trainings[name] = [
            replace(chosen, seed=seed, output=Path(output, f"{name}-seed{seed}")) for seed in seeds
        ]
    env = next((of[0].env for of in trainings.values()), "")
    sets = tuple(_entries(keys, "sets", ())) or None
    usual = SPEED_ANCHORS if env in (SPEED_ID, TERRAIN_ID) else ANCHORS
    return Sweep(Path(output), trainings, sets, episodes, tuple(_entries(keys, "compare", usual)))


def _entries(keys: Mapping[str, Any], name: str, default: Sequence[Any]) -> list[Any]:
    """A list without repetitions."""
    value = keys.get(name, default)
    if isinstance(value, str) or not isinstance(value, (list, tuple)):
        raise ValueError(f"{name} = {value!r:.60}; must be a list")
    if any(entry in value[:i] for i, entry in enumerate(value)):
        raise ValueError(f"{name} = {value!r:.60}; must name each entry once")
    return list(value)


# Where they run


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


class Ended(NamedTuple):
    """How a training ended."""

    line: str  # what to say
    failed: bool


def check_whole(several: Several) -> None:
    """Raises ValueError for half of what several trainings need, or for too much."""
    names = [each.name for each in fields(several) if getattr(several, each.name) is not None]
    if names and not {"seeds", "sweep"} & set(names):
        raise ValueError(f"--{names[0]} is of several trainings; give --seeds or --sweep too")
    if {"seeds", "sweep"} <= set(names):
        raise ValueError("--seeds and --sweep are given; the seeds of a sweep are in its file")


def planned(options: Options, several: Several) -> tuple[dict[str, Options], Sweep | None]:
    """Trainings by name, and the sweep that they are of. Raises ValueError."""
    kind = type(options)
    if several.sweep is not None:
        usual, names = kind(), [each.name for each in fields(kind)]
        changed = [name for name in names if getattr(options, name) != getattr(usual, name)]
        if changed:
            raise ValueError(f"--{changed[0]} beside --sweep; write it into {several.sweep}")
        sweep = read_sweep(several.sweep, kind)
        every = [each for of in sweep.trainings.values() for each in of]
        return {f"{each.folder}": replace(each, resume=True) for each in every}, sweep
    trainings = {}
    for seed in parse_seeds(several.seeds):
        each = replace(options, seed=seed, output=None)
        if options.output is not None:
            each = replace(each, output=options.output / each.folder.name)
        trainings[f"{each.folder}"] = each
    return trainings, None


def executor_of(several: Several) -> tuple[Executor, Shard | None]:
    """Where the trainings run, and the part of them that does. Raises ValueError."""
    shard = None if several.shard is None else parse_shard(several.shard)
    executor = make_executor(several.workers, several.ray, shard)
    return executor or make_executor(workers=1), shard  # type: ignore[return-value]


def train_all(
    trainings: Mapping[str, Options],
    executor: Executor,
    train_one: Callable[[Place, Job], Ended],
    quiet: bool = False,
) -> int:
    """Train; returns how many have failed.

    train_one: of an importable module. Raises OSError for a training that is lost again and again.
    """
    place = Place(list(sys.argv), os.getcwd())
    again = {"resume": True, "overwrite": False, "quiet": True}  # each may begin more than once
    jobs = [Job(name, {**vars(options), **again}) for name, options in trainings.items()]
    failures = 0
    with (
        tqdm(total=len(jobs), unit=" trainings", disable=quiet, dynamic_ncols=True) as bar,
        closing(executor.results(train_one, place, jobs)) as results,
    ):
        for number, ended in results:
            failures += ended.failed
            bar.update(1)
            text = f"{jobs[number].name}: {ended.line}"
            bar.write(text, file=sys.stderr if ended.failed else sys.stdout)
    return failures


# The table at the end of a sweep: every agent, with all its seeds, on every set


def compared(sweep: Sweep, executor: Executor | None) -> str:
    """Evaluate the agents of a sweep; returns the table, which lies in OUTPUT/table.md, too.

    Raises ValueError and PolicyError.
    """
    from tracked_env.benchmark import BenchmarkConfig, Store, check, default_sets, summarise
    from tracked_env.benchmark.policies import (
        by_name,
        load_policies,
        open_archive,
        registered_policies,
    )
    from tracked_env.benchmark.report import write
    from tracked_env.benchmark.runner import run_with_bar
    from tracked_env.benchmark.summary import rows_of
    from tracked_env.benchmark.table_model import aligned, markdown_rows

    first = next(iter(sweep.trainings.values()))[0]
    config = BenchmarkConfig(
        sets=sweep.sets or default_sets(first.env), episodes=sweep.episodes, lateral=first.lateral
    )
    paths = {
        name: [path for one in of if (path := one.folder / "agent.zip").exists()]
        for name, of in sweep.trainings.items()
    }
    trained = {name: of for name, of in paths.items() if of}
    known = {**by_name(registered_policies(), config.env), **trained}
    entries = load_policies([*sweep.compare, *trained], known, open_archive)
    store = Store(sweep.output / "evaluation", config.identity())
    records = run_with_bar(config, entries, store, executor)
    rows = rows_of(records)
    summary = summarise(records, rows)
    write(store.folder, {**store.header, "benchmark": check(config)._asdict()}, records, summary)
    cells = table(rows, trained)
    note = (
        "IQM of the tracking RMSE [m] with 95 % intervals over seeds and episodes; held out: mean "
        "of the best\nRMSE [m] of each training on its held-out episodes. * fewer than 5 seeds"
    )
    text = f"{markdown_rows(cells, 1)}\n\n{note}\n\n{check(config).message}\n"
    write_atomically(sweep.output / TABLE, text.encode())
    return f"{aligned(cells, 1)}\n\n{note}"


def table(rows: Mapping[str, Any], trained: Mapping[str, list[Path]]) -> list[list[str]]:
    """Rows of cells, the header first: agents, and the IQM of the RMSE on each set and on all."""
    from tracked_env.benchmark.report import marked

    cells = [["agent", "seeds", "steps", "held out", *rows]]
    for name in list(rows.values())[-1].seeds:
        recipes: list[dict[str, Any]] = [read_recipe(path) or {} for path in trained.get(name, ())]
        best = [recipe["held_out_rmse"] for recipe in recipes if recipe.get("held_out_rmse")]
        steps = max((recipe["config"]["steps"] for recipe in recipes), default=0)
        scores = [row.summary(name).rmse_iqm for row in rows.values()]
        cells.append([
            marked(name, len(recipes)), f"{len(recipes) or '-'}", f"{steps:,}" if steps else "-",
            f"{sum(best) / len(best):.3f}" if best else "-",
            *(f"{score.value:.3f} [{score.low:.3f}, {score.high:.3f}]" for score in scores),
        ])  # fmt: skip
    return cells
