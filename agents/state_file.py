"""The state of a training as one file of plain data: JSON for its shape, npy files for arrays.

    numbers, text, lists         as JSON has them; exact, as floats are written with all digits
    everything else              {"tag": ...}, of the tags below
    arrays, tensors              a number in a table: type, where in the file of that type, shape
Reading one builds nothing but these, the named tuples in TYPES and the generators in GENERATORS:
no pickle, so a stranger's file runs no code. Two references to one array stay one.
"""

import json
import zipfile
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.lib import format as npy
from numpy.typing import NDArray
from sb3_contrib.common.recurrent.type_aliases import RNNStates

from baselines.linearizing.adaptive_policy import AdaptiveState
from baselines.lyapunov.adaptive_slippage_aware import AdaptiveSlipState
from baselines.lyapunov.slippage_aware import LyapunovState
from tracked_env.arrays import Batch
from tracked_env.engine.episode import Episode, SensorDraw
from tracked_env.engine.reset import Running
from tracked_env.physics.parameters import PlantParameters, VehicleState
from tracked_env.references import ReferenceProfile
from tracked_env.validation import check_unpacked

# What the state of a training consists of. An augmentation with a named tuple of
# its own adds it here.
TYPES: dict[str, Any] = {
    made.__name__: made
    for made in (
        AdaptiveSlipState, AdaptiveState, Batch, Episode, LyapunovState, PlantParameters,
        ReferenceProfile, RNNStates, Running, SensorDraw, VehicleState,
    )
}  # fmt: skip
GENERATORS: dict[str, Any] = {made.__name__: made for made in (np.random.PCG64, np.random.SFC64)}
STATE = "state.json"
_NUMERIC = "biufc"  # kinds of arrays: whole and real numbers, no objects


class _Writer:
    """Turns a state into a tree for JSON; its arrays go into one pool for each type."""

    def __init__(self) -> None:
        self.table: list[list[Any]] = []
        self._pools: dict[str, list[NDArray[Any]]] = {}
        self._sizes: dict[str, int] = {}
        self._known: dict[int, tuple[int, Any]] = {}  # by identity; holds them, so that it lasts

    def pools(self) -> dict[str, NDArray[Any]]:
        """All elements of each type of arrays."""
        return {kind: np.concatenate(parts) for kind, parts in self._pools.items()}

    def _array(self, value: NDArray[Any]) -> int:
        """Its number in the table."""
        if id(value) in self._known:
            return self._known[id(value)][0]
        if value.dtype.kind not in _NUMERIC:
            raise TypeError(f"an array of {value.dtype} cannot be written")
        turned = value.flags.f_contiguous and not value.flags.c_contiguous
        kind = value.dtype.str
        first = self._sizes.get(kind, 0)
        self._pools.setdefault(kind, []).append((value.T if turned else value).ravel())
        self._sizes[kind] = first + value.size
        self.table.append([kind, first, list(value.shape), turned])
        self._known[id(value)] = len(self.table) - 1, value
        return len(self.table) - 1

    def tree(self, value: Any) -> Any:
        """A value as JSON knows it. Raises TypeError for a type that is not written."""
        if value is None or type(value) in (bool, int, float, str):
            return value
        if type(value) is list:
            return [self.tree(part) for part in value]
        return self._tagged(value)

    def _tagged(self, value: Any) -> dict[str, Any]:
        if isinstance(value, np.generic) and value.dtype.kind in _NUMERIC:
            return {"number": [value.dtype.str, self.tree(value.item())]}
        if isinstance(value, np.ndarray):
            return {"array": self._array(value)}
        if isinstance(value, torch.Tensor):
            return {"tensor": self._array(value.detach().cpu().numpy())}
        if type(value) in (dict, OrderedDict):
            return {"dict": [[self.tree(key), self.tree(part)] for key, part in value.items()]}
        if type(value) is deque:
            return {"deque": [value.maxlen, self.tree(list(value))]}
        if isinstance(value, np.random.Generator):
            state = value.bit_generator.state
            if state["bit_generator"] in GENERATORS:
                return {"generator": self.tree(state)}
        if type(value) is tuple:
            return {"tuple": self.tree(list(value))}
        if TYPES.get(type(value).__name__) is type(value):
            return {"named": [type(value).__name__, self.tree(list(value))]}
        raise TypeError(
            f"a {type(value).__name__} cannot be written; a named tuple has to stand in "
            "agents.state_file.TYPES"
        )


class _Reader:
    """Turns the tree back. Raises ValueError for what no writer has written."""

    def __init__(self, table: Any, pools: Mapping[str, NDArray[Any]]) -> None:
        self._table, self._pools = table, pools
        self._arrays: dict[int, NDArray[Any]] = {}
        self._tags: dict[str, Callable[[Any], Any]] = {
            "number": self._number, "array": self._array, "tensor": self._tensor,
            "dict": lambda given: {self.value(key): self.value(part) for key, part in given},
            "deque": lambda given: deque(self.value(given[1]), given[0]),
            "generator": self._generator,
            "tuple": lambda given: tuple(self.value(given)),
            "named": lambda given: TYPES[given[0]](*self.value(given[1])),
        }  # fmt: skip

    def value(self, tree: Any) -> Any:
        """What a tree stands for."""
        if isinstance(tree, list):
            return [self.value(part) for part in tree]
        if not isinstance(tree, dict):
            return tree
        ((tag, given),) = tree.items()
        return self._tags[tag](given)

    def _array(self, number: int) -> NDArray[Any]:
        if number not in self._arrays:
            kind, first, shape, turned = self._table[number]
            size = int(np.prod(shape, dtype=np.int64))
            if type(first) is not int or first < 0 or any(length < 0 for length in shape):
                raise ValueError(f"array {number} begins nowhere")
            elements = self._pools[kind][first : first + size].copy()
            array = elements.reshape(shape[::-1]).T if turned else elements.reshape(shape)
            self._arrays[number] = array
        return self._arrays[number]

    def _tensor(self, number: int) -> torch.Tensor:
        return torch.from_numpy(self._array(number))

    def _number(self, given: Any) -> Any:
        kind = np.dtype(given[0])
        if kind.kind not in _NUMERIC:
            raise ValueError(f"a number of type {kind}")
        return kind.type(self.value(given[1]))

    def _generator(self, given: Any) -> np.random.Generator:
        state = self.value(given)
        made = GENERATORS[state["bit_generator"]]()
        made.state = state
        return np.random.Generator(made)


def write_state(path: Path, state: Mapping[str, Any]) -> None:
    """Write a state. Raises TypeError for a type that `read_state` does not know."""
    writer = _Writer()
    tree = writer.tree(dict(state))
    content = json.dumps({"arrays": writer.table, "state": tree})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(STATE, content)
        for kind, elements in writer.pools().items():
            with archive.open(f"{kind}.npy", "w", force_zip64=True) as file:
                npy.write_array(file, elements, allow_pickle=False)


def read_state(path: Path) -> dict[str, Any]:
    """A state that `write_state` wrote. Raises ValueError for anything else."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_unpacked(archive, path.stat().st_size)  # nothing in it is compressed
            if archive.testzip() is not None:
                raise ValueError("its checksum is wrong")
            content = json.loads(archive.read(STATE))
            pools = {}
            for name in set(archive.namelist()) - {STATE}:
                with archive.open(name) as file:
                    elements = npy.read_array(file, allow_pickle=False).ravel()
                pools[elements.dtype.str] = elements
        state = _Reader(content["arrays"], pools).value(content["state"])
        if not isinstance(state, dict):
            raise ValueError("it holds no state")
        return state
    except Exception as error:  # damaged files raise what happens to go wrong
        raise ValueError(f"{type(error).__name__}: {str(error)[:200]}") from error
