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
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.lib import format as npy
from numpy.typing import NDArray

from tracked_env.validation import check_unpacked

# Named tuples that the state of a training consists of, by name: the module where it stands. An
# augmentation with one of its own adds it.
TYPES = {
    "AdaptiveSlipState": "baselines.lyapunov.slippage_aware",
    "AdaptiveState": "baselines.linearizing.adaptive_policy",
    "Batch": "tracked_env.arrays",
    "Episode": "tracked_env.engine.episode",
    "LyapunovState": "baselines.lyapunov.slippage_aware",
    "PlantParameters": "tracked_env.physics.parameters",
    "ReferenceProfile": "tracked_env.references.profile",
    "RNNStates": "sb3_contrib.common.recurrent.type_aliases",
    "Running": "tracked_env.engine.reset",
    "SensorDraw": "tracked_env.sensors",
    "VehicleState": "tracked_env.physics.parameters",
}
GENERATORS: dict[str, Any] = {kind.__name__: kind for kind in (np.random.PCG64, np.random.SFC64)}
STATE = "state.json"
_NUMERIC = "biufc"  # kinds of arrays: whole and real numbers, no objects


class _Writer:
    """Turns a state into a tree for JSON; its arrays go into one pool for each type."""

    def __init__(self) -> None:
        self.table: list[list[Any]] = []
        self.pools: dict[str, list[NDArray[Any]]] = {}
        self._sizes: dict[str, int] = {}
        self._numbers: dict[int, tuple[int, Any]] = {}  # by identity; holds the arrays themselves

    def _array(self, value: NDArray[Any]) -> int:
        """Its number in the table."""
        if id(value) not in self._numbers:
            if value.dtype.kind not in _NUMERIC:
                raise TypeError(f"an array of {value.dtype} cannot be written")
            turned = value.flags.f_contiguous and not value.flags.c_contiguous
            kind = value.dtype.str
            first = self._sizes.get(kind, 0)
            self.pools.setdefault(kind, []).append((value.T if turned else value).ravel())
            self._sizes[kind] = first + value.size
            self._numbers[id(value)] = len(self.table), value
            self.table.append([kind, first, list(value.shape), turned])
        return self._numbers[id(value)][0]

    def tree(self, value: Any) -> Any:
        """A value as JSON knows it. Raises TypeError for a type that is not written."""
        if value is None or type(value) in (bool, int, float, str):
            return value
        if type(value) is list:
            return [self.tree(part) for part in value]
        return dict([self._tagged(value)])

    def _tagged(self, value: Any) -> tuple[str, Any]:
        if isinstance(value, np.generic) and value.dtype.kind in _NUMERIC:
            return "number", [value.dtype.str, self.tree(value.item())]
        if isinstance(value, np.ndarray):
            return "array", self._array(value)
        if isinstance(value, torch.Tensor):
            return "tensor", self._array(value.detach().cpu().numpy())
        if type(value) in (dict, OrderedDict):
            return "dict", [[self.tree(key), self.tree(part)] for key, part in value.items()]
        if type(value) is deque:
            return "deque", [value.maxlen, self.tree(list(value))]
        if isinstance(value, np.random.Generator):
            state = value.bit_generator.state
            if state["bit_generator"] in GENERATORS:
                return "generator", self.tree(state)
        if type(value) is tuple:
            return "tuple", self.tree(list(value))
        name = type(value).__name__
        if TYPES.get(name) == type(value).__module__:
            return "named", [name, self.tree(list(value))]
        raise TypeError(
            f"a {name} cannot be written; a named tuple has to stand in agents.state_file.TYPES"
        )


class _Reader:
    """Turns the tree back. Raises ValueError for what no writer has written."""

    def __init__(self, table: Any, pools: Mapping[str, NDArray[Any]]) -> None:
        self._table, self._pools = table, pools
        self._arrays: dict[int, NDArray[Any]] = {}
        self._tags: dict[str, Callable[[Any], Any]] = {
            "number": self._number,
            "array": self._array,
            "tensor": lambda number: torch.from_numpy(self._array(number)),
            "dict": lambda pairs: {self.value(key): self.value(part) for key, part in pairs},
            "deque": lambda content: deque(self.value(content[1]), content[0]),
            "generator": self._generator,
            "tuple": lambda parts: tuple(self.value(parts)),
            "named": self._named,
        }

    def value(self, tree: Any) -> Any:
        """What a tree stands for."""
        if isinstance(tree, list):
            return [self.value(part) for part in tree]
        if not isinstance(tree, dict):
            return tree
        ((tag, content),) = tree.items()
        return self._tags[tag](content)

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

    def _number(self, content: Any) -> Any:
        kind = np.dtype(content[0])
        if kind.kind not in _NUMERIC:
            raise ValueError(f"a number of type {kind}")
        return kind.type(self.value(content[1]))

    def _named(self, content: Any) -> Any:
        name, parts = content
        return getattr(import_module(TYPES[name]), name)(*self.value(parts))

    def _generator(self, content: Any) -> np.random.Generator:
        state = self.value(content)
        generator = GENERATORS[state["bit_generator"]]()
        generator.state = state
        return np.random.Generator(generator)


def write_state(path: Path, state: Mapping[str, Any]) -> None:
    """Write a state. Raises TypeError for a type that `read_state` does not know."""
    writer = _Writer()
    tree = writer.tree(dict(state))
    content = json.dumps({"arrays": writer.table, "state": tree})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(STATE, content)
        for kind, parts in writer.pools.items():
            with archive.open(f"{kind}.npy", "w", force_zip64=True) as file:
                npy.write_array(file, np.concatenate(parts), allow_pickle=False)


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
