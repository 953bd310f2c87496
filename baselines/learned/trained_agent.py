"""A trained agent as a policy, from the archive that its training has written.

    policy = open_agent(Path("runs/ppo-blind-seed0/agent.zip")).make(context)
Nothing of the library that trained it is needed.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from baselines.batch_policy import Context
from baselines.estimators.measurement import DataSheet
from baselines.learned.agent_archive import (
    INFERENCE,
    PICKLED,
    STUDENT,
    WEIGHTS,
    Driven,
    driven,
    from_npz,
    groups_of,
    normalisation_of,
    read_entry,
    read_recipe,
    untrusted,
)
from baselines.learned.agent_policy import (
    PRIVILEGED,
    TEACHER,
    Actor,
    AgentPolicy,
    Groups,
    Normalisation,
    Predictor,
    TeacherPolicy,
    policy_of,
)
from baselines.learned.augmentation import make_augmentation
from baselines.learned.student import features_of, read_recurrent_student, read_student, widened_by
from tracked_env import observation as layout

HERE = Path(__file__).resolve().parent


class TrainedAgent(NamedTuple):
    """An archive that has been opened."""

    make: Callable[[Context], AgentPolicy | TeacherPolicy]  # a fresh policy for an environment
    sources: tuple[Path, ...]  # folders whose code its actions depend on, besides the archive


def open_agent(path: Path) -> TrainedAgent:
    """A trained agent.

    Raises ValueError for a missing, damaged or foreign file, for one that holds pickled objects,
    and for an agent that sees something else than this project's environments offer.
    """
    path = Path(path)
    recipe = read_recipe(path)
    if recipe is None:
        raise ValueError(untrusted(path, "has no recipe of train.py"))
    if recipe["format"] == PICKLED:
        raise ValueError(untrusted(path, "is of a former version of train.py"))
    try:
        weights = from_npz(read_entry(path, WEIGHTS), WEIGHTS)
        actor = Actor(recipe["algorithm"], recipe["network"], weights)
    except ValueError as error:
        raise ValueError(f"agent {path} cannot be loaded: {error}") from error
    return agent_of(path, recipe, actor, (recipe["network"]["inputs"],))


def agent_of(
    path: Path, recipe: Mapping[str, Any], model: Predictor, shown: tuple[int, ...] | None
) -> TrainedAgent:
    """The agent with this checked recipe and network, which sees inputs of the shape `shown`.

    Raises ValueError for a network that sees something else, and for a damaged student.
    """
    kind, options = recipe["augmentation"], recipe["augmentation_options"]
    known = driven(recipe)
    groups = groups_of(recipe)
    observed = sum(map(len, groups.values()))
    expected = (observed + _features(kind, options, known),)
    if shown != expected:
        raise ValueError(
            f"agent {path} sees {shown}; must see {expected} (augmentation {kind!r}). Was it "
            "trained on another environment, or inside a wrapper? Then pass it as module:function."
        )
    normalisation = normalisation_of(recipe)
    if kind == STUDENT:
        try:
            content = read_entry(path, INFERENCE)
            model = _student(content, options, known, model, normalisation, groups)
        except ValueError as error:
            raise ValueError(f"agent {path} cannot be loaded as a student: {error}") from error
        (kind, options), normalisation = widened_by(options), None

    def make(context: Context) -> AgentPolicy | TeacherPolicy:
        period = recipe["control_period"]
        if abs(period - context.control_period) > 1e-9:
            raise ValueError(
                f"agent {path} was trained with a control period of {period:g} s; this "
                f"environment has {context.control_period:g} s"
            )
        if context.drive != known.drive:
            raise ValueError(
                f"agent {path} was trained to command each sprocket's {known.drive}; this "
                f"environment takes its {context.drive}"
            )
        try:
            return policy_of(model, kind, options, context, normalisation, groups)
        except ValueError as error:
            raise ValueError(f"agent {path}: {error}") from error

    whole = kind in ("estimates", "residual")  # estimators and controllers too
    return TrainedAgent(make, (HERE.parent if whole else HERE,))


def _student(
    content: bytes, options: Mapping[str, Any], known: Driven, teacher: Predictor,
    scaling: Normalisation | None, groups: Groups,
) -> Predictor:  # fmt: skip
    """The student in an archive, with or without an LSTM. Raises ValueError."""
    names = [field for of_group in groups.values() for field in of_group]
    if "lstm_hidden" not in options:
        return read_student(content, options, teacher, scaling, len(names))
    features_of(options, known.drive)  # refuses some
    inputs = len(names) + _features(*widened_by(options), known)
    return read_recurrent_student(content, options, inputs, teacher, scaling, names)


class _Nominal(NamedTuple):
    """A context that names the features of an augmentation."""

    drive: str
    vehicle: str
    control_period: float = 0.02
    lateral: str = "sliding"
    sensors: Any = DataSheet()
    observation: Sequence[str] = layout.NAMES


def _features(kind: str, options: Mapping[str, Any], known: Driven) -> int:
    """Number of features that an agent of this kind sees besides the observation."""
    if kind in (TEACHER, STUDENT):  # a student hands them to its teacher's network
        return len(PRIVILEGED)
    return len(make_augmentation(kind, options, _Nominal(*known), 1).feature_names)
