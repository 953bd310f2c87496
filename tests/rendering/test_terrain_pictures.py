"""Pictures on terrain show its relief, the pose in space, loads and tilt, from above and behind."""

import copy
import math
import pickle

import gymnasium
import numpy as np
import pytest

from tests.rendering.picture_cases import SHAPE, bump, episode, last_picture
from tracked_env import TERRAIN_ID
from tracked_env.plants.terrain import LOAD_LEFT, LOAD_RIGHT
from tracked_env.rendering import (
    Renderer,
    TerrainSource,
    canvas,
    legend,
    perspective,
    soil_map,
    source_of,
)
from tracked_env.rendering.snapshot import BodyPose

ON_TERRAIN = (800, 960, 3)
EXTENT = np.array([[-20.0, -20.0], [20.0, 20.0]])


def shaded_map(pixels, heights, cell, interval, light=soil_map.LIGHT):
    out = pixels.copy()
    soil_map.draw_relief(out, heights, cell, interval, light)
    return out


def loads(simulation, row):
    return np.full((2, 4, 2), 900.0)


def picture_of(terrain, view="top", **state):
    """The first picture of a vehicle that heads east from the origin, moved to another state."""
    env = episode()
    for name, value in state.items():
        env.simulation.batch.state()[0, STATE[name]] = value
    picture = Renderer("rgb_array", 50, view=view, terrain=terrain).draw(env.simulation, 0)
    return picture


STATE = {"z": 17, "roll": 18, "pitch": 19}


@pytest.mark.parametrize("view", ["top", "3d"])
def test_a_picture_on_terrain_has_a_strip_below_and_one_without_has_none(view):
    source = TerrainSource(bump(6.0, 2.0), loads)
    for terrain, shape in ((source, ON_TERRAIN), (None, SHAPE)):
        picture = picture_of(terrain, view)
        assert (picture.shape, picture.dtype) == (shape, np.uint8)
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100


def test_level_terrain_from_above_is_darker_than_no_terrain_by_a_constant_factor():
    with_terrain, without = picture_of(TerrainSource()), picture_of(None)
    ground = np.s_[60:100, 100:300]
    ratio = with_terrain[ground] / without[ground]
    assert ratio == pytest.approx(np.full(ratio.shape, soil_map.LEVEL), abs=0.006)


def test_slopes_to_the_north_west_are_bright_and_those_to_the_south_east_dark():
    picture = picture_of(TerrainSource(bump(0.0, 4.5, 2.0, 1.0)))
    row, column = 320 - round(40 * 4.5), 320  # of the top of the hill, in the north: above
    north_west, south_east = (
        int(np.median(picture[row + k - 8 : row + k + 8, column + k - 8 : column + k + 8, 0]))
        for k in (-28, 28)
    )
    assert north_west > int(picture[row, 20, 0]) + 10 > south_east + 40


def test_a_reflection_of_terrain_and_light_reflects_the_map():
    x, y = np.meshgrid(np.linspace(-4.0, 4.0, 82), np.linspace(4.0, -4.0, 82))
    heights = bump(1.0, 1.5)(x, y)
    pixels = np.full((80, 80, 3), 180, dtype=np.uint8)
    one = shaded_map(pixels, heights, 0.1, 0.25)
    light = (-soil_map.LIGHT[0], *soil_map.LIGHT[1:])
    other = shaded_map(pixels, heights[:, ::-1].copy(), 0.1, 0.25, light)
    assert np.array_equal(one, other[:, ::-1]) and not np.array_equal(one, other)


def test_contour_lines_lie_where_the_height_is_a_multiple_of_the_interval():
    x = np.tile(np.linspace(-0.02, 8.0, 402), (12, 1))  # 50 px for a metre
    pixels = np.full((10, 400, 3), 250, dtype=np.uint8)
    blue = shaded_map(pixels, 0.3 * x, 0.02, 0.5)[5, :, 2].astype(int)
    lines = np.flatnonzero((blue[1:-1] < blue[:-2]) & (blue[1:-1] <= blue[2:])) + 1
    places = 0.02 * lines
    assert places == pytest.approx(0.5 * np.arange(1, 5) / 0.3, abs=0.03)
    assert blue[1] < blue[lines[1]]  # every fifth line is strong, that of height 0 too


@pytest.mark.parametrize(
    ("height", "interval"), [(0.0, 1.0), (2.4, 0.2), (0.011, 0.001), (70.0, 10.0)]
)
def test_the_interval_is_a_round_number_that_gives_at_most_twelve_lines(height, interval):
    terrain = TerrainSource(lambda x, y: height * (x - x.min()) / np.ptp(x))
    assert soil_map.interval_around(terrain, EXTENT, 2.0) == pytest.approx(interval)


def test_positive_pitch_is_nose_down_and_positive_roll_is_left_side_up():
    def moved(point, **angles):
        pose = BodyPose(*{**dict.fromkeys(BodyPose._fields, 0.0), **angles}.values())
        return pose.place(np.array([point]))[0]

    assert moved((1.0, 0.0, 0.0), pitch=0.3) == pytest.approx([math.cos(0.3), 0.0, -math.sin(0.3)])
    assert moved((0.0, 1.0, 0.0), roll=0.3) == pytest.approx([0.0, math.cos(0.3), math.sin(0.3)])
    turned = moved((1.0, 0.0, 0.0), yaw=0.5, pitch=0.3, roll=0.2)
    assert turned[:2] == pytest.approx(math.cos(0.3) * np.array([math.cos(0.5), math.sin(0.5)]))


def test_the_tilt_is_the_angle_between_the_up_axes():
    pose = BodyPose(0.0, 0.0, 0.0, 1.0, 0.4, -0.7)
    assert math.cos(pose.tilt) == pytest.approx(pose.axes[2, 2])
    assert BodyPose(0.0, 0.0, 0.0, 1.0, 0.0, 3.0).tilt == pytest.approx(3.0)


def test_roll_and_pitch_turn_their_indicators_and_beyond_the_limit_they_warn():
    def dial(picture, middle):
        part = picture[640 + 44 : 640 + 132, middle - 44 : middle + 44].astype(int)
        return (np.abs(part - (82, 94, 103)).sum(axis=2) < 30).astype(int)

    def warned(picture):
        label = picture[640 + 138 : 640 + 154, 766:890].astype(int)
        return bool((np.abs(label - canvas.VERMILLION).sum(axis=2) < 60).any())

    terrain = TerrainSource(centre_height=0.5)
    level, rolled = picture_of(terrain), picture_of(terrain, roll=0.4)
    pitched = picture_of(terrain, pitch=0.4)
    roll, pitch = legend._DIALS[0][0], legend._DIALS[1][0]
    assert np.array_equal(dial(level, pitch), dial(rolled, pitch))
    upper = dial(rolled, roll)[:36]  # the left side is up
    assert upper[:, :44].sum() > 2 * upper[:, 44:].sum()
    lower = dial(pitched, pitch)[52:]  # the nose, at the right, is down
    assert lower[:, 44:].sum() > 20 > lower[:, :44].sum()
    assert not warned(level) and not warned(pitched)
    assert warned(picture_of(terrain, roll=0.7))
    assert warned(picture_of(terrain._replace(tilt_limit=0.45), roll=0.4))


def test_the_load_map_has_the_front_at_the_top_and_the_left_edge_at_the_left():
    patches = np.zeros((3, 2))
    patches[2, 1] = 100.0  # front, left
    picture = canvas.to_array(legend.load_picture(patches, 100.0, (40, 60)))
    dark = (picture == canvas.LOAD_SCALE[-1]).all(axis=2)
    assert dark[:20, :20].all() and dark.sum() == 400


def test_the_profile_rises_where_the_path_climbs():
    env = episode()
    renderer = Renderer("rgb_array", 50, terrain=TerrainSource(lambda x, y: 0.1 * np.abs(x - 30.0)))
    picture = renderer.draw(env.simulation, 0)
    box = legend._PROFILE
    profile = picture[640 + box.top + 2 : 640 + box.bottom - 2, box.left + 2 : box.right - 2]
    earth = (profile == legend.EARTH).all(axis=2).sum(axis=0)
    lowest = int(np.argmin(earth[10:])) + 10
    assert earth[12] > earth[100] > earth[lowest] < earth[-12]
    assert lowest / len(earth) == pytest.approx(0.5, abs=0.03)  # of 60 m


def test_from_behind_a_roll_to_the_left_lowers_the_left_track():
    terrain = TerrainSource(centre_height=0.5)
    belt = []
    for roll in (-0.25, 0.25):
        picture = picture_of(terrain, "3d", roll=roll)[300:560, 160:480].astype(int)
        blue = picture[..., 2] - picture[..., 0] > 45  # the belts at low slip
        rows = np.arange(260)[:, None]
        belt.append(
            [float((rows * half).sum() / half.sum()) for half in (blue[:, :160], blue[:, 160:])]
        )
    assert belt[0][0] > belt[0][1] + 20  # roll to the left: its left track is lower in the picture
    assert belt[1][1] > belt[1][0] + 20


def test_the_shadow_falls_away_from_the_light_and_farther_from_a_higher_vehicle():
    shaded = []
    for height in (0.0, 1.0):  # of the tracks above the ground; the light comes from the left
        source = TerrainSource(centre_height=0.5)
        scene = picture_of(source, "3d", z=0.5 + height)[200:588, :640].astype(int)
        ground = np.median(scene[:, 560:], axis=(0, 1))
        dark = ground + perspective.SHADE * (np.array(canvas.INK) - ground)
        shaded.append(np.argwhere(np.abs(scene - dark).max(axis=2) < 6)[:, 1])
    beside = [(columns > 320).sum() / len(columns) for columns in shaded]
    assert len(shaded[0]) > 500 and beside[0] > 0.8
    assert np.median(shaded[1]) > np.median(shaded[0]) + 20


def test_a_hill_between_eye_and_vehicle_raises_the_eye():
    hidden = picture_of(TerrainSource(bump(-4.0, 0.0, 4.0, 0.8)), "3d")
    free = picture_of(TerrainSource(bump(-40.0, 0.0, 4.0, 0.8)), "3d")
    for picture in (hidden, free):  # the deck's grey in the middle of the picture
        middle = picture[330:390, 290:350].reshape(-1, 3).astype(int)
        assert (np.ptp(middle, axis=1) < 40).mean() > 0.5


@pytest.mark.parametrize("view", ["top", "3d"])
def test_the_same_calls_give_the_same_pixels_on_terrain_and_after_pickling(view):
    terrain = TerrainSource(wavy)
    first = Renderer("rgb_array", 50, view=view, terrain=terrain)
    second = pickle.loads(pickle.dumps(first))
    env = episode()
    for _ in range(3):
        last_picture(env, 5, 0.2, 0.4)
        one, other = first.draw(env.simulation, 0), second.draw(env.simulation, 0)
        assert np.array_equal(one, other)


def wavy(x, y):
    return 0.5 * np.sin(0.5 * x) * np.cos(0.4 * y)


@pytest.mark.parametrize(
    ("heights", "message"),
    [
        (lambda x, y: np.zeros(3), r"heights have shape \(3,\); must be \(\d+, \d+\)"),
        (lambda x, y: np.where(x > 5.0, np.nan, 0.0), "height = nan m at x = .*must be finite"),
    ],
)
def test_heights_that_cannot_be_drawn_are_one_line(heights, message):
    with pytest.raises(ValueError, match=message) as raised:
        picture_of(TerrainSource(heights))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("view", ["top", "3d"])
def test_the_tracks_have_the_colours_of_the_loads_below_them(view):
    def front_left(simulation, row):
        patches = np.zeros((2, 4, 2))
        patches[0, 2:] = 1e5
        return patches

    terrain = TerrainSource(centre_height=0.5)
    picture, plain = (picture_of(terrain._replace(loads=of), view) for of in (front_left, None))
    dark, pale = canvas.LOAD_SCALE[-1].astype(int), canvas.LOAD_SCALE[0].astype(int)

    def places(colour, blue):
        scene = blue[27:588, :640].astype(int)
        ratio = scene.sum(axis=2, keepdims=True) / colour.sum()  # of the light on it
        alike = np.abs(scene - ratio * colour).max(axis=2) < 4.0
        return np.argwhere(alike & (ratio[..., 0] > 0.6) & (ratio[..., 0] < 1.3))

    loaded = places(dark, picture)
    assert len(loaded) > 50 + len(places(dark, plain))
    if view == "top":  # heads east: the front is at the right, the left track above
        assert (loaded[:, 1] > 320).mean() > 0.95 and (loaded[:, 0] < 293).mean() > 0.95
        assert (np.abs(picture[27:588, :640].astype(int) - pale).max(axis=2) < 4).sum() > 300
    else:  # seen from behind
        assert (loaded[:, 1] < 320).mean() > 0.9


def test_what_a_picture_shows_of_the_patches_adds_up_and_changes_nothing():
    env = gymnasium.make(TERRAIN_ID, plant_options={"terrain": "hills"}).unwrapped
    env.reset(seed=1)
    for _ in range(60):
        env.step(np.float32([0.4, 0.5]))
    before = copy.deepcopy(env.simulation.batch)
    source = source_of(env.simulation, 0)
    patches = source.loads(env.simulation, 0)
    assert patches.shape == (2, 10, 4) and (patches >= 0.0).all() and patches.std() > 5.0
    tracks = env.simulation.batch.floats[0, [LOAD_LEFT, LOAD_RIGHT]]
    assert patches.sum(axis=(1, 2)) == pytest.approx(tracks, rel=1e-9)
    for array, copied in zip(env.simulation.batch, before, strict=True):
        assert np.array_equal(array, copied)


def test_loads_of_patches_stand_from_the_rear_to_the_front_and_from_right_to_left():
    slope = {"kind": "plane", "slope_x": -0.3, "slope_y": -0.15}  # down ahead and to the left
    env = gymnasium.make(
        TERRAIN_ID,
        plant_options={"terrain": slope},
        uncertainty="nominal",
        reference={"kind": "straight", "speed": 0.0},
    ).unwrapped
    still = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0, "speed": 0.0, "yaw_rate": 0.0}
    env.reset(seed=0, options={"start": still, "soil": {"friction_angle": 0.7}})
    for _ in range(50):
        env.step(np.zeros(2, dtype=np.float32))
    source = source_of(env.simulation, 0)
    patches = source.loads(env.simulation, 0)
    assert (np.diff(patches, axis=1) > 0.0).all()  # heavier to the front
    assert (np.diff(patches, axis=2) > 0.0).all() and patches[0].sum() > patches[1].sum()
