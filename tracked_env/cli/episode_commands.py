"""`tracked-env record`, `render` and `drive`: one episode as a log, as a picture, or by keyboard.

Columns of a log, as `tracked-env identify` reads it, are what the sensors say, one row a control
step. A sensor without a new sample leaves its cells empty; a delay is taken off, so that every row
is of one moment.
"""

import argparse
import csv
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID, arrays
from tracked_env.benchmark import video
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.policies import policies_for
from tracked_env.benchmark.policy_interface import Policy, checked_policy, needs_truth, tell_plant
from tracked_env.cli.command_line import Parser, explained
from tracked_env.cli.evaluate_options import add_episode_options, episode_config
from tracked_env.environment_ids import published_id, single_class
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
        "Write a picture of the end (PNG), a film (WebP, GIF, MP4) or a page that replays it "
        "without a server (HTML) of a policy in one episode of an evaluation set.",
    )
    text = "as in `tracked-env evaluate --policies`; of several seeds, the first one drives"
    parser.add_argument("policy", metavar="POLICY", help=text)
    text = "picture to write, ends in .webp, .gif, .mp4, .png or .html (default: episode.gif)"
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


# Driving by keyboard, with what an observer believes beside it

OBSERVERS = {TORQUE_ID: "adaptive", SPEED_ID: "slc-adaptive", TERRAIN_ID: "slc-adaptive"}
DURATION = 120.0  # [s] of an episode
ERROR_LIMIT = 50.0  # [m] from the reference: a person need not follow it
STEPS_SHOWN = 2  # control steps between two pictures
# What keys ask for, over the limit: of both tracks, and added to one and taken from the other. More
# torque spins the tracks, which then do not turn the vehicle.
REACH = {"torque": (0.25, 0.3), "speed": (0.6, 0.3)}
RATE = 2.0  # [1/s] at which keys move the command
KEYS = """arrows or W A S D   drive and turn; let go: the command falls to zero
space               no command at once
R                   a new episode
Esc, Q              end"""


class Controls:
    """From events of the keyboard to actions; drive: what an action is, a key of REACH."""

    def __init__(self, drive: str) -> None:
        self._reach = REACH[drive]
        self.quit = self.again = False  # asked for
        self._pressed: set[int] = set()
        self._command = np.zeros(2)  # forward, to the left

    def take(self, events: Iterable[Any]) -> None:
        """Take note of what has happened since the last call."""
        import pygame

        for event in events:
            if event.type in (pygame.QUIT, pygame.WINDOWCLOSE):
                self.quit = True
            elif event.type == pygame.KEYDOWN:
                self._pressed.add(event.key)
                self.quit |= event.key in (pygame.K_ESCAPE, pygame.K_q)
                self.again |= event.key == pygame.K_r
            elif event.type == pygame.KEYUP:
                self._pressed.discard(event.key)

    def action(self, period: float) -> NDArray[np.float32]:
        """Action left, right in [-1, 1], `period` [s] after the last one."""
        import pygame

        def pressed(*keys: int) -> float:
            return float(not self._pressed.isdisjoint(keys))

        forward = pressed(pygame.K_UP, pygame.K_w) - pressed(pygame.K_DOWN, pygame.K_s)
        left = pressed(pygame.K_LEFT, pygame.K_a) - pressed(pygame.K_RIGHT, pygame.K_d)
        change = np.array([forward, left]) * self._reach - self._command
        self._command += np.clip(change, -RATE * period, RATE * period)
        if pygame.K_SPACE in self._pressed:
            self._command[:] = 0.0
        ahead, turn = self._command
        return np.clip([ahead - turn, ahead + turn], -1.0, 1.0).astype(np.float32)


def drive(config: BenchmarkConfig, name: str, observer: Policy | None) -> list[float]:
    """Drive a set in a window until the end is asked for; distances [m] to the reference."""
    import pygame

    from tracked_env.rendering import Renderer, source_of

    pygame.display.init()
    pygame.event.clear([pygame.QUIT, pygame.WINDOWCLOSE])  # of windows that were closed before
    env = single_class(config.env)(**config.arguments(name, truth=False))
    period = env.simulation.solver.control_period
    terrain = source_of(env.simulation, 0)
    renderer = Renderer("human", round(1.0 / (STEPS_SHOWN * period)), terrain=terrain)
    controls, distances = Controls(env.simulation.solver.drive.name), list[float]()
    seed, over, steps = config.first_seed(name), True, 0
    controls.again = True
    try:
        while not controls.quit:
            if controls.again:
                observation, _ = env.reset(seed=seed)
                controls.again, over, seed = False, False, seed + 1
                state, start = None, np.ones(1, dtype=bool)
                if observer is not None:
                    tell_plant(observer, env.simulation.solver.reads.names)
            if not over:
                if observer is not None:  # it sees what was commanded; its own action is not used
                    _, state = observer.predict(observation[None], state, start, deterministic=True)
                    start = np.zeros(1, dtype=bool)
                observation, _, ended, timed_out, info = env.step(controls.action(period))
                distances.append(float(info["tracking_error"][0]))
                over, steps = ended or timed_out, steps + 1
            if over or steps % STEPS_SHOWN == 0:
                beliefs = None if observer is None else video.beliefs_of(observer)
                renderer.draw(env.simulation, 0, beliefs)
                controls.take(pygame.event.get())
    finally:
        renderer.close()
        env.close()
    return distances


def _observer(name: str, config: BenchmarkConfig) -> Policy:
    """The policy whose beliefs are shown. Raises ValueError for one that identifies nothing."""
    entry = policies_for(config.env, [name])[0]
    policy = checked_policy(entry, config.context(config.sets[0]))
    if needs_truth(policy) or not hasattr(policy, "estimates"):
        why = "it is given the truth" if needs_truth(policy) else "it identifies nothing"
        usual = OBSERVERS[published_id(config.env)]
        raise ValueError(
            f"--observer {name}: {why}; must be a policy that identifies, as {usual}, or none"
        )
    return policy


def drive_main(arguments: Sequence[str], program: str) -> int:
    """Drive; returns the exit status."""
    text = (
        "Drive a vehicle of an evaluation set in a window; the panel shows what an\n"
        "observer believes of vehicle and soil, beside the truth."
    )
    layout = argparse.RawDescriptionHelpFormatter
    parser = Parser(program, text, epilog=KEYS, formatter_class=layout)
    text = "policy whose estimates are shown, or `none` (default: adaptive or slc-adaptive)"
    parser.add_argument("--observer", metavar="POLICY", help=text)
    add_episode_options(parser)
    options = parser.parse_args(arguments)
    import tracked_env.rendering  # noqa: F401, says what is missing before anything is compiled

    config = episode_config(options)
    config = replace(config, error_limit=ERROR_LIMIT, duration=config.duration or DURATION)
    name, uncertainty_set = options.observer or OBSERVERS[published_id(config.env)], config.sets[0]
    observer = None if name == "none" else _observer(name, config)
    print(KEYS)
    distances = drive(config, uncertainty_set, observer)
    error = math.sqrt(float(np.mean(np.square(distances)))) if distances else 0.0
    duration = f"{len(distances) / config.control_rate:.1f} s driven"
    seed = config.first_seed(uncertainty_set)
    print(f"{duration}, RMSE {error:.3f} m, set {uncertainty_set}, seed {seed}")
    return 0
