"""A trained agent as one file: the archive of Stable-Baselines3 with the agent's recipe in it.

`recipe.json` inside the archive says what surrounds the network: algorithm, kind of memory and
its options, normalisation, control period; and how the agent came about: configuration, steps,
seconds, versions, machine, command. An archive without it, from `model.save` of any of the
algorithms on the plain environment, is loaded as a blind agent, with a notice.

Loading unpickles what SB3 has pickled: open only archives that you trust.
"""

import hashlib
import io
import json
import shlex
import sys
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from agents import memory
from agents.algorithms import ALGORITHMS
from agents.environment import control_period, driven
from agents.inference import STUDENT, load_student
from agents.policy import AgentPolicy, Normalisation, Predictor
from agents.privileged import PRIVILEGED, TEACHER, TeacherPolicy, policy_of
from tracked_env import TORQUE_ID
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyContext, PolicyEntry
from tracked_env.benchmark.policy_interface import source_fingerprint
from tracked_env.benchmark.store import machine, versions, write_atomically

RECIPE = "recipe.json"
OPTIMISER = "optimizer.pth"  # how the entries of optimisers end
FORMAT = 1  # of the recipe
_NEEDED = ("format", "algorithm", "memory", "memory_options", "normalisation", "control_period")
# Files whose code is around every network; a change of one may change what an agent does.
_AROUND = ("memory.py", "policy.py", "slip_memory.py", "held.py", "recurrent.py", "loading.py")
# Order in which an archive without a recipe is tried: who is the pickiest comes first.
_TRIED = ("recurrent-ppo", "tqc", "sac", "td3", "ppo")


def exact(config: Any) -> dict[str, Any]:
    """A configuration of train.py as JSON knows it, settings of the other algorithms left out."""
    student = config.memory == STUDENT
    others = {name.replace("-", "_") for name in ALGORITHMS} | {STUDENT}
    others -= {STUDENT if student else config.agent.replace("-", "_")}
    kept = {name: value for name, value in asdict(config).items() if name not in others}
    kept["smoothness"] = config.change_price
    kept["steps"], kept["evaluate_every"] = config.total_steps, config.evaluation_interval
    return dict(json.loads(json.dumps(kept, default=str)))


def recipe_of(config: Any, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """What every archive of a training of train.py says of itself."""
    return {
        "algorithm": config.agent,
        "memory": config.memory,
        "memory_options": config.memory_options,
        "control_period": control_period(config.env, arguments),
        "environment": {"id": config.env, **arguments},
        "config": exact(config),
        "versions": versions(),
        "machine": machine(),
        "command": shlex.join(["python", *sys.argv]),
    }


def save_agent(
    path: Path,
    model: BaseAlgorithm,
    recipe: Mapping[str, Any],
    files: Mapping[str, bytes] | None = None,
) -> None:
    """Write model, recipe and further files as one archive without moments, whole or not at all."""
    buffer = io.BytesIO()
    model.save(buffer)
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.writestr(RECIPE, json.dumps({"format": FORMAT, **recipe}, indent=1))
        for name, content in (files or {}).items():
            archive.writestr(name, content)
    write_atomically(path, without_moments(buffer.getvalue()))


def without_moments(archive: bytes) -> bytes:
    """An archive of Stable-Baselines3, compressed, its optimisers as fresh ones.

    Their moments of gradients are two thirds of it, and only the next gradient step needs them:
    `load` and `learn` work without. A training that goes on has them in its checkpoint.
    """
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(archive)) as given,
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as kept,
    ):
        for name in given.namelist():
            content = given.read(name)
            if name.endswith(OPTIMISER):
                state = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
                fresh = io.BytesIO()
                torch.save({**state, "state": {}}, fresh)
                content = fresh.getvalue()
            kept.writestr(name, content)
    return buffer.getvalue()


def read_recipe(path: Path) -> dict[str, Any] | None:
    """The recipe in an archive, None where there is none.

    Raises ValueError for a missing or damaged file, and for a recipe of another format.
    """
    if not path.is_file():
        raise ValueError(f"agent {path}: no such file. Was it trained with another --output?")
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
            names = archive.namelist()
            if damaged is None and RECIPE not in names and "data" in names:
                return None
            recipe = json.loads(archive.read(RECIPE)) if damaged is None else {}
    except (zipfile.BadZipFile, OSError, KeyError, EOFError, ValueError) as error:
        raise ValueError(
            f"agent {path} cannot be loaded: not an archive of an agent, or damaged ({error})"
        ) from error
    if damaged is not None:
        raise ValueError(f"agent {path} cannot be loaded: {damaged} in it is damaged")
    if not isinstance(recipe, dict) or recipe.get("format") != FORMAT:
        raise ValueError(
            f"agent {path} has a recipe of another format; must be {FORMAT}. Is it of another "
            "version of this project?"
        )
    missing = [name for name in _NEEDED if name not in recipe]
    if missing or recipe["algorithm"] not in ALGORITHMS:
        raise ValueError(
            f"agent {path}: its recipe lacks {missing} or names an algorithm that is none of "
            f"{', '.join(ALGORITHMS)}"
        )
    return recipe


def load_model(path: Path, algorithms: tuple[str, ...]) -> BaseAlgorithm:
    """The model in an archive, of the first of `algorithms` that can load it. ValueError if none"""
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


def normalisation_of(recipe: Mapping[str, Any]) -> Normalisation | None:
    """The running normalisation that a recipe holds."""
    stored = recipe["normalisation"]
    if stored is None:
        return None
    return Normalisation(
        np.array(stored["mean"]), np.array(stored["variance"]), stored["epsilon"], stored["clip"]
    )


def load_teacher(path: Path | None) -> tuple[BaseAlgorithm, dict[str, Any]]:
    """Model and recipe of a teacher. Raises ValueError where there is none."""
    if path is None:
        raise ValueError("a student needs --teacher, an agent.zip of --memory teacher")
    recipe = read_recipe(path)
    if recipe is None or recipe["memory"] != TEACHER:
        kind = "blind" if recipe is None else recipe["memory"]
        raise ValueError(f"agent {path} has memory {kind!r}; a student needs a teacher")
    agent_entry(path)  # checks what it sees
    return load_model(path, (recipe["algorithm"],)), recipe


def agent_name(path: Path) -> str:
    """What tables call an agent: its file, or the folder of a file that train.py has named."""
    return path.resolve().parent.name if path.stem in ("agent", "last") else path.stem


def _fingerprint(path: Path, kind: str) -> str:
    """Digest of the archive and of the code around its network."""
    digest = hashlib.sha256(path.read_bytes())
    for file in _AROUND:
        digest.update(Path(memory.__file__).with_name(file).read_bytes())
    if kind in (TEACHER, STUDENT):
        for file in ("privileged.py", "inference.py"):
            digest.update(Path(memory.__file__).with_name(file).read_bytes())
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


def agent_entry(path: Path) -> PolicyEntry:
    """A trained agent as a policy of the benchmark.

    Raises ValueError for a missing, damaged or foreign file, and for an agent that sees or does
    something else than this environment offers.
    """
    path = Path(path)
    recipe = read_recipe(path)
    plain = recipe is None
    if recipe is None:
        recipe = _plain_recipe(path)
    model = load_model(path, _TRIED if plain else (recipe["algorithm"],))
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
        driver = load_student(path, options, model, normalisation)
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
