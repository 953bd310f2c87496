"""The plant seam: what a plant says of itself is true, and nothing else knows a plant."""

import ast
import math

import numpy as np
import pytest

from tests.driving import STILL, make, run
from tests.processes import python
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.physics.level_motion import hold_speeds
from tracked_env.physics.parameters import VEHICLES
from tracked_env.physics.patches_on_level_ground import make_patches
from tracked_env.plants import SHIPPED
from tracked_env.plants.standalone import Rig, TerrainRig
from tracked_env.vector_env import TrackedVehicleVectorEnv

NO_NAMES = {"distributed", "lumped", "constrained", "by_torque"}
# Files that may write a plant's name: defaults of ids and arguments, and the evaluation sets.
DEFAULTS = (
    "__init__.py",
    "env.py",
    "vector_env.py",
    "engine/env_config.py",
    "benchmark/set_catalogue.py",
    "cli/evaluate_options.py",
    "cli/evaluate_command.py",
    "cli/vehicle_commands.py",  # a layout of matplotlib
    "identify/commands.py",
)


def names_of_plants(path):
    """Identifiers and compared strings of a file that name a plant or what only one plant has."""
    tree = ast.parse(path.read_text())
    result = []
    for node in ast.walk(tree):
        named = getattr(node, "id", None) or getattr(node, "attr", None) or getattr(node, "arg", "")
        if named in NO_NAMES - {"lumped"}:  # `physics.lumped` is no plant
            result.append((node.lineno, named))
        if isinstance(node, ast.Constant) and node.value in NO_NAMES:
            result.append((node.lineno, repr(node.value)))
    return result


def test_no_other_part_of_the_package_knows_a_plant_by_name(repository):
    package = repository / "tracked_env"
    assert names_of_plants(package / "plants/lumped_block.py"), "the search finds nothing"
    places = []
    for path in sorted(package.rglob("*.py")):
        part = path.relative_to(package).as_posix()
        if part.startswith(("plants/", "physics/")):
            continue
        for line, name in names_of_plants(path):
            if part not in DEFAULTS or not name.startswith("'"):
                places.append(f"{part}:{line} {name}")
    assert places == []


@pytest.mark.slow
def test_a_new_process_finds_the_kernels_in_the_cache():
    code = (
        "import numpy as np, tracked_env\n"
        "from tracked_env.plants import distributed, lumped_block as lumped\n"
        "from tracked_env.vector_env import TrackedVehicleVectorEnv\n"
        "kernels = {'lumped': lumped.advance_sliding, 'distributed': distributed.advance}\n"
        "for plant, kernel in kernels.items():\n"
        "    env = TrackedVehicleVectorEnv(1, plant=plant)\n"
        "    env.reset(seed=0); env.step(np.zeros((1, 2), np.float32))\n"
        "    hits, misses = kernel.stats.cache_hits, kernel.stats.cache_misses\n"
        "    print(sum(hits.values()), sum(misses.values()))\n"
    )

    python("-c", code)  # fills the cache
    assert python("-c", code).stdout.split() == ["1", "0", "1", "0"]


def test_the_plant_alone_moves_as_the_environment_does():
    # 0.25 is exact in single precision, so both are given the same torque.
    env = TrackedVehicleVectorEnv(1, uncertainty="nominal", reference="straight", error_limit=1e3)
    env.reset(seed=0, options={"start": STILL})
    rig = Rig("lumped", VEHICLES["strawa"])
    rig.states[:] = env.simulation.batch.state()
    limit = VEHICLES["strawa"].torque_limit
    for _ in range(50):
        env.step(np.array([[0.25, 0.5]], np.float32))
        rig.advance(np.array([[0.25, 0.5]]) * limit, 0.02)
    assert np.abs(rig.state.v_x).min() > 0.1
    assert rig.states == pytest.approx(env.simulation.batch.state(), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("integrator", ["rosenbrock", "euler"])
def test_the_plant_alone_on_patches_is_hold_speeds_bit_for_bit(integrator):
    p, draws = VEHICLES["focchi"], np.random.default_rng(0)
    rig = Rig("distributed", p, 2, "speed", 1e-3, {"integrator": integrator})
    states, loads = np.zeros((2, 6)), np.zeros((2, 6))
    table = np.array([p, p], dtype=float)
    for _ in range(30):
        speeds = draws.uniform(-5.0, 5.0, (2, 2))
        hold_speeds(states, speeds, table, make_patches(), 10, 1e-3, integrator == "euler", loads)
        rig.advance(speeds, 0.01)
    assert np.array_equal(rig.states[:, :6], states)


@pytest.mark.parametrize("commands", [[1.0], [[1.0]], np.zeros(2), [[math.nan, 0.0]]])
def test_commands_of_a_wrong_shape_are_refused(commands):
    for rig in (Rig("lumped", VEHICLES["strawa"]), TerrainRig(VEHICLES["focchi"])):
        with pytest.raises(ValueError, match="must be finite numbers of shape"):
            rig.advance(commands, 0.1)
    with pytest.raises(ValueError, match="needs plant"):
        Rig("lumped", VEHICLES["strawa"], drive="speed")


def braked(plant, soil_at, slippery=None):
    """Yaw [rad] 0.4 s after the belts of a vehicle at 1 m/s stop; slippery: -1 right, 1 left."""
    env = TrackedVehicleVectorEnv(
        1, plant=plant, drive="speed", vehicle="focchi", uncertainty="nominal",
        sensors="ideal", error_limit=1e3, plant_options={"soil_at": soil_at},
        reference={"kind": "straight", "speed": 0.8, "x": 0.0, "y": 0.0, "yaw": 0.0},
    )  # fmt: skip
    line = {"parameter": "friction_angle", "kind": "line", "target": 0.1, "x": 0.0, "y": 0.0,
            "direction": 0.5 * math.pi * (slippery or 0.0), "edge": 0.01}  # fmt: skip
    schedule = [] if slippery is None else [line]
    env.reset(seed=0, options={"start": {**STILL, "speed": 1.0}, "schedule": schedule})
    for _ in range(20):
        env.step(np.zeros((1, 2), np.float32))
    return env.simulation.column("yaw")[0]


@pytest.mark.parametrize(("plant", "parts"), [("distributed", "tracks"), ("terrain", "patches")])
def test_a_braking_vehicle_turns_to_the_side_with_more_grip_where_each_part_has_its_soil(
    plant, parts
):
    left, right = braked(plant, parts, slippery=-1), braked(plant, parts, slippery=1)
    assert left > 0.05, "the right track slides, the left one holds"
    assert right == pytest.approx(-left, rel=1e-6)
    assert abs(braked(plant, "centre", slippery=-1)) < 0.1 * left
    level = braked(plant, parts)
    assert abs(level) < 1e-9 and level == pytest.approx(braked(plant, "centre"), abs=1e-12)


FIELD = [{"kind": "plane", "slope_x": 0.15, "slope_y": 0.1}, {"kind": "hills", "height": 0.3}]
ON_FIELD = {
    "plant": "terrain",
    "plant_options": {"terrain": FIELD},
    "sensors": "ideal",
    "duration": 30.0,
}


@pytest.mark.parametrize(("env_id", "vehicle"), [(SPEED_ID, "focchi"), (TORQUE_ID, "strawa")])
def test_terrain_is_an_option_of_every_environment_which_has_then_the_state_in_space(
    env_id, vehicle
):
    env = make(env_id, **ON_FIELD, vehicle=vehicle, expose_truth=True)
    truth = run(env, 100, np.tile([0.3, 0.35], (100, 1)))[2]["truth"]
    assert env.simulation.solver.prepared.options.reliefs.waves.shape == (1, 2, 4)
    assert abs(truth["roll"]) > 1e-3 and abs(truth["pitch"]) > 1e-3
    assert np.isfinite(list(truth.values())).all()
    rig = TerrainRig(VEHICLES[vehicle], {"terrain": FIELD})
    height = rig.field.at(truth["x"], truth["y"])[0]
    assert truth["z"] == pytest.approx(float(height), abs=0.15)


def test_an_episode_starts_on_the_ground_with_both_tracks_down():
    env = make(SPEED_ID, **ON_FIELD, expose_truth=True)
    options = {"start": {"speed": 0.0, "yaw_rate": 0.0}, "soil": {"friction_angle": 0.7}}
    first = env.reset(seed=3, options=options)[1]["truth"]
    last = run(env, 50, np.zeros((50, 2)), seed=3, options=options)[2]["truth"]
    for name, least in (("z", 0.01), ("roll", 0.04), ("pitch", 0.04), ("x", 0.02)):
        assert last[name] == pytest.approx(first[name], abs=least)


def test_a_file_for_each_plant(repository):
    files = {path.stem for path in (repository / "tracked_env/plants").glob("*.py")}
    assert files == {"__init__", "standalone", *SHIPPED.values()}
