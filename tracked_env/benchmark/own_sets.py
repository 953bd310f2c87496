"""Evaluation sets of one's own: of a file, and those of this package on another id.

    # my_sets.toml
    [wet-field]                                       # its name; everything below may be left out
    env = "tracked_env/Torque-v0"                     # by default that of --env
    uncertainty = {cohesion = [500.0, 2000.0]}        # a name, ranges, or a list of these
    reference = {kind = "circle", radius = 10.0, speed = 2.0}
    sensors = "rtk"
    duration = 20.0                                   # [s]
    seed = 0                                          # of episode 0; --seed is added to it
    arguments = {vehicle = "robot.toml", plant = "distributed"}    # further ones

What is left out is as the id is registered.

A set of a published id is that id with differences: a law and a duration, and perhaps other
sensors, another reference or plant. On an id of another project the same differences are made to
the arguments of that id (`on_id`).
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tracked_env.benchmark.evaluation_sets import BenchmarkSet
from tracked_env.engine.env_config import SHOWN, EnvConfig
from tracked_env.environment_ids import arguments_of, checked_arguments, find_id
from tracked_env.physics.parameters import Range
from tracked_env.uncertainty import make_uncertainty
from tracked_env.validation import checked_keys, checked_whole

SUFFIX = ".toml"  # of a file of sets
OF_SET = ("uncertainty", "sensors", "reference", "duration")  # arguments that are its fields
KEYS = ("env", *OF_SET, "arguments", "seed")  # of a table of a file
_SEED = Range(0, 2**31, "-", "It is the seed of the first episode.")


def _registered_with(env: str) -> dict[str, Any]:
    """All arguments of an id that its environment is made from, but those of OF_SET."""
    usual = arguments_of(env)
    return {
        name: value
        for name, value in usual.items()
        if name not in (*OF_SET, *SHOWN) and value is not EnvConfig._field_defaults.get(name)
    }


def set_of(name: str, table: Mapping[str, Any], env: str, where: str = "set") -> BenchmarkSet:
    """A set from a table as in the head of this file; env: where it names none.

    Raises ValueError for an unknown key, id or argument, and for a seed that is none; what else is
    wrong is refused by `BenchmarkConfig`.
    """
    what = f"{where} {name!r}:"
    checked_keys(what, table, KEYS)
    try:
        named = str(table.get("env", env))
        env = env if named == env.rpartition(":")[2] else find_id(named)
        further = table.get("arguments")
        further = checked_arguments("arguments", env, further, OF_SET, "is a key of the set itself")
        seed = checked_whole("seed", table.get("seed", 0), _SEED)
        uncertainty = table.get("uncertainty", arguments_of(env)["uncertainty"])
        make_uncertainty(uncertainty)
    except ValueError as error:
        raise ValueError(f"{what} {error}") from error
    of_set = {key: table.get(key, arguments_of(env)[key]) for key in OF_SET}
    arguments = {**_registered_with(env), **further}
    return BenchmarkSet(name, **of_set, env=env, arguments=arguments, seed=seed)


def read_sets(path: str | Path, env: str) -> tuple[BenchmarkSet, ...]:
    """The sets of a TOML file, as in the head of this file; env: of those that name none.

    Raises ValueError for a file that is no TOML or has no set, and as `set_of`; OSError for one
    that cannot be read.
    """
    try:
        tables = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(
            f"sets {path}: no TOML: {error}; must be tables as `[my-set]`, with lines as "
            '`uncertainty = "payload"`'
        ) from error
    wrong = next((key for key, table in tables.items() if not isinstance(table, Mapping)), None)
    if wrong is not None or not tables:
        line = f"{wrong} = {tables[wrong]!r:.60} belongs to none" if wrong else "it is empty"
        raise ValueError(
            f"sets {path}: {line}; must be tables, each headed by a name as `[my-set]`"
        )
    return tuple(set_of(name, table, env, f"sets {path}:") for name, table in tables.items())


def on_id(entry: BenchmarkSet, env: str) -> BenchmarkSet:
    """A set of a published id on another id: the same law, duration and differences."""
    published, own = arguments_of(entry.env), _registered_with(env)
    said = {"sensors": entry.sensors, "reference": entry.reference, **entry.arguments}
    differences = {key: value for key, value in said.items() if value != published[key]}
    if "observation" in own:
        differences.pop("observation", None)
    usual = arguments_of(env)
    return entry._replace(
        env=env,
        sensors=differences.pop("sensors", usual["sensors"]),
        reference=differences.pop("reference", usual["reference"]),
        arguments={**own, **differences},
    )
