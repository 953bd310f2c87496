"""A path in the plane as pieces whose curvature is linear in the way along them.

    k(s) = k_0 + k' s        yaw(s) = yaw_0 + k_0 s + k' s^2 / 2
A piece is driven forwards or in reverse; s is the signed way along it, so that yaw' = k s' holds in
both directions. Straight lines and arcs are evaluated in closed form, clothoids by Gauss-Legendre
quadrature on as many parts as their turning needs.

Frame: world, SI units; yaw is continuous.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.physics.jit import copy_entries, formula, loop

Array = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
PART = 3.0  # [rad] of turning a part of the quadrature at most


class Path(NamedTuple):
    """A path of P pieces from a pose."""

    start: Array  # (3,) x, y [m], yaw [rad]
    length: Array  # [m] (P,) of each piece, signed: negative in reverse
    curvature: Array  # [1/m] (P,) at the beginning of the piece, positive to the left
    sharpness: Array  # [1/m^2] (P,) k', over the signed way

    @classmethod
    def of(
        cls, start: ArrayLike, length: Sequence[float] | Array,
        curvature: Sequence[float] | Array, sharpness: Sequence[float] | Array | None = None,
    ) -> "Path":  # fmt: skip
        """A path without the pieces that have no length."""
        lengths, curvatures = np.asarray(length, dtype=float), np.asarray(curvature, dtype=float)
        changes = (
            np.zeros_like(lengths) if sharpness is None else np.asarray(sharpness, dtype=float)
        )
        kept = np.abs(lengths) > 0.0
        begin = np.array(start, dtype=np.float64)
        return cls(begin, lengths[kept], curvatures[kept], changes[kept])

    @property
    def whole_length(self) -> float:
        """Way along all pieces [m], in reverse too."""
        return float(np.sum(np.abs(self.length)))

    @property
    def largest_curvature(self) -> float:
        """Largest |k| [1/m]; 0 for a path without pieces."""
        ends = np.abs([self.curvature, self.curvature + self.sharpness * self.length])
        return float(np.max(ends, initial=0.0))


class Place(NamedTuple):
    """A path at M distances, each field (M,)."""

    x: Array  # [m]
    y: Array  # [m]
    yaw: Array  # [rad]
    curvature: Array  # [1/m]
    sharpness: Array  # [1/m^2] over the signed way
    gear: Array  # [-] 1 forwards, -1 in reverse


@formula
def along(way, curvature, sharpness, yaw):
    """Displacement (x, y) [m] after the signed way [m] from a point with that yaw [rad]."""
    turned = (curvature + 0.5 * sharpness * way) * way
    if sharpness == 0.0:
        half = 0.5 * turned
        chord = way * (1.0 - half * half / 6.0) if abs(half) < 1e-4 else way * math.sin(half) / half
        return chord * math.cos(yaw + half), chord * math.sin(yaw + half)
    parts = 1 + int((abs(curvature * way) + abs(sharpness) * way * way) / PART)
    x, y, width = 0.0, 0.0, way / parts
    for part in range(parts):
        for node in range(len(_NODES)):
            s = width * (part + 0.5 * (_NODES[node] + 1.0))
            angle = yaw + (curvature + 0.5 * sharpness * s) * s
            x += 0.5 * width * _WEIGHTS[node] * math.cos(angle)
            y += 0.5 * width * _WEIGHTS[node] * math.sin(angle)
    return x, y


@loop
def _places(start, length, curvature, sharpness, distances, out):
    """Rows x, y, yaw, curvature, sharpness, gear at sorted distances [m] along the path."""
    x, y, yaw = start[0], start[1], start[2]
    piece, begun = 0, 0.0
    for i in range(len(distances)):
        while piece < len(length) - 1 and distances[i] > begun + abs(length[piece]):
            way = length[piece]
            step_x, step_y = along(way, curvature[piece], sharpness[piece], yaw)
            x, y = x + step_x, y + step_y
            yaw += (curvature[piece] + 0.5 * sharpness[piece] * way) * way
            begun += abs(way)
            piece += 1
        gear = math.copysign(1.0, length[piece])
        way = gear * min(distances[i] - begun, abs(length[piece]))
        step_x, step_y = along(way, curvature[piece], sharpness[piece], yaw)
        out[0, i], out[1, i] = x + step_x, y + step_y
        out[2, i] = yaw + (curvature[piece] + 0.5 * sharpness[piece] * way) * way
        out[3, i] = curvature[piece] + sharpness[piece] * way
        out[4, i], out[5, i] = sharpness[piece], gear


def places(path: Path, distances: ArrayLike) -> Place:
    """The path at sorted distances (M,) [m] from its start, counted forwards in either gear."""
    ways = np.ascontiguousarray(distances, dtype=np.float64)
    out = np.zeros((len(Place._fields), len(ways)))
    if len(path.length):
        _places(*path, ways, out)
    else:
        out[:3], out[5] = path.start[:, None], 1.0
    return Place(*out)


@loop
def _integrated(start, length, curvature, sharpness, steps, pose):
    """The pose at the end by Runge-Kutta's method of order 4 on yaw' = k, x' = cos, y' = sin."""
    copy_entries(start, pose)
    for piece in range(len(length)):
        step = length[piece] / steps
        for i in range(steps):
            k = curvature[piece] + sharpness[piece] * step * i
            middle = pose[2] + 0.5 * step * (k + 0.25 * sharpness[piece] * step)
            last = pose[2] + step * (k + 0.5 * sharpness[piece] * step)
            pose[0] += step / 6.0 * (math.cos(pose[2]) + 4.0 * math.cos(middle) + math.cos(last))
            pose[1] += step / 6.0 * (math.sin(pose[2]) + 4.0 * math.sin(middle) + math.sin(last))
            pose[2] = last


def end_errors(path: Path, goal: ArrayLike, steps: int = 200) -> tuple[float, float]:
    """(distance [m], yaw [rad]) from the goal after integrating the path numerically."""
    pose = np.empty(3)
    _integrated(*path, steps, pose)
    away = np.asarray(goal, dtype=np.float64) - pose
    return math.hypot(away[0], away[1]), abs(math.remainder(float(away[2]), 2.0 * math.pi))
