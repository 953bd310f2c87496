"""What a search of settings has driven: a CSV file that it goes on from, and tables of it."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from tracked_env.benchmark.text_tables import markdown_rows
from tracked_env.benchmark.tuning import FACTORS, Candidate, Outcome, Settings, Tunable

BEST = 10  # candidates of the table
_SUMMARY = ("cost", "rmse", "settled", "lost", "rate")  # columns behind the settings
_REFUSED = "refused"


class Records:
    """Candidates of one search by their settings and seed, each kept as soon as it was driven."""

    def __init__(self, file: Path, names: Sequence[str], sets: Sequence[str]) -> None:
        self.file, self._names, self._sets = file, tuple(names), tuple(sets)
        of_sets = [f"{name} {field}" for name in self._sets for field in Outcome._fields]
        self._columns = ["seed", "stage", *self._names, *_SUMMARY, *of_sets]
        self._known: dict[tuple[float, ...], Candidate | None] = {}
        if file.exists():
            with file.open(newline="", encoding="utf-8") as lines:
                for row in csv.DictReader(lines):
                    if None not in row.values():  # the last line of an interrupted run may be short
                        self._read(row)

    def _key(self, seed: int, settings: Settings) -> tuple[float, ...]:
        return (seed, *(settings[name] for name in self._names))

    def _read(self, row: dict[str, str]) -> None:
        settings = {name: float(row[name]) for name in self._names}
        key = self._key(int(row["seed"]), settings)
        if row["cost"] == _REFUSED:
            self._known[key] = None
            return
        outcomes = {
            name: Outcome(*(float(row[f"{name} {field}"]) for field in Outcome._fields))
            for name in self._sets
        }
        self._known[key] = Candidate(row["stage"], settings, outcomes)

    def __len__(self) -> int:
        return len(self._known)

    def has(self, seed: int, settings: Settings) -> bool:
        """Whether these settings have been driven, or refused, on episodes from `seed` on."""
        return self._key(seed, settings) in self._known

    def get(self, seed: int, settings: Settings) -> Candidate | None:
        """The candidate; None where it was refused."""
        return self._known[self._key(seed, settings)]

    def add(self, seed: int, settings: Settings, candidate: Candidate | None, stage: str) -> None:
        """Keep a candidate; None: it was refused."""
        self._known[self._key(seed, settings)] = candidate
        row: dict[str, object] = {"seed": seed, "stage": stage, **settings, "cost": _REFUSED}
        if candidate is not None:
            row |= {"cost": candidate.cost}
            row |= {field: candidate.mean(field) for field in Outcome._fields}
            for name, one in candidate.outcomes.items():
                row |= {f"{name} {field}": value for field, value in one._asdict().items()}
        self.file.parent.mkdir(parents=True, exist_ok=True)
        new = not self.file.exists() or not self.file.stat().st_size
        with self.file.open("a", newline="", encoding="utf-8") as lines:
            writer = csv.DictWriter(lines, self._columns, restval="-")
            if new:
                writer.writeheader()
            writer.writerow(row)


def _cells(candidate: Candidate) -> list[str]:
    """Settings, J, errors, failures and action rate."""
    return [
        *(f"{value:.4g}" for value in candidate.settings.values()),
        f"{candidate.cost:.4f}", f"{candidate.mean('rmse'):.4f}",
        f"{candidate.mean('settled'):.4f}", f"{100.0 * candidate.mean('lost'):.1f}",
        f"{candidate.mean('rate'):.4g}",
    ]  # fmt: skip


def candidate_rows(candidates: Sequence[Candidate]) -> list[list[str]]:
    """Header and one row for each."""
    names = list(candidates[0].settings)
    head = ["stage", *names, "J [m]", "IQM [m]", "after 5 s [m]", "lost [%]", "action rate"]
    return [head, *([one.stage, *_cells(one)] for one in candidates)]


def best_of(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The ten best, best first."""
    return sorted(candidates, key=lambda one: one.cost)[:BEST]


def sensitivity_rows(best: Candidate, varied: Sequence[Candidate]) -> list[list[str]]:
    """Header and one row per setting: J over that of the best, with the setting times FACTORS."""
    costs = {one.stage: one.cost / best.cost for one in varied}
    rows = [["setting", *(f"x {factor:g}" for factor in FACTORS)]]
    for name in best.settings:
        stages = [f"{name} x {factor:g}" for factor in FACTORS]
        if any(stage in costs for stage in stages):
            found = [costs.get(stage, math.nan) for stage in stages]
            rows.append([name, *("refused" if math.isnan(one) else f"{one:.3f}" for one in found)])
    return rows


def set_rows(before: Candidate, after: Candidate) -> list[list[str]]:
    """Header and one row per set: errors and failures of two candidates."""
    rows = [["set", "IQM before [m]", "after", "after 5 s before [m]", "after", "lost before [%]",
             "after"]]  # fmt: skip
    for name, old in before.outcomes.items():
        new = after.outcomes[name]
        errors = (old.rmse, new.rmse, old.settled, new.settled)
        lost = (f"{100.0 * one.lost:.1f}" for one in (old, new))
        rows.append([name, *(f"{error:.4f}" for error in errors), *lost])
    return rows


def page(
    policy: Tunable, env: str, conditions: str, driven: Sequence[Candidate],
    varied: Sequence[Candidate], audited: Sequence[Candidate],
) -> str:  # fmt: skip
    """Markdown of one search. driven: default first; audited: default and best on the audit."""
    best = best_of(driven)
    ranges = [["setting", "range", "scale", "default", "best"]]
    for name, (low, high, logarithmic) in policy.ranges.items():
        scale = "logarithmic" if logarithmic else "linear"
        values = (f"{one.settings[name]:.4g}" for one in (driven[0], best[0]))
        ranges.append([name, f"{low:g} to {high:g}", scale, *values])
    parts = [
        f"## `{policy.name}` on {env}", conditions, markdown_rows(ranges, names=1),
        "The best, and the default last:",
        markdown_rows(candidate_rows([*best, driven[0]]), names=1),
        "Each setting of the best alone times a factor, J over that of the best:",
        markdown_rows(sensitivity_rows(best[0], varied), names=1),
        "Default (before) and best (after), set by set:",
        markdown_rows(set_rows(driven[0], best[0]), names=1),
    ]  # fmt: skip
    if audited:
        parts += ["The same two on the audit split:", markdown_rows(candidate_rows(audited), 1)]
    return "\n\n".join(parts) + "\n"
