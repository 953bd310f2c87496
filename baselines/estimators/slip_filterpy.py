"""The slip observer around the unscented Kalman filter of the filterpy library.

Model, memory and answers are those of slip_observer; one UnscentedKalmanFilter serves all vehicles
in turn. Readers of filterpy can see here what the batched observer computes. filterpy 2 draws new
sigma points from (x, P + Q) before the update, 1.x did not; S 7.2.1 passes the propagated ones on.
It is slower, 40 times for one vehicle, 180 times for 64.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.2. [2] R. Labbe, filterpy 2.0.
"""

import math
from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray

from baselines.estimators import pose_outages as outage
from baselines.estimators import slip_kinematics as kinematics
from baselines.estimators import slip_step as step
from baselines.estimators.measurement import POSE, REJECTED, Measurement, empty_rows
from baselines.estimators.slip_kinematics import ROWS, STATES, Inputs, Way
from baselines.estimators.slip_observer import BETA, SPREAD, SlipObserver
from tracked_env.physics.jit import formula, loop

Floats = NDArray[np.float64]


@formula
def _state(point):
    """A sigma point (STATES,) as the model takes it."""
    return point[0], point[1], point[2], point[3], point[4], point[5]


@loop
def process_point(point, _period, u, k):
    """f of one sigma point (STATES,)."""
    moved = point.copy()
    moved[0], moved[1], moved[2] = kinematics.process(_state(point), u, k)
    return moved


@loop
def measured_point(point, u, way, gyro, k):
    """h of one sigma point: z (3,) or (ROWS,)."""
    z = np.empty(ROWS)
    z[0], z[1], z[2], z[3], z[4], z[5] = kinematics.measured(_state(point), u, way, gyro, k)
    return z[: int(k.rows)]


class _Filter(UnscentedKalmanFilter):
    """filterpy's filter; its loop over the sigma points for P_xz is one product here."""

    def cross_variance(self, x: Floats, z: Floats, sigmas_f: Floats, sigmas_h: Floats) -> Floats:
        """(42c): states x rows of z."""
        return np.asarray((sigmas_f - x).T @ (self.Wc[:, None] * (sigmas_h - z)))


class FilterpySlipObserver(SlipObserver):
    """SlipObserver with filterpy's filter inside; arguments and answers are the same."""

    def __init__(self, *setting: Any, **named: Any) -> None:
        super().__init__(*setting, **named)
        points = MerweScaledSigmaPoints(STATES, alpha=SPREAD, beta=BETA, kappa=0.0)
        rows, period = int(self.model.rows), self.control_period
        self._ukf = _Filter(STATES, rows, period, measured_point, process_point, points)

    def compute(self, measurement: Measurement) -> NDArray[Any]:
        """As SlipObserver, vehicle by vehicle."""
        answers = empty_rows(len(self.memory), self._answer)
        samples, rows, rings = (*measurement, measurement.attitude), self.rows, self.rings
        for i in range(len(rows)):
            sample = step.Sensed(*(array[i] for array in samples))
            self._step(rows[i], rings[i], sample, answers[i])
        self.answer = np.asarray(answers)
        return self.answer

    def _step(self, row: Any, ring: Any, sample: step.Sensed, answer: Any) -> None:
        """One step of one vehicle, as in slip_observer.update_all."""
        ukf, k, x, p = self._ukf, self.model, row["state"], row["covariance"]
        u = step.take_drive(row, sample, k)
        started, yaw = row["started"] > 0.0, x[2]
        if started:
            ukf.x, ukf.P = x.copy(), p.copy()
            kinematics.fill_process_noise(ukf.Q, yaw, u, k)
            ukf.predict(u=u, k=k)
            x[:], p[:] = ukf.x, ukf.P
            yaw = 0.5 * (yaw + x[2])
        kinematics.push(row, ring, kinematics.step_way(yaw, tuple(row["belt"]), u, k))
        refused, used, nis = False, False, math.nan
        new, out = sample.fresh[POSE], (np.empty(ROWS), np.empty((ROWS, ROWS)))
        if new and not step.has_pose(sample):
            row["skipped"] += 1.0
            new, refused = False, True
        if new:
            way, gyro = step.take_pose(row, ring, sample, u, k, out)
            if started:
                nis, refused = self._update(row, out, u, (way, gyro))
                used = not refused
            else:
                step.start(row, sample.values, out, way, k)
        elif outage.silent(row, k):
            way, gyro = step.take_motion(row, sample, u, k, out)
            self._correct(out, u, (way, gyro))
            x[:], p[:] = ukf.x, ukf.P
        end = step.finish(row, np.empty((STATES, STATES)), u, used, k)
        answer["excitation"], answer["condition"], learns = end
        answer["status"] = REJECTED if refused else learns
        answer["nis"], answer["skipped"] = nis, row["skipped"]
        answer["value"], answer["covariance"] = x, p

    def _correct(self, out: tuple[Floats, Floats], u: Inputs, ways: tuple[Way, Way]) -> None:
        """filterpy's update with z and R, the two of `out`."""
        rows, (z, noise), (way, gyro) = int(self.model.rows), out, ways
        noise = noise[:rows, :rows]
        self._ukf.update(z[:rows], R=noise, u=u, way=way, gyro=gyro, k=self.model)

    def _update(
        self, row: Any, out: tuple[Floats, Floats], u: Inputs, ways: tuple[Way, Way]
    ) -> tuple[float, bool]:
        """Update with a pose, unless it is an outlier. Returns its NIS, and whether it is."""
        ukf, k, x, p, z = self._ukf, self.model, row["state"], row["covariance"], out[0]
        self._correct(out, u, ways)
        nis = float(ukf.y @ ukf.SI @ ukf.y)
        verdict = step.innovation_verdict(row, nis, k)
        if verdict == step.OUTLIER:
            return nis, True
        if verdict == step.CHANGE:
            pose_nis = float(ukf.y[:3] @ np.linalg.solve(ukf.S[:3, :3], ukf.y[:3]))
            kinematics.inflate(p, (z[0] - x[0], z[1] - x[1], z[2] - x[2]), pose_nis, nis, k)
            ukf.x, ukf.P = x.copy(), p.copy()
            ukf.sigmas_f = ukf.points_fn.sigma_points(x, p)
            self._correct(out, u, ways)
        x[:], p[:] = ukf.x, ukf.P
        return nis, False
