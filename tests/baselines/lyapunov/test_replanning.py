"""The controller that plans to the goal again every second, on the distributed plant."""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.stats import qmc

from baselines.estimators.measurement import DataSheet
from baselines.lyapunov import replanning
from baselines.lyapunov.replanning import FINAL, SETTLE, ReplanningPolicy
from baselines.registry import POLICIES
from baselines.slip.slip_sweep import with_friction
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyContext
from tracked_env.physics.parameters import VEHICLES
from tracked_env.plants.standalone import Rig
from tracked_env.sensors import MOCAP
from tracked_env.vector_env import TrackedVehicleVectorEnv

FOCCHI = VEHICLES["focchi"]
SHOWN = layout.make_layout(["motion", "drive", "age", "goal"])
PERIOD = 0.02  # [s]
IDEAL = DataSheet(*(0.0 for _ in DataSheet._fields))


def draw_goals(count):
    """Goals (count, 3) 1 to 4 m from the origin; constants were chosen on others, those of F."""
    unit = 2.0 * qmc.Halton(3, scramble=True, rng=0).random(400) - 1.0
    goals = unit * [4.0, 4.0, np.pi]
    distance = np.hypot(*goals.T[:2])
    return goals[(distance > 1.0) & (distance < 4.0)][:count]


def make(**changes):
    """`slc-replan` with ideal sensors."""
    options = {"data_sheet": IDEAL, "observation": SHOWN.names, **changes}
    return ReplanningPolicy(FOCCHI, PERIOD, **options)


def show(states, sprockets, goals, age=0.0, seen_at=None):
    """Observations (N, D): pose and velocity of `seen_at`, `age` [s] old; the rest of now."""
    old = states if seen_at is None else seen_at
    cosine, sine = np.cos(old[:, 2]), np.sin(old[:, 2])
    x, y, turn = (goals - old[:, :3]).T
    values = dict.fromkeys(SHOWN.names, np.zeros(len(states))) | {
        "v_x": old[:, 3],
        "v_y": old[:, 4],
        "yaw_rate": states[:, 5],
        "sprocket_speed_left": sprockets[:, 0],
        "sprocket_speed_right": sprockets[:, 1],
        "goal_x": cosine * x + sine * y,
        "goal_y": cosine * y - sine * x,
        "goal_cosine": np.cos(turn),
        "goal_sine": np.sin(turn),
        "pose_age": np.full(len(states), age),
    }
    return SHOWN.pack(values)


class Drive(NamedTuple):
    """What happened, over T steps."""

    states: np.ndarray  # (T, N, 6) pose and velocities
    observations: np.ndarray  # (T, N, D)
    actions: np.ndarray  # (T, N, 2)
    memory: Any  # the policy's state at the end
    off: np.ndarray  # (N,) [m] from the goal at the end
    turned: np.ndarray  # (N,) [rad] from its yaw there


def drive(
    policy, goals, frictions=(0.4, 0.1), change=2.0, duration=25.0, speed=0.0, late=0, starts=None
):
    """Drive to goals (N, 3) from the origin, at `speed` [m/s] there.

    frictions: until `change` [s], and then. late: steps by which pose and velocity are. starts
    (T, N): where episodes start; the vehicle goes on from where it is.
    """
    count, limit = len(goals), FOCCHI.sprocket_speed_limit
    rigs = [Rig("distributed", with_friction(FOCCHI, mu), count, "speed") for mu in frictions]
    sprockets = np.full((count, 2), speed / FOCCHI.sprocket_radius)
    rigs[0].states[:, 3] = speed
    rig, memory, states, observations, actions = rigs[0], None, [], [], []
    for k in range(round(duration / PERIOD)):
        if rig is not rigs[1] and k * PERIOD >= change:
            rigs[1].states[:] = rig.states
            rig = rigs[1]
        states.append(rig.states[:, :6].copy())
        back = min(late, k)
        seen = show(states[-1], sprockets, goals, PERIOD * back, states[-1 - back])
        action, memory = policy.predict(seen, memory, None if starts is None else starts[k])
        sprockets = limit * action.astype(np.float64)
        rig.advance(sprockets, PERIOD)
        observations.append(seen)
        actions.append(action)
    missed = (rig.states[:, :3] - goals).T
    off, turned = np.hypot(*missed[:2]), np.abs(np.arctan2(np.sin(missed[2]), np.cos(missed[2])))
    history = (np.array(rows) for rows in (states, observations, actions))
    return Drive(*history, memory, off, turned)


GOALS = draw_goals(64)
FLOORS = {"step": (0.4, 0.1), "same": (0.4, 0.4)}  # mu in the first 4 s, and then
COUNT = {"step": 64, "same": 24}
FAR = np.array([[2.0, 2.5, -0.4], [-3.0, -1.0, 2.0]])
BEHIND = np.array([[-2.0, 0.0, 0.0], [-1.0, 0.1, 3.0], [0.0, -1.5, 0.0], [3.0, 1.0, -3.0]])


@pytest.fixture(scope="module")
def runs():
    """Runs by floor and period of replanning."""
    return {
        (floor, period): drive(make(replan_period=period), GOALS[: COUNT[floor]], mu, change=4.0)
        for floor, mu in FLOORS.items()
        for period in (1.0, math.inf)
    }


def interval(values):
    """95 % interval of a mean."""
    half = 1.96 * np.std(values, ddof=1) / math.sqrt(len(values))
    return np.mean(values) - half, np.mean(values) + half


@pytest.mark.slow
def test_plans_of_the_moment_end_nearer_to_the_goal_where_the_floor_turns_slippery(runs):
    again, once = runs["step", 1.0], runs["step", math.inf]
    low, _high = interval(once.off - again.off)
    assert low > 0.0
    assert again.off.mean() < 0.75 * once.off.mean()


@pytest.mark.slow
def test_where_nothing_changes_plans_of_the_moment_are_as_good_as_one(runs):
    again, once = runs["same", 1.0], runs["same", math.inf]
    _low, high = interval(again.off - once.off)
    assert high < 0.002
    assert again.off.max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("floor", FLOORS)
def test_vehicles_come_to_rest_at_the_goal_with_its_yaw(runs, floor):
    run = runs[floor, 1.0]
    plans = run.memory.plans
    assert (plans.since > plans.duration + SETTLE).all()
    assert run.off.max() < 0.05
    assert run.turned.max() < 0.01
    np.testing.assert_array_equal(run.actions[-1], 0.0)
    assert np.abs(run.states[-1, :, 3:]).max() < 1e-3
    assert plans.followed.mean() > 5.0
    assert (plans.not_found == 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("floor", FLOORS)
def test_no_vehicle_drives_circles_to_correct_what_is_left_of_its_error(runs, floor):
    again, once = (
        PERIOD * np.abs(runs[floor, period].states[:, :, 5]).sum(axis=0)
        for period in (1.0, math.inf)
    )
    assert (again < once + math.pi / 2.0).all()
    assert runs["step", 1.0].memory.plans.refused.sum() > 0


@pytest.mark.parametrize(
    ("changes", "farthest"),
    [
        pytest.param({}, 0.02, marks=pytest.mark.slow),
        ({"speed": 0.35}, 0.02),
        ({"late": 8}, 0.04),
        pytest.param({"frictions": (0.1, 0.6)}, 0.03, marks=pytest.mark.slow),
    ],
    ids=["from rest", "in motion", "pose 0.16 s late", "from ice"],
)
def test_goals_behind_and_beside_are_reached(changes, farthest):
    run = drive(make(), BEHIND, **{"frictions": (0.4, 0.4), **changes})
    assert run.off.max() < farthest
    assert run.turned.max() < 0.05


def converging(monkeypatch, when):
    """Plans converge for numbers of the call that `when` holds for; returns the calls."""
    optimal, calls = replanning.optimal, []

    def counted(*arguments, **options):
        calls.append(arguments)
        return optimal(*arguments, **options)._replace(converged=when(len(calls)))

    monkeypatch.setattr(replanning, "optimal", counted)
    return calls


def test_a_plan_that_is_not_found_leaves_the_one_before_and_is_counted(monkeypatch):
    once = drive(make(replan_period=math.inf), FAR[:1], duration=7.0)
    calls = converging(monkeypatch, lambda number: number == 1)
    run = drive(make(), FAR[:1], duration=7.0)
    np.testing.assert_array_equal(run.actions, once.actions)
    assert run.memory.plans.not_found[0] == len(calls) - 1 == 6
    assert run.memory.plans.followed[0] == 1


def test_without_any_plan_the_vehicle_stands_and_asks_again(monkeypatch):
    converging(monkeypatch, lambda number: number >= 3)
    run = drive(make(replan_period=math.inf), FAR[:1], duration=3.0)
    begun = np.flatnonzero(np.abs(run.actions[:, 0]).max(axis=1) > 0.0)[0]
    assert begun == round(2.0 / PERIOD)
    assert run.memory.plans.not_found[0] == 2


def test_plans_are_asked_for_every_second_until_little_is_left():
    run = drive(make(), FAR[:1], (0.4, 0.4), duration=12.0)
    policy, memory, attempts, left = make(), None, [], []
    for k, seen in enumerate(run.observations):
        before = None if memory is None else memory.plans
        _action, memory = policy.predict(seen, memory)
        if memory.plans.since_attempt[0] == 0.0:
            attempts.append(k)
            left.append(math.inf if before is None else float(before.duration[0] - before.since[0]))
    assert set(np.diff(attempts)) == {round(1.0 / PERIOD)}
    assert min(left) > FINAL
    assert memory.plans.duration[0] - (12.0 - PERIOD * attempts[-1]) < FINAL


def test_a_row_of_a_batch_with_another_clock_is_the_vehicle_alone_to_the_bit():
    count, steps = 64, 150
    rng = np.random.default_rng(5)
    begins = rng.integers(0, 60, count)
    starts = np.zeros((steps, count), dtype=bool)
    starts[begins, np.arange(count)] = True
    goals = np.tile(draw_goals(16), (4, 1))
    run = drive(make(), goals, (0.4, 0.2), change=1.0, duration=steps * PERIOD, starts=starts)
    assert len(set(run.memory.plans.since)) > 30
    for i in (0, 17, 63):
        alone, memory = make(), None
        for k in range(begins[i], steps):
            alone = make() if k == 100 else alone  # the state is all that is remembered
            action, memory = alone.predict(run.observations[k, i], memory)
            np.testing.assert_array_equal(action, run.actions[k, i])
        np.testing.assert_array_equal(memory.plans.samples[0], run.memory.plans.samples[i])


@pytest.mark.parametrize("first", [0, 30], ids=["from the start", "under way"])
def test_missing_samples_are_no_error(first):
    run = drive(make(), FAR, duration=2.0)
    policy, memory = make(), None
    for k, seen in enumerate(run.observations):
        lost = np.full_like(seen, np.nan) if first <= k < first + 40 else seen
        action, memory = policy.predict(lost, memory)
        assert np.isfinite(action).all()
        if first == 0 and k < 40:
            np.testing.assert_array_equal(action, 0.0)
    assert (memory.plans.duration > 5.0).all()
    assert (np.abs(action).max(axis=1) > 0.05).all()


def test_an_observation_without_a_goal_is_refused_in_one_line():
    context = PolicyContext(PERIOD, "sliding", MOCAP, "speed", VEHICLES["focchi"])
    for name in ("slc-replan", "slc-once"):
        with pytest.raises(ValueError, match=r"the observation lacks .*goal") as refused:
            POLICIES[name](context)
        assert "\n" not in str(refused.value)
        POLICIES[name](context._replace(observation=SHOWN.names))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"replan_period": 0.001}, "replan_period = 0.001 s; must be the control period"),
        ({"replan_period": math.nan}, "replan_period = nan s"),
    ],
)
def test_arguments_that_make_no_plan_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        make(**changes)


@pytest.mark.slow
def test_in_the_environment_every_goal_is_reached_on_an_unknown_floor():
    drive = {"vehicle": "focchi", "plant": "distributed", "drive": "speed", "sensors": "mocap"}
    reference = {"kind": "plan", "goals": "halton", "planner": "dubins"}
    drive |= {"observation": (*layout.V0.groups, "goal"), "reference": reference}
    env = TrackedVehicleVectorEnv(8, uncertainty="friction", duration=25.0, **drive)
    context = PolicyContext(PERIOD, "sliding", MOCAP, "speed", VEHICLES["focchi"], env.layout.names)
    policy, memory = POLICIES["slc-replan"](context), None
    seen, _ = env.reset(seed=4)
    for _ in range(1240):
        action, memory = policy.predict(seen, memory)
        seen, _, terminated, _, _ = env.step(action)
        assert not terminated.any()
    values = env.layout.unpack(seen)
    assert np.hypot(values["goal_x"], values["goal_y"]).max() < 0.04
    assert np.abs(values["goal_sine"]).max() < 0.02
    np.testing.assert_array_equal(action, 0.0)
