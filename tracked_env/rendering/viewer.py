"""An episode as a page for a browser, with `viser`: it needs neither server nor network.

`Recorder` collects the episode as arrays, `write_html` writes the page, which runs from disk and
has its own time line. Ground and vehicle are the meshes of `perspective`; their colours carry the
light of the pictures, so the scene has ambient light alone.
"""

import contextlib
import io
import math
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from tracked_env.engine.simulation import Simulation
from tracked_env.physics.parameters import PlantParameters
from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Bytes, Floats
from tracked_env.rendering.perspective import HORIZON, Landscape
from tracked_env.rendering.scene import Faces, footprint, vehicle_faces
from tracked_env.rendering.snapshot import (
    BodyPose,
    Pose,
    Snapshot,
    TerrainSource,
    path_of,
    placed,
    take,
)
from tracked_env.rendering.soil_map import SoilMap, interval_around

AROUND = 6.0  # [contact lengths] of ground around the path
MESH_POINTS = 2.5e4  # [-] heights of the ground at most
IMAGE_PIXELS = 1.0e6  # [-] of the picture on it
PATH_STEP = 0.1  # [s] between points of the reference
PORT = 8080  # [-] first one that is tried while the page is written, at 127.0.0.1
RATE = 20.0  # [1/s] instants of a recording that are shown
LIFT = 0.03  # [contact lengths] of lines above the ground
FIELD = 8  # [px] side of the field of a colour in a common picture
AMBIENT = 2.3  # intensity at which colours look as in the pictures


class Recording(NamedTuple):
    """One episode; T instants."""

    times: Floats  # (T,) [s]
    poses: Floats  # (T, 6) x, y, z [m], yaw, pitch, roll [rad]
    references: Floats  # (T, 3) x, y [m], yaw [rad]
    path: Floats  # (P, 2) [m] of the reference
    parameters: PlantParameters
    centre_height: float  # [m] of the centre of mass above the underside of the tracks
    ground: Landscape
    picture: Bytes  # (H, W, 3) of the ground, first row in the north


class Recorder:
    """Collects one episode of one row of a simulation."""

    def __init__(self, terrain: TerrainSource | None = None) -> None:
        """terrain: what the vehicle drives on; None: level ground."""
        self._terrain = terrain or TerrainSource()
        self._shots: list[Snapshot] = []

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

    def finish(self) -> Recording:
        """The recording; raises ValueError without an instant."""
        if not self._shots:
            raise ValueError("recorded instants = 0; must be >= 1. Call add() after reset()")
        shots, first = self._shots, self._shots[0]
        count = math.ceil(first.duration / PATH_STEP) + 1
        path = path_of(first, np.linspace(0.0, first.duration, count))
        return Recording(
            np.array([shot.time for shot in shots]),
            np.array([self._terrain.pose(shot.state) for shot in shots]),
            np.array([shot.reference for shot in shots]),
            path,
            first.nominal,
            self._terrain.centre_height,
            *self._ground(path),
        )

    def _ground(self, path: Floats) -> tuple[Landscape, Bytes]:
        """The ground around path and vehicle, and its colours from above with relief."""
        shot, terrain = self._shots[0], self._terrain
        length = shot.sizes.length
        everywhere = np.concatenate([path, [s.pose[:2] for s in self._shots]])
        low = everywhere.min(axis=0) - AROUND * length
        high = everywhere.max(axis=0) + AROUND * length
        cell = max(0.1 * length, math.sqrt(float(np.prod(high - low)) / MESH_POINTS))
        interval = interval_around(terrain, path, length)
        ground = Landscape(terrain, low, high, cell, length, interval)
        soil = SoilMap(shot, canvas.default_zoom(length), None, terrain, interval)
        soil.advance(shot)
        height, width = cell * (np.array(ground.grid.heights.shape) - 1)  # [m]
        pixel = math.sqrt(width * height / IMAGE_PIXELS)
        rows, columns = math.floor(height / pixel), math.floor(width / pixel)
        xs = ground.grid.x + width * (np.arange(columns) + 0.5) / columns
        ys = ground.grid.y + height * (1.0 - (np.arange(rows) + 0.5) / rows)
        top = ground.grid.y + float(height)
        return ground, soil.with_relief(soil.image(shot, xs, ys), ground.grid.x, top, pixel)


def _mesh(corners: Floats, faces: NDArray[np.int64], uv: Floats, image: Bytes) -> Any:
    """Triangles with a picture (H, W, 3) at texture coordinates uv (V, 2), without gloss."""
    import trimesh

    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(image), metallicFactor=0.0, roughnessFactor=1.0
    )
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(corners, faces, visual=visual, process=False)


def _ground_mesh(recording: Recording) -> Any:
    """The ground with its picture."""
    grid, cell = recording.ground.grid, recording.ground.cell
    rows, columns = grid.heights.shape
    x, y = grid.x + cell * np.arange(columns), grid.y + cell * np.arange(rows)
    places = np.stack([*np.meshgrid(x, y), grid.heights.astype(np.float64)], axis=-1)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    low = np.stack([corner, corner + 1, corner + columns + 1], axis=1)
    high = np.stack([corner, corner + columns + 1, corner + columns], axis=1)
    uv = np.stack(np.meshgrid(np.linspace(0.0, 1.0, columns), np.linspace(0.0, 1.0, rows)), axis=-1)
    faces = np.concatenate([low, high])
    return _mesh(places.reshape(-1, 3), faces, uv.reshape(-1, 2), recording.picture)


def _solid(faces: Faces) -> Any:
    """Polygons as a mesh whose colours carry the light: each has a field of a common picture."""
    colours = faces.lit()
    triangles, fields = [], []
    for k, (start, end) in enumerate(pairwise(faces.starts)):
        corners = faces.corners[start:end]
        for m in range(1, len(corners) - 1):
            triangles += [corners[[0, m, m + 1]], corners[[0, m + 1, m]]]  # seen from both sides
            fields += [k, k]
    side = math.ceil(math.sqrt(len(colours)))
    palette = np.zeros((side * side, 3), dtype=np.uint8)
    palette[: len(colours)] = colours
    image = palette.reshape(side, side, 3).repeat(FIELD, 0).repeat(FIELD, 1)
    row, column = np.divmod(np.repeat(fields, 3), side)
    uv = np.stack([(column + 0.5) / side, 1.0 - (row + 0.5) / side], axis=1)
    order = np.arange(3 * len(fields)).reshape(-1, 3)
    return _mesh(np.concatenate(triangles), order, uv, image)


class Stage:
    """The scene of a recording on a server, at one instant."""

    def __init__(self, server: Any, recording: Recording) -> None:
        """Put everything on the server that stays the same."""
        self.recording, self._length = recording, recording.parameters.contact_length
        scene, p = server.scene, recording.parameters
        scene.set_up_direction("+z")
        scene.world_axes.visible = False
        scene.configure_default_lights(False)
        scene.configure_environment_map(None)
        scene.add_light_ambient("/light", intensity=AMBIENT)
        scene.set_background_image(np.tile(np.array(HORIZON, dtype=np.uint8), (8, 8, 1)))
        scene.add_mesh_trimesh("/ground", _ground_mesh(recording))
        for name, line, colour in (
            ("/reference", recording.path, canvas.BLUE),
            ("/driven", recording.poses[:, :2], canvas.INK),
        ):
            self._line(scene, name, recording.ground.on_ground(line, LIFT), colour)
        body = vehicle_faces(p, recording.centre_height)
        self._vehicle = scene.add_mesh_trimesh("/vehicle", _solid(body))
        outline = footprint(p, self._length)
        self._ghost = scene.add_frame("/reference_pose", show_axes=False)
        flat = np.insert(np.array([*outline, outline[0]]), 2, 0.0, axis=1)
        self._line(scene, "/reference_pose/outline", flat, canvas.BLUE)
        self._look(server.initial_camera, recording.ground.on_ground(recording.path, LIFT))
        self.move(0)

    def move(self, instant: int) -> None:
        """Show an instant of the recording."""
        pose = BodyPose(*self.recording.poses[instant].tolist())
        turn = Rotation.from_euler("ZYX", pose[3:])
        self._vehicle.position, self._vehicle.wxyz = pose[:3], turn.as_quat(scalar_first=True)
        self._ghost.position, self._ghost.wxyz = self._lying(self.recording.references[instant])

    @staticmethod
    def _line(scene: Any, name: str, points: Floats, colour: canvas.Colour) -> None:
        """A line through points (P, 3) [m], 3 px wide."""
        segments = np.stack([points[:-1], points[1:]], axis=1)
        scene.add_line_segments(name, segments, colour, thickness=3.0, thickness_units="screen")

    def _lying(self, reference: Floats) -> tuple[Floats, Floats]:
        """Position [m] and quaternion of the reference pose on the slope under it."""
        (x, y, yaw), reach = reference.tolist(), 0.4 * self._length
        around = reach * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
        h = self.recording.ground.heights(placed(around, Pose(x, y, yaw)))
        pitch = -math.atan2(h[1] - h[2], 2.0 * reach)
        roll = math.atan2((h[3] - h[4]) * math.cos(pitch), 2.0 * reach)
        turn = Rotation.from_euler("ZYX", [yaw, pitch, roll])
        return np.array([x, y, h[0] + LIFT * self._length]), turn.as_quat(scalar_first=True)

    def _look(self, camera: Any, path: Floats) -> None:
        """The first camera: the whole path, from the south and from above."""
        low, high = path.min(axis=0), path.max(axis=0)
        middle = 0.5 * (low + high) * (1.0, 1.0, 0.0) + (0.0, 0.0, low[2])
        away = 0.75 * float(np.linalg.norm(high - low)) + 3.0 * self._length
        camera.up, camera.fov = (0.0, 0.0, 1.0), math.radians(50.0)
        camera.look_at = tuple(middle.tolist())
        camera.position = tuple((middle + away * np.array([-0.25, -0.95, 0.75])).tolist())


def instants(recording: Recording) -> NDArray[np.int64]:
    """Indices of about RATE instants a second, the first and the last among them."""
    times = recording.times
    count = max(round(float(times[-1] - times[0]) * RATE), 1) + 1
    even = np.linspace(times[0], times[-1], count)
    return np.unique(np.searchsorted(times, even - 1e-9).clip(0, len(times) - 1))


def write_html(recording: Recording, path: Path) -> None:
    """Write the recording as one page that needs neither server nor network.

    Raises ImportError that says what to install.
    """
    try:
        import viser
    except ImportError as error:
        install = 'pip install "tracked-env[viewer]"'
        raise ImportError(f"the viewer needs viser, which is not installed: {install}") from error
    with contextlib.redirect_stdout(io.StringIO()):  # it prints its address at any verbosity
        server = viser.ViserServer(host="127.0.0.1", port=PORT, verbose=False)
    try:
        stage = Stage(server, recording)
        record = server.get_scene_serializer()
        steps = instants(recording).tolist()
        for instant, following in zip(steps, [*steps[1:], steps[-1]], strict=True):
            stage.move(instant)
            record.insert_sleep(float(recording.times[following] - recording.times[instant]))
        page = record.as_html()
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8")
