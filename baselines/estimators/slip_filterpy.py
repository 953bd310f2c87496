"""The slip observer around the unscented Kalman filter of the filterpy library.

Same interface, model, memory and answers as slip_observer; one UnscentedKalmanFilter object serves
all vehicles in turn, its x and P loaded from `memory`. Readers of filterpy can see here what the
batched observer computes. filterpy 2 draws new sigma points from (x, P + Q) before the update,
1.x did not; S 7.2.1 passes the propagated ones on. It is slower by two orders of magnitude.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.2. [2] R. Labbe, filterpy 2.0.
"""

import math
from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray

from baselines.estimators import slip_kinematics as kinematics
from baselines.estimators import slip_step as step
from baselines.estimators.slip_kinematics import ROWS, STATES, Constants, Inputs, Way
from baselines.estimators.slip_observer import BETA, SPREAD, Answer, SlipObserver
from tracked_env.physics.jit import loop


@loop
def process_point(point, _period, u, k):
    """f of one sigma point (STATES,)."""
    moved = point.copy()
    moved[0], moved[1], moved[2] = kinematics.process(
        point[0], point[1], point[2], point[3], point[4], point[5], u, k
    )
    return moved


@loop
def measured_point(point, u, way, gyro, k):
    """h of one sigma point: z (3,) or (ROWS,)."""
    z = np.empty(ROWS)
    state = (point[0], point[1], point[2], point[3], point[4], point[5])
    z[0], z[1], z[2], z[3], z[4], z[5] = kinematics.measured(state, u, way, gyro, k)
    return z[: int(k.rows)]


@loop
def begin(rows, i, sample, x, p, k):
    """Load vehicle i into x and p; returns its inputs."""
    step.load(rows[i], x, p)
    return step.take_drive(rows[i], sample, x, p, k)


@loop
def process_noise(yaw, u, k, noise):
    """Q of this step into noise (STATES, STATES)."""
    kinematics.fill_process_noise(noise, yaw, u, k)


@loop
def look(rows, rings, i, yaw, sample, u, k, arrays):
    """After the prediction; arrays: x, P, z, R.

    Returns (outcome, whether a pose is to be used, whether there is a sample to update with, way,
    gyro).
    """
    row, ring = rows[i], rings[i]
    x, p, z, noise = arrays
    step.reckon(row, ring, yaw, u, k)
    outcome = 1
    new, usable = step.has_pose(sample)
    if new and not usable:
        row.skipped += 1.0
        outcome = 2
    way = gyro = kinematics.since(row, ring, 0.0)
    pose = new and usable
    update = pose or step.is_blind(row, k)
    if pose:
        way, gyro = step.take_pose(row, ring, sample, x, u, k, (z, noise))
    elif update:
        way, gyro = step.take_motion(row, sample, x, p, u, k, (z, noise))
    if update and row.started == 0.0:
        step.start(row, sample.values, x, p, (z, noise), way, k)
        pose = update = False
    return outcome, pose, update, way, gyro


@loop
def innovation_verdict(rows, i, nis, k):
    """As slip_step.innovation_verdict."""
    return step.innovation_verdict(rows[i], nis, k)


@loop
def inflate(p, error, pose_nis, nis, k):
    """As slip_kinematics.inflate."""
    kinematics.inflate(p, error, pose_nis, nis, k)


@loop
def end(rows, i, arrays, u, used, outcome, k):
    """Bounds and memory of vehicle i; arrays: x, P and room for a factor of P.

    Returns (excitation, condition, status).
    """
    x, p, root = arrays
    return step.finish(rows[i], x, p, root, u, used, outcome, k)


class _Filter(UnscentedKalmanFilter):
    """filterpy's filter; its loop over the sigma points for P_xz is one product here."""

    def cross_variance(
        self,
        x: NDArray[np.float64],
        z: NDArray[np.float64],
        sigmas_f: NDArray[np.float64],
        sigmas_h: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """(42c): states x rows of z."""
        return np.asarray((sigmas_f - x).T @ (self.Wc[:, None] * (sigmas_h - z)))


class FilterpySlipObserver(SlipObserver):
    """SlipObserver with filterpy's filter inside; arguments and answers are the same."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        points = MerweScaledSigmaPoints(STATES, alpha=SPREAD, beta=BETA, kappa=0.0)
        rows = ROWS if self.velocity else 3
        self._filter = _Filter(
            STATES, rows, self.control_period, hx=measured_point, fx=process_point, points=points
        )
        self._z, self._noise = np.empty(ROWS), np.empty((ROWS, ROWS))

    def _advance(self, samples: tuple[Any, ...], answer: Answer) -> None:
        """As in SlipObserver, vehicle by vehicle."""
        ukf, k, rows, rings = self._filter, self._constants, self.rows, self.rings
        value, covariance, summary, status = answer
        for i in range(len(rows)):
            sample = step.Sensed(*(array[i] for array in samples))
            ukf.x, ukf.P = np.empty(STATES), np.empty((STATES, STATES))
            u = begin(rows, i, sample, ukf.x, ukf.P, k)
            yaw = float(ukf.x[2])
            if rows["started"][i] > 0.0:
                process_noise(yaw, u, k, ukf.Q)
                ukf.predict(u=u, k=k)
                yaw = 0.5 * (yaw + float(ukf.x[2]))
            arrays = ukf.x, ukf.P, self._z, self._noise
            outcome, used, update, way, gyro = look(rows, rings, i, yaw, sample, u, k, arrays)
            nis = math.nan
            if update:
                nis, refused = self._update(i, u, way, gyro)
                outcome, used = (2, False) if refused else (outcome, used)
                nis = nis if used or refused else math.nan
            end_arrays = ukf.x, ukf.P, np.empty((STATES, STATES))
            summary[i, 0], summary[i, 1], status[i] = end(rows, i, end_arrays, u, used, outcome, k)
            summary[i, 2], summary[i, 3] = nis, rows["skipped"][i]
            value[i], covariance[i] = ukf.x, ukf.P

    def _update(self, i: int, u: Inputs, way: Way, gyro: Way) -> tuple[float, bool]:
        """Update with the sample, unless it is an outlier. Returns its NIS, and whether it is."""
        ukf, k = self._filter, self._constants
        inner: dict[str, Inputs | Way | Constants] = {"u": u, "way": way, "gyro": gyro, "k": k}
        rows = ukf.R.shape[0]
        z, noise = self._z[:rows], self._noise[:rows, :rows]
        x, p = ukf.x, ukf.P
        ukf.update(z, R=noise, **inner)
        nis = float(ukf.y @ ukf.SI @ ukf.y)
        verdict = innovation_verdict(self.rows, i, nis, k)
        if verdict == 1:
            ukf.x, ukf.P = x, p
        elif verdict == 2:
            pose_nis = float(ukf.y[:3] @ np.linalg.solve(ukf.S[:3, :3], ukf.y[:3]))
            inflate(p, (z[0] - x[0], z[1] - x[1], z[2] - x[2]), pose_nis, nis, k)
            ukf.x, ukf.P = x, p
            ukf.sigmas_f = ukf.points_fn.sigma_points(x, p)
            ukf.update(z, R=noise, **inner)
        return nis, verdict == 1
