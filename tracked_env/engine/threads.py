"""A function over many rows, on several threads. Kernels release the interpreter lock."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


class Threads:
    """Runs a function over equal shares of the rows; threads start with the first run."""

    def __init__(self, count: int) -> None:
        """count: threads, with that of the caller."""
        self.count = count
        self._pool: ThreadPoolExecutor | None = None

    @property
    def started(self) -> bool:
        """Whether there are threads beside that of the caller."""
        return self._pool is not None

    def run(self, function: Callable[[int, int], int], size: int, lanes: int = 1) -> list[int]:
        """Results of function(first, last) for shares of `size` rows, the caller's share first.

        lanes: rows that belong together; a share begins at a multiple of it.
        """
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.count - 1, "tracked_env")
        blocks = -(-size // lanes)
        share = -(-blocks // self.count) * lanes
        parts = [
            self._pool.submit(function, first, min(first + share, size))
            for first in range(share, size, share)
        ]
        return [function(0, min(share, size)), *(part.result() for part in parts)]

    def close(self) -> None:
        """End the threads; a later run starts new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
