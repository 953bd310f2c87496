"""Observation augmentation: what each kind shows, forgetting, going on from a state, residuals."""

import numpy as np
import pytest

from baselines.estimators.measurement import DataSheet
from baselines.learned.agent_policy import make_augmentation
from baselines.learned.augmentation import KINDS, LAGS, RECKONED, REMEMBERED, SHEET, network_inputs
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
BY_SPEED = PolicyContext(0.02, "sliding", MOCAP, "speed", VEHICLES["focchi"])
NEVER = np.zeros(2, dtype=bool)
ALWAYS = np.ones(2, dtype=bool)
V_X = obs.INDEX["v_x"]


def observations(steps, count=2):
    """Observations whose speed is the number of the step, plus 100 per row."""
    for step in range(steps):
        batch = np.zeros((count, obs.SIZE), dtype=np.float32)
        batch[:, V_X] = step + 100.0 * np.arange(count)
        yield batch


def past_speeds(features):
    return features.reshape(len(features), len(LAGS), len(REMEMBERED))[
        :, :, REMEMBERED.index("v_x")
    ]


def test_history_holds_the_samples_at_its_lags():
    history = make_augmentation("history", {}, RTK, 2)
    for step, batch in enumerate(observations(50)):
        features = history.observe(batch, ALWAYS if step == 0 else NEVER)
        expected = np.maximum(step - np.array(LAGS), 0)
        np.testing.assert_array_equal(past_speeds(features)[0], expected)
        np.testing.assert_array_equal(past_speeds(features)[1], expected + 100)
    assert features.shape == (2, len(history.feature_names))


def test_history_forgets_the_rows_that_start_and_no_others():
    history = make_augmentation("history", {"lags": [1, 3]}, RTK, 2)
    for step, batch in enumerate(observations(10)):
        features = history.observe(batch, np.array([step == 0, step in (0, 9)]))
    speeds = features.reshape(2, 2, -1)[:, :, REMEMBERED.index("v_x")]
    np.testing.assert_array_equal(speeds, [[8, 6], [109, 109]])


@pytest.mark.parametrize("context", [RTK, BY_SPEED], ids=["torque", "speed"])
@pytest.mark.parametrize("kind", KINDS)
def test_memories_put_back_in_some_rows_leave_the_others(kind, context):
    options = {"uncertainty": "payload"} if context is RTK else SPEED
    env = TrackedVehicleVectorEnv(3, **options)
    one, other, expected = (make_augmentation(kind, {}, context, 3) for _ in range(3))
    observation, _ = env.reset(seed=0)
    for step in range(10):
        start = np.full(3, step == 0)
        one.observe(observation, start)
        other.observe(observation, start)
        observation = env.step(np.full((3, 2), 0.3, np.float32))[0]
    kept = one.memories()
    stranger = np.roll(observation, 1, axis=0)
    np.testing.assert_array_equal(
        one.observe(stranger, np.zeros(3, bool)), other.observe(stranger, np.zeros(3, bool))
    )
    one.restore(kept, np.array([True, False, True]))
    expected.restore(kept)
    last = expected.observe(observation, np.zeros(3, bool))
    moved = other.observe(observation, np.zeros(3, bool))
    mixed = one.observe(observation, np.zeros(3, bool))
    np.testing.assert_array_equal(mixed[[0, 2]], last[[0, 2]])
    np.testing.assert_array_equal(mixed[1], moved[1])
    assert kind == "blind" or not np.array_equal(mixed[1], last[1])


def test_the_residual_of_zero_is_the_adaptive_policy():
    agents = pytest.importorskip("agents.environments", reason="its wrapper needs the extra `rl`")
    inner = TrackedVehicleVectorEnv(2, uncertainty="mixed", duration=2.0, autoreset_mode="SameStep")
    env = agents.AgentVectorEnv(inner, make_augmentation("residual", {}, RTK, 2))
    plain = TrackedVehicleVectorEnv(2, uncertainty="mixed", duration=2.0, autoreset_mode="SameStep")
    env.reset(seed=0)
    observation, _ = plain.reset(seed=0)
    policy, state, start = AdaptivePolicy(gains=Gains()), None, ALWAYS
    for _ in range(150):  # over the end of an episode
        action, state = policy.predict(observation, state, start)
        observation, *_, terminated, truncated, _ = plain.step(action)
        start = terminated | truncated
        widened = env.step(np.zeros((2, 2), np.float32))[0]
        np.testing.assert_array_equal(widened[:, : obs.SIZE], observation)


def test_the_residual_corrects_the_controller_with_the_gains_of_its_archive():
    """Without gains, as in archives before there were any to tune, those of the paper."""
    seen_by = {}
    for name, options in {
        "none": {},
        "paper": {"gains": list(Gains())},
        "own": {"gains": [200.0]},
    }.items():
        augmentation = make_augmentation("residual", options, RTK, 1)
        observation = np.full((1, obs.SIZE), 0.05, np.float32)
        seen_by[name] = augmentation.observe(observation, np.ones(1, dtype=bool))[:, :2]
    assert np.array_equal(seen_by["none"], seen_by["paper"])
    assert np.abs(seen_by["own"] - seen_by["none"]).max() > 1e-3


def test_the_residual_is_scaled_and_stays_within_the_limits():
    augmentation = make_augmentation("residual", {"scale": 0.5}, RTK, 2)
    features = np.zeros((2, len(augmentation.feature_names)), np.float32)
    features[:, :2] = [[0.1, -0.2], [0.9, -0.9]]
    command = augmentation.command(np.array([[1.0, -0.4], [1.0, -1.0]], np.float32), features)
    np.testing.assert_allclose(command, [[0.6, -0.4], [1.0, -1.0]], atol=1e-7)


def test_the_network_sees_zero_for_what_is_not_measured_and_bounded_features():
    observation = np.zeros((1, obs.SIZE), np.float32)
    observation[0, V_X] = np.nan
    shown = network_inputs(observation, np.array([[np.inf, -1e9, np.nan]], np.float32))
    assert shown[0, V_X] == 0.0 and shown[0, -3:].tolist() == [10.0, -10.0, 0.0]


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("elephant", {}, "kinds are blind, history"),
        ("blind", {"lags": [1]}, "options"),
        ("history", {"lags": [0, 1]}, "must rise, from 1"),
        ("history", {"lags": []}, "must rise, from 1"),
        ("residual", {"scale": 0.0}, r"must be in \(0, 2\]"),
        ("residual", {"gains": [50.0, 1.0, 15.0]}, "not Hurwitz"),
    ],
)
def test_wrong_kinds_and_options_are_clear_errors(kind, options, message):
    with pytest.raises(ValueError, match=message):
        make_augmentation(kind, options, RTK, 2)


def test_the_filtered_errors_are_the_true_ones_with_ideal_sensors():
    """In their scales: position error 0.2 m, heading 0.1 rad, speed 0.2 m/s, yaw rate 0.1."""
    env = TrackedVehicleVectorEnv(2, uncertainty="nominal", sensors="ideal")
    augmentation = make_augmentation(
        "residual", {}, PolicyContext(0.02, "sliding", make_sensors("ideal")), 2
    )
    observation, _ = env.reset(seed=0)
    for step in range(20):
        features = augmentation.observe(observation, np.full(2, step == 0))
        known = obs.unpack(observation)
        expected = {
            "filtered_error_x": known["position_error_x"] / 0.2,
            "filtered_error_y": known["position_error_y"] / 0.2,
            "filtered_heading_error": known["heading_error"] / 0.1,
            "filtered_speed_error": (known["reference_speed"] - known["v_x"]) / 0.2,
            "filtered_v_y": known["v_y"] / 0.2,
            "filtered_yaw_rate_error": (known["reference_yaw_rate"] - known["yaw_rate"]) / 0.1,
        }
        for name, values in expected.items() if step > 2 else ():  # the filter has begun
            shown = features[:, augmentation.feature_names.index(name)]
            np.testing.assert_allclose(shown, values, atol=0.005, err_msg=name)
        command = augmentation.command(np.zeros((2, 2), np.float32), features)
        observation = env.step(command)[0]


def test_the_network_sees_how_far_the_filtered_pose_can_be_trusted():
    """Error of the filtered distance over the claimed deviation: its square is about 1."""
    shown = []
    for name in ("rtk", "strawa"):
        sensors = make_sensors(name)
        env = TrackedVehicleVectorEnv(32, sensors=sensors, expose_truth=True)
        augmentation = make_augmentation("residual", {}, RTK._replace(sensors=sensors), 32)
        observation, info = env.reset(seed=0)
        ratios = []
        for step in range(150):
            features = augmentation.observe(observation, np.full(32, step == 0))
            named = dict(zip(augmentation.feature_names, features.T, strict=True))
            deviation = 0.05 * np.exp(named["filtered_position_log_deviation"])
            true = info["tracking_error"][:, 0]
            filtered = 0.2 * np.hypot(named["filtered_error_x"], named["filtered_error_y"])
            ratios.append((filtered - true) ** 2 / deviation**2)
            command = augmentation.command(np.zeros((32, 2), np.float32), features)
            observation, *_, info = env.step(command)
        shown.append(np.median(deviation))
        assert 0.1 < np.mean(ratios[50:]) < 1.5, name
    assert shown[1] > 5.0 * shown[0]


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


ON_SLOPES = BY_SPEED._replace(observation=make_layout(TERRAIN["observation"]).names)


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
    augmentation = make_augmentation(kind, {}, BY_SPEED, 2)
    shown, _ = drive_with(augmentation)
    assert shown.shape[2] == len(augmentation.feature_names)
    assert np.isfinite(shown).all()
    assert np.abs(shown).max() < 20.0
    named = dict(zip(augmentation.feature_names, shown[-1].T, strict=True))
    assert set(SLIP_ESTIMATES) <= set(named)
    assert (np.abs(named["log_friction"]) > 0.01).any()  # one has left the nominal floor


@pytest.mark.parametrize(("context", "arguments"), [(BY_SPEED, SPEED), (ON_SLOPES, TERRAIN)])
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
