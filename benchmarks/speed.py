"""How fast the environment is, beside its peers measured in the same run.

    python benchmarks/speed.py [--seconds 2.0] [--rows REGEX] [--training-steps 100000] [--publish]
    python benchmarks/speed.py --against ../other-clone [--rows REGEX]

Every figure is the best of the same number of passes (the machine's other work only ever slows a
pass down), and comes with its ratio to a peer. What the rows are stands in speed_rows.py. Nothing
is asserted: timings are for reading. `--output` also writes the table as Markdown, `--publish`
into docs/speed.md.

`--against` times another checkout as well and prints both. Each checkout has a process of its own,
in which its modules are imported; the rows are those of this checkout. A pass of the one is
followed by a pass of the other, and the best of each counts: other work on the machine meets both
alike.

The row of a training runs train.py as it stands, with its default settings. It needs the extras
`rl` and `cli`; without them it is left out, and that is said. `--training-steps 0` leaves it out.
"""

import argparse
import csv
import io
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import speed_rows  # type: ignore[import-not-found]  # beside this file

TORQUE = "tracked_env/Torque-v0"  # by name: the other checkout may lack it
PASSES = 7
TRAININGS = 3  # of which the fastest counts
SLOWER = 1.03  # ratio from which on a row is marked; minima of the same code differ by less
SERVE = "serve"  # first argument of a process that times rows for another one
FREE_SHARE = 0.9  # of a core that a training uses on a free machine
TRAINING = "PPO, 64 vehicles, with learner"
TRAINING_PEER = "Torque-v0 vector, 64, calm"
ROOT = Path(__file__).resolve().parent.parent


class Row(NamedTuple):
    """One line of the table."""

    name: str
    microseconds: float  # per environment step, or per call
    steps: int  # of the environment, per call
    peer: str  # name of the row it is compared with
    ends: float = 0.0  # episodes that end, per 1000 steps


def start_up() -> tuple[float, float]:
    """Seconds until the first step: with an empty kernel cache, and with a full one."""
    code = (
        "import time; t = time.perf_counter()\n"
        "import gymnasium, numpy as np\n"
        f"env = gymnasium.make('tracked_env:{TORQUE}')\n"
        "env.reset(seed=0); env.step(np.zeros(2, np.float32))\n"
        "print(time.perf_counter() - t)"
    )
    command, times = [sys.executable, "-c", code], list[float]()
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        for _ in range(3):
            done = subprocess.check_output(command, env=environment, text=True)
            times.append(float(done))
    return times[0], min(times[1:])


def training_rows(steps: int) -> list[Row]:
    """The row of train.py, learner and checkpoints included, of about `steps` steps (whole
    rollouts), without held-out episodes: the best of TRAININGS, after a short one that loads what
    the first step needs. The clock of a training starts when its environment and networks are
    there. None where `steps` is 0, or with a note where the extras are missing; says so where other
    work held it up.
    """
    if steps <= 0:
        return []
    sys.path.insert(0, str(ROOT))
    try:
        import train
        from agents.options import options_of_train
    except SystemExit as reason:  # train.py says what is missing and how to get it
        print(f"no row of a training: {reason}", file=sys.stderr)
        return []
    finally:
        sys.path.remove(str(ROOT))
    best, share = np.inf, 0.0
    for asked in (1, *[steps] * TRAININGS):
        began, worked = time.perf_counter(), time.process_time()
        with tempfile.TemporaryDirectory() as output, redirect_stdout(io.StringIO()):
            folder = Path(output, "ppo")
            config = options_of_train()(steps=asked, held_out=0, quiet=True, output=folder)
            if train.main(config) != 0:
                raise RuntimeError("train.py failed; its message stands above")
            with open(config.folder / "curve.csv", newline="") as file:
                last = list(csv.DictReader(file))[-1]
        if asked == steps:
            best = min(best, float(last["seconds"]) / float(last["steps"]))
            core = (time.process_time() - worked) / (time.perf_counter() - began)
            share = max(share, core)
    if share < FREE_SHARE:
        print(f"trainings had {share:.0%} of a core; repeat on a free machine", file=sys.stderr)
    return [Row(TRAINING, 1e6 * float(best), steps, TRAINING_PEER)]


def measure(chosen: Sequence[speed_rows.Row], seconds: float) -> list[Row]:
    """Rows of `speed_rows`, each the best of PASSES passes of about `seconds` in all."""
    measured = []
    for row in chosen:
        load = row.make()
        calls = speed_rows.calls_of_a_pass(load, seconds / PASSES)
        best = min(speed_rows.time_of_a_pass(load, calls) for _ in range(PASSES))
        measured.append(Row(row.name, 1e6 * best / row.steps, row.steps, row.peer, load.ends()))
    return measured


def with_peers(every: Sequence[speed_rows.Row], pattern: str) -> list[speed_rows.Row]:
    """Rows whose name contains `pattern` (a regular expression), and their peers."""
    matching = [row for row in every if re.search(pattern, row.name)]
    peers = {row.name: row.peer for row in every}
    needed = {row.name for row in matching} | {row.peer for row in matching}
    needed |= {peers[name] for name in needed}
    return [row for row in every if row.name in needed]


def markdown(rows: list[Row], begun: tuple[float, float] | None) -> str:
    """The table and what it was measured on; begun: what `start_up` returned."""
    times = {row.name: row.microseconds for row in rows}
    lines = [
        "| what | us per step | steps/s | time over peer | peer | ends per 1000 steps |",
        "|--|--|--|--|--|--|",
    ]
    for row in rows:
        ratio = row.microseconds / times.get(row.peer, np.nan)
        ends = f"{row.ends:.2g}" if row.ends else "-"
        lines.append(
            f"| {row.name} | {row.microseconds:.2f} | {1e6 / row.microseconds:,.0f} "
            f"| {ratio:.2f} | {row.peer} | {ends} |"
        )
    env: Any = gymnasium.make_vec(TORQUE, num_envs=64).unwrapped
    memory = sum(array.nbytes for array in env.simulation.batch) // env.num_envs / 1024
    first_step = learner = ""
    if begun:
        first_step = (
            f"First step of a fresh process: {begun[0]:.1f} s with an empty kernel cache "
            f"(compilation), {begun[1]:.2f} s with a full one."
        )
    if TRAINING in times:
        learner = (
            f" PPO: the default settings of train.py, fastest of {TRAININGS}, "
            f"PyTorch {version('torch')}, Stable-Baselines3 {version('stable-baselines3')}."
        )
    lines += [
        "",
        f"Memory of one vehicle: {memory:.1f} KiB (30 s episode). " + first_step,
        "",
        f"Python {platform.python_version()}, NumPy {np.__version__}, Gymnasium "
        f"{gymnasium.__version__}, {os.cpu_count()} cores ({platform.machine()}), one process, "
        "50 Hz control, 8 RK4 sub-steps per step, two threads from 512 vehicles on." + learner,
    ]
    return "\n".join(lines)


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

    def __init__(self, checkout: Path, registered: Sequence[tuple[str, str]]) -> None:
        """Raises ValueError for a folder without the package."""
        self.checkout = checkout.resolve()
        if not (self.checkout / "tracked_env" / "__init__.py").is_file():
            raise ValueError(f"--against {checkout}: no package tracked_env there; must be a clone")
        paths = [str(self.checkout), os.environ.get("PYTHONPATH", "")]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
        command = [sys.executable, __file__, SERVE, str(self.checkout), json.dumps(registered)]
        pipe, folder = subprocess.PIPE, self.checkout
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, text=True, cwd=folder, env=environment
        )

    def ask(self, **request: Any) -> Mapping[str, Any]:
        """What the process answers. Raises RuntimeError when it has ended."""
        requests, answers = self._process.stdin, self._process.stdout
        assert requests is not None and answers is not None
        try:
            print(json.dumps(request), file=requests, flush=True)
            answer = answers.readline()
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
        answers = [worker.ask(row=name, seconds=seconds) for worker in (ours, theirs)]
        reasons = [str(answer["error"]) for answer in answers if "error" in answer]
        best = [float("nan" if "error" in answer else "inf") for answer in answers]
        calls = max(int(answer.get("calls", 0)) for answer in answers)
        for _ in range(passes):
            for k, worker in enumerate((ours, theirs)):
                if "error" not in answers[k]:
                    best[k] = min(best[k], float(worker.ask(calls=calls)["seconds"]))
        yield Pair(name, 1e6 * best[0] / steps, 1e6 * best[1] / steps, "; ".join(reasons))


def line(pair: Pair) -> str:
    """One line of the table."""
    note = " slower" if pair.ratio > SLOWER else ""
    note += f" {pair.reason}" if pair.reason else ""
    return f"| {pair.name} | {pair.ours:.3f} | {pair.theirs:.3f} | {pair.ratio:.3f}{note} |"


def compare(
    ours: Path, theirs: Path, chosen: Sequence[speed_rows.Row], seconds: float, passes: int
) -> list[Pair]:
    """Time rows of both checkouts and print the table line by line. Raises ValueError."""
    registered = speed_rows.controllers()
    workers: list[Worker] = []
    pairs = []
    try:
        workers += [Worker(checkout, registered) for checkout in (ours, theirs)]
        print("| what | us per step | there | time over that there |\n|--|--|--|--|", flush=True)
        names = [(row.name, row.steps) for row in chosen]
        for pair in compared(names, workers[0], workers[1], seconds, passes):
            pairs.append(pair)
            print(line(pair), flush=True)
    finally:
        for worker in workers:
            worker.close()
    return pairs


def serve(checkout: Path, registered: Sequence[tuple[str, str]]) -> None:
    """Answer requests, one JSON object a line: make a row, or time a pass of it."""
    import tracked_env

    if checkout not in Path(tracked_env.__file__).resolve().parents:
        raise SystemExit(f"{checkout}: another tracked_env was imported, {tracked_env.__file__}")
    by_name = {row.name: row for row in speed_rows.rows(registered)}
    answers, sys.stdout = sys.stdout, sys.stderr  # what rows print does not get in between
    load = speed_rows.Load(lambda: None)
    for text in sys.stdin:
        request = json.loads(text)
        answer: dict[str, Any] = {}
        if "row" in request:
            try:
                load = by_name[request["row"]].make()
                answer["calls"] = speed_rows.calls_of_a_pass(load, request["seconds"])
            except Exception as error:  # of another version, whatever it says
                answer["error"] = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        else:
            answer["seconds"] = speed_rows.time_of_a_pass(load, request["calls"])
        print(json.dumps(answer), file=answers, flush=True)


def options() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=float, default=2.0, help="time spent per figure [s]")
    text = "only rows whose name matches, and their peers"
    parser.add_argument("--rows", default="", metavar="REGEX", help=text)
    text = "compare with another checkout, row by row"
    parser.add_argument("--against", type=Path, metavar="PATH", help=text)
    text = "of each training; 0 leaves its row out"
    parser.add_argument("--training-steps", type=int, default=100_000, help=text)
    parser.add_argument("--output", type=Path, help="also write the Markdown table to this file")
    text = "also renew the table in docs/speed.md"
    parser.add_argument("--publish", action="store_true", help=text)
    arguments = parser.parse_args()
    if arguments.publish and (arguments.rows or arguments.against):
        parser.error("--publish needs all rows: leave out --rows and --against")
    return arguments


def main() -> None:
    """Measure and print."""
    arguments = options()
    every = speed_rows.rows(speed_rows.controllers())
    chosen = with_peers(every, arguments.rows) if arguments.rows else every
    if not chosen:
        names = "\n".join(f"  {row.name}" for row in every)
        raise SystemExit(f"--rows {arguments.rows}: no such row; there are\n{names}")
    if arguments.against:
        try:
            seconds = arguments.seconds / PASSES
            pairs = compare(ROOT, arguments.against, chosen, seconds, PASSES)
        except (ValueError, RuntimeError) as error:
            raise SystemExit(str(error)) from error
        if arguments.output:
            arguments.output.write_text("\n".join(map(line, pairs)) + "\n")
        return
    begun = None if arguments.rows else start_up()
    rows = measure(chosen, arguments.seconds)
    if begun:
        rows += training_rows(arguments.training_steps)
    table = markdown(rows, begun)
    print(table)
    if arguments.output:
        arguments.output.write_text(table + "\n")
    if arguments.publish:
        from tracked_env.benchmark.files import replace_block  # not in other checkouts

        replace_block(ROOT / "docs" / "speed.md", "speed table", table)


if __name__ == "__main__":
    if sys.argv[1:2] == [SERVE]:
        serve(Path(sys.argv[2]), json.loads(sys.argv[3]))
    else:
        main()
