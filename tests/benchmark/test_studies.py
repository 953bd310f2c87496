"""The studies: what adapting is worth, breaking points, and what would break the headline."""

import csv
import math
from typing import NamedTuple

import numpy as np
import pytest

from benchmarks.studies import adaptation as ad
from benchmarks.studies import break_headline as headline
from benchmarks.studies import breaking_points as bp
from benchmarks.studies import vehicle_sizes
from tests.benchmark.stub_policies import Constant
from tests.benchmark.test_report import EASY, records
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import SETS, BenchmarkConfig, tuning
from tracked_env.benchmark.evaluation_sets import AUDIT
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.store import READS_TRUTH
from tracked_env.benchmark.summary import rows_of
from tracked_env.sensors import make_sensors

# By axis: the fields of the sensors that differ between two of its levels.
SENSOR_FIELDS = {"pose-delay": {"pose_delay"}, "position-noise": {"position_noise"}}
SENSOR_FIELDS["outage"] = {"pose_outage_length"}


@pytest.fixture(autouse=True)
def sets_of_before():
    """Levels are registered as sets, which tests of the catalogue do not expect."""
    before = dict(SETS)
    yield
    SETS.clear()
    SETS.update(before)


@pytest.mark.parametrize("axis", [*bp.AXES])
@pytest.mark.parametrize("share", [0.013, 0.4, 0.77])
def test_the_bracket_holds_the_level_at_which_half_fail(axis, share):
    of, asked = bp.AXES[axis], list[float]()
    limit = of.level(share)

    def success(level):
        asked.append(level)
        return 0.5 if abs(level - of.easy) <= abs(limit - of.easy) else 0.49

    point = bp.bisect(axis, "x", 16, success)
    assert abs(point.stands - of.easy) <= abs(limit - of.easy) < abs(point.breaks - of.easy)
    assert len(asked) == 2 + bp.BISECTIONS == len(set(asked))
    width = np.log(point.breaks / point.stands) / np.log(of.hard / of.easy)
    assert width == pytest.approx(2.0**-bp.BISECTIONS)
    assert point.success == 0.5


def test_where_it_never_breaks_or_always_does_the_other_end_is_nan():
    always = bp.bisect("mass", "x", 16, lambda level: 1.0)
    assert (always.stands, math.isnan(always.breaks)) == (10.0, True)
    never = bp.bisect("mass", "x", 16, lambda level: 0.2)
    assert (math.isnan(never.stands), never.breaks, never.success) == (True, 1.0, 0.2)
    cells = bp.table([always, never._replace(agent="y")])
    assert cells[1:] == [["x", "stands 10"], ["y", "fails at 1"]]


@pytest.mark.parametrize("env", [TORQUE_ID, SPEED_ID])
def test_the_levels_of_an_axis_change_what_it_names_and_nothing_else(env):
    drawn = {}
    for axis in bp.AXES:
        for level in (bp.AXES[axis].easy, bp.AXES[axis].level(0.5)):
            name = bp.set_of(env, axis, level)
            assert bp.set_of(env, axis, level) == name and SETS[name].env == env
            made = BenchmarkConfig((name,)).environment(name, 1, truth=False)
            made.reset(seed=[5])
            (episode,) = made.simulation.episodes
            made.close()
            drawn[axis, level] = episode
    for axis in bp.AXES:
        easy, hard = (drawn[axis, bp.AXES[axis].level(share)] for share in (0.0, 0.5))
        assert np.array_equal(easy.profile.table, hard.profile.table)
        assert easy.noise_seed == hard.noise_seed and easy.state == hard.state
        assert (repr(easy.sensors) == repr(hard.sensors)) == (axis in ("mass", "soil-strength"))
        before, after = (
            make_sensors(SETS[bp.set_of(env, axis, bp.AXES[axis].level(share))].sensors)._asdict()
            for share in (0.0, 0.5)
        )
        differing = {field for field in before if before[field] != after[field]}
        assert differing == SENSOR_FIELDS.get(axis, set())
        assert (easy.parameters == hard.parameters) == (axis not in ("mass", "soil-strength"))
    heavy, light = (drawn["mass", bp.AXES["mass"].level(s)].parameters for s in (0.5, 0.0))
    assert heavy.mass / light.mass == pytest.approx(10.0**0.5) == heavy.inertia / light.inertia
    weak = drawn["soil-strength", bp.AXES["soil-strength"].level(0.5)].parameters
    frictions = math.tan(weak.friction_angle), math.tan(light.friction_angle)
    assert frictions[0] / frictions[1] == pytest.approx(0.02**0.5)
    assert weak.cohesion == pytest.approx(light.cohesion * 0.02**0.5)


def test_an_environment_without_axes_is_refused():
    with pytest.raises(ValueError, match="has no breaking points"):
        bp.set_of(TERRAIN_ID, "mass", 1.0)


def test_the_command_writes_points_and_continues_with_what_is_missing(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(bp, "BISECTIONS", 2)
    arguments = ["--policies", "nominal", "--axes", "mass", "--episodes", "2"]
    arguments += ["--output", str(tmp_path)]
    assert bp.main(arguments, "program") == 0
    (folder,) = tmp_path.iterdir()
    with (folder / "breaking_points.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert 1.0 <= float(row["stands"]) < float(row["breaks"]) <= 10.0
    assert (row["trained_low"], row["trained_high"]) == ("0.5", "2.0")
    before = (folder / "episodes.jsonl").read_bytes()
    assert bp.main(arguments, "program") == 0
    assert (folder / "episodes.jsonl").read_bytes() == before
    monkeypatch.setattr(bp, "BISECTIONS", 3)
    assert bp.main(arguments, "program") == 0
    later = (folder / "episodes.jsonl").read_bytes()
    assert later.startswith(before) and later.count(b"\n") == before.count(b"\n") + 1
    capsys.readouterr()
    with pytest.raises(SystemExit, match="2"):
        bp.main([*arguments, "--axes", "colour"], "program")
    assert "--axes: invalid choice: 'colour'" in capsys.readouterr().err


def after(uncertainty_set, **rmse):
    """A row of one set with these RMSEs after the change; `oracle` reads the truth."""
    given = records(uncertainty_set, **dict.fromkeys(rmse, EASY))
    for record in given:
        value = float(rmse[record["policy"]][record["episode"]])
        lost = np.isnan(value) and record["policy"] == "x"
        record |= {"rmse_after_change": None if np.isnan(value) else value, "max_error": 5.0}
        record |= {"terminated": float(lost), "recovery_time": 1.0}
        if record["policy"] == "oracle":
            record |= {READS_TRUTH: True, "tracking_rmse": 0.9 * record["tracking_rmse"]}
    return rows_of(given)[uncertainty_set]


def test_regret_is_to_the_ceiling_and_worth_to_the_frozen_one():
    found = ad.scores(after("a", oracle=EASY, x=EASY + 0.01, **{"x frozen": 3.0 * (EASY + 0.01)}))
    assert set(found) == {"oracle", "x"}
    assert tuple(found["x"].regret or ()) == pytest.approx((0.01, 0.01, 0.01))
    assert tuple(found["x"].worth or ()) == pytest.approx((3.0, 3.0, 3.0))
    assert found["oracle"].worth is None
    assert tuple(found["oracle"].regret or ()) == (0.0, 0.0, 0.0)
    assert [len(row) for row in ad.table({"a": found})] == [7, 7, 7]


def test_an_episode_that_is_lost_before_the_change_counts_with_the_error_where_it_ended():
    early = np.where(np.arange(16) < 4, np.nan, EASY)
    found = ad.scores(after("a", oracle=EASY, x=early))
    assert found["x"].episodes == 16
    assert found["x"].rmse.value == pytest.approx((4 * 5.0 + EASY[4:].sum()) / 16.0)
    without = ad.scores(after("a", oracle=early, x=EASY))  # no change there: not counted
    assert without["x"].episodes == 12


def test_there_is_no_score_without_any_change_and_no_regret_without_a_ceiling():
    assert ad.scores(after("a", oracle=np.nan * EASY, y=np.nan * EASY)) == {}
    assert ad.scores(after("a", y=EASY))["y"].regret is None


class Settings(NamedTuple):
    gain: float = 3.0
    off: float = 0.0
    bound: float = math.inf


def tuned(context, **settings):
    return Constant(Settings(**settings).gain, 0.0)


tuned.TUNABLE = {"gain": (1.0, 9.0, True), "off": (0.0, 1.0, False), "bound": (0.1, 9.0, True)}  # type: ignore[attr-defined]
tuned.SETTINGS = lambda context: Settings()  # type: ignore[attr-defined]


def candidate(rmse, settled, rate=1.0, lost=0.0, gain=1.0):
    outcome = tuning.Outcome(rmse, settled, lost, rate)
    return tuning.Candidate("search", {"gain": gain}, {"payload": outcome}, 1.1)


def test_the_best_of_each_measure_is_picked_unless_it_acts_faster_or_loses_more():
    default = candidate(0.10, 0.10)
    whole, after = candidate(0.08, 0.12, gain=2.0), candidate(0.12, 0.08, gain=3.0)
    hasty, losing = candidate(0.01, 0.01, 1.2, gain=4.0), candidate(0.02, 0.02, lost=0.9, gain=5.0)
    found = headline.best_of([default, whole, after, hasty, losing])
    assert found["whole episodes"] is whole and found["after 5 s"] is after
    assert headline.best_of([default, candidate(0.2, 0.2, gain=6.0)]) == {}


def challenger(name, controller="adaptive"):
    entry = PolicyEntry(f"{controller}, best {name}", tuned, name)
    return headline.Challenger(controller, name, {"gain": 1.0}, entry)


def results_of(factor, settled, rate=1.0):
    """A challenger of `adaptive` with these errors and this action rate over its own."""
    one = challenger("whole episodes")
    errors = {one.entry.name: factor * EASY, "adaptive": EASY, "ppo@0": 0.99 * EASY}
    given = [record for name in ("a", "b") for record in records(name, **errors)]
    for record in given:
        own = record["policy"] == one.entry.name
        record["settled_rmse"] = 0.5 * EASY.mean() * (settled if own else 1.0)
        record["torque_rate"] = 100.0 * (rate if own else 1.0)
    sets = headline.of_sets(given)
    usual = headline.ranking(sets, ["adaptive", "ppo"], "adaptive")
    return headline.result_table(sets, [one], usual, "adaptive")


def test_the_headline_breaks_where_settings_from_outside_are_better_at_the_same_rate():
    cases = [(0.98, 0.98, 1.0, 0), (0.96, 1.0, 1.0, 1), (1.2, 0.96, 1.0, 1), (0.9, 0.9, 1.0, 2)]
    for factor, settled, rate, count in (*cases, (0.9, 0.9, 1.2, 0), (1.5, 1.5, 1.0, 0)):
        cells, results = results_of(factor, settled, rate)
        said = headline.broken(results)
        assert len(said) == count, (factor, settled, rate)
        row = dict(zip(cells[0], cells[1], strict=True))
        assert row["error / default"].startswith(f"{factor:.3f}")
        assert row["action rate"] == f"{rate:.2f}"
        assert row["rank"] == ("1" if factor < 0.99 else "2")


@pytest.mark.slow
def test_it_chooses_on_some_episodes_confirms_on_others_and_continues(tmp_path, capsys):
    arguments = ["--policies", "adaptive", "nominal", "--sets", "payload", "--episodes", "2"]
    arguments += ["--budget", "3", "--confirm", "3", "--output", str(tmp_path)]
    status = headline.main(arguments, "program")
    (folder,) = tmp_path.iterdir()
    assert folder.name.startswith(f"headline-{AUDIT}-")
    text = capsys.readouterr().out
    assert f"chosen from seed {AUDIT}, driven from seed {AUDIT + headline.CONFIRMED}" in text
    chosen = {path.name: path.read_bytes() for path in (folder / "chosen").glob("*.csv")}
    assert len(chosen) == 2
    before = (folder / "episodes.jsonl").read_bytes()
    assert f'"seed": {AUDIT + headline.CONFIRMED + 2}'.encode() in before
    assert f'"seed": {AUDIT + headline.CONFIRMED + 3}'.encode() not in before
    assert headline.main(arguments, "program") == status
    assert (folder / "episodes.jsonl").read_bytes() == before
    assert {p.name: p.read_bytes() for p in (folder / "chosen").glob("*.csv")} == chosen


@pytest.mark.slow
def test_without_a_reference_the_first_policy_is_the_reference(tmp_path, capsys):
    arguments = ["--policies", "nominal", "--sets", "payload", "--episodes", "2", "--budget", "2"]
    headline.main([*arguments, "--output", str(tmp_path)], "program")
    assert "/ nominal" in capsys.readouterr().out


@pytest.mark.slow
def test_vehicles_from_40_kg_to_61_t_are_driven_as_well_as_those_of_the_ids(tmp_path):
    """Errors in contact lengths; the starts of slow drives take longer, hence 1.6 and not 1."""
    names = ["strawa", "focchi", "inspection-robot", "excavator", "main-battle-tank"]
    options = ["--vehicles", *names, "--policies", "adaptive", "--episodes", "8"]
    assert vehicle_sizes.main([*options, "--output", str(tmp_path)], "vehicle_sizes") == 0
    (path,) = tmp_path.glob("*/vehicle_sizes.csv")
    rows = list(csv.DictReader(path.open(encoding="utf-8")))
    assert [row["vehicle"] for row in rows] == names
    for column in ("adaptive: whole", "adaptive: after 5 s"):
        error = [float(row[column]) for row in rows]
        assert max(error[2:]) < 1.6 * max(error[:2])
    assert all(row["adaptive: lost"] == "0" for row in rows)
