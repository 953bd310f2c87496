"""How fast the environment is, beside its peers measured in the same run.

    python benchmarks/speed.py [--seconds 2.0] [--rows REGEX] [--training-steps 100000] [--publish]
    python benchmarks/speed.py --against ../other-clone [--rows REGEX]

Every figure is the best of the same number of passes (the machine's other work only ever slows a
pass down), and comes with its ratio to a peer. What the rows are stands in speed_rows.py. Nothing
is asserted: timings are for reading. `--output` also writes the table as Markdown, `--publish`
into docs/speed.md.

`--against` times another checkout as well, each row in alternation with this one, and prints both.

The row of a training runs train.py as it stands, with its default settings. It needs the extras
`rl` and `cli`; without them it is left out, and that is said. `--training-steps 0` leaves it out.
"""

import argparse
import csv
import io
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from benchmarks import speed_against, speed_rows
from tracked_env import TORQUE_ID as TORQUE
from tracked_env.benchmark.files import replace_block

PASSES = 7
TRAININGS = 3  # of which the fastest counts
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
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        times = [
            float(
                subprocess.run(
                    [sys.executable, "-c", code],
                    env=environment, check=True, capture_output=True, text=True,
                ).stdout
            )
            for _ in range(3)
        ]  # fmt: skip
    return times[0], min(times[1:])


def training_seconds(steps: int) -> float:
    """Seconds per environment step of train.py, learner and checkpoints included.

    The best of TRAININGS of about `steps` steps (whole rollouts), without held-out episodes, after
    a short one that loads what the first step needs. The clock of a training starts when its
    environment and networks are there. Says so where other work held it up. Raises ImportError
    where the extras are missing.
    """
    sys.path.insert(0, str(ROOT))
    try:
        import train
        from agents.options import options_of_train
    except SystemExit as reason:  # train.py says what is missing and how to get it
        raise ImportError(str(reason)) from None
    finally:
        sys.path.remove(str(ROOT))
    best, share = np.inf, 0.0
    for turn in range(TRAININGS + 1):
        began, worked = time.perf_counter(), time.process_time()
        with tempfile.TemporaryDirectory() as output, redirect_stdout(io.StringIO()):
            asked = steps if turn else 1
            config = options_of_train()(
                steps=asked, held_out=0, quiet=True, output=Path(output, "ppo")
            )
            if train.main(config) != 0:
                raise RuntimeError("train.py failed; its message stands above")
            with open(config.folder / "curve.csv", newline="") as file:
                last = list(csv.DictReader(file))[-1]
        if turn:
            best = min(best, float(last["seconds"]) / float(last["steps"]))
            core = (time.process_time() - worked) / (time.perf_counter() - began)
            share = max(share, core)
    if share < FREE_SHARE:
        print(f"trainings had {share:.0%} of a core; repeat on a free machine", file=sys.stderr)
    return float(best)


def training_rows(steps: int) -> list[Row]:
    """The row of a training; none, with a note, where the extras are missing or `steps` is 0."""
    if steps <= 0:
        return []
    try:
        seconds = training_seconds(steps)
    except ImportError as error:
        print(f"no row of a training: {error}", file=sys.stderr)
        return []
    return [Row(TRAINING, 1e6 * seconds, steps, TRAINING_PEER)]


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
    found = [row for row in every if re.search(pattern, row.name)]
    needed = {row.name for row in found} | {row.peer for row in found}
    chain = {row.name: row.peer for row in every}
    needed |= {chain[name] for name in needed}
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


def options() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=float, default=2.0, help="time spent per figure [s]")
    parser.add_argument(
        "--rows", default="", metavar="REGEX", help="only rows whose name matches, and their peers"
    )
    parser.add_argument(
        "--against", type=Path, metavar="PATH", help="compare with another checkout, row by row"
    )
    parser.add_argument(
        "--training-steps", type=int, default=100_000, help="of each training; 0 leaves its row out"
    )
    parser.add_argument("--output", type=Path, help="also write the Markdown table to this file")
    parser.add_argument(
        "--publish", action="store_true", help="also renew the table in docs/speed.md"
    )
    given = parser.parse_args()
    if given.publish and (given.rows or given.against):
        parser.error("--publish needs all rows: leave out --rows and --against")
    return given


def main() -> None:
    """Measure and print."""
    arguments = options()
    every = speed_rows.rows(speed_rows.controllers())
    chosen = with_peers(every, arguments.rows) if arguments.rows else every
    if not chosen:
        raise SystemExit(f"--rows {arguments.rows}: no such row; there are\n" + "\n".join(
            f"  {row.name}" for row in every
        ))  # fmt: skip
    if arguments.against:
        try:
            seconds = arguments.seconds / PASSES
            pairs = speed_against.compare(ROOT, arguments.against, chosen, seconds, PASSES)
        except (ValueError, RuntimeError) as error:
            raise SystemExit(str(error)) from error
        if arguments.output:
            arguments.output.write_text("\n".join(map(speed_against.line, pairs)) + "\n")
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
        replace_block(ROOT / "docs" / "speed.md", "speed table", table)


if __name__ == "__main__":
    main()
