"""L1 adaptive augmentation of the linearizing law with nominal parameters.

Forward speed and yaw rate are one channel each (`augmented_policy`); what their predictors find
that the nominal model lacks, low-passed, is cancelled by the efforts:
    net force m_0 (u_1 - d_1 - w v_y),   moment I_0 (u_2 - d_2) - f M_0
Position and heading are no channels: what acts on them is not matched, and the outer loop of the
law, whose model they are, is exact for them.

References: [1] Hovakimyan, Cao, L1 Adaptive Control Theory (SIAM 2010).
"""

from typing import Any, NamedTuple

import numpy as np

from baselines.augmented import augmented_policy as base
from baselines.linearizing import linearizing_law as law
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PlantParameters, plant_parameters


class L1Settings(NamedTuple):
    """Settings of the law and of both channels; forward first, then turning."""

    k_p: float = 120.0  # [1/s^3] gains of the law
    k_v: float = 60.0  # [1/s^2]
    k_a: float = 12.3  # [1/s]
    bound: float = 0.35  # [m] what the law sees of a position error at most
    mass_factor: float = 1.48  # [-] mass that the law and the predictor assume over the nominal one
    inertia_factor: float = 1.42  # [-] the same of the inertia; both set the input gain
    forward_bandwidth: float = 40.0  # [1/s] of the low-pass filter
    turning_bandwidth: float = 54.0  # [1/s]
    forward_rate: float = 1.0  # [1/s] a of the predictor's error
    turning_rate: float = 1.0  # [1/s]
    drive_bandwidth: float = 67.0  # [1/s] of the low-pass filter of each drive's loop
    forward_bound: float = 8.0  # [m/s^2] of what is cancelled
    turning_bound: float = 15.0  # [rad/s^2]


# Setting -> (low, high, whether on a logarithmic scale) of a search.
TUNABLE = {
    **law.TUNABLE,
    "mass_factor": (0.8, 1.8, True),
    "inertia_factor": (0.8, 1.6, True),
    "forward_bandwidth": (5.0, 100.0, True),
    "turning_bandwidth": (5.0, 100.0, True),
    "drive_bandwidth": (30.0, 300.0, True),
}
_FORWARD, _TURNING = base.CHANNEL_COLUMN, base.CHANNEL_COLUMN + 3  # columns of the Estimates


@loop
def adapt_all(observation, torques, setting, loops, memory, lacking):
    """One step of all vehicles: observation (N, >= SIZE) filtered, torques (N, 2) [N m] measured or
    NaN, loops: Loop of both channels, memory (N, CHANNEL_COLUMN + 6) in and out, lacking (N, 2)
    [m/s^2, rad/s^2] out."""
    period, a, b = setting.period, _FORWARD, _TURNING
    for i in range(observation.shape[0]):
        last = base.last_period(observation, i, torques, memory, setting)
        mean = last.mean
        if last.begun:
            net = mean.thrust - mean.resistance + mean.pull
            moment = mean.twist - mean.turning + mean.carried
            base.advance(memory, i, a, last.speed_change, net, loops[0], period)
            base.advance(memory, i, b, last.yaw_rate_change, moment, loops[1], period)
        lacking[i, 0], lacking[i, 1] = memory[i, a + 2], memory[i, b + 2]


class L1Policy(base.AugmentedPolicy):
    """The nominal law with L1 adaptive augmentation; arguments as AugmentedPolicy, and settings.

    Raises ValueError for a setting that is negative or not a number.
    """

    first = np.zeros(base.CHANNEL_COLUMN + 6)

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        *arguments: Any,
        settings: L1Settings | None = None,
        **options: Any,
    ) -> None:
        self.settings = s = base.checked_settings(settings or L1Settings(), {"_factor": 0.1})
        p = plant_parameters() if parameters is None else parameters
        assumed = p._replace(  # with the resistances of the nominal vehicle
            mass=p.mass * s.mass_factor,
            inertia=p.inertia * s.inertia_factor,
            longitudinal_resistance=p.longitudinal_resistance / s.mass_factor,
            lateral_resistance=p.lateral_resistance / s.mass_factor,
        )
        super().__init__(assumed, *arguments, **options)
        self._loops = (
            base.Loop(s.forward_rate, s.forward_bandwidth, s.forward_bound),
            base.Loop(s.turning_rate, s.turning_bandwidth, s.turning_bound),
        )

    def adapt(self, observation: Any, torques: Any, adaptation: Any) -> None:
        """As AugmentedPolicy.adapt."""
        lacking = self.controller.lacking
        adapt_all(observation, torques, self._setting, self._loops, adaptation, lacking)
