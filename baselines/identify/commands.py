"""`tracked-env identify` and `tracked-env slip`: parameters and slip from a user's own files.

Registered in the entry point group `tracked_env.commands`, where the command line finds them.
"""

import argparse
import csv
import io
import json
import shlex
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from baselines.identify import slip_runs, vehicle_log
from baselines.identify.csv_log import UNITS, pairs, table_of
from tracked_env.benchmark.files import machine, versions, write_atomically
from tracked_env.benchmark.table_model import aligned, folded
from tracked_env.cli.command_line import Parser, explained
from tracked_env.engine.env_config import make_vehicle
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.sensors import make_sensors
from tracked_env.validation import checked_number, parsed_json

WIDTH = 80  # [characters] of what is printed
SHOWN = 20  # runs that are not used, on the terminal
GEAR = Range(1e-3, 1e4, "-", "It is the motor speed over the sprocket speed.")
PER_AMPERE = Range(0.0, 1e3, "N m/A", "It is the torque constant of the motor.")
EFFICIENCY = Range(0.05, 1.0, "-", "Did you pass a percentage?")
IDENTIFY = (
    "Run the identification of the adaptive policy over a log and write a report, a set of "
    "parameters for `gymnasium.make(id, **set['make'])`, and all estimates over time. x forward, "
    "y to the left, yaw and yaw rate positive to the left."
)
SLIP = (
    "Fit the slip velocity of both tracks and the slip angle as functions of the sprocket speeds "
    "to runs of a vehicle, and write a model that the slippage-aware policies load, and a report. "
    "A file has a row a run, or rows over time (with the column `time`)."
)


class Option(NamedTuple):
    """An option with one value."""

    name: str
    default: Any  # its type is that of the value
    metavar: str
    help: str


_UNITS = "; ".join(", ".join(units) for units in UNITS.values() if len(units) > 1)
_FILE = (
    Option("--columns", "", "NAME=COLUMN,..", "names or positions (from 1) of columns in the file"),
    Option(
        "--units",
        "",
        "NAME=UNIT,..",
        f"units that are not SI; a header may also say them, `yaw [deg]`. Known are {_UNITS}",
    ),
    Option(
        "--gear",
        1.0,
        "RATIO",
        "motor speed over sprocket speed, where the file has those of "
        "motors (default: 1, the file has those of sprockets)",
    ),
    Option(
        "--vehicle",
        "strawa",
        "NAME|JSON|FILE",
        "geometry and nominal values: strawa, focchi, "
        'focchi-short, or a JSON object or file: {"base": "strawa", "track_gauge": 1.2} '
        "(default: strawa)",
    ),
)
_LOG = (
    Option(
        "--torque-per-ampere", 0.0, "NM/A", "torque constant of the motors, for a log of currents"
    ),
    Option("--efficiency", 1.0, "SHARE", "of the gear, for torques of the motors (default: 1)"),
    Option(
        "--sensors",
        "rtk",
        "NAME|JSON|FILE",
        "noise of the sensors: rtk, mocap, strawa, ideal, "
        'or a JSON object or file: \'{"preset": "rtk", "torque_noise": 30}\' (default: rtk)',
    ),
)


def _parser(program: str, description: str, end: str) -> Parser:
    layout = argparse.RawDescriptionHelpFormatter
    return Parser(program, folded(description, WIDTH), epilog=end, formatter_class=layout)


def _add(parser: Parser, options: Sequence[Option]) -> None:
    for name, default, metavar, text in options:
        kind = Path if isinstance(default, Path) else type(default)
        parser.add_argument(name, type=kind, default=default, metavar=metavar, help=text)


def _add_output(parser: Parser, folder: str) -> None:
    text = f"of the files (default: {folder})"
    _add(parser, [Option("--output", Path(folder), "FOLDER", text)])
    parser.add_argument("--no-figures", action="store_true", help="tables alone on the page")


def json_or_name(text: str, option: str) -> Any:
    """A name, a JSON object, or that of a file. Raises ValueError for a file that is no object."""
    if text.endswith(".json"):
        text = Path(text).read_text(encoding="utf-8")
    if not text.lstrip().startswith("{"):
        return text
    try:
        return parsed_json(text)
    except ValueError as error:
        raise ValueError(f"{option}: no JSON object: {error}") from error


def vehicle_of(text: str) -> PlantParameters:
    """The vehicle of --vehicle; a set of parameters that `identify` wrote is one too."""
    spec = json_or_name(text, "--vehicle")
    if isinstance(spec, dict) and "contradictions" in spec:
        raise ValueError(
            f"--vehicle: {text} is of a log that contradicts its model, and has no vehicle; must "
            "have one. Its entry `contradictions` says why"
        )
    if isinstance(spec, dict) and "make" in spec:
        spec = spec["make"].get("vehicle", {})
    return make_vehicle(spec)


def _provenance(program: str, arguments: Sequence[str], **facts: str) -> dict[str, str]:
    """Where the numbers come from."""
    return {
        "command": shlex.join([*program.split(), *arguments]),
        **facts,
        "versions": ", ".join(f"{name} {of}" for name, of in versions().items()),
        "machine": ", ".join(str(of) for of in machine().values()),
    }


def _write(folder: Path, files: dict[str, bytes]) -> None:
    """Files, each named on a line."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        write_atomically(folder / name, data)
    print("", *(folder / name for name in files), sep="\n")


def identify_main(arguments: Sequence[str], program: str) -> int:
    """Identify, print, write; returns the exit status, 1 for a log that contradicts the model."""
    columns = table_of(vehicle_log.COLUMNS)
    parser = _parser(program, IDENTIFY, f"columns of the log:\n{columns}")
    parser.add_argument("log", type=Path, help="CSV file, a row per sample")
    _add(parser, (*_FILE, *_LOG))
    lateral: dict[str, Any] = {"choices": ("sliding", "constrained"), "default": "sliding"}
    parser.add_argument("--lateral", help="lateral model (default: sliding)", **lateral)
    _add_output(parser, "identified")
    options = parser.parse_args(arguments)
    drivetrain = vehicle_log.Drivetrain(
        checked_number("--gear", options.gear, GEAR),
        checked_number("--torque-per-ampere", options.torque_per_ampere, PER_AMPERE),
        checked_number("--efficiency", options.efficiency, EFFICIENCY),
    )
    vehicle = vehicle_of(options.vehicle)
    sensors = make_sensors(json_or_name(options.sensors, "--sensors"))
    mapping, units = pairs(options.columns, "--columns"), pairs(options.units, "--units")
    log = vehicle_log.read_log(options.log, mapping, units, drivetrain, vehicle, sensors)
    # Here, because compiled code is loaded with it: a wrong file is refused at once.
    from baselines.identify import report_log
    from baselines.identify.identify_log import identify

    with explained():
        identified = identify(log, vehicle, options.lateral)
    parameters = report_log.parameter_set(identified)
    rows = [[*row[:5], row[6]] for row in report_log.result_rows(identified)]
    print(aligned(rows, 2, WIDTH))
    for text in (*log.faults, *parameters["not_told"]):
        print(f"\n{folded(text, WIDTH)}")
    noise = {k: v for k, v in sensors._asdict().items() if k.endswith(("_noise", "_bias"))}
    sheet = {"data sheet": ", ".join(f"{name} {value:g}" for name, value in noise.items())}
    facts = _provenance(program, arguments, **sheet)
    page = report_log.page(identified, options.log.name, facts, not options.no_figures)
    series = {"time": log.time}
    for name, (value, deviation) in identified.series.items():
        series |= {name: value, f"{name}_deviation": deviation}
    series |= {f"{name}_excitation": of for name, of in identified.excitation.items()}
    names = ("x", "y", "yaw", "v_x", "v_y", "yaw_rate")
    series |= dict(zip(names, identified.motion.T, strict=True))
    table = io.StringIO()
    csv.writer(table).writerow(series)
    np.savetxt(table, np.column_stack([*series.values()]), delimiter=",", fmt="%.6g")
    files = {
        "identification.html": page.encode(),
        "parameters.json": (json.dumps(parameters, indent=1) + "\n").encode(),
        "identification.csv": table.getvalue().encode(),
    }
    _write(options.output, files)
    if "make" in parameters:
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
    columns = table_of(slip_runs.COLUMNS)
    parser = _parser(program, SLIP, f"columns:\n{columns}\n\n{order}")
    parser.add_argument("runs", type=Path, nargs="+", help="CSV files")
    _add(parser, _FILE)
    _add_output(parser, "slip")
    options = parser.parse_args(arguments)
    vehicle, gear = vehicle_of(options.vehicle), checked_number("--gear", options.gear, GEAR)
    mapping, units = pairs(options.columns, "--columns"), pairs(options.units, "--units")
    runs = slip_runs.read_runs(options.runs, mapping, units, gear, vehicle)
    from baselines.identify import identify_slip

    with explained():
        fitted = identify_slip.fit(runs, vehicle)
    used, refused = fitted.runs, [f"* {r.run}: {r.reason}" for r in fitted.runs.refused]
    summary = (
        f"{len(fitted.data.alpha)} samples of {len(np.unique(used.run))} runs, "
        f"{used.rows_left_out} rows of them left out; {len(refused)} runs or samples not used, "
        f"{fitted.outliers} of them because they contradict both belts."
    )
    print(f"{folded(summary, WIDTH)}\n")
    print(aligned(identify_slip.score_rows(fitted), 2, WIDTH))
    if refused:
        print("\nNot used:", *(folded(line, WIDTH) for line in refused[:SHOWN]), sep="\n")
    if len(refused) > SHOWN:
        print(f"and {len(refused) - SHOWN} more, on the page")
    geometry = (
        f"sprocket_radius {vehicle.sprocket_radius:g} m, track_gauge {vehicle.track_gauge:g} m"
    )
    facts = _provenance(
        program, arguments, files="; ".join(used.notes), vehicle=f"{geometry}, gear {gear:g}"
    )
    subject = ", ".join(path.name for path in options.runs[:3])
    page = identify_slip.page(fitted, subject, facts, not options.no_figures)
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "slip.npz"
        fitted.model.save(model)
        files = {"slip.html": page.encode(), "slip.npz": model.read_bytes()}
    names = [*fitted.data._fields, "beta_left_predicted", "beta_right_predicted", "alpha_predicted"]
    numbers = np.column_stack([*fitted.data, *fitted.predicted])
    table, texts = io.StringIO(), ([f"{value:.6g}" for value in row] for row in numbers)
    rows = ([run, *row] for run, row in zip(used.run, texts, strict=True))
    csv.writer(table).writerows([["run", *names], *rows])
    _write(options.output, {**files, "slip.csv": table.getvalue().encode()})
    return 0
