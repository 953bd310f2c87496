"""The adaptive policy as an interface: observations only, estimates, faults, errors."""

import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.evaluation import evaluate_policy

from baselines.estimators.measurement import DataSheet
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from tests.baselines.episodes import replay, run, seen_by
from tracked_env import observation as layout
from tracked_env.sb3 import make_vec_env
from tracked_env.sensors import IDEAL, RTK

SENSORS = slice(0, layout.INDEX["reference_speed"])


@pytest.fixture(scope="module")
def recorded():
    """Observations (200, 3, SIZE) of three vehicles driven by the policy."""
    return seen_by(AdaptivePolicy())


def interrupt(*_arguments):
    raise KeyboardInterrupt


def test_a_call_that_was_interrupted_can_be_repeated(recorded, monkeypatch):
    policy = AdaptivePolicy()
    whole, _ = replay(policy, recorded)
    _, state = replay(policy, recorded[:80])
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(policy.controller, "act", interrupt)
        policy.predict(recorded[80], state)
    assert np.array_equal(replay(policy, recorded[80:], state)[0], whole[80:])


class Garbage(gymnasium.Wrapper):
    """Says nonsense in info["truth"]."""

    def step(self, action):
        *rest, info = super().step(action)
        return *rest, {**info, "truth": dict.fromkeys(info["truth"], np.nan)}


def test_the_truth_is_never_looked_at():
    outcomes = []
    for wrap in (lambda env: env, Garbage):
        env = wrap(gymnasium.make("tracked_env/Torque-v0", expose_truth=True))
        policy, state, actions = AdaptivePolicy(), None, []
        observation, _ = env.reset(seed=1)
        for _ in range(60):
            action, state = policy.predict(observation, state)
            observation, *_ = env.step(action)
            actions.append(action)
        outcomes.append(actions)
    assert np.array_equal(*outcomes)
    assert not hasattr(policy, "needs_truth")
    assert not hasattr(policy, "observe_truth")


def test_it_tells_what_it_knows_and_how_well(recorded):
    policy = AdaptivePolicy()
    assert dict(policy.estimates()) == dict(policy.excited()) == dict(policy.nis()) == {}
    replay(policy, recorded)
    estimates, excited = policy.estimates(), policy.excited()
    for value, deviation in estimates.values():
        assert value.shape == deviation.shape == (3,)
        assert np.isfinite(value).all()
        assert (deviation > 0.0).all()
    assert set(excited) <= set(estimates)
    assert excited["mass"].dtype == bool
    assert excited["mass"].any()
    assert set(policy.nis()) == {"longitudinal", "turning", "slip", "soil", "actuators"}


def test_the_estimates_are_what_the_controller_works_with(recorded):
    policy = AdaptivePolicy()
    replay(policy, recorded)
    rows, estimates = policy.controller.parameters, policy.estimates()
    for name in ("mass", "longitudinal_resistance", "inertia", "lateral_resistance"):
        row = rows[type(policy.parameters)._fields.index(name)]
        assert np.array_equal(row, estimates[name][0])
        assert (row != getattr(policy.parameters, name)).all()


def test_traction_limits_are_used_where_known_and_without_soil_stay_nominal():
    names = ("cohesion", "friction_angle", "shear_deformation_modulus")
    for uses_soil in (True, False):
        policy = AdaptivePolicy(uses_soil=uses_soil)
        run(policy, "weak-soil", 16, 4.0)
        determined, p = policy.identification.traction_determined, policy.parameters
        assert 0.3 < determined.mean() < 1.0
        for name in names:
            row = policy.controller.parameters[type(p)._fields.index(name)]
            assert np.array_equal(row != getattr(p, name), determined & uses_soil)


def test_with_ideal_sensors_the_motion_is_taken_as_measured(recorded):
    assert AdaptivePolicy().filtered
    assert not AdaptivePolicy(data_sheet=DataSheet.of(IDEAL)).filtered
    raw, _ = replay(AdaptivePolicy(filtered=False), recorded)
    calm, _ = replay(AdaptivePolicy(filtered=True), recorded)
    assert not np.array_equal(raw, calm)
    jitter = [np.abs(np.diff(actions[50:], axis=0)).mean() for actions in (calm, raw)]
    assert jitter[0] < 0.7 * jitter[1]  # the filter is there to calm the tracks


def test_stable_baselines3_evaluates_it_on_one_env_and_on_many():
    kwargs = {"duration": 2.0}
    single = gymnasium.make("tracked_env/Torque-v0", **kwargs)
    many = make_vec_env(n_envs=4, seed=0, env_kwargs=kwargs)
    for env, episodes in ((single, 2), (many, 8)):
        rewards, lengths = evaluate_policy(
            AdaptivePolicy(), env, episodes, return_episode_rewards=True, warn=False
        )
        assert lengths == [100] * episodes
        assert min(rewards) > 30.0


@pytest.mark.parametrize("filtered", [True, False])
def test_missing_sensor_values_do_not_stop_it(filtered):
    rng = np.random.default_rng(3)

    def spoil(step, observation):
        lost = rng.random((len(observation), SENSORS.stop)) < 0.1
        observation[:, SENSORS][lost] = np.nan
        if step == 0:
            observation[0, SENSORS] = np.nan

    policy = AdaptivePolicy(filtered=filtered)
    episodes = run(policy, "soil-and-mass", 8, spoil=spoil)
    assert np.isfinite(episodes.action).all()
    assert not episodes.over.any()
    assert episodes.settled.max() < 0.1
    assert (policy.identification.longitudinal.skipped > 50).all()


def test_a_sensor_group_that_dies_stops_nothing():
    for group in (("position", "heading"), ("acc", "yaw_"), ("sprocket", "torque")):
        columns = [i for n, i in layout.INDEX.items() if n.startswith(group) and i < SENSORS.stop]

        def spoil(step, observation, columns=columns):
            if step > 200:
                observation[:, columns] = np.nan

        episodes = run(AdaptivePolicy(), "nominal", 4, 6.0, spoil=spoil)
        assert np.isfinite(episodes.action).all()


def test_a_wild_reading_now_and_then_is_no_news():
    def spoil(step, observation):
        if step % 50 == 49:
            observation[:, SENSORS] = layout.BOUND[SENSORS]

    episodes = run(AdaptivePolicy(), "soil-and-mass", 8, spoil=spoil)
    assert episodes.settled.max() < 0.15


@pytest.mark.parametrize("name", ["reference_speed", "pose_age", "previous_action_left"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_reference_action_or_age_that_is_not_finite_is_refused(recorded, name, value):
    broken = recorded[0].copy()
    broken[2, layout.INDEX[name]] = value
    with pytest.raises(ValueError, match=rf"observation\[2\]: {name} = {value}; must be finite"):
        AdaptivePolicy().predict(broken)


def test_a_state_of_another_control_period_is_refused(recorded):
    _, state = AdaptivePolicy().predict(recorded[0])
    with pytest.raises(ValueError, match="control period"):
        AdaptivePolicy(control_period=0.05).predict(recorded[1], state)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"slip": "ekf"}, "slip = 'ekf'; must be 'batched' or 'filterpy'"),
        ({"lateral": "skid"}, "lateral = 'skid'; must be one of"),
        (
            {"control_period": 50.0},
            r"control_period = 50.0 s; must be a number in \[0.0001, 1\] s.*rate",
        ),
        ({"gains": Gains(1.0, -1.0, 1.0)}, "gains must be positive"),
        ({"data_sheet": DataSheet.of(RTK)._replace(gyro_noise=-1.0)}, "gyro_noise = -1"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, says):
    with pytest.raises(ValueError, match=says):
        AdaptivePolicy(**options)
