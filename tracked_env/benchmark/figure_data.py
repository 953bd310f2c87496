"""The part of a chunk of episodes that is kept for the figures, in a file of arrays.

episodes                     those of the chunk that are among the first FIGURE_ERRORS of the set
time, error                  their error at FIGURE_POINTS times
change                       when the first abrupt change of each began [s], NaN without one
motion                       every channel of the first FIGURE_EPISODES, NaN after their end
believed_time, _names,       of a policy that estimates: value, standard deviation and truth
  _value, _deviation, _truth (points, parameters, episodes) of the same episodes
control_period               [s]
The files of a set are joined when they are read: what is drawn does not depend on the chunks.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.beliefs import Beliefs
from tracked_env.benchmark.metrics import CHANNELS, Trace, counted_error

FIGURE_ERRORS = 64  # episodes whose error is kept
FIGURE_EPISODES = 4  # whose motion is kept in full
_BELIEVED = ("believed_value", "believed_deviation", "believed_truth")
FIGURE_POINTS = 300  # times at which error and beliefs are kept


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
    return {
        "episodes": numbers,
        "time": (times + 1) * trace.control_period,
        "error": error[times].astype(np.float32),
        "change": _changed(trace, len(numbers)),
        "motion": few,
        "control_period": np.array(trace.control_period),
        **({} if beliefs is None else _believed(trace, beliefs, shown)),
    }


def _changed(trace: Trace, count: int) -> NDArray[np.float64]:
    """Start [s] of the first abrupt change of the first `count` episodes."""
    first = [of[0].first if of else np.nan for of in trace.changes()[:count]]
    return np.array(first, dtype=np.float64) * trace.control_period


def joined(parts: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
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
    together = {
        **parts[0],
        "episodes": np.array(episodes),
        "error": np.stack([parts[i]["error"][:, k] for i, k in columns], axis=1),
        "change": np.array([parts[i]["change"][k] for i, k in columns]),
    }
    motion = [parts[i]["motion"][:, k] for i, k in few]
    steps = max((len(each) for each in motion), default=0)
    size = steps, len(motion), parts[0]["motion"].shape[2]
    together["motion"] = np.full(size, np.nan, dtype=np.float32)
    for k, each in enumerate(motion):
        together["motion"][: len(each), k] = each
    for name in (name for name in _BELIEVED if name in parts[0]):
        kept = [parts[i][name][..., k] for i, k in few]
        together[name] = np.stack(kept, axis=-1) if kept else parts[0][name]
    return together


def _believed(trace: Trace, beliefs: Beliefs, shown: int) -> dict[str, NDArray[Any]]:
    """The beliefs of the first episodes, NaN after their end."""
    times = _thinned(trace.max_steps)
    void = (times[:, None] >= trace.steps[:shown])[:, None]
    last = len(beliefs.value) - 1  # all later times are void

    def kept(array: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.where(void, np.float32(np.nan), array[np.minimum(times, last), :, :shown])

    return {
        "believed_time": times * trace.control_period,
        "believed_names": np.array(beliefs.names),
        "believed_value": kept(beliefs.value),
        "believed_deviation": kept(beliefs.deviation),
        "believed_truth": kept(beliefs.truth),
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
        raise ValueError("its arrays do not fit together")
    return arrays
