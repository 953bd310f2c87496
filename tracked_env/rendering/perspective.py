"""The scene from behind the vehicle: ground, paths, vehicle and reference, with a depth buffer."""

import numpy as np
import pygame
from numpy.typing import NDArray

from tracked_env.rendering import canvas, raster
from tracked_env.rendering.canvas import Bytes, Colour
from tracked_env.rendering.chase_camera import ChaseCamera, StandingCamera
from tracked_env.rendering.landscape import Landscape, resampled
from tracked_env.rendering.raster import Eye
from tracked_env.rendering.scene import GHOST_REACH, footprint
from tracked_env.rendering.snapshot import Pose, Snapshot
from tracked_env.rendering.soil_map import SoilMap
from tracked_env.rendering.terrain_source import BodyPose, TerrainSource, pose_of
from tracked_env.rendering.vehicle_mesh import vehicle_faces

Points = NDArray[np.float64]

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
