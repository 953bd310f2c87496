"""The unicycle and the slippage-aware policy: tracking, saturation, sensors, interface."""

import math

import numpy as np
import pytest

from baselines.estimators.measurement import DataSheet
from baselines.lyapunov import lyapunov_laws
from baselines.lyapunov.lyapunov_laws import LyapunovGains, PseudoKinematicModel
from baselines.lyapunov.slippage_aware import SlippageAwarePolicy, UnicyclePolicy
from baselines.slip.slip_models import NoSlip
from tests.baselines.episodes import replay
from tests.baselines.lyapunov.lyapunov_function import Spiral, pose_error
from tracked_env import observation as layout
from tracked_env.physics.parameters import plant_parameters

MAXXII = plant_parameters()._replace(
    track_gauge=0.606, sprocket_radius=0.0856, sprocket_speed_limit=20.0
)
PERIOD = 0.02
RTK = DataSheet()


class SpeedDependentSlip:
    """Slip of the signs that F measured, times `scale`; alpha changes with speed too."""

    def __init__(self, scale=1.0):
        self.scale = scale

    def slip(self, sprocket_left, sprocket_right):
        turn, speed = sprocket_right - sprocket_left, np.abs(sprocket_left + sprocket_right) / 2.0
        beta = self.scale * 0.2 * 0.0856 * turn
        alpha = self.scale * -0.35 * turn / np.sqrt(64.0 + turn * turn) * (1.4 - speed / 10.0)
        return -beta, beta, alpha


class Circle:
    """A reference of constant speed and yaw rate."""

    speed, yaw_acceleration = 0.3, 0.0

    def yaw_rate(self, _time):
        return 0.6

    def advance(self, pose, _time, duration):
        motion = lyapunov_laws.BodyMotion(self.speed, 0.6)
        return np.array(lyapunov_laws.pose_step(*pose, motion, 0.0, duration))


def drive(
    policy, duration, reference=None, start=(0.3, 0.3, 0.2), noise=None, count=1, delay=0, rate=1
):
    """Distances (T, N) and actions (T, N, 2) of vehicles of SpeedDependentSlip; delay of the
    pose, and rate (from one pose to the next), in steps."""
    reference, limit = reference or Spiral(), float(policy.geometry.limit[0])
    model = PseudoKinematicModel(MAXXII, SpeedDependentSlip())
    noise = noise or RTK._make([0.0] * len(RTK))
    rng, h = np.random.default_rng(0), policy.control_period
    pose, goal = np.tile(np.array(start), (count, 1)), np.zeros(3)
    sprockets, seen, state = np.zeros((count, 2)), [], None
    distances, actions = [], []
    sigma = [noise.position_noise, noise.position_noise, noise.yaw_noise]
    for k in range(round(duration / h)):
        motion, alpha = model.motion(sprockets)
        seen.append(pose + rng.normal(size=pose.shape) * sigma)
        taken = max(k - k % rate - delay, 0)
        error = np.array([pose_error(*at, *goal) for at in seen[taken]])
        values = dict.fromkeys(layout.NAMES, np.zeros(count)) | {
            "position_error_x": -error[:, 0],
            "position_error_y": -error[:, 1],
            "heading_error": -error[:, 2],
            "v_x": motion[:, 0] + rng.normal(0.0, noise.velocity_noise, count),
            "v_y": motion[:, 0] * np.tan(alpha) + rng.normal(0.0, noise.velocity_noise, count),
            "yaw_rate": motion[:, 1] + rng.normal(0.0, noise.gyro_noise, count),
            "sprocket_speed_left": sprockets[:, 0],
            "sprocket_speed_right": sprockets[:, 1],
            "reference_speed": np.full(count, reference.speed),
            "reference_yaw_rate": np.full(count, reference.yaw_rate(k * h)),
            "reference_yaw_acceleration": np.full(count, reference.yaw_acceleration),
            "pose_age": np.full(count, (k - taken) * h),
        }
        action, state = policy.predict(layout.pack(values), state)
        sprockets = action.astype(float) * limit
        distances.append(np.hypot(pose[:, 0] - goal[0], pose[:, 1] - goal[1]))
        actions.append(action)
        pose = model.step(pose, sprockets, h)
        goal = reference.advance(goal, k * h, h)
    return np.array(distances), np.array(actions)


def aware(period=PERIOD, **options):
    return SlippageAwarePolicy(MAXXII, period, SpeedDependentSlip(), **options)


def observations(count=200, rows=3, seed=0):
    """Random observations (count, rows, SIZE) of vehicles near their paths."""
    seen = np.random.default_rng(seed).normal(0.0, 0.5, (count, rows, layout.SIZE))
    seen[..., layout.INDEX["pose_age"]] **= 2.0
    return seen.astype(np.float32)


def test_on_the_spiral_only_the_slippage_aware_controller_converges():
    distance, _ = drive(aware(), 40.0)
    assert distance[1750:].max() < 1e-3
    distance, _ = drive(UnicyclePolicy(MAXXII, PERIOD), 40.0)
    assert distance[1750:].min() > 0.05


def test_the_slip_of_the_path_is_that_of_the_motion_on_it():
    """With f(v_d, w_d) as alpha_d, 6.2 mm would be left on this circle."""
    distance, _ = drive(aware(), 30.0, Circle(), start=(0.0, 0.0, 0.0))
    assert distance[-1] < 3e-4


def test_what_the_slip_model_leaves_over_costs_distance_but_not_stability():
    policy = SlippageAwarePolicy(MAXXII, PERIOD, SpeedDependentSlip(0.9))
    distance, _ = drive(policy, 30.0, Circle(), start=(0.0, 0.0, 0.0))
    assert 0.02 < distance[1250:].min() < distance[1250:].max() < 0.2


def test_the_rate_of_the_slip_is_that_of_the_slip_along_the_reference():
    policy, h = aware(), 1e-3
    for speed, turn, acceleration, bend in ((0.3, 0.4, 0.0, 0.3), (0.4, -0.5, 0.2, 0.1)):
        rows = [[speed + s * acceleration, turn + s * bend, 0.0, 0.0] for s in (-h, h)]
        before, after = policy.reference_slip(np.array(rows))[0]
        alpha, rate = policy.reference_slip(np.array([[speed, turn, acceleration, bend]]))
        assert rate[0] == pytest.approx((after - before) / (2.0 * h), rel=0.02)
        assert alpha[0] * turn < 0.0
    assert policy.reference_slip(np.array([[0.3, 0.4, 0.0, 0.0]]))[1] == 0.0
    assert policy.reference_slip(np.array([[0.0, 1.0, 0.0, 0.0]]))[0] == 0.0


def test_a_jump_of_the_reference_gives_no_blow():
    policy, state = aware(), None
    values = dict.fromkeys(layout.NAMES, 0.0) | {"reference_speed": 0.2, "v_x": 0.2}
    speeds = {"sprocket_speed_left": 0.2 / 0.0856, "sprocket_speed_right": 0.2 / 0.0856}
    _, state = policy.predict(layout.pack(values | speeds), state)
    action, _ = policy.predict(layout.pack(values | speeds | {"reference_yaw_rate": 0.3}), state)
    left, right = 20.0 * action * 0.0856
    assert (right - left) * 0.6 / 0.606 == pytest.approx(0.3, abs=0.2)  # w_d and k_phi alpha_d


def test_saturated_sprockets_keep_the_turn():
    slow = MAXXII._replace(sprocket_speed_limit=6.0)
    values = dict.fromkeys(layout.NAMES, 0.0) | {"position_error_x": 2.0}
    policy = UnicyclePolicy(slow, PERIOD)
    action, _ = policy.predict(layout.pack(values | {"heading_error": 0.5}))
    expected_turn = math.sin(0.5) * 0.606 / 0.0856  # [rad/s] right minus left
    assert 6.0 * (action[1] - action[0]) == pytest.approx(expected_turn, rel=1e-5)
    assert action[1] == 1.0


def test_the_filter_calms_the_tracks_and_follows_no_worse():
    path = {"duration": 15.0, "start": (0.0, 0.0, 0.0), "noise": RTK, "count": 16}
    assert aware().pose_filter[1:3] == (1.0, 1.0)
    raw, rough = drive(aware(), **path)
    filtered, calm = drive(aware(data_sheet=RTK), **path)
    rough, calm = (np.abs(np.diff(a[150:], axis=0)).mean() for a in (rough, calm))
    assert calm < 0.05 * rough
    assert np.sqrt((filtered**2).mean()) < np.sqrt((raw**2).mean())


def test_without_a_velocity_sensor_the_belts_carry_the_filter():
    blind = RTK._replace(velocity_noise=1e3)
    policy = aware(data_sheet=blind)
    assert not policy.pose_filter.velocity_measured
    noise, at_rest = blind._replace(velocity_noise=5.0), (0.0, 0.0, 0.0)
    distance, _ = drive(policy, 15.0, start=at_rest, noise=noise, count=16)
    assert np.sqrt((distance**2).mean()) < 0.01


def test_late_and_rare_poses_are_carried_forward():
    late, _ = drive(aware(), 40.0, delay=5)
    assert late[1750:].max() < 3e-3  # the vehicle drives 30 mm in 0.1 s
    assert drive(aware(), 40.0, rate=10)[0][1750:].max() < 3e-3


def test_missing_samples_never_make_an_action_missing():
    sensors = layout.INDEX["reference_speed"]
    for policy in (aware(), aware(data_sheet=RTK), UnicyclePolicy(MAXXII, PERIOD)):
        seen = observations()
        seen[20:60, 0, :sensors] = np.nan
        seen[80:120, 1] = np.nan
        seen[:5, 2, :3] = np.nan
        seen[50:70, 2, layout.INDEX["pose_age"] :] = np.inf
        actions, state = replay(policy, seen)
        assert np.isfinite(actions).all()
        assert (np.abs(actions) <= 1.0).all()
        assert all(np.isfinite(values).all() for values in state)
        assert (actions[80:120, 1] == 0.0).all()  # no reference: it stands
        assert (actions[:5, 2] == 0.0).all()  # it does not know yet where it is
        assert (actions[20:60, 0] != 0.0).any()  # dead reckoning
        assert (actions[125:, 1] != 0.0).any()


def test_without_the_encoders_the_demand_stands_in_for_them():
    policy, seen = aware(), observations(2)
    _, state = policy.predict(seen[0])
    blind, same = seen[1].copy(), seen[1].copy()
    for side, name in enumerate(("sprocket_speed_left", "sprocket_speed_right")):
        blind[:, layout.INDEX[name]] = np.nan
        same[:, layout.INDEX[name]] = state.sprockets[:, side] / layout.SCALE[layout.INDEX[name]]
    expected, _ = policy.predict(same, state)
    assert policy.predict(blind, state)[0] == pytest.approx(expected, abs=1e-6)


class Silent:
    """A slip model without any value."""

    def slip(self, left, right):
        return (np.full(left.shape, np.nan),) * 3


@pytest.mark.parametrize("model", [NoSlip(), Silent()])
def test_without_slip_both_policies_are_the_same_bit_for_bit(model):
    seen = observations()
    expected, _ = replay(UnicyclePolicy(MAXXII, PERIOD), seen)
    assert np.array_equal(replay(SlippageAwarePolicy(MAXXII, PERIOD, model), seen)[0], expected)
    assert not np.array_equal(replay(aware(), seen)[0], expected)


def test_left_and_right_mirror_exactly():
    seen = observations()
    actions, _ = replay(aware(data_sheet=RTK), seen)
    mirrored, _ = replay(aware(data_sheet=RTK), layout.mirror(seen))
    assert np.array_equal(mirrored, actions[..., ::-1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gains": LyapunovGains(-1.0, 1.0)}, "positive"),
        ({"gains": LyapunovGains(10.0, math.nan)}, "positive"),
        ({"control_period": 50.0}, "Did you pass a rate"),
        ({"control_period": 0.2}, "overshoots"),
        ({"parameters": MAXXII._replace(sprocket_radius=85.6)}, "sprocket_radius = 85.6 m"),
    ],
)
def test_an_argument_that_makes_no_sense_is_refused_with_its_reason(arguments, message):
    with pytest.raises(ValueError, match=message):
        UnicyclePolicy(**({"parameters": MAXXII, "control_period": PERIOD} | arguments))
