"""Breaking points: how much of one difficulty a policy stands until half of its episodes fail.

Along an AXIS the level of one difficulty goes from easy to hard, all else stays: sensors on unknown
vehicles and soils, mass and soil strength as factors of the nominal ones. The share of episodes
with success is taken on the same episodes at every level and for every policy, and the level where
it passes one half is bisected,
    level(f) = easy + f (hard - easy), or easy^(1 - f) hard^f on a logarithmic axis,  f in [0, 1]
f by halves, so that policies meet the same levels. The answer is a bracket: half or more succeed at
`stands`, fewer at `breaks`. It takes success to fall along the axis; what the bisection does not
visit is not seen. Success of N episodes at one half is known to +-1 / sqrt(N).

`tracked-env breaking-points`: how much of each difficulty every policy stands.
"""

import argparse
import csv
import io
import math
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from benchmarks.studies.choose_sets import few_seeds, seed_count
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import SETS, BenchmarkSet, register
from tracked_env.benchmark.figures import STYLE, looks, new_figure, plain_ticks
from tracked_env.benchmark.policies import (
    by_name,
    default_names,
    load_policies,
    open_archive,
    registered_policies,
)
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.progress_bar import progress_bar
from tracked_env.benchmark.runner import run
from tracked_env.benchmark.store import Store, identity_hash, write_atomically
from tracked_env.benchmark.summary import agent_of
from tracked_env.benchmark.text_tables import aligned
from tracked_env.cli.evaluate_options import JoinedNames, add_env, add_option, names
from tracked_env.cli.exit_status import Parser, reported
from tracked_env.physics.parameters import PlantParameters
from tracked_env.references import ReferenceProfile
from tracked_env.uncertainty import UNCERTAINTY_SETS
from tracked_env.uncertainty.drawing_laws import Draw, fingerprint
from tracked_env.validation import checked_choice

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
        scaled = truth._replace(
            mass=truth.mass * self.mass,
            inertia=truth.inertia * self.mass,
            cohesion=truth.cohesion * self.strength,
            friction_angle=math.atan(math.tan(truth.friction_angle) * self.strength),
        )
        if self.resistances is not None:
            longitudinal, lateral = self.resistances
            scaled = scaled._replace(
                longitudinal_resistance=longitudinal, lateral_resistance=lateral
            )
        return Draw(scaled, [])


class Axis(NamedTuple):
    """One difficulty, from easy to hard."""

    unit: str
    easy: float
    hard: float
    logarithmic: bool
    trained: Mapping[str, tuple[float, float]]  # range in the training of the agents, by id
    of: Callable[[BenchmarkSet, float], BenchmarkSet]  # the set of a level

    def level(self, share: float) -> float:
        """The level at a share of the way from easy to hard."""
        if self.logarithmic:
            return float(self.easy ** (1.0 - share) * self.hard**share)
        return self.easy + share * (self.hard - self.easy)


def _sensors(**fields: Callable[[float], Any]) -> Callable[[BenchmarkSet, float], BenchmarkSet]:
    """Sets whose sensors have these fields, of the level."""
    return lambda base, level: base._replace(
        sensors={"preset": base.sensors, **{name: of(level) for name, of in fields.items()}}
    )


# Middle of what the law `weak-soil` draws. With the nominal resistance of Torque-v0 no policy could
# move on soil below 0.16 of the nominal strength, and the axis would show that and nothing else.
_ON_WEAK_SOIL = {TORQUE_ID: (0.13, 0.55)}


def _on_soil(base: BenchmarkSet, level: float) -> BenchmarkSet:
    """The set with this soil strength."""
    law = Scaled(strength=level, resistances=_ON_WEAK_SOIL.get(base.env))
    return base._replace(uncertainty=law)


# Laws and sensors of `train.py`, as the page on agents lists them. Soil strength: largest effort on
# the weakest soil over that on the nominal one, friction over the nominal friction.
AXES = {
    "pose-delay": Axis(
        "s", 0.02, 1.0, True, {TORQUE_ID: (0.0, 0.2), SPEED_ID: (0.0, 0.1)},
        _sensors(pose_delay=float),
    ),
    "position-noise": Axis(
        "m", 0.02, 10.0, True, {TORQUE_ID: (0.02, 1.0), SPEED_ID: (0.001, 0.001)},
        _sensors(position_noise=float),
    ),
    "outage": Axis(
        "s", 0.5, 20.0, True, {TORQUE_ID: (3.0, 10.0), SPEED_ID: (3.0, 10.0)},
        _sensors(
            pose_outage_gap=lambda level: (5.0, 10.0), pose_outage_length=lambda level: (level,) * 2
        ),
    ),
    "mass": Axis(
        "of nominal", 1.0, 10.0, True, {TORQUE_ID: (0.5, 2.0), SPEED_ID: (0.8, 1.5)},
        lambda base, level: base._replace(uncertainty=Scaled(mass=level)),
    ),
    "soil-strength": Axis(
        "of nominal", 1.0, 0.02, True, {TORQUE_ID: (0.087, 1.0), SPEED_ID: (0.25, 2.0)},
        _on_soil,
    ),
}  # fmt: skip
_BASES = {
    TORQUE_ID: BenchmarkSet("", "soil-and-mass", ""),
    SPEED_ID: SETS["friction"]._replace(about=""),
}


def set_of(env: str, axis: str, level: float) -> str:
    """Name of the evaluation set of a level, which is registered if it is not yet.

    Raises ValueError for an environment without axes.
    """
    if env not in _BASES:
        raise ValueError(f"environment {env!r} has no breaking points; must be one of {[*_BASES]}")
    name = f"{env.rpartition('/')[2].lower()} {axis} {level:.6g}"
    if name not in SETS:
        made = AXES[axis].of(_BASES[env], level)
        register(made._replace(name=name, about=f"{axis} of {level:.3g} {AXES[axis].unit}"))
    return name


class Point(NamedTuple):
    """Where one agent breaks along an axis; NaN where it does at no level, or at every one."""

    axis: str
    agent: str
    stands: float  # hardest level known with half of the episodes or more successful
    breaks: float  # easiest level known with fewer
    success: float  # [-] at `stands`, or where that is NaN at the easiest level
    episodes: int


def bisect(
    axis: str, agent: str, episodes: int, success: Callable[[float], float]
) -> Iterator[Point]:
    """The bracket of an agent, narrower with each; success(level) runs the episodes of a level."""
    of = AXES[axis]
    known = {share: success(of.level(share)) for share in (0.0,)}
    if known[0.0] < HALF:
        yield Point(axis, agent, math.nan, of.easy, known[0.0], episodes)
        return
    known[1.0] = success(of.level(1.0))
    if known[1.0] >= HALF:
        yield Point(axis, agent, of.hard, math.nan, known[1.0], episodes)
        return
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        known[middle] = success(of.level(middle))
        low, high = (middle, high) if known[middle] >= HALF else (low, middle)
        yield Point(axis, agent, of.level(low), of.level(high), known[low], episodes)


def table(points: Sequence[Point]) -> list[list[str]]:
    """Rows of cells, the header first: one row per agent, a column per axis."""
    axes = list(dict.fromkeys(point.axis for point in points))
    found = {(point.agent, point.axis): point for point in points}
    cells = [["policy", *(f"{axis} [{AXES[axis].unit}]" for axis in axes)]]
    for agent in dict.fromkeys(point.agent for point in points):
        cells.append([agent, *(_text(found.get((agent, axis))) for axis in axes)])
    return cells


def _text(point: Point | None) -> str:
    if point is None:
        return "-"
    if math.isnan(point.stands):
        return f"fails at {point.breaks:.3g}"
    if math.isnan(point.breaks):
        return f"stands {point.stands:.3g}"
    return f"{point.stands:.3g} to {point.breaks:.3g}"


def figure(env: str, points: Sequence[Point]) -> "Figure":
    """A panel per axis, an agent per line, the training range shaded; harder is further right."""
    import matplotlib

    axes_shown = list(dict.fromkeys(point.axis for point in points))
    agents = list(dict.fromkeys(point.agent for point in points))
    style = looks(agents)
    with matplotlib.rc_context({**STYLE, "text.parse_math": False}):
        drawn, grid = new_figure(
            (1.9, 0.3 * len(agents) + 0.3), columns=len(axes_shown), left=1.7, gap=(0.2, 0.4)
        )
        for panel, (axes, name) in enumerate(zip(grid[0], axes_shown, strict=True)):
            axis = AXES[name]
            axes.axvspan(*axis.trained[env], color="0.88", linewidth=0)
            for point in points:
                if point.axis == name:
                    _line(axes, point, axis, agents.index(point.agent), style[point.agent])
            axes.set_xscale("log" if axis.logarithmic else "linear")
            axes.tick_params(axis="x", labelsize=7.5)
            low, high = sorted((axis.easy, axis.hard))
            axes.set_xlim(0.8 * low, 1.25 * high)
            if axis.hard < axis.easy:
                axes.invert_xaxis()
            plain_ticks(axes.xaxis, (1.0, 3.0))
            axes.set_ylim(len(agents) - 0.5, -0.5)
            axes.set_yticks(range(len(agents)), agents if panel == 0 else [""] * len(agents))
            axes.set_xlabel(f"{name} [{axis.unit}]")
        grid[0, 0].set_title("Level at which half of the episodes fail", loc="left")
    return drawn


def _line(axes: Any, point: Point, axis: Axis, row: int, look: Any) -> None:
    """From the easy end to where half fail; an arrow where no level of the axis does it."""
    if math.isnan(point.stands):
        axes.plot(axis.easy, row, "x", color=look.colour)
        return
    axes.plot([axis.easy, point.stands], [row, row], color=look.colour, linewidth=1.5)
    if math.isnan(point.breaks):
        axes.plot(point.stands, row, ">",
                  color=look.colour, markersize=6.0)  # fmt: skip
        return
    axes.plot([point.stands, point.breaks], [row, row], color=look.colour, linewidth=5.0)


def _options(arguments: Sequence[str], program: str) -> argparse.Namespace:
    parser = Parser(
        program,
        "Find, for each policy and difficulty, the level at which half of the episodes "
        "fail, on the same episodes. What was run is kept, and only what is missing is run.",
    )
    add_env(parser, (TORQUE_ID, SPEED_ID), text="environment id", default=TORQUE_ID)
    add_option(
        parser, "policies", "as in `tracked-env evaluate`; by default all that are registered"
    )
    parser.add_argument("--axes", nargs="+", type=names, action=JoinedNames, metavar="AXIS",
                        help=f"of {', '.join(AXES)}; by default all")  # fmt: skip
    add_option(parser, "episodes", "of a level", default=32)
    add_option(parser, "seed", "of the first episode")
    parser.add_argument("--seeds", type=seed_count, default=1, metavar="N",
                        help="trainings of an agent, at most (default: 1)")  # fmt: skip
    add_option(parser, "output", "folder of the results")
    return parser.parse_args(arguments)


def find(
    given: argparse.Namespace, entries: Sequence[PolicyEntry], axes: Sequence[str]
) -> tuple[Store, list[Point]]:
    """The points, and where their episodes are kept. Raises ValueError, PolicyError, OSError."""

    def config_of(axis: str, level: float) -> BenchmarkConfig:
        name = set_of(given.env, axis, level)
        return BenchmarkConfig((name,), given.episodes, given.seed)

    first = config_of(axes[0], AXES[axes[0]].easy)
    identity = {k: v for k, v in first.identity().items() if k != "own_sets"}
    identity["breaking_points"] = fingerprint(Scaled())
    track = given.env.rpartition("/")[2].lower()
    folder = (
        given.output / f"breaking-points-{track}-seed{given.seed}-{identity_hash(identity)[:8]}"
    )
    store, points = Store(folder, identity), list[Point]()
    by_agent: dict[str, list[PolicyEntry]] = {}
    for entry in entries:
        by_agent.setdefault(agent_of(entry.name), []).append(entry)
    levels = len(axes) * len(entries) * (BISECTIONS + 2)
    steps = given.episodes * first.max_steps(first.sets[0])
    with progress_bar(levels * steps) as progress:
        for axis in axes:
            for agent, trainings in by_agent.items():
                done = 0

                def success(level: float) -> float:
                    nonlocal done
                    done += 1
                    records = run(config_of(axis, level), trainings, store)  # noqa: B023
                    progress(steps * len(trainings), f"{axis}: {agent}")  # noqa: B023
                    return float(np.mean([record["success"] for record in records]))

                *_, point = bisect(axis, agent, given.episodes, success)
                points.append(point)
                rest = BISECTIONS + 2 - done  # levels that need not be run
                progress(rest * steps * len(trainings), f"{axis}: {agent}")
    return store, points


def write(folder: Path, env: str, points: Sequence[Point]) -> None:
    """breaking_points.csv and, with matplotlib, breaking_points.png."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*Point._fields, "trained_low", "trained_high"))
    for point in points:
        writer.writerow((*point, *AXES[point.axis].trained[env]))
    write_atomically(folder / "breaking_points.csv", text.getvalue().encode())
    try:
        drawn, image = figure(env, points), io.BytesIO()
    except ImportError as error:
        print(f"not drawn: {error}", file=sys.stderr)
        return
    drawn.savefig(image, format="png", bbox_inches="tight")
    write_atomically(folder / "breaking_points.png", image.getvalue())


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Find the points, print and write them; returns the exit status."""
    given = _options(arguments, program)
    axes = given.axes or list(AXES)
    for axis in axes:
        checked_choice("axis", axis, AXES)
    policies = registered_policies()
    registry, trained = by_name(policies, given.env)
    specs = given.policies or default_names(policies, given.env)
    entries = few_seeds(load_policies(specs, registry, trained, open_archive), given.seeds)
    store, points = find(given, entries, axes)
    write(store.folder, given.env, points)
    print(f"\n{aligned(table(points), 1, shutil.get_terminal_size().columns)}\n")
    print(
        f"Half or more of {given.episodes} episodes succeed at the first number, fewer at the "
        f"second.\nbreaking_points.csv and breaking_points.png in {store.folder}"
    )
    return 0
