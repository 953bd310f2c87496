"""The scene: ground, vehicle, reference and forces are drawn where they are, at every size."""

import numpy as np
import pytest

from tests.rendering import picture_cases as cases
from tracked_env.rendering import Renderer, canvas, scene, snapshot, soil_map
from tracked_env.rendering.renderer import History


def test_what_lies_to_the_left_of_a_vehicle_heading_east_is_above_it():
    pale, brown = canvas.SOIL_SCALE[0].tolist(), canvas.SOIL_SCALE[170].tolist()
    at_left = cases.episode({"schedule": [cases.region(0.0, 5.5)]}).render()
    assert cases.pixel(at_left, 0.1, 5.4) == pale
    assert cases.pixel(at_left, 0.1, -5.4) == brown
    ahead = cases.episode({"schedule": [cases.region(5.5, 0.0)]}).render()
    assert cases.pixel(ahead, 5.4, -0.4) == pale
    assert cases.pixel(ahead, -5.4, -0.4) == brown


def rows_of(picture, colour):
    """How far above the middle of the scene [m] each pixel of that colour is."""
    scene = picture[60:580, :640]
    rows = np.flatnonzero((scene == colour).all(axis=2).any(axis=1))
    return (260 - rows) / 40


def test_forces_and_reference_are_drawn_on_the_side_where_they_are():
    env = cases.episode({"start": {**cases.CENTRED, "offset_y": -3.0}})
    for _ in range(3):
        env.step(np.array([0.05, 0.5], dtype=np.float32))
    picture = env.render()
    blue, green = rows_of(picture, canvas.BLUE), rows_of(picture, canvas.GREEN)
    assert 3.9 < blue.max() < 4.1  # the left edge of the reference's footprint
    assert -1.4 < green.min() < green.max() < -0.9  # only the right track pushes
    arrow = (picture[60:580, :640] == canvas.GREEN).all(axis=2).sum()
    assert arrow > 120  # 9 kN; the 1 kN on the left has no pixel of the pure colour


def test_the_picture_of_the_mirrored_drive_is_the_mirrored_picture():
    pictures = []
    for side in (1, -1):
        env = cases.episode({"start": {**cases.CENTRED, "offset_y": 1.0 * side}})
        torques = (0.18, 0.35)[::side]
        pictures.append(
            cases.last_picture(env, 60, *torques)[70:571, 70:570]
        )  # row 320 is the middle
    # Vehicle, ghost, lines and arrows, but not ground and grid:
    dark = [picture.max(axis=2) < 180 for picture in pictures]
    assert dark[0].sum() > 3000
    flipped = dark[1][::-1]
    wrong = [np.mean(dark[0] != other) / dark[0].mean() for other in (flipped, dark[1])]
    assert wrong[0] < 0.06 < 0.5 < wrong[1]


def test_drawn_forces_balance_as_in_the_plant():
    env = cases.episode(lateral="sliding")
    for _ in range(20):
        env.step(np.array([0.2, 0.6], dtype=np.float32))
    shot = snapshot.take(env.simulation, 0)
    drawbar = shot.state.effort_left + shot.state.effort_right - sum(shot.resistance)
    assert drawbar == pytest.approx(shot.parameters.mass * shot.state.acceleration_x, rel=1e-9)
    assert min(shot.resistance) > 1000.0
    assert shot.lateral_force > 1000.0  # turning left, the soil pushes to the left
    picture = env.render()
    assert rows_of(picture, canvas.PURPLE).mean() > 0.1


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
def test_the_largest_and_the_smallest_vehicle_can_be_drawn(vehicle, zoom, monkeypatch):
    make, sizes = canvas.surface, []

    def recorded(width, height, transparent=False):
        sizes.append(width * height)
        return make(width, height, transparent)

    monkeypatch.setattr(canvas, "surface", recorded)
    env = cases.episode({"vehicle": vehicle}, error_limit=1e6)
    drawing = Renderer("rgb_array", 50, pixels_per_metre=zoom)
    for _ in range(10):
        env.step(np.array([1.0, -1.0], dtype=np.float32))
        picture = drawing.draw(env.simulation, 0)
    assert picture is not None and picture.shape == cases.SHAPE
    assert max(sizes) < 16e6  # a sprite is no larger than what can be seen of it


@pytest.mark.parametrize("away", [0.0, 100.0])
def test_a_path_is_drawn_where_it_is_in_the_picture_and_nowhere_else(away):
    picture, camera = canvas.surface(60, 40), scene.Camera(0.0, 0.0, 10.0, 30.0, 20.0)
    points = np.array([[-1.0, away], [0.0, away], [1.0, away]])
    scene.path(picture, camera, points, canvas.BLUE)
    blue = (canvas.to_array(picture) == canvas.BLUE).all(axis=2)
    assert blue[20, 22:38].all() and not blue[:10].any() if away == 0.0 else not blue.any()


def test_a_notice_tells_what_has_changed_and_goes():
    step = {"parameter": "mass", "kind": "ramp", "target": 2320.0, "start": 0.1}
    env = cases.episode({"schedule": [step, cases.region(1.0, 0.0, radius=0.3)]})
    history = History(snapshot.take(env.simulation, 0))
    notices = {}
    for _ in range(200):
        env.step(np.array([0.3, 0.3], dtype=np.float32))
        shot = snapshot.take(env.simulation, 0)
        history.update(shot)
        notices[round(shot.time, 2)] = history.notices()
    assert notices[0.08] == []
    assert notices[0.12] == ["mass m: 1450 → 2320 kg"]
    assert any("lateral resistance: 0.80 → 0.00" in lines for lines in notices.values())
    assert any("lateral resistance: 0.00 → 0.80" in lines for lines in notices.values())
    assert "mass m: 1450 → 2320 kg" not in notices[3.2]


def test_belts_run_and_trail_grows_with_the_vehicle():
    env = cases.episode()
    history = History(snapshot.take(env.simulation, 0))
    travel = np.zeros(2)
    for _ in range(50):
        env.step(np.array([0.2, 0.5], dtype=np.float32))
        shot = snapshot.take(env.simulation, 0)
        history.update(shot)
        speeds = np.array([shot.state.sprocket_speed_left, shot.state.sprocket_speed_right])
        travel += 0.02 * 0.3 * speeds
    assert history.travel == pytest.approx(travel, rel=1e-9)
    assert travel[1] > travel[0] > 0.0
    assert np.hypot(*(history.trail[-1] - shot.pose[:2])) < 0.1
    assert 10 < len(history.trail) <= 51


def test_the_map_is_that_of_the_plant():
    schedule = [
        {"parameter": "lateral_resistance", "kind": "wave", "target": 0.6, "amplitude": 0.03,
         "k_x": 0.7, "decay": 0.01},
        {"parameter": "lateral_resistance", "kind": "line", "target": 0.3, "x": 1.0, "y": 0.5,
         "direction": 0.4, "edge": 1.5},
        {"parameter": "cohesion", "kind": "region", "target": 9e3, "x": 2.0, "y": 0.0,
         "radius": 1.0, "edge": 2.0},
    ]  # fmt: skip
    values = set()
    for x in (-3.0, 0.9, 1.3, 2.0, 7.0):
        place = {"offset_x": x, "offset_y": 0.7 * x}
        env = cases.episode({"schedule": schedule, "start": {**cases.CENTRED, **place}})
        shot = snapshot.take(env.simulation, 0)
        for name in ("lateral_resistance", "cohesion"):
            value = soil_map.value_at(shot, 3, name, 0.0, shot.state.x, shot.state.y)
            assert value == env.simulation.truth()[name][0]
            values.add(value)
        assert 0.0 < (mu := shot.parameters.lateral_resistance) < 1.2
        picture = env.render()
        # A pale corner of the vehicle's own cell is hidden by it: read the ground beside it.
        beside = shot.state.x + 0.4, shot.state.y + 2.0
        mu = soil_map.value_at(shot, 3, "lateral_resistance", 0.0, *beside)
        expected = canvas.SOIL_SCALE[int(256 * mu / 1.2)].astype(int)
        near = picture[320 - 82 : 320 - 77, 320 + 14 : 320 + 19].reshape(-1, 3).astype(int)
        assert np.abs(near - expected).max(axis=1).min() <= 3
    assert len(values) >= 8


@pytest.mark.parametrize("duration", [0.0, 0.3])
def test_an_event_in_time_changes_the_colour_of_the_map_when_it_acts(duration):
    ramp = {"parameter": "lateral_resistance", "kind": "ramp", "target": 0.2, "start": 0.1,
            "duration": duration}  # fmt: skip
    env = cases.episode({"schedule": [ramp]})
    before = cases.pixel(cases.last_picture(env, 4), 0.13, 5.4)
    after = cases.pixel(cases.last_picture(env, 1 + round(50 * duration)), 0.13, 5.4)
    assert before == canvas.SOIL_SCALE[170].tolist()
    assert after == canvas.SOIL_SCALE[42].tolist()


def test_the_map_steps_in_ramps_and_is_exact_elsewhere():
    ramps = np.array([[0.0, 0, 1.0, 1.0, 0.0, 0, 0, 0], [0.0, 0, 1.0, 2.0, 0.5, 0, 0, 0]])
    colours = [soil_map.map_time(ramps, t) for t in (0.5, 1.0, 1.9, 2.0, 2.19, 2.3, 2.45, 2.5, 9.0)]
    assert colours == pytest.approx([0.0, 1.0, 1.0, 2.0, 2.0, 2.2, 2.4, 2.5, 2.5])


def test_the_ground_shows_the_parameter_that_is_asked_for():
    env = cases.episode({"schedule": [cases.region(0.0, 5.5)]})
    colours = {}
    for name in (None, "cohesion"):
        picture = Renderer("rgb_array", 50, soil_parameter=name).draw(env.simulation, 0)
        colours[name] = cases.pixel(picture, 0.1, 5.4), cases.pixel(picture, 0.1, -5.4)
    assert colours[None][0] != colours[None][1]
    assert colours["cohesion"] == (canvas.SOIL_SCALE[224].tolist(),) * 2
