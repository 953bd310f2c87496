"""`tracked-env identify` and `record`: what a log says, what it cannot say, and what is refused."""

import csv
import json
import re
import shlex
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from scipy.stats import binom

from baselines.identify import vehicle_log
from baselines.identify.identify_log import biases, half_width, identify
from baselines.identify.report_log import limitations, parameter_set
from baselines.identify.vehicle_log import Drivetrain, read_log
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import TUNED_GAINS, Gains
from tests.baselines.identify.independent_vehicle import write
from tests.baselines.observer_runs import PARAMETERS, intervals, record
from tracked_env.cli.episode_commands import record_log
from tracked_env.cli.main import main
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import PRESETS

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

STRAWA, RTK = VEHICLES["strawa"], PRESETS["rtk"]
ALL_ACCELERATIONS = ("acceleration_x", "acceleration_y", "yaw_acceleration")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Twelve logs of random vehicles on random soils, with the true values."""
    return record(tmp_path_factory.mktemp("logs"), 12, 30.0)


def columns_of(path):
    table = np.genfromtxt(path, delimiter=",", names=True)
    return {name: table[name].copy() for name in table.dtype.names}


def read(path, units=None, **of):
    return read_log(path, of.pop("mapping", {}), units or {}, Drivetrain(**of), STRAWA, RTK)


@pytest.mark.slow
def test_the_intervals_of_simulated_logs_hold_the_truth_about_as_often_as_they_say(logs):
    """48 intervals of 95 %: fewer than the 0.1 % quantile would be no accident."""
    estimates = intervals(logs)
    inside_all = [inside for name in PARAMETERS for inside, _, _ in estimates[name]]
    assert sum(inside_all) >= binom.ppf(0.001, len(inside_all), 0.95)
    for name in PARAMETERS:  # and they are narrow: a few per cent of the value
        assert np.median([half / value for _, half, value in estimates[name]]) < 0.04


def test_the_set_of_parameters_makes_an_environment_with_that_vehicle(logs, capsys):
    path, truth = logs[0]
    assert main(["identify", str(path), "--vehicle", "strawa", "--output", "out"]) == 0
    terminal = capsys.readouterr().out
    assert "determined" in terminal and max(map(len, terminal.splitlines())) <= 80
    parameters = json.loads(Path("out/parameters.json").read_text())
    options = {"uncertainty": "nominal", "expose_truth": True, **parameters["make"]}
    env = gymnasium.make("tracked_env:tracked_env/Torque-v0", **options)
    _, info = env.reset(seed=0)
    assert info["truth"]["mass"] == pytest.approx(truth["mass"], rel=0.03)
    assert info["truth"]["inertia"] == pytest.approx(truth["inertia"], rel=0.06)
    with Path("out/identification.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(columns_of(path)["time"])
    assert float(rows[-1]["mass_deviation"]) > 0.0
    page = Path("out/identification.html").read_text()
    assert path.name in page and "http" not in page.replace("http://www.w3.org", "")
    assert "e+" not in terminal and not re.search(r">[\d.]+e[+-]\d", page)
    for place, said in (("untold", parameters["not_told"]), ("log", [])):  # sentences, no facts
        part = page.partition(f'<section id="{place}">')[2].partition("</section>")[0]
        assert "<li>" in part and "<dl>" not in part
        assert not said or part.count("<li>") == len(said)


def test_straight_driving_at_constant_speed_tells_a_force_and_no_mass():
    """A vehicle that goes straight on: m g mu_l is what its torques say, and nothing else."""
    count, speed, force = 2000, 1.5, 6000.0
    noise = np.random.default_rng(0).standard_normal
    time = 0.02 * np.arange(count)
    sigma = {"x": 0.02, "y": 0.02, "yaw": 0.005, "yaw_rate": 0.002, "v_x": 0.03, "v_y": 0.03}
    sigma |= {"acceleration_x": 0.05, "acceleration_y": 0.05, "yaw_acceleration": 0.07}
    columns = {name: s * noise(count) for name, s in sigma.items()} | {"time": time}
    columns["x"] += speed * time
    columns["v_x"] += speed
    for side in ("left", "right"):
        columns[f"sprocket_speed_{side}"] = 1.01 * speed / 0.3 + 0.02 * noise(count)
        columns[f"torque_{side}"] = 0.5 * force * 0.3 + 10.0 * noise(count)
    identified = identify(read(write(columns)), STRAWA)
    verdicts = {name: of.verdict for name, of in identified.parameters.items()}
    assert {verdicts[n] for n in ("mass", "inertia", "lateral_resistance")} == {"not determined"}
    assert identified.resistance_force[0] == pytest.approx(force, rel=0.05)
    said = " ".join(limitations(identified))
    assert "not told apart" in said and "m g mu_l" in said and "turns" in said
    result = parameter_set(identified)
    assert result["make"]["vehicle"]["mass"] == STRAWA.mass and "mass" not in result["ranges"]


@pytest.mark.parametrize("gains", [Gains(80.0, 60.0, 12.0, 0.5), TUNED_GAINS])
def test_on_firm_clay_the_inertia_is_claimed_no_better_than_it_is(gains):
    """There the resistance to a turn is that of cohesion, which no friction explains."""
    options = {"plant": "distributed", "uncertainty": "nominal", "error_limit": 1e5}
    env = gymnasium.make("tracked_env:tracked_env/Torque-v0", duration=20.0, **options)
    truth = record_log(env, AdaptivePolicy(gains=gains), "patches.csv", seed=3)
    identified = identify(read(Path("patches.csv")), STRAWA)
    inertia = identified.parameters["inertia"]
    assert abs(inertia.value - truth["inertia"]) < 3.0 * inertia.deviation
    assert inertia.value == pytest.approx(truth["inertia"], rel=0.2)
    assert any("Cohesion of firm soil" in sentence for sentence in limitations(identified))
    assert parameter_set(identified)["make"]["vehicle"]["lateral_resistance"] <= 2.0


def test_accelerations_that_are_not_logged_are_derived(logs):
    """In three claimed deviations, and the yaw rate says as much as two accelerometers do."""
    for (path, truth), lacking in zip(
        logs, (ALL_ACCELERATIONS, ALL_ACCELERATIONS, ALL_ACCELERATIONS[2:]), strict=False
    ):
        columns = columns_of(path)
        for name in lacking:
            del columns[name]
        log = read(write(columns))
        assert any("slopes of straight lines" in note for note in log.notes)
        estimates = identify(log, STRAWA).parameters
        for name in PARAMETERS:
            assert abs(estimates[name].value - truth[name]) < 3.0 * estimates[name].deviation, name
    assert estimates["inertia"].deviation < 0.03 * truth["inertia"]


def test_motors_currents_and_other_units_are_those_of_the_sprockets(logs):
    columns = columns_of(logs[2][0])
    plain = read(write(columns))
    gear, constant = 20.0, 0.5
    other = dict(columns)
    other["yaw"] = np.degrees(columns["yaw"]) % 360.0
    other["x"] = 1e3 * columns["x"]
    for side in ("left", "right"):
        other[f"sprocket_speed_{side}"] = gear * columns[f"sprocket_speed_{side}"] / (np.pi / 30.0)
        other[f"current_{side}"] = other.pop(f"torque_{side}") / (0.9 * gear * constant)
    path = write(other, header=",".join(other).replace("yaw,", "heading [deg],"))
    drivetrain = {"gear": gear, "torque_per_ampere": constant, "efficiency": 0.9}
    log = read(path, {"sprocket_speed": "rpm", "x": "mm"}, **drivetrain)
    for name, column in plain.values.items():
        turns = 2.0 * np.pi * np.round((log.values[name] - column)[0] / (2.0 * np.pi))
        shift = turns if name == "yaw" else 0.0
        np.testing.assert_allclose(log.values[name] - shift, column, rtol=1e-6, atol=1e-5)


def test_rows_that_are_uneven_or_lost_are_placed_on_a_grid_and_said(logs):
    path, truth = logs[4]
    columns = columns_of(path)
    generator = np.random.default_rng(1)
    inner = 1 + np.sort(generator.choice(len(columns["time"]) - 2, 1455, False))
    rows = np.concatenate([[0], inner, [len(columns["time"]) - 1]])
    lost = read(write({name: column[rows] for name, column in columns.items()}))
    assert f"{len(columns['time']) - len(rows)} of them without a row" in " ".join(lost.notes)
    shifts = np.append(0.0, generator.uniform(-0.008, 0.008, len(rows) * 2))
    at = columns["time"] + shifts[: len(columns["time"])]
    uneven = {n: np.interp(at, columns["time"], c) for n, c in columns.items()} | {"time": at}
    log = read(write(uneven))
    assert "resampled" in " ".join(log.notes)
    for one in (lost, log):
        estimates = identify(one, STRAWA).parameters
        assert estimates["mass"].value == pytest.approx(truth["mass"], rel=0.03)


def test_a_pose_that_is_held_between_its_samples_is_no_new_sample(logs):
    columns = columns_of(logs[5][0])
    source = np.arange(len(columns["time"])) // 5 * 5
    for name in ("x", "y", "yaw", "v_x", "v_y"):
        columns[name] = columns[name][source]
    log = read(write(columns))
    assert log.fresh[:, 0].mean() == pytest.approx(0.2, abs=0.01)
    assert log.age[:, 0].max() == pytest.approx(0.08, abs=1e-6)


def test_a_slope_is_that_of_a_line_and_an_average_has_its_weights():
    """slopes(v) = averages(dv/dt) for any v that is a parabola, whose derivative is a line."""
    time = 0.02 * np.arange(60)
    speed = 1.0 + 2.0 * time + 3.0 * time**2
    np.testing.assert_allclose(
        vehicle_log.slopes(speed, 0.02, 5)[2:-2], (2.0 + 6.0 * time)[2:-2], atol=1e-9
    )
    np.testing.assert_allclose(
        vehicle_log.averages(2.0 + 6.0 * time, 5)[2:-2], (2.0 + 6.0 * time)[2:-2], atol=1e-9
    )


def test_an_interval_holds_noise_and_biases_of_either_sign():
    """Noise alone: 1.96 sigma. One large bias: it and 1.64 sigma, half of the noise is inside."""
    assert half_width(1.0, []) == pytest.approx(1.959964, abs=1e-5)
    assert half_width(1.0, [100.0]) == pytest.approx(101.644854, abs=1e-5)
    assert half_width(0.0, [2.0, 1.0]) == 3.0
    draw = np.random.default_rng(0)
    errors = draw.standard_normal(200_000) + draw.choice([-1.0, 1.0], 200_000) * 1.5
    assert np.mean(np.abs(errors) <= half_width(1.0, [1.5])) == pytest.approx(0.95, abs=0.003)


def test_the_bias_of_two_accelerometers_is_that_of_their_difference(logs):
    magnitudes = biases(read(logs[0][0]))
    assert magnitudes["yaw_acceleration"] == pytest.approx(np.sqrt(2.0) * RTK.acceleration_bias)


def test_an_interval_of_the_resistance_holds_the_bias_of_the_accelerometer(logs):
    """A bias b is taken for a resistance of b / g, however long the log is."""
    log = read(logs[0][0])
    none = log._replace(sensors=RTK._replace(acceleration_bias=0.0, gyro_bias=0.0))
    wide, narrow = (
        identify(one, STRAWA).parameters["longitudinal_resistance"] for one in (log, none)
    )
    more = 0.5 * (wide.high - wide.low) - 0.5 * (narrow.high - narrow.low)
    assert 0.5 < more / (RTK.acceleration_bias / 9.81) < 1.1


def test_record_writes_a_log_and_the_truth_and_leaves_missing_samples_empty(capsys):
    rare = '{"preset": "rtk", "pose_rate": 10}'
    options = ["--file", "a/l.csv", "--truth", "t.json", "--sensors", rare]
    assert main(["record", "adaptive", "--set", "payload", "--duration", "6", *options]) == 0
    assert "a/l.csv" in capsys.readouterr().out
    columns = columns_of(Path("a/l.csv"))
    assert np.mean(np.isfinite(columns["x"])) == pytest.approx(0.2, abs=0.01)
    assert np.isfinite(columns["torque_left"]).all()
    assert json.loads(Path("t.json").read_text())["mass"] > 0.0
    assert main(["record", "oracle", "--duration", "1"]) == 2
    assert "truth" in capsys.readouterr().err


def test_the_blocks_of_the_page_run_as_they_stand(repository):
    """In order, in one folder: what one block writes the next one reads."""
    text = (repository / "docs" / "your_data.md").read_text()
    blocks = re.findall(r"```(python|bash)\n(.*?)```", text, flags=re.DOTALL)
    assert [kind for kind, _ in blocks] == ["python", "bash", "python", "bash", "python"]
    for kind, block in blocks:
        if kind == "python":
            exec(compile(block, "your_data.md", "exec"), {})
            continue
        for line in block.splitlines():
            program, *arguments = shlex.split(line)
            assert program == "tracked-env" and main(arguments) == 0
    truth = json.loads(Path("truth.json").read_text())
    estimates = json.loads(Path("identified/parameters.json").read_text())["parameters"]
    assert estimates["mass"]["value"] == pytest.approx(truth["mass"], rel=0.03)
