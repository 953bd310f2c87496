"""What the page of the paper is made of: its head, the texts above the tables, the figures."""

from pathlib import Path

from reproduce.paper_page import Figures, PaperPage
from reproduce.strawa2021 import claims, tables
from reproduce.strawa2021 import slip as slips
from reproduce.strawa2021 import soil as soils
from reproduce.strawa2021.results import Results

HEAD = """# Strawa et al. (2021) run again: section 8

*On-Line Learning and Updating Unmanned Tracked Vehicle Dynamics*, Electronics **10** (2021) 187.
Written by `python evaluate.py --paper strawa2021`; every number below is computed by that run.

The paper (S) states neither the radius, the speed, the start and d, nor the sensors of any single
test. Chosen here: a circle of R = 10 m around the origin of the maps, 2 m/s, d = 0.2 m, control at
100 Hz, no motor lag, and the lateral constraint of S (28). "Factor" is the factor of the turning
resistance (20): 2 as printed, 1 from its integral. The sensors are `ideal`, or `strawa` with the
noise of section 5.2, all at 100 Hz unless stated otherwise.

The manoeuvre of 8.3 is a straight line along the Y axis for 7 s, then a spiral to R = 6 m at 30 s,
at 2 ± 0.2 m/s. At X = 0 the maps (44), (45) are constant, so that the coefficients begin to change
when the spiral begins, as the paper says.

Regressions: `printed` is the recursion of 7.1.1 as it stands, with forgetting factor 0.998;
`bounded` has the same equations and factor, kept in bounds by this project's prior, gates and
compensation of the torque noise; `coupled` is this project's, with one forgetting time per
parameter.

Not covered: the electric circuit of the motor in 4.1.4, for which the paper gives no constants; the
two accelerometers of 5.2.1 (here the yaw acceleration is measured with a noise of its own); figure
16 on the straight line.
"""

TABLES = {
    "8.1 and 8.2": (
        tables.control_table,
        "Errors are distances to the moving reference point, from 30 s to 60 s.",
    ),
    "Figure 17": (
        tables.sweep_table,
        "Largest RMSE of the distance to the vehicle whose controller knows both parameters, with "
        "one of the two wrong by up to ±50 %.",
    ),
    "8.3.1: every condition": (
        tables.identification_table,
        "The error of the mass is taken on the straight part from 1 s to 7 s and in the spiral "
        "from 7 s to 30 s, the errors of inertia and mu_t from 12 s on. `fixed`: the same filter "
        "with wrong parameters that are not identified.",
    ),
    "8.3.1: speed and radius": (tables.path_table, "Maps, ideal sensors, factor 2."),
    "8.3.1: noise and excitation": (
        tables.noise_table,
        "Uniform ground, factor 2; noise and bias are those of section 5.2 times the number.",
    ),
    "8.3.1: speed at the start": (
        tables.start_table,
        "Uniform ground, the paper's noise, factor 2. From a slow start the first measured "
        "positions, 1 m off, can turn the vehicle so fast that one track runs backwards for some "
        "steps: there the resistances do not add up to 2 R_l, as the regression of the paper "
        "supposes.",
    ),
    "8.3.2": (
        tables.slip_table,
        f"Steady: |dv/dt| below {slips.STEADY:g} m/s², rapid: above {slips.RAPID:g} m/s², from "
        f"{slips.BEGUN:g} s on. Bias with its standard error; errors in percentage points of slip.",
    ),
    "8.3.3": (
        tables.soil_table,
        "RMS of the relative errors from 1 s after each change of the soil.",
    ),
    "8.3.3: noise of the slip": (
        tables.soil_noise_table,
        "Printed method, manoeuvre, white noise on true slips.",
    ),
    "8.3.3: window": (
        tables.soil_window_table,
        f"Printed method, manoeuvre, changing ground, white noise of {soils.WINDOW_NOISE:g} on "
        "true slips; the paper takes fifty.",
    ),
}
ORDER = ("exact", "mass-inertia", "sweep", "maps", "resistance-maps", "sandy-loam", "estimates",
         "estimates-uniform", "trajectory", "slip", "soil")  # fmt: skip


def save_figures(results: Results, folder: Path) -> Figures:
    """Write all figures, in the order of the page. Raises ImportError without matplotlib."""
    from reproduce import paper_page as paper_figures
    from reproduce.strawa2021 import figures as control_figures
    from reproduce.strawa2021 import figures as identification_figures

    drawn = paper_figures.save(
        results, folder, "strawa2021", control_figures.drawings, identification_figures.drawings
    )
    return {name: drawn[name] for name in ORDER}


PAGE = PaperPage(HEAD, claims.claims, TABLES, save_figures)
