"""What the observer says of itself, and when to trust it: figures of observer_trust.md.

    python -m docs.observer_figures        writes docs/_static/observer_*.png

`changes`: mean of |error| and of the claimed deviation around an abrupt change. `distributed`,
`reversing`, `standstill`: error and three claimed deviations over time, episodes of one kind each.
"""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np

from baselines.estimators.measurement import Status
from docs.observer_runs import PARAMETERS, Floats, Run, driven
from tracked_env.benchmark.metrics import abrupt_changes

mpl.use("Agg")
import matplotlib.pyplot as plt

FOLDER = Path(__file__).resolve().parent / "_static"
BEFORE, BEHIND = 2.0, 6.0  # [s] around a change
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
SHOWN = 4  # vehicles in the figures over time
REVERSING = {"kind": "circle", "radius": 8.0, "speed": -1.2}
STOPPING = {"kind": "straight", "speed": 0.0, "initial_speed": 1.5}
LOADED = 15.0  # [s] at which the vehicle that stands gets 40 % more mass


def aligned(run: Run, name: str) -> tuple[Floats, Floats]:
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


def changes() -> None:
    """Mean error and claim around a payload step and the border of a soil."""
    figure, axes = plt.subplots(2, 4, figsize=(11.0, 4.6), layout="constrained", sharex=True)
    for row, name in zip(axes, ("payload", "terrain-transition"), strict=True):
        run = driven(name, 32)
        for axis, parameter in zip(row, PARAMETERS, strict=True):
            error, claimed = aligned(run, parameter)
            time = run.period * np.arange(len(error)) - BEFORE
            axis.semilogy(time, 100.0 * error.mean(axis=1), color=COLOURS[1], label="mean |error|")
            axis.semilogy(
                time, 100.0 * claimed.mean(axis=1), color=COLOURS[0], label="claimed sigma"
            )
            axis.axvline(0.0, color="0.6", linewidth=0.8)
            axis.set_title(f"{name}:\n{parameter.replace('_', ' ')}", fontsize="small")
            axis.set_ylim(0.3, 100.0)
            later = error[time >= 1.0], claimed[time >= 1.0]
            print(
                f"{name} {parameter}: {error.shape[1]} changes, 1 s after: error "
                f"{later[0][0].mean():.1%}, claimed {later[1][0].mean():.1%}; at the end "
                f"{later[0][-1].mean():.1%}, {later[1][-1].mean():.1%}"
            )
    axes[0, 0].legend(fontsize="x-small")
    figure.supxlabel("time after the change [s]", fontsize="medium")
    figure.supylabel("[%]", fontsize="medium")
    figure.savefig(FOLDER / "observer_changes.png", dpi=100)


def over_time(run: Run, parameters: Sequence[str], target: str) -> None:
    """Error and three claimed deviations of some vehicles; grey: share of all that are holding."""
    figure, axes = plt.subplots(
        1, len(parameters), figsize=(4.2 * len(parameters), 3.2), layout="constrained"
    )
    for axis, parameter in zip(axes, parameters, strict=True):
        part = 0 if parameter in ("mass", "longitudinal_resistance") else 1
        error, claimed = 100.0 * run.error(parameter), 300.0 * run.claimed(parameter)
        for i in range(SHOWN):
            axis.plot(run.time, error[:, i], color=COLOURS[1], linewidth=0.8)
            axis.plot(run.time, claimed[:, i], color=COLOURS[0], linewidth=0.8)
            axis.plot(run.time, -claimed[:, i], color=COLOURS[0], linewidth=0.8)
        settled = run.time > 2.0
        most = 1.3 * max(
            np.quantile(np.abs(error[settled]), 0.995), float(np.median(claimed[settled]))
        )
        axis.set(title=parameter.replace("_", " "), xlabel="time [s]", ylim=(-most, most))
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


def main() -> None:
    """Draw and write all figures; print their numbers."""
    changes()
    along = ("mass", "longitudinal_resistance", "inertia")
    over_time(driven("distributed", 32), along, "distributed")
    run = driven("soil-and-mass", 32, reference=REVERSING)
    over_time(run, ("mass", "inertia", "lateral_resistance"), "reversing")
    mass = 1450.0 * 1.4
    load = [{"parameter": "mass", "kind": "ramp", "target": mass, "start": LOADED, "duration": 0.0}]
    run = driven("nominal", 32, {"schedule": load}, reference=STOPPING)
    over_time(run, along, "standstill")


if __name__ == "__main__":
    main()
