"""`tracked-env plan`: a motion to a goal as a table, a figure and a file of numbers.

The planner is that of the installed package which registers `plan` in `tracked_env.commands`.

Figure of a plan: path with footprints, speeds, sprockets, slip; needs matplotlib.
"""

import argparse
import csv
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.figures import DPI, PALETTE, REFERENCE_COLOUR, STYLE
from tracked_env.benchmark.policies import command_function
from tracked_env.cli.exit_status import Parser, explained, reported
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_number

POSE: dict[str, Any] = {"nargs": 3, "type": float, "metavar": ("X", "Y", "YAW")}
# Options that are limits of the plan: field and help.
LIMITS = {
    "v_min": "least speed of the belts' mean [m/s]; that of --v-max: constant speed",
    "v_max": "largest speed [m/s]",
    "reserve": "share of the sprocket speed that is left to the controller",
    "sprocket_acceleration": "of either sprocket [rad/s^2]; without it a plan does not brake",
}
# Options of a plan around obstacles, the defaults of the planner where they are not there.
AROUND = {
    "margin": "around the vehicle [m]",
    "room": "around start and goal in which a way around obstacles is searched [m]",
    "time_limit": "of that search [s]",
}
MOVING = 0.25  # [-] of v_max: slower, a turn on the spot has any curvature
YAW = Range(-2.0 * np.pi, 2.0 * np.pi, "rad", "Did you pass degrees?")
RANGES = {
    "v_min": Range(0.0, 30.0, "m/s", "Did you pass km/h, or mean --reverse?"),
    "v_max": Range(0.001, 30.0, "m/s", "Did you pass km/h, or mean --reverse?"),
    "sprocket_acceleration": Range(0.001, 1e5, "rad/s^2", "Did you mean the sprocket speed?"),
}
COLUMNS = ("time", "x", "y", "yaw", "course", "speed", "course_rate", "yaw_rate", "sprocket_left",
           "sprocket_right")  # fmt: skip
SLIP_COLUMNS = ("beta_left", "beta_right", "alpha")


def _parser(program: str) -> argparse.ArgumentParser:
    parser = Parser(
        program,
        "Plan a motion to a goal, print it as a table and draw it. Lengths in m, "
        "angles in rad, speeds in m/s and rad/s. The exit status is 1 where no plan was found.",
    )
    parser.add_argument("--goal", required=True, help="pose to reach", **POSE)
    parser.add_argument("--start", default=(0.0, 0.0, 0.0), help="pose at first (default: 0 0 0)",
                        **POSE)  # fmt: skip
    parser.add_argument("--via", action="append", default=[], help="way point; may be repeated",
                        **POSE)  # fmt: skip
    parser.add_argument("--obstacle-circle", action="append", default=[], nargs=3, type=float,
                        metavar=("X", "Y", "R"), help="obstacle; may be repeated")  # fmt: skip
    for name, text in AROUND.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, help=text)
    parser.add_argument("--method", default="optimal",
                        help="optimal (default), dubins, reeds-shepp or clothoid")  # fmt: skip
    parser.add_argument("--vehicle", default="focchi", help="(default: focchi)")
    parser.add_argument("--friction", type=float, metavar="MU",
                        help="of the soil (default: that of the vehicle)")  # fmt: skip
    parser.add_argument("--slope", nargs=2, type=float, metavar=("DZ/DX", "DZ/DY"),
                        help="of the ground (default: level)")  # fmt: skip
    parser.add_argument("--reverse", action="store_true", help="allow driving backwards")
    parser.add_argument("--no-slip", action="store_true", help="plan as if tracks did not slip")
    for name, text in LIMITS.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, help=text)
    parser.add_argument("--output", type=Path, default=Path(), metavar="FOLDER",
                        help="of the files (default: the current one)")  # fmt: skip
    parser.add_argument("--csv", action="store_true", help="write plan.csv too")
    parser.add_argument("--no-figure", action="store_true", help="do not draw plan.png")
    return parser


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Plan, print, draw; returns the exit status."""
    given = _parser(program).parse_args(arguments)
    for name, poses in (("--start", [given.start]), ("--via", given.via), ("--goal", [given.goal])):
        for pose in poses:
            checked_number(f"{name} yaw", pose[2], YAW)
    limits = _present(given, LIMITS)
    for name in limits.keys() & RANGES.keys():
        checked_number(f"--{name.replace('_', '-')}", limits[name], RANGES[name])
    with explained():
        found = command_function("plan")(
            given.goal, given.start, given.method, given.vehicle, given.friction,
            not given.no_slip, limits, given.via, given.obstacle_circle,
            given.reverse, given.slope, _present(given, AROUND),
        )  # fmt: skip
    print("\n".join(table(found)))
    _write(given, found)
    if not found.trajectory.converged:
        print(f"{program}: {found.trajectory.message}", file=sys.stderr)
        return 1
    return 0


def _present(given: argparse.Namespace, names: Iterable[str]) -> dict[str, float]:
    """Options that are there, by name."""
    return {name: value for name in names if (value := getattr(given, name)) is not None}


def table(found: Any) -> list[str]:
    """Lines with name, value and unit of what describes a plan."""
    made = found.trajectory
    speed, slow = np.abs(made.speed), MOVING * found.limits.v_max
    moving = speed > slow
    bend = np.abs(made.yaw_rate[moving]) / speed[moving]
    sprocket = max(np.abs(made.sprocket_left).max(), np.abs(made.sprocket_right).max())
    lines = [("method", made.method, ""), ("converged", "yes" if made.converged else "no", "")]
    if made.converged:
        steps = [np.abs(np.diff(side)) for side in (made.sprocket_left, made.sprocket_right)]
        ends = max(abs(made.sprocket_left[-1]), abs(made.sprocket_right[-1]))
        lines += [
            ("duration", f"{made.duration:.3f}", "s"),
            ("length", f"{made.length:.3f}", "m"),
            ("cost", f"{made.cost:.3f}", "s"),
            ("largest speed", f"{speed.max():.3f}", "m/s"),
            ("largest sprocket speed", f"{sprocket:.2f}",
             f"rad/s of {found.limits.sprocket_used:.3g}"),
            ("largest sprocket step", f"{np.max(steps, initial=0.0):.2f}", "rad/s at once"),
            ("sprocket speed at end", f"{ends:.2f}", "rad/s"),
            ("largest curvature", f"{bend.max(initial=0.0):.2f}", f"1/m above {slow:.2g} m/s"),
        ]  # fmt: skip
    lines += [
        ("iterations", f"{made.iterations}", ""),
        ("end error", f"{made.end_error:.2g}", "m"),
        ("end yaw error", f"{made.end_yaw_error:.2g}", "rad"),
    ]
    if made.message:
        lines.append(("message", made.message, ""))
    return [f"{name:<24}{value} {unit}".rstrip() for name, value, unit in lines]


def _write(given: argparse.Namespace, found: Any) -> None:
    """The files, each named on a line."""
    files = [given.output / "plan.csv"] if given.csv else []
    if given.csv:
        given.output.mkdir(parents=True, exist_ok=True)
        columns = [getattr(found.trajectory, name) for name in COLUMNS] + [*found.slip]
        with files[0].open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([*COLUMNS, *SLIP_COLUMNS])
            writer.writerows(np.column_stack(columns).tolist())
    if not given.no_figure:
        points = [given.start, *given.via, given.goal]
        files.append(save(given.output / "plan.png", found, points, given.obstacle_circle))
    for file in files:
        print(file)


if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOOTPRINTS = 10  # drawn along a path, its ends included
SIZE = 11.0, 6.6  # [inch]
COURSE, YAW_PLAN_FIGURE, THIRD = PALETTE[0], PALETTE[1], PALETTE[2]


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
        (made.course[at], COURSE, gear, "course"), (made.yaw[at], YAW_PLAN_FIGURE, 1.0, "yaw"),
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
        for (values, name), colour, style in zip(
            lines, (COURSE, YAW_PLAN_FIGURE), ("-", "--"), strict=False
        ):
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
