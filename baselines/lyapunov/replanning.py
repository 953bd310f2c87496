"""The slippage-aware controller that plans to a goal, and plans again while it drives.

Every REPLAN_PERIOD a plan of least time (planners.least_time) is made from the filtered pose, with
the slip of the identified friction and the belts that drive the measured speed and yaw rate in
steady state (commanded belts run ahead of a vehicle on slippery ground by seconds), and followed in
the course frame (`Trajectory.at`). Poses are those in the frame of the goal. The error to the goal
is filtered, so that a new plan changes nothing in the filter; with that error (e_x, e_y, e_psi) in
body axes and the plan at (x, y) with course chi, the error to the plan is
    (e_x, e_y) - R(e_psi)^T (x, y)        e_psi - chi
On friction mu a vehicle changes its motion by mu g at most; plans use GRIP of that, for slip is in
steady state in a plan and not in the vehicle. Speeds and lengths below are for the indoor vehicle
of [F] and grow with the track gauge.

A plan that did not converge is dropped, and so is one whose way is longer by DETOUR than what is
left of the one before, while the vehicle is within NEAR of that: it would drive a circle to correct
a few centimetres to the side. With less than FINAL left the plan is driven to its end, and the
vehicle rests after SETTLE. A vehicle without any plan stands, and plans again.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 5.2, 6.3.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.batch_policy import Bools, Floats
from baselines.estimators.measurement import DataSheet
from baselines.lyapunov import lyapunov_laws as law
from baselines.lyapunov import slippage_aware
from baselines.lyapunov.lyapunov_laws import LyapunovGains
from baselines.lyapunov.pose_filter import PATH, POSE
from baselines.planners.least_time import optimal
from baselines.planners.trajectory import Limits, Start, Trajectory
from baselines.slip.slip_models import Array, TableSlipModel
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import VEHICLES, PlantParameters
from tracked_env.physics.terramechanics import GRAVITY

INTERVALS, PER_INTERVAL = 40, 5  # of a plan, and samples kept of each
LAST = INTERVALS * PER_INTERVAL  # sample


class Plans(NamedTuple):
    """The plans of N vehicles, in the frame of each one's goal; never changed in place."""

    samples: Array  # (N, LAST + 1, 7) x, y [m], course [rad], V, chi', V', chi''; even in time
    duration: Array  # (N,) [s] of the plan
    since: Array  # (N,) [s] since it began; NaN: no plan yet
    since_attempt: Array  # (N,) [s] since the last attempt to plan, followed or not
    followed: NDArray[np.int64]  # (N,) plans that were, in this episode
    not_found: NDArray[np.int64]  # (N,) plans that did not converge
    refused: NDArray[np.int64]  # (N,) plans that went round

    @classmethod
    def none(cls, count: int) -> "Plans":
        """No plans yet."""
        counts = (np.zeros(count, dtype=np.int64) for _ in range(3))
        since, attempt = np.full(count, math.nan), np.full(count, math.inf)
        return cls(np.zeros((count, LAST + 1, 7)), np.zeros(count), since, attempt, *counts)

    def restarted(self, start: Bools) -> "Plans":
        """Without those of vehicles whose episode starts."""
        if not start.any():
            return self
        copies = Plans._make(values.copy() for values in self)
        for values, new in zip(copies, Plans.none(int(start.sum())), strict=True):
            values[start] = new
        return copies

    def way_left(self, i: int) -> float:
        """Way [m] of vehicle i until its plan ends; infinite without a plan."""
        if math.isnan(self.since[i]):
            return math.inf
        spacing = self.duration[i] / LAST
        first = min(int(self.since[i] / max(spacing, 1e-9)), LAST)
        return float(np.sum(np.abs(self.samples[i, first:, 3])) * spacing)


@loop
def follow(error, samples, since, duration, to_plan, motion):
    """Error to the plan (N, 3), body axes, and its v_d, w_d, v_d', w_d' (N, 4), both out.

    error (N, 3): to the goal. samples, since, duration: of Plans. Zeros without a plan.
    """
    at = np.empty(7)
    for i in range(error.shape[0]):
        to_plan[i], motion[i] = 0.0, 0.0
        if not math.isfinite(since[i]):
            continue
        place = min(since[i] / duration[i], 1.0) * LAST if duration[i] > 0.0 else LAST
        first = min(int(place), LAST - 1)
        share = place - first
        for k in range(7):
            at[k] = (1.0 - share) * samples[i, first, k] + share * samples[i, first + 1, k]
        cosine, sine = rotation(error[i, 2])
        # The plan's position in body axes, of the frame turned by yaw = error[i, 2].
        to_plan[i, 0] = error[i, 0] - (cosine * at[0] + sine * at[1])
        to_plan[i, 1] = error[i, 1] - (cosine * at[1] - sine * at[0])
        to_plan[i, 2] = wrap_angle(error[i, 2] - at[2])
        for k in range(4):
            motion[i, k] = at[3 + k]


REPLAN_PERIOD = 1.0  # [s] between two plans
FINAL = 2.5  # [s] left of a plan, below which it is driven to its end
SETTLE = 3.0  # [s] after the end, until the belts stand
NEAR = 0.1  # [m] from the plan: one that goes round is not taken
DETOUR = 0.3  # [m] by which the way of such a plan is longer; a circle has 1 m at least
GRIP = 0.14  # [-] share of mu g for accelerations in plans
RESERVE = 0.2  # [-] share of the sprocket speed that plans leave to the controller
SPROCKET_ACCELERATION = 20.0  # [rad/s^2] of plans, on any ground
SLOWEST, FASTEST = 0.15, 0.4  # [m/s] of the belts in plans

GOAL = ("goal_x", "goal_y", "goal_cosine", "goal_sine")
_I, _SCALE = layout.INDEX, layout.SCALE
_ERRORS = POSE[:3]
_MEASURED = tuple(name for name in slippage_aware.NEEDS if name not in (*_ERRORS, *PATH))
_POSE, _PATH = [_I[name] for name in _ERRORS], [_I[name] for name in PATH]
_MOTION = [_I["v_x"], _I["yaw_rate"]]
_GOAL_SCALE = layout.make_layout(["goal"]).scale[: len(GOAL)]


class ReplanningState(NamedTuple):
    """State of the policy between two calls."""

    adaptive: slippage_aware.AdaptiveSlipState
    plans: Plans


class ReplanningPolicy(slippage_aware.AdaptiveSlipPolicy):
    """Drives to the goal that the observation shows (group `goal`); see the head of the file.

    replan_period [s]: math.inf for one plan alone. Other arguments as AdaptiveSlipPolicy. Ground
    that is not level is driven as if it were.
    Raises ValueError for arguments that make no sense, and for an observation without a goal.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        gains: LyapunovGains = law.GAINS_ON_SLOPES,
        observation: Sequence[str] = layout.NAMES,
        replan_period: float = REPLAN_PERIOD,
    ) -> None:
        super().__init__(parameters, control_period, data_sheet, gains)
        self._view = layout.View(observation, (*_MEASURED, *GOAL))
        if not replan_period >= control_period:
            raise ValueError(
                f"replan_period = {replan_period} s; must be the control period of "
                f"{control_period:g} s or more. Did you pass a frequency?"
            )
        self._replan_period = float(replan_period)
        # Track gauge in units of that of the indoor vehicle.
        self._size = size = parameters.track_gauge / VEHICLES["focchi"].track_gauge
        speeds = {"v_min": size * SLOWEST, "v_max": size * FASTEST, "reserve": RESERVE}
        self._limits = Limits.of(parameters, **speeds)
        self.plans = Plans.none(0)  # before the call of `act`, new in it

    def act(self, observation: Floats, state: Any, start: Bools) -> tuple[Floats, Any]:
        """Sprocket speeds over their limit, and the new state."""
        adaptive = None
        self.plans = Plans.none(len(start))
        if state is not None:
            self.same_count(len(state.plans.since), len(start))
            adaptive, self.plans = state.adaptive, state.plans.restarted(start)
        action, adaptive = super().act(with_goal_as_reference(observation), adaptive, start)
        return action, ReplanningState(adaptive, self.plans)

    def _path_error(
        self, observation: Floats, error: Array, reference: Array, moving: Bools, belt_motion: Array
    ) -> tuple[Array, Array, Bools]:
        """Error to the plan and motion of the plan, of vehicles that have one."""
        period, plans = self.control_period, self.plans
        since, attempt = plans.since + period, plans.since_attempt + period
        plans = plans._replace(since=since, since_attempt=attempt)
        soon = 0.5 * period  # the clock is a sum
        again = (plans.duration - since > FINAL) & (attempt > self._replan_period - soon)
        first = np.isnan(since) & (attempt > REPLAN_PERIOD - soon)
        due = np.flatnonzero(moving & (first | again))
        to_plan, motion = np.empty((len(error), 3)), np.empty((len(error), 4))
        if len(due):
            follow(error, plans.samples, plans.since, plans.duration, to_plan, motion)
            measured = observation[:, _MOTION] * _SCALE[_MOTION]
            belts = self._steady_belts(np.where(np.isfinite(measured), measured, belt_motion))
            plans = self._updated(plans, due, error, np.hypot(*to_plan.T[:2]), belts)
        self.plans = plans
        follow(error, plans.samples, plans.since, plans.duration, to_plan, motion)
        return to_plan, motion, moving & (plans.since < plans.duration + SETTLE)

    def _steady_belts(self, motion: Array) -> Array:
        """Sprocket speeds (N, 2) [rad/s] that drive motion (N, 2), within the limits of plans."""
        belts = self._feed_forward(motion, np.zeros_like(motion))
        return np.clip(belts, -self._limits.sprocket_used, self._limits.sprocket_used)

    def _updated(
        self, plans: Plans, rows: NDArray[np.int64], error: Array, off: Array, belts: Array
    ) -> Plans:
        """The plans with new ones of `rows`; off (N,) [m]: distance to the ones before."""
        new = Plans._make(values.copy() for values in plans)
        model = self.slip_model
        assert isinstance(model, TableSlipModel)
        friction = np.broadcast_to(model.friction, len(error))
        for i in rows:
            plan = self._plan(error[i], belts[i], model._replace(friction=friction[i : i + 1]))
            longest = plans.way_left(i) + self._size * DETOUR
            new.since_attempt[i] = 0.0
            if not plan.converged:
                new.not_found[i] += 1
            elif off[i] < self._size * NEAR and plan.length > longest:
                new.refused[i] += 1
            else:
                new.followed[i] += 1
                new.since[i], new.duration[i] = 0.0, plan.duration
                samples = np.stack(plan.at(np.linspace(0.0, plan.duration, LAST + 1)), axis=1)
                new.samples[i] = samples[:, [0, 1, 2, 3, 5, 4, 6]]  # the turn before the gain
        return new

    def _plan(self, error: Array, belts: Array, model: TableSlipModel) -> Trajectory:
        """The plan of one vehicle at `error` (3,) to the goal, its belts at (2,) [rad/s]."""
        grip = GRIP * GRAVITY * float(model.friction[0])
        turning = grip / self.parameters.sprocket_radius
        limits = self._limits._replace(
            acceleration=grip,
            lateral_acceleration=grip,
            sprocket_acceleration=min(SPROCKET_ACCELERATION, turning),
        )
        ahead, left, yaw = (float(value) for value in error)
        cosine, sine = math.cos(yaw), math.sin(yaw)
        place = cosine * ahead - sine * left, sine * ahead + cosine * left
        start = Start(*place, yaw, sprocket_left=belts[0], sprocket_right=belts[1])
        problem = start, (0.0, 0.0, 0.0), limits, self.parameters, model
        plan = optimal(*problem, intervals=INTERVALS, stop=True)
        assert isinstance(plan, Trajectory)
        return plan


def with_goal_as_reference(observation: Floats) -> Floats:
    """Observations (N, SIZE) whose reference stands at the goal; GOAL stands behind those given."""
    goal = observation[:, layout.SIZE :] * _GOAL_SCALE
    referred = observation[:, : layout.SIZE].copy()
    error = np.column_stack([goal[:, 0], goal[:, 1], np.arctan2(goal[:, 3], goal[:, 2])])
    referred[:, _POSE], referred[:, _PATH] = error / _SCALE[_POSE], 0.0
    return referred
