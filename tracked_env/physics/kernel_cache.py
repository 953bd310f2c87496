"""Compiled kernels on disk, each under a key that covers all the code it was made of.

Kernels inline formulas, constants and templates from other files, which numba's own disk cache
does not look at: after an edit or an update it would load the old machine code. Here the name of a
file holds a digest of

    code, options and constants of the kernel and of every function that it calls, directly or not,
    as they are in this process, where they may have been reloaded or replaced: numbers, arrays,
    named tuples, intrinsics. Docstrings, comments and places in a file have no part in it;
    the types of the arguments, the processor, the versions of Python, numba and LLVM, the settings
    of numba that change machine code, and the source of this file and of `jit`.

Several processes that need the same kernel compile it once: whoever comes second waits for the file
of the first (`claim`). Where the system has no locks of parts of a file, each compiles it.

So code of another source is never found, and several versions live side by side. A kernel that
refers to an object of another kind is compiled in each process. A file is written whole or not at
all, begins with a digest of its content, and is compiled anew where it is damaged.

The folder: NUMBA_CACHE_DIR if it is set, or else that of the user's caches, or else `__pycache__`
beside this file. Where none can be written, kernels are compiled in each process, and a warning
says so once. Files that nobody has loaded for LONGEST_UNUSED seconds are deleted, and the oldest of
more than LARGEST bytes.
"""

import hashlib
import os
import pickle
import sys
import tempfile
import time
import uuid
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from multiprocessing import parent_process
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numba.core import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

LONGEST_UNUSED = 30 * 86400.0  # [s] since a file was last loaded
TOUCHED = 86400.0  # [s] a file that was loaded longer ago is marked as loaded again
LARGEST = 2e9  # [bytes] of all files together
SUFFIX = ".kernel"
LONGEST_WAIT = 120.0  # [s] for a kernel that another process compiles
_INTERVAL = 0.02  # [s]
_CLAIMS: set[Path] = set()  # kernels that this process compiles for all
_PACKAGE = __name__.partition(".")[0]
_SETTINGS = ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "LOOP_VECTORIZE", "SLP_VECTORIZE")
_FOLDER = Path(__file__).parent
_TOOLS = [
    sys.version,
    *(f"{name} {version(name)}" for name in ("numba", "llvmlite")),
    *(f"{name} {getattr(config, name, None)}" for name in _SETTINGS),
    *((_FOLDER / name).read_text() for name in ("jit.py", "kernel_cache.py")),
]
_COMPILERS = ("numpy", "numba", "llvmlite", "scipy", "math", "builtins")
_CONSTANTS = (bool, int, float, complex, str, bytes, np.generic, np.dtype, type(None))
_SOURCES: dict[str, bytes] = {}  # files with kernels, as they were when those were defined


def imported_source(path: Path) -> bytes:
    """Content of a Python file when the first kernel in it was defined, or else now."""
    return _SOURCES.get(str(path)) or path.read_bytes()


class _UncoveredError(Exception):
    """A function has other constants, or calls others, than when it was compiled first, or refers
    to an object of an unknown kind: no key covers it."""


def _is_compilers(value: Any) -> bool:
    """Whether a value is a part of numpy, numba or another package that the versions cover."""
    name = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
    return (name or type(value).__module__).partition(".")[0] in _COMPILERS


def _function_of(value: Any) -> FunctionType | None:
    """The Python function of a dispatcher or an intrinsic; the value, if it is one itself."""
    function = getattr(value, "py_func", getattr(value, "_defn", value))
    return function if isinstance(function, FunctionType) else None


@cache
def _words(code: CodeType, documentation: str | None) -> tuple[bytes, frozenset[str]]:
    """What a code object does, apart from the values of the names it looks up, and these names."""
    names, content = {*code.co_names, *code.co_freevars}, code.co_code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            inside, more = _words(each, None)
            content, names = content + inside, names | more
        elif each != documentation or each is None:
            constant = sorted(each, key=repr) if isinstance(each, frozenset) else each
            content += f"\0{constant!r}".encode()  # apart: 1 and 23 are not 12 and 3
    return content + repr((code.co_names, code.co_varnames)).encode(), frozenset(names)


def _values(function: FunctionType, names: frozenset[str]) -> dict[str, Any]:
    """What the names that a function looks up stand for: in its module and in those it names."""
    scope = function.__globals__
    values = {name: scope[name] for name in sorted(names & scope.keys())}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        values[name] = cell.cell_contents
    modules = {name: value for name, value in values.items() if isinstance(value, ModuleType)}
    while modules:
        path, module = modules.popitem()
        if not _is_compilers(module):
            inside = {f"{path}.{n}": vars(module)[n] for n in sorted(names & vars(module).keys())}
            more = {n: v for n, v in inside.items() if isinstance(v, ModuleType)}
            modules |= {n: v for n, v in more.items() if v is not module and n not in values}
            values |= inside
    return values


def _content(value: Any, called: list[Any]) -> bytes:
    """What a value is that a function refers to; called: gets the functions in it."""
    if isinstance(value, _CONSTANTS):
        return f"{type(value).__name__} {value!r}".encode()
    if isinstance(value, (tuple, list)):
        return b"%d" % len(value) + b",".join(_content(each, called) for each in value)
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape}".encode() + value.tobytes()
    if isinstance(value, type):
        return f"{value.__qualname__} {getattr(value, '_fields', '')}".encode()
    if _function_of(value) is not None and not _is_compilers(_function_of(value)):
        called.append(value)
        return b"function"
    if isinstance(value, ModuleType):
        return b"module"
    if _is_compilers(value) and " at 0x" not in str(value):
        return str(value).encode()
    raise _UncoveredError(repr(value))


_FIRST: WeakKeyDictionary[FunctionType, Any] = WeakKeyDictionary()


def _code(value: Any, visited: set[int]) -> Iterator[bytes]:
    """Code, options and constants that a function and all it calls have in this process.

    Numba compiles a function once and goes on with the constants of then: raises _UncoveredError
    where they are others now.
    """
    function = _function_of(value)
    if function is None or id(function) in visited:
        return
    visited.add(id(function))
    content, names = _words(function.__code__, function.__doc__)
    options = getattr(value, "targetoptions", {})
    called: list[Any] = []
    parts = [content]
    parts += (f"{k} {sorted(v) if isinstance(v, set) else v}".encode() for k, v in options.items())
    for name, each in _values(function, names).items():
        parts += name.encode(), _content(each, called)
    parts.append(_content(function.__defaults__ or (), called))
    content_here = b"\0".join(parts)
    state = content_here, [id(each) for each in called]
    if _FIRST.setdefault(function, state) != state:
        raise _UncoveredError(function.__qualname__)
    yield content_here
    for each in called:
        yield from _code(each, visited)


def _folders() -> Iterator[Path]:
    if chosen := getattr(config, "CACHE_DIR", ""):
        yield Path(chosen).absolute() / _PACKAGE
        return
    # relative where neither the environment nor the system names a home
    user = Path(AppDirs(appname=_PACKAGE, appauthor=False).user_cache_dir)
    if user.is_absolute():
        yield user
    yield _FOLDER / "__pycache__"


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
        else:
            _sweep(path)
            return path
    _warn("; ".join(reasons))
    return None


def _sweep(path: Path) -> None:
    """Delete what is old, the oldest beyond LARGEST bytes, and the rest of interrupted writes."""
    files = []
    for file in path.glob(f"*{SUFFIX}*"):
        with suppress(OSError):  # another process was faster
            status = file.stat()
            files.append((time.time() - status.st_mtime, status.st_size, file))
    total = 0
    for age, size, file in sorted(files):
        total += size
        if age > (LONGEST_UNUSED if file.suffix == SUFFIX else TOUCHED) or total > LARGEST:
            with suppress(OSError):  # likewise, or the file is not ours
                file.unlink()


@cache  # each reason once
def _warn(reason: str) -> None:
    warnings.warn(
        f"compiled kernels cannot be kept on disk ({reason}): every process compiles them, which "
        "takes up to a minute. Set NUMBA_CACHE_DIR to a folder that can be written and has space",
        RuntimeWarning,
        stacklevel=2,
    )


@cache  # once
def _announce() -> None:
    """Say on a terminal why the first call takes long; workers leave it to their parent."""
    if sys.stderr is not None and sys.stderr.isatty() and parent_process() is None:
        text = "tracked_env: compiling kernels, once after an installation: about a minute ..."
        print(text, file=sys.stderr, flush=True)


@cache
def _locks(folder: Path) -> Callable[[Path, bool], bool]:
    """lock(path, on): whether no other process has the byte of a kernel in the file of locks."""
    try:
        import fcntl  # not on Windows

        file = os.open(folder / "locks", os.O_RDWR | os.O_CREAT, 0o666)
    except (ImportError, OSError):
        return lambda path, on: True

    def lock(path: Path, on: bool) -> bool:
        byte = int.from_bytes(blake2b(path.name.encode(), digest_size=4).digest()) >> 1
        with suppress(OSError):  # file systems without locks
            try:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB if on else fcntl.LOCK_UN, 1, byte)
            except (BlockingIOError, PermissionError):
                return False
        return True

    return lock


def claim(path: Path) -> None:
    """Let this process alone compile the kernel of a file, once no other one does.

    Does not wait longer than LONGEST_WAIT seconds. A process that ends frees what it claims.
    """
    lock, began = _locks(path.parent), time.monotonic()
    while not lock(path, True) and time.monotonic() - began < LONGEST_WAIT:
        time.sleep(_INTERVAL)
    _CLAIMS.add(path)


def release(*paths: Path) -> None:
    """End the claims of kernels, of all where none is named."""
    for path in paths or tuple(_CLAIMS):
        _CLAIMS.discard(path)
        _locks(path.parent)(path, False)


class KernelCache(FunctionCache):
    """Keeps what is compiled of one dispatcher; stands in the place of numba's own cache.

    loading: of a target, what numba needs of it to load what was kept.
    """

    def __init__(self, dispatcher: Any, loading: Callable[[Any], Any]) -> None:
        self._dispatcher, self._py_func, self._loading = dispatcher, dispatcher.py_func, loading
        self._name, self._enabled = repr(self._py_func), True
        file = self._py_func.__code__.co_filename
        if file not in _SOURCES and os.path.isfile(file):
            _SOURCES[file] = Path(file).read_bytes()

    @property
    def cache_path(self) -> str | None:
        """Folder, as a string; None where nothing is kept."""
        return None if folder() is None else str(folder())

    def flush(self) -> None:
        """Nothing: files of other source are never loaded."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was compiled for the types `sig`, or None."""
        path = self._path(sig, target_context.codegen())
        if path is None:
            return None
        kernel = self._load(path, target_context)
        if kernel is None:
            claim(path)
            kernel = self._load(path, target_context)  # of another process, meanwhile
            if kernel is None:
                _announce()
            else:
                release(path)
        return kernel

    def _load(self, path: Path, target_context: Any) -> Any:
        try:
            content = path.read_bytes()
            if hashlib.sha256(content[32:]).digest() != content[:32]:
                return None
            target_context.refresh()
            payload = pickle.loads(content[32:])
            with suppress(OSError):  # a file of another user can be read, not marked
                if time.time() - path.stat().st_mtime > TOUCHED:
                    os.utime(path)
            kernel = CompileResultCacheImpl.rebuild(self, self._loading(target_context), payload)  # type: ignore[arg-type]
            return kernel._replace(target_context=target_context)
        except Exception:  # not there, damaged, or of a module that is gone: compiled anew
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled."""
        path = self._path(sig, data.codegen)
        if path is None:
            return
        try:
            if not data.library.has_dynamic_globals and all(f.can_cache for f in data.lifted):
                self._save(path, data)
        finally:
            release(path)

    def _save(self, path: Path, data: Any) -> None:
        content = dumps(CompileResultCacheImpl.reduce(self, data))  # type: ignore[arg-type]
        part = path.with_name(f"{path.name}.{uuid.uuid4().hex}")  # containers share numbers, too
        try:
            path.parent.mkdir(parents=True, exist_ok=True)  # deleted meanwhile
            part.write_bytes(hashlib.sha256(content).digest() + content)
            os.replace(part, path)
        except OSError as error:
            with suppress(OSError):
                part.unlink()
            _warn(str(error))

    def _path(self, sig: Any, codegen: Any) -> Path | None:
        types, base = repr(sig), folder() if self._enabled else None
        if base is None or " at 0x" in types:  # types that mean nothing to another process
            return None
        name = self._py_func.__qualname__
        place = self._py_func.__module__, name, types, codegen.magic_tuple(), _TOOLS
        digest = hashlib.sha256(repr(place).encode())
        try:
            for part in _code(self._dispatcher, set()):
                digest.update(part)
        except _UncoveredError:
            return None
        return base / f"{name.rpartition('.')[2]}-{digest.hexdigest()[:32]}{SUFFIX}"
