"""Specifications: what is drawn from them, the arrays they give, and what refusals say."""

import itertools
import math

import numpy as np
import pytest

from tests.references.reference_cases import DURATION, KINDS, POINTS
from tracked_env.references import make_reference, sample
from tracked_env.references.specification import MIXED

SHARP = {"kind": "waypoints", "points": [[0, 0], [1, 0], [1, 1], [0, 1], [0, 2]], "speed": 3.0}


@pytest.mark.parametrize("duration", [0.5, 7.3, 20.0, 20.2])
def test_the_number_of_segments_depends_on_the_duration_alone(duration, rng):
    for kind in KINDS:
        spec = {"kind": kind, "points": POINTS} if kind == "waypoints" else kind
        profile = make_reference(spec, duration, rng)
        shape = (math.ceil(duration / 0.5) + 1, 6)
        assert profile.speed.shape == profile.yaw_rate.shape == shape
        for array in (profile.speed, profile.yaw_rate):
            assert array.dtype == np.float64 and array.flags.c_contiguous and array.flags.writeable


def test_the_same_generator_gives_the_same_reference_and_another_one_another():
    for kind in ("random", "mixed"):
        rngs = (np.random.default_rng(seed) for seed in (1, 1, 2))
        one, same, other = (make_reference(kind, DURATION, rng) for rng in rngs)
        assert np.array_equal(one.speed, same.speed)
        assert np.array_equal(one.yaw_rate, same.yaw_rate)
        assert not np.array_equal(one.yaw_rate, other.yaw_rate)


def test_a_pair_is_drawn_uniformly_whatever_the_order_of_the_keys():
    spec = {"kind": "circle", "radius": [5.0, 15.0], "speed": [1.0, 2.0], "direction": [-1, 1]}
    turned = dict(reversed(spec.items()))
    speeds, radii = [], []
    for seed in range(200):
        one = make_reference(spec, 5.0, np.random.default_rng(seed))
        two = make_reference(turned, 5.0, np.random.default_rng(seed))
        assert np.array_equal(one.yaw_rate, two.yaw_rate) and np.array_equal(one.speed, two.speed)
        speeds.append(one.speed[0, 0])
        radii.append(one.speed[0, 0] / one.yaw_rate[0, 0])
    assert 1.0 <= min(speeds) < 1.05 and 1.95 < max(speeds) <= 2.0
    assert 5.0 <= min(np.abs(radii)) < 5.5 and 14.5 < max(np.abs(radii)) <= 15.0
    assert 60 < np.sum(np.array(radii) > 0.0) < 140


def test_mixed_references_keep_the_lateral_acceleration_that_their_table_promises(rng):
    for spec in MIXED:
        choices = [value if isinstance(value, list) else [value] for value in spec.values()]
        for corner in itertools.product(*choices):
            extreme = dict(zip(spec, corner, strict=True))
            path = sample(make_reference(extreme, 20.0, rng), np.linspace(0.0, 20.0, 201))
            assert np.abs(path.speed * path.yaw_rate).max() <= 1.5 + 1e-9


def test_every_episode_draws_one_of_the_references_of_a_list_evenly():
    slow, back = {"kind": "straight", "speed": 1.0}, {"kind": "straight", "speed": -2.0}
    spec = {"kind": "mixed", "of": [slow, back, back, "random"]}
    drawn = [make_reference(spec, 5.0, np.random.default_rng(seed)) for seed in range(400)]
    first = np.array([profile.speed[0, 0] for profile in drawn])
    straight = np.array([not profile.yaw_rate.any() for profile in drawn])
    assert np.all(first[straight & (first < 0.0)] == -2.0)
    shares = [np.mean(straight & (first == 1.0)), np.mean(first == -2.0), np.mean(~straight)]
    assert np.abs(np.subtract(shares, [0.25, 0.5, 0.25])).max() < 3.3 * 0.5 / math.sqrt(400)


@pytest.mark.parametrize(
    ("of", "words"),
    [
        ([], "at least"), ("random", "list"), (["mixed"], "mixed"),
        ([{"kind": "plan", "goal": [1.0, 2.0]}], "plan"), (["random", "circel"], "circle"),
        (["random", {"kind": "circle", "radius": -5.0}], "radius"), (["random", 3], "3"),
    ],
)  # fmt: skip
def test_a_list_of_references_is_checked_whole_before_one_is_drawn(of, words):
    for seed in range(4):
        with pytest.raises(ValueError, match=words):
            make_reference({"kind": "mixed", "of": of}, 5.0, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("circel", ["'circel'", "unknown reference kind"]),
        (3, ["reference = 3", "a name or a dictionary"]),
        ({"kind": "circle", "raduis": 3.0}, ["'raduis'", "Did you mean 'radius'"]),
        ({"kind": "waypoints", "points": POINTS, "x": 1.0}, ["'x'", "'points', 'speed'"]),
        ({"kind": "circle", "radius": -3.0}, ["radius = -3.0 m", "[1, 10000] m", "direction"]),
        ({"kind": "circle", "speed": 7.2}, ["speed = 7.2 m/s", "[-5, 5]", "km/h"]),
        ({"kind": "circle", "speed": math.nan}, ["speed = nan m/s"]),
        ({"kind": "circle", "speed": True}, ["speed = True"]),
        ({"kind": "circle", "speed": "fast"}, ["speed = 'fast'"]),
        ({"kind": "circle", "speed": None}, ["speed = None"]),
        ({"kind": "circle", "speed": [0.5, math.nan]}, ["speed = nan m/s"]),
        ({"kind": "circle", "radius": 10**400}, ["radius = inf m"]),
        ({"kind": "circle", "x": 1j}, ["x = 1j"]),
        ({"kind": "circle", "yaw": [1.0]}, ["yaw = [1.0]"]),
        ({"kind": "circle", "speed": [2.0, 1.0]}, ["low must be <= high", "swapped"]),
        ({"kind": "circle", "speed": [1.0, 2.0, 3.0]}, ["[low, high]"]),
        ({"kind": "circle", "yaw": 180.0}, ["yaw = 180.0 rad", "degrees"]),
        ({"kind": "circle", "direction": 0.5}, ["direction = 0.5", "+1 (left), -1 (right)"]),
        ({"kind": "figure_eight", "speed": -1.0}, ["speed = -1.0 m/s", "reverse"]),
        ({"kind": "figure_eight", "speed": 5.0, "size": 5.0}, ["<= 5.0 rad/s", "lower the speed"]),
        ({"kind": "chicane", "turn_time": 2.2}, ["turn_time = 2.2 s", "multiple of 0.5 s"]),
        ({"kind": "chicane", "switch_time": 1.0}, ["switch_time = 1.0 s", "turn_time = 2.0 s"]),
        ({"kind": "random", "speed_range": [3.0, 1.0]}, ["speed_range", "low must be <= high"]),
        ({"kind": "waypoints"}, ["points missing"]),
        ({"kind": "waypoints", "points": [[0.0, 0.0]]}, ["(1, 2)", "2 <= M"]),
        ({"kind": "waypoints", "points": [[0, 1, 2], [0, 1, 2]]}, ["(2, 3)", "(2, M)"]),
        ({"kind": "waypoints", "points": [[0, 0], [math.nan, 1]]}, ["NaN"]),
        ({"kind": "waypoints", "points": [[0, 0], [0, 0], [1, 1]]}, ["0 and 1", "repeated"]),
        ({"kind": "waypoints", "points": [["0", "1"], ["2", "3"]]}, ["points", "numbers"]),
        ({"kind": "waypoints", "points": [[True, False], [False, True]]}, ["points", "numbers"]),
        (SHARP, ["misses way-point", "lower the speed"]),
    ],
)
def test_a_bad_specification_is_refused_with_quantity_value_range_and_cause(spec, words, rng):
    with pytest.raises(ValueError) as error:
        make_reference(spec, DURATION, rng)
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan, math.inf, 1e5])
def test_a_bad_duration_is_refused(duration, rng):
    with pytest.raises(ValueError, match=r"duration = .* s; must be a number in"):
        make_reference("circle", duration, rng)
