"""The predictive controllers: one call, bounds, symmetry, what they see, and in closed loop."""

from functools import cache

import numpy as np
import pytest

from baselines.lyapunov.lyapunov_laws import LyapunovGains
from baselines.lyapunov.pose_filter import ATTITUDE
from baselines.predictive.predictive_control import PredictiveController
from baselines.predictive.stages import TIMES, PredictiveSettings, interpolation, shift
from baselines.predictive.tracked_prediction import SPEED as FORWARD
from baselines.predictive.tracked_prediction import YAW, side_velocity
from baselines.registry import BY_DRIVE, POLICIES, PREDICTIVE
from tests.baselines.episodes import FAILED, context, interquartile_mean, run
from tests.baselines.predictive.predictive_cases import Problem, model, observed
from tracked_env import SPEED
from tracked_env import observation as layout
from tracked_env.benchmark import BenchmarkConfig, PolicyContext
from tracked_env.benchmark.policy_interface import needs_truth
from tracked_env.benchmark.runner import steps_of
from tracked_env.observation import V0
from tracked_env.physics.lumped import drive_limits
from tracked_env.physics.parameters import VEHICLES, plant_parameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.sensors import PRESETS
from tracked_env.vector_env import TrackedVehicleVectorEnv
from tracked_env.vehicles import find_vehicle

ERRORS = {"position_error_x": 0.1, "position_error_y": -0.2, "heading_error": 0.15}


def controller(**settings):
    return PredictiveController(plant_parameters(), settings=PredictiveSettings(**settings))


def act(controller, observation, plans=None):
    count = len(observation)
    return controller.act(observation, plans, np.full(count, plans is None), np.zeros((count, 2)))


@pytest.mark.parametrize("path", [(2.0, 0.0), (2.0, 0.3), (0.5, -0.6), (-1.5, 0.2), (0.0, 0.0)])
def test_a_reference_that_the_model_can_follow_costs_nothing(path):
    problem = Problem(observed(*path))
    drift = problem.work.ahead.path[0, 2:4]  # it drifts along its path
    problem.work.states[0, YAW : FORWARD + 1] = drift
    assert problem.cost(problem.inputs) < 1e-6  # float32 of the observation
    assert problem.step() < 1e-4


FAR = {"position_error_y": 1.5, "heading_error": 1.0}  # a whole first step would cost more


@pytest.mark.parametrize("errors", [ERRORS, FAR], ids=["near", "far"])
def test_plans_cost_less_with_every_step(errors):
    problem = Problem(observed(**errors))
    costs = []
    for _ in range(8):
        costs.append(problem.cost(problem.inputs))
        problem.step()
    assert (np.diff(costs) <= 0.0).all()
    assert costs[-1] < 0.5 * costs[0]


def test_a_plan_is_carried_on_by_the_share_of_a_stage_that_has_passed():
    mpc = controller()
    observation = observed()
    _, plans = act(mpc, observation)
    observation[:] = observed(v_x=2.0)
    for _ in range(3):  # of an exact reference the plan stays what it is
        _, after = act(mpc, observation, plans)
        assert np.abs(after[:, :-1] - plans[:, :-1]).max() < 0.05
        plans = after
    before = np.cumsum(np.arange(30.0))[:, None] * np.ones((30, 2)) / 1e3
    shifted = before.copy()
    shift(shifted, 0.5)
    np.testing.assert_allclose(shifted[:-1], 0.5 * (before[1:] + before[:-1]))
    np.testing.assert_array_equal(shifted[-1], before[-1])


def test_mirrored_paths_have_mirrored_actions():
    mirrored = {**ERRORS, "position_error_y": 0.2, "heading_error": -0.15}
    one, plan = act(controller(), observed(1.5, 0.4, turn=0.2, **ERRORS))
    other, mirror = act(controller(), observed(1.5, -0.4, turn=-0.2, **mirrored))
    np.testing.assert_allclose(other[0, ::-1], one[0], atol=1e-6)
    np.testing.assert_allclose(mirror[0, :, ::-1], plan[0], atol=1e-6)


def test_reversed_paths_are_driven_as_forward_ones_are_looked_at_from_behind():
    forward, _ = act(controller(), observed(1.5, 0.2, position_error_x=0.1))
    backward, _ = act(controller(), observed(-1.5, 0.2, position_error_x=-0.1))
    np.testing.assert_allclose(backward[0], -forward[0, ::-1], atol=1e-6)
    reverse, _ = act(controller(), observed(-1.5, 0.2, v_x=-1.5))
    turned, _ = act(controller(), observed(1.5, 0.2, v_x=-1.5, heading_error=np.pi))
    np.testing.assert_allclose(turned, reverse, atol=1e-5)


def test_whatever_is_observed_the_action_is_bounded():
    rng = np.random.default_rng(3)
    wild = rng.uniform(-1.0, 1.0, (200, layout.SIZE)) * layout.HIGH
    plans = None
    mpc = controller()
    for _ in range(3):
        action, plans = act(mpc, wild.astype(np.float32), plans)
        assert np.isfinite(plans).all()
        assert (np.abs(action) <= 1.0).all()


def test_commands_stay_below_what_the_soil_carries():
    mpc, p = controller(), plant_parameters()._replace(cohesion=2000.0, friction_angle=0.2)
    mpc.parameters[:] = np.array(p)[:, None]
    carried = (
        PredictiveSettings().traction
        * drive_limits(p).effort_limit
        / (p.torque_limit / p.sprocket_radius)
    )
    assert carried < 0.5
    action, plans = act(mpc, observed(2.0, 0.0, v_x=0.0, position_error_x=2.0))
    assert np.abs(plans).max() == pytest.approx(carried)
    assert np.abs(action).max() <= carried + 1e-6


UNSEEN = observed(count=2)
UNSEEN[1, layout.INDEX["v_x"]] = np.nan


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: act(controller(), UNSEEN), r"observation\[1\]: v_x = nan"),
        (lambda: controller(effort=0.0), "effort = 0; must be positive"),
        (lambda: controller(stages=60.0), "at most 2 s"),
        (lambda: controller(stages=30.5), "whole number"),
        (lambda: POLICIES["mpc-adaptive"](context(), effort_of_all=7.0), "effort_of_all"),
    ],
)
def test_what_makes_no_sense_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_the_reference_between_the_shown_times_is_that_of_a_parabola():
    times = np.linspace(0.0, 2.0, 41)
    curve = lambda t: 1.0 + 0.7 * t - 0.2 * t * t  # noqa: E731
    shown = np.array([*(curve(t) for t in TIMES), 0.7])
    result = interpolation(times) @ shown
    np.testing.assert_allclose(result[times <= 1.0], curve(times[times <= 1.0]), atol=1e-12)
    assert np.abs(result - curve(times)).max() < 0.05  # the last slope is the chord's


def test_a_slow_drive_is_commanded_earlier():
    """The model knows the lag: to the same error it answers with a larger command."""
    action = {}
    for lag in (0.05, 0.3):
        slow = model(drive_time_constant=lag)
        problem = Problem(observed(position_error_x=0.1), prediction=slow, effort=3.0)
        for _ in range(10):
            problem.step()
        action[lag] = problem.inputs[0].sum() - problem.work.ahead.efforts[0].sum()
    assert action[0.3] > 1.05 * action[0.05] > 0.0


INDOORS = PolicyContext(0.02, "sliding", PRESETS["mocap"], "speed", VEHICLES["focchi"])
SEED = 50_000  # of a split on which nothing is published


@cache
def by_torque(name, uncertainty="soil-and-mass", **options):
    return run(POLICIES[name](context()), uncertainty, 48, seed=SEED, **options)


@cache
def by_speed(name, uncertainty="friction", gains=None):
    options = {key: SPEED[key] for key in ("vehicle", "plant", "drive", "error_limit", "reference")}
    policy = POLICIES[name](INDOORS, **(gains._asdict() if gains else {}))
    return run(policy, uncertainty, 12, sensors="mocap", seed=SEED, **options)


@pytest.mark.parametrize("uncertainty", ["soil-and-mass", "slow-drive"])
def test_it_tracks_closer_than_feedback_linearization_on_the_same_estimates(uncertainty):
    """By 13 to 14 per cent, after the start by 9 to 17, with gains of both that are tuned."""
    mine, other = (by_torque(name, uncertainty) for name in ("mpc-adaptive", "adaptive"))
    assert interquartile_mean(mine.rmse) < 0.95 * interquartile_mean(other.rmse)
    assert np.median(mine.settled) < np.median(other.settled)
    assert (mine.rmse < FAILED).all()


@pytest.mark.slow
def test_its_parameters_matter():
    mine, oracle, wrong = (by_torque(f"mpc-{name}") for name in ("adaptive", "oracle", "nominal"))
    assert np.median(wrong.settled) > 3.0 * np.median(mine.settled)
    assert interquartile_mean(mine.rmse) < 1.15 * interquartile_mean(oracle.rmse)


def test_it_stays_on_the_path_with_a_second_between_poses_and_backwards():
    assert not by_torque("mpc-adaptive", sensors="rtk-outages").over.any()
    backwards = {"kind": "circle", "radius": 10.0, "speed": -1.5}
    mine = run(POLICIES["mpc-adaptive"](context()), "nominal", 8, reference=backwards, seed=SEED)
    assert np.median(mine.settled) < 0.03


@pytest.mark.parametrize(
    "uncertainty", ["friction", pytest.param("floor-ood", marks=pytest.mark.slow)]
)
def test_by_sprocket_speeds_it_tracks_closer_than_the_law_with_the_gains_of_the_paper(uncertainty):
    mine, tuned = (by_speed(name, uncertainty) for name in ("mpc-adaptive", "slc-adaptive"))
    paper = by_speed("slc-adaptive", uncertainty, LyapunovGains())
    assert interquartile_mean(mine.rmse) < 0.8 * interquartile_mean(paper.rmse)
    assert np.median(mine.settled) < 0.6 * np.median(paper.settled)
    assert interquartile_mean(mine.rmse) < 1.1 * interquartile_mean(tuned.rmse)  # level with it


@pytest.mark.slow
def test_by_sprocket_speeds_knowledge_of_the_slip_matters():
    mine, oracle, wrong = (by_speed(f"mpc-{name}") for name in ("adaptive", "oracle", "nominal"))
    assert np.median(wrong.settled) > 1.5 * np.median(mine.settled)
    assert np.median(mine.settled) < 1.5 * np.median(oracle.settled)


@pytest.mark.parametrize("name", PREDICTIVE)
def test_each_is_of_either_drive_only_the_oracle_reads_the_truth_and_none_predicts_all(name):
    for place in (context(), INDOORS):
        assert name in BY_DRIVE[place.drive]
        policy = POLICIES[name](place, effort=7.0)
        assert needs_truth(policy) == (name == "mpc-oracle")
        if place.drive == "torque":
            assert policy.controller.settings.effort == 7.0
    with pytest.raises(ValueError, match=r"lateral = 'constrained'; model predictive control"):
        POLICIES[name](context(lateral="constrained"))
    slopes = (*V0.names, *ATTITUDE)
    with pytest.raises(ValueError, match="predicts level ground alone"):
        POLICIES[name](INDOORS._replace(observation=slopes))


@pytest.mark.parametrize("name", PREDICTIVE)
@pytest.mark.parametrize("group", ["look_ahead", "action"])
def test_an_observation_without_what_it_needs_is_refused_by_the_group(name, group):
    part = "ahead_" if group == "look_ahead" else "previous"
    fields = tuple(n for n in V0.names if part not in n)
    for place in (context(), INDOORS) if group == "look_ahead" else (context(),):
        with pytest.raises(ValueError, match=group):
            POLICIES[name](place._replace(observation=fields))


def settled_errors(env, context, seeds):
    """RMSE of the distance to the reference after 5 s [m], of every vehicle; closes env."""
    policy, column, away = POLICIES["mpc-adaptive"](context), env.simulation.batch.column, []
    for _ in steps_of(policy, env, seeds):
        distance = column("reference_x") - column("x"), column("reference_y") - column("y")
        away.append(np.hypot(*distance))
    env.close()
    return np.sqrt(np.mean(np.square(away[250:]), axis=0))


def test_a_long_vehicle_with_weak_drives_does_not_swing_about_its_path():
    """5.3 m, 21 t, 0.8 m beside the path at first: with a horizon of 1.2 s it whirls, 2 m away."""
    config = BenchmarkConfig(("vehicles",), 92, seed=50_000)
    env = config.environment("vehicles", 1, truth=False, episode=88)
    context = config.context("vehicles", 88)
    assert context.vehicle.contact_length > 5.0
    assert settled_errors(env, context, [config.first_seed("vehicles") + 88])[0] < 0.3


def test_the_way_back_begins_with_a_shift_outwards_over_a_share_of_the_length():
    """On uniform friction mu g a turn needs v w = mu g d / (l / 2), d the shift of its centre ahead
    of the middle, and v_y = -w d; so dv_y / dw = -l v w / (mu g), a share of l."""
    p = plant_parameters()
    for share in (0.2, 0.4, 0.6):
        grip, speed = p.lateral_resistance * GRAVITY, 3.0
        turn, small = share * grip / speed, 1e-4
        now, tighter = (side_velocity(speed, w, model()) for w in (turn, turn + small))
        assert (tighter - now) / small == pytest.approx(-share * p.contact_length, rel=0.02)


@pytest.mark.parametrize("name", ["tracked-tractor", "infantry-fighting-vehicle"])
def test_heavy_vehicles_do_not_whirl_on_a_fast_eight(name):
    """Whose place counts as much against the heading as for 2 m turns tighter to come back: 2 of 4
    of these were lost, or off by their length."""
    env = TrackedVehicleVectorEnv(
        4, vehicle=name, uncertainty="any-soil", reference="figure_eight", sensors="rtk",
        error_limit=100.0, duration=20.0, autoreset_mode="Disabled",
    )  # fmt: skip
    sensors = env.simulation.settings.sensors
    at = PolicyContext(0.02, "sliding", sensors=sensors, vehicle=find_vehicle(name))
    assert settled_errors(env, at, [51_000, 51_001, 51_002, 51_003]).max() < 0.05
