"""Which plant reads which parameter: what is declared, what is measured, and what is refused."""

import numpy as np
import pytest

from tests.driving import run
from tracked_env import arrays as b
from tracked_env.engine.env_config import EnvConfig, make_solver
from tracked_env.engine.simulation import Simulation
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import GROUPS, PARAMETER_NAMES, RANGES, VEHICLES
from tracked_env.uncertainty import known_laws

# In the order of the columns of the table in docs/uncertainty.md.
VARIANTS = (
    {},
    {"lateral": "constrained"},
    {"plant": "distributed"},
    {"plant": "distributed", "drive": "speed"},
    {"plant": "terrain"},
    {"plant": "terrain", "drive": "speed"},
)
ARGUMENTS = {make_solver(EnvConfig(**given)).reads.plant: given for given in VARIANTS}
READS = {plant: make_solver(EnvConfig(**given)).reads.names for plant, given in ARGUMENTS.items()}
SLIDING, CONSTRAINED, BY_TORQUE, *_ = ARGUMENTS
UNREAD = [(plant, name) for plant in READS for name in PARAMETER_NAMES if name not in READS[plant]]
GROUP_OF = {name: group for group, names in GROUPS.items() for name in names}
# Full drive to the top speed, a turn, a pivot, reverse: 0.8 s each.
ACTIONS = np.repeat(np.float32([[1, 1], [0.2, 0.9], [-1, 1], [-1, -0.6]]), 40, axis=0)


def motion(plant, changed=None):
    """All rows of the state (T, STATE_ROWS), with one parameter of the truth overwritten."""
    calm = {"uncertainty": "nominal", "sensors": "ideal", "reference": "straight"}
    config = EnvConfig(**calm, error_limit=1e6, **ARGUMENTS[plant])
    simulation = Simulation(1, config)
    simulation.rngs = [np.random.default_rng(0)]
    # Past the check of the options, which is what this measurement is about.
    for name, value in (changed or {}).items():
        simulation.running.nominals[name] = value
    simulation.reset(simulation.all, [{"start": {"offset_x": 0.0, "offset_y": 0.0}}])
    rows = []
    for action in ACTIONS:
        simulation.step(action[None])
        rows.append(simulation.batch.floats[0, b.STATE : b.STATE + s.STATE_ROWS].copy())
    return np.array(rows)


@pytest.mark.parametrize("plant", READS)
def test_a_plant_reads_the_parameters_whose_range_ends_change_its_motion_and_no_others(plant):
    base = motion(plant)
    moved = set()
    for name in PARAMETER_NAMES:
        ends = [motion(plant, {name: end}) for end in (RANGES[name].low, RANGES[name].high)]
        if any(not np.array_equal(base, end, equal_nan=True) for end in ends):
            moved.add(name)
    assert moved == READS[plant]


def test_the_documented_table_lists_what_each_plant_reads(repository):
    lines = (repository / "docs/uncertainty.md").read_text().splitlines()
    first = next(n for n, line in enumerate(lines) if line.startswith("| parameter | lumped"))
    marked = {plant: set(PARAMETER_NAMES) for plant in READS}
    entries = [line.strip("|").split("|") for line in lines[first + 2 :]]
    for name, *marks in entries[: next(n for n, cells in enumerate(entries) if len(cells) < 2)]:
        assert {mark.strip() for mark in marks} == {"yes", "-"}, name
        for plant, mark in zip(READS, marks, strict=True):
            if mark.strip() == "-":
                marked[plant].remove(name.strip(" `"))
    assert marked == READS


@pytest.mark.parametrize("plant, name", UNREAD)
def test_an_option_a_schedule_or_a_range_without_effect_is_refused_by_name(plant, name):
    value = getattr(VEHICLES["strawa"], name)
    env = TrackedVehicleEnv(uncertainty="nominal", **ARGUMENTS[plant])
    event = {"parameter": name, "kind": "ramp", "target": value, "start": 1.0}
    refused = [{GROUP_OF[name]: {name: value}}]
    if name != "torque_limit":  # no schedule of any plant may change it
        refused.append({"schedule": [event]})
    says = rf"{name} = .*; the {plant} does not read it.*must be one of .*'mass'.*Did you mean"
    for options in refused:
        with pytest.raises(ValueError, match=says):
            env.reset(seed=0, options=options)
    for ranges in ({name: [value, value]}, ["nominal", {name: [value, value]}]):
        with pytest.raises(ValueError, match=says):
            TrackedVehicleEnv(uncertainty=ranges, **ARGUMENTS[plant])


@pytest.mark.parametrize("plant", READS)
def test_every_parameter_that_a_plant_reads_may_be_set_and_drawn(plant):
    for name in READS[plant]:
        value = getattr(VEHICLES["strawa"], name)
        changed = 1.02 * value if value else 0.02
        ranges = {"mass": [1450.0, 1450.0], name: [value, value]}
        env = TrackedVehicleEnv(uncertainty=ranges, expose_truth=True, **ARGUMENTS[plant])
        options = {GROUP_OF[name]: {name: changed}}
        assert env.reset(seed=0)[1]["truth"][name] == value
        assert env.reset(seed=0, options=options)[1]["truth"][name] == changed


@pytest.mark.parametrize("plant", READS)
@pytest.mark.parametrize("name", known_laws())
def test_a_set_draws_the_same_for_every_plant_and_changes_what_the_plant_reads(name, plant):
    def episodes_of(plant):
        simulation = Simulation(4, EnvConfig(uncertainty=name, **ARGUMENTS[plant]))
        simulation.rngs = [np.random.default_rng(i) for i in range(4)]
        simulation.reset(simulation.all, [None] * 4)
        return simulation.episodes

    for here, everywhere in zip(episodes_of(plant), episodes_of(CONSTRAINED), strict=True):
        assert here.parameters == everywhere.parameters
        assert here.noise_seed == everywhere.noise_seed
        assert here.state == everywhere.state
        both = READS[plant] & READS[CONSTRAINED]
        snapshot, its = (
            episode.events[[PARAMETER_NAMES[int(row[1])] in both for row in episode.events]]
            for episode in (here, everywhere)
        )
        np.testing.assert_array_equal(snapshot, its)
        assert {PARAMETER_NAMES[int(row[1])] for row in here.events} <= READS[plant]


def test_a_resistance_map_on_patches_varies_the_motion_resistance_alone():
    env = TrackedVehicleEnv(
        uncertainty="resistance-map",
        plant="distributed",
        sensors="ideal",
        reference="straight",
        expose_truth=True,
        error_limit=1e3,
    )
    readings = []
    for count in (1, 150):
        truth = run(env, count, np.full((count, 2), 0.3))[2]["truth"]
        readings.append((truth["longitudinal_resistance"], truth["lateral_resistance"]))
    (before, snapshot), (after, same) = readings
    assert abs(after - before) > 1e-3
    assert snapshot == same == VEHICLES["strawa"].lateral_resistance


def test_the_limit_in_which_an_action_is_measured_does_not_change_inside_an_episode():
    change = {"parameter": "sprocket_speed_limit", "kind": "ramp", "target": 10.0, "start": 1.0}
    for arguments in VARIANTS:
        env = TrackedVehicleEnv(uncertainty="nominal", **arguments)
        if arguments.get("drive") == "speed":
            with pytest.raises(ValueError, match=r"sprocket_speed_limit.*measured in it"):
                env.reset(seed=0, options={"schedule": [change]})
        else:
            env.reset(seed=0, options={"schedule": [change]})
