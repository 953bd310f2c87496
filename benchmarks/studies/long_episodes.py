"""What an hour of driving does to `adaptive`: the error of its minutes, and memory that it takes.

    python -m benchmarks.studies.long_episodes                    # an hour of every case
    python -m benchmarks.studies.long_episodes --case laps --minutes 20 --policy mpc-adaptive

Cases, of Torque-v0 on episodes of the development split:
    drift    the law `drift`: soil and load slide from nominal to others
    wear     soil and load are unknown; both drives lose up to half of their torque, slowly
    laps     an eight, lap after lap over the resistances of one map
The error of a minute is the RMSE of the distance to the reference over all vehicles. Memory is what
is resident beyond that after the second minute, in which everything has been called.
"""

import sys
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.studies import Cells, show
from tracked_env import TORQUE_ID, make_vec
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT
from tracked_env.benchmark.policies import policies_for
from tracked_env.benchmark.policy_interface import PolicyContext, checked_policy, needs_truth
from tracked_env.benchmark.runner import steps_of
from tracked_env.cli.command_line import Parser, reported
from tracked_env.sensors import RTK

PERIOD = 0.02  # [s]
MINUTE = 3000  # [steps]
REMAINING = (0.8, 0.5)  # [-] of the torque of a worn drive, right and left
PAGE = 4096  # [B] of /proc/self/statm


def case_arguments(case: str, duration: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Arguments of the environment, and options of its reset."""
    if case == "drift":
        return {"uncertainty": "drift"}, {}
    if case == "wear":
        ramp = {"kind": "ramp", "start": 60.0, "duration": duration - 60.0}
        worn = zip(("actuator_gain_right", "actuator_gain_left"), REMAINING, strict=True)
        schedule = [{**ramp, "parameter": name, "target": share} for name, share in worn]
        return {"uncertainty": "soil-and-mass"}, {"schedule": schedule}
    eight = {"kind": "figure_eight", "speed": 2.0, "size": 40.0}
    return {"uncertainty": "resistance-map", "reference": eight}, {}


def resident() -> float:
    """Memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 1e6


def minutes_of(
    name: str, case: str, count: int, minutes: int
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.bool_], float]]:
    """(RMSE (count,) [m], rows that have ended, resident memory [MB]) minute after minute."""
    arguments, options = case_arguments(case, 60.0 * minutes)
    policy: Any = checked_policy(
        policies_for(TORQUE_ID, [name])[0], PolicyContext(PERIOD, "sliding", RTK)
    )
    arguments |= {"duration": 60.0 * minutes, "expose_truth": needs_truth(policy)}
    env: Any = make_vec(TORQUE_ID, count, autoreset_mode="Disabled", **arguments)
    steps = steps_of(policy, env, range(DEVELOPMENT, DEVELOPMENT + count), options=options)
    over = next(steps).over.copy()  # of the reset
    for _ in range(minutes):
        squares = np.zeros(count)
        for step in islice(steps, MINUTE):
            squares += step.info["tracking_error"][:, 0] ** 2
            over |= step.terminated
        yield np.sqrt(squares / MINUTE), over, resident()


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Drive and print the table."""
    parser = Parser(program, (__doc__ or "").split("\n")[0])
    cases = ("drift", "wear", "laps")
    parser.add_argument("--case", nargs="+", choices=cases, default=cases)
    parser.add_argument("--policy", default="adaptive", help="default: adaptive")
    parser.add_argument("--minutes", type=int, default=60, help="default: 60")
    parser.add_argument("--vehicles", type=int, default=4, help="default: 4")
    options = parser.parse_args(arguments)
    head = ["case", "second minute [m]", "last", "last / second", "largest", "lost", "memory [MB]"]
    cells: Cells = [head]
    for case in options.case:
        start, errors, memory = resident(), [], []
        for error, over, size in minutes_of(
            options.policy, case, options.vehicles, options.minutes
        ):
            errors.append(float(np.sqrt(np.mean(error[~over] ** 2))))
            memory.append(size)
            print(
                f"{case} minute {len(errors)}: {errors[-1]:.4f} m, {size - start:.0f} MB",
                flush=True,
            )
        second, last, largest = errors[1], errors[-1], max(errors[1:])
        row = [f"{second:.4f}", f"{last:.4f}", f"{last / second:.2f}", f"{largest:.4f}"]
        cells.append([case, *row, str(int(over.sum())), f"{memory[-1] - memory[1]:.1f}"])
    show(cells, 1)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "long_episodes"))
