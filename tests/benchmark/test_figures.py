"""Figures of a tiny benchmark: they are drawn, and what they show is legible."""

import numpy as np
import pytest

from tests.benchmark.stub_policies import Believing, Constant, entry
from tracked_env.benchmark import BenchmarkConfig, Store, figures, run
from tracked_env.benchmark.store import Record

Finished = tuple[Store, list[Record]]
CONFIG = BenchmarkConfig(sets=("payload",), episodes=3, duration=6.0)
POLICIES = [
    entry("coast", lambda context: Constant(0.0, 0.0)),  # stays near for a while
    entry("spin", lambda context: Constant(-1.0, 1.0)),  # leaves the path
]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A store and its records."""
    store = Store(tmp_path_factory.mktemp("run"), CONFIG.identity())
    return store, run(CONFIG, POLICIES, store)


def drawn(finished):
    """The traces of every set."""
    store, _ = finished
    found = {}
    for name in CONFIG.sets:
        loaded = {policy.name: store.load_trace(policy.name, name) for policy in POLICIES}
        found[name] = {policy: trace for policy, trace in loaded.items() if trace is not None}
    return found


def test_a_set_gets_two_pictures_and_there_is_one_of_all_sets(finished, tmp_path):
    store, records = finished
    files = figures.save_all(tmp_path, store, records, CONFIG.sets, CONFIG.seed)
    assert sorted(path.name for path in files) == [
        "drive-payload.svg",
        "errors.svg",
        "paths-payload.svg",
    ]
    assert all("<svg" in path.read_text() and "<image" not in path.read_text() for path in files)


@pytest.mark.parametrize("damaged", [["coast"], ["coast", "spin"]])
def test_a_damaged_trace_is_left_out_of_the_figures_and_the_others_are_drawn(
    finished, tmp_path, damaged
):
    original, records = finished
    store = Store(tmp_path / "copy", CONFIG.identity())
    for policy in POLICIES:
        trace = original.load_trace(policy.name, "payload")
        store.save_trace(policy.name, "payload", trace)
        if policy.name in damaged:
            store.trace_path(policy.name, "payload").write_bytes(b"mine")
    files = figures.save_all(tmp_path, store, records, CONFIG.sets, CONFIG.seed)
    assert len(files) == (3 if len(damaged) == 1 else 0)
    assert len(store.notices) == len(damaged)


def test_policies_of_which_fewer_episodes_were_kept_are_drawn_and_names_are_no_formulas(
    finished, tmp_path
):
    original, records = finished
    store = Store(tmp_path / "copy", CONFIG.identity())
    odd = {"coast": "$\\foo$", "spin": "spin"}
    for name, new in odd.items():
        trace = original.load_trace(name, "payload")
        kept = 1 if name == "coast" else 3
        store.save_trace(new, "payload", {**trace, "motion": trace["motion"][:, :kept]})
    renamed = [{**r, "policy": odd[r["policy"]]} for r in records]
    files = figures.save_all(tmp_path, store, renamed, CONFIG.sets, CONFIG.seed)
    assert len(files) == 3


def test_every_axis_has_a_label_with_its_unit_and_the_legend_lies_above_all_panels(finished):
    traces, style = drawn(finished), figures.looks(["coast", "spin"])
    for figure in (
        figures.drive("payload", traces["payload"], style),
        figures.paths("payload", traces["payload"], style, seed=0),
        figures.errors(traces, style),
    ):
        labels = [text for of in figure.axes for text in (of.get_xlabel(), of.get_ylabel()) if text]
        assert labels and all("[" in label for label in labels)
        figure.canvas.draw()
        legend = figure.legends[0].get_window_extent()
        assert figure.legends[0].get_title().get_text()
        assert legend.y0 >= max(axes.get_tightbbox().y1 for axes in figure.axes)
        assert legend.x0 >= 0  # a picture is as wide as a long title


def test_paths_mark_where_a_policy_left_and_have_the_errors_over_time_below_them(finished):
    style = figures.looks(["coast", "spin"])
    figure = figures.paths("payload", drawn(finished)["payload"], style, seed=0)
    crosses = [line for line in figure.axes[0].lines if line.get_marker() == "X"]
    assert style["spin"].colour in {line.get_color() for line in crosses}
    below = [axes for axes in figure.axes if axes.get_xlabel() == "time [s]"]
    assert len(below) == 3 and all(len(axes.lines) == 2 for axes in below)
    assert all(axes.get_yscale() == "log" for axes in below)


@pytest.fixture(scope="module")
def believed(tmp_path_factory):
    """A store with a policy that estimates parameters, one of them with a wide band."""
    store = Store(tmp_path_factory.mktemp("believed"), CONFIG.identity())
    guess = {"mass": (1450.0, 100.0), "lateral_resistance": (0.8, 1e3), "slip_left": (0.0, 0.1)}
    policies = [
        entry("coast", lambda context: Constant(0.0, 0.0)),
        entry("guess", lambda context: Believing(guess, 0.0)),
    ]
    return store, run(CONFIG, policies, store)


def test_the_picture_of_beliefs_shows_truth_and_estimate_however_wide_the_band(believed, tmp_path):
    store, records = believed
    files = figures.save_all(tmp_path, store, records, CONFIG.sets, CONFIG.seed)
    assert "beliefs-payload.svg" in [path.name for path in files]
    traces = {name: store.load_trace(name, "payload") or {} for name in ("coast", "guess")}
    figure = figures.beliefs("payload", traces, figures.looks(["coast", "guess"]), seed=0)
    assert len(figure.axes) == 2 * 3  # mass and lateral resistance of three episodes
    assert "[kg]" in figure.axes[0].get_ylabel()
    low, high = figure.axes[0].get_ylim()
    masses = traces["guess"]["believed_truth"][:, 0]
    assert low < min(np.nanmin(masses), 1450.0)
    assert max(np.nanmax(masses), 1450.0) < high
    assert figure.axes[3].get_ylim()[1] < 2.0  # not the 2000 of the claimed band
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["true", "guess"]


def test_without_estimates_there_is_no_picture_of_beliefs(finished):
    traces, style = drawn(finished), figures.looks(["coast", "spin"])
    assert figures.beliefs("payload", traces["payload"], style, seed=0) is None


def test_policies_differ_in_more_than_colour():
    style = figures.looks([f"policy {i}" for i in range(6)])
    for part in zip(*style.values(), strict=True):
        assert len(set(part)) == 6


def test_a_figure_draws_five_policies_in_the_order_that_is_given_and_keeps_its_legend_whole(
    finished, tmp_path
):
    original, records = finished
    names = [f"policy-with-quite-a-long-name-{i}" for i in range(7)]
    store = Store(tmp_path / "copy", CONFIG.identity())
    trace = original.load_trace("coast", "payload")
    for name in names:
        store.save_trace(name, "payload", trace)
    own = [r for r in records if r["policy"] == "coast"]
    given = [{**r, "policy": name} for name in names for r in own]
    wanted = [names[i] for i in (6, 0, 3, 5, 1, 2)]
    files = figures.save_all(tmp_path, store, given, CONFIG.sets, 0, wanted)
    for path in files:
        text = path.read_text()
        shown = sorted((text.index(f"{name}<"), name) for name in names if f"{name}<" in text)
        assert {name for _, name in shown} == set(wanted[:5]), path.name
    style = figures.looks(wanted[:5])
    traces = dict.fromkeys(wanted[:5], trace)
    figure = figures.drive("payload", traces, style)
    figure.canvas.draw()
    legend = figure.legends[0].get_window_extent()
    assert len(figure.legends[0].get_texts()) == 5
    assert legend.x1 <= figure.bbox.x1
    assert legend.y0 >= max(axes.get_window_extent().y1 for axes in figure.axes)
