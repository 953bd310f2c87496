"""The leaderboard: every agent by its error over that of the adaptive baseline, over all sets.

    relative error   geometric mean over sets of IQM of the RMSE / that of the reference, of whole
                     episodes and after the start; a factor in one set counts as much as the same
                     factor in another, whatever the size of their errors
    worst set        the largest of these ratios, of whole episodes, and where
    lost set         fewer than LOST of its episodes end with success, and not so the reference's
An episode that ends early counts the error limit for the time it lacks, so a set in which most
episodes are lost has a ratio of limit / IQM of the reference, about 100, and of twelve sets it
alone multiplies the mean by 100^(1/12) = 1.5. An agent that is good elsewhere can make up for that:
therefore an agent that loses a set is never called better, and the set is named. What is lost in up
to a quarter of a set's episodes is cut off by its IQM; it shows in worst tenth and success.

`better` and `worse` mean that the interval of the relative error, of redraws of all sets together,
excludes 1, of whole episodes and after the start; they need enough episodes and seeds
(`statistics.enough`), else it is `too few`. Where the mean of the paired differences, which is
decided by lost vehicles, says the opposite, the verdict adds it. Score (see `summary`), probability
of improvement and cost metrics stand beside it.

Is it the choice of the statistic that decides? Agents are ordered by OTHER ones as well, and the
agreement with the order of the leaderboard is Kendall's tau. Is it that some sets say the same, and
count twice? The same order is made of the most sets of which no two are alike (`statistics`).
"""

import csv
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark import table_model as tables
from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.report import (
    GOAL_COLUMNS,
    GOAL_LEGEND,
    TOO_FEW,
    Columns,
    action_rate,
    has_goal,
    marked,
    plain,
    rate_unit,
)
from tracked_env.benchmark.statistics import FEW_EPISODES, FEW_SEEDS, SMALLEST, Estimate
from tracked_env.benchmark.summary import Comparison, PolicySummary, Row, Summary
from tracked_env.benchmark.table_model import Table, between

# What agents have to beat, by torque and by speed; the summary's baseline where both are missing.
REFERENCES = ("adaptive", "slc-adaptive")
LOST = 0.5  # [-] share of the episodes with success below which a set is lost
MAX_DRAWN = 5  # agents in a figure; more cannot be told apart


class RelativeError(NamedTuple):
    """An agent against the reference over all sets; ratios of 1 are the reference's own."""

    whole: Estimate  # [-] geometric mean
    settled: Estimate  # [-] the same after the start
    worst_set: str
    worst: float  # [-] ratio there
    lost: tuple[str, ...]  # sets that the agent loses and the reference does not
    episodes: int  # of the smallest set, of one seed


class TrainingCost(NamedTuple):
    """Of one seed, the mean over those that are known."""

    steps: float  # of the environment
    cpu_seconds: float  # [s] of processor time

    def __str__(self) -> str:
        return f"{self.steps / 1e6:.2g} M steps, {self.cpu_seconds:.0f} s"


class Place(NamedTuple):
    """One agent of the leaderboard."""

    agent: str
    seeds: int  # trainings, 0 for a policy that is not trained
    overall: PolicySummary  # over all sets
    balanced: Estimate | None  # mean of the scores of the sets that have one
    scores: dict[str, Estimate | None]  # by set
    rmse: dict[str, Estimate]  # [m] IQM by set
    against: Comparison | None  # the reference is its baseline; None for the reference itself
    relative: RelativeError  # over the reference
    training: TrainingCost | None = None  # None of a controller, or where it is not known


class Leaderboard(NamedTuple):
    """Agents, the best first."""

    places: list[Place]
    sets: list[str]
    reference: str
    conditions: str  # what was run, in a sentence
    agreement: dict[str, float]  # Kendall's tau of this order with those by other statistics
    anchors: tuple[str, ...] = ()  # the policies that score 0 and 1 over all sets, if both are here


def _success(row: Row, agent: str) -> float:
    return float(row.matrix(agent, "success").mean())


def relative(sets: Mapping[str, Row], agent: str, reference: str) -> RelativeError:
    """The agent's errors over those of the reference; sets: a Row of each set."""
    rows = sets.values()
    ratios = {name: float(stats.ratio(r.iqm(agent), r.iqm(reference))) for name, r in sets.items()}
    worst = max(ratios, key=lambda name: ratios[name])
    lost = [n for n, r in sets.items() if _success(r, agent) < LOST <= _success(r, reference)]
    return RelativeError(
        stats.relative_error([(row.redrawn[agent], row.redrawn[reference]) for row in rows]),
        stats.relative_error([(row.settled[agent], row.settled[reference]) for row in rows]),
        worst,
        ratios[worst],
        tuple(lost),
        min(min(row.sizes) for row in rows),
    )


def _geometric(statistic: Callable[[Row, str], float]) -> Callable[[Sequence[Row], str], float]:
    """Mean over sets of the logarithm of a statistic: orders as the geometric mean does."""
    return lambda rows, agent: float(
        np.mean([math.log(max(statistic(row, agent), SMALLEST)) for row in rows])
    )


def _power(row: Row, agent: str) -> float:
    """Mean power [W] while driving, so that an episode that ends early saves nothing."""
    energy, time = (row.matrix(agent, name).sum() for name in ("energy", "driven_time"))
    return float(energy / max(time, SMALLEST))


# Other statistics that agents may be ordered by; smaller ones are better.
OTHER: dict[str, Callable[[Sequence[Row], str], float]] = {
    "mean": _geometric(lambda row, agent: float(row.redrawn[agent].values.mean())),
    "median": _geometric(lambda row, agent: float(np.median(row.redrawn[agent].values))),
    "worst tenth": _geometric(
        lambda row, agent: float(stats.worst_tenth(row.redrawn[agent].values.ravel()))
    ),
    "after 5 s": _geometric(
        lambda row, agent: float(stats.interquartile_mean(row.settled[agent].values.ravel()))
    ),
    "success": lambda rows, agent: -float(np.mean([_success(row, agent) for row in rows])),
    "IQM times power": _geometric(lambda row, agent: row.iqm(agent) * _power(row, agent)),
}


def agreement(sets: Mapping[str, Row], ranked: Mapping[str, float]) -> dict[str, float]:
    """Kendall's tau of the order of `ranked` {agent: value} and those by OTHER; NaN of one agent.

    sets: a Row of each set.
    """
    rows, values = list(sets.values()), list(ranked.values())
    taus = {
        name: stats.kendalls_tau(values, [by(rows, agent) for agent in ranked])
        for name, by in OTHER.items()
    }
    places = stats.unlike(stats.correlations([{n: row.iqm(n) for n in ranked} for row in rows]))
    by = _geometric(lambda row, agent: row.iqm(agent))
    fewer = [by([rows[i] for i in places], agent) for agent in ranked]
    return taus | {f"{len(places)} unlike sets": stats.kendalls_tau(values, fewer)}


def leaderboard(
    summary: Summary,
    rows: Mapping[str, Row],
    conditions: str = "",
    training: Mapping[str, TrainingCost] | None = None,
) -> Leaderboard:
    """From the summary and the rows that it was made of; training: what each agent's cost."""
    names = list(summary.policies)
    last = names[-1]  # all sets, or the only one
    sets = names[:-1] or names
    of_sets = {name: rows[name] for name in sets}
    agents = summary.policies[last]
    reference = next((name for name in REFERENCES if name in agents), summary.baseline)
    places = []
    for agent, overall in agents.items():
        by_set = {name: summary.policies[name][agent] for name in sets}
        scores = {name: of.score for name, of in by_set.items()}
        places.append(
            Place(
                agent,
                overall.seeds,
                overall,
                _balanced(agent, scores, rows),
                scores,
                {name: of.rmse_iqm for name, of in by_set.items()},
                None if agent == reference else rows[last].compare(reference, agent),
                relative(of_sets, agent, reference),
                (training or {}).get(agent),
            )
        )
    places.sort(key=lambda place: place.relative.whole.value)
    ranked = {place.agent: place.relative.whole.value for place in places}
    anchors = rows[last].anchors() or ()
    return Leaderboard(places, sets, reference, conditions, agreement(of_sets, ranked), anchors)


def _balanced(
    agent: str, scores: Mapping[str, Estimate | None], rows: Mapping[str, Row]
) -> Estimate | None:
    """Every set counts the same, whatever the size of its errors; None without any score."""
    measured = {name: score for name, score in scores.items() if score is not None}
    if not measured:
        return None
    drawn = np.mean([rows[name].scores(agent) for name in measured], axis=0)
    value = float(np.mean([score.value for score in measured.values()]))
    row = next(iter(rows.values()))
    involved = (row.redrawn[key] for key in (agent, *(row.anchors() or ())))
    return stats.estimate(value, drawn, stats.fewest(*involved))


def shown(board: Leaderboard) -> list[str]:
    """The agents that figures draw, at most MAX_DRAWN, in the order of the leaderboard.

    The reference, where the score is 0, the best that reads the truth, and the best of the others.
    """
    agents = [place.agent for place in board.places]
    first = list(dict.fromkeys([board.reference, *board.anchors, *agents]))[:MAX_DRAWN]
    return [name for name in agents if name in first]


def said(ratio: Estimate) -> str:
    """What the interval of a ratio of errors says of 1."""
    return "better" if ratio.high < 1.0 else "worse" if ratio.low > 1.0 else "not certain"


def verdict(place: Place, settled: bool = False) -> str:
    """The verdict of the errors over those of the reference, in a word; settled: after the start.

    Where a set is lost the word is `loses` and its name.
    """
    if place.against is None:
        return "reference"
    if not stats.enough(place.relative.episodes, place.seeds):
        return TOO_FEW
    if place.relative.lost:
        first, *others = place.relative.lost
        return f"loses {first}" + (f" and {len(others)}" if others else "")
    if settled:
        return said(place.relative.settled)
    word, difference = said(place.relative.whole), place.against.difference
    mean = "better" if difference.low > 0.0 else "worse" if difference.high < 0.0 else ""
    return f"{word}, mean {mean}" if {word, mean} == {"better", "worse"} else word


def main_table(board: Leaderboard) -> Table:
    """One row per agent, by what leads the leaderboard."""
    than = board.reference
    columns: Columns = {
        "place": lambda p: f"{1 + board.places.index(p)}",
        "agent": lambda p: marked(p.agent, p.seeds),
        "seeds": lambda p: f"{p.seeds or '-'}",
        f"error / {than}": lambda p: between(p.relative.whole, 2, p.seeds),
        "after 5 s": lambda p: between(p.relative.settled, 2, p.seeds),
        "worst set": lambda p: (
            "-" if p.against is None else f"{p.relative.worst:.3g} {p.relative.worst_set}"
        ),
        "worst [m]": lambda p: f"{p.overall.rmse_worst.value:.2f}",
        "success": lambda p: f"{p.overall.means['success']:.1%}",
        f"than {than}": verdict,
        "than it": lambda p: verdict(p, settled=True),
    }
    explanation = (
        f"Error / {than}: geometric mean over the sets of the IQM of the RMSE over that of {than}, "
        "of whole episodes and\nafter 5 s, without the start, which lies off the path. Intervals: "
        "95 %, seeds and episodes redrawn, in all sets together.\nWorst set: the largest of these "
        "ratios. Worst [m]: RMSE of the worst tenth of the episodes. A lost episode counts with "
        f"its\nerror at the limit. Than {than}: whether the interval excludes 1; 'loses' a set: "
        f"under half of its episodes succeed,\nand not so for {than}; no verdict ({TOO_FEW}) below "
        f"{FEW_EPISODES + 1} episodes of a set and {FEW_SEEDS + 1} seeds."
    )
    if any(0 < place.seeds <= FEW_SEEDS for place in board.places):
        explanation += f"\n* fewer than {FEW_SEEDS + 1} training seeds"
    taus = ", ".join(f"{name} {tau:.2f}" for name, tau in board.agreement.items() if tau == tau)
    notes = [explanation]
    if taus:
        notes.append(f"Kendall's tau of this order and that by another statistic:\n{taus}.")
    rows = tables.rows_of(columns, board.places)
    rows[0][0], rows[0][-1] = "", "after 5 s"  # of two columns
    return Table(f"Agents by their error over that of {than}", rows, 2, notes, (1, 8))


def score_table(board: Leaderboard) -> Table:
    """The score, and the errors over all sets in metres."""
    columns: Columns = {
        "agent": lambda p: p.agent,
        "score": lambda p: "-" if p.overall.score is None else between(p.overall.score, 3, p.seeds),
        "of the sets": lambda p: "-" if p.balanced is None else f"{p.balanced.value:.2f}",
        "RMSE [m]: IQM [95 %]": lambda p: between(p.overall.rmse_iqm, 3, p.seeds),
        "after 5 s": lambda p: f"{p.overall.settled_iqm.value:.3f}",
        "P(better)": lambda p: "-" if p.against is None else f"{p.against.improvement.value:.0%}",
    }
    note = (
        "Score: part of the gap between integral (0; without it nominal or uc) and the ceiling "
        "(1), the best policy that knows\nthe truth, by the IQM of the RMSE over all sets. Of the "
        "sets: mean of their scores, each with its own ceiling.\nP(better): probability that the "
        "agent has the smaller RMSE than the reference in an episode."
    )
    return Table("Score and errors in metres", tables.rows_of(columns, board.places), 1, [note])


def set_table(board: Leaderboard) -> Table:
    """Score and, in brackets, IQM of each agent on each set."""

    def cell(place: Place, name: str) -> str:
        score = place.scores[name]
        return f"{'-' if score is None else f'{score.value:.2f}'} ({place.rmse[name].value:.3f})"

    head = ["set", *(place.agent for place in board.places)]
    rows = [[name, *(cell(place, name) for place in board.places)] for name in board.sets]
    return Table("Sets", [head, *rows], 1, ["Score, and in brackets the IQM of the RMSE [m]"])


def cost_table(board: Leaderboard) -> Table:
    """Cost metrics and those about changes, over all sets."""
    unit, factor = rate_unit(place.overall.means for place in board.places)
    columns: Columns = {
        "agent": lambda p: p.agent,
        "success": lambda p: f"{p.overall.means['success']:.1%}",
        "ended early": lambda p: f"{p.overall.means['terminated']:.1%}",
        "recovery [s]": lambda p: (
            f"{p.overall.means['recovery_time']:.1f}" if p.overall.changed else "-"
        ),
        "peak [m]": lambda p: (
            f"{p.overall.means['peak_after_change']:.2f}" if p.overall.changed else "-"
        ),
        "energy [kJ]": lambda p: f"{p.overall.means['energy'] / 1e3:.4g}",
        "effort": lambda p: f"{p.overall.means['effort']:.4f}",
        "saturated": lambda p: f"{p.overall.means['saturation_share']:.1%}",
        f"action rate [{unit}]": lambda p: f"{factor * action_rate(p.overall.means)[0]:.4g}",
        "predict [us]": lambda p: (
            f"{'' if p.overall.timed_alone else '~'}{p.overall.predict_time * 1e6:.1f}"
        ),
        "training": lambda p: "-" if p.training is None else str(p.training),
    }
    note = (
        "Means over all sets, seeds and episodes. Peak: largest distance after an abrupt change. "
        "Effort: mean square of the\ndemand over its limit. Saturated: part of the time at the "
        "limit. Predict: per vehicle and step, in the batch that was run;\n~ with other processes "
        "at the same time, not comparable."
    )
    return Table("Cost metrics", tables.rows_of(columns, board.places), 1, [note])


def goal_table(board: Leaderboard) -> Table:
    """Goals, over all sets that have any; no row without."""
    rows = [["agent", *GOAL_COLUMNS]]
    for place in board.places:
        means = place.overall.means
        if has_goal(means):
            rows.append([place.agent, *(cell(means) for cell in GOAL_COLUMNS.values())])
    return Table("Goals", rows, 1, [GOAL_LEGEND])


def tables_of(board: Leaderboard) -> list[Table]:
    """The tables of the leaderboard that are not empty, the conditions below the last."""
    parts = [part(board) for part in (main_table, score_table, set_table, cost_table, goal_table)]
    parts = [part for part in parts if len(part.rows) > 1]
    if board.conditions:
        parts[-1] = parts[-1]._replace(notes=[*parts[-1].notes, board.conditions])
    return parts


def terminal(board: Leaderboard, width: int = 80) -> str:
    """The leaderboard as plain text of at most `width` columns; wider tables are folded."""
    return tables.terminal(tables_of(board), width)


def document(board: Leaderboard) -> dict[str, Any]:
    """The leaderboard for JSON."""
    verdicts = [
        {"verdict": verdict(place), "verdict_settled": verdict(place, settled=True)}
        for place in board.places
    ]
    agents = [{**plain(p), **words} for p, words in zip(board.places, verdicts, strict=True)]
    return {
        "conditions": board.conditions,
        "reference": board.reference,
        "sets": board.sets,
        "agreement": plain(board.agreement),
        "agents": agents,
    }


def write(folder: Path, board: Leaderboard) -> list[Path]:
    """Write leaderboard.json and leaderboard.md into `folder`; returns the files."""
    texts = {
        "leaderboard.json": json.dumps(document(board), indent=1) + "\n",
        "leaderboard.md": tables.markdown(tables_of(board)),
    }
    for name, text in texts.items():
        write_atomically(folder / name, text.encode())
    return [folder / name for name in texts]


def _curve(folder: Path, columns: Sequence[str]) -> list[tuple[float, ...]]:
    """These columns of curve.csv, which a training leaves in its folder; none where one lacks."""
    path = folder / "curve.csv"
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        try:
            return [tuple(float(row[name]) for name in columns) for row in csv.DictReader(file)]
        except (KeyError, TypeError, ValueError):
            return []  # a curve of another kind


def read_curves(folders: Mapping[str, Sequence[Path]]) -> dict[str, list[list[tuple[float, ...]]]]:
    """Learning curves [(steps, RMSE on held-out episodes [m]), ...], one per seed, by agent.

    folders: those of an agent's archives. Agents without a curve are left out.
    """
    curves: dict[str, list[list[tuple[float, ...]]]] = {}
    for agent, places in folders.items():
        for folder in places:
            rows = [row for row in _curve(folder, ("steps", "held_out_rmse")) if row[1] == row[1]]
            if rows:
                curves.setdefault(agent, []).append(rows)
    return curves


def read_costs(folders: Mapping[str, Sequence[Path]]) -> dict[str, TrainingCost]:
    """Cost of training a seed, by agent; folders as `read_curves`."""
    costs = {}
    for agent, places in folders.items():
        curves = (_curve(folder, ("steps", "cpu_seconds")) for folder in places)
        ends = [curve[-1] for curve in curves if curve]
        if ends:
            costs[agent] = TrainingCost(*np.mean(ends, axis=0).tolist())
    return costs
