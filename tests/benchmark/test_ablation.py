"""The study of parts and conditions: that each takes out or changes what it says, and no more."""

import csv
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from baselines.estimators import interacting_models as im
from baselines.estimators.measurement import POSE
from baselines.estimators.slip_filterpy import FilterpySlipObserver
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.registry import POLICIES
from benchmarks.studies import ablation as study
from reproduce.strawa2021.identification import FORGETTING
from tests.benchmark.test_report import EASY, records
from tests.driving import assert_equal
from tracked_env import TORQUE_ID
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT
from tracked_env.benchmark.policies import policies_for
from tracked_env.benchmark.summary import rows_of
from tracked_env.physics.lumped import drive_limits
from tracked_env.physics.parameters import PARAMETER_INDEX, PARAMETER_NAMES
from tracked_env.vehicles import SIZED

CONFIG = BenchmarkConfig(("alternating", "outages-gains"), 2, DEVELOPMENT)
COUNT, STEPS = 2, 200  # vehicles, control steps
# A reference that turns, so that the turning regression is excited.
DRIVEN = replace(CONFIG, reference={"kind": "circle", "radius": 8.0, "speed": 2.0})
_MU_L, _MU_T = "longitudinal_resistance", "lateral_resistance"
_LAG, *_GAINS = "drive_time_constant", "actuator_gain_left", "actuator_gain_right"
_SOIL = ("cohesion", "friction_angle", "shear_deformation_modulus")
HELD: dict[str, set[str]] = {
    "all nominal": {"mass", "inertia", _MU_L, _MU_T, _LAG, *_GAINS, *_SOIL},
    "resistances nominal": {_MU_L, _MU_T},
    "motion resistance nominal": {_MU_L},
    "lateral resistance nominal": {_MU_T},
    "drives nominal": {_LAG, *_GAINS},
    "lag of the drives nominal": {_LAG},
    "gains of the drives nominal": {*_GAINS},
    "mass nominal": {"mass"},
    "inertia nominal": {"inertia"},
}


def driven(policy: Any, name: str = "alternating", steps: int = STEPS, config: Any = DRIVEN) -> Any:
    """What a policy did: actions (steps, N, 2), parameters of its law (steps, ROWS, N), ages of the
    pose, positions that were observed and that the law saw."""
    env = config.environment(name, COUNT, truth=False)
    observation, _ = env.reset(seed=[DEVELOPMENT + i for i in range(COUNT)])
    seen, law = [], policy.controller.act

    def act(shown: Any, *arguments: Any) -> Any:
        seen.append(shown.copy())
        return law(shown, *arguments)

    policy.controller.act = act
    state, start = None, np.ones(COUNT, dtype=bool)
    actions, believed, ages, observed = [], [], [], []
    for _ in range(steps):
        observed.append(observation.copy())
        action, state = policy.predict(observation, state, start)
        start = np.zeros(COUNT, dtype=bool)
        actions.append(action)
        believed.append(
            np.broadcast_to(policy.controller.parameters, (len(PARAMETER_NAMES), COUNT))
        )
        believed[-1] = believed[-1].copy()
        ages.append(policy.identification.reading.latest.age[:, POSE])
        observation, *_ = env.step(action)
    env.close()
    arrays = {"actions": actions, "believed": believed, "ages": ages, "observed": observed}
    return SimpleNamespace(seen=np.array(seen), **{k: np.array(v) for k, v in arrays.items()})


@pytest.fixture(scope="module")
def adaptive() -> Any:
    policy = POLICIES["adaptive"](DRIVEN.context("alternating"))
    run = driven(policy)
    run.policy = policy
    return run


def without(name: str) -> AdaptivePolicy:
    return study.make_without(name, DRIVEN.context("alternating"))


def test_without_any_part_taken_out_it_is_the_registered_policy_bit_for_bit(
    adaptive: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(study.PARTS, "nothing", study.Part())
    assert np.array_equal(driven(without("nothing")).actions, adaptive.actions)


@pytest.mark.parametrize("name", [*HELD])
def test_the_law_has_nominal_values_of_what_is_held_and_estimates_of_the_rest(
    name: str, adaptive: Any
) -> None:
    policy = without(name)
    run = driven(policy)
    nominal = np.array(DRIVEN.context("alternating").vehicle)
    moved = (adaptive.believed[-1] != nominal[:, None]).any(axis=1)
    for parameter, row in PARAMETER_INDEX.items():
        values = run.believed[:, row]
        if parameter in HELD[name]:
            assert (values == nominal[row]).all(), parameter
        elif parameter not in _SOIL:  # which the data must determine before it is used
            assert (values[-1] != nominal[row]).any() == moved[row], parameter
    estimated = {**policy.estimates()}
    for parameter in HELD[name].difference(_SOIL):
        assert (estimated[parameter][0] != nominal[PARAMETER_INDEX[parameter]]).all(), parameter
    if name != "lag of the drives nominal":  # the lag of this set is the nominal one, nearly
        assert not np.array_equal(run.actions, adaptive.actions)


def test_with_the_inertial_mass_nominal_the_forces_of_the_soil_are_those_identified() -> None:
    policy = without("inertial mass nominal")
    run, p = driven(policy), PARAMETER_INDEX
    mass = policy.estimates()["mass"][0]
    assert (run.believed[:, p["mass"]] == DRIVEN.context("alternating").vehicle.mass).all()
    assert not np.allclose(mass, run.believed[-1, p["mass"]], rtol=0.01)
    for name in (_MU_L, _MU_T):
        product = run.believed[-1, p["mass"]] * run.believed[-1, p[name]]
        assert product == pytest.approx(mass * policy.estimates()[name][0])


def test_without_the_filter_the_law_sees_what_was_measured(adaptive: Any) -> None:
    measured = driven(without("no filter"))
    assert np.array_equal(measured.seen[:, :, :3], measured.observed[:, :, :3])
    assert not np.array_equal(adaptive.seen[:, :, :3], adaptive.observed[:, :, :3])


def test_without_the_soil_the_law_keeps_the_nominal_one_and_the_filter_too() -> None:
    config = BenchmarkConfig(("late-weak-soil",), COUNT, DEVELOPMENT)
    context, soil = config.context("late-weak-soil"), [PARAMETER_INDEX[name] for name in _SOIL]
    nominal, ground = np.array(context.vehicle)[soil], {}
    usual = driven(POLICIES["adaptive"](context), "late-weak-soil", STEPS, config)
    assert (usual.believed[:, soil] != nominal[:, None]).any()
    for name in ("no soil in the law", "no soil estimator"):
        policy = study.make_without(name, context)
        run = driven(policy, "late-weak-soil", STEPS, config)
        assert (run.believed[:, soil] == nominal[:, None]).all()
        assert policy.identification is not None
        rows, friction = policy.stack.slip.rows, policy.identification.turning
        ground[name] = rows["effort_maximum"].copy()
        assert np.array_equal(rows["friction"], friction.of("lateral_resistance"))
    expected = drive_limits(context.vehicle).effort_maximum
    assert ground["no soil estimator"] == pytest.approx(expected)
    assert not np.isclose(ground["no soil in the law"], expected).any()


def test_the_regressions_are_those_that_the_parts_name(adaptive: Any) -> None:
    stacks, masses = {"adaptive": adaptive.policy.stack}, {}
    for name in (
        "no side-slip row", "single model", "single model, forgets faster",
        "regressions of the paper",
    ):  # fmt: skip
        policy = without(name)
        driven(policy)
        stacks[name], masses[name] = policy.stack, policy.estimates()["mass"][0]
    both = {name: (of.longitudinal, of.turning) for name, of in stacks.items()}
    several = {name: [bool(r.rows["odds"].any()) for r in of] for name, of in both.items()}
    assert several.pop("adaptive") == several.pop("no side-slip row") == [True, True]
    assert [*several.values()] == 3 * [[False, False]]
    factors = {name: {r.prior.forgetting for r in of} for name, of in both.items()}
    assert factors["single model"] == factors["adaptive"] == {im.FORGETTING}
    assert factors["single model, forgets faster"] == {FORGETTING}
    assert factors["regressions of the paper"] == {FORGETTING}
    coupled = {name: of.longitudinal._constants.coupled for name, of in stacks.items()}
    assert [name for name, value in coupled.items() if not value] == ["regressions of the paper"]
    masses["adaptive"] = adaptive.policy.estimates()["mass"][0]
    values = np.stack([*masses.values()])
    assert len(np.unique(values[:, 0])) == len(masses)  # each identifies in its own way


def test_gains_and_lag_are_held_while_there_is_no_pose_and_only_then() -> None:
    config = replace(CONFIG, sensors={"preset": "rtk-outages", "pose_outage_gap": [2.0, 2.0]})
    policy = study.make_without("drives held in outages", config.context("outages-gains"))
    run = driven(policy, "outages-gains", 400, config)
    drives = [PARAMETER_INDEX[name] for name in (_LAG, *_GAINS)]
    silent = run.ages[1:] > study.OUTAGE
    assert silent.any(axis=0).all()
    changes = (run.believed[1:, drives] != run.believed[:-1, drives]).any(axis=1)
    assert not changes[silent].any()
    assert changes[~silent].mean() > 0.5
    estimate = policy.estimates()["actuator_gain_left"][0]
    assert (estimate[silent[-1]] != run.believed[-1, drives[1]][silent[-1]]).all()


def test_the_filter_of_filterpy_drives_as_the_own_one(adaptive: Any) -> None:
    policy = without("filter of filterpy")
    assert isinstance(policy.stack.slip, FilterpySlipObserver)
    run = driven(policy, steps=50)
    assert run.actions == pytest.approx(adaptive.actions[:50], abs=1e-4)


class Told:
    """A policy that notes what it is told."""

    def __init__(self, context: Any) -> None:
        self.vehicle = context.vehicle


@pytest.mark.parametrize("error", [0.1, 0.3])
def test_each_number_of_size_and_drives_is_told_too_large_or_too_small_by_the_error(
    error: float,
) -> None:
    context, seen = CONFIG.context("alternating"), []
    for draw in range(study.DRAWS):
        entries = [study.told_wrongly(name, error, draw) for name in ("adaptive", "integral")]
        assert [e.name for e in entries] == [
            f"{name} told {error:g}@{draw}" for name in ("adaptive", "integral")
        ]
        own = entries[0].make(context).parameters  # type: ignore[attr-defined]
        assert own == entries[1].make(context)._policy.parameters  # type: ignore[attr-defined]
        true = context.vehicle._asdict()
        signs = {name: getattr(own, name) / true[name] for name in SIZED}
        for ratio in signs.values():
            assert min(abs(ratio - 1.0 - error), abs(ratio - 1.0 / (1.0 + error))) < 1e-12
        assert {name for name, value in true.items() if getattr(own, name) != value} == {*SIZED}
        seen.append(tuple(signs.values()))
        function, arguments = entries[0].source or (None, ())
        again = function(*arguments)  # type: ignore[misc]
        assert (again.name, again.fingerprint) == (entries[0].name, entries[0].fingerprint)
    assert len({*seen}) == study.DRAWS


def test_a_noise_factor_scales_white_noise_and_nothing_else() -> None:
    louder = study.Condition(noise=4.0).config(CONFIG)
    for name in CONFIG.sets:
        sheet, louder_sheet = CONFIG.context(name).sensors, louder.context(name).sensors
        for field, value in sheet._asdict().items():
            is_noise = field.endswith("_noise")
            assert getattr(louder_sheet, field) == (4.0 * value if is_noise else value), field
        sets = CONFIG.registered(name), louder.registered(name)
        same = {field for field in sets[0]._fields if field not in ("sensors", "arguments")}
        assert all(getattr(sets[0], field) == getattr(sets[1], field) for field in same)
        as_usual = replace(CONFIG, own_sets=study.with_noise(CONFIG, 1.0))
        envs = [of.environment(name, 1, truth=False) for of in (CONFIG, as_usual, louder)]
        first = [env.reset(seed=[DEVELOPMENT])[0] for env in envs]
        assert np.array_equal(first[0], first[1]) and not np.array_equal(first[0], first[2])
        usual, scaled = (envs[k].simulation.episodes[0] for k in (0, 2))
        assert usual is not None and scaled is not None
        for field in ("parameters", "state", "events"):
            assert_equal(getattr(usual, field), getattr(scaled, field))
        assert np.array_equal(usual.profile.table, scaled.profile.table)


def test_a_control_rate_changes_the_rate_alone_and_who_cannot_drive_at_it_is_refused() -> None:
    slow = study.CONDITIONS["10 Hz"]
    assert slow.config(CONFIG) == replace(CONFIG, control_rate=10.0)
    assert slow.config(CONFIG).context("alternating").control_period == pytest.approx(0.1)
    entries = policies_for(TORQUE_ID, ["adaptive", "mpc-adaptive"])
    assert [entry.name for entry in slow.entries(entries, CONFIG)] == ["adaptive"]
    assert study.CONDITIONS["20 Hz"].entries(entries, CONFIG) == entries


def test_errors_are_over_those_of_the_policy_under_usual_conditions() -> None:
    usual = {
        name: rows_of(records(name, adaptive=EASY, integral=2.0 * EASY))[name] for name in "ab"
    }
    wrong = {
        "a": rows_of(records("a", **{"adaptive told 0.1@0": 2.0 * EASY}))["a"],
        "b": rows_of(records("b", **{"adaptive told 0.1@0": 8.0 * EASY}))["b"],
    }
    same = study.condition_table({"20 Hz": usual}, usual, ["adaptive", "integral"])
    one, two = "1.00 [1.00, 1.00]", "2.00 [2.00, 2.00]"
    assert [row[1:3] for row in same[1:]] == [[one, two], [one, one]]
    cells = study.condition_table({"told 10 % wrong": wrong}, usual, ["adaptive", "integral"])
    assert cells[2][1:3] == ["4.00 [4.00, 4.00]", study.REFUSED]


def test_parts_are_ordered_by_what_they_are_worth() -> None:
    rows = {
        name: rows_of(records(name, adaptive=EASY, one=EASY, two=factor * EASY))[name]
        for name, factor in (("a", 2.0), ("b", 8.0))
    }
    cells = study.part_table(rows, ["one", "two"])
    assert [row[:2] for row in cells[1:]] == [
        ["two", "4.00 [4.00, 4.00]"], ["one", "1.00 [1.00, 1.00]"],
    ]  # fmt: skip
    assert cells[1][3] == "b 8.00"


@pytest.mark.slow
def test_the_command_runs_what_is_missing_and_renews_its_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    blocks = "".join(f"<!-- {n}: begin -->\n<!-- {n}: end -->\n" for n in ("parts", "conditions"))
    page.write_text(blocks)
    arguments = ["--sets", "alternating", "outages-gains", "--episodes", "2", "--duration", "6"]
    arguments += ["--output", str(tmp_path / "results"), "--page", str(page)]
    arguments += ["--policies", "adaptive", "integral", "--parts", "mass nominal", "no filter"]
    arguments += ["--conditions", "20 Hz", "noise times 2", "told 10 % wrong"]
    assert study.main(arguments, "program") == 0
    folders = sorted((tmp_path / "results").iterdir())
    assert len(folders) == 3  # of usual episodes, another rate, other sensors
    before = {path: (path / "episodes.jsonl").read_bytes() for path in folders}
    (table,) = (tmp_path / "results").glob("*/parts.csv")
    rows = list(csv.reader(table.open(encoding="utf-8")))
    assert {row[0] for row in rows[1:]} == {"mass nominal", "no filter"}
    (table,) = (tmp_path / "results").glob("*/conditions.csv")
    rows = list(csv.reader(table.open(encoding="utf-8")))
    assert [row[0] for row in rows[2:]] == ["20 Hz", "noise times 2", "told 10 % wrong"]
    text = page.read_text()
    assert "| mass nominal |" in text and "| told 10 % wrong |" in text
    assert study.main(arguments, "program") == 0
    assert {path: (path / "episodes.jsonl").read_bytes() for path in folders} == before
    assert page.read_text() == text
