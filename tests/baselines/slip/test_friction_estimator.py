"""Slip on unknown friction: it is found, followed and held; robust, resumable, in the loop."""

import math
from functools import partial

import numpy as np
import pytest

from baselines.estimators.measurement import DataSheet
from baselines.slip.friction_estimator import CHANNELS, VELOCITIES, RecursiveSlipEstimator
from baselines.slip.slip_sweep import FRICTIONS, slip_family, with_friction
from tracked_env.physics import parameters as s
from tracked_env.physics.level_motion import hold_speeds
from tracked_env.physics.parameters import VEHICLES
from tracked_env.physics.patches_on_level_ground import make_patches
from tracked_env.plants.standalone import TerrainRig
from tracked_env.sensors import MOCAP

FOCCHI = VEHICLES["focchi"]
PERIOD = 0.02
QUIET = DataSheet(*(0.0 for _ in DataSheet._fields))
NOISY = DataSheet()
PATCHES = make_patches()
SPROCKETS = ("sprocket_speed_left", "sprocket_speed_right")


def turns(time, speed=0.5, rate=0.7, period=6.0):
    """Sprocket speeds (2,) of a vehicle that swings left and right."""
    v, w = min(speed, speed * time), rate * math.sin(2.0 * math.pi * time / period)
    half = 0.5 * w * FOCCHI.track_gauge
    return np.array([v - half, v + half]) / FOCCHI.sprocket_radius


def circle(time):
    return turns(0.0) + np.array([3.0, 7.0])


def straight(time):
    return np.array([5.0, 5.0])


class Drive:
    """Vehicles on given frictions, what their sensors see, and an estimator."""

    def __init__(self, frictions, sheet=QUIET, seed=0, **arguments):
        self.count, self.sheet = len(frictions), sheet
        self.estimator = RecursiveSlipEstimator(FOCCHI, PERIOD, sheet, self.count, **arguments)
        self.draws = np.random.default_rng(seed)
        self.states, self.time = np.zeros((self.count, 6)), 0.0
        self.put_on(frictions)

    def put_on(self, frictions):
        self.rows = np.array([with_friction(FOCCHI, mu) for mu in frictions])

    def sample(self, speeds):
        """Five measurements (5, N) after one control period."""
        sprockets = np.tile(speeds(self.time), (self.count, 1))
        loads = np.empty((self.count, 6))
        hold_speeds(self.states, sprockets, self.rows, PATCHES, 4, PERIOD / 4, False, loads)
        self.time += PERIOD
        s = self.sheet
        sigma = [s.sprocket_speed_noise] * 2 + [s.velocity_noise] * 2 + [s.gyro_noise]
        noise = self.draws.standard_normal((self.count, 5)) * sigma
        return (np.hstack([sprockets, self.states[:, 3:]]) + noise).T

    def on(self, speeds, duration):
        """(steps, N) estimates of mu."""
        history = []
        for _ in range(round(duration / PERIOD)):
            self.estimator.update(*self.sample(speeds))
            history.append(self.estimator.friction)
        return np.array(history)


FLOORS = [0.07, 0.1, 0.15, 0.25, 0.4, 0.6, 0.8]


@pytest.mark.parametrize(("sheet", "tolerance"), [(QUIET, 0.06), (NOISY, 0.3)])
def test_a_friction_it_was_not_told_is_found_within_seconds(sheet, tolerance):
    drive = Drive(FLOORS, sheet)
    drive.on(turns, 4.0)
    late = drive.on(turns, 4.0)
    np.testing.assert_allclose(np.median(late, axis=0), FLOORS, rtol=tolerance)


@pytest.mark.parametrize("sheet", [QUIET, NOISY])
def test_slip_is_that_of_the_true_friction_with_sensor_noise_too(sheet):
    drive = Drive(FLOORS, sheet)
    drive.on(turns, 6.0)
    left, right = np.full(len(FLOORS), 3.0), np.full(len(FLOORS), 7.0)
    estimate = np.array(drive.estimator.slip(left, right))
    true = np.array(slip_family(FOCCHI).slip(left, right, np.array(FLOORS)))
    np.testing.assert_allclose(estimate[:2], true[:2], atol=0.006)  # m/s, of 0.06
    np.testing.assert_allclose(estimate[2], true[2], atol=0.03)


@pytest.mark.parametrize(("before", "after"), [(0.4, 0.1), (0.1, 0.4), (0.8, 0.15)])
@pytest.mark.parametrize("sheet", [QUIET, NOISY])
def test_a_step_of_friction_is_followed_within_a_second_of_turning(before, after, sheet):
    drive = Drive([before] * 4, sheet)
    drive.on(circle, 5.0)
    drive.put_on([after] * 4)
    drive.on(circle, 1.0)
    np.testing.assert_allclose(np.median(drive.on(circle, 0.5)), after, rtol=0.25)


def test_nothing_is_forgotten_or_learned_when_driving_straight():
    drive = Drive([0.15, 0.6], NOISY)
    drive.on(turns, 5.0)
    before = drive.estimator.friction
    np.testing.assert_array_equal(drive.on(straight, 10.0), np.tile(before, (500, 1)))


def test_before_any_turn_it_knows_what_it_was_told_and_how_little_that_is():
    drive = Drive([0.1], NOISY)
    drive.on(straight, 2.0)
    mu, sigma = drive.estimator.estimates()["friction"]
    assert mu[0] == pytest.approx(0.4, rel=0.02)
    assert sigma[0] > 0.2
    drive.on(turns, 4.0)
    mu, sigma = drive.estimator.estimates()["friction"]
    assert abs(mu[0] - 0.1) < 3.0 * sigma[0] < 0.05


def test_errors_agree_with_the_standard_deviation():
    drive = Drive([0.15] * 20, NOISY)
    drive.on(turns, 8.0)
    mu, sigma = drive.estimator.estimates()["friction"]
    z = (mu - 0.15) / sigma
    assert np.abs(z).max() < 4.0
    assert 0.1 < np.sqrt(np.mean(z**2)) < 1.5


def test_missing_samples_are_skipped_and_wild_ones_have_little_weight():
    clean, spoiled = Drive([0.15] * 3, NOISY), Drive([0.15] * 3, NOISY)
    for step in range(300):
        sample = spoiled.sample(turns)
        if step % 7 == 0:
            sample[step % 5] = np.nan
        if step % 31 == 0:
            sample[2:, 0] = 1e300
            sample[0, 1] = np.inf
            sample[4, 2] = -40.0
        spoiled.estimator.update(*sample)
        clean.estimator.update(*clean.sample(turns))
    assert np.isfinite(spoiled.estimator.memory).all()
    np.testing.assert_allclose(spoiled.estimator.friction, 0.15, rtol=0.25)
    before = spoiled.estimator.friction
    used = spoiled.estimator.update(*np.full((5, 3), np.nan))
    assert not used.any()
    np.testing.assert_array_equal(spoiled.estimator.friction, before)


def test_rows_that_are_reset_start_anew_and_the_others_go_on():
    drive = Drive([0.1, 0.1], NOISY)
    drive.on(turns, 3.0)
    before = drive.estimator.memory[1].copy()
    drive.estimator.reset([0])
    fresh = RecursiveSlipEstimator(FOCCHI, PERIOD, NOISY)
    np.testing.assert_array_equal(drive.estimator.memory[0], fresh.memory[0])
    np.testing.assert_array_equal(drive.estimator.memory[1], before)


def test_a_hundred_thousand_steps_of_anything_stay_bounded():
    coarse = make_patches(2, 1)
    estimator = RecursiveSlipEstimator(FOCCHI, PERIOD, NOISY, 100, patches=coarse)
    draws = np.random.default_rng(0)
    for step in range(1000):
        sample = draws.standard_normal((5, 100)) * [[8.0], [8.0], [1.0], [1.0], [2.0]]
        sample[:, step % 100] = 0.0
        estimator.update(*sample)
    assert np.isfinite(estimator.memory).all()
    mu, sigma = estimator.estimates()["friction"]
    assert (mu >= FRICTIONS[0] - 1e-12).all() and (mu <= FRICTIONS[-1] + 1e-12).all()
    assert (sigma > 0.0).all() and np.isfinite(sigma).all()


def test_a_long_steady_drive_drifts_nowhere():
    drive = Drive([0.15, 0.4], NOISY)
    late = drive.on(turns, 60.0)[-1500:]
    np.testing.assert_allclose(np.median(late, axis=0), [0.15, 0.4], rtol=0.1)
    assert np.abs(np.log(late[:, 0] / 0.15)).max() < math.log(1.5)


WRONG = {
    "control_period = 50": lambda: RecursiveSlipEstimator(FOCCHI, 50.0, NOISY),
    "count = 0": lambda: Drive([]),
    "gyro_noise = -1": lambda: Drive([0.1], NOISY._replace(gyro_noise=-1.0)),
    "count = 2": lambda: Drive([0.1, 0.2]).estimator.update(*np.zeros((5, 3))),
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_arguments_are_refused_with_quantity_and_cause(message):
    with pytest.raises(ValueError, match=message):
        WRONG[message]()


SHEET, DIRECTIONS = DataSheet.of(MOCAP), 8


def relative_errors(grade, mu=0.5, duration=10.0, blind=False):
    """(slopes known, taken for level): estimate over mu - 1, (steps, DIRECTIONS), late in a drive.

    Vehicles that begin in all directions on a plane of that grade, and turn to and fro. blind: the
    velocity is not measured in the second half.
    """
    rng, parameters = np.random.default_rng(0), with_friction(FOCCHI, mu)
    terrain = {"terrain": {"kind": "plane", "slope_x": grade}}
    rig = TerrainRig(parameters, terrain, count=DIRECTIONS)
    for i in range(DIRECTIONS):
        rig.stand(0.0, 0.0, 2.0 * math.pi * i / DIRECTIONS, i)
    both = [
        RecursiveSlipEstimator(FOCCHI, PERIOD, SHEET, DIRECTIONS, slopes=slopes)
        for slopes in (True, False)
    ]
    steps = round(duration / PERIOD)
    estimate = np.empty((2, steps, DIRECTIONS))
    for k in range(steps):
        turn = 0.5 * FOCCHI.track_gauge * 0.5 * math.sin(2.0 * math.pi * PERIOD * k / 5.0)
        speeds = np.array([0.3 - turn, 0.3 + turn]) / FOCCHI.sprocket_radius
        attitude = rig.states[:, [s.ROLL, s.PITCH]].copy()
        attitude += SHEET.yaw_noise * rng.standard_normal(attitude.shape)
        rig.advance(np.tile(speeds, (DIRECTIONS, 1)), PERIOD)
        seen = rig.states[:, [s.V_X, s.V_Y, s.YAW_RATE]]
        noise = [SHEET.velocity_noise, SHEET.velocity_noise, SHEET.gyro_noise]
        seen = seen + noise * rng.standard_normal(seen.shape)
        if blind and k >= steps // 2:
            seen[:, :2] = math.nan
        for j, estimator in enumerate(both):
            estimator.update(*speeds, *seen.T, attitude)
            estimate[j, k] = estimator.friction / mu - 1.0
    return estimate[:, steps // 2 :]


@pytest.fixture(scope="module")
def errors():
    """By grade."""
    return {grade: relative_errors(grade) for grade in (0.0, 0.1, 0.2, 0.3)}


def rms(values):
    return math.sqrt(np.mean(values**2))


@pytest.mark.parametrize("grade", [0.1, 0.2, 0.3])
def test_on_a_slope_friction_is_found_as_on_level_ground_unless_it_is_taken_for_level(
    errors, grade
):
    on_level, (on_slope, taken_for_level) = errors[0.0][0], errors[grade]
    assert rms(on_slope) < rms(on_level)
    assert abs(on_slope.mean()) < 0.05
    assert np.abs(on_slope.mean(axis=0)).max() < 0.08  # in every direction
    assert rms(taken_for_level) > max(0.4, 8.0 * rms(on_slope))


def test_without_a_velocity_the_friction_found_before_is_kept_on_a_slope():
    assert rms(relative_errors(0.1, blind=True)[0]) < 0.1


def test_without_a_velocity_no_plant_of_the_bank_slides_away():
    """On every friction below the grade of 0.3 it would, faster than the belts within a second."""
    estimator = RecursiveSlipEstimator(FOCCHI, PERIOD, SHEET, slopes=True)
    attitude, belts = np.array([[0.0, math.atan(0.3)]]), 0.3
    for k in range(200):
        velocity = belts if k < 10 else math.nan
        speed = belts / FOCCHI.sprocket_radius
        estimator.update(speed, speed, velocity, 0.0 * velocity, 0.0, attitude)
    forward = estimator.memory[0, VELOCITIES : VELOCITIES + CHANNELS * len(FRICTIONS) : CHANNELS]
    assert np.abs(forward - belts).max() < belts


def samples(count):
    """Arguments of `update` for 3 vehicles: speeds, motion and attitude at random."""
    rng = np.random.default_rng(1)
    speeds, motion = rng.uniform(2.0, 5.0, (count, 2, 3)), 0.3 * rng.standard_normal((count, 3, 3))
    attitude = 0.1 * rng.standard_normal((count, 3, 2))
    return [(*speeds[k], *motion[k], attitude[k]) for k in range(count)]


@pytest.mark.parametrize("slopes", [False, True])
def test_a_copy_of_the_memory_resumes_and_a_row_is_the_single_vehicle_bit_for_bit(slopes):
    make = partial(RecursiveSlipEstimator, FOCCHI, PERIOD, SHEET, slopes=slopes)
    whole, resumed, single = make(3), make(3), make()
    for k, sample in enumerate(samples(80)):
        if k == 40:
            resumed.memory[:] = whole.memory
        for estimator in (whole, resumed) if k >= 40 else (whole,):
            estimator.update(*sample)
        single.update(*(column[1:2] for column in sample))
    np.testing.assert_array_equal(resumed.memory, whole.memory)
    np.testing.assert_array_equal(single.memory[0], whole.memory[1])
