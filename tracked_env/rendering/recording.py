"""One episode as arrays, for a viewer that shows any instant: poses, errors, loads, ground."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine.simulation import Simulation
from tracked_env.physics.parameters import PlantParameters
from tracked_env.references import sample
from tracked_env.rendering import sizes
from tracked_env.rendering.canvas import Bytes
from tracked_env.rendering.landscape import height_grid, interval_around
from tracked_env.rendering.snapshot import Snapshot, take
from tracked_env.rendering.soil_map import SoilMap
from tracked_env.rendering.terrain_source import TerrainSource, pose_of

FloatArray = NDArray[np.float64]

AROUND = 6.0  # [contact lengths] of ground around the path
MESH_POINTS = 2.5e4  # [-] heights of the ground at most
IMAGE_PIXELS = 1.0e6  # [-] of the picture on it
PATH_STEP = 0.1  # [s] between points of the reference


class Relief(NamedTuple):
    """The ground: heights on a square mesh, and a picture of the same area."""

    heights: NDArray[np.float32]  # (R, C) [m], rows along y, columns along x
    x: float  # [m] of heights[0, 0]
    y: float  # [m]
    cell: float  # [m]
    picture: Bytes  # (H, W, 3), first row in the north


class Recording(NamedTuple):
    """One episode; T instants."""

    times: FloatArray  # (T,) [s]
    poses: FloatArray  # (T, 6) x, y, z [m], yaw, pitch, roll [rad]
    references: FloatArray  # (T, 3) x, y [m], yaw [rad]
    speeds: FloatArray  # (T,) [m/s]
    distances: FloatArray  # (T,) [m] to the reference
    loads: FloatArray | None  # (T, 2) [N] under the left and the right track
    path: FloatArray  # (P, 2) [m] of the reference
    parameters: PlantParameters
    terrain: TerrainSource
    relief: Relief


class Recorder:
    """Collects one episode of one row of a simulation."""

    def __init__(self, terrain: TerrainSource | None = None) -> None:
        """terrain: what the vehicle drives on; None: level ground."""
        self._terrain = terrain or TerrainSource()
        self._shots: list[Snapshot] = []
        self._loads: list[FloatArray] = []

    def add(self, simulation: Simulation, row: int = 0) -> None:
        """Take the present instant of the episode.

        Raises gymnasium.error.ResetNeeded before the first episode, ValueError after another one.
        """
        shot = take(simulation, row)
        if self._shots and shot.episode is not self._shots[0].episode:
            raise ValueError(
                "a recording holds one episode, but another one has begun: use another"
            )
        self._shots.append(shot)
        if self._terrain.loads is not None:
            self._loads.append(self._terrain.loads(simulation, row).sum(axis=(1, 2)))

    def finish(self) -> Recording:
        """The recording; raises ValueError without an instant."""
        if not self._shots:
            raise ValueError("recorded instants = 0; must be >= 1. Call add() after reset()")
        shots, first = self._shots, self._shots[0]
        count = math.ceil(first.duration / PATH_STEP) + 1
        profile = sample(first.episode.profile, np.linspace(0.0, first.duration, count))
        path = np.stack([profile.x, profile.y], axis=1)
        return Recording(
            times=np.array([shot.time for shot in shots]),
            poses=np.array([pose_of(shot.state, self._terrain) for shot in shots]),
            references=np.array([shot.reference for shot in shots]),
            speeds=np.array([shot.state.v_x for shot in shots]),
            distances=np.array([shot.distance for shot in shots]),
            loads=np.array(self._loads) if self._loads else None,
            path=path,
            parameters=first.nominal,
            terrain=self._terrain,
            relief=self._relief(first, path),
        )

    def _relief(self, shot: Snapshot, path: FloatArray) -> Relief:
        length = shot.sizes.length
        everywhere = np.concatenate([path, [s.pose[:2] for s in self._shots]])
        low, high = everywhere.min(axis=0), everywhere.max(axis=0)
        low, high = low - AROUND * length, high + AROUND * length
        cell = max(0.1 * length, math.sqrt(float(np.prod(high - low)) / MESH_POINTS))
        heights, x, y = height_grid(self._terrain, low, high, cell)
        interval = interval_around(self._terrain, path, length)
        soil = SoilMap(shot, sizes.default_zoom(length), None, self._terrain, interval)
        soil.advance(shot)
        size = cell * (np.array(heights.shape) - 1)  # [m] y, x
        pixel = math.sqrt(float(np.prod(size)) / IMAGE_PIXELS)
        rows, columns = (math.floor(extent / pixel) for extent in size)
        xs = x + size[1] * (np.arange(columns) + 0.5) / columns
        ys = y + size[0] * (1.0 - (np.arange(rows) + 0.5) / rows)
        colours = soil.image(shot, xs, ys)
        picture = soil.with_relief(colours, x, y + float(size[0]), pixel)
        return Relief(heights, x, y, cell, picture)
