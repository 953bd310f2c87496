"""Unscented Kalman filter for the slips of both tracks, and a filtered pose: S 7.2, batched.

The model is in slip_kinematics, the rest of a step in slip_step. slip_filterpy is the same observer
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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from baselines.estimators import pose_outages as outage
from baselines.estimators import slip_kinematics as kinematics
from baselines.estimators import slip_step as step
from baselines.estimators.measurement import (
    ATTITUDE,
    BatchEstimator,
    DataSheet,
    Estimate,
    Measurement,
    Quantity,
    Setting,
    attitude_of,
    columns_of,
    rows_of,
)
from baselines.estimators.observation_reader import POSE_DELAY
from baselines.estimators.slip_kinematics import ROW, ROWS, SLIP_LEFT, SLOT, STATES
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import RANGES, PlantParameters, Range
from tracked_env.physics.rigid_body import LEVEL
from tracked_env.validation import CONTROL_PERIOD, SIGMA, VEHICLES, checked_number, checked_whole

# Value, covariance, (N, 4) excitation, condition, NIS, skipped, and status.
Answer = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]
FALSE_ALARM = 1e-6  # [-] share of good samples that the outlier gate rejects
SPREAD = 0.6  # [-] alpha of the unscented transform
BETA = 2.0  # [-] best for a Gaussian
POINTS = 2 * STATES + 1

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


@loop
def predict(x, p, u, k, scratch):
    """(x, P) one step later, without Q."""
    root, points, images = scratch.root, scratch.points, scratch.images
    draw(x, p, root, points)
    for j in range(POINTS):
        images[0, j], images[1, j], images[2, j] = kinematics.process(
            points[0, j], points[1, j], points[2, j],
            points[3, j], points[4, j], points[5, j], u, k,
        )  # fmt: skip
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
    """Innovation of z in units of its sigma, e = M^-1 y, and W = M^-1 C^T (ROWS, STATES).

    Returns (NIS of the pose rows, NIS of all rows).
    """
    root, points, images, s, w, e, z, noise = scratch
    rows = int(k.rows)
    draw(x, p, root, points)
    for j in range(POINTS):
        point = (
            points[0, j], points[1, j], points[2, j], points[3, j], points[4, j], points[5, j]
        )  # fmt: skip
        (
            images[0, j], images[1, j], images[2, j], images[3, j], images[4, j], images[5, j],
        ) = kinematics.measured(point, u, way, gyro, k)  # fmt: skip
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
    """One step of all vehicles.

    samples: values (N, CHANNELS), fresh, age, attitude (N, 3). rows (N,) and rings (N, slots) of
    the state are changed, the answers written: value, covariance, summary (N, 4) excitation,
    condition, NIS, skipped, and status.
    """
    values, fresh, age, attitude = samples
    value, covariance, summary, status = answers
    scratch = Scratch(
        np.empty((6, 6)), np.empty((STATES, POINTS)), np.empty((ROWS, POINTS)), np.empty((6, 6)),
        np.empty((6, 6)), np.empty(6), np.empty(6), np.empty((6, 6)),
    )  # fmt: skip
    z, noise, w, e = scratch.z, scratch.noise, scratch.w, scratch.e
    out = z, noise
    for i in range(rows.shape[0]):
        row, ring, x, p = rows[i], rings[i], value[i], covariance[i]
        sample = step.Sensed(values[i], fresh[i], age[i], attitude[i])
        step.load(row, x, p)
        u = step.take_drive(row, sample, x, p, k)
        started = row.started > 0.0
        yaw = x[2]
        if started:
            kinematics.fill_process_noise(noise, yaw, u, k)
            predict(x, p, u, k, scratch)
            yaw = 0.5 * (yaw + x[2])
            for a in range(STATES):
                for b in range(a, STATES):
                    p[a, b] += noise[a, b]
        step.reckon(row, ring, yaw, u, k)
        outcome, used, nis = 1, False, math.nan
        new, usable = step.has_pose(sample)
        if new and not usable:
            row.skipped += 1.0
            outcome = 2
        if step.is_blind(row, k) and not (new and usable):
            way, gyro = step.take_motion(row, sample, x, p, u, k, out)
            compare(x, p, u, way, gyro, k, scratch)
            _correct(x, p, ROWS, w, e)
        elif new and usable:
            way, gyro = step.take_pose(row, ring, sample, x, u, k, out)
            if not started:
                step.start(row, sample.values, x, p, out, way, k)
            else:
                pose_nis, nis = compare(x, p, u, way, gyro, k, scratch)
                verdict = step.innovation_verdict(row, nis, k)
                used = verdict != 1
                if verdict == 1:
                    outcome = 2
                elif verdict == 2:
                    error = (z[0] - x[0], z[1] - x[1], z[2] - x[2])
                    kinematics.inflate(p, error, pose_nis, nis, k)
                    compare(x, p, u, way, gyro, k, scratch)
                if used:
                    _correct(x, p, int(k.rows), w, e)
        summary[i, 0], summary[i, 1], status[i] = step.finish(
            row, x, p, scratch.root, u, used, outcome, k
        )
        summary[i, 2], summary[i, 3] = nis, row.skipped


@loop
def forget(rows, which):
    """Vehicles `which` as nothing were known of them."""
    for i in which:
        row = rows[i]
        for a in range(STATES):
            row.covariance[a, a] = kinematics.largest_variance(a)
        row.held[0] = row.held[1] = step.LARGEST_READING


@loop
def motion_all(rows, k, motion):
    """(X, Y, psi, v_x, v_y, w) of all vehicles into motion (N, 6)."""
    for i in range(rows.shape[0]):
        row = rows[i]
        x, belts = row.state, (row.belt[0], row.belt[1])
        u = kinematics.make_inputs(belts, belts, x, LEVEL, 0.0, -1.0, k)
        left, right, tangent = kinematics.gains(x[3], x[4], x[5], u)
        velocity = kinematics.body_velocity(left, right, belts[0], belts[1], tangent, k)
        for a in range(3):
            motion[i, a] = x[a] + row.gap[a]
            motion[i, 3 + a] = velocity[a]
        motion[i, 3] += row.gap[3]


@loop
def read_slips(rows, k, slips, variances):
    """i_L, i_R and their variances of all vehicles, (N, 2) each; inf in an outage, where slips are
    what the soil is thought to be."""
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
        maximum, modulus = soil[i, 0], soil[i, 1]
        ff = covariance[i, 0, 0] / (maximum * maximum)
        fk = covariance[i, 0, 1] / (maximum * modulus)
        kk = covariance[i, 1, 1] / (modulus * modulus)
        outage.take_ground(rows[i], maximum, modulus, ff, fk, kk, friction[i], k)


def estimate_of(names: tuple[str, ...], answer: Answer) -> Estimate:
    """A bare answer as an Estimate."""
    value, covariance, summary, status = answer
    return Estimate(
        names, value, covariance, summary[:, 0], summary[:, 1], status, summary[:, 2],
        summary[:, 3].astype(np.int64),
    )  # fmt: skip


class Motion(NamedTuple):
    """Filtered pose and velocities of N vehicles, each (N,)."""

    x: NDArray[np.float64]  # [m] world
    y: NDArray[np.float64]  # [m] world
    yaw: NDArray[np.float64]  # [rad] not wrapped
    v_x: NDArray[np.float64]  # [m/s] body
    v_y: NDArray[np.float64]  # [m/s] body
    yaw_rate: NDArray[np.float64]  # [rad/s]


_DRIFT = Range(0.0, 10.0, "SI/sqrt(s)", "It is no variance.")
_DELAY = Range(0.0, 10.0, "s", "Did you pass milliseconds?")


class SlipObserver(BatchEstimator):
    """Slip ratios, side slip angle and pose of N vehicles from pose and sprocket speeds.

    parameters: nominal; track gauge and sprocket radius are used, in outages contact length and
    icr_forward too. control_period [s]:
    time between two updates. data_sheet: noise of the sensors. count: N.
    velocity: True uses v_x, v_y of the pose group and the gyro too, False the paper's pose alone.
    Process noise, standard deviations that grow with the square root of time:
    position_drift [m/sqrt(s)], yaw_drift [rad/sqrt(s)]: what the kinematics leave out, bumps and
    flexing tracks. slip_drift [1/sqrt(s)]: a slip changes by 0.02 in a second, straight into a
    turn on clay. side_slip_drift [rad/sqrt(s)]: likewise.
    longest_delay [s]: of the pose group; older samples count as that old. lateral: lateral model
    of the nominal vehicle, used in outages.

    Raises ValueError for arguments outside their range.
    """

    names = kinematics.NAMES
    provides = (
        Quantity("slip_left", "-"), Quantity("slip_right", "-"), Quantity("side_slip", "rad"),
    )  # fmt: skip
    needs: tuple[str, ...] = (
        "x", "y", "yaw", "v_x", "v_y", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right",
        "acceleration_x", "acceleration_y", "torque_left", "torque_right",
    )  # fmt: skip
    paired = False
    row = ROW

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        count: int = 1,
        velocity: bool = True,
        position_drift: float = 0.01,
        yaw_drift: float = 0.003,
        slip_drift: float = 0.02,
        side_slip_drift: float = 0.03,
        longest_delay: float = 1.0,
        lateral: str = "sliding",
    ) -> None:
        self.control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        count = checked_whole("count", count, VEHICLES)
        for name in ("track_gauge", "sprocket_radius"):
            checked_number(name, getattr(parameters, name), RANGES[name])
        for name, number in data_sheet._asdict().items():
            checked_number(name, number, POSE_DELAY if name == "pose_delay" else SIGMA)
        drifts = (position_drift, yaw_drift, slip_drift, side_slip_drift)
        for name, drift in zip(("position", "yaw", "slip", "side_slip"), drifts, strict=True):
            checked_number(f"{name}_drift", drift, _DRIFT)
        checked_number("longest_delay", longest_delay, _DELAY)
        self.velocity = bool(velocity)
        rows = ROWS if velocity else 3
        gate = float(chi2.isf(FALSE_ALARM, rows))
        self._constants = kinematics.make_constants(
            parameters, self.control_period, data_sheet, drifts, gate, rows, lateral
        )
        slots = kinematics.slots_for(longest_delay, self.control_period)
        self.memory = np.zeros((count, columns_of(ROW)))
        self.ring = np.zeros((count, slots * columns_of(SLOT)))
        self.reset()

    @classmethod
    def for_stack(cls, setting: Setting) -> "SlipObserver":
        """As a part of the identification stack."""
        part = cls(
            setting.parameters, setting.control_period, setting.data_sheet, setting.count,
            lateral=setting.lateral,
        )  # fmt: skip
        if setting.attitude:
            part.needs = (*cls.needs, *ATTITUDE)
        return part

    @property
    def constants(self) -> kinematics.Constants:
        """Numbers of the model, as the kernels take them."""
        return self._constants

    @property
    def rings(self) -> Any:
        """The ring as slots (N, K) of slip_kinematics.SLOT."""
        return rows_of(self.ring, SLOT)

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        super().reset(rows)
        every = np.arange(len(self.memory))
        which = every if rows is None else np.atleast_1d(every[np.asarray(rows)])
        forget(self.rows, which)

    def take_ground(
        self,
        soil: NDArray[np.float64],
        covariance: NDArray[np.float64],
        friction: NDArray[np.float64],
    ) -> None:
        """What is known of the ground, for outages: F_max [N] of a track and K [m] (N, 2), their
        covariance (N, 2, 2), mu_t (N,)."""
        take_ground_all(self.rows, self._constants, soil, covariance, friction)

    def compute(self, measurement: Measurement) -> Answer:
        """Take one sample; returns the bare answer: value, covariance, summary, status."""
        n = len(self.memory)
        answer = (
            np.empty((n, STATES)), np.empty((n, STATES, STATES)), np.empty((n, 4)),
            np.empty(n, dtype=np.int64),
        )  # fmt: skip
        samples = (*measurement, attitude_of(measurement))
        self._advance(samples, answer)
        return answer

    def estimate(self, answer: Answer) -> Estimate:
        """The bare answer as an Estimate."""
        return estimate_of(self.names, answer)

    def _advance(self, samples: tuple[Any, ...], answer: Answer) -> None:
        """The filter itself: writes its results into the answer."""
        update_all(samples, self._constants, self.rows, self.rings, answer)

    def motion_rows(self) -> NDArray[np.float64]:
        """The columns of a Motion, (N, 6)."""
        columns = np.empty((len(self.memory), 6))
        motion_all(self.rows, self._constants, columns)
        return columns

    def motion(self) -> Motion:
        """Filtered pose; velocities by the model from the last belt speeds and the slips."""
        return Motion(*self.motion_rows().T)

    @property
    def slips(self) -> NDArray[np.float64]:
        """(N, 2) i_L, i_R [-]."""
        return self.slips_and_variances()[0]

    @property
    def slip_variances(self) -> NDArray[np.float64]:
        """(N, 2) variances of i_L, i_R [-]."""
        return self.slips_and_variances()[1]

    def slips_and_variances(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """`slips` and `slip_variances`."""
        count = len(self.memory)
        slips, variances = np.empty((count, 2)), np.empty((count, 2))
        read_slips(self.rows, self._constants, slips, variances)
        return slips, variances
