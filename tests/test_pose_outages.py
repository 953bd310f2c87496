"""Outages of the pose: a renewal process of its own, in which inertial and drive sensors go on."""

import json

import gymnasium
import numpy as np
import pytest

from tracked_env import observation as obs
from tracked_env import sensors
from tracked_env.sensors import CHANNELS
from tracked_env.vector_env import TrackedVehicleVectorEnv

PERIOD = 0.02  # [s]
GAP, LENGTH = (0.4, 1.2), (0.2, 0.8)  # [s]
OUTAGES = {"pose_outage_gap": GAP, "pose_outage_length": LENGTH}
WITH_OUTAGES = {"preset": "rtk", **OUTAGES}
ACTION = np.array([0.3, 0.2], dtype=np.float32)
POSE = CHANNELS[:5]
AGE = obs.INDEX["pose_age"]


def vehicles(count, **arguments):
    defaults = {"sensors": WITH_OUTAGES, "error_limit": 1e6}
    return TrackedVehicleVectorEnv(count, autoreset_mode="Disabled", **{**defaults, **arguments})


def observations(env, steps, seed=0, **arguments):
    """Observations (steps + 1, N, D) under one action."""
    actions = np.tile(ACTION, (env.num_envs, 1))
    readings = [env.reset(seed=seed, **arguments)[0]]
    return np.array(readings + [env.step(actions)[0] for _ in range(steps)])


def runs(missing):
    """(gaps, lengths) [steps] of one vehicle that are complete: (steps,) bool."""
    edges = np.flatnonzero(np.diff(missing.astype(int)))
    pieces = np.diff(np.concatenate([[-1], edges]))
    return pieces[::2], pieces[1::2]


def test_gaps_and_lengths_are_uniform_in_their_ranges_and_independent():
    env = vehicles(300, duration=40.0)
    missing = observations(env, 1500)[:, :, AGE] > 0.5 * PERIOD
    gaps, lengths = zip(*(runs(row) for row in missing.T), strict=True)
    assert not missing[0].any()
    for pieces, (low, high) in ((gaps, GAP), (lengths, LENGTH)):
        first = np.array([row[:12] for row in pieces]) * PERIOD  # of all as many: no bias
        assert first.min() == pytest.approx(low, abs=PERIOD)
        assert first.max() == pytest.approx(high, abs=PERIOD)
        assert first.mean() == pytest.approx(0.5 * (low + high), rel=0.02)
        assert first.std() == pytest.approx((high - low) / np.sqrt(12.0), rel=0.05)
        inside = (first - first.mean()) / first.std()
        assert abs((inside[:, 1:] * inside[:, :-1]).mean()) < 0.06  # 3.5 standard deviations
        assert abs((inside[1:] * inside[:-1]).mean()) < 0.06  # of vehicles that are neighbours
    pairs = [np.array([row[:12] for row in pieces], float) for pieces in (gaps, lengths)]
    gap, length = ((p - p.mean()) / p.std() for p in pairs)
    assert abs((gap * length).mean()) < 0.06
    assert abs((gap[:, 1:] * length[:, :-1]).mean()) < 0.06


def test_outages_leave_every_other_number_as_it_is():
    plain, holed = (
        observations(vehicles(8, sensors=sheet), 300) for sheet in ("rtk", WITH_OUTAGES)
    )
    missing = holed[:, :, AGE] > 0.5 * PERIOD
    assert 0.2 < missing.mean() < 0.6
    assert np.array_equal(plain[~missing], holed[~missing])
    pose = {"position_error_x", "position_error_y", "heading_error", "pose_age", *POSE}
    alive = [k for k, name in enumerate(obs.NAMES) if name not in pose]
    assert np.array_equal(plain[:, :, alive], holed[:, :, alive])


def test_in_an_outage_velocity_holds_its_age_grows_and_the_inertial_group_goes_on():
    readings = observations(vehicles(1), 300)[:, 0]
    missing = readings[:, AGE] > 0.5 * PERIOD
    assert missing.any()
    gone = np.flatnonzero(missing)
    ages = readings[gone, AGE] * obs.SCALE[AGE]
    began = np.array([np.flatnonzero(~missing[:k])[-1] for k in gone])
    assert np.allclose(ages, (gone - began) * PERIOD, atol=1e-5)
    for name in ("v_x", "v_y"):
        assert np.array_equal(readings[gone, obs.INDEX[name]], readings[began, obs.INDEX[name]])
    for name in ("acceleration_x", "yaw_rate", "sprocket_speed_left", "torque_right"):
        assert (np.diff(readings[:, obs.INDEX[name]]) != 0.0).all()
    assert (readings[:, [obs.INDEX["inertial_age"], obs.INDEX["drive_age"]]] == 0.0).all()


def test_outages_are_an_option_of_one_episode_and_a_preset():
    env = vehicles(2, sensors="rtk")
    assert (observations(env, 150)[:, :, AGE] == 0.0).all()
    assert (observations(env, 150, options={"sensors": OUTAGES})[:, :, AGE] > 0.0).any()
    assert (observations(env, 150)[:, :, AGE] == 0.0).all()
    made = gymnasium.make("tracked_env:tracked_env/Speed-v0", sensors="mocap-outages").unwrapped
    assert made.simulation.settings.sensors.pose_outage_length == (3.0, 10.0)
    fields = sensors.make_sensors("rtk-outages")
    assert fields._replace(pose_outage_gap=(0.0, 0.0), pose_outage_length=(0.0, 0.0)) == sensors.RTK
    assert sensors.make_sensors(json.loads(json.dumps(fields._asdict()))) == fields


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"pose_outage_gap": 3.0, "pose_outage_length": LENGTH}, r"3\.0; must be \[low, high\]"),
        ({"pose_outage_gap": [2, 1], "pose_outage_length": LENGTH}, "low must be <= high"),
        ({"pose_outage_gap": GAP, "pose_outage_length": [-1, 1]}, r"-1\.0 s; must be a number in"),
        ({"pose_outage_gap": GAP}, "Did you forget one"),
        ({"pose_outage_length": LENGTH}, "Did you forget one"),
    ],
)
def test_ranges_that_make_no_sense_are_refused_with_the_reason(fields, message):
    with pytest.raises(ValueError, match=message):
        sensors.make_sensors({"preset": "rtk", **fields})
