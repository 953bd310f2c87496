"""Where results live while a benchmark runs: one line of JSON per finished chunk of episodes.

    episodes.jsonl   line 1: header with the identity (all that changes numbers) and its hash;
                     then one line per finished chunk of one policy on one set
    traces/          the motion of some episodes of each policy and set, for the figures
    .lock            locked by the process that has the folder open; the system unlocks it when
                     the process ends, however it ends
    shard-I-of-N/    the same files, of the process that runs part I of N; all are read together
A line is appended by a single write and synced, so a kill at any moment costs at most the
chunk in progress; a torn last line is cut off when the folder is opened again, and temporary files
of processes that were killed are removed. Lines of a policy whose source has changed since are
skipped.
"""

import hashlib
import io
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.executors import Shard
from tracked_env.benchmark.files import Lock, file_name, machine, sweep, versions, write_atomically
from tracked_env.benchmark.records import (
    BESIDE,
    READS_TRUTH,
    Record,
    checked_chunk,
    checked_header,
    checked_trace,
    merged,
)
from tracked_env.validation import plain_arrays

FORMAT = 4  # of the file; a change of the columns needs a new one
FILE = "episodes.jsonl"
LOCK = ".lock"
SHARDS = "shard-*-of-*"  # folders of shards


def identity_hash(identity: Mapping[str, Any]) -> str:
    """Digest of a JSON-able identity."""
    text = json.dumps(identity, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


# Locks of this process by device and file: a folder may be opened again where it is open.
_LOCKS: WeakValueDictionary[tuple[int, int], Lock] = WeakValueDictionary()


class Store:
    """The results in one folder, for one identity.

    That of a shard writes to a folder of its own inside it. All read what all have written.
    """

    def __init__(
        self, folder: Path, identity: Mapping[str, Any], shard: Shard | None = None
    ) -> None:
        """Open or create `folder`, which no other process may have open, or that of a shard in it.

        Raises ValueError when it cannot be written, is open elsewhere, holds results of another
        identity, or is damaged anywhere but in its last line. `notices` says what was dropped.
        """
        self.shard, whole = shard, folder
        if shard is not None:
            folder = whole / f"shard-{shard.part}-of-{shard.parts}"
        self.folder = folder
        self.path = folder / FILE
        self.notices: list[str] = []
        self.chunks: list[Record] = []
        header = {
            "format": FORMAT,
            "hash": identity_hash(identity),
            "identity": dict(identity),
            "versions": versions(),
            "machine": machine(),
        }
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._lock = self._locked()
            self.header: Record = header
            if self.path.exists():
                self.header, self.chunks = self._load(self.path, header)
            else:
                write_atomically(self.path, (json.dumps(header) + "\n").encode())
            self.others = [
                path.parent
                for path in (whole / FILE, *sorted(whole.glob(f"{SHARDS}/{FILE}")))
                if path.parent != folder and path.exists()
            ]
            self._of_others = [
                chunk for other in self.others for chunk in self._load(other / FILE, header)[1]
            ]
        except OSError as error:
            raise ValueError(
                f"{str(error.filename or folder)[:200]}: {error.strerror}. Results need a folder "
                "that can be written; name another one"
            ) from error

    @property
    def shards(self) -> int:
        """How many processes share the work, 1 without shards."""
        return 1 if self.shard is None else self.shard.parts

    def share(self, tasks: Iterable[Any]) -> Iterator[Any]:
        """The tasks that are this process's: all but for a shard."""
        return iter(tasks) if self.shard is None else self.shard.of(tasks)

    def _locked(self) -> Lock | None:
        """The lock of the folder; None, with a notice, where the file system has none."""
        descriptor = os.open(self.folder / LOCK, os.O_RDWR | os.O_CREAT)
        status = os.fstat(descriptor)
        key = (status.st_dev, status.st_ino)
        lock = _LOCKS.get(key)
        if lock is not None:
            os.close(descriptor)
            return lock
        try:
            lock = _LOCKS[key] = Lock(descriptor)
        except BlockingIOError as error:
            raise ValueError(
                f"{self.folder}: another process writes results there. Wait until it has ended, "
                "or name another folder"
            ) from error
        except OSError:
            self.notices.append(
                f"{self.folder} is on a file system without locks; a second process must not "
                "write there"
            )
            return None
        for place in (self.folder, *self.folder.glob("*/")):
            if not place.match(SHARDS):  # another process may be writing there
                sweep(place)
        if self.shard is not None:
            sweep(self.folder)
        return lock

    def _load(self, path: Path, expected: Record) -> tuple[Record, list[Record]]:
        """Header and chunks of a file; of our own, a torn last line is cut off."""
        data = path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        lines = whole.splitlines(keepends=True)
        parsed: list[Record] = []
        for number, line in enumerate(lines, start=1):
            try:
                value = json.loads(line)
            except (ValueError, RecursionError) as error:
                if number < len(lines) or number == 1:
                    raise _damaged(path, number, error) from error
                whole = whole[: -len(line)]
                continue
            try:
                parsed.append(checked_chunk(value) if number > 1 else _header(value))
            except ValueError as error:
                raise _damaged(path, number, error) from error
        if not parsed:
            raise _damaged(path, 1, ValueError("not a result file, it has no whole line"))
        header = parsed[0]
        if header["hash"] != expected["hash"]:
            raise ValueError(
                f"{path.parent} holds results of another configuration:\n"
                f"{_difference(header['identity'], expected['identity'])}\n"
                "Choose another folder, or delete this one."
            )
        if len(whole) < len(data) and path == self.path:
            self.notices.append(f"dropped a torn last line of {self.path}; its chunk runs again")
            os.truncate(self.path, len(whole))
        return header, parsed[1:]

    def append(self, chunk: Record, workers: int = 1) -> None:
        """Add a finished chunk {policy, fingerprint, set, predict_time, episodes: [...]}.

        workers: processes at the same time, which is kept if it is more than this one.
        Raises OSError when it cannot be written whole; then the file is what it was before.
        """
        chunk = {**chunk, BESIDE: workers} if workers > 1 else chunk
        line = (json.dumps(chunk, allow_nan=False) + "\n").encode()
        descriptor, written = -1, 0
        try:
            # No file is made here: one without a header could not be read again.
            descriptor = os.open(self.path, os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0))
            before = os.fstat(descriptor).st_size
            try:
                written = os.write(descriptor, line)
                if written < len(line):
                    raise OSError("is the disk full, or a quota or file size limit reached?")
                os.fsync(descriptor)
            except BaseException:
                with suppress(OSError):  # what is left is a torn line, cut off on opening
                    os.ftruncate(descriptor, before)
                raise
        except OSError as error:
            raise OSError(
                f"{self.path}: {written} of {len(line)} bytes written, chunk not stored: "
                f"{error.strerror or error}"
            ) from error
        finally:
            if descriptor >= 0:
                os.close(descriptor)
        self.chunks.append(chunk)

    def records(self, fingerprints: Mapping[str, str]) -> list[Record]:
        """One record per episode of the given policies {name: fingerprint}, later ones win."""
        found: dict[tuple[str, str, int], Record] = {}
        for chunk in (*self._of_others, *self.chunks):
            if fingerprints.get(chunk["policy"]) != chunk["fingerprint"]:
                continue
            for episode in chunk["episodes"]:
                key = (chunk["set"], chunk["policy"], episode["episode"])
                common = {name: chunk[name] for name in ("set", "policy", "predict_time")}
                beside = {name: chunk[name] for name in (BESIDE, READS_TRUTH) if name in chunk}
                found[key] = {**common, **beside, **episode}
        return list(found.values())

    def trace_path(self, policy: str, uncertainty_set: str, first: int = 0) -> Path:
        """File with the motion of episodes of a policy on a set, from `first` on."""
        names = (uncertainty_set, policy, *([str(first)] if first else []))
        return self.folder / "traces" / f"{file_name(*names)}.npz"

    def save_trace(
        self, policy: str, uncertainty_set: str, arrays: Mapping[str, Any], first: int = 0
    ) -> None:
        """Keep arrays for the figures, all or nothing."""
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        write_atomically(self.trace_path(policy, uncertainty_set, first), buffer.getvalue())

    def load_trace(self, policy: str, uncertainty_set: str) -> dict[str, NDArray[Any]] | None:
        """The arrays of `save_trace`, of all chunks and shards together.

        None when there are none, with a notice if one is unreadable.
        """
        name = file_name(uncertainty_set, policy)
        parts = []
        for folder in (self.folder, *self.others):
            traces = folder / "traces"
            later = (path for path in sorted(traces.glob(f"{name}--*.npz")) if _is_later(path))
            for path in (traces / f"{name}.npz", *later):
                try:
                    if path.exists():
                        parts.append(checked_trace(plain_arrays(path)))
                        whole = merged(parts)
                except Exception as error:  # zipfile and numpy raise many kinds for a damaged file
                    self.notices.append(
                        f"{path} is damaged and left out of the figures ({type(error).__name__}: "
                        f"{error})"
                    )
                    return None
        return whole if parts and whole["motion"].size else None


def _is_later(trace: Path) -> bool:
    """Whether a trace begins with a later episode, whose number ends its name."""
    return trace.stem.rpartition("--")[2].isdecimal()


def _header(value: Any) -> Record:
    """The first line. Raises ValueError for another format, and if it contradicts itself."""
    if isinstance(value, dict) and value.get("format", FORMAT) != FORMAT:
        raise ValueError(f"not a result file of format {FORMAT}, but {value['format']!r:.60}")
    header = checked_header(value)
    if identity_hash(header["identity"]) != header["hash"]:
        raise ValueError("the identity is not that of the hash")
    return header


def _damaged(path: Path, number: int, error: BaseException) -> ValueError:
    if number == 1:
        return ValueError(
            f"{path} cannot be continued: {error}. Move it away, or name another folder."
        )
    return ValueError(
        f"{path}, line {number} is damaged ({error}). Remove that line, or the folder to start "
        "anew."
    )


def _difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    names: Iterable[str] = sorted({*old, *new})
    lines = [
        f"  {name}: there {old.get(name)!r}, now {new.get(name)!r}"
        for name in names
        if old.get(name) != new.get(name)
    ]
    return "\n".join(lines)
