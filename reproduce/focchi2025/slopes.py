"""Sections 4.5 and 8 on slopes: grounds, slip over the direction of gravity, the chicane, all runs.

Grounds. F drives on a mesh that was drawn in Blender and is published with the authors' code. Its
height map is not part of this project: `authors_map` reads it where it lies beside the project.
`field` is for everyone. Nine tenths of the map are nearly level and the rest are hills, so that its
slopes have a long tail: 90 % of them over the median is 10, where the heights of a Gaussian field
(any `fractal`) give 1.8. Therefore
    h = w ln(1 + exp((z - z_0) / w))
with z a fractal: hills where z exceeds z_0, level ground where it does not. Amplitude, z_0 and w
are fitted to the median, 90 % and 99 % of the slopes of the map; `steepness` computes them.

4.5: slip as a function of the sprocket speeds and of the direction of gravity, F (34). mu = 0.6 and
the vehicle of Table 2. The ramps of the paper have "inclinations from 0 to -0.3 rad in increments
of 0.5"; here both directions of the slope are swept in steps of 0.05. `PROBES` are runs that no
table has seen. On a side slope, driven straight and steadily, all forces along the ground balance:
F_g + (F_t, F_y) = 0, whatever the slip.

8.3: the chicane F (53) in closed loop, figures 22 and 23. Both controllers take the pose error in
the vehicle's plane, F (49) with the yaw counted once. The slippage-aware one has slip of level
ground ("flat") or over the direction of gravity: that of the load that acts ("slope"), or that of
uniform load whatever acts ("uniform"). c_0 = [15, 2, -2.9] m is read as a place and a heading. mu =
0.6, 0.6 m/s and 0.4 rad/s; control at 200 Hz; sprockets up to 18 rad/s, as in the authors' sweeps.

Reference: [1] Focchi et al. (2025), sections 4.5, 5.3 and 8.
"""

import time
from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from baselines.estimators.measurement import DataSheet
from baselines.lyapunov.lyapunov_laws import LyapunovGains
from baselines.lyapunov.slippage_aware import SlippageAwarePolicy, UnicyclePolicy
from baselines.slip.slip_models import SlipModel, TableSlipModel
from baselines.slip.slip_regression import determination
from baselines.slip.slip_sweep import identified_slip, identified_slope_slip, slip_data
from baselines.slip.slope_motion import steady_on_slopes
from reproduce import Say
from reproduce.focchi2025 import control
from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025.control import LENGTHS, vehicle
from reproduce.focchi2025.load_models import DURATION, FRICTION, HEIGHT, LOADS, OpenLoop, Stiffening
from reproduce.policy_runs import Drive, Floats, follow, sampled
from tracked_env import TERRAIN
from tracked_env.observation import make_layout
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.rigid_body import in_body_plane
from tracked_env.plants.standalone import TerrainRig
from tracked_env.sensors import PRESETS
from tracked_env.terrain.height_field import HeightField, make_height_field

# In a folder beside that of the project.
MAP = Path(__file__).parents[3] / "shared" / "data" / "terrain_mesh" / "height_5cm.npz"
FRACTAL: dict[str, Any] = {
    "kind": "fractal", "height": 0.67, "seed": 2, "hurst": 1.0, "longest": 30.0, "shortest": 8.0,
    "count": 32,
}  # fmt: skip
LEVEL, ROUNDING = 0.124, 0.112  # [m] z_0, w
HALF_SIDE, CELL = 29.5, 0.1  # [m] of the field; that of the map is the same
SHARES = (50.0, 90.0, 99.0)  # [%] of the slopes that are compared
SPROCKET_LIMIT = 18.0  # [rad/s] of the sweeps for this friction in the authors' code
SPEED_STEP = 2.25  # [rad/s]; slip is nearly linear between: 1.25 changes 8.3 by 0.1 mm
FINE, COARSE = 0.0875, 0.21875  # [-] of the grade over mu: 0.05 and 0.13 in the grade
PROBES = 400  # runs that no table has seen
FASTEST, STEEPEST = 10.0, 0.35  # [rad/s], [-] grade of the probes
SLOW = 0.05  # [m/s] |v_x| from which on alpha is compared
GRADES = np.linspace(0.05, 0.35, 7)  # [-] of the side slopes
STRAIGHT = (2.0, 5.0, 10.0)  # [rad/s] both sprockets on them
BEND = (4.0, 8.0)  # [rad/s] left, right of a left turn
SPEED, TURN, RATE = 0.6, 0.4, 200.0  # [m/s], [rad/s], [Hz]
HEADINGS = (-2.9, 0.0)  # [rad] c_0, and that of the authors' code
KINDS = ("uc", "flat", "slope", "uniform")
SHOWN = make_layout(TERRAIN["observation"])
SIDE_SLOPE = 0.25  # [rad]
STARTS, REACH = 16, 15.0  # vehicles of `spread`, [m] |x|, |y| of their starts at most
TIMED, TIMINGS = 0.2, 5  # [s] of driving that is timed, how often


class UnevenGround(NamedTuple):
    """A ground of section 8."""

    name: str
    field: HeightField
    start: tuple[float, float]  # [m] x, y of 8.3, on a flank that falls towards -x


def authors_map(file: Path | None = None) -> tuple[UnevenGround | None, str]:
    """The authors' map, None is MAP, and why it is missing ("": it is there)."""
    file = MAP if file is None else file
    if not file.exists():
        return None, f"height map of the authors: no file {file}, left out; the seeded field is run"
    spec = {"kind": "map", "file": str(file), "interpolation": "bilinear"}
    return UnevenGround("authors' map", make_height_field(spec), (15.0, 2.0)), ""


@lru_cache(maxsize=1)
def field() -> UnevenGround:
    """The seeded field: the same numbers everywhere."""
    axis = np.linspace(-HALF_SIDE, HALF_SIDE, round(2.0 * HALF_SIDE / CELL) + 1)
    z = make_height_field(FRACTAL).at(*np.meshgrid(axis, axis))[0]
    heights = ROUNDING * np.logaddexp(0.0, (z - LEVEL) / ROUNDING)
    hills = make_height_field({"kind": "map", "heights": heights, "cell": CELL})
    return UnevenGround("seeded field", hills, (1.7, 10.4))


def steepness(ground: UnevenGround) -> Floats:
    """SHARES of the slopes |dz/dx, dz/dy| [-] over the whole of a ground."""
    axis = np.arange(-HALF_SIDE + 0.5 * CELL, HALF_SIDE, CELL)
    _, slope_x, slope_y = ground.field.at(*np.meshgrid(axis, axis))
    return np.asarray(np.percentile(np.hypot(slope_x, slope_y), SHARES))


# Section 4.5


class SlopeIdentification(NamedTuple):
    """Everything of section 4.5."""

    scores: dict[str, Floats]  # R^2 of beta_left, beta_right, alpha on the probes by model
    steady: int  # probes with a steady motion
    side_slip: Floats  # (STRAIGHT, GRADES) [rad] alpha on side slopes that rise to the left
    loads: dict[str, Floats]  # [m/s] slip velocity uphill, downhill at 5 rad/s, grade 0.35
    bend: Floats  # (3, 2) yaw rate [rad/s] and v_y [m/s] of BEND: uphill, level, downhill
    uphill: float  # [-] share of left turns across a slope in which the vehicle slips to the right


def model(load: str, length: float = LENGTHS[-1], slope_step: float = FINE) -> TableSlipModel:
    """Slip on slopes of the vehicle of 8.3; kept after the first call."""
    return identified_slope_slip(parameters_of(length), load, SPEED_STEP, slope_step)


def probes() -> tuple[Floats, Floats]:
    """Sprocket speeds (PROBES, 2) [rad/s] and grades (PROBES, 2) [-], at random."""
    rng = np.random.default_rng(45)
    speeds = rng.uniform(-FASTEST, FASTEST, (PROBES, 2))
    size, way = STEEPEST * np.sqrt(rng.random(PROBES)), rng.uniform(-np.pi, np.pi, PROBES)
    return speeds, np.stack([size * np.cos(way), size * np.sin(way)], axis=1)


def identify() -> SlopeIdentification:
    """Tables, probes and side slopes."""
    parameters = vehicle(friction=FRICTION)
    speeds, grade = probes()
    motion = steady_on_slopes(parameters, speeds, grade)
    steady = np.isfinite(motion[:, 0])
    speeds, grade, motion = speeds[steady], grade[steady], motion[steady]
    left, right = speeds.T.copy()
    true = slip_data(parameters, left, right, motion)
    moving = np.abs(true.v_x) > SLOW
    models: dict[str, SlipModel] = {
        "steps of 0.05": model("nonuniform").on(grade),
        "steps of 0.13": model("nonuniform", slope_step=COARSE).on(grade),
        "uniform load": model("uniform").on(grade),
        "level ground": identified_slip(parameters),
    }
    scores = {}
    for name, one in models.items():
        beta_left, beta_right, alpha = one.slip(left, right)
        pairs = (
            (true.beta_left, beta_left),
            (true.beta_right, beta_right),
            (true.alpha[moving], alpha[moving]),
        )
        scores[name] = np.array([determination(*pair) for pair in pairs])
    across = np.stack([np.zeros_like(GRADES), -GRADES], axis=1)
    side = []
    for speed in STRAIGHT:
        steady_motion = steady_on_slopes(parameters, np.full((len(GRADES), 2), speed), across)
        side.append(np.arctan(steady_motion[:, 1] / steady_motion[:, 0]))
    hills, belt = np.array([[-STEEPEST, 0.0], [STEEPEST, 0.0]]), 5.0 * parameters.sprocket_radius
    slips = {
        load: belt - steady_on_slopes(parameters, np.full((2, 2), 5.0), hills, load)[:, 0]
        for load in ("nonuniform", "uniform")
    }
    along = np.array([[-0.2, 0.0], [0.0, 0.0], [0.2, 0.0]])
    bend = steady_on_slopes(parameters, np.tile(BEND, (3, 1)), along)[:, [2, 1]]
    turns = (left > 0.0) & (right > left + 1.0) & (np.abs(grade[:, 1]) > 0.15)
    uphill = float((true.v_y[turns] * grade[turns, 1] < 0.0).mean())
    return SlopeIdentification(scores, len(left), np.array(side), slips, bend, uphill)


# Section 8.3


class SlopeCase(NamedTuple):
    """A vehicle of 8.3 and its controller."""

    ground: str  # name of an UnevenGround
    kind: str  # one of KINDS
    load: str = "nonuniform"
    heading: float = HEADINGS[0]  # [rad] at the start
    length: float = LENGTHS[-1]  # [m]


class Tracking(NamedTuple):
    """Errors in the vehicle's plane, F figure 23."""

    mean: float  # [m]
    final: float  # [m]
    largest: float  # [m]
    heading: float  # [rad] largest, about the normal of the vehicle's plane
    pitch: tuple[float, float]  # [rad] least and largest, nose down


def cases(grounds: Sequence[UnevenGround]) -> list[SlopeCase]:
    """What is driven: both headings on every ground; on the first one also uniform load, and the
    unicycle controller with the shorter contact length."""
    every = [
        SlopeCase(ground.name, kind, heading=heading)
        for ground, kind, heading in product(grounds, KINDS, HEADINGS)
    ]
    first = SlopeCase(grounds[0].name, "uc")
    every += [first._replace(kind=kind, load="uniform") for kind in KINDS[:3]]
    return [*every, first._replace(length=LENGTHS[0])]


def parameters_of(length: float) -> PlantParameters:
    """Table 2 with mu = 0.6 and the faster sprockets."""
    return vehicle(length, FRICTION)._replace(sprocket_speed_limit=SPROCKET_LIMIT)


def policy(kind: str, load: str, length: float) -> SlippageAwarePolicy:
    """A controller of KINDS with the gains of F and ideal sensors."""
    parameters, period = parameters_of(length), 1.0 / RATE
    options = (LyapunovGains(), DataSheet.of(PRESETS["ideal"]), SHOWN.names)
    if kind == "uc":
        return UnicyclePolicy(parameters, period, *options)
    slip: SlipModel = identified_slip(parameters)
    if kind != "flat":
        slip = model(load if kind == "slope" else "uniform", length)
    return SlippageAwarePolicy(parameters, period, slip, *options)


def drive(grounds: Sequence[UnevenGround], every: Sequence[SlopeCase]) -> dict[SlopeCase, Drive]:
    """Drive all cases; those that differ in the heading alone as one batch."""
    by_name = {ground.name: ground for ground in grounds}
    runs = {}
    for alike in dict.fromkeys(case._replace(heading=HEADINGS[0]) for case in every):
        members = [case for case in every if case._replace(heading=HEADINGS[0]) == alike]
        ground, parameters = by_name[alike.ground], parameters_of(alike.length)
        options = {"terrain": ground.field, "load": alike.load, "centre_of_mass_height": HEIGHT}
        rig = TerrainRig(parameters, options, len(members))
        for row, case in enumerate(members):
            rig.stand(*ground.start, case.heading, row)
        x, y = ground.start
        path = control.chicane(DURATION, SPEED, TURN)
        profiles = [path._replace(x=x, y=y, yaw=case.heading) for case in members]
        reference = sampled(profiles, RATE, DURATION)
        controller = policy(alike.kind, alike.load, alike.length)
        run = follow(controller, rig, reference, None, parameters, RATE, SHOWN)
        for row, case in enumerate(members):
            runs[case] = run.part(slice(row, row + 1))
    return runs


def errors(run: Drive) -> tuple[Floats, Floats]:
    """(T,) Cartesian error [m] and heading error [rad] in the plane of the first vehicle."""
    truth = {name: values[:, 0] for name, values in run.truth.items()}
    cosine, sine = np.cos(truth["yaw"]), np.sin(truth["yaw"])
    apart_x, apart_y = (truth[f"reference_{name}"] - truth[name] for name in "xy")
    angles = [(np.cos(truth[name]), np.sin(truth[name])) for name in ("pitch", "roll")]
    apart = cosine * apart_x + sine * apart_y, cosine * apart_y - sine * apart_x
    ahead, left, turn = in_body_plane(*apart, -run.heading[:, 0], *angles)
    return np.asarray(np.hypot(ahead, left)), np.asarray(turn)


def tracking(run: Drive) -> Tracking:
    """Figure 23 in numbers."""
    (distance, turn), pitch = errors(run), run.truth["pitch"]
    sizes = distance.mean(), distance[-1], distance.max(), np.abs(turn).max()
    mean, final, largest, heading = map(float, sizes)
    return Tracking(mean, final, largest, heading, (float(pitch.min()), float(pitch.max())))


# All runs


class Slopes(NamedTuple):
    """All runs of sections 4.5 and 8."""

    missing: str  # why the authors' map is left out; "" when it is there
    grounds: list[UnevenGround]
    open_loop: dict[tuple[str, str, str], OpenLoop]  # ground, COMMANDS, load; HEADINGS
    scripted: dict[tuple[str, str], OpenLoop]  # SOILS, load: the authors' open loop on their map
    level: OpenLoop  # (53) on level ground, nonuniform
    spread: dict[str, Floats]  # [m] by ground: gaps of STARTS vehicles, (53)
    decay: dict[str, tuple[float, float]]  # [1/s] by damping: roll, closed form and plant
    side: tuple[float, float]  # [-] balance on SIDE_SLOPE: plant, closed form
    stiffening: dict[tuple[str, str], Stiffening]  # PAIRS, PER_AREA
    cost: dict[str, float]  # [us] process time of a step of 1 ms by load
    identification: SlopeIdentification
    closed_loop: dict[SlopeCase, Drive]


def scattered() -> list[tuple[float, float, float]]:
    """STARTS anywhere on a ground: x, y [m], yaw [rad]."""
    rng = np.random.default_rng(8)
    places = rng.uniform(-REACH, REACH, (STARTS, 2))
    return [(float(x), float(y), float(rng.uniform(-np.pi, np.pi))) for x, y in places]


def cost(ground: UnevenGround) -> dict[str, float]:
    """Process time [us] of one step of 1 ms, by load; least of TIMINGS."""
    parameters, least = vehicle(friction=FRICTION), {}
    for load in LOADS:
        rig = TerrainRig(parameters, {"terrain": ground.field, "load": load}, step=1e-3)
        rig.stand(*ground.start, 0.0)
        timings = []
        for _ in range(TIMINGS + 1):
            began = time.process_time()
            rig.advance([[5.0, 6.0]], TIMED)
            timings.append(time.process_time() - began)
        least[load] = 1e6 * min(timings[1:]) / (TIMED / 1e-3)
    return least


def run_all(say: Say = lambda text: None, file: Path | None = None) -> Slopes:
    """Run everything; say(text) reports which runs come next. file: the map, None is MAP."""
    mapped, missing = authors_map(file)
    if missing:
        say(missing)
    grounds = [field()] if mapped is None else [mapped, field()]
    say("section 8.1: load models")
    open_loop, spread = {}, {}
    for ground in grounds:
        starts = [(*ground.start, heading) for heading in loads.HEADINGS]
        for commands, load in product(loads.COMMANDS, LOADS):
            run = loads.drive(ground.field, load, starts, commands)
            open_loop[ground.name, commands, load] = run
        runs = [loads.drive(ground.field, load, scattered(), "(53)") for load in LOADS]
        spread[ground.name] = loads.gap(*runs)
    scripted = {
        (name, load): loads.drive(mapped.field, load, [loads.SCRIPTED], "linear", soil)
        for (name, soil), load in product(loads.SOILS.items(), LOADS)
        if mapped is not None
    }
    level = loads.drive("flat", "nonuniform", [(0.0, 0.0, 0.0)], "(53)")
    decay = {
        name: (loads.roll_decay(damping), loads.measured_roll_decay(damping))
        for name, damping in loads.DAMPING.items()
    }
    side = loads.load_on_a_side_slope(SIDE_SLOPE)
    say("section 8.2: stiffness that grows with speed")
    stiffening = {
        (pair, reading): loads.stiffen(*loads.PAIRS[pair], loads.PER_AREA[reading])
        for pair, reading in product(loads.PAIRS, loads.PER_AREA)
    }
    timed = cost(grounds[0])
    say("section 4.5: slip on slopes")
    identification = identify()
    say("section 8.3: chicane on slopes")
    closed = drive(grounds, cases(grounds))
    return Slopes(
        missing, grounds, open_loop, scripted, level, spread, decay, side, stiffening, timed,
        identification, closed,
    )  # fmt: skip
