"""The adaptive policy with what the environment knows: true parameters, true motion, or both.

The true parameters are those in force. A plant whose soil shears under the tracks reads no lateral
resistance, and its belts have inertia: the lumped model has no true parameters there. On level
ground the oracle then takes those with which the model has the forces of the plant as it moves now:
    m' = m + 2 J / r^2,   I' = I + (J / r^2) B^2 / 2       belts that roll, J that of one
    mu_l' m' = mu_l m,    F_max' = F_max m' / m            of the torques over r
    mu_t' m' = C:   I dw/dt = (B/2) [(F_R - R_R) - (F_L - R_L)] + f M(v_y, w; C)
    x' = w (v_y - v_y(v, w; mu_t', m')) / (w^2 + w_0^2)    centre of mass ahead of the contact
with the steady v_y of linearizing_law. Shear grows from the front of a track to its rear, where
therefore most of the friction acts; x' is what that does to the side slip. C is found with the
weights (M^2, M_0^2) of this equation and of a usual resistance: where the vehicle does not turn,
the equation says nothing. On slopes, where gravity and the load of each patch move the vehicle as
well, inertia and lateral resistance are identified, together.

With the true motion the controller sees true pose and velocities in place of the filtered ones; the
estimators, where they are used, go on with what was measured.
"""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from baselines.batch_policy import Array
from baselines.linearizing import linearizing_law as law
from baselines.linearizing.adaptive_policy import AdaptivePolicy, FixedParametersPolicy
from tracked_env.physics import lumped
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PARAMETER_INDEX as _ROW
from tracked_env.physics.parameters import PARAMETER_NAMES, row_parameters

PARAMETERS, MOTION = "parameters", "motion"  # what a policy may be told
LOADS = ("v_x", "v_y", "yaw_rate", "yaw_acceleration", "effort_left", "effort_right")
_MOTION = ("x", "y", "yaw", "v_x", "v_y", "yaw_rate")
_REFERENCE = ("reference_x", "reference_y", "reference_yaw")
USUAL_RESISTANCE = 0.5  # [-] mu_t of a vehicle that does not turn
STRAIGHT = 0.1  # [-] M_0 over m g l / 4, the friction moment of a turn on the spot at mu_t = 1
SLOW_TURN = 0.02  # [rad/s] w_0
LARGEST = 12.0, 0.25  # [-] mu_t on cohesive soil, and x' over the contact length
_MASS, _INERTIA, _COHESION = _ROW["mass"], _ROW["inertia"], _ROW["cohesion"]
_ALONG, _ACROSS = _ROW["longitudinal_resistance"], _ROW["lateral_resistance"]
_AHEAD = _ROW["centre_of_mass_x"]
IDENTIFIED = [_INERTIA, _ACROSS, _AHEAD]  # on slopes


@loop
def use_equivalents(loads, parameters):
    """Parameters (PARAMETER_ROWS, N) of a plant with shear under the tracks become those of the
    lumped model, see the head of the file; loads (len(LOADS), N)."""
    inverse_width = 1.0 / soil.MOTION_RESISTANCE_REGULARISATION
    for i in range(parameters.shape[1]):
        v_x, v_y, yaw_rate = loads[0, i], loads[1, i], loads[2, i]
        bend, left, right = loads[3, i], loads[4, i], loads[5, i]
        p = row_parameters(parameters.T, i, 0)
        k, weight = lumped.coefficients(p, False), p.mass * soil.GRAVITY
        turn, belt = yaw_rate * k.half_gauge, p.sprocket_inertia * k.inverse_radius**2
        drive = right - soil.resisting(v_x + turn, right, k.resistance, inverse_width)
        drive -= left - soil.resisting(v_x - turn, left, k.resistance, inverse_width)
        unit = weight / k.contact_length
        _force, moment = soil.lateral_friction(v_y, yaw_rate, unit, k.contact_length)
        moment *= k.turning_resistance_factor
        least = STRAIGHT * 0.25 * weight * k.contact_length
        product = moment * (p.inertia * bend - k.half_gauge * drive)
        across = product + least * least * USUAL_RESISTANCE
        across = min(max(across / (moment * moment + least * least), 0.0), LARGEST[0])
        growth = (p.mass + 2.0 * belt) / p.mass
        parameters[_MASS, i] *= growth
        parameters[_INERTIA, i] += 2.0 * belt * k.half_gauge**2
        parameters[_ALONG, i] /= growth
        parameters[_COHESION, i] *= growth  # the frictional part grows with the mass
        parameters[_ACROSS, i] = across / growth
        k = lumped.coefficients(row_parameters(parameters.T, i, 0), False)
        slip = v_y - law.steady_lateral_velocity(v_x, yaw_rate, k)
        ahead = yaw_rate * slip / (yaw_rate * yaw_rate + SLOW_TURN * SLOW_TURN)
        most = LARGEST[1] * k.contact_length
        parameters[_AHEAD, i] = min(max(ahead, -most), most)


class OraclePolicy(FixedParametersPolicy):
    """The adaptive policy with the truth handed to `observe_truth`; arguments as AdaptivePolicy.

    told: PARAMETERS, MOTION, or both.
    """

    needs_truth = True
    _without_effect: Collection[str] = ()

    def __init__(
        self, *arguments: Any, told: Collection[str] = (PARAMETERS,), **options: Any
    ) -> None:
        super().__init__(*arguments, **options)
        self._told = told

    def observe_plant(self, without_effect: Collection[str]) -> None:
        """Take note of the parameters that the plant does not read."""
        self._without_effect = without_effect

    def observe_truth(self, truth: Mapping[str, Array]) -> None:
        """Take over the truth, {name: number or (N,)}; other names are ignored."""

        def rows(names: tuple[str, ...]) -> Array:
            return np.stack([np.atleast_1d(truth[name]) for name in names])

        policy: AdaptivePolicy = self._policy
        if PARAMETERS in self._told:
            parameters = policy.fixed_parameters = rows(PARAMETER_NAMES)
            shears = "lateral_resistance" in self._without_effect
            if shears and "centre_of_mass_x" in self._without_effect:  # a plant on level ground
                use_equivalents(rows(LOADS), parameters)
            elif shears:
                parameters[IDENTIFIED] = np.nan
        if MOTION in self._told:
            policy.true_motion = rows(_REFERENCE).T.copy(), rows(_MOTION).T.copy()
