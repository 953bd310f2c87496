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
"""

import glob
import hashlib
import os
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from tracked_env.benchmark.policy_interface import (
    Policy,
    PolicyContext,
    PolicyEntry,
    PolicyFactory,
    folder_digest,
    load_policy,
)
from tracked_env.benchmark.summary import SEED_MARK
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
