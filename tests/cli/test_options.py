"""The options of all commands: one meaning has one name and default, and pages name what exists."""

import argparse
import re
import shlex

import pytest

from baselines.planners.trajectory import Limits
from tests.conftest import ROOT
from tracked_env.cli.command_line import Parser
from tracked_env.cli.main import COMMANDS, main

# Options with the same name and another meaning: what they are of is in their help.
OF_THE_COMMAND = {
    "output": "a folder by the name of what is in it",
    "file": "what it is called by default says what is in it",
    "vehicle": "that of the environment; without one that of plans, or required",
    "episodes": "tune has as many as evaluate, which has fewer at first sight",
    "sensors": "those of the log, not of the sets",
    "workers": "what is compiled is compiled on all processors, what is measured on one",
}
# Programs of others on the pages.
FOREIGN = {
    "pip": "--extra-index-url --no-deps", "any": "--help",
    "ray": "--head --port --address --autoscaling-config --generate",
    "slurm": "--array --cpus-per-task --mem --time",
    "RL Zoo": "--no-render --algo --env-kwargs --gym-packages",
    "an algorithm of one's own": "--cross-entropy.horizon",
}  # fmt: skip
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
PAGES = [page for page in PAGES if not {"_generated", "decisions", "api"} & set(page.parts)]


class Seen(Exception):
    """A parser that is complete."""


@pytest.fixture
def parsers(monkeypatch):
    """The parser of each command, and that of train.py where the extra `rl` is installed."""

    def seen(parser, arguments=None, namespace=None):
        if parser.prog == "tracked-env":  # that of the command's name reads on
            return argparse.ArgumentParser.parse_args(parser, arguments, namespace)
        raise Seen(parser)

    monkeypatch.setattr(Parser, "parse_args", seen)
    monkeypatch.setattr("tracked_env.cli.main.end_at_interrupt", lambda program: None)
    found = {}
    for name in (name for name in COMMANDS if name != "train"):
        with pytest.raises(Seen) as of:
            main([name])
        found[name] = of.value.args[0]
    try:
        from agents import options
    except ImportError:
        return found
    with pytest.raises(Seen) as of:
        options.parse([], options.options_of_train())
    return {**found, "train": of.value.args[0]}


def options_of(parser):
    """(name, action) of the options."""
    return [
        (one.option_strings[0], one)
        for one in parser._actions
        if one.option_strings[1:2] != ["--help"] and one.option_strings
    ]


def test_the_help_of_every_option_says_its_default(parsers):
    assert len(parsers) >= len(COMMANDS) - 1
    silent = [
        f"{command} {name}: {action.help}"
        for command, parser in parsers.items()
        for name, action in options_of(parser)
        if not action.required and "default" not in (action.help or "").lower()
    ]
    assert silent == []


def test_the_help_of_every_number_says_its_range(parsers):
    interval = r"[\[(][-\d.e]+, [-\d.e]+[\])]|\d+ to [-\d.e]+|\d or more|> 0|within 2 pi"
    silent = [
        f"{command} {name}: {action.help}"
        for command, parser in parsers.items()
        for name, action in options_of(parser)
        if action.type in (int, float) and not re.search(interval, action.help)
    ]
    assert silent == []


def test_every_argument_without_a_name_has_a_help(parsers):
    places = [a for of in parsers.values() for a in of._actions if not a.option_strings]
    assert len(places) > 8 and all(action.help for action in places)


def test_an_option_of_several_commands_has_one_default(parsers):
    defaults = {}
    for command, parser in parsers.items():
        for name, action in options_of(parser):
            if command != "train":  # a training has defaults of its own: --seed is of its networks
                defaults.setdefault(name.lstrip("-"), {})[command] = action.default
    differing = {
        name: of for name, of in defaults.items() if len({str(one) for one in of.values()}) > 1
    }
    assert differing.keys() == OF_THE_COMMAND.keys(), differing
    assert {str(one) for one in defaults["vehicle"].values()} == {"None", "focchi"}


def test_the_defaults_of_a_plan_are_those_in_its_help(parsers):
    texts = {name: action.help for name, action in options_of(parsers["plan"])}
    for name in ("v_min", "v_max", "reserve"):
        default = f"(default: {Limits._field_defaults[name]:g})"
        assert default in texts[f"--{name.replace('_', '-')}"]


def known_options(parser):
    return {name for action in parser._actions for name in action.option_strings}


def lines_of(text):
    """Lines of the shell in the blocks of a page, with those that go on joined."""
    blocks = re.findall(r"^```(?:bash|console|sh)?\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]


def test_commands_on_pages_have_the_options_that_they_are_called_with(parsers):
    seen, wrong = 0, []
    for page in PAGES:
        for line in lines_of(page.read_text(encoding="utf-8")):
            call = re.search(r"(?:tracked-env ([a-z]+)|(train|evaluate)\.py)( .*|$)", line)
            command = call and (call[1] or call[2])
            if not command or command not in parsers:
                continue
            rest = re.split(r"[|;&#]", call[3])[0]
            names = [word.split("=")[0] for word in re.findall(r"(?<=\s)--[a-z][\w.=-]*", rest)]
            seen += len(names)
            known = known_options(parsers[command])
            wrong += [f"{page.name}: {line}: {name}" for name in names if name not in known]
    assert wrong == [] and seen > 50


def test_every_option_that_a_page_names_exists(parsers):
    known = {name for parser in parsers.values() for name in known_options(parser)}
    scripts = [*ROOT.glob("benchmarks/**/*.py"), *ROOT.glob("docs/*.py"), *ROOT.glob("agents/*.py")]
    scripts += [*ROOT.glob("tests/tools/*.py"), ROOT / "tests/baselines/observer_runs.py"]
    for script in scripts:
        known |= set(re.findall(r"\"(--[a-z][\w.-]*)\"", script.read_text(encoding="utf-8")))
    known |= {name for names in FOREIGN.values() for name in shlex.split(names)}
    wrong = [
        f"{page.relative_to(ROOT)}: {name}"
        for page in PAGES
        for name in re.findall(r"(?<![\w-])--[a-z][\w.-]*\w", page.read_text(encoding="utf-8"))
        if name not in known and "train" in parsers
    ]
    assert wrong == []
