"""Section 7.2: goals, and the plans to them, as the paper and its code have them.

Goals: scipy's Halton points as in the code, 4 (2 u - 1) in x and y, kept in an annulus from 1 m to
4 m and not from 2 m as printed (21 of the hundred are nearer). Start: (0, 0, 0).

    dubins     at v, turning radius at the limit of the sprockets, slip ignored
    clothoid   one G1 clothoid at v, whatever its length and curvature: none is bounded in F
    optimal    least time under slip (`baselines.planners.optimal`), v_min = v_max or v_min below;
               "rest to rest" begins and ends at rest, which no plan of F does
F has v = 0.4 m/s, sprockets up to 18 rad/s (10 at mu = 0.1, 7.1), and no other limit.

Section 6.3 and 7.2.2 with the conventions of the paper's code, one at a time.

added_slip  the forward map with beta added, (29) as printed: slip turns the vehicle more.
            Data and controller have beta = r omega - v_track, which is subtracted
unwrapped   the yaw of the goal in [0, 2 pi), to be reached as it stands: (52) does not wrap
levels      7.2.2: c_1 and c_2 of (54) times numbers of the code, instead of other soils

Table 4: plans tracked on the distributed plant, every planner with both controllers.

200 Hz, ideal sensors, k_p = 10, k_phi = 1, no noise. UC follows the body of a plan (yaw, belt
speeds), SLC its course (`baselines.planners.trajectory`); the code of F gives both the body, which
`exchanged` pairs do.
    start  "rest": at the start, standing, as in F; "moving": as the plan begins
The errors are those of Table 4 as its code computes them: RMSE over the time of the plan, against
the plan, of the distance and of the heading (for SLC of e_phi + alpha, that of the motion).
Vehicles that share a controller are one batch; blocks of it have plans of like duration.

Section 7.2: everything that its claims, tables and figures are made of.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from baselines.lyapunov.lyapunov_laws import PseudoKinematicModel
from baselines.lyapunov.slippage_aware import SlippageAwarePolicy, UnicyclePolicy
from baselines.planners import speed_along_path
from baselines.planners.curves import Path, clothoid
from baselines.planners.interior_point import make_stages, solve
from baselines.planners.optimal import optimal
from baselines.planners.plan import plan
from baselines.planners.planning_problem import Bounds, Task, make_work
from baselines.planners.slip_surface import surface_of
from baselines.planners.speed_along_path import driven
from baselines.planners.trajectory import Limits, Trajectory, hand_over
from baselines.slip.slip_models import ExponentialSlipModel, NoSlip, SlipModel
from baselines.slip.slip_regression import fit_exponential
from baselines.slip.slip_sweep import identified_slip, sweep
from reproduce.focchi2025.control import follow, patches
from reproduce.focchi2025.identification import within
from reproduce.focchi2025.runs import LENGTHS, Floats, Run, vehicle
from reproduce.focchi2025.runs import SLOWEST as SLOWEST_runs
from tracked_env.benchmark.store import machine
from tracked_env.physics.parameters import PlantParameters
from tracked_env.validation import checked_choice

ORIGIN = (0.0, 0.0, 0.0)
FIGURE_16 = (2.0, 2.5, -0.4)  # [m, m, rad] the goal of figures 16 and 17
SPEED = 0.4  # [m/s] v_max, and v_min at constant speed
SLOWEST = 0.15  # [m/s] v_min of "optimal, variable"
PERIOD = 0.02  # [s] between samples of a plan
FRICTION = 0.4  # [-] mu of 7.2
SLIPPERY = 0.1  # [-] mu of 7.1
FASTER, SLOWER = 18.0, 10.0  # [rad/s] omega_max of 7.2, and of 7.1 at SLIPPERY
REACH = 4.0  # [m] outer radius of the annulus, and half the edge of the square
NEAREST = 1.0  # [m] inner radius in the code; 2 m is printed
DRAWS = 400  # of which the first hundred inside count
PLANNERS = (
    "dubins", "clothoid", "optimal", "optimal, variable", "optimal, from 0",
    "optimal, beta added", "optimal, rest to rest", "dubins, 0.16 m", "dubins, 0.5 m",
)  # fmt: skip
RADII = {"dubins, 0.16 m": 0.16, "dubins, 0.5 m": 0.5}  # [m]; 0.106 m at the limit
V_MIN = {"optimal, variable": SLOWEST, "optimal, rest to rest": SLOWEST, "optimal, from 0": 0.0}
GENTLE = 5.0  # [rad/s^2] sprocket acceleration of "optimal, rest to rest"; F has no such limit


class Ground(NamedTuple):
    """A vehicle and its soil, and what plans leave to the controller."""

    length: float = LENGTHS[-1]  # [m] contact length
    friction: float = FRICTION  # [-] mu
    reserve: float = 0.0  # [-] share of the sprocket speed

    @property
    def vehicle(self) -> PlantParameters:
        """Table 2 on this soil."""
        return self.on(self.friction)

    def on(self, friction: float) -> PlantParameters:
        """The same vehicle, with the same sprockets, on another mu."""
        made = vehicle(self.length, friction)
        return made._replace(sprocket_speed_limit=self.sprocket_speed)

    @property
    def sprocket_speed(self) -> float:
        """omega_max [rad/s]: 18 in 7.2, 10 in 7.1."""
        return FASTER if self.friction > SLIPPERY else SLOWER

    def limits(self, v_min: float = SPEED, v_max: float = SPEED) -> Limits:
        """Those of F: sprockets and speed."""
        return Limits(self.sprocket_speed, self.reserve, v_min=v_min, v_max=v_max)


class AddedSlip(NamedTuple):
    """A slip model whose beta has the other sign, so that a planner adds it.

    (29) as printed does so in the forward map, and so does the code's planner: slip turns the
    vehicle more. Data and controller have beta = r omega - v_track, which is subtracted.
    """

    slip_model: SlipModel

    def slip(self, sprocket_left: Any, sprocket_right: Any) -> tuple[Floats, Floats, Floats]:
        """(beta_left, beta_right [m/s], alpha [rad])."""
        left, right, alpha = self.slip_model.slip(sprocket_left, sprocket_right)
        return -left, -right, alpha


@lru_cache(maxsize=8)
def _drawn(nearest: float) -> Floats:
    unit = qmc.Halton(d=3, scramble=True, seed=0).random(DRAWS)
    goals: Floats = np.stack(
        [*(REACH * (2.0 * unit[:, k] - 1.0) for k in (0, 1)), 2.0 * math.pi * unit[:, 2]], axis=1
    )
    distance = np.hypot(goals[:, 0], goals[:, 1])
    return goals[(nearest < distance) & (distance < REACH)]


def halton_goals(count: int = 100, nearest: float = NEAREST) -> Floats:
    """The first goals (N, 3) in an annulus from `nearest` to REACH [m], as the code draws them."""
    return _drawn(nearest)[:count].copy()


def plans(
    ground: Ground, planner: str, goals: Floats, slip: SlipModel | None = None
) -> list[Trajectory]:
    """Plans of one of PLANNERS to goals (N, 3). slip: None is the table of the ground's sweep.

    Raises ValueError for another planner.
    """
    checked_choice("planner", planner, PLANNERS)
    made = ground.vehicle
    limits = ground.limits(V_MIN.get(planner, SPEED))
    if planner == "clothoid":
        return [_clothoid(goal, limits, made) for goal in goals]
    if planner.startswith("dubins"):
        radius = RADII.get(planner, 0.0)
        bend = 1.0 / radius if radius else math.inf
        found = plan(ORIGIN, goals, limits._replace(curvature=bend), None, "dubins", made,
                     period=PERIOD)  # fmt: skip
    else:
        slip = identified_slip(made) if slip is None else slip
        slip = AddedSlip(slip) if planner == "optimal, beta added" else slip
        stop = planner == "optimal, rest to rest"
        if stop:
            limits = limits._replace(sprocket_acceleration=GENTLE)
        found = optimal(ORIGIN, goals, limits, made, slip, period=PERIOD, stop=stop)
    assert isinstance(found, list)
    return found


def _clothoid(goal: Floats, limits: Limits, made: PlantParameters) -> Trajectory:
    fitted = clothoid(ORIGIN, goal)
    path = Path.of(ORIGIN, fitted.length, fitted.curvature, fitted.sharpness)
    profile = speed_along_path.constant(path, SPEED, limits, made)
    return driven(path, profile, goal, limits, made, "clothoid", period=PERIOD)


class Seconds(NamedTuple):
    """CPU time of a plan [s]: median, and largest of all goals."""

    median: float
    worst: float


def seconds(call: Callable[[Floats], object], goals: Floats, repeats: int = 3) -> Seconds:
    """Of `call` for each goal, the least of some repeats; a first call is not counted."""
    call(goals[0])
    taken = np.empty((repeats, len(goals)))
    for round_ in range(repeats):
        for i, goal in enumerate(goals):
            began = process_time()
            call(goal)
            taken[round_, i] = process_time() - began
    least = taken.min(axis=0)
    return Seconds(float(np.median(least)), float(least.max()))


def durations(found: Sequence[Trajectory]) -> Floats:
    """[s] (N,)."""
    return np.array([one.duration for one in found])


INTERVALS = 40  # [-] N of Table 1
ITERATIONS = 200  # of the interior point method
FAST = 0.8  # [m/s] v_max of 7.2.2
IDENTIFIED = 10.0  # [rad/s] sprocket speeds up to which (54) is fitted, section 4
LEVELS = {"normal": (1.0, 1.0), "medium": (3.0, 0.5), "high": (4.0, 0.25)}  # [-] of c_1, of c_2
PRINTED_LEVELS = {"normal": 5.2, "medium": 4.9, "high": 4.12}  # [s] T of 7.2.2
SIGNS = {"subtracted": 1.0, "added": -1.0}  # of beta in the forward map
SUBSTEPS = 8  # of the model in a held interval


def replayed(found: Sequence[Trajectory], vehicle: PlantParameters, goals: Floats) -> Floats:
    """Distance (N,) [m] to the goals after the sprocket speeds of plans, on the model (27).

    Its slip is the table of the vehicle on its soil, with beta subtracted.
    """
    model, missed = PseudoKinematicModel(vehicle, identified_slip(vehicle)), []
    for made, goal in zip(found, goals, strict=True):
        pose = np.array([[made.x[0], made.y[0], made.yaw[0]]])
        inputs = np.stack([made.sprocket_left, made.sprocket_right], axis=1)[:-1]
        first = np.flatnonzero(np.append(True, np.any(np.diff(inputs, axis=0) != 0.0, axis=1)))
        times = np.append(made.time[first], made.time[-1])
        for speeds, duration in zip(inputs[first], np.diff(times), strict=True):
            for _ in range(SUBSTEPS):
                pose = model.step(pose, speeds[None], float(duration) / SUBSTEPS)
        missed.append(math.hypot(pose[0, 0] - goal[0], pose[0, 1] - goal[1]))
    return np.array(missed)


class Unwrapped(NamedTuple):
    """Plans at constant speed to yaws as the code has them, (N,) each."""

    duration: Floats  # [s]
    converged: Any  # (N,) bool
    turns: Floats  # [-] whole turns from the yaw of the shortest Dubins path to that of the goal


def unwrapped(ground: Ground, goals: Floats) -> Unwrapped:
    """From the Dubins path, as in F, to the yaw in [0, 2 pi) as it stands."""
    vehicle, limits = ground.vehicle, ground.limits()
    half, belt = 0.5 * vehicle.track_gauge, vehicle.sprocket_radius * limits.sprocket_used
    surface = surface_of(identified_slip(vehicle), vehicle, limits.sprocket_used, SPEED)
    none = math.inf
    bounds = Bounds(float(belt), SPEED, SPEED, none, none, none, none, float(half), True, False)
    w, a = make_work(INTERVALS), make_stages(INTERVALS)
    rows = []
    for goal, guess in zip(goals, plans(ground, "dubins, 0.5 m", goals), strict=True):
        x, y, yaw = (float(value) for value in goal)
        task = Task(0.0, x, y, yaw, 0.0, 0.0, False, 0, 0, 1.0)
        knots = np.linspace(0.0, guess.duration, INTERVALS + 1)
        turned = np.diff(np.interp(knots, guess.time, guess.course)) / np.diff(knots)
        w.belts[:, 0], w.belts[:, 1] = SPEED, half * turned
        duration, _cost, converged, _used = solve(
            task, bounds, surface, guess.duration, w, a, ITERATIONS, math.inf
        )
        rows.append((duration, converged, (yaw - guess.course[-1]) / (2.0 * math.pi)))
    found = np.array(rows, dtype=float).T
    return Unwrapped(found[0], found[1] > 0.0, np.round(found[2]))


def exponential(ground: Ground) -> ExponentialSlipModel:
    """(54) fitted to the runs of the ground's sweep up to IDENTIFIED."""
    vehicle = ground.vehicle
    return fit_exponential(within(sweep(vehicle), IDENTIFIED), vehicle)[0]


def levels(ground: Ground) -> dict[tuple[str, str], Trajectory]:
    """{(sign of SIGNS, level of LEVELS): plan of 7.2.2 to the goal of figure 16}."""
    fitted, found = exponential(ground), {}
    for sign, factor in SIGNS.items():
        for level, times in LEVELS.items():
            constants = fitted.constants * np.array(times)
            constants[:2, 0] *= factor
            model = ExponentialSlipModel(constants, fitted.track_gauge)
            made = optimal(ORIGIN, FIGURE_16, ground.limits(0.0, FAST), ground.vehicle, model)
            assert isinstance(made, Trajectory)
            found[sign, level] = made
    return found


def soils(ground: Ground, frictions: Sequence[float] = (0.4, 0.2, 0.1)) -> dict[float, Trajectory]:
    """{mu: plan to the goal of figure 16 with v in [0, FAST] and the slip identified there}."""
    found = {}
    for friction in frictions:
        slippery = ground.on(friction)
        made = optimal(
            ORIGIN, FIGURE_16, ground.limits(0.0, FAST), slippery, identified_slip(slippery)
        )
        assert isinstance(made, Trajectory)
        found[friction] = made
    return found


RATE = 200.0  # [Hz] of control
STEP = 2.5e-3  # [s] of integration
PER_STEP = 40.0  # [-] vehicles whose steps take as long as what a step of any block does
FRAMES = {"uc": "body", "slc": "course"}  # what each controller follows
AT_LIMIT = 0.999  # [-] of the sprocket limit: saturated


class Pair(NamedTuple):
    """A planner and a controller."""

    controller: str  # uc, slc
    planner: str  # of planning.PLANNERS
    exchanged: bool = False  # whether the controller follows the other frame

    @property
    def frame(self) -> str:
        """Of hand_over."""
        other = {"uc": "course", "slc": "body"}
        return (other if self.exchanged else FRAMES)[self.controller]

    @property
    def name(self) -> str:
        """As in Table 4."""
        planner = {"dubins": "DP", "clothoid": "CP", "optimal": "SLP"}
        kind, _, rest = self.planner.partition(", ")
        name = f"{self.controller.upper()}-{planner[kind]}"
        return name + (f" ({rest})" if rest else "") + (" (exchanged)" if self.exchanged else "")


PRINTED = tuple(
    Pair(controller, planner)
    for planner in ("dubins", "clothoid", "optimal")
    for controller in ("uc", "slc")
)
VARIABLE, FROM_ZERO = Pair("slc", "optimal, variable"), Pair("slc", "optimal, from 0")
REST = tuple(Pair(controller, "optimal, rest to rest") for controller in ("uc", "slc"))
WIDE = tuple(Pair(controller, "dubins, 0.5 m") for controller in ("uc", "slc"))
TIGHT = tuple(Pair(controller, "dubins, 0.16 m") for controller in ("uc", "slc"))
# As the code of F: plans that add beta, and the body of the plan for both controllers.
AS_CODED = tuple(Pair(kind, "optimal, beta added", kind == "slc") for kind in ("uc", "slc"))
EXCHANGED = tuple(Pair(controller, "optimal", True) for controller in ("uc", "slc"))
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


def begin(job: Job, start: str, vehicle: PlantParameters) -> tuple[Floats, Floats]:
    """State (6,) and sprocket speeds (2,) at the start of a plan."""
    t = job.trajectory
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


def drive(jobs: Sequence[Job], ground: Ground, start: str) -> Run:
    """One batch of jobs with one controller, until the longest plan has ended."""
    vehicle = ground.vehicle
    longest = max(job.trajectory.duration for job in jobs)
    time = np.arange(math.ceil(longest * RATE) + 1) / RATE
    shown = [
        hand_over(job.trajectory, time, vehicle, job.pair.frame)._asdict() for job in jobs
    ]  # fmt: skip
    reference = {name: np.stack([one[name] for one in shown], axis=1) for name in shown[0]}
    reference["jerk"] = np.zeros_like(reference["x"])
    plant = patches(vehicle, len(jobs), False, STEP)
    states, sprockets = zip(*(begin(job, start, vehicle) for job in jobs), strict=True)
    plant.states[:, :6] = states
    policy = controller(jobs[0].pair.controller, vehicle)
    return follow(policy, plant, reference, None, vehicle, RATE, sprockets=np.array(sprockets))


def errors(run: Run, job: Job) -> tuple[Floats, Floats]:
    """(T,) e_xy [m] and e_phi, or e_phi + alpha [rad], of a run of one vehicle, over its plan."""
    during = run.time < job.trajectory.duration
    state, heading = run.state[during, :, 0], run.heading[during, 0]
    if job.pair.controller == "slc":
        moving = np.abs(state[:, 3]) > SLOWEST_runs
        heading = heading + np.arctan(
            np.where(moving, state[:, 4], 0.0) / np.where(moving, state[:, 3], 1.0)
        )
    return run.distance[during, 0], heading


def score(run: Run, job: Job, goal: Floats, limit: float) -> list[float]:
    """Fields of Tracked of a run of one vehicle; limit [rad/s]: of the sprockets."""
    distance, heading = errors(run, job)
    last = len(distance)
    end = run.state[last, :3, 0]
    return [
        float(np.sqrt(np.mean(np.square(distance)))), float(np.sqrt(np.mean(np.square(heading)))),
        math.hypot(end[0] - goal[0], end[1] - goal[1]),
        abs(math.remainder(end[2] - goal[2], 2.0 * math.pi)), job.trajectory.duration,
        float(np.mean(np.abs(run.sprockets[:last, :, 0]).max(axis=1) >= AT_LIMIT * limit)),
    ]  # fmt: skip


def track(ground: Ground, start: str, pairs: Sequence[Pair], goals: Floats) -> dict[Pair, Tracked]:
    """Every pair to every goal (N, 3); start: "rest" or "moving"."""
    made = {name: plans(ground, name, goals) for name in dict.fromkeys(p.planner for p in pairs)}
    failed = [name for name in made if not all(p.converged for p in made[name])]
    assert not any(name.startswith("optimal") for name in failed), failed
    limit = ground.vehicle.sprocket_speed_limit
    found = {pair: np.empty((len(Tracked._fields), len(goals))) for pair in pairs}
    for kind in dict.fromkeys(pair.controller for pair in pairs):
        jobs = [
            Job(pair, number, one)
            for pair in pairs
            if pair.controller == kind
            for number, one in enumerate(made[pair.planner])
        ]
        for block in blocks(jobs):
            run = drive(block, ground, start)
            for i, job in enumerate(block):
                alone, goal = run.only(slice(i, i + 1)), goals[job.number]
                found[job.pair][:, job.number] = score(alone, job, goal, limit)
    return {pair: Tracked(*values) for pair, values in found.items()}


def blocks(jobs: Sequence[Job]) -> list[list[Job]]:
    """Jobs in blocks of like duration, so that the sum of their steps costs least."""
    ordered = sorted(jobs, key=lambda one: one.trajectory.duration)
    longest = np.array([job.trajectory.duration for job in ordered])
    best, begun = np.zeros(len(ordered) + 1), np.zeros(len(ordered) + 1, dtype=int)
    for last in range(len(ordered)):
        count = last + 1 - np.arange(last + 1)
        cost = best[: last + 1] + longest[last] * (PER_STEP + count)
        begun[last + 1], best[last + 1] = np.argmin(cost), np.min(cost)
    made, end = [], len(ordered)
    while end > 0:
        made.append(ordered[begun[end] : end])
        end = begun[end]
    return made[::-1]


TIMED = ("dubins", "clothoid", "optimal", "optimal, variable", "optimal, from 0")
SOME = 40  # goals, of the setups that the paper does not have
GOALS = 100


class Setup(NamedTuple):
    """What the pairs of one comparison share."""

    ground: Ground
    start: str  # rest, moving


PAPER = {length: Setup(Ground(length), "rest") for length in LENGTHS}
MOVING = {length: Setup(Ground(length, reserve=0.1), "moving") for length in LENGTHS}
SLIPPERY_PLANNING_RUNS = [
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
    models = (table, NoSlip(), AddedSlip(table), exponential(ground))
    return Replays(
        *(
            replayed(plans(ground, "optimal", goals, model), ground.vehicle, goals)
            for model in models
        )
    )


def computation(ground: Ground, goals: Floats) -> dict[str, Seconds]:
    """Table 5: one goal at a time, sampled every 20 ms, end checked."""
    fitted = exponential(ground)
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
    for setup in (*MOVING.values(), *SLIPPERY_PLANNING_RUNS):
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
        unwrapped(ground, every), durations(plans(ground, "dubins", every)),
        replays(ground, every), levels(ground), soils(ground),
        computation(ground, every), f"{about['processor']}, {about['cores']} cores",
    )  # fmt: skip
