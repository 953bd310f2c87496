"""Section 8 of Strawa et al. (2021) as scenarios that can be run again.

    control         8.1, 8.2      controller with known and wrong parameters; figure 17
    identification  8.3.1         mass, inertia and resistance identified on line
    soil            8.3.2, 8.3.3  unscented Kalman filter for the slips; F_max and K
    page, control_figures         what the paper says, what comes out; words in page.toml
Vehicles are those of tracked_env; controller and estimators are those of baselines.

References: [1] Strawa et al., Electronics 10 (2021) 187.
"""

from reproduce.strawa2021.page import PAGE, run_everything

__all__ = ["PAGE", "run_everything"]
