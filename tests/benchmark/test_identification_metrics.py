"""Estimates: what is taken down beside which true value, and metrics whose values are known."""

import numpy as np
import pytest

from tests.benchmark.stub_policies import Believing, Constant, Tracking, entry
from tracked_env.benchmark import BenchmarkConfig, Store, run, summarise
from tracked_env.benchmark import identification_metrics as ident
from tracked_env.benchmark.identification_metrics import ESTIMABLE, Recorder
from tracked_env.benchmark.metrics import CHANNELS, Trace
from tracked_env.benchmark.runner import drive
from tracked_env.physics.parameters import VEHICLES
from tracked_env.plants.lumped_block import PLANT as LUMPED

PERIOD = 0.02  # [s]
STEPS = 1000
CONFIG = BenchmarkConfig(sets=("soil-and-mass",), episodes=3, duration=2.0)


def trace(steps=STEPS, change=None):
    """One episode at rest; its mass doubles in step `change`."""
    values = np.ones((steps, 1, len(CHANNELS)))
    if change is not None:
        values[change:, 0, CHANNELS.index("mass")] = 2.0
    ended = np.array([steps < STEPS])
    limits = np.array([8e3]), np.array([2.0]), 5.0
    return Trace(values, np.array([steps]), STEPS, ended, ~ended, *limits, PERIOD)


def measured(value, truth=1000.0, deviation=50.0, name="mass", of=None):
    """Metrics of one episode; value, truth, deviation: numbers or (STEPS,)."""
    beliefs = Recorder(1, STEPS)
    beliefs.names, beliefs.reports_excitation, beliefs.nis = (name,), (False,), {}
    beliefs.rows, beliefs.excited = STEPS, np.zeros((STEPS, 1, 1), dtype=bool)
    beliefs.value, beliefs.truth, beliefs.deviation = (
        np.broadcast_to(np.asarray(part, dtype=np.float32), STEPS)[:, None, None]
        for part in (value, truth, deviation)
    )
    (found,) = ident.evaluate(beliefs, trace() if of is None else of)
    return dict(found["identification"][name])


def test_every_metric_is_computed_and_documented(repository):
    assert set(measured(1000.0)) == set(ident.ESTIMATION_METRICS)
    text = (repository / "docs" / "metrics.md").read_text(encoding="utf-8")
    for name, metric in ident.ESTIMATION_METRICS.items():
        assert f"| `{name}` | {metric.unit} | {metric.meaning} |" in text


ROWS = np.arange(STEPS)
TIME = ROWS * PERIOD
TWO_MASSES = np.where(ROWS < 500, 1000.0, 2000.0)
NOISE = np.random.default_rng(0).normal(0.0, 50.0, STEPS)
GAP = np.where(ROWS < 250, np.nan, 1100.0)
EARLY = np.where(ROWS < 400, 1100.0, np.nan)
DOUBLED = np.where(ROWS <= 400, 1000.0, 2000.0)  # row 401 is the first to see it
LATE = np.where(ROWS < 401 + 150, 1000.0, 2000.0)


@pytest.mark.parametrize(
    ("beliefs", "expected"),
    [
        (
            {"value": 900.0},
            {"relative_rmse": 0.1, "settled_relative_rmse": 0.1, "final_relative_error": -0.1}
            | {"claimed_deviation": 0.05},
        ),
        # The error is relative to the true value of that moment.
        ({"value": 1.2 * TWO_MASSES, "truth": TWO_MASSES}, {"relative_rmse": 0.2}),
        ({"value": 1200.0, "truth": TWO_MASSES}, {"final_relative_error": -0.4}),
        # The settled one leaves out the first five seconds.
        (
            {"value": np.where(TIME < 5.0, 500.0, 1100.0)},
            {"settled_relative_rmse": 0.1, "relative_rmse": np.sqrt(0.25 * 0.25 + 0.75 * 0.01)},
        ),
        ({"value": 1100.0, "deviation": 50.0}, {"nees": 4.0, "in_three_sigma": 1.0}),
        ({"value": 1160.0, "deviation": 50.0}, {"in_three_sigma": 0.0}),
        # A claim of no uncertainty has no NEES, but is found out.
        ({"value": 1001.0, "deviation": 0.0}, {"nees": None, "in_three_sigma": 0.0}),
        ({"value": 1000.0}, {"settling_time": 0.0, "settled": 1.0}),
        ({"value": 1200.0}, {"settling_time": None, "settled": 0.0}),
        # It counts from the last abrupt change.
        ({"value": LATE, "truth": DOUBLED, "of": trace(change=400)}, {"settling_time": 3.0}),
        ({"value": LATE, "truth": DOUBLED}, {"settling_time": (401 + 150) * PERIOD}),
        # What is not finite lies outside and leaves the rest as it is.
        ({"value": GAP}, {"relative_rmse": 0.1, "in_three_sigma": 0.75}),
        ({"value": GAP, "truth": 1100.0}, {"settling_time": 5.0}),
        ({"value": np.nan}, {"relative_rmse": None, "nees": None}),
        # An early end counts only the time driven.
        (
            {"value": EARLY, "of": trace(400)},
            {"relative_rmse": 0.1, "in_three_sigma": 1.0, "diverged": 0.0},
        ),
        ({"value": EARLY, "of": trace(100)}, {"settled_relative_rmse": None}),
        # Slip as it is, a parameter near zero over its nominal value.
        ({"value": 0.05, "truth": 0.0, "name": "slip_left"}, {"relative_rmse": 0.05}),
        (
            {"value": 0.001, "truth": 0.0, "name": "longitudinal_resistance"},
            {"relative_rmse": 0.001 / (0.01 * 0.6)},
        ),
    ],
)
def test_metrics_of_estimates_with_known_errors(beliefs, expected):
    found = measured(**beliefs)
    for name, value in expected.items():
        assert found[name] == (None if value is None else pytest.approx(value)), name


def test_errors_that_follow_their_claim_have_a_nees_of_one_and_lie_in_three_sigma():
    found = measured(1000.0 + NOISE)
    assert found["nees"] == pytest.approx(1.0, abs=0.15)
    assert found["in_three_sigma"] == pytest.approx(0.997, abs=0.005)


def test_an_estimate_that_converges_settles_when_it_enters_ten_percent_for_good():
    found = measured(1000.0 * (1.0 - np.exp(-TIME / 2.0)))
    assert found["settling_time"] == pytest.approx(2.0 * np.log(10.0), abs=PERIOD)
    swinging = np.where(np.abs(TIME - 7.0) < 0.5, 1500.0, 1000.0)
    assert measured(swinging)["settling_time"] == pytest.approx(7.5, abs=PERIOD)


@pytest.mark.parametrize(
    ("value", "truth", "diverged"),
    [
        (VEHICLES["strawa"].mass, 500.0, 0.0),  # 190 % off, but no worse than knowing nothing
        (2000.0, 500.0, 1.0),
        (1400.0, 1000.0, 0.0),  # 40 %
        (2000.0, 1450.0, 0.0),  # worse than nominal, but not by half
        (np.nan, 1450.0, 1.0),
        (np.inf, 1450.0, 1.0),
    ],
)
def test_diverged_is_who_ends_far_away_and_worse_than_the_nominal_value(value, truth, diverged):
    assert measured(value, truth)["diverged"] == diverged


def test_what_may_be_estimated_has_a_true_and_a_nominal_value():
    assert set(ident.nominal_values()) == set(ESTIMABLE)
    effort = 0.3 * 2.0 * 70e3 + 0.5 * 1450.0 * 9.81 * np.tan(np.radians(38.4))
    assert ident.nominal_values()["effort_maximum"] == pytest.approx(effort)


def test_the_first_second_after_a_change_is_told_apart():
    truth = np.where(np.arange(STEPS) < 400, 1000.0, 2000.0)
    late = np.where(np.arange(STEPS) < 400 + round(0.8 / PERIOD), 1000.0, 2000.0)
    found = measured(late, truth, of=trace(change=400))
    assert found["nees"] > 1.0 and found["in_three_sigma"] < 1.0
    assert found["nees_apart"] == 0.0 and found["in_three_sigma_apart"] == 1.0


def test_a_run_records_what_is_known_of_a_policy_that_is_five_percent_off(tmp_path):
    names = ("mass", "lateral_resistance")
    policies = [
        entry("silent", lambda context: Constant()),
        entry("tracking", lambda context: Tracking(names, 1.05, 0.02)),
    ]
    store = Store(tmp_path, CONFIG.identity())
    records = run(CONFIG, policies, store)
    assert not [r for r in records[:3] if "identification" in r or "nis" in r]
    for record in records[3:]:
        assert list(record["identification"]) == list(names)
        mass = record["identification"]["mass"]
        assert mass["relative_rmse"] == pytest.approx(0.05, rel=1e-4)
        assert mass["nees"] == pytest.approx(6.25, rel=1e-4)
        assert (mass["settling_time"], mass["settled"], mass["diverged"]) == (0.0, 1.0, 0.0)
        assert mass["excited"] == 0.5
        assert record["identification"]["lateral_resistance"]["excited"] is None
        assert record["nis"] == {"filter": 1.0}
    again = Store(tmp_path, CONFIG.identity())
    assert run(CONFIG, policies, again) == records  # as they come back from the file
    kept = store.load_trace("tracking", "soil-and-mass")
    assert kept["believed_names"].tolist() == list(names)
    assert kept["believed_value"].shape == (100, 2, 3)
    assert kept["believed_value"] == pytest.approx(1.05 * kept["believed_truth"], rel=1e-5)
    assert list(summarise(records).identification["soil-and-mass"]) == ["tracking"]


def test_the_size_of_a_chunk_does_not_change_a_number_of_the_estimates(tmp_path):
    policy = entry("tracking", lambda context: Tracking(("mass", "slip_left"), 1.05, 0.02))
    found = []
    for chunk in (3, 2):
        config = BenchmarkConfig(sets=("soil-and-mass",), episodes=3, duration=2.0, chunk=chunk)
        records = run(config, [policy], Store(tmp_path / f"{chunk}", config.identity()))
        found.append([r["identification"] for r in records])
    assert found[0] == found[1]


def test_a_light_vehicle_is_judged_by_its_own_nominal_values(tmp_path):
    light = VEHICLES["focchi"].mass
    assert ident.nominal_values(VEHICLES["focchi"])["mass"] == light
    config = BenchmarkConfig(sets=("floor",), episodes=1, duration=0.5)  # nothing is unknown
    store = Store(tmp_path, config.identity())
    policy = entry("heavy", lambda context: Believing({"mass": (6.0 * light, 1.0)}, 0.0))
    (record,) = run(config, [policy], store)
    believed = record["identification"]["mass"]
    assert believed["relative_rmse"] == pytest.approx(5.0, rel=1e-6)
    assert believed["diverged"] == 1.0  # the nominal value is right, and of a heavy vehicle is not


def test_the_truth_beside_an_estimate_is_the_one_in_force_when_it_was_made():
    names = ("mass", "effort_maximum", "slip_left", "lateral_resistance")
    config = BenchmarkConfig(sets=("payload",), duration=2.0)
    env = config.environment("payload", 3, truth=True)
    policy = Tracking(("mass", "lateral_resistance", "slip_left"), 1.0, 0.1)
    recorder = Recorder(3, 100)
    drive(policy, env, range(3), lambda: None, recorder)
    assert recorder.rows == 100
    assert np.array_equal(recorder.value, recorder.truth)
    assert (np.ptp(recorder.truth[:, 0], axis=0) > 500.0).all()  # the payload is in it
    believing = Believing(dict.fromkeys(names, (1.0, 1.0)))
    recorder = Recorder(3, 100)
    drive(believing, env, range(3), lambda: None, recorder)
    soil = VEHICLES["strawa"]
    mass, maximum, *_ = recorder.truth[: recorder.rows].swapaxes(0, 1)
    effort = 0.6 * soil.cohesion + 0.5 * 9.81 * mass * np.tan(soil.friction_angle)
    assert maximum == pytest.approx(effort, rel=1e-5)


def test_a_parameter_that_the_plant_does_not_read_has_no_truth_and_is_not_evaluated():
    believing = Believing(dict.fromkeys(("mass", "lateral_resistance"), (1.0, 1.0)))
    recorder = Recorder(3, 100, read=frozenset({"mass"}))
    env = BenchmarkConfig(sets=("payload",), duration=2.0).environment("payload", 3, truth=True)
    drive(believing, env, range(3), lambda: None, recorder)
    assert recorder.names == ("mass",)


def test_asking_a_policy_changes_none_of_the_numbers_of_its_drive(tmp_path):
    policies = [
        entry("silent", lambda context: Constant(0.3, 0.3)),
        entry("believing", lambda context: Believing({"mass": (1450.0, 100.0)})),
    ]
    records = run(CONFIG, policies, Store(tmp_path, CONFIG.identity()))
    drop = ("policy", "predict_time", "identification", "nis")
    plain = [{k: v for k, v in r.items() if k not in drop} for r in records]
    assert plain[:3] == plain[3:]


@pytest.mark.parametrize(
    ("believed", "message"),
    [
        ({"mas": (1.0, 1.0)}, "estimates of .'mas'.; none of them"),
        ({"mass": (1.0,)}, "estimate of mass has shapes"),
        ({"mass": (np.ones(2), np.ones(2))}, "each \\(3,\\): one number per vehicle"),
    ],
)
def test_estimates_that_are_not_understood_are_refused(tmp_path, believed, message):
    policy = Constant()
    policy.estimates = lambda: {
        name: tuple(np.full(3, p) if np.ndim(p) == 0 else p for p in parts)
        for name, parts in believed.items()
    }
    with pytest.raises(ValueError, match=message):
        run(CONFIG, [entry("odd", lambda context: policy)], Store(tmp_path, CONFIG.identity()))


def test_what_the_benchmark_has_no_truth_for_is_not_judged(tmp_path):
    beliefs = {"gyro_bias": (0.0, 1.0), "mass": (1450.0, 1.0)}
    policy = entry("more", lambda context: Believing(beliefs))
    records = run(CONFIG, [policy], Store(tmp_path, CONFIG.identity()))
    assert list(records[0]["identification"]) == ["mass"]


def test_every_parameter_that_the_plant_reads_may_be_estimated(tmp_path):
    policy = entry("all", lambda context: Believing(dict.fromkeys(ESTIMABLE, (1.0, 1.0))))
    records = run(CONFIG, [policy], Store(tmp_path, CONFIG.identity()))
    read = LUMPED.reads["torque"] - {"icr_forward"}  # of the constrained model alone
    assert "lateral_resistance" in read
    assert set(records[0]["identification"]) == {*read, "effort_maximum", "slip_left", "slip_right"}
