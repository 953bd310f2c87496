"""Where results live while a benchmark runs: one line of JSON per finished chunk of episodes.

    episodes.jsonl   line 1: header with the identity (all that changes numbers) and its hash;
                     then one line per finished chunk of one policy on one set
    traces/          arrays for the figures, a file per chunk
    .lock            locked by the process that has the folder open; the system unlocks it when
                     the process ends, however it ends
    shard-I-of-N/    the same files, of the process that runs part I of N; all are read together
A line is appended by a single write and synced, so a kill at any moment costs at most the
chunk in progress; a torn last line is cut off when the folder is opened again, and temporary files
of processes that were killed are removed. Lines of a policy whose source has changed since are
skipped. Lines, of which damaged or edited ones are refused when they are read:
    header   {format, hash, identity, versions, machine}
    chunk    {policy, fingerprint, set, predict_time, episodes: [record, ...]}, where other
             processes ran at the same time, how many: beside, and of a policy that is handed the
             true parameters reads_truth: true
    record   {episode, seed, digest, ended, every metric of METRICS}, and of a policy that
             estimates {identification: {parameter: {metric: number}}, nis: {filter: number}}
Numbers are finite. Metrics are >= 0, shares at most 1; None stands for what an episode lacks.
Arrays for the figures, which are one set's when they are read:
    episodes                     those of the chunk among the first FIGURE_ERRORS of the set
    time, error                  their error at FIGURE_POINTS times
    change                       when the first abrupt change of each began [s], NaN without one
    motion                       every channel of the first FIGURE_EPISODES, NaN after their end
    believed_time, _names,       of a policy that estimates: value, standard deviation and truth
      _value, _deviation, _truth (points, parameters, episodes) of the same episodes
    control_period               [s]
"""

import hashlib
import io
import json
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.executors import Shard
from tracked_env.benchmark.files import Lock, file_name, machine, sweep, versions, write_atomically
from tracked_env.benchmark.identification_metrics import ESTIMATION_METRICS, Recorder
from tracked_env.benchmark.metrics import CHANNELS, ENDINGS, METRICS, OPTIONAL, Trace, counted_error
from tracked_env.validation import plain_arrays

Record = dict[str, Any]

FORMAT = 4  # of the file; a change of the columns needs a new one
FILE = "episodes.jsonl"
LOCK = ".lock"
SHARDS = "shard-*-of-*"  # folders of shards
FIGURE_ERRORS = 64  # episodes whose error is stored
FIGURE_EPISODES = 4  # whose motion is stored in full
FIGURE_POINTS = 300  # times at which error and beliefs are stored
BESIDE = "beside"  # processes at the same time, which makes `predict_time` not comparable
READS_TRUTH = "reads_truth"  # of a policy that is handed the true parameters


class Kind(NamedTuple):
    """What the value of a field is."""

    text: str
    fits: Callable[[Any], bool]


def _number(low: float = 0.0, high: float = math.inf, optional: bool = False) -> Kind:
    """A finite number; optional: or None, for what an episode lacks."""

    def fits(value: Any) -> bool:
        if value is None or type(value) not in (int, float):
            return optional and value is None
        return low <= value <= high and abs(value) <= sys.float_info.max

    limits = f" in [0, {high:g}]" if high < math.inf else " >= 0" if low == 0.0 else ""
    return Kind(f"a finite number{limits}", fits)


COUNT = Kind("an integer >= 0", lambda value: type(value) is int and value >= 0)
TEXT = Kind("text", lambda value: isinstance(value, str))
DICT = Kind("a dict", lambda value: isinstance(value, dict))
LIST = Kind("a list", lambda value: isinstance(value, list))
Fields = Mapping[str, Kind]
HEADER = {"format": COUNT, "hash": TEXT, "identity": DICT, "versions": DICT, "machine": DICT}
CHUNK = {"policy": TEXT, "fingerprint": TEXT, "set": TEXT, "predict_time": _number()}
CHUNK |= {"episodes": LIST}
OF_CHUNK = {
    BESIDE: COUNT,
    READS_TRUTH: Kind("true or false", lambda value: isinstance(value, bool)),
}
_SHARES = ("success", "terminated", "saturation_share")
EPISODE = {"episode": COUNT, "seed": COUNT, "digest": TEXT}
EPISODE |= {"ended": Kind(f"one of {ENDINGS}", lambda value: value in ENDINGS)}
EPISODE |= {
    name: _number(high=1.0 if name in _SHARES else math.inf, optional=name in OPTIONAL)
    for name in METRICS
}
OF_EPISODE = {"identification": DICT, "nis": DICT}  # of policies that estimate
_ESTIMATE = _number(-math.inf, optional=True)
_NONE: Fields = {}


def _checked(what: str, fields: Any, needed: Fields, others: Fields = _NONE) -> Record:
    """A dict with all the needed fields, perhaps others, each of its kind. Raises ValueError."""
    if not isinstance(fields, dict):
        raise ValueError(f"{what} is {fields!r:.60}; must be a dict")
    kinds = {**needed, **others}
    if lacking := [name for name in needed if name not in fields]:
        raise ValueError(f"{what} lacks {', '.join(lacking)}")
    for name, value in fields.items():
        if name not in kinds:
            raise ValueError(f"{what} has {name!r}, which is not known")
        if not kinds[name].fits(value):
            raise ValueError(f"{name} of {what} = {value!r:.60}; must be {kinds[name].text}")
    return fields


def _checked_chunk(chunk: Any) -> Record:
    """A chunk of finished episodes. Raises ValueError."""
    for record in _checked("the chunk", chunk, CHUNK, OF_CHUNK)["episodes"]:
        what = f"episode {record.get('episode')!r:.20}" if isinstance(record, dict) else "a record"
        _checked(what, record, EPISODE, OF_EPISODE)
        for name, metrics in record.get("identification", {}).items():
            estimates = dict.fromkeys(ESTIMATION_METRICS, _ESTIMATE)
            _checked(f"{what}, estimate of {name!r:.60}", metrics, estimates)
        nis = record.get("nis", {})
        _checked(f"{what}, nis", nis, dict.fromkeys(nis, _ESTIMATE))
    return dict(chunk)


def _checked_header(header: Any) -> Record:
    """The first line. Raises ValueError for another format, and if it contradicts itself."""
    if isinstance(header, dict) and header.get("format", FORMAT) != FORMAT:
        raise ValueError(f"not a result file of format {FORMAT}, but {header['format']!r:.60}")
    if identity_hash(_checked("the header", header, HEADER)["identity"]) != header["hash"]:
        raise ValueError("the identity is not that of the hash")
    return dict(header)


def _thinned(steps: int) -> NDArray[np.int64]:
    """At most FIGURE_POINTS of `steps` rows, first and last among them."""
    return np.unique(np.linspace(0, steps - 1, FIGURE_POINTS).astype(np.int64))


def figure_data(
    trace: Trace, beliefs: Recorder | None = None, episodes: Sequence[int] | None = None
) -> dict[str, NDArray[Any]]:
    """The arrays of the head of this file, from a whole chunk.

    episodes: their numbers, which rise; by default they are the first ones.
    """
    numbers = np.arange(len(trace.steps)) if episodes is None else np.array(episodes)
    numbers = numbers[numbers < FIGURE_ERRORS]
    whole = int((numbers < FIGURE_EPISODES).sum())
    error = counted_error(trace)[:, : len(numbers)]
    times = _thinned(len(error))
    steps = int(trace.steps[:whole].max(initial=0))
    few = trace.values[:steps, :whole].astype(np.float32)
    few[~trace.driven()[:steps, :whole]] = np.nan
    first = [of[0].first if of else np.nan for of in trace.changes()[: len(numbers)]]
    arrays = {
        "episodes": numbers,
        "time": (times + 1) * trace.control_period,
        "error": error[times].astype(np.float32),
        "change": np.array(first, dtype=np.float64) * trace.control_period,
        "motion": few,
        "control_period": np.array(trace.control_period),
    }
    if beliefs is None:
        return arrays
    times = _thinned(trace.max_steps)
    void = (times[:, None] >= trace.steps[:whole])[:, None]
    rows = np.minimum(times, beliefs.rows - 1)  # all later times are void
    arrays |= {
        "believed_time": times * trace.control_period,
        "believed_names": np.array(beliefs.names),
    }
    for name in ("value", "deviation", "truth"):
        values = getattr(beliefs, name)[rows, :, :whole]
        arrays[f"believed_{name}"] = np.where(void, np.float32(np.nan), values)
    return arrays


# Type and axes of the arrays: t, p times, e episodes, m those with motion, s steps, c channels, n
# names.
_AXES = {"episodes": "ie", "time": "ft", "error": "fte", "change": "fe", "motion": "fsmc"}
_AXES |= {"control_period": "f"}
_OF_BELIEFS = {"believed_time": "fp", "believed_names": "Un", "believed_value": "fpnm"}
_OF_BELIEFS |= {"believed_deviation": "fpnm", "believed_truth": "fpnm"}


def _checked_trace(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays of `figure_data`. Raises ValueError for shapes that do not fit, KeyError for a
    missing array."""
    sizes = {"c": len(CHANNELS)}
    axes = _AXES | (_OF_BELIEFS if "believed_names" in arrays else {})
    for name, kind_and_axes in axes.items():
        array, kind, letters = arrays[name], kind_and_axes[0], kind_and_axes[1:]
        fits = len(letters) == array.ndim and array.dtype.kind == kind
        shape = zip(letters, array.shape, strict=False)
        if not fits or any(sizes.setdefault(letter, size) != size for letter, size in shape):
            raise ValueError(f"{name} has shape {array.shape}, type {array.dtype}")
    first = arrays["episodes"].min(initial=FIGURE_ERRORS)
    if first < FIGURE_EPISODES and not arrays["motion"].size:
        raise ValueError("it has no motion")
    return arrays


def _merged(parts: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """The arrays of several chunks as those of one; an episode that two of them have, once."""
    episodes, columns = np.unique(np.concatenate([p["episodes"] for p in parts]), return_index=True)
    few = np.concatenate([p["episodes"][p["episodes"] < FIGURE_EPISODES] for p in parts])
    orders = {"e": columns, "m": np.unique(few, return_index=True)[1]}
    steps = max(len(part["motion"]) for part in parts)
    merged = {**parts[0], "episodes": episodes}
    for name in merged.keys() - {"episodes"}:
        axes = {**_AXES, **_OF_BELIEFS}[name][1:]
        for letter in orders.keys() & {*axes}:
            arrays = [part[name] for part in parts]
            if name == "motion":  # as long as the longest one
                ends = [((0, steps - len(motion)), (0, 0), (0, 0)) for motion in arrays]
                arrays = [
                    np.pad(*of, constant_values=np.nan) for of in zip(arrays, ends, strict=True)
                ]
            axis = axes.index(letter)
            merged[name] = np.concatenate(arrays, axis).take(orders[letter], axis)
    return merged


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
        self.shard, whole = shard or Shard(1, 1), folder
        if shard is not None:
            folder = whole / f"shard-{shard.part}-of-{shard.parts}"
        self.folder, self.path = folder, folder / FILE
        self.notices: list[str] = []
        self.chunks: list[Record] = []
        self.header: Record = {
            "format": FORMAT,
            "hash": identity_hash(identity),
            "identity": dict(identity),
            "versions": versions(),
            "machine": machine(),
        }
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._lock = self._locked()
            if not self.path.exists():
                write_atomically(self.path, (json.dumps(self.header) + "\n").encode())
            self.header, *self.chunks = self._load(self.path, self.header)
            paths = (whole / FILE, *sorted(whole.glob(f"{SHARDS}/{FILE}")))
            others = [path for path in paths if path != self.path and path.exists()]
            self.others = [path.parent for path in others]
            self._of_others = [c for path in others for c in self._load(path, self.header)[1:]]
        except OSError as error:
            raise ValueError(
                f"{str(error.filename or folder)[:200]}: {error.strerror}. Results need a folder "
                "that can be written; name another one"
            ) from error

    def _locked(self) -> Lock | None:
        """The lock of the folder; None, with a notice, where the file system has none."""
        descriptor = os.open(self.folder / LOCK, os.O_RDWR | os.O_CREAT)
        status = os.fstat(descriptor)
        key = (status.st_dev, status.st_ino)
        if key in _LOCKS:
            os.close(descriptor)
            return _LOCKS[key]
        try:
            lock = _LOCKS[key] = Lock(descriptor)
        except BlockingIOError as error:
            raise ValueError(
                f"{self.folder}: another process writes results there. Wait until it has ended, "
                "or name another folder"
            ) from error
        except OSError:
            system = "is on a file system without locks; a second process must not write there"
            self.notices.append(f"{self.folder} {system}")
            return None
        for place in (self.folder, *self.folder.glob("*/")):
            if place == self.folder or not place.match(SHARDS):  # another may be writing there
                sweep(place)
        return lock

    def _load(self, path: Path, expected: Record) -> list[Record]:
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
                parsed.append(_checked_chunk(value) if number > 1 else _checked_header(value))
            except ValueError as error:
                raise _damaged(path, number, error) from error
        if not parsed:
            raise _damaged(path, 1, ValueError("not a result file, it has no whole line"))
        old, new = parsed[0]["identity"], expected["identity"]
        if parsed[0]["hash"] != expected["hash"]:
            difference = "\n".join(
                f"  {name}: there {old.get(name)!r}, now {new.get(name)!r}"
                for name in sorted({*old, *new})
                if old.get(name) != new.get(name)
            )
            raise ValueError(
                f"{path.parent} holds results of another configuration:\n{difference}\n"
                "Choose another folder, or delete this one."
            )
        if len(whole) < len(data) and path == self.path:
            self.notices.append(f"dropped a torn last line of {self.path}; its chunk runs again")
            os.truncate(self.path, len(whole))
        return parsed

    def append(self, chunk: Record, workers: int = 1) -> None:
        """Add a finished chunk {policy, fingerprint, set, predict_time, episodes: [...]}.

        workers: processes at the same time, which is kept if it is more than this one.
        Raises OSError when it cannot be written whole; then the file is what it was before.
        """
        chunk = {**chunk, BESIDE: workers} if workers > 1 else chunk
        line = (json.dumps(chunk, allow_nan=False) + "\n").encode()
        written = 0
        try:
            # No file is made here: one without a header could not be read again.
            with self.path.open("r+b", buffering=0) as file:
                before = file.seek(0, os.SEEK_END)
                try:
                    written = os.write(file.fileno(), line)
                    if written < len(line):
                        raise OSError("is the disk full, or a quota or file size limit reached?")
                    os.fsync(file.fileno())
                except BaseException:
                    with suppress(OSError):  # what is left is a torn line, cut off on opening
                        file.truncate(before)
                    raise
        except OSError as error:
            raise OSError(
                f"{self.path}: {written} of {len(line)} bytes written, chunk not stored: "
                f"{error.strerror or error}"
            ) from error
        self.chunks.append(chunk)

    def records(self, fingerprints: Mapping[str, str]) -> list[Record]:
        """One record per episode of the policies {name: fingerprint}, later ones win."""
        records: dict[tuple[str, str, int], Record] = {}
        for chunk in (*self._of_others, *self.chunks):
            if fingerprints.get(chunk["policy"]) != chunk["fingerprint"]:
                continue
            common = ("set", "policy", "predict_time", *(n for n in OF_CHUNK if n in chunk))
            for episode in chunk["episodes"]:
                key = (chunk["set"], chunk["policy"], episode["episode"])
                records[key] = {**{name: chunk[name] for name in common}, **episode}
        return list(records.values())

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
        for traces in (folder / "traces" for folder in (self.folder, *self.others)):
            numbered = sorted(traces.glob(f"{name}--*.npz"))  # the number of a later episode
            later = (path for path in numbered if path.stem.rpartition("--")[2].isdecimal())
            for path in (traces / f"{name}.npz", *later):
                try:
                    if path.exists():
                        parts.append(_checked_trace(plain_arrays(path)))
                        whole = _merged(parts)
                except Exception as error:  # zipfile and numpy raise many kinds for a damaged file
                    self.notices.append(
                        f"{path} is damaged and left out of the figures ({type(error).__name__}: "
                        f"{error})"
                    )
                    return None
        return whole if parts and whole["motion"].size else None


def _damaged(path: Path, number: int, error: BaseException) -> ValueError:
    if number == 1:
        return ValueError(
            f"{path} cannot be continued: {error}. Move it away, or name another folder."
        )
    return ValueError(
        f"{path}, line {number} is damaged ({error}). Remove that line, or the folder to start "
        "anew."
    )
