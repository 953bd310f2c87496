"""Which evaluation sets decide: separations and rank correlations of every candidate.

    python -m benchmarks.studies.choice_of_sets [--env Speed-v0] [--page docs/choice_of_sets.md]

Episodes are those of the development split. Per set, with the interquartile means (IQM) of the
tracking RMSE of these policies:
    blind      the best agent that learned to drive from one observation
    memory     the best policy that keeps something of former observations, without the truth
    baseline   the non-adaptive controller of the drive
    adaptive   the controller that identifies the parameters under way
    ceiling    the best policy with the true parameters
    separation of memory          (blind - memory) / (baseline - ceiling)
    separation of identification  (baseline - adaptive) / (baseline - ceiling)
    headroom                      adaptive / ceiling, of whole episodes and after 5 s, each with the
                                  best policy with the true parameters there
What is below 0 is 0. A separation is strong above MEMORY or IDENTIFICATION where the first IQM of
its numerator is also at least SEPARATION_RATIO times the second one. Where baseline and ceiling are
closer than that ratio nothing is there to be identified, and the separation of identification is 0.
The rank correlation of two sets is Spearman's, over the IQMs of all policies, every training of an
agent one of them: above ALIKE one of the two says what the other one says.
"""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.studies import Cells, policies_of, records_of, show, study_parser
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import (
    DEVELOPMENT,
    SETS,
    Version,
    group_of,
    names_of,
    version_of,
)
from tracked_env.benchmark.files import replace_block, write_atomically
from tracked_env.benchmark.statistics import ALIKE, correlations, interquartile_mean, unlike
from tracked_env.benchmark.store import Store, identity_hash
from tracked_env.benchmark.summary import ALL_SETS, SEPARATION_RATIO, Row, rows_of
from tracked_env.benchmark.table_model import markdown_rows
from tracked_env.cli.command_line import reported
from tracked_env.cli.evaluate_options import add_option, env_of

MEMORY = 0.5  # [-] from here on a separation of memory is strong
IDENTIFICATION = 0.3  # [-] likewise
FEWEST, MOST = 10, 12  # sets of an environment
STRONG = 4  # sets of either strong separation
# Those that keep nothing of former observations but are no agents.
MEMORYLESS = ("nominal", "uc", "slc", "slc-flat")
BASELINES = ("integral", "slc", "nominal", "uc")  # the first one that is there
ADAPTIVE = ("adaptive", "slc-adaptive")
KNOWN = ("nominal", "floor", "level")  # sets in which nothing is unknown: no candidates


class Separation(NamedTuple):
    """What one set separates."""

    name: str
    group: str  # of the version; empty for a candidate
    iqm: dict[str, float]  # [m] of every agent, all its seeds together
    of_seeds: dict[str, float]  # [m] of every policy, the seeds of an agent apart
    roles: dict[str, str | None]  # the policy in each, as in the head of this file
    headroom: tuple[float, float]  # [-] whole, after the start; NaN where a role is not filled

    def of(self, role: str) -> float:
        """IQM [m] of the policy in a role; NaN where nobody has it."""
        return self.iqm.get(self.roles[role] or "", math.nan)

    def separates(self, kind: str) -> tuple[float, bool]:
        """Separation [-] of `memory` or `identification`, and whether it is strong.

        Infinite where only the gap of baseline and ceiling is 0 or negative, NaN where a role is
        not filled.
        """
        roles, limit = {
            "memory": (("blind", "memory"), MEMORY),
            "identification": (("baseline", "adaptive"), IDENTIFICATION),
        }[kind]
        worse, better = map(self.of, roles)
        gap = self.of("baseline") - self.of("ceiling")
        if kind == "identification" and self.of("baseline") < SEPARATION_RATIO * self.of("ceiling"):
            return 0.0, False
        if math.isnan(worse - better) or math.isnan(gap):
            return math.nan, False
        share = (worse - better) / gap if gap > 0.0 else math.inf
        share = share if worse > better else 0.0
        return share, worse >= SEPARATION_RATIO * better and share > limit


def is_blind(agent: str) -> bool:
    """Whether an agent, by its name, learned to drive from one observation."""
    return agent.endswith("-blind") and not agent.startswith("recurrent-")


def separation(name: str, row: Row, version: Version | None = None) -> Separation:
    """The roles of a set, from its row of the summary."""
    iqm = {agent: row.iqm(agent) for agent in row.names}
    settled = {a: float(interquartile_mean(row.settled[a].values.ravel())) for a in row.names}

    def best(names: Sequence[str]) -> str | None:
        return min(names, key=iqm.__getitem__, default=None)

    blind = [agent for agent in iqm if is_blind(agent)]
    others = {*blind, *row.reading_truth(), *MEMORYLESS}
    of_seeds = {
        policy: float(interquartile_mean(values))
        for agent, policies in row.seeds.items()
        for policy, values in zip(policies, row.matrix(agent, "tracking_rmse"), strict=True)
    }
    roles = {
        "blind": best(blind),
        "memory": best([agent for agent in iqm if agent not in others]),
        "baseline": next((agent for agent in BASELINES if agent in iqm), None),
        "adaptive": next((agent for agent in ADAPTIVE if agent in iqm), None),
        "ceiling": row.ceiling(),
    }
    least = (
        min(map(of.__getitem__, row.reading_truth()), default=math.nan) for of in (iqm, settled)
    )
    own = (of.get(roles["adaptive"] or "", math.nan) for of in (iqm, settled))
    whole, after = (float(mine / best) for mine, best in zip(own, least, strict=True))
    group = "" if version is None else group_of(name, version)
    return Separation(name, group, iqm, of_seeds, roles, (whole, after))


def without_one(sets: Sequence[Mapping[str, float]]) -> NDArray[np.float64]:
    """The largest rank correlations (S, S) of sets {policy: value} whichever policy is left out."""
    policies = list(sets[0]) if sets else []
    if len(policies) < 2:  # nobody is left
        return correlations(sets)

    def rest(left_out: str) -> list[dict[str, float]]:
        return [{p: values[p] for p in policies if p != left_out} for values in sets]

    return np.fmax.reduce([correlations(rest(policy)) for policy in policies])


class Choice(NamedTuple):
    """All candidates of an environment, in their order."""

    sets: list[Separation]
    correlation: NDArray[np.float64]  # (S, S) [-]

    def chosen(self) -> list[Separation]:
        """Those of the version."""
        return [each for each in self.sets if each.group]

    def closest(self, name: str, among: Sequence[Separation]) -> tuple[str, float]:
        """The set of `among` with the largest rank correlation, and that; ("", NaN) if alone."""
        index = {each.name: i for i, each in enumerate(self.sets)}
        row = self.correlation[index[name]]
        pairs = [(row[index[each.name]], each.name) for each in among if each.name != name]
        value, other = max(pairs, default=(math.nan, ""))
        return other, float(value)

    def most_unlike(self, among: Sequence[Separation], lasting: bool = False) -> list[Separation]:
        """The most of these sets of which no two are alike; chosen ones rather than others.

        lasting: nor are they whichever policy is left out.
        """
        places = [i for i, each in enumerate(self.sets) if each in among]
        preferred = [k for k, i in enumerate(places) if self.sets[i].group]
        correlation = self.correlation[np.ix_(places, places)]
        if lasting:
            apart = without_one([self.sets[i].of_seeds for i in places])
            correlation = np.fmax(correlation, apart)
        return [self.sets[places[k]] for k in unlike(correlation, preferred)]

    def verdict(self) -> list[str]:
        """Whether the chosen sets are as many, as strong and as different as they should be, each
        in a line with `met` or `NOT met`; and how many could go together."""
        chosen, alike = self.chosen(), []
        for i, each in enumerate(chosen):
            other, value = self.closest(each.name, chosen[:i])
            if value > ALIKE:
                alike.append(f"{each.name} and {other} ({value:.2f})")
        judged = [(FEWEST <= len(chosen) <= MOST, f"{FEWEST} to {MOST} sets: {len(chosen)}")]
        for kind, limit in (("memory", MEMORY), ("identification", IDENTIFICATION)):
            names = [each.name for each in chosen if each.separates(kind)[1]]
            text = f"at least {STRONG} with a separation of {kind} above {limit}: {len(names)}"
            judged.append((len(names) >= STRONG, f"{text} ({', '.join(names) or 'none'})"))
        text = f"no two with a rank correlation above {ALIKE}: {', '.join(alike) or 'none'}"
        judged.append((not alike, text))
        lines = [f"{'met' if met else 'NOT met'}: {text}" for met, text in judged]
        pools = {"chosen sets": chosen} | ({"candidates": self.sets} if self.sets != chosen else {})
        for kind, among in pools.items():
            for lasting, whichever in ((False, ""), (True, ", whichever policy is left out")):
                apart = self.most_unlike(among, lasting)
                names = [each.name for each in apart]
                lines.append(
                    f"of the {len(among)} {kind} at most {len(apart)} go together without a pair "
                    f"above {ALIKE}{whichever}: {', '.join(names) or 'none'}"
                )
        return lines


def choice(rows: Mapping[str, Row], version: Version | None = None) -> Choice:
    """The separations of all sets, and how alike they are; rows: of the summary."""
    sets = [separation(name, row, version) for name, row in rows.items() if name != ALL_SETS]
    return Choice(sets, correlations([each.of_seeds for each in sets]))


def table(candidates: Choice) -> Cells:
    """One row per candidate; * marks a strong separation."""
    head = "set|group|blind [m]|with memory [m]|baseline [m]|adaptive [m]|ceiling [m]"
    cells = [[*head.split("|"), "headroom", "memory", "identification", "most alike"]]
    for each in candidates.sets:
        row = [f"{each.of(role):.3f} {of}" if of else "-" for role, of in each.roles.items()]
        row.append(" / ".join("-" if math.isnan(of) else f"{of:.2f}" for of in each.headroom))
        for value, strong in map(each.separates, ("memory", "identification")):
            text = "> 99" if value > 99.0 else f"{value:.2f}"
            row.append("-" if math.isnan(value) else text + "*" * strong)
        other, value = candidates.closest(each.name, candidates.sets)
        cells.append([each.name, each.group or "-", *row, f"{other} {value:.2f}" if other else "-"])
    return cells


def correlation_table(candidates: Choice) -> Cells:
    """Rank correlations of the chosen sets with one another."""
    chosen = [i for i, each in enumerate(candidates.sets) if each.group]
    names = [candidates.sets[i].name for i in chosen]
    values = candidates.correlation[np.ix_(chosen, chosen)]
    return [["", *names], *([names[k], *(f"{v:.2f}" for v in row)] for k, row in enumerate(values))]


EXPLANATION = (
    "IQM of the RMSE [m], and whose it is. Headroom: adaptive / ceiling, whole / after 5 s.\n"
    "Memory: (blind - with memory) / (baseline - ceiling). Identification: (baseline - adaptive) / "
    "(baseline -\nceiling). *: strong. Most alike: the candidate with the largest rank correlation."
)


def candidates_of(env: str, version: Version | None) -> tuple[str, ...]:
    """Every set of an environment id in which something is unknown, those of the version first."""
    chosen = () if version is None else names_of(version)
    unknown = [name for name, each in SETS.items() if each.env == env and name not in KNOWN]
    return tuple(dict.fromkeys((*chosen, *unknown)))


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Run what is missing, print the tables, renew the page; returns the exit status."""
    parser = study_parser(program, "Print what every candidate for the sets separates.", 24)
    parser.set_defaults(seeds=1)
    add_option(parser, "sets", "candidates; by default all sets of the environment")
    text = "whose choice is judged, such as torque-unlike-v1 (default: newest of the environment)"
    parser.add_argument("--sets-version", metavar="VERSION", help=text)
    text = "page whose block of this environment, or of the version that is named, is renewed"
    parser.add_argument("--page", type=Path, metavar="FILE", help=text)
    options = parser.parse_args(arguments)
    env, page = env_of(options.env, options.sets), options.page
    version, track = version_of(env, (), options.sets_version), env.partition("/")[2]
    block = f"choice for {options.sets_version or track}"
    if page is not None and not page.is_file():
        raise ValueError(f"--page {page}: no such file; must be a page with the block `{block}`")
    sets = tuple(options.sets or candidates_of(env, version))
    config = BenchmarkConfig(sets, options.episodes, DEVELOPMENT)
    entries, identity = policies_of(options, env), config.identity()
    folder = options.output / f"choice-{track.lower()}" / identity_hash(identity)[:8]
    store = Store(folder, identity)
    candidates = choice(rows_of(records_of(config, entries, store, options.workers)), version)
    conditions = (
        f"{config.episodes} episodes of each set, from seed {config.seed} on (development split), "
        f"{len(entries)} policies; source {identity['source']}."
    )
    show(table(candidates), 2)
    print(EXPLANATION)
    show(correlation_table(candidates), 1)
    print("\n".join([*candidates.verdict(), "", conditions]))
    values = {each.name: each.iqm for each in candidates.sets}
    write_atomically(folder / "choice.json", json.dumps(values, indent=1).encode())
    if page is not None:
        judged = "\n".join(f"- {line}" for line in candidates.verdict())
        tables = markdown_rows(table(candidates)), markdown_rows(correlation_table(candidates), 1)
        chosen = "Rank correlations of the chosen sets:"
        replace_block(page, block, "\n\n".join([tables[0], chosen, tables[1], judged, conditions]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "choice_of_sets"))
