"""Configuration of a benchmark: sets, episodes, and settings that differ from the sets."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium

from tracked_env.benchmark import evaluation_sets as es
from tracked_env.benchmark.evaluation_sets import DEFAULT_SETS, SETS, BenchmarkSet, Version
from tracked_env.benchmark.files import source_fingerprint
from tracked_env.benchmark.policy_interface import PolicyContext
from tracked_env.engine.env_config import EnvConfig
from tracked_env.observation import make_layout
from tracked_env.physics.kernel_cache import imported_source
from tracked_env.sensors import make_sensors
from tracked_env.uncertainty import fingerprint, make_uncertainty
from tracked_env.validation import checked_choice
from tracked_env.vector_env import TrackedVehicleVectorEnv
from tracked_env.vehicles import find_vehicle

CHUNK = 64  # [episodes] run as one batch; has no influence on results
CHUNK_MIN = 16  # [episodes] that a worker gets at least; one takes twice its time in 64
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


@dataclass(frozen=True)
class BenchmarkConfig:
    """Episodes to be run. Part of a result's identity is all but `sets`, `episodes`, `chunk`, and
    `version`.

    None for reference, sensors, duration or error_limit: the value of each set or its environment.
    All sets are of one environment id.
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

    def __post_init__(self) -> None:
        """Raise ValueError for everything that the environment or the runner would refuse."""
        for name in self.sets:
            checked_choice("evaluation set", name, SETS)
        ids = {SETS[name].env for name in self.sets}
        if len(ids) > 1:
            raise ValueError(f"sets = {self.sets} are of {sorted(ids)}; must be of one environment")
        if len(set(self.sets)) != len(self.sets) or not self.sets:
            raise ValueError(f"sets = {self.sets}; must be one or more, each named once")
        for name, least in (("episodes", 1), ("chunk", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} = {getattr(self, name)}; must be at least {least}")
        es.version_of(self.env, self.sets, self.version)
        for name in self.sets:
            self.environment(name, 1, truth=False).close()

    def identity(self) -> dict[str, Any]:
        """Everything that changes the numbers of an episode, the policy apart."""
        identity = {**asdict(self), "source": SOURCE}
        for name in ("sets", "episodes", "chunk", "version"):
            del identity[name]
        others = {
            name: [
                repr(part) if field != "uncertainty" else fingerprint(make_uncertainty(part))
                for field, part in sorted(SETS[name]._asdict().items())
            ]
            for name in self.sets
            if name not in es.OF_VERSION
        }
        return {**identity, "own_sets": others} if others else identity

    @property
    def env(self) -> str:
        """Environment id of the sets."""
        return SETS[self.sets[0]].env

    @property
    def frozen_version(self) -> Version | None:
        """Version of the sets that results are compared with, None where there is none."""
        return es.version_of(self.env, self.sets, self.version)

    def evaluation_set(self, name: str) -> BenchmarkSet:
        """A set, with the settings of this configuration in place of its own."""
        settings = {key: getattr(self, key) for key in ("reference", "sensors", "duration")}
        return SETS[name]._replace(**{k: v for k, v in settings.items() if v is not None})

    def context(self, name: str) -> PolicyContext:
        """Information on the environment of a set that a policy may use."""
        entry = self.evaluation_set(name)
        arguments = {**EnvConfig._field_defaults, **self.arguments(name, truth=False)}
        vehicle = find_vehicle(arguments["vehicle"], arguments["base_vehicle"])
        return PolicyContext(
            1.0 / self.control_rate,
            self.lateral,
            make_sensors(entry.sensors, torque_limit=vehicle.torque_limit),
            arguments["drive"],
            vehicle,
            make_layout(arguments["observation"]).names,
        )

    def arguments(self, name: str, truth: bool) -> dict[str, Any]:
        """Arguments of an environment for a set; truth: whether it exposes it."""
        entry = self.evaluation_set(name)
        limit = {} if self.error_limit is None else {"error_limit": self.error_limit}
        usual = getattr(gymnasium.registry.get(entry.env), "kwargs", {})
        return {
            **{key: usual[key] for key in ("base_vehicle",) if key in usual},
            **entry.arguments,
            **limit,
            "reference": entry.reference,
            "uncertainty": entry.uncertainty,
            "sensors": entry.sensors,
            "duration": entry.duration,
            "control_rate": self.control_rate,
            "lateral": self.lateral,
            "expose_truth": truth,
        }

    def environment(self, name: str, count: int, truth: bool) -> TrackedVehicleVectorEnv:
        """A batch in which an ended episode rests."""
        return TrackedVehicleVectorEnv(
            count, **self.arguments(name, truth), autoreset_mode="Disabled"
        )

    def max_steps(self, name: str) -> int:
        """Control steps of a whole episode of a set."""
        return round(self.evaluation_set(name).duration * self.control_rate)
