"""The ground at a place: the same soil as under the centre of mass, and any surface."""

import numpy as np
import pytest

from tracked_env.physics.parameters import SoilParameters
from tracked_env.terrain.ground import Terrain
from tracked_env.vector_env import TrackedVehicleVectorEnv


def terrain_of(simulation, i):
    batch = simulation.batch
    time = (batch.counter("step")[i] - 1) * simulation.solver.control_period
    return Terrain(batch.floats, batch.events, i, int(batch.counter("event_count")[i]), time)


@pytest.mark.parametrize("law", ["resistance-map", "terrain-transition", "drift", "mixed"])
def test_the_soil_at_the_centre_of_mass_is_the_soil_in_force_bit_for_bit(law):
    env = TrackedVehicleVectorEnv(8, uncertainty=law, error_limit=1e6)
    env.reset(seed=0)
    batch, moved = env.simulation.batch, 0
    for _ in range(600):
        places = batch.state()[:, :2].copy()  # where the step begins
        env.step(np.full((8, 2), 0.6, np.float32))
    for i in range(8):
        under = terrain_of(env.simulation, i).at(*places[i])
        truth = [batch.column(name)[i] for name in SoilParameters._fields]
        assert list(under) == truth
        start = batch.base()[i, 10:15]
        moved += not np.array_equal(start, truth)
    assert moved > 0, "no soil has changed"


def test_soil_differs_from_place_to_place():
    env = TrackedVehicleVectorEnv(1, uncertainty="nominal")
    line = {"parameter": "cohesion", "kind": "line", "target": 1e3}
    line |= {"x": 0.0, "y": 0.0, "direction": 0.0, "edge": 1.0}
    env.reset(seed=0, options={"schedule": [line]})
    ground = terrain_of(env.simulation, 0)
    assert ground.at(-5.0, 3.0).cohesion == 70e3
    assert ground.at(5.0, 3.0).cohesion == 1e3
    assert ground.at(0.0, -9.0).cohesion == pytest.approx(0.5 * 71e3)
    assert ground.at(5.0, 3.0).friction_angle == ground.at(-5.0, 3.0).friction_angle
