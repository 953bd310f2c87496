"""What each part of the adaptive baseline is worth, and what it is sensitive to, on Torque-v0.

    python -m benchmarks.studies.ablation                    # all parts, all conditions
    python -m benchmarks.studies.ablation --conditions       # parts alone
    python -m benchmarks.studies.ablation --page docs/ablation.md

On development episodes; errors are geometric means over the sets of ratios of the interquartile
mean of the RMSE, with intervals of `statistics`, of parts after 5 s as well.
    parts        `adaptive` without one part, over `adaptive`
    conditions   a policy under a condition, over the same policy at 50 Hz, with the sensors of the
                 sets, told the true numbers of its vehicle
A noise factor scales all white noise of the sensors, not biases, and policies know it. Wrong
numbers are those that fleets are told (`evaluation_sets.Fleet`): each of size and drives times
1 + error or over that, with equal odds; DRAWS of these count as seeds of the policy.

A parameter that is held at its nominal value is so for the control law alone: the estimators go on,
and tell one another what they identify. The turning regression identifies m mu_t; its mu_t, over
the mass that is identified, meets a nominal mass in the law, and the force in the law is wrong by
as much as the mass. `inertial mass nominal` takes that out of it: forces stay as identified.
"""

import hashlib
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from baselines.estimators.interacting_models import PLAIN
from baselines.estimators.measurement import POSE, DataSheet
from baselines.estimators.stack import Identification, IdentificationStack
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from benchmarks.studies import Cells, policies_of, records_of, show, study_parser, write_csv
from reproduce.strawa2021.identification import FORGETTING, PaperStack
from tracked_env import TORQUE_ID
from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT, BenchmarkSet, Fleet, default_sets
from tracked_env.benchmark.files import replace_block, source_fingerprint
from tracked_env.benchmark.leaderboard import relative
from tracked_env.benchmark.policies import policies_for
from tracked_env.benchmark.policy_interface import (
    SEED_MARK,
    PolicyContext,
    PolicyEntry,
    PolicyError,
    agent_of,
    checked_policy,
)
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import Record, Store
from tracked_env.benchmark.summary import Row, rows_of
from tracked_env.benchmark.table_model import between, markdown_rows
from tracked_env.cli.command_line import reported
from tracked_env.cli.evaluate_command import result_folder
from tracked_env.cli.evaluate_options import add_option
from tracked_env.physics.parameters import PARAMETER_INDEX, PARAMETER_NAMES, PlantParameters

REFERENCE = "adaptive"
POLICIES = ("adaptive", "mpc-adaptive", "integral")  # of the conditions
DRAWS = 5  # [-] of wrong numbers
REFUSED = "refused"  # of a policy that cannot be made

# Parts

OUTAGE = 1.5  # [s] age of the pose from which on it is an outage; some sets have one pose a second
RESISTANCES = ("longitudinal_resistance", "lateral_resistance")
DRIVES = ("drive_time_constant", "actuator_gain_left", "actuator_gain_right")
SOIL = ("cohesion", "friction_angle", "shear_deformation_modulus")
_MASS = PARAMETER_INDEX["mass"]
_RESISTANCES, _DRIVES = ([PARAMETER_INDEX[name] for name in of] for of in (RESISTANCES, DRIVES))


class NominalGroundStack(IdentificationStack):
    """Its filter allows for the nominal soil in outages, as uncertain as before any data."""

    def update(self, *arguments: Any, **options: Any) -> Identification:
        """As IdentificationStack.update."""
        step = super().update(*arguments, **options)
        soil, covariance, _ = self._ground
        friction = step.parts.answers["turning"]["value"][:, 1]
        self.slip.take_ground(soil, covariance, friction)
        return step


class NoSideslipStack(IdentificationStack):
    """Without the equation of the side slip."""

    uses_sideslip = False


class SingleModelStack(NoSideslipStack):
    """One model in each regression, with its forgetting factor; without the interacting models
    there is no monitor of trends, no gate of outliers, and no equation of the side slip."""

    forgetting: float | None = None  # another factor

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        for regression in (self.longitudinal, self.turning):
            factor = self.forgetting or regression.prior.forgetting
            regression.table = PLAIN
            regression.prior = regression.prior._replace(forgetting=factor)


class ForgetfulStack(SingleModelStack):
    """The same with the forgetting factor of the paper."""

    forgetting = FORGETTING


class InertialMassPolicy(AdaptivePolicy):
    """The mass of the law is nominal, the forces m mu_l g and m mu_t g are as identified."""

    def _adapt(self, step: Identification) -> None:
        super()._adapt(step)
        parameters, nominal = self.controller.parameters, self.parameters.mass
        parameters[_RESISTANCES] *= parameters[_MASS] / nominal
        parameters[_MASS] = nominal


class OutagePolicy(AdaptivePolicy):
    """In an outage of the pose gains and lag of the drives stay what they were when it began."""

    def _adapt(self, step: Identification) -> None:
        before = self.controller.parameters[_DRIVES]
        super()._adapt(step)
        parameters, silent = self.controller.parameters, step.reading.latest.age[:, POSE] > OUTAGE
        parameters[_DRIVES] = np.where(silent, before, parameters[_DRIVES])


class Part(NamedTuple):
    """The adaptive policy without one of its parts."""

    kind: type[AdaptivePolicy] = AdaptivePolicy
    stack: type[IdentificationStack] = IdentificationStack
    held: tuple[str, ...] = ()  # parameters that are nominal for the law
    options: Mapping[str, Any] = MappingProxyType({})  # further arguments of `kind`


PARTS = {
    "all nominal": Part(held=("mass", "inertia", *RESISTANCES, *DRIVES, *SOIL)),
    "resistances nominal": Part(held=RESISTANCES),
    "motion resistance nominal": Part(held=RESISTANCES[:1]),
    "lateral resistance nominal": Part(held=RESISTANCES[1:]),
    "no filter": Part(options={"filtered": False}),
    "drives nominal": Part(held=DRIVES),
    "lag of the drives nominal": Part(held=DRIVES[:1]),
    "gains of the drives nominal": Part(held=DRIVES[1:]),
    "drives held in outages": Part(OutagePolicy),
    "mass nominal": Part(held=("mass",)),
    "inertial mass nominal": Part(InertialMassPolicy),
    "inertia nominal": Part(held=("inertia",)),
    "no soil in the law": Part(options={"uses_soil": False}),
    "no soil estimator": Part(stack=NominalGroundStack, options={"uses_soil": False}),
    "no side-slip row": Part(stack=NoSideslipStack),
    "single model": Part(stack=SingleModelStack),
    "single model, forgets faster": Part(stack=ForgetfulStack),
    "regressions of the paper": Part(stack=PaperStack),
    "filter of filterpy": Part(options={"slip": "filterpy"}),
}


def make_without(name: str, context: PolicyContext) -> AdaptivePolicy:
    """A fresh adaptive policy without a part of PARTS."""
    part, sheet = PARTS[name], DataSheet.of(context.sensors)
    arguments = context.vehicle, context.control_period, sheet, context.lateral
    kind: Any = type(part.kind.__name__, (part.kind,), {"stack_kind": part.stack})
    policy: AdaptivePolicy = kind(*arguments, observation=context.observation, **part.options)
    if part.held:
        policy.fixed_parameters = np.full((len(PARAMETER_NAMES), 1), np.nan)
        for parameter in part.held:
            nominal = getattr(context.vehicle, parameter)
            policy.fixed_parameters[PARAMETER_INDEX[parameter]] = nominal
    return policy


def entries_without(names: Sequence[str]) -> list[PolicyEntry]:
    """The policies without these parts, for the benchmark."""
    own = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:12]
    mark = "-".join([own, *map(source_fingerprint, ("baselines", "reproduce"))])
    return [PolicyEntry(name, partial(make_without, name), mark) for name in names]


# Conditions


class OwnVehicle(Fleet):
    """A fleet whose vehicles are all that of the environment."""

    def vehicle(self, seed: int, base: PlantParameters) -> PlantParameters:
        """The vehicle itself."""
        return base


def told_wrongly(name: str, error: float, draw: int) -> PolicyEntry:
    """A policy that is told wrong numbers [-] of its vehicle; each draw is another seed of it."""
    (entry,) = policies_for(TORQUE_ID, [name])
    told = OwnVehicle(error, sensors=("rtk",)).told

    def make(context: PolicyContext) -> object:
        return entry.make(context._replace(vehicle=told(draw, context.vehicle)))

    agent, _, seed = name.partition(SEED_MARK)
    return PolicyEntry(
        f"{agent} told {error:g}{SEED_MARK}{draw}" + f" of {seed}" * bool(seed),
        make,  # type: ignore[arg-type]
        f"{entry.fingerprint}:{error:g}:{draw}",
        (told_wrongly, (name, error, draw)),
    )


def with_noise(config: BenchmarkConfig, factor: float) -> tuple[BenchmarkSet, ...]:
    """The sets of a configuration with the white noise of all sensors times a factor."""
    sets = []
    for name in config.sets:
        sheet = config.context(name).sensors._asdict()
        noise = {field: factor * of for field, of in sheet.items() if field.endswith("_noise")}
        sets.append(config.registered(name)._replace(sensors={**sheet, **noise}))
    return tuple(sets)


class Condition(NamedTuple):
    """In what the episodes differ, or what policies are told."""

    rate: float = 50.0  # [Hz] of the control
    noise: float = 1.0  # [-] times that of the sensors
    error: float = 0.0  # [-] of the numbers of the vehicle

    def config(self, usual: BenchmarkConfig) -> BenchmarkConfig:
        """Its configuration; `usual` is the one that it differs from."""
        own = () if self.noise == 1.0 else with_noise(usual, self.noise)
        return replace(usual, control_rate=self.rate, own_sets=own)

    def entries(self, policies: Sequence[PolicyEntry], usual: BenchmarkConfig) -> list[PolicyEntry]:
        """The policies as they are told, without those that refuse the control rate."""
        if self.error > 0.0:
            return [told_wrongly(p.name, self.error, k) for p, k in product(policies, range(DRAWS))]
        context, accepting = self.config(usual).context(usual.sets[0]), []
        for entry in policies:
            with suppress(PolicyError):
                checked_policy(entry, context)
                accepting.append(entry)
        return accepting

    def agent(self, policy: str) -> str:
        """Name of a policy as it is told."""
        return f"{policy} told {self.error:g}" if self.error else policy


CONDITIONS = {
    **{f"{rate} Hz": Condition(rate=float(rate)) for rate in (10, 20, 100)},
    **{f"noise times {factor:g}": Condition(noise=factor) for factor in (0.5, 2.0, 4.0)},
    **{f"told {percent} % wrong": Condition(error=0.01 * percent) for percent in (10, 30)},
}


def by_set(records: Sequence[Record], config: BenchmarkConfig) -> dict[str, Row]:
    """A Row of each set."""
    rows = rows_of(records)
    return {name: rows[name] for name in config.sets}


def success(sets: Mapping[str, Row], agent: str) -> float:
    """Share of episodes with success [%]."""
    shares = [row.matrix(agent, "success").mean() for row in sets.values()]
    return 100.0 * float(sum(shares)) / len(shares)


def part_table(sets: Mapping[str, Row], parts: Sequence[str]) -> Cells:
    """A row for each part, the most valuable first."""
    errors = {part: relative(sets, part, REFERENCE) for part in parts}
    cells = [["part", "error", "after 5 s", "worst set", "success [%]"]]
    for part, of in sorted(errors.items(), key=lambda pair: -pair[1].whole.value):
        worst = f"{of.worst_set} {of.worst:.2f}"
        share = f"{success(sets, part):.1f}"
        cells.append([part, between(of.whole, 2), between(of.settled, 2), worst, share])
    return cells


def over_usual(
    rows: Mapping[str, Row], agent: str, policy: str, usual: Mapping[str, Row]
) -> Estimate:
    """Error of an agent over that of a policy on other episodes."""
    return stats.relative_error(
        [(rows[name].redrawn[agent], usual[name].redrawn[policy]) for name in usual]
    )


def condition_table(
    by_condition: Mapping[str, Mapping[str, Row]], usual: Mapping[str, Row], agents: Sequence[str]
) -> Cells:
    """A row for each condition, below one of usual episodes, of the error over that of the first
    agent; by_condition: a Row of each set under it."""
    cells = [["condition", *agents, "success [%]"]]
    for name, rows in {f"usual, over {agents[0]}": usual, **by_condition}.items():
        row, shares = [name], []
        for agent in agents:
            told, over = agent, agents[0]
            if name in CONDITIONS:
                told, over = CONDITIONS[name].agent(agent), agent
            if any(told not in of.names for of in rows.values()):
                row.append(REFUSED)
                shares.append("-")
                continue
            row.append(between(over_usual(rows, told, over, usual), 2))
            shares.append(f"{success(rows, told):.0f}")
        cells.append([*row, " / ".join(shares)])
    return cells


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Run what is missing, print and write the tables, renew the page."""
    ids = {"envs": (TORQUE_ID,), "default": TORQUE_ID}
    parser = study_parser(program, (__doc__ or "").split("\n")[0], 32, ids)
    add_option(parser, "sets", "by default those of the leaderboard")
    add_option(parser, "duration")
    for name, of in (("parts", PARTS), ("conditions", CONDITIONS)):
        parser.add_argument(f"--{name}", nargs="*", choices=of, default=[*of], help="default: all")
    text = "page whose blocks `parts` and `conditions` are renewed"
    parser.add_argument("--page", type=Path, metavar="FILE", help=text)
    options = parser.parse_args(arguments)
    sets, count = tuple(options.sets or default_sets()), options.episodes
    config = BenchmarkConfig(sets, count, DEVELOPMENT, duration=options.duration)
    store = Store(result_folder(options.output, config), config.identity())
    options.policies = options.policies or POLICIES
    entries, tables = policies_of(options, TORQUE_ID), dict[str, Cells]()
    split = f"{count} episodes of each of {len(sets)} sets, seeds from {DEVELOPMENT} on"
    if options.parts:
        both = [*policies_for(TORQUE_ID, [REFERENCE]), *entries_without(options.parts)]
        rows = by_set(records_of(config, both, store, options.workers), config)
        tables["parts"] = part_table(rows, options.parts)
    if options.conditions:
        usual = by_set(records_of(config, entries, store, options.workers), config)
        by_condition = {}
        for name in options.conditions:
            condition = CONDITIONS[name]
            own, told = condition.config(config), condition.entries(entries, config)
            kept = Store(result_folder(options.output, own), own.identity())
            by_condition[name] = by_set(records_of(own, told, kept, options.workers), own)
        agents = list(dict.fromkeys(agent_of(entry.name) for entry in entries))
        tables["conditions"] = condition_table(by_condition, usual, agents)
    for name, cells in tables.items():
        write_csv(store.folder / f"{name}.csv", cells)
        show(cells, 1)
        if options.page is not None:
            text = f"{markdown_rows(cells, 1)}\n\n{split}; source {config.identity()['source']}."
            replace_block(options.page, name, text)
    print(f"{split}; tables in {store.folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "ablation"))
