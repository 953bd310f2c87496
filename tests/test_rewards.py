"""Rewards of one's own and costs: the terms, what a function sees."""

import copy
import json

import gymnasium
import numba
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tests.driving import ON_PATH, assert_equal, make, wild_actions
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID, rewards
from tracked_env import arrays as b
from tracked_env.sb3 import make_vec_env
from tracked_env.step import INFO_KEYS, WEIGHTS
from tracked_env.vector_env import TrackedVehicleVectorEnv

FORWARD = np.full(2, 0.3, np.float32)
COSTS = {
    "tilt": 0.1, "slip": 0.1, "corridor": 0.2, "torque": 0.4, "obstacles": [[2.0, 0.0, 0.5]],
    "budget": 25,
}  # fmt: skip
DEFAULT = {name: {"weight": weight} for name, weight in WEIGHTS.items()}
SHARP = {"position": {"scale": 0.015}, "heading": {"weight": 0.0}, "effort": {"weight": -0.4}}


def of_arrays(its):
    """A reward that uses functions of NumPy that work on several numbers at once."""
    calm = np.square(its.action - its.last_action).mean(axis=1)
    near = np.exp(-np.abs(its.error_across)) + np.tanh(its.speed) + np.cos(its.heading_error)
    return near - calm - 10.0 * its.terminated - np.abs(its.slip).max(axis=1)


@numba.njit
def compiled(its):
    """A reward in a loop."""
    reward = np.empty(its.distance.size)
    for k in range(reward.size):
        reward[k] = np.exp(-its.distance[k] / its.contact_length[k]) - its.action[k, 0] ** 2
        reward[k] -= 5.0 if its.terminated[k] else 0.1 * its.torque[k, 1]
    return reward


@pytest.fixture
def registry(monkeypatch):
    """The names of rewards, as they were before the test afterwards."""
    monkeypatch.setattr(rewards, "_REGISTERED", {})
    return rewards._REGISTERED


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_the_default_weights_in_a_dict_are_the_reward_of_the_kernel_to_the_bit(mode):
    arguments = {"duration": 1.0, "error_limit": 0.8, "autoreset_mode": mode}
    env = TrackedVehicleVectorEnv(8, reward=DEFAULT, **arguments)
    plain = TrackedVehicleVectorEnv(8, **arguments)
    assert_equal(env.reset(seed=3), plain.reset(seed=3))
    ended = 0
    for actions in wild_actions(120, 8):
        step = env.step(actions)
        assert_equal(step, plain.step(actions))
        ended += np.sum(step[2] | step[3])
    assert ended > 0


@pytest.mark.parametrize("scale", [0.015, 0.25, 2.0])
def test_a_term_is_half_its_weight_at_its_scale(scale):
    rewards_ = {"position": {"weight": 2.0, "scale": scale}, "speed": {"weight": 0.0}}
    env = make(reward=rewards_, uncertainty="nominal", error_limit=1e3)
    length = env.simulation.solver.nominal.contact_length
    start = {**ON_PATH, "offset_y": scale * length}
    env.reset(seed=0, options={"start": start, "reference": {"kind": "straight"}})
    _, reward, _, _, info = env.step(np.zeros(2, np.float32))
    ratio = info["tracking_error"][0] / (scale * length)
    assert info["reward_position"] == pytest.approx(2.0 / (1.0 + ratio**2), rel=1e-12)
    assert ratio == pytest.approx(1.0, rel=0.2) and info["reward_speed"] == 0.0
    assert reward == pytest.approx(sum(info[name] for name in INFO_KEYS), abs=1e-15)


def outcomes(env_id, steps=20, options=None, **arguments):
    """What a function sees in each step of a drive, and `info` beside it."""
    seen = []

    def reward(its):
        seen.append(copy.deepcopy(its))
        return np.zeros(its.distance.size)

    env = make(env_id, reward=reward, expose_truth=True, error_limit=50.0, **arguments)
    env.simulation._scoring._reward = reward  # the environment has a copy
    env.reset(seed=1, options=options)
    seen.clear()
    infos = [env.step(np.float32([0.2, 0.6]))[4] for _ in range(steps)]
    return seen, infos


def test_a_function_sees_the_true_motion_in_si():
    seen, infos = outcomes(TORQUE_ID)
    for its, info in zip(seen, infos, strict=True):
        truth = info["truth"]
        assert all(len(of) == 1 for of in its)
        for name, of in (("x", its.x), ("yaw", its.yaw), ("v_x", its.speed)):
            assert of[0] == truth[name]
        assert its.yaw_rate[0] == truth["yaw_rate"] and its.tilt[0] == 0.0
        assert its.slip[0].tolist() == [truth["slip_left"], truth["slip_right"]]
        assert its.torque[0, 1] == truth["torque_right"] / truth["torque_limit"]
        assert its.speed_error[0] == its.reference_speed[0] - its.speed[0]
        distance, heading = info["tracking_error"]
        assert np.hypot(its.error_along, its.error_across)[0] == pytest.approx(distance, rel=1e-12)
        assert its.heading_error[0] == heading
        assert its.action[0].tolist() == np.float32([0.2, 0.6]).tolist()
    assert seen[0].last_action.tolist() == [[0.0, 0.0]]
    assert_equal(seen[1].last_action, seen[0].action)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_a_vehicle_to_the_right_and_behind_has_positive_errors(side, yaw):
    reference = {"kind": "straight", "speed": 1.0, "yaw": yaw}
    start = {**ON_PATH, "offset_x": -0.3 * side, "offset_y": -0.1 * side}
    options = {"start": start, "reference": reference}
    seen, _ = outcomes(TORQUE_ID, 1, options, uncertainty="nominal")
    assert seen[0].error_along[0] == pytest.approx(0.3 * side, abs=0.03)
    assert seen[0].error_across[0] == pytest.approx(0.1 * side, abs=0.03)


def test_the_tilt_is_the_slope_under_the_vehicle():
    terrain = {"kind": "plane", "slope_x": 0.2}
    seen, _ = outcomes(TERRAIN_ID, 40, terrain=terrain, uncertainty="nominal")
    assert seen[-1].tilt[0] == pytest.approx(np.arctan(0.2), abs=0.05)


@pytest.mark.parametrize("reward", [{"speed": {"weight": 2.0}}, of_arrays], ids=["dict", "numpy"])
def test_a_motion_that_is_not_finite_has_the_worst_terms_and_exceeds_every_limit(reward):
    seen = []

    def watched(its):
        seen.append(its)
        return of_arrays(its)

    env = TrackedVehicleVectorEnv(3, reward=reward, costs=COSTS, error_limit=4.0)
    if callable(reward):
        env.simulation._scoring._reward = watched
    env.reset(seed=0)
    env.simulation.batch.floats[1, b.STATE + 3] = np.nan
    _, rewards_, terminated, _, info = env.step(np.full((3, 2), 0.2, np.float32))
    assert terminated.tolist() == [False, True, False] and np.isfinite(rewards_).all()
    assert info["cost"][1] == 5.0
    if callable(reward):
        its = seen[-1]
        assert its.diverged.tolist() == its.terminated.tolist() == [False, True, False]
        assert (its.distance[1], its.error_along[1], its.error_across[1]) == (4.0, 4.0, 0.0)
    else:
        assert rewards_[1] == pytest.approx(WEIGHTS["effort"] + WEIGHTS["smoothness"])


def test_a_reward_that_is_not_finite_names_the_vehicle():
    env = TrackedVehicleVectorEnv(3, reward=lambda its: np.where(its.speed, np.nan, 0.0))
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"reward of vehicle 0 = nan; must be finite"):
        env.step(np.zeros((3, 2), np.float32))


def test_names_stand_for_dicts_and_functions(registry):
    rewards.register("sharp", SHARP)
    rewards.register("mine", of_arrays)
    for name, reward in (("sharp", SHARP), ("mine", of_arrays)):
        env, same = make(reward=name), make(reward=reward)
        env.reset(seed=2), same.reset(seed=2)
        assert env.step(FORWARD)[1] == same.step(FORWARD)[1]
        text = gymnasium.make(TORQUE_ID, reward=name).spec.to_json()
        assert json.loads(text)["kwargs"] == {"reward": SHARP if name == "sharp" else name}
    assert rewards.reward_record("sharp") == SHARP and rewards.reward_record("mine") == "mine"
    for name, reward, says in (
        ("mine", SHARP, "none of"),
        ("default", SHARP, "none of"),
        (3, SHARP, "must be text"),
        ("other", {"sped": {}}, "Did you mean 'speed'"),
        ("other", "mean", "unknown reward 'mean'"),
    ):
        with pytest.raises(ValueError, match=says):
            rewards.register(name, reward)
    assert [*registry] == ["sharp", "mine"]


# --- costs ----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("limits", "beyond", "within"),
    [
        ("corridor", 0.19, 0.21),
        ("slip", 0.0, 1.0),  # under way: at standstill a slip ratio has no meaning
        ("torque", 0.0, 10.0),
        ("tilt", 0.1, 0.3),
        ("obstacles", 0.71, 0.69),  # of a disc 1.2 m ahead with a radius of 0.5 m
    ],
)
def test_a_limit_is_exceeded_on_one_side_of_it_and_not_on_the_other(limits, beyond, within):
    arguments = {"uncertainty": "nominal", "error_limit": 50.0, "terrain": {"kind": "plane"}}
    arguments["terrain"]["slope_x"] = 0.2 if limits == "tilt" else 0.0
    start = {**ON_PATH, "offset_y": 0.2, "speed": 0.0}
    for limit, cost in ((beyond, 1.0), (within, 0.0)):
        costs = {limits: limit}
        if limits == "obstacles":
            costs = {"obstacles": [[40.0, 0.0, 1.0], [1.2, 0.2, 0.5]], "clearance": limit}
        env = make(TERRAIN_ID, costs=costs, **arguments)
        env.reset(seed=0, options={"start": start})
        for _ in range(10 if limits in ("tilt", "slip") else 1):
            info = env.step(np.full(2, 0.02, np.float32))[4]
        assert (info["cost"], info[f"cost_{limits}"]) == (cost, cost)
        assert type(info["cost"]) is float


def test_the_default_clearance_is_half_the_diagonal_of_the_vehicle():
    env = make(SPEED_ID)
    vehicle = env.simulation.solver.nominal
    half = 0.5 * np.hypot(vehicle.contact_length, vehicle.track_gauge + vehicle.track_width)
    start = {**ON_PATH, "speed": 0.0}
    for gap, cost in ((half - 0.02, 1.0), (half + 0.02, 0.0)):
        env = make(SPEED_ID, costs={"obstacles": [[0.0, 1.0 + gap, 1.0]]})
        env.reset(seed=0, options={"start": start})
        assert env.step(np.zeros(2, np.float32))[4]["cost"] == cost


def test_costs_pass_the_checker_and_leave_five_values_and_no_budget():
    env = make(costs={"slip": 0.1})
    check_env(env, skip_render_check=True)
    env.reset(seed=0)
    assert len(env.step(FORWARD)) == 5 and env.cost_budget is None
    assert make().cost_budget is None and "cost" not in make().reset(seed=0)[1]


def test_an_ended_row_has_its_last_costs_in_the_final_info_and_the_infos_of_sb3():
    costs = {"torque": 0.0, "corridor": 1e3}
    env = TrackedVehicleVectorEnv(2, costs=costs, duration=0.1, autoreset_mode="SameStep")
    env.reset(seed=0)
    venv = make_vec_env(n_envs=2, seed=0, env_kwargs={"costs": costs, "duration": 0.1})
    venv.reset()
    for k in range(5):
        actions = np.full((2, 2), 0.5, np.float32)
        _, _, _, truncated, info = env.step(actions)
        infos = venv.step(actions)[3]
        assert truncated.all() == (k == 4) and [one["cost"] for one in infos] == [1.0, 1.0]
    assert info["final_info"]["cost"].tolist() == info["final_info"]["_cost"].tolist() == [1, 1]
    assert info["cost"].tolist() == [0.0, 0.0]
