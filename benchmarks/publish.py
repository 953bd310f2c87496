"""Publish a leaderboard: from the results of evaluate.py into the documentation.

    make leaderboard                                      # this, for the three ids
    python evaluate.py --all --output results/leaderboard   # all controllers and shipped agents
    python benchmarks/publish.py results/leaderboard/torque-v4-seed0-*

Likewise with `--env tracked_env/Speed-v0` and `Terrain-v0`. docs/boards.md gets the whole board
between the two markers of that environment, docs/results.md five columns of every policy and a
figure of error against action rate, README.md the first SHORT_ROWS of its rows but those of the
true motion. Of another version of the sets (`--sets-version`) docs/boards.md alone gets the board,
between the markers of that version, on that id where it has several.
With times of calls in the folder (`tracked-env timing --json FOLDER/timing.json`, before
evaluate.py) the tables have them. `baselines/learned/pretrained/ENV/scores.json` gets the
interquartile mean of the RMSE per seed or controller and set with a 95 % bootstrap interval over
the episodes; tests run some of them again.
"""

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tracked_env.benchmark import SETS, figures
from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.evaluation_sets import NEWEST, VERSIONS
from tracked_env.benchmark.files import replace_block
from tracked_env.benchmark.leaderboard import TrainingCost
from tracked_env.benchmark.report import action_rate, rate_unit, set_cell
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.table_model import between, escaped

ROOT = Path(__file__).resolve().parent.parent
PRETRAINED = ROOT / "baselines" / "learned" / "pretrained"
SHORT_ROWS = 8  # policies in the README
LOST = 0.5  # [-] failures from which on a policy is not drawn


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


def ratio(name: str) -> Callable[[dict[str, Any]], str]:
    """The cell of a relative error of an agent."""
    return lambda entry: estimate_text(entry["relative"][name], 2, entry["seeds"])


def table(board: dict[str, Any]) -> str:
    """The leaderboard as Markdown: overall, then the IQM of the RMSE and its ratio per set."""
    agents = board["agents"]
    unit, factor = rate_unit(means_of(entry) for entry in agents)
    than = escaped(board["reference"])

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


def short_table(board: dict[str, Any]) -> str:
    """Five columns of every policy: what it is worth, in whole episodes and after the start."""

    def call(entry: dict[str, Any]) -> str:
        return f"{entry['call']['median'] * 1e6:.0f}" if entry["call"] else "-"

    columns: dict[str, Callable[[dict[str, Any]], str]] = {
        "error": ratio("whole"),
        "after 5 s": ratio("settled"),
        "policy": lambda e: escaped(e["agent"]),
        "success": lambda e: f"{100 * means_of(e)['success']:.1f} %",
        "call [us]": call,
    }
    rules = ("--" if name == "policy" else "--:" for name in columns)
    lines = [line([*columns]), "|" + "|".join(rules) + "|"]
    return "\n".join(
        [*lines, *(line([cell(e) for cell in columns.values()]) for e in board["agents"])]
    )


def draw_rates(board: dict[str, Any], path: Path) -> None:
    """Error against action rate of all policies but those that fail in half of the episodes."""
    drawn = [e for e in board["agents"] if means_of(e)["success"] > LOST]
    unit, factor = rate_unit(means_of(entry) for entry in board["agents"])
    style = figures.looks([entry["agent"] for entry in drawn])
    with figures.picture(path, 4.4) as figure:
        axes = figure.subplots()
        for entry in drawn:
            error, rate = entry["relative"]["whole"], factor * action_rate(means_of(entry))[0]
            look = style[entry["agent"]]
            bar = [[error["value"] - error["low"]], [error["high"] - error["value"]]]
            axes.errorbar(
                rate, error["value"], bar, fmt=look.marker, color=look.colour, ms=6,
                label=entry["agent"],
            )  # fmt: skip
        axes.set(xscale="log", yscale="log", xlabel=f"action rate [{unit}]")
        axes.set_ylabel(f"error over that of {board['reference']}")
        for axis in (axes.xaxis, axes.yaxis):
            figures.plain_ticks(axis)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), title="by error")


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
    track = SETS[first].env.partition("/")[2]
    version = VERSIONS.get(results.get("benchmark", {}).get("version"))
    is_default = version is None or version in NEWEST
    name = track if version is None or is_default else version.name
    if version is not None and len(version.envs) > 1:
        name = f"{name} on {track}"
    short = short_table(board)
    blocks = {"docs/boards.md": (f"leaderboard of {name}", table(board))}
    if is_default:
        rows = [row for row in short.split("\n") if "-true-motion" not in row]
        first_rows = "\n".join(rows[: 2 + SHORT_ROWS])  # two of head
        blocks["docs/results.md"] = f"short leaderboard of {track}", short
        blocks["README.md"] = f"short leaderboard of {track}", first_rows
    try:
        for page, block in blocks.items():
            replace_block(ROOT / page, *block)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    print(*blocks, "written")
    if is_default:
        figure = ROOT / "docs" / "_static" / f"results-{track.lower()}.png"
        draw_rates(board, figure)
        target = PRETRAINED / track / "scores.json"
        target.parent.mkdir(exist_ok=True)
        target.write_text(json.dumps(scores(results), indent=1) + "\n", encoding="utf-8")
        print(figure, target, "written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
