"""The slip observer around the unscented Kalman filter of the filterpy library.

Same interface, model, memory and answers as slip_observer; one UnscentedKalmanFilter object serves
all vehicles in turn, its x and P loaded from `memory`. Whoever knows filterpy can read here what
the batched observer computes. filterpy 2 draws new sigma points from (x, P + Q) before the update,
1.x did not; S 7.2.1 passes the propagated ones on. It is slower by two orders of magnitude.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.2. [2] R. Labbe, filterpy 2.0.
"""

import math
from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray

from baselines.estimators import slip_kinematics
from baselines.estimators import slip_kinematics as slip_covariance
from baselines.estimators import slip_step as step
from baselines.estimators.measurement import Measurement, attitude_of
from baselines.estimators.slip_kinematics import ROWS, STATES, Constants, Inputs, Way
from baselines.estimators.slip_observer import BETA, SPREAD, SlipObserver
from tracked_env.physics.jit import formula, loop

# One row of numbers passes between Python and the kernels: calls with tuples cost more.
_WAY, _GYRO, _USED, _OUTCOME = 20, 30, 40, 41  # its first columns are the Inputs
_LINK = 42


@formula
def _constants(c):
    """Constants from an array."""
    return Constants(
        c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7],
        c[8], c[9], c[10], c[11], c[12], c[13], c[14], c[15],
        c[16], c[17], c[18], c[19], c[20], c[21], c[22], c[23],
    )  # fmt: skip


@formula
def _inputs(r):
    """Inputs from the link row."""
    return Inputs(
        r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11],
        r[12], r[13], r[14], r[15], r[16], r[17], r[18], r[19],
    )  # fmt: skip


@formula
def _way(r, at):
    """Way from the link row, from column `at` on."""
    return Way(
        r[at], r[at + 1], r[at + 2], r[at + 3], r[at + 4],
        r[at + 5], r[at + 6], r[at + 7], r[at + 8], r[at + 9],
    )  # fmt: skip


@loop
def process_point(point, _period, link, constants):
    """f of one sigma point (STATES,)."""
    k = _constants(constants)
    moved = point.copy()
    moved[0], moved[1], moved[2] = slip_kinematics.process(
        point[0], point[1], point[2], point[3], point[4], point[5], _inputs(link), k
    )
    return moved


@loop
def measured_point(point, link, constants):
    """h of one sigma point: z (3,) or (ROWS,)."""
    k = _constants(constants)
    z = np.empty(ROWS)
    z[0], z[1], z[2], z[3], z[4], z[5] = slip_kinematics.measured(
        point[0], point[1], point[2], point[3], point[4], point[5],
        _inputs(link), _way(link, _WAY), _way(link, _GYRO), k,
    )  # fmt: skip
    return z[: int(k.rows)]


@loop
def begin(memory, i, values, fresh, attitude, constants, link, x, p):
    """Load vehicle i into x and p, its inputs into link."""
    step.load(memory, i, x, p)
    u = step.take_drive(memory, i, values, fresh, attitude, x, p, _constants(constants))
    for column in range(_WAY):
        link[column] = u[column]


@loop
def process_noise(yaw, constants, link, noise):
    """Q of this step into noise (STATES, STATES)."""
    slip_covariance.fill_process_noise(noise, yaw, _inputs(link), _constants(constants))


@loop
def look(memory, i, slots, yaw, values, fresh, age, constants, link, x, p, z, noise):
    """After the prediction. Returns True when there is a sample to update with: z and noise."""
    k, u = _constants(constants), _inputs(link)
    step.reckon(memory, i, slots, yaw, u, k)
    link[_OUTCOME], link[_USED] = 1.0, 0.0
    new, usable = step.has_pose(values, fresh, i)
    if new and not usable:
        memory[i, step.SKIPPED] += 1.0
        link[_OUTCOME] = 2.0
    if new and usable:
        way, gyro = step.take_pose(memory, i, slots, values, fresh, age, x, u, k, z, noise)
        link[_USED] = 1.0
    elif step.is_blind(memory, i, k):
        way, gyro = step.take_motion(memory, i, values, fresh, x, p, u, k, z, noise)
    else:
        return False
    for column in range(_GYRO - _WAY):
        link[_WAY + column] = way[column]
        link[_GYRO + column] = gyro[column]
    if memory[i, step.STARTED] == 0.0:
        step.start(memory, i, values, x, p, z, noise, way, k)
        link[_USED] = 0.0
        return False
    return True


@loop
def innovation_verdict(memory, i, nis, constants):
    """As slip_step.innovation_verdict."""
    return step.innovation_verdict(memory, i, nis, _constants(constants))


@loop
def inflate(p, z, x, pose_nis, nis, constants):
    """As slip_covariance.inflate."""
    k = _constants(constants)
    slip_covariance.inflate(p, z[0] - x[0], z[1] - x[1], z[2] - x[2], pose_nis, nis, k)


@loop
def end(memory, i, link, x, p, constants, value, covariance, summary, status):
    """Bounds, memory and answers of vehicle i."""
    u, used, outcome = _inputs(link), link[_USED] > 0.0, int(link[_OUTCOME])
    root = np.empty((STATES, STATES))
    summary[i, 0], summary[i, 1], status[i] = step.finish(
        memory, i, x, p, root, u, used, outcome, _constants(constants)
    )
    summary[i, 3] = memory[i, step.SKIPPED]
    value[i] = x
    covariance[i] = p


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
        self._numbers = np.array(self._constants)
        self._link = np.zeros(_LINK)
        rows = ROWS if self.velocity else 3
        self._filter = _Filter(
            STATES,
            rows,
            self.control_period,
            hx=measured_point,
            fx=process_point,
            points=MerweScaledSigmaPoints(STATES, alpha=SPREAD, beta=BETA, kappa=0.0),
        )
        self._z = np.empty(ROWS)
        self._noise = np.empty((ROWS, ROWS))

    def _advance(
        self,
        measurement: Measurement,
        value: NDArray[np.float64],
        covariance: NDArray[np.float64],
        summary: NDArray[np.float64],
        status: NDArray[np.int64],
    ) -> None:
        """As in SlipObserver, vehicle by vehicle."""
        link, ukf = self._link, self._filter
        values, fresh, age = measurement
        attitude = attitude_of(measurement)
        for i in range(len(self.memory)):
            ukf.x, ukf.P = np.empty(STATES), np.empty((STATES, STATES))
            begin(self.memory, i, values, fresh, attitude, self._numbers, link, ukf.x, ukf.P)
            yaw = float(ukf.x[2])
            if self.memory[i, step.STARTED] > 0.0:
                yaw = self._predict(yaw)
            summary[i, 2] = math.nan
            if look(
                self.memory, i, self._slots, yaw, values, fresh, age,
                self._numbers, link, ukf.x, ukf.P, self._z, self._noise,
            ):  # fmt: skip
                summary[i, 2] = self._update(i)
            end(
                self.memory,
                i,
                link,
                ukf.x,
                ukf.P,
                self._numbers,
                value,
                covariance,
                summary,
                status,
            )

    def _predict(self, yaw: float) -> float:
        """Predict; returns the heading in the middle of the step."""
        ukf, inner = self._filter, {"link": self._link, "constants": self._numbers}
        process_noise(yaw, self._numbers, self._link, ukf.Q)
        ukf.predict(**inner)
        return 0.5 * (yaw + float(ukf.x[2]))

    def _update(self, i: int) -> float:
        """Update with the sample, unless it is an outlier. Returns its NIS, NaN of no pose."""
        ukf, inner = self._filter, {"link": self._link, "constants": self._numbers}
        rows = ukf.R.shape[0]
        z, noise = self._z[:rows], self._noise[:rows, :rows]
        x, p = ukf.x, ukf.P
        ukf.update(z, R=noise, **inner)
        nis = float(ukf.y @ ukf.SI @ ukf.y)
        verdict = innovation_verdict(self.memory, i, nis, self._numbers)
        if verdict == 1:
            ukf.x, ukf.P = x, p
            self._link[_OUTCOME], self._link[_USED] = 2.0, 0.0
            return nis
        if verdict == 2:
            pose_nis = float(ukf.y[:3] @ np.linalg.solve(ukf.S[:3, :3], ukf.y[:3]))
            inflate(p, z, x, pose_nis, nis, self._numbers)
            ukf.x, ukf.P = x, p
            ukf.sigmas_f = ukf.points_fn.sigma_points(x, p)
            ukf.update(z, R=noise, **inner)
        return nis if self._link[_USED] > 0.0 else math.nan
