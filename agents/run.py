"""A training resolved from its options, once: everything that its parts are made of.

`resolve` turns the options of train.py into a `Run`; what makes environments, learners, archives
and checkpoints reads the run alone.
"""

import json
import shlex
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from agents.algorithms import ALGORITHMS, STUDENT_ALGORITHM, Algorithm
from agents.options import (
    Options,
    Part,
    check_read,
    control_period,
    driven,
    environment_arguments,
    layout_of,
    parts_of,
)
from agents.reward import PRECISION
from baselines.learned.agent_archive import STUDENT, Driven
from baselines.learned.agent_policy import STUDENT_FEATURES, Groups, groups_in
from baselines.learned.augmentation import BASE, LAGS, RESIDUAL_SCALE
from baselines.linearizing.linearizing_law import TUNED_GAINS
from baselines.lyapunov.slippage_aware import tuned_gains
from tracked_env.benchmark.store import machine, versions
from tracked_env.engine.env_config import EnvConfig

FIRST_SEED, ROWS, TRAININGS = 2**24, 2**16, 2**15  # of trainings, and how far apart they are


class Schedule(NamedTuple):
    """When what happens, all in environment steps over all vehicles."""

    total: int
    evaluate_every: int
    checkpoint_every: int  # 0: between all rollouts


class Augmentation(NamedTuple):
    """What the network has besides the present observation."""

    kind: str  # of baselines.learned.augmentation, or teacher or student
    options: Mapping[str, Any]


class Reward(NamedTuple):
    """What the reward of the training has besides that of the environment."""

    precision: float  # [-] over the contact length
    smoothness: float  # [-] action-rate penalty


@dataclass(frozen=True)
class Run:
    """One training. Row i of its vehicles is seeded `seed` + i."""

    name: str  # of the algorithm, with which the options of its settings begin
    algorithm: Algorithm
    settings: Any  # of the algorithm's class of settings
    seed: int  # of everything random
    env: str  # id of the environment
    arguments: Mapping[str, Any]  # of the environment; `sensors` is a list where there are several
    groups: Groups  # of the observation, with their fields
    parts: tuple[Part, ...]  # the vehicles by kind of sensors
    held_out: tuple[Part, ...]  # the held-out episodes by kind of sensors, none without them
    staggered: bool
    augmentation: Augmentation
    reward: Reward
    normalise: bool  # whether observations are normalised by their running statistics
    schedule: Schedule
    teacher: Path | None  # of a student
    trust: bool  # whether pickled objects in the teacher's archive are loaded
    folder: Path
    tensorboard: bool
    recipe: Mapping[str, Any]  # what every archive of this training says of it

    @property
    def vehicles(self) -> int:
        """Rows of all parts."""
        return sum(part.rows for part in self.parts)


def random_seed(seed: int) -> int:
    """Of everything random in the training number `seed`; its row i is seeded that + i.

    Trainings share no episode with one another, with the held-out ones or with the benchmark's,
    whose seeds are below FIRST_SEED. Raises ValueError for a number out of range.
    """
    if not 0 <= seed < TRAININGS:
        raise ValueError(f"seed = {seed}; must be in [0, {TRAININGS})")
    return FIRST_SEED + ROWS * seed


def chosen_settings(options: Options) -> tuple[str, Any]:
    """Name and settings of what learns: the chosen algorithm, or a student."""
    name = STUDENT if options.augmentation == STUDENT else options.algorithm
    return name, getattr(options, name.replace("-", "_"))


def _algorithm(options: Options) -> tuple[str, Algorithm, Any]:
    """Name, record and settings of what learns."""
    name, settings = chosen_settings(options)
    return name, STUDENT_ALGORITHM if name == STUDENT else ALGORITHMS[name], settings


def _schedule(options: Options, algorithm: Algorithm) -> Schedule:
    total = algorithm.steps if options.steps is None else options.steps
    every, checkpoint = options.evaluate_every, options.checkpoint_every
    return Schedule(
        total,
        max(total // 10, 1) if every is None else every,
        algorithm.checkpoint_every if checkpoint is None else checkpoint,
    )


def _reward(options: Options) -> Reward:
    precision, smoothness = options.precision, options.smoothness
    usual = ALGORITHMS[options.algorithm].smoothness
    return Reward(
        PRECISION if precision is None else precision,
        float(usual if smoothness is None else smoothness),
    )


def _lags(options: Options) -> tuple[int, ...]:
    return LAGS if options.lags is None else options.lags


def _residual_scale(options: Options) -> float:
    return RESIDUAL_SCALE if options.residual_scale is None else options.residual_scale


def _commands_torques(options: Options) -> bool:
    return bool(_driven(options.env, environment_arguments(options))["drive"] == "torque")


def _residual(options: Options) -> dict[str, Any]:
    """Options of a residual agent, with the gains of the controller that it corrects."""
    residual: dict[str, Any] = {"scale": _residual_scale(options)}
    torques = _commands_torques(options)
    if options.base not in (None, BASE) or (options.base == BASE and not torques):
        return {**residual, "base": options.base}  # refused where the drives take speeds
    if torques:
        return {**residual, "gains": list(TUNED_GAINS)}
    shown = layout_of(options.env, environment_arguments(options)).names
    return {**residual, "gains": list(tuned_gains(shown))}


def _augmentation(options: Options) -> Augmentation:
    lags = list(_lags(options))
    residual = _residual(options) if options.augmentation == "residual" else {}
    student = options.student
    inferred: dict[str, Any] = {"lags": lags, "hidden": list(student.hidden)}
    if student.lstm_hidden:
        inferred = {"hidden": list(student.hidden), "lstm_hidden": student.lstm_hidden}
        if student.features != STUDENT_FEATURES[0]:
            inferred["features"] = student.features
    known = {"history": {"lags": lags}, "residual": residual, STUDENT: inferred}
    sheet = {"data_sheet": True} if options.data_sheet else {}
    return Augmentation(options.augmentation, {**known.get(options.augmentation, {}), **sheet})


def configuration(options: Options) -> dict[str, Any]:
    """Options as JSON has them, with the defaults in force, without settings that are not read."""
    name, algorithm, _ = _algorithm(options)
    others = {other.replace("-", "_") for other in (*ALGORITHMS, STUDENT)}
    others -= {name.replace("-", "_")}
    kept = {key: value for key, value in asdict(options).items() if key not in others}
    schedule = _schedule(options, algorithm)
    reward = _reward(options)  # a student does not read it
    kept.update(
        agent=options.algorithm, steps=schedule.total, evaluate_every=schedule.evaluate_every,
        precision=reward.precision, smoothness=reward.smoothness, lags=_lags(options),
        residual_scale=_residual_scale(options),
    )  # fmt: skip
    if name == STUDENT and options.student.lstm_hidden is None:
        kept[STUDENT].pop("lstm_hidden")
    if name == STUDENT and options.student.features == STUDENT_FEATURES[0]:
        kept[STUDENT].pop("features")
    return dict(json.loads(json.dumps(kept, default=str)))


def _driven(env: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Drive and vehicle, written out: an archive is read where the id may not be registered."""
    usual = {name: EnvConfig._field_defaults[name] for name in Driven._fields}
    return {**usual, **driven(env, arguments)}


def resolve(options: Options) -> Run:
    """The training that options describe.

    Raises ValueError, for options without effect too, and errors of gymnasium.
    """
    check_read(options)
    name, algorithm, settings = _algorithm(options)
    arguments = environment_arguments(options)
    augmentation = _augmentation(options)
    groups = groups_in(layout_of(options.env, arguments))
    recipe = {
        "algorithm": ALGORITHMS[options.algorithm].network,
        "augmentation": augmentation.kind,
        "augmentation_options": augmentation.options,
        "observation": groups,
        "control_period": control_period(options.env, arguments),
        "environment": {"id": options.env, **_driven(options.env, arguments), **arguments},
        "config": configuration(options),
        "versions": versions(),
        "machine": machine(),
        "command": shlex.join(["python", *sys.argv]),
    }
    return Run(
        name=name,
        algorithm=algorithm,
        settings=settings,
        seed=random_seed(options.seed),
        env=options.env,
        arguments=arguments,
        groups=groups,
        parts=parts_of(options.env, arguments, options.vehicles),
        held_out=parts_of(options.env, arguments, options.held_out) if options.held_out else (),
        staggered=options.staggered,
        augmentation=augmentation,
        reward=_reward(options),
        normalise=options.normalise,
        schedule=_schedule(options, algorithm),
        teacher=options.teacher,
        trust=options.trust,
        folder=options.folder,
        tensorboard=options.tensorboard,
        recipe=recipe,
    )
