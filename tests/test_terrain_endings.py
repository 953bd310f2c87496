"""Why episodes of `tracked_env/Terrain-v0` end, and where that is said."""

import gymnasium
import numpy as np

from tests.test_terrain_v0 import CALM, ENDINGS, ON_PATH, ROUGH, STANDING, UPHILL, make
from tracked_env import TERRAIN, TERRAIN_ID
from tracked_env import arrays as b
from tracked_env.sb3 import make_vec_env
from tracked_env.vector_env import TrackedVehicleVectorEnv


def test_leaving_the_map_ends_the_episode_with_that_reason():
    heights = np.zeros((9, 9)).tolist()
    env = make(
        **{**CALM, "plant_options": {"terrain": {"kind": "map", "heights": heights, "cell": 0.25}}}
    )
    env.reset(seed=0, options={"start": ON_PATH, **ROUGH})
    for _ in range(200):
        *_, terminated, truncated, info = env.step(np.float32([0.5, 0.5]))
        if terminated or truncated:
            break
        assert not any(info[name] for name in ENDINGS)
    assert terminated and not truncated and not info["is_success"]
    assert [info[name] for name in ENDINGS] == [False, False, True, False]
    assert 0.5 < info["truth"]["x"] < 1.0


def test_tilting_beyond_the_limit_ends_the_episode_with_that_reason():
    steep = {"terrain": {"kind": "ramp", "slope": 0.5, "start": 0.5}, "tilt_limit": 0.3}
    env = make(**{**CALM, "plant_options": steep})
    env.reset(seed=0, options={"start": ON_PATH, **ROUGH})
    for _ in range(200):
        *_, terminated, _, info = env.step(np.float32([0.5, 0.5]))
        truth = info["truth"]
        tilt = np.arccos(np.cos(truth["pitch"]) * np.cos(truth["roll"]))
        assert terminated == (tilt > 0.3)
        if terminated:
            break
    assert terminated and [info[name] for name in ENDINGS] == [False, True, False, False]


def test_leaving_the_path_has_its_flag_and_time_has_none():
    env = make(**{**CALM, "error_limit": 0.4, "reference": {"kind": "straight", "speed": 0.5}})
    env.reset(seed=0, options=STANDING)
    for _ in range(200):
        *_, terminated, truncated, info = env.step(np.zeros(2, np.float32))
        if terminated:
            break
    assert [info[name] for name in ENDINGS] == [True, False, False, False]
    env = make(**{**CALM, "duration": 0.5})
    env.reset(seed=0)
    for _ in range(25):
        *_, terminated, truncated, info = env.step(np.float32([0.35, 0.35]))
    assert truncated and not terminated and not any(info[name] for name in ENDINGS)


def test_the_same_step_reset_keeps_the_reason_in_final_info():
    options = {"terrain": {"kind": "map", "heights": np.zeros((9, 9)).tolist(), "cell": 0.25}}
    env = TrackedVehicleVectorEnv(
        2, **{**TERRAIN, **CALM, "plant_options": options}, autoreset_mode="SameStep"
    )
    env.reset(seed=0, options={"start": ON_PATH, **ROUGH})
    for _ in range(200):
        *_, terminated, _, info = env.step(np.full((2, 2), 0.5, np.float32))
        if terminated.any():
            break
    assert info["final_info"]["ended_off_map"].all() and not info["ended_off_map"].any()


def test_stable_baselines_reads_the_reason_too():
    options = {"terrain": {"kind": "map", "heights": np.zeros((9, 9)).tolist(), "cell": 0.25}}
    env = make_vec_env(TERRAIN_ID, 2, env_kwargs={**CALM, "plant_options": options})
    env.reset()
    dones = [False]
    while not any(dones):
        *_, dones, infos = env.step(np.full((2, 2), 0.8, np.float32))
    flags = {name: infos[int(np.argmax(dones))][name] for name in ENDINGS}
    assert flags == {name: name == "ended_off_map" for name in ENDINGS}


def test_other_environments_have_no_such_flags():
    env = gymnasium.make("tracked_env/Speed-v0")
    _, info = env.reset(seed=0)
    assert not any(name.startswith("ended_") for name in info)


def test_off_map_and_tilt_do_not_outlive_their_episode():
    env = make(**{**CALM, "plant_options": {**UPHILL, "tilt_limit": 0.1}})
    env.reset(seed=0)
    assert env.simulation.batch.floats[0, b.FAILURE] == 1.0
    *_, terminated, _, info = env.step(np.zeros(2, np.float32))
    assert terminated and info["ended_tilted"]
    _, info = env.reset(seed=0)
    assert not any(info[name] for name in ENDINGS)
