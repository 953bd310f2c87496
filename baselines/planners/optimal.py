"""Draft."""

import math
import numpy as np
from typing import NamedTuple
from baselines.planners.dubins import SIGNS, SNAP, segments_of_words, relative
from baselines.planners import interior_point as ip
from baselines.planners import riccati
from baselines.planners.interval_limits import Bounds
from tracked_env.physics.jit import formula, loop


@formula
def _guess(segments, signs, radius, speed, half_gauge, belts):
    """Belt speeds of a Dubins path (3,) [m] at constant speed: means over equal intervals."""
    n = len(belts)
    total = segments[0] + segments[1] + segments[2]
    length = total / n
    for k in range(n):
        first, turn, begin = k * length, 0.0, 0.0
        for part in range(3):
            end = begin + segments[part]
            inside = min(end, first + length) - max(begin, first)
            turn += signs[part] * max(inside, 0.0)
            begin = end
        belts[k, 0] = speed
        belts[k, 1] = turn / length / radius * speed * half_gauge if length > 0.0 else 0.0
    return total / speed


@loop
def solve_all(starts, goals, surface, bounds, setting, before, out, belts, first, last):
    """Plans of rows first to last. out (B, 6): duration, cost, converged, iterations, turning, starts."""
    n = belts.shape[1]
    w, a = ip.make_work(n), riccati.make_stages(n)
    angles = np.empty((6, 3))
    totals = np.empty(6)
    radius, speed = setting.radius, setting.speed
    for row in range(first, last):
        x, y, phi = relative(starts, goals, row, radius)
        segments_of_words(x, y, phi, SNAP / max(1.0, radius), angles)
        for word in range(6):
            total = angles[word, 0] + angles[word, 1] + angles[word, 2]
            totals[word] = total * radius if total == total else math.inf
        out[row, 1] = math.inf
        out[row, 2] = 0.0
        out[row, 3] = 0.0
        out[row, 5] = 0.0
        shortest = totals.min()
        for _ in range(setting.starts):
            word = np.argmin(totals)
            if totals[word] == math.inf:
                break
            if out[row, 2] > 0.0 and totals[word] > setting.longer * shortest + setting.extra:
                break
            totals[word] = math.inf
            turning = 0.0
            for part in range(3):
                turning += SIGNS[word, part] * angles[word, part]
            task = ip.Task(
                starts[row, 2],
                goals[row, 0] - starts[row, 0],
                goals[row, 1] - starts[row, 1],
                turning,
                before[row, 0],
                before[row, 1],
                setting.ramp,
                setting.smoothing,
            )
            segments = angles[word] * radius
            duration = _guess(segments, SIGNS[word], radius, speed, surface.half_gauge, w.belts)
            duration, cost, converged, used = ip.solve(
                task, bounds, surface, duration, w, a, setting.iterations
            )
            out[row, 3] += used
            out[row, 5] += 1
            if converged and cost < out[row, 1]:
                out[row, 0], out[row, 1], out[row, 2], out[row, 4] = duration, cost, 1.0, turning
                belts[row] = w.belts


class Setting(NamedTuple):
    radius: float
    speed: float
    starts: int
    longer: float
    extra: float
    ramp: bool
    smoothing: float
    iterations: int
