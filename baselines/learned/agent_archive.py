"""Reading the file of a trained agent, a zip archive of plain data:

    recipe.json    what it is and how it came about (`baselines.learned.recipe`)
    weights.npz    of the network, under the names of PyTorch (`baselines.learned.forward_pass`)
    student.npz    of a student: its inference (`baselines.learned.student_network`)
Reading one runs no code of its author: there is no pickle in it. What is wrong is a ValueError of
one line.
"""

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from baselines.learned.forward_pass import Arrays
from baselines.learned.recipe import check_recipe, current

RECIPE, WEIGHTS, INFERENCE = "recipe.json", "weights.npz", "student.npz"
LARGEST = 2**28  # [bytes] of one file in an archive, unpacked


def read_entry(path: Path, name: str) -> bytes:
    """One file of an archive. Raises ValueError."""
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.read(name)
    except (zipfile.BadZipFile, OSError, KeyError, EOFError, NotImplementedError) as error:
        raise ValueError(f"{name} in it is missing or damaged ({error})") from error


def _opened(path: Path) -> tuple[Any, list[str]]:
    """The content of recipe.json, None where there is none, and the names of all files."""
    try:
        with zipfile.ZipFile(path) as archive:
            large = [entry.filename for entry in archive.infolist() if entry.file_size > LARGEST]
            if large:
                raise ValueError(f"{large[0]} in it has more than {LARGEST} bytes")
            damaged = archive.testzip()
            if damaged is not None:
                raise ValueError(f"{damaged} in it is damaged")
            names = archive.namelist()
            recipe = json.loads(archive.read(RECIPE)) if RECIPE in names else None
            return current(recipe), names
    except Exception as error:  # damaged archives and texts raise what happens to go wrong
        raise ValueError(
            f"agent {path} cannot be loaded: not an archive of an agent, or damaged "
            f"({str(error)[:200]})"
        ) from error


def read_recipe(path: Path) -> dict[str, Any] | None:
    """The recipe in an archive, checked; None where an archive of Stable-Baselines3 has none.

    Raises ValueError for a missing, damaged or foreign file, and for a recipe that is not
    understood.
    """
    if not path.is_file():
        raise ValueError(f"agent {path}: no such file. Was it trained with another --output?")
    recipe, names = _opened(path)
    if recipe is None:
        if "data" in names:
            return None
        raise ValueError(f"agent {path} cannot be loaded: not an archive of an agent")
    try:
        check_recipe(recipe)
    except ValueError as error:
        raise ValueError(f"agent {path}: {error}") from error
    found: dict[str, Any] = recipe
    return found


def from_npz(content: bytes, name: str) -> Arrays:
    """The arrays of an npz file of that name. Raises ValueError for others, pickled ones too."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            if not hasattr(stored, "files"):
                raise ValueError("it is a single array")
            return {entry: stored[entry] for entry in stored.files}
    except Exception as error:  # a damaged file raises what happens to go wrong
        raise ValueError(f"{name} is no npz file of plain arrays ({str(error)[:200]})") from error


def untrusted(path: Path, why: str) -> str:
    """Says that an archive would have to be unpickled."""
    return (
        f"agent {path} {why}: its network is pickled, and unpickling runs any code that its author "
        "put there. If you trust the author, add --trust (in Python: trust=True)"
    )
