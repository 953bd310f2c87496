"""Figures 16 to 23: plans tracked by both controllers, load models, stiffening, slopes."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025 import slopes as closed
from reproduce.focchi2025.claims import SLC_SLP, UC_SLP
from reproduce.focchi2025.control import LENGTHS
from reproduce.focchi2025.control_figures import ASSUMED, ONLINE, SLC, UC
from reproduce.focchi2025.planning import FIGURE_16
from reproduce.focchi2025.planning_loop import MOVING, PAPER, VARIABLE, Pair, errors
from reproduce.focchi2025.slopes import HALF_SIDE, SlopeCase, Slopes, UnevenGround
from reproduce.paper_page import REFERENCE, panels
from tracked_env.benchmark.figures import PALETTE

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


def paths(results: Any) -> Figure:
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
        panel.set(title=f"{title}: {plan_.duration:.2f} s", xlabel="x [m]", ylabel="y [m]")
    axes[0, 0].legend(fontsize=8)
    return figure


def _error_line(pair: Pair) -> dict[str, Any]:
    colours = dict(zip(TITLES, (PALETTE[3], PALETTE[1], PALETTE[0], PALETTE[2]), strict=True))
    style = "-" if pair.controller == "slc" else "--"
    return {"color": colours[pair.planner], "linestyle": style, "label": pair.name}


def tracking(results: Any) -> Figure:
    """Figure 17, and the errors of all goals by the start."""
    figure, (axes,) = panels((10.0, 4.0), 1, 2)
    for pair, (job, run) in results.planning.shown.items():
        distance, _ = errors(run, job)
        share = run.time[: len(distance)] / job.trajectory.duration
        axes[0].plot(share, 100.0 * distance, linewidth=1.3, **_error_line(pair))
    axes[0].set(
        xlabel="time / duration of the plan",
        ylabel="Cartesian error [cm]",
        title="goal of figure 16",
        ylim=(0.0, 1.45 * axes[0].get_ylim()[1]),
    )
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
    axes[1].set(
        xscale="log",
        xlabel="RMSE of the Cartesian error [cm]",
        ylabel="share of the goals below it",
        title="all goals, 0.7 m",
        ylim=(0.0, 1.5),
    )
    axes[1].legend(fontsize=8, ncols=2)
    return figure


def slipperiness(results: Any) -> Figure:
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
        panel.set(title=title, xlabel="x [m]", ylabel="y [m]")
        panel.legend(fontsize=8)
    for k, (mu, one) in enumerate(planning.soils.items()):
        share = one.time / one.duration
        line: dict[str, Any] = {"color": PALETTE[k], "linewidth": 1.3}
        axes[1, 1].step(share, one.course - one.yaw, where="post", label=f"mu = {mu:g}", **line)
        axes[1, 1].step(share, 0.1 * one.yaw_rate, where="post", linestyle="--", **line)
    axes[1, 1].set(
        title="identified slip: alpha [rad], and yaw rate / 10 [rad/s] (dashed)",
        xlabel="time / duration",
    )
    axes[1, 1].legend(fontsize=8)
    return figure


# Slopes

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
    axes.set(aspect="equal", xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), xlabel="x [m]")


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


def slope_tracking(slopes: Slopes) -> Figure:
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
    grade = np.linspace(-closed.STEEPEST, closed.STEEPEST, 61)
    along, across = (axis.ravel() for axis in np.meshgrid(grade, grade))
    model = closed.model("nonuniform").on(np.stack([along, across], axis=1))
    left, right = (np.full(along.size, speed) for speed in closed.BEND)
    beta_left, _, alpha = model.slip(left, right)
    for panel, values, title in (
        (axes[0], 1e3 * beta_left, r"$\beta_L$ [mm/s] of a left turn"),
        (axes[1], 1e3 * alpha, r"$\alpha$ [mrad] of a left turn"),
    ):
        shown = panel.contourf(grade, grade, values.reshape(61, 61), levels=16, cmap="viridis")
        figure.colorbar(shown, ax=panel)
        panel.set(title=title, xlabel="gravity ahead [-]", aspect="equal")
    axes[0].set_ylabel("gravity to the left [-]")
    for speed, found, colour in zip(closed.STRAIGHT, slopes.identification.side_slip, PALETTE,
                                    strict=False):  # fmt: skip
        axes[2].plot(closed.GRADES, 1e3 * np.abs(found), "o-", color=colour, markersize=3,
                     label=f"{speed:g} rad/s")  # fmt: skip
    first = 1e3 * abs(float(slopes.identification.side_slip[1, 0])) / float(closed.GRADES[0])
    axes[2].plot(closed.GRADES, first * closed.GRADES, color="0.5", linewidth=0.8, linestyle=":",
                 label="proportional")  # fmt: skip
    axes[2].set(title=r"$|\alpha|$ [mrad] straight across a slope", xlabel="grade [-]")
    axes[2].legend(fontsize=7)
    return figure


def drawings(results: Any) -> dict[str, Figure]:
    """All figures of this file."""
    return {
        "plans": paths(results),
        "plan-errors": tracking(results),
        "plan-slip": slipperiness(results),
        "loads": load_models(results.slopes),
        "stiffening": stiffening(results.slopes),
        "slope-slip": slip_on_slopes(results.slopes),
        "slope-chicane": slope_tracking(results.slopes),
    }
