"""The map of the ground: its colours are the plant's parameters, in space and in time."""

import numpy as np
import pytest

from tests.rendering.picture_cases import CENTRED, episode, last_picture, pixel, region
from tracked_env.rendering import Renderer, canvas, snapshot, soil_map


def test_the_map_is_that_of_the_plant() -> None:
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
        env = episode({"schedule": schedule, "start": {**CENTRED, **place}})
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
        near = picture[320 - 82 : 320 - 77, 340 + 14 : 340 + 19].reshape(-1, 3).astype(int)
        assert np.abs(near - expected).max(axis=1).min() <= 3
    assert len(values) >= 8


@pytest.mark.parametrize("duration", [0.0, 0.3])
def test_an_event_in_time_changes_the_colour_of_the_map_when_it_acts(duration: float) -> None:
    ramp = {"parameter": "lateral_resistance", "kind": "ramp", "target": 0.2, "start": 0.1,
            "duration": duration}  # fmt: skip
    env = episode({"schedule": [ramp]})
    before = pixel(last_picture(env, 4), 0.13, 5.4)
    after = pixel(last_picture(env, 1 + round(50 * duration)), 0.13, 5.4)
    assert before == canvas.SOIL_SCALE[170].tolist()
    assert after == canvas.SOIL_SCALE[42].tolist()


def test_the_map_steps_in_ramps_and_is_exact_elsewhere() -> None:
    ramps = np.array([[0.0, 0, 1.0, 1.0, 0.0, 0, 0, 0], [0.0, 0, 1.0, 2.0, 0.5, 0, 0, 0]])
    colours = [soil_map.map_time(ramps, t) for t in (0.5, 1.0, 1.9, 2.0, 2.19, 2.3, 2.45, 2.5, 9.0)]
    assert colours == pytest.approx([0.0, 1.0, 1.0, 2.0, 2.0, 2.2, 2.4, 2.5, 2.5])


def test_the_ground_shows_the_parameter_that_is_asked_for() -> None:
    env = episode({"schedule": [region(0.0, 5.5)]})
    colours = {}
    for name in (None, "cohesion"):
        picture = Renderer("rgb_array", 50, soil_parameter=name).draw(env.simulation, 0)
        colours[name] = pixel(picture, 0.1, 5.4), pixel(picture, 0.1, -5.4)
    assert colours[None][0] != colours[None][1]
    assert colours["cohesion"] == (canvas.SOIL_SCALE[224].tolist(),) * 2
