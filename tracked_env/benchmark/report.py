"""The summary and the leaderboard as tables, JSON, CSV, and one HTML page.

Of the summary: every policy on every set; every policy against the baseline; which goals are
reached, if references have any; how good the estimates are, if a policy makes any. Of the
leaderboard: the order; every agent on every set; scores and costs.
"""

import csv
import io
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from tracked_env.benchmark import leaderboard as lb
from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark import table_model as tables
from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.identification_metrics import ESTIMATION_METRICS
from tracked_env.benchmark.leaderboard import TOO_FEW, Leaderboard, Place, verdict
from tracked_env.benchmark.metrics import ACTION_RATES, GOAL_ANGLE, GOAL_DISTANCE, METRICS
from tracked_env.benchmark.statistics import FEW_EPISODES, FEW_SEEDS, Estimate
from tracked_env.benchmark.store import Record
from tracked_env.benchmark.summary import SEPARATION_RATIO, Summary
from tracked_env.benchmark.table_model import Cell, Drawing, Section, Table, between

RECORD_COLUMNS = ("set", "policy", "episode", "seed", "digest", "ended", *METRICS, "predict_time")
FEW_LEGEND = f"\n* fewer than {FEW_SEEDS + 1} training seeds"
FILES = {
    "results.json": "configuration, versions, units, all intervals and all records",
    "episodes.csv": "one row per set, policy and episode",
    "leaderboard.json": "the leaderboard as numbers",
    "summary.md": "the tables of every set as text",
}
Columns = dict[str, Callable[[Any], str | Cell]]


class Line(NamedTuple):
    """What one line of a table is made of."""

    set: str
    agent: str
    of: Any  # a PolicySummary, Comparison, ..
    name: str = ""  # of a parameter or filter


def _lines(by_set: Mapping[str, Mapping[str, Any]]) -> list[Line]:
    return [
        Line(name, agent, of) for name, agents in by_set.items() for agent, of in agents.items()
    ]


def _named_lines(by_set: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> list[Line]:
    return [
        line._replace(of=of, name=name) for line in _lines(by_set) for name, of in line.of.items()
    ]


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


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else f"{value:{form}}"


def policy_table(summary: Summary) -> Table:
    """One row per set and policy."""
    lines = _lines(summary.policies)
    unit, factor = rate_unit(line.of.means for line in lines)
    columns: Columns = {
        "set": lambda line: line.set,
        "policy": lambda line: marked(line.agent, line.of.seeds),
        "RMSE [m]: IQM [95 %]": lambda line: between(line.of.rmse_iqm),
        "mean": lambda line: f"{line.of.rmse_mean.value:.3f}",
        "90 %": lambda line: f"{line.of.rmse_quantile.value:.3f}",
        "max": lambda line: f"{line.of.means['max_error']:.2f}",
        "success": lambda line: f"{line.of.means['success']:.0%}",
        "early": lambda line: f"{line.of.means['terminated']:.0%}",
        "recovery [s]": lambda line: _number(line.of.means["recovery_time"], ".1f"),
        "energy [kJ]": lambda line: f"{line.of.means['energy'] / 1e3:.0f}",
        "saturated": lambda line: f"{line.of.means['saturation_share']:.1%}",
        f"action rate [{unit}]": lambda line: f"{factor * action_rate(line.of.means)[0]:.1f}",
    }
    first = next(iter(summary.policies.values()))
    legend = (
        f"{first[summary.baseline].episodes} episodes per set, the same for every policy. RMSE: "
        "distance to the reference. IQM: mean of the middle half of the episodes, with a "
        "bootstrap interval; 90 %: its quantile. Max: largest distance. Early: "
        "ended before its time. Recovery: after the first abrupt change. All but the IQM are "
        "means over the episodes."
    )
    if any(0 < p.seeds <= FEW_SEEDS for p in first.values()):
        legend += FEW_LEGEND
    return Table("Errors and costs", tables.rows_of(columns, lines), 2, [legend])


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
        f"differences. Intervals: 95 %. {base} is clearly worse when the interval of the "
        f"difference lies above 0 and the ratio is at least {SEPARATION_RATIO}. P(better): part of "
        f"the episodes in which the policy has the smaller RMSE. Fails alone: episodes that {base} "
        f"masters and the policy does not. {TOO_FEW.capitalize()}: no verdict below "
        f"{FEW_EPISODES + 1} episodes and {FEW_SEEDS + 1} seeds. Score: 0 as integral (without it "
        "nominal or uc), 1 as the ceiling, the best policy that knows the truth."
    )
    rows = tables.rows_of(columns, _lines(summary.comparisons))
    return Table(f"Compared with {base}", rows, 2, [rule])


def goal_table(summary: Summary) -> Table:
    """One row per set with goals and policy."""
    columns: Columns = {
        **SET_AND_POLICY,
        "goals reached": lambda line: f"{line.of.means['goal_reached']:.0%}",
        "time [s]": lambda line: f"{line.of.means['goal_time']:.1f}",
        "energy [kJ]": lambda line: f"{line.of.means['goal_energy'] / 1e3:.2f}",
        "miss at the end [m]": lambda line: f"{line.of.means['goal_miss']:.3f}",
    }
    lines = (x for x in _lines(summary.policies) if not math.isnan(x.of.means["goal_reached"]))
    legend = (
        f"Reached: within {GOAL_DISTANCE:.3g} contact lengths and {GOAL_ANGLE:g} rad of the goal. "
        "Time and energy until then, or of the whole episode where it was not; means over the "
        "episodes."
    )
    return Table("Goals", tables.rows_of(columns, lines), 2, [legend])


def _share(value: float) -> str:
    return _number(value, ".1%") if not value >= 10.0 else ">1000%"


def identification_table(summary: Summary) -> Table:
    """One row per set, policy and estimated parameter."""
    columns: Columns = {
        **SET_AND_POLICY,
        "parameter": lambda line: line.name,
        "error settled": lambda line: _share(line.of["settled_relative_rmse"]),
        "settling [s]": lambda line: (
            "never"
            if line.of["settling_time"] == math.inf
            else _number(line.of["settling_time"], ".1f")
        ),
        "settles": lambda line: _share(line.of["settled"]),
        "NEES": lambda line: _number(line.of["nees"], ".3g"),
        "in 3 sigma": lambda line: _share(line.of["in_three_sigma"]),
        "NEES apart": lambda line: _number(line.of["nees_apart"], ".3g"),
        "in 3 sigma apart": lambda line: _share(line.of["in_three_sigma_apart"]),
        "claimed sigma": lambda line: _share(line.of["claimed_deviation"]),
        "excited": lambda line: _share(line.of["excited"]),
        "diverged": lambda line: _share(line.of["diverged"]),
    }
    legend = (
        "Error settled: median relative RMS error after 5 s. Settling: median time after the last "
        "abrupt change until within 10 % for good. NEES: 1 expected; in 3 sigma: 99.7 % expected; "
        "apart: without the first second after an abrupt change. Claimed sigma: median of the "
        "claimed deviation over the true value."
    )
    rows = tables.rows_of(columns, _named_lines(summary.identification))
    return Table("Estimates", rows, 3, [legend])


def nis_table(summary: Summary) -> Table:
    """One row per set, policy and filter."""
    columns: Columns = {
        **SET_AND_POLICY,
        "filter": lambda line: line.name,
        "mean NIS": lambda line: _number(line.of, ".3g"),
    }
    legend = "Mean normalised innovation squared; the dimension of the innovation is expected."
    rows = tables.rows_of(columns, _named_lines(summary.nis))
    return Table("Innovations of the filters", rows, 3, [legend])


def main_table(board: Leaderboard) -> Table:
    """One row per agent, the best first, by what leads the leaderboard."""
    than, places = board.reference, board.places

    def ratio(name: str) -> Callable[[Place], Cell]:
        of = attrgetter(f"relative.{name}")
        return lambda place: Cell(between(of(place), 2, place.seeds), of(place).value)

    columns: Columns = {
        "agent": lambda p: marked(p.agent, p.seeds),
        f"than {than}": verdict,
        "seeds": lambda p: f"{p.seeds or '-'}",
        f"error / {than}": ratio("whole"),
        "mean": ratio("mean"),
        "90 % quantile": ratio("quantile"),
        "failures": lambda p: f"{1.0 - p.overall.means['success']:.1%}",
        "sets redrawn": ratio("sets_drawn"),
        "after 5 s": ratio("settled"),
        "than it after 5 s": lambda p: verdict(p, settled=True),
        "worst set": lambda p: (
            "-" if p.against is None else f"{p.relative.worst:.3g} {p.relative.worst_set}"
        ),
    }
    notes = [
        f"Error / {than}: geometric mean over the sets of the IQM of the RMSE over that of {than}, "
        "of whole episodes and after 5 s, without the start, which lies off the path; mean and "
        "90 % quantile: the same of these statistics in the place of the IQM. A lost episode "
        "counts with its error at the limit. Failures: episodes that end early or without success. "
        "Worst set: the largest ratio of the IQMs of one set.",
        "Intervals: 95 %, seeds and episodes redrawn, in all sets together: what is so on these "
        "sets. Sets redrawn: the error with the sets redrawn as well: what is so on sets like "
        f"these. Than {than}: whether the error differs from 1 on these sets; all verdicts of this "
        "table together err in at most 5 % of such tables (Holm's correction). 'Loses' a set: "
        f"under half of its episodes succeed, and not so for {than}; no verdict ({TOO_FEW}) below "
        f"{FEW_EPISODES + 1} episodes of a set and {FEW_SEEDS + 1} seeds.",
    ]
    if any(0 < place.seeds <= FEW_SEEDS for place in places):
        notes[-1] += FEW_LEGEND
    taus = ", ".join(f"{name} {tau:.2f}" for name, tau in board.agreement.items() if tau == tau)
    if taus:
        notes.append(f"Kendall's tau of this order and that by another statistic:\n{taus}.")
    rows = tables.rows_of(columns, places)
    return Table(f"Agents by their error over that of {than}", rows, 2, notes)


def set_cell(rmse: Estimate, ratio: Estimate, seeds: int) -> str:
    """An agent on one set, as text: IQM of its RMSE, and its ratio to that of the reference."""
    return f"{rmse.value:.3f} m: {between(ratio, 2, seeds)}"


def _set_cell(place: Place, name: str) -> Cell:
    """Error in one set and its ratio, and on a page what the ratio says."""
    ratio = place.relative.by_set[name]
    enough = stats.enough(place.relative.episodes, place.seeds)
    word = "reference" if place.against is None else lb.judgement(ratio) if enough else TOO_FEW
    text = set_cell(place.rmse[name], ratio, place.seeds)
    return Cell(text, ratio.value, "heat", (word,), tables.colour(ratio.value))


def set_table(board: Leaderboard) -> Table:
    """Error of every agent over that of the reference on every set."""
    head: list[str | Cell] = ["agent", f"than {board.reference}", *board.sets]
    body: list[list[str | Cell]] = [
        [p.agent, verdict(p), *(_set_cell(p, name) for name in board.sets)] for p in board.places
    ]
    note = (
        f"IQM of the RMSE, and this over that of {board.reference} with its 95 % interval; on the "
        "page what each interval says by itself, without a correction for their number. Blue: a "
        f"smaller error than the reference; red: a larger one; white: 1. No verdict ({TOO_FEW}) "
        f"below {FEW_EPISODES + 1} episodes or {FEW_SEEDS + 1} seeds."
    )
    return Table("Error of every agent on every set", [head, *body], 2, [note])


def cost_table(board: Leaderboard) -> Table:
    """Scores, errors in metres and costs over all sets; times of a call where one was measured."""
    calls = ("1 vehicle: median [us]", "median"), ("1 vehicle: P99 [us]", "p99")
    measured = any(place.call for place in board.places)

    def call(place: Place, field: str) -> str:
        return "-" if place.call is None else f"{getattr(place.call, field) * 1e6:.1f}"

    unit, factor = rate_unit(place.overall.means for place in board.places)
    columns: Columns = {
        "agent": lambda p: p.agent,
        "score": lambda p: "-" if p.overall.score is None else between(p.overall.score, 3, p.seeds),
        "RMSE [m]: IQM [95 %]": lambda p: between(p.overall.rmse_iqm, 3, p.seeds),
        "after 5 s": lambda p: f"{p.overall.settled_iqm.value:.3f}",
        "P(better)": lambda p: "-" if p.against is None else f"{p.against.improvement.value:.0%}",
        "ended early": lambda p: f"{p.overall.means['terminated']:.1%}",
        "peak [m]": lambda p: _number(p.overall.means["peak_after_change"], ".2f"),
        "energy [kJ]": lambda p: f"{p.overall.means['energy'] / 1e3:.4g}",
        "effort": lambda p: f"{p.overall.means['effort']:.4f}",
        f"action rate [{unit}]": lambda p: f"{factor * action_rate(p.overall.means)[0]:.4g}",
        "predict [us]": lambda p: (
            f"{'' if p.overall.timed_alone else '~'}{p.overall.predict_time * 1e6:.1f}"
        ),
        **({name: partial(call, field=field) for name, field in calls} if measured else {}),
        "training": lambda p: "-" if p.training is None else str(p.training),
    }
    note = (
        "Score: part of the gap between integral (0; without it nominal or uc) and the ceiling "
        "(1), the best policy that knows the truth, by the IQM of the RMSE over all sets. "
        "P(better): probability that the agent has the smaller RMSE than the reference in an "
        "episode. The others are means. Peak: largest distance after an abrupt change. Effort: "
        "mean square of the demand over its limit. Predict: per vehicle and step, in the batch "
        "that was run; ~ with other processes at the same time, not comparable."
    )
    if measured:
        note += f" 1 vehicle: of single calls, as {lb.TIMING} has them; not of the batch."
    return Table("Scores and costs", tables.rows_of(columns, board.places), 1, [note])


def tables_of(summary: Summary) -> list[Table]:
    """The tables of a summary that are not empty."""
    makers = policy_table, comparison_table, goal_table, identification_table, nis_table
    return [table for table in (make(summary) for make in makers) if len(table.rows) > 1]


def leaderboard_tables(board: Leaderboard) -> list[Table]:
    """The tables of the leaderboard, the conditions below the last."""
    costs = cost_table(board)
    conditions = [board.conditions] if board.conditions else []
    costs = costs._replace(notes=[*costs.notes, *conditions])
    return [main_table(board), set_table(board), costs]


def terminal(summary: Summary, width: int = 80) -> str:
    """The whole summary as plain text of at most `width` columns; wider tables are folded."""
    return tables.terminal(tables_of(summary), width)


def plain(value: Any) -> Any:
    """Named tuples as dicts, all the way down, for JSON; what is not finite is None."""
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def document(board: Leaderboard) -> dict[str, Any]:
    """The leaderboard for JSON."""
    agents = [
        {**plain(p), "verdict": verdict(p), "verdict_settled": verdict(p, settled=True)}
        for p in board.places
    ]
    parts = ("conditions", "reference", "sets", "agreement")
    return {**{name: plain(getattr(board, name)) for name in parts}, "agents": agents}


def flat(record: Record) -> Record:
    """A record with its estimates as columns `parameter.metric` and `nis.filter`, for CSV."""
    columns = {k: v for k, v in record.items() if k not in ("identification", "nis")}
    for name, values in {**record.get("identification", {}), "nis": record.get("nis", {})}.items():
        columns.update({f"{name}.{metric}": value for metric, value in values.items()})
    return columns


def _write(folder: Path, texts: Mapping[str, str]) -> None:
    for name, text in texts.items():
        write_atomically(folder / name, text.encode())


def write(
    folder: Path, header: Mapping[str, Any], records: Sequence[Record], summary: Summary
) -> None:
    """Write results.json, episodes.csv and summary.md into `folder`."""
    units = {name: metric.unit for name, metric in {**METRICS, **ESTIMATION_METRICS}.items()}
    results = {**header, "units": units, "summary": plain(summary), "episodes": list(records)}
    text = io.StringIO()
    rows = [flat(record) for record in records]
    columns = dict.fromkeys([*RECORD_COLUMNS, *(name for row in rows for name in row)])
    writer = csv.DictWriter(text, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    texts = {"results.json": json.dumps(results, indent=1) + "\n", "episodes.csv": text.getvalue()}
    _write(folder, {**texts, "summary.md": tables.markdown(tables_of(summary))})


def write_leaderboard(
    folder: Path,
    board: Leaderboard,
    summary: Summary,
    facts: Mapping[str, str] = {},
    figures: Sequence[Drawing] = (),
    episodes: Sequence[Path] = (),
) -> Path:
    """Write leaderboard.json, leaderboard.md and leaderboard.html into `folder`; returns the page.

    facts: where the numbers come from, by what it is; figures: of all sets; episodes: SVG files
    of figures of episodes.
    """
    parts = leaderboard_tables(board)
    agents = ", ".join(lb.figure_agents(board))
    drawings = [
        Drawing(
            path.stem.replace("-", " of ", 1),
            f"Drawn: {agents}. As a file: figures/{path.name}",
            tables.inline_svg(path.read_text(encoding="utf-8"), path.stem),
            folded=path.stem != "errors",
        )
        for path in episodes
    ]
    sections = [
        Section("Leaderboard", "leaderboard", parts[:1]),
        Section("Every set", "sets", parts[1:2]),
        Section("Figures", "figures", figures=figures),
        Section("Episodes", "episodes", figures=drawings),
        Section("Scores and costs", "costs", parts[2:]),
        Section("Details", "details", tables_of(summary)),
        Section("Provenance", "provenance", facts=facts),
        Section("Files", "files", links=FILES),
    ]
    texts = {
        "leaderboard.json": json.dumps(document(board), indent=1) + "\n",
        "leaderboard.md": tables.markdown(parts),
        "leaderboard.html": tables.page_text(
            "Leaderboard", facts.get("environment", ""), [board.conditions], sections
        ),
    }
    _write(folder, texts)
    return folder / "leaderboard.html"
