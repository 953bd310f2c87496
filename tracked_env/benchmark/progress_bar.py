"""How far a comparison is, in control steps of vehicles: a bar, or plain lines in a log."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[int, str], None]  # (vehicle steps done since the last call, what runs)
LINE_PERIOD = 30.0  # [s] between two lines where stderr is not a terminal


def no_progress(steps: int, label: str) -> None:
    """Report no progress."""


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


def progress_lines(total: int, clock: Callable[[], float] = time.monotonic) -> Progress:
    """Writes a line to stderr at most every LINE_PERIOD; clock: [s]."""
    done = 0
    began = last = clock()

    def progress(steps: int, label: str) -> None:
        nonlocal done, last
        done += steps
        now = clock()
        if now - last >= LINE_PERIOD and done > 0:
            last = now
            left = (now - began) * max(total - done, 0) / done
            print(
                f"{done / max(total, 1):4.0%} {label}: {_duration(now - began)} elapsed, "
                f"about {_duration(left)} left",
                file=sys.stderr,
                flush=True,
            )

    return progress


@contextmanager
def progress_bar(total: int, quiet: bool = False) -> Iterator[Progress]:
    """A function that reports control steps of vehicles; nothing is shown when quiet.

    On a terminal it shows a bar, when tqdm is installed; elsewhere it writes lines.
    """
    if quiet:
        yield no_progress
        return
    try:
        from tqdm import tqdm
    except ImportError:
        yield progress_lines(total)
        return
    if not sys.stderr.isatty():
        yield progress_lines(total)
        return
    form = "{desc:<28} {percentage:3.0f}% |{bar}| [{elapsed}<{remaining}, {rate_fmt}]"
    with tqdm(
        total=total, unit=" steps", unit_scale=True, bar_format=form, dynamic_ncols=True
    ) as bar:

        def progress(steps: int, label: str) -> None:
            bar.set_description_str(label, refresh=False)
            bar.update(steps)

        yield progress
