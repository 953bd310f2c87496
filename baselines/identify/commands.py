"""`tracked-env identify` and `tracked-env slip`: parameters and slip from a user's own files.

Registered in the entry point group `tracked_env.commands`, where the command line finds them.
"""

import argparse
import csv
import io
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from baselines.identify import slip_runs, vehicle_log
from baselines.identify.csv_log import UNITS, pairs, table_of
from tracked_env.benchmark.files import machine, versions, write_atomically
from tracked_env.benchmark.table_model import aligned, folded
from tracked_env.cli.command_line import (
    EnvironmentOptions,
    Parser,
    add_field,
    explained,
    vehicle_spec,
)
from tracked_env.physics.parameters import Range
from tracked_env.sensors import make_sensors
from tracked_env.validation import checked_number, name_or_json
from tracked_env.vehicles import find_vehicle

WIDTH = 80  # [characters] of what is printed
GEAR = Range(1e-3, 1e4, "-", "It is the motor speed over the sprocket speed.")
PER_AMPERE = Range(0.0, 1e3, "N m/A", "It is the torque constant of the motor.")
EFFICIENCY = Range(0.05, 1.0, "-", "Did you pass a percentage?")
IDENTIFY = (
    "Run the identification of the adaptive policy over a log and write the vehicle, for "
    "`gymnasium.make(id, vehicle=...)` and --vehicle of all commands, a report, a set of "
    "parameters, and all estimates over time. x forward, "
    "y to the left, yaw and yaw rate positive to the left."
)
SENSORS = 'rtk (default), mocap, strawa, ideal, or JSON: {"preset": "rtk", "torque_noise": 30}'
SLIP = (
    "Fit the slip velocity of both tracks and the slip angle as functions of the sprocket speeds "
    "to runs of a vehicle, and write a model that the slippage-aware policies load, and the "
    "vehicle with the friction of its runs, for --vehicle of all commands. "
    "A file has a row a run, or rows over time (with the column `time`)."
)


def _parser(program: str, description: str, end: str, folder: str) -> Parser:
    """A parser with the options of both commands."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = Parser(program, folded(description, WIDTH), epilog=end, formatter_class=layout)
    units = "; ".join(", ".join(names) for names in UNITS.values() if len(names) > 1)
    options: list[tuple[str, Any, str, str]] = [
        ("--columns", "", "NAME=COLUMN,..", "names or positions from 1 of columns (default: own)"),
        ("--units", "", "NAME=UNIT,..", f"units that are not SI, of {units} (default: SI)"),
        ("--gear", 1.0, "RATIO", "motor over sprocket speed, 0.001 to 1e4 (default: 1)"),
        ("--output", Path(folder), "FOLDER", f"folder of the files (default: {folder})"),
    ]
    _add(parser, options)
    text = "vehicle that drove, as in the other commands: its sizes are taken as right"
    add_field(parser, EnvironmentOptions, "vehicle", text, required=True)
    return parser


def _add(parser: Parser, options: list[tuple[str, Any, str, str]]) -> None:
    """Options, each with name, default, whose type is that of the value, metavar and help."""
    for name, default, metavar, text in options:
        kind = Path if isinstance(default, Path) else type(default)
        parser.add_argument(name, type=kind, default=default, metavar=metavar, help=text)


def _write(folder: Path, files: dict[str, bytes]) -> None:
    """Files, each named on a line."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        write_atomically(folder / name, data)
    print("", *(folder / name for name in files), sep="\n")


def identify_main(arguments: Sequence[str], program: str) -> int:
    """Identify, print, write; returns the exit status, 1 for a log that contradicts the model."""
    end = f"columns of the log:\n{table_of(vehicle_log.COLUMNS)}"
    parser = _parser(program, IDENTIFY, end, "identified")
    parser.add_argument("log", type=Path, help="CSV file, a row per sample")
    more: list[tuple[str, Any, str, str]] = [
        ("--torque-per-ampere", 0.0, "NM/A", "of a log of currents, 0 to 1000 (default: 0)"),
        (
            "--efficiency",
            1.0,
            "SHARE",
            "of the gear, 0.05 to 1, if torques are motors' (default: 1)",
        ),
        ("--sensors", "rtk", "NAME|JSON|FILE", f"noise of the sensors: {SENSORS}"),
    ]
    _add(parser, more)
    options = parser.parse_args(arguments)
    drivetrain = vehicle_log.Drivetrain(
        checked_number("--gear", options.gear, GEAR),
        checked_number("--torque-per-ampere", options.torque_per_ampere, PER_AMPERE),
        checked_number("--efficiency", options.efficiency, EFFICIENCY),
    )
    vehicle = find_vehicle(vehicle_spec(options.vehicle))
    sheet: Any = name_or_json(options.sensors, "sensors")
    sensors = make_sensors(sheet, torque_limit=vehicle.torque_limit)
    mapping, units = pairs(options.columns, "--columns"), pairs(options.units, "--units")
    log = vehicle_log.read_log(options.log, mapping, units, drivetrain, vehicle, sensors)
    # Here, because compiled code is loaded with it: a wrong file is refused at once.
    from baselines.identify import report_log
    from baselines.identify.identify_log import identify

    with explained():
        identified = identify(log, vehicle)
    parameters = report_log.parameter_set(identified)
    rows = [[*row[:5], row[6]] for row in report_log.result_rows(identified)]
    print(aligned(rows, 2, WIDTH))
    for text in (*log.faults, *parameters["not_told"]):
        print(f"\n{folded(text, WIDTH)}")
    noise = {k: v for k, v in sensors._asdict().items() if k.endswith(("_noise", "_bias"))}
    facts = {
        "command": shlex.join([*program.split(), *arguments]),
        "data sheet": ", ".join(f"{name} {value:g}" for name, value in noise.items()),
        "versions": ", ".join(f"{name} {version}" for name, version in versions().items()),
        "machine": ", ".join(map(str, machine().values())),
    }
    page = report_log.page(identified, options.log.name, facts)
    table = io.StringIO()
    series = report_log.over_time(identified)
    csv.writer(table).writerow(series)
    np.savetxt(table, np.column_stack([*series.values()]), delimiter=",", fmt="%.6g")
    files = {
        "identification.html": page.encode(),
        "parameters.json": (json.dumps(parameters, indent=1) + "\n").encode(),
        "identification.csv": table.getvalue().encode(),
    }
    if toml := report_log.vehicle_file(parameters):
        files = {"vehicle.toml": toml.encode(), **files}
    _write(options.output, files)
    if toml:
        return 0
    print(
        f"{program}: {options.log}: the log contradicts the model; parameters.json has no "
        "vehicle for gymnasium.make",
        file=sys.stderr,
    )
    return 1


def slip_main(arguments: Sequence[str], program: str) -> int:
    """Fit, print, write; returns the exit status."""
    order = f"A file without a header and --columns has {', '.join(slip_runs.ORDER)}."
    end = f"columns:\n{table_of(slip_runs.COLUMNS)}\n\n{order}"
    parser = _parser(program, SLIP, end, "slip")
    parser.add_argument("runs", type=Path, nargs="+", help="CSV files")
    options = parser.parse_args(arguments)
    vehicle = find_vehicle(vehicle_spec(options.vehicle))
    gear = checked_number("--gear", options.gear, GEAR)
    mapping, units = pairs(options.columns, "--columns"), pairs(options.units, "--units")
    runs = slip_runs.read_runs(options.runs, mapping, units, gear, vehicle)
    from baselines.identify import identify_slip

    with explained():
        fitted = identify_slip.fit(runs, vehicle)
    print(f"{folded(identify_slip.summary(fitted), WIDTH)}\n")
    print(aligned(identify_slip.score_rows(fitted), 2, WIDTH))
    soil = identify_slip.friction(fitted, vehicle)
    print(f"\n{folded(soil.text, WIDTH)}")
    if fitted.runs.refused:
        lines = (folded(f"* {r.run}: {r.reason}", WIDTH) for r in fitted.runs.refused)
        print("\nNot used:", *lines, sep="\n")
    model, table = io.BytesIO(), io.StringIO()
    fitted.model.save(model)
    names = [*fitted.data._fields, "beta_left_predicted", "beta_right_predicted", "alpha_predicted"]
    rows = np.column_stack([*fitted.data, *fitted.predicted])
    csv.writer(table).writerow(["run", *names])
    for run, row in zip(fitted.runs.run, rows, strict=True):
        csv.writer(table).writerow([run, *(f"{value:.6g}" for value in row)])
    files = {"slip.npz": model.getvalue(), "slip.csv": table.getvalue().encode()}
    toml = identify_slip.vehicle_file(vehicle, soil).encode()
    _write(options.output, {"vehicle.toml": toml, **files})
    return 0
