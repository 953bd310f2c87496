"""Metrics of one episode, from the recorded true motion.

With e_k the distance to the reference after control step k, h the control period, T the length
of the episode, E the error limit, tau and omega of the two sprockets:
    tracking RMSE      sqrt(mean e_k^2)
    effort             mean demand^2 over its limit^2                   over both sides
    energy             sum h (|tau_L omega_L| + |tau_R omega_R|)        no recuperation
    saturation share   part of the steps and sides with |demand| at its limit
    action rate        mean |demand_k - demand_(k-1)| / h               over both sides
The demand is what the action commands: the torque of a sprocket, or its speed. Its limit is the
largest one. The action rate is therefore one of two metrics: `torque_rate` [N m/s], or
`sprocket_speed_rate` [rad/s^2]; the other one is NaN.
An episode that ends early counts e_k = E for the time it lacks, and e_k never counts more than
E: leaving the path is never better than staying on it. Heading, speed, effort, energy, saturation
and action rate are taken over the time driven; read them beside the share of terminations.
Recovery, peak and RMSE after an abrupt change of the true parameters are defined in `changes`; they
are NaN where there is none. Goals are those of planned references, see `goal_metrics`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.changes import CHANGING, RECOVERED, Change, abrupt_changes, recovery
from tracked_env.benchmark.goal_metrics import (
    GOAL_ANGLE,
    GOAL_DISTANCE,
    GoalReaching,
    reaching,
)
from tracked_env.physics.parameters import VEHICLES, PlantParameters

FloatArray = NDArray[np.float64]

SETTLING_TIME = 5.0  # [s] start of the settled part; half the episode when it is shorter than 10 s
SATURATED = 0.999  # [-] of the limit of the demand
# Metric of the action rate by drive, what the actions are.
ACTION_RATES = {"torque": "torque_rate", "speed": "sprocket_speed_rate"}
ENDINGS = ("time", "off-path", "non-finite")

# Columns of a trace, all true values.
CHANNELS = (
    "x", "y", "yaw",  # [m, m, rad] vehicle, world
    "reference_x", "reference_y", "reference_yaw",  # [m, m, rad]
    "error", "heading_error",  # [m, rad]
    "speed_error",  # [m/s] reference minus vehicle
    "action_left", "action_right",  # [-] clipped demand over its limit
    "torque_left", "torque_right",  # [N m] of the drives
    "sprocket_speed_left", "sprocket_speed_right",  # [rad/s]
    "slip_left", "slip_right",  # [-]
    *CHANGING,  # [SI] parameters that were in force during the step
)  # fmt: skip


class Trace(NamedTuple):
    """The recorded motion of n episodes over at most T control steps."""

    values: FloatArray  # (T, n, channels) after each control step; rows past `steps` are void
    steps: NDArray[np.int64]  # (n,) control steps driven
    max_steps: int  # control steps of a whole episode
    terminated: NDArray[np.bool_]  # (n,) ended before its time
    success: NDArray[np.bool_]  # (n,) as `info["is_success"]`
    demand_limit: FloatArray  # (n,) largest demand: torque [N m] or sprocket speed [rad/s]
    contact_length: FloatArray  # (n,) [m]
    error_limit: float  # [m]
    control_period: float  # [s]
    drive: str = "torque"  # what the demand is, a key of ACTION_RATES
    nominal: PlantParameters = VEHICLES["strawa"]  # what its policies expect
    goals: FloatArray | None = None  # (n, 3) x, y, yaw of the goals of references that have one

    def channel(self, name: str) -> FloatArray:
        """One channel, (T, n)."""
        return self.values[:, :, CHANNELS.index(name)]

    def driven(self) -> NDArray[np.bool_]:
        """(T, n) whether the episode was still running."""
        return np.arange(len(self.values))[:, None] < self.steps

    def changes(self) -> list[list[Change]]:
        """The abrupt changes of every episode in the time driven."""
        columns = [CHANNELS.index(name) for name in CHANGING]
        return [
            abrupt_changes(self.values[:steps, i, columns], self.control_period)
            for i, steps in enumerate(self.steps)
        ]


class Metric(NamedTuple):
    """Unit and meaning of one column of the records."""

    unit: str
    meaning: str


METRICS = {
    "tracking_rmse": Metric("m", "RMSE of the distance to the reference, whole episode"),
    "settled_rmse": Metric("m", f"the same after {SETTLING_TIME:g} s"),
    "max_error": Metric("m", "largest distance to the reference"),
    "final_error": Metric("m", "distance to the reference at the end"),
    "heading_rmse": Metric("rad", "RMSE of the heading error"),
    "speed_rmse": Metric("m/s", "RMSE of the speed error"),
    "effort": Metric("-", "mean square of the demand over its limit"),
    "energy": Metric("J", "work of the sprockets, braking counts as well"),
    "saturation_share": Metric("-", "part of the time with a demand at its limit"),
    "torque_rate": Metric("N m/s", "mean rate of change of the torque demand"),
    "sprocket_speed_rate": Metric("rad/s^2", "mean rate of change of the demanded sprocket speed"),
    "success": Metric("-", "ended by time with an RMSE below a quarter of the contact length l"),
    "terminated": Metric("-", "ended before its time"),
    "driven_time": Metric("s", "time until the end of the episode"),
    "recovery_time": Metric(
        "s", f"time after an abrupt change until the distance stays below {RECOVERED:g} l"
    ),
    "peak_after_change": Metric("m", "largest distance to the reference after that change"),
    "rmse_after_change": Metric("m", "RMSE of that distance after that change, until the next one"),
    "goal_reached": Metric(
        "-", f"the goal was reached within l/{1.0 / GOAL_DISTANCE:g} and {GOAL_ANGLE:g} rad"
    ),
    "goal_time": Metric("s", "time until then; the whole episode without"),
    "goal_energy": Metric("J", "work of the sprockets until then"),
    "goal_miss": Metric("m", "distance to the goal at the end"),
}
OF_GOALS = ("goal_reached", "goal_time", "goal_energy", "goal_miss")
# Metrics that an episode may lack: of the other drive, without an abrupt change, without a goal.
AFTER_CHANGE = ("recovery_time", "peak_after_change", "rmse_after_change")
OPTIONAL = (*ACTION_RATES.values(), *AFTER_CHANGE, *OF_GOALS)


def counted_error(trace: Trace) -> FloatArray:
    """Distance to the reference [m], (max_steps, n): as driven, then the error limit."""
    counted = np.full((trace.max_steps, len(trace.steps)), trace.error_limit)
    error = np.where(trace.driven(), trace.channel("error"), trace.error_limit)
    counted[: len(error)] = np.where(error < trace.error_limit, error, trace.error_limit)
    return counted  # a NaN is not below the limit, so it counts as the limit


def settled_step(trace: Trace) -> int:
    """First control step of the settled part."""
    whole = trace.max_steps * trace.control_period
    return round(min(SETTLING_TIME, 0.5 * whole) / trace.control_period)


def _total(values: FloatArray) -> FloatArray:
    """Sum over time, (T, n) -> (n,), to the last bit the same for every size of the batch."""
    return np.ascontiguousarray(values.T).sum(axis=-1)


def _root_mean_square(values: FloatArray) -> FloatArray:
    """Root of the mean square over time, (T, n) -> (n,)."""
    return np.sqrt(_total(values * values) / len(values))


def _driven_mean(trace: Trace, values: FloatArray) -> FloatArray:
    """Mean over the steps driven, (T, n) -> (n,); non-finite values count as zero."""
    valid = np.where(trace.driven() & np.isfinite(values), values, 0.0)
    return _total(valid) / np.maximum(trace.steps, 1)


def _sides(trace: Trace, name: str) -> FloatArray:
    """Left and right channel, (2, T, n)."""
    return np.stack([trace.channel(f"{name}_left"), trace.channel(f"{name}_right")])


def ending(trace: Trace) -> list[str]:
    """How each episode ended, one of ENDINGS."""
    last = trace.values[trace.steps - 1, np.arange(len(trace.steps))]
    finite = np.isfinite(last.sum(axis=-1))
    kind = np.where(trace.terminated, np.where(finite, 1, 2), 0)
    return [ENDINGS[k] for k in kind]


def _reaching(trace: Trace, power: FloatArray) -> GoalReaching:
    """The numbers of OF_GOALS; power [W] (T, n)."""
    goals = np.full((len(trace.steps), 3), np.nan) if trace.goals is None else trace.goals
    poses = np.stack([trace.channel(name) for name in ("x", "y", "yaw")])
    period = trace.control_period
    length = trace.nominal.contact_length
    return reaching(poses, power, trace.steps, goals, length, period, trace.max_steps * period)


def evaluate(trace: Trace) -> dict[str, FloatArray]:
    """Every metric of METRICS, (n,) each; NaN only in OPTIONAL ones."""
    period = trace.control_period
    error = counted_error(trace)
    settled = settled_step(trace)
    after = [
        recovery(error[:, i], c, period, RECOVERED * trace.contact_length[i])
        for i, c in enumerate(trace.changes())
    ]
    power = np.abs(_sides(trace, "torque") * _sides(trace, "sprocket_speed")).sum(axis=0)
    action = _sides(trace, "action")
    before = np.concatenate([action[:, :1], action[:, :-1]], axis=1)  # the first step is no change
    demand_rate = np.abs(action - before).mean(axis=0) * trace.demand_limit / period
    rates = dict.fromkeys(ACTION_RATES.values(), np.full(len(trace.steps), np.nan))
    rates[ACTION_RATES[trace.drive]] = _driven_mean(trace, demand_rate)
    saturated = (np.abs(action) >= SATURATED).mean(axis=0)
    return {
        "tracking_rmse": _root_mean_square(error),
        "settled_rmse": _root_mean_square(error[settled:]),
        "max_error": error.max(axis=0),
        "final_error": error[-1],
        "heading_rmse": np.sqrt(_driven_mean(trace, trace.channel("heading_error") ** 2)),
        "speed_rmse": np.sqrt(_driven_mean(trace, trace.channel("speed_error") ** 2)),
        "effort": _driven_mean(trace, (action**2).mean(axis=0)),
        "energy": _driven_mean(trace, power) * trace.steps * period,
        "saturation_share": _driven_mean(trace, saturated),
        **rates,
        "success": trace.success.astype(np.float64),
        "terminated": trace.terminated.astype(np.float64),
        "driven_time": trace.steps * period,
        **dict(zip(AFTER_CHANGE, np.array(after).T, strict=True)),
        **dict(zip(OF_GOALS, _reaching(trace, power), strict=True)),
    }
