"""The arguments of the environment of a training, from the options of train.py.

Several entries of `sensors` are a list; each gets its part of the vehicles
(`agents.vector_envs`) and of the held-out episodes.

The options of train.py: one dataclass, whose docstrings are its help.

Options of train.py that the training asked for would not read: refused where they are given.

Settings belong to the algorithm whose name they begin with, a few options to an augmentation.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from dataclasses import fields as dataclass_fields
from itertools import accumulate
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, cast, get_args, get_origin

import gymnasium
import tyro.conf
from gymnasium.envs.registration import load_env_creator
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from agents.algorithms import ALGORITHMS, StudentSettings, check
from agents.vector_envs import shares
from baselines.learned.agent_archive import STUDENT
from baselines.learned.agent_policy import STUDENT_FEATURES
from baselines.learned.augmentation import KINDS
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import PolicyContext
from tracked_env.engine.env_config import SHOWN, EnvConfig, make_solver
from tracked_env.observation import Layout, make_layout
from tracked_env.sensors import make_sensors
from tracked_env.validation import checked_keys, name_or_json
from tracked_env.vector_env import TrackedVehicleVectorEnv

if TYPE_CHECKING:
    pass

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


# Options that only some kinds of augmentation have, see `agents.options`.
_OF_AUGMENTATION = {
    "lags": ("history", STUDENT), "residual_scale": ("residual",), "base": ("residual",),
    "trust": (STUDENT,), "data_sheet": (*KINDS, STUDENT),
}  # fmt: skip
_RENAMED = {"--memory": "--augmentation"}  # former names of options


def _refuse_setting(option: str, name: str, options: Options) -> None:
    """Raises ValueError for a setting of `name` where something else learns."""
    chosen = STUDENT if options.augmentation == STUDENT else options.algorithm
    if name == chosen:
        return
    instead = f"--augmentation {STUDENT}" if name == STUDENT else f"--agent {name}"
    learns = "a student, which has the network of its teacher" if chosen == STUDENT else chosen
    raise ValueError(
        f"--{option} has no effect: it is a setting of {name}, and what learns is {learns}. Give "
        f"{instead}, or leave it out"
    )


def _changed(settings: Any) -> Iterator[str]:
    """Names of the settings that have another value than by default."""
    usual = type(settings)()
    for setting in fields(settings):
        if getattr(settings, setting.name) != getattr(usual, setting.name):
            yield setting.name.replace("_", "-")


def check_read(options: Options) -> None:
    """Raises ValueError for an option that has another value than by default, and no effect."""
    for option, kinds in _OF_AUGMENTATION.items():
        value = getattr(options, option)
        if value not in (None, False) and options.augmentation not in kinds:
            raise ValueError(
                f"--{option.replace('_', '-')} has no effect with augmentation "
                f"{options.augmentation}: it is an option of augmentation {' and '.join(kinds)}. "
                f"Give --augmentation {kinds[0]}, or leave it out"
            )
    if options.lags is not None and options.student.lstm_hidden is not None:
        raise ValueError(
            f"--lags has no effect with --student.lstm-hidden {options.student.lstm_hidden}: that "
            f"student sees {options.student.features} instead of past samples. Leave one of them "
            "out"
        )
    if options.student.features != STUDENT_FEATURES[0] and options.student.lstm_hidden is None:
        raise ValueError(
            f"--student.features {options.student.features} has no effect without an LSTM: that "
            "student sees past samples. Give --student.lstm-hidden 64 too, or leave it out"
        )
    for name in (*ALGORITHMS, STUDENT):
        for setting in _changed(getattr(options, name.replace("-", "_"))):
            _refuse_setting(f"{name}.{setting}", name, options)


def check_given(arguments: Sequence[str], options: Options) -> None:
    """Raises ValueError for a setting on the command line that has no effect, default or not."""
    for word in arguments:
        name, dot, setting = word.removeprefix("--").partition("=")[0].partition(".")
        name = name.replace("_", "-")
        if word.startswith("--") and dot and (name in ALGORITHMS or name == STUDENT):
            _refuse_setting(f"{name}.{setting}", name, options)


def check_names(arguments: Sequence[str]) -> None:
    """Raises ValueError for an option by a former name, and says the one of today."""
    for word in arguments:
        former, _, _ = word.partition("=")
        if former in _RENAMED:
            raise ValueError(f"{former} is called {_RENAMED[former]} now, with the same values")
