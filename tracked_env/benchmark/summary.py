"""From records to a summary.

Per set and policy: interquartile mean (IQM) and mean of the tracking RMSE over the episodes, each
with a 95 % bootstrap interval, and means of the other metrics over the episodes that have them.
Every policy is then compared with the first one, the baseline, on the same episodes:
    ratio        IQM of the baseline's RMSE over the policy's
    difference   mean over the episodes of (baseline's - policy's RMSE) [m]
    worse        the baseline is clearly worse: the interval of the difference lies above 0 and
                 the ratio is at least SEPARATION_RATIO. With nominal as the baseline, a set
                 separates when this holds for the oracle.
    fails alone  episodes in which the policy ends early or without success, the baseline not
    score        (IQM of nominal - IQM of policy) / (IQM of nominal - IQM of oracle), if both are
                 among the policies: 0 is as good as nominal, 1 as the oracle
`all sets` pools the episodes of all sets, redrawn set by set (stratified).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.identification import IdentificationSummary, mean_nis
from tracked_env.benchmark.identification import summarise as summarise_beliefs
from tracked_env.benchmark.metrics import METRICS
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import Record

SEPARATION_RATIO = 1.2  # [-] of the interquartile means
ALL_SETS = "all sets"
LOW_ANCHOR, HIGH_ANCHOR = "nominal", "oracle"  # policies that score 0 and 1


class PolicySummary(NamedTuple):
    """One policy on one set."""

    episodes: int
    rmse_iqm: Estimate  # [m]
    rmse_mean: Estimate  # [m]
    means: dict[str, float]  # of every metric, over the episodes that have it; NaN if none has
    predict_time: float  # [s] per vehicle and step
    changed: int = 0  # episodes with an abrupt change of the parameters


class Comparison(NamedTuple):
    """The baseline against one policy on one set."""

    ratio: Estimate  # [-]
    difference: Estimate  # [m]
    worse_share: float  # [-] of the episodes in which the baseline is worse
    worse: bool  # clearly, see above
    fails_alone: int = 0  # episodes in which the policy fails and the baseline does not
    score: Estimate | None = None  # [-] 0 as nominal, 1 as oracle; None if they are not told apart


class Summary(NamedTuple):
    """What a benchmark says: {set: {policy: ...}}, sets and policies in their order."""

    baseline: str
    policies: dict[str, dict[str, PolicySummary]]
    comparisons: dict[str, dict[str, Comparison]]
    # By parameter, and by filter; only of policies that estimate.
    identification: dict[str, dict[str, dict[str, IdentificationSummary]]]
    nis: dict[str, dict[str, dict[str, float]]]


def _column(records: Sequence[Record], name: str) -> NDArray[np.float64]:
    return np.array([record[name] for record in records], dtype=np.float64)


def _rmse(strata: Sequence[Sequence[Record]]) -> list[NDArray[np.float64]]:
    return [_column(records, "tracking_rmse") for records in strata]


def _mean(records: Sequence[Record], name: str) -> float:
    """Mean of a metric over the records that have it."""
    values = _column(records, name)
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else np.nan


def failed(record: Record) -> bool:
    """Whether an episode ended before its time, or with too large an error."""
    return bool(record["terminated"] > 0.5 or record["success"] < 0.5)


def _policy_summary(strata: Sequence[Sequence[Record]]) -> PolicySummary:
    rmse = _rmse(strata)
    pooled = [record for records in strata for record in records]
    return PolicySummary(
        len(pooled),
        stats.estimate(rmse),
        stats.estimate(rmse, stats.mean),
        {name: _mean(pooled, name) for name in METRICS},
        _mean(pooled, "predict_time"),
        sum(record["recovery_time"] is not None for record in pooled),
    )


def compare(
    baseline: Sequence[Sequence[Record]],
    other: Sequence[Sequence[Record]],
    anchors: tuple[Sequence[Sequence[Record]], Sequence[Sequence[Record]]] | None = None,
) -> Comparison:
    """Baseline against another policy; strata of records of the same episodes.

    anchors: the same of the policies that score 0 and 1; without them there is no score.
    Raises ValueError when the episodes differ.
    """
    for first, second in zip(baseline, other, strict=True):
        if [r["digest"] for r in first] != [r["digest"] for r in second]:
            raise ValueError(
                f"policies {first[0]['policy']!r} and {second[0]['policy']!r} did not meet the "
                f"same episodes of {first[0]['set']!r}; delete the folder of results"
            )
    own = _rmse(other)
    pairs = stats.paired(_rmse(baseline), own)
    ratio = stats.estimate(pairs, stats.ratio_of_means)
    difference = stats.estimate(pairs, stats.mean_difference)
    pooled = np.concatenate(pairs)
    share = float(np.mean(pooled[:, 0] > pooled[:, 1]))
    clearly = difference.low > 0.0 and ratio.value >= SEPARATION_RATIO
    alone = sum(
        failed(b) and not failed(a)
        for first, second in zip(baseline, other, strict=True)
        for a, b in zip(first, second, strict=True)
    )
    score = None
    if anchors is not None:
        score = stats.score(_rmse(anchors[0]), _rmse(anchors[1]), own)
    return Comparison(ratio, difference, share, bool(clearly), alone, score)


def summarise(records: Sequence[Record]) -> Summary:
    """Summary of records as the runner returns them; the first policy is the baseline."""
    groups: dict[str, dict[str, list[Record]]] = {}
    for record in records:
        groups.setdefault(record["set"], {}).setdefault(record["policy"], []).append(record)
    if not groups:
        raise ValueError("no finished episode to summarise")
    baseline = records[0]["policy"]
    rows: dict[str, list[dict[str, list[Record]]]] = {name: [by] for name, by in groups.items()}
    if len(groups) > 1:
        rows[ALL_SETS] = list(groups.values())
    policies: dict[str, dict[str, PolicySummary]] = {}
    comparisons: dict[str, dict[str, Comparison]] = {}
    identification: dict[str, dict[str, dict[str, IdentificationSummary]]] = {}
    nis: dict[str, dict[str, dict[str, float]]] = {}
    for name, strata in rows.items():
        names = list(strata[0])
        by_policy = {policy: [stratum[policy] for stratum in strata] for policy in names}
        policies[name] = {policy: _policy_summary(by_policy[policy]) for policy in names}
        anchors = None
        if {LOW_ANCHOR, HIGH_ANCHOR} <= set(names):
            anchors = by_policy[LOW_ANCHOR], by_policy[HIGH_ANCHOR]
        comparisons[name] = {
            policy: compare(by_policy[baseline], by_policy[policy], anchors) for policy in names[1:]
        }
        pooled = {policy: [r for s in strata for r in s[policy]] for policy in names}
        believed = {policy: summarise_beliefs(records) for policy, records in pooled.items()}
        identification[name] = {policy: by for policy, by in believed.items() if by}
        nis[name] = {policy: mean_nis(pooled[policy]) for policy in identification[name]}
    return Summary(baseline, policies, comparisons, identification, nis)
