"""Which evaluation sets decide: separations and rank correlations, from records.

Per set, with the interquartile means (IQM) of the tracking RMSE of these policies:
    blind      the best agent that learned to drive from one observation
    memory     the best policy that keeps something of former observations, without the truth
    baseline   the non-adaptive controller of the drive
    adaptive   the controller that identifies the parameters under way
    ceiling    the best policy with the true parameters
    separation of memory          (blind - memory) / (baseline - ceiling)
    separation of identification  (baseline - adaptive) / (baseline - ceiling)
What is below 0 is 0. A separation is strong above MEMORY or IDENTIFICATION where the first IQM of
its numerator is also at least SEPARATION_RATIO times the second one. Where baseline and ceiling are
closer than that ratio nothing is there to be identified, and the separation of identification is 0.
The rank correlation of two sets is Spearman's, over the IQMs of all policies, every training of an
agent one of them: above ALIKE one of the two says what the other one says.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp

from tracked_env.benchmark.evaluation_sets import Version, group_of
from tracked_env.benchmark.statistics import interquartile_mean
from tracked_env.benchmark.summary import ALL_SETS, SEPARATION_RATIO, Row

MEMORY = 0.5  # [-] from here on a separation of memory is strong
IDENTIFICATION = 0.3  # [-] likewise
ALIKE = 0.9  # [-] rank correlation
FEWEST, MOST = 10, 12  # sets of an environment
STRONG = 4  # sets of either strong separation
# Those that keep nothing of former observations but are no agents.
MEMORYLESS = ("nominal", "uc", "slc", "slc-flat")
BASELINES = ("integral", "slc", "nominal", "uc")  # the first one that is there
ADAPTIVE = ("adaptive", "slc-adaptive")


class Separation(NamedTuple):
    """What one set separates."""

    name: str
    group: str  # of the version; empty for a candidate
    iqm: dict[str, float]  # [m] of every agent, all its seeds together
    of_seeds: dict[str, float]  # [m] of every policy, the seeds of an agent apart
    blind: str | None
    memory: str | None
    baseline: str | None
    adaptive: str | None
    ceiling: str | None

    def of(self, role: str) -> float:
        """IQM [m] of the policy in a role; NaN where nobody has it."""
        name = getattr(self, role)
        return math.nan if name is None else self.iqm[name]

    @property
    def gap(self) -> float:
        """Baseline - ceiling [m]."""
        return self.of("baseline") - self.of("ceiling")

    @property
    def of_memory(self) -> float:
        """Separation of memory [-], NaN where a role is not filled."""
        return _share(self.of("blind") - self.of("memory"), self.gap)

    @property
    def of_identification(self) -> float:
        """Separation of identification [-], NaN where a role is not filled."""
        if self.of("baseline") < SEPARATION_RATIO * self.of("ceiling"):
            return 0.0
        return _share(self.of("baseline") - self.of("adaptive"), self.gap)

    @property
    def needs_memory(self) -> bool:
        """Whether the separation of memory is strong."""
        apart = self.of("blind") >= SEPARATION_RATIO * self.of("memory")
        return apart and self.of_memory > MEMORY

    @property
    def needs_identification(self) -> bool:
        """Whether the separation of identification is strong."""
        apart = self.of("baseline") >= SEPARATION_RATIO * self.of("adaptive")
        return apart and self.of_identification > IDENTIFICATION


def _share(difference: float, gap: float) -> float:
    """Difference over gap, at least 0; infinite where only the gap is 0 or negative."""
    if math.isnan(difference) or math.isnan(gap):
        return math.nan
    if difference <= 0.0:
        return 0.0
    return difference / gap if gap > 0.0 else math.inf


def is_blind(agent: str) -> bool:
    """Whether an agent, by its name, learned to drive from one observation."""
    return agent.endswith("-blind") and not agent.startswith("recurrent-")


def separation(name: str, row: Row, version: Version | None = None) -> Separation:
    """The roles of a set, from its row of the summary."""
    iqm = {agent: row.iqm(agent) for agent in row.names}

    def best(names: Sequence[str]) -> str | None:
        return min(names, key=iqm.__getitem__, default=None)

    blind = [agent for agent in iqm if is_blind(agent)]
    truthful = row.reading_truth()
    others = {*blind, *truthful, *MEMORYLESS}
    of_seeds = {
        policy: float(interquartile_mean(values))
        for agent, policies in row.seeds.items()
        for policy, values in zip(policies, row.matrix(agent, "tracking_rmse"), strict=True)
    }
    return Separation(
        name,
        "" if version is None else group_of(name, version),
        iqm,
        of_seeds,
        best(blind),
        best([agent for agent in iqm if agent not in others]),
        next((agent for agent in BASELINES if agent in iqm), None),
        next((agent for agent in ADAPTIVE if agent in iqm), None),
        row.ceiling(),
    )


def ranks(values: Sequence[float]) -> NDArray[np.float64]:
    """Ranks from 1 on, the mean rank for equal values."""
    array = np.asarray(values, dtype=np.float64)
    below = (array[None, :] < array[:, None]).sum(axis=1)
    return below + 0.5 * ((array[None, :] == array[:, None]).sum(axis=1) + 1.0)


def rank_correlation(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    """Spearman's correlation [-] of two sets over their policies; NaN if all are equal."""
    first, second = (ranks([of[agent] for agent in one]) for of in (one, other))
    if min(np.ptp(first), np.ptp(second)) == 0.0:
        return math.nan
    return float(np.corrcoef(first, second)[0, 1])


def correlations(sets: Sequence[Mapping[str, float]]) -> NDArray[np.float64]:
    """Rank correlations (S, S) of sets {policy: value} with one another."""
    return np.array([[rank_correlation(one, other) for other in sets] for one in sets])


def without_one(sets: Sequence[Mapping[str, float]]) -> NDArray[np.float64]:
    """The largest rank correlations (S, S) of sets {policy: value} whichever policy is left out."""
    policies = list(sets[0]) if sets else []
    if len(policies) < 2:  # nobody is left
        return correlations(sets)
    return np.fmax.reduce(
        [
            correlations([{p: of[p] for p in policies if p != out} for of in sets])
            for out in policies
        ]
    )


def unlike(correlation: NDArray[np.float64], preferred: Sequence[int] = ()) -> list[int]:
    """The most sets of which no two have a rank correlation above ALIKE: their places, rising.

    correlation (S, S). Exact, by integer programming: x_i + x_j <= 1 for each pair that is alike.
    preferred: places that are taken rather than others where the number is the same.
    """
    count = len(correlation)
    if count == 0:
        return []
    gain, whole = np.ones(count), np.ones(count, dtype=np.int64)
    gain[list(preferred)] += 0.5 / count
    pairs = np.argwhere(np.triu(correlation > ALIKE, 1))
    rows = np.zeros((len(pairs), count))
    for row, pair in zip(rows, pairs, strict=True):
        row[pair] = 1.0
    limits = [LinearConstraint(rows, -np.inf, 1.0)] if len(pairs) else []
    found = milp(-gain, constraints=limits, integrality=whole, bounds=Bounds(0.0, 1.0))
    taken = np.asarray(found.x) > 0.5  # there is a solution: no set at all is one
    return [int(i) for i in np.flatnonzero(taken)]


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

    def judgement(self) -> list[tuple[bool, str]]:
        """Whether the chosen sets are as many, as strong and as different as they should be."""
        chosen = self.chosen()
        memory = [each.name for each in chosen if each.needs_memory]
        identification = [each.name for each in chosen if each.needs_identification]
        alike = []
        for i, each in enumerate(chosen):
            other, value = self.closest(each.name, chosen[:i])
            if value > ALIKE:
                alike.append(f"{each.name} and {other} ({value:.2f})")
        return [
            (FEWEST <= len(chosen) <= MOST, f"{FEWEST} to {MOST} sets: {len(chosen)}"),
            (
                len(memory) >= STRONG,
                f"at least {STRONG} with a separation of memory above {MEMORY}: "
                f"{len(memory)} ({', '.join(memory) or 'none'})",
            ),
            (
                len(identification) >= STRONG,
                f"at least {STRONG} with a separation of identification above {IDENTIFICATION}: "
                f"{len(identification)} ({', '.join(identification) or 'none'})",
            ),
            (
                not alike,
                f"no two with a rank correlation above {ALIKE}: {', '.join(alike) or 'none'}",
            ),
        ]


def choice(rows: Mapping[str, Row], version: Version | None = None) -> Choice:
    """The separations of all sets, and how alike they are; rows: of the summary."""
    sets = [separation(name, row, version) for name, row in rows.items() if name != ALL_SETS]
    return Choice(sets, correlations([each.of_seeds for each in sets]))


def table(found: Choice) -> list[list[str]]:
    """Rows of cells, the header first: one row per candidate."""
    cells = [
        ["set", "group", "blind [m]", "with memory [m]", "baseline [m]", "adaptive [m]",
         "ceiling [m]", "memory", "identification", "most alike"],
    ]  # fmt: skip
    for each in found.sets:
        other, value = found.closest(each.name, found.sets)

        def role(name: str, of: Separation = each) -> str:
            agent = getattr(of, name)
            return "-" if agent is None else f"{of.of(name):.3f} {agent}"

        cells.append(
            [each.name, each.group or "-", *map(role, ("blind", "memory", "baseline", "adaptive")),
             role("ceiling"), _strength(each.of_memory, each.needs_memory),
             _strength(each.of_identification, each.needs_identification),
             f"{other} {value:.2f}" if other else "-"]
        )  # fmt: skip
    return cells


def _strength(value: float, strong: bool) -> str:
    """A separation; * where it is strong."""
    if math.isnan(value):
        return "-"
    return f"{'> 99' if value > 99.0 else f'{value:.2f}'}{'*' if strong else ''}"


def correlation_table(found: Choice) -> list[list[str]]:
    """Rows of cells, the header first: rank correlations of the chosen sets with one another."""
    chosen = [i for i, each in enumerate(found.sets) if each.group]
    names = [found.sets[i].name for i in chosen]
    rows = [
        [names[k], *(f"{found.correlation[i, j]:.2f}" for j in chosen)]
        for k, i in enumerate(chosen)
    ]
    return [["", *names], *rows]


EXPLANATION = (
    "IQM of the RMSE [m], and whose it is. Memory: (blind - with memory) / (baseline - ceiling). "
    "Identification:\n(baseline - adaptive) / (baseline - ceiling). *: strong. Most alike: the "
    "candidate with the largest rank correlation."
)


def verdict(found: Choice) -> str:
    """The judgement in lines, each with `met` or `NOT met`, and what could be had."""
    lines = [f"{'met' if met else 'NOT met'}: {text}" for met, text in found.judgement()]
    pools = [(found.chosen(), "chosen sets"), (found.sets, "candidates")]
    for among, all_of in pools[: 1 if pools[0][0] == found.sets else 2]:
        for lasting, whichever in ((False, ""), (True, ", whichever policy is left out")):
            unalike = found.most_unlike(among, lasting)
            names = ", ".join(each.name for each in unalike)
            lines.append(
                f"of the {len(among)} {all_of} at most {len(unalike)} go together without a pair "
                f"above {ALIKE}{whichever}: {names or 'none'}"
            )
    return "\n".join(lines)
