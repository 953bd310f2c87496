"""`tracked-env policies` and `tracked-env envs`: what there is, of other packages too."""

import json
import os
import subprocess
import sys
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest

from baselines.registry import POLICIES, policies
from tests.benchmark.plugin_package import install
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import frozen
from tracked_env.benchmark.evaluation_sets import SETS, version_of
from tracked_env.cli.main import main

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

TINY = ("--sets", "payload", "--episodes", "1", "--duration", "0.5")


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """Installs a package with policies of its own."""
    return partial(install, tmp_path, monkeypatch)


def test_policies_lists_controllers_agents_and_those_of_other_packages(plugin, capsys):
    plugin(coast="plugin_policies:Coast", broken="broken_policies:Policy")
    assert main(["policies"]) == 0
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    names = [line.split()[0] for line in lines if line.startswith("  ")]
    ours = [name for of in policies().values() for name in of]
    to_goals = ["slc-replan", "slc-once"]  # compared where they are named
    assert sorted(names) == sorted([*ours, *to_goals, "coast"]) and set(POLICIES) <= set(names)
    assert "Lets the vehicle coast.  [other-package]" in next(li for li in lines if " coast " in li)
    assert shown.err.startswith("warning: policies 'broken' of other-package")
    assert shown.err.count("\n") == 1
    assert main(["policies", "--env", "Speed-v0"]) == 0
    assert "tracked_env/Torque-v0" not in capsys.readouterr().out


def test_a_policy_of_another_package_is_evaluated_by_its_name(plugin):
    plugin(coast="plugin_policies:Coast")
    assert main(["evaluate", *TINY, "--policies", "oracle", "coast", "--no-figures"]) == 0
    (file,) = Path("results").glob("*/results.json")
    found = {record["policy"] for record in json.loads(file.read_text())["episodes"]}
    assert found == {"oracle", "coast"}


def test_envs_lists_every_environment_and_evaluation_set(capsys):
    assert main(["envs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    ids = [TORQUE_ID, SPEED_ID, TERRAIN_ID]
    of_ids = [name for env in ids for name, entry in SETS.items() if entry.env == env]
    assert len(of_ids) == len(SETS)
    shown = [line.split()[0] for line in lines if line.startswith("  ")]
    assert sorted(shown) == sorted(of_ids)
    firsts = [after for env in ids for line, after in pairwise(lines) if line.startswith(env)]
    for env, first in zip(ids, firsts, strict=True):
        version = version_of(env)
        assert version is not None and first.split()[0] == version.sets[0]
        entry = frozen.stored(version)["sets"][version.sets[0]]
        mark = f"[{version.name}, {entry['group']}, version 1, hash {entry['hash']}]"
        assert first.endswith(mark)
    assert [line.split()[0] for line in lines if not line.startswith("  ")] == ids


def test_a_list_that_is_not_read_to_its_end_is_no_error(repository):
    environment = {**os.environ, "PYTHONPATH": str(repository)}
    command = f"{sys.executable} -m tracked_env.cli.main policies | head -c 1"
    how = {"shell": True, "capture_output": True, "text": True, "timeout": 60}
    done = subprocess.run(command, env=environment, **how)  # type: ignore[call-overload]
    assert (len(done.stdout), done.stderr) == (1, "")
