"""The summary of a benchmark as tables, JSON and CSV.

Tables: every policy on every set; every policy against the baseline; what happens after abrupt
changes, if there are any; which goals are reached, if references have any; how good the estimates
are, if a policy makes any.
"""

import csv
import io
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tracked_env.benchmark import table_model as tables
from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.identification_metrics import ESTIMATION_METRICS
from tracked_env.benchmark.metrics import (
    ACTION_RATES,
    GOAL_ANGLE,
    GOAL_DISTANCE,
    METRICS,
    RECOVERED,
)
from tracked_env.benchmark.records import Record
from tracked_env.benchmark.statistics import FEW_EPISODES, FEW_SEEDS
from tracked_env.benchmark.summary import SEPARATION_RATIO, Summary
from tracked_env.benchmark.table_model import Table, between

TOO_FEW = "too few"  # in the place of a verdict, see `statistics.enough`
RECORD_COLUMNS = ("set", "policy", "episode", "seed", "digest", "ended", *METRICS, "predict_time")
Columns = dict[str, Callable[[Any], str]]


class Line(NamedTuple):
    """What one line of a table is made of."""

    set: str
    agent: str
    of: Any  # a PolicySummary, Comparison, ..
    name: str = ""  # of a parameter or filter


def _lines(by_set: Mapping[str, Mapping[str, Any]]) -> Iterator[Line]:
    return (
        Line(name, agent, of) for name, agents in by_set.items() for agent, of in agents.items()
    )


def _named_lines(by_set: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Iterator[Line]:
    return (
        Line(line.set, line.agent, of, name)
        for line in _lines(by_set)
        for name, of in line.of.items()
    )


SET_AND_POLICY: Columns = {"set": lambda line: line.set, "policy": lambda line: line.agent}


def marked(agent: str, seeds: int) -> str:
    """The name of an agent, with a star where too few seeds stand behind its intervals."""
    return f"{agent} *" if 0 < seeds <= FEW_SEEDS else agent


def action_rate(means: Mapping[str, float]) -> tuple[float, str]:
    """Action rate of an agent and its unit, of the drive that it has been on."""
    measured = [name for name in ACTION_RATES.values() if not math.isnan(means[name])]
    name = measured[0] if measured else ACTION_RATES["torque"]
    return means[name], METRICS[name].unit


def rate_unit(means: Iterable[Mapping[str, float]]) -> tuple[str, float]:
    """Unit of a column of action rates, and the factor from SI to it; means: of each row."""
    rates = [action_rate(of) for of in means]
    unit = rates[0][1]
    large = max((rate for rate, _ in rates if rate == rate), default=0.0) > 1e3
    return ("kN m/s", 1e-3) if large and unit == "N m/s" else (unit, 1.0)


def policy_table(summary: Summary) -> Table:
    """One row per set and policy."""
    lines = list(_lines(summary.policies))
    unit, factor = rate_unit(line.of.means for line in lines)
    columns: Columns = {
        "set": lambda line: line.set,
        "policy": lambda line: marked(line.agent, line.of.seeds),
        "RMSE [m]: IQM [95 %]": lambda line: between(line.of.rmse_iqm),
        "mean": lambda line: f"{line.of.rmse_mean.value:.3f}",
        "worst": lambda line: f"{line.of.rmse_worst.value:.2f}",
        "max": lambda line: f"{line.of.means['max_error']:.2f}",
        "success": lambda line: f"{line.of.means['success']:.0%}",
        "early": lambda line: f"{line.of.means['terminated']:.0%}",
        "energy [kJ]": lambda line: f"{line.of.means['energy'] / 1e3:.0f}",
        "saturated": lambda line: f"{line.of.means['saturation_share']:.1%}",
        f"action rate [{unit}]": lambda line: f"{factor * action_rate(line.of.means)[0]:.1f}",
    }
    first = next(iter(summary.policies.values()))
    legend = (
        f"{first[summary.baseline].episodes} episodes per set, the same for every policy. RMSE: "
        "distance to the reference. IQM: mean of the middle half\nof the episodes, with a "
        "bootstrap interval; worst: mean of the largest tenth. Max: largest\n"
        "distance. Early: ended before its time. All but the IQM are means over the episodes."
    )
    if any(0 < p.seeds <= FEW_SEEDS for p in first.values()):
        legend += f"\n* fewer than {FEW_SEEDS + 1} training seeds"
    rows = tables.rows_of(columns, lines)
    return Table("Errors and costs", rows, 2, [legend], (1, 0))


def comparison_table(summary: Summary) -> Table:
    """One row per set and policy but the baseline."""

    def score(line: Line) -> str:
        estimate = summary.policies[line.set][line.agent].score
        return "-" if estimate is None else between(estimate, 2)

    base = summary.baseline
    columns: Columns = {
        **SET_AND_POLICY,
        "RMSE ratio": lambda line: between(line.of.ratio, 1),
        f"{base} - policy [m]": lambda line: between(line.of.difference),
        "clearly worse": lambda line: (
            TOO_FEW if not line.of.enough else "yes" if line.of.worse else "NO"
        ),
        "P(better)": lambda line: f"{line.of.improvement.value:.0%}",
        "fails alone": lambda line: f"{line.of.fails_alone:.3g}",
        "score": score,
    }
    rule = (
        f"RMSE ratio: IQM of {base} over that of the policy. {base} - policy: mean of the paired "
        f"differences. Intervals: 95 %.\n{base} is clearly worse when the interval of the "
        f"difference lies above 0 and the ratio is at least {SEPARATION_RATIO}.\nP(better): part "
        "of the episodes in which the policy has the smaller RMSE. Fails alone: episodes that "
        f"{base}\nmasters and the policy does not. {TOO_FEW.capitalize()}: no verdict below "
        f"{FEW_EPISODES + 1} episodes and {FEW_SEEDS + 1} seeds.\nScore: 0 as integral (without "
        "it nominal or uc), 1 as the ceiling, the best policy that knows the truth."
    )
    rows = tables.rows_of(columns, _lines(summary.comparisons))
    return Table(f"Compared with {base}", rows, 2, [rule], (1, 4))


def recovery_table(summary: Summary) -> Table:
    """One row per set with abrupt changes and policy."""
    columns: Columns = {
        **SET_AND_POLICY,
        "episodes with a change": lambda line: f"{line.of.changed}",
        "recovery [s]": lambda line: f"{line.of.means['recovery_time']:.1f}",
        "peak after it [m]": lambda line: f"{line.of.means['peak_after_change']:.2f}",
    }
    legend = (
        "After the first abrupt change of the true parameters: time until the distance stays "
        f"below {RECOVERED:g} contact lengths, and its\nlargest value; means over the episodes "
        "with a change."
    )
    rows = tables.rows_of(columns, (line for line in _lines(summary.policies) if line.of.changed))
    return Table("After abrupt changes", rows, 2, [legend], (1, 0))


GOAL_LEGEND = (
    f"Reached: within {GOAL_DISTANCE:.3g} contact lengths and {GOAL_ANGLE:g} rad of the goal. Time "
    "and energy until then,\nor of the whole episode where it was not; means over the episodes."
)
GOAL_COLUMNS: Columns = {  # from the means of all metrics
    "goals reached": lambda means: f"{means['goal_reached']:.0%}",
    "time [s]": lambda means: f"{means['goal_time']:.1f}",
    "energy [kJ]": lambda means: f"{means['goal_energy'] / 1e3:.2f}",
    "miss at the end [m]": lambda means: f"{means['goal_miss']:.3f}",
}


def has_goal(means: Mapping[str, float]) -> bool:
    """Whether any episode had a goal; means: of all metrics."""
    return not math.isnan(means["goal_reached"])


def _of_means(cell: Callable[[Any], str]) -> Callable[[Any], str]:
    return lambda line: cell(line.of.means)


def goal_table(summary: Summary) -> Table:
    """One row per set with goals and policy."""
    columns: Columns = {
        **SET_AND_POLICY,
        **{name: _of_means(cell) for name, cell in GOAL_COLUMNS.items()},
    }
    lines = (line for line in _lines(summary.policies) if has_goal(line.of.means))
    return Table("Goals", tables.rows_of(columns, lines), 2, [GOAL_LEGEND], (1, 0))


def _share(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1%}" if value < 10.0 else ">1000%"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"


def _time(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1f}" if math.isfinite(value) else "never"


def identification_table(summary: Summary) -> Table:
    """One row per set, policy and estimated parameter."""
    columns: Columns = {
        **SET_AND_POLICY,
        "parameter": lambda line: line.name,
        "error settled": lambda line: _share(line.of["settled_relative_rmse"]),
        "settling [s]": lambda line: _time(line.of["settling_time"]),
        "settles": lambda line: _share(line.of["settled"]),
        "NEES": lambda line: _number(line.of["nees"]),
        "in 3 sigma": lambda line: _share(line.of["in_three_sigma"]),
        "NEES apart": lambda line: _number(line.of["nees_apart"]),
        "in 3 sigma apart": lambda line: _share(line.of["in_three_sigma_apart"]),
        "claimed sigma": lambda line: _share(line.of["claimed_deviation"]),
        "excited": lambda line: _share(line.of["excited"]),
        "diverged": lambda line: _share(line.of["diverged"]),
    }
    legend = (
        "Error settled: median relative RMS error after 5 s. Settling: median time after the last "
        "abrupt change until\nwithin 10 % for good. NEES: 1 expected; in 3 sigma: 99.7 % expected; "
        "apart: without the first second after an abrupt\nchange. Claimed sigma: median of the "
        "claimed deviation over the true value."
    )
    rows = tables.rows_of(columns, _named_lines(summary.identification))
    return Table("Estimates", rows, 3, [legend], (1, 0))


def nis_table(summary: Summary) -> Table:
    """One row per set, policy and filter."""
    columns: Columns = {
        **SET_AND_POLICY,
        "filter": lambda line: line.name,
        "mean NIS": lambda line: _number(line.of),
    }
    legend = "Mean normalised innovation squared; the dimension of the innovation is expected."
    rows = tables.rows_of(columns, _named_lines(summary.nis))
    return Table("Innovations of the filters", rows, 3, [legend], (1, 0))


TABLES = (
    policy_table,
    comparison_table,
    recovery_table,
    goal_table,
    identification_table,
    nis_table,
)


def tables_of(summary: Summary) -> list[Table]:
    """The tables that are not empty."""
    return [table for table in (make(summary) for make in TABLES) if len(table.rows) > 1]


def terminal(summary: Summary, width: int = 80) -> str:
    """The whole summary as plain text of at most `width` columns; wider tables are folded."""
    return tables.terminal(tables_of(summary), width)


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
    write_atomically(folder / "summary.md", tables.markdown(tables_of(summary)).encode())
