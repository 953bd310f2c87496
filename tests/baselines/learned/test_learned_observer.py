"""The learned observer: its network, its features, and what it may change."""

import math
from functools import partial

import numpy as np
import pytest

from baselines.learned import gated_network as gated
from baselines.learned import learned_observer as learned
from baselines.learned.learned_observer import (
    FEATURES,
    LIMIT,
    MOTION,
    LearnedObserver,
    observer_layers,
)
from baselines.registry import POLICIES
from tracked_env import observation as layout
from tracked_env.benchmark.policy_interface import PolicyContext
from tracked_env.sensors import make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

LATE, OUTAGES = {"preset": "rtk", "pose_delay": 0.2}, "rtk-outages"
COLUMNS = [layout.INDEX[name] for name in MOTION]
SCALES = layout.SCALE[COLUMNS]


def weights_of(hidden=24, middle=16, seed=0, size=1.0):
    """Weights of a network of random numbers."""
    rng, inputs = np.random.default_rng(seed), len(FEATURES)
    shapes = {
        "gru.weight_ih_l0": (3 * hidden, inputs), "gru.weight_hh_l0": (3 * hidden, hidden),
        "gru.bias_ih_l0": (3 * hidden,), "gru.bias_hh_l0": (3 * hidden,),
        "middle.weight": (middle, hidden + inputs), "middle.bias": (middle,),
        "last.weight": (2 * len(MOTION), middle), "last.bias": (2 * len(MOTION),),
    }  # fmt: skip
    return {
        name: (size * rng.normal(size=shape) / math.sqrt(shape[-1])).astype(np.float32)
        for name, shape in shapes.items()
    }


def vehicles(count, sensors="rtk", **arguments):
    """An environment of hard episodes, and what policies may know of it."""
    env = TrackedVehicleVectorEnv(
        count, sensors=sensors, uncertainty="alternating-all", duration=6.0, **arguments
    )
    sheet = make_sensors(sensors, torque_limit=env.simulation.solver.nominal.torque_limit)
    return env, PolicyContext(0.02, "sliding", sheet)


def drive(count, network, base="adaptive", sensors="rtk", steps=60, each=None):
    """Actions (steps, count, 2) of a policy behind an observer, or without one (False)."""
    env, context = vehicles(count, sensors)
    policy = POLICIES[base](context)
    if network is not False:
        policy.correct_motion(partial(LearnedObserver, network))
    observation, _ = env.reset(seed=7)
    state, actions = None, []
    for _ in range(steps):
        action, state = policy.predict(observation, state)
        if each is not None:
            each(policy, env)
        actions.append(action)
        observation, *_ = env.step(action)
    env.close()
    return np.array(actions)


@pytest.mark.parametrize("recurrent", [True, False])
def test_the_network_is_that_of_pytorch(recurrent):
    torch = pytest.importorskip("torch")
    weights, hidden, rng = weights_of(128, 128), 128, np.random.default_rng(1)
    network = observer_layers(weights, recurrent)
    x = rng.normal(size=(5, 7, len(FEATURES))).astype(np.float32)
    gru = torch.nn.GRU(len(FEATURES), hidden)
    gru.load_state_dict({n[4:]: torch.from_numpy(v) for n, v in weights.items() if n[:3] == "gru"})
    state = np.zeros((7, hidden), np.float32)
    run = gated.BatchNetwork(network, 7)
    remembered = None
    for inputs in x:
        outputs = run(inputs, state)
        given = torch.from_numpy(inputs)
        h, remembered = gru(given[None], remembered if recurrent else None)
        both = torch.cat([h[0], given], dim=1)
        middle = (
            torch.from_numpy(weights["middle.weight"]),
            torch.from_numpy(weights["middle.bias"]),
        )
        last = torch.from_numpy(weights["last.weight"]), torch.from_numpy(weights["last.bias"])
        linear = torch.nn.functional.linear
        expected = linear(torch.relu(linear(both, *middle)), *last).detach().numpy()
        assert np.abs(state - h[0].detach().numpy()).max() < 1e-6
        assert np.abs(outputs - expected).max() < 3e-6  # of numbers of order one


def test_the_hyperbolic_tangent_is_that_of_the_library_to_single_precision():
    x = np.concatenate([np.linspace(-12.0, 12.0, 4001), [1e-8, -1e-30, 0.0]]).astype(np.float32)
    values = np.array([gated._tanh(each) for each in x])
    assert np.abs(values - np.tanh(x.astype(float))).max() < 4e-7
    assert np.abs(values).max() <= 1.0


@pytest.mark.parametrize("base", ["adaptive", "mpc-adaptive"])
@pytest.mark.parametrize("sensors", [LATE, OUTAGES])
def test_a_batch_has_the_bits_of_its_single_vehicles(base, sensors):
    network = observer_layers(weights_of(), True)
    batch, single = (drive(n, network, base, sensors) for n in (3, 1))
    assert np.array_equal(batch[:, :1], single)


@pytest.mark.parametrize("base", ["adaptive", "mpc-adaptive"])
def test_an_observer_that_corrects_nothing_leaves_the_actions_as_they_are(base):
    plain = drive(2, False, base)
    assert np.array_equal(drive(2, None, base), plain)
    silent = weights_of()
    silent["last.weight"][:] = 0.0
    silent["last.bias"][:] = 0.0
    assert np.array_equal(drive(2, observer_layers(silent, True), base), plain)
    assert not np.array_equal(drive(2, observer_layers(weights_of(), True), base), plain)


def test_what_the_controller_sees_moves_by_the_limit_at_most():
    def check(policy, env):
        of = policy.corrector
        moved = np.abs(of.shown - of.before) / of.units
        assert moved.max() <= LIMIT + 1e-3
        for column, of_pose in ((0, 0), (1, 0), (2, 1)):
            units = of.units[:, column]
            assert (units >= learned.LEAST_UNITS[of_pose]).all()
            assert (units <= learned.LARGEST_UNITS[of_pose]).all()
        largest.append(moved.max())

    largest = []
    drive(3, observer_layers(weights_of(size=30.0), True), each=check)
    assert max(largest) > 0.99 * LIMIT


def test_a_filter_that_has_let_its_pose_go_moves_no_heading_by_much():
    def let_go(policy, env):
        step, observation = policy.identification, np.zeros((2, layout.SIZE), np.float32)
        answers = step.parts.answers
        answers["slip"]["covariance"][:, 2, 2] = 0.3**2
        policy.corrector.correct(observation, step, answers["actuators"])
        largest.append(np.abs(policy.corrector.shown - policy.corrector.before)[:, 2].max())

    largest = []
    drive(2, observer_layers(weights_of(size=30.0), True), each=let_go)
    assert max(largest) == pytest.approx(0.1, abs=1e-6)  # rad, LIMIT times the largest unit


def test_it_goes_on_from_an_earlier_state():
    env, context = vehicles(2, LATE)
    policy = POLICIES["adaptive"](context)
    policy.correct_motion(partial(LearnedObserver, observer_layers(weights_of(), True)))
    observation, _ = env.reset(seed=3)
    state, seen = None, []
    for _ in range(30):
        seen.append((observation, state))
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
    env.close()
    last = action
    state = seen[20][1]
    for earlier, _ in seen[20:]:
        action, state = policy.predict(earlier, state)
    assert np.array_equal(action, last)


def test_a_late_pose_is_compared_with_the_motion_of_its_time():
    """A vehicle at 2 m/s is 0.4 m, 20 deviations, further when its pose comes."""
    position = [FEATURES.index(f"innovation_{axis}") for axis in "xy"]
    fresh = FEATURES.index("pose_is_new")
    seen = []
    drive(
        4, None, sensors=LATE, steps=200, each=lambda p, _: seen.append(p.corrector.features.copy())
    )
    values = np.concatenate(seen[50:])
    values = values[values[:, fresh] > 0.0][:, position]
    assert len(values) > 50
    assert np.sqrt((values**2).mean()) < 2.0


def test_without_noise_nothing_is_corrected():
    network = observer_layers(weights_of(), True)
    assert np.array_equal(drive(2, network, sensors="ideal"), drive(2, False, sensors="ideal"))


def test_weights_of_another_shape_are_refused():
    weights = weights_of()
    weights["middle.weight"] = weights["middle.weight"][:, :-1]
    with pytest.raises(ValueError, match=r"middle\.weight"):
        observer_layers(weights, True)
