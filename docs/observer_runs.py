"""Runs of the adaptive policy with what its observer believes: tables of two pages.

    python -m docs.observer_runs [--first SEED] [--episodes N]    the table of observer_trust.md
    python -m docs.observer_runs --faults        both tables of identification.md on actuator faults

Claims: every quantity on every set of torque-v3 and torque-unlike-v1. Truth: the value in force
when the sample was taken; of the side slip atan(v_y / v_x) where |v_x| > MOVING, of F_max the
closed form A c + W / 2 tan phi, on every plant.

Faults: is soil taken for an actuator fault, or a fault for soil? Estimates are compared with the
truth from START on, and not within AFTER of a gain that steps. The sets `weak-actuator` and
`actuator-fault` draw vehicle and soil as `soil-and-mass` does, by the same numbers: their episodes
differ from those in the drives alone.
"""

import argparse
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.registry import adaptive
from tracked_env.arrays import columns
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import VERSIONS
from tracked_env.benchmark.identification_metrics import APART
from tracked_env.benchmark.metrics import CHANGING, abrupt_changes
from tracked_env.physics.parameters import STATE_NAMES

Floats = NDArray[np.float64]
SEED = 72_000  # episodes on which nothing was chosen
PARAMETERS = ("mass", "inertia", "longitudinal_resistance", "lateral_resistance")
GAINS = ("actuator_gain_left", "actuator_gain_right")
DRIVES = (*GAINS, "drive_time_constant")
QUANTITIES = {
    **dict(zip(PARAMETERS, ("mass", "inertia", "mu_l", "mu_t"), strict=True)),
    **{"slip_left": "i_L", "slip_right": "i_R", "side_slip": "alpha", "effort_maximum": "F_max"},
    "shear_deformation_modulus": "K",
    **dict(zip(DRIVES, ("g_L", "g_R", "T"), strict=True)),
}
ABSOLUTE = ("slip_left", "slip_right", "side_slip")  # errors are not relative to the true value
MOVING = 0.05  # [m/s] below it there is no side slip
VERSIONS_SHOWN = ("torque-v3", "torque-unlike-v1")

FAULT_SEED, FAULT_EPISODES = 71_000, 100
START, AFTER = 1.0, 0.2  # [s]
ALARM = 0.1  # [-] an error of a gain from which on it would be a fault
ON_SOILS = (
    "soil-and-mass",
    "weak-soil",
    "terrain-transition",
    "resistance-map",
    "drift",
    "distributed",
)
ON_DRIVES = ("soil-and-mass", "weak-actuator", "actuator-fault", "slow-drive")


class Run(NamedTuple):
    """Beliefs and truth of N vehicles over T control steps; columns as in `names`."""

    period: float  # [s]
    value: Floats  # (T, N, P) SI
    deviation: Floats  # (T, N, P)
    truth: Floats  # (T, N, P)
    state: Floats  # (T, N, STATE_ROWS) true, columns as STATE_NAMES
    status: NDArray[np.int64]  # (T, N, 2) of the regressions: longitudinal, turning
    excitation: Floats  # (T, N, 2)
    changing: Floats  # (T, N, C) parameters whose abrupt changes count
    driven: NDArray[np.bool_]  # (T, N) whether the episode goes on
    policy: AdaptivePolicy
    names: tuple[str, ...]

    @property
    def time(self) -> Floats:
        """(T,) [s]."""
        return self.period * np.arange(len(self.value))

    def error(self, name: str) -> Floats:
        """(T, N) relative error of one parameter."""
        j = self.names.index(name)
        return self.value[..., j] / self.truth[..., j] - 1.0

    def claimed(self, name: str) -> Floats:
        """(T, N) claimed deviation of one parameter over its true value."""
        j = self.names.index(name)
        return self.deviation[..., j] / self.truth[..., j]

    def motion(self, name: str) -> Floats:
        """(T, N) one state of the vehicle."""
        return self.state[..., STATE_NAMES.index(name)]


def driven(
    name: str,
    count: int,
    reset: Mapping[str, Any] | None = None,
    names: Sequence[str] = PARAMETERS,
    first: int = SEED,
    **changed: Any,
) -> Run:
    """Drive `count` episodes of an evaluation set; changed: of `BenchmarkConfig`.

    names: estimates taken down. first: seed of the first episode.
    """
    config = BenchmarkConfig(sets=(name,), episodes=count, **changed)
    env, policy = config.environment(name, count, truth=False), adaptive(config.context(name))
    assert isinstance(policy, AdaptivePolicy)
    batch, states = env.simulation.batch, columns(STATE_NAMES)
    truths = columns(["v_x" if name == "side_slip" else name for name in names])
    changing, over = columns(CHANGING), np.zeros(count, dtype=bool)
    seeds = [first + i for i in range(count)]
    observation, _ = env.reset(seed=seeds, options=None if reset is None else dict(reset))
    state: Any = None
    rows: list[tuple[Floats, ...]] = []
    for _ in range(env.simulation.settings.max_steps):
        action, state = policy.predict(observation, state)
        estimates, filters = policy.identification.estimates(), ("longitudinal", "turning")
        beliefs = np.array([estimates[name] for name in names])  # (P, 2, N)
        reports = policy.identification.status(), policy.identification.excitation()
        status, excitation = (np.stack([each[part] for part in filters], 1) for each in reports)
        now = (batch.floats[:, rows] for rows in (truths, states, changing))
        truth, motion, changes = now
        value, deviation = beliefs.transpose(1, 2, 0)
        rows.append((value, deviation, truth, motion, status, excitation, changes, ~over))
        observation, _reward, terminated, truncated, _info = env.step(action)
        over = over | terminated | truncated
    parts = [np.array(part) for part in zip(*rows, strict=True)]
    run = Run(env.simulation.solver.control_period, *parts, policy, tuple(names))  # type: ignore[arg-type]
    if "side_slip" in names:
        v_x, v_y = run.motion("v_x"), run.motion("v_y")
        moves = np.abs(v_x) > MOVING
        truth = np.where(moves, np.arctan(v_y / np.where(moves, v_x, 1.0)), np.nan)
        run.truth[..., names.index("side_slip")] = truth
    return run


def apart(run: Run) -> NDArray[np.bool_]:
    """(T, N) whether the episode goes on, and no abrupt change was within the last second."""
    counts = run.driven.copy()
    for i in range(counts.shape[1]):
        steps = int(run.driven[:, i].sum())
        for change in abrupt_changes(run.changing[:steps, i], run.period):
            counts[change.first : change.last + round(APART / run.period), i] = False
    return counts


def cells(run: Run) -> list[str]:
    """A cell of the table for each quantity: NEES, share within three sigma [%], without the
    second after a change; median claimed sigma, median error at the end [%]."""
    counts, row = apart(run), []
    last = run.driven.sum(axis=0) - 1
    for j, name in enumerate(run.names):
        value, sigma, truth = run.value[..., j], run.deviation[..., j], run.truth[..., j]
        known = counts & np.isfinite(truth) & (sigma > 0.0)
        scale = np.ones_like(truth) if name in ABSOLUTE else np.abs(truth)
        with np.errstate(invalid="ignore", divide="ignore"):
            score, error = np.square((value - truth) / sigma), np.abs(value - truth) / scale
        end = error[last, np.arange(len(last))]
        row.append(
            f"{score[known].mean():.2g}, {100.0 * np.mean(score[known] <= 9.0):.1f}; "
            f"{100.0 * np.median((sigma / scale)[known]):.2g}, {100.0 * np.nanmedian(end):.2g}"
        )
    return row


def fault_run(name: str, episodes: int = FAULT_EPISODES, duration: float | None = None) -> Run:
    """Episodes of an evaluation set with the estimates of soil and drives."""
    names = (*PARAMETERS, *DRIVES)
    return driven(name, episodes, names=names, first=FAULT_SEED, duration=duration)


def _errors(run: Run) -> tuple[Floats, Floats]:
    """(T, N, P) errors over the true value and over the claimed deviation; NaN: not compared."""
    used, (first, wait) = run.driven.copy(), (round(t / run.period) for t in (START, AFTER))
    used[:first] = False
    for name in GAINS:
        gain = run.truth[..., run.names.index(name)]
        for k, i in np.argwhere(np.diff(gain, axis=0) != 0.0):
            used[k + 1 : k + 1 + wait, i] = False
    error = np.where(used[..., None], run.value - run.truth, np.nan)
    return error / run.truth, error / run.deviation


def _within_three_sigma(sigmas: Floats) -> float:
    return float((np.abs(sigmas[np.isfinite(sigmas)]) <= 3.0).mean())


def alarms(run: Run) -> dict[str, float]:
    """Errors of both gains: median and largest, share of episodes with an error beyond ALARM, share
    of time within three deviations."""
    places = [run.names.index(name) for name in GAINS]
    relative, sigmas = (each[..., places] for each in _errors(run))
    largest = np.nanmax(np.abs(relative), axis=(0, 2))
    return {
        "median": float(np.nanmedian(np.abs(relative))),
        "largest": float(largest.max()),
        "alarmed": float((largest > ALARM).mean()),
        "in_three_sigma": _within_three_sigma(sigmas),
    }


def soil_errors(run: Run) -> dict[str, tuple[float, float]]:
    """By quantity of vehicle, soil and drives: median of the last error, share of time within three
    deviations."""
    relative, sigmas = _errors(run)
    found = {}
    for j, name in enumerate(run.names):
        last = [column[np.isfinite(column)][-1] for column in relative[..., j].T]
        found[name] = float(np.median(np.abs(last))), _within_three_sigma(sigmas[..., j])
    return found


def fault_tables() -> str:
    """Both tables on faults in Markdown."""
    runs = {name: fault_run(name) for name in dict.fromkeys((*ON_SOILS, *ON_DRIVES))}
    lines = ["| set | gain: median error | largest | episodes beyond 10% | in 3 sigma |"]
    lines.append("|--|--:|--:|--:|--:|")
    for name in ON_SOILS:
        a = alarms(runs[name])
        numbers = f"{a['median']:.2%} | {a['largest']:.1%} | {a['alarmed']:.0%}"
        lines.append(f"| `{name}` | {numbers} | {a['in_three_sigma']:.1%} |")
    lines += ["", "| set | m | I | mu_l | mu_t | g_L | g_R | T |", "|--|" + 7 * "--:|"]
    for name in ON_DRIVES:
        shown = [f"{last:.1%}, {share:.0%}" for last, share in soil_errors(runs[name]).values()]
        lines.append(f"| `{name}` | {' | '.join(shown)} |")
    return "\n".join(lines).replace("%", " %")


def main() -> None:
    """Print the table of every quantity on every set, or those on faults."""
    parser = argparse.ArgumentParser(description="How good the claims of the observer are.")
    parser.add_argument("--first", type=int, default=SEED, help="seed of the first episode")
    parser.add_argument("--episodes", type=int, default=32, help="per set")
    parser.add_argument("--faults", action="store_true", help="the tables on actuator faults")
    options = parser.parse_args()
    if options.faults:
        print(fault_tables())
        return
    print("| set |", " | ".join(QUANTITIES.values()), "|", sep=" ")
    print("|--|" + "--|" * len(QUANTITIES))
    for name in dict.fromkeys(n for version in VERSIONS_SHOWN for n in VERSIONS[version].sets):
        run = driven(name, options.episodes, names=tuple(QUANTITIES), first=options.first)
        print(f"| `{name}` |", " | ".join(cells(run)), "|", flush=True)


if __name__ == "__main__":
    main()
