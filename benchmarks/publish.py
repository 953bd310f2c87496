"""Publish a leaderboard: from the results of evaluate.py into the documentation.

    python evaluate.py                                    # all controllers and shipped agents
    python benchmarks/publish.py results/torque-v3-seed0-*   # tables and scores.json

Likewise with `--env tracked_env/Speed-v0` and results/speed-v3-*, and with
`--env tracked_env/Terrain-v0` and results/terrain-v3-*. docs/results.md gets the whole
table between the two markers of that environment, with the cost of training each agent, read from
the curve.csv beside it, and README.md the columns SHORT of it.
`baselines/learned/pretrained/ENV/scores.json` gets the interquartile mean of the RMSE per seed or
controller and set with a 95 % bootstrap interval over the episodes; tests run some of them again,
and ask whether each set separates the policies that it should.
"""

import argparse
import json
import re
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from tracked_env.benchmark import SETS
from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.files import replace_block
from tracked_env.benchmark.leaderboard import between
from tracked_env.benchmark.report import rate_unit
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.summary import action_rate
from tracked_env.benchmark.text_tables import escaped

ROOT = Path(__file__).resolve().parent.parent
PRETRAINED = ROOT / "baselines" / "learned" / "pretrained"
SHORT = ("", "policy", "seeds", "RMSE, all sets [m]", "after 5 s [m]", "success")  # and the verdict


def track_of(board: dict[str, Any]) -> str:
    """Environment of a leaderboard, as the folder of its agents is called."""
    return SETS[next(name for name in board["sets"] if name in SETS)].env.partition("/")[2]


def training_cost(agent: str, track: str) -> str:
    """Steps and mean processor time of trainings of a shipped agent, '-' for a controller."""
    curves = [
        np.genfromtxt(path, delimiter=",", names=True)
        for path in sorted((PRETRAINED / track).glob(f"{agent}-seed*/curve.csv"))
    ]
    if not curves:
        return "-"
    seconds = np.mean([curve["cpu_seconds"][-1] for curve in curves])
    return f"{curves[0]['steps'][-1] / 1e6:.2g} M steps, {seconds:.0f} s"


def estimate_text(estimate: dict[str, float], digits: int, seeds: int) -> str:
    """Value and interval, as the leaderboard writes them."""
    return between(Estimate(**estimate), digits, seeds)


def table(board: dict[str, Any]) -> str:
    """The leaderboard as Markdown: overall, then the IQM of the RMSE per set."""
    agents, track = board["agents"], track_of(board)
    means = [
        {name: np.nan if value is None else value for name, value in e["overall"]["means"].items()}
        for e in agents
    ]
    unit, factor = rate_unit(means)
    rates = [f"{factor * action_rate(of)[0]:.1f}" for of in means]
    lines = [
        "| | policy | seeds | RMSE, all sets [m] | after 5 s [m] | score | worst tenth [m] "
        f"| success | action rate [{unit}] | P(better) | than {escaped(board['reference'])} "
        "| training of a seed, CPU |",
        "|--:|--|--:|--:|--:|--:|--:|--:|--:|--:|--|--:|",
    ]
    for rank, entry in enumerate(agents, start=1):
        o = entry["overall"]
        seeds = entry["seeds"] or "-"
        star = "" if entry["seeds"] in (None, 0) or entry["seeds"] >= 5 else "*"
        against = entry["against"]
        chance = "-" if against is None else f"{against['improvement']['value']:.0%}"
        cells = [
            f"{rank}", escaped(entry["agent"]), f"{seeds}{star}",
            estimate_text(o["rmse_iqm"], 3, entry["seeds"]), f"{o['settled_iqm']['value']:.3f}",
            estimate_text(o["score"], 3, entry["seeds"]), f"{o['rmse_worst']['value']:.2f}",
            f"{100 * o['means']['success']:.1f} %", rates[rank - 1],
            chance, entry["verdict"], training_cost(entry["agent"], track),
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    names = [escaped(entry["agent"]) for entry in agents]
    lines += ["", "| set | " + " | ".join(names) + " |", "|--|" + "--:|" * len(names)]
    for name in board["sets"]:
        values = [entry["rmse"][name]["value"] for entry in agents]
        cells = [f"**{v:.3f}**" if v == min(values) else f"{v:.3f}" for v in values]
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    lines += ["", f"{board['conditions']}. * fewer than five seeds."]
    return "\n".join(lines)


def short_table(full: str) -> str:
    """The columns SHORT and the verdict of the first table in `full`, which `table` has made."""
    overall, _, _ = full.partition("\n\n")
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in overall.split("\n")]
    names = [cell.strip() for cell in rows[0]]
    kept = [i for i, name in enumerate(names) if name in SHORT or name.startswith("than ")]
    return "\n".join("|" + "|".join(row[i] for i in kept) + "|" for row in rows)


def scores(results: dict[str, Any]) -> dict[str, Any]:
    """IQM of the RMSE on each set, of every seed of every agent and of every controller.

    {"episodes": count, "seeds": {agent: {seed: {set: {iqm, low, high}}}},
    "controllers": {name: {set: {iqm, low, high}}}}.
    """
    rmse: dict[tuple[str, str], list[float]] = defaultdict(list)
    for record in results["episodes"]:
        rmse[record["policy"], record["set"]].append(record["tracking_rmse"])
    seeds: dict[str, Any] = {}
    controllers: dict[str, Any] = {}
    for (policy, name), values in rmse.items():
        agent, _, seed = policy.partition("@")
        estimate = stats.estimate([np.array(values)])
        if seed:
            place = seeds.setdefault(agent, {}).setdefault(seed, {})
        else:
            place = controllers.setdefault(agent, {})
        place[name] = {
            "iqm": round(estimate.value, 5),
            "low": round(estimate.low, 5),
            "high": round(estimate.high, 5),
        }
    count = min((len(values) for values in rmse.values()), default=0)
    return {"episodes": count, "seeds": seeds, "controllers": controllers}


def main() -> int:
    """Write the tables and the scores; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("results", type=Path, help="folder that evaluate.py has written")
    folder = parser.parse_args().results
    if not (folder / "leaderboard.json").is_file():
        print(f"{folder}: no leaderboard.json. Is it a folder of evaluate.py?", file=sys.stderr)
        return 2
    board = json.loads((folder / "leaderboard.json").read_text(encoding="utf-8"))
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    track, full = track_of(board), table(board)
    try:
        replace_block(ROOT / "docs" / "results.md", f"leaderboard of {track}", full)
        replace_block(ROOT / "README.md", f"short leaderboard of {track}", short_table(full))
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    target = PRETRAINED / track / "scores.json"
    target.parent.mkdir(exist_ok=True)
    target.write_text(json.dumps(scores(results), indent=1) + "\n", encoding="utf-8")
    print(f"docs/results.md, README.md and {target} written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
