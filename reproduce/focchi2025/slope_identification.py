"""Section 4.5: slip as a function of the sprocket speeds and of the direction of gravity, F (34).

mu = 0.6 and the vehicle of Table 2. The ramps of the paper have "inclinations from 0 to -0.3 rad in
increments of 0.5"; here both directions of the slope are swept in steps of 0.05. `PROBES` are runs
that no table has seen. On a side slope, driven straight and steadily, all forces along the ground
balance: F_g + (F_t, F_y) = 0, whatever the slip.

Reference: [1] Focchi et al. (2025), section 4.5.
"""

from typing import NamedTuple

import numpy as np

from baselines.slip.slip_models import SlipModel
from baselines.slip.slip_regression import determination
from baselines.slip.slip_sweep import identified_slip, slip_data
from baselines.slip.slope_models import SlopeSlipModel
from baselines.slip.slope_sweep import identified_slope_slip, steady_on_slopes
from reproduce.focchi2025.load_models import FRICTION
from reproduce.focchi2025.runs import LENGTHS, Floats, vehicle

SPROCKET_LIMIT = 18.0  # [rad/s] of the sweeps for this friction in the authors' code
SPEED_STEP = 2.25  # [rad/s]; slip is nearly linear between: 1.25 changes 8.3 by 0.1 mm
FINE, COARSE = 0.0875, 0.21875  # [-] of the grade over mu: 0.05 and 0.13 in the grade
PROBES = 400  # runs that no table has seen
FASTEST, STEEPEST = 10.0, 0.35  # [rad/s], [-] grade of the probes
SLOW = 0.05  # [m/s] |v_x| from which on alpha is compared
GRADES = np.linspace(0.05, 0.35, 7)  # [-] of the side slopes
STRAIGHT = (2.0, 5.0, 10.0)  # [rad/s] both sprockets on them
BEND = (4.0, 8.0)  # [rad/s] left, right of a left turn


class SlopeIdentification(NamedTuple):
    """Everything of section 4.5."""

    scores: dict[str, Floats]  # R^2 of beta_left, beta_right, alpha on the probes by model
    steady: int  # probes with a steady motion
    side_slip: Floats  # (STRAIGHT, GRADES) [rad] alpha on side slopes that rise to the left
    loads: dict[str, Floats]  # [m/s] slip velocity uphill, downhill at 5 rad/s, grade 0.35
    bend: Floats  # (3, 2) yaw rate [rad/s] and v_y [m/s] of BEND: uphill, level, downhill
    uphill: float  # [-] share of left turns across a slope in which the vehicle slips to the right


def model(load: str, length: float = LENGTHS[-1], slope_step: float = FINE) -> SlopeSlipModel:
    """Slip on slopes of the vehicle of 8.3; kept after the first call."""
    parameters = vehicle(length, FRICTION)._replace(sprocket_speed_limit=SPROCKET_LIMIT)
    return identified_slope_slip(parameters, load, SPEED_STEP, slope_step)


def probes() -> tuple[Floats, Floats]:
    """Sprocket speeds (PROBES, 2) [rad/s] and grades (PROBES, 2) [-], at random."""
    rng = np.random.default_rng(45)
    speeds = rng.uniform(-FASTEST, FASTEST, (PROBES, 2))
    size, way = STEEPEST * np.sqrt(rng.random(PROBES)), rng.uniform(-np.pi, np.pi, PROBES)
    return speeds, np.stack([size * np.cos(way), size * np.sin(way)], axis=1)


def run_all() -> SlopeIdentification:
    """Tables, probes and side slopes."""
    parameters = vehicle(friction=FRICTION)
    speeds, grade = probes()
    motion = steady_on_slopes(parameters, speeds, grade)
    known = np.isfinite(motion[:, 0])
    speeds, grade, motion = speeds[known], grade[known], motion[known]
    left, right = speeds.T.copy()
    true = slip_data(parameters, left, right, motion)
    moving = np.abs(true.v_x) > SLOW
    models: dict[str, SlipModel] = {
        "steps of 0.05": model("nonuniform").on(grade),
        "steps of 0.13": model("nonuniform", slope_step=COARSE).on(grade),
        "uniform load": model("uniform").on(grade),
        "level ground": identified_slip(parameters),
    }
    scores = {}
    for name, one in models.items():
        beta_left, beta_right, alpha = one.slip(left, right)
        pairs = [
            (true.beta_left, beta_left), (true.beta_right, beta_right),
            (true.alpha[moving], alpha[moving]),
        ]  # fmt: skip
        scores[name] = np.array([determination(a, b) for a, b in pairs])
    side = []
    for speed in STRAIGHT:
        across = np.stack([np.zeros_like(GRADES), -GRADES], axis=1)
        found = steady_on_slopes(parameters, np.full((len(GRADES), 2), speed), across)
        side.append(np.arctan(found[:, 1] / found[:, 0]))
    slopes = np.array([[-STEEPEST, 0.0], [STEEPEST, 0.0]])
    both = np.full((2, 2), 5.0)
    belt = 5.0 * parameters.sprocket_radius
    loads = {
        load: belt - steady_on_slopes(parameters, both, slopes, load)[:, 0]
        for load in ("nonuniform", "uniform")
    }
    along = np.array([[-0.2, 0.0], [0.0, 0.0], [0.2, 0.0]])
    bend = steady_on_slopes(parameters, np.tile(BEND, (3, 1)), along)[:, [2, 1]]
    turns = (left > 0.0) & (right > left + 1.0) & (np.abs(grade[:, 1]) > 0.15)
    uphill = float((true.v_y[turns] * grade[turns, 1] < 0.0).mean())
    return SlopeIdentification(scores, len(left), np.array(side), loads, bend, uphill)
