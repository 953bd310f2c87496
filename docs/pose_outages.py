"""Error of the filtered pose through outages, and what is claimed: the figure of identification.md.

    python docs/pose_outages.py        writes docs/_static/pose_outages.png

One episode of `outages-weak-soil` each by the adaptive policy and by the oracle: distance between
filtered and true pose, each against the reference, and three sigma of its covariance.
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from baselines.registry import POLICIES
from tracked_env import arrays as b
from tracked_env.benchmark import BenchmarkConfig

mpl.use("Agg")
import matplotlib.pyplot as plt

TARGET = Path(__file__).resolve().parent / "_static" / "pose_outages.png"
SET, SEED, SKIPPED = "outages-weak-soil", 71_000, 100  # steps of the start are not shown


def episode(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(error [m], three sigma [m], whether the pose is missing) of each step."""
    config = BenchmarkConfig(sets=(SET,))
    env = config.environment(SET, 1, truth=True)
    policy, arrays = POLICIES[name](config.context(SET)), env.simulation.batch
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
        value, covariance = known.parts.answers["slip"][:2]
        error = value[0, :2] - known.reading.reference[0, :2] - (true - path)
        rows.append((np.hypot(*error), 3.0 * np.sqrt(np.trace(covariance[0, :2, :2])), missing))
        observation, *_, info = env.step(action)
    return tuple(np.array(rows)[SKIPPED:].T)  # type: ignore[return-value]


def main() -> None:
    """Draw and write the figure."""
    figure, axes = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
    for colour, name in (("#0072B2", "adaptive"), ("#009E73", "oracle")):
        error, claimed, missing = episode(name)
        time = 0.02 * (SKIPPED + np.arange(len(error)))
        axes.plot(time, error, color=colour, label=f"{name}: error")
        axes.plot(time, claimed, "--", color=colour, linewidth=1.0, label=f"{name}: three sigma")
    axes.fill_between(
        time, 0.0, 1.0, where=missing > 0.0, transform=axes.get_xaxis_transform(),
        color="0.9", label="no pose",
    )  # fmt: skip
    axes.set(xlabel="time [s]", ylabel="position [m]", xlim=(time[0], time[-1]), ylim=(0.0, None))
    axes.legend(fontsize="small", facecolor="white", framealpha=1.0, ncols=2)
    figure.savefig(TARGET, dpi=110)


if __name__ == "__main__":
    main()
