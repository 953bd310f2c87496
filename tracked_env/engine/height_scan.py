"""Heights of the ground around a vehicle, as a depth sensor gives them in the yaw frame.

For a point at (a, b) contact lengths l ahead and to the left, at the true heading:
    measured = h(P) - z + sigma n,   P = (x, y) + l R_z(yaw) (a, b),   n ~ N(0, 1)
z is the height of the vehicle as the state has it, so that level ground at rest reads 0. Every
point of every control step is lost with the probability DROPOUT; then its last value stays, as it
does where the state is not finite. Where the sensors of the episode have no error, neither has this
one. Random numbers come from a stream of its own, seeded by the noise seed of the episode and the
name of the group: nothing else changes by it.

Assumptions: no delay, no occlusion; the sensor is levelled and knows its own height without error.
"""

import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tracked_env.engine import columns as b
from tracked_env.engine import noise
from tracked_env.engine.episode import Episode
from tracked_env.physics import state as s
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PARAMETER_INDEX
from tracked_env.plants import Ground

NOISE = 0.02  # [m] sigma, of a depth camera or lidar at a few metres
DROPOUT = 0.02  # [-] of a point in a control step
_LOST = float(ndtri(DROPOUT))  # [-] a normal number below it loses the point
_LENGTH = b.BASE + PARAMETER_INDEX["contact_length"]
_SEEDS = 2**63  # [-] of `noise.seed_state`
Floats = NDArray[np.float64]


@loop
def _place(floats, rows, points, x, y):
    """Places x, y (n, M) [m] of the points (M, 2) [contact lengths] around the vehicles `rows`."""
    for k in range(rows.size):
        i = rows[k]
        cosine, sine = rotation(floats[i, b.STATE + s.YAW])
        length = floats[i, _LENGTH]
        for m in range(points.shape[0]):
            ahead, left = length * points[m, 0], length * points[m, 1]
            x[k, m] = floats[i, b.STATE + s.X] + cosine * ahead - sine * left
            y[k, m] = floats[i, b.STATE + s.Y] + sine * ahead + cosine * left


@loop
def _measure(floats, counters, rows, heights, held, states, noisy, shown):
    """Readings shown (n, M) [m] where the ground has these heights (n, M) [m].

    held (N, M): the last readings; states (N, noise.STATE) and noisy (N,): of the streams.
    """
    count = heights.shape[1]
    normal = np.zeros(2 * count, dtype=np.float32)
    for k in range(rows.size):
        i = rows[k]
        if noisy[i]:
            noise.fill_normal(states[i], normal)
        else:
            normal[:] = 0.0
        started = counters[i, b.STEP] > 0
        for m in range(count):
            value = heights[k, m] - floats[i, b.STATE + s.Z] + NOISE * normal[m]
            if not (started and (normal[count + m] < _LOST or not math.isfinite(value))):
                held[i, m] = value
            shown[k, m] = held[i, m]


class HeightScan:
    """The same points around each of N vehicles."""

    def __init__(self, name: str, points: tuple[tuple[float, float], ...], count: int) -> None:
        """name: of its group; points: (ahead, left) [contact lengths] each."""
        self._name, self._points = zlib.crc32(name.encode()), np.array(points)
        self._held = np.zeros((count, len(points)))
        self._states = np.zeros((count, noise.STATE), dtype=np.uint64)
        self._noisy = np.zeros(count, dtype=np.bool_)

    @property
    def running(self) -> dict[str, Any]:
        """All that changes while episodes run, the arrays themselves."""
        return {"held": self._held, "states": self._states, "noisy": self._noisy}

    @running.setter
    def running(self, values: Mapping[str, Any]) -> None:
        self._held, self._states = values["held"], values["states"]
        self._noisy = values["noisy"]

    def start(self, i: int, episode: Episode) -> None:
        """Begin an episode on vehicle i."""
        self._noisy[i] = episode.sensors.noisy
        noise.seed_state(self._states[i], (episode.noise_seed ^ (self._name << 31)) % _SEEDS)

    def read(
        self, batch: b.Batch, rows: NDArray[np.int64], ground: Ground | None, shown: Floats
    ) -> None:
        """Readings around the vehicles `rows` into shown (n, M) [m]; ground: None is level."""
        places = np.zeros((2, rows.size, len(self._points)))
        if ground is None:
            heights = places[0]
        else:
            _place(batch.floats, rows, self._points, places[0], places[1])
            heights = ground.heights(batch.floats, rows, places[0], places[1])
        _measure(
            batch.floats, batch.counters, rows, heights, self._held, self._states, self._noisy,
            shown,
        )  # fmt: skip
