"""NUMBA_DISABLE_JIT=1: everything runs as plain Python, with the numbers of the kernels."""

import sys

import gymnasium
import numpy as np
import pytest

from baselines.estimators.stack import IdentificationStack
from baselines.planners import Limits, Start, plan
from tests.processes import python
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.physics.parameters import VEHICLES


def episode(env_id):
    """Observations of a whole episode with schedule, noise and delays."""
    env = gymnasium.make(env_id, duration=0.2)
    mass = {"parameter": "mass", "kind": "ramp", "target": 70.0, "start": 0.1}
    observation, _ = env.reset(seed=1, options={"schedule": [mass], "sensors": {"pose_delay": 0.1}})
    readings, over = [observation], False
    while not over:
        action = np.float32([0.3 + 0.2 * np.sin(len(readings)), 0.4])
        observation, _, terminated, over, _ = env.step(action)
        assert not terminated
        readings.append(observation)
    assert len(readings) == 11
    return np.array(readings)


def identified():
    """Features of the identification stack over an episode."""
    env, stack = gymnasium.make(TORQUE_ID, uncertainty="payload"), IdentificationStack()
    observation, _ = env.reset(seed=2)
    features = [stack.observe(observation[None], np.array([True]))]
    for k in range(100):
        observation = env.step(np.float32([0.3, 0.1 + 0.004 * k]))[0]
        features.append(stack.observe(observation[None], np.array([False])))
    return np.array(features)


def planned(method):
    """A plan of Focchi's vehicle, by time."""
    limits = Limits.of(VEHICLES["focchi"])
    trajectory = plan(Start(), (1.5, 0.6, 0.4), limits, method=method)
    assert trajectory.converged
    return np.array(trajectory[:13])


CASES = {
    **{name: (lambda name=name: episode(name)) for name in (TORQUE_ID, SPEED_ID, TERRAIN_ID)},
    "stack": identified,
    **{name: (lambda name=name: planned(name)) for name in ("dubins", "clothoid", "optimal")},
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The numbers of all cases from a process without a compiler."""
    file = tmp_path_factory.mktemp("plain") / "numbers.npz"
    python(__file__, file, NUMBA_DISABLE_JIT="1")
    return np.load(file)


@pytest.mark.parametrize("case", CASES)
def test_plain_python_has_the_numbers_of_the_kernels(case, plain):
    compiled = CASES[case]()
    assert compiled.size > 100
    np.testing.assert_allclose(plain[case], compiled, rtol=0.0, atol=1e-12)


if __name__ == "__main__":
    np.savez(sys.argv[1], **{name: case() for name, case in CASES.items()})
