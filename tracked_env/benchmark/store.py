"""Where results live while a benchmark runs: one line of JSON per finished chunk of episodes.

    episodes.jsonl   line 1: header with the identity (all that changes numbers) and its hash;
                     then one line per finished chunk of one policy on one set
    traces/          the motion of some episodes of each policy and set, for the figures
A line is appended by a single write and synced, so a kill at any moment costs at most the
chunk in progress; a torn last line is cut off when the folder is opened again. Lines of a
policy whose source has changed since are skipped.
"""

import hashlib
import json
import os
import platform
import sys
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FORMAT = 1  # of the file; a change of the columns needs a new one
FILE = "episodes.jsonl"
PACKAGES = ("tracked-env", "numpy", "scipy", "numba", "gymnasium", "stable-baselines3", "torch")
Record = dict[str, Any]


def identity_hash(identity: Mapping[str, Any]) -> str:
    """Digest of a JSON-able identity."""
    text = json.dumps(identity, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def versions() -> dict[str, str]:
    """Python and the installed packages that matter."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def machine() -> dict[str, Any]:
    """Processor and system, without names of host or user."""
    return {
        "system": platform.system(),
        "architecture": platform.machine(),
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file so that it is there whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_bytes(data)
    os.replace(temporary, path)


class Store:
    """The results in one folder, for one identity."""

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        """Open or create `folder`.

        Raises ValueError when it holds results of another identity, or is damaged anywhere but
        in its last line. `notices` says what was dropped.
        """
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
        self.header: Record = self._load(header) if self.path.exists() else header
        if not self.path.exists():
            write_atomically(self.path, (json.dumps(header) + "\n").encode())

    def _load(self, expected: Record) -> Record:
        data = self.path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        lines = whole.splitlines(keepends=True)
        parsed: list[Record] = []
        for number, line in enumerate(lines, start=1):
            try:
                parsed.append(json.loads(line))
            except ValueError as error:
                if number < len(lines) or number == 1:
                    raise ValueError(
                        f"{self.path}, line {number} is damaged ({error}). Remove that line, or "
                        "the folder to start anew."
                    ) from error
                whole = whole[: -len(line)]
        if not parsed or parsed[0].get("format") != FORMAT:
            raise ValueError(f"{self.path} is not a result file of format {FORMAT}; move it away")
        header = parsed[0]
        if header["hash"] != expected["hash"]:
            raise ValueError(
                f"{self.folder} holds results of another configuration:\n"
                f"{_difference(header['identity'], expected['identity'])}\n"
                "Choose another folder, or delete this one."
            )
        if len(whole) < len(data):
            self.notices.append(f"dropped a torn last line of {self.path}; its chunk runs again")
            os.truncate(self.path, len(whole))
        self.chunks = parsed[1:]
        return header

    def append(self, chunk: Record) -> None:
        """Add a finished chunk {policy, fingerprint, set, predict_time, episodes: [...]}."""
        line = (json.dumps(chunk, allow_nan=False) + "\n").encode()
        with self.path.open("ab", buffering=0) as file:
            file.write(line)
            os.fsync(file.fileno())
        self.chunks.append(chunk)

    def records(self, fingerprints: Mapping[str, str]) -> list[Record]:
        """One record per episode of the given policies {name: fingerprint}, later ones win."""
        found: dict[tuple[str, str, int], Record] = {}
        for chunk in self.chunks:
            if fingerprints.get(chunk["policy"]) != chunk["fingerprint"]:
                continue
            for episode in chunk["episodes"]:
                key = (chunk["set"], chunk["policy"], episode["episode"])
                common = {name: chunk[name] for name in ("set", "policy", "predict_time")}
                found[key] = {**common, **episode}
        return list(found.values())

    def trace_path(self, policy: str, uncertainty_set: str) -> Path:
        """File with the motion of the first episodes of a policy on a set."""
        safe = [
            "".join(c if c.isalnum() or c in "-_." else "_" for c in name)
            for name in (uncertainty_set, policy)
        ]
        return self.folder / "traces" / f"{'--'.join(safe)}.npz"

    def save_trace(self, policy: str, uncertainty_set: str, arrays: Mapping[str, Any]) -> None:
        """Keep arrays for the figures, all or nothing."""
        path = self.trace_path(policy, uncertainty_set)
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.name}.{os.getpid()}.npz")
        np.savez(temporary, **arrays)
        os.replace(temporary, path)

    def load_trace(self, policy: str, uncertainty_set: str) -> dict[str, NDArray[Any]] | None:
        """The arrays of `save_trace`, or None when there are none."""
        path = self.trace_path(policy, uncertainty_set)
        if not path.exists():
            return None
        with np.load(path) as data:
            return dict(data)


def _difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    names: Iterable[str] = sorted({*old, *new})
    lines = [
        f"  {name}: there {old.get(name)!r}, now {new.get(name)!r}"
        for name in names
        if old.get(name) != new.get(name)
    ]
    return "\n".join(lines)
