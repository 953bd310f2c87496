"""The feedback-linearizing controller in closed loop, beside the figures of the paper."""

import numpy as np
import pytest

from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from tests.baselines.closed_loop import RTK_NOISE, Path, drive, starts, steady
from tracked_env.physics.parameters import plant_parameters

CLAY = plant_parameters()
PRINTED = CLAY._replace(turning_resistance_factor=2.0)  # S (20) to the letter
CIRCLE, LINE = steady(2.0, 0.2), steady(2.0, 0.0)
OFFSET = starts(y=-1.0, v_x=0.3)  # the start of S 8.1: 1 m off, slow


@pytest.mark.parametrize("lag", [0.0, 0.05])
@pytest.mark.parametrize("d", [0.05, 0.2])
@pytest.mark.parametrize("path", [CIRCLE, LINE], ids=["circle", "line"])
def test_perfect_knowledge_leaves_no_error_in_the_constrained_lateral_model(path, d, lag):
    p = PRINTED._replace(icr_forward=d, drive_time_constant=lag)
    run = drive(
        FeedbackLinearizingController(p, lateral="constrained"), p, path, OFFSET, 30.0,
        "constrained",
    )  # fmt: skip
    assert run.error[0, 0] == 1.0
    assert run.error.max() < 1.2
    assert run.error[-50:].max() < 1e-6  # S 8.1; float32 observations leave 1e-8
    assert np.ptp(run.action[-50:], axis=0).max() < 1e-4


@pytest.mark.parametrize("d", [0.05, 0.2])
@pytest.mark.parametrize("rate", [100, 50, 20])
def test_the_sliding_lateral_model_is_tracked_to_a_millimetre_whatever_d_and_rate(rate, d):
    p = CLAY._replace(icr_forward=d)
    run = drive(FeedbackLinearizingController(p, 1.0 / rate), p, CIRCLE, OFFSET, 25.0)
    assert run.error[-rate:].max() < 1e-4
    line = drive(FeedbackLinearizingController(p, 1.0 / rate), p, LINE, OFFSET, 25.0)
    assert line.error[-rate:].max() < 2e-3


@pytest.mark.parametrize(("rate", "rms"), [(100, 0.0032), (50, 0.005), (20, 0.0075)])
def test_sensor_noise_costs_millimetres(rate, rms):
    start = np.repeat(OFFSET, 12, axis=0)
    controller = FeedbackLinearizingController(CLAY, 1.0 / rate)
    run = drive(controller, CLAY, CIRCLE, start, 20.0, noise=RTK_NOISE)
    assert np.sqrt(np.mean(run.error[10 * rate :] ** 2)) == pytest.approx(rms, rel=0.15)


def test_a_winding_path_is_followed_because_the_heading_to_come_is_differentiated():
    p = CLAY._replace(icr_forward=0.2, drive_time_constant=0.0)
    sin, cos = np.sin, np.cos
    path = Path(
        lambda t: (2 + 0.5 * sin(0.5 * t), 0.25 * cos(0.5 * t), -0.125 * sin(0.5 * t)),
        lambda t: (0.3 * sin(0.8 * t), 0.24 * cos(0.8 * t)),
    )
    controller = FeedbackLinearizingController(p, 0.01, lateral="constrained")
    run = drive(controller, p, path, starts(v_x=2.0), 25.0, "constrained")
    assert np.sqrt(np.mean(run.error[500:] ** 2)) < 2e-3  # 1.4 mm; 4.2 mm without delta'


@pytest.mark.parametrize("speed", [2.0, 0.3, -1.5])
def test_any_start_near_the_path_at_rest_or_moving_is_caught(speed):
    count, draw = 48, np.random.default_rng(11).uniform
    start = starts(
        count,
        x=draw(-1, 1, count),
        y=draw(-1, 1, count),
        yaw=draw(-1, 1, count),
        v_x=draw(0, 1, count) * (np.arange(count) % 2),
    )
    controller = FeedbackLinearizingController(CLAY)
    run = drive(controller, CLAY, steady(speed, 0.1), start, 20.0, noise=RTK_NOISE)
    rms = np.sqrt(np.mean(run.error[500:] ** 2, axis=0))
    assert np.median(rms) < 0.01
    assert run.error[500:].max() < 0.1  # 2 d or more if a vehicle that faces back were ignored
    assert np.abs(run.action).max() <= 1.0


def test_a_vehicle_at_rest_on_a_resting_reference_is_left_at_rest():
    run = drive(FeedbackLinearizingController(CLAY), CLAY, steady(0.0, 0.0), starts(), 5.0)
    assert not run.action.any()
    assert not run.state.any()
