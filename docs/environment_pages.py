"""Reference part of the page of each environment id: from its registration and the class docstring.

What is the same for all ids is a section of the docstring; tables are those of an environment that
is made here: its action, observation, default arguments, `info` and options of the plant.
"""

import inspect
import re
from pathlib import Path
from typing import Any

import gymnasium

from docs.api_pages import write_changed
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics.parameters import RANGES
from tracked_env.plants import find

IDS = {
    "torque_v0": "tracked_env/Torque-v0",
    "speed_v0": "tracked_env/Speed-v0",
    "terrain_v0": "tracked_env/Terrain-v0",
}  # page -> id
DOCS = Path(__file__).resolve().parent


def write_environment_pages(folder: Path) -> None:
    """`folder`/PAGE.md for each id, to be included by the page in docs/environments."""
    folder.mkdir(parents=True, exist_ok=True)
    for page, env_id in IDS.items():
        write_changed(folder / f"{page}.md", reference(env_id))


def reference(env_id: str) -> str:
    """The reference of one id as Markdown, headings from the second level on."""
    env = gymnasium.make(env_id, expose_truth=True)
    env.reset(seed=0)
    _, _, _, _, info = env.step(env.action_space.sample())
    core: Any = env.unwrapped
    env.close()
    options = gymnasium.spec(env_id).kwargs
    parts = sections(inspect.getdoc(TrackedVehicleEnv) or "")
    tables = {
        "Action Space": _actions(core),
        "Observation Space": _observations(core),
        "Arguments": _arguments(parts["Arguments"], options) + _options(options),
        "Info": _info(parts["Info"], info),
    }
    head = (
        f'| Make | `gymnasium.make("tracked_env:{env_id}")` |\n|--|--|\n'
        f"| Action space | `{core.action_space}`: {_drive(core)[1]} of the sprockets |\n"
        f"| Observation space | `Box({core.layout.size}, float32)`: {len(core.layout.groups)} "
        "groups of sensor readings and the reference |\n"
        f"| Episode | {core.simulation.settings.max_steps} steps at {core.metadata['render_fps']} "
        "Hz, or until the vehicle is too far from the reference |\n"
        '| Pictures | `render_mode="human"` or `"rgb_array"` |\n'
    )
    texts = [f"## {title}\n\n{tables.get(title, text)}\n" for title, text in parts.items()]
    return _linked("\n".join([head, *texts]))


def sections(docstring: str) -> dict[str, str]:
    """Title -> text of the sections of the docstring, without what stands before the first."""
    found = re.split(r"^## (.+)$", docstring, flags=re.MULTILINE)[1:]
    return {title: text.strip() for title, text in zip(found[::2], found[1::2], strict=True)}


def _drive(core: Any) -> tuple[str, str]:
    """Parameter that is the limit of an action, and the quantity that it limits."""
    torque = gymnasium.spec(core.spec.id).kwargs.get("drive", "torque") == "torque"
    return ("torque_limit", "torque") if torque else ("sprocket_speed_limit", "speed")


def _actions(core: Any) -> str:
    """The table of actions, with the size of an action of 1."""
    limit, quantity = _drive(core)
    unit = RANGES[limit].unit
    value = core.simulation.truth()[limit][0]
    rows = [
        f"| {index} | {side} sprocket {quantity} over `{limit}` | -1 | 1 | {value:g} {unit} |"
        for index, side in enumerate(("left", "right"))
    ]
    return (
        f"`{core.action_space}`\n\n| index | action | min | max | 1 means |\n|--|--|--|--|--|\n"
        + "\n".join(rows)
        + "\n\nValues outside are clipped; a non-finite value or a wrong shape is a `ValueError`. "
        "Equal actions drive straight on; more on the right turns left."
    )


def _observations(core: Any) -> str:
    """The table of the fields that the id shows."""
    return (
        f"`Box({core.layout.size}, float32)`: sensor readings and the reference, each in SI units "
        'over its scale ("shown as 1") and clipped at its bound. No true state. The argument '
        "`observation` chooses other [groups](../observation.md).\n\n"
        + core.layout.markdown_table()
    )


def _arguments(text: str, options: dict[str, Any]) -> str:
    """The table of arguments with the defaults of this id."""
    lines = []
    for line in text.split("\n"):
        row = re.match(r"\| `(\w+)` \| (.+?) \| (.+) \|$", line)
        if row and row[1] in options:
            value = options[row[1]]
            shown = f'`"{value}"`' if isinstance(value, str) else f"`{value!r}`"
            line = f"| `{row[1]}` | {shown} | {row[3]} |"
        lines.append(line)
    first = text.partition("\n\n")[0]  # it says that the ids differ; here they are separate
    return "\n".join(lines).replace(first, "All but a function can be written as JSON.", 1)


def _options(options: dict[str, Any]) -> str:
    """Options of the plant of this id."""
    plant = find(options.get("plant", "lumped"))
    if not plant.options:
        return f"\n\nThe plant `{plant.name}` has no `plant_options`."
    listed = ", ".join(
        f"`{name}` ({f'{value:g}' if isinstance(value, float) else repr(value)})"
        for name, value in plant.options.items()
    )
    return f"\n\n`plant_options` of the plant `{plant.name}`, with their defaults: {listed}."


def _info(text: str, info: dict[str, Any]) -> str:
    """The rows of the table that this id has, and the names in `truth`."""
    lines = []
    for line in text.split("\n"):
        row = re.match(r"\| `(\w+)` \|", line)
        if row is None or row[1] in info:
            lines.append(line)
    names = ", ".join(f"`{name}`" for name in info["truth"])
    return "\n".join(lines) + f"\n\n`truth` has {names}."


def _linked(text: str) -> str:
    """Files of the documentation that the docstring names, as links from docs/environments."""

    def link(match: re.Match[str]) -> str:
        title = (DOCS / f"{match[1]}.md").read_text(encoding="utf-8").partition("\n")[0]
        return f"[{title.removeprefix('# ')}](../{match[1]}.md)"

    return re.sub(r"docs/(\w+)\.md", link, text)
