"""Publish a leaderboard: from the results of evaluate.py into the documentation.

    python evaluate.py                                    # all controllers and shipped agents
    python benchmarks/publish.py results/torque-v3-seed0-*   # tables and scores.json

Likewise with `--env tracked_env/Speed-v0` and results/speed-v3-*, and with
`--env tracked_env/Terrain-v0` and results/terrain-v3-*. docs/results.md gets the whole
table between the two markers of that environment, and README.md the columns SHORT of its first
SHORT_ROWS policies. Of another version of the sets (`--sets-version`) docs/results.md alone gets
the table, between the markers of that version.
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
from tracked_env.benchmark.evaluation_sets import NEWEST, VERSIONS
from tracked_env.benchmark.files import replace_block
from tracked_env.benchmark.leaderboard import between
from tracked_env.benchmark.report import rate_unit
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.summary import action_rate
from tracked_env.benchmark.text_tables import escaped
from tracked_env.benchmark.training_curves import TrainingCost

ROOT = Path(__file__).resolve().parent.parent
PRETRAINED = ROOT / "baselines" / "learned" / "pretrained"
SHORT = (
    "", "policy", "seeds", "error", "after 5 s", "RMSE, all sets [m]", "after 5 s [m]", "success",
)  # fmt: skip # and the verdict
SHORT_ROWS = 8  # policies


def track_of(board: dict[str, Any]) -> str:
    """Environment of a leaderboard, as the folder of its agents is called."""
    return SETS[next(name for name in board["sets"] if name in SETS)].env.partition("/")[2]


def estimate_text(estimate: dict[str, float], digits: int, seeds: int) -> str:
    """Value and interval, as the leaderboard writes them."""
    return between(Estimate(**estimate), digits, seeds)


def table(board: dict[str, Any]) -> str:
    """The leaderboard as Markdown: overall, then the IQM of the RMSE per set."""
    agents = board["agents"]
    means = [
        {name: np.nan if value is None else value for name, value in e["overall"]["means"].items()}
        for e in agents
    ]
    unit, factor = rate_unit(means)
    rates = [f"{factor * action_rate(of)[0]:.1f}" for of in means]
    than = escaped(board["reference"])
    lines = [
        f"| | policy | error | than {than} | after 5 s | after the start | success | worst set "
        f"| worst tenth [m] | action rate [{unit}] | energy [kJ] | seeds "
        "| RMSE, all sets [m] | after 5 s [m] | score | P(better) | training of a seed, CPU |",
        "|--:|--|--:|--|--:|--|--:|--|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for rank, entry in enumerate(agents, start=1):
        o, own, count = entry["overall"], entry["relative"], entry["seeds"]
        star = "" if count in (None, 0) or count >= 5 else "*"
        against, training = entry["against"], entry["training"]
        chance = "-" if against is None else f"{against['improvement']['value']:.0%}"
        cells = [
            f"{rank}", escaped(entry["agent"]),
            estimate_text(own["whole"], 2, count), entry["verdict"],
            estimate_text(own["settled"], 2, count), entry["verdict_settled"],
            f"{100 * o['means']['success']:.1f} %",
            "-" if against is None else f"{own['worst']:.3g} `{own['worst_set']}`",
            f"{o['rmse_worst']['value']:.2f}", rates[rank - 1],
            f"{means[rank - 1]['energy'] / 1e3:.3g}", f"{count or '-'}{star}",
            estimate_text(o["rmse_iqm"], 3, count), f"{o['settled_iqm']['value']:.3f}",
            "-" if o["score"] is None else estimate_text(o["score"], 3, count),
            chance, "-" if training is None else str(TrainingCost(**training)),
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    names = [escaped(entry["agent"]) for entry in agents]
    lines += ["", "| set | " + " | ".join(names) + " |", "|--|" + "--:|" * len(names)]
    for name in board["sets"]:
        values = [entry["rmse"][name]["value"] for entry in agents]
        cells = [f"**{v:.3f}**" if v == min(values) else f"{v:.3f}" for v in values]
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    agreement = ", ".join(f"{k} {v:.2f}" for k, v in board["agreement"].items() if v is not None)
    lines += [
        "",
        f"Error: geometric mean over the sets of the IQM of the RMSE over that of {than}.",
        f"Kendall's tau of the order with that by {agreement}.",
        f"{board['conditions']}. * fewer than five seeds.",
    ]
    return "\n".join(lines)


def short_table(full: str) -> str:
    """The columns SHORT and the verdict of the first SHORT_ROWS policies of the first table in
    `full`, which `table` has made."""
    overall, _, _ = full.partition("\n\n")
    lines = overall.split("\n")[: 2 + SHORT_ROWS]  # two of head
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines]
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
    version = VERSIONS.get(results.get("benchmark", {}).get("version"))
    if version is not None and version not in NEWEST:
        return _publish_aside(version.name, full)
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


def _publish_aside(version: str, full: str) -> int:
    """Write the table of a version that is not the default one; returns the exit status."""
    try:
        replace_block(ROOT / "docs" / "results.md", f"leaderboard of {version}", full)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    print("docs/results.md written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
