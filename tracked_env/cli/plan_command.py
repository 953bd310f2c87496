"""`tracked-env plan`: a motion to a goal as a table, a figure and a file of numbers.

The planner is that of the installed package which registers `plan` in `tracked_env.commands`.
"""

import argparse
import csv
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tracked_env.benchmark.registered_policies import command_function
from tracked_env.cli.exit_status import Parser, reported
from tracked_env.cli.waiting import explained
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
        from tracked_env.cli.plan_figure import save

        points = [given.start, *given.via, given.goal]
        files.append(save(given.output / "plan.png", found, points, given.obstacle_circle))
    for file in files:
        print(file)
