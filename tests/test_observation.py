"""The layout of the observation: groups, versions, columns by name."""

import json

import gymnasium
import numpy as np
import pytest

from tests.driving import run
from tracked_env import observation as obs

ID = "tracked_env:tracked_env/Torque-v0"
ACTIONS = np.full((60, 2), (0.3, 0.2))
# Of v0, for good: agents and data sets rely on it.
V0 = {
    "pose_error": "position_error_x position_error_y heading_error",
    "motion": "v_x v_y yaw_rate acceleration_x acceleration_y yaw_acceleration",
    "drive": "sprocket_speed_left sprocket_speed_right torque_left torque_right",
    "reference": "reference_speed reference_acceleration reference_jerk reference_yaw_rate "
    "reference_yaw_acceleration",
    "look_ahead": "reference_speed_ahead_0.25 reference_speed_ahead_0.5 reference_speed_ahead_1 "
    "reference_speed_ahead_2 reference_yaw_rate_ahead_0.25 reference_yaw_rate_ahead_0.5 "
    "reference_yaw_rate_ahead_1 reference_yaw_rate_ahead_2",
    "action": "previous_action_left previous_action_right",
    "age": "pose_age inertial_age drive_age",
}
SCALES = [
    1, 1, 0.5, 2, 0.5, 0.5, 2, 2, 2, 6, 6, 4000, 4000, 2, 2, 4, 0.5, 1, *[2] * 4, *[0.5] * 4, 1, 1,
    1, 1, 1,
]  # fmt: skip
BOUNDS = [
    20, 20, 4, 40, 40, 20, 200, 200, 400, 2000, 2000, 2e6, 2e6, 40, 100, 400, 20, 100, *[40] * 4,
    *[20] * 4, 1, 1, 60, 60, 60,
]  # fmt: skip


def test_the_layout_v0_is_what_it_has_always_been():
    assert {group.name: " ".join(f.name for f in group.fields) for group in obs.V0.parts} == V0
    assert obs.V0.groups == obs.VERSIONS["v0"]
    assert obs.SCALE.tolist() == SCALES
    assert [field.bound for field in obs.FIELDS] == BOUNDS
    high = (np.array(BOUNDS) / np.array(SCALES)).astype(np.float32)
    assert obs.HIGH.tobytes() == high.tobytes()
    assert obs.LOW.tobytes() == np.concatenate([-high[:28], [0, 0, 0]]).astype(np.float32).tobytes()


@pytest.mark.parametrize("env_id", ["Torque-v0", "Speed-v0"])
def test_an_environment_of_some_groups_shows_their_columns_bit_for_bit(env_id):
    groups = ["motion", "pose_error", "age", "reference"]
    whole = gymnasium.make(f"tracked_env:tracked_env/{env_id}")
    part = gymnasium.make(f"tracked_env:tracked_env/{env_id}", observation=groups)
    layout = part.unwrapped.layout
    assert layout.groups == tuple(groups)
    assert part.observation_space.shape == (layout.size,) == (17,)
    readings, values = (run(env, 60, ACTIONS, seed=3)[0] for env in (whole, part))
    assert np.array_equal(values, readings[:, obs.V0.columns(layout.names)])
    assert all(part.observation_space.contains(row) for row in values)


def test_arguments_of_a_composed_environment_are_json():
    env = gymnasium.make(ID, observation=["look_ahead", "action"])
    assert json.loads(json.dumps(env.spec.kwargs))["observation"] == ["look_ahead", "action"]


def test_a_part_of_a_layout_packs_unpacks_and_mirrors_as_the_whole():
    layout = obs.make_layout(["drive", "pose_error", "look_ahead"])
    values = np.random.default_rng(0).normal(size=(4, obs.SIZE))
    whole = obs.pack(dict(zip(obs.NAMES, values.T, strict=True)))
    columns = obs.V0.columns(layout.names)
    fields = obs.unpack(whole)
    part = layout.pack({name: fields[name] for name in layout.names})
    assert np.array_equal(part, whole[:, columns])
    assert np.array_equal(layout.unpack(part)["torque_left"], fields["torque_left"])
    assert np.array_equal(layout.mirror(part), obs.mirror(whole)[:, columns])
    assert np.array_equal(layout.mirror(layout.mirror(part)), part)
    assert not np.array_equal(layout.mirror(part), part)
    assert layout.markdown_table().count("\n") == layout.size + 1


def test_a_missing_group_is_named_with_what_to_make_the_environment_with():
    names = obs.make_layout(["motion", "drive"]).names
    with pytest.raises(ValueError, match=r"lacks group age \(pose_age\); .*'drive', 'age'\]"):
        obs.columns(names, ["v_x", "pose_age"])
    with pytest.raises(ValueError, match=r"unknown observation field 'v_z'.*Did you mean 'v_"):
        obs.columns(names, ["v_z"])
    with pytest.raises(ValueError, match=r"lacks group reference \(reference_speed\)"):
        obs.View(names, ["v_x", "reference_speed"])


def test_a_view_finds_fields_by_name_and_shows_0_for_what_nobody_needs():
    layout = obs.make_layout(["age", "motion"])
    readings = np.arange(2 * layout.size, dtype=np.float32).reshape(2, -1) + 1.0
    view = obs.View(layout.names, ["v_x", "pose_age"])
    result = view(readings)
    assert result.shape == (2, obs.SIZE)
    assert result[1, obs.INDEX["v_x"]] == readings[1, layout.index["v_x"]]
    assert result[0, obs.INDEX["pose_age"]] == readings[0, 0]
    assert not result[:, obs.INDEX["reference_speed"]].any()
    assert np.count_nonzero(result) == readings.size
    same = obs.View()
    whole = np.zeros((3, obs.SIZE), dtype=np.float32)
    assert same(whole) is whole
    for wrong in (readings[:, :-1], np.zeros((1, 1, layout.size)), whole):
        with pytest.raises(ValueError, match=r"shape .* must be \(9,\) or \(N, 9\)"):
            view(wrong)


FIELDS = (obs.Field("a", "-", 1.0, 1.0, ""),)


@pytest.mark.parametrize(
    ("group", "says"),
    [
        (obs.Group("motion", (obs.Field("a", "-", 1.0, 1.0, ""),)), "'motion' is taken"),
        (obs.Group("empty", ()), "has no field"),
        (obs.Group("new", (obs.Field("v_x", "-", 1.0, 1.0, ""),)), "in the group 'motion' already"),
        (obs.Group("new", 2 * (obs.Field("a", "-", 1.0, 1.0, ""),)), "in the group 'new' already"),
        (obs.Group("new", (obs.Field("a", "-", 0.0, 1.0, ""),)), "must be positive"),
        (obs.Group("new", (obs.Field("a_left", "-", 1.0, 1.0, ""),)), "without its right one"),
        (obs.Group("new", FIELDS, compute=print), "'new' must have `compute` with `reads`"),
        (obs.Group("new", FIELDS, reads=("v_x",)), "'new' must have `compute` with `reads`"),
        (obs.Group("new", FIELDS, ("roll",), print, ("v_z",)), "field that 'new' reads 'v_z'"),
        (obs.Group("new", FIELDS, ("roll",), print, ("pitch",)), "field that 'new' reads 'pitch'"),
    ],
)
def test_a_group_that_does_not_fit_is_not_registered(group, says, registries):
    before = dict(obs.GROUPS)
    with pytest.raises(ValueError, match=says):
        obs.register(group)
    assert before == obs.GROUPS
