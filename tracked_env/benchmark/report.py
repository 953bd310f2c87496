"""The summary of a benchmark as terminal table, Markdown, JSON and CSV.

Tables: every policy on every set; every policy against the baseline; what happens after abrupt
changes, if there are any; which goals are reached, if references have any; how good the estimates
are, if a policy makes any.
"""

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tracked_env.benchmark.identification_metrics import ESTIMATION_METRICS
from tracked_env.benchmark.metrics import GOAL_ANGLE, GOAL_DISTANCE, METRICS, OF_GOALS, RECOVERED
from tracked_env.benchmark.reliability import FEW_EPISODES, FEW_SEEDS
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import Record, write_atomically
from tracked_env.benchmark.summary import (
    ALL_SETS,
    SEPARATION_RATIO,
    Comparison,
    Summary,
    action_rate,
    summarise,
)
from tracked_env.benchmark.text_tables import aligned, escaped_lines, folded, markdown_rows

__all__ = [
    "ALL_SETS", "SEPARATION_RATIO", "Comparison", "Summary", "aligned", "markdown",
    "markdown_rows", "summarise", "terminal", "write",
]  # fmt: skip

TOO_FEW = "too few"  # in the place of a verdict, see `reliability.enough`
GOAL_COLUMNS = ("goals reached", "time [s]", "energy [kJ]", "miss at the end [m]")
RECORD_COLUMNS = ("set", "policy", "episode", "seed", "digest", "ended", *METRICS, "predict_time")


def _interval(e: Estimate, digits: int = 3) -> str:
    return f"{e.value:.{digits}f} [{e.low:.{digits}f}, {e.high:.{digits}f}]"


def marked(agent: str, seeds: int) -> str:
    """The name of an agent, with a star where too few seeds stand behind its intervals."""
    return f"{agent} *" if 0 < seeds <= FEW_SEEDS else agent


def rate_unit(means: Iterable[Mapping[str, float]]) -> tuple[str, float]:
    """Unit of a column of action rates, and the factor from SI to it; means: of each row."""
    found = [action_rate(of) for of in means]
    unit = found[0][1]
    large = max((rate for rate, _ in found if rate == rate), default=0.0) > 1e3
    return ("kN m/s", 1e-3) if large and unit == "N m/s" else (unit, 1.0)


def policy_table(summary: Summary) -> list[list[str]]:
    """Rows of cells, the header first: one row per set and policy."""
    unit, factor = rate_unit(p.means for by in summary.policies.values() for p in by.values())
    rows = [
        ["set", "policy", "RMSE [m]: IQM [95 %]", "mean", "worst", "max", "success", "early",
         "energy [kJ]", "saturated", f"action rate [{unit}]"],
    ]  # fmt: skip
    for name, by_policy in summary.policies.items():
        for policy, p in by_policy.items():
            m = p.means
            rows.append(
                [name, marked(policy, p.seeds), _interval(p.rmse_iqm), f"{p.rmse_mean.value:.3f}",
                 f"{p.rmse_worst.value:.2f}",
                 f"{m['max_error']:.2f}", f"{m['success']:.0%}", f"{m['terminated']:.0%}",
                 f"{m['energy'] / 1e3:.0f}", f"{m['saturation_share']:.1%}",
                 f"{factor * action_rate(m)[0]:.1f}"]
            )  # fmt: skip
    return rows


def comparison_table(summary: Summary) -> list[list[str]]:
    """Rows of cells, the header first: one row per set and policy but the baseline."""
    base = summary.baseline
    rows = [
        ["set", "policy", "RMSE ratio", f"{base} - policy [m]", "clearly worse",
         "P(better)", "fails alone", "score"],
    ]  # fmt: skip
    for name, by_policy in summary.comparisons.items():
        for policy, c in by_policy.items():
            score = summary.policies[name][policy].score
            rows.append(
                [name, policy, _interval(c.ratio, 1), _interval(c.difference),
                 ("yes" if c.worse else "NO") if c.enough else TOO_FEW,
                 f"{c.improvement.value:.0%}", f"{c.fails_alone:.3g}",
                 "-" if score is None else _interval(score, 2)]
            )  # fmt: skip
    return rows


def recovery_table(summary: Summary) -> list[list[str]]:
    """Rows of cells, the header first: one row per set with abrupt changes and policy."""
    rows = [["set", "policy", "episodes with a change", "recovery [s]", "peak after it [m]"]]
    for name, by_policy in summary.policies.items():
        for policy, p in by_policy.items():
            if p.changed:
                recovery, peak = (p.means[m] for m in ("recovery_time", "peak_after_change"))
                rows.append([name, policy, f"{p.changed}", f"{recovery:.1f}", f"{peak:.2f}"])
    return rows


def goal_cells(means: Mapping[str, float]) -> list[str]:
    """Cells of GOAL_COLUMNS."""
    reached, time, energy, miss = (means[metric] for metric in OF_GOALS)
    return [f"{reached:.0%}", f"{time:.1f}", f"{energy / 1e3:.2f}", f"{miss:.3f}"]


def goal_table(summary: Summary) -> list[list[str]]:
    """Rows of cells, the header first: one row per set with goals and policy."""
    return [["set", "policy", *GOAL_COLUMNS]] + [
        [name, policy, *goal_cells(p.means)]
        for name, by_policy in summary.policies.items()
        for policy, p in by_policy.items()
        if not math.isnan(p.means["goal_reached"])
    ]


def _share(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1%}" if value < 10.0 else ">1000%"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"


def identification_table(summary: Summary) -> list[list[str]]:
    """Rows of cells, the header first: one row per set, policy and estimated parameter."""
    rows = [
        ["set", "policy", "parameter", "error settled", "settling [s]", "settles", "NEES",
         "in 3 sigma", "NEES apart", "in 3 sigma apart", "claimed sigma", "excited", "diverged"],
    ]  # fmt: skip
    for name, by_policy in summary.identification.items():
        for policy, by_parameter in by_policy.items():
            for parameter, e in by_parameter.items():
                time = f"{e.settling_time:.1f}" if math.isfinite(e.settling_time) else "never"
                rows.append(
                    [name, policy, parameter, _share(e.settled_relative_rmse),
                     "-" if math.isnan(e.settling_time) else time, _share(e.settled),
                     _number(e.nees), _share(e.in_three_sigma), _number(e.nees_apart),
                     _share(e.in_three_sigma_apart), _share(e.claimed_deviation),
                     _share(e.excited), _share(e.diverged)]
                )  # fmt: skip
    return rows


def nis_table(summary: Summary) -> list[list[str]]:
    """Rows of cells, the header first: one row per set, policy and filter."""
    return [["set", "policy", "filter", "mean NIS"]] + [
        [name, policy, of, _number(value)]
        for name, by_policy in summary.nis.items()
        for policy, by_filter in by_policy.items()
        for of, value in by_filter.items()
    ]


def rule(summary: Summary) -> str:
    """The sentences that explain the columns of the comparison."""
    base = summary.baseline
    return (
        f"RMSE ratio: IQM of {base} over that of the policy. {base} - policy: mean of the paired "
        f"differences. Intervals: 95 %.\n{base} is clearly worse when the interval of the "
        f"difference lies above 0 and the ratio is at least {SEPARATION_RATIO}.\nP(better): part "
        "of the episodes in which the policy has the smaller RMSE. Fails alone: episodes that "
        f"{base}\nmasters and the policy does not. {TOO_FEW.capitalize()}: no verdict below "
        f"{FEW_EPISODES + 1} episodes and {FEW_SEEDS + 1} seeds.\nScore: 0 as integral (without "
        "it nominal or uc), 1 as the ceiling, the best policy that knows the truth."
    )


def legend(summary: Summary) -> str:
    """Meaning of the numbers of the first table."""
    first = next(iter(summary.policies.values()))
    few = any(0 < p.seeds <= FEW_SEEDS for p in first.values())
    return (
        f"{first[summary.baseline].episodes} episodes per set, the same for every policy. RMSE: "
        "distance to the reference. IQM: mean of the middle half\nof the episodes, with a "
        "bootstrap interval; worst: mean of the largest tenth. Max: largest\n"
        "distance. Early: ended before its time. All but the IQM are means over the episodes."
        + (f"\n* fewer than {FEW_SEEDS + 1} training seeds" if few else "")
    )


RECOVERY_LEGEND = (
    "After the first abrupt change of the true parameters: time until the distance stays below "
    f"{RECOVERED:g} contact lengths, and its\nlargest value; means over the episodes with a change."
)
GOAL_LEGEND = (
    f"Reached: within {GOAL_DISTANCE:.3g} contact lengths and {GOAL_ANGLE:g} rad of the goal. Time "
    "and energy until then,\nor of the whole episode where it was not; means over the episodes."
)
IDENTIFICATION_LEGEND = (
    "Error settled: median relative RMS error after 5 s. Settling: median time after the last "
    "abrupt change until\nwithin 10 % for good. NEES: 1 expected; in 3 sigma: 99.7 % expected; "
    "apart: without the first second after an abrupt\nchange. Claimed sigma: median of the "
    "claimed deviation over the true value."
)


def parts(summary: Summary) -> list[tuple[list[list[str]], int, str]]:
    """Tables that are not empty, how many of their columns are names, their legends."""
    tables = [
        (policy_table(summary), 2, legend(summary)),
        (comparison_table(summary), 2, rule(summary)),
        (recovery_table(summary), 2, RECOVERY_LEGEND),
        (goal_table(summary), 2, GOAL_LEGEND),
        (identification_table(summary), 3, IDENTIFICATION_LEGEND),
        (
            nis_table(summary),
            3,
            "Mean normalised innovation squared; the dimension of the innovation is expected.",
        ),
    ]
    return [table for table in tables if len(table[0]) > 1]


def terminal(summary: Summary, width: int = 80) -> str:
    """The whole summary as plain text of at most `width` columns; wider tables are folded."""
    return "\n\n".join(
        f"{aligned(rows, names, width)}\n\n{folded(text, width)}"
        for rows, names, text in parts(summary)
    )


def markdown(summary: Summary) -> str:
    """The whole summary as Markdown."""
    return (
        "\n\n".join(
            f"{markdown_rows(rows, names)}\n\n{escaped_lines(text)}"
            for rows, names, text in parts(summary)
        )
        + "\n"
    )


def plain(value: Any) -> Any:
    """Named tuples as dicts, all the way down, for JSON; what is not finite is None."""
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return {name: plain(part) for name, part in zip(value._fields, value, strict=True)}
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def flat(record: Record) -> Record:
    """A record with its estimates as columns `parameter.metric` and `nis.filter`, for CSV."""
    columns = {k: v for k, v in record.items() if k not in ("identification", "nis")}
    for name, values in record.get("identification", {}).items():
        columns.update({f"{name}.{metric}": value for metric, value in values.items()})
    columns.update({f"nis.{name}": value for name, value in record.get("nis", {}).items()})
    return columns


def write(
    folder: Path, header: Mapping[str, Any], records: Sequence[Record], summary: Summary
) -> None:
    """Write results.json, episodes.csv and summary.md into `folder`."""
    units = {name: metric.unit for name, metric in {**METRICS, **ESTIMATION_METRICS}.items()}
    document = {**header, "units": units, "summary": plain(summary), "episodes": list(records)}
    write_atomically(folder / "results.json", (json.dumps(document, indent=1) + "\n").encode())
    text = io.StringIO()
    rows = [flat(record) for record in records]
    columns = dict.fromkeys([*RECORD_COLUMNS, *(name for row in rows for name in row)])
    writer = csv.DictWriter(text, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(folder / "episodes.csv", text.getvalue().encode())
    write_atomically(folder / "summary.md", markdown(summary).encode())
