"""One tracked vehicle behind the Gymnasium interface: the simulation core with N = 1."""

import inspect
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from tracked_env import observation as obs
from tracked_env.arrays import RowReport
from tracked_env.engine.env_config import EnvConfig, PlainSpec, environment_arguments
from tracked_env.engine.simulation import Simulation, checked_actions
from tracked_env.validation import checked_keys

ObsType = NDArray[np.float32]
_ACTION_SHAPE = (2,)


def make_renderer(simulation: Simulation, i: int, mode: str) -> Any:
    """What draws vehicle i; raises ImportError with the extra to install when pygame is missing."""
    from tracked_env.rendering import Renderer, source_of

    rate = round(simulation.config.control_rate)
    return Renderer(mode, rate, terrain=source_of(simulation, i))


class TrackedVehicleEnv(PlainSpec, gymnasium.Env[ObsType, ObsType]):
    """A skid-steering tracked vehicle on unknown soil follows a reference in time.

    ## Description
    A tracked vehicle turns by driving its two tracks differently: by their sprocket torques
    (`tracked_env/Torque-v0`, after Strawa et al. 2021) or by their sprocket speeds
    (`tracked_env/Speed-v0`, after Focchi et al. 2025, and `tracked_env/Terrain-v0`, the same on
    slopes and hills). Mass, inertia, soil
    strength and resistance are drawn per episode, may change inside it, and are not observed.
    The task is to stay on a moving reference pose.
    SI units, body frame x forward and y left, yaw positive to the left.

    ## Action Space
    `Box(-1, 1, (2,), float32)`

    | index | action | min | max | unit |
    |--|--|--|--|--|
    | 0 | left sprocket torque over `torque_limit` | -1 | 1 | - |
    | 1 | right sprocket torque over `torque_limit` | -1 | 1 | - |

    With `drive="speed"` it is the sprocket speed over `sprocket_speed_limit`. Values outside
    are clipped; a non-finite value, a wrong shape or a wrong type is a ValueError. Equal
    actions drive straight on; more on the right turns left.

    ## Observation Space
    `Box(float32)`: sensor readings and the reference, each over its scale. No true state. The
    table is that of `observation="v0"`; the attribute `layout` has the names, scales and table
    of the groups that this environment shows.

    OBSERVATION_TABLE

    ## Rewards
    Sum of bounded terms (`tracked_env.step`), in [-0.1, 1] per step: closeness of position
    (weight 0.7), heading (0.15) and speed (0.15), minus effort (0.05) and change of the action
    (0.05). Each is in `info`: `reward_position`, `reward_heading`, `reward_speed`,
    `reward_effort`, `reward_smoothness`. The argument `reward` takes other weights and scales, or
    a function; the page docs/rewards.md says how.

    ## Starting State
    Beside the start of the reference: U(-0.15, 0.15) contact lengths l forward and to the
    left (0.3 m for l = 2 m), U(-0.1, 0.1) rad off, at its speed *U(0.8, 1.2).

    ## Episode End
    Terminated: more than `error_limit` from the reference, or a non-finite state. Then the
    observation keeps the last readings of the sensors, the reward is the worst, -0.1, and
    `truth` and `tracking_error` show the state as it is.
    Truncated: after `duration`, by the environment itself. `spec.max_episode_steps` is None,
    because it would be a fixed number of steps while `duration` and `control_rate` are
    arguments; `tracked_env.make` makes an environment whose `spec` has the number.

    ## Arguments
    All but a function are JSON-able; `tracked_env/Speed-v0` and `tracked_env/Terrain-v0` have
    defaults of their own (`tracked_env.SPEED`, `tracked_env.TERRAIN`).

    | argument | default | meaning |
    |--|--|--|
    | `reference` | `"random"` | name or dict, see `tracked_env.references` |
    | `uncertainty` | `"soil-and-mass"` | set by name, {parameter: [low, high]}, or a function |
    | `sensors` | `"rtk"` | preset `ideal`, `rtk`, `strawa`, `mocap`, .., or dict of overrides |
    | `duration` | 30 | [s] of an episode |
    | `control_rate` | 50 | [Hz] of actions and observations |
    | `lateral` | `"sliding"` | of the lumped plant; or `"constrained"`, which patches refuse |
    | `error_limit` | 5 | [m] distance that ends an episode |
    | `time_step` | 0.0025 | [s] longest integration step; its error: docs/numerics.md |
    | `vehicle` | `"strawa"` | nominal one: `strawa`, `focchi`, `focchi-short`, or a dict |
    | `plant` | `"lumped"` | `"lumped"`, `"distributed"`, `"terrain"` or a `Plant`, see below |
    | `drive` | `"torque"` | what the actions are; `"speed"` needs one with patches |
    | `patches` | (10, 4) | of the plants with patches: along and across a track |
    | `plant_options` | None | {option: value} of the plant, see its file in `plants/` |
    | `observation` | `"v0"` | groups that are shown: a list of names from the table above |
    | `expose_truth` | False | put true state and parameters into `info["truth"]` |
    | `render_mode` | None | `"human"` or `"rgb_array"` |
    | `terrain` | None | of the plant `"terrain"`, level if None; see docs/terrain.md |
    | `reward` | `"default"` | name, {term: {"weight": .., "scale": ..}}, or a function |
    | `costs` | None | {term: limit}: `cost` in `info`; see `tracked_env.rewards` |
    | `base_vehicle` | `"strawa"` | base of a `vehicle` that is a dict without `"base"` |

    A `vehicle` may be a dict, {"base": "focchi", parameter: value}: what is not named is of the
    base, which is the id's own vehicle where none is named; a warning lists it where mass, contact
    length or gauge are more than 30 % from the base's. The plants: `"lumped"` has closed-form
    forces, `"distributed"` patches under the tracks, `"terrain"` these on uneven ground; others
    have the name under which `tracked_env.plants.register` knows them.

    `reset(options={...})` overrides any value for one episode; the keys are `vehicle`, `soil`,
    `lateral_model` ({parameter: value}), `reference`, `sensors`, `schedule`
    (a list of changes, see `tracked_env.events`), `start` ({offset_x, offset_y, offset_yaw,
    speed, yaw_rate}) and `terrain` (the number of one of those that are drawn from). An unknown
    key is a ValueError, and so is a parameter that the plant does not read
    (docs/uncertainty.md has the table).

    ## Info
    | key | value | meaning |
    |--|--|--|
    | `tracking_error` | (2,) [m, rad] | true distance to the reference, heading error |
    | `reward_position` | float | term of the reward: closeness of position |
    | `reward_heading` | float | closeness of heading |
    | `reward_speed` | float | closeness of speed |
    | `reward_effort` | float | mean square of the action |
    | `reward_smoothness` | float | mean square of the change of the action |
    | `reference_scale` | (3,) [-] | of speeds, yaw rates, lengths, for the vehicle; 1: as written |
    | `is_success` | bool | the episode has ended by time, with an RMSE below l/4 |
    | `ended_off_path` | bool | on terrain: ended more than `error_limit` from the reference |
    | `ended_tilted` | bool | on terrain: more than the option `tilt_limit` off the vertical |
    | `ended_off_map` | bool | on terrain: a patch is beyond the edge of the height map |
    | `ended_overloaded` | bool | on terrain: the moment at which a uniform load tips |
    | `cost` | float | with `costs`: limits exceeded in this step; `cost_tilt`, ...: each |
    | `truth` | dict | with `expose_truth`: state and parameters by name, SI |

    ## Version History
    * v0: initial version
    """

    metadata: dict[str, Any] = {  # noqa: RUF012, an instance variable in Gymnasium
        "render_modes": ["human", "rgb_array"],
        "render_fps": 50,
    }
    expose_truth: bool

    @environment_arguments
    def __init__(self, config: EnvConfig) -> None:
        self.simulation = Simulation(1, config)
        self.layout = self.simulation.layout
        self.metadata = {**self.metadata, "render_fps": round(config.control_rate)}
        self.observation_space = gymnasium.spaces.Box(*self.layout.limits, dtype=np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.cost_budget = self.simulation.cost_budget
        self._renderer: Any = None
        self._reference_scale = tuple(self.simulation.reference_scale[0].tolist())
        self._no_endings = dict.fromkeys(self.simulation.ending_flags, False)

    @property
    def _np_random(self) -> np.random.Generator | None:
        """Gymnasium's generator of this environment: the random stream of its vehicle."""
        return self.simulation.rngs[0]

    @_np_random.setter
    def _np_random(self, generator: np.random.Generator | None) -> None:
        self.simulation.rngs[0] = generator

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObsType, dict[str, Any]]:
        """Start an episode. Raises ValueError for options that are unknown or out of range."""
        super().reset(seed=seed)
        self.simulation.rngs[0] = self.np_random  # seeds itself where no seed was ever given
        observation = self.simulation.reset(self.simulation.all, [options])[0].copy()
        self._reference_scale = tuple(self.simulation.reference_scale[0].tolist())
        if self.render_mode == "human":
            self.render()
        return observation, self._reward_and_info(self.simulation.batch.row_report(0))[1]

    def step(self, action: ObsType) -> tuple[ObsType, float, bool, bool, dict[str, Any]]:
        """Hold the two demands, sprocket torques or speeds, for one control period.

        Raises ResetNeeded before the first reset, ValueError for an action that is not (2,)
        finite real numbers.
        """
        simulation = self.simulation
        plain = type(action) is np.ndarray and action.dtype.kind == "f"
        if not plain or action.shape != _ACTION_SHAPE:
            action = checked_actions(action, _ACTION_SHAPE)
        simulation.actions[0] = action
        simulation.advance()
        if self.render_mode == "human":
            self.render()
        report = simulation.first_report
        terminated = truncated = is_success = False
        if simulation.some_ended:
            terminated, truncated = map(bool, report.flags.tolist())
            is_success = truncated and bool(simulation.success[0])
        reward, info = self._reward_and_info(report, is_success, terminated)
        return simulation.first_observation.copy(), reward, terminated, truncated, info

    def _reward_and_info(
        self, report: RowReport, is_success: bool = False, terminated: bool = False
    ) -> tuple[float, dict[str, Any]]:
        reward, position, heading, speed, effort, smoothness = report.rewards.tolist()
        info: dict[str, Any] = {  # written out: `INFO_KEYS` in a loop takes three times as long
            "reward_position": position,
            "reward_heading": heading,
            "reward_speed": speed,
            "reward_effort": effort,
            "reward_smoothness": smoothness,
            "tracking_error": report.tracking_error.copy(),
            "is_success": is_success,
            "reference_scale": self._reference_scale,
        }
        if self._no_endings:
            info.update(self._no_endings)
            if terminated:
                flags = self.simulation.endings().items()
                info.update((name, bool(flag[0])) for name, flag in flags)
        if self.simulation.cost_names:
            costs = self.simulation.costs().items()
            info.update((name, float(value[0])) for name, value in costs)
        if self.expose_truth:
            truth = self.simulation.truth()
            info["truth"] = {name: float(value[0]) for name, value in truth.items()}
        return reward, info

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the scene: an RGB array (height, width, 3), or a window in `human` mode.

        Raises ImportError with the extra to install when pygame is missing.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs render_mode='rgb_array' or 'human' at make().")
            return None
        if self._renderer is None:
            self._renderer = make_renderer(self.simulation, 0, self.render_mode)
        return self._renderer.draw(self.simulation, 0)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def env_creator(config: Mapping[str, Any] | None = None) -> TrackedVehicleEnv:
    """One vehicle for RLlib: `register_env("tracked_env", env_creator)` of `ray.tune`.

    config: arguments of `TrackedVehicleEnv`; RLlib's EnvContext is such a dict. RLlib seeds the
    environments of its workers itself. Raises ValueError for a key that is no argument, or a value
    out of range.
    """
    arguments = inspect.signature(TrackedVehicleEnv).parameters
    return TrackedVehicleEnv(**checked_keys("env_config", config, arguments))


# Indentation first: it is that of the source, and the table has none.
TrackedVehicleEnv.__doc__ = inspect.cleandoc(TrackedVehicleEnv.__doc__ or "").replace(
    "OBSERVATION_TABLE", obs.markdown_table()
)
