"""Sets of a TOML file: what they say, what identifies their results, what is refused."""

import json
import pickle
import re
from pathlib import Path

import pytest

from tests.test_vehicles import ROBOT
from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.benchmark import BenchmarkConfig, check
from tracked_env.benchmark.benchmark_config import on_id, read_sets
from tracked_env.cli.evaluate_options import benchmark_config, parsed
from tracked_env.cli.main import main
from tracked_env.validation import name_or_json
from tracked_env.vehicles import find_vehicle, vehicle_toml

SETS = """
[wet-field]
uncertainty = {cohesion = [500.0, 2000.0], friction_angle = [0.3, 0.5]}
reference = {kind = "circle", radius = 10.0, speed = 2.0}
sensors = {preset = "rtk", pose_delay = 0.1}
duration = 0.5
seed = 7

[robot]
uncertainty = "payload"
duration = 0.5
arguments = {vehicle = "robot.toml", plant = "distributed"}
"""


@pytest.fixture(autouse=True)
def files(in_an_empty_folder):
    """The files of the sets and of the vehicle that one of them names."""
    Path("mine.toml").write_text(SETS, encoding="utf-8")
    Path("robot.toml").write_text(vehicle_toml(ROBOT), encoding="utf-8")


def configured(*line):
    """The configuration of a command line."""
    return benchmark_config(parsed([*line], "test"))


def test_a_table_says_law_reference_sensors_duration_seed_and_arguments():
    config = configured("--sets", "mine.toml", "--seed", "2")
    assert config.sets == ("wet-field", "robot") and config.env == TORQUE_ID
    assert config.first_seed("wet-field") == 9 and config.first_seed("robot") == 2
    wet = config.evaluation_set("wet-field")
    assert wet.reference == {"kind": "circle", "radius": 10.0, "speed": 2.0}
    assert config.max_steps("wet-field") == 25
    assert config.context("wet-field").sensors.pose_delay == 0.1
    assert config.context("robot").vehicle == find_vehicle(ROBOT)
    env = config.environment("wet-field", 4, truth=False)
    env.reset(seed=[0, 1, 2, 3])
    cohesion = env.simulation.batch.column("cohesion")
    assert ((cohesion >= 500.0) & (cohesion <= 2000.0)).all() and cohesion.std() > 0.0
    plant = config.environment("robot", 1, truth=False).simulation.solver.plant
    assert plant.name == "distributed"


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("mine.toml", ("wet-field", "robot")),
        ("mine.toml robot", ("robot",)),
        ("mine.toml,robot", ("robot",)),
        ("payload mine.toml robot", ("payload", "robot")),
    ],
)
def test_a_file_means_all_of_its_sets_or_those_that_are_named(words, names):
    assert configured("--sets", *words.split()).sets == names


def test_what_a_table_leaves_out_is_as_the_id_is_registered():
    Path("short.toml").write_text("[short]\nduration = 1.0\n", encoding="utf-8")
    (short,) = read_sets("short.toml", SPEED_ID)
    assert (short.env, short.uncertainty, short.sensors) == (SPEED_ID, "friction", "mocap")
    assert short.arguments["plant"] == "distributed" and short.duration == 1.0
    config = configured("--env", "Speed-v0", "--sets", "short.toml")
    assert config.context("short").vehicle == find_vehicle("focchi")


def test_the_content_of_a_file_is_the_identity_of_results_and_its_name_is_not():
    first = configured("--sets", "mine.toml").identity()
    assert json.loads(json.dumps(first)) == first
    assert first["own_sets"]["robot"]["arguments"]["vehicle"]["mass"] == 60.0
    Path("mine.toml").rename("other.toml")
    assert configured("--sets", "other.toml").identity() == first
    for old, new in (("2000.0", "2001.0"), ("seed = 7", "seed = 8"), ("0.1}", "0.2}")):
        Path("other.toml").write_text(SETS.replace(old, new), encoding="utf-8")
        assert configured("--sets", "other.toml").identity() != first
    Path("other.toml").write_text(SETS, encoding="utf-8")
    Path("robot.toml").write_text(vehicle_toml({**ROBOT, "mass": 61.0}), encoding="utf-8")
    assert configured("--sets", "other.toml").identity() != first


def test_a_configuration_goes_to_another_process_without_its_files():
    config = configured("--sets", "mine.toml")
    data = pickle.dumps(config)
    Path("robot.toml").unlink()
    received = pickle.loads(data)
    assert received.identity() == config.identity()
    received.environment("robot", 1, truth=False).close()


def test_a_set_in_the_place_of_a_published_one_is_not_that_of_the_version():
    Path("mine.toml").write_text('[payload]\nuncertainty = "payload"\n', encoding="utf-8")
    config = configured("--sets", "mine.toml", "--episodes", "1")
    assert "sets of your own, not v2: set payload" in check(config).message
    usual = BenchmarkConfig(sets=("noisy-gains",), episodes=1)
    assert "vehicle" not in usual.identity() and "own_sets" not in usual.identity()
    other = BenchmarkConfig(sets=("noisy-gains",), episodes=1, vehicle=ROBOT)
    assert "not torque-v3: another vehicle" in check(other).message


def test_a_published_set_on_its_own_id_is_itself():
    from tracked_env.benchmark.evaluation_sets import SETS as registered

    for entry in registered.values():
        moved = on_id(entry, entry.env)
        assert (moved.sensors, moved.reference) == (entry.sensors, entry.reference)
        differences = {key: value for key, value in entry.arguments.items() if key != "observation"}
        assert differences.items() <= moved.arguments.items()


@pytest.mark.parametrize(
    "line",
    [
        "evaluate --sets mine.toml --policies nominal adaptive --episodes 1 --no-figures --quiet",
        "tune adaptive --sets mine.toml --episodes 4 --budget 3",
        "record adaptive --set mine.toml,wet-field",
        "render adaptive --set mine.toml,robot --file one.png",
    ],
    ids=lambda line: line.split()[0],
)
def test_a_command_drives_the_sets_of_a_file(line, capsys):
    assert main(line.split()) == 0
    shown = capsys.readouterr().out
    if line.startswith("evaluate"):
        (path,) = Path("results").glob("own-*/results.json")
        seeds = {each["set"]: each["seed"] for each in json.loads(path.read_text())["episodes"]}
        assert seeds == {"wet-field": 7, "robot": 0}
    if line.startswith("record"):
        assert "set wet-field, seed 7" in shown


WRONG = [
    ("", "it is empty; must be tables, each headed by a name"),
    ("duration = 3.0", "duration = 3.0 belongs to none; must be tables"),
    ("[a\nb", "no TOML: .*must be tables as"),
    ("[a]\nduraton = 3.0", "mine.toml: 'a': key 'duraton'.*Did you mean 'duration'"),
    ("[a]\nduration = -3.0", "set 'a': duration = -3.0 s; must be"),
    ('[a]\nuncertainty = "paylod"', "'a': unknown uncertainty set 'paylod'.*'payload'"),
    ("[a]\nuncertainty = {cohesion = [3.0]}", r"'a': uncertainty of cohesion = \[3.0\]; must be"),
    ("[a]\nuncertainty = {cohesion = [9.0, 3.0]}", "low must be <= high"),
    ('[a]\nsensors = "rtq"', "set 'a': unknown sensor preset 'rtq'"),
    ('[a]\nreference = "cirle"', "set 'a': unknown .*'cirle'.*Did you mean 'circle'"),
    ('[a]\nseed = "x"', "'a': seed = 'x'; must be a number"),
    ("[a]\nseed = 1.5", "'a': seed = 1.5; must be a whole number"),
    ('[a]\nenv = "Sped-v0"', "'a': unknown environment 'Sped-v0'.*Did you mean 'Speed-v0'"),
    ("[a]\narguments = {plnt = 1}", "'a': unknown arguments key 'plnt'.*Did you mean 'plant'"),
    ("[a]\narguments = {sensors = 'rtk'}", "'a': arguments: sensors is a key of the set itself"),
    ("[a]\narguments = {vehicle = 'robo'}", "set 'a': unknown vehicle 'robo'"),
    (
        "[a]\narguments = {control_rate = 5.0}\n[b]",
        "control_rate = 5.0 in set 'a' and 50.0 in set 'b'; must be the same",
    ),
    ('[a]\nenv = "Speed-v0"\n[b]', "'b' is of Torque-v0, which contradicts 'a' of Speed-v0"),
]


@pytest.mark.parametrize(("text", "says"), WRONG)
def test_a_wrong_file_is_one_line_that_names_the_set(text, says, capsys):
    Path("mine.toml").write_text(text, encoding="utf-8")
    assert main(["evaluate", "--policies", "nominal", "--sets", "mine.toml"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("tracked-env evaluate: ") and error.count("\n") == 1
    assert re.search(says, error)


def test_one_set_is_asked_for_where_one_episode_is_driven(capsys):
    arguments = ["render", "nominal", "--set", "mine.toml"]
    assert main(arguments) == 2
    assert "2 sets, wet-field, robot; must be one: FILE.toml,SET" in capsys.readouterr().err


def test_a_file_of_sets_finds_the_vehicle_beside_it_and_may_be_of_windows(tmp_path, monkeypatch):
    (tmp_path / "project").mkdir()
    (tmp_path / "project/robot.toml").write_text('base = "focchi"\nmass = 60.0\n')
    table = '[a]\r\narguments = {vehicle = "robot.toml"}\r\n'
    (tmp_path / "project/sets.toml").write_bytes(b"\xef\xbb\xbf" + table.encode())
    monkeypatch.chdir(tmp_path)
    (one,) = read_sets("project/sets.toml", TORQUE_ID)
    assert BenchmarkConfig(("a",), own_sets=(one,)).context("a").vehicle.mass == 60.0
    (tmp_path / "arguments.json").write_bytes(b'\xef\xbb\xbf{"plant": "distributed"}')
    assert name_or_json("arguments.json", "env-args") == {"plant": "distributed"}
