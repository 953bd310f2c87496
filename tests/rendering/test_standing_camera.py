"""The standing eye: it keeps its place while it sees the vehicle, and its ground is drawn once."""

from typing import Any

import numpy as np
import pytest

from tests.rendering.picture_cases import started
from tests.rendering.terrain_cases import bump
from tracked_env.physics.parameters import STATE_NAMES
from tracked_env.rendering import Renderer, TerrainSource

HILL = TerrainSource(bump(9.0, -3.0, 2.0, 1.5), centre_height=0.5)
AHEAD = [2.0, 5.0, 8.0]  # [m] in front of the eye, 7.4 m behind the start


def moved(env: Any, **state: float) -> None:
    for name, value in state.items():
        env.simulation.batch.state()[0, STATE_NAMES.index(name)] = value


def drawn(renderer: Renderer, env: Any) -> np.ndarray:
    picture = renderer.draw(env.simulation, 0)
    assert picture is not None
    return picture


def place(renderer: Renderer) -> tuple[float, ...]:
    """Where the eye of the last picture stands."""
    stage = renderer._stage
    assert stage is not None and stage.perspective is not None
    assert stage.perspective._eye is not None
    return tuple(stage.perspective._eye[:5])


def test_the_eye_stands_while_the_vehicle_is_well_seen_and_then_takes_a_new_place() -> None:
    env = started()
    renderer = Renderer("rgb_array", 50, view="3d-standing", terrain=HILL)
    drawn(renderer, env)
    first = place(renderer)
    for x in AHEAD[:2]:
        moved(env, x=x, yaw=0.3)
        drawn(renderer, env)
        assert place(renderer) == first
    for far in ({"x": 8.0}, {"x": 4.0, "y": 6.0}, {"x": -4.0, "y": 0.0}):
        moved(env, **far)
        before = place(renderer)
        drawn(renderer, env)
        assert place(renderer) != before


def test_a_hill_in_between_gives_the_eye_a_new_place() -> None:
    for y, stays in ((0.0, False), (20.0, True)):  # of the hill
        env = started()
        terrain = TerrainSource(bump(1.0, y, 3.0, 0.7), centre_height=0.5)
        renderer = Renderer("rgb_array", 50, view="3d-standing", terrain=terrain)
        moved(env, x=-3.0)
        drawn(renderer, env)
        first = place(renderer)
        moved(env, x=3.0)
        drawn(renderer, env)
        assert (place(renderer) == first) == stays


RAMP = {"parameter": "lateral_resistance", "kind": "ramp", "target": 0.2, "start": 0.4,
        "duration": 0.8}  # fmt: skip


@pytest.mark.parametrize("schedule", [[], [RAMP]])
def test_ground_that_is_shown_again_gives_the_pixels_of_ground_that_is_drawn_anew(
    schedule: list[Any],
) -> None:
    env = started({"schedule": schedule})
    again = Renderer("rgb_array", 50, view="3d-standing", terrain=HILL)
    anew = Renderer("rgb_array", 50, view="3d-standing", terrain=HILL)
    last = np.zeros(0)
    for _ in range(6):
        for _ in range(15):
            env.step(np.array([0.3, 0.35], dtype=np.float32))
        stage = anew._stage
        if stage is not None and stage.perspective is not None:
            stage.perspective._eye, stage.perspective._standing = None, False  # all anew
        one, other = drawn(again, env), drawn(anew, env)
        assert np.array_equal(one, other) and not np.array_equal(one, last)
        last = one
