"""Abrupt changes of made-up parameter histories, and recovery from them, in closed form."""

import numpy as np
import pytest

from tests.benchmark.stub_policies import Constant
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.metrics import ABRUPT_TIME, CHANGING, Change, abrupt_changes, recovery
from tracked_env.benchmark.runner import drive

PERIOD = 0.02  # [s]
STEPS = 1000


def history(**changes: np.ndarray) -> np.ndarray:
    """(T, 4) constant ones, but for the named parameters."""
    values = np.ones((STEPS, len(CHANGING)))
    for name, column in changes.items():
        values[:, CHANGING.index(name)] = column
    return values


def ramp(first: int, last: int, low: float = 1.0, high: float = 2.0) -> np.ndarray:
    """(T,) constant, then linear so that the first new value is in step `first`, then constant."""
    return np.interp(np.arange(STEPS), [first - 1, last], [low, high])


def test_a_step_is_a_change_at_the_step_from_which_on_it_is_in_force() -> None:
    payload = history(mass=ramp(400, 400), inertia=ramp(400, 400))
    assert abrupt_changes(payload, PERIOD) == [Change(400, 400)]


def test_a_border_lasts_from_its_first_to_its_last_change() -> None:
    assert abrupt_changes(history(longitudinal_resistance=ramp(300, 340)), PERIOD) == [
        Change(300, 340)
    ]


@pytest.mark.parametrize("duration", [ABRUPT_TIME, 10.0])
def test_what_takes_longer_than_two_seconds_is_a_drift(duration: float) -> None:
    slow = ramp(100, 100 + round(duration / PERIOD))
    assert abrupt_changes(history(mass=slow), PERIOD) == []


def test_a_step_is_seen_beside_the_drift_of_another_parameter() -> None:
    both = history(mass=ramp(400, 400), lateral_resistance=ramp(1, STEPS - 1))
    assert abrupt_changes(both, PERIOD) == [Change(400, 400)]


def test_what_varies_at_the_start_or_the_end_of_the_episode_is_not_a_whole_change() -> None:
    for fast in (ramp(1, 40), ramp(STEPS - 40, STEPS - 1), ramp(STEPS - 40, STEPS + 40)):
        assert abrupt_changes(history(lateral_resistance=fast), PERIOD) == []
    assert abrupt_changes(history(mass=ramp(STEPS - 5, STEPS - 5)), PERIOD) != []


def test_a_small_change_is_not_felt() -> None:
    assert abrupt_changes(history(mass=ramp(400, 400, 1.0, 1.01)), PERIOD) == []


def test_a_border_that_is_crossed_twice_is_two_changes_and_one_with_a_halt_on_it_one() -> None:
    there_and_back = ramp(300, 320) + ramp(600, 620, 0.0, -1.0)
    assert abrupt_changes(history(mass=there_and_back), PERIOD) == [
        Change(300, 320),
        Change(600, 620),
    ]
    halting = ramp(300, 310, 1.0, 1.5) + ramp(330, 340, 0.0, 0.5)
    assert abrupt_changes(history(mass=halting), PERIOD) == [Change(300, 340)]


def test_overlapping_runs_of_two_parameters_are_one_change() -> None:
    both = {"mass": ramp(300, 330), "inertia": ramp(320, 350)}
    earlier = history(**both, lateral_resistance=ramp(100, 110))
    assert abrupt_changes(earlier, PERIOD) == [Change(100, 110), Change(300, 350)]


def test_an_error_that_decays_recovers_when_it_falls_below_the_threshold() -> None:
    time = PERIOD * (1 + np.arange(STEPS))  # entry k is taken after step k
    error = np.where(time > 6.0, np.exp(-(time - 6.0) / 2.0), 0.01)
    found, peak, _ = recovery(error, [Change(300, 300)], PERIOD, 0.1)
    assert found == pytest.approx(2.0 * np.log(1.0 / 0.1), abs=PERIOD)
    assert peak == pytest.approx(np.exp(-0.01))


def test_the_time_to_recover_counts_from_the_end_and_the_peak_from_the_start_of_a_change() -> None:
    error = np.zeros(STEPS)
    error[300:310], error[340:390] = 0.9, 0.2
    assert recovery(error, [Change(300, 340)], PERIOD, 0.1) == (
        pytest.approx(1.0), 0.9, pytest.approx(np.sqrt((10 * 0.81 + 50 * 0.04) / (STEPS - 300))),
    )  # fmt: skip


def test_who_leaves_the_threshold_again_has_not_recovered_before() -> None:
    error = np.zeros(STEPS)
    error[500], error[900] = 1.0, 0.5
    assert recovery(error, [Change(400, 400)], PERIOD, 0.1)[0] == pytest.approx(501 * PERIOD)


def test_who_never_recovers_takes_the_time_that_is_left_or_that_to_the_next_change() -> None:
    error = np.full(STEPS, 0.5)
    assert recovery(error, [Change(400, 400)], PERIOD, 0.1)[0] == pytest.approx(600 * PERIOD)
    two = [Change(400, 400), Change(500, 500)]
    assert recovery(error, two, PERIOD, 0.1)[0] == pytest.approx(100 * PERIOD)


def test_who_is_not_disturbed_recovers_at_once() -> None:
    assert recovery(np.full(STEPS, 0.05), [Change(400, 420)], PERIOD, 0.1) == (
        0.0, 0.05, pytest.approx(0.05),
    )  # fmt: skip


def test_without_a_change_there_is_nothing_to_recover_from() -> None:
    assert np.isnan(recovery(np.ones(STEPS), [], PERIOD, 0.1)).all()


def test_the_payload_step_of_a_real_episode_is_found_where_its_schedule_has_it() -> None:
    config = BenchmarkConfig(sets=("payload",), duration=4.0)
    env = config.environment("payload", 4, truth=False)
    trace, _ = drive(Constant(0.2, 0.2), env, range(4), lambda: None)
    for i, changes in enumerate(trace.changes()):
        episode = env.simulation.episodes[i]
        assert episode is not None
        step = int(np.ceil(episode.events[0, 3] / PERIOD))
        assert changes == [Change(step, step)]


@pytest.mark.parametrize("name", ["soil-and-mass", "drift", "resistance-map"])
def test_sets_without_steps_and_borders_have_no_abrupt_change(name: str) -> None:
    env = BenchmarkConfig(duration=20.0).environment(name, 4, truth=False)
    trace, _ = drive(Constant(0.25, 0.25), env, range(4), lambda: None)
    assert trace.changes() == [[]] * 4
