"""Compare policies on randomized tracked vehicles and soils, on the same episodes for all.

Every policy meets the same vehicles, soils, references and sensor noise. The summary says, per
uncertainty set, how far each policy is from the reference, and whether the first one is clearly
worse than the others. Results go to a folder named after the configuration, under OUTPUT:
results.json, episodes.csv, summary.md and figures.

An interrupted run loses at most the chunk of episodes in progress; run it again to continue.
"""

import json
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

try:
    import tyro
except ImportError:
    sys.exit("evaluate.py needs tyro: run `make install`, or pip install 'tracked-env[cli]'")

from baselines.policies import POLICIES
from tracked_env.benchmark import DEFAULT_SETS, BenchmarkConfig, Store, load_policy, report
from tracked_env.benchmark.policies import PolicyEntry
from tracked_env.benchmark.runner import Progress, pending, run
from tracked_env.benchmark.store import identity_hash

INTERRUPTED = 130  # exit status, as shells have it for Ctrl-C


@dataclass(frozen=True)
class Config:
    """What to compare, on what, and where the results go."""

    # Each line of these texts is a line of --help.
    policies: tuple[str, ...] = tuple(POLICIES)
    """Policies to compare; the first one is the baseline.
    nominal: feedback linearization with nominal parameters.
    adaptive: the same controller, parameters identified on line.
    oracle: the same controller with the true parameters.
    path/to/agent.zip: a PPO agent trained by train.py.
    module:attribute: any object with a `predict` as in
    Stable-Baselines3, or a class or function that makes one."""

    sets: tuple[str, ...] = DEFAULT_SETS
    """Uncertainty sets: the laws of vehicle, soil and changes.
    There is also `nominal`: nothing is unknown, no change."""

    episodes: int = 32
    """Episodes per set; episode i is seeded SEED + i."""

    seed: int = 0
    """Seed of the first episode."""

    sensors: str = "rtk"
    """Sensor preset ideal, rtk or strawa, or JSON overrides:
    '{"preset": "rtk", "pose_delay": 0.1}'"""

    reference: str = "random"
    """Reference to follow (random, mixed, circle, figure_eight,
    straight, spiral, identification, chicane), or JSON:
    '{"kind": "circle", "radius": 10, "speed": 2}'"""

    duration: float = 30.0
    """Length of an episode [s]."""

    lateral: Literal["sliding", "constrained"] = "sliding"
    """Lateral closure of the plant: sliding tracks, or the ICR
    held at a constant distance as in the original paper."""

    output: Path = Path("results")
    """Folder for results; each configuration gets its own in it."""

    figures: bool = True
    """Draw paths, errors, torque and slip as PNG."""

    video: bool = False
    """Record the first episode of the first set, every policy."""

    paper: Literal["none", "strawa2021"] = "none"
    """Instead of the benchmark, run section 8 of the paper again:
    its claims beside what comes out, figures 9 to 36, one page."""

    chunk: int = 64
    """Episodes run and stored together; numbers do not change."""


def name_or_json(text: str, what: str) -> str | Mapping[str, Any]:
    """`text` itself, or the JSON object that it holds. Raises ValueError."""
    if not text.lstrip().startswith("{"):
        return text
    try:
        return dict(json.loads(text))
    except ValueError as error:
        raise ValueError(f"--{what} {text}: not a JSON object ({error})") from error


def benchmark_config(config: Config) -> BenchmarkConfig:
    """The part of the command line that the benchmark knows. Raises ValueError."""
    return BenchmarkConfig(
        sets=config.sets,
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
    ]
    name = f"{'-'.join(labels)}-{benchmark.duration:g}s-seed{benchmark.seed}"
    return output / f"{name}-{identity_hash(benchmark.identity())[:8]}"


@contextmanager
def progress_bar(total: int) -> Iterator[Progress]:
    """A function that reports control steps of vehicles; shows a bar when tqdm is installed."""
    try:
        from tqdm import tqdm
    except ImportError:
        yield lambda steps, label: None
        return
    form = "{desc:<28} {percentage:3.0f}% |{bar}| [{elapsed}<{remaining}, {rate_fmt}]"
    with tqdm(
        total=total, unit=" steps", unit_scale=True, bar_format=form, dynamic_ncols=True
    ) as bar:

        def progress(steps: int, label: str) -> None:
            bar.set_description_str(label, refresh=False)
            bar.update(steps)

        yield progress


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
            from tracked_env.benchmark import figures

            files = figures.save_all(
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


def reproduce(config: Config) -> int:
    """Section 8 of the paper: run it, print what it claims beside what comes out, write the page.

    Without matplotlib the page has no figures.
    """
    from baselines import strawa2021 as baseline
    from tracked_env.benchmark import strawa2021
    from tracked_env.benchmark.strawa2021 import claims, page

    began = time.perf_counter()

    def say(text: str) -> None:
        print(f"{time.perf_counter() - began:5.0f} s  {text}", flush=True)

    tools = strawa2021.Tools(
        baseline.controller, baseline.policy, baseline.SlipTool, baseline.SoilTool
    )
    results = strawa2021.run_everything(tools, say)
    folder = config.output / "strawa2021"
    say("page")
    try:
        files = page.write(results, folder, config.figures)
    except ImportError as error:
        print(f"not drawn: {error}", file=sys.stderr)
        files = page.write(results, folder, draw=False)
    print(f"\n{page.terminal(claims.claims(results))}\n")
    names = ", ".join(file.name for file in files if file.suffix != ".png")
    drawn = sum(file.suffix == ".png" for file in files)
    print(f"{names} and {drawn} figures in {folder}; {time.perf_counter() - began:.0f} s")
    return 0


def loaded_policies(specs: tuple[str, ...]) -> list[PolicyEntry]:
    """One entry per name; PyTorch is imported only when a trained agent is among them."""
    entries = []
    for spec in dict.fromkeys(specs):
        if spec.endswith(".zip"):
            try:
                from agents.ppo import agent_entry
            except ImportError as error:
                raise ValueError(
                    f"policy {spec!r}: {error}. Trained agents need pip install 'tracked-env[rl]'"
                ) from error
            entries.append(agent_entry(Path(spec)))
        else:
            entries.append(load_policy(spec, POLICIES))
    return entries


def main(config: Config) -> int:
    """Run, print the summary, write the results; returns the exit status."""
    began = time.perf_counter()
    if config.paper != "none":
        return reproduce(config)
    try:
        benchmark = benchmark_config(config)
        entries = loaded_policies(config.policies)
        store = Store(result_folder(config.output, benchmark), benchmark.identity())
    except ValueError as error:
        print(f"evaluate.py: {error}", file=sys.stderr)
        return 2
    for notice in store.notices:
        print(notice)
    tasks = list(pending(benchmark, entries, store))
    asked = len(entries) * len(benchmark.sets) * benchmark.episodes
    missing = sum(len(task.episodes) for task in tasks)
    if missing < asked:
        print(f"{asked - missing} of {asked} episodes are already in {store.folder}")
    steps = round(benchmark.duration * benchmark.control_rate)
    try:
        with progress_bar(missing * steps) as progress:
            records = run(benchmark, entries, store, progress)
    except KeyboardInterrupt:
        print(f"\ninterrupted; run the same command to continue in {store.folder}", file=sys.stderr)
        return INTERRUPTED
    summary = report.summarise(records)
    report.write(store.folder, store.header, records, summary)
    print(f"\n{report.terminal(summary)}\n")
    print(f"results.json, episodes.csv and summary.md in {store.folder}")
    draw(config, benchmark, entries, store, records)
    print(f"done in {time.perf_counter() - began:.1f} s")
    return 0


if __name__ == "__main__":
    sys.path.insert(0, "")  # so that `module:attribute` finds modules of the current folder
    sys.exit(main(tyro.cli(Config, description=__doc__)))
