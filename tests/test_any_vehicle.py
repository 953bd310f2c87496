"""Vehicles of any size, drawn for each episode: that they move, turn and follow, and are the same
in a batch as alone; the data sheet; and fleets of the benchmark.
"""

import math

import gymnasium
import numpy as np
import pytest

import tracked_env
from baselines.registry import POLICIES
from tests.driving import assert_equal
from tracked_env import arrays as b
from tracked_env import observation as obs
from tracked_env.benchmark import tuning, video
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import SETS, TOLD, VEHICLE_SETS, names_of
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.runner import Task, run_task
from tracked_env.benchmark.statistics import interquartile_mean
from tracked_env.physics.parameters import PARAMETER_NAMES, VEHICLES, PlantParameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.references import batch_reference
from tracked_env.uncertainty import known_laws, make_uncertainty
from tracked_env.uncertainty.any_vehicle import any_vehicle
from tracked_env.vector_env import TrackedVehicleVectorEnv
from tracked_env.vehicles.abilities import contradictions

STRAWA = VEHICLES["strawa"]
IDS = {
    tracked_env.TORQUE_ID: {},
    tracked_env.SPEED_ID: tracked_env.SPEED,
    tracked_env.TERRAIN_ID: tracked_env.TERRAIN,
}
DRAWN = 10_000
TIMES = np.arange(0.0, 30.0, 0.25)


def drawn(count, seed=0, **arguments):
    env = TrackedVehicleVectorEnv(
        count, **{"uncertainty": "any-vehicle", "autoreset_mode": "Disabled", **arguments}
    )
    env.reset(seed=seed)
    return env


def parameters(rows):
    """Records or rows as parameters of arrays."""
    table = np.array([tuple(row) for row in rows.tolist()])
    return PlantParameters(*table.T)


def strength(p):
    """Effort [N] that the ground carries under one track at full slip, S (2) and (7) at i = 1."""
    load = 0.5 * p.mass * GRAVITY
    most = p.cohesion * p.track_width * p.contact_length + load * np.tan(p.friction_angle)
    u = p.contact_length / p.shear_deformation_modulus
    return most * (1.0 - (1.0 - np.exp(-u)) / u)


def static_effort(p):
    """Effort [N] of a track for a turn on the spot, by the moment of uniform lateral friction."""
    moment = p.turning_resistance_factor * p.lateral_resistance * p.mass * GRAVITY
    return 0.25 * moment * p.contact_length / p.track_gauge + (
        0.5 * p.longitudinal_resistance * p.mass * GRAVITY
    )


@pytest.fixture(scope="module")
def fleet():
    """DRAWN episodes: nominal vehicles, truth before and after the change, references."""
    env = drawn(DRAWN, sensors="ideal")
    simulation = env.simulation
    before = simulation.batch.base().copy()
    after, counts = before.copy(), simulation.batch.counters[:, b.EVENT_COUNT]
    for number in range(5):  # a change of one kind has at most five rows, see `_any_soil`
        has = counts > number
        rows = simulation.batch.events[has, number]
        after[np.flatnonzero(has), rows[:, 1].astype(int)] = rows[:, 2]
    nominal = parameters(simulation.running.nominals)
    table = simulation.batch.profile.copy()
    env.close()
    return nominal, parameters(before), parameters(after), table


def test_each_of_ten_thousand_vehicles_is_sound_and_the_sizes_cover_the_family(fleet):
    nominal = fleet[0]
    assert 0.5 <= nominal.contact_length.min() < 0.51
    assert 5.9 < nominal.contact_length.max() <= 6.0
    share = np.log(nominal.contact_length / 0.5) / math.log(12.0)
    np.testing.assert_allclose(np.quantile(share, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.02)
    assert nominal.mass.min() < 50.0 and nominal.mass.max() == 6e4
    for i in range(0, DRAWN, 10):
        assert contradictions(PlantParameters(*(float(values[i]) for values in nominal))) == []


def test_each_can_turn_on_the_spot_while_it_accelerates_before_and_after_its_change(fleet):
    for p in fleet[1:3]:
        gain = np.minimum(p.actuator_gain_left, p.actuator_gain_right)
        available = np.minimum(gain * p.torque_limit / p.sprocket_radius, strength(p))
        needed = static_effort(p) + 0.1 * p.mass * GRAVITY
        assert (1.15 * needed / available).max() <= 1.0 + 1e-9
        assert p.longitudinal_resistance.min() > 0.0 and p.lateral_resistance.min() > 0.05


def test_each_has_the_efforts_and_belts_that_its_reference_takes(fleet):
    """Inverse dynamics on the reference, with the ground's whole moment against the turn."""
    nominal, before, after, table = fleet
    paths = [sample_row(table[:, i]) for i in range(DRAWN)]
    v, dv, w, dw = (np.array(each) for each in zip(*paths, strict=True))
    p = PlantParameters(*(values[:, None] for values in nominal))
    accelerating = 0.5 * np.abs(dv) + p.inertia / p.mass * np.abs(dw) / p.track_gauge
    assert 0.07 < accelerating.max() / GRAVITY <= 0.1 + 1e-9
    for p in (before, after):
        p = PlantParameters(*(values[:, None] for values in p))
        gain = np.minimum(p.actuator_gain_left, p.actuator_gain_right)
        half = 0.5 * p.track_gauge
        belts = np.abs(v) + half * np.abs(w)
        assert (belts / (p.sprocket_radius * p.sprocket_speed_limit)).max() < 0.9
        along = 0.5 * p.mass * np.abs(dv)
        turning = p.inertia * np.abs(dw) / p.track_gauge
        available = np.minimum(gain * p.torque_limit / p.sprocket_radius, strength(p))
        assert ((static_effort(p) + along + turning) / available).max() < 1.0
        # what slides sideways in the curve stays under the track
        assert (np.abs(v * w) / (p.lateral_resistance * GRAVITY)).max() < 1.0


def sample_row(table):
    """v, dv/dt, w, dw/dt of one reference at TIMES, by numpy's polynomials."""
    segment, time = np.divmod(TIMES, 0.5)
    rows, powers = table[segment.astype(int)], time[:, None] ** np.arange(6)
    slopes = np.arange(1, 6) * time[:, None] ** np.arange(5)
    return [
        (rows[:, first : first + powers.shape[1]] * powers).sum(axis=1)
        if not derived
        else (rows[:, first + 1 : first + 6] * slopes).sum(axis=1)
        for first in (0, 6)
        for derived in (False, True)
    ]


@pytest.mark.parametrize("name", IDS)
def test_an_episode_is_the_same_alone_as_in_a_batch_whatever_its_row(name):
    many = gymnasium.make_vec(
        name, 5, uncertainty="any-vehicle", vectorization_mode="vector_entry_point",
        autoreset_mode="Disabled",
    )  # fmt: skip
    shown, _ = many.reset(seed=[7, 8, 9, 10, 11])
    alone = gymnasium.make(name, uncertainty="any-vehicle")
    first, _ = alone.reset(seed=10)
    assert np.array_equal(shown[3], first)
    action = np.array([0.3, 0.4], np.float32)
    for _ in range(25):
        shown, rewards, *_ = many.step(np.tile(action, (5, 1)))
        one, reward, *_ = alone.step(action)
        assert np.array_equal(shown[3], one) and rewards[3] == reward
    ours, theirs = many.unwrapped.simulation, alone.unwrapped.simulation
    assert_equal(ours.batch.floats[3], theirs.batch.floats[0])
    assert ours.nominal(3) == theirs.nominal(0) != ours.nominal(2)
    alone.reset(seed=10, options={"vehicle": {"mass": 500.0}})  # drawn in Python
    assert theirs.nominal(0) == ours.nominal(3)


@pytest.mark.parametrize("reference", ["circle", "mixed", tracked_env.SPEED["reference"]])
def test_references_suit_the_vehicle_that_is_drawn(reference):
    env = drawn(40, reference=reference)
    speeds = {}
    for i, episode in enumerate(env.simulation.episodes):
        p = env.simulation.nominal(i)
        belts = np.abs(episode.profile.speed[:, 0])
        belts = belts + 0.5 * p.track_gauge * np.abs(episode.profile.yaw_rate[:, 0])
        speeds[p.sprocket_radius * p.sprocket_speed_limit] = float(belts.max())
    assert all(fastest <= top for top, fastest in speeds.items())
    slow, fast = min(speeds), max(speeds)
    assert speeds[fast] > 2.0 * speeds[slow]


@pytest.mark.parametrize(
    "reference", ["random", tracked_env.SPEED["reference"], {"speed_range": [0.5, 4.0]}]
)
def test_the_batch_scales_random_paths_as_an_environment_of_that_vehicle_does(reference):
    env = drawn(50, reference=reference)
    for i in range(50):
        p = env.simulation.nominal(i)
        own = {**({} if isinstance(reference, str) else {"vehicle": "strawa", **reference})}
        expected = batch_reference({"kind": "random", **own}, p)
        assert np.array_equal(env.simulation._loader._paths.limits[i], expected[0].limits[0])


def test_start_error_limit_and_torque_noise_are_in_proportion_to_the_vehicle():
    env = drawn(400, sensors={"preset": "rtk", "torque_noise": 10.0})
    simulation = env.simulation
    length, torque = simulation.column("contact_length"), simulation.column("torque_limit")
    np.testing.assert_allclose(simulation.column("error_limit"), 5.0 * length / 2.0, rtol=1e-14)
    noise = simulation.batch.floats[:, b.SIGMA + 11 : b.SIGMA + 13]
    np.testing.assert_allclose(noise, 10.0 * torque[:, None] / 8000.0 * [1.0, 1.0], rtol=1e-14)
    offsets = np.array([[e.state.x, e.state.y] for e in simulation.episodes]) / length[:, None]
    assert 0.14 < np.abs(offsets).max() <= 0.15


def test_a_failing_reset_leaves_vehicle_reference_and_generator_as_they_were():
    env = gymnasium.make("tracked_env/Torque-v0", uncertainty="any-vehicle")
    env.reset(seed=3)
    simulation = env.unwrapped.simulation
    before = simulation.nominal(0)
    with pytest.raises(ValueError, match="unknown"):
        env.reset(options={"reference": "cirle"})
    assert simulation.nominal(0) == before
    other, _ = env.reset()
    env.reset(seed=3)
    assert np.array_equal(env.reset()[0], other)


def test_a_mixture_with_it_is_refused_and_any_soil_serves_any_vehicle():
    with pytest.raises(ValueError, match=r'must stand alone.*"any-soil"'):
        make_uncertainty(["any-vehicle", "payload"])
    one = any_vehicle(11, STRAWA)
    env = drawn(3, uncertainty="any-soil", vehicle=one)
    loads = [episode.parameters.mass / one.mass for episode in env.simulation.episodes]
    assert len({*loads}) == 3 and all(0.8 <= load <= 1.5 for load in loads)
    draw = known_laws()["any-vehicle"](np.random.default_rng(0), one, None, 30.0)
    assert draw.parameters.contact_length == one.contact_length


def sheet_of(env, observation, name):
    return np.exp(env.simulation.layout.unpack(observation)[f"sheet_{name}"])


@pytest.mark.parametrize("error", [0.0, 0.1])
def test_the_data_sheet_shows_the_nominal_vehicle_with_its_error_for_a_whole_episode(error):
    layout = (*obs.V0.groups, "data_sheet")
    env = drawn(64, observation=layout, sensors={"preset": "rtk", "data_sheet_error": error})
    first = env.simulation.observations.copy()
    for _ in range(3):
        last, *_ = env.step(np.zeros((64, 2), np.float32))
    for name in obs.SHEET:
        nominal = np.array([getattr(env.simulation.nominal(i), name) for i in range(64)])
        ratio = sheet_of(env, first, name) / nominal
        wrong = np.abs(np.log(ratio))
        np.testing.assert_allclose(wrong, math.log1p(error), rtol=1e-5, atol=2e-6)
        assert error == 0.0 or 15 < (ratio > 1.0).sum() < 49
        assert np.array_equal(sheet_of(env, last, name), sheet_of(env, first, name))
    plain = drawn(64)
    for _ in range(3):
        other, *_ = plain.step(np.zeros((64, 2), np.float32))
    assert np.array_equal(other, last[:, : obs.SIZE])  # nothing else changes


def test_two_vehicles_that_are_scale_models_look_the_same_in_units_of_the_data_sheet():
    """Froude: lengths s, times sqrt(s), forces s^3 leave every number as it is.

    Straight ahead: friction to the side is regularised below a fixed speed of 0.03 m/s.
    """
    s, several = 4.0, (any_vehicle(k, STRAWA) for k in range(200))
    fast = (p for p in several if p.sprocket_radius * p.sprocket_speed_limit > 4.0)
    one = next(p for p in fast if p.contact_length < 1.0)
    scales = {
        "m": s, "kg": s**3, "kg m^2": s**5, "N m": s**4, "rad/s": s**-0.5, "s": s**0.5, "Pa": s,
    }  # fmt: skip
    units = {"mass": "kg", "inertia": "kg m^2", "sprocket_inertia": "kg m^2", "cohesion": "Pa"}
    units |= {"torque_limit": "N m", "sprocket_speed_limit": "rad/s", "drive_time_constant": "s"}
    lengths = ("track_gauge", "track_width", "contact_length", "sprocket_radius", "icr_forward")
    units |= dict.fromkeys((*lengths, "shear_deformation_modulus"), "m")
    large = one._replace(**{n: getattr(one, n) * scales[u] for n, u in units.items()})
    shown = []
    for p, rate, speed in ((one, 50.0, 1.0), (large, 25.0, s**0.5)):
        env = drawn(
            1, vehicle=p, uncertainty="nominal", sensors="ideal", observation=["relative"],
            control_rate=rate, time_step=0.0025 if rate == 50.0 else 0.005, error_limit=1e6,
            reference={"kind": "straight", "speed": 1.5 * speed},
        )  # fmt: skip
        start = {"offset_x": 0.1 * p.contact_length, "offset_y": 0.0, "offset_yaw": 0.0}
        env.reset(seed=1, options={"start": {**start, "speed": 1.5 * speed, "yaw_rate": 0.0}})
        for _ in range(40):
            last, *_ = env.step(np.array([[0.3, 0.3]], np.float32))
        shown.append(env.simulation.layout.unpack(last[0]))
    ahead = {name for name in shown[0] if "ahead" in name}  # at fixed times
    for name in {*shown[0]} - ahead:
        assert shown[0][name] == pytest.approx(shown[1][name], rel=1e-3, abs=1e-4), name


def test_units_of_the_sheet_are_those_of_the_vehicle():
    env = drawn(3, observation=[*obs.V0.groups, "relative"])
    last, *_ = env.step(np.full((3, 2), 0.3, np.float32))
    values, p = env.simulation.layout.unpack(last), env.simulation.nominal(1)
    units = {"v_x": math.sqrt(9.81 * p.contact_length), "torque_left": p.torque_limit}
    units |= {"position_error_x": p.contact_length, "acceleration_x": 9.81, "heading_error": 1.0}
    for name, unit in units.items():
        shown = values[f"relative_{name}"][1]
        assert shown == pytest.approx(values[name][1] / unit, rel=1e-3, abs=1e-6), name


def test_copies_and_snapshots_keep_the_vehicle_and_its_sheet():
    env = drawn(4, observation="relative-v0", sensors={"data_sheet_error": 0.3})
    simulation = env.simulation
    snapshot, nominal = simulation.snapshot(), simulation.nominal(2)
    env.reset(seed=99)
    assert simulation.nominal(2) != nominal
    simulation.resume(snapshot)
    assert simulation.nominal(2) == nominal
    first = simulation.step(np.zeros((4, 2), np.float32)).copy()
    simulation.resume(snapshot)
    assert np.array_equal(simulation.step(np.zeros((4, 2), np.float32)), first)


# --- fleets of the benchmark ------------------------------------------------------------------
def test_a_fleet_has_four_episodes_a_vehicle_and_the_same_ones_whatever_is_told():
    names = [name for name in names_of(VEHICLE_SETS) if SETS[name].env == tracked_env.TORQUE_ID]
    config = BenchmarkConfig(sets=tuple(names), episodes=10)
    assert [*config.batches(names[0], 10, 64)] == [range(4), range(4, 8), range(8, 10)]
    vehicles = [config.arguments(n, False, i)["vehicle"] for n in names for i in range(10)]
    assert vehicles[:10] == vehicles[10:20] == vehicles[30:]
    assert vehicles[0] == vehicles[3] != vehicles[4]
    options = config.options(names[0], range(4, 8))
    assert options is not None and len(options["rows"]) == 4
    for name, error in zip(names, TOLD.values(), strict=True):
        told, true = config.context(name, 5).vehicle, vehicles[5]
        factors = np.array([getattr(told, n) / getattr(true, n) for n in PARAMETER_NAMES[:10]])
        if error is None:
            assert told == STRAWA
        else:
            np.testing.assert_allclose(np.abs(np.log(factors)), math.log1p(error), atol=1e-12)
            assert told[10:] == true[10:]
        assert config.context(name, 5, truth=True).vehicle == true


def test_another_split_has_other_vehicles():
    frozen = BenchmarkConfig(sets=("vehicles",)).arguments("vehicles", False)["vehicle"]
    config = BenchmarkConfig(sets=("vehicles",), seed=50_000)
    assert config.arguments("vehicles", False)["vehicle"] != frozen


def test_a_fleet_is_tuned_and_shown_on_the_episodes_that_are_compared():
    config = BenchmarkConfig(sets=("vehicles",), episodes=8, duration=2.0)
    policy = tuning.tunable("nominal", POLICIES["nominal"])
    entry = PolicyEntry("nominal", POLICIES["nominal"], "")
    compared = [
        record["tracking_rmse"]
        for chunk in config.batches("vehicles", 8, 8)
        for record in run_task(entry, Task("nominal", "vehicles", tuple(chunk)), config).chunk[
            "episodes"
        ]
    ]
    tuned = tuning.outcome(policy, {}, config, "vehicles")
    assert tuned.rmse == pytest.approx(float(interquartile_mean(compared)), rel=1e-12)
    *_, (simulation, _) = video._driven(config, entry, "vehicles", 6, 50)
    assert float(simulation.rmse[0]) == pytest.approx(compared[6], rel=1e-12)


def test_a_vehicle_for_a_set_that_draws_its_own_is_refused():
    with pytest.raises(ValueError, match="'vehicles', which draws its own vehicles"):
        BenchmarkConfig(sets=("vehicles",), vehicle="focchi")
