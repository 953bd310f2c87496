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
from tracked_env.rendering.afterglow import Memory
from tracked_env.rendering.panel import WIDTH as PANEL_WIDTH
from tracked_env.rendering.panel import Panel
from tracked_env.rendering.scene import Camera, Points
from tracked_env.rendering.snapshot import Snapshot, take
from tracked_env.rendering.soil_map import SoilMap
from tracked_env.validation import checked_choice

SCENE_WIDTH, SCENE_HEIGHT = 680, 640  # [px]
WIDTH, HEIGHT = SCENE_WIDTH + PANEL_WIDTH, SCENE_HEIGHT  # [px] of a picture
PATH_STEP, PATH_POINTS = 0.05, 4000  # [s] between points of the path, and at most that many
MODES = ("human", "rgb_array")


class _Stage:
    """Data of one episode."""

    def __init__(
        self, shot: Snapshot, text: canvas.Text, pixels_per_metre: int | None, soil: str | None
    ) -> None:
        self.episode = shot.episode
        count = min(math.ceil(shot.duration / PATH_STEP), PATH_POINTS) + 1
        self.times: NDArray[np.float64] = np.linspace(0.0, shot.duration, count)
        path = sample(shot.episode.profile, self.times)
        self.path: Points = np.stack([path.x, path.y], axis=1)
        length = shot.sizes.length
        if pixels_per_metre is None:
            self.zoom = sizes.default_zoom(length)
        else:
            self.zoom = sizes.checked_zoom(pixels_per_metre, length)
        self.soil = SoilMap(shot, self.zoom, soil)
        self.panel = Panel(text, self.path, self.soil, 1.5 * length)
        self.memory = Memory(shot)


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
    ) -> None:
        """Open nothing yet.

        render_mode: "human" or "rgb_array"; fps: [1/s] at most, in a window;
        pixels_per_metre: zoom, by default 80 px for the contact length of the environment's
        vehicle, else 40 to 200 px for it; soil_parameter: the one that colours the ground, by
        default the first of the plant's `soil_map` that varies in the plane, else its first.
        Raises ValueError for anything else; `draw` for a zoom that does not suit the vehicle.
        """
        self.render_mode = checked_choice("render_mode", render_mode, MODES)
        if pixels_per_metre is not None:
            pixels_per_metre = sizes.checked_zoom(pixels_per_metre)
        if soil_parameter is not None:
            checked_choice("soil_parameter", soil_parameter, SoilParameters._fields)
        self.fps = fps
        self._zoom = pixels_per_metre
        self._soil_parameter = soil_parameter
        self._window: pygame.Window | None = None
        self._clock = pygame.time.Clock()
        self._forget()

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy has opened nothing yet and has not seen the pictures before it."""
        return type(self), (self.render_mode, self.fps, self._zoom, self._soil_parameter)

    def draw(self, simulation: Simulation, row: int) -> NDArray[np.uint8] | None:
        """The picture of vehicle `row` (HEIGHT, WIDTH, 3); None in `human` mode.

        Raises gymnasium.error.ResetNeeded before the first episode, and ValueError for a zoom
        that does not suit the vehicle.
        """
        shot = take(simulation, row)
        picture = self._compose(shot)
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

    def _compose(self, shot: Snapshot) -> pygame.Surface:
        if self._picture is None:
            self._picture = canvas.surface(WIDTH, HEIGHT)
        if self._stage is None or shot.episode is not self._stage.episode:
            self._stage = _Stage(shot, self._text, self._zoom, self._soil_parameter)
        picture, stage = self._picture, self._stage
        stage.memory.update(shot)
        refresh = stage.soil.advance(shot)
        ground = picture.subsurface((0, 0, SCENE_WIDTH, SCENE_HEIGHT))
        half_width, half_height = 0.5 * SCENE_WIDTH / stage.zoom, 0.5 * SCENE_HEIGHT / stage.zoom
        left, top = shot.state.x - half_width, shot.state.y + half_height
        stage.soil.draw(ground, shot, left, top)
        legend.coordinates(ground, self._text, left, top, stage.zoom)
        self._things(ground, stage, shot)
        legend.draw(ground, self._text, stage.soil, shot, stage.memory.notices(), stage.zoom)
        view = half_width, half_height
        picture.blit(stage.panel.draw(shot, stage.memory, refresh, view), (SCENE_WIDTH, 0))
        return picture

    def _things(self, ground: pygame.Surface, stage: _Stage, shot: Snapshot) -> None:
        """Objects on the ground, from the lowest to the highest."""
        width, height = ground.get_size()
        camera = Camera(shot.state.x, shot.state.y, stage.zoom, 0.5 * width, 0.5 * height)
        now, here = np.array([shot.reference[:2]]), np.array([shot.pose[:2]])
        done = int(np.searchsorted(stage.times, shot.time, side="right"))
        past = np.concatenate([stage.path[:done], now])
        future = np.concatenate([now, stage.path[done:]])
        driven = np.concatenate([stage.memory.trail, here])
        scene.path(ground, camera, past, canvas.PALE_BLUE, 3)
        scene.path(ground, camera, future, canvas.BLUE, 3)
        scene.path(ground, camera, driven, canvas.INK, 3)
        scene.ghost_shade(ground, camera, shot)
        scene.vehicle(ground, camera, shot, stage.memory.travel)
        scene.ghost(ground, camera, shot)

    def _show(self, picture: pygame.Surface) -> None:
        """Put the picture on the screen and wait for its time."""
        if self._window is None or not pygame.display.get_init():
            pygame.display.init()
            self._window = pygame.Window("tracked_env", (WIDTH, HEIGHT))
        self._window.get_surface().blit(picture, (0, 0))
        self._window.flip()
        pygame.event.pump()
        self._clock.tick(self.fps)
