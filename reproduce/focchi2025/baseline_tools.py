"""Slip models and policies as the experiments of Focchi et al. (2025) ask for them.

reproduce.focchi2025 drives vehicles and draws figures, and knows no baseline: it is
handed TOOLS, factories by the name that it has for them.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 3 to 5 and 7.
"""

from collections.abc import Callable
from typing import Any

from baselines.estimators.sensor_samples import DataSheet
from baselines.lyapunov.adaptive_slippage_aware import AdaptiveSlipPolicy
from baselines.lyapunov.pseudo_kinematic import PseudoKinematicModel
from baselines.lyapunov.slippage_aware import SlippageAwarePolicy, UnicyclePolicy
from baselines.slip import slip_regression as regression
from baselines.slip import slip_sweep as identification
from baselines.slip.slip_models import SlipModel
from baselines.slip.slip_sweep import SlipData
from tracked_env.physics.parameters import PlantParameters


def sweep(parameters: PlantParameters, step: float) -> SlipData:
    """Steady slip at all pairs of sprocket speeds on a grid."""
    return identification.sweep(parameters, step)


def upsample(data: SlipData, parameters: PlantParameters) -> SlipData:
    """Smooth surfaces through the runs, on a dense grid."""
    return identification.upsample(data, parameters)[0]


def fit(
    data: SlipData, parameters: PlantParameters, kind: str
) -> tuple[SlipModel, regression.Scores]:
    """kind "trees" or "exponential": the model, and R^2 as the paper has it."""
    if kind == "trees":
        return regression.train_trees(data, parameters)
    return regression.fit_exponential(data, parameters)


def controller(
    parameters: PlantParameters, period: float, sensors: Any, count: int, model: SlipModel | None
) -> SlippageAwarePolicy:
    """The slippage-aware controller with a slip model, or without one that for a unicycle."""
    sheet = DataSheet.of(sensors)
    if model is None:
        return UnicyclePolicy(parameters, period, data_sheet=sheet)
    return SlippageAwarePolicy(parameters, period, model, data_sheet=sheet)


def online(
    parameters: PlantParameters, period: float, sensors: Any, count: int
) -> AdaptiveSlipPolicy:
    """The slippage-aware controller with the slip that its vehicles show under way."""
    return AdaptiveSlipPolicy(parameters, period, DataSheet.of(sensors))


TOOLS: dict[str, Callable[..., Any]] = {
    "sweep": sweep,
    "measured": identification.read_measured,
    "upsample": upsample,
    "regression": fit,
    "validate": regression.validate,
    "slip": identification.identified_slip,
    "kinematic": PseudoKinematicModel,
    "controller": controller,
    "online": online,
}
