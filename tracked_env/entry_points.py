"""What installed packages register by entry points, and a clone by its pyproject.toml.

A clone that is not installed registers what the pyproject.toml beside this package says.
"""

import re
import tomllib
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

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
