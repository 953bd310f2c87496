"""A trained agent as a policy of the benchmark, from its archive.

Archives of train.py are plain data (`agents.archive`). Those of `model.save` of
Stable-Baselines3, and of train.py of the version before, hold pickled objects: opening one runs
whatever its author put there, so it takes `trust`. One without a recipe, of any of the algorithms
on the plain environment, is loaded as a blind agent, with a notice.
"""

import hashlib
import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm

from agents import memory
from agents.algorithms import ALGORITHMS
from agents.archive import (
    PICKLED,
    load_network,
    normalisation_of,
    read_entry,
    read_recipe,
    untrusted,
)
from agents.inference import STUDENT, WEIGHTS, load_student
from agents.policy import AgentPolicy, Predictor
from agents.privileged import PRIVILEGED, TEACHER, TeacherPolicy, policy_of
from agents.training.arguments import driven
from tracked_env import TORQUE_ID
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyContext, PolicyEntry
from tracked_env.benchmark.policy_interface import source_fingerprint

PACKAGE = Path(__file__).parent
# Files of this package that no action of a trained agent depends on; all others are in its
# fingerprint. Each with the reason.
WITHOUT_INFLUENCE = {
    "algorithms/": "settings of trainings; an archive holds the network that came of them",
    "ending.py": "how commands end early",
    "training/": "how agents are trained; they drive by the files around it",
}
# Order in which an archive without a recipe is tried: who is the pickiest comes first.
_TRIED = ("recurrent-ppo", "tqc", "sac", "td3", "ppo")


def unpickled(path: Path, algorithms: tuple[str, ...]) -> BaseAlgorithm:
    """The model in an archive of Stable-Baselines3, of the first of `algorithms` that can load it.

    Runs whatever code is in the archive. Raises ValueError where none can.
    """
    errors = []
    for name in algorithms:
        with warnings.catch_warnings():
            # SB3 restores the class of the buffer that it has chosen itself, then warns of it.
            ignored = r"`n_steps=\d+` is ignored because a custom `replay_buffer_class`"
            warnings.filterwarnings("ignore", ignored, UserWarning)
            try:
                return ALGORITHMS[name][0].load(path, device="cpu")
            except Exception as error:  # SB3 raises what happens to go wrong
                errors.append(f"{name}: {type(error).__name__}: {str(error)[:200]}")
    raise ValueError(f"agent {path} cannot be loaded as {'; '.join(errors)}")


def load_predictor(path: Path, recipe: Mapping[str, Any] | None, trust: bool) -> Any:
    """What acts in an archive: a policy of Stable-Baselines3, or a whole model of it.

    recipe: of `read_recipe`. Raises ValueError, also for a pickled one without `trust`.
    """
    if recipe is None:
        if not trust:
            raise ValueError(untrusted(path, "has no recipe of train.py"))
        return unpickled(path, _TRIED)
    if recipe["format"] == PICKLED and trust:
        return unpickled(path, (recipe["algorithm"],)).policy
    return load_network(path, recipe)


def load_teacher(path: Path | None, trust: bool = False) -> tuple[Any, dict[str, Any]]:
    """Network and recipe of a teacher; trust: as `agent_entry`. Raises ValueError."""
    if path is None:
        raise ValueError("a student needs --teacher, an agent.zip of --memory teacher")
    recipe = read_recipe(path)
    if recipe is None or recipe["memory"] != TEACHER:
        kind = "blind" if recipe is None else recipe["memory"]
        raise ValueError(f"agent {path} has memory {kind!r}; a student needs a teacher")
    agent_entry(path, trust)  # checks what it sees
    return load_predictor(path, recipe, trust), recipe


def agent_name(path: Path) -> str:
    """What tables call an agent: its file, or the folder of a file that train.py has named."""
    return path.resolve().parent.name if path.stem in ("agent", "last") else path.stem


def code_around(package: Path) -> list[Path]:
    """The files of this package that an agent's action may depend on, relative to it."""
    files = sorted(file.relative_to(package) for file in package.rglob("*.py"))
    left_out = tuple(WITHOUT_INFLUENCE)
    return [file for file in files if not file.as_posix().startswith(left_out)]


def _fingerprint(path: Path, kind: str) -> str:
    """Digest of the archive and of the code around its network."""
    digest = hashlib.sha256(path.read_bytes())
    for file in code_around(PACKAGE):
        content = (PACKAGE / file).read_bytes()
        digest.update(f"{file.as_posix()} {len(content)}\n".encode() + content)
    if kind in ("estimates", "residual"):
        digest.update(source_fingerprint("baselines").encode())
    return digest.hexdigest()[:12]


def _plain_recipe(path: Path) -> dict[str, Any]:
    """What is taken for the recipe of an archive without one; says so on stderr.

    Raises ValueError where the statistics of a normalisation lie beside it.
    """
    for beside in sorted(path.parent.glob("*.pkl")):
        if "normal" in beside.name.lower():
            raise ValueError(
                f"agent {path} has no recipe, and {beside.name} beside it looks like a "
                "normalisation (VecNormalize), which would not be applied. Train with train.py "
                "--normalise, which puts it into the archive, or pass a policy that normalises "
                "as module:attribute"
            )
    print(
        f"agent {path} has no recipe of train.py: taken as a blind agent, observations not "
        "normalised",
        file=sys.stderr,
    )
    return {"memory": "blind", "memory_options": {}, "normalisation": None}


def agent_entry(path: Path, trust: bool = False) -> PolicyEntry:
    """A trained agent as a policy of the benchmark.

    trust: open an archive that holds pickled objects too, which runs its author's code.
    Raises ValueError for a missing, damaged or foreign file, and for an agent that sees or does
    something else than this environment offers.
    """
    path = Path(path)
    recipe = read_recipe(path)
    plain = recipe is None
    model = load_predictor(path, recipe, trust)
    if recipe is None:
        recipe = _plain_recipe(path)
    kind, options = recipe["memory"], recipe["memory_options"]
    normalisation = normalisation_of(recipe)
    shown = getattr(model.observation_space, "shape", None)
    arguments = recipe.get("environment", {})
    known = driven(arguments.get("id", TORQUE_ID), arguments)
    context = PolicyContext(recipe.get("control_period", 0.02), "sliding", **known)
    names = PRIVILEGED  # which a student hands to its teacher's network
    if kind not in (TEACHER, STUDENT):
        names = memory.make_memory(kind, options, context, 1).feature_names
    expected = (layout.SIZE + len(names),)
    if shown != expected or getattr(model.action_space, "shape", None) != (2,):
        raise ValueError(
            f"agent {path} sees {shown} and acts {model.action_space}; must see {expected} "
            f"(memory {kind!r}) and act (2,). Was it trained on another environment, or inside "
            "a wrapper? Then pass it as module:function."
        )

    driver: Predictor = model
    if kind == STUDENT:
        try:
            driver = load_student(read_entry(path, WEIGHTS), options, model, normalisation)
        except ValueError as error:
            raise ValueError(f"agent {path} cannot be loaded as a student: {error}") from error
        kind, options, normalisation = "history", {"lags": options["lags"]}, None

    def make(context: PolicyContext) -> AgentPolicy | TeacherPolicy:
        period = recipe.get("control_period")
        if period is not None and abs(period - context.control_period) > 1e-9:
            raise ValueError(
                f"agent {path} was trained with a control period of {period:g} s; this "
                f"environment has {context.control_period:g} s"
            )
        if not plain and context.drive != known.get("drive", "torque"):
            raise ValueError(
                f"agent {path} was trained to command each sprocket's "
                f"{known.get('drive', 'torque')}; this environment takes its {context.drive}"
            )
        return policy_of(driver, kind, options, context, normalisation)

    return PolicyEntry(agent_name(path), make, _fingerprint(path, recipe["memory"]))
