"""The step of one vehicle and of a batch: what is prepared once per environment stays right."""

import copy

import gymnasium
import numpy as np
import pytest

from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.env import TrackedVehicleEnv
from tracked_env.sb3 import TrackedVehicleVecEnv
from tracked_env.step import INFO_KEYS
from tracked_env.vector_env import TrackedVehicleVectorEnv

CRUISE = np.array([0.2, 0.25], np.float32)
LATE = {"preset": "rtk", "pose_delay": 0.2}  # makes the history of samples longer
CHANGES = [{"parameter": "mass", "kind": "ramp", "target": 2500.0, "start": 0.1}] * 3


def steps(env, count, action=CRUISE):
    """What `count` steps return."""
    return [env.step(action) for _ in range(count)]


def assert_same_steps(ours, theirs):
    assert len(ours) == len(theirs) > 0
    for one, other in zip(ours, theirs, strict=True):
        assert one[1:4] == other[1:4] and one[4].keys() == other[4].keys()
        assert np.array_equal(one[0], other[0])
        for key in one[4]:
            assert np.array_equal(one[4][key], other[4][key]), key


@pytest.mark.parametrize("env_id", [TORQUE_ID, SPEED_ID])
def test_what_a_step_returns_is_never_changed_by_a_later_step_or_reset(env_id):
    env = gymnasium.make(env_id).unwrapped
    first = env.reset(seed=0)
    snapshot = [(o, i, o.copy(), copy.deepcopy(i)) for o, i in [first]]
    for k in range(70):  # past the end of a noise block
        observation, *_, info = env.step(CRUISE)
        snapshot.append((observation, info, observation.copy(), copy.deepcopy(info)))
        if k % 30 == 29:
            env.reset()
    for observation, info, then, measured_values in snapshot:
        assert np.array_equal(observation, then)
        assert all(np.array_equal(info[key], measured_values[key]) for key in measured_values)
        assert info["tracking_error"].base is None and observation.base is None


def test_the_info_of_a_step_has_plain_numbers_by_the_names_of_the_reward_s_terms():
    env = TrackedVehicleEnv()
    env.reset(seed=0)
    *_, reward, terminated, truncated, info = env.step(CRUISE)
    assert [key for key in info if key.startswith("reward_")] == [*INFO_KEYS]
    assert {type(reward), *(type(info[key]) for key in INFO_KEYS)} == {float}
    assert {type(terminated), type(truncated), type(info["is_success"])} == {bool}
    terms = env.simulation.report().terms
    assert [info[key] for key in INFO_KEYS] == [float(term[0]) for term in terms]


@pytest.mark.parametrize("options", [{"sensors": LATE}, {"schedule": CHANGES}])
def test_a_step_after_a_reset_that_widens_the_arrays_is_that_of_a_fresh_environment(options):
    env, fresh = TrackedVehicleEnv(), TrackedVehicleEnv()
    env.reset(seed=1)
    steps(env, 20)
    for one in (env, fresh):
        one.reset(seed=5, options=options)
    assert_same_steps(steps(env, 100), steps(fresh, 100))


def test_an_ended_vehicle_that_is_stepped_on_keeps_its_flags_up():
    env = TrackedVehicleEnv(duration=0.2)
    env.reset(seed=0, options={"start": {"offset_x": 0.0, "offset_y": 0.0}})
    flags = [step[2:4] for step in steps(env, 14)]
    assert flags == [(False, False)] * 9 + [(False, True)] * 5
    assert env.simulation.ended[0]
    env.reset()
    assert not env.simulation.ended[0] and steps(env, 1)[0][2:4] == (False, False)


@pytest.mark.parametrize("count", [1, 3])
def test_actions_of_any_type_and_order_give_the_same_step_and_compile_no_new_kernel(count):
    plain = np.tile(CRUISE, (count, 1)) * np.linspace(0.5, 1.0, count, dtype=np.float32)[:, None]
    readonly = plain.copy()
    readonly.flags.writeable = False
    wide = np.zeros((2 * count, 4), np.float32)
    wide[::2, ::2] = plain
    others = [np.asfortranarray(plain), readonly, wide[::2, ::2], plain.astype(">f4"),
              plain.astype(np.float64), plain.tolist()]  # fmt: skip
    env = TrackedVehicleVectorEnv(count)
    env.reset(seed=0)
    kernel = env.simulation.solver.prepared.advance
    expected, _ = env.step(plain)[:2]
    compiled = len(kernel.signatures)
    for actions in others:
        env.reset(seed=0)
        assert np.array_equal(env.step(actions)[0], expected)
        single = TrackedVehicleEnv()
        single.reset(seed=0)
        assert np.array_equal(single.step(actions[0])[0], expected[0])
    assert len(kernel.signatures) == compiled


SHAPES = [0.1, [0.1], [[0.1, 0.2]], [0.1, 0.2, 0.3], np.float32([0.1]), [[0.1], [0.1, 0.2]]]
NO_NUMBERS = [  # NumPy would read text as numbers, and drop the imaginary part
    np.array([0.1 + 1.0j, 0.0]), ["0.1", "0.2"], np.array(["0.1", "0.2"]), [None, None],
    np.array([0.1, 0.2], dtype=object), np.array([1, 2], dtype="M8[s]"), [b"1", b"2"],
]  # fmt: skip


@pytest.mark.parametrize(
    ("wrong", "says"),
    [*((one, "action") for one in SHAPES), *((one, "must be real numbers") for one in NO_NUMBERS)],
    ids=repr,
)
def test_an_action_of_another_shape_or_type_is_refused_before_anything_moves(wrong, says):
    single, rows = TrackedVehicleEnv(), TrackedVehicleVectorEnv(2)
    wrapped = TrackedVehicleVecEnv(TrackedVehicleVectorEnv(2, autoreset_mode="SameStep"))
    for env, action in ((single, wrong), (rows, [wrong, wrong]), (wrapped, [wrong, wrong])):
        env.reset()
        simulation = (env.env if env is wrapped else env).simulation
        before = simulation.batch.floats.copy()
        with pytest.raises(ValueError, match=says):
            env.step(action)
        assert np.array_equal(before, simulation.batch.floats)
