"""Metrics of made-up traces whose values are known."""

from typing import Any

import numpy as np
import pytest

from tracked_env.benchmark import metrics
from tracked_env.benchmark.metrics import CHANGING, Trace
from tracked_env.engine.env_config import DRIVES

PERIOD = 0.02  # [s]
STEPS = 1000
LIMIT = 5.0  # [m]


def trace(steps: int = STEPS, max_steps: int = STEPS, **channels: Any) -> Trace:
    """One episode with the given channels, numbers or (steps,), and 0 everywhere else."""
    values = np.zeros((steps, 1, len(metrics.CHANNELS)))
    for name, channel in channels.items():
        values[:, 0, metrics.CHANNELS.index(name)] = channel
    ended = np.array([steps < max_steps])
    return Trace(
        values, np.array([steps]), max_steps, ended, ~ended, np.array([8000.0]),
        np.array([2.0]), LIMIT, PERIOD,
    )  # fmt: skip


def value(of: Trace, name: str) -> float:
    return float(metrics.evaluate(of)[name][0])


def test_every_metric_is_computed_and_documented() -> None:
    assert set(metrics.evaluate(trace())) == set(metrics.METRICS)


def test_the_rmse_of_a_constant_error_is_that_error() -> None:
    constant = trace(error=0.3)
    for name in ("tracking_rmse", "settled_rmse", "max_error", "final_error"):
        assert value(constant, name) == pytest.approx(0.3)


def test_the_settled_rmse_leaves_out_the_first_five_seconds() -> None:
    error = np.where(np.arange(1, STEPS + 1) * PERIOD <= 5.0, 1.0, 0.1)
    assert value(trace(error=error), "settled_rmse") == pytest.approx(0.1)
    assert value(trace(error=error), "tracking_rmse") == pytest.approx(np.sqrt(0.25 + 0.75 * 0.01))


def test_the_settled_rmse_of_a_short_episode_is_that_of_its_second_half() -> None:
    short = trace(100, 100, error=np.repeat([1.0, 0.1], 50))
    assert value(short, "settled_rmse") == pytest.approx(0.1)


def test_the_time_after_a_crash_counts_with_the_error_limit() -> None:
    crashed = trace(STEPS // 2, error=0.0)
    assert value(crashed, "tracking_rmse") == pytest.approx(LIMIT / np.sqrt(2.0))
    assert value(crashed, "max_error") == value(crashed, "final_error") == LIMIT
    assert value(crashed, "terminated") == 1.0
    assert value(crashed, "success") == 0.0
    assert value(crashed, "driven_time") == pytest.approx(10.0)


@pytest.mark.parametrize("steps", [1, 100, 500, 999])
def test_leaving_the_path_is_never_better_than_staying_at_the_limit(steps: int) -> None:
    stays = trace(error=np.r_[np.full(steps, 0.2), np.full(STEPS - steps, 0.999 * LIMIT)])
    leaves = trace(steps, error=0.2)
    for name in ("tracking_rmse", "settled_rmse", "max_error", "final_error"):
        assert value(leaves, name) >= value(stays, name)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 80.0])
def test_a_state_that_is_not_finite_counts_as_the_limit_and_spoils_nothing(bad: float) -> None:
    moving = [name for name in metrics.CHANNELS if name not in CHANGING]
    channels = {name: np.r_[np.zeros(9), bad] for name in moving}
    diverged = metrics.evaluate(trace(10, **channels))
    # No change of the parameters, no goal, and the actions are torques.
    lacking = ("sprocket_speed_rate", *metrics.AFTER_CHANGE, *metrics.OF_GOALS)
    finite = {name: np.isfinite(column).all() for name, column in diverged.items()}
    assert [name for name in finite if not finite[name]] == list(lacking)
    assert diverged["max_error"][0] == LIMIT


def test_how_an_episode_ended_is_told_apart() -> None:
    assert metrics.ending(trace()) == ["time"]
    assert metrics.ending(trace(10, error=5.1)) == ["off-path"]
    assert metrics.ending(trace(10, x=np.nan)) == ["non-finite"]


def test_the_energy_is_power_times_time_whatever_the_signs() -> None:
    driving = trace(
        torque_left=1000.0, sprocket_speed_left=-2.0, torque_right=-500.0, sprocket_speed_right=-4.0
    )
    assert value(driving, "energy") == pytest.approx(4000.0 * STEPS * PERIOD)


def test_saturation_counts_the_steps_and_sides_at_the_limit_of_the_demand() -> None:
    action = np.zeros(STEPS)
    action[:100] = 1.0
    assert value(trace(action_left=action), "saturation_share") == pytest.approx(0.05)
    assert value(trace(action_left=0.99), "saturation_share") == 0.0


@pytest.mark.parametrize(
    ("drive", "limit", "name", "other"),
    [
        ("torque", 8000.0, "torque_rate", "sprocket_speed_rate"),  # [N m]
        ("speed", 10.0, "sprocket_speed_rate", "torque_rate"),  # [rad/s]
    ],
)
def test_the_action_rate_is_the_mean_rate_of_the_demand_in_its_own_unit(
    drive: str, limit: float, name: str, other: str
) -> None:
    given: dict[str, Any] = {"drive": drive, "demand_limit": np.array([limit])}
    ramp = trace(action_left=np.linspace(0.0, 1.0, STEPS), action_right=0.5)._replace(**given)
    assert value(ramp, name) == pytest.approx(limit / (STEPS * PERIOD) / 2)
    alternating = trace(action_left=0.1 * (-1.0) ** np.arange(STEPS))._replace(**given)
    assert value(alternating, name) == pytest.approx(0.2 * limit / PERIOD / 2, rel=2e-3)
    assert np.isnan(value(alternating, other))


def test_every_drive_has_an_action_rate_and_every_unit_of_a_record_is_one_unit() -> None:
    assert set(metrics.ACTION_RATES) == set(DRIVES)
    units = [metrics.METRICS[name].unit for name in metrics.ACTION_RATES.values()]
    assert units == ["N m/s", "rad/s^2"]


def test_heading_and_speed_are_measured_over_the_time_driven() -> None:
    crashed = trace(100, heading_error=-0.2, speed_error=0.5)
    assert value(crashed, "heading_rmse") == pytest.approx(0.2)
    assert value(crashed, "speed_rmse") == pytest.approx(0.5)


def test_rows_past_the_end_of_an_episode_are_void() -> None:
    both = trace()
    values = np.zeros((STEPS, 2, len(metrics.CHANNELS)))
    values[100:, 1] = 1e9  # whatever lies there
    pair = both._replace(
        values=values,
        steps=np.array([STEPS, 100]),
        terminated=np.array([False, True]),
        success=np.array([True, False]),
        demand_limit=np.full(2, 8000.0),
        contact_length=np.full(2, 2.0),
    )
    alone = metrics.evaluate(trace(100))
    for name, column in metrics.evaluate(pair).items():
        assert column[1] == alone[name][0] or np.isnan([column[1], alone[name][0]]).all()
