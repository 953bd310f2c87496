"""What a teacher sees besides the observation: the hidden parameters in force, and the slips.

A teacher is trained on an environment with `expose_truth`, and as a policy declares `needs_truth`,
like the oracle: it measures what could be had, and is no competitor. A student infers these inputs
from measurements and drives with the same network.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env import observation as layout
from tracked_env.observation import FEATURE_BOUND
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.terramechanics import GRAVITY, mohr_coulomb

Floats = NDArray[np.float32]
Truth = Mapping[str, NDArray[np.float64]]

TEACHER = "teacher"  # the kind of such an agent in a recipe
STUDENT_FEATURES = ("reckoned", "estimates")  # what its student with an LSTM may see, first: usual
# Logarithm of the ratio to nominal that is shown as 1, and the differences that are.
RATIOS = {"mass": 0.3, "inertia": 0.3, "shear_deformation_modulus": 0.5, "traction_limit": 1.0}
DIFFERENCES = {
    "longitudinal_resistance": 0.3, "lateral_resistance": 0.3, "drive_time_constant": 0.1,
    "slip_left": 0.5, "slip_right": 0.5,
}  # fmt: skip
PRIVILEGED = (*RATIOS, *DIFFERENCES)
# The true motion, as fields of the observation that ideal sensors would fill, and how far it is
# usually from what dead reckoning says [SI].
MOTION = {
    "position_error_x": 0.1, "position_error_y": 0.1, "heading_error": 0.05,
    "v_x": 0.1, "v_y": 0.1, "yaw_rate": 0.05,
}  # fmt: skip


def _quantities(truth: Mapping[str, Any]) -> dict[str, Any]:
    """The truth and the largest effort F_max of one track [N], Mohr-Coulomb."""
    area, load = truth["track_width"] * truth["contact_length"], 0.5 * GRAVITY * truth["mass"]
    limit = mohr_coulomb(truth["cohesion"], np.tan(truth["friction_angle"]), area, load)
    return {**truth, "traction_limit": limit}


def true_motion(truth: Truth, reference: Sequence[NDArray[np.float64]]) -> Floats:
    """MOTION (N, 6) of the true state, as the observation shows it.

    reference: x, y [m] and yaw [rad] of the reference now, (N,) each.
    """
    ahead, left = reference[0] - truth["x"], reference[1] - truth["y"]
    turn = reference[2] - truth["yaw"]
    cosine, sine = np.cos(truth["yaw"]), np.sin(truth["yaw"])
    values = np.stack([
        cosine * ahead + sine * left, cosine * left - sine * ahead,
        turn - 2.0 * np.pi * np.floor(turn / (2.0 * np.pi) + 0.5),
        truth["v_x"], truth["v_y"], truth["yaw_rate"],
    ], axis=1)  # fmt: skip
    columns = [layout.INDEX[name] for name in MOTION]
    bound = layout.BOUND[columns].astype(np.float64)
    return np.clip(values / layout.SCALE[columns], -bound, bound).astype(np.float32)


def privileged(truth: Truth, nominal: PlantParameters) -> Floats:
    """The true PRIVILEGED quantities over their scales, (N, F), finite and clipped, 0 = nominal.

    nominal: the vehicle on the soil that its controllers expect. Slips are clipped to 1 before
    they are scaled, everything to FEATURE_BOUND after, so that a student learns what its teacher
    sees.
    """
    given = _quantities(truth)
    expected = {"slip_left": 0.0, "slip_right": 0.0, **_quantities(nominal._asdict())}
    with np.errstate(divide="ignore"):  # a soil without any traction is shown as the bound
        columns = [np.log(given[name] / expected[name]) / scale for name, scale in RATIOS.items()]
    for name, scale in DIFFERENCES.items():
        value = np.clip(given[name], -1.0, 1.0) if name.startswith("slip") else given[name]
        columns.append((value - expected[name]) / scale)
    shown = np.nan_to_num(np.stack(columns, axis=-1))
    return np.clip(shown, -FEATURE_BOUND, FEATURE_BOUND).astype(np.float32)
