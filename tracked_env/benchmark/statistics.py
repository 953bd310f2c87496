"""Statistics for few episodes with heavy tails: interquartile mean and bootstrap intervals.

    interquartile mean      mean of the middle half: floor(n / 4) values are cut off at each end [1]
    percentile bootstrap    draw n of n values with replacement, B times; the interval lies between
                            the (1 - level) / 2 and (1 + level) / 2 quantiles of the statistic [2]
    stratified              the values of each stratum (one training seed, one set) are redrawn
                            among themselves, then pooled [1]
Assumption: episodes are drawn independently. With n values the percentile interval of a mean is
too short by about a factor sqrt((n - 1) / n), and more for skewed values: use n >= 16.

References: [1] Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical
Precipice, NeurIPS 2021. [2] Efron and Tibshirani, An Introduction to the Bootstrap, 1993, 13.3.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
Statistic = Callable[[FloatArray], FloatArray]  # (..., n) -> (...)

LEVEL = 0.95  # [-] of the intervals
RESAMPLES = 5000  # [-] Monte-Carlo error of an interval's end: about 2 % of its width
SEED = 20210187  # of the resampling: the same records give the same interval


class Estimate(NamedTuple):
    """A statistic and its bootstrap interval, in the unit of the values."""

    value: float
    low: float
    high: float


def mean(values: ArrayLike) -> FloatArray:
    """Mean over the last axis, (..., n) -> (...)."""
    return np.asarray(np.asarray(values, dtype=np.float64).mean(axis=-1))


def interquartile_mean(values: ArrayLike) -> FloatArray:
    """Mean of the middle half over the last axis, (..., n) -> (...); n <= 3 is the plain mean."""
    ordered = np.sort(np.asarray(values, dtype=np.float64), axis=-1)
    count = ordered.shape[-1]
    cut = count // 4
    return mean(ordered[..., cut : count - cut])


def bootstrap(
    strata: Sequence[ArrayLike], statistic: Statistic, resamples: int = RESAMPLES, seed: int = SEED
) -> FloatArray:
    """The statistic of `resamples` redraws, shape (resamples,).

    strata: one array (n_s, ...) per stratum, redrawn by rows within itself. The statistic sees
    the pooled redraws with their n = sum n_s values on the last axis, (resamples, ..., n).
    Raises ValueError for an empty stratum.
    """
    rng = np.random.default_rng(seed)
    drawn = []
    for stratum in strata:
        values = np.asarray(stratum, dtype=np.float64)
        if values.ndim == 0 or values.shape[0] == 0:
            raise ValueError("a stratum has no values; there is nothing to draw from")
        rows = rng.integers(values.shape[0], size=(resamples, values.shape[0]))
        drawn.append(np.moveaxis(values[rows], 1, -1))
    return statistic(np.concatenate(drawn, axis=-1))


def interval(distribution: FloatArray, level: float = LEVEL) -> tuple[float, float]:
    """Percentile interval of a bootstrap distribution (resamples,)."""
    low, high = np.quantile(distribution, [0.5 - 0.5 * level, 0.5 + 0.5 * level])
    return float(low), float(high)


def estimate(
    strata: Sequence[ArrayLike], statistic: Statistic = interquartile_mean, level: float = LEVEL
) -> Estimate:
    """The statistic of all values with its stratified percentile bootstrap interval.

    strata: as `bootstrap` takes them; one stratum for a single set of episodes.
    """
    pooled = np.concatenate([np.asarray(stratum, dtype=np.float64) for stratum in strata])
    low, high = interval(bootstrap(strata, statistic), level)
    return Estimate(float(statistic(np.moveaxis(pooled, 0, -1))), low, high)


def paired(first: Sequence[ArrayLike], second: Sequence[ArrayLike]) -> list[FloatArray]:
    """Strata of pairs (n_s, 2) from two lists of strata (n_s,) of the same episodes.

    Raises ValueError when the lengths differ.
    """
    pairs = []
    for a, b in zip(first, second, strict=True):
        if np.shape(a) != np.shape(b):
            raise ValueError(
                f"{np.shape(a)} and {np.shape(b)} values are not pairs; were both policies run "
                "on the same episodes?"
            )
        pairs.append(np.stack([np.asarray(a, float), np.asarray(b, float)], axis=-1))
    return pairs


def mean_difference(pairs: FloatArray) -> FloatArray:
    """Mean of first - second, (..., 2, n) -> (...): what both share cancels."""
    return mean(pairs[..., 0, :] - pairs[..., 1, :])


def ratio_of_means(pairs: FloatArray) -> FloatArray:
    """Interquartile mean of the first over that of the second, (..., 2, n) -> (...)."""
    top, bottom = interquartile_mean(pairs[..., 0, :]), interquartile_mean(pairs[..., 1, :])
    return np.divide(top, bottom, out=np.full_like(top, np.inf), where=bottom > 0.0)


def gap_closed(triples: FloatArray) -> FloatArray:
    """Part of the gap from a low to a high anchor that a policy closes, (..., 3, n) -> (...).

    Rows of the second last axis: values of the anchor that scores 0, of the one that scores 1,
    and of the policy; smaller values are better. With the interquartile means A, B and C:
    (A - C) / (A - B), NaN where A <= B.
    """
    low, high, policy = np.moveaxis(interquartile_mean(triples), -1, 0)
    gap = low - high
    return np.divide(low - policy, gap, out=np.full_like(gap, np.nan), where=gap > 0.0)


def score(
    low: Sequence[ArrayLike], high: Sequence[ArrayLike], policy: Sequence[ArrayLike]
) -> Estimate | None:
    """`gap_closed` with its stratified bootstrap interval, the same redraws for all three.

    Each argument: strata of values (n_s,) of the same episodes. None when the gap between the
    anchors is not certain (a redraw in forty has none): the score would mean nothing.
    """
    triples = [np.stack(parts, axis=-1) for parts in zip(low, high, policy, strict=True)]
    value = float(gap_closed(np.concatenate(triples).T))
    distribution = bootstrap(triples, gap_closed)
    known = distribution[~np.isnan(distribution)]
    if np.isnan(value) or known.size < (0.5 + 0.5 * LEVEL) * distribution.size:
        return None
    return Estimate(value, *interval(known))
