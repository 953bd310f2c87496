"""Paired comparison of policies on named uncertainty sets; docs/evaluation.md shows its use."""

from tracked_env.benchmark.policies import (
    Policy,
    PolicyContext,
    PolicyEntry,
    PolicyFactory,
    load_policy,
)
from tracked_env.benchmark.report import terminal
from tracked_env.benchmark.runner import DEFAULT_SETS, BenchmarkConfig, run
from tracked_env.benchmark.store import Store
from tracked_env.benchmark.summary import Summary, summarise

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
