"""Search of the settings of a controller: one budget and one rule for every policy.

A policy can be tuned if what is registered, factory(context, **settings), has two attributes:
    TUNABLE   {setting: (low, high, whether on a logarithmic scale)}
    SETTINGS  function of the context that returns the default settings, a NamedTuple
With u in [0, 1]^d the settings over their ranges, and for a set s of N episodes
    q_s   interquartile mean of the tracking RMSE, whole episode       t_s: the same after 5 s
    f_s   part of the episodes that fail: ended early, or RMSE not below a quarter of the contact
    a     mean action rate over that of the default settings
    J     exp(mean_s (ln q_s + ln t_s) / 2) (1 + LOST mean_s f_s) (1 + HASTY max(a / a_max - 1, 0))
in m, the budget goes to all settings at once, on the same episodes throughout: first the default
settings, then CMA-ES [1] from them, with a first deviation of SPREAD in u and a fixed seed. Then
each setting of the best alone times FACTORS shows how sharp the optimum is. What a controller
refuses (ValueError) is not driven and not counted. What was driven lies in a CSV file that a search
goes on from, and on a page of tables.

References: [1] Hansen, The CMA Evolution Strategy: A Tutorial, 2016, arXiv:1604.00772; the library
is `cmaes` (extra `tune`).
"""

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark import metrics
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT
from tracked_env.benchmark.files import source_fingerprint
from tracked_env.benchmark.policy_interface import blamed, needs_truth
from tracked_env.benchmark.runner import Progress, drive, no_progress
from tracked_env.benchmark.statistics import interquartile_mean
from tracked_env.benchmark.store import identity_hash
from tracked_env.benchmark.table_model import Table
from tracked_env.validation import checked_keys

LOST = 10.0  # [-] weight of the part that fails: 1 % of all episodes counts as 10 % more error
HASTY = 10.0  # [-] weight of an action rate beyond the allowed one
RATE_LIMIT = 1.1  # [-] a_max, over the action rate of the default settings
SPREAD = 0.15  # [-] of a range, first standard deviation of the search
ROUNDS = 20  # generations per setting of the budget, at most
INSTALL = "pip install 'tracked-env[tune]'"
FACTORS = (0.5, 0.7, 1.4, 2.0)  # on each setting of the best alone
BEST = 10  # candidates of a table
_REFUSED = "refused"
Settings = Mapping[str, float]
Ranges = Mapping[str, tuple[float, float, bool]]


class Outcome(NamedTuple):
    """What settings gave on one set."""

    rmse: float  # [m] interquartile mean, whole episode
    settled: float  # [m] after 5 s
    lost: float  # [-] part of the episodes
    rate: float  # mean action rate, [N m/s] or [rad/s^2]


class Candidate(NamedTuple):
    """Settings that were driven."""

    stage: str  # default, search, "SETTING x FACTOR", or audit
    settings: Settings
    outcomes: dict[str, Outcome]  # by set
    rate_limit: float = math.inf  # a_max times the rate of the default

    @property
    def cost(self) -> float:
        """J [m] of the head of this file."""
        logs = [0.5 * (math.log(o.rmse) + math.log(o.settled)) for o in self.outcomes.values()]
        haste = max(self.mean("rate") / self.rate_limit - 1.0, 0.0)
        return math.exp(np.mean(logs)) * (1.0 + LOST * self.mean("lost")) * (1.0 + HASTY * haste)

    def mean(self, field: str) -> float:
        """Mean of a field over the sets, geometric that of an error."""
        values = np.array([getattr(one, field) for one in self.outcomes.values()])
        geometric = field in ("rmse", "settled")
        return float(np.exp(np.log(values).mean()) if geometric else values.mean())


class Tunable(NamedTuple):
    """What a registered policy declares."""

    name: str
    make: Callable[..., Any]  # (context, **settings)
    ranges: Ranges
    defaults: Callable[[Any], Any]


def tunable(name: str, factory: Any) -> Tunable:
    """What is registered under a name. Raises ValueError where it declares no ranges."""
    ranges, defaults = getattr(factory, "TUNABLE", None), getattr(factory, "SETTINGS", None)
    if not ranges or not callable(defaults):
        raise ValueError(
            f"policy {name!r} declares no settings to be tuned: it needs attributes TUNABLE and "
            "SETTINGS. Is it an agent, or a controller without gains of its own?"
        )
    for setting, (low, high, logarithmic) in ranges.items():
        if not (low < high and (low > 0.0 or not logarithmic)):
            raise ValueError(f"policy {name!r}: range of {setting} is [{low:g}, {high:g}]")
    return Tunable(name, factory, ranges, defaults)


def default_settings(policy: Tunable, context: Any) -> dict[str, float]:
    """The default of every setting that is tuned."""
    values = policy.defaults(context)._asdict()
    return {name: float(values[name]) for name in checked_keys("TUNABLE", policy.ranges, values)}


def outcome(policy: Tunable, settings: Settings, config: BenchmarkConfig, name: str) -> Outcome:
    """Drive the episodes of one set. Raises ValueError for settings that the policy refuses, and
    PolicyError for one that fails under way."""
    first, parts = config.first_seed(name), list[dict[str, Any]]()
    for chunk in config.batches(name, config.episodes, config.episodes):
        controller = policy.make(config.context(name, chunk[0]), **settings)
        env = config.environment(name, len(chunk), needs_truth(controller), chunk[0])
        seeds, options = [first + i for i in chunk], config.options(name, chunk)
        try:
            trace, _time = drive(controller, env, seeds, lambda: None, options=options)
        except (Exception, SystemExit) as error:
            raise blamed(error, policy.name, f"set {name!r}, settings {dict(settings)}") from error
        finally:
            env.close()
        parts.append(metrics.evaluate(trace))
    values = {metric: np.concatenate([part[metric] for part in parts]) for metric in parts[0]}
    rate = float(values[metrics.ACTION_RATES[trace.drive]].mean())
    rmse, settled = (
        float(interquartile_mean(values[key])) for key in ("tracking_rmse", "settled_rmse")
    )
    return Outcome(rmse, settled, 1.0 - float(values["success"].mean()), rate)


def scaled(ranges: Ranges, settings: Settings) -> NDArray[np.float64]:
    """Settings as u, clipped to [0, 1]."""
    point = []
    for name, (low, high, logarithmic) in ranges.items():
        value = min(max(settings[name], low), high)
        span = math.log(high / low) if logarithmic else high - low
        point.append((math.log(value / low) if logarithmic else value - low) / span)
    return np.array(point)


def unscaled(ranges: Ranges, point: NDArray[np.float64]) -> dict[str, float]:
    """u as settings, with four digits, which is what tables show."""
    values = {}
    for u, (name, (low, high, logarithmic)) in zip(point, ranges.items(), strict=True):
        value = low * (high / low) ** u if logarithmic else low + u * (high - low)
        values[name] = float(f"{min(max(value, low), high):.4g}")
    return values


Evaluate = Callable[[str, Settings], Candidate | None]  # None: refused


def searched(
    ranges: Ranges, default: Settings, budget: int, evaluate: Evaluate
) -> Iterator[Candidate]:
    """The default settings, and those that CMA-ES asks for, `budget` in all.

    Raises ValueError where the default is refused, or the library is missing.
    """
    try:
        from cmaes import CMA
    except ImportError as error:
        raise ValueError(f"tuning needs the library cmaes: {INSTALL}") from error
    first = evaluate("default", default)
    if first is None:
        raise ValueError(f"the default settings {dict(default)} are refused")
    yield first
    # One setting alone has an axis beside it that nothing depends on.
    start, extra = scaled(ranges, default), max(2 - len(ranges), 0)
    mean = np.append(start, np.full(extra, 0.5))
    size = 4 + int(3.0 * math.log(len(mean)))
    bounds = np.tile([0.0, 1.0], (len(mean), 1))
    optimizer = CMA(mean, SPREAD, bounds, seed=1, population_size=size)
    driven = {tuple(default.values()): first.cost}
    for _ in range(ROUNDS * budget):
        generation = []
        for _ in range(size):
            point = optimizer.ask()
            settings = unscaled(ranges, point[: len(ranges)])
            key = tuple(settings.values())
            if key not in driven:
                if len(driven) - sum(map(math.isinf, driven.values())) >= budget:
                    return
                candidate = evaluate("search", settings)
                driven[key] = math.inf if candidate is None else candidate.cost
                if candidate is not None:
                    yield candidate
            generation.append((point, driven[key]))
        worst = max((cost for _, cost in generation if cost < math.inf), default=first.cost)
        optimizer.tell([(point, min(cost, 2.0 * worst)) for point, cost in generation])
        if optimizer.should_stop():  # all of it in one place: begin again from the start
            optimizer = CMA(mean, SPREAD, bounds, seed=len(driven), population_size=size)


def varied(settings: Settings) -> Iterator[tuple[str, float, dict[str, float]]]:
    """Each setting alone times FACTORS: which, by what, and all settings; 0 and inf are left."""
    for name, value in settings.items():
        for factor in FACTORS if value != 0.0 and math.isfinite(value) else ():
            yield name, factor, {**settings, name: value * factor}


def read_candidates(file: Path) -> Iterator[tuple[int, Settings, Candidate | None]]:
    """What a search has driven: first seed, settings, and the candidate, None where refused."""
    with file.open(newline="", encoding="utf-8") as lines:
        for row in csv.DictReader(lines):
            if None in row.values():  # the last line of an interrupted run may be short
                continue
            names = [*row]
            own, others = names[2 : names.index("cost")], names[names.index("cost") + 1 :]
            settings = {name: float(row[name]) for name in own}
            candidate = None
            if row["cost"] != _REFUSED:
                sets = dict.fromkeys(name.rpartition(" ")[0] for name in others)
                outcomes = {
                    name: Outcome(*(float(row[f"{name} {field}"]) for field in Outcome._fields))
                    for name in sets
                }
                candidate = Candidate(row["stage"], settings, outcomes)
            yield int(row["seed"]), settings, candidate


class Search:
    """Candidates of one policy, driven, each kept in a file as soon as it was, or read from it."""

    def __init__(
        self,
        policy: Tunable,
        sets: tuple[str, ...],
        episodes: int,
        folder: Path,
        duration: float | None = None,
        rate_limit: float = RATE_LIMIT,
        seed: int = DEVELOPMENT,
        **settings: Any,
    ) -> None:
        """rate_limit: a_max, infinite for none. seed: of the first episode of each set. settings:
        further ones of `BenchmarkConfig`."""
        self.policy, self.sets, self.episodes = policy, sets, episodes
        self.settings = {"duration": duration, **settings}
        self.progress: Progress = no_progress
        self.rate_limit, self.seed = rate_limit, seed
        config = self.config()
        context = config.context(sets[0])
        self.default = default_settings(policy, context)
        policy.make(context, **self.default)
        source = source_fingerprint(policy.make.__module__)
        identity = {**config.identity(), "sets": sets, "episodes": episodes}
        identity |= {"policy": source, "ranges": dict(policy.ranges)}
        track = config.env.rpartition("/")[2].lower()
        self.file = folder / f"{policy.name}-{track}-{identity_hash(identity)[:8]}.csv"
        self.max_steps = sum(config.max_steps(name) for name in sets)
        # By seed and settings; None where the controller refused them.
        self.candidates: dict[tuple[float, ...], Candidate | None] = {}
        if self.file.exists():
            for first, values, candidate in read_candidates(self.file):
                self.candidates[first, *values.values()] = candidate

    def config(self, seed: int | None = None) -> BenchmarkConfig:
        """The episodes from a seed on, by default those of the search."""
        seed = self.seed if seed is None else seed
        return BenchmarkConfig(self.sets, self.episodes, seed, **self.settings)

    def _keep(self, seed: int, stage: str, settings: Settings, candidate: Candidate | None) -> None:
        self.candidates[seed, *settings.values()] = candidate
        row: dict[str, object] = {"seed": seed, "stage": stage, **settings}
        row["cost"] = _REFUSED if candidate is None else candidate.cost
        for name in self.sets:
            of = dict.fromkeys(Outcome._fields, "-")
            if candidate is not None:
                of = candidate.outcomes[name]._asdict()
            row |= {f"{name} {field}": value for field, value in of.items()}
        self.file.parent.mkdir(parents=True, exist_ok=True)
        with self.file.open("a", newline="", encoding="utf-8") as lines:
            writer = csv.DictWriter(lines, [*row])
            if not lines.tell():
                writer.writeheader()
            writer.writerow(row)

    def evaluate(self, stage: str, settings: Settings, seed: int | None = None) -> Candidate | None:
        """The candidate of these settings; None where the controller refuses them."""
        config = self.config(seed)
        key = (config.seed, *settings.values())
        if key in self.candidates:
            stored = self.candidates[key]
            self.progress(self.max_steps * self.episodes if stored else 0, stage)
            return None if stored is None else self._limited(stored._replace(stage=stage))
        try:
            self.policy.make(config.context(self.sets[0]), **settings)
        except ValueError:
            self._keep(config.seed, stage, settings, None)
            return None
        candidate = Candidate(stage, settings, {})
        for name in self.sets:
            candidate.outcomes[name] = outcome(self.policy, settings, config, name)
            self.progress(config.max_steps(name) * self.episodes, f"{stage}: {name}")
        self._keep(config.seed, stage, settings, candidate)
        return self._limited(candidate)

    def _limited(self, candidate: Candidate) -> Candidate:
        """With the rate that it may have: of the default settings on the same episodes."""
        usual = self.candidates.get((self.seed, *self.default.values()))
        limit = self.rate_limit * (candidate if usual is None else usual).mean("rate")
        return candidate._replace(rate_limit=limit)


def undominated(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those of which none has both a smaller action rate and a smaller error, by rising rate.

    The error is J without the price of haste.
    """
    free = [one._replace(rate_limit=math.inf) for one in candidates]
    kept: list[Candidate] = []
    for one in sorted(free, key=lambda each: (each.mean("rate"), each.cost)):
        if not kept or one.cost < kept[-1].cost:
            kept.append(one)
    return kept


_CURVE = "Settings that were driven, of which no other has less error at no more action rate."
COLUMNS: dict[str, Callable[[Candidate], str]] = {
    "J [m]": lambda one: f"{one.cost:.4f}",
    "IQM [m]": lambda one: f"{one.mean('rmse'):.4f}",
    "after 5 s [m]": lambda one: f"{one.mean('settled'):.4f}",
    "lost [%]": lambda one: f"{100.0 * one.mean('lost'):.1f}",
    "action rate": lambda one: f"{one.mean('rate'):.4g}",
}


def tables_of(
    policy: Tunable,
    candidates: Sequence[Candidate],
    around: Mapping[tuple[str, float], Candidate],
    audited: Sequence[Candidate],
) -> list[Table]:
    """Tables of one search. candidates: the default first; around: the best with one setting times
    a factor; audited: default and best on the audit."""

    def rows_of(driven: Sequence[Candidate]) -> list[list[str]]:
        rows = [["stage", *policy.ranges, *COLUMNS]]
        for one in driven:
            settings = (f"{value:.4g}" for value in one.settings.values())
            rows.append([one.stage, *settings, *(cell(one) for cell in COLUMNS.values())])
        return rows

    default, best = candidates[0], sorted(candidates, key=lambda one: one.cost)[:BEST]
    ranges = [["setting", "range", "scale", "default", "best"]]
    sensitivity = [["setting", *(f"x {factor:g}" for factor in FACTORS)]]
    for name, (low, high, logarithmic) in policy.ranges.items():
        scale = "logarithmic" if logarithmic else "linear"
        values = (f"{one.settings[name]:.4g}" for one in (default, best[0]))
        ranges.append([name, f"{low:g} to {high:g}", scale, *values])
        near = [around.get((name, factor)) for factor in FACTORS]
        ratios = [f"{one.cost / best[0].cost:.3f}" if one else _REFUSED for one in near]
        sensitivity += [[name, *ratios]] if any(near) else []
    tables = [
        Table("Ranges", ranges),
        Table("Best", rows_of([*best, default]), 1, ["The best, and the default last."]),
        Table("Sensitivity", sensitivity, 1, ["J over that of the best, one setting changed."]),
        Table("Error against action rate", rows_of(undominated(candidates)), 1, [_CURVE]),
    ]
    note = "The default and the best on the audit split."
    return [*tables, *([Table("Audit", rows_of(audited), 1, [note])] if audited else [])]
