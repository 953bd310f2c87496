"""What is stored of a chunk of episodes: lines of results and arrays for the figures; their checks.

Lines of results; damaged or edited ones are refused when read:
    header   {format, hash, identity, versions, machine}
    chunk    {policy, fingerprint, set, predict_time, episodes: [record, ...]}, where other
             processes ran at the same time, how many: beside, and of a policy that is handed the
             true parameters reads_truth: true
    record   {episode, seed, digest, ended, every metric of METRICS}, and of a policy that
             estimates {identification: {parameter: {metric: number}}, nis: {filter: number}}
Numbers are finite. Metrics are >= 0, shares at most 1; None stands for what an episode lacks.

Arrays for the figures, a file per chunk:
    episodes                     those of the chunk among the first FIGURE_ERRORS of the set
    time, error                  their error at FIGURE_POINTS times
    change                       when the first abrupt change of each began [s], NaN without one
    motion                       every channel of the first FIGURE_EPISODES, NaN after their end
    believed_time, _names,       of a policy that estimates: value, standard deviation and truth
      _value, _deviation, _truth (points, parameters, episodes) of the same episodes
    control_period               [s]
The files of a set are joined when they are read: what is drawn does not depend on the chunks.
"""

import math
import sys
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.identification_metrics import ESTIMATION_METRICS, LATER, Beliefs
from tracked_env.benchmark.metrics import CHANNELS, ENDINGS, METRICS, OPTIONAL, Trace, counted_error

Record = dict[str, Any]

FIGURE_ERRORS = 64  # episodes whose error is stored
FIGURE_EPISODES = 4  # whose motion is stored in full
FIGURE_POINTS = 300  # times at which error and beliefs are stored
_BELIEVED = ("believed_value", "believed_deviation", "believed_truth")

HEADER = {"format": int, "hash": str, "identity": dict, "versions": dict, "machine": dict}
CHUNK = {"policy": str, "fingerprint": str, "set": str, "predict_time": float, "episodes": list}
BESIDE = "beside"  # processes at the same time, which makes `predict_time` not comparable
READS_TRUTH = "reads_truth"  # of a policy that is handed the true parameters
EPISODE = {"episode": int, "seed": int, "digest": str, "ended": str}
ESTIMATES = {"identification": dict, "nis": dict}  # of policies that estimate
SHARES = ("success", "terminated", "saturation_share")
_KINDS = {int: "an integer >= 0", bool: "true or false", str: "text", dict: "a dict",
          list: "a list"}  # fmt: skip
NEEDED = [name for name in ESTIMATION_METRICS if name not in LATER]  # of an estimate


def _fields(what: str, value: Any, needed: Collection[str], allowed: Collection[str]) -> Record:
    """A dict with all the needed fields and no other than those and the allowed ones."""
    if not isinstance(value, dict):
        raise ValueError(f"{what} is {value!r:.60}; must be a dict")
    lacking = [name for name in needed if name not in value]
    if lacking:
        raise ValueError(f"{what} lacks {', '.join(lacking)}")
    others = [name for name in value if name not in needed and name not in allowed]
    if others:
        raise ValueError(f"{what} has {others[0]!r}, which is not known")
    return value


def _number(what: str, value: Any, low: float = -math.inf, high: float = math.inf) -> None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not low <= value <= high or abs(value) > sys.float_info.max:
        limits = "" if low < 0.0 else f" >= {low:g}" if high == math.inf else f" in [0, {high:g}]"
        raise ValueError(f"{what} = {value!r:.60}; must be a finite number{limits}")


def _typed(what: str, fields: Mapping[str, Any], types: Mapping[str, type]) -> None:
    for name, kind in types.items():
        value = fields.get(name)
        if kind is float:
            _number(f"{name} of {what}", value, 0.0)
        elif type(value) is not kind or (isinstance(value, int) and value < 0):
            raise ValueError(f"{name} of {what} = {value!r:.60}; must be {_KINDS[kind]}")


def checked_header(header: Any) -> Record:
    """The first line, of the present format or not. Raises ValueError."""
    fields = _fields("the header", header, HEADER, ())
    _typed("the header", fields, HEADER)
    return fields


def checked_chunk(chunk: Any) -> Record:
    """Any other line: a chunk of finished episodes. Raises ValueError."""
    more = {BESIDE: int, READS_TRUTH: bool}
    fields = _fields("the chunk", chunk, CHUNK, more)
    there = {name: kind for name, kind in more.items() if name in fields}
    _typed("the chunk", fields, {**CHUNK, **there})
    for record in fields["episodes"]:
        _check_record(record)
    return fields


def _check_record(record: Any) -> None:
    fields = _fields("a record", record, (*EPISODE, *METRICS), ESTIMATES)
    _typed("a record", fields, EPISODE)
    what = f"episode {fields['episode']}"
    if fields["ended"] not in ENDINGS:
        raise ValueError(f"ended of {what} = {fields['ended']!r:.60}; must be one of {ENDINGS}")
    for name in METRICS:
        if fields[name] is not None or name not in OPTIONAL:
            _number(f"{name} of {what}", fields[name], 0.0, 1.0 if name in SHARES else math.inf)
    _typed(what, fields, {name: kind for name, kind in ESTIMATES.items() if name in fields})
    for parameter, metrics in fields.get("identification", {}).items():
        _fields(f"estimate of {parameter!r:.60} in {what}", metrics, NEEDED, LATER)
        _check_estimates(what, metrics)
    _check_estimates(what, fields.get("nis", {}))


def _check_estimates(what: str, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if value is not None:
            _number(f"{name} of {what}", value)


def _thinned(steps: int) -> NDArray[np.int64]:
    """At most FIGURE_POINTS of `steps` rows, first and last among them."""
    return np.unique(np.linspace(0, steps - 1, FIGURE_POINTS).astype(np.int64))


def figure_data(
    trace: Trace, beliefs: Beliefs | None = None, episodes: Sequence[int] | None = None
) -> dict[str, NDArray[Any]]:
    """The arrays of the head of this file, from a whole chunk.

    episodes: their numbers, which rise; by default they are the first ones.
    """
    numbers = np.arange(len(trace.steps)) if episodes is None else np.array(episodes)
    numbers = numbers[numbers < FIGURE_ERRORS]
    shown = int((numbers < FIGURE_EPISODES).sum())
    error = counted_error(trace)[:, : len(numbers)]
    times = _thinned(len(error))
    steps = int(trace.steps[:shown].max(initial=0))
    few = trace.values[:steps, :shown].astype(np.float32)
    few[~trace.driven()[:steps, :shown]] = np.nan
    first = [of[0].first if of else np.nan for of in trace.changes()[: len(numbers)]]
    return {
        "episodes": numbers,
        "time": (times + 1) * trace.control_period,
        "error": error[times].astype(np.float32),
        "change": np.array(first, dtype=np.float64) * trace.control_period,
        "motion": few,
        "control_period": np.array(trace.control_period),
        **({} if beliefs is None else _believed(trace, beliefs, shown)),
    }


def merged(parts: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """The arrays of several chunks as those of one; an episode that two of them have, once."""
    if len(parts) == 1:
        return dict(parts[0])
    where: dict[int, tuple[int, int]] = {}  # episode -> part and column
    for number, part in enumerate(parts):
        for column, episode in enumerate(part["episodes"].tolist()):
            where.setdefault(episode, (number, column))
    episodes = sorted(where)
    columns = [where[episode] for episode in episodes]
    few = [where[episode] for episode in episodes if episode < FIGURE_EPISODES]
    whole = {
        **parts[0],
        "episodes": np.array(episodes),
        "error": np.stack([parts[i]["error"][:, k] for i, k in columns], axis=1),
        "change": np.array([parts[i]["change"][k] for i, k in columns]),
    }
    motion = [parts[i]["motion"][:, k] for i, k in few]
    steps = max((len(each) for each in motion), default=0)
    size = steps, len(motion), parts[0]["motion"].shape[2]
    whole["motion"] = np.full(size, np.nan, dtype=np.float32)
    for k, each in enumerate(motion):
        whole["motion"][: len(each), k] = each
    for name in (name for name in _BELIEVED if name in parts[0]):
        columns_of = [parts[i][name][..., k] for i, k in few]
        whole[name] = np.stack(columns_of, axis=-1) if columns_of else parts[0][name]
    return whole


def _believed(trace: Trace, beliefs: Beliefs, shown: int) -> dict[str, NDArray[Any]]:
    """The beliefs of the first episodes, NaN after their end."""
    times = _thinned(trace.max_steps)
    void = (times[:, None] >= trace.steps[:shown])[:, None]
    last = len(beliefs.value) - 1  # all later times are void

    def thinned(array: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.where(void, np.float32(np.nan), array[np.minimum(times, last), :, :shown])

    return {
        "believed_time": times * trace.control_period,
        "believed_names": np.array(beliefs.names),
        "believed_value": thinned(beliefs.value),
        "believed_deviation": thinned(beliefs.deviation),
        "believed_truth": thinned(beliefs.truth),
    }


def checked_trace(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays of `figure_data`, whose shapes must agree.

    Raises ValueError for a shape, KeyError for a missing array.
    """
    shapes = {"time": 1, "error": 2, "change": 1, "motion": 3, "control_period": 0}
    if "believed_names" in arrays:
        shapes |= {"believed_time": 1, "believed_names": 1}
        shapes |= dict.fromkeys(_BELIEVED, 3)
    for name, dimensions in shapes.items():
        kind = "U" if name == "believed_names" else "f"
        if arrays[name].ndim != dimensions or arrays[name].dtype.kind != kind:
            raise ValueError(f"{name} has shape {arrays[name].shape}, type {arrays[name].dtype}")
    motion = arrays["motion"]
    sizes: list[tuple[Any, Any]] = [
        (len(arrays["time"]), len(arrays["error"])),
        (arrays["error"].shape[1], len(arrays["change"])),
        (motion.shape[2], len(CHANNELS)),
    ]
    if "believed_names" in arrays:
        size = (len(arrays["believed_time"]), len(arrays["believed_names"]), motion.shape[1])
        for part in ("value", "deviation", "truth"):
            sizes.append((arrays[f"believed_{part}"].shape, size))
    first = arrays["episodes"].min(initial=FIGURE_ERRORS) if "episodes" in arrays else 0
    if any(one != other for one, other in sizes) or (first < FIGURE_EPISODES and not motion.size):
        raise ValueError("its arrays do not fit whole")
    return arrays
