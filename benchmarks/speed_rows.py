"""What benchmarks/speed.py times: the rows of its table, each a call that is repeated.

    calm      no vehicle ends: constant small actions, `error_limit` out of reach, passes that are
              shorter than an episode and begin with a reset that is not timed
    random    random actions and the default `error_limit`: vehicles end and start anew in the call
    episodes  a pass is one whole episode with the reset of every vehicle after it, as calm else
    predict   one call of a policy on observations of vehicles that it has driven itself
    plants    without an environment: the light vehicle with 2 x 40 patches turns under its own
              belts; on terrain one step of 1 ms, as published simulators take it, and what counts
              to a user, 20 ms of driving at the default step
    planners  paths of 1000 goals at once; slippage-aware plans, mean over goals 1 to 4 m away

Modules of the project are imported where a row is made: in another checkout (`--against`) a row
may be missing.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import cycle, product
from typing import Any, NamedTuple

import gymnasium
import numpy as np

TORQUE, SPEED = "tracked_env/Torque-v0", "tracked_env/Speed-v0"
TERRAIN = "tracked_env/Terrain-v0"
CALM = {"error_limit": 1e6}
CRUISE = 0.15  # action
NOISE = 64  # [steps] after which new noise is drawn: every pass has its share of it
BETWEEN = 21 * NOISE  # [steps] calm ones after a reset: an episode has 1500
WARM = 300  # [steps] of random actions before the first pass: vehicles are no longer in step
PENDULUM, CARTPOLE = "Pendulum-v1 step", "CartPole-v1 step"
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
    ("Terrain-v0 with v0", TERRAIN, {"observation": "v0"}, (1,)),
    ("Terrain-v0 with height scan", TERRAIN, {"observation": SCANNED.split()}, (1, 64)),
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
    calm = [np.full(2, CRUISE, dtype=np.float32)]
    actions = cycle([env.action_space.sample() for _ in range(64)] if mode == "random" else calm)

    def call() -> bool:
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()
            return True
        return False

    def ends() -> float:
        return float(sum(call() for _ in range(1000)))

    return _load(call, env, mode, ends, extra=0)


def vector(env_id: str, mode: str, count: int, **arguments: Any) -> Load:
    """A step of the vector environment, with its autoresets."""
    env: Any = gymnasium.make_vec(
        env_id, num_envs=count, vectorization_mode="vector_entry_point", **arguments
    )
    env.reset(seed=0)
    env.action_space.seed(0)
    calm = [np.full((count, 2), CRUISE, dtype=np.float32)]
    actions = cycle([env.action_space.sample() for _ in range(16)] if mode == "random" else calm)

    def call() -> Any:
        return env.step(next(actions))

    def ends() -> float:
        steps = max(200, 6400 // count)
        ended = sum(float(np.sum(np.bitwise_or(*call()[2:4]))) for _ in range(steps))
        return 1e3 * ended / (steps * count)

    return _load(call, env, mode, ends, extra=1)


def _load(
    call: Callable[[], object], env: Any, mode: str, ends: Callable[[], float], extra: int
) -> Load:
    """The pass of a mode; extra: calls beside the steps of an episode that its reset takes."""
    if mode == "calm":
        return Load(call, env.reset, BETWEEN, multiple=NOISE)
    if mode == "episodes":
        steps = int(env.unwrapped.simulation.settings.max_steps)
        return Load(call, env.reset, steps + extra, whole=True, ends=lambda: 1e3 / steps)
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

    torque, speed = (TORQUE, "rtk", "strawa"), (SPEED, "mocap", "focchi")
    env_id, sensors, vehicle = torque if drive == "torque" else speed
    entry: Any = registered.by_name(registered.registered_policies(), drive)[name]
    if isinstance(entry, list):
        entry = registered.open_archive(entry[0])
    context = PolicyContext(0.02, "sliding", make_sensors(sensors), drive, vehicle)
    policy = entry.make(context)
    seen = _drive(policy, count, env_id, 150, duration=30.0)
    first, later = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    state: Any = policy.predict(seen[0], None, first)[1]
    observations = cycle(seen[1:])

    def call() -> None:
        nonlocal state
        _, state = policy.predict(next(observations), state, later)

    return Load(call)


def identification(count: int) -> Load:
    """An update of all estimators, on observations of weak soil: there every one has work."""
    from baselines.linearizing.adaptive_policy import AdaptivePolicy

    driver = AdaptivePolicy()
    seen = _drive(driver, count, TORQUE, 250, uncertainty="weak-soil")
    observations = cycle(seen[50:])
    return Load(lambda: driver.stack.update(next(observations)))


def controllers() -> list[tuple[str, str]]:
    """(drive, name) of the registered controllers that are not handed the truth."""
    from tracked_env.benchmark.policies import ENVIRONMENTS, by_name, registered_policies
    from tracked_env.benchmark.policy_interface import PolicyContext, needs_truth

    pairs = []
    for drive, vehicle in (("torque", "strawa"), ("speed", "focchi")):
        entries: dict[str, Any] = by_name(registered_policies(), drive)
        for policy in registered_policies():
            context = PolicyContext(0.02, "sliding", drive=drive, vehicle=vehicle)
            if policy.env != ENVIRONMENTS[drive] or policy.is_trained:
                continue
            if not needs_truth(entries[policy.name].make(context)):
                pairs.append((drive, policy.name))
    return pairs


STEPS = 1000  # of a plant in one call: its overhead is below a percent
CONTROL_PERIOD = 0.02  # [s]


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


def _speeds(count: int) -> Any:
    """Sprocket speeds (N, 2) [rad/s] that turn each vehicle on a circle of its own."""
    return np.linspace((3.0, 4.0), (4.0, 8.0), count)


def distributed_alone(count: int, euler: bool) -> Load:
    """STEPS steps of the distributed plant.

    Euler steps of 1 ms cost one evaluation of all patches each; Rosenbrock steps of 2.5 ms, the
    default, cost two.
    """
    from tracked_env.physics.level_motion import hold_speeds
    from tracked_env.physics.parameters import VEHICLES
    from tracked_env.physics.patches_on_level_ground import make_patches

    states, loads, speeds = np.zeros((count, 6)), np.zeros((count, 6)), _speeds(count)
    parameters = np.tile(np.array(VEHICLES["focchi"], dtype=float), (count, 1))
    patches, h = make_patches(10, 4), 1e-3 if euler else 2.5e-3
    return Load(lambda: hold_speeds(states, speeds, parameters, patches, STEPS, h, euler, loads))


def terrain_alone(count: int, ground: str, step: float | None) -> Load:
    """STEPS steps of the plant on terrain, of that length [s].

    None: as many control periods at its default step.
    """
    from tracked_env.physics.parameters import VEHICLES
    from tracked_env.plants.standalone import TerrainRig
    from tracked_env.plants.terrain import LONGEST_STEP

    options = {"terrain": _grounds()[ground]}
    rig = TerrainRig(VEHICLES["focchi"], options, count, step=step or LONGEST_STEP)
    speeds, duration = _speeds(count), STEPS * (step or CONTROL_PERIOD)

    def stand() -> None:
        for row in range(count):
            rig.stand(0.0, 0.0, 0.1 * row, row)

    return Load(lambda: rig.advance(speeds, duration), stand)


def _goals(count: int) -> Any:
    """Goals (N, 3) from 1 to 4 m away."""
    drawn = np.random.default_rng(0).uniform((1.0, 0.0, 0.0), (4.0, 6.28, 6.28), (count, 3))
    distance, direction, yaw = drawn.T
    return np.stack([distance * np.cos(direction), distance * np.sin(direction), yaw], axis=1)


def paths(method: str) -> Load:
    """Paths to 1000 goals, without sampling them in time."""
    from baselines.planners import curves

    start, goals = np.zeros(3), _goals(1000)
    if method == "clothoid":
        return Load(lambda: curves.clothoid(start, goals))
    path = curves.dubins if method == "dubins" else curves.reeds_shepp
    return Load(lambda: path(start, goals, 0.2))


def plans(v_min: float, at_once: bool) -> Load:
    """Slippage-aware plans of the light vehicle to 100 goals: one after another, or at once."""
    from baselines.planners.least_time import optimal
    from baselines.planners.trajectory import Limits
    from baselines.slip.slip_sweep import identified_slip
    from tracked_env.physics.parameters import VEHICLES

    vehicle, goals = VEHICLES["focchi"], _goals(100)
    limits = Limits.of(vehicle, v_min=v_min, v_max=0.4)
    model = limits, vehicle, identified_slip(vehicle)
    if at_once:
        return Load(lambda: optimal((0, 0, 0), goals, *model, threads=2))
    each = cycle(goals)
    return Load(lambda: optimal((0, 0, 0), next(each), *model), multiple=len(goals))


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
        for count, mode in product(counts, ("calm", "random", "episodes")):
            options = arguments if mode == "random" else {**arguments, **CALM}
            if count == 1:
                make = partial(single, env_id, mode, **options)
                yield Row(f"{label} step, {mode}", 1, CARTPOLE, make)
            else:
                name, peer = f"{label} vector, {count}, {mode}", f"CartPole-v1 vector, {count}"
                yield Row(name, count, peer, partial(vector, env_id, mode, count, **options))
    for count in (1, 64):
        yield Row(f"reset, {_vehicles(count)}", count, CARTPOLE, partial(resets, count))


def policy_rows(registered: Sequence[tuple[str, str]]) -> Iterator[Row]:
    """Policies and estimators; registered: (drive, name) of the controllers."""
    for drive, name, network in (*((*pair, "") for pair in registered), *AGENTS):
        label = f"{name} ({network})" if network else name
        for count in (1, 64):
            text = f"predict {label}, {drive}, {_vehicles(count)}"
            yield Row(text, count, CARTPOLE, partial(predictions, drive, name, count))
    for count in (1, 64):
        name = f"identification stack, {_vehicles(count)}"
        yield Row(name, count, CARTPOLE, partial(identification, count))


def plant_rows() -> Iterator[Row]:
    """Plants without an environment, per step or per 20 ms of driving."""
    for count in (1, 64):
        for euler, name in ((True, "Euler step of 1 ms"), (False, "Rosenbrock step of 2.5 ms")):
            label = f"distributed plant alone, {name}, {_vehicles(count)}"
            yield Row(label, STEPS * count, CARTPOLE, partial(distributed_alone, count, euler))
        steps = (1e-3, "step of 1 ms"), (None, "20 ms of driving")
        for ground, (step, name) in product(_grounds(), steps):
            label = f"terrain plant alone, {ground}, {name}, {_vehicles(count)}"
            yield Row(label, STEPS * count, CARTPOLE, partial(terrain_alone, count, ground, step))


def planner_rows() -> Iterator[Row]:
    """Paths of 1000 goals at once; slippage-aware plans, mean over goals 1 to 4 m away."""
    for method in ("dubins", "reeds-shepp", "clothoid"):
        name = f"planner {method}, path, of 1000 goals"
        yield Row(name, 1000, CARTPOLE, partial(paths, method))
    for v_min, speed in ((0.4, "constant speed"), (0.15, "variable speed")):
        name = f"planner optimal, {speed}"
        yield Row(name, 1, CARTPOLE, partial(plans, v_min, False))
        name += ", 100 goals on two threads"
        yield Row(name, 100, CARTPOLE, partial(plans, v_min, True))


def rows(registered: Sequence[tuple[str, str]]) -> list[Row]:
    """All rows, peers first; registered: what `controllers` returns."""
    ours = policy_rows(registered), plant_rows(), planner_rows()
    return [row for part in (environment_rows(), *ours) for row in part]


def calls_of_a_pass(load: Load, seconds: float) -> int:
    """How many calls take about `seconds`; makes some, so that everything is compiled."""
    load.prepare()
    load.call()
    if load.whole:
        return load.calls
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
