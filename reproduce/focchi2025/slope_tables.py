"""The tables of the page for sections 4.5 and 8."""

from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025 import slope_chicane as closed
from reproduce.focchi2025 import slope_identification as ident
from reproduce.focchi2025.results import Results
from reproduce.focchi2025.uneven_ground import FRACTAL, slopes
from reproduce.paper_page import Rows

CONTROLLER = {
    "uc": "UC", "flat": "SLC, slip of level ground", "slope": "SLC, slip on slopes",
    "uniform": "SLC, slip on slopes with uniform load",
}  # fmt: skip


def ground_table(results: Results) -> Rows:
    """Slopes of the grounds."""
    rows = [["ground", "median slope", "90 %", "99 %", "place"]]
    for ground in results.slopes.grounds:
        x, y = ground.start
        rows.append([ground.name, *(f"{one:.4f}" for one in slopes(ground)), f"({x:g} m, {y:g} m)"])
    return rows


def load_table(results: Results) -> Rows:
    """Figure 21, left."""
    rows = [["ground", "reference", "heading [rad]", "gap [m]", "nonuniform: length [m]",
             "uniform: length [m]", "uniform at its bound"]]  # fmt: skip
    for ground in results.slopes.grounds:
        for commands, text in loads.COMMANDS.items():
            runs = [results.slopes.open_loop[ground.name, commands, load] for load in loads.LOADS]
            for row, heading in enumerate(loads.HEADINGS):
                rows.append(
                    [ground.name, text, f"{heading:g}", f"{loads.gap(*runs)[row]:.2f}",
                     *(f"{loads.length(run)[row]:.2f}" for run in runs),
                     f"{100 * runs[1].saturated[row]:.2g} % of the time"],
                )  # fmt: skip
    return rows


def stiffening_table(results: Results) -> Rows:
    """Figure 21, right."""
    rows = [["K_tp [s/m^2]", "length [m]", "K_t", "closed form [kN/m]", "largest in contact [kN/m]",
             "largest pitch [rad]", "held: pitch [rad]", "balance [rad]"]]  # fmt: skip
    for (pair, reading), run in results.slopes.stiffening.items():
        stiffening, length = loads.PAIRS[pair]
        formula = loads.foremost(stiffening, length, loads.TOP_SPEED)
        rows.append(
            [f"{stiffening:g}", f"{length:g}", reading, f"{1e-3 * formula:.1f}",
             f"{1e-3 * float(run.stiffness.max()):.1f}", f"{-float(run.pitch.min()):.3f}",
             f"{-run.held:.4f}", f"{-run.equilibrium:.4f}"],
        )  # fmt: skip
    return rows


def tracking_table(results: Results) -> Rows:
    """Figure 23 in numbers."""
    rows = [["ground", "load", "length [m]", "heading [rad]", "controller", "mean [cm]",
             "final [cm]", "max [cm]", "heading error [rad]", "pitch [rad]"]]  # fmt: skip
    for case, run in results.slopes.closed_loop.items():
        one = closed.tracking(run)
        errors = [f"{100 * value:.1f}" for value in (one.mean, one.final, one.largest)]
        rows.append(
            [case.ground, case.load, f"{case.length:g}", f"{case.heading:g}",
             CONTROLLER[case.kind], *errors, f"{one.heading:.3f}",
             f"{one.pitch[0]:.2f} to {one.pitch[1]:.2f}"],
        )  # fmt: skip
    return rows


def slope_slip_table(results: Results) -> Rows:
    """R^2 of slip on slopes."""
    rows = [["slip model", "beta_left", "beta_right", "alpha"]]
    for name, scores in results.slopes.identification.scores.items():
        rows.append([name, *(f"{one:.4f}" for one in scores)])
    return rows


def side_slope_table(results: Results) -> Rows:
    """alpha straight across slopes."""
    rows = [["sprockets [rad/s]", *(f"grade {grade:g}" for grade in ident.GRADES)]]
    found = results.slopes.identification.side_slip
    for speed, alpha in zip(ident.STRAIGHT, found, strict=True):
        rows.append([f"{speed:g}", *(f"{1e3 * abs(one):.2f}" for one in alpha)])
    return rows


TABLES = {
    "Slip on slopes": (
        slope_slip_table,
        f"R^2 on {ident.PROBES} runs that no table has seen, nonuniform load, mu = 0.6; steps of "
        "the tables in the grade.",
    ),
    "Straight across slopes": (side_slope_table, "Slip angle alpha in mrad, downhill."),
    "Grounds of section 8": (
        ground_table,
        f"|grad h| over 59 m x 59 m. The seeded field is a fractal (seed {FRACTAL['seed']}, "
        f"wavelengths {FRACTAL['shortest']:g} to {FRACTAL['longest']:g} m) above a level, rounded.",
    ),
    "Load models": (load_table, "Figure 21, left: open loop, mu = 0.6, D_t = 5 kN s/m."),
    "Stiffening": (
        stiffening_table,
        "Figure 21, right. Pitch is nose up here. K_t per track, and as coded: times the area of "
        "the track for each patch.",
    ),
    "Chicane on slopes": (tracking_table, "Figure 23: errors in the vehicle's plane, 200 Hz."),
}
