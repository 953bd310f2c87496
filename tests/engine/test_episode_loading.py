"""New episodes: drawn in kernels, or in Python one by one, with the same bits."""

import numpy as np
import pytest

from tests.driving import assert_equal
from tests.references.reference_cases import KINDS, POINTS
from tracked_env import SPEED, TERRAIN
from tracked_env.engine.env_config import EnvConfig
from tracked_env.engine.simulation import Simulation
from tracked_env.sensors import PRESETS
from tracked_env.uncertainty import known_laws

COUNT = 5
IDS = {"Torque-v0": {}, "Speed-v0": SPEED}
WAY = {"kind": "waypoints", "points": POINTS, "speed": [1.0, 2.0]}
REFERENCES = {
    **{kind: {"kind": kind} for kind in KINDS if kind != "waypoints"},
    "waypoints": WAY,
    "posed": {"kind": "random", "x": 3.0, "y": -1.0, "yaw": 0.7, "speed_range": 2.0},
    "drawn": {"kind": "random", "yaw_rate_limit": [0.2, 0.5]},
}
LATE = {"pose_delay": 0.1, "drive_rate": 10.0, "inertial_dropout": 0.2}
SENSORS = {**{name: name for name in PRESETS}, "late": LATE}
RANGES = {"mass": [1000.0, 2000.0], "cohesion": [1e3, 7e4], "inertia": [900.0, 900.0]}


def simulation(in_kernels, **config):
    """A simulation with one generator each, whose episodes are loaded in one way or the other."""
    made = Simulation(COUNT, EnvConfig(**config))
    assert made._loader._law is not None
    if not in_kernels:
        made._loader._law = made._loader._paths = None
    made.rngs = [np.random.default_rng(i) for i in range(COUNT)]
    return made


def assert_same_episodes(**config):
    """Both ways lead to the same arrays, streams and episodes, through resets of some rows."""
    ours, other = (simulation(way, **config) for way in (True, False))
    actions = np.full((COUNT, 2), 0.3, dtype=np.float32)
    for rows in ([0, 1, 2, 3, 4], [1, 3], [4], [3, 0, 1]):
        for one in (ours, other):
            one.reset(np.array(rows))
        assert_equal(tuple(ours.batch), tuple(other.batch))
        assert_equal(tuple(ours.running), tuple(other.running))
        assert_equal(list(ours.episodes), list(other.episodes))
        states = [[rng.bit_generator.state for rng in one.rngs] for one in (ours, other)]
        assert states[0] == states[1]
        for _ in range(70):  # over the end of a block of noise
            assert np.array_equal(ours.step(actions), other.step(actions))


# Of "any-vehicle" what stands alone here is the ground; the vehicle: tests/test_any_vehicle.py.
@pytest.mark.parametrize("name", [*sorted({*known_laws()} - {"any-vehicle"}), "ranges", "mixture"])
@pytest.mark.parametrize("env", IDS)
def test_every_uncertainty_set_is_drawn_in_a_batch_as_it_is_alone(env, name):
    spec = {"ranges": RANGES, "mixture": ["mixed", "payload", {"mass": [1e3, 2e3]}]}.get(name, name)
    if name == "ranges" and env == "Speed-v0":
        spec = {"mass": [50.0, 70.0]}
    assert_same_episodes(**{**IDS[env], "uncertainty": spec})


@pytest.mark.parametrize("name", REFERENCES)
def test_every_reference_is_drawn_in_a_batch_as_it_is_alone(name):
    assert_same_episodes(reference=REFERENCES[name], uncertainty="terrain-transition")


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("env", IDS)
def test_every_sensor_preset_is_drawn_in_a_batch_as_it_is_alone(env, name):
    assert_same_episodes(**{**IDS[env], "sensors": SENSORS[name]})


def test_a_plant_completes_the_start_in_a_batch_as_it_does_alone():
    ranges = {**RANGES, "icr_forward": [0.0, 0.1]}
    assert_same_episodes(lateral="constrained", uncertainty=ranges)


def test_the_order_of_the_rows_and_other_rows_do_not_matter():
    many, alone = simulation(True), simulation(True)
    many.reset(np.array([3, 0, 4]))
    for i in (0, 3, 4):
        alone.reset(np.array([i]))
    assert_equal(tuple(many.batch), tuple(alone.batch))
    assert [episode is None for episode in many.episodes] == [False, True, True, False, False]


def test_options_of_one_reset_are_gone_at_the_next_in_a_batch():
    ours = simulation(True)
    heavy = {"vehicle": {"mass": 1999.0}, "sensors": "ideal"}
    ours.reset(ours.all, [heavy] + [None] * (COUNT - 1))
    assert ours.episodes[0].parameters.mass == 1999.0 and not ours.running.noisy[0]
    ours.reset(ours.all)
    assert ours.episodes[0].parameters.mass != 1999.0 and ours.running.noisy[0]
    assert ours.truth()["mass"].tolist() == [episode.parameters.mass for episode in ours.episodes]


def test_episodes_keep_what_was_true_at_their_start_while_they_run():
    ours = simulation(True, uncertainty="mixed")
    ours.reset(ours.all)
    before = list(ours.episodes)
    for _ in range(100):
        ours.step(np.full((COUNT, 2), 0.4, dtype=np.float32))
    assert_equal(before, list(ours.episodes))
    assert_equal(before[1:3], ours.episodes[1:3])


def test_an_episode_is_one_object_until_the_next_one_begins():
    # Pictures and recordings tell by it that another episode has begun.
    ours = simulation(True, uncertainty="mixed")
    ours.reset(ours.all)
    before = ours.episodes[1]
    ours.step(np.full((COUNT, 2), 0.4, dtype=np.float32))
    assert ours.episodes[1] is before
    ours.reset(np.array([1]))
    assert ours.episodes[1] is not before


def test_a_drawn_reference_that_is_refused_loses_no_random_number_and_moves_no_vehicle():
    # Seldom would a belt have to run faster than 6 m/s:
    tight = {"kind": "figure_eight", "speed": [1.0, 3.2], "size": [5.0, 6.0]}
    ours = simulation(True, reference=tight)
    for _ in range(200):
        states = [rng.bit_generator.state for rng in ours.rngs]
        before = [array.copy() for array in (*ours.batch, *ours.running)]
        try:
            ours.reset(ours.all)
        except ValueError as error:
            assert str(error).startswith("vehicle ") and "a belt would have to run" in str(error)
            break
    else:
        pytest.fail("no reference was refused")
    assert states == [rng.bit_generator.state for rng in ours.rngs]
    assert_equal(before, [*ours.batch, *ours.running])


def test_options_that_say_nothing_leave_every_draw_as_it_is():
    configs = {"reference": "mixed"}, {"uncertainty": "mixed", "sensors": "rtk-outages"}
    for config in ({}, *configs, {**TERRAIN, "uncertainty": "soft-patches"}):
        plain, asked = simulation(True, **config), simulation(True, **config)
        plain.reset(plain.all)
        asked.reset(asked.all, [{"vehicle": {}, "start": None}] * COUNT)
        assert_equal(tuple(plain.batch), tuple(asked.batch))
        assert_equal(list(plain.episodes), list(asked.episodes))


def test_a_vehicle_without_a_stream_is_named():
    ours = simulation(True)
    ours.rngs[2] = None
    with pytest.raises(ValueError, match="vehicle 2 has no random stream"):
        ours.reset(np.array([0, 2]))
