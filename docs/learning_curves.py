"""Learning curves of the shipped agents: the figure of docs/trained_agents.md.

    python docs/learning_curves.py        writes docs/_static/learning_curves.png

Read from the curve.csv beside each agent: error on held-out episodes over steps, the thick line
the median of the seeds, the pale lines each of them.
"""

from collections import defaultdict
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import FixedLocator

ROOT = Path(__file__).resolve().parent.parent
TARGET = ROOT / "docs" / "_static" / "learning_curves.png"


def curves() -> dict[str, list[tuple[np.ndarray, np.ndarray]]]:
    """{agent: [(steps, held-out RMSE [m]) of a seed]}, where it was evaluated."""
    found = defaultdict(list)
    for path in sorted(
        (ROOT / "baselines" / "learned" / "pretrained" / "Torque-v0").glob("*-seed*/curve.csv")
    ):
        curve = np.genfromtxt(path, delimiter=",", names=True)
        known = np.isfinite(curve["held_out_rmse"])
        agent = path.parent.name.rpartition("-seed")[0]
        found[agent].append((curve["steps"][known], curve["held_out_rmse"][known]))
    return dict(found)


def main() -> None:
    """Draw and write the figure."""
    figure, axes = plt.subplots(figsize=(8.4, 4.0), layout="constrained")
    for number, (agent, seeds) in enumerate(curves().items()):
        colour = f"C{number}"
        for steps, rmse in seeds:
            axes.plot(steps / 1e6, rmse, color=colour, alpha=0.25, linewidth=0.8)
        count = min(len(steps) for steps, _ in seeds)
        median = np.median([rmse[:count] for _, rmse in seeds], axis=0)
        axes.plot(seeds[0][0][:count] / 1e6, median, color=colour, linewidth=1.8, label=agent)
    axes.set(xscale="log", yscale="log", xlabel="steps [million]")
    axes.set_ylabel("RMSE of the distance, held-out episodes [m]")
    for axis, ticks in (
        (axes.xaxis, (0.05, 0.1, 0.2, 0.5, 1, 2)),
        (axes.yaxis, (0.03, 0.1, 0.3, 1, 3)),
    ):
        axis.set_major_locator(FixedLocator(ticks))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    axes.grid(which="both", alpha=0.2)
    axes.legend(fontsize="small", frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(TARGET, dpi=110)


if __name__ == "__main__":
    main()
