"""How fast the environment is, beside its peers measured in the same run.

    python benchmarks/speed.py [--seconds 2.0] [--rows REGEX] [--publish]
    python benchmarks/speed.py --against ../other-clone [--rows REGEX]

Every figure is the best of the same number of passes (the machine's other work only ever slows a
pass down), and comes with its ratio to a peer; docs/speed.md tells what the rows are. Nothing is
asserted: timings are for reading.

`--against` times another checkout as well and prints both: the script of either one runs ROUNDS
times, in turns, and the best of each row counts; a row that one of them lacks is NaN.
"""

import argparse
import math
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib.metadata import version
from itertools import cycle, product
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from tracked_env.benchmark import policies as registry
from tracked_env.benchmark.files import replace_block
from tracked_env.benchmark.policy_interface import PolicyContext, needs_truth
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import make_sensors

ROOT = Path(__file__).resolve().parent.parent
PASSES, TRAININGS, TRAINING_STEPS = 7, 3, "100000"  # the fastest of them counts
ROUNDS = 3  # of each of two checkouts
SLOWER = 1.03  # ratio from which on a row is marked; minima of the same code differ by less
CALM, CRUISE = {"error_limit": 1e6}, 0.15  # arguments; action
NOISE = 64  # [steps] after which new noise is drawn: every pass has its share of it
BETWEEN = 21 * NOISE  # [steps] calm ones after a reset: an episode has 1500
WARM = 300  # [steps] of random actions before the first pass: vehicles are no longer in step
STEPS, CONTROL_PERIOD = 1000, 0.02  # of a plant in one call: its overhead is below a percent; [s]
CIRCLES = (3.0, 4.0), (4.0, 8.0)  # [rad/s] sprocket speeds of the first and the last vehicle
TORQUE, SPEED, TERRAIN = (f"tracked_env/{name}-v0" for name in ("Torque", "Speed", "Terrain"))
PENDULUM, CARTPOLE = "Pendulum-v1 step", "CartPole-v1 step"
TRAINING, TRAINING_PEER = "PPO, 64 vehicles, with learner", "Torque-v0 vector, 64, calm"
Figure = tuple[float, int]  # time of a step [us], threads
SCANNED = (
    "pose_error motion drive reference look_ahead action age attitude tangent_error height_scan"
)
# Environments beside the peers: name, id, arguments, vehicles.
ENVIRONMENTS: tuple[tuple[str, str, dict[str, Any], tuple[int, ...]], ...] = (
    ("Torque-v0", TORQUE, {}, (1, 64, 4096)),
    ("Torque-v0 constrained", TORQUE, {"lateral": "constrained"}, (1, 64)),
    ("Torque-v0 distributed", TORQUE, {"plant": "distributed"}, (1, 64)),
    ("Speed-v0", SPEED, {}, (1, 64)),
    ("Terrain-v0", TERRAIN, {}, (1, 64)),
    ("Terrain-v0 on one thread", TERRAIN, {"threads": 1}, (64,)),
    ("Terrain-v0 with v0", TERRAIN, {"observation": "v0"}, (1,)),
    ("Terrain-v0 with height scan", TERRAIN, {"observation": SCANNED.split()}, (1, 64)),
    ("Terrain-v0 by torque", TERRAIN, {"drive": "torque"}, (1,)),
)
# Trained agents beside the registered controllers: (drive, name, network).
AGENTS = (
    ("torque", "ppo-blind", "MLP"),
    ("torque", "ppo-estimates", "MLP on estimates"),
)


class Load(NamedTuple):
    """What a row repeats."""

    call: Callable[[], object]
    prepare: Callable[[], object] = lambda: None  # before each pass, not timed
    calls: int = 10**6  # of a pass, at most
    multiple: int = 1  # of which the calls of a pass are one
    threads: int = 1  # that run side by side in a call


class Row(NamedTuple):
    """One line of the table."""

    name: str
    steps: int  # of vehicles, per call
    peer: str  # name of the row it is compared with
    make: Callable[[], Load]


def environment(env_id: str, mode: str, count: int, **arguments: Any) -> Load:
    """A step or a reset: of the unwrapped environment, or of `count` vehicles, with autoresets."""
    single = count == 1
    kind = {} if single else {"num_envs": count, "vectorization_mode": "vector_entry_point"}
    make: Callable[..., Any] = gymnasium.make if single else gymnasium.make_vec
    env: Any = make(env_id, **kind, **arguments).unwrapped
    env.action_space.seed(0)
    env.reset(seed=0)
    threads = getattr(getattr(env, "simulation", None), "threads", 1)  # of a peer: one
    if mode == "reset":
        return Load(env.reset, threads=threads)
    samples = [env.action_space.sample() for _ in range(64 if single else 16)]
    calm = np.full(2 if single else (count, 2), CRUISE, dtype=np.float32)
    actions = cycle(samples if mode == "random" else [calm])

    def one() -> None:
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()

    call: Callable[[], object] = one if single else lambda: env.step(next(actions))
    if mode == "calm":
        return Load(call, env.reset, BETWEEN, NOISE, threads)
    if mode == "episodes":  # the reset of a vector environment takes a call
        calls = int(env.simulation.settings.max_steps) + (0 if single else 1)
        return Load(call, env.reset, calls, calls, threads)
    for _ in range(WARM):
        call()
    return Load(call, multiple=NOISE, threads=threads)


def _drive(driver: Any, count: int, env_id: str, steps: int, **arguments: Any) -> list[Any]:
    """Observations of vehicles that `driver` drives."""
    env = gymnasium.make_vec(env_id, num_envs=count, **arguments)
    observation, _ = env.reset(seed=0)
    observations, state = [], None
    for step in range(steps):
        action, state = driver.predict(observation, state, np.full(count, step == 0))
        observation = env.step(action)[0]
        observations.append(observation)
    return observations


def predictions(drive: str, name: str, count: int) -> Load:
    """`predict` of a registered policy; of a trained agent, of its first seed."""
    torque, speed = (TORQUE, "rtk", "strawa"), (SPEED, "mocap", "focchi")
    env_id, sensors, vehicle = torque if drive == "torque" else speed
    entry: Any = registry.by_name(registry.registered_policies(), drive)[name]
    if isinstance(entry, list):
        entry = registry.open_archive(entry[0])
    context = PolicyContext(0.02, "sliding", make_sensors(sensors), drive, VEHICLES[vehicle])
    policy = entry.make(context)
    observations = _drive(policy, count, env_id, 150, duration=30.0)
    later = np.zeros(count, dtype=bool)
    state: Any = policy.predict(observations[0], None, ~later)[1]
    ahead = cycle(observations[1:])

    def call() -> None:
        nonlocal state
        _, state = policy.predict(next(ahead), state, later)

    return Load(call)


def identification(count: int, slip: str) -> Load:
    """An update of all estimators, on observations of weak soil: there every one has work."""
    from baselines.linearizing.adaptive_policy import AdaptivePolicy

    driver = AdaptivePolicy(slip=slip)
    ahead = cycle(_drive(driver, count, TORQUE, 250, uncertainty="weak-soil")[50:])
    return Load(lambda: driver.stack.update(next(ahead)))


def controllers() -> list[tuple[str, str]]:
    """(drive, name) of the registered controllers that are not handed the truth."""
    pairs = []
    policies = registry.registered_policies()
    for drive, vehicle in (("torque", "strawa"), ("speed", "focchi")):
        entries: dict[str, Any] = registry.by_name(policies, drive)
        context = PolicyContext(0.02, "sliding", drive=drive, vehicle=VEHICLES[vehicle])
        for policy in policies:
            if policy.env != registry.ENVIRONMENTS[drive] or policy.is_trained:
                continue
            if not needs_truth(entries[policy.name].make(context)):
                pairs.append((drive, policy.name))
    return pairs


def _grounds() -> dict[str, dict[str, Any]]:
    """Terrains by name."""
    rng = np.random.default_rng(0)
    shape, motion = rng.uniform(0.01, 0.05, 8), rng.uniform(-2.0, 2.0, (8, 2))
    waves = np.column_stack([shape, motion, rng.uniform(0.0, 6.0, 8)])
    east, north = np.meshgrid(np.linspace(-40.0, 40.0, 801), np.linspace(-40.0, 40.0, 801))
    heights = 0.2 * np.sin(0.5 * east) * np.cos(0.4 * north)
    return {
        "plane": {"kind": "plane", "slope_x": 0.1},
        "ramp": {"kind": "ramp", "slope": 0.1, "start": 0.8, "length": 4.0},
        "height map": {"kind": "map", "cell": 0.1, "heights": heights},
        "8 sinusoids": {"kind": "waves", "waves": waves.tolist()},
    }


def distributed_alone(count: int, euler: bool) -> Load:
    """STEPS steps of the distributed plant: Euler of 1 ms, or Rosenbrock of 2.5 ms, the default."""
    from tracked_env.physics.level_motion import hold_speeds
    from tracked_env.physics.patches_on_level_ground import make_patches

    (states, loads), speeds = np.zeros((2, count, 6)), np.linspace(*CIRCLES, count)
    parameters = np.tile(np.array(VEHICLES["focchi"], dtype=float), (count, 1))
    patches, h = make_patches(10, 4), 1e-3 if euler else 2.5e-3
    return Load(lambda: hold_speeds(states, speeds, parameters, patches, STEPS, h, euler, loads))


def terrain_alone(count: int, ground: str, step: float | None) -> Load:
    """STEPS steps of that length [s] on terrain; None: as many control periods by default steps."""
    from tracked_env.plants.standalone import TerrainRig
    from tracked_env.plants.terrain import LONGEST_STEP

    options = {"terrain": _grounds()[ground]}
    rig = TerrainRig(VEHICLES["focchi"], options, count, step=step or LONGEST_STEP)
    speeds, duration = np.linspace(*CIRCLES, count), STEPS * (step or CONTROL_PERIOD)

    def stand() -> None:
        for row in range(count):
            rig.stand(0.0, 0.0, 0.1 * row, row)

    return Load(lambda: rig.advance(speeds, duration), stand)


def _goals(count: int) -> Any:
    """Goals (N, 3) from 1 to 4 m away."""
    draws = np.random.default_rng(0).uniform((1.0, 0.0, 0.0), (4.0, 6.28, 6.28), (count, 3))
    distance, direction, yaw = draws.T
    return np.stack([distance * np.cos(direction), distance * np.sin(direction), yaw], axis=1)


def paths(method: str) -> Load:
    """Paths to 1000 goals, without sampling them in time."""
    from baselines.planners import curves

    start, goals = np.zeros(3), _goals(1000)
    if method == "clothoid":
        return Load(lambda: curves.clothoid(start, goals))
    curve = curves.dubins if method == "dubins" else curves.reeds_shepp
    return Load(lambda: curve(start, goals, 0.2))


def plans(v_min: float, at_once: bool) -> Load:
    """Slippage-aware plans of the light vehicle to 100 goals: one after another, or at once."""
    from baselines.planners import Limits, optimal
    from baselines.slip.slip_sweep import identified_slip

    vehicle, goals = VEHICLES["focchi"], _goals(100)
    model = Limits.of(vehicle, v_min=v_min, v_max=0.4), vehicle, identified_slip(vehicle)
    if at_once:
        return Load(lambda: optimal((0, 0, 0), goals, *model, threads=2), threads=2)
    each = cycle(goals)
    return Load(lambda: optimal((0, 0, 0), next(each), *model), multiple=len(goals))


def rows(registered: Sequence[tuple[str, str]]) -> Iterator[Row]:
    """All rows, peers first; registered: what `controllers` returns."""
    vehicles = {1: "1 vehicle", 64: "64 vehicles"}
    yield Row(PENDULUM, 1, PENDULUM, partial(environment, "Pendulum-v1", "random", 1))
    yield Row(CARTPOLE, 1, PENDULUM, partial(environment, "CartPole-v1", "random", 1))
    for count in (64, 4096):
        name = f"CartPole-v1 vector, {count}"
        yield Row(name, count, name, partial(environment, "CartPole-v1", "random", count))
    for label, env_id, arguments, counts in ENVIRONMENTS:
        for count, mode in product(counts, ("calm", "random", "episodes")):
            options = arguments if mode == "random" else {**arguments, **CALM}
            kind, peer = f"vector, {count}", f"CartPole-v1 vector, {count}"
            kind, peer = ("step", CARTPOLE) if count == 1 else (kind, peer)
            make = partial(environment, env_id, mode, count, **options)
            yield Row(f"{label} {kind}, {mode}", count, peer, make)
    for count in (1, 64):
        make = partial(environment, TORQUE, "reset", count)
        yield Row(f"reset, {vehicles[count]}", count, CARTPOLE, make)
    for drive, name, network in (*((*pair, "") for pair in registered), *AGENTS):
        label = f"{name} ({network})" if network else name
        for count in (1, 64):
            text = f"predict {label}, {drive}, {vehicles[count]}"
            yield Row(text, count, CARTPOLE, partial(predictions, drive, name, count))
    for label, slip, counts in ((" with filterpy", "filterpy", (1,)), ("", "batched", (1, 64))):
        for count in counts:
            name = f"identification stack{label}, {vehicles[count]}"
            yield Row(name, count, CARTPOLE, partial(identification, count, slip))
    for count in (1, 64):
        for euler, name in ((True, "Euler step of 1 ms"), (False, "Rosenbrock step of 2.5 ms")):
            label = f"distributed plant alone, {name}, {vehicles[count]}"
            yield Row(label, STEPS * count, CARTPOLE, partial(distributed_alone, count, euler))
        steps = (1e-3, "step of 1 ms"), (None, "20 ms of driving")
        for ground, (step, name) in product(_grounds(), steps):
            label = f"terrain plant alone, {ground}, {name}, {vehicles[count]}"
            yield Row(label, STEPS * count, CARTPOLE, partial(terrain_alone, count, ground, step))
    for method in ("dubins", "reeds-shepp", "clothoid"):
        yield Row(f"planner {method}, path, of 1000 goals", 1000, CARTPOLE, partial(paths, method))
    for v_min, speed in ((0.4, "constant speed"), (0.15, "variable speed")):
        name = f"planner optimal, {speed}"
        yield Row(name, 1, CARTPOLE, partial(plans, v_min, False))
        yield Row(f"{name}, 100 goals on two threads", 100, CARTPOLE, partial(plans, v_min, True))


def calls_of_a_pass(load: Load, seconds: float) -> int:
    """How many calls take about `seconds`; makes some, so that everything is compiled."""
    load.prepare()
    load.call()
    began, tried = time.perf_counter(), 0
    while tried < 3 or (time.perf_counter() - began < 0.02 and tried < 50):
        load.call()
        tried += 1
    once = (time.perf_counter() - began) / tried
    calls = min(int(seconds / max(once, 1e-9)), load.calls)
    return max(-(-calls // load.multiple), 1) * load.multiple


def time_of_a_pass(load: Load, calls: int) -> float:
    """Mean duration of a call [s] over one pass."""
    load.prepare()
    call, began = load.call, time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - began) / calls


def measure(row: Row, seconds: float) -> Figure:
    """The best of PASSES passes of about `seconds` in all."""
    load = row.make()
    calls = calls_of_a_pass(load, seconds / PASSES)
    best = min(time_of_a_pass(load, calls) for _ in range(PASSES))
    return 1e6 * best / row.steps, load.threads


def start_up() -> str:
    """Time until the first step: with an empty kernel cache, and with a full one."""
    code = (
        "import time; t = time.perf_counter()\n"
        "import gymnasium, numpy as np\n"
        f"env = gymnasium.make('tracked_env:{TORQUE}')\n"
        "env.reset(seed=0); env.step(np.zeros(2, np.float32))\n"
        "print(time.perf_counter() - t)"
    )
    command = [sys.executable, "-c", code]
    with tempfile.TemporaryDirectory() as cache:
        env = {**os.environ, "NUMBA_CACHE_DIR": cache}
        times = [float(subprocess.check_output(command, env=env, text=True)) for _ in range(3)]
    return (
        f"First step of a fresh process: {times[0]:.1f} s with an empty kernel cache "
        f"(compilation), {min(times[1:]):.2f} s with a full one."
    )


def training() -> Figure:
    """A step of train.py from its second rollout on, the best of TRAININGS; one PyTorch thread."""
    times = []
    for _ in range(TRAININGS):
        with tempfile.TemporaryDirectory() as folder:
            options = ["--steps", TRAINING_STEPS, "--held-out", "0", "--quiet", "--output", folder]
            subprocess.check_output([sys.executable, "train.py", *options], cwd=ROOT)
            (curve,) = Path(folder).rglob("curve.csv")
            table = np.genfromtxt(curve, delimiter=",", names=True)
        times.append(np.ptp(table["seconds"]) / np.ptp(table["steps"]))
    return 1e6 * float(min(times)), 1


def markdown(figures: Mapping[str, Figure], peers: Mapping[str, str], first_step: str) -> str:
    """The table and what it was measured on; first_step: what `start_up` returned."""
    lines = ["| what | threads | us per step | steps/s | time over peer | peer |"]
    lines.append("|--|--|--|--|--|--|")
    for name, (each, threads) in figures.items():
        ratio = each / figures.get(peers[name], (math.nan, 1))[0]
        speed = f"{each:.3f} | {1e6 / each:,.0f} | {ratio:.2f}"
        lines.append(f"| {name} | {threads} | {speed} | {peers[name]} |")
    env: Any = gymnasium.make_vec(TORQUE, num_envs=64).unwrapped
    memory = sum(array.nbytes for array in env.simulation.batch) // env.num_envs / 1024
    lines += ["", f"Memory of one vehicle: {memory:.1f} KiB (30 s episode). {first_step}", ""]
    learner = f" PyTorch {version('torch')}, Stable-Baselines3 {version('stable-baselines3')}."
    lines.append(
        f"Python {platform.python_version()}, NumPy {np.__version__}, Gymnasium "
        f"{gymnasium.__version__}, {os.cpu_count()} cores ({platform.machine()}), one process, "
        "50 Hz control, 8 RK4 sub-steps per step." + (learner if TRAINING in figures else "")
    )
    return "\n".join(lines)


def compare(theirs: Path, rows_like: str, seconds: float) -> Iterator[str]:
    """Lines of the comparison with another checkout: the scripts of both run in turns."""
    best: tuple[dict[str, float], ...] = ({}, {})
    for k, folder in [*enumerate((ROOT, theirs.resolve()))] * ROUNDS:
        options = ["--rows", rows_like, "--seconds", str(seconds / ROUNDS)]
        command = [sys.executable, "benchmarks/speed.py", *options]
        env = {**os.environ, "PYTHONPATH": str(folder)}
        for text in subprocess.check_output(command, cwd=folder, env=env, text=True).splitlines():
            if len(cells := [cell.strip() for cell in text.split("|")]) == 8 and cells[2].isdigit():
                best[k][cells[1]] = min(best[k].get(cells[1], math.inf), float(cells[3]))
    yield "| what | us per step | there | time over that there |"
    yield "|--|--|--|--|"
    for name in dict.fromkeys((*best[0], *best[1])):
        ours, there = (times.get(name, math.nan) for times in best)
        ratio = ours / there
        slower = " slower" if ratio > SLOWER else ""
        yield f"| {name} | {ours:.3f} | {there:.3f} | {ratio:.3f}{slower} |"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=float, default=2.0, help="time spent per figure [s]")
    parser.add_argument("--rows", default="", metavar="REGEX", help="only those, and their peers")
    parser.add_argument(
        "--against", type=Path, metavar="PATH", help="compare with another checkout"
    )
    parser.add_argument("--publish", action="store_true", help="also renew docs/speed.md")
    options = parser.parse_args()
    if options.publish and (options.rows or options.against):
        parser.error("--publish needs all rows: leave out --rows and --against")
    if options.against:
        if not (options.against / "benchmarks" / "speed.py").is_file():
            parser.error(f"--against {options.against}: no benchmarks/speed.py there")
        print(*compare(options.against, options.rows, options.seconds), sep="\n")
        return
    every = list(rows(controllers()))
    matching = [row for row in every if re.search(options.rows, row.name)]
    if not matching:
        names = "\n".join(f"  {row.name}" for row in every)
        raise SystemExit(f"--rows {options.rows}: no such row; there are\n{names}")
    needed = {name for row in matching for name in (row.name, row.peer)}
    needed |= {row.peer for row in every if row.name in needed}
    chosen = [row for row in every if row.name in needed]
    first_step = "" if options.rows else start_up()
    figures = {row.name: measure(row, options.seconds) for row in chosen}
    if not options.rows:
        figures[TRAINING] = training()
    peers = {row.name: row.peer for row in chosen} | {TRAINING: TRAINING_PEER}
    table = markdown(figures, peers, first_step)
    print(table)
    if options.publish:
        replace_block(ROOT / "docs" / "speed.md", "speed table", table)


if __name__ == "__main__":
    main()
