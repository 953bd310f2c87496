"""The distributed plant against sweeps that Focchi et al. published with their code.

Excerpts of github.com/mfocchi/robot_control, base_controllers/tracked_robot/regressor: columns
sprocket left, right [rad/s], beta_left, beta_right [m/s], alpha [rad]. Their law multiplies the
shear displacement by the belt speed, which changes K and hardly the steady slip.
"""

import numpy as np
import pytest

from baselines.slip.slip_sweep import slip_data, steady_motion
from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025.control import vehicle

# ident_wheels_sim_2d_0.1.csv: mu = 0.1, sprockets within 10 rad/s.
SLIPPERY = np.array(
    [
        (4.838710, 9.354839, -0.036189, 0.044795, -0.096468),
        (4.838710, 8.064516, -0.029354, 0.031327, -0.047363),
        (4.838710, 6.774194, -0.018323, 0.018541, -0.015733),
        (4.838710, 3.548387, 0.012191, -0.012164, 0.004821),
        (4.838710, 2.258065, 0.025039, -0.024663, 0.027503),
        (4.838710, 0.967742, 0.038212, -0.036720, 0.064622),
        (4.838710, -0.322581, 0.051869, -0.048375, 0.116829),
        (4.838710, -1.612903, 0.066024, -0.060016, 0.181415),
        (8.064516, 6.129032, 0.018480, -0.018208, 0.016253),
        (8.064516, 4.193548, 0.038003, -0.034353, 0.068148),
        (8.064516, 2.258065, 0.060988, -0.045714, 0.153648),
        (8.064516, 0.322581, 0.090093, -0.052492, 0.274089),
        (8.064516, -1.612903, 0.125652, -0.059490, 0.404373),
        (8.064516, -3.548387, 0.157838, -0.071930, 0.553341),
    ]
)
# data2d/csv/ident_wheels_sim_0.4_WLmax_18.csv: mu = 0.4, sprockets within 18 rad/s.
FIRM = np.array(
    [
        (10.174, 18.0, -0.038108, 0.043812, -0.068941),
        (10.174, 14.87, -0.024973, 0.025774, -0.025896),
        (10.174, 11.739, -0.009513, 0.009529, -0.002345),
        (10.174, 7.0435, 0.017018, -0.016901, 0.011127),
        (10.174, 3.913, 0.035020, -0.033750, 0.043341),
        (10.174, 0.78261, 0.053982, -0.049450, 0.095286),
        (10.174, -2.3478, 0.074282, -0.064653, 0.163320),
        (10.174, -5.4783, 0.094300, -0.080724, 0.249140),
        (10.174, -8.6087, 0.110000, -0.101080, 0.345690),
        (13.304, 16.435, -0.016664, 0.016882, -0.012390),
        (13.304, 8.6087, 0.025884, -0.025218, 0.025481),
        (13.304, 2.3478, 0.065013, -0.053539, 0.128780),
        (13.304, -3.913, 0.114940, -0.075251, 0.302330),
        (13.304, -10.174, 0.152760, -0.113240, 0.519770),
    ]
)
SWEEPS = {0.1: SLIPPERY, 0.4: FIRM}


def agreement(friction, length, resistance):
    """(R^2, published over ours) of beta_left, beta_right, alpha."""
    left, right, *published = SWEEPS[friction].T
    parameters = vehicle(length, friction, resistance)
    ours = slip_data(parameters, left, right, steady_motion(parameters, left, right))
    columns = list(zip((ours.beta_left, ours.beta_right, ours.alpha), published, strict=True))
    scores = [1.0 - np.sum((q - p) ** 2) / np.sum((q - q.mean()) ** 2) for p, q in columns]
    return np.array(scores), np.array([(p @ q) / (p @ p) for p, q in columns])


@pytest.mark.parametrize(("friction", "length"), [(0.1, 0.7), (0.4, 0.5)])
def test_a_published_sweep_is_that_of_one_length_without_rolling_resistance(friction, length):
    score, slope = agreement(friction, length, 0.0)
    assert score[:2].min() > 0.998 and score[2] > 0.98
    assert slope == pytest.approx(1.0, abs=0.06) and slope[:2] == pytest.approx(1.0, abs=0.03)
    other = 1.2 - length
    assert agreement(friction, other, 0.0)[0][:2].max() < 0.75
    assert agreement(friction, length, 0.025)[0][:2].max() < 0.98


def test_with_rolling_resistance_both_tracks_slip_forward_where_the_path_is_nearly_straight():
    for resistance, agree in ((0.025, True), (0.0, False)):
        parameters = vehicle(0.7, 0.1, resistance)
        left, right = np.array([9.95]), np.array([10.0])
        found = slip_data(parameters, left, right, steady_motion(parameters, left, right))
        assert (found.beta_left[0] * found.beta_right[0] > 0.0) == agree


def test_the_published_grid_has_thirty_two_speeds_and_none_at_standstill():
    speeds = np.linspace(-10.0, 10.0, 32)
    assert all(np.abs(speeds - one).min() < 1e-5 for one in SLIPPERY[:, :2].ravel())
    assert np.abs(speeds).min() > 0.3 and round(float(speeds[1] - speeds[0]), 2) == ident.STEP
