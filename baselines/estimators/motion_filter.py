"""The filtered motion without identification: observation reader and slip observer, no more.

For controllers that want the pose and the velocities of the adaptive policy's filter, and not its
parameters. The ground that the filter reckons with in an outage is the nominal one, as uncertain
as the soil estimator thinks it before any data.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import late_pose
from baselines.estimators import stack as links
from baselines.estimators.measurement import (
    ATTITUDE,
    NEEDS,
    DataSheet,
    Measurement,
    ObservationReader,
    Setting,
    WiderMeasurement,
    attitude_of,
)
from baselines.estimators.slip_observer import Answer, SlipObserver
from baselines.estimators.soil_estimator import PRIOR_SIGMA
from tracked_env import observation as layout
from tracked_env.physics.lumped import drive_limits
from tracked_env.physics.parameters import PlantParameters


class FilteredMotion(NamedTuple):
    """What one observation of N vehicles says after the filter."""

    latest: Measurement  # each group's last sample
    reference: NDArray[np.float64]  # (N, 3) pose of the reference now [m, m, rad]
    rows: NDArray[np.float64]  # (N, 6) X, Y, psi, v_x, v_y, w, now
    answer: Answer  # of the slip observer


class MotionFilter:
    """Reader and slip observer of N vehicles; arguments as those of the identification stack.

    observation: (N, SIZE), and behind it ATTITUDE where `attitude` is True.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        count: int = 1,
        lateral: str = "sliding",
        attitude: bool = False,
    ) -> None:
        setting = Setting(parameters, control_period, data_sheet, count, lateral, attitude)
        self.reader = ObservationReader(control_period, count, data_sheet.pose_delay)
        self.slip = SlipObserver.for_stack(setting)
        self._scales = layout.make_layout(["attitude"]).scale[:3] if attitude else None
        maximum = drive_limits(parameters).effort_maximum
        modulus = parameters.shear_deformation_modulus
        soil = np.array([maximum, modulus])
        self._soil = np.tile(soil, (count, 1))
        self._uncertain = np.tile(np.diag((np.array(PRIOR_SIGMA) * soil) ** 2), (count, 1, 1))
        self._friction = np.full(count, float(parameters.lateral_resistance))

    @property
    def needs(self) -> tuple[str, ...]:
        """Fields of the observation that are read."""
        return (*NEEDS, *(ATTITUDE if self._scales is not None else ()))

    def memories(self) -> Sequence[NDArray[np.float64]]:
        """A copy of everything that is remembered; `restore` puts it back."""
        return self.reader.memory.copy(), self.slip.memory.copy()

    def restore(self, memories: Sequence[NDArray[np.float64]]) -> None:
        """Go on from what `memories` returned. Raises ValueError for that of another batch."""
        own = (self.reader.memory, self.slip.memory)
        for kept, memory in zip(own, memories, strict=True):
            if memory.shape != kept.shape:
                raise ValueError(
                    f"state with shape {memory.shape}; must be {kept.shape}. Is it that of "
                    "another batch, or of another control period?"
                )
        for kept, memory in zip(own, memories, strict=True):
            kept[:] = memory

    def update(self, observation: NDArray[np.float32], start: NDArray[np.bool_]) -> FilteredMotion:
        """Take one observation of every vehicle; rows with `start` begin anew.

        Raises ValueError for a reference, action or age that is not finite.
        """
        row, column, starts = links.inspect(observation, start)
        if row >= 0:
            raise ValueError(
                f"observation[{row}]: {layout.NAMES[column]} = {observation[row, column]}; must be "
                "finite. Only sensors may be NaN. Did a wrapper divide by zero?"
            )
        if starts:
            self.reader.reset(start)
            self.slip.reset(start)
        reading = self.reader.take(observation, start)
        moment = late_pose.moment_of(self.reader, reading)
        latest, behind = moment.samples, np.empty(len(observation))
        if self._scales is not None:
            shown = observation[:, layout.SIZE : layout.SIZE + 3].astype(np.float64) * self._scales
            latest = WiderMeasurement.of(latest, dict(zip(ATTITUDE, shown.T, strict=True)))
        links.date(latest.age, moment.drive_delay, behind)
        self.slip.take_ground(self._soil, self._uncertain, self._friction)
        answer = late_pose.filtered(self.slip, latest, moment.held)
        motion = self.slip.motion_rows()
        links.put_velocity(motion, moment.paired.values)
        links.advance(motion, behind, moment.paired.values, attitude_of(latest))
        late_pose.to_present(motion, self.reader, self.slip, moment, attitude_of(latest))
        return FilteredMotion(reading.latest, reading.reference, motion, answer)
