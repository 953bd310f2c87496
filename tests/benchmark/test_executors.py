"""Chunks in other processes and shards: the records of the serial run, whatever happens."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.benchmark.stub_policies import MARK, Constant, entry
from tests.processes import python
from tracked_env.benchmark import BenchmarkConfig, Store, run
from tracked_env.benchmark.benchmark_config import CHUNK_MIN
from tracked_env.benchmark.executors import Shard, WorkerPool, make_executor, parse_shard
from tracked_env.benchmark.policies import policies_for
from tracked_env.benchmark.policy_interface import PolicyError
from tracked_env.benchmark.runner import chunk_size, pending
from tracked_env.cli.main import main

CONFIG = BenchmarkConfig(sets=("payload", "drift"), episodes=36, duration=1.0)


TIMING = ("predict_time", "beside")


def policies(*specs):
    """Policies as the command line finds them."""
    return policies_for("torque", specs)


def values(records):
    """Records without what depends on the time that a computer took."""
    return [{k: v for k, v in record.items() if k not in TIMING} for record in records]


def records_of(folder, entries, executor=None):
    return run(CONFIG, entries, Store(folder, CONFIG.identity()), executor=executor)


def episodes_stored(folder):
    """Every episode in the files of a folder, as often as it is there."""
    return [
        (chunk["set"], chunk["policy"], episode["episode"])
        for path in folder.rglob("episodes.jsonl")
        for chunk in map(json.loads, path.read_text().splitlines()[1:])
        for episode in chunk["episodes"]
    ]


STUBS = "stub_policies"


@pytest.fixture(autouse=True)
def stubs(monkeypatch):
    """Modules of this folder can be imported by their name, in other processes too."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))


def test_workers_give_the_records_and_traces_of_the_serial_run(tmp_path):
    entries = policies("adaptive", f"mine={STUBS}:Constant")
    assert chunk_size(CONFIG, 2, 2) < CONFIG.episodes  # the chunks differ
    serial = records_of(tmp_path / "serial", entries)
    parallel = records_of(tmp_path / "parallel", entries, WorkerPool(2))
    assert values(parallel) == values(serial)
    assert {record["beside"] for record in parallel} == {2}
    assert not any("beside" in record for record in serial)
    stores = [Store(tmp_path / name, CONFIG.identity()) for name in ("serial", "parallel")]
    for name in CONFIG.sets:
        for policy in entries:
            one, other = (store.load_trace(policy.name, name) for store in stores)
            assert set(one) == set(other)
            for key, array in one.items():
                np.testing.assert_array_equal(array, other[key])


@pytest.mark.slow
def test_figures_are_the_same_whatever_the_chunks(tmp_path):
    entries = policies(f"spin={STUBS}:Spin", "adaptive")  # one leaves the path, at various times
    config = BenchmarkConfig(sets=("nominal",), episodes=70, duration=4.0)
    traces = []
    for chunk in (70, 64, 3):
        chosen = replace(config, chunk=chunk)
        store = Store(tmp_path / str(chunk), chosen.identity())
        run(chosen, entries, store)
        traces.append([store.load_trace(entry.name, "nominal") for entry in entries])
    for other in traces[1:]:
        for one, two in zip(traces[0], other, strict=True):
            assert set(one) == set(two)
            for key, array in one.items():
                np.testing.assert_array_equal(array, two[key])
    spun = traces[0][0]
    assert spun["error"].shape[1] == 64 and spun["motion"].shape[1] == 4
    assert len(spun["motion"]) < 200  # all four have left the path before the end


@pytest.mark.slow
def test_a_killed_worker_costs_its_chunk_alone_and_it_runs_again(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv(MARK, str(tmp_path / "mark"))
    entries = policies(f"{STUBS}:Mortal", "nominal")
    parallel = records_of(tmp_path / "parallel", entries, WorkerPool(2))
    assert (tmp_path / "mark").exists(), "no worker was killed"
    assert values(parallel) == values(records_of(tmp_path / "serial", entries))
    stored = episodes_stored(tmp_path / "parallel")
    assert len(stored) == len(set(stored)) == len(parallel)
    said = capfd.readouterr().err
    assert "was lost because its process ended (signal 9); it runs again" in said
    assert "payload: " in said and "Traceback" not in said


@pytest.mark.slow
def test_a_chunk_that_is_lost_again_and_again_is_an_error_that_names_it(tmp_path):
    with pytest.raises(OSError, match=r"Deadly, episodes 0 to \d+, was lost 3 times.*memory"):
        records_of(tmp_path, policies(f"{STUBS}:Deadly"), WorkerPool(1))


def test_an_error_of_a_policy_in_a_worker_is_blamed_on_it_and_what_ran_is_kept(tmp_path):
    entries = policies("nominal", f"{STUBS}:Wrong")
    said = r"policy '.*:Wrong', set 'payload', step 2: KeyError: 'lacking' .*stub_policies.py"
    with pytest.raises(PolicyError, match=said):
        records_of(tmp_path, entries, WorkerPool(1))
    assert {policy for _, policy, _ in episodes_stored(tmp_path)} == {"nominal"}


@pytest.mark.slow
def test_a_rerun_does_only_the_chunks_that_are_missing(tmp_path):
    entries = policies("nominal", "adaptive")
    store = Store(tmp_path, CONFIG.identity())

    class Interrupted(Exception):
        pass

    def interrupt(steps, label):
        raise Interrupted

    with pytest.raises(Interrupted):
        run(CONFIG, entries, store, interrupt, WorkerPool(2))
    kept = len(episodes_stored(tmp_path))
    assert 0 < kept < 144
    records = run(CONFIG, entries, store, executor=WorkerPool(2))
    stored = episodes_stored(tmp_path)
    assert len(stored) == len(set(stored)) == len(records) == 144


def test_a_policy_that_another_process_cannot_make_is_refused_before_anything_runs(tmp_path):
    local = entry("local", lambda context: Constant())
    with pytest.raises(ValueError, match=r"'local' cannot be sent .*module:attribute"):
        records_of(tmp_path, [local], WorkerPool(1))
    assert episodes_stored(tmp_path) == []


@pytest.mark.slow
def test_a_worker_with_another_source_of_a_policy_says_so(tmp_path):
    (nominal,) = policies("nominal")
    with pytest.raises(ValueError, match="policy 'nominal' has another source on"):
        records_of(tmp_path, [nominal._replace(fingerprint="of before")], WorkerPool(1))


def test_chunks_shrink_only_where_there_are_fewer_than_three_a_worker():
    many = BenchmarkConfig(sets=("payload",), episodes=640)
    assert [chunk_size(many, 1, workers) for workers in (1, 3, 4, 7, 1000)] == [64, 64, 32, 16, 16]
    assert chunk_size(many, 20, 66) == 64
    assert chunk_size(BenchmarkConfig(episodes=100, chunk=8), 1, 1000) == 8 < CHUNK_MIN


@pytest.mark.parametrize(("duration", "sizes"), [(30.0, [64, 6]), (360.0, [11] * 6 + [4])])
def test_long_episodes_run_in_smaller_batches_so_that_memory_is_bounded(duration, sizes):
    config = BenchmarkConfig(("drift",), 70, duration=duration)
    assert [len(batch) for batch in config.batches("drift", 70, 64)] == sizes
    hour = BenchmarkConfig(("drift",), 3, duration=3600.0)
    assert [len(batch) for batch in hour.batches("drift", 3, 64)] == [1, 1, 1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--shard", "3/2"), "shard '3/2'; must be I/N with 1 <= I <= N"),
        (("--shard", "0/2"), "counted from 0? Use --array=1-N"),
        (("--shard", "1"), "must be I/N"),
        (("--workers", "0"), "workers = 0; must be at least 1"),
        (("--workers", "2", "--shard", "1/2"), "--workers and --shard are given; choose one"),
        (("--workers", "2", "--ray", "local"), "--workers and --ray are given; choose one"),
    ],
)
def test_a_wrong_place_to_run_is_one_line_before_anything_runs(
    options, message, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(["evaluate", "--policies", "nominal", *options])
    except SystemExit as error:
        status = int(error.code or 0)
    assert status == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("tracked-env evaluate: ") and message in line
    assert not list(tmp_path.iterdir())


def workers_of(process):
    """Processes that a process has started, from /proc."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == process and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


def seen_to_end(workers):
    """Wait for the end of processes, 20 s at most."""
    until = time.monotonic() + 20
    while any(Path(f"/proc/{worker}").exists() for worker in workers):
        assert time.monotonic() < until, "a worker outlives the process that asked"
        time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads the processes of the system")
def test_a_worker_in_a_long_job_ends_at_once_with_the_process_that_asked(repository, tmp_path):
    mark = tmp_path / "mark"
    paths = os.pathsep.join([str(repository), str(Path(__file__).parent)])
    code = (
        "from stub_policies import sleep; "
        "from tracked_env.benchmark.executors import WorkerPool; "
        "list(WorkerPool(1).results(sleep, 0, [300.0]))"
    )
    environment = {**os.environ, "PYTHONPATH": paths, MARK: str(mark)}
    process = subprocess.Popen([sys.executable, "-c", code], env=environment)
    until = time.monotonic() + 100
    while not mark.exists() and time.monotonic() < until:
        time.sleep(0.02)
    workers = workers_of(process.pid)
    process.kill()
    process.wait()
    assert mark.exists() and workers
    seen_to_end(workers)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads the processes of the system")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_when_the_process_that_asks_ends_its_workers_end_and_what_they_had_done_is_kept(
    how, repository, tmp_path, monkeypatch, capsys
):
    arguments = ["--sets", "payload", "drift", "--episodes", "48", "--no-figures"]
    arguments += ["--policies", "nominal", "adaptive"]
    command = [sys.executable, str(repository / "evaluate.py"), *arguments, "--workers", "2"]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    # In the background of a shell SIGINT is ignored, and children inherit that.
    usual = lambda: signal.signal(signal.SIGINT, signal.default_int_handler)  # noqa: E731
    how_to = {"cwd": tmp_path, "start_new_session": True, "preexec_fn": usual}
    process = subprocess.Popen(command, **pipes, **how_to)
    until, kept = time.monotonic() + 200, []
    while not kept and process.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
        kept = episodes_stored(tmp_path)
    workers = workers_of(process.pid)
    if how is signal.SIGINT:
        os.killpg(process.pid, how)  # Ctrl-C reaches all processes of a terminal
    else:
        process.send_signal(how)
    _, error = process.communicate(timeout=60)
    assert len(workers) >= 2
    seen_to_end(workers)
    if how is signal.SIGINT:
        assert process.returncode == 130
        lines = [line for line in error.splitlines() if line.strip() and "steps/s" not in line]
        assert lines == ["evaluate.py: interrupted; finished episodes are kept, run it again"]
    kept = episodes_stored(tmp_path)
    assert 0 < len(kept) < 192, "it ended too early or too late to show anything"
    monkeypatch.chdir(tmp_path)
    assert main(["evaluate", *arguments]) == 0
    assert f"{len(kept)} of 192 episodes are already in" in capsys.readouterr().out
    assert len(episodes_stored(tmp_path)) == 192


def test_shards_share_the_chunks_and_what_they_wrote_is_read_together(tmp_path):
    entries = policies("nominal", "adaptive", "oracle")
    serial = records_of(tmp_path / "serial", entries)
    shards = [Shard(part, 3) for part in (1, 2, 3)]
    open_together = [Store(tmp_path / "shards", CONFIG.identity(), shard) for shard in shards]
    for store in open_together:
        run(CONFIG, entries, store)
        assert {c["policy"] for c in store.chunks} == {"nominal", "adaptive", "oracle"}
    stored = episodes_stored(tmp_path / "shards")
    assert len(stored) == len(set(stored)) == len(serial)
    merged = Store(tmp_path / "shards", CONFIG.identity())
    assert list(pending(CONFIG, entries, merged)) == []
    assert values(run(CONFIG, entries, merged)) == values(serial)
    assert merged.chunks == []  # nothing was copied or done twice
    assert merged.load_trace("adaptive", "drift") is not None


def test_a_shard_that_is_lost_is_made_up_for_by_the_run_that_merges(tmp_path):
    entries = policies("nominal")
    run(CONFIG, entries, Store(tmp_path / "shards", CONFIG.identity(), Shard(1, 2)))
    torn = tmp_path / "shards" / "shard-1-of-2" / "episodes.jsonl"
    torn.write_bytes(torn.read_bytes()[:-20])
    store = Store(tmp_path / "shards", CONFIG.identity())
    merged = run(CONFIG, entries, store)
    assert store.notices == []
    assert values(merged) == values(records_of(tmp_path / "serial", entries))
    assert not torn.read_bytes().endswith(b"\n")  # the file of another process is left alone


def test_two_processes_of_one_shard_are_refused(tmp_path):
    store = Store(tmp_path, CONFIG.identity(), Shard(1, 2))
    code = (
        "from pathlib import Path; from tracked_env.benchmark import *; "
        "from tracked_env.benchmark.executors import Shard; "
        "c = BenchmarkConfig(sets=('payload', 'drift'), episodes=36, duration=1.0); "
        f"opened = lambda part: Store(Path({str(tmp_path)!r}), c.identity(), Shard(part, 2)); "
        "opened(2); print('the other'); opened(1)"
    )
    done = python("-c", code, status=1)
    assert done.stdout == "the other\n"
    assert "shard-1-of-2: another process writes results there" in done.stderr
    assert store.chunks == []


def test_the_parts_of_all_shards_are_everything_and_share_nothing():
    assert make_executor() is None and make_executor(shard=parse_shard("2/2")) is None
    for parts in (1, 2, 3, 7, 30):
        dealt = [job for part in range(1, parts + 1) for job in Shard(part, parts).of(range(20))]
        assert sorted(dealt) == list(range(20))


def test_shards_from_the_command_line_end_in_the_tables_of_one_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = ["evaluate", "--sets", "payload", "--episodes", "40", "--duration", "0.5"]
    command += ["--no-figures", "--policies", "nominal", "oracle"]
    for part in ("1/2", "2/2"):
        assert main([*command, "--shard", part]) == 0
        assert f"shard {part} is done" in capsys.readouterr().out
    assert not list(tmp_path.rglob("results.json"))
    assert main(command) == 0
    assert "80 of 80 episodes are already in" in capsys.readouterr().out
    (document,) = tmp_path.rglob("results.json")
    assert len(json.loads(document.read_text())["episodes"]) == 80
