"""Exit status of a command: errors as one line, and the end at Ctrl-C."""

import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import wraps

Main = Callable[[Sequence[str], str], int]


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
