"""One leg of a plan: from a pose to a pose, by any method, forwards or in reverse.

In reverse. A vehicle in reverse is one that drives forwards with its ends exchanged: turned by pi,
with the left track for the right one and sprockets that run the other way. Slip is mirrored with
it, as the tracks are symmetric from front to back: p -> -p, v_x -> -v_x, v_y -> -v_y at the same q
and w. So a plan in reverse is the forward plan from the turned start to the turned goal, exactly.
Changes of gear are those of Reeds-Shepp paths, of RADII times the radius at which the belts can
turn: their cusps are poses that legs in alternating gears join, each a plan of least time that ends
at rest, if the limits say how to brake. The cusps are not optimized further.
"""

import math
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from baselines.planners import speed_along_path
from baselines.planners.curves import clothoid, dubins, reeds_shepp
from baselines.planners.least_time import RADIUS, optimal
from baselines.planners.plan_on_slopes import Ground, Terrain, plan_on_terrain
from baselines.planners.speed_along_path import Path, SpeedProfile, TimedPath, places, sampled
from baselines.planners.trajectory import SAMPLED, Limits, Start, Trajectory
from baselines.slip.slip_models import SlipModel
from tracked_env.physics.parameters import PlantParameters

Array = NDArray[np.float64]

LONGEST = 3.0  # [-] times the Dubins path: a longer clothoid is not driven
RADII = 1.0, 2.0  # [-] of the least radius: of the Reeds-Shepp paths that are tried
SHORTEST = 1e-6  # [m] of a leg


def arc_radius(limits: Limits, vehicle: PlantParameters) -> float:
    """Least turning radius [m] of arcs at v_max. Raises ValueError where the limits allow none."""
    bend = limits.curvature_at(limits.v_max, vehicle)
    if bend <= 0.0:
        belt = vehicle.sprocket_radius * limits.sprocket_used
        raise ValueError(
            f"limits v_max = {limits.v_max:g} m/s; must be below {belt:g} m/s for any turn, the "
            f"belts at {limits.sprocket_used:g} rad/s. Is the reserve too large?"
        )
    return 1.0 / bend


def _clothoid(
    pose: tuple[float, float, float], goal: Array, limits: Limits, vehicle: PlantParameters
) -> Path:
    """The clothoid. Raises ValueError where it is not driven."""
    path = clothoid(pose, goal).path()
    bend, way = path.largest_curvature, path.whole_length
    if bend > limits.curvature:
        raise ValueError(f"the clothoid bends by {bend:.3g} of {limits.curvature:.3g} 1/m")
    allowed = float(speed_along_path.bound_speed(np.array([bend]), limits, vehicle)[0])
    if allowed < limits.v_min * (1.0 - 1e-12):
        raise ValueError(f"the clothoid allows {allowed:.3g} m/s of {limits.v_min:.3g} at least")
    shortest = float(dubins(pose, goal, arc_radius(limits, vehicle)).length[0])
    if way > LONGEST * max(shortest, math.hypot(*(goal[:2] - pose[:2]))):
        raise ValueError(f"the clothoid is {way:.3g} m long, Dubins' {shortest:.3g} m")
    return path


def timed_path(
    start: Start, goal: Array, limits: Limits, vehicle: PlantParameters, method: str
) -> TimedPath:
    """A path of `method`, any but "optimal", with its speed. Raises ValueError as `plan`."""
    message = ""
    if method == "clothoid":
        try:
            path = _clothoid(start[:3], goal, limits, vehicle)
        except ValueError as error:
            message, method = f"Dubins path instead: {error}", "dubins"
    if method != "clothoid":
        curve = reeds_shepp if method == "reeds-shepp" else dubins
        path = curve(start[:3], goal, arc_radius(limits, vehicle)).path()
    return TimedPath(path, _profile(path, start, limits, vehicle), method, message)


def _profile(path: Path, start: Start, limits: Limits, vehicle: PlantParameters) -> SpeedProfile:
    """The speed along a path."""
    if limits.fixed:
        return speed_along_path.constant(path, limits.v_max)
    return speed_along_path.fastest(path, limits, vehicle, max(start.speed, 0.0))


class Planner(NamedTuple):
    """One way to plan a leg, to be called with a start and a goal."""

    limits: Limits
    vehicle: PlantParameters
    slip_model: SlipModel | None
    method: str
    period: float  # [s] between samples
    intervals: int
    reverse: bool
    ground: Ground | None

    @property
    def brakes(self) -> bool:
        """Whether the optimal planner can end at rest: speed and its rate of change have limits."""
        return not self.limits.fixed and math.isfinite(self.limits.sprocket_acceleration)

    @property
    def fastest(self) -> tuple[float, float]:
        """Speed [m/s] and yaw rate [rad/s] that the limits allow."""
        belt = self.vehicle.sprocket_radius * self.limits.sprocket_used
        return self.limits.v_max, 2.0 * belt / self.vehicle.track_gauge

    @property
    def jumps(self) -> bool:
        """Whether belts would have to jump at a change of gear, and must not."""
        return self.limits.fixed and math.isfinite(self.limits.sprocket_acceleration)

    @property
    def gears(self) -> int:
        """In which a route may be driven: 1: forwards, 2: both, 0: both, but without a change."""
        if self.method == "reeds-shepp":
            return 2
        return (0 if self.jumps else 2) if self.reverse else 1

    @property
    def turns_on_the_spot(self) -> bool:
        """Whether a leg may."""
        slow = self.limits.v_min == 0.0 and math.isinf(self.limits.curvature)
        return self.method == "optimal" and slow

    def __call__(self, start: Start, goal: Array, last: bool = True, gear: int = 0) -> Trajectory:
        """One trajectory to a goal (3,); last: to rest there, if the limits say how to brake.

        gear: of the optimal planner, 1 forwards, -1 in reverse, 0 the cheapest that is allowed.
        """
        if self.method != "optimal":
            timed = timed_path(start, goal, self.limits, self.vehicle, self.method)
            return self._sampled(timed, goal)
        level = {0: self._cheapest, 1: self._forwards, -1: self._backwards}[gear]
        if self.ground is None:
            return level(start, goal, last)
        terrain = Terrain.of(self.ground, self.slip_model, self.vehicle)
        return plan_on_terrain(level, start, goal, last, terrain)

    def _sampled(self, timed: TimedPath, goal: Array) -> Trajectory:
        return sampled(timed, goal, self.limits, self.vehicle, self.slip_model, self.period)

    @property
    def follows(self) -> bool:
        """Whether it can drive arcs and lines, where belts jump."""
        free = math.isinf(self.limits.sprocket_acceleration) and self.ground is None
        return self.method != "optimal" or free

    def follow(self, start: Start, path: Path, goal: Array) -> Trajectory:
        """The trajectory along a path to a goal (3,)."""
        profile = _profile(path, start, self.limits, self.vehicle)
        both = bool(np.any(path.length < 0.0))
        method = "reeds-shepp" if both or self.method == "reeds-shepp" else "dubins"
        same = self.method in ("dubins", "reeds-shepp")
        message = "" if same else f"no free plan by '{self.method}': arcs and lines instead"
        return self._sampled(TimedPath(path, profile, method, message), goal)

    def _forwards(
        self, start: Start, goal: Array, last: bool, turning: float | None = None
    ) -> Trajectory:
        how: Any = {"intervals": self.intervals, "period": self.period, "turning": turning}
        world = self.limits, self.vehicle, self.slip_model
        plan: Any = optimal(start, goal, *world, stop=last and self.brakes, **how)
        return cast(Trajectory, plan)

    def _backwards(
        self, start: Start, goal: Array, last: bool, turning: float | None = None
    ) -> Trajectory:
        """The forward plan of the vehicle whose front is the back of this one."""
        x, y, yaw, speed, yaw_rate, left, right = start
        sides = (None if side is None else -side for side in (right, left))
        begin = Start(x, y, yaw + math.pi, -speed, yaw_rate, *sides)
        plan = self._forwards(begin, goal + np.array([0.0, 0.0, math.pi]), last, turning)
        turned: Any = {"yaw": plan.yaw - math.pi, "course": plan.course - math.pi}
        turned |= {"speed": -plan.speed, "acceleration": -plan.acceleration}
        turned |= {"sprocket_left": -plan.sprocket_right, "sprocket_right": -plan.sprocket_left}
        return plan._replace(**turned)

    def _cheapest(
        self, start: Start, goal: Array, last: bool, turning: float | None = None
    ) -> Trajectory:
        """The optimal plan of least cost among one gear and changes between both, if allowed.

        The plan forwards is returned where none converged.
        """
        if not self.reverse:
            return self._forwards(start, goal, last, turning)
        plans = [self._forwards(start, goal, last), self._backwards(start, goal, last)]
        # At constant speed the belts would jump where the gear changes.
        least = max(arc_radius(self.limits, self.vehicle), RADIUS * self.vehicle.track_gauge)
        for share in () if self.jumps else RADII:
            plans += self._from_cusp_to_cusp(start, goal, share * least, last)
        return min((p for p in plans if p.converged), key=lambda p: p.cost, default=plans[0])

    def _from_cusp_to_cusp(
        self, start: Start, goal: Array, radius: float, last: bool
    ) -> list[Trajectory]:
        """The plan by way of the cusps of the Reeds-Shepp path; none where it has no cusp."""
        path = reeds_shepp(start[:3], goal, radius).path()
        cusps = np.flatnonzero(np.diff(np.sign(path.length)))
        if not len(cusps):
            return []
        at = places(path, np.cumsum(np.abs(path.length))[cusps])
        targets = [*np.stack([at.x, at.y, at.yaw], axis=1), goal]
        gears = np.sign(path.length)[[*cusps, -1]]
        legs: list[Trajectory] = []
        begin = start
        for target, gear in zip(targets, gears, strict=True):
            if math.hypot(target[0] - begin.x, target[1] - begin.y) < SHORTEST:
                continue
            drive = self._forwards if gear > 0.0 else self._backwards
            legs.append(drive(begin, target, last or target is not goal))
            if not legs[-1].converged:
                break
            begin = end_of(legs[-1])
        return [concatenated(legs)] if legs else []


def end_of(plan: Trajectory) -> Start:
    """Pose and motion at the end of a trajectory."""
    last = {name: float(getattr(plan, name)[-1]) for name in Trajectory._fields[:SAMPLED]}
    last["speed"] *= math.cos(last["course"] - last["yaw"])
    return Start(**{name: last[name] for name in Start._fields})


def concatenated(legs: list[Trajectory]) -> Trajectory:
    """Legs one after the other; the end errors are those of the last.

    Where two meet, the sample is the first one of the later leg, whose speeds hold from there on.
    """
    if len(legs) == 1:
        return legs[0]
    samples, shift = np.array(legs[0][:SAMPLED]), np.zeros((SAMPLED, 1))
    for leg in legs[1:]:
        turned = samples[3, -1] - leg.yaw[0]
        shift[0] = samples[0, -1]  # time, and yaw and course by whole turns
        shift[3:5] = 2.0 * math.pi * round(turned / (2.0 * math.pi))
        samples = np.hstack([samples[:, :-1], np.array(leg[:SAMPLED]) + shift])
    whole: Any = dict(zip(Trajectory._fields, samples, strict=False))
    whole |= {name: sum(getattr(leg, name) for leg in legs) for name in ("cost", "iterations")}
    whole["converged"] = all(leg.converged for leg in legs)
    notes = (f"leg {i}: {leg.message}" for i, leg in enumerate(legs, 1) if leg.message)
    return legs[-1]._replace(**whole, message="; ".join(notes))
