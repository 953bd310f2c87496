"""The tables of the page below the claims: every condition, one line each."""

from collections.abc import Iterable

from reproduce.focchi2025 import chicane
from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025.chicane import Case
from reproduce.focchi2025.claims import RATE, prediction
from reproduce.focchi2025.results import Results
from reproduce.focchi2025.runs import LENGTHS, RESISTANCE
from reproduce.paper_page import Rows

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
    for kind in chicane.KINDS:
        for rate in chicane.RATES:
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
    for kind in ("uc", "table", *chicane.REGRESSED):
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
        for true, assumed in chicane.SOILS:
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
    for name, text in chicane.READINGS.items():
        for resistance in (RESISTANCE, 0.0):
            found = [
                results.readings.get((name, n, resistance, kind))
                for kind in chicane.KINDS
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
    for kind in chicane.KINDS:
        for noise in (chicane.NOISE, chicane.LOUD[0].noise):
            found = [results.chicane[Case(kind, n, noise=noise)].numbers() for n in LENGTHS]
            rows.append([CONTROLLER[kind], f"{noise:.2g}", *(one.text for one in found)])
    return rows


def integrator_table(results: Results) -> Rows:
    """Euler against the default."""
    rows = [["integrator", "UC: max [cm]", "SLC: max [cm]", "SLC: RMSE [cm]"]]
    for name in chicane.INTEGRATORS:
        uc, slc = (results.integrators[name, kind].numbers() for kind in chicane.KINDS)
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
    rows = [["runs", "regression", "R^2 on", *ident.CHANNELS]]

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
    rows = [["simulation", "quantity", *ident.CHANNELS]]
    found = results.identification
    for length, agreement in found.against_measured.items():
        for name in ("correlation", "slope"):
            text = "real / simulated" if name == "slope" else name
            values = [f"{value:.2f}" for value in getattr(agreement, name)]
            rows.append([f"{length:g} m", text, *values])
    if len(rows) == 1:
        rows.append(["no file of the real vehicle", *["-"] * (len(rows[0]) - 1)])
    return rows
