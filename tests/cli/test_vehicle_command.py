"""`tracked-env vehicle`: the catalogue, one vehicle on the soils, and what does not fit."""

import re

import pytest

from tracked_env.cli.main import main
from tracked_env.uncertainty.soils import SOILS
from tracked_env.vehicles import find_vehicle, vehicle_names, vehicle_toml
from tracked_env.vehicles.abilities import abilities

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

ROBOT = {"title": "Our robot", "source": "scales", "base": "infantry-ugv", "mass": 1500.0}


@pytest.fixture
def shown(capsys, monkeypatch):
    """Runs `tracked-env vehicle` on a wide terminal; returns what it prints."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments):
        assert main(["vehicle", *arguments]) == 0
        return capsys.readouterr().out

    return run


def test_without_a_vehicle_it_lists_all_that_have_a_name(shown):
    lines = shown().splitlines()
    rows = {line.split()[0]: line.split() for line in lines[2:] if line and line[0].islower()}
    assert {*vehicle_names()} <= {*rows}
    p = find_vehicle("m113")
    assert rows["m113"][1:5] == ["10400", "2.667", "50.2", "17.7"]
    assert rows["m113"][5] == f"{abilities(p).turning_share:.0%}"


def test_a_file_is_described_on_its_own_soil_and_on_those_of_the_catalogue(shown, tmp_path):
    (tmp_path / "robot.toml").write_text(vehicle_toml(ROBOT), encoding="utf-8")
    text = shown("robot.toml")
    able = abilities(find_vehicle(ROBOT))
    own = rf"its own +{re.escape(f'{able.traction:.4g}')} +{able.turning_torque:.4g} "
    pressure = f"ground pressure +{able.ground_pressure / 1e3:.1f} +kPa$"
    for line in ("mass +1500 +kg$", pressure, own, *(f"{soil} " for soil in SOILS)):
        assert re.search(f"^{line}", text, re.MULTILINE), line
    assert text.endswith("source: scales\n")


def test_what_does_not_fit_is_a_warning(shown, tmp_path):
    (tmp_path / "robot.toml").write_text(vehicle_toml({**ROBOT, "torque_limit": 40.0}))
    assert "warning: it cannot move on its soil: a track gives" in shown("robot.toml")


@pytest.mark.parametrize(
    ("vehicle", "status", "message"),
    [
        ("infantry", 2, "unknown vehicle 'infantry'"),
        ("robot.toml", 1, "robot.toml: no such file"),
        ("heavy.toml", 2, "mass = 1000000.0 kg; must be a number in [10, 100000] kg"),
    ],
)
def test_a_wrong_vehicle_ends_with_one_line(vehicle, status, message, tmp_path, capsys):
    (tmp_path / "heavy.toml").write_text("mass = 1e6\n")
    assert main(["vehicle", vehicle]) == status
    error = capsys.readouterr().err
    assert error.startswith("tracked-env vehicle: ") and message in error
    assert error.count("\n") == 1


def test_the_page_shows_what_is_printed(shown, repository, tmp_path):
    text = (repository / "docs/own_vehicle.md").read_text()
    blocks = dict(re.findall(r"^```(toml|text)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)[::-1])
    (tmp_path / "robot.toml").write_text(blocks["toml"])
    lines = shown("robot.toml").splitlines()
    assert [line for line in blocks["text"].splitlines() if line not in lines] == []
