"""Policies that packages register by entry point, so that a command line knows them by name.

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

import sys
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, NamedTuple

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.policy_interface import (
    PolicyEntry,
    PolicyFactory,
    as_factory,
    source_fingerprint,
)
from tracked_env.benchmark.policy_lookup import OpenedArchive, archive_entry
from tracked_env.entry_points import declared
from tracked_env.validation import unknown

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
    """What a command of that name calls, or the module of it.

    Raises ValueError where no package registers it.
    """
    for _, entry, found in _loaded(COMMANDS, _to_stderr):
        if entry.name == name:
            function: Callable[..., Any] = found
            return function
    raise ValueError(f"no installed package registers {name!r} in the group {COMMANDS!r}")
