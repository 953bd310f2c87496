"""What the augmented policies share: filter, nominal law, and a kernel that adapts between them.

    observation -> reader and slip observer -> filtered motion -> adaptation -> law -> efforts
The motion is that of the adaptive policy's filter; no parameter is identified. The adaptation sees
the filtered forward speed and yaw rate and the commands that were sent, nothing else, and says what
the law is to cancel or which parameters it is to use. Its state is one row per vehicle: what the
drives give, the last measured motion, then the numbers of the adaptation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.augmented.channel_loads import OWN
from baselines.augmented.drive_loop import correct_all
from baselines.batch_policy import BatchPolicy
from baselines.estimators.actuators import COMMANDS
from baselines.estimators.motion_filter import MotionFilter
from baselines.estimators.sensor_samples import ATTITUDE, COLUMN, DRIVE, DataSheet, Measurement
from baselines.linearizing.linearizing_law import Gains
from baselines.linearizing.linearizing_policy import (
    NEEDS,
    FeedbackLinearizingController,
    shows_attitude,
)
from baselines.linearizing.shown_motion import show
from tracked_env import observation as layout
from tracked_env.physics.parameters import PlantParameters, plant_parameters

_TORQUES = [COLUMN["torque_left"], COLUMN["torque_right"]]


class AugmentedState(NamedTuple):
    """State of the policy between two calls."""

    controller: NDArray[np.float64]  # (N, STATE) of the law
    memories: tuple[NDArray[np.float64], ...]  # of the filter
    adaptation: NDArray[np.float64]  # (N, columns)


class AugmentedPolicy(BatchPolicy[AugmentedState]):
    """Nominal law on the filtered motion, with an adaptation that a subclass brings.

    parameters: nominal ones. control_period [s]: between two calls. data_sheet: noise of the
    sensors (default `rtk`). lateral: model of the nominal vehicle. gains: of the law. observation:
    names of the fields that the environment shows.
    filtered: as for the adaptive policy.
    Raises ValueError for arguments that make no sense, and for an observation that lacks what the
    law, the filter or the adaptation needs, the commands that were sent among it.
    """

    first = np.zeros(OWN)  # row of the adaptation with which an episode begins

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        lateral: str = "sliding",
        gains: Gains | None = None,
        filtered: bool | None = None,
        observation: Sequence[str] = layout.NAMES,
    ) -> None:
        self.parameters = plant_parameters() if parameters is None else parameters
        self.data_sheet = DataSheet() if data_sheet is None else data_sheet
        self.sloped = shows_attitude(observation)
        self.constrained = lateral == "constrained"
        shown = (*layout.NAMES, *ATTITUDE) if self.sloped else layout.NAMES
        self.controller = FeedbackLinearizingController(
            self.parameters, control_period, gains, lateral, shown
        )
        noisy = max(self.data_sheet[:3]) > 0.0
        self.filtered = noisy if filtered is None else bool(filtered)
        self._given: AugmentedState | None = None
        self._build(1)
        needs = (*NEEDS, *COMMANDS, *self.filter.needs)
        self._view = layout.View(observation, tuple(dict.fromkeys(needs)))

    def _build(self, count: int) -> None:
        """Filter and law of `count` vehicles."""
        controller = self.controller
        self.filter = MotionFilter(
            self.parameters, controller.control_period, self.data_sheet, count, controller.lateral,
            self.sloped,
        )  # fmt: skip
        nominal = np.array(self.parameters, dtype=np.float64)
        controller.parameters = np.repeat(nominal[:, None], count, axis=1)
        controller.lacking = np.zeros((count, 2))
        self._frozen: NDArray[np.bool_] | None = None  # rows that learn no more
        self._held = self._learned(count)
        self.count = count

    def _learned(self, count: int) -> tuple[NDArray[np.float64], ...]:
        """Copies of the rows of the adaptation, of `lacking` and of the parameters, by vehicle."""
        given = np.tile(self.first, (count, 1)) if self._given is None else self._given.adaptation
        return given.copy(), self.controller.lacking.copy(), self.controller.parameters.T.copy()

    def freeze(self, rows: NDArray[np.bool_]) -> None:
        """Keep what is cancelled, the parameters and the corrections of the drives as they are in
        these rows (N,), until they start anew; the filter of the motion goes on."""
        self._held = self._learned(self.count)
        self._frozen = rows.copy() if self._frozen is None else self._frozen | rows

    def adapt(
        self,
        observation: NDArray[np.float32],
        torques: NDArray[np.float64],
        adaptation: NDArray[np.float64],
    ) -> None:
        """Take one filtered observation, and the torques (N, 2) [N m] at the sprockets, NaN where
        they are not measured now: adaptation (N, columns) in and out, then the law's `lacking` or
        `parameters`."""
        raise NotImplementedError

    def act(
        self,
        observation: NDArray[np.float32],
        state: AugmentedState | None,
        start: NDArray[np.bool_],
    ) -> tuple[NDArray[np.float32], AugmentedState]:
        """Sprocket torques over their limit, and the new state; one call per control step.

        A NaN in a sensor field is skipped. Raises ValueError for a state of another number of
        vehicles, or a reference that is not finite; then the state given is still good.
        """
        count = len(observation)
        if state is not None:
            self.same_count(len(state.controller), count)
        if count != self.count:
            self._given = None
            self._build(count)
        if state is not None and state is not self._given:
            self.filter.restore(state.memories)
        self._given = None  # until this call has ended well, the filter is in no known state
        known = self.filter.update(observation, start)
        _value, _covariance, summary, status = known.answer
        show(
            observation, known.reference, known.rows, known.latest.values, known.latest.age,
            summary, status, 0.5 * self.controller.control_period, self.filtered,
        )  # fmt: skip
        fresh = np.zeros((count, len(self.first))) if state is None else state.adaptation.copy()
        fresh[start] = self.first
        self.adapt(observation, self._torques(known.latest), fresh)
        if self._frozen is not None:
            self._frozen &= ~start
            for now, kept in zip(
                (fresh, self.controller.lacking, self.controller.parameters.T), self._held,
                strict=True,
            ):  # fmt: skip
                now[self._frozen] = kept[self._frozen]
        held = None if state is None else state.controller
        action, held = self.controller.act(observation, held, start)
        correct_all(fresh, 0, action)
        self._given = AugmentedState(held, tuple(self.filter.memories()), fresh)
        return action, self._given

    def _torques(self, latest: Measurement) -> NDArray[np.float64]:
        """(N, 2) torques of samples that are new and not late, else NaN."""
        now = latest.age[:, DRIVE] < 0.5 * self.controller.control_period
        return np.where(now[:, None], latest.values[:, _TORQUES], np.nan)
