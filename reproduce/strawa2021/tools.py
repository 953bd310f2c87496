"""What the scenarios are handed: controller and estimators, as factories.

period [s] is the control period, sensors the tracked_env.sensors.Sensors whose noise may be
known, lateral the closure of the nominal model, count the number N of vehicles.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from tracked_env.benchmark.policy_interface import Policy
from tracked_env.physics.parameters import PlantParameters

Controller = Callable[[PlantParameters, float, str], Policy]


class Tools(NamedTuple):
    """Factories; what they make is only asked for the methods named here."""

    # (parameters, period, lateral) -> predict. Parameters: numbers, or (N,) for N vehicles.
    controller: Controller
    # (parameters, period, sensors, lateral, kind) -> predict, estimates; kind "printed",
    # "paper" or "coupled": regression of the policy; "fixed": the same without adaptation.
    policy: Callable[[PlantParameters, float, Any, str, str], Any]
    # (parameters, period, sensors, count, velocity) -> observe(observation) = slips, variances
    slip: Callable[[PlantParameters, float, Any, int, bool], Any]
    # (parameters, period, sensors, count, residual, filtered)
    #     -> observe(observation, slips, variances) = {name: (N,)}
    soil: Callable[[PlantParameters, float, Any, int, str, bool], Any]
