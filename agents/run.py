"""A training resolved from its options, once: everything that its parts are made of.

`resolve` turns the options of train.py into a `Run`; what makes environments, learners, archives
and checkpoints reads the run alone. Several entries of `sensors` are a list; each gets its part of
the vehicles (`agents.environments.JoinedVecEnv`) and of the held-out episodes.
"""

import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from agents.algorithms import ALGORITHMS, Algorithm
from agents.options import Options, check_read
from baselines.learned.agent_policy import Groups, groups_in
from baselines.learned.augmentation import BASE, LAGS, RESIDUAL_SCALE
from tracked_env import SPEED, SPEED_ID, TERRAIN, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.files import machine, versions
from tracked_env.benchmark.policy_interface import PolicyContext
from tracked_env.cli.command_line import vehicle_spec
from tracked_env.engine.env_config import EnvConfig, make_solver
from tracked_env.environment_ids import arguments_of, checked_arguments, find_id, published_id
from tracked_env.observation import make_layout
from tracked_env.references.specification import known_kind
from tracked_env.rewards import Scoring, reward_record
from tracked_env.sensors import make_sensors
from tracked_env.validation import name_or_json
from tracked_env.vehicles import find_vehicle, vehicle_record

FIRST_SEED, ROWS, TRAININGS = 2**24, 2**16, 2**15  # of trainings, and how far apart they are
PRECISION = 0.075  # [-] over the contact length: distance at which the reward term is 1/2
MIXED = "mixture"  # in the place of a name: several entries, which follow
# `mixture` of uncertainty: everything that the benchmark calls in distribution, quick changes, slow
# and failing drives among it. Out of distribution stays out, and so does another plant.
MIXTURE = {
    TORQUE_ID: (
        "soil-and-mass", "payload", "resistance-map", "weak-soil", "terrain-transition", "drift",
        "mixed", "alternating-soils", "weak-actuator", "actuator-fault", "alternating-gains",
        "loose-soil", "slow-drive", "alternating-loads", "alternating-resistances",
        "alternating-all", "flickering-drive",
    ),
    SPEED_ID: (
        "friction", "friction-step", "friction-drift", "floor-mixed", "alternating-floors",
        "slow-floor-drive", "changing-floors",
    ),
    TERRAIN_ID: (
        "slope", "hills", "slope-step", "soft-patches", "slope-payload", "changing-slope",
        "changing-hills", "slope-boxes",
    ),
}  # fmt: skip
Entry = str | Mapping[str, Any]  # of a set, sensors, reference: a name or an object of JSON


def _ways(usual: Mapping[str, Any], fast: Mapping[str, Any], backward: list[float]) -> Entry:
    """`mixture` of references: three episodes of five as usual, one fast, one backward."""
    further: tuple[Mapping[str, Any], ...] = ({}, {}, {}, fast, {"speed_range": backward})
    return {"kind": "mixed", "of": [{**usual, **changed} for changed in further]}


_FAST = {"speed_range": [2.0, 5.0], "yaw_rate_limit": 0.8, "lateral_acceleration_limit": 3.0}
_FAST_INDOORS = {"speed_range": [0.3, 0.55], "lateral_acceleration_limit": 0.6}
WAYS = {
    TORQUE_ID: _ways({"kind": "random"}, _FAST, [-3.0, -1.0]),
    SPEED_ID: _ways(SPEED["reference"], _FAST_INDOORS, [-0.5, -0.1]),
    TERRAIN_ID: _ways(TERRAIN["reference"], _FAST_INDOORS, [-0.5, -0.1]),
}
# `mixture` of sensors: good ones, and what asks for the past, outages of the pose among it.
_INDOORS: tuple[Entry, ...] = (
    "mocap",
    {"preset": "mocap", "pose_delay": 0.1},
    {"preset": "mocap", "position_noise": 0.05},
    {"preset": "mocap", "velocity_measured": 0.0},
    "mocap-outages",
    {"preset": "mocap", "pose_rate": 1.0},
)
_OUTDOORS: tuple[Entry, ...] = (
    "rtk",
    {"preset": "rtk", "pose_delay": 0.2},
    "strawa",
    {"preset": "rtk", "velocity_measured": 0.0},
    "rtk-outages",
    {"preset": "rtk", "pose_rate": 1.0},
)
SENSOR_MIXTURE = {TORQUE_ID: _OUTDOORS, SPEED_ID: _INDOORS, TERRAIN_ID: _INDOORS}
_OPTIONS = ("uncertainty", "sensors", "reference", "duration", "lateral")  # of train.py


class Augmentation(NamedTuple):
    """What the network has besides the present observation."""

    kind: str  # of baselines.learned.augmentation
    options: Mapping[str, Any]


class Part(NamedTuple):
    """The rows of one kind of sensors."""

    arguments: dict[str, Any]  # of their environment
    context: PolicyContext  # what a policy may know of it
    rows: int
    first: int  # rows before them, which their seeds go on from
    env: Any = None  # of held-out episodes: in DISABLED mode, one row each


@dataclass(frozen=True)
class Run:
    """One training. Row i of its vehicles is seeded `seed` + i."""

    options: Any  # Options, with the defaults in force
    algorithm: Algorithm
    settings: Any  # of the algorithm's class of settings
    seed: int  # of everything random
    arguments: Mapping[str, Any]  # of the environment
    groups: Groups  # of the observation, with their fields
    parts: tuple[Part, ...]  # the vehicles by kind of sensors
    held_out: tuple[Part, ...]  # the held-out episodes by kind of sensors, none without them
    augmentation: Augmentation
    recipe: Mapping[str, Any]  # what every archive of this training says of it


# The environment


def _entries(
    texts: Sequence[str] | None, what: str, env: str, mixtures: Mapping[str, tuple[Entry, ...]]
) -> Any:
    """One entry, or a list; None where nothing is named. Raises ValueError."""
    if texts is None:
        return None
    if not texts:
        raise ValueError(f"--{what} needs at least one entry")
    mixture = mixtures[published_id(env)]
    parts = [
        part
        for text in texts
        for part in (mixture if text == MIXED else (name_or_json(text, what),))
    ]
    return parts[0] if len(parts) == 1 else parts


def _reference(text: str | None, env: str) -> Any:
    """What --reference says; None where it is left out. Raises ValueError."""
    value = name_or_json(text, "reference")
    if isinstance(value, str):
        known_kind(value, MIXED)
    return WAYS[published_id(env)] if value == MIXED else value


def environment_of(options: Options) -> tuple[dict[str, Any], Groups, PolicyContext]:
    """Arguments of the environment that options describe, what it shows, and its context.

    `sensors` is a list where there are several; the context leaves them out. What the command line
    leaves open is as the environment id is registered. Raises ValueError.
    """
    env = find_id(options.env, "--env")
    usual = arguments_of(env)
    chosen = {
        "uncertainty": _entries(options.uncertainty, "uncertainty", env, MIXTURE),
        "sensors": _entries(options.sensors, "sensors", env, SENSOR_MIXTURE),
        "reference": _reference(options.reference, env),
        "duration": options.duration,
        "lateral": options.lateral,
    }
    chosen = {key: usual[key] if value is None else value for key, value in chosen.items()}
    further = name_or_json(options.env_args, "env-args")
    further = checked_arguments("--env-args", env, further, (*_OPTIONS, "vehicle"))
    if options.vehicle is not None:
        base = further.get("base_vehicle", usual["base_vehicle"])
        further["vehicle"] = vehicle_record(find_vehicle(vehicle_spec(options.vehicle), base))
    try:
        whole = {**usual, **further}
        config = EnvConfig(**{name: whole[name] for name in EnvConfig._fields if name in whole})
        layout, solver = make_layout(whole["observation"]), make_solver(config)
        Scoring(config.reward, config.costs, solver.nominal)  # checks both
    except (TypeError, ValueError) as error:
        raise ValueError(f"--env-args {options.env_args}: {error}") from error
    arguments = {**chosen, **further}
    context = PolicyContext(solver.control_period, arguments["lateral"], observation=layout.names)
    context = context._replace(drive=solver.drive.name, vehicle=solver.nominal)
    return arguments, groups_in(layout), context


def parts_of(arguments: Mapping[str, Any], context: PolicyContext, count: int) -> tuple[Part, ...]:
    """`count` rows, shared among the kinds of sensors as evenly as it goes, more for the first.

    Raises ValueError where there are fewer rows than kinds.
    """
    sensors, parts = arguments["sensors"], []
    kinds = sensors if isinstance(sensors, list) else [sensors]
    if count < len(kinds):
        raise ValueError(
            f"{count} vehicles or held-out episodes for {len(kinds)} kinds of sensors; must be one "
            "each"
        )
    first = 0
    for kind, rows in zip(kinds, map(len, np.array_split(range(count), len(kinds))), strict=True):
        sheet = make_sensors(kind, torque_limit=context.vehicle.torque_limit)
        seen = context._replace(sensors=sheet)
        parts.append(Part({**arguments, "sensors": kind}, seen, rows, first))
        first += rows
    return tuple(parts)


# The training


def random_seed(seed: int) -> int:
    """Of everything random in the training number `seed`; its row i is seeded that + i.

    Trainings share no episode with one another, with the held-out ones or with the benchmark's,
    whose seeds are below FIRST_SEED. Raises ValueError for a number out of range.
    """
    if not 0 <= seed < TRAININGS:
        raise ValueError(f"seed = {seed}; must be in [0, {TRAININGS})")
    return FIRST_SEED + ROWS * seed


def completed(options: Options, reward: Any = "default") -> Options:
    """Options with the defaults in force where they leave something open.

    reward: of the environment; none but its own terms are added to that. Raises ValueError.
    """
    algorithm = ALGORITHMS[options.algorithm]
    steps = algorithm.steps if options.steps is None else options.steps
    usual = arguments_of(find_id(options.env, "--env"))
    defaults: dict[str, Any] = {
        "agent": options.algorithm,
        "steps": steps,
        "evaluate_every": max(steps // 10, 1),
        "checkpoint_every": algorithm.checkpoint_every,
        "precision": PRECISION,
        "smoothness": algorithm.smoothness,
        "lags": LAGS,
        "residual_scale": RESIDUAL_SCALE,
        **{name: usual[name] for name in ("duration", "lateral")},
    }
    if reward != "default":  # it says itself what near the path and a calm action are worth
        for name in ("precision", "smoothness"):
            if getattr(options, name):
                raise ValueError(
                    f"--{name} {getattr(options, name):g} with a reward of your own; must be 0 or "
                    "left out: nothing is added to it. Put it into the reward"
                )
        defaults |= {"precision": 0.0, "smoothness": 0.0}
    left_open = {name: of for name, of in defaults.items() if getattr(options, name) is None}
    return replace(options, **left_open)


def _augmentation(options: Options, context: PolicyContext) -> Augmentation:
    """With the gains of the controller that a residual agent corrects."""
    kind = options.augmentation
    entries: dict[str, Any] = {}
    if kind == "history":
        entries = {"lags": list(options.lags or ())}
    elif kind == "residual":
        entries = {"scale": options.residual_scale}
        torques = context.drive == "torque"
        if options.base not in (None, BASE) or (options.base == BASE and not torques):
            entries["base"] = options.base  # refused where the drives take speeds
        else:
            from baselines.linearizing.linearizing_law import TUNED_GAINS  # many files behind
            from baselines.lyapunov.slippage_aware import tuned_gains

            gains = TUNED_GAINS if torques else tuned_gains(context.observation)
            entries["gains"] = list(gains.for_vehicle(context.vehicle))
    sheet = {"data_sheet": True} if options.data_sheet else {}
    return Augmentation(kind, {**entries, **sheet})


def configuration(options: Options) -> dict[str, Any]:
    """Completed options as JSON has them, without settings that are not read."""
    others = {name.replace("-", "_") for name in {*ALGORITHMS} - {options.algorithm}}
    chosen = {key: of for key, of in asdict(options).items() if key not in others}
    return dict(json.loads(json.dumps(chosen, default=str)))


def resolve(options: Options) -> Run:
    """The training that options describe.

    Raises ValueError, for options without effect too, and errors of gymnasium.
    """
    check_read(options)
    arguments, groups, context = environment_of(options)
    reward = {**arguments_of(options.env), **arguments}["reward"]
    options = completed(options, reward)
    augmentation = _augmentation(options, context)
    # Written out, so that an archive is read where no id is registered.
    if "reward" in arguments:
        arguments["reward"] = reward_record(arguments["reward"])
    drive = {"drive": context.drive, "vehicle": vehicle_record(context.vehicle)}
    algorithm = ALGORITHMS[options.algorithm]
    recipe = {
        "algorithm": algorithm.network,
        "augmentation": augmentation.kind,
        "augmentation_options": augmentation.options,
        "observation": groups,
        "control_period": context.control_period,
        "environment": {"id": options.env, **arguments, **drive},
        "config": {
            **configuration(options),
            "vehicle": options.vehicle and drive["vehicle"],
            "duration": arguments["duration"],
            "lateral": arguments["lateral"],
        },
        "versions": versions(),
        "machine": machine(),
        "command": shlex.join(["python", *sys.argv]),
    }
    parts = parts_of(arguments, context, options.vehicles)
    held_out = parts_of(arguments, context, options.held_out) if options.held_out else ()
    return Run(
        options, algorithm, options.settings, random_seed(options.seed),
        arguments, groups, parts, held_out, augmentation, recipe,
    )  # fmt: skip
