"""A fixed part of the jobs, for arrays of independent processes such as those of SLURM."""

import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple


class Shard(NamedTuple):
    """One part of several, counted from 1; written 2/3."""

    part: int
    parts: int

    def __str__(self) -> str:
        return f"{self.part}/{self.parts}"

    def of(self, jobs: Iterable[Any]) -> Iterator[Any]:
        """The jobs of this part; those of all parts are everything, and no two parts share one.

        Jobs are dealt out in rounds, each begun one part later: policies take turns in them, and
        no part is to get all chunks of the slowest one.
        """
        return (
            job for i, job in enumerate(jobs) if (i + i // self.parts) % self.parts == self.part - 1
        )


def parse_shard(text: str) -> Shard:
    """I/N with 1 <= I <= N. Raises ValueError."""
    match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    shard = Shard(int(match[1]), int(match[2])) if match else Shard(0, 0)
    if not 1 <= shard.part <= shard.parts:
        raise ValueError(
            f"shard {text!r:.40}; must be I/N with 1 <= I <= N, as 1/8 to 8/8. Is the array of "
            "SLURM counted from 0? Use --array=1-N"
        )
    return shard
