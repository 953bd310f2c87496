"""Reference and cost of the predictive controllers, and their step over the stages of the horizon.

Reference. An observation shows speed v and yaw rate w of the reference now, with their derivatives,
and 0.25, 0.5, 1 and 2 s ahead. Between them both are cubic: slopes of the parabola through three
neighbours, of the observed derivative now, and of the chord at the end. They are linear in the six
numbers, so a constant matrix gives them at the nodes of the horizon, where the pose follows by the
rule of `tracked_prediction`, in body axes of the present.

Cost. Over N stages of h seconds the commands u_k, in units of the largest torque, minimise
    sum_{k=1..N} t_k [q_p |p_k - p_ref|^2 + q_psi (yaw_k - yaw_ref)^2 + q_v (v_k - v_ref)^2
                      + q_w (w_k - w_ref)^2]
    + sum_{k<N} [r |u_k - f_k|^2 + r_c |(u_k - e_k) (1 - exp(-h/T))|^2],   t_k = 1, t_N = terminal
with the states of `tracked_prediction`, f the command that keeps the model on the reference, and
(u - e) (1 - exp(-h/T)) what the effort of a drive changes by in a stage. Gauss-Newton drops the
curvature of the model: weights and gradients are all that its step needs. The step is that of
`baselines.riccati` with |u| bounded where the input is chosen.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from baselines.batch_policy import Array
from baselines.predictive import tracked_prediction as model
from baselines.riccati import Stages, clipped, make_stages, recursion
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters, top_speed
from tracked_env.physics.rigid_body import in_plane_above

TIMES = (0.0, 0.25, 0.5, 1.0, 2.0)  # [s] at which speed and yaw rate are shown
_AHEAD = ("0.25", "0.5", "1", "2")
ERRORS = ("position_error_x", "position_error_y", "heading_error")
_SPEEDS, _TURNS = (
    (f"reference_{name}", *(f"reference_{name}_ahead_{t}" for t in _AHEAD), f"reference_{rate}")
    for name, rate in (("speed", "acceleration"), ("yaw_rate", "yaw_acceleration"))
)
PATH_NEEDS = (*ERRORS, *_SPEEDS, *_TURNS)  # fields of the observation
SHOWN = len(_SPEEDS)
TUNED_LENGTH = 2.2  # [m] contact length of the longest vehicle with these stages
TUNED_PACE = 3.0  # [1/s] top speed over contact length of the vehicle of the weights
TUNED_SPEED = 6.0  # [m/s] its top speed
_SPEED_COLUMNS = np.array([layout.INDEX[name] for name in _SPEEDS])
_TURN_COLUMNS = np.array([layout.INDEX[name] for name in _TURNS])
_SCALE = layout.SCALE

condense, fix_inputs, eliminate = recursion(model.STATES, model.ROWS, model.COLUMNS, 1)
PATH_X, PATH_Y, HEADING, PATH_SPEED, PATH_YAW_RATE = range(5)  # columns of a path
MEASURED = (model.X, model.Y, model.YAW, model.SPEED, model.YAW_RATE)  # states that they are of


class PredictiveSettings(NamedTuple):
    """Weights and horizon."""

    position: float = 92.0  # [1/m^2] q_p
    heading: float = 2.6  # [1/rad^2] q_psi
    speed: float = 1.05  # [s^2/m^2] q_v
    yaw_rate: float = 0.12  # [s^2/rad^2] q_w
    effort: float = 0.64  # [-] r
    effort_change: float = 41.0  # [-] r_c
    terminal: float = 3.2  # [-] factor on the weights of the last state
    stages: float = 30.0  # [-] N, a whole number
    duration: float = 0.04  # [s] h
    traction: float = 0.96  # [-] share of the effort that the soil carries, F_limit, to be used
    smoothing: float = 0.76  # [-] s of the turning friction in the model

    def for_pace(self, p: PlantParameters) -> "PredictiveSettings":
        """Those of another vehicle than the one for which they were chosen.

        A longer vehicle answers more slowly, as the root of its length: its stages are longer, or
        it swings about the path from an error that it cannot remove within the horizon. Where the
        horizon covers less of the length all the same, places count more against headings.

        A tighter turn first shifts the centre of mass outwards, by what the side slip changes: the
        way back from an error begins in the wrong direction for 0.6 L at three fifths of the
        sideways grip. A large or fast vehicle whose place counts too much against its heading
        turns ever tighter to come back, and whirls: its headings count L^2 times, L in m.
        """
        longest = TIMES[-1] / (self.stages * self.duration)
        slower = min(max(math.sqrt(p.contact_length / TUNED_LENGTH), 1.0), longest)
        factor = TUNED_PACE * p.contact_length / (top_speed(p) * slower * slower)
        larger = p.contact_length > TUNED_LENGTH or top_speed(p) > TUNED_SPEED
        return self._replace(
            position=self.position * min(max(factor, 1.0), 10.0),
            heading=self.heading * (max(p.contact_length**2, 1.0) if larger else 1.0),
            duration=self.duration * slower,
        )


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


class Ahead(NamedTuple):
    """Reference of one vehicle, N stages."""

    path: Array  # (N + 1, 5) pose of the vehicle on the path, v_x and yaw rate
    efforts: Array  # (N, 2) [-] in units of the largest command, that drive it
    speed: Array  # (N + 1,) [m/s] along the path
    turn: Array  # (N + 1,) [rad/s]


class Work(NamedTuple):
    """What the kernels write to, for one vehicle after the other."""

    stages: Stages
    ahead: Ahead
    states: Array  # (N + 1, STATES) of the last plan
    new_states: Array  # (N + 1, STATES) of the one that is tried
    new_inputs: Array  # (N, 2)
    weight: Array  # (N + 1, STATES + 2) diagonal of the Hessians; inputs of the last are not used
    gradient: Array  # (N + 1, STATES + 2) of the cost
    change: Array  # (STATES,) of the state, against that of the gains


class Task(NamedTuple):
    """What the plans of a batch have in common."""

    weights: Array  # of `interpolation`
    settings: PredictiveSettings
    share: float  # [-] of a stage that a control step takes
    sloped: bool  # whether ATTITUDE stands behind the fields of v0

    @classmethod
    def of(cls, settings: PredictiveSettings, control_period: float, sloped: bool) -> "Task":
        """With settings as floats, and stages at least as long as a control period [s].

        Raises ValueError for a weight that is not positive and finite, or a horizon that the
        observation does not show.
        """
        s = PredictiveSettings(*(float(value) for value in settings))
        s = s._replace(duration=max(s.duration, control_period))
        for name, value in s._asdict().items():
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} = {value:g}; must be positive and finite")
        if s.stages != round(s.stages) or s.stages * s.duration > TIMES[-1] + 1e-9:
            raise ValueError(
                f"stages = {s.stages:g} of {s.duration:g} s; must be a whole number, at most "
                f"{TIMES[-1]:g} s together: the observation shows no more of the reference"
            )
        weights = interpolation(s.duration * np.arange(int(s.stages) + 1))
        return cls(weights, s, control_period / s.duration, sloped)


def make_work(count: int) -> Work:
    """Work space for `count` stages."""
    n, states, every = count, (count + 1, model.STATES), (count + 1, model.STATES + 2)
    ahead = Ahead(np.zeros((n + 1, 5)), np.zeros((n, 2)), np.zeros(n + 1), np.zeros(n + 1))
    stages = make_stages(n, model.STATES, model.ROWS, model.COLUMNS, 1)
    plan = np.zeros(states), np.zeros(states), np.zeros((n, 2))
    return Work(stages, ahead, *plan, np.zeros(every), np.zeros(every), np.zeros(model.STATES))


def interpolation(times: ArrayLike) -> Array:
    """Matrix (len(times), SHOWN): values at TIMES and the slope at 0, to values at `times` [s]."""
    nodes = np.array(TIMES)
    value = np.eye(len(nodes), SHOWN)
    chord = np.diff(value, axis=0) / np.diff(nodes)[:, np.newaxis]
    slope = np.zeros_like(value)
    slope[0, -1] = 1.0
    before, after = np.diff(nodes)[:-1, np.newaxis], np.diff(nodes)[1:, np.newaxis]
    slope[1:-1] = (after * chord[:-1] + before * chord[1:]) / (before + after)
    slope[-1] = chord[-1]
    at = np.asarray(times, dtype=np.float64)
    return np.asarray(CubicHermiteSpline(nodes, value, slope)(at), dtype=np.float64)


@formula
def _shown(observation, i, columns, weights, sign, out):
    for k in range(out.shape[0]):
        total = 0.0
        for c in range(SHOWN):
            column = columns[c]
            total += weights[k, c] * (observation[i, column] * _SCALE[column])
        out[k] = sign * total


@formula
def lay_path(observation, i, weights, facing, start, incline, h, ahead):
    """Pose, speed and yaw rate of the reference at the nodes of the horizon, into ahead.

    start: (x, y, heading) of the reference now, in body axes; facing: -1.0 where the path is
    followed in reverse; h [s]: of a stage.
    """
    v, w, path = ahead.speed, ahead.turn, ahead.path
    _shown(observation, i, _SPEED_COLUMNS, weights, facing, v)
    _shown(observation, i, _TURN_COLUMNS, weights, 1.0, w)
    x, y, heading = start
    for k in range(path.shape[0]):
        if k > 0:
            half_turn = 0.25 * h * (w[k - 1] + w[k])
            cosine, sine = rotation(heading + half_turn)
            way = 0.5 * h * (v[k - 1] + v[k])
            along, across = in_plane_above(way * cosine, way * sine, incline)
            x, y, heading = x + along, y + across, heading + 2.0 * half_turn
        path[k, PATH_X], path[k, PATH_Y], path[k, HEADING] = x, y, heading
        path[k, PATH_SPEED], path[k, PATH_YAW_RATE] = v[k], w[k]


@formula
def set_costs(w, inputs, settings, coupling):
    """Weights and gradients of all stages from w.states (N + 1, STATES) and inputs (N, 2).

    coupling: weight of |u - e|^2.
    """
    count, path, states, efforts = inputs.shape[0], w.ahead.path, w.states, w.ahead.efforts
    for k in range(count + 1):
        factor = settings.terminal if k == count else 1.0
        weight, gradient = w.weight[k], w.gradient[k]
        weight[model.X] = weight[model.Y] = factor * settings.position
        weight[model.YAW] = factor * settings.heading
        weight[model.SPEED] = factor * settings.speed
        weight[model.YAW_RATE] = factor * settings.yaw_rate
        weight[model.EFFORT_LEFT] = weight[model.EFFORT_RIGHT] = 0.0
        gradient[model.EFFORT_LEFT] = gradient[model.EFFORT_RIGHT] = 0.0
        for column in range(len(MEASURED)):
            s = MEASURED[column]
            gradient[s] = weight[s] * (states[k, s] - path[k, column])
        if k < count:
            for side in range(2):
                u, e = model.LEFT + side, model.EFFORT_LEFT + side
                change = coupling * (inputs[k, side] - states[k, e])
                weight[u], weight[e] = settings.effort + coupling, coupling
                gradient[u] = settings.effort * (inputs[k, side] - efforts[k, side]) + change
                gradient[e] = -change


@loop
def improve(w, inputs, bounds, lag, coupling):
    """Offsets and gains of all stages about inputs (N, 2), within bounds (2,) of |u|.

    lag [-]: of the efforts over a stage; coupling: as in `set_costs`.
    """
    a, count = w.stages, inputs.shape[0]
    low, high = np.empty(2), np.empty(2)
    a.value[:, :] = 0.0
    for s in range(model.STATES):
        a.value[s, s] = w.weight[count, s]
        a.linear[0, s] = w.gradient[count, s]
    for back in range(count):
        k = count - 1 - back
        for s in range(model.STATES + 2):
            a.hessian[k, s, s], a.gradient[k, s] = w.weight[k, s], w.gradient[k, s]
        for side in range(2):
            a.hessian[k, model.EFFORT_LEFT + side, model.LEFT + side] = -coupling
            low[side] = -bounds[side] - inputs[k, side]
            high[side] = bounds[side] - inputs[k, side]
        condense(a, k, lag)
        left, right, inverse = fix_inputs(a, low, high)
        eliminate(a, k, inverse)
        a.offsets[k, 0, 0] += left
        a.offsets[k, 0, 1] += right


@formula
def improved(w, k, before, share, bounds):
    """w.new_inputs of stage k: those before, a share of the offset and feedback, in bounds (2,)."""
    for s in range(model.STATES):
        w.change[s] = w.new_states[k, s] - w.states[k, s]
    for side in range(2):
        target = before[side] + share * w.stages.offsets[k, 0, side]
        for s in range(model.STATES):
            target += w.stages.gains[k, side, s] * w.change[s]
        w.new_inputs[k, side] = clipped(target, -bounds[side], bounds[side])


@formula
def total_cost(w, states, inputs, settings, coupling):
    """The sum that is minimised, of states (N + 1, STATES) from row 1 on and inputs (N, 2)."""
    count, path, efforts, total = inputs.shape[0], w.ahead.path, w.ahead.efforts, 0.0
    for k in range(count):
        left, right = inputs[k, 0] - efforts[k, 0], inputs[k, 1] - efforts[k, 1]
        total += settings.effort * (left * left + right * right)
        left = inputs[k, 0] - states[k, model.EFFORT_LEFT]
        right = inputs[k, 1] - states[k, model.EFFORT_RIGHT]
        total += coupling * (left * left + right * right)
        s, r = states[k + 1], path[k + 1]
        x, y, turn = s[model.X] - r[PATH_X], s[model.Y] - r[PATH_Y], s[model.YAW] - r[HEADING]
        v, turn_rate = s[model.SPEED] - r[PATH_SPEED], s[model.YAW_RATE] - r[PATH_YAW_RATE]
        cost = settings.position * (x * x + y * y) + settings.heading * turn * turn
        cost += settings.speed * v * v + settings.yaw_rate * turn_rate * turn_rate
        total += settings.terminal * cost if k + 1 == count else cost
    return total


@formula
def shift(inputs, share):
    """Plan (N, 2) after a share of a stage: means over the new stages; the last command stays."""
    for k in range(inputs.shape[0] - 1):
        for side in range(2):
            inputs[k, side] += share * (inputs[k + 1, side] - inputs[k, side])
