"""Section 8 of Strawa et al. (2021) as scenarios that can be run again.

    control            8.1, 8.2    controller with known and with wrong parameters
    sweep              figure 17   RMSE over the errors of mass and inertia
    identification     8.3.1       mass, inertia and resistance identified on line
    slip               8.3.2       unscented Kalman filter for the slips
    soil               8.3.3       F_max and K; printed_gnr is the method as printed
    drive              a batch of vehicles with its time histories
    filtered_policies  the policies of 8.3
    results            all of them run
    claims, page       what the paper says, what comes out, as one page
Vehicles are those of tracked_env; controller and estimators are those of baselines.

References: [1] Strawa et al., Electronics 10 (2021) 187.
"""

from reproduce.strawa2021.page import PAGE
from reproduce.strawa2021.results import run_everything

__all__ = ["PAGE", "run_everything"]
