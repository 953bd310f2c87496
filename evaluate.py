"""Compare policies on randomized tracked vehicles and soils, on the same episodes for all.

Every policy meets the same vehicles, soils, references and sensor noise. The summary says, per
uncertainty set, how far each policy is from the reference, and whether the first one is clearly
worse than the others; the leaderboard orders them by score. Results go to a folder named after
the configuration, under OUTPUT: results.json, episodes.csv, summary.md, leaderboard.html and
figures.

An interrupted run loses at most the chunk of episodes in progress; run it again to continue.
"""

import sys

from agents.ending import stop_at_once

if __name__ == "__main__":
    # Finished chunks are on disk, and what else a kill leaves is removed by the next run.
    stop_at_once("\nevaluate.py: interrupted; finished episodes are kept, run it again")

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

try:
    import tyro
except ImportError:
    sys.exit("evaluate.py needs tyro: run `make install`, or pip install 'tracked-env[cli]'")

from baselines.registry import BY_DRIVE, POLICIES
from reproduce.command import main as run_paper
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.benchmark import (
    BenchmarkConfig,
    Store,
    Summary,
    check,
    default_sets,
    leaderboard,
    leaderboard_page,
    report,
)
from tracked_env.benchmark.policy_interface import PolicyEntry, PolicyError, checked_policy
from tracked_env.benchmark.policy_lookup import archives, load_policies, shipped_agents
from tracked_env.benchmark.runner import pending, progress_bar, run
from tracked_env.benchmark.sets import VERSION
from tracked_env.benchmark.store import identity_hash
from tracked_env.benchmark.summary import Row, rows_of
from tracked_env.validation import checked_choice, name_or_json

PRETRAINED = Path(__file__).parent / "agents" / "pretrained"
DRIVES = {TORQUE_ID: "torque", SPEED_ID: "speed"}
SHIPPED = {env: shipped_agents(PRETRAINED / env.partition("/")[2]) for env in DRIVES}


@dataclass(frozen=True)
class Config:
    """What to compare, on what, and where the results go."""

    # Each line of these texts is a line of --help.
    env: Literal["tracked_env/Torque-v0", "tracked_env/Speed-v0"] = "tracked_env/Torque-v0"
    """Environment id: sprocket torques as actions, or speeds."""

    policies: tuple[str, ...] | None = None
    """Policies to compare; the first one is the baseline.
    Default: all controllers and the shipped agents.
    Of Torque-v0:
    nominal: feedback linearization, nominal parameters.
    adaptive: the same, parameters identified on line.
    oracle: the same, true parameters.
    Of Speed-v0:
    uc: Lyapunov control of a unicycle, slip unknown.
    slc: slippage-aware, slip identified beforehand.
    slc-adaptive: the same, slip identified on line.
    slc-oracle: the same, slip of the true soil.
    Of both:
    ppo-blind ...: agents/pretrained, with all seeds.
    path/to/agent.zip: an agent of train.py, or, with
    --trust, any other archive of Stable-Baselines3.
    NAME=runs/ppo-*/agent.zip: the seeds of one agent,
    summarised together.
    module:attribute: any object with a `predict` as in
    Stable-Baselines3, or what makes one. It is imported
    and run."""

    trust: bool = False
    """Open archives that hold pickled objects too: those of Stable-
    Baselines3 itself, and of former versions of train.py. Opening one
    runs any code that its author put there: only for authors whom
    you trust. Agents of train.py hold none and need it not."""

    sets: tuple[str, ...] | None = None
    """Evaluation sets: laws of vehicle, soil and changes,
    and sensors. Default: all of ENV but the known ones."""

    episodes: int = 32
    """Episodes per set; the frozen ones are the first 100 of each."""

    seed: int = 0
    """Seed of the first episode; of the frozen ones it is 0."""

    sensors: str | None = None
    """Instead of the sensors of each set: ideal, rtk,
    strawa, mocap, or JSON:
    '{"preset": "rtk", "pose_delay": 0.1}'"""

    reference: str | None = None
    """Instead of the reference of each set: random, mixed,
    circle, figure_eight, straight, spiral, chicane,
    identification, or JSON:
    '{"kind": "circle", "radius": 10, "speed": 2}'"""

    duration: float | None = None
    """Instead of the length of the episodes of each set [s]."""

    lateral: Literal["sliding", "constrained"] = "sliding"
    """Lateral model of the lumped plant: sliding tracks, or the
    ICR at a constant distance, as in the paper."""

    output: Path = Path("results")
    """Folder for results; each configuration gets its own in
    it, which one evaluate.py at a time may write."""

    figures: bool = True
    """Draw paths, errors, torque and slip as PNG."""

    video: bool = False
    """Record the first episode of the first set, every policy."""

    paper: Literal["none", "strawa2021", "focchi2025"] = "none"
    """Instead of the benchmark, run a paper's experiments again:
    its claims beside the results, its figures, one page."""

    chunk: int = 64
    """Episodes run and stored together; numbers do not change."""

    def named_policies(self) -> tuple[str, ...]:
        """The policies asked for, or all there are for the environment."""
        agents = SHIPPED[self.env] if find_spec("torch") else ()
        return self.policies or (*BY_DRIVE[DRIVES[self.env]], *agents)


def benchmark_config(config: Config) -> BenchmarkConfig:
    """The part of the command line that the benchmark knows. Raises ValueError."""
    checked_choice("environment", config.env, DRIVES)
    return BenchmarkConfig(
        sets=config.sets or default_sets(config.env),
        episodes=config.episodes,
        seed=config.seed,
        reference=name_or_json(config.reference, "reference"),
        sensors=name_or_json(config.sensors, "sensors"),
        duration=config.duration,
        lateral=config.lateral,
        chunk=config.chunk,
    )


def result_folder(output: Path, benchmark: BenchmarkConfig) -> Path:
    """One folder per configuration: the readable part of it, and the hash of all of it."""
    labels = [
        spec if isinstance(spec, str) else spec.get(key, "custom")
        for spec, key in ((benchmark.reference, "kind"), (benchmark.sensors, "preset"))
        if spec is not None
    ]
    if benchmark.duration is not None:
        labels.append(f"{benchmark.duration:g}s")
    track = [benchmark.env.partition("/")[2].lower()] if benchmark.env == SPEED_ID else []
    name = "-".join([*track, *(labels or [VERSION]), f"seed{benchmark.seed}"])
    return output / f"{name}-{identity_hash(benchmark.identity())[:8]}"


def draw(
    config: Config,
    benchmark: BenchmarkConfig,
    entries: list[PolicyEntry],
    store: Store,
    records: list[dict[str, Any]],
) -> None:
    """Figures and videos, as far as they are asked for and their packages are installed."""
    folder = store.folder
    try:
        if config.figures:
            from tracked_env.benchmark import episode_figures

            files = episode_figures.save_all(
                folder / "figures", store, records, benchmark.sets, benchmark.seed
            )
            print(f"{len(files)} figures in {folder / 'figures'}")
        if config.video:
            from tracked_env.benchmark import video

            for entry in entries:
                path = video.record(benchmark, entry, benchmark.sets[0], 0, folder / "videos")
                print(f"video {path}")
    except ImportError as error:
        print(f"not drawn: {error}", file=sys.stderr)


def open_archive(path: Path, trust: bool = False) -> PolicyEntry:
    """A trained agent; PyTorch is imported only here. trust: unpickle it if need be.

    Raises ValueError.
    """
    try:
        import torch

        from agents.loading import agent_entry
    except ImportError as error:
        raise ValueError(
            f"policy {str(path)!r}: {error}. Trained agents need pip install 'tracked-env[rl]'"
        ) from error
    torch.set_num_threads(1)  # networks this small are faster on one, and a busy machine is too
    return agent_entry(path, trust)


def write_leaderboard(
    config: Config, store: Store, summary: Summary, rows: Mapping[str, Row], conditions: str
) -> str:
    """Write the leaderboard as JSON, Markdown and HTML; returns it as text."""
    board = leaderboard.leaderboard(summary, rows, conditions)
    leaderboard.write(store.folder, board)
    shipped = SHIPPED[config.env]
    paths = [path for spec in config.named_policies() for path in archives(spec, shipped)]
    folders: dict[str, list[Path]] = {}
    for name, path in paths:
        folders.setdefault(name, []).append(path.parent)
    curves = leaderboard.read_curves(folders)
    leaderboard_page.write(store.folder, board, list(rows.values())[-1], curves, config.figures)
    return leaderboard.terminal(board)


def main(config: Config) -> int:
    """Run what is asked for; returns the exit status. One line on stderr says what failed."""
    try:
        if config.paper != "none":
            return run_paper(config.paper, config.output, config.figures)
        return compare(config)
    except (PolicyError, OSError) as error:
        print(f"evaluate.py: {error}", file=sys.stderr)
        return 1


def compare(config: Config) -> int:
    """The benchmark: run, print the summary, write the results; returns the exit status."""
    began = time.perf_counter()
    try:
        benchmark = benchmark_config(config)
        entries = load_policies(
            config.named_policies(), POLICIES, SHIPPED[config.env],
            partial(open_archive, trust=config.trust),
        )  # fmt: skip
        for entry in entries:  # reject incompatible policies first
            checked_policy(entry, benchmark.context(benchmark.sets[0]))
        store = Store(result_folder(config.output, benchmark), benchmark.identity())
    except ValueError as error:
        print(f"evaluate.py: {error}", file=sys.stderr)
        return 2
    checked = check(benchmark)
    for notice in (*store.notices, checked.message):
        print(notice)
    known = len(store.notices)
    tasks = list(pending(benchmark, entries, store))
    asked = len(entries) * len(benchmark.sets) * benchmark.episodes
    missing = sum(len(task.episodes) for task in tasks)
    if missing < asked:
        print(f"{asked - missing} of {asked} episodes are already in {store.folder}")
    steps = sum(len(task.episodes) * benchmark.max_steps(task.uncertainty_set) for task in tasks)
    with progress_bar(steps) as progress:
        records = run(benchmark, entries, store, progress)
    try:
        rows = rows_of(records)
    except ValueError as error:  # stored episodes that contradict each other
        print(f"evaluate.py: {error}", file=sys.stderr)
        return 1
    summary = report.summarise(records, rows)
    report.write(store.folder, {**store.header, "benchmark": checked._asdict()}, records, summary)
    conditions = f"{checked.message}; source {benchmark.identity()['source']}"
    board = write_leaderboard(config, store, summary, rows, conditions)
    print(f"\n{report.terminal(summary)}\n\n\nLeaderboard\n\n{board}\n")
    print(f"results.json, episodes.csv, summary.md and leaderboard.html in {store.folder}")
    draw(config, benchmark, entries, store, records)
    for notice in store.notices[known:]:
        print(notice)
    print(f"done in {time.perf_counter() - began:.1f} s")
    return 0


if __name__ == "__main__":
    sys.path.insert(0, "")  # so that `module:attribute` finds modules of the current folder
    sys.exit(main(tyro.cli(Config, description=__doc__)))
