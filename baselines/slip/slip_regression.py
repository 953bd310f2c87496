"""Regression of identified slip: decision trees as in F 4.2, and the exponential form F (54).

Four trees: beta_left, beta_right, and alpha for v_x > 0 and for v_x < 0, each of both sprocket
speeds. scikit-learn (the extra `slip`) grows them; what is looked up later are plain arrays.

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
from numpy.typing import ArrayLike, NDArray
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

    trees: arrays (roots (4,), feature, threshold, below, above, value); feature -1 is a leaf,
    children count from the tree's root. sprocket_radius [m]. Made by `train_trees`.
    """

    def __init__(self, trees: Sequence[NDArray], sprocket_radius: float) -> None:
        kinds = (np.int64, np.int64, np.float64, np.int64, np.int64, np.float64)
        if len(trees) != len(kinds) or len(trees[0]) != 4:
            raise ValueError(
                f"trees: {len(trees)} arrays, {len(trees[0])} roots; must be 6 arrays and 4 roots"
            )
        pairs = zip(trees, kinds, strict=True)
        self.trees = tuple(np.ascontiguousarray(a, dtype=k) for a, k in pairs)
        self.sprocket_radius = float(sprocket_radius)

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> Slip:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], (N,) each."""
        speeds = checked_speeds(sprocket_left, sprocket_right)
        out = np.empty((speeds[0].size, 3))
        _descend(self.trees, self.sprocket_radius, *speeds, out)
        return out[:, 0], out[:, 1], out[:, 2]


@loop
def _descend(trees, radius, left, right, out):
    """Slip of N vehicles by four trees (roots, feature, threshold, below, above, value); out
    (N, 3). Speeds are compared in single precision, as scikit-learn does."""
    roots, feature, threshold, below, above, value = trees
    for n in range(left.size):
        forward = 0.0
        for c in range(3):
            root = roots[c] if c < 2 or forward >= 0.0 else roots[3]
            node = root
            while feature[node] >= 0:
                speed = np.float32(right[n] if feature[node] else left[n])
                node = root + (below[node] if speed <= threshold[node] else above[node])
            out[n, c] = value[node]
            if c == 1:
                forward = radius * (left[n] + right[n]) - (out[n, 0] + out[n, 1])
        if left[n] == 0.0 and right[n] == 0.0:
            out[n, :] = 0.0


class ExponentialSlipModel:
    """F (54): -c_1 exp(-c_2 R) for R >= 0, c_1 exp(c_2 R) otherwise, R = v_x / w of the belts.

    constants (3, 2): c_1, c_2 of beta_left, beta_right [m/s] and alpha [rad]; c_1 of
    beta_right is negative, which F excludes. With R alone reverse would have the sign of
    forward; all three change it with both sprocket speeds, so here the sign is that of -w.
    """

    def __init__(self, constants: ArrayLike, track_gauge: float) -> None:
        self.constants = np.array(constants, dtype=np.float64)
        self.track_gauge = float(track_gauge)
        if self.constants.shape != (3, 2) or not np.isfinite(self.constants).all():
            raise ValueError(
                f"constants = {self.constants.tolist()}; must be finite, (3, 2): c_1 and c_2 of "
                "beta_left, beta_right and alpha"
            )
        if (self.constants[:, 1] < 0.0).any():
            raise ValueError(
                f"c_2 = {self.constants[:, 1].min():g} 1/m; must not be negative, or slip grows "
                "towards straight driving. Are the two constants in the order c_1, c_2?"
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


def scores(predicted: Array, data: SlipData) -> Scores:
    """R^2 of predictions (3, N): beta_left, beta_right, alpha, this one where |v_x| > SLOWEST."""
    left, right, alpha = predicted
    forward, reverse = data.v_x > SLOWEST, data.v_x < -SLOWEST
    return Scores(
        determination(data.beta_left, left),
        determination(data.beta_right, right),
        determination(data.alpha[forward], alpha[forward]),
        determination(data.alpha[reverse], alpha[reverse]),
    )


def score(model: SlipModel, data: SlipData) -> Scores:
    """R^2 of a model on data; alpha where |v_x| > SLOWEST."""
    return scores(np.array(model.slip(data.sprocket_left, data.sprocket_right)), data)


def split(data: SlipData) -> tuple[SlipData, SlipData]:
    """(training, test) data drawn at random; TEST_SHARE goes to the test set."""
    order = np.random.default_rng(0).permutation(len(data.alpha))
    count = max(1, round(TEST_SHARE * len(order)))
    return data.rows(np.sort(order[count:])), data.rows(np.sort(order[:count]))


def regressor() -> Any:
    """A decision tree to be trained. Raises ImportError without scikit-learn."""
    try:
        from sklearn.tree import DecisionTreeRegressor  # type: ignore[import-untyped]
    except ImportError as error:
        raise ImportError(
            "decision trees need scikit-learn: pip install 'tracked-env[slip]'. A trained model "
            "is loaded and looked up without it (baselines.slip.slip_models)."
        ) from error
    return DecisionTreeRegressor(min_samples_leaf=LEAF, random_state=0)


def grow(data: SlipData) -> list[Any]:
    """scikit-learn trees of beta_left, beta_right, alpha forward and alpha in reverse.

    Raises ValueError where the data hold no forward or no reverse driving, ImportError without
    scikit-learn.
    """
    every = np.ones(len(data.v_x), dtype=bool)
    targets = [(data.beta_left, every), (data.beta_right, every)]
    targets += [(data.alpha, data.v_x > 0.0), (data.alpha, data.v_x < 0.0)]
    inputs = np.stack([data.sprocket_left, data.sprocket_right], axis=1)
    grown = []
    for target, rows in targets:
        if rows.sum() < 2 * LEAF:
            raise ValueError(
                f"{rows.sum()} runs with one sign of v_x; must be {2 * LEAF} or more. "
                "Do the data cover both directions?"
            )
        grown.append(regressor().fit(inputs[rows], target[rows]))
    return grown


def as_arrays(grown: list[Any]) -> tuple[NDArray, ...]:
    """(roots, feature, threshold, below, above, value) of scikit-learn trees, one after another.

    Children count from the root of their tree; a leaf has feature -1.
    """
    trees = [one.tree_ for one in grown]
    roots = np.cumsum([0, *(tree.node_count for tree in trees[:-1])])
    features = [np.where(tree.children_left < 0, -1, tree.feature) for tree in trees]
    names = "threshold", "children_left", "children_right"
    columns = [[getattr(tree, name) for tree in trees] for name in names]
    values = [tree.value[:, 0, 0] for tree in trees]
    return (roots, *(np.concatenate(column) for column in (features, *columns, values)))


def train_trees(data: SlipData, parameters: PlantParameters) -> tuple[TreeSlipModel, Scores]:
    """Trees of the data but for a test set drawn at random from them, and R^2 on that.

    parameters: sprocket_radius is used. data: upsampled as in F, or runs. Raises as `grow` does.
    """
    training, test = split(data)
    model = TreeSlipModel(as_arrays(grow(training)), parameters.sprocket_radius)
    return model, score(model, test)


def validate(data: SlipData, parameters: PlantParameters) -> Scores:
    """R^2 by cross-validation on runs that neither the upsampling nor the trees have seen.

    Raises as `grow` does.
    """
    fold = np.random.default_rng(0).permutation(len(data.alpha)) % FOLDS
    held_out = np.empty((3, len(fold)))
    for k in range(FOLDS):
        dense, _grid = upsample(data.rows(fold != k), parameters)
        model = TreeSlipModel(as_arrays(grow(dense)), parameters.sprocket_radius)
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
        raise ValueError(
            f"{use.sum()} runs forward in turns; must be 4 or more. Do the data hold "
            "straight driving only?"
        )
    runs, radius, constants, fits = data.rows(use), radius[use], [], []
    for target in (runs.beta_left, runs.beta_right, runs.alpha):
        sign = 1.0 if np.sum(target * np.sign(radius)) <= 0.0 else -1.0
        low, high = sorted((0.0, sign * 10.0))
        bounds = ([low, 0.0], [high, 100.0])
        pair, _ = curve_fit(decay, radius, target, p0=(0.1 * sign, 1.0), bounds=bounds)
        constants.append(pair)
        fits.append(determination(target, decay(radius, *pair)))
    model = ExponentialSlipModel(np.array(constants), parameters.track_gauge)
    return model, Scores(fits[0], fits[1], fits[2], float("nan"))
