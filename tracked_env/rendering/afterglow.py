"""What a picture shows of the time before it: the driven trail, the belts, the latest changes.

It is filled by the pictures themselves: what happened before the first of them is not known.
"""

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics import parameter_events
from tracked_env.physics.parameters import PARAMETER_NAMES
from tracked_env.rendering.quantities import QUANTITIES
from tracked_env.rendering.snapshot import Snapshot
from tracked_env.rendering.soil_map import value_at

TRAIL_STEP = 0.015  # [contact lengths] between points of the trail
TRAIL_LIMIT = 8192  # [-] points kept; beyond it every second one goes
NOTICE_DURATION = 3.0  # [s] a change stays on the screen after it has ended
NOTICE_WEIGHT = 0.01  # [-] smaller changes of an event's weight are not noticed


class Memory:
    """What has been seen of one episode."""

    def __init__(self, shot: Snapshot) -> None:
        """Start with the first picture of an episode."""
        self._time = shot.time
        self._points = np.empty((TRAIL_LIMIT, 2))
        self._points[0] = shot.state.x, shot.state.y
        self._count = 1
        self.travel = [0.0, 0.0]  # [m] of the left and the right belt
        self._weights = [self._change(shot, e)[2] for e in range(shot.events.shape[1])]
        self._notices: dict[int, tuple[float, str]] = {}

    @property
    def trail(self) -> NDArray[np.float64]:
        """Where the vehicle was, (P, 2) [m], world frame, oldest first."""
        return self._points[: self._count]

    def update(self, shot: Snapshot) -> None:
        """Take in the next picture of the episode."""
        elapsed, self._time = shot.time - self._time, shot.time
        speeds = shot.state.sprocket_speed_left, shot.state.sprocket_speed_right
        for side, speed in enumerate(speeds):
            self.travel[side] += elapsed * speed * shot.parameters.sprocket_radius
        here = np.array([shot.state.x, shot.state.y])
        if np.abs(here - self._points[self._count - 1]).sum() >= TRAIL_STEP * shot.sizes.length:
            if self._count == TRAIL_LIMIT:
                self._count //= 2
                self._points[: self._count] = self._points[::2]
            self._points[self._count] = here
            self._count += 1
        for e in range(shot.events.shape[1]):
            self._watch(shot, e)

    def notices(self) -> list[str]:
        """What has changed lately, a line for each event."""
        return [
            line for since, line in self._notices.values() if self._time - since < NOTICE_DURATION
        ]

    @staticmethod
    def _change(shot: Snapshot, e: int) -> tuple[str, float, float]:
        """Parameter of event e, its value without the event, and the event's weight in [0, 1]."""
        _, parameter, target = shot.events[0, e, :3]
        name = PARAMETER_NAMES[int(parameter)]
        before, after = (
            value_at(shot, count, name, shot.time, shot.state.x, shot.state.y)
            for count in (e, e + 1)
        )
        return name, before, (after - before) / (target - before) if target != before else 0.0

    def _watch(self, shot: Snapshot, e: int) -> None:
        """Note when event e acts. A wave acts everywhere, always: it is not news."""
        if shot.events[0, e, 0] == parameter_events.WAVE:
            return
        name, before, weight = self._change(shot, e)
        if name not in shot.reads:
            return
        change = weight - self._weights[e]
        if abs(change) < NOTICE_WEIGHT:
            return
        self._weights[e] = weight
        quantity = QUANTITIES[name]
        usual = getattr(shot.nominal, name)
        numbers = [quantity.number(x, usual) for x in (before, float(shot.events[0, e, 2]))]
        first, last = numbers if change > 0.0 else numbers[::-1]
        self._notices[e] = shot.time, f"{quantity.label}: {first} → {last} {quantity.unit}".rstrip()
