"""What a policy is to the benchmark.

A policy is any object with the `predict` of Stable-Baselines3:
    action, state = predict(observation, state=None, episode_start=None, deterministic=True)
with observation (N, D) float32, episode_start (N,) bool, action (N, 2) in [-1, 1]. `state` is
handed back unchanged at the next call; what it holds is the policy's business.

A policy that declares `needs_truth = True` gets, before each `predict`, the true state and
parameters through `observe_truth(truth)`, {name: (N,)}. No other policy ever sees them.

A policy that identifies parameters may say what it believes; the benchmark asks after each
`predict` and compares with the truth (see `identification_metrics`). The names are the same in
every call, and the answers must not change what the policy does:
    estimates() -> {name: (value (N,), standard deviation (N,))}       SI
    excited()   -> {name: (N,) bool}   optional: whether the data say something about it now
    nis()       -> {filter: (N,)}      optional: normalised innovation squared, NaN = no sample

A policy that learns under way may have a method
    freeze(rows)     rows (N,) bool; those vehicles keep what has been learned of them so far
What that is: parameters, a history, a hidden state; the filter of the motion goes on. A row that
starts an episode learns again. With it the benchmark measures what adapting was worth (`frozen`).
"""

import sysconfig
import traceback
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tracked_env.observation import NAMES
from tracked_env.physics.parameters import PARAMETER_NAMES, VEHICLES, PlantParameters
from tracked_env.sensors import RTK, Sensors

SEED_MARK = "@"  # between the name of an agent and that of one of its seeds
FROZEN_NAME = "frozen"  # behind the name of a policy that learns no more after a change
# Where Python and installed packages lie; an error is located in the policy's own source first.
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")})


class Policy(Protocol):
    """The interface described above."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """The action for each observation, and the state for the next call."""
        ...


class PolicyContext(NamedTuple):
    """What a factory may know of the environment that its policy will meet."""

    control_period: float  # [s]
    lateral: str  # lateral model
    sensors: Sensors = RTK  # their data sheet; the signs of the biases are not in it
    drive: str = "torque"  # what the actions are, torques or speeds of the sprockets
    vehicle: PlantParameters = VEHICLES["strawa"]  # nominal, on its nominal soil
    observation: tuple[str, ...] = NAMES  # its fields; `tracked_env.observation` finds columns


PolicyFactory = Callable[[PolicyContext], Policy]


class PolicyEntry(NamedTuple):
    """A policy of the benchmark; each chunk of episodes gets a fresh one."""

    name: str
    make: PolicyFactory
    fingerprint: str  # changes with its source, so that old results are not mistaken for new
    # How another process finds it: a function of a module, and arguments, that return an entry.
    source: tuple[Callable[..., Any], tuple[Any, ...]] | None = None
    frozen: bool = False  # each vehicle's `freeze` is called at its first abrupt change


def agent_of(policy: str) -> str:
    """The agent that a policy `name@seed` is a training of; other names stay."""
    return policy.rpartition(SEED_MARK)[0] or policy


class PolicyError(ValueError):
    """A policy that fails; one line says which, where, and what it did."""


def blamed(error: BaseException, policy: str, where: str) -> PolicyError:
    """The error of a policy in one line, with the place in its source that raised it.

    where: what the policy was asked for, such as "set 'payload', step 3".
    """
    if isinstance(error, PolicyError):
        return error
    text = " ".join(str(error).split())
    what = f"{type(error).__name__}: {text}" if text else type(error).__name__
    if isinstance(error, SystemExit):
        what = f"it called sys.exit({error.code!r}), which a policy must not do"
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename).parent != Path(__file__).parent and frame.filename[:1] != "<"
    ]
    outside = [frame for frame in frames if not frame.filename.startswith(_LIBRARIES)]
    place = ""
    if frames:
        frame = (outside or frames)[-1]
        place = f" ({frame.filename}, line {frame.lineno}, in {frame.name})"
    return PolicyError(f"policy {policy!r}, {where}: {what}{place}")


def checked_policy(entry: PolicyEntry, context: PolicyContext) -> Policy:
    """A fresh policy, seen to have what it declares. Raises PolicyError."""
    try:
        policy = entry.make(context)
        if not callable(getattr(policy, "predict", None)):
            raise TypeError(
                f"it is {policy!r:.200}, which has no method `predict`. Name an object that has "
                "one, or a class or function that makes one from no argument or `context`"
            )
        if needs_truth(policy) and not callable(getattr(policy, "observe_truth", None)):
            raise TypeError("it declares needs_truth but has no `observe_truth`")
    except (Exception, SystemExit) as error:
        raise blamed(error, entry.name, "when it was made") from error
    return policy


def checked_answer(answer: Any, count: int) -> tuple[NDArray[np.float32], Any]:
    """Actions (count, 2) and state from what `predict` returned. Raises ValueError."""
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise ValueError(f"`predict` returned {answer!r:.100}; must be a pair (action, state)")
    action = np.asarray(answer[0])
    if action.shape != (count, 2) or action.dtype.kind not in "biuf":
        raise ValueError(
            f"`predict` returned actions of shape {action.shape} and type {action.dtype}; must be "
            f"numbers of shape ({count}, 2): left and right of every vehicle"
        )
    wrong = ~np.isfinite(action).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ValueError(
            f"`predict` returned action[{row}] = {action[row].tolist()}; must be finite, in "
            "[-1, 1]. Is the state of the policy finite?"
        )
    return np.clip(action, -1.0, 1.0).astype(np.float32), answer[1]


def needs_truth(policy: Policy) -> bool:
    """Whether a policy declares that it must see the true state and parameters."""
    return bool(getattr(policy, "needs_truth", False))


def tell_plant(policy: Policy, reads: Collection[str]) -> None:
    """Tell a policy with the truth which of its parameters the plant does not read, if it asks.

    It asks by a method `observe_plant(without_effect)`. reads: names of those that it reads.
    """
    observe = getattr(policy, "observe_plant", None)
    if needs_truth(policy) and callable(observe):
        observe(tuple(name for name in PARAMETER_NAMES if name not in reads))


def frozen(entry: PolicyEntry) -> PolicyEntry:
    """The same policy, which learns no more from the first abrupt change on, under a name of it."""
    agent, mark, seed = entry.name.rpartition(SEED_MARK)
    name = f"{agent} {FROZEN_NAME}{mark}{seed}" if mark else f"{entry.name} {FROZEN_NAME}"
    return entry._replace(name=name, frozen=True)


def identifies(policy: Policy) -> bool:
    """Whether a policy says what it believes of the parameters."""
    return callable(getattr(policy, "estimates", None))


def can_freeze(policy: Policy) -> bool:
    """Whether a policy can keep what it has learned."""
    return callable(getattr(policy, "freeze", None))
