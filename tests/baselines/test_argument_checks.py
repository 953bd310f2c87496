"""Controllers and estimators check period, count and noise alike, with one message each."""

from functools import partial

import pytest

from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import DataSheet
from baselines.estimators.observation_reader import ObservationReader
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.soil_estimator import SoilEstimator
from baselines.estimators.turning import TurningEstimator
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from baselines.lyapunov.slippage_aware import SlippageAwarePolicy
from baselines.slip.friction_estimator import RecursiveSlipEstimator
from baselines.slip.slip_models import NoSlip
from tracked_env.physics.parameters import VEHICLES

P = VEHICLES["focchi"]
SHEET = DataSheet()
CONTROLLERS = {
    "feedback linearization": partial(FeedbackLinearizingController, P),
    "slippage aware": partial(SlippageAwarePolicy, P, slip_model=NoSlip()),
}
ESTIMATORS = {
    "reader": ObservationReader,
    "longitudinal": partial(LongitudinalEstimator, P, data_sheet=SHEET),
    "turning": partial(TurningEstimator, P, data_sheet=SHEET),
    "slip": partial(SlipObserver, P, data_sheet=SHEET),
    "soil": partial(SoilEstimator, P, data_sheet=SHEET),
    "friction": partial(RecursiveSlipEstimator, P, data_sheet=SHEET),
}
EVERY = {**CONTROLLERS, **ESTIMATORS}


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("period", [0.0, 50.0, float("nan"), "20 ms", True])
def test_a_control_period_outside_its_range_is_refused_in_the_same_words(name, period):
    says = (
        rf"control_period = {period!r}.*; must be a number in \[0.0001, 1\] s. Did you pass a rate"
    )
    with pytest.raises(ValueError, match=says):
        EVERY[name](control_period=period)


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("count", [0, -1, 1.5, "2", True])
def test_a_count_that_is_no_whole_number_from_one_on_is_refused(name, count):
    with pytest.raises(ValueError, match=rf"count = {count!r}.*; must be a"):
        ESTIMATORS[name](control_period=0.02, count=count)


@pytest.mark.parametrize("name", ["slip", "soil", "friction"])
@pytest.mark.parametrize("sigma", [-1.0, float("inf"), float("nan")])
def test_a_standard_deviation_that_is_negative_or_not_finite_is_refused(name, sigma):
    sheet = SHEET._replace(gyro_noise=sigma)
    with pytest.raises(ValueError, match=rf"gyro_noise = {sigma} .*; must be a number in \[0"):
        ESTIMATORS[name](control_period=0.02, data_sheet=sheet)
