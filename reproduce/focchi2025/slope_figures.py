"""Figures 21 to 23 of the paper; needs matplotlib."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025.results import Results
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
    }
