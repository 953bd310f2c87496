"""What of a store survives on disk, what is refused, what is left behind where writing fails."""

import errno
import io
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.identification_metrics import ESTIMATION_METRICS
from tracked_env.benchmark.metrics import CHANNELS, METRICS, OPTIONAL
from tracked_env.benchmark.store import FILE, LOCK, Store

IDENTITY = {"seed": 0, "sensors": "rtk"}


PRINTS = {"a": "1"}


def record(episode, rmse=0.5):
    """What the runner stores of an episode."""
    known = {"episode": episode, "seed": episode, "digest": f"d{episode}", "ended": "time"}
    values = dict.fromkeys(METRICS, 0.5) | dict.fromkeys(OPTIONAL)
    return {**known, **values, "tracking_rmse": rmse}


def chunk(first=0, policy="a", fingerprint="1", rmse=0.5):
    episodes = [record(first + i, rmse) for i in range(2)]
    head = {"policy": policy, "fingerprint": fingerprint, "set": "s", "predict_time": 1e-6}
    return {**head, "episodes": episodes}


def two_chunks(folder):
    """A folder in which two finished chunks are stored."""
    store = Store(folder, IDENTITY)
    store.append(chunk(0))
    store.append(chunk(2))
    return store.folder


ESTIMATE = dict.fromkeys(ESTIMATION_METRICS, 0.1)


@pytest.fixture
def folder(tmp_path):
    """A folder with two finished chunks."""
    return two_chunks(tmp_path / "run")


def test_finished_chunks_are_there_after_reopening(folder):
    records = Store(folder, IDENTITY).records(PRINTS)
    assert [record["episode"] for record in records] == [0, 1, 2, 3]
    assert records[0] == {"set": "s", "policy": "a", "predict_time": 1e-6, **record(0)}


LINE = json.dumps(chunk(4)).encode() + b"\n"


# Zeros are what a power cut leaves on some file systems.
@pytest.mark.parametrize("torn", [LINE[:1], LINE[:40], LINE[:-1], b"\x00\x00\x00\x00\n"])
def test_a_torn_last_line_is_dropped_with_a_notice(folder, torn):
    with (folder / FILE).open("ab") as file:
        file.write(torn)
    store = Store(folder, IDENTITY)
    assert len(store.notices) == 1 and "torn last line" in store.notices[0]
    assert len(store.records(PRINTS)) == 4
    store.append(chunk(4))
    again = Store(folder, IDENTITY)
    assert again.notices == [] and len(again.records(PRINTS)) == 6


def test_damage_before_the_last_line_is_an_error_that_names_the_line(folder):
    lines = (folder / FILE).read_text().splitlines(keepends=True)
    lines[1] = lines[1][:20] + "\n"
    (folder / FILE).write_text("".join(lines))
    with pytest.raises(ValueError, match="line 2 is damaged"):
        Store(folder, IDENTITY)


def test_another_configuration_in_the_same_folder_is_an_error_that_says_what_differs(folder):
    with pytest.raises(ValueError, match="sensors: there 'rtk', now 'ideal'"):
        Store(folder, {**IDENTITY, "sensors": "ideal"})
    assert len(Store(folder, IDENTITY).records(PRINTS)) == 4


def test_results_of_a_policy_whose_source_has_changed_are_skipped(folder):
    store = Store(folder, IDENTITY)
    assert store.records({"a": "2"}) == []
    store.append(chunk(0, fingerprint="2", rmse=0.1))
    assert [r["tracking_rmse"] for r in store.records({"a": "2"})] == [0.1, 0.1]
    assert [r["tracking_rmse"] for r in store.records({"a": "1"})] == [0.5] * 4


def test_a_number_that_json_does_not_know_is_refused_and_leaves_no_trace(folder):
    store = Store(folder, IDENTITY)
    with pytest.raises(ValueError, match="JSON compliant"):
        store.append(chunk(4, rmse=float("nan")))
    assert len(Store(folder, IDENTITY).records(PRINTS)) == 4


def test_the_header_says_what_was_run_with_what_and_where(folder):
    header = json.loads((folder / FILE).read_text().splitlines()[0])
    assert header["identity"] == IDENTITY
    assert header["versions"]["numpy"] == np.__version__
    assert header["machine"]["cores"] >= 1


def edited(folder, line, change):
    """Put something else into a line of the results."""
    path = folder / FILE
    lines = path.read_text().splitlines()
    lines[line] = change(lines[line]) if callable(change) else change
    path.write_text("\n".join(lines) + "\n")


def changed(**fields):
    """What edits a line: these fields of a header, a chunk or its first record are others."""

    def change(line):
        whole = json.loads(line)
        inner = whole["episodes"][0] if {*fields} - {*whole} - {"more"} else whole
        inner.update(fields)
        return json.dumps(whole)

    return change


@pytest.mark.parametrize(
    "header",
    [
        *("[]", "5", "null", "{}", '"text"', "[" * 100_000, "\x00", '{"format": 99}'),
        *(changed(hash=5), changed(hash="0" * 12), changed(identity=[]), changed(more=1)),
        *(changed(identity={"seed": 1}), changed(versions=None), changed(machine="mine")),
        changed(format="2"),
    ],
)
def test_a_damaged_header_is_one_line_that_names_the_file(folder, header):
    edited(folder, 0, header)
    with pytest.raises(ValueError, match=r"episodes\.jsonl cannot be continued: .*") as caught:
        Store(folder, IDENTITY)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("line", [1, 2])
@pytest.mark.parametrize("text", ["[]", "5", "null", "{}", '"text"', "true"])
def test_a_line_that_is_no_chunk_is_refused_wherever_it_is(folder, line, text):
    edited(folder, line, text)
    with pytest.raises(ValueError, match=f"line {line + 1} is damaged") as caught:
        Store(folder, IDENTITY)
    assert "\n" not in str(caught.value)


def test_records_of_every_kind_that_the_runner_makes_are_read(folder):
    first = {"recovery_time": 0.0, "identification": {"mass": ESTIMATE}, "nis": {"filter": None}}
    second = {
        "identification": {"mass": {**ESTIMATE, "settling_time": None}},
        "nis": {"filter": 2.0},
    }
    episodes = [{**record(4), **first}, {**record(5), **second}]
    Store(folder, IDENTITY).append({**chunk(4), "episodes": episodes})
    assert len(Store(folder, IDENTITY).records(PRINTS)) == 6


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("tracking_rmse", "small", "tracking_rmse of episode 0 = 'small'; must be a finite"),
        ("tracking_rmse", float("nan"), "tracking_rmse of episode 0 = nan"),
        ("max_error", float("inf"), "max_error of episode 0 = inf"),
        ("tracking_rmse", -1.0, r".*= -1\.0; must be a finite number >= 0"),
        ("tracking_rmse", None, "tracking_rmse of episode 0 = None"),
        ("tracking_rmse", True, "tracking_rmse of episode 0 = True"),
        pytest.param("energy", 10**400, "energy of episode 0", id="larger than any float"),
        ("success", 7.0, r"success of episode 0 = 7\.0; must be a finite number in \[0, 1\]"),
        ("recovery_time", "soon", "recovery_time of episode 0 = 'soon'"),
        ("episode", "first", "episode of episode 'first' = 'first'; must be an integer"),
        ("seed", 1.5, r"seed of episode 0 = 1\.5"),
        ("digest", 3, "digest of episode 0 = 3; must be text"),
        ("ended", "well", "ended of episode 0 = 'well'; must be one of"),
        ("note", "mine", "episode 0 has 'note', which is not known"),
        ("identification", [], r"identification of episode 0 = \[\]; must be a dict"),
        ("identification", {"mass": 3}, "episode 0, estimate of 'mass' is 3"),
        ("identification", {"mass": {}}, "episode 0, estimate of 'mass' lacks relative_rmse"),
        (
            "identification",
            {"mass": {**ESTIMATE, "nees": "x"}},
            "nees of episode 0, estimate of 'mass' = 'x'",
        ),
        ("nis", {"filter": float("nan")}, "filter of episode 0, nis = nan"),
        *(
            (name, wrong, f"{name} of the chunk")
            for name in ("policy", "fingerprint", "set", "predict_time", "episodes")
            for wrong in (None, "5" if name == "predict_time" else 5, {})
        ),
    ],
)
def test_a_record_with_text_or_no_number_is_refused_when_it_is_read(folder, place, value, message):
    edited(folder, 1, changed(**{place: value}))
    with pytest.raises(ValueError, match=f"line 2 is damaged .{message}"):
        Store(folder, IDENTITY)


def motion():
    """A trace as `figure_data` makes it."""
    return {
        "episodes": np.arange(2),
        "time": np.arange(3.0),
        "error": np.zeros((3, 2), np.float32),
        "change": np.array([1.0, np.nan]),
        "motion": np.zeros((3, 2, len(CHANNELS)), np.float32),
        "control_period": np.array(0.02),
    }


def test_traces_come_back_under_any_policy_name(tmp_path):
    store = Store(tmp_path, IDENTITY)
    assert store.load_trace("my.module:make", "s") is None
    store.save_trace("my.module:make", "s", motion())
    loaded = store.load_trace("my.module:make", "s")
    assert loaded["time"].tolist() == [0.0, 1.0, 2.0]
    assert [path.suffix for path in (tmp_path / "traces").iterdir()] == [".npz"]


def test_no_two_policies_or_sets_share_a_file_on_any_file_system(tmp_path):
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
    ]
    names += ["b--b", "x" * 300, "x" * 301, "x" * 60, "a@0", "a~0", "a_", "_a"]
    pairs = [(policy, of_set) for policy in names for of_set in names]
    files = {store.trace_path(*pair).name.lower() for pair in pairs}
    assert len(files) == len(pairs)
    assert all(name.isascii() and len(name) < 200 for name in files)
    assert store.trace_path("nominal", "weak-soil").name == "weak-soil--nominal.npz"
    for number, name in enumerate(names):
        store.save_trace(name, "s", {**motion(), "time": np.full(3, float(number))})
    for number, name in enumerate(names):
        loaded = store.load_trace(name, "s")
        assert loaded["time"][0] == number


def damaged_traces():
    """Bytes or arrays that are none of a trace."""
    whole = io.BytesIO()
    np.savez(whole, **motion())
    single = io.BytesIO()
    np.save(single, np.zeros(3))
    data = whole.getvalue()
    return {
        **{"a folder": None, "empty": b"", "text": b"mine", "torn": data[:500], "nothing": {}},
        "spoilt": data[:70] + b"\xff" * 60 + data[130:],
        "array": single.getvalue(),
        "flat": {**motion(), "motion": np.zeros(3)},
        "few channels": {**motion(), "motion": np.zeros((3, 2, 4))},
        "no rows": {**motion(), "motion": np.zeros((0, 2, len(CHANNELS)))},
        "other times": {**motion(), "time": np.zeros(4)},
        "text inside": {**motion(), "error": np.full((3, 2), "x")},
        "objects": {**motion(), "error": np.full((3, 2), None)},
        "half a belief": {**motion(), "believed_names": np.array(["mass"])},
    }


@pytest.mark.parametrize("kind", damaged_traces())
def test_a_damaged_trace_is_left_out_with_a_notice(tmp_path, kind):
    store = Store(tmp_path, IDENTITY)
    given = damaged_traces()[kind]
    path = store.trace_path("a", "s")
    if given is None:
        path.mkdir(parents=True)
    elif isinstance(given, bytes):
        path.parent.mkdir()
        path.write_bytes(given)
    else:
        store.save_trace("a", "s", given)
    assert store.load_trace("a", "s") is None
    (notice,) = store.notices
    assert f"{path} is damaged and left out of the figures" in notice


HOLDING = """
import sys, time
from pathlib import Path
from tests.benchmark.test_store import IDENTITY
from tracked_env.benchmark.store import Store

store = Store(Path(sys.argv[1]), IDENTITY)
print("open", flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize("kind", ["file", "below a file", "too long", "proc", "results", "lock"])
def test_a_folder_that_cannot_hold_results_is_one_line(tmp_path, kind):
    (tmp_path / "file").write_text("mine")
    places = {"below a file": "file/below", "too long": "x" * 5000, "proc": "/proc/nothing/here"}
    places |= {"file": "file", "results": "", "lock": ""}
    folder = tmp_path / places[kind]
    if kind in ("results", "lock"):
        (tmp_path / (FILE if kind == "results" else LOCK)).mkdir()
    with pytest.raises(ValueError, match="Results need a folder that can be written") as caught:
        Store(folder, IDENTITY)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert (tmp_path / "file").read_text() == "mine"


def full(*arguments):
    raise OSError(errno.ENOSPC, "No space left on device")


WRITE = os.write


@pytest.mark.parametrize(
    ("call", "instead", "message"),
    [
        *(("write", full, "No space left on device"), ("fsync", full, "No space left on device")),
        ("write", lambda *to: 0, r"0 of \d+ bytes written.*is the disk full"),
        ("write", lambda file, data: WRITE(file, data[:100]), r"100 of \d+ bytes written"),
    ],
)
def test_a_write_that_fails_or_is_short_leaves_the_file_as_it_was(
    folder, monkeypatch, call, instead, message
):
    store = Store(folder, IDENTITY)
    before = (folder / FILE).read_bytes()
    monkeypatch.setattr(os, call, instead)
    with pytest.raises(OSError, match=rf"episodes\.jsonl: .*{message}") as caught:
        store.append(chunk(4))
    assert "\n" not in str(caught.value)
    monkeypatch.undo()
    assert (folder / FILE).read_bytes() == before
    assert len(store.chunks) == 2 and len(store.records(PRINTS)) == 4
    store.append(chunk(4))
    assert len(Store(folder, IDENTITY).records(PRINTS)) == 6


def test_results_that_were_deleted_meanwhile_are_not_begun_without_a_header(folder):
    store = Store(folder, IDENTITY)
    (folder / FILE).unlink()
    with pytest.raises(OSError, match="No such file"):
        store.append(chunk(4))
    assert not (folder / FILE).exists()


def test_no_temporary_file_survives_a_failure_or_a_rerun(folder, monkeypatch):
    store = Store(folder, IDENTITY)
    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space left"):
        store.save_trace("a", "s", {"time": np.arange(3.0)})
    with pytest.raises(OSError, match="No space left"):
        write_atomically(folder / "results.json", b"{}")
    monkeypatch.undo()
    assert [path.name for path in folder.rglob("*.tmp")] == []
    del store
    names = ".results.json.4711.tmp", "traces/.s--a.npz.1.tmp", "videos/.x.2.tmp/new/episode.mp4"
    killed = [folder / name for name in names]
    for path in killed:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"half")
    mine = folder / "notes.tmp"
    mine.write_text("mine")
    again = Store(folder, IDENTITY)
    assert list(folder.rglob("*.tmp")) == [mine]
    assert len(again.records(PRINTS)) == 4


def test_a_folder_is_open_in_one_process_at_a_time_and_a_killed_one_blocks_nothing(
    folder, repository
):
    partial = folder / ".results.json.4711.tmp"
    command = [sys.executable, "-c", HOLDING, str(folder)]
    with subprocess.Popen(command, cwd=repository, stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout
            assert other.stdout.readline() == "open\n"
            partial.write_bytes(b"being written")
            with (folder / FILE).open("a") as file:
                file.write('{"half')
            with pytest.raises(ValueError, match="another process writes results there"):
                Store(folder, IDENTITY)
            assert partial.exists()
            assert (folder / FILE).read_text().endswith('{"half')
        finally:
            other.kill()
    assert len(Store(folder, IDENTITY).records(PRINTS)) == 4
    assert not partial.exists()


def test_a_process_may_open_its_folder_again(folder):
    first, second = Store(folder, IDENTITY), Store(folder, IDENTITY)
    first.append(chunk(4))
    del first
    second.append(chunk(6))
    assert len(Store(folder, IDENTITY).records(PRINTS)) == 8
