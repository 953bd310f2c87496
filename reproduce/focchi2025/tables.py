"""The tables of the page below the claims: every condition, one line each; heads in page.toml."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from reproduce.focchi2025 import control, slopes
from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025.claims import RATE, TABLE_4, prediction
from reproduce.focchi2025.control import LENGTHS, RESISTANCE, Case
from reproduce.focchi2025.planning_loop import PAPER
from reproduce.paper_page import Cells

CONTROLLER = {
    "uc": "UC",
    "table": "SLC",
    "trees": "SLC, decision trees",
    "exponential": "SLC, (54) of all runs",
    "exponential, slow": "SLC, (54) within 4.6 rad/s",
    "online": "SLC, on line",
}
ON_SLOPES = {
    "uc": "UC", "flat": "SLC, slip of level ground", "slope": "SLC, slip on slopes",
    "uniform": "SLC, slip on slopes with uniform load",
}  # fmt: skip
PRINTED = {"uc": "10", "table": "below 3"}  # [cm] figure 13
TABLE_5 = {"dubins": 0.06, "clothoid": 0.022, "optimal, (54)": 1.64, "optimal": 18.0}  # [s]
REPLAYS = {
    "table": "the slip of the model", "none": "no slip", "added": "its slip, beta added",
    "exponential": "(54) fitted to it",
}  # fmt: skip


def numbers(results: Any, kind: str, **case: Any) -> list[control.Numbers]:
    """Of the chicane with both lengths."""
    return [results.chicane[Case(kind, n, **case)].numbers() for n in LENGTHS]


def texts(found: Sequence[control.Numbers]) -> list[str]:
    """Their largest errors."""
    return [one.text for one in found]


def chicane_rows(results: Any) -> list[Cells]:
    """Figure 13, over the control rate."""
    rows = []
    for kind in control.KINDS:
        for rate in control.RATES:
            found = numbers(results, kind, rate=rate)
            head = [CONTROLLER[kind], f"{rate}", PRINTED[kind] if rate == RATE else ""]
            errors = [f"{100 * one.rmse:.2f}" for one in found]
            rows.append([*head, *texts(found), *errors, *(f"{one.heading:.3f}" for one in found)])
    return rows


def model_rows(results: Any) -> list[Cells]:
    """The closed loop with each slip model."""
    rows = []
    for kind in ("uc", "table", *control.REGRESSED):
        if Case(kind, LENGTHS[0]) in results.chicane:
            found = numbers(results, kind)
            errors = [f"{100 * one.rmse:.2f}" for one in found]
            rows.append([CONTROLLER[kind], *texts(found), *errors])
    return rows


def online_rows(results: Any) -> list[Cells]:
    """Wrong assumed friction: with its slip, and with slip identified on line."""
    rows = []
    for length in LENGTHS:
        for true, assumed in control.SOILS:
            right = results.chicane[Case("table", length, friction=true, believed=true)].numbers()
            for kind, believed in (("table", true), ("table", assumed), ("online", assumed)):
                run = results.chicane[Case(kind, length, friction=true, believed=believed)]
                one, online = run.numbers(), kind == "online"
                mu = run.belief.get("friction") if online else None
                rows.append(
                    [f"{length:g}", f"{true:g}", f"{believed:g}",
                     "on line" if online else "as assumed", one.text, f"{100 * one.rmse:.2f}",
                     f"{one.largest / right.largest:.2f}", f"{one.rmse / right.rmse:.2f}",
                     "" if mu is None else f"{mu[-1].mean():.3f}"]
                )  # fmt: skip
    return rows


def resistance_rows(results: Any) -> list[Cells]:
    """Rolling resistance of the plant and of the regressor."""
    cases = [("uc", RESISTANCE, RESISTANCE), ("uc", 0.0, 0.0)]
    cases += [
        ("table", true, assumed) for true in (RESISTANCE, 0.0) for assumed in (RESISTANCE, 0.0)
    ]
    rows = []
    for kind, true, assumed in cases:
        found = numbers(results, kind, resistance=true, believed_resistance=assumed)
        head = [CONTROLLER[kind], f"{true:g}", "" if kind == "uc" else f"{assumed:g}"]
        rows.append([*head, *texts(found)])
    return rows


def reading_rows(results: Any) -> list[Cells]:
    """The readings of (53)."""
    rows = []
    for name, text in control.READINGS.items():
        for resistance in (RESISTANCE, 0.0):
            keys = [(name, n, resistance, kind) for kind in control.KINDS for n in LENGTHS]
            if all(key in results.readings for key in keys):
                errors = [f"{100 * results.readings[key].largest:.1f}" for key in keys]
                rows.append([f"{name}: {text}", f"{resistance:g}", *errors])
    return rows


def noise_rows(results: Any) -> list[Cells]:
    """N(0, 0.02) as standard deviation, and as variance."""
    return [
        [CONTROLLER[kind], f"{noise:.2g}", *texts(numbers(results, kind, noise=noise))]
        for kind in control.KINDS
        for noise in (control.NOISE, control.LOUD[0].noise)
    ]


def integrator_rows(results: Any) -> list[Cells]:
    """Euler against the default."""
    rows = []
    for name in control.INTEGRATORS:
        uc, slc = (results.integrators[name, kind].numbers() for kind in control.KINDS)
        rows.append([name, *(f"{100 * e:.3f}" for e in (uc.largest, slc.largest, slc.rmse))])
    return rows


def prediction_rows(results: Any) -> list[Cells]:
    """Figure 14 in numbers."""
    rows = []
    for case in results.predicted:
        found = prediction(results.chicane, results.predicted, case)
        for name, sizes in found.items():
            unit = "mm/s" if name.startswith("beta") else "mrad"
            rows.append([f"{case.length:g}", name, unit, *(f"{1e3 * one:.1f}" for one in sizes)])
    return rows


def regression_rows(results: Any) -> list[Cells]:
    """R^2 of all regressions."""
    found = results.identification
    lines = []
    for name, one in (("simulation, mu = 0.1", found.simulated), ("real vehicle", found.measured)):
        if one is not None:
            lines += [
                (name, "trees", "held-out upsampled points", one.held_out),
                (name, "trees", "runs not seen", one.unseen),
                (name, "exponential (54)", "forward runs it was fitted to", one.exponential_fit),
            ]
    lines.append(("2 s from rest", "steady simulation", "all runs", found.brief.determination))
    for length, agreement in found.against_measured.items():
        model = f"simulation, {length:g} m"
        lines.append(("real vehicle", model, "all runs", agreement.determination))
    for length, (behind, agreement) in found.behind.items():
        model = f"simulation, {length:g} m, point {100 * behind:.1f} cm behind"
        lines.append(("real vehicle", model, "all runs", agreement.determination))
    return [
        [*head, *("-" if s != s else f"{s:.4f}" for s in scores)]
        for *head, scores in lines
        if scores is not None
    ]


def size_rows(results: Any) -> list[Cells]:
    """Real over simulated slip."""
    rows = [
        [f"{length:g} m", "real / simulated" if name == "slope" else name,
         *(f"{value:.2f}" for value in getattr(agreement, name))]
        for length, agreement in results.identification.against_measured.items()
        for name in ("correlation", "slope")
    ]  # fmt: skip
    return rows or [["no file of the real vehicle", *["-"] * (1 + len(ident.CHANNELS))]]


def tracking_rows(results: Any) -> list[Cells]:
    """Table 4 in every condition."""

    def printed(pair: tuple[float, float] | None) -> str:
        return "" if pair is None else f"{pair[0]:g} ± {pair[1]:g}"

    rows = []
    for setup, found in results.planning.tracked.items():
        ground, start = setup
        base = next(one.duration.mean() for pair, one in found.items() if pair.planner == "dubins")
        for pair, one in found.items():
            distance, heading = (
                TABLE_4.get(pair, (None, None)) if setup in PAPER.values() else (None, None)
            )
            rows.append(
                [f"{ground.length:g}", f"{ground.friction:g}", start,
                 f"{100 * (1.0 - ground.reserve):g} %", f"{len(one.distance)}", pair.name,
                 printed(distance), f"{one.distance.mean():.3f} ± {one.distance.std():.3f}",
                 printed(heading), f"{one.heading.mean():.3f} ± {one.heading.std():.3f}",
                 f"{one.missed.mean():.3f}", f"{one.turned.mean():.3f}",
                 f"{one.duration.mean() / base:.2f}", f"{100 * one.saturated.mean():.0f} %"]
            )  # fmt: skip
    return rows


def seconds_rows(results: Any) -> list[Cells]:
    """Table 5."""
    return [
        [name, f"{TABLE_5[name]:g}" if name in TABLE_5 else "", f"{1e3 * one.median:.2f}",
         f"{1e3 * one.worst:.2f}"]
        for name, one in results.planning.seconds.items()
    ]  # fmt: skip


def replay_rows(results: Any) -> list[Cells]:
    """Distances to the goals after replayed sprocket speeds."""
    missed = results.planning.replays
    return [
        [label, *(f"{f(missed[name]):.3f}" for f in (np.mean, np.median, np.max))]
        for name, label in REPLAYS.items()
    ]


def level_rows(results: Any) -> list[Cells]:
    """7.2.2."""
    levels, soils = results.planning.levels, results.planning.soils
    plans = {f"(54), {level}, beta {sign}": one for (sign, level), one in levels.items()}
    plans |= {f"identified, mu = {mu:g}": one for mu, one in soils.items()}
    return [
        [name, f"{one.duration:.2f}", f"{np.abs(one.course - one.yaw).max():.3f}",
         f"{np.abs(one.yaw_rate).max():.2f}"]
        for name, one in plans.items()
    ]  # fmt: skip


def slope_slip_rows(results: Any) -> list[Cells]:
    """R^2 of slip on slopes."""
    scores = results.slopes.identification.scores
    return [[name, *(f"{one:.4f}" for one in found)] for name, found in scores.items()]


def side_slope_rows(results: Any) -> list[Cells]:
    """alpha straight across slopes."""
    found = zip(slopes.STRAIGHT, results.slopes.identification.side_slip, strict=True)
    return [[f"{w:g}", *(f"{1e3 * abs(one):.2f}" for one in alpha)] for w, alpha in found]


def ground_rows(results: Any) -> list[Cells]:
    """Slopes of the grounds."""
    return [
        [ground.name, *(f"{one:.4f}" for one in slopes.steepness(ground)),
         f"({ground.start[0]:g} m, {ground.start[1]:g} m)"]
        for ground in results.slopes.grounds
    ]  # fmt: skip


def load_rows(results: Any) -> list[Cells]:
    """Figure 21, left."""
    rows = []
    for ground in results.slopes.grounds:
        for commands, text in loads.COMMANDS.items():
            runs = [results.slopes.open_loop[ground.name, commands, load] for load in loads.LOADS]
            gaps, lengths = loads.gap(*runs), [loads.length(run) for run in runs]
            for row, heading in enumerate(loads.HEADINGS):
                cells = [ground.name, text, f"{heading:g}", f"{gaps[row]:.2f}"]
                cells += [f"{length[row]:.2f}" for length in lengths]
                rows.append([*cells, f"{100 * runs[1].saturated[row]:.2g} % of the time"])
    return rows


def stiffening_rows(results: Any) -> list[Cells]:
    """Figure 21, right."""
    rows = []
    for (pair, reading), run in results.slopes.stiffening.items():
        stiffening, length = loads.PAIRS[pair]
        formula = loads.foremost(stiffening, length, loads.TOP_SPEED)
        forces = [f"{1e-3 * k:.1f}" for k in (formula, float(run.stiffness.max()))]
        pitches = [f"{-float(run.pitch.min()):.3f}", f"{-run.held:.4f}", f"{-run.equilibrium:.4f}"]
        rows.append([f"{stiffening:g}", f"{length:g}", reading, *forces, *pitches])
    return rows


def slope_chicane_rows(results: Any) -> list[Cells]:
    """Figure 23 in numbers."""
    rows = []
    for case, run in results.slopes.closed_loop.items():
        one = slopes.tracking(run)
        head = [case.ground, case.load, f"{case.length:g}", f"{case.heading:g}"]
        errors = [f"{100 * value:.1f}" for value in (one.mean, one.final, one.largest)]
        pitch = f"{one.pitch[0]:.2f} to {one.pitch[1]:.2f}"
        rows.append([*head, ON_SLOPES[case.kind], *errors, f"{one.heading:.3f}", pitch])
    return rows


TABLES = {
    "chicane": chicane_rows, "models": model_rows, "online": online_rows,
    "resistance": resistance_rows, "readings": reading_rows, "noise": noise_rows,
    "integrators": integrator_rows, "predicted": prediction_rows, "regressions": regression_rows,
    "sizes": size_rows, "tracked": tracking_rows, "seconds": seconds_rows, "replays": replay_rows,
    "levels": level_rows, "slope_slip": slope_slip_rows, "side_slopes": side_slope_rows,
    "grounds": ground_rows, "loads": load_rows, "stiffening": stiffening_rows,
    "slope_chicane": slope_chicane_rows,
}  # fmt: skip
