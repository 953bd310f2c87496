"""Section 7.2: plans tracked on the distributed plant by both controllers, Table 4, and all runs.

200 Hz, ideal sensors, k_p = 10, k_phi = 1, no noise. UC follows the body of a plan (yaw, belt
speeds), SLC its course (`baselines.planners.trajectory`); the code of F gives both the body, which
`exchanged` pairs do.
    start  "rest": at the start, standing, as in F; "moving": as the plan begins
The errors are those of Table 4 as its code computes them: RMSE over the time of the plan, against
the plan, of the distance and of the heading (for SLC of e_phi + alpha, that of the motion).
Vehicles that share a controller are one batch; blocks of it have plans of like duration.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from baselines.lyapunov.slippage_aware import SlippageAwarePolicy, UnicyclePolicy
from baselines.planners.trajectory import Trajectory
from baselines.slip.slip_models import NoSlip, SlipModel
from baselines.slip.slip_sweep import identified_slip
from reproduce import Say
from reproduce.focchi2025 import planning as coded
from reproduce.focchi2025.control import LENGTHS, SLOWEST, patches
from reproduce.focchi2025.planning import FIGURE_16, Ground, Seconds, Unwrapped, plans
from reproduce.policy_runs import SPROCKETS, Drive, Floats, follow, side_by_side
from tracked_env.benchmark.files import machine
from tracked_env.physics.parameters import PlantParameters

RATE = 200.0  # [Hz] of control
STEP = 2.5e-3  # [s] of integration
BLOCK = 50  # vehicles that are driven together
FRAMES = {"uc": "body", "slc": "course"}  # what each controller follows
AT_LIMIT = 0.999  # [-] of the sprocket limit: saturated


class Pair(NamedTuple):
    """A planner and a controller."""

    controller: str  # uc, slc
    planner: str  # of planning.PLANNERS
    exchanged: bool = False  # whether the controller follows the other frame

    @property
    def frame(self) -> str:
        """Of Trajectory.at."""
        other = {"uc": "course", "slc": "body"}
        return (other if self.exchanged else FRAMES)[self.controller]

    @property
    def name(self) -> str:
        """As in Table 4."""
        planner = {"dubins": "DP", "clothoid": "CP", "optimal": "SLP"}
        kind, _, rest = self.planner.partition(", ")
        name = f"{self.controller.upper()}-{planner[kind]}"
        return name + (f" ({rest})" if rest else "") + (" (exchanged)" if self.exchanged else "")


def both(planner: str, exchanged: bool = False) -> tuple[Pair, Pair]:
    """A planner with each controller."""
    return Pair("uc", planner, exchanged), Pair("slc", planner, exchanged)


PRINTED = (*both("dubins"), *both("clothoid"), *both("optimal"))
VARIABLE, FROM_ZERO = Pair("slc", "optimal, variable"), Pair("slc", "optimal, from 0")
REST, EXCHANGED = both("optimal, rest to rest"), both("optimal", True)
WIDE, TIGHT = both("dubins, 0.5 m"), both("dubins, 0.16 m")
# As the code of F: plans that add beta, and the body of the plan for both controllers.
AS_CODED = tuple(Pair(kind, "optimal, beta added", kind == "slc") for kind in ("uc", "slc"))
USUAL = (*PRINTED, VARIABLE)
ALL = (*USUAL, *AS_CODED, FROM_ZERO, *REST, *TIGHT, *WIDE, *EXCHANGED)


class Tracked(NamedTuple):
    """Errors of one pair, (N,) goals each."""

    distance: Floats  # [m] RMSE of e_xy
    heading: Floats  # [rad] RMSE of e_phi, or of e_phi + alpha
    missed: Floats  # [m] distance to the goal at the end of the plan
    turned: Floats  # [rad] yaw to the goal there
    duration: Floats  # [s] of the plan
    saturated: Floats  # [-] share of the time with a sprocket at its limit


class Job(NamedTuple):
    """One vehicle."""

    pair: Pair
    number: int  # of its goal
    trajectory: Trajectory


def begin(trajectory: Trajectory, start: str) -> tuple[Floats, Floats]:
    """State (6,) and sprocket speeds (2,) at the start of a plan."""
    t = trajectory
    state, sprockets = np.zeros(6), np.zeros(2)
    state[:3] = t.x[0], t.y[0], t.yaw[0]
    if start == "moving":
        alpha = t.course[0] - t.yaw[0]
        state[3:] = t.speed[0] * math.cos(alpha), t.speed[0] * math.sin(alpha), t.yaw_rate[0]
        sprockets[:] = t.sprocket_left[0], t.sprocket_right[0]
    return state, sprockets


def controller(kind: str, vehicle: PlantParameters) -> SlippageAwarePolicy:
    """uc, or slc with the slip of the vehicle on its soil."""
    if kind == "uc":
        return UnicyclePolicy(vehicle, 1.0 / RATE)
    return SlippageAwarePolicy(vehicle, 1.0 / RATE, identified_slip(vehicle))


def drive(jobs: Sequence[Job], ground: Ground, start: str) -> Drive:
    """One batch of jobs with one controller, until the longest plan has ended."""
    vehicle = ground.vehicle
    longest = max(job.trajectory.duration for job in jobs)
    time = np.arange(math.ceil(longest * RATE) + 1) / RATE
    reference = side_by_side(
        [job.trajectory.at(time, job.pair.frame, vehicle)._asdict() for job in jobs]
    )
    reference["jerk"] = np.zeros_like(reference["x"])
    plant = patches(vehicle, len(jobs), False, STEP)
    states, sprockets = zip(*(begin(job.trajectory, start) for job in jobs), strict=True)
    plant.states[:, :6] = states
    policy = controller(jobs[0].pair.controller, vehicle)
    return follow(policy, plant, reference, None, vehicle, RATE, sprockets=np.array(sprockets))


def errors(run: Drive, job: Job) -> tuple[Floats, Floats]:
    """(T,) e_xy [m] and e_phi, or e_phi + alpha [rad], of a run of one vehicle, over its plan."""
    during = run.time < job.trajectory.duration
    v_x, v_y = (run.truth[name][during, 0] for name in ("v_x", "v_y"))
    heading = run.heading[during, 0]
    if job.pair.controller == "slc":
        moving = np.abs(v_x) > SLOWEST
        heading = heading + np.arctan(np.where(moving, v_y, 0.0) / np.where(moving, v_x, 1.0))
    return run.distance[during, 0], heading


def score(run: Drive, job: Job, goal: Floats, limit: float) -> list[float]:
    """Fields of Tracked of a run of one vehicle; limit [rad/s]: of the sprockets."""
    distance, heading = errors(run, job)
    last = len(distance)
    x, y, yaw = (run.truth[name][last, 0] for name in ("x", "y", "yaw"))
    sprockets = np.stack([run.truth[name][:last, 0] for name in SPROCKETS])
    return [
        float(np.sqrt(np.mean(np.square(distance)))),
        float(np.sqrt(np.mean(np.square(heading)))),
        math.hypot(x - goal[0], y - goal[1]),
        abs(math.remainder(yaw - goal[2], 2.0 * math.pi)),
        job.trajectory.duration,
        float(np.mean(np.abs(sprockets).max(axis=0) >= AT_LIMIT * limit)),
    ]


def track(ground: Ground, start: str, pairs: Sequence[Pair], goals: Floats) -> dict[Pair, Tracked]:
    """Every pair to every goal (N, 3); start: "rest" or "moving"."""
    trajectories = {pair.planner: plans(ground, pair.planner, goals) for pair in pairs}
    failed = [name for name, group in trajectories.items() if not all(t.converged for t in group)]
    assert not any(name.startswith("optimal") for name in failed), failed
    limit = ground.vehicle.sprocket_speed_limit
    scores = {pair: np.empty((len(Tracked._fields), len(goals))) for pair in pairs}
    for kind in dict.fromkeys(pair.controller for pair in pairs):
        jobs = [
            Job(pair, number, one)
            for pair in pairs
            if pair.controller == kind
            for number, one in enumerate(trajectories[pair.planner])
        ]
        for block in blocks(jobs):
            run = drive(block, ground, start)
            for i, job in enumerate(block):
                alone, goal = run.part(slice(i, i + 1)), goals[job.number]
                scores[job.pair][:, job.number] = score(alone, job, goal, limit)
    return {pair: Tracked(*values) for pair, values in scores.items()}


def blocks(jobs: Sequence[Job]) -> list[list[Job]]:
    """Jobs in blocks of like duration."""
    ordered = sorted(jobs, key=lambda job: job.trajectory.duration)
    return [ordered[i : i + BLOCK] for i in range(0, len(ordered), BLOCK)]


# All runs

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


class Planning(NamedTuple):
    """All runs of section 7.2."""

    tracked: dict[Setup, dict[Pair, Tracked]]
    shown: dict[Pair, tuple[Job, Drive]]  # the goal of figure 16, one vehicle each
    added: float  # [s] duration of the plan to that goal that adds beta
    unslipped: float  # [s] of the plan that knows no slip
    ratios: dict[float, float]  # {inner radius [m]: clothoid over Dubins, mean durations}
    nearer: int  # goals of the code's annulus that the printed one does not have
    unwrapped: Unwrapped
    dubins: Floats  # [s] durations of the Dubins paths
    replays: dict[str, Floats]  # [m] (N,) to the goals on the model (27), by what is known of slip
    levels: dict[tuple[str, str], Trajectory]  # 7.2.2, {(sign of beta, level): plan}
    soils: dict[float, Trajectory]  # {mu: plan} with identified slip
    seconds: dict[str, Seconds]  # Table 5
    machine: str


def figure_16() -> dict[Pair, tuple[Job, Drive]]:
    """The goal of figure 16, by all pairs of Table 3."""
    ground, start = SHOWN
    goal = np.array([FIGURE_16])
    jobs = [Job(pair, 0, plans(ground, pair.planner, goal)[0]) for pair in USUAL]
    return {job.pair: (job, drive([job], ground, start)) for job in jobs}


def replays(ground: Ground, goals: Floats) -> dict[str, Floats]:
    """Distance [m] (N,) to the goals after the sprocket speeds of plans at constant speed, by what
    these know: the slip of the model, none, its slip with beta added, (54)."""
    table = identified_slip(ground.vehicle)
    models: dict[str, SlipModel] = {
        "table": table,
        "none": NoSlip(),
        "added": coded.AddedSlip(table),
        "exponential": coded.exponential(ground),
    }
    return {
        name: coded.replayed(plans(ground, "optimal", goals, model), ground.vehicle, goals)
        for name, model in models.items()
    }


def computation(ground: Ground, goals: Floats) -> dict[str, Seconds]:
    """Table 5: one goal at a time, sampled every 20 ms, end checked."""
    cases: dict[str, tuple[str, SlipModel | None]] = {name: (name, None) for name in TIMED}
    cases["optimal, (54)"] = "optimal", coded.exponential(ground)

    def spent(name: str, slip: SlipModel | None) -> Seconds:
        return coded.seconds(lambda goal: plans(ground, name, goal[None], slip), goals)

    return {label: spent(*case) for label, case in cases.items()}


def run_all(say: Say = lambda text: None) -> Planning:
    """Run all; say(text) reports which ones come next."""
    ground, every = SHOWN.ground, coded.halton_goals(GOALS)
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
        goals = coded.halton_goals(GOALS, nearest)
        means = [
            coded.durations(plans(ground, name, goals)).mean() for name in ("clothoid", "dubins")
        ]
        ratios[nearest] = float(means[0] / means[1])
    about, goal = machine(), np.array([FIGURE_16])
    added = plans(ground, "optimal, beta added", goal)[0].duration
    unslipped = plans(ground, "optimal", goal, NoSlip())[0].duration
    nearer = int(np.sum(np.hypot(*every[:, :2].T) < 2.0))
    return Planning(
        tracked, figure_16(), added, unslipped, ratios, nearer,
        coded.unwrapped(ground, every), coded.durations(plans(ground, "dubins", every)),
        replays(ground, every), coded.levels(ground), coded.soils(ground),
        computation(ground, every), f"{about['processor']}, {about['cores']} cores",
    )  # fmt: skip
