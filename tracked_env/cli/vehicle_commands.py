"""`tracked-env vehicle` and `tracked-env plan`: what a vehicle can do, and how it gets to a goal.

vehicle: its abilities on its soil and on others, and what of its parameters does not fit.

plan: a motion as a table, a figure and a file of numbers. The planner is that of the installed
package which registers `plan` in `tracked_env.commands`.
"""

import csv
import math
import shutil
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark import table_model
from tracked_env.benchmark.policies import command_function
from tracked_env.benchmark.table_model import Table
from tracked_env.cli.command_line import (
    EnvironmentOptions,
    Parser,
    add_field,
    explained,
    vehicle_spec,
)
from tracked_env.cli.evaluate_options import add_option
from tracked_env.physics.parameters import GROUPS, RANGES, PlantParameters, Range
from tracked_env.uncertainty.soils import SOILS
from tracked_env.validation import checked_number
from tracked_env.vehicles import find_vehicle, vehicle_names, vehicle_values
from tracked_env.vehicles.abilities import Abilities, abilities, contradictions

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def _row(name: str, able: Abilities) -> list[str]:
    return [
        name,
        f"{able.traction:.4g}",
        f"{able.turning_torque:.4g}",
        f"{able.turning_share:.0%}",
        f"{math.degrees(able.steepest_grade):.0f}",
        f"{able.acceleration:.2g}",
    ]


def on_soils(p: PlantParameters) -> Table:
    """Table of what a vehicle can do on its own soil and on those of the catalogue."""
    head = "soil", "traction [N]", "turning torque [N m]", "of the effort", "grade [deg]"
    rows = [[*head, "acceleration [m/s^2]"], _row("its own", abilities(p))]
    for name, soil in SOILS.items():
        values = {key: getattr(soil, key) for key in soil._fields[:3]}  # strength; not resistance
        rows.append(_row(name, abilities(p._replace(**values))))
    note = (
        "Of one track; the torque that a turn on the spot needs, and its share of what drive and "
        "soil give. Other soils: their c, phi and K with the mu_l and mu_t of its own."
    )
    return Table("On soils", rows, 1, [note])


def description(name: str, p: PlantParameters) -> Table:
    """Table of the parameters of a vehicle, and what follows from them on every soil."""
    able = abilities(p)
    rows = [["quantity", "value", "unit"]]
    for key in (*GROUPS["vehicle"][:10], *GROUPS["soil"][:5]):
        rows.append([key, f"{getattr(p, key):g}", RANGES[key].unit])
    rows += [
        ["ground pressure", f"{able.ground_pressure / 1e3:.1f}", "kPa"],
        ["top speed", f"{able.top_speed:.3g}", "m/s"],
        ["fastest turn on the spot", f"{able.fastest_turn:.3g}", "rad/s"],
        ["effort of one drive", f"{able.drive_effort:.4g}", "N"],
    ]
    return Table(name, rows)


def catalogue() -> Table:
    """Table of all vehicles that have a name."""
    rows = [["vehicle", "mass [kg]", "l [m]", "kPa", "m/s", "turn", "grade [deg]", "title"]]
    for name in vehicle_names():
        p = find_vehicle(name)
        able = abilities(p)
        size = f"{p.mass:g}", f"{p.contact_length:g}", f"{able.ground_pressure / 1e3:.1f}"
        motion = f"{able.top_speed:.3g}", f"{able.turning_share:.0%}"
        grade, title = math.degrees(able.steepest_grade), vehicle_values(name).get("title", "")
        rows.append([name, *size, *motion, f"{grade:.0f}", str(title)])
    note = "turn: share of its effort that it needs to turn on the spot, on its own soil."
    return Table("Vehicles", rows, 1, [note])


def vehicle_main(arguments: Sequence[str], program: str) -> int:
    """Print; returns the exit status."""
    parser = Parser(
        program,
        "What a vehicle can do: ground pressure, top speed, turns, grades, on its own soil and on "
        "others; and what of its parameters does not fit together.",
    )
    text = "as --vehicle of the other commands (default: list the vehicles that have a name)"
    parser.add_argument("vehicle", nargs="?", metavar="VEHICLE", help=text)
    options = parser.parse_args(arguments)
    width = shutil.get_terminal_size().columns
    if options.vehicle is None:
        print(table_model.terminal([catalogue()], width))
        return 0
    spec = vehicle_spec(options.vehicle)
    p, values = find_vehicle(spec), vehicle_values(spec)
    title = str(values.get("title") or options.vehicle)
    tables = [description(title, p), on_soils(p)]
    print(table_model.terminal(tables, width))
    if values.get("source"):
        print(f"source: {values['source']}")
    for sentence in contradictions(p):
        print(f"warning: {sentence}")
    return 0


# Plans

# Options that are limits of the plan: field and help.
LIMITS = {
    "v_min": "least speed of the belts' mean [m/s], 0 to 30, or that of --v-max: constant speed "
    "(default: 0.15)",
    "v_max": "largest speed [m/s], 0.001 to 30 (default: 0.4)",
    "reserve": "share of the sprocket speed that is left to the controller, in [0, 1) (default: 0)",
    "sprocket_acceleration": "of either sprocket [rad/s^2], 0.001 to 1e5 (default: unlimited, and "
    "a plan does not brake)",
}
# Options of a plan around obstacles, the defaults of the planner where they are not there.
AROUND = {
    "margin": "around the vehicle [m], 0 to 100 (default: 0.05)",
    "room": "around start and goal in which a way around obstacles is searched [m], 0 to 1e6 "
    "(default: as wide as the obstacles)",
    "time_limit": "of that search [s], 0 to 1e5 (default: 5)",
}
MOVING = 0.25  # [-] of v_max: slower, a turn on the spot has any curvature
YAW = Range(-2.0 * np.pi, 2.0 * np.pi, "rad", "Did you pass degrees?")
LIMIT_RANGES = {
    "v_min": Range(0.0, 30.0, "m/s", "Did you pass km/h, or mean --reverse?"),
    "v_max": Range(0.001, 30.0, "m/s", "Did you pass km/h, or mean --reverse?"),
    "sprocket_acceleration": Range(0.001, 1e5, "rad/s^2", "Did you mean the sprocket speed?"),
}
COLUMNS = ("time", "x", "y", "yaw", "course", "speed", "course_rate", "yaw_rate")
SPROCKETS = ("sprocket_left", "sprocket_right")
SLIP_COLUMNS = ("beta_left", "beta_right", "alpha")
FOOTPRINTS = 10  # drawn along a path, its ends included


def _plan_parser(program: str) -> Parser:
    parser = Parser(
        program,
        "Plan a motion to a goal, print it as a table and draw it. Lengths in m, "
        "angles in rad, speeds in m/s and rad/s. The exit status is 1 where no plan was found.",
    )
    pose: dict[str, Any] = {"nargs": 3, "type": float, "metavar": ("X", "Y", "YAW")}
    turn = "yaw within 2 pi"
    circle = {**pose, "metavar": ("X", "Y", "R")}
    slope = {**pose, "nargs": 2, "metavar": ("DZ/DX", "DZ/DY")}
    several: dict[str, Any] = {"action": "append", "default": []}
    add, method = parser.add_argument, "optimal (default), dubins, reeds-shepp or clothoid"
    around = "obstacle, R > 0; may be repeated (default: none)"
    add("--goal", required=True, help=f"pose to reach, {turn}", **pose)
    add("--start", default=(0.0, 0.0, 0.0), help=f"pose at first, {turn} (default: 0 0 0)", **pose)
    add("--via", help=f"way point, {turn}; may be repeated (default: none)", **pose, **several)
    add("--obstacle-circle", help=around, **circle, **several)
    for name, text in {**AROUND, **LIMITS}.items():
        add(f"--{name.replace('_', '-')}", type=float, help=text)
    add("--method", default="optimal", help=method)
    text = "vehicle that drives, as in the other commands; plans are driven on Speed-v0"
    add_field(parser, EnvironmentOptions, "vehicle", text, default="focchi")
    friction = "of the soil, > 0 (default: that of the vehicle)"
    add("--friction", type=float, metavar="MU", help=friction)
    add("--slope", help="of the ground, -1 to 1 each (default: level)", **slope)
    add("--reverse", action="store_true", help="allow driving backwards (default: no)")
    add("--no-slip", action="store_true", help="plan as if tracks did not slip (default: no)")
    folder = "of the files (default: the current one)"
    add("--output", type=Path, default=Path(), metavar="FOLDER", help=folder)
    add("--csv", action="store_true", help="write plan.csv too (default: no)")
    add_option(parser, "figures", "draw plan.png")
    return parser


def plan_main(arguments: Sequence[str], program: str) -> int:
    """Plan, print, draw; returns the exit status."""
    options = _plan_parser(program).parse_args(arguments)
    for name, poses in (("start", [options.start]), ("via", options.via), ("goal", [options.goal])):
        for pose in poses:
            checked_number(f"--{name} yaw", pose[2], YAW)

    def present(names: Iterable[str]) -> dict[str, float]:
        return {name: x for name in names if (x := getattr(options, name)) is not None}

    limits = present(LIMITS)
    for name in limits.keys() & LIMIT_RANGES.keys():
        checked_number(f"--{name.replace('_', '-')}", limits[name], LIMIT_RANGES[name])
    with explained():
        plan = command_function("plan")(
            options.goal,
            options.start,
            options.method,
            vehicle_spec(options.vehicle),
            options.friction,
            not options.no_slip,
            limits,
            slope=options.slope,
            circles=options.obstacle_circle,
            via=options.via,
            reverse=options.reverse,
            **present(AROUND),
        )
    print("\n".join(plan_table(plan)))
    folder: Path = options.output
    if options.csv:
        folder.mkdir(parents=True, exist_ok=True)
        columns = [getattr(plan.trajectory, name) for name in (*COLUMNS, *SPROCKETS)] + [*plan.slip]
        with (folder / "plan.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([*COLUMNS, *SPROCKETS, *SLIP_COLUMNS])
            writer.writerows(np.column_stack(columns).tolist())
        print(folder / "plan.csv")
    if options.figures:
        points = np.array([options.start, *options.via, options.goal], dtype=float)
        draw(folder / "plan.png", plan, points, options.obstacle_circle)
        print(folder / "plan.png")
    if not plan.trajectory.converged:
        print(f"{program}: {plan.trajectory.message}", file=sys.stderr)
        return 1
    return 0


def plan_table(plan: Any) -> list[str]:
    """Lines with name, value and unit of what describes a plan."""
    way, limits = plan.trajectory, plan.limits
    speed, slow = np.abs(way.speed), MOVING * limits.v_max
    moving = speed > slow
    bend = np.abs(way.yaw_rate[moving]) / speed[moving]
    sprockets = np.abs([way.sprocket_left, way.sprocket_right])
    lines = [("method", way.method, ""), ("converged", "yes" if way.converged else "no", "")]
    if way.converged:
        step = np.abs(np.diff([way.sprocket_left, way.sprocket_right])).max(initial=0.0)
        unit = f"rad/s of {limits.sprocket_used:.3g}"
        lines += [
            ("duration", f"{way.duration:.3f}", "s"),
            ("length", f"{way.length:.3f}", "m"),
            ("cost", f"{way.cost:.3f}", "s"),
            ("largest speed", f"{speed.max():.3f}", "m/s"),
            ("largest sprocket speed", f"{sprockets.max():.2f}", unit),
            ("largest sprocket step", f"{step:.2f}", "rad/s at once"),
            ("sprocket speed at end", f"{sprockets[:, -1].max():.2f}", "rad/s"),
            ("largest curvature", f"{bend.max(initial=0.0):.2f}", f"1/m above {slow:.2g} m/s"),
        ]
    lines += [
        ("iterations", f"{way.iterations}", ""),
        ("end error", f"{way.end_error:.2g}", "m"),
        ("end yaw error", f"{way.end_yaw_error:.2g}", "rad"),
    ]
    if way.message:
        lines.append(("message", way.message, ""))
    return [f"{name:<24}{value} {unit}".rstrip() for name, value, unit in lines]


def outline(pose: NDArray[Any], vehicle: Any) -> NDArray[Any]:
    """Corners (5, 2) [m] of the rectangle around both tracks of a vehicle at x, y, yaw."""
    half = 0.5 * vehicle.contact_length, 0.5 * (vehicle.track_gauge + vehicle.track_width)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * half
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return corners @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]


def draw(file: Path, plan: Any, points: NDArray[Any], circles: Sequence[Any]) -> None:
    """A figure of a plan: path with footprints, speeds, sprockets, slip.

    points (K, 3): start, way points, goal; circles: x, y, radius [m].
    """
    from tracked_env.benchmark.figures import PALETTE, REFERENCE_COLOUR, picture

    way, limits = plan.trajectory, plan.limits
    left, right, alpha = plan.slip
    sprockets = {"left": way.sprocket_left, "right": way.sprocket_right}
    panels: dict[str, tuple[dict[str, Any], tuple[float, ...]]] = {  # lines, bounds
        "speed [m/s]": ({"ground": way.speed, "v_x": way.speed * np.cos(alpha)}, (limits.v_max,)),
        "yaw rate [rad/s]": ({"course": way.course_rate, "yaw": way.yaw_rate}, ()),
        "sprocket [rad/s]": (sprockets, (limits.sprocket_used, -limits.sprocket_used)),
        "beta [m/s]": ({"left": left, "right": right}, ()),
        "alpha [rad]": ({"alpha": alpha}, ()),
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    with picture(file, 7.0) as figure:
        axes = figure.subplot_mosaic([["path", label] for label in panels])
        _draw_path(axes["path"], plan, points, circles)
        for label, (lines, bounds) in panels.items():
            for k, (name, values) in enumerate(lines.items()):
                shape: Any = {"linestyle": ("-", "--")[k], "color": PALETTE[k], "linewidth": 1.3}
                axes[label].plot(way.time, values, label=name, **shape)
            for bound in bounds:
                axes[label].axhline(bound, color=REFERENCE_COLOUR, linestyle=":", linewidth=1.0)
            axes[label].set_ylabel(label)
            axes[label].legend(loc="best", ncols=2, handlelength=1.5)
        axes[label].set_xlabel("time [s]")
        figure.suptitle(
            f"{way.method}: {way.duration:.2f} s, {way.length:.2f} m, ends "
            f"{1e3 * way.end_error:.3f} mm from the goal"
            + ("" if way.converged else ", not converged")
        )


def _draw_path(axes: "Axes", plan: Any, points: NDArray[Any], circles: Sequence[Any]) -> None:
    from matplotlib.patches import Circle

    way = plan.trajectory
    for x, y, radius in circles:
        axes.add_patch(Circle((x, y), radius, facecolor="0.8", edgecolor="0.5"))
    when = np.linspace(0.0, way.duration, FOOTPRINTS)
    at = np.minimum(np.searchsorted(way.time, when - 1e-9), len(way.time) - 1)
    for pose in np.stack([way.x, way.y, way.yaw], axis=1)[at]:
        axes.plot(*outline(pose, plan.vehicle).T, color="0.7", linewidth=0.7)
    axes.plot(way.x, way.y, color="C0", linewidth=1.8, label="path of the centre")
    marks = ("o", "start", points[:1]), ("s", "way point", points[1:-1]), ("*", "goal", points[-1:])
    for marker, label, some in marks:
        if len(some):
            style: Any = {"color": "0.2", "markersize": 9, "markerfacecolor": "none"}
            axes.plot(some[:, 0], some[:, 1], marker, label=label, **style)
    axes.legend(loc="best")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]")
