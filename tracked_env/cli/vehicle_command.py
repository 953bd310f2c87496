"""`tracked-env vehicle`: what a vehicle can do on its soil and on others, what does not fit."""

import math
import shutil
from collections.abc import Sequence

from tracked_env.benchmark import table_model
from tracked_env.benchmark.table_model import Table
from tracked_env.cli.command_line import Parser, reported, vehicle_spec
from tracked_env.physics.parameters import GROUPS, RANGES, PlantParameters
from tracked_env.uncertainty.soils import SOILS
from tracked_env.vehicles import find_vehicle, vehicle_names, vehicle_values
from tracked_env.vehicles.abilities import Abilities, abilities, contradictions

OWN_SOIL = "its own"


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
    rows = [[*head, "acceleration [m/s^2]"], _row(OWN_SOIL, abilities(p))]
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
        rows.append([
            name, f"{p.mass:g}", f"{p.contact_length:g}", f"{able.ground_pressure / 1e3:.1f}",
            f"{able.top_speed:.3g}", f"{able.turning_share:.0%}",
            f"{math.degrees(able.steepest_grade):.0f}", str(vehicle_values(name).get("title", "")),
        ])  # fmt: skip
    note = "turn: share of its effort that it needs to turn on the spot, on its own soil."
    return Table("Vehicles", rows, 1, [note])


@reported
def main(arguments: Sequence[str], program: str) -> int:
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
