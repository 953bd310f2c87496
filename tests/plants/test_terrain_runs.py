"""The plant on terrain against converged reference runs, and against a second implementation."""

import json

import numpy as np
import pytest

from tests.physics.world_axes_plant import euler_run
from tests.plants.terrain_runs import difference, rig_of, run
from tracked_env.plants.terrain import LONGEST_STEP

NAMES = (
    "01_up10_mu0.4_nonuniform",
    "07_sideturn10_mu0.4_uniform",
    "09_field_mu0.6_nonuniform",
)
VEHICLE = {
    "m": 62.0, "inertia": [2.18, 2.81, 4.5], "com_height": 0.25, "track_length": 0.7,
    "track_gauge": 0.606, "track_width": 0.1, "sprocket_radius": 0.0856, "patches_along": 10,
    "patches_across": 4,
}  # fmt: skip
SOIL = {
    "mu": 0.5, "cohesion_Pa": 0.0, "shear_modulus_m": 0.001, "stiffness_N_per_m3": 1e5 / 0.07,
    "damping_Ns_per_m3": 5e3 / 0.07, "rolling_resistance": 0.0, "stiffening_s_per_m2": 0.0,
}  # fmt: skip
WAVES = [[0.06, 1.1, 0.4, 0.3], [0.05, -0.5, 1.2, 1.0], [0.04, 1.7, -0.9, 2.1]]


def reference(folder, name):
    """(dict of the run, rows as `run` gives them)."""
    data = folder / "terrain"
    if not (data / "runs.json").is_file():
        pytest.skip(f"no reference runs on terrain in {data}")
    spec = json.loads((data / "runs.json").read_text())[name]
    return spec, np.loadtxt(data / f"{name}.csv", delimiter=",", skiprows=1)[:, 3:]


@pytest.mark.parametrize("name", NAMES)
def test_runs_repeat_converged_runs_and_the_default_step_costs_a_millimetre_at_most(
    name, reference_data
):
    spec, truth = reference(reference_data, name)
    result = run(spec, 2.5e-4)
    distance, rotation = difference(result, truth)
    assert distance < 0.3 and rotation < 0.1
    assert np.abs(result[:, 13] - truth[:, 13]).max() < 1.0
    assert result[0, 3:7] == pytest.approx(truth[0, 3:7], abs=1e-9)
    distance, rotation = difference(run(spec, LONGEST_STEP), truth)
    assert distance < 1.0 and rotation < 1.0


def case(load, terrain, left, right, soil=None, vehicle=None, duration=1.0):
    """A run from rest, belts linear in time from 0 to `left`, `right` and half way back."""
    command = {"t": [0.0, 0.5, 1.0], "L": [0.0, left, 0.5 * left], "R": [0.0, right, 0.5 * right]}
    return {
        "vehicle": {**VEHICLE, **(vehicle or {})}, "soil": {**SOIL, **(soil or {})}, "load": load,
        "terrain": terrain, "command": command, "duration": duration,
        "initial": {"p": [0.0, 0.0, 0.25], "q": [1.0, 0.0, 0.0, 0.0]},
    }  # fmt: skip


def standing(spec):
    """The run from where its vehicle stands on the ground."""
    rig = rig_of(spec, 1e-3)
    rig.stand(0.0, 0.0, 0.2)
    p, q = rig.positions[0], rig.quaternions[0]
    return {**spec, "initial": {"p": p.tolist(), "q": q.tolist()}}


CASES = {
    "cohesion": case("nonuniform", {"a": 0.2}, 4, 6, {"cohesion_Pa": 900.0}),
    "rolling": case("nonuniform", {"sines": WAVES}, 5, 3, {"rolling_resistance": 0.06}),
    "stiffening": case("nonuniform", {"a": 0.1}, 6, 4, {"stiffening_s_per_m2": 5.5}),
    "ramp": case("nonuniform", {"ramp": [0.4, 0.1, 0.4]}, 5, 5.5),
    "step": case("nonuniform", {"step": [0.08, 0.2, 0.4]}, 5, 4.5),
    "uniform step": case("uniform", {"step": [0.06, 0.1, 0.5]}, 5, 5),
    "tipping": case("uniform", {"a": 0.62}, 3, 3, {"mu": 0.9}, {"com_height": 0.6}, 0.25),
    "reverse": case("nonuniform", {"sines": WAVES}, -5, -3.5),
    "through zero": case("nonuniform", {"a": 0.1, "b": 0.1}, 4, -4),
    "other vehicle": case(
        "uniform", {"a": -0.2}, 4, 5, {"shear_modulus_m": 0.004},
        {"m": 90.0, "track_length": 0.5, "patches_along": 7, "patches_across": 3},
    ),
    "shifted mass": case(
        "nonuniform", {"sines": WAVES}, 5, 4, {"stiffening_s_per_m2": 3.0},
        {"shift": [0.08, -0.05, 0.06]},
    ),
    "shifted mass, uniform": case(
        "uniform", {"sines": WAVES}, 4, -3, {"rolling_resistance": 0.04},
        {"shift": [-0.06, 0.07, -0.04]},
    ),
}  # fmt: skip


# [s] steps of the second implementation, the coarse ones; where contact changes they are short
STEPS = {"ramp": 2e-4, "tipping": 2e-4}
STEPS |= dict.fromkeys(("reverse", "other vehicle", "shifted mass"), 5e-4)

# Their ground, soil and way are also those of other cases, or they take many steps.
SLOW = ("rolling", "stiffening", "ramp", "reverse", "through zero")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in CASES]
)
def test_a_second_implementation_in_world_axes_drives_the_same_way(name):
    spec = standing(CASES[name])
    step = STEPS.get(name, 1e-3)
    coarse, fine = euler_run(spec, step), euler_run(spec, 0.5 * step)
    truth = 2.0 * fine - coarse  # of order one
    result = run(spec, 2.5e-4)
    distance, rotation = difference(result, truth)
    assert distance < 0.1 and rotation < 0.1
    distance, rotation = difference(run(spec, LONGEST_STEP), truth)
    assert distance < 1.0 and rotation < 1.0
    assert np.median(np.abs(result[:, 13] - truth[:, 13])) < 0.5
    assert np.median(np.abs(result[:, 14] - truth[:, 14])) < 0.1


def test_the_uniform_load_says_where_a_vehicle_would_tip():
    for name, expected in (("tipping", True), ("uniform step", False)):
        rig = rig_of(standing(CASES[name]), 1e-3)
        readings = False
        for _ in range(50):
            rig.advance([[3.0, 3.0]], 0.02)
            readings |= bool(rig.saturated[0])
        assert readings == expected


def test_halving_the_step_divides_the_error_by_more_than_two_and_a_half():
    spec = standing(case("nonuniform", {"sines": WAVES}, 4, 5, {"shear_modulus_m": 0.05}))
    truth = run(spec, 6.25e-5)
    errors = [difference(run(spec, h), truth)[0] for h in (5e-3, 2.5e-3, 1.25e-3)]
    assert errors[0] / errors[1] > 2.5
    assert errors[1] / errors[2] > 2.5


def test_finer_patches_converge(reference_data):
    spec, _ = reference(reference_data, NAMES[2])
    truth = run(spec, 1e-3, 3.0, patches=(80, 8))
    coarse = difference(run(spec, 1e-3, 3.0, patches=(10, 4)), truth)
    fine = difference(run(spec, 1e-3, 3.0, patches=(40, 4)), truth)
    assert 1.0 < coarse[0] < 15.0
    assert fine[0] < 0.4 * coarse[0]
