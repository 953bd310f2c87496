"""What a policy is to the benchmark, and how one is found from a name.

A policy is any object with the `predict` of Stable-Baselines3:
    action, state = predict(observation, state=None, episode_start=None, deterministic=True)
with observation (N, D) float32, episode_start (N,) bool, action (N, 2) in [-1, 1]. `state` is
handed back unchanged at the next call; what it holds is the policy's business.

A policy that declares `needs_truth = True` gets, before each `predict`, the true state and
parameters through `observe_truth(truth)`, {name: (N,)}. No other policy ever sees them.

A policy that identifies parameters may say what it believes; the benchmark asks after each
`predict` and compares with the truth (see `identification`). It has a method
    estimates() -> {name: (value (N,), standard deviation (N,))}       SI
and, if it likes,
    excited()   -> {name: (N,) bool}   whether the data say something about that parameter now
    nis()       -> {filter: (N,)}      normalised innovation squared of its filters, NaN = no sample
The names are the same in every call; estimates of what is not in `identification.KNOWN` are not
judged. The answers must
not change what the policy does.
"""

import hashlib
import importlib
import importlib.util
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from tracked_env.observation import NAMES
from tracked_env.sensors import RTK, Sensors
from tracked_env.validation import unknown


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
    lateral: str  # lateral closure
    sensors: Sensors = RTK  # their data sheet; the signs of the biases are not in it
    drive: str = "torque"  # what the actions are, torques or speeds of the sprockets
    vehicle: str = "strawa"  # nominal vehicle and soil, a key of physics.parameters.VEHICLES
    observation: tuple[str, ...] = NAMES  # its fields; `tracked_env.observation` finds columns


PolicyFactory = Callable[[PolicyContext], Policy]


class PolicyEntry(NamedTuple):
    """A policy of the benchmark; each chunk of episodes gets a fresh one."""

    name: str
    make: PolicyFactory
    fingerprint: str  # changes with its source, so that old results are not mistaken for new


def source_fingerprint(module: str, ignore: tuple[str, ...] = ()) -> str:
    """Digest of the Python source of a module, and of its whole package if it is in one.

    ignore: files and folders without influence on results. Raises ModuleNotFoundError.
    """
    spec = importlib.util.find_spec(module.partition(".")[0])
    if spec is None:
        raise ModuleNotFoundError(f"no module named {module!r}")
    folders = spec.submodule_search_locations
    if folders:
        files = sorted(path for folder in folders for path in Path(folder).rglob("*.py"))
    else:
        files = [Path(spec.origin)] if spec.origin and Path(spec.origin).is_file() else []
    digest = hashlib.sha256()
    for path in files:
        if not {*path.parts}.intersection(ignore):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _from_module(spec: str) -> PolicyEntry:
    """`module:attribute`; a class or function is called, with the context if it takes one."""
    module_name, _, attribute = spec.partition(":")
    try:
        found: Any = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        raise ValueError(
            f"policy {spec!r}: {error}. Is the module installed, or in the current folder?"
        ) from error
    for part in attribute.split("."):
        if not hasattr(found, part):
            raise ValueError(f"policy {spec!r}: {module_name} has no attribute {attribute!r}")
        found = getattr(found, part)
    fingerprint = source_fingerprint(module_name)
    if not isinstance(found, type) and hasattr(found, "predict"):
        return PolicyEntry(spec, lambda context: found, fingerprint)
    if not callable(found):
        raise ValueError(f"policy {spec!r} is {found!r}; it has no `predict` and is no factory")
    return PolicyEntry(spec, _factory(found), fingerprint)


def _factory(found: Callable[..., Any]) -> PolicyFactory:
    if "context" in inspect.signature(found).parameters:
        return lambda context: found(context=context)
    return lambda context: found()


def load_policy(spec: str, registry: Mapping[str, PolicyFactory]) -> PolicyEntry:
    """The policy that a command line names.

    spec: a name of the registry, or `module:attribute`: an object with `predict`, or a class
    or function that makes one (an argument named `context` receives the PolicyContext).
    Raises ValueError for anything else, and says what there is.
    """
    if spec in registry:
        make = registry[spec]
        return PolicyEntry(spec, make, source_fingerprint(make.__module__))
    if spec.endswith(".zip"):
        raise ValueError(
            f"policy {spec!r}: archives of agents are not loaded by the harness. Wrap it: a module "
            "with a function that loads the archive and returns it, passed as module:function. "
            f"Named policies are {sorted(registry)}."
        )
    if ":" in spec:
        return _from_module(spec)
    raise unknown("policy (or module:attribute)", spec, registry)


def checked_policy(entry: PolicyEntry, context: PolicyContext) -> Policy:
    """A fresh policy, seen to have what it declares. Raises ValueError."""
    policy = entry.make(context)
    if not callable(getattr(policy, "predict", None)):
        raise ValueError(f"policy {entry.name!r} is {policy!r}, which has no method `predict`")
    if needs_truth(policy) and not callable(getattr(policy, "observe_truth", None)):
        raise ValueError(f"policy {entry.name!r} declares needs_truth but has no `observe_truth`")
    return policy


def needs_truth(policy: Policy) -> bool:
    """Whether a policy declares that it must see the true state and parameters."""
    return bool(getattr(policy, "needs_truth", False))


def identifies(policy: Policy) -> bool:
    """Whether a policy says what it believes of the parameters."""
    return callable(getattr(policy, "estimates", None))
