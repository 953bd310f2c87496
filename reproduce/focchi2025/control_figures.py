"""Figures 10 and 12 to 14: paths, errors and slip; needs matplotlib."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from reproduce.focchi2025 import chicane
from reproduce.focchi2025.chicane import Case
from reproduce.focchi2025.claims import RATE
from reproduce.focchi2025.results import Results
from reproduce.focchi2025.runs import BEGUN, LENGTHS, Run, vehicle
from reproduce.paper_figures import REFERENCE, Drawings, panels
from tracked_env.benchmark.drawing import PALETTE

UC: dict[str, Any] = {"color": PALETTE[1], "linestyle": "--", "linewidth": 1.3, "label": "UC"}
SLC: dict[str, Any] = {"color": PALETTE[0], "linewidth": 1.3, "label": "SLC"}
LINES = {"uc": UC, "table": SLC, "slc": SLC}
ASSUMED: dict[str, Any] = {"color": PALETTE[3], "linestyle": ":", "linewidth": 1.3}
ONLINE: dict[str, Any] = {"color": PALETTE[2], "linestyle": "-.", "linewidth": 1.3}
DOTS = 4000  # points of a line at most


def _thin(run: Run) -> slice:
    return slice(None, None, max(len(run.time) // DOTS, 1))


def _path(axes: Any, runs: dict[str, Run], title: str) -> None:
    """Reference and driven paths of the first vehicles."""
    first = next(iter(runs.values()))
    x, y = first.reference[:, 0, 0], first.reference[:, 1, 0]
    axes.plot(x, y, **REFERENCE)
    axes.plot(x[0], y[0], "o", color=PALETTE[2], markersize=5)
    axes.plot(x[-1], y[-1], "o", color=PALETTE[3], markersize=5)
    for kind, run in runs.items():
        axes.plot(run.state[_thin(run), 0, 0], run.state[_thin(run), 1, 0], **LINES[kind])
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(title)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def spiral(results: Results) -> Figure:
    """Figure 10: paths, Cartesian error, Lyapunov function."""
    figure, (axes,) = panels((10.0, 3.3), 1, 3)
    _path(axes[0], {kind: one.run for kind, one in results.spiral.items()}, "path")
    for kind, one in results.spiral.items():
        axes[1].plot(one.run.time, 100.0 * one.run.distance[:, 0], **LINES[kind])
        axes[2].plot(one.run.time, np.maximum(one.value, 1e-7), **LINES[kind])
    axes[1].set_title("Cartesian error [cm]")
    axes[2].set_title("Lyapunov function (38), (45)")
    axes[2].set_yscale("log")
    for panel in axes[1:]:
        panel.set_xlabel("time [s]")
    axes[1].set_ylim(bottom=0.0)
    axes[0].legend(fontsize=8)
    return figure


def paths(results: Results) -> Figure:
    """Figure 12: the chicane with both contact lengths."""
    figure, (axes,) = panels((10.0, 4.2), 1, len(LENGTHS))
    for panel, length in zip(axes, LENGTHS, strict=True):
        runs = {k: results.chicane[Case(k, length, RATE)] for k in chicane.KINDS}
        _path(panel, runs, f"contact length {length:g} m")
    axes[0].legend(fontsize=8)
    return figure


def errors(results: Results) -> Figure:
    """Figure 13: Cartesian and heading error, all vehicles."""
    figure, axes = panels((10.0, 5.0), 2, len(LENGTHS), sharex=True, sharey="row")
    for column, length in enumerate(LENGTHS):
        for kind in chicane.KINDS:
            run = results.chicane[Case(kind, length, RATE)]
            part = _thin(run)
            for i in range(run.state.shape[2]):
                line = {**LINES[kind], "linewidth": 0.8, "label": LINES[kind]["label"]}
                if i:
                    line["label"] = None
                axes[0, column].plot(run.time[part], 100.0 * run.distance[part, i], **line)
                axes[1, column].plot(run.time[part], run.heading[part, i], **line)
        axes[0, column].set_title(f"contact length {length:g} m")
        for level, kind in ((10.0, "uc"), (3.0, "table")):
            axes[0, column].plot([BEGUN, chicane.DURATION], [level, level], linewidth=0.8,
                                 linestyle=":", color=LINES[kind]["color"])  # fmt: skip
        axes[1, column].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("Cartesian error [cm]")
    axes[1, 0].set_ylabel("heading error [rad]")
    axes[0, 0].set_ylim(bottom=0.0)
    axes[0, 0].legend(fontsize=8)
    return figure


def slip(results: Results) -> Figure:
    """Figure 14: actual slip and what the controller expects, first vehicle."""
    cases = list(results.predicted)
    figure, axes = panels((10.0, 6.0), 3, len(cases), sharex=True, sharey="row")
    labels = (r"$\beta_L$ [m/s]", r"$\beta_R$ [m/s]", r"$\alpha$ [rad]")
    for column, case in enumerate(cases):
        run = results.chicane[case]
        part = _thin(run)
        actual = run.slip(vehicle(case.length, case.friction, case.resistance))
        for row, label in enumerate(labels):
            panel = axes[row, column]
            panel.plot(run.time[part], actual[row][part, 0], color=PALETTE[0], linewidth=0.7,
                       label="actual")  # fmt: skip
            panel.plot(run.time[part], results.predicted[case][row][part], color=PALETTE[1],
                       linewidth=0.9, alpha=0.85, label="predicted")  # fmt: skip
            panel.set_ylabel(label if column == 0 else "")
            late = run.time[part] >= 1.0
            size = float(np.nanmax(np.abs(results.predicted[case][row][part][late])))
            panel.set_ylim(-1.8 * size, 1.8 * size)
        axes[0, column].set_title(f"contact length {case.length:g} m")
        axes[-1, column].set_xlabel("time [s]")
    axes[0, 0].legend(fontsize=8, ncols=2)
    return figure


def online(results: Results) -> Figure:
    """The chicane with a wrong assumed friction: error, and the friction of the controller."""
    length = LENGTHS[-1]
    figure, axes = panels((10.0, 5.0), 2, len(chicane.SOILS), sharex=True)
    for column, (true, assumed) in enumerate(chicane.SOILS):
        for kind, believed, line, label in (
            ("table", true, SLC, "slip of the true friction"),
            ("table", assumed, ASSUMED, "slip of the assumed friction"),
            ("online", assumed, ONLINE, "identified on line"),
        ):
            run = results.chicane[Case(kind, length, friction=true, believed=believed)]
            shown = {**line, "label": label}
            axes[0, column].plot(run.time, 100.0 * run.distance[:, 0], **shown)
            mu = (
                run.belief["friction"][:, 0]
                if kind == "online"
                else np.full(len(run.time), believed)
            )
            axes[1, column].plot(run.time, mu, **shown)
        axes[0, column].set_title(f"true mu = {true:g}, assumed {assumed:g}")
        axes[0, column].set_ylim(0.0, 10.0)
        axes[1, column].set_ylim(0.0, 0.5)
        axes[1, column].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("Cartesian error [cm]")
    axes[1, 0].set_ylabel("friction believed [-]")
    axes[0, 0].legend(fontsize=8)
    return figure


def drawings(results: Results) -> Drawings:
    """All figures of this file."""
    return {
        "spiral": (
            spiral(results),
            "Figure 10 of the paper: pseudo-kinematic model, a spiral of v_d = 0.3 m/s, "
            "w_d = 0.05 t.",
        ),
        "paths": (
            paths(results),
            "Figure 12 of the paper: chicane (53) on the distributed model, mu = 0.1.",
        ),
        "errors": (
            errors(results),
            "Figure 13 of the paper: errors of all vehicles; dotted: the paper's 10 cm and 3 cm.",
        ),
        "slip": (
            slip(results),
            "Figure 14 of the paper: slip of one vehicle, actual and predicted; drawn up to 1.8 "
            "times the largest prediction.",
        ),
        "online": (
            online(results),
            "The chicane with a wrong assumed friction, contact length 0.7 m.",
        ),
    }
