"""A sweep from a file: agents x observation augmentations x uncertainty x seeds, and one table.

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
TOML, or JSON with the same names. All but `output` and `agents` has a default.

All agents of the benchmark on equal terms: five seeds of each family, one after the other.

    python -m agents.sweep                                  # everything; hours
    python -m agents.sweep --families ppo-blind ppo-student --seeds 0:1
    nice python -m agents.sweep --threads 2 > families.log &

Every family of an environment has the same laws and sensors (`mixture`), the data sheet of its
sensors where it acts on sensors, and the action-rate penalty of 1. PPO has 2 M steps on Torque-v0,
recurrent PPO too, residual agents 0.4 M, since more gained nothing; agents with a replay buffer
have what they can afford in the time, a seventh of that or less. A student comes after its teacher
of the same seed. A finished training is not repeated, an interrupted one goes on: give the same
command again.

The one table at the end of a sweep: every agent, with all its seeds, on every set.

Several trainings, one task each: where they run, what is said, what is lost.

A training that is lost with its process or node begins again from its last checkpoint, which lies
on a disk that all of them see, and makes the agent that it would have made.
"""

import argparse
import csv
import os
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin

from tqdm import tqdm

from agents.options import Options
from baselines.learned.agent_archive import read_recipe
from tracked_env import SPEED_ID, TERRAIN_ID
from tracked_env.benchmark import BenchmarkConfig, Store, check, default_sets, summarise
from tracked_env.benchmark.executors import Executor, Shard, make_executor, parse_shard
from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.policies import by_name, load_policies, open_archive, registered_policies
from tracked_env.benchmark.progress_bar import progress_bar
from tracked_env.benchmark.report import marked, write
from tracked_env.benchmark.runner import pending, run
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.summary import Row, rows_of
from tracked_env.benchmark.text_tables import aligned, markdown_rows
from tracked_env.validation import checked_choice, checked_keys, parsed_json

KEYS = (
    "output", "agents", "augmentations", "uncertainty", "seeds", "sets", "episodes", "compare",
    "options",
)  # fmt: skip
# Controllers that give a score its 0 and its 1: of Torque-v0, and of ids driven by speeds.
ANCHORS = ("nominal", "adaptive", "oracle")
SPEED_ANCHORS = ("uc", "slc-adaptive", "slc-oracle")
# Options that a sweep gives by itself.
_OWN = ("agent", "augmentation", "uncertainty", "seed", "output", "resume", "overwrite", "quiet")


class Sweep(NamedTuple):
    """What to train and how to compare it."""

    output: Path
    trainings: dict[str, list[Options]]  # by name of the agent, one for each seed
    sets: tuple[str, ...] | None
    episodes: int
    compare: tuple[str, ...]


def parse_seeds(given: Any) -> tuple[int, ...]:
    """Seeds from `0:5` (0 to 4), `1,3` or a list of numbers. Raises ValueError."""
    try:
        if isinstance(given, str) and ":" in given:
            first, last = given.split(":")
            seeds = tuple(range(int(first or 0), int(last)))
        elif isinstance(given, str):
            seeds = tuple(int(part) for part in given.split(","))
        else:
            seeds = tuple(seed for seed in given if type(seed) is int)
            seeds = seeds if len(seeds) == len(given) else ()
    except (TypeError, ValueError):
        seeds = ()
    if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds):
        raise ValueError(
            f"seeds = {given!r:.60}; must be FIRST:END without the end, as 0:5, or different "
            "numbers >= 0, as 1,3"
        )
    return seeds


def read_sweep(path: Path, kind: type[Options]) -> Sweep:
    """A sweep from a file; kind: the options of train.py. Raises ValueError."""
    try:
        text = path.read_text(encoding="utf-8")
        given = parsed_json(text) if path.suffix == ".json" else tomllib.loads(text)
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(f"sweep file {path}: {error}") from error
    try:
        return _sweep(given, kind)
    except (TypeError, ValueError) as error:
        raise ValueError(f"sweep file {path}: {error}") from error


def _sweep(given: Any, kind: type[Options]) -> Sweep:
    known = checked_keys("sweep", given, KEYS)
    for name in ("output", "agents"):
        if name not in known:
            raise ValueError(f"{name} is missing; must be there, as in agents = ['ppo']")
    output = known["output"]
    if not isinstance(output, str) or not output.strip():
        raise ValueError(f"output = {output!r}; must name a folder")
    common = _changed("options", kind(), known.get("options"), _OWN)
    seeds = parse_seeds(known.get("seeds", [0]))
    uncertainty = _listed(known, "uncertainty", [None])
    trainings: dict[str, list[Options]] = {}
    augmentations = _listed(known, "augmentations", ["blind"])
    for agent, augmentation, laws in product(
        _listed(known, "agents", ()), augmentations, uncertainty
    ):
        laws = laws if laws is None or isinstance(laws, list) else [laws]
        own = {"agent": agent, "augmentation": augmentation, "uncertainty": laws}
        name = "-".join([agent, augmentation, *(laws or () if len(uncertainty) > 1 else ())])
        chosen = _changed("sweep", common, own)
        trainings[name] = [
            replace(chosen, seed=seed, output=Path(output, f"{name}-seed{seed}")) for seed in seeds
        ]
    episodes = known.get("episodes", 32)
    if type(episodes) is not int or episodes < 1:
        raise ValueError(f"episodes = {episodes!r}; must be a whole number of at least 1")
    sets = tuple(_listed(known, "sets", ())) or None
    usual = SPEED_ANCHORS if common.env in (SPEED_ID, TERRAIN_ID) else ANCHORS
    return Sweep(Path(output), trainings, sets, episodes, tuple(_listed(known, "compare", usual)))


def _listed(known: Mapping[str, Any], name: str, default: Sequence[Any]) -> list[Any]:
    """A list without repetitions."""
    value = known.get(name, default)
    if isinstance(value, str) or not isinstance(value, (list, tuple)):
        raise ValueError(f"{name} = {value!r:.60}; must be a list")
    if any(entry in value[:i] for i, entry in enumerate(value)):
        raise ValueError(f"{name} = {value!r:.60}; must name each entry once")
    return list(value)


def _changed(what: str, options: Any, given: Any, without: Sequence[str] = ()) -> Any:
    """Options, or the settings of an algorithm, with other values. Raises ValueError."""
    kinds = {each.name: each.type for each in fields(options) if each.name not in without}
    changes: dict[str, Any] = {}
    for name, value in checked_keys(what, given, kinds).items():
        before = getattr(options, name)
        if is_dataclass(before):
            value = _changed(name, before, value)
        elif isinstance(value, list):
            value = tuple(value)
        elif name == "teacher" and isinstance(value, str):
            value = Path(value)
        elif get_origin(kinds[name]) is Literal:
            checked_choice(name, value, get_args(kinds[name]))
        elif isinstance(before, float) and type(value) is int:
            value = float(value)
        elif before is not None and type(value) is not type(before):
            raise ValueError(f"{name} = {value!r:.60}; must be a {type(before).__name__}")
        changes[name] = value
    return replace(options, **changes)


ROOT = Path(__file__).resolve().parent.parent
TERMS = "--uncertainty mixture --sensors mixture"
SHOWN = f"{TERMS} --data-sheet"
PPO = "--steps 2000000"
RESIDUAL = "--steps 400000 --augmentation residual --ppo.log-std-init -2"  # more did not help
REPLAY = "--smoothness 1"  # which agents with a replay buffer would leave out
STUDENT = (
    "--augmentation student --student.lstm-hidden 64 --student.hidden 64 --student.n-steps 250 "
    "--student.batch-size 16000 --student.buffer-size 400000 --student.gradient-steps 24 "
    "--vehicles 60 --steps 1600000"
)
# By family: whose agent of the same seed teaches it.
TEACHERS = {"ppo-student": "ppo-teacher", "ppo-student-estimates": "ppo-teacher"}

# By environment, name of the family -> its options of train.py.
FAMILIES = {
    "Torque-v0": {
        "ppo-blind": f"{SHOWN} {PPO}",
        "ppo-history": f"{SHOWN} {PPO} --augmentation history",
        "ppo-reckoned": f"{SHOWN} {PPO} --augmentation reckoned",
        "ppo-estimates": f"{SHOWN} {PPO} --augmentation estimates",
        "ppo-residual": f"{SHOWN} {RESIDUAL} --residual-scale 0.05",
        "ppo-residual-mpc": f"{SHOWN} {RESIDUAL} --residual-scale 0.05 --base mpc-adaptive",
        "ppo-teacher": f"--uncertainty mixture --sensors ideal {PPO} --augmentation teacher",
        "ppo-student": f"{SHOWN} {STUDENT}",
        "ppo-student-estimates": f"{SHOWN} {STUDENT} --student.features estimates",
        "recurrent-ppo-blind": f"{SHOWN} {PPO} --agent recurrent-ppo --recurrent-ppo.n-steps 512",
        "sac-blind": f"{SHOWN} --agent sac --steps 300000 {REPLAY}",
        "td3-blind": f"{SHOWN} --agent td3 --steps 300000 {REPLAY}",
        "tqc-blind": f"{SHOWN} --agent tqc --steps 150000 {REPLAY}",
    },
    "Speed-v0": {
        "ppo-blind": f"{SHOWN} --steps 1500000",
        "ppo-reckoned": f"{SHOWN} --steps 1500000 --augmentation reckoned",
        "ppo-residual": f"{SHOWN} {RESIDUAL} --residual-scale 0.1",
    },
    "Terrain-v0": {
        "ppo-blind": f"{SHOWN} --steps 1500000",
        "ppo-reckoned": f"{SHOWN} --steps 1500000 --augmentation reckoned",
        "ppo-residual": f"{SHOWN} --steps 300000 --evaluate-every 100000 --augmentation residual "
        "--ppo.log-std-init -2 --residual-scale 0.1",
    },
}


def command(env: str, family: str, seed: int, output: Path) -> list[str]:
    """Arguments of train.py for one training, which goes on where it was."""
    more = []
    if family in TEACHERS:
        more = ["--teacher", str(output / env / f"{TEACHERS[family]}-seed{seed}" / "agent.zip")]
    folder = str(output / env / f"{family}-seed{seed}")
    return [
        "--env", f"tracked_env/{env}", *shlex.split(FAMILIES[env][family]), *more,
        "--seed", str(seed), "--output", folder, "--resume", "--quiet",
    ]  # fmt: skip


def cpu_minutes(folder: Path) -> tuple[float, float]:
    """Processor time of a finished training [min], and its best error on held-out episodes [m]."""
    with (folder / "curve.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    errors = [float(row["held_out_rmse"]) for row in rows if row["held_out_rmse"] != "nan"]
    return float(rows[-1]["cpu_seconds"]) / 60.0, min(errors, default=float("nan"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Train all that is asked for; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--families", nargs="+", help="names, of every environment; default: all")
    parser.add_argument("--envs", nargs="+", default=[*FAMILIES], choices=[*FAMILIES])
    parser.add_argument("--seeds", default="0:5", help="FIRST:END without the end, or 1,3")
    parser.add_argument("--output", type=Path, default=Path("runs", "families"))
    parser.add_argument("--threads", type=int, default=1, help="of PyTorch")
    given = parser.parse_args(arguments)
    known = {name for families in FAMILIES.values() for name in families}
    wrong = sorted(set(given.families or ()) - known)
    if wrong:
        parser.error(f"unknown family {wrong[0]!r}; known are {', '.join(sorted(known))}")
    try:
        seeds = parse_seeds(given.seeds)
    except ValueError as error:
        parser.error(str(error))
    failures = 0
    for seed in seeds:
        for env in given.envs:
            for family in FAMILIES[env]:
                if given.families and family not in given.families:
                    continue
                words = command(env, family, seed, given.output)
                words += ["--threads", str(given.threads)]
                ended = subprocess.run([sys.executable, "train.py", *words], cwd=ROOT, check=False)
                if ended.returncode:
                    failures += 1
                    print(f"{env} {family} seed {seed}: failed", flush=True)
                    continue
                minutes, best = cpu_minutes(ROOT / given.output / env / f"{family}-seed{seed}")
                print(
                    f"{env} {family} seed {seed}: {minutes:.1f} min of processor time, best "
                    f"{best:.4f} m held out",
                    flush=True,
                )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())


TABLE = "table.md"


def archives_of(sweep: Sweep) -> dict[str, list[Path]]:
    """The trained agents of a sweep, those that are there."""
    paths = {
        name: [options.folder / "agent.zip" for options in trainings]
        for name, trainings in sweep.trainings.items()
    }
    found = {name: [path for path in of if path.exists()] for name, of in paths.items()}
    return {name: of for name, of in found.items() if of}


def compared(sweep: Sweep, executor: Executor | None) -> str:
    """Evaluate the agents of a sweep; returns the table, which lies in OUTPUT/table.md, too.

    Raises ValueError and PolicyError.
    """
    first = next(iter(sweep.trainings.values()))[0]
    config = BenchmarkConfig(
        sets=sweep.sets or default_sets(first.env), episodes=sweep.episodes, lateral=first.lateral
    )
    registry, shipped = by_name(registered_policies(), config.env)
    trained = archives_of(sweep)
    agents = {**shipped, **trained}
    entries = load_policies([*sweep.compare, *trained], registry, agents, open_archive)
    store = Store(sweep.output / "evaluation", config.identity())
    workers = 1 if executor is None else executor.workers
    tasks = list(pending(config, entries, store, workers))
    total = sum(len(task.episodes) * config.max_steps(task.uncertainty_set) for task in tasks)
    with progress_bar(total) as progress:
        records = run(config, entries, store, progress, executor)
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


def table(rows: dict[str, Row], trained: dict[str, list[Path]]) -> list[list[str]]:
    """Rows of cells, the header first: agents, and the IQM of the RMSE on each set and on all."""
    cells = [["agent", "seeds", "steps", "held out", *rows]]
    last = list(rows.values())[-1]
    for name in last.seeds:
        recipes: list[dict[str, Any]] = [read_recipe(path) or {} for path in trained.get(name, ())]
        best = [recipe["held_out_rmse"] for recipe in recipes if recipe.get("held_out_rmse")]
        steps = max((recipe["config"]["steps"] for recipe in recipes), default=0)
        cells.append(
            [marked(name, len(recipes)), f"{len(recipes) or '-'}", f"{steps:,}" if steps else "-",
             f"{sum(best) / len(best):.3f}" if best else "-",
             *(_between(row.summary(name).rmse_iqm) for row in rows.values())]
        )  # fmt: skip
    return cells


def _between(estimate: Estimate) -> str:
    return f"{estimate.value:.3f} [{estimate.low:.3f}, {estimate.high:.3f}]"


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
