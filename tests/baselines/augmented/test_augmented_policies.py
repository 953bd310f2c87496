"""The augmented policies: freezing, refusals, projection, and what they do on the plant."""

import numpy as np
import pytest

from baselines.augmented.augmented_policy import (
    CHANNEL_COLUMN,
    DRIVE_COLUMNS,
    L1Policy,
    L1Settings,
)
from baselines.augmented.mrac import HIGH, LOW, MracPolicy, MracSettings
from baselines.estimators.measurement import DataSheet
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from baselines.registry import l1, mrac
from tests.baselines.episodes import context, replay, run, seen_by
from tracked_env import observation as layout
from tracked_env.physics.parameters import PARAMETER_INDEX, plant_parameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.sensors import IDEAL
from tracked_env.vector_env import TrackedVehicleVectorEnv

POLICIES = {"l1": L1Policy, "mrac": MracPolicy}
NOMINAL = plant_parameters()
SENSORS = slice(0, layout.INDEX["reference_speed"])
both = pytest.mark.parametrize("name", list(POLICIES))


@pytest.fixture(scope="module")
def recorded():
    """Observations (200, 3, SIZE) of three vehicles driven by a policy."""
    return seen_by(L1Policy())


@both
def test_a_frozen_row_keeps_what_it_learned_until_it_starts_anew(recorded, name):
    """Channels, parameters, and the correction of each drive."""
    policy = POLICIES[name]()
    whole, _ = replay(policy, recorded)
    _, state = replay(policy, recorded[:80])
    policy.freeze(np.array([False, True, False]))
    learned, law = state.adaptation[1].copy(), policy.controller
    lacking, parameters = law.lacking[1].copy(), law.parameters[:, 1].copy()
    assert np.abs(learned[[4, DRIVE_COLUMNS + 4]]).min() > 0.0
    for step in range(80, 120):
        action, state = policy.predict(recorded[step], state)
        assert np.array_equal(state.adaptation[1], learned)
        assert np.array_equal(law.lacking[1], lacking)
        assert np.array_equal(law.parameters[:, 1], parameters)
        assert np.array_equal(action[[0, 2]], whole[step, [0, 2]])
        assert not np.array_equal(action[1], whole[step, 1])
    anew, state = policy.predict(recorded[120], state, np.array([False, True, False]))
    rest, _ = replay(policy, recorded[121:], state)
    fresh, _ = replay(POLICIES[name](), recorded[120:, 1])
    assert np.array_equal(np.concatenate([anew[None, 1], rest[:, 1]]), fresh)


@both
def test_in_a_mirrored_world_left_and_right_are_exchanged(recorded, name):
    """Behind the filter, whose left and right are not the same to rounding."""
    actions, _ = replay(POLICIES[name](filtered=False), recorded[:100])
    mirrored, _ = replay(POLICIES[name](filtered=False), layout.mirror(recorded[:100]))
    np.testing.assert_allclose(mirrored[..., ::-1], actions, atol=1e-5)
    assert np.abs(actions[..., 0] - actions[..., 1]).max() > 0.1


@both
def test_an_observation_without_the_commands_is_refused(name):
    fewer = [field for field in layout.NAMES if not field.startswith("previous_action")]
    with pytest.raises(ValueError, match="previous_action_left"):
        POLICIES[name](observation=fewer)


@pytest.mark.parametrize(
    ("factory", "setting", "value"),
    [
        (l1, "forward_bandwidth", -1.0),
        (l1, "mass_factor", 0.0),
        (mrac, "turning_rate", 0.0),
        (mrac, "leak", float("nan")),
    ],
)
def test_settings_without_sense_are_refused_by_name(factory, setting, value):
    with pytest.raises(ValueError, match=setting):
        factory(context(), **{setting: value})


def test_every_range_of_the_search_names_a_setting_and_holds_its_default():
    for factory, settings in ((l1, L1Settings()), (mrac, MracSettings())):
        for name, (low, high, _logarithmic) in factory.TUNABLE.items():
            assert low <= getattr(settings, name) <= high, name


def test_the_law_cancels_what_it_is_told_that_the_model_lacks():
    """Net force less m a, moment less I b, with the compensator as if they had acted."""
    observation = np.zeros((2, layout.SIZE), dtype=np.float32)
    observation[:, [layout.INDEX["v_x"], layout.INDEX["reference_speed"]]] = 0.4
    controller = FeedbackLinearizingController(NOMINAL)
    plain, kept = controller.predict(observation)
    zero = FeedbackLinearizingController(NOMINAL)
    zero.lacking = np.zeros((2, 2))
    assert np.array_equal(zero.predict(observation)[0], plain)
    controller.lacking = np.array([[0.8, 0.0], [0.8, -0.3]])
    action, state = controller.predict(observation)
    effort = (action - plain).astype(float) * NOMINAL.torque_limit / NOMINAL.sprocket_radius
    np.testing.assert_allclose(effort.sum(axis=1), -0.8 * NOMINAL.mass, rtol=1e-5)
    moment = 0.5 * NOMINAL.track_gauge * (effort[:, 1] - effort[:, 0])
    np.testing.assert_allclose(moment, [0.0, 0.3 * NOMINAL.inertia], atol=0.1)
    np.testing.assert_allclose(state, kept, atol=1e-12)


def straight(policy, seconds=12.0, **ranges):
    """State of a policy that has driven one vehicle along a line, ideal sensors."""
    options = {"sensors": "ideal", "reference": {"kind": "straight", "speed": 2.0}}
    options |= {"duration": seconds + 1.0, "autoreset_mode": "Disabled"}
    values = {name: [value, value] for name, value in ranges.items()}
    env = TrackedVehicleVectorEnv(1, uncertainty=values, **options)
    (observation, _), state = env.reset(seed=1), None
    for _ in range(round(seconds / 0.02)):
        action, state = policy.predict(observation, state)
        observation, *_, info = env.step(action)
    return state, float(info["tracking_error"][0, 0])


def test_what_l1_cancels_on_a_line_is_the_resistance_that_its_model_lacks():
    """At constant speed: d = g (mu_0 m_0 - mu m) / (f m_0), f m_0 the mass of its model."""
    settings = L1Settings(forward_bound=20.0)
    policy = L1Policy(settings=settings)
    mass, resistance = 1900.0, 0.35
    state, error = straight(policy, mass=mass, longitudinal_resistance=resistance)
    nominal = NOMINAL.longitudinal_resistance * NOMINAL.mass
    assumed = settings.mass_factor * NOMINAL.mass
    wanted = GRAVITY * (nominal - resistance * mass) / assumed
    assert state.adaptation[0, CHANNEL_COLUMN + 2] == pytest.approx(wanted, rel=0.03)
    assert error < 0.02
    none = L1Policy(settings=settings._replace(forward_bound=0.0, turning_bound=0.0))
    assert straight(none, mass=mass, longitudinal_resistance=resistance)[1] > 0.05


def test_what_mrac_demands_on_a_line_is_the_resistance_of_the_vehicle():
    """p_2 mu_0 m_0 g + p_3 m_0 = mu m g at constant speed, whatever the parts are."""
    policy = MracPolicy(settings=MracSettings(leak=0.0))
    mass, resistance = 1900.0, 0.35
    state, error = straight(policy, mass=mass, longitudinal_resistance=resistance)
    _, held, constant = state.adaptation[0, CHANNEL_COLUMN : CHANNEL_COLUMN + 3]
    demanded = held * NOMINAL.longitudinal_resistance * GRAVITY + constant
    assert demanded == pytest.approx(resistance * mass * GRAVITY / NOMINAL.mass, rel=0.03)
    assert error < 0.02


def test_parameters_of_mrac_stay_in_the_projection_set_whatever_the_sensors_say(recorded):
    policy, state = MracPolicy(settings=MracSettings(turning_inertial=1e5)), None
    rng = np.random.default_rng(2)
    reached = set()
    for observation in recorded:
        seen = observation.copy()
        seen[:, SENSORS] += rng.normal(size=seen[:, SENSORS].shape).astype(np.float32)
        _, state = policy.predict(seen, state)
        for at in (CHANNEL_COLUMN, CHANNEL_COLUMN + 4):
            p = state.adaptation[:, at : at + 3]
            assert (p >= np.array(LOW)).all() and (p <= np.array(HIGH)).all()
            reached |= set(p.ravel())
        mass = policy.controller.parameters[PARAMETER_INDEX["mass"]] / NOMINAL.mass
        assert (mass >= LOW.inertial).all() and (mass <= HIGH.inertial).all()
    assert reached & {*LOW, *HIGH}


@pytest.mark.parametrize("uncertainty", ["soil-and-mass", "payload"])
@both
def test_unknown_vehicles_are_tracked_several_times_better_than_without_adaptation(
    name, uncertainty
):
    idle = L1Policy(settings=L1Settings(forward_bound=0.0, turning_bound=0.0, drive_bandwidth=0.0))
    before = run(idle, uncertainty, count=16, seed=70_000)
    after = run(POLICIES[name](), uncertainty, count=16, seed=70_000)
    assert np.median(after.settled) < 0.35 * np.median(before.settled)
    assert after.over.sum() <= before.over.sum()


@both
def test_weak_drives_are_made_up_for(name):
    error = run(POLICIES[name](), "weak-actuator", count=16, seed=70_000).settled
    assert np.median(error) < 0.05


@both
def test_ideal_sensors_and_the_right_parameters_leave_nothing_to_adapt(name):
    policy = POLICIES[name](data_sheet=DataSheet.of(IDEAL))
    assert not policy.filtered
    outcome = run(policy, "nominal", count=4, sensors="ideal", seed=70_000)
    assert outcome.settled.max() < 0.02
