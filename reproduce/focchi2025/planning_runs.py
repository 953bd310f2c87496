"""Section 7.2: everything that its claims, tables and figures are made of."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from baselines.lyapunov.pseudo_kinematic import NoSlip, SlipModel
from baselines.planners.trajectory import Trajectory
from baselines.slip.slip_sweep import identified_slip
from reproduce.focchi2025 import planning_as_coded as coded
from reproduce.focchi2025.planning import (
    FIGURE_16,
    AddedSlip,
    Ground,
    Seconds,
    durations,
    halton_goals,
    plans,
    seconds,
)
from reproduce.focchi2025.planning_as_coded import Unwrapped
from reproduce.focchi2025.planning_loop import (
    ALL,
    AS_CODED,
    USUAL,
    Job,
    Pair,
    Tracked,
    drive,
    track,
)
from reproduce.focchi2025.runs import LENGTHS, Floats, Run
from tracked_env.benchmark.provenance import machine

TIMED = ("dubins", "clothoid", "optimal", "optimal, variable", "optimal, from 0")
SOME = 40  # goals, of the setups that the paper does not have
GOALS = 100


class Setup(NamedTuple):
    """What the pairs of one comparison share."""

    ground: Ground
    start: str  # rest, moving


PAPER = {length: Setup(Ground(length), "rest") for length in LENGTHS}
MOVING = {length: Setup(Ground(length, reserve=0.1), "moving") for length in LENGTHS}
SLIPPERY = [
    Setup(Ground(length, 0.1, reserve), start)
    for length in LENGTHS
    for start, reserve in (("rest", 0.0), ("moving", 0.25))
]
# One clothoid is 59 m long, and driven alone takes longer than all the other plans together.
QUICK = tuple(pair for pair in USUAL if pair.planner != "clothoid")
SHOWN = Setup(Ground(), "rest")  # of figures 16 and 17


class Replays(NamedTuple):
    """Distance [m] (N,) to the goals after the sprocket speeds of plans on the model (27)."""

    table: Floats  # the planner knows the slip of the model
    none: Floats  # it knows no slip
    added: Floats  # it adds beta
    exponential: Floats  # it knows (54)


class Planning(NamedTuple):
    """All runs of section 7.2."""

    tracked: dict[Setup, dict[Pair, Tracked]]
    shown: dict[Pair, tuple[Job, Run]]  # the goal of figure 16, one vehicle each
    added: float  # [s] duration of the plan to that goal that adds beta
    unslipped: float  # [s] of the plan that knows no slip
    ratios: dict[float, float]  # {inner radius [m]: clothoid over Dubins, mean durations}
    nearer: int  # goals of the code's annulus that the printed one does not have
    unwrapped: Unwrapped
    dubins: Floats  # [s] durations of the Dubins paths
    replays: Replays
    levels: dict[tuple[str, str], Trajectory]  # 7.2.2, {(sign of beta, level): plan}
    soils: dict[float, Trajectory]  # {mu: plan} with identified slip
    seconds: dict[str, Seconds]  # Table 5
    machine: str


def figure_16() -> dict[Pair, tuple[Job, Run]]:
    """The goal of figure 16, by all pairs of Table 3."""
    found = {}
    for pair in USUAL:
        goal = np.array([FIGURE_16])
        job = Job(pair, 0, plans(SHOWN.ground, pair.planner, goal)[0])
        found[pair] = (job, drive([job], SHOWN.ground, SHOWN.start))
    return found


def replays(ground: Ground, goals: Floats) -> Replays:
    """Plans at constant speed, by what they know of slip."""
    table = identified_slip(ground.vehicle)
    models = (table, NoSlip(), AddedSlip(table), coded.exponential(ground))
    return Replays(
        *(
            coded.replayed(plans(ground, "optimal", goals, model), ground.vehicle, goals)
            for model in models
        )
    )


def computation(ground: Ground, goals: Floats) -> dict[str, Seconds]:
    """Table 5: one goal at a time, sampled every 20 ms, end checked."""
    fitted = coded.exponential(ground)
    asked: dict[str, tuple[str, SlipModel | None]] = {name: (name, None) for name in TIMED}
    asked["optimal, (54)"] = "optimal", fitted
    found = {}
    for label, (name, model) in asked.items():

        def call(goal: Floats, name: str = name, model: SlipModel | None = model) -> object:
            return plans(ground, name, goal[None], model)

        found[label] = seconds(call, goals)
    return found


def run_all(say: Callable[[str], None] = lambda text: None) -> Planning:
    """Run all; say(text) reports which ones come next."""
    ground, every = SHOWN.ground, halton_goals(GOALS)
    some = every[:SOME]
    tracked = {}
    for length, setup in PAPER.items():
        say(f"table 4: plans tracked with both controllers, {length:g} m")
        pairs = ALL if length == SHOWN.ground.length else (*USUAL, *AS_CODED)
        tracked[setup] = track(*setup, pairs, every)
    for setup in (*MOVING.values(), *SLIPPERY):
        say(f"the same, mu = {setup.ground.friction:g}, {setup.start}, {setup.ground.length:g} m")
        pairs = USUAL if setup == MOVING[SHOWN.ground.length] else QUICK
        tracked[setup] = track(*setup, pairs, some)
    say("figures 16 to 18, table 5, signs and conventions of the planner")
    ratios = {}
    for nearest in (1.0, 2.0):
        drawn = halton_goals(GOALS, nearest)
        found = [durations(plans(ground, name, drawn)).mean() for name in ("clothoid", "dubins")]
        ratios[nearest] = float(found[0] / found[1])
    about, goal = machine(), np.array([FIGURE_16])
    added = plans(ground, "optimal, beta added", goal)[0].duration
    unslipped = plans(ground, "optimal", goal, NoSlip())[0].duration
    nearer = int(np.sum(np.hypot(*every[:, :2].T) < 2.0))
    return Planning(
        tracked, figure_16(), added, unslipped, ratios, nearer,
        coded.unwrapped(ground, every), durations(plans(ground, "dubins", every)),
        replays(ground, every), coded.levels(ground), coded.soils(ground),
        computation(ground, every), f"{about['processor']}, {about['cores']} cores",
    )  # fmt: skip
