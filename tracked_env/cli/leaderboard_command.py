"""`tracked-env leaderboard`: evaluation of everything that is registered, and the tables."""

from collections.abc import Sequence

from tracked_env.cli.evaluate_command import run_config
from tracked_env.cli.evaluate_options import ENVIRONMENTS, add_env, add_options, config_of
from tracked_env.cli.exit_status import Parser

# What a leaderboard has in its own way; everything else is as in `tracked-env evaluate`.
_FIXED = ("env", "policies", "trust", "sets", "sensors", "reference", "duration", "lateral",
          "figures", "video", "paper", "all")  # fmt: skip


def main(arguments: Sequence[str], program: str) -> int:
    """Evaluate on the environments one after the other; returns the exit status."""
    parser = Parser(
        program,
        "Evaluate all registered policies on all sets, and write leaderboard.json, "
        "leaderboard.md and leaderboard.html.",
    )
    add_env(parser, text="this environment alone", default=None)
    add_options(parser, without=_FIXED)
    given = parser.parse_args(arguments)
    chosen = [given.env] if given.env else list(ENVIRONMENTS)
    for env in chosen:
        given.env, given.all, given.figures = env, True, False
        status = run_config(config_of(given), program)
        if status != 0:
            return status
    return 0
