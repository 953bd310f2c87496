"""`tracked-env identify`: mass, inertia, resistance, slip and soil from a user's own log.

`tracked-env slip`: the slip of a vehicle over its sprocket speeds, from a user's own runs.
"""

import argparse
import csv
import json
import shlex
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from baselines.identify.csv_log import UNITS, pairs, table_of
from baselines.identify.slip_runs import COLUMNS, ORDER, read_runs
from baselines.identify.vehicle_log import COLUMNS as COLUMNS_vehicle_log
from baselines.identify.vehicle_log import Drivetrain, read_log
from tracked_env.benchmark.store import machine, versions, write_atomically
from tracked_env.benchmark.text_tables import aligned, folded
from tracked_env.cli.exit_status import Parser, explained, reported
from tracked_env.engine.env_config import make_vehicle
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.sensors import Sensors, make_sensors
from tracked_env.validation import checked_number, parsed_json

DESCRIPTION_IDENTIFY_COMMAND = (
    "Run the identification of the adaptive policy over a log and write a report, a set of "
    "parameters for `gymnasium.make(id, **set['make'])`, and all estimates over time. x forward, "
    "y to the left, yaw and yaw rate positive to the left."
)
WIDTH = 80  # [characters] of what is printed
GEAR = Range(1e-3, 1e4, "-", "It is the motor speed over the sprocket speed.")
PER_AMPERE = Range(0.0, 1e3, "N m/A", "It is the torque constant of the motor.")
EFFICIENCY = Range(0.05, 1.0, "-", "Did you pass a percentage?")


def add_vehicle_options(parser: argparse.ArgumentParser) -> None:
    """Options of the columns, units, gear and vehicle of a user's file."""
    known = [of for of in UNITS.values() if len(of) > 1]
    parser.add_argument("--columns", default="", metavar="NAME=COLUMN,..",
                        help="names or positions (from 1) of columns in the file")  # fmt: skip
    parser.add_argument("--units", default="", metavar="NAME=UNIT,..",
                        help="units that are not SI; a header may also say them, `yaw [deg]`. "
                        "Known are " + "; ".join(", ".join(of) for of in known))  # fmt: skip
    parser.add_argument("--gear", type=float, default=1.0, metavar="RATIO",
                        help="motor speed over sprocket speed, where the file has those of motors "
                        "(default: 1, the file has those of sprockets)")  # fmt: skip
    parser.add_argument("--vehicle", default="strawa", metavar="NAME|JSON|FILE",
                        help="geometry and nominal values: strawa, focchi, focchi-short, or a JSON "
                        "object or file: {\"base\": \"strawa\", \"track_gauge\": 1.2} "
                        "(default: strawa)")  # fmt: skip


def json_or_name(text: str, what: str) -> Any:
    """A name, a JSON object, or that of a file. Raises ValueError for a file that is no object."""
    if text.endswith(".json"):
        text = Path(text).read_text(encoding="utf-8")
    if not text.lstrip().startswith("{"):
        return text
    try:
        return parsed_json(text)
    except ValueError as error:
        raise ValueError(f"{what}: no JSON object: {error}") from error


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


def _parser_identify_command(program: str) -> argparse.ArgumentParser:
    parser = Parser(
        program,
        folded(DESCRIPTION_IDENTIFY_COMMAND, WIDTH),
        epilog="columns of the log:\n" + table_of(COLUMNS_vehicle_log),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("log", type=Path, help="CSV file, a row per sample")
    add_vehicle_options(parser)
    parser.add_argument("--torque-per-ampere", type=float, default=0.0, metavar="NM/A",
                        help="torque constant of the motors, for a log of currents")  # fmt: skip
    parser.add_argument("--efficiency", type=float, default=1.0, metavar="SHARE",
                        help="of the gear, for torques of the motors (default: 1)")  # fmt: skip
    parser.add_argument("--sensors", default="rtk", metavar="NAME|JSON|FILE",
                        help="noise of the sensors: rtk, mocap, strawa, ideal, or a JSON object "
                        "or file: '{\"preset\": \"rtk\", \"torque_noise\": 30}' "
                        "(default: rtk)")  # fmt: skip
    parser.add_argument("--lateral", choices=("sliding", "constrained"), default="sliding",
                        help="lateral model (default: sliding)")  # fmt: skip
    parser.add_argument("--output", type=Path, default=Path("identified"), metavar="FOLDER",
                        help="of the files (default: identified)")  # fmt: skip
    parser.add_argument("--no-figures", action="store_true", help="tables alone on the page")
    return parser


@reported
def identify_command(arguments: Sequence[str], program: str) -> int:
    """Identify, print, write; returns the exit status, 1 for a log that contradicts the model."""
    given = _parser_identify_command(program).parse_args(arguments)
    drivetrain = Drivetrain(
        checked_number("--gear", given.gear, GEAR),
        checked_number("--torque-per-ampere", given.torque_per_ampere, PER_AMPERE),
        checked_number("--efficiency", given.efficiency, EFFICIENCY),
    )
    vehicle, sensors = (
        vehicle_of(given.vehicle),
        make_sensors(json_or_name(given.sensors, "--sensors")),
    )
    mapping, units = pairs(given.columns, "--columns"), pairs(given.units, "--units")
    log = read_log(given.log, mapping, units, drivetrain, vehicle, sensors)
    # Here, because compiled code is loaded with it: a wrong file is refused at once.
    from baselines.identify import pages
    from baselines.identify.identify_log import identify, parameter_set

    with explained():
        identified = identify(log, vehicle, given.lateral)
    made = parameter_set(identified)
    rows = [[*row[:5], row[6]] for row in pages.result_rows(identified)]
    print(aligned(rows, 2, WIDTH))
    for text in (*log.faults, *made["not_told"]):
        print(f"\n{folded(text, WIDTH)}")
    command = shlex.join([*program.split(), *arguments])
    page = pages.page_log_page(
        identified, given.log.name, _facts(command, sensors), not given.no_figures
    )
    _write_identify_command(given.output, identified, made, page)
    if "make" not in made:
        print(
            f"{program}: {given.log}: the log contradicts the model; parameters.json has no "
            "vehicle for gymnasium.make",
            file=sys.stderr,
        )
        return 1
    return 0


def _facts(command: str, sensors: Sensors) -> dict[str, str]:
    """Where the numbers come from."""
    noise = {k: v for k, v in sensors._asdict().items() if k.endswith(("_noise", "_bias"))}
    return {
        "command": command,
        "data sheet": ", ".join(f"{name} {value:g}" for name, value in noise.items()),
        "versions": ", ".join(f"{name} {of}" for name, of in versions().items()),
        "machine": ", ".join(str(of) for of in machine().values()),
    }


def _write_identify_command(folder: Path, identified: Any, made: dict[str, Any], page: str) -> None:
    """The three files, each named on a line."""
    folder.mkdir(parents=True, exist_ok=True)
    series = {"time": identified.log.time}
    for name, (value, deviation) in identified.series.items():
        series |= {name: value, f"{name}_deviation": deviation}
    series |= {f"{name}_excitation": of for name, of in identified.excitation.items()}
    names = ("x", "y", "yaw", "v_x", "v_y", "yaw_rate")
    series |= {name: identified.motion[:, k] for k, name in enumerate(names)}
    with (folder / "identification.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerow(series)
        np.savetxt(file, np.column_stack([*series.values()]), delimiter=",", fmt="%.6g")
    write_atomically(folder / "parameters.json", (json.dumps(made, indent=1) + "\n").encode())
    write_atomically(folder / "identification.html", page.encode())
    print(file=sys.stdout)
    for name in ("identification.html", "parameters.json", "identification.csv"):
        print(folder / name)


DESCRIPTION = (
    "Fit the slip velocity of both tracks and the slip angle as functions of the sprocket speeds "
    "to runs of a vehicle, and write a model that the slippage-aware policies load, and a report. "
    "A file has a row a run, or rows over time (with the column `time`)."
)
SHOWN = 20  # runs that are not used, on the terminal


def _parser(program: str) -> argparse.ArgumentParser:
    parser = Parser(
        program,
        folded(DESCRIPTION, WIDTH),
        epilog="columns:\n" + table_of(COLUMNS) + "\n\nA file without a header and --columns has "
        f"{', '.join(ORDER)}.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("runs", type=Path, nargs="+", help="CSV files")
    add_vehicle_options(parser)
    parser.add_argument("--output", type=Path, default=Path("slip"), metavar="FOLDER",
                        help="of the files (default: slip)")  # fmt: skip
    parser.add_argument("--no-figures", action="store_true", help="tables alone on the page")
    return parser


@reported
def slip_command(arguments: Sequence[str], program: str) -> int:
    """Fit, print, write; returns the exit status."""
    given = _parser(program).parse_args(arguments)
    vehicle, gear = vehicle_of(given.vehicle), checked_number("--gear", given.gear, GEAR)
    mapping, units = pairs(given.columns, "--columns"), pairs(given.units, "--units")
    runs = read_runs(given.runs, mapping, units, gear, vehicle)
    from baselines.identify import pages
    from baselines.identify.identify_slip import fit

    with explained():
        fitted = fit(runs, vehicle)
    count = len(np.unique(fitted.runs.run))
    said = (
        f"{len(fitted.data.alpha)} samples of {count} runs, {fitted.runs.rows_left_out} rows of "
        f"them left out; {len(fitted.runs.refused)} runs or samples not used, {fitted.outliers} "
        "of them because they contradict both belts."
    )
    print(f"{folded(said, WIDTH)}\n")
    print(aligned(pages.score_rows(fitted), 2, WIDTH))
    refused = [f"* {r.run}: {r.reason}" for r in fitted.runs.refused]
    if refused:
        print("\nNot used:")
        print("\n".join(folded(line, WIDTH) for line in refused[:SHOWN]))
        if len(refused) > SHOWN:
            print(f"and {len(refused) - SHOWN} more, on the page")
    command = shlex.join([*program.split(), *arguments])
    facts = {
        "command": command, "files": "; ".join(fitted.runs.said),
        "vehicle": f"sprocket_radius {vehicle.sprocket_radius:g} m, track_gauge "
        f"{vehicle.track_gauge:g} m, gear {gear:g}",
        "versions": ", ".join(f"{name} {of}" for name, of in versions().items()),
        "machine": ", ".join(str(of) for of in machine().values()),
    }  # fmt: skip
    subject = ", ".join(path.name for path in given.runs[:3])
    _write(given.output, fitted, pages.page(fitted, subject, facts, not given.no_figures))
    return 0


def _write(folder: Path, fitted: Any, page: str) -> None:
    """The three files, each named on a line."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as place:
        made = Path(place) / "slip.npz"
        fitted.model.save(made)
        write_atomically(folder / "slip.npz", made.read_bytes())
    names = [*fitted.data._fields, "beta_left_predicted", "beta_right_predicted", "alpha_predicted"]
    with (folder / "slip.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["run", *names])
        for run, row in zip(
            fitted.runs.run, np.column_stack([*fitted.data, *fitted.predicted]), strict=True
        ):
            writer.writerow([run, *(f"{value:.6g}" for value in row)])
    write_atomically(folder / "slip.html", page.encode())
    print()
    for name in ("slip.html", "slip.npz", "slip.csv"):
        print(folder / name)
