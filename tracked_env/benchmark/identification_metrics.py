"""Accuracy of the estimates of a policy: metrics from its estimates and the true values.

Row k of its beliefs (`benchmark.beliefs`) has the estimate x_k, its standard deviation sigma_k and
the true value p_k. With the scale P_k = max(|p_k|, 1 % of the nominal value), 1 for the slips, and
the K rows of the time driven:
    relative error       r_k = (x_k - p_k) / P_k
    relative RMSE        sqrt(mean r_k^2), over all rows and over those after SETTLING_TIME
    settling time        smallest tau >= 0 with |r_k| <= SETTLED for all rows from t_0 + tau on,
                         t_0 the time of the first row after the last abrupt change of the episode
                         (0 when there is none); none = never
    NEES                 mean ((x_k - p_k) / sigma_k)^2 over the rows with sigma_k > 0; 1 expected
    in three sigma       part of the rows with |x_k - p_k| <= 3 sigma_k; 0.997 expected
    ... apart            the same without the rows from an abrupt change until APART after it
    claimed deviation    median of sigma_k / P_k
    diverged             the last estimate is not finite, or |r| > DIVERGED and |r| is larger than
                         that of the nominal value
Rows whose estimate is not finite count as outside every band, and not in the RMSE.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.metrics import SLIPS, Beliefs, Metric, Trace, last_outside, settled_step
from tracked_env.physics.lumped import drive_limits
from tracked_env.physics.parameters import VEHICLES, PlantParameters

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
# Metrics that records of earlier versions lack.
LATER = ("nees_apart", "in_three_sigma_apart", "claimed_deviation")


@lru_cache
def nominal_values(nominal: PlantParameters = VEHICLES["strawa"]) -> dict[str, float]:
    """The nominal value of each of KNOWN: the estimate of a policy that identifies nothing."""
    effort = float(drive_limits(nominal).effort_maximum)
    return {**nominal._asdict(), "effort_maximum": effort, **dict.fromkeys(SLIPS, 0.0)}


def scales(
    names: Sequence[str], truth: NDArray[np.float64], known: Mapping[str, float]
) -> NDArray[np.float64]:
    """Scale of a relative error, (P, K): the true value, not too close to 0; 1 in SI units for
    slips and for what is nominally 0.

    known: the nominal values.
    """
    floor = [[LEAST_SCALE * abs(known[name])] for name in names]
    absolute = [[name in SLIPS or known[name] == 0.0] for name in names]
    return np.where(absolute, 1.0, np.maximum(np.abs(truth), floor))


def _mean(values: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Mean over the valid entries of the last axis; NaN where there is none."""
    if valid.size and valid.all():
        return np.asarray(values.mean(axis=-1))
    count = valid.sum(axis=-1)
    total = np.where(valid, values, 0.0).sum(axis=-1)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def optional(value: float) -> float | None:
    """A number as JSON has it; what is not finite (nothing to measure, never) is None."""
    return float(value) if np.isfinite(value) else None


def evaluate(beliefs: Beliefs, trace: Trace) -> list[dict[str, Any]]:
    """Per episode {"identification": {parameter: {metric: number}}, "nis": {filter: mean}}.

    The metrics are those of ESTIMATION_METRICS, None where there is nothing to measure.
    """
    changes = trace.changes()
    known = nominal_values(trace.nominal)
    # Vehicle first and time last: neighbours in memory, and the same sums for every batch.
    parts = (beliefs.value, beliefs.deviation, beliefs.truth, beliefs.excited)
    by_vehicle = [np.ascontiguousarray(part.T) for part in parts]
    results: list[dict[str, Any]] = []
    for i, steps in enumerate(trace.steps):
        origin = changes[i][-1].last + 1 if changes[i] else 0
        rows = [part[i, :, :steps].astype(np.float64) for part in by_vehicle]
        apart = np.ones(steps, dtype=bool)
        for change in changes[i]:
            apart[change.first : change.last + round(APART / trace.control_period)] = False
        columns = _episode(beliefs, rows, origin, settled_step(trace), known, apart)
        columns["settling_time"] = columns["settling_time"] * trace.control_period
        parameters = {
            name: {metric: optional(column[j]) for metric, column in columns.items()}
            for j, name in enumerate(beliefs.names)
        }
        nis = {}
        for name, values in beliefs.nis.items():
            driven = np.ascontiguousarray(values[:steps, i], dtype=np.float64)
            nis[name] = optional(float(_mean(driven, np.isfinite(driven))))
        results.append({"identification": parameters, "nis": nis})
    return results


def _episode(
    beliefs: Beliefs,
    rows: Sequence[NDArray[np.float64]],
    origin: int,
    settled: int,
    known: Mapping[str, float],
    apart: NDArray[np.bool_],
) -> dict[str, NDArray[np.float64]]:
    """Every metric of one episode, (P,) each; the settling time in rows.

    rows: value, deviation, truth and excited, each (P, K); origin: first row after the last change;
    known: the nominal values. apart (K,): rows that are not shortly after an abrupt change.
    """
    value, deviation, truth, excited = rows
    finite = np.isfinite(value) & np.isfinite(truth)
    error = np.where(finite, value - np.where(finite, truth, 0.0), np.nan)
    scale = scales(beliefs.names, truth, known)
    relative = error / scale
    squared = relative * relative
    outside = ~(np.abs(relative) <= SETTLED)[:, origin:]
    settling = np.array([last_outside(row) for row in outside], dtype=np.float64)
    never = settling >= outside.shape[1]
    claimed = finite & (deviation > 0.0) & np.isfinite(deviation)
    nominal = np.array([known[name] for name in beliefs.names])
    last = np.abs(relative[:, -1])
    others = np.abs(nominal - truth[:, -1]) / scale[:, -1]
    seen = outside.shape[1] > 0
    normalised = (error / np.where(claimed, deviation, 1.0)) ** 2
    inside = (np.abs(error) <= 3.0 * deviation).astype(np.float64)
    every = np.broadcast_to(apart, inside.shape)
    return {
        "relative_rmse": np.sqrt(_mean(squared, finite)),
        "settled_relative_rmse": np.sqrt(_mean(squared[:, settled:], finite[:, settled:])),
        "final_relative_error": relative[:, -1],
        "settling_time": np.where(never, np.inf, settling),
        "settled": np.where(seen, (~never).astype(np.float64), np.nan),
        "nees": _mean(normalised, claimed),
        "in_three_sigma": inside.mean(axis=-1),
        "nees_apart": _mean(normalised, claimed & apart),
        "in_three_sigma_apart": _mean(inside, every),
        "claimed_deviation": np.median(deviation / scale, axis=-1),
        "excited": np.where(beliefs.reports_excitation, excited.mean(axis=-1), np.nan),
        "diverged": (~np.isfinite(value[:, -1]) | ((last > DIVERGED) & (last > others))).astype(
            np.float64
        ),
    }


class IdentificationSummary(NamedTuple):
    """One parameter as one policy estimates it on one set."""

    episodes: int
    relative_rmse: float  # [-] median over the episodes
    settled_relative_rmse: float  # [-] median
    final_relative_error: float  # [-] median of the magnitude
    settling_time: float  # [s] median, inf when most episodes never settle
    settled: float  # [-] share of the episodes
    nees: float  # [-] mean
    in_three_sigma: float  # [-] mean
    nees_apart: float  # [-] mean, NaN where records lack it, as the next two
    in_three_sigma_apart: float  # [-] mean
    claimed_deviation: float  # [-] median
    excited: float  # [-] mean, NaN when the policy does not say
    diverged: float  # [-] share of the episodes


def summarise(records: Sequence[Mapping[str, Any]]) -> dict[str, IdentificationSummary]:
    """Summary of one policy on one set, by parameter; empty when it estimates nothing."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for record in records:
        for name, values in record.get("identification", {}).items():
            found.setdefault(name, []).append(values)
    return {name: _summary(rows) for name, rows in found.items()}


def _summary(rows: Sequence[Mapping[str, Any]]) -> IdentificationSummary:
    columns = {
        metric: np.array([row.get(metric) for row in rows], dtype=np.float64)
        for metric in ESTIMATION_METRICS
    }
    columns["final_relative_error"] = np.abs(columns["final_relative_error"])
    columns["settling_time"][columns["settled"] == 0.0] = np.inf
    median = (
        "relative_rmse", "settled_relative_rmse", "final_relative_error", "settling_time",
        "claimed_deviation",
    )  # fmt: skip
    values = {}
    for metric, column in columns.items():
        known = column[~np.isnan(column)]
        centre = np.median if metric in median else np.mean
        values[metric] = float(centre(known)) if known.size else np.nan
    return IdentificationSummary(len(rows), **values)


def mean_nis(records: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Mean normalised innovation squared of one policy on one set, by filter."""
    found: dict[str, list[float]] = {}
    for record in records:
        for name, value in record.get("nis", {}).items():
            found.setdefault(name, []).extend([] if value is None else [value])
    return {name: float(np.mean(values)) if values else np.nan for name, values in found.items()}
