"""Policies by name: registered ones, modules, archives of agents, several training seeds.

A command line names a policy as one of
    name                  that a package registers
    module:attribute      an object with `predict`, or a class or function that makes one
    NAME@SEED             one training of a registered agent
    path/to/agent.zip     a trained agent; opened by a function of the group `tracked_env.archives`
    NAME=any of these     under another name; the path may be a pattern: every file that matches
                          is one training of the agent NAME

Packages register policies by entry point:
    [project.entry-points."tracked_env.policies"]
    mine = "my_package.policies:Mine"
The object is what `module:attribute` may name. Its attribute `drive`, if it has one, says which
environment it is compared on by default: "torque" (Torque-v0), "speed" (Speed-v0), or an id such as
"tracked_env/Terrain-v0" or "yard/Rover-v0" of its own project. On an id of another project those of
the published id with the same drive are compared too. One entry may register many: an object with a
function
    policies() -> {drive or id: {name: policy, or a list of archives, one per training seed}}
An empty list is an agent whose archives are not installed.

Archives are opened by the entries of the group `tracked_env.archives`: functions that take a path
and return an object with `make(context)` and `sources`, the folders whose code its actions depend
on, or raise ValueError. Functions that commands of `tracked-env` call are in the group
`tracked_env.commands`, under the name of the command.

Trainings of one agent are policies `name@seed` and are summarised together: those of one NAME, and
archives whose names differ only in the seed, the number at the end of their name or folder.
"""

import glob
import hashlib
import importlib
import inspect
import os
import re
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, NamedTuple

from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.benchmark.files import folder_digest, source_fingerprint
from tracked_env.benchmark.policy_interface import (
    SEED_MARK,
    PolicyEntry,
    PolicyError,
    PolicyFactory,
    blamed,
)
from tracked_env.entry_points import declared
from tracked_env.environment_ids import PUBLISHED, published_id
from tracked_env.validation import unknown

POLICIES, ARCHIVES = "tracked_env.policies", "tracked_env.archives"  # groups of entry points
COMMANDS = "tracked_env.commands"
# Where policies are compared by default, by what they may call it.
ENVIRONMENTS = {"torque": TORQUE_ID, "speed": SPEED_ID}
ENVIRONMENTS |= {env: env for env in PUBLISHED}
_OUR_IDS = "tracked_env/"
ARCHIVE = ".zip"
NAME_LIMIT = 200  # [characters] of the name of a policy
GENERIC = ("agent", "last")  # names that say nothing: the folder has a better one
_SEEDED = re.compile(rf"(.+?)[-_ ]?(?:seed|{SEED_MARK})[-_ ]?(\d+)")

Opener = Callable[[Path], PolicyEntry]
OpenArchive = Callable[[Path], Any]  # of the group `tracked_env.archives`
Known = Mapping[str, Any]  # by name: a factory, an entry, or a list of archives
Warn = Callable[[str], None]


class Registered(NamedTuple):
    """A policy under its name."""

    name: str
    env: str | None  # id on which it is compared by default; None: on none, only by its name
    policy: Any  # what `module:attribute` names, or a list of archives
    module: str  # whose package is its source
    distribution: str  # that registers it

    @property
    def is_trained(self) -> bool:
        """Whether it is a list of archives."""
        return isinstance(self.policy, list)

    @property
    def summary(self) -> str:
        """One line for a list."""
        if not self.is_trained:
            text = getattr(self.policy, "__doc__", None) or ""
            return text.strip().partition("\n")[0]
        seeds = len(self.policy)
        if not seeds:
            return "trained agent, its archives are not installed"
        return f"trained agent, {seeds} seed{'s' * (seeds > 1)}"


def _to_stderr(text: str) -> None:
    print(f"warning: {text}", file=sys.stderr)


def _left_out(distribution: str, entry: EntryPoint, error: BaseException) -> str:
    reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    what = f"{entry.group.removeprefix('tracked_env.')} {entry.name!r} of {distribution}"
    return f"{what} ({entry.value}) are left out: {reason}"


def _policies_of(entry: EntryPoint) -> list[tuple[str, str | None, Any]]:
    """Name, environment and policy of everything that an entry registers."""
    loaded = entry.load()
    if callable(getattr(loaded, "policies", None)):
        many: Mapping[str | None, Mapping[str, Any]] = loaded.policies()
    else:
        many = {getattr(loaded, "drive", None): {entry.name: loaded}}
    policies: list[tuple[str, str | None, Any]] = []
    for drive, of in many.items():
        is_own = "/" in str(drive) and not str(drive).startswith(_OUR_IDS)
        if drive is not None and drive not in ENVIRONMENTS and not is_own:
            others = ", ".join(ENVIRONMENTS)
            raise ValueError(f"its drive is {drive!r}; must be one of {others}, or an id of yours")
        env = None if drive is None else ENVIRONMENTS.get(drive, drive)
        policies += [(name, env, policy) for name, policy in of.items()]
    for name, _, policy in policies:
        if not isinstance(policy, list):
            as_factory(name, policy)
    return policies


def registered_policies(warn: Warn = _to_stderr) -> list[Registered]:
    """Everything that is registered. warn: called with what is left out, and why."""
    known: dict[tuple[str, str | None], Registered] = {}
    for distribution, entry in declared(POLICIES):
        try:
            policies = _policies_of(entry)
        except (Exception, SystemExit) as error:
            warn(_left_out(distribution, entry, error))
            continue
        for name, env, policy in policies:
            new = Registered(name, env, policy, entry.module, distribution)
            other = known.setdefault((name, env), new)
            if other is not new:
                warn(f"policy {name!r} of {distribution} is left out: {other.distribution} has it")
    return list(known.values())


def ids_of(env: str) -> tuple[str, ...]:
    """The ids whose policies suit an environment, its own first.

    env: "torque", "speed", or an id, also `module:namespace/Name-v0`.
    """
    env = ENVIRONMENTS.get(env, env)
    return (env,) if env in PUBLISHED else (env.rpartition(":")[2], published_id(env))


def default_names(policies: Sequence[Registered], env: str) -> tuple[str, ...]:
    """Names of all that are compared on an environment by default; env: as in `ids_of`."""
    here = [policy for each in ids_of(env) for policy in policies if policy.env == each]
    names = (policy.name for policy in here if not policy.is_trained or policy.policy)
    return tuple(dict.fromkeys(names))


def by_name(policies: Sequence[Registered], env: str) -> dict[str, Any]:
    """Policies and archives for `load_policies`; of one name, the one for this environment.

    env: as in `ids_of`. Policies for other environments are there too: they say themselves what
    they cannot drive.
    """
    place = {each: number for number, each in enumerate((*ids_of(env), None))}
    known: dict[str, Any] = {}
    for one in sorted(policies, key=lambda each: place.get(each.env, len(place))):
        policy = one.policy
        if one.name in known:
            continue
        if not one.is_trained:
            source, mark = (registered_policy, (one.name, env)), source_fingerprint(one.module)
            policy = PolicyEntry(one.name, as_factory(one.name, policy), mark, source)
        known[one.name] = policy
    return known


def registered_policy(name: str, env: str) -> PolicyEntry:
    """A policy that is registered under a name. Raises ValueError for an unknown one."""
    known = by_name(registered_policies(lambda warning: None), env)
    entries = {name: one for name, one in known.items() if isinstance(one, PolicyEntry)}
    if name not in entries:
        raise unknown("policy", name, entries)
    return entries[name]


def as_factory(spec: str, policy: Any) -> PolicyFactory:
    """What a specification names, as a factory: a policy, or a class or function that makes one.

    Raises PolicyError for anything else.
    """
    if not isinstance(policy, type) and hasattr(policy, "predict"):
        return lambda context: policy
    if not callable(policy):
        text = " ".join(repr(policy).split())[:200]
        raise PolicyError(f"policy {spec!r} is {text}; it has no `predict` and is no factory")
    try:
        takes_context = "context" in inspect.signature(policy).parameters
    except ValueError:  # some built-in functions have no signature
        takes_context = False
    return (lambda context: policy(context=context)) if takes_context else lambda context: policy()


def _from_module(spec: str) -> PolicyEntry:
    """`module:attribute`; a class or function is called, with the context if it takes one."""
    module_name, _, attribute = spec.partition(":")
    try:
        policy: Any = importlib.import_module(module_name)
        for part in attribute.split("."):
            if not hasattr(policy, part):
                raise PolicyError(f"policy {spec!r}: {module_name} has no attribute {attribute!r}")
            policy = getattr(policy, part)
        fingerprint = source_fingerprint(module_name)
        return PolicyEntry(spec, as_factory(spec, policy), fingerprint, (_from_module, (spec,)))
    except ModuleNotFoundError as error:
        raise ValueError(
            f"policy {spec!r}: {error}. Is the module installed, or in the current folder?"
        ) from error
    except (Exception, SystemExit) as error:
        raise blamed(error, spec, f"when {module_name or 'it'} was imported") from error


def load_policy(spec: str, known: Known) -> PolicyEntry:
    """The policy of a known name, or of `module:attribute`: an object with `predict`, or a class
    or function that makes one (an argument named `context` receives the PolicyContext).

    Raises ValueError for anything else, and says what there is.
    """
    if spec in known:
        policy = known[spec]
        if isinstance(policy, PolicyEntry):
            return policy
        return PolicyEntry(spec, policy, source_fingerprint(policy.__module__))
    if spec.endswith(ARCHIVE):
        raise ValueError(
            f"policy {spec!r}: archives of agents are not loaded by the harness. Wrap it: a module "
            "with a function that loads the archive and returns it, passed as module:function. "
            f"Named policies are {sorted(known)}."
        )
    if ":" in spec:
        return _from_module(spec)
    raise unknown("policy (or module:attribute)", spec, known)


def archive_entry(path: Path, open_one: OpenArchive) -> PolicyEntry:
    """An archive as a policy, named after its file or folder. Raises ValueError.

    The fingerprint changes with the archive, and with the code that turns it into actions.
    """
    opened = open_one(path)
    data = path.read_bytes()
    digest = hashlib.sha256(data)
    for folder in opened.sources:
        digest.update(folder_digest(folder).encode())
    source = archive_of_bytes, (open_one, path.name, data)
    return PolicyEntry(own_name(path), opened.make, digest.hexdigest()[:12], source)


def archive_of_bytes(open_one: OpenArchive, name: str, data: bytes) -> PolicyEntry:
    """An archive as a policy, where its file need not be. Raises ValueError."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        return archive_entry(path, open_one)


def open_archive(path: Path) -> PolicyEntry:
    """A trained agent, by the first registered function that can open it. Raises ValueError."""
    first: ValueError | None = None
    for distribution, entry in declared(ARCHIVES):
        try:
            open_one = entry.load()
        except (Exception, SystemExit) as error:
            _to_stderr(_left_out(distribution, entry, error))
            continue
        try:
            return archive_entry(path, open_one)
        except ValueError as error:
            first = first or error
    raise first or ValueError(f"agent {path}: no installed package opens archives of agents")


def command_function(name: str) -> Callable[..., Any]:
    """What a command of that name calls. Raises ValueError where no package registers it."""
    for _, entry in declared(COMMANDS):
        if entry.name == name:
            function: Callable[..., Any] = entry.load()
            return function
    raise ValueError(f"no installed package registers {name!r} in the group {COMMANDS!r}")


def own_name(path: Path) -> str:
    """What an archive is called: its file, or the folder of one that train.py has named."""
    return path.resolve().parent.name if path.stem in GENERIC else path.stem


def _name_and_policy(spec: str) -> tuple[str, str]:
    """NAME ("" for none) and the rest of an item of the command line, NAME=POLICY.

    The path of an archive may hold "=" itself: what exists is a path as a whole, and a name before
    a path has no "/".
    """
    if not spec.endswith(ARCHIVE):
        name, _, source = spec.rpartition("=")
        return name, source
    name, equals, source = spec.partition("=")
    is_path = "/" in name or os.sep in name or Path(spec).exists() or bool(glob.glob(spec))
    return (name, source) if equals and not is_path else ("", spec)


def archives(spec: str, known: Known) -> list[tuple[str, Path]]:
    """Name of the agent and file of every archive that an item of the command line names.

    Raises ValueError for a known agent without archives.
    """
    shipped = {name: one for name, one in known.items() if isinstance(one, list)}
    name, source = _name_and_policy(spec)
    if source in shipped:
        if not shipped[source]:
            raise ValueError(
                f"policy {source!r} is a trained agent with 0 archives in this installation; must "
                "have one at least. Source distributions leave them out: install the wheel (pip "
                "install --only-binary tracked-env tracked-env), or use a clone of the repository"
            )
        return [(name or source, path) for path in shipped[source]]
    agent, _, seed = source.rpartition(SEED_MARK)
    if agent in shipped:
        one = dict(zip(_seeds(shipped[agent]), shipped[agent], strict=True))
        if seed not in one:
            raise unknown(f"seed of {agent!r}", seed, one)
        return [(name or agent, one[seed])]
    if not source.endswith(ARCHIVE):
        return []
    paths = [Path(path) for path in sorted(glob.glob(source))] or [Path(source)]
    seeded = {path: _SEEDED.fullmatch(own_name(path)) for path in paths}
    return [(name or (m[1] if m else own_name(path)), path) for path, m in seeded.items()]


def _seeds(paths: Sequence[Path]) -> list[str]:
    """Names of the seeds of one agent: the numbers at the end of its archives, else counted."""
    numbers = [re.search(r"(\d+)$", own_name(path)) for path in paths]
    labels = [str(int(number[1])) for number in numbers if number]
    return labels if len(set(labels)) == len(paths) else [str(i) for i in range(len(paths))]


def load_policies(
    specs: Sequence[str], known: Known, opener: Opener = open_archive
) -> list[PolicyEntry]:
    """Everything that a command line names, in its order, see the head of this file.

    known: policies and lists of archives by name. opener: loads an archive. Raises ValueError for
    what is not known or not there, and for two policies of one name.
    """
    by_agent: dict[str, PolicyEntry | list[Path]] = {}  # archives: the trainings of an agent
    for spec in dict.fromkeys(specs):
        items: list[tuple[str, Any]] = [*archives(spec, known)]
        if not items:
            name, source = _name_and_policy(spec)
            entry = load_policy(source, known)
            items = [(name or entry.name, entry)]
        for key, one in items:
            paths = by_agent.setdefault(key, [] if isinstance(one, Path) else one)
            if isinstance(one, Path) and isinstance(paths, list):
                paths += [] if one in paths else [one]  # as `NAME` and `NAME@SEED` have it
            elif paths is not one:
                raise ValueError(f"two policies are called {key!r}; give one a name: NAME=PATH")
    loaded: list[PolicyEntry] = []
    for name, one in by_agent.items():
        if not name.isprintable() or len(name) > NAME_LIMIT or SEED_MARK in name:
            raise ValueError(
                f"policy {name!r:.60}: a name is at most {NAME_LIMIT} characters that can be "
                f"printed, without {SEED_MARK}, which marks seeds; give one: NAME=PATH"
            )
        if isinstance(one, PolicyEntry):
            loaded.append(one._replace(name=name))
        else:
            for seed, path in zip(_seeds(one), one, strict=True):
                loaded.append(opener(path)._replace(name=f"{name}{SEED_MARK}{seed}"))
    return loaded


def policies_for(env: str, specs: Sequence[str] | None = None) -> list[PolicyEntry]:
    """The policies that a command line names for an environment; env: as in `ids_of`.

    specs: by default all that are compared there. Raises ValueError as `load_policies`.
    """
    policies = registered_policies()
    names = specs or default_names(policies, env)
    return load_policies(names, by_name(policies, env))
