"""`tracked-env render`: a policy in one episode of a set, as GIF, MP4, PNG or HTML."""

from collections.abc import Sequence
from pathlib import Path

from tracked_env.benchmark import video
from tracked_env.benchmark.policies import policies_for
from tracked_env.cli.command_line import Parser
from tracked_env.cli.evaluate_options import add_episode_options, episode_config


def main(arguments: Sequence[str], program: str) -> int:
    """Draw an episode; returns the exit status."""
    parser = Parser(
        program,
        "Write a picture of the end (PNG), a film (GIF, MP4) or a page that replays it without a "
        "server (HTML) of a policy in one episode of an evaluation set.",
    )
    text = "as in `tracked-env evaluate --policies`; of several seeds, the first one drives"
    parser.add_argument("policy", metavar="POLICY", help=text)
    text = "ends in .gif, .mp4, .png or .html (default: episode.gif)"
    default = Path("episode.gif")
    parser.add_argument("--file", type=Path, default=default, metavar="FILE", help=text)
    text = "time that a PNG shows [s] (default: the end)"
    parser.add_argument("--at", type=float, metavar="T", help=text)
    text = "from above or from behind the vehicle (default: top)"
    parser.add_argument("--view", choices=("top", "3d"), default="top", help=text)
    add_episode_options(parser)
    options = parser.parse_args(arguments)
    file, view, at = options.file, options.view, options.at
    config = episode_config(options)
    entry = policies_for(config.env, [options.policy])[0]
    episode = config, entry, config.sets[0], 0
    if file.suffix.lower() != ".html":
        video.draw(*episode, file, view, at)
    elif at is None and view == "top":
        from tracked_env.rendering import viewer

        viewer.write_html(video.record_episode(*episode), file)
    else:
        raise ValueError(
            f"file {file}: a page has its own time and view; leave out --at and --view"
        )
    print(f"{entry.name}, set {config.sets[0]}, seed {config.first_seed(config.sets[0])}: {file}")
    return 0
