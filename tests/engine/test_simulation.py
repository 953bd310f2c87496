"""The simulation core: sensors, schedules, streams, threads, golden trajectory."""

import json
import math

import numpy as np
import pytest

from tests.driving import STILL
from tracked_env import arrays as b
from tracked_env import observation as obs
from tracked_env.engine.env_config import EnvConfig
from tracked_env.engine.simulation import Simulation, Threads
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import HEAVY_CLAY, VEHICLES
from tracked_env.sensors import CHANNELS, PRESETS, Sensors, make_sensors
from tracked_env.uncertainty import SOILS, STRAWA_MAPS, known_laws

NOMINAL = VEHICLES["strawa"]
STRAIGHT = {"kind": "straight", "speed": 2.0}
ON_PATH = {**STILL, "speed": 2.0}
CRUISE = 0.16001  # action that balances mu_l m g on the nominal soil: 1280 N m per track


def simulate(count=1, options=None, **config):
    """A simulation of `count` vehicles, reset with one generator each."""
    config = {"reference": STRAIGHT, "uncertainty": "nominal", "sensors": "ideal", **config}
    simulation = Simulation(count, EnvConfig(**config))
    simulation.rngs = [np.random.default_rng(i) for i in range(count)]
    arguments = {"start": ON_PATH, **(options or {})}
    simulation.reset(simulation.all, [arguments] * count)
    return simulation


def drive(simulation, steps, action=(CRUISE, CRUISE)):
    """Observations (steps + 1, N, SIZE) in SI units, under a constant action."""
    actions = np.tile(np.float32(action), (simulation.count, 1))
    readings = [simulation.observations.copy()]
    for _ in range(steps):
        readings.append(simulation.step(actions).copy())
    return obs.unpack(np.array(readings))


def test_sensor_noise_and_bias_have_the_laws_of_the_preset():
    simulation = simulate(400, sensors="rtk")
    sums, squares, steps = 0.0, 0.0, 50
    actions = np.full((400, 2), CRUISE, np.float32)
    biases = []
    for _ in range(steps):
        simulation.step(actions)
        state = simulation.batch.floats[:, b.STATE : b.STATE + s.STATE_ROWS]
        delivered = simulation.batch.floats[:, b.SAMPLE : b.SAMPLE + len(CHANNELS)]
        truth = np.zeros_like(delivered)
        for c, name in enumerate(CHANNELS):
            if "torque" not in name:
                truth[:, c] = state[:, s.STATE_NAMES.index(name)]
            else:
                effort = state[:, s.STATE_NAMES.index(name.replace("torque", "effort"))]
                truth[:, c] = effort * NOMINAL.sprocket_radius
        error = delivered - truth
        bias = simulation.batch.floats[:, b.BIAS : b.BIAS + len(CHANNELS)]
        error -= bias
        sums, squares = sums + error.sum(axis=0), squares + (error**2).sum(axis=0)
        biases.append(bias.copy())
    count = 400 * steps
    sigma = simulation.batch.floats[0, b.SIGMA : b.SIGMA + len(CHANNELS)]
    coupling = 0.001 * 0.02  # cross-coupling of accelerations below 0.02 m/s^2 while cruising
    assert np.all(np.abs(sums / count) < 4.0 * sigma / math.sqrt(count) + coupling)
    assert np.sqrt(squares / count) == pytest.approx(sigma, rel=0.02)
    rtk = PRESETS["rtk"]
    expected = math.sqrt(2.0) * rtk.acceleration_noise / rtk.accelerometer_distance
    assert sigma[CHANNELS.index("yaw_acceleration")] == pytest.approx(expected)
    gyro = biases[0][:, CHANNELS.index("yaw_rate")]
    assert set(np.abs(gyro)) == {rtk.gyro_bias} and abs(gyro.mean()) < 0.2 * rtk.gyro_bias
    assert all(np.array_equal(biases[0], later) for later in biases)


def test_noise_does_not_repeat_across_blocks_steps_vehicles_or_episodes():
    simulation = simulate(3, sensors="rtk")
    first = drive(simulation, 200)["v_x"]
    assert np.unique(first).size > 0.99 * first.size
    simulation.reset(simulation.all, [{"start": ON_PATH}] * 3)
    second = drive(simulation, 10)["v_x"]
    assert not np.isin(second, first).any()


def test_a_delayed_group_shows_what_was_measured_that_long_ago():
    now = drive(simulate(), 40, action=(0.3, 0.3))
    late = drive(simulate(options={"sensors": {"pose_delay": 0.1}}), 40, action=(0.3, 0.3))
    assert np.array_equal(late["v_x"][10:], now["v_x"][5:-5])
    assert np.array_equal(late["yaw_rate"], now["yaw_rate"])
    assert late["pose_age"][3:12, 0] == pytest.approx([0.06, 0.08] + [0.1] * 7, abs=1e-6)
    assert np.all(late["drive_age"] == 0.0)


def test_a_slow_group_holds_its_last_sample():
    slow = drive(simulate(options={"sensors": {"drive_rate": 10.0}}), 23, action=(0.3, 0.3))
    speed = slow["sprocket_speed_left"][:, 0]
    assert np.unique(speed).size == 5
    assert slow["drive_age"][:6, 0] == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08, 0.0], abs=1e-6)
    assert np.unique(slow["v_x"]).size == 24


def test_dropouts_come_with_their_probability_and_are_seen_as_age():
    simulation = simulate(200, options={"sensors": {"pose_dropout": 0.3}})
    age = drive(simulation, 100)["pose_age"][1:]
    assert (age > 0.0).mean() == pytest.approx(0.3, abs=0.01)
    assert np.all(drive(simulate(50), 50)["pose_age"] == 0.0)


def test_delay_of_one_vehicle_leaves_the_others_alone():
    pair = Simulation(2, EnvConfig(reference=STRAIGHT, sensors="rtk"))
    pair.rngs = [np.random.default_rng(i) for i in range(2)]
    late = {"sensors": {"pose_delay": 0.2, "drive_delay": 0.04}}
    pair.reset(pair.all, [None, late])
    alone = Simulation(1, EnvConfig(reference=STRAIGHT, sensors="rtk"))
    alone.rngs = [np.random.default_rng(0)]
    alone.reset(alone.all, [None])
    for _ in range(30):
        both = pair.step(np.full((2, 2), 0.2, np.float32))
        assert np.array_equal(both[0], alone.step(np.full((1, 2), 0.2, np.float32))[0])


def test_the_observation_of_ideal_sensors_is_the_state():
    simulation = simulate(options={"start": {**ON_PATH, "offset_y": 0.3, "yaw_rate": 0.2}})
    readings = drive(simulation, 30, action=(0.2, 0.5))
    truth = simulation.truth()
    for name in ("v_x", "v_y", "yaw_rate", "acceleration_x", "sprocket_speed_right"):
        assert readings[name][-1, 0] == pytest.approx(truth[name][0], rel=1e-6)
    assert readings["torque_right"][-1, 0] == pytest.approx(
        truth["effort_right"][0] * 0.3, rel=1e-6
    )
    assert readings["previous_action_right"][-1, 0] == pytest.approx(0.5)


def test_accelerations_are_the_derivatives_of_the_velocities():
    simulation = simulate(control_rate=1000.0, options={"start": {**ON_PATH, "yaw_rate": 0.3}})
    readings = drive(simulation, 400, action=(0.1, 0.5))
    dt = 0.001
    rate_x = np.gradient(readings["v_x"][:, 0], dt)[300:-1]
    rate_y = np.gradient(readings["v_y"][:, 0], dt)[300:-1]
    yaw_rate = readings["yaw_rate"][300:-1, 0]
    inertial_x = rate_x - yaw_rate * readings["v_y"][300:-1, 0]
    inertial_y = rate_y + yaw_rate * readings["v_x"][300:-1, 0]
    assert readings["acceleration_x"][300:-1, 0] == pytest.approx(inertial_x, abs=5e-3)
    assert readings["acceleration_y"][300:-1, 0] == pytest.approx(inertial_y, abs=5e-3)


def test_a_payload_step_acts_inside_the_episode_and_is_seen_in_the_truth():
    step = {"parameter": "mass", "kind": "ramp", "target": 2900.0, "start": 0.5}
    loaded = simulate(options={"schedule": [step]})
    empty = simulate()
    masses, same, different = [], 0, 0
    for k in range(50):
        action = np.full((1, 2), 0.3, np.float32)
        one, other = loaded.step(action), empty.step(action)
        masses.append(loaded.truth()["mass"][0])
        column = obs.INDEX["v_x"]
        same += int(k < 25 and one[0, column] == other[0, column])
        different += int(k >= 26 and one[0, column] < other[0, column])
    assert masses[:25] == [1450.0] * 25 and masses[26:] == [2900.0] * 24
    assert same == 25 and different == 24
    # Twice the mass at the same effort: dv/dt = F/m - mu_l g, here after the step.
    effort = 2.0 * 0.3 * NOMINAL.torque_limit / NOMINAL.sprocket_radius
    expected = effort / 2900.0 - 0.6 * 9.81
    assert loaded.truth()["acceleration_x"][0] == pytest.approx(expected, rel=1e-3)


def test_ramps_are_linear_and_regions_and_lines_act_where_they_lie():
    schedule = [
        {"parameter": "inertia", "kind": "ramp", "target": 2180.0, "start": 0.2, "duration": 1.0},
        {"parameter": "cohesion", "kind": "region", "target": 1e3,
         "x": 2.0, "y": 0.0, "radius": 0.5},
        {"parameter": "lateral_resistance", "kind": "line", "target": 0.4, "x": 1.0, "y": 0.0,
         "direction": 0.0, "edge": 0.2},
    ]  # fmt: skip
    simulation = simulate(options={"schedule": schedule}, error_limit=1e3)
    log = []
    for _ in range(80):
        x = simulation.truth()["x"][0]  # parameters are those of the start of a step
        simulation.step(np.full((1, 2), CRUISE, np.float32))
        truth = simulation.truth()
        log.append((x, truth["inertia"][0], truth["cohesion"][0], truth["lateral_resistance"][0]))
    x, inertia, cohesion, lateral = np.array(log).T
    time = 0.02 * np.arange(80)
    assert inertia == pytest.approx(1180.0 + 1000.0 * np.clip(time - 0.2, 0.0, 1.0))
    assert np.all(cohesion[np.abs(x - 2.0) < 0.25] == 1e3)
    assert np.all(cohesion[np.abs(x - 2.0) > 0.75] == HEAVY_CLAY.cohesion)
    assert np.all(lateral[x < 0.9] == 0.8) and np.all(lateral[x > 1.1] == pytest.approx(0.4))


def test_resistance_maps_are_equations_44_and_45():
    simulation = simulate(
        uncertainty="resistance-map",
        error_limit=1e3,
        options={"reference": {"kind": "circle", "radius": 10.0, "speed": 2.0}},
    )
    for _ in range(150):
        x, y = (simulation.truth()[name][0] for name in ("x", "y"))
        simulation.step(np.float32([[0.1, 0.4]]))
        truth = simulation.truth()
        expected = 0.7 + 0.02 * x * math.cos(0.3 * y)
        assert truth["longitudinal_resistance"][0] == pytest.approx(expected)
        expected = 0.6 + 0.03 * x * math.sin(0.2 * x) * math.exp(-0.01 * y)
        assert truth["lateral_resistance"][0] == pytest.approx(expected, abs=1e-12)
    assert len(STRAWA_MAPS) == 2


LOAD, GRIP, RESISTANCE = (
    {"mass", "inertia"},
    {"friction_angle"},
    {"longitudinal_resistance", "lateral_resistance"},
)
GAINS = {"actuator_gain_left", "actuator_gain_right"}
SOIL = GRIP | {"cohesion", "shear_deformation_modulus"}
CHANGED = {
    **dict.fromkeys(("payload", "slope-payload", "slope-boxes"), LOAD),
    **dict.fromkeys(("friction-step", "slope-step", "alternating-floors"), GRIP),
    **dict.fromkeys(("changing-floors", "changing-slope", "changing-hills"), GRIP),
    **dict.fromkeys(("actuator-fault", "alternating-gains"), GAINS),
    "friction-drift": GRIP | {"shear_deformation_modulus", "longitudinal_resistance"},
    "resistance-map": RESISTANCE,
    "drift": LOAD | RESISTANCE,
    "floor-mixed": LOAD | GRIP,
    "alternating-soils": SOIL,
    "alternating-loads": LOAD,
    "alternating-resistances": RESISTANCE,
    "flickering-drive": GAINS,
    "alternating-all": GAINS | RESISTANCE,
    **dict.fromkeys(("any-soil", "any-vehicle"), LOAD | GAINS | SOIL | RESISTANCE),
}


@pytest.mark.parametrize("name", known_laws())
def test_every_uncertainty_set_draws_physical_values_and_changes_what_it_promises(name):
    simulation = Simulation(64, EnvConfig(uncertainty=name, error_limit=1e6, sensors="ideal"))
    simulation.rngs = [np.random.default_rng(i) for i in range(64)]
    simulation.reset(simulation.all, [None] * 64)
    start = simulation.truth()
    # until soils that alternate every 2 s are the other ones, and the drive has failed
    for _ in range(1324 if name == "flickering-drive" else 1399):
        simulation.step(np.full((64, 2), 0.2, np.float32))
    end = simulation.truth()
    changed = {key for key in NOMINAL._fields if not np.array_equal(start[key], end[key])}
    if name in CHANGED:
        assert changed == CHANGED[name]
    elif name in ("terrain-transition", "mixed"):
        assert changed >= RESISTANCE
    else:
        assert changed == set()
    varied = {key for key in NOMINAL._fields if np.unique(start[key]).size > 1}
    assert varied == set() if name in ("nominal", "payload", "drift") else True
    assert np.isfinite(simulation.batch.floats[:, : b.STATE + s.STATE_ROWS]).all()


def test_sets_that_are_held_out_do_not_overlap_the_training_ranges():
    draws = {}
    for name in ("soil-and-mass", "ood"):
        law = known_laws()[name]
        rng = np.random.default_rng(0)
        draws[name] = np.array([law(rng, NOMINAL, None, 30.0).parameters.mass for _ in range(300)])
    inside, outside = draws["soil-and-mass"], draws["ood"]
    assert not np.any((outside > inside.min()) & (outside < inside.max()))


def test_weak_soil_is_limited_by_traction_and_spins_without_a_nan():
    simulation = simulate(
        32, uncertainty="weak-soil", error_limit=1e6, options={"start": {"speed": 0.2}}
    )
    readings = drive(simulation, 10, action=(0.3, 1.0))
    truth = simulation.truth()
    assert np.all(truth["slip_right"] > 0.5)
    # The belt runs at its top speed, and the drive still pushes no harder than the soil holds.
    limit = simulation.column("effort_limit")
    assert np.all(np.abs(truth["effort_right"]) <= limit * (1.0 + 1e-12))
    assert np.all(np.abs(readings["sprocket_speed_right"]) <= NOMINAL.sprocket_speed_limit + 1e-3)


def test_what_the_policy_does_changes_neither_vehicle_nor_noise_nor_the_next_episode():
    runs = []
    for action, steps in ((0.1, 130), (0.25, 70)):
        simulation = Simulation(2, EnvConfig(uncertainty="mixed"))
        simulation.rngs = [np.random.default_rng(i) for i in range(2)]
        simulation.reset(simulation.all, [None] * 2)
        noise = simulation.batch.noise.copy()
        for _ in range(steps):
            simulation.step(np.full((2, 2), action, np.float32))
        simulation.reset(simulation.all, [None] * 2)
        runs.append((noise, simulation.batch.noise.copy(), simulation.batch.floats.copy()))
    for one, other in zip(*runs, strict=True):
        assert np.array_equal(one, other)


def test_soil_presets_stay_in_range_and_sensor_presets_are_those_of_the_paper():
    assert SOILS["sandy_loam"].cohesion == 9650.0
    strawa = PRESETS["strawa"]
    assert strawa.position_noise == 1.0 and strawa.yaw_noise == pytest.approx(math.radians(1.0))
    assert (strawa.velocity_noise, strawa.gyro_bias) == (0.1, 0.01)
    assert (strawa.acceleration_bias, strawa.cross_coupling) == (0.002, 0.001)
    assert strawa.sprocket_speed_noise**2 == pytest.approx(0.01)
    assert make_sensors({"preset": "ideal", "gyro_bias": 0.5}) == Sensors(gyro_bias=0.5)


def golden_run():
    """State after 3 s of a fixed drive over a schedule, both lateral models."""
    schedule = [
        {"parameter": "mass", "kind": "ramp", "target": 1900.0, "start": 0.7, "duration": 0.5},
        {"parameter": "lateral_resistance", "kind": "line", "target": 0.5, "x": 3.0, "y": 0.0,
         "direction": 0.0},
    ]  # fmt: skip
    table = {}
    for lateral in ("sliding", "constrained"):
        simulation = simulate(lateral=lateral, error_limit=1e3, options={"schedule": schedule})
        rows = []
        for k in range(150):
            turn = 0.25 * math.sin(0.05 * k)
            simulation.step(np.float32([[0.3 - turn, 0.3 + turn]]))
            if k % 30 == 29:
                state = simulation.batch.state()[0]
                assert not state[s.Z :].any()  # planar
                rows.append(state[: s.Z].tolist())
        table[lateral] = rows
    return table


def test_the_golden_trajectory_has_not_changed(repository):
    # A change here needs a table in CHANGELOG.md that says what changed and why. To renew:
    # python -c "from tests.engine.test_simulation import golden_run; ..." into the file below.
    golden = json.loads((repository / "tests/golden_torque_v0.json").read_text())
    for lateral, rows in golden_run().items():
        assert np.array(rows) == pytest.approx(np.array(golden[lateral]), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("lateral", ["sliding", "constrained"])
def test_vehicles_that_are_moved_together_in_any_number_have_the_bits_of_one_alone(lateral):
    config = EnvConfig(uncertainty="weak-soil", lateral=lateral, error_limit=1e6)
    rows = np.arange(66)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 66, 2)).astype(np.float32)
    runs = []
    for size in (1, 2, 3, 7, 8, 9, 31, 63, 64, 65, 66):
        simulation = Simulation(66, config)
        simulation.rngs = [np.random.default_rng(i) for i in rows]
        simulation.reset(rows)
        for action in actions:
            for first in range(0, 66, size):
                simulation.step(action, rows[first : first + size])
        runs.append(simulation.batch.floats)
    for floats in runs[1:]:
        assert np.array_equal(runs[0], floats)


@pytest.mark.parametrize(("size", "lanes"), [(1, 1), (2, 1), (9, 1), (64, 64), (65, 64), (600, 64)])
@pytest.mark.parametrize("count", [2, 3])
def test_shares_hold_every_row_once_and_begin_at_a_block(size, lanes, count):
    threads, shares = Threads(count), []

    def note(first, last):
        shares.append((first, last))
        return last - first

    assert sum(threads.run(note, size, lanes)) == size
    rows = [row for first, last in shares for row in range(first, last)]
    assert sorted(rows) == list(range(size))
    assert all(first % lanes == 0 for first, _ in shares)
    assert len(shares) == min(count, -(-size // lanes))
    threads.close()
