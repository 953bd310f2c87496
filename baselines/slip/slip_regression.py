"""Regression of identified slip: decision trees as in F 4.2, and the exponential form F (54).

Four trees of scikit-learn (the extra `slip`): beta_left, beta_right, and alpha for v_x > 0 and for
v_x < 0, each of both sprocket speeds.

Scores are coefficients of determination R^2 on data that the regression has not seen. F does
not say whether its test set was split off before the upsampling or after it. After it, each
test point has neighbours 0.1 rad/s away in the training set, and R^2 says little; `validate`
splits off whole runs before it.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 4, 7.2.3.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import curve_fit

from baselines.slip.slip_models import Array, Slip, SlipModel, checked_speeds
from baselines.slip.slip_sweep import SlipData, upsample
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PlantParameters

TEST_SHARE = 0.2  # [-] of the data that is held out
FOLDS = 5  # of the cross-validation
SLOWEST = 0.05  # [m/s] |v_x| below which alpha is not scored: it tends to pi/2 or to 0 there
LEAF = 2  # samples in a leaf at least: a single noisy one is not followed
STRAIGHT = 1e-9  # [rad/s] a smaller yaw rate, or difference of belts, has no turning radius
LARGEST_RADIUS = 1e3  # [m] runs beyond it are straight: they do not enter the exponential form


class TreeSlipModel:
    """Slip by four decision trees: beta_left, beta_right, alpha forward and alpha in reverse.

    trees: of scikit-learn, as `grow` returns them. sprocket_radius [m]. Made by `train_trees`.
    """

    def __init__(self, trees: Sequence[Any], sprocket_radius: float) -> None:
        self.trees, self.sprocket_radius = tuple(trees), float(sprocket_radius)

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> Slip:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], (N,) each."""
        left, right = checked_speeds(sprocket_left, sprocket_right)
        inputs = np.stack([left, right], axis=1).astype(np.float32)  # as scikit-learn compares
        beta_left, beta_right, forward, reverse = (
            tree.tree_.predict(inputs)[:, 0] for tree in self.trees
        )
        ahead = self.sprocket_radius * (left + right) - (beta_left + beta_right) >= 0.0
        standing = (left == 0.0) & (right == 0.0)
        slip = beta_left, beta_right, np.where(ahead, forward, reverse)
        return tuple(np.where(standing, 0.0, each) for each in slip)  # type: ignore[return-value]


class ExponentialSlipModel:
    """F (54): -c_1 exp(-c_2 R) for R >= 0, c_1 exp(c_2 R) otherwise, R = v_x / w of the belts.

    constants (3, 2): c_1, c_2 of beta_left, beta_right [m/s] and alpha [rad]; c_1 of
    beta_right is negative, which F excludes. With R alone reverse would have the sign of
    forward; all three change it with both sprocket speeds, so here the sign is that of -w.
    """

    def __init__(self, constants: ArrayLike, track_gauge: float) -> None:
        self.constants = np.array(constants, dtype=np.float64)
        self.track_gauge = float(track_gauge)
        c = self.constants
        if c.shape != (3, 2) or not np.isfinite(c).all() or (c[:, 1] < 0.0).any():
            raise ValueError(
                f"constants = {c.tolist()}; must be finite, (3, 2): c_1 and c_2 of beta_left, "
                "beta_right and alpha, c_2 >= 0 1/m, or slip grows towards straight driving"
            )

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> Slip:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], (N,) each."""
        speeds = checked_speeds(sprocket_left, sprocket_right)
        out = np.empty((speeds[0].size, 3))
        _exponentials(self.constants, 0.5 * self.track_gauge, *speeds, out)
        return out[:, 0], out[:, 1], out[:, 2]


@loop
def _exponentials(constants, half_gauge, left, right, out):
    """F (54) for N vehicles; out (N, 3). constants (3, 2): c_1, c_2 of beta_left, beta_right
    and alpha; the turning radius is that of the belts, F (26)."""
    for n in range(left.size):
        turn = right[n] - left[n]
        straight = abs(turn) < STRAIGHT
        bend = abs(half_gauge * (left[n] + right[n]) / (1.0 if straight else turn))
        sign = 0.0 if straight else (-1.0 if turn > 0.0 else 1.0)
        for c in range(3):
            out[n, c] = sign * constants[c, 0] * math.exp(-constants[c, 1] * bend)


class Scores(NamedTuple):
    """Coefficients of determination R^2 [-] on held-out data; NaN without data."""

    beta_left: float
    beta_right: float
    alpha_forward: float
    alpha_reverse: float


def determination(truth: Array, predicted: Array) -> float:
    """R^2 = 1 - sum (y - f)^2 / sum (y - mean y)^2 [-]; NaN for fewer than two samples."""
    spread = np.sum((truth - truth.mean()) ** 2) if len(truth) > 1 else 0.0
    return float(1.0 - np.sum((truth - predicted) ** 2) / spread) if spread > 0.0 else math.nan


def scores(predicted: ArrayLike, data: SlipData) -> Scores:
    """R^2 of predictions (3, N): beta_left, beta_right, alpha, this one where |v_x| > SLOWEST."""
    left, right, alpha = np.asarray(predicted)
    forward, reverse = data.v_x > SLOWEST, data.v_x < -SLOWEST
    return Scores(
        determination(data.beta_left, left),
        determination(data.beta_right, right),
        determination(data.alpha[forward], alpha[forward]),
        determination(data.alpha[reverse], alpha[reverse]),
    )


def score(model: SlipModel, data: SlipData) -> Scores:
    """R^2 of a model on data."""
    return scores(model.slip(data.sprocket_left, data.sprocket_right), data)


def split(data: SlipData) -> tuple[SlipData, SlipData]:
    """(training, test) data drawn at random; TEST_SHARE goes to the test set."""
    order = np.random.default_rng(0).permutation(len(data.alpha))
    count = max(1, round(TEST_SHARE * len(order)))
    return data.rows(np.sort(order[count:])), data.rows(np.sort(order[:count]))


def grow(data: SlipData) -> list[Any]:
    """scikit-learn trees of beta_left, beta_right, alpha forward and alpha in reverse.

    Raises ValueError where the data hold no forward or no reverse driving, ImportError without
    scikit-learn.
    """
    try:
        from sklearn.tree import DecisionTreeRegressor  # type: ignore[import-untyped]
    except ImportError as error:
        message = "decision trees need scikit-learn: pip install 'tracked-env[slip]'"
        raise ImportError(message) from error
    every = np.ones(len(data.v_x), dtype=bool)
    targets = [(data.beta_left, every), (data.beta_right, every)]
    targets += [(data.alpha, data.v_x > 0.0), (data.alpha, data.v_x < 0.0)]
    inputs = np.stack([data.sprocket_left, data.sprocket_right], axis=1)
    grown = []
    for target, rows in targets:
        if rows.sum() < 2 * LEAF:
            raise ValueError(
                f"{rows.sum()} runs in a direction; must be {2 * LEAF} or more in both"
            )
        tree = DecisionTreeRegressor(min_samples_leaf=LEAF, random_state=0)
        grown.append(tree.fit(inputs[rows], target[rows]))
    return grown


def train_trees(data: SlipData, parameters: PlantParameters) -> tuple[TreeSlipModel, Scores]:
    """Trees of the data but for a test set drawn at random from them, and R^2 on that.

    parameters: sprocket_radius is used. data: upsampled as in F, or runs. Raises as `grow` does.
    """
    training, test = split(data)
    model = TreeSlipModel(grow(training), parameters.sprocket_radius)
    return model, score(model, test)


def validate(data: SlipData, parameters: PlantParameters) -> Scores:
    """R^2 by cross-validation on runs that neither the upsampling nor the trees have seen.

    Raises as `grow` does.
    """
    fold = np.random.default_rng(0).permutation(len(data.alpha)) % FOLDS
    held_out = np.empty((3, len(fold)))
    for k in range(FOLDS):
        dense, _grid = upsample(data.rows(fold != k), parameters)
        model = TreeSlipModel(grow(dense), parameters.sprocket_radius)
        test = data.rows(fold == k)
        held_out[:, fold == k] = model.slip(test.sprocket_left, test.sprocket_right)
    return scores(held_out, data)


def decay(radius: Array, first: float, second: float) -> Array:
    """F (54) at radius R [m]: -first exp(-second R), or first exp(second R) for R < 0."""
    return np.where(radius >= 0.0, -1.0, 1.0) * first * np.exp(-second * np.abs(radius))


def fit_exponential(
    data: SlipData, parameters: PlantParameters
) -> tuple[ExponentialSlipModel, Scores]:
    """F (54) fitted to the runs that drive forward, and R^2 on those runs (F names no other).

    R is that of the belts, F (26), which is known when the model is looked up. parameters:
    track_gauge is used. Raises ValueError without forward runs in turns.
    """
    turn = data.sprocket_right - data.sprocket_left
    drive, arm = data.sprocket_left + data.sprocket_right, 0.5 * parameters.track_gauge
    turning = np.abs(turn) > STRAIGHT
    radius = arm * drive / np.where(turning, turn, 1.0)
    use = turning & (data.v_x > SLOWEST) & (drive > 0.0) & (np.abs(radius) < LARGEST_RADIUS)
    if use.sum() < 4:
        raise ValueError(f"{use.sum()} runs forward in turns; must be 4 or more")
    runs, radius, constants, fits = data.rows(use), radius[use], np.empty((3, 2)), []
    for pair, target in zip(constants, (runs.beta_left, runs.beta_right, runs.alpha), strict=True):
        sign = 1.0 if np.sum(target * np.sign(radius)) <= 0.0 else -1.0
        low, high = sorted((0.0, sign * 10.0))
        bounds, first = ([low, 0.0], [high, 100.0]), (0.1 * sign, 1.0)
        pair[:], _ = curve_fit(decay, radius, target, p0=first, bounds=bounds)
        fits.append(determination(target, decay(radius, *pair)))
    return ExponentialSlipModel(constants, parameters.track_gauge), Scores(
        fits[0], fits[1], fits[2], math.nan
    )
