"""The file of a trained agent, a zip archive of plain data:

    recipe.json    algorithm, kind of memory and its options, normalisation, network, control
                   period; how it came about: configuration, steps, versions, machine, command
    weights.npz    of the network, as `agents.networks` names them
    student.npz    of a student: its inference (`agents.inference`)
Reading one runs no code of whoever wrote it: there is no pickle in it. Everything is checked, and
what is wrong is a ValueError of one line.
"""

import json
import math
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy

from agents.algorithms import ALGORITHMS
from agents.inference import STUDENT
from agents.memory import KINDS
from agents.networks import (
    are_sizes,
    build,
    checked_network,
    from_npz,
    network_of,
    to_npz,
    weights_of,
)
from agents.policy import Normalisation
from agents.privileged import TEACHER
from tracked_env import TORQUE_ID
from tracked_env.benchmark.store import write_atomically
from tracked_env.physics.parameters import VEHICLES

RECIPE, WEIGHTS = "recipe.json", "weights.npz"
FORMAT = 2  # of the recipe
PICKLED = 1  # format of the version before, whose networks lie beside it as SB3 pickles them
LARGEST = 2**28  # [bytes] of one file in an archive, unpacked
LONGEST_LAG = 4096  # [control steps]
_NEEDED = ("format", "algorithm", "memory", "memory_options", "normalisation", "control_period")
_DRIVES = ("torque", "speed")


def save_agent(
    path: Path,
    model: BaseAlgorithm | BasePolicy,
    recipe: Mapping[str, Any],
    files: Mapping[str, bytes] | None = None,
) -> None:
    """Write recipe, network and further files as one archive, whole or not at all."""
    policy: BasePolicy = model.policy if isinstance(model, BaseAlgorithm) else model
    told = {**recipe, "format": FORMAT, "network": network_of(policy)}
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(RECIPE, json.dumps(told, indent=1))
        archive.writestr(WEIGHTS, to_npz(weights_of(policy)))
        for name, content in (files or {}).items():
            archive.writestr(name, content)
    write_atomically(path, buffer.getvalue())


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
            return (json.loads(archive.read(RECIPE)) if RECIPE in names else None), names
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
    formats = (FORMAT, PICKLED)
    if not isinstance(recipe, dict) or recipe.get("format") not in formats:
        raise ValueError(
            f"agent {path} has a recipe of another format; must be {FORMAT}. Is it of another "
            "version of this project?"
        )
    missing = [name for name in _NEEDED if name not in recipe]
    if missing:
        raise ValueError(f"agent {path}: its recipe lacks {', '.join(missing)}")
    try:
        _check(recipe)
    except ValueError as error:
        raise ValueError(f"agent {path}: in its recipe {error}") from error
    return recipe


def _is_number(value: Any, low: float = -math.inf) -> bool:
    """Whether a value of JSON is a finite number above `low`."""
    return type(value) in (int, float) and low < value and abs(value) < 1e300


def _check(recipe: Mapping[str, Any]) -> None:
    """Raises ValueError for a recipe that no agent can be made of."""
    kinds = (*KINDS, TEACHER, STUDENT)
    for name, known in (("algorithm", tuple(ALGORITHMS)), ("memory", kinds)):
        if recipe[name] not in known:
            raise ValueError(f"{name} = {_short(recipe[name])}; must be one of {', '.join(known)}")
    if not _is_number(recipe["control_period"], 0.0):
        raise ValueError(f"control_period = {_short(recipe['control_period'])}; must be in s, > 0")
    _check_options(recipe["memory"], recipe["memory_options"])
    _check_environment(recipe.get("environment", {}))
    inputs = None
    if recipe["format"] != PICKLED:
        inputs = checked_network(recipe.get("network"), recipe["algorithm"])["inputs"]
    _check_normalisation(recipe["normalisation"], inputs)


def _short(value: Any) -> str:
    return repr(value)[:100]


def _check_options(kind: str, options: Any) -> None:
    """Options of a kind of memory. Raises ValueError."""
    names = {"history": ("lags",), "residual": ("scale",), STUDENT: ("lags", "hidden")}
    known = names.get(kind, ())
    if not isinstance(options, dict) or not set(options) <= set(known):
        raise ValueError(
            f"memory_options = {_short(options)}; of memory {kind!r} must have "
            f"{' and '.join(known) or 'nothing'}"
        )
    if kind == STUDENT and set(options) != set(known):
        raise ValueError(f"memory_options = {_short(options)}; a student needs lags and hidden")
    lags = options.get("lags", [1])
    integers = isinstance(lags, list) and all(type(lag) is int for lag in lags)
    if not (integers and lags and lags == sorted(set(lags)) and lags[0] >= 1):
        raise ValueError(f"lags = {_short(lags)}; must rise, from 1 control step on")
    if lags[-1] > LONGEST_LAG:
        raise ValueError(f"lags = {_short(lags)}; must be at most {LONGEST_LAG} control steps")
    if not are_sizes(options.get("hidden", [])):
        raise ValueError(f"hidden = {_short(options['hidden'])}; must be a list of sizes")
    scale = options.get("scale", 1.0)
    if not (_is_number(scale, 0.0) and scale <= 2.0):
        raise ValueError(f"scale = {_short(scale)}; must be in (0, 2]")


def _check_environment(arguments: Any) -> None:
    """The environment of a training. Raises ValueError."""
    if not isinstance(arguments, dict):
        raise ValueError(f"environment = {_short(arguments)}; must be an id and arguments")
    name = arguments.get("id", TORQUE_ID)
    # Not gymnasium.spec, which is for ids of one's own: only what is registered already.
    if not isinstance(name, str) or name not in gymnasium.registry:
        raise ValueError(
            f"environment.id = {_short(name)}; is not registered. Was it trained with another "
            "package installed?"
        )
    for key, known in (("drive", _DRIVES), ("vehicle", tuple(VEHICLES))):
        if key in arguments and arguments[key] not in known:
            raise ValueError(
                f"environment.{key} = {_short(arguments[key])}; must be one of {', '.join(known)}"
            )


def _check_normalisation(stored: Any, inputs: int | None) -> None:
    """A running normalisation of `inputs` quantities. Raises ValueError."""
    if stored is None:
        return
    given = stored if isinstance(stored, dict) else {}
    mean, variance = given.get("mean"), given.get("variance")
    if not (
        isinstance(mean, list)
        and isinstance(variance, list)
        and len(mean) == len(variance)
        and (inputs is None or len(mean) == inputs)
        and all(map(_is_number, mean))
        and all(_is_number(value) and value >= 0.0 for value in variance)
        and _is_number(given.get("epsilon"), 0.0)
        and _is_number(given.get("clip"), 0.0)
    ):
        raise ValueError(
            f"normalisation = {_short(stored)}; must be null, or have finite numbers `mean` and "
            f"`variance`, {inputs or 'as many as inputs'} of each, `epsilon` and `clip` > 0"
        )


def normalisation_of(recipe: Mapping[str, Any]) -> Normalisation | None:
    """The running normalisation that a checked recipe holds."""
    stored = recipe["normalisation"]
    if stored is None:
        return None
    return Normalisation(
        np.array(stored["mean"], dtype=np.float64),
        np.array(stored["variance"], dtype=np.float64),
        stored["epsilon"],
        stored["clip"],
    )


def load_network(path: Path, recipe: Mapping[str, Any]) -> BasePolicy:
    """The network in an archive, as the policy of Stable-Baselines3. recipe: of `read_recipe`.

    Raises ValueError for an archive of the version before, and for weights that are damaged, not
    finite, or not those of the architecture.
    """
    if recipe["format"] == PICKLED:
        raise ValueError(untrusted(path, "is of a former version of train.py"))
    try:
        weights = from_npz(read_entry(path, WEIGHTS), WEIGHTS)
        return build(recipe["algorithm"], recipe["network"], weights)
    except ValueError as error:
        raise ValueError(f"agent {path} cannot be loaded: {error}") from error


def untrusted(path: Path, why: str) -> str:
    """Says that an archive would have to be unpickled."""
    return (
        f"agent {path} {why}: its network is pickled, and unpickling runs any code that its author "
        "put there. If you trust the author, add --trust (in Python: trust=True)"
    )
