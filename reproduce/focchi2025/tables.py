"""The tables of the page below the claims: every condition, one line each.

The tables of section 7.2: every pair in every condition, times of planners, replays.

The tables of the page for sections 4.5 and 8.
"""

from collections.abc import Iterable

import numpy as np

from reproduce.focchi2025 import control, identification
from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025 import slopes as closed
from reproduce.focchi2025 import slopes as ident
from reproduce.focchi2025.claims import RATE, TABLE_4, TABLE_5, prediction
from reproduce.focchi2025.control import Case
from reproduce.focchi2025.planning import PAPER, Planning
from reproduce.focchi2025.results import Results
from reproduce.focchi2025.runs import LENGTHS, RESISTANCE
from reproduce.focchi2025.slopes import FRACTAL, slopes
from reproduce.paper_page import Rows

NONE = (None, None)  # printed for no pair of that condition


def tracking_table(results: Results) -> Rows:
    """Table 4 in every condition."""
    rows = [["length [m]", "mu", "start", "sprockets planned to", "goals", "pair",
             "paper: e_xy [m]", "e_xy [m]", "paper: e_phi [rad]", "e_phi [rad]",
             "end: distance [m]", "end: yaw [rad]", "T / Dubins", "saturated"]]  # fmt: skip
    for setup, found in results.planning.tracked.items():
        ground, start = setup
        base = next(one.duration.mean() for pair, one in found.items() if pair.planner == "dubins")
        for pair, one in found.items():
            printed = TABLE_4.get(pair, NONE) if setup in PAPER.values() else NONE
            rows.append(
                [f"{ground.length:g}", f"{ground.friction:g}", start,
                 f"{100 * (1.0 - ground.reserve):g} %", f"{len(one.distance)}", pair.name,
                 _printed(printed[0]), f"{one.distance.mean():.3f} ± {one.distance.std():.3f}",
                 _printed(printed[1]), f"{one.heading.mean():.3f} ± {one.heading.std():.3f}",
                 f"{one.missed.mean():.3f}", f"{one.turned.mean():.3f}",
                 f"{one.duration.mean() / base:.2f}", f"{100 * one.saturated.mean():.0f} %"]
            )  # fmt: skip
    return rows


def _printed(pair: tuple[float, float] | None) -> str:
    return "" if pair is None else f"{pair[0]:g} ± {pair[1]:g}"


def seconds_table(results: Results) -> Rows:
    """Table 5."""
    rows = [["planner", "paper: average [s]", "median [ms]", "worst [ms]"]]
    for name, one in results.planning.seconds.items():
        paper = f"{TABLE_5[name]:g}" if name in TABLE_5 else ""
        rows.append([name, paper, f"{1e3 * one.median:.2f}", f"{1e3 * one.worst:.2f}"])
    return rows


def replay_table(results: Results) -> Rows:
    """Distances to the goals after replayed sprocket speeds."""
    planning: Planning = results.planning
    names = {
        "table": "the slip of the model", "none": "no slip", "added": "its slip, beta added",
        "exponential": "(54) fitted to it",
    }  # fmt: skip
    rows = [["the planner knows", "mean [m]", "median [m]", "largest [m]"]]
    for name, label in names.items():
        missed = getattr(planning.replays, name)
        rows.append([label, *(f"{f(missed):.3f}" for f in (np.mean, np.median, np.max))])
    return rows


def level_table(results: Results) -> Rows:
    """7.2.2."""
    rows = [["slip", "duration [s]", "largest alpha [rad]", "largest yaw rate [rad/s]"]]
    plans = {
        f"(54), {level}, beta {sign}": one
        for (sign, level), one in results.planning.levels.items()
    } | {f"identified, mu = {mu:g}": one for mu, one in results.planning.soils.items()}  # fmt: skip
    for name, one in plans.items():
        rows.append(
            [name, f"{one.duration:.2f}", f"{np.abs(one.course - one.yaw).max():.3f}",
             f"{np.abs(one.yaw_rate).max():.2f}"]
        )  # fmt: skip
    return rows


TABLES = {
    "Plans tracked": (
        tracking_table,
        "Table 4, and conditions that the paper does not have: another mu (7.1's, with its "
        "sprocket limit of 10 rad/s), a vehicle that moves as the plan begins, a reserve. Mean ± "
        "standard deviation over the goals of the RMSE over time against the plan; for SLC the "
        "heading is that of the motion. v in [0.15, 0.4] m/s where it says variable; 0.16 m, "
        "0.5 m: radius of Dubins paths; exchanged: UC on the course, SLC on the body; beta "
        "added: as (29) is printed.",
    ),
    "Time of a plan": (seconds_table, "Table 5: CPU time; the machine is in the claims."),
    "Plans replayed": (
        replay_table,
        "Sprocket speeds of plans at constant 0.4 m/s, mu = 0.4, 0.7 m, on the model (27).",
    ),
    "Slip and duration": (
        level_table,
        "7.2.2, figures 18 and 19: goal (2, 2.5, -0.4), v in [0, 0.8] m/s, 18 rad/s, 0.7 m.",
    ),
}


CONTROLLER_SLOPE_TABLES = {
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


def tracking_table_slope_tables(results: Results) -> Rows:
    """Figure 23 in numbers."""
    rows = [["ground", "load", "length [m]", "heading [rad]", "controller", "mean [cm]",
             "final [cm]", "max [cm]", "heading error [rad]", "pitch [rad]"]]  # fmt: skip
    for case, run in results.slopes.closed_loop.items():
        one = closed.tracking(run)
        errors = [f"{100 * value:.1f}" for value in (one.mean, one.final, one.largest)]
        rows.append(
            [case.ground, case.load, f"{case.length:g}", f"{case.heading:g}",
             CONTROLLER_SLOPE_TABLES[case.kind], *errors, f"{one.heading:.3f}",
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


TABLES_SLOPE_TABLES = {
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
    "Chicane on slopes": (
        tracking_table_slope_tables,
        "Figure 23: errors in the vehicle's plane, 200 Hz.",
    ),
}


CONTROLLER = {
    "uc": "UC",
    "table": "SLC",
    "trees": "SLC, decision trees",
    "exponential": "SLC, (54) of all runs",
    "exponential, slow": "SLC, (54) within 4.6 rad/s",
    "online": "SLC, on line",
}
PRINTED = {"uc": "10", "table": "below 3"}  # [cm] figure 13
_LENGTH_HEAD = [f"{n:g} m: max [cm]" for n in LENGTHS]


def chicane_table(results: Results) -> Rows:
    """Figure 13, over the control rate."""
    rows = [["controller", "control [Hz]", "paper: max [cm]", *_LENGTH_HEAD,
             *(f"{n:g} m: RMSE [cm]" for n in LENGTHS), *(f"{n:g} m: heading [rad]"
             for n in LENGTHS)]]  # fmt: skip
    for kind in control.KINDS:
        for rate in control.RATES:
            found = [results.chicane[Case(kind, n, rate)].numbers() for n in LENGTHS]
            rows.append(
                [CONTROLLER[kind], f"{rate}", PRINTED[kind] if rate == RATE else "",
                 *(one.text for one in found), *(f"{100 * one.rmse:.2f}" for one in found),
                 *(f"{one.heading:.3f}" for one in found)],
            )  # fmt: skip
    return rows


def model_table(results: Results) -> Rows:
    """The closed loop with each slip model."""
    rows = [["controller", *_LENGTH_HEAD, *(f"{n:g} m: RMSE [cm]" for n in LENGTHS)]]
    for kind in ("uc", "table", *control.REGRESSED):
        if Case(kind, LENGTHS[0]) not in results.chicane:
            continue
        found = [results.chicane[Case(kind, n)].numbers() for n in LENGTHS]
        rows.append([CONTROLLER[kind], *(one.text for one in found),
                     *(f"{100 * one.rmse:.2f}" for one in found)])  # fmt: skip
    return rows


def online_table(results: Results) -> Rows:
    """Wrong assumed friction: with its slip, and with slip identified on line."""
    rows = [["length [m]", "true mu", "assumed mu", "slip", "max [cm]", "RMSE [cm]",
             "max / known", "RMSE / known", "mu at the end"]]  # fmt: skip
    for length in LENGTHS:
        for true, assumed in control.SOILS:
            known = results.chicane[Case("table", length, friction=true, believed=true)].numbers()
            for kind, believed in (("table", true), ("table", assumed), ("online", assumed)):
                run = results.chicane[Case(kind, length, friction=true, believed=believed)]
                one = run.numbers()
                mu = run.belief.get("friction") if kind == "online" else None
                rows.append(
                    [f"{length:g}", f"{true:g}", f"{believed:g}",
                     "on line" if kind == "online" else "as assumed", one.text,
                     f"{100 * one.rmse:.2f}", f"{one.largest / known.largest:.2f}",
                     f"{one.rmse / known.rmse:.2f}",
                     "" if mu is None else f"{mu[-1].mean():.3f}"],
                )  # fmt: skip
    return rows


def resistance_table(results: Results) -> Rows:
    """Rolling resistance of the plant and of the regressor."""
    rows = [["controller", "c_r", "c_r of the regressor", *_LENGTH_HEAD]]
    cases = [("uc", RESISTANCE, RESISTANCE), ("uc", 0.0, 0.0)]
    cases += [
        ("table", true, assumed) for true in (RESISTANCE, 0.0) for assumed in (RESISTANCE, 0.0)
    ]
    for kind, true, assumed in cases:
        found = [
            results.chicane[Case(kind, n, resistance=true, believed_resistance=assumed)]
            for n in LENGTHS
        ]
        rows.append([CONTROLLER[kind], f"{true:g}", "" if kind == "uc" else f"{assumed:g}",
                     *(run.numbers().text for run in found)])  # fmt: skip
    return rows


def open_table(results: Results) -> Rows:
    """The readings of (53)."""
    rows = [["v_d before t_1", "c_r", *(f"{name}, {n:g} m: max [cm]" for name in ("UC", "SLC")
             for n in LENGTHS)]]  # fmt: skip
    for name, text in control.READINGS.items():
        for resistance in (RESISTANCE, 0.0):
            found = [
                results.readings.get((name, n, resistance, kind))
                for kind in control.KINDS
                for n in LENGTHS
            ]
            if any(one is None for one in found):
                continue
            rows.append([f"{name}: {text}", f"{resistance:g}",
                         *(f"{100 * one.largest:.1f}" for one in found if one)])  # fmt: skip
    return rows


def noise_table(results: Results) -> Rows:
    """N(0, 0.02) as standard deviation, and as variance."""
    rows = [["controller", "sigma [rad/s]", *_LENGTH_HEAD]]
    for kind in control.KINDS:
        for noise in (control.NOISE, control.LOUD[0].noise):
            found = [results.chicane[Case(kind, n, noise=noise)].numbers() for n in LENGTHS]
            rows.append([CONTROLLER[kind], f"{noise:.2g}", *(one.text for one in found)])
    return rows


def integrator_table(results: Results) -> Rows:
    """Euler against the default."""
    rows = [["integrator", "UC: max [cm]", "SLC: max [cm]", "SLC: RMSE [cm]"]]
    for name in control.INTEGRATORS:
        uc, slc = (results.integrators[name, kind].numbers() for kind in control.KINDS)
        rows.append(
            [name, f"{100 * uc.largest:.3f}", f"{100 * slc.largest:.3f}", f"{100 * slc.rmse:.3f}"]
        )
    return rows


def prediction_table(results: Results) -> Rows:
    """Figure 14 in numbers."""
    rows = [["length [m]", "slip", "unit", "size in the turns", "error in the turns",
             "error in the second after a jump"]]  # fmt: skip
    for case in results.predicted:
        for name, (size, error, jump) in prediction(
            results.chicane, results.predicted, case
        ).items():
            scale, unit = (1e3, "mm/s") if name.startswith("beta") else (1e3, "mrad")
            rows.append([f"{case.length:g}", name, unit,
                         *(f"{scale * value:.1f}" for value in (size, error, jump))])  # fmt: skip
    return rows


def identification_table(results: Results) -> Rows:
    """R^2 of all regressions."""
    found = results.identification
    rows = [["runs", "regression", "R^2 on", *identification.CHANNELS]]

    def add(name: str, regression: str, on: str, scores: Iterable[float] | None) -> None:
        if scores is not None:
            rows.append([name, regression, on, *("-" if s != s else f"{s:.4f}" for s in scores)])

    for name, one in (("simulation, mu = 0.1", found.simulated), ("real vehicle", found.measured)):
        if one is None:
            continue
        add(name, "trees", "held-out upsampled points", one.held_out)
        add(name, "trees", "runs not seen", one.unseen)
        add(name, "exponential (54)", "forward runs it was fitted to", one.exponential_fit)
    add("2 s from rest", "steady simulation", "all runs", found.brief.determination)
    for length, agreement in found.against_measured.items():
        add("real vehicle", f"simulation, {length:g} m", "all runs", agreement.determination)
    for length, (behind, agreement) in found.behind.items():
        add(
            "real vehicle",
            f"simulation, {length:g} m, point {100 * behind:.1f} cm behind",
            "all runs",
            agreement.determination,
        )
    return rows


def size_table(results: Results) -> Rows:
    """Real over simulated slip."""
    rows = [["simulation", "quantity", *identification.CHANNELS]]
    found = results.identification
    for length, agreement in found.against_measured.items():
        for name in ("correlation", "slope"):
            text = "real / simulated" if name == "slope" else name
            values = [f"{value:.2f}" for value in getattr(agreement, name)]
            rows.append([f"{length:g} m", text, *values])
    if len(rows) == 1:
        rows.append(["no file of the real vehicle", *["-"] * (len(rows[0]) - 1)])
    return rows
