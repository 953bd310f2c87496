"""Heights of the ground around a vehicle, as a depth sensor gives them in the yaw frame.

For a point at (a, b) contact lengths l ahead and to the left, at the true heading:
    measured = h(P) - z + sigma n,   P = (x, y) + l R_z(yaw) (a, b),   n ~ N(0, 1)
z is the height of the vehicle as the state has it, so that level ground at rest reads 0. Every
point of every control step is lost with the probability DROPOUT; then its last value stays. Where
the sensors of the episode have no error, neither has this one. Random numbers come from a stream of
its own, seeded by the noise seed of the episode: nothing else changes by it.

Assumptions: no delay, no occlusion; the sensor is levelled and knows its own height without error.
"""

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.engine.episode import Episode
from tracked_env.physics import state as s
from tracked_env.physics.parameters import PARAMETER_INDEX
from tracked_env.plants import Ground

NOISE = 0.02  # [m] sigma, of a depth camera or lidar at a few metres
DROPOUT = 0.02  # [-] of a point in a control step
_LENGTH = b.BASE + PARAMETER_INDEX["contact_length"]


class HeightScan:
    """The same points around each of N vehicles."""

    def __init__(self, name: str, points: tuple[tuple[float, float], ...], count: int) -> None:
        """name: of its group; points: (ahead, left) [contact lengths] each."""
        self._name, self._points = name, np.array(points)
        self._held = np.zeros((count, len(points)))
        self._streams: list[np.random.Generator | None] = [None] * count

    @property
    def running(self) -> dict[str, Any]:
        """All that changes while episodes run, the arrays and streams themselves."""
        return {"held": self._held, "streams": self._streams}

    @running.setter
    def running(self, values: Mapping[str, Any]) -> None:
        self._held, self._streams = values["held"], values["streams"]

    def start(self, i: int, episode: Episode) -> None:
        """Begin an episode on vehicle i."""
        seed = [episode.noise_seed, zlib.crc32(self._name.encode())]
        noisy = episode.sensors.noisy
        self._streams[i] = np.random.Generator(np.random.SFC64(seed)) if noisy else None

    def read(
        self, batch: b.Batch, rows: NDArray[np.int64], ground: Ground | None
    ) -> NDArray[np.float64]:
        """Heights (n, M) [m] around the vehicles `rows`; ground: None is level."""
        floats = batch.floats
        x, y, yaw, z = (floats[rows, b.STATE + k, None] for k in (s.X, s.Y, s.YAW, s.Z))
        ahead, left = floats[rows, _LENGTH, None] * self._points.T[:, None]
        cosine, sine = np.cos(yaw), np.sin(yaw)
        heights = np.zeros(ahead.shape)
        if ground is not None:
            at_x, at_y = x + cosine * ahead - sine * left, y + sine * ahead + cosine * left
            heights = ground.heights(floats, rows, at_x, at_y)
        fresh = heights - z
        started = batch.counters[rows, b.STEP] > 0
        for k, i in enumerate(rows.tolist()):
            stream = self._streams[i]
            if stream is not None:
                error = NOISE * stream.standard_normal(len(self._points))
                lost = stream.random(len(self._points)) < DROPOUT
                fresh[k] = np.where(lost & started[k], self._held[i], fresh[k] + error)
        self._held[rows] = fresh
        return fresh
