"""What the experiments are handed: identification of slip, slip models and policies, as factories.

A slip model has `slip(left, right)` -> beta_left, beta_right [m/s], alpha [rad] at sprocket speeds
(N,) [rad/s]. Runs are the columns sprocket_left, sprocket_right [rad/s], beta_left, beta_right
[m/s], alpha [rad], v_x, v_y [m/s] and yaw_rate [rad/s], (N,) each, as a named tuple.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from tracked_env.physics.parameters import PlantParameters


class Tools(NamedTuple):
    """Factories; what they make is only asked for what is named here."""

    # (parameters, step [rad/s]) -> runs of a vehicle at all pairs of sprocket speeds
    sweep: Callable[[PlantParameters, float], Any]
    # (file, parameters) -> runs of the real vehicle
    measured: Callable[[Path, PlantParameters], Any]
    # (runs, parameters) -> runs on a dense grid
    upsample: Callable[[Any, PlantParameters], Any]
    # (runs, parameters, kind) -> (slip model, R^2 of beta_left, beta_right, alpha forward, alpha in
    # reverse). kind "trees": decision trees, R^2 on points held out; "exponential": F (54).
    # Raises ImportError where the trees' library is missing.
    regression: Callable[[Any, PlantParameters, str], tuple[Any, Any]]
    # (runs, parameters) -> R^2 of trees on runs that neither they nor the upsampling have seen
    validate: Callable[[Any, PlantParameters], Any]
    # (parameters) -> slip model of a vehicle on its soil, to be looked up in the loop
    slip: Callable[[PlantParameters], Any]
    # (parameters, slip model) -> motion(sprockets (N, 2)) = ((N, 2) v_x, w, alpha (N,)),
    # step(pose (N, 3), sprockets, duration) = pose
    kinematic: Callable[[PlantParameters, Any], Any]
    # (parameters, period, sensors, count, slip model or None) -> predict, and for a slip model
    # reference_slip((N, 4) v_d, w_d, v_d', w_d') = (alpha_d, its rate)
    controller: Callable[[PlantParameters, float, Any, int, Any], Any]
    # (parameters, period, sensors, count) -> predict, estimates: slip identified on line
    online: Callable[[PlantParameters, float, Any, int], Any]
