"""Section 8 of Strawa et al. (2021) as scenarios that can be run again.

    control         8.1, 8.2    controller with known and with wrong parameters
    sweep           figure 17   RMSE over the errors of mass and inertia
    identification  8.3.1       mass, inertia and resistance identified under way
    slip            8.3.2       unscented Kalman filter for the slips
    soil            8.3.3       F_max and K; printed_gnr is the method as printed
    claims, page                what the paper says, what comes out, as one page
Controller and estimators are handed in as `Tools`.

References: [1] Strawa et al., Electronics 10 (2021) 187.
"""

from reproduce.strawa2021.control import (
    PATHS,
    SCENARIOS,
    SETTLED,
    Run,
    Scenario,
    believed_parameters,
    run,
    run_all,
    table,
)
from reproduce.strawa2021.results import Results
from reproduce.strawa2021.results import run_all as run_everything
from reproduce.strawa2021.tools import Controller, Tools

__all__ = [
    "PATHS", "SCENARIOS", "SETTLED", "Controller", "Results", "Run", "Scenario", "Tools",
    "believed_parameters", "run", "run_all", "run_everything", "table",
]  # fmt: skip
