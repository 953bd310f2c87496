"""Observations of other groups than v0: compiled and Python forms, lost states."""

import gymnasium
import numpy as np

from tracked_env import TERRAIN, TERRAIN_ID
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
