"""The traces of a store: names of files on any file system, and damaged ones."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tracked_env.benchmark.metrics import CHANNELS
from tracked_env.benchmark.store import Store

IDENTITY = {"seed": 0, "sensors": "rtk"}


def motion() -> dict[str, np.ndarray]:
    """A trace as `figure_data` makes it."""
    return {
        "time": np.arange(3.0), "error": np.zeros((3, 2), np.float32),
        "change": np.array([1.0, np.nan]),
        "motion": np.zeros((3, 2, len(CHANNELS)), np.float32), "control_period": np.array(0.02),
    }  # fmt: skip


def test_traces_come_back_under_any_policy_name(tmp_path: Path) -> None:
    store = Store(tmp_path, IDENTITY)
    assert store.load_trace("my.module:make", "s") is None
    store.save_trace("my.module:make", "s", motion())
    loaded = store.load_trace("my.module:make", "s")
    assert loaded is not None
    assert loaded["time"].tolist() == [0.0, 1.0, 2.0]
    assert [path.suffix for path in (tmp_path / "traces").iterdir()] == [".npz"]


def test_no_two_policies_or_sets_share_a_file_on_any_file_system(tmp_path: Path) -> None:
    store = Store(tmp_path, IDENTITY)
    names = [
        "a_b",
        "a/b",
        "a\\b",
        "A_b",
        "a b",
        "a:b",
        "ä",
        "a\u0308",
        "..",
        "",
        "a|b",
        "a--b",
        "b",
        "b--b",
    ]
    names += ["x" * 300, "x" * 301, "x" * 60, "a@0", "a~0", "a_", "_a"]
    pairs = [(policy, of_set) for policy in names for of_set in names]
    files = {store.trace_path(*pair).name.lower() for pair in pairs}
    assert len(files) == len(pairs)
    assert all(name.isascii() and len(name) < 200 for name in files)
    assert store.trace_path("nominal", "weak-soil").name == "weak-soil--nominal.npz"
    for number, name in enumerate(names):
        store.save_trace(name, "s", {**motion(), "time": np.full(3, float(number))})
    for number, name in enumerate(names):
        loaded = store.load_trace(name, "s")
        assert loaded is not None
        assert loaded["time"][0] == number


def damaged_traces() -> dict[str, Any]:
    """Bytes or arrays that are none of a trace."""
    whole = io.BytesIO()
    np.savez(whole, **motion())
    single = io.BytesIO()
    np.save(single, np.zeros(3))
    data = whole.getvalue()
    return {
        "empty": b"", "text": b"mine", "torn": data[:500],
        "spoilt": data[:70] + b"\xff" * 60 + data[130:],
        "array": single.getvalue(), "nothing": {}, "flat": {**motion(), "motion": np.zeros(3)},
        "few channels": {**motion(), "motion": np.zeros((3, 2, 4))},
        "no rows": {**motion(), "motion": np.zeros((0, 2, len(CHANNELS)))},
        "other times": {**motion(), "time": np.zeros(4)},
        "text inside": {**motion(), "error": np.full((3, 2), "x")},
        "objects": {**motion(), "error": np.full((3, 2), None)},
        "half a belief": {**motion(), "believed_names": np.array(["mass"])},
    }  # fmt: skip


@pytest.mark.parametrize("kind", damaged_traces())
def test_a_damaged_trace_is_left_out_with_a_notice(tmp_path: Path, kind: str) -> None:
    store = Store(tmp_path, IDENTITY)
    given = damaged_traces()[kind]
    path = store.trace_path("a", "s")
    if isinstance(given, bytes):
        path.parent.mkdir()
        path.write_bytes(given)
    else:
        store.save_trace("a", "s", given)
    assert store.load_trace("a", "s") is None
    (notice,) = store.notices
    assert f"{path} is damaged and left out of the figures" in notice


def test_a_trace_that_is_a_folder_is_left_out_with_a_notice(tmp_path: Path) -> None:
    store = Store(tmp_path, IDENTITY)
    store.trace_path("a", "s").mkdir(parents=True)
    assert store.load_trace("a", "s") is None
    assert len(store.notices) == 1
