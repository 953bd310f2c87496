"""Figures 6 to 9: slip over the sprocket speeds; needs matplotlib."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025.identification import Identifications, Identified
from reproduce.focchi2025.results import Results
from reproduce.focchi2025.runs import Floats, vehicle
from reproduce.paper_figures import Drawings
from tracked_env.benchmark.drawing import DPI, PALETTE

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
        from scipy.interpolate import griddata

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
    lines.set_xlabel(r"$\omega_R - \omega_L$ [rad/s]")
    lines.set_ylabel(LABELS[2])
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


def drawings(results: Results) -> Drawings:
    """All figures of this file; figure 9 where there are runs of the real vehicle."""
    found, radius = results.identification, vehicle().sprocket_radius
    drawn = {
        "fits": (
            fits(found, radius),
            "Figures 6 and 7 of the paper: the regressors (surfaces) and the runs (dots), "
            "mu = 0.1, 0.7 m.",
        ),
        "frictions": (
            frictions(found),
            "Figure 8 of the paper: alpha of the simulation, driving forward.",
        ),
    }
    if found.measured is not None:
        drawn["comparison"] = (
            comparison(found, radius),
            "Figure 9 of the paper: simulation (0.7 m) and real vehicle in the range of the "
            "latter.",
        )
    return drawn
