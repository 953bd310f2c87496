"""Pictures: what they show, where, and that they come in every way Gymnasium asks for them."""

import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pygame
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo
from numpy.typing import NDArray

import tracked_env  # noqa: F401
from tracked_env import batch as b
from tracked_env.env import TrackedVehicleEnv
from tracked_env.rendering import Renderer, canvas, snapshot, soil_map
from tracked_env.rendering.memory import Memory
from tracked_env.vector_env import TrackedVehicleVectorEnv

ID = "tracked_env/Torque-v0"
SHAPE = (640, 960, 3)
WEST_EAST = {"kind": "straight", "speed": 2.0, "x": 0.0, "y": 0.0, "yaw": 0.0}
CENTRED = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0, "speed": 2.0, "yaw_rate": 0.0}
Picture = NDArray[np.uint8]


def started(options: dict[str, Any] | None = None, **arguments: Any) -> TrackedVehicleEnv:
    """An environment at rest over a vehicle that heads east from the origin."""
    given: dict[str, Any] = {"reference": WEST_EAST, "uncertainty": "nominal", "sensors": "ideal"}
    env = TrackedVehicleEnv(**{**given, "render_mode": "rgb_array", **arguments})
    env.reset(seed=3, options={"start": CENTRED, **(options or {})})
    return env


def driven(env: TrackedVehicleEnv, steps: int, left: float = 0.3, right: float = 0.3) -> Picture:
    """The last picture of some steps, each of them drawn."""
    for _ in range(steps):
        env.step(np.array([left, right], dtype=np.float32))
        picture = env.render()
    assert picture is not None
    return picture


def pixel(picture: Picture, x: float, y: float) -> list[int]:
    """Colour at a place [m] relative to the vehicle, away from the thin grid lines."""
    return picture[320 - round(40 * y), 340 + round(40 * x)].tolist()


def region(x: float, y: float, **change: Any) -> dict[str, Any]:
    """A disc of 2 m where the lateral resistance is 0."""
    disc = {"kind": "region", "x": x, "y": y, "radius": 2.0, "edge": 0.1}
    return {"parameter": "lateral_resistance", "target": 0.0, **disc, **change}


def test_a_picture_is_an_rgb_array_and_opens_no_window() -> None:
    picture = driven(started(), 3)
    assert (picture.shape, picture.dtype) == (SHAPE, np.uint8)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100
    code = (
        "import gymnasium, pygame, tracked_env\n"
        f"env = gymnasium.make('{ID}', render_mode='rgb_array')\n"
        "env.reset(seed=0); env.render()\n"
        "assert not pygame.display.get_init() and pygame.display.get_surface() is None"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_same_calls_give_the_same_pixels() -> None:
    first, second = (started(uncertainty="mixed", sensors="rtk") for _ in range(2))
    one, other = driven(first, 20, 0.2, 0.4), driven(second, 20, 0.2, 0.4)
    assert np.array_equal(one, other)
    again = first.render()
    assert again is not None and np.array_equal(one, again)
    assert not np.array_equal(one, driven(first, 20))


def test_what_lies_to_the_left_of_a_vehicle_heading_east_is_above_it() -> None:
    pale, brown = canvas.SOIL_SCALE[0].tolist(), canvas.SOIL_SCALE[170].tolist()
    at_left = started({"schedule": [region(0.0, 5.5)]}).render()
    assert at_left is not None
    assert pixel(at_left, 0.1, 5.4) == pale
    assert pixel(at_left, 0.1, -5.4) == brown
    ahead = started({"schedule": [region(5.5, 0.0)]}).render()
    assert ahead is not None
    assert pixel(ahead, 5.4, -0.4) == pale
    assert pixel(ahead, -5.4, -0.4) == brown


def rows_of(picture: Picture, colour: canvas.Colour) -> NDArray[np.float64]:
    """How far above the middle of the scene [m] each pixel of that colour is."""
    scene = picture[60:580, :680]
    rows = np.flatnonzero((scene == colour).all(axis=2).any(axis=1))
    return (260 - rows) / 40


def test_forces_and_reference_are_drawn_on_the_side_where_they_are() -> None:
    env = started({"start": {**CENTRED, "offset_y": -3.0}})
    for _ in range(3):
        env.step(np.array([0.05, 0.5], dtype=np.float32))
    picture = env.render()
    assert picture is not None
    blue, green = rows_of(picture, canvas.BLUE), rows_of(picture, canvas.GREEN)
    assert 3.9 < blue.max() < 4.1  # the left edge of the reference's footprint
    assert -1.4 < green.min() < green.max() < -0.9  # only the right track pushes
    arrow = (picture[60:580, :680] == canvas.GREEN).all(axis=2).sum()
    assert arrow > 120  # 9 kN; the 1 kN on the left has no pixel of the pure colour


def test_the_picture_of_the_mirrored_drive_is_the_mirrored_picture() -> None:
    pictures = []
    for side in (1, -1):
        env = started({"start": {**CENTRED, "offset_y": 1.0 * side}})
        torques = (0.18, 0.35)[::side]
        pictures.append(driven(env, 60, *torques)[70:571, 70:670])  # row 320 is the middle
    # Vehicle, ghost, lines and arrows, but not ground and grid:
    dark = [picture.max(axis=2) < 180 for picture in pictures]
    assert dark[0].sum() > 3000
    flipped = dark[1][::-1]
    wrong = [np.mean(dark[0] != other) / dark[0].mean() for other in (flipped, dark[1])]
    assert wrong[0] < 0.06 < 0.5 < wrong[1]


def test_the_map_is_that_of_the_plant() -> None:
    schedule = [
        {"parameter": "lateral_resistance", "kind": "wave", "target": 0.6, "amplitude": 0.03,
         "k_x": 0.7, "decay": 0.01},
        {"parameter": "lateral_resistance", "kind": "line", "target": 0.3, "x": 1.0, "y": 0.5,
         "direction": 0.4, "edge": 1.5},
        {"parameter": "cohesion", "kind": "region", "target": 9e3, "x": 2.0, "y": 0.0,
         "radius": 1.0, "edge": 2.0},
    ]  # fmt: skip
    seen = set()
    for x in (-3.0, 0.9, 1.3, 2.0, 7.0):
        place = {"offset_x": x, "offset_y": 0.7 * x}
        env = started({"schedule": schedule, "start": {**CENTRED, **place}})
        shot = snapshot.take(env.simulation, 0)
        for name in ("lateral_resistance", "cohesion"):
            value = soil_map.value_at(shot, 3, name, 0.0, shot.state.x, shot.state.y)
            assert value == env.simulation.truth()[name][0]
            seen.add(value)
        assert 0.0 < (mu := shot.parameters.lateral_resistance) < 1.2
        picture = env.render()
        assert picture is not None
        # A pale corner of the vehicle's own cell is hidden by it: read the ground beside it.
        beside = shot.state.x + 0.4, shot.state.y + 2.0
        mu = soil_map.value_at(shot, 3, "lateral_resistance", 0.0, *beside)
        expected = canvas.SOIL_SCALE[int(256 * mu / 1.2)].astype(int)
        near = picture[320 - 82 : 320 - 77, 340 + 14 : 340 + 19].reshape(-1, 3).astype(int)
        assert np.abs(near - expected).max(axis=1).min() <= 3
    assert len(seen) >= 8


@pytest.mark.parametrize("duration", [0.0, 0.3])
def test_an_event_in_time_changes_the_colour_of_the_map_when_it_acts(duration: float) -> None:
    ramp = {"parameter": "lateral_resistance", "kind": "ramp", "target": 0.2, "start": 0.1,
            "duration": duration}  # fmt: skip
    env = started({"schedule": [ramp]})
    before = pixel(driven(env, 4), 0.13, 5.4)
    after = pixel(driven(env, 1 + round(50 * duration)), 0.13, 5.4)
    assert before == canvas.SOIL_SCALE[170].tolist()
    assert after == canvas.SOIL_SCALE[42].tolist()


def test_the_map_steps_in_ramps_and_is_exact_elsewhere() -> None:
    ramps = np.array([[0.0, 0, 1.0, 1.0, 0.0, 0, 0, 0], [0.0, 0, 1.0, 2.0, 0.5, 0, 0, 0]])
    shown = [soil_map.map_time(ramps, t) for t in (0.5, 1.0, 1.9, 2.0, 2.19, 2.3, 2.45, 2.5, 9.0)]
    assert shown == pytest.approx([0.0, 1.0, 1.0, 2.0, 2.0, 2.2, 2.4, 2.5, 2.5])


def test_a_notice_tells_what_has_changed_and_goes() -> None:
    step = {"parameter": "mass", "kind": "ramp", "target": 2320.0, "start": 0.1}
    env = started({"schedule": [step, region(1.0, 0.0, radius=0.3)]})
    memory = Memory(snapshot.take(env.simulation, 0))
    seen: dict[float, list[str]] = {}
    for _ in range(200):
        env.step(np.array([0.3, 0.3], dtype=np.float32))
        shot = snapshot.take(env.simulation, 0)
        memory.update(shot)
        seen[round(shot.time, 2)] = memory.notices()
    assert seen[0.08] == []
    assert seen[0.12] == ["mass m: 1450 → 2320 kg"]
    assert any("lateral resistance: 0.80 → 0.00" in lines for lines in seen.values())
    assert any("lateral resistance: 0.00 → 0.80" in lines for lines in seen.values())
    assert "mass m: 1450 → 2320 kg" not in seen[3.2]


def test_a_notice_is_seen_in_the_picture() -> None:
    step = {"parameter": "mass", "kind": "ramp", "target": 2320.0, "start": 0.1}
    env = started({"schedule": [step]})
    without, notice = driven(env, 3), driven(env, 4)
    box = np.s_[50:70, 260:420]
    assert without[box].min() > 100
    assert notice[box].min() < 80


def test_belts_run_and_trail_grows_with_the_vehicle() -> None:
    env = started()
    memory = Memory(snapshot.take(env.simulation, 0))
    travel = np.zeros(2)
    for _ in range(50):
        env.step(np.array([0.2, 0.5], dtype=np.float32))
        shot = snapshot.take(env.simulation, 0)
        memory.update(shot)
        speeds = np.array([shot.state.sprocket_speed_left, shot.state.sprocket_speed_right])
        travel += 0.02 * 0.3 * speeds
    assert memory.travel == pytest.approx(travel, rel=1e-9)
    assert travel[1] > travel[0] > 0.0
    assert np.hypot(*(memory.trail[-1] - shot.pose[:2])) < 0.1
    assert 10 < len(memory.trail) <= 51


def test_drawn_forces_balance_as_in_the_plant() -> None:
    env = started(lateral="sliding")
    for _ in range(20):
        env.step(np.array([0.2, 0.6], dtype=np.float32))
    shot = snapshot.take(env.simulation, 0)
    drawbar = shot.state.effort_left + shot.state.effort_right - sum(shot.resistance)
    assert drawbar == pytest.approx(shot.parameters.mass * shot.state.acceleration_x, rel=1e-9)
    assert min(shot.resistance) > 1000.0
    assert shot.lateral_force > 1000.0  # turning left, the soil pushes to the left
    picture = env.render()
    assert picture is not None
    assert rows_of(picture, canvas.PURPLE).mean() > 0.1


def test_a_new_episode_forgets_the_old_one() -> None:
    used = started()
    driven(used, 30)
    used.reset(seed=3, options={"start": CENTRED})
    assert np.array_equal(driven(used, 5), driven(started(), 5))


def test_the_vector_environment_draws_each_row_as_the_single_one_does() -> None:
    vector = TrackedVehicleVectorEnv(2, render_mode="rgb_array")
    single = TrackedVehicleEnv(render_mode="rgb_array")
    vector.reset(seed=5)
    single.reset(seed=6)
    action = np.array([0.3, 0.2], dtype=np.float32)
    for _ in range(5):
        vector.step(np.stack([action, action]))
        single.step(action)
        pictures, picture = vector.render(), single.render()
    assert pictures is not None and picture is not None and len(pictures) == 2
    assert np.array_equal(pictures[1], picture)
    assert not np.array_equal(pictures[0], picture)
    vector.close()


def test_closing_twice_and_drawing_again_work_even_after_pygame_quit() -> None:
    env = started()
    drawing = Renderer("rgb_array", 50)
    drawing.close()
    for disturb in (drawing.close, drawing.close, pygame.quit, pygame.font.init):
        disturb()
        picture = driven(env, 1)
        again = drawing.draw(env.simulation, 0)
        assert again is not None and np.abs(again.astype(int) - picture).mean() < 0.5


def test_a_window_shows_what_the_array_holds_and_closes() -> None:
    env = started()
    human, other = Renderer("human", 1000), Renderer("human", 1000)
    picture = Renderer("rgb_array", 50).draw(env.simulation, 0)
    for window in (human, other):
        assert window.draw(env.simulation, 0) is None
    assert picture is not None and human._window is not None and other._window is not None
    assert human._window is not other._window
    assert np.array_equal(canvas.to_array(human._window.get_surface()), picture)
    for window in (human, human, other):
        window.close()
    assert human._window is None
    assert human.draw(env.simulation, 0) is None
    human.close()


def test_gymnasium_checks_the_environment_and_its_rendering_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(ID, render_mode="rgb_array").unwrapped)


def test_a_recorded_video_can_be_played(tmp_path: Path) -> None:
    moviepy = pytest.importorskip("moviepy")
    base = gymnasium.make(ID, render_mode="rgb_array", duration=0.5, uncertainty="drift")
    env = RecordVideo(base, str(tmp_path / "videos"), episode_trigger=lambda episode: True)
    env.reset(seed=0)
    done = False
    while not done:
        done = any(env.step(np.array([0.3, 0.3], dtype=np.float32))[2:4])
    last = base.render()
    env.close()
    (file,) = tmp_path.glob("videos/*.mp4")
    with moviepy.VideoFileClip(str(file)) as clip:
        frames = list(clip.iter_frames())
        assert clip.fps == 50
    assert len(frames) == pytest.approx(26, abs=1)
    assert frames[-1].shape == SHAPE
    assert isinstance(last, np.ndarray)
    assert np.abs(frames[-1].astype(float) - last).mean() < 4.0  # lossy


def test_a_state_that_is_not_finite_is_drawn_and_named() -> None:
    env = started()
    driven(env, 2)
    env.simulation.batch.floats[0, b.STATE : b.STATE + 6] = np.nan
    assert env.render() is not None
    assert "not finite" in snapshot.take(env.simulation, 0).ending


@pytest.mark.parametrize(
    "vehicle",
    [
        {"mass": 1e5, "inertia": 1e6, "contact_length": 10.0, "track_gauge": 10.0,
         "torque_limit": 1e6},
        {"mass": 10.0, "inertia": 0.5, "contact_length": 0.1, "track_gauge": 0.1,
         "track_width": 0.01, "torque_limit": 0.1},
    ],
)  # fmt: skip
@pytest.mark.parametrize("zoom", [20, 100])
def test_the_largest_and_the_smallest_vehicle_can_be_drawn(
    vehicle: dict[str, float], zoom: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, sizes = canvas.surface, []

    def recorded(width: int, height: int, transparent: bool = False) -> pygame.Surface:
        sizes.append(width * height)
        return make(width, height, transparent)

    monkeypatch.setattr(canvas, "surface", recorded)
    env = started({"vehicle": vehicle}, error_limit=1e6)
    drawing = Renderer("rgb_array", 50, pixels_per_metre=zoom)
    for _ in range(10):
        env.step(np.array([1.0, -1.0], dtype=np.float32))
        picture = drawing.draw(env.simulation, 0)
    assert picture is not None and picture.shape == SHAPE
    assert max(sizes) < 16e6  # a sprite is no larger than what can be seen of it


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ValueError, match="render_mode"):
        Renderer("ansi", 50)
    with pytest.raises(ValueError, match="pixels_per_metre = 7"):
        Renderer("rgb_array", 50, pixels_per_metre=7)
    with pytest.raises(ValueError, match="soil_parameter"):
        Renderer("rgb_array", 50, soil_parameter="mass")
    env = TrackedVehicleEnv(render_mode="rgb_array")
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset"):
        env.render()


def test_the_ground_shows_the_parameter_that_is_asked_for() -> None:
    env = started({"schedule": [region(0.0, 5.5)]})
    shown = {}
    for name in (None, "cohesion"):
        picture = Renderer("rgb_array", 50, soil_parameter=name).draw(env.simulation, 0)
        assert picture is not None
        shown[name] = pixel(picture, 0.1, 5.4), pixel(picture, 0.1, -5.4)
    assert shown[None][0] != shown[None][1]
    assert shown["cohesion"] == (canvas.SOIL_SCALE[224].tolist(),) * 2


@pytest.mark.parametrize(("module", "word"), [("None", "not installed"), ("Old()", "older")])
def test_without_pygame_ce_the_error_names_what_to_install(module: str, word: str) -> None:
    code = (
        "import sys, types, tracked_env\n"
        "Old = lambda: types.ModuleType('pygame')\n"
        f"sys.modules['pygame'] = {module}\n"
        "try:\n    import tracked_env.rendering\n"
        "except ImportError as error:\n    print(error)"
    )
    said = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert 'tracked-env[render]"' in said.stdout and word in said.stdout
