"""Model predictive control of the torque-driven vehicle: one Gauss-Newton step per control step.

It minimises the cost of `tracking_cost` over the model of `tracked_prediction`, with the reference
of `path_ahead` and |u| <= min(1, F_limit / (g c)). Each call begins from the last plan,
shifted by one control period, rolls the model out from the present state, and takes one step of
`box_riccati`; the first command is given, the rest is the next plan.

References: [1] Diehl, Bock, Schloeder, A real-time iteration scheme for nonlinear optimization in
optimal feedback control, SIAM J. Control Optim. 43 (2005).

Model predictive control as a policy: the identification stack in front of the controller.

    PredictivePolicy         its model has the parameters that are identified under way
    NominalPredictivePolicy  its model has the nominal parameters; motion is filtered all the same
    PredictiveOraclePolicy   its model has the true parameters
Estimates, filter, late poses and outages are those of the adaptive policy; the controller alone
differs.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.batch_policy import not_finite
from baselines.estimators.actuators import COMMANDS
from baselines.estimators.measurement import DataSheet
from baselines.estimators.stack import Identification
from baselines.linearizing.adaptive_policy import AdaptivePolicy, OraclePolicy
from baselines.linearizing.linearizing_law import pressed
from baselines.linearizing.linearizing_policy import reached_all
from baselines.predictive import stages
from baselines.predictive.stages import PredictiveSettings, set_costs, total_cost
from baselines.predictive.tracked_prediction import (
    GIVEN_LEFT,
    GIVEN_RIGHT,
    SPEED,
    STATES,
    YAW,
    YAW_RATE,
    Ahead,
    X,
    Y,
    differentiate,
    drive,
    interpolation,
    look_ahead,
    make_ahead,
    prediction,
)
from baselines.predictive.tracked_prediction import NEEDS as PATH_NEEDS
from tracked_env import observation as layout
from tracked_env.physics import lumped
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters, row_parameters
from tracked_env.physics.rigid_body import LEVEL, incline_of
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.validation import CONTROL_PERIOD, checked_number

Array = NDArray[np.float64]

NEEDS = (*PATH_NEEDS, "v_x", "yaw_rate")  # fields of the observation that the controller reads
STEPS_AT_START = 4  # Gauss-Newton steps where there is no plan yet
HALVINGS = 6  # of a step
LONGEST_HORIZON = 2.0  # [s] that the observation shows
_V_X, _YAW_RATE = layout.INDEX["v_x"], layout.INDEX["yaw_rate"]
_V_X_SCALE, _YAW_RATE_SCALE = layout.SCALE[_V_X], layout.SCALE[_YAW_RATE]
_ROLL, _PITCH = layout.SIZE, layout.SIZE + 1
_ROLL_SCALE, _PITCH_SCALE = layout.make_layout(["attitude"]).scale[:2]


class Work(NamedTuple):
    """What the kernel writes to, for one vehicle after the other."""

    stages: stages.Stages
    ahead: Ahead
    states: Array  # (N + 1, STATES) of the last plan
    new_states: Array  # (N + 1, STATES) of the one that is tried
    new_inputs: Array  # (N, 2)


def make_work(count: int) -> Work:
    """Work space for `count` stages."""
    return Work(
        stages.make_stages(count), make_ahead(count), np.zeros((count + 1, STATES)),
        np.zeros((count + 1, STATES)), np.zeros((count, 2)),
    )  # fmt: skip


@loop
def roll_out(m, a, states, inputs):
    """States (N + 1, STATES) of inputs (N, 2) from states[0] on, and their derivatives."""
    for k in range(inputs.shape[0]):
        sides = drive(states[k], inputs[k], m, states[k + 1])
        differentiate(states[k], states[k + 1], sides, m, a.forward[k])


@loop
def try_step(m, a, states, inputs, bounds, share, new_states, new_inputs):
    """Inputs (N, 2) after a share of the offsets and all of the feedback, with their states."""
    new_states[0, :] = states[0]
    for k in range(inputs.shape[0]):
        for s in range(STATES):
            a.change[s] = new_states[k, s] - states[k, s]
        for side in range(2):
            new_inputs[k, side] = stages.improved(
                a, k, side, inputs[k, side], share, a.change, bounds[side]
            )
        drive(new_states[k], new_inputs[k], m, new_states[k + 1])


@loop
def gauss_newton(m, ahead, settings, work, inputs, bounds):
    """Roll out from work.states[0], then improve inputs (N, 2) in place; the largest change [-].

    m: Prediction; bounds (2,) of the inputs. The step is halved until the cost falls; where it does
    not, the inputs stay.
    """
    a, states = work.stages, work.states
    coupling = settings.effort_change * (1.0 - m.decay) * (1.0 - m.decay)
    roll_out(m, a, states, inputs)
    set_costs(a, ahead, states, inputs, settings, coupling)
    stages.improve(a, inputs, bounds, m.decay, coupling)
    before, share = total_cost(ahead, states, inputs, settings, coupling), 1.0
    for _ in range(HALVINGS):
        try_step(m, a, states, inputs, bounds, share, work.new_states, work.new_inputs)
        after = total_cost(ahead, work.new_states, work.new_inputs, settings, coupling)
        if after < before:
            largest = 0.0
            for k in range(inputs.shape[0]):
                for side in range(2):
                    largest = max(largest, abs(work.new_inputs[k, side] - inputs[k, side]))
                    inputs[k, side] = work.new_inputs[k, side]
            return largest
        share *= 0.5
    return 0.0


@formula
def shift(inputs, share):
    """Plan (N, 2) after a share of a stage: means over the new stages; the last command is kept."""
    for k in range(inputs.shape[0] - 1):
        for side in range(2):
            inputs[k, side] += share * (inputs[k + 1, side] - inputs[k, side])


@formula
def start_state(observation, i, given, states):
    """The present into states[0]: the origin, measured velocities, efforts of the drives."""
    s = states[0]
    s[X] = s[Y] = s[YAW] = 0.0
    s[SPEED] = observation[i, _V_X] * _V_X_SCALE
    s[YAW_RATE] = observation[i, _YAW_RATE] * _YAW_RATE_SCALE
    s[GIVEN_LEFT], s[GIVEN_RIGHT] = given[i, 0], given[i, 1]


@loop
def plan_all(
    observation, parameters, start, given, weights, settings, share, sloped, work, plans, action
):
    """Improve the plans (V, N, 2) of V vehicles in place; action (V, 2) out.

    observation (V, >= SIZE), ATTITUDE behind v0 where sloped; parameters (rows, V or 1); start
    (V,): rows without a plan; given (V, 2) [-]; weights: of path_ahead.interpolation; share [-] of
    a stage that a control step takes. Returns the first row that is not finite, or -1.
    """
    shared = parameters.shape[1] == 1
    ahead, states = work.ahead, work.states
    bounds = np.empty(2)
    for i in range(observation.shape[0]):
        check = 0.0
        for column in range(observation.shape[1]):
            check += observation[i, column] * 0.0
        if check != 0.0:
            return i
        p = row_parameters(parameters.T, 0 if shared else i, 0)
        incline = LEVEL
        if sloped:
            incline = incline_of(
                observation[i, _PITCH] * _PITCH_SCALE, observation[i, _ROLL] * _ROLL_SCALE
            )
        k = pressed(lumped.coefficients(p, False), incline.press)
        m = prediction(
            p, k, settings.duration, settings.smoothing, GRAVITY * incline.down_x,
            GRAVITY * incline.down_y,
        )  # fmt: skip
        look_ahead(observation, i, weights, incline, m, ahead)
        start_state(observation, i, given, states)
        carried = settings.traction * lumped.drive_limits(p).effort_limit
        bounds[0] = 1.0 if sloped else min(1.0, carried / m.force_left)
        bounds[1] = 1.0 if sloped else min(1.0, carried / m.force_right)
        inputs, steps = plans[i], 1
        if start[i]:
            inputs[:, :] = ahead.efforts
            steps = STEPS_AT_START
        else:
            shift(inputs, share)
        for k_stage in range(inputs.shape[0]):
            for side in range(2):
                inputs[k_stage, side] = min(max(inputs[k_stage, side], -bounds[side]), bounds[side])
        for _ in range(steps):
            gauss_newton(m, ahead, settings, work, inputs, bounds)
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
        given = PredictiveSettings() if settings is None else settings
        self.settings = checked_settings(given, self.control_period)
        self.sloped, self.lateral = sloped, "sliding"
        self.parameters = np.array(parameters, dtype=np.float64)[:, np.newaxis]
        self.stages = int(self.settings.stages)
        h = self.settings.duration
        self._weights = interpolation(h * np.arange(self.stages + 1))
        self._share = self.control_period / h
        self._work = make_work(self.stages)

    def act(
        self,
        observation: NDArray[np.float32],
        plans: Array | None,
        start: NDArray[np.bool_],
        given: Array,
    ) -> tuple[NDArray[np.float32], Array]:
        """Sprocket torques over their limit (V, 2), and the new plans (V, N, 2) [-].

        given (V, 2) [-], in and out: what the drives give, in units of their commands. Rows that
        start have no plan. Raises ValueError for an observation that is not finite.
        """
        count = len(observation)
        plans = np.zeros((count, self.stages, 2)) if plans is None else plans.copy()
        reached_all(observation, start, self.parameters, self.control_period, given)
        action = np.empty((count, 2), dtype=np.float32)
        bad = plan_all(
            observation, self.parameters, start, given, self._weights, self.settings, self._share,
            self.sloped, self._work, plans, action,
        )  # fmt: skip
        if bad >= 0:
            raise not_finite(observation, bad)
        return action, plans


def checked_settings(settings: PredictiveSettings, control_period: float) -> PredictiveSettings:
    """Settings as floats, with stages at least as long as a control period.

    Raises ValueError for a weight that is not positive and finite, or a horizon that the
    observation does not show.
    """
    given = PredictiveSettings(*(float(value) for value in settings))
    given = given._replace(duration=max(given.duration, control_period))
    for name, value in given._asdict().items():
        if not 0.0 < value < math.inf:
            raise ValueError(f"{name} = {value:g}; must be positive and finite")
    horizon = round(given.stages) * given.duration
    if given.stages != round(given.stages) or horizon > LONGEST_HORIZON + 1e-9:
        raise ValueError(
            f"stages = {given.stages:g} of {given.duration:g} s; must be a whole number, at most "
            f"{LONGEST_HORIZON:g} s together: the observation shows no more of the reference"
        )
    return given


class PredictivePolicy(AdaptivePolicy):
    """Predictive controller and estimators as one policy, for one vehicle or a batch.

    parameters: nominal ones. control_period [s]: between two calls. data_sheet: noise of the
    sensors (default `rtk`). lateral: must be "sliding". observation: names of the fields that the
    environment shows; the look-ahead and the commands must be among them. settings: weights and
    horizon.
    Raises ValueError for arguments that make no sense, and for an observation that lacks a field.
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
        self, observation: NDArray[np.float32], start: NDArray[np.bool_], memory: Any,
        given: NDArray[np.float64],
    ) -> tuple[NDArray[np.float32], Any]:  # fmt: skip
        action, plans = self.controller.act(observation, memory, start, given)
        return action, plans


class NominalPredictivePolicy(PredictivePolicy):
    """The same with the nominal parameters; arguments as PredictivePolicy."""

    def _adapt(self, known: Identification) -> None:
        """The parameters stay what they are."""


class PredictiveOraclePolicy(OraclePolicy):
    """The same with the true parameters at every step; arguments as PredictivePolicy."""

    identifying = PredictivePolicy
