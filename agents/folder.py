"""How train.py and evaluate.py end early: in one line, with the exit status that a shell expects.

    130   interrupted with Ctrl-C
    2     wrong settings, a training that diverged, a folder that cannot be written
It imports nothing that takes time, so that Ctrl-C has an answer while everything else is imported.

The folder of one training, and whether a training may begin or go on there.

config.json                     the recipe; `"finished": true` when the training has ended
agent.zip, last.zip, curve.csv  of the training that config.json describes
checkpoint*.zip                 of `agents.checkpoint`, until it has ended
A file of one of these names that no training has written is never replaced or deleted: training
there is refused. Each is recognised by its content, a checkpoint also by an unfinished training
beside it, since a damaged one must give way.
"""

import json
import os
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from agents import checkpoint
from baselines.learned.agent_archive import current, read_recipe
from tracked_env.benchmark.store import write_atomically

INTERRUPTED = 130
REFUSED = 2


class Refused(Exception):
    """What is asked for cannot be trained; nothing has been written."""


def stop_at_once(line: str) -> None:
    """From now on Ctrl-C prints `line` and ends the process without unwinding.

    An exception in the middle of an import or a compilation would be lost or replaced. What is to
    be kept must be whole on the disk at any time. A process in the background, for which the shell
    has switched Ctrl-C off, stays as it is.
    """

    def stop(*_: object) -> None:
        with suppress(Exception):
            sys.stdout.flush()
        os.write(2, f"{line}\n".encode())
        os._exit(INTERRUPTED)

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop)


def raise_again() -> None:
    """Undo `stop_at_once`: Ctrl-C raises KeyboardInterrupt."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def refusing(*errors: type[Exception]) -> Iterator[None]:
    """Turn the errors of wrong settings into Refused."""
    try:
        yield
    except errors as error:
        raise Refused(error) from error
    except MemoryError as error:
        raise Refused(f"{error}. Lower vehicles, n_steps or the sizes of buffers") from error


def failed(text: object) -> int:
    """Say in one line what is wrong; returns the exit status."""
    print("train.py:", " ".join(str(text).split()), file=sys.stderr)
    return REFUSED


def interrupted(folder: object, resumable: bool) -> int:
    """Say in one line how to go on; returns the exit status."""
    way = "go on with --resume" if resumable else "no checkpoint yet, begin anew with --overwrite"
    print(f"interrupted; {way} --output {folder}", file=sys.stderr)
    return INTERRUPTED


CONFIG = "config.json"
ARCHIVES = ("agent.zip", "last.zip")
CURVE = "curve.csv"
PRODUCTS = (*ARCHIVES, CURVE)
_COLUMNS = b"steps,seconds,"  # how a learning curve begins, a student's too
_RECIPE = (  # entries of every config.json that a training has written
    "algorithm", "augmentation", "augmentation_options", "control_period", "environment",
    "config", "versions", "command",
)  # fmt: skip


class AlreadyFinished(Exception):
    """The training that is asked for has ended; its text says where the agent is."""


def _lies(path: Path) -> bool:
    """Whether something is there, a broken link too."""
    return path.is_symlink() or path.exists()


def _recipe(path: Path) -> dict[str, Any] | None:
    """The recipe that a training has written to config.json, None for any other content."""
    try:
        recipe = current(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(recipe, dict) or not isinstance(recipe.get("config"), dict):
        return None
    return recipe if all(name in recipe for name in _RECIPE) else None


def _is_archive(path: Path) -> bool:
    """Whether a training has written an archive: it has a recipe with a configuration."""
    try:
        recipe = read_recipe(path)
    except ValueError:
        return False
    return recipe is not None and "config" in recipe


def _is_curve(path: Path) -> bool:
    """Whether a file is a learning curve."""
    try:
        with path.open("rb") as file:
            return file.read(len(_COLUMNS)) == _COLUMNS
    except OSError:
        return False


def _are_checkpoints(folder: Path, recipe: Mapping[str, Any] | None) -> bool:
    """Whether a training has written the checkpoints of a folder that holds `recipe`."""
    if recipe is not None and "finished" not in recipe:
        return True
    try:
        return checkpoint.read(folder)[0] is not None
    except ValueError:
        return False


def _recorded(folder: Path) -> dict[str, Any]:
    """What config.json holds, nothing where there is none.

    Raises ValueError for a file, any of those of a training, that no training has written.
    """
    recipe = _recipe(folder / CONFIG)
    ours = {CONFIG: recipe is not None, CURVE: _is_curve(folder / CURVE)}
    ours.update({name: _is_archive(folder / name) for name in ARCHIVES})
    names = (checkpoint.FILE, checkpoint.PREVIOUS)
    if any(_lies(folder / name) for name in names):
        ours.update(dict.fromkeys(names, _are_checkpoints(folder, recipe)))
    foreign = [name for name in ours if _lies(folder / name) and not ours[name]]
    if foreign:
        raise ValueError(
            f"{folder} holds {', '.join(foreign)} not written by a training, or damaged: nothing "
            "is changed there. Choose another --output, or move it away"
        )
    return recipe or {}


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
    if checkpoint.exist(folder):
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
    if _lies(folder) and not folder.is_dir():
        raise ValueError(f"--output {folder} is a file; must be a folder, or not yet there")
    recorded = _recorded(folder)
    if overwrite:
        return None
    finished = recorded.get("finished") is True
    if not resume:
        _check_free(folder, finished)
        return None
    if finished:
        _compare(recorded["config"], config, free)
        agent = folder / ARCHIVES[0]
        if not agent.exists():
            raise ValueError(
                f"{folder} holds a finished training, but {agent.name} is missing: put it back, "
                "or give --overwrite to train anew"
            )
        checkpoint.remove(folder)  # one may be left of a kill in the last moment
        raise AlreadyFinished(f"already finished: {agent}")
    captured, notices = checkpoint.read(folder)
    for notice in notices:
        print(f"{notice}; going on from the one before", file=sys.stderr)
    if captured is None:
        _check_free(folder, finished)  # an agent without a checkpoint, of an older version
    else:
        recorded = current(captured["recipe"])
    if "config" in recorded:
        _compare(recorded["config"], config, free)
    return captured


def _bytes(recipe: Mapping[str, Any]) -> bytes:
    return json.dumps(recipe, indent=2).encode()


def begin(folder: Path, recipe: Mapping[str, Any], done: int) -> None:
    """Write the configuration. What lies there goes, unless the training goes on after `done`.

    Nothing is deleted before the new configuration is on the disk. Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if done:
        print(f"going on after {done:,} steps")
        write_atomically(folder / CONFIG, _bytes(recipe))
        return
    written = folder / f".{CONFIG}.new"
    try:
        written.write_bytes(_bytes(recipe))
        checkpoint.remove(folder)
        for name in (CONFIG, *PRODUCTS):
            (folder / name).unlink(missing_ok=True)
        os.replace(written, folder / CONFIG)
    except BaseException:
        written.unlink(missing_ok=True)
        raise


def finish(folder: Path, recipe: Mapping[str, Any]) -> None:
    """Say in the folder that its training has ended, and delete its checkpoints."""
    write_atomically(folder / CONFIG, _bytes({**recipe, "finished": True}))
    checkpoint.remove(folder)
