"""What a policy believes stands in the panel beside the truth, to scale."""

import math

import numpy as np
import pytest

from tests.rendering.picture_cases import episode
from tracked_env.physics import lumped
from tracked_env.rendering import Renderer, TerrainSource, canvas, panel, snapshot
from tracked_env.rendering.canvas import value_of
from tracked_env.rendering.panel import PITCH, SIGMAS, TOP

SCENE = 640  # [px]
SCALE = SCENE + 206, 50  # [px] left end and width
ENDS = 0.0, 2.0  # [-] of a scale, in nominal values


def pixels(simulation, beliefs):
    picture = Renderer("rgb_array", 50).draw(simulation, 0, beliefs)
    return picture


def band(picture, row):
    """First and last column of the band in a row, relative to its scale."""
    line = picture[TOP + PITCH * row + 8, SCALE[0] : SCALE[0] + SCALE[1]]
    blue = [canvas.PALE_BLUE, canvas.BLUE, canvas.INK]  # the estimate and the truth lie on it
    columns = [k for k, pixel in enumerate(line.tolist()) if tuple(pixel) in blue]
    return columns[0], columns[-1]


def test_beliefs_change_the_rows_of_the_panel_and_nothing_else():
    simulation = episode().simulation
    without, with_them = pixels(simulation, None), pixels(simulation, {"mass": (1000.0, 50.0)})
    different = np.argwhere((without != with_them).any(axis=2))
    rows, columns = different[:, 0], different[:, 1]
    assert columns.min() >= SCENE and rows.min() >= TOP - 22
    assert rows.max() <= TOP + PITCH * panel.MAX_ROWS
    assert np.array_equal(without, pixels(simulation, None))


@pytest.mark.parametrize("plant", ["lumped", "distributed"])
def test_texts_have_10_px_where_a_picture_is_650_px_wide_and_none_covers_another(
    plant, monkeypatch
):
    boxes = {}

    def recorded(string, size, *style):
        assert size * 650 / Renderer("rgb_array", 50).size[0] >= 10.0, string
        return image_of(string, size, *style)

    def put(self, string, x, y, size=canvas.TEXT, colour=canvas.INK, bold=False, align=0.0):
        ink = image_of(string, size, bold, colour).get_bounding_rect()
        width = written(self, string, x, y, size, colour, bold, align)
        box = ink.move(x - round(align * width), y)
        assert self.surface.get_rect().contains(box), string
        others = boxes.setdefault(self.surface.get_size(), {})
        assert box.collidelist(list(others)) < 0, string
        others[tuple(box)] = string
        return width

    image_of, written = canvas.text_image, canvas.Sheet.put
    monkeypatch.setattr(canvas, "text_image", recorded)
    monkeypatch.setattr(canvas.Sheet, "put", put)
    simulation = episode(plant=plant).simulation
    names = snapshot.take(simulation, 0).plant.panel
    everything = {name: (value_of(simulation.solver.nominal, name), 0.1) for name in names}
    terrain = TerrainSource(wavy, lambda *_: np.full((2, 4, 2), 900.0))
    for beliefs in (None, everything):
        boxes.clear()
        assert Renderer("rgb_array", 50, terrain=terrain).draw(simulation, 0, beliefs) is not None
        assert {len(texts) > 10 for texts in boxes.values()} == {True} and len(boxes) == 3


def wavy(x, y):
    return 0.5 * np.sin(0.5 * x) * np.cos(0.4 * y)


def test_a_band_reaches_as_far_as_95_percent_of_a_normal_distribution():
    simulation = episode().simulation
    nominal = simulation.solver.nominal.mass
    value, deviation = 0.9 * nominal, 0.2 * nominal
    picture = pixels(simulation, {"mass": (value, deviation)})
    width = (SCALE[1] - 1) / (2.0 * nominal)
    expected = [width * (value + side * SIGMAS * deviation) for side in (-1, 1)]
    assert band(picture, 0) == pytest.approx(expected, abs=1.1)
    assert math.erf(SIGMAS / math.sqrt(2.0)) == pytest.approx(0.95, abs=1e-6)


def test_bands_beyond_the_scale_end_with_it_and_unknown_ones_are_not_drawn():
    simulation = episode().simulation
    wide = pixels(simulation, {"mass": (simulation.solver.nominal.mass, 1e9)})
    assert band(wide, 0) == pytest.approx((0, SCALE[1] - 1), abs=1)
    unknown = pixels(simulation, {"mass": (math.nan, math.nan)})
    assert np.array_equal(unknown, pixels(simulation, {}))


def test_the_largest_effort_stands_for_the_strengths_that_make_it_up():
    shot = snapshot.take(episode().simulation, 0)
    true = float(lumped.drive_limits(shot.parameters).effort_maximum)
    rows = {row.name: row for row in panel.belief_rows(shot, {"effort_maximum": (2e4, 1e3)})}
    assert "cohesion" not in rows and "friction_angle" not in rows
    assert rows["effort_maximum"].truth == true
    usual = {row.name for row in panel.belief_rows(shot, {"mass": (1.0, 1.0)})}
    assert {"cohesion", "friction_angle"} <= usual and "effort_maximum" not in usual


def test_an_angle_of_friction_is_shown_as_the_friction_of_patches():
    simulation = episode(plant="distributed").simulation
    shot = snapshot.take(simulation, 0)
    (row,) = [
        row
        for row in panel.belief_rows(shot, {"friction_angle": (0.5, 0.1)})
        if row.name == "friction"
    ]
    assert row.truth == math.tan(shot.parameters.friction_angle)
    ends = [math.tan(0.5 + side * SIGMAS * 0.1) for side in (-1, 1)]
    assert [row.value, row.low, row.high] == pytest.approx([math.tan(0.5), *ends])


def test_what_the_plant_does_not_read_is_not_shown():
    shot = snapshot.take(episode(plant="distributed").simulation, 0)
    assert "lateral_resistance" not in shot.reads
    names = {row.name for row in panel.belief_rows(shot, {"lateral_resistance": (0.5, 0.1)})}
    assert "lateral_resistance" not in names
