"""`tracked-env tune`: search the settings of a controller on the development episodes."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import LENGTH, seeds_of, tuning_sets
from tracked_env.benchmark.files import source_fingerprint
from tracked_env.benchmark.policies import ENVIRONMENTS, registered_policies
from tracked_env.benchmark.runner import Progress, StepCounter, progress_bar
from tracked_env.benchmark.store import identity_hash
from tracked_env.benchmark.table_model import aligned
from tracked_env.benchmark.tuning import (
    Candidate,
    Records,
    Settings,
    Tunable,
    best_of,
    candidate_rows,
    default_settings,
    outcome,
    page,
    searched,
    sensitivity_rows,
    tunable,
    varied,
)
from tracked_env.cli.command_line import Parser, reported
from tracked_env.cli.evaluate_options import add_env, add_option, env_of
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_whole, unknown

BUDGET = Range(3, 10_000, "-", "It is the number of settings that are driven.")
EPISODES = Range(4, LENGTH, "-", "It is the number of episodes of each set.")


def _parser(program: str) -> argparse.ArgumentParser:
    parser = Parser(
        program,
        "Search the settings of a controller on the development episodes, and write a "
        "CSV file with all that was driven and a page of tables. An interrupted search goes on "
        "when the same command is given again.",
    )
    parser.add_argument("policy", help="a registered controller that declares its ranges")
    add_env(parser)
    add_option(parser, "sets", "evaluation sets (default: all that separate policies)")
    text = "settings to be driven, the default among them, without those of the sensitivity"
    parser.add_argument("--budget", type=int, default=80, metavar="N", help=f"{text} (default: 80)")
    add_option(parser, "episodes", "of each set", default=32)
    add_option(parser, "duration")
    text = "drive default and best on the audit split at the end; look once"
    parser.add_argument("--audit", action="store_true", help=text)
    add_option(parser, "output", "folder of the files", default=Path("results/tuning"))
    return parser


def registered(name: str, env: str) -> Tunable:
    """The controller of that name for that environment. Raises ValueError."""
    policies = registered_policies()
    here = {one.name: one.policy for one in policies if one.env in (None, ENVIRONMENTS[env])}
    factories = {**{one.name: one.policy for one in policies}, **here}
    if name not in factories:
        tuned = [key for key, one in factories.items() if hasattr(one, "TUNABLE")]
        raise unknown("policy", name, tuned)
    return tunable(name, factories[name])


class Search:
    """Candidates of one policy, driven or read."""

    def __init__(
        self,
        policy: Tunable,
        sets: tuple[str, ...],
        episodes: int,
        folder: Path,
        duration: float | None = None,
    ) -> None:
        self.policy, self.sets, self.episodes, self.duration = policy, sets, episodes, duration
        config = self.config("development")
        context = config.context(sets[0])
        self.default = default_settings(policy, context)
        policy.make(context, **self.default)
        source = source_fingerprint(policy.make.__module__)
        identity = {**config.identity(), "sets": sets, "episodes": episodes}
        identity |= {"policy": source, "ranges": dict(policy.ranges)}
        track = config.env.rpartition("/")[2].lower()
        stem = f"{policy.name}-{track}-{identity_hash(identity)[:8]}"
        self.records = Records(folder / f"{stem}.csv", tuple(policy.ranges), sets)
        self.page = folder / f"{stem}.md"
        self.max_steps = sum(config.max_steps(name) for name in sets)

    def config(self, split: str) -> BenchmarkConfig:
        """The episodes of a split."""
        first = seeds_of(split).start
        return BenchmarkConfig(self.sets, self.episodes, first, duration=self.duration)

    def evaluator(
        self, progress: Progress, split: str = "development"
    ) -> Callable[[str, Settings], Candidate | None]:
        """A function of stage and settings that returns the candidate, None for refused ones."""
        config = self.config(split)

        def evaluate(stage: str, settings: Settings) -> Candidate | None:
            if self.records.has(config.seed, settings):
                stored = self.records.get(config.seed, settings)
                progress(self.max_steps * self.episodes if stored else 0, stage)
                return None if stored is None else stored._replace(stage=stage)
            candidate = self._driven(config, stage, settings, progress)
            self.records.add(config.seed, settings, candidate, stage)
            return candidate

        return evaluate

    def _driven(
        self, config: BenchmarkConfig, stage: str, settings: Settings, progress: Progress
    ) -> Candidate | None:
        try:
            self.policy.make(config.context(self.sets[0]), **settings)
        except ValueError:
            return None
        outcomes = {}
        for name in self.sets:
            counter = StepCounter(progress, self.episodes, f"{stage}: {name}")
            outcomes[name] = outcome(self.policy, settings, config, name, counter)
            counter.end(config.max_steps(name))
        return Candidate(stage, settings, outcomes)


def tune(search: Search, budget: int, audit: bool) -> str:
    """Search, write the page, and return the tables for a terminal."""
    variations = 4 * len(search.policy.ranges) + 2 * audit
    with progress_bar((budget + variations) * search.max_steps * search.episodes) as progress:
        evaluate = search.evaluator(progress)
        driven = list(searched(search.policy.ranges, search.default, budget, evaluate))
        best = best_of(driven)
        around = [evaluate(stage, settings) for stage, settings in varied(best[0].settings)]
        judge = search.evaluator(progress, "audit")
        audited = [judge(one.stage, one.settings) for one in (driven[0], best[0]) if audit]
    sharp, checked = ([one for one in of if one is not None] for of in (around, audited))
    development = search.config("development")
    last = development.seed + search.episodes - 1
    conditions = (
        f"{len(driven)} settings on {len(search.sets)} sets ({', '.join(search.sets)}), "
        f"{search.episodes} episodes each, seeds {development.seed} to {last}."
    )
    text = page(search.policy, development.env, conditions, driven, sharp, checked)
    search.page.write_text(text, encoding="utf-8")
    tables = [candidate_rows([*best, driven[0]]), sensitivity_rows(best[0], sharp)]
    if audit:
        tables.append(candidate_rows(checked))
    return "\n\n".join([conditions, *(aligned(table, names=1) for table in tables)])


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Search and print; returns the exit status."""
    options = _parser(program).parse_args(arguments)
    budget = checked_whole("--budget", options.budget, BUDGET)
    episodes = checked_whole("--episodes", options.episodes, EPISODES)
    env = env_of(options.env, options.sets)
    policy, sets = registered(options.policy, env), options.sets or tuning_sets(env)
    search = Search(policy, sets, episodes, options.output, options.duration)
    if len(search.records):
        print(f"going on with {len(search.records)} settings of {search.records.file}")
    print(tune(search, budget, options.audit))
    print(search.records.file, search.page, sep="\n")
    return 0
