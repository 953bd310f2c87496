"""Unscented Kalman filter for the slips of both tracks, and a filtered pose: S 7.2, batched.

The model is in slip_kinematics, the rest of a step in slip_step; slip_filterpy is the same observer
around the filter of filterpy. The filter is a scaled unscented transform over six states:

n = 6, L = spread^2 n - n, U^T U = (n + L) P (Cholesky):
    sigma points   x, x + rows of U, x - rows of U
    weights        mean: L / (n + L), then c = 1 / (2 (n + L)) each
                   covariance: the first is larger by 1 - spread^2 + beta
    predict        mean and covariance of f(points), + Q; then new points from (x, P)
    update         S = cov(z, z) + R, C = cov(x, z), K = C S^-1:  x += K y, P -= K S K^T
spread = 0.6 is the smallest round one with which every weight of a covariance is positive (from
0.52 on), hence every P positive definite; a tiny one, such as 1e-3, has weights of 1e6 that cancel.
Slips and alpha do not move in f, so their part of the transform is exact and not computed; as x is
linear in the points, C = c U^T (Z+ - Z-). With the Cholesky factor of S = M M^T: W = M^-1 C^T,
x += W^T M^-1 y, P -= W^T W, NIS = |M^-1 y|^2.

References: [1] R. van der Merwe, PhD thesis, OGI (2004). [S] Strawa et al., Electronics 10 (2021)
187, section 7.2.1, with the errata on the sign of K S K^T and on the scaling.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from baselines.estimators import pose_outages as outage
from baselines.estimators import slip_kinematics as kinematics
from baselines.estimators import slip_step as step
from baselines.estimators.measurement import (
    POSE,
    REJECTED,
    BatchEstimator,
    Measurement,
    Quantity,
    Rows,
    columns_of,
)
from baselines.estimators.slip_kinematics import ROW, ROWS, SLIP_LEFT, SLOT, STATES
from tracked_env.physics.jit import BoundOnce, formula, loop
from tracked_env.physics.rigid_body import LEVEL

FALSE_ALARM = 1e-6  # [-] share of good samples that the outlier gate rejects
SPREAD = 0.6  # [-] alpha of the unscented transform
BETA = 2.0  # [-] best for a Gaussian
POINTS = 2 * STATES + 1
# Process noise, standard deviations that grow with the square root of time: what the kinematics
# leave out, bumps and flexing tracks; a slip changes by 0.02 in a second, straight into a turn on
# clay.
POSITION_DRIFT = 0.01  # [m/sqrt(s)]
YAW_DRIFT = 0.003  # [rad/sqrt(s)]
SLIP_DRIFT = 0.02  # [1/sqrt(s)]
SIDE_SLIP_DRIFT = 0.03  # [rad/sqrt(s)]
LONGEST_DELAY = 1.0  # [s] of the pose group; older samples count as that old
BIAS_WINDOW = 0.5  # [s] over it the gyro's bias does not average out, the noise does
SILENCE = 0.25  # [s] a pose that is only late or rare comes within it, see pose_outages
BLENDING = 0.5  # [s] time constant with which what is shown follows the first pose after an outage
LEAST_SIGMA = 1e-4  # [m, rad, m/s, rad/s] of ideal sensors: keeps the covariance well conditioned

_SCALE = SPREAD * SPREAD * STATES  # n + L
_C = 0.5 / _SCALE  # weight of every point but the first
_C0 = 1.0 - STATES / _SCALE + (1.0 - SPREAD * SPREAD + BETA)  # first weight of a covariance


class Scratch(NamedTuple):
    """Room for one step of one vehicle."""

    root: Any  # (6, 6) Cholesky factor
    points: Any  # (STATES, POINTS) sigma points
    images: Any  # (ROWS, POINTS) what the model makes of them
    s: Any  # (6, 6) covariance of the innovation
    w: Any  # (6, 6) M^-1 C^T
    e: Any  # (6,) M^-1 y
    z: Any  # (6,) sample
    noise: Any  # (6, 6) Q or R


@loop
def draw(x, p, root, points):
    """Sigma points (STATES, POINTS) of (x, P)."""
    kinematics.factorise(p, root, STATES, _SCALE)
    for a in range(STATES):
        for j in range(POINTS):
            points[a, j] = x[a]
        for m in range(a + 1):
            points[a, 1 + m] = x[a] + root[a, m]
            points[a, 1 + STATES + m] = x[a] - root[a, m]


@formula
def _point(points, j):
    """One sigma point as a state."""
    return points[0, j], points[1, j], points[2, j], points[3, j], points[4, j], points[5, j]


@loop
def predict(x, p, u, k, scratch):
    """(x, P) one step later, without Q."""
    root, points, images = scratch.root, scratch.points, scratch.images
    draw(x, p, root, points)
    for j in range(POINTS):
        images[0, j], images[1, j], images[2, j] = kinematics.process(_point(points, j), u, k)
    for a in range(3):
        first, total = images[a, 0], 0.0
        for j in range(1, POINTS):
            total += images[a, j] - first
        x[a] = first + _C * total
        for j in range(POINTS):
            images[a, j] -= x[a]
    for a in range(3):
        for b in range(a, 3):
            total = 0.0
            for j in range(1, POINTS):
                total += images[a, j] * images[b, j]
            p[a, b] = _C * total + _C0 * images[a, 0] * images[b, 0]
        for b in range(3, STATES):
            total = 0.0
            for m in range(b + 1):
                total += root[b, m] * (images[a, 1 + m] - images[a, 1 + STATES + m])
            p[a, b] = _C * total


@loop
def compare(x, p, u, way, gyro, k, scratch):
    """Innovation of z in units of its sigma, e = M^-1 y, and W = M^-1 C^T (ROWS, STATES). Returns
    (NIS of the pose rows, NIS of all rows)."""
    root, points, images, s, w, e, z, noise = scratch
    rows = int(k.rows)
    draw(x, p, root, points)
    for j in range(POINTS):
        (
            images[0, j], images[1, j], images[2, j], images[3, j], images[4, j], images[5, j],
        ) = kinematics.measured(_point(points, j), u, way, gyro, k)  # fmt: skip
    for a in range(rows):
        first, total = images[a, 0], 0.0
        for j in range(1, POINTS):
            total += images[a, j] - first
        mean = first + _C * total
        e[a] = z[a] - mean
        for j in range(POINTS):
            images[a, j] -= mean
        for b in range(STATES):
            total = 0.0
            for m in range(b + 1):
                total += root[b, m] * (images[a, 1 + m] - images[a, 1 + STATES + m])
            w[a, b] = _C * total
    for a in range(rows):
        for b in range(a, rows):
            total = 0.0
            for j in range(1, POINTS):
                total += images[a, j] * images[b, j]
            s[a, b] = noise[a, b] + _C * total + _C0 * images[a, 0] * images[b, 0]
    kinematics.factorise(s, root, rows, 1.0)
    pose_nis = nis = 0.0
    for a in range(rows):
        for m in range(a):
            e[a] -= root[a, m] * e[m]
            for b in range(STATES):
                w[a, b] -= root[a, m] * w[m, b]
        inverse = 1.0 / root[a, a]
        e[a] *= inverse
        for b in range(STATES):
            w[a, b] *= inverse
        nis += e[a] * e[a]
        pose_nis = nis if a < 3 else pose_nis
    return pose_nis, nis


@formula
def _correct(x, p, rows, w, e):
    """x += W^T e, P -= W^T W (upper triangle)."""
    for r in range(rows):
        for a in range(STATES):
            x[a] += w[r, a] * e[r]
            for b in range(a, STATES):
                p[a, b] -= w[r, a] * w[r, b]


@loop
def update_all(samples, k, rows, rings, answers):
    """One step of all vehicles. samples: values (N, CHANNELS), fresh, age, attitude (N, 3). rows
    (N,) and rings (N, slots) of the state are changed, the answers (N,) written."""
    values, fresh, age, attitude = samples
    scratch = Scratch(
        np.empty((6, 6)), np.empty((STATES, POINTS)), np.empty((ROWS, POINTS)), np.empty((6, 6)),
        np.empty((6, 6)), np.empty(6), np.empty(6), np.empty((6, 6)),
    )  # fmt: skip
    z, noise, w, e = scratch.z, scratch.noise, scratch.w, scratch.e
    out = z, noise
    for i in range(rows.shape[0]):
        row, ring, answer = rows[i], rings[i], answers[i]
        x, p = row.state, row.covariance
        sample = step.Sensed(values[i], fresh[i], age[i], attitude[i])
        u = step.take_drive(row, sample, k)
        started = row.started > 0.0
        yaw = x[2]
        if started:
            kinematics.fill_process_noise(noise, yaw, u, k)
            predict(x, p, u, k, scratch)
            yaw = 0.5 * (yaw + x[2])
            for a in range(STATES):
                for b in range(a, STATES):
                    p[a, b] += noise[a, b]
        kinematics.push(row, ring, kinematics.step_way(yaw, (row.belt[0], row.belt[1]), u, k))
        refused, used, nis = False, False, math.nan
        new = sample.fresh[POSE]
        if new and not step.has_pose(sample):
            row.skipped += 1.0
            new, refused = False, True
        if new:
            way, gyro = step.take_pose(row, ring, sample, u, k, out)
            if not started:
                step.start(row, sample.values, out, way, k)
            else:
                pose_nis, nis = compare(x, p, u, way, gyro, k, scratch)
                verdict = step.innovation_verdict(row, nis, k)
                refused = verdict == step.OUTLIER
                used = not refused
                if verdict == step.CHANGE:
                    error = (z[0] - x[0], z[1] - x[1], z[2] - x[2])
                    kinematics.inflate(p, error, pose_nis, nis, k)
                    compare(x, p, u, way, gyro, k, scratch)
                if used:
                    _correct(x, p, int(k.rows), w, e)
        elif outage.silent(row, k):
            way, gyro = step.take_motion(row, sample, u, k, out)
            compare(x, p, u, way, gyro, k, scratch)
            _correct(x, p, ROWS, w, e)
        answer.excitation, answer.condition, learns = step.finish(row, scratch.root, u, used, k)
        answer.status = REJECTED if refused else learns
        answer.nis, answer.skipped = nis, row.skipped
        for a in range(STATES):
            answer.value[a] = x[a]
            for b in range(STATES):
                answer.covariance[a, b] = p[a, b]


@loop
def motion_all(rows, k, motion):
    """(X, Y, psi, v_x, v_y, w) of all vehicles into motion (N, 6)."""
    for i in range(rows.shape[0]):
        row = rows[i]
        x, belts = row.state, (row.belt[0], row.belt[1])
        u = kinematics.make_inputs(belts, belts, x, LEVEL, 0.0, -1.0, k)
        left, right, tangent = kinematics.gains(x[3], x[4], x[5], u)
        velocity = kinematics.body_velocity(left, right, belts, tangent, k)
        for a in range(3):
            motion[i, a] = x[a] + row.gap[a]
            motion[i, 3 + a] = velocity[a]
        motion[i, 3] += row.gap[3]


@loop
def read_slips(rows, k, slips, variances):
    """Slips and their variances of all vehicles, (N, 2) each."""
    for i in range(rows.shape[0]):
        row = rows[i]
        for side in range(2):
            state = SLIP_LEFT + side
            slips[i, side] = row.state[state]
            blind = outage.silent(row, k)
            variances[i, side] = math.inf if blind else row.covariance[state, state]


@loop
def take_ground_all(rows, k, soil, covariance, friction):
    """soil (N, 2) F_max, K, their covariance (N, 2, 2) and mu_t (N,), for outages."""
    for i in range(rows.shape[0]):
        row, maximum, modulus = rows[i], soil[i, 0], soil[i, 1]
        row.effort_maximum = maximum
        row.shear_length = k.contact_length / modulus
        row.p_ff = covariance[i, 0, 0] / (maximum * maximum)
        row.p_fk = covariance[i, 0, 1] / (maximum * modulus)
        row.p_kk = covariance[i, 1, 1] / (modulus * modulus)
        row.friction = friction[i]


class Motion(NamedTuple):
    """Filtered pose and velocities of N vehicles, each (N,)."""

    x: NDArray[np.float64]  # [m] world
    y: NDArray[np.float64]  # [m] world
    yaw: NDArray[np.float64]  # [rad] not wrapped
    v_x: NDArray[np.float64]  # [m/s] body
    v_y: NDArray[np.float64]  # [m/s] body
    yaw_rate: NDArray[np.float64]  # [rad/s]


class SlipObserver(BatchEstimator):
    """Slip ratios, side slip angle and pose of N vehicles from pose and sprocket speeds.

    Of the nominal parameters track gauge and sprocket radius are used, in outages contact length
    and icr_forward too.
    velocity: True uses v_x, v_y of the pose group and the gyro too, False the paper's pose alone.
    """

    names = kinematics.NAMES
    provides = (
        Quantity("slip_left", "-"),
        Quantity("slip_right", "-"),
        Quantity("side_slip", "rad"),
    )
    needs: tuple[str, ...] = (
        "x", "y", "yaw", "v_x", "v_y", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right",
        "acceleration_x", "acceleration_y", "torque_left", "torque_right",
    )  # fmt: skip
    paired = False
    reads_attitude = True
    row = ROW
    kernel = update_all
    initial: Mapping[str, Any] = {
        "covariance": np.diag([kinematics.largest_variance(a) for a in range(STATES)]),
        "stale": step.LARGEST_READING,
    }
    rings = Rows("ring", SLOT)

    def __init__(self, *setting: Any, velocity: bool = True, **named: Any) -> None:
        super().__init__(*setting, **named)
        p, sheet, period = self.parameters, self.data_sheet, self.control_period
        rows = ROWS if velocity else 3
        drifts = (POSITION_DRIFT, YAW_DRIFT, SLIP_DRIFT, SIDE_SLIP_DRIFT)
        sigma = {name: max(number, LEAST_SIGMA) for name, number in sheet._asdict().items()}
        belt_sigma = p.sprocket_radius * sheet.sprocket_speed_noise
        bias = sheet.gyro_bias**2 * max(BIAS_WINDOW / period, 1.0)
        numbers = (
            period,
            p.sprocket_radius,
            1.0 / p.track_gauge,
            belt_sigma**2,
            kinematics.STANDING_BELT + 3.0 * belt_sigma,
            sigma["position_noise"] ** 2,
            sigma["yaw_noise"] ** 2,
            sigma["velocity_noise"] ** 2,
            sigma["gyro_noise"] ** 2 + bias,
            *(drift * drift * period for drift in drifts),
            chi2.isf(FALSE_ALARM, rows),
            rows,
            SILENCE / period if velocity else math.inf,
            sheet.acceleration_noise**2,
            sigma["acceleration_bias"] ** 2,
            sigma["gyro_noise"] ** 2,
            sigma["gyro_bias"] ** 2,
            p.contact_length,
            self.lateral == "constrained",
            p.icr_forward,
            math.exp(-period / BLENDING),
        )
        self.model = kinematics.Constants(*(float(number) for number in numbers))
        self._motion, self._read_slips = BoundOnce(motion_all), BoundOnce(read_slips)
        self._take_ground = BoundOnce(take_ground_all)
        slots = round(LONGEST_DELAY / period) + 3
        self.ring = np.zeros((len(self.memory), slots * columns_of(SLOT)))
        self.reset()

    def take_ground(
        self,
        soil: NDArray[np.float64],
        covariance: NDArray[np.float64],
        friction: NDArray[np.float64],
    ) -> None:
        """The ground as identified, for outages: F_max [N] of a track and K [m] (N, 2), their
        covariance (N, 2, 2), mu_t (N,)."""
        ground = (np.ascontiguousarray(each, float) for each in (soil, covariance, friction))
        self._take_ground(self.rows, self.model, *ground)

    def inputs(self, measurement: Measurement) -> tuple[Any, ...]:
        """Samples, model and state."""
        return (*measurement, measurement.attitude), self.model, self.rows, self.rings

    def motion_rows(self) -> NDArray[np.float64]:
        """The columns of a Motion, (N, 6)."""
        columns = np.empty((len(self.memory), 6))
        self._motion(self.rows, self.model, columns)
        return columns

    def motion(self) -> Motion:
        """Filtered pose; velocities by the model from the last belt speeds and the slips."""
        return Motion(*self.motion_rows().T)

    def slips_and_variances(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """i_L, i_R (N, 2) [-], and their variances; inf in an outage, where slips are what the soil
        is thought to be."""
        shape = (len(self.memory), 2)
        slips, variances = np.empty(shape), np.empty(shape)
        self._read_slips(self.rows, self.model, slips, variances)
        return slips, variances
