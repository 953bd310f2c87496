"""The observation reader beside the environment's own pose, clocks and samples."""

import copy

import numpy as np
import pytest

from baselines.estimators.measurement import DRIVE, INERTIAL, POSE
from baselines.estimators.observation_reader import ObservationReader
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from tests.baselines.estimators.motion_cases import CLAY, state
from tracked_env import arrays as b
from tracked_env import observation as layout
from tracked_env.physics import parameters as s
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import wrap_angle
from tracked_env.sensors import CHANNEL_COUNT
from tracked_env.vector_env import TrackedVehicleVectorEnv

PERIOD = 0.02
REFERENCES = [
    "straight", "circle", "figure_eight", "spiral", "identification", "random", "mixed", "chicane",
    {"kind": "circle", "speed": -1.5, "radius": 8.0, "direction": -1, "yaw": 2.0, "x": 30.0},
    {"kind": "waypoints", "points": [[0, 0], [15, 0], [25, 10], [45, 10]]},
]  # fmt: skip


class Drive:
    """A vehicle that follows its reference under the nominal controller, and a reader."""

    def __init__(self, references, sensors="ideal", duration=30.0, seed=3):
        count = len(references)
        self.env = TrackedVehicleVectorEnv(
            count, uncertainty="nominal", sensors=sensors, duration=duration,
            error_limit=50.0, autoreset_mode="Disabled",
        )  # fmt: skip
        rows = [{"reference": reference} for reference in references]
        self.observation, _ = self.env.reset(seed=seed, options={"rows": rows})
        self.controller = FeedbackLinearizingController(CLAY, PERIOD)
        self.controller.parameters = np.repeat(self.controller.parameters, count, axis=1)
        self.state = None
        self.reader = ObservationReader(PERIOD, count)

    @property
    def floats(self):
        """The environment's own numbers, (N, columns)."""
        return self.env.simulation.batch.floats

    def read(self):
        return self.reader.read(self.observation)

    def step(self, action=None):
        """One control period, with the action (N, 2) given or the controller's."""
        if action is None:
            action, self.state = self.controller.predict(self.observation, self.state)
        self.observation = self.env.step(action)[0]


def rotate(angle, x, y):
    return np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y


def test_reference_and_pose_are_the_environment_s_on_every_reference():
    drive = Drive(REFERENCES)
    start = drive.floats[:, [b.REFERENCE_X, b.REFERENCE_Y, b.REFERENCE_YAW]].copy()
    # The yaw rate of the chicane jumps, and nobody sees when within a control period.
    jumps = np.array([reference == "chicane" for reference in REFERENCES])
    tolerance, angle = np.where(jumps, 0.05, 1e-4), np.where(jumps, 0.01, 1e-5)
    farthest = np.zeros(len(REFERENCES))
    for _ in range(1500):
        reading = drive.read()
        f, ref, z = drive.floats, reading.reference, reading.latest
        for columns, x, y, yaw in (
            ([b.REFERENCE_X, b.REFERENCE_Y, b.REFERENCE_YAW], *ref.T),
            ([b.STATE + s.X, b.STATE + s.Y, b.STATE + s.YAW], *z.values[:, :3].T),
        ):
            true_x, true_y, true_yaw = f[:, columns].T
            back_x, back_y = rotate(-start[:, 2], true_x - start[:, 0], true_y - start[:, 1])
            assert (np.hypot(x - back_x, y - back_y) < tolerance).all()
            assert (np.abs(np.vectorize(wrap_angle)(yaw - (true_yaw - start[:, 2]))) < angle).all()
        unpacked = layout.unpack(drive.observation)
        dx, dy = rotate(-z.channel("yaw"), ref[:, 0] - z.channel("x"), ref[:, 1] - z.channel("y"))
        assert dx == pytest.approx(unpacked["position_error_x"], abs=1e-9)
        assert dy == pytest.approx(unpacked["position_error_y"], abs=1e-9)
        turn = np.vectorize(wrap_angle)(ref[:, 2] - z.channel("yaw"))
        assert turn == pytest.approx(unpacked["heading_error"], abs=1e-9)
        farthest = np.maximum(farthest, np.hypot(ref[:, 0], ref[:, 1]))
        drive.step()
    assert farthest.min() > 10.0


def test_channels_other_than_the_pose_are_passed_on_in_si_units():
    drive = Drive(["random"], "rtk")
    for _ in range(20):
        z = drive.read().latest
        true = drive.floats[0, b.SAMPLE : b.SAMPLE + CHANNEL_COUNT]
        assert z.values[0, 3:] == pytest.approx(true[3:], rel=1e-6, abs=1e-6)
        drive.step()


IRREGULAR = {
    "preset": "rtk", "pose_rate": 10.0, "pose_delay": 0.1, "inertial_rate": 25.0,
    "inertial_delay": 0.04, "inertial_dropout": 0.1, "drive_delay": 0.02, "drive_dropout": 0.3,
}  # fmt: skip


@pytest.mark.parametrize("sensors", ["rtk", IRREGULAR], ids=["every step", "irregular"])
def test_a_group_is_new_when_another_sample_has_arrived(sensors):
    drive = Drive(["random"] * 5, sensors)
    at = b.SAMPLE if sensors == "rtk" else b.DELIVERED
    taken_before = np.full((5, 3), -1.0)
    fresh = np.zeros(3)
    for step in range(400):
        latest = drive.read().latest
        taken = drive.floats[:, at + CHANNEL_COUNT : at + CHANNEL_COUNT + 3].copy()
        assert np.array_equal(latest.fresh, taken > taken_before)
        assert latest.age == pytest.approx((step - taken) * PERIOD, abs=1e-6)
        taken_before = taken
        fresh += latest.fresh.mean(0)
        drive.step()
    if sensors == "rtk":
        assert (fresh == 400).all()
    else:
        assert fresh == pytest.approx([80, 180, 280], abs=15)


def test_a_group_that_is_silent_for_good_never_counts_as_new():
    reader = ObservationReader(PERIOD)
    observation = np.zeros((1, layout.SIZE), dtype=np.float32)
    column = layout.INDEX["drive_age"]
    for step in range(4000):
        observation[0, column] = min(step * PERIOD / layout.SCALE[column], layout.BOUND[column])
        reading = reader.read(observation)
        assert reading.latest.fresh[0, DRIVE] == (step == 0)
        assert reading.paired.fresh[0, DRIVE] == (step == 0)
        assert reading.latest.fresh[0, POSE]


def longitudinal_misfit(measurement):
    """a_x - (F_L + F_R) / m + g mu_l [m/s^2] of vehicles whose tracks both run forward."""
    force = (measurement.channel("torque_left") + measurement.channel("torque_right")) / (
        CLAY.sprocket_radius
    )
    resistance = soil.GRAVITY * CLAY.longitudinal_resistance
    return measurement.channel("acceleration_x") - force / CLAY.mass + resistance


@pytest.mark.parametrize(
    "delays",
    [{"drive_delay": 0.06}, {"inertial_delay": 0.1}, {"inertial_delay": 0.3, "drive_delay": 0.04}],
)
def test_samples_of_different_delay_are_paired_by_the_time_they_were_taken(delays):
    drive = Drive(["straight"] * 2, {"preset": "ideal", **delays})
    together, apart = [], []
    for step in range(500):
        reading = drive.read()
        if step > 100:
            assert reading.paired.fresh.all()
            together.append(longitudinal_misfit(reading.paired))
            apart.append(longitudinal_misfit(reading.latest))
            assert reading.paired.age[0, INERTIAL] == pytest.approx(max(delays.values()), abs=1e-6)
            assert reading.paired.age[0, INERTIAL] == reading.paired.age[0, DRIVE]
        swing = 0.05 * np.sin(0.1 * step)  # about the torque of a constant speed
        drive.step(np.array([[0.162 + swing, 0.162 + swing], [0.162 - swing, 0.164]]))
    assert np.abs(together).max() < 1e-5  # float32 observations
    assert np.abs(apart).max() > 0.2


@pytest.mark.parametrize(
    "sensors",
    [
        IRREGULAR,
        {"preset": "ideal", "drive_rate": 25.0},
        {"preset": "ideal", "inertial_dropout": 0.5, "drive_dropout": 0.5, "drive_delay": 0.06},
    ],
)
def test_every_pair_is_of_one_moment_and_given_once(sensors):
    drive = Drive(["random"] * 6, sensors)
    at = b.SAMPLE + CHANNEL_COUNT
    sampled = []  # the step at which inertial and drive of each vehicle were last taken
    pairs = [set() for _ in range(6)]
    for step in range(500):
        paired = drive.read().paired
        sampled.append(drive.floats[:, [at + INERTIAL, at + DRIVE]].copy())
        for i in np.flatnonzero(paired.fresh[:, INERTIAL]):
            when = round(step - paired.age[i, INERTIAL] / PERIOD)
            assert when not in pairs[i]
            pairs[i].add(when)
            assert (sampled[when][i] == when).all()
        assert np.array_equal(paired.fresh[:, INERTIAL], paired.fresh[:, DRIVE])
        drive.step()
    both = [
        int((row == np.arange(500)[:, None]).all(1).sum()) for row in np.swapaxes(sampled, 0, 1)
    ]
    lengths = [len(each) for each in pairs]
    assert all(0.6 * n < length <= n for n, length in zip(both, lengths, strict=True))


def test_the_delay_of_the_drive_group_is_found_apart_from_dropouts():
    sensors = {"preset": "ideal", "drive_delay": 0.06, "drive_dropout": 0.2}
    drive = Drive(["random"] * 4, sensors)
    delays = []
    for _ in range(500):
        delays.append(drive.read().drive_delay)
        drive.step()
    assert np.min(delays[50:]) == pytest.approx(0.06, abs=1e-6)
    assert np.mean(delays[50:]) < 0.07


def test_a_new_episode_starts_from_nothing_in_its_row_alone():
    drive = Drive(["random"] * 3)
    for _ in range(50):
        drive.read()
        drive.step()
    before = copy.deepcopy(drive.reader)
    start = np.array([False, True, False])
    reading = drive.reader.read(drive.observation, start)
    fresh = ObservationReader(PERIOD).read(drive.observation[1:2])
    assert np.array_equal(reading.latest.values[1], fresh.latest.values[0])
    assert not reading.reference[1].any()
    assert reading.reference[[0, 2]].any(axis=1).all()
    other = before
    other.reset([1])
    again = other.read(drive.observation)
    assert np.array_equal(again.latest.values, reading.latest.values)
    assert np.array_equal(state(other), state(drive.reader))
    other.reset()
    assert not state(other).any()
