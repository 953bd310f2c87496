"""All runs of sections 4.5 and 8, on the seeded field and, where it lies, on the authors' map."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025 import slope_chicane, slope_identification
from reproduce.focchi2025.load_models import LOADS, OpenLoop, Stiffening
from reproduce.focchi2025.runs import Floats, Run, vehicle
from reproduce.focchi2025.slope_chicane import SlopeCase
from reproduce.focchi2025.slope_identification import SlopeIdentification
from reproduce.focchi2025.uneven_ground import UnevenGround, authors_map, field
from tracked_env.plants.terrain_rig import TerrainRig

SIDE_SLOPE = 0.25  # [rad]
STARTS, REACH = 16, 15.0  # vehicles of `spread`, [m] |x|, |y| of their starts at most
TIMED, TIMINGS = 0.2, 5  # [s] of driving that is timed, how often


class Slopes(NamedTuple):
    """All runs of sections 4.5 and 8."""

    missing: str  # why the authors' map is left out; "" when it is there
    grounds: list[UnevenGround]
    open_loop: dict[tuple[str, str, str], OpenLoop]  # ground, COMMANDS, load; HEADINGS
    scripted: dict[str, OpenLoop]  # load: from the place of the authors' open loop, on their map
    level: OpenLoop  # (53) on level ground, nonuniform
    spread: dict[str, Floats]  # [m] by ground: gaps of STARTS vehicles, (53)
    decay: dict[str, tuple[float, float]]  # [1/s] by damping: roll, closed form and plant
    side: tuple[float, float]  # [-] balance on SIDE_SLOPE: plant, closed form
    stiffening: dict[tuple[str, str], Stiffening]  # PAIRS, PER_AREA
    cost: dict[str, float]  # [us] process time of a step of 1 ms by load
    identification: SlopeIdentification
    closed_loop: dict[SlopeCase, Run]


def scattered() -> list[tuple[float, float, float]]:
    """STARTS anywhere on a ground: x, y [m], yaw [rad]."""
    rng = np.random.default_rng(8)
    places = rng.uniform(-REACH, REACH, (STARTS, 2))
    return [(float(x), float(y), float(rng.uniform(-np.pi, np.pi))) for x, y in places]


def cost(ground: UnevenGround) -> dict[str, float]:
    """Process time [us] of one step of 1 ms, by load; least of TIMINGS."""
    found = {}
    for load in LOADS:
        rig = TerrainRig(vehicle(friction=loads.FRICTION), {"terrain": ground.field, "load": load},
                         step=1e-3)  # fmt: skip
        rig.stand(*ground.start, 0.0)
        timings = []
        for _ in range(TIMINGS + 1):
            began = time.process_time()
            rig.advance([[5.0, 6.0]], TIMED)
            timings.append(time.process_time() - began)
        found[load] = 1e6 * min(timings[1:]) / (TIMED / 1e-3)
    return found


def run_all(say: Callable[[str], None] = lambda text: None, file: Path | None = None) -> Slopes:
    """Run everything; say(text) reports which runs come next. file: the map, None is MAP."""
    mapped, missing = authors_map(file)
    if missing:
        say(missing)
    grounds = [field()] if mapped is None else [mapped, field()]
    say("section 8.1: load models")
    open_loop, spread = {}, {}
    for ground in grounds:
        starts = [(*ground.start, heading) for heading in loads.HEADINGS]
        for commands in loads.COMMANDS:
            for load in LOADS:
                run = loads.drive(ground.field, load, starts, commands)
                open_loop[ground.name, commands, load] = run
        runs = [loads.drive(ground.field, load, scattered(), "(53)") for load in LOADS]
        spread[ground.name] = loads.gap(*runs)
    scripted = {
        load: loads.drive(mapped.field, load, [loads.SCRIPTED], "linear")
        for load in LOADS
        if mapped is not None
    }
    level = loads.drive("flat", "nonuniform", [(0.0, 0.0, 0.0)], "(53)")
    decay = {
        name: (loads.roll_decay(given), loads.measured_roll_decay(given))
        for name, given in loads.DAMPING.items()
    }
    side = loads.load_on_a_side_slope(SIDE_SLOPE)
    say("section 8.2: stiffness that grows with speed")
    stiffening = {
        (pair, reading): loads.stiffen(*loads.PAIRS[pair], per_area)
        for pair in loads.PAIRS
        for reading, per_area in loads.PER_AREA.items()
    }
    timed = cost(grounds[0])
    say("section 4.5: slip on slopes")
    found = slope_identification.run_all()
    say("section 8.3: chicane on slopes")
    closed = slope_chicane.drive(grounds, slope_chicane.cases(grounds))
    return Slopes(
        missing, grounds, open_loop, scripted, level, spread, decay, side, stiffening, timed, found,
        closed,
    )  # fmt: skip
