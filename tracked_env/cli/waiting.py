"""What a command says where it keeps the user waiting."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

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
