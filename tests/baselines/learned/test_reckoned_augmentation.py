"""Dead reckoning and the data sheet as inputs of an agent, and the base of a residual one."""

import numpy as np
import pytest

from baselines.estimators.measurement import DataSheet
from baselines.learned.agent_policy import make_augmentation
from baselines.learned.augmentation import KINDS, RECKONED, SHEET
from baselines.learned.controller_augmentation import SLIP_ESTIMATES
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from baselines.lyapunov.slippage_aware import tuned_gains
from baselines.registry import POLICIES, slc_adaptive
from tracked_env import SPEED, TERRAIN
from tracked_env import observation as obs
from tracked_env.benchmark import PolicyContext
from tracked_env.observation import View, make_layout
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import MOCAP, make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

PERIOD = 0.02
RTK = PolicyContext(PERIOD, "sliding")
INDOORS = PolicyContext(PERIOD, "sliding", drive="speed", vehicle=VEHICLES["focchi"])
IDEAL = RTK._replace(sensors=make_sensors("ideal"))
_SCALES = np.array([*RECKONED.values()])


def seen(**values):
    """One observation of the named values, SI."""
    given = {**dict.fromkeys(obs.NAMES, 0.0), **values}
    return obs.pack({name: np.array([value]) for name, value in given.items()})


def test_without_a_pose_the_belts_carry_the_error_on_as_far_as_they_drive():
    """A reference that stands, 1 m ahead; the belts drive towards it at 0.5 m/s, turning left."""
    made, vehicle = make_augmentation("reckoned", {}, IDEAL, 1), VEHICLES["strawa"]
    made.observe(seen(position_error_x=1.0), np.array([True]))
    belts = 0.5 / vehicle.sprocket_radius
    steps, turn = 50, 0.3
    for step in range(1, steps + 1):
        held = seen(
            position_error_x=1.0,
            pose_age=step * PERIOD,
            yaw_rate=turn,
            sprocket_speed_left=belts,
            sprocket_speed_right=belts,
        )
        shown = made.observe(held, np.array([False]))[0] * _SCALES
    time = steps * PERIOD
    yaw, radius = turn * time, 0.5 / turn
    driven = radius * np.sin(yaw), radius * (1.0 - np.cos(yaw))
    ahead, left = 1.0 - driven[0], -driven[1]
    cosine, sine = np.cos(yaw), np.sin(yaw)
    expected = cosine * ahead + sine * left, cosine * left - sine * ahead, -yaw, 0.5
    np.testing.assert_allclose(shown, expected, atol=2e-3)


def test_dead_reckoning_trusts_each_pose_by_the_data_sheet():
    """A sample 0.1 m off moves the error by nearly all of it, or by a hundredth."""
    moved = []
    for sensors in ("ideal", "rtk", "strawa"):
        made = make_augmentation("reckoned", {}, RTK._replace(sensors=make_sensors(sensors)), 1)
        made.observe(seen(), np.array([True]))
        moved.append(made.observe(seen(position_error_x=0.1), np.array([False]))[0, 0] * 0.2)
    np.testing.assert_allclose(moved[0], 0.1, rtol=1e-6)
    assert 0.001 < moved[1] < 0.05 and 0.0 < moved[2] < 0.001


def test_the_bias_of_the_gyro_is_learned_with_poses_and_taken_off_without_until_a_new_start():
    """A vehicle that stands as its reference does; the gyro alone says that it turns."""
    context = RTK._replace(sensors=RTK.sensors._replace(gyro_bias=0.005))
    bias, made, other = 0.005, *(make_augmentation("reckoned", {}, context, 1) for _ in range(2))
    turned, none = {}, np.array([False])

    def shown_heading(one, age, start):
        return -(one.observe(seen(yaw_rate=bias, pose_age=age), start)[0] * _SCALES)[2]

    for learning in (40.0, 0.0):  # [s] with poses before an outage of 10 s
        for step in range(round((learning + 10.0) / PERIOD)):
            if learning == 40.0 and step == 2100:
                other.restore(made.memories())
            missing = max(step * PERIOD - learning, 0.0)
            turned[learning] = shown_heading(made, missing, np.array([step == 0]))
            if learning == 40.0 and step >= 2100:
                assert shown_heading(other, missing, none) == turned[learning]
    assert turned[0.0] == pytest.approx(10.0 * bias, rel=0.05)
    assert abs(turned[40.0]) < 0.1 * turned[0.0]


def test_without_a_pose_reckoned_errors_are_far_nearer_to_the_truth_than_the_held_ones():
    """On firm soil, where tracks hardly slip, wherever the vehicle drives."""
    env = TrackedVehicleVectorEnv(
        8, uncertainty="soil-and-mass", sensors="rtk-outages", duration=14.0, error_limit=200.0
    )
    made = make_augmentation("reckoned", {}, RTK, 8)
    observation, _ = env.reset(seed=3)
    reckoned, held, start = [], [], np.ones(8, bool)
    for _ in range(600):
        shown = made.observe(observation, start)[:, :2] * _SCALES[:2]
        start[:] = False
        true = env.simulation.column("distance")
        missing = observation[:, obs.INDEX["pose_age"]] > 0.5
        reckoned += [*np.abs(np.hypot(*shown.T) - true)[missing]]
        held += [*np.abs(np.hypot(*observation[:, :2].T) - true)[missing]]
        observation = env.step(np.full((8, 2), 0.15, np.float32))[0]
    assert len(held) > 500
    assert np.median(reckoned) < 0.3 * np.median(held)


def test_a_state_of_other_vehicles_is_refused():
    two, three = (make_augmentation("reckoned", {}, RTK, count) for count in (2, 3))
    with pytest.raises(ValueError, match=r"state of shape \(3, 3\); must be \(2, 3\)"):
        two.restore(three.memories())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("context", [RTK, INDOORS], ids=["torque", "speed"])
def test_the_data_sheet_stands_behind_all_features_and_changes_none(kind, context):
    plain, with_sheet = (
        make_augmentation(kind, {"data_sheet": shown}, context, 2) for shown in (False, True)
    )
    batch = np.full((2, obs.SIZE), 0.1, np.float32)
    start = np.ones(2, bool)
    one, other = plain.observe(batch, start), with_sheet.observe(batch, start)
    np.testing.assert_array_equal(one, other[:, : -len(SHEET)])
    assert with_sheet.feature_names == (*plain.feature_names, *SHEET)
    action = np.full((2, 2), 0.25, np.float32)
    np.testing.assert_array_equal(plain.command(action, one), with_sheet.command(action, other))


def test_the_data_sheet_tells_apart_what_single_observations_do_not():
    shown = {}
    for sensors in ("rtk", "strawa", "ideal", {"preset": "rtk", "velocity_measured": 0.0}):
        context = RTK._replace(sensors=make_sensors(sensors))
        made = make_augmentation("blind", {"data_sheet": True}, context, 1)
        row = made.observe(np.zeros((1, obs.SIZE), np.float32), np.ones(1, bool))[0]
        shown[str(sensors)] = dict(zip(SHEET, row, strict=True))
    rtk, strawa, ideal, unmeasured = shown.values()
    assert rtk["position_noise"] == 0.0 and rtk["velocity_noise"] == pytest.approx(0.0)
    assert strawa["position_noise"] == pytest.approx(np.log10(50.0))
    assert ideal["position_noise"] == -3.0  # no noise at all
    assert 4.0 < unmeasured["velocity_noise"] < obs.FEATURE_BOUND


def test_a_residual_agent_corrects_the_policy_that_it_names(monkeypatch):
    """The usual one is `adaptive`; a policy with other gains is another base."""
    given, start = seen(position_error_x=0.3, reference_speed=1.0), np.ones(1, bool)

    def stiff(context):
        sheet = DataSheet.of(context.sensors)
        return AdaptivePolicy(data_sheet=sheet, gains=Gains(k_p=20.0))

    monkeypatch.setitem(POLICIES, "stiff", stiff)
    usual, named, other = (
        make_augmentation("residual", options, RTK, 1).observe(given, start)[0, :2]
        for options in ({}, {"base": "adaptive"}, {"base": "stiff"})
    )
    np.testing.assert_array_equal(usual, named)
    assert not np.allclose(usual, other, atol=1e-3)


def test_a_residual_agent_on_predictive_control_goes_on_from_its_memories_and_can_be_frozen():
    env = TrackedVehicleVectorEnv(2, uncertainty="soil-and-mass", autoreset_mode="Disabled")
    made, again, held = (
        make_augmentation("residual", {"base": "mpc-adaptive"}, RTK, 2) for _ in range(3)
    )
    parameters = lambda one: one.policy.controller.parameters.copy()  # noqa: E731
    observation, _ = env.reset(seed=1)
    start, nothing = np.ones(2, bool), np.zeros((2, 2), np.float32)
    for step in range(60):
        if step == 40:
            for one in (again, held):
                one.restore(made.memories())
                one.observe(observation, start)
            held.freeze(np.array([False, True]))
            learned = parameters(held)
        features = made.observe(observation, start)
        if step > 40:
            np.testing.assert_array_equal(again.observe(observation, start), features)
            np.testing.assert_array_equal(held.observe(observation, start)[0], features[0])
        start[:] = False
        action = made.command(nothing, features)
        np.testing.assert_array_equal(action, features[:, :2])
        observation = env.step(action)[0]
    np.testing.assert_array_equal(parameters(held)[:, 1], learned[:, 1])
    np.testing.assert_array_equal(parameters(held)[:, 0], parameters(made)[:, 0])
    assert not np.array_equal(parameters(made)[:, 1], learned[:, 1])


@pytest.mark.parametrize(
    ("context", "base", "message"),
    [
        (RTK, "nobody", "base = 'nobody'; must be a registered policy: nominal, "),
        (RTK, "nominal", "base = 'nominal' identifies nothing; must be adaptive or mpc-adaptive"),
        (INDOORS, "adaptive", "driven by its sprocket speeds; must be left out"),
    ],
)
def test_a_base_that_cannot_be_corrected_is_refused_in_one_line(context, base, message):
    with pytest.raises(ValueError, match=message):
        make_augmentation("residual", {"base": base}, context, 1)


# Vehicles driven by their sprocket speeds


CONTEXT = PolicyContext(0.02, "sliding", MOCAP, "speed", VEHICLES["focchi"])
ON_SLOPES = CONTEXT._replace(observation=make_layout(TERRAIN["observation"]).names)


def drive_with(augmentation, steps=60, seed=0, count=2):
    """Features (steps, N, F) while random actions drive."""
    env = TrackedVehicleVectorEnv(count, **SPEED)
    observation, _ = env.reset(seed=seed)
    rng, start, shown = np.random.default_rng(seed), np.ones(count, dtype=bool), []
    for _ in range(steps):
        shown.append(augmentation.observe(observation, start).copy())
        start[:] = False
        action = rng.uniform(0.2, 0.7, (count, 2)).astype(np.float32)
        observation, *_ = env.step(augmentation.command(action, shown[-1]))
    return np.array(shown), observation


@pytest.mark.parametrize("kind", ["estimates", "residual"])
def test_features_are_named_finite_and_of_order_one(kind):
    augmentation = make_augmentation(kind, {}, CONTEXT, 2)
    shown, _ = drive_with(augmentation)
    assert shown.shape[2] == len(augmentation.feature_names)
    assert np.isfinite(shown).all()
    assert np.abs(shown).max() < 20.0
    named = dict(zip(augmentation.feature_names, shown[-1].T, strict=True))
    assert set(SLIP_ESTIMATES) <= set(named)
    assert (np.abs(named["log_friction"]) > 0.01).any()  # one has left the nominal floor


@pytest.mark.parametrize(("context", "arguments"), [(CONTEXT, SPEED), (ON_SLOPES, TERRAIN)])
def test_a_residual_of_nothing_drives_as_the_adaptive_controller_of_its_environment(
    context, arguments
):
    """On slopes that is the one that knows them: its observation shows the attitude."""
    env = TrackedVehicleVectorEnv(2, **arguments)
    options = {"gains": list(tuned_gains(context.observation))}
    augmentation = make_augmentation("residual", options, context, 2)
    controller = slc_adaptive(context)
    view, state = View(context.observation, augmentation.needs), None
    observation, _ = env.reset(seed=3)
    start = np.ones(2, dtype=bool)
    for _ in range(40):
        features = augmentation.observe(view(observation), start)
        command = augmentation.command(np.zeros((2, 2), np.float32), features)
        action, state = controller.predict(observation, state, start)
        np.testing.assert_array_equal(command, action)
        start = np.zeros(2, dtype=bool)
        observation, *_ = env.step(action)
