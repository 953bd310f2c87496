"""Checkpoints of a training: everything that its next step depends on, in one file.

    recipe      of the training, with its configuration
    learner     of `Learner.capture`: networks, environment, random states
    progress    learning curve, best agent, times
A training that goes on from here does what it would have done: same parameters, bit for bit.
The file is plain data (`agents.training.state_file`): reading one runs no code of whoever wrote it.
It is written beside the one before, which is kept until the new one is whole.
"""

import os
import secrets
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.training.state_file import read_state, write_state

if TYPE_CHECKING:
    from agents.training.learner import Learner
    from agents.training.progress import Progress

FILE = "checkpoint.zip"
PREVIOUS = "checkpoint-before.zip"
FORMAT = 3


def put_back(captured: Mapping[str, Any], *parts: "Learner | Progress") -> None:
    """Let a fresh learner and its progress go on from a checkpoint.

    Raises ValueError for one that could be read and is not of this training.
    """
    try:
        for name, part in zip(("learner", "progress"), parts, strict=True):
            part.resume(captured[name])
    except Exception as error:  # what is not as `capture` left it raises what happens to go wrong
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        raise ValueError(
            f"the checkpoint does not fit this training ({reason}). Was it changed, or written by "
            "another version? Give --overwrite to train anew"
        ) from error


def write(folder: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint; until it is whole, the one before stays. A kill loses neither."""
    temporary = folder / f".{FILE}.{os.getpid()}-{secrets.token_hex(4)}.tmp"
    try:
        write_state(temporary, {"format": FORMAT, **state})
        if (folder / FILE).exists():
            os.replace(folder / FILE, folder / PREVIOUS)
        os.replace(temporary, folder / FILE)
    finally:
        temporary.unlink(missing_ok=True)


def _load(path: Path) -> dict[str, Any]:
    """Raises ValueError for a damaged file, and for one of another version."""
    try:
        with zipfile.ZipFile(path) as archive:
            pickled = "state.pkl" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        pickled = False  # what is wrong is said below
    if pickled:
        raise ValueError(
            f"checkpoint {path} is of a former version, which pickled it: opening it would run "
            "any code in it"
        )
    try:
        state = read_state(path)
    except ValueError as error:
        raise ValueError(f"checkpoint {path} is damaged: {error}") from error
    recipe = state.get("recipe")
    known = isinstance(recipe, dict) and isinstance(recipe.get("config"), dict)
    if state.get("format") != FORMAT or not known:
        raise ValueError(f"checkpoint {path} is not of format {FORMAT}, or lacks its configuration")
    return state


def read(folder: Path) -> tuple[dict[str, Any] | None, list[str]]:
    """The latest whole checkpoint of a folder, or None where there is none, and what to say.

    Raises ValueError when there are checkpoints, but all are damaged.
    """
    notices: list[str] = []
    for path in (folder / FILE, folder / PREVIOUS):
        if path.exists():
            try:
                return _load(path), notices
            except ValueError as error:
                notices.append(str(error))
    if notices:
        raise ValueError(
            f"{'; '.join(notices)}. Nothing to resume: delete {folder} and train anew."
        )
    return None, []


def exist(folder: Path) -> bool:
    """Whether a folder holds checkpoints."""
    return any((folder / name).exists() for name in (FILE, PREVIOUS))


def remove(folder: Path) -> None:
    """Delete the checkpoints of a folder."""
    for path in (folder / FILE, folder / PREVIOUS, *folder.glob(f".{FILE}*.tmp")):
        path.unlink(missing_ok=True)
