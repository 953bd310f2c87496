"""Scaled unscented transform over six states for a batch of vehicles, and the loop that uses it.

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

import numpy as np

from baselines.estimators import slip_covariance, slip_kinematics
from baselines.estimators import slip_step as step
from baselines.estimators.slip_kinematics import ROWS, STATES
from tracked_env.physics.jit import formula, loop

SPREAD = 0.6  # [-] alpha of the unscented transform
BETA = 2.0  # [-] best for a Gaussian
POINTS = 2 * STATES + 1

_SCALE = SPREAD * SPREAD * STATES  # n + L
_C = 0.5 / _SCALE  # weight of every point but the first
_C0 = 1.0 - STATES / _SCALE + (1.0 - SPREAD * SPREAD + BETA)  # first weight of a covariance


@loop
def draw(x, p, root, points):
    """Sigma points (STATES, POINTS) of (x, P)."""
    slip_covariance.factorise(p, root, STATES, _SCALE)
    for a in range(STATES):
        for j in range(POINTS):
            points[a, j] = x[a]
        for m in range(a + 1):
            points[a, 1 + m] = x[a] + root[a, m]
            points[a, 1 + STATES + m] = x[a] - root[a, m]


@loop
def predict(x, p, u, k, root, points, images):
    """(x, P) one step later, without Q. images (>= 3, POINTS) is scratch."""
    draw(x, p, root, points)
    for j in range(POINTS):
        images[0, j], images[1, j], images[2, j] = slip_kinematics.process(
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
def compare(x, p, z, noise, u, way, gyro, k, root, points, images, s, w, e):
    """Innovation of z in units of its sigma, e = M^-1 y, and W = M^-1 C^T (ROWS, STATES).

    Returns (NIS of the pose rows, NIS of all rows).
    """
    rows = int(k.rows)
    draw(x, p, root, points)
    for j in range(POINTS):
        (
            images[0, j], images[1, j], images[2, j], images[3, j], images[4, j], images[5, j],
        ) = slip_kinematics.measured(
            points[0, j], points[1, j], points[2, j],
            points[3, j], points[4, j], points[5, j], u, way, gyro, k,
        )  # fmt: skip
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
    slip_covariance.factorise(s, root, rows, 1.0)
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
def update_all(
    values, fresh, age, attitude, k, slots, memory, value, covariance, summary, status
):  # fmt: skip
    """One step of all vehicles: summary (N, 4) excitation, condition, NIS, skipped."""
    root, s, w = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    points, images = np.empty((STATES, POINTS)), np.empty((ROWS, POINTS))
    noise, z, e = np.empty((6, 6)), np.empty(6), np.empty(6)
    for i in range(memory.shape[0]):
        x, p = value[i], covariance[i]
        step.load(memory, i, x, p)
        u = step.take_drive(memory, i, values, fresh, attitude, x, p, k)
        started = memory[i, step.STARTED] > 0.0
        yaw = x[2]
        if started:
            slip_covariance.fill_process_noise(noise, yaw, u, k)
            predict(x, p, u, k, root, points, images)
            yaw = 0.5 * (yaw + x[2])
            for a in range(STATES):
                for b in range(a, STATES):
                    p[a, b] += noise[a, b]
        step.reckon(memory, i, slots, yaw, u, k)
        outcome, used, nis = 1, False, math.nan
        new, usable = step.has_pose(values, fresh, i)
        if new and not usable:
            memory[i, step.SKIPPED] += 1.0
            outcome = 2
        if step.is_blind(memory, i, k) and not (new and usable):
            way, gyro = step.take_motion(memory, i, values, fresh, x, p, u, k, z, noise)
            compare(x, p, z, noise, u, way, gyro, k, root, points, images, s, w, e)
            _correct(x, p, ROWS, w, e)
        elif new and usable:
            way, gyro = step.take_pose(memory, i, slots, values, fresh, age, x, u, k, z, noise)
            if not started:
                step.start(memory, i, values, x, p, z, noise, way, k)
            else:
                pose_nis, nis = compare(
                    x, p, z, noise, u, way, gyro, k, root, points, images, s, w, e
                )
                verdict = step.innovation_verdict(memory, i, nis, k)
                used = verdict != 1
                if verdict == 1:
                    outcome = 2
                elif verdict == 2:
                    east, north, turn = z[0] - x[0], z[1] - x[1], z[2] - x[2]
                    slip_covariance.inflate(p, east, north, turn, pose_nis, nis, k)
                    compare(x, p, z, noise, u, way, gyro, k, root, points, images, s, w, e)
                if used:
                    _correct(x, p, int(k.rows), w, e)
        summary[i, 0], summary[i, 1], status[i] = step.finish(
            memory, i, x, p, root, u, used, outcome, k
        )
        summary[i, 2] = nis
        summary[i, 3] = memory[i, step.SKIPPED]
