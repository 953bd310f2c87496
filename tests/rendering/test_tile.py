"""Pictures of many vehicles are tiles, whose few texts can be read when they are small."""

import time

import numpy as np
import pytest

from tests.rendering.picture_cases import started
from tracked_env.rendering import Renderer
from tracked_env.rendering.legend import STRIP
from tracked_env.rendering.renderer import MOST_PANELS
from tracked_env.vector_env import TrackedVehicleVectorEnv

FILM = 240  # [px] width of a tile in a film of 1920 px with eight tiles in a row
LEAST = 8  # [px] height of capital letters that can be read


def pictures(count: int) -> tuple[np.ndarray, ...]:
    env = TrackedVehicleVectorEnv(count, render_mode="rgb_array")
    env.reset(seed=0)
    env.step(np.full((count, 2), 0.2, np.float32))
    drawn = env.render()
    assert drawn is not None
    env.close()
    return drawn


def test_many_vehicles_are_drawn_as_tiles_and_few_with_their_panels() -> None:
    assert {picture.shape for picture in pictures(MOST_PANELS)} == {(640, 960, 3)}
    tiles = pictures(MOST_PANELS + 1)
    assert {picture.shape for picture in tiles} == {(640, 680, 3)}
    assert not np.array_equal(tiles[0], tiles[1])


def test_texts_of_a_tile_can_be_read_in_a_film_of_many() -> None:
    env = started()
    drawn = Renderer("rgb_array", 50, layout="tile").draw(env.simulation, 0)
    assert drawn is not None
    for strip in (drawn[:STRIP], drawn[-STRIP:]):
        for half in (strip[:, :300], strip[:, 380:]):
            dark = (half.max(axis=2) < 100).any(axis=1)
            assert np.flatnonzero(dark).size * FILM / 680 >= LEAST


@pytest.mark.parametrize("layout", ["panel", "tile"])
def test_a_layout_that_is_asked_for_does_not_depend_on_the_number_of_vehicles(layout: str) -> None:
    shapes = set()
    for count in (1, MOST_PANELS + 1):
        env = TrackedVehicleVectorEnv(count)
        env.reset(seed=0)
        renderer = Renderer("rgb_array", 50, layout=layout)
        drawn = renderer.draw(env.simulation, 0)
        assert drawn is not None and drawn.shape[1::-1] == renderer.size
        shapes.add(drawn.shape)
    assert len(shapes) == 1
    with pytest.raises(ValueError, match="layout"):
        Renderer("rgb_array", 50, layout="stamp")


def test_a_tile_takes_less_than_a_tenth_of_a_second() -> None:
    env = TrackedVehicleVectorEnv(16, render_mode="rgb_array")
    env.reset(seed=0)
    action = np.full((16, 2), 0.2, np.float32)
    times = []
    for _ in range(4):
        env.step(action)
        began = time.process_time()
        env.render()
        times.append((time.process_time() - began) / 16)
    env.close()
    assert min(times) < 0.1  # [s] of the processor
