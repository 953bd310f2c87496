"""What the page of the paper is made of: its head, the texts above the tables, the figures."""

from pathlib import Path

from reproduce.focchi2025 import claims, tables
from reproduce.focchi2025 import tables as planning_tables
from reproduce.focchi2025 import tables as slope_tables
from reproduce.focchi2025.results import Results
from reproduce.paper_page import Figures, PaperPage

HEAD = """# Focchi et al. (2025) run again: sections 4 to 8

*Pseudo-Kinematic Trajectory Control and Planning of Tracked Vehicles* (2025). Written by
`python evaluate.py --paper focchi2025`; every number below is computed by that run.

UC is the unicycle controller (40)-(42), SLC the slippage-aware one (44)-(47), k_p = 10, k_phi = 1.
The vehicle is that of Table 2 with its contact length of 0.7 m, and with 0.5 m; mu = 0.1, K = 1 mm,
c_r = 0.025. The reference is (53) with the ramp v_d = v_max t; the vehicle starts 5 cm, 3 cm and
0.01 rad off, and errors are counted from 3 s on. The actuation noise N(0, 0.02) is read as a
standard deviation in rad/s, drawn anew at every control step. Each case has four vehicles; the
tables have the mean ± standard deviation of their largest errors. The SLC interpolates its slip in
a table of the sweep of section 4; decision trees as in the paper have a line of their own.

On slopes (4.5, 8) mu = 0.6 and h = 0.25 m; the grounds are the height map that the authors
publish with their code, where its file is at hand, and a seeded field with slopes like it.

Plans (6, 7.2): mu = 0.4, 0.4 m/s, sprockets up to 18 rad/s, 100 goals from 1 to 4 m away, control
at 200 Hz, ideal sensors, no noise, from rest; further conditions are in a table.

Not covered: figure 15, because the path of the real
vehicle is not available; neural networks against decision trees (4.2), of which only the trees are
implemented; the statement of 7.1 that actual sprocket speeds predict slip better than desired ones,
because here the two differ by the noise alone.
"""

TABLES = {
    "Chicane": (
        tables.chicane_table,
        "Figure 13. The paper controls at 1 kHz in simulation and its vehicle at 200 Hz.",
    ),
    "Slip models": (
        tables.model_table,
        "Control at 200 Hz. (54) is fitted to all runs, and to those with both sprockets within "
        "4.6 rad/s.",
    ),
    "Wrong assumed friction": (
        tables.online_table,
        "Control at 200 Hz, ideal sensors. Assumed mu: the friction that the controller assumes. "
        "Known: the slip of the true friction.",
    ),
    "Rolling resistance": (tables.resistance_table, "Control at 200 Hz."),
    "Readings of (53)": (
        tables.open_table,
        "Control at 50 Hz, no noise; the paper prints the last one.",
    ),
    "Actuation noise": (
        tables.noise_table,
        "Control at 200 Hz; 0.02 as a standard deviation and as a variance.",
    ),
    "Integrators": (
        tables.integrator_table,
        "Contact length 0.7 m, control at 200 Hz, no noise.",
    ),
    "Predicted slip": (
        tables.prediction_table,
        "Figure 14 in numbers: rms values, control at 1 kHz.",
    ),
    "Regressions": (
        tables.identification_table,
        "Contact length 0.7 m; alpha is scored where |v_x| > 0.05 m/s.",
    ),
    "Simulated and real slip": (
        tables.size_table,
        "Figure 9 in numbers, within ±4.6 rad/s.",
    ),
    **planning_tables.TABLES,
    **slope_tables.TABLES_SLOPE_TABLES,
}


def save_figures(results: Results, folder: Path) -> Figures:
    """Write all figures, in the order of the page. Raises ImportError without matplotlib."""
    from reproduce import paper_page as paper_figures
    from reproduce.focchi2025 import figures as control_figures
    from reproduce.focchi2025 import figures as planning_figures
    from reproduce.focchi2025 import figures as slope_figures
    from reproduce.focchi2025 import figures as surfaces

    return paper_figures.save(
        results, folder, "focchi2025", surfaces.drawings, control_figures.drawings,
        planning_figures.drawings, slope_figures.drawings,
    )  # fmt: skip


PAGE = PaperPage(HEAD, claims.claims, TABLES, save_figures)
