"""Figures 16 to 18: plans tracked by both controllers, errors, slip; needs matplotlib."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from reproduce.focchi2025.control_figures import SLC, UC
from reproduce.focchi2025.planning import FIGURE_16
from reproduce.focchi2025.planning_claims import SLC_SLP, UC_SLP
from reproduce.focchi2025.planning_loop import VARIABLE, Pair, errors
from reproduce.focchi2025.planning_runs import MOVING, PAPER
from reproduce.focchi2025.results import Results
from reproduce.focchi2025.runs import LENGTHS
from reproduce.paper_figures import REFERENCE, Drawings, panels
from tracked_env.benchmark.drawing import PALETTE

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
        distance, _ = errors(run, job)
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
