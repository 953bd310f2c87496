"""The adaptive policy as an interface: shapes, state, observations only, faults, errors."""

import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.evaluation import evaluate_policy

from baselines.estimators.measurement import DataSheet
from baselines.linearizing.adaptive_policy import AdaptivePolicy, AdaptiveState
from baselines.linearizing.linearizing_law import Gains
from baselines.linearizing.linearizing_policy import STATE
from tests.baselines.episodes import replay, run, seen_by
from tracked_env import observation as layout
from tracked_env.sb3 import make_vec_env
from tracked_env.sensors import IDEAL, RTK

SENSORS = slice(0, layout.INDEX["reference_speed"])


@pytest.fixture(scope="module")
def recorded():
    """Observations (200, 3, SIZE) of three vehicles driven by the policy."""
    return seen_by(AdaptivePolicy())


def copied(state):
    memories = tuple(memory.copy() for memory in state.memories)
    return AdaptiveState(state.controller.copy(), memories, state.delivered.copy())


def interrupt(*_arguments):
    raise KeyboardInterrupt


# --- shapes and state -----------------------------------------------------------------------


def test_one_observation_gives_one_action_and_a_batch_a_batch(recorded):
    policy = AdaptivePolicy()
    for observation, shape in ((recorded[0, 0], (2,)), (recorded[0], (3, 2))):
        action, state = policy.predict(observation)
        assert action.shape == shape
        assert action.dtype == np.float32
        assert (np.abs(action) <= 1.0).all()
        assert state.controller.shape == (recorded.shape[1] if len(shape) == 2 else 1, STATE)


def test_a_row_of_a_batch_is_the_single_policy_bit_for_bit(recorded):
    together, _ = replay(AdaptivePolicy(), recorded)
    for i in range(3):
        alone, _ = replay(AdaptivePolicy(), recorded[:, i])
        assert np.array_equal(together[:, i], alone)


def test_an_older_state_put_back_gives_the_same_actions_again(recorded):
    policy = AdaptivePolicy()
    _, state = replay(policy, recorded[:80])
    kept = copied(state)
    first, _ = replay(policy, recorded[80:], state)
    for again in (kept, state):
        assert np.array_equal(first, replay(policy, recorded[80:], again)[0])
    assert np.array_equal(first, replay(AdaptivePolicy(), recorded[80:], kept)[0])
    assert all(np.array_equal(a, b) for a, b in zip(kept.memories, state.memories, strict=True))


def test_episode_start_makes_only_its_rows_new(recorded):
    policy = AdaptivePolicy()
    whole, _ = replay(policy, recorded)
    _, state = replay(policy, recorded[:80])
    mixed, state = policy.predict(recorded[80], state, np.array([False, True, False]))
    assert np.array_equal(mixed[[0, 2]], whole[80, [0, 2]])
    rest, _ = replay(policy, recorded[81:], state)
    assert np.array_equal(rest[:, [0, 2]], whole[81:, [0, 2]])
    fresh, _ = replay(AdaptivePolicy(), recorded[80:, 1])
    assert np.array_equal(np.concatenate([mixed[None, 1], rest[:, 1]]), fresh)
    assert not np.array_equal(rest[:, 1], whole[81:, 1])
    again, _ = policy.predict(recorded[80], state, True)
    assert np.array_equal(again, AdaptivePolicy().predict(recorded[80])[0])


def test_a_refused_observation_leaves_the_state_as_good_as_it_was(recorded):
    policy = AdaptivePolicy()
    whole, _ = replay(policy, recorded)
    _, state = replay(policy, recorded[:80])
    broken = recorded[80].copy()
    broken[1, layout.INDEX["reference_jerk"]] = np.nan
    with pytest.raises(ValueError, match=r"observation\[1\]: reference_jerk = nan"):
        policy.predict(broken, state)
    assert np.array_equal(replay(policy, recorded[80:], state)[0], whole[80:])


def test_a_call_that_was_interrupted_can_be_repeated(recorded, monkeypatch):
    policy = AdaptivePolicy()
    whole, _ = replay(policy, recorded)
    _, state = replay(policy, recorded[:80])
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(policy.controller, "act", interrupt)
        policy.predict(recorded[80], state)
    assert np.array_equal(replay(policy, recorded[80:], state)[0], whole[80:])


# --- what it knows --------------------------------------------------------------------------


class Garbage(gymnasium.Wrapper):
    """Says nonsense in info["truth"]."""

    def step(self, action):
        *rest, info = super().step(action)
        return *rest, {**info, "truth": dict.fromkeys(info["truth"], np.nan)}


def test_the_truth_is_never_looked_at():
    taken = []
    for wrap in (lambda env: env, Garbage):
        env = wrap(gymnasium.make("tracked_env/Torque-v0", expose_truth=True))
        policy, state, actions = AdaptivePolicy(), None, []
        observation, _ = env.reset(seed=1)
        for _ in range(60):
            action, state = policy.predict(observation, state)
            observation, *_ = env.step(action)
            actions.append(action)
        taken.append(actions)
    assert np.array_equal(*taken)
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
    rows, known = policy.controller.parameters, policy.estimates()
    for name in ("mass", "longitudinal_resistance", "inertia", "lateral_resistance"):
        row = rows[type(policy.parameters)._fields.index(name)]
        assert np.array_equal(row, known[name][0])
        assert (row != getattr(policy.parameters, name)).all()


def test_traction_limits_are_used_where_known_and_without_soil_stay_nominal():
    names = ("cohesion", "friction_angle", "shear_deformation_modulus")
    for uses_soil in (True, False):
        policy = AdaptivePolicy(uses_soil=uses_soil)
        run(policy, "weak-soil", 16, 4.0)
        known, p = policy.identification.traction_known, policy.parameters
        assert 0.3 < known.mean() < 1.0
        for name in names:
            row = policy.controller.parameters[type(p)._fields.index(name)]
            assert np.array_equal(row != getattr(p, name), known & uses_soil)


def test_with_ideal_sensors_the_motion_is_taken_as_measured(recorded):
    assert AdaptivePolicy().filtered
    assert not AdaptivePolicy(data_sheet=DataSheet.of(IDEAL)).filtered
    raw, _ = replay(AdaptivePolicy(filtered=False), recorded)
    shown, _ = replay(AdaptivePolicy(filtered=True), recorded)
    assert not np.array_equal(raw, shown)
    jitter = [np.abs(np.diff(actions[50:], axis=0)).mean() for actions in (shown, raw)]
    assert jitter[0] < 0.7 * jitter[1]  # the filter is there to calm the tracks


# --- Stable-Baselines3 ----------------------------------------------------------------------


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


# --- faults of the sensors ------------------------------------------------------------------


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


# --- errors ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["reference_speed", "pose_age", "previous_action_left"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_reference_action_or_age_that_is_not_finite_is_refused(recorded, name, value):
    broken = recorded[0].copy()
    broken[2, layout.INDEX[name]] = value
    with pytest.raises(ValueError, match=rf"observation\[2\]: {name} = {value}; must be finite"):
        AdaptivePolicy().predict(broken)


def test_wrong_shapes_and_foreign_states_are_refused(recorded):
    policy = AdaptivePolicy()
    for wrong in (np.zeros(5), np.zeros((2, layout.SIZE + 1)), np.zeros((1, 1, layout.SIZE))):
        with pytest.raises(ValueError, match=rf"observation has shape .* must be .*{layout.SIZE}"):
            policy.predict(wrong.astype(np.float32))
    _, state = policy.predict(recorded[0])
    with pytest.raises(ValueError, match=r"state of 3 vehicles; must be of 2"):
        policy.predict(recorded[0, :2], state)
    with pytest.raises(ValueError, match=r"episode_start has shape \(2,\); must be \(3,\)"):
        policy.predict(recorded[1], state, np.zeros(2, dtype=bool))
    slow = AdaptivePolicy(control_period=0.05)
    with pytest.raises(ValueError, match="control period"):
        slow.predict(recorded[1], state)
    assert np.isfinite(policy.predict(recorded[1], state)[0]).all()


@pytest.mark.parametrize(
    ("options", "says"),
    [
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
