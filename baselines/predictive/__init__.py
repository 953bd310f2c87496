"""Model predictive controllers: they drive along the reference that the observation shows ahead."""

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
