"""Paired comparison of policies on named uncertainty sets; docs/evaluation.md shows its use."""

from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import DEFAULT_SETS, SETS, BenchmarkSet, default_sets
from tracked_env.benchmark.frozen import check
from tracked_env.benchmark.policy_interface import (
    Policy,
    PolicyContext,
    PolicyEntry,
    PolicyFactory,
    load_policy,
)
from tracked_env.benchmark.report import terminal
from tracked_env.benchmark.runner import run
from tracked_env.benchmark.store import Store
from tracked_env.benchmark.summary import Summary, summarise

__all__ = [
    "DEFAULT_SETS",
    "SETS",
    "BenchmarkConfig",
    "BenchmarkSet",
    "Policy",
    "PolicyContext",
    "PolicyEntry",
    "PolicyFactory",
    "Store",
    "Summary",
    "check",
    "default_sets",
    "load_policy",
    "run",
    "summarise",
    "terminal",
]
