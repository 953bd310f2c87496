"""What a store leaves behind where writing fails, or where two processes want it."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.benchmark.store_cases import IDENTITY, PRINTS, chunk, two_chunks
from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.store import FILE, LOCK, Store

LIMITED = """
import resource, signal, sys
from pathlib import Path
from tests.benchmark.test_store import IDENTITY, chunk
from tracked_env.benchmark.store import FILE, Store

store = Store(Path(sys.argv[1]), IDENTITY)
size = (store.folder / FILE).stat().st_size + 100
resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
try:
    store.append(chunk(4))
except OSError as error:
    sys.exit(f"failed: {error}")
"""

HOLDING = """
import sys, time
from pathlib import Path
from tests.benchmark.test_store import IDENTITY
from tracked_env.benchmark.store import Store

store = Store(Path(sys.argv[1]), IDENTITY)
print("open", flush=True)
time.sleep(600)
"""


@pytest.fixture
def folder(tmp_path):
    """A folder with two finished chunks."""
    return two_chunks(tmp_path / "run")


@pytest.mark.parametrize("kind", ["file", "below a file", "too long", "proc", "results", "lock"])
def test_a_folder_that_cannot_hold_results_is_one_line(tmp_path, kind):
    (tmp_path / "file").write_text("mine")
    folder = {
        "file": tmp_path / "file", "below a file": tmp_path / "file" / "below",
        "too long": tmp_path / ("x" * 5000), "proc": Path("/proc/nothing/here"),
        "results": tmp_path, "lock": tmp_path,
    }[kind]  # fmt: skip
    if kind in ("results", "lock"):
        (tmp_path / (FILE if kind == "results" else LOCK)).mkdir()
    with pytest.raises(ValueError, match="Results need a folder that can be written") as caught:
        Store(folder, IDENTITY)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("written", [0, 100])
def test_a_short_write_fails_and_leaves_the_file_as_it_was(folder, monkeypatch, written):
    store = Store(folder, IDENTITY)
    before = (folder / FILE).read_bytes()
    write = os.write
    monkeypatch.setattr(os, "write", lambda file, data: write(file, data[:written]))
    with pytest.raises(
        OSError, match=rf"{written} of \d+ bytes written.*is the disk full"
    ) as caught:
        store.append(chunk(4))
    assert "\n" not in str(caught.value)
    monkeypatch.undo()
    assert (folder / FILE).read_bytes() == before
    assert len(store.records(PRINTS)) == 4
    store.append(chunk(4))
    assert len(Store(folder, IDENTITY).records(PRINTS)) == 6


@pytest.mark.parametrize("failing", ["fsync", "write"])
def test_an_error_while_writing_leaves_the_file_as_it_was(folder, monkeypatch, failing):
    def full(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    store = Store(folder, IDENTITY)
    before = (folder / FILE).read_bytes()
    monkeypatch.setattr(os, failing, full)
    with pytest.raises(OSError, match=r"episodes\.jsonl: .*No space left on device"):
        store.append(chunk(4))
    assert (folder / FILE).read_bytes() == before
    assert len(store.chunks) == 2


def test_a_limit_of_the_system_on_files_fails_clearly_and_a_rerun_goes_on(folder, repository):
    pytest.importorskip("resource", reason="limits of processes are those of POSIX")
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(folder)], cwd=repository, capture_output=True,
        text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 1
    assert "failed: " in done.stderr
    assert "100 of" in done.stderr
    store = Store(folder, IDENTITY)
    assert store.notices == []
    assert len(store.records(PRINTS)) == 4
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

    def full(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space left"):
        store.save_trace("a", "s", {"time": np.arange(3.0)})
    with pytest.raises(OSError, match="No space left"):
        write_atomically(folder / "results.json", b"{}")
    monkeypatch.undo()
    assert [path.name for path in folder.rglob("*.tmp")] == []
    del store
    killed = [folder / ".results.json.4711.tmp", folder / "traces" / ".s--a.npz.1.tmp",
              folder / "videos" / ".x.2.tmp" / "new" / "episode.mp4"]  # fmt: skip
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
    with subprocess.Popen(
        [sys.executable, "-c", HOLDING, str(folder)], cwd=repository, stdout=subprocess.PIPE,
        text=True,
    ) as other:  # fmt: skip
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
