"""`tracked-env render`: policies in one episode of a set, as GIF, MP4, PNG or HTML."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from benchmarks.studies.choose_sets import few_seeds
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.policies import by_name, load_policies, open_archive, registered_policies
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.cli.evaluate_command import benchmark_config
from tracked_env.cli.evaluate_options import JoinedNames, add_episode_options, config_of, names
from tracked_env.cli.exit_status import Parser, reported
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_whole

PORTS = Range(1, 65535, "-", "It is the port of 127.0.0.1 that is tried first.")


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Draw an episode; returns the exit status."""
    parser = Parser(
        program,
        "Write a picture of the end (PNG), a film (GIF, MP4) or a page that replays it "
        "(HTML) of a policy in one episode of an evaluation set; two to four policies are shown "
        "side by side in PNG, GIF and MP4.",
    )
    parser.add_argument("drivers", nargs="+", type=names, action=JoinedNames, metavar="POLICY",
                        help="as in `tracked-env evaluate --policies`; of several seeds, the first "
                        "one drives")  # fmt: skip
    parser.add_argument("--file", type=Path, metavar="FILE", help="ends in .gif, .mp4 or .png "
                        "(default: episode.gif, and none with --html or --live)")  # fmt: skip
    parser.add_argument("--at", type=float, metavar="T",
                        help="time that a PNG shows [s] (default: the end)")  # fmt: skip
    parser.add_argument("--view", choices=("top", "3d", "3d-standing"), default="top",
                        help="from above or from behind the vehicle (default: top)")  # fmt: skip
    parser.add_argument("--html", type=Path, metavar="FILE",
                        help="page that replays the episode, without a server")  # fmt: skip
    parser.add_argument("--live", type=int, nargs="?", const=8080, metavar="PORT",
                        help="serve it at 127.0.0.1 with a slider (default: 8080)")  # fmt: skip
    add_episode_options(parser)
    given = parser.parse_args(arguments)
    benchmark = benchmark_config(config_of(given))
    registry, trained = by_name(registered_policies(), benchmark.env)
    loaded = load_policies(given.drivers, registry, trained, open_archive)
    _write(given, benchmark, few_seeds(loaded, 1))
    return 0


def _write(
    given: argparse.Namespace, benchmark: BenchmarkConfig, entries: list[PolicyEntry]
) -> None:
    """Write the files, each named on a line, then serve the page if it is to be."""
    from tracked_env.benchmark import video

    uncertainty_set = benchmark.sets[0]
    drivers = ", ".join(entry.name for entry in entries)
    label = f"{drivers}, set {uncertainty_set}, seed {benchmark.seed}"
    browser = given.html is not None or given.live is not None
    if browser and given.file is None and (given.at is not None or given.view != "top"):
        named = f"--view {given.view}" if given.at is None else f"--at {given.at:g}"
        raise ValueError(f"{named} changes nothing on a page, which has its own time and view; "
                         "must be given with --file")  # fmt: skip
    if given.live is not None:
        checked_whole("--live", given.live, PORTS)
    if given.html is not None and given.html.suffix.lower() != ".html":
        raise ValueError(f"file {given.html}: must end in .html")
    if browser and len(entries) > 1:
        raise ValueError(f"{len(entries)} policies in one page; must be one. Give --file instead")
    if browser:
        from tracked_env.rendering import viewer

        viewer.check_installed()
    file = given.file or (None if browser else Path("episode.gif"))
    if file is not None:
        video.draw(benchmark, entries, uncertainty_set, 0, file, given.view, given.at)
        print(f"{label}: {file}")
    if not browser:
        return
    recording = video.record_episode(benchmark, entries[0], uncertainty_set, 0)
    if given.html is not None:
        viewer.write_html(recording, given.html)
        print(f"{label}: {given.html}")
    if given.live is not None:
        viewer.show(recording, given.live)
