"""Identification on slopes: what the accelerometer feels, loads, ways on the map, one stack."""

import math

import numpy as np
import pytest

from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import (
    ATTITUDE,
    DataSheet,
    Measurement,
    Status,
    make_measurement,
)
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.stack import IdentificationStack
from baselines.estimators.turning import TurningEstimator
from tests.baselines.estimators.motion_cases import EXACT, measurements, motion
from tests.baselines.estimators.slip_cases import GAUGE, PARAMETERS, PERIOD, RADIUS, RTK
from tracked_env import TERRAIN
from tracked_env import observation as layout
from tracked_env.physics.parameters import VEHICLES, plant_parameters
from tracked_env.physics.rigid_body import angles_of, matrix_of, quaternion_of, turned
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.sensors import make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

CLAY = plant_parameters()
SHOWN = layout.make_layout(TERRAIN["observation"])
FLAT_NEEDS = IdentificationStack().needs


def estimator(kind, parameters, sheet=EXACT, attitude=True):
    """An estimator of one vehicle as the stack makes it."""
    return kind(parameters, 0.02, sheet, attitude=attitude)


def tilted(measurement, roll, pitch, pitch_rate=0.0):
    """The measurement with an attitude, each a number or (N,)."""
    count = len(measurement.values)
    rows = zip(ATTITUDE, (roll, pitch, pitch_rate), strict=True)
    return measurement.with_fields(
        {name: np.broadcast_to(value, count).astype(float) for name, value in rows}
    )


def crawling(pitch, mass, resistance, roll=0.1):
    """A sample of a vehicle that drives straight at constant speed on that slope: no kinematic
    acceleration; its thrust carries the weight's share and the rolling resistance."""
    press = math.cos(pitch) * math.cos(roll)
    thrust = mass * GRAVITY * (resistance * press - math.sin(pitch))
    torque = 0.5 * thrust * CLAY.sprocket_radius
    sample = make_measurement(
        v_x=1.0, v_y=0.0, yaw_rate=0.0, acceleration_x=-GRAVITY * math.sin(pitch),
        torque_left=torque, torque_right=torque,
    )  # fmt: skip
    return tilted(sample, roll, pitch)


@pytest.mark.parametrize("excited", [True, False], ids=["slopes", "one slope"])
def test_at_constant_speed_changing_slopes_show_the_mass_and_one_slope_does_not(excited):
    mass, resistance = 1.3 * CLAY.mass, 0.05
    one, blind = (estimator(LongitudinalEstimator, CLAY, attitude=a) for a in (True, False))
    for k in range(400):
        pitch = 0.3 * math.sin(0.05 * k) if excited else 0.2
        sample = crawling(pitch, mass, resistance)
        known = one.update(sample)
        wrong = blind.update(Measurement(*sample))
    found = 1.0 / known.of("inverse_mass")[0]
    if not excited:
        assert known.status[0] == Status.HOLDING and known.excitation[0] < 1.0
        return
    assert known.status[0] == Status.CONVERGING
    assert found == pytest.approx(mass, rel=1e-4)
    assert known.of("longitudinal_resistance")[0] == pytest.approx(resistance, rel=1e-3)
    # Without the attitude the load is the weight: what is found is less by the mean of the cosines.
    assert wrong.of("longitudinal_resistance")[0] == pytest.approx(0.97 * resistance, rel=0.01)


def test_turning_on_a_slope_is_turning_under_a_smaller_load():
    roll, pitch = 0.3, 0.35
    press = math.cos(roll) * math.cos(pitch)
    truth = CLAY._replace(inertia=1.3 * CLAY.inertia)
    lighter = truth._replace(lateral_resistance=truth.lateral_resistance * press)
    sloped, blind = (estimator(TurningEstimator, CLAY, attitude=a) for a in (True, False))
    for sample in measurements(lighter, "curves"):
        known, wrong = sloped.update(tilted(sample, roll, pitch)), blind.update(sample)
    assert known.of("inertia")[0] == pytest.approx(truth.inertia, rel=0.01)
    assert known.of("lateral_resistance")[0] == pytest.approx(truth.lateral_resistance, rel=0.01)
    biased = press * truth.lateral_resistance
    assert wrong.of("lateral_resistance")[0] == pytest.approx(biased, rel=0.01)


def hills(steps, count, slip, side_slip, seed=0):
    """Samples of vehicles whose tracks slip by `slip` while roll and pitch swing: the body moves in
    its own plane, and its attitude is integrated."""
    rng, tangent = np.random.default_rng(seed), math.tan(side_slip)
    position = np.zeros((count, 2))
    attitude = [quaternion_of(0.3 * i, 0.25, 0.2 - 0.1 * i) for i in range(count)]
    yaw, phase = 0.3 * np.arange(count), rng.uniform(0.0, 6.3, count)
    for k in range(steps):
        turn = 0.4 * np.sin(0.02 * k + phase)
        belts = np.stack([1.0 - turn, 1.0 + turn], axis=1)
        tracks = (1.0 - slip) * belts
        forward, w = tracks.mean(axis=1), (tracks[:, 1] - tracks[:, 0]) / GAUGE
        rates = 0.15 * np.cos(0.03 * k + phase)
        angles = np.array([angles_of(q, y) for q, y in zip(attitude, yaw, strict=True)])
        yaw = angles[:, 0]
        noise = rng.standard_normal((8, count))
        sample = make_measurement(
            x=position[:, 0] + 0.02 * noise[0],
            y=position[:, 1] + 0.02 * noise[1],
            yaw=yaw + RTK.yaw_noise * noise[2],
            v_x=forward + 0.03 * noise[3],
            v_y=tangent * forward + 0.03 * noise[4],
            yaw_rate=w + 0.002 * noise[5],
            sprocket_speed_left=belts[:, 0] / RADIUS + 0.02 * noise[6],
            sprocket_speed_right=belts[:, 1] / RADIUS + 0.02 * noise[7],
        )
        yield tilted(sample, angles[:, 2], angles[:, 1], rates)
        for i in range(count):
            middle = turned(attitude[i], 0.0, 0.5 * PERIOD * rates[i], 0.5 * PERIOD * w[i])
            axes = np.array(matrix_of(middle)).reshape(3, 3)
            position[i] += PERIOD * (axes @ [forward[i], tangent * forward[i], 0.0])[:2]
            attitude[i] = turned(attitude[i], 0.0, PERIOD * rates[i], PERIOD * w[i])


def test_slips_on_slopes_are_found_where_a_flat_map_takes_the_slope_for_slip():
    slip, side_slip = 0.1, 0.06
    sloped, flat = (SlipObserver(PARAMETERS, PERIOD, RTK, 4, velocity=False) for _ in range(2))
    found, wrong, nis = [], [], []
    for k, sample in enumerate(hills(900, 4, slip, side_slip)):
        known = sloped.update(sample)
        other = flat.update(Measurement(*sample))
        if k > 400:
            found.append(known.value[:, 3:])
            wrong.append(other.value[:, 3:])
            nis.append(known.nis)
    errors = np.mean(found, axis=(0, 1)) - [slip, slip, side_slip]
    assert np.abs(errors).max() < 0.005
    assert np.mean(nis) < 4.0  # 3 are expected
    assert np.abs(np.mean(wrong, axis=(0, 1)) - [slip, slip, side_slip]).max() > 0.01


def drive(terrain, sensors, steps, speed, count=2):
    """Observations (steps, count, D) and forward speeds of the light vehicle under a constant
    thrust that just carries it up the slope, and its sensors."""
    env = TrackedVehicleVectorEnv(
        count,
        **{
            **TERRAIN, "drive": "torque", "uncertainty": "nominal", "sensors": sensors,
            "plant_options": {"terrain": terrain}, "error_limit": 1e3, "expose_truth": True,
            "reference": {"kind": "straight", "speed": speed}, "duration": 60.0,
        },
    )  # fmt: skip
    on_path = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0, "speed": speed}
    seen, info = env.reset(seed=70400, options={"start": on_path})
    light = VEHICLES["focchi"]
    for _ in range(steps):
        pitch = info["truth"]["pitch"]
        press = light.longitudinal_resistance * (speed > 0.0) * np.cos(pitch)
        thrust = light.mass * GRAVITY * (press - np.sin(pitch))
        action = 0.5 * thrust * light.sprocket_radius / light.torque_limit
        yield seen, info["truth"]
        seen, _, _, _, info = env.step(np.stack([action, action], axis=1).astype(np.float32))


LATE = {"preset": "ideal", "pose_delay": 0.2, "drive_delay": 0.2, "inertial_delay": 0.2}


@pytest.mark.parametrize("slope", [0.2, -0.2])
def test_gravity_is_not_taken_for_thrust_where_a_late_filter_is_brought_to_the_present(slope):
    sheet = DataSheet.of(make_sensors(LATE))
    sloped, flat = (
        IdentificationStack(VEHICLES["focchi"], 0.02, sheet, 2, attitude=attitude)
        for attitude in (True, False)
    )
    views = [layout.View(SHOWN.names, stack.needs) for stack in (sloped, flat)]
    errors = []
    for observation, truth in drive({"kind": "plane", "slope_x": slope}, LATE, 100, 0.4):
        known = [
            stack.update(view(observation))
            for stack, view in zip((sloped, flat), views, strict=True)
        ]
        errors.append([one.motion.v_x - truth["v_x"] for one in known])
    taken = GRAVITY * math.sin(math.atan(slope)) * LATE["pose_delay"]  # 0.38 m/s
    after_delay = np.mean(errors[12:], axis=2)
    np.testing.assert_allclose(after_delay[:, 0], 0.0, atol=0.05 * abs(taken))
    np.testing.assert_allclose(after_delay[:8, 1], taken, rtol=0.05)
    # Later the flat stack counts gravity as the accelerometer's bias, which is right on this slope.
    assert abs(after_delay[-1, 1]) < 0.1 * abs(taken)


@pytest.mark.parametrize("slip", ["batched", "filterpy"])
def test_at_zero_attitude_the_stack_is_the_flat_stack_to_the_bit_and_single_vehicles_too(slip):
    stacks = [
        IdentificationStack(CLAY, 0.02, RTK, count, attitude=attitude, slip=slip)
        for count, attitude in ((3, True), (3, False), (1, True))
    ]
    rng, base = np.random.default_rng(0), motion("curves")
    names = (*layout.NAMES, *ATTITUDE)
    for k in range(60):
        values = {name: 0.05 * rng.normal(size=3) for name in layout.NAMES}
        values.update(v_x=base[0][k] + 0.03 * rng.normal(size=3))
        values.update(torque_left=np.full(3, base[3][k]), torque_right=np.full(3, base[4][k]))
        flat = layout.pack(
            {**values, **{name: np.zeros(3) for name in layout.NAMES if "age" in name}}
        )
        level = np.concatenate([flat, np.zeros((3, len(ATTITUDE)), np.float32)], axis=1)
        tilt = level.copy()
        tilt[:, -3:] = 0.4 * rng.normal(size=(3, 3))
        given = tilt if k > 30 else level
        both = stacks[0].update(given), stacks[1].update(flat), stacks[2].update(given[1:2])
        for name in ("longitudinal", "turning", "slip", "soil"):
            one, other, single = (known.parts[name].value for known in both)
            np.testing.assert_array_equal(one[1], single[0])
            if k <= 30:
                np.testing.assert_array_equal(one, other)
    assert not np.array_equal(both[0].slip.value, both[1].slip.value)
    assert len(names) == level.shape[1] and stacks[1].needs == FLAT_NEEDS


def test_a_missing_attitude_counts_as_level_and_spoils_nothing():
    stack = IdentificationStack(CLAY, 0.02, RTK, 1, attitude=True)
    twin = IdentificationStack(CLAY, 0.02, RTK, 1, attitude=True)
    view = np.zeros((1, layout.SIZE + 3), np.float32)
    view[0, layout.INDEX["v_x"]] = 0.5
    broken = view.copy()
    broken[0, layout.SIZE :] = np.nan
    for _ in range(10):
        one, other = stack.update(broken), twin.update(view)
        np.testing.assert_array_equal(one.motion_rows, other.motion_rows)
    assert all(np.array_equal(a, b) for a, b in zip(stack.memories(), twin.memories(), strict=True))
