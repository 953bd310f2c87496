"""The slippage-aware controller that identifies the friction, in closed loop on Speed-v0."""

from functools import cache

import numpy as np
import pytest

from baselines.estimators.measurement import DataSheet
from baselines.lyapunov import pose_filter
from baselines.lyapunov.lyapunov_laws import LyapunovGains
from baselines.lyapunov.slippage_aware import KnownSlip, OracleSlipPolicy
from baselines.registry import BY_DRIVE, POLICIES, PREDICTIVE
from baselines.slip.friction_estimator import RecursiveSlipEstimator
from baselines.slip.slip_sweep import identified_slip
from tracked_env import observation as layout
from tracked_env.benchmark import BenchmarkConfig, PolicyContext
from tracked_env.benchmark.policy_interface import needs_truth
from tracked_env.benchmark.runner import drive
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import MOCAP

FOCCHI = VEHICLES["focchi"]
CONTEXT = PolicyContext(0.02, "sliding", MOCAP, "speed", FOCCHI)


@cache
def errors(name, of_set, gains=None, count=16, duration=20.0):
    """RMSE (count,) [m] after 5 s, of a named policy on a set; gains: not those registered."""
    config = BenchmarkConfig(sets=(of_set,), duration=duration)
    policy = POLICIES[name](config.context(of_set), **(gains._asdict() if gains else {}))
    env = config.environment(of_set, count, needs_truth(policy))
    trace, _ = drive(policy, env, range(count), lambda: None)
    assert not trace.terminated.any()
    return np.sqrt((trace.channel("error")[250:] ** 2).mean(axis=0))


# The gains of the paper leave more to a wrong slip angle than the tuned ones.
PAPER = LyapunovGains()
# Unknown floors, and across a border.
FLOORS = ["friction", pytest.param("friction-step", marks=pytest.mark.slow)]


@pytest.mark.slow
@pytest.mark.parametrize("of_set", FLOORS)
def test_on_friction_that_it_is_not_told_it_drives_like_one_that_knows(of_set):
    adaptive, oracle = (errors(name, of_set, PAPER) for name in ("slc-adaptive", "slc-oracle"))
    assert adaptive.mean() < 1.2 * oracle.mean()


@pytest.mark.parametrize("of_set", FLOORS)
def test_more_knowledge_of_the_slip_is_better_tracking(of_set):
    names = ("uc", "slc", "slc-adaptive")
    unaware, fixed, adaptive = (errors(name, of_set, PAPER).mean() for name in names)
    assert adaptive < 0.9 * fixed < 0.5 * unaware


@pytest.mark.slow
def test_tuned_gains_leave_less_than_half_and_what_is_not_known_costs_millimetres():
    adaptive, oracle = (errors(name, "friction").mean() for name in ("slc-adaptive", "slc-oracle"))
    assert adaptive < 0.5 * errors("slc-adaptive", "friction", PAPER).mean()
    assert oracle < adaptive < oracle + 0.003


def test_a_late_pose_costs_little():
    late = errors("slc-adaptive", "floor-late-pose").mean()
    assert late < 1.3 * errors("slc-adaptive", "friction").mean()


def test_known_slip_is_the_one_identified_on_that_soil():
    model = KnownSlip(FOCCHI)
    model.friction, model.modulus = np.array([0.2, 0.6]), np.array([0.001, 0.002])
    left, right = np.array([2.0, -3.0]), np.array([4.0, 5.0])
    slip = np.array(model.slip(left, right))
    for row, (mu, modulus) in enumerate(zip(model.friction, model.modulus, strict=True)):
        soil = {"friction_angle": float(np.arctan(mu)), "shear_deformation_modulus": modulus}
        table = identified_slip(FOCCHI._replace(**soil))
        expected = table.slip(left[row : row + 1], right[row : row + 1])
        np.testing.assert_allclose(slip[:, row], np.ravel(expected), rtol=0, atol=2e-4)
    twice = np.array(model.slip(np.tile(left, 2), np.tile(right, 2)))
    np.testing.assert_array_equal(twice, np.tile(slip, 2))


@pytest.mark.parametrize(("age", "looked_at"), [(0.0, True), (0.1, False)])
def test_a_late_velocity_is_not_taken_for_one_of_now(age, looked_at):
    config = BenchmarkConfig(sets=("friction",))
    env, policy, state = config.environment("friction", 2, False), POLICIES["slc-adaptive"], None
    policy, (observation, _) = policy(config.context("friction")), env.reset(seed=3)
    for _ in range(40):
        before = observation, state
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
    observation, state = before
    observation[:, layout.INDEX["pose_age"]] = age / layout.SCALE[layout.INDEX["pose_age"]]
    faster = observation.copy()
    faster[:, layout.INDEX["v_x"]] += 0.1
    one, other = (policy.predict(seen, state)[1].memory for seen in (observation, faster))
    assert np.array_equal(one, other) != looked_at


@pytest.mark.parametrize(("drive", "other"), [("speed", "torque"), ("torque", "speed")])
def test_a_policy_for_one_kind_of_drive_refuses_the_other(drive, other):
    vehicle = {"speed": FOCCHI, "torque": VEHICLES["strawa"]}
    for name in set(BY_DRIVE[drive]) - set(PREDICTIVE):
        with pytest.raises(ValueError, match=f"the environment takes its {other}"):
            POLICIES[name](CONTEXT._replace(drive=other, vehicle=vehicle[other]))
        policy = POLICIES[name](CONTEXT._replace(drive=drive, vehicle=vehicle[drive]))
        assert needs_truth(policy) == (name in ("slc-oracle", "oracle"))


def test_the_oracle_takes_the_soil_of_every_vehicle():
    oracle = OracleSlipPolicy(FOCCHI, 0.02, DataSheet.of(MOCAP))
    truth = {name: np.full(2, value) for name, value in FOCCHI._asdict().items()}
    truth["friction_angle"] = np.arctan([0.1, 0.7])
    truth["slip_left"] = np.zeros(2)
    oracle.observe_truth(truth)
    np.testing.assert_allclose(oracle.slip_model.friction, [0.1, 0.7])
    np.testing.assert_allclose(oracle.slip_model.modulus, 0.001)


def lost_in_outages(count=24, duration=20.0):
    """RMS error [m] of the pose that the policy carries on where none comes, per vehicle."""
    config = BenchmarkConfig(sets=("floor-outages",), duration=duration)
    policy = POLICIES["slc-adaptive"](config.context("floor-outages"))
    env = config.environment("floor-outages", count, truth=False)
    observation, _ = env.reset(seed=list(range(71_000, 71_000 + count)))
    arrays, state, squares = env.simulation.batch, None, []
    for _ in range(round(duration / 0.02)):
        east, north = (arrays.column(n) - arrays.column(f"reference_{n}") for n in ("x", "y"))
        c, s = np.cos(arrays.column("yaw")), np.sin(arrays.column("yaw"))
        true = np.stack([c * east + s * north, c * north - s * east], axis=1)
        blind = observation[:, layout.INDEX["pose_age"]] > 0.25
        action, state = policy.predict(observation, state)
        lost = ((state.driving.error[:, :2] - true) ** 2).sum(axis=1)
        squares.append(np.where(blind, lost, np.nan))
        observation, *_ = env.step(action)
    return np.sqrt(np.nanmean(squares, axis=0))


@pytest.mark.slow
def test_without_a_pose_it_goes_by_the_plant_that_the_belts_drive(monkeypatch):
    by_plant = lost_in_outages()
    monkeypatch.setattr(RecursiveSlipEstimator, "velocities", lambda self: None)
    settled = lost_in_outages()  # by the slip at which the belts settle
    assert np.median(by_plant) < 0.01
    assert by_plant.mean() < 0.9 * settled.mean()


def test_the_bias_of_the_gyro_is_learned_from_the_heading_and_taken_off_in_an_outage():
    """A vehicle at rest beside a resting reference: 10 s with poses, 10 s without."""
    rng, bias, turned = np.random.default_rng(1), 0.01, {}
    sheet = DataSheet.of(MOCAP)._replace(gyro_bias=bias)
    for learned in (True, False):
        keep, reference = pose_filter.PoseFilter.of(sheet, 0.02, learned), np.empty((8, 4))
        error, mean, gyro = np.zeros((8, 3)), np.zeros((8, 3)), np.zeros((8, pose_filter.GYRO))
        memory = pose_filter.PoseMemory(error, np.zeros(8), mean, gyro, np.zeros(8, dtype=bool))
        for step in range(1000):
            observation = np.zeros((8, layout.SIZE), dtype=np.float32)
            blind = max(step - 500, 0) * 0.02
            heading = sheet.yaw_noise * rng.standard_normal(8) if blind == 0.0 else np.nan
            rate = bias + sheet.gyro_noise * rng.standard_normal(8)
            columns = [layout.INDEX[name] for name in ("heading_error", "yaw_rate", "pose_age")]
            for column, value in zip(columns, (heading, rate, blind), strict=True):
                observation[:, column] = value / layout.SCALE[column]
            rest = np.zeros((8, 2)), np.zeros(8)
            pose_filter.locate(observation, *rest, keep, memory, reference)
        turned[learned] = np.abs(error[:, 2])
        assert np.allclose(gyro[:, pose_filter.TURN_BIAS], bias if learned else 0.0, atol=1e-3)
    assert turned[True].max() < 0.015
    assert turned[False].min() > 0.09  # [rad], the bias over 10 s


@pytest.mark.parametrize("steps", [1, 5, 50])
def test_a_sample_after_a_gap_takes_away_what_samples_in_the_gap_would_have(steps):
    """A vehicle at rest whose belts say d = 5 cm/s. Just after a sample it is d T r / (1 - r) off,
    r = (1 - K)^n, T = n dt: less the longer the gap, as n samples pull n times."""
    sheet = DataSheet.of(MOCAP)._replace(velocity_noise=1e6)
    keep, reference = pose_filter.PoseFilter.of(sheet, 0.02, False), np.empty((1, 4))
    memory, drift = pose_filter.PoseMemory.blank(1), np.array([[0.05, 0.0]])
    observation = np.zeros((1, layout.SIZE), dtype=np.float32)
    for step in range(40 * steps + 1):
        observation[0, layout.INDEX["pose_age"]] = (
            0.02 * (step % steps) / layout.SCALE[layout.INDEX["pose_age"]]
        )
        pose_filter.locate(observation, drift, np.zeros(1), keep, memory, reference)
    r = (1.0 - keep.position_gain) ** steps
    assert memory.error[0, 0] == pytest.approx(0.05 * 0.02 * steps * r / (1.0 - r), rel=1e-3)
