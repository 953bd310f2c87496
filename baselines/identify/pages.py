"""The report of a slip that was fitted to a user's runs: tables and figures on one page.

The report of an identified log: one page that needs no other file, tables and figures.

Figures need matplotlib (extra `render`); without it the page has its tables alone.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from baselines.identify.identify_log import (
    CONSTANT,
    NAMES,
    NORMAL,
    SOIL,
    WHITE_LAGS,
    Identified,
    autocorrelation,
    untold,
)
from baselines.identify.identify_slip import Fitted
from tracked_env.benchmark.figures import PALETTE, STYLE, inline_svg, new_figure, svg_text
from tracked_env.benchmark.leaderboard_page import Drawing, Section, page_text
from tracked_env.benchmark.text_tables import plain_table

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


if TYPE_CHECKING:
    from matplotlib.axes import Axes

POINTS = 600  # of a curve: more are not seen
ESTIMATE, CLAIM, CONSTANT_LINE = PALETTE[1], PALETTE[5], PALETTE[0]
FILES_LOG_PAGE = {
    "parameters.json": "the set of parameters, for gymnasium.make(id, **set['make'])",
    "identification.csv": "estimates, deviations, excitation and filtered motion of every step",
}
EXPECTED = {"longitudinal": 1.0, "turning": 1.0, "slip": 6.0}  # mean NIS, its dimension


def digits(value: float, count: int) -> str:
    """A number with so many significant digits, without an exponent."""
    return np.format_float_positional(value, count, unique=False, fractional=False, trim="-")


def result_rows(identified: Identified) -> list[list[str]]:
    """Rows of cells, the header first: what was found."""
    rows = [["parameter", "unit", "value", "standard deviation", "95 % interval", "nominal",
             "verdict"]]  # fmt: skip
    nominal = identified.nominal
    for name, of in identified.found.items():
        label, unit = NAMES[name]
        start = getattr(nominal, name, identified.series[name][0][0])
        verdict = of.verdict + (", changes" if of.changed else "")
        interval = f"{digits(of.low, 4)} to {digits(of.high, 4)}"
        rows.append([label, unit, digits(of.value, 4), digits(of.deviation, 2), interval,
                     digits(start, 4), verdict])  # fmt: skip
    return rows


def excitation_rows(identified: Identified) -> list[list[str]]:
    """Rows of cells, the header first: how far the log excites each estimator."""
    rows = [["estimator", "median excitation", "largest", "time with all parameters excited",
             "samples refused", "mean NIS", "expected"]]  # fmt: skip
    for name, excitation in identified.excitation.items():
        status, nis = identified.status[name], identified.nis[name]
        mean = f"{np.nanmean(nis):.2g}" if np.isfinite(nis).any() else "-"
        rows.append([name, digits(np.median(excitation), 3), digits(excitation.max(), 3),
                     f"{np.mean(status == 0):.0%}", f"{np.mean(status == 2):.1%}", mean,
                     f"{EXPECTED[name]:g}" if name in EXPECTED else "-"])  # fmt: skip
    return rows


def residual_rows(identified: Identified) -> list[list[str]]:
    """Rows of cells, the header first: residuals of the two regressions."""
    rows = [["equation", "samples", "mean", "rms", "beyond 1.96", "autocorrelation at lag 1",
             f"lags 1 to {WHITE_LAGS} beyond the band"]]  # fmt: skip
    for name, r in identified.residuals.items():
        if len(r) < 4 * WHITE_LAGS:
            rows.append([name, f"{len(r)}", *["-"] * 5])
            continue
        correlation = autocorrelation(r)
        outside = float(np.mean(np.abs(correlation) > NORMAL / np.sqrt(len(r))))
        rows.append([name, f"{len(r)}", f"{r.mean():.2f}", f"{np.sqrt(np.mean(r**2)):.2f}",
                     f"{np.mean(np.abs(r) > NORMAL):.1%}", f"{correlation[0]:.2f}",
                     f"{outside:.0%}"])  # fmt: skip
    return rows


def page_log_page(
    identified: Identified, subject: str, facts: Mapping[str, str], draw: bool = True
) -> str:
    """The whole page; subject: name of the log, facts: where the numbers come from."""
    results = plain_table(
        "What the log says. Constant parameters of the whole log, or where one changes its value "
        "at the end; a deviation holds the noise and the biases of the data sheet",
        result_rows(identified), (0,), [],
    )  # fmt: skip
    excitation = plain_table(
        "Excitation is the smallest eigenvalue of the information, 1 where data and prior weigh "
        "the same. NIS is the normalised innovation squared",
        excitation_rows(identified), (0,), [],
    )  # fmt: skip
    residuals = plain_table(
        "Residuals of each sample by the estimates before it, over the standard deviation that the "
        "data sheet gives: the rms is 1 and the autocorrelation 0 where model and data sheet are "
        f"right; 5 % of {WHITE_LAGS} lags lie beyond the band by chance",
        residual_rows(identified), (0,), [],
    )  # fmt: skip
    drawn = _drawings_log_page(identified) if draw else {}
    sections = [
        Section("Parameters", "parameters", [results]),
        Section("What the log cannot tell", "untold", notes=untold(identified)),
        Section("Over time", "time", figures=drawn.get("time", ())),
        Section("Excitation", "excitation", [excitation], drawn.get("excitation", ())),
        Section("Residuals", "residuals", [residuals], drawn.get("residuals", ())),
        Section("The log", "log", figures=drawn.get("log", ()), notes=identified.log.notes),
        Section("Provenance", "provenance", facts=facts),
        Section("Files", "files", links=FILES_LOG_PAGE),
    ]  # fmt: skip
    introduction = [
        f"{identified.log.time[-1]:.0f} s of driving, {len(identified.log.time)} steps of "
        f"{1e3 * identified.log.period:.3g} ms."
    ]
    kept = [part for part in sections if any(part[2:])]
    return page_text("Identification", subject, introduction, kept, "parameter or estimator")


def _drawings_log_page(identified: Identified) -> dict[str, Sequence[Drawing]]:
    """Figures by section; empty without matplotlib."""
    try:
        import matplotlib
    except ImportError:
        return {}
    with matplotlib.rc_context({**STYLE, "text.parse_math": False}):
        figures = {
            "time": [
                ("Parameters over time", "Line: estimate, which may change at any moment; band: "
                 "95 %. Dashed: constant value of the whole log.", _parameters(identified)),
                ("Slip over time", "Slip ratio of both tracks and side slip; band: 95 %.",
                 _slips(identified)),
            ],
            "excitation": [("Excitation over time", "From 1 on the data weigh more than the prior.",
                            _excitation(identified))],
            "residuals": [("Autocorrelation of the residuals", "Dotted: 95 % band of white noise.",
                           _whiteness(identified))],
            "log": [("The path", "Filtered positions, and those of the log.", _path(identified))],
        }  # fmt: skip
        return {
            section: [
                Drawing(title, text, inline_svg(svg_text(figure, title), title))
                for title, text, figure in of
            ]
            for section, of in figures.items()
        }


def _thin(identified: Identified) -> Any:
    """Steps that are drawn."""
    return np.unique(np.linspace(0, len(identified.log.time) - 1, POINTS).astype(int))


def _banded(axes: "Axes", identified: Identified, name: str, colour: str, label: str = "") -> None:
    """One quantity with its 95 % band; the axis shows the band once it is narrower."""
    k, (value, deviation) = _thin(identified), identified.series[name]
    time = identified.log.time[k]
    low, high = value[k] - NORMAL * deviation[k], value[k] + NORMAL * deviation[k]
    if name in SOIL:
        factor = np.exp(NORMAL * deviation[k] / value[k])
        low, high = value[k] / factor, value[k] * factor
    axes.fill_between(time, low, high, color=colour, alpha=0.2, linewidth=0.0)
    axes.plot(time, value[k], color=colour, linewidth=1.2, label=label)
    later = slice(len(k) // 8, None)
    bottom, top = float(np.min(low[later])), float(np.max(high[later]))
    margin = 0.1 * (top - bottom) + 1e-9
    axes.set_ylim(bottom - margin, top + margin)


def _parameters(identified: Identified) -> Any:
    figure, panels = new_figure((3.4, 1.5), 3, 2, gap=(0.75, 0.35), sharex=True)
    for axes, name in zip(panels.flat, (*CONSTANT, *SOIL), strict=True):
        _banded(axes, identified, name, ESTIMATE)
        if name in CONSTANT and not identified.found[name].changed:
            axes.axhline(identified.found[name].value, color=CONSTANT_LINE, linestyle="--",
                         linewidth=1.0)  # fmt: skip
        label, unit = NAMES[name]
        axes.set_title(f"{label} [{unit}]", loc="left", fontsize=9)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    return figure


def _slips(identified: Identified) -> Any:
    figure, panels = new_figure((7.5, 1.5), 2, 1, gap=(0.35, 0.35), sharex=True)
    for name, colour in (("slip_left", PALETTE[0]), ("slip_right", PALETTE[1])):
        _banded(panels[0, 0], identified, name, colour, name.replace("_", " "))
    k = _thin(identified)
    both = [identified.series[name][0][k] for name in ("slip_left", "slip_right")]
    reach = 1.2 * float(np.percentile(np.abs(both), 99.0)) + 0.01
    panels[0, 0].set_ylim(-reach, reach)
    panels[0, 0].legend(loc="upper right", ncols=2)
    panels[0, 0].set_title("slip ratio [-]", loc="left", fontsize=9)
    _banded(panels[1, 0], identified, "side_slip", PALETTE[2])
    panels[1, 0].set_title("side slip [rad]", loc="left", fontsize=9)
    panels[1, 0].set_xlabel("time [s]")
    return figure


def _excitation(identified: Identified) -> Any:
    figure, panels = new_figure((7.5, 1.8))
    axes, k = panels[0, 0], _thin(identified)
    for (name, excitation), colour in zip(identified.excitation.items(), PALETTE, strict=False):
        axes.semilogy(identified.log.time[k], np.maximum(excitation[k], 1e-4), color=colour,
                      label=name, linewidth=1.0)  # fmt: skip
    axes.axhline(1.0, color="0.5", linestyle=":")
    axes.legend(loc="lower center", ncols=4)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("time [s]")
    return figure


def _whiteness(identified: Identified) -> Any:
    figure, panels = new_figure((3.4, 1.6), 1, 2, gap=(0.6, 0.4), sharey=True)
    for axes, (name, r) in zip(panels[0], identified.residuals.items(), strict=True):
        axes.set_title(f"{name} equation", loc="left", fontsize=9)
        axes.set_xlabel("lag [samples]")
        if len(r) >= 4 * WHITE_LAGS:
            axes.bar(np.arange(1, WHITE_LAGS + 1), autocorrelation(r), color=ESTIMATE, width=0.7)
            for side in (-1.0, 1.0):
                axes.axhline(side * NORMAL / np.sqrt(len(r)), color="0.4", linestyle=":")
        else:
            axes.text(0.5, 0.5, "too few samples", ha="center", transform=axes.transAxes)
        axes.set_ylim(-0.3, 0.3)
    return figure


def _path(identified: Identified) -> Any:
    figure, panels = new_figure((4.5, 4.0))
    axes, k, log = panels[0, 0], _thin(identified), identified.log
    x, y = log.values["x"] - log.values["x"][0], log.values["y"] - log.values["y"][0]
    axes.plot(x[k], y[k], ".", color="0.6", markersize=2.0, label="log")
    axes.plot(identified.motion[k, 0], identified.motion[k, 1], color=ESTIMATE, linewidth=1.0,
              label="filtered")  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x from the start [m]")
    axes.set_ylabel("y from the start [m]")
    axes.legend()
    return figure
