"""Terrains of which every episode draws one, and the soil at a place."""

import json
import pickle

import gymnasium
import numpy as np
import pytest

from tracked_env import TERRAIN, TERRAIN_ID
from tracked_env.arrays import RELIEF_SIZE
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics import patches_on_terrain as g
from tracked_env.physics.parameters import VEHICLES, SoilParameters
from tracked_env.physics.rigid_body import matrix_of, quaternion_of
from tracked_env.physics.terrain_motion import grid_of
from tracked_env.plants.standalone import TerrainRig
from tracked_env.terrain.ground import WAVE_SCRATCH, soil_at
from tracked_env.terrain.height_field import make_height_field
from tracked_env.terrain.pool import fill_patches, make_pool
from tracked_env.vector_env import TrackedVehicleVectorEnv

X, Y = np.meshgrid(np.linspace(-4.0, 4.0, 9), np.linspace(-3.0, 3.0, 7))
FRACTAL = {"kind": "fractal", "seed": 3, "height": 0.05}
DRAWN = {"kind": "drawn", "of": FRACTAL, "count": 4}
MAPS = np.random.default_rng(0).normal(0.0, 0.01, (3, 41, 41))
DRAWN_MAPS = {"kind": "drawn", "of": {"kind": "map", "heights": MAPS, "cell": 0.5}}
ONE_MAP = {"kind": "map", "heights": MAPS[0], "cell": 1}
LISTED = {"kind": "drawn", "terrains": ["hills", {"kind": "ramp", "slope": 0.3}, "crossing"]}
CALM = {"uncertainty": "nominal", "sensors": "ideal", "expose_truth": True}


def make(**arguments):
    return gymnasium.make(TERRAIN_ID, **arguments).unwrapped


def heights_under(env, row=0):
    """Heights at places of the ground that the vehicle of a row drives on."""
    ground, floats = env.simulation.solver.prepared.ground, env.simulation.batch.floats
    return ground.heights(floats, np.array([row]), X.reshape(1, -1), Y.reshape(1, -1))[0]


def expected(terrain):
    return make_height_field(terrain).at(X, Y)[0].ravel()


@pytest.mark.parametrize("patches", [(10, 4), (1, 1), (7, 3), (3, 9), (80, 8)], ids=str)
@pytest.mark.parametrize("drawn", [0, 3])
def test_the_ground_under_the_tracks_is_that_at_the_places_of_their_patches(patches, drawn):
    """By the addition theorem there, one by one here."""
    footing = g.Footing(0.25, 0.35, 0.07 / 40, 1e6, 1e5, 0.0, 0.03, -0.02)
    columns, rows = (np.linspace(-1.0, 1.0, 2 * n + 1)[1::2] for n in patches)
    relief = make_height_field(["hills", {"kind": "fractal", "count": 7}]).relief
    rng = np.random.default_rng(3)
    w, floats = np.zeros((g.SCRATCH_ROWS, g.LANES)), np.zeros((1, RELIEF_SIZE))
    floats[0, :2] = 0.2, -0.1
    floats[0, 2 : 2 + 4 * drawn] = rng.uniform(0.05, 2.0, 4 * drawn)
    extra = {"kind": "waves", "waves": floats[0, 2 : 2 + 4 * drawn].reshape(drawn, 4)}
    plane = {"kind": "plane", "slope_x": 0.2, "slope_y": -0.1}
    field = make_height_field(["hills", {"kind": "fractal", "count": 7}, plane, extra])
    place, r = (3.0, -2.0, 0.3), matrix_of(quaternion_of(*rng.uniform(-1.0, 1.0, 3)))
    lanes = g.place_patches(w, columns, 0.5 * rows, 0.3, 0.1, footing)
    g.locate(w, lanes, place, r, footing.height)
    grid = grid_of(w, place, r, footing.height, *patches)
    fill_patches(((relief, floats, 0, 0), np.full(WAVE_SCRATCH, np.nan)), w, lanes, grid)
    w = w[:, : 2 * patches[0] * patches[1]]
    expected = field.at(w[g.PLACE_X], w[g.PLACE_Y])
    assert np.ptp(expected[0]) > 0.03
    for row, values in zip((g.HEIGHT, g.SLOPE_X, g.SLOPE_Y), expected, strict=True):
        assert w[row] == pytest.approx(values, rel=0.0, abs=1e-14)


def test_the_members_of_a_fractal_have_the_seeds_that_follow():
    pool = make_pool([{"kind": "plane", "slope_x": 0.1}, DRAWN])
    assert len(pool.fields) == 4
    for k, field in enumerate(pool.fields):
        alone = make_height_field([{"kind": "plane", "slope_x": 0.1}, {**FRACTAL, "seed": 3 + k}])
        np.testing.assert_array_equal(field.at(X, Y), alone.at(X, Y))
    assert len(make_pool({"kind": "drawn", "of": "fractal"}).fields) == 16


@pytest.mark.parametrize("spec", [DRAWN, DRAWN_MAPS, LISTED, [DRAWN_MAPS, "hills"]], ids=str)
def test_a_vehicle_drives_on_the_member_that_its_episode_has_drawn(spec):
    fields = make_pool(spec).fields
    env = TrackedVehicleVectorEnv(12, **{**TERRAIN, **CALM, "terrain": spec})
    env.reset(seed=1)
    members = [episode.terrain for episode in env.simulation.episodes]
    assert set(members) == set(range(len(fields)))
    for row, member in enumerate(members):
        heights = heights_under(env, row)
        np.testing.assert_allclose(heights, fields[member].at(X, Y)[0].ravel(), atol=1e-12)
    env.step(np.zeros((12, 2), np.float32))
    states = env.simulation.truth()
    for row, member in enumerate(members):
        under = float(fields[member].at(states["x"][row], states["y"][row])[0])
        assert states["z"][row] == pytest.approx(under, abs=0.05)


def test_every_member_is_drawn_as_often():
    env = TrackedVehicleVectorEnv(2000, **{**TERRAIN, **CALM, "terrain": DRAWN})
    env.reset(seed=0)
    counts = np.bincount([episode.terrain for episode in env.simulation.episodes], minlength=4)
    assert np.abs(counts - 500).max() < 80


def test_an_option_names_the_terrain_and_leaves_all_other_draws_as_they_were():
    plain, named = (make(terrain=DRAWN) for _ in range(2))
    plain.reset(seed=5)
    first = plain.simulation.episodes[0]
    other = (first.terrain + 1) % 4
    named.reset(seed=5, options={"terrain": other})
    episode = named.simulation.episodes[0]
    assert episode.terrain == other
    for name in ("parameters", "noise_seed", "state", "relief"):
        assert getattr(episode, name) == getattr(first, name)
    assert not np.array_equal(heights_under(plain), heights_under(named))
    named.reset(seed=5, options={"terrain": first.terrain})
    np.testing.assert_array_equal(heights_under(plain), heights_under(named))
    again = [env.reset()[0] for env in (plain, named)]
    np.testing.assert_array_equal(*again)


def test_the_argument_is_the_option_of_the_plant():
    named = make(terrain="hills", **CALM)
    spelled = make(plant_options={"terrain": "hills"}, **CALM)
    for env in (named, spelled):
        env.reset(seed=2)
        np.testing.assert_allclose(heights_under(env), expected("hills"), atol=1e-12)
    action = np.float32([0.5, 0.4])
    np.testing.assert_array_equal(named.step(action)[0], spelled.step(action)[0])
    heights = np.random.default_rng(1).normal(0.0, 0.01, (21, 31))
    spec = {"kind": "map", "heights": heights, "cell": 0.5}
    env = make(terrain=spec, **CALM)
    env.reset(seed=0)
    np.testing.assert_allclose(heights_under(env), expected(spec), atol=1e-12)
    level = make(**CALM)
    level.reset(seed=0)
    assert not heights_under(level).any()


def test_a_drawn_terrain_can_be_written_as_json_and_its_environment_pickled():
    listed = {**DRAWN_MAPS["of"], "heights": MAPS.tolist()}
    text = json.dumps({"kind": "drawn", "of": listed})
    read, pool = make_pool(json.loads(text)), make_pool(DRAWN_MAPS)
    for one, other in zip(read.reliefs, pool.reliefs, strict=True):
        np.testing.assert_array_equal(one, other)
    env = TrackedVehicleVectorEnv(3, **{**TERRAIN, "terrain": DRAWN})
    env.reset(seed=0)
    copied = pickle.loads(pickle.dumps(env))
    action = np.full((3, 2), 0.4, np.float32)
    np.testing.assert_array_equal(env.step(action)[0], copied.step(action)[0])


def test_a_rig_stands_on_the_first_terrain():
    rig = TerrainRig(VEHICLES["focchi"], {"terrain": DRAWN})
    np.testing.assert_array_equal(rig.field.at(X, Y), make_height_field(FRACTAL).at(X, Y))


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ({"kind": "drawn"}, "must have either 'of' or 'terrains'"),
        ({"kind": "drawn", "of": "fractal", "terrains": ["hills"]}, "either 'of' or 'terrains'"),
        ({"kind": "drawn", "of": "hills"}, "must have a fractal, or a map"),
        ({"kind": "drawn", "terrains": "hills"}, "terrains = 'hills'; must be a list"),
        ({"kind": "drawn", "terrains": []}, "must be a list of terrains"),
        ({"kind": "drawn", "terrains": ["hills"], "count": 3}, "goes with 'of'"),
        ({"kind": "drawn", "of": "fractal", "count": 0}, "count of drawn terrains = 0.*must be"),
        ({"kind": "drawn", "of": "fractal", "number": 3}, "unknown .*'number'"),
        ({"kind": "drawn", "of": {"kind": "fractal", "seed": "a"}}, "fractal seed = 'a'"),
        ({**DRAWN_MAPS, "count": 4}, "count of drawn terrains = 4 with 3 maps"),
        ([DRAWN, DRAWN], "2 drawn parts; must be one at most"),
        ({"kind": "drawn", "terrains": [DRAWN, "hills"]}, "unknown terrain kind 'drawn'"),
        ({"kind": "drawn", "terrains": ["hills", ONE_MAP]}, "maps of shapes .*of one shape"),
        (MAPS[0], "array of shape .41, 41.*need the distance between them"),
        ("drawn", "must have either 'of' or 'terrains'"),
        (3, "terrain = 3; must be a kind, a dict"),
        ("drwn", "unknown terrain kind 'drwn'.*'crossing', 'drawn',.*Did you mean 'drawn'"),
        (["hills", {"kind": "moon"}], "unknown terrain kind 'moon'.*'drawn'"),
        ({"slope": 0.1}, "unknown terrain kind None.*'drawn'"),
    ],
)
def test_a_wrong_choice_of_terrains_is_refused_in_one_line(spec, says):
    with pytest.raises(ValueError, match=says) as error:
        make(terrain=spec)
    assert "\n" not in str(error.value)


def test_a_terrain_said_twice_or_without_effect_or_out_of_range_is_refused():
    with pytest.raises(ValueError, match="as an argument and in plant_options"):
        make(terrain="hills", plant_options={"terrain": "hills"})
    with pytest.raises(ValueError, match=r'terrain = "hills" with plant = "lumped".*"terrain"'):
        TrackedVehicleEnv(terrain="hills")
    env = make(terrain=DRAWN)
    for wrong in (4, -1, 0.5, "hills"):
        with pytest.raises(ValueError, match=r"options.'terrain'. = .*must be"):
            env.reset(seed=0, options={"terrain": wrong})
    with pytest.raises(ValueError, match="there is only one terrain"):
        make(terrain="hills").reset(seed=0, options={"terrain": 0})


def soil_under(simulation, i, x, y):
    """Soil of vehicle i at the time of its last step."""
    time = (simulation.batch.counter("step")[i] - 1) * simulation.solver.control_period
    return soil_at(simulation.batch, i, time, x, y)


@pytest.mark.parametrize("law", ["resistance-map", "terrain-transition", "drift", "mixed"])
def test_the_soil_at_the_centre_of_mass_is_the_soil_in_force_bit_for_bit(law):
    env = TrackedVehicleVectorEnv(8, uncertainty=law, error_limit=1e6)
    env.reset(seed=0)
    batch, moved = env.simulation.batch, 0
    for _ in range(600):
        places = batch.state()[:, :2].copy()  # where the step begins
        env.step(np.full((8, 2), 0.6, np.float32))
    for i in range(8):
        under = soil_under(env.simulation, i, *places[i])
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
    places = ((-5.0, 3.0), (5.0, 3.0), (0.0, -9.0))
    soils = [soil_under(env.simulation, 0, *place) for place in places]
    assert [soil.cohesion for soil in soils] == [70e3, 1e3, pytest.approx(0.5 * 71e3)]
    assert soils[0].friction_angle == soils[1].friction_angle
