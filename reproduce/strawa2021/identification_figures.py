"""Figures 17 and 28 to 36: surface of the RMSE, estimates over time; needs matplotlib."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from reproduce.paper_figures import REFERENCE, Drawings, panels
from reproduce.strawa2021 import identification as ident
from reproduce.strawa2021 import slip as slips
from reproduce.strawa2021.drive import Drive
from reproduce.strawa2021.identification import Condition
from reproduce.strawa2021.results import REGRESSIONS, Results
from reproduce.strawa2021.soil import CASES, CHANGES, Case
from reproduce.strawa2021.sweep import Surface
from tracked_env.benchmark.drawing import DPI, PALETTE

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
        axes.set_xlabel("mass / true")
        axes.set_ylabel("inertia / true")
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
            panel.axvline(ident.STRAIGHT, color="0.7", linewidth=0.8)
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
            axes[0, column].set_title(f"{sensors} sensors")
            axes[0, column].set_ylabel("distance to the reference [m]")
            axes[0, column].set_xlabel("time [s]")
            axes[0, column].set_yscale("log")
            axes[0, column].set_ylim(1e-4, 10.0)
    axes[0, 0].set_title("path, sensors of the paper")
    axes[0, 0].set_aspect("equal", adjustable="datalim")
    axes[0, 0].set_xlabel("x [m]")
    axes[0, 0].set_ylabel("y [m]")
    axes[0, 0].legend(fontsize=7)
    return figure


def slip(result: slips.Slips) -> Figure:
    """Figure 33: true and estimated slip of one vehicle on sandy loam, gentle and brisk."""
    shown = [
        i
        for i, case in enumerate(result.cases)
        if case.soil == "sandy loam" and case.rate == slips.RATES[0]
    ]
    figure, axes = panels((10.0, 2.6 * len(shown) + 0.3), len(shown), 2, sharex=True)
    time = result.result.time
    for row, case in enumerate(shown):
        vehicle = case * result.seeds
        rapid = slips.windows(result, case, rapid=True)[:, 0]
        for column, side in enumerate(slips.SIDES):
            panel = axes[row, column]
            for k, name in enumerate(slips.MEASURED):
                estimate = 100.0 * result.estimate[name][:, vehicle, column]
                panel.plot(time, estimate, color=PALETTE[k], linewidth=0.9, label=f"z = {name}")
            truth = 100.0 * result.result.truth[f"slip_{side}"][:, vehicle]
            panel.plot(time, truth, color="black", linewidth=1.2, label="true")
            panel.fill_between(time, 0.0, 1.0, where=rapid, transform=panel.get_xaxis_transform(),
                               color="0.88", linewidth=0.0, zorder=0,
                               label="rapid change of speed")  # fmt: skip
            panel.set_title(f"{side} track, {result.cases[case].speed}")
            panel.set_ylabel("slip [%]")
            seen = truth[time > 1.0]
            panel.set_ylim(min(seen.min(), 0.0) - 6.0, seen.max() + 8.0)
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    handles, labels = axes[-1, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def soil(results: Results, way: str = "manoeuvre") -> Figure:
    """Figures 34 to 36: F_max, K, iterations on changing ground."""
    methods = {
        "printed": ("printed method, true slips", PALETTE[0], "-"),
        "ideal": ("this project's, true slips", PALETTE[1], "--"),
        "rtk": ("this project's, rtk sensors", PALETTE[2], "-."),
    }
    case = CASES.index(Case(way, "changing"))
    figure, axes = panels((10.0, 7.2), 3, 2, sharex=True)
    exact = results.soil["printed"]
    rows = (
        ("effort", "true_effort", 1e-3, "$F_{max}$ [kN]", (0.0, 30.0)),
        ("modulus", "true_modulus", 1e3, "K [mm]", (0.0, 60.0)),
    )
    for row, (name, true, scale, label, limits) in enumerate(rows):
        axes[row, 0].plot(exact.time, scale * getattr(exact, true)[:, case], **TRUE)
        for method, (text, colour, style) in methods.items():
            found = results.soil[method]
            line = {"color": colour, "linestyle": style, "linewidth": 1.2, "label": text}
            value = getattr(found, name)[:, case]
            axes[row, 0].plot(found.time, scale * value, **line)
            error = 100.0 * (value / getattr(found, true)[:, case] - 1.0)
            axes[row, 1].plot(found.time, error, **line)
        axes[row, 0].set_ylabel(label)
        axes[row, 0].set_ylim(limits)
        axes[row, 1].set_ylabel("relative error [%]")
        axes[row, 1].set_ylim(-100.0, 100.0)
    for column, method in enumerate(("printed", "rtk")):
        text, colour, _style = methods[method]
        found = results.soil[method]
        panel = axes[2, column]
        panel.plot(found.time, found.iterations[:, case], ".", markersize=2.5, color=colour)
        panel.set_title(f"iterations: {text}")
        panel.set_ylim(-1.0, 21.0)
        panel.set_xlabel("time [s]")
    for panel in axes.flat:
        for change in CHANGES:
            panel.axvline(change, color="0.7", linewidth=0.8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def drawings(results: Results) -> Drawings:
    """All figures of this file."""
    like = Condition("paper", 2.0, "strawa")
    identified = results.identification
    return {
        "sweep": (
            sweep(results.sweep),
            "Figure 17 of the paper: RMSE over the mass and inertia that the controller assumes, "
            "factor 2 in (20).",
        ),
        "estimates": (
            estimates(identified, like, "Noise of the paper, maps (44), (45), factor 2"),
            "Figures 28 to 31 of the paper: mass, inertia and resistance coefficients, one vehicle "
            "with the noise of the paper; the spiral begins at the grey line. Dotted: 1 %, 5 %.",
        ),
        "estimates-uniform": (
            estimates(
                identified,
                like._replace(ground="uniform"),
                "Noise of the paper, uniform ground, factor 2",
                10.0,
            ),
            "The same on ground whose coefficients are everywhere those of X = 0.",
        ),
        "trajectory": (
            trajectory(identified, like),
            "Figure 32 of the paper: the manoeuvre with wrong and with identified parameters, maps "
            "(44), (45), factor 2.",
        ),
        "slip": (
            slip(results.slip),
            "Figure 33 of the paper: slip of both tracks on sandy loam with the noise of the "
            "paper, one vehicle.",
        ),
        "soil": (
            soil(results),
            "Figures 34 to 36 of the paper: F_max, K and the iterations; the soil changes at the "
            "grey lines.",
        ),
    }
