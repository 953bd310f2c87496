"""Model predictive control of sprocket speeds on the pseudo-kinematic model.

Stages k of h seconds at constant sprocket speeds u_k, in units of their limit, with beta(u) and
alpha(u) of the slip model that is now believed:
    v = (r omega_L - beta_L + r omega_R - beta_R) / 2
    w = (r omega_R - beta_R - r omega_L + beta_L) / B
    yaw' = yaw + h w,   (x', y') by (v, v tan(alpha)) along the mean heading
The states are those of `tracked_prediction`: pose, sprocket speeds, v and w of the stage before.
v, w and tan(alpha) are linear in the sprocket speeds about a plan: `slip` (3, N, V, 3) is what they
are on the plan of each of V vehicles, then their slopes by the left and right input. Reference,
cost and step are those of `stages`, with drives that follow at once: the change of sprocket speeds
from stage to stage takes the place of that of efforts. A vehicle on the reference has the path's
heading less alpha.

References: [F] Focchi et al. (2025), section 3.2.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from baselines.batch_policy import Bools, Floats, shows_attitude
from baselines.lyapunov import lyapunov_laws as law
from baselines.lyapunov.slippage_aware import (
    NEEDS,
    AdaptiveSlipPolicy,
    LyapunovState,
    OracleSlipPolicy,
    SlippageAwarePolicy,
)
from baselines.predictive import stages
from baselines.predictive import tracked_prediction as model
from baselines.riccati import clipped
from baselines.slip.slip_models import Array
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import VEHICLES, PlantParameters, top_speed
from tracked_env.physics.rigid_body import LEVEL

PROBE = 0.01  # [-] of the limit: step of the differences of the slip model
SETTINGS = stages.PredictiveSettings(
    position=100.0, heading=4.0, speed=1.0, yaw_rate=0.3, effort=1.0, effort_change=10.0,
    terminal=5.0, traction=0.98, smoothing=1.0,
)  # fmt: skip
TUNED_FOR = VEHICLES["focchi"]  # the vehicle of SETTINGS


def settings_for(p: PlantParameters) -> stages.PredictiveSettings:
    """SETTINGS of a vehicle of another top speed: commands are in units of it, errors are not."""
    ratio = (top_speed(p) / top_speed(TUNED_FOR)) ** 2
    s = SETTINGS
    return s._replace(effort=s.effort * ratio, effort_change=s.effort_change * ratio)


@formula
def motion_at(slip, k, i, left, right):
    """v [m/s], w [rad/s] and tan(alpha) [-] of stage k, a change of (left, right) off the plan."""
    v, w, t = slip[0, k, i, 0], slip[0, k, i, 1], slip[0, k, i, 2]
    return (
        v + left * slip[1, k, i, 0] + right * slip[2, k, i, 0],
        w + left * slip[1, k, i, 1] + right * slip[2, k, i, 1],
        t + left * slip[1, k, i, 2] + right * slip[2, k, i, 2],
    )


@formula
def move(s, motion, inputs, h, after):
    """State after one stage with inputs (2,)."""
    v, w, t = motion
    cosine, sine = rotation(s[model.YAW] + 0.5 * h * w)
    after[model.X] = s[model.X] + h * v * (cosine - t * sine)
    after[model.Y] = s[model.Y] + h * v * (sine + t * cosine)
    after[model.YAW] = s[model.YAW] + h * w
    after[model.SPEED], after[model.YAW_RATE] = v, w
    after[model.EFFORT_LEFT], after[model.EFFORT_RIGHT] = inputs[0], inputs[1]


@formula
def differentiate(s, after, slip, k, i, h, forward):
    """forward of stage k, see tracked_prediction; v and w of the stage before have no effect."""
    v, w, t = motion_at(slip, k, i, 0.0, 0.0)
    cosine, sine = rotation(s[model.YAW] + 0.5 * h * w)
    forward[:, :] = 0.0
    way_x, way_y = after[model.X] - s[model.X], after[model.Y] - s[model.Y]
    by_yaw = forward[model.BY_YAW]
    by_yaw[model.D_X], by_yaw[model.D_Y], by_yaw[model.D_YAW] = -way_y, way_x, 1.0
    for side in range(2):
        d_v, d_w, d_t = slip[1 + side, k, i, 0], slip[1 + side, k, i, 1], slip[1 + side, k, i, 2]
        column = forward[model.BY_INPUT + side]
        turn = 0.5 * h * d_w
        column[model.D_X] = h * (d_v * (cosine - t * sine) - v * d_t * sine) - turn * way_y
        column[model.D_Y] = h * (d_v * (sine + t * cosine) + v * d_t * cosine) + turn * way_x
        column[model.D_YAW], column[model.D_SPEED], column[model.D_YAW_RATE] = h * d_w, d_v, d_w


@formula
def on_the_path(ahead, slip, beta, i, half_gauge, unit):
    """Bring heading, v_x and yaw rate of `ahead` to a vehicle on the path, and fill its inputs.

    beta (stages, V, 2) [m/s]; unit [m/s]: belt speed at the limit.
    """
    path, v, w = ahead.path, ahead.speed, ahead.turn
    for k in range(ahead.efforts.shape[0]):
        tangent = slip[0, k, i, 2]
        speed = 0.5 * (v[k] + v[k + 1]) / np.sqrt(1.0 + tangent * tangent)
        turn = 0.5 * (w[k] + w[k + 1])
        path[k + 1, stages.HEADING] -= np.arctan(tangent)
        path[k + 1, stages.PATH_SPEED], path[k + 1, stages.PATH_YAW_RATE] = speed, turn
        motion = law.BodyMotion(speed, turn)
        left, right = law.belt_speeds(motion, beta[k, i, 0], beta[k, i, 1], half_gauge)
        ahead.efforts[k, 0] = clipped(left / unit, -1.0, 1.0)
        ahead.efforts[k, 1] = clipped(right / unit, -1.0, 1.0)


class Present(NamedTuple):
    """What V vehicles do now, and the slip along their plans."""

    error: Array  # (V, 3) vehicle minus reference, body axes
    sprockets: Array  # (V, 2) [-] sent last
    start: Bools  # (V,) rows whose plan is not one yet
    slip: Array  # (3, N, V, 3) v, w, tan(alpha) on the plan and their slopes by both inputs
    beta: Array  # (N, V, 2) [m/s]


@loop
def plan_all(observation, now, task, geometry, w, plans):
    """Improve the plans (V, N, 2) of V vehicles in place by one step; now: Present."""
    settings, states, slip = task.settings, w.states, now.slip
    h, bounds = settings.duration, np.ones(2)
    for i in range(plans.shape[0]):
        inputs = plans[i]
        place = (-now.error[i, 0], -now.error[i, 1], -now.error[i, 2])
        # The error is the vehicle's in its own axes: the reference stands at minus that.
        stages.lay_path(observation, i, task.weights, 1.0, place, LEVEL, h, w.ahead)
        at = i % geometry.radius.shape[0]
        unit = geometry.radius[at] * geometry.limit[at]
        on_the_path(w.ahead, slip, now.beta, i, geometry.half_gauge[at], unit)
        states[0, :] = 0.0
        states[0, model.EFFORT_LEFT] = now.sprockets[i, 0]
        states[0, model.EFFORT_RIGHT] = now.sprockets[i, 1]
        for k in range(inputs.shape[0]):
            move(states[k], motion_at(slip, k, i, 0.0, 0.0), inputs[k], h, states[k + 1])
            differentiate(states[k], states[k + 1], slip, k, i, h, w.stages.forward[k])
        coupling = 0.0 if now.start[i] else settings.effort_change
        stages.set_costs(w, inputs, settings, coupling)
        stages.improve(w, inputs, bounds, 0.0, coupling)
        w.new_states[0, :] = states[0]
        for k in range(inputs.shape[0]):
            new = w.new_inputs[k]
            stages.improved(w, k, inputs[k], 1.0, bounds)
            motion = motion_at(slip, k, i, new[0] - inputs[k, 0], new[1] - inputs[k, 1])
            move(w.new_states[k], motion, new, h, w.new_states[k + 1])
        inputs[:, :] = w.new_inputs


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
        settings: stages.PredictiveSettings | None = None,
        **options: Any,
    ) -> None:
        if shows_attitude(observation):  # before slip models of slopes, which take seconds
            raise ValueError(
                "model predictive control of sprocket speeds predicts level ground alone; use "
                "'slc-adaptive' where the observation shows an attitude, or drive='torque'"
            )
        super().__init__(*arguments, **{**options, "observation": observation})
        self._view = layout.View(observation, (*NEEDS, *stages.PATH_NEEDS))
        self._task = stages.Task.of(settings or SETTINGS, self.control_period, False)
        self._stages = int(self._task.settings.stages)
        self._work: stages.Work = stages.make_work(self._stages)
        # Of the present call of `act`: plans, demands sent last, rows that start, observation.
        self._plans: Array
        self._last: Array
        self._started: Bools
        self._seen: Floats

    def act(self, observation: Floats, state: Any, start: Bools) -> tuple[Floats, Any]:
        """Sprocket speeds over their limit, and the new state."""
        count = len(observation)
        driving: Any = None if state is None else state.driving
        if state is None:
            self._plans = np.zeros((count, self._stages, 2))
            self._last = np.zeros((count, 2))
        else:
            self.same_count(len(state.plans), count)
            self._plans = state.plans.copy()
            self._last = driving.sprockets / self.geometry.limit[:, np.newaxis]
        self._plans[start] = 0.0
        self._last[start] = 0.0
        self._started = start
        # What is not finite has no meaning for a vehicle that stands: `moving` of slc is False.
        self._seen = np.nan_to_num(observation)
        action, driving = super().act(observation, driving, start)
        return action, PredictiveSlipState(driving, self._plans)

    def _law(self, error: Array, reference: Array, alpha: Array) -> Array:
        """Motion of the first stage (V, 2); the plans are improved by one step."""
        now = Present(error, self._last, self._started, *self._probe())
        plan_all(self._seen, now, self._task, self.geometry, self._work, self._plans)
        return self._plans[:, 0].copy()

    def _feed_forward(self, motion: Array, beta: Array) -> Array:
        """Sprocket speeds (V, 2) [rad/s]: here `motion` is what the plan begins with."""
        return motion * self.geometry.limit[:, np.newaxis]

    def _probe(self) -> tuple[Array, Array]:
        """Slip and beta along the plans, shifted by a control step; see Present."""
        self._plans[:, :-1] += self._task.share * np.diff(self._plans, axis=1)  # as stages.shift
        count, stages = len(self._plans), self._stages
        along = np.ascontiguousarray(np.swapaxes(self._plans, 0, 1))  # (N, V, 2)
        inputs = np.repeat(along[np.newaxis], 3, axis=0)
        steps = np.where(along > 0.0, -PROBE, PROBE)
        inputs[1, :, :, 0] += steps[:, :, 0]
        inputs[2, :, :, 1] += steps[:, :, 1]
        inputs *= self.geometry.limit[:, np.newaxis]
        beta, alpha, motion = self._slip(inputs.reshape(-1, 2))
        slip = np.concatenate([motion, np.tan(alpha)[:, np.newaxis]], axis=1)
        slip = slip.reshape(3, stages, count, 3)
        slip[1:] -= slip[0]
        slip[1] /= steps[:, :, :1]
        slip[2] /= steps[:, :, 1:]
        return slip, beta[: stages * count].reshape(stages, count, 2)


class PredictiveOracleSlipPolicy(PredictiveSlipPolicy, OracleSlipPolicy):
    """The same with the slip of the true soil; arguments as OracleSlipPolicy."""


class PredictiveAdaptiveSlipPolicy(AdaptiveSlipPolicy, PredictiveSlipPolicy):
    """The same with the slip of the friction that is identified under way.

    Arguments as AdaptiveSlipPolicy, and settings.
    """
