"""Everything that the page is made of, from one call."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from baselines.slip.slip_sweep import identified_slip
from reproduce.focchi2025 import control, identification
from reproduce.focchi2025 import planning as planning_runs
from reproduce.focchi2025 import slopes as slope_runs
from reproduce.focchi2025.control import Case, Spiral
from reproduce.focchi2025.identification import Identifications
from reproduce.focchi2025.planning import Planning
from reproduce.focchi2025.runs import LENGTHS, Floats, Numbers, Run, vehicle
from reproduce.focchi2025.slopes import Slopes


class Results(NamedTuple):
    """All runs."""

    identification: Identifications
    spiral: dict[str, Spiral]  # "uc", "slc"
    chicane: dict[Case, Run]
    readings: dict[tuple[str, float, float, str], Numbers]  # reading of (53), length, c_r, kind
    integrators: dict[tuple[str, str], Run]  # integrator, kind
    predicted: dict[Case, tuple[Floats, Floats, Floats]]  # slip (T,) of the first vehicle
    slopes: Slopes  # sections 4.5 and 8
    planning: Planning  # sections 6 and 7.2


def predicted_slip(case: Case, run: Run) -> tuple[Floats, Floats, Floats]:
    """beta_left, beta_right, alpha that the controller of a case expects of its first vehicle."""
    model = identified_slip(vehicle(case.length, case.believed, case.believed_resistance))
    left, right = (run.sprockets[:, side, 0].copy() for side in range(2))
    beta_left, beta_right, alpha = model.slip(left, right)
    return beta_left, beta_right, alpha


def run_everything(
    say: Callable[[str], None] = lambda text: None,
    measured: Path | None = None,
    terrain: Path | None = None,
) -> Results:
    """Run all experiments; say(text) reports which ones come next.

    measured: file of the runs of the real vehicle, None is `identification.MEASURED`. terrain: the
    authors' height map, None is `uneven_ground.MAP`.
    """
    say("figures 6 to 9: identification of slip")
    identified = identification.run_all(measured)
    if identified.missing:
        say(identified.missing)
    if identified.measured is None:
        say("runs of the real vehicle: no file, left out")
    say("figure 10: spiral")
    spirals = control.run_all()
    say("figures 12 to 14: chicane")
    trees = [case for case in control.MODELS if case.kind == "trees"]
    cases = [*control.PAPER, *control.MODELS, *control.ONLINE, *control.RESISTANCES, *control.LOUD]
    if identified.missing:
        cases = [case for case in cases if case not in trees]
    driven = control.drive(list(dict.fromkeys(cases)))
    say("readings of (53), integrators")
    read, integrated = control.readings(), control.integrators()
    shown = [Case("table", length, control.RATES[0]) for length in LENGTHS]
    predicted = {case: predicted_slip(case, driven[case]) for case in shown}
    slopes = slope_runs.run_all_slope_runs(say, terrain)
    planning = planning_runs.run_all(say)
    return Results(identified, spirals, driven, read, integrated, predicted, slopes, planning)
