"""The leaderboard: every agent by its error over that of the adaptive baseline, over all sets.

The relative error is the geometric mean over sets of IQM of the RMSE / that of the reference, of
whole episodes and after the start. A set is lost where fewer than LOST of its episodes end with
success, and not so the reference's: an agent that loses one is never called better. `better` and
`worse` mean a p-value of at most 5 % with Holm's correction for the number of verdicts of the
board; below the numbers of `statistics.enough` they are TOO_FEW. Agents are ordered by OTHER
statistics as well, and by the most sets of which no two are alike; the agreement with the order of
the leaderboard is Kendall's tau. docs/metrics.md has the reasons.
"""

import csv
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.policy_interface import agent_of
from tracked_env.benchmark.statistics import SMALLEST, Estimate
from tracked_env.benchmark.summary import Comparison, PolicySummary, Row, Summary

TOO_FEW = "too few"  # in the place of a verdict, see `statistics.enough`
# What agents have to beat, by torque and by speed; the summary's baseline where both are missing.
REFERENCES = ("adaptive", "slc-adaptive")
LOST = 0.5  # [-] share of the episodes with success below which a set is lost
TIMING = "timing.json"  # of `tracked-env timing --json`, in a folder of results
MAX_DRAWN = 5  # agents in a figure; more cannot be told apart


class RelativeError(NamedTuple):
    """An agent against the reference over all sets; ratios of 1 are the reference's own."""

    whole: Estimate  # [-] geometric mean of the ratios of IQMs
    settled: Estimate  # [-] the same after the start
    mean: Estimate  # [-] as `whole`, of means
    quantile: Estimate  # [-] of 90 % quantiles
    sets_drawn: Estimate  # [-] `whole` with the sets redrawn as well
    by_set: dict[str, Estimate]  # [-] ratio of the IQMs in each set
    p_values: tuple[float, float]  # of whole episodes, after the start; alone, see `statistics`
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


class CallTime(NamedTuple):
    """Of `predict` for one vehicle, as `tracked-env timing` measures it."""

    median: float  # [s]
    p99: float  # [s]


class Place(NamedTuple):
    """One agent of the leaderboard."""

    agent: str
    seeds: int  # trainings, 0 for a policy that is not trained
    overall: PolicySummary  # over all sets
    scores: dict[str, Estimate | None]  # by set
    rmse: dict[str, Estimate]  # [m] IQM by set
    against: Comparison | None  # the reference is its baseline; None for the reference itself
    relative: RelativeError  # over the reference
    training: TrainingCost | None = None  # None of a controller, or where it is not known
    call: CallTime | None = None  # None where it was not measured
    corrected: tuple[float, float] = (1.0, 1.0)  # p-values with Holm's correction, of a verdict


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
    whole = {name: (row.redrawn[agent], row.redrawn[reference]) for name, row in sets.items()}
    pairs = [*whole.values()]
    settled = [(row.settled[agent], row.settled[reference]) for row in sets.values()]
    by_set = {name: stats.relative_error([pair]) for name, pair in whole.items()}
    worst = max(by_set, key=lambda name: by_set[name].value)
    lost = [n for n, r in sets.items() if _success(r, agent) < LOST <= _success(r, reference)]
    return RelativeError(
        stats.relative_error(pairs),
        stats.relative_error(settled),
        stats.relative_error(pairs, "mean"),
        stats.relative_error(pairs, "quantile"),
        stats.relative_error(pairs, redraw_sets=True),
        by_set,
        (stats.p_value(pairs), stats.p_value(settled)),
        worst,
        by_set[worst].value,
        tuple(lost),
        min(min(row.sizes) for row in sets.values()),
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
    "90 % quantile": _geometric(
        lambda row, agent: float(stats.quantile(row.redrawn[agent].values.ravel()))
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
    calls: Mapping[str, CallTime] | None = None,
) -> Leaderboard:
    """From the summary and the rows that it was made of; training: what each agent's cost; calls:
    time of its calls for one vehicle."""
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
        place = Place(
            agent,
            overall.seeds,
            overall,
            scores,
            {name: of.rmse_iqm for name, of in by_set.items()},
            None if agent == reference else rows[last].compare(reference, agent),
            relative(of_sets, agent, reference),
            (training or {}).get(agent),
            (calls or {}).get(agent),
        )
        places.append(place)
    places = _corrected(sorted(places, key=lambda place: place.relative.whole.value))
    ranked = {place.agent: place.relative.whole.value for place in places}
    anchors = rows[last].anchors() or ()
    return Leaderboard(places, sets, reference, conditions, agreement(of_sets, ranked), anchors)


def _corrected(places: Sequence[Place]) -> list[Place]:
    """Places with Holm's correction over all verdicts, of whole episodes and after the start."""
    judged = [p for p in places if p.against and stats.enough(p.relative.episodes, p.seeds)]
    corrected = iter(stats.holm([p for place in judged for p in place.relative.p_values]))
    return [
        place._replace(corrected=(next(corrected), next(corrected))) if place in judged else place
        for place in places
    ]


def figure_agents(board: Leaderboard) -> list[str]:
    """The agents that figures draw, at most MAX_DRAWN, in the order of the leaderboard.

    The reference, where the score is 0, the best that reads the truth, and the best of the others.
    """
    agents = [place.agent for place in board.places]
    first = list(dict.fromkeys([board.reference, *board.anchors, *agents]))[:MAX_DRAWN]
    return [name for name in agents if name in first]


def judgement(ratio: Estimate) -> str:
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
    if place.corrected[settled] > 1.0 - stats.LEVEL:
        return "not certain"
    return judgement(place.relative.settled if settled else place.relative.whole)


def read_costs(folders: Mapping[str, Sequence[Path]]) -> dict[str, TrainingCost]:
    """Cost of training a seed, by agent, from the last row of the curve.csv of a training.

    folders: those of an agent's archives. Agents without such a curve are left out.
    """
    costs = {}
    for agent, places in folders.items():
        ends = []
        for path in (folder / "curve.csv" for folder in places):
            if path.is_file():
                rows = [*csv.DictReader(path.read_text(encoding="utf-8").splitlines())]
                if rows and {"steps", "cpu_seconds"} <= rows[-1].keys():  # else another kind
                    ends.append([float(rows[-1][name]) for name in ("steps", "cpu_seconds")])
        if ends:
            costs[agent] = TrainingCost(*np.mean(ends, axis=0).tolist())
    return costs


def read_call_times(folder: Path) -> dict[str, CallTime]:
    """Times of a call by agent, of the file TIMING in a folder of results; none without it.

    Raises ValueError for a file of another content.
    """
    path = folder / TIMING
    if not path.exists():
        return {}
    try:
        timings = json.loads(path.read_text(encoding="utf-8"))["timings"]
        return {
            agent_of(of["policy"]): CallTime(*(float(of["predict"][k]) for k in CallTime._fields))
            for of in timings
        }
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} is not what `tracked-env timing --json` writes; write it again or delete it"
        ) from error
