"""What an archive of train.py says of its training, and archives of strangers as policies.

Archives of train.py are plain data and need neither PyTorch nor this package
(`baselines.learned.trained_agent`). Those of `model.save` of Stable-Baselines3, and of train.py of
the version before, hold pickled objects: opening one runs whatever its author put there, so it
takes `trust`. One without a recipe, of any of the algorithms on the plain environment, is loaded as
a blind agent, with a notice.
"""

import sys
import warnings
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm

from agents.algorithms import ALGORITHMS
from agents.archive import load_network
from baselines.learned.agent_archive import read_recipe
from baselines.learned.agent_policy import AgentPolicy, TeacherPolicy, policy_of
from baselines.learned.privileged_inputs import TEACHER
from baselines.learned.recipe import PICKLED
from baselines.learned.trained_agent import TrainedAgent, agent_of, open_agent
from baselines.registry import Context
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyEntry
from tracked_env.benchmark.policy_lookup import archive_entry

PACKAGE = Path(__file__).resolve().parent
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


def load_teacher(path: Path | None, trust: bool = False) -> tuple[Any, dict[str, Any]]:
    """Network and recipe of a teacher, to learn from; trust: as `open_trusted`.

    Raises ValueError.
    """
    if path is None:
        raise ValueError("a student needs --teacher, an agent.zip of --augmentation teacher")
    recipe = read_recipe(path)
    if recipe is None or recipe["augmentation"] != TEACHER:
        kind = "blind" if recipe is None else recipe["augmentation"]
        raise ValueError(f"agent {path} has augmentation {kind!r}; a student needs a teacher")
    agent_entry(path, trust)  # checks what it sees
    if recipe["format"] == PICKLED:
        return unpickled(path, (recipe["algorithm"],)).policy, recipe
    return load_network(path, recipe), recipe


def _check_plain(path: Path) -> None:
    """Say on stderr what an archive without a recipe is taken for.

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


def open_trusted(path: Path) -> TrainedAgent:
    """An agent in an archive of train.py, or in one that may hold pickled objects.

    Opening the latter runs any code of its author. Raises ValueError for a missing, damaged or
    foreign file, and for an agent that sees or does something else than this environment offers.
    """
    path = Path(path)
    recipe = read_recipe(path)
    if recipe is not None and recipe["format"] != PICKLED:
        return open_agent(path)
    algorithms = _TRIED if recipe is None else (recipe["algorithm"],)
    model = unpickled(path, algorithms).policy
    shown = getattr(model.observation_space, "shape", None)
    if recipe is not None:
        opened = agent_of(path, recipe, model, shown)
        return opened._replace(sources=(*opened.sources, PACKAGE))
    if shown != (layout.SIZE,) or getattr(model.action_space, "shape", None) != (2,):
        raise ValueError(
            f"agent {path} sees {shown} and acts {model.action_space}; must see ({layout.SIZE},) "
            "and act (2,). Was it trained on another environment, or inside a wrapper? Then pass "
            "it as module:function."
        )
    _check_plain(path)

    def make(context: Context) -> AgentPolicy | TeacherPolicy:
        return policy_of(model, "blind", {}, context)

    return TrainedAgent(make, (PACKAGE, PACKAGE.parent / "baselines" / "learned"))


def agent_entry(path: Path, trust: bool = False) -> PolicyEntry:
    """A trained agent as a policy of the benchmark.

    trust: open an archive that holds pickled objects too, as `open_trusted`. Raises ValueError.
    """
    return archive_entry(Path(path), open_trusted if trust else open_agent)
