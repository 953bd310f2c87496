"""What an environment is built from: its arguments, and the solver that follows from them.

`EnvConfig` is the one list of the arguments: the constructors of the single and of the vector
environment take theirs from it, with `environment_arguments`.
"""

import copy
import functools
import inspect
import reprlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.envs.registration import EnvSpec

from tracked_env.physics.parameters import ParametersRead, PlantParameters, Range
from tracked_env.plants import DRIVES, Drive, Plant, Prepared, find, known_plants, prepared
from tracked_env.sensors import Sensors
from tracked_env.uncertainty import Spec
from tracked_env.validation import (
    alternatives,
    checked_choice,
    checked_flag,
    checked_keys,
    checked_number,
    checked_whole,
)
from tracked_env.vehicles import find_vehicle, written_out

SUBSTEP = 0.0025  # [s] longest RK4 step; stable there, its error is in docs/numerics.md
SHOWN = ("expose_truth", "render_mode")  # what is returned and drawn: nothing moves by them
_RATE = Range(5.0, 1000.0, "Hz", "Did you pass the period?")
_STEP = Range(1e-5, 0.005, "s", "Larger steps are unstable.")
_LIMIT = Range(0.01, 1e6, "m", "It is a distance.")
_THREADS = Range(1, 64, "-", "Number of threads.")
_Constructor = Callable[..., None]


class EnvConfig(NamedTuple):
    """Arguments of the environments, as `TrackedVehicleEnv` documents them."""

    reference: str | Mapping[str, Any] = "random"
    uncertainty: Spec = "soil-and-mass"
    sensors: str | Mapping[str, Any] | Sensors = "rtk"
    duration: float = 30.0  # [s]
    control_rate: float = 50.0  # [Hz]
    lateral: str = "sliding"
    error_limit: float = 5.0  # [m]
    time_step: float = SUBSTEP  # [s]
    vehicle: str | Path | Mapping[str, Any] | PlantParameters = "strawa"
    plant: str | Plant = "lumped"
    drive: str = "torque"
    patches: Sequence[int] = (10, 4)
    plant_options: Mapping[str, Any] | None = None
    observation: str | Sequence[str] = "v0"
    expose_truth: bool = False
    render_mode: str | None = None
    terrain: Any = None  # of the plant on terrain; the same as in plant_options
    reward: str | Mapping[str, Any] | Callable[..., Any] = "default"
    costs: Mapping[str, Any] | None = None  # limits; both as `tracked_env.rewards` has them
    base_vehicle: str = "strawa"  # of a `vehicle` that names no "base"
    threads: int = 1  # an argument of the vector environment alone


def environment_arguments(constructor: _Constructor) -> _Constructor:
    """`constructor` with the arguments of `EnvConfig` in place of its parameter `config`.

    A field that the constructor has as a parameter of its own is left to it. The signature lists
    all; an unknown argument is a TypeError that names the nearest one. What is SHOWN is checked
    here, and an attribute.
    """
    existing = inspect.signature(constructor).parameters
    kind, annotations = inspect.Parameter.POSITIONAL_OR_KEYWORD, EnvConfig.__annotations__
    added = {
        name: inspect.Parameter(name, kind, default=default, annotation=annotations[name])
        for name, default in EnvConfig._field_defaults.items()
        if name not in existing and name != "threads"
    }
    parameters: list[inspect.Parameter] = []
    for name, parameter in existing.items():
        parameters += added.values() if name == "config" else [parameter.replace(kind=kind)]
    signature = inspect.Signature(parameters, return_annotation=None)

    @functools.wraps(constructor)
    def construct(self: Any, *positional: Any, **keywords: Any) -> None:
        function, names = type(self).__name__, [*signature.parameters][1:]
        for name in (each for each in keywords if each not in names):
            # Python's own words: tools, such as TorchRL's GymEnv, look for them.
            others = alternatives(name, names)
            raise TypeError(f"{function}(): unexpected keyword argument {name!r}; {others}")
        try:
            values = signature.bind(self, *positional, **keywords).arguments
        except TypeError as error:
            raise TypeError(f"{function}(): {error}") from None
        config = EnvConfig(**{name: values.pop(name) for name in added if name in values})
        if config.render_mode is not None:
            checked_choice("render_mode", config.render_mode, self.metadata["render_modes"])
        self.render_mode = config.render_mode
        self.expose_truth = checked_flag("expose_truth", config.expose_truth)
        constructor(**values, config=config)

    construct.__signature__ = signature  # type: ignore[attr-defined]
    construct.__annotations__ = {p.name: p.annotation for p in parameters[1:]} | {"return": None}
    return construct


def self_contained(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments that make an equal environment in another process, or after a file has changed.

    Vehicles of files and of `register_vehicle` and rewards that are dicts are written out. Raises
    ValueError and OSError as `vehicle_values` does.
    """
    changed, reference = dict(arguments), arguments.get("reference")
    if "vehicle" in arguments:
        changed["vehicle"] = written_out(arguments["vehicle"])
    if isinstance(reference, Mapping) and reference.get("vehicle") is not None:
        changed["reference"] = {**reference, "vehicle": written_out(reference["vehicle"])}
    if isinstance(arguments.get("reward"), str) and arguments["reward"] != "default":
        from tracked_env.rewards import reward_record  # here: few environments need it

        changed["reward"] = reward_record(arguments["reward"])
    return changed


def plain_arguments(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments as `self_contained` has them that JSON can hold; functions and plants stay."""
    return {name: _plain(value) for name, value in self_contained(arguments).items()}


def _plain(value: Any) -> Any:
    if hasattr(value, "_asdict"):  # PlantParameters, Sensors: JSON would make lists of them
        value = value._asdict()
    if isinstance(value, Mapping):
        return {name: _plain(of) for name, of in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(of) for of in value]
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


class PlainSpec:
    """Base of the environments: `spec.to_json()` describes them whole, `EnvSpec.from_json` equally.

    Laws and rewards that are functions need a name for that, by their `register`.
    """

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """What the environment was made from, by `gymnasium.make`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec = copy.copy(spec)
            spec.kwargs = plain_arguments(spec.kwargs)
        self._spec = spec


class Solver(NamedTuple):
    """Clock, plant and limits, the same for every vehicle of a batch."""

    control_period: float  # [s]
    substeps: int  # per control step
    substep: float  # [s]
    plant: Plant
    drive: Drive  # what the action is
    prepared: Prepared  # the plant with this drive and its options
    nominal: PlantParameters  # of the vehicle and the soil that its controllers expect
    error_limit: float  # [m] distance to the reference that ends an episode
    threads: int

    @property
    def reads(self) -> ParametersRead:
        """The parameters on which motion and sensors depend."""
        names = self.plant.reads[self.drive.name] - self.prepared.unread
        words = f"{self.plant.name} plant{self.prepared.variant} driven by {self.drive.name}"
        return ParametersRead(words, names, self.drive.limit)


def _quoted(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else " ".join(reprlib.repr(value).split())


def plant_options(plant: Plant, config: EnvConfig) -> dict[str, Any]:
    """Options of the plant: those that are arguments of their own, then `plant_options`.

    `lateral`, `patches` and `terrain` are arguments of every environment. Raises ValueError for a
    value other than the default where the plant has no such option, and for a terrain said twice.
    """
    arguments: dict[str, Any] = {"lateral": config.lateral, "patches": config.patches}
    explicit = checked_keys("plant_options", config.plant_options, plant.options)
    if config.terrain is not None:
        arguments["terrain"] = config.terrain
        if "terrain" in explicit:
            raise ValueError(
                "terrain is given as an argument and in plant_options; must be one of them"
            )
    for name, value in arguments.items():
        default = EnvConfig._field_defaults[name]
        if name not in plant.options and value is not default and value != default:
            others = [other.name for other in known_plants() if name in other.options]
            raise ValueError(
                f'{name} = {_quoted(value)} with plant = "{plant.name}"; must be '
                f"{_quoted(default)}: this plant has no such option. Did you mean plant = "
                f'"{others[0]}"?'
            )
    return {**{k: v for k, v in arguments.items() if k in plant.options}, **explicit}


def make_solver(config: EnvConfig) -> Solver:
    """Check and combine; the sub-step is the largest one <= time_step that divides a step.

    Raises ValueError for a value outside its range, an unknown name, and for a drive that the plant
    does not accept.
    """
    rate = checked_number("control_rate", config.control_rate, _RATE)
    longest = checked_number("time_step", config.time_step, _STEP)
    limit = checked_number("error_limit", config.error_limit, _LIMIT)
    threads = checked_whole("threads", config.threads, _THREADS)
    plant = find(config.plant)
    preparation = prepared(plant, config.drive, plant_options(plant, config))
    substeps = int(np.ceil(1.0 / (rate * longest) - 1e-9))
    drive, vehicle = DRIVES[config.drive], find_vehicle(config.vehicle, config.base_vehicle)
    clock = (1.0 / rate, substeps, 1.0 / (rate * substeps))
    return Solver(*clock, plant, drive, preparation, vehicle, limit, threads)
