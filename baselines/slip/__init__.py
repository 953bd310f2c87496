"""Slip of tracks identified beforehand or on line, and the models that hold it."""

from baselines.slip.friction_estimator import RecursiveSlipEstimator
from baselines.slip.slip_models import (
    ExponentialSlipModel,
    NoSlip,
    SlipFamily,
    SlipModel,
    TableSlipModel,
    TreeSlipModel,
    load,
)
from baselines.slip.slip_sweep import (
    identified_slip,
    identified_slope_slip,
    slip_family,
    slope_slip_family,
    with_friction,
)

__all__ = [
    "ExponentialSlipModel",
    "NoSlip",
    "RecursiveSlipEstimator",
    "SlipFamily",
    "SlipModel",
    "TableSlipModel",
    "TreeSlipModel",
    "identified_slip",
    "identified_slope_slip",
    "load",
    "slip_family",
    "slope_slip_family",
    "with_friction",
]
