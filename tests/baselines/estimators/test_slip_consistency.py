"""Is the slip observer right, and does it know how right it is? Known slips, noisy sensors."""

import numpy as np
import pytest

from baselines.estimators.slip_observer import SlipObserver
from tests.baselines.estimators.slip_cases import (
    PARAMETERS,
    PERIOD,
    RTK,
    SHEETS,
    STRAWA,
    follow,
    simulate,
    weaving,
)

COUNT = 200
SLIPS = np.array([0.05, 0.14])


def _observer(sheet, count=COUNT, **options):
    return SlipObserver(PARAMETERS, PERIOD, sheet, count, **options)


@pytest.mark.parametrize("velocity", [True, False], ids=["velocity", "pose_only"])
@pytest.mark.parametrize("preset", SHEETS)
@pytest.mark.parametrize("direction", [1.0, -1.0], ids=["forward", "reverse"])
def test_constant_slips_are_found_without_bias(preset, velocity, direction):
    belts = direction * weaving(600, COUNT)
    run = simulate(belts, direction * SLIPS, -0.06, SHEETS[preset])
    value, covariance, _, _ = follow(_observer(SHEETS[preset], velocity=velocity), run.measurements)
    error = value[-1, :, 3:] - run.state[-1, :, 3:]
    sigma = np.sqrt(np.diagonal(covariance[-1], axis1=-2, axis2=-1))[:, 3:]
    assert np.all(np.abs(error.mean(axis=0)) < 4.0 * error.std(axis=0) / np.sqrt(COUNT) + 1e-3)
    assert np.all(np.abs(error) < 5.0 * sigma)
    assert np.all(sigma < (0.06 if preset == "strawa" else 0.03))


@pytest.mark.parametrize("preset", SHEETS)
def test_braking_slips_are_found_without_bias(preset):
    run = simulate(weaving(600, COUNT), -SLIPS, 0.05, SHEETS[preset])
    value, *_ = follow(_observer(SHEETS[preset]), run.measurements)
    error = value[-1, :, 3:5] + SLIPS
    assert np.all(np.abs(error.mean(axis=0)) < 4.0 * error.std(axis=0) / np.sqrt(COUNT) + 1e-3)


@pytest.mark.parametrize(("preset", "rms"), [("rtk", 0.008), ("strawa", 0.016)])
def test_slowly_varying_slips_are_followed(preset, rms):
    time = PERIOD * np.arange(1500)[:, None]
    slips = 0.08 + 0.06 * np.stack([np.sin(0.4 * time), np.cos(0.3 * time)], axis=-1)
    run = simulate(weaving(1500, 50), slips, 0.05 * np.sin(0.5 * time), SHEETS[preset])
    value, *_ = follow(_observer(SHEETS[preset], 50), run.measurements)
    error = (value - run.state)[500:, :, 3:5]
    assert np.sqrt(np.mean(error**2)) < rms
    assert np.abs(error.mean(axis=(0, 1))).max() < 0.002


def _matched(sheet, velocity, seed=3):
    """Slips that walk as the observer supposes; sigma of the walk below the default's."""
    steps, walk = 600, 0.02 * np.sqrt(PERIOD)
    rng = np.random.default_rng(seed)
    slips = 0.25 + np.cumsum(walk * rng.standard_normal((steps, COUNT, 2)), axis=0)
    side = np.cumsum(1.5 * walk * rng.standard_normal((steps, COUNT)), axis=0)
    run = simulate(weaving(steps, COUNT), slips, side, sheet, seed, drifts=(0.01, 0.003))
    return run, follow(_observer(sheet, velocity=velocity), run.measurements)


@pytest.mark.parametrize("velocity", [True, False], ids=["velocity", "pose_only"])
@pytest.mark.parametrize("preset", SHEETS)
def test_nis_and_nees_are_chi_square_on_a_matched_simulation(preset, velocity):
    run, (value, covariance, _, nis) = _matched(SHEETS[preset], velocity)
    rows = 6 if velocity else 3
    # Averages of chi^2 with `rows` degrees of freedom: 4 sigma, and 3 % for the linearisation.
    samples = nis[200:].size
    assert nis[200:].mean() == pytest.approx(
        rows, abs=4.0 * np.sqrt(2.0 * rows / samples) + 0.03 * rows
    )
    error = value[599] - run.state[599]
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance[599]), error)
    assert nees.mean() == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / COUNT))
    late = np.abs(nis[200:] - nis[200:].mean())
    together = np.mean((nis[200:-1] - nis[200:].mean()) * (nis[201:] - nis[200:].mean()))
    assert abs(together) < 0.05 * np.mean(late**2)  # white innovations


def test_a_delayed_pose_gives_unbiased_slips_and_pose_and_without_its_age_it_does_not():
    steps = 700
    belts = weaving(steps, COUNT)
    belts += np.abs((PERIOD * np.arange(steps) % 6.0) - 3.0)[:, None, None]  # +-1 m/s^2
    run = simulate(belts, SLIPS, -0.06, RTK, delay=10)
    errors = []
    for known in (True, False):
        observer = _observer(RTK)
        samples = run.measurements
        if not known:
            samples = [m._replace(age=np.zeros_like(m.age)) for m in samples]
        value, *_ = follow(observer, samples)
        errors.append((value - run.state)[400:])
    assert np.abs(errors[0][..., 3:].mean(axis=1)).max() < 0.005
    assert np.hypot(*errors[0][..., :2].mean(axis=1).T).max() < 0.01
    assert np.abs(errors[1][..., 3:].mean(axis=1)).max() > 0.02
    assert np.hypot(*errors[1][..., :2].mean(axis=1).T).max() > 0.1


def test_few_samples_and_lost_ones_leave_the_estimate_unbiased():
    run = simulate(weaving(1000, COUNT), SLIPS, -0.06, STRAWA)
    rng, observer = np.random.default_rng(4), _observer(STRAWA)
    skipped = np.zeros(COUNT, dtype=int)
    for m in run.measurements:
        m.fresh[:, 0] = rng.random(COUNT) < 0.3
        lost = rng.random(COUNT) < 0.1
        m.values[lost, 0] = np.nan
        skipped += lost & m.fresh[:, 0]
        answer = observer.update(m)
        assert np.array_equal(answer.status == 2, (lost & m.fresh[:, 0]) | (answer.nis > 38.0))
    error = answer.value[:, 3:] - run.state[-1, :, 3:]
    assert np.array_equal(answer.skipped, skipped)
    assert np.all(np.abs(error.mean(axis=0)) < 4.0 * error.std(axis=0) / np.sqrt(COUNT) + 1e-3)


def test_the_filtered_motion_is_better_than_the_sensors():
    run = simulate(weaving(600, COUNT), SLIPS, -0.06, STRAWA)
    observer = _observer(STRAWA)
    follow(observer, run.measurements)
    motion = np.array(observer.motion()).T
    assert np.array_equal(motion[:, :3], observer.memory[:, :3])
    rms = np.sqrt(np.mean((motion[:, 3:] - run.velocity[-1]) ** 2, axis=0))
    assert np.all(rms < np.array([0.03, 0.03, 0.03]))  # 0.1 m/s of the velocities
    assert np.sqrt(np.mean((motion[:, :2] - run.state[-1, :, :2]) ** 2)) < 0.15  # 1 m
