"""Figures 9 to 36: paths, speeds, errors, torque, slip, surfaces of the RMSE, estimates."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from reproduce.paper_page import REFERENCE, panels
from reproduce.strawa2021 import identification as ident
from reproduce.strawa2021 import soil as soils
from reproduce.strawa2021.control import (
    PATHS,
    SCENARIOS,
    SETTLED,
    SIDES,
    STRAIGHT,
    Drive,
    Run,
    Surface,
)
from reproduce.strawa2021.identification import REGRESSIONS, Condition
from tracked_env.benchmark.figures import DPI, PALETTE, REFERENCE_COLOUR
from tracked_env.events import changed_value, encode_schedule
from tracked_env.physics.parameters import plant_parameters
from tracked_env.uncertainty import STRAWA_MAPS

Runs = dict[tuple[str, str, float], Run]

NUMBERS = {  # of the figures in the paper
    "exact": "figures 9 to 12",
    "mass-inertia": "figures 13 to 16",
    "resistance-maps": "figures 20 to 23",
    "sandy-loam": "figures 24 to 27",
}
HISTORY = 20.0  # [s] of the histories
LEAST = 1e-8  # [m] errors are drawn from here on


def _paths(axes: Any, runs: Runs, name: str, path: str, lines: dict[float, dict[str, Any]]) -> None:
    """Driven paths and the reference."""
    x, y = runs[name, path, 1.0].reference[:, runs[name, path, 1.0].time <= SETTLED]
    axes.plot(x, y, **REFERENCE)
    for factor, line in lines.items():
        result = runs[name, path, factor]
        rows = result.time <= SETTLED
        axes.plot(result.truth["x"][rows], result.truth["y"][rows], **line)
    axes.set(title=f"path, {path}", xlabel="x [m]", ylabel="y [m]")
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
        rows, truth = result.time <= HISTORY, result.truth
        time = result.time[rows]
        for panel, key in zip(axes[1], ("v_x", "yaw_rate"), strict=False):
            panel.plot(time, truth[key][rows], **line)
        axes[1, 2].plot(time, -np.gradient(truth["v_x"], 0.01)[rows], **line)
        for side, faded in zip(SIDES, (0.45, 1.0), strict=True):
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
        panel.set(
            title=title if panel is axes[0, 2] else f"{title}, circle",
            ylabel=unit,
            xlabel="time [s]",
        )
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
        panel.set(title=name, aspect="equal", xlabel="x [m]", ylabel="y [m]")
        panel.grid(visible=False)
    nominal = plant_parameters()
    for label, key, colour, believed in (
        (r"$\mu_l$", "longitudinal_resistance", PALETTE[0], nominal.longitudinal_resistance),
        (r"$\mu_t$", "lateral_resistance", PALETTE[1], nominal.lateral_resistance),
    ):
        right.plot(result.time, result.truth[key], color=colour, label=f"{label}, true")
        right.axhline(believed, color=colour, linestyle=":", label=f"{label}, controller")
    right.set(title="on the circle", xlabel="time [s]", ylim=(0.38, 0.93))
    right.legend(fontsize=7, ncols=2, loc="lower right")
    return figure


TRUE = {"color": "black", "linewidth": 2.2, "alpha": 0.35, "label": "true"}
KINDS = {  # of policy: label, colour, line style
    "fixed": ("wrong parameters", PALETTE[3], ":"),
    "printed": ("as printed", PALETTE[4], "-."),
    "paper": ("bounded", PALETTE[0], "--"),
    "coupled": ("coupled", PALETTE[1], "-"),
}
ESTIMATED = {  # label, limits of the value, limits of the relative error [%]
    "mass": ("mass [kg]", (600.0, 2400.0), (-10.0, 10.0)),
    "inertia": ("inertia [kg m$^2$]", (600.0, 1800.0), (-30.0, 30.0)),
    "longitudinal_resistance": (r"$\mu_l$ [-]", (0.0, 1.4), (-40.0, 40.0)),
    "lateral_resistance": (r"$\mu_t$ [-]", (0.0, 1.4), (-40.0, 40.0)),
}


def _kind(kind: str) -> dict[str, Any]:
    label, colour, style = KINDS[kind]
    return {"label": label, "color": colour, "linestyle": style, "linewidth": 1.2}


def sweep(surfaces: dict[tuple[str, float], Surface], factor: float = 2.0) -> Figure:
    """Figure 17: one surface per path."""
    chosen = {way: s for (way, own), s in surfaces.items() if own == factor}
    figure = Figure(figsize=(10.0, 3.0), dpi=DPI)
    figure.subplots_adjust(left=0.0, right=0.98, bottom=0.08, top=0.95, wspace=0.08)
    for column, (way, surface) in enumerate(chosen.items()):
        axes: Any = figure.add_subplot(1, len(chosen), column + 1, projection="3d")
        mass, inertia = np.meshgrid(surface.factors, surface.factors, indexing="ij")
        axes.plot_surface(mass, inertia, surface.rmse, cmap="viridis", rstride=1, cstride=1)
        axes.set_title(f"RMSE [m], {way}", y=0.98)
        axes.set(xlabel="mass / true", ylabel="inertia / true")
        axes.set_xticks((0.5, 1.0, 1.5))
        axes.set_yticks((0.5, 1.0, 1.5))
        axes.view_init(elev=24.0, azim=-60.0)
        axes.set_box_aspect(None, zoom=1.0)
    return figure


def estimates(
    runs: dict[Condition, Drive], like: Condition, title: str, zoom: float = 1.0
) -> Figure:
    """Figures 28 to 31 under one condition: the first vehicle, value and relative error.

    zoom: of the errors' axes but for the mass, whose limits the paper names.
    """
    figure, axes = panels((10.0, 8.6), len(ESTIMATED), 2, sharex=True)
    for row, (name, (label, values, errors)) in enumerate(ESTIMATED.items()):
        for kind in REGRESSIONS:
            result = runs[like._replace(kind=kind)]
            if kind == REGRESSIONS[0]:
                axes[row, 0].plot(result.time, result.truth[name][:, 0], **TRUE)
            axes[row, 0].plot(result.time, result.belief[name][:, 0], **_kind(kind))
            error = 100.0 * ident.relative_error(result, name)[:, 0]
            axes[row, 1].plot(result.time, error, **_kind(kind))
        axes[row, 0].set_ylabel(label)
        axes[row, 1].set_ylabel("relative error [%]")
        axes[row, 0].set_ylim(values)
        axes[row, 1].set_ylim([limit / (1.0 if row == 0 else zoom) for limit in errors])
        for panel in axes[row]:
            panel.axvline(STRAIGHT, color="0.7", linewidth=0.8)
    for level in (-5.0, -1.0, 1.0, 5.0):
        axes[0, 1].axhline(level, color="0.7", linewidth=0.8, linestyle=":")
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    axes[0, 0].legend(fontsize=8, ncols=3, loc="upper left")
    figure.suptitle(title)
    return figure


def trajectory(runs: dict[Condition, Drive], like: Condition) -> Figure:
    """Figure 32: the paths of the manoeuvre, the distance to the reference, ideal and noisy."""
    figure, axes = panels((10.0, 3.6), 1, 3)
    reference = runs[like].reference[:, 0]
    axes[0, 0].plot(*reference.T, **REFERENCE)
    for kind in KINDS:
        truth = runs[like._replace(kind=kind, sensors="strawa")].truth
        axes[0, 0].plot(truth["x"][:, 0], truth["y"][:, 0], **_kind(kind))
        for column, sensors in ((1, "ideal"), (2, "strawa")):
            result = runs[like._replace(kind=kind, sensors=sensors)]
            error = np.sqrt(np.mean(result.error**2, axis=1))
            axes[0, column].plot(result.time, np.maximum(error, 1e-5), **_kind(kind))
            axes[0, column].set(
                title=f"{sensors} sensors",
                ylabel="distance to the reference [m]",
                xlabel="time [s]",
                yscale="log",
                ylim=(1e-4, 10.0),
            )
    axes[0, 0].set_title("path, sensors of the paper")
    axes[0, 0].set_aspect("equal", adjustable="datalim")
    axes[0, 0].set(xlabel="x [m]", ylabel="y [m]")
    axes[0, 0].legend(fontsize=7)
    return figure


def slip(result: soils.Slips) -> Figure:
    """Figure 33: true and estimated slip of one vehicle on sandy loam, gentle and brisk."""
    shown = [
        i
        for i, case in enumerate(result.cases)
        if case.soil == "sandy loam" and case.rate == soils.RATES[0]
    ]
    figure, axes = panels((10.0, 2.6 * len(shown) + 0.3), len(shown), 2, sharex=True)
    time = result.result.time
    for row, case in enumerate(shown):
        vehicle = case * result.seeds
        rapid = soils.windows(result, case, rapid=True)[:, 0]
        for column, side in enumerate(SIDES):
            panel = axes[row, column]
            for k, name in enumerate(soils.MEASURED):
                estimate = 100.0 * result.estimate[name][:, vehicle, column]
                panel.plot(time, estimate, color=PALETTE[k], linewidth=0.9, label=f"z = {name}")
            truth = 100.0 * result.result.truth[f"slip_{side}"][:, vehicle]
            panel.plot(time, truth, color="black", linewidth=1.2, label="true")
            panel.fill_between(time, 0.0, 1.0, where=rapid, transform=panel.get_xaxis_transform(),
                               color="0.88", linewidth=0.0, zorder=0,
                               label="rapid change of speed")  # fmt: skip
            panel.set(title=f"{side} track, {result.cases[case].speed}", ylabel="slip [%]")
            seen = truth[time > 1.0]
            panel.set_ylim(min(seen.min(), 0.0) - 6.0, seen.max() + 8.0)
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    handles, labels = axes[-1, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def soil(found: dict[str, soils.Soil], way: str = "manoeuvre") -> Figure:
    """Figures 34 to 36: F_max, K, iterations on changing ground."""
    methods = {
        "printed": ("printed method, true slips", PALETTE[0], "-"),
        "ideal": ("this project's, true slips", PALETTE[1], "--"),
        "rtk": ("this project's, rtk sensors", PALETTE[2], "-."),
    }
    case = soils.CASES.index(soils.Case(way, "changing"))
    figure, axes = panels((10.0, 7.2), 3, 2, sharex=True)
    exact = found["printed"]
    rows = (
        ("effort", "true_effort", 1e-3, "$F_{max}$ [kN]", (0.0, 30.0)),
        ("modulus", "true_modulus", 1e3, "K [mm]", (0.0, 60.0)),
    )
    for row, (name, true, scale, label, limits) in enumerate(rows):
        axes[row, 0].plot(exact.time, scale * getattr(exact, true)[:, case], **TRUE)
        for method, (text, colour, style) in methods.items():
            one = found[method]
            line = {"color": colour, "linestyle": style, "linewidth": 1.2, "label": text}
            value = getattr(one, name)[:, case]
            axes[row, 0].plot(one.time, scale * value, **line)
            error = 100.0 * (value / getattr(one, true)[:, case] - 1.0)
            axes[row, 1].plot(one.time, error, **line)
        axes[row, 0].set(ylabel=label, ylim=limits)
        axes[row, 1].set(ylabel="relative error [%]", ylim=(-100.0, 100.0))
    for column, method in enumerate(("printed", "rtk")):
        text, colour, _style = methods[method]
        one = found[method]
        panel = axes[2, column]
        panel.plot(one.time, one.iterations[:, case], ".", markersize=2.5, color=colour)
        panel.set(title=f"iterations: {text}", ylim=(-1.0, 21.0), xlabel="time [s]")
    for panel in axes.flat:
        for change in soils.CHANGES:
            panel.axvline(change, color="0.7", linewidth=0.8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def drawings(results: Any) -> dict[str, Figure]:
    """All figures, of the results of the paper."""
    like, identified = Condition("paper", 2.0, "strawa"), results.identification
    uniform = like._replace(ground="uniform")
    conditions = "Noise of the paper, maps (44), (45), factor 2"
    return {
        **{name: scenario(results.control, name) for name in SCENARIOS},
        "maps": maps(results.control),
        "sweep": sweep(results.sweep),
        "estimates": estimates(identified, like, conditions),
        "estimates-uniform": estimates(
            identified, uniform, "Noise of the paper, uniform ground, factor 2", 10.0
        ),
        "trajectory": trajectory(identified, like),
        "slip": slip(results.slip),
        "soil": soil(results.soil),
    }
