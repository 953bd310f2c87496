"""Figures 9 to 36: paths, speeds, errors, torque, slip, surfaces of the RMSE, estimates."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from reproduce import REFERENCE, label_all, legend_below, panels, surfaces, words_of
from reproduce.policy_runs import Drive
from reproduce.strawa2021 import control
from reproduce.strawa2021 import identification as ident
from reproduce.strawa2021 import soil as soils
from reproduce.strawa2021.control import PATHS, SETTLED, SIDES, STRAIGHT, Case, Run, Surface
from reproduce.strawa2021.identification import REGRESSIONS, Condition
from tracked_env.benchmark.figures import PALETTE
from tracked_env.events import changed_value, encode_schedule
from tracked_env.physics.parameters import plant_parameters
from tracked_env.uncertainty import STRAWA_MAPS

NAMES: dict[str, dict[str, str]] = words_of(__file__)["names"]  # of scenarios
HISTORY = 20.0  # [s] of the histories
LEAST = 1e-8  # [m] errors are drawn from here on
FACTORS: dict[float, dict[str, Any]] = {  # lines by the turning factor
    2.0: {"color": PALETTE[0], "linestyle": "--", "linewidth": 1.2, "label": "factor 2 in (20)"},
    1.0: {"color": PALETTE[1], "linewidth": 1.2, "label": "factor 1 in (20)"},
}
TRUE: dict[str, Any] = {"color": "black", "linewidth": 2.2, "alpha": 0.35, "label": "true"}
RULE: dict[str, Any] = {"color": "0.7", "linewidth": 0.8}
KINDS: dict[str, dict[str, Any]] = {  # lines by the policy
    "fixed": {"label": "wrong parameters", "color": PALETTE[3], "linestyle": ":"},
    "printed": {"label": "as printed", "color": PALETTE[4], "linestyle": "-."},
    "paper": {"label": "bounded", "color": PALETTE[0], "linestyle": "--"},
    "coupled": {"label": "coupled", "color": PALETTE[1]},
}
ESTIMATED = {  # label, limits of the value, limits of the relative error [%]
    "mass": ("mass [kg]", (600.0, 2400.0), (-10.0, 10.0)),
    "inertia": ("inertia [kg m$^2$]", (600.0, 1800.0), (-30.0, 30.0)),
    "longitudinal_resistance": (r"$\mu_l$ [-]", (0.0, 1.4), (-40.0, 40.0)),
    "lateral_resistance": (r"$\mu_t$ [-]", (0.0, 1.4), (-40.0, 40.0)),
}
METHODS: dict[str, dict[str, Any]] = {  # lines of section 8.3.3
    "printed": {"label": "printed method, true slips", "color": PALETTE[0]},
    "ideal": {"label": "this project's, true slips", "color": PALETTE[1], "linestyle": "--"},
    "rtk": {"label": "this project's, rtk sensors", "color": PALETTE[2], "linestyle": "-."},
}


def scenario(runs: Mapping[Case, Run], name: str) -> Figure:
    """Nine panels of one scenario: paths and error, speeds on the circle, drive on the circle."""
    figure, axes = panels(8.4, 3, 3)
    for panel, path in zip(axes[0], PATHS, strict=False):
        truth, rows = runs[name, path, 1.0].truth, runs[name, path, 1.0].time <= SETTLED
        panel.plot(truth["reference_x"][rows], truth["reference_y"][rows], **REFERENCE)
        for factor, line in FACTORS.items():
            truth = runs[name, path, factor].truth
            panel.plot(truth["x"][rows], truth["y"][rows], **line)
        panel.set(title=f"path, {path}", xlabel="x [m]", ylabel="y [m]")
    axes[0, 0].set_aspect("equal", adjustable="datalim")
    low, high = axes[0, 1].get_ylim()
    axes[0, 1].set_ylim(min(low, -1.5), max(high, 1.5))
    for factor, line in FACTORS.items():
        for path, faded in (("circle", 1.0), ("straight", 0.4)):
            run, style = runs[name, path, factor], {"alpha": faded, "label": path}
            axes[0, 2].plot(run.time, np.maximum(run.distance, LEAST), **{**line, **style})
        run = runs[name, "circle", factor]
        rows, truth = run.time <= HISTORY, run.truth
        acceleration = np.gradient(truth["v_x"], 0.01)
        for panel, values in zip(
            axes[1], (truth["v_x"], truth["yaw_rate"], -acceleration), strict=True
        ):
            panel.plot(run.time[rows], values[rows], **line)
        for side, faded in zip(SIDES, (0.45, 1.0), strict=True):
            torque = truth[f"effort_{side}"] * truth["sprocket_radius"] / 1e3
            values = torque, truth[f"sprocket_speed_{side}"], 100.0 * truth[f"slip_{side}"]
            style = {"alpha": faded, "label": f"{side}, factor {factor:g}"}
            for panel, value in zip(axes[2], values, strict=True):
                panel.plot(run.time[rows], value[rows], **{**line, **style})
    circle = PATHS["circle"]
    for panel, level in zip(axes[1], (1.0, 1.0 / circle["radius"]), strict=False):
        panel.axhline(circle["speed"] * level, **{**REFERENCE, "label": None}, zorder=0)
    speeds = ("forward speed", "yaw rate", "acceleration error")
    titles = (*speeds, "transmitted torque", "sprocket speed", "slip")
    units = ("[m/s]", "[rad/s]", "[m/s$^2$]", "[kN m]", "[rad/s]", "[%]")
    texts = {"title": titles, "ylabel": units, "xlabel": "time on the circle [s]"}
    label_all(axes[1:].flat, texts)
    axes[0, 2].set(xlabel="time [s]", title="distance to reference", ylabel="[m]", yscale="log")
    slip = np.concatenate([line.get_ydata()[100:] for line in axes[2, 2].lines])
    if np.abs(slip).max() < 20.0:  # the first second is the jump onto the path
        axes[2, 2].set_ylim(min(0.0, 1.3 * slip.min()), 1.3 * slip.max())
    legend_below(figure, axes[0, 0])
    case = "Section {section}: {title} ({figures})"
    figure.suptitle(case.format_map(NAMES[name]))
    return figure


def maps(runs: Mapping[Case, Run]) -> Figure:
    """Figures 18 and 19: the maps (44), (45) with the circle, and the coefficients on it."""
    figure, (left, below) = panels(5.4, 2, 2, height_ratios=(3, 2))
    right = figure.add_subplot(below[0].get_gridspec()[1, :])
    for panel in below:
        panel.remove()
    x, y = np.meshgrid(np.linspace(-25.0, 25.0, 201), np.linspace(-25.0, 25.0, 201))
    events = encode_schedule(STRAWA_MAPS)[None]
    value: Any = np.vectorize(
        lambda e, x, y: changed_value(0.0, events, 0, e, 0.0, x, y), otypes=[np.float64]
    )
    run, nominal = runs["resistance-maps", "circle", 1.0], plant_parameters()
    names = ("longitudinal_resistance", "lateral_resistance")
    for e, (panel, name, label) in enumerate(
        zip(left, names, (r"$\mu_l$ (44)", r"$\mu_t$ (45)"), strict=True)
    ):
        mesh = panel.pcolormesh(x, y, value(e, x, y), shading="gouraud")
        figure.colorbar(mesh, ax=panel, shrink=0.85)
        path = run.truth["reference_x"], run.truth["reference_y"]
        panel.plot(*path, color="white", linewidth=1.2)
        panel.plot([0.0, 0.0], [0.0, 14.0], color="white", linewidth=1.2, linestyle="--")
        panel.set(title=label, aspect="equal", xlabel="x [m]", ylabel="y [m]")
        panel.grid(visible=False)
        right.plot(run.time, run.truth[name], color=PALETTE[e], label=f"{label}, true")
        level = getattr(nominal, name)
        right.axhline(level, color=PALETTE[e], linestyle=":", label=f"{label}, controller")
    right.set(title="on the circle", xlabel="time [s]", ylim=(0.38, 0.93))
    legend_below(figure, right)
    return figure


def sweep(results: Mapping[tuple[str, float], Surface]) -> Figure:
    """Figure 17: one surface per path, with the printed factor."""
    cases = {way: one for (way, factor), one in results.items() if factor == 2.0}
    titles = [f"RMSE [m], {way}" for way in cases]
    labels, view = ("mass / true", "inertia / true"), {"elev": 24.0, "azim": -60.0}
    figure, axes = surfaces(2.4, 1, titles, labels, view)
    for panel, one in zip(axes, cases.values(), strict=True):
        grid = np.meshgrid(one.factors, one.factors, indexing="ij")
        panel.plot_surface(*grid, one.rmse, cmap="viridis", rstride=1, cstride=1)
    return figure


def estimates(
    runs: Mapping[Condition, Drive], like: Condition, title: str, zoom: float = 1.0
) -> Figure:
    """Figures 28 to 31 under one condition: the first vehicle, value and relative error.

    zoom: of the errors' axes but for the mass, whose limits the paper names.
    """
    figure, axes = panels(8.6, len(ESTIMATED), 2, sharex=True)
    for row, (name, (label, values, errors)) in zip(axes, ESTIMATED.items(), strict=True):
        first = runs[like._replace(kind=REGRESSIONS[0])]
        row[0].plot(first.time, first.truth[name][:, 0], **TRUE)
        for kind in REGRESSIONS:
            run = runs[like._replace(kind=kind)]
            row[0].plot(run.time, run.belief[name][:, 0], **KINDS[kind])
            row[1].plot(run.time, 100.0 * ident.relative_error(run, name)[:, 0], **KINDS[kind])
        closer = 1.0 if name == "mass" else zoom
        row[0].set(ylabel=label, ylim=values)
        row[1].set(ylabel="relative error [%]", ylim=[limit / closer for limit in errors])
        for panel in row:
            panel.axvline(STRAIGHT, **RULE)
    for level in (-5.0, -1.0, 1.0, 5.0):
        axes[0, 1].axhline(level, linestyle=":", **RULE)
    label_all(axes[-1], {"xlabel": "time [s]"})
    legend_below(figure, axes[0, 0])
    figure.suptitle(title)
    return figure


def trajectory(runs: Mapping[Condition, Drive], like: Condition) -> Figure:
    """Figure 32: the paths of the manoeuvre, the distance to the reference, ideal and noisy."""
    figure, ((path, *errors),) = panels(3.6, 1, 3)
    truth = runs[like].truth
    path.plot(truth["reference_x"][:, 0], truth["reference_y"][:, 0], **REFERENCE)
    for kind, line in KINDS.items():
        for panel, sensors in zip(errors, ("ideal", "strawa"), strict=True):
            run = runs[like._replace(kind=kind, sensors=sensors)]
            error = np.sqrt(np.mean(run.distance**2, axis=1))
            panel.plot(run.time, np.maximum(error, 1e-5), **line)
            panel.set(title=f"{sensors} sensors", yscale="log", ylim=(1e-4, 10.0))
        path.plot(run.truth["x"][:, 0], run.truth["y"][:, 0], **line)
    label_all(errors, {"ylabel": "distance to the reference [m]", "xlabel": "time [s]"})
    path.set_aspect("equal", adjustable="datalim")
    path.set(title="path, sensors of the paper", xlabel="x [m]", ylabel="y [m]")
    legend_below(figure, path)
    return figure


def slip(result: soils.Slips) -> Figure:
    """Figure 33: true and estimated slip of one vehicle on sandy loam, gentle and brisk."""
    cases = [
        i
        for i, case in enumerate(result.cases)
        if case.soil == "sandy loam" and case.rate == soils.RATES[0]
    ]
    figure, axes = panels(2.4 * len(cases) + 0.3, len(cases), 2, sharex=True)
    time = result.result.time
    for row, case in zip(axes, cases, strict=True):
        vehicle = case * result.seeds
        rapid = soils.windows(result, case, rapid=True)[:, 0]
        for column, (side, panel) in enumerate(zip(SIDES, row, strict=True)):
            for k, name in enumerate(soils.MEASURED):
                estimate = 100.0 * result.estimate[name][:, vehicle, column]
                panel.plot(time, estimate, color=PALETTE[k], linewidth=0.9, label=f"z = {name}")
            truth = 100.0 * result.result.truth[f"slip_{side}"][:, vehicle]
            panel.plot(time, truth, color="black", linewidth=1.2, label="true")
            shade = {"color": "0.88", "linewidth": 0.0, "zorder": 0, "where": rapid}
            panel.fill_between(time, 0.0, 1.0, transform=panel.get_xaxis_transform(),
                               label="rapid change of speed", **shade)  # fmt: skip
            panel.set(title=f"{side} track, {result.cases[case].speed}", ylabel="slip [%]")
            late = truth[time > 1.0]
            panel.set_ylim(min(late.min(), 0.0) - 6.0, late.max() + 8.0)
    label_all(axes[-1], {"xlabel": "time [s]"})
    legend_below(figure, axes[-1, 0])
    return figure


def soil(results: Mapping[str, soils.Soil]) -> Figure:
    """Figures 34 to 36: F_max, K, iterations on changing ground."""
    case = soils.CASES.index(soils.Case("manoeuvre", "changing"))
    figure, axes = panels(7.2, 3, 2, sharex=True)
    exact = results["printed"]
    rows = (
        ("effort", 1e-3, "$F_{max}$ [kN]", (0.0, 30.0)),
        ("modulus", 1e3, "K [mm]", (0.0, 60.0)),
    )
    for (value, error), (name, scale, label, limits) in zip(axes, rows, strict=False):
        true = getattr(exact, f"true_{name}")[:, case]
        value.plot(exact.time, scale * true, **TRUE)
        for method, line in METHODS.items():
            estimate = getattr(results[method], name)[:, case]
            value.plot(exact.time, scale * estimate, linewidth=1.2, **line)
            error.plot(exact.time, 100.0 * (estimate / true - 1.0), linewidth=1.2, **line)
        value.set(ylabel=label, ylim=limits)
        error.set(ylabel="relative error [%]", ylim=(-100.0, 100.0))
    for panel, method in zip(axes[2], ("printed", "rtk"), strict=True):
        line, iterations = METHODS[method], results[method].iterations[:, case]
        panel.plot(exact.time, iterations, ".", markersize=2.5, color=line["color"])
        panel.set(title=f"iterations: {line['label']}", ylim=(-1.0, 21.0), xlabel="time [s]")
    for panel in axes.flat:
        for change in soils.CHANGES:
            panel.axvline(change, **RULE)
    legend_below(figure, axes[0, 0], 2)
    return figure


def drawings(results: Any) -> dict[str, Figure]:
    """All figures, of the results of the paper."""
    maps_, runs = Condition("paper", 2.0, "strawa"), results.identification
    uniform = maps_._replace(ground="uniform")
    noise = "Noise of the paper, {}, factor 2"
    return {
        **{name: scenario(results.control, name) for name in control.SCENARIOS},
        "maps": maps(results.control),
        "sweep": sweep(results.sweep),
        "estimates": estimates(runs, maps_, noise.format("maps (44), (45)")),
        "estimates-uniform": estimates(runs, uniform, noise.format("uniform ground"), 10.0),
        "trajectory": trajectory(runs, maps_),
        "slip": slip(results.slip),
        "soil": soil(results.soil),
    }
