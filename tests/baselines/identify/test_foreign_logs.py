"""`tracked-env identify` on logs of a simulator that is not this package's, right and wrong."""

import gzip
import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from baselines.identify.csv_log import pairs, read_cells
from baselines.identify.identify_log import identify
from baselines.identify.log_torques import unit_moment
from baselines.identify.report_log import contradictions, limitations, parameter_set
from baselines.identify.vehicle_log import Drivetrain, read_log
from tests.baselines.identify import independent_vehicle
from tests.baselines.identify.independent_vehicle import Noise, Vehicle, drive, write
from tracked_env.cli.main import main
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import PRESETS

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

STRAWA, RTK = VEHICLES["strawa"], PRESETS["rtk"]
SPEEDS = ("sprocket_speed_left", "sprocket_speed_right")
TORQUES = ("torque_left", "torque_right")
POSE = ("x", "y", "yaw")
ACCELERATIONS = ("acceleration_x", "acceleration_y")
TRUE = {"mass": "mass", "inertia": "inertia"}
TRUE |= {"longitudinal_resistance": "mu_l", "lateral_resistance": "mu_t"}
HEAVY = Vehicle(30e3, 9e4, 2.7, 4.5, 0.5, 0.35, 0.08, 0.6, 2.5e5, torque_limit=8e4, speed=4.0)
LIGHT = Vehicle(62.0, 4.5, 0.606, 0.7, 0.1, 0.0856, 0.025, 0.4, 130.0, 1e-3)
LIGHT = LIGHT._replace(torque_limit=40.0, speed=0.6)
OF_HEAVY = STRAWA._replace(mass=28e3, inertia=8e4, track_gauge=2.7, contact_length=4.5)
OF_HEAVY = OF_HEAVY._replace(track_width=0.5, sprocket_radius=0.35, torque_limit=8e4)
SMALL_NOISE = {"position_noise": 0.005, "velocity_noise": 0.01, "torque_noise": 0.2}


@pytest.fixture(scope="module")
def log():
    """40 s of a vehicle of 1650 kg whose friction is smoothed over 5 mm/s."""
    return drive()


def identified_from(columns, nominal=STRAWA, sensors=RTK):
    path = write(columns)
    return identify(read_log(path, {}, {}, Drivetrain(), nominal, sensors), nominal)


RIGHT = {
    "forward": ({}, STRAWA, RTK, set(TRUE)),
    "in reverse": ({"kind": "reverse"}, STRAWA, RTK, set(TRUE)),
    "straight alone": ({"kind": "straight"}, STRAWA, RTK, {"mass", "longitudinal_resistance"}),
    "at 10 Hz": ({"rate": 10.0, "seed": 3}, STRAWA, RTK, set(TRUE)),
    "at 200 Hz": ({"rate": 200.0, "seed": 4, "duration": 20.0}, STRAWA, RTK, set(TRUE)),
    "of 30 t": ({"vehicle": HEAVY}, OF_HEAVY, RTK, set(TRUE)),
    "of 62 kg": (
        {"vehicle": LIGHT, "noise": Noise(0.005, velocity=0.01, torque=0.2)},
        VEHICLES["focchi"],
        RTK._replace(**SMALL_NOISE),
        set(),
    ),
}


# The others, but for one option.
LIKE = ("in reverse", "straight alone", "at 10 Hz", "at 200 Hz", "of 30 t")


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=[pytest.mark.slow] * (c in LIKE)) for c in RIGHT]
)
def test_a_right_log_determines_what_it_excites_and_holds_the_truth(case):
    options, nominal, sensors, excited = RIGHT[case]
    truth = options.get("vehicle", Vehicle())
    identified = identified_from(drive(**options), nominal, sensors)
    assert not contradictions(identified) and "make" in parameter_set(identified)
    for name, other in TRUE.items():
        of = identified.parameters[name]
        assert (of.verdict == "determined") or name not in excited, name
        if of.verdict != "not determined":
            assert abs(of.value - getattr(truth, other)) < 1.5 * (of.high - of.value), name


def test_pivots_and_a_payload_are_no_contradiction():
    assert not contradictions(identified_from(drive(kind="pivot")))
    loaded = identified_from(drive(payload=lambda time: 500.0 * (time > 20.0)))
    assert not contradictions(loaded) and loaded.parameters["mass"].changed
    assert "changed" in " ".join(limitations(loaded))


@pytest.mark.parametrize(("more", "from_time"), [(80.0, 20.0), (150.0, 10.0), (150.0, 28.0)])
def test_a_small_load_that_is_taken_on_within_the_log_is_no_single_mass(more, from_time):
    """One mass for all of it would be 2 to 5 % off, with an interval of 1 %."""
    identified = identified_from(drive(payload=lambda time: more * (time > from_time), seed=1))
    mass, truth = identified.parameters["mass"], Vehicle().mass + more
    assert mass.changed
    assert mass.low < truth < mass.high
    assert "changed" in " ".join(limitations(identified))


def turned(columns, *names):
    return columns | {name: -columns[name] for name in names}


def scaled(columns, factor, *names):
    return columns | {name: factor * columns[name] for name in names}


def swapped(columns, first, second):
    return columns | {first: columns[second], second: columns[first]}


def late(columns, steps, *names):
    before = np.maximum(np.arange(len(columns["time"])) - steps, 0)
    return columns | {name: columns[name][before] for name in names}


def frozen(columns, name, row):
    return columns | {name: columns[name][np.minimum(np.arange(len(columns[name])), row)]}


def without(columns, *names):
    return {name: column for name, column in columns.items() if name not in names}


def jumping(columns, seconds):
    time = columns["time"] + np.where(np.arange(len(columns["time"])) >= 1000, seconds, 0.0)
    return columns | {"time": time}


WRONG = {
    "torques reversed": (lambda c: turned(c, *TORQUES), "torque_right have the wrong sign"),
    "left torque reversed": (lambda c: turned(c, TORQUES[0]), "torque_left has the wrong sign"),
    "right torque reversed": (lambda c: turned(c, TORQUES[1]), "torque_right has the wrong sign"),
    "torques swapped": (lambda c: swapped(c, *TORQUES), "are swapped"),
    "torques swapped, reversed": (lambda c: swapped(turned(c, *TORQUES), *TORQUES), "swapped and"),
    "kN m": (lambda c: scaled(c, 1e-3, *TORQUES), "--units torque=kN m"),
    "left torque in kN m": (lambda c: scaled(c, 1e-3, TORQUES[0]), "times torque_right"),
    "torques of the motors": (lambda c: scaled(c, 1 / 34, *TORQUES), "--gear RATIO"),
    "per cent": (lambda c: scaled(c, 1 / 80, *TORQUES), "per cent"),
    "torque zero": (lambda c: scaled(c, 0.0, *TORQUES), "without a change"),
    "torque frozen": (lambda c: frozen(c, TORQUES[1], 1200), "torque_right is"),
    "torque twice": (lambda c: c | {TORQUES[0]: c[TORQUES[1]]}, "the same in every row"),
    "torques late": (lambda c: late(c, 25, *TORQUES), "later than logged"),
    "sprockets swapped": (lambda c: swapped(c, *SPEEDS), "left and right swapped"),
    "left sprocket reversed": (lambda c: turned(c, SPEEDS[0]), "sprocket_speed_left is negative"),
    "sprockets in rpm": (lambda c: scaled(c, 9.549, *SPEEDS), "rpm"),
    "sprocket frozen": (lambda c: c | {SPEEDS[0]: np.full(len(c["time"]), 3.0)}, "must change"),
    "yaw and gyro in deg": (lambda c: scaled(c, 20.0, "yaw", "yaw_rate"), "as its belts say"),
    "compass": (lambda c: turned(c, "yaw"), "positive to the right"),
    "heading from y": (lambda c: c | {"yaw": c["yaw"] + 1.57}, "deg from yaw"),
    "x and y swapped": (lambda c: swapped(c, "x", "y"), "x and y swapped"),
    "hull turned": (lambda c: c | {"yaw": c["yaw"] + np.pi}, "yaw turned"),
    "accelerometer in g": (lambda c: scaled(c, 1 / 9.81, "acceleration_x"), "acceleration_x=g"),
    "accelerometer reversed": (lambda c: turned(c, "acceleration_x"), "positive forward"),
    "accelerometer swapped": (lambda c: swapped(c, *ACCELERATIONS), "another column"),
    "vertical axis": (lambda c: c | {"acceleration_y": c["acceleration_y"] + 9.81}, "gravity"),
    "v_y to the right": (lambda c: turned(c, "v_y"), "positive to the left"),
    "pose late": (lambda c: late(c, 100, *POSE), "2 s after yaw_rate"),
    "position late": (lambda c: late(c, 100, "x", "y"), "2 s after the sprockets"),
    "clock jump": (lambda c: jumping(c, 1e9), "the clock jumps"),
    "clock backward": (lambda c: jumping(c, -15.0), "does not rise"),
    "yaw in deg": (lambda c: scaled(c, 57.3, "yaw"), "--units yaw=deg"),
    "gyro in deg/s": (lambda c: scaled(c, 57.3, "yaw_rate"), "yaw_rate=deg/s"),
    "gyro reversed": (lambda c: turned(c, "yaw_rate"), "positive to the left"),
    "mm": (lambda c: scaled(c, 1e3, "x", "y"), "x=mm,y=mm"),
    "time in ms": (lambda c: scaled(c, 1e3, "time"), "--units time=ms"),
    "torques in N mm": (lambda c: scaled(c, 1e3, *TORQUES), "torque_left reaches"),
    "no torques": (lambda c: without(c, *TORQUES), "lacks torque_left"),
    "no gyro": (lambda c: without(c, "yaw_rate"), "lacks yaw_rate"),
    "too short": (lambda c: {name: column[:100] for name, column in c.items()}, "lasts"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_log_is_refused_before_anything_is_fitted(case, log, capsys):
    change, said = WRONG[case]
    path = write(change(log))
    assert main(["identify", str(path), "--vehicle", "strawa", "--output", "out"]) == 2
    message = capsys.readouterr().err
    assert said in message and message.count("\n") == 1
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("name", "factor"),
    [("track_gauge", 2.0), ("sprocket_radius", 0.5), ("sprocket_radius", 2.0), ("mass", 10.0)],
)
def test_a_log_of_another_vehicle_is_refused(name, factor, log):
    with pytest.raises(ValueError, match="--vehicle"):
        identified_from(log, STRAWA._replace(**{name: factor * getattr(STRAWA, name)}))


def test_residuals_that_follow_each_other_give_no_vehicle(log, capsys):
    """Torques without their sign: no other sign or side explains them better."""
    unsigned = log | {name: np.abs(log[name]) for name in TORQUES}
    assert main(["identify", str(write(unsigned)), "--vehicle", "strawa", "--output", "out"]) == 1
    terminal = capsys.readouterr()
    assert "contradicted" in terminal.out and "contradicts the model" in terminal.err
    result = json.loads(Path("out/parameters.json").read_text())
    assert result["contradictions"] and "make" not in result and "ranges" not in result
    assert main(["identify", "log.csv", "--vehicle", "out/parameters.json"]) == 2
    assert "has no vehicle" in capsys.readouterr().err


def test_a_mass_at_the_bound_of_its_search_is_not_determined(log):
    identified = identified_from(log)
    mass = identified.parameters["mass"]._replace(against="at its bound")
    bounded = identified._replace(parameters=identified.parameters | {"mass": mass})
    assert mass.verdict == "at its bound" and "make" not in parameter_set(bounded)


FRICTIONS = [*product(("algebraic", "tanh"), (0.005, 0.03, 0.1))]
WIDEST = "tanh", 0.1


@pytest.mark.parametrize(
    ("law", "smoothing"),
    [pytest.param(*of, marks=[pytest.mark.slow] * (of != WIDEST)) for of in FRICTIONS],
)
def test_mu_t_is_right_whatever_smooths_the_friction(law, smoothing):
    """The estimators have one shape and 3 cm/s; without the fit mu_t was 4 and 9 % off."""
    truth = Vehicle(smoothing=smoothing, law=law)
    of = identified_from(drive(truth, seed=20)).parameters["lateral_resistance"]
    assert of.low <= truth.mu_t <= of.high and of.high - of.low < 0.15 * truth.mu_t


@pytest.mark.parametrize("width", [0.002, 0.03, 0.2])
def test_the_moment_in_closed_form_is_its_quadrature(width):
    vehicle, nodes = Vehicle(smoothing=width), np.linspace(-1.0, 1.0, 200_001)
    v_y, rate = np.array([[0.0, 0.1, -0.3], [0.2, -0.5, 0.4]])
    pairs = zip(v_y, rate, strict=True)
    expected = [
        np.mean(nodes * independent_vehicle.friction(v + w * nodes, vehicle)) for v, w in pairs
    ]
    np.testing.assert_allclose(unit_moment(v_y, rate, 2.0, width, 0.0), expected, atol=2e-5)


ROWS = np.array([[0.0, 0.0, 0.0], [1.0, 2.5, -3.25], [2.0, 1e-3, 1234.5], [3.0, 7.5, 0.125]])


def table(separator, decimal=".", end="\n", number="{:.6g}"):
    rows = ([number.format(v).replace(".", decimal) for v in row] for row in ROWS)
    return "".join(separator.join(line) + end for line in (["time", "x", "y"], *rows))


FILES = {
    "commas": table(",").encode(),
    "semicolons that begin with whole numbers": table(";", ",").encode(),
    "tabs and decimal commas": table("\t", ",").encode(),
    "blanks and decimal commas": table("  ", ",").encode(),
    "commas and blanks": table(", ").encode(),
    "bars": table("|").encode(),
    "byte order mark": b"\xef\xbb\xbf" + table(",").encode(),
    "UTF-16": table("\t").encode("utf-16"),
    "CR LF": table(";", end="\r\n").encode(),
    "separator at the end": table(",", end=",\n").encode(),
    "semicolon at the end": table(";", ",", end=";\n").encode(),
    "exponents with decimal commas": table(";", ",", number="{:.9e}").encode(),
    "comments": ("# device 7\n" + table(",") + "# end, 3\n").encode(),
    "sep= of a spreadsheet": ("sep=;\n" + table(";", ",")).encode(),
    "line of units": table(",").replace("y\n", "y\ns,m,m\n", 1).encode(),
    "header twice": (table(",") + "time,x,y\n").encode(),
    "quotes": table(",").replace("2.5", '"2.5"').encode(),
    "quoted decimal commas": "\n".join(
        ["time,x,y", *(",".join(f'"{v:.6g}"'.replace(".", ",") for v in row) for row in ROWS)]
    ).encode(),
    "gzip": gzip.compress(table(",").encode()),
}


@pytest.mark.parametrize("case", FILES)
def test_a_file_is_read_the_same_however_it_is_written(case):
    path = Path("file.csv")
    path.write_bytes(FILES[case])
    cells = read_cells(path)
    assert cells.header == ["time", "x", "y"] and not cells.unreadable and not cells.truncated
    np.testing.assert_allclose(cells.numbers, ROWS, rtol=1e-5)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"# only\n", "is empty"),
        (b"a;b\n1.50;2,5\n", "decimal"),
        (b"a,b\n1,5,2,5\n1,25,3,75\n", "decimal commas between commas"),
        (b"\x1f\x8bnothing", "damaged gzip"),
    ],
)
def test_a_file_that_says_nothing_or_two_things_is_refused(content, said):
    Path("file.csv").write_bytes(content)
    with pytest.raises(ValueError, match=said):
        read_cells(Path("file.csv"))


def test_a_cell_that_is_empty_or_text_and_a_short_line_are_nan():
    Path("file.csv").write_text("a,b,c\n1,2,3\n1,none,\n2")
    cells = read_cells(Path("file.csv"))
    np.testing.assert_array_equal(
        cells.numbers, [[1, 2, 3], [1, np.nan, np.nan], [2, np.nan, np.nan]]
    )
    assert cells.unreadable == [(3, 1, "none")] and cells.truncated == 1


def test_a_row_whose_time_is_text_is_named_on_the_terminal(log, capsys):
    lines = write(log).read_text().splitlines()
    lines[500] = "yesterday," + lines[500].partition(",")[2]
    Path("log.csv").write_text("\n".join(lines))
    assert main(["identify", "log.csv", "--vehicle", "strawa", "--output", "out"]) == 0
    assert "Line 501: time is 'yesterday'" in capsys.readouterr().out


def test_names_that_stand_twice_are_refused(log):
    with pytest.raises(ValueError, match="x stands there twice"):
        pairs("x=y,x=yaw", "--columns")
    path = write(log)
    with pytest.raises(ValueError, match="are both column yaw"):
        read_log(path, {"x": "yaw", "y": "yaw"}, {}, Drivetrain(), STRAWA, RTK)
    header, _, rest = path.read_text().partition("\n")
    path.write_text(header.replace("v_y", "v_x") + "\n" + rest)
    with pytest.raises(ValueError, match="2 columns v_x, at the positions 5, 6"):
        read_log(path, {}, {}, Drivetrain(), STRAWA, RTK)


@pytest.mark.parametrize("command", ["identify", "slip"])
def test_an_output_that_is_a_file_is_refused_before_the_log_is_read(command, capsys):
    Path("taken").write_text("")
    with pytest.raises(SystemExit) as end:
        main([command, "log.csv", "--vehicle", "focchi", "--output", "taken/below"])
    assert end.value.code == 2 and "is a file; must be a folder" in capsys.readouterr().err
