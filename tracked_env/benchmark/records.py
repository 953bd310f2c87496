"""Checks of the lines of stored results: damaged or edited ones are refused when read.

    header   {format, hash, identity, versions, machine}
    chunk    {policy, fingerprint, set, predict_time, episodes: [record, ...]}, where other
             processes ran at the same time, how many: beside, and of a policy that is handed the
             true parameters reads_truth: true
    record   {episode, seed, digest, ended, every metric of METRICS}, and of a policy that
             estimates {identification: {parameter: {metric: number}}, nis: {filter: number}}
Numbers are finite. Metrics are >= 0, shares at most 1; None stands for what an episode lacks.
All functions raise ValueError.
"""

import math
import sys
from collections.abc import Collection, Mapping
from typing import Any

from tracked_env.benchmark.identification_metrics import ESTIMATION_METRICS, LATER
from tracked_env.benchmark.metrics import ENDINGS, METRICS, OPTIONAL

Record = dict[str, Any]

HEADER = {"format": int, "hash": str, "identity": dict, "versions": dict, "machine": dict}
CHUNK = {"policy": str, "fingerprint": str, "set": str, "predict_time": float, "episodes": list}
BESIDE = "beside"  # processes at the same time, which makes `predict_time` not comparable
READS_TRUTH = "reads_truth"  # of a policy that is handed the true parameters
EPISODE = {"episode": int, "seed": int, "digest": str, "ended": str}
ESTIMATES = {"identification": dict, "nis": dict}  # of policies that estimate
SHARES = ("success", "terminated", "saturation_share")
_SAID = {
    int: "an integer >= 0",
    float: "a number >= 0",
    bool: "true or false",
    str: "text",
    dict: "a dict",
    list: "a list",
}
NEEDED = [name for name in ESTIMATION_METRICS if name not in LATER]  # of an estimate


def _fields(what: str, given: Any, needed: Collection[str], allowed: Collection[str]) -> Record:
    """A dict with all the needed fields and no other than those and the allowed ones."""
    if not isinstance(given, dict):
        raise ValueError(f"{what} is {given!r:.60}; must be a dict")
    lacking = [name for name in needed if name not in given]
    if lacking:
        raise ValueError(f"{what} lacks {', '.join(lacking)}")
    strange = [name for name in given if name not in needed and name not in allowed]
    if strange:
        raise ValueError(f"{what} has {strange[0]!r}, which is not known")
    return given


def _number(what: str, value: Any, low: float = -math.inf, high: float = math.inf) -> None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not low <= value <= high or abs(value) > sys.float_info.max:
        limits = "" if low < 0.0 else f" >= {low:g}" if high == math.inf else f" in [0, {high:g}]"
        raise ValueError(f"{what} = {value!r:.60}; must be a finite number{limits}")


def _typed(what: str, given: Mapping[str, Any], types: Mapping[str, type]) -> None:
    for name, kind in types.items():
        value = given.get(name)
        if kind is float:
            _number(f"{name} of {what}", value, 0.0)
        elif type(value) is not kind or (isinstance(value, int) and value < 0):
            raise ValueError(f"{name} of {what} = {value!r:.60}; must be {_SAID[kind]}")


def checked_header(header: Any) -> Record:
    """The first line, of the present format or not."""
    known = _fields("the header", header, HEADER, ())
    _typed("the header", known, HEADER)
    return known


def checked_chunk(chunk: Any) -> Record:
    """Any other line: a chunk of finished episodes."""
    beside = {BESIDE: int, READS_TRUTH: bool}
    known = _fields("the chunk", chunk, CHUNK, beside)
    _typed("the chunk", known, CHUNK)
    _typed("the chunk", known, {name: kind for name, kind in beside.items() if name in known})
    for record in known["episodes"]:
        _check_record(record)
    return known


def _check_record(record: Any) -> None:
    known = _fields("a record", record, (*EPISODE, *METRICS), ESTIMATES)
    _typed("a record", known, EPISODE)
    what = f"episode {known['episode']}"
    if known["ended"] not in ENDINGS:
        raise ValueError(f"ended of {what} = {known['ended']!r:.60}; must be one of {ENDINGS}")
    for name in METRICS:
        if known[name] is not None or name not in OPTIONAL:
            _number(f"{name} of {what}", known[name], 0.0, 1.0 if name in SHARES else math.inf)
    _typed(what, known, {name: kind for name, kind in ESTIMATES.items() if name in known})
    for parameter, metrics in known.get("identification", {}).items():
        _fields(f"estimate of {parameter!r:.60} in {what}", metrics, NEEDED, LATER)
        _check_estimates(what, metrics)
    _check_estimates(what, known.get("nis", {}))


def _check_estimates(what: str, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if value is not None:
            _number(f"{name} of {what}", value)
