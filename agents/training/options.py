"""The options of train.py: one dataclass, whose docstrings are its help."""

from dataclasses import dataclass, field, make_dataclass
from dataclasses import fields as dataclass_fields
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, cast, get_args, get_origin

import gymnasium
import tyro.conf
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
)

from agents.algorithms import ALGORITHMS
from agents.algorithms.settings import check
from agents.algorithms.student import StudentSettings
from baselines.learned.recipe import STUDENT
from tracked_env import TORQUE_ID

DEFAULT = "ppo"  # the algorithm where --agent is not given


def folder_of(text: str) -> Path:
    """A folder that the command line names. Raises ValueError for an empty name."""
    if not text.strip():
        raise ValueError("--output is empty; name a folder, or `.` for the working directory")
    return Path(text)


Folder = Annotated[
    Path,
    PrimitiveConstructorSpec(
        1, "PATH", lambda words: folder_of(words[0]), lambda given: isinstance(given, Path),
        lambda given: [str(given)],
    ),
]  # fmt: skip


@dataclass(frozen=True)
class Options:
    """Agent, environment and folder of a training."""

    agent: str | None = None
    """Algorithm, by default ppo; its settings are the options that start with its name."""

    augmentation: Literal[
        "blind", "history", "reckoned", "estimates", "residual", "teacher", "student"
    ] = "blind"  # fmt: skip
    """Observation augmentation: inputs besides the present observation.
    blind: none (recurrent-ppo remembers by itself).
    history: past samples. reckoned: the pose error by dead reckoning.
    estimates: the identified parameters. residual: corrects the action of BASE.
    teacher: the true parameters. student: drives with TEACHER's network,
    and infers the true parameters from past samples."""

    teacher: Path | None = None
    """Of augmentation student: agent.zip of the teacher."""

    trust: bool = False
    """Open a teacher of a former version too. It is unpickled, which runs any
    code that its author put there: only for authors whom you trust."""

    steps: int | None = None
    """Environment steps, over all vehicles. Default:
    2 000 000 for PPO, 1 000 000 for recurrent PPO,
    300 000 for agents with a replay buffer,
    500 000 for a student."""

    seed: int = 0
    """Of the networks and of the vehicles: same seed, same machine, same agent.
    Trainings with different seeds share no episode."""

    vehicles: int = 64
    """Vehicles stepped together."""

    env: str = TORQUE_ID
    """Id of the environment, with or without `tracked_env/`."""

    uncertainty: tuple[str, ...] | None = None
    """Uncertainty sets to train on (default: that of ENV), or `mixture` for all that
    the benchmark calls in distribution; of several, every episode draws one."""

    sensors: tuple[str, ...] | None = None
    """Sensor presets ideal, rtk, strawa or mocap, or JSON overrides:
    '{"preset": "rtk", "pose_delay": 0.1}'; of several, each gets its part of
    the vehicles. `mixture`: rtk; rtk 0.2 s late; strawa; rtk without velocity;
    rtk-outages; rtk with one pose a second (on Speed-v0 and Terrain-v0: mocap;
    mocap 0.1 s late; mocap with noise of 5 cm; mocap without velocity; mocap-outages;
    mocap with one pose a second)."""

    reference: str | None = None
    """Kind of reference to follow, or JSON."""

    duration: float = 30.0
    """Length of an episode [s]."""

    staggered: bool = True
    """First episodes end at different times: otherwise all vehicles are at the same
    time of their episodes for the whole training."""

    lateral: Literal["sliding", "constrained"] = "sliding"
    """Lateral model of the lumped plant."""

    env_args: str | None = None
    """Further arguments of the environment, as JSON:
    '{"plant": "distributed"}'."""

    output: Folder | None = None
    """Folder of the training. Default:
    runs/AGENT-AUGMENTATION-seedSEED, and of another id, as Speed-v0,
    runs/Speed-v0/AGENT-AUGMENTATION-seedSEED."""

    resume: bool = False
    """Go on from the last checkpoint in OUTPUT; starts
    where there is none, does nothing where it is finished."""

    overwrite: bool = False
    """Train anew, though OUTPUT holds a training: its files are deleted."""

    evaluate_every: int | None = None
    """Steps between evaluations on held-out episodes;
    default is a tenth of all."""

    held_out: int = 64
    """Held-out episodes; 0 evaluates never and keeps the last agent."""

    checkpoint_every: int | None = None
    """Steps between checkpoints; default is every rollout,
    or 20 000 for students and agents with a replay buffer."""

    normalise: bool = False
    """Normalise the inputs of the network by their running mean and
    deviation. They are of order one already."""

    precision: float | None = None
    """Distance of an additional reward term, steeper near the path, in training only,
    over the contact length; 0 leaves it out. Default: 0.075."""

    smoothness: float | None = None
    """Weight of the action-rate penalty, the mean square of the change of the action per
    control step, in training only; 0 leaves it out. Default: 1 for PPO, 0 for agents with
    a replay buffer, which hardly learn with it."""

    lags: tuple[int, ...] | None = None
    """Of augmentation history and student: ages of the samples [control steps].
    Default: 1 2 4 8 16 32."""

    residual_scale: float | None = None
    """Of augmentation residual: largest correction, over the torque limit. Default: 0.3."""

    base: str | None = None
    """Of augmentation residual: the policy that the agent corrects, adaptive or mpc-adaptive, on
    vehicles driven by torque. Default: adaptive."""

    data_sheet: bool = False
    """Show the agent the noise of its sensors, which the controllers know as well: it tells
    sensors apart that a single sample does not. Of every augmentation but teacher."""

    tensorboard: bool = False
    """Also write TensorBoard logs to OUTPUT."""

    threads: int = 1
    """Threads of PyTorch; one is often faster than two for networks of this size."""

    quiet: bool = False
    """Show no progress bar."""

    student: StudentSettings = field(default_factory=StudentSettings)
    """Settings of augmentation student."""

    def __post_init__(self) -> None:
        ours = f"tracked_env/{self.env}"
        if self.env not in gymnasium.registry and ours in gymnasium.registry:
            object.__setattr__(self, "env", ours)
        check(self)
        if self.agent is not None and self.agent not in ALGORITHMS:
            known = ", ".join(ALGORITHMS)
            raise ValueError(f"agent = {self.agent!r}; must be one of {known}")
        if self.teacher is not None and self.augmentation != STUDENT:
            raise ValueError(
                f"only a student has a teacher, but teacher = {self.teacher} with augmentation "
                f"{self.augmentation}. Did you mean --augmentation student?"
            )
        if self.augmentation == STUDENT:
            self._check_student()

    def _check_student(self) -> None:
        """Raises ValueError for options that the training of a student would not read."""
        given = {
            "agent": self.agent is not None, "normalise": self.normalise,
            "precision": self.precision is not None, "smoothness": self.smoothness is not None,
            "staggered": not self.staggered, "tensorboard": self.tensorboard,
        }  # fmt: skip
        for name in (name for name, is_given in given.items() if is_given):
            value = getattr(self, name.replace("-", "_"))
            raise ValueError(
                f"{name} = {value} with augmentation student; must be left out: a student has the "
                "algorithm, the network and the normalisation of its teacher, and learns by "
                f"regression, without rewards. Was --{name} meant for the teacher?"
            )

    @property
    def algorithm(self) -> str:
        """Name of the algorithm: `agent`, or the default one."""
        return DEFAULT if self.agent is None else self.agent

    @property
    def folder(self) -> Path:
        """Where everything goes."""
        track = "" if self.env == TORQUE_ID else self.env.rpartition("/")[2]
        name = f"{self.algorithm}-{self.augmentation}-seed{self.seed}"
        return self.output or Path("runs", track, name)


WORDS: dict[Any, str] = {int: "INTEGER", float: "NUMBER", str: "TEXT", Path: "PATH", Folder: "PATH"}

# Names the types of all options by these words too, where they may not be left out.
REGISTRY = ConstructorRegistry()


def _by_words(kind: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    of: Any = kind.type
    if of not in (int, float, str):
        return None
    return PrimitiveConstructorSpec(
        1, WORDS[of], lambda words: of(words[0]),
        lambda given: isinstance(given, of) or (of is float and isinstance(given, int)),
        lambda given: [str(given)],
    )  # fmt: skip


REGISTRY.primitive_rule(_by_words)


def in_words(kind: Any) -> Any:
    """A type of an option that may be left out, so that the help names it by a word."""
    parts = [part for part in get_args(kind) if part is not NoneType]
    if get_origin(kind) is Annotated or len(parts) != 1 or NoneType not in get_args(kind):
        return kind
    (part,) = parts
    if get_origin(part) is Literal:
        word = "{" + ",".join(get_args(part)) + "}"
    elif get_origin(part) is tuple:
        word = WORDS[get_args(part)[0]]
        word = f"{word} [{word} ...]"
    else:
        word = WORDS[part]
    return Annotated[kind, tyro.conf.arg(metavar=word)]


def options_of_train() -> type[Options]:
    """`Options` with a choice of, and the settings of, every algorithm that is registered now.

    Raises ValueError for an algorithm that is called like another option.
    """
    taken = {option.name for option in dataclass_fields(Options)}
    for name in ALGORITHMS:
        if name.replace("-", "_") in taken:
            raise ValueError(f"algorithm {name!r}: --{name} is another option; rename it")
    choice: Any = Literal[tuple(ALGORITHMS)]
    fields = [("agent", choice | None, None)]
    fields += [
        (name.replace("-", "_"), of.settings, field(default_factory=of.settings))
        for name, of in ALGORITHMS.items()
    ]
    made = make_dataclass("Config", fields, bases=(Options,), frozen=True)
    made.__doc__ = Options.__doc__
    return cast(type[Options], made)
