"""`Renderer`: one picture of one vehicle, as an array or in a window."""

import math
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray
from pygame import Surface

from tracked_env import events as parameter_events
from tracked_env.engine.simulation import Simulation
from tracked_env.physics.parameters import PARAMETER_NAMES, SoilParameters
from tracked_env.rendering import canvas, scene
from tracked_env.rendering.canvas import LABELS, Floats, Lines
from tracked_env.rendering.legend import HEIGHT, STRIP_HEIGHT, Legend, TerrainStrip
from tracked_env.rendering.legend import WIDTH as SCENE_WIDTH
from tracked_env.rendering.panel import WIDTH as PANEL_WIDTH
from tracked_env.rendering.panel import Beliefs, Panel
from tracked_env.rendering.perspective import Perspective
from tracked_env.rendering.snapshot import Pose, Snapshot, TerrainSource, path_of, placed, take
from tracked_env.rendering.soil_map import SoilMap, interval_around, value_at
from tracked_env.validation import checked_choice

WIDTH = SCENE_WIDTH + PANEL_WIDTH  # [px] of a picture
PATH_STEP, PATH_POINTS = 0.05, 4000  # [s] between points of the path, and at most that many
MODES = ("human", "rgb_array")
VIEWS = ("top", "3d")
TRAIL_STEP = 0.015  # [contact lengths] between points of the trail
NOTICE_DURATION = 3.0  # [s] a change stays on the screen after it has ended
NOTICE_WEIGHT = 0.01  # [-] smaller changes of an event's weight are not noticed


class History:
    """What a picture shows of the time before it: the driven trail, the belts, latest changes.

    It is filled by the pictures themselves: what happened before the first of them is not known.
    """

    def __init__(self, shot: Snapshot) -> None:
        """Start with the first picture of an episode."""
        self._time = shot.time
        self._points = [shot.pose[:2]]
        self.travel = [0.0, 0.0]  # [m] of the left and the right belt
        self._weights = [self._change(shot, e)[2] for e in range(shot.events.shape[1])]
        self._notices: dict[int, tuple[float, str]] = {}

    @property
    def trail(self) -> Floats:
        """Where the vehicle was, (P, 2) [m], world frame, oldest first."""
        return np.array(self._points)

    def update(self, shot: Snapshot) -> None:
        """Take in the next picture of the episode."""
        elapsed, self._time = shot.time - self._time, shot.time
        speeds = shot.state.sprocket_speed_left, shot.state.sprocket_speed_right
        for side, speed in enumerate(speeds):
            self.travel[side] += elapsed * speed * shot.parameters.sprocket_radius
        (x, y), here = self._points[-1], shot.pose
        if abs(here.x - x) + abs(here.y - y) >= TRAIL_STEP * shot.sizes.length:
            self._points.append(here[:2])
        for e in range(shot.events.shape[1]):
            self._watch(shot, e)

    def notices(self) -> list[str]:
        """What has changed lately, a line for each event."""
        notices, now = self._notices.values(), self._time
        return [line for since, line in notices if now - since < NOTICE_DURATION]

    @staticmethod
    def _change(shot: Snapshot, e: int) -> tuple[str, float, float]:
        """Parameter of event e, its value without the event, and the event's weight in [0, 1]."""
        _, parameter, target = shot.events[0, e, :3]
        name, place = PARAMETER_NAMES[int(parameter)], (shot.time, *shot.pose[:2])
        before, after = (value_at(shot, count, name, *place) for count in (e, e + 1))
        return name, before, (after - before) / (target - before) if target != before else 0.0

    def _watch(self, shot: Snapshot, e: int) -> None:
        """Note when event e acts. A wave acts everywhere, always: it is not news."""
        if shot.events[0, e, 0] == parameter_events.WAVE:
            return
        name, before, weight = self._change(shot, e)
        change = weight - self._weights[e]
        if name not in shot.reads or abs(change) < NOTICE_WEIGHT:
            return
        self._weights[e] = weight
        label, usual = LABELS[name], getattr(shot.nominal, name)
        numbers = [label.number(x, usual) for x in (before, float(shot.events[0, e, 2]))]
        first, last = numbers if change > 0.0 else numbers[::-1]
        self._notices[e] = shot.time, f"{label.label}: {first} → {last} {label.unit}".rstrip()


class _Stage:
    """Data of one episode."""

    def __init__(self, shot: Snapshot, drawing: "Renderer") -> None:
        self.episode = shot.episode
        terrain, length = drawing.terrain, shot.sizes.length
        count = min(math.ceil(shot.duration / PATH_STEP), PATH_POINTS) + 1
        self.times: Floats = np.linspace(0.0, shot.duration, count)
        self.path = path_of(shot, self.times)
        self.goal = _goal(shot)
        self.zoom = canvas.checked_zoom(drawing.zoom, length)
        interval = 1.0 if terrain is None else interval_around(terrain, self.path, length)
        self.soil = SoilMap(shot, self.zoom, drawing.soil_parameter, terrain, interval)
        self.panel = Panel(self.path, self.soil, 1.5 * length)
        self.history = History(shot)
        self.perspective: Perspective | None = None
        if drawing.view == "3d":
            self.perspective = Perspective(shot, terrain or TerrainSource(), self.path, interval)
        self.strip = terrain and TerrainStrip(terrain, self.path, length)

    def lines(self, shot: Snapshot, done: int) -> Lines:
        """Past and future of the reference, the driven path and the goal, each (P, 2) [m]."""
        now, here = np.array([shot.reference[:2]]), np.array([shot.pose[:2]])
        past = np.concatenate([self.path[:done], now])
        future = np.concatenate([now, self.path[done:]])
        behind = np.concatenate([self.history.trail, here])
        lines = [(past, canvas.PALE_BLUE), (future, canvas.BLUE), (behind, canvas.INK)]
        return lines if self.goal is None else [(self.goal, canvas.PURPLE), *lines]


def _goal(shot: Snapshot) -> Floats | None:
    """Outline (P, 2) [m] of the vehicle at the goal of a plan, with an arrowhead; else None."""
    knots = shot.episode.profile.knots
    if not knots.size:
        return None
    front = 0.5 * shot.nominal.contact_length
    outline = scene.footprint(shot.nominal, shot.sizes.length)
    head = [(front, 0.0), (0.0, -0.4 * front), (0.0, 0.4 * front), (front, 0.0)]
    middle = next(k for k, point in enumerate(outline) if point[0] == front) + 1
    ring = np.array([*outline[:middle], *head, *outline[middle:], outline[0]])
    return placed(ring, Pose(*knots[-1, 1:4].tolist()))


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
    ) -> None:
        """Open nothing yet.

        render_mode: "human" or "rgb_array"; fps: [1/s] at most, in a window;
        pixels_per_metre: zoom, by default 80 px for the contact length of the environment's
        vehicle, else 40 to 200 px for it; soil_parameter: the one that colours the ground, by
        default the first of the plant's `soil_map` that varies in the plane, else its first;
        view: "top", from above, or "3d", from behind the vehicle; terrain: what the vehicle drives
        on, shown with its relief and a strip below the scene; None: level ground without them.
        Raises ValueError for anything else; `draw` for a zoom that does not suit the vehicle.
        """
        self.render_mode = checked_choice("render_mode", render_mode, MODES)
        if soil_parameter is not None:
            checked_choice("soil_parameter", soil_parameter, SoilParameters._fields)
        self.view = checked_choice("view", view, VIEWS)
        self.terrain, self.fps = terrain, fps
        self.zoom, self.soil_parameter = pixels_per_metre, soil_parameter
        self._window: pygame.Window | None = None
        self._clock = pygame.time.Clock()
        self._forget()

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy has opened nothing yet and has not seen the pictures before it."""
        options = self.zoom, self.soil_parameter, self.view, self.terrain
        return type(self), (self.render_mode, self.fps, *options)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a picture [px]."""
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
        self._picture: Surface | None = None
        self._stage: _Stage | None = None

    def _compose(self, shot: Snapshot, beliefs: Beliefs | None) -> Surface:
        if self._picture is None:
            self._picture = canvas.surface(*self.size)
        if self._stage is None or shot.episode is not self._stage.episode:
            self._stage = _Stage(shot, self)
        picture, stage = self._picture, self._stage
        stage.history.update(shot)
        refresh = stage.soil.advance(shot)
        ground = picture.subsurface((0, 0, SCENE_WIDTH, HEIGHT))
        done = int(np.searchsorted(stage.times, shot.time, side="right"))
        lines, travel = stage.lines(shot, done), stage.history.travel
        view, zoom, legend = None, None, Legend(ground)
        if stage.perspective is not None:
            stage.perspective.draw(ground, shot, stage.soil, refresh, lines, travel)
        else:
            zoom = stage.zoom
            view = 0.5 * SCENE_WIDTH / zoom, 0.5 * HEIGHT / zoom
            left, top = shot.state.x - view[0], shot.state.y + view[1]
            stage.soil.draw(ground, shot, left, top)
            legend.coordinates(left, top, zoom)
            scene.draw(ground, shot, zoom, lines, travel)
        legend.draw(stage.soil, shot, stage.history.notices(), zoom)
        trail = stage.history.trail
        picture.blit(stage.panel.draw(shot, trail, refresh, view, beliefs), (SCENE_WIDTH, 0))
        if stage.strip is not None:
            picture.blit(stage.strip.draw(shot, done, stage.soil.interval), (0, HEIGHT))
        return picture

    def _show(self, picture: Surface) -> None:
        """Put the picture on the screen and wait for its time."""
        if self._window is None or not pygame.display.get_init():
            pygame.display.init()
            self._window = pygame.Window("tracked_env", self.size)
        self._window.get_surface().blit(picture, (0, 0))
        self._window.flip()
        pygame.event.pump()
        self._clock.tick(self.fps)
