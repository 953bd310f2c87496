"""What the environment of a training remembers, layer by layer, so that it can go on from there.

vehicles, soils, noise streams     in mid-episode
augmentation and normalisation     of the wrappers
"""

from typing import Any

from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

from agents.agent_vector_env import AgentVectorEnv
from agents.privileged import TruthfulVectorEnv
from agents.training import checkpoint_fit
from agents.training.joined import JoinedVecEnv
from tracked_env.engine.simulation import Simulation
from tracked_env.sb3 import TrackedVehicleVecEnv

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


def _of_simulation(simulation: Simulation) -> dict[str, Any]:
    """What a simulation remembers, as plain data."""
    state = simulation.snapshot()
    composer = state["composer"]
    return {**state, "composer": None if composer is None else composer.snapshot()}


def _resume_simulation(simulation: Simulation, state: dict[str, Any]) -> None:
    composer = simulation.composer
    if composer is not None:
        composer.resume(state["composer"])
    simulation.resume({**state, "composer": composer})


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
            states.append(_of_simulation(layer.env.unwrapped.simulation))
        else:
            states.append(None)
    return states


def resume_environment(env: VecEnv | None, states: list[Any]) -> None:
    """Put back what `capture_environment` took, into an environment of the same arguments.

    Raises ValueError, before anything is put back, for what another environment has left.
    """
    if env is not None:
        env.reset()  # now it has everything that the states are compared with
    checkpoint_fit.check(capture_environment(env), states, "environment")
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
            _resume_simulation(layer.env.unwrapped.simulation, state)
