"""The leaderboard: every agent by its error over that of the adaptive baseline.

The order is that of `relative_errors`: the geometric mean over sets of the ratio of the IQMs, with
the interval of redraws of all sets together. `better` and `worse` mean that this interval excludes
1, of whole episodes and after the start; they need enough episodes and seeds
(`reliability.enough`), else it is `too few`. An agent that loses a set is never better, the set is
named; and where the mean of the paired differences, which is decided by lost vehicles, says the
opposite, the verdict adds it.
Score (see `summary`), probability of improvement and cost metrics stand beside it.

Written as terminal table, Markdown, JSON and one HTML page (see `leaderboard_page`).
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tracked_env.benchmark.figures import MAX_DRAWN
from tracked_env.benchmark.relative_errors import RelativeError, agreement, relative
from tracked_env.benchmark.reliability import FEW_EPISODES, FEW_SEEDS, enough, estimate, fewest
from tracked_env.benchmark.report import (
    GOAL_COLUMNS,
    GOAL_LEGEND,
    TOO_FEW,
    goal_cells,
    marked,
    plain,
    rate_unit,
)
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import write_atomically
from tracked_env.benchmark.summary import (
    Comparison,
    PolicySummary,
    Row,
    Summary,
    action_rate,
)
from tracked_env.benchmark.text_tables import aligned, escaped_lines, folded, markdown_rows
from tracked_env.benchmark.training_curves import TrainingCost

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


def leaderboard(
    summary: Summary,
    rows: Mapping[str, Row],
    conditions: str = "",
    training: Mapping[str, TrainingCost] | None = None,
) -> Leaderboard:
    """From the summary and the rows that it was made of; training: what each agent's cost."""
    names = list(summary.policies)
    last = names[-1]  # all sets, or the only one
    sets = names[:-1] if len(names) > 1 else names
    of_sets = {name: rows[name] for name in sets}
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
            relative(of_sets, agent, reference),
            (training or {}).get(agent),
        )
        for agent, overall in agents.items()
    ]
    places.sort(key=lambda place: place.relative.whole.value)
    ranked = {place.agent: place.relative.whole.value for place in places}
    return Leaderboard(
        places, sets, reference, conditions, agreement(of_sets, ranked), rows[last].anchors() or ()
    )


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


def shown(board: Leaderboard) -> list[str]:
    """The agents that figures draw, at most MAX_DRAWN, in the order of the leaderboard.

    The reference, where the score is 0, the best that reads the truth, and the best of the others.
    """
    agents = [place.agent for place in board.places]
    first = list(dict.fromkeys([board.reference, *board.anchors, *agents]))[:MAX_DRAWN]
    return [name for name in agents if name in first]


def between(e: Estimate, digits: int, seeds: int) -> str:
    """Value and interval; the value alone of an agent with one seed."""
    value = f"{e.value:.{digits}f}"
    return value if seeds == 1 else f"{value} [{e.low:.{digits}f}, {e.high:.{digits}f}]"


def said(ratio: Estimate) -> str:
    """What the interval of a ratio of errors says of 1."""
    return "better" if ratio.high < 1.0 else "worse" if ratio.low > 1.0 else "not certain"


def _of_mean(difference: Estimate) -> str:
    return "better" if difference.low > 0.0 else "worse" if difference.high < 0.0 else ""


def verdict(place: Place, settled: bool = False) -> str:
    """The verdict of the errors over those of the reference, in a word; settled: after the start.

    Where a set is lost the word is `loses` and its name.
    """
    if place.against is None:
        return "reference"
    if not enough(place.relative.episodes, place.seeds):
        return TOO_FEW
    if place.relative.lost:
        first, *others = place.relative.lost
        return f"loses {first}" + (f" and {len(others)}" if others else "")
    if settled:
        return said(place.relative.settled)
    word, mean = said(place.relative.whole), _of_mean(place.against.difference)
    return f"{word}, mean {mean}" if {word, mean} == {"better", "worse"} else word


def table(board: Leaderboard) -> list[list[str]]:
    """Rows of cells, the header first: one row per agent, by what leads the leaderboard."""
    cells = [
        ["", "agent", "seeds", f"error / {board.reference}", "after 5 s", "worst set",
         "worst [m]", "success", f"than {board.reference}", "after 5 s"],
    ]  # fmt: skip
    for rank, place in enumerate(board.places, start=1):
        o, own = place.overall, place.relative
        cells.append(
            [f"{rank}", marked(place.agent, place.seeds), f"{place.seeds or '-'}",
             between(own.whole, 2, place.seeds), between(own.settled, 2, place.seeds),
             "-" if place.against is None else f"{own.worst:.3g} {own.worst_set}",
             f"{o.rmse_worst.value:.2f}",
             f"{o.means['success']:.1%}", verdict(place), verdict(place, settled=True)]
        )  # fmt: skip
    return cells


def score_table(board: Leaderboard) -> list[list[str]]:
    """Rows of cells, the header first: the score, and the errors over all sets in metres."""
    cells = [["agent", "score", "of the sets", "RMSE [m]: IQM [95 %]", "after 5 s", "P(better)"]]
    for place in board.places:
        o, against = place.overall, place.against
        cells.append(
            [place.agent, "-" if o.score is None else between(o.score, 3, place.seeds),
             "-" if place.balanced is None else f"{place.balanced.value:.2f}",
             between(o.rmse_iqm, 3, place.seeds), f"{o.settled_iqm.value:.3f}",
             "-" if against is None else f"{against.improvement.value:.0%}"]
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
    unit, factor = rate_unit(place.overall.means for place in board.places)
    cells = [
        ["agent", "success", "ended early", "recovery [s]", "peak [m]", "energy [kJ]", "effort",
         "saturated", f"action rate [{unit}]", "predict [us]", "training"],
    ]  # fmt: skip
    for place in board.places:
        o, m = place.overall, place.overall.means
        change = [f"{m['recovery_time']:.1f}", f"{m['peak_after_change']:.2f}"]
        cells.append(
            [place.agent, f"{m['success']:.1%}", f"{m['terminated']:.1%}",
             *(change if o.changed else ["-", "-"]), f"{m['energy'] / 1e3:.4g}",
             f"{m['effort']:.4f}", f"{m['saturation_share']:.1%}",
             f"{factor * action_rate(m)[0]:.4g}",
             f"{'' if o.timed_alone else '~'}{o.predict_time * 1e6:.1f}",
             "-" if place.training is None else str(place.training)]
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
    """Meaning of the columns of `table`."""
    few = any(0 < place.seeds <= FEW_SEEDS for place in board.places)
    than = board.reference
    return (
        f"Error / {than}: geometric mean over the sets of the IQM of the RMSE over that of {than}, "
        "of whole episodes and\nafter 5 s, without the start, which lies off the path. Intervals: "
        "95 %, seeds and episodes redrawn, in all sets together.\nWorst set: the largest of these "
        "ratios. Worst [m]: RMSE of the worst tenth of the episodes. A lost episode counts with "
        f"its\nerror at the limit. Than {than}: whether the interval excludes 1; 'loses' a set: "
        "under half of its episodes succeed,\nand not so for "
        f"{than}; no verdict ({TOO_FEW}) below {FEW_EPISODES + 1} episodes of a set and "
        f"{FEW_SEEDS + 1} seeds."
        + (f"\n* fewer than {FEW_SEEDS + 1} training seeds" if few else "")
    )


def agreement_text(board: Leaderboard) -> str:
    """Kendall's tau of the order, in a sentence."""
    known = [f"{name} {tau:.2f}" for name, tau in board.agreement.items() if tau == tau]
    if not known:
        return ""
    return f"Kendall's tau of this order and that by another statistic:\n{', '.join(known)}."


SCORES = (
    "Score: part of the gap between integral (0; without it nominal or uc) and the ceiling (1), "
    "the best policy that knows\nthe truth, by the IQM of the RMSE over all sets. Of the sets: "
    "mean of their scores, each with its own ceiling.\nP(better): probability that the agent has "
    "the smaller RMSE than the reference in an episode."
)


def terminal(board: Leaderboard, width: int = 80) -> str:
    """The leaderboard as plain text of at most `width` columns; wider tables are folded."""
    parts = [
        aligned(table(board), width=width),
        explanation(board),
        agreement_text(board),
        aligned(score_table(board), 1, width),
        SCORES,
        aligned(set_table(board), 1, width),
        "Score, and in brackets the IQM of the RMSE [m]",
        aligned(cost_table(board), 1, width),
        COSTS,
    ]
    if len(goals := goal_table(board)) > 1:
        parts += [aligned(goals, 1, width), GOAL_LEGEND]
    parts.append(board.conditions)
    tables = parts[0], parts[3], parts[5], parts[7], parts[9] if len(goals) > 1 else ""
    texts = (part if part in tables else folded(part, width) for part in parts if part)
    return "\n\n".join(texts)


def markdown(board: Leaderboard) -> str:
    """The leaderboard as Markdown."""
    goals = goal_table(board)
    parts = [
        markdown_rows(table(board)),
        escaped_lines(explanation(board)).replace("\n*", "\n\n\\*"),
        agreement_text(board),
        markdown_rows(score_table(board), 1),
        SCORES,
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
        "agreement": plain(board.agreement),
        "agents": [
            {
                **plain(place),
                "verdict": verdict(place),
                "verdict_settled": verdict(place, settled=True),
            }
            for place in board.places
        ],
    }


def write(folder: Path, board: Leaderboard) -> list[Path]:
    """Write leaderboard.json and leaderboard.md into `folder`; returns the files."""
    texts = {
        "leaderboard.json": json.dumps(document(board), indent=1) + "\n",
        "leaderboard.md": markdown(board),
    }
    for name, text in texts.items():
        write_atomically(folder / name, text.encode())
    return [folder / name for name in texts]
