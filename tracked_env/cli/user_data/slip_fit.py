"""The slip of a vehicle fitted to its runs: corrupt ones out, a table, R^2 on runs not seen.

The surfaces are those of `baselines.slip`: thin plate splines through beta_left, beta_right and
v_y over both sprocket speeds, then a table. Held out are whole runs, in FOLDS parts, each of which
is predicted by the fit of the others. What `corrupt_runs` finds is left out before, and R^2 is told
of all runs as well; how well a run is fitted has no influence.
"""

from typing import Any, NamedTuple

import numpy as np

from tracked_env.benchmark.registered_policies import command_function
from tracked_env.cli.user_data.corrupt_runs import corrupt
from tracked_env.cli.user_data.csv_columns import Floats
from tracked_env.cli.user_data.slip_runs import Refused, Runs
from tracked_env.physics.parameters import PlantParameters

LEAST_RUNS = 12
FOLDS = 5
NODES = 120  # of the grid along the wider side, at most
FINEST = 0.1  # [rad/s] between them at least


class Fitted(NamedTuple):
    """A model and how good it is."""

    model: Any  # TableSlipModel of baselines.slip
    data: Any  # SlipData of the samples used
    runs: Runs
    predicted: Floats  # (3, N) beta_left, beta_right, alpha, each sample by a fit without its run
    scores: Any  # Scores: R^2 on those
    outliers: int  # samples that `corrupt_runs` found, left out
    scores_of_all: Any  # Scores with these among those fitted and predicted


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
    """Fit. Raises ValueError for too few runs, and for runs that contradict their belts."""
    tools: Any = command_function("slip")
    scores = command_function("slip-scores")

    def held_out(part: Runs) -> tuple[Any, Floats]:
        data = tools.slip_data(vehicle, part.sprocket_left, part.sprocket_right, part.motion)
        return data, _held_out(tools, data, part.run, vehicle)

    _enough(runs)
    reasons = corrupt(runs, vehicle)
    data, predicted = held_out(runs)
    scores_of_all = scores(predicted, data)
    if reasons:
        marked = np.zeros(len(runs.run), dtype=bool)
        marked[[*reasons]] = True
        runs = runs.without(marked, [Refused(str(runs.run[k]), of) for k, of in reasons.items()])
        _enough(runs)
        data, predicted = held_out(runs)
    model = _fit(tools, data, vehicle)
    return Fitted(
        model, data, runs, predicted, scores(predicted, data), len(reasons), scores_of_all
    )
