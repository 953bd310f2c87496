"""Perspective has closed forms, hills hide what is behind them, and mirrored ground is mirrored."""

import numpy as np
import pytest

from tests.rendering.picture_cases import HEIGHT, WIDTH, board, bump, eye, grid, ground_picture, put
from tracked_env.rendering import raster
from tracked_env.rendering.perspective import Landscape, Picture, resampled
from tracked_env.rendering.snapshot import TerrainSource, level
from tracked_env.rendering.soil_map import LIGHT

RED = (255, 0, 0)


def count(picture):
    return int((picture.colours == RED).all(axis=2).sum())


@pytest.mark.parametrize(
    ("yaw", "point", "pixel"),
    [
        ((1.0, 0.0), (10.0, 0.0, 2.0), (160.0, 80.0)),  # ahead, at the height of the eye
        ((1.0, 0.0), (10.0, 1.0, 2.0), (140.0, 80.0)),  # to the left
        ((1.0, 0.0), (10.0, 0.0, 3.0), (160.0, 60.0)),  # higher
        ((0.0, 1.0), (0.0, 10.0, 2.0), (160.0, 80.0)),  # the eye looks north
        ((0.0, 1.0), (1.0, 10.0, 2.0), (180.0, 80.0)),
    ],
)
def test_a_point_is_seen_at_the_pixel_of_the_closed_form(yaw, point, pixel):
    at = eye()._replace(cosine=yaw[0], sine=yaw[1])
    assert raster.project(at, np.array(point)) == pytest.approx([*pixel, 0.1])


def test_points_behind_the_eye_or_too_near_have_no_inverse_distance():
    points = np.array([[-5.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.5, 0.0, 0.0]])
    assert raster.project(eye(), points)[:, 2].tolist() == [0.0, 0.0, 2.0]


@pytest.mark.parametrize("slope", [0.0, 0.1, -0.05])
def test_the_depth_of_a_plane_follows_from_its_slope(slope):
    inverse = ground_picture(lambda x, y: slope * x).inverse
    drop = (np.arange(HEIGHT) + 0.5 - 80.0) / 200.0  # of the ray per metre ahead
    expected = (drop + slope) / 2.0
    inside = (expected > 1.0 / 45.0) & (expected < 1.0 / 0.6)
    assert inside.sum() > 100
    assert inverse[inside] == pytest.approx(
        np.repeat(expected[inside, None], WIDTH, axis=1), rel=2e-4
    )
    assert (inverse[expected <= 0.0] == 0.0).all()


def test_a_ridge_hides_what_is_behind_it_and_not_what_is_before_it():
    def ridge(x, y):
        return 3.0 * np.exp(-((x - 10.0) ** 2) / 2.0)

    for x, visible in ((6.0, True), (16.0, False), (30.0, False)):
        picture = ground_picture(ridge)
        put(picture, board(x, 0.0, 0.6), RED)
        assert (count(picture) > 50) == visible and (count(picture) == 0) != visible
    picture = ground_picture(level)
    put(picture, board(16.0, 0.0, 0.6), RED)
    assert count(picture) == pytest.approx((200.0 * 0.6 / 16.0) ** 2, rel=0.2)


def test_the_nearer_of_two_polygons_is_seen_in_any_order():
    near, far = board(6.0, 0.0, 1.5), board(8.0, 0.0, 1.5, side=2.0)
    pictures = []
    for order in ((near, far), (far, near)):
        picture = ground_picture(level)
        for quad in order:
            put(picture, quad, RED if quad is near else (0, 0, 255))
        pictures.append(picture)
        assert count(picture) == pytest.approx((200.0 * 0.6 / 6.0) ** 2, rel=0.15)
    assert np.array_equal(pictures[0].colours, pictures[1].colours)


def test_a_path_is_hidden_behind_a_hill_and_drawn_before_it():
    path = np.stack([np.linspace(3.0, 24.0, 60), np.zeros(60)], axis=1)
    rows = {}
    for name, height in (("level", 0.0), ("hill", 3.0)):
        terrain = TerrainSource(bump(10.0, 0.0, height))
        landscape = Landscape.around(terrain, path, 1.0, 2.0)
        picture = Picture(WIDTH, HEIGHT)
        picture.ground(landscape.grid, eye())
        before, after = resampled(path[path[:, 0] < 8.0], 0.1), resampled(path[30:], 0.1)
        for line, colour in ((before, (0, 0, 255)), (after, RED)):
            picture.line(eye(), landscape, line, colour)
        rows[name] = count(picture), int((picture.colours == (0, 0, 255)).all(axis=2).sum())
    assert rows["level"][0] > 15 and rows["hill"][0] == 0
    assert min(rows[name][1] for name in rows) > 100


@pytest.mark.parametrize("opacity", [0.25, 1.0])
def test_only_opaque_polygons_enter_the_depth_buffer(opacity):
    picture = ground_picture(level)
    before = picture.inverse.copy()
    put(picture, board(6.0, 0.0, 1.5), RED, opacity)
    assert np.array_equal(before, picture.inverse) == (opacity < 1.0)


def test_mirrored_ground_in_mirrored_light_gives_the_mirrored_picture():
    hill, mirrored = bump(9.0, 3.0), bump(9.0, -3.0)
    one = ground_picture(hill)
    other = ground_picture(mirrored, light=(LIGHT[0], -LIGHT[1], LIGHT[2]))
    assert np.allclose(one.inverse, other.inverse[:, ::-1], rtol=1e-5)
    difference = np.abs(one.colours.astype(int) - other.colours[:, ::-1])
    assert difference.max() <= 2 and difference.mean() < 0.01
    assert np.abs(one.colours.astype(int) - other.colours).mean() > 1.0


def test_a_hill_in_the_north_is_at_the_left_of_an_eye_that_looks_east():
    inverse = ground_picture(bump(12.0, 5.0, 4.0)).inverse
    higher = (inverse[:80] > 0.0).sum(axis=0)  # ground above the horizon
    assert higher[: WIDTH // 2].sum() > 500 and higher[WIDTH // 2 :].sum() == 0


def test_softening_changes_edges_alone():
    picture = np.full((20, 20, 3), 100, dtype=np.uint8)
    picture[:, 10:] = 200
    out = np.empty_like(picture)
    raster.soften(picture, 70, out)
    changed = np.flatnonzero((out != picture).any(axis=(0, 2)))
    assert changed.tolist() == [9, 10]
    assert out[5, 9, 0] == 100 + 100 // 8 + 1 and out[5, 10, 0] == 200 - 100 // 8


def test_a_ground_grid_is_flat_beyond_its_edge():
    ground = grid(lambda x, y: 0.0 * x + 1.0)
    picture = Picture(WIDTH, HEIGHT)
    far = eye(z=3.0, y=500.0)
    raster.trace(ground, far, picture.inverse)
    expected = (np.arange(HEIGHT) + 0.5 - 80.0) / 200.0 / 2.0
    inside = expected > 1.0 / 45.0
    inside &= expected < 2.0
    assert picture.inverse[inside, 7] == pytest.approx(expected[inside], rel=1e-3)


def test_a_polygon_that_reaches_behind_the_eye_is_left_out():
    picture = ground_picture(level)
    before = picture.colours.copy()
    reaching = np.array([[(-2.0, -1.0, 0.5), (8.0, -1.0, 0.5), (8.0, 1.0, 0.5), (-2.0, 1.0, 0.5)]])
    put(picture, reaching, RED)
    assert np.array_equal(picture.colours, before)
