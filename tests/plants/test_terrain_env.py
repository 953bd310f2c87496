"""The plant on terrain in the environments: state in space, start, soil under patches, batches."""

import copy
import math

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.physics.parameters import VEHICLES
from tracked_env.plants.standalone import TerrainRig
from tracked_env.vector_env import TrackedVehicleVectorEnv

FIELD = [{"kind": "plane", "slope_x": 0.15, "slope_y": 0.1}, {"kind": "hills", "height": 0.3}]


def environment(drive=SPEED_ID, **arguments):
    options = {"terrain": FIELD, **arguments.pop("plant_options", {})}
    return gymnasium.make(drive, plant="terrain", plant_options=options, **arguments).unwrapped


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("name", "vehicle"), [(SPEED_ID, "focchi"), (TORQUE_ID, "strawa")])
def test_it_drives_in_the_environments_with_the_state_in_space(name, vehicle):
    env = environment(name, vehicle=vehicle, sensors="ideal", expose_truth=True)
    check_env(env, skip_render_check=True)
    env.reset(seed=0)
    for _ in range(100):
        *_, info = env.step(np.array([0.3, 0.35], np.float32))
    truth = info["truth"]
    field = env.simulation.solver.prepared.options[1]
    assert field.waves.shape == (1, 2, 4)
    assert abs(truth["roll"]) > 1e-3 and abs(truth["pitch"]) > 1e-3
    assert np.isfinite(list(truth.values())).all()
    rig = TerrainRig(VEHICLES[vehicle], {"terrain": FIELD})
    height = rig.field.at(truth["x"], truth["y"])[0]
    assert truth["z"] == pytest.approx(float(height), abs=0.15)


def test_an_episode_starts_on_the_ground_with_both_tracks_down():
    env = environment(sensors="ideal", expose_truth=True)
    start = {"speed": 0.0, "yaw_rate": 0.0}
    options = {"start": start, "schedule": [], "soil": {"friction_angle": 0.7}}
    _, info = env.reset(seed=3, options=options)
    first = info["truth"]
    for _ in range(50):
        *_, info = env.step(np.zeros(2, np.float32))
    last = info["truth"]
    for name, least in (("z", 0.01), ("roll", 0.04), ("pitch", 0.04), ("x", 0.02)):
        assert last[name] == pytest.approx(first[name], abs=least)


def test_rows_of_the_vector_environment_are_the_single_environment_bit_for_bit():
    arguments = {"plant": "terrain", "plant_options": {"terrain": FIELD}, "drive": "speed",
                 "vehicle": "focchi"}  # fmt: skip
    batch = TrackedVehicleVectorEnv(3, **arguments)
    batch.reset(seed=5)
    singles = [TrackedVehicleVectorEnv(1, **arguments) for _ in range(3)]
    for i, env in enumerate(singles):
        env.reset(seed=5 + i)
    action = np.array([[0.4, 0.5]], np.float32)
    for _ in range(20):
        together = batch.step(np.repeat(action, 3, axis=0))[0]
        alone = np.concatenate([env.step(action)[0] for env in singles])
        assert np.array_equal(together, alone)
    copied = copy.deepcopy(batch)
    assert np.array_equal(
        batch.step(np.repeat(action, 3, axis=0))[0], copied.step(np.repeat(action, 3, axis=0))[0]
    )


def braking(soil_at, direction):
    """Yaw [rad] after braking with one track on a slippery half of level ground."""
    env = TrackedVehicleVectorEnv(
        1, plant="terrain", drive="speed", vehicle="focchi", uncertainty="nominal",
        sensors="ideal", error_limit=1e3, plant_options={"soil_at": soil_at},
        reference={"kind": "straight", "speed": 1.0, "x": 0.0, "y": 0.0, "yaw": 0.0},
    )  # fmt: skip
    line = {"parameter": "friction_angle", "kind": "line", "target": 0.1, "x": 0.0, "y": 0.0,
            "direction": 0.5 * math.pi * direction, "edge": 0.01}  # fmt: skip
    still = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0, "speed": 1.0, "yaw_rate": 0.0}
    env.reset(seed=0, options={"start": still, "schedule": [line]})
    for _ in range(20):
        env.step(np.zeros((1, 2), np.float32))
    return env.simulation.column("yaw")[0]


def test_each_patch_meets_the_soil_of_its_place():
    left, right = braking("patches", -1), braking("patches", 1)
    assert left > 0.05, "the right track slides, the left one holds"
    assert right == pytest.approx(-left, rel=1e-6)
    assert abs(braking("centre", -1)) < 0.1 * left
