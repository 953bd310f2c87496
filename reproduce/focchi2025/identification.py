"""Section 4: slip as a function of the sprocket speeds, figures 6 to 9, and its exponential form.

The sweep of F has 31 x 31 pairs of sprocket speeds within +-10 rad/s, each held for 2 s from rest.
Here a pair is held until the motion is steady; `after_two_seconds` computes the difference.
The runs of the real vehicle are not part of this project: without their file they are left out.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.slip import slip_regression as fits
from baselines.slip import slip_sweep
from baselines.slip.slip_regression import Scores
from baselines.slip.slip_sweep import STEP, SlipData, identified_slip, slip_data, sweep
from reproduce.focchi2025.control import FRICTION, LENGTHS, MEASURED_LIMIT, vehicle, within
from reproduce.policy_runs import Floats
from tracked_env.physics.level_motion import hold_speeds
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.patches_on_level_ground import make_patches

# Runs of the real vehicle, in a folder beside that of the project.
MEASURED = Path(__file__).parents[3] / "shared" / "data" / "slip_real_indoor.csv"

FRICTIONS = (0.1, 0.4, 0.6)  # [-] mu of figure 8
HELD, AVERAGED = 2.0, 1.0  # [s] a pair of speeds is held, and the mean is over the end
BRIEF_STEP = 0.005  # [s] integration step of the runs from rest
SLOW = 0.05  # [m/s] |v_x| from which on alpha is compared
CHANNELS = ("beta_left", "beta_right", "alpha, forward", "alpha, reverse")


class Identified(NamedTuple):
    """Slip of one vehicle on one soil."""

    runs: SlipData
    trees: fits.TreeSlipModel
    held_out: Scores  # on points of the dense grid that the trees have not seen
    unseen: Scores  # on runs that the upsampling has not seen either
    exponential: fits.ExponentialSlipModel  # F (54)
    exponential_fit: Scores  # on the runs it was fitted to


class Agreement(NamedTuple):
    """A prediction p against runs q, per entry of CHANNELS."""

    determination: Floats  # (4,) R^2 [-]
    correlation: Floats  # (4,) [-]
    slope: Floats  # (4,) sum p q / sum p^2 [-]: 1 is the same size


class Identifications(NamedTuple):
    """Everything of section 4."""

    simulated: Identified  # Table 2, mu = 0.1
    by_friction: dict[float, SlipData]  # runs by mu
    measured: Identified | None
    against_measured: dict[float, Agreement]  # simulation by contact length [m]
    behind: dict[float, tuple[float, Agreement]]  # [m] `offset`, and the agreement with it
    behind_each: tuple[float, float]  # [m] of forward and reverse runs alone, shorter length
    brief: Agreement  # steady slip against 2 s from rest
    brief_slow: Agreement  # the same within MEASURED_LIMIT


def agreement(predicted: tuple[Floats, Floats, Floats], runs: SlipData) -> Agreement:
    """Predicted beta_left, beta_right, alpha against runs; alpha where |v_x| > SLOW."""
    every, forward = np.ones(len(runs.v_x), dtype=bool), runs.v_x > SLOW
    pairs = [
        (predicted[0], runs.beta_left, every),
        (predicted[1], runs.beta_right, every),
        (predicted[2], runs.alpha, forward),
        (predicted[2], runs.alpha, runs.v_x < -SLOW),
    ]
    rows = []
    for p, q, mask in pairs:
        p, q = p[mask], q[mask]
        rows.append((fits.determination(q, p), np.corrcoef(p, q)[0, 1], (p @ q) / (p @ p)))
    return Agreement(*np.array(rows).T)


def identify(parameters: PlantParameters, runs: SlipData) -> Identified:
    """Regressions of the runs of a vehicle. Raises ImportError without scikit-learn."""
    trained = fits.train_trees(slip_sweep.upsample(runs, parameters)[0], parameters)
    unseen = fits.validate(runs, parameters)
    return Identified(runs, *trained, unseen, *fits.fit_exponential(runs, parameters))


def after_two_seconds(parameters: PlantParameters, runs: SlipData) -> tuple[Floats, Floats, Floats]:
    """beta_left, beta_right [m/s], alpha [rad] as in F 4.2: held from rest, then averaged."""
    speeds = np.stack([runs.sprocket_left, runs.sprocket_right], axis=1)
    state, loads = np.zeros((len(speeds), 6)), np.empty((len(speeds), 6))
    rows, patches = np.tile(np.array(parameters, dtype=float), (len(speeds), 1)), make_patches()
    averaged = round(AVERAGED / BRIEF_STEP / 10)

    def hold(steps: int) -> None:
        hold_speeds(state, speeds, rows, patches, steps, BRIEF_STEP, False, loads)

    hold(round((HELD - AVERAGED) / BRIEF_STEP))
    total = np.zeros((len(speeds), 3))
    for _ in range(10):
        hold(averaged)
        total += 0.1 * state[:, 3:]
    mean = slip_data(parameters, runs.sprocket_left, runs.sprocket_right, total)
    return mean.beta_left, mean.beta_right, mean.alpha


def run_all(file: Path | None = None, step: float = STEP) -> Identifications:
    """Sweeps and regressions; file: runs of the real vehicle, None is MEASURED."""
    by_friction = {mu: sweep(vehicle(friction=mu), step) for mu in FRICTIONS}
    true, runs = vehicle(friction=FRICTION), by_friction[FRICTION]
    left, right, alpha = after_two_seconds(true, runs)
    brief_runs = runs._replace(beta_left=left, beta_right=right, alpha=alpha)
    brief = agreement(slip_of(runs), brief_runs)
    slow = agreement(slip_of(within(runs, MEASURED_LIMIT)), within(brief_runs, MEASURED_LIMIT))
    simulation = Identifications(
        identify(true, runs), by_friction, None, {}, {}, (math.nan, math.nan), brief, slow
    )
    file = MEASURED if file is None else file
    if not file.exists():
        return simulation
    real = slip_sweep.read_measured(file, true)
    predicted = {
        length: identified_slip(vehicle(length)).slip(real.sprocket_left, real.sprocket_right)
        for length in LENGTHS
    }
    short = predicted[LENGTHS[0]]
    return simulation._replace(
        measured=identify(true, real),
        against_measured={length: agreement(slip, real) for length, slip in predicted.items()},
        behind={length: offset(slip, real) for length, slip in predicted.items()},
        behind_each=(
            distance(short, real, real.v_x > SLOW),
            distance(short, real, real.v_x < -SLOW),
        ),
    )


def slip_of(runs: SlipData) -> tuple[Floats, Floats, Floats]:
    """beta_left, beta_right, alpha of runs."""
    return runs.beta_left, runs.beta_right, runs.alpha


def offset(predicted: tuple[Floats, Floats, Floats], runs: SlipData) -> tuple[float, Agreement]:
    """How far [m] behind the turning centre the runs were measured, and the agreement with that.

    A point d behind it has v_y - w d: alpha in a turn changes by -w d / v_x, with the same sign
    forward and in reverse, while that of the slip changes sign. d is the least squares fit.
    """
    across, turn = runs.v_x * np.tan(predicted[2]), runs.yaw_rate
    behind = distance(predicted, runs, np.abs(runs.v_x) > SLOW)
    alpha_behind = np.arctan((across - behind * turn) / np.where(runs.v_x == 0.0, np.inf, runs.v_x))
    return behind, agreement((predicted[0], predicted[1], alpha_behind), runs)


def distance(
    predicted: tuple[Floats, Floats, Floats], runs: SlipData, mask: NDArray[np.bool_]
) -> float:
    """The d [m] of `offset` from some of the runs, by a mask."""
    turn, across = runs.yaw_rate[mask], (runs.v_x * np.tan(predicted[2]))[mask]
    return -float(turn @ (runs.v_y[mask] - across) / (turn @ turn))


def share_above(runs: SlipData, other: SlipData) -> float:
    """How much larger |alpha| is in `runs` than in `other`, rms where both drive forward [-]."""
    both = (runs.v_x > SLOW) & (other.v_x > SLOW)
    sizes = [np.sqrt(np.mean(one.alpha[both] ** 2)) for one in (runs, other)]
    return float(sizes[0] / sizes[1])
