"""What the tests of the least squares share: priors, regressions, a loop over samples."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import interacting_models as im
from baselines.estimators import least_squares as ls
from baselines.estimators.measurement import columns_of, rows_of
from tracked_env.physics.jit import loop

# Nothing but recursive least squares with a prior: no forgetting.
PLAIN = ls.Prior(1.0, 2.0, 1.0, 0.5, -1e9, -1e9, 1e9, 1e9, forgetting=1.0)
SIGMA = np.array([PLAIN.sigma_1, PLAIN.sigma_2])
TRUE = np.array([1.5, 2.4])  # parameters, where a test needs any
# As the vehicle's regressions use it: with interacting models.
LIVELY = PLAIN._replace(forgetting=0.9995)
WALKS = {
    im.CALM: (0.0, 0.01), im.FAST: (0.005, 0.3), im.BORDER: (0.0, 2.0), im.JUMP: (3.0, 0.01),
    im.ALARMED: (0.04, 0.1), im.SLOW: (0.0, 0.006),
}  # fmt: skip
TABLE = im.table(WALKS, 9.0, PLAIN.sigma_2, 0.02)


class Run(NamedTuple):
    """What was known after each of T samples of N vehicles."""

    value: NDArray[np.float64]  # (N, T, 2)
    covariance: NDArray[np.float64]  # (N, T, 2, 2)
    eigenvalues: NDArray[np.float64]  # (N, T, 2) smallest, largest, of the information
    status: NDArray[np.int64]  # (N, T)
    nis: NDArray[np.float64]  # (N, T)
    memory: NDArray[np.float64]  # (N, columns) at the end

    @property
    def rows(self):
        """The memory as rows (N,)."""
        return rows_of(self.memory, im.ROW)


@loop
def _run_all(samples, rows, prior, table, value, covariance, eigenvalues, status, nis):
    for i in range(samples.shape[0]):
        for k in range(samples.shape[1]):
            s = samples[i, k]
            sample = ls.Sample(s[0], s[1], s[2], s[3], s[4])
            status[i, k], nis[i, k] = im.take(rows[i], sample, prior, table)
            value[i, k, 0], value[i, k, 1] = ls.values(rows[i].estimates[0], prior)
            p_11, p_12, p_22 = ls.covariance(rows[i].estimates[0], prior)
            covariance[i, k, 0, 0], covariance[i, k, 1, 1] = p_11, p_22
            covariance[i, k, 0, 1] = covariance[i, k, 1, 0] = p_12
            smallest, largest = ls.eigenvalues(rows[i].estimates[0])
            eigenvalues[i, k, 0], eigenvalues[i, k, 1] = smallest, largest


def run(samples, prior, memory=None, table=im.PLAIN) -> Run:
    """Feed samples (N, T, 5), columns as in ls.Sample; memory: where to go on from."""
    samples = np.ascontiguousarray(samples, dtype=float)
    count, steps = samples.shape[:2]
    prior = ls.Prior(*(float(x) for x in prior))
    memory = np.zeros((count, columns_of(im.ROW))) if memory is None else memory.copy()
    value, eigenvalues = np.empty((count, steps, 2)), np.empty((count, steps, 2))
    covariance = np.empty((count, steps, 2, 2))
    status, nis = np.empty((count, steps), dtype=np.int64), np.empty((count, steps))
    _run_all(
        samples, rows_of(memory, im.ROW), prior, table, value, covariance, eigenvalues, status, nis
    )
    return Run(value, covariance, eigenvalues, status, nis, memory)


def interact(samples, prior=LIVELY, memory=None) -> Run:
    """The same with interacting models."""
    return run(samples, prior, memory, TABLE)


def prior_draws(count, seed=7):
    """Parameters (count, 2) drawn from the prior of PLAIN."""
    draws = np.random.default_rng(seed).standard_normal((count, 2))
    return [PLAIN.mean_1, PLAIN.mean_2] + draws * [PLAIN.sigma_1, PLAIN.sigma_2]


def regression(theta, steps, seed=0, count=1, variance=0.04, noise_1=0.0, know_noise=True):
    """Samples (count, steps, 5) of y = phi . theta + e with white regressors, phi_1 of mean 3.

    theta: (2,), (count, 2) or (count, steps, 2). noise_1: variance of what is added to phi_1;
    know_noise: whether the sample says so.
    """
    rng = np.random.default_rng(seed)
    phi = rng.standard_normal((count, steps, 2)) + np.array([3.0, -1.0])
    theta = np.asarray(theta, dtype=float)
    theta = theta[:, None, :] if theta.ndim == 2 else theta
    y = (phi * theta).sum(-1) + np.sqrt(variance) * rng.standard_normal((count, steps))
    seen = phi[..., 0] + np.sqrt(noise_1) * rng.standard_normal((count, steps))
    total = variance + noise_1 * np.broadcast_to(theta, phi.shape)[..., 0] ** 2
    known = np.full((count, steps), noise_1 if know_noise else 0.0)
    return np.stack([y, seen, phi[..., 1], total, known], axis=-1)


def nees(result: Run, theta, step=-1) -> NDArray[np.float64]:
    """Normalised estimation error squared (N,) after a step."""
    error = result.value[:, step] - theta
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(result.covariance[:, step]), error)
