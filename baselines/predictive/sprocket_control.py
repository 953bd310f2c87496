"""Model predictive control of sprocket speeds on the pseudo-kinematic model.

The model is that of `sprocket_prediction`, linear about the last plan, with beta(u) and alpha(u) of
the slip model that is now believed; the cost is that of `tracking_cost` and the step that of
`box_riccati`, with drives that follow at once: the change of sprocket speeds from stage to stage
takes the place of that of efforts. The reference is that of `path_ahead`; a vehicle on it has the
path's heading less alpha.

References: [F] Focchi et al. (2025), section 3.2.

Prediction of the pseudo-kinematic model for model predictive control of sprocket speeds.

Stages k of h seconds at constant sprocket speeds u_k, in units of their limit, with beta(u) and
alpha(u) of a slip model:
    v = (r omega_L - beta_L + r omega_R - beta_R) / 2
    w = (r omega_R - beta_R - r omega_L + beta_L) / B
    yaw' = yaw + h w,   (x', y') by (v, v tan(alpha)) along the mean heading
The states are those of `tracked_prediction`: pose, v and w of the stage before, and its sprocket
speeds. v, w and tan(alpha) are linear in the sprocket speeds about a plan: `felt` (3, N, V, 3) is
what they are on the plan of each of V vehicles, then their slopes by the left and right input.

References: [F] Focchi et al. (2025), section 3.2.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.measurement import DataSheet
from baselines.lyapunov import lyapunov_laws as law
from baselines.lyapunov.adaptive_slippage_aware import AdaptiveSlipPolicy, OracleSlipPolicy
from baselines.lyapunov.lyapunov_laws import Geometry
from baselines.lyapunov.pose_filter import shows_attitude
from baselines.lyapunov.slippage_aware import NEEDS, LyapunovState, SlippageAwarePolicy
from baselines.predictive import stages
from baselines.predictive.predictive_control import Work, checked_settings, make_work, shift
from baselines.predictive.stages import PredictiveSettings, set_costs
from baselines.predictive.tracked_prediction import (
    GIVEN_LEFT,
    GIVEN_RIGHT,
    HEADING,
    PATH_SPEED,
    PATH_YAW_RATE,
    SPEED,
    STATES,
    YAW,
    YAW_RATE,
    X,
    Y,
    interpolation,
    lay_path,
)
from baselines.predictive.tracked_prediction import NEEDS as PATH_NEEDS
from baselines.slip.slip_models import Array, NoSlip
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.rigid_body import LEVEL


@formula
def motion_at(felt, k, i, left, right):
    """v [m/s], w [rad/s] and tan(alpha) [-] of stage k, a change of (left, right) off the plan."""
    v, w, t = felt[0, k, i, 0], felt[0, k, i, 1], felt[0, k, i, 2]
    return (
        v + left * felt[1, k, i, 0] + right * felt[2, k, i, 0],
        w + left * felt[1, k, i, 1] + right * felt[2, k, i, 1],
        t + left * felt[1, k, i, 2] + right * felt[2, k, i, 2],
    )


@formula
def move(s, motion, left, right, h, after):
    """State after one stage; returns cosine and sine of its mean heading."""
    v, w, t = motion
    cosine, sine = rotation(s[YAW] + 0.5 * h * w)
    after[X] = s[X] + h * v * (cosine - t * sine)
    after[Y] = s[Y] + h * v * (sine + t * cosine)
    after[YAW] = s[YAW] + h * w
    after[SPEED], after[YAW_RATE] = v, w
    after[GIVEN_LEFT], after[GIVEN_RIGHT] = left, right
    return cosine, sine


@formula
def differentiate(s, after, motion, felt, k, i, turn, h, forward):
    """forward of stage k, see tracked_prediction; v and w of the stage before have no effect."""
    v, _w, t = motion
    cosine, sine = turn
    forward[:, :] = 0.0
    way_x, way_y = after[X] - s[X], after[Y] - s[Y]
    forward[0, X], forward[0, Y], forward[0, YAW] = -way_y, way_x, 1.0
    for side in range(2):
        d_v, d_w, d_t = felt[1 + side, k, i, 0], felt[1 + side, k, i, 1], felt[1 + side, k, i, 2]
        column = forward[5 + side]
        column[X] = h * (d_v * (cosine - t * sine) - v * d_t * sine) - 0.5 * h * d_w * way_y
        column[Y] = h * (d_v * (sine + t * cosine) + v * d_t * cosine) + 0.5 * h * d_w * way_x
        column[YAW], column[SPEED], column[YAW_RATE] = h * d_w, d_v, d_w


@formula
def on_the_path(ahead, felt, beta, i, half_gauge, unit):
    """Bring heading, v_x and yaw rate of `ahead` to a vehicle on the path, and fill its inputs.

    beta (stages, V, 2) [m/s]; unit [m/s]: belt speed at the limit.
    """
    path, v, w = ahead.path, ahead.speed, ahead.turn
    count = ahead.efforts.shape[0]
    for k in range(count):
        tangent = felt[0, k, i, 2]
        speed = 0.5 * (v[k] + v[k + 1]) / np.sqrt(1.0 + tangent * tangent)
        turn = 0.5 * (w[k] + w[k + 1])
        path[k + 1, HEADING] -= np.arctan(tangent)
        path[k + 1, PATH_SPEED], path[k + 1, PATH_YAW_RATE] = speed, turn
        left, right = law.belt_speeds(
            law.BodyMotion(speed, turn), beta[k, i, 0], beta[k, i, 1], half_gauge
        )
        ahead.efforts[k, 0] = min(max(left / unit, -1.0), 1.0)
        ahead.efforts[k, 1] = min(max(right / unit, -1.0), 1.0)


PROBE = 0.01  # [-] of the limit: step of the differences of the slip model
SETTINGS = PredictiveSettings(
    position=100.0, heading=4.0, speed=1.0, yaw_rate=0.3, effort=1.0, effort_change=10.0
)


@loop
def plan_all(observation, error, last, start, felt, beta, weights, settings, geometry, work, plans):
    """Improve the plans (V, N, 2) of V vehicles in place by one step.

    error (V, 3): vehicle minus reference, body axes; last (V, 2) [-]: sprocket speeds sent last;
    start (V,): rows whose plan is not one yet; felt (3, N, V, 3): v, w, tan(alpha) on the plan and
    their slopes by both inputs; beta (N, V, 2) [m/s].
    """
    h, a, ahead = settings.duration, work.stages, work.ahead
    states, new_states, new_inputs = work.states, work.new_states, work.new_inputs
    bounds = np.ones(2)
    for i in range(plans.shape[0]):
        place = (-error[i, 0], -error[i, 1], -error[i, 2])
        # The error is the vehicle's in its own axes: the reference stands at minus that.
        lay_path(observation, i, weights, 1.0, place, LEVEL, h, ahead)
        unit = geometry.radius[i] * geometry.limit[i]
        on_the_path(ahead, felt, beta, i, geometry.half_gauge[i], unit)
        states[0, :] = 0.0
        states[0, GIVEN_LEFT], states[0, GIVEN_RIGHT] = last[i, 0], last[i, 1]
        for k in range(plans.shape[1]):
            motion = motion_at(felt, k, i, 0.0, 0.0)
            turn = move(states[k], motion, plans[i, k, 0], plans[i, k, 1], h, states[k + 1])
            differentiate(states[k], states[k + 1], motion, felt, k, i, turn, h, a.forward[k])
        coupling = 0.0 if start[i] else settings.effort_change
        set_costs(a, ahead, states, plans[i], settings, coupling)
        stages.improve(a, plans[i], bounds, 0.0, coupling)
        new_states[0, :] = states[0]
        for k in range(plans.shape[1]):
            for s in range(STATES):
                a.change[s] = new_states[k, s] - states[k, s]
            for side in range(2):
                new_inputs[k, side] = stages.improved(
                    a, k, side, plans[i, k, side], 1.0, a.change, 1.0
                )
            left, right = new_inputs[k, 0], new_inputs[k, 1]
            motion = motion_at(felt, k, i, left - plans[i, k, 0], right - plans[i, k, 1])
            move(new_states[k], motion, left, right, h, new_states[k + 1])
        plans[i, :, :] = new_inputs


@loop
def shift_all(plans, share):
    """`predictive_control.shift` of all rows."""
    for i in range(plans.shape[0]):
        shift(plans[i], share)


class PredictiveSlipState(NamedTuple):
    """State of the policy between two calls."""

    driving: LyapunovState
    plans: Array  # (V, N, 2) [-] sprocket speeds to come, over their limit

    @property
    def attitude(self) -> Array:
        """(V, 2) roll and pitch [rad]: level."""
        return self.driving.attitude


class PredictiveSlipPolicy(SlippageAwarePolicy):
    """The pose filter and slip model of slc with model predictive control in place of its law.

    Arguments as SlippageAwarePolicy, and settings: weights and horizon. Raises ValueError where the
    observation shows an attitude: slopes are not in the model.
    """

    def __init__(
        self,
        *arguments: Any,
        observation: Sequence[str] = layout.NAMES,
        settings: PredictiveSettings | None = None,
        **options: Any,
    ) -> None:
        super().__init__(*arguments, **{**options, "observation": observation})
        if self._attitude is not None:
            raise ValueError(
                "model predictive control of sprocket speeds predicts level ground alone; use "
                "'slc-adaptive' where the observation shows an attitude, or drive='torque'"
            )
        self._view = layout.View(observation, (*NEEDS, *PATH_NEEDS))
        given = SETTINGS if settings is None else settings
        self.settings = checked_settings(given, self.control_period)
        self._stages = int(self.settings.stages)
        h = self.settings.duration
        self._weights = interpolation(h * np.arange(self._stages + 1))
        self._share = self.control_period / h
        self._work: Work = make_work(self._stages)
        self._plans: Array = np.zeros((0, self._stages, 2))
        self._started: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        self._last: Array = np.zeros((0, 2))
        self._seen: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)
        self._spread: tuple[int, Geometry] = (0, self.geometry)

    def act(
        self,
        observation: NDArray[np.float32],
        state: Any,
        start: NDArray[np.bool_],
    ) -> tuple[NDArray[np.float32], Any]:
        """Sprocket speeds over their limit, and the new state."""
        count = len(observation)
        driving: Any = None if state is None else state.driving
        geometry, _thrice = self._rows(count)
        if state is None:
            self._plans = np.zeros((count, self._stages, 2))
            self._last = np.zeros((count, 2))
        else:
            self.same_count(len(state.plans), count)
            self._plans = state.plans.copy()
            self._last = driving.sprockets / geometry.limit[:, np.newaxis]
        self._plans[start] = 0.0
        self._last[start] = 0.0
        self._started = start
        # What is not finite has no meaning for a vehicle that stands: `moving` of slc is False.
        self._seen = np.nan_to_num(observation)
        action, driving = super().act(observation, driving, start)
        return action, PredictiveSlipState(driving, self._plans)

    def _law(self, error: Array, reference: Array, alpha: Array, geometry: Geometry) -> Array:
        """Motion of the first stage (V, 2); the plans are improved by one step."""
        shift_all(self._plans, self._share)
        felt, beta = self._probe(geometry)
        plan_all(
            self._seen, error, self._last, self._started, felt, beta, self._weights, self.settings,
            geometry, self._work, self._plans,
        )  # fmt: skip
        return self._plans[:, 0].copy()

    def _feed_forward(self, motion: Array, beta: Array, geometry: Geometry) -> Array:
        """Sprocket speeds (V, 2) [rad/s]: here `motion` is what the plan begins with."""
        return motion * geometry.limit[:, np.newaxis]

    def _probe(self, geometry: Geometry) -> tuple[Array, Array]:
        """felt and beta of `plan_all`: what the slip model says along the plans."""
        count, stages = len(self._plans), self._stages
        if self._spread[0] != count:
            self._spread = count, Geometry(*(np.tile(value, 3 * stages) for value in geometry))
        along = np.ascontiguousarray(np.swapaxes(self._plans, 0, 1))  # (N, V, 2)
        inputs = np.repeat(along[np.newaxis], 3, axis=0)
        steps = np.where(along > 0.0, -PROBE, PROBE)
        inputs[1, :, :, 0] += steps[:, :, 0]
        inputs[2, :, :, 1] += steps[:, :, 1]
        inputs *= geometry.limit[:, np.newaxis]
        beta, alpha, motion = self._slip(inputs.reshape(-1, 2), self._spread[1])
        felt = np.concatenate([motion, np.tan(alpha)[:, np.newaxis]], axis=1)
        felt = felt.reshape(3, stages, count, 3)
        felt[1:] -= felt[0]
        felt[1] /= steps[:, :, :1]
        felt[2] /= steps[:, :, 1:]
        return felt, beta[: stages * count].reshape(stages, count, 2)


class PredictiveOracleSlipPolicy(PredictiveSlipPolicy, OracleSlipPolicy):
    """The same with the slip of the true soil; arguments as OracleSlipPolicy."""


class PredictiveAdaptiveSlipPolicy(AdaptiveSlipPolicy):
    """The same with the slip of the friction that is identified under way.

    Arguments as AdaptiveSlipPolicy without gains and controller, and settings.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        observation: Sequence[str] = layout.NAMES,
        settings: PredictiveSettings | None = None,
    ) -> None:
        shown = observation if shows_attitude(observation) else layout.NAMES
        controller = PredictiveSlipPolicy(
            parameters, control_period, NoSlip(), None, data_sheet,
            observation=shown, settings=settings,
        )  # fmt: skip
        super().__init__(
            parameters, control_period, data_sheet, None, observation, controller=controller
        )
        self._view = layout.View(observation, (*NEEDS, *PATH_NEEDS))
