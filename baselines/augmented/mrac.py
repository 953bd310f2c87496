"""Model-reference adaptive augmentation of the linearizing law.

The law keeps its form; mass, motion resistance, inertia and turning resistance in it are adapted,
one channel each for forward speed and yaw rate, with what is left as a constant force and moment.
Parameters are ratios to the nominal ones:
    thrust = p_1 (v_x' - w v_y) + p_2 R_0 / m_0 + p_3       [m/s^2]
    twist  = q_1 w' + q_2 M_0 / I_0 + q_3                   [rad/s^2]
    m = p_1 m_0,  mu_l = mu_l0 p_2 / p_1,  I = q_1 I_0,  mu_t = mu_t0 q_2 / p_1
They make the prediction right, and are not claimed to be those of the vehicle.

Adaptation of one channel by a Lyapunov update law: thrust h (over the nominal mass or inertia)
moves x against the parts r and 1 of the load,
    h   = q_1 x' + q_2 r + q_3                      the vehicle, q unknown, q_1 > 0
    h   = p_1 a + p_2 r + p_3                       the law: a is what it asks of its parameters p
    x_m'= a + l (x - x_m)                           reference model, fed with the error e = x - x_m
    e'  = -l e + (p - q)' y / q_1,  y = (a, r, 1)
    p'  = -G y E(e) / (1 + y' G y / l^2) - k (p - p_0)
E(e) = e - clip(e, -z, z): dead zone z. k: sigma modification, a pull towards the nominal p_0. p
stays in the box [low, high]: for a diagonal G that clipping is the projection. The normalization
keeps adaptation slower than the reference model: y' G y / (1 + ..) < l^2. a follows from the effort
that was applied, limits and lag included, so that a saturated drive teaches nothing wrong. Without
excitation no parameter is claimed to be right, the prediction is: docs/augmented.md

References: [1] Lavretsky, Wise, Robust and Adaptive Control (2013), chapters 9 to 11. [2] Gibson,
Annaswamy, Lavretsky, IEEE Access 1 (2013), closed-loop reference models. [3] Johnson, Calise,
J. Guidance 26 (2003), pseudo-control hedging.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from baselines.augmented import augmented_policy as base
from baselines.linearizing import linearizing_law as law
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PARAMETER_INDEX as _ROW


class Load(NamedTuple):
    """Three numbers of a channel: parameters, gains, bounds, or regressors."""

    inertial: float  # of x'
    resisting: float  # of r
    constant: float  # of 1


class Sample(NamedTuple):
    """What a channel saw in one period."""

    change: float  # of the measured x
    thrust: float  # mean of h
    resisting: float  # mean of r


class Adaptation(NamedTuple):
    """Numbers of the law, for one channel."""

    gain: Load  # G, diagonal
    low: Load  # projection bounds
    high: Load
    nominal: Load  # p_0
    rate: float  # [1/s] l
    leak: float  # [1/s] k
    dead_zone: float  # [of x] z


_MASS, _RESISTANCE = _ROW["mass"], _ROW["longitudinal_resistance"]
_INERTIA, _FRICTION = _ROW["inertia"], _ROW["lateral_resistance"]
_FORWARD, _TURNING = base.CHANNEL_COLUMN, base.CHANNEL_COLUMN + 4  # columns of Load and error
# Projection bounds, ratios to the nominal values; constants [m/s^2, rad/s^2].
LOW, HIGH = Load(0.4, 0.05, -3.0), Load(2.5, 3.0, 3.0)
NOMINAL = Load(1.0, 1.0, 0.0)


class MracSettings(NamedTuple):
    """Settings of the law, and of both channels: the gains G, rates and dead zones."""

    k_p: float = 127.0  # [1/s^3] gains of the law
    k_v: float = 47.5  # [1/s^2]
    k_a: float = 10.7  # [1/s]
    bound: float = 0.118  # [m] what the law sees of a position error at most

    forward_inertial: float = 40.9  # [s/m^2] gain of the mass
    forward_resisting: float = 176.0  # [s/m^2] of the motion resistance
    forward_constant: float = 19.6  # [1/s^2] of the constant force
    turning_inertial: float = 37.2  # [s/rad^2] of the inertia
    turning_resisting: float = 140.0  # [s/rad^2] of the turning resistance
    turning_constant: float = 39.7  # [1/s^2] of the constant moment
    forward_rate: float = 23.8  # [1/s] l of the reference model
    turning_rate: float = 20.3  # [1/s]
    leak: float = 0.00514  # [1/s] sigma modification
    forward_dead_zone: float = 0.00185  # [m/s]
    turning_dead_zone: float = 0.00304  # [rad/s]
    drive_bandwidth: float = 145.0  # [1/s] of the low-pass filter of each drive's loop


# Setting -> (low, high, whether on a logarithmic scale) of a search.
TUNABLE = {
    **law.TUNABLE,
    "forward_inertial": (5.0, 5000.0, True),
    "forward_resisting": (1.0, 500.0, True),
    "forward_constant": (1.0, 500.0, True),
    "turning_inertial": (5.0, 5000.0, True),
    "turning_resisting": (1.0, 500.0, True),
    "turning_constant": (1.0, 500.0, True),
    "forward_rate": (5.0, 60.0, True),
    "turning_rate": (5.0, 60.0, True),
    "leak": (0.001, 0.3, True),
    "forward_dead_zone": (0.0, 0.01, False),
    "turning_dead_zone": (0.0, 0.01, False),
    "drive_bandwidth": (30.0, 300.0, True),
}


@formula
def demanded(parameters, thrust, resisting):
    """a: the x' that `thrust` gives by the parameters."""
    p = parameters
    return (thrust - p.resisting * resisting - p.constant) / p.inertial


@formula
def beyond(error, dead_zone):
    """What of an error exceeds the dead zone; odd."""
    return error - min(max(error, -dead_zone), dead_zone)


@formula
def _moved(p, middle, error, sample, law, period):
    """(Load, error e) after one period, with a of the parameters `middle` all through it."""
    a, resisting = demanded(middle, sample.thrust, sample.resisting), sample.resisting
    decay = math.exp(-law.rate * period)
    later = decay * error + (1.0 - decay) / law.rate * (sample.change / period - a)
    g, low, high, at = law.gain, law.low, law.high, law.nominal
    size = a * a * g.inertial + resisting * resisting * g.resisting + g.constant
    effect = beyond(0.5 * (error + later), law.dead_zone)
    keep = math.exp(-law.leak * period)
    lasting = (1.0 - keep) / law.leak if law.leak > 0.0 else period
    step = -lasting * effect / (1.0 + size / (law.rate * law.rate))
    inertial = at.inertial + keep * (p.inertial - at.inertial) + step * g.inertial * a
    resistance = at.resisting + keep * (p.resisting - at.resisting) + step * g.resisting * resisting
    constant = at.constant + keep * (p.constant - at.constant) + step * g.constant
    moved = Load(
        min(max(inertial, low.inertial), high.inertial),
        min(max(resistance, low.resisting), high.resisting),
        min(max(constant, low.constant), high.constant),
    )
    return moved, later


@formula
def adapted(p, error, sample, law, period):
    """(Load p, error e) after one period [s].

    sample: Sample over it; law: Adaptation. Of second order in the period (midpoint rule): e by its
    exact solution for constant a, p by the mean of e.
    """
    ahead, _error = _moved(p, p, error, sample, law, period)
    middle = Load(
        0.5 * (p.inertial + ahead.inertial),
        0.5 * (p.resisting + ahead.resisting),
        0.5 * (p.constant + ahead.constant),
    )
    return _moved(p, middle, error, sample, law, period)


@formula
def _channel(memory, i, at, sample, law, setting):
    """Adapt Load and error of vehicle i in columns `at` and following, in and out."""
    p = Load(memory[i, at], memory[i, at + 1], memory[i, at + 2])
    p, memory[i, at + 3] = adapted(p, memory[i, at + 3], sample, law, setting.period)
    memory[i, at], memory[i, at + 1], memory[i, at + 2] = p


@loop
def adapt_all(observation, torques, setting, laws, memory, parameters, lacking):
    """One step of all vehicles: observation (N, >= SIZE) filtered, torques (N, 2) [N m] measured or
    NaN, laws: Adaptation of both channels, memory (N, CHANNEL_COLUMN + 8) in and out, parameters
    (PARAMETER_ROWS, N) and lacking (N, 2) [m/s^2, rad/s^2] out."""
    p, period, a, b = setting.nominal, setting.period, _FORWARD, _TURNING
    for i in range(observation.shape[0]):
        mean, faster, turned, begun = base.last_period(observation, i, torques, memory, setting)
        if begun:
            speed, turn = faster - period * mean.pull, turned - period * mean.carried
            _channel(memory, i, a, Sample(speed, mean.thrust, mean.resistance), laws[0], setting)
            _channel(memory, i, b, Sample(turn, mean.twist, mean.turning), laws[1], setting)
        mass, inertia = memory[i, a], memory[i, b]
        parameters[_MASS, i] = p.mass * mass
        parameters[_RESISTANCE, i] = p.longitudinal_resistance * memory[i, a + 1] / mass
        parameters[_INERTIA, i] = p.inertia * inertia
        parameters[_FRICTION, i] = p.lateral_resistance * memory[i, b + 1] / mass
        lacking[i, 0], lacking[i, 1] = -memory[i, a + 2] / mass, -memory[i, b + 2] / inertia


class MracPolicy(base.AugmentedPolicy):
    """The law with model-reference adaptation; arguments as AugmentedPolicy, and settings.

    Raises ValueError for a setting that is negative or not a number, or a rate that is zero.
    """

    first = np.array([*np.zeros(base.CHANNEL_COLUMN), *NOMINAL, 0.0, *NOMINAL, 0.0])

    def __init__(
        self, *arguments: Any, settings: MracSettings | None = None, **options: Any
    ) -> None:
        self.settings = s = base.checked_settings(settings or MracSettings(), {"_rate": 1e-3})
        super().__init__(*arguments, **options)
        bounds = (LOW, HIGH, NOMINAL)
        forward = Load(s.forward_inertial, s.forward_resisting, s.forward_constant)
        turning = Load(s.turning_inertial, s.turning_resisting, s.turning_constant)
        self._laws = (
            Adaptation(forward, *bounds, s.forward_rate, s.leak, s.forward_dead_zone),
            Adaptation(turning, *bounds, s.turning_rate, s.leak, s.turning_dead_zone),
        )

    def adapt(self, observation: Any, torques: Any, adaptation: Any) -> None:
        """As AugmentedPolicy.adapt."""
        sample, law = (observation, torques, self._setting), self.controller
        adapt_all(*sample, self._laws, adaptation, law.parameters, law.lacking)
