"""Atomic writing of files, unique names, locks; digests of source files, versions, the machine.

A file is written beside its place under a temporary name and then moved there. Files that a
killed process leaves under such a name are removed by `sweep`; call it only while the lock of the
folder is held.
"""

import hashlib
import importlib.util
import os
import platform
import re
import shutil
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_TYPED = os.urandom(16)  # stands for the source of what has no file
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
    new: list[Path] = []
    lock = None
    try:
        try:
            new += [path for path in (folder, *folder.parents) if not path.exists()]
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = -1 if sys.platform == "win32" else os.open(folder, os.O_RDONLY)
        except OSError as error:
            wrong = f"cannot be written ({error}). Make room or choose another folder"
            if isinstance(error, FileExistsError):
                wrong = "is a file; must be a folder, or not yet there"
            raise ValueError(f"--output {folder} {wrong}") from error
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
        for path in new:
            with suppress(OSError):  # it has files now
                path.rmdir()
        if lock is not None:
            lock.release()


def folder_digest(
    folder: Path, without: Collection[str] = (), read: Callable[[Path], bytes] = Path.read_bytes
) -> str:
    """Digest of every Python file below a folder: path relative to it, length and content.

    without: relative paths that are left out, of files and, with a slash at the end, of folders;
    read: gives the content of a file.
    """
    digest = hashlib.sha256()
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*.py")}
    for name in sorted(files):
        if name in without or any(of.endswith("/") and name.startswith(of) for of in without):
            continue
        content = read(files[name])
        digest.update(f"{name}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()[:12]


def source_fingerprint(
    module: str, without: Collection[str] = (), read: Callable[[Path], bytes] = Path.read_bytes
) -> str:
    """Digest of the Python source of a module, and of its whole package if it is in one.

    without, read: as of `folder_digest`. A script is its file; what is typed into an interpreter or
    a notebook has another digest in each process, so that no result of it is taken for one of
    later code. Raises ModuleNotFoundError.
    """
    main = sys.modules["__main__"]
    if module == "__main__" and main.__spec__ is None:
        script = Path(getattr(main, "__file__", ""))  # <stdin> is no file
        return hashlib.sha256(read(script) if script.is_file() else _TYPED).hexdigest()[:12]
    spec = importlib.util.find_spec(module.partition(".")[0])
    if spec is None:
        raise ModuleNotFoundError(f"no module named {module!r}")
    places = spec.submodule_search_locations
    digests = [folder_digest(Path(at), without, read) for at in places or ()]
    if len(digests) == 1:
        return digests[0]
    source = Path(spec.origin) if spec.origin and not places else None
    data = read(source) if source and source.is_file() else "".join(digests).encode()
    return hashlib.sha256(data).hexdigest()[:12]


PACKAGES = ("tracked-env", "numpy", "scipy", "numba", "gymnasium", "stable-baselines3", "torch")


def versions() -> dict[str, str]:
    """Python and the installed packages that matter."""
    installed = {"python": platform.python_version()}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            installed[name] = version(name)
    return installed


def machine() -> dict[str, Any]:
    """Processor and system, without names of host or user."""
    processor = platform.processor()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
        processor = next(names, processor)
    return {
        "system": platform.system(),
        "architecture": platform.machine(),
        "processor": processor,
        "cores": len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count(),
    }
