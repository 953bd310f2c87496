"""What Ctrl-C does to a command: it ends at once, with one line."""

import os
import signal
import sys
from contextlib import suppress


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
