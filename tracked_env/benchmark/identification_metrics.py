"""Accuracy of the estimates of a policy, taken down step by step beside the true values.

A policy with the hook `estimates` is asked after each `predict`. Row k holds its estimate x_k and
standard deviation sigma_k at time k h, when it has seen k + 1 observations, and the true value p_k
that was in force when the last of them was taken. Estimates of parameters outside ESTIMABLE, or
that the plant does not read, have no true value and are not taken down. docs/metrics.md defines the
metrics, by the relative error
    r_k = (x_k - p_k) / P_k,   P_k = max(|p_k|, 1 % of the nominal value), 1 for the slips
NEES is over the rows with sigma_k > 0. Rows whose estimate is not finite count as outside every
band, and not in the RMSE.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.arrays import columns
from tracked_env.benchmark.metrics import Metric, Trace, last_outside, settled_step
from tracked_env.physics.lumped import drive_limits
from tracked_env.physics.parameters import PARAMETER_NAMES, VEHICLES, PlantParameters

FloatArray = NDArray[np.float64]

SLIPS = ("slip_left", "slip_right")
ESTIMABLE = (*PARAMETER_NAMES, "effort_maximum", *SLIPS)  # what may be estimated
SETTLED = 0.1  # [-] relative error within which an estimate is settled
DIVERGED = 0.5  # [-] relative error from which on an estimate may count as diverged
APART = 1.0  # [s] after an abrupt change, in which no estimator can know of it
LEAST_SCALE = 0.01  # [-] of the nominal value; keeps x/0 out of the relative error

ESTIMATION_METRICS = {
    "relative_rmse": Metric("-", "RMS of the relative error, whole episode"),
    "settled_relative_rmse": Metric("-", "the same after 5 s"),
    "final_relative_error": Metric("-", "relative error at the end, with its sign"),
    "settling_time": Metric("s", "time after the last abrupt change until within 10 % for good"),
    "settled": Metric("-", "1 when there is such a time, 0 when it never settles"),
    "nees": Metric("-", "mean of the squared error over the claimed variance"),
    "in_three_sigma": Metric("-", "part of the time with an error below three claimed sigma"),
    "excited": Metric("-", "part of the time in which the policy calls the parameter excited"),
    "nees_apart": Metric("-", "NEES without the first second after an abrupt change"),
    "in_three_sigma_apart": Metric("-", "part within three sigma, without that second"),
    "claimed_deviation": Metric("-", "median of the claimed sigma over the true value"),
    "diverged": Metric("-", "ends not finite, or beyond 50 % and worse than the nominal value"),
}


class Recorder:
    """Takes down the beliefs of one batch step by step, and the true values beside them."""

    names: tuple[str, ...] = ()  # (P,)
    value: NDArray[np.float32]  # (T, P, n) SI; rows past `rows` are void
    deviation: NDArray[np.float32]  # (T, P, n)
    truth: NDArray[np.float32]  # (T, P, n)
    excited: NDArray[np.bool_]  # (T, P, n)
    reports_excitation: tuple[bool, ...]  # (P,) whether `excited` is known
    nis: dict[str, NDArray[np.float32]]  # (T, n) by filter

    def __init__(
        self, count: int, max_steps: int, read: frozenset[str] = frozenset(ESTIMABLE)
    ) -> None:
        """read: parameters that the plant reads; others have no true value."""
        self.with_truth = (read | {"effort_maximum", *SLIPS}) & {*ESTIMABLE}
        self.count, self.max_steps = count, max_steps
        self.rows = 0

    def _allocate(self, estimates: Mapping[str, Any], excited: Mapping[str, Any]) -> None:
        """Fix the names by the first answer. Raises ValueError if none of them is known."""
        self.names = tuple(name for name in estimates if name in self.with_truth)
        if not self.names:
            raise ValueError(f"estimates of {sorted(estimates)}; none of them is in {ESTIMABLE}")
        for name in self.names:
            shapes = [np.shape(part) for part in estimates[name]]
            if shapes != [(self.count,)] * 2:
                raise ValueError(
                    f"estimate of {name} has shapes {shapes}; must be (value, standard deviation), "
                    f"each ({self.count},): one number per vehicle"
                )
        self.reports_excitation = tuple(name in excited for name in self.names)
        self._columns = columns(self.names)
        shape = (self.max_steps, len(self.names), self.count)
        self.value, self.deviation, self.truth = (np.empty(shape, np.float32) for _ in range(3))
        self.excited = np.zeros(shape, dtype=bool)
        self.nis = {}

    def take(self, policy: Any, floats: FloatArray) -> None:
        """One row. floats: those of the batch, before the step that follows.

        Raises ValueError for names or shapes that are not understood.
        """
        k = self.rows
        estimates = policy.estimates()
        excited = policy.excited() if hasattr(policy, "excited") else {}
        if k == 0:
            self._allocate(estimates, excited)
        for j, name in enumerate(self.names):
            self.value[k, j], self.deviation[k, j] = estimates[name]
            if self.reports_excitation[j]:
                self.excited[k, j] = excited[name]
        self.truth[k] = floats[:, self._columns].T
        for name, nis in (policy.nis() if hasattr(policy, "nis") else {}).items():
            if name not in self.nis:
                self.nis[name] = np.full((self.max_steps, self.count), np.nan, dtype=np.float32)
            self.nis[name][k] = nis
        self.rows += 1


@lru_cache
def nominal_values(nominal: PlantParameters = VEHICLES["strawa"]) -> dict[str, float]:
    """Nominal value of each of ESTIMABLE: the estimate of a policy that identifies nothing."""
    effort = float(drive_limits(nominal).effort_maximum)
    return {**nominal._asdict(), "effort_maximum": effort, **dict.fromkeys(SLIPS, 0.0)}


def scales(names: Sequence[str], truth: FloatArray, nominal: Mapping[str, float]) -> FloatArray:
    """Scale of a relative error, (P, K): the true value, not too close to 0; 1 in SI units for
    slips and for what is nominally 0.

    nominal: the nominal values.
    """
    floor = [[LEAST_SCALE * abs(nominal[name])] for name in names]
    absolute = [[name in SLIPS or nominal[name] == 0.0] for name in names]
    return np.where(absolute, 1.0, np.maximum(np.abs(truth), floor))


def _mean(values: FloatArray, valid: NDArray[np.bool_]) -> FloatArray:
    """Mean over the valid entries of the last axis; NaN where there is none."""
    if valid.size and valid.all():
        return np.asarray(values.mean(axis=-1))
    count = valid.sum(axis=-1)
    total = np.where(valid, values, 0.0).sum(axis=-1)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def optional(value: float) -> float | None:
    """A number as JSON has it; what is not finite (nothing to measure, never) is None."""
    return float(value) if np.isfinite(value) else None


def evaluate(beliefs: Recorder, trace: Trace) -> list[dict[str, Any]]:
    """Per episode {"identification": {parameter: {metric: number}}, "nis": {filter: mean}}.

    The metrics are those of ESTIMATION_METRICS, None where there is nothing to measure.
    """
    changes = trace.changes()
    nominal = nominal_values(trace.nominal)
    parts = (beliefs.value, beliefs.deviation, beliefs.truth, beliefs.excited)
    results: list[dict[str, Any]] = []
    for i, steps in enumerate(trace.steps):
        origin = changes[i][-1].last + 1 if changes[i] else 0
        # Times of one vehicle are neighbours in memory: the same sums for every batch.
        rows = [np.ascontiguousarray(part[:steps, :, i].T, dtype=np.float64) for part in parts]
        apart = np.ones(steps, dtype=bool)
        for change in changes[i]:
            apart[change.first : change.last + round(APART / trace.control_period)] = False
        metrics = _episode(beliefs, rows, origin, settled_step(trace), nominal, apart)
        metrics["settling_time"] = metrics["settling_time"] * trace.control_period
        parameters = {
            name: {metric: optional(values[j]) for metric, values in metrics.items()}
            for j, name in enumerate(beliefs.names)
        }
        nis = {}
        for name, values in beliefs.nis.items():
            driven = np.ascontiguousarray(values[:steps, i], dtype=np.float64)
            nis[name] = optional(float(_mean(driven, np.isfinite(driven))))
        results.append({"identification": parameters, "nis": nis})
    return results


def _episode(
    beliefs: Recorder,
    rows: Sequence[FloatArray],
    origin: int,
    settled: int,
    nominal: Mapping[str, float],
    apart: NDArray[np.bool_],
) -> dict[str, FloatArray]:
    """Every metric of one episode, (P,) each; the settling time in rows.

    rows: value, deviation, truth and excited, each (P, K); origin: first row after the last change;
    nominal: values. apart (K,): rows that are not shortly after an abrupt change.
    """
    value, deviation, truth, excited = rows
    finite = np.isfinite(value) & np.isfinite(truth)
    error = np.where(finite, value - np.where(finite, truth, 0.0), np.nan)
    scale = scales(beliefs.names, truth, nominal)
    relative = error / scale
    squared = relative * relative
    outside = ~(np.abs(relative) <= SETTLED)[:, origin:]
    settling = np.array([last_outside(row) for row in outside], dtype=np.float64)
    never = settling >= outside.shape[1]
    claimed = finite & (deviation > 0.0) & np.isfinite(deviation)
    last = np.abs(relative[:, -1])
    constant = np.array([nominal[name] for name in beliefs.names])
    of_nominal = np.abs(constant - truth[:, -1]) / scale[:, -1]
    diverged = ~np.isfinite(value[:, -1]) | ((last > DIVERGED) & (last > of_nominal))
    normalised = (error / np.where(claimed, deviation, 1.0)) ** 2
    inside = (np.abs(error) <= 3.0 * deviation).astype(np.float64)
    return {
        "relative_rmse": np.sqrt(_mean(squared, finite)),
        "settled_relative_rmse": np.sqrt(_mean(squared[:, settled:], finite[:, settled:])),
        "final_relative_error": relative[:, -1],
        "settling_time": np.where(never, np.inf, settling),
        "settled": np.where(outside.shape[1] > 0, (~never).astype(np.float64), np.nan),
        "nees": _mean(normalised, claimed),
        "in_three_sigma": inside.mean(axis=-1),
        "nees_apart": _mean(normalised, claimed & apart),
        "in_three_sigma_apart": _mean(inside, np.broadcast_to(apart, inside.shape)),
        "claimed_deviation": np.median(deviation / scale, axis=-1),
        "excited": np.where(beliefs.reports_excitation, excited.mean(axis=-1), np.nan),
        "diverged": diverged.astype(np.float64),
    }


# Metrics of which a summary has the median over the episodes (of the final error, of its magnitude;
# of the settling time inf when most episodes never settle); of the others it has the mean.
MEDIANS = {"relative_rmse", "settled_relative_rmse", "final_relative_error"}
MEDIANS |= {"settling_time", "claimed_deviation"}


def summarise(records: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """{parameter: {metric: number}} of one policy on one set, and `episodes`; empty when it
    estimates nothing. NaN where records lack a metric."""
    summary: dict[str, dict[str, float]] = {}
    for name in dict.fromkeys(name for r in records for name in r.get("identification", {})):
        of_records = (record.get("identification", {}) for record in records)
        estimates = [of[name] for of in of_records if name in of]
        rows = {
            metric: np.array([of.get(metric) for of in estimates], dtype=np.float64)
            for metric in ESTIMATION_METRICS
        }
        rows["final_relative_error"] = np.abs(rows["final_relative_error"])
        rows["settling_time"][rows["settled"] == 0.0] = np.inf
        summary[name] = {"episodes": len(estimates)}
        for metric, column in rows.items():
            values = column[~np.isnan(column)]
            centre = np.median if metric in MEDIANS else np.mean
            summary[name][metric] = float(centre(values)) if values.size else np.nan
    return summary


def mean_nis(records: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Mean normalised innovation squared of one policy on one set, by filter."""
    nis = [record.get("nis", {}) for record in records]
    summary = {}
    for name in dict.fromkeys(name for of in nis for name in of):
        values = [of[name] for of in nis if of.get(name) is not None]
        summary[name] = float(np.mean(values)) if values else np.nan
    return summary
