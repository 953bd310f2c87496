"""The leaderboard: every agent by its score over all sets, and its result in each set.

The score over all sets comes from the pooled episodes; agents without one (nominal or oracle are
missing, or their difference is not certain) are ordered by the IQM of their RMSE. Every agent is
also compared with the adaptive baseline on the same episodes: the probability that it is better in
an episode, and the difference of the IQMs. `better` and `worse` mean that the interval of that
difference excludes 0. Where the mean, which is decided by lost vehicles, gives the opposite result,
the verdict adds it. An agent with one seed has no interval and no verdict: chance cannot be
separated from quality.

Written as terminal table, Markdown, JSON and one HTML page (see `leaderboard_page`).
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tracked_env.benchmark.changes import RECOVERED
from tracked_env.benchmark.reliability import FEW_SEEDS, estimate, fewest
from tracked_env.benchmark.report import (
    GOAL_COLUMNS,
    GOAL_LEGEND,
    goal_cells,
    marked,
    plain,
)
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import write_atomically
from tracked_env.benchmark.summary import Comparison, PolicySummary, Row, Summary, action_rate
from tracked_env.benchmark.text_tables import aligned, escaped_lines, markdown_rows

# What agents have to beat, by torque and by speed; the summary's baseline where both are missing.
REFERENCES = ("adaptive", "slc-adaptive")


COSTS = (
    "Means over all sets, seeds and episodes. Peak: largest distance after an abrupt change. "
    "Effort: mean square of the\ndemand over its limit. Saturated: part of the time at the limit. "
    "Predict: per vehicle and step, in the batch that was run;\n~ with other processes at the "
    "same time, not comparable."
)


class Place(NamedTuple):
    """One agent of the leaderboard."""

    agent: str
    seeds: int  # trainings, 0 for a policy that is not trained
    overall: PolicySummary  # over all sets
    balanced: Estimate | None  # mean of the scores of the sets that have one
    scores: dict[str, Estimate | None]  # by set
    rmse: dict[str, Estimate]  # [m] IQM by set
    against: Comparison | None  # the reference is its baseline; None for the reference itself


class Leaderboard(NamedTuple):
    """Agents, the best first."""

    places: list[Place]
    sets: list[str]
    reference: str
    conditions: str  # what was run, in a sentence


def leaderboard(summary: Summary, rows: Mapping[str, Row], conditions: str = "") -> Leaderboard:
    """From the summary and the rows that it was made of."""
    names = list(summary.policies)
    last = names[-1]  # all sets, or the only one
    sets = names[:-1] if len(names) > 1 else names
    agents = summary.policies[last]
    reference = next((name for name in REFERENCES if name in agents), summary.baseline)
    places = [
        Place(
            agent,
            overall.seeds,
            overall,
            _balanced(agent, {name: summary.policies[name][agent].score for name in sets}, rows),
            {name: summary.policies[name][agent].score for name in sets},
            {name: summary.policies[name][agent].rmse_iqm for name in sets},
            None if agent == reference else rows[last].compare(reference, agent),
        )
        for agent, overall in agents.items()
    ]

    def order(place: Place) -> tuple[bool, float]:
        score = place.overall.score
        return score is None, place.overall.rmse_iqm.value if score is None else -score.value

    return Leaderboard(sorted(places, key=order), sets, reference, conditions)


def _balanced(
    agent: str, scores: Mapping[str, Estimate | None], rows: Mapping[str, Row]
) -> Estimate | None:
    """Every set counts the same, whatever the size of its errors; None without any score."""
    known = {name: score for name, score in scores.items() if score is not None}
    if not known:
        return None
    drawn = np.mean([rows[name].scores(agent) for name in known], axis=0)
    value = float(np.mean([score.value for score in known.values()]))
    row = next(iter(rows.values()))
    own = (row.redrawn[key] for key in (agent, *(row.anchors() or ())))
    return estimate(value, drawn, fewest(*own))


def between(e: Estimate, digits: int, seeds: int) -> str:
    """Value and interval; the value alone of an agent with one seed."""
    value = f"{e.value:.{digits}f}"
    return value if seeds == 1 else f"{value} [{e.low:.{digits}f}, {e.high:.{digits}f}]"


def _said(e: Estimate) -> str:
    return "better" if e.low > 0.0 else "worse" if e.high < 0.0 else "not certain"


def verdict(place: Place) -> str:
    """The verdict of the differences to the reference, in a word."""
    if place.against is None:
        return "reference"
    if place.seeds == 1:
        return "one seed"
    said, mean = _said(place.against.gain), _said(place.against.difference)
    return f"{said}, mean {mean}" if {said, mean} == {"better", "worse"} else said


def table(board: Leaderboard) -> list[list[str]]:
    """Rows of cells, the header first: one row per agent."""
    cells = [
        ["", "agent", "seeds", "score", "of the sets", "RMSE [m]: IQM [95 %]", "after 5 s",
         "worst", "success", "recovery", "P(better)", f"than {board.reference}"],
    ]  # fmt: skip
    for rank, place in enumerate(board.places, start=1):
        o, against = place.overall, place.against
        means = o.means
        cells.append(
            [f"{rank}", marked(place.agent, place.seeds), f"{place.seeds or '-'}",
             "-" if o.score is None else between(o.score, 3, place.seeds),
             "-" if place.balanced is None else f"{place.balanced.value:.2f}",
             between(o.rmse_iqm, 3, place.seeds), f"{o.settled_iqm.value:.3f}",
             f"{o.rmse_worst.value:.2f}", f"{means['success']:.1%}",
             f"{means['recovery_time']:.1f}" if o.changed else "-",
             "-" if against is None else f"{against.improvement.value:.0%}", verdict(place)]
        )  # fmt: skip
    return cells


def set_table(board: Leaderboard) -> list[list[str]]:
    """Rows of cells, the header first: score and, in brackets, IQM of each agent on each set."""
    cells = [["set", *(place.agent for place in board.places)]]
    for name in board.sets:
        row = [name]
        for place in board.places:
            score = place.scores[name]
            row.append(
                f"{'-' if score is None else f'{score.value:.2f}'} ({place.rmse[name].value:.3f})"
            )
        cells.append(row)
    return cells


def cost_table(board: Leaderboard) -> list[list[str]]:
    """Rows of cells, the header first: cost metrics and those about changes, over all sets."""
    unit = action_rate(board.places[0].overall.means)[1]
    cells = [
        ["agent", "success", "ended early", "recovery [s]", "peak [m]", "energy [kJ]", "effort",
         "saturated", f"action rate [{unit}]", "predict [us]"],
    ]  # fmt: skip
    for place in board.places:
        o, m = place.overall, place.overall.means
        change = [f"{m['recovery_time']:.1f}", f"{m['peak_after_change']:.2f}"]
        cells.append(
            [place.agent, f"{m['success']:.1%}", f"{m['terminated']:.1%}",
             *(change if o.changed else ["-", "-"]), f"{m['energy'] / 1e3:.4g}",
             f"{m['effort']:.4f}", f"{m['saturation_share']:.1%}", f"{action_rate(m)[0]:.4g}",
             f"{'' if o.timed_alone else '~'}{o.predict_time * 1e6:.1f}"]
        )  # fmt: skip
    return cells


def goal_table(board: Leaderboard) -> list[list[str]]:
    """Rows of cells, the header first: goals, over all sets that have any; no row without."""
    cells = [["agent", *GOAL_COLUMNS]]
    for place in board.places:
        if not math.isnan(place.overall.means["goal_reached"]):
            cells.append([place.agent, *goal_cells(place.overall.means)])
    return cells


def explanation(board: Leaderboard) -> str:
    """Meaning of the columns."""
    few = any(0 < place.seeds <= FEW_SEEDS for place in board.places)
    than = board.reference
    return (
        "Score: part of the gap between nominal (0) and oracle (1) that is closed, by the IQM of "
        "the RMSE over all\nsets; the worst and the best quarter of the episodes are not in it. "
        "Of the sets: mean of their scores, each set\ncounts the same. Intervals: 95 %, seeds and "
        "episodes redrawn. After 5 s: IQM of the RMSE [m] without\nthe start, which lies off the "
        "path. Worst: RMSE [m] of the worst tenth of the episodes. Recovery: time [s] after an\n"
        f"abrupt change until the distance stays below {RECOVERED:g} contact lengths. P(better): "
        f"probability that the agent has\nthe smaller RMSE than {than} in an episode; than {than}: "
        "whether the interval of the difference of the IQMs says so."
        + (f"\n* fewer than {FEW_SEEDS + 1} training seeds" if few else "")
    )


def terminal(board: Leaderboard) -> str:
    """The leaderboard as plain text."""
    parts = [f"{aligned(table(board))}\n\n{explanation(board)}"]
    parts.append(
        f"{aligned(set_table(board), 1)}\n\nScore, and in brackets the IQM of the RMSE [m]"
    )
    parts.append(f"{aligned(cost_table(board), 1)}\n\n{COSTS}")
    if len(goals := goal_table(board)) > 1:
        parts.append(f"{aligned(goals, 1)}\n\n{GOAL_LEGEND}")
    return "\n\n".join([*parts, board.conditions]).rstrip()


def markdown(board: Leaderboard) -> str:
    """The leaderboard as Markdown."""
    goals = goal_table(board)
    parts = [
        markdown_rows(table(board)),
        escaped_lines(explanation(board)).replace("\n*", "\n\n\\*"),
        markdown_rows(set_table(board), 1),
        "Score, and in brackets the IQM of the RMSE [m].",
        markdown_rows(cost_table(board), 1),
        COSTS,
        *((markdown_rows(goals, 1), escaped_lines(GOAL_LEGEND)) if len(goals) > 1 else ()),
        escaped_lines(board.conditions),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def document(board: Leaderboard) -> dict[str, Any]:
    """The leaderboard for JSON."""
    return {
        "conditions": board.conditions,
        "reference": board.reference,
        "sets": board.sets,
        "agents": [{**plain(place), "verdict": verdict(place)} for place in board.places],
    }


def read_curves(
    folders: Mapping[str, Sequence[Path]],
) -> dict[str, list[list[tuple[float, float]]]]:
    """Learning curves [(steps, RMSE on held-out episodes [m]), ...], one per seed, by agent.

    folders: those of an agent's archives. A curve.csv with the columns `steps` and
    `held_out_rmse` is read; agents without one are left out.
    """
    import csv

    found: dict[str, list[list[tuple[float, float]]]] = {}
    for agent, places in folders.items():
        for folder in places:
            path = folder / "curve.csv"
            if not path.is_file():
                continue
            with path.open(encoding="utf-8", newline="") as file:
                rows = list(csv.DictReader(file))
            try:
                pairs = [(float(row["steps"]), float(row["held_out_rmse"])) for row in rows]
            except (KeyError, TypeError, ValueError):
                continue  # a curve of another kind
            known = [(steps, rmse) for steps, rmse in pairs if rmse == rmse]
            if known:
                found.setdefault(agent, []).append(known)
    return found


def write(folder: Path, board: Leaderboard) -> list[Path]:
    """Write leaderboard.json and leaderboard.md into `folder`; returns the files."""
    texts = {
        "leaderboard.json": json.dumps(document(board), indent=1) + "\n",
        "leaderboard.md": markdown(board),
    }
    for name, text in texts.items():
        write_atomically(folder / name, text.encode())
    return [folder / name for name in texts]
