"""The policy for any vehicle: what it may know, its features, its state."""

import copy
import math

import numpy as np
import pytest

from baselines.estimators.measurement import DataSheet
from baselines.learned import untold_policy
from baselines.learned import vehicle_features as features
from baselines.learned.trained_agent import open_agent
from baselines.learned.untold_policy import AnyVehiclePolicy, policy_layers
from baselines.learned.vehicle_features import DRIVES, FEATURES, TOLD, VehicleFeatures, told_of
from baselines.registry import shipped_agents
from tests.baselines.learned.networks import random_weights
from tracked_env import SPEED
from tracked_env.benchmark.policy_interface import PolicyContext
from tracked_env.physics.parameters import VEHICLES
from tracked_env.uncertainty.any_vehicle import any_vehicle
from tracked_env.vector_env import TrackedVehicleVectorEnv

CONTEXT = PolicyContext(0.02, "sliding")


def network():
    """A network of random numbers."""
    return policy_layers(random_weights(len(FEATURES), 2), True)


def fleet(count, **arguments):
    """An environment of vehicles of any size."""
    return TrackedVehicleVectorEnv(
        count, uncertainty="any-vehicle", **{"sensors": "rtk", "duration": 12.0, **arguments}
    )


def actions(policy, count, steps=80, each=None):
    """Actions (steps, count, 2) of a policy."""
    env = fleet(count)
    observation, _ = env.reset(seed=11)
    state, taken = None, []
    for _ in range(steps):
        action, state = policy.predict(observation, state)
        if each is not None:
            observation = each(observation)
        taken.append(action)
        observation, *_ = env.step(action)
    env.close()
    return np.array(taken)


def begin(count, steps, **arguments):
    """Features and simulation after the actions to begin with have driven a fleet."""
    env, start = fleet(count, **arguments), np.ones(count, bool)
    seen = VehicleFeatures(0.02, DataSheet.of(env.simulation.settings.sensors), count)
    observation, _ = env.reset(seed=3)
    for _ in range(steps):
        seen.see(observation, start)
        start = np.zeros(count, bool)
        observation, *_ = env.step(np.clip(seen.begin, -1.0, 1.0).astype(np.float32))
    return seen, env


def test_nothing_of_the_vehicle_reaches_a_policy_that_is_not_told():
    other = CONTEXT._replace(vehicle=any_vehicle(7, VEHICLES["strawa"]))
    plain, told = (actions(AnyVehiclePolicy(network(), c), 2) for c in (CONTEXT, other))
    assert np.array_equal(plain, told)
    shown = actions(AnyVehiclePolicy(network(), other, told=True), 2)
    assert not np.array_equal(shown, plain)


def test_what_is_told_is_the_sheet_of_the_context():
    vehicle = any_vehicle(7, VEHICLES["strawa"])
    row = told_of([vehicle])[0]
    assert row[0] == 1.0
    for name, zero, value in zip(TOLD, features.SHOWN_AS_ZERO, row[1:], strict=True):
        assert zero * math.exp(2.0 * value) == pytest.approx(getattr(vehicle, name))


def test_a_batch_has_the_bits_of_its_single_vehicles():
    policy = AnyVehiclePolicy(network(), CONTEXT)
    together = actions(policy, 4)
    assert np.array_equal(together[:, :1], actions(AnyVehiclePolicy(network(), CONTEXT), 1))


def test_it_goes_on_from_an_earlier_state():
    policy, env = AnyVehiclePolicy(network(), CONTEXT), fleet(3)
    observation, _ = env.reset(seed=2)
    states, observations, expected = [None], [], []
    for _ in range(40):
        observations.append(observation)
        action, state = policy.predict(observation, states[-1])
        expected.append(action)
        states.append(state)
        observation, *_ = env.step(action)
    state = states[20]
    for k in range(20, 40):
        action, state = policy.predict(observations[k], state)
        assert np.array_equal(action, expected[k])
    env.close()


def test_a_row_that_starts_forgets_and_the_others_go_on():
    policy, env = AnyVehiclePolicy(network(), CONTEXT), fleet(2)
    observation, _ = env.reset(seed=2)
    fresh, state = observation.copy(), None
    first, _ = AnyVehiclePolicy(network(), CONTEXT).predict(fresh)
    for _ in range(20):
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
    mixed = np.stack([fresh[0], observation[1]])
    again, _ = policy.predict(mixed, state, np.array([True, False]))
    alone, _ = policy.predict(observation, state)
    assert np.array_equal(again[0], first[0])
    assert np.array_equal(again[1], alone[1])
    env.close()


def test_what_is_not_measured_stops_nothing():
    def without(observation):
        observation = observation.copy()
        observation[0, :3] = np.nan
        observation[1] = np.nan
        return observation

    assert np.isfinite(actions(AnyVehiclePolicy(network(), CONTEXT), 3, each=without)).all()


def test_features_are_finite_bounded_and_as_many_as_their_names():
    seen, env = begin(24, 200, sensors="strawa")
    assert seen.features.shape == (24, len(FEATURES))
    assert (np.abs(seen.features) <= features.BOUND).all()
    changes = np.ptp(seen.features, axis=0) > 0.0
    constant = {name for name, moves in zip(FEATURES, changes, strict=True) if not moves}
    sheet = {f"sheet_{name}" for name in features.SHEET}
    told = {"is_told", *(f"told_{name}" for name in TOLD)}
    new = {"pose_is_new", "inertial_is_new", "drive_is_new", "pose_age", "drive_age", "time"}
    assert constant <= sheet | told | new
    env.close()


def test_regressions_find_how_vehicles_of_all_sizes_answer():
    """alpha = T / (r m) of both tracks, gamma = T B / (2 r I): of what a command of 1 gives."""
    seen, env = begin(48, 500)
    column = env.simulation.batch.column
    effort = column("torque_limit") / column("sprocket_radius")
    turning = effort * 0.5 * column("track_gauge") / column("inertia")
    for name, shown, true, agrees in (
        ("alpha", 5.0, effort / column("mass"), 0.5),
        ("gamma", 4.0, turning, 0.75),
    ):
        found = shown / np.exp(seen.features[:, FEATURES.index(name)].astype(float))
        assert np.corrcoef(np.log(found), np.log(true))[0, 1] > agrees
        assert 0.8 < np.median(found / true) < 1.25
    radius = np.exp(seen.features[:, FEATURES.index("log_radius")].astype(float) - 1.4)
    assert np.median(radius / column("sprocket_radius")) == pytest.approx(1.0, abs=0.03)
    lag = features.LAGS[1:] / np.array(features.LAGS[:-1])
    best = np.round(2.0 * (seen.features[:, FEATURES.index("lag")].astype(float) + 1.0)).astype(int)
    ratio = np.array(features.LAGS)[best] / column("drive_time_constant")
    assert np.mean((ratio > 1.0 / lag.max()) & (ratio < lag.max())) > 0.9
    env.close()


def test_the_action_to_begin_with_keeps_most_vehicles_of_a_fleet_on_their_path():
    _, env = begin(48, 590)
    column = env.simulation.batch.column
    away = np.hypot(column("reference_x") - column("x"), column("reference_y") - column("y"))
    assert np.median(away / column("contact_length")) < 0.1
    assert np.mean(away < 0.5 * column("contact_length")) > 0.85
    env.close()


class Alone(VehicleFeatures):
    """The same with what is added to turns beside the network taken away."""

    def action(self, outputs):
        return super().action(outputs) - 0.5 * self.apart()[:, None] * self.weak() * [-1.0, 1.0]

    def apart(self):
        """What is added to turns beside the network, (N,) [-]."""
        return np.diff(self.steady / self.weak(), axis=1)[:, 0]

    def weak(self):
        even = self.features[:, FEATURES.index("torque_left_to_right")].astype(float) / 3.0
        return np.exp(0.5 * even[:, None] * [-1.0, 1.0])


def test_a_path_beside_the_vehicle_asks_for_a_turn_in_proportion_to_place_and_speed():
    """dw/dt = k v e_y / [1 + (v / V)^4], and less of it far from the path."""
    count, d = 24, 0.05
    env = fleet(count, sensors={"preset": "ideal", "pose_rate": 1.0}, autoreset_mode="Disabled")
    seen = Alone(0.02, DataSheet.of(env.simulation.settings.sensors), count)
    observation, _ = env.reset(seed=3)
    start = np.ones(count, bool)
    for _ in range(275):  # the next pose comes later
        seen.see(observation, start)
        observation, *_ = env.step(np.clip(seen.begin, -1.0, 1.0).astype(np.float32))
        start[:] = False
    errors, asked = [], []
    for side in (-d, d):
        moved = copy.deepcopy(seen)
        mean = moved.rows["mean"]
        mean[:, 0] += side * np.sin(mean[:, 2])
        mean[:, 1] -= side * np.cos(mean[:, 2])
        values = moved.see(observation, start).astype(float)
        found = {name: values[:, k] for k, name in enumerate(FEATURES)}
        e_x, e_y = (
            np.sign(found[n]) * np.expm1(np.abs(found[n])) / 50.0 for n in ("error_x", "error_y")
        )
        far = 1.0 + (e_x**2 + e_y**2) / features.NEAR**2
        errors.append(e_y)
        asked.append(moved.apart() * far * 4.0 / np.exp(found["gamma"]))
    v = env.simulation.batch.column("reference_speed")
    env.close()
    assert np.ptp(v) > 2.0
    np.testing.assert_allclose(errors[1] - errors[0], 2.0 * d, rtol=1e-3)
    gain = features.LATERAL_GAINS[2] * v / (1.0 + (v / features.FAST) ** 4)
    np.testing.assert_allclose(asked[1] - asked[0], gain * 2.0 * d, rtol=1e-2, atol=1e-4)


class Begun(VehicleFeatures):
    """By speed, without the integral."""

    def action(self, outputs):
        return super().action(outputs) - self.steady + self.begin


@pytest.mark.parametrize(
    ("drive", "other", "less"), [("torque", Alone, 0.97), ("speed", Begun, 0.93)]
)
def test_what_is_added_to_the_network_takes_away_what_it_leaves(drive, other, less, monkeypatch):
    """The feedback of the lateral error, by speed the integral: vehicle by vehicle."""
    agent, errors = open_agent(shipped_agents(drive)["any-vehicle"][0]), []
    own = SPEED if drive == "speed" else {"sensors": "rtk"}
    for kind in (VehicleFeatures, other):
        monkeypatch.setattr(untold_policy, "VehicleFeatures", kind)
        arguments = {**own, "uncertainty": "any-vehicle", "duration": 12.0}
        env, away, state = TrackedVehicleVectorEnv(32, **arguments), [], None
        sensors = env.simulation.settings.sensors
        policy = agent.make(CONTEXT._replace(sensors=sensors, drive=drive))
        observation, _ = env.reset(seed=5)
        for _ in range(590):
            action, state = policy.predict(observation, state)
            observation, _, _, _, info = env.step(action)
            away.append(info["tracking_error"][:, 0])
        env.close()
        errors.append(np.sqrt(np.mean(np.square(away[250:]), axis=0)))
    assert np.exp(np.mean(np.log(errors[0] / errors[1]))) < less


def by_speed(count, steps, uncertainty="any-vehicle", act=None, **arguments):
    """Errors [contact lengths] after 5 s (N,), features and simulation, of a fleet that actions to
    begin with drive by speed, with their integral."""
    env = TrackedVehicleVectorEnv(
        count, **{**SPEED, "uncertainty": uncertainty, "duration": 20.0, **arguments}
    )
    seen = VehicleFeatures(0.02, DataSheet.of(env.simulation.settings.sensors), count, "speed")
    observation, _ = env.reset(seed=3)
    column, start, away = env.simulation.batch.column, np.ones(count, bool), []
    for _ in range(steps):
        seen.see(observation, start)
        start = np.zeros(count, bool)
        action = seen.action(np.zeros((count, 2))) if act is None else act(seen)
        observation, *_ = env.step(np.clip(action, -1.0, 1.0).astype(np.float32))
        gone = np.hypot(column("reference_x") - column("x"), column("reference_y") - column("y"))
        away.append(gone / column("contact_length"))
    env.close()
    return np.sqrt(np.mean(np.square(away[250:]), axis=0)), seen, env.simulation


def test_by_speed_what_vehicles_of_all_sizes_show_keeps_them_on_their_path():
    """Radius, limit and gauge are found within seconds: with the slip that is in them, which makes
    the radius smaller and the gauge larger."""
    errors, seen, simulation = by_speed(32, 600)
    assert np.median(errors) < 0.015
    assert errors.max() < 0.1
    found = {name: seen.features[:, k].astype(float) for k, name in enumerate(FEATURES)}
    column = simulation.batch.column
    limit = DRIVES["speed"].shown_as_zero * np.exp(3.0 * found["log_torque"])
    np.testing.assert_allclose(limit, column("sprocket_speed_limit"), rtol=0.03)
    radius = np.exp(found["log_radius"] - 1.4)
    np.testing.assert_allclose(radius, column("sprocket_radius"), rtol=0.25)
    assert 0.9 < np.median(radius / column("sprocket_radius")) < 1.0
    gauge = 1.6 * np.exp(found["log_gauge"])
    assert (gauge > 0.95 * column("track_gauge")).all()
    assert np.median(gauge / column("track_gauge")) < 2.0


@pytest.mark.parametrize("vehicle", ["tracked-tractor", "excavator", "m113", "focchi"])
def test_by_speed_the_limit_is_found_although_belts_turn_already_at_the_start(vehicle):
    """Lags of 0.2 s, and none; commands begin while belts roll."""
    arguments = {**SPEED, "vehicle": vehicle, "uncertainty": "any-soil"}
    env = TrackedVehicleVectorEnv(16, **{**arguments, "reference": "figure_eight"})
    seen = VehicleFeatures(0.02, DataSheet.of(env.simulation.settings.sensors), 16, "speed")
    observation, _ = env.reset(seed=3)
    column, start = env.simulation.batch.column, np.ones(16, bool)
    assert (column("sprocket_speed_left") > 1.0).all()
    for _ in range(20):
        seen.see(observation, start)
        start[:] = False
        observation, *_ = env.step(np.clip(seen.begin, -1.0, 1.0).astype(np.float32))
    env.close()
    place = FEATURES.index("log_torque")
    limit = DRIVES["speed"].shown_as_zero * np.exp(3.0 * seen.features[:, place].astype(float))
    assert np.median(limit / column("sprocket_speed_limit")) == pytest.approx(1.0, abs=0.03)


def test_by_speed_the_integral_takes_away_what_stays_ahead_without_a_network():
    with_it = by_speed(64, 600)[0]
    without = by_speed(64, 600, act=lambda seen: seen.begin)[0]
    assert np.median(with_it) < 0.97 * np.median(without)


def test_by_speed_a_batch_has_the_bits_of_its_single_vehicles_and_no_sheet_is_shown():
    context = PolicyContext(0.02, "sliding", drive="speed")
    taken = []
    for count in (4, 1):
        env = TrackedVehicleVectorEnv(count, **{**SPEED, "uncertainty": "any-vehicle"})
        policy, state = AnyVehiclePolicy(network(), context), None
        observation, _ = env.reset(seed=11)
        actions = []
        for _ in range(60):
            action, state = policy.predict(observation, state)
            actions.append(action[0])
            observation, *_ = env.step(action)
        env.close()
        taken.append(actions)
    assert np.array_equal(*taken)
    with pytest.raises(ValueError, match="never told its vehicle"):
        AnyVehiclePolicy(network(), context, told=True)
