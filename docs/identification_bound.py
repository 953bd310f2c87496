"""How well can mass and resistances be known? The data's bound beside the observer's claim.

    python -m docs.identification_bound        writes docs/_static/identification_bound.png

Posterior Cramer-Rao bound of theta along the way that was driven [1]. theta walks at random with
variance Q per step, each step brings equations y = h . theta + e, e ~ N(0, R), and
    P <- P + Q,    P <- (P^-1 + sum h^T h / R)^-1
bounds the covariance of every unbiased estimate of theta from below. theta is [ln m, mu_l, ln I,
ln C] with C = m mu_t; the equations are those of the regressions and of the side slip, linearised
in the true parameters, with true motion and the noise of the data sheet. Q is that of the truth:
the mean square change over one second. What no bound of this kind has: biases of the sensors, the
models' own errors, and that an observer must first find out how fast what changes.

References: [1] P. Tichavsky, C. H. Muravchik, A. Nehorai, IEEE Trans. Signal Processing 46 (1998).
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from baselines.estimators import longitudinal, sideslip, turning
from baselines.estimators.longitudinal import INVERSE_MASS_SIGMA, RESISTANCE_SIGMA
from baselines.estimators.measurement import make_measurement
from baselines.estimators.turning import FRICTION_SIGMA, INERTIA_SIGMA
from docs.observer_runs import Floats, Run, driven
from tracked_env.physics.parameters import STATE_NAMES
from tracked_env.sensors import CHANNELS

mpl.use("Agg")
import matplotlib.pyplot as plt

TARGET = Path(__file__).resolve().parent / "_static" / "identification_bound.png"
SETS, EPISODES = ("drift", "resistance-map"), 32
PARAMETERS_SHOWN = ("mass", "longitudinal_resistance")  # the first two of theta
WALK_TIME = 1.0  # [s] over which the truth's change counts as a walk
BEGUN = 3.0  # [s] from which on medians are taken
PRIOR = (INVERSE_MASS_SIGMA, RESISTANCE_SIGMA, INERTIA_SIGMA, FRICTION_SIGMA)


def bound(regressors: Floats, variances: Floats, walk: Floats, prior: Floats) -> Floats:
    """Covariances (T, p, p) after each of T steps.

    regressors: h (T, r, p) of r equations, variances: R (T, r), infinite where there is none.
    walk: variances (p,) that the parameters gain per step. prior: covariance (p, p).
    """
    information = np.einsum("tri,trj,tr->tij", regressors, regressors, 1.0 / variances)
    covariance, every = np.asarray(prior, dtype=float), []
    for gained in information:
        covariance = np.linalg.inv(np.linalg.inv(covariance + np.diag(walk)) + gained)
        every.append(covariance)
    return np.array(every)


def walks(parameters: Floats, period: float) -> Floats:
    """Variances (p,) per step of parameters (T, p): the mean square change over WALK_TIME."""
    lag = round(WALK_TIME / period)
    return np.asarray(np.mean((parameters[lag:] - parameters[:-lag]) ** 2, axis=0) * period)


def equations(run: Run, i: int) -> tuple[Floats, Floats]:
    """(regressors (T, 3, 4), variances (T, 3)) of vehicle i: longitudinal, turning, side slip."""
    stack = run.policy.stack
    along, turn = stack.longitudinal.constants()[0], stack.turning.constants()[0]
    sheet, half = stack.setting.data_sheet, 0.5 * stack.parameters.contact_length
    side = sideslip.Constants(half, sheet.velocity_noise**2, sheet.acceleration_noise**2, 0.0, 1.0)
    steps = len(run.value)
    h, variance = np.zeros((steps, 3, 4)), np.full((steps, 3), np.inf)
    shared = [name for name in CHANNELS if name in STATE_NAMES]
    for k in range(steps):
        mass, inertia, mu_l, mu_t = (float(x) for x in run.truth[k, i])
        true = {name: run.motion(name)[k, i : i + 1] for name in shared}
        z = make_measurement(**true).values
        sample, moves = longitudinal.equation(z, 0, along, 1.0)
        if moves:
            h[k, 0, :2], variance[k, 0] = (-sample.phi_1 / mass, sample.phi_2), sample.variance
        friction = mass * mu_t
        sample, turns = turning.equation(z, 0, turn, mass, mu_l, friction, inertia, 1.0)
        if turns:
            h[k, 1, 2:] = sample.phi_1 * inertia, sample.phi_2 * friction
            variance[k, 1] = sample.variance
        usable = abs(true["yaw_rate"][0]) > sideslip.LEAST_TURN
        if usable and true["v_x"][0] > sideslip.LEAST_SPEED:
            v_y, variance[k, 2] = sideslip.expected(z, 0, side, 1.0 / mass, friction, 0.0, 1.0)
            h[k, 2, 0], h[k, 2, 3] = v_y, -v_y
    return h, variance


def bounds(run: Run) -> tuple[Floats, Floats]:
    """Standard deviations (T, N, 4) of [ln m, mu_l, ln I, ln C] that the data allow, with the
    equation of the side slip and without it."""
    both = []
    for i in range(run.value.shape[1]):
        mass, inertia, mu_l, mu_t = run.truth[:, i].T
        parameters = np.stack([np.log(mass), mu_l, np.log(inertia), np.log(mass * mu_t)], axis=1)
        walk, prior = walks(parameters, run.period), np.diag(PRIOR) ** 2
        h, variance = equations(run, i)
        found = bound(h, variance, walk, prior), bound(h[:, :2], variance[:, :2], walk, prior)
        both.append([np.sqrt(np.diagonal(P, axis1=1, axis2=2)) for P in found])
    with_it, without = (np.stack(one, axis=1) for one in zip(*both, strict=True))
    return with_it, without


def rms(values: Floats) -> Floats:
    """Root mean square over the vehicles."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=1)))


def main() -> None:
    """Draw and write the figure; print the medians over time and vehicles."""
    figure, axes = plt.subplots(2, 2, figsize=(8.0, 5.0), layout="constrained", sharex=True)
    for row, name in zip(axes, SETS, strict=True):
        run = driven(name, EPISODES)
        least, without = bounds(run)
        for j, (axis, parameter) in enumerate(zip(row, PARAMETERS_SHOWN, strict=True)):
            scale = 1.0 if j == 0 else run.truth[..., 2]  # the bound of mu_l is absolute
            title = f"{name}: {parameter.replace('_', ' ')}"
            axis.set(title=title, xlim=(1.0, run.time[-1]))
            for label, values, style in (
                ("actual error", run.error(parameter), {"color": "#D55E00"}),
                ("claimed sigma", run.claimed(parameter), {"color": "#0072B2"}),
                ("bound without side slip", without[..., j] / scale, {"color": "k", "ls": ":"}),
                ("bound", least[..., j] / scale, {"color": "k", "ls": "--"}),
            ):
                begun = run.time >= 1.0
                axis.plot(run.time[begun], 100.0 * rms(values)[begun], lw=1.2, label=label, **style)
                middle = 100.0 * np.median(np.abs(values[run.time >= BEGUN]))
                print(f"{title}: {label}: median {middle:.1f} %")
    for axis in axes.flat:
        axis.set_ylim(0.0, None)
    axes[0, 0].legend(fontsize="small")
    figure.supxlabel("time [s]")
    figure.supylabel("rms over 32 vehicles [%]")
    figure.savefig(TARGET, dpi=100)


if __name__ == "__main__":
    main()
