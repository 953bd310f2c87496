"""The tables of section 7.2: every pair in every condition, times of planners, replays."""

import numpy as np

from reproduce.focchi2025.planning_claims import TABLE_4, TABLE_5
from reproduce.focchi2025.planning_runs import PAPER, Planning
from reproduce.focchi2025.results import Results
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
