"""Whether the state in a checkpoint fits the environment that is to go on from it.

Kernels index arrays without looking at their bounds, so a state of another shape could make them
write anywhere: the state is compared with that of the fresh environment, and the whole numbers
that kernels take for places in arrays with the sizes of these.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import recursive_getattr

from tracked_env.engine import columns as b
from tracked_env.physics.parameter_events import KINDS
from tracked_env.physics.parameters import PARAMETER_ROWS

_NUMBERS = (bool, int, float, np.generic)
# Arrays of the simulation that grow, and along which axis.
_GROWING = {"Batch.events": 1, "Batch.history": 1, "Episode.events": 0}


def _shape(array: Any, where: str) -> tuple[int, ...]:
    """Its shape, without the axis along which it grows."""
    axis = next((axis for name, axis in _GROWING.items() if where.endswith(name)), None)
    return tuple(length for i, length in enumerate(array.shape) if i != axis)


def _refuse(where: str, given: Any, expected: Any) -> None:
    raise ValueError(f"{where} = {repr(given)[:80]}; must be {str(expected)[:80]}")


def check(expected: Any, given: Any, where: str) -> None:
    """Raises ValueError where `given` has other types, names or shapes than `expected`.

    What is None in `expected`, or an array without elements, may be anything.
    """
    if expected is None or (isinstance(expected, np.ndarray) and not expected.size):
        return
    if isinstance(expected, _NUMBERS) or (
        isinstance(expected, np.ndarray) and not expected.ndim
    ):  # NumPy turns an array of one number into a number as it likes
        if not isinstance(given, (*_NUMBERS, np.ndarray)) or np.shape(given) != ():
            _refuse(where, given, "a number")
        if given != given and expected == expected:
            _refuse(where, given, "a number, not NaN")
    elif isinstance(expected, (np.ndarray, torch.Tensor)):
        if type(given) is not type(expected):
            _refuse(where, given, "an array")
        wanted = expected.dtype, len(expected.shape), _shape(expected, where)
        found = given.dtype, len(given.shape), _shape(given, where)
        if wanted != found:
            _refuse(where, found, wanted)
    elif isinstance(expected, dict):
        if not isinstance(given, dict) or set(given) != set(expected):
            _refuse(where, given, f"a dict of {sorted(map(str, expected))}")
        for name, part in expected.items():
            check(part, given[name], f"{where}.{name}")
    elif isinstance(expected, (list, tuple)):
        if type(given) is not type(expected) or len(given) != len(expected):
            _refuse(where, given, f"{len(expected)} entries of a {type(expected).__name__}")
        names = getattr(expected, "_fields", range(len(expected)))
        inside = type(expected).__name__ if hasattr(expected, "_fields") else where
        for name, part, its in zip(names, expected, given, strict=True):
            check(part, its, f"{inside}.{name}")
        if isinstance(expected, b.Batch):
            _check_places(expected, given)
    elif type(given) is not type(expected):
        _refuse(where, given, f"a {type(expected).__name__}")


def check_curve(curve: Any) -> None:
    """Raises ValueError for a learning curve that is none."""
    if not isinstance(curve, list):
        _refuse("curve", curve, "a list of rows")
    for row in curve:
        check((0, 0.0, 0.0, np.nan, np.nan), row, "curve")


def check_parameters(model: BaseAlgorithm, given: Any) -> None:
    """Networks and optimisers in a checkpoint. Raises ValueError where they are not the model's."""
    fresh = model.get_parameters()
    check(dict.fromkeys(fresh), given, "parameters")
    for name, expected in fresh.items():
        if "param_groups" not in expected:
            check(expected, given[name], name)
        else:
            _check_optimiser(recursive_getattr(model, name), expected, given[name], name)


def _check_optimiser(optimiser: Any, expected: Any, given: Any, where: str) -> None:
    """Settings and moments of an optimiser. Raises ValueError."""
    check(dict.fromkeys(expected), given, where)
    check(expected["param_groups"], given["param_groups"], where)
    for ours, its in zip(expected["param_groups"], given["param_groups"], strict=True):
        if {**ours, "lr": 0.0} != {**its, "lr": 0.0}:  # the rate falls; all else stays
            _refuse(where, its, ours)
    tensors = [tensor for group in optimiser.param_groups for tensor in group["params"]]
    for number, moments in given["state"].items():
        tensor = tensors[number].data
        wanted = {"step": torch.tensor(0.0), "exp_avg": tensor, "exp_avg_sq": tensor}
        check(wanted, moments, f"{where}.{number}")


def _check_places(fresh: b.Batch, given: b.Batch) -> None:
    """Raises ValueError for numbers in a batch that kernels would take for places outside it."""
    counters = given.counters
    steps = fresh.counters[:, b.MAX_STEP].max()

    def column(first: int, low: int, high: float, width: int = 1) -> None:
        values = counters[:, first : first + width]
        if not ((values >= low) & (values <= high)).all():
            _refuse(f"Batch.counters {first}", values.ravel(), f"within [{low}, {high:.0f}]")

    if given.events.shape[1] < 1 or given.history.shape[1] < 1:
        _refuse("Batch", (given.events.shape, given.history.shape), "events and history")
    column(b.STEP, 0, steps)
    column(b.MAX_STEP, 0, steps)
    column(b.NOISE_CURSOR, -1, b.NOISE_BLOCK - 1)
    column(b.EVENT_COUNT, 0, given.events.shape[1])
    column(b.PERIOD, 1, np.inf, b.GROUP_COUNT)
    column(b.DELAY, 0, np.inf, b.GROUP_COUNT)
    _check_events(given.events, counters[:, b.EVENT_COUNT])


def _check_events(events: NDArray[np.float64], counts: NDArray[np.int64]) -> None:
    """Raises ValueError for a kind of change or a parameter that does not exist."""
    used = events[np.arange(events.shape[1]) < counts[:, None]]
    for column, size in ((0, max(KINDS.values()) + 1), (1, PARAMETER_ROWS)):
        if not ((used[:, column] >= 0) & (used[:, column] < size)).all():
            _refuse("Batch.events", used[:, column], f"within [0, {size})")
