"""What every estimator does alike: rows of a batch, copied states, resets, errors that say why."""

import copy
import pickle

import numpy as np
import pytest

from baselines.estimators.actuators import COMMANDS, ActuatorEstimator
from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import DataSheet, Measurement, make_measurement
from baselines.estimators.observation_reader import ObservationReader
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.soil_estimator import SoilEstimator
from baselines.estimators.turning import TurningEstimator
from tests.baselines.estimators.motion_cases import CLAY, go_on, state
from tracked_env import observation as layout
from tracked_env.vector_env import TrackedVehicleVectorEnv

COUNT, STEPS, PERIOD = 3, 150, 0.02
KINDS = {
    "longitudinal": LongitudinalEstimator,
    "turning": TurningEstimator,
    "slip": SlipObserver,
    "soil": SoilEstimator,
    "actuators": ActuatorEstimator,
}
EVERY = pytest.mark.parametrize("kind", KINDS.values(), ids=list(KINDS))


def part_of(measurement, rows):
    added = {name: values[rows] for name, values in measurement.added.items()}
    return Measurement(*(array[rows] for array in measurement)).with_fields(added)


@pytest.fixture(scope="module")
def samples():
    """(latest, paired) of every step of a drive with late and lost samples, and outages."""
    sensors = {
        "preset": "rtk", "pose_delay": 0.1, "pose_rate": 2.0, "inertial_dropout": 0.1,
        "drive_delay": 0.02, "drive_dropout": 0.2,
    }  # fmt: skip
    env = TrackedVehicleVectorEnv(COUNT, uncertainty="weak-soil", sensors=sensors, error_limit=1e3)
    reader, rng, drive = ObservationReader(PERIOD, COUNT), np.random.default_rng(1), []
    observation, action = env.reset(seed=7)[0], np.full((COUNT, 2), 0.2, dtype=np.float32)
    for _ in range(STEPS):
        commands = observation[:, [layout.INDEX[name] for name in COMMANDS]].astype(float)
        added = dict(zip(COMMANDS, commands.T, strict=True))
        drive.append([one.with_fields(added) for one in reader.read(observation)[:2]])
        action = np.clip(action + rng.uniform(-0.1, 0.1, action.shape), -0.4, 0.7)
        observation = env.step(action.astype(np.float32))[0]
    return drive


def follow(estimator, samples, rows=slice(None)):
    """The Estimate after each sample, of some of the vehicles."""
    return [estimator.update(part_of(one[estimator.paired], rows)) for one in samples]


def assert_same(ours, theirs, row=slice(None)):
    for one, other in zip(ours, theirs, strict=True):
        for mine, yours in zip(one[1:], other[1:], strict=True):
            np.testing.assert_array_equal(mine, yours[row])


@EVERY
def test_a_row_of_a_batch_is_the_vehicle_alone_and_its_copied_state_goes_on_bit_for_bit(
    kind, samples
):
    batch = follow(kind(CLAY, PERIOD, count=COUNT), samples)
    assert np.ptp([estimate.value for estimate in batch], axis=0).min() > 0.0
    for i in range(COUNT):
        alone, other = kind(CLAY, PERIOD), kind(CLAY, PERIOD)
        rows = slice(i, i + 1)
        first = follow(alone, samples[:90], rows)
        go_on(other, alone)
        assert_same(first + follow(other, samples[90:], rows), batch, rows)


@EVERY
def test_samples_may_have_any_layout_and_estimators_go_on_where_they_are_copied(kind, samples):
    """Kernels are bound to the types of their first call."""
    expected = follow(kind(CLAY, PERIOD, count=COUNT), samples)
    estimator, answers = kind(CLAY, PERIOD, count=COUNT), []
    for k, one in enumerate(samples):
        measurement = one[estimator.paired]
        turned = Measurement(*(np.asfortranarray(array) for array in measurement))
        whole = Measurement(turned.values, turned.fresh.astype(np.int8), turned.age)
        other = (measurement, turned, whole)[k % 3].with_fields(measurement.added)
        answers.append(estimator.update(other))
        if k % 50 == 10:
            estimator = copy.deepcopy(estimator) if k % 100 == 10 else roundtrip(estimator)
    assert_same(answers, expected)


def roundtrip(estimator):
    return pickle.loads(pickle.dumps(estimator))


@EVERY
@pytest.mark.parametrize("rows", [[1], np.array([False, True, False]), 1])
def test_reset_forgets_the_vehicles_named_and_no_other(kind, rows, samples):
    estimator, new = kind(CLAY, PERIOD, count=COUNT), kind(CLAY, PERIOD, count=COUNT)
    follow(estimator, samples[:40])
    before = state(estimator)
    estimator.reset(rows)
    np.testing.assert_array_equal(state(estimator)[1], state(new)[1])
    np.testing.assert_array_equal(state(estimator)[[0, 2]], before[[0, 2]])
    estimator.reset()
    np.testing.assert_array_equal(state(estimator), state(new))


WRONG = [
    ({"control_period": 50.0}, "control_period = 50.0 s.*rate or milliseconds"),
    ({"count": 0}, "count = 0"),
    ({"lateral": "slide"}, "lateral = 'slide'; must be 'sliding' or 'constrained'"),
    ({"parameters": CLAY._replace(track_gauge=1700.0)}, "track_gauge.*millimetres"),
    ({"parameters": CLAY._replace(shear_deformation_modulus=2.0)}, "centimetres"),
    ({"data_sheet": DataSheet(yaw_noise=-1.0)}, "yaw_noise = -1.0"),
    ({"data_sheet": DataSheet(gyro_bias=np.nan)}, "gyro_bias = nan"),
    ({"data_sheet": DataSheet(pose_delay=100.0)}, "pose_delay = 100.0 s.*milliseconds"),
]


@EVERY
@pytest.mark.parametrize(("options", "words"), WRONG, ids=[words[:20] for _, words in WRONG])
def test_senseless_arguments_are_refused_with_the_reason(kind, options, words):
    with pytest.raises(ValueError, match=words):
        kind(**{"parameters": CLAY, **options})


@pytest.mark.parametrize(
    ("options", "words"),
    [({"window": 1}, "window = 1"), ({"correlation_steps": 0.5}, "correlation_steps = 0.5")],
)
def test_senseless_windows_of_the_soil_estimator_are_refused(options, words):
    with pytest.raises(ValueError, match=words):
        SoilEstimator(CLAY, PERIOD, **options)


@EVERY
def test_a_measurement_of_another_number_of_vehicles_is_refused(kind):
    with pytest.raises(ValueError, match=r"values has shape \(3, 13\).*made for count = 2"):
        kind(CLAY, PERIOD, count=2).update(make_measurement(x=np.zeros(3)))
