"""The state of a training as one file of plain data: JSON for its shape, npy records for arrays.

    numbers, text, lists         as JSON has them; exact, as floats are written with all digits
    everything else              {"tag": ...}, of the tags below
    arrays, tensors              their number in the file of arrays, one record after the other
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
STATE, ARRAYS = "state.json", "arrays.npy"
_NUMERIC = "biufc"  # kinds of arrays: whole and real numbers, no objects


class _Writer:
    """Turns a state into a tree for JSON; its arrays are numbered."""

    def __init__(self) -> None:
        self.arrays: list[Any] = []
        self._numbers: dict[int, tuple[int, Any]] = {}  # by identity; holds the arrays themselves

    def _array(self, value: Any) -> int:
        """Its number among the arrays."""
        if id(value) not in self._numbers:
            if value.dtype.kind not in _NUMERIC:
                raise TypeError(f"an array of {value.dtype} cannot be written")
            self._numbers[id(value)] = len(self.arrays), value
            self.arrays.append(np.asarray(value))
        return self._numbers[id(value)][0]

    def tree(self, value: Any) -> Any:
        """A value as JSON knows it. Raises TypeError for a type that is not written."""
        if value is None or type(value) in (bool, int, float, str):
            return value
        if type(value) is list:
            return [self.tree(part) for part in value]
        return dict([self._tagged(value)])

    def _tagged(self, value: Any) -> tuple[str, Any]:
        name = type(value).__name__
        if isinstance(value, (np.ndarray, np.generic)):
            return "array" if isinstance(value, np.ndarray) else "number", self._array(value)
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
        if TYPES.get(name) == type(value).__module__:
            return "named", [name, self.tree(list(value))]
        raise TypeError(
            f"a {name} cannot be written; a named tuple has to stand in agents.state_file.TYPES"
        )


def _named(content: Any) -> Any:
    name, parts = content
    return getattr(import_module(TYPES[name]), name)(*parts)


def _generator(state: Any) -> np.random.Generator:
    generator = GENERATORS[state["bit_generator"]]()
    generator.state = state
    return np.random.Generator(generator)


def write_state(path: Path, state: Mapping[str, Any]) -> None:
    """Write a state. Raises TypeError for a type that `read_state` does not know."""
    writer = _Writer()
    tree = writer.tree(dict(state))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(STATE, json.dumps(tree))
        with archive.open(ARRAYS, "w", force_zip64=True) as file:
            for array in writer.arrays:
                npy.write_array(file, array, allow_pickle=False)


def read_state(path: Path) -> dict[str, Any]:
    """A state that `write_state` wrote. Raises ValueError for anything else."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_unpacked(archive, path.stat().st_size)  # nothing in it is compressed
            if archive.testzip() is not None:
                raise ValueError("its checksum is wrong")
            arrays = []
            with archive.open(ARRAYS) as file:
                while file.tell() < archive.getinfo(ARRAYS).file_size:
                    arrays.append(npy.read_array(file, allow_pickle=False))
            built: dict[str, Callable[[Any], Any]] = {
                "number": lambda number: arrays[number][()],
                "array": arrays.__getitem__,
                "tensor": lambda number: torch.from_numpy(arrays[number]),
                "dict": dict,
                "deque": lambda content: deque(content[1], content[0]),
                "generator": _generator,
                "tuple": tuple,
                "named": _named,
            }

            def value(tagged: dict[str, Any]) -> Any:
                ((tag, content),) = tagged.items()
                return built[tag](content)

            state = json.loads(archive.read(STATE), object_hook=value)
        if not isinstance(state, dict):
            raise ValueError("it holds no state")
        return state
    except Exception as error:  # damaged files raise what happens to go wrong
        raise ValueError(f"{type(error).__name__}: {str(error)[:200]}") from error
