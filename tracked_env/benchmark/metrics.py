"""Metrics of one episode, from the recorded true motion; docs/metrics.md says how to read them.

With e_k the distance to the reference after control step k, h the control period, T the length
of the episode, E the error limit, tau and omega of the two sprockets:
    tracking RMSE      sqrt(mean e_k^2)
    effort             mean demand^2 over its limit^2                   over both sides
    energy             sum h (|tau_L omega_L| + |tau_R omega_R|)        no recuperation
    saturation share   part of the steps and sides with |demand| at its limit
    action rate        mean |demand_k - demand_(k-1)| / h               over both sides
Of the two metrics of the action rate, of torques and of speeds, the one that is not commanded is
NaN. e_k = E for the time that an episode lacks, and is never more; all that is no distance to the
reference is taken over the time driven.

Changes. A parameter of CHANGING changes in step k when its value in force differs from that of
step k - 1 by more than RESOLUTION of it. Steps less than JOIN_TIME apart make one run, per
parameter; a run is
    abrupt    when it lasts less than ABRUPT_TIME and moves the parameter by at least
              ABRUPT_CHANGE of its value before it (a payload step, the crossing of a border),
              and, unless it is a single step, lies JOIN_TIME away from both ends of the episode
    slow      otherwise (drift, a resistance map): it is no change in the sense of this file
Abrupt runs of all parameters that overlap are one change. With t_s and t_e start and end of the
first change, t_n the start of the next (or the end of the episode), l the contact length:
    recovery time        smallest tau >= 0 with e(t) < RECOVERED l for all t_e + tau < t <= t_n;
                         t_n - t_e when there is none
    peak after change    max of e(t) over t_s < t <= t_n
    RMSE after change    sqrt(mean e(t)^2) over t_s < t <= t_n
All are NaN without an abrupt change in the time driven.

A goal, which not all references have, is reached in a step with the pose within GOAL_DISTANCE l and
GOAL_ANGLE of it. The miss is the distance where the pose was finite last.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine.episode import Episode
from tracked_env.physics.parameters import VEHICLES, PlantParameters

FloatArray = NDArray[np.float64]

SETTLING_TIME = 5.0  # [s] start of the settled part; half the episode when it is shorter than 10 s
SATURATED = 0.999  # [-] of the limit of the demand
# Metric of the action rate by drive, what the actions are.
ACTION_RATES = {"torque": "torque_rate", "speed": "sprocket_speed_rate"}
ENDINGS = ("time", "off-path", "non-finite")

CHANGING = (
    *("mass", "inertia", "longitudinal_resistance", "lateral_resistance", "friction_angle"),
    *("actuator_gain_left", "actuator_gain_right"),
)
RESOLUTION = 1e-9  # [-] smaller relative changes are rounding
ABRUPT_TIME = 2.0  # [s] a change that takes longer is a drift, which a policy can follow
ABRUPT_CHANGE = 0.02  # [-] less is not felt: a graze of a border
JOIN_TIME = 0.5  # [s] a vehicle that stops on a border and goes on crosses it once
RECOVERED = 0.05  # [-] of the contact length l: 0.1 m for 2 m, a fifth of a failure

GOAL_DISTANCE = 1.0 / 7.0  # [-] of the contact length: 0.1 m for 0.7 m
GOAL_ANGLE = 0.1  # [rad]

# Columns of a trace, all true values: poses [m, rad], error [m, rad], reference minus vehicle speed
# [m/s], clipped demand over its limit [-], drives [N m, rad/s], slip [-], parameters in force [SI].
CHANNELS = (
    *("x", "y", "yaw", "reference_x", "reference_y", "reference_yaw"),
    *("error", "heading_error", "speed_error", "action_left", "action_right"),
    *("torque_left", "torque_right", "sprocket_speed_left", "sprocket_speed_right"),
    *("slip_left", "slip_right", *CHANGING),
)


class Change(NamedTuple):
    """One abrupt change; the parameters are new from step `first`, and constant from `last`."""

    first: int  # [control steps] it starts at time `first` times the control period
    last: int  # [control steps] and ends at time `last` times the control period


class Trace(NamedTuple):
    """The recorded motion of n episodes over at most T control steps."""

    values: FloatArray  # (T, n, channels) after each control step; rows past `steps` are void
    steps: NDArray[np.int64]  # (n,) control steps driven
    max_steps: int  # control steps of a whole episode
    terminated: NDArray[np.bool_]  # (n,) ended before its time
    success: NDArray[np.bool_]  # (n,) as `info["is_success"]`
    demand_limit: FloatArray  # (n,) largest demand: torque [N m] or sprocket speed [rad/s]
    contact_length: FloatArray  # (n,) [m]
    error_limit: NDArray[np.float64]  # (N,) [m]
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


AFTER_CHANGE = ("recovery_time", "peak_after_change", "rmse_after_change")
OF_GOALS = ("goal_reached", "goal_time", "goal_energy", "goal_miss")
# Metrics that an episode may lack: of the other drive, without an abrupt change, without a goal.
OPTIONAL = (*ACTION_RATES.values(), *AFTER_CHANGE, *OF_GOALS)
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


def abrupt_changes(parameters: FloatArray, period: float) -> list[Change]:
    """The abrupt changes of one episode, in their order.

    parameters: (T, P) values in force during each control step driven; period [s] of a step.
    """
    join = max(round(JOIN_TIME / period), 2)
    abrupt = []
    for values in parameters.T:
        step = np.abs(np.diff(values))
        moved = np.flatnonzero(step > RESOLUTION * np.abs(values[:-1])) + 1
        breaks = np.flatnonzero(np.diff(moved) >= join) + 1
        for steps in np.split(moved, breaks) if moved.size else ():  # those less than `join` apart
            first, last = int(steps[0]), int(steps[-1])
            before, after = values[first - 1], values[last]
            large = abs(after - before) >= ABRUPT_CHANGE * abs(before)
            whole = first == last or join < first <= last < len(values) - join
            if large and whole and (last - first) * period < ABRUPT_TIME:
                abrupt.append(Change(first, last))
    changes: list[Change] = []
    for run in sorted(abrupt):
        if changes and run.first <= changes[-1].last:
            changes[-1] = Change(changes[-1].first, max(changes[-1].last, run.last))
        else:
            changes.append(run)
    return changes


def last_outside(outside: NDArray[np.bool_]) -> int:
    """Number of leading entries up to the last that is True; 0 when none is."""
    places = np.flatnonzero(outside)
    return int(places[-1]) + 1 if places.size else 0


def recovery(
    error: FloatArray, changes: list[Change], period: float, recovered: float
) -> tuple[float, float, float]:
    """Recovery time [s], peak and RMSE [m] after the first change; NaN when there is none.

    error: (T,) counted distance to the reference [m] after each control step of the whole
    episode, also past an early end; period [s] of a step; recovered [m]: what counts as such.
    """
    if not changes:
        return np.nan, np.nan, np.nan
    first, last = changes[0]
    until = changes[1].first if len(changes) > 1 else len(error)
    # Entry k of the error is taken at time (k + 1) periods.
    since = error[first:until]
    time = period * last_outside(error[last:until] >= recovered)
    return time, float(since.max()), float(np.sqrt(np.mean(since * since)))


def goals_of(episodes: list[Episode]) -> FloatArray:
    """Goals (n, 3) x, y [m], yaw [rad]; NaN where a reference has none."""
    goals = np.full((len(episodes), 3), np.nan)
    for i, episode in enumerate(episodes):
        if episode.profile.knots.size:
            goals[i] = episode.profile.knots[-1, 1:4]
    return goals


def goal_reaching(trace: Trace, power: FloatArray) -> dict[str, FloatArray]:
    """The metrics of OF_GOALS, (n,) each; power [W] (T, n) of both sprockets."""
    count, steps, period = len(trace.steps), trace.steps, trace.control_period
    goals = np.full((count, 3), np.nan) if trace.goals is None else trace.goals
    poses = np.stack([trace.channel(name) for name in ("x", "y", "yaw")])
    x, y, yaw = np.where(np.isfinite(poses), poses, np.nan) - goals.T[:, None]
    away = np.hypot(x, y)
    turned = np.abs(np.remainder(yaw + np.pi, 2.0 * np.pi) - np.pi)
    number, driven = np.arange(len(away))[:, None], trace.driven()
    near = away <= GOAL_DISTANCE * trace.nominal.contact_length
    there = driven & near & (turned <= GOAL_ANGLE)
    reached, first = there.any(axis=0), there.argmax(axis=0)
    last = np.where(reached, first, steps - 1)
    powers = np.where((number <= last) & np.isfinite(power), power, 0.0)
    ends = np.where(driven & np.isfinite(away), number, 0).max(axis=0)
    time = np.where(reached, (first + 1) * period, trace.max_steps * period)
    values = reached.astype(float), time, _total(powers) * period, away[ends, np.arange(count)]
    has_goal = np.isfinite(goals).all(axis=1)
    return {
        name: np.where(has_goal, value, np.nan)
        for name, value in zip(OF_GOALS, values, strict=True)
    }


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


def evaluate(trace: Trace) -> dict[str, FloatArray]:
    """Every metric of METRICS, (n,) each; NaN only in OPTIONAL ones."""
    period = trace.control_period
    error = counted_error(trace)
    settled = settled_step(trace)
    after = [
        recovery(error[:, i], changes, period, RECOVERED * trace.contact_length[i])
        for i, changes in enumerate(trace.changes())
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
        **goal_reaching(trace, power),
    }
