"""Reading the file of a trained agent, a zip archive of plain data:

    recipe.json    what it is and how it came about (`baselines.learned.agent_archive`)
    weights.npz    of the network, under the names of PyTorch (`baselines.learned.agent_policy`)
    student.npz    of a student: its inference (`baselines.learned.student`)
Reading one runs no code of its author: there is no pickle in it. What is wrong is a ValueError of
one line.

The recipe of a trained agent: what an archive says of itself in JSON, checked.

    algorithm, network            layers, sizes and activation of the network
    augmentation, augmentation_options    of the observation: its kind, and `lags` or `scale`,
                                  `base`, `data_sheet`
    observation                   groups that the agent sees, {group: [fields]}; absent: those of v0
    normalisation                 running mean and variance of the inputs, or null
    control_period [s]
    environment                   id and arguments of the training, with `drive` and `vehicle`
    config, versions, ...         how it came about; nothing is read from there
`memory` and `memory_options` are former names of the augmentation, which `current` replaces.
Everything is checked before it is used, and what is wrong is a ValueError of one line.
"""

import io
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from baselines.learned.agent_policy import (
    ALGORITHMS,
    RECURRENT,
    STUDENT_FEATURES,
    TEACHER,
    V0_GROUPS,
    Arrays,
    Groups,
    Normalisation,
)
from baselines.learned.augmentation import KINDS
from tracked_env.physics.parameters import VEHICLES
from tracked_env.validation import check_unpacked, parsed_json, plain_arrays

FORMAT = 2  # of the recipe
PICKLED = 1  # format of the version before, whose networks lie beside it as SB3 pickles them
LONGEST_LAG = 4096  # [control steps]
MOST_UNITS, MOST_LAYERS = 4096, 16  # of a network that is built from a file
STUDENT = "student"  # kind of an agent that infers what its teacher sees
LAYER_ACTIVATIONS = ("tanh", "relu")  # of forward_pass.ACTIVATIONS, those of an actor

_NEEDED = (
    "format", "algorithm", "augmentation", "augmentation_options", "normalisation",
    "control_period",
)  # fmt: skip
_FORMER = {"memory": "augmentation", "memory_options": "augmentation_options"}
_DRIVES = ("torque", "speed")


class Driven(NamedTuple):
    """What an agent commands and drives."""

    drive: str  # torques or speeds of the sprockets
    vehicle: str  # nominal vehicle and soil, a key of VEHICLES


# Of recipes that name an environment of this project and leave these to its registration.
_REGISTERED = {
    "tracked_env/Torque-v0": Driven("torque", "strawa"),
    "tracked_env/Speed-v0": Driven("speed", "focchi"),
    "tracked_env/Terrain-v0": Driven("speed", "focchi"),
}


def current(recipe: Any) -> Any:
    """A recipe with the names of today, its configuration and that of a teacher too."""
    if not isinstance(recipe, dict):
        return recipe
    named = {_FORMER.get(name, name): value for name, value in recipe.items()}
    return {
        name: current(value) if name in ("config", "teacher") else value
        for name, value in named.items()
    }


def check_recipe(recipe: Any) -> None:
    """Raises ValueError for a recipe that no agent can be made of."""
    if not isinstance(recipe, dict) or recipe.get("format") not in (FORMAT, PICKLED):
        raise ValueError(
            f"its recipe is of another format; must be {FORMAT}. Is it of another version of this "
            "project?"
        )
    missing = [name for name in _NEEDED if name not in recipe]
    if missing:
        raise ValueError(f"its recipe lacks {', '.join(missing)}")
    try:
        _check(recipe)
    except ValueError as error:
        raise ValueError(f"in its recipe {error}") from error


def _is_number(value: Any, low: float = -math.inf) -> bool:
    """Whether a value of JSON is a finite number above `low`."""
    return type(value) in (int, float) and low < value and abs(value) < 1e300


def _check(recipe: Mapping[str, Any]) -> None:
    """Raises ValueError for a recipe that no agent can be made of."""
    kinds = (*KINDS, TEACHER, STUDENT)
    for name, known in (("algorithm", ALGORITHMS), ("augmentation", kinds)):
        if recipe[name] not in known:
            raise ValueError(f"{name} = {_short(recipe[name])}; must be one of {', '.join(known)}")
    if not _is_number(recipe["control_period"], 0.0):
        raise ValueError(f"control_period = {_short(recipe['control_period'])}; must be in s, > 0")
    _check_options(recipe["augmentation"], recipe["augmentation_options"])
    driven(recipe)
    groups_of(recipe)
    inputs = None
    if recipe["format"] != PICKLED:
        inputs = checked_network(recipe.get("network"), recipe["algorithm"])["inputs"]
    _check_normalisation(recipe["normalisation"], inputs)


def _short(value: Any) -> str:
    return repr(value)[:100]


def _check_options(kind: str, options: Any) -> None:
    """Options of a kind of augmentation. Raises ValueError."""
    names = {
        "history": ("lags",), "residual": ("scale", "base", "gains"), STUDENT: ("lags", "hidden"),
        TEACHER: (),
    }  # fmt: skip
    needed = names.get(kind, ())
    if kind == STUDENT and isinstance(options, dict) and "lstm_hidden" in options:
        needed = ("hidden", "lstm_hidden")
    known = needed if kind == TEACHER else (*needed, "data_sheet")
    if "lstm_hidden" in needed:
        known = (*known, "features")
    if not isinstance(options, dict) or not set(options) <= set(known):
        raise ValueError(
            f"augmentation_options = {_short(options)}; of augmentation {kind!r} must have "
            f"{' and '.join(known) or 'nothing'}"
        )
    if kind == STUDENT and not set(needed) <= set(options):
        raise ValueError(
            f"augmentation_options = {_short(options)}; a student needs {' and '.join(needed)}"
        )
    lags = options.get("lags", [1])
    integers = isinstance(lags, list) and all(type(lag) is int for lag in lags)
    if not (integers and lags and lags == sorted(set(lags)) and lags[0] >= 1):
        raise ValueError(f"lags = {_short(lags)}; must rise, from 1 control step on")
    if lags[-1] > LONGEST_LAG:
        raise ValueError(f"lags = {_short(lags)}; must be at most {LONGEST_LAG} control steps")
    if not are_sizes(options.get("hidden", [])):
        raise ValueError(f"hidden = {_short(options['hidden'])}; must be a list of sizes")
    if not _is_size(options.get("lstm_hidden", 1)):
        raise ValueError(f"lstm_hidden = {_short(options['lstm_hidden'])}; must be a size")
    if options.get("features", STUDENT_FEATURES[0]) not in STUDENT_FEATURES:
        raise ValueError(
            f"features = {_short(options['features'])}; must be {' or '.join(STUDENT_FEATURES)}"
        )
    if "gains" in options:
        from baselines.linearizing.linearizing_law import Gains  # many files behind it

        gains, fields = options["gains"], Gains._fields
        numbers = isinstance(gains, list) and all(_is_number(gain, -1.0) for gain in gains)
        if not (numbers and 1 <= len(gains) <= len(fields)):
            raise ValueError(f"gains = {_short(gains)}; must be {', '.join(fields)}")
    scale = options.get("scale", 1.0)
    if not (_is_number(scale, 0.0) and scale <= 2.0):
        raise ValueError(f"scale = {_short(scale)}; must be in (0, 2]")
    if type(options.get("data_sheet", False)) is not bool:
        raise ValueError(f"data_sheet = {_short(options['data_sheet'])}; must be true or false")
    if not isinstance(options.get("base", ""), str):
        raise ValueError(f"base = {_short(options['base'])}; must be the name of a policy")


def driven(recipe: Mapping[str, Any]) -> Driven:
    """Drive and nominal vehicle of the training. Raises ValueError."""
    arguments = recipe.get("environment", {})
    if not isinstance(arguments, dict):
        raise ValueError(f"environment = {_short(arguments)}; must be an id and arguments")
    name = arguments.get("id", "tracked_env/Torque-v0")
    usual = _REGISTERED.get(name) if isinstance(name, str) else None
    found = []
    for key, known in (("drive", _DRIVES), ("vehicle", tuple(VEHICLES))):
        value = arguments.get(key, None if usual is None else getattr(usual, key))
        if key not in arguments and usual is None:
            raise ValueError(
                f"environment.id = {_short(name)} is none of this project, and there is no "
                f"environment.{key}; must be one of {', '.join(known)}"
            )
        if value not in known:
            raise ValueError(
                f"environment.{key} = {_short(value)}; must be one of {', '.join(known)}"
            )
        found.append(value)
    return Driven(*found)


def groups_of(recipe: Mapping[str, Any]) -> Groups:
    """The observation that the agent sees: its groups and their fields. Raises ValueError."""
    groups = recipe.get("observation", V0_GROUPS)
    fields = [
        field
        for name, of_group in (groups.items() if isinstance(groups, dict) else ())
        for field in (of_group if isinstance(of_group, list) and of_group else (None,))
    ]
    if not fields or not all(isinstance(field, str) for field in fields):
        raise ValueError(
            f"observation = {_short(groups)}; must be groups with lists of their fields"
        )
    if len(set(fields)) < len(fields) or len(fields) > MOST_UNITS:
        raise ValueError(f"observation = {_short(groups)}; names a field twice, or too many")
    found: Groups = groups
    return found


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


def _is_size(value: Any) -> bool:
    return type(value) is int and 1 <= value <= MOST_UNITS


def are_sizes(value: Any) -> bool:
    """Whether a value of JSON is a list of sizes of layers."""
    return isinstance(value, list) and len(value) <= MOST_LAYERS and all(map(_is_size, value))


def checked_network(given: Any, algorithm: str) -> dict[str, Any]:
    """An architecture from JSON. Raises ValueError for one that cannot be built."""
    network = given if isinstance(given, dict) else {}
    recurrent = algorithm == RECURRENT
    lstm = network.get("lstm_hidden")
    activation = network.get("activation")
    if not (
        _is_size(network.get("inputs"))
        and are_sizes(network.get("hidden"))
        and activation in LAYER_ACTIVATIONS
        and (_is_size(lstm) if recurrent else lstm is None)
    ):
        raise ValueError(
            f"network = {str(given)[:200]!r}; must have `inputs`, a list `hidden` of at most "
            f"{MOST_LAYERS} sizes, `lstm_hidden` (null without LSTM), all within "
            f"[1, {MOST_UNITS}], and `activation`, one of {', '.join(LAYER_ACTIVATIONS)}"
        )
    return network


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
