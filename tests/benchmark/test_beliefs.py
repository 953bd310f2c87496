"""Beliefs of policies: what is taken down beside which true value, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benchmark.stub_policies import Believing, Constant, Tracking, entry
from tracked_env.benchmark import BenchmarkConfig, Store, run
from tracked_env.benchmark.metrics import KNOWN, Recorder
from tracked_env.benchmark.runner import drive
from tracked_env.physics.parameters import VEHICLES
from tracked_env.plants.lumped import PLANT as LUMPED

CONFIG = BenchmarkConfig(sets=("soil-and-mass",), episodes=3, duration=2.0)


def test_the_truth_beside_an_estimate_is_the_one_in_force_when_it_was_made() -> None:
    names = ("mass", "effort_maximum", "slip_left", "lateral_resistance")
    config = BenchmarkConfig(sets=("payload",), duration=2.0)
    env = config.environment("payload", 3, truth=True)
    policy = Tracking(("mass", "lateral_resistance", "slip_left"), 1.0, 0.1)
    recorder = Recorder(3, 100)
    drive(policy, env, range(3), lambda: None, recorder)
    beliefs = recorder.beliefs()
    assert len(beliefs.value) == 100
    assert np.array_equal(beliefs.value, beliefs.truth)
    assert (np.ptp(beliefs.truth[:, 0], axis=0) > 500.0).all()  # the payload is in it
    believing = Believing(dict.fromkeys(names, (1.0, 1.0)))
    recorder = Recorder(3, 100)
    drive(believing, env, range(3), lambda: None, recorder)
    beliefs = recorder.beliefs()
    weight = 9.81 * beliefs.truth[:, 0]
    effort = 0.6 * VEHICLES["strawa"].cohesion + 0.5 * weight * np.tan(
        VEHICLES["strawa"].friction_angle
    )
    assert beliefs.truth[:, 1] == pytest.approx(effort, rel=1e-5)


def test_a_parameter_that_the_plant_does_not_read_has_no_truth_and_is_not_evaluated() -> None:
    believing = Believing(dict.fromkeys(("mass", "lateral_resistance"), (1.0, 1.0)))
    recorder = Recorder(3, 100, read=frozenset({"mass"}))
    env = BenchmarkConfig(sets=("payload",), duration=2.0).environment("payload", 3, truth=True)
    drive(believing, env, range(3), lambda: None, recorder)
    assert recorder.beliefs().names == ("mass",)


def test_asking_a_policy_changes_none_of_the_numbers_of_its_drive(tmp_path: Path) -> None:
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
def test_estimates_that_are_not_understood_are_refused(
    tmp_path: Path, believed: dict[str, Any], message: str
) -> None:
    policy = Constant()
    policy.estimates = lambda: {  # type: ignore[attr-defined]
        name: tuple(np.full(3, p) if np.ndim(p) == 0 else p for p in parts)
        for name, parts in believed.items()
    }
    with pytest.raises(ValueError, match=message):
        run(CONFIG, [entry("odd", lambda context: policy)], Store(tmp_path, CONFIG.identity()))


def test_what_the_benchmark_has_no_truth_for_is_not_judged(tmp_path: Path) -> None:
    beliefs = {"gyro_bias": (0.0, 1.0), "mass": (1450.0, 1.0)}
    policy = entry("more", lambda context: Believing(beliefs))
    records = run(CONFIG, [policy], Store(tmp_path, CONFIG.identity()))
    assert list(records[0]["identification"]) == ["mass"]


def test_every_parameter_that_the_plant_reads_may_be_estimated(tmp_path: Path) -> None:
    policy = entry("all", lambda context: Believing(dict.fromkeys(KNOWN, (1.0, 1.0))))
    records = run(CONFIG, [policy], Store(tmp_path, CONFIG.identity()))
    read = LUMPED.reads["torque"] - {"icr_forward"}  # of the constrained model alone
    assert "lateral_resistance" in read
    assert set(records[0]["identification"]) == {
        *read,
        "effort_maximum",
        "slip_left",
        "slip_right",
    }
