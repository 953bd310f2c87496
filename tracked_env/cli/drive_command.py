"""`tracked-env drive`: drive by keyboard, with what an observer believes beside it."""

import argparse
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.policies import policies_for
from tracked_env.benchmark.policy_interface import Policy, checked_policy, needs_truth, tell_plant
from tracked_env.cli.command_line import Parser
from tracked_env.cli.evaluate_options import add_episode_options, episode_config
from tracked_env.environment_ids import published_id, single_class

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

    from tracked_env.benchmark.video import beliefs_of
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
                beliefs = None if observer is None else beliefs_of(observer)
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


def main(arguments: Sequence[str], program: str) -> int:
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
