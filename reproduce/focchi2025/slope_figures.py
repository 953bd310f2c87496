"""Figures 21 to 23 of the paper; needs matplotlib."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025 import slope_chicane as closed
from reproduce.focchi2025 import slope_identification as ident
from reproduce.focchi2025.control_figures import ASSUMED, ONLINE, SLC, UC
from reproduce.focchi2025.results import Results
from reproduce.focchi2025.slope_chicane import SlopeCase
from reproduce.focchi2025.slope_runs import Slopes
from reproduce.focchi2025.uneven_ground import HALF_SIDE, UnevenGround
from reproduce.paper_figures import REFERENCE, Drawings, panels
from tracked_env.benchmark.drawing import PALETTE

NONUNIFORM: dict[str, Any] = {"color": PALETTE[0], "linewidth": 1.3, "label": "nonuniform load"}
UNIFORM: dict[str, Any] = {
    "color": PALETTE[1], "linestyle": "--", "linewidth": 1.3, "label": "uniform load",
}  # fmt: skip
NODES = 240  # of a ground along each side


def contours(axes: Any, ground: UnevenGround, centre: tuple[float, float], half: float) -> None:
    """Heights of a ground around a place [m], in grey with contours."""
    x, y = (np.linspace(c - half, c + half, NODES) for c in centre)
    x, y = (np.clip(axis, -HALF_SIDE, HALF_SIDE) for axis in (x, y))
    height = ground.field.at(*np.meshgrid(x, y))[0]
    axes.contourf(x, y, height, levels=20, cmap="Greys", alpha=0.45)
    axes.contour(x, y, height, levels=20, colors="0.6", linewidths=0.4)
    axes.set_aspect("equal")
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])
    axes.set_xlabel("x [m]")


def load_models(slopes: Slopes) -> Figure:
    """Figure 21, left: both loads on each ground, one column per ground and reference."""
    shown = [(ground, commands) for ground in slopes.grounds for commands in loads.COMMANDS]
    figure, (axes,) = panels((3.1 * len(shown), 3.6), 1, len(shown))
    for panel, (ground, commands) in zip(axes, shown, strict=True):
        runs = [slopes.open_loop[ground.name, commands, load] for load in loads.LOADS]
        path = runs[0].reference
        points = np.concatenate([path, *(run.positions[:, :2, 0] for run in runs)])
        low, high = points.min(axis=0), points.max(axis=0)
        middle = 0.5 * (low + high)
        half = 0.5 * float((high - low).max()) + 0.7
        contours(panel, ground, (float(middle[0]), float(middle[1])), half)
        panel.plot(*path.T, **REFERENCE)
        for run, line in zip(runs, (NONUNIFORM, UNIFORM), strict=True):
            panel.plot(run.positions[:, 0, 0], run.positions[:, 1, 0], **line)
        panel.plot(*path[0], "o", color=PALETTE[2], markersize=5)
        panel.set_title(f"{ground.name}, {commands}", fontsize=9)
    axes[0].set_ylabel("y [m]")
    axes[0].legend(fontsize=7)
    return figure


def stiffening(slopes: Slopes) -> Figure:
    """Figure 21, right: stiffness of the foremost patches that touch, and the pitch."""
    figure, (axes,) = panels((9.0, 3.2), 1, 2)
    lines = {"printed": "--", "fits": "-"}
    for (pair, reading), run in slopes.stiffening.items():
        gain, length = loads.PAIRS[pair]
        line: dict[str, Any] = {
            "color": PALETTE[0 if reading == "as coded" else 3], "linestyle": lines[pair],
            "linewidth": 1.3, "label": f"{gain:g} s/m$^2$, {length:g} m, K$_t$ {reading}",
        }  # fmt: skip
        axes[0].plot(run.speed, 1e-3 * run.stiffness, **line)
        axes[1].plot(run.speed, -run.pitch, **line)
    axes[0].plot(loads.TOP_SPEED, 1e-3 * loads.PRINTED_STIFFNESS, "o", color=PALETTE[1],
                 label="printed: 23 kN/m")  # fmt: skip
    axes[0].set_title("largest stiffness [kN/m]")
    axes[1].set_title("pitch, nose up [rad]")
    for panel in axes:
        panel.set_xlabel("v_x [m/s]")
    axes[0].legend(fontsize=7)
    return figure


CONTROLLERS = {
    "uc": UC,
    "flat": {**ASSUMED, "label": "SLC, slip of level ground"},
    "slope": {**SLC, "label": "SLC, slip on slopes"},
    "uniform": {**ONLINE, "label": "the same of uniform load"},
}


def tracking(slopes: Slopes) -> Figure:
    """Figures 22 and 23: paths, Cartesian and heading error, pitch; one column per ground."""
    columns = len(slopes.grounds)
    figure, axes = panels((4.6 * columns, 9.0), 4, columns, height_ratios=(2.2, 1, 1, 0.8))
    for column, ground in enumerate(slopes.grounds):
        runs = {kind: slopes.closed_loop[SlopeCase(ground.name, kind)] for kind in closed.KINDS}
        path = runs["uc"].reference[:, :2, 0]
        low, high = path.min(axis=0), path.max(axis=0)
        middle, half = 0.5 * (low + high), 0.5 * float((high - low).max()) + 0.6
        contours(axes[0, column], ground, (float(middle[0]), float(middle[1])), half)
        axes[0, column].plot(*path.T, **REFERENCE)
        axes[0, column].plot(*path[0], "o", color=PALETTE[2], markersize=5)
        axes[0, column].plot(*path[-1], "o", color=PALETTE[3], markersize=5)
        axes[0, column].set_title(ground.name)
        for kind, run in runs.items():
            line = CONTROLLERS[kind]
            distance, turn = closed.errors(run)
            axes[0, column].plot(run.state[:, 0, 0], run.state[:, 1, 0], **line)
            axes[1, column].plot(run.time, 100.0 * distance, **line)
            axes[2, column].plot(run.time, -turn, **line)
            axes[3, column].plot(run.time, run.state[:, 8, 0], **line)
        axes[3, column].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("y [m]")
    axes[1, 0].set_ylabel("Cartesian error [cm]")
    axes[2, 0].set_ylabel("heading error [rad]")
    axes[3, 0].set_ylabel("pitch [rad]")
    axes[1, 0].legend(fontsize=7)
    return figure


def slip_on_slopes(slopes: Slopes) -> Figure:
    """Section 4.5: the tables over the direction of gravity, and the slip angle across slopes."""
    figure, (axes,) = panels((10.0, 3.4), 1, 3)
    grade = np.linspace(-ident.STEEPEST, ident.STEEPEST, 61)
    along, across = (axis.ravel() for axis in np.meshgrid(grade, grade))
    model = ident.model("nonuniform").on(np.stack([along, across], axis=1))
    left, right = (np.full(along.size, speed) for speed in ident.BEND)
    beta_left, _, alpha = model.slip(left, right)
    for panel, values, title in (
        (axes[0], 1e3 * beta_left, r"$\beta_L$ [mm/s] of a left turn"),
        (axes[1], 1e3 * alpha, r"$\alpha$ [mrad] of a left turn"),
    ):
        shown = panel.contourf(grade, grade, values.reshape(61, 61), levels=16, cmap="viridis")
        figure.colorbar(shown, ax=panel)
        panel.set_title(title)
        panel.set_xlabel("gravity ahead [-]")
        panel.set_aspect("equal")
    axes[0].set_ylabel("gravity to the left [-]")
    for speed, found, colour in zip(ident.STRAIGHT, slopes.identification.side_slip, PALETTE,
                                    strict=False):  # fmt: skip
        axes[2].plot(ident.GRADES, 1e3 * np.abs(found), "o-", color=colour, markersize=3,
                     label=f"{speed:g} rad/s")  # fmt: skip
    first = 1e3 * abs(float(slopes.identification.side_slip[1, 0])) / float(ident.GRADES[0])
    axes[2].plot(ident.GRADES, first * ident.GRADES, color="0.5", linewidth=0.8, linestyle=":",
                 label="proportional")  # fmt: skip
    axes[2].set_title(r"$|\alpha|$ [mrad] straight across a slope")
    axes[2].set_xlabel("grade [-]")
    axes[2].legend(fontsize=7)
    return figure


def drawings(results: Results) -> Drawings:
    """All figures of this file."""
    return {
        "loads": (
            load_models(results.slopes),
            "Figure 21 of the paper, left: open loop with both load models, mu = 0.6; (53), and "
            "the reference of the authors' code, whose yaw rate falls linearly.",
        ),
        "stiffening": (
            stiffening(results.slopes),
            "Figure 21 of the paper, right: stiffness of the foremost patches in contact; pitch.",
        ),
        "slope-slip": (
            slip_on_slopes(results.slopes),
            "Section 4.5: slip of a left turn (4, 8 rad/s) over the direction of gravity, and the "
            "slip angle straight across slopes, mu = 0.6.",
        ),
        "slope-chicane": (
            tracking(results.slopes),
            "Figures 22 and 23 of the paper: the chicane in closed loop on slopes, mu = 0.6.",
        ),
    }
