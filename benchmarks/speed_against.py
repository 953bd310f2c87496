"""Two checkouts timed row by row in alternation: `python benchmarks/speed.py --against PATH`.

Each checkout has a process of its own, in which its modules are imported; the rows, in
`speed_rows`, are those of this checkout. A pass of the one is followed by a pass of the other, and
the best of each counts, so that other work on the machine meets both alike.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import speed_rows

SCRIPT = Path(__file__).resolve()
SLOWER = 1.03  # ratio from which on a row is marked; minima of the same code differ by less


class Pair(NamedTuple):
    """Best times of a row [us per step]; NaN where a checkout has no such row."""

    name: str
    ours: float
    theirs: float
    reason: str = ""  # why there is none

    @property
    def ratio(self) -> float:
        """Ours over theirs."""
        return self.ours / self.theirs


class Worker:
    """A process that times rows with the modules of a checkout."""

    def __init__(self, checkout: Path, known: Sequence[tuple[str, str]]) -> None:
        """Raises ValueError for a folder without the package."""
        self.checkout = checkout.resolve()
        if not (self.checkout / "tracked_env" / "__init__.py").is_file():
            raise ValueError(f"--against {checkout}: no package tracked_env there; must be a clone")
        paths = [str(self.checkout), os.environ.get("PYTHONPATH", "")]
        self._process = subprocess.Popen(
            [sys.executable, str(SCRIPT), str(self.checkout), json.dumps(known)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=self.checkout,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)},
        )  # fmt: skip

    def ask(self, **request: Any) -> Mapping[str, Any]:
        """What the process answers. Raises RuntimeError when it has ended."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            raise RuntimeError(f"the process of {self.checkout} has ended; its message is above")
        return dict(json.loads(answer))

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def compared(
    names: Iterable[tuple[str, int]], ours: Worker, theirs: Worker, seconds: float, passes: int
) -> Iterator[Pair]:
    """Rows (name, steps of a call), each with `passes` passes of both checkouts."""
    for name, steps in names:
        made = [worker.ask(row=name, seconds=seconds) for worker in (ours, theirs)]
        reasons = [str(answer["error"]) for answer in made if "error" in answer]
        best = [float("nan") if "error" in answer else float("inf") for answer in made]
        calls = max((int(answer["calls"]) for answer in made if "error" not in answer), default=0)
        for _ in range(passes):
            for k, worker in enumerate((ours, theirs)):
                if "error" not in made[k]:
                    best[k] = min(best[k], float(worker.ask(calls=calls)["seconds"]))
        yield Pair(name, 1e6 * best[0] / steps, 1e6 * best[1] / steps, "; ".join(reasons))


def line(pair: Pair) -> str:
    """One line of the table."""
    mark = " slower" if pair.ratio > SLOWER else ""
    said = f" {pair.reason}" if pair.reason else ""
    return f"| {pair.name} | {pair.ours:.3f} | {pair.theirs:.3f} | {pair.ratio:.3f}{mark}{said} |"


def compare(
    ours: Path, theirs: Path, chosen: Sequence[speed_rows.Row], seconds: float, passes: int
) -> list[Pair]:
    """Time rows of both checkouts and print the table line by line. Raises ValueError."""
    known = speed_rows.controllers()
    workers: list[Worker] = []
    pairs = []
    try:
        workers += [Worker(checkout, known) for checkout in (ours, theirs)]
        print("| what | us per step | there | time over that there |\n|--|--|--|--|", flush=True)
        names = [(row.name, row.steps) for row in chosen]
        for pair in compared(names, workers[0], workers[1], seconds, passes):
            pairs.append(pair)
            print(line(pair), flush=True)
    finally:
        for worker in workers:
            worker.close()
    return pairs


def serve(checkout: Path, known: Sequence[tuple[str, str]]) -> None:
    """Answer requests, one JSON object a line: make a row, or time a pass of it."""
    import tracked_env

    if checkout not in Path(tracked_env.__file__).resolve().parents:
        raise SystemExit(f"{checkout}: another tracked_env was imported, {tracked_env.__file__}")
    made = {row.name: row for row in speed_rows.rows(known)}
    answers, sys.stdout = sys.stdout, sys.stderr  # what rows print does not get in between
    load = speed_rows.Load(lambda: None)
    for text in sys.stdin:
        request = json.loads(text)
        answer: dict[str, Any] = {}
        if "row" in request:
            try:
                load = made[request["row"]].make()
                answer["calls"] = speed_rows.calls_of_a_pass(load, request["seconds"])
            except Exception as error:  # of another version, whatever it says
                answer["error"] = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        else:
            answer["seconds"] = speed_rows.time_of_a_pass(load, request["calls"])
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    serve(Path(sys.argv[1]), json.loads(sys.argv[2]))
