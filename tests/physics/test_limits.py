"""What the plants leave out, recomputed by `limits`, and the pages that show its tables."""

import math

import numpy as np
import pytest

from tests.physics import limits
from tests.physics.limits import TURN_SOILS, VEHICLE, ground
from tracked_env import arrays as b
from tracked_env.engine.env_config import EnvConfig
from tracked_env.engine.simulation import Simulation
from tracked_env.physics import parameters as s
from tracked_env.physics.lumped import drive_limits
from tracked_env.physics.parameters import RANGES
from tracked_env.physics.terramechanics import GRAVITY

WEIGHT = VEHICLE.mass * GRAVITY


@pytest.fixture(scope="module")
def turns():
    return limits.turns_table()


def test_the_pages_show_the_tables_that_are_computed(repository, turns):
    assert "1.2 cm on dry sand" in limits.limits_table()
    assert limits.limits_table() in (repository / "docs/physics.md").read_text()
    assert turns in (repository / "docs/distributed.md").read_text()


def test_locked_tracks_keep_all_lateral_friction_in_the_lumped_plant_alone():
    lumped, isotropic, distributed = limits.locked_lateral_forces()
    assert lumped == pytest.approx(VEHICLE.lateral_resistance * WEIGHT, rel=0.01)
    assert lumped == pytest.approx(11.3e3, rel=0.01)
    assert isotropic == pytest.approx(lumped / 30.0, rel=0.01)
    # Full sliding friction of both tracks against the velocity: 2 F_max u / |v|.
    strength = 2.0 * drive_limits(VEHICLE).effort_maximum
    assert distributed == pytest.approx(strength * 0.1 / math.hypot(3.0, 0.1), rel=1e-3)


def test_lateral_shear_takes_a_third_of_the_turning_moment_of_the_distributed_plant():
    derived = limits.moment_left_by_shear()
    assert derived == pytest.approx(1.0 - (1.0 - math.exp(-2.5)) / 2.5, rel=1e-12)
    assert limits.measured_moment_left_by_shear() == pytest.approx(derived, abs=0.04)
    slipping = [limits.measured_moment_left_by_shear(slip=i) for i in (0.02, 0.05, 0.1)]
    assert min(slipping[:2]) > 0.6 and max(slipping[:2]) < 0.71
    assert slipping[2] < 0.5  # the force has turned along the track
    stiff = VEHICLE._replace(shear_deformation_modulus=2e-4)
    assert limits.measured_moment_left_by_shear(stiff) == pytest.approx(1.0, abs=0.01)


def test_the_icr_moves_forward_with_the_load_and_agrees_with_the_plant_without_transfer():
    assert limits.icr_of_load_transfer(braking=0.0) == pytest.approx(
        3.0**2 / 10.0 * 2.0 / (2.0 * 0.8 * GRAVITY), rel=1e-9
    )
    assert limits.icr_of_load_transfer() == pytest.approx(0.32, abs=0.01)
    # A density p(x) = (1 + 12 x_p x / l^2) / l, integrated numerically.
    x_icr, shift = limits.icr_of_load_transfer(), 0.5 * 3.0 / GRAVITY
    x = np.linspace(-1.0, 1.0, 200001)
    density = 0.5 * (1.0 + 3.0 * shift * x)
    force = np.trapezoid(density * np.where(x < x_icr, 1.0, -1.0), x)
    assert 0.8 * GRAVITY * force == pytest.approx(0.9, abs=1e-3)


def test_drives_with_inertia_slow_the_distributed_plant_by_their_share_of_the_mass():
    def gained(plant):
        config = EnvConfig(
            uncertainty={"longitudinal_resistance": [0.0, 0.0], "drive_time_constant": [0.0, 0.0]},
            sensors="ideal",
            reference="straight",
            error_limit=1e6,
            plant=plant,
        )
        simulation = Simulation(1, config)
        simulation.rngs = [np.random.default_rng(0)]
        start = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0, "speed": 1.0}
        simulation.reset(simulation.all, [{"start": start}])
        for _ in range(50):
            simulation.step(np.full((1, 2), 0.1, np.float32))
        return simulation.batch.floats[0, b.STATE + s.V_X] - 1.0

    ratio = gained("lumped") / gained("distributed")
    share = limits.ROTATING_SHARE
    assert share == pytest.approx(0.153, abs=0.001)
    assert ratio == pytest.approx(1.0 + share, rel=0.02)


def test_the_turn_of_the_distributed_plant_on_clay_takes_six_times_the_moment_of_the_lumped():
    moment, icr = limits.steady_turn(VEHICLE, 10.0)
    lumped = limits.lumped_moment(VEHICLE, 10.0)
    assert moment == pytest.approx(34.9e3, rel=0.01)
    assert lumped == pytest.approx(0.25 * 0.8 * WEIGHT * 2.0, rel=0.02)
    assert 6.0 < moment / lumped < 6.5
    assert icr == pytest.approx(-0.076, abs=0.005)


@pytest.mark.parametrize("soil", TURN_SOILS)
def test_no_single_lateral_resistance_makes_the_plants_agree(soil):
    p = ground(soil, TURN_SOILS[soil])
    matches = [limits.matching_resistance(p, radius) for radius in limits.RADII]
    assert np.all(np.diff(matches) < 0.0), matches
    assert matches[0] / matches[-1] > 1.5
    for mu, radius in zip(matches, limits.RADII, strict=True):
        matched = limits.lumped_moment(p._replace(lateral_resistance=mu), radius)
        assert matched == pytest.approx(limits.steady_turn(p, radius)[0], rel=1e-9)
    assert (min(matches) > RANGES["lateral_resistance"].high) == (soil == "heavy_clay")


def test_a_turn_that_the_soil_does_not_carry_has_no_moment():
    with pytest.raises(ValueError, match="no steady turn of radius 5 m"):
        limits.steady_turn(ground("dry_sand", 0.6), 5.0)
