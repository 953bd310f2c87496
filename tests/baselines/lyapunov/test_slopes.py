"""The Lyapunov policies on slopes: errors in the vehicle's plane, slip on the slope it feels."""

import numpy as np
import pytest

import tracked_env
from baselines.estimators.measurement import DataSheet
from baselines.lyapunov import slippage_aware
from baselines.lyapunov.lyapunov_laws import GAINS_ON_SLOPES, LyapunovGains, steady_gain
from baselines.lyapunov.pose_filter import ATTITUDE, filtered_attitude, in_vehicle_plane
from baselines.lyapunov.slippage_aware import (
    AdaptiveSlipPolicy,
    KnownSlip,
    SlippageAwarePolicy,
    UnicyclePolicy,
)
from baselines.registry import POLICIES
from baselines.slip.slip_sweep import (
    FAMILY_NODES,
    FAMILY_SLOPE_STEP,
    identified_slip,
    identified_slope_slip,
    with_friction,
)
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyContext
from tracked_env.benchmark.policy_interface import needs_truth
from tracked_env.benchmark.runner import drive
from tracked_env.observation import make_layout
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

FOCCHI = VEHICLES["focchi"]
SHOWN = make_layout(tracked_env.TERRAIN["observation"])
LAYOUTS = (layout.NAMES, SHOWN.names)


def context(sensors="mocap"):
    known = make_sensors(sensors), "speed", VEHICLES["focchi"], SHOWN.names
    return PolicyContext(0.02, "sliding", *known)


def environment(count, truth=False, **arguments):
    options = {**tracked_env.TERRAIN, **arguments}
    return TrackedVehicleVectorEnv(count, **options, autoreset_mode="Disabled", expose_truth=truth)


def error_and_rate(policy, count, **arguments):
    """(count,) RMSE [m] and action rate [rad/s^2] after 3 s, on seeds that no set has."""
    env = environment(count, needs_truth(policy), **arguments)
    trace, _ = drive(policy, env, range(70000, 70000 + count), lambda: None)
    assert not trace.terminated.any()
    error = np.sqrt((trace.channel("error")[150:] ** 2).mean(axis=0))
    changes = [
        np.abs(np.diff(trace.channel(n)[150:], axis=0)) for n in ("action_left", "action_right")
    ]
    return error, np.mean(changes, axis=(0, 1)) * trace.demand_limit / trace.control_period


def rmse(name, count, **arguments):
    """(count,) RMSE [m] after 3 s of a named policy."""
    policy = POLICIES[name](context(arguments.get("sensors", "mocap")))
    return error_and_rate(policy, count, **arguments)[0]


SIZES = {"position_error_x": 0.1, "position_error_y": 0.1, "heading_error": 0.2, "yaw_rate": 0.2}
SIZES |= {"v_y": 0.02, "reference_yaw_rate": 0.4, "reference_yaw_acceleration": 0.1}


def situations(count, rng):
    """Observations (count, size) in the layout of Terrain-v0, not tilted."""
    values = {name: np.zeros(count) for name in SHOWN.names}
    for name, size in SIZES.items():
        values[name] = size * rng.uniform(-1.0, 1.0, count)
    values["v_x"] = values["reference_speed"] = rng.uniform(0.1, 0.5, count)
    values["sprocket_speed_left"], values["sprocket_speed_right"] = rng.uniform(1, 6, (2, count))
    return values


class WithoutSlopes:
    """A slip model of level ground alone."""

    def __init__(self, model):
        self.slip = model.slip


def with_and_without_slopes():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(slippage_aware, "MODULI", (1.0,))  # the others are not asked for
        known = KnownSlip(FOCCHI)
    return [SlippageAwarePolicy(FOCCHI, 0.02, model) for model in (known, WithoutSlopes(known))]


SAME = {
    "uc": lambda: [UnicyclePolicy(FOCCHI, 0.02, LyapunovGains(), None, names) for names in LAYOUTS],
    "slc": lambda: [
        SlippageAwarePolicy(FOCCHI, 0.02, identified_slip(FOCCHI), LyapunovGains(), None, names)
        for names in LAYOUTS
    ],
    "a slope model where no attitude is shown": with_and_without_slopes,
}


@pytest.mark.parametrize("case", SAME)
def test_on_level_ground_actions_are_those_of_the_planar_policy_to_the_bit(case):
    rng, memory, policies = np.random.default_rng(0), [None, None], SAME[case]()
    for _ in range(20):
        values, actions = situations(16, rng), []
        for k, policy in enumerate(policies):
            fields = SHOWN if policy._view.size > layout.SIZE else layout.V0
            seen = fields.pack({name: values[name] for name in fields.names})
            action, memory[k] = policy.predict(seen, memory[k])
            actions.append(action)
        np.testing.assert_array_equal(*actions)


@pytest.mark.slow
def test_the_slope_table_on_level_ground_gives_nearly_the_planar_actions():
    rng = np.random.default_rng(1)
    seen = SHOWN.pack(situations(200, rng))
    actions = [
        SlippageAwarePolicy(FOCCHI, 0.02, model, observation=SHOWN.names).predict(seen)[0]
        for model in (identified_slip(FOCCHI), identified_slope_slip(FOCCHI))
    ]
    assert np.percentile(np.abs(actions[0] - actions[1]), 95) < 0.01


@pytest.mark.slow
def test_the_error_in_the_vehicles_plane_is_what_the_observation_shows():
    """The group tangent_error is the same quantity."""
    env = environment(8, sensors="ideal", uncertainty="slope", duration=2.0)
    observation, _ = env.reset(seed=70000)
    for _ in range(30):
        observation, *_ = env.step(np.full((8, 2), 0.4, dtype=np.float32))
    view = layout.View(SHOWN.names, (*layout.NAMES, *ATTITUDE))
    seen = view(observation)
    values = SHOWN.unpack(observation)
    attitude = np.stack([values["roll"], values["pitch"]], axis=1)
    assert np.abs(attitude).max() > 0.05
    plane = layout.unpack(in_vehicle_plane(seen, attitude)[:, : layout.SIZE])
    for flat, tangent in (
        ("position_error_x", "tangent_error_x"),
        ("position_error_y", "tangent_error_y"),
        ("heading_error", "tangent_heading_error"),
    ):
        np.testing.assert_allclose(plane[flat], values[tangent], atol=1e-6)
    speed = values["reference_speed"] / np.cos(values["pitch"])
    np.testing.assert_allclose(plane["reference_speed"], speed, rtol=1e-5)


def test_the_attitude_is_filtered_and_a_missing_sample_is_carried_on():
    policy = SlippageAwarePolicy(FOCCHI, 0.02, identified_slip(FOCCHI), observation=SHOWN.names)
    assert policy.predict(SHOWN.pack(situations(2, np.random.default_rng(2))))[0].shape == (2, 2)
    sheet = context().sensors
    gain = steady_gain(sheet.yaw_noise, sheet.gyro_noise, sheet.gyro_bias, 0.02)
    assert 0.0 < gain < 0.5
    wide = np.zeros((1, layout.SIZE + 4), dtype=np.float32)
    wide[0, layout.SIZE :] = np.nan, 0.2, 0.0, 0.5  # roll, pitch, rates over 0.5
    last, none = np.array([[0.1, 0.0]]), np.array([False])
    after = filtered_attitude(wide, last, none, gain, 0.02)
    assert after[0, 0] == 0.1
    assert after[0, 1] == pytest.approx(0.005 + gain * (0.1 - 0.005), rel=1e-5)
    begun = filtered_attitude(wide, last, ~none, gain, 0.02)
    np.testing.assert_allclose(begun, [[0.0, 0.1]], atol=1e-7)


def test_mirrored_situations_on_slopes_give_mirrored_actions():
    rng = np.random.default_rng(3)
    values = situations(50, rng)
    values["roll"], values["pitch"] = rng.uniform(-0.2, 0.2, (2, 50))
    seen = SHOWN.pack(values)
    step = FOCCHI.sprocket_speed_limit / FAMILY_NODES
    coarse = identified_slope_slip(FOCCHI, "nonuniform", step, FAMILY_SLOPE_STEP)
    policy = SlippageAwarePolicy(FOCCHI, 0.02, coarse, observation=SHOWN.names)
    action, mirrored = policy.predict(seen)[0], policy.predict(SHOWN.mirror(seen))[0]
    np.testing.assert_allclose(mirrored[:, ::-1], action, atol=1e-5)


SIDE_SLOPE = {
    "sensors": "ideal",
    "uncertainty": "nominal",
    "duration": 12.0,
    "reference": {"kind": "circle", "radius": 2.0, "speed": 0.3},
    "plant_options": {"terrain": {"kind": "plane", "slope_y": 0.25}},
}


@pytest.mark.slow
def test_on_a_known_slope_the_map_of_slopes_halves_the_error_of_the_planar_map():
    names = ("slc", "slc-flat", "uc")
    sloped, planar, unaware = (rmse(name, 2, **SIDE_SLOPE)[0] for name in names)
    assert sloped < 0.5 * planar < 0.5 * unaware


@pytest.mark.slow
def test_across_a_border_of_friction_on_a_slope_the_adaptive_one_beats_the_planar_map():
    """In nearly every episode (a sign test: p = 0.003), not by a few large ones alone."""
    options = {"uncertainty": "slope-step", "duration": 16.0}
    planar, adaptive = (rmse(name, 12, **options) for name in ("slc-flat", "slc-adaptive"))
    assert (planar > adaptive).sum() >= 11
    assert (planar - adaptive).mean() > 0.02
    assert np.median(adaptive) < 0.7 * np.median(planar)


@pytest.mark.slow
def test_seconds_without_a_pose_leave_the_adaptive_one_as_near_as_nominal_friction():
    outages = {"uncertainty": "slope", "sensors": "mocap-outages", "duration": 20.0}
    assert rmse("slc-adaptive", 8, **outages).mean() < rmse("slc", 8, **outages).mean()


@pytest.mark.slow
def test_the_gains_of_slopes_hold_where_the_attitude_is_shown_and_only_there():
    for names, expected in ((layout.NAMES, LyapunovGains()), (SHOWN.names, GAINS_ON_SLOPES)):
        assert UnicyclePolicy(FOCCHI, 0.02, observation=names).gains == expected
        assert AdaptiveSlipPolicy(FOCCHI, 0.02, DataSheet(), None, names).gains == expected


def test_the_gains_of_slopes_leave_less_than_half_of_the_error_of_the_papers_gains():
    sheet = DataSheet.of(context().sensors)
    options = {"uncertainty": "slope-step", "duration": 12.0}
    (paper, its_rate), (ours, our_rate) = (
        error_and_rate(UnicyclePolicy(FOCCHI, 0.02, gains, sheet, SHOWN.names), 8, **options)
        for gains in (LyapunovGains(), GAINS_ON_SLOPES)
    )
    assert np.median(ours) < 0.5 * np.median(paper)
    assert our_rate.mean() < its_rate.mean() + 0.5


@pytest.mark.slow
def test_slip_that_is_known_on_slopes_costs_little_action_rate():
    """The slip angle jumps with the demanded yaw rate; fed back at once the law oscillates."""
    rates = [
        error_and_rate(POLICIES[name](context()), 12, uncertainty="hills", duration=20.0)[1].mean()
        for name in ("slc-flat", "slc")
    ]
    assert rates[1] < 2.0 * rates[0] < 5.0


@pytest.fixture
def one_modulus(monkeypatch):
    """Slip that is known on slopes is that of the nominal K: each further table takes 5 s."""
    monkeypatch.setattr(slippage_aware, "SLOPE_MODULI", (1.0,))


TABLE = pytest.param("slc", marks=pytest.mark.slow)  # takes 6 s


@pytest.mark.parametrize("name", ["uc", TABLE, "slc-flat", "slc-adaptive", "slc-oracle"])
def test_each_policy_drives_on_hills_with_the_defaults_of_the_environment(name, one_modulus):
    assert np.isfinite(rmse(name, 3, duration=4.0)).all()


def test_friction_that_is_taken_for_less_than_a_slope_needs_is_not_used():
    """Long shear looks like little friction; slip near sliding would be overestimated."""
    slippery = with_friction(FOCCHI, 0.2)
    policy = AdaptiveSlipPolicy(slippery, 0.02, DataSheet(), observation=SHOWN.names)
    values = {name: np.zeros(2) for name in SHOWN.names}
    for name in ("sprocket_speed_left", "sprocket_speed_right"):  # straight on: nothing is learned
        values[name] = np.full(2, 3.0)
    values["pitch"], values["v_x"] = np.array([0.0, 0.3]), np.full(2, 0.25)
    seen, state = SHOWN.pack(values), None
    for _ in range(3):
        _action, state = policy.predict(seen, state)
    np.testing.assert_allclose(policy.estimator.friction, 0.2, rtol=0.03)
    used = policy.slip_model.friction
    assert used[1] == pytest.approx(np.tan(0.3) / 0.5, rel=1e-5)
    assert used[0] == policy.estimator.friction[0]


def test_known_slip_is_that_of_twice_the_friction_that_the_slope_needs_at_least(one_modulus):
    soil_slip = KnownSlip(FOCCHI, slopes=True)
    left, right, grade = np.full(2, 2.0), np.full(2, 4.0), np.array([[0.0, 0.25], [0.0, 0.0]])
    slips = []
    for friction in (0.3, 0.5):
        soil_slip.friction = np.full(2, friction)
        soil_slip.modulus = np.full(2, FOCCHI.shear_deformation_modulus)
        slips.append(np.array(soil_slip.on(grade).slip(left, right)))
    np.testing.assert_array_equal(slips[0][:, 0], slips[1][:, 0])
    assert (np.abs(slips[0] - slips[1])[:, 1] > 1e-4).any()
