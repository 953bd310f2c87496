"""`Renderer`: one picture of one vehicle, as an array or in a window."""

import math
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

from tracked_env.engine.simulation import Simulation
from tracked_env.physics.parameters import SoilParameters
from tracked_env.references import sample
from tracked_env.rendering import canvas, legend, scene, sizes
from tracked_env.rendering import legend as tile
from tracked_env.rendering.legend import HEIGHT_TERRAIN_STRIP as STRIP_HEIGHT
from tracked_env.rendering.legend import TerrainStrip
from tracked_env.rendering.panel import WIDTH as PANEL_WIDTH
from tracked_env.rendering.panel import Beliefs, Panel
from tracked_env.rendering.perspective import Perspective, interval_around
from tracked_env.rendering.scene import Camera, Memory, Points
from tracked_env.rendering.snapshot import Snapshot, TerrainSource, take
from tracked_env.rendering.soil_map import SoilMap
from tracked_env.validation import checked_choice

SCENE_WIDTH, SCENE_HEIGHT = 680, 640  # [px]
WIDTH, HEIGHT = SCENE_WIDTH + PANEL_WIDTH, SCENE_HEIGHT  # [px] of a picture
PATH_STEP, PATH_POINTS = 0.05, 4000  # [s] between points of the path, and at most that many
MODES = ("human", "rgb_array")
VIEWS = ("top", "3d", "3d-standing")
LAYOUTS = ("panel", "tile")
MOST_PANELS = 4  # vehicles of a simulation that are drawn with their panels


class _Stage:
    """Data of one episode."""

    def __init__(
        self,
        shot: Snapshot,
        text: canvas.Text,
        pixels_per_metre: int | None,
        soil: str | None,
        view: str,
        terrain: TerrainSource | None,
    ) -> None:
        self.episode = shot.episode
        count = min(math.ceil(shot.duration / PATH_STEP), PATH_POINTS) + 1
        self.times: NDArray[np.float64] = np.linspace(0.0, shot.duration, count)
        path = sample(shot.episode.profile, self.times)
        self.path: Points = np.stack([path.x, path.y], axis=1)
        self.goal = _goal(shot)
        length = shot.sizes.length
        if pixels_per_metre is None:
            self.zoom = sizes.default_zoom(length)
        else:
            self.zoom = sizes.checked_zoom(pixels_per_metre, length)
        interval = 1.0 if terrain is None else interval_around(terrain, self.path, length)
        self.soil = SoilMap(shot, self.zoom, soil, terrain, interval)
        self.panel = Panel(text, self.path, self.soil, 1.5 * length)
        self.memory = Memory(shot)
        self.perspective: Perspective | None = None
        if view != "top":
            source, standing = terrain or TerrainSource(), view == "3d-standing"
            self.perspective = Perspective(shot, source, self.path, interval, standing)
        self.strip: TerrainStrip | None = None
        if terrain is not None:
            self.strip = TerrainStrip(text, terrain, self.path, length)


def _lines(stage: _Stage, shot: Snapshot, done: int) -> list[tuple[Points, canvas.Colour]]:
    """Past and future of the reference, the driven path and the goal, each (P, 2) [m]."""
    now, here = np.array([shot.reference[:2]]), np.array([shot.pose[:2]])
    past = np.concatenate([stage.path[:done], now])
    future = np.concatenate([now, stage.path[done:]])
    driven = np.concatenate([stage.memory.trail, here])
    lines = [(past, canvas.PALE_BLUE), (future, canvas.BLUE), (driven, canvas.INK)]
    return lines if stage.goal is None else [(stage.goal, canvas.PURPLE), *lines]


def _goal(shot: Snapshot) -> Points | None:
    """Outline (P, 2) [m] of the vehicle at the goal of a plan, with an arrowhead; else None."""
    knots = shot.episode.profile.knots
    if not knots.size:
        return None
    x, y, yaw = knots[-1, 1:4].tolist()
    front = 0.5 * shot.nominal.contact_length
    outline = scene.footprint(shot.nominal, shot.sizes.length)
    head = [(front, 0.0), (0.0, -0.4 * front), (0.0, 0.4 * front), (front, 0.0)]
    middle = next(k for k, point in enumerate(outline) if point[0] == front) + 1
    drawn = np.array([*outline[:middle], *head, *outline[middle:], outline[0]])
    corners = drawn[:, 0] + 1j * drawn[:, 1]
    place = x + 1j * y + corners * np.exp(1j * yaw)
    return np.column_stack([place.real, place.imag])


class Renderer:
    """Draws one row of a `Simulation`; give every row a renderer of its own.

    The picture follows from the state and from the pictures of the episode before it (trail,
    belts, notices): the same calls give the same pixels. In `rgb_array` mode no window is
    opened and no display is needed.
    """

    def __init__(
        self,
        render_mode: str,
        fps: int,
        pixels_per_metre: int | None = None,
        soil_parameter: str | None = None,
        view: str = "top",
        terrain: TerrainSource | None = None,
        layout: str | None = None,
    ) -> None:
        """Open nothing yet.

        render_mode: "human" or "rgb_array"; fps: [1/s] at most, in a window;
        pixels_per_metre: zoom, by default 80 px for the contact length of the environment's
        vehicle, else 40 to 200 px for it; soil_parameter: the one that colours the ground, by
        default the first of the plant's `soil_map` that varies in the plane, else its first;
        view: "top", from above; "3d", from behind the vehicle, or "3d-standing", from places behind
        it that change where it leaves the middle of the picture; terrain: what the vehicle drives
        on, shown with its relief and a strip below the scene; None: level ground without them;
        layout: "panel", the scene with all numbers beside it, or "tile", the scene with a few
        large ones, for films of many vehicles; None: a tile where the simulation has more than
        MOST_PANELS vehicles.
        Raises ValueError for anything else; `draw` for a zoom that does not suit the vehicle.
        """
        self.render_mode = checked_choice("render_mode", render_mode, MODES)
        if pixels_per_metre is not None:
            pixels_per_metre = sizes.checked_zoom(pixels_per_metre)
        if soil_parameter is not None:
            checked_choice("soil_parameter", soil_parameter, SoilParameters._fields)
        self.view = checked_choice("view", view, VIEWS)
        self.terrain = terrain
        if layout is not None:
            checked_choice("layout", layout, LAYOUTS)
        self._layout = layout
        self._is_tile = layout == "tile"
        self.fps = fps
        self._zoom = pixels_per_metre
        self._soil_parameter = soil_parameter
        self._window: pygame.Window | None = None
        self._clock = pygame.time.Clock()
        self._forget()

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy has opened nothing yet and has not seen the pictures before it."""
        return type(self), (
            self.render_mode, self.fps, self._zoom, self._soil_parameter, self.view, self.terrain,
            self._layout,
        )  # fmt: skip

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a picture [px]; by the number of vehicles from the first one on."""
        if self._is_tile:
            return SCENE_WIDTH, SCENE_HEIGHT
        return WIDTH, HEIGHT + (0 if self.terrain is None else STRIP_HEIGHT)

    def draw(
        self, simulation: Simulation, row: int, beliefs: Beliefs | None = None
    ) -> NDArray[np.uint8] | None:
        """The picture of vehicle `row` (height, width, 3), see `size`; None in `human` mode.

        beliefs: what a policy believes of the parameters, {name: (value, standard deviation)} SI;
        the panel shows them with their 95 % bands beside the truth.
        Raises gymnasium.error.ResetNeeded before the first episode, and ValueError for a zoom
        that does not suit the vehicle.
        """
        shot = take(simulation, row)
        if self._picture is None and self._layout is None:
            self._is_tile = len(simulation.episodes) > MOST_PANELS
        if self.terrain is not None and self.terrain.loads is not None:
            shot = shot._replace(loads=self.terrain.loads(simulation, row))
        picture = self._compose(shot, beliefs)
        if self.render_mode == "rgb_array":
            return canvas.to_array(picture)
        self._show(picture)
        return None

    def close(self) -> None:
        """Close the window and forget everything; drawing again starts afresh."""
        if self._window is not None and pygame.display.get_init():
            self._window.destroy()
        self._window = None
        self._forget()

    def _forget(self) -> None:
        self._picture: pygame.Surface | None = None
        self._text = canvas.Text()
        self._stage: _Stage | None = None

    def _compose(self, shot: Snapshot, beliefs: Beliefs | None) -> pygame.Surface:
        if self._picture is None:
            self._picture = canvas.surface(*self.size)
        if self._stage is None or shot.episode is not self._stage.episode:
            self._stage = _Stage(
                shot, self._text, self._zoom, self._soil_parameter, self.view, self.terrain
            )
        picture, stage = self._picture, self._stage
        stage.memory.update(shot)
        refresh = stage.soil.advance(shot)
        ground = picture.subsurface((0, 0, SCENE_WIDTH, SCENE_HEIGHT))
        done = int(np.searchsorted(stage.times, shot.time, side="right"))
        lines = _lines(stage, shot, done)
        view, zoom = None, None
        if stage.perspective is not None:
            travel = stage.memory.travel
            stage.perspective.draw(ground, shot, stage.soil, refresh, lines, travel)
        else:
            zoom = stage.zoom
            view = 0.5 * SCENE_WIDTH / zoom, 0.5 * SCENE_HEIGHT / zoom
            self._from_above(ground, stage, shot, lines, view)
        notices = stage.memory.notices()
        if self._is_tile:
            tile.draw_tile(ground, self._text, shot, notices)
            return picture
        legend.draw(ground, self._text, stage.soil, shot, notices, zoom)
        panel = stage.panel.draw(shot, stage.memory, refresh, view, beliefs)
        picture.blit(panel, (SCENE_WIDTH, 0))
        if stage.strip is not None:
            strip = stage.strip.draw(shot, done, stage.soil.interval)
            picture.blit(strip, (0, SCENE_HEIGHT))
        return picture

    def _from_above(
        self,
        ground: pygame.Surface,
        stage: _Stage,
        shot: Snapshot,
        lines: list[tuple[Points, canvas.Colour]],
        view: tuple[float, float],
    ) -> None:
        """Soil map and objects on it, from the lowest to the highest; view [m]: half the scene."""
        left, top = shot.state.x - view[0], shot.state.y + view[1]
        stage.soil.draw(ground, shot, left, top)
        if not self._is_tile:
            legend.coordinates(ground, self._text, left, top, stage.zoom)
        width, height = ground.get_size()
        camera = Camera(shot.state.x, shot.state.y, stage.zoom, 0.5 * width, 0.5 * height)
        for points, colour in lines:
            scene.path(ground, camera, points, colour, 3)
        scene.ghost_shade(ground, camera, shot)
        scene.vehicle(ground, camera, shot, stage.memory.travel)
        scene.ghost(ground, camera, shot)

    def _show(self, picture: pygame.Surface) -> None:
        """Put the picture on the screen and wait for its time."""
        if self._window is None or not pygame.display.get_init():
            pygame.display.init()
            self._window = pygame.Window("tracked_env", self.size)
        self._window.get_surface().blit(picture, (0, 0))
        self._window.flip()
        pygame.event.pump()
        self._clock.tick(self.fps)
