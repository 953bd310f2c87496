"""Observations of other groups than v0: compiled and Python forms, threads, lost states."""

import gymnasium
import numpy as np
import pytest

from tests.driving import assert_equal
from tracked_env import TERRAIN, TERRAIN_ID
from tracked_env import observation as obs
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import STATE_NAMES
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


@pytest.mark.parametrize(
    ("form", "says"),
    [
        ({"compute": leaning}, "'new' must have `compute` with `reads`"),
        ({"reads": READS}, "'new' must have `compute` with `reads`"),
        ({"compute": leaning, "reads": ("v_z",)}, "unknown field that 'new' reads 'v_z'"),
        ({"compute": leaning, "reads": ("pitch",)}, "unknown field that 'new' reads 'pitch'"),
    ],
)
def test_a_compiled_group_that_is_not_complete_is_not_registered(form, says, registries):
    with pytest.raises(ValueError, match=says):
        obs.register(group("new", **form))
    assert "new" not in obs.GROUPS


def test_threads_show_the_observations_of_one_thread_over_several_episodes():
    one, two = (vehicles(40, threads=threads, sensors="rtk") for threads in (1, 2))
    assert_equal(one.reset(seed=1)[0], two.reset(seed=1)[0])
    rng = np.random.default_rng(0)
    for _ in range(110):  # beyond a block of noise and the end of an episode
        actions = rng.uniform(-1.0, 1.0, (40, 2)).astype(np.float32)
        assert_equal(one.step(actions)[0], two.step(actions)[0])
    assert two.simulation._threads._pool and not one.simulation._threads._pool


def test_a_vehicle_whose_state_is_not_finite_keeps_its_last_readings():
    env = gymnasium.make(TERRAIN_ID, observation=EVERYTHING, uncertainty="hills").unwrapped
    env.reset(seed=0)
    before = env.step(ACTION)[0]
    env.simulation.batch.state()[0, STATE_NAMES.index("v_x")] = np.nan
    after, _, terminated, *_ = env.step(ACTION)
    heights = env.layout.columns([field.name for field in obs.GROUPS["height_scan"].fields])
    attitude = env.layout.columns([field.name for field in obs.GROUPS["attitude"].fields])
    assert terminated and np.isfinite(after).all()
    for values in (heights, attitude):
        assert np.array_equal(after[values], before[values])
