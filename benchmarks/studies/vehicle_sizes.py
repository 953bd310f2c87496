"""How the controllers drive vehicles of every size: the catalogue, each on its own random paths.

    python -m benchmarks.studies.vehicle_sizes                    by torques, as Torque-v0
    python -m benchmarks.studies.vehicle_sizes --env Speed-v0     by speeds
    python -m benchmarks.studies.vehicle_sizes --reference figure_eight

Errors are the interquartile mean of the RMSE of the distance to the reference over the episodes, in
contact lengths: of the whole episode, and after its first 5 s. A lost episode counts as infinite.
"""

import sys
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from scipy.stats import trim_mean

from benchmarks.studies import Cells, policies_of, records_of, show, study_parser, write_csv
from tracked_env import TORQUE_ID
from tracked_env.benchmark import BenchmarkConfig, BenchmarkSet, Store
from tracked_env.benchmark.store import Record
from tracked_env.cli.command_line import reported
from tracked_env.cli.evaluate_command import result_folder
from tracked_env.cli.evaluate_options import env_of
from tracked_env.vehicles import find_vehicle, vehicle_names

POLICIES = {"torque": ("adaptive", "mpc-adaptive"), "speed": ("slc-adaptive",)}
FIRST_SEED = 65_000  # of no published set
OFF_PATH = 2.5  # [-] contact lengths at which an episode ends


def make_sets(
    env: str, names: Sequence[str], reference: str | None = None
) -> tuple[BenchmarkSet, ...]:
    """A set for each vehicle: the id as it is, with that vehicle, and another reference."""
    usual: dict[str, Any] = gymnasium.spec(env).kwargs
    sets = []
    for name in names:
        length = find_vehicle(name).contact_length
        own = {**usual, "vehicle": name, "error_limit": OFF_PATH * length}
        law, sensors = own.pop("uncertainty", "soil-and-mass"), own.pop("sensors", "rtk")
        path = own.pop("reference", "random") if reference is None else reference
        sets.append(BenchmarkSet(name, law, sensors, path, env=env, arguments=own))
    return tuple(sets)


def errors(records: Sequence[Record], policy: str, length: float) -> tuple[float, float, int]:
    """(whole, after 5 s, episodes lost) of a policy on one vehicle."""
    own = [record for record in records if record["policy"] == policy]
    lost = [record["ended"] != "time" for record in own]
    both = [
        trim_mean([np.inf if gone else r[key] for r, gone in zip(own, lost, strict=True)], 0.25)
        for key in ("tracking_rmse", "settled_rmse")
    ]
    return both[0] / length, both[1] / length, sum(lost)


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Run what is missing, print and write the table."""
    parser = study_parser(program, (__doc__ or "").split("\n")[0], 16)
    parser.add_argument("--vehicles", nargs="+", default=vehicle_names(), metavar="NAME")
    parser.add_argument("--reference", metavar="KIND", help="scaled to each (default: of the id)")
    options = parser.parse_args(arguments)
    env = env_of(options.env, None) or TORQUE_ID
    sets = make_sets(env, options.vehicles, options.reference)
    names = tuple(options.vehicles)
    config = BenchmarkConfig(names, options.episodes, FIRST_SEED, own_sets=sets)
    drive = config.context(names[0]).drive
    options.policies = options.policies or POLICIES[drive]
    entries = policies_of(options, env)
    store = Store(result_folder(options.output, config), config.identity())
    records = records_of(config, entries, store, options.workers)
    head = [f"{entry.name}: {what}" for entry in entries for what in ("whole", "after 5 s", "lost")]
    cells: Cells = [["vehicle", "mass [kg]", "l [m]", *head]]
    for name in names:
        p, of = find_vehicle(name), [r for r in records if r["set"] == name]
        row = [name, f"{p.mass:g}", f"{p.contact_length:g}"]
        for entry in entries:
            whole, after, lost = errors(of, entry.name, p.contact_length)
            row += [f"{whole:.4f}", f"{after:.4f}", str(lost)]
        cells.append(row)
    write_csv(store.folder / "vehicle_sizes.csv", cells)
    show(cells, 1)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "vehicle_sizes"))
