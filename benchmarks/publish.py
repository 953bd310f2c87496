"""Publish a leaderboard: from the results of evaluate.py into the documentation.

    python evaluate.py                                    # all controllers and shipped agents
    python benchmarks/publish.py results/torque-v4-seed0-*   # tables and scores.json

Likewise with `--env tracked_env/Speed-v0` and `Terrain-v0`. docs/results.md gets the whole table
between the two markers of that environment, and README.md the columns SHORT of its first SHORT_ROWS
policies. Of another version of the sets (`--sets-version`) docs/results.md alone gets the table,
between the markers of that version, on that id where it has several.
`baselines/learned/pretrained/ENV/scores.json` gets the interquartile mean of the RMSE per seed or
controller and set with a 95 % bootstrap interval over the episodes; tests run some of them again.
"""

import argparse
import json
import re
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tracked_env.benchmark import SETS
from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.evaluation_sets import NEWEST, VERSIONS
from tracked_env.benchmark.files import replace_block
from tracked_env.benchmark.leaderboard import TrainingCost
from tracked_env.benchmark.report import action_rate, rate_unit, set_cell
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.table_model import between, escaped

ROOT = Path(__file__).resolve().parent.parent
PRETRAINED = ROOT / "baselines" / "learned" / "pretrained"
# Columns of the short table, beside the verdict.
SHORT = (
    "",
    "policy",
    "error",
    "mean",
    "90 % quantile",
    "failures",
    "after 5 s",
    "RMSE, all sets [m]",
)
SHORT_ROWS = 8  # policies


def estimate_text(estimate: dict[str, float] | None, digits: int, seeds: int) -> str:
    """Value and interval, as the leaderboard writes them; `-` for none."""
    return "-" if estimate is None else between(Estimate(**estimate), digits, seeds)


def means_of(entry: dict[str, Any]) -> dict[str, float]:
    """Means of all metrics of an agent over all sets, NaN where it has none."""
    means = entry["overall"]["means"].items()
    return {name: np.nan if value is None else value for name, value in means}


def line(cells: list[str]) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join(cells) + " |"


def table(board: dict[str, Any]) -> str:
    """The leaderboard as Markdown: overall, then the IQM of the RMSE and its ratio per set."""
    agents = board["agents"]
    unit, factor = rate_unit(means_of(entry) for entry in agents)
    than = escaped(board["reference"])

    def ratio(name: str) -> Callable[[dict[str, Any]], str]:
        return lambda entry: estimate_text(entry["relative"][name], 2, entry["seeds"])

    def worst_set(entry: dict[str, Any]) -> str:
        ratios = entry["relative"]
        return f"{ratios['worst']:.3g} `{ratios['worst_set']}`" if entry["against"] else "-"

    def chance(entry: dict[str, Any]) -> str:
        against = entry["against"]
        return f"{against['improvement']['value']:.0%}" if against else "-"

    def training(entry: dict[str, Any]) -> str:
        return str(TrainingCost(**entry["training"])) if entry["training"] else "-"

    columns: dict[str, Callable[[dict[str, Any]], str]] = {
        "policy": lambda e: escaped(e["agent"]),
        "error": ratio("whole"),
        f"than {than}": lambda e: e["verdict"],
        "mean": ratio("mean"),
        "90 % quantile": ratio("quantile"),
        "failures": lambda e: f"{100 * (1.0 - e['overall']['means']['success']):.1f} %",
        "sets redrawn": ratio("sets_drawn"),
        "after 5 s": ratio("settled"),
        "after the start": lambda e: e["verdict_settled"],
        "worst set": worst_set,
        f"action rate [{unit}]": lambda e: f"{factor * action_rate(means_of(e))[0]:.1f}",
        "energy [kJ]": lambda e: f"{means_of(e)['energy'] / 1e3:.3g}",
        "seeds": lambda e: f"{e['seeds'] or '-'}{'*' if 0 < (e['seeds'] or 0) < 5 else ''}",
        "RMSE, all sets [m]": lambda e: estimate_text(e["overall"]["rmse_iqm"], 3, e["seeds"]),
        "after 5 s [m]": lambda e: f"{e['overall']['settled_iqm']['value']:.3f}",
        "score": lambda e: estimate_text(e["overall"]["score"], 3, e["seeds"]),
        "P(better)": chance,
        "training of a seed, CPU": training,
    }
    words = ("policy", f"than {than}", "after the start", "worst set")
    rules = ("--" if name in words else "--:" for name in columns)
    lines = ["| | " + " | ".join(columns) + " |", "|--:|" + "|".join(rules) + "|"]
    for rank, entry in enumerate(agents, start=1):
        lines.append(line([f"{rank}", *(cell(entry) for cell in columns.values())]))
    lines += ["", line(["set", *(escaped(e["agent"]) for e in agents)])]
    lines.append("|--|" + "--:|" * len(agents))
    for name in board["sets"]:
        values = [Estimate(**entry["rmse"][name]) for entry in agents]
        ratios = [Estimate(**entry["relative"]["by_set"][name]) for entry in agents]
        seeds = [entry["seeds"] for entry in agents]
        cells = [set_cell(*of) for of in zip(values, ratios, seeds, strict=True)]
        best = values.index(min(values))
        cells[best] = f"**{cells[best]}**"
        lines.append(line([f"`{name}`", *cells]))
    agreement = ", ".join(f"{k} {v:.2f}" for k, v in board["agreement"].items() if v is not None)
    lines += [
        "",
        f"Error: geometric mean over the sets of the IQM of the RMSE over that of {than}; mean, "
        "90 % quantile: of these in its place. Sets redrawn: the error with the interval on sets "
        "like these; all others are on these sets. All verdicts together err in at most 5 %.",
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
    chosen = [i for i, name in enumerate(names) if name in SHORT or name.startswith("than ")]
    return "\n".join("|" + "|".join(row[i] for i in chosen) + "|" for row in rows)


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
        redrawn = stats.redraw(np.array([values]), stats.Redraws([len(values)]))
        iqm = float(stats.interquartile_mean(values))
        estimate = stats.estimate(iqm, redrawn.iqm, seeds=1)
        place = seeds.setdefault(agent, {}).setdefault(seed, {}) if seed else {}
        place = place if seed else controllers.setdefault(agent, {})
        place[name] = dict(zip(("iqm", "low", "high"), np.round(estimate, 5).tolist(), strict=True))
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
    first = next(name for name in board["sets"] if name in SETS)
    track, full = SETS[first].env.partition("/")[2], table(board)
    version = VERSIONS.get(results.get("benchmark", {}).get("version"))
    is_default = version is None or version in NEWEST
    name = track if version is None or is_default else version.name
    if version is not None and len(version.envs) > 1:
        name = f"{name} on {track}"
    try:
        replace_block(ROOT / "docs" / "results.md", f"leaderboard of {name}", full)
        if is_default:
            replace_block(ROOT / "README.md", f"short leaderboard of {track}", short_table(full))
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if not is_default:
        print("docs/results.md written")
        return 0
    target = PRETRAINED / track / "scores.json"
    target.parent.mkdir(exist_ok=True)
    target.write_text(json.dumps(scores(results), indent=1) + "\n", encoding="utf-8")
    print(f"docs/results.md, README.md and {target} written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
