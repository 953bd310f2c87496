"""Cost of the model predictive controller for the torque-driven vehicle.

Over N stages of h seconds the commands u_k, in units of the largest torque, minimise
    sum_{k=1..N} t_k [q_p |p_k - p_ref|^2 + q_psi (yaw_k - yaw_ref)^2 + q_v (v_k - v_ref)^2
                      + q_w (w_k - w_ref)^2]
    + sum_{k<N} [r |u_k - f_k|^2 + r_c |(u_k - e_k) (1 - exp(-h/T))|^2],   t_k = 1, t_N = terminal
with the states of `tracked_prediction`, the reference of `path_ahead`, f the command that keeps the
model on it, and (u - e) (1 - exp(-h/T)) what the effort of a drive changes by in a stage.
Gauss-Newton drops the curvature of the model: weights and gradients are all that its step needs.
"""

from typing import NamedTuple

from baselines.predictive.path_ahead import HEADING, PATH_SPEED, PATH_X, PATH_Y, PATH_YAW_RATE
from baselines.predictive.tracked_prediction import (
    GIVEN_LEFT,
    GIVEN_RIGHT,
    LEFT,
    RIGHT,
    SPEED,
    YAW,
    YAW_RATE,
    X,
    Y,
)
from tracked_env.physics.jit import formula


class PredictiveSettings(NamedTuple):
    """Weights and horizon."""

    position: float = 100.0  # [1/m^2] q_p
    heading: float = 10.0  # [1/rad^2] q_psi
    speed: float = 1.0  # [s^2/m^2] q_v
    yaw_rate: float = 0.3  # [s^2/rad^2] q_w
    effort: float = 3.0  # [-] r
    effort_change: float = 200.0  # [-] r_c
    terminal: float = 5.0  # [-] factor on the weights of the last state
    stages: float = 30.0  # [-] N, a whole number
    duration: float = 0.04  # [s] h
    traction: float = 0.98  # [-] share of the effort that the soil carries, F_limit, to be used
    smoothing: float = 1.0  # [-] s of the turning friction in the model


TUNABLE = {  # name -> lowest, highest, whether on a logarithmic scale
    "position": (30.0, 1000.0, True),
    "heading": (1.0, 100.0, True),
    "speed": (0.1, 10.0, True),
    "yaw_rate": (0.03, 3.0, True),
    "effort": (0.1, 100.0, True),
    "effort_change": (1.0, 1000.0, True),
    "terminal": (1.0, 20.0, True),
    "traction": (0.5, 1.0, False),
    "smoothing": (0.1, 1.0, True),
}


@formula
def set_costs(a, ahead, states, inputs, settings, coupling):
    """Weights and gradients of all stages from states (N + 1, STATES) and inputs (N, 2)."""
    count, path = inputs.shape[0], ahead.path
    for k in range(count + 1):
        factor = settings.terminal if k == count else 1.0
        weight, gradient = a.weight[k], a.gradient[k]
        weight[X] = weight[Y] = factor * settings.position
        weight[YAW] = factor * settings.heading
        weight[SPEED], weight[YAW_RATE] = factor * settings.speed, factor * settings.yaw_rate
        weight[GIVEN_LEFT] = weight[GIVEN_RIGHT] = 0.0
        gradient[GIVEN_LEFT] = gradient[GIVEN_RIGHT] = 0.0
        gradient[X] = weight[X] * (states[k, X] - path[k, PATH_X])
        gradient[Y] = weight[Y] * (states[k, Y] - path[k, PATH_Y])
        gradient[YAW] = weight[YAW] * (states[k, YAW] - path[k, HEADING])
        gradient[SPEED] = weight[SPEED] * (states[k, SPEED] - path[k, PATH_SPEED])
        gradient[YAW_RATE] = weight[YAW_RATE] * (states[k, YAW_RATE] - path[k, PATH_YAW_RATE])
        if k < count:
            weight[LEFT] = weight[RIGHT] = settings.effort
            gradient[LEFT] = settings.effort * (inputs[k, 0] - ahead.efforts[k, 0])
            gradient[RIGHT] = settings.effort * (inputs[k, 1] - ahead.efforts[k, 1])
            for side in range(2):
                change = coupling * (inputs[k, side] - states[k, GIVEN_LEFT + side])
                weight[LEFT + side] += coupling
                weight[GIVEN_LEFT + side] = coupling
                gradient[LEFT + side] += change
                gradient[GIVEN_LEFT + side] = -change


@formula
def total_cost(ahead, states, inputs, settings, coupling):
    """The sum that is minimised, of states (N + 1, STATES) from row 1 on and inputs (N, 2)."""
    count, path, total = inputs.shape[0], ahead.path, 0.0
    for k in range(count):
        left = inputs[k, 0] - ahead.efforts[k, 0]
        right = inputs[k, 1] - ahead.efforts[k, 1]
        total += settings.effort * (left * left + right * right)
        left = inputs[k, 0] - states[k, GIVEN_LEFT]
        right = inputs[k, 1] - states[k, GIVEN_RIGHT]
        total += coupling * (left * left + right * right)
        s, r = states[k + 1], path[k + 1]
        x, y, turn = s[X] - r[PATH_X], s[Y] - r[PATH_Y], s[YAW] - r[HEADING]
        v, w = s[SPEED] - r[PATH_SPEED], s[YAW_RATE] - r[PATH_YAW_RATE]
        cost = settings.position * (x * x + y * y) + settings.heading * turn * turn
        cost += settings.speed * v * v + settings.yaw_rate * w * w
        total += settings.terminal * cost if k + 1 == count else cost
    return total
