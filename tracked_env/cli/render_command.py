"""`tracked-env render`: a GIF, MP4 or PNG of one policy in one episode of an evaluation set."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tracked_env.benchmark import default_sets
from tracked_env.benchmark.policy_interface import PolicyError
from tracked_env.benchmark.policy_lookup import load_policies
from tracked_env.benchmark.registered_policies import by_name, open_archive, registered_policies
from tracked_env.cli.evaluate_command import benchmark_config
from tracked_env.cli.evaluate_options import DRIVES, add_options, config_of

_OTHERS = ("policies", "trust", "sets", "episodes", "output", "figures", "video", "paper", "chunk")


def main(arguments: Sequence[str], program: str) -> int:
    """Draw an episode; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog=program,
        allow_abbrev=False,
        description="Write a picture of the end (PNG) or a film (GIF, MP4) of one policy in one "
        "episode of an evaluation set.",
    )
    parser.add_argument("policy", help="as in `tracked-env evaluate --policies`; of several seeds, "
                        "the first one drives")  # fmt: skip
    parser.add_argument("--set", help="evaluation set (default: the first one of the environment)")
    parser.add_argument("--file", type=Path, default=Path("episode.gif"), metavar="FILE",
                        help="ends in .gif, .mp4 or .png (default: episode.gif)")  # fmt: skip
    add_options(parser, without=_OTHERS)
    given = parser.parse_args(arguments)
    given.sets = [(given.set or default_sets(given.env)[0],)]
    try:
        benchmark = benchmark_config(config_of(given))
        registry, trained = by_name(registered_policies(), DRIVES[benchmark.env])
        entry = load_policies([given.policy], registry, trained, open_archive)[0]
        from tracked_env.benchmark import video

        video.draw(benchmark, entry, benchmark.sets[0], 0, given.file)
    except (PolicyError, ImportError, OSError) as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 1
    except ValueError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 2
    print(f"{entry.name}, set {benchmark.sets[0]}, seed {benchmark.seed}: {given.file}")
    return 0
