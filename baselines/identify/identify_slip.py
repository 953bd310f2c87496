"""The slip of a vehicle fitted to its runs: corrupt ones out, a table, R^2 on runs not seen.

Steady runs are corrupt that contradict both belts: a hull frame turned round, sides swapped, a dead
encoder. With the belts' mean m and half their difference d [m/s], a vehicle that is the same to the
left and right, front and back, obeys
    v_x = sgn(m) f(|m|, |d|),  w B/2 = sgn(d) h(|m|, |d|),  v_y = sgn(m d) g(|m|, |d|)
so that all runs lie on three surfaces over a quarter of the belt speeds, and a corrupt one beside
them, where a mirror image of another drive belongs: with the hull frame turned by 180 degrees v_x
and v_y have the other sign, with sides swapped w and v_y, with the sign of yaw reversed w. Sliding
friction knows directions and no speeds, so to first order the surfaces are of degree one:
    f = |m| (1, q, q^2, s) c_f,  h = |d| (..) c_h,  g = sqrt(|m d|) (..) c_g,
    q = |d| / (|m| + |d|),  s = (|m| + |d|) / its median
Tracks with unlike grip, or a load off the middle, add the terms d to v_x, m to w B/2, d to v_y.
The coefficients minimise the sum of absolute errors, which a minority of corrupt runs hardly moves.
With D the robust deviations by which a run is beside the surfaces (D^2 is summed over its samples),
and D' those with a fault of a kind put right, the logarithm of the likelihood ratio is
(D^2 - D'^2) / 2. A run is corrupt where it is above CERTAIN and D > NEARER D', or above LIKELIER
and that kind occurs SEVERAL times.

The slip that is fitted afterwards is that of `baselines.slip`: thin plate splines through both slip
velocities and v_y over both sprocket speeds, then a table. Held out are whole runs, in FOLDS parts,
each of which is predicted by the fit of the others; how well a run is fitted has no influence on
whether it is left out.

The vehicle that explains the slip best is that of `--vehicle` with the friction mu at which the
slip of the distributed plant is nearest to the measured slip velocities, by least squares.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.identify.csv_log import Floats
from baselines.identify.slip_runs import Runs
from baselines.slip.slip_models import TableSlipModel
from baselines.slip.slip_regression import Scores, determination, scores
from baselines.slip.slip_sweep import (
    FRICTIONS,
    SlipData,
    make_table,
    slip_data,
    slip_family,
    upsample,
    with_friction,
)
from tracked_env.physics.parameters import PlantParameters
from tracked_env.vehicles import vehicle_toml

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
    "as if its hull frame were turned by 180 degrees": (-1.0, 1.0, -1.0),
    "as if left and right were swapped": (1.0, -1.0, -1.0),
    "as if the sign of its yaw were another": (1.0, -1.0, 1.0),
}
LEAST_RUNS = 12
EXPLAINED = 0.5  # [-] R^2 of the slip velocities from which on the friction is determined
TRIED = 400  # values of mu between the least and the largest of FRICTIONS, 0.7 % apart
FOLDS = 5
NODES = 120  # of the grid along the wider side, at most
FINEST = 0.1  # [rad/s] between them at least


# --- corrupt runs ---------------------------------------------------------------------------


def _belts(left: Floats, right: Floats, radius: float) -> tuple[Floats, Floats]:
    """Mean and half the difference [m/s] of belts at sprocket speeds [rad/s]."""
    return 0.5 * radius * (left + right), 0.5 * radius * (right - left)


def _least_absolute(rows: Floats, values: Floats) -> Floats:
    """Coefficients c that minimise sum |rows c - values|, by reweighted least squares."""
    coefficients: Floats = np.zeros(rows.shape[1])
    weights = np.ones(len(values))
    scale = float(np.abs(values).max()) or 1.0
    for _ in range(ROUNDS):
        solution = np.linalg.lstsq(weights[:, None] * rows, weights * values, rcond=None)[0]
        coefficients = np.asarray(solution, dtype=np.float64)
        errors = np.abs(rows @ coefficients - values)
        weights = 1.0 / np.sqrt(np.maximum(errors, TINY * scale))
    return coefficients


class _Surfaces:
    """The three surfaces, and how far runs are beside them; mean, half: see `_belts`."""

    def __init__(self, mean: Floats, half: Floats, measured: Floats) -> None:
        total = np.abs(mean) + np.abs(half)
        self.median = max(float(np.median(total)), 1e-9)
        forms = zip(self._forms(mean, half), measured, strict=True)
        self.coefficients = np.stack([_least_absolute(rows, values) for rows, values in forms])
        errors = np.abs(self.predicted(mean, half) - measured) / self._size(total)
        # As many runs as coefficients lie on a surface of least absolute errors: they say nothing.
        errors = np.sort(errors, axis=1)[:, self.coefficients.shape[1] :]
        self.deviation = np.maximum(1.4826 * np.median(errors, axis=1), 1e-3 * self.median)

    def _forms(self, mean: Floats, half: Floats) -> Floats:
        """Regressors (3, N, 5) of v_x, w B/2, v_y."""
        total = np.abs(mean) + np.abs(half)
        q = np.abs(half) / np.maximum(total, 1e-12)
        shape = np.stack([np.ones_like(q), q, q * q, total / self.median], axis=1)
        product = mean * half
        both = np.sign(product) * np.sqrt(np.abs(product))
        pairs = ((mean, half), (half, mean), (both, half))
        return np.stack([np.column_stack([a[:, None] * shape, b]) for a, b in pairs])

    def _size(self, total: Floats) -> Floats:
        """(N,) how errors grow with the belts' speed: not below its median, where noise remains."""
        return np.maximum(total / self.median, 1.0)

    def predicted(self, mean: Floats, half: Floats) -> Floats:
        """(3, N) v_x, w B/2, v_y [m/s]."""
        return np.einsum("cnk,ck->cn", self._forms(mean, half), self.coefficients)

    def beside(self, mean: Floats, half: Floats, measured: Floats) -> Floats:
        """(N,) robust deviations by which measured v_x, w B/2, v_y (3, N) are beside them."""
        errors = (self.predicted(mean, half) - measured) / self.deviation[:, None]
        return np.sqrt((errors * errors).sum(axis=0)) / self._size(np.abs(mean) + np.abs(half))


def _alternatives(
    surfaces: _Surfaces, runs: Runs, measured: Floats, radius: float
) -> Iterator[tuple[str, Floats, NDArray[np.bool_]]]:
    """Of each kind: its words, how far beside the surfaces runs are without it, and which may."""
    left, right = runs.sprocket_left, runs.sprocket_right
    for words, signs in KINDS.items():
        corrected = np.array(signs)[:, None] * measured
        beside = surfaces.beside(*_belts(left, right, radius), corrected)
        yield words, beside, np.ones(len(left), dtype=np.bool_)
    fastest = max(np.abs(left).max(), np.abs(right).max())
    for side, belt in (("left", left), ("right", right)):
        nearest = np.full(len(left), np.inf)
        for speed in np.linspace(-fastest, fastest, SPEEDS):
            other = np.full(len(belt), speed)
            one, two = (other, right) if side == "left" else (left, other)
            nearest = np.minimum(nearest, surfaces.beside(*_belts(one, two, radius), measured))
        yield f"as if its {side} encoder were dead", nearest, np.abs(belt) <= STANDS * fastest


def corrupt(runs: Runs, vehicle: PlantParameters) -> dict[int, str]:
    """The number of each sample of a corrupt run, and why it is one.

    Raises ValueError where most runs contradict their belts.
    """
    motion, radius = runs.motion, vehicle.sprocket_radius
    mean, half = _belts(runs.sprocket_left, runs.sprocket_right, radius)
    measured = np.stack([motion[:, 0], 0.5 * vehicle.track_gauge * motion[:, 2], motion[:, 1]])
    surfaces = _Surfaces(mean, half, measured)
    predicted = surfaces.predicted(mean, half)
    if np.median(np.sign(mean) * predicted[0]) < 0.0:
        raise ValueError(
            "most runs go backward where their belts run forward: is the hull frame turned by 180 "
            "degrees, or do both sprocket speeds have another sign?"
        )
    if np.median(np.sign(half) * predicted[1]) < 0.0:
        raise ValueError(
            "most runs turn right where the right belt is the faster one: are left and right "
            "swapped, or is yaw positive to the right?"
        )
    beside = surfaces.beside(mean, half, measured)
    _, run = np.unique(runs.run, return_inverse=True)
    square = np.bincount(run, beside**2)
    reasons: dict[int, str] = {}
    for words, without, possible in _alternatives(surfaces, runs, measured, radius):
        explained = np.bincount(run, without**2)
        likelier = 0.5 * (square - explained) * (np.bincount(run, ~possible) == 0)
        clear = (likelier > CERTAIN) & (square > NEARER**2 * explained)
        if clear.sum() >= SEVERAL:
            clear = likelier > LIKELIER
        for k in np.flatnonzero(clear[run]).tolist():
            reasons.setdefault(k, words)
    error = np.abs(predicted - measured).max(axis=0)
    gross = (beside > UNLIKE) & (error > UNLIKE_SHARE * (np.abs(mean) + np.abs(half)))
    for k in np.flatnonzero(gross).tolist():
        reasons.setdefault(k, "unlike all others")
    speeds = (mean - half, mean + half, measured[0] - measured[1], measured[0] + measured[1])
    table = np.stack([*speeds, measured[2]], axis=1)
    text = (
        "moves {}: belts at {:.3g} and {:.3g} m/s, tracks at {:.3g} and {:.3g} m/s, v_y {:.3g} m/s"
    )
    return {k: text.format(reasons[k], *table[k]) for k in sorted(reasons)}


# --- the fit --------------------------------------------------------------------------------


class Fitted(NamedTuple):
    """A model and how good it is."""

    model: TableSlipModel
    data: SlipData  # the samples used
    runs: Runs
    predicted: Floats  # (3, N) beta_left, beta_right, alpha, each sample by a fit without its run
    scores: Scores  # R^2 on those
    outliers: int  # samples of corrupt runs, left out
    scores_of_all: Scores  # with these among those fitted and predicted


def _fit(data: SlipData, vehicle: PlantParameters) -> TableSlipModel:
    """The table of some samples."""
    reach = max(np.ptp(data.sprocket_left), np.ptp(data.sprocket_right))
    dense, grid = upsample(data, vehicle, max(FINEST, float(reach) / NODES))
    return make_table(dense, grid, vehicle)


def _predicted(runs: Runs, vehicle: PlantParameters) -> tuple[SlipData, Floats]:
    """The samples, and (3, N) predictions of each by the fit of the other folds.

    Raises ValueError for too few runs, or runs along one line.
    """
    names, place = np.unique(runs.run, return_inverse=True)
    if len(names) < LEAST_RUNS:
        raise ValueError(
            f"{len(names)} usable runs, {len(runs.refused)} refused; needs {LEAST_RUNS} or more, "
            "of different sprocket speeds: straight, left and right turns at several speeds each. "
            + "; ".join(f"{r.run}: {r.reason}" for r in runs.refused[:3])
        )
    points = np.stack([runs.sprocket_left, runs.sprocket_right], axis=1)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < 0.05 * spread[0]:
        raise ValueError(
            "all runs lie on one line of sprocket speeds; needs straight driving and turns, with "
            "left and right speeds that differ by several amounts. Are both columns the same?"
        )
    data = slip_data(vehicle, runs.sprocket_left, runs.sprocket_right, runs.motion)
    fold = (np.random.default_rng(0).permutation(len(names)) % FOLDS)[place]  # runs stay whole
    predicted = np.empty((3, len(fold)))
    for k in range(FOLDS):
        test = fold == k
        if test.any():
            model = _fit(data.rows(~test), vehicle)
            predicted[:, test] = model.slip(data.sprocket_left[test], data.sprocket_right[test])
    return data, predicted


def fit(runs: Runs, vehicle: PlantParameters) -> Fitted:
    """Fit. Raises ValueError for too few runs, and for runs that contradict their belts."""
    data, predicted = _predicted(runs, vehicle)
    reasons, scores_of_all = corrupt(runs, vehicle), scores(predicted, data)
    if reasons:
        runs = runs.without(reasons)
        data, predicted = _predicted(runs, vehicle)
    fitted = _fit(data, vehicle), data, runs, predicted, scores(predicted, data)
    return Fitted(*fitted, len(reasons), scores_of_all)


class Friction(NamedTuple):
    """The soil on which the distributed plant slips as measured."""

    value: float  # [-] mu
    explained: float  # [-] R^2 of both slip velocities

    @property
    def determined(self) -> bool:
        """Whether it explains the slip."""
        return self.explained > EXPLAINED

    @property
    def text(self) -> str:
        """What is known of it, a sentence."""
        what = f"R^2 of both slip velocities {self.explained:.3f}"
        if self.determined:
            return f"Friction mu = {self.value:.3g}, at which the distributed plant has {what}."
        return (
            f"The friction is not determined: at the best value, {self.value:.3g}, {what}. Are "
            "geometry and weight those of --vehicle, and did the tracks slip?"
        )


def friction(fitted: Fitted, vehicle: PlantParameters) -> Friction:
    """The friction of least squares over those of FRICTIONS."""
    data, family = fitted.data, slip_family(vehicle)
    measured = np.concatenate([data.beta_left, data.beta_right])
    values = np.geomspace(FRICTIONS[0], FRICTIONS[-1], TRIED)

    def predicted(mu: float) -> Floats:
        return np.concatenate(family.slip(data.sprocket_left, data.sprocket_right, mu)[:2])

    best = min(values, key=lambda mu: float(np.sum((predicted(mu) - measured) ** 2)))
    return Friction(float(best), determination(measured, predicted(best)))


def vehicle_file(vehicle: PlantParameters, found: Friction) -> str:
    """The vehicle on the soil of its runs as a TOML file; on its own where that is not known."""
    if not found.determined:
        return vehicle_toml(vehicle._asdict())
    note = f"mu = {found.value:.3g}, of the slip"
    notes = {"cohesion": note, "friction_angle": note}
    return vehicle_toml(with_friction(vehicle, found.value)._asdict(), notes)


def score_rows(fitted: Fitted) -> list[list[str]]:
    """Rows of cells, the header first: R^2 and errors on runs not seen.

    Where runs were left out as corrupt, R^2 with them stands beside the one without.
    """
    data, (left, right, alpha) = fitted.data, fitted.predicted
    rows = [["quantity", "unit", "samples", "R^2, runs not seen", "rms error", "largest slip"]]
    if fitted.outliers:
        rows[0].insert(4, "with those left out")
    every = np.ones(len(left), dtype=bool)
    parts = (
        ("beta_left", "m/s", data.beta_left, left, every),
        ("beta_right", "m/s", data.beta_right, right, every),
        ("alpha, forward", "rad", data.alpha, alpha, data.v_x > 0.05),
        ("alpha, in reverse", "rad", data.alpha, alpha, data.v_x < -0.05),
    )
    both = zip(fitted.scores, fitted.scores_of_all, parts, strict=True)
    for score, of_all, (label, unit, true, predicted, use) in both:
        with_all = [_score(of_all)] if fitted.outliers else []
        cells = ["0", "-", *with_all, "-", "-"]
        if use.any():
            error = np.sqrt(np.mean((true[use] - predicted[use]) ** 2))
            largest = f"{np.abs(true[use]).max():.3f}"
            cells = [f"{use.sum()}", _score(score), *with_all, f"{error:.4f}", largest]
        rows.append([label, unit, *cells])
    return rows


def _score(score: float) -> str:
    return f"{score:.3f}" if score == score else "-"


def summary(fitted: Fitted) -> str:
    """How many samples are used."""
    return (
        f"{len(fitted.data.alpha)} samples of {len(np.unique(fitted.runs.run))} runs, "
        f"{fitted.runs.rows_left_out} rows of them left out; {len(fitted.runs.refused)} runs or "
        f"samples not used, {fitted.outliers} of them because they contradict both belts."
    )
