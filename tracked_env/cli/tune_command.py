"""`tracked-env tune`: search the settings of a controller on the development episodes."""

from collections.abc import Sequence
from pathlib import Path

from tracked_env.benchmark import table_model
from tracked_env.benchmark.evaluation_sets import AUDIT, LENGTH
from tracked_env.benchmark.policies import ids_of, registered_policies
from tracked_env.benchmark.runner import progress_bar
from tracked_env.benchmark.tuning import (
    RATE_LIMIT,
    Search,
    Tunable,
    searched,
    tables_of,
    tunable,
    varied,
)
from tracked_env.cli.command_line import Parser
from tracked_env.cli.evaluate_options import (
    Config,
    add_env,
    add_option,
    benchmark_settings,
    chosen_sets,
)
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_number, checked_whole, unknown

BUDGET = Range(3, 10_000, "-", "It is the number of settings that are driven.")
RATE = Range(0.01, 1e9, "-", "It is a factor on the action rate of the default settings.")
EPISODES = Range(4, LENGTH, "-", "It is the number of episodes of each set.")


def _parser(program: str) -> Parser:
    parser = Parser(
        program,
        "Search the settings of a controller on the development episodes, and write a "
        "CSV file with all that was driven and a page of tables. An interrupted search goes on "
        "when the same command is given again.",
    )
    parser.add_argument("policy", help="a registered controller that declares its ranges")
    add_env(parser)
    add_option(parser, "vehicle")
    add_option(parser, "env_args")
    text = "evaluation sets (default: all that separate policies), or FILE.toml: sets of your own"
    add_option(parser, "sets", text)
    text = "settings to be driven, 3 to 10000, the default among them, without the sensitivity"
    parser.add_argument(
        "--budget", type=int, default=200, metavar="N", help=f"{text} (default: 200)"
    )
    add_option(parser, "episodes", f"of each set, 4 to {LENGTH}", default=32)
    add_option(parser, "duration")
    text = "drive default and best on the audit split at the end; look once"
    parser.add_argument("--audit", action="store_true", help=text)
    text = "largest action rate over that of the default settings, 0.01 to 1e9 (any)"
    parser.add_argument(
        "--rate-limit", type=float, default=RATE_LIMIT, metavar="X", help=f"{text} (default: 1.1)"
    )
    add_option(parser, "output", "folder of the files", default=Path("results/tuning"))
    return parser


def registered(name: str, env: str) -> Tunable:
    """The controller of that name for that environment. Raises ValueError."""
    policies = registered_policies()
    factories = {one.name: one.policy for one in policies}
    for id_ in (*reversed(ids_of(env)), None):
        factories |= {one.name: one.policy for one in policies if one.env == id_}
    if name not in factories:
        tuned = [key for key, one in factories.items() if hasattr(one, "TUNABLE")]
        raise unknown("policy", name, tuned)
    return tunable(name, factories[name])


def tune(search: Search, budget: int, audit: bool) -> str:
    """Search, write the page beside the file, and return the tables for a terminal."""
    variations = 4 * len(search.policy.ranges) + 2 * audit
    with progress_bar((budget + variations) * search.max_steps * search.episodes) as progress:
        search.progress = progress
        candidates = list(searched(search.policy.ranges, search.default, budget, search.evaluate))
        best = min(candidates, key=lambda one: one.cost)
        around = {
            (name, factor): search.evaluate(f"{name} x {factor:g}", settings)
            for name, factor, settings in varied(best.settings)
        }
        judged = [(one.stage, one.settings) for one in (candidates[0], best) if audit]
        audited = [search.evaluate(*one, seed=AUDIT) for one in judged]
    config = search.config()
    firsts = sorted({config.first_seed(name) for name in search.sets})
    seeds = ", ".join(f"{first} to {first + search.episodes - 1}" for first in firsts)
    conditions = (
        f"{len(candidates)} settings on {len(search.sets)} sets ({', '.join(search.sets)}), "
        f"{search.episodes} episodes each, seeds {seeds}."
    )
    near = {place: one for place, one in around.items() if one is not None}
    checked = [one for one in audited if one is not None]
    tables = tables_of(search.policy, candidates, near, checked)
    text = f"## `{search.policy.name}` on {config.env}\n\n{conditions}\n\n"
    page = text + table_model.markdown(tables)
    search.file.with_suffix(".md").write_text(page, encoding="utf-8")
    return f"{conditions}\n\n{table_model.terminal(tables, 132)}"


def main(arguments: Sequence[str], program: str) -> int:
    """Search and print; returns the exit status."""
    options = _parser(program).parse_args(arguments)
    budget = checked_whole("--budget", options.budget, BUDGET)
    episodes = checked_whole("--episodes", options.episodes, EPISODES)
    env = chosen_sets(options.env, options.sets).env
    policy = registered(options.policy, env)
    own = Config(options.vehicle, options.env_args, env=env, sets=options.sets)
    settings = {"duration": options.duration, **benchmark_settings(own, "tuning")}
    settings["rate_limit"] = checked_number("--rate-limit", options.rate_limit, RATE)
    search = Search(policy, settings.pop("sets"), episodes, options.output, **settings)
    if search.candidates:
        print(f"going on with {len(search.candidates)} settings of {search.file}")
    print(tune(search, budget, options.audit))
    print(search.file, search.file.with_suffix(".md"), sep="\n")
    return 0
