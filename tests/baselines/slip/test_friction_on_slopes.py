"""Friction that is estimated on slopes: by plants that feel gravity, and by planar ones."""

import math

import numpy as np
import pytest

from baselines.estimators.measurement import DataSheet
from baselines.slip.friction_estimator import CHANNELS, VELOCITIES, RecursiveSlipEstimator
from baselines.slip.slip_sweep import FRICTIONS, with_friction
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import VEHICLES
from tracked_env.plants.standalone import TerrainRig
from tracked_env.sensors import MOCAP

FOCCHI = VEHICLES["focchi"]
SHEET = DataSheet.of(MOCAP)
PERIOD, DIRECTIONS = 0.02, 8


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
    found = np.empty((2, steps, DIRECTIONS))
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
            found[j, k] = estimator.friction / mu - 1.0
    return found[:, steps // 2 :]


@pytest.fixture(scope="module")
def errors():
    """By grade."""
    return {grade: relative_errors(grade) for grade in (0.0, 0.1, 0.2, 0.3)}


def rms(values):
    return math.sqrt(np.mean(values**2))


@pytest.mark.parametrize("grade", [0.1, 0.2, 0.3])
def test_on_a_slope_friction_is_found_as_well_as_on_level_ground(errors, grade):
    on_level, on_slope = errors[0.0][0], errors[grade][0]
    assert rms(on_slope) < rms(on_level)
    assert abs(on_slope.mean()) < 0.05
    assert np.abs(on_slope.mean(axis=0)).max() < 0.08  # in every direction


@pytest.mark.parametrize("grade", [0.1, 0.2, 0.3])
def test_an_estimator_that_takes_every_place_for_level_errs_by_half_of_the_friction(errors, grade):
    assert rms(errors[grade][1]) > 0.4
    assert rms(errors[grade][1]) > 8.0 * rms(errors[grade][0])


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


def test_a_copy_of_the_memory_resumes_bit_for_bit_on_slopes():
    rng = np.random.default_rng(1)
    speeds, seen = rng.uniform(2.0, 5.0, (40, 2, 3)), 0.3 * rng.standard_normal((40, 3, 3))
    attitude = 0.1 * rng.standard_normal((40, 3, 2))
    whole = RecursiveSlipEstimator(FOCCHI, PERIOD, SHEET, 3, slopes=True)
    for k in range(20):
        whole.update(*speeds[k], *seen[k], attitude[k])
    other = RecursiveSlipEstimator(FOCCHI, PERIOD, SHEET, 3, slopes=True)
    other.memory[:] = whole.memory
    for k in range(20, 40):
        whole.update(*speeds[k], *seen[k], attitude[k])
        other.update(*speeds[k], *seen[k], attitude[k])
    np.testing.assert_array_equal(other.memory, whole.memory)


def test_a_row_of_a_batch_is_the_single_vehicle_on_slopes():
    rng = np.random.default_rng(2)
    batch = RecursiveSlipEstimator(FOCCHI, PERIOD, SHEET, 3, slopes=True)
    alone = RecursiveSlipEstimator(FOCCHI, PERIOD, SHEET, slopes=True)
    for _ in range(30):
        speeds, seen = rng.uniform(2.0, 5.0, (2, 3)), 0.3 * rng.standard_normal((3, 3))
        attitude = 0.1 * rng.standard_normal((3, 2))
        batch.update(*speeds, *seen, attitude)
        alone.update(*speeds[:, 1:2], *seen[:, 1:2], attitude[1:2])
    np.testing.assert_array_equal(batch.memory[1], alone.memory[0])
