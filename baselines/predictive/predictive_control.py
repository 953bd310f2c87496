"""Model predictive control of the torque-driven vehicle: one Gauss-Newton step per control step.

It minimises the cost of `stages` over the model of `tracked_prediction`, with |u| <= min(1,
F_limit / (g c)). Each call begins from the last plan, shifted by one control period, rolls the
model out from the present state, and takes one step; the first command is sent, the rest is the
next plan. A vehicle that drives along the path of the reference with its centre of mass has the
speed sqrt(v^2 - v_y^2) and the heading of the path plus delta, sin(delta) = -v_y / v. Nothing else
is known of the path ahead.

Estimates, filter, late poses and outages are those of the adaptive policy.

References: [1] Diehl, Bock, Schloeder, A real-time iteration scheme for nonlinear optimization in
optimal feedback control, SIAM J. Control Optim. 43 (2005).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from baselines.batch_policy import Array, Bools, Floats, not_finite
from baselines.estimators.actuators import COMMANDS
from baselines.estimators.measurement import DataSheet
from baselines.estimators.stack import Identification
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import MAXIMUM_SIDE_SLIP, inverse_speed, pressed
from baselines.linearizing.linearizing_policy import is_finite, measured_incline, reached_all
from baselines.linearizing.oracle_policy import OraclePolicy
from baselines.predictive import stages
from baselines.predictive import tracked_prediction as model
from baselines.predictive.stages import PredictiveSettings, Task
from baselines.riccati import clipped
from tracked_env import observation as layout
from tracked_env.physics import lumped as vehicle
from tracked_env.physics.elementary import signed
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters, row_parameters
from tracked_env.physics.rigid_body import in_plane_above
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.validation import CONTROL_PERIOD, checked_number

NEEDS = (*stages.PATH_NEEDS, "v_x", "yaw_rate")  # fields of the observation that are read
STEPS_AT_START = 4  # Gauss-Newton steps where there is no plan yet
HALVINGS = 6  # of a step
_V_X, _YAW_RATE = layout.INDEX["v_x"], layout.INDEX["yaw_rate"]
_ERROR_X, _ERROR_Y, _HEADING = (layout.INDEX[name] for name in stages.ERRORS)
_SCALE = layout.SCALE


@loop
def look_ahead(observation, i, weights, incline, m, ahead):
    """Fill `ahead` for vehicle i with the Prediction m, in body axes; incline of its plane.

    observation (N, >= SIZE); weights: of `interpolation`. A vehicle that faces backwards follows
    the same path in reverse.
    """
    heading = observation[i, _HEADING] * _SCALE[_HEADING]
    faces_back = abs(heading) > 0.5 * math.pi
    if faces_back:
        heading -= signed(math.pi, heading)
    error_x, error_y = observation[i, _ERROR_X], observation[i, _ERROR_Y]
    x, y = in_plane_above(error_x * _SCALE[_ERROR_X], error_y * _SCALE[_ERROR_Y], incline)
    facing = -1.0 if faces_back else 1.0
    stages.lay_path(observation, i, weights, facing, (x, y, heading), incline, m.duration, ahead)
    v, w, path, lateral = ahead.speed, ahead.turn, ahead.path, 0.0
    for k in range(path.shape[0]):
        forward, before = v[k], lateral
        for _ in range(2):
            lateral = model.side_velocity(forward, w[k], m)
            forward = signed(math.sqrt(v[k] * v[k] - lateral * lateral), v[k])
        slip = clipped(-lateral * inverse_speed(v[k]), -MAXIMUM_SIDE_SLIP, MAXIMUM_SIDE_SLIP)
        path[k, stages.HEADING] += math.asin(slip)
        path[k, stages.PATH_SPEED] = forward
        if k > 0:
            left, right = model.needed_efforts(
                path[k - 1, stages.PATH_SPEED], w[k - 1], forward, w[k], before, m
            )
            ahead.efforts[k - 1, 0] = left / m.force_left
            ahead.efforts[k - 1, 1] = right / m.force_right


@loop
def roll_out(m, w, inputs):
    """w.states of inputs (N, 2) from the first one on, and their derivatives."""
    for k in range(inputs.shape[0]):
        sides = model.drive(w.states[k], inputs[k], m, w.states[k + 1])
        model.differentiate(w.states[k], w.states[k + 1], sides, m, w.stages.forward[k])


@loop
def try_step(m, w, inputs, bounds, share):
    """w.new_inputs after a share of the offsets and all of the feedback, with w.new_states."""
    w.new_states[0, :] = w.states[0]
    for k in range(inputs.shape[0]):
        stages.improved(w, k, inputs[k], share, bounds)
        model.drive(w.new_states[k], w.new_inputs[k], m, w.new_states[k + 1])


@loop
def gauss_newton(m, settings, w, inputs, bounds):
    """Roll out from w.states[0], then improve inputs (N, 2) in place; the largest change [-].

    m: Prediction; bounds (2,) of the inputs. The step is halved until the cost falls; where it does
    not, the inputs stay.
    """
    coupling = settings.effort_change * (1.0 - m.decay) * (1.0 - m.decay)
    roll_out(m, w, inputs)
    stages.set_costs(w, inputs, settings, coupling)
    stages.improve(w, inputs, bounds, m.decay, coupling)
    before, share = stages.total_cost(w, w.states, inputs, settings, coupling), 1.0
    for _ in range(HALVINGS):
        try_step(m, w, inputs, bounds, share)
        after = stages.total_cost(w, w.new_states, w.new_inputs, settings, coupling)
        if after < before:
            largest = 0.0
            for k in range(inputs.shape[0]):
                for side in range(2):
                    largest = max(largest, abs(w.new_inputs[k, side] - inputs[k, side]))
                    inputs[k, side] = w.new_inputs[k, side]
            return largest
        share *= 0.5
    return 0.0


@formula
def start_state(observation, i, drives, states):
    """The present into states[0]: the origin, measured velocities, efforts of the drives."""
    s = states[0]
    s[model.X] = s[model.Y] = s[model.YAW] = 0.0
    s[model.SPEED] = observation[i, _V_X] * _SCALE[_V_X]
    s[model.YAW_RATE] = observation[i, _YAW_RATE] * _SCALE[_YAW_RATE]
    s[model.EFFORT_LEFT], s[model.EFFORT_RIGHT] = drives[i, 0], drives[i, 1]


@loop
def plan_all(observation, parameters, start, drives, task, work, plans, action):
    """Improve the plans (V, N, 2) of V vehicles in place; action (V, 2) out.

    observation (V, >= SIZE), ATTITUDE behind v0 where sloped; parameters (rows, V or 1); start
    (V,): rows without a plan; drives (V, 2) [-]: efforts. Returns the first row that is not finite,
    or -1.
    """
    shared, settings = parameters.shape[1] == 1, task.settings
    bounds = np.empty(2)
    for i in range(observation.shape[0]):
        if not is_finite(observation, i):
            return i
        p = row_parameters(parameters.T, 0 if shared else i, 0)
        incline = measured_incline(observation, i, task.sloped)
        k = pressed(vehicle.coefficients(p, False), incline.press)
        pull = GRAVITY * incline.down_x, GRAVITY * incline.down_y
        m = model.prediction(p, k, settings.duration, settings.smoothing, pull[0], pull[1])
        look_ahead(observation, i, task.weights, incline, m, work.ahead)
        start_state(observation, i, drives, work.states)
        carried = settings.traction * vehicle.drive_limits(p).effort_limit
        bounds[0] = 1.0 if task.sloped else min(1.0, carried / m.force_left)
        bounds[1] = 1.0 if task.sloped else min(1.0, carried / m.force_right)
        inputs, steps = plans[i], 1
        if start[i]:
            inputs[:, :] = work.ahead.efforts
            steps = STEPS_AT_START
        else:
            stages.shift(inputs, task.share)
        for stage in range(inputs.shape[0]):
            for side in range(2):
                inputs[stage, side] = clipped(inputs[stage, side], -bounds[side], bounds[side])
        for _ in range(steps):
            gauss_newton(m, settings, work, inputs, bounds)
        action[i, 0], action[i, 1] = inputs[0, 0], inputs[0, 1]
    return -1


class PredictiveController:
    """Model predictive controller of V vehicles, whose model is `parameters` (rows, V or 1).

    parameters: nominal ones. control_period [s]: between two calls. settings: weights and horizon.
    sloped: whether ATTITUDE stands behind the fields of v0.
    Raises ValueError for settings that make no sense.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float = 0.02,
        settings: PredictiveSettings | None = None,
        sloped: bool = False,
    ) -> None:
        self.control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        self.lateral = "sliding"
        self.parameters = np.array(parameters, dtype=np.float64)[:, np.newaxis]
        self._task = Task.of(settings or PredictiveSettings(), self.control_period, sloped)
        self.settings = self._task.settings
        self.stages = int(self.settings.stages)
        self._work = stages.make_work(self.stages)

    def act(
        self, observation: Floats, plans: Array | None, start: Bools, drives: Array
    ) -> tuple[Floats, Array]:
        """Sprocket torques over their limit (V, 2), and the new plans (V, N, 2) [-].

        drives (V, 2) [-], in and out: what the drives give, in units of their commands. Rows that
        start have no plan. Raises ValueError for an observation that is not finite.
        """
        count = len(observation)
        plans = np.zeros((count, self.stages, 2)) if plans is None else plans.copy()
        reached_all(observation, start, self.parameters, self.control_period, drives)
        action = np.empty((count, 2), dtype=np.float32)
        bad = plan_all(
            observation, self.parameters, start, drives, self._task, self._work, plans, action
        )
        if bad >= 0:
            raise not_finite(observation, bad)
        return action, plans


class PredictivePolicy(AdaptivePolicy):
    """Predictive controller and estimators as one policy, for one vehicle or a batch.

    Arguments as AdaptivePolicy without gains, and settings: weights and horizon. lateral: must be
    "sliding". The observation must show the look-ahead and the commands.
    """

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        lateral: str = "sliding",
        observation: Sequence[str] = layout.NAMES,
        settings: PredictiveSettings | None = None,
    ) -> None:
        if lateral != "sliding":
            raise ValueError(
                f"lateral = {lateral!r}; model predictive control predicts 'sliding' alone. Use "
                "'adaptive' or 'nominal', or an environment with lateral_model='sliding'"
            )
        self._settings = settings
        super().__init__(parameters, control_period, data_sheet, observation=observation)
        needed = (*NEEDS, *COMMANDS, *self.stack.needs)
        self._view = layout.View(observation, tuple(dict.fromkeys(needed)))

    def _make_controller(
        self, control_period: float, settings: Any, lateral: str, sloped: bool
    ) -> Any:
        return PredictiveController(self.parameters, control_period, self._settings, sloped)

    def _drive(
        self, observation: Floats, start: Bools, memory: Any, given: Array
    ) -> tuple[Floats, Any]:
        return self.controller.act(observation, memory, start, given)


class NominalPredictivePolicy(PredictivePolicy):
    """The same with the nominal parameters; arguments as PredictivePolicy."""

    def _adapt(self, known: Identification) -> None:
        """The parameters stay what they are."""


class PredictiveOraclePolicy(OraclePolicy):
    """The same with the truth at every step, of parameters, motion or both; arguments as
    PredictivePolicy, and `told` as OraclePolicy."""

    identifying = PredictivePolicy
