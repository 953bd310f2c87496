"""The agents that come with this package: of an environment, name -> archives, one per seed.

The source distribution leaves the archives out; an installation that was built from it has the
names, and an empty list for each.
"""

import json
import re
from pathlib import Path

PRETRAINED = Path(__file__).resolve().parent / "pretrained"
SCORES = "scores.json"  # per environment: {"seeds": {name: ...}}, of every shipped agent
FOLDERS = {"torque": "Torque-v0", "speed": "Speed-v0"}

_SEEDED = re.compile(r"(.+)-seed(\d+)")


def shipped_agents(env: str) -> dict[str, list[Path]]:
    """Archives of PRETRAINED for an environment, its id or a drive, by the name of the agent."""
    found: dict[str, list[Path]] = {}
    folder = PRETRAINED / FOLDERS.get(env, env.rpartition("/")[2])
    for path in sorted(folder.glob("*/agent.zip")):
        match = _SEEDED.fullmatch(path.parent.name)
        found.setdefault(match[1] if match else path.parent.name, []).append(path)
    scores = folder / SCORES
    if not found and scores.is_file():
        return {name: [] for name in json.loads(scores.read_text(encoding="utf-8"))["seeds"]}
    return found
