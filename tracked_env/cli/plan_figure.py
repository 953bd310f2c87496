"""Figure of a plan: path with footprints, speeds, sprockets, slip; needs matplotlib."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.drawing import DPI, PALETTE, REFERENCE_COLOUR, STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOOTPRINTS = 10  # drawn along a path, its ends included
SIZE = 11.0, 6.6  # [inch]
COURSE, YAW, THIRD = PALETTE[0], PALETTE[1], PALETTE[2]


def save(file: Path, found: Any, points: Sequence[Any], circles: Sequence[Any]) -> Path:
    """Draw a plan with its way points (K, 3) and circles x, y, radius [m]; returns the file.

    Raises ImportError without matplotlib.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(
            "the figure needs matplotlib: pip install 'tracked-env[render]', or pass --no-figure"
        ) from error
    made = found.trajectory
    file.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({**STYLE, "text.parse_math": False}):
        figure = Figure(figsize=SIZE, dpi=DPI)
        grid = figure.add_gridspec(5, 2, width_ratios=(1.15, 1.0), left=0.06, right=0.99, top=0.93,
                                   bottom=0.08, hspace=0.22, wspace=0.17)  # fmt: skip
        _path(figure.add_subplot(grid[:, 0]), found, np.asarray(points, dtype=float), circles)
        over_time = [figure.add_subplot(grid[0, 1])]
        over_time += [figure.add_subplot(grid[i, 1], sharex=over_time[0]) for i in range(1, 5)]
        _over_time(over_time, found)
        state = "" if made.converged else ", not converged"
        figure.suptitle(
            f"{made.method}: {made.duration:.2f} s, {made.length:.2f} m, ends "
            f"{1e3 * made.end_error:.3f} mm from the goal{state}",
            x=0.06, y=0.98, ha="left", va="top", fontsize=11,
        )  # fmt: skip
        figure.savefig(file)
    return file


def outline(pose: NDArray[Any], vehicle: Any) -> NDArray[Any]:
    """Corners (5, 2) [m] of the rectangle around both tracks of a vehicle at x, y, yaw."""
    half = 0.5 * vehicle.contact_length, 0.5 * (vehicle.track_gauge + vehicle.track_width)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * half
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return corners @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]


def _path(axes: "Axes", found: Any, points: NDArray[Any], circles: Sequence[Any]) -> None:
    from matplotlib.patches import Circle

    made = found.trajectory
    for x, y, radius in circles:
        axes.add_patch(Circle((x, y), radius, facecolor="0.8", edgecolor="0.5"))
    axes.plot(made.x, made.y, color=COURSE, linewidth=1.8, label="path of the centre")
    when = np.linspace(0.0, made.duration, FOOTPRINTS)
    at = np.minimum(np.searchsorted(made.time, when - 1e-9), len(made.time) - 1)
    for k in at:
        box = outline(np.array([made.x[k], made.y[k], made.yaw[k]]), found.vehicle)
        axes.plot(*box.T, color="0.7", linewidth=0.7)
    length = 0.6 * found.vehicle.contact_length
    gear = np.where(made.speed[at] < 0.0, -1.0, 1.0)
    for angle, colour, sign, label in (
        (made.course[at], COURSE, gear, "course"), (made.yaw[at], YAW, 1.0, "yaw"),
    ):  # fmt: skip
        axes.quiver(
            made.x[at], made.y[at], sign * length * np.cos(angle), sign * length * np.sin(angle),
            angles="xy", scale_units="xy", scale=1.0, color=colour, width=0.004, label=label,
            zorder=3,
        )  # fmt: skip
    marks = [("o", "start")] + [("s", "way point")] * (len(points) - 2) + [("*", "goal")]
    for (x, y, _), (marker, label) in zip(points, marks, strict=True):
        axes.plot(x, y, marker, color="0.2", markersize=9, markerfacecolor="none", label=label)
    for k in (0, len(points) - 1):
        box = outline(points[k], found.vehicle)
        axes.plot(*box.T, color="0.2", linewidth=1.0, linestyle=":")
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(unique.values(), unique.keys(), loc="best", fontsize=8)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _over_time(axes: Sequence["Axes"], found: Any) -> None:
    made, limits = found.trajectory, found.limits
    left, right, alpha = found.slip
    panels: tuple[tuple[str, tuple[tuple[Any, str], ...], tuple[float, ...]], ...] = (
        ("speed [m/s]", ((made.speed, "ground"), (made.speed * np.cos(alpha), "v_x")),
         (limits.v_max,)),
        ("yaw rate [rad/s]", ((made.course_rate, "course"), (made.yaw_rate, "yaw")), ()),
        ("sprocket [rad/s]", ((made.sprocket_left, "left"), (made.sprocket_right, "right")),
         (limits.sprocket_used, -limits.sprocket_used)),
        ("beta [m/s]", ((left, "left"), (right, "right")), ()),
        ("alpha [rad]", ((alpha, "alpha"),), ()),
    )  # fmt: skip
    for each, (label, lines, bounds) in zip(axes, panels, strict=True):
        for (values, name), colour, style in zip(lines, (COURSE, YAW), ("-", "--"), strict=False):
            each.plot(made.time, values, color=colour, linestyle=style, linewidth=1.3, label=name)
        for bound in bounds:
            each.axhline(bound, color=REFERENCE_COLOUR, linestyle=":", linewidth=1.0)
        each.set_ylabel(label)
        each.locator_params(axis="y", nbins=4)
        each.margins(y=0.15)
        if len(lines) > 1:
            each.legend(loc="best", fontsize=8, ncols=2, handlelength=1.5)
        if each is not axes[-1]:
            each.tick_params(labelbottom=False)
    axes[-1].set_xlabel("time [s]")
