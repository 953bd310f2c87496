"""Sections 4 to 8 of Focchi et al. (2025) as experiments that can be run again.

    control         5.2, 7.1   the controllers on a spiral and on the chicane: figures 10 to 14
    identification  4, 7.2.3   slip over the sprocket speeds: figures 6 to 9, exponential form
    planning        6, 7.2     goals and plans, conventions of the authors' code
    planning_loop   7.2        plans tracked by both controllers, figures 16, 17
    load_models     8.1, 8.2   nonuniform and uniform load, stiffness that grows: figure 21
    slopes          4.5, 8     the grounds, slip on slopes, the chicane there: figures 22 and 23
    claims, control_figures    what the paper says, what comes out; words in page.toml
Below: all runs, and the tables of the page, the values of every condition; cells in page.toml. The
vehicle is that of tracked_env; slip models and controllers are those of baselines.

References: [1] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025).
"""

from collections.abc import Callable, Iterable, Mapping
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from baselines.slip.slip_sweep import identified_slip
from reproduce import Cells, PaperPage, Say, words_of
from reproduce.focchi2025 import control, control_figures, identification, planning_loop, slopes
from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025.claims import RATE, TABLE_4, outcomes, prediction
from reproduce.focchi2025.control import LENGTHS, RESISTANCE, Case, Numbers, Spiral, vehicle
from reproduce.focchi2025.identification import Identifications
from reproduce.focchi2025.planning_loop import PAPER, Planning
from reproduce.focchi2025.slopes import Slopes
from reproduce.policy_runs import SPROCKETS, Drive, Floats

__all__ = ["PAGE", "Results", "run_everything"]

Rows = Iterable[Mapping[str, Any] | Cells]

NAMES: dict[str, dict[str, str]] = words_of(__file__)["names"]
PRINTED = {"uc": "10", "table": "below 3"}  # [cm] figure 13
TABLE_5 = {"dubins": 0.06, "clothoid": 0.022, "optimal, (54)": 1.64, "optimal": 18.0}  # [s]


class Results(NamedTuple):
    """All runs."""

    identification: Identifications
    spiral: dict[str, Spiral]  # "uc", "slc"
    chicane: dict[Case, Drive]
    readings: dict[tuple[str, float, float, str], Numbers]  # reading of (53), length, c_r, kind
    integrators: dict[tuple[str, str], Numbers]  # integrator, kind
    predicted: dict[Case, tuple[Floats, Floats, Floats]]  # slip (T,) of the first vehicle
    slopes: Slopes  # sections 4.5 and 8
    planning: Planning  # sections 6 and 7.2


def predicted_slip(case: Case, run: Drive) -> tuple[Floats, Floats, Floats]:
    """beta_left, beta_right, alpha that the controller of a case expects of its first vehicle."""
    model = identified_slip(vehicle(case.length, case.assumed, case.assumed_resistance))
    left, right = (run.truth[name][:, 0].copy() for name in SPROCKETS)
    beta_left, beta_right, alpha = model.slip(left, right)
    return beta_left, beta_right, alpha


def run_everything(
    say: Say = lambda text: None, measured: Path | None = None, terrain: Path | None = None
) -> Results:
    """Run all experiments; say(text) reports which ones come next.

    measured: file of the runs of the real vehicle, None is `identification.MEASURED`. terrain: the
    authors' height map, None is `slopes.MAP`.
    """
    say("figures 6 to 9: identification of slip")
    identified = identification.run_all(measured)
    if identified.measured is None:
        say("runs of the real vehicle: no file, left out")
    say("figure 10: spiral")
    spirals = control.spirals()
    say("figures 12 to 14: chicane")
    cases = [*control.PAPER, *control.MODELS, *control.ONLINE, *control.RESISTANCES, *control.LOUD]
    chicane = control.drive(list(dict.fromkeys(cases)))
    say("readings of (53), integrators")
    readings, integrators = control.readings(), control.integrators()
    cases_of_figure = [Case("table", length, control.RATES[0]) for length in LENGTHS]
    predicted = {case: predicted_slip(case, chicane[case]) for case in cases_of_figure}
    on_slopes = slopes.run_all(say, terrain)
    planning = planning_loop.run_all(say)
    return Results(
        identified, spirals, chicane, readings, integrators, predicted, on_slopes, planning
    )


# Tables


def of_chicane(results: Any, kind: str, **case: Any) -> dict[str, Any]:
    """A controller on the chicane with both lengths."""
    runs = [control.numbers(results.chicane[Case(kind, n, **case)]) for n in LENGTHS]
    return {"name": NAMES["controllers"][kind], "runs": runs}


def chicane_rows(results: Any) -> Rows:
    """Figure 13, over the control rate."""
    for kind, rate in product(control.KINDS, control.RATES):
        printed = PRINTED[kind] if rate == RATE else ""
        yield {"rate": rate, "printed": printed, **of_chicane(results, kind, rate=rate)}


def online_rows(results: Any) -> Rows:
    """Wrong assumed friction: with its slip, and with slip identified on line."""

    def numbers(case: Case) -> Numbers:
        return control.numbers(results.chicane[case])

    for length, (true, assumed) in product(LENGTHS, control.SOILS):
        right = numbers(Case("table", length, friction=true, assumed=true))
        for kind, friction in (("table", true), ("table", assumed), ("online", assumed)):
            case = Case(kind, length, friction=true, assumed=friction)
            one, belief = numbers(case), results.chicane[case].belief
            end = f"{np.tan(belief['friction_angle'][-1]).mean():.3f}" if kind == "online" else ""
            yield {
                "length": length,
                "true": true,
                "assumed": friction,
                "slip": "on line" if kind == "online" else "as assumed",
                "run": one,
                "ratios": (one.largest / right.largest, one.rmse / right.rmse),
                "end": end,
            }


def resistance_rows(results: Any) -> Rows:
    """Rolling resistance of the plant and of the regressor."""
    every = tuple(product((RESISTANCE, 0.0), repeat=2))
    for kind, cases in (("uc", (every[0], every[3])), ("table", every)):
        for true, assumed in cases:
            row = of_chicane(results, kind, resistance=true, assumed_resistance=assumed)
            yield {"true": true, "assumed": "" if kind == "uc" else f"{assumed:g}", **row}


def reading_rows(results: Any) -> Rows:
    """The readings of (53)."""
    for (name, text), resistance in product(control.READINGS.items(), (RESISTANCE, 0.0)):
        keys = [(name, n, resistance, kind) for kind in control.KINDS for n in LENGTHS]
        errors = [results.readings[key].largest for key in keys]
        yield {"name": name, "text": text, "resistance": resistance, "errors": errors}


def prediction_rows(results: Any) -> Rows:
    """Figure 14 in numbers."""
    for case in results.predicted:
        slips = prediction(results.chicane, results.predicted, case)
        for name, sizes in slips.items():
            unit = "mm/s" if name.startswith("beta") else "mrad"
            yield {"length": case.length, "name": name, "unit": unit, "sizes": sizes}


def regression_rows(results: Any) -> Rows:
    """R^2 of all regressions."""
    every = results.identification
    lines = []
    for name, one in (("simulation, mu = 0.1", every.simulated), ("real vehicle", every.measured)):
        if one is not None:
            lines += [
                (name, "trees", "held-out upsampled points", one.held_out),
                (name, "trees", "runs not seen", one.unseen),
                (name, "exponential (54)", "forward runs it was fitted to", one.exponential_fit),
            ]
    lines.append(("2 s from rest", "steady simulation", "all runs", every.brief.determination))
    models = [(f"{n:g} m", one) for n, one in every.against_measured.items()]
    models += [
        (f"{n:g} m, point {100 * behind:.1f} cm behind", one)
        for n, (behind, one) in every.behind.items()
    ]
    lines += [
        ("real vehicle", f"simulation, {name}", "all runs", one.determination)
        for name, one in models
    ]
    for *head, scores in lines:
        yield [*head, *("-" if np.isnan(s) else f"{s:.4f}" for s in scores)]


def size_rows(results: Any) -> Rows:
    """Real over simulated slip."""
    if not results.identification.against_measured:
        yield ["no file of the real vehicle", *["-"] * (1 + len(identification.CHANNELS))]
    for length, one in results.identification.against_measured.items():
        yield {"length": length, "quantity": "correlation", "values": one.correlation}
        yield {"length": length, "quantity": "real / simulated", "values": one.slope}


def tracking_rows(results: Any) -> Rows:
    """Table 4 in every condition."""
    for (ground, start), tracked in results.planning.tracked.items():
        base = next(t.duration.mean() for pair, t in tracked.items() if pair.planner == "dubins")
        for pair, one in tracked.items():
            printed = TABLE_4.get(pair, ()) if (ground, start) in PAPER.values() else ()
            yield {
                "ground": ground,
                "start": start,
                "used": 1.0 - ground.reserve,
                "count": len(one.distance),
                "pair": pair,
                "printed": [f"{mean:g} ± {std:g}" for mean, std in printed] or ("", ""),
                "mean": [values.mean() for values in one],
                "std": [values.std() for values in one],
                "longer": one.duration.mean() / base,
            }


def replay_rows(results: Any) -> Rows:
    """Distances to the goals after replayed sprocket speeds."""
    for name, label in NAMES["replays"].items():
        missed = results.planning.replays[name]
        sizes = {"mean": missed.mean(), "median": np.median(missed), "largest": missed.max()}
        yield {"label": label, **sizes}


def level_rows(results: Any) -> Rows:
    """7.2.2."""
    levels, soils = results.planning.levels, results.planning.soils
    plans = {f"(54), {level}, beta {sign}": plan for (sign, level), plan in levels.items()}
    plans |= {f"identified, mu = {mu:g}": plan for mu, plan in soils.items()}
    for name, plan in plans.items():
        alpha, rate = np.abs(plan.course - plan.yaw).max(), np.abs(plan.yaw_rate).max()
        yield {"name": name, "plan": plan, "alpha": alpha, "rate": rate}


def load_rows(results: Any) -> Rows:
    """Figure 21, left."""
    for ground, (commands, text) in product(results.slopes.grounds, loads.COMMANDS.items()):
        runs = [results.slopes.open_loop[ground.name, commands, load] for load in loads.LOADS]
        for row, heading in enumerate(loads.HEADINGS):
            yield {
                "ground": ground.name,
                "text": text,
                "heading": heading,
                "gap": loads.gap(*runs)[row],
                "lengths": [loads.length(run)[row] for run in runs],
                "saturated": runs[1].saturated[row],
            }


def stiffening_rows(results: Any) -> Rows:
    """Figure 21, right."""
    for (name, reading), run in results.slopes.stiffening.items():
        pair = loads.PAIRS[name]
        formula, largest = loads.foremost(*pair, loads.TOP_SPEED), float(run.stiffness.max())
        values = {"pair": pair, "reading": reading, "formula": formula, "largest": largest}
        yield {**values, "run": run, "pitch": float(run.pitch.min())}


TABLES: dict[str, Callable[[Any], Rows]] = {
    "chicane": chicane_rows,
    "models": lambda results: (
        of_chicane(results, kind) for kind in ("uc", "table", *control.REGRESSED)
    ),
    "online": online_rows,
    "resistance": resistance_rows,
    "readings": reading_rows,
    "noise": lambda results: (
        {"noise": noise, **of_chicane(results, kind, noise=noise)}
        for kind, noise in product(control.KINDS, (control.NOISE, control.LOUD[0].noise))
    ),
    "integrators": lambda results: (
        {"name": name, **{kind: results.integrators[name, kind] for kind in control.KINDS}}
        for name in control.INTEGRATORS
    ),
    "predicted": prediction_rows,
    "regressions": regression_rows,
    "sizes": size_rows,
    "tracked": tracking_rows,
    "seconds": lambda results: (
        {"name": name, "printed": f"{TABLE_5[name]:g}" if name in TABLE_5 else "", "one": one}
        for name, one in results.planning.seconds.items()
    ),
    "replays": replay_rows,
    "levels": level_rows,
    "slope_slip": lambda results: (
        {"name": name, "scores": scores}
        for name, scores in results.slopes.identification.scores.items()
    ),
    "side_slopes": lambda results: (
        {"speed": speed, "alpha": np.abs(alpha)}
        for speed, alpha in zip(
            slopes.STRAIGHT, results.slopes.identification.side_slip, strict=True
        )
    ),
    "grounds": lambda results: (
        {"ground": ground, "slopes": slopes.steepness(ground)} for ground in results.slopes.grounds
    ),
    "loads": load_rows,
    "stiffening": stiffening_rows,
    "slope_chicane": lambda results: (
        {"case": case, "name": NAMES["slopes"][case.kind], "one": slopes.tracking(run)}
        for case, run in results.slopes.closed_loop.items()
    ),
}
PAGE = PaperPage(
    "focchi2025", words_of(__file__), outcomes, TABLES, (control_figures.drawings,), vars(slopes)
)
