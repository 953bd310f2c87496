"""How often the claims of the observer, and of `tracked-env identify`, hold: tables of three pages.

    python -m tests.baselines.observer_runs [--first SEED] [--episodes N]    of observer_trust.md
    python -m tests.baselines.observer_runs --faults    of identification.md, on actuator faults
    python -m tests.baselines.observer_runs --logs [--first 91000]    coverage, of your_data.md

Claims: every quantity on every set of torque-v3 and torque-unlike-v1. Truth: the value in force
when the sample was taken; of the side slip atan(v_y / v_x) where |v_x| > MOVING, of F_max the
closed form A c + W / 2 tan phi, on every plant.

Faults: is soil taken for an actuator fault, or a fault for soil? Estimates are compared with the
truth from START on, and not within AFTER of a gain that steps. The sets `weak-actuator` and
`actuator-fault` draw vehicle and soil as `soil-and-mass` does, by the same numbers: their episodes
differ from those in the drives alone.

Logs: vehicles and soils are drawn at random and driven by the adaptive policy; what the sensors say
goes through CSV files, as a user's log does.
"""

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.identify.identify_log import SOIL, identify
from baselines.identify.vehicle_log import Drivetrain, read_log
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.registry import adaptive
from tracked_env.arrays import columns
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import VERSIONS
from tracked_env.benchmark.identification_metrics import APART
from tracked_env.benchmark.metrics import CHANGING, abrupt_changes
from tracked_env.cli.episode_commands import record_logs
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import PRESETS
from tracked_env.vector_env import TrackedVehicleVectorEnv

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

FAULT_SEED, FAULT_EPISODES = 71_000, 100
START, AFTER = 1.0, 0.2  # [s]
ALARM = 0.1  # [-] an error of a gain from which on it would be a fault
ON_SOILS = ["weak-soil", "terrain-transition", "resistance-map", "drift", "distributed"]
ON_DRIVES = ["weak-actuator", "actuator-fault", "slow-drive"]

LOG_SEED, LOGS = 90_000, 100  # on which the design of the intervals was chosen
Logs = list[tuple[Path, dict[str, float]]]
Intervals = dict[str, list[tuple[bool, float, float]]]


class Run(NamedTuple):
    """Beliefs and truth of N vehicles over T control steps; columns as in `names`."""

    period: float  # [s]
    value: Floats  # (T, N, P) SI
    deviation: Floats  # (T, N, P)
    truth: Floats  # (T, N, P)
    speeds: Floats  # (T, N, 2) [m/s] true v_x, v_y
    changing: Floats  # (T, N, C) parameters whose abrupt changes count
    running: NDArray[np.bool_]  # (T, N) whether the episode goes on
    names: tuple[str, ...]


def observe(
    name: str,
    count: int,
    names: Sequence[str] = PARAMETERS,
    first: int = SEED,
    **options: Any,
) -> Run:
    """Beliefs on the estimates `names` in `count` episodes of an evaluation set.

    first: seed of the first episode. options: of `BenchmarkConfig`.
    """
    config = BenchmarkConfig(sets=(name,), episodes=count, **options)
    env, policy = config.environment(name, count, truth=False), adaptive(config.context(name))
    batch, over = env.simulation.batch, np.zeros(count, dtype=bool)
    truths = columns(["v_x" if name == "side_slip" else name for name in names])
    places = truths, columns(("v_x", "v_y")), columns(CHANGING)
    observation, _ = env.reset(seed=[first + i for i in range(count)])
    state: Any = None
    rows: list[tuple[Floats, ...]] = []
    for _ in range(env.simulation.settings.max_steps):
        action, state = policy.predict(observation, state)
        estimates = policy.identification.estimates()
        beliefs = np.array([estimates[name] for name in names]).transpose(1, 2, 0)
        rows.append((*beliefs, *(batch.floats[:, place] for place in places), ~over))
        observation, _reward, terminated, truncated, _info = env.step(action)
        over = over | terminated | truncated
    parts = [np.array(part) for part in zip(*rows, strict=True)]
    run = Run(env.simulation.solver.control_period, *parts, tuple(names))  # type: ignore[arg-type]
    if "side_slip" in names:
        v_x, v_y = run.speeds[..., 0], run.speeds[..., 1]
        moves = np.abs(v_x) > MOVING
        truth = np.where(moves, np.arctan(v_y / np.where(moves, v_x, 1.0)), np.nan)
        run.truth[..., names.index("side_slip")] = truth
    return run


def cells(run: Run) -> list[str]:
    """A cell of the table for each quantity: NEES, share within three sigma [%], without the
    second after a change; median claimed sigma, median error at the end [%]."""
    counts, row = run.running.copy(), []
    last = run.running.sum(axis=0) - 1
    for i, end in enumerate(last):
        for change in abrupt_changes(run.changing[: end + 1, i], run.period):
            counts[change.first : change.last + round(APART / run.period), i] = False
    for j, name in enumerate(run.names):
        value, sigma, truth = run.value[..., j], run.deviation[..., j], run.truth[..., j]
        use = counts & np.isfinite(truth) & (sigma > 0.0)
        scale = np.ones_like(truth) if name in ABSOLUTE else np.abs(truth)
        with np.errstate(invalid="ignore", divide="ignore"):
            score, error = np.square((value - truth) / sigma), np.abs(value - truth) / scale
        final = error[last, np.arange(len(last))]
        row.append(
            f"{score[use].mean():.2g}, {100.0 * np.mean(score[use] <= 9.0):.1f}; "
            f"{100.0 * np.median((sigma / scale)[use]):.2g}, {100.0 * np.nanmedian(final):.2g}"
        )
    return row


def fault_run(name: str, episodes: int = FAULT_EPISODES, duration: float | None = None) -> Run:
    """Episodes of an evaluation set with the estimates of soil and drives."""
    names = (*PARAMETERS, *DRIVES)
    return observe(name, episodes, names=names, first=FAULT_SEED, duration=duration)


def _errors(run: Run) -> tuple[Floats, Floats]:
    """(T, N, P) errors over the true value and over the claimed deviation; NaN: not compared."""
    used, (first, wait) = run.running.copy(), (round(t / run.period) for t in (START, AFTER))
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
    errors = {}
    for j, name in enumerate(run.names):
        last = [column[np.isfinite(column)][-1] for column in relative[..., j].T]
        errors[name] = float(np.median(np.abs(last))), _within_three_sigma(sigmas[..., j])
    return errors


def table(head: Sequence[str], rows: Mapping[str, Sequence[str]]) -> str:
    """A Markdown table with the keys of its rows as the first column."""
    lines = [f"| {' | '.join(head)} |", "|--|" + "--:|" * (len(head) - 1)]
    lines += [f"| {name} | {' | '.join(texts)} |" for name, texts in rows.items()]
    return "\n".join(lines)


def fault_tables() -> str:
    """Both tables on faults in Markdown."""
    runs = {name: fault_run(name) for name in ("soil-and-mass", *ON_SOILS, *ON_DRIVES)}
    gains, soils = {}, {}
    for name in ("soil-and-mass", *ON_SOILS):
        values = zip((2, 1, 0, 1), alarms(runs[name]).values(), strict=True)
        gains[f"`{name}`"] = [f"{value:.{digits}%}" for digits, value in values]
    for name in ("soil-and-mass", *ON_DRIVES):
        errors = soil_errors(runs[name]).values()
        soils[f"`{name}`"] = [f"{last:.1%}, {share:.0%}" for last, share in errors]
    head = ["set", "gain: median error", "largest", "episodes beyond 10%", "in 3 sigma"]
    quantities = ["set", "m", "I", "mu_l", "mu_t", "g_L", "g_R", "T"]
    return f"{table(head, gains)}\n\n{table(quantities, soils)}".replace("%", " %")


def record(folder: Path, count: int, duration: float, first: int = LOG_SEED) -> Logs:
    """(log, true values) of `count` episodes of `duration` [s] of `soil-and-mass`."""
    options = {"uncertainty": "soil-and-mass", "duration": duration, "error_limit": 1e5}
    env = TrackedVehicleVectorEnv(count, autoreset_mode="Disabled", **options)
    paths = [folder / f"{number}.csv" for number in range(count)]
    seeds = [first + number for number in range(count)]
    return list(zip(paths, record_logs(env, AdaptivePolicy(), paths, seeds), strict=True))


def intervals(logs: Logs) -> Intervals:
    """(whether it holds the truth, half of its width, value) of every interval by parameter."""
    rows: Intervals = {name: [] for name in (*PARAMETERS, *SOIL)}
    for path, truth in logs:
        log = read_log(path, {}, {}, Drivetrain(), VEHICLES["strawa"], PRESETS["rtk"])
        for name, one in identify(log, VEHICLES["strawa"]).parameters.items():
            if name in PARAMETERS or one.verdict != "not determined":
                inside = one.low <= truth[name] <= one.high
                rows[name].append((inside, 0.5 * (one.high - one.low), one.value))
    return rows


def coverage_table(first: int) -> str:
    """Of LOGS logs of a minute from the seed `first` on, as Markdown."""
    with tempfile.TemporaryDirectory() as folder:
        rows = intervals(record(Path(folder), LOGS, 60.0, first))
    lines = {}
    for name, parts in {**rows, "all": [one for part in rows.values() for one in part]}.items():
        if parts:
            width = np.median([half / value for _, half, value in parts])
            inside = np.mean([inside for inside, _, _ in parts])
            texts = f"{len(parts)}", f"{inside:.0%}", "" if name == "all" else f"{width:.1%}"
            lines[name] = texts
    return table(["parameter", "intervals", "hold the truth", "half of the width"], lines)


def main() -> None:
    """Print the table of every quantity on every set, of faults or of logs."""
    parser = argparse.ArgumentParser(description="How good the claims of the observer are.")
    parser.add_argument("--first", type=int, help="seed of the first episode")
    parser.add_argument("--episodes", type=int, default=32, help="per set")
    parser.add_argument("--faults", action="store_true", help="the tables on actuator faults")
    parser.add_argument("--logs", action="store_true", help="the table on logs of a user")
    options = parser.parse_args()
    if options.faults:
        print(fault_tables())
    elif options.logs:
        print(coverage_table(options.first or LOG_SEED))
    else:
        sets = dict.fromkeys(VERSIONS["torque-v3"].sets + VERSIONS["torque-unlike-v1"].sets)
        more = tuple(QUANTITIES), options.first or SEED
        rows = {f"`{name}`": cells(observe(name, options.episodes, *more)) for name in sets}
        print(table(["set", *QUANTITIES.values()], rows))


if __name__ == "__main__":
    main()
