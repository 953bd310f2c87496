"""Checkpoints of a training: everything that its next step depends on, in one file.

    learner     of `Learner.capture`: networks, optimisers, counters, replay buffer, environment
                layer by layer (vehicles, soils and noise streams in mid-episode, augmentation,
                normalisation), random states of Python, NumPy, PyTorch and the exploration
    progress    learning curve, best agent, times
A training that goes on from here does what it would have done: same parameters, bit for bit.
The file is plain data, JSON for its shape and npy records for arrays:
    numbers, text, lists         as JSON has them; exact, as floats are written with all digits
    everything else              {"tag": ...}, of the tags below
    arrays, tensors              their number in the file of arrays, one record after the other
Reading one builds nothing but these, the named tuples in TYPES and the generators in GENERATORS:
no pickle, so a stranger's file runs no code. Two references to one array stay one. It is
written beside the one before, which is kept until the new one is whole. Kernels index arrays
without looking at their bounds, so a state of another shape could make them write anywhere: `check`
compares it with that of the fresh training, and the whole numbers that kernels take for places in
arrays with the sizes of these.
"""

import json
import os
import random
import sys
import zipfile
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.lib import format as npy
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.save_util import recursive_getattr, recursive_setattr
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor, VecNormalize

from agents.environments import AgentVectorEnv, JoinedVecEnv
from tracked_env import arrays as b
from tracked_env.benchmark.files import temporary
from tracked_env.engine.simulation import Simulation
from tracked_env.events import KINDS
from tracked_env.physics.parameters import PARAMETER_ROWS
from tracked_env.uncertainty.drawing_laws import RECORD
from tracked_env.validation import check_unpacked
from tracked_env.vector_env import TrackedVehicleVectorEnv

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
        if isinstance(value, np.ndarray) and value.dtype == RECORD:
            return "records", self._array(value.view(np.float64).reshape(len(value), -1))
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
            f"a {name} cannot be written; a named tuple has to stand in agents.checkpoint.TYPES"
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
                "records": lambda number: arrays[number].view(RECORD)[:, 0],
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


# --- the checkpoint --------------------------------------------------------------------------
FILE, PREVIOUS = "checkpoint.zip", "checkpoint-before.zip"
FORMAT = 5
_NUMBERS = (bool, int, float, np.generic)
_GROWING = {"Batch.events": 1, "Batch.history": 1, "Episode.events": 0}  # along which axis


# The files


def put_back(captured: Mapping[str, Any], learner: Any, progress: Any) -> None:
    """Let a fresh learner and its progress go on from a checkpoint.

    Raises ValueError for one that could be read and is not of this training.
    """
    try:
        learner.resume(captured["learner"])
        progress.resume(captured["progress"])
    except Exception as error:  # what is not as `capture` left it raises what happens to go wrong
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        raise ValueError(
            f"the checkpoint does not fit this training ({reason}). Was it changed, or written by "
            "another version? Give --overwrite to train anew"
        ) from error


def write(folder: Path, state: Mapping[str, Any]) -> None:
    """Write a checkpoint; until it is whole, the one before stays. A kill loses neither."""
    partial = temporary(folder / FILE)
    try:
        write_state(partial, {"format": FORMAT, **state})
        if (folder / FILE).exists():
            os.replace(folder / FILE, folder / PREVIOUS)
        os.replace(partial, folder / FILE)
    finally:
        partial.unlink(missing_ok=True)


def present(folder: Path) -> list[Path]:
    """The checkpoints in a folder, the latest first."""
    return [path for path in (folder / FILE, folder / PREVIOUS) if path.exists()]


def read(folder: Path) -> dict[str, Any] | None:
    """The latest whole checkpoint of a folder, None where there is none; a damaged one is said.

    Raises ValueError when there are checkpoints, but all are damaged.
    """
    damaged: list[str] = []
    for path in present(folder):
        try:
            state = read_state(path)
            if state.get("format") != FORMAT:
                raise ValueError(f"must be of format {FORMAT}")
        except ValueError as error:
            damaged.append(f"checkpoint {path} is damaged: {error}")
            continue
        for text in damaged:
            print(f"{text}; going on from the one before", file=sys.stderr)
        return state
    if damaged:
        raise ValueError(
            f"{'; '.join(damaged)}. Nothing to resume: delete {folder} and train anew."
        )
    return None


def remove(folder: Path) -> None:
    """Delete the checkpoints of a folder."""
    for path in (folder / FILE, folder / PREVIOUS, *folder.glob(f".{FILE}*.tmp")):
        path.unlink(missing_ok=True)


# Whether a state fits


def _refuse(where: str, value: Any, expected: Any) -> None:
    raise ValueError(f"{where} = {repr(value)[:80]}; must be {str(expected)[:80]}")


def _form(array: Any, where: str) -> tuple[Any, ...]:
    """Type, axes and lengths of an array, without the axis along which it grows."""
    axis = next((axis for name, axis in _GROWING.items() if where.endswith(name)), None)
    lengths = tuple(length for i, length in enumerate(array.shape) if i != axis)
    return array.dtype, len(array.shape), lengths


def check(expected: Any, value: Any, where: str) -> None:
    """Raises ValueError where `value` has other types, names or shapes than `expected`.

    What is None in `expected`, or an array without elements, may be anything.
    """
    if expected is None or (isinstance(expected, np.ndarray) and not expected.size):
        return
    if isinstance(expected, _NUMBERS) or (
        isinstance(expected, np.ndarray) and not expected.ndim
    ):  # NumPy turns an array of one number into a number as it likes
        if not isinstance(value, (*_NUMBERS, np.ndarray)) or np.shape(value) != ():
            _refuse(where, value, "a number")
        if value != value and expected == expected:
            _refuse(where, value, "a number, not NaN")
    elif isinstance(expected, (np.ndarray, torch.Tensor)):
        if type(value) is not type(expected):
            _refuse(where, value, "an array")
        if _form(value, where) != _form(expected, where):
            _refuse(where, _form(value, where), _form(expected, where))
    elif isinstance(expected, dict):
        if not isinstance(value, dict) or set(value) != set(expected):
            _refuse(where, value, f"a dict of {sorted(map(str, expected))}")
        for name, part in expected.items():
            check(part, value[name], f"{where}.{name}")
    elif isinstance(expected, (list, tuple)):
        if type(value) is not type(expected) or len(value) != len(expected):
            _refuse(where, value, f"{len(expected)} entries of a {type(expected).__name__}")
        names = getattr(expected, "_fields", range(len(expected)))
        inside = type(expected).__name__ if hasattr(expected, "_fields") else where
        for name, part, its in zip(names, expected, value, strict=True):
            check(part, its, f"{inside}.{name}")
        if isinstance(expected, b.Batch):
            _check_places(expected, value)
    elif type(value) is not type(expected):
        _refuse(where, value, f"a {type(expected).__name__}")


def _check_places(fresh: b.Batch, batch: b.Batch) -> None:
    """Raises ValueError for numbers in a batch that kernels would take for places outside it."""
    counters, events = batch.counters, batch.events
    steps = fresh.counters[:, b.MAX_STEP].max()
    if events.shape[1] < 1 or batch.history.shape[1] < 1:
        _refuse("Batch", (events.shape, batch.history.shape), "events and history")
    for first, width, low, high in (
        (b.STEP, 1, 0, steps),
        (b.MAX_STEP, 1, 0, steps),
        (b.NOISE_CURSOR, 1, -1, b.NOISE_BLOCK - 1),
        (b.EVENT_COUNT, 1, 0, events.shape[1]),
        (b.PERIOD, b.GROUP_COUNT, 1, np.inf),
        (b.DELAY, b.GROUP_COUNT, 0, np.inf),
    ):
        values = counters[:, first : first + width]
        if not ((values >= low) & (values <= high)).all():
            _refuse(f"Batch.counters {first}", values.ravel(), f"within [{low}, {high:.0f}]")
    used = events[np.arange(events.shape[1]) < counters[:, b.EVENT_COUNT, None]]
    for column, size in ((0, max(KINDS.values()) + 1), (1, PARAMETER_ROWS)):  # kind, parameter
        if not ((used[:, column] >= 0) & (used[:, column] < size)).all():
            _refuse("Batch.events", used[:, column], f"within [0, {size})")


def _check_parameters(model: BaseAlgorithm, parameters: Any) -> None:
    """Networks and optimisers in a checkpoint. Raises ValueError where they are not the model's."""
    fresh = model.get_parameters()
    optimisers = [name for name in fresh if "param_groups" in fresh[name]]
    form = {name: {**fresh[name], "state": None} for name in optimisers}
    check(fresh | form, parameters, "parameters")
    for name in optimisers:
        groups = fresh[name]["param_groups"], parameters[name]["param_groups"]
        for ours, its in zip(*groups, strict=True):
            if {**ours, "lr": 0.0} != {**its, "lr": 0.0}:  # the rate falls; all else stays
                _refuse(name, its, ours)
        live = recursive_getattr(model, name).param_groups
        tensors = [tensor.data for group in live for tensor in group["params"]]
        for number, moments in parameters[name]["state"].items():
            moment = dict.fromkeys(("exp_avg", "exp_avg_sq"), tensors[number])
            check({"step": torch.tensor(0.0), **moment}, moments, f"{name}.{number}")


# The environment

_STATISTICS = tuple(
    f"{of}.{name}" for of in ("obs_rms", "ret_rms") for name in ("mean", "var", "count")
)
# What layers remember, by the names of their attributes.
_REMEMBERED: dict[type, tuple[str, ...]] = {
    VecNormalize: ("returns", "old_obs", "old_reward", *_STATISTICS),
    VecMonitor: ("episode_returns", "episode_lengths", "episode_count"),
}


def layers(env: Any) -> list[Any]:
    """The environment's wrappers from the outside in; last the joined one, or the simulation.

    Raises AttributeError where the wrappers do not lead to one.
    """
    wrappers = [env]
    while not isinstance(env, (Simulation, JoinedVecEnv)):
        inner = "simulation" if isinstance(env, TrackedVehicleVectorEnv) else "env"
        env = env.venv if isinstance(env, VecEnvWrapper) else getattr(env, inner)
        wrappers.append(env)
    return wrappers


def capture_environment(env: VecEnv | None) -> list[Any]:
    """What each layer remembers, in the order of `layers`; None where it is nothing."""

    def captured(layer: Any) -> Any:
        if isinstance(layer, JoinedVecEnv):
            return [capture_environment(part) for part in layer.parts]
        if isinstance(layer, (AgentVectorEnv, Simulation)):
            return layer.snapshot()
        names = _REMEMBERED.get(type(layer), ())
        return {name: recursive_getattr(layer, name) for name in names} or None

    return [captured(layer) for layer in layers(env)]


def resume_environment(env: Any, states: list[Any]) -> None:
    """Put back what `capture_environment` took, into an environment of the same arguments.

    Raises ValueError, before anything is put back, for what another environment has left.
    """
    env.reset()  # now it has everything that the states are compared with
    check(capture_environment(env), states, "environment")
    _put_back(env, states)


def _put_back(env: Any, states: list[Any]) -> None:
    for layer, state in zip(layers(env), states, strict=True):
        if isinstance(layer, JoinedVecEnv):
            for part, its in zip(layer.parts, state, strict=True):
                _put_back(part, its)
        elif isinstance(layer, (AgentVectorEnv, Simulation)):
            layer.resume(state)
        else:
            for name, value in (state or {}).items():
                recursive_setattr(layer, name, value)


# Models of Stable-Baselines3

_MODEL = (  # attributes of a model that change while it learns
    "num_timesteps", "_episode_num", "_n_updates", "_last_obs", "_last_episode_starts",
    "_last_original_obs", "_current_progress_remaining", "ep_info_buffer", "ep_success_buffer",
)  # fmt: skip
_SAMPLES = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_ENDED = {"r": 0.0, "l": 0, "t": 0.0}  # what VecMonitor says of an episode


def _samples(model: BaseAlgorithm) -> dict[str, Any] | None:
    """The rows of a replay buffer that have been written, None where there is no buffer."""
    if not isinstance(model, OffPolicyAlgorithm):
        return None
    buffer: Any = model.replay_buffer
    arrays = {name: getattr(buffer, name)[: buffer.size()] for name in _SAMPLES}
    return {"pos": buffer.pos, "full": buffer.full, "arrays": arrays}


def _put_samples_back(model: Any, samples: Any) -> None:
    buffer = model.replay_buffer
    position, full = int(samples["pos"]), bool(samples["full"])
    if not 0 <= position < buffer.buffer_size:
        raise ValueError(f"pos = {position}; must be in [0, {buffer.buffer_size})")
    filled = buffer.buffer_size if full else position
    for name in _SAMPLES:
        stored, rows = samples["arrays"][name], getattr(buffer, name)[:filled]
        check(rows, stored, name)
        rows[:] = stored
    buffer.pos, buffer.full = position, full


def capture_model(model: BaseAlgorithm) -> dict[str, Any]:
    """Everything that the next rollout of a model depends on.

    Raises AttributeError where the installed Stable-Baselines3 lacks an attribute of _MODEL.
    """
    _, variables = model._get_torch_save_params()
    recurrent = ("_last_lstm_states",) if isinstance(model, RecurrentPPO) else ()
    return {
        "parameters": model.get_parameters(),
        "variables": {name: recursive_getattr(model, name) for name in variables},
        "attributes": {name: getattr(model, name) for name in (*_MODEL, *recurrent)},
        "samples": _samples(model),
        "environment": capture_environment(model.get_env()),
        "random": {  # the streams that the whole process shares, and that of the exploration
            "python": random.getstate(),
            "numpy": np.random.get_state(),  # noqa: NPY002, what SB3 draws from
            "torch": torch.get_rng_state(),
            "action": model.action_space.np_random.bit_generator.state,
        },
    }


def resume_model(model: BaseAlgorithm, captured: Mapping[str, Any]) -> None:
    """Put everything that `capture_model` took into a fresh model of the same configuration.

    Raises any exception where it does not fit.
    """
    env: Any = model.get_env()
    model._last_obs = env.reset()  # now it has everything that the checkpoint must have
    fresh = capture_model(model)
    fresh["attributes"].update(
        _last_episode_starts=np.ones(env.num_envs, dtype=bool),
        ep_info_buffer=deque(),
        ep_success_buffer=deque(),
    )
    if model.get_vec_normalize_env() is not None:
        fresh["attributes"]["_last_original_obs"] = model._last_obs
    for part in ("variables", "random", "attributes"):
        check(fresh[part], captured[part], part)
    attributes, states = captured["attributes"], captured["random"]
    for success in attributes["ep_success_buffer"]:
        check(False, success, "ep_success_buffer")
    for info in attributes["ep_info_buffer"]:
        check(_ENDED, {name: info[name] for name in _ENDED}, "ep_info_buffer")
    _check_parameters(model, captured["parameters"])
    resume_environment(env, captured["environment"])
    model.set_parameters(captured["parameters"], exact_match=True, device="cpu")
    for name, value in captured["variables"].items():
        if value is not None:
            recursive_setattr(model, f"{name}.data", value.data)
    for name in fresh["attributes"]:
        setattr(model, name, attributes[name])
    if isinstance(model, OffPolicyAlgorithm):
        _put_samples_back(model, captured["samples"])
    random.setstate(states["python"])
    np.random.set_state(states["numpy"])  # noqa: NPY002
    torch.set_rng_state(states["torch"])
    model.action_space.np_random.bit_generator.state = states["action"]
