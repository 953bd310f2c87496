"""`tracked-env slip`: the slip of a vehicle over its sprocket speeds, from a user's own runs."""

import argparse
import csv
import shlex
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tracked_env.benchmark.provenance import machine, versions
from tracked_env.benchmark.store import write_atomically
from tracked_env.benchmark.text_tables import aligned, folded
from tracked_env.cli.exit_status import Parser, reported
from tracked_env.cli.identify_command import GEAR, WIDTH, add_vehicle_options, vehicle_of
from tracked_env.cli.user_data.csv_columns import pairs, table_of
from tracked_env.cli.user_data.slip_runs import COLUMNS, ORDER, read_runs
from tracked_env.cli.waiting import explained
from tracked_env.validation import checked_number

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
def main(arguments: Sequence[str], program: str) -> int:
    """Fit, print, write; returns the exit status."""
    given = _parser(program).parse_args(arguments)
    vehicle, gear = vehicle_of(given.vehicle), checked_number("--gear", given.gear, GEAR)
    mapping, units = pairs(given.columns, "--columns"), pairs(given.units, "--units")
    runs = read_runs(given.runs, mapping, units, gear, vehicle)
    from tracked_env.cli.user_data import slip_page
    from tracked_env.cli.user_data.slip_fit import fit

    with explained():
        fitted = fit(runs, vehicle)
    count = len(np.unique(fitted.runs.run))
    said = (
        f"{len(fitted.data.alpha)} samples of {count} runs, {fitted.runs.rows_left_out} rows of "
        f"them left out; {len(fitted.runs.refused)} runs or samples not used, {fitted.outliers} "
        "of them because they contradict both belts."
    )
    print(f"{folded(said, WIDTH)}\n")
    print(aligned(slip_page.score_rows(fitted), 2, WIDTH))
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
    _write(given.output, fitted, slip_page.page(fitted, subject, facts, not given.no_figures))
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
