"""What benchmarks/speed.py times: the rows of its table, each a call that is repeated.

    calm      no vehicle ends: constant small actions, `error_limit` out of reach, passes that are
              shorter than an episode and begin with a reset that is not timed
    random    random actions and the default `error_limit`: vehicles end and start anew in the call
    episodes  a pass is one whole episode with the reset of every vehicle after it, as calm else
    predict   one call of a policy on observations of vehicles that it has driven itself

Modules of the project are imported where a row is made: in another checkout (`--against`) a row
may be missing.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from benchmarks import speed_planners, speed_plants

TORQUE, SPEED = "tracked_env/Torque-v0", "tracked_env/Speed-v0"
TERRAIN = "tracked_env/Terrain-v0"
CALM = {"error_limit": 1e6}
CRUISE = 0.15  # action
NOISE = 64  # [steps] after which new noise is drawn: every pass has its share of it
BETWEEN = 21 * NOISE  # [steps] calm ones after a reset: an episode has 1500
WARM = 300  # [steps] of random actions before the first pass: vehicles are no longer in step
PENDULUM, CARTPOLE = "Pendulum-v1 step", "CartPole-v1 step"
SCANNED = [
    "pose_error", "motion", "drive", "reference", "look_ahead", "action", "age", "attitude",
    "tangent_error", "height_scan",
]  # fmt: skip
# Environments beside the peers: name, id, arguments, vehicles.
ENVIRONMENTS: tuple[tuple[str, str, dict[str, Any], tuple[int, ...]], ...] = (
    ("Torque-v0", TORQUE, {}, (1, 64, 4096)),
    ("Torque-v0 constrained", TORQUE, {"lateral": "constrained"}, (1, 64)),
    ("Torque-v0 distributed", TORQUE, {"plant": "distributed"}, (1, 64)),
    ("Speed-v0", SPEED, {}, (1, 64)),
    ("Terrain-v0", TERRAIN, {}, (1, 64)),
    ("Terrain-v0 with v0", TERRAIN, {"observation": "v0"}, (1,)),
    ("Terrain-v0 with height scan", TERRAIN, {"observation": SCANNED}, (1, 64)),
    ("Terrain-v0 by torque", TERRAIN, {"drive": "torque"}, (1,)),
)
# Trained agents beside the registered controllers: (drive, name, network).
AGENTS = (
    ("torque", "ppo-blind", "MLP"),
    ("torque", "ppo-residual", "MLP on adaptive"),
    ("torque", "recurrent-ppo-blind", "LSTM"),
    ("torque", "ppo-student-estimates", "LSTM on estimates"),
    ("speed", "ppo-blind", "MLP"),
)


class Load(NamedTuple):
    """What a row repeats."""

    call: Callable[[], object]
    prepare: Callable[[], object] = lambda: None  # before each pass, not timed
    calls: int = 10**6  # of a pass, at most
    whole: bool = False  # a pass has exactly so many calls
    multiple: int = 1  # of which the calls of a pass are one
    ends: Callable[[], float] = lambda: 0.0  # episodes that end, per 1000 steps


class Row(NamedTuple):
    """One line of the table."""

    name: str
    steps: int  # of vehicles, per call
    peer: str  # name of the row it is compared with
    make: Callable[[], Load]


def single(env_id: str, mode: str, **arguments: Any) -> Load:
    """A step of the unwrapped environment, reset when its episode ends."""
    env = gymnasium.make(env_id, **arguments).unwrapped
    env.action_space.seed(0)
    env.reset(seed=0)
    samples = [env.action_space.sample() for _ in range(64)]
    if mode != "random":
        samples = [np.full(2, CRUISE, dtype=np.float32)]
    turn, count = [0], len(samples)

    def call() -> bool:
        turn[0] += 1
        _, _, terminated, truncated, _ = env.step(samples[turn[0] % count])
        if terminated or truncated:
            env.reset()
            return True
        return False

    def ends() -> float:
        return float(sum(call() for _ in range(1000)))

    return _load(call, env.reset, mode, env, ends, extra=0)


def vector(env_id: str, mode: str, count: int, **arguments: Any) -> Load:
    """A step of the vector environment, with its autoresets."""
    env: Any = gymnasium.make_vec(
        env_id, num_envs=count, vectorization_mode="vector_entry_point", **arguments
    )
    env.reset(seed=0)
    env.action_space.seed(0)
    samples = [env.action_space.sample() for _ in range(16)]
    if mode != "random":
        samples = [np.full((count, 2), CRUISE, dtype=np.float32)]
    turn, kinds = [0], len(samples)

    def call() -> Any:
        turn[0] += 1
        return env.step(samples[turn[0] % kinds])

    def ends() -> float:
        steps = max(200, 6400 // count)
        return 1e3 * sum(float(np.sum(np.bitwise_or(*call()[2:4]))) for _ in range(steps)) / (
            steps * count
        )  # fmt: skip

    return _load(call, env.reset, mode, env.unwrapped, ends, extra=1)


def _load(
    call: Callable[[], object], reset: Callable[[], object], mode: str, env: Any,
    ends: Callable[[], float], extra: int,
) -> Load:  # fmt: skip
    """The pass of a mode; extra: calls beside the steps of an episode that its reset takes."""
    if mode == "calm":
        return Load(call, reset, BETWEEN, multiple=NOISE)
    if mode == "episodes":
        steps = int(env.simulation.settings.max_steps)
        return Load(call, reset, steps + extra, whole=True, ends=lambda: 1e3 / steps)
    for _ in range(WARM):
        call()
    return Load(call, multiple=NOISE, ends=ends)


def resets(count: int) -> Load:
    """A reset of `count` vehicles by one call."""
    env: Any = gymnasium.make(TORQUE) if count == 1 else gymnasium.make_vec(TORQUE, num_envs=count)
    env.reset(seed=0)
    return Load(env.unwrapped.reset)


def _drive(driver: Any, count: int, env_id: str, steps: int, **arguments: Any) -> list[Any]:
    """Observations of vehicles that `driver` drives."""
    env = gymnasium.make_vec(env_id, num_envs=count, **arguments)
    observation, _ = env.reset(seed=0)
    seen, state = [], None
    start = np.ones(count, dtype=bool)
    for _ in range(steps):
        action, state = driver.predict(observation, state, start)
        start = np.zeros(count, dtype=bool)
        observation = env.step(action)[0]
        seen.append(observation)
    return seen


def predictions(drive: str, name: str, count: int) -> Load:
    """`predict` of a registered policy; of a trained agent, of its first seed."""
    from tracked_env.benchmark import policies as registered
    from tracked_env.benchmark.policy_interface import PolicyContext
    from tracked_env.sensors import make_sensors

    env_id, sensors, vehicle = {
        "torque": (TORQUE, "rtk", "strawa"), "speed": (SPEED, "mocap", "focchi"),
    }[drive]  # fmt: skip
    policies, archives = registered.by_name(registered.registered_policies(), drive)
    entry: Any = policies.get(name) or registered.open_archive(archives[name][0])
    context = PolicyContext(0.02, "sliding", make_sensors(sensors), drive, vehicle)
    policy = entry.make(context)
    seen = _drive(policy, count, env_id, 150, duration=30.0)
    first, later = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    turn: list[int] = [0]
    state: Any = policy.predict(seen[0], None, first)[1]

    def call() -> None:
        nonlocal state
        turn[0] = turn[0] % (len(seen) - 1) + 1
        _, state = policy.predict(seen[turn[0]], state, later)

    return Load(call)


def identification(count: int, slip: str) -> Load:
    """An update of all estimators, on observations of weak soil: there every one has work."""
    from baselines.linearizing.adaptive_policy import AdaptivePolicy

    driver = AdaptivePolicy(slip=slip)
    seen = _drive(driver, count, TORQUE, 250, uncertainty="weak-soil")
    turn = [49]

    def call() -> None:
        turn[0] = turn[0] + 1 if turn[0] < len(seen) - 1 else 50
        driver.stack.update(seen[turn[0]])

    return Load(call)


def controllers() -> list[tuple[str, str]]:
    """(drive, name) of the registered controllers that are not handed the truth."""
    from tracked_env.benchmark.policies import ENVIRONMENTS, by_name, registered_policies
    from tracked_env.benchmark.policy_interface import PolicyContext, needs_truth

    found = []
    for drive, vehicle in (("torque", "strawa"), ("speed", "focchi")):
        entries: dict[str, Any] = by_name(registered_policies(), drive)[0]
        for policy in registered_policies():
            context = PolicyContext(0.02, "sliding", drive=drive, vehicle=vehicle)
            if policy.env != ENVIRONMENTS[drive] or policy.is_trained:
                continue
            if not needs_truth(entries[policy.name].make(context)):
                found.append((drive, policy.name))
    return found


def _vehicles(count: int) -> str:
    return "1 vehicle" if count == 1 else f"{count} vehicles"


def environment_rows() -> Iterator[Row]:
    """Peers and environments."""
    yield Row(PENDULUM, 1, PENDULUM, partial(single, "Pendulum-v1", "random"))
    yield Row(CARTPOLE, 1, PENDULUM, partial(single, "CartPole-v1", "random"))
    for count in (64, 4096):
        name = f"CartPole-v1 vector, {count}"
        yield Row(name, count, name, partial(vector, "CartPole-v1", "random", count))
    for label, env_id, arguments, counts in ENVIRONMENTS:
        for count in counts:
            for mode in ("calm", "random", "episodes"):
                given = {**arguments, **({} if mode == "random" else CALM)}
                if count == 1:
                    name, peer = f"{label} step, {mode}", CARTPOLE
                    yield Row(name, 1, peer, partial(single, env_id, mode, **given))
                else:
                    name, peer = f"{label} vector, {count}, {mode}", f"CartPole-v1 vector, {count}"
                    yield Row(name, count, peer, partial(vector, env_id, mode, count, **given))
    for count in (1, 64):
        yield Row(f"reset, {_vehicles(count)}", count, CARTPOLE, partial(resets, count))


def policy_rows(known: Sequence[tuple[str, str]]) -> Iterator[Row]:
    """Policies and estimators; known: (drive, name) of the controllers."""
    named = [*((drive, name, "") for drive, name in known), *AGENTS]
    for drive, name, network in named:
        for count in (1, 64):
            text = f"predict {name}{f' ({network})' * bool(network)}, {drive}, {_vehicles(count)}"
            yield Row(text, count, CARTPOLE, partial(predictions, drive, name, count))
    for name, count, slip in (
        ("identification stack with filterpy", 1, "filterpy"),
        ("identification stack", 1, "batched"), ("identification stack", 64, "batched"),
    ):  # fmt: skip
        yield Row(f"{name}, {_vehicles(count)}", count, CARTPOLE,
                  partial(identification, count, slip))  # fmt: skip


def plant_rows() -> Iterator[Row]:
    """Plants without an environment, per step or per 20 ms of driving."""
    for count in (1, 64):
        steps, who = speed_plants.STEPS * count, _vehicles(count)
        for euler, name in ((True, "Euler step of 1 ms"), (False, "Rosenbrock step of 2.5 ms")):
            yield Row(f"distributed plant alone, {name}, {who}", steps, CARTPOLE,
                      partial(_of_plant, speed_plants.distributed_alone, count, euler))  # fmt: skip
        for ground in speed_plants.GROUNDS:
            for step, name in ((1e-3, "step of 1 ms"), (None, "20 ms of driving")):
                made = partial(_of_plant, speed_plants.terrain_alone, count, ground, step)
                yield Row(f"terrain plant alone, {ground}, {name}, {who}", steps, CARTPOLE, made)


def _of_plant(make: Callable[..., speed_plants.Calls], *arguments: Any) -> Load:
    return Load(*make(*arguments))


def planner_rows() -> Iterator[Row]:
    """Paths of 1000 goals at once; slippage-aware plans, mean over goals 1 to 4 m away."""
    for method in speed_planners.PATHS:
        yield Row(f"planner {method}, path, of 1000 goals", 1000, CARTPOLE,
                  partial(_planned, speed_planners.paths, method))  # fmt: skip
    for v_min, speed in ((0.4, "constant speed"), (0.15, "variable speed")):
        yield Row(f"planner optimal, {speed}", 1, CARTPOLE,
                  partial(_planned, speed_planners.one_by_one, v_min))  # fmt: skip
        yield Row(f"planner optimal, {speed}, 100 goals on two threads", 100, CARTPOLE,
                  partial(_planned, speed_planners.at_once, v_min))  # fmt: skip


def _planned(make: Callable[..., tuple[Callable[[], object], int]], *arguments: Any) -> Load:
    call, multiple = make(*arguments)
    return Load(call, multiple=multiple)


def rows(known: Sequence[tuple[str, str]]) -> list[Row]:
    """All rows, peers first; known: what `controllers` returns."""
    return [*environment_rows(), *policy_rows(known), *plant_rows(), *planner_rows()]


def calls_of_a_pass(load: Load, seconds: float) -> int:
    """How many calls take about `seconds`; makes some, so that everything is compiled."""
    load.prepare()
    load.call()
    if load.whole:
        return load.calls
    began, made = time.perf_counter(), 0
    while made < 3 or (time.perf_counter() - began < 0.02 and made < 50):
        load.call()
        made += 1
    once = (time.perf_counter() - began) / made
    calls = min(int(seconds / max(once, 1e-9)), load.calls)
    return max(-(-calls // load.multiple), 1) * load.multiple


def time_of_a_pass(load: Load, calls: int) -> float:
    """Mean duration of a call [s] over one pass."""
    load.prepare()
    call, began = load.call, time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - began) / calls
