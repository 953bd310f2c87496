"""Controllers take one vehicle or a batch, and refuse wrong shapes and arguments."""

import copy
import pickle
from functools import cache, partial

import gymnasium
import numpy as np
import pytest

from baselines.batch_policy import BatchPolicy
from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import DataSheet
from baselines.estimators.observation_reader import ObservationReader
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.soil_estimator import SoilEstimator
from baselines.estimators.turning import TurningEstimator
from baselines.learned.trained_agent import open_agent
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from baselines.lyapunov.slippage_aware import SlippageAwarePolicy
from baselines.registry import POLICIES, shipped_agents
from baselines.slip.friction_estimator import RecursiveSlipEstimator
from baselines.slip.slip_models import NoSlip
from tests.baselines.episodes import replay
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyContext
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import PRESETS

TORQUE = PolicyContext(0.02, "sliding")
SPEED = PolicyContext(0.02, "sliding", PRESETS["mocap"], "speed", VEHICLES["focchi"])
CASES = [(name, TORQUE) for name in ("nominal", "adaptive", "l1", "mrac", "mpc-adaptive")]
CASES += [(name, SPEED) for name in ("uc", "slc-adaptive", "mpc-adaptive")]
every_policy = pytest.mark.parametrize(
    ("name", "context"), CASES, ids=[f"{name}-{context.drive}" for name, context in CASES]
)
HALF = 40  # [steps] of the recorded observations


@cache
def recorded(name, context):
    """Observations (2 HALF, 3, SIZE) of three vehicles driven by a policy, never written to."""
    env_id = TORQUE_ID if context is TORQUE else SPEED_ID
    env = gymnasium.make_vec(env_id, num_envs=3)
    policy, state, observations = POLICIES[name](context), None, [env.reset(seed=4)[0]]
    for _ in range(2 * HALF - 1):
        action, state = policy.predict(observations[-1], state)
        observations.append(env.step(action)[0])
    result = np.array(observations)
    result.flags.writeable = False
    return result


@every_policy
def test_a_row_of_a_batch_is_the_single_vehicle_bit_for_bit(name, context):
    observations = recorded(name, context)
    assert isinstance(POLICIES[name](context), BatchPolicy)
    batch, _ = replay(POLICIES[name](context), observations)
    assert batch.dtype == np.float32 and 0.0 < np.abs(batch).max() <= 1.0
    for i in range(3):
        single, _ = replay(POLICIES[name](context), observations[:, i])
        assert single.shape == (2 * HALF, 2)
        assert np.array_equal(single, batch[:, i])
    batch_of_one, _ = replay(POLICIES[name](context), observations[:, :1])
    assert np.array_equal(batch_of_one, batch[:, :1])


@every_policy
def test_an_older_state_put_back_gives_the_same_actions_again(name, context):
    observations, policy = recorded(name, context), POLICIES[name](context)
    _, state = replay(policy, observations[:HALF])
    saved = copy.deepcopy(state)
    first, _ = replay(policy, observations[HALF:], state)
    for again in (saved, state):
        assert np.array_equal(first, replay(policy, observations[HALF:], again)[0])
    other = POLICIES[name](context)
    assert np.array_equal(first, replay(other, observations[HALF:], saved)[0])


LEARNED = [(n, c) for c in (TORQUE, SPEED) for n in shipped_agents(c.drive)]


@pytest.mark.parametrize("way", [copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))])
@pytest.mark.parametrize(("name", "context"), [*CASES, *LEARNED])
def test_a_copy_goes_on_bit_for_bit(name, context, way):
    observations = recorded("adaptive" if context is TORQUE else "slc-adaptive", context)
    learned = name not in POLICIES
    make = open_agent(shipped_agents(context.drive)[name][0]).make if learned else POLICIES[name]
    policy = make(context)
    _, state = replay(policy, observations[:HALF])
    copied, its_state = way((policy, state))
    expected, _ = replay(policy, observations[HALF:], state)
    assert np.array_equal(replay(copied, observations[HALF:], its_state)[0], expected)
    assert len(np.unique(expected[:, 0, 0])) > HALF // 2


@every_policy
def test_episode_start_makes_only_its_rows_new(name, context):
    observations, policy = recorded(name, context), POLICIES[name](context)
    whole, _ = replay(policy, observations)
    _, state = replay(policy, observations[:HALF])
    some = np.array([False, True, False])
    mixed, later = policy.predict(observations[HALF], state, some)
    rest, _ = replay(policy, observations[HALF + 1 :], later)
    actions = np.concatenate([mixed[None], rest])
    assert np.array_equal(actions[:, [0, 2]], whole[HALF:, [0, 2]])
    fresh, _ = replay(POLICIES[name](context), observations[HALF:])
    assert np.array_equal(actions[:, 1], fresh[:, 1])
    assert not np.array_equal(actions[:, 1], whole[HALF:, 1])
    # Without a state every row begins, whatever episode_start says.
    assert np.array_equal(policy.predict(observations[HALF], None, some)[0], fresh[0])
    assert np.array_equal(policy.predict(observations[HALF], state, True)[0], fresh[0])


@every_policy
def test_a_refused_call_changes_nothing(name, context):
    observations, policy = recorded(name, context), POLICIES[name](context)
    whole, _ = replay(policy, observations)
    _, state = replay(policy, observations[:HALF])
    now, width = observations[HALF], layout.SIZE
    estimates = getattr(policy, "estimates", dict)
    before = copy.deepcopy(estimates())
    for wrong in (np.zeros(width + 1), np.zeros((3, 5)), np.zeros((1, 3, width)), np.zeros(())):
        with pytest.raises(ValueError, match=rf"observation has shape .* must be \({width},\)"):
            policy.predict(wrong, state)
    with pytest.raises(ValueError, match=r"episode_start has shape \(2,\); must be \(3,\)"):
        policy.predict(now, state, np.array([True, False]))
    for key, values in estimates().items():
        assert np.array_equal(values, before[key], equal_nan=True)
    with pytest.raises(ValueError, match=r"state of 3 vehicles"):
        policy.predict(now[:2], state)
    if context is TORQUE:  # by speeds, a vehicle without a reference stands
        broken = now.copy()
        broken[1, layout.INDEX["reference_jerk"]] = np.nan
        with pytest.raises(ValueError, match=r"observation\[1\]: reference_jerk = nan"):
            policy.predict(broken, state)
    assert np.array_equal(replay(policy, observations[HALF:], state)[0], whole[HALF:])


@every_policy
def test_what_is_passed_in_is_not_written_to(name, context):
    observations, policy = recorded(name, context)[:3].copy(), POLICIES[name](context)
    observations[:, 0, layout.INDEX["v_y"]] = 0.01
    before = observations.copy()
    replay(policy, observations)
    assert np.array_equal(observations, before)


@pytest.mark.parametrize(("name", "context"), CASES[1:], ids=[name for name, _ in CASES[1:]])
def test_sensors_that_are_missing_make_no_action_missing(name, context):
    observations, rng = recorded(name, context).copy(), np.random.default_rng(0)
    sensors = observations[..., : layout.INDEX["reference_speed"]]
    sensors[rng.random(sensors.shape) < 0.2] = np.nan
    assert np.isfinite(replay(POLICIES[name](context), observations)[0]).all()


# Period, count and noise are checked alike, with one message each


P = VEHICLES["focchi"]
SHEET = DataSheet()
CONTROLLERS = {
    "feedback linearization": partial(FeedbackLinearizingController, P),
    "slippage aware": partial(SlippageAwarePolicy, P, slip_model=NoSlip()),
}
ESTIMATORS = {
    "reader": ObservationReader,
    "longitudinal": partial(LongitudinalEstimator, P, data_sheet=SHEET),
    "turning": partial(TurningEstimator, P, data_sheet=SHEET),
    "slip": partial(SlipObserver, P, data_sheet=SHEET),
    "soil": partial(SoilEstimator, P, data_sheet=SHEET),
    "friction": partial(RecursiveSlipEstimator, P, data_sheet=SHEET),
}
EVERY = {**CONTROLLERS, **ESTIMATORS}


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("period", [0.0, 50.0, float("nan"), "20 ms", True])
def test_a_control_period_outside_its_range_is_refused_in_the_same_words(name, period):
    says = (
        rf"control_period = {period!r}.*; must be a number in \[0.0001, 1\] s. Did you pass a rate"
    )
    with pytest.raises(ValueError, match=says):
        EVERY[name](control_period=period)


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("count", [0, -1, 1.5, "2", True])
def test_a_count_that_is_no_whole_number_from_one_on_is_refused(name, count):
    with pytest.raises(ValueError, match=rf"count = {count!r}.*; must be a"):
        ESTIMATORS[name](control_period=0.02, count=count)


@pytest.mark.parametrize("name", ["slip", "soil", "friction"])
@pytest.mark.parametrize("sigma", [-1.0, float("inf"), float("nan")])
def test_a_standard_deviation_that_is_negative_or_not_finite_is_refused(name, sigma):
    sheet = SHEET._replace(gyro_noise=sigma)
    with pytest.raises(ValueError, match=rf"gyro_noise = {sigma} .*; must be a number in \[0"):
        ESTIMATORS[name](control_period=0.02, data_sheet=sheet)
