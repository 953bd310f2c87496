"""The policies of section 8.3: the controller behind the filter of its pose and slips.

They differ in what they do about the parameters only: keep them, or identify them on line. As in
S the estimated soil is not used by the controller.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 7 and 8.3.
"""

from baselines.estimators.sensor_samples import DataSheet
from baselines.estimators.stack import Identification
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from reproduce.strawa2021.drive import PERIOD
from tracked_env.physics.parameters import PlantParameters
from tracked_env.sensors import Sensors


class FilteringPolicy(AdaptivePolicy):
    """The adaptive policy without adaptation: the controller keeps the parameters it was given.

    Position noise of 1 m saturates the controller without a filter, so a comparison with the
    adaptive policy has to have the same filter.
    """

    def _adapt(self, known: Identification) -> None:
        """Keep the parameters."""


def filtered_policy(
    parameters: PlantParameters, sensors: Sensors, kind: str, lateral: str = "constrained"
) -> AdaptivePolicy:
    """The policy of one row of the tables, for any number of vehicles.

    parameters: believed at the start. sensors: their noise is known to the filters. kind:
    "printed", "paper" or "coupled" is the regression of mass, inertia and resistance, "fixed"
    keeps the parameters.
    """
    made = FilteringPolicy if kind == "fixed" else AdaptivePolicy
    return made(
        parameters,
        PERIOD,
        DataSheet.of(sensors),
        lateral,
        Gains(),
        regression="coupled" if kind == "fixed" else kind,
        uses_soil=False,
    )
