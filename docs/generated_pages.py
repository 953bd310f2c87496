"""Pages that `docs/conf.py` has written from the code: API reference, environments, vehicles.

The API reference has the docstrings of every public module.
A docstring of this project is plain text. Paragraphs and `code` read as in Markdown, `*` begins an
item of a list, and an indented block is a formula or a table that is shown as it stands.

The page of an environment id has a part from its registration and the class docstring. What is the
same for all ids is a section of the docstring; tables are those of an environment that is made
here: its action, observation, default arguments, `info` and options of the plant.
"""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium

from tracked_env.benchmark.table_model import markdown
from tracked_env.cli.vehicle_commands import catalogue
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics.parameters import RANGES
from tracked_env.plants import find


class Section(NamedTuple):
    """One page: its file and title, a sentence, and the modules; a package brings all of its."""

    file: str
    title: str
    sentence: str
    modules: str


_SECTIONS = """\
environments | Environments | Environments, single and vector: rewards, changes in an episode. \
| tracked_env tracked_env.env tracked_env.vector_env tracked_env.arrays tracked_env.step \
tracked_env.rewards tracked_env.events tracked_env.streams tracked_env.validation \
tracked_env.vehicles tracked_env.environment_ids
wrappers | Wrappers and observations | What an agent sees: fields, sensors, what observers append. \
| tracked_env.wrappers tracked_env.observation tracked_env.sensors tracked_env.engine.episode
episodes | References, uncertainty and ground | What an episode is made of: motion, laws, terrain. \
| tracked_env.references tracked_env.uncertainty tracked_env.terrain
plants | Plants | The equations of motion as the engine takes them. | tracked_env.plants
physics | Physics | Terramechanics, contact, rigid bodies and integration. | tracked_env.physics
benchmark | Benchmark | Frozen sets, policies, metrics and the leaderboard. | tracked_env.benchmark
controllers | Controllers | Feedback linearization, adaptive, predictive and Lyapunov control. \
| baselines.registry baselines.batch_policy baselines.linearizing baselines.augmented \
baselines.predictive baselines.lyapunov baselines.riccati
estimators | Estimators | Identification of vehicle, soil and drives. | baselines.estimators
slip | Slip models | Slip of the tracks, identified by driving and on line. | baselines.slip
planners | Planners | Motions to a pose, shortest or in least time. | baselines.planners
learned | Trained agents | Archives of agents, which drive with NumPy alone. | baselines.learned
identify | Your own logs | A vehicle and its slip from logs of its user. | baselines.identify
rendering | Rendering | Pictures, films and pages of an episode. | tracked_env.rendering
libraries | Other libraries | Stable-Baselines3 and Minari. \
| tracked_env.sb3 tracked_env.datasets"""
SECTIONS = [Section(*(part.strip() for part in row.split("|"))) for row in _SECTIONS.splitlines()]
_FIELD = re.compile(r"^    (\w+): (.+?)  # (.+)$", re.MULTILINE)
_ARRAY = re.compile(r"ndarray\[tuple\[Any, \.\.\.\], dtype\[(\w+)\]\]")
_ITEM = re.compile(r"[*-] ")


def modules_of(name: str) -> Iterator[str]:
    """The module, and all below it where it is a package; `tracked_env` itself stands alone."""
    yield name
    module = importlib.import_module(name)
    if name.count(".") and hasattr(module, "__path__"):
        for below in sorted(one.name for one in pkgutil.iter_modules(module.__path__, f"{name}.")):
            yield from modules_of(below)


def write_api_pages(folder: Path) -> None:
    """One Markdown page for each section, and `index.md` with a table of them."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = "\n".join(f"| [{s.title}]({s.file}.md) | {s.sentence} |" for s in SECTIONS)
    tree = "\n".join(section.file for section in SECTIONS)
    index = (
        "# API reference\n\nMade of the docstrings of all public modules. Arrays have their shape, "
        "numbers their unit in brackets. Names and symbols: NOTATION.md of the repository.\n\n"
        f"| section | content |\n|--|--|\n{rows}\n\n```{{toctree}}\n:hidden:\n\n{tree}\n```\n"
    )
    write_changed(folder / "index.md", index)
    for section in SECTIONS:
        blocks = [f"# {section.title}\n\n{section.sentence}\n"]
        for name in (name for module in section.modules.split() for name in modules_of(module)):
            if inspect.getdoc(importlib.import_module(name)):
                block = f"## `{name}`\n\n```{{eval-rst}}\n.. automodule:: {name}\n```\n"
                blocks.append(block)
        write_changed(folder / f"{section.file}.md", "\n".join(blocks))


def write_changed(path: Path, text: str) -> None:
    """Write where something changes: Sphinx then reads only changed pages again."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def restructured(text: str) -> str:
    """A docstring of this project as reStructuredText."""
    blocks: list[str] = []
    for kind, lines in (run for block in re.split(r"\n\s*\n", text) for run in _runs(block)):
        if kind == "verbatim":
            lines = [".. code-block:: text", "", *(f"   {line}" for line in lines)]
            blocks.append("\n".join(lines))
        else:
            blocks.append(_escaped("\n".join(lines), kind == "item"))
    return "\n\n".join(blocks)


def _runs(block: str) -> list[tuple[str, list[str]]]:
    """(kind, lines) of the parts of a block: "plain", "item" of a list, or "verbatim"."""
    runs: list[tuple[str, list[str]]] = []
    for line in block.split("\n"):
        before = runs[-1][0] if runs else ""
        kind = "verbatim" if line.startswith(" ") and before != "item" else "plain"
        if _ITEM.match(line) or (before == "item" and line.startswith(" ")):
            kind = "item"
        if kind != before or _ITEM.match(line):
            runs.append((kind, []))
        runs[-1][1].append(line)
    return runs


def _escaped(text: str, item: bool = False) -> str:
    """Signs that mean something in reStructuredText, outside `code`, as themselves."""
    mark, text = (text[:2], text[2:]) if item else ("", text)
    parts = re.split(r"`([^`]+)`", text)
    parts[::2] = (re.sub(r"([\\*|`])|(?<=\w)(_)(?!\w)", r"\\\1\2", part) for part in parts[::2])
    # The sign \ and a space separate code from a letter beside it.
    parts[1::2] = (rf"\ ``{part}``\ " for part in parts[1::2])
    return mark + "".join(parts)


def fields_of(thing: Any) -> list[str]:
    """Fields of a NamedTuple or a dataclass with their comments, which have the units."""
    try:
        source = inspect.getsource(thing)
    except (OSError, TypeError):
        return []
    return [f"* ``{name}``: {_escaped(text)}" for name, _, text in _FIELD.findall(source)]


def convert_docstring(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Hook of autodoc: the docstring becomes reStructuredText in place."""
    if any(line.startswith("## ") for line in lines):  # Markdown with tables: it has its own page
        lines[:] = [lines[0], "", "Its text is on the pages of the :doc:`ids </environment>`."]
    else:
        lines[:] = restructured("\n".join(lines)).split("\n")
    if what == "class" and (hasattr(thing, "_fields") or hasattr(thing, "__dataclass_fields__")):
        lines += ["", *fields_of(thing), ""]


def shorten_signature(
    app: Any, what: str, name: str, thing: Any, options: Any, signature: Any, returns: Any
) -> tuple[Any, ...]:
    """Hook of autodoc: arrays by the name that the code uses, NDArray[float64]."""
    return tuple(one and _ARRAY.sub(r"NDArray[\1]", one) for one in (signature, returns))


def skip_member(app: Any, what: str, name: str, thing: Any, skip: bool, options: Any) -> Any:
    """Hook of autodoc: leave out what says nothing, as 'Alias for field number 0'."""
    return (getattr(thing, "__doc__", None) or "").startswith("Alias for field number") or None


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


def write_catalogue(folder: Path) -> None:
    """`folder`/vehicles.md, the table of `tracked-env vehicle`."""
    write_changed(folder / "vehicles.md", markdown([catalogue()]))


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
