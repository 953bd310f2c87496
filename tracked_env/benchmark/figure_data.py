"""The part of a chunk of episodes that is kept for the figures, in a file of arrays.

time, error                  error of all episodes at FIGURE_POINTS times
motion                       every channel of the first FIGURE_EPISODES, NaN after their end
believed_time, _names,       of a policy that estimates: value, standard deviation and truth
  _value, _deviation, _truth (points, parameters, episodes) of the same episodes
control_period               [s]
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.identification_metrics import Beliefs
from tracked_env.benchmark.metrics import CHANNELS, Trace, counted_error

FIGURE_EPISODES = 4  # whose motion is kept in full
FIGURE_POINTS = 300  # times at which error and beliefs are kept


def _thinned(steps: int) -> NDArray[np.int64]:
    """At most FIGURE_POINTS of `steps` rows, first and last among them."""
    return np.unique(np.linspace(0, steps - 1, FIGURE_POINTS).astype(np.int64))


def figure_data(trace: Trace, beliefs: Beliefs | None = None) -> dict[str, NDArray[Any]]:
    """The arrays of the head of this file, from a whole chunk."""
    error = counted_error(trace)
    times = _thinned(len(error))
    few = trace.values[:, :FIGURE_EPISODES].astype(np.float32)
    few[~trace.driven()[:, :FIGURE_EPISODES]] = np.nan
    return {
        "time": (times + 1) * trace.control_period,
        "error": error[times].astype(np.float32),
        "motion": few,
        "control_period": np.array(trace.control_period),
        **({} if beliefs is None else _believed(trace, beliefs)),
    }


def _believed(trace: Trace, beliefs: Beliefs) -> dict[str, NDArray[Any]]:
    """The beliefs of the first episodes, NaN after their end."""
    times = _thinned(len(beliefs.value))
    void = (times[:, None] >= trace.steps[:FIGURE_EPISODES])[:, None]

    def kept(array: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.where(void, np.float32(np.nan), array[times, :, :FIGURE_EPISODES])

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
    shapes = {"time": 1, "error": 2, "motion": 3, "control_period": 0}
    if "believed_names" in arrays:
        shapes |= {"believed_time": 1, "believed_names": 1}
        shapes |= dict.fromkeys(("believed_value", "believed_deviation", "believed_truth"), 3)
    for name, dimensions in shapes.items():
        kind = "U" if name == "believed_names" else "f"
        if arrays[name].ndim != dimensions or arrays[name].dtype.kind != kind:
            raise ValueError(f"{name} has shape {arrays[name].shape}, type {arrays[name].dtype}")
    motion = arrays["motion"]
    sizes: list[tuple[Any, Any]] = [
        (len(arrays["time"]), len(arrays["error"])),
        (motion.shape[2], len(CHANNELS)),
    ]
    if "believed_names" in arrays:
        size = (len(arrays["believed_time"]), len(arrays["believed_names"]), motion.shape[1])
        for part in ("value", "deviation", "truth"):
            sizes.append((arrays[f"believed_{part}"].shape, size))
    if any(one != other for one, other in sizes) or not motion.size:
        raise ValueError("its arrays do not fit together")
    return arrays
