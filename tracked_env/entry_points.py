"""What packages register: by entry points, or by a module that is imported by its name.

A clone that is not installed registers what the pyproject.toml beside this package says.

What `register` of vehicles, rewards, references and plants names is known in one process. Written
`module:name`, it is known in all: the module is imported first, in a worker process as well.
"""

import importlib
import re
import tomllib
from collections.abc import Callable, Iterable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from tracked_env.validation import unknown

OURS = "tracked-env"  # our distribution, which comes first
_PACKAGES = Path(__file__).resolve().parents[1]  # where this package lies


def _name(distribution: str) -> str:
    return re.sub(r"[-_.]+", "-", distribution).lower()


def _of_clone(group: str) -> list[EntryPoint]:
    """What the pyproject.toml beside this package says, nothing where there is none."""
    try:
        project = tomllib.loads((_PACKAGES / "pyproject.toml").read_text(encoding="utf-8"))
        if _name(project["project"]["name"]) != OURS:
            return []
        entries = project["project"]["entry-points"].get(group, {})
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        return []
    return [EntryPoint(name, value, group) for name, value in entries.items()]


def declared(group: str) -> list[tuple[str, EntryPoint]]:
    """Distribution and entry, ours first, then by name."""
    clone = _of_clone(group)
    entries = [(OURS, entry) for entry in clone]
    for entry in entry_points(group=group):
        distribution = _name(entry.dist.name) if entry.dist else "?"
        if not (clone and distribution == OURS):
            entries.append((distribution, entry))
    return sorted(entries, key=lambda each: (each[0] != OURS, each[0], each[1].name))


def imported_name(what: str, text: str) -> str:
    """The name behind `module:`, after the module is imported; a name without it as it is.

    what: it is, in messages. Raises ValueError for a module that cannot be imported.
    """
    module, colon, name = text.rpartition(":")
    if colon:
        try:
            importlib.import_module(module)
        except Exception as error:
            raise ValueError(
                f"{what} {text}: {module!r} cannot be imported ({error}). Is it installed, "
                "or in the current folder?"
            ) from error
    return name


def registered_name(
    what: str, value: object, names: Callable[[], Iterable[str]], hint: str = ""
) -> str:
    """The name of something that is registered, written as `name` or `module:name`.

    names: those that are known, asked for after the import. Raises ValueError.
    """
    if isinstance(value, str) and value in names():
        return value
    name = imported_name(what, value) if isinstance(value, str) else value
    if name in (known := list(names())):
        return str(name)
    cause = "A name is known in the process that registers it, module:name in others too"
    if name is not value:
        cause = f"Does {str(value).rpartition(':')[0]!r} register it?"
    raise ValueError(f"{unknown(what, name, known)}{hint} {cause}")
