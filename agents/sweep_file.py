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
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin

from agents.training.options import Options
from tracked_env import SPEED_ID, TERRAIN_ID
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
