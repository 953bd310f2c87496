"""A smooth path through way-points at constant speed, as a profile of speed and yaw rate.

The path is the quintic spline through the points over the chord length (C4), straight at
both ends (curvature and its derivative are zero there), so that what comes before and after
can be straight. With s = v t the arc length, r(u) the spline and ' = d/du:
    kappa = (x' y'' - y' x'') / |r'|^3,  w = v kappa,  dw/dt = v^2 kappa' / |r'|
Per segment of time the polynomial w has six conditions: w and dw/dt at both ends, the exact
change of heading, and the exact mean heading. So the heading has no drift at all, and the
position none to first order; w is C1, hence the path C3.

References: [1] de Boor, A Practical Guide to Splines, ch. XIII.
"""

from functools import lru_cache
from typing import Any

import numpy as np

from tracked_env.physics.reference_profile import SEGMENT_DURATION
from tracked_env.references.profile import (
    FloatArray,
    ReferenceProfile,
    constant,
    derivative_row,
    number_of_segments,
    sample,
)

PASSING_TOLERANCE = 1e-3  # [m] to each way-point
PANELS = 4  # [-] quadrature panels between two way-points
NEWTON_STEPS = 4  # [-] for the inverse of the arc length; quadratic from 1e-2

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS  # on [0, 1]
_CONDITIONS = [derivative_row(t, order) for order in (0, 1) for t in (0.0, SEGMENT_DURATION)]
_CONDITIONS += [derivative_row(SEGMENT_DURATION, order) for order in (-1, -2)]
_FIT = np.linalg.inv(np.array(_CONDITIONS)).T  # (6, 6): conditions @ this


class _Path:
    """The spline through points (M, 2) with its arc length; beyond its end it is straight."""

    def __init__(self, points: FloatArray) -> None:
        from scipy.interpolate import make_interp_spline  # 0.4 s to import: only when used

        chords = np.hypot(*np.diff(points, axis=0).T)
        knots = np.concatenate([[0.0], np.cumsum(chords)])
        straight_end = [(2, np.zeros(2)), (3, np.zeros(2))]
        ends: Any = (straight_end, straight_end)  # the stubs know the named conditions only
        spline = make_interp_spline(knots, points, k=5, bc_type=ends)
        self._first, self._second, self._third = (spline.derivative(n) for n in (1, 2, 3))
        fractions = np.arange(PANELS) / PANELS
        panels = (knots[:-1, None] + chords[:, None] * fractions).ravel()
        self._panels = np.append(panels, knots[-1])
        lengths = self._length(self._panels[:-1], np.diff(self._panels))
        self._arc = np.concatenate([[0.0], np.cumsum(lengths)])
        self.arc_of_points = self._arc[::PANELS]

    def _length(self, start: FloatArray, extent: FloatArray) -> FloatArray:
        """Arc length [m] from parameter `start` over `extent`, both (n,)."""
        tangent = self._first(start[:, None] + extent[:, None] * _NODES)
        return extent * (np.hypot(tangent[..., 0], tangent[..., 1]) @ _WEIGHTS)

    def parameter(self, arc: FloatArray) -> FloatArray:
        """Return u with s(u) = arc [m] (n,), limited to the path."""
        arc = np.minimum(arc, self._arc[-1])
        panel = np.clip(np.searchsorted(self._arc, arc, "right") - 1, 0, len(self._arc) - 2)
        start, base = self._panels[panel], self._arc[panel]
        width = self._panels[panel + 1] - start
        extent = width * (arc - base) / (self._arc[panel + 1] - base)
        for _ in range(NEWTON_STEPS):
            tangent = self._first(start + extent)
            missing = arc - base - self._length(start, extent)
            extent = np.clip(extent + missing / np.hypot(*tangent.T), 0.0, width)
        return start + extent

    def heading(self, u: FloatArray) -> FloatArray:
        """Heading [rad] at sorted u (n,), unwrapped."""
        tangent = self._first(u)
        return np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))

    def curvature(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Curvature [1/m] and its derivative by the arc length [1/m^2] at u (n,)."""
        (x1, y1), (x2, y2), (x3, y3) = self._first(u).T, self._second(u).T, self._third(u).T
        tangent2 = x1 * x1 + y1 * y1
        tangent3 = tangent2 * np.sqrt(tangent2)
        kappa = (x1 * y2 - y1 * x2) / tangent3
        bend = (x1 * y3 - y1 * x3) / tangent3 - 3.0 * kappa * (x1 * x2 + y1 * y2) / tangent2
        return kappa, bend / np.sqrt(tangent2)


@lru_cache(maxsize=64)
def _profile(points_bytes: bytes, speed: float, segments: int) -> ReferenceProfile:
    """Build the profile (10 ms); an episode that repeats the points finds it here."""
    points = np.frombuffer(points_bytes).reshape(-1, 2)
    path = _Path(points)
    starts = SEGMENT_DURATION * np.arange(segments + 1)
    # Per segment: its start and the quadrature nodes, in one sorted list of times.
    times = starts[:, None] + SEGMENT_DURATION * np.concatenate([[0.0], _NODES])
    u = path.parameter(speed * times.ravel())
    heading = path.heading(u).reshape(times.shape)
    kappa, bend = path.curvature(u.reshape(times.shape)[:, 0])
    w, dw = speed * kappa, speed**2 * bend
    turn = np.diff(heading[:, 0])
    mean = SEGMENT_DURATION * ((heading[:-1, 1:] - heading[:-1, :1]) @ _WEIGHTS)
    yaw_rate = np.stack([w[:-1], w[1:], dw[:-1], dw[1:], turn, mean], axis=1) @ _FIT
    (x, y), yaw = points[0].tolist(), float(heading[0, 0])
    profile = ReferenceProfile(constant(speed, segments), yaw_rate, x, y, yaw)
    _check_passing(profile, points, path.arc_of_points / speed)
    return profile


def _check_passing(profile: ReferenceProfile, points: FloatArray, times: FloatArray) -> None:
    """Raise ValueError unless the profile passes every way-point that it has time for."""
    reached = times <= len(profile.speed) * SEGMENT_DURATION
    samples = sample(profile, times[reached])
    miss = np.hypot(samples.x - points[reached, 0], samples.y - points[reached, 1])
    worst = int(miss.argmax())
    if not miss[worst] <= PASSING_TOLERANCE:
        raise ValueError(
            f"points: the path misses way-point {worst} by {miss[worst]:.2g} m; must be within "
            f"{PASSING_TOLERANCE} m. Its curvature changes too fast for {SEGMENT_DURATION} s "
            "segments: lower the speed, or spread or smooth the way-points."
        )


def waypoints(duration: float, points: FloatArray, speed: float = 2.0) -> ReferenceProfile:
    """Path through `points` (M, 2) [m], world frame, M >= 2, at `speed` [m/s] > 0.

    The start pose is the first point, along the path. A path longer than the profile is
    truncated by time; after the last point (at length / speed) the reference goes straight
    on at the same speed. Raises ValueError if a way-point were missed by more than 1 mm.
    """
    data = np.ascontiguousarray(points, dtype=np.float64).tobytes()
    kept = _profile(data, float(speed), number_of_segments(duration))
    return kept._replace(speed=kept.speed.copy(), yaw_rate=kept.yaw_rate.copy())
