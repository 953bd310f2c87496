"""The command `tracked-env render`: pictures, films and pages of one episode."""

import sys
import weakref
from pathlib import Path

import numpy as np
import pytest

from tracked_env.benchmark import video
from tracked_env.cli.main import main
from tracked_env.rendering.canvas import QUANTITY_COLOURS

pytest.importorskip("pygame", reason="pictures need the extra `render`")
image, moviepy = pytest.importorskip("PIL.Image"), pytest.importorskip("moviepy")
pytestmark = pytest.mark.usefixtures("in_an_empty_folder")


@pytest.mark.parametrize("suffix", [".gif", ".mp4", ".png", ".webp"])
def test_render_writes_the_episode_in_the_format_of_the_file(suffix):
    file = Path("folder") / f"one{suffix}"
    arguments = ["ppo-blind", "--set", "drift", "--duration", "1", "--file", str(file)]
    assert main(["render", *arguments]) == 0
    assert list(file.parent.iterdir()) == [file]
    if suffix == ".mp4":
        with moviepy.VideoFileClip(str(file)) as clip:
            assert clip.fps == 50
            assert len(list(clip.iter_frames())) == pytest.approx(51, abs=1)
        return
    with image.open(file) as picture:
        assert picture.size == (960, 640)
        frames = getattr(picture, "n_frames", 1)
        assert frames == (1 if suffix == ".png" else 11)
        assert picture.convert("L").getextrema() != (0, 0)


def test_a_film_is_encoded_while_it_is_drawn(tmp_path):
    """All pictures of 30 s together are 2.8 GB. Its size need not be a multiple of 16."""
    alive = []

    def film():
        for k in range(60):
            picture = np.full((90, 122, 3), 4 * k, np.uint8)
            alive.append(weakref.ref(picture))
            assert sum(each() is not None for each in alive) <= 4  # type: ignore[operator]
            yield picture

    video._write(tmp_path / "one.mp4", film(), 20.0)
    with moviepy.VideoFileClip(str(tmp_path / "one.mp4")) as clip:
        frames = list(clip.iter_frames())
        assert clip.fps == 20 and clip.size == [122, 90] and len(frames) == 60
    assert [np.mean(frame) for frame in frames] == pytest.approx(4.0 * np.arange(60), abs=4.0)


def test_colours_of_a_film_are_those_of_the_quantities_in_every_picture(tmp_path):
    """Thin lines over ground of many colours, which change from picture to picture."""
    rng = np.random.default_rng(0)
    lines = np.array(QUANTITY_COLOURS)

    def film():
        still = rng.integers(0, 256, (8, 120, 3))
        for k in range(10):
            picture = np.zeros((100, 120, 3), np.uint8)
            picture[..., 0] = np.linspace(20 * k, 60 + 18 * k, 120)
            picture[..., 1] = np.linspace(40, 250, 100)[:, None]
            picture[..., 2] = rng.integers(60, 90, (100, 120))
            picture[:8] = still
            picture[10 + 5 * k : 10 + 5 * k + len(lines), 5] = lines
            yield picture

    video._write(tmp_path / "one.gif", film(), 10.0)
    with image.open(tmp_path / "one.gif") as shown:
        frames = []
        for k in range(shown.n_frames):  # type: ignore[attr-defined]
            shown.seek(k)
            frames.append(np.asarray(shown.convert("RGB")).astype(int))
    assert len(frames) == 10
    for k, frame in enumerate(frames):
        assert np.array_equal(frame[10 + 5 * k : 10 + 5 * k + len(lines), 5], lines)
        assert np.array_equal(frame[:8], frames[0][:8])  # nothing that stays flickers


def test_a_picture_shows_the_time_that_is_asked_for_and_else_the_end(capsys):
    drawn = {}
    for time in ("0", "0.5", "1", ""):
        at = ["--at", time] if time else []
        assert main(["render", "nominal", "--duration", "1", "--file", "one.png", *at]) == 0
        with image.open("one.png") as picture:
            drawn[time] = np.asarray(picture)
    assert np.array_equal(drawn["1"], drawn[""])
    assert not np.array_equal(drawn["0"], drawn["0.5"])
    assert not np.array_equal(drawn["0.5"], drawn["1"])
    capsys.readouterr()
    for wrong in (["--at", "1.5"], ["--at", "0.5", "--file", "one.gif"]):
        assert main(["render", "nominal", "--duration", "1", "--file", "one.png", *wrong]) == 2
    beyond, moving = capsys.readouterr().err.splitlines()
    assert "must be in [0, 1] s" in beyond and "must end in .png" in moving


def test_render_shows_the_same_episode_from_behind_the_vehicle():
    arguments = ["nominal", "--duration", "1", "--file"]
    assert main(["render", *arguments, "top.png"]) == 0
    assert main(["render", *arguments, "behind.png", "--view", "3d"]) == 0
    with image.open("top.png") as top, image.open("behind.png") as behind:
        assert top.size == behind.size == (960, 640)
        panel, scene = (650, 60, 950, 460), (0, 60, 640, 580)
        assert top.crop(panel).tobytes() == behind.crop(panel).tobytes()
        assert top.crop(scene).tobytes() != behind.crop(scene).tobytes()


def test_render_writes_a_page():
    pytest.importorskip("viser", reason="pages need the extra `viewer`")
    assert main(["render", "nominal", "--duration", "1", "--file", "replay.html"]) == 0
    assert [path.name for path in Path().iterdir()] == ["replay.html"]


def test_without_viser_render_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["render", "nominal", "--duration", "1", "--file", "replay.html"]) == 1
    error = capsys.readouterr().err
    assert 'pip install "tracked-env[viewer]"' in error and error.count("\n") == 1
    assert list(Path().iterdir()) == []
