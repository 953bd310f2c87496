"""A recurrent policy of sprocket speeds, which learned slip where others have a model of it.

    u = clip(u_uc + a y_1..2),   v' = v_belts + c y_3..5,   h', y of a gated network for x
u_uc is the action of the unicycle controller, which knows no slip, for the pose error that
`pose_filter` carries on from sample to sample with the motion v' (v_x, v_y and yaw rate, in the
plane of the vehicle): belts and gyro, and what the network says that slip adds in the step that
comes. The features x are sensors, reference, attitude, that error and by how much a sample has
moved it. The heights around the vehicle (`height_scan`) may be among them.
"""

from typing import Any, NamedTuple

import numpy as np

from baselines.batch_policy import Array, Bools, Context, Floats
from baselines.estimators.measurement import DataSheet
from baselines.learned.agent_policy import Arrays
from baselines.learned.gated_network import Layers, RecurrentNetwork, layers_of
from baselines.lyapunov import lyapunov_laws as law
from baselines.lyapunov import pose_filter
from baselines.lyapunov.slippage_aware import LyapunovState, UnicyclePolicy, tuned_gains
from tracked_env import observation as layout
from tracked_env.physics.elementary import wrap_angle

# What the network adds to belts and gyro, and what an output of 1 is [m/s, m/s, rad/s].
MOTION = {"v_x": 0.02, "v_y": 0.02, "yaw_rate": 0.01}
UNITS = np.array([*MOTION.values()])
ACTION = 0.025  # [-] of the speed limit, what an output of 1 adds to an action
UC_SHOWN = 3.0  # [-] what an action of the unicycle controller of 1 is shown as
OUTPUTS = 2 + len(MOTION)
BOUND = 8.0  # [-] features are clipped to
ATTITUDE = tuple(field.name for field in layout.GROUPS["attitude"].fields)
HEIGHTS = tuple(field.name for field in layout.GROUPS["height_scan"].fields)
_REFERENCE = ("speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration")
_AHEAD = tuple(name for name in layout.NAMES if "_ahead_" in name)
# Fields that are shown as they are, and what is shown as 1 [SI].
_PLAIN = {
    **dict.fromkeys(("v_x", "v_y"), 0.2), "yaw_rate": 0.2,
    **dict.fromkeys(("acceleration_x", "acceleration_y", "yaw_acceleration"), 1.0),
    **dict.fromkeys(("sprocket_speed_left", "sprocket_speed_right"), 3.0),
    **dict.fromkeys(("torque_left", "torque_right"), 10.0),
    **{f"reference_{name}": 0.3 for name in _REFERENCE},
    **dict.fromkeys(_AHEAD, 0.3),
    **dict.fromkeys(("previous_action_left", "previous_action_right"), 0.3),
}  # fmt: skip
_ATTITUDE_SCALE = np.array([0.1, 0.1, 0.2, 0.2, 1.0])
_UPRIGHT = np.array([0.0, 0.0, 0.0, 0.0, 9.81])  # what is shown as 0
_LOGARITHMIC = {  # of either sign: sgn(x) ln(1 + |x|), and what x is over [SI]
    "error_x": 0.01, "error_y": 0.01, "error_yaw": 0.02,
    "large_error_x": 0.2, "large_error_y": 0.2, "large_error_yaw": 0.4,
    "moved_x": 0.1, "moved_y": 0.1, "moved_yaw": 0.1,
    "slip_v_x": 0.02, "slip_v_y": 0.02, "slip_yaw_rate": 0.05, "pose_age": 0.2,
}  # fmt: skip
FEATURES = (
    *_PLAIN, *ATTITUDE, *_LOGARITHMIC, *(f"added_{name}" for name in MOTION),
    "uc_left", "uc_right", "pose_is_new", "velocity_is_measured",
)  # fmt: skip
_SHOWN = [layout.INDEX[name] for name in _PLAIN]
_PLAIN_SCALE = layout.SCALE[_SHOWN] / np.array([*_PLAIN.values()])
_LOG_SCALE = 1.0 / np.array([*_LOGARITHMIC.values()])
_GYRO, _AGE = layout.INDEX["yaw_rate"], layout.INDEX["pose_age"]
_VELOCITY = [layout.INDEX["v_x"], layout.INDEX["v_y"]]
_SLOPE = layout.make_layout(["attitude"]).scale


def inputs_of(heights: bool) -> int:
    """How many numbers the network sees."""
    return len(FEATURES) + (len(HEIGHTS) if heights else 0)


def slip_layers(weights: Arrays, recurrent: bool, heights: bool) -> Layers:
    """The network of a policy from its weights. Raises ValueError."""
    return layers_of(weights, inputs_of(heights), OUTPUTS, recurrent)


def motion_between(before: Array, after: Array, reference: Array, period: float) -> Array:
    """v_x, v_y [m/s] and yaw rate [rad/s] (N, 3) that carry pose errors (N, 3) `before` on to
    `after` within a period [s], past a reference (N, >= 2) v_d, w_d: `carried` solved for them."""
    speed, turn = reference[:, 0], reference[:, 1]
    turned = wrap_angle(after[:, 2] - before[:, 2])
    w = turned / period + turn
    half, middle = 0.5 * period * w, before[:, 2] + 0.5 * turned
    c, s = np.cos(half), np.sin(half)
    ahead = c * after[:, 0] - s * after[:, 1] - (c * before[:, 0] + s * before[:, 1])
    left = s * after[:, 0] + c * after[:, 1] - (c * before[:, 1] - s * before[:, 0])
    v_x = ahead / period + speed * np.cos(middle)
    v_y = left / period - speed * np.sin(middle)
    return np.stack([v_x, v_y, w], axis=1)


class LearnedSlipState(NamedTuple):
    """State of the policy between two calls; never changed in place."""

    driving: LyapunovState
    added: Array  # (N, 3) [m/s, m/s, rad/s] to belts and gyro
    hidden: Floats


class LearnedSlipPolicy(UnicyclePolicy):
    """The policy in an environment. heights: whether its network sees the height scan.

    Raises ValueError for an observation that lacks a field, and for actions that are no speeds.
    """

    def __init__(self, network: RecurrentNetwork, context: Context, heights: bool = False) -> None:
        if context.drive != "speed":
            raise ValueError(f"it commands speeds, the environment takes a {context.drive}")
        shown, sheet = context.observation, DataSheet.of(context.sensors)
        super().__init__(
            context.vehicle, context.control_period, tuned_gains(shown), sheet, observation=shown
        )
        self.pose_filter = self.pose_filter._replace(velocity_measured=False)
        further = (*(ATTITUDE if self._tilted else ()), *(HEIGHTS if heights else ()))
        self._view = layout.View(shown, (*layout.NAMES, *further))
        self._heights = heights
        self._measured = sheet.velocity_noise <= pose_filter.VELOCITY_NOISE_LIMIT
        self._network = network
        self._count, self._infer = 1, network.batch(1)

    def act(self, observation: Floats, state: Any, start: Bools) -> tuple[Floats, Any]:
        """Sprocket speeds over their limit, and the new state."""
        features, uc, state = self.see(observation, state, start)
        outputs = self.infer(features, state.hidden)
        action = np.clip(uc + ACTION * outputs[:, :2], -1.0, 1.0).astype(np.float32)
        return action, state._replace(added=outputs[:, 2:] * UNITS)

    def infer(self, features: Floats, hidden: Floats) -> Floats:
        """Outputs (N, OUTPUTS) of the network, hidden (N, H) in and out."""
        if len(features) != self._count:
            self._count, self._infer = len(features), self._network.batch(len(features))
        return self._infer(features, hidden)

    def see(
        self, observation: Floats, state: LearnedSlipState | None, start: Bools
    ) -> tuple[Floats, Floats, LearnedSlipState]:
        """Features (N, F), actions (N, 2) of the unicycle controller, and the state in which the
        network is to carry its part on."""
        count = len(observation)
        if state is None:
            added = np.zeros((count, 3))
            hidden = np.zeros((count, self._network.size), np.float32)
            before, driving = np.zeros((count, 3)), None
        else:
            self.same_count(len(state.added), count)
            driving, forget = state.driving, start[:, None]
            added = np.where(forget, 0.0, state.added)
            hidden = np.where(forget, np.float32(0.0), state.hidden)
            before = driving.error
        self._added = added
        gyro = observation[:, _GYRO].copy()
        observation[:, _GYRO] += (added[:, 2] / layout.SCALE[_GYRO]).astype(np.float32)
        uc, driving = super().act(observation, driving, start)
        observation[:, _GYRO] = gyro
        error, reference, belts = self._path
        age = np.zeros(count) if state is None else state.driving.age
        is_new = start | (driving.age < age + 0.5 * self.control_period)
        w = np.nan_to_num(gyro * layout.SCALE[_GYRO])
        self.shown = reference, np.stack([belts[:, 0], np.zeros(count), w], axis=1)
        moved = self.unknown_motion(before, error) - added
        moved[start] = 0.0
        velocity = observation[:, _VELOCITY] * layout.SCALE[_VELOCITY]
        slip = np.stack([velocity[:, 0] - belts[:, 0], velocity[:, 1], w - belts[:, 1]], axis=1)
        signed = np.concatenate([error, error, moved, slip, driving.age[:, None]], axis=1)
        signed *= _LOG_SCALE
        attitude = np.zeros((count, len(ATTITUDE)))
        if self._tilted:
            rows = observation[:, layout.SIZE : layout.SIZE + len(ATTITUDE)] * _SLOPE
            rows[:, :2] = driving.attitude
            attitude = (rows - _UPRIGHT) / _ATTITUDE_SCALE
        parts = [
            observation[:, _SHOWN] * _PLAIN_SCALE, attitude,
            np.sign(signed) * np.log1p(np.abs(signed)), added / UNITS, UC_SHOWN * uc,
            is_new[:, None], np.full((count, 1), self._measured),
        ]  # fmt: skip
        if self._heights:
            parts.append(observation[:, -len(HEIGHTS) :])
        features = np.nan_to_num(np.concatenate(parts, axis=1))
        bounded = np.clip(features, -BOUND, BOUND).astype(np.float32)
        return bounded, uc, LearnedSlipState(driving, added, hidden)

    def unknown_motion(self, before: Array, after: Array) -> Array:
        """What belts and gyro, as last seen, lack of the motion that carries pose errors (N, 3)
        from one step to this one [m/s, m/s, rad/s]."""
        reference, known = self.shown
        return motion_between(before, after, reference, self.control_period) - known

    def _without_pose(
        self, observation: Floats, motion: Array, alpha: Array
    ) -> tuple[Array, Array]:
        """Belts and what the network adds."""
        forward = motion[:, 0] + self._added[:, 0]
        slow = np.abs(forward) < law.SLOW
        angle = np.arctan(self._added[:, 1] / np.where(slow, np.inf, forward))
        return np.stack([forward, motion[:, 1] + self._added[:, 2]], axis=1), angle

    def _path_error(
        self, observation: Floats, error: Array, reference: Array, moving: Bools, belt_motion: Array
    ) -> tuple[Array, Array, Bools]:
        self._path = error, reference, belt_motion
        return error, reference, moving
