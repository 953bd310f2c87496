"""Kinds of references that users register: drawn, scaled and refused as those of the catalogue."""

import inspect
import math

import gymnasium
import numpy as np
import pytest

from baselines.registry import POLICIES
from tests.driving import assert_equal
from tracked_env import TORQUE_ID, references
from tracked_env.benchmark import BenchmarkConfig, Store, load_policy, run
from tracked_env.physics.parameters import VEHICLES, top_speed
from tracked_env.references import (
    ReferenceProfile,
    constant,
    fit,
    knot_times,
    make_reference,
    number_of_segments,
    sample,
    specification,
)

DURATION = 10.0
RANGES = {"cruise": (0.1, 4.0, "m/s"), "swing": (0.0, 1.0, "rad/s"), "period": (2.0, 60.0, "s")}


def slalom(duration, cruise=2.0, swing=0.3, period=8.0, direction=1.0):
    """Turns to the left and to the right by turns, at constant speed."""
    times, omega = knot_times(number_of_segments(duration)), 2.0 * math.pi / period
    phase, w = omega * times, direction * swing
    rates = fit(w * np.sin(phase), w * omega * np.cos(phase), -w * omega**2 * np.sin(phase))
    return ReferenceProfile(constant(cruise, len(rates)), rates)


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """The kind "slalom", and none beside it; afterwards as before."""
    monkeypatch.setattr(specification, "_REGISTERED", {})
    monkeypatch.setattr(specification, "_ARGUMENTS", dict(specification._ARGUMENTS))
    references.register("slalom", slalom, RANGES)
    return specification._REGISTERED


def test_a_registered_kind_is_the_function_with_its_parameters():
    rng = np.random.default_rng(0)
    plain = make_reference("slalom", DURATION, rng)
    assert_equal(plain.table, slalom(DURATION).table)
    one = {"kind": "slalom", "cruise": 1.5, "x": 3.0, "yaw": 1.0}
    placed = make_reference(one, DURATION, rng)
    assert_equal(placed.table, slalom(DURATION, cruise=1.5).table)
    at = sample(placed, [0.0, 4.0, 8.0])
    assert (placed.x, at.x[0], at.yaw[0]) == (3.0, 3.0, 1.0)
    assert at.yaw_rate[1] == pytest.approx(0.0, abs=1e-9)
    assert at.yaw[2] == pytest.approx(1.0, abs=1e-4)  # one period


def test_ranges_are_drawn_whatever_the_order_of_the_keys():
    spec = {"kind": "slalom", "cruise": [1.0, 2.0], "period": [4.0, 9.0], "direction": [-1, 1]}
    tables = []
    for each in (spec, dict(reversed(spec.items()))):
        tables.append(make_reference(each, DURATION, np.random.default_rng(5)).table)
    assert_equal(*tables)
    speeds = [make_reference(spec, 1.0, np.random.default_rng(k)).speed[0, 0] for k in range(99)]
    assert 1.0 <= min(speeds) < 1.1 and 1.9 < max(speeds) <= 2.0


def wavy(duration, cruise=0.4, swing=0.2, spacing=6.0):
    """The same with a distance between turns."""
    return slalom(duration, cruise, swing, spacing / cruise)


@pytest.mark.parametrize("written_for", ["strawa", "focchi", None])
def test_defaults_are_in_proportion_to_top_speed_and_length_of_the_vehicle(written_for):
    references.register("wavy", wavy, {**RANGES, "spacing": (0.1, 99.0, "m")}, vehicle=written_for)
    focchi, rng = VEHICLES["focchi"], np.random.default_rng(0)
    own = VEHICLES[written_for or "focchi"]
    ratio = top_speed(focchi) / top_speed(own)
    turning = min(ratio * own.track_gauge / focchi.track_gauge, 1.0)
    longer = focchi.contact_length / own.contact_length
    expected = wavy(DURATION, 0.4 * ratio, 0.2 * turning, 6.0 * longer).table
    profile = make_reference("wavy", DURATION, rng, focchi)
    np.testing.assert_allclose(profile.table, expected, rtol=1e-9, atol=1e-12)
    share = top_speed(focchi) / top_speed(VEHICLES["strawa"])
    for more, speed in (({}, 0.3), ({"vehicle": "strawa"}, 0.3 * share)):
        profile = make_reference({"kind": "wavy", "cruise": 0.3, **more}, DURATION, rng, focchi)
        assert profile.speed[0, 0] == pytest.approx(speed, rel=1e-12)


def test_options_of_a_reset_and_the_benchmark_take_it(tmp_path):
    env = gymnasium.make(TORQUE_ID, duration=2.0)
    options = {"reference": {"kind": "slalom", "cruise": 1.25}}
    env.reset(seed=0, options=options)
    assert env.unwrapped.simulation.column("reference_speed")[0] == 1.25
    config = BenchmarkConfig(sets=("payload",), episodes=2, duration=1.0, reference="slalom")
    records = run(config, [load_policy("nominal", POLICIES)], Store(tmp_path, config.identity()))
    assert len(records) == 2


def random_circle(duration, rng, vehicle, radius):
    n = number_of_segments(duration)
    speed = rng.uniform(0.5, 1.0) * top_speed(vehicle)
    return ReferenceProfile(constant(speed, n), constant(speed / radius, n))


def test_a_function_may_draw_and_read_the_vehicle_and_ask_for_a_parameter():
    references.register("round", random_circle)
    spec, vehicle = {"kind": "round", "radius": 5.0}, VEHICLES["focchi"]
    speeds = [
        make_reference(spec, DURATION, np.random.default_rng(k), vehicle).speed[0, 0]
        for k in (1, 1, 2)
    ]
    assert speeds[0] == speeds[1] != speeds[2] and max(speeds) <= top_speed(vehicle)
    with pytest.raises(ValueError, match="'round': radius missing; must be in"):
        make_reference("round", DURATION, np.random.default_rng(0), vehicle)
    references.register("wide", random_circle, {"radius": (6.0, 9.0, "m")})
    with pytest.raises(ValueError, match=r"radius = 5.0 m; must be a number in \[6, 9\] m"):
        make_reference({"kind": "wide", "radius": 5.0}, DURATION, np.random.default_rng(0), vehicle)


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("slalon", "Did you mean 'slalom'"),
        ({"kind": "slalom", "cruse": 1.0}, "Did you mean 'cruise'"),
        (
            {"kind": "slalom", "cruise": 9.0},
            r"cruise = 9.0 m/s; must be a number in \[0.1, 4\] m/s",
        ),
        ({"kind": "slalom", "swing": "1"}, "swing = '1'"),
        ({"kind": "slalom", "swing": [0.4, 0.1]}, "low must be <= high"),
        ({"kind": "slalom", "direction": 2}, "direction = 2"),
    ],
)
def test_a_wrong_specification_is_refused_as_those_of_the_catalogue(spec, says):
    with pytest.raises(ValueError, match=says):
        gymnasium.make(TORQUE_ID, reference=spec)


def short(duration):
    return ReferenceProfile(constant(1.0, 3), constant(0.0, 3))


def with_name(duration, name=1.0):
    return slalom(duration)


def with_start(duration, x=1.0):
    return slalom(duration)


def with_range(duration, radius=(5.0, 9.0)):
    return slalom(duration)


def without_duration(speed=1.0):
    return slalom(1.0)


@pytest.mark.parametrize(
    ("kind", "build", "more", "says"),
    [
        ("slalom", slalom, {"ranges": RANGES}, "none of.*'slalom'"),
        ("circle", slalom, {"ranges": RANGES}, "none of.*'circle'"),
        ("plan", slalom, {"ranges": RANGES}, "none of"),
        (3, slalom, {"ranges": RANGES}, "reference kind = 3; must be text"),
        ("new", slalom, {}, "parameter 'cruise' of reference kind 'new'; must have a range"),
        ("new", with_start, {}, "parameter 'x'.*be none of"),
        ("new", with_name, {"ranges": {"name": (2.0, 3.0, "m")}}, "name = 1.0 m; must be"),
        ("new", with_name, {"ranges": {"name": (3.0, 2.0, "m")}}, "range of name = .*low <= high"),
        ("new", with_name, {"ranges": {"name": 2.0}}, "range of name = 2.0; must be"),
        ("new", slalom, {"ranges": RANGES, "vehicle": "tank"}, "unknown vehicle 'tank'"),
        ("new", with_range, {}, r"radius = \(5.0, 9.0\) is a default of 'new'; must be one number"),
        ("new", without_duration, {}, "must have the argument `duration`"),
        ("new", "slalom", {}, "must be a function of duration"),
    ],
)
def test_a_wrong_registration_is_refused_and_leaves_no_kind(kind, build, more, says, registered):
    with pytest.raises(ValueError, match=says):
        references.register(kind, build, **more)
    assert [*registered] == ["slalom"] and kind not in {*specification._ARGUMENTS} - {
        "slalom",
        *references.REFERENCES,
    }


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (short, r"tables of shape \[\(3, 6\), \(3, 6\)\]; must be a ReferenceProfile .*\(21, 6\)"),
        (lambda duration: None, r"shape \[\]; must be a ReferenceProfile"),
        (lambda duration: slalom(duration, cruise=np.nan), "two finite ones"),
        (lambda duration: slalom(duration, swing=9.0), "a belt would have to run at 9.65 m/s"),
    ],
)
def test_what_is_no_reference_is_refused_when_the_environment_is_made(build, says):
    references.register("new", build)
    with pytest.raises(ValueError, match=says):
        gymnasium.make(TORQUE_ID, reference="new", duration=DURATION)


def test_signatures_of_the_catalogue_are_those_of_its_functions():
    for kind, build in references.REFERENCES.items():
        known = inspect.signature(build).parameters
        assert {*known} - {*specification._CONTEXT} <= {*specification._defaults(kind)}
