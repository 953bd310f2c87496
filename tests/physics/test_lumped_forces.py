"""The equations of motion: power balance, symmetries, rest, limits of the drive."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.physics.plant_cases import CLAY, LATERAL_MODELS, REST, model, random_cases
from tracked_env.physics import lumped
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.lumped import Motion
from tracked_env.physics.parameters import RANGES


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_sprocket_power_is_kinetic_energy_rate_plus_slip_rolling_and_lateral_dissipation(
    lateral_model,
):
    for p, motion, left, right in random_cases(lateral_model):
        loads, rates = model(lateral_model, p)
        f, rate = loads(motion, left, right), rates(motion, left, right)
        drive = lumped.drive_limits(p)
        speeds = lumped.track_speeds(motion, 0.5 * p.track_gauge)
        efforts = np.array([f.effort_left, f.effort_right])
        belts = np.array(
            [lumped.track_slip(*pair, drive)[1] for pair in zip(efforts, speeds, strict=True)]
        )
        # Transmitted torque F r times sprocket speed V_t / r.
        sprocket = (efforts * p.sprocket_radius) @ (belts / p.sprocket_radius)
        slip = efforts @ (belts - speeds)
        rolling = f.resistance_left * speeds[0] + f.resistance_right * speeds[1]
        lateral = -(f.lateral_force * motion.v_y + f.turning_moment * motion.yaw_rate)
        kinetic = p.mass * (motion.v_x * rate[0] + motion.v_y * rate[1])
        kinetic += p.inertia * motion.yaw_rate * rate[2]
        largest = max(abs(sprocket), abs(slip), abs(rolling), abs(lateral), abs(kinetic))
        assert abs(sprocket - kinetic - slip - rolling - lateral) <= 1e-9 * largest
        assert slip >= 0.0
        # What a held load may give back near standstill, see test_terramechanics.
        trace = 0.0842 * p.mass * soil.GRAVITY
        width = soil.MOTION_RESISTANCE_REGULARISATION
        assert rolling >= -trace * p.longitudinal_resistance * width
        if lateral_model == "sliding":
            assert lateral >= 0.0
        else:
            length = 0.25 * p.contact_length * p.turning_resistance_factor
            width = soil.YAW_FRICTION_REGULARISATION
            assert lateral >= -trace * p.lateral_resistance * length * width


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_left_and_right_are_mirror_images_and_so_are_front_and_rear_bit_for_bit(lateral_model):
    for p, motion, left, right in random_cases(lateral_model):
        rates = model(lateral_model, p)[1]
        a_x, a_y, a_w = rates(motion, left, right)
        mirrored = rates(Motion(motion.v_x, -motion.v_y, -motion.yaw_rate), right, left)
        assert mirrored == (a_x, -a_y, -a_w)
        # Turned by half a turn: left and right change places, and the ICR changes its sign.
        turned = p._replace(icr_forward=-p.icr_forward)
        back = Motion(-motion.v_x, -motion.v_y, motion.yaw_rate)
        assert model(lateral_model, turned)[1](back, -right, -left) == (-a_x, -a_y, a_w)


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_the_faster_right_track_turns_the_vehicle_to_the_left(lateral_model):
    a_x, _, a_w = model(lateral_model, CLAY)[1](REST, -6000.0, 6000.0)
    assert a_w > 0.0
    assert abs(a_x) < 1e-6
    left, right = lumped.track_speeds(Motion(1.0, 0.0, 0.2), 0.85)
    assert (left, right) == pytest.approx((0.83, 1.17))


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_a_vehicle_at_rest_stays_at_rest_below_its_resistances(lateral_model):
    rates = model(lateral_model, CLAY)[1]
    for left, right in [(0.0, 0.0), (1000.0, 1000.0), (-1200.0, 1200.0), (0.0, -1270.0)]:
        assert rates(REST, left, right) == (0.0, 0.0, 0.0)
    assert rates(REST, 1400.0, 1400.0)[0] == pytest.approx(
        2.0 * (1400.0 / 0.3 - 0.3 * 1450.0 * 9.81) / 1450.0
    )


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_no_effort_exceeds_the_limit_of_the_soil(lateral_model):
    for p, motion, left, right in random_cases(lateral_model):
        f = model(lateral_model, p)[0](motion, 50.0 * left, 50.0 * right)
        limit = lumped.drive_limits(p).effort_limit
        assert abs(f.effort_left) <= limit
        assert abs(f.effort_right) <= limit
        assert limit == soil.tractive_effort(
            1.0, lumped.drive_limits(p).effort_maximum, lumped.drive_limits(p).shear_length
        )


def test_a_track_faster_than_its_sprocket_gets_no_driving_effort_but_can_brake():
    drive = lumped.drive_limits(CLAY)
    top = CLAY.sprocket_radius * CLAY.sprocket_speed_limit
    for speed in (1.0001 * top, 2.0 * top):
        assert lumped.track_limits(speed, drive) == (-drive.effort_limit, 0.0)
        assert lumped.track_limits(-speed, drive) == (0.0, drive.effort_limit)


def test_an_effort_called_safe_is_below_every_traction_limit():
    # Efforts around the limit at speeds that leave the belt little slip: where it is close.
    draws = np.random.default_rng(6)
    counts = {True: 0, False: 0}
    for p, _, _, _ in random_cases("sliding", 600):
        drive, half_gauge = lumped.drive_limits(p), 0.5 * p.track_gauge
        fastest = (1.0 - 10.0 ** draws.uniform(-4.0, 0.0)) / drive.inverse_belt_limit
        share = draws.uniform(-1.0, 1.0)
        motion = Motion(share * fastest, 0.0, (1.0 - abs(share)) * fastest / half_gauge)
        limits = lumped.traction_limits(motion, half_gauge, drive)
        lowest = min(abs(bound) for bound in limits)
        effort = float(draws.uniform(0.3, 1.5) * lowest)
        safe = bool(lumped.safe_effort(motion, effort, half_gauge, drive))
        counts[safe] += 1
        assert not (safe and effort > lowest)
    assert min(counts.values()) > 100


def test_the_motor_lag_decays_exponentially_and_may_be_absent():
    assert lumped.torque_decay(0.05, 0.05) == pytest.approx(math.exp(-1.0), rel=1e-14)
    assert lumped.torque_decay(0.01, 0.0) == 0.0
    assert lumped.torque_decay(0.0, 0.05) == 1.0


def test_inertial_acceleration_of_a_steady_circle_points_to_its_centre():
    assert lumped.inertial_acceleration(Motion(2.0, 0.0, 0.2), 0.0, 0.0) == (0.0, 0.4)
    assert lumped.inertial_acceleration(Motion(2.0, 0.0, -0.2), 0.0, 0.0) == (0.0, -0.4)
    assert lumped.inertial_acceleration(Motion(0.0, 1.0, 0.5), 0.3, 0.0) == pytest.approx(
        (-0.2, 0.0)
    )


def test_every_extreme_of_the_allowed_parameters_gives_finite_accelerations():
    for name, bounds in RANGES.items():
        for value in (bounds.low, bounds.high):
            p = CLAY._replace(**{name: float(value)})
            for lateral_model in LATERAL_MODELS:
                rates = model(lateral_model, p)[1](Motion(1.0, -0.01, 0.2), 500.0, 900.0)
                assert np.all(np.isfinite(rates)), (name, value)


def test_the_yaw_moment_at_which_a_pivot_starts_is_rolling_resistance_only():
    # Sliding friction needs sliding: at rest the turn starts beyond the tracks' resistance.
    def yaw_acceleration(torque):
        return model("sliding", CLAY)[1](REST, -torque, torque)[2]

    threshold = brentq(lambda t: yaw_acceleration(t) - 1e-6, 1000.0, 2000.0)
    assert threshold == pytest.approx(0.3 * 0.3 * 1450.0 * 9.81, rel=1e-6)
