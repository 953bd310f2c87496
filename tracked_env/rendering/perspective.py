"""The scene from behind the vehicle: ground, paths, vehicle and reference, with a depth buffer.

The ground of one episode for pictures in perspective: height grid, soil colours, ribbons.

The grid covers the path and as far around it as a picture shows. A ribbon is a line drawn on the
ground: quads whose corners lie on the ground, so that it bends with it and hides behind hills.

The eye behind the vehicle: where it stands, and the projection of its picture.

It looks along a heading that follows the vehicle's yaw with a lag, so that the picture turns
smoothly. It stands behind and above the vehicle, and higher where the ground between the two
would hide the vehicle. The horizon moves in the picture and the vehicle stays at one row.
A standing eye keeps its place until the vehicle is out of the middle, too far, too close or behind
a hill: the ground is then drawn once for many pictures.
"""

import math

import numpy as np
import pygame
from numpy.typing import NDArray

from tracked_env.rendering import canvas, raster
from tracked_env.rendering.canvas import Bytes, Colour
from tracked_env.rendering.raster import Eye, GroundGrid, project
from tracked_env.rendering.scene import GHOST_REACH, footprint, vehicle_faces
from tracked_env.rendering.sizes import default_zoom, grid_of
from tracked_env.rendering.snapshot import BodyPose, Pose, Snapshot, TerrainSource, pose_of
from tracked_env.rendering.soil_map import LIGHT, SoilMap, brightness_on_grid, contour_interval

Points = NDArray[np.float64]


VIEW = 30.0  # [contact lengths] that are seen; around the path the grid reaches as far
AROUND, COARSE = 4.0, 96  # [contact lengths] around the path, and [-] heights on each side, that
#                           choose the interval of the contour lines
FINEST = 1.0 / 24.0  # [contact lengths] between heights
MOST_CELLS = 1.5e6  # [-] of a grid
SOIL_STEP = 4  # cells of the heights for one colour of the soil
LIFT = 0.01  # [contact lengths] of ribbons above the ground


def height_grid(
    terrain: TerrainSource, low: Points, high: Points, cell: float
) -> tuple[NDArray[np.float32], float, float]:
    """Heights [m] float32 (R, C), x and y [m] of the first, over low to high (2,) [m]."""
    columns, rows = (math.ceil((high[k] - low[k]) / cell) + 2 for k in (0, 1))
    xs = low[0] + cell * np.arange(columns)
    ys = low[1] + cell * np.arange(rows)
    heights = np.empty((rows, columns), dtype=np.float32)
    block = max(1, int(2e5) // columns)
    for first in range(0, rows, block):
        x, y = np.meshgrid(xs, ys[first : first + block])
        heights[first : first + block] = terrain.checked_heights(x, y)
    return heights, float(low[0]), float(low[1])


def interval_around(terrain: TerrainSource, path: Points, length: float) -> float:
    """Interval [m] of the contour lines for the ground around a path (P, 2) [m]."""
    low, high = path.min(axis=0) - AROUND * length, path.max(axis=0) + AROUND * length
    xs, ys = (np.linspace(low[k], high[k], COARSE) for k in (0, 1))
    x, y = np.meshgrid(xs, ys)
    return contour_interval(terrain.checked_heights(x, y))


class Landscape:
    """Ground of one episode."""

    def __init__(
        self,
        terrain: TerrainSource,
        path: Points,
        length: float,
        interval: float,
        light: tuple[float, float, float] = LIGHT,
    ) -> None:
        """path (P, 2) [m] of the reference; length: contact length [m]; interval [m] between
        contour lines; light: vector to it.
        """
        self.length, self.light = length, light
        low, high = path.min(axis=0) - VIEW * length, path.max(axis=0) + VIEW * length
        self.cell = max(FINEST * length, math.sqrt(float(np.prod(high - low)) / MOST_CELLS))
        heights, x, y = height_grid(terrain, low, high, self.cell)
        bright = np.empty_like(heights)
        brightness_on_grid(heights, self.cell, light, bright)
        mesh = grid_of(default_zoom(length))
        white = np.full((1, 1, 3), 255, dtype=np.uint8)
        self.grid = GroundGrid(
            heights, bright, x, y, 1.0 / self.cell, white, float(max(heights.shape)),
            1.0 / interval, mesh.parts / mesh.side,
        )  # fmt: skip

    def colour(self, soil: SoilMap, shot: Snapshot) -> None:
        """Take the soil's colours as they are now."""
        rows, columns = self.grid.heights.shape
        step = 1 if soil.uniform else SOIL_STEP
        count = (1, 1) if soil.uniform else (rows // step, columns // step)
        xs = self.grid.x + self.cell * step * (np.arange(count[1]) + 0.5)
        ys = self.grid.y + self.cell * step * (np.arange(count[0]) + 0.5)
        pixels = soil.image(shot, xs, ys)
        one = float(max(rows, columns)) if soil.uniform else float(step)
        self.grid = self.grid._replace(soil=pixels, soil_step=one)

    def heights(self, points: Points) -> Points:
        """Heights [m] (...,) of the drawn ground at places (..., 2) [m], bilinear."""
        grid = self.grid.heights
        at = (points - (self.grid.x, self.grid.y)) * self.grid.inverse_cell
        at = np.clip(at, 0.0, (grid.shape[1] - 1.001, grid.shape[0] - 1.001))
        j, i = np.moveaxis(at.astype(np.int64), -1, 0)
        u, v = np.moveaxis(at - at.astype(np.int64), -1, 0)
        low = grid[i, j] + u * (grid[i, j + 1] - grid[i, j])
        high = grid[i + 1, j] + u * (grid[i + 1, j + 1] - grid[i + 1, j])
        return low + v * (high - low)

    def on_ground(self, points: Points) -> Points:
        """Places (..., 2) [m] with their heights, just above the ground (..., 3)."""
        heights = self.heights(points) + LIFT * self.length
        return np.concatenate([points, heights[..., None]], axis=-1)

    def ribbon(self, line: Points, width: Points) -> Points:
        """Quads (P - 1, 4, 3) [m] of a line (P, 2) [m] on the ground, width (P,) [m].

        Points that repeat the one before them give quads without an area.
        """
        along = np.gradient(line, axis=0)
        size = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        aside = 0.5 * width[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1) / size
        left, right = self.on_ground(line + aside), self.on_ground(line - aside)
        return np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)


def resampled(line: Points, step: float) -> Points:
    """A line (P, 2) [m] with points `step` [m] apart along it; at least its two ends."""
    size = np.linalg.norm(np.diff(line, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(size)])
    moved = np.concatenate([[True], size > 1e-9])
    count = max(math.ceil(at[-1] / step), 1) + 1
    wanted = np.linspace(0.0, at[-1], count)
    return np.stack([np.interp(wanted, at[moved], line[moved, k]) for k in (0, 1)], axis=1)


# In contact lengths:
BEHIND, ABOVE = 3.7, 1.9  # from the vehicle to the eye
FREE = 0.45  # least height of the line of sight above the ground
NEAR = 0.4  # nothing closer is drawn
LAG = 0.6  # [s] time constant of the heading
FIELD = math.radians(54.0)  # [rad] horizontal angle of view
VEHICLE_ROW = 0.57  # [-] of the picture's height
SAMPLES = 24  # [-] of the line of sight
# Of a standing eye: distances ahead [contact lengths] and parts of the picture where the vehicle
# may be.
CLOSEST, FARTHEST = 2.2, 7.0
MIDDLE = 0.12, 0.88  # [-] of the width
UPRIGHT = 0.10, 0.86  # [-] of the height


class ChaseCamera:
    """The eye of one episode."""

    def __init__(self, yaw: float, time: float) -> None:
        """Start behind a vehicle with that yaw [rad] at that time [s]."""
        self._yaw, self._time = yaw, time

    def follow(self, yaw: float, time: float) -> None:
        """Turn towards the yaw [rad] of the vehicle (not wrapped) at that time [s]."""
        elapsed, self._time = max(time - self._time, 0.0), time
        self._yaw += (yaw - self._yaw) * (1.0 - math.exp(-elapsed / LAG))

    def eye(self, pose: BodyPose, landscape: Landscape, width: int, height: int) -> Eye:
        """The eye for a picture of that size [px]."""
        length = landscape.length
        cosine, sine = math.cos(self._yaw), math.sin(self._yaw)
        x, y = pose.x - BEHIND * length * cosine, pose.y - BEHIND * length * sine
        z = pose.z + ABOVE * length
        share = np.linspace(0.0, 0.9, SAMPLES)  # from the eye to the vehicle
        line = np.stack([x + share * (pose.x - x), y + share * (pose.y - y)], axis=1)
        needed = landscape.heights(line) + FREE * length * (1.0 - share)
        z = max(z, float(np.max((needed - share * pose.z) / (1.0 - share))))
        focal = 0.5 * width / math.tan(0.5 * FIELD)
        row = VEHICLE_ROW * height - focal * (z - pose.z) / (BEHIND * length)
        return Eye(
            x, y, z, cosine, sine, focal, 0.5 * width, row, NEAR * length, VIEW * length
        )  # fmt: skip


class StandingCamera(ChaseCamera):
    """An eye that takes a new place behind the vehicle when it no longer sees it well."""

    def __init__(self, yaw: float, time: float) -> None:
        """Start behind a vehicle with that yaw [rad] at that time [s]."""
        super().__init__(yaw, time)
        self._eye: Eye | None = None

    def follow(self, yaw: float, time: float) -> None:
        """Note the yaw [rad] of the vehicle."""
        self._yaw = yaw

    def eye(self, pose: BodyPose, landscape: Landscape, width: int, height: int) -> Eye:
        """The eye for a picture of that size [px]; the one before where that still sees it."""
        if self._eye is None or not _sees(self._eye, pose, landscape, width, height):
            self._eye = super().eye(pose, landscape, width, height)
        return self._eye


def _sees(eye: Eye, pose: BodyPose, landscape: Landscape, width: int, height: int) -> bool:
    """Whether the vehicle is in the middle of the picture, at a good distance, and not hidden."""
    column, row, inverse = project(eye, np.array([pose.x, pose.y, pose.z])).tolist()
    if not inverse or not CLOSEST < 1.0 / (inverse * landscape.length) < FARTHEST:
        return False
    if not MIDDLE[0] * width < column < MIDDLE[1] * width:
        return False
    if not UPRIGHT[0] * height < row < UPRIGHT[1] * height:
        return False
    share = np.linspace(0.0, 0.9, SAMPLES)[:, None]
    line = np.array([eye.x, eye.y, eye.z]) + share * np.array(
        [pose.x - eye.x, pose.y - eye.y, pose.z - eye.z]
    )
    return bool((line[:, 2] > landscape.heights(line[:, :2])).all())


ZENITH: Colour = (126, 172, 212)
HORIZON: Colour = (222, 231, 238)
LINE_WIDTH = 0.05  # [contact lengths] of paths on the ground
THINNEST = 1.8  # [px] of the same, far away
NEARER = 0.02  # [-] of its distance that a line on the ground is taken as nearer than it
SHADE = 0.38  # [-] opacity of the shadow under the vehicle
OUTLINE_STEP = 0.08  # [contact lengths] between points of the reference's outline
EDGE = 70  # [-] of 765: brighter edges are softened


class Picture:
    """A picture in the making: colours and depth buffer."""

    def __init__(self, width: int, height: int) -> None:
        """Size in pixels."""
        self.colours: Bytes = np.empty((height, width, 3), dtype=np.uint8)
        self.inverse = np.zeros((height, width), dtype=np.float32)
        self._spans = np.zeros((height, 2), dtype=np.int64)  # drawn on the ground, of each row
        self._soft: Bytes = np.empty_like(self.colours)
        # Of ground that is shown again: colours, depth buffer, softened colours.
        self._kept: tuple[Bytes, NDArray[np.float32], Bytes] | None = None

    def keep(self) -> None:
        """Keep the ground that has been drawn, for `restore`."""
        raster.soften(self.colours, EDGE, self._soft)
        self._kept = self.colours.copy(), self.inverse.copy(), self._soft.copy()

    def restore(self) -> None:
        """The ground as it was kept; what was drawn on it is gone."""
        assert self._kept is not None
        self.colours[:], self.inverse[:], self._soft[:] = self._kept
        self._spans[:] = self.colours.shape[1], 0

    def ground(self, landscape: Landscape, eye: Eye) -> None:
        """Sky and ground; what was drawn before is gone."""
        self._kept = None
        height = self.colours.shape[0]
        above = (eye.row - np.arange(height)) / height + 0.2
        share = np.clip(above / 0.8, 0.0, 1.0)[:, None]
        sky = np.array(HORIZON) + share * (np.array(ZENITH) - np.array(HORIZON))
        raster.trace(landscape.grid, eye, self.inverse)
        haze, rows = np.array(HORIZON, dtype=np.uint8), np.round(sky).astype(np.uint8)
        raster.colour_ground(landscape.grid, eye, self.inverse, haze, rows, self.colours)

    def polygons(
        self,
        seen: Points,
        starts: NDArray[np.int64],
        colours: Bytes,
        opacity: float = 1.0,
        bias: float = 0.0,
    ) -> None:
        """Projected polygons; arguments as `raster.fill_polygons` has them, one of each for all."""
        count = starts.size - 1
        raster.fill_polygons(
            seen, starts, colours, np.full(count, opacity), np.full(count, bias),
            self.inverse, self.colours, self._spans,
        )  # fmt: skip

    def quads(
        self, eye: Eye, quads: Points, colour: Colour, opacity: float = 1.0, bias: float = 0.0
    ) -> None:
        """Quads (Q, 4, 3) [m] of one colour."""
        self._projected(raster.project(eye, quads), colour, opacity, bias)

    def line(self, eye: Eye, landscape: Landscape, line: Points, colour: Colour) -> None:
        """A line (P, 2) [m] on the ground, nowhere thinner than THINNEST."""
        if len(line) < 2:
            return
        away = np.hypot(line[:, 0] - eye.x, line[:, 1] - eye.y)
        width = np.maximum(LINE_WIDTH * landscape.length, THINNEST * away / eye.focal)
        seen = raster.project(eye, landscape.ribbon(line, width))
        for left, right in ((0, 3), (1, 2)):  # both edges, at the start and at the end of a quad
            across = seen[:, left, :2] - seen[:, right, :2]
            missing = np.maximum(THINNEST - np.hypot(across[:, 0], across[:, 1]), 0.0)
            upward = np.where(across[:, 1] > 0.0, 0.5, -0.5) * missing
            seen[:, left, 1] += upward
            seen[:, right, 1] -= upward
        self._projected(seen, colour, 1.0, NEARER)

    def _projected(self, seen: Points, colour: Colour, opacity: float, bias: float) -> None:
        starts = 4 * np.arange(len(seen) + 1)
        colours = np.tile(np.array(colour, dtype=np.uint8), (len(seen), 1))
        self.polygons(seen.reshape(-1, 3), starts, colours, opacity, bias)

    def softened(self) -> Bytes:
        """The finished colours (H, W, 3)."""
        if self._kept is None:
            raster.soften(self.colours, EDGE, self._soft)
        else:
            raster.soften_spans(self.colours, EDGE, self._spans, self._soft)
        return self._soft


def _corners(outline: Points, pose: Pose | BodyPose) -> Points:
    """Places (P, 2) [m] of an outline (P, 2) [m] of the body seen from above."""
    cosine, sine = np.cos(pose.yaw), np.sin(pose.yaw)
    return outline @ np.array([[cosine, sine], [-sine, cosine]]) + (pose.x, pose.y)


class Perspective:
    """The perspective scene of one episode."""

    def __init__(
        self,
        shot: Snapshot,
        terrain: TerrainSource,
        path: Points,
        interval: float,
        standing: bool = False,
    ) -> None:
        """path (P, 2) [m]: the whole reference; interval [m] between contour lines.

        standing: the eye keeps its place for as long as it sees the vehicle well.
        """
        self._terrain = terrain
        self.landscape = Landscape(terrain, path, shot.sizes.length, interval)
        camera = StandingCamera if standing else ChaseCamera
        self._camera, self._standing = camera(shot.state.yaw, shot.time), standing
        self._eye: Eye | None = None  # of the ground that is kept
        self._picture: Picture | None = None

    def draw(
        self,
        target: pygame.Surface,
        shot: Snapshot,
        soil: SoilMap,
        refresh: bool,
        lines: list[tuple[Points, Colour]],
        travel: list[float],
    ) -> None:
        """Cover the target; lines: paths (P, 2) [m] on the ground; travel [m] of both belts."""
        width, height = target.get_size()
        if self._picture is None:
            self._picture = Picture(width, height)
            refresh = True
        if refresh:
            self.landscape.colour(soil, shot)
        pose = pose_of(shot.state, self._terrain)
        self._camera.follow(pose.yaw, shot.time)
        eye = self._camera.eye(pose, self.landscape, width, height)
        if eye is not self._eye or refresh:
            self._picture.ground(self.landscape, eye)
            if self._standing:
                self._eye = eye
                self._picture.keep()
        if self._standing:
            self._picture.restore()
        self._shadow(self._picture, eye, pose, shot)
        for line, colour in lines:
            self._picture.line(eye, self.landscape, line, colour)
        self._reference(self._picture, eye, shot)
        slips = shot.state.slip_left, shot.state.slip_right
        loads = None
        if shot.loads is not None:  # of the patches side by side
            loads = canvas.load_colours(shot.loads.mean(axis=2), shot.load_shown)
        faces = vehicle_faces(shot.parameters, self._terrain.centre_height, slips, travel, loads)
        light = pose.axes.T @ np.array(self.landscape.light)
        seen = raster.project(eye, pose.place(faces.corners))
        self._picture.polygons(seen, faces.starts, faces.lit(light.tolist()))
        canvas.paint(target, self._picture.softened())

    def _shadow(self, picture: Picture, eye: Eye, pose: BodyPose, shot: Snapshot) -> None:
        """The ground under the vehicle, darker."""
        p = shot.parameters
        half, side = 0.62 * p.contact_length, 0.56 * (p.track_gauge + p.track_width)
        x, y = np.meshgrid(np.linspace(-half, half, 9), np.linspace(-side, side, 7), indexing="ij")
        nodes = self.landscape.on_ground(_corners(np.stack([x, y], axis=-1), pose))
        quads = np.stack([nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]], axis=2)
        picture.quads(eye, quads.reshape(-1, 4, 3), canvas.INK, SHADE, NEARER)

    def _reference(self, picture: Picture, eye: Eye, shot: Snapshot) -> None:
        """The outline where the vehicle should be, and a line from there to where it is."""
        length = self.landscape.length
        if shot.distance > GHOST_REACH * length:
            return
        outline = np.array(footprint(shot.parameters, length))
        ring = resampled(np.concatenate([outline, outline[:1]]), OUTLINE_STEP * length)
        error = resampled(np.array([shot.reference[:2], shot.pose[:2]]), OUTLINE_STEP * length)
        for line in (_corners(ring, shot.reference), error):
            picture.line(eye, self.landscape, line, canvas.BLUE)
