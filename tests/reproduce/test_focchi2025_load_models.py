"""Focchi et al. (2025), 8.1, 8.2, the grounds of section 8; printed equations of 2.2 and 5.3."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baselines.lyapunov.lyapunov_laws import LyapunovGains, PoseError
from reproduce.focchi2025 import claims, slopes
from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025.control import vehicle
from tests.baselines.lyapunov.lyapunov_function import unicycle_law
from tracked_env.physics.rigid_body import in_body_plane
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.plants.standalone import TerrainRig

MAP_SLOPES = (0.0277, 0.2788, 0.5300)  # [-] median, 90 %, 99 % of the authors' map


@pytest.fixture
def mapped(reference_data):
    """The authors' map, or a skip that names the file."""
    ground, missing = slopes.authors_map(reference_data / "terrain_mesh" / "height_5cm.npz")
    if ground is None:
        pytest.skip(missing)
    return ground


def test_the_seeded_field_has_the_slopes_of_the_authors_map():
    np.testing.assert_allclose(slopes.steepness(slopes.field()), MAP_SLOPES, rtol=0.02)


def test_the_authors_map_has_the_slopes_that_the_seeded_field_is_fitted_to(mapped):
    np.testing.assert_allclose(slopes.steepness(mapped), MAP_SLOPES, rtol=0.001)


def test_a_vehicle_starts_on_a_flank_of_both_grounds(mapped):
    for one in (mapped, slopes.field()):
        _, slope_x, slope_y = one.field.at(*one.start)
        assert 0.18 < slope_x < 0.25 and abs(slope_y) < 0.06


@pytest.mark.slow
def test_without_the_map_its_file_is_named_and_the_seeded_field_is_run(tmp_path, monkeypatch):
    for module in (loads, slopes):
        monkeypatch.setattr(module, "DURATION", 0.5)
    monkeypatch.setattr(slopes, "RATE", 50.0)
    monkeypatch.setattr(slopes, "SPEED_STEP", 6.0)
    monkeypatch.setattr(slopes, "PROBES", 40)
    lines = []
    results = slopes.run_all(lines.append, tmp_path / "gone.npz")
    assert "gone.npz" in lines[0] and "left out" in lines[0] and results.missing == lines[0]
    assert [one.name for one in results.grounds] == ["seeded field"]
    outcomes = claims.load_claims(results)
    assert not any(outcome.values.get("ground") == "authors' map" for outcome in outcomes)


@pytest.mark.parametrize(("name", "rate"), [("Table 2", 425.0), ("as 8.1 prints", 4250.0)])
def test_roll_decays_at_the_rate_of_the_closed_form(name, rate):
    damping = loads.DAMPING[name]
    assert loads.roll_decay(damping) == pytest.approx(rate, rel=1e-3)
    assert loads.measured_roll_decay(damping) == pytest.approx(rate, rel=0.005)


def test_the_damping_of_8_1_is_too_large_for_its_explicit_steps_and_that_of_table_2_is_not():
    amplified = {name: abs(1.0 - 1e-3 * loads.roll_decay(d)) for name, d in loads.DAMPING.items()}
    assert amplified["as 8.1 prints"] > 3.0 and amplified["Table 2"] < 1.0


def test_across_a_slope_the_lower_track_is_loaded_by_the_moment_of_the_shear_forces():
    plant, closed = loads.load_on_a_side_slope(0.25)
    assert plant == pytest.approx(closed, rel=0.002) and plant > 0.2


def test_the_printed_pair_gives_53_9_kn_per_m_and_5_5_with_half_a_metre_the_printed_23():
    printed, fits = (loads.foremost(*loads.PAIRS[name], 1.4) for name in ("printed", "fits"))
    assert printed == pytest.approx(5e3 * (1.0 + 10.5 * 1.4 * 0.665))
    assert fits == pytest.approx(5e3 * (1.0 + 5.5 * 1.4 * 0.475))
    assert fits == pytest.approx(loads.PRINTED_STIFFNESS, rel=0.02)
    assert printed > 2.3 * loads.PRINTED_STIFFNESS


@pytest.mark.parametrize("reading", loads.PER_AREA)
@pytest.mark.parametrize("pair", loads.PAIRS)
def test_a_vehicle_on_stiffening_ground_pitches_until_force_and_moment_balance(pair, reading):
    run = loads.stiffen(*loads.PAIRS[pair], loads.PER_AREA[reading])
    assert run.held == pytest.approx(run.equilibrium, rel=0.005)
    assert run.held < -0.01 and run.pitch[0] == pytest.approx(0.0, abs=1e-3)
    assert run.raised == ((pair, reading) == ("fits", "per track"))
    if not run.raised:
        closed = loads.foremost(*loads.PAIRS[pair], 1.4)
        assert run.stiffness.max() == pytest.approx(closed, rel=0.005)


def test_the_belts_of_the_open_loop_are_those_of_a_unicycle_beyond_any_limit():
    parameters = vehicle()
    left, right = loads.belts(parameters, np.array([1.6]), np.array([0.6]))[0]
    radius, gauge = parameters.sprocket_radius, parameters.track_gauge
    assert 0.5 * radius * (left + right) == pytest.approx(1.6)
    assert radius * (right - left) / gauge == pytest.approx(0.6)
    assert left > parameters.sprocket_speed_limit


def test_uniform_load_ends_metres_beside_nonuniform_load_on_the_authors_map(mapped):
    starts = [(*mapped.start, 0.0)]
    runs = [loads.drive(mapped.field, load, starts, "linear") for load in loads.LOADS]
    assert loads.length(runs[0])[0] == pytest.approx(claims.PRINTED_LENGTH, abs=0.1)
    assert loads.gap(*runs)[0] == pytest.approx(3.68, abs=0.1)


def test_on_level_ground_the_load_models_drive_the_same_path_to_a_few_centimetres():
    runs = [loads.drive("flat", load, [(0.0, 0.0, 0.0)], "(53)") for load in loads.LOADS]
    assert loads.gap(*runs)[0] < 0.1
    assert not runs[1].saturated.any()


ANGLE, SPEED = math.radians(20.0), 0.5  # [rad], [m/s]


def test_the_printed_damper_lifts_a_vehicle_that_drives_downhill():
    weight = vehicle().mass * GRAVITY
    vertical = -SPEED * math.sin(ANGLE)  # z . p' of (17) for motion along the ground
    lift = -2.0 * loads.DAMPING["Table 2"] * vertical  # (18), both tracks
    assert lift == pytest.approx(1.71e3, rel=0.01) and lift > 2.0 * weight
    parameters = vehicle(friction=loads.FRICTION)
    rig = TerrainRig(parameters, {"terrain": {"kind": "plane", "slope_x": -math.tan(ANGLE)}})
    rig.stand(0.0, 0.0, 0.0)
    rig.advance([[SPEED / parameters.sprocket_radius] * 2], 4.0)
    assert rig.load[0] == pytest.approx(weight * math.cos(ANGLE), rel=1e-4)


@pytest.mark.parametrize("yaw", [0.5, 1.5, -2.0])
def test_a_tilt_taken_from_the_rotation_vector_is_turned_by_half_the_yaw(yaw):
    tilt = np.array([0.0, 1e-4, 0.0])  # of the ground, which (15) gives no yaw
    ground, body = Rotation.from_rotvec(tilt), Rotation.from_euler("z", yaw)
    error = (ground * body.inv()).as_rotvec()[:2]
    turned = math.remainder(math.atan2(error[1], error[0]) - 0.5 * math.pi, 2.0 * math.pi)
    assert turned == pytest.approx(0.5 * yaw, abs=1e-3)
    assert np.hypot(*error) == pytest.approx(1e-4 * 0.5 * yaw / math.sin(0.5 * yaw), rel=1e-3)


def printed_speed(error, yaw, gains):
    """delta_v of (42) with the error of (49): rotated by the yaw, then with the yaw once more."""
    x, y = Rotation.from_euler("z", yaw).inv().apply([*error, 0.0])[:2]
    return -gains.k_p * math.hypot(x, y) * math.cos(math.atan2(y, x) - yaw)


@pytest.mark.parametrize("yaw", [0.0, 1.0, math.pi])
def test_the_printed_error_in_the_body_depends_on_where_north_is(yaw):
    gains = LyapunovGains()
    behind = (-0.1 * math.cos(yaw), -0.1 * math.sin(yaw))  # vehicle less reference
    level = ((1.0, 0.0), (1.0, 0.0))
    ahead, left, turn = in_body_plane.py_func(0.1, 0.0, 0.0, *level)
    right = unicycle_law(PoseError(-ahead, -left, -turn), 0.0, 0.0, gains)
    assert right.speed == pytest.approx(0.1 * gains.k_p)
    assert printed_speed(behind, yaw, gains) == pytest.approx(right.speed * math.cos(yaw))
