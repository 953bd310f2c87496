"""Everything that the page is made of, from one call."""

from collections.abc import Callable
from typing import NamedTuple

from reproduce.strawa2021 import control, identification, slip, soil, sweep
from reproduce.strawa2021.control import Drive
from reproduce.strawa2021.identification import Condition, Quality

REGRESSIONS = ("printed", "paper", "coupled")


class Results(NamedTuple):
    """All runs."""

    control: dict[tuple[str, str, float], control.Run]
    sweep: dict[tuple[str, float], sweep.Surface]
    identification: dict[Condition, Drive]
    by_path: dict[str, dict[tuple[float, float], Quality]]  # by regression
    by_noise: dict[str, dict[tuple[float, float], Quality]]
    by_start: dict[str, dict[float, Quality]]
    slip: slip.Slips
    soil: dict[str, soil.Soil]
    soil_noise: dict[str, dict[float, soil.Soil]]  # by ground and sigma of the slips
    soil_window: dict[int, soil.Soil]  # by window [control steps]


def run_everything(say: Callable[[str], None] = lambda text: None) -> Results:
    """Run all scenarios; say(text) reports which ones come next."""
    say("sections 8.1, 8.2: controller")
    controlled = control.run_all()
    say("figure 17: mass and inertia")
    surfaces = sweep.run_all()
    say("section 8.3.1: mass, inertia, resistance")
    identified = identification.run_all()
    by_path = {kind: identification.by_path(kind) for kind in REGRESSIONS}
    by_noise = {kind: identification.by_noise(kind) for kind in REGRESSIONS}
    by_start = {kind: identification.by_start(kind) for kind in REGRESSIONS}
    say("section 8.3.2: slip")
    slips = slip.run_all()
    say("section 8.3.3: soil")
    soils = soil.run_all()
    noise = {
        ground: soil.with_noise(soils["ideal"], soil.CASES.index(soil.Case("manoeuvre", ground)))
        for ground in soil.GROUNDS
    }
    windows = soil.by_window(soils["ideal"], soil.CASES.index(soil.Case("manoeuvre", "changing")))
    return Results(
        controlled, surfaces, identified, by_path, by_noise, by_start, slips, soils, noise, windows
    )
