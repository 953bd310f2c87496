"""Figures 6 to 14: slip over the sprocket speeds, the spiral and the chicane."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.interpolate import griddata

from reproduce.focchi2025 import control
from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025.claims import RATE
from reproduce.focchi2025.control import BEGUN, LENGTHS, Case, Floats, Run, vehicle
from reproduce.focchi2025.identification import Identifications, Identified
from reproduce.paper_page import REFERENCE, panels
from tracked_env.benchmark.figures import DPI, PALETTE

SIMULATED, REAL, POINTS = PALETTE[1], PALETTE[4], PALETTE[0]
LABELS = (r"$\beta_L$ [m/s]", r"$\beta_R$ [m/s]", r"$\alpha$ [rad], $v_x > 0$")
NODES = 41  # of a surface along each axis
VIEW = {"elev": 24.0, "azim": -125.0}
ALPHA_SHOWN = 0.05  # [m/s] slower runs have no alpha worth drawing


def _axes(figure: Figure, rows: int, columns: int, index: int, title: str) -> Any:
    """Three-dimensional axes over both sprocket speeds."""
    axes: Any = figure.add_subplot(rows, columns, index, projection="3d")
    axes.set_title(title, y=0.97)
    axes.set_xlabel(r"$\omega_L$ [rad/s]", labelpad=-2.0)
    axes.set_ylabel(r"$\omega_R$ [rad/s]", labelpad=-2.0)
    axes.tick_params(pad=-1.0, labelsize=7)
    axes.locator_params(nbins=5)
    axes.view_init(**VIEW)
    axes.set_box_aspect(None, zoom=1.0)
    return axes


def _forward(values: Floats, v_x: Floats) -> Floats:
    """alpha where the vehicle drives forward; nan elsewhere."""
    return np.where(v_x > ALPHA_SHOWN, values, np.nan)


Reach = tuple[float, float, float, float]  # [rad/s] least and largest speed, left then right


def _reach(found: Identified) -> Reach:
    """Where the sprockets have runs."""
    left, right = found.runs.sprocket_left, found.runs.sprocket_right
    return float(left.min()), float(left.max()), float(right.min()), float(right.max())


def _sheets(found: Identified, reach: Reach, radius: float) -> list[Floats]:
    """Left, right, beta_left, beta_right, alpha forward of the regressor, or of the dense runs."""
    lines = (np.linspace(*reach[:2], NODES), np.linspace(*reach[2:], NODES))
    left, right = np.meshgrid(*lines, indexing="ij")
    if found.trees is not None:
        flat: tuple[Floats, ...] = found.trees.slip(left.ravel(), right.ravel())
    else:
        dense = found.dense
        points = (dense.sprocket_left, dense.sprocket_right)
        flat = tuple(
            griddata(points, values, (left.ravel(), right.ravel()), method="nearest")
            for values in (dense.beta_left, dense.beta_right, dense.alpha)
        )
    beta_left, beta_right, alpha = (values.reshape(left.shape) for values in flat)
    v_x = 0.5 * (radius * (left + right) - beta_left - beta_right)
    return [left, right, beta_left, beta_right, _forward(alpha, v_x)]


def fits(found: Identifications, radius: float) -> Figure:
    """Figures 6 and 7: regressor and runs, simulation above the real vehicle."""
    shown = [("simulation", found.simulated, SIMULATED)]
    if found.measured is not None:
        shown.append(("real vehicle", found.measured, REAL))
    figure = Figure(figsize=(10.0, 3.1 * len(shown)), dpi=DPI)
    figure.subplots_adjust(left=0.01, right=0.97, bottom=0.05, top=0.96, wspace=0.04, hspace=0.06)
    for row, (name, one, colour) in enumerate(shown):
        sheets, runs = _sheets(one, _reach(one), radius), one.runs
        some = slice(None, None, 3 if len(runs.v_x) > 500 else 1)  # of the dots
        dots = (runs.beta_left, runs.beta_right, _forward(runs.alpha, runs.v_x))
        for column, label in enumerate(LABELS):
            axes = _axes(figure, len(shown), 3, 3 * row + column + 1, f"{label}, {name}")
            axes.plot_surface(
                *sheets[:2], sheets[2 + column], color=colour, alpha=0.65, linewidth=0.0,
                rcount=NODES, ccount=NODES,
            )  # fmt: skip
            axes.scatter(
                runs.sprocket_left[some],
                runs.sprocket_right[some],
                dots[column][some],
                s=1.5,
                color=POINTS,
                depthshade=False,
            )
    return figure


def frictions(found: Identifications) -> Figure:
    """Figure 8: alpha for three frictions, as surfaces and along lines of constant mean speed."""
    figure = Figure(figsize=(10.0, 3.8), dpi=DPI)
    figure.subplots_adjust(left=0.01, right=0.98, bottom=0.14, top=0.93, wspace=0.12)
    surface = _axes(figure, 1, 2, 1, LABELS[2])
    lines: Any = figure.add_subplot(1, 2, 2)
    for mu, colour in zip(ident.FRICTIONS, (PALETTE[1], PALETTE[2], PALETTE[0]), strict=True):
        runs = found.by_friction[mu]
        side = round(len(runs.v_x) ** 0.5)
        left, right = (c.reshape(side, side) for c in (runs.sprocket_left, runs.sprocket_right))
        alpha = _forward(runs.alpha, runs.v_x).reshape(side, side)
        surface.plot_surface(
            left, right, alpha, color=colour, alpha=0.55, linewidth=0.0, rcount=side, ccount=side
        )
        # Nodes with i + j constant: the same mean speed, the turn grows along them.
        i = np.arange(side)
        j = 2 * (side // 2) + 2 * (side // 6) - i
        inside = (j >= 0) & (j < side)
        i, j = i[inside], j[inside]
        mean = 0.5 * (left[i, j] + right[i, j])[0]
        lines.plot(right[i, j] - left[i, j], alpha[i, j], color=colour, linewidth=1.3,
                   label=rf"$\mu$ = {mu:g}")  # fmt: skip
        lines.set_title(f"mean of the sprocket speeds {mean:.1f} rad/s")
    lines.set(xlabel=r"$\omega_R - \omega_L$ [rad/s]", ylabel=LABELS[2])
    lines.legend(fontsize=8)
    return figure


def comparison(found: Identifications, radius: float) -> Figure:
    """Figure 9: simulation and real vehicle in the range that the latter reaches."""
    assert found.measured is not None
    figure = Figure(figsize=(10.0, 3.3), dpi=DPI)
    figure.subplots_adjust(left=0.01, right=0.97, bottom=0.1, top=0.95, wspace=0.04)
    reach = _reach(found.measured)
    real = _sheets(found.measured, reach, radius)
    simulated = _sheets(found.simulated, reach, radius)
    for column, label in enumerate(LABELS):
        axes = _axes(figure, 1, 3, column + 1, label)
        for sheets, colour in ((simulated, SIMULATED), (real, REAL)):
            axes.plot_surface(*sheets[:2], sheets[2 + column], color=colour, alpha=0.7,
                              linewidth=0.0, rcount=NODES, ccount=NODES)  # fmt: skip
    handles = [Patch(color=c) for c in (SIMULATED, REAL)]
    figure.legend(handles, ["simulation", "real vehicle"], loc="lower center", ncols=2, fontsize=8)
    return figure


# Controllers

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
    axes.set(title=title, xlabel="x [m]", ylabel="y [m]")


def spiral(results: Any) -> Figure:
    """Figure 10: paths, Cartesian error, Lyapunov function."""
    figure, (axes,) = panels((10.0, 3.3), 1, 3)
    _path(axes[0], {kind: one.run for kind, one in results.spiral.items()}, "path")
    for kind, one in results.spiral.items():
        axes[1].plot(one.run.time, 100.0 * one.run.distance[:, 0], **LINES[kind])
        axes[2].plot(one.run.time, np.maximum(one.value, 1e-7), **LINES[kind])
    axes[1].set_title("Cartesian error [cm]")
    axes[2].set(title="Lyapunov function (38), (45)", yscale="log")
    for panel in axes[1:]:
        panel.set_xlabel("time [s]")
    axes[1].set_ylim(bottom=0.0)
    axes[0].legend(fontsize=8)
    return figure


def paths(results: Any) -> Figure:
    """Figure 12: the chicane with both contact lengths."""
    figure, (axes,) = panels((10.0, 4.2), 1, len(LENGTHS))
    for panel, length in zip(axes, LENGTHS, strict=True):
        runs = {k: results.chicane[Case(k, length, RATE)] for k in control.KINDS}
        _path(panel, runs, f"contact length {length:g} m")
    axes[0].legend(fontsize=8)
    return figure


def errors(results: Any) -> Figure:
    """Figure 13: Cartesian and heading error, all vehicles."""
    figure, axes = panels((10.0, 5.0), 2, len(LENGTHS), sharex=True, sharey="row")
    for column, length in enumerate(LENGTHS):
        for kind in control.KINDS:
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
            axes[0, column].plot([BEGUN, control.DURATION], [level, level], linewidth=0.8,
                                 linestyle=":", color=LINES[kind]["color"])  # fmt: skip
        axes[1, column].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("Cartesian error [cm]")
    axes[1, 0].set_ylabel("heading error [rad]")
    axes[0, 0].set_ylim(bottom=0.0)
    axes[0, 0].legend(fontsize=8)
    return figure


def slip(results: Any) -> Figure:
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


def online(results: Any) -> Figure:
    """The chicane with a wrong assumed friction: error, and the friction of the controller."""
    length = LENGTHS[-1]
    figure, axes = panels((10.0, 5.0), 2, len(control.SOILS), sharex=True)
    for column, (true, assumed) in enumerate(control.SOILS):
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
        axes[0, column].set(title=f"true mu = {true:g}, assumed {assumed:g}", ylim=(0.0, 10.0))
        axes[1, column].set(ylim=(0.0, 0.5), xlabel="time [s]")
    axes[0, 0].set_ylabel("Cartesian error [cm]")
    axes[1, 0].set_ylabel("friction believed [-]")
    axes[0, 0].legend(fontsize=8)
    return figure


def drawings(results: Any) -> dict[str, Figure]:
    """All figures of this file; figure 9 where there are runs of the real vehicle."""
    found, radius = results.identification, vehicle().sprocket_radius
    figures = {"fits": fits(found, radius), "frictions": frictions(found)}
    if found.measured is not None:
        figures["comparison"] = comparison(found, radius)
    return figures | {f.__name__: f(results) for f in (spiral, paths, errors, slip, online)}
