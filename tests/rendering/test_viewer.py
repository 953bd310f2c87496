"""A recording holds an episode, and the viewer shows it live or as one page without a server."""

import math
import re

import gymnasium
import numpy as np
import pytest

from tests.rendering.picture_cases import CENTRED, bump, episode, last_picture, region
from tracked_env.rendering import Recorder, TerrainSource, viewer


def recorded(steps=50, terrain=None):
    """A drive to the east, one instant in ten control steps."""
    env = episode()
    recorder = Recorder(terrain)
    recorder.add(env.simulation)
    for _ in range(steps // 10):
        last_picture(env, 10)
        recorder.add(env.simulation)
    return recorder.finish()


def test_a_recording_holds_times_poses_and_the_ground_around_the_path():
    recording = recorded(50, TerrainSource(bump(5.0, 0.0), centre_height=0.4))
    assert recording.times == pytest.approx(np.arange(6) * 0.2)
    assert (np.diff(recording.poses[:, 0]) > 0.1).all()
    assert recording.poses[:, 2] == pytest.approx(0.4)
    grid, cell = recording.ground.grid, recording.ground.cell
    rows, columns = grid.heights.shape
    x, y = grid.x + cell * np.arange(columns), grid.y + cell * np.arange(rows)
    row, column = np.unravel_index(np.argmax(grid.heights), grid.heights.shape)
    assert (x[column], y[row]) == pytest.approx((5.0, 0.0), abs=cell)
    assert x[0] < -10.0 and x[-1] > 70.0  # 60 m of path


def test_soft_soil_in_the_north_is_in_the_upper_half_of_the_picture_on_the_ground():
    env = episode({"schedule": [region(0.0, 6.0)]})
    recorder = Recorder()
    recorder.add(env.simulation)
    picture = recorder.finish().picture
    light = (picture != np.median(picture, axis=(0, 1))).any(axis=2)
    rows, columns = np.nonzero(light)
    assert rows.mean() / len(picture) == pytest.approx(0.25, abs=0.03)  # 6 of 12 m to the north
    assert columns.mean() / picture.shape[1] == pytest.approx(12.0 / 84.0, abs=0.03)


def test_a_recording_holds_one_episode():
    env = episode()
    recorder = Recorder()
    with pytest.raises(ValueError, match="recorded instants = 0"):
        recorder.finish()
    recorder.add(env.simulation)
    env.reset(seed=4, options={"start": CENTRED})
    with pytest.raises(ValueError, match="one episode"):
        recorder.add(env.simulation)
    with pytest.raises(gymnasium.error.ResetNeeded):
        Recorder().add(type(env)().simulation)


def test_about_twenty_instants_a_second_are_shown_with_the_first_and_the_last():
    recording = recorded(10)
    times = np.linspace(0.0, 3.0, 151)
    indices = viewer.instants(recording._replace(times=times))
    assert times[indices] == pytest.approx(np.linspace(0.0, 3.0, 61), abs=0.02)
    assert (indices[0], indices[-1]) == (0, 150)
    assert viewer.instants(recording._replace(times=times[:1])).tolist() == [0]


def test_the_page_is_one_file_without_links_to_the_net(tmp_path):
    pytest.importorskip("viser", reason="pages need the extra `viewer`")
    file = tmp_path / "folder" / "replay.html"
    viewer.write_html(recorded(50, TerrainSource(bump(5.0, 0.0))), file)
    assert list(file.parent.iterdir()) == [file]
    page = file.read_text(encoding="utf-8")
    assert set(re.findall(r"https?://[\w./-]+", page)) <= {"http://www.w3.org/2000/svg"}
    links = re.findall(
        r"<(?:script|link|img|iframe)[^>]*?\s(?:src|href)=[\"']?([^\"'\s>]{0,9})", page
    )
    assert links and all(link.startswith("data:") for link in links)
    assert 5e5 < len(page) < 6e6


class Calls:
    """A server of viser that only notes what is put on it."""

    def __init__(self, name="server"):
        self.__dict__.update(name=name, made={})

    def __getattr__(self, name):
        return self.made.setdefault(name, Calls(name))

    def __call__(self, *arguments, **options):
        key = arguments[0] if arguments and isinstance(arguments[0], str) else ""
        return self.made.setdefault(key, Calls(key))


def test_the_vehicle_is_where_it_was_at_the_instant():
    pytest.importorskip("trimesh", reason="meshes need the extra `viewer`")
    recording = recorded(100, TerrainSource(bump(50.0, 9.0)))
    stage = viewer.Stage(Calls(), recording)
    stage.move(10)
    assert stage._vehicle.position == pytest.approx(tuple(recording.poses[10, :3]))


def test_the_reference_pose_lies_on_the_slope():
    pytest.importorskip("trimesh", reason="meshes need the extra `viewer`")
    stage = viewer.Stage(Calls(), recorded(10, TerrainSource(lambda x, y: 0.5 * x)))
    position, quaternion = stage._lying(np.array([4.0, 1.0, 0.0]))
    assert position[2] == pytest.approx(2.0, abs=0.1)
    half = -0.5 * math.atan(0.5)  # nose up
    assert quaternion == pytest.approx([math.cos(half), 0.0, math.sin(half), 0.0])
