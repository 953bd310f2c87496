"""A Ray cluster of two nodes on this machine: nodes and workers end, the results stay the same."""

import importlib
import json
import os
import shlex
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tests.agents.agent_cases import parameters, small
from tests.benchmark.stub_policies import MARK
from tests.benchmark.test_executors import CONFIG, STUBS, episodes_stored, policies, values
from tracked_env.benchmark import Store, run
from tracked_env.benchmark.executors import make_executor
from tracked_env.benchmark.policy_interface import PolicyError

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent


class TwoNodes:
    """A cluster whose second node can end."""

    def __init__(self, marks):
        self.ray = pytest.importorskip(
            "ray", reason="Ray is not installed: pip install 'tracked-env[cluster]'"
        )
        from ray.cluster_utils import Cluster

        self.marks = marks
        self.cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
        self.second = self.cluster.add_node(num_cpus=1)
        self.ray.init(
            address=self.cluster.address,
            log_to_driver=False,
            logging_level="ERROR",
            runtime_env={"env_vars": {"RAY_USAGE_STATS_ENABLED": "0"}},
        )

    def end_second(self):
        """Kill the second node with everything on it."""
        second, self.second = self.second, None
        self.cluster.remove_node(second, allow_graceful=False)

    def be_two(self):
        """Another node takes the place of one that was killed."""
        if self.second is None:
            self.second = self.cluster.add_node(num_cpus=1)

    def end(self):
        self.ray.shutdown()
        self.cluster.shutdown()


@pytest.fixture(scope="module")
def nodes(tmp_path_factory):
    """One cluster for all tests; what it starts inherits paths and variables."""
    marks = tmp_path_factory.mktemp("marks")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(MARK, str(marks))
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.syspath_prepend(str(HERE))
        patch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), str(HERE.parents[1])]))
        two = TwoNodes(marks)
        yield two
        two.end()


def records_of(folder, *specs, ray=True):
    executor = make_executor(ray="auto") if ray else None
    return run(CONFIG, policies(*specs), Store(folder, CONFIG.identity()), executor=executor)


def when(it_is_time, act):
    """Do something in another thread as soon as it is time."""

    def wait():
        until = time.monotonic() + 100
        while not it_is_time() and time.monotonic() < until:
            time.sleep(0.01)
        act()

    thread = threading.Thread(target=wait)
    thread.start()
    return thread


def test_a_cluster_gives_the_records_of_the_serial_run(nodes, tmp_path):
    specs = "adaptive", "ppo-blind", f"mine={STUBS}:Constant"
    found = records_of(tmp_path / "ray", *specs)
    assert values(found) == values(records_of(tmp_path / "serial", *specs, ray=False))
    assert {record["beside"] for record in found} == {2}


def test_a_node_that_ends_in_an_evaluation_costs_its_chunks_alone(nodes, tmp_path, capfd):
    nodes.be_two()
    specs = f"{STUBS}:Pausing", "nominal"
    (nodes.marks / "doomed").write_text(nodes.second.node_id)
    killing = when((nodes.marks / "reached").exists, nodes.end_second)
    found = records_of(tmp_path / "ray", *specs)
    killing.join()
    assert (nodes.marks / "reached").exists(), "no node was killed"
    (nodes.marks / "doomed").unlink()
    assert values(found) == values(records_of(tmp_path / "serial", *specs, ray=False))
    stored = episodes_stored(tmp_path / "ray")
    assert len(stored) == len(set(stored)) == len(found)
    said = capfd.readouterr().err
    assert ":Pausing, episodes" in said and "its worker or its node ended" in said
    assert "it runs again" in said


@pytest.mark.usefixtures("own_parts")
def test_a_node_imports_the_module_that_registers_a_kind_of_reference(nodes, tmp_path):
    config = replace(CONFIG, episodes=2, reference="own_parts:creep")
    store = Store(tmp_path, config.identity())
    executor = make_executor(ray="auto")
    assert len(run(config, policies("nominal"), store, executor=executor)) == 4


def test_an_error_of_a_policy_on_a_node_is_blamed_on_it(nodes, tmp_path):
    with pytest.raises(PolicyError, match=r":Wrong', set 'payload', step 2: KeyError: 'lacking'"):
        records_of(tmp_path, f"{STUBS}:Wrong")


def test_a_node_that_ends_in_a_sweep_costs_a_training_what_it_did_since_its_checkpoint(
    nodes, tmp_path, monkeypatch, capfd
):
    import train
    from agents.sweep import train_all

    nodes.be_two()
    monkeypatch.chdir(tmp_path)
    options = replace(small(Path("none")), steps=8192, evaluate_every=8192)
    swept = {name: replace(options, seed=int(name), output=Path(name)) for name in "12"}
    for each in swept.values():
        train.prepare(each)
    second = nodes.second.node_id

    def on_the_second_node():
        notes = {name: Path(f"{name}.node") for name in swept}
        there = [n for n, note in notes.items() if note.exists() and note.read_text() == second]
        return any(Path(name, "checkpoint-before.zip").exists() for name in there)

    killing = when(on_the_second_node, nodes.end_second)
    executor = make_executor(ray="auto")
    task = importlib.import_module(STUBS).trained_and_noted
    assert train_all(swept, executor, task, quiet=True) == 0
    killing.join()
    assert "was lost because its worker or its node ended" in capfd.readouterr().err
    for name, each in swept.items():
        recipe = json.loads(Path(name, "config.json").read_text())
        assert recipe["command"] == shlex.join(["python", *sys.argv])  # not that of a worker
        alone = replace(each, output=Path(f"{name}-alone"))
        assert train.main(alone) == 0
        one, other = parameters(Path(name, "last.zip")), parameters(alone.folder / "last.zip")
        assert all((one[key] == other[key]).all() for key in other)


def test_a_cluster_that_cannot_be_reached_is_one_line(tmp_path):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'tracked-env[cluster]'")
    with pytest.raises(ValueError, match=r"ray = '127.0.0.1:1': nothing answers there.*ray start"):
        make_executor(ray="127.0.0.1:1")
    with pytest.raises(ValueError, match="must be local, auto or HOST:PORT"):
        make_executor(ray="nowhere")


def test_without_ray_the_option_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ValueError, match=r"not installed: pip install 'tracked-env\[cluster\]'"):
        make_executor(ray="local")
