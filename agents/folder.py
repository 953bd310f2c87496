"""The folder of one training, and whether a training may begin or go on there.

config.json                     the recipe; `"finished": true` when the training has ended
agent.zip, last.zip, curve.csv  of the training that config.json describes
checkpoint*.zip                 of `agents.checkpoints`, until it has ended
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agents import checkpoints
from tracked_env.benchmark.store import write_atomically

CONFIG = "config.json"
PRODUCTS = ("agent.zip", "last.zip", "curve.csv")


class AlreadyFinished(Exception):
    """The training that is asked for has ended; its text says where the agent is."""


def _recorded(folder: Path) -> dict[str, Any]:
    """What config.json holds, nothing where there is none or it is damaged."""
    try:
        recipe = json.loads((folder / CONFIG).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return recipe if isinstance(recipe, dict) else {}


def _compare(then: Mapping[str, Any], now: Mapping[str, Any], free: Sequence[str]) -> None:
    """Raises ValueError for configurations that differ in more than the entries `free`."""
    changed = [name for name in now if name not in free and then.get(name) != now[name]]
    if changed:
        raise ValueError(
            "--resume goes on with the same configuration, but different are "
            + ", ".join(f"{name} (then {then.get(name)}, now {now[name]})" for name in changed)
            + ". Choose another --output, or give --overwrite instead"
        )


def _check_free(folder: Path, finished: bool) -> None:
    """Raises ValueError where a training that begins would overwrite another one."""
    otherwise = "choose another --output, or give --overwrite to train anew"
    if finished:
        raise ValueError(f"{folder} holds a finished training: {otherwise}")
    if checkpoints.exist(folder):
        raise ValueError(
            f"{folder} holds an unfinished training: add --resume to go on with it, {otherwise}"
        )
    if any((folder / name).exists() for name in PRODUCTS):
        raise ValueError(f"{folder} holds an agent: {otherwise}")


def going_on(
    folder: Path, config: Mapping[str, Any], free: Sequence[str], resume: bool, overwrite: bool
) -> dict[str, Any] | None:
    """The checkpoint that a training with `config` goes on from, None where it begins.

    free: entries of the configuration that may have changed. Raises AlreadyFinished where that
    training has ended, and ValueError where it would overwrite one or is another one.
    """
    if resume and overwrite:
        raise ValueError("--resume goes on and --overwrite trains anew: choose one of them")
    if overwrite:
        return None
    recorded = _recorded(folder)
    finished = recorded.get("finished") is True
    if not resume:
        _check_free(folder, finished)
        return None
    if finished:
        _compare(recorded["config"], config, free)
        checkpoints.remove(folder)  # one may be left of a kill in the last moment
        raise AlreadyFinished(f"already finished: {folder / PRODUCTS[0]}")
    captured, notices = checkpoints.read(folder)
    for notice in notices:
        print(f"{notice}; going on from the one before", file=sys.stderr)
    if captured is None:
        _check_free(folder, finished)  # an agent without a checkpoint, of an older version
    else:
        recorded = captured["recipe"]
    if "config" in recorded:
        _compare(recorded["config"], config, free)
    return captured


def begin(folder: Path, recipe: Mapping[str, Any], done: int) -> None:
    """Write the configuration. What lies there goes, unless the training goes on after `done`."""
    folder.mkdir(parents=True, exist_ok=True)
    if done:
        print(f"going on after {done:,} steps")
    else:
        checkpoints.remove(folder)
        for name in (CONFIG, *PRODUCTS):
            (folder / name).unlink(missing_ok=True)
    write_atomically(folder / CONFIG, json.dumps(recipe, indent=2).encode())


def finish(folder: Path, recipe: Mapping[str, Any]) -> None:
    """Say in the folder that its training has ended, and delete its checkpoints."""
    ended = {**recipe, "finished": True}
    write_atomically(folder / CONFIG, json.dumps(ended, indent=2).encode())
    checkpoints.remove(folder)
