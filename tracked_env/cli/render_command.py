"""`tracked-env render`: a policy in one episode of a set, as GIF, MP4, PNG or HTML."""

from collections.abc import Sequence
from pathlib import Path

from tracked_env.benchmark import video
from tracked_env.benchmark.policies import policies_for
from tracked_env.cli.command_line import Parser, reported
from tracked_env.cli.evaluate_command import benchmark_config
from tracked_env.cli.evaluate_options import add_episode_options, config_of


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Draw an episode, each file named on a line; returns the exit status."""
    parser = Parser(
        program,
        "Write a picture of the end (PNG), a film (GIF, MP4) or a page that replays it "
        "(HTML) of a policy in one episode of an evaluation set.",
    )
    text = "as in `tracked-env evaluate --policies`; of several seeds, the first one drives"
    parser.add_argument("policy", metavar="POLICY", help=text)
    text = "ends in .gif, .mp4 or .png (default: episode.gif, and none with --html)"
    parser.add_argument("--file", type=Path, metavar="FILE", help=text)
    text = "time that a PNG shows [s] (default: the end)"
    parser.add_argument("--at", type=float, metavar="T", help=text)
    text = "from above or from behind the vehicle (default: top)"
    parser.add_argument("--view", choices=("top", "3d"), default="top", help=text)
    text = "page that replays the episode, without a server"
    parser.add_argument("--html", type=Path, metavar="FILE", help=text)
    add_episode_options(parser)
    options = parser.parse_args(arguments)
    file, page, view, at = options.file, options.html, options.view, options.at
    config = benchmark_config(config_of(options))
    uncertainty_set = config.sets[0]
    entry = policies_for(config.env, [options.policy])[0]
    if page is not None and file is None and (at is not None or view != "top"):
        wrong = f"--view {view}" if at is None else f"--at {at:g}"
        raise ValueError(
            f"{wrong} changes nothing on a page, which has its own time and view; "
            "must be given with --file"
        )
    if page is not None and page.suffix.lower() != ".html":
        raise ValueError(f"file {page}: must end in .html")
    if page is not None:
        from tracked_env.rendering import viewer

        viewer.check_installed()
    elif file is None:
        file = Path("episode.gif")
    label = f"{entry.name}, set {uncertainty_set}, seed {config.seed}"
    if file is not None:
        video.draw(config, entry, uncertainty_set, 0, file, view, at)
        print(f"{label}: {file}")
    if page is not None:
        viewer.write_html(video.record_episode(config, entry, uncertainty_set, 0), page)
        print(f"{label}: {page}")
    return 0
