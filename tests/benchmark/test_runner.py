"""The paired runner: same episodes for all, nothing lost, nothing seen that must not be."""

import sys
import time

import numpy as np
import pytest

from tests.benchmark.stub_policies import Constant, Curious, Truthful, entry
from tracked_env import SPEED_ID, TERRAIN_ID
from tracked_env.benchmark import (
    DEFAULT_SETS,
    SETS,
    BenchmarkConfig,
    Store,
    default_sets,
    run,
    runner,
)
from tracked_env.benchmark.evaluation_sets import NEWEST
from tracked_env.benchmark.metrics import METRICS
from tracked_env.benchmark.policy_interface import PolicyError, checked_answer
from tracked_env.benchmark.runner import drive, pending
from tracked_env.benchmark.store import figure_data
from tracked_env.physics.parameters import PARAMETER_NAMES, VEHICLES
from tracked_env.sensors import STRAWA
from tracked_env.uncertainty import known_laws

NOMINAL = VEHICLES["strawa"]
SHORT = BenchmarkConfig(sets=("soil-and-mass",), episodes=4, duration=2.0)
SECOND = BenchmarkConfig(duration=1.0)  # 50 steps: too short to leave the path
COAST = entry("coast", lambda context: Constant(0.0, 0.0))
SPIN = entry("spin", lambda context: Constant(-1.0, 1.0))


def done(folder, config, *policies, **options):
    return run(config, policies, Store(folder, config.identity()), **options)


def values(records):
    """Records without the time that a computer took."""
    return [{k: v for k, v in r.items() if k != "predict_time"} for r in records]


def test_there_is_one_record_per_set_policy_and_episode_in_the_order_asked_for(tmp_path):
    config = BenchmarkConfig(sets=("payload", "ood"), episodes=3, duration=0.5, seed=7)
    records = done(tmp_path, config, SPIN, COAST)
    assert [(r["set"], r["policy"], r["episode"], r["seed"]) for r in records] == [
        (s, p, i, 7 + i) for s in ("payload", "ood") for p in ("spin", "coast") for i in range(3)
    ]
    assert all(set(METRICS) <= set(r) for r in records)


def test_every_policy_meets_the_same_episodes(tmp_path):
    records = done(tmp_path, SHORT, COAST, SPIN)
    digests = [[r["digest"] for r in records if r["policy"] == p] for p in ("coast", "spin")]
    assert digests[0] == digests[1]
    assert len(set(digests[0])) == SHORT.episodes


def test_every_policy_meets_the_same_noise_however_it_drives():
    noises = []
    for action in ((0.0, 0.0), (-1.0, 1.0)):
        policy = Constant(*action)
        env = SHORT.environment("soil-and-mass", 2, truth=False)
        trace, _ = drive(policy, env, [0, 1], lambda: None)
        measured = np.array(policy.observations)[1:, :, 3] * 2.0  # v_x [m/s]
        true = trace.channel("speed_error")
        reference = np.array(policy.observations)[1:, :, 13] * 2.0
        noises.append(measured - (reference - true[:-1]))
    assert np.std(noises[0]) == pytest.approx(0.03, rel=0.2)
    assert np.allclose(noises[0], noises[1], atol=1e-5)


def test_the_rmse_is_the_one_that_the_environment_counts():
    env = SECOND.environment("soil-and-mass", 3, truth=False)
    trace, _ = drive(Constant(0.2, 0.3), env, [0, 1, 2], lambda: None)
    error = trace.channel("error")
    assert np.sqrt(np.mean(error**2, axis=0)) == pytest.approx(env.simulation.rmse, rel=1e-12)


def test_an_episode_that_leaves_the_path_ends_alone_and_counts_the_limit(tmp_path):
    config = BenchmarkConfig(sets=("nominal",), episodes=4, duration=8.0)
    records = done(tmp_path, config, SPIN)
    assert {r["ended"] for r in records} == {"off-path"}
    assert len({r["driven_time"] for r in records}) > 1
    for record in records:
        lacking = 1.0 - record["driven_time"] / 8.0
        assert record["tracking_rmse"] >= 5.0 * np.sqrt(lacking)
        assert record["final_error"] == 5.0


def test_a_policy_gets_its_state_back_and_is_told_of_the_start_once():
    policy = Constant()
    drive(policy, SECOND.environment("payload", 2, truth=False), [0, 1], lambda: None)
    assert [state for state, _ in policy.calls] == [None, *range(1, 50)]
    assert [start.tolist() for _, start in policy.calls[:2]] == [[True, True], [False, False]]
    assert not any(start.any() for _, start in policy.calls[1:])


def test_the_truth_is_handed_over_before_every_action_and_holds_what_changes():
    policy = Truthful()
    drive(policy, SECOND.environment("payload", 3, truth=True), [0, 1, 2], lambda: None)
    assert len(policy.told) == len(policy.calls) == 50
    assert set(PARAMETER_NAMES) <= set(policy.told[0])
    assert not [name for name in policy.told[0] if name.startswith("_")]
    assert policy.told[0]["mass"].tolist() == [NOMINAL.mass] * 3
    assert np.all(policy.told[-1]["mass"] != NOMINAL.mass)  # the payload has stepped


def test_a_policy_is_told_the_data_sheet_of_the_sensors_and_nothing_of_the_truth(tmp_path):
    config = BenchmarkConfig(
        sets=("ood",), episodes=1, duration=0.5, sensors={"preset": "strawa", "gyro_noise": 0.5}
    )
    told = []

    def make(context):
        told.append(context)
        return Constant()

    done(tmp_path, config, entry("curious", make))
    (context,) = told
    assert context.sensors == STRAWA._replace(gyro_noise=0.5)
    assert context == config.context("ood")
    fields = "control_period lateral sensors drive vehicle observation"
    assert context._fields == tuple(fields.split())


def test_no_other_policy_is_handed_the_truth(tmp_path):
    records = done(tmp_path, SHORT, entry("curious", lambda context: Curious()))
    assert len(records) == SHORT.episodes


class Interrupting(Constant):
    """Ctrl-C when the clock has run `after` steps in all."""

    def __init__(self, clock, after):
        super().__init__(0.0, 0.0)
        self.clock, self.after = clock, after

    def predict(self, *args, **kwargs):
        self.clock[0] += 1
        if self.clock[0] == self.after:
            raise KeyboardInterrupt
        return super().predict(*args, **kwargs)


def test_an_interruption_loses_only_the_chunk_in_progress(tmp_path):
    config = BenchmarkConfig(sets=("payload", "ood"), episodes=4, duration=1.0, chunk=2)
    clock = [0]
    policy = entry("coast", lambda context: Interrupting(clock, after=130))
    with pytest.raises(KeyboardInterrupt):
        done(tmp_path, config, policy)
    store = Store(tmp_path, config.identity())
    tasks = [(task.uncertainty_set, task.episodes) for task in pending(config, [policy], store)]
    assert tasks == [("ood", (0, 1)), ("ood", (2, 3))]
    clock[0] = 1000
    continued = run(config, [policy], store)
    assert clock[0] == 1000 + 2 * 50
    assert values(continued) == values(done(tmp_path / "new", config, COAST))


def test_a_rerun_does_what_is_new_or_of_another_source_and_nothing_again(tmp_path):
    first = done(tmp_path, SHORT, COAST, SPIN)

    def refuse(context):
        raise AssertionError("a finished episode ran again")

    assert done(tmp_path, SHORT, entry("coast", refuse), entry("spin", refuse)) == first
    more = BenchmarkConfig(sets=("soil-and-mass", "ood"), episodes=6, duration=2.0)
    store = Store(tmp_path, more.identity())
    changed = entry("spin", SPIN.make, fingerprint="2")
    tasks = list(pending(more, [COAST, changed], store))
    assert [(t.policy, t.uncertainty_set, t.episodes) for t in tasks] == [
        ("coast", "soil-and-mass", (4, 5)),
        *(("spin", "soil-and-mass", tuple(range(6))), ("coast", "ood", tuple(range(6)))),
        ("spin", "ood", tuple(range(6))),
    ]


class Answering(Constant):
    """Answers with what it was built with, or raises it."""

    def __init__(self, answer):
        super().__init__()
        self.answer = answer

    def predict(self, *args, **kwargs):
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer


ACTIONS = np.zeros((4, 2), np.float32)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, r"`predict` returned None; must be a pair"),
        (ACTIONS, r"`predict` returned array.*must be a pair"),
        ((ACTIONS,), "must be a pair"),
        ((None, None), r"actions of shape \(\) and type object; must be numbers of shape \(4, 2\)"),
        ((ACTIONS[0], None), r"actions of shape \(2,\)"),
        ((ACTIONS[:3], None), r"actions of shape \(3, 2\)"),
        ((ACTIONS.T, None), r"actions of shape \(2, 4\)"),
        ((ACTIONS.astype(str), None), "type <U"),
        ((ACTIONS * 1j, None), "type complex64"),
        (([[1, 2], [3]], None), "ValueError"),
        ((np.full((4, 2), np.nan), None), r"action\[0\] = \[nan, nan\]; must be finite"),
        ((np.full((4, 2), -np.inf), None), "must be finite"),
        (
            ZeroDivisionError("over\n0"),
            r"ZeroDivisionError: over 0 \(.*test_runner.py, line \d+, in",
        ),
        (SystemExit(0), r"it called sys.exit\(0\), which a policy must not do"),
        (SystemExit("bye"), r"it called sys.exit\('bye'\)"),
        (MemoryError(), "MemoryError"),
    ],
)
def test_a_policy_that_answers_wrongly_raises_or_exits_is_named_in_one_line(
    tmp_path, answer, message
):
    said = f"^policy 'wrong', set 'soil-and-mass', step 0: .*{message}"
    with pytest.raises(PolicyError, match=said) as caught:
        done(tmp_path, SHORT, entry("wrong", lambda context: Answering(answer)))
    assert "\n" not in str(caught.value)
    assert Store(tmp_path, SHORT.identity()).chunks == []


def test_actions_beyond_the_limits_and_of_other_types_are_taken_as_the_environment_does():
    given = np.array([[2.0, -1e300], [0.1, 1.0]])
    action, state = checked_answer((given, "mine"), 2)
    assert action.dtype == np.float32
    assert action.tolist() == [[1.0, -1.0], [np.float32(0.1), 1.0]]
    assert state == "mine"
    assert checked_answer(([[0, 1], [1, 0]], None), 2)[0].tolist() == [[0.0, 1.0], [1.0, 0.0]]


class Alternating(Constant):
    """Demands 0.3 and 0.2 of the limit in turn, on both sides."""

    def predict(self, *args, **kwargs):
        self.action = (0.3, 0.3) if len(self.calls) % 2 else (0.2, 0.2)
        return super().predict(*args, **kwargs)


@pytest.mark.parametrize(
    ("name", "rate", "limit", "lacking"),
    [
        ("nominal", "torque_rate", NOMINAL.torque_limit, "sprocket_speed_rate"),
        ("floor", "sprocket_speed_rate", VEHICLES["focchi"].sprocket_speed_limit, "torque_rate"),
    ],
)
def test_the_action_rate_of_an_environment_is_that_of_what_its_action_commands(
    tmp_path, name, rate, limit, lacking
):
    config = BenchmarkConfig(sets=(name,), episodes=1, duration=1.0)  # 49 changes in 50 steps
    (record,) = done(tmp_path, config, entry("alternating", lambda context: Alternating()))
    assert record[rate] == pytest.approx(0.1 * limit / 0.02 * 49 / 50, rel=1e-5)
    assert record[lacking] is None


def test_progress_adds_up_to_every_step_of_every_vehicle(tmp_path):
    config = BenchmarkConfig(sets=("nominal",), episodes=4, duration=8.0)  # SPIN ends early
    reported = []
    report = lambda steps, label: reported.append(steps)  # noqa: E731
    done(tmp_path, config, COAST, SPIN, progress=report)
    assert sum(reported) == 2 * 4 * 400
    assert min(reported) >= 0


def test_what_is_kept_for_the_figures_is_small():
    env = BenchmarkConfig(episodes=8).environment("drift", 8, truth=False)
    trace, _ = drive(Constant(0.0, 0.0), env, range(8), lambda: None)
    kept = figure_data(trace)
    assert kept["error"].shape == (300, 8)
    assert kept["motion"].shape[1] == 4
    assert sum(array.nbytes for array in kept.values()) < 600_000


def test_the_default_sets_are_those_in_which_something_is_unknown():
    named = {*DEFAULT_SETS, *default_sets(SPEED_ID), *default_sets(TERRAIN_ID)}
    assert named == {name for version in NEWEST for name in version.sets}
    assert not named & {"nominal", "floor", "level"}
    laws = {entry.uncertainty for entry in SETS.values()}
    assert laws == {*known_laws()} - {"any-vehicle"}  # which gives a fleet its vehicles


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sets": ("ood", "soil")}, "unknown evaluation set 'soil'"),
        ({"sets": ("ood", "friction")}, "must be of one environment"),
        ({"sets": ()}, "must be one or more"),
        ({"sets": ("ood", "ood")}, "each named once"),
        ({"episodes": 0}, "episodes = 0; must be at least 1"),
        ({"seed": -1}, "seed = -1; must be at least 0"),
        ({"sensors": "gps"}, "unknown sensor preset 'gps'"),
        ({"duration": 0.0}, "duration = 0.0 s"),
        ({"reference": "cirle"}, "unknown reference kind 'cirle'"),
    ],
)
def test_a_wrong_configuration_is_refused_at_once(wrong, message):
    with pytest.raises(ValueError, match=message):
        BenchmarkConfig(**wrong)


@pytest.mark.parametrize(("period", "lines"), [(0.0, 10), (0.2, 3)])
def test_in_a_log_progress_is_a_plain_line_at_most_every_period(period, lines, capsys, monkeypatch):
    monkeypatch.setattr(runner, "LOG_PERIOD", period)
    with runner.progress_bar(1000) as report:
        for _ in range(10):
            report(100, "payload: oracle")
            time.sleep(0.05)
    shown = capsys.readouterr()
    assert shown.out == "" and "\r" not in shown.err
    assert lines - 2 <= shown.err.count("\n") <= lines + 2
    assert "payload: oracle" in shown.err and "100%" in shown.err


@pytest.mark.parametrize(("quiet", "terminal"), [(True, True), (True, False), (False, False)])
def test_a_short_run_in_a_log_and_a_quiet_one_show_no_progress(
    quiet, terminal, capsys, monkeypatch
):
    monkeypatch.setattr(runner, "LOG_PERIOD", 0.0 if quiet else 30.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    with runner.progress_bar(10, quiet) as report:
        report(10, "drift: adaptive")
    assert capsys.readouterr().err == ""
