"""Compiled kernels on disk, each under a key that covers all the source it was made of.

Kernels inline formulas, constants, columns and templates from other files, which numba's own disk
cache does not look at: after an edit or an update it would load the old machine code. Here the
name of a file holds a digest of

    the source of the kernel's module and of all it imports, directly or not, as far as it
    belongs to this package, to the same package or to a project outside the library folders;
    the types of the arguments, the processor, and the versions of Python, numba and LLVM.

So code of another source is never found, whatever was edited, updated or went back to a former
state, and several versions live side by side. A file is written whole or not at all (a new one
takes the place of the old one), begins with a digest of its content, and is compiled anew where it
is damaged. Source that was edited after it was imported is not what runs: nothing is stored then.

The folder: NUMBA_CACHE_DIR if it is set, or else that of the user's caches, or else `__pycache__`
beside this file. Where none can be written, kernels are compiled in each process, and a warning
says so once. Files that nobody has loaded for KEPT seconds are deleted.
"""

import hashlib
import os
import pickle
import re
import sys
import sysconfig
import tempfile
import time
import warnings
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any

from numba.core import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

KEPT = 30 * 86400.0  # [s] since a file was last loaded
TOUCHED = 86400.0  # [s] a file that was loaded longer ago is marked as loaded again
SUFFIX = ".kernel"
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([^\n]+))", re.M
)
_LIBRARIES = tuple(
    {os.path.realpath(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")}
)
_OWN = __name__.partition(".")[0]
_TOOLS = "-".join((sys.version, *(f"{name} {version(name)}" for name in ("numba", "llvmlite"))))


class _Source:
    """Content of a Python file as it was when the first kernel that may use it was defined."""

    def __init__(self, path: str) -> None:
        with open(path, "rb") as file:
            status, self.text = os.fstat(file.fileno()), file.read()
        self.path, self.mark = path, (status.st_mtime_ns, status.st_size)
        self.digest = hashlib.sha256(self.text).digest()

    def is_current(self) -> bool:
        """Whether the file is still the one that was read."""
        try:
            status = os.stat(self.path)
        except OSError:
            return False
        return (status.st_mtime_ns, status.st_size) == self.mark


_source = cache(_Source)


def _file_of(module: str) -> str | None:
    """Path of the source of a module by its name; None where it is no file.

    Only the package it is in need be imported, so that it works in the middle of an import.
    """
    top, *rest = module.split(".")
    package = sys.modules.get(top)
    if package is None:
        return None
    if not rest:
        path = getattr(package, "__file__", None)
        return path if path and path.endswith(".py") else None
    for folder in getattr(package, "__path__", ()):
        base = os.path.join(folder, *rest)
        for path in (f"{base}.py", os.path.join(base, "__init__.py")):
            if os.path.isfile(path):
                return path
    return None


def _imports(text: str, module: str, is_package: bool) -> Iterator[str]:
    """Names of modules that `text` imports; of `from a import b` both `a.b` and `a`."""
    for origin, names, plain in _IMPORT.findall(text):
        if plain:
            yield from (name.split()[0] for name in plain.split(",") if name.split())
            continue
        level = len(origin) - len(origin.lstrip("."))
        if level:  # relative
            parts = module.split(".")
            parts = parts[: len(parts) - level + is_package]
            origin = ".".join([*parts, origin.lstrip(".")]).rstrip(".")
        named = [part.split() for part in re.sub(r"#[^\n]*|[()\\]", "", names).split(",")]
        inside = [f"{origin}.{words[0]}" for words in named if words]
        yield from inside
        if any(_file_of(name) is None for name in inside):
            yield origin  # something that the package's own file defines


@cache
def _direct(module: str, home: str) -> tuple[str, ...]:
    """Modules that `module` imports and that may hold parts of a kernel of package `home`."""
    path = _file_of(module)
    if path is None:
        return ()
    text = _source(path).text.decode("utf-8", "replace")
    is_package = os.path.basename(path) == "__init__.py"
    return tuple(
        name for name in _imports(text, module, is_package) if _may_hold_kernels(name, home)
    )


@cache
def _may_hold_kernels(module: str, home: str) -> bool:
    path = _file_of(module)
    if path is None or module.partition(".")[0] in ("numpy", "numba", "scipy"):
        return False
    if module.partition(".")[0] in (_OWN, home):
        return True
    if not os.path.realpath(path).startswith(_LIBRARIES):
        return True
    return _OWN.encode() in _source(path).text  # installed, and made for this package


def sources_of(module: str) -> dict[str, _Source]:
    """The files a kernel of `module` may be made of, by the names of their modules."""
    found, waiting = dict[str, _Source](), [module]
    home = module.partition(".")[0]
    while waiting:
        name = waiting.pop()
        path = _file_of(name)
        if name not in found and path is not None:
            found[name] = _source(path)
            waiting.extend(_direct(name, home))
    return found


def digest_of(sources: dict[str, _Source]) -> bytes:
    """One digest of files, by the names of their modules and their contents."""
    digest = hashlib.sha256(_TOOLS.encode())
    for name in sorted(sources):
        digest.update(name.encode() + b"\0" + sources[name].digest)
    return digest.digest()


@cache
def _key_of(module: str) -> tuple[bytes, dict[str, _Source]]:
    sources = sources_of(module)
    return digest_of(sources), sources


def _folders() -> Iterator[Path]:
    chosen = getattr(config, "CACHE_DIR", "")
    if chosen:
        yield Path(chosen) / _OWN
        return
    yield Path(AppDirs(appname=_OWN, appauthor=False).user_cache_dir)
    yield Path(__file__).parent / "__pycache__"


@cache
def folder() -> Path | None:
    """Where compiled kernels are kept; None, with a warning, where nothing can be written.

    Old files are deleted when it is first asked.
    """
    reasons = []
    for path in _folders():
        try:
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path) as file:
                file.write(b"\0")
        except (OSError, RuntimeError) as error:
            reasons.append(f"{path}: {error}")
            continue
        _sweep(path)
        return path
    _warn("; ".join(reasons))
    return None


def _sweep(path: Path) -> None:
    """Delete what was not loaded for KEPT seconds, and what an interrupted write has left."""
    now = time.time()
    for file in path.glob(f"*{SUFFIX}*"):
        try:
            limit = KEPT if file.suffix == SUFFIX else TOUCHED
            if now - file.stat().st_mtime > limit:
                file.unlink()
        except OSError:
            continue  # another process was faster, or the file is not ours


@cache  # each reason once
def _warn(reason: str) -> None:
    warnings.warn(
        f"compiled kernels cannot be kept on disk ({reason}): every process compiles them, which "
        "takes up to a minute. Set NUMBA_CACHE_DIR to a folder that can be written and has space",
        RuntimeWarning,
        stacklevel=2,
    )


class KernelCache(FunctionCache):
    """Keeps what is compiled of one function; stands in the place of numba's own cache."""

    def __init__(self, function: FunctionType) -> None:
        self._py_func, self._name, self._enabled = function, repr(function), True
        self._digest, self._sources = _key_of(function.__module__)

    @property
    def cache_path(self) -> str | None:
        """Folder, as a string; None where nothing is kept."""
        return None if folder() is None else str(folder())

    def flush(self) -> None:
        """Nothing: files of other source are never loaded."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was compiled for the types `sig`, or None."""
        path = self._path(sig, target_context.codegen()) if self._enabled else None
        if path is None:
            return None
        try:
            content = path.read_bytes()
            if hashlib.sha256(content[32:]).digest() != content[:32]:
                return None
            target_context.refresh()
            payload = pickle.loads(content[32:])
            if time.time() - path.stat().st_mtime > TOUCHED:
                os.utime(path)
            return CompileResultCacheImpl.rebuild(self, target_context, payload)  # type: ignore[arg-type]
        except Exception:  # not there, damaged, or of a module that is gone: compiled anew
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, unless its source has changed since it was imported."""
        if data.library.has_dynamic_globals or any(not each.can_cache for each in data.lifted):
            return
        path = self._path(sig, data.codegen) if self._enabled else None
        if path is None or not all(source.is_current() for source in self._sources.values()):
            return
        content = dumps(CompileResultCacheImpl.reduce(self, data))  # type: ignore[arg-type]
        part = path.with_name(f"{path.name}.{os.getpid()}")
        try:
            part.write_bytes(hashlib.sha256(content).digest() + content)
            os.replace(part, path)
        except OSError as error:
            part.unlink(missing_ok=True)
            _warn(str(error))

    def _path(self, sig: Any, codegen: Any) -> Path | None:
        types = repr(sig)
        if not self._sources or " at 0x" in types or folder() is None:
            return None  # no file, or types that mean nothing to another process
        _, *others = self._index_key(sig, codegen)
        code = self._py_func.__code__
        place = (self._py_func.__module__, self._py_func.__qualname__, code.co_firstlineno)
        key = hashlib.sha256(self._digest + repr((place, types, others)).encode()).hexdigest()[:32]
        base = folder()
        return None if base is None else base / f"{code.co_name}-{key}{SUFFIX}"
