"""Drives that give another torque than they are commanded: the parameters actuator_gain_*."""

import numpy as np
import pytest

from tracked_env.benchmark import evaluation_sets
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import VEHICLES
from tracked_env.plants.standalone import Rig
from tracked_env.uncertainty import make_uncertainty

PLANTS = ("lumped", "distributed", "terrain")
NOMINAL = VEHICLES["strawa"]
COMMAND = np.array([[1200.0, 2400.0]])  # [N m]


def states_after(plant, duration, command=COMMAND, **changed):
    """States after commands held for `duration` [s]."""
    rig = Rig(plant, NOMINAL._replace(**changed), options={})
    rig.advance(command, duration)
    return rig.states[0].copy()


@pytest.mark.parametrize("plant", PLANTS)
def test_a_drive_of_gain_one_half_moves_the_vehicle_as_half_the_command_does(plant):
    halved = states_after(plant, 1.0, actuator_gain_left=0.5, actuator_gain_right=0.5)
    np.testing.assert_array_equal(halved, states_after(plant, 1.0, 0.5 * COMMAND))
    left = states_after(plant, 1.0, actuator_gain_left=0.5)
    np.testing.assert_array_equal(left, states_after(plant, 1.0, COMMAND * [0.5, 1.0]))
    right = states_after(plant, 1.0, actuator_gain_right=0.5)
    np.testing.assert_array_equal(right, states_after(plant, 1.0, COMMAND * [1.0, 0.5]))
    assert not np.array_equal(left, right)


@pytest.mark.parametrize("plant", PLANTS)
def test_the_torque_follows_the_gain_times_the_command_by_the_lag(plant):
    lag, time = 0.2, 0.1
    state = states_after(
        plant, time, actuator_gain_left=0.4, actuator_gain_right=1.1, drive_time_constant=lag
    )
    followed = COMMAND[0] * [0.4, 1.1] * (1.0 - np.exp(-time / lag))
    np.testing.assert_allclose(state[[s.TORQUE_LEFT, s.TORQUE_RIGHT]], followed, rtol=1e-9)


def test_a_drive_may_lose_torque_inside_an_episode():
    env = TrackedVehicleEnv(
        uncertainty="nominal",
        sensors="ideal",
        expose_truth=True,
        reference="straight",
        error_limit=1e3,
    )
    fault = {"parameter": "actuator_gain_left", "kind": "ramp", "target": 0.4, "start": 1.0}
    env.reset(seed=0, options={"schedule": [fault]})
    torques, gains = [], []
    for _ in range(100):
        _, _, _, _, info = env.step(np.float32([0.3, 0.3]))
        torques.append(info["truth"]["torque_left"])
        gains.append(info["truth"]["actuator_gain_left"])
    commanded = 0.3 * NOMINAL.torque_limit
    assert (gains[10], gains[-1]) == (1.0, 0.4)
    assert torques[48] == pytest.approx(commanded, rel=1e-6)
    assert torques[-1] == pytest.approx(0.4 * commanded, rel=1e-6)


def test_the_sets_of_weak_and_failing_drives_draw_gains_and_belong_to_no_version():
    weak, fault = make_uncertainty("weak-actuator"), make_uncertainty("actuator-fault")
    rng = np.random.default_rng(70_000)
    draws = [weak(rng, NOMINAL, None, 30.0).parameters for _ in range(200)]
    gains = np.array([(p.actuator_gain_left, p.actuator_gain_right) for p in draws])
    low = gains < 1.0
    assert low.any(axis=1).all() and ((gains >= 0.4) & (gains <= 0.7))[low].all()
    assert all(
        0.2 < share < 0.47 for share in (low.all(1).mean(), *(low.mean(0) - low.all(1).mean()))
    )
    events = [fault(rng, NOMINAL, None, 30.0).events for _ in range(50)]
    sides = [event["parameter"] for (event,) in events]
    assert set(sides) == {"actuator_gain_left", "actuator_gain_right"}
    assert all(9.0 <= e["start"] <= 18.0 and 0.4 <= e["target"] <= 0.7 for (e,) in events)
    sound = make_uncertainty("soil-and-mass")
    for law in (weak, fault):  # the same vehicles on the same soils
        one, other = (f(np.random.default_rng(7), NOMINAL, None, 30.0) for f in (law, sound))
        assert one.parameters._replace(actuator_gain_left=1.0, actuator_gain_right=1.0) == (
            other.parameters
        )
    for name in ("weak-actuator", "actuator-fault"):
        assert name in evaluation_sets.SETS and name not in evaluation_sets.names_of(
            evaluation_sets.PLANAR
        )
