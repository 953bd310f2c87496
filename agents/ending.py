"""How train.py and evaluate.py end early: in one line, with the exit status that a shell expects.

    130   interrupted with Ctrl-C
    2     wrong settings, a training that diverged, a folder that cannot be written
It imports nothing that takes time, so that Ctrl-C has an answer while everything else is imported.
"""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

INTERRUPTED = 130
REFUSED = 2


class Refused(Exception):
    """What is asked for cannot be trained; nothing has been written."""


def stop_at_once(line: str) -> None:
    """From now on Ctrl-C prints `line` and ends the process without unwinding.

    An exception in the middle of an import or a compilation would be lost or replaced. What is to
    be kept must be whole on the disk at any time. A process in the background, for which the shell
    has switched Ctrl-C off, stays as it is.
    """

    def stop(*_: object) -> None:
        with suppress(Exception):
            sys.stdout.flush()
        os.write(2, f"{line}\n".encode())
        os._exit(INTERRUPTED)

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop)


def raise_again() -> None:
    """Undo `stop_at_once`: Ctrl-C raises KeyboardInterrupt."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def refusing(*errors: type[Exception]) -> Iterator[None]:
    """Turn the errors of wrong settings into Refused."""
    try:
        yield
    except errors as error:
        raise Refused(error) from error
    except MemoryError as error:
        raise Refused(f"{error}. Lower vehicles, n_steps or the sizes of buffers") from error


def failed(text: object) -> int:
    """Say in one line what is wrong; returns the exit status."""
    print("train.py:", " ".join(str(text).split()), file=sys.stderr)
    return REFUSED


def interrupted(folder: object, resumable: bool) -> int:
    """Say in one line how to go on; returns the exit status."""
    way = "go on with --resume" if resumable else "no checkpoint yet, begin anew with --overwrite"
    print(f"interrupted; {way} --output {folder}", file=sys.stderr)
    return INTERRUPTED
