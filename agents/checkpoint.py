"""Whether the state in a checkpoint fits the environment that is to go on from it.

Kernels index arrays without looking at their bounds, so a state of another shape could make them
write anywhere: the state is compared with that of the fresh environment, and the whole numbers
that kernels take for places in arrays with the sizes of these.

Checkpoints of a training: everything that its next step depends on, in one file.

    recipe      of the training, with its configuration
    learner     of `Learner.capture`: networks, environment, random states
    progress    learning curve, best agent, times
A training that goes on from here does what it would have done: same parameters, bit for bit.
The file is plain data (`agents.state_file`): reading one runs no code of whoever wrote it.
It is written beside the one before, which is kept until the new one is whole.

What the environment of a training remembers, layer by layer, so that it can go on from there.

vehicles, soils, noise streams     in mid-episode
augmentation and normalisation     of the wrappers

What the next rollout of a model of Stable-Baselines3 depends on.

networks, optimisers, counters     of the algorithm
replay buffer                      of SAC, TD3, TQC
environment                        agents.checkpoint
random states                      of Python, NumPy, PyTorch and the exploration
"""

import os
import random
import secrets
import zipfile
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import stable_baselines3
import torch
from numpy.typing import NDArray
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.save_util import recursive_getattr, recursive_setattr
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

from agents.state_file import read_state, write_state
from agents.vector_envs import AgentVectorEnv, JoinedVecEnv, TruthfulVectorEnv
from tracked_env import arrays as b
from tracked_env.events import KINDS
from tracked_env.physics.parameters import PARAMETER_ROWS
from tracked_env.sb3 import TrackedVehicleVecEnv

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


if TYPE_CHECKING:
    from agents.progress import Learner, Progress

FILE = "checkpoint.zip"
PREVIOUS = "checkpoint-before.zip"
FORMAT = 3


def put_back(captured: Mapping[str, Any], *parts: "Learner | Progress") -> None:
    """Let a fresh learner and its progress go on from a checkpoint.

    Raises ValueError for one that could be read and is not of this training.
    """
    try:
        for name, part in zip(("learner", "progress"), parts, strict=True):
            part.resume(captured[name])
    except Exception as error:  # what is not as `capture` left it raises what happens to go wrong
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        raise ValueError(
            f"the checkpoint does not fit this training ({reason}). Was it changed, or written by "
            "another version? Give --overwrite to train anew"
        ) from error


def write(folder: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint; until it is whole, the one before stays. A kill loses neither."""
    temporary = folder / f".{FILE}.{os.getpid()}-{secrets.token_hex(4)}.tmp"
    try:
        write_state(temporary, {"format": FORMAT, **state})
        if (folder / FILE).exists():
            os.replace(folder / FILE, folder / PREVIOUS)
        os.replace(temporary, folder / FILE)
    finally:
        temporary.unlink(missing_ok=True)


def _load(path: Path) -> dict[str, Any]:
    """Raises ValueError for a damaged file, and for one of another version."""
    try:
        with zipfile.ZipFile(path) as archive:
            pickled = "state.pkl" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        pickled = False  # what is wrong is said below
    if pickled:
        raise ValueError(
            f"checkpoint {path} is of a former version, which pickled it: opening it would run "
            "any code in it"
        )
    try:
        state = read_state(path)
    except ValueError as error:
        raise ValueError(f"checkpoint {path} is damaged: {error}") from error
    recipe = state.get("recipe")
    known = isinstance(recipe, dict) and isinstance(recipe.get("config"), dict)
    if state.get("format") != FORMAT or not known:
        raise ValueError(f"checkpoint {path} is not of format {FORMAT}, or lacks its configuration")
    return state


def read(folder: Path) -> tuple[dict[str, Any] | None, list[str]]:
    """The latest whole checkpoint of a folder, or None where there is none, and what to say.

    Raises ValueError when there are checkpoints, but all are damaged.
    """
    notices: list[str] = []
    for path in (folder / FILE, folder / PREVIOUS):
        if path.exists():
            try:
                return _load(path), notices
            except ValueError as error:
                notices.append(str(error))
    if notices:
        raise ValueError(
            f"{'; '.join(notices)}. Nothing to resume: delete {folder} and train anew."
        )
    return None, []


def exist(folder: Path) -> bool:
    """Whether a folder holds checkpoints."""
    return any((folder / name).exists() for name in (FILE, PREVIOUS))


def remove(folder: Path) -> None:
    """Delete the checkpoints of a folder."""
    for path in (folder / FILE, folder / PREVIOUS, *folder.glob(f".{FILE}*.tmp")):
        path.unlink(missing_ok=True)


_NORMALISE = ("returns", "old_obs", "old_reward")
_RUNNING, _STATISTICS = ("obs_rms", "ret_rms"), ("mean", "var", "count")  # of VecNormalize
_MONITOR = ("episode_returns", "episode_lengths", "episode_count")


def layers(env: VecEnv | None) -> list[Any]:
    """The environment's wrappers from the outside in, the vector or joined environment last.

    Raises RuntimeError where the wrappers do not lead to one.
    """
    found: list[Any] = []
    layer: Any = env
    while layer is not None:
        found.append(layer)
        layer = getattr(layer, "venv", None) or getattr(layer, "env", None)
    if found and not any(isinstance(one, (TrackedVehicleVecEnv, JoinedVecEnv)) for one in found):
        raise RuntimeError(f"no vehicles below {type(found[-1]).__name__}, the last wrapper found")
    return found


def _named(holder: Any, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(holder, name) for name in names}


def capture_environment(env: VecEnv | None) -> list[Any]:
    """What each layer remembers, None where it is nothing; in the order of `layers`."""
    states: list[Any] = []
    for layer in layers(env):
        if isinstance(layer, VecNormalize):
            statistics = {name: _named(getattr(layer, name), _STATISTICS) for name in _RUNNING}
            states.append({**_named(layer, _NORMALISE), **statistics})
        elif isinstance(layer, VecMonitor):
            states.append(_named(layer, _MONITOR))
        elif isinstance(layer, JoinedVecEnv):
            states.append([capture_environment(part) for part in layer.parts])
        elif isinstance(layer, AgentVectorEnv):
            states.append(layer.snapshot())
        elif isinstance(layer, TruthfulVectorEnv):
            states.append((layer.augmentation.present, layer.augmentation.last))
        elif isinstance(layer, TrackedVehicleVecEnv):
            states.append(layer.env.unwrapped.simulation.snapshot())
        else:
            states.append(None)
    return states


def resume_environment(env: VecEnv | None, states: list[Any]) -> None:
    """Put back what `capture_environment` took, into an environment of the same arguments.

    Raises ValueError, before anything is put back, for what another environment has left.
    """
    if env is not None:
        env.reset()  # now it has everything that the states are compared with
    check(capture_environment(env), states, "environment")
    _put_back(env, states)


def _put_back(env: VecEnv | None, states: list[Any]) -> None:
    for layer, state in zip(layers(env), states, strict=True):
        if isinstance(layer, VecNormalize):
            for name in _NORMALISE:
                setattr(layer, name, state[name])
            for name in _RUNNING:
                for part in _STATISTICS:
                    setattr(getattr(layer, name), part, state[name][part])
        elif isinstance(layer, VecMonitor):
            for name in _MONITOR:
                setattr(layer, name, state[name])
        elif isinstance(layer, JoinedVecEnv):
            for joined, its in zip(layer.parts, state, strict=True):
                _put_back(joined, its)
        elif isinstance(layer, AgentVectorEnv):
            layer.resume(state)
        elif isinstance(layer, TruthfulVectorEnv):
            layer.augmentation.present, layer.augmentation.last = state
        elif isinstance(layer, TrackedVehicleVecEnv):
            layer.env.unwrapped.simulation.resume(state)


_MODEL = (  # attributes of a model that change while it learns
    "num_timesteps", "_episode_num", "_n_updates", "_last_obs", "_last_episode_starts",
    "_last_original_obs", "_current_progress_remaining", "ep_info_buffer", "ep_success_buffer",
)  # fmt: skip
_RECURRENT = ("_last_lstm_states",)  # of RecurrentPPO, beside them
_SAMPLES = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_ENDED = {"r": 0.0, "l": 0, "t": 0.0}  # what VecMonitor says of an episode


def capture_random() -> dict[str, Any]:
    """The states of the random streams that the whole process shares."""
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(),  # noqa: NPY002, what SB3 draws from
        "torch": torch.get_rng_state(),
    }


def put_random_back(states: Mapping[str, Any]) -> None:
    """Put back what `capture_random` took."""
    random.setstate(states["python"])
    np.random.set_state(states["numpy"])  # noqa: NPY002
    torch.set_rng_state(states["torch"])


def _samples(model: BaseAlgorithm) -> dict[str, Any] | None:
    """The rows of a replay buffer that have been written, None where there is no buffer."""
    if not isinstance(model, OffPolicyAlgorithm):
        return None
    buffer: Any = model.replay_buffer
    filled = buffer.size()
    arrays = {name: getattr(buffer, name)[:filled] for name in _SAMPLES}
    return {"pos": buffer.pos, "full": buffer.full, "arrays": arrays}


def _put_samples_back(model: BaseAlgorithm, samples: Any) -> None:
    if not isinstance(model, OffPolicyAlgorithm):
        return
    buffer: Any = model.replay_buffer
    position, full = int(samples["pos"]), bool(samples["full"])
    if not 0 <= position < buffer.buffer_size:
        raise ValueError(f"pos = {position}; must be in [0, {buffer.buffer_size})")
    filled = buffer.buffer_size if full else position
    for name in _SAMPLES:
        stored, kept = samples["arrays"][name], getattr(buffer, name)[:filled]
        check(kept, stored, name)
        kept[:] = stored
    buffer.pos, buffer.full = position, full


def _attributes(model: BaseAlgorithm) -> dict[str, Any]:
    """Raises RuntimeError for one that the installed Stable-Baselines3 does not have."""
    names = (*_MODEL, *(_RECURRENT if isinstance(model, RecurrentPPO) else ()))
    missing = [name for name in names if not hasattr(model, name)]
    if missing:
        raise RuntimeError(
            f"{type(model).__name__} of stable-baselines3 {stable_baselines3.__version__} has no "
            f"attribute {missing[0]!r}, without which a training cannot go on from a checkpoint. "
            "Install the version that constraints.txt names"
        )
    return {name: getattr(model, name) for name in names}


def capture(model: BaseAlgorithm) -> dict[str, Any]:
    """Everything that the next rollout of a model depends on. Raises as `_attributes`."""
    _, variables = model._get_torch_save_params()
    return {
        "parameters": model.get_parameters(),
        "variables": {name: recursive_getattr(model, name) for name in variables},
        "attributes": _attributes(model),
        "samples": _samples(model),
        "environment": capture_environment(model.get_env()),
        "random": {
            **capture_random(),
            "action": model.action_space.np_random.bit_generator.state,
        },
    }


def resume(model: BaseAlgorithm, captured: Mapping[str, Any]) -> None:
    """Put everything that `capture` took into a fresh model of the same configuration.

    Raises any exception where it does not fit.
    """
    env = model.get_env()
    assert env is not None
    shown: Any = env.reset()
    model._last_obs = shown  # now it has everything that the checkpoint must have
    fresh = capture(model)
    fresh["attributes"].update(
        _last_episode_starts=np.ones(env.num_envs, dtype=bool),
        ep_info_buffer=deque(),
        ep_success_buffer=deque(),
    )
    if model.get_vec_normalize_env() is not None:
        fresh["attributes"]["_last_original_obs"] = model._last_obs
    for part in ("variables", "random", "attributes"):
        check(fresh[part], captured[part], part)
    attributes = captured["attributes"]
    for success in attributes["ep_success_buffer"]:
        check(False, success, "ep_success_buffer")
    for info in attributes["ep_info_buffer"]:
        check(_ENDED, {name: info[name] for name in _ENDED}, "ep_info_buffer")
    check_parameters(model, captured["parameters"])
    resume_environment(env, captured["environment"])
    model.set_parameters(captured["parameters"], exact_match=True, device="cpu")
    for name, value in captured["variables"].items():
        if value is not None:
            recursive_setattr(model, f"{name}.data", value.data)
    for name in fresh["attributes"]:
        setattr(model, name, attributes[name])
    _put_samples_back(model, captured["samples"])
    put_random_back(captured["random"])
    model.action_space.np_random.bit_generator.state = captured["random"]["action"]
