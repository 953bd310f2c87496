"""Slip of tracks identified beforehand or on line, and the models that hold it.

Public:
* `identified_slip`, `identified_slope_slip`: the model of a vehicle on its soil, level or on slopes
* `slip_family`, `slope_slip_family`: the same over friction; `with_friction`: a vehicle on a mu
* `RecursiveSlipEstimator`: friction, and with it slip, from what the sensors show
* `SlipModel`: what a model of slip must have; `SlipFamily`, `TableSlipModel`, `TreeSlipModel`,
  `ExponentialSlipModel` and `NoSlip` are such; `load`: a table from its file
"""

from baselines.slip.friction_estimator import RecursiveSlipEstimator
from baselines.slip.slip_models import NoSlip, SlipFamily, SlipModel, TableSlipModel, load
from baselines.slip.slip_regression import ExponentialSlipModel, TreeSlipModel
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
