"""The slip of a vehicle fitted to its runs: outliers out, a table for controllers, R^2 on runs that
the fit has not seen.

The surfaces are those of `baselines.slip`: thin plate splines through beta_left, beta_right and
v_y over both sprocket speeds, then a table. Held out are whole runs, in FOLDS parts, each of which
is predicted by the fit of the others. An outlier is a sample whose held-out error is beyond GATE
robust deviations and beyond what a surface leaves anyway; the worst are taken out first, and the
rest is fitted again.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from tracked_env.benchmark.registered_policies import command_function
from tracked_env.cli.user_data.csv_columns import Floats
from tracked_env.cli.user_data.slip_runs import Refused, Runs
from tracked_env.physics.parameters import PlantParameters

LEAST_RUNS = 12
FOLDS = 5
NODES = 120  # of the grid along the wider side, at most
FINEST = 0.1  # [rad/s] between them at least
GATE = 6.0  # [-] robust deviations
ALWAYS = 0.02  # [m/s] no smaller error makes an outlier
ROUNDS = 12
BORDER = 1.5  # [-] on the limit of samples at the border of the speeds driven
CHANNELS = ("beta_left", "beta_right", "v_y")


class Fitted(NamedTuple):
    """A model and how good it is."""

    model: Any  # TableSlipModel of baselines.slip
    data: Any  # SlipData of the samples used
    runs: Runs
    predicted: Floats  # (3, N) beta_left, beta_right, alpha, each sample by a fit without its run
    scores: Any  # Scores: R^2 on those
    outliers: int


def _folds(run: Any) -> Any:
    """(N,) number of the fold of each sample; samples of a run share theirs."""
    names, place = np.unique(run, return_inverse=True)
    return (np.random.default_rng(0).permutation(len(names)) % FOLDS)[place]


def _fit(tools: Any, data: Any, vehicle: PlantParameters) -> Any:
    """The table of some samples."""
    reach = max(np.ptp(data.sprocket_left), np.ptp(data.sprocket_right))
    dense, grid = tools.upsample(data, vehicle, max(FINEST, float(reach) / NODES))
    return tools.make_table(dense, grid, vehicle)


def _held_out(tools: Any, data: Any, run: Any, vehicle: PlantParameters) -> Floats:
    """(3, N) predictions of each sample by the fit of the other folds."""
    fold, found = _folds(run), np.empty((3, len(run)))
    for k in range(FOLDS):
        test = fold == k
        if test.any():
            model = _fit(tools, data.rows(~test), vehicle)
            found[:, test] = model.slip(data.sprocket_left[test], data.sprocket_right[test])
    return found


def _enough(runs: Runs) -> None:
    """Raise ValueError for too few runs, or runs along one line."""
    count = len(np.unique(runs.run))
    if count < LEAST_RUNS:
        raise ValueError(
            f"{count} usable runs, {len(runs.refused)} refused; needs {LEAST_RUNS} or more, of "
            "different sprocket speeds: straight, left and right turns at several speeds each. "
            + "; ".join(f"{r.run}: {r.reason}" for r in runs.refused[:3])
        )
    points = np.stack([runs.sprocket_left, runs.sprocket_right], axis=1)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < 0.05 * spread[0]:
        raise ValueError(
            "all runs lie on one line of sprocket speeds; needs straight driving and turns, with "
            "left and right speeds that differ by several amounts. Are both columns the same?"
        )


def fit(runs: Runs, vehicle: PlantParameters) -> Fitted:
    """Fit. Raises ValueError for too few runs."""
    tools: Any = command_function("slip")
    scores = command_function("slip-scores")
    outliers = 0
    for _ in range(ROUNDS):
        _enough(runs)
        data = tools.slip_data(vehicle, runs.sprocket_left, runs.sprocket_right, runs.motion)
        predicted = _held_out(tools, data, runs.run, vehicle)
        found = _outliers(data, predicted)
        if not found.any():
            break
        reasons = [
            Refused(str(runs.run[k]), _reason(data, predicted, k))
            for k in np.flatnonzero(found).tolist()
        ]
        outliers += int(found.sum())
        runs = runs.without(found, reasons)
    else:
        _enough(runs)
        data = tools.slip_data(vehicle, runs.sprocket_left, runs.sprocket_right, runs.motion)
        predicted = _held_out(tools, data, runs.run, vehicle)
    model = _fit(tools, data, vehicle)
    return Fitted(model, data, runs, predicted, scores(predicted, data), outliers)


def _errors(data: Any, predicted: Floats) -> Floats:
    """(3, N) [m/s] beta_left, beta_right, and what the error of alpha moves to the side."""
    side = data.v_x * np.tan(np.clip(predicted[2], -1.5, 1.5))
    return np.stack([data.beta_left - predicted[0], data.beta_right - predicted[1],
                     np.where(np.abs(data.v_x) > ALWAYS, data.v_y - side, 0.0)])  # fmt: skip


def _limits(data: Any, errors: Floats) -> Floats:
    """(3, N) [m/s] beyond which an error is an outlier; it grows with the speed of the belts."""
    speed = np.abs(data.v_x) + np.abs(data.beta_left) + np.abs(data.beta_right)
    size = 0.3 + speed / max(float(np.median(speed)), 1e-6)
    deviation = 1.4826 * np.median(np.abs(errors / size), axis=1, keepdims=True)
    return np.maximum(GATE * deviation * size, ALWAYS)


def _excess(data: Any, predicted: Floats) -> Floats:
    """(N,) largest error of each sample over what makes an outlier.

    At the border of the speeds driven the fit of the others has to extrapolate; more is allowed.
    """
    errors = _errors(data, predicted)
    found = (np.abs(errors) / _limits(data, errors)).max(axis=0)
    found[ConvexHull(np.stack([data.sprocket_left, data.sprocket_right], axis=1)).vertices] /= (
        BORDER
    )
    return np.asarray(found)


def _outliers(data: Any, predicted: Floats) -> Any:
    """(N,) the worst samples beyond the limit: others may be off because a fit followed those."""
    excess = _excess(data, predicted)
    return (excess > 1.0) & (excess > 0.5 * excess.max())


def _reason(data: Any, predicted: Floats, k: int) -> str:
    errors = _errors(data, predicted)
    limits = _limits(data, errors)
    worst = int(np.argmax(np.abs(errors[:, k]) / limits[:, k]))
    return (
        f"outlier: {CHANNELS[worst]} is {errors[worst, k]:+.3f} m/s off what runs of similar "
        f"speeds say, {GATE * abs(errors[worst, k]) / limits[worst, k]:.0f} robust deviations"
    )
