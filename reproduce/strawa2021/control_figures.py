"""Figures 9 to 16 and 18 to 27: paths, speeds, errors, torque and slip; needs matplotlib."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from reproduce.paper_figures import REFERENCE, Drawings, panels
from reproduce.strawa2021.control import PATHS, SCENARIOS, SETTLED, Run
from reproduce.strawa2021.results import Results
from tracked_env.benchmark.drawing import PALETTE, REFERENCE_COLOUR
from tracked_env.events import encode_schedule
from tracked_env.physics.parameter_events import changed_value
from tracked_env.physics.parameters import plant_parameters
from tracked_env.uncertainty import STRAWA_MAPS

Runs = dict[tuple[str, str, float], Run]

NUMBERS = {  # of the figures in the paper
    "exact": "figures 9 to 12",
    "mass-inertia": "figures 13 to 16",
    "resistance-maps": "figures 20 to 23",
    "sandy-loam": "figures 24 to 27",
}
SHOWN = 20.0  # [s] of the drive's histories
LEAST = 1e-8  # [m] errors are drawn from here on


def _paths(axes: Any, runs: Runs, name: str, path: str, lines: dict[float, dict[str, Any]]) -> None:
    """Driven paths and the reference."""
    x, y = runs[name, path, 1.0].reference[:, runs[name, path, 1.0].time <= SETTLED]
    axes.plot(x, y, **REFERENCE)
    for factor, line in lines.items():
        result = runs[name, path, factor]
        rows = result.time <= SETTLED
        axes.plot(result.truth["x"][rows], result.truth["y"][rows], **line)
    axes.set_title(f"path, {path}")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    if path == "circle":
        axes.set_aspect("equal", adjustable="datalim")
    else:
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, -1.5), max(high, 1.5))


def scenario(runs: Runs, name: str) -> Figure:
    """Nine panels of one scenario: paths and error, speeds on the circle, drive on the circle."""
    case = SCENARIOS[name]
    figure, axes = panels((10.0, 8.4), 3, 3)
    lines: dict[float, dict[str, Any]] = {
        factor: {
            "color": colour,
            "linestyle": style,
            "linewidth": 1.2,
            "label": f"factor {factor:g} in (20)",
        }
        for factor, colour, style in zip((2.0, 1.0), PALETTE, ("--", "-"), strict=False)
    }
    for column, path in enumerate(PATHS):
        _paths(axes[0, column], runs, name, path, lines)
    speed = PATHS["circle"]["speed"]
    wanted = {"v_x": speed, "yaw_rate": speed / PATHS["circle"]["radius"]}
    for factor, line in lines.items():
        for path, faded in (("circle", 1.0), ("straight", 0.4)):
            result = runs[name, path, factor]
            shown = {**line, "label": f"{path}, factor {factor:g}", "alpha": faded}
            axes[0, 2].plot(result.time, np.maximum(result.error, LEAST), **shown)
        result = runs[name, "circle", factor]
        rows, truth = result.time <= SHOWN, result.truth
        time = result.time[rows]
        for panel, key in zip(axes[1], ("v_x", "yaw_rate"), strict=False):
            panel.plot(time, truth[key][rows], **line)
        axes[1, 2].plot(time, -np.gradient(truth["v_x"], 0.01)[rows], **line)
        for side, faded in (("left", 0.45), ("right", 1.0)):
            shown = {**line, "label": f"{side}, factor {factor:g}", "alpha": faded}
            torque = truth[f"effort_{side}"] * truth["sprocket_radius"] / 1e3
            axes[2, 0].plot(time, torque[rows], **shown)
            axes[2, 1].plot(time, truth[f"sprocket_speed_{side}"][rows], **shown)
            axes[2, 2].plot(time, 100.0 * truth[f"slip_{side}"][rows], **shown)
    for panel, key in zip(axes[1], ("v_x", "yaw_rate"), strict=False):
        panel.axhline(wanted[key], color=REFERENCE_COLOUR, linewidth=3.0, alpha=0.45, zorder=0)
    titles = (
        (axes[0, 2], "distance to the reference", "[m]"),
        (axes[1, 0], "forward speed", "[m/s]"),
        (axes[1, 1], "yaw rate", "[rad/s]"),
        (axes[1, 2], "acceleration error", "[m/s$^2$]"),
        (axes[2, 0], "transmitted torque", "[kN m]"),
        (axes[2, 1], "sprocket speed", "[rad/s]"),
        (axes[2, 2], "slip", "[%]"),
    )
    for panel, title, unit in titles:
        panel.set_title(title if panel is axes[0, 2] else f"{title}, circle")
        panel.set_ylabel(unit)
        panel.set_xlabel("time [s]")
    axes[0, 2].set_yscale("log")
    low, high = axes[0, 2].get_ylim()
    axes[0, 2].set_ylim(min(low, 1e-2), max(high, 10.0))
    slip = np.concatenate([axes_line.get_ydata()[100:] for axes_line in axes[2, 2].lines])
    if np.abs(slip).max() < 20.0:  # the first second is the jump onto the path
        axes[2, 2].set_ylim(min(0.0, 1.3 * slip.min()), 1.3 * slip.max())
    for panel in (axes[0, 0], axes[0, 2], axes[2, 0]):
        panel.legend(
            fontsize=7,
            loc="center" if panel is axes[0, 0] else "best",
            frameon=True,
            framealpha=0.85,
            edgecolor="none",
        )
    figure.suptitle(f"Section {case.section}: {case.title} ({NUMBERS[name]} of the paper)")
    return figure


def maps(runs: Runs) -> Figure:
    """Figures 18 and 19: the maps (44), (45) with the circle, and the coefficients on it."""
    figure, ((*left, right),) = panels((10.0, 3.2), 1, 3)
    x, y = np.meshgrid(np.linspace(-25.0, 25.0, 201), np.linspace(-25.0, 25.0, 201))
    events = encode_schedule(STRAWA_MAPS)[None]
    value: Any = np.vectorize(
        lambda e, x, y: changed_value(0.0, events, 0, e, 0.0, x, y), otypes=[np.float64]
    )
    result = runs["resistance-maps", "circle", 1.0]
    for e, (panel, name) in enumerate(zip(left, (r"$\mu_l$ (44)", r"$\mu_t$ (45)"), strict=True)):
        drawn = panel.pcolormesh(x, y, value(e, x, y), shading="gouraud")
        figure.colorbar(drawn, ax=panel, shrink=0.85)
        panel.plot(*result.reference, color="white", linewidth=1.2)
        panel.plot([0.0, 0.0], [0.0, 14.0], color="white", linewidth=1.2, linestyle="--")
        panel.set_title(name)
        panel.set_aspect("equal")
        panel.set_xlabel("x [m]")
        panel.set_ylabel("y [m]")
        panel.grid(visible=False)
    nominal = plant_parameters()
    for label, key, colour, believed in (
        (r"$\mu_l$", "longitudinal_resistance", PALETTE[0], nominal.longitudinal_resistance),
        (r"$\mu_t$", "lateral_resistance", PALETTE[1], nominal.lateral_resistance),
    ):
        right.plot(result.time, result.truth[key], color=colour, label=f"{label}, true")
        right.axhline(believed, color=colour, linestyle=":", label=f"{label}, controller")
    right.set_title("on the circle")
    right.set_xlabel("time [s]")
    right.set_ylim(0.38, 0.93)
    right.legend(fontsize=7, ncols=2, loc="lower right")
    return figure


def drawings(results: Results) -> Drawings:
    """All figures of this file."""
    runs, drawn = results.control, {}
    for name, case in SCENARIOS.items():
        caption = (
            f"Section {case.section}, {NUMBERS[name]} of the paper: {case.title}. Grey: reference; "
            "pale: straight line or left track."
        )
        drawn[name] = (scenario(runs, name), caption)
    drawn["maps"] = (
        maps(runs),
        "Figures 18 and 19 of the paper: the maps (44), (45) with the "
        "circle of 8.2.2 (solid) and the straight part of 8.3.1 (dashed), and the "
        "coefficients on the circle.",
    )
    return drawn
