"""One file of a vehicle goes through every command, and so does an id of another project."""

import json
import re
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import tracked_env
from baselines.slip.slip_sweep import steady_motion, with_friction
from tests.processes import python
from tests.test_vehicles import ROBOT
from tracked_env import TORQUE_ID, environment_ids
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.cli.evaluate_options import benchmark_config, parsed
from tracked_env.cli.main import main
from tracked_env.sb3 import make_vec_env
from tracked_env.vector_env import TrackedVehicleVectorEnv
from tracked_env.vehicles import find_vehicle, vehicle_toml

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

OWN = find_vehicle(ROBOT)
SHORT = ("--sets", "payload", "--episodes", "1", "--duration", "0.5", "--no-figures", "--quiet")
# A project of its own, in the current folder: a vehicle, ids, and a policy of one of them.
PROJECT = """
import gymnasium
import numpy as np

from tracked_env.env import TrackedVehicleEnv

ROVER = {"mass": 60.0, "inertia": 3.2, "base": "focchi", "torque_limit": 45.0}
ENTRY = {"entry_point": "tracked_env.env:TrackedVehicleEnv",
         "vector_entry_point": "tracked_env.vector_env:TrackedVehicleVectorEnv"}
BY_SPEED = {"vehicle": ROVER, "base_vehicle": "focchi", "drive": "speed", "plant": "distributed",
            "sensors": "mocap", "control_rate": 25.0}
for name, kind, arguments in (
    ("Rover", ENTRY, BY_SPEED),
    ("Torque", ENTRY, {"vehicle": ROVER, "base_vehicle": "focchi"}),
    ("Alone", {"entry_point": ENTRY["entry_point"]}, BY_SPEED),
    ("Rare", {"entry_point": "yard:Rare"}, {}),
    ("Wrapped", {"entry_point": ENTRY["entry_point"], "additional_wrappers": (
        gymnasium.wrappers.TimeAwareObservation.wrapper_spec(),)}, {}),
    ("Lost", {**ENTRY, "vector_entry_point": "yard:Nothing"}, {}),
):
    gymnasium.register(id=f"yard/{name}-v0", kwargs=arguments, **kind)


class Rare(TrackedVehicleEnv):
    pass


class Coast:
    drive = "yard/Rover-v0"

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 2), np.float32), state
"""


@pytest.fixture
def robot(tmp_path):
    """The file of the vehicle."""
    path = tmp_path / "robot.toml"
    path.write_text(vehicle_toml(ROBOT), encoding="utf-8")
    return path


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A module `yard` in the current folder; its ids are gone afterwards."""
    (tmp_path / "yard.py").write_text(PROJECT, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("yard", None)
    for name in [each for each in gymnasium.registry if each.startswith("yard/")]:
        del gymnasium.registry[name]


def results():
    (path,) = Path("results").glob("*/results.json")
    document = json.loads(path.read_text(encoding="utf-8"))
    return document


def test_a_policy_is_told_the_vehicle_and_the_laws_draw_around_it(robot):
    line = ["--vehicle", str(robot), "--sets", "soil-and-mass"]
    benchmark = benchmark_config(parsed(line, "test"))
    assert benchmark.context("soil-and-mass").vehicle == OWN and benchmark.vehicle == OWN
    drawn = {}
    for name, config in (("own", benchmark), ("usual", BenchmarkConfig(("soil-and-mass",)))):
        env = config.environment("soil-and-mass", 4, truth=False)
        env.reset(seed=[0, 1, 2, 3])
        nominal = config.context("soil-and-mass").vehicle.mass
        drawn[name] = env.simulation.batch.column("mass") / nominal
    assert drawn["own"] == pytest.approx(drawn["usual"]) and drawn["own"].std() > 0.0


def test_evaluate_drives_a_file_and_its_values_are_the_identity(robot):
    line = ["evaluate", *SHORT, "--policies", "nominal", "adaptive", "--vehicle"]
    assert main([*line, str(robot)]) == 0
    document = results()
    assert document["identity"]["vehicle"] == OWN._asdict()
    assert {each["policy"] for each in document["episodes"]} == {"nominal", "adaptive"}
    robot.rename("another.toml")
    assert main([*line, "another.toml"]) == 0  # the same values: the same folder
    assert main([*line, json.dumps({**ROBOT})]) == 0
    assert results()["hash"] == document["hash"]
    Path("another.toml").write_text(vehicle_toml({**ROBOT, "mass": 61.0}), encoding="utf-8")
    assert main([*line, "another.toml"]) == 0
    assert len([*Path("results").glob("own-vehicle-*/results.json")]) == 2


def test_the_file_is_the_nominal_vehicle_of_a_log(robot):
    line = "record adaptive --set nominal --duration 30 --truth truth.json --vehicle"
    assert main([*line.split(), str(robot)]) == 0
    assert main(["identify", "log.csv", "--vehicle", str(robot)]) == 0
    result = json.loads(Path("identified/parameters.json").read_text(encoding="utf-8"))
    mass = result["parameters"]["mass"]
    assert mass["low"] < OWN.mass < mass["high"] and mass["deviation"] < 0.3 * OWN.mass
    vehicle = find_vehicle("identified/vehicle.toml")
    assert (vehicle.track_gauge, vehicle.torque_limit) == (OWN.track_gauge, OWN.torque_limit)


@pytest.mark.slow
def test_the_file_is_the_vehicle_of_runs_and_the_file_of_its_slip_drives_on(robot):
    left, right = np.random.default_rng(0).uniform(-10.0, 10.0, (2, 60))
    motion = steady_motion(with_friction(OWN, 0.3), left, right)
    names = "sprocket_speed_left,sprocket_speed_right,v_x,v_y,yaw_rate"
    runs = np.column_stack([left, right, motion])
    np.savetxt("runs.csv", runs, delimiter=",", header=names, comments="")
    assert main(["slip", "runs.csv", "--vehicle", str(robot)]) == 0
    vehicle = find_vehicle("slip/vehicle.toml")
    assert np.tan(vehicle.friction_angle) == pytest.approx(0.3, rel=0.05)
    assert vehicle.mass == OWN.mass
    line = "evaluate --sets friction --policies slc --vehicle slip/vehicle.toml"
    assert main([*line.split(), *SHORT[2:]]) == 0


@pytest.mark.parametrize(
    "line",
    [
        "plan --goal 2 1.5 0.4 --method dubins --no-slip --no-figures --vehicle {}",
        "vehicle {}",
        "record adaptive --set payload --duration 0.5 --vehicle {}",
        "render adaptive --set payload --duration 0.2 --file one.png --vehicle {}",
        "tune adaptive --sets payload --episodes 4 --budget 3 --duration 0.5 --vehicle {}",
        pytest.param("timing nominal --calls 5 --vehicle {}", marks=pytest.mark.slow),
        pytest.param(
            "leaderboard --env Torque-v0 --episodes 1 --quiet --vehicle {}", marks=pytest.mark.slow
        ),
    ],
    ids=lambda line: line.split()[0],
)
def test_a_command_takes_the_file(line, robot, monkeypatch):
    driven = []
    context = BenchmarkConfig.context
    monkeypatch.setattr(
        BenchmarkConfig, "context", lambda *of: driven.append(context(*of)) or driven[-1]
    )
    if line.startswith("leaderboard"):  # everything that is registered takes long
        monkeypatch.setattr("tracked_env.cli.evaluate_command.compare", lambda config, *_: (
            driven.append(benchmark_config(config).context("noisy-gains")) or 0
        ))  # fmt: skip
    assert main([word.format(robot) for word in line.split()]) == 0
    if line.split()[0] not in ("plan", "vehicle"):
        assert driven and all(each.vehicle == OWN for each in driven)


def test_drive_takes_the_file(robot, monkeypatch):
    driven = []
    monkeypatch.setattr(
        "tracked_env.cli.episode_commands.drive",
        lambda config, name, observer: driven.append(config.context(name)) or [],
    )
    assert main(["drive", "--vehicle", str(robot)]) == 0
    assert driven[0].vehicle == OWN


def test_a_log_becomes_a_file_an_environment_and_a_comparison_in_three_commands(capsys):
    log = "record adaptive --set soil-and-mass --seed 7 --duration 20 --truth truth.json"
    assert main(log.split()) == 0
    assert main(["identify", "log.csv", "--vehicle", "strawa"]) == 0
    line = "evaluate --vehicle identified/vehicle.toml --policies nominal adaptive --sets nominal"
    assert main([*line.split(), *SHORT[2:]]) == 0
    truth = json.loads(Path("truth.json").read_text(encoding="utf-8"))
    vehicle = find_vehicle("identified/vehicle.toml")
    assert vehicle.mass == pytest.approx(truth["mass"], rel=0.02)
    assert vehicle.mass > 1.1 * find_vehicle("strawa").mass  # loaded
    env = gymnasium.make(TORQUE_ID, vehicle="identified/vehicle.toml", uncertainty="nominal")
    assert env.unwrapped.simulation.solver.nominal == vehicle
    assert results()["identity"]["vehicle"] == vehicle._asdict()


def test_an_id_of_another_project_is_driven_with_its_own_arguments(project):
    line = "evaluate --env yard:yard/Rover-v0 --sets friction --policies slc uc"
    assert main([*line.split(), *SHORT[2:]]) == 0
    document = results()
    own = document["identity"]["own_sets"]["friction"]
    assert own["env"] == "yard/Rover-v0" and own["arguments"]["vehicle"]["mass"] == 60.0
    assert document["identity"]["control_rate"] == 25.0
    config = benchmark_config(parsed(line.split()[1:-3], "test"))
    assert config.evaluation_set("friction").sensors == "mocap"
    context = config.context("friction")
    assert (context.drive, context.vehicle.mass, context.control_period) == ("speed", 60.0, 0.04)


def test_an_id_without_a_vector_entry_point_has_that_of_the_package(project):
    line = "evaluate --env yard:yard/{}-v0 --sets friction --policies slc"
    for name in ("Rover", "Alone"):
        assert main([*line.format(name).split(), *SHORT[2:], "--output", name]) == 0
    (with_one,), (alone,) = ([*Path(name).glob("*/episodes.csv")] for name in ("Rover", "Alone"))
    left_out = re.compile(r",[^,]*$", re.MULTILINE)
    assert left_out.sub("", alone.read_text()) == left_out.sub("", with_one.read_text())
    envs = tracked_env.make_vec("yard:yard/Alone-v0", 2, duration=0.5)
    rows = make_vec_env("yard:yard/Alone-v0", 2, env_kwargs={"duration": 0.5}, seed=3)
    single = gymnasium.make("yard:yard/Alone-v0", duration=0.5)
    assert isinstance(envs.unwrapped, TrackedVehicleVectorEnv)
    one, observations = single.reset(seed=3)[0], envs.reset(seed=3)[0]
    assert np.array_equal(one, observations[0]) and np.array_equal(rows.reset(), observations)
    for call in (tracked_env.make_vec, make_vec_env):
        with pytest.raises(ValueError, match="Rare is for one vehicle alone"):
            call("yard:yard/Rare-v0", 2)
    assert gymnasium.registry["yard/Alone-v0"].vector_entry_point is None  # nothing was changed


def test_a_set_of_a_file_is_of_an_id_of_another_project(project):
    Path("mine.toml").write_text('[a]\nenv = "yard/Rover-v0"\nduration = 0.5\n', encoding="utf-8")
    line = ["--env", "yard:yard/Rover-v0", "--sets", "mine.toml"]
    environment_ids.find_id("yard:yard/Rover-v0")
    config = benchmark_config(parsed(line, "test"))
    assert config.env == "yard:yard/Rover-v0" and config.control_rate == 25.0
    assert config.context("a").vehicle.mass == 60.0 and config.max_steps("a") == 12


def test_policies_that_do_not_fit_an_id_are_left_out_where_none_is_named(
    project, monkeypatch, capsys
):
    from tracked_env.benchmark import policies
    from tracked_env.benchmark.policies import Registered, default_names, registered_policies

    environment_ids.find_id("yard:yard/Rover-v0")
    known = registered_policies()
    coast = Registered("coast", "yard/Rover-v0", __import__("yard").Coast, "yard", "yard")
    few = [one for one in known if one.name in ("uc", "slc", "adaptive", "ppo-reckoned")]
    monkeypatch.setattr(policies, "registered_policies", lambda *_: [*few, coast])
    names = default_names([*few, coast], "yard:yard/Rover-v0")
    assert names[0] == "coast" and "uc" in names and "adaptive" not in names
    line = "evaluate --env yard:yard/Rover-v0 --sets friction"
    assert main([*line.split(), *SHORT[2:]]) == 0
    shown = capsys.readouterr().err
    assert re.search(r"left out: policy 'ppo-reckoned@0'.* period of 0\.02 s", shown)
    assert {each["policy"] for each in results()["episodes"]} == {"coast", "uc", "slc"}
    first = ["evaluate", "--env", "yard:yard/Rover-v0", "--output", "first", *SHORT[2:]]
    assert main(first) == 0  # a first look has what the project registers for its id
    (path,) = Path("first").glob("*/results.json")
    episodes = json.loads(path.read_text(encoding="utf-8"))["episodes"]
    assert {each["policy"] for each in episodes} == {"coast", "slc"}
    assert len({each["set"] for each in episodes}) == 4


@pytest.mark.parametrize(
    "line",
    [
        "record slc --duration 0.5",
        "render slc --duration 0.2 --file one.png",
        "tune slc --sets friction --episodes 4 --budget 3 --duration 0.5",
        pytest.param("timing slc --calls 5", marks=pytest.mark.slow),
        pytest.param("compile slc --workers 1", marks=pytest.mark.slow),
    ],
)
def test_a_command_takes_an_id_of_another_project(line, project):
    assert main([*line.split(), "--env", "yard:yard/Rover-v0"]) == 0


@pytest.mark.slow
def test_an_installed_project_evaluates_its_vehicle_on_its_id_in_several_processes(tmp_path):
    site = tmp_path / "site"
    information = site / "yard-1.dist-info"
    information.mkdir(parents=True)
    (site / "yard.py").write_text(PROJECT, encoding="utf-8")
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: yard\nVersion: 1\n")
    (information / "entry_points.txt").write_text(
        "[tracked_env.vehicles]\nrover = yard:ROVER\n[tracked_env.policies]\ncoast = yard:Coast\n"
    )
    line = "evaluate --env yard:yard/Rover-v0 --vehicle rover --policies coast uc --workers 2"
    line += " --sets friction --episodes 3 --chunk 2 --duration 0.5 --no-figures --quiet"
    python("-m", "tracked_env.cli.main", *line.split(), cwd=None, path=[site])
    document = results()
    assert document["identity"]["vehicle"]["mass"] == 60.0
    assert [each["policy"] for each in document["episodes"]].count("coast") == 3


def test_arguments_of_the_environment_are_those_that_are_named():
    Path("arguments.json").write_text('{"plant": "distributed", "patches": [4, 2]}')
    for text in ("arguments.json", '{"plant": "distributed", "patches": [4, 2]}'):
        line = ["--sets", "payload", "--env-args", text]
        benchmark = benchmark_config(parsed(line, "test"))
        assert benchmark.arguments("payload", truth=False)["patches"] == [4, 2]
        env = benchmark.environment("payload", 1, truth=False)
        assert env.simulation.solver.plant.name == "distributed"
        assert benchmark.identity()["own_sets"]["payload"]["arguments"]["plant"] == "distributed"


ID = "evaluate --policies nominal --sets payload --env"
WRONG = [
    ("evaluate --vehicle robo.toml", 1, "robo.toml: no such file"),
    ("evaluate --vehicle robo", 2, "unknown vehicle 'robo'; .* A file must end in .toml"),
    ('evaluate --vehicle {"mass":6}', 2, r"mass = 6.0 kg; must be .* \[10, 100000\] kg"),
    ('evaluate --vehicle {"mas":60}', 2, "unknown vehicle key 'mas'.*Did you mean 'mass'"),
    ("evaluate --vehicle {mass", 2, "--vehicle {mass: not a JSON object"),
    ("tune adaptive --vehicle robo", 2, "unknown vehicle 'robo'"),
    ("record adaptive --vehicle robo", 2, "unknown vehicle 'robo'"),
    ("render adaptive --vehicle robo", 2, "unknown vehicle 'robo'"),
    ("drive --vehicle robo", 2, "unknown vehicle 'robo'"),
    ("timing adaptive --vehicle robo", 2, "unknown vehicle 'robo'"),
    ("plan --goal 1 1 0 --vehicle robo", 2, "unknown vehicle 'robo'"),
    ("identify log.csv --vehicle robo", 2, "unknown vehicle 'robo'"),
    ("slip runs.csv --vehicle robo", 2, "unknown vehicle 'robo'"),
    (f"{ID} yrd:yard/Rover-v0", 2, "--env: .* yrd:yard/Rover-v0: 'yrd' cannot be imported"),
    (f"{ID} yard:yard/Rovr-v0", 2, "unknown environment 'yard:yard/Rovr-v0'.* did 'yard' regist"),
    (f"{ID} yard:yard/Rare-v0", 2, "Rare is for one vehicle alone; .* add vector_entry_point="),
    (f"{ID} yard:yard/Wrapped-v0", 2, "without vector_entry_point, and the wrappers of its regis"),
    (f"{ID} yard:yard/Lost-v0", 2, "yard/Lost-v0: vector_entry_point 'yard:Nothing': "),
    (f"{ID} CartPole-v1", 2, "CartPole-v1 is not an environment of tracked vehicles"),
    (f"{ID} yard:yard/Rover-v0", 2, "'payload' is of Torque-v0, which contradicts --env Rover-v0"),
    ('evaluate --env-args {"plnt":"x"}', 2, "unknown --env-args key 'plnt'.*Did you mean 'plant'"),
    ('evaluate --env-args {"vehicle":"x"}', 2, "vehicle has an option of its own, --vehicle"),
    ('evaluate --env-args {"uncertainty":"x"}', 2, "uncertainty is that of the sets"),
    ('evaluate --env-args {"plant":"x"}', 2, "set '.*': unknown plant 'x'"),
    ("evaluate --env-args none.json", 1, "none.json: no such file"),
    ("evaluate --env-args plant", 2, "--env-args = 'plant'; must be a dict"),
]


@pytest.mark.parametrize(("line", "status", "says"), WRONG, ids=lambda value: str(value)[:60])
def test_a_wrong_vehicle_id_or_argument_is_one_line(line, status, says, project, capsys):
    try:
        assert main(line.split()) == status
    except SystemExit as ended:
        assert ended.code == status
    error = capsys.readouterr().err
    assert error.startswith(f"tracked-env {line.split()[0]}: ") and error.count("\n") == 1
    assert re.search(says, error)
