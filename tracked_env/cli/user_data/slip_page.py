"""The report of a slip that was fitted to a user's runs: tables and figures on one page."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tracked_env.benchmark.drawing import PALETTE, STYLE, inline_svg, new_figure, svg_text
from tracked_env.benchmark.leaderboard_page import Drawing, Section, page_text
from tracked_env.benchmark.text_tables import plain_table
from tracked_env.cli.user_data.slip_fit import Fitted

LABELS = ("beta left [m/s]", "beta right [m/s]", "alpha [rad]")
R2_LABELS = ("beta_left", "beta_right", "alpha, forward", "alpha, in reverse")
FILES = {
    "slip.npz": "the model, for `baselines.slip.slip_models.load` and the policies `slc`",
    "slip.csv": "every sample with its prediction by a fit that has not seen its run",
}


def score_rows(fitted: Fitted) -> list[list[str]]:
    """Rows of cells, the header first: R^2 and errors on runs not seen.

    Where runs were left out as corrupt, R^2 with them stands beside the one without.
    """
    data, left, right, alpha = fitted.data, *fitted.predicted
    rows = [["quantity", "unit", "samples", "R^2, runs not seen", "rms error", "largest slip"]]
    if fitted.outliers:
        rows[0].insert(4, "with those left out")
    forward, reverse = data.v_x > 0.05, data.v_x < -0.05
    every = np.ones(len(left), dtype=bool)
    parts = (
        (data.beta_left, left, every, "m/s"), (data.beta_right, right, every, "m/s"),
        (data.alpha, alpha, forward, "rad"), (data.alpha, alpha, reverse, "rad"),
    )  # fmt: skip
    for label, score, of_all, (true, found, chosen, unit) in zip(
        R2_LABELS, fitted.scores, fitted.scores_of_all, parts, strict=True
    ):
        with_all = [_shown(of_all)] if fitted.outliers else []
        if not chosen.any():
            rows.append([label, unit, "0", "-", *with_all, "-", "-"])
            continue
        error = np.sqrt(np.mean((true[chosen] - found[chosen]) ** 2))
        rows.append([label, unit, f"{chosen.sum()}", _shown(score), *with_all, f"{error:.4f}",
                     f"{np.abs(true[chosen]).max():.3f}"])  # fmt: skip
    return rows


def _shown(score: float) -> str:
    return f"{score:.3f}" if score == score else "-"


def refused_rows(fitted: Fitted) -> list[list[str]]:
    """Rows of cells, the header first: runs that are not used, and why."""
    return [["run", "reason"], *([r.run, r.reason] for r in fitted.runs.refused)]


def page(fitted: Fitted, subject: str, facts: Mapping[str, str], draw: bool = True) -> str:
    """The whole page."""
    runs = len(np.unique(fitted.runs.run))
    used = plain_table(
        "Each run is predicted by a fit of other runs: R^2 is 1 where all of it is explained and 0 "
        "where the mean says as much",
        score_rows(fitted), (0,), [],
    )  # fmt: skip
    refused = plain_table("Runs that are not used", refused_rows(fitted), (0,), [])
    for row in refused.rows:
        row[1] = row[1]._replace(kind="name")
    figures = _drawings(fitted) if draw else []
    sections = [
        Section("R^2 on runs not seen", "scores", [used], figures[:1]),
        Section("Surfaces", "surfaces", figures=figures[1:]),
        Section("Runs left out", "refused", [refused] if len(refused.rows) else ()),
        Section("Provenance", "provenance", facts=facts),
        Section("Files", "files", links=FILES),
    ]
    introduction = [
        f"{len(fitted.data.alpha)} samples of {runs} runs are used; {len(fitted.runs.refused)} "
        f"runs or samples are not, {fitted.outliers} of them because they contradict both belts. "
        f"In the runs that are used {fitted.runs.rows_left_out} rows are left out."
    ]
    kept = [part for part in sections if any(part[2:])]
    return page_text("Slip", subject, introduction, kept, "run or reason")


def _drawings(fitted: Fitted) -> list[Drawing]:
    try:
        import matplotlib
    except ImportError:
        return []
    with matplotlib.rc_context({**STYLE, "text.parse_math": False}):
        figures = (
            ("Predicted and measured", "Each sample by a fit that has not seen its run; on the "
             "dashed line the prediction is exact.", _predicted(fitted)),
            ("Slip over the sprocket speeds", "Colour: the model; circles: samples in the same "
             "colours.", _surfaces(fitted)),
        )  # fmt: skip
        return [
            Drawing(title, text, inline_svg(svg_text(figure, title), title))
            for title, text, figure in figures
        ]


def _true(fitted: Fitted) -> tuple[Any, Any, Any]:
    return fitted.data.beta_left, fitted.data.beta_right, fitted.data.alpha


def _predicted(fitted: Fitted) -> Any:
    figure, panels = new_figure((2.6, 2.4), 1, 3, gap=(0.75, 0.4))
    for axes, label, true, found in zip(
        panels[0], LABELS, _true(fitted), fitted.predicted, strict=True
    ):
        both = np.concatenate([true, found])
        ends = [both.min(), both.max()]
        axes.plot(ends, ends, "--", color="0.5", linewidth=1.0)
        axes.plot(true, found, "o", color=PALETTE[1], markersize=2.5, alpha=0.7)
        axes.set_title(label, loc="left", fontsize=9)
        axes.set_xlabel("measured")
    panels[0, 0].set_ylabel("predicted")
    return figure


def _surfaces(fitted: Fitted) -> Any:
    data = fitted.data
    figure, panels = new_figure((2.6, 2.4), 1, 3, gap=(0.75, 0.4), sharex=True, sharey=True)
    left, right = np.meshgrid(
        np.linspace(data.sprocket_left.min(), data.sprocket_left.max(), 40),
        np.linspace(data.sprocket_right.min(), data.sprocket_right.max(), 40),
    )
    surfaces = fitted.model.slip(left.ravel(), right.ravel())
    for axes, label, surface, true in zip(panels[0], LABELS, surfaces, _true(fitted), strict=True):
        reach = float(np.percentile(np.abs(true), 98.0)) + 1e-6
        shown = {"vmin": -reach, "vmax": reach, "cmap": "RdBu_r"}
        axes.contourf(left, right, np.clip(surface, -reach, reach).reshape(left.shape),
                      np.linspace(-reach, reach, 15), cmap="RdBu_r")  # fmt: skip
        axes.scatter(data.sprocket_left, data.sprocket_right, c=true, s=9.0, edgecolors="0.2",
                     linewidths=0.3, **shown)  # fmt: skip
        axes.set_title(f"{label}, +-{reach:.2g}", loc="left", fontsize=9)
        axes.set_xlabel("left sprocket [rad/s]")
    panels[0, 0].set_ylabel("right sprocket [rad/s]")
    return figure
