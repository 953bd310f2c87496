"""What a project registers is found in other processes, which are started afresh, and in copies."""

import copy
import json
import pickle
import re
import sys
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AsyncVectorEnv

from baselines.registry import POLICIES
from tests.driving import assert_equal
from tracked_env import TORQUE_ID, plants, rewards, vehicles
from tracked_env.benchmark import BenchmarkConfig, Store, load_policy, run
from tracked_env.benchmark.benchmark_config import set_of
from tracked_env.benchmark.executors import WorkerPool
from tracked_env.references import specification

FORWARD = np.full(2, 0.2, np.float32)
OWN = {"vehicle": "own_parts:crawler", "reference": "own_parts:creep", "reward": "own_parts:near"}
PLAIN = {key: name.partition(":")[2] for key, name in OWN.items()}


pytestmark = pytest.mark.usefixtures("own_parts")


def forget():
    """As a process that has imported nothing of the project."""
    for names in (vehicles._registered, rewards._REGISTERED, specification._REGISTERED):
        names.clear()
    sys.modules.pop("own_parts", None)


def made(**arguments):
    """An environment; this function can be imported by other processes."""
    return gymnasium.make(TORQUE_ID, duration=1.0, **arguments)


@pytest.mark.slow
def test_processes_of_gymnasium_import_the_module_of_a_name():
    env = AsyncVectorEnv([partial(made, **OWN)] * 2, context="spawn")
    env.reset(seed=3)
    rewards_ = env.step(np.tile(FORWARD, (2, 1)))[1]
    env.close()
    for seed in (3, 4):
        here = made(**OWN)
        assert here.unwrapped.simulation.solver.nominal.mass == 50.0
        here.reset(seed=seed)
        assert here.step(FORWARD)[1] == rewards_[seed - 3] < 0.0


@pytest.mark.slow
def test_processes_of_stable_baselines3_import_the_module_of_a_name():
    from stable_baselines3.common.vec_env import SubprocVecEnv  # here: every process loads torch

    env = SubprocVecEnv([partial(made, **OWN)] * 2, start_method="spawn")
    env.seed(3)
    env.reset()
    _, rewards_, _, _ = env.step(np.tile(FORWARD, (2, 1)))
    env.close()
    here = made(**OWN)
    here.reset(seed=3)
    assert here.step(FORWARD)[1] == rewards_[0] < 0.0


def configuration(own):
    arguments = {key: own[key] for key in ("vehicle", "reward")}
    table = {"reference": own["reference"], "duration": 1.0, "arguments": arguments}
    return BenchmarkConfig(("a",), episodes=2, own_sets=(set_of("a", table, TORQUE_ID),))


def records(own, folder, executor=None):
    config = configuration(own)
    entries = [load_policy("nominal", POLICIES)]
    return run(config, entries, Store(folder, config.identity()), executor=executor)


def test_workers_of_a_comparison_import_the_module_of_a_name(tmp_path):
    parallel, serial = records(OWN, tmp_path / "a", WorkerPool(1)), records(OWN, tmp_path / "b")
    assert [each["tracking_rmse"] for each in parallel] == [
        each["tracking_rmse"] for each in serial
    ]


@pytest.mark.slow
@pytest.mark.parametrize("key", ["reference", "reward"])
def test_a_name_that_a_worker_does_not_know_says_how_to_write_it(key, tmp_path):
    import own_parts  # noqa: F401, registers

    says = rf"unknown {key}.* {PLAIN[key]!r}; .*in the process that registers it, module:name in"
    with pytest.raises(ValueError, match=says):
        own = {"vehicle": "strawa", "reference": "circle", "reward": "default", key: PLAIN[key]}
        records(own, tmp_path, WorkerPool(1))


@pytest.mark.slow
def test_workers_have_the_values_of_a_vehicle_and_of_a_reward_that_is_a_dict(tmp_path):
    import own_parts  # noqa: F401, registers

    own = {"vehicle": "crawler", "reward": "sharp", "reference": {"kind": "circle"}}
    own["reference"]["vehicle"] = "crawler"
    assert len(records(own, tmp_path, WorkerPool(1))) == 2


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"reward": "lost:near"}, "reward lost:near: 'lost' cannot be imported (No module"),
        ({"reward": "own_parts:nera"}, "unknown reward 'nera'.*'near'? Does 'own_parts' register"),
        ({"vehicle": "own_parts:robo"}, "unknown vehicle 'robo'.* Does 'own_parts' register it?"),
        ({"reference": "own_parts:crep"}, "unknown reference kind 'crep'.* Does 'own_parts'"),
        ({"plant": "own_parts:rolling"}, "unknown plant 'rolling'.* Does 'own_parts' register it?"),
        ({"plant": "rolling"}, "unknown plant 'rolling'.* module:name in others too"),
    ],
)
def test_a_wrong_module_or_name_is_refused_with_its_cause(arguments, says):
    with pytest.raises(ValueError, match=re.escape(says).replace(r"\.\*", ".*")):
        made(**arguments)


@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_needs_neither_the_registration_nor_the_file_of_its_vehicle(how, tmp_path):
    import own_parts  # noqa: F401, registers

    path = tmp_path / "robot.toml"
    path.write_text('base = "crawler"\ncontact_length = 0.6\n')
    reference = {"kind": "circle", "radius": 3.0, "speed": 0.3, "vehicle": "crawler"}
    for vehicle in (path, "crawler", {"base": str(path), "cohesion": 10.0}):
        env = made(vehicle=vehicle, reward="sharp", reference=reference)
        env.reset(seed=2)
        text = path.read_text()
        path.write_text("mass = 900.0\n")  # somebody edits it
        names = [vehicles._registered, rewards._REGISTERED]
        kept = [dict(each) for each in names]
        forget()
        twin, again = how(env), gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
        again.reset(seed=2)
        step = env.step(FORWARD)
        assert_equal(step, twin.step(FORWARD))
        assert_equal(step, again.step(FORWARD))
        path.write_text(text)
        for each, content in zip(names, kept, strict=True):
            each.update(content)


def test_another_function_of_a_kind_or_plant_is_another_comparison(tmp_path, monkeypatch):
    digests = set()
    for number in (1, 1, 2):
        module = tmp_path / "kinds_of_mine.py"
        source = Path(__file__).with_name("benchmark") / "own_parts.py"
        module.write_text(source.read_text() + f"# {number}\n")
        monkeypatch.syspath_prepend(str(tmp_path))
        forget()
        sys.modules.pop("kinds_of_mine", None)
        config = BenchmarkConfig(("payload",), reference="kinds_of_mine:creep")
        digests.add(json.dumps(config.identity()["registered"]))
    assert len(digests) == 2
    assert "registered" not in BenchmarkConfig(("payload",)).identity()
    own = set_of("a", {"arguments": {"plant": "like_lumped"}}, TORQUE_ID)
    lumped = plants.find("lumped")
    monkeypatch.setattr(plants, "_REGISTERED", {"like_lumped": copy.copy(lumped)})
    object.__setattr__(plants.find("like_lumped"), "name", "like_lumped")
    assert [*BenchmarkConfig(("a",), own_sets=(own,)).identity()["registered"]["a"]] == ["plant"]
