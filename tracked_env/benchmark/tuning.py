"""Search of the settings of a controller: one budget and one rule for every policy.

A policy can be tuned if what is registered, factory(context, **settings), has two attributes:
    TUNABLE   {setting: (low, high, whether on a logarithmic scale)}
    SETTINGS  function of the context that returns the default settings, a NamedTuple
With u in [0, 1]^d the settings over their ranges, and for a set s of N episodes
    q_s   interquartile mean of the tracking RMSE, whole episode       t_s: the same after 5 s
    f_s   part of the episodes that fail: ended early, or RMSE not below a quarter of the contact
    J     exp(mean_s (ln q_s + ln t_s) / 2) (1 + LOST mean_s f_s)                             [m]
the budget is spent in this order, on the same episodes throughout:
    default   the settings as they are
    search    half of it on points of the Halton sequence [1], scrambled with a fixed seed
    refine    the rest on a pattern search [2] from the best: each setting up and down by STEP of
              its range in turn, a step that is halved when none of them is better, down to FINEST
and then each setting of the best alone times FACTORS, to show how sharp the optimum is. What a
controller refuses (ValueError) is not driven and not counted.

References: [1] Halton, Numerische Mathematik 2 (1960). [2] Hooke and Jeeves, J. ACM 8 (1961).
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark import metrics
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.policy_interface import blamed, needs_truth
from tracked_env.benchmark.runner import drive
from tracked_env.benchmark.statistics import interquartile_mean
from tracked_env.validation import checked_keys

LOST = 10.0  # [-] weight of the part that fails: 1 % of all episodes counts as 10 % more error
STEP, FINEST = 0.1, 0.01  # [-] of a range, first and last step of the pattern search
FACTORS = (0.5, 0.7, 1.4, 2.0)  # on each setting of the best alone
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

    stage: str  # default, search, refine, "SETTING x FACTOR", or audit
    settings: Settings
    outcomes: Mapping[str, Outcome]  # by set

    @property
    def cost(self) -> float:
        """J [m], or inf where nothing was driven."""
        return cost(list(self.outcomes.values()))

    def mean(self, field: str) -> float:
        """Mean of a field over the sets, geometric that of an error."""
        values = np.array([getattr(one, field) for one in self.outcomes.values()])
        return float(
            np.exp(np.log(values).mean()) if field in ("rmse", "settled") else values.mean()
        )


class Tunable(NamedTuple):
    """What a registered policy declares."""

    name: str
    make: Callable[..., Any]  # (context, **settings)
    ranges: Ranges
    defaults: Callable[[Any], Any]


def cost(outcomes: Sequence[Outcome]) -> float:
    """J [m] of the head of this file; inf of nothing."""
    if not outcomes:
        return math.inf
    logs = [0.5 * (math.log(one.rmse) + math.log(one.settled)) for one in outcomes]
    lost = float(np.mean([one.lost for one in outcomes]))
    return math.exp(float(np.mean(logs))) * (1.0 + LOST * lost)


def tunable(name: str, found: Any) -> Tunable:
    """What is registered under a name. Raises ValueError where it declares no ranges."""
    ranges, defaults = getattr(found, "TUNABLE", None), getattr(found, "SETTINGS", None)
    if not ranges or not callable(defaults):
        raise ValueError(
            f"policy {name!r} declares no settings to be tuned: it needs attributes TUNABLE and "
            "SETTINGS. Is it an agent, or a controller without gains of its own?"
        )
    for setting, (low, high, logarithmic) in ranges.items():
        if not (low < high and (low > 0.0 or not logarithmic)):
            raise ValueError(f"policy {name!r}: range of {setting} is [{low:g}, {high:g}]")
    return Tunable(name, found, ranges, defaults)


def default_settings(policy: Tunable, context: Any) -> dict[str, float]:
    """The default of every setting that is tuned."""
    given = policy.defaults(context)._asdict()
    return {name: float(given[name]) for name in checked_keys("TUNABLE", policy.ranges, given)}


def outcome(
    policy: Tunable, settings: Settings, config: BenchmarkConfig, name: str,
    on_step: Callable[[], None] = lambda: None,
) -> Outcome:  # fmt: skip
    """Drive the episodes of one set. Raises ValueError for settings that the policy refuses, and
    PolicyError for one that fails under way."""
    made = policy.make(config.context(name), **settings)
    env = config.environment(name, config.episodes, needs_truth(made))
    seeds = range(config.seed, config.seed + config.episodes)
    try:
        trace, _time = drive(made, env, seeds, on_step)
    except (Exception, SystemExit) as error:
        raise blamed(error, policy.name, f"set {name!r}, settings {dict(settings)}") from error
    finally:
        env.close()
    found = metrics.evaluate(trace)
    rate = found[metrics.ACTION_RATES[trace.drive]].mean()
    errors = (interquartile_mean(found[key]) for key in ("tracking_rmse", "settled_rmse"))
    rmse, settled = (float(value) for value in errors)
    return Outcome(rmse, settled, 1.0 - float(found["success"].mean()), float(rate))


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
    """The candidates of the stages default, search and refine, `budget` of them."""
    from scipy.stats import qmc

    best = evaluate("default", default)
    if best is None:
        raise ValueError(f"the default settings {dict(default)} are refused")
    yield best
    spent, halton = 1, qmc.Halton(len(ranges), scramble=True, seed=1)
    for point in halton.random(20 * budget):
        if spent >= (budget + 1) // 2:
            break
        candidate = evaluate("search", unscaled(ranges, point))
        if candidate is not None:
            spent, best = spent + 1, min(best, candidate, key=lambda one: one.cost)
            yield candidate
    for candidate in _refined(ranges, best, budget - spent, evaluate):
        yield candidate


def _refined(
    ranges: Ranges, best: Candidate, budget: int, evaluate: Evaluate
) -> Iterator[Candidate]:
    """Pattern search from `best`."""
    step, known = STEP, {tuple(best.settings.values())}
    while budget > 0 and step >= FINEST:
        improved = False
        for axis in range(len(ranges)):
            for sign in (1.0, -1.0):
                point = scaled(ranges, best.settings)
                point[axis] = min(max(point[axis] + sign * step, 0.0), 1.0)
                settings = unscaled(ranges, point)
                if budget < 1 or tuple(settings.values()) in known:
                    continue
                known.add(tuple(settings.values()))
                candidate = evaluate("refine", settings)
                if candidate is None:
                    continue
                budget -= 1
                yield candidate
                if candidate.cost < best.cost:
                    best, improved = candidate, True
                    break
        if not improved:
            step *= 0.5


def varied(settings: Settings) -> Iterator[tuple[str, dict[str, float]]]:
    """(stage, settings) with each setting alone times FACTORS; those that are 0 or inf are left."""
    for name, value in settings.items():
        if value != 0.0 and math.isfinite(value):
            for factor in FACTORS:
                yield f"{name} x {factor:g}", {**settings, name: value * factor}
