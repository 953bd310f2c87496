"""Arguments and options that make no sense: one line that says quantity, value, range and cause."""

import gymnasium
import numpy as np
import pytest

from tests.driving import assert_equal
from tracked_env import SPEED, TERRAIN
from tracked_env.env import TrackedVehicleEnv
from tracked_env.sb3 import make_vec_env
from tracked_env.sensors import Sensors
from tracked_env.validation import name_or_json
from tracked_env.vector_env import TrackedVehicleVectorEnv

NAN, INFINITE = float("nan"), float("inf")
NO_NUMBERS = [NAN, INFINITE, -INFINITE, True, "1", None, [1.0], 10**400, 1j]
NUMBERS = ("duration", "control_rate", "error_limit", "time_step")
COUNTS = ("num_envs", "threads", "max_episode_steps")
FLAGS = ("no", "True", 1, 0, 1.0, None, [])


def short(value):
    """A name of a test of readable length."""
    return str(value)[:24]


def refused(call, *says):
    """The message of the ValueError that `call` raises: one line with all of `says`."""
    with pytest.raises(ValueError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    for part in says:
        assert part in message, message
    return message


PATCHES = [
    None, 5, "10", {1: 2, 3: 4}, [10], [10, NAN], [INFINITE, 4], [True, 4], [10, None], [10, "4"],
    [10, 2.5], [0, 4], [10, 1000],
]  # fmt: skip
# Arguments, and parts of the message: what is said of the value, and what may be meant.
WRONG = [
    *(({name: value}, name, "must be a number in [") for name in NUMBERS for value in NO_NUMBERS),
    *(({"patches": patches}, "patches", "must be") for patches in PATCHES),
    *(({"plant": "distributed", "patches": patches}, "patches", "must be") for patches in PATCHES),
    ({"reference": "nowhere"}, "'nowhere'", "straight"),
    ({"reference": None}, "reference = None"),
    ({"uncertainty": "soil_and_mass"}, "unknown", "Did you mean 'soil-and-mass'"),
    ({"uncertainty": {"mass": [2000.0, 1000.0]}}, "low must be <= high"),
    ({"uncertainty": {"mass": 1500.0}}, "mass", "must be"),
    ({"uncertainty": None}, "uncertainty = None", "'nominal'"),
    ({"uncertainty": ["mixed", None]}, "uncertainty = None"),
    ({"uncertainty": 5}, "uncertainty = 5"),
    ({"sensors": "none"}, "unknown sensor preset", "known are"),
    ({"sensors": None}, "sensors = None", "'ideal'"),
    ({"sensors": 5}, "sensors = 5"),
    ({"sensors": Sensors(position_noise=NAN)}, "position_noise = nan"),
    ({"sensors": Sensors(pose_delay=3.0)}, "pose_delay = 3.0 s", "milliseconds"),
    ({"duration": -1.0}, "duration", "control steps"),
    ({"control_rate": 0.02}, "control_rate", "period"),
    ({"lateral": "slidin"}, "Did you mean 'sliding'"),
    ({"plant": "distributed", "lateral": "sideways"}, "sideways"),
    ({"plant": "distributed", "lateral": "constrained"}, 'lateral = "constrained"', '"sliding"'),
    ({**SPEED, "lateral": "constrained"}, 'lateral = "constrained"', '"sliding"'),
    ({"time_step": 0.05}, "time_step", "unstable"),
    ({"error_limit": 0.0}, "error_limit", "distance"),
    ({"render_mode": "ascii"}, "unknown render_mode"),
    ({"drive": "speed"}, 'drive = "speed"', "needs plant"),
    ({"drive": "sped"}, "Did you mean 'speed'"),
    ({"plant": "patches"}, "unknown plant 'patches'"),
    ({"vehicle": "tank"}, "unknown vehicle 'tank'"),
    ({"vehicle": {"mas": 80.0}}, "vehicle key 'mas'"),
    ({"vehicle": {"mass": 1.0}}, "mass = 1.0 kg"),
    ({"vehicle": {"base": "tank"}}, "vehicle base 'tank'"),
    ({**TERRAIN, "plant_options": {"tilt_limit": 90.0}}, "tilt_limit = 90.0 rad", "degrees"),
    ({**TERRAIN, "terrain": "moon"}, "unknown terrain kind 'moon'"),
    ({**TERRAIN, "terrain": {"kind": "plane", "slope_x": NAN}}, "slope_x = nan; must be"),
    *(({"reward": value}, "reward = ", "must be a name") for value in (None, 5, 0.7, [1.0])),
    ({"reward": "defalt"}, "unknown reward 'defalt'", "Did you mean 'default'"),
    ({"reward": {"positon": {}}}, "reward key 'positon'", "Did you mean 'position'"),
    ({"reward": {"position": 0.7}}, "reward position: = 0.7; must be a dict"),
    ({"reward": {"effort": {"scale": 1.0}}}, "reward effort: key 'scale'"),
    ({"reward": {"speed": {"scale": 0.0}}}, "reward speed scale = 0.0", "half its weight"),
    ({"reward": {"speed": {"weight": NAN}}}, "reward speed weight = nan"),
    ({"reward": lambda its: its.distance.mean()}, "shape ()", "must be (2,)", "average"),
    ({"reward": lambda its: its.action}, "shape (2, 2)", "must be (2,)"),
    ({"reward": lambda its: None}, "must be (2,) numbers", "return nothing"),
    ({"costs": 0.1}, "costs = 0.1; must be a dict"),
    ({"costs": {"tlit": 0.1}}, "costs key 'tlit'", "Did you mean 'tilt'"),
    ({"costs": {"tilt": 20.0}}, "costs tilt = 20.0 rad", "degrees"),
    ({"costs": {"slip": -0.1}}, "costs slip = -0.1", "[0, 1]"),
    ({"costs": {"torque": 3000.0}}, "costs torque = 3000.0", "share of the torque limit"),
    ({"costs": {"corridor": "1"}}, "costs corridor = '1'", "half the width"),
    ({"costs": {"obstacles": [3.0, 0.0, 1.0]}}, "costs obstacles", "outer list"),
    ({"costs": {"obstacles": [[3.0, 0.0, -1.0]]}}, "obstacle radius = -1.0 m"),
    ({"costs": {"obstacles": [[3.0, NAN, 1.0]]}}, "obstacle y = nan m"),
    ({"costs": {"slip": 0.1, "clearance": 1.0}}, "clearance is of obstacles"),
    ({"costs": {"budget": 25.0}}, "costs has no limit", "'obstacles'"),
    ({"costs": {"slip": 0.1, "budget": -1.0}}, "costs budget = -1.0"),
    ({"observation": "v9"}, "unknown observation 'v9'"),
    *(({"observation": spec}, "must be 'v0' or a list of groups") for spec in ([], {"a": 1}, 3)),
    ({"observation": ["motion", "moton"]}, "observation group 'moton'", "Did you mean 'motion'"),
    ({"observation": ["motion", "age", "motion"]}, "each group can be shown once"),
]


@pytest.mark.parametrize("kind", [TrackedVehicleEnv, TrackedVehicleVectorEnv])
@pytest.mark.parametrize(("arguments", "says"), [(a, says) for a, *says in WRONG], ids=short)
def test_a_wrong_argument_is_one_line_that_says_what_may_be_meant(kind, arguments, says):
    refused(lambda: kind(**arguments), *says)


@pytest.mark.parametrize("value", [*NO_NUMBERS, 1.5, 0, -1], ids=short)
@pytest.mark.parametrize("name", COUNTS)
def test_a_count_that_is_no_whole_number_is_refused(name, value):
    if value is None and name == "max_episode_steps":
        return  # no limit
    says = "must be a whole number" if value == 1.5 else "must be a number"
    refused(lambda: TrackedVehicleVectorEnv(**{name: value}), name, says, "[1, ")


def test_a_count_may_be_written_as_a_float_or_a_numpy_integer():
    env = TrackedVehicleVectorEnv(2.0, threads=np.int64(1), max_episode_steps=3.0)
    env.reset(seed=0)
    assert (env.num_envs, type(env.num_envs)) == (2, int)
    ends = [env.step(np.zeros((2, 2), np.float32))[3].all() for _ in range(3)]
    assert ends == [False, False, True]


@pytest.mark.parametrize("value", FLAGS, ids=short)
def test_a_flag_is_true_or_false_and_nothing_else(value):
    says = "must be True or False"
    for kind in (TrackedVehicleEnv, TrackedVehicleVectorEnv):
        refused(lambda kind=kind: kind(expose_truth=value), "expose_truth", says)
    env = TrackedVehicleVectorEnv(2)
    refused(lambda: env.reset(options={"staggered": value}), "staggered", says)
    refused(lambda: make_vec_env(n_envs=2, staggered=value), "staggered", says)
    refused(lambda: make_vec_env(n_envs=2, monitor=value), "monitor", says)


@pytest.mark.parametrize("seed", ["abc", 1.5, NAN, True, -1, [0, 1.5], [0, "1"], {}, [1, 2, 3]])
def test_a_seed_is_a_whole_number_or_one_per_row(seed):
    env = TrackedVehicleVectorEnv(2)
    refused(lambda: env.reset(seed=seed), "seed")
    assert env.simulation.rngs == [None, None]


def test_seeds_may_come_from_numpy():
    env = TrackedVehicleVectorEnv(2)
    first, _ = env.reset(seed=7)
    assert np.array_equal(first, env.reset(seed=np.array([7, 8]))[0])
    assert np.array_equal(first, env.reset(seed=[np.int64(7), 8])[0])


def test_an_unknown_autoreset_mode_names_those_that_exist():
    refused(lambda: TrackedVehicleVectorEnv(2, autoreset_mode="same"), "autoreset_mode", "SameStep")
    refused(lambda: TrackedVehicleVectorEnv(2, autoreset_mode=None), "autoreset_mode", "SameStep")


@pytest.mark.parametrize("kind", [TrackedVehicleEnv, TrackedVehicleVectorEnv])
def test_arguments_that_are_changed_after_construction_change_nothing(kind):
    def arguments():
        return {
            "reference": {"kind": "waypoints", "points": np.array([[0.0, 0.0], [9.0, 0.0]])},
            "uncertainty": [{"mass": [1200.0, 1300.0]}, {"cohesion": [5e3, 6e3]}],
            "sensors": {"preset": "ideal", "pose_delay": 0.1},
            "expose_truth": True,
        }

    changing = arguments()
    env, plain = kind(**changing), kind(**arguments())
    changing["reference"]["points"][1] = 0.0, 9.0
    changing["uncertainty"][0]["mass"][:] = 5000.0, 6000.0
    changing["uncertainty"].pop()
    changing["sensors"]["pose_delay"] = 0.9
    assert_equal(env.reset(seed=1), plain.reset(seed=1))
    changing["reference"].clear()
    assert_equal(env.reset(), plain.reset())


# --- vehicles without an episode ------------------------------------------------------------

ResetNeeded = gymnasium.error.ResetNeeded


@pytest.mark.parametrize("arguments", [{}, SPEED], ids=["torque", "speed"])
def test_a_vehicle_that_was_never_reset_cannot_be_stepped(arguments):
    env = TrackedVehicleEnv(**arguments)
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step(np.zeros(2, np.float32))
    many = TrackedVehicleVectorEnv(20, **arguments)
    with pytest.raises(ResetNeeded, match=r"vehicle 0 has no episode \(20 of 20 have none\)"):
        many.step(np.zeros((20, 2), np.float32))
    assert not many.simulation.batch.floats.any()
    many.reset(seed=0)
    assert np.isfinite(many.step(np.zeros((20, 2), np.float32))[1]).all()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_rows_that_the_first_mask_leaves_out_cannot_be_stepped(mode):
    env = TrackedVehicleVectorEnv(3, autoreset_mode=mode)
    actions = np.zeros((3, 2), np.float32)
    env.reset(seed=0, options={"reset_mask": np.array([True, False, True])})
    before = env.simulation.batch.floats.copy()
    with pytest.raises(ResetNeeded, match=r"vehicle 1 has no episode \(1 of 3"):
        env.step(actions)
    assert np.array_equal(before, env.simulation.batch.floats)
    env.reset(options={"reset_mask": np.array([False, True, False])})
    for _ in range(3):
        assert np.isfinite(env.step(actions)[1]).all()


def test_a_snapshot_of_vehicles_without_an_episode_leaves_them_without():
    env = TrackedVehicleVectorEnv(2)
    snapshot = env.simulation.snapshot()
    env.reset(seed=0)
    env.step(np.zeros((2, 2), np.float32))
    env.simulation.resume(snapshot)
    with pytest.raises(ResetNeeded, match="2 of 2"):
        env.step(np.zeros((2, 2), np.float32))


@pytest.mark.parametrize("depth", [80, 2000, 200_000])
@pytest.mark.parametrize("opened", ['{"a":', "["])
def test_json_that_is_nested_too_deeply_is_one_line(depth, opened):
    closed = "}" if opened == '{"a":' else "]"
    text = f'{{"kind": {opened * depth}1{closed * depth}}}'
    with pytest.raises(ValueError, match=r"--reference .*not a JSON object.*64 levels") as error:
        name_or_json(text, "reference")
    assert len(str(error.value)) < 300
    assert name_or_json('{"a": [[1]]}', "reference") == {"a": [[1]]}
