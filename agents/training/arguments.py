"""The arguments of the environment of a training, from the options of train.py.

Several entries of `sensors` are a list; each gets its part of the vehicles
(`agents.training.joined`) and of the held-out episodes.
"""

from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium
from gymnasium.envs.registration import load_env_creator

from agents.training.joined import shares
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import PolicyContext
from tracked_env.engine.env_config import SHOWN, EnvConfig, make_solver
from tracked_env.observation import Layout, make_layout
from tracked_env.sensors import make_sensors
from tracked_env.validation import checked_keys, name_or_json
from tracked_env.vector_env import TrackedVehicleVectorEnv

if TYPE_CHECKING:
    from agents.training.options import Options

# `mixture` of uncertainty: everything that the benchmark calls in distribution, weak drives and
# faults among it. Out of distribution stays out, and so do slow motors and the distributed plant.
MIXTURE = {
    TORQUE_ID: (
        "soil-and-mass", "payload", "resistance-map", "weak-soil", "terrain-transition", "drift",
        "mixed", "alternating-soils", "weak-actuator", "actuator-fault", "alternating-gains",
    ),
    SPEED_ID: (
        "friction", "friction-step", "friction-drift", "floor-mixed", "alternating-floors",
    ),
    TERRAIN_ID: ("slope", "hills", "slope-step", "soft-patches", "slope-payload"),
}  # fmt: skip
# `mixture` of sensors: good ones, and what asks for the past, outages of the pose among it.
_INDOORS: tuple[str | Mapping[str, Any], ...] = (
    "mocap",
    {"preset": "mocap", "pose_delay": 0.1},
    {"preset": "mocap", "position_noise": 0.05},
    {"preset": "mocap", "velocity_measured": 0.0},
    "mocap-outages",
    {"preset": "mocap", "pose_rate": 1.0},
)
SENSOR_MIXTURE: dict[str, tuple[str | Mapping[str, Any], ...]] = {
    TORQUE_ID: (
        "rtk",
        {"preset": "rtk", "pose_delay": 0.2},
        "strawa",
        {"preset": "rtk", "velocity_measured": 0.0},
        "rtk-outages",
        {"preset": "rtk", "pose_rate": 1.0},
    ),
    SPEED_ID: _INDOORS,
    TERRAIN_ID: _INDOORS,
}
# What an environment draws from where its registration does not say so.
_DEFAULTS = {
    name: EnvConfig._field_defaults[name] for name in ("uncertainty", "sensors", "reference")
}
_OPTIONS = ("uncertainty", "sensors", "reference", "duration", "lateral")  # of train.py


def _named(known: Mapping[str, Any], env: str) -> Any:
    """What is known of an environment id. Raises ValueError."""
    if env not in known:
        raise ValueError(f"no mixture for {env}; name the entries one by one")
    return known[env]


def _entries(given: Sequence[str] | None, what: str, env: str, mixtures: Mapping[str, Any]) -> Any:
    """One entry, or a list; None where nothing is given. Raises ValueError."""
    if given is None:
        return None
    if not given:
        raise ValueError(f"--{what} needs at least one entry")
    parts = [
        part
        for text in given
        for part in (_named(mixtures, env) if text == "mixture" else (name_or_json(text, what),))
    ]
    return parts[0] if len(parts) == 1 else parts


def defaults_of(env: str) -> dict[str, Any]:
    """Arguments that an environment id is registered with, and the class's own where it is not."""
    return {**_DEFAULTS, **gymnasium.spec(env).kwargs}


def layout_of(env: str, arguments: Mapping[str, Any]) -> Layout:
    """What an environment id with arguments shows. Raises ValueError for an unknown group."""
    made = {**defaults_of(env), **arguments}
    return make_layout(made.get("observation", EnvConfig._field_defaults["observation"]))


def driven(env: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """What a policy must know of an environment id and its arguments: drive and vehicle."""
    made = {**defaults_of(env), **arguments}
    return {name: made[name] for name in ("drive", "vehicle") if name in made}


def control_period(env: str, arguments: Mapping[str, Any]) -> float:
    """Of an environment id with arguments [s]. Raises ValueError for arguments that are wrong."""
    made = {**defaults_of(env), **arguments}
    known = {name: made[name] for name in EnvConfig._fields if name in made}
    return make_solver(EnvConfig(**known)).control_period


def _further(text: str | None, env: str) -> Mapping[str, Any]:
    """Arguments without an option of their own, from JSON. Raises ValueError."""
    given = name_or_json(text, "env-args")
    for name in _OPTIONS:
        if isinstance(given, Mapping) and name in given:
            raise ValueError(f"--env-args: {name} has an option of its own, --{name}")
    allowed = sorted({*EnvConfig._fields} - {*_OPTIONS, *SHOWN})
    further = checked_keys("--env-args", given, allowed)
    try:
        layout_of(env, further)
        control_period(env, further)
    except (TypeError, ValueError) as error:
        raise ValueError(f"--env-args {text}: {error}") from error
    return further


def check_environment(env: str) -> None:
    """Raises ValueError for an id that is unknown, or not of an environment of this project."""
    try:
        made: Any = gymnasium.spec(env).vector_entry_point
        made = load_env_creator(made) if isinstance(made, str) else made
    except (gymnasium.error.Error, ImportError) as error:
        raise ValueError(f"--env {env}: {error}") from error
    if not (isinstance(made, type) and issubclass(made, TrackedVehicleVectorEnv)):
        raise ValueError(
            f"--env {env} is not an environment of tracked vehicles; must be {TORQUE_ID}, "
            f"{SPEED_ID}, {TERRAIN_ID}, or an id registered with their vector_entry_point"
        )


def environment_arguments(options: "Options") -> dict[str, Any]:
    """Arguments of the environment; `sensors` is a list where there are several.

    What the command line leaves open is as the environment id is registered. Raises ValueError.
    """
    check_environment(options.env)
    defaults = defaults_of(options.env)
    given = {
        "uncertainty": _entries(options.uncertainty, "uncertainty", options.env, MIXTURE),
        "sensors": _entries(options.sensors, "sensors", options.env, SENSOR_MIXTURE),
        "reference": name_or_json(options.reference, "reference"),
    }
    chosen = {key: defaults[key] if value is None else value for key, value in given.items()}
    further = _further(options.env_args, options.env)
    return {**chosen, "duration": options.duration, "lateral": options.lateral, **further}


class Part(NamedTuple):
    """The rows of one kind of sensors."""

    arguments: dict[str, Any]  # of their environment
    context: PolicyContext  # what a policy may know of it
    rows: int
    first: int  # rows before them


def parts_of(env: str, arguments: Mapping[str, Any], count: int) -> tuple[Part, ...]:
    """`count` rows, shared among the kinds of sensors. Raises ValueError."""
    given = arguments["sensors"]
    period, known = control_period(env, arguments), driven(env, arguments)
    known["observation"] = layout_of(env, arguments).names
    kinds = given if isinstance(given, list) else [given]
    counts = shares(count, len(kinds))
    firsts = accumulate(counts, initial=0)
    return tuple(
        Part(
            {**arguments, "sensors": sensors},
            PolicyContext(period, arguments["lateral"], make_sensors(sensors), **known),
            *where,
        )
        for sensors, *where in zip(kinds, counts, firsts, strict=False)  # one more of `firsts`
    )
