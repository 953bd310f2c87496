"""Vehicles by name, file and values are the same vehicle everywhere."""

import sys

import gymnasium
import pytest

import tracked_env
from tracked_env import TORQUE_ID, entry_points, vehicles
from tracked_env.physics.parameters import PARAMETER_NAMES, VEHICLES
from tracked_env.vehicles import find_vehicle, vehicle_record, vehicle_toml, vehicle_values

ROBOT = {
    "title": 'A "delivery" robot\n',
    "source": "measured",
    "base": "focchi",
    "mass": 60.0,
    "inertia": 3.2,
    "track_gauge": 0.45,
    "track_width": 0.08,
    "contact_length": 0.6,
    "sprocket_radius": 0.07,
    "torque_limit": 45.0,
    "sprocket_speed_limit": 20.0,
    "drive_time_constant": 0.05,
    "sprocket_inertia": 0.04,
}


@pytest.fixture
def registered(monkeypatch):
    """No vehicle stays registered after a test."""
    monkeypatch.setattr(vehicles, "_registered", {})
    vehicles._declared.cache_clear()
    yield
    vehicles._declared.cache_clear()


@pytest.fixture
def robot(tmp_path):
    """The file of the robot."""
    path = tmp_path / "robot.toml"
    path.write_text(vehicle_toml(ROBOT), encoding="utf-8")
    return path


def test_a_file_its_values_and_its_name_are_one_vehicle(robot, registered):
    tracked_env.register_vehicle("robot", robot)
    parameters = VEHICLES["focchi"]._replace(
        **{name: value for name, value in ROBOT.items() if name in PARAMETER_NAMES}
    )
    for spec in (robot, str(robot), ROBOT, "robot", parameters):
        assert find_vehicle(spec) == parameters
        env = gymnasium.make(TORQUE_ID, vehicle=spec).unwrapped
        assert env.simulation.solver.nominal == parameters
    assert "robot" in vehicles.vehicle_names()


def test_a_file_says_the_unit_of_each_value_and_reads_back_to_the_bit(robot):
    text = robot.read_text(encoding="utf-8")
    assert "mass = 60.0  # [kg]\n" in text and "sprocket_inertia = 0.04  # [kg m^2]\n" in text
    assert vehicle_values(robot) == ROBOT
    third = {"mass": 1000.0 / 3.0}
    robot.write_text(vehicle_toml(third), encoding="utf-8")
    assert vehicle_values(robot) == third


def test_a_base_may_be_a_file_or_a_registered_vehicle(robot, registered):
    heavier = {"base": str(robot), "mass": 70.0}
    tracked_env.register_vehicle("heavier", heavier)
    expected = find_vehicle(ROBOT)._replace(mass=70.0)
    assert find_vehicle(heavier) == expected
    assert find_vehicle({"base": "heavier", "cohesion": 10.0}) == expected._replace(cohesion=10.0)


@pytest.mark.parametrize("end", ["\n", "\r\n"], ids=["line feeds", "of Windows"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"], ids=["plain", "byte order mark"])
def test_a_file_of_windows_is_the_same_vehicle(robot, end, mark):
    text = robot.read_text(encoding="utf-8").replace("\n", end)
    robot.write_bytes(mark + text.encode())
    assert find_vehicle(robot) == find_vehicle(ROBOT)


def test_a_file_and_its_base_are_found_from_any_folder(tmp_path, monkeypatch, registered):
    for folder in ("project", "elsewhere"):
        (tmp_path / folder).mkdir()
    (tmp_path / "project/robot.toml").write_text(vehicle_toml(ROBOT), encoding="utf-8")
    (tmp_path / "project/heavy.toml").write_text('base = "robot.toml"\nmass = 70.0\n')
    heavy = find_vehicle(ROBOT)._replace(mass=70.0)
    monkeypatch.chdir(tmp_path)
    assert find_vehicle("project/heavy.toml") == heavy
    tracked_env.register_vehicle("heavy", "project/heavy.toml")
    monkeypatch.chdir("elsewhere")
    assert find_vehicle("heavy") == find_vehicle("../project/heavy.toml") == heavy
    (tmp_path / "elsewhere/light.toml").write_text('base = "focchi"\nmass = 60.0\n')
    (tmp_path / "project/light.toml").write_text('base = "focchi"\nmass = 61.0\n')
    (tmp_path / "project/last.toml").write_text('base = "light.toml"\n')
    assert find_vehicle("../project/last.toml").mass == 61.0  # the one beside it comes first


def test_records_keep_the_name_of_a_vehicle_of_the_ids_and_all_values_of_others():
    assert vehicle_record(VEHICLES["focchi"]) == "focchi"
    own = find_vehicle(ROBOT)
    assert find_vehicle(vehicle_record(own)) == own and len(vehicle_record(own)) == 25


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mass = 60 kg", "no TOML: .*must be lines as `mass = 60.0"),
        ('mass = "60"', "mass = '60'; must be a number in"),
        (
            "mass = 6.0",
            r"mass = 6.0 kg; must be .* in \[10, 100000\] kg. Did you pass tonnes",
        ),
        ("mas = 60.0", "unknown vehicle .*robot.toml: key 'mas'.*Did you mean 'mass'"),
        ("[vehicle]\nmass = 60.0", "unknown vehicle .* key 'vehicle'"),
        ('base = "robo"', "unknown vehicle base 'robo'"),
        ("\x00", "no TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_its_cause(robot, text, message):
    robot.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        find_vehicle(robot)


def test_a_base_that_leads_back_is_refused(robot):
    robot.write_text(f"base = {str(robot)!r}\nmass = 60.0\n", encoding="utf-8")
    with pytest.raises(ValueError, match="its own base is, in the end,"):
        find_vehicle(robot)


@pytest.mark.parametrize("spec", [None, 3, ["focchi"], "robot", "fochi"])
def test_what_is_no_vehicle_is_refused(spec):
    with pytest.raises(ValueError, match=r"unknown vehicle .*A file must end in \.toml"):
        find_vehicle(spec)


def test_a_missing_file_names_itself(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.toml"):
        find_vehicle(tmp_path / "nothing.toml")


@pytest.mark.parametrize("name", ["strawa", "own.toml"])
def test_a_name_that_is_taken_or_of_a_file_is_refused(name, registered):
    with pytest.raises(ValueError, match=f"vehicle name = '{name}'; must be none of"):
        tracked_env.register_vehicle(name, ROBOT)


def test_a_registered_vehicle_makes_sense(registered):
    with pytest.raises(ValueError, match=r"mass = -1\.0 kg; must be"):
        tracked_env.register_vehicle("wrong", {"mass": -1.0})
    assert "wrong" not in vehicles.vehicle_names()


@pytest.fixture
def project(tmp_path, monkeypatch, registered):
    """An installed project whose entry points are `rover`, a file, and `broken`, nothing."""
    (tmp_path / "rover_project.py").write_text(
        "from pathlib import Path\nROVER = Path(__file__).with_name('rover.toml')\n"
    )
    (tmp_path / "rover.toml").write_text(vehicle_toml(ROBOT), encoding="utf-8")
    information = tmp_path / "rover_project-1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: rover\nVersion: 1\n")
    (information / "entry_points.txt").write_text(
        f"[{vehicles.GROUP}]\nrover = rover_project:ROVER\nbroken = rover_project:NONE\n"
        "focchi = rover_project:ROVER\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield
    sys.modules.pop("rover_project", None)


def test_the_entry_point_of_another_project_is_a_vehicle(project):
    assert find_vehicle("rover") == find_vehicle(ROBOT)
    assert find_vehicle("focchi") == VEHICLES["focchi"]  # ours are not replaced
    assert [group for _, group in entry_points.declared(vehicles.GROUP)]
    with pytest.raises(ValueError, match=r"'broken': its entry point .* cannot be loaded"):
        find_vehicle("broken")
