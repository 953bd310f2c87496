"""Steady runs that contradict both belts: a hull frame turned round, sides swapped, a dead encoder.

With the belts' mean m and half their difference d [m/s], a vehicle that is the same to the left and
right, front and back, obeys
    v_x = sgn(m) f(|m|, |d|),  w B/2 = sgn(d) h(|m|, |d|),  v_y = sgn(m d) g(|m|, |d|)
so that all runs lie on three surfaces over a quarter of the belt speeds, and a corrupt one beside
them, where a mirror image of another drive belongs: with the hull frame turned by 180 degrees v_x
and v_y have the other sign, with sides swapped w and v_y, with the sign of yaw reversed w. Sliding
friction knows directions and no speeds, so to first order the surfaces are of degree one:
    f = |m| (1, q, q^2, s) c_f,  h = |d| (..) c_h,  g = sqrt(|m d|) (..) c_g,
    q = |d| / (|m| + |d|),  s = (|m| + |d|) / its median
Tracks with unlike grip, or a load off the middle, add the terms d to v_x, m to w B/2, d to v_y.
The coefficients minimise the sum of absolute errors, which a minority of corrupt runs hardly moves;
the surfaces that are fitted to the slip afterwards have no part in it. With D the robust deviations
by which a run is beside the surfaces (D^2 is summed over its samples), and D' those with a fault of
a kind put right, the logarithm of the likelihood ratio is (D^2 - D'^2) / 2. A run is corrupt where
it is above CERTAIN and D > NEARER D', or above LIKELIER and that kind occurs SEVERAL times.

The slip of a vehicle fitted to its runs: corrupt ones out, a table, R^2 on runs not seen.

The surfaces are those of `baselines.slip`: thin plate splines through beta_left, beta_right and
v_y over both sprocket speeds, then a table. Held out are whole runs, in FOLDS parts, each of which
is predicted by the fit of the others. What `corrupt_runs` finds is left out before, and R^2 is told
of all runs as well; how well a run is fitted has no influence.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.identify.csv_log import Floats
from baselines.identify.slip_runs import Refused, Runs
from tracked_env.benchmark.policies import command_function
from tracked_env.physics.parameters import PlantParameters

CERTAIN = 18.0  # [-] logarithm of a likelihood ratio: 6 deviations that a fault explains wholly
LIKELIER = 7.0  # [-] the same, of a kind of which there are several
SEVERAL = 3  # [-] runs
NEARER = 2.0  # [-]
UNLIKE = 10.0  # [-] robust deviations of a run that no kind explains
UNLIKE_SHARE = 0.4  # [-] of the belt speed, which its error has to exceed as well
STANDS = 1e-3  # [-] of the fastest belt: an encoder that shows less may be dead
SPEEDS = 41  # that a belt may have had whose encoder is dead
ROUNDS = 60  # of the reweighted least squares
TINY = 1e-4  # [-] of the residuals, whose weight grows no further
# Signs of v_x, w, v_y in the measured run where they are those of the true one under a fault.
KINDS = {
    "turned": ((-1.0, 1.0, -1.0), "as if its hull frame were turned by 180 degrees"),
    "swapped": ((1.0, -1.0, -1.0), "as if left and right were swapped"),
    "yaw": ((1.0, -1.0, 1.0), "as if the sign of its yaw were another"),
}


def _belts(left: Floats, right: Floats, radius: float) -> tuple[Floats, Floats]:
    return 0.5 * radius * (left + right), 0.5 * radius * (right - left)


def _forms(mean: Floats, half: Floats, median: float) -> tuple[Floats, Floats]:
    """Regressors (3, N, 5) of v_x, w B/2, v_y, and the sum |m| + |d| (N,) [m/s]."""
    total = np.abs(mean) + np.abs(half)
    q = np.abs(half) / np.maximum(total, 1e-12)
    shape = np.stack([np.ones_like(q), q, q * q, total / median], axis=1)
    product = mean * half
    sizes = (mean, half, np.sign(product) * np.sqrt(np.abs(product)))
    others = (half, mean, half)
    rows = [np.column_stack([a[:, None] * shape, b]) for a, b in zip(sizes, others, strict=True)]
    return np.stack(rows), total


def _least_absolute(rows: Floats, values: Floats) -> Floats:
    """Coefficients c that minimise sum |rows c - values|, by reweighted least squares."""
    found: Floats = np.zeros(rows.shape[1])
    weights = np.ones(len(values))
    scale = float(np.abs(values).max()) or 1.0
    for _ in range(ROUNDS):
        solved = np.linalg.lstsq(weights[:, None] * rows, weights * values, rcond=None)[0]
        found = np.asarray(solved, dtype=np.float64)
        weights = 1.0 / np.sqrt(np.maximum(np.abs(rows @ found - values), TINY * scale))
    return found


class _Surfaces:
    """The three surfaces, and how far runs are beside them."""

    def __init__(self, mean: Floats, half: Floats, measured: Floats) -> None:
        self.median = max(float(np.median(np.abs(mean) + np.abs(half))), 1e-9)
        rows, total = _forms(mean, half, self.median)
        self.coefficients = np.stack(
            [_least_absolute(r, v) for r, v in zip(rows, measured, strict=True)]
        )
        errors = np.abs(self.predicted(mean, half) - measured) / self._size(total)
        # As many runs as coefficients lie on a surface of least absolute errors: they say nothing.
        errors = np.sort(errors, axis=1)[:, self.coefficients.shape[1] :]
        self.deviation = np.maximum(1.4826 * np.median(errors, axis=1), 1e-3 * self.median)

    def _size(self, total: Floats) -> Floats:
        """(N,) how errors grow with the belts' speed: not below its median, where noise remains."""
        return np.maximum(total / self.median, 1.0)

    def predicted(self, mean: Floats, half: Floats) -> Floats:
        """(3, N) v_x, w B/2, v_y [m/s]."""
        rows, _ = _forms(mean, half, self.median)
        return np.einsum("cnk,ck->cn", rows, self.coefficients)

    def beside(self, mean: Floats, half: Floats, measured: Floats) -> Floats:
        """(N,) robust deviations by which measured v_x, w B/2, v_y (3, N) are beside them."""
        total = np.abs(mean) + np.abs(half)
        errors = (self.predicted(mean, half) - measured) / self.deviation[:, None]
        return np.sqrt((errors * errors).sum(axis=0)) / self._size(total)


def _alternatives(
    surfaces: _Surfaces, left: Floats, right: Floats, measured: Floats, radius: float
) -> Iterator[tuple[str, Floats, NDArray[np.bool_]]]:
    """Of each kind: its words, how far beside the surfaces runs are without it, and which may."""
    mean, half = _belts(left, right, radius)
    everywhere = np.ones(len(left), dtype=np.bool_)
    for signs, words in KINDS.values():
        yield words, surfaces.beside(mean, half, np.array(signs)[:, None] * measured), everywhere
    fastest = max(np.abs(left).max(), np.abs(right).max())
    for side, belt in (("left", left), ("right", right)):
        nearest = np.full(len(left), np.inf)
        for speed in np.linspace(-fastest, fastest, SPEEDS):
            other = np.full(len(belt), speed)
            pair = (other, right) if side == "left" else (left, other)
            mean, half = _belts(pair[0], pair[1], radius)
            nearest = np.minimum(nearest, surfaces.beside(mean, half, measured))
        yield f"as if its {side} encoder were dead", nearest, np.abs(belt) <= STANDS * fastest


def corrupt(runs: Runs, vehicle: PlantParameters) -> dict[int, str]:
    """The number of each sample of a corrupt run, and why it is one.

    Raises ValueError where most runs contradict their belts.
    """
    left, right, motion = runs.sprocket_left, runs.sprocket_right, runs.motion
    mean, half = _belts(left, right, vehicle.sprocket_radius)
    measured = np.stack([motion[:, 0], 0.5 * vehicle.track_gauge * motion[:, 2], motion[:, 1]])
    surfaces = _Surfaces(mean, half, measured)
    _check_most(surfaces, mean, half)
    beside = surfaces.beside(mean, half, measured)
    _, run = np.unique(runs.run, return_inverse=True)
    square = np.bincount(run, beside**2)
    found: dict[int, str] = {}
    for words, without, possible in _alternatives(
        surfaces, left, right, measured, vehicle.sprocket_radius
    ):
        explained = np.bincount(run, without**2)
        likelier = 0.5 * (square - explained) * (np.bincount(run, ~possible) == 0)
        clear = (likelier > CERTAIN) & (square > NEARER**2 * explained)
        if clear.sum() >= SEVERAL:
            clear = likelier > LIKELIER
        for k in np.flatnonzero(clear[run]).tolist():
            found.setdefault(k, f"moves {words}: {_moves(mean, half, measured, k)}")
    error = np.abs(surfaces.predicted(mean, half) - measured).max(axis=0)
    gross = (beside > UNLIKE) & (error > UNLIKE_SHARE * (np.abs(mean) + np.abs(half)))
    for k in np.flatnonzero(gross).tolist():
        found.setdefault(k, f"moves unlike all others: {_moves(mean, half, measured, k)}")
    return dict(sorted(found.items()))


def _check_most(surfaces: _Surfaces, mean: Floats, half: Floats) -> None:
    """Raise ValueError where v_x or w have the wrong sign in most runs."""
    forward, turning, _ = surfaces.predicted(mean, half)
    if np.median(np.sign(mean) * forward) < 0.0:
        raise ValueError(
            "most runs go backward where their belts run forward: is the hull frame turned by 180 "
            "degrees, or do both sprocket speeds have another sign?"
        )
    if np.median(np.sign(half) * turning) < 0.0:
        raise ValueError(
            "most runs turn right where the right belt is the faster one: are left and right "
            "swapped, or is yaw positive to the right?"
        )


def _moves(mean: Floats, half: Floats, measured: Floats, k: int) -> str:
    return (
        f"belts at {mean[k] - half[k]:.3g} and {mean[k] + half[k]:.3g} m/s, tracks at "
        f"{measured[0, k] - measured[1, k]:.3g} and {measured[0, k] + measured[1, k]:.3g} m/s, "
        f"v_y {measured[2, k]:.3g} m/s"
    )


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
