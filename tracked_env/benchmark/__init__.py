"""Paired comparison of policies on named uncertainty sets.

    entries = [load_policy("my_package:my_policy", registry={})]
    config = BenchmarkConfig(episodes=16)
    store = Store(Path("results/mine"), config.identity())
    summary = summarise(run(config, entries, store))
"""

from tracked_env.benchmark.policies import (
    Policy,
    PolicyContext,
    PolicyEntry,
    PolicyFactory,
    load_policy,
)
from tracked_env.benchmark.report import Summary, summarise, terminal
from tracked_env.benchmark.runner import DEFAULT_SETS, BenchmarkConfig, run
from tracked_env.benchmark.store import Store

__all__ = [
    "DEFAULT_SETS",
    "BenchmarkConfig",
    "Policy",
    "PolicyContext",
    "PolicyEntry",
    "PolicyFactory",
    "Store",
    "Summary",
    "load_policy",
    "run",
    "summarise",
    "terminal",
]
