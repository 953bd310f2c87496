"""Terrains: what each kind is, slopes that are derivatives, maps from files, what is refused."""

import importlib.util
import json
import math
import sys

import numpy as np
import pytest

from tracked_env.arrays import STEEPEST
from tracked_env.terrain import height_field
from tracked_env.terrain.ground import fill_places
from tracked_env.terrain.height_field import KINDS, make_height_field

RNG = np.random.default_rng(0)
X, Y = RNG.uniform(-3.0, 4.0, (2, 400))
SMOOTH = RNG.normal(0.0, 0.05, (15, 21)).cumsum(axis=0).cumsum(axis=1) * 0.1
SOME = {
    "plane": {"kind": "plane", "height": 0.5, "slope_x": 0.2, "slope_y": -0.1},
    "ramp": {"kind": "ramp", "slope": 0.3, "start": -0.5, "length": 1.5, "direction": 0.7},
    "step": {"kind": "step", "height": -0.2, "start": 0.3, "length": 0.8, "direction": -2.0},
    "hills": {"kind": "hills"},
    "crossing": {"kind": "crossing"},
    "waves": {"kind": "waves", "waves": [[0.06, 1.1, 0.4, 0.3], [0.05, -0.5, 1.2, 1.0]]},
    "fractal": {"kind": "fractal", "seed": 5},
    "bicubic": {"kind": "map", "heights": SMOOTH, "cell": 0.5, "interpolation": "bicubic"},
}


def slope_errors(field, x, y, d=1e-6):
    """Slopes less central differences of the height."""
    _, slope_x, slope_y = field.at(x, y)
    along = (field.at(x + d, y)[0] - field.at(x - d, y)[0]) / (2 * d)
    aside = (field.at(x, y + d)[0] - field.at(x, y - d)[0]) / (2 * d)
    return slope_x - along, slope_y - aside


@pytest.mark.parametrize("name", SOME)
def test_the_slopes_are_the_derivatives_of_the_height(name):
    assert np.abs(slope_errors(make_height_field(SOME[name]), X, Y)).max() < 1e-7


def test_a_ramp_and_a_step_are_as_their_equations_say():
    x = np.linspace(-1.0, 4.0, 501)
    ramp = make_height_field({"kind": "ramp", "slope": 0.3, "start": 1.0, "length": 2.0})
    u = (x - 1.0) / 2.0
    inside = 0.3 * 2.0 * (u / 2 - np.sin(np.pi * u) / (2 * np.pi))
    expected = np.where(u < 0, 0.0, np.where(u > 1, 0.3 * (x - 2.0), inside))
    assert ramp.at(x, 0.0)[0] == pytest.approx(expected, abs=1e-14)
    step = make_height_field({"kind": "step", "height": 0.2, "start": 1.0, "length": 2.0})
    inside = 0.2 * (u - np.sin(2 * np.pi * u) / (2 * np.pi))
    expected = np.where(u < 0, 0.0, np.where(u > 1, 0.2, inside))
    height, slope, _ = step.at(x, 0.0)
    assert height == pytest.approx(expected, abs=1e-14)
    assert slope.max() == pytest.approx(2 * 0.2 / 2.0)


def test_hills_are_a_product_and_crossing_ridges_a_sum():
    k = 2 * np.pi / 8.0
    hills = make_height_field({"kind": "hills", "height": 0.3, "wavelength": 8.0})
    assert hills.at(X, Y)[0] == pytest.approx(0.3 * np.sin(k * X) * np.sin(k * Y), abs=1e-14)
    ridges = make_height_field({"kind": "crossing", "height": 0.3, "wavelength": 8.0, "angle": 1.2})
    other = X * math.cos(1.2) + Y * math.sin(1.2)
    expected = 0.15 * (np.sin(k * X) + np.sin(k * other))
    assert ridges.at(X, Y)[0] == pytest.approx(expected, abs=1e-14)


def test_a_fractal_has_the_deviation_and_the_spectrum_that_it_states():
    spec = {"kind": "fractal", "height": 0.1, "hurst": 0.7, "count": 24, "seed": 3}
    waves = make_height_field(spec).relief.waves
    assert np.array_equal(waves, make_height_field(spec).relief.waves)
    assert not np.array_equal(waves, make_height_field({**spec, "seed": 4}).relief.waves)
    k = np.hypot(waves[:, 1], waves[:, 2])
    assert 0.5 * (waves[:, 0] ** 2).sum() == pytest.approx(0.01)
    falls = np.polyfit(np.log(k), np.log(waves[:, 0]), 1)[0]
    assert falls == pytest.approx(-0.7)
    x, y = np.random.default_rng(1).uniform(-500.0, 500.0, (2, 20000))
    assert make_height_field(spec).at(x, y)[0].std() == pytest.approx(0.1, rel=0.05)


def test_a_list_is_the_sum_of_its_parts():
    parts = [SOME["plane"], SOME["ramp"], SOME["waves"], SOME["bicubic"]]
    total = make_height_field(parts).at(X, Y)
    singles = np.sum([make_height_field(part).at(X, Y) for part in parts], axis=0)
    assert np.array(total) == pytest.approx(singles, abs=1e-14)


@pytest.mark.parametrize("name", SOME)
def test_a_terrain_written_as_json_is_the_same_terrain(name):
    field = make_height_field(SOME[name])
    read = make_height_field(json.loads(field.to_json()))
    assert np.array_equal(field.at(X, Y), read.at(X, Y))
    assert make_height_field(field) is field


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("waves", "map")])
def test_every_kind_has_defaults(kind):
    height, *slopes = make_height_field(kind).at(X, Y)
    assert np.isfinite(height).all() and np.abs(slopes).max() < STEEPEST


def test_a_map_goes_through_its_heights_and_both_interpolations_keep_a_plane():
    rows, columns = np.mgrid[0:15, 0:21]
    x, y = -5.0 + 0.5 * columns, -3.5 + 0.5 * rows
    for interpolation in ("bilinear", "bicubic"):
        spec = {"kind": "map", "cell": 0.5, "interpolation": interpolation}
        field = make_height_field({**spec, "heights": SMOOTH})
        assert field.at(x, y)[0] == pytest.approx(SMOOTH, abs=1e-14)
        plane = make_height_field({**spec, "heights": 0.3 * x - 0.2 * y})
        height, slope_x, slope_y = plane.at(X, 0.5 * Y)
        assert height == pytest.approx(0.3 * X - 0.1 * Y, abs=1e-13)
        assert slope_x == pytest.approx(0.3, abs=1e-12)
        assert slope_y == pytest.approx(-0.2, abs=1e-12)


def test_bicubic_slopes_are_continuous_where_bilinear_slopes_jump_by_curvature_times_cell():
    x = np.arange(-40, 41) * 0.25
    heights = np.tile(0.1 * x * x, (5, 1))
    jumps = {}
    for interpolation in ("bilinear", "bicubic"):
        spec = {"kind": "map", "heights": heights, "cell": 0.25, "interpolation": interpolation}
        field = make_height_field(spec)
        jumps[interpolation] = field.at(2.0 + 1e-9, 0.0)[1] - field.at(2.0 - 1e-9, 0.0)[1]
    assert jumps["bilinear"] == pytest.approx(0.2 * 0.25, rel=1e-6)
    assert abs(jumps["bicubic"]) < 1e-8


def test_beyond_its_edge_a_map_keeps_the_height_of_the_edge_and_says_so():
    field = make_height_field({"kind": "map", "heights": SMOOTH, "cell": 0.5, "origin": [1.0, 2.0]})
    height, slope_x, slope_y = field.at(100.0, 4.3)
    assert height == pytest.approx(field.at(11.0, 4.3)[0])
    assert slope_x == 0.0 and slope_y != 0.0
    w = np.zeros((5, 5))
    w[:2] = (3.0, 0.5, 3.0, 100.0, 3.0), (4.0, 4.0, 1e300, 4.3, 4.3)
    assert fill_places(field.relief, w) == 3
    assert np.isfinite(w).all()
    assert fill_places(make_height_field("hills").relief, np.full((5, 1), 1e6)) == 0
    for bad in (math.nan, math.inf, -math.inf):  # no place is on the map
        w[:2, 0], w[:2, 1] = (bad, 3.0), (3.0, bad)
        assert fill_places(field.relief, w[:, :2].copy()) == 2


def written(tmp_path):
    """The same heights in every kind of file, with what a file does not say."""
    heights = np.round(1000.0 * (SMOOTH - SMOOTH.min())) / 1000.0
    np.save(tmp_path / "map.npy", heights)
    np.savez(tmp_path / "map.npz", height=heights, x0=-1.0, y0=2.0, spacing=0.5)
    return heights


def test_maps_are_read_from_numpy_files(tmp_path):
    heights = written(tmp_path)
    array = make_height_field({"kind": "map", "heights": heights, "cell": 0.5, "origin": (-1, 2)})
    npy = {"kind": "map", "file": str(tmp_path / "map.npy"), "cell": 0.5, "origin": [-1.0, 2.0]}
    npz = {"kind": "map", "file": str(tmp_path / "map.npz")}
    for spec in (npy, npz):
        assert np.array_equal(make_height_field(spec).at(X, Y), array.at(X, Y))
    doubled = make_height_field({**npz, "scale": 2.0, "cell": 1.0})
    assert doubled.relief.heights == pytest.approx(2.0 * heights)
    assert doubled.relief.frame[2] == 1.0


def test_a_grey_image_of_16_bits_is_a_map_with_its_upper_edge_at_the_largest_y(tmp_path):
    image = pytest.importorskip("PIL.Image")
    heights = written(tmp_path)
    counts = np.round(1000.0 * heights).astype(np.uint16)
    image.fromarray(counts[::-1].copy()).save(tmp_path / "map.png")
    spec = {"kind": "map", "file": str(tmp_path / "map.png"), "scale": 1e-3, "cell": 0.5}
    assert make_height_field(spec).relief.heights == pytest.approx(heights, abs=1e-12)


def write_geotiff(path, heights, x, y):
    """Heights with cells of 0.5 m; (x, y) [m]: the upper left corner of the first cell."""
    rasterio = pytest.importorskip("rasterio")
    rows, columns = heights.shape
    form = {"driver": "GTiff", "height": rows, "width": columns, "count": 1, "dtype": "float64"}
    form["transform"] = rasterio.transform.from_origin(x, y, 0.5, 0.5)
    with rasterio.open(path, "w", **form) as target:
        target.write(heights[::-1], 1)


def test_a_geotiff_brings_its_cell_and_its_origin(tmp_path):
    heights = written(tmp_path)
    write_geotiff(tmp_path / "map.tif", heights, -1.0, 3.0)
    field = make_height_field({"kind": "map", "file": str(tmp_path / "map.tif")})
    assert field.relief.heights == pytest.approx(heights)
    first = 3.0 - (len(heights) - 0.5) * 0.5
    assert field.relief.frame[:3] == pytest.approx([-0.75, first, 2.0])


MAP = {"kind": "map", "cell": 0.5}
FLAT = [[0.0, 0.0], [0.0, 0.0]]


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("hils", "unknown terrain kind 'hils'.*Did you mean 'hills'"),
        (3.0, "terrain = 3.0; must be a kind, a dict"),
        ({"kind": "plane", "slope": 0.1}, "key 'slope'.*Did you mean 'slope_y'|'slope_x'"),
        ({"kind": "plane", "slope_x": 20.0}, r"plane slope_x = 20.0; .*\[-5, 5\].*tangent"),
        ({"kind": "ramp", "length": 0.0}, "ramp length = 0.0 m; .*not 0"),
        ({"kind": "step", "height": 1.0, "length": 0.1}, "slope of up to 20; must be at most 5"),
        ({"kind": "waves", "waves": [[1.0, 2.0]]}, r"waves of shape \(1, 2\); must be finite rows"),
        ({"kind": "waves", "waves": [[9.0, 2.0, 0.0, 0.0]]}, "slope of up to 18"),
        ({"kind": "fractal", "seed": 0.5}, "fractal seed = 0.5; must be a whole number"),
        ({"kind": "fractal", "longest": 1.0, "shortest": 2.0}, "must be at most longest = 1.0 m"),
        (MAP, "must have either 'heights' or 'file'"),
        ({**MAP, "heights": [[1.0]]}, r"shape \(1, 1\); must be at least 2 x 2"),
        ({**MAP, "heights": [1.0, 2.0]}, r"shape \(2,\); must be \(rows, columns\)"),
        ({**MAP, "heights": [[1.0, 2.0], [3.0]]}, "rows of equal length"),
        ({**MAP, "heights": [[0.0, math.nan], [0.0, 0.0]]}, r"heights\[0\]\[1\] of a map = nan"),
        ({**MAP, "heights": [[0.0, 9.0], [0.0, 0.0]]}, "other units than the cells"),
        ({"kind": "map", "heights": FLAT}, "lacks 'cell'"),
        ({**MAP, "heights": FLAT, "origin": 3.0}, r"must be \[x, y\]"),
        ({**MAP, "heights": FLAT, "interpolation": "nearest"}, "unknown interpolation 'nearest'"),
        ({**MAP, "file": "/nowhere/map.npy"}, "no such file. Is the path relative"),
        ({**MAP, "file": "map.obj"}, "must end in one of"),
        ([{**MAP, "heights": FLAT}] * 2, "two maps; must be one at most"),
    ],
)
def test_a_wrong_terrain_is_refused_in_one_line(spec, says):
    with pytest.raises(ValueError, match=says) as error:
        make_height_field(spec)
    assert "\n" not in str(error.value)


DAMAGED = {
    "cut.npz": lambda whole: whole[:-40],
    "no.npz": lambda whole: b"no archive at all",
    "flipped.npz": lambda whole: whole[:80] + bytes(255 - b for b in whole[80:120]) + whole[120:],
    "header.npy": lambda whole: b"\x93NUMPY\x01\x00\x12\x00{'descr': ((( '<f8\n",
    "no.npy": lambda whole: b"no array",
    "empty.npy": lambda whole: b"",
    "no.png": lambda whole: b"\x89PNG\r\n\x1a\n" + bytes(20),
    "no.tif": lambda whole: b"II*\x00" + bytes(20),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_is_refused_in_one_line(name, tmp_path):
    pytest.importorskip({"png": "PIL", "tif": "rasterio"}.get(name[-3:], "numpy"))
    np.savez(tmp_path / "whole.npz", height=SMOOTH, x0=0.0, spacing=0.5)
    (tmp_path / name).write_bytes(DAMAGED[name]((tmp_path / "whole.npz").read_bytes()))
    with pytest.raises(ValueError, match=rf"{name}'; cannot be read") as error:
        make_height_field({**MAP, "file": str(tmp_path / name)})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"other": np.zeros((3, 3))}, "must hold an array 'height'"),
        ({"height": SMOOTH, "x0": [0.0, 1.0]}, "cannot be read"),
        ({"height": SMOOTH, "spacing": "half"}, "cannot be read"),
        ({"height": SMOOTH + 1.0j}, "are not numbers"),
        ({"height": SMOOTH.astype(str)}, "are not numbers"),
        ({"height": np.array([[None, 1.0]] * 2)}, "cannot be read"),
        ({"height": np.zeros((2000, 2000), np.uint8)}, "unpacks to"),
    ],
)
def test_a_file_of_other_arrays_is_refused_in_one_line(arrays, says, tmp_path, monkeypatch):
    monkeypatch.setattr(height_field, "LARGEST", 1000)
    np.savez_compressed(tmp_path / "map.npz", **arrays)
    with pytest.raises(ValueError, match=says) as error:
        make_height_field({**MAP, "file": str(tmp_path / "map.npz")})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("mode", ["P", "RGB", "LA"])
def test_colours_of_a_picture_are_no_heights(mode, tmp_path):
    image = pytest.importorskip("PIL.Image")
    grey = image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8))
    grey.convert(mode).save(tmp_path / "map.png")
    with pytest.raises(ValueError, match=f"of mode {mode}; must be a grey image"):
        make_height_field({**MAP, "file": str(tmp_path / "map.png")})


def test_a_map_in_coordinates_of_a_survey_is_centred_and_a_warning_names_them(tmp_path):
    """The vehicle starts at (0, 0): it would leave the map in its first step."""
    np.savez(tmp_path / "map.npz", height=SMOOTH, x0=500_000.0, y0=5_800_000.0, spacing=0.5)
    files = ["map.npz"]
    if importlib.util.find_spec("rasterio"):
        write_geotiff(tmp_path / "map.tif", SMOOTH, 500_000.0, 5_800_000.0)
        files.append("map.tif")
    for name in files:
        spec = {"kind": "map", "file": str(tmp_path / name)}
        with pytest.warns(UserWarning, match=r"500000.*without \(0, 0\).*middle is put"):
            field = make_height_field(spec)
        half = [-0.25 * (count - 1) for count in SMOOTH.shape[::-1]]
        assert field.relief.frame[:2] == pytest.approx(half)
        placed = make_height_field({**spec, "origin": [500_000.0, 0.0]})
        assert placed.relief.frame[:2] == pytest.approx([500_000.0, 0.0])


@pytest.mark.parametrize("name, module", [("map.png", "PIL"), ("map.tif", "rasterio")])
def test_a_missing_reader_is_named_with_its_extra(name, module, tmp_path, monkeypatch):
    (tmp_path / name).write_bytes(b"")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ValueError, match=r"pip install tracked-env\[terrain\]"):
        make_height_field({**MAP, "file": str(tmp_path / name)})
