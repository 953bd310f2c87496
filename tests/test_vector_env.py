"""The vector environment: same numbers as the single one, autoreset, options per row, SB3."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from tests.driving import assert_equal, wild_actions
from tests.test_rewards import COSTS, SHARP, compiled, of_arrays
from tests.test_uncertainty import Heavier
from tracked_env import SPEED, TERRAIN
from tracked_env import arrays as b
from tracked_env.env import TrackedVehicleEnv
from tracked_env.sb3 import make_vec_env
from tracked_env.step import INFO_KEYS
from tracked_env.vector_env import TrackedVehicleVectorEnv

HARD = {"uncertainty": "mixed", "duration": 1.5, "error_limit": 1.0, "expose_truth": True}


def test_make_vec_uses_the_project_s_own_vector_environment():
    env = gymnasium.make_vec("tracked_env:tracked_env/Torque-v0", num_envs=3)
    assert isinstance(env.unwrapped, TrackedVehicleVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert env.observation_space.shape[0] == 3


@pytest.mark.parametrize("limit", [1000, 40])  # [steps]; the episodes have 75
@pytest.mark.parametrize("mode", AutoresetMode)
def test_it_does_what_gymnasium_s_own_vector_env_does_with_single_environments(mode, limit):
    count = 5
    ours = TrackedVehicleVectorEnv(count, **HARD, autoreset_mode=mode, max_episode_steps=limit)
    singles = [lambda: TimeLimit(TrackedVehicleEnv(**HARD), limit)] * count
    theirs = SyncVectorEnv(singles, autoreset_mode=mode)
    first, info = ours.reset(seed=11)
    reference, reference_info = theirs.reset(seed=11)
    assert_equal(first, reference)
    assert info["truth"].keys() == reference_info["truth"].keys()
    ends = 0
    for actions in wild_actions(250, count):
        ours_step = ours.step(actions)
        theirs_step = theirs.step(actions)
        for left, right in zip(ours_step[:3], theirs_step[:3], strict=True):
            assert_equal(left, right)
        assert_equal(ours_step[3], theirs_step[3] & ~theirs_step[2])  # TimeLimit may say both
        for key in ("tracking_error", "is_success", *INFO_KEYS):
            rows = theirs_step[4].get("_" + key, np.zeros(count, bool))
            assert ours_step[4]["_" + key].all()
            assert np.array_equal(ours_step[4][key][rows], theirs_step[4][key][rows])
        if "final_obs" in theirs_step[4]:
            assert_equal(ours_step[4]["final_obs"], theirs_step[4]["final_obs"])
            assert_equal(ours_step[4]["_final_obs"], theirs_step[4]["_final_obs"])
            over = theirs_step[4]["_final_info"]
            for key in ("tracking_error", "is_success", *INFO_KEYS):
                one = ours_step[4]["final_info"][key][over]
                assert np.array_equal(one, theirs_step[4]["final_info"][key][over])
        ended = ours_step[2] | ours_step[3]
        ends += int(ended.sum())
        if mode is AutoresetMode.DISABLED and ended.any():
            mask = {"reset_mask": ended}
            readings = [env.reset(options=dict(mask))[0] for env in (ours, theirs)]
            assert_equal(*readings)
    assert ends > 2 * count


DRAWN = {"kind": "drawn", "of": {"kind": "fractal", "seed": 3, "height": 0.05}, "count": 4}
OUTAGES = {"pose_outage_gap": (0.4, 1.2), "pose_outage_length": (0.2, 0.8)}
NEAR = {"kind": "plan", "goals": [[0.1, 0.0, 0.0], [0.15, 0.01, 0.1]], "planner": "dubins"}
SHOWN = ["motion", "pose_error", "reference", "goal"]
ON_HILLS = {**TERRAIN, "uncertainty": "hills", "sensors": "rtk"}
KINDS = {
    "torque": {"uncertainty": "mixed"},
    "outages": {"sensors": {"preset": "ideal", **OUTAGES}},
    "noisy outages": {"sensors": {"preset": "rtk", **OUTAGES}},
    "torque on patches": {"plant": "distributed", "uncertainty": "loose-soil"},
    "speed": SPEED,
    "terrain": TERRAIN,
    "terrain by torque": {**TERRAIN, "drive": "torque", "uncertainty": ["hills", "slope"]},
    "height scan": {**ON_HILLS, "observation": [*TERRAIN["observation"], "height_scan"]},
    "drawn terrain": {**ON_HILLS, "terrain": DRAWN},
    "own law on drawn terrain": {**TERRAIN, "uncertainty": Heavier(2.0), "terrain": DRAWN},
    "own reward": {"reward": of_arrays, "costs": COSTS},
    "own reward on terrain": {**TERRAIN, "reward": SHARP, "costs": COSTS},
    "compiled reward": {**SPEED, "reward": compiled, "costs": COSTS},
    **{
        f"goal, {frame}": {**SPEED, "reference": {**NEAR, "frame": frame}, "observation": SHOWN}
        for frame in ("course", "body")
    },
}


@pytest.mark.parametrize("kind", KINDS)
def test_rows_threads_and_single_environments_agree_to_the_bit_over_ends_of_episodes(kind):
    hard = {**KINDS[kind], "duration": 1.5, "error_limit": 0.5, "expose_truth": True}
    same = {**hard, "autoreset_mode": "SameStep"}
    count = 20 if "plant" in hard else 520  # threads are used from 16 or from 512 vehicles on
    threaded, plain = (TrackedVehicleVectorEnv(count, **same, threads=n) for n in (3, 1))
    single, row = TrackedVehicleEnv(**hard), 7
    assert_equal(threaded.reset(seed=5), plain.reset(seed=5))
    alone, _ = single.reset(seed=5 + row)
    assert np.array_equal(threaded.simulation.observations[row], alone)
    ends = 0
    for actions in wild_actions(110, count):  # over the end of a block of noise
        one = threaded.step(actions)
        assert_equal(one, plain.step(actions))
        ends += int((one[2] | one[3]).sum())
        alone, reward, terminated, truncated, info = single.step(actions[row])
        values = one[4]
        if terminated or truncated:
            assert_equal(one[4]["final_obs"][row], alone)
            alone, values = single.reset()[0], one[4]["final_info"]
        assert np.array_equal(one[0][row], alone)
        assert (one[1][row], one[2][row], one[3][row]) == (reward, terminated, truncated)
        names = [key for key in info if key.startswith(("ended_", "reward_", "cost"))]
        assert all(info[key] == values[key][row] for key in names)
    assert ends >= count
    assert threaded.simulation._threads._pool and not plain.simulation._threads._pool
    threaded.close()


def test_disabled_autoreset_lets_an_ended_row_rest_until_its_mask_resets_it():
    env = TrackedVehicleVectorEnv(4, duration=0.2, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0, options={"rows": [None, None, None, {"start": {"offset_y": 50.0}}]})
    actions = np.zeros((4, 2), np.float32)
    _, _, terminated, truncated, _ = env.step(actions)
    assert terminated.tolist() == [False, False, False, True] and not truncated.any()
    resting = env.simulation.batch.floats[3, b.STATE : b.STATE + 8].copy()
    for _ in range(9):
        _, rewards, terminated, truncated, _ = env.step(actions)
        assert rewards[3] == 0.0 and terminated[3]
    assert np.array_equal(resting, env.simulation.batch.floats[3, b.STATE : b.STATE + 8])
    assert truncated.tolist() == [True, True, True, False]
    mask = np.array([False, True, False, True])
    before = env.simulation.observations.copy()
    observations, info = env.reset(options={"reset_mask": mask})
    assert np.array_equal(before[~mask], observations[~mask])
    assert not np.array_equal(before[1], observations[1])
    assert info["_tracking_error"].tolist() == mask.tolist()
    _, _, terminated, truncated, _ = env.step(actions)
    assert (terminated | truncated).tolist() == [True, False, True, False]


def test_a_masked_reset_with_a_seed_restarts_only_those_streams():
    env = TrackedVehicleVectorEnv(3, autoreset_mode=AutoresetMode.DISABLED)
    first, _ = env.reset(seed=9)
    env.step(np.zeros((3, 2), np.float32))
    again, _ = env.reset(seed=9, options={"reset_mask": np.array([True, False, True])})
    assert np.array_equal(first[[0, 2]], again[[0, 2]])
    assert not np.array_equal(first[1], again[1])


def test_staggered_episodes_are_cut_short_once_and_rows_are_out_of_step_from_then_on():
    env, plain = (
        TrackedVehicleVectorEnv(5, duration=0.2, autoreset_mode=AutoresetMode.SAME_STEP)
        for _ in range(2)
    )
    first, _ = env.reset(seed=0, options={"staggered": True})
    assert np.array_equal(first, plain.reset(seed=0)[0])  # the episodes are the same
    actions, ended, success = np.zeros((5, 2), np.float32), np.zeros((30, 5), bool), []
    for step in range(30):
        _, _, terminated, ended[step], info = env.step(actions)
        assert not terminated.any()
        success += [info["final_info"]["is_success"][ended[step]]] if ended[step].any() else []
    ends = [(1 + np.flatnonzero(column)).tolist() for column in ended.T]
    assert ends == [[2, 12, 22], [4, 14, 24], [6, 16, 26], [8, 18, 28], [10, 20, 30]]
    assert [one.tolist() for one in success[:5]] == [[False]] * 4 + [[True]]  # the last is whole
    assert np.concatenate(success[5:]).all()


def test_a_masked_staggered_reset_leaves_the_clocks_of_other_rows():
    env = TrackedVehicleVectorEnv(3, duration=0.2, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0)
    env.reset(options={"staggered": True, "reset_mask": np.array([True, False, True])})
    limits = env.simulation.batch.counters[:, b.MAX_STEP]
    assert limits.tolist() == [5, 10, 10]


def test_options_reach_every_row_and_rows_win_over_the_common_ones():
    env = TrackedVehicleVectorEnv(3, expose_truth=True)
    rows = [None, {"vehicle": {"mass": 1700.0}}, {"soil": {"cohesion": 9650.0}}]
    _, info = env.reset(seed=0, options={"vehicle": {"mass": 1600.0}, "rows": rows})
    assert info["truth"]["mass"].tolist() == [1600.0, 1700.0, 1600.0]
    assert info["truth"]["cohesion"][2] == 9650.0
    assert info["truth"]["cohesion"][0] != 9650.0


@pytest.mark.parametrize(
    "options, says",
    [
        ({"rows": [{}]}, "list of 2"),
        ({"rows": [{"vehicle": {"mas": 1.0}}, None]}, "Did you mean 'mass'"),
        ({"reset_mask": np.array([1, 0])}, "bool"),
        ({"reset_mask": np.array([False, False])}, "at least one True"),
        ({"soils": {}}, "Did you mean 'soil'"),
        ({"rows": [None, {"start": {"speed": 1e9}}]}, "vehicle 1: .*km/h"),
        *(({"rows": rows}, "list of 2") for rows in (5, [5, None], "ab", {0: {}, 1: {}})),
        *(({"reset_mask": mask}, "bool") for mask in (True, "ab")),
        *((options, "options") for options in (5, "start", [1], {5: {}})),
        ({"start": 5}, "options"),
        ({"vehicle": [1]}, "options"),
    ],
)
def test_wrong_options_change_no_row_and_use_up_no_random_numbers(options, says):
    env, plain = TrackedVehicleVectorEnv(2), TrackedVehicleVectorEnv(2)
    for one in (env, plain):
        one.reset(seed=0)
    with pytest.raises(ValueError, match=says):
        env.reset(options=options)
    assert np.array_equal(plain.simulation.batch.floats, env.simulation.batch.floats)
    assert np.array_equal(plain.reset()[0], env.reset()[0])


def test_one_non_finite_action_stops_the_whole_batch_before_it_moves():
    for count in (3, 600):
        env = TrackedVehicleVectorEnv(count)
        env.reset(seed=0)
        before = env.simulation.batch.floats.copy()
        actions = np.zeros((count, 2), np.float32)
        actions[2, 1] = np.nan
        with pytest.raises(ValueError, match=r"action\[2\].*finite"):
            env.step(actions)
        assert np.array_equal(before, env.simulation.batch.floats)


def test_the_sb3_adapter_hands_over_terminal_observations_and_learns():
    env = make_vec_env(n_envs=4, seed=3, env_kwargs={"duration": 0.4}, monitor=False)
    twin = TrackedVehicleVectorEnv(4, duration=0.4, autoreset_mode="Disabled")
    first = env.reset()
    assert np.array_equal(first, twin.reset(seed=3)[0])
    actions = np.full((4, 2), 0.2, np.float32)
    for step in range(20):
        observations, rewards, dones, infos = env.step(actions)
        last, expected, *_ = twin.step(actions)
        assert np.allclose(rewards, expected)
        assert dones.all() == (step == 19)
    for i in range(4):
        assert np.array_equal(infos[i]["terminal_observation"], last[i])
        assert infos[i]["TimeLimit.truncated"] is True
        terms = [infos[i][key] for key in INFO_KEYS]
        assert {type(term) for term in terms} == {float}
        assert rewards[i] == pytest.approx(sum(terms), abs=1e-6)
    assert not np.array_equal(observations, last)
    monitored = make_vec_env(n_envs=4, seed=0, env_kwargs={"duration": 0.4})
    assert isinstance(monitored, VecMonitor)
    model = PPO("MlpPolicy", monitored, n_steps=32, batch_size=64, device="cpu", seed=0)
    model.learn(256)
    assert model.ep_info_buffer[0]["l"] == 20
    with pytest.raises(NotImplementedError, match="share"):
        env.set_attr("duration", 1.0)


@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_diverged_row_ends_alone_with_finite_numbers_in_every_autoreset_mode(mode):
    env, plain = (TrackedVehicleVectorEnv(70, duration=1.0, autoreset_mode=mode) for _ in range(2))
    actions = np.full((70, 2), 0.2, np.float32)
    for one in (env, plain):
        one.reset(seed=0)
        one.step(actions)
    env.simulation.batch.floats[2, b.STATE + 3] = np.nan
    others = np.arange(70) != 2
    for step in range(5):
        readings, expected = env.step(actions), plain.step(actions)
        for left, right in zip(readings[:4], expected[:4], strict=True):
            assert np.array_equal(left[others], right[others])
        assert np.isfinite(readings[0]).all() and np.isfinite(readings[1]).all()
        assert (readings[2] | readings[3])[2] == (step == 0 or mode is AutoresetMode.DISABLED)
        if step == 0:
            assert readings[1][2] == -0.1 and readings[2][2] and not readings[3][2]
            if mode is AutoresetMode.SAME_STEP:
                last = readings[4]["final_obs"][2]
                assert env.single_observation_space.contains(last)
                assert readings[4]["final_info"]["reward_position"][2] == 0.0
