"""`tracked_env/Torque-v0` as one environment: interface, options, endings, symmetry."""

import copy
import json

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import tracked_env
from tests.driving import STILL, assert_equal, make, run
from tracked_env import arrays as b
from tracked_env import observation as obs
from tracked_env import step
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics import parameters as s
from tracked_env.physics.parameters import GROUPS, RANGES
from tracked_env.references import REFERENCES
from tracked_env.sb3 import TrackedVehicleVecEnv
from tracked_env.sensors import PRESETS
from tracked_env.uncertainty import known_laws
from tracked_env.vector_env import TrackedVehicleVectorEnv

PATCHES = {"plant": "distributed", "uncertainty": "loose-soil"}
CROSSING = {"plant_options": {"terrain": "crossing"}}
TORQUE = [
    {},
    *({"uncertainty": name} for name in known_laws()),
    *({"sensors": name} for name in PRESETS),
    *({"reference": name} for name in REFERENCES if name != "waypoints"),
    {"reference": {"kind": "waypoints", "points": [[0, 0], [8, 0], [16, 4], [24, 4]]}},
    {"lateral": "constrained", "control_rate": 20.0, "duration": 5.0, "expose_truth": True},
    {"uncertainty": {"mass": [1000.0, 2000.0]}, "sensors": {"pose_delay": 0.1}},
    {"observation": ["look_ahead", "action"]},
    PATCHES,
    {**PATCHES, "vehicle": "focchi", "uncertainty": "friction"},
    {"plant": "terrain", **CROSSING, "expose_truth": True},
]
SPEED = [
    {},
    *({"uncertainty": name} for name in ("friction-step", "floor-ood")),
    {"vehicle": "focchi-short", "patches": [7, 3], "sensors": "rtk"},
    {"vehicle": "strawa", "uncertainty": "loose-soil"},
    {"plant": "terrain", **CROSSING, "expose_truth": True},
]
TERRAIN = [
    {},
    *({"uncertainty": name} for name in ("slope-step", "slope-payload", "soft-patches")),
    {"uncertainty": "hills-ood"},
    {"drive": "torque", **CROSSING},
    {"vehicle": "strawa", "drive": "torque", "sensors": "rtk", "error_limit": 5.0},
    {"plant_options": {"load": "uniform", "soil_at": "patches"}},
    {"observation": ["tangent_error", "attitude"], "patches": [8, 2], "expose_truth": True},
]
MASS = {"parameter": "mass", "kind": "ramp"}
CHECKED = [
    *((tracked_env.TORQUE_ID, arguments) for arguments in TORQUE),
    *((tracked_env.SPEED_ID, arguments) for arguments in SPEED),
    *((tracked_env.TERRAIN_ID, arguments) for arguments in TERRAIN),
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("env_id", "arguments"), CHECKED, ids=lambda a: json.dumps(a)[:60])
def test_both_environment_checkers_pass_without_a_warning(env_id, arguments):
    check_env(make(env_id, **arguments), skip_render_check=True)
    sb3_check_env(make(env_id, **arguments), skip_render_check=True)


def test_the_id_is_found_by_module_prefix_and_its_arguments_survive_json():
    arguments = json.loads(json.dumps({"uncertainty": "drift", "duration": 2.0}))
    env = gymnasium.make("tracked_env:tracked_env/Torque-v0", **arguments)
    assert isinstance(env.unwrapped, TrackedVehicleEnv)
    assert env.spec.id == tracked_env.TORQUE_ID
    assert env.spec.kwargs == arguments


def test_the_class_docstring_lists_every_field_of_the_observation():
    for field in obs.FIELDS:
        assert f"`{field.name}`" in TrackedVehicleEnv.__doc__


@pytest.mark.parametrize("name", RANGES)
@pytest.mark.parametrize("wrong", ["below", "above", float("nan"), "1", None, [1.0, 2.0], True])
def test_a_wrong_parameter_is_refused_with_name_value_range_and_hint(name, wrong):
    low, high, _, hint = RANGES[name]
    value = {"below": low - 1.0, "above": high * 1.1 + 1.0}.get(str(wrong), wrong)
    group = next(group for group, names in GROUPS.items() if name in names)
    with pytest.raises(ValueError) as caught:
        make().reset(seed=0, options={group: {name: value}})
    message = str(caught.value)
    assert name in message and f"{low:g}, {high:g}" in message and hint in message


@pytest.mark.parametrize(
    "options, says",
    [
        ({"vehicel": {}}, "Did you mean 'vehicle'"),
        ({"vehicle": {"masss": 1.0}}, "Did you mean 'mass'"),
        ({"soil": {"mass": 1500.0}}, "soil"),
        ({"sensors": {"gyro": 1.0}}, "gyro"),
        ({"sensors": "gps"}, "rtk"),
        ({"sensors": {"pose_dropout": 1.5}}, "probability"),
        ({"reference": {"kind": "circle", "radius": -1.0}}, "radius"),
        ({"reference": "cirle"}, "circle"),
        ({"start": {"offset": 1.0}}, "offset_x"),
        ({"schedule": {"mass": 1.0}}, "list"),
        ({"schedule": [{"parameter": "mass", "kind": "step"}]}, "ramp"),
        ({"schedule": [{**MASS, "target": 1e9, "start": 1.0}]}, "tonnes"),
        ({"schedule": [{**MASS, "target": 1e3}]}, "start"),
        ({"schedule": [{"parameter": "torque_limit", "kind": "ramp"}]}, "torque_limit"),
        ({"vehicle": {"mass": -1.0}}, "mass"),
        ([1], "dict"),
    ],
)
def test_wrong_options_change_no_episode_and_use_up_no_random_numbers(options, says):
    env, plain = make(), make()
    for one in (env, plain):
        one.reset(seed=0)
        one.step(np.float32([0.2, 0.2]))
    with pytest.raises(ValueError, match=says):
        env.reset(options=options)
    assert np.array_equal(plain.simulation.batch.floats, env.simulation.batch.floats)
    assert np.array_equal(plain.reset()[0], env.reset()[0])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_non_finite_action_is_refused_before_anything_moves(bad):
    env = make()
    env.reset(seed=0)
    before = env.simulation.batch.floats.copy()
    with pytest.raises(ValueError, match="must be finite"):
        env.step(np.float32([bad, 0.0]))
    assert np.array_equal(before, env.simulation.batch.floats)


def test_actions_outside_the_box_act_as_clipped():
    a, _, _ = run(make(), 50, actions=np.tile([3.0, 1e30], (50, 1)))
    b, _, _ = run(make(), 50, actions=np.tile([1.0, 1.0], (50, 1)))
    assert np.array_equal(a, b)


def test_reward_is_the_sum_of_its_terms_each_within_its_weight():
    env = make(uncertainty="mixed", error_limit=50.0)
    env.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(150):
        _, reward, *_, info = env.step(rng.uniform(-1, 1, 2).astype(np.float32))
        assert reward == pytest.approx(sum(info[key] for key in step.INFO_KEYS), abs=1e-12)
        for name, weight in step.WEIGHTS.items():
            assert min(weight, 0.0) <= info[f"reward_{name}"] <= max(weight, 0.0)


def test_the_truth_is_hidden_unless_asked_for():
    assert "truth" not in make().reset(seed=0)[1]
    info = make(expose_truth=True).reset(seed=0)[1]
    assert {"mass", "cohesion", "x", "slip_left"} <= set(info["truth"])


def test_an_episode_is_truncated_by_time_and_terminated_off_the_path():
    env = make(duration=1.0, reference="straight")
    observations, _, info = run(env, 1000, actions=np.zeros((1000, 2)))
    assert len(observations) - 1 == 50 and not env.simulation.terminated[0]
    env = make(duration=60.0, error_limit=1.0, reference="straight")
    observations, _, info = run(env, 3000, actions=np.zeros((3000, 2)))
    assert info["tracking_error"][0] > 1.0 and env.simulation.terminated[0]
    assert len(observations) - 1 < 3000 and info["is_success"] is False


def test_tracking_error_is_the_distance_and_heading_to_the_reference():
    env = make(expose_truth=True, reference={"kind": "straight", "speed": 2.0})
    start = {"offset_x": -0.5, "offset_y": 1.2, "offset_yaw": 0.3, "speed": 2.0}
    _, info = env.reset(seed=0, options={"start": start})
    assert info["tracking_error"] == pytest.approx([1.3, -0.3])
    assert info["truth"]["y"] == pytest.approx(1.2)


@pytest.mark.parametrize(
    ("env_id", "arguments"),
    [
        (tracked_env.TORQUE_ID, {"lateral": "sliding"}),
        (tracked_env.TORQUE_ID, {"lateral": "constrained"}),
        (tracked_env.TORQUE_ID, {"plant": "distributed"}),
        (tracked_env.SPEED_ID, {}),
    ],
)
def test_exchanging_left_and_right_mirrors_the_episode_exactly(env_id, arguments):
    actions = np.random.default_rng(5).uniform(-1, 1, (150, 2))
    calm = {"uncertainty": "nominal", "sensors": "ideal", "reference": "straight"}
    env = make(env_id, **calm, **arguments, error_limit=1e3)
    start = {"offset_x": 0.1, "offset_y": 0.4, "offset_yaw": 0.2, "speed": 1.0, "yaw_rate": 0.1}
    other = {**start, "offset_y": -0.4, "offset_yaw": -0.2, "yaw_rate": -0.1}
    ours, rewards, _ = run(env, 150, actions, options={"start": start})
    theirs, mirrored, _ = run(env, 150, actions[:, ::-1], options={"start": other})
    assert np.array_equal(obs.mirror(ours), theirs)
    assert np.array_equal(rewards, mirrored)
    assert np.abs(ours[:, obs.INDEX["yaw_rate"]]).max() > 0.1


def test_a_vehicle_at_rest_stays_at_rest_below_the_resistance():
    env = make(uncertainty="nominal", sensors="ideal", reference="straight", expose_truth=True)
    # mu_l m g / 2 * r = 1280 N m per track is 0.16 of the torque limit.
    env.reset(seed=0, options={"start": STILL})
    for _ in range(100):
        *_, info = env.step(np.float32([0.155, 0.155]))
    assert info["truth"]["v_x"] == 0.0 and info["truth"]["x"] == 0.0
    for _ in range(50):
        *_, info = env.step(np.float32([0.165, 0.165]))
    assert info["truth"]["v_x"] > 0.01


@pytest.mark.parametrize("row", [s.X, s.YAW, s.V_X, s.YAW_RATE])
@pytest.mark.parametrize("value", [np.nan, np.inf, -1e200])
@pytest.mark.parametrize("env_id", [tracked_env.TORQUE_ID, tracked_env.SPEED_ID])
@pytest.mark.parametrize("sensors", ["strawa", {"pose_delay": 0.1, "pose_rate": 10.0}])
def test_a_diverged_vehicle_ends_with_its_last_readings_and_the_worst_reward(
    env_id, row, value, sensors
):
    env = gymnasium.make(env_id, sensors=sensors, uncertainty="nominal", error_limit=1e6).unwrapped
    env.reset(seed=0)
    for _ in range(7):
        before, *_ = env.step(np.float32([0.2, 0.2]))
    env.simulation.batch.floats[0, b.STATE + row] = value
    observation, reward, terminated, truncated, info = env.step(np.float32([0.2, 0.3]))
    assert env.observation_space.contains(observation)
    snapshot = [obs.INDEX[name] for name in ("v_x", "yaw_rate", "acceleration_x", "torque_left")]
    if sensors == "strawa":  # no delay: the sensors show what they showed before
        assert np.array_equal(observation[snapshot], before[snapshot])
    assert terminated and not truncated and not info["is_success"]
    assert reward == sum(info[key] for key in step.INFO_KEYS) == -0.1
    assert all(info[f"reward_{k}"] == min(w, 0.0) for k, w in step.WEIGHTS.items())
    observation, info = env.reset()
    assert env.observation_space.contains(observation) and np.isfinite(info["tracking_error"]).all()


# --- what a step takes and returns ---------------------------------------------------------------

CRUISE = np.array([0.2, 0.25], np.float32)
LATE = {"preset": "rtk", "pose_delay": 0.2}  # makes the history of samples longer
CHANGES = [{"parameter": "mass", "kind": "ramp", "target": 2500.0, "start": 0.1}] * 3


def steps(env, count, action=CRUISE):
    """What `count` steps return."""
    return [env.step(action) for _ in range(count)]


@pytest.mark.parametrize("env_id", [tracked_env.TORQUE_ID, tracked_env.SPEED_ID])
def test_what_a_step_returns_is_never_changed_by_a_later_step_or_reset(env_id):
    env = gymnasium.make(env_id).unwrapped
    first = env.reset(seed=0)
    copies = [(o, i, o.copy(), copy.deepcopy(i)) for o, i in [first]]
    for k in range(70):  # past the end of a noise block
        observation, *_, info = env.step(CRUISE)
        copies.append((observation, info, observation.copy(), copy.deepcopy(info)))
        if k % 30 == 29:
            env.reset()
    for observation, info, then, about in copies:
        assert np.array_equal(observation, then)
        assert all(np.array_equal(info[key], about[key]) for key in about)
        assert info["tracking_error"].base is None and observation.base is None


def test_the_info_of_a_step_has_plain_numbers_by_the_names_of_the_reward_s_terms():
    env = TrackedVehicleEnv()
    env.reset(seed=0)
    *_, reward, terminated, truncated, info = env.step(CRUISE)
    assert [key for key in info if key.startswith("reward_")] == [*step.INFO_KEYS]
    assert {type(reward), *(type(info[key]) for key in step.INFO_KEYS)} == {float}
    assert {type(terminated), type(truncated), type(info["is_success"])} == {bool}
    terms = env.simulation.report().terms
    assert [info[key] for key in step.INFO_KEYS] == [float(term[0]) for term in terms]


@pytest.mark.parametrize("options", [{"sensors": LATE}, {"schedule": CHANGES}])
def test_a_step_after_a_reset_that_widens_the_arrays_is_that_of_a_fresh_environment(options):
    env, fresh = TrackedVehicleEnv(), TrackedVehicleEnv()
    env.reset(seed=1)
    steps(env, 20)
    for one in (env, fresh):
        one.reset(seed=5, options=options)
    assert_equal(steps(env, 100), steps(fresh, 100))


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
