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

IDS = {f"{name}_v0": f"tracked_env/{name.title()}-v0" for name in ("torque", "speed", "terrain")}
DOCS = Path(__file__).resolve().parent
HEAD = """\
| Make | `gymnasium.make("tracked_env:{id}")` |
|--|--|
| Action space | `{action}`: {quantity} of the sprockets |
| Observation space | `Box({size}, float32)`: {groups} groups of sensor readings and the reference |
| Episode | {steps} steps at {rate} Hz, or until the vehicle is too far from the reference |
| Pictures | `render_mode="human"` or `"rgb_array"` |
"""
ACTION = """\
`{action}`

| index | action | min | max | 1 means |
|--|--|--|--|--|
| 0 | left sprocket {quantity} over `{limit}` | -1 | 1 | {value:g} {unit} |
| 1 | right sprocket {quantity} over `{limit}` | -1 | 1 | {value:g} {unit} |

Values outside are clipped; a non-finite value or a wrong shape is a `ValueError`. \
Equal actions drive straight on; more on the right turns left."""
OBSERVATION = """\
`Box({size}, float32)`: sensor readings and the reference, each in SI units over its scale \
("shown as 1") and clipped at its bound. No true state. The argument `observation` chooses other \
[groups](../observation.md).

{table}"""


def write_environment_pages(folder: Path) -> None:
    """`folder`/PAGE.md for each id, to be included by the page in docs/environments."""
    folder.mkdir(parents=True, exist_ok=True)
    for page, env_id in IDS.items():
        write_changed(folder / f"{page}.md", reference(env_id))


def reference(env_id: str) -> str:
    """The reference of one id as Markdown, headings from the second level on."""
    env = gymnasium.make(env_id, expose_truth=True)
    env.reset(seed=0)
    info = env.step(env.action_space.sample())[4]
    core: Any = env.unwrapped
    env.close()
    options = gymnasium.spec(env_id).kwargs
    torque = options.get("drive", "torque") == "torque"
    limit = "torque_limit" if torque else "sprocket_speed_limit"
    values = {
        **{"id": env_id, "action": core.action_space, "size": core.layout.size, "limit": limit},
        **{"steps": core.simulation.settings.max_steps, "rate": core.metadata["render_fps"]},
        **{"groups": len(core.layout.groups), "table": core.layout.markdown_table()},
        **{"quantity": "torque" if torque else "speed", "unit": RANGES[limit].unit},
        "value": core.simulation.truth()[limit][0],
    }
    pieces = re.split(r"^## (.+)$", inspect.getdoc(TrackedVehicleEnv) or "", flags=re.MULTILINE)
    parts = {title: text.strip() for title, text in zip(pieces[1::2], pieces[2::2], strict=True)}
    parts |= {
        "Action Space": ACTION.format(**values),
        "Observation Space": OBSERVATION.format(**values),
        "Arguments": _arguments(parts["Arguments"], options) + _options(options),
        "Info": _info(parts["Info"], info),
    }
    texts = [f"## {title}\n\n{text}\n" for title, text in parts.items()]
    # Files of the documentation that the docstring names, as links from docs/environments.
    return re.sub(r"docs/(\w+)\.md", _link, "\n".join([HEAD.format(**values), *texts]))


def _link(match: re.Match[str]) -> str:
    title = (DOCS / f"{match[1]}.md").read_text(encoding="utf-8").partition("\n")[0]
    return f"[{title.removeprefix('# ')}](../{match[1]}.md)"


def _arguments(text: str, options: dict[str, Any]) -> str:
    """The table of arguments with the defaults of this id."""

    def default(match: re.Match[str]) -> str:
        if match[1] not in options:
            return match[0]
        value = options[match[1]]
        text = f'"{value}"' if isinstance(value, str) else repr(value)
        return f"| `{match[1]}` | `{text}` |"

    first = text.partition("\n\n")[0]  # it says that the ids differ; here they are separate
    text = re.sub(r"^\| `(\w+)` \| .+? \|(?= .+ \|$)", default, text, flags=re.MULTILINE)
    return text.replace(first, "All but a function can be written as JSON.", 1)


def _options(options: dict[str, Any]) -> str:
    """Options of the plant of this id."""
    plant = find(options.get("plant", "lumped"))
    if not plant.options:
        return f"\n\nThe plant `{plant.name}` has no `plant_options`."
    defaults = ", ".join(
        f"`{name}` ({f'{value:g}' if isinstance(value, float) else repr(value)})"
        for name, value in plant.options.items()
    )
    return f"\n\n`plant_options` of the plant `{plant.name}`, with their defaults: {defaults}."


def _info(text: str, info: dict[str, Any]) -> str:
    """The rows of the table that this id has, and the names in `truth`."""
    rows = [(re.match(r"\| `(\w+)` \|", line), line) for line in text.split("\n")]
    lines = [line for row, line in rows if row is None or row[1] in info]
    names = ", ".join(f"`{name}`" for name in info["truth"])
    return "\n".join(lines) + f"\n\n`truth` has {names}."
