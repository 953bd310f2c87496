"""What a vehicle can do, in closed form, against the simulated lumped plant; the catalogue."""

import math
import re

import pytest

from tracked_env.physics.parameters import GROUPS, RANGES, VEHICLES
from tracked_env.plants.standalone import Rig
from tracked_env.vehicles import FILES, find_vehicle, vehicle_names
from tracked_env.vehicles.abilities import abilities, contradictions

CATALOGUE = sorted(path.stem for path in FILES.glob("*.toml"))
ALL = [*VEHICLES, *CATALOGUE]
M113 = find_vehicle("m113")
FLOOR = M113._replace(cohesion=0.0, friction_angle=math.atan(0.4))  # carries less than the drives


def driven(parameters, *torques, duration=5.0):
    """The lumped plant after `duration` [s] from rest, a vehicle for each (left, right) [N m]."""
    rig = Rig("lumped", parameters, count=len(torques))
    rig.advance(torques, duration)
    return rig.state


@pytest.mark.parametrize("name", ALL)
def test_the_turning_torque_separates_a_turn_on_the_spot_from_creep(name):
    p = find_vehicle(name)
    torque = abilities(p).turning_torque
    left = driven(p, *((-share * torque, share * torque) for share in (0.95, 1.05)))
    right = driven(p, (1.05 * torque, -1.05 * torque))
    creep, turn = 0.5 * p.contact_length * left.yaw_rate  # [m/s] the tracks' ends slide
    assert 0.0 < creep < 0.1 < 0.3 < turn  # friction is smoothed below 0.1 m/s
    assert right.yaw_rate[0] == pytest.approx(-left.yaw_rate[1])
    assert abs(left.x[1]) < 1e-6


@pytest.mark.parametrize(
    "name", [n for n in ALL if abilities(find_vehicle(n)).steepest_grade < 1.5]
)
def test_the_steepest_grade_can_just_be_climbed(name):
    """Level ground with the forces of a grade: less weight on it, and gravity as a resistance."""
    p = find_vehicle(name)
    climbs = []
    for share in (0.995, 1.005):
        grade = share * abilities(p).steepest_grade
        resistance = p.longitudinal_resistance + math.tan(grade)
        on_grade = p._replace(mass=p.mass * math.cos(grade), longitudinal_resistance=resistance)
        state = driven(on_grade, (p.torque_limit, p.torque_limit))
        climbs.append(state.v_x[0] > 0.01)
    assert climbs == [True, False]


def test_a_vehicle_whose_effort_exceeds_all_resistance_climbs_any_grade():
    p = VEHICLES["strawa"]
    able, weight = abilities(p), p.mass * 9.81
    cohesive = p.cohesion * p.track_width * p.contact_length  # [N] also where no weight is left
    assert 2.0 * min(able.drive_effort, cohesive) > weight * math.hypot(
        1.0, p.longitudinal_resistance
    )
    assert able.steepest_grade == pytest.approx(0.5 * math.pi)
    stuck = M113._replace(longitudinal_resistance=1.5)
    assert abilities(stuck).steepest_grade == 0.0


@pytest.mark.parametrize("name", ALL)
def test_full_torque_drives_at_the_top_speed(name):
    p = find_vehicle(name)
    state = driven(p, (p.torque_limit, p.torque_limit), duration=60.0)
    assert state.v_x[0] == pytest.approx(abilities(p).top_speed, rel=0.01)


@pytest.mark.parametrize("p", [M113, FLOOR], ids=["limited by the drives", "by the soil"])
def test_full_torque_accelerates_as_the_closed_form_says(p):
    able, torques = abilities(p), (p.torque_limit, p.torque_limit)
    assert (able.drive_effort < able.traction) == (p is M113)
    early, late = (driven(p, torques, duration=time).v_x[0] for time in (1.5, 2.0))
    assert (late - early) / 0.5 == pytest.approx(able.acceleration, rel=0.01)


def test_the_ground_pressure_of_the_m113_is_that_of_its_imperial_data_sheet():
    pressure = 22_900 / (2 * 15 * 105)  # [psi] weight over two tracks of 15 x 105 in
    assert abilities(M113).ground_pressure / 6894.76 == pytest.approx(pressure, rel=0.005)


def test_left_and_right_are_alike_and_the_weaker_drive_counts():
    weak_left = M113._replace(actuator_gain_left=0.7)
    weak_right = M113._replace(actuator_gain_right=0.7)
    assert abilities(weak_left) == abilities(weak_right)
    assert abilities(weak_left).drive_effort == pytest.approx(0.7 * abilities(M113).drive_effort)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_grades_and_shares_do_not_depend_on_the_size(scale):
    """Lengths as s, masses as s^3, torques as s^4, cohesion as s: all forces as the weight."""
    powers = {"mass": 3, "inertia": 5, "torque_limit": 4, "cohesion": 1, "sprocket_inertia": 5}
    lengths = ("track_gauge", "track_width", "contact_length", "sprocket_radius")
    powers |= dict.fromkeys((*lengths, "shear_deformation_modulus"), 1)
    other = M113._replace(**{n: getattr(M113, n) * scale**power for n, power in powers.items()})
    for name in ("turning_share", "steepest_grade", "acceleration"):
        expected = getattr(abilities(M113), name)
        assert getattr(abilities(other), name) == pytest.approx(expected), name


@pytest.mark.parametrize("name", ALL)
def test_nothing_contradicts_itself_in_a_vehicle_of_this_package(name):
    assert contradictions(find_vehicle(name)) == []


@pytest.mark.parametrize("name", CATALOGUE)
def test_each_number_of_the_catalogue_has_its_unit_and_where_it_is_from(name):
    text = (FILES / f"{name}.toml").read_text(encoding="utf-8")
    assert re.search(r'^title = ".+"$', text, re.MULTILINE)
    source = re.search(r'^source = "(.+)"$', text, re.MULTILINE)
    numbers = re.findall(r"^(\w+) = [-\d.e]+(?:  # \[(.+?)\] ?(.*))?$", text, re.MULTILINE)
    named = [parameter for parameter, _, _ in numbers]
    assert set(named) >= {*GROUPS["vehicle"][:10], *GROUPS["soil"][:5]}
    pages = re.findall(r"^# (\[\d\]) .+, (https?://\S+)$", text, re.MULTILINE)
    assert source and len({address for _, address in pages}) == len(pages)
    for parameter, unit, origin in numbers:
        assert unit == RANGES[parameter].unit, parameter
        assert origin.startswith(("estimated", *(page for page, _ in pages))), parameter
    origins = " ".join(origin for _, _, origin in numbers)
    assert all(page in origins for page, _ in pages)  # each is what a number is from


def test_the_catalogue_has_its_names():
    assert set(ALL) <= set(vehicle_names()) and len(CATALOGUE) == 15


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"torque_limit": 100.0}, "cannot move on its soil: a track gives 412.2 N by its drive"),
        ({"torque_limit": 5000.0}, "can hardly turn .* 96% of .* before the gear"),
        ({"inertia": 2670.0}, r"over that of a box .* = 0\.227 .* box of this mass has 1\.18e\+04"),
        (
            {"contact_length": 4.5, "lateral_resistance": 0.3},
            r"over track_gauge = 2\.08 -; usual is",
        ),
        ({"track_width": 2.5}, r"track_width over track_gauge = 1\.16 .* the tracks overlap"),
        (
            {"mass": 62.0, "inertia": 160.0, "sprocket_inertia": 1.0},
            "ground pressure = 299 Pa; usual",
        ),
        ({"sprocket_inertia": 6000.0}, r"over the mass = 9\.8 -; .* the gear ratio squared"),
    ],
)
def test_what_does_not_fit_together_is_said_with_the_numbers(changes, sentence):
    (found,) = contradictions(M113._replace(**changes))
    assert re.search(sentence, found), found
