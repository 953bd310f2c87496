"""Policies as other processes get them: how to make one, not the policy itself.

A policy is sent as the function that found it and its arguments (`PolicyEntry.source`): a name that
a package registers, `module:attribute`, or the bytes of an archive. The other process finds it anew
and compares fingerprints, so that it has the same source, or says that it has not.
"""

import pickle
import platform
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.sets import SETS


class SentPolicy(NamedTuple):
    """A policy without what only one process can have."""

    name: str
    fingerprint: str
    data: bytes  # a pickled `PolicyEntry.source`, or the factory itself
    frozen: bool = False


class Comparison(NamedTuple):
    """What all chunks of a comparison share."""

    config: BenchmarkConfig
    source: str  # of the simulation
    policies: Mapping[str, SentPolicy]


# What this process has found, by name and fingerprint.
_FOUND: dict[tuple[str, str], PolicyEntry] = {}


def sent(config: BenchmarkConfig, policies: Sequence[PolicyEntry]) -> Comparison:
    """A comparison as other processes get it.

    Raises ValueError for a policy that cannot be sent.
    """
    known = {
        entry.name: SentPolicy(entry.name, entry.fingerprint, _data(entry), entry.frozen)
        for entry in policies
    }
    return Comparison(config, config.identity()["source"], known)


def _data(entry: PolicyEntry) -> bytes:
    try:
        return pickle.dumps(entry.make if entry.source is None else entry.source)
    except Exception as error:
        raise ValueError(
            f"policy {entry.name!r} cannot be sent to another process ({error}). Name it as "
            "module:attribute, or define its factory at the top of a module"
        ) from error


def received(comparison: Comparison, name: str) -> PolicyEntry:
    """A policy in the process that has got it.

    Raises ValueError where this process has another source, of the policy or the simulation.
    """
    policy = comparison.policies[name]
    key = policy.name, policy.fingerprint
    if key not in _FOUND:
        found: Any = pickle.loads(policy.data)
        if isinstance(found, tuple):
            function, arguments = found
            entry = function(*arguments)._replace(name=name, frozen=policy.frozen)
            if entry.fingerprint != policy.fingerprint:
                raise _differs(f"policy {name!r}")
        else:
            entry = PolicyEntry(name, found, policy.fingerprint, frozen=policy.frozen)
        _check_simulation(comparison)
        _FOUND[key] = entry
    return _FOUND[key]


def _check_simulation(comparison: Comparison) -> None:
    """Raises ValueError where this process would simulate something else."""
    unknown = [name for name in comparison.config.sets if name not in SETS]
    if unknown:
        raise ValueError(
            f"evaluation set {unknown[0]!r} is not known on {platform.node()}: register it in the "
            "module of a policy, which every process imports"
        )
    if comparison.config.identity()["source"] != comparison.source:
        raise _differs("the simulation")


def _differs(what: str) -> ValueError:
    return ValueError(
        f"{what} has another source on {platform.node()} than here: install the same version of "
        "the same packages there"
    )
