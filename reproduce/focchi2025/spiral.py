"""Figure 10: unicycle and slippage-aware controller on the pseudo-kinematic model, on a spiral.

F prints v_d = 0.3 m/s and w_d = 4 t, on a model without limits. In rad/s that takes the outer
sprocket within half a second beyond the 10 rad/s up to which slip was identified (`beyond_after`).
Here w_d = 0.05 t: a radius of 0.3 m after 20 s.
"""

from typing import NamedTuple

import numpy as np

from baselines.estimators.sensor_samples import DataSheet
from baselines.lyapunov.lyapunov_laws import LyapunovGains, PoseError, lyapunov_value
from baselines.lyapunov.pseudo_kinematic import PseudoKinematicModel
from baselines.lyapunov.slippage_aware import SlippageAwarePolicy, UnicyclePolicy
from baselines.slip.slip_sweep import identified_slip
from reproduce.focchi2025.loop import Kinematic, follow, sampled
from reproduce.focchi2025.runs import LENGTHS, Floats, Run, vehicle
from tracked_env.physics.parameters import PlantParameters
from tracked_env.references import ReferenceProfile
from tracked_env.references.profile import constant, knot_times
from tracked_env.sensors import PRESETS

SPEED = 0.3  # [m/s] v_d
YAW_ACCELERATION = 0.05  # [rad/s^2] w_d / t
PRINTED = 4.0  # [rad/s^2]
START = (0.3, 0.3, 0.2)  # [m, m, rad]
DURATION = 20.0  # [s]
RATE = 200.0  # [Hz]


class Spiral(NamedTuple):
    """One controller on the spiral."""

    run: Run
    value: Floats  # (T,) Lyapunov function (38), or (45) for the slippage-aware controller

    @property
    def rises(self) -> float:
        """Largest rise of the value above its least one so far [-]."""
        return float(np.max(self.value - np.minimum.accumulate(self.value)))


def profile() -> ReferenceProfile:
    """The reference of figure 10."""
    starts = knot_times(DURATION)[:-1]
    turn = constant(0.0, len(starts))
    turn[:, 0], turn[:, 1] = YAW_ACCELERATION * starts, YAW_ACCELERATION
    return ReferenceProfile(constant(SPEED, len(starts)), turn)


def beyond_after(parameters: PlantParameters, slope: float = PRINTED) -> float:
    """Time [s] at which w_d = slope t, without slip, takes the outer sprocket beyond its limit."""
    fastest = parameters.sprocket_radius * parameters.sprocket_speed_limit
    return (fastest - SPEED) / (0.5 * parameters.track_gauge * slope)


def run_all(length: float = LENGTHS[-1], duration: float = DURATION) -> dict[str, Spiral]:
    """Both controllers, {"uc", "slc"}; the slippage-aware one knows the slip of the model."""
    parameters = vehicle(length)
    model = identified_slip(parameters)
    sheet, period = DataSheet.of(PRESETS["ideal"]), 1.0 / RATE
    aware = SlippageAwarePolicy(parameters, period, model, data_sheet=sheet)
    policies = {"uc": UnicyclePolicy(parameters, period, data_sheet=sheet), "slc": aware}
    found = {}
    for kind, policy in policies.items():
        plant = Kinematic(PseudoKinematicModel(parameters, model))
        reference = sampled([profile()], RATE, duration)
        run = follow(policy, plant, reference, START, parameters, RATE)
        alpha: Floats = np.zeros(len(run.time))
        if policy is aware:
            rows = np.zeros((len(run.time), 4))
            rows[:, 0], rows[:, 1] = SPEED, YAW_ACCELERATION * run.time
            rows[:, 3] = YAW_ACCELERATION
            alpha = aware.reference_slip(rows)[0]
        errors = zip(run.distance[:, 0], run.heading[:, 0], alpha, strict=True)
        gains = LyapunovGains()
        value = [
            lyapunov_value(PoseError(e_xy, 0.0, e_h), slip, gains) for e_xy, e_h, slip in errors
        ]
        found[kind] = Spiral(run, np.array(value))
    return found
