"""Strawa et al. (2021), sections 8.1 and 8.2, run again: what must come out."""

from types import SimpleNamespace

import numpy as np
import pytest

from reproduce.strawa2021.control import SCENARIOS, SETTLED, run
from reproduce.strawa2021.page import control_rows


@pytest.mark.parametrize("path", ["circle", "straight"])
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_with_exact_parameters_the_error_vanishes_and_every_state_is_steady(path, factor):
    result = run(SCENARIOS["exact"], path, factor, duration=40.0)
    assert result.error[0] > 0.9
    late = result.time >= SETTLED
    assert result.error[late].max() < 1e-6
    for name, unit in (("v_x", 1e-6), ("v_y", 1e-6), ("yaw_rate", 1e-6), ("slip_left", 1e-6),
                       ("slip_right", 1e-6), ("sprocket_speed_left", 1e-5),
                       ("effort_left", 0.1), ("effort_right", 0.1)):  # fmt: skip
        assert np.ptp(result.truth[name][late]) < unit, name


def test_wrong_mass_and_inertia_leave_the_steady_offset_of_about_1_4_m():
    result = run(SCENARIOS["mass-inertia"], "circle", 2.0, duration=40.0)
    assert result.settled_rms == pytest.approx(1.4, abs=0.05)
    late = result.error[result.time >= SETTLED]
    assert np.ptp(late) < 1e-3


def test_resistance_maps_keep_the_error_moving_at_a_third_of_a_metre():
    result = run(SCENARIOS["resistance-maps"], "circle", 2.0)
    assert 0.3 < result.settled_rms < 0.45
    assert result.settled_max < 1.0


def test_the_paper_s_lost_vehicle_on_sandy_loam_follows_from_the_printed_factor_only():
    printed = run(SCENARIOS["sandy-loam"], "circle", 2.0, duration=40.0)
    integral = run(SCENARIOS["sandy-loam"], "circle", 1.0, duration=40.0)
    assert printed.settled_rms > 2.0
    assert np.abs(printed.truth["slip_right"]).max() > 0.99
    assert integral.settled_max < 1e-6
    assert np.abs(integral.truth["slip_right"][100:]).max() < 0.05


def test_the_table_has_one_line_per_run():
    result = run(SCENARIOS["exact"], "circle", 1.0, duration=2.0)
    (line,) = control_rows(SimpleNamespace(control={("exact", "circle", 1.0): result}))
    assert len(line) == 8 and line[3] == "1" and line[4] == "nan"
