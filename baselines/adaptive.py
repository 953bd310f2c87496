"""The adaptive policy: the feedback-linearizing controller fed by the identification stack.

Certainty equivalence: at every control step the controller takes the estimates for the truth,
    mass, mu_l, inertia, mu_t     always: where the data say nothing they stay where they were
    F_max, K                      where the data determine what the soil carries, else nominal
and sees the filtered pose and velocity instead of the measured ones. It starts from its nominal
parameters in every episode, uses observations only, and never sees a true parameter.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 7 and 8.3.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.controllers.feedback_linearization import FeedbackLinearizingController
from baselines.controllers.linearizing_law import Gains
from baselines.estimators.estimate import Status
from baselines.estimators.measurement import COLUMN, INERTIAL, DataSheet
from baselines.estimators.stack import Identification, IdentificationStack, Memories
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PARAMETER_INDEX, PlantParameters, plant_parameters

_ROW = PARAMETER_INDEX
_I, _SCALE, _BOUND = layout.INDEX, layout.SCALE, layout.BOUND
_X, _Y, _YAW = _I["position_error_x"], _I["position_error_y"], _I["heading_error"]
_V_X, _V_Y, _W = _I["v_x"], _I["v_y"], _I["yaw_rate"]
_GYRO = COLUMN["yaw_rate"]
# Sensor fields that the controller does not use, but whose NaN would stop it.
_UNUSED = np.array(
    [_I[name] for name in layout.NAMES if name.startswith(("acc", "yaw_acc", "sprocket", "torque"))]
)


class AdaptiveState(NamedTuple):
    """What the policy remembers between two calls."""

    xi: NDArray[np.float64]  # (N,) [m/s^2] compensator of the controller
    memories: Memories  # of the estimators


@loop
def show_filtered(observation, reference, pose, velocity, gyro):
    """Write the filtered motion into observation (N, SIZE): reference and pose (N, 3) in one
    frame, velocity (N, 3) v_x, v_y, yaw rate by model, gyro (N,) used where finite."""
    for i in range(observation.shape[0]):
        c, s = rotation(pose[i, 2])
        e_x, e_y = reference[i, 0] - pose[i, 0], reference[i, 1] - pose[i, 1]
        layout.store(observation, i, _X, c * e_x + s * e_y)
        layout.store(observation, i, _Y, c * e_y - s * e_x)
        turn = reference[i, 2] - pose[i, 2]
        turn -= 2.0 * np.pi * np.floor(turn / (2.0 * np.pi) + 0.5)
        layout.store(observation, i, _YAW, turn)
        layout.store(observation, i, _V_X, velocity[i, 0])
        layout.store(observation, i, _V_Y, velocity[i, 1])
        layout.store(observation, i, _W, gyro[i] if np.isfinite(gyro[i]) else velocity[i, 2])
        for k in range(_UNUSED.shape[0]):
            if not np.isfinite(observation[i, _UNUSED[k]]):
                observation[i, _UNUSED[k]] = 0.0


class AdaptivePolicy:
    """Controller and estimators as one policy, for one vehicle or a batch.

    parameters: nominal ones. control_period [s]: between two calls. data_sheet: noise of the
    sensors (default `rtk`). lateral: closure of the nominal model. gains: of the controller.
    stack: "batched" or "filterpy" slip observer, "coupled" or "paper" regressions.
    filtered: True shows the controller the filtered motion, False the measured one; None =
    True unless the data sheet knows no noise at all.
    uses_soil: whether the estimated traction limits are used. S does not.
    Raises ValueError for arguments that make no sense.
    """

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        lateral: str = "sliding",
        gains: Gains | None = None,
        regression: str = "coupled",
        slip: str = "batched",
        filtered: bool | None = None,
        uses_soil: bool = True,
    ) -> None:
        self.parameters = plant_parameters() if parameters is None else parameters
        self.data_sheet = DataSheet() if data_sheet is None else data_sheet
        self.controller = FeedbackLinearizingController(
            self.parameters, control_period, gains, lateral
        )
        noisy = max(self.data_sheet[:3]) > 0.0
        self.filtered = noisy if filtered is None else bool(filtered)
        self.uses_soil = bool(uses_soil)
        self._options: dict[str, Any] = {"regression": regression, "slip": slip}
        self._given: AdaptiveState | None = None
        self.known: Identification | None = None
        self._build(1)

    def _build(self, count: int) -> None:
        """Estimators and parameters of `count` vehicles, all at their nominal values."""
        self.stack = IdentificationStack(
            self.parameters, self.controller.control_period, self.data_sheet, count,
            self.controller.lateral, **self._options,
        )  # fmt: skip
        nominal = np.array(self.parameters, dtype=np.float64)
        self.controller.parameters = np.repeat(nominal[:, None], count, axis=1)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: AdaptiveState | None = None,
        episode_start: NDArray[np.bool_] | bool | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], AdaptiveState]:
        """Sprocket torques over their limit, and the state to pass to the next call.

        observation: (SIZE,) or (N, SIZE) as in tracked_env.observation. state: None starts
        from the nominal parameters. episode_start: (N,) or a bool; those rows start anew.
        deterministic: without effect. One call per control step.
        Returns action float32, (2,) or (N, 2), in [-1, 1], left then right, and the new state.
        A NaN in a sensor field is skipped. Raises ValueError for a wrong shape, a state of
        another number of vehicles, or a reference that is not finite.
        """
        single = np.ndim(observation) == 1
        batch = np.array(observation, dtype=np.float32, ndmin=2)
        count = len(batch)
        if batch.ndim != 2 or batch.shape[1] != layout.SIZE:
            raise ValueError(
                f"observation has shape {np.shape(observation)}; must be ({layout.SIZE},) or "
                f"(N, {layout.SIZE}). Did a wrapper stack or append to it?"
            )
        if count != self.stack.count:
            self._build(count)
            self._given = None
        start = np.zeros(count, dtype=bool)
        if state is None:
            start[:] = True
        elif state is not self._given:
            self.stack.restore(state.memories)
        if episode_start is not None:
            start |= np.asarray(episode_start, dtype=bool)
        known = self.stack.update(batch, start)
        self._adapt(known)
        if self.filtered:
            motion = known.motion
            show_filtered(
                batch, known.reading.reference, np.stack(motion[:3], axis=-1),
                np.stack(motion[3:], axis=-1), self._gyro(known),
            )  # fmt: skip
        xi = None if state is None else state.xi
        action, xi = self.controller.predict(batch, xi, start)
        self.known = known
        self._given = AdaptiveState(xi, self.stack.memories())
        return (action[0] if single else action), self._given

    def _gyro(self, known: Identification) -> NDArray[np.float64]:
        """The gyro where its sample is new, else NaN, (N,)."""
        latest = known.reading.latest
        stale = latest.age[:, INERTIAL] > 0.5 * self.controller.control_period
        return np.where(stale, np.nan, latest.values[:, _GYRO])

    def _adapt(self, known: Identification) -> None:
        """Hand the estimates to the controller."""
        rows = self.controller.parameters
        rows[_ROW["mass"]] = known.mass
        rows[_ROW["longitudinal_resistance"]] = known.longitudinal.value[:, 1]
        rows[_ROW["inertia"]] = known.turning.value[:, 0]
        rows[_ROW["lateral_resistance"]] = known.turning.value[:, 1]
        if not self.uses_soil:
            return
        p = self.parameters
        effort, trusted = known.soil.value[:, 0], known.traction_known
        # F_max as cohesion alone: the controller needs no more than the product.
        rows[_ROW["cohesion"]] = np.where(
            trusted, effort / (p.track_width * p.contact_length), p.cohesion
        )
        rows[_ROW["friction_angle"]] = np.where(trusted, 0.0, p.friction_angle)
        rows[_ROW["shear_deformation_modulus"]] = np.where(
            trusted, known.soil.value[:, 1], p.shear_deformation_modulus
        )

    def estimates(self) -> Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """(value, standard deviation) by name after the last call, each (N,), SI."""
        return {} if self.known is None else self.known.estimates()

    def excited(self) -> Mapping[str, NDArray[np.bool_]]:
        """Whether the data determine the parameter, by name, (N,)."""
        if self.known is None:
            return {}
        status = self.known.status()
        by_parameter = {
            "mass": "longitudinal", "longitudinal_resistance": "longitudinal",
            "inertia": "turning", "lateral_resistance": "turning",
            "slip_left": "slip", "slip_right": "slip", "effort_maximum": "soil",
            "shear_deformation_modulus": "soil",
        }  # fmt: skip
        return {name: status[e] == Status.CONVERGING for name, e in by_parameter.items()}

    def nis(self) -> Mapping[str, NDArray[np.float64]]:
        """Normalised innovation squared of each estimator in the last call, (N,)."""
        return {} if self.known is None else self.known.nis()
