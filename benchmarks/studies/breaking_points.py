"""Breaking points: how much of one difficulty a policy stands until half of its episodes fail.

    python -m benchmarks.studies.breaking_points [--env Speed-v0] [--policies ..] [--axes mass ..]

Along an AXIS the level of one difficulty goes from easy to hard, all else stays: sensors on unknown
vehicles and soils, mass and soil strength as factors of the nominal ones. The share of episodes
with success is taken on the same episodes at every level and for every policy, and the level where
it passes one half is bisected,
    level(f) = easy + f (hard - easy), or easy^(1 - f) hard^f on a logarithmic axis,  f in [0, 1]
f by halves, so that policies meet the same levels. The answer is a bracket: half or more succeed at
`stands`, fewer at `breaks`. It takes success to fall along the axis; what the bisection does not
visit is not seen. Success of N episodes at one half is known to +-1 / sqrt(N).
"""

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from benchmarks.studies import Cells, policies_of, records_of, show, study_parser, write_csv
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import SETS, BenchmarkSet, register
from tracked_env.benchmark.policy_interface import PolicyEntry, agent_of
from tracked_env.benchmark.store import Store, identity_hash
from tracked_env.cli.command_line import reported
from tracked_env.cli.evaluate_options import add_option
from tracked_env.physics.parameters import PlantParameters
from tracked_env.references import ReferenceProfile
from tracked_env.uncertainty import UNCERTAINTY_SETS
from tracked_env.uncertainty.drawing_laws import Draw, fingerprint

HALF = 0.5  # [-] success at the breaking point
BISECTIONS = 6  # the bracket is 1/64 of the axis


@dataclass(frozen=True)
class Scaled:
    """The nominal vehicle on the nominal soil, mass and soil strength multiplied."""

    mass: float = 1.0  # [-] of mass and inertia
    strength: float = 1.0  # [-] of cohesion and tan(friction angle)
    resistances: tuple[float, float] | None = None  # [-] mu_l, mu_t; None: the nominal ones

    def __call__(
        self,
        rng: np.random.Generator,
        nominal: PlantParameters,
        profile: ReferenceProfile,
        duration: float,
    ) -> Draw:
        """Draw one episode."""
        truth = UNCERTAINTY_SETS["nominal"](rng, nominal, profile, duration).parameters
        resistances = truth.longitudinal_resistance, truth.lateral_resistance
        longitudinal, lateral = self.resistances or resistances
        scaled = truth._replace(
            mass=truth.mass * self.mass,
            inertia=truth.inertia * self.mass,
            cohesion=truth.cohesion * self.strength,
            friction_angle=math.atan(math.tan(truth.friction_angle) * self.strength),
            longitudinal_resistance=longitudinal,
            lateral_resistance=lateral,
        )
        return Draw(scaled, [])


class Axis(NamedTuple):
    """One difficulty, from easy to hard, on a logarithmic scale."""

    unit: str
    easy: float
    hard: float
    trained: Mapping[str, tuple[float, float]]  # range in the training of the agents, by id
    at_level: Callable[[BenchmarkSet, float], BenchmarkSet]  # the set of a level

    def level(self, share: float) -> float:
        """The level at a share of the way from easy to hard."""
        return float(self.easy ** (1.0 - share) * self.hard**share)


def _sensors(**fields: Callable[[float], Any]) -> Callable[[BenchmarkSet, float], BenchmarkSet]:
    """Sets whose sensors have these fields, of the level."""
    return lambda base, level: base._replace(
        sensors={"preset": base.sensors, **{name: field(level) for name, field in fields.items()}}
    )


def _trained(torque: tuple[float, float], speed: tuple[float, float]) -> Any:
    return {TORQUE_ID: torque, SPEED_ID: speed}


def _scaled(field: str) -> Callable[[BenchmarkSet, float], BenchmarkSet]:
    """Sets of the nominal vehicle and soil, with this field of `Scaled` of the level."""

    def at_level(base: BenchmarkSet, level: float) -> BenchmarkSet:
        # Middle of what the law `weak-soil` draws. With the nominal resistance of Torque-v0 no
        # policy could move on soil below 0.16 of the nominal strength: the axis would show that.
        resistances = (0.13, 0.55) if (field, base.env) == ("strength", TORQUE_ID) else None
        return base._replace(uncertainty=Scaled(**{field: level}, resistances=resistances))

    return at_level


_OUTAGES = _sensors(
    pose_outage_gap=lambda level: (5.0, 10.0), pose_outage_length=lambda level: (level,) * 2
)
# Laws and sensors of `train.py`, as the page on agents lists them. Soil strength: largest effort on
# the weakest soil over that on the nominal one, friction over the nominal friction.
AXES = {
    "pose-delay": Axis(
        "s", 0.02, 1.0, _trained((0.0, 0.2), (0.0, 0.1)), _sensors(pose_delay=float)
    ),
    "position-noise": Axis(
        "m", 0.02, 10.0, _trained((0.02, 1.0), (0.001, 0.001)), _sensors(position_noise=float)
    ),
    "outage": Axis("s", 0.5, 20.0, _trained((3.0, 10.0), (3.0, 10.0)), _OUTAGES),
    "mass": Axis("of nominal", 1.0, 10.0, _trained((0.5, 2.0), (0.8, 1.5)), _scaled("mass")),
    "soil-strength": Axis(
        "of nominal", 1.0, 0.02, _trained((0.087, 1.0), (0.25, 2.0)), _scaled("strength")
    ),
}
_BASES = {TORQUE_ID: BenchmarkSet("", "soil-and-mass"), SPEED_ID: SETS["friction"]}


def set_of(env: str, axis: str, level: float) -> str:
    """Name of the evaluation set of a level, which is registered if it is not yet.

    Raises ValueError for an environment without axes.
    """
    if env not in _BASES:
        raise ValueError(f"environment {env!r} has no breaking points; must be one of {[*_BASES]}")
    name = f"{env.rpartition('/')[2].lower()} {axis} {level:.6g}"
    if name not in SETS:
        register(AXES[axis].at_level(_BASES[env], level)._replace(name=name))
    return name


class Point(NamedTuple):
    """Where one agent breaks along an axis; NaN where it does at no level, or at every one."""

    axis: str
    agent: str
    stands: float  # hardest level known with half of the episodes or more successful
    breaks: float  # easiest level known with fewer
    success: float  # [-] at `stands`, or where that is NaN at the easiest level
    episodes: int

    def __str__(self) -> str:
        if math.isnan(self.stands):
            return f"fails at {self.breaks:.3g}"
        if math.isnan(self.breaks):
            return f"stands {self.stands:.3g}"
        return f"{self.stands:.3g} to {self.breaks:.3g}"


def bisect(name: str, agent: str, episodes: int, success: Callable[[float], float]) -> Point:
    """The bracket of an agent along an axis; success(level) runs the episodes of a level."""
    axis = AXES[name]
    first = success(axis.easy)
    if first < HALF:
        return Point(name, agent, math.nan, axis.easy, first, episodes)
    last = success(axis.hard)
    if last >= HALF:
        return Point(name, agent, axis.hard, math.nan, last, episodes)
    low, high, at_low = 0.0, 1.0, first
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        share = success(axis.level(middle))
        if share >= HALF:
            low, at_low = middle, share
        else:
            high = middle
    return Point(name, agent, axis.level(low), axis.level(high), at_low, episodes)


def table(points: Sequence[Point]) -> Cells:
    """One row per agent, a column per axis."""
    axes = list(dict.fromkeys(point.axis for point in points))
    texts = {(point.agent, point.axis): str(point) for point in points}
    agents = dict.fromkeys(point.agent for point in points)
    head = ["policy", *(f"{axis} [{AXES[axis].unit}]" for axis in axes)]
    return [head, *([agent, *(texts.get((agent, axis), "-") for axis in axes)] for agent in agents)]


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Find the points, print and write them; returns the exit status."""
    text = "Find the level at which half of the episodes fail, for each policy and difficulty."
    ids = {"envs": (TORQUE_ID, SPEED_ID), "default": TORQUE_ID}
    parser = study_parser(program, text, 32, ids)
    parser.set_defaults(seeds=1)
    parser.add_argument("--axes", nargs="+", choices=AXES, default=[*AXES], help="by default all")
    add_option(parser, "seed", "of the first episode")
    options = parser.parse_args(arguments)
    env, count, seed = options.env, options.episodes, options.seed
    trainings: dict[str, list[PolicyEntry]] = {}
    for entry in policies_of(options, env):
        trainings.setdefault(agent_of(entry.name), []).append(entry)

    def config_of(axis: str, level: float) -> BenchmarkConfig:
        return BenchmarkConfig((set_of(env, axis, level),), count, seed)

    identity = dict(config_of(options.axes[0], AXES[options.axes[0]].easy).identity())
    del identity["own_sets"]
    identity["breaking_points"] = fingerprint(Scaled())
    track = env.rpartition("/")[2].lower()
    folder = f"breaking-points-{track}-seed{seed}-{identity_hash(identity)[:8]}"
    store, points = Store(options.output / folder, identity), list[Point]()
    for axis in options.axes:
        for agent, entries in trainings.items():

            def success(level: float) -> float:
                records = records_of(config_of(axis, level), entries, store, options.workers)  # noqa: B023
                return float(np.mean([record["success"] for record in records]))

            points.append(bisect(axis, agent, count, success))
    rows = [(*point, *AXES[point.axis].trained[env]) for point in points]
    head = (*Point._fields, "trained_low", "trained_high")
    write_csv(store.folder / "breaking_points.csv", [head, *rows])
    show(table(points), 1)
    print(f"Half or more of {count} episodes succeed at the first number, fewer at the second.")
    print(f"breaking_points.csv in {store.folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "breaking_points"))
