"""What a controller follows of a planned trajectory, at any time: its course, or its body.

    "course"  x, y, chi, V, chi' and V', chi'': a unicycle on the path of the centre. For a
              controller that compensates slip (slc): it adds beta and alpha itself
    "body"    x, y, yaw of the vehicle, and the speeds of the belts
              v_b = r (omega_L + omega_R) / 2    w_b = r (omega_R - omega_L) / B
              For a controller that repeats the planned sprocket speeds (uc): slip is in the pose
Belt speeds with the pose given to slc count slip twice; the course given to uc leaves it out.

Held inputs. An optimal plan holds its belt speeds over intervals: its yaw is continuous, but alpha,
and with it chi = yaw + alpha, jumps between intervals, as no vehicle's course does. Here alpha is
the planned one in the middle of each interval and linear in between, so that chi is continuous and
chi' = w + alpha' is its derivative, constant on half intervals. V and w are held as planned; V' and
chi'' are the slopes between the middles. x, y are the planned ones: V exp(i chi) stays within a
millimetre of them.
After its end a plan stands at the goal, with the vehicle's yaw in both frames: without speed a
vehicle has no course.
Frame: world, SI units; angles are continuous, not wrapped.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), (35), sections 6 and 7.2; the code of F gives both controllers the pose and v_b,
w_b.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.trajectory import Trajectory
from tracked_env.physics.parameters import PlantParameters
from tracked_env.validation import checked_choice

Array = NDArray[np.float64]
Index = NDArray[np.integer]

FRAMES = ("course", "body")
STRAIGHT = 1e-6  # [rad] arcs that turn less are straight


class Followed(NamedTuple):
    """A trajectory at T times in one frame, each field (T,)."""

    x: Array  # [m]
    y: Array  # [m]
    yaw: Array  # [rad] course, or yaw of the vehicle
    speed: Array  # [m/s] over the ground along the course, or of the belts
    acceleration: Array  # [m/s^2] its derivative
    yaw_rate: Array  # [rad/s] of the course, or of the belts
    yaw_acceleration: Array  # [rad/s^2] its derivative


def hand_over(
    trajectory: Trajectory, times: ArrayLike, vehicle: PlantParameters, frame: str = "course"
) -> Followed:
    """A trajectory at `times` (T,) [s] from its beginning, as a controller follows it.

    frame: one of FRAMES. Raises ValueError for another one and for times that are negative or not
    finite.
    """
    checked_choice("frame", frame, FRAMES)
    at = np.atleast_1d(np.asarray(times, dtype=np.float64))
    if at.ndim != 1 or not np.isfinite(at).all() or np.min(at, initial=0.0) < 0.0:
        raise ValueError(f"times = {times!r} s; must be (T,), finite and >= 0. Are they absolute?")
    over = at >= trajectory.duration
    if len(trajectory.time) == 1 or over.all():
        return _standing(trajectory, at)
    part = np.searchsorted(trajectory.time, at, side="right") - 1
    part = np.clip(part, 0, len(trajectory.time) - 2)
    held = trajectory.method == "optimal"
    x, y = _places(trajectory, part, at, held)
    if frame == "course":
        rest = _course(trajectory, part, at, held)
    else:
        rest = _body(trajectory, part, at, vehicle, held)
    still = _standing(trajectory, at)
    moving = (x, y, *rest)
    return Followed(*(np.where(over, s, m) for s, m in zip(still, moving, strict=True)))


def _standing(trajectory: Trajectory, times: Array) -> Followed:
    """At the goal."""
    pose = (np.full(len(times), float(v[-1])) for v in trajectory[1:4])
    return Followed(*pose, *(np.zeros(len(times)) for _ in range(4)))


def _between(values: Array, t: Trajectory, part: Index, at: Array) -> Array:
    """Linear between samples."""
    share = (at - t.time[part]) / (t.time[part + 1] - t.time[part])
    return np.asarray(values[part] + share * (values[part + 1] - values[part]))


def _places(t: Trajectory, part: Index, at: Array, held: bool) -> tuple[Array, Array]:
    """x, y on the arcs between samples, whose ends are the samples."""
    turned = np.diff(t.yaw if held else t.course)[part]
    since, step = at - t.time[part], (t.time[part + 1] - t.time[part])
    gain = np.zeros(len(at)) if held else t.acceleration[part]
    way, whole = ((t.speed[part] + 0.5 * gain * d) * d for d in (since, step))
    share = np.where(np.abs(whole) > 0.0, way / np.where(whole == 0.0, 1.0, whole), since / step)
    bent = np.abs(turned) > STRAIGHT
    angle = np.where(bent, turned, 1.0)
    chord = np.expm1(1j * angle * share) / np.expm1(1j * angle)
    place = t.x + 1j * t.y
    found = place[part] + np.diff(place)[part] * np.where(bent, chord, share)
    return found.real, found.imag


class Intervals(NamedTuple):
    """The K intervals of a plan on which its inputs are held."""

    of: Index  # (M,) the interval in which, or with which, a sample begins
    first: Index  # (K,) sample at its beginning
    middle: Array  # [s] (K,)


def held_intervals(t: Trajectory) -> Intervals:
    """Intervals of equal sprocket speeds."""
    left, right = t.sprocket_left[:-1], t.sprocket_right[:-1]
    new = np.append(True, (np.diff(left) != 0.0) | (np.diff(right) != 0.0))
    first = np.flatnonzero(new)
    ends = np.append(t.time[first], t.time[-1])
    of = np.append(np.cumsum(new), np.sum(new)) - 1
    return Intervals(of, first, 0.5 * (ends[1:] + ends[:-1]))


def _course(t: Trajectory, part: Index, at: Array, held: bool) -> tuple[Array, ...]:
    """chi, V, V', chi', chi''."""
    if not held:
        names = ("course", "speed", "acceleration", "course_rate", "course_acceleration")
        return tuple(_between(getattr(t, name), t, part, at) for name in names)
    parts = held_intervals(t)
    k = parts.of[part]
    since = at - parts.middle[k]
    alpha, turn, speed = (v[parts.first] for v in (t.course - t.yaw, t.yaw_rate, t.speed))
    rate = _slopes(alpha, parts, k, since)
    course = _between(t.yaw, t, part, at) + alpha[k] + rate * since
    bend = _slopes(turn, parts, k, since)
    return course, speed[k], _slopes(speed, parts, k, since), turn[k] + rate, bend


def _body(
    t: Trajectory, part: Index, at: Array, vehicle: PlantParameters, held: bool
) -> tuple[Array, ...]:
    """yaw, v_b, v_b', w_b, w_b'."""
    radius = vehicle.sprocket_radius
    speed = 0.5 * radius * (t.sprocket_left + t.sprocket_right)
    turn = radius * (t.sprocket_right - t.sprocket_left) / vehicle.track_gauge
    yaw = _between(t.yaw, t, part, at)
    if not held:
        rates = (np.gradient(values, t.time) for values in (speed, turn))
        given = [_between(values, t, part, at) for values in (speed, *rates, turn)]
        return yaw, given[0], given[1], given[3], given[2]
    parts = held_intervals(t)
    k = parts.of[part]
    speed, turn = speed[parts.first], turn[parts.first]
    slopes = [_slopes(values, parts, k, at - parts.middle[k]) for values in (speed, turn)]
    return yaw, speed[k], slopes[0], turn[k], slopes[1]


def _slopes(values: Array, parts: Intervals, k: Index, since: Array) -> Array:
    """Slope of held values (K,) between the middles of intervals; since [s]: middle of k."""
    if len(values) < 2:
        return np.zeros(len(k))
    slope = np.diff(values) / np.diff(parts.middle)
    return np.asarray(slope[np.clip(np.where(since < 0.0, k - 1, k), 0, len(slope) - 1)])
