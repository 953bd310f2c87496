"""Soil taken for an actuator fault, and a fault for soil: the tables of identification.md.

    python -m docs.actuator_errors        prints both tables; 1 to 2 minutes

The adaptive policy drives; its estimates are compared with the truth from START on, and not within
AFTER of a gain that steps. Episodes are drawn from seed SEED on, which are no episodes of the
benchmark. The sets `weak-actuator` and `actuator-fault` draw vehicle and soil as `soil-and-mass`
does, by the same numbers: their episodes differ from those in the drives alone.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.registry import adaptive
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.benchmark.metrics import Beliefs, Recorder, Trace
from tracked_env.benchmark.runner import drive

SEED, EPISODES = 71_000, 100
START, AFTER = 1.0, 0.2  # [s]
ALARM = 0.1  # [-] an error of a gain from which on it would be a fault
GAINS = ("actuator_gain_left", "actuator_gain_right")
DRIVES = (*GAINS, "drive_time_constant")
SOIL = ("mass", "inertia", "longitudinal_resistance", "lateral_resistance")
ON_SOILS = (
    "soil-and-mass", "weak-soil", "terrain-transition", "resistance-map", "drift", "distributed",
)  # fmt: skip
ON_DRIVES = ("soil-and-mass", "weak-actuator", "actuator-fault", "slow-drive")


class Errors(NamedTuple):
    """Estimates of one policy on one set against the truth."""

    names: tuple[str, ...]
    relative: NDArray[np.float64]  # (T, P, n) error over the true value, NaN where not compared
    sigmas: NDArray[np.float64]  # (T, P, n) error over the claimed deviation, likewise

    def of(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(relative error, error over its deviation) of one quantity, (T, n)."""
        column = self.names.index(name)
        return self.relative[:, column], self.sigmas[:, column]


def compared(beliefs: Beliefs, trace: Trace) -> Errors:
    """Errors of what is believed, at the times that are compared."""
    value, truth = beliefs.value.astype(np.float64), beliefs.truth.astype(np.float64)
    first, wait = (round(time / trace.control_period) for time in (START, AFTER))
    used = np.arange(len(value))[:, None] < trace.steps
    used[:first] = False
    for name in GAINS:
        gain = truth[:, beliefs.names.index(name)]
        for k, i in np.argwhere(np.diff(gain, axis=0) != 0.0):
            used[k + 1 : k + 1 + wait, i] = False
    error = np.where(used[:, None], value - truth, np.nan)
    return Errors(beliefs.names, error / truth, error / beliefs.deviation)


def driven(name: str, episodes: int = EPISODES, duration: float | None = None) -> Errors:
    """Errors of the adaptive policy on an evaluation set."""
    config = BenchmarkConfig(sets=(name,), episodes=episodes, duration=duration)
    policy = adaptive(config.context(name))
    assert isinstance(policy, AdaptivePolicy)
    env = config.environment(name, episodes, truth=False)
    recorder = Recorder(episodes, env.simulation.settings.max_steps)
    seeds = [SEED + i for i in range(episodes)]
    trace, _ = drive(policy, env, seeds, lambda: None, recorder)
    return compared(recorder.beliefs(), trace)


def alarms(errors: Errors) -> dict[str, float]:
    """Errors of both gains: median and largest, share of episodes with an error beyond ALARM, share
    of time within three deviations."""
    relative, sigmas = (np.stack([errors.of(g)[k] for g in GAINS]) for k in (0, 1))
    largest = np.nanmax(np.abs(relative), axis=(0, 1))
    known = np.isfinite(sigmas)
    return {
        "median": float(np.nanmedian(np.abs(relative))),
        "largest": float(largest.max()),
        "alarmed": float((largest > ALARM).mean()),
        "in_three_sigma": float((np.abs(sigmas[known]) <= 3.0).mean()),
    }


def soil_errors(errors: Errors) -> dict[str, tuple[float, float]]:
    """By quantity of vehicle and soil: median of the last error, share within three deviations."""
    found = {}
    for name in (*SOIL, *DRIVES):
        relative, sigmas = errors.of(name)
        last = np.array([column[np.isfinite(column)][-1] for column in relative.T])
        known = np.isfinite(sigmas)
        share = float((np.abs(sigmas[known]) <= 3.0).mean())
        found[name] = float(np.median(np.abs(last))), share
    return found


def tables() -> str:
    """Both tables in Markdown."""
    by_set = {name: driven(name) for name in dict.fromkeys((*ON_SOILS, *ON_DRIVES))}
    lines = [
        "| set | gain: median error | largest | episodes beyond 10% | in 3 sigma |",
        "|--|--:|--:|--:|--:|",
    ]
    for name in ON_SOILS:
        a = alarms(by_set[name])
        lines.append(
            f"| `{name}` | {a['median']:.2%} | {a['largest']:.1%} | {a['alarmed']:.0%} | "
            f"{a['in_three_sigma']:.1%} |"
        )
    heads = " | ".join(("m", "I", "mu_l", "mu_t", "g_L", "g_R", "T"))
    lines += ["", f"| set | {heads} |", "|--|" + 7 * "--:|"]
    for name in ON_DRIVES:
        cells = [f"{last:.1%}, {share:.0%}" for last, share in soil_errors(by_set[name]).values()]
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return "\n".join(lines).replace("%", " %")


if __name__ == "__main__":
    print(tables())
