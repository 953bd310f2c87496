"""Paired comparison of policies on named uncertainty sets; docs/evaluation.md shows its use.

What a policy is, is imported at once; the rest when it is first named, so that a training or a
controller does not load tables, figures and the runner.
"""

from importlib import import_module
from typing import Any

from tracked_env.benchmark.policy_interface import Policy, PolicyContext, PolicyEntry, PolicyFactory

_MODULES = {
    "BenchmarkConfig": "benchmark_config",
    "BenchmarkSet": "evaluation_sets",
    "DEFAULT_SETS": "evaluation_sets",
    "SETS": "evaluation_sets",
    "default_sets": "evaluation_sets",
    "check": "frozen",
    "load_policies": "policies",
    "load_policy": "policies",
    "read_sets": "benchmark_config",
    "policies_for": "policies",
    "terminal": "report",
    "run": "runner",
    "Store": "store",
    "Summary": "summary",
    "summarise": "summary",
}

__all__ = ["Policy", "PolicyContext", "PolicyEntry", "PolicyFactory", *_MODULES]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
