"""What a teacher sees besides the observation: hidden parameters over their nominal values."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from agents.environments import AgentVectorEnv, TruthfulVectorEnv, make_part, make_taught
from agents.run import MIXTURE, Augmentation, resolve
from baselines.learned.student import PRIVILEGED, policy_of, privileged
from tests.agents.agent_cases import STEPS, small, vehicles
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env import observation as obs
from tracked_env.physics.parameters import VEHICLES
from tracked_env.wrappers import FEATURE_BOUND


def at_nominal(vehicle):
    """The truth of one vehicle that is the nominal one."""
    values = {name: np.array([value]) for name, value in VEHICLES[vehicle]._asdict().items()}
    return {**values, "slip_left": np.zeros(1), "slip_right": np.zeros(1)}


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_privileged_inputs_are_0_at_nominal_and_of_order_one_where_parameters_spread(vehicle):
    truth, nominal = at_nominal(vehicle), VEHICLES[vehicle]
    np.testing.assert_array_equal(privileged(truth, nominal), np.zeros((1, len(PRIVILEGED))))
    heavy = {**truth, "mass": truth["mass"] * np.exp(0.3), "slip_left": np.array([-7.0])}
    shown = dict(zip(PRIVILEGED, privileged(heavy, nominal)[0], strict=True))
    assert shown["mass"] == pytest.approx(1.0) and shown["slip_left"] == pytest.approx(-2.0)
    # Cohesion bears most of the traction on clay; without it the limit grows as the mass.
    cohesive = nominal.cohesion > 0.0
    assert shown["traction_limit"] == pytest.approx(0.04 if cohesive else 0.3, abs=0.02)


def test_a_soil_without_traction_is_shown_as_the_bound():
    slippery = {**at_nominal("focchi"), "friction_angle": np.zeros(1)}
    shown = dict(zip(PRIVILEGED, privileged(slippery, VEHICLES["focchi"])[0], strict=True))
    assert shown["traction_limit"] == -FEATURE_BOUND


@pytest.mark.parametrize(
    ("env", "uncertainty"),
    [(env, name) for env, names in MIXTURE.items() for name in names]
    + [(TORQUE_ID, "ood"), (SPEED_ID, "floor-ood")],
)
def test_no_privileged_input_is_clipped_in_the_sets_of_an_environment(env, uncertainty):
    """Nothing is far from its nominal: 10 is the bound, and what a student learns stays below."""
    batch = gymnasium.make_vec(
        env, 64, "vector_entry_point", uncertainty=uncertainty, expose_truth=True,
        autoreset_mode="SameStep", duration=4.0,
    )  # fmt: skip
    nominal = batch.unwrapped.simulation.solver.nominal
    random, largest = np.random.default_rng(0), 0.0
    _, info = batch.reset(seed=0)
    for _ in range(250):
        largest = max(largest, np.abs(privileged(info["truth"], nominal)).max())
        info = batch.step(random.uniform(-1.0, 1.0, (64, 2)).astype(np.float32))[-1]
    # under soft patches the shear modulus is up to 30 times the nominal one: ln(30) / 0.5
    assert 0.02 < largest < (6.81 if uncertainty == "soft-patches" else 5.0)


@pytest.mark.parametrize("env", [TORQUE_ID, SPEED_ID])
def test_training_driving_and_teaching_scale_by_the_nominal_vehicle_of_the_environment(
    env, tmp_path
):
    config = small(tmp_path, env=env, augmentation="teacher", uncertainty=None)
    run = resolve(config)
    (part,) = run.parts
    trained = make_part(run, part).env.env.env
    _, (taught,) = make_taught(replace(run, augmentation=Augmentation("student", {"lags": [1, 2]})))
    driving = policy_of(None, "teacher", {}, part.context)
    nominal = trained.unwrapped.simulation.solver.nominal
    assert isinstance(trained, TruthfulVectorEnv) and isinstance(taught, TruthfulVectorEnv)
    assert trained.nominal == taught.nominal == driving.nominal == nominal


def test_privileged_inputs_belong_to_the_observation_they_stand_beside():
    """At an episode's end too: `final_obs` has the old vehicle's, the new row the new one's."""
    constant = vehicles(uncertainty="soil-and-mass", expose_truth=True)  # within an episode
    truthful = TruthfulVectorEnv(constant)
    env = AgentVectorEnv(truthful, truthful.truth)
    parameters = [not name.startswith("slip") for name in PRIVILEGED]
    core = env.unwrapped
    observation, _ = env.reset(seed=0)
    ends = 0
    for _ in range(STEPS):
        truth = privileged(core.simulation.truth(), VEHICLES["strawa"])
        np.testing.assert_array_equal(observation[:, obs.SIZE :], truth)
        observation, _, terminated, truncated, info = env.step(np.full((3, 2), 0.2, np.float32))
        for i in np.flatnonzero(terminated | truncated):
            ends += 1
            last = info["final_obs"][i][obs.SIZE :]
            np.testing.assert_array_equal(last[parameters], truth[i, parameters])
            assert (observation[i, obs.SIZE :][parameters] != truth[i, parameters]).any()
    assert ends >= 3
