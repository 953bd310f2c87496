"""The file of a trained agent, a zip archive of plain data, and the agent as a policy.

    policy = open_agent(Path("runs/ppo-blind-seed0/agent.zip")).make(context)
    recipe.json    what it is and how it came about, below
    weights.npz    of the network, under the names of PyTorch (`baselines.learned.agent_policy`)
Reading one runs no code of its author, since there is no pickle in it. The recipe is checked before
it is used; what is wrong is a ValueError of one line.

    algorithm, network            layers, sizes and activation of the network
    augmentation, augmentation_options    of the observation: its kind, and `lags` or `scale`, ..
    observation                   groups that the agent sees, {group: [fields]}; absent: those of v0
    normalisation                 running mean and variance of the inputs, or null
    control_period [s]
    environment                   id and arguments of the training, with `drive` and `vehicle`
    config, versions, ...         how it came about; nothing is read from there
A learned observer (`baselines.learned.learned_observer`) has the augmentation "observer", with the
options `base`, the policy that it stands in, and `recurrent`; one for any vehicle
(`baselines.learned.untold_policy`) has "any-vehicle", with `recurrent`; one that learned slip
(`baselines.learned.learned_slip`) has "learned-slip", with `recurrent` and `heights`, whether it
sees the height scan. They have neither algorithm nor network.
`memory` and `memory_options` are former names of the augmentation, which `current` replaces.
"""

import io
import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from baselines.batch_policy import Context
from baselines.learned.agent_policy import (
    ACTIVATIONS,
    ALGORITHMS,
    ANY_VEHICLE,
    LEARNED_SLIP,
    OBSERVER,
    RECURRENT,
    V0_GROUPS,
    Actor,
    AgentPolicy,
    Arrays,
    Groups,
    Normalisation,
    fields_of,
    make_augmentation,
)
from baselines.learned.augmentation import KINDS, PlainContext
from tracked_env.physics.parameters import PARAMETER_NAMES, VEHICLES, PlantParameters
from tracked_env.validation import (
    check_unpacked,
    checked_keys,
    checked_parameter,
    parsed_json,
    plain_arrays,
)

if TYPE_CHECKING:
    from baselines.learned.gated_network import Layers, RecurrentNetwork

HERE = Path(__file__).resolve().parent
RECIPE, WEIGHTS = "recipe.json", "weights.npz"  # in an archive
FORMAT = 2  # of the recipe
LONGEST_LAG = 4096  # [control steps]
MOST_UNITS, MOST_LAYERS = 4096, 16  # of a network that is built from a file
MOST_GAINS = 5  # of a controller

_NEEDED = (
    "format", "algorithm", "augmentation", "augmentation_options", "normalisation",
    "control_period",
)  # fmt: skip
_FORMER = {"memory": "augmentation", "memory_options": "augmentation_options"}
_DRIVES = ("torque", "speed")
APART = (OBSERVER, ANY_VEHICLE, LEARNED_SLIP)  # agents without an algorithm, a network of their own
_GONE = ("teacher", "student")  # kinds of agents that are known no longer


# What networks of one vehicle take for granted, and by how much it may differ [-].
_SIZES = ("mass", "inertia", "track_gauge", "contact_length", "sprocket_radius")
SAME_SIZE = 0.1


class Drive(NamedTuple):
    """What an agent commands and drives."""

    drive: str  # torques or speeds of the sprockets
    vehicle: PlantParameters  # nominal, on its nominal soil


# Of recipes that name an environment of this project and leave these to its registration.
_INDOORS = {"drive": "speed", "vehicle": "focchi"}
_REGISTERED = {
    "tracked_env/Torque-v0": {"drive": "torque", "vehicle": "strawa"},
    "tracked_env/Speed-v0": _INDOORS,
    "tracked_env/Terrain-v0": _INDOORS,
}


def current(recipe: Any) -> Any:
    """A recipe with the names of today, and so its configuration."""
    if not isinstance(recipe, dict):
        return recipe
    named = {_FORMER.get(name, name): value for name, value in recipe.items()}
    return {name: current(value) if name == "config" else value for name, value in named.items()}


def check_recipe(recipe: Any) -> None:
    """Raises ValueError for a recipe that no agent can be made of."""
    if not isinstance(recipe, dict) or recipe.get("format") != FORMAT:
        raise ValueError(
            f"its recipe is of another format; must be {FORMAT}. Is it of another version of this "
            "project?"
        )
    missing = [name for name in _NEEDED if name not in recipe]
    if missing:
        raise ValueError(f"its recipe lacks {', '.join(missing)}")
    try:
        kind = recipe["augmentation"]
        if kind in _GONE:
            raise ValueError(f"augmentation = {kind!r} is no longer known. Train another agent")
        _check_choice("augmentation", kind, (*KINDS, *APART))
        period = recipe["control_period"]
        _check(_is_number(period, 0.0), "control_period", period, "be in s, > 0")
        _check_options(kind, recipe["augmentation_options"])
        drive_of(recipe)
        if kind in APART:
            return
        _check_choice("algorithm", recipe["algorithm"], ALGORITHMS)
        groups_of(recipe)
        network: Any = recipe.get("network")
        _check_network(network, recipe["algorithm"])
        _check_normalisation(recipe["normalisation"], network["inputs"])
    except ValueError as error:
        raise ValueError(f"in its recipe {error}") from error


def _check(fine: object, name: str, value: Any, must: str) -> None:
    """Raises ValueError for a value of a recipe that is not fine."""
    if not fine:
        raise ValueError(f"{name} = {repr(value)[:100]}; must {must}")


def _check_choice(name: str, value: Any, known: Sequence[str]) -> None:
    _check(value in known, name, value, f"be one of {', '.join(known)}")


def _is_number(value: Any, low: float = -math.inf) -> bool:
    """Whether a value of JSON is a finite number above `low`."""
    return type(value) in (int, float) and low < value and abs(value) < 1e300


def _is_list(value: Any, check: Callable[[Any], bool], low: int, high: int) -> bool:
    """Whether a value of JSON is a list of `low` to `high` entries that pass the check."""
    return isinstance(value, list) and low <= len(value) <= high and all(map(check, value))


def _is_size(value: Any) -> bool:
    return type(value) is int and 1 <= value <= MOST_UNITS


def _are_lags(value: Any) -> bool:
    whole = _is_list(
        value, lambda lag: type(lag) is int and 1 <= lag <= LONGEST_LAG, 1, LONGEST_LAG
    )
    return whole and value == sorted(set(value))


# What an option of an augmentation must be.
_OPTIONS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "lags": (_are_lags, f"rise, from 1 to at most {LONGEST_LAG} control steps"),
    "gains": (
        lambda value: _is_list(value, lambda gain: _is_number(gain, -1.0), 1, MOST_GAINS),
        "be those of the controller",
    ),
    "scale": (lambda value: _is_number(value, 0.0) and value <= 2.0, "be in (0, 2]"),
    "data_sheet": (lambda value: type(value) is bool, "be true or false"),
    "base": (lambda value: isinstance(value, str), "be the name of a policy"),
    "recurrent": (lambda value: type(value) is bool, "be true or false"),
    "heights": (lambda value: type(value) is bool, "be true or false"),
}
_OPTIONS_OF = {
    "history": ("lags",),
    "residual": ("scale", "base", "gains"),
    OBSERVER: ("base", "recurrent"),
    ANY_VEHICLE: ("recurrent",),
    LEARNED_SLIP: ("recurrent", "heights"),
}


def _check_options(kind: str, options: Any) -> None:
    """Options of a kind of augmentation. Raises ValueError."""
    known = (*_OPTIONS_OF.get(kind, ()), *(() if kind in APART else ("data_sheet",)))
    must = f"of augmentation {kind!r} must have {' and '.join(known)}"
    if not isinstance(options, dict) or not set(options) <= set(known):
        raise ValueError(f"augmentation_options = {repr(options)[:100]}; {must}")
    if kind in APART:
        _check(set(options) == set(known), "augmentation_options", options, must)
    for name, value in options.items():
        is_valid, must = _OPTIONS[name]
        _check(is_valid(value), name, value, must)


def drive_of(recipe: Mapping[str, Any]) -> Drive:
    """Drive and nominal vehicle of the training. Raises ValueError."""
    arguments = recipe.get("environment", {})
    _check(isinstance(arguments, dict), "environment", arguments, "be an id and arguments")
    name = arguments.get("id", "tracked_env/Torque-v0")
    usual = _REGISTERED.get(name, {}) if isinstance(name, str) else {}
    values = {**usual, **arguments}
    for key, known in (("drive", _DRIVES), ("vehicle", tuple(VEHICLES))):
        if key not in values:
            raise ValueError(
                f"environment.id = {repr(name)[:100]} is none of this project, and there is no "
                f"environment.{key}; must be one of {', '.join(known)}"
            )
    _check_choice("environment.drive", values["drive"], _DRIVES)
    return Drive(values["drive"], _vehicle_of(values["vehicle"]))


def _vehicle_of(record: Any) -> PlantParameters:
    """A vehicle as `tracked_env.vehicles.vehicle_record` has it. Raises ValueError."""
    if not isinstance(record, dict):
        _check_choice("environment.vehicle", record, tuple(VEHICLES))
        return VEHICLES[record]
    checked_keys("environment.vehicle", record, PARAMETER_NAMES)
    missing = [name for name in PARAMETER_NAMES if name not in record]
    if missing:
        raise ValueError(f"environment.vehicle lacks {', '.join(missing)}; must have all values")
    return PlantParameters(**{n: checked_parameter(n, value) for n, value in record.items()})


def groups_of(recipe: Mapping[str, Any]) -> Groups:
    """The observation that the agent sees: its groups and their fields. Raises ValueError."""
    groups = recipe.get("observation", V0_GROUPS)
    lists = [*groups.values()] if isinstance(groups, dict) else []
    named = lists and all(
        _is_list(fields, lambda name: isinstance(name, str), 1, MOST_UNITS) for fields in lists
    )
    _check(named, "observation", groups, "be groups with lists of their fields")
    fields = fields_of(groups)
    once = len(set(fields)) == len(fields) <= MOST_UNITS
    _check(once, "observation", groups, "not name a field twice, nor too many")
    checked: Groups = groups
    return checked


def _check_normalisation(content: Any, inputs: int) -> None:
    """A running normalisation of `inputs` quantities. Raises ValueError."""
    values = content if isinstance(content, dict) else {}
    fine = content is None or (
        _is_list(values.get("mean"), _is_number, inputs, inputs)
        and _is_list(values.get("variance"), lambda x: _is_number(x) and x >= 0.0, inputs, inputs)
        and _is_number(values.get("epsilon"), 0.0)
        and _is_number(values.get("clip"), 0.0)
    )
    must = "be null, or have finite numbers `mean` and `variance`, "
    _check(fine, "normalisation", content, f"{must}{inputs} of each, `epsilon` and `clip` > 0")


def normalisation_of(recipe: Mapping[str, Any]) -> Normalisation | None:
    """The running normalisation that a checked recipe holds."""
    content = recipe["normalisation"]
    if content is None:
        return None
    mean, variance = (np.array(content[name], np.float64) for name in ("mean", "variance"))
    return Normalisation(mean, variance, content["epsilon"], content["clip"])


def _check_network(content: Any, algorithm: str) -> None:
    """An architecture. Raises ValueError for one that cannot be built."""
    network = content if isinstance(content, dict) else {}
    lstm = network.get("lstm_hidden")
    fine = (
        _is_size(network.get("inputs"))
        and _is_list(network.get("hidden"), _is_size, 0, MOST_LAYERS)
        and network.get("activation") in tuple(ACTIVATIONS)
        and (_is_size(lstm) if algorithm == RECURRENT else lstm is None)
    )
    must = f"have `inputs`, a list `hidden` of at most {MOST_LAYERS} sizes, `lstm_hidden` (null "
    must += f"without LSTM), all within [1, {MOST_UNITS}], and `activation`, one of "
    _check(fine, "network", content, must + ", ".join(ACTIVATIONS))


# The file


def read_arrays(path: Path, name: str) -> Arrays:
    """The arrays of an npz file in an archive. Raises ValueError, for pickled ones too."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_unpacked(archive)
            content = archive.read(name)
    except Exception as error:  # a damaged file raises what happens to go wrong
        raise ValueError(f"{name} in it is missing or damaged ({error})") from error
    try:
        return plain_arrays(io.BytesIO(content))
    except ValueError as error:
        raise ValueError(f"{name} is {error}") from error


def read_recipe(path: Path) -> dict[str, Any] | None:
    """The recipe in an archive, checked; None where an archive of Stable-Baselines3 has none.

    Raises ValueError for a missing, damaged or foreign file, and for a recipe that is not
    understood.
    """
    if not path.is_file():
        raise ValueError(f"agent {path}: no such file. Was it trained with another --output?")
    try:
        with zipfile.ZipFile(path) as archive:
            check_unpacked(archive)
            damaged, names = archive.testzip(), archive.namelist()
            if damaged is not None:
                raise ValueError(f"{damaged} in it is damaged")
            if RECIPE not in names and "data" in names:
                return None
            recipe: Any = current(parsed_json(archive.read(RECIPE).decode("utf-8")))
    except Exception as error:  # damaged archives and texts raise what happens to go wrong
        raise ValueError(
            f"agent {path} cannot be loaded: not an archive of an agent, or damaged "
            f"({str(error)[:200]})"
        ) from error
    try:
        check_recipe(recipe)
    except ValueError as error:
        raise ValueError(f"agent {path}: {error}") from error
    return dict(recipe)


# The agent


def check_context(path: Path, recipe: Mapping[str, Any], context: Context) -> None:
    """Raises ValueError for an environment with another control period or drive."""
    period, drive = recipe["control_period"], drive_of(recipe).drive
    if abs(period - context.control_period) > 1e-9:
        raise ValueError(
            f"agent {path} was trained with a control period of {period:g} s; this "
            f"environment has {context.control_period:g} s"
        )
    if context.drive != drive:
        raise ValueError(
            f"agent {path} was trained to command each sprocket's {drive}; this "
            f"environment takes its {context.drive}"
        )


def _check_size(path: Path, trained: Drive, context: Context) -> None:
    """Raises ValueError for a vehicle of another size than that of the training."""
    for name in (*_SIZES, f"{'torque' if trained.drive == 'torque' else 'sprocket_speed'}_limit"):
        there, here = getattr(trained.vehicle, name), getattr(context.vehicle, name)
        if abs(here - there) > SAME_SIZE * there:
            raise ValueError(
                f"agent {path} was trained on a vehicle of another size: {name} = {here:g} is not "
                f"within {SAME_SIZE:.0%} of {there:g}; 'any-vehicle' drives others on level ground"
            )


def layers_at(path: Path, recipe: Mapping[str, Any]) -> "Layers":
    """The network of an agent of APART. Raises ValueError."""
    from baselines.learned.learned_observer import observer_layers
    from baselines.learned.learned_slip import slip_layers
    from baselines.learned.untold_policy import policy_layers

    make: Any = {OBSERVER: observer_layers, ANY_VEHICLE: policy_layers, LEARNED_SLIP: slip_layers}
    options = {key: value for key, value in recipe["augmentation_options"].items() if key != "base"}
    try:
        layers: Layers = make[recipe["augmentation"]](read_arrays(path, WEIGHTS), **options)
    except ValueError as error:
        raise ValueError(f"agent {path} cannot be loaded: {error}") from error
    return layers


def policy_around(
    network: "RecurrentNetwork", kind: str, options: Mapping[str, Any], context: Context
) -> Any:
    """The policy of a kind of APART around its network. options: those of the recipe, and `told` of
    ANY_VEHICLE: whether it is shown the vehicle of the context."""
    if kind == ANY_VEHICLE:
        from baselines.learned.untold_policy import AnyVehiclePolicy

        return AnyVehiclePolicy(network, context, options.get("told", False))
    if kind == LEARNED_SLIP:
        from baselines.learned.learned_slip import LearnedSlipPolicy

        return LearnedSlipPolicy(network, context, options["heights"])
    from baselines.learned.learned_observer import LearnedObserver
    from baselines.registry import POLICIES

    policy: Any = POLICIES[options["base"]](context)
    policy.correct_motion(partial(LearnedObserver, network))
    return policy


def apart_at(
    path: Path, recipe: Mapping[str, Any], kind: str, **further: Any
) -> Callable[[Context], Any]:
    """Makes the policy of an archive of this kind of APART, with `further` options in place of its
    own. Raises ValueError."""
    from baselines.registry import POLICIES

    if recipe["augmentation"] != kind:
        found = recipe["augmentation"]
        raise ValueError(f"agent {path} is of the kind {found!r}; must be of {kind!r}")
    options = {**recipe["augmentation_options"], **further}
    base = options.get("base")
    if kind == OBSERVER and base not in POLICIES:
        raise ValueError(f"agent {path}: base = {base!r}; must be one of {', '.join(POLICIES)}")
    network = layers_at(path, recipe)

    def make(context: Context) -> Any:
        check_context(path, recipe, context)
        if kind != ANY_VEHICLE:
            _check_size(path, drive_of(recipe), context)
        return policy_around(network, kind, options, context)

    return make


class TrainedAgent(NamedTuple):
    """An archive that has been opened."""

    make: Callable[[Context], Any]  # a fresh policy for an environment
    sources: tuple[Path, ...]  # folders whose code its actions depend on, besides the archive


def open_agent(path: Path) -> TrainedAgent:
    """A trained agent.

    Raises ValueError for a missing, damaged or foreign file, for one that holds pickled objects,
    and for an agent that sees something else than this project's environments offer.
    """
    recipe = read_recipe(path)
    if recipe is None:
        raise ValueError(
            f"agent {path} has no recipe of train.py: its network is pickled, and unpickling runs "
            "any code that its author put there. If you trust the author, add --trust (in Python: "
            "trust=True)"
        )
    kind, options = recipe["augmentation"], recipe["augmentation_options"]
    if kind in APART:
        return TrainedAgent(apart_at(path, recipe, kind), (HERE.parent,))
    known, normalisation, groups = drive_of(recipe), normalisation_of(recipe), groups_of(recipe)
    fields = fields_of(groups)
    try:
        network = recipe["network"]
        model = Actor(recipe["algorithm"], network, read_arrays(path, WEIGHTS))
        features = make_augmentation(kind, options, PlainContext(*known), 1).feature_names
    except ValueError as error:
        raise ValueError(f"agent {path} cannot be loaded: {error}") from error
    inputs = len(fields) + len(features)
    if network["inputs"] != inputs:
        raise ValueError(
            f"agent {path} sees {network['inputs']} inputs; must see {inputs} "
            f"(augmentation {kind!r}). Was it trained on another environment?"
        )

    def make(context: Context) -> AgentPolicy:
        check_context(path, recipe, context)
        try:
            return AgentPolicy(model, kind, options, context, normalisation, groups)
        except ValueError as error:
            raise ValueError(f"agent {path}: {error}") from error

    whole = kind in ("estimates", "residual")  # estimators and controllers too
    return TrainedAgent(make, (HERE.parent if whole else HERE,))
