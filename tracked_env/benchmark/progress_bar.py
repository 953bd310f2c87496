"""How far a comparison is, in control steps of vehicles."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[int, str], None]  # (vehicle steps done since the last call, what runs)


def no_progress(steps: int, label: str) -> None:
    """Report no progress."""


@contextmanager
def progress_bar(total: int) -> Iterator[Progress]:
    """A function that reports control steps of vehicles; shows a bar when tqdm is installed."""
    try:
        from tqdm import tqdm
    except ImportError:
        yield lambda steps, label: None
        return
    form = "{desc:<28} {percentage:3.0f}% |{bar}| [{elapsed}<{remaining}, {rate_fmt}]"
    with tqdm(
        total=total, unit=" steps", unit_scale=True, bar_format=form, dynamic_ncols=True
    ) as bar:

        def progress(steps: int, label: str) -> None:
            bar.set_description_str(label, refresh=False)
            bar.update(steps)

        yield progress
