"""Statistics for few episodes with heavy tails: interquartile mean and bootstrap intervals.

    interquartile mean      mean of the middle half: floor(n / 4) values are cut off at each end [1]
    worst tenth             mean of the largest ceil(n / 10) values: the conditional value at risk
    percentile bootstrap    draw n of n values with replacement, B times; the interval lies between
                            the (1 - level) / 2 and (1 + level) / 2 quantiles of the statistic [2]
    stratified              the values of each stratum (one training seed, one set) are redrawn
                            among themselves, then pooled [1]
    Kendall's tau           agreement of two orders, 1 where no pair is the other way round, -1
                            where all are; tau-b, which counts ties [3]
Assumption: episodes are drawn independently. With n values the percentile interval of a mean is
too short by about a factor sqrt((n - 1) / n), and more for skewed values: use n >= 16.

References: [1] Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical
Precipice, NeurIPS 2021. [2] Efron and Tibshirani, An Introduction to the Bootstrap, 1993, 13.3.
[3] Kendall, Biometrika 33 (1945) 239.
"""

import math
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


def worst_tenth(values: ArrayLike) -> FloatArray:
    """Mean of the largest tenth over the last axis, (..., n) -> (...); at least one value."""
    ordered = np.sort(np.asarray(values, dtype=np.float64), axis=-1)
    return mean(ordered[..., -math.ceil(ordered.shape[-1] / 10) :])


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


def kendalls_tau(first: ArrayLike, second: ArrayLike) -> float:
    """Kendall's tau-b of two lists of values (n,) of the same things; NaN if one has only ties."""
    signs = [
        np.sign(np.subtract.outer(values, values)[np.triu_indices(len(values), 1)])
        for values in (np.asarray(first, np.float64), np.asarray(second, np.float64))
    ]
    pairs = math.prod(int(np.count_nonzero(sign)) for sign in signs)
    return float(signs[0] @ signs[1]) / math.sqrt(pairs) if pairs else math.nan
