"""What a command says where it keeps the user waiting."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

PATIENCE = 4.0  # [s] without a word
COMPILING = "compiling kernels, once after an installation: about a minute ..."


@contextmanager
def explained(text: str = COMPILING, after: float = PATIENCE) -> Iterator[None]:
    """Print `text` to the standard error if the block takes longer than `after` [s]."""
    timer = threading.Timer(after, lambda: print(text, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
