"""Sections 4 to 8 of Focchi et al. (2025) as experiments that can be run again.

    control         5.2, 7.1   the controllers on a spiral and on the chicane: figures 10 to 14
    identification  4, 7.2.3   slip over the sprocket speeds: figures 6 to 9, exponential form
    planning        6, 7.2     goals and plans, conventions of the authors' code
    planning_loop   7.2        plans tracked by both controllers, figures 16, 17
    load_models     8.1, 8.2   nonuniform and uniform load, stiffness that grows: figure 21
    slopes          4.5, 8     the grounds, slip on slopes, the chicane there: figures 22 and 23
    claims, tables, control_figures  what the paper says, what comes out; words in page.toml
The vehicle is that of tracked_env; slip models and controllers are those of baselines.

References: [1] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025).
"""

from pathlib import Path
from typing import NamedTuple

from baselines.slip.slip_sweep import identified_slip
from reproduce.focchi2025 import control, control_figures, identification, planning_loop, slopes
from reproduce.focchi2025.claims import outcomes
from reproduce.focchi2025.control import LENGTHS, Case, Numbers, Spiral, vehicle
from reproduce.focchi2025.identification import Identifications
from reproduce.focchi2025.planning_loop import Planning
from reproduce.focchi2025.slopes import Slopes
from reproduce.focchi2025.tables import TABLES
from reproduce.paper_page import PaperPage, Say, words_of
from reproduce.policy_runs import SPROCKETS, Drive, Floats

__all__ = ["PAGE", "Results", "run_everything"]


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


PAGE = PaperPage(
    "focchi2025", words_of(__file__), outcomes, TABLES, (control_figures.drawings,), vars(slopes)
)
