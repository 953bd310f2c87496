"""One training in a folder at a time, by an advisory lock of the operating system.

The lock is on the folder itself and belongs to an open file of the process: it leaves nothing
behind, and a process that is killed has given it back. Where the system has no such locks
(Windows, some network file systems) nothing is locked.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, which is made if need be, and removed again if it stays empty.

    Raises ValueError where another process holds it, and where there can be no such folder.
    """
    made: list[Path] = []
    handle = None
    try:
        try:
            made += [path for path in (folder, *folder.parents) if not path.exists()]
            folder.mkdir(parents=True, exist_ok=True)
            handle = None if fcntl is None else os.open(folder, os.O_RDONLY)
        except OSError as error:
            if isinstance(error, FileExistsError):
                raise ValueError(
                    f"--output {folder} is a file; must be a folder, or not yet there"
                ) from error
            raise ValueError(
                f"--output {folder} cannot be written ({error}). Make room or choose another folder"
            ) from error
        if handle is not None:
            _lock(handle, folder)
        yield
    finally:
        for path in made:
            with suppress(OSError):  # it has files now
                path.rmdir()
        if handle is not None:
            os.close(handle)


def _lock(handle: int, folder: Path) -> None:
    """Raises ValueError where another process holds the lock."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ValueError(
            f"{folder} is in use by a training that runs now: wait for it, or choose another "
            "--output"
        ) from error
    except OSError:
        return  # a file system without locks
