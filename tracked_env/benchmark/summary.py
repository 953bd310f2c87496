"""From records to a summary; docs/metrics.md defines what is in it.

A policy `name@seed` is one training of the agent `name`; its seeds are summarised together. Per set
and agent there is a PolicySummary; every agent is then compared with the first one, the baseline,
on the same episodes. The ceiling of a set is the policy with the smallest IQM among those that are
handed the true parameters. `all sets` pools the episodes of all sets; the k-th ones of all are
redrawn together.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.identification_metrics import mean_nis
from tracked_env.benchmark.identification_metrics import summarise as summarise_beliefs
from tracked_env.benchmark.metrics import METRICS
from tracked_env.benchmark.policy_interface import SEED_MARK, agent_of
from tracked_env.benchmark.statistics import Estimate, FloatArray
from tracked_env.benchmark.store import BESIDE, READS_TRUTH, Record

SEPARATION_RATIO = 1.2  # [-] of the interquartile means
ALL_SETS = "all sets"
STARTS = ("integral", "nominal", "uc")  # the first of them that is here scores 0
BySeed = dict[str, list[Record]]  # records of one agent on one set


class PolicySummary(NamedTuple):
    """One agent on one set."""

    episodes: int  # of one seed
    rmse_iqm: Estimate  # [m]
    rmse_mean: Estimate  # [m]
    rmse_quantile: Estimate  # [m] 90 % quantile
    settled_iqm: Estimate  # [m] IQM of the RMSE after the start
    means: dict[str, float]  # of every metric, over the episodes that have it; NaN if none has
    predict_time: float  # [s] per vehicle and step
    changed: int = 0  # episodes with an abrupt change of the parameters, of all seeds
    seeds: int = 0  # trainings; 0 for a policy that is not trained
    score: Estimate | None = None  # [-] 0 as START, 1 as the ceiling; None if these do not differ
    timed_alone: bool = True  # whether no other process disturbed `predict_time`


class Comparison(NamedTuple):
    """One agent against another, the baseline, on one set."""

    ratio: Estimate  # [-] IQM of the baseline's RMSE over the agent's
    difference: Estimate  # [m] mean over seeds and episodes of the baseline's RMSE - the agent's
    improvement: Estimate  # [-] probability that the agent has the smaller RMSE in an episode
    worse: bool  # clearly: the difference's interval is above 0, the ratio >= SEPARATION_RATIO
    fails_alone: float = 0  # episodes in which the agent fails and the baseline does not, per seed
    enough: bool = True  # episodes of each set and seeds of both for a verdict


class Summary(NamedTuple):
    """Results of a benchmark: {set: {agent: ...}}, sets and agents in their order."""

    baseline: str
    policies: dict[str, dict[str, PolicySummary]]
    comparisons: dict[str, dict[str, Comparison]]
    # By parameter, and by filter; only of policies that estimate.
    identification: dict[str, dict[str, dict[str, dict[str, float]]]]
    nis: dict[str, dict[str, dict[str, float]]]
    ceilings: dict[str, str]  # {set: agent}, of the sets that a policy with the truth has driven


def _column(records: Sequence[Record], name: str) -> FloatArray:
    return np.array([record[name] for record in records], dtype=np.float64)


def _mean(records: Sequence[Record], name: str) -> float:
    """Mean of a metric over the records that have it."""
    column = _column(records, name)
    values = column[~np.isnan(column)]
    return float(values.mean()) if values.size else np.nan


class Row:
    """One line of the summary: some sets, every agent on their episodes."""

    def __init__(self, sets: Sequence[Mapping[str, BySeed]]) -> None:
        """sets: {agent: records by seed} of each. Raises ValueError when the episodes differ."""
        self.sets = sets
        self.names = list(sets[0])
        self.seeds = {name: list(sets[0][name]) for name in self.names}
        self.sizes = [self._checked(of) for of in sets]  # episodes of each
        self.redraws = stats.Redraws(self.sizes)
        self.redrawn, self.settled = (
            {
                name: stats.redraw(self.matrix(name, metric), self.redraws, number)
                for number, name in enumerate(self.names)
            }
            for metric in ("tracking_rmse", "settled_rmse")
        )

    def _checked(self, agents: Mapping[str, BySeed]) -> int:
        """Number of episodes of a set, seen to be the same for every policy."""
        first: list[Record] = []
        for name, seeds in self.seeds.items():
            for policy in seeds:
                records = agents.get(name, {}).get(policy, [])
                first = first or records
                if [r["digest"] for r in records] != [r["digest"] for r in first]:
                    raise ValueError(
                        f"policies {first[0]['policy']!r} and {policy!r} did not meet the same "
                        f"episodes of {first[0]['set']!r}; delete the folder of results"
                    )
        return len(first)

    def pooled(self, name: str) -> list[Record]:
        """All records of an agent, seed by seed."""
        return [r for policy in self.seeds[name] for of in self.sets for r in of[name][policy]]

    def matrix(self, name: str, metric: str) -> FloatArray:
        """A metric of an agent, (S, N)."""
        return _column(self.pooled(name), metric).reshape(len(self.seeds[name]), -1)

    def failed(self, name: str) -> FloatArray:
        """Share of seeds that ended each episode early or with too large an error, (N,)."""
        early, success = self.matrix(name, "terminated"), self.matrix(name, "success")
        return ((early > 0.5) | (success < 0.5)).mean(axis=0)

    def anchors(self) -> tuple[str, str] | None:
        """The policies that score 0 and 1, if both are here."""
        start, ceiling = next((n for n in STARTS if n in self.names), None), self.ceiling()
        return None if start is None or ceiling is None else (start, ceiling)

    def trainings(self, name: str) -> int:
        """Seeds of an agent; 0 of a policy that is not trained."""
        seeds = self.seeds[name]
        return len(seeds) if any(SEED_MARK in policy for policy in seeds) else 0

    def score(self, name: str) -> Estimate | None:
        """Where an agent is between the anchors."""
        if (anchors := self.anchors()) is None:
            return None
        low, high, agent = (self.redrawn[key] for key in (*anchors, name))
        return stats.score(low, high, agent)

    def ceiling(self) -> str | None:
        """The agent with the smallest IQM of those that read the truth, None without one."""
        return min(self.reading_truth(), key=self.iqm, default=None)

    def reading_truth(self) -> list[str]:
        """The agents that are handed the true parameters."""
        return [n for n in self.names if any(READS_TRUTH in r for r in self.pooled(n))]

    def iqm(self, name: str) -> float:
        """IQM [m] of the tracking RMSE of an agent over seeds and episodes."""
        return float(stats.interquartile_mean(self.redrawn[name].values.ravel()))

    def summary(self, name: str) -> PolicySummary:
        """Statistics of one agent on these sets."""
        redrawn, settled, records = self.redrawn[name], self.settled[name], self.pooled(name)
        flat, after = redrawn.values.ravel(), settled.values.ravel()
        seeds = stats.fewest(redrawn)
        return PolicySummary(
            redrawn.values.shape[1],
            stats.estimate(self.iqm(name), redrawn.iqm, seeds),
            stats.estimate(float(flat.mean()), redrawn.mean, seeds),
            stats.estimate(float(stats.quantile(flat)), redrawn.quantile, seeds),
            stats.estimate(float(stats.interquartile_mean(after)), settled.iqm, seeds),
            {metric: _mean(records, metric) for metric in METRICS},
            _mean(records, "predict_time"),
            sum(record["recovery_time"] is not None for record in records),
            self.trainings(name),
            self.score(name),
            not any(BESIDE in record for record in records),
        )

    def compare(self, base: str, name: str) -> Comparison:
        """An agent against another."""
        a, b = self.redrawn[base], self.redrawn[name]
        seeds = stats.fewest(a, b)
        value = float(stats.ratio(self.iqm(base), self.iqm(name)))
        ratio = stats.estimate(value, stats.ratio(a.iqm, b.iqm), seeds)
        apart = float(a.values.mean() - b.values.mean())
        difference = stats.estimate(apart, a.mean - b.mean, seeds)
        return Comparison(
            ratio,
            difference,
            stats.improvement(b, a, self.redraws),
            bool(difference.low > 0.0 and ratio.value >= SEPARATION_RATIO),
            float((self.failed(name) * (1.0 - self.failed(base))).sum()),
            stats.enough(min(self.sizes), self.trainings(base), self.trainings(name)),
        )


def rows_of(records: Sequence[Record]) -> dict[str, Row]:
    """One Row per set, and `all sets` if there are several. Raises ValueError without a record."""
    groups: dict[str, dict[str, BySeed]] = {}  # {set: {agent: records by seed}}
    for record in records:
        agents = groups.setdefault(record["set"], {})
        seeds = agents.setdefault(agent_of(record["policy"]), {})
        seeds.setdefault(record["policy"], []).append(record)
    if not groups:
        raise ValueError("no finished episode to summarise")
    rows = {name: Row([group]) for name, group in groups.items()}
    if len(groups) > 1:
        rows[ALL_SETS] = Row(list(groups.values()))
    return rows


def summarise(records: Sequence[Record], rows: Mapping[str, Row] | None = None) -> Summary:
    """Summary of records as the runner returns them; the first agent is the baseline.

    rows: those of the records, where they are known already.
    """
    rows = rows_of(records) if rows is None else rows
    baseline = agent_of(records[0]["policy"])
    summary = Summary(baseline, {}, {}, {}, {}, {})
    for name, row in rows.items():
        summary.policies[name] = {agent: row.summary(agent) for agent in row.names}
        summary.comparisons[name] = {
            agent: row.compare(baseline, agent) for agent in row.names if agent != baseline
        }
        beliefs = {agent: summarise_beliefs(row.pooled(agent)) for agent in row.names}
        summary.identification[name] = {agent: of for agent, of in beliefs.items() if of}
        summary.nis[name] = {
            agent: mean_nis(row.pooled(agent)) for agent in summary.identification[name]
        }
        if (ceiling := row.ceiling()) is not None:
            summary.ceilings[name] = ceiling
    return summary
