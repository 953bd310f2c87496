"""Policies by entry point: ours, another package's, broken ones, and a clone without any."""

from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from baselines import registry
from baselines.registry import BY_ENVIRONMENT, PRETRAINED, shipped_agents
from tests.benchmark.plugin_package import Install, install
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID, entry_points
from tracked_env.benchmark import PolicyContext, policies
from tracked_env.benchmark.policies import (
    ENVIRONMENTS,
    Registered,
    by_name,
    default_names,
    load_policies,
    open_archive,
)


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Installs a package with entries of its own."""
    return partial(install, tmp_path, monkeypatch)


def registered() -> tuple[list[Registered], list[str]]:
    """What is registered, and what is said to be left out."""
    said: list[str] = []
    return policies.registered_policies(said.append), said


def ours() -> list[tuple[str, str | None]]:
    return [
        *(
            (name, ENVIRONMENTS[env])
            for env, names in BY_ENVIRONMENT.items()
            for name in (*names, *shipped_agents(env))
        ),
        ("slc-once", None),  # they need a goal, and are compared where they are named
        ("slc-replan", None),
    ]


def test_controllers_and_shipped_agents_are_registered_per_environment_in_their_order() -> None:
    policies, said = registered()
    assert [(policy.name, policy.env) for policy in policies[: len(ours())]] == ours()
    assert said == []
    known = ("nominal", "integral", "l1", "mrac", "adaptive", "oracle")
    assert default_names(policies, "torque")[:6] == known
    assert "ppo-student" in default_names(policies, "torque")
    assert "ppo-student" not in default_names(policies, SPEED_ID)
    assert default_names(policies, "speed") == default_names(policies, SPEED_ID)
    on_slopes = default_names(policies, TERRAIN_ID)
    assert on_slopes[0] == "uc" and {"slc-adaptive", "slc-oracle"} < set(on_slopes)
    assert all(policy.summary and "\n" not in policy.summary for policy in policies)


def test_every_shipped_archive_is_registered() -> None:
    found = {path for policy in registered()[0] if policy.is_trained for path in policy.found}
    assert found == set(PRETRAINED.glob("*/*/agent.zip"))


def test_agents_whose_archives_are_not_installed_are_known_and_not_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for scores in PRETRAINED.glob(f"*/{registry.SCORES}"):
        (tmp_path / scores.parent.name).mkdir()
        (tmp_path / scores.parent.name / scores.name).write_bytes(scores.read_bytes())
    before = {env: list(shipped_agents(env)) for env in BY_ENVIRONMENT}
    monkeypatch.setattr(registry, "PRETRAINED", tmp_path)
    policies, said = registered()
    assert said == []
    for env, names in BY_ENVIRONMENT.items():
        absent = shipped_agents(env)
        assert sorted(absent) == sorted(before[env]) and not any(absent.values())
        assert default_names(policies, env) == names
    assert {one.summary for one in policies if one.is_trained} == {
        "trained agent, its archives are not installed"
    }
    with pytest.raises(ValueError, match="Source distributions leave them out"):
        load_policies(["ppo-blind"], *by_name(policies, "torque"), open_archive)


def test_a_policy_of_an_installed_package_is_known_by_its_name(
    plugin: Install,
) -> None:
    plugin(coast="plugin_policies:Coast", anywhere="plugin_policies:Anywhere")
    policies, said = registered()
    assert said == []
    (coast,) = [policy for policy in policies if policy.name == "coast"]
    assert (coast.env, coast.distribution) == (TORQUE_ID, "other-package")
    assert coast.summary == "Lets the vehicle coast."
    assert default_names(policies, "torque")[-1] == "coast"  # behind ours
    assert "anywhere" not in default_names(policies, "torque")  # only by its name
    registry, trained = by_name(policies, "torque")
    entry, second = load_policies(["coast", "anywhere"], registry, trained, open_archive)
    policy = entry.make(PolicyContext(0.02, "sliding"))
    action, _ = policy.predict(np.zeros((2, 31), dtype=np.float32))
    assert action.shape == (2, 2)
    assert entry.name == "coast" and second.name == "anywhere"


def test_one_entry_can_register_many_policies(plugin: Install) -> None:
    plugin(all_of_them="plugin_policies:Several")
    policies, said = registered()
    assert said == []
    found = [(p.name, p.env) for p in policies if p.distribution == "other-package"]
    assert found == [("coast-too", TORQUE_ID), ("coast", SPEED_ID), ("coast", TERRAIN_ID)]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("broken_policies:Policy", "ModuleNotFoundError: No module named 'not_installed_anywhere'"),
        ("plugin_policies:Absent", "AttributeError"),
        (
            "plugin_policies:Lost",
            "its drive is 'wheels'; must be one of torque, speed, tracked_env/",
        ),
        ("plugin_policies:NOTHING", "no `predict` and is no factory"),
    ],
)
def test_a_broken_package_is_one_line_that_names_it_and_the_others_work(
    value: str, message: str, plugin: Install
) -> None:
    plugin(broken=value, coast="plugin_policies:Coast")
    policies, (said,) = registered()
    assert said.startswith(f"policies 'broken' of other-package ({value}) are left out: ")
    assert message in said and "\n" not in said
    assert {name for name, _ in ours()} | {"coast"} == {policy.name for policy in policies}


def test_a_name_that_we_have_stays_ours(plugin: Install) -> None:
    plugin(nominal="plugin_policies:Coast")
    policies, (said,) = registered()
    assert said == "policy 'nominal' of other-package is left out: tracked-env has it"
    assert [p.distribution for p in policies if p.name == "nominal"] == ["tracked-env"]


def test_in_a_clone_that_is_not_installed_nothing_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entry_points, "entry_points", lambda group: ())
    assert [(policy.name, policy.env) for policy in registered()[0]] == ours()
    assert open_archive(shipped_agents("speed")["ppo-blind"][0]).name == "ppo-blind-seed0"


def test_in_a_clone_that_is_installed_too_everything_is_there_once(plugin: Install) -> None:
    plugin("Tracked_Env", baselines="baselines.registry")
    policies, said = registered()
    assert said == []
    assert [(policy.name, policy.env) for policy in policies] == ours()


def test_installed_without_a_clone_the_entries_of_the_distribution_count(
    plugin: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(entry_points, "_PACKAGES", tmp_path)
    to_goals = {f"slc-{name}": f"baselines.registry:slc_{name}" for name in ("replan", "once")}
    plugin("tracked-env", baselines="baselines.registry", **to_goals)
    policies, said = registered()
    assert said == []
    assert [(policy.name, policy.env) for policy in policies] == ours()


def test_of_two_agents_of_one_name_the_one_for_the_environment_is_taken() -> None:
    for env in BY_ENVIRONMENT:
        _, trained = by_name(registered()[0], env)
        shipped = shipped_agents(env)
        assert {name: trained[name] for name in shipped} == shipped
    assert shipped_agents("torque")["ppo-blind"] != shipped_agents("speed")["ppo-blind"]


def test_an_archive_that_nothing_opens_is_a_clear_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def entries(group: str) -> list[tuple[str, EntryPoint]]:
        return []

    monkeypatch.setattr(policies, "declared", entries)
    with pytest.raises(ValueError, match="no installed package opens archives"):
        open_archive(tmp_path / "agent.zip")
