"""L1 adaptive augmentation of the linearizing law with nominal parameters.

Forward speed and yaw rate are one channel each (`matched_uncertainty`); what their predictors find
that the nominal model lacks, low-passed, is cancelled by the efforts:
    net force m_0 (u_1 - d_1 - w v_y),   moment I_0 (u_2 - d_2) - f M_0
Position and heading are no channels: what acts on them is not matched, and the outer loop of the
law, whose model they are, is exact for them.

References: [1] Hovakimyan, Cao, L1 Adaptive Control Theory (SIAM 2010).
"""

from typing import Any, NamedTuple

import numpy as np

from baselines.augmented.augmented_policy import AugmentedPolicy
from baselines.augmented.channel_loads import OWN, last_period
from baselines.augmented.matched_uncertainty import Estimate, sampled
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_number


class L1Settings(NamedTuple):
    """Settings of both channels; forward first, then turning."""

    forward_bandwidth: float = 5.0  # [1/s] of the low-pass filter
    turning_bandwidth: float = 5.0  # [1/s]
    forward_rate: float = 1.0  # [1/s] a of the predictor's error
    turning_rate: float = 1.0  # [1/s]
    drive_bandwidth: float = 30.0  # [1/s] of the low-pass filter of each drive's loop
    forward_bound: float = 8.0  # [m/s^2] of what is cancelled
    turning_bound: float = 15.0  # [rad/s^2]


# Setting -> (low, high, whether on a logarithmic scale) of a search.
TUNABLE = {
    "forward_bandwidth": (0.5, 50.0, True),
    "turning_bandwidth": (0.5, 50.0, True),
    "drive_bandwidth": (1.0, 200.0, True),
    "forward_rate": (0.1, 20.0, True),
    "turning_rate": (0.1, 20.0, True),
}
_ALLOWED = Range(0.0, 1e6, "SI", "Bandwidths, rates and bounds are not negative.")


@loop
def adapt_all(observation, torques, p, period, constrained, sloped, settings, memory, lacking):
    """One step of all vehicles: observation (N, >= SIZE) filtered, torques (N, 2) [N m] measured or
    NaN, p nominal, memory (N, OWN + 6) in and out, lacking (N, 2) [m/s^2, rad/s^2] out."""
    s = settings
    for i in range(observation.shape[0]):
        last = last_period(
            observation, i, torques, memory, p, s.drive_bandwidth, period, constrained, sloped
        )
        mean = last.mean
        if last.known:
            forward = Estimate(memory[i, OWN], memory[i, OWN + 1], memory[i, OWN + 2])
            turning = Estimate(memory[i, OWN + 3], memory[i, OWN + 4], memory[i, OWN + 5])
            forward = sampled(
                forward, last.speed_change, mean.thrust - mean.resistance + mean.pull,
                s.forward_rate, s.forward_bandwidth, s.forward_bound, period,
            )  # fmt: skip
            turning = sampled(
                turning, last.yaw_rate_change, mean.twist - mean.turning + mean.carried,
                s.turning_rate, s.turning_bandwidth, s.turning_bound, period,
            )  # fmt: skip
            memory[i, OWN], memory[i, OWN + 1], memory[i, OWN + 2] = forward
            memory[i, OWN + 3], memory[i, OWN + 4], memory[i, OWN + 5] = turning
        lacking[i, 0], lacking[i, 1] = memory[i, OWN + 2], memory[i, OWN + 5]


class L1Policy(AugmentedPolicy):
    """The nominal law with L1 adaptive augmentation; arguments as AugmentedPolicy, and settings.

    Raises ValueError for a setting that is negative or not a number.
    """

    first = np.zeros(OWN + 6)

    def __init__(self, *arguments: Any, settings: L1Settings | None = None, **options: Any) -> None:
        super().__init__(*arguments, **options)
        given = L1Settings() if settings is None else settings
        for name, value in given._asdict().items():
            checked_number(name, value, _ALLOWED)
        self.settings = L1Settings(*(float(value) for value in given))

    def adapt(self, observation: Any, torques: Any, adaptation: Any) -> None:
        """As AugmentedPolicy.adapt."""
        adapt_all(
            observation,
            torques,
            *self.arguments(),
            self.settings,
            adaptation,
            self.controller.lacking,
        )
