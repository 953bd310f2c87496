"""The pseudo-kinematic model: circles, signs of slip, order of the integration, refusals."""

import math

import numpy as np
import pytest
from scipy.special import fresnel

from baselines.lyapunov import lyapunov_laws
from baselines.lyapunov.lyapunov_laws import BodyMotion, Geometry, PoseError, PseudoKinematicModel
from baselines.slip.slip_models import NoSlip
from tests.baselines.lyapunov.lyapunov_function import Spiral, pose_error
from tracked_env.physics.parameters import plant_parameters

MAXXII = plant_parameters()._replace(
    track_gauge=0.606, sprocket_radius=0.0856, sprocket_speed_limit=10.0
)


class InnerTrackDrags:
    """Slip of the signs that F measured: the outer track drives, the inner one is dragged."""

    def slip(self, sprocket_left, sprocket_right):
        difference = sprocket_right - sprocket_left
        beta = 0.2 * 0.0856 * difference
        return -beta, beta, -0.35 * np.tanh(difference / 8.0)


def test_without_slip_it_is_a_unicycle_on_its_circle():
    model, sprockets = PseudoKinematicModel(MAXXII), np.array([[3.0, 5.0]])
    (speed, turn), alpha = model.motion(sprockets)[0][0], model.motion(sprockets)[1]
    assert (speed, turn) == pytest.approx((0.0856 * 4.0, 0.0856 * 2.0 / 0.606))
    assert alpha == 0.0
    pose = np.zeros((1, 3))
    for _ in range(200):
        pose = model.step(pose, sprockets, 0.05)
    angle, radius = turn * 10.0, speed / turn
    expected = [radius * math.sin(angle), radius * (1.0 - math.cos(angle)), angle]
    assert pose[0] == pytest.approx(expected, abs=1e-9)


def test_the_centre_of_rotation_moves_forward_and_the_turn_gets_wider_with_slip():
    sprockets = np.array([[3.0, 5.0]])
    slipping = PseudoKinematicModel(MAXXII, InnerTrackDrags())
    (speed, turn), alpha = slipping.motion(sprockets)[0][0], slipping.motion(sprockets)[1][0]
    ideal = PseudoKinematicModel(MAXXII).motion(sprockets)[0][0]
    assert turn == pytest.approx(0.6 * ideal[1])
    assert speed == pytest.approx(ideal[0])
    assert alpha < 0.0  # a left turn: the lateral velocity points to the right
    assert -speed * math.tan(alpha) / turn > 0.0  # x_icr = -v_y / w
    v_x, v_y = lyapunov_laws.pose_rate(0.0, speed, alpha)
    assert v_x == pytest.approx(speed)
    assert math.atan(v_y / v_x) == pytest.approx(alpha)


def test_reverse_driving_mirrors_forward_driving():
    model = PseudoKinematicModel(MAXXII, InnerTrackDrags())
    sprockets = np.random.default_rng(0).uniform(-9.0, 9.0, (50, 2))
    there = model.step(np.zeros((50, 3)), sprockets, 0.3)
    back = model.step(there, -sprockets, 0.3)
    forward, backward = model.motion(sprockets)[0], model.motion(-sprockets)[0]
    assert np.array_equal(forward, -backward)
    assert back[:, 2] == pytest.approx(0.0, abs=1e-15)
    mirrored = model.step(np.zeros((50, 3)), sprockets[:, ::-1], 0.3)
    assert np.array_equal(mirrored, there * [1.0, -1.0, -1.0])


def test_the_integration_is_of_fourth_order():
    motion, errors = BodyMotion(1.0, 2.0), []
    for steps in (4, 8, 16):
        x = y = yaw = 0.0
        for _ in range(steps):
            x, y, yaw = lyapunov_laws.pose_step(x, y, yaw, motion, 0.2, 1.0 / steps)
        cosine = math.cos(0.2)
        exact_x = (math.sin(2.2) - math.sin(0.2)) / (2.0 * cosine)
        exact_y = (math.cos(0.2) - math.cos(2.2)) / (2.0 * cosine)
        errors.append(math.hypot(x - exact_x, y - exact_y))
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.05)


def test_the_spiral_is_the_clothoid_of_its_yaw_rate():
    spiral, pose = Spiral(), np.zeros(3)
    for k in range(2000):
        pose = spiral.advance(pose, k * 0.01, 0.01)
    length = math.sqrt(math.pi / spiral.yaw_acceleration)
    s, c = fresnel(20.0 / length)
    assert pose == pytest.approx([0.3 * length * c, 0.3 * length * s, 10.0], abs=1e-9)
    assert spiral.yaw_rate(20.0) == pytest.approx(1.0)
    fastest = (0.3 + 1.0 * 0.303) / 0.0856
    assert fastest < 10.0  # [rad/s] within the speeds at which F identified the slip


def test_the_error_is_in_body_axes_and_carried_along_with_both_motions():
    error = pose_error(1.0, 3.0, 0.5 * math.pi, 1.0, 1.0, 0.0)
    assert tuple(error) == pytest.approx((2.0, 0.0, 0.5 * math.pi))
    speed, turn, v_x, v_y, w, h = 0.3, 0.4, 0.25, -0.04, -0.5, 1e-2
    pose, reference = (0.2, -0.1, 0.4), (0.0, 0.1, 0.1)
    start = pose_error(*pose, *reference)
    after = pose_error(
        *lyapunov_laws.pose_step(*pose, BodyMotion(v_x, w), math.atan(v_y / v_x), h),
        *lyapunov_laws.pose_step(*reference, BodyMotion(speed, turn), 0.0, h),
    )
    carried = lyapunov_laws.carried(start, v_x, v_y, w, speed, turn, h)
    assert tuple(carried) == pytest.approx(tuple(after), abs=1e-7)
    assert not np.allclose(carried, start, atol=1e-4)
    assert lyapunov_laws.carried(start, v_x, v_y, w, speed, turn, 0.0) == PoseError(*start)


def test_the_gain_is_one_without_noise_and_the_root_of_its_riccati_equation_with_it():
    assert lyapunov_laws.steady_gain(0.0, 0.03, 0.0, 0.02) == 1.0
    gain = lyapunov_laws.steady_gain(0.02, 0.03, 0.05, 0.02)
    grown = (0.03 * 0.02) ** 2 + 0.05**2 * 0.02
    variance = gain * 0.02**2  # after a sample; before the next one it has grown
    assert (variance + grown) / (variance + grown + 0.02**2) == pytest.approx(gain, rel=1e-12)
    assert 0.0 < lyapunov_laws.steady_gain(0.02, 0.03, 0.0, 0.02) < gain


def test_the_slip_angle_is_bounded_and_fades_out_at_standstill():
    slow, most = lyapunov_laws.SLOW, lyapunov_laws.MAXIMUM_SLIP_ANGLE
    assert lyapunov_laws.faded(0.2, slow) == lyapunov_laws.faded(0.2, -1.0) == 0.2
    assert lyapunov_laws.faded(-1.5, 1.0) == -most
    assert lyapunov_laws.faded(1.5, 0.0) == lyapunov_laws.faded(math.nan, 1.0) == 0.0
    values = [lyapunov_laws.faded(0.2, speed) for speed in np.linspace(0.0, 0.1, 1001)]
    assert 0.0 < np.diff(values).max() < 1e-3
    assert np.diff(values).min() >= 0.0
    assert np.diff(values)[[0, 499]].max() < 2e-5  # no kink at 0, none at SLOW


def test_on_the_path_the_vehicle_drives_what_the_law_demands_at_rest():
    reference, alpha = np.array([[0.3, 0.5]]), np.array([-0.3])
    motion = np.empty((1, 2))
    lyapunov_laws.along_slip(reference, alpha, np.array([0.1]), motion)
    slip, gains = lyapunov_laws.Slip(-0.3, -0.3, 0.1), lyapunov_laws.LyapunovGains()
    rest = lyapunov_laws.slippage_aware_law(PoseError(0.0, 0.0, 0.3), 0.3, 0.5, slip, gains)
    assert tuple(motion[0]) == pytest.approx(tuple(rest), abs=1e-15)


def test_parameters_may_differ_from_vehicle_to_vehicle():
    several = MAXXII._replace(track_gauge=np.array([0.606, 1.2]))
    sprockets = np.array([[3.0, 5.0], [3.0, 5.0]])
    motion = PseudoKinematicModel(several).motion(sprockets)[0]
    assert motion[0, 1] / motion[1, 1] == pytest.approx(1.2 / 0.606)
    assert all((value == 0.0).all() for value in NoSlip().slip(sprockets[0], sprockets[1]))


def of_lengths(**lengths):
    return Geometry.of(MAXXII._replace(**{name: np.full(n, 0.3) for name, n in lengths.items()}))


WRONG = {
    r"track_gauge = 606\.0 m.*millimetres": lambda: Geometry.of(MAXXII._replace(track_gauge=606.0)),
    "sprocket_radius = nan": lambda: Geometry.of(MAXXII._replace(sprocket_radius=math.nan)),
    r"parameters for \[2, 3\] vehicles": lambda: of_lengths(track_gauge=2, sprocket_radius=3),
    "3 observations but parameters of 2": lambda: PseudoKinematicModel(
        MAXXII._replace(track_gauge=np.full(2, 0.6))
    ).motion(np.zeros((3, 2))),
    "duration = 0": lambda: PseudoKinematicModel(MAXXII).step(*np.zeros((2, 1, 2)), 0.0),
    "duration = nan": lambda: PseudoKinematicModel(MAXXII).step(*np.zeros((2, 1, 2)), math.nan),
}


@pytest.mark.parametrize("message", WRONG)
def test_what_makes_no_sense_is_refused_with_its_reason(message):
    with pytest.raises(ValueError, match=message):
        WRONG[message]()
