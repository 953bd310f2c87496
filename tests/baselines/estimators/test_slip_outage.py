"""Outages of the pose: what the slip observer goes by, what it claims, and how it comes back."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from baselines.estimators import pose_outages
from baselines.estimators import soil_regression as sr
from baselines.estimators.measurement import COLUMN, DataSheet
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.stack import IdentificationStack
from baselines.registry import adaptive, oracle
from tests.baselines.episodes import context
from tests.baselines.estimators.motion_cases import state
from tests.baselines.estimators.slip_cases import PARAMETERS, PERIOD, RTK, weaving
from tests.baselines.estimators.slip_cases import simulate as slipping
from tracked_env import arrays as b
from tracked_env.benchmark import BenchmarkConfig, metrics
from tracked_env.benchmark.runner import drive
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.parameters import plant_parameters
from tracked_env.sensors import UNMEASURED, make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

SEED = 70_500
STEPS, COUNT = 1500, 16
BEGIN, END = 400, 700  # [steps] of the outage of simulated kinematics
_RADIUS = PARAMETERS.sprocket_radius


def blind(measurements, begin=BEGIN, end=END):
    """The same without new poses from `begin` to `end`."""
    for k, m in enumerate(measurements):
        if begin <= k < end:
            m.fresh[:, 0] = False
            m.values[:, :5] = measurements[begin - 1].values[:, :5]
            m.age[:, 0] = (k - begin + 1) * PERIOD
    return measurements


def accelerated(run, rng=None, sheet=RTK, bias=0.0):
    """Accelerometers into the measurements of a kinematic run, from its velocities."""
    v, w = run.velocity[..., :2], run.velocity[..., 2]
    rate = np.gradient(v, PERIOD, axis=0)
    noise = np.zeros((*w.shape, 2)) if rng is None else rng.standard_normal((*w.shape, 2))
    for k, m in enumerate(run.measurements):
        sigma = sheet.acceleration_noise
        m.values[:, COLUMN["acceleration_x"]] = rate[k, :, 0] - w[k] * v[k, :, 1] + bias
        m.values[:, COLUMN["acceleration_y"]] = rate[k, :, 1] + w[k] * v[k, :, 0]
        m.values[:, COLUMN["acceleration_x"] : COLUMN["yaw_rate"]] += sigma * noise[k]
    return run


@cache
def episodes(factory, uncertainty):
    """Episodes with outages: what the observer claims and errs, (steps, N, ..) by name."""
    env = TrackedVehicleVectorEnv(
        COUNT, uncertainty=uncertainty, sensors="rtk-outages", duration=STEPS * PERIOD,
        expose_truth=True, autoreset_mode="Disabled",
    )  # fmt: skip
    policy = factory(context(make_sensors("rtk-outages")))
    observation, info = env.reset(seed=SEED)
    arrays, state = env.simulation.batch, None
    rows = {name: [] for name in ("error", "sigma", "nees", "missing", "action")}
    for k in range(STEPS):
        if getattr(policy, "needs_truth", False):
            policy.observe_truth(info["truth"])
        true = np.stack([arrays.column(n) for n in ("x", "y", "yaw")], axis=1)
        path = np.stack([arrays.column(f"reference_{n}") for n in ("x", "y", "yaw")], axis=1)
        missing = arrays.counters[:, b.STEP] < arrays.counters[:, b.OUTAGE_UNTIL]
        action, state = policy.predict(observation, state)
        known = getattr(policy, "_policy", policy).identification
        error = (known.slip.value[:, :3] - known.reading.reference) - (true - path)
        error[:, 2] = (error[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        p = known.slip.covariance[:, :3, :3]
        sigma = np.sqrt(np.diagonal(p, axis1=1, axis2=2))
        nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(p), error) / 3.0
        step = error, sigma, nees, missing & (k >= 100), action
        for name, values in zip(rows, step, strict=True):
            rows[name].append(values)
        observation, *_, info = env.step(action)
    return SimpleNamespace(**{name: np.array(values) for name, values in rows.items()})


SETS = ("soil-and-mass", "weak-soil", "alternating-soils")


@pytest.mark.parametrize("uncertainty", SETS)
def test_in_an_outage_the_claimed_covariance_of_the_pose_is_true(uncertainty):
    run = episodes(adaptive, uncertainty)
    assert run.missing.mean() > 0.3
    assert run.nees[run.missing].mean() < 2.0
    inside = np.abs(run.error) <= 3.0 * run.sigma
    assert (inside[run.missing].mean(axis=0) >= 0.97).all()
    # and it is not padded: claims are of the size of the errors
    claimed, rms = (np.sqrt((x[run.missing][:, :2] ** 2).mean()) for x in (run.sigma, run.error))
    assert claimed < 4.0 * rms
    assert rms < 0.06  # [m]; 0.3 by random walks


def test_who_knows_the_soil_errs_less_where_slip_is_large():
    ours, known = (episodes(factory, "weak-soil") for factory in (adaptive, oracle))
    along = [np.median((r.error[..., :2] ** 2).sum(axis=2)[r.missing]) for r in (ours, known)]
    assert along[1] < along[0]
    assert known.sigma[known.missing][:, 0].mean() < ours.sigma[ours.missing][:, 0].mean()


@pytest.mark.parametrize("uncertainty", SETS)
def test_the_first_pose_after_an_outage_makes_no_jump_of_the_action(uncertainty):
    run = episodes(adaptive, uncertainty)
    change = np.abs(np.diff(run.action, axis=0)).max(axis=2)
    returned = run.missing[:-1] & ~run.missing[1:]
    assert returned.sum() > 10
    assert change[returned].max() < 0.05  # [-] of the torque limit; 1 without blending


def test_effort_and_known_soil_hold_the_speed_where_the_accelerometer_is_missing():
    """Slip 0.2 on both tracks by S (7); before the outage the filter has seen a slip of 0.1."""
    sheet = DataSheet(*[0.0] * 7, 1.0, 0.0, 0.0)
    belts = np.full((END, 1, 2), 2.0)
    slips = np.where(np.arange(END)[:, None, None] < BEGIN, 0.1, 0.2)
    run = slipping(belts, slips, 0.0, sheet)
    maximum, modulus = 8000.0, 0.02
    length = PARAMETERS.contact_length / modulus
    for k, m in enumerate(blind(run.measurements)):
        effort = soil.tractive_effort(float(slips[k, 0, 0]), maximum, length)
        for side in ("left", "right"):
            m.values[:, COLUMN[f"torque_{side}"]] = effort * _RADIUS
    errors = []
    for known in (True, False):
        observer = SlipObserver(PARAMETERS, PERIOD, sheet)
        for m in run.measurements:
            if known:
                ground = np.array([[maximum, modulus]])
                observer.take_ground(ground, np.zeros((1, 2, 2)), np.array([0.6]))
            answer = observer.update(m)
        errors.append(float(run.state[-1, 0, 0] - answer.value[0, 0]))
    assert abs(errors[0]) < 0.1  # of 9.6 m; most of it in the first 0.25 s and until v has settled
    assert errors[1] == pytest.approx(-0.1 * 2.0 * (END - BEGIN) * PERIOD, rel=0.05)


def test_the_inertial_speed_carries_slips_that_change_unseen_and_its_bias_is_learned():
    rng, bias = np.random.default_rng(3), 0.02
    belts = weaving(END + 1, 4)
    slips = np.full((END + 1, 4, 2), 0.05)
    slips[BEGIN + 20 :] = 0.3  # another soil
    slips[BEGIN + 20 : BEGIN + 60] = np.linspace(0.05, 0.3, 40)[:, None, None]
    run = accelerated(slipping(belts, slips, 0.0), rng, bias=bias)
    observer = SlipObserver(PARAMETERS, PERIOD, RTK, 4)
    for m in blind(run.measurements)[:END]:
        answer = observer.update(m)
    way = np.linalg.norm(run.state[END - 1, :, :2] - answer.value[:, :2], axis=1)
    assert way.max() < 0.15  # [m]; 2.5 m by the slips of before
    assert np.allclose(answer.value[:, 3:5], 0.3, atol=0.03)
    learned = observer.rows["speed"][:, pose_outages.BIAS]
    assert np.allclose(learned, bias, atol=0.01)


def test_the_gyro_holds_the_heading_and_its_bias_is_learned():
    rng, bias = np.random.default_rng(4), 0.01
    run = accelerated(slipping(weaving(END, 4), 0.05, 0.0), rng)
    for m in run.measurements:
        m.values[:, COLUMN["yaw_rate"]] += bias
    sheet = RTK._replace(gyro_bias=bias)
    observer = SlipObserver(PARAMETERS, PERIOD, sheet, 4)
    for m in blind(run.measurements):
        answer = observer.update(m)
    learned = observer.rows["heading"][:, pose_outages.BIAS]
    assert np.allclose(learned, bias, atol=0.0015)
    assert np.abs(run.state[END - 1, :, 2] - answer.value[:, 2]).max() < 0.02  # 0.06 by the bias


def test_the_heading_of_an_outage_begins_where_the_gyro_has_turned_to():
    """Exact sensors, on a circle of 0.4 rad/s: one step of the turn is 8 mrad."""
    sheet = DataSheet(*[0.0] * len(DataSheet._fields))
    belts = np.tile([1.0, 2.0], (END, 1, 1))
    run = accelerated(slipping(belts, 0.05, 0.0, sheet), sheet=sheet)
    assert run.velocity[BEGIN, 0, 2] * PERIOD > 0.007
    observer, errors = SlipObserver(PARAMETERS, PERIOD, sheet), []
    for k, m in enumerate(blind(run.measurements)):
        errors.append(observer.update(m).value[0, 2] - run.state[k, 0, 2])
    assert np.abs(errors[BEGIN - 50 :]).max() < 1e-3  # [rad]


def test_a_belt_that_stands_while_the_track_slides_does_not_stop_the_vehicle():
    belts = np.full((END, 1, 2), 2.0)
    run = accelerated(slipping(belts, 0.0, 0.0))
    for m in blind(run.measurements)[BEGIN + 30 :]:  # the left track is locked and slides on
        m.values[:, COLUMN["sprocket_speed_left"]] = 0.0
    observer = SlipObserver(PARAMETERS, PERIOD, RTK)
    for m in run.measurements:
        answer = observer.update(m)
    assert abs(run.state[-1, 0, 0] - answer.value[0, 0]) < 0.1


def test_without_a_velocity_sensor_the_bias_is_learned_from_the_speed_of_the_filter():
    """Else the inertial speed that carries the outage is wrong by 30 s of the bias: 0.6 m."""
    assert pose_outages.UNMEASURED == UNMEASURED
    errors, worst = {}, {}
    for chosen in ("outages", "outages-no-velocity"):
        config = BenchmarkConfig(sets=(chosen,))
        env = config.environment(chosen, 16, False)
        trace, _time = drive(adaptive(config.context(chosen)), env, range(72000, 72016), int)
        env.close()
        found = np.sort(metrics.evaluate(trace)["tracking_rmse"])
        errors[chosen], worst[chosen] = found[4:12].mean(), found[-2]
    assert errors["outages-no-velocity"] < 1.3 * errors["outages"] < 0.06
    assert worst["outages-no-velocity"] < 0.5


def test_a_pose_that_is_only_late_or_rare_is_no_outage():
    """Within 0.25 s nothing but the random walk: same numbers with and without accelerometers."""
    plain, more = (slipping(weaving(300), 0.1, 0.03, delay=10) for _ in range(2))
    accelerated(more, bias=0.5)
    one, other = (SlipObserver(PARAMETERS, PERIOD, RTK) for _ in range(2))
    for k, (a, c) in enumerate(zip(plain.measurements, more.measurements, strict=True)):
        a.fresh[:, 0] = c.fresh[:, 0] = k % 12 == 0
        ours, theirs = one.update(a), other.update(c)
        assert np.array_equal(ours.value, theirs.value)
        assert np.array_equal(ours.covariance, theirs.covariance)


def test_the_soil_learns_nothing_from_slips_that_it_has_predicted_itself():
    observer = SlipObserver(PARAMETERS, PERIOD, RTK, 2)
    run = slipping(weaving(END, 2), 0.1, 0.0)
    for k, m in enumerate(blind(run.measurements)):
        observer.update(m)
        silent = k >= BEGIN + 12  # 0.25 s
        assert np.isinf(observer.slip_variances).all() == silent
    stack = IdentificationStack(plant_parameters(), PERIOD)
    stack.soil.provide_slip(np.full((1, 2), 0.1), np.full((1, 2), np.inf))
    before = state(stack.soil)
    m.values[:, COLUMN["torque_left"]] = m.values[:, COLUMN["torque_right"]] = 2000.0
    stack.soil.update(type(m)(m.values[:1], m.fresh[:1], m.age[:1]))
    learned = np.arange(before.shape[1]) != list(sr.ROW.fields).index("clock")
    assert np.array_equal(state(stack.soil)[:, learned], before[:, learned])


def _jumping(pose_at=(0,), steps=60):
    """A vehicle at 1.5 m/s whose belts spin at 6 m/s from step 1 on; poses at these steps."""
    belts = np.full((steps, 1, 2), 6.0)
    belts[0] = 1.5
    run = accelerated(slipping(belts, np.where(belts > 2.0, 0.75, 0.0), 0.0))
    for k, m in enumerate(run.measurements):
        m.values[:, COLUMN["acceleration_x"] : COLUMN["yaw_rate"]] = 0.0
        m.fresh[:, 0] = k in pose_at
        m.age[:, 0] = (k - max(at for at in pose_at if at <= k)) * PERIOD
    return run


def test_a_belt_that_jumps_does_not_take_the_inertial_speed_along():
    """The slip is that of the new belt; with the belt of before it would make 0.4 m/s."""
    observer = SlipObserver(PARAMETERS, PERIOD, RTK)
    for k, m in enumerate(_jumping().measurements):
        observer.update(m)
        assert observer.motion().v_x[0] == pytest.approx(1.5, abs=0.15)
        assert k == 0 or observer.rows["speed"][0, 0] == pytest.approx(1.5, abs=0.15)


def test_the_first_pose_after_an_outage_counts_once():
    """Wrong by 0.3 m/s and 0.06 rad before; counted twice, as wrong to the other side."""
    run = accelerated(slipping(np.full((END + 1, 1, 2), 2.0), 0.1, 0.0), bias=0.0)
    for m in blind(run.measurements)[BEGIN:END]:
        m.values[:, COLUMN["acceleration_x"]] += 0.05
        m.values[:, COLUMN["yaw_rate"]] += 0.01
    observer = SlipObserver(PARAMETERS, PERIOD, RTK)
    for m in run.measurements:
        observer.update(m)
    filtered = observer.motion().v_x[0] - observer.rows["gap"][0, 3]
    assert observer.rows["speed"][0, 0] == pytest.approx(filtered, abs=1e-9)
    assert 1.7 < filtered < 2.0  # of 1.8 and 2.1
    assert observer.rows["heading"][0, 0] == pytest.approx(0.0, abs=0.02)


def test_slips_with_one_pose_a_second_are_within_their_claim():
    rng, count, steps = np.random.default_rng(5), 32, 900
    belts = weaving(steps, count)
    time = PERIOD * np.arange(steps)[:, None, None]
    slips = 0.15 + 0.1 * np.sin(1.5 * time + np.arange(count)[:, None])
    run = accelerated(slipping(belts, np.broadcast_to(slips, belts.shape), 0.0), rng)
    observer, inside, squared = SlipObserver(PARAMETERS, PERIOD, RTK, count), [], []
    for k, m in enumerate(run.measurements):
        m.fresh[:, 0] = k % 50 == 0
        m.age[:, 0] = k % 50 * PERIOD
        answer = observer.update(m)
        if k % 50 >= 13 and k > 200:  # in between slips are taken to walk
            error = answer.value[:, 3:5] - run.state[k, :, 3:5]
            variance = np.diagonal(answer.covariance, axis1=1, axis2=2)[:, 3:5]
            squared.append(error**2 / variance)
            inside.append(np.abs(error) <= 3.0 * np.sqrt(variance))
    assert np.mean(inside) >= 0.97
    assert np.mean(squared) < 3.0
