"""Exit status of a command: errors as one line, and the end at Ctrl-C.

What a command says where it keeps the user waiting.
"""

import argparse
import difflib
import errno
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any, NoReturn

Main = Callable[[Sequence[str], str], int]


class Parser(argparse.ArgumentParser):
    """Reads the arguments of a program; what is wrong is one line on stderr and exit status 2.

    Names of options are not understood from their beginning alone; what is near an unknown one is
    named.
    """

    def __init__(self, program: str, description: str, **more: Any) -> None:
        super().__init__(prog=program, description=description, allow_abbrev=False, **more)
        self.register("type", int, _whole)
        self.register("type", float, _number)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Read the arguments; a folder of --output that cannot be written is refused here, before
        any work."""
        read = super().parse_args(args, namespace)
        folder = getattr(read, "output", None)
        if isinstance(folder, Path):
            place = next(of for of in (folder, *folder.absolute().parents) if of.exists())
            if not place.is_dir():
                self.error(f"--output: {folder}: {place} is a file; must be a folder")
            if not os.access(place, os.W_OK | os.X_OK):
                self.error(f"--output: {folder}: {place} must be writable. May you write there?")
        return read

    def error(self, message: str) -> NoReturn:
        """End the program."""
        said = message.removeprefix("argument ")
        near = difflib.get_close_matches(*self._wrong_and_known(said), n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        self.exit(2, f"{self.prog}: {said}{hint} (see {self.prog} --help)\n")

    def _wrong_and_known(self, message: str) -> tuple[str, list[str]]:
        """A name that is not known, of a message of argparse, and those that are."""
        if option := re.match(r"unrecognized arguments: (--[\w-]+)", message):
            return option[1], [name for each in self._actions for name in each.option_strings]
        if choice := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            return choice[1], [name.strip("'") for name in choice[2].split(", ")]
        return "", []


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}; must be a whole number") from error


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"{text}; must be a number, with a point for decimals and without a unit"
        ) from error


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


def reported(main: Main) -> Main:
    """`main` with errors as one line on stderr that begins with the name of the program.

    Exit status 2 for arguments that make no sense (ValueError), 1 for a policy that fails, a file,
    or a package that is missing.
    """

    @wraps(main)
    def ended(arguments: Sequence[str], program: str) -> int:
        # Here, because this file is imported before Ctrl-C ends a command with one line.
        from tracked_env.benchmark.policy_interface import PolicyError

        try:
            return main(arguments, program)
        except BrokenPipeError:  # nobody reads on: no error of the command
            raise
        except (PolicyError, ImportError, OSError) as error:
            print(f"{program}: {one_line(error)}", file=sys.stderr)
            return 1
        except ValueError as error:
            print(f"{program}: {error}", file=sys.stderr)
            return 2

    return ended


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


PATIENCE = 4.0  # [s] without a word
COMPILING = "compiling kernels, once after an installation: about a minute ..."


@contextmanager
def explained(text: str = COMPILING, after: float | None = None) -> Iterator[None]:
    """Print `text` to the standard error if the block takes longer than `after` [s].

    None: PATIENCE.
    """
    wait = PATIENCE if after is None else after
    timer = threading.Timer(wait, lambda: print(text, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
