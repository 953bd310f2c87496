"""The arguments of the environments stand in one list, `EnvConfig`."""

import ast
import inspect
import pydoc
import re

import gymnasium
import pytest

from tracked_env import TORQUE_ID
from tracked_env.engine.env_config import EnvConfig
from tracked_env.env import TrackedVehicleEnv
from tracked_env.vector_env import TrackedVehicleVectorEnv

GIVEN = {  # a value of every shared argument that is not its default
    "reference": "circle", "uncertainty": "drift", "sensors": "ideal", "duration": 7.0,
    "control_rate": 20.0, "lateral": "constrained", "error_limit": 3.0, "time_step": 0.001,
    "vehicle": "focchi", "plant": "distributed", "drive": "speed", "patches": (6, 2),
    "plant_options": {"integrator": "euler"}, "observation": ["motion"], "expose_truth": True,
    "render_mode": "rgb_array", "terrain": "hills", "reward": {"heading": {"weight": 0.0}},
    "costs": {"slip": 0.1}, "base_vehicle": "focchi",
}  # fmt: skip


def listed(kind):
    """Arguments of an environment class and their defaults, in order."""
    parameters = inspect.signature(kind).parameters.values()
    assert all(p.kind is p.POSITIONAL_OR_KEYWORD for p in parameters)
    return {p.name: p.default for p in parameters}


def test_both_environments_have_the_arguments_of_the_configuration():
    shared = {k: v for k, v in EnvConfig._field_defaults.items() if k != "threads"}
    assert [*shared] == [*GIVEN]
    assert listed(TrackedVehicleEnv) == shared
    vector = listed(TrackedVehicleVectorEnv)
    assert [*vector] == ["num_envs", *shared, "autoreset_mode", "threads", "max_episode_steps"]
    assert {k: vector[k] for k in shared} == shared
    for kind in (TrackedVehicleEnv, TrackedVehicleVectorEnv):
        values = pydoc.render_doc(kind)
        assert all(
            f"{name}: " in values and f"{name}: " in pydoc.render_doc(kind.__init__)
            for name in listed(kind)
        )


def test_the_table_of_arguments_has_every_argument_with_its_default():
    table = TrackedVehicleEnv.__doc__.partition("## Arguments")[2].partition("`reset(")[0]
    rows = re.findall(r"^ *\| `(\w+)` \| ([^|]+?) \|", table, flags=re.MULTILINE)
    assert {n: ast.literal_eval(d.strip("`")) for n, d in rows} == listed(TrackedVehicleEnv)


@pytest.mark.parametrize("kind", [TrackedVehicleEnv, TrackedVehicleVectorEnv])
@pytest.mark.parametrize("name, value", GIVEN.items(), ids=lambda part: str(part)[:20])
def test_every_argument_reaches_the_simulation(kind, name, value):
    plants = {
        "terrain": "terrain",
        **dict.fromkeys(("drive", "patches", "plant_options"), "distributed"),
    }
    needed = {"plant": plants[name]} if name in plants else {}
    config = kind(**needed, **{name: value}).simulation.config
    assert getattr(config, name) == value
    assert value != EnvConfig._field_defaults[name]


def test_threads_are_an_argument_of_the_vector_environment_alone():
    assert TrackedVehicleVectorEnv(2).simulation.config.threads == 2
    assert TrackedVehicleVectorEnv(2, threads=5).simulation.config.threads == 5
    with pytest.raises(TypeError, match="unexpected keyword argument 'threads'"):
        TrackedVehicleEnv(threads=5)


@pytest.mark.parametrize("kind", [TrackedVehicleEnv, TrackedVehicleVectorEnv])
@pytest.mark.parametrize(
    "arguments, says",
    [
        ({"sensor": "rtk"}, "unexpected keyword argument 'sensor'; .* Did you mean 'sensors'"),
        ({"refrence": "circle"}, "Did you mean 'reference'"),
        ({"config": None}, "unexpected keyword argument 'config'; known are"),
    ],
)
def test_an_unknown_argument_is_a_type_error_that_names_the_nearest(kind, arguments, says):
    with pytest.raises(TypeError, match=rf"^{kind.__name__}\(\): .*{says}") as caught:
        kind(**arguments)
    assert "\n" not in str(caught.value)
    with pytest.raises(TypeError, match=says):
        gymnasium.make(TORQUE_ID, **arguments)
    with pytest.raises(TypeError, match=says):
        gymnasium.make_vec(TORQUE_ID, **arguments)


def test_arguments_may_be_given_by_position():
    assert TrackedVehicleEnv("circle", "payload").simulation.config[:2] == ("circle", "payload")
    many = TrackedVehicleVectorEnv(3, "circle")
    assert many.num_envs == 3 and many.simulation.config.reference == "circle"
    with pytest.raises(TypeError, match=r"TrackedVehicleEnv\(\): multiple values .*'reference'"):
        TrackedVehicleEnv("circle", reference="circle")
    with pytest.raises(TypeError, match=r"TrackedVehicleEnv\(\): too many positional"):
        TrackedVehicleEnv(*range(30))


def test_a_vehicle_may_be_a_dict_over_a_named_one():
    vehicle = {"base": "focchi", "mass": 80.0}
    env = TrackedVehicleEnv(vehicle=vehicle, uncertainty="nominal", expose_truth=True)
    _, info = env.reset(seed=0)
    assert info["truth"]["mass"] == 80.0
    assert info["truth"]["track_gauge"] == 0.606
