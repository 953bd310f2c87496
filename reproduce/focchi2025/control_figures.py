"""Figures 6 to 23: slip over the sprocket speeds, the controllers, plans, load models, slopes."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from reproduce import REFERENCE, label_all, legend_below, panels, surfaces
from reproduce.focchi2025 import control, slopes
from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025.claims import RATE, SLC_SLP, UC_SLP
from reproduce.focchi2025.control import BEGUN, LENGTHS, Case, vehicle
from reproduce.focchi2025.identification import Identifications, Identified
from reproduce.focchi2025.planning import FIGURE_16
from reproduce.focchi2025.planning_loop import MOVING, PAPER, VARIABLE, Pair, Planning, errors
from reproduce.focchi2025.slopes import HALF_SIDE, SlopeCase, Slopes, UnevenGround
from reproduce.policy_runs import Drive, Floats
from tracked_env.benchmark.figures import PALETTE

Line = dict[str, Any]  # arguments of a line
BLUE, RED, GREEN, PINK = PALETTE[1], PALETTE[0], PALETTE[2], PALETTE[3]
SIMULATED, REAL, POINTS = PALETTE[1], PALETTE[4], PALETTE[0]
SLIP = (r"$\beta_L$ [m/s]", r"$\beta_R$ [m/s]", r"$\alpha$ [rad]")
SPEEDS = (r"$\omega_L$ [rad/s]", r"$\omega_R$ [rad/s]")
VIEW = {"elev": 24.0, "azim": -125.0}
NODES = 41  # of a surface along each axis
ALPHA_SHOWN = 0.05  # [m/s] slower runs have no alpha worth drawing
DOTS = 4000  # points of a line at most
UC: Line = {"color": BLUE, "linestyle": "--", "linewidth": 1.3, "label": "UC"}
SLC: Line = {"color": RED, "linewidth": 1.3, "label": "SLC"}
LINES = {"uc": UC, "table": SLC, "slc": SLC}
ASSUMED: Line = {"color": PINK, "linestyle": ":", "linewidth": 1.3}
ONLINE: Line = {"color": GREEN, "linestyle": "-.", "linewidth": 1.3}
LOADS = {
    load: {**line, "label": f"{load} load"}
    for load, line in zip(loads.LOADS, (SLC, UC), strict=True)
}
ON_SLOPES: dict[str, Line] = {
    "uc": UC,
    "flat": {**ASSUMED, "label": "SLC, slip of level ground"},
    "slope": {**SLC, "label": "SLC, slip on slopes"},
    "uniform": {**ONLINE, "label": "the same of uniform load"},
}
PLANS = {  # title and colour of a planner
    "dubins": ("Dubins", PINK),
    "clothoid": ("clothoid", BLUE),
    "optimal": ("optimal, 0.4 m/s", RED),
    "optimal, variable": ("optimal, 0.15 to 0.4 m/s", GREEN),
}
ARROW, ARROWS = 0.35, 12  # [m] length of those that show a yaw, and how many on a path
CONTOUR_NODES = 240  # of a ground along each side


def ends(axes: Any, x: Floats, y: Floats) -> None:
    """Dots where a path begins and ends."""
    axes.plot(x[0], y[0], "o", color=GREEN, markersize=5)
    axes.plot(x[-1], y[-1], "o", color=PINK, markersize=5)


def on_plane(axes: Any, title: str) -> None:
    """Title and equal scales of a plane."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(title=title, xlabel="x [m]", ylabel="y [m]")


def driven_paths(axes: Any, runs: Mapping[str, Drive], title: str) -> None:
    """Reference and driven paths of the first vehicles."""
    truth = next(iter(runs.values())).truth
    x, y = truth["reference_x"][:, 0], truth["reference_y"][:, 0]
    axes.plot(x, y, **REFERENCE)
    ends(axes, x, y)
    for kind, run in runs.items():
        rows = thin(run)
        axes.plot(run.truth["x"][rows, 0], run.truth["y"][rows, 0], **LINES[kind])
    on_plane(axes, title)


def thin(run: Drive) -> slice:
    """Rows that are drawn."""
    return slice(None, None, max(len(run.time) // DOTS, 1))


# Slip over the sprocket speeds


def forward(values: Floats, v_x: Floats) -> Floats:
    """alpha where the vehicle drives forward; nan elsewhere."""
    return np.where(v_x > ALPHA_SHOWN, values, np.nan)


def sheets(one: Identified, reach: Identified, radius: float) -> tuple[Any, list[Floats]]:
    """Sprocket speeds within those of `reach`, and beta_left, beta_right, alpha forward of the
    regressor there, or of the dense runs."""
    speeds = reach.runs.sprocket_left, reach.runs.sprocket_right
    lines = (np.linspace(values.min(), values.max(), NODES) for values in speeds)
    left, right = np.meshgrid(*lines, indexing="ij")
    slips = one.trees.slip(left.ravel(), right.ravel())
    beta_left, beta_right, alpha = (values.reshape(left.shape) for values in slips)
    v_x = 0.5 * (radius * (left + right) - beta_left - beta_right)
    return (left, right), [beta_left, beta_right, forward(alpha, v_x)]


def sheet(axes: Any, grid: Any, values: Floats, colour: str) -> None:
    """One surface."""
    side = len(values)
    axes.plot_surface(
        *grid, values, color=colour, alpha=0.65, linewidth=0.0, rcount=side, ccount=side
    )


def fits(results: Identifications, radius: float) -> Figure:
    """Figures 6 and 7: regressor and runs, simulation above the real vehicle."""
    rows = [("simulation", results.simulated, SIMULATED)]
    if results.measured is not None:
        rows.append(("real vehicle", results.measured, REAL))
    titles = [f"{label}, {name}" for name, *_ in rows for label in SLIP]
    figure, axes = surfaces(2.3 * len(rows), len(rows), titles, SPEEDS, VIEW)
    for row, (_, one, colour) in enumerate(rows):
        (grid, values), runs = sheets(one, one, radius), one.runs
        some = slice(None, None, 3 if len(runs.v_x) > 500 else 1)  # of the dots
        dots = (runs.beta_left, runs.beta_right, forward(runs.alpha, runs.v_x))
        speeds = runs.sprocket_left[some], runs.sprocket_right[some]
        for panel, surface, dot in zip(axes[3 * row :], values, dots, strict=False):
            sheet(panel, grid, surface, colour)
            panel.scatter(*speeds, dot[some], s=1.5, color=POINTS, depthshade=False)
    return figure


def frictions(results: Identifications) -> Figure:
    """Figure 8: alpha for three frictions, as surfaces and along lines of constant mean speed."""
    figure, (surface, space) = surfaces(3.4, 1, (SLIP[2], ""), SPEEDS, VIEW)
    space.remove()
    lines: Any = figure.add_axes((0.6, 0.15, 0.38, 0.75))
    for mu, colour in zip(ident.FRICTIONS, (BLUE, GREEN, RED), strict=True):
        runs = results.by_friction[mu]
        side = round(len(runs.v_x) ** 0.5)
        alpha = forward(runs.alpha, runs.v_x).reshape(side, side)
        left, right = (w.reshape(side, side) for w in (runs.sprocket_left, runs.sprocket_right))
        sheet(surface, (left, right), alpha, colour)
        # Nodes with i + j constant: the same mean speed, the turn grows along them.
        i = np.arange(side)
        j = 2 * (side // 2) + 2 * (side // 6) - i
        i, j = i[(j >= 0) & (j < side)], j[(j >= 0) & (j < side)]
        mean = 0.5 * (left[i, j] + right[i, j])[0]
        lines.plot(right[i, j] - left[i, j], alpha[i, j], color=colour, label=rf"$\mu$ = {mu:g}")
        lines.set_title(f"mean sprocket speed {mean:.1f} rad/s")
    lines.set(xlabel=r"$\omega_R - \omega_L$ [rad/s]", ylabel=SLIP[2])
    lines.legend()
    return figure


def comparison(results: Identifications, radius: float) -> Figure:
    """Figure 9: simulation and real vehicle in the range that the latter reaches."""
    assert results.measured is not None
    figure, axes = surfaces(3.3, 1, SLIP, SPEEDS, VIEW)
    for one, colour in ((results.simulated, SIMULATED), (results.measured, REAL)):
        grid, values = sheets(one, results.measured, radius)
        for panel, surface in zip(axes, values, strict=True):
            sheet(panel, grid, surface, colour)
    handles = [Patch(color=c) for c in (SIMULATED, REAL)]
    figure.legend(handles, ["simulation", "real vehicle"], loc="lower center", ncols=2)
    return figure


# Controllers


def spiral(results: Any) -> Figure:
    """Figure 10: paths, Cartesian error, Lyapunov function."""
    figure, ((path, error, value),) = panels(3.3, 1, 3)
    driven_paths(path, {kind: one.run for kind, one in results.spiral.items()}, "path")
    for kind, one in results.spiral.items():
        error.plot(one.run.time, 100.0 * one.run.distance[:, 0], **LINES[kind])
        value.plot(one.run.time, np.maximum(one.value, 1e-7), **LINES[kind])
    value.set_yscale("log")
    titles = ("Cartesian error [cm]", "Lyapunov function")
    label_all((error, value), {"title": titles, "xlabel": "time [s]"})
    error.set_ylim(bottom=0.0)
    legend_below(figure, path)
    return figure


def chicane(results: Any, length: float) -> dict[str, Drive]:
    """Runs of both controllers with a contact length, as the paper has them."""
    return {kind: results.chicane[Case(kind, length, RATE)] for kind in control.KINDS}


def paths(results: Any) -> Figure:
    """Figure 12: the chicane with both contact lengths."""
    figure, (axes,) = panels(3.6, 1, len(LENGTHS))
    for panel, length in zip(axes, LENGTHS, strict=True):
        driven_paths(panel, chicane(results, length), f"contact length {length:g} m")
    legend_below(figure, axes[0])
    return figure


def tracking_errors(results: Any) -> Figure:
    """Figure 13: Cartesian and heading error, all vehicles."""
    figure, axes = panels(5.0, 2, len(LENGTHS), sharex=True, sharey="row")
    for (upper, lower), length in zip(axes.T, LENGTHS, strict=True):
        for (kind, run), level in zip(chicane(results, length).items(), (10.0, 3.0), strict=True):
            rows, line = thin(run), {**LINES[kind], "linewidth": 0.8}
            label = [line.pop("label"), *[None] * (run.distance.shape[1] - 1)]
            upper.plot(run.time[rows], 100.0 * run.distance[rows], label=label, **line)
            lower.plot(run.time[rows], run.heading[rows], **line)
            printed = {"linewidth": 0.8, "linestyle": ":", "color": line["color"]}
            upper.plot([BEGUN, control.DURATION], [level, level], **printed)
        upper.set_title(f"contact length {length:g} m")
    axes[0, 0].set_ylim(bottom=0.0)
    label_all(axes[:, 0], {"ylabel": ("Cartesian error [cm]", "heading error [rad]")})
    label_all(axes[1], {"xlabel": "time [s]"})
    legend_below(figure, axes[0, 0])
    return figure


def slip(results: Any) -> Figure:
    """Figure 14: actual slip and what the controller expects, first vehicle."""
    figure, axes = panels(6.0, 3, len(results.predicted), sharex=True, sharey="row")
    for column, (case, predicted) in zip(axes.T, results.predicted.items(), strict=True):
        run = results.chicane[case]
        rows = thin(run)
        time = run.time[rows]
        actual = control.slip_of(run, vehicle(case.length, case.friction, case.resistance))
        for panel, true, expected in zip(column, actual, predicted, strict=True):
            panel.plot(time, true[rows, 0], color=RED, linewidth=0.7, label="actual")
            panel.plot(time, expected[rows], color=BLUE, linewidth=0.9, label="predicted")
            size = float(np.nanmax(np.abs(expected[rows][time >= 1.0])))
            panel.set_ylim(-1.8 * size, 1.8 * size)
        column[0].set_title(f"contact length {case.length:g} m")
    label_all(axes[:, 0], {"ylabel": SLIP})
    label_all(axes[-1], {"xlabel": "time [s]"})
    legend_below(figure, axes[0, 0])
    return figure


# Plans


def arrow(axes: Any, x: float, y: float, yaw: float, **line: Any) -> None:
    """A yaw at a place."""
    axes.plot([x, x + ARROW * np.cos(yaw)], [y, y + ARROW * np.sin(yaw)], **line)


def plans(results: Planning) -> Figure:
    """Figure 16."""
    figure, axes = panels(6.6, 2, 2)
    for panel, (planner, (title, _)) in zip(axes.flat, PLANS.items(), strict=True):
        for pair, (job, run) in results.shown.items():
            if pair.planner != planner:
                continue
            plan, line = job.trajectory, LINES[pair.controller]
            panel.plot(plan.x, plan.y, **{**REFERENCE, "label": None})
            last = int(np.searchsorted(run.time, plan.duration))
            x, y, yaw = (run.truth[name][: last + 1, 0] for name in ("x", "y", "yaw"))
            panel.plot(x, y, **line)
            arrow(panel, x[last], y[last], yaw[last], color=line["color"], alpha=0.6)
            on_plane(panel, f"{title}: {plan.duration:.2f} s")
        for pose, colour in (((0.0, 0.0, 0.0), GREEN), (FIGURE_16, PINK)):
            panel.plot(*pose[:2], "o", color=colour, markersize=5)
            arrow(panel, *pose, color=colour, linewidth=1.5)
    legend_below(figure, axes[0, 0])
    return figure


def of_pair(pair: Pair, **other: Any) -> Line:
    """Line of a planner with a controller."""
    style = "-" if pair.controller == "slc" else "--"
    line = {"color": PLANS[pair.planner][1], "linestyle": style, "label": pair.name}
    return {**line, "linewidth": 1.3, **other}


def plan_errors(results: Planning) -> Figure:
    """Figure 17, and the errors of all goals by the start."""
    figure, ((left,), (right,)) = panels(7.6, 2, 1)
    for pair, (job, run) in results.shown.items():
        distance, _ = errors(run, job)
        share = run.time[: len(distance)] / job.trajectory.duration
        left.plot(share, 100.0 * distance, **of_pair(pair))
    left.set(title="goal of figure 16", ylim=(0.0, 1.45 * left.get_ylim()[1]))
    starts = (("from rest", PAPER[LENGTHS[-1]], "-"), ("moving", MOVING[LENGTHS[-1]], ":"))
    for pair, colour in ((UC_SLP, BLUE), (SLC_SLP, RED), (VARIABLE, GREEN)):
        for name, setup, style in starts:
            distance = np.sort(results.tracked[setup][pair].distance)
            part = np.arange(1, len(distance) + 1) / len(distance)
            line = of_pair(pair, color=colour, linestyle=style, label=f"{pair.name}, {name}")
            right.plot(100.0 * distance, part, **line)
    right.set(title="all goals, 0.7 m", xscale="log", ylim=(0.0, 1.5))
    xlabels = ("time / duration of the plan", "RMSE of the Cartesian error [cm]")
    ylabels = ("Cartesian error [cm]", "share of the goals below it")
    label_all((left, right), {"xlabel": xlabels, "ylabel": ylabels})
    for panel in (left, right):
        panel.legend(ncols=3)
    return figure


def slipperiness(results: Planning) -> Figure:
    """Figures 18 and 19."""
    figure, axes = panels(7.5, 2, 2)
    groups: dict[str, dict[str, Any]] = {
        f"(54), {title}": {k: v for (s, k), v in results.levels.items() if s == sign}
        for sign, title in (
            ("subtracted", "beta subtracted"),
            ("added", "beta added as in the code"),
        )
    }
    groups["identified slip"] = {f"mu = {mu:g}": v for mu, v in results.soils.items()}
    for panel, (title, group) in zip(axes.flat, groups.items(), strict=False):
        for (name, one), colour in zip(group.items(), PALETTE, strict=False):
            panel.plot(one.x, one.y, color=colour, label=f"{name}: {one.duration:.2f} s")
            for i in np.linspace(0, len(one.time) - 1, ARROWS).astype(int):
                pose = (one.x[i], one.y[i], one.yaw[i])
                arrow(panel, *pose, color=colour, alpha=0.4, linewidth=0.8)
        on_plane(panel, title)
    last = axes[1, 1]
    for (mu, one), colour in zip(results.soils.items(), PALETTE, strict=False):
        line: Line = {"color": colour, "linewidth": 1.3, "where": "post"}
        last.step(one.time / one.duration, one.course - one.yaw, label=f"mu = {mu:g}", **line)
        last.step(one.time / one.duration, 0.1 * one.yaw_rate, linestyle="--", **line)
    title = "alpha [rad]; dashed: yaw rate / 10 [rad/s]"
    last.set(title=title, xlabel="time / duration")
    for panel in axes.flat:
        panel.legend()
    return figure


# Slopes


def contours(axes: Any, ground: UnevenGround, points: Floats, margin: float) -> None:
    """Heights of a ground around points (P, 2) [m], in grey with contours."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * float((high - low).max()) + margin
    x, y = (
        np.clip(np.linspace(c - half, c + half, CONTOUR_NODES), -HALF_SIDE, HALF_SIDE)
        for c in 0.5 * (low + high)
    )
    height = ground.field.at(*np.meshgrid(x, y))[0]
    axes.contourf(x, y, height, levels=20, cmap="Greys", alpha=0.45)
    axes.contour(x, y, height, levels=20, colors="0.6", linewidths=0.4)
    axes.set(aspect="equal", xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), xlabel="x [m]")


def load_models(results: Slopes) -> Figure:
    """Figure 21, left: both loads on each ground, one column per ground and reference."""
    columns = [(ground, commands) for ground in results.grounds for commands in loads.COMMANDS]
    figure, axes = panels(6.8, 2, len(columns) // 2)
    for panel, (ground, commands) in zip(axes.flat, columns, strict=True):
        runs = {load: results.open_loop[ground.name, commands, load] for load in LOADS}
        path = runs["uniform"].reference
        paths_ = {load: run.positions[:, :2, 0] for load, run in runs.items()}
        contours(panel, ground, np.concatenate([path, *paths_.values()]), 0.7)
        panel.plot(*path.T, **REFERENCE)
        for load, points in paths_.items():
            panel.plot(*points.T, **LOADS[load])
        panel.plot(*path[0], "o", color=GREEN, markersize=5)
        panel.set_title(f"{ground.name}, {commands}")
    label_all(axes[:, 0], {"ylabel": "y [m]"})
    legend_below(figure, axes[0, 0])
    return figure


def stiffening(results: Slopes) -> Figure:
    """Figure 21, right: stiffness of the foremost patches that touch, and the pitch."""
    figure, (axes,) = panels(3.4, 1, 2)
    for (pair, reading), run in results.stiffening.items():
        gain, length = loads.PAIRS[pair]
        line: Line = {
            "color": RED if reading == "as coded" else PINK,
            "linestyle": "--" if pair == "printed" else "-",
            "label": f"{gain:g} s/m$^2$, {length:g} m, K$_t$ {reading}",
        }
        axes[0].plot(run.speed, 1e-3 * run.stiffness, **line)
        axes[1].plot(run.speed, -run.pitch, **line)
    printed = loads.TOP_SPEED, 1e-3 * loads.PRINTED_STIFFNESS
    axes[0].plot(*printed, "o", color=BLUE, label="printed: 23 kN/m")
    titles = ("largest stiffness [kN/m]", "pitch, nose up [rad]")
    label_all(axes, {"title": titles, "xlabel": "v_x [m/s]"})
    legend_below(figure, axes[0], 2)
    return figure


def slope_tracking(results: Slopes) -> Figure:
    """Figures 22 and 23: paths, Cartesian and heading error, pitch; one column per ground."""
    figure, axes = panels(8.6, 4, len(results.grounds), height_ratios=(2.2, 1, 1, 0.8))
    for (path, *histories), ground in zip(axes.T, results.grounds, strict=True):
        runs = {kind: results.closed_loop[SlopeCase(ground.name, kind)] for kind in slopes.KINDS}
        truth = runs["uc"].truth
        goal = truth["reference_x"][:, 0], truth["reference_y"][:, 0]
        contours(path, ground, np.stack(goal, axis=1), 0.6)
        path.plot(*goal, **REFERENCE)
        ends(path, *goal)
        path.set_title(ground.name)
        for kind, run in runs.items():
            line, (distance, turn) = ON_SLOPES[kind], slopes.errors(run)
            path.plot(run.truth["x"][:, 0], run.truth["y"][:, 0], **line)
            values = (100.0 * distance, -turn, run.truth["pitch"][:, 0])
            for panel, value in zip(histories, values, strict=True):
                panel.plot(run.time, value, **line)
    names = ("y [m]", "Cartesian error [cm]", "heading error [rad]", "pitch [rad]")
    label_all(axes[:, 0], {"ylabel": names})
    label_all(axes[-1], {"xlabel": "time [s]"})
    legend_below(figure, axes[1, 0], 2)
    return figure


def drawings(results: Any) -> dict[str, Figure]:
    """All figures; figure 9 where there are runs of the real vehicle."""
    slips, radius = results.identification, vehicle().sprocket_radius
    figures = {} if slips.measured is None else {"comparison": comparison(slips, radius)}
    return figures | {
        "fits": fits(slips, radius),
        "frictions": frictions(slips),
        "spiral": spiral(results),
        "paths": paths(results),
        "errors": tracking_errors(results),
        "slip": slip(results),
        "plans": plans(results.planning),
        "plan-errors": plan_errors(results.planning),
        "plan-slip": slipperiness(results.planning),
        "loads": load_models(results.slopes),
        "stiffening": stiffening(results.slopes),
        "slope-chicane": slope_tracking(results.slopes),
    }
