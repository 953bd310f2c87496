"""Groups beside v0: compiled and Python forms, lost states, the height scan."""

import gymnasium
import numpy as np
import pytest

from tests.driving import assert_equal
from tracked_env import SPEED_ID, TERRAIN, TERRAIN_ID
from tracked_env import observation as obs
from tracked_env.physics.jit import loop
from tracked_env.vector_env import TrackedVehicleVectorEnv

EVERYTHING = [*TERRAIN["observation"], "height_scan"]
FIELD = obs.Field("leaning", "rad", 0.5, 4.0, "roll times speed, for a test", mirrored=True)
READS = ("roll", "v_x")
ACTION = np.float32([0.3, 0.4])


@loop
def leaning(inputs, outputs):
    """Product of the two columns."""
    for k in range(inputs.shape[0]):
        outputs[k, 0] = inputs[k, 0] * inputs[k, 1]


def group(name, **form):
    return obs.Group(name, (FIELD._replace(name=name),), channels=("roll",), **form)


def vehicles(count=3, **given):
    given = {"uncertainty": "hills", "observation": EVERYTHING, "duration": 1.0, **given}
    return TrackedVehicleVectorEnv(count, **{**TERRAIN, **given})


def test_the_compiled_form_of_a_group_shows_what_its_form_in_python_shows(registries):
    obs.register(group("compiled", compute=leaning, reads=READS))
    obs.register(group("in_python", compute=leaning.py_func, reads=READS))
    env = vehicles(observation=["compiled", "attitude", "in_python", "motion"])
    readings = env.reset(seed=0)[0]
    for _ in range(30):
        readings = env.step(np.tile(ACTION, (3, 1)))[0]
        fields = env.layout.unpack(readings)
        assert np.array_equal(fields["compiled"], fields["in_python"])
    np.testing.assert_allclose(fields["compiled"], fields["roll"] * fields["v_x"], rtol=1e-5)
    assert np.abs(fields["compiled"]).min() > 1e-4


def test_a_vehicle_whose_state_is_not_finite_keeps_its_last_readings_and_shows_a_finite_goal():
    goal = {"kind": "plan", "goal": [2.0, 2.5, -0.4], "planner": "dubins"}
    settings = {"uncertainty": "hills", "observation": [*EVERYTHING, "goal"], "reference": goal}
    for value in (np.nan, 1e200):
        env = gymnasium.make(TERRAIN_ID, **settings).unwrapped
        env.reset(seed=0)
        before = env.step(ACTION)[0]
        env.simulation.batch.column("v_x")[0] = value
        after, _, terminated, *_ = env.step(ACTION)
        assert terminated and env.observation_space.contains(after)
        for name in ("height_scan", "attitude"):
            values = env.layout.columns([field.name for field in obs.GROUPS[name].fields])
            assert np.array_equal(after[values], before[values])


GROUP = obs.GROUPS["height_scan"]
SHOWN = [*TERRAIN["observation"], "height_scan"]
HILLS = {"plant_options": {"terrain": "hills"}, "uncertainty": "hills", "observation": SHOWN}
ACTION = np.float32([0.3, 0.4])


def make(**arguments):
    return gymnasium.make(TERRAIN_ID, **{**HILLS, "sensors": "ideal", **arguments}).unwrapped


def scanned(env, seen):
    fields = env.layout.unpack(seen)
    return np.stack([fields[field.name] for field in GROUP.fields], axis=-1)


def test_heights_are_those_of_the_ground_at_the_points_in_the_yaw_frame():
    env = make(expose_truth=True)
    env.reset(seed=3)
    for _ in range(30):
        readings, *_, info = env.step(ACTION)
    truth = info["truth"]
    cosine, sine = np.cos(truth["yaw"]), np.sin(truth["yaw"])
    ahead, left = 0.7 * np.array(GROUP.scan).T
    x, y = truth["x"] + cosine * ahead - sine * left, truth["y"] + sine * ahead + cosine * left
    k = 2 * np.pi / 8.0
    a, b, *waves = env.simulation.episodes[0].relief
    expected = 0.25 * np.sin(k * x) * np.sin(k * y) + a * x + b * y
    for amplitude, k_x, k_y, phase in np.reshape(waves, (-1, 4)):
        expected = expected + amplitude * np.sin(k_x * x + k_y * y + phase)
    np.testing.assert_allclose(scanned(env, readings), expected - truth["z"], atol=1e-6)
    assert np.ptp(expected) > 0.05


def test_level_ground_reads_the_height_of_the_vehicle_on_every_plant():
    arguments = {"uncertainty": "nominal", "sensors": "ideal", "observation": SHOWN}
    for env_id in (TERRAIN_ID, SPEED_ID):
        env = gymnasium.make(env_id, **arguments).unwrapped
        readings, _ = env.reset(seed=0)
        np.testing.assert_allclose(scanned(env, readings), 0.0, atol=1e-9)


def test_noise_has_its_sigma_and_lost_points_keep_their_last_value():
    arguments = {**TERRAIN, "observation": SHOWN, "uncertainty": "nominal"}
    env = TrackedVehicleVectorEnv(32, **{**arguments, "error_limit": 1e3, "sensors": "rtk"})
    readings, _ = env.reset(seed=0)
    output = [scanned(env, readings)]
    output += [scanned(env, env.step(np.zeros((32, 2)))[0]) for _ in range(100)]
    values = np.array(output)
    assert values[20:].std() == pytest.approx(0.02, rel=0.03)
    lost = np.all(values[1:] == values[:-1], axis=-1), values[1:] == values[:-1]
    assert lost[1].mean() == pytest.approx(0.02, rel=0.05) and not lost[0].any()


def test_the_scan_changes_nothing_else():
    with_scan, without = make(sensors="rtk"), make(sensors="rtk", observation=SHOWN[:-1])
    (one, _), (other, _) = with_scan.reset(seed=1), without.reset(seed=1)
    for _ in range(70):
        assert_equal(one[: len(other)], other)
        one, other = with_scan.step(ACTION)[0], without.step(ACTION)[0]


def test_mirroring_exchanges_the_points_at_the_left_and_at_the_right():
    layout = obs.make_layout(["height_scan"])
    readings = np.arange(layout.size, dtype=np.float32)
    mirrored = layout.mirror(readings)
    for (ahead, left), value in zip(GROUP.scan, mirrored, strict=True):
        assert value == GROUP.scan.index((ahead, -left))
