"""`tracked_env/Speed-v0`, and the distributed plant in both environments."""

import numpy as np
import pytest

from tests import driving
from tests.driving import ON_PATH, run
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env import observation as obs
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics.parameters import VEHICLES

BY_TORQUE = {"plant": "distributed", "uncertainty": "loose-soil"}
STRAIGHT = {"kind": "straight", "speed": 0.3}
CALM = {"reference": STRAIGHT, "uncertainty": "nominal", "sensors": "ideal", "expose_truth": True}


def make(env_id=SPEED_ID, **arguments):
    return driving.make(env_id, **arguments)


def test_both_ids_are_one_class_and_show_the_same_observation():
    speed, torque = make(), make(TORQUE_ID)
    assert type(speed) is type(torque) is TrackedVehicleEnv
    assert speed.observation_space == torque.observation_space
    assert speed.action_space == torque.action_space


def test_an_action_is_the_sprocket_speed_over_its_limit():
    env = make(**CALM)
    options = {"start": ON_PATH}
    observations, _, info = run(env, 100, np.tile([0.3, 0.5], (100, 1)), options=options)
    truth = info["truth"]
    limit = VEHICLES["focchi"].sprocket_speed_limit
    assert truth["sprocket_speed_left"] == pytest.approx(0.3 * limit, rel=1e-6)
    assert truth["sprocket_speed_right"] == pytest.approx(0.5 * limit, rel=1e-6)
    assert truth["yaw_rate"] > 0.05
    assert obs.unpack(observations[-1])["sprocket_speed_right"] == pytest.approx(0.5 * limit, 1e-5)


def test_a_drive_that_lags_follows_its_demand_exponentially():
    env = make(**CALM)
    options = {"start": {**ON_PATH, "speed": 0.0}, "vehicle": {"drive_time_constant": 0.1}}
    _, _, info = run(env, 5, np.full((5, 2), 0.4), options=options)  # 0.1 s
    expected = 4.0 * (1.0 - np.exp(-1.0))
    assert info["truth"]["sprocket_speed_left"] == pytest.approx(expected, rel=1e-6)


def test_straight_on_the_drag_is_the_rolling_resistance():
    env = make(**CALM)
    _, _, info = run(env, 200, np.full((200, 2), 0.35), options={"start": ON_PATH})
    truth = info["truth"]
    drag = 0.025 * 62.0 * 9.81 / 2.0
    assert truth["effort_left"] == pytest.approx(drag, rel=1e-3)
    assert truth["torque_left"] == pytest.approx(drag * 0.0856, rel=1e-3)
    assert 0.0 < truth["slip_left"] < 0.01


@pytest.mark.parametrize("steps", [3, 10])
def test_torque_on_ice_spins_up_the_sprocket_against_its_inertia_before_the_vehicle(steps):
    slippery = {"friction_angle": 0.05, "cohesion": 0.0, "longitudinal_resistance": 0.0}
    env = make(TORQUE_ID, plant="distributed", **{**CALM, "reference": "straight"})
    options = {"soil": slippery, "start": {**ON_PATH, "speed": 0.0}}
    _, _, info = run(env, steps, np.full((steps, 2), 0.5), options=options)
    truth, t, lag = info["truth"], 0.02 * steps, 0.05
    belt = truth["sprocket_speed_left"] * 0.3
    strength = 0.5 * truth["mass"] * 9.81 * np.tan(0.05)
    if steps == 10:
        assert truth["effort_left"] == pytest.approx(strength, rel=0.02)
        assert truth["sprocket_speed_limit"] * 0.3 > belt > 5.0 * truth["v_x"] > 0.0
    else:
        pushed = 0.5 * 8000.0 / 0.3 * (t - lag * (1.0 - np.exp(-t / lag)))
        expected = 0.3**2 / truth["sprocket_inertia"] * (pushed - strength * t)
        assert belt == pytest.approx(expected, rel=0.02)


def test_an_episode_starts_with_belts_that_roll():
    env = make(**CALM)
    start = {**ON_PATH, "speed": 0.4, "yaw_rate": 0.5}
    _, info = env.reset(seed=0, options={"start": start})
    truth = info["truth"]
    assert truth["sprocket_speed_left"] * 0.0856 == pytest.approx(0.4 - 0.303 * 0.5)
    assert truth["sprocket_speed_right"] * 0.0856 == pytest.approx(0.4 + 0.303 * 0.5)


def test_success_is_measured_in_contact_lengths():
    env = make(**{**CALM, "duration": 1.0})
    for speed, succeeds in ((0.35, True), (0.0, False)):
        # Standing still the vehicle is 0.3 m behind after 1 s: an RMSE of 0.17 m, and l/4 = 0.175.
        start = {**ON_PATH, "offset_x": 0.0 if succeeds else -0.1}
        _, _, info = run(env, 60, np.full((60, 2), speed), options={"start": start})
        assert info["is_success"] is succeeds
