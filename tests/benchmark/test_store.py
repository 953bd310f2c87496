"""What survives on disk, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from tracked_env.benchmark.store import FILE, Record, Store

IDENTITY = {"seed": 0, "sensors": "rtk"}
PRINTS = {"a": "1"}


def chunk(first: int = 0, policy: str = "a", fingerprint: str = "1", rmse: float = 0.5) -> Record:
    episodes = [{"episode": first + i, "tracking_rmse": rmse} for i in range(2)]
    return {
        "policy": policy, "fingerprint": fingerprint, "set": "s", "predict_time": 1e-6,
        "episodes": episodes,
    }  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with two finished chunks."""
    store = Store(tmp_path / "run", IDENTITY)
    store.append(chunk(0))
    store.append(chunk(2))
    return store.folder


def test_finished_chunks_are_there_after_reopening(folder: Path) -> None:
    records = Store(folder, IDENTITY).records(PRINTS)
    assert [record["episode"] for record in records] == [0, 1, 2, 3]
    assert records[0] == {
        "set": "s", "policy": "a", "predict_time": 1e-6, "episode": 0, "tracking_rmse": 0.5
    }  # fmt: skip


@pytest.mark.parametrize("keep", [1, 40, -1])
def test_a_torn_last_line_is_dropped_with_a_notice(folder: Path, keep: int) -> None:
    line = json.dumps(chunk(4)) + "\n"
    with (folder / FILE).open("a") as file:
        file.write(line[:keep])
    store = Store(folder, IDENTITY)
    assert len(store.notices) == 1
    assert "torn last line" in store.notices[0]
    assert len(store.records(PRINTS)) == 4
    store.append(chunk(4))
    again = Store(folder, IDENTITY)
    assert again.notices == []
    assert len(again.records(PRINTS)) == 6


def test_a_last_line_of_rubbish_is_dropped_too(folder: Path) -> None:
    with (folder / FILE).open("ab") as file:
        file.write(b"\x00\x00\x00\x00\n")  # what a power cut leaves on some file systems
    store = Store(folder, IDENTITY)
    assert len(store.notices) == 1
    assert len(store.records(PRINTS)) == 4


def test_damage_before_the_last_line_is_an_error_that_names_the_line(folder: Path) -> None:
    lines = (folder / FILE).read_text().splitlines(keepends=True)
    lines[1] = lines[1][:20] + "\n"
    (folder / FILE).write_text("".join(lines))
    with pytest.raises(ValueError, match="line 2 is damaged"):
        Store(folder, IDENTITY)


def test_another_configuration_in_the_same_folder_is_an_error_that_says_what_differs(
    folder: Path,
) -> None:
    with pytest.raises(ValueError, match="sensors: there 'rtk', now 'ideal'"):
        Store(folder, {**IDENTITY, "sensors": "ideal"})
    assert len(Store(folder, IDENTITY).records(PRINTS)) == 4


def test_a_file_that_is_none_of_ours_is_refused(tmp_path: Path) -> None:
    (tmp_path / FILE).write_text('{"format": 99}\n')
    with pytest.raises(ValueError, match="not a result file"):
        Store(tmp_path, IDENTITY)


def test_results_of_a_policy_whose_source_has_changed_are_skipped(folder: Path) -> None:
    store = Store(folder, IDENTITY)
    assert store.records({"a": "2"}) == []
    store.append(chunk(0, fingerprint="2", rmse=0.1))
    assert [r["tracking_rmse"] for r in store.records({"a": "2"})] == [0.1, 0.1]
    assert [r["tracking_rmse"] for r in store.records({"a": "1"})] == [0.5] * 4


def test_a_number_that_json_does_not_know_is_refused_and_leaves_no_trace(folder: Path) -> None:
    store = Store(folder, IDENTITY)
    with pytest.raises(ValueError, match="JSON compliant"):
        store.append(chunk(4, rmse=float("nan")))
    assert len(Store(folder, IDENTITY).records(PRINTS)) == 4


def test_the_header_says_what_was_run_with_what_and_where(folder: Path) -> None:
    header = json.loads((folder / FILE).read_text().splitlines()[0])
    assert header["identity"] == IDENTITY
    assert header["versions"]["numpy"] == np.__version__
    assert header["machine"]["cores"] >= 1


def test_traces_come_back_under_any_policy_name(tmp_path: Path) -> None:
    store = Store(tmp_path, IDENTITY)
    assert store.load_trace("my.module:make", "s") is None
    store.save_trace("my.module:make", "s", {"time": np.arange(3.0)})
    loaded = store.load_trace("my.module:make", "s")
    assert loaded is not None
    assert loaded["time"].tolist() == [0.0, 1.0, 2.0]
    assert [path.suffix for path in (tmp_path / "traces").iterdir()] == [".npz"]
