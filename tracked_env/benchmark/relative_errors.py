"""What leads the leaderboard: an agent's error over that of the reference, over all sets.

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

Is it the choice of the statistic that decides? Agents are ordered by OTHER ones as well, and the
agreement with the order of the leaderboard is Kendall's tau. Is it that some sets say the same, and
count twice? The same order is made of the most sets of which no two are alike.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.stats import rankdata

from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.reliability import SMALLEST, ratio, relative_error
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.summary import Row

LOST = 0.5  # [-] share of the episodes with success below which a set is lost
ALIKE = 0.9  # [-] rank correlation above which one of two sets says what the other one says


def rank_correlation(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    """Spearman's correlation [-] of two sets over their policies; NaN if all are equal."""
    first, second = (rankdata([values[agent] for agent in one]) for values in (one, other))
    if min(np.ptp(first), np.ptp(second)) == 0.0:
        return math.nan
    return float(np.corrcoef(first, second)[0, 1])


def correlations(sets: Sequence[Mapping[str, float]]) -> NDArray[np.float64]:
    """Rank correlations (S, S) of sets {policy: value} with one another."""
    return np.array([[rank_correlation(one, other) for other in sets] for one in sets])


def unlike(correlation: NDArray[np.float64], preferred: Sequence[int] = ()) -> list[int]:
    """The most sets of which no two have a rank correlation above ALIKE: their places, rising.

    correlation (S, S). Exact, by integer programming: x_i + x_j <= 1 for each pair that is alike.
    preferred: places that are taken rather than others where the number is the same.
    """
    count = len(correlation)
    if count == 0:
        return []
    gain, whole = np.ones(count), np.ones(count, dtype=np.int64)
    gain[list(preferred)] += 0.5 / count
    pairs = np.argwhere(np.triu(correlation > ALIKE, 1))
    rows = np.zeros((len(pairs), count))
    rows[np.arange(len(pairs))[:, None], pairs] = 1.0
    limits = [LinearConstraint(rows, -np.inf, 1.0)] if len(pairs) else []
    solution = milp(-gain, constraints=limits, integrality=whole, bounds=Bounds(0.0, 1.0))
    return np.flatnonzero(np.asarray(solution.x) > 0.5).tolist()  # no set at all is a solution


class RelativeError(NamedTuple):
    """An agent against the reference over all sets; ratios of 1 are the reference's own."""

    whole: Estimate  # [-] geometric mean
    settled: Estimate  # [-] the same after the start
    worst_set: str
    worst: float  # [-] ratio there
    lost: tuple[str, ...]  # sets that the agent loses and the reference does not
    episodes: int  # of the smallest set, of one seed


def _success(row: Row, agent: str) -> float:
    return float(row.matrix(agent, "success").mean())


def relative(sets: Mapping[str, Row], agent: str, reference: str) -> RelativeError:
    """The agent's errors over those of the reference; sets: a Row of each set."""
    rows = list(sets.values())
    ratios = {
        name: float(ratio(np.array(row.iqm(agent)), np.array(row.iqm(reference))))
        for name, row in sets.items()
    }
    worst = max(ratios, key=lambda name: ratios[name])
    return RelativeError(
        relative_error([(row.redrawn[agent], row.redrawn[reference]) for row in rows]),
        relative_error([(row.settled[agent], row.settled[reference]) for row in rows]),
        worst,
        ratios[worst],
        tuple(
            name
            for name, row in sets.items()
            if _success(row, agent) < LOST <= _success(row, reference)
        ),
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
    rows = list(sets.values())
    values = list(ranked.values())
    found = {
        name: stats.kendalls_tau(values, [by(rows, agent) for agent in ranked])
        for name, by in OTHER.items()
    }
    apart = unlike(correlations([{name: row.iqm(name) for name in ranked} for row in rows]))
    by = _geometric(lambda row, agent: row.iqm(agent))
    fewer = [by([rows[i] for i in apart], agent) for agent in ranked]
    return found | {f"{len(apart)} unlike sets": stats.kendalls_tau(values, fewer)}
