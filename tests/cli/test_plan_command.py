"""The command `tracked-env plan`: its table, its files, and what it refuses."""

import csv
import time
from pathlib import Path

import numpy as np
import pytest

from baselines.planners.reference_plans import planned
from tracked_env.cli.command_line import COMPILING
from tracked_env.cli.main import main
from tracked_env.cli.vehicle_commands import outline

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

GOAL = ("--goal", "2", "2.5", "-0.4")
QUICK = ("plan", *GOAL, "--method", "dubins", "--no-slip", "--no-figures")


def printed(text):
    """Name -> value of the table."""
    return {line[:24].strip(): line[24:] for line in text.splitlines() if line[24:]}


def test_plan_prints_the_plan_that_the_planner_makes(capsys):
    assert main(["plan", *GOAL, "--no-figures"]) == 0
    table, found = printed(capsys.readouterr().out), planned((2.0, 2.5, -0.4))
    assert table["converged"] == "yes"
    assert table["duration"] == f"{found.trajectory.duration:.3f} s"
    assert table["cost"] == f"{found.trajectory.cost:.3f} s"
    assert int(table["iterations"]) > 0
    assert float(table["end error"].split()[0]) < 1e-6


def test_a_plan_that_is_not_found_has_no_duration(capsys):
    """No way from rest to a speed of 0.4 m/s: the last iterate of the solver lasts for hours."""
    goal = ("--goal", "100000", "0", "0")
    assert main(["plan", *goal, "--v-min", "0.4", "--no-slip", "--no-figures"]) != 0
    out = capsys.readouterr().out
    assert "duration" not in out and "cost" not in out


def test_plan_says_the_length_of_a_path_and_its_curvature(capsys):
    """A half circle of radius R: 2 (r omega - v) / (B v) = 1 / R at the sprockets' limit."""
    found = planned((0.0, 1.0, 0.0), method="dubins", slips=False)
    bend = found.limits.curvature_at(found.limits.v_max, found.vehicle)
    width = 2.0 / bend
    arguments = ["plan", "--goal", "0", str(width), "3.141592653589793"]
    assert (
        main([*arguments, "--method", "dubins", "--no-slip", "--v-min", "0.4", "--no-figures"]) == 0
    )
    table = printed(capsys.readouterr().out)
    assert table["length"] == f"{np.pi / bend:.3f} m"
    assert float(table["largest curvature"].split()[0]) == pytest.approx(bend, abs=0.006)
    assert table["largest sprocket speed"].startswith("10.00 rad/s")


def test_a_plan_that_takes_long_says_why_and_a_quick_one_says_nothing(capsys, monkeypatch):
    assert main([*QUICK]) == 0
    assert capsys.readouterr().err == ""

    def slow(*arguments, **options):
        time.sleep(0.5)
        return planned((2.0, 2.5, -0.4), method="dubins", slips=False)

    monkeypatch.setattr("tracked_env.cli.vehicle_commands.command_function", lambda name: slow)
    monkeypatch.setattr("tracked_env.cli.command_line.PATIENCE", 0.05)
    assert main([*QUICK]) == 0
    assert capsys.readouterr().err == f"{COMPILING}\n"


def test_plan_writes_a_figure_and_the_samples(capsys):
    more = "--output there --csv --via 1 1 1 --obstacle-circle 0.2 2.4 0.3"
    assert main(["plan", *GOAL, *more.split()]) == 0
    assert Path("there/plan.png").read_bytes().startswith(b"\x89PNG")
    assert Path("there/plan.png").stat().st_size > 20_000
    with Path("there/plan.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    last = rows[-1]
    assert (last["x"], last["y"], last["yaw"]) == pytest.approx((2.0, 2.5, -0.4), abs=1e-6)
    near = min(np.hypot(row["x"] - 1.0, row["y"] - 1.0) for row in rows)
    assert near < 1e-6
    # belts over the ground and slip velocities are the sprocket speeds: r omega = v + beta
    row = rows[len(rows) // 3]
    across = 0.5 * 0.606 * row["yaw_rate"]
    forward = row["speed"] * np.cos(row["alpha"])
    assert 0.0856 * row["sprocket_right"] == pytest.approx(forward + across + row["beta_right"])
    assert "plan.csv" in capsys.readouterr().out


def test_slip_and_reverse_are_those_that_are_asked_for(capsys):
    def duration(*arguments):
        assert main(["plan", *arguments, "--no-figures"]) == 0
        return float(printed(capsys.readouterr().out)["duration"].split()[0])

    none, little, much = (
        duration(*GOAL, *more)
        for more in (("--no-slip",), ("--friction", "0.4"), ("--friction", "0.1"))
    )
    assert none <= little <= much and much > none + 0.2
    assert np.abs(planned((2.0, 2.5, -0.4), slips=False).slip).max() < 1e-12
    behind = ("--goal", "-1", "0.1", "0.1")
    assert duration(*behind, "--reverse") < 0.7 * duration(*behind)


def test_the_outline_of_a_vehicle_turns_with_its_yaw():
    vehicle = planned((1.0, 0.0, 0.0), method="dubins", slips=False).vehicle
    front_left = outline(np.array([1.0, 2.0, 0.5 * np.pi]), vehicle)[0]
    half_width = 0.5 * (vehicle.track_gauge + vehicle.track_width)
    np.testing.assert_allclose(front_left, [1.0 - half_width, 2.0 + 0.5 * vehicle.contact_length])


def test_a_goal_that_no_plan_reaches_ends_with_status_1(capsys):
    """A ring of obstacles around the start."""
    ring = [
        [f"{1.3 * np.cos(a):.3f}", f"{1.3 * np.sin(a):.3f}", "0.4"] for a in np.arange(0, 6.3, 0.5)
    ]
    walls = [word for circle in ring for word in ("--obstacle-circle", *circle)]
    assert main([*QUICK, *walls]) == 1
    said = capsys.readouterr()
    assert printed(said.out)["converged"] == "no"
    assert said.err.startswith("tracked-env plan: no way around the obstacles was found: searched")
    assert "forwards only" in said.err and said.err.count("\n") == 1
