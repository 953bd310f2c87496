"""What one policy for any vehicle is worth: drawn vehicles, over a controller that is told each.

    python -m benchmarks.studies.untold_vehicles                        the shipped agents
    python -m benchmarks.studies.untold_vehicles --env Speed-v0
    python -m benchmarks.studies.untold_vehicles --agents runs/*/agent.zip --first 50000

Of every vehicle of the set of the id four episodes: two with the sensors of the id, one with a
pose a second, one with outages. An error is the RMSE of the distance to the reference; that of a
vehicle is the geometric mean of its episodes over that of `adaptive`, by speed of `slc-adaptive`,
which is told the vehicle. By torque the agents drive untold and told.
The table has the median over vehicles with its 95 % interval (bootstrap of vehicles), the 90 %
quantile, the largest one, medians by sensors and by thirds of the contact length, and what is lost.
All but `whole` are of what is left after 5 s; an episode that ends before has the error at which
episodes end.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.learned.agent_policy import ANY_VEHICLE
from baselines.learned.trained_agent import TrainedAgent, apart_at, open_agent, read_recipe
from baselines.registry import ANY, shipped_agents
from benchmarks.studies import Cells, records_of, show, study_parser, write_csv
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.benchmark import BenchmarkConfig, Store
from tracked_env.benchmark.benchmark_config import FLEET_LIMIT
from tracked_env.benchmark.policies import archive_entry, policies_for
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.store import Record
from tracked_env.cli.command_line import reported
from tracked_env.cli.evaluate_command import result_folder

TURNS = 4  # episodes of a vehicle
RESAMPLES = 4000
# Set, and the controllers that are told, by the id; the first is what errors are over.
TOLD = {
    TORQUE_ID: ("vehicles", ("adaptive", "mpc-adaptive")),
    SPEED_ID: ("floor-vehicles", ("slc-adaptive", "mpc-adaptive", "uc")),
}
HEAD = (
    *("policy", "whole", "after 5 s", "90 % quantile", "largest", "plain", "rare pose", "outages"),
    *("small", "middle", "large", "lost"),
)
Errors = NDArray[np.float64]  # (vehicles, TURNS)


def open_told(path: Path) -> TrainedAgent:
    """An agent that is shown the data sheet of its vehicle. Raises ValueError."""
    recipe, plain = read_recipe(path), open_agent(path)
    assert recipe is not None  # of what has been opened
    return TrainedAgent(apart_at(path, recipe, ANY_VEHICLE, told=True), plain.sources)


def entries_of(env: str, archives: Sequence[Path]) -> list[PolicyEntry]:
    """The controllers, then every agent untold and, by torque, told. Raises ValueError."""
    entries = policies_for(env, TOLD[env][1])
    kinds = (("untold", open_agent), ("told", open_told))
    for kind, open_one in kinds if env == TORQUE_ID else kinds[:1]:
        for path in archives:
            entry = archive_entry(path, open_one)
            entries.append(entry._replace(name=f"{path.parent.name} {kind}"))
    return entries


def errors_of(
    records: Sequence[Record], policy: str, first: int, limits: Errors
) -> tuple[Errors, Errors, NDArray[np.bool_]]:
    """RMSE of the whole and after 5 s [m], and what was lost; limits (vehicles,) [m]."""
    whole, settled = np.empty((2, len(limits), TURNS))
    lost = np.zeros((len(limits), TURNS), dtype=bool)
    for record in records:
        if record["policy"] == policy:
            place = divmod(record["seed"] - first, TURNS)
            limit = limits[place[0]]
            after = record["settled_rmse"]
            whole[place], lost[place] = record["tracking_rmse"], record["ended"] != "time"
            settled[place] = limit if after is None or not after < limit else after
    return whole, settled, lost


def row_of(name: str, own: Any, base: Any, order: Any) -> list[str]:
    """A row of the table; own, base: of `errors_of`; order: vehicles by their length."""
    rng, count = np.random.default_rng(0), len(order)
    resampled = rng.integers(count, size=(RESAMPLES, count))
    whole, settled = (np.log(a / b) for a, b in zip(own[:2], base[:2], strict=True))
    cells, mean = [name], settled.mean(axis=1)
    for each in (whole.mean(axis=1), mean):
        low, high = np.exp(np.quantile(np.median(each[resampled], axis=1), [0.025, 0.975]))
        cells.append(f"{np.exp(np.median(each)):.2f} [{low:.2f}, {high:.2f}]")
    sensors = settled[:, :2].mean(axis=1), settled[:, 2], settled[:, 3]
    thirds = [mean[third] for third in np.array_split(order, 3)]
    values = [
        np.quantile(mean, 0.9),
        mean.max(),
        *(np.median(each) for each in (*sensors, *thirds)),
    ]
    return [*cells, *(f"{np.exp(value):.2f}" for value in values), f"{100.0 * own[2].mean():.2f} %"]


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Run what is missing, print and write the table."""
    ids = {"envs": tuple(TOLD), "default": TORQUE_ID}
    parser = study_parser(program, (__doc__ or "").split("\n")[0], 100 * TURNS, ids)
    parser.add_argument("--agents", nargs="+", type=Path, help="archives (default: shipped ones)")
    parser.add_argument("--first", type=int, default=0, help="seed of the first episode")
    options = parser.parse_args(arguments)
    name, controllers = TOLD[options.env]
    entries = entries_of(options.env, options.agents or shipped_agents(options.env)[ANY])
    count = options.episodes // TURNS
    if count < 1:
        raise ValueError(f"--episodes = {options.episodes}; must be at least {TURNS}, of a vehicle")
    config = BenchmarkConfig((name,), TURNS * count, options.first)
    store = Store(result_folder(options.output, config), config.identity())
    records = records_of(config, entries, store, options.workers)
    lengths = np.array(
        [config.arguments(name, False, TURNS * v)["vehicle"].contact_length for v in range(count)]
    )
    first, limits = config.first_seed(name), FLEET_LIMIT * lengths
    found = {entry.name: errors_of(records, entry.name, first, limits) for entry in entries}
    base, order = found[controllers[0]], np.argsort(lengths)
    cells: Cells = [[*HEAD], *(row_of(name, own, base, order) for name, own in found.items())]
    write_csv(store.folder / "untold_vehicles.csv", cells)
    show(cells, 1)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "untold_vehicles"))
