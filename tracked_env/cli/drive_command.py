"""`tracked-env drive`: drive by keyboard or gamepad, with what an observer believes beside it."""

import argparse
import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.policies import by_name, load_policies, open_archive, registered_policies
from tracked_env.benchmark.policy_interface import Policy, checked_policy, needs_truth, tell_plant
from tracked_env.cli.evaluate_command import benchmark_config
from tracked_env.cli.evaluate_options import add_episode_options, config_of
from tracked_env.cli.exit_status import Parser, reported

OBSERVERS = {TORQUE_ID: "adaptive", SPEED_ID: "slc-adaptive", TERRAIN_ID: "slc-adaptive"}
DURATION = 120.0  # [s] of an episode
ERROR_LIMIT = 50.0  # [m] from the reference: a person need not follow it
STEPS_SHOWN = 2  # control steps between two pictures
# What keys ask for, over the limit: of both tracks, and added to one and taken from the other. More
# torque spins the tracks, which then do not turn the vehicle.
REACH = {"torque": (0.25, 0.3), "speed": (0.6, 0.3)}
RATE = 2.0  # [1/s] at which keys move the command
DEAD_ZONE = 0.1  # [-] of a stick that does not come back to its middle
START_BUTTONS = (6, 7)  # of the common makes: start, options, back
KEYS = """arrows or W A S D   drive and turn; let go: the command falls to zero
space               no command at once
R                   a new episode
Esc, Q              end
left stick          the same by gamepad, which may be plugged in under way; its
                    start button begins a new episode"""


def of_stick(value: float) -> float:
    """What an axis asks for in [-1, 1]: nothing in the dead zone, then in proportion."""
    beyond = (abs(value) - DEAD_ZONE) / (1.0 - DEAD_ZONE)
    return math.copysign(min(beyond, 1.0), value) if beyond > 0.0 else 0.0


class Controls:
    """From events of keyboard and gamepad to actions; drive: what an action is, a key of REACH."""

    def __init__(self, drive: str) -> None:
        self._reach = REACH[drive]
        self.quit = self.again = False  # asked for
        self._held: set[int] = set()
        self._sticks: dict[int, list[float]] = {}  # of each gamepad: to the right, down
        self._command = np.zeros(2)  # forward, to the left
        self._pads: dict[int, Any] = {}  # by their id; one that nobody holds sends nothing

    def take(self, events: Iterable[Any]) -> None:
        """Take note of what has happened since the last call."""
        import pygame

        for event in events:
            if event.type == pygame.QUIT or event.type == pygame.WINDOWCLOSE:
                self.quit = True
            elif event.type == pygame.KEYDOWN:
                self._held.add(event.key)
                self.quit |= event.key in (pygame.K_ESCAPE, pygame.K_q)
                self.again |= event.key == pygame.K_r
            elif event.type == pygame.KEYUP:
                self._held.discard(event.key)
            elif event.type == pygame.JOYDEVICEADDED:
                with suppress(pygame.error):  # one that has gone again
                    pad = pygame.joystick.Joystick(event.device_index)
                    self._pads[pad.get_instance_id()] = pad
                    print(f"gamepad: {pad.get_name()}", flush=True)
            elif event.type == pygame.JOYDEVICEREMOVED:
                self._sticks.pop(event.instance_id, None)  # else its last command would go on
                if self._pads.pop(event.instance_id, None) is not None:
                    print("gamepad unplugged; the keys drive", flush=True)
            elif event.type == pygame.JOYAXISMOTION and event.axis < 2:
                stick = self._sticks.setdefault(event.instance_id, [0.0, 0.0])
                stick[event.axis] = of_stick(event.value)
            elif event.type == pygame.JOYBUTTONDOWN and event.button in START_BUTTONS:
                self.again = True

    def action(self, period: float) -> NDArray[np.float32]:
        """Action left, right in [-1, 1], `period` [s] after the last one."""
        import pygame

        def asked(more: tuple[int, int], less: tuple[int, int]) -> float:
            return float(bool(self._held & {*more})) - float(bool(self._held & {*less}))

        right, down = np.sum([[0.0, 0.0], *self._sticks.values()], axis=0)
        forward = asked((pygame.K_UP, pygame.K_w), (pygame.K_DOWN, pygame.K_s)) - down
        left = asked((pygame.K_LEFT, pygame.K_a), (pygame.K_RIGHT, pygame.K_d)) - right
        wanted = np.clip([forward, left], -1.0, 1.0) * self._reach
        step = RATE * period
        self._command += np.clip(wanted - self._command, -step, step)
        if pygame.K_SPACE in self._held:
            self._command[:] = 0.0
        ahead, turn = self._command
        return np.clip([ahead - turn, ahead + turn], -1.0, 1.0).astype(np.float32)


def drive(config: BenchmarkConfig, name: str, observer: Policy | None) -> list[float]:
    """Drive a set in a window until the end is asked for; distances [m] to the reference."""
    import pygame

    from tracked_env.benchmark.video import beliefs_of
    from tracked_env.env import TrackedVehicleEnv
    from tracked_env.rendering import Renderer, source_of

    pygame.display.init()
    pygame.joystick.init()
    pygame.event.clear([pygame.QUIT, pygame.WINDOWCLOSE])  # of windows that were closed before
    env = TrackedVehicleEnv(**config.arguments(name, truth=False))
    period = env.simulation.solver.control_period
    terrain = source_of(env.simulation, 0)
    renderer = Renderer("human", round(1.0 / (STEPS_SHOWN * period)), terrain=terrain)
    controls, distances = Controls(env.simulation.solver.drive.name), list[float]()
    seed, over, steps = config.seed, True, 0
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
                believed = None if observer is None else beliefs_of(observer)
                renderer.draw(env.simulation, 0, believed)
                controls.take(pygame.event.get())
    finally:
        renderer.close()
        env.close()
    return distances


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Drive; returns the exit status."""
    parser = Parser(
        program,
        "Drive a vehicle of an evaluation set in a window; the panel shows what an\n"
        "observer believes of vehicle and soil, beside the truth.",
        epilog=KEYS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--observer", metavar="POLICY",
                        help="policy whose estimates are shown, or `none` (default: "
                        "adaptive, on Speed-v0 and Terrain-v0 slc-adaptive)")  # fmt: skip
    add_episode_options(parser)
    given = parser.parse_args(arguments)
    import tracked_env.rendering  # noqa: F401, says what is missing before anything is compiled

    config = replace(benchmark_config(config_of(given)), error_limit=ERROR_LIMIT)
    if config.duration is None:
        config = replace(config, duration=DURATION)
    observer = given.observer or OBSERVERS[config.env]
    chosen: Policy | None = None
    if observer != "none":
        registry, trained = by_name(registered_policies(), config.env)
        entry = load_policies([observer], registry, trained, open_archive)[0]
        chosen = checked_policy(entry, config.context(config.sets[0]))
        if needs_truth(chosen) or not hasattr(chosen, "estimates"):
            why = "it is given the truth" if needs_truth(chosen) else "it identifies nothing"
            raise ValueError(
                f"--observer {observer}: {why}; must be a policy that identifies, as "
                f"{OBSERVERS[config.env]}, or none"
            )
    print(KEYS)
    distances = drive(config, config.sets[0], chosen)
    error = math.sqrt(float(np.mean(np.square(distances)))) if distances else 0.0
    print(f"{len(distances) / config.control_rate:.1f} s driven, RMSE {error:.3f} m, set "
          f"{config.sets[0]}, seed {config.seed}")  # fmt: skip
    return 0
