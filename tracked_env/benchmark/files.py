"""Atomic writing of files, unique file names, and locks.

A file is written beside its place under a temporary name and then moved there. Files that a
killed process leaves under such a name are removed by `sweep`; call it only while the lock of the
folder is held.

The part of a chunk of episodes that is kept for the figures, in a file of arrays.

episodes                     those of the chunk that are among the first FIGURE_ERRORS of the set
time, error                  their error at FIGURE_POINTS times
change                       when the first abrupt change of each began [s], NaN without one
motion                       every channel of the first FIGURE_EPISODES, NaN after their end
believed_time, _names,       of a policy that estimates: value, standard deviation and truth
  _value, _deviation, _truth (points, parameters, episodes) of the same episodes
control_period               [s]
The files of a set are joined when they are read: what is drawn does not depend on the chunks.
"""

import hashlib
import os
import platform
import re
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.metrics import CHANNELS, Beliefs, Trace, counted_error

NAME_LENGTH = 60  # [characters] of each readable part of a file's name

_TEMPORARY = re.compile(r"\..+\.\d+\.tmp")
# Names that are different files on every file system: lower case, ASCII, single separators.
_PLAIN = re.compile(r"[a-z0-9]+([-_.@][a-z0-9]+)*")


def temporary(path: Path) -> Path:
    """Where this process writes a file until it is whole; `sweep` removes what a kill has left."""
    return path.with_name(f".{path.name}.{os.getpid()}.tmp")


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file so that it is there whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = temporary(path)
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    except BaseException:
        with suppress(OSError):
            partial.unlink()
        raise


def replace_block(path: Path, name: str, content: str) -> None:
    """Replace what stands between `<!-- name: begin -->` and `<!-- name: end -->` in a page.

    Raises ValueError where the page has no such block, or more than one; then it stays as it is.
    """
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    text = path.read_text(encoding="utf-8")
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(end) < text.index(begin):
        raise ValueError(f"{path} has no block between {begin} and {end}. Was it edited by hand?")
    before, after = text[: text.index(begin)], text[text.index(end) :]
    write_atomically(path, f"{before}{begin}\n{content}\n{after}".encode())


def sweep(folder: Path) -> None:
    """Remove temporary files and folders; no process may be writing there."""
    for path in folder.glob(".*.tmp"):
        if _TEMPORARY.fullmatch(path.name):
            with suppress(OSError):
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def file_name(*names: str) -> str:
    """A name for a file of these names, another one for any others, on every file system."""
    parts = []
    for name in names:
        if _PLAIN.fullmatch(name) and len(name) <= NAME_LENGTH:
            parts.append(name)
        else:
            readable = re.sub(r"[^A-Za-z0-9.@_-]", "_", name)[:NAME_LENGTH]
            parts.append(f"{readable}~{hashlib.sha256(name.encode()).hexdigest()[:12]}")
    return "--".join(parts)


class Lock:
    """An advisory lock of the operating system on a file, until this object or its process ends."""

    def __init__(self, descriptor: int) -> None:
        """Raises BlockingIOError if another process holds it, OSError where there are no locks."""
        self.descriptor = descriptor
        if sys.platform == "win32":
            import msvcrt

            try:
                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            except PermissionError as error:
                raise BlockingIOError(error.errno, error.strerror) from error
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def release(self) -> None:
        """Give the lock back and close the file, once."""
        descriptor, self.descriptor = self.descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def __del__(self) -> None:
        self.release()


@contextmanager
def locked(folder: Path, by: str = "another process") -> Iterator[None]:
    """Hold a lock on a folder itself, which leaves no file behind. It is made if need be, and
    removed again if it stays empty.

    by: who else could hold it, for the message. Where the system does not lock folders (Windows,
    some network file systems) nothing is locked. Raises ValueError where another process holds it,
    and where there can be no such folder.
    """
    made: list[Path] = []
    lock = None
    try:
        try:
            made += [path for path in (folder, *folder.parents) if not path.exists()]
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = -1 if sys.platform == "win32" else os.open(folder, os.O_RDONLY)
        except FileExistsError as error:
            raise ValueError(
                f"--output {folder} is a file; must be a folder, or not yet there"
            ) from error
        except OSError as error:
            raise ValueError(
                f"--output {folder} cannot be written ({error}). Make room or choose another folder"
            ) from error
        try:
            lock = None if descriptor < 0 else Lock(descriptor)
        except BlockingIOError as error:
            raise ValueError(
                f"{folder} is in use by {by} that runs now: wait for it, or choose another --output"
            ) from error
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        for path in made:
            with suppress(OSError):  # it has files now
                path.rmdir()
        if lock is not None:
            lock.release()


FIGURE_ERRORS = 64  # episodes whose error is kept
FIGURE_EPISODES = 4  # whose motion is kept in full
_BELIEVED = ("believed_value", "believed_deviation", "believed_truth")
FIGURE_POINTS = 300  # times at which error and beliefs are kept


def _thinned(steps: int) -> NDArray[np.int64]:
    """At most FIGURE_POINTS of `steps` rows, first and last among them."""
    return np.unique(np.linspace(0, steps - 1, FIGURE_POINTS).astype(np.int64))


def figure_data(
    trace: Trace, beliefs: Beliefs | None = None, episodes: Sequence[int] | None = None
) -> dict[str, NDArray[Any]]:
    """The arrays of the head of this file, from a whole chunk.

    episodes: their numbers, which rise; by default they are the first ones.
    """
    numbers = np.arange(len(trace.steps)) if episodes is None else np.array(episodes)
    numbers = numbers[numbers < FIGURE_ERRORS]
    shown = int((numbers < FIGURE_EPISODES).sum())
    error = counted_error(trace)[:, : len(numbers)]
    times = _thinned(len(error))
    steps = int(trace.steps[:shown].max(initial=0))
    few = trace.values[:steps, :shown].astype(np.float32)
    few[~trace.driven()[:steps, :shown]] = np.nan
    return {
        "episodes": numbers,
        "time": (times + 1) * trace.control_period,
        "error": error[times].astype(np.float32),
        "change": _changed(trace, len(numbers)),
        "motion": few,
        "control_period": np.array(trace.control_period),
        **({} if beliefs is None else _believed(trace, beliefs, shown)),
    }


def _changed(trace: Trace, count: int) -> NDArray[np.float64]:
    """Start [s] of the first abrupt change of the first `count` episodes."""
    first = [of[0].first if of else np.nan for of in trace.changes()[:count]]
    return np.array(first, dtype=np.float64) * trace.control_period


def joined(parts: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """The arrays of several chunks as those of one; an episode that two of them have, once."""
    if len(parts) == 1:
        return dict(parts[0])
    where: dict[int, tuple[int, int]] = {}  # episode -> part and column
    for number, part in enumerate(parts):
        for column, episode in enumerate(part["episodes"].tolist()):
            where.setdefault(episode, (number, column))
    episodes = sorted(where)
    columns = [where[episode] for episode in episodes]
    few = [where[episode] for episode in episodes if episode < FIGURE_EPISODES]
    together = {
        **parts[0],
        "episodes": np.array(episodes),
        "error": np.stack([parts[i]["error"][:, k] for i, k in columns], axis=1),
        "change": np.array([parts[i]["change"][k] for i, k in columns]),
    }
    motion = [parts[i]["motion"][:, k] for i, k in few]
    steps = max((len(each) for each in motion), default=0)
    size = steps, len(motion), parts[0]["motion"].shape[2]
    together["motion"] = np.full(size, np.nan, dtype=np.float32)
    for k, each in enumerate(motion):
        together["motion"][: len(each), k] = each
    for name in (name for name in _BELIEVED if name in parts[0]):
        kept = [parts[i][name][..., k] for i, k in few]
        together[name] = np.stack(kept, axis=-1) if kept else parts[0][name]
    return together


def _believed(trace: Trace, beliefs: Beliefs, shown: int) -> dict[str, NDArray[Any]]:
    """The beliefs of the first episodes, NaN after their end."""
    times = _thinned(trace.max_steps)
    void = (times[:, None] >= trace.steps[:shown])[:, None]
    last = len(beliefs.value) - 1  # all later times are void

    def kept(array: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.where(void, np.float32(np.nan), array[np.minimum(times, last), :, :shown])

    return {
        "believed_time": times * trace.control_period,
        "believed_names": np.array(beliefs.names),
        "believed_value": kept(beliefs.value),
        "believed_deviation": kept(beliefs.deviation),
        "believed_truth": kept(beliefs.truth),
    }


def checked_trace(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays of `figure_data`, whose shapes must agree.

    Raises ValueError for a shape, KeyError for a missing array.
    """
    shapes = {"time": 1, "error": 2, "change": 1, "motion": 3, "control_period": 0}
    if "believed_names" in arrays:
        shapes |= {"believed_time": 1, "believed_names": 1}
        shapes |= dict.fromkeys(_BELIEVED, 3)
    for name, dimensions in shapes.items():
        kind = "U" if name == "believed_names" else "f"
        if arrays[name].ndim != dimensions or arrays[name].dtype.kind != kind:
            raise ValueError(f"{name} has shape {arrays[name].shape}, type {arrays[name].dtype}")
    motion = arrays["motion"]
    sizes: list[tuple[Any, Any]] = [
        (len(arrays["time"]), len(arrays["error"])),
        (arrays["error"].shape[1], len(arrays["change"])),
        (motion.shape[2], len(CHANNELS)),
    ]
    if "believed_names" in arrays:
        size = (len(arrays["believed_time"]), len(arrays["believed_names"]), motion.shape[1])
        for part in ("value", "deviation", "truth"):
            sizes.append((arrays[f"believed_{part}"].shape, size))
    first = arrays["episodes"].min(initial=FIGURE_ERRORS) if "episodes" in arrays else 0
    if any(one != other for one, other in sizes) or (first < FIGURE_EPISODES and not motion.size):
        raise ValueError("its arrays do not fit together")
    return arrays


PACKAGES = ("tracked-env", "numpy", "scipy", "numba", "gymnasium", "stable-baselines3", "torch")


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
