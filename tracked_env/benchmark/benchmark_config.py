"""Configuration of a benchmark: sets, episodes, and settings that differ from the sets.

Evaluation sets of one's own: of a file, and those of this package on another id.

    # my_sets.toml
    [wet-field]                                       # its name; everything below may be left out
    env = "tracked_env/Torque-v0"                     # by default that of --env
    uncertainty = {cohesion = [500.0, 2000.0]}        # a name, ranges, or a list of these
    reference = {kind = "circle", radius = 10.0, speed = 2.0}
    sensors = "rtk"
    duration = 20.0                                   # [s]
    seed = 0                                          # of episode 0; --seed is added to it
    arguments = {vehicle = "robot.toml", plant = "distributed"}    # further ones; files beside this

What is left out is as the id is registered.

A set of a published id is that id with differences: a law and a duration, and perhaps other
sensors, another reference or plant. On an id of another project the same differences are made to
the arguments of that id (`on_id`).
"""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from tracked_env.benchmark import evaluation_sets as es
from tracked_env.benchmark.evaluation_sets import DEFAULT_SETS, SETS, BenchmarkSet, Version
from tracked_env.benchmark.files import source_fingerprint
from tracked_env.benchmark.policy_interface import PolicyContext
from tracked_env.engine.env_config import SHOWN, EnvConfig, self_contained
from tracked_env.environment_ids import (
    PUBLISHED,
    arguments_of,
    checked_arguments,
    find_id,
    published_id,
    vector_class,
)
from tracked_env.observation import make_layout
from tracked_env.physics.kernel_cache import imported_source
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.plants import SHIPPED, find
from tracked_env.references.profile import PLAN
from tracked_env.references.specification import builder_of
from tracked_env.sensors import make_sensors
from tracked_env.uncertainty import fingerprint, make_uncertainty
from tracked_env.validation import checked_choice, checked_keys, checked_whole
from tracked_env.vector_env import TrackedVehicleVectorEnv
from tracked_env.vehicles import Spec, beside, find_vehicle, vehicle_record

CHUNK = 64  # [episodes] run as one batch; has no influence on results
FLEET_LIMIT = 2.5  # [contact lengths] error that ends an episode of a fleet
CHUNK_MIN = 16  # [episodes] that a worker gets at least; one takes twice its time in 64
# Control steps of all vehicles of a batch of two or more, at most: 0.4 kB is recorded of each, and
# the evaluation of an hour of one vehicle takes as much again three times.
LARGEST_BATCH = 200_000
# What a result's identity leaves out: files and folders of the package that draw, report, find
# policies (each record has its own fingerprint), run chunks elsewhere or adapt to other libraries.
# Everything else counts, so a new file counts until it is named here.
_OF_BENCHMARK = (
    *("executors", "figures", "files", "frozen", "leaderboard", "policies", "report"),
    *("statistics", "store", "summary", "table_model", "tuning", "video"),
)
WITHOUT_INFLUENCE = ("cli/", "rendering/", "sb3.py", *(f"benchmark/{n}.py" for n in _OF_BENCHMARK))
# Files of kernels as they were when those were imported, which may be long ago, the others as they
# are now: an edit while the process runs is not written over results of what it runs.
SOURCE = source_fingerprint("tracked_env", WITHOUT_INFLUENCE, imported_source)


def _identity(value: Any) -> Any:
    """A value as JSON has it, alike in every process; of an object, a digest."""
    if isinstance(value, Mapping):
        values = {str(key): _identity(each) for key, each in value.items() if key != "vehicle"}
        if "vehicle" in value:  # its values, not the name of its file
            values["vehicle"] = vehicle_record(find_vehicle(value["vehicle"]))
        return values
    if isinstance(value, (list, tuple)) and not hasattr(value, "_fields"):
        return [_identity(each) for each in value]
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return fingerprint(value)


def _content(entry: BenchmarkSet) -> dict[str, Any]:
    """All that the numbers of a set depend on, vehicles with their values, as JSON has it."""
    values = {**entry._asdict(), "uncertainty": fingerprint(make_uncertainty(entry.uncertainty))}
    module, _, values["env"] = entry.env.rpartition(":")
    if entry.env not in PUBLISHED:
        kind = vector_class(entry.env).__module__
        modules = {each for each in (module, kind) if each.partition(".")[0] != "tracked_env"}
        values["source"] = [source_fingerprint(each) for each in sorted(modules - {""})]
    return {key: _identity(value) for key, value in values.items()}


def _with_vehicle(entry: BenchmarkSet, vehicle: Spec | None) -> BenchmarkSet:
    """A set with the parameters of the vehicle that its arguments name, or of another one."""
    arguments = {**arguments_of(entry.env), **entry.arguments}
    try:
        spec = arguments["vehicle"] if vehicle is None else vehicle
        own = find_vehicle(spec, arguments["base_vehicle"])
    except ValueError as error:
        if vehicle is not None:
            raise
        raise ValueError(f"set {entry.name!r}: {error}") from error
    fields = {**entry.arguments, "vehicle": own, "reference": entry.reference}
    arguments = self_contained(fields)
    return entry._replace(reference=arguments.pop("reference"), arguments=arguments)


def _registered_source(entry: BenchmarkSet) -> dict[str, str]:
    """Digests of the kind of reference and the plant of a set that a project has registered."""
    plant = find({**arguments_of(entry.env), **entry.arguments}["plant"])
    own: dict[str, Any] = {"reference": builder_of(entry.reference)}
    own["plant"] = None if plant.name in SHIPPED else plant.prepare
    return {name: fingerprint(of) for name, of in own.items() if of is not None}


@dataclass(frozen=True)
class BenchmarkConfig:
    """Episodes to be run. Part of a result's identity is all but `sets`, `episodes`, `chunk`, and
    `version`, and of `own_sets` and `vehicle` the content.

    None for reference, sensors, duration, error_limit or vehicle: the value of each set or its
    environment. All sets are of one environment id. A vehicle is as `find_vehicle` takes it, and
    afterwards its parameters.
    """

    sets: tuple[str, ...] = DEFAULT_SETS
    episodes: int = 32  # per set
    seed: int = 0
    reference: str | Mapping[str, Any] | None = None
    sensors: str | Mapping[str, Any] | None = None
    duration: float | None = None  # [s]
    control_rate: float = 50.0  # [Hz]
    lateral: str = "sliding"
    error_limit: float | None = None  # [m]
    chunk: int = CHUNK
    version: str | None = None  # of the sets, to be compared with; None: the newest with all sets
    vehicle: Spec | None = None  # the sets' laws draw around it
    own_sets: tuple[BenchmarkSet, ...] = ()  # beside those that are registered, or in their place

    def __post_init__(self) -> None:
        """Raise ValueError for everything that the environment or the runner would refuse."""
        known = {**SETS, **self._own}
        for name in self.sets:
            checked_choice("evaluation set", name, known)
        ids = {known[name].env for name in self.sets}
        if len(ids) > 1:
            raise ValueError(f"sets = {self.sets} are of {sorted(ids)}; must be of one environment")
        if len(set(self.sets)) != len(self.sets) or not self.sets:
            raise ValueError(f"sets = {self.sets}; must be one or more, each named once")
        for name, least in (("episodes", 1), ("chunk", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} = {getattr(self, name)}; must be at least {least}")
        if self.version is not None:
            es.version_of(published_id(self.env), self.sets, self.version)
        # Files of vehicles are read once, and here: other processes need not have them.
        own_sets = tuple(_with_vehicle(entry, None) for entry in self.own_sets)
        object.__setattr__(self, "own_sets", own_sets)
        reference = self_contained({"reference": self.reference})["reference"]
        object.__setattr__(self, "reference", reference)
        fleets = [name for name in self.sets if self.registered(name).fleet is not None]
        if self.vehicle is not None and fleets:
            raise ValueError(
                f"vehicle with set {fleets[0]!r}, which draws its own vehicles; must be one of both"
            )
        if self.vehicle is not None:
            entry = _with_vehicle(self.registered(self.sets[0]), self.vehicle)
            object.__setattr__(self, "vehicle", entry.arguments["vehicle"])
        for name in self.sets:
            self._check(name)

    def _check(self, name: str) -> None:
        """Raises ValueError where no environment can be made of a set."""
        is_own, arguments = name in self._own, self.registered(name).arguments
        for key in ("control_rate", "lateral"):
            if arguments.get(key, getattr(self, key)) != getattr(self, key):
                raise ValueError(
                    f"set {name!r}: {key} = {arguments[key]!r}; must be that of the configuration, "
                    f"{getattr(self, key)!r}, and the same in all sets"
                )
        try:
            self.environment(name, 1, truth=False).close()
        except (TypeError, ValueError) as error:
            if isinstance(error, ValueError) and not is_own:
                raise
            raise ValueError(f"set {name!r}: {error}") from error

    def identity(self) -> dict[str, Any]:
        """Everything that changes the numbers of an episode, the policy apart."""
        left_out = ("sets", "episodes", "chunk", "version", "own_sets", "vehicle")
        names = (each.name for each in fields(self) if each.name not in left_out)
        identity = {**{name: _identity(getattr(self, name)) for name in names}, "source": SOURCE}
        if self.vehicle is not None:
            identity["vehicle"] = find_vehicle(self.vehicle)._asdict()
        others = {
            name: _content(self.registered(name))
            for name in self.sets
            if name in self._own or name not in es.OF_VERSION
        }
        sources = {name: _registered_source(self.evaluation_set(name)) for name in self.sets}
        sources = {name: source for name, source in sources.items() if source}
        parts = {"own_sets": others, "registered": sources}
        return identity | {name: part for name, part in parts.items() if part}

    @property
    def _own(self) -> dict[str, BenchmarkSet]:
        return {entry.name: entry for entry in self.own_sets}

    def registered(self, name: str) -> BenchmarkSet:
        """A set as it is registered, or one of `own_sets`. Raises KeyError for an unknown one."""
        return self._own[name] if name in self._own else SETS[name]

    @property
    def env(self) -> str:
        """Environment id of the sets."""
        return self.registered(self.sets[0]).env

    def first_seed(self, name: str) -> int:
        """Seed of episode 0 of a set."""
        return self.seed + self.registered(name).seed

    @property
    def frozen_version(self) -> Version | None:
        """Version of the sets that results are compared with, None where there is none."""
        named = self.version if self.env in PUBLISHED else None
        return es.version_of(self.env, self.sets, named)

    def evaluation_set(self, name: str) -> BenchmarkSet:
        """A set, with the settings of this configuration in place of its own."""
        settings = {key: getattr(self, key) for key in ("reference", "sensors", "duration")}
        explicit = {key: value for key, value in settings.items() if value is not None}
        return self.registered(name)._replace(**explicit)

    def _fleet_base(self, entry: BenchmarkSet) -> PlantParameters:
        arguments = {**arguments_of(entry.env), **entry.arguments}
        return find_vehicle(arguments["vehicle"], arguments["base_vehicle"])

    def context(self, name: str, episode: int = 0, truth: bool = False) -> PolicyContext:
        """Information on the environment of an episode of a set that a policy may use.

        truth: it sees the truth, and is told the true vehicle of a fleet.
        """
        entry = self.evaluation_set(name)
        arguments = {**arguments_of(entry.env), **self.arguments(name, False, episode)}
        vehicle = find_vehicle(arguments["vehicle"], arguments["base_vehicle"])
        if entry.fleet is not None and not truth:
            seed = self.first_seed(name) + episode
            vehicle = entry.fleet.told(seed, self._fleet_base(entry))
        return PolicyContext(
            1.0 / self.control_rate,
            self.lateral,
            make_sensors(entry.sensors, torque_limit=vehicle.torque_limit),
            arguments["drive"],
            vehicle,
            make_layout(arguments["observation"]).names,
        )

    def arguments(self, name: str, truth: bool, episode: int = 0) -> dict[str, Any]:
        """Arguments of an environment for an episode of a set; truth: whether it exposes it."""
        entry = self.evaluation_set(name)
        limit = {} if self.error_limit is None else {"error_limit": self.error_limit}
        vehicle: dict[str, Any] = {} if self.vehicle is None else {"vehicle": self.vehicle}
        own, reference = {**arguments_of(entry.env), **entry.arguments}, entry.reference
        if entry.fleet is not None:
            base = self._fleet_base(entry)
            its = entry.fleet.vehicle(self.first_seed(name) + episode, base)
            length = {"error_limit": FLEET_LIMIT * its.contact_length}
            vehicle, limit = {"vehicle": its}, {**length, **limit}
        other = bool(vehicle) and self.reference is None
        if other and isinstance(reference, Mapping) and reference.get("kind") != PLAN:
            # its speeds are for the vehicle of the set
            written_for = find_vehicle(own["vehicle"], own["base_vehicle"])
            reference = {"vehicle": written_for, **reference}
        return {
            "base_vehicle": own["base_vehicle"],
            **entry.arguments,
            **vehicle,
            **limit,
            "reference": reference,
            "uncertainty": entry.uncertainty,
            "sensors": entry.sensors,
            "duration": entry.duration,
            "control_rate": self.control_rate,
            "lateral": self.lateral,
            "expose_truth": truth,
        }

    def environment(
        self, name: str, count: int, truth: bool, episode: int = 0
    ) -> TrackedVehicleVectorEnv:
        """A batch in which an ended episode rests; of a fleet, with the vehicle of `episode`."""
        kind = vector_class(self.env)
        return kind(count, **self.arguments(name, truth, episode), autoreset_mode="Disabled")

    def options(self, name: str, episodes: Sequence[int]) -> dict[str, Any] | None:
        """Options of the reset of these episodes of a set."""
        entry = self.registered(name)
        if entry.fleet is None or self.sensors is not None:
            return None
        turns = [(self.first_seed(name) + i) % entry.fleet.episodes for i in episodes]
        return {"rows": [{"sensors": entry.fleet.sensors[turn]} for turn in turns]}

    def batches(self, name: str, episodes: int, size: int) -> Iterator[range]:
        """Episodes of a set that can run as one batch of at most `size`: of one vehicle, and
        fewer of long ones, so that memory is bounded."""
        fleet, first = self.registered(name).fleet, 0
        size = min(size, max(LARGEST_BATCH // self.max_steps(name), 1))
        while first < episodes:
            last = first + size
            if fleet is not None:
                last = first + fleet.episodes - (self.first_seed(name) + first) % fleet.episodes
            yield range(first, min(last, episodes))
            first = last

    def max_steps(self, name: str) -> int:
        """Control steps of a whole episode of a set."""
        return round(self.evaluation_set(name).duration * self.control_rate)


# --- sets of one's own ------------------------------------------------------------------------
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
        tables = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
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
    for table in tables.values():
        arguments = table.get("arguments")
        if isinstance(arguments, dict) and "vehicle" in arguments:
            arguments["vehicle"] = beside(path, arguments["vehicle"])
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
