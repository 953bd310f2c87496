"""A recording in the browser with `viser`: live with a slider, or as one file without a server.

`show` serves it at 127.0.0.1 until it is interrupted. `write_html` writes a page that runs from
disk and has its own time line; controls of the live page are not in it. In both the driven path
grows: it consists of pieces that are shown in turn. Colours carry the light of the pictures, so
the scene has ambient light alone.

One episode as arrays, for a viewer that shows any instant: poses, errors, loads, ground.
"""

import contextlib
import io
import math
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from tracked_env.engine.simulation import Simulation
from tracked_env.physics.parameters import PlantParameters
from tracked_env.references import sample
from tracked_env.rendering import canvas, sizes
from tracked_env.rendering.canvas import Bytes
from tracked_env.rendering.perspective import HORIZON, height_grid, interval_around
from tracked_env.rendering.scene import Faces, footprint, vehicle_faces
from tracked_env.rendering.snapshot import Snapshot, TerrainSource, pose_of, take
from tracked_env.rendering.soil_map import SoilMap

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


HOST = "127.0.0.1"  # the page is not visible on the network
PORT = 8080  # [-] first one that is tried
RATE = 20.0  # [1/s] instants of a recording that are shown
PIECES = 60  # [-] at most, of the driven path
LIFT = 0.03  # [contact lengths] of lines above the ground
FIELD = 8  # [px] side of the field of a colour in a common picture
LINE = 3.0  # [px] width of lines
AMBIENT = 2.3  # intensity at which colours look as in the pictures
SPEEDS = ("0.25", "0.5", "1", "2", "4")  # of the live page's clock
MISSING = 'the viewer needs viser, which is not installed: pip install "tracked-env[viewer]"'


def check_installed() -> None:
    """Raise ImportError that says what to install where viser is missing."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise ImportError(MISSING) from error


def _server(port: int) -> Any:
    """A server that only this machine reaches; raises ImportError as `check_installed`."""
    check_installed()
    import viser

    with contextlib.redirect_stdout(io.StringIO()):  # it prints its address at any verbosity
        return viser.ViserServer(host=HOST, port=port, verbose=False)


def _stop(server: Any) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def _ground(relief: Relief) -> Any:
    """The ground as a mesh with its picture."""
    import trimesh

    rows, columns = relief.heights.shape
    x = relief.x + relief.cell * np.arange(columns)
    y = relief.y + relief.cell * np.arange(rows)
    places = np.stack([*np.meshgrid(x, y), relief.heights.astype(np.float64)], axis=-1)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    low = np.stack([corner, corner + 1, corner + columns + 1], axis=1)
    high = np.stack([corner, corner + columns + 1, corner + columns], axis=1)
    u, v = np.meshgrid(np.linspace(0.0, 1.0, columns), np.linspace(0.0, 1.0, rows))
    visual = _painted(np.stack([u.ravel(), v.ravel()], axis=1), relief.picture)
    faces = np.concatenate([low, high])
    return trimesh.Trimesh(places.reshape(-1, 3), faces, visual=visual, process=False)


def _solid(faces: Faces) -> Any:
    """Polygons as a mesh whose colours carry the light: each has a field of a common picture."""
    import trimesh

    colours = faces.lit()
    triangles, fields = [], []
    for k in range(len(colours)):
        corners = faces.corners[faces.starts[k] : faces.starts[k + 1]]
        for m in range(1, len(corners) - 1):
            triangles += [corners[[0, m, m + 1]], corners[[0, m + 1, m]]]  # seen from both sides
            fields += [k, k]
    side = math.ceil(math.sqrt(len(colours)))
    palette = np.zeros((side * side, 3), dtype=np.uint8)
    palette[: len(colours)] = colours
    image = palette.reshape(side, side, 3).repeat(FIELD, 0).repeat(FIELD, 1)
    row, column = np.divmod(np.repeat(fields, 3), side)
    uv = np.stack([(column + 0.5) / side, 1.0 - (row + 0.5) / side], axis=1)
    order = np.arange(len(uv)).reshape(-1, 3)
    return trimesh.Trimesh(
        np.concatenate(triangles), order, visual=_painted(uv, image), process=False
    )


def _painted(uv: FloatArray, image: canvas.Bytes) -> Any:
    """A picture (H, W, 3) on a mesh with the texture coordinates uv (V, 2), without gloss."""
    import trimesh

    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(image), metallicFactor=0.0, roughnessFactor=1.0
    )
    return trimesh.visual.TextureVisuals(uv=uv, material=material)


def _segments(points: FloatArray) -> FloatArray:
    """Line segments (P - 1, 2, 3) of a line (P, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)


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
        scene.add_mesh_trimesh("/ground", _ground(recording.relief))
        path = self._on_ground(recording.path)
        self._line(scene, "/reference", path, canvas.BLUE)
        self._pieces = self._trail(scene)
        body = vehicle_faces(p, recording.terrain.centre_height, (0.0, 0.0), (0.0, 0.0))
        self._vehicle = scene.add_mesh_trimesh("/vehicle", _solid(body))
        outline = np.array([*footprint(p, self._length), footprint(p, self._length)[0]])
        self._ghost = scene.add_frame("/reference_pose", show_axes=False)
        flat = np.insert(outline, 2, 0.0, axis=1)
        self._line(scene, "/reference_pose/outline", flat, canvas.BLUE)
        self._label = scene.add_label("/numbers", "", anchor="bottom-center")
        self._look(server, path)
        self.move(0)

    def move(self, instant: int) -> None:
        """Show an instant of the recording."""
        recording = self.recording
        x, y, z, yaw, pitch, roll = recording.poses[instant].tolist()
        turn = Rotation.from_euler("ZYX", [yaw, pitch, roll])
        self._vehicle.position = (x, y, z)
        self._vehicle.wxyz = turn.as_quat(scalar_first=True)
        self._ghost.position, self._ghost.wxyz = self._lying(recording.references[instant])
        for first, piece in self._pieces:
            if piece.visible != (first < instant):
                piece.visible = first < instant
        self._label.position = (x, y, z + 0.9 * self._length)
        self._label.text = self.numbers(instant)

    def numbers(self, instant: int) -> str:
        """Time, speed, position error, tilt and, where they are known, loads at an instant."""
        r = self.recording
        pitch, roll = r.poses[instant, 4:]
        tilt = math.degrees(math.acos(min(math.cos(pitch) * math.cos(roll), 1.0)))
        parts = [
            f"{r.times[instant]:.1f} s", f"{r.speeds[instant]:.2f} m/s",
            f"error {r.distances[instant]:.2f} m", f"tilt {tilt:.0f}°",
        ]  # fmt: skip
        if r.loads is not None:
            left, right = r.loads[instant] / 1e3
            parts.append(f"loads {left:.1f} | {right:.1f} kN")
        return " · ".join(parts)

    def _heights(self, points: FloatArray) -> FloatArray:
        """Heights (P,) [m] of the terrain at places (P, 2) [m]."""
        return self.recording.terrain.checked_heights(points[:, 0], points[:, 1])

    def _on_ground(self, points: FloatArray) -> FloatArray:
        heights = self._heights(points) + LIFT * self._length
        return np.column_stack([points, heights])

    def _line(self, scene: Any, name: str, points: FloatArray, colour: canvas.Colour) -> Any:
        return scene.add_line_segments(
            name, _segments(points), colour, thickness=LINE, thickness_units="screen"
        )

    def _trail(self, scene: Any) -> list[tuple[int, Any]]:
        """Pieces of the driven path, each with the instant at which it begins."""
        points = self._on_ground(self.recording.poses[:, :2])
        count = len(points)
        cuts = np.unique(np.linspace(0, count - 1, min(PIECES, count)).astype(int)).tolist()
        pieces = []
        for first, last in pairwise(cuts):
            part = points[first : last + 1]
            piece = self._line(scene, f"/driven/{first:05d}", part, canvas.INK)
            piece.visible = False
            pieces.append((last - 1, piece))
        return pieces

    def _lying(self, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position [m] and quaternion of the reference pose on the slope under it."""
        x, y, yaw = reference.tolist()
        reach = 0.4 * self._length
        ahead, aside = (
            np.array([math.cos(yaw), math.sin(yaw)]),
            np.array([-math.sin(yaw), math.cos(yaw)]),
        )
        places = np.array([x, y]) + reach * np.array([0.0 * ahead, ahead, -ahead, aside, -aside])
        h = self._heights(places)
        pitch = -math.atan2(h[1] - h[2], 2.0 * reach)
        roll = math.atan2((h[3] - h[4]) * math.cos(pitch), 2.0 * reach)
        turn = Rotation.from_euler("ZYX", [yaw, pitch, roll])
        return np.array([x, y, h[0] + LIFT * self._length]), turn.as_quat(scalar_first=True)

    def _look(self, server: Any, path: FloatArray) -> None:
        """The first camera: the whole path, from the south and from above."""
        low, high = path.min(axis=0), path.max(axis=0)
        middle = 0.5 * (low + high) * (1.0, 1.0, 0.0) + (0.0, 0.0, low[2])
        away = 0.75 * float(np.linalg.norm(high - low)) + 3.0 * self._length
        camera = server.initial_camera
        camera.up = (0.0, 0.0, 1.0)
        camera.fov = math.radians(50.0)
        camera.look_at = tuple(middle.tolist())
        camera.position = tuple((middle + away * np.array([-0.25, -0.95, 0.75])).tolist())


def instants(recording: Recording) -> NDArray[np.int64]:
    """Indices of about RATE instants a second, the first and the last among them."""
    times = recording.times
    count = max(round(float(times[-1] - times[0]) * RATE), 1) + 1
    wanted = np.linspace(times[0], times[-1], count)
    return np.unique(np.searchsorted(times, wanted - 1e-9).clip(0, len(times) - 1))


def write_html(recording: Recording, path: Path) -> None:
    """Write the recording as one page that needs neither server nor network.

    Raises ImportError that says what to install.
    """
    server = _server(PORT)
    try:
        stage = Stage(server, recording)
        record = server.get_scene_serializer()
        shown = instants(recording).tolist()
        for instant, following in zip(shown, [*shown[1:], shown[-1]], strict=True):
            stage.move(instant)
            record.insert_sleep(float(recording.times[following] - recording.times[instant]))
        page = record.as_html()
    finally:
        _stop(server)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8")


def show(recording: Recording, port: int = PORT, until: Callable[[], bool] = lambda: False) -> None:
    """Serve the recording at 127.0.0.1 with slider and play button, until interrupted.

    port: the first one that is tried; until: asked often, True ends it. Raises ImportError that
    says what to install.
    """
    server = _server(port)
    try:
        server.gui.configure_theme(show_share_button=False, show_logo=False)
        stage = Stage(server, recording)
        times = recording.times
        print(
            f"http://{HOST}:{server.get_port()} shows {times[-1]:g} s; Ctrl+C ends it", flush=True
        )
        slider = server.gui.add_slider(
            "time [s]", float(times[0]), max(float(times[-1]), float(times[0]) + 1e-3), 0.01,
            float(times[0]),
        )  # fmt: skip
        playing = server.gui.add_checkbox("play", True)
        speed = server.gui.add_dropdown("speed", SPEEDS, initial_value="1")
        follow = server.gui.add_checkbox("follow the vehicle", False)
        last = time.monotonic()
        while not until():
            time.sleep(1.0 / RATE)
            now = time.monotonic()
            elapsed, last = now - last, now
            if playing.value:
                later = slider.value + elapsed * float(speed.value)
                slider.value = float(times[0]) if later > times[-1] else later
            instant = int(np.searchsorted(times, slider.value).clip(0, len(times) - 1))
            stage.move(instant)
            if follow.value:
                for client in server.get_clients().values():
                    step = recording.poses[instant, :3] - np.array(client.camera.look_at)
                    client.camera.position = np.array(client.camera.position) + step
                    client.camera.look_at = recording.poses[instant, :3]
    except KeyboardInterrupt:
        pass
    finally:
        _stop(server)
