"""Figures 6 to 9: slip over the sprocket speeds; needs matplotlib.

Figures 10 and 12 to 14: paths, errors and slip; needs matplotlib.

Figures 16 to 18: plans tracked by both controllers, errors, slip; needs matplotlib.

Figures 21 to 23 of the paper; needs matplotlib.
"""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from reproduce.focchi2025 import control, identification
from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025 import slopes as closed
from reproduce.focchi2025 import slopes as ident
from reproduce.focchi2025.claims import RATE, SLC_SLP, UC_SLP
from reproduce.focchi2025.control import Case
from reproduce.focchi2025.identification import Identifications, Identified
from reproduce.focchi2025.planning import FIGURE_16, MOVING, PAPER, VARIABLE, Pair
from reproduce.focchi2025.planning import errors as errors_planning_loop
from reproduce.focchi2025.results import Results
from reproduce.focchi2025.runs import BEGUN, LENGTHS, Floats, Run, vehicle
from reproduce.focchi2025.slopes import HALF_SIDE, SlopeCase, Slopes, UnevenGround
from reproduce.paper_page import REFERENCE, Drawings, panels
from tracked_env.benchmark.figures import DPI, PALETTE

SIMULATED, REAL, POINTS = PALETTE[1], PALETTE[4], PALETTE[0]
LABELS = (r"$\beta_L$ [m/s]", r"$\beta_R$ [m/s]", r"$\alpha$ [rad], $v_x > 0$")
NODES_SURFACES = 41  # of a surface along each axis
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
    lines = (np.linspace(*reach[:2], NODES_SURFACES), np.linspace(*reach[2:], NODES_SURFACES))
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
                rcount=NODES_SURFACES, ccount=NODES_SURFACES,
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
    for mu, colour in zip(
        identification.FRICTIONS, (PALETTE[1], PALETTE[2], PALETTE[0]), strict=True
    ):
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
                              linewidth=0.0, rcount=NODES_SURFACES, ccount=NODES_SURFACES)  # fmt: skip
    handles = [Patch(color=c) for c in (SIMULATED, REAL)]
    figure.legend(handles, ["simulation", "real vehicle"], loc="lower center", ncols=2, fontsize=8)
    return figure


def drawings_surfaces(results: Results) -> Drawings:
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


UC: dict[str, Any] = {"color": PALETTE[1], "linestyle": "--", "linewidth": 1.3, "label": "UC"}
SLC: dict[str, Any] = {"color": PALETTE[0], "linewidth": 1.3, "label": "SLC"}
LINES_CONTROL_FIGURES = {"uc": UC, "table": SLC, "slc": SLC}
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
        axes.plot(
            run.state[_thin(run), 0, 0], run.state[_thin(run), 1, 0], **LINES_CONTROL_FIGURES[kind]
        )
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(title)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def spiral(results: Results) -> Figure:
    """Figure 10: paths, Cartesian error, Lyapunov function."""
    figure, (axes,) = panels((10.0, 3.3), 1, 3)
    _path(axes[0], {kind: one.run for kind, one in results.spiral.items()}, "path")
    for kind, one in results.spiral.items():
        axes[1].plot(one.run.time, 100.0 * one.run.distance[:, 0], **LINES_CONTROL_FIGURES[kind])
        axes[2].plot(one.run.time, np.maximum(one.value, 1e-7), **LINES_CONTROL_FIGURES[kind])
    axes[1].set_title("Cartesian error [cm]")
    axes[2].set_title("Lyapunov function (38), (45)")
    axes[2].set_yscale("log")
    for panel in axes[1:]:
        panel.set_xlabel("time [s]")
    axes[1].set_ylim(bottom=0.0)
    axes[0].legend(fontsize=8)
    return figure


def paths_control_figures(results: Results) -> Figure:
    """Figure 12: the chicane with both contact lengths."""
    figure, (axes,) = panels((10.0, 4.2), 1, len(LENGTHS))
    for panel, length in zip(axes, LENGTHS, strict=True):
        runs = {k: results.chicane[Case(k, length, RATE)] for k in control.KINDS}
        _path(panel, runs, f"contact length {length:g} m")
    axes[0].legend(fontsize=8)
    return figure


def errors(results: Results) -> Figure:
    """Figure 13: Cartesian and heading error, all vehicles."""
    figure, axes = panels((10.0, 5.0), 2, len(LENGTHS), sharex=True, sharey="row")
    for column, length in enumerate(LENGTHS):
        for kind in control.KINDS:
            run = results.chicane[Case(kind, length, RATE)]
            part = _thin(run)
            for i in range(run.state.shape[2]):
                line = {
                    **LINES_CONTROL_FIGURES[kind],
                    "linewidth": 0.8,
                    "label": LINES_CONTROL_FIGURES[kind]["label"],
                }
                if i:
                    line["label"] = None
                axes[0, column].plot(run.time[part], 100.0 * run.distance[part, i], **line)
                axes[1, column].plot(run.time[part], run.heading[part, i], **line)
        axes[0, column].set_title(f"contact length {length:g} m")
        for level, kind in ((10.0, "uc"), (3.0, "table")):
            axes[0, column].plot([BEGUN, control.DURATION], [level, level], linewidth=0.8,
                                 linestyle=":", color=LINES_CONTROL_FIGURES[kind]["color"])  # fmt: skip
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
        axes[0, column].set_title(f"true mu = {true:g}, assumed {assumed:g}")
        axes[0, column].set_ylim(0.0, 10.0)
        axes[1, column].set_ylim(0.0, 0.5)
        axes[1, column].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("Cartesian error [cm]")
    axes[1, 0].set_ylabel("friction believed [-]")
    axes[0, 0].legend(fontsize=8)
    return figure


def drawings_control_figures(results: Results) -> Drawings:
    """All figures of this file."""
    return {
        "spiral": (
            spiral(results),
            "Figure 10 of the paper: pseudo-kinematic model, a spiral of v_d = 0.3 m/s, "
            "w_d = 0.05 t.",
        ),
        "paths": (
            paths_control_figures(results),
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


LINES = {"uc": UC, "slc": SLC}
TITLES = {
    "dubins": "Dubins", "clothoid": "clothoid", "optimal": "optimal, 0.4 m/s",
    "optimal, variable": "optimal, 0.15 to 0.4 m/s",
}  # fmt: skip
ARROW = 0.35  # [m] length of those that show a yaw
ARROWS = 12  # on a path of figure 18


def _yaw(axes: Any, pose: Any, colour: str, **line: Any) -> None:
    x, y, yaw = pose
    axes.plot([x, x + ARROW * np.cos(yaw)], [y, y + ARROW * np.sin(yaw)], color=colour, **line)


def paths(results: Results) -> Figure:
    """Figure 16."""
    figure, axes = panels((10.0, 8.0), 2, 2)
    for panel, (planner, title) in zip(axes.flat, TITLES.items(), strict=True):
        shown = {p: v for p, v in results.planning.shown.items() if p.planner == planner}
        plan_ = next(iter(shown.values()))[0].trajectory
        panel.plot(plan_.x, plan_.y, **{**REFERENCE, "label": "plan"})
        for pair, (job, run) in shown.items():
            last = int(np.searchsorted(run.time, job.trajectory.duration))
            line = LINES[pair.controller]
            panel.plot(run.state[: last + 1, 0, 0], run.state[: last + 1, 1, 0], **line)
            _yaw(panel, run.state[last, :3, 0], line["color"], alpha=0.6)
        for pose, colour in (((0.0, 0.0, 0.0), PALETTE[2]), (FIGURE_16, PALETTE[3])):
            panel.plot(*pose[:2], "o", color=colour, markersize=5)
            _yaw(panel, pose, colour, linewidth=1.5)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_title(f"{title}: {plan_.duration:.2f} s")
        panel.set_xlabel("x [m]")
        panel.set_ylabel("y [m]")
    axes[0, 0].legend(fontsize=8)
    return figure


def _error_line(pair: Pair) -> dict[str, Any]:
    colours = dict(zip(TITLES, (PALETTE[3], PALETTE[1], PALETTE[0], PALETTE[2]), strict=True))
    style = "-" if pair.controller == "slc" else "--"
    return {"color": colours[pair.planner], "linestyle": style, "label": pair.name}


def tracking(results: Results) -> Figure:
    """Figure 17, and the errors of all goals by the start."""
    figure, (axes,) = panels((10.0, 4.0), 1, 2)
    for pair, (job, run) in results.planning.shown.items():
        distance, _ = errors_planning_loop(run, job)
        share = run.time[: len(distance)] / job.trajectory.duration
        axes[0].plot(share, 100.0 * distance, linewidth=1.3, **_error_line(pair))
    axes[0].set_xlabel("time / duration of the plan")
    axes[0].set_ylabel("Cartesian error [cm]")
    axes[0].set_title("goal of figure 16")
    axes[0].set_ylim(0.0, 1.45 * axes[0].get_ylim()[1])
    axes[0].legend(fontsize=8, ncols=2)
    setups = {"from rest": PAPER[LENGTHS[-1]], "moving": MOVING[LENGTHS[-1]]}
    for pair in (UC_SLP, SLC_SLP, VARIABLE):
        for (name, setup), style in zip(setups.items(), ("-", ":"), strict=True):
            found = np.sort(results.planning.tracked[setup][pair].distance)
            part = np.arange(1, len(found) + 1) / len(found)
            line = {**_error_line(pair), "linestyle": style, "label": f"{pair.name}, {name}"}
            if pair == UC_SLP:
                line["color"] = PALETTE[1]
            axes[1].plot(100.0 * found, part, linewidth=1.3, **line)
    axes[1].set_xscale("log")
    axes[1].set_xlabel("RMSE of the Cartesian error [cm]")
    axes[1].set_ylabel("share of the goals below it")
    axes[1].set_title("all goals, 0.7 m")
    axes[1].set_ylim(0.0, 1.5)
    axes[1].legend(fontsize=8, ncols=2)
    return figure


def slipperiness(results: Results) -> Figure:
    """Figures 18 and 19."""
    figure, axes = panels((10.0, 7.5), 2, 2)
    planning = results.planning
    groups = {
        "(54), beta subtracted": {k: v for (s, k), v in planning.levels.items()
                                  if s == "subtracted"},
        "(54), beta added as in the code": {k: v for (s, k), v in planning.levels.items()
                                            if s == "added"},
        "identified slip": {f"mu = {mu:g}": v for mu, v in planning.soils.items()},
    }  # fmt: skip
    for panel, (title, plans) in zip(axes.flat, groups.items(), strict=False):
        for k, (name, one) in enumerate(plans.items()):
            panel.plot(one.x, one.y, color=PALETTE[k], linewidth=1.5,
                       label=f"{name}: {one.duration:.2f} s")  # fmt: skip
            for i in np.linspace(0, len(one.time) - 1, ARROWS).astype(int):
                pose = (one.x[i], one.y[i], one.yaw[i])
                _yaw(panel, pose, PALETTE[k], alpha=0.4, linewidth=0.8)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_title(title)
        panel.set_xlabel("x [m]")
        panel.set_ylabel("y [m]")
        panel.legend(fontsize=8)
    for k, (mu, one) in enumerate(planning.soils.items()):
        share = one.time / one.duration
        line: dict[str, Any] = {"color": PALETTE[k], "linewidth": 1.3}
        axes[1, 1].step(share, one.course - one.yaw, where="post", label=f"mu = {mu:g}", **line)
        axes[1, 1].step(share, 0.1 * one.yaw_rate, where="post", linestyle="--", **line)
    axes[1, 1].set_title("identified slip: alpha [rad], and yaw rate / 10 [rad/s] (dashed)")
    axes[1, 1].set_xlabel("time / duration")
    axes[1, 1].legend(fontsize=8)
    return figure


def drawings(results: Results) -> Drawings:
    """All figures of this file."""
    return {
        "plans": (
            paths(results),
            "Figure 16 of the paper: plans to (2, 2.5, -0.4), mu = 0.4, 0.7 m, from rest, tracked "
            "by both controllers until they end.",
        ),
        "plan-errors": (
            tracking(results),
            "Figure 17 of the paper: errors on these plans (left); RMSE of all goals from rest, "
            "and where the vehicle moves as the plan begins (right).",
        ),
        "plan-slip": (
            slipperiness(results),
            "Figures 18 and 19 of the paper: plans with v in [0, 0.8] m/s by the slip that the "
            "planner knows; lines along the paths show the yaw.",
        ),
    }


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


def tracking_slope_figures(slopes: Slopes) -> Figure:
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


def drawings_slope_figures(results: Results) -> Drawings:
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
            tracking_slope_figures(results.slopes),
            "Figures 22 and 23 of the paper: the chicane in closed loop on slopes, mu = 0.6.",
        ),
    }
