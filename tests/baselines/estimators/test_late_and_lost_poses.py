"""Poses that come late or not at all: what the filter goes by and claims, how it comes back."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from baselines.estimators import motion_filter, pose_outages
from baselines.estimators import soil_regression as sr
from baselines.estimators.measurement import COLUMN, INERTIAL, DataSheet, columns_of, rows_of
from baselines.estimators.motion_filter import MotionFilter
from baselines.estimators.observation_reader import FIRST, ObservationReader
from baselines.estimators.pose_outages import BIAS
from baselines.estimators.slip_kinematics import ROW
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.stack import IdentificationStack
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.registry import POLICIES, adaptive, oracle
from tests.baselines.episodes import context
from tests.baselines.estimators.motion_cases import state
from tests.baselines.estimators.slip_cases import PARAMETERS, PERIOD, RTK, weaving
from tests.baselines.estimators.slip_cases import simulate as slipping
from tracked_env import arrays as b
from tracked_env.benchmark import BenchmarkConfig, metrics
from tracked_env.benchmark.runner import drive
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.parameters import VEHICLES, plant_parameters
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


def tracking(factory, chosen):
    """RMSE [m] of 16 episodes of an evaluation set, in ascending order."""
    config = BenchmarkConfig(sets=(chosen,))
    env = config.environment(chosen, 16, False)
    trace, _time = drive(factory(config.context(chosen)), env, range(72000, 72016), int)
    env.close()
    return np.sort(metrics.evaluate(trace)["tracking_rmse"])


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
    with_it, without = (tracking(adaptive, name) for name in ("outages", "outages-no-velocity"))
    assert without[4:12].mean() < 1.3 * with_it[4:12].mean() < 0.06
    assert without[-2] < 0.5


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
        assert np.isinf(observer.slips_and_variances()[1]).all() == silent
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


LAG = 10  # [steps]
CLAY = VEHICLES["strawa"]
LATE = {"preset": "ideal", "pose_delay": LAG * PERIOD}


def observations(sensors, steps, count=3):
    """What the same vehicles under the same commands show with these sensors, (steps, N, D)."""
    env = TrackedVehicleVectorEnv(
        count, uncertainty="weak-soil", sensors=sensors, error_limit=1e3, duration=60.0
    )
    rng = np.random.default_rng(1)
    rows = [env.reset(seed=71000)[0]]
    action = np.zeros((count, 2))
    for _ in range(steps - 1):
        action = np.clip(action + rng.uniform(-0.1, 0.11, (count, 2)), -0.3, 0.6)
        rows.append(env.step(action.astype(np.float32))[0])
    return np.array(rows)


def test_the_filter_of_a_late_pose_knows_what_that_of_a_pose_in_time_knew():
    sheets = [DataSheet.of(make_sensors(sensors)) for sensors in ("ideal", LATE)]
    stacks = [IdentificationStack(CLAY, PERIOD, sheet, 3) for sheet in sheets]
    drives = [observations(sensors, 150) for sensors in ("ideal", LATE)]
    estimates = []
    for stack, rows in zip(stacks, drives, strict=True):
        answers = [stack.update(observation).parts.answers for observation in rows]
        estimates.append([[a[name]["value"] for name in ("slip", "soil")] for a in answers])
    for n in range(LAG, 150):
        for in_time, late in zip(estimates[0][n - LAG], estimates[1][n], strict=True):
            np.testing.assert_allclose(late, in_time, rtol=2e-4, atol=2e-5)
    slips = np.array([one[0][:, 3:5] for one in estimates[0]])
    assert np.ptp(slips, axis=0).max() > 0.2  # or there was nothing to know


def test_slips_of_a_late_pose_are_those_of_now():
    """The stack with a pose in time is the truth: sensors are ideal. Slips change by 0.2."""
    sheets = [DataSheet.of(make_sensors(sensors)) for sensors in ("ideal", LATE)]
    stacks = [IdentificationStack(CLAY, PERIOD, sheet, 3) for sheet in sheets]
    in_time, late = observations("ideal", 150), observations(LATE, 150)
    errors, old = [], []
    for n, (one, other) in enumerate(zip(in_time, late, strict=True)):
        truth = stacks[0].update(one).slip.value[:, 3:5].copy()
        estimates = stacks[1].update(other)
        if n > 2 * LAG:
            errors.append(estimates.slip.value[:, 3:5] - truth)
            old.append(estimates.parts.answers["slip"]["value"][:, 3:5] - truth)
    for share in (0.5, 0.8, 0.9):
        assert np.quantile(np.abs(errors), share) < 0.25 * np.quantile(np.abs(old), share)


def test_until_the_first_late_pose_what_is_shown_is_the_first_pose_and_the_way_since():
    motions = MotionFilter(CLAY, PERIOD, DataSheet.of(make_sensors(LATE)), 3)
    in_time, start = observations("ideal", LAG + 1), np.array([True] * 3)
    truth = MotionFilter(CLAY, PERIOD, DataSheet.of(make_sensors("ideal")), 3)
    for late, now in zip(observations(LATE, LAG + 1), in_time, strict=True):
        shown, right = motions.update(late, start).rows, truth.update(now, start).rows
        np.testing.assert_allclose(shown[:, :3], right[:, :3], atol=0.01)
        start = np.zeros(3, dtype=bool)


def filters(bias):
    """A row of the slip observer with these biases of accelerometer and gyro."""
    rows = rows_of(np.zeros((1, columns_of(ROW))), ROW)
    rows["speed"][:, BIAS] = rows["heading"][:, BIAS] = bias
    return rows


def carried(motion, inertial, last=LAG, bias=0.0):
    """A motion LAG steps later, by inertial(t) = (a_x, w, dw/dt) up to the step `last`."""
    reader = ObservationReader(PERIOD, 1, LAG * PERIOD)
    reader.rows["step"] = LAG + 1  # steps 0 to LAG have been read
    names = ("acceleration_x", "yaw_rate", "yaw_acceleration")
    places = [COLUMN[name] - FIRST[INERTIAL] for name in names]
    for step in range(last + 1):
        slot = reader.rings[0, 0, step : step + 1]
        slot["taken"] = step + 1.0
        slot["values"][0][places] = np.add(inertial(step * PERIOD), (bias, bias, 0.0))
    motion, level = np.array([motion]), np.zeros((1, 3))
    steps = np.array([LAG])
    motion_filter.carry(motion, reader.rows, reader.rings, PERIOD, steps, filters(bias), level)
    return motion[0]


@pytest.mark.parametrize("bias", [0.0, 0.3])
def test_the_way_since_is_that_of_the_equations_of_motion(bias):
    """Against solve_ivp: x' = v c - v_y s, y' = v s + v_y c, psi' = w, v' = f + w v_y."""

    def inertial(t):
        return 1.5 * np.cos(9.0 * t), 0.8 * np.sin(7.0 * t) - 0.3, 0.0

    x, y, yaw, v, v_y = 3.0, -2.0, 0.7, 1.2, 0.1

    def rates(t, s):
        f, w, _ = inertial(t)
        c, sine = np.cos(s[2]), np.sin(s[2])
        return [s[3] * c - v_y * sine, s[3] * sine + v_y * c, w, f + w * v_y]

    exact = solve_ivp(rates, (0.0, LAG * PERIOD), [x, y, yaw, v], rtol=1e-10).y[:, -1]
    motion = carried([x, y, yaw, v, v_y, inertial(0.0)[1]], inertial, bias=bias)
    np.testing.assert_allclose(motion[:4], exact, atol=1e-3)
    assert motion[5] == pytest.approx(inertial(LAG * PERIOD)[1])
    assert np.hypot(*(exact[:2] - (x, y))) > 0.2 and abs(exact[2] - yaw) > 0.02


def test_beyond_the_last_inertial_sample_its_accelerations_go_on():
    motions = [
        carried([3.0, -2.0, 0.7, 1.2, 0.1, 0.2], lambda t: (0.7, 0.2 + 1.1 * t, 1.1), last)
        for last in (LAG, LAG - 5)
    ]
    np.testing.assert_allclose(motions[1], motions[0], rtol=1e-12)


@pytest.mark.parametrize("name", ["adaptive", pytest.param("mpc-adaptive", marks=pytest.mark.slow)])
def test_a_late_pose_on_weak_soil_costs_little(name):
    """Before, slips that were constant over the delay turned the filter's heading away: 0.19 m."""
    in_time, late = (
        tracking(POLICIES[name], chosen)[4:12].mean() for chosen in ("weak-soil", "late-weak-soil")
    )
    assert late < 1.35 * in_time < 0.06


@pytest.mark.parametrize("rate", [50.0, 20.0])
def test_late_poses_do_not_delay_what_is_known_of_the_resistances(rate):
    """The regressions need inertial and drive samples alone, which are not late."""

    def reached(delay):
        """Time [s] from each step of both resistances until mu_l is within 15 %, (2, 3)."""
        sensors = {"preset": "rtk", "pose_delay": delay}
        env = TrackedVehicleVectorEnv(
            3, uncertainty="nominal", sensors=sensors, control_rate=rate, duration=12.0
        )
        steps = ((4.0, 0.3), (8.0, 0.65))
        schedule = [
            {"parameter": name, "kind": "ramp", "target": target, "start": start, "duration": 0.0}
            for start, target in steps
            for name in ("longitudinal_resistance", "lateral_resistance")
        ]
        observation, _ = env.reset(seed=5, options={"schedule": schedule})
        sheet = DataSheet.of(make_sensors(sensors))
        policy = AdaptivePolicy(control_period=1.0 / rate, data_sheet=sheet)
        state, known = None, []
        for step in range(round(12.0 * rate)):
            start = np.full(3, step == 0)
            action, state = policy.predict(observation, state, start)
            known.append(np.array(policy.identification.longitudinal.value[:, 1]))
            observation, *_ = env.step(action)
        near = [np.abs(np.array(known)[round(s * rate) :] / t - 1.0) < 0.15 for s, t in steps]
        return np.array([one.argmax(axis=0) for one in near]) / rate

    assert (reached(0.2) - reached(0.0)).max() < 0.11
