"""Figures of pages that compare runs: learning, outages of the pose, claims of the observer.

    python -m docs.page_figures [learning_curves | pose_outages | observer]  # docs/_static/*.png

learning_curves   trained_agents.md: error on held-out episodes over steps, read from the curve.csv
                  beside each shipped agent; thick lines are the median of the seeds, pale ones each
pose_outages      identification.md: distance between filtered and true pose, each against the
                  reference, and three sigma of its covariance, one episode each of two policies
observer          observer_trust.md: mean of |error| and of the claimed deviation around an abrupt
                  change; error and three claimed deviations over time, episodes of one kind each
"""

import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import FixedLocator

from baselines.estimators.measurement import Status
from baselines.registry import POLICIES
from docs.observer_runs import PARAMETERS, Floats, Run, driven
from tracked_env import arrays as b
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.benchmark.metrics import abrupt_changes

mpl.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "_static"
AGENTS = ROOT / "baselines" / "learned" / "pretrained" / "Torque-v0"
OUTAGES, SEED, SKIPPED = "outages-weak-soil", 71_000, 100  # steps of the start are not shown
BEFORE, BEHIND = 2.0, 6.0  # [s] around a change
ERROR, CLAIM, OTHER = "#D55E00", "#0072B2", "#009E73"
SHOWN = 4  # vehicles in the figures over time
REVERSING = {"kind": "circle", "radius": 8.0, "speed": -1.2}
STOPPING = {"kind": "straight", "speed": 0.0, "initial_speed": 1.5}
LOADED = 15.0  # [s] at which the vehicle that stands gets 40 % more mass


def learning_curves() -> None:
    """Of every shipped agent of Torque-v0 that was evaluated while it learned."""
    curves = defaultdict(list)
    for path in sorted(AGENTS.glob("*-seed*/curve.csv")):
        curve = np.genfromtxt(path, delimiter=",", names=True)
        known = np.isfinite(curve["held_out_rmse"])
        agent = path.parent.name.rpartition("-seed")[0]
        curves[agent].append((curve["steps"][known], curve["held_out_rmse"][known]))
    figure, axes = plt.subplots(figsize=(8.4, 4.0), layout="constrained")
    for number, (agent, seeds) in enumerate(curves.items()):
        colour = f"C{number}"
        for steps, rmse in seeds:
            axes.plot(steps / 1e6, rmse, color=colour, alpha=0.25, linewidth=0.8)
        count = min(len(steps) for steps, _ in seeds)
        median = np.median([rmse[:count] for _, rmse in seeds], axis=0)
        axes.plot(seeds[0][0][:count] / 1e6, median, color=colour, linewidth=1.8, label=agent)
    axes.set(xscale="log", yscale="log", xlabel="steps [million]")
    axes.set_ylabel("RMSE of the distance, held-out episodes [m]")
    axes.xaxis.set_major_locator(FixedLocator((0.05, 0.1, 0.2, 0.5, 1, 2)))
    axes.yaxis.set_major_locator(FixedLocator((0.03, 0.1, 0.3, 1, 3)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    axes.grid(which="both", alpha=0.2)
    axes.legend(fontsize="small", frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(FOLDER / "learning_curves.png", dpi=110)


def _pose_errors(name: str) -> tuple[Floats, Floats, Floats]:
    """(error [m], three sigma [m], whether the pose is missing) of each step of an episode."""
    config = BenchmarkConfig(sets=(OUTAGES,))
    env = config.environment(OUTAGES, 1, truth=True)
    policy, arrays = POLICIES[name](config.context(OUTAGES)), env.simulation.batch
    observation, info = env.reset(seed=[SEED])
    state, rows = None, []
    for _ in range(env.simulation.settings.max_steps):
        if getattr(policy, "needs_truth", False):
            policy.observe_truth({k: v for k, v in info["truth"].items() if k[0] != "_"})
        true = np.array([arrays.column(n)[0] for n in ("x", "y")])
        path = np.array([arrays.column(f"reference_{n}")[0] for n in ("x", "y")])
        missing = arrays.counters[0, b.STEP] < arrays.counters[0, b.OUTAGE_UNTIL]
        action, state = policy.predict(observation, state)
        known = getattr(policy, "_policy", policy).identification
        value, covariance = (known.parts.answers["slip"][n] for n in ("value", "covariance"))
        error = value[0, :2] - known.reading.reference[0, :2] - (true - path)
        rows.append((np.hypot(*error), 3.0 * np.sqrt(np.trace(covariance[0, :2, :2])), missing))
        observation, *_, info = env.step(action)
    error, claimed, missing = np.array(rows)[SKIPPED:].T
    return error, claimed, missing


def pose_outages() -> None:
    """Of the adaptive policy and of the oracle."""
    figure, axes = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
    for colour, name in ((CLAIM, "adaptive"), (OTHER, "oracle")):
        error, claimed, missing = _pose_errors(name)
        time = 0.02 * (SKIPPED + np.arange(len(error)))
        axes.plot(time, error, color=colour, label=f"{name}: error")
        axes.plot(time, claimed, "--", color=colour, linewidth=1.0, label=f"{name}: three sigma")
    shade = {"transform": axes.get_xaxis_transform(), "color": "0.9", "label": "no pose"}
    axes.fill_between(time, 0.0, 1.0, where=missing > 0.0, **shade)
    axes.set(xlabel="time [s]", ylabel="position [m]", xlim=(time[0], time[-1]), ylim=(0.0, None))
    axes.legend(fontsize="small", facecolor="white", framealpha=1.0, ncols=2)
    figure.savefig(FOLDER / "pose_outages.png", dpi=110)


def _aligned(run: Run, name: str) -> tuple[Floats, Floats]:
    """(|error|, claimed) (K, changes) from BEFORE until BEHIND each first change, relative."""
    first, last = round(BEFORE / run.period), round(BEHIND / run.period)
    errors, claims = [], []
    for i in range(run.value.shape[1]):
        found = abrupt_changes(run.truth[:, i], run.period)
        if found and first <= found[0].first <= len(run.value) - last:
            rows = slice(found[0].first - first, found[0].first + last)
            errors.append(np.abs(run.error(name)[rows, i]))
            claims.append(run.claimed(name)[rows, i])
    return np.stack(errors, axis=1), np.stack(claims, axis=1)


def _changes() -> None:
    """Mean error and claim around a payload step and the border of a soil."""
    figure, axes = plt.subplots(2, 4, figsize=(11.0, 4.6), layout="constrained", sharex=True)
    for row, name in zip(axes, ("payload", "terrain-transition"), strict=True):
        run = driven(name, 32)
        for axis, parameter in zip(row, PARAMETERS, strict=True):
            error, claimed = (100.0 * part.mean(axis=1) for part in _aligned(run, parameter))
            time = run.period * np.arange(len(error)) - BEFORE
            axis.semilogy(time, error, color=ERROR, label="mean |error|")
            axis.semilogy(time, claimed, color=CLAIM, label="claimed sigma")
            axis.axvline(0.0, color="0.6", linewidth=0.8)
            axis.set_title(f"{name}:\n{parameter.replace('_', ' ')}", fontsize="small")
            axis.set_ylim(0.3, 100.0)
            later = np.flatnonzero(time >= 1.0)[0]
            for when, k in (("1 s after", later), ("at the end", -1)):
                print(f"{name} {parameter}, {when}: {error[k]:.1f} %, claimed {claimed[k]:.1f} %")
    axes[0, 0].legend(fontsize="x-small")
    figure.supxlabel("time after the change [s]", fontsize="medium")
    figure.supylabel("[%]", fontsize="medium")
    figure.savefig(FOLDER / "observer_changes.png", dpi=100)


def _over_time(run: Run, parameters: Sequence[str], target: str) -> None:
    """Error and three claimed deviations of some vehicles; grey: share of all that are holding."""
    count = len(parameters)
    figure, axes = plt.subplots(1, count, figsize=(4.2 * count, 3.2), layout="constrained")
    for axis, parameter in zip(axes, parameters, strict=True):
        part = 0 if parameter in ("mass", "longitudinal_resistance") else 1
        error, claimed = 100.0 * run.error(parameter), 300.0 * run.claimed(parameter)
        for i in range(SHOWN):
            axis.plot(run.time, error[:, i], color=ERROR, linewidth=0.8)
            for bound in (claimed, -claimed):
                axis.plot(run.time, bound[:, i], color=CLAIM, linewidth=0.8)
        settled = run.time > 2.0
        largest = np.quantile(np.abs(error[settled]), 0.995), float(np.median(claimed[settled]))
        limit = 1.3 * max(largest)
        axis.set(title=parameter.replace("_", " "), xlabel="time [s]", ylim=(-limit, limit))
        holding = np.mean(run.status[..., part] == int(Status.HOLDING), axis=1)
        above = axis.twinx()
        above.fill_between(run.time, 0.0, holding, color="0.85", zorder=0)
        above.set(ylim=(0.0, 8.0), yticks=[])
        inside = np.abs(error) <= claimed
        print(
            f"{target} {parameter}: in 3 sigma {inside.mean():.1%}, from 5 s on "
            f"{inside[run.time >= 5.0].mean():.1%}; at the end error "
            f"{np.median(error[-1]):+.1f} %, claimed sigma {np.median(claimed[-1]) / 3.0:.1f} %, "
            f"holding {holding.mean():.0%}, excitation {np.median(run.excitation[-1, :, part]):.3g}"
        )
    axes[0].set_ylabel("error (orange), 3 sigma (blue) [%]", fontsize="small")
    figure.savefig(FOLDER / f"observer_{target}.png", dpi=100)


def observer() -> None:
    """Around changes, on patches, in reverse, and standing while the load changes."""
    _changes()
    along = ("mass", "longitudinal_resistance", "inertia")
    _over_time(driven("distributed", 32), along, "distributed")
    run = driven("soil-and-mass", 32, reference=REVERSING)
    _over_time(run, ("mass", "inertia", "lateral_resistance"), "reversing")
    load = {"parameter": "mass", "kind": "ramp", "target": 1450.0 * 1.4, "start": LOADED}
    run = driven("nominal", 32, {"schedule": [load | {"duration": 0.0}]}, reference=STOPPING)
    _over_time(run, along, "standstill")


if __name__ == "__main__":
    FIGURES = {each.__name__: each for each in (learning_curves, pose_outages, observer)}
    for name in sys.argv[1:] or FIGURES:
        FIGURES[name]()
