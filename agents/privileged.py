"""What a teacher sees besides the observation: the hidden parameters in force, and the slips.

A teacher is trained like any other agent, on an environment with `expose_truth`; its memory,
`Privileged`, is filled by `TruthfulVectorEnv` from `info["truth"]`. As a policy of the benchmark
it declares `needs_truth`, like the oracle: it shows what could be had, and is no competitor. A
student (`agents.student`) infers these inputs from measurements and drives with the same network.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from agents.memory import Blind, seen
from agents.policy import AgentPolicy, AgentState, Normalisation, Predictor
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyContext
from tracked_env.physics.parameters import VEHICLES, PlantParameters
from tracked_env.physics.terramechanics import GRAVITY, mohr_coulomb
from tracked_env.wrappers import FEATURE_BOUND

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]
Truth = Mapping[str, NDArray[np.float64]]

TEACHER = "teacher"  # the kind of memory in a recipe
# Logarithm of the ratio to nominal that is shown as 1, and the differences that are.
RATIOS = {"mass": 0.3, "inertia": 0.3, "shear_deformation_modulus": 0.5, "traction_limit": 1.0}
DIFFERENCES = {
    "longitudinal_resistance": 0.3, "lateral_resistance": 0.3, "drive_time_constant": 0.1,
    "slip_left": 0.5, "slip_right": 0.5,
}  # fmt: skip
PRIVILEGED = (*RATIOS, *DIFFERENCES)


def _quantities(truth: Mapping[str, Any]) -> dict[str, Any]:
    """The truth and the largest effort F_max of one track [N], Mohr-Coulomb."""
    area, load = truth["track_width"] * truth["contact_length"], 0.5 * GRAVITY * truth["mass"]
    limit = mohr_coulomb(truth["cohesion"], np.tan(truth["friction_angle"]), area, load)
    return {**truth, "traction_limit": limit}


def privileged(truth: Truth, nominal: PlantParameters) -> Floats:
    """The true PRIVILEGED quantities over their scales, (N, F), finite and clipped, 0 = nominal.

    nominal: the vehicle on the soil that its controllers expect. Slips are clipped to 1 before
    they are scaled, everything to FEATURE_BOUND after, so that a student learns what its teacher
    sees.
    """
    given = _quantities(truth)
    expected = {"slip_left": 0.0, "slip_right": 0.0, **_quantities(nominal._asdict())}
    with np.errstate(divide="ignore"):  # a soil without any traction is shown as the bound
        columns = [np.log(given[name] / expected[name]) / scale for name, scale in RATIOS.items()]
    for name, scale in DIFFERENCES.items():
        value = np.clip(given[name], -1.0, 1.0) if name.startswith("slip") else given[name]
        columns.append((value - expected[name]) / scale)
    shown = np.nan_to_num(np.stack(columns, axis=-1))
    return np.clip(shown, -FEATURE_BOUND, FEATURE_BOUND).astype(np.float32)


class Privileged(Blind):
    """A memory that is told the truth before each `observe`. count, control_period: as Blind.

    nominal: the vehicle and the soil that the inputs are ratios to and differences from.
    `present` (N, F) belongs to the observation that the environment shows. `last` is the same
    except in rows that have just ended, where it belongs to the last observation of the episode.
    """

    feature_names = PRIVILEGED

    def __init__(self, count: int, control_period: float, nominal: PlantParameters) -> None:
        super().__init__(count, control_period)
        self.nominal = nominal
        self.present: Floats = np.zeros((count, len(PRIVILEGED)), dtype=np.float32)
        self.last = self.present

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """The privileged inputs (N, F); rows with `start` begin an episode."""
        return np.where(start[:, None], self.present, self.last)


class TruthfulVectorEnv(gymnasium.vector.VectorWrapper):
    """Tells a `Privileged` the truth after each step. env: with `expose_truth`.

    Raises ValueError for an environment that does not expose the truth, or of another vehicle.
    """

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], memory: Privileged) -> None:
        super().__init__(env)
        core: Any = env.unwrapped
        if not getattr(core, "expose_truth", False):
            raise ValueError("a teacher needs an environment made with expose_truth = True")
        if core.simulation.solver.nominal != memory.nominal:
            raise ValueError(
                "the environment and the memory have different nominal vehicles; a teacher needs "
                "`tracked_env.physics.parameters.VEHICLES` of the environment's `vehicle`"
            )
        self.memory = memory

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes."""
        observation, info = self.env.reset(seed=seed, options=options)
        memory = self.memory
        memory.present = memory.last = privileged(info["truth"], memory.nominal)
        return observation, info

    def step(self, actions: Floats) -> tuple[Any, NDArray[np.float64], Bools, Bools, Any]:
        """Advance all rows by one control period; actions (N, 2)."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        memory = self.memory
        memory.present = memory.last = privileged(info["truth"], memory.nominal)
        if "final_info" in info:  # the row shows its next episode already
            final = privileged(info["final_info"]["truth"], memory.nominal)
            memory.last = np.where(info["_final_info"][:, None], final, memory.present)
        return observation, reward, terminated, truncated, info


class TeacherPolicy:
    """A teacher as a policy of the benchmark, which must be handed the truth.

    model: of Stable-Baselines3, sees observation and privileged inputs. nominal: as Privileged.
    normalisation: of both.
    """

    needs_truth = True

    def __init__(
        self,
        model: Predictor,
        nominal: PlantParameters,
        normalisation: Normalisation | None = None,
    ) -> None:
        self.model, self.nominal, self.normalisation = model, nominal, normalisation
        self._inputs: Floats | None = None

    def observe_truth(self, truth: Truth) -> None:
        """Take over the truth, {name: number or (N,)}; other names are ignored."""
        values = {name: np.atleast_1d(value) for name, value in truth.items() if name[0] != "_"}
        self._inputs = privileged(values, self.nominal)

    def predict(
        self,
        observation: Floats,
        state: AgentState | None = None,
        episode_start: Bools | bool | None = None,
        deterministic: bool = True,
    ) -> tuple[Floats, AgentState]:
        """Action and state as AgentPolicy. Raises ValueError for a wrong shape or no truth."""
        batch = np.array(observation, dtype=np.float32, ndmin=2)
        if self._inputs is None or batch.shape != (len(self._inputs), layout.SIZE):
            raise ValueError(
                f"observation has shape {np.shape(observation)}, but the truth of "
                f"{0 if self._inputs is None else len(self._inputs)} vehicles was observed; a "
                "teacher needs `observe_truth` before each `predict`. A student drives without."
            )
        start = np.full(len(batch), state is None)
        if episode_start is not None:
            start |= np.asarray(episode_start, dtype=bool)
        shown = seen(batch, self._inputs)
        if self.normalisation is not None:
            shown = self.normalisation(shown)
        action, recurrent = self.model.predict(
            shown, None if state is None else state.recurrent, start, deterministic
        )
        commands = np.asarray(action, np.float32)
        return (commands[0] if np.ndim(observation) == 1 else commands), AgentState((), recurrent)


def policy_of(
    model: Predictor,
    kind: str,
    options: Mapping[str, Any],
    context: PolicyContext,
    normalisation: Normalisation | None = None,
) -> AgentPolicy | TeacherPolicy:
    """A model as the policy that its kind of memory makes of it; arguments as AgentPolicy."""
    if kind == TEACHER:
        return TeacherPolicy(model, VEHICLES[context.vehicle], normalisation)
    return AgentPolicy(model, kind, options, context, normalisation)
