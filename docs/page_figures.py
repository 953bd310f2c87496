"""Figures of pages that compare runs: learning, claims of the observer.

    python -m docs.page_figures [learning_curves | changes]  # docs/_static/*.png

learning_curves   trained_agents.md: error on held-out episodes over steps, read from the curve.csv
                  beside each shipped agent; thick lines are the median of the seeds, pale ones each
changes           observer_trust.md: mean of |error| and of the claimed deviation around an abrupt
                  change
"""

import sys
from collections import defaultdict
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import FixedLocator

from docs.observer_runs import PARAMETERS, Floats, Run, observe
from tracked_env.benchmark.metrics import abrupt_changes

mpl.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "_static"
AGENTS = ROOT / "baselines" / "learned" / "pretrained" / "Torque-v0"
EPISODES = 32  # of each set
BEFORE, BEHIND = 2.0, 6.0  # [s] around a change
ERROR, CLAIM = "#D55E00", "#0072B2"


def learning_curves() -> None:
    """Of every shipped agent of Torque-v0 that was evaluated while it learned."""
    curves = defaultdict(list)
    for path in sorted(AGENTS.glob("*-seed*/curve.csv")):
        curve = np.genfromtxt(path, delimiter=",", names=True)
        measured = curve[np.isfinite(curve["held_out_rmse"])]
        agent = path.parent.name.rpartition("-seed")[0]
        curves[agent].append((measured["steps"] / 1e6, measured["held_out_rmse"]))
    figure, axes = plt.subplots(figsize=(8.4, 4.0), layout="constrained")
    for number, (agent, seeds) in enumerate(curves.items()):
        colour = f"C{number}"
        for steps, rmse in seeds:
            axes.plot(steps, rmse, color=colour, alpha=0.25, linewidth=0.8)
        count = min(len(steps) for steps, _ in seeds)
        median = np.median([rmse[:count] for _, rmse in seeds], axis=0)
        axes.plot(seeds[0][0][:count], median, color=colour, linewidth=1.8, label=agent)
    axes.set(xscale="log", yscale="log", xlabel="steps [million]")
    axes.set_ylabel("RMSE of the distance, held-out episodes [m]")
    axes.xaxis.set_major_locator(FixedLocator((0.05, 0.1, 0.2, 0.5, 1, 2)))
    axes.yaxis.set_major_locator(FixedLocator((0.03, 0.1, 0.3, 1, 3)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    axes.legend(fontsize="small", frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(FOLDER / "learning_curves.png", dpi=110)


def _aligned(run: Run, name: str) -> tuple[Floats, Floats]:
    """(|error|, claimed) (K, changes) from BEFORE until BEHIND each first change, relative."""
    first, last = round(BEFORE / run.period), round(BEHIND / run.period)
    errors, claims = [], []
    for i in range(run.value.shape[1]):
        at = abrupt_changes(run.truth[:, i], run.period)
        if at and first <= at[0].first <= len(run.value) - last:
            rows = slice(at[0].first - first, at[0].first + last)
            errors.append(np.abs(run.error(name)[rows, i]))
            claims.append(run.claimed(name)[rows, i])
    return np.stack(errors, axis=1), np.stack(claims, axis=1)


def changes() -> None:
    """Mean error and claim around a payload step and the border of a soil."""
    figure, axes = plt.subplots(2, 4, figsize=(11.0, 4.6), layout="constrained", sharex=True)
    for row, name in zip(axes, ("payload", "terrain-transition"), strict=True):
        run = observe(name, EPISODES)
        for axis, parameter in zip(row, PARAMETERS, strict=True):
            error, claimed = (100.0 * part.mean(axis=1) for part in _aligned(run, parameter))
            time = run.period * np.arange(len(error)) - BEFORE
            axis.semilogy(time, error, color=ERROR, label="mean |error|")
            axis.semilogy(time, claimed, color=CLAIM, label="claimed sigma")
            axis.axvline(0.0, color="0.6", linewidth=0.8)
            axis.set_title(f"{name}:\n{parameter.replace('_', ' ')}", fontsize="small")
            axis.set_ylim(0.3, 100.0)
            for when, k in (("1 s after", np.flatnonzero(time >= 1.0)[0]), ("at the end", -1)):
                print(f"{name} {parameter}, {when}: {error[k]:.1f} %, claimed {claimed[k]:.1f} %")
    axes[0, 0].legend(fontsize="x-small")
    figure.supxlabel("time after the change [s]", fontsize="medium")
    figure.supylabel("[%]", fontsize="medium")
    figure.savefig(FOLDER / "observer_changes.png", dpi=100)


if __name__ == "__main__":
    FIGURES = {each.__name__: each for each in (learning_curves, changes)}
    for name in sys.argv[1:] or FIGURES:
        FIGURES[name]()
