"""Model predictive controllers: they drive along the reference that the observation shows ahead.

Public:
* `PredictiveController`: the controller by torques, with `PredictiveSettings`
* `PredictivePolicy`, `NominalPredictivePolicy`, `PredictiveOraclePolicy`: with the identified, the
  nominal and the true parameters in its model
* `PredictiveAdaptiveSlipPolicy`, `PredictiveSlipPolicy`, `PredictiveOracleSlipPolicy`: by sprocket
  speeds, with the slip of the identified friction, of a given model and of the true soil
"""

from baselines.predictive.predictive_control import (
    NominalPredictivePolicy,
    PredictiveController,
    PredictiveOraclePolicy,
    PredictivePolicy,
)
from baselines.predictive.sprocket_control import (
    PredictiveAdaptiveSlipPolicy,
    PredictiveOracleSlipPolicy,
    PredictiveSlipPolicy,
)
from baselines.predictive.stages import PredictiveSettings

__all__ = [
    "NominalPredictivePolicy",
    "PredictiveAdaptiveSlipPolicy",
    "PredictiveController",
    "PredictiveOraclePolicy",
    "PredictiveOracleSlipPolicy",
    "PredictivePolicy",
    "PredictiveSettings",
    "PredictiveSlipPolicy",
]
