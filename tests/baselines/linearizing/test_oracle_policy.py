"""What the oracle is told of a plant that is not its model, and of the motion."""

import numpy as np
import pytest

from baselines.batch_policy import Array
from baselines.linearizing import linearizing_law as law
from baselines.linearizing import oracle_policy
from baselines.registry import POLICIES
from tests.baselines.episodes import context, interquartile_mean, run
from tracked_env.physics import lumped
from tracked_env.physics.parameters import PlantParameters, SoilParameters, plant_parameters
from tracked_env.plants.standalone import Rig
from tracked_env.sensors import make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

SAND = SoilParameters(2e3, 0.55, 0.03, 0.12)
CLAY = SoilParameters(30e3, 0.3, 0.02, 0.12)


def turning(soil, left, right):
    """(parameters, equivalents, state) of a vehicle that torques [N m] have brought to a turn."""
    p = plant_parameters()._replace(**soil._asdict())
    rig = Rig("distributed", p, step=1e-3)
    rig.states[:, 3] = 2.0
    rig.advance([[left, right]], 2.0)
    loads = np.stack([getattr(rig.state, name) for name in oracle_policy.LOADS])
    rows: Array = np.array(p, dtype=np.float64)[:, np.newaxis].copy()
    oracle_policy.use_equivalents(loads, rows)
    return p, PlantParameters(*rows[:, 0].tolist()), rig.state


@pytest.mark.parametrize(
    ("soil", "torques"),
    [(SAND, (100.0, 700.0)), (SAND, (900.0, -100.0)), (CLAY, (-2000.0, 2600.0))],
)
def test_the_law_asks_for_the_torques_that_drive_a_plant_with_shear_as_it_moves(soil, torques):
    p, q, state = turning(soil, *torques)
    motion = lumped.Motion(*(float(v[0]) for v in (state.v_x, state.v_y, state.yaw_rate)))
    felt, bend = float(state.acceleration_x[0]), float(state.yaw_acceleration[0])
    forward = felt + motion.yaw_rate * motion.v_y
    for parameters, wrong in ((q, False), (p, True)):
        k = lumped.coefficients(parameters, False)
        efforts = law.track_efforts(motion, forward, bend, parameters, k, False)
        asked = np.array(efforts) * p.sprocket_radius
        assert (np.abs(asked - torques).max() > 50.0) == wrong  # 5 N m, and more than 500


def test_the_side_slip_of_the_model_is_then_that_of_the_plant():
    _, q, state = turning(SAND, 100.0, 700.0)
    v_x, v_y, yaw_rate = (float(v[0]) for v in (state.v_x, state.v_y, state.yaw_rate))
    k = lumped.coefficients(q, False)
    model = law.steady_lateral_velocity(v_x, yaw_rate, k, 0.0, q.centre_of_mass_x)
    assert abs(law.steady_lateral_velocity(v_x, yaw_rate, k) - v_y) > 0.005
    assert model == pytest.approx(v_y, abs=1e-3)


def test_a_vehicle_that_does_not_turn_keeps_a_usual_resistance():
    _, q, state = turning(CLAY, 400.0, 400.0)
    assert state.yaw_rate[0] == 0.0
    growth = q.mass / plant_parameters().mass
    assert q.lateral_resistance * growth == oracle_policy.USUAL_RESISTANCE
    assert q.centre_of_mass_x == 0.0


def test_mirrored_turns_have_the_same_equivalents():
    mirrored = [turning(SAND, *torques)[1] for torques in ((100.0, 700.0), (700.0, 100.0))]
    assert np.allclose(*mirrored, rtol=1e-12)


@pytest.mark.parametrize("uncertainty", ["loose-soil", "alternating-soils"])
def test_the_oracle_is_the_ceiling_on_another_plant(uncertainty):
    oracle, adaptive = (POLICIES[name](context()) for name in ("oracle", "adaptive"))
    oracle.observe_plant(("lateral_resistance", "centre_of_mass_x"))
    ceiling, best = (
        interquartile_mean(run(policy, uncertainty, 16, plant="distributed").settled)
        for policy in (oracle, adaptive)
    )
    assert ceiling < 0.8 * best


def test_on_slopes_it_is_told_all_but_what_the_turns_identify():
    oracle = POLICIES["oracle"](context())
    oracle.observe_plant(("lateral_resistance",))
    names = (*PlantParameters._fields, *oracle_policy.LOADS)
    oracle.observe_truth({name: np.array([0.5, 0.6]) for name in names})
    identified = np.isnan(oracle._policy.fixed_parameters).all(axis=1)
    names = ["inertia", "lateral_resistance", "centre_of_mass_x"]
    assert [PlantParameters._fields[row] for row in np.flatnonzero(identified)] == names


@pytest.mark.parametrize("name", ["oracle-true-motion", "mpc-oracle-true-motion"])
def test_one_that_knows_motion_and_parameters_does_not_look_at_its_sensors(name):
    options = {"uncertainty": "mixed", "autoreset_mode": "Disabled", "expose_truth": True}
    actions = []
    for sensors in ("ideal", "strawa"):
        policy, state = POLICIES[name](context(make_sensors(sensors))), None
        env = TrackedVehicleVectorEnv(3, sensors=sensors, **options)
        observation, info = env.reset(seed=4)
        for _ in range(50):
            policy.observe_truth(info["truth"])
            action, state = policy.predict(observation, state)
            actions.append(action)
            observation, _, _, _, info = env.step(action)
    assert np.array_equal(actions[:50], actions[50:])
    assert np.abs(actions).max() > 0.1
