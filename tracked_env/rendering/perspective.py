"""The scene in space: ground of an episode as a mesh, the eye behind the vehicle, and the picture.

The mesh covers the path and as far around it as a picture shows; `viewer` takes the same. A ribbon
is a line drawn on the ground: quads whose corners lie on it, so that it bends with the ground and
hides behind hills.

The eye looks along a heading that follows the vehicle's yaw with a lag, so that the picture turns
smoothly. It stands behind and above the vehicle, and higher where the ground between the two
would hide the vehicle. The horizon moves in the picture and the vehicle stays at one row.
"""

import math

import numpy as np
from pygame import Surface
from scipy.spatial import ConvexHull

from tracked_env.rendering import canvas, raster
from tracked_env.rendering.canvas import Bytes, Colour, Floats, Lines, default_zoom, grid_of
from tracked_env.rendering.legend import HEIGHT, WIDTH
from tracked_env.rendering.raster import Eye, GroundGrid
from tracked_env.rendering.scene import GHOST_REACH, footprint, quads, vehicle_faces
from tracked_env.rendering.snapshot import BodyPose, Snapshot, TerrainSource, placed
from tracked_env.rendering.soil_map import LIGHT, SoilMap, brightness_on_grid

# In contact lengths:
VIEW = 30.0  # that are seen; around the path the mesh reaches as far
FINEST = 1.0 / 24.0  # between heights
LIFT = 0.01  # of ribbons above the ground
LINE_WIDTH = 0.05  # of paths on the ground
OUTLINE_STEP = 0.08  # between points of the reference's outline
BEHIND, ABOVE = 3.7, 1.9  # from the vehicle to the eye
CLEARANCE = 0.45  # least height of the line of sight above the ground
NEAR = 0.4  # nothing closer is drawn

MAX_CELLS = 1.5e6  # [-] of a mesh
SOIL_STEP = 4  # cells of the heights for one colour of the soil
LAG = 0.6  # [s] time constant of the heading
FIELD = math.radians(54.0)  # [rad] horizontal angle of view
VEHICLE_ROW = 0.57  # [-] of the picture's height
SAMPLES = 24  # [-] of the line of sight
ZENITH: Colour = (126, 172, 212)
HORIZON: Colour = (222, 231, 238)
THINNEST = 1.8  # [px] of a path far away
NEARER = 0.02  # [-] of its distance that a line on the ground is taken as nearer than it
SHADE, RINGS = 0.38, 6  # [-] opacity of the vehicle's shadow; rings of its mesh
EDGE = 70  # [-] of 765: brighter edges are softened


class Landscape:
    """Ground of one episode: heights on a square mesh, and the colours on it."""

    def __init__(
        self,
        terrain: TerrainSource,
        low: Floats,
        high: Floats,
        cell: float,
        length: float,
        interval: float,
    ) -> None:
        """The ground from low to high (2,) [m] with heights `cell` [m] apart.

        length: contact length [m]; interval [m] between contour lines.
        """
        self.length, self.cell = length, cell
        columns, rows = (math.ceil((high[k] - low[k]) / cell) + 2 for k in (0, 1))
        xs, ys = low[0] + cell * np.arange(columns), low[1] + cell * np.arange(rows)
        heights = np.empty((rows, columns), dtype=np.float32)
        block = max(1, int(2e5) // columns)
        for first in range(0, rows, block):
            places = np.meshgrid(xs, ys[first : first + block])
            heights[first : first + block] = terrain.checked_heights(*places)
        bright = np.empty_like(heights)
        brightness_on_grid(heights, cell, LIGHT, bright)
        mesh, white = grid_of(default_zoom(length)), np.full((1, 1, 3), 255, dtype=np.uint8)
        size = float(max(heights.shape))
        lines = 1.0 / interval, mesh.parts / mesh.side
        x, y = (float(first) for first in low)
        self.grid = GroundGrid(heights, bright, x, y, 1.0 / cell, white, size, *lines)

    @classmethod
    def around(
        cls, terrain: TerrainSource, path: Floats, length: float, interval: float
    ) -> "Landscape":
        """As far around a path (P, 2) [m] as a picture shows; arguments as above."""
        low, high = path.min(axis=0) - VIEW * length, path.max(axis=0) + VIEW * length
        cell = max(FINEST * length, math.sqrt(float(np.prod(high - low)) / MAX_CELLS))
        return cls(terrain, low, high, cell, length, interval)

    def colour(self, soil: SoilMap, shot: Snapshot) -> None:
        """Take the soil's colours as they are now."""
        rows, columns = self.grid.heights.shape
        step = max(rows, columns) if soil.uniform else SOIL_STEP
        xs = self.grid.x + self.cell * step * (np.arange(max(columns // step, 1)) + 0.5)
        ys = self.grid.y + self.cell * step * (np.arange(max(rows // step, 1)) + 0.5)
        self.grid = self.grid._replace(soil=soil.image(shot, xs, ys), soil_step=float(step))

    def heights(self, points: Floats) -> Floats:
        """Heights [m] (...,) of the mesh at places (..., 2) [m], bilinear."""
        heights = np.empty(points.shape[:-1])
        raster.heights_at(self.grid, points.reshape(-1, 2), heights.reshape(-1))
        return heights

    def on_ground(self, points: Floats, lift: float = LIFT) -> Floats:
        """Places (..., 2) [m] with their heights, just above the ground (..., 3)."""
        heights = self.heights(points) + lift * self.length
        return np.concatenate([points, heights[..., None]], axis=-1)

    def ribbon(self, line: Floats, width: Floats) -> Floats:
        """Quads (P - 1, 4, 3) [m] of a line (P, 2) [m] on the ground, width (P,) [m].

        Points that repeat the one before them give quads without an area.
        """
        along = np.gradient(line, axis=0)
        size = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        aside = 0.5 * width[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1) / size
        left, right = self.on_ground(line + aside), self.on_ground(line - aside)
        return np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)


def resampled(line: Floats, step: float) -> Floats:
    """A line (P, 2) [m] with points `step` [m] apart along it; at least its two ends."""
    size = np.linalg.norm(np.diff(line, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(size)])
    moved = np.concatenate([[True], size > 1e-9])
    places = np.linspace(0.0, at[-1], max(math.ceil(at[-1] / step), 1) + 1)
    return np.stack([np.interp(places, at[moved], line[moved, k]) for k in (0, 1)], axis=1)


class Picture:
    """A picture in the making: colours and depth buffer."""

    def __init__(self, width: int, height: int) -> None:
        """Size in pixels."""
        self.colours: Bytes = np.empty((height, width, 3), dtype=np.uint8)
        self.inverse = np.zeros((height, width), dtype=np.float32)
        self._soft: Bytes = np.empty_like(self.colours)

    def ground(self, grid: GroundGrid, eye: Eye) -> None:
        """Sky and ground; what was drawn before is gone."""
        height = self.colours.shape[0]
        above = (eye.row - np.arange(height)) / height + 0.2
        share = np.clip(above / 0.8, 0.0, 1.0)[:, None]
        sky = np.array(HORIZON) + share * (np.array(ZENITH) - np.array(HORIZON))
        raster.trace(grid, eye, self.inverse)
        haze, rows = np.array(HORIZON, dtype=np.uint8), np.round(sky).astype(np.uint8)
        raster.colour_ground(grid, eye, self.inverse, haze, rows, self.colours)

    def quads(
        self, pixels: Floats, colour: Colour, opacity: float = 1.0, bias: float = 0.0
    ) -> None:
        """Projected quads (Q, 4, 3) of one colour."""
        colours = np.tile(np.array(colour, dtype=np.uint8), (len(pixels), 1))
        starts, buffers = 4 * np.arange(len(pixels) + 1), (self.inverse, self.colours)
        raster.fill_polygons(pixels.reshape(-1, 3), starts, colours, opacity, bias, *buffers)

    def line(self, eye: Eye, landscape: Landscape, line: Floats, colour: Colour) -> None:
        """A line (P, 2) [m] on the ground, nowhere thinner than THINNEST."""
        if len(line) < 2:
            return
        away = np.hypot(line[:, 0] - eye.x, line[:, 1] - eye.y)
        width = np.maximum(LINE_WIDTH * landscape.length, THINNEST * away / eye.focal)
        pixels = raster.project(eye, landscape.ribbon(line, width))
        for left, right in ((0, 3), (1, 2)):  # both edges, at the start and at the end of a quad
            across = pixels[:, left, :2] - pixels[:, right, :2]
            missing = np.maximum(THINNEST - np.hypot(across[:, 0], across[:, 1]), 0.0)
            upward = np.where(across[:, 1] > 0.0, 0.5, -0.5) * missing
            pixels[:, left, 1] += upward
            pixels[:, right, 1] -= upward
        self.quads(pixels, colour, 1.0, NEARER)

    def softened(self) -> Bytes:
        """The finished colours (H, W, 3)."""
        raster.soften(self.colours, EDGE, self._soft)
        return self._soft


class Perspective:
    """The perspective scene of one episode, with an eye that follows the vehicle."""

    def __init__(
        self, shot: Snapshot, terrain: TerrainSource, path: Floats, interval: float
    ) -> None:
        """path (P, 2) [m]: the whole reference; interval [m] between contour lines."""
        self._terrain = terrain
        self.landscape = Landscape.around(terrain, path, shot.sizes.length, interval)
        self._yaw, self._time = shot.state.yaw, shot.time
        self._picture = Picture(WIDTH, HEIGHT)

    def draw(
        self,
        target: Surface,
        shot: Snapshot,
        soil: SoilMap,
        refresh: bool,
        lines: Lines,
        travel: list[float],
    ) -> None:
        """Cover the target; refresh: the soil's colours have changed; lines: paths (P, 2) [m] on
        the ground; travel [m] of both belts.
        """
        if refresh:
            self.landscape.colour(soil, shot)
        picture, pose = self._picture, self._terrain.pose(shot.state)
        elapsed, self._time = max(shot.time - self._time, 0.0), shot.time
        self._yaw += (pose.yaw - self._yaw) * (1.0 - math.exp(-elapsed / LAG))
        eye = self._eye(pose)
        picture.ground(self.landscape.grid, eye)
        slips = shot.state.slip_left, shot.state.slip_right
        loads = None
        if shot.loads is not None:  # of the patches side by side
            loads = canvas.load_colours(shot.loads.mean(axis=2), shot.load_shown)
        faces = vehicle_faces(shot.parameters, self._terrain.centre_height, slips, travel, loads)
        corners, light = pose.place(faces.corners), pose.axes.T @ np.array(LIGHT)
        picture.quads(raster.project(eye, self._shadow(corners)), canvas.INK, SHADE, NEARER)
        for line, colour in (*lines, *self._reference(shot)):
            picture.line(eye, self.landscape, line, colour)
        pixels = raster.project(eye, corners)
        shown, buffers = faces.lit(light.tolist()), (picture.inverse, picture.colours)
        raster.fill_polygons(pixels, faces.starts, shown, 1.0, 0.0, *buffers)
        canvas.paint(target, picture.softened())

    def _eye(self, pose: BodyPose) -> Eye:
        """Behind and above the vehicle at a pose."""
        landscape, length = self.landscape, self.landscape.length
        cosine, sine = math.cos(self._yaw), math.sin(self._yaw)
        x, y = pose.x - BEHIND * length * cosine, pose.y - BEHIND * length * sine
        z = pose.z + ABOVE * length
        share = np.linspace(0.0, 0.9, SAMPLES)  # from the eye to the vehicle
        line = np.stack([x + share * (pose.x - x), y + share * (pose.y - y)], axis=1)
        needed = landscape.heights(line) + CLEARANCE * length * (1.0 - share)
        z = max(z, float(np.max((needed - share * pose.z) / (1.0 - share))))
        focal = 0.5 * WIDTH / math.tan(0.5 * FIELD)
        row = VEHICLE_ROW * HEIGHT - focal * (z - pose.z) / (BEHIND * length)
        near, far = NEAR * length, VIEW * length
        return Eye(x, y, z, cosine, sine, focal, 0.5 * WIDTH, row, near, far)

    def _shadow(self, corners: Floats) -> Floats:
        """Quads (Q, 4, 3) [m] on the ground: the convex hull of where the light puts the corners
        (V, 3) [m] of the vehicle."""
        above = corners[:, 2] - self.landscape.heights(corners[:, :2])
        fallen = corners[:, :2] - above[:, None] * (np.array(LIGHT[:2]) / LIGHT[2])
        rim = fallen[ConvexHull(fallen).vertices]
        ring = resampled(np.concatenate([rim, rim[:1]]), OUTLINE_STEP * self.landscape.length)
        middle, share = rim.mean(axis=0), np.linspace(0.0, 1.0, RINGS)[:, None, None]
        return quads(self.landscape.on_ground(middle + share * (ring - middle)))

    def _reference(self, shot: Snapshot) -> Lines:
        """The outline where the vehicle should be, and a line from there to where it is."""
        length = self.landscape.length
        if shot.distance > GHOST_REACH * length:
            return []
        outline = np.array(footprint(shot.parameters, length))
        ring = resampled(np.concatenate([outline, outline[:1]]), OUTLINE_STEP * length)
        error = resampled(np.array([shot.reference[:2], shot.pose[:2]]), OUTLINE_STEP * length)
        return [(placed(ring, shot.reference), canvas.BLUE), (error, canvas.BLUE)]
