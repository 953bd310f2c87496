"""Laws of ground and boxes that change every few seconds: when, between what, and by what mass."""

import math
from collections import defaultdict

import numpy as np
import pytest

from tracked_env.physics.parameters import VEHICLES
from tracked_env.uncertainty import known_laws

FOCCHI = VEHICLES["focchi"]
CENTRE = ("centre_of_mass_x", "centre_of_mass_y", "centre_of_mass_z")


def course(name, seed):
    """What the parameters that change are, {name: values}, the first drawn, and when, of 30 s."""
    draw = known_laws()[name](np.random.default_rng(seed), FOCCHI, None, 30.0)
    values, times = defaultdict(list), defaultdict(list)
    for event in draw.events:
        assert event["kind"] == "ramp" and event["duration"] == 0.0
        values[event["parameter"]].append(event["target"])
        times[event["parameter"]].append(event["start"])
    return {key: [getattr(draw.parameters, key), *values[key]] for key in values}, times


@pytest.mark.parametrize(
    ("name", "slippery", "rough"),
    [
        ("changing-floors", (0.1, 0.15), (0.5, 0.8)),
        ("changing-slope", (0.4, 0.5), (0.7, 0.9)),
        ("changing-hills", (0.4, 0.5), (0.7, 0.9)),
    ],
)
def test_slippery_and_rough_ground_take_turns_every_two_seconds_drawn_anew(name, slippery, rough):
    begins = set()
    for seed in range(12):
        values, times = course(name, seed)
        assert [*values] == ["friction_angle"]
        assert times["friction_angle"] == pytest.approx(np.arange(2.0, 29.0, 2.0))
        friction = [math.tan(angle) for angle in values["friction_angle"]]
        first, second = friction[::2], friction[1::2]
        low, high = sorted((first, second))
        assert slippery[0] <= min(low) and max(low) <= slippery[1]
        assert rough[0] <= min(high) and max(high) <= rough[1]
        assert len(set(friction)) == len(friction)
        begins.add(first is low)
    assert begins == {True, False}


def test_boxes_are_put_down_to_the_bare_vehicle_and_are_others_each_time():
    begins = set()
    for seed in range(12):
        values, times = course("slope-boxes", seed)
        assert times["mass"] == pytest.approx(np.arange(4.5, 28.0, 4.5))
        boxes = np.array(values["mass"]) - FOCCHI.mass
        bare = np.isclose(boxes, 0.0)
        assert np.array_equal(bare[1:], ~bare[:-1])
        begins.add(bool(bare[0]))
        carried = boxes[~bare]
        assert np.all((carried >= 0.2 * FOCCHI.mass) & (carried <= 0.5 * FOCCHI.mass))
        assert len(np.unique(carried)) == len(carried)
        moment = np.array([values[key] for key in CENTRE]) * values["mass"]  # of the box alone
        place = moment[:, ~bare] / carried
        reach = 0.3 * FOCCHI.contact_length, 0.2 * FOCCHI.track_gauge, 0.3 * FOCCHI.contact_length
        assert np.all(np.abs(place) <= np.array(reach)[:, None] * (1.0 + 1e-9))
        assert np.allclose(moment[:, bare], 0.0)
    assert begins == {True, False}
