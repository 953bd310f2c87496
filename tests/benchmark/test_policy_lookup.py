"""Policies from a command line: names, modules, archives through an opener, seeds of one agent."""

from pathlib import Path

import pytest

from tests.benchmark.stub_policies import Constant, entry
from tracked_env.benchmark.policies import archives, load_policies
from tracked_env.benchmark.policy_interface import PolicyEntry

REGISTRY = {"nominal": lambda context: Constant()}


def opened(path: Path) -> PolicyEntry:
    return entry(path.stem, lambda context: Constant(), fingerprint=str(path))


def made(folder: Path, *names: str) -> list[Path]:
    paths = [folder / name for name in names]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    return paths


def names(specs: list[str], **options: object) -> list[str]:
    options = {"opener": opened, **options}
    return [e.name for e in load_policies(specs, REGISTRY, **options)]  # type: ignore[arg-type]


def test_every_file_of_a_pattern_is_a_training_of_the_agent_named(tmp_path: Path) -> None:
    made(tmp_path, "ppo-seed0/agent.zip", "ppo-seed12/agent.zip", "other/agent.zip")
    found = load_policies([f"mine={tmp_path}/ppo-*/agent.zip"], REGISTRY, opener=opened)
    assert [e.name for e in found] == ["mine@0", "mine@12"]
    assert [e.fingerprint for e in found] == [
        str(tmp_path / f"ppo-seed{i}/agent.zip") for i in (0, 12)
    ]


def test_archives_whose_names_differ_in_the_seed_alone_are_one_agent(tmp_path: Path) -> None:
    files = made(tmp_path, "ppo-seed0/agent.zip", "ppo-seed1/agent.zip", "sac/agent.zip")
    specs = [str(files[0]), "nominal", str(files[2]), str(files[1])]
    assert names(specs) == ["ppo@0", "ppo@1", "nominal", "sac@0"]


def test_files_without_a_number_are_counted(tmp_path: Path) -> None:
    made(tmp_path, "a/agent.zip", "b/agent.zip", "x7.zip")
    assert names([f"mine={tmp_path}/?/agent.zip"]) == ["mine@0", "mine@1"]
    assert names([f"{tmp_path}/x7.zip"]) == ["x7@7"]


def test_a_registered_agent_is_known_by_its_name_with_all_its_seeds(tmp_path: Path) -> None:
    first, second, other = made(
        tmp_path, "ppo-seed0/agent.zip", "ppo-seed1/agent.zip", "tqc/agent.zip"
    )
    shipped = {"ppo": [first, second], "tqc": [other]}
    assert names(["tqc", "ppo"], shipped=shipped) == ["tqc@0", "ppo@0", "ppo@1"]
    assert names(["new=ppo"], shipped=shipped) == ["new@0", "new@1"]
    assert archives("new=ppo", shipped) == [("new", path) for path in shipped["ppo"]]


def test_one_training_of_a_registered_agent_is_called_as_among_all_of_them(tmp_path: Path) -> None:
    shipped = {"ppo": made(tmp_path, "ppo-seed0/agent.zip", "ppo-seed1/agent.zip")}
    assert names(["ppo@1"], shipped=shipped) == ["ppo@1"]
    assert names(["new=ppo@1", "ppo@0"], shipped=shipped) == ["new@1", "ppo@0"]
    assert names(["ppo@1", "ppo"], shipped=shipped) == ["ppo@1", "ppo@0"]
    assert archives("ppo@1", shipped) == [("ppo", shipped["ppo"][1])]
    with pytest.raises(ValueError, match=r"unknown seed of 'ppo' '7'; known are \['0', '1'\]"):
        names(["ppo@7"], shipped=shipped)


def test_an_agent_without_archives_is_refused_with_where_they_are() -> None:
    for spec in ("tqc", "new=tqc"):
        with pytest.raises(ValueError, match=r"'tqc' .* 0 archives .* wheel .* clone") as refused:
            names(["nominal", spec], shipped={"tqc": []})
        assert "\n" not in str(refused.value)


def test_any_policy_can_be_renamed() -> None:
    spec = "tests.benchmark.stub_policies:Constant"
    assert names([f"mine={spec}", "base=nominal", spec]) == ["mine", "base", spec]


@pytest.mark.parametrize("before", ["", "mine="])
def test_a_path_may_hold_the_sign_that_ends_a_name(
    before: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    made(tmp_path, "runs/lr=3e-4/agent.zip", "lr=1e-3/agent.zip", "a=b.zip")
    for path, own in (
        ("runs/lr=3e-4/agent.zip", "lr=3e-4"),
        ("lr=1e-3/agent.zip", "lr=1e-3"),
        ("a=b.zip", "a=b"),
        ("runs/lr=*/agent.zip", "lr=3e-4"),
        (str(tmp_path / "runs/lr=3e-4/agent.zip"), "lr=3e-4"),
    ):
        (policy,) = load_policies([f"{before}{path}"], REGISTRY, opener=opened)
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
def test_what_is_not_known_is_said(specs: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        names(specs, shipped={"ppo": [Path("agent.zip")]})


def test_without_an_opener_an_archive_is_refused() -> None:
    for spec in ("agent.zip", "ppo"):
        with pytest.raises(ValueError, match=r"archives of agents|unknown policy"):
            load_policies([spec], REGISTRY, shipped={"ppo": [Path("agent.zip")]})


def test_an_archive_that_is_not_there_is_left_to_the_opener_to_refuse() -> None:
    seen: list[Path] = []

    def opener(path: Path) -> PolicyEntry:
        seen.append(path)
        raise ValueError(f"{path}: no such file")

    with pytest.raises(ValueError, match="no such file"):
        load_policies(["runs/none/agent.zip"], REGISTRY, opener=opener)
    assert seen == [Path("runs/none/agent.zip")]


def test_two_files_of_one_number_are_counted_instead(tmp_path: Path) -> None:
    made(tmp_path, "a/run4/agent.zip", "b/run4/agent.zip")
    assert names([f"mine={tmp_path}/*/run4/agent.zip"]) == ["mine@0", "mine@1"]
