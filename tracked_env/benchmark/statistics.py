"""Statistics of errors with heavy tails, over few episodes and few training seeds.

docs/metrics.md says what each is for, and how well the intervals cover. The values of an agent are
a matrix (S, N): S training seeds (1 of a controller), N episodes of one or several sets.
    interquartile mean      mean of the middle half: floor(n / 4) values are cut off at each end [1]
    90 % quantile           the ceil(0.9 n)-th smallest value
    bootstrap               S of S seeds and n of n episodes, with replacement; every drawn seed
                            meets every drawn episode [1, 2], sets of one size are redrawn together
    probability             of improvement: U / (S_X S_Y) of Mann and Whitney in each episode [1]
    performance profile     share of all seeds and episodes with a value below tau [1]
    expanded interval       with v the variance of all redraws and v_s that of redraws of the seeds
                            alone, a normal quantile z is replaced by sqrt(1 + v_s / ((S - 1) v))
                            t_nu, nu = (S - 1) (v / v_s)^2 [3, 4]. Of several samples that are few,
                            seeds and sets, the terms under the root and 1 / nu add up; with one
                            seed it is the percentile interval [5]
    relative error          geometric mean over sets of a statistic of an agent / that of another
    p-value                 of a relative error of 1: twice the share of the redraws beyond 1, at
                            least 1 / resamples, expanded as the interval; where seeds count and no
                            redraw is beyond 1, of Student's t, with the deviation of the redraws
    Holm's correction       p_(i) becomes the largest (m - j + 1) p_(j), j <= i, at most 1 [6]
    rank correlation        Spearman's, of two sets over the same policies
A redraw is kept as counts of each seed and episode (SciPy's bootstrap redraws one sample), so that
the values are sorted once: a trimmed mean follows from the cumulative counts.

References: [1] Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical
Precipice, NeurIPS 2021, section 4. [2] Owen, The pigeonhole bootstrap, Annals of Applied
Statistics 1 (2007) 386. [3] Hesterberg, The American Statistician 69 (2015) 371.
[4] Satterthwaite, Biometrics Bulletin 2 (1946) 110. [5] Efron and Tibshirani, An Introduction to
the Bootstrap, 1993, 13.3. [6] Holm, Scandinavian Journal of Statistics 6 (1979) 65.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri, stdtr, stdtrit

FloatArray = NDArray[np.float64]

LEVEL = 0.95  # [-] of the intervals
RESAMPLES = 5000  # [-] Monte-Carlo error of an interval's end: about 2 % of its width
SEED = 20210187  # of the resampling: the same records give the same interval
FEW_SEEDS = 4  # an agent with so many or less is marked, and gets no verdict
FEW_EPISODES = 15  # of a set, with which there is no verdict: percentiles of fewer are too narrow
SMALLEST = 1e-12  # [m] an error below counts as this one, so that its logarithm is finite
BLOCK = 250  # [redraws] worked on at once: bounds the memory
ALIKE = 0.9  # [-] rank correlation of two sets


class Estimate(NamedTuple):
    """A statistic and its bootstrap interval, in the unit of the values."""

    value: float
    low: float
    high: float


def interquartile_mean(values: ArrayLike) -> FloatArray:
    """Mean of the middle half over the last axis, (..., n) -> (...); n <= 3 is the plain mean."""
    ordered = np.sort(np.asarray(values, dtype=np.float64), axis=-1)
    count = ordered.shape[-1]
    cut = count // 4
    return np.asarray(ordered[..., cut : count - cut].mean(axis=-1))


def quantile(values: ArrayLike) -> FloatArray:
    """90 % quantile over the last axis, (..., n) -> (...): the ceil(0.9 n)-th smallest value."""
    ordered = np.sort(np.asarray(values, dtype=np.float64), axis=-1)
    return np.asarray(ordered[..., ordered.shape[-1] - ordered.shape[-1] // 10 - 1])


# By the name of a field of `Redrawn`.
STATISTICS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "mean": lambda values: np.asarray(np.mean(values, axis=-1)),
    "iqm": interquartile_mean,
    "quantile": quantile,
}


def _counts(rng: np.random.Generator, size: int, resamples: int) -> NDArray[np.int64]:
    """How often each of `size` rows is drawn, in `resamples` draws of `size`: (B, size)."""
    drawn = rng.integers(size, size=(resamples, size)) + size * np.arange(resamples)[:, None]
    return np.bincount(drawn.ravel(), minlength=resamples * size).reshape(resamples, size)


class Redraws:
    """Redraws of the episodes of one or several sets, and of an agent's seeds."""

    def __init__(self, sizes: Sequence[int], resamples: int = RESAMPLES, seed: int = SEED) -> None:
        """sizes: episodes of each set. Raises ValueError for a set without any."""
        if not sizes or min(sizes) < 1:
            raise ValueError("a set has no episodes; there is nothing to draw from")
        rng = np.random.default_rng(seed)
        self.resamples, self.seed = resamples, seed
        drawn = {n: _counts(rng, n, resamples) for n in dict.fromkeys(sizes)}
        self.episodes = np.concatenate([drawn[n] for n in sizes], axis=1)  # (B, N)

    def seeds(self, count: int, agent: int) -> NDArray[np.int64]:
        """Redraws (B, S) of the seeds of agent number `agent`, independent of other agents'."""
        return _counts(np.random.default_rng([self.seed, agent]), count, self.resamples)


class Redrawn(NamedTuple):
    """An agent's values, and three statistics of each redraw.

    Of two kinds, in the first axis: seeds and episodes redrawn, and the seeds alone.
    """

    values: FloatArray  # (S, N)
    seeds: NDArray[np.int64]  # (B, S) how often each seed was drawn
    mean: FloatArray  # (2, B)
    iqm: FloatArray  # (2, B) interquartile mean
    quantile: FloatArray  # (2, B) 90 % quantile


def redraw(values: FloatArray, redraws: Redraws, agent: int = 0) -> Redrawn:
    """Statistics of an agent in every redraw; values (S, N)."""
    seeds = redraws.seeds(len(values), agent)
    order = np.argsort(values, axis=None)
    ordered = values.ravel()[order]
    total = values.size
    quarter, place = total // 4, total - total // 10  # of the quantile, counted from 1
    mean, iqm, upper = np.empty((3, 2, redraws.resamples))
    for kind, episodes in enumerate((redraws.episodes, np.ones_like(redraws.episodes))):
        if kind and len(values) == 1:  # one seed alone: nothing is redrawn
            mean[1], iqm[1], upper[1] = (of(ordered) for of in STATISTICS.values())
            break
        for first in range(0, redraws.resamples, BLOCK):
            rows = slice(first, first + BLOCK)
            drawn = seeds[rows, :, None] * episodes[rows, None, :]
            reached = drawn.reshape(len(drawn), -1)[:, order].cumsum(axis=1)
            for low, high, out in ((quarter, total - quarter, iqm), (place - 1, place, upper)):
                inside = np.diff(np.clip(reached, low, high), axis=1, prepend=low)
                out[kind, rows] = inside @ ordered / (high - low)
        mean[kind] = np.einsum("bs,sn,bn->b", seeds, values, episodes, optimize=True) / total
    return Redrawn(values, seeds, mean, iqm, upper)


def fewest(*agents: Redrawn) -> int:
    """The smallest number of seeds of those that have several, else 1."""
    return min((len(agent.values) for agent in agents if len(agent.values) > 1), default=1)


def _expansion(variances: Sequence[float], sizes: Sequence[int]) -> tuple[float, float]:
    """Factor of a normal quantile, and the degrees of freedom of Student's t in its place.

    variances: of all redraws and of those of each small sample alone, which has so many members.
    """
    terms = [
        (min(part / variances[0], 1.0), size - 1)
        for part, size in zip(variances[1:], sizes, strict=True)
        if size > 1 and part > 0.0 and variances[0] > 0.0
    ]
    freedom = sum(share**2 / n for share, n in terms)
    return math.sqrt(1.0 + sum(share / n for share, n in terms)), 1.0 / (freedom or math.inf)


def interval(distribution: FloatArray, *sizes: int, level: float = LEVEL) -> FloatArray:
    """Expanded percentile interval of redraws (1 + F, B, ...): (2, ...).

    distribution: of all samples, then of each of F small samples alone; sizes: of these, seeds or
    sets. A redraw that is no number is left out.
    """
    columns = distribution.reshape(*distribution.shape[:2], -1)
    bounds = np.empty((2, columns.shape[2]))
    tail = 0.5 - 0.5 * level
    for column in range(columns.shape[2]):
        redraws, *alone = (of[~np.isnan(of)] for of in columns[:, :, column])
        factor, freedom = _expansion([float(of.var()) for of in (redraws, *alone)], sizes)
        beyond = tail if factor == 1.0 else ndtr(factor * stdtrit(freedom, tail))
        bounds[:, column] = np.quantile(redraws, [beyond, 1.0 - beyond])
    return bounds.reshape(2, *distribution.shape[2:])


def estimate(value: float, distribution: FloatArray, seeds: int) -> Estimate:
    """A statistic and the expanded interval of its redraws (2, B), of `seeds` trainings."""
    low, high = interval(distribution, seeds)
    return Estimate(float(value), float(low), float(high))


def ratio(value: ArrayLike, other: ArrayLike) -> FloatArray:
    """value / other; infinite where the other is 0."""
    value = np.asarray(value, dtype=np.float64)
    return np.divide(value, other, out=np.full_like(value, np.inf), where=np.asarray(other) > 0.0)


def enough(episodes: int, *seeds: int) -> bool:
    """Whether a verdict may be given: episodes of each set, trainings of each agent (0: none)."""
    return episodes > FEW_EPISODES and not any(0 < count <= FEW_SEEDS for count in seeds)


def _log_ratio(
    sets: Sequence[tuple[Redrawn, Redrawn]], statistic: str
) -> tuple[FloatArray, FloatArray]:
    """Logarithm of the ratio of a statistic on each of K sets, (K,), and of its redraws (2, B, K).

    All sets must have been redrawn from the same `Redraws.seed` and agent numbers: then a redraw
    takes the same seeds, and in sets of one size the same episodes, everywhere.
    """

    def logarithm(of: Redrawn) -> tuple[float, FloatArray]:
        value = float(STATISTICS[statistic](of.values.ravel()))
        return math.log(max(value, SMALLEST)), np.log(np.maximum(getattr(of, statistic), SMALLEST))

    pairs = [(logarithm(agent), logarithm(reference)) for agent, reference in sets]
    values = np.array([agent[0] - reference[0] for agent, reference in pairs])
    return values, np.stack([agent[1] - reference[1] for agent, reference in pairs], axis=2)


def relative_error(
    sets: Sequence[tuple[Redrawn, Redrawn]], statistic: str = "iqm", redraw_sets: bool = False
) -> Estimate:
    """Geometric mean over sets of a statistic over that of the reference.

    sets: (agent, reference) of each. Its interval is of these sets, or with them redrawn as well.
    """
    values, drawn = _log_ratio(sets, statistic)
    distribution, sizes = drawn.mean(axis=2), [fewest(*sets[0])]
    if redraw_sets:
        rng = np.random.default_rng([SEED, 0, 1])  # neither of episodes nor of any agent's seeds
        count = _counts(rng, len(sets), drawn.shape[1]) / len(sets)
        both, by_sets = (drawn[0] * count).sum(axis=1), count @ values
        distribution, sizes = np.stack([both, distribution[1], by_sets]), [*sizes, len(sets)]
    low, high = np.exp(interval(distribution, *sizes))
    return Estimate(math.exp(values.mean()), float(low), float(high))


def p_value(sets: Sequence[tuple[Redrawn, Redrawn]]) -> float:
    """Two-sided p-value of a relative error of 1 on these sets."""
    values, redraws = _log_ratio(sets, "iqm")
    drawn = redraws.mean(axis=2)
    share = min(float((drawn[0] >= 0.0).mean()), float((drawn[0] <= 0.0).mean()), 0.5)
    factor, freedom = _expansion([float(of.var()) for of in drawn], (fewest(*sets[0]),))
    if factor > 1.0:
        normal = ndtri(share) if share > 0.0 else -abs(values.mean()) / drawn[0].std()
        share = float(stdtr(freedom, normal / factor))
    return max(2.0 * share, 1.0 / len(drawn[0]))


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values (m,) with Holm's correction for their number, in the same places."""
    adjusted, largest = [0.0] * len(p_values), 0.0
    for rank, place in enumerate(np.argsort(p_values, kind="stable").tolist()):
        largest = max(largest, min((len(p_values) - rank) * p_values[place], 1.0))
        adjusted[place] = largest
    return adjusted


def gap_closed(low: ArrayLike, high: ArrayLike, value: ArrayLike) -> FloatArray:
    """(low - value) / (low - high): 0 as the anchor `low`, 1 as `high`; NaN without a gap.

    low, high, value: interquartile means; smaller ones are better.
    """
    gap = np.asarray(np.subtract(low, high), dtype=np.float64)
    return np.divide(np.subtract(low, value), gap, out=np.full_like(gap, np.nan), where=gap > 0.0)


def score(low: Redrawn, high: Redrawn, agent: Redrawn) -> Estimate | None:
    """`gap_closed` of interquartile means with its interval.

    None when the gap between the anchors is not certain (more than a redraw in forty has none).
    """
    value = float(gap_closed(*(interquartile_mean(of.values.ravel()) for of in (low, high, agent))))
    distribution = gap_closed(low.iqm, high.iqm, agent.iqm)
    if np.isnan(value) or np.isnan(distribution).mean(axis=1).max() > 0.5 - 0.5 * LEVEL:
        return None
    return estimate(value, distribution, fewest(low, high, agent))


def improvement(first: Redrawn, second: Redrawn, redraws: Redraws) -> Estimate:
    """Probability that a seed of the first beats one of the second on the same episode."""
    difference = second.values[None, :, :] - first.values[:, None, :]
    wins = 0.5 * (np.sign(difference) + 1.0)  # (S_1, S_2, N) 1, 0, or 1/2 for a tie
    pairs = wins.reshape(-1, wins.shape[-1])  # (S_1 S_2, N)
    by_pair = np.stack([redraws.episodes @ pairs.T, np.tile(pairs.sum(1), (redraws.resamples, 1))])
    drawn = first.seeds[:, :, None] * second.seeds[:, None, :]
    distribution = (by_pair * drawn.reshape(len(drawn), -1)).sum(axis=2) / wins.size  # (2, B)
    return estimate(float(wins.mean()), distribution, fewest(first, second))


def profile(agent: Redrawn, redraws: Redraws, tau: FloatArray) -> FloatArray:
    """Performance profile and its 95 % band at the thresholds tau (T,): (3, T)."""
    below = (agent.values[:, :, None] <= tau).astype(np.float64)  # (S, N, T)
    total = agent.values.size
    drawn = np.stack([redraws.episodes @ part for part in below])  # (S, B, T)
    both = np.einsum("bs,sbt->bt", agent.seeds, drawn)
    alone = agent.seeds @ below.sum(axis=1)
    bounds = interval(np.stack([both, alone]) / total, fewest(agent))
    return np.concatenate([below.mean(axis=(0, 1))[None], bounds])


def kendalls_tau(first: Sequence[float], second: Sequence[float]) -> float:
    """Kendall's tau-b of two lists of values (n,) of the same things; NaN if one has only ties."""
    from scipy.stats import kendalltau  # here: its import takes half a second

    return float(kendalltau(first, second).statistic) if len(first) > 1 else math.nan


def correlations(sets: Sequence[Mapping[str, float]]) -> FloatArray:
    """Rank correlations (S, S) of sets {policy: value} with one another; NaN if all are equal."""
    from scipy.stats import rankdata

    def correlation(one: FloatArray, two: FloatArray) -> float:
        constant = min(np.ptp(one), np.ptp(two)) == 0.0
        return math.nan if constant else float(np.corrcoef(one, two)[0, 1])

    ranks = [rankdata([of[policy] for policy in sets[0]]) for of in sets]
    return np.array([[correlation(one, two) for two in ranks] for one in ranks])


def unlike(correlation: FloatArray, preferred: Sequence[int] = ()) -> list[int]:
    """The most sets of which no two have a rank correlation above ALIKE: their places, rising.

    correlation (S, S). Exact, by integer programming: x_i + x_j <= 1 for each pair that is alike.
    preferred: places that are taken rather than others where the number is the same.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp

    count = len(correlation)
    if count == 0:
        return []
    gain, whole = np.ones(count), np.ones(count, dtype=np.int64)
    gain[list(preferred)] += 0.5 / count
    pairs = np.argwhere(np.triu(correlation > ALIKE, 1))
    rows = np.zeros((len(pairs), count))
    np.put_along_axis(rows, pairs, 1.0, axis=1)
    limits = [LinearConstraint(rows, -np.inf, 1.0)] if len(pairs) else []
    solution = milp(-gain, constraints=limits, integrality=whole, bounds=Bounds(0.0, 1.0))
    selected = np.asarray(solution.x) > 0.5  # there is a solution: no set at all is one
    return [int(i) for i in np.flatnonzero(selected)]
