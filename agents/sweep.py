"""Several trainings: seeds, or a sweep from a file, one task each, and one evaluation at the end.

What a file of a sweep says (TOML, or JSON with the same names) is in docs/scale.md; all but
`output` and `agents` has a default. A training that is lost with its process or node begins again
from its last checkpoint, which lies on a disk that all of them see, and makes the agent that it
would have made.

And all agents of the benchmark on equal terms, five seeds of each family, one after the other:

    python -m agents.sweep                                  # everything; hours
    python -m agents.sweep --families ppo-blind ppo-estimates --seeds 0:1
    nice python -m agents.sweep --threads 2 > families.log &

Every family of an environment has the same laws and sensors (`mixture`), the data sheet of its
sensors where it acts on sensors, and the action-rate penalty of 1. A finished training is not
repeated, an interrupted one goes on: give the same command again.
"""

import argparse
import glob
import os
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from agents.options import Options, Several, changed_options, parse, words_of
from tracked_env import TORQUE_ID
from tracked_env.benchmark.executors import Executor
from tracked_env.cli.command_line import as_argument
from tracked_env.environment_ids import find_id, published_id
from tracked_env.validation import checked_keys, parsed_json

KEYS = (
    "output", "agents", "augmentations", "uncertainty", "seeds", "sets", "episodes", "compare",
    "options",
)  # fmt: skip
# Controllers that give a score its 0 and its 1: of ids driven by speeds, and of others.
SPEED_ANCHORS, ANCHORS = ("uc", "slc-adaptive", "slc-oracle"), ("nominal", "adaptive", "oracle")
# Options that a sweep gives by itself.
_OWN = ("agent", "augmentation", "uncertainty", "seed", "output", "resume", "overwrite", "quiet")


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
    by_torque = not env or published_id(find_id(env, "--env")) == TORQUE_ID
    usual = ANCHORS if by_torque else SPEED_ANCHORS
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


def planned(options: Options, several: Several) -> tuple[dict[str, Options], Sweep | None]:
    """Trainings by name, and the sweep that they are of. Raises ValueError."""
    kind = type(options)
    if several.sweep is not None:
        changed = changed_options(options)
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


def compare_agents(sweep: Sweep, several: Several, quiet: bool = False) -> int:
    """Evaluate the agents of a sweep, each with all its seeds; returns the exit status.

    It is `tracked-env evaluate` with OUTPUT/evaluation.
    """
    from tracked_env.cli.evaluate_command import compare
    from tracked_env.cli.evaluate_options import Config

    first = next(iter(sweep.trainings.values()))[0]
    folder = glob.escape(str(sweep.output))
    agents = [
        f"{name}={folder}/{glob.escape(name)}-seed*/agent.zip"
        for name, of in sweep.trainings.items()
        if any((one.folder / "agent.zip").exists() for one in of)
    ]
    config = Config(
        env=first.env, policies=(*sweep.compare, *agents), sets=sweep.sets, quiet=quiet,
        episodes=sweep.episodes, lateral=first.lateral, output=sweep.output / "evaluation",
        figures=False, workers=several.workers, ray=several.ray, vehicle=first.vehicle,
        env_args=first.env_args,
    )  # fmt: skip
    return compare(config, "train.py")


# --- the families of agents ------------------------------------------------------------------
ROOT = Path(__file__).resolve().parent.parent
TERMS = "--uncertainty mixture --sensors mixture"
SHOWN = f"{TERMS} --data-sheet"
# A reward that has half its worth at 1.5 cm, of vehicles of 2 m and 0.6 m; ways forward, fast and
# backward.
WAYS = "--reference mixture --steps 3000000"
ESTIMATES = f"{SHOWN} --precision 0.0075 {WAYS} --augmentation estimates"
RECKONED = f"{SHOWN} --precision 0.025 {WAYS} --augmentation reckoned"
BLIND = f"{SHOWN} --steps 2000000"
# By environment, name of the family -> its options of train.py.
FAMILIES = {
    "Torque-v0": {"ppo-blind": BLIND, "ppo-estimates": ESTIMATES},
    "Speed-v0": {"ppo-reckoned": RECKONED},
    "Terrain-v0": {"ppo-reckoned": RECKONED},
}


def command(env: str, family: str, seed: int, output: Path) -> list[str]:
    """Arguments of train.py for one training, which goes on where it was."""
    words = ["--env", f"tracked_env/{env}", *shlex.split(FAMILIES[env][family])]
    folder = str(output / env / f"{family}-seed{seed}")
    return [*words, "--seed", str(seed), "--output", folder, "--resume", "--quiet"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Train all that is asked for; returns the exit status."""
    names = sorted({name for families in FAMILIES.values() for name in families})
    parser = argparse.ArgumentParser(description="Train all families of agents.")
    parser.add_argument("--families", nargs="+", choices=names, help="of every environment")
    parser.add_argument("--envs", nargs="+", default=[*FAMILIES], choices=[*FAMILIES])
    seeds = as_argument(parse_seeds)
    parser.add_argument("--seeds", type=seeds, default="0:5", help="FIRST:END, or 1,3")
    parser.add_argument("--output", type=Path, default=Path("runs", "families"))
    parser.add_argument("--threads", default="1", help="of PyTorch")
    options = parser.parse_args(arguments)
    failures = 0
    for seed, env in product(options.seeds, options.envs):
        for family in (name for name in FAMILIES[env] if name in (options.families or names)):
            words = [*command(env, family, seed, options.output), "--threads", options.threads]
            ended = subprocess.run([sys.executable, "train.py", *words], cwd=ROOT, check=False)
            failures += ended.returncode != 0
            end = "failed" if ended.returncode else "done"
            print(f"{env} {family} seed {seed}: {end}", flush=True)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
