"""`tracked-env render` and `tracked-env record`: a picture or the log of a policy in one episode.

Columns of a log, as `tracked-env identify` reads it, are what the sensors say, one row a control
step. A sensor without a new sample leaves its cells empty; a delay is taken off, so that every row
is of one moment.
"""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tracked_env import arrays
from tracked_env.benchmark import video
from tracked_env.benchmark.policies import policies_for
from tracked_env.benchmark.policy_interface import checked_policy, needs_truth
from tracked_env.cli.command_line import Parser, explained
from tracked_env.cli.evaluate_options import add_episode_options, episode_config
from tracked_env.sensors import CHANNEL_COUNT, CHANNELS, GROUP_START, GROUPS

IDENTIFIED = (
    *("mass", "inertia", "longitudinal_resistance", "lateral_resistance"),
    *("effort_maximum", "shear_deformation_modulus"),
)


def record_log(
    env: Any, policy: Any, path: Path | str, seed: int | None = None
) -> dict[str, float]:
    """Drive one episode and write its log; returns the true values at its end, SI by name.

    env: an environment of this package, single or a vector of one, perhaps wrapped. policy: any
    object with `predict(observation, state, episode_start)`, as Stable-Baselines3 has it.
    Raises ValueError for a vector of several vehicles.
    """
    return record_logs(env, policy, [path], seed)[0]


def record_logs(
    env: Any, policy: Any, paths: Sequence[Path | str], seed: Any = None
) -> list[dict[str, float]]:
    """The same for each vehicle of a vector environment; seed: as its `reset` takes it.

    Raises ValueError for another number of vehicles than of paths.
    """
    inner = env.unwrapped
    batch, count = inner.simulation.batch, len(paths)
    if len(batch.floats) != count:
        raise ValueError(f"the environment has {len(batch.floats)} vehicles, for {count} logs")
    observation, _ = env.reset(seed=seed)
    period = inner.simulation.solver.control_period
    rows = [[_row(batch, i, period)] for i in range(count)]
    state, start, over = None, np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    while not over.all():
        action, state = policy.predict(observation, state, start)
        observation, _reward, terminated, truncated, _info = env.step(action)
        for i in np.flatnonzero(~over).tolist():
            rows[i].append(_row(batch, i, period))
        over |= np.asarray(terminated) | np.asarray(truncated)
        start = np.zeros(count, dtype=bool)
    for path, log in zip(map(Path, paths), rows, strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["time", *CHANNELS])
            writer.writerows(log)
    places = [arrays.COLUMN[name] for name in IDENTIFIED]
    return [
        dict(zip(IDENTIFIED, batch.floats[i, places].tolist(), strict=True)) for i in range(count)
    ]


def _row(batch: Any, i: int, period: float) -> list[str]:
    """Time and samples of vehicle i; empty where a group has no new one."""
    step = int(batch.counters[i, arrays.STEP])
    samples = batch.floats[i, arrays.SAMPLE : arrays.SAMPLE + CHANNEL_COUNT]
    sampled_at = batch.floats[i, arrays.SAMPLE + CHANNEL_COUNT :][: len(GROUPS)]
    new = np.repeat(np.round(sampled_at) == step, np.diff(GROUP_START))
    cells = [f"{value:.9g}" if is_new else "" for value, is_new in zip(samples, new, strict=True)]
    return [f"{step * period:.6f}", *cells]


def record_main(arguments: Sequence[str], program: str) -> int:
    """Record a log; returns the exit status."""
    parser = Parser(
        program,
        "Drive one episode of an evaluation set and write what the sensors say as a "
        "CSV log with a row per control step, for `tracked-env identify`.",
    )
    parser.add_argument("policy", help="as in `tracked-env evaluate --policies`")
    text = "log to write (default: log.csv)"
    parser.add_argument("--file", type=Path, default=Path("log.csv"), metavar="FILE", help=text)
    text = "write the true values at the end as JSON too (default: no)"
    parser.add_argument("--truth", type=Path, metavar="FILE", help=text)
    add_episode_options(parser)
    options = parser.parse_args(arguments)
    benchmark = episode_config(options)
    name = benchmark.sets[0]
    entry = policies_for(benchmark.env, [options.policy])[0]
    with explained():
        policy = checked_policy(entry, benchmark.context(name))
        if needs_truth(policy):
            raise ValueError(f"policy {entry.name!r} needs the truth; a log is driven without it")
        env = benchmark.environment(name, 1, truth=False)
        seed = benchmark.first_seed(name)
        truth = record_log(env, policy, options.file, seed)
    print(f"{entry.name}, set {name}, seed {seed}: {options.file}")
    if options.truth is not None:
        options.truth.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
        print(options.truth)
    return 0


def render_main(arguments: Sequence[str], program: str) -> int:
    """Draw an episode; returns the exit status."""
    parser = Parser(
        program,
        "Write a picture of the end (PNG), a film (GIF, MP4) or a page that replays it without a "
        "server (HTML) of a policy in one episode of an evaluation set.",
    )
    text = "as in `tracked-env evaluate --policies`; of several seeds, the first one drives"
    parser.add_argument("policy", metavar="POLICY", help=text)
    text = "picture to write, ends in .gif, .mp4, .png or .html (default: episode.gif)"
    default = Path("episode.gif")
    parser.add_argument("--file", type=Path, default=default, metavar="FILE", help=text)
    text = "time that a PNG shows [s], 0 or more (default: the end)"
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
