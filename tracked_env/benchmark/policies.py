"""Policies from what a command line says: names, modules, archives of agents, several seeds.

    name                  that a package registers (`registered_policies`)
    module:attribute      an object with `predict`, or a class or function that makes one
    NAME@SEED             one training of such an agent
    path/to/agent.zip     a trained agent; opened by a function that the caller passes in
    NAME=any of these     under another name; the path may be a pattern: every file that matches
                          is one training of the agent NAME

Trainings of one agent are policies `name@seed` and are summarised together: those of one NAME, and
archives whose names differ only in the seed (ppo-seed0, ppo-seed1). The seed is the number at the
end of the name of the archive, or of its folder if train.py has named it, else the files are
counted.

Policies that packages register by entry point, so that a command line knows them by name.

    [project.entry-points."tracked_env.policies"]
    mine = "my_package.policies:Mine"
The object is what `module:attribute` of a command line may name: a policy, or a class or function
that makes one. Its attribute `drive`, if it has one, says which environment it is compared on by
default: "torque" (Torque-v0), "speed" (Speed-v0), or an id such as "tracked_env/Terrain-v0". One
entry may also register many: an object with a function
    policies() -> {drive or id: {name: policy, or a list of archives, one per training seed}}
An empty list says that the agent is known and its archives are not installed: it is refused by name
and not compared by default.

Archives of agents are opened by the entries of the group `tracked_env.archives`, functions that
take a path and return an object with `make(context)` and `sources`, the folders whose code its
actions depend on, or raise ValueError. Functions that commands of `tracked-env` call are in the
group `tracked_env.commands`, under the name of the command.
"""

import glob
import hashlib
import os
import re
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.policy_interface import (
    SEED_MARK,
    Policy,
    PolicyContext,
    PolicyEntry,
    PolicyFactory,
    as_factory,
    folder_digest,
    load_policy,
    source_fingerprint,
)
from tracked_env.entry_points import declared
from tracked_env.validation import unknown

ARCHIVE = ".zip"
NAME_LIMIT = 200  # [characters] of the name of a policy
GENERIC = ("agent", "last")  # names that say nothing: the folder has a better one
Opener = Callable[[Path], PolicyEntry]

_SEEDED = re.compile(rf"(.+?)[-_ ]?(?:seed|{SEED_MARK})[-_ ]?(\d+)")


class OpenedArchive(Protocol):
    """An archive of an agent that has been opened."""

    @property
    def make(self) -> PolicyFactory:
        """Makes a fresh policy of it."""

    @property
    def sources(self) -> tuple[Path, ...]:
        """Folders whose code its actions depend on."""


def archive_entry(path: Path, open_one: Callable[[Path], OpenedArchive]) -> PolicyEntry:
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


def archive_of_bytes(
    open_one: Callable[[Path], OpenedArchive], name: str, data: bytes
) -> PolicyEntry:
    """An archive as a policy, where its file need not be. Raises ValueError."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        return archive_entry(path, open_one)


def _parts(name: str) -> tuple[str, str | None]:
    """Name of the agent and of the seed, if a name says both."""
    match = _SEEDED.fullmatch(name)
    return (match[1], match[2]) if match else (name, None)


def _label(path: Path) -> str | None:
    """The number at the end of the name of an archive."""
    match = re.search(r"(\d+)$", own_name(path))
    return str(int(match[1])) if match else None


def named(spec: str) -> tuple[str, str]:
    """(own name, "" for none; policy) of an item of the command line, NAME=POLICY.

    The path of an archive may hold "=" itself: what exists is a path as a whole, and a name before
    a path has no "/".
    """
    if not spec.endswith(ARCHIVE):
        name, _, source = spec.rpartition("=")
        return name, source
    name, equals, source = spec.partition("=")
    is_path = "/" in name or os.sep in name or Path(spec).exists() or bool(glob.glob(spec))
    return (name, source) if equals and not is_path else ("", spec)


def archives(spec: str, shipped: Mapping[str, Sequence[Path]]) -> list[tuple[str, Path]]:
    """Name of the agent and file of every archive that an item of the command line names.

    Raises ValueError for an agent of `shipped` without archives.
    """
    given, source = named(spec)
    if source in shipped:
        if not shipped[source]:
            raise ValueError(
                f"policy {source!r} is a trained agent with 0 archives in this installation; must "
                "have one at least. Source distributions leave them out: install the wheel (pip "
                "install --only-binary tracked-env tracked-env), or use a clone of the repository"
            )
        return [(given or source, path) for path in shipped[source]]
    agent, _, seed = source.rpartition(SEED_MARK)
    if agent in shipped:
        one = dict(zip(_seeds(shipped[agent]), shipped[agent], strict=True))
        if seed not in one:
            raise unknown(f"seed of {agent!r}", seed, one)
        return [(given or agent, one[seed])]
    if not source.endswith(ARCHIVE):
        return []
    paths = [Path(found) for found in sorted(glob.glob(source))] or [Path(source)]
    return [(given or _parts(own_name(path))[0], path) for path in paths]


def own_name(path: Path) -> str:
    """What an archive is called: its file, or the folder of one that train.py has named."""
    return path.resolve().parent.name if path.stem in GENERIC else path.stem


def _seeds(paths: Sequence[Path]) -> list[str]:
    """Names of the seeds of one agent."""
    labels = [_label(path) for path in paths]
    if None in labels or len(set(labels)) < len(labels):
        return [str(number) for number in range(len(paths))]
    return [str(label) for label in labels]


def load_policies(
    specs: Sequence[str],
    registry: Mapping[str, PolicyFactory | PolicyEntry],
    shipped: Mapping[str, Sequence[Path]] | None = None,
    opener: Opener | None = None,
) -> list[PolicyEntry]:
    """Everything that a command line names, in its order, see the head of this file.

    shipped: archives of agents by name, none where they are not installed. opener: loads an
    archive; it is called for nothing else. Raises ValueError for what is not known or not there,
    and for two policies of one name.
    """
    shipped = {} if shipped is None or opener is None else shipped
    entries: list[PolicyEntry] = []
    trained: dict[str, list[Path]] = {}
    for spec in dict.fromkeys(specs):
        given, source = named(spec)
        found = [] if source in registry or opener is None else archives(spec, shipped)
        if not found:
            entry = load_policy(source, {**dict.fromkeys(shipped, _nothing), **registry})
            entries.append(entry._replace(name=given or entry.name))
        for name, path in found:
            if name not in trained:  # its place in the order; filled in below
                entries.append(PolicyEntry(name, _nothing, ""))
            paths = trained.setdefault(name, [])
            if path not in paths:  # as `NAME` and `NAME@SEED` have it
                paths.append(path)
    names = [entry.name for entry in entries]
    for name in names:
        if not name.isprintable() or len(name) > NAME_LIMIT or SEED_MARK in name:
            raise ValueError(
                f"policy {name!r:.60}: a name is at most {NAME_LIMIT} characters that can be "
                f"printed, without {SEED_MARK}, which marks seeds; give one: NAME=PATH"
            )
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two policies are called {name!r}; give one a name: NAME=PATH")
    return [
        one
        for entry in entries
        for one in ([entry] if entry.name not in trained else _opened(entry.name, trained, opener))
    ]


def _nothing(context: PolicyContext) -> Policy:
    """Stands for archives that are opened later."""
    raise NotImplementedError


def _opened(
    name: str, trained: Mapping[str, Sequence[Path]], opener: Opener | None
) -> list[PolicyEntry]:
    """The trainings of one agent."""
    assert opener is not None
    paths = trained[name]
    return [
        opener(path)._replace(name=f"{name}{SEED_MARK}{seed}")
        for seed, path in zip(_seeds(paths), paths, strict=True)
    ]


POLICIES, ARCHIVES = "tracked_env.policies", "tracked_env.archives"  # groups of entry points
COMMANDS = "tracked_env.commands"
# Where policies are compared by default, by what they may call it.
ENVIRONMENTS = {
    "torque": TORQUE_ID, "speed": SPEED_ID,
    **{env: env for env in (TORQUE_ID, SPEED_ID, TERRAIN_ID)},
}  # fmt: skip


class Registered(NamedTuple):
    """A policy under its name."""

    name: str
    env: str | None  # id on which it is compared by default; None: on none, only by its name
    found: Any  # what `module:attribute` names, or a list of archives
    module: str  # whose package is its source
    distribution: str  # that registers it

    @property
    def is_trained(self) -> bool:
        """Whether it is a list of archives."""
        return isinstance(self.found, list)

    @property
    def summary(self) -> str:
        """One line for a list."""
        if self.is_trained:
            seeds = len(self.found)
            if not seeds:
                return "trained agent, its archives are not installed"
            return f"trained agent, {seeds} seed{'s' * (seeds > 1)}"
        text = getattr(self.found, "__doc__", None) or ""
        return text.strip().partition("\n")[0]


def _loaded(group: str, warn: Callable[[str], None]) -> list[tuple[str, EntryPoint, Any]]:
    """What can be imported; the others are left out with a warning."""
    loaded = []
    for distribution, entry in declared(group):
        try:
            loaded.append((distribution, entry, entry.load()))
        except (Exception, SystemExit) as error:
            warn(_left_out(distribution, entry, error))
    return loaded


def _left_out(distribution: str, entry: EntryPoint, error: BaseException) -> str:
    said = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    what = f"{entry.group.removeprefix('tracked_env.')} {entry.name!r} of {distribution}"
    return f"{what} ({entry.value}) are left out: {said}"


def _policies_of(entry: EntryPoint, found: Any) -> list[tuple[str, str | None, Any]]:
    """Name, environment and policy of everything that an entry registers."""
    if not callable(getattr(found, "policies", None)):
        drive = getattr(found, "drive", None)
        if drive is not None and drive not in ENVIRONMENTS:
            raise ValueError(f"its drive is {drive!r}; must be one of {', '.join(ENVIRONMENTS)}")
        policies = [(entry.name, None if drive is None else ENVIRONMENTS[drive], found)]
    else:
        many: Mapping[str, Mapping[str, Any]] = found.policies()
        if set(many) - {*ENVIRONMENTS}:
            raise ValueError(
                f"it has policies of {sorted(many)}; known are {', '.join(ENVIRONMENTS)}"
            )
        policies = [
            (name, ENVIRONMENTS[key], one) for key, of in many.items() for name, one in of.items()
        ]
    for name, _, one in policies:
        if not isinstance(one, list):
            as_factory(name, one)
    return policies


def _to_stderr(text: str) -> None:
    print(f"warning: {text}", file=sys.stderr)


def registered_policies(warn: Callable[[str], None] = _to_stderr) -> list[Registered]:
    """Everything that is registered. warn: called with what is left out, and why."""
    known: dict[tuple[str, str | None], Registered] = {}
    for distribution, entry, found in _loaded(POLICIES, warn):
        try:
            of_entry = _policies_of(entry, found)
        except (Exception, SystemExit) as error:
            warn(_left_out(distribution, entry, error))
            continue
        for name, env, one in of_entry:
            new = Registered(name, env, one, entry.module, distribution)
            other = known.setdefault((name, env), new)
            if other is not new:
                warn(f"policy {name!r} of {distribution} is left out: {other.distribution} has it")
    return list(known.values())


def default_names(policies: list[Registered], env: str) -> tuple[str, ...]:
    """Names of all that are compared on an environment by default; env: as in ENVIRONMENTS."""
    here = (policy for policy in policies if policy.env == ENVIRONMENTS[env])
    return tuple(policy.name for policy in here if not policy.is_trained or policy.found)


def by_name(
    policies: list[Registered], env: str
) -> tuple[dict[str, PolicyFactory | PolicyEntry], dict[str, list[Path]]]:
    """Policies and archives for `load_policies`; of one name, the one for this environment.

    env: as in ENVIRONMENTS. Policies for other environments are there too: they say themselves
    what they cannot drive.
    """
    here = ENVIRONMENTS[env]
    chosen: dict[str, Registered] = {}
    for policy in sorted(policies, key=lambda each: (each.env != here, each.env is not None)):
        chosen.setdefault(policy.name, policy)
    registry: dict[str, PolicyFactory | PolicyEntry] = {
        name: PolicyEntry(
            name,
            as_factory(name, of.found),
            source_fingerprint(of.module),
            (registered_policy, (name, env)),
        )
        for name, of in chosen.items()
        if not of.is_trained
    }
    return registry, {name: of.found for name, of in chosen.items() if of.is_trained}


def registered_policy(name: str, env: str) -> PolicyEntry:
    """A policy that is registered under a name. Raises ValueError for an unknown one."""
    registry, _ = by_name(registered_policies(lambda warning: None), env)
    entry = registry.get(name)
    if not isinstance(entry, PolicyEntry):
        raise unknown("policy", name, registry)
    return entry


def open_archive(path: Path) -> PolicyEntry:
    """A trained agent, by the first registered function that can open it. Raises ValueError."""
    first: ValueError | None = None
    for _, _, opened in _loaded(ARCHIVES, _to_stderr):
        open_one: Callable[[Path], OpenedArchive] = opened
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
