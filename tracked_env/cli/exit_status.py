"""Exit status of a command: errors as one line, and the end at Ctrl-C."""

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import wraps
from typing import Any, NoReturn

Main = Callable[[Sequence[str], str], int]


class Parser(argparse.ArgumentParser):
    """Reads the arguments of a program; what is wrong is one line on stderr and exit status 2.

    Names of options are not understood from their beginning alone.
    """

    def __init__(self, program: str, description: str, **more: Any) -> None:
        super().__init__(prog=program, description=description, allow_abbrev=False, **more)

    def error(self, message: str) -> NoReturn:
        """End the program."""
        said = message.removeprefix("argument ")
        self.exit(2, f"{self.prog}: {said} (see {self.prog} --help)\n")


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
            print(f"{program}: {error}", file=sys.stderr)
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
