"""The turning estimator of a vehicle that is heavier than it believes, for its tests."""

import numpy as np

from baselines.estimators.turning import TurningEstimator
from tests.baselines.estimators.motion_cases import CLAY, EXACT

TRUTH = CLAY._replace(
    mass=1750.0, longitudinal_resistance=0.45, inertia=1500.0, lateral_resistance=0.65
)
LATERAL_MODELS = ("sliding", "constrained")


def with_lateral_model(p, factor=1.0, icr=0.2):
    return p._replace(turning_resistance_factor=factor, icr_forward=icr)


def true_values(p):
    return np.array([p.inertia, p.lateral_resistance])


def estimator(sheet=EXACT, count=1, nominal=CLAY, truth=TRUTH, **options):
    """With the mass and motion resistance of `truth`, as the longitudinal estimator finds them."""
    found = TurningEstimator(nominal, 0.02, data_sheet=sheet, count=count, **options)
    found.vehicles["mass"][:], found.vehicles["resistance"][:] = (
        truth.mass,
        truth.longitudinal_resistance,
    )
    return found


def relative_error(estimate, p):
    """(N, 2) of I and mu_t."""
    return estimate.value / true_values(p) - 1.0
