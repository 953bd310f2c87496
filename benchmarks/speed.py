"""How fast the environment is, beside its peers measured in the same run.

    python benchmarks/speed.py [--seconds 2.0] [--training-steps 100000] [--publish]

Every figure is the best of several repetitions (the machine's other work only ever slows a
repetition down), rows are interleaved, and each comes with its ratio to a peer. Nothing is
asserted: timings are for reading. `--output` also writes the table as Markdown,
`--publish` into docs/speed.md.

The row of a training runs train.py as it stands, with its default settings. It needs the extras
`rl` and `cli`; without them it is left out, and that is said. `--training-steps 0` leaves it out.
"""

import argparse
import csv
import io
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

import tracked_env
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from tracked_env.benchmark.files import replace_block
from tracked_env.engine.columns import bytes_per_vehicle
from tracked_env.physics.parameters import VEHICLES
from tracked_env.physics.patch_dynamics import hold_speeds
from tracked_env.physics.patch_forces import make_patches

TORQUE = tracked_env.TORQUE_ID
REPETITIONS = 7
TRAININGS = 3  # of which the fastest counts
FREE_SHARE = 0.9  # of a core that a training uses on a free machine
TRAINING = "PPO, 64 vehicles, with learner"
ROOT = Path(__file__).resolve().parent.parent
PLANT_STEPS = 1000  # of one call of the distributed plant: its overhead is below a percent


class Row(NamedTuple):
    """One line of the table."""

    name: str
    microseconds: float  # per environment step, or per call
    steps: int  # of the environment, per call
    peer: str  # name of the row it is compared with


def best_time(call: Callable[[], object], seconds: float) -> float:
    """Shortest mean duration [s] of `call` over the repetitions of about `seconds` in all."""
    call()
    start = time.perf_counter()
    call()
    once = time.perf_counter() - start
    loops = max(int(seconds / REPETITIONS / max(once, 1e-9)), 1)
    best = np.inf
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        for _ in range(loops):
            call()
        best = min(best, (time.perf_counter() - start) / loops)
    return best


def single_step(env_id: str, **arguments: Any) -> Callable[[], object]:
    """One step of the unwrapped environment, reset when its episode ends."""
    env = gymnasium.make(env_id, **arguments).unwrapped
    env.action_space.seed(0)
    env.reset(seed=0)
    action = env.action_space.sample()
    if env_id == TORQUE:
        action = np.full(2, 0.15, dtype=np.float32)

    def call() -> None:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    return call


def vector_step(
    env_id: str, count: int, wild: bool = False, **arguments: Any
) -> Callable[[], object]:
    """One step of the vector environment, with its autoresets."""
    env = gymnasium.make_vec(
        env_id, num_envs=count, vectorization_mode="vector_entry_point", **arguments
    )
    env.reset(seed=0)
    env.action_space.seed(0)
    samples = [env.action_space.sample() for _ in range(16)]
    if env_id == TORQUE and not wild:
        samples = [np.full((count, 2), 0.15, dtype=np.float32)]
    turn = [0]

    def call() -> None:
        turn[0] += 1
        env.step(samples[turn[0] % len(samples)])

    return call


def identification_step(count: int, slip: str, policy: bool = False) -> Callable[[], object]:
    """One step of the whole identification stack, or of the adaptive policy around it.

    Its observations are those of a drive on weak soil, where every estimator has work to do.
    """
    env = gymnasium.make_vec(TORQUE, num_envs=count, uncertainty="weak-soil")
    driver = AdaptivePolicy(slip=slip)
    observation, _ = env.reset(seed=0)
    seen, state = [], None
    for _ in range(250):
        action, state = driver.predict(observation, state)
        observation = env.step(action)[0]
        seen.append(observation)
    turn = [49]

    def call() -> None:
        nonlocal state
        turn[0] = turn[0] + 1 if turn[0] < len(seen) - 1 else 50
        if policy:
            _, state = driver.predict(seen[turn[0]], state)
        else:
            driver.stack.update(seen[turn[0]])

    return call


def plant_steps(count: int, euler: bool) -> Callable[[], object]:
    """PLANT_STEPS steps of the distributed plant alone: 2 x 40 patches, belts that turn it.

    No environment around it. Euler steps of 1 ms, as published simulators take them, cost one
    evaluation of all patches each; Rosenbrock steps of 2.5 ms, the default, cost two.
    """
    states, loads = np.zeros((count, 6)), np.zeros((count, 6))
    speeds = np.linspace((3.0, 4.0), (4.0, 8.0), count)
    parameters = np.tile(np.array(VEHICLES["focchi"], dtype=float), (count, 1))
    patches, h = make_patches(10, 4), 1e-3 if euler else 2.5e-3

    def call() -> None:
        hold_speeds(states, speeds, parameters, patches, PLANT_STEPS, h, euler, loads)

    return call


def episode_seconds(call: Callable[[], object], calls: int) -> float:
    """Mean duration [s] of one call over a whole episode, its autoresets included."""
    start = time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - start) / calls


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
        from agents.training.options import options_of_train
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
    return [Row(TRAINING, 1e6 * seconds, steps, "Torque-v0 vector, 64")]


def measure(seconds: float) -> list[Row]:
    """All rows without PyTorch, peers first."""
    free: dict[str, Any] = {"error_limit": 1e6}  # episodes end by time only
    singles = {
        "Pendulum-v1 step": (single_step("Pendulum-v1"), "Pendulum-v1 step"),
        "CartPole-v1 step": (single_step("CartPole-v1"), "Pendulum-v1 step"),
        "Torque-v0 step, rtk sensors": (single_step(TORQUE, **free), "Pendulum-v1 step"),
    }
    rows = [
        Row(name, 1e6 * best_time(call, seconds), 1, peer) for name, (call, peer) in singles.items()
    ]
    for count in (64, 4096):
        peer = f"CartPole-v1 vector, {count}"
        call = vector_step("CartPole-v1", count)
        rows.append(Row(peer, 1e6 * best_time(call, seconds) / count, count, peer))
        call = vector_step(TORQUE, count, **free)
        name = f"Torque-v0 vector, {count}"
        rows.append(Row(name, 1e6 * best_time(call, seconds) / count, count, peer))
        call = vector_step(TORQUE, count, **free)
        call()
        mean = 1e6 * episode_seconds(call, 1501) / count
        rows.append(Row(f"Torque-v0 vector, {count}, episode + reset", mean, count, peer))
        call = vector_step(TORQUE, count, wild=True)
        call()
        mean = 1e6 * episode_seconds(call, 400) / count
        rows.append(Row(f"Torque-v0 vector, {count}, random actions", mean, count, peer))
    env = gymnasium.make_vec(TORQUE, num_envs=64)
    env.reset(seed=0)
    rows.append(
        Row("reset of one vehicle", 1e6 * best_time(env.reset, seconds) / 64, 64, rows[0].name)
    )
    for name, count, arguments in (
        ("Identification stack with filterpy, 1 vehicle", 1, ("filterpy",)),
        ("Identification stack, 1 vehicle", 1, ("batched",)),
        ("Identification stack, 64 vehicles", 64, ("batched",)),
        ("Adaptive policy, 1 vehicle", 1, ("batched", True)),
        ("Adaptive policy, 64 vehicles", 64, ("batched", True)),
    ):
        call = identification_step(count, *arguments)
        rows.append(Row(name, 1e6 * best_time(call, seconds) / count, count, rows[0].name))
    for euler, name in ((True, "Euler step of 1 ms"), (False, "Rosenbrock step of 2.5 ms")):
        for count in (1, 64):
            steps = PLANT_STEPS * count
            time_ = 1e6 * best_time(plant_steps(count, euler), seconds) / steps
            vehicles = f"{count} vehicle{'s' if count > 1 else ''}"
            rows.append(Row(f"Distributed plant, {name}, {vehicles}", time_, steps, rows[0].name))
    return rows


def markdown(rows: list[Row], cold: float, warm: float) -> str:
    """The table and what it was measured on."""
    times = {row.name: row.microseconds for row in rows}
    lines = [
        "| what | us per step | steps/s | time over peer | peer |",
        "|--|--|--|--|--|",
    ]
    for row in rows:
        ratio = row.microseconds / times[row.peer]
        lines.append(
            f"| {row.name} | {row.microseconds:.2f} | {1e6 / row.microseconds:,.0f} "
            f"| {ratio:.2f} | {row.peer} |"
        )
    env: Any = gymnasium.make_vec(TORQUE, num_envs=64).unwrapped
    memory = bytes_per_vehicle(env.simulation.batch) / 1024
    learner = ""
    if TRAINING in times:
        learner = (
            f" PPO: the default settings of train.py, fastest of {TRAININGS}, "
            f"PyTorch {version('torch')}, Stable-Baselines3 {version('stable-baselines3')}."
        )
    lines += [
        "",
        f"Memory of one vehicle: {memory:.1f} KiB (30 s episode). First step of a fresh process: "
        f"{cold:.1f} s with an empty kernel cache (compilation), {warm:.2f} s with a full one.",
        "",
        f"Python {platform.python_version()}, NumPy {np.__version__}, Gymnasium "
        f"{gymnasium.__version__}, {os.cpu_count()} cores ({platform.machine()}), one process, "
        "50 Hz control, 8 RK4 sub-steps per step, two threads from 512 vehicles on." + learner,
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=2.0, help="time spent per figure [s]")
    parser.add_argument(
        "--training-steps", type=int, default=100_000, help="of each training; 0 leaves its row out"
    )
    parser.add_argument("--output", type=Path, help="also write the Markdown table to this file")
    parser.add_argument(
        "--publish", action="store_true", help="also renew the table in docs/speed.md"
    )
    arguments = parser.parse_args()
    cold, warm = start_up()
    rows = measure(arguments.seconds) + training_rows(arguments.training_steps)
    table = markdown(rows, cold, warm)
    print(table)
    if arguments.output:
        arguments.output.write_text(table + "\n")
    if arguments.publish:
        replace_block(ROOT / "docs" / "speed.md", "speed table", table)


if __name__ == "__main__":
    main()
