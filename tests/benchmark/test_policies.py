"""Policies by name: registered ones, modules, archives through an opener, seeds of one agent."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from baselines import registry as shipped
from baselines.registry import BY_ENVIRONMENT, PRETRAINED, TRUE_MOTION, shipped_agents
from tests.benchmark.plugin_package import install
from tests.benchmark.stub_policies import Constant, entry
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID, entry_points
from tracked_env.benchmark import PolicyContext
from tracked_env.benchmark import policies as lookup

REGISTRY = {"nominal": lambda context: Constant()}


def opened(path):
    return entry(path.stem, lambda context: Constant(), fingerprint=str(path))


def made(folder, *names):
    paths = [folder / name for name in names]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    return paths


def names(specs, shipped=None):
    return [e.name for e in lookup.load_policies(specs, {**REGISTRY, **(shipped or {})}, opened)]


@pytest.mark.parametrize(
    ("files", "specs", "expected"),
    [
        (
            ("ppo-seed0/agent", "ppo-seed12/agent"),
            ("mine={}/ppo-*/agent.zip",),
            ["mine@0", "mine@12"],
        ),
        (
            ("ppo-seed0/agent", "ppo-seed1/agent", "sac/agent"),
            ("{}/ppo-seed0/agent.zip", "nominal", "{}/sac/agent.zip", "{}/ppo-seed1/agent.zip"),
            ["ppo@0", "ppo@1", "nominal", "sac@0"],
        ),
        (("a/agent", "b/agent"), ("mine={}/?/agent.zip",), ["mine@0", "mine@1"]),
        (("x7",), ("{}/x7.zip",), ["x7@7"]),
        (("a/run4/agent", "b/run4/agent"), ("mine={}/*/run4/agent.zip",), ["mine@0", "mine@1"]),
    ],
)
def test_archives_of_a_pattern_or_with_names_that_differ_in_the_seed_are_one_agent(
    files, specs, expected, tmp_path
):
    made(tmp_path, *(f"{name}.zip" for name in files))
    found = lookup.load_policies([spec.format(tmp_path) for spec in specs], REGISTRY, opener=opened)
    assert [entry.name for entry in found] == expected
    paths = [Path(entry.fingerprint) for entry in found if "@" in entry.name]
    assert len(set(paths)) == len(paths) and all(path.exists() for path in paths)


def test_a_registered_agent_is_known_by_its_name_with_all_its_seeds(tmp_path):
    first, second, other = made(
        tmp_path, "ppo-seed0/agent.zip", "ppo-seed1/agent.zip", "tqc/agent.zip"
    )
    shipped = {"ppo": [first, second], "tqc": [other]}
    assert names(["tqc", "ppo"], shipped=shipped) == ["tqc@0", "ppo@0", "ppo@1"]
    assert names(["new=ppo"], shipped=shipped) == ["new@0", "new@1"]
    assert lookup.archives("new=ppo", shipped) == [("new", path) for path in shipped["ppo"]]


def test_one_training_of_a_registered_agent_is_called_as_among_all_of_them(tmp_path):
    shipped = {"ppo": made(tmp_path, "ppo-seed0/agent.zip", "ppo-seed1/agent.zip")}
    assert names(["ppo@1"], shipped=shipped) == ["ppo@1"]
    assert names(["new=ppo@1", "ppo@0"], shipped=shipped) == ["new@1", "ppo@0"]
    assert names(["ppo@1", "ppo"], shipped=shipped) == ["ppo@1", "ppo@0"]
    assert lookup.archives("ppo@1", shipped) == [("ppo", shipped["ppo"][1])]
    with pytest.raises(ValueError, match=r"unknown seed of 'ppo' '7'; known are \['0', '1'\]"):
        names(["ppo@7"], shipped=shipped)


def test_an_agent_without_archives_is_refused_with_where_they_are():
    for spec in ("tqc", "new=tqc"):
        with pytest.raises(ValueError, match=r"'tqc' .* 0 archives .* wheel .* clone") as refused:
            names(["nominal", spec], shipped={"tqc": []})
        assert "\n" not in str(refused.value)


def test_any_policy_can_be_renamed():
    spec = "tests.benchmark.stub_policies:Constant"
    assert names([f"mine={spec}", "base=nominal", spec]) == ["mine", "base", spec]


@pytest.mark.parametrize("before", ["", "mine="])
def test_a_path_may_hold_the_sign_that_ends_a_name(before, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made(tmp_path, "runs/lr=3e-4/agent.zip", "lr=1e-3/agent.zip", "a=b.zip")
    for path, own in (
        ("runs/lr=3e-4/agent.zip", "lr=3e-4"),
        ("lr=1e-3/agent.zip", "lr=1e-3"),
        ("a=b.zip", "a=b"),
        ("runs/lr=*/agent.zip", "lr=3e-4"),
        (str(tmp_path / "runs/lr=3e-4/agent.zip"), "lr=3e-4"),
    ):
        (policy,) = lookup.load_policies([f"{before}{path}"], REGISTRY, opener=opened)
        assert Path(policy.fingerprint).exists()
        assert policy.name.rpartition("@")[0] == ("mine" if before else own)


@pytest.mark.parametrize(
    ("specs", "message"),
    [
        (["nominl"], "Did you mean 'nominal'"),
        (["ppi"], "Did you mean 'ppo'"),
        (["a\nb=nominal"], "at most 200 characters that can be printed"),
        (["\x1b[2J=nominal"], "that can be printed"),
        ([f"{'x' * 201}=nominal"], "at most 200 characters"),
        (["ppo@1=nominal"], "without @, which marks seeds"),
        (["nominal", "nominal=tests.benchmark.stub_policies:Constant"], "two policies are called"),
    ],
)
def test_what_is_not_known_is_said(specs, message):
    with pytest.raises(ValueError, match=message):
        names(specs, shipped={"ppo": [Path("agent.zip")]})


def test_an_archive_that_is_not_there_is_left_to_the_opener_to_refuse():
    seen = []

    def opener(path):
        seen.append(path)
        raise ValueError(f"{path}: no such file")

    with pytest.raises(ValueError, match="no such file"):
        lookup.load_policies(["runs/none/agent.zip"], REGISTRY, opener=opener)
    assert seen == [Path("runs/none/agent.zip")]


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """Installs a package with entries of its own."""
    return partial(install, tmp_path, monkeypatch)


def registered():
    """What is registered, and what is said to be left out."""
    said = []
    return lookup.registered_policies(said.append), said


def ours():
    return [
        *(
            (name, lookup.ENVIRONMENTS[env])
            for env, names in BY_ENVIRONMENT.items()
            for name in (*names, *shipped_agents(env))
        ),
        *((name, None) for name in (*TRUE_MOTION, "adaptive-learned-observer", "any-vehicle-told")),
        ("slc-once", None),  # they need a goal, and are compared where they are named
        ("slc-replan", None),
    ]


def test_controllers_and_shipped_agents_are_registered_per_environment_in_their_order():
    policies, said = registered()
    assert [(policy.name, policy.env) for policy in policies[: len(ours())]] == ours()
    assert said == []
    known = (
        *("nominal", "nominal-centred", "integral", "integral-centred"),
        *("l1", "mrac", "adaptive", "oracle"),
    )
    assert lookup.default_names(policies, "torque")[:8] == known
    assert "ppo-estimates" in lookup.default_names(policies, "torque")
    assert "ppo-estimates" not in lookup.default_names(policies, SPEED_ID)
    assert lookup.default_names(policies, "speed") == lookup.default_names(policies, SPEED_ID)
    on_slopes = lookup.default_names(policies, TERRAIN_ID)
    assert on_slopes[0] == "uc" and {"slc-adaptive", "slc-oracle"} < set(on_slopes)
    assert all(policy.summary and "\n" not in policy.summary for policy in policies)


def test_every_shipped_archive_is_registered():
    found = {path for policy in registered()[0] if policy.is_trained for path in policy.policy}
    assert found == set(PRETRAINED.glob("*/*/agent.zip"))


def test_agents_whose_archives_are_not_installed_are_known_and_not_compared(tmp_path, monkeypatch):
    for scores in PRETRAINED.glob(f"*/{shipped.SCORES}"):
        (tmp_path / scores.parent.name).mkdir()
        (tmp_path / scores.parent.name / scores.name).write_bytes(scores.read_bytes())
    before = {env: list(shipped_agents(env)) for env in BY_ENVIRONMENT}
    monkeypatch.setattr(shipped, "PRETRAINED", tmp_path)
    policies, said = registered()
    assert said == []
    for env, names in BY_ENVIRONMENT.items():
        absent = shipped_agents(env)
        assert sorted(absent) == sorted(before[env]) and not any(absent.values())
        assert lookup.default_names(policies, env) == names
    assert {one.summary for one in policies if one.is_trained} == {
        "trained agent, its archives are not installed"
    }
    with pytest.raises(ValueError, match="Source distributions leave them out"):
        lookup.load_policies(["ppo-blind"], lookup.by_name(policies, "torque"), lookup.open_archive)


def test_a_policy_of_an_installed_package_is_known_by_its_name(plugin):
    plugin(coast="plugin_policies:Coast", anywhere="plugin_policies:Anywhere")
    policies, said = registered()
    assert said == []
    (coast,) = [policy for policy in policies if policy.name == "coast"]
    assert (coast.env, coast.distribution) == (TORQUE_ID, "other-package")
    assert coast.summary == "Lets the vehicle coast."
    assert lookup.default_names(policies, "torque")[-1] == "coast"  # behind ours
    assert "anywhere" not in lookup.default_names(policies, "torque")  # only by its name
    known = lookup.by_name(policies, "torque")
    entry, second = lookup.load_policies(["coast", "anywhere"], known, lookup.open_archive)
    policy = entry.make(PolicyContext(0.02, "sliding"))
    action, _ = policy.predict(np.zeros((2, 31), dtype=np.float32))
    assert action.shape == (2, 2)
    assert entry.name == "coast" and second.name == "anywhere"


def test_one_entry_can_register_many_policies(plugin):
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
def test_a_broken_package_is_one_line_that_names_it_and_the_others_work(value, message, plugin):
    plugin(broken=value, coast="plugin_policies:Coast")
    policies, (said,) = registered()
    assert said.startswith(f"policies 'broken' of other-package ({value}) are left out: ")
    assert message in said and "\n" not in said
    assert {name for name, _ in ours()} | {"coast"} == {policy.name for policy in policies}


def test_a_name_that_we_have_stays_ours(plugin):
    plugin(nominal="plugin_policies:Coast")
    policies, (said,) = registered()
    assert said == "policy 'nominal' of other-package is left out: tracked-env has it"
    assert [p.distribution for p in policies if p.name == "nominal"] == ["tracked-env"]


@pytest.mark.parametrize("place", ["clone", "both", "installed"])
def test_in_a_clone_installed_or_both_everything_is_there_once(
    place, plugin, tmp_path, monkeypatch
):
    if place == "clone":
        monkeypatch.setattr(entry_points, "entry_points", lambda group: ())
    elif place == "both":
        plugin("Tracked_Env", baselines="baselines.registry")
    else:
        monkeypatch.setattr(entry_points, "_PACKAGES", tmp_path)
        to_goals = {f"slc-{name}": f"baselines.registry:slc_{name}" for name in ("replan", "once")}
        plugin("tracked-env", baselines="baselines.registry", **to_goals)
    policies, said = registered()
    assert said == []
    assert [(policy.name, policy.env) for policy in policies] == ours()
    if place == "clone":
        entry = shipped_agents("speed")["ppo-reckoned"][0]
        assert lookup.open_archive(entry).name == "ppo-reckoned-seed0"


def test_of_two_agents_of_one_name_the_one_for_the_environment_is_taken():
    for env in BY_ENVIRONMENT:
        known = lookup.by_name(registered()[0], env)
        shipped = shipped_agents(env)
        assert {name: known[name] for name in shipped} == shipped
    by_speed, on_slopes = (shipped_agents(env)["ppo-reckoned"] for env in (SPEED_ID, TERRAIN_ID))
    assert by_speed != on_slopes


def test_an_archive_that_nothing_opens_is_a_clear_error(tmp_path, monkeypatch):
    monkeypatch.setattr(lookup, "declared", lambda group: [])
    with pytest.raises(ValueError, match="no installed package opens archives"):
        lookup.open_archive(tmp_path / "agent.zip")
