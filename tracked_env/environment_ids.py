"""Ids of environments that commands take: those of this package, and those of other projects.

An id of another project is registered with gymnasium, with the classes of this package or derived
ones; it is named as `gymnasium.make` takes it:
    namespace/Name-v0             registered by a module that is imported already
    module:namespace/Name-v0      registered when `module` is imported

    gymnasium.register(
        id="yard/Rover-v0",
        entry_point="tracked_env.env:TrackedVehicleEnv",
        vector_entry_point="tracked_env.vector_env:TrackedVehicleVectorEnv",
        kwargs={"vehicle": "rover.toml", "plant": "distributed"},
    )

`vector_entry_point` may be left out where the entry point is that class itself: many vehicles are
then simulated by this package's own. A derived class needs one of its own, which does the same.
"""

import copy
import inspect
from collections.abc import Collection, Mapping
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec, load_env_creator

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.engine.env_config import SHOWN, EnvConfig
from tracked_env.entry_points import imported_name
from tracked_env.env import TrackedVehicleEnv
from tracked_env.plants import DRIVES, find
from tracked_env.validation import alternatives, checked_choice, checked_keys
from tracked_env.vector_env import TrackedVehicleVectorEnv

PUBLISHED = (TORQUE_ID, SPEED_ID, TERRAIN_ID)  # those with evaluation sets and policies


def bare(env: str) -> str:
    """The name of an id alone, as Speed-v0."""
    return env.rpartition("/")[2]


def find_id(text: str, what: str = "environment") -> str:
    """The id that a command line names; the names of our own do without `tracked_env/`.

    Imports the module of `module:namespace/Name-v0`. what: it is, in messages. Raises ValueError
    for an id that is not registered, and for one whose environment is not a tracked one.
    """
    for env in PUBLISHED:
        if text in (env, bare(env), f"tracked_env:{env}"):
            return env
    name = imported_name(what, text)
    if name not in gymnasium.registry:
        others = "; an id of another project is named module:namespace/Name-v0"
        if name != text:
            others = f"; did {text.rpartition(':')[0]!r} register it?"
        near = alternatives(name, [bare(env) for env in PUBLISHED])
        raise ValueError(f"unknown environment {text!r}; {near}".rstrip(".") + others)
    vector_class(text, what)
    return text


def _registered(env: str) -> Any:
    """What gymnasium knows of an id that `find_id` has found, perhaps in another process."""
    return gymnasium.registry[imported_name("environment", env)]


def arguments_of(env: str) -> dict[str, Any]:
    """All arguments of the environment of an id: as registered, else the defaults."""
    return {**EnvConfig._field_defaults, **_registered(env).kwargs}


def _loaded(env: str, name: str) -> Any:
    """A class that an id is registered with; None where it has none. name: of the entry point."""
    entry = getattr(_registered(env), name)
    try:
        return load_env_creator(entry) if isinstance(entry, str) else entry
    except (ImportError, AttributeError) as error:
        raise ValueError(f"environment {env}: {name} {entry!r}: {error}") from error


def vector_class(env: str, what: str = "environment") -> type[TrackedVehicleVectorEnv]:
    """The class of the vector environment of an id; what: it is, in messages.

    Raises ValueError where it is not derived from `TrackedVehicleVectorEnv`, and where there is
    none and the single environment is not this package's own, without wrappers.
    """
    if env in PUBLISHED:
        return TrackedVehicleVectorEnv
    kind = _loaded(env, "vector_entry_point")
    if kind is None:
        single, wrappers = _loaded(env, "entry_point"), _registered(env).additional_wrappers
        if single is TrackedVehicleEnv and not wrappers:
            return TrackedVehicleVectorEnv
        if isinstance(single, type) and issubclass(single, TrackedVehicleEnv):
            own = "the wrappers of its registration" if wrappers else f"{single.__name__}"
            raise ValueError(
                f"{what} {env} is registered without vector_entry_point, and {own} is for one "
                "vehicle alone; must have one: derive a class from "
                "tracked_env.vector_env:TrackedVehicleVectorEnv that does the same, and add "
                'vector_entry_point="module:Class" to gymnasium.register'
            )
    if not (isinstance(kind, type) and issubclass(kind, TrackedVehicleVectorEnv)):
        raise ValueError(
            f"{what} {env} is not an environment of tracked vehicles; must be "
            f"{', '.join(PUBLISHED)}, or an id registered with their entry_point"
        )
    return kind


def vector_spec(env: str | EnvSpec) -> str | EnvSpec:
    """What `gymnasium.make_vec` takes for an id, with the vector environment of `vector_class`."""
    spec = None
    if isinstance(env, str):
        spec = gymnasium.registry.get(imported_name("environment", env))
    if spec is None or spec.vector_entry_point is not None:
        return env
    spec = copy.deepcopy(spec)
    spec.vector_entry_point = vector_class(str(env))
    return spec


def single_class(env: str) -> type[TrackedVehicleEnv]:
    """The class of the single environment of an id. Raises ValueError for one of another kind."""
    kind = TrackedVehicleEnv if env in PUBLISHED else _loaded(env, "entry_point")
    if not (isinstance(kind, type) and issubclass(kind, TrackedVehicleEnv)):
        raise ValueError(
            f"environment {env}: its entry_point is {kind!r:.100}; must be derived from "
            "tracked_env.env:TrackedVehicleEnv"
        )
    return kind


def published_id(env: str) -> str:
    """The published id whose sets and policies suit an id: that of the same drive.

    Of ids that are driven by speeds, Terrain-v0 where the plant is on terrain.
    """
    if env in PUBLISHED:
        return env
    of = arguments_of(env)
    if checked_choice("drive", of["drive"], DRIVES) == "torque":
        return TORQUE_ID
    return TERRAIN_ID if "terrain" in find(of["plant"]).options else SPEED_ID


def checked_arguments(
    what: str,
    env: str,
    value: object,
    elsewhere: Collection[str] = (),
    where: str = "has an option of its own, --{0}",
) -> dict[str, Any]:
    """Further arguments of the environment of an id, their names checked.

    what: they are, in messages. elsewhere: those that are said elsewhere, and where, with {0} for
    the name. Raises ValueError.
    """
    for name in (each for each in elsewhere if isinstance(value, Mapping) and each in value):
        raise ValueError(f"{what}: {name} {where.format(name)}")
    own = [*inspect.signature(vector_class(env)).parameters]
    names = {*EnvConfig._fields, *own} - {"num_envs", "autoreset_mode", *elsewhere, *SHOWN}
    return dict(checked_keys(what, value, sorted(names)))
