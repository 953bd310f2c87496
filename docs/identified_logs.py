"""How often the 95 % intervals of `tracked-env identify` hold the truth.

    python -m docs.identified_logs               # the logs on which the intervals were designed
    python -m docs.identified_logs --seed 91000  # fresh ones

Vehicles and soils are drawn at random and driven by the adaptive policy; what the sensors say goes
through CSV files, as a user's log does.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from baselines.identify.identify_log import SOIL, identify
from baselines.identify.vehicle_log import Drivetrain, read_log
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from tracked_env.cli.record_command import record_logs
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import PRESETS
from tracked_env.vector_env import TrackedVehicleVectorEnv

SEED = 90_000  # the design of the intervals was chosen on 100 logs of `soil-and-mass` from here
KNOWN = ("mass", "longitudinal_resistance", "inertia", "lateral_resistance")
Logs = list[tuple[Path, dict[str, float]]]
Intervals = dict[str, list[tuple[bool, float, float]]]


def driven(
    folder: Path, count: int, duration: float, soils: str = "soil-and-mass", first: int = SEED
) -> Logs:
    """(log, true values) of `count` episodes of `duration` [s] of an uncertainty set.

    first: seed of the first episode.
    """
    env = TrackedVehicleVectorEnv(
        count, uncertainty=soils, duration=duration, error_limit=1e5, autoreset_mode="Disabled"
    )
    paths = [folder / f"{number}.csv" for number in range(count)]
    seeds = [first + number for number in range(count)]
    return list(zip(paths, record_logs(env, AdaptivePolicy(), paths, seeds), strict=True))


def intervals(logs: Logs) -> Intervals:
    """(whether it holds the truth, half of its width, value) of every interval by parameter."""
    found: Intervals = {name: [] for name in (*KNOWN, *SOIL)}
    for path, truth in logs:
        log = read_log(path, {}, {}, Drivetrain(), VEHICLES["strawa"], PRESETS["rtk"])
        for name, of in identify(log, VEHICLES["strawa"]).parameters.items():
            if name in KNOWN or of.verdict != "not determined":
                inside = of.low <= truth[name] <= of.high
                found[name].append((inside, 0.5 * (of.high - of.low), of.value))
    return found


def table(found: Intervals) -> str:
    """The coverage as a Markdown table."""
    lines = ["| parameter | intervals | hold the truth | half of the width |", "|--|--:|--:|--:|"]
    for name, of in {**found, "all": [one for part in found.values() for one in part]}.items():
        if of:
            held = np.mean([inside for inside, _, _ in of])
            width = np.median([half / value for _, half, value in of])
            shown = "" if name == "all" else f"{width:.1%}"
            lines.append(f"| {name} | {len(of)} | {held:.0%} | {shown} |")
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--set", default="soil-and-mass")
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        logs = driven(Path(folder), given.count, given.duration, given.set, given.seed)
        print(table(intervals(logs)))
