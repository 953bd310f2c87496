"""The formulas of events: closed forms inside the maps, and no position that breaks them."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.driving import make
from tracked_env import events
from tracked_env.events import _FIELDS, KINDS, decode_event, encode_event, encode_schedule
from tracked_env.physics.parameters import RANGES

LARGEST = np.finfo(float).max
POSITIONS = st.floats(-LARGEST, LARGEST)
MAP = {"parameter": "lateral_resistance", "kind": "wave", "target": 0.6, "amplitude": 0.03}
MAP |= {"k_x": 0.2, "phase": -0.5 * math.pi, "decay": 0.01}


def value_after(event, x, y, time=0.0, before=0.8):
    """The value after one event, as the kernel computes it."""
    return events.changed_value(before, encode_schedule([event])[None], 0, 0, time, x, y)


def event_of(kind, ends):
    """An event with every field at the lower (False) or upper (True) end of its range."""
    parameter = "lateral_resistance"
    fields = {
        name: allowed.high if end else allowed.low
        for (name, _, allowed), end in zip(_FIELDS[kind], ends, strict=False)
    }
    target = RANGES[parameter].high if ends[-1] else RANGES[parameter].low
    return {"parameter": parameter, "kind": kind, "target": target, **fields}


def test_a_wave_is_its_formula_to_the_bit_wherever_a_map_may_lie():
    rng = np.random.default_rng(0)
    for x, y in rng.uniform(-1e4, 1e4, (500, 2)):
        plain = 0.6 + 0.03 * x * math.cos(0.2 * x + 0.0 * y - 0.5 * math.pi) * math.exp(-0.01 * y)
        assert value_after(MAP, x, y) == min(max(plain, 0.2), 1.5)


@pytest.mark.parametrize("kind", events.KINDS)
@given(x=POSITIONS, y=POSITIONS, ends=st.lists(st.booleans(), min_size=6, max_size=6))
@example(x=0.0, y=-8e4, ends=[True] * 6)
@example(x=0.0, y=-LARGEST, ends=[True] * 6)
@example(x=LARGEST, y=-LARGEST, ends=[True] * 6)
@example(x=LARGEST, y=LARGEST, ends=[True, True, False, False, False, True])
def test_every_finite_position_gives_a_value_inside_the_range_of_the_parameter(kind, x, y, ends):
    low, high, *_ = RANGES["lateral_resistance"]
    assert low <= value_after(event_of(kind, ends), x, y, time=3.0) <= high


def test_a_region_and_a_line_are_complete_far_inside_and_absent_far_outside():
    region = {"parameter": "mass", "kind": "region", "target": 9.0e3, "x": 1.0, "y": 2.0}
    region = {**region, "radius": 3.0}
    line = {"parameter": "mass", "kind": "line", "target": 9.0e3, "x": 1.0, "y": 2.0}
    line = {**line, "direction": 0.0}
    assert value_after(region, 1.0, 2.0, before=1e3) == 9e3
    assert value_after(region, LARGEST, -LARGEST, before=1e3) == 1e3
    assert value_after(line, LARGEST, LARGEST, before=1e3) == 9e3
    assert value_after(line, -LARGEST, LARGEST, before=1e3) == 1e3


def test_an_episode_that_starts_far_from_the_origin_of_a_map_has_no_nan():
    reference = {"kind": "straight", "speed": 1.0, "y": -8e4}
    env = make(uncertainty="resistance-map", reference=reference, expose_truth=True)
    start = {"offset_x": 0.0, "offset_y": 0.0}
    observation, info = env.reset(seed=0, options={"start": start})
    assert np.isfinite(observation).all()
    assert info["truth"]["lateral_resistance"] == 0.6  # at X = 0 the map is its mean
    for _ in range(20):
        observation, reward, terminated, _, info = env.step(np.float32([0.2, 0.2]))
        assert np.isfinite(observation).all() and math.isfinite(reward) and not terminated
        assert 0.2 <= info["truth"]["lateral_resistance"] <= 1.5


@pytest.mark.parametrize("kind", KINDS)
def test_a_row_that_is_decoded_and_encoded_again_is_the_same_row(kind):
    rng = np.random.default_rng(0)
    for _ in range(100):
        numbers = {name: abs(rng.normal()) + 0.1 for name, _, _ in _FIELDS[kind]}
        numbers |= {"phase": -0.3} if kind == "wave" else {}
        event = {"parameter": "lateral_resistance", "kind": kind, "target": 0.7, **numbers}
        row = encode_event(event)
        decoded = decode_event([*row, numbers.get("direction", 0.0)])
        assert decoded == event and encode_event(decoded) == row
        assert encode_event(decode_event(row)) == pytest.approx(row, rel=1e-15)
