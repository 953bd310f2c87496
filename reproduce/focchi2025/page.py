"""What the page of the paper is made of: its head, the texts above the tables, the figures."""

from pathlib import Path

from reproduce.focchi2025 import claims, tables
from reproduce.focchi2025.results import Results
from reproduce.paper_page import Figures, PaperPage

HEAD = """# Focchi et al. (2025) run again: sections 4, 5.2 and 7.1

*Pseudo-Kinematic Trajectory Control and Planning of Tracked Vehicles* (2025). Written by
`python evaluate.py --paper focchi2025`; every number below is computed by that run.

UC is the unicycle controller (40)-(42), SLC the slippage-aware one (44)-(47), k_p = 10, k_phi = 1.
Vehicle: Table 2 with its contact length of 0.7 m, and with 0.5 m; mu = 0.1, K = 1 mm, c_r = 0.025.
Reference: (53) with the ramp v_d = v_max t; start 5 cm, 3 cm and 0.01 rad off; errors count from
3 s on. Actuation noise N(0, 0.02) is a standard deviation in rad/s, new at every control step, four
vehicles per case: mean ± standard deviation of their largest errors. The SLC looks its slip up in a
table of the sweep of section 4; decision trees as in the paper have a line of their own.

Not covered: sections 2.2, 4.5, 5.3, 6, 7.2 and 8 but for (54) (slopes, planners); figure 15, for
want of the real vehicle's path; neural networks against trees (4.2), of which only the trees are
here; that actual sprocket speeds predict slip better than desired ones (7.1): here the sprockets
differ from what is asked by the noise alone.
"""

TABLES = {
    "Chicane": (tables.chicane_table, "Figure 13. The paper controls at 1 kHz in simulation; its "
                "vehicle at 200 Hz."),
    "Slip models": (tables.model_table, "200 Hz. (54) fitted to all runs, and to those with both "
                    "sprockets within 4.6 rad/s."),
    "Friction told wrong": (tables.online_table, "200 Hz, ideal sensors. Known: the slip of the "
                            "true friction."),
    "Rolling resistance": (tables.resistance_table, "200 Hz."),
    "Readings of (53)": (tables.open_table, "50 Hz, no noise; the paper prints the last one."),
    "Actuation noise": (tables.noise_table, "200 Hz; 0.02 as standard deviation and as variance."),
    "Integrators": (tables.integrator_table, "0.7 m, 200 Hz, no noise."),
    "Predicted slip": (tables.prediction_table, "Figure 14 in numbers, rms, 1 kHz."),
    "Regressions": (tables.identification_table, "0.7 m; alpha where |v_x| > 0.05 m/s."),
    "Simulated and real slip": (tables.size_table, "Figure 9 in numbers, within ±4.6 rad/s."),
}  # fmt: skip


def save_figures(results: Results, folder: Path) -> Figures:
    """Write all figures, in the order of the page. Raises ImportError without matplotlib."""
    from reproduce import paper_figures
    from reproduce.focchi2025 import control_figures, surfaces

    return paper_figures.save(
        results, folder, "focchi2025", surfaces.drawings, control_figures.drawings
    )


PAGE = PaperPage(HEAD, claims.claims, TABLES, save_figures)
