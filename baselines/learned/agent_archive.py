"""Reading the file of a trained agent, a zip archive of plain data:

    recipe.json    what it is and how it came about (`baselines.learned.recipe`)
    weights.npz    of the network, under the names of PyTorch (`baselines.learned.forward_pass`)
    student.npz    of a student: its inference (`baselines.learned.student_network`)
Reading one runs no code of its author: there is no pickle in it. What is wrong is a ValueError of
one line.
"""

import io
import zipfile
from pathlib import Path
from typing import Any

from baselines.learned.forward_pass import Arrays
from baselines.learned.recipe import check_recipe, current
from tracked_env.validation import check_unpacked, parsed_json, plain_arrays

RECIPE, WEIGHTS, INFERENCE = "recipe.json", "weights.npz", "student.npz"


def read_entry(path: Path, name: str) -> bytes:
    """One file of an archive. Raises ValueError."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_unpacked(archive)
            return archive.read(name)
    except Exception as error:  # a damaged file raises what happens to go wrong
        raise ValueError(f"{name} in it is missing or damaged ({error})") from error


def _opened(path: Path) -> tuple[Any, list[str]]:
    """The content of recipe.json, None where there is none, and the names of all files."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_unpacked(archive)
            damaged = archive.testzip()
            if damaged is not None:
                raise ValueError(f"{damaged} in it is damaged")
            names = archive.namelist()
            recipe = parsed_json(archive.read(RECIPE).decode("utf-8")) if RECIPE in names else None
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
        return plain_arrays(io.BytesIO(content))
    except ValueError as error:
        raise ValueError(f"{name} is {error}") from error


def untrusted(path: Path, why: str) -> str:
    """Says that an archive would have to be unpickled."""
    return (
        f"agent {path} {why}: its network is pickled, and unpickling runs any code that its author "
        "put there. If you trust the author, add --trust (in Python: trust=True)"
    )
