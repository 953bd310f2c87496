"""Options from the fields of a dataclass, errors as one line, and the end at Ctrl-C.

A field is an option of its name, its type says what is read, and the text below it is its help:

    @dataclass(frozen=True)
    class Config:
        episodes: int = 32
        '''Episodes of each set.'''

    parser = Parser("program", "What it does.")
    add_fields(parser, Config)
    config = from_fields(Config, parser.parse_args(["--episodes", "3"]))

    bool                --NAME and --no-NAME
    Literal             one of its values
    tuple[X, ...]       one or more, as a tuple
    X | None            as X; None where it is left out
    another dataclass   its fields as --NAME.FIELD, in a group of their own
The metadata of a field replace what follows from its type: they are arguments of `add_argument`.
"""

import argparse
import ast
import difflib
import errno
import inspect
import os
import re
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import cache, wraps
from itertools import chain, pairwise
from pathlib import Path
from types import MappingProxyType, NoneType
from typing import Any, Literal, NoReturn, TypeVar, get_args, get_origin, get_type_hints

T = TypeVar("T")
WORDS = {int: "INTEGER", float: "NUMBER", str: "TEXT", Path: "PATH"}  # for a value in the help
PATIENCE = 4.0  # [s] without a word
ROOT = Path(__file__).resolve().parents[2]  # the clone, where this package lies in one
COMPILING = (
    "compiling kernels, once after an installation: about a minute ... "
    "(`tracked-env compile` does it ahead, for all)"
)


class Parser(argparse.ArgumentParser):
    """Reads the arguments of a program; what is wrong is one line on stderr and exit status 2.

    Names of options are not understood from their beginning alone; what is near an unknown one is
    named.
    """

    def __init__(self, program: str, description: str, **more: Any) -> None:
        super().__init__(prog=program, description=description, allow_abbrev=False, **more)
        number = "a number, with a point for decimals and without a unit"
        self.register("type", int, as_argument(int, "a whole number"))
        self.register("type", float, as_argument(float, number))

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Read the arguments; a folder of --output that cannot be written is refused here, before
        any work."""
        options = super().parse_args(args, namespace)
        folder = getattr(options, "output", None)
        if isinstance(folder, Path):
            place = next(each for each in (folder, *folder.absolute().parents) if each.exists())
            if not place.is_dir():
                self.error(f"--output: {folder}: {place} is a file; must be a folder")
            if not os.access(place, os.W_OK | os.X_OK):
                self.error(f"--output: {folder}: {place} must be writable. May you write there?")
        return options

    def error(self, message: str) -> NoReturn:
        """End the program."""
        text = message.removeprefix("argument ")
        allowed = [name for each in self._actions for name in each.option_strings]
        wrong = re.match(r"unrecognized arguments: (--[\w.-]+)", text)
        if choice := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", text):
            wrong, allowed = choice, [name.strip("'") for name in choice[2].split(", ")]
        near = difflib.get_close_matches(wrong[1], allowed, n=1) if wrong else []
        hint = f"; did you mean {near[0]}?" if near else ""
        self.exit(2, f"{self.prog}: {text}{hint} (see {self.prog} --help)\n")


def as_argument(parse: Callable[[str], T], must: str = "") -> Callable[[str], T]:
    """A function that reads an argument, with its ValueError as a message of the parser.

    must: what the value has to be, where that error does not say it.
    """

    def argument(text: str) -> T:
        try:
            return parse(text)
        except ValueError as error:
            wrong = f"{text}; must be {must}" if must else str(error)
            raise argparse.ArgumentTypeError(wrong) from error

    return argument


class _AsTuple(argparse.Action):
    """Stores the values of an option as a tuple; of tuples all their values, each once."""

    def __call__(self, parser: object, namespace: Any, values: Any, option: object = None) -> None:
        if isinstance(values[0], tuple):
            values = dict.fromkeys(chain.from_iterable(values))
        setattr(namespace, self.dest, tuple(values))


def option(default: Any, **arguments: Any) -> Any:
    """A field with a default and with arguments of `add_argument`."""
    return field(default=default, metadata=arguments)


@cache
def help_of(kind: type) -> dict[str, str]:
    """The text below each field of a dataclass, those of its bases too."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        with suppress(OSError, TypeError):  # built in, or made in memory
            body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0].body  # type: ignore[attr-defined]
            for line, text in pairwise(body):
                if isinstance(line, ast.AnnAssign) and isinstance(text, ast.Expr):
                    words = ast.literal_eval(text.value).split()
                    texts[ast.unparse(line.target)] = " ".join(words)
    return texts


def _reading(hint: Any) -> dict[str, Any]:
    """What argparse needs to read a value of a type."""
    if NoneType in get_args(hint):
        (hint,) = (part for part in get_args(hint) if part is not NoneType)
    if hint is bool:
        return {"action": argparse.BooleanOptionalAction}
    if get_origin(hint) is Literal:
        return {"choices": get_args(hint)}
    if get_origin(hint) is tuple:
        return {**_reading(get_args(hint)[0]), "nargs": "+", "action": _AsTuple}
    return {"type": hint, "metavar": WORDS.get(hint)}


def add_field(
    parser: Any,
    kind: type,
    name: str,
    text: str | None = None,
    prefix: str = "",
    ranges: Mapping[str, str] = MappingProxyType({}),
    **changed: Any,
) -> None:
    """A field of a dataclass as an option --PREFIX.NAME of a parser or a group of it.

    text: its help, where it is not the text below the field. ranges: of numbers, by the name of the
    field, for the help. changed: further arguments of `add_argument`, in place of what the field
    says.
    """
    (each,) = (each for each in fields(kind) if each.name == name)
    default = each.default if each.default_factory is MISSING else each.default_factory()
    arguments = {**_reading(get_type_hints(kind)[name]), "default": default}
    arguments |= {**each.metadata, **changed}
    default = arguments["default"]
    help_text = help_of(kind).get(name, "") if text is None else text
    notes = [f"in {ranges[name]}"] if name in ranges else []
    if isinstance(default, bool):
        notes.append(f"default: {'yes' if default else 'no'}")
    elif default is not None:
        words = default if isinstance(default, tuple) else (default,)
        notes.append(f"default: {' '.join(map(str, words))}")
    elif "default" not in help_text.lower() and not arguments.get("required"):
        notes.append("default: none")
    help_text += f" ({'; '.join(notes)})" if notes else ""
    where = f"{prefix}.{name}" if prefix else name
    help_text = help_text.lstrip().replace("%", "%%")
    parser.add_argument(f"--{where.replace('_', '-')}", dest=where, help=help_text, **arguments)


def add_fields(
    parser: Any,
    kind: type,
    prefix: str = "",
    ranges: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """The fields of a dataclass as options; ranges: as `add_field`."""
    hints = get_type_hints(kind)
    for each in fields(kind):
        if is_dataclass(hints[each.name]):
            nested = f"{prefix}.{each.name}" if prefix else each.name
            text = help_of(kind).get(each.name) or hints[each.name].__doc__
            group = parser.add_argument_group(nested.replace("_", "-"), text)
            add_fields(group, hints[each.name], prefix=nested, ranges=ranges)
        else:
            add_field(parser, kind, each.name, prefix=prefix, ranges=ranges)


def from_fields(kind: type[T], namespace: argparse.Namespace, prefix: str = "") -> T:
    """A dataclass from the options of a command line; options that are not there: its defaults."""
    options, hints, values = vars(namespace), get_type_hints(kind), {}
    for each in fields(kind):  # type: ignore[arg-type]
        where = f"{prefix}.{each.name}" if prefix else each.name
        if is_dataclass(hints[each.name]):
            values[each.name] = from_fields(hints[each.name], namespace, where)
        elif where in options:
            values[each.name] = options[where]
    return kind(**values)


@dataclass(frozen=True)
class EnvironmentOptions:
    """What of a user's own is put into an environment, by the same options of all commands."""

    vehicle: str | None = option(None, metavar="NAME|FILE.toml|JSON")
    """Vehicle, in place of the usual one: a name (`tracked-env vehicle` lists them), your file
    (TOML, as `tracked-env identify` writes it), or JSON: '{"base": "focchi", "mass": 60}'. What is
    uncertain is drawn around it. By default strawa in Torque-v0, focchi in Speed-v0 and
    Terrain-v0."""

    env_args: str | None = option(None, metavar="JSON|FILE.json")
    """Further arguments of the environment: '{"plant": "distributed"}'."""


def vehicle_spec(text: str | None) -> Any:
    """What --vehicle says, as `tracked_env.vehicles.find_vehicle` takes it; None for None.

    A set of parameters that `tracked-env identify` wrote (FILE.json) is a vehicle too. Raises
    ValueError for one without a vehicle, and as `name_or_json`.
    """
    from tracked_env.validation import name_or_json  # here: it loads numba

    spec: Any = name_or_json(text, "vehicle")
    if isinstance(spec, dict) and "contradictions" in spec:
        raise ValueError(
            f"--vehicle: {text} is of a log that contradicts its model, and has no vehicle; must "
            "have one. Its entry `contradictions` says why"
        )
    if isinstance(spec, dict) and "make" in spec:
        spec = spec["make"].get("vehicle", {})
    return spec


# Likely causes, by the number of the system's error.
CAUSES = {
    errno.ENOENT: "Is the name right, and the current folder the one you mean?",
    errno.EISDIR: "A file is needed there; did you leave out its name?",
    errno.EEXIST: "A file stands where a folder is needed; name another one.",
    errno.ENOTDIR: "A file stands where a folder is needed; name another one.",
    errno.EACCES: "May you read and write there?",
    errno.EROFS: "Name a folder that can be written.",
    errno.ENOSPC: "Name a folder on another disk.",
}


def one_line(error: Exception) -> str:
    """What an error says, of a file with its name first and the likely cause."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        cause = CAUSES.get(error.errno or 0, "")
        return f"{error.filename}: {error.strerror.lower()}. {cause}".rstrip()
    return str(error)


def reported(main: Callable[..., int]) -> Callable[..., int]:
    """`main` with errors as one line on stderr that begins with the name of the program.

    Exit status 2 for arguments that make no sense (ValueError), 1 for a policy that fails, a file,
    or a package that is missing.
    """

    @wraps(main)
    def ended(arguments: Any, program: str, *more: Any) -> int:
        # Here, because this file is imported before Ctrl-C ends a command with one line.
        from tracked_env.benchmark.policy_interface import PolicyError

        try:
            return main(arguments, program, *more)
        except BrokenPipeError:  # nobody reads on: no error of the command
            raise
        except (PolicyError, ImportError, OSError) as error:
            print(f"{program}: {one_line(error)}", file=sys.stderr)
            return 1
        except ValueError as error:
            print(f"{program}: {error}", file=sys.stderr)
            return 2

    return ended


@contextmanager
def explained(after: float | None = None) -> Iterator[None]:
    """Print COMPILING to the standard error if the block takes longer than `after` [s], by default
    PATIENCE. On a terminal the kernels say it themselves (`kernel_cache`)."""
    if sys.stderr.isatty():
        yield
        return
    wait = PATIENCE if after is None else after
    timer = threading.Timer(wait, lambda: print(COMPILING, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def end_at_interrupt(program: str) -> None:
    """End this process with status 130 at Ctrl-C, in the middle of a compilation too.

    An exception there would be lost or replaced. Finished episodes are on disk, and what else is
    left behind is removed by the next run.
    """

    def stop(signum: int, frame: object) -> None:
        with suppress(Exception):
            sys.stdout.flush()
        text = f"\n{program}: interrupted; finished episodes are kept, run it again\n"
        os.write(2, text.encode())
        os._exit(130)  # as shells have it for Ctrl-C

    signal.signal(signal.SIGINT, stop)


def run_script(name: str, arguments: Sequence[str]) -> None:
    """Go on as `python NAME ARGUMENTS`; return where this package lies in no clone with it."""
    if not ((ROOT / name).is_file() and (ROOT / "pyproject.toml").is_file()):
        return
    command = [sys.executable, str(ROOT / name), *arguments]
    sys.stdout.flush()
    if sys.platform == "win32":  # where exec returns to the shell at once
        sys.exit(subprocess.run(command, check=False).returncode)
    os.execv(sys.executable, command)


def train_main(arguments: Sequence[str], program: str) -> int:
    """`tracked-env train`: train.py of the clone."""
    run_script("train.py", arguments)
    raise ValueError(
        "training is not part of the installed package. Clone the repository and run "
        "`make install` there, then `python train.py`"
    )
