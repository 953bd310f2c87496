"""From records to a summary, and the summary as terminal table, Markdown, JSON and CSV.

Per set and policy: interquartile mean (IQM) and mean of the tracking RMSE over the episodes, each
with a 95 % bootstrap interval, and means of the other metrics. Every policy is then compared
with the first one, the baseline, on the same episodes:
    ratio        IQM of the baseline's RMSE over the policy's
    difference   mean over the episodes of (baseline's - policy's RMSE) [m]
    worse        the baseline is clearly worse: the interval of the difference lies above 0 and
                 the ratio is at least SEPARATION_RATIO. With nominal as the baseline, a set
                 separates when this holds for the oracle.
`all sets` pools the episodes of all sets, redrawn set by set (stratified).
"""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.metrics import METRICS
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import Record, write_atomically

SEPARATION_RATIO = 1.2  # [-] of the interquartile means
ALL_SETS = "all sets"
RECORD_COLUMNS = ("set", "policy", "episode", "seed", "digest", "ended", *METRICS, "predict_time")


class PolicySummary(NamedTuple):
    """One policy on one set."""

    episodes: int
    rmse_iqm: Estimate  # [m]
    rmse_mean: Estimate  # [m]
    means: dict[str, float]  # of every metric, in its unit
    predict_time: float  # [s] per vehicle and step


class Comparison(NamedTuple):
    """The baseline against one policy on one set."""

    ratio: Estimate  # [-]
    difference: Estimate  # [m]
    worse_share: float  # [-] of the episodes in which the baseline is worse
    worse: bool  # clearly, see above


class Summary(NamedTuple):
    """What a benchmark says: {set: {policy: ...}}, sets and policies in their order."""

    baseline: str
    policies: dict[str, dict[str, PolicySummary]]
    comparisons: dict[str, dict[str, Comparison]]


def _column(records: Sequence[Record], name: str) -> NDArray[np.float64]:
    return np.array([record[name] for record in records], dtype=np.float64)


def _policy_summary(strata: Sequence[Sequence[Record]]) -> PolicySummary:
    rmse = [_column(records, "tracking_rmse") for records in strata]
    pooled = [record for records in strata for record in records]
    return PolicySummary(
        len(pooled),
        stats.estimate(rmse),
        stats.estimate(rmse, stats.mean),
        {name: float(_column(pooled, name).mean()) for name in METRICS},
        float(_column(pooled, "predict_time").mean()),
    )


def compare(baseline: Sequence[Sequence[Record]], other: Sequence[Sequence[Record]]) -> Comparison:
    """Baseline against another policy; strata of records of the same episodes.

    Raises ValueError when the episodes differ.
    """
    for first, second in zip(baseline, other, strict=True):
        if [r["digest"] for r in first] != [r["digest"] for r in second]:
            raise ValueError(
                f"policies {first[0]['policy']!r} and {second[0]['policy']!r} did not meet the "
                f"same episodes of {first[0]['set']!r}; delete the folder of results"
            )
    columns = [[_column(records, "tracking_rmse") for records in s] for s in (baseline, other)]
    pairs = stats.paired(*columns)
    ratio = stats.estimate(pairs, stats.ratio_of_means)
    difference = stats.estimate(pairs, stats.mean_difference)
    pooled = np.concatenate(pairs)
    share = float(np.mean(pooled[:, 0] > pooled[:, 1]))
    clearly = difference.low > 0.0 and ratio.value >= SEPARATION_RATIO
    return Comparison(ratio, difference, share, bool(clearly))


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
    for name, strata in rows.items():
        names = list(strata[0])
        by_policy = {policy: [stratum[policy] for stratum in strata] for policy in names}
        policies[name] = {policy: _policy_summary(by_policy[policy]) for policy in names}
        comparisons[name] = {
            policy: compare(by_policy[baseline], by_policy[policy]) for policy in names[1:]
        }
    return Summary(baseline, policies, comparisons)


# --- tables ---------------------------------------------------------------------------------
def _interval(e: Estimate, digits: int = 3) -> str:
    return f"{e.value:.{digits}f} [{e.low:.{digits}f}, {e.high:.{digits}f}]"


def policy_table(summary: Summary) -> list[list[str]]:
    """Rows of cells, the header first: one row per set and policy."""
    rows = [
        ["set", "policy", "RMSE [m]: IQM [95 %]", "mean", "max error", "success", "ended early",
         "energy [kJ]", "saturated", "chatter [kN m/s]"],
    ]  # fmt: skip
    for name, by_policy in summary.policies.items():
        for policy, p in by_policy.items():
            m = p.means
            rows.append(
                [name, policy, _interval(p.rmse_iqm), f"{p.rmse_mean.value:.3f}",
                 f"{m['max_error']:.2f}", f"{m['success']:.0%}", f"{m['terminated']:.0%}",
                 f"{m['energy'] / 1e3:.0f}", f"{m['saturation_share']:.1%}",
                 f"{m['torque_chatter'] / 1e3:.1f}"]
            )  # fmt: skip
    return rows


def comparison_table(summary: Summary) -> list[list[str]]:
    """Rows of cells, the header first: one row per set and policy but the baseline."""
    base = summary.baseline
    rows = [
        ["set", "policy", f"RMSE {base} / policy", f"{base} - policy [m]", f"{base} worse in",
         f"{base} clearly worse"],
    ]  # fmt: skip
    for name, by_policy in summary.comparisons.items():
        for policy, c in by_policy.items():
            rows.append(
                [name, policy, _interval(c.ratio, 1), _interval(c.difference),
                 f"{c.worse_share:.0%}", "yes" if c.worse else "NO"]
            )  # fmt: skip
    return rows


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """A table for the terminal: first two columns left, the others right; repeated sets blank."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    before = ""
    for number, row in enumerate(rows):
        cells = [("" if row[0] == before else row[0]), *row[1:]]
        before = row[0]
        parts = [c.ljust(w) for c, w in zip(cells[:2], widths[:2], strict=True)]
        parts += [c.rjust(w) for c, w in zip(cells[2:], widths[2:], strict=True)]
        lines.append("  ".join(parts).rstrip())
        if number == 0:
            lines.append("-" * len(lines[0]))
    return "\n".join(lines)


def markdown_rows(rows: Sequence[Sequence[str]]) -> str:
    """The same as a Markdown table."""
    head, *body = rows
    rule = ["--" if i < 2 else "--:" for i in range(len(head))]
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, rule, *body])


def rule(summary: Summary) -> str:
    """The sentence that explains the last column."""
    return (
        f"Ratio of the IQMs and mean of the paired differences, with 95 % intervals. "
        f"{summary.baseline} is clearly worse when the\ninterval of the difference lies above 0 "
        f"and the ratio is at least {SEPARATION_RATIO}."
    )


def legend(summary: Summary) -> str:
    """What the numbers of the first table are."""
    count = next(iter(summary.policies.values()))[summary.baseline].episodes
    return (
        f"{count} episodes per set, the same for every policy. RMSE: distance to the reference. "
        "IQM: mean of the middle half\nof the episodes, with a percentile bootstrap interval; all "
        "other columns are means over the episodes."
    )


def terminal(summary: Summary) -> str:
    """The whole summary as plain text."""
    parts = [aligned(policy_table(summary)), legend(summary)]
    if any(summary.comparisons.values()):
        parts += [aligned(comparison_table(summary)), rule(summary)]
    return "\n\n".join(parts)


def markdown(summary: Summary) -> str:
    """The whole summary as Markdown."""
    parts = [markdown_rows(policy_table(summary)), legend(summary)]
    if any(summary.comparisons.values()):
        parts += [markdown_rows(comparison_table(summary)), rule(summary)]
    return "\n\n".join(parts) + "\n"


def plain(value: Any) -> Any:
    """Named tuples as dicts, all the way down, for JSON."""
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return {name: plain(part) for name, part in zip(value._fields, value, strict=True)}
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    return value


def write(
    folder: Path, header: Mapping[str, Any], records: Sequence[Record], summary: Summary
) -> None:
    """Write results.json, episodes.csv and summary.md into `folder`."""
    units = {name: metric.unit for name, metric in METRICS.items()}
    document = {**header, "units": units, "summary": plain(summary), "episodes": list(records)}
    write_atomically(folder / "results.json", (json.dumps(document, indent=1) + "\n").encode())
    text = io.StringIO()
    writer = csv.DictWriter(text, RECORD_COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    write_atomically(folder / "episodes.csv", text.getvalue().encode())
    write_atomically(folder / "summary.md", markdown(summary).encode())
