"""Feedback linearization on slopes: gravity, the vehicle's plane, level ground to the bit."""

import math

import numpy as np
import pytest

from baselines.estimators.measurement import ATTITUDE
from baselines.linearizing import linearizing_law as law
from baselines.linearizing.linearizing_law import Gains
from baselines.registry import POLICIES
from tests.baselines.episodes import run
from tracked_env import TERRAIN
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyContext
from tracked_env.physics import lumped
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.parameters import VEHICLES
from tracked_env.physics.rigid_body import incline_of, matrix_of, quaternion_of
from tracked_env.sensors import MOCAP

LIGHT = VEHICLES["focchi"]
K = lumped.coefficients(LIGHT, False)
SHOWN = layout.make_layout(TERRAIN["observation"])
TORQUE = {**TERRAIN, "drive": "torque"}


def policy(name, observation=SHOWN.names):
    """A policy for the light vehicle driven by torques; layout.NAMES: it knows no slope.

    With the gains of the paper, for which the limits of the tests were found.
    """
    context = PolicyContext(0.02, "sliding", MOCAP, "torque", VEHICLES["focchi"], observation)
    return POLICIES[name](context, **Gains()._asdict())


class Flat:
    """A policy that is shown the fields of v0 alone."""

    def __init__(self, name):
        self.policy = policy(name, layout.NAMES)

    def predict(self, observation, state):
        return self.policy.predict(observation[:, : layout.SIZE], state)


def seen(count=40, seed=1, **attitude):
    """Observations near the path, of moderate errors."""
    rng = np.random.default_rng(seed)
    values = {name: 0.03 * rng.normal(size=count) for name in SHOWN.names}
    values["v_x"] = values["reference_speed"] = np.full(count, 0.3)
    for name in ATTITUDE:
        values[name] = np.zeros(count)
    return SHOWN.pack({**values, **attitude})


@pytest.mark.parametrize("pitch", [0.25, -0.25])
def test_efforts_hold_the_weights_share_along_the_slope_and_the_pressed_resistance(pitch):
    incline = incline_of(pitch, 0.1)
    k = law.pressed(K, incline.press)
    motion = lumped.Motion(0.4, 0.0, 0.0)
    left, right = law.track_efforts(motion, 0.0, 0.0, LIGHT, k, False, 9.81 * incline.down_x)
    weight = LIGHT.mass * soil.GRAVITY
    rolling = LIGHT.longitudinal_resistance * weight * math.cos(pitch) * math.cos(0.1)
    assert left + right == pytest.approx(rolling - weight * math.sin(pitch), rel=1e-3)


def test_the_lateral_velocity_balances_friction_gravity_and_the_turn():
    for yaw_rate, roll in ((0.5, 0.2), (-0.5, 0.2), (0.8, -0.25)):
        incline = incline_of(0.1, roll)
        k = law.pressed(K, incline.press)
        v_y = law.steady_lateral_velocity(0.4, yaw_rate, k, soil.GRAVITY * incline.down_y)
        force, _ = soil.lateral_friction(v_y, yaw_rate, k.friction_intensity, k.contact_length)
        needed = 0.4 * yaw_rate + soil.GRAVITY * math.cos(0.1) * math.sin(roll)
        assert force / LIGHT.mass == pytest.approx(needed, rel=0.02)
        assert v_y * roll < 0.0  # left side up: it slides to the right


def test_a_path_laid_on_a_plane_is_demanded_with_all_its_derivatives():
    slope_x, slope_y, yaw, v, w = 0.25, -0.15, 0.7, 0.4, 0.6
    along = slope_x * math.cos(yaw) + slope_y * math.sin(yaw)
    aside = slope_y * math.cos(yaw) - slope_x * math.sin(yaw)
    pitch, roll = -math.atan(along), math.atan2(aside, math.hypot(1.0, along))
    axes = np.array(matrix_of(quaternion_of(yaw, pitch, roll))).reshape(3, 3)
    reference = law.Reference(v, 0.2, -0.1, w, 0.3)
    on_map = law.demanded_motion(0.03, -0.02, 0.1, reference, 0.0, 0.0, False)
    demand = np.array(law.lifted(on_map, incline_of(pitch, roll))).reshape(4, 2)
    c, s = math.cos(yaw), math.sin(yaw)
    for flat, tilted in zip(np.array(on_map).reshape(4, 2), demand, strict=True):
        x, y = c * flat[0] - s * flat[1], s * flat[0] + c * flat[1]
        lifted = axes.T @ [x, y, slope_x * x + slope_y * y]
        assert tilted == pytest.approx(lifted[:2], abs=1e-12)
        assert lifted[2] == pytest.approx(0.0, abs=1e-12)


def test_on_level_ground_actions_are_those_of_the_flat_policy_to_the_bit():
    observation = seen()
    sloped = policy("nominal").predict(observation)[0]
    assert np.abs(sloped).max() < 0.25  # neither drive nor soil bounds it
    np.testing.assert_array_equal(sloped, Flat("nominal").predict(observation, None)[0])
    assert np.abs(sloped - policy("nominal").predict(seen(pitch=np.full(40, 0.1)))[0]).max() > 0.05


@pytest.mark.parametrize("name", ["nominal", "adaptive"])
def test_on_mirrored_slopes_left_and_right_are_exchanged(name):
    tilt = np.random.default_rng(2).uniform(-0.3, 0.3, (2, 40))
    one, other, states = policy(name), policy(name), [None, None]
    for k in range(5):
        observation = seen(seed=k, roll=tilt[0], pitch=tilt[1])
        action, states[0] = one.predict(observation, states[0])
        back, states[1] = other.predict(SHOWN.mirror(observation), states[1])
        np.testing.assert_allclose(back[:, ::-1], action, rtol=0.0, atol=2e-6)
    assert np.abs(action - action[:, ::-1]).max() > 0.1


def test_a_missing_attitude_counts_as_level_for_the_adaptive_policy_and_is_named_by_the_other():
    broken = seen(pitch=np.full(40, 0.2), roll=np.full(40, 0.1))
    broken[:, [SHOWN.index[name] for name in ATTITUDE]] = np.nan
    level = policy("adaptive").predict(seen())[0]
    np.testing.assert_array_equal(policy("adaptive").predict(broken)[0], level)
    with pytest.raises(ValueError, match=r"observation\[0\]: roll = nan; must be finite"):
        policy("nominal").predict(broken)


@pytest.mark.parametrize("toward", [0.5 * math.pi, -0.75 * math.pi], ids=["across", "down"])
def test_on_a_plane_slope_the_known_vehicle_stays_on_its_path(toward):
    slope = {"slope_x": 0.2 * math.cos(toward), "slope_y": 0.2 * math.sin(toward)}
    arguments = {**TORQUE, "uncertainty": "nominal", "error_limit": 5.0, "sensors": "ideal"}
    arguments |= {"plant_options": {"terrain": {"kind": "plane", **slope}}}
    arguments |= {"reference": {"kind": "straight", "speed": 0.3}}
    arguments |= {"seed": 70200, "count": 4, "duration": 8.0}
    assert run(policy("nominal"), **arguments).settled.max() < 0.022
    if toward < 0.0:
        assert run(Flat("nominal"), **arguments).settled.min() > 0.3


@pytest.mark.parametrize("name, least", [("nominal", 4.0), ("adaptive", 4.0)])
def test_on_unknown_slopes_the_attitude_divides_the_error(name, least):
    arguments = {**TORQUE, "uncertainty": "slope", "seed": 70300, "count": 16, "duration": 8.0}
    sloped, flat = (np.median(run(kind, **arguments).rmse) for kind in (policy(name), Flat(name)))
    assert sloped < 0.1
    assert flat > least * sloped
