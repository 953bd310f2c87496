"""Compiled kernels on disk, each under a key that covers all the source it was made of.

Kernels inline formulas, constants, columns and templates from other files, which numba's own disk
cache does not look at: after an edit or an update it would load the old machine code. Here the
name of a file holds a digest of

    the source of the kernel's module and of all it imports, directly or not, as far as it
    belongs to this package, to the same package or to a project outside the library folders;
    the code and the constants of the functions it calls, as they are in this process, where they
    may have been reloaded or replaced;
    the types of the arguments, the processor, the versions of Python, numba and LLVM, and the
    settings of numba that change machine code.

So code of another source is never found, whatever was edited, updated or went back to a former
state, and several versions live side by side. A file is written whole or not at all (a new one
takes the place of the old one), begins with a digest of its content, and is compiled anew where it
is damaged. Source that was edited after it was imported is not what runs: nothing is stored then.

The folder: NUMBA_CACHE_DIR if it is set, or else that of the user's caches, or else `__pycache__`
beside this file. Where none can be written, kernels are compiled in each process, and a warning
says so once. Files that nobody has loaded for KEPT seconds are deleted, and the oldest of more than
LARGEST bytes.
"""

import hashlib
import os
import pickle
import re
import sys
import sysconfig
import tempfile
import time
import uuid
import warnings
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numba.core import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

KEPT = 30 * 86400.0  # [s] since a file was last loaded
TOUCHED = 86400.0  # [s] a file that was loaded longer ago is marked as loaded again
LARGEST = 2e9  # [bytes] of all files together
SUFFIX = ".kernel"
_IMPORT = re.compile(
    r"(?:^|;)[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n;]*)"
    r"|import[ \t]+([^\n;#]+))",
    re.M,
)
_LIBRARIES = tuple(
    {os.path.realpath(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")}
)
_INSTALLED = re.compile(r"[/\\](?:site|dist)-packages[/\\]")
_OWN = __name__.partition(".")[0]
_SETTINGS = ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "LOOP_VECTORIZE", "SLP_VECTORIZE")
_TOOLS = "-".join(
    (
        sys.version,
        *(f"{name} {version(name)}" for name in ("numba", "llvmlite")),
        *(f"{name} {getattr(config, name, None)}" for name in _SETTINGS),
    )
)
_COMPILERS = ("numpy", "numba", "scipy", "math", "builtins")
_CONSTANTS = (bool, int, float, complex, str, bytes, np.generic)


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


def imported_source(path: Path) -> bytes:
    """Content of a Python file when the first kernel that may use it was defined, or else now."""
    return _source(str(path)).text


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
        return path if path and path.endswith(".py") and os.path.isfile(path) else None
    for folder in getattr(package, "__path__", ()):
        base = os.path.join(folder, *rest)
        for path in (f"{base}.py", os.path.join(base, "__init__.py")):
            if os.path.isfile(path):
                return path
    return None


def _imports(text: str, module: str, is_package: bool) -> Iterator[str]:
    """Names of modules that `text` imports; of `from a import b` both `a.b` and `a`."""
    for origin, names, plain in _IMPORT.findall(text.replace("\\\n", " ")):
        if plain:
            for name in (part.split()[0] for part in plain.split(",") if part.split()):
                yield from (name, name.partition(".")[0])
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
    if path is None or module.partition(".")[0] in _COMPILERS:
        return False
    if module.partition(".")[0] in (_OWN, home):
        return True
    place = os.path.realpath(path)
    if not (place.startswith(_LIBRARIES) or _INSTALLED.search(place)):
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


@cache
def _words(code: CodeType) -> tuple[bytes, frozenset[str]]:
    """What a code object does, apart from the values of the names it looks up, and these names."""
    names, content = {*code.co_names, *code.co_freevars}, code.co_code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            inside, further = _words(each)
            content, names = content + inside, names | further
        elif not isinstance(each, frozenset):  # printed in another order by each process
            content += repr(each).encode()
    return content + repr((code.co_names, code.co_varnames)).encode(), frozenset(names)


class _ReplacedError(Exception):
    """A function has other constants, or calls others, than when it was compiled first."""


_FIRST: WeakKeyDictionary[FunctionType, Any] = WeakKeyDictionary()


def _running(function: Any, seen: set[int]) -> Iterator[bytes]:
    """Code and constants that a function and all it calls have in this process.

    A name may stand for something else than in the source: reloaded, replaced, or computed when
    its module was imported. Numba compiles a function once and goes on with the constants of then:
    raises _ReplacedError where they are others now.
    """
    function = getattr(function, "py_func", function)
    if not isinstance(function, FunctionType) or id(function) in seen:
        return
    seen.add(id(function))
    if function.__module__.partition(".")[0] in _COMPILERS:
        return
    content, names = _words(function.__code__)
    scope = function.__globals__
    values = {name: scope[name] for name in sorted(names & scope.keys())}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        values[name] = cell.cell_contents
    for value in [*values.values()]:
        if isinstance(value, ModuleType) and value.__name__ not in _COMPILERS:
            inside = vars(value)
            values |= {f"{value.__name__}.{n}": inside[n] for n in sorted(names & inside.keys())}
    parts, others = [content, repr([*values]).encode()], []
    waiting = [function.__defaults__ or (), *values.values()]
    for value in waiting:
        if isinstance(value, tuple):
            parts.append(b"%d" % len(value))
            waiting.extend(value)
        elif isinstance(value, np.ndarray):
            parts.append(f"{value.dtype} {value.shape}".encode() + value.tobytes())
        elif isinstance(value, _CONSTANTS):
            parts.append(f"{type(value).__name__} {value!r}".encode())
        else:
            others.append(value)
    own = b"\0".join(parts)
    state = own, [id(each) for each in others]
    if _FIRST.setdefault(function, state) != state:
        raise _ReplacedError
    yield own
    for each in others:
        yield from _running(each, seen)


def _folders() -> Iterator[Path]:
    chosen = getattr(config, "CACHE_DIR", "")
    if chosen:
        yield Path(chosen).absolute() / _OWN
        return
    # relative where neither the environment nor the system names a home
    user = Path(AppDirs(appname=_OWN, appauthor=False).user_cache_dir)
    if user.is_absolute():
        yield user
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
    """Delete what was not loaded for KEPT seconds, the oldest beyond LARGEST bytes, and what an
    interrupted write has left.
    """
    files = []
    for file in path.glob(f"*{SUFFIX}*"):
        with suppress(OSError):  # another process was faster
            status = file.stat()
            files.append((time.time() - status.st_mtime, status.st_size, file))
    total = 0
    for age, size, file in sorted(files):
        total += size
        if age > (KEPT if file.suffix == SUFFIX else TOUCHED) or total > LARGEST:
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
            with suppress(OSError):  # a file of another user can be read, not marked
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
        types = repr(sig)
        if not self._sources or " at 0x" in types or folder() is None:
            return None  # no file, or types that mean nothing to another process
        _, *others = self._index_key(sig, codegen)
        code = self._py_func.__code__
        place = (self._py_func.__module__, self._py_func.__qualname__, code.co_firstlineno)
        digest = hashlib.sha256(self._digest + repr((place, types, others)).encode())
        try:
            for part in _running(self._py_func, set()):
                digest.update(part)
        except _ReplacedError:
            return None
        base = folder()
        name = f"{code.co_name}-{digest.hexdigest()[:32]}{SUFFIX}"
        return None if base is None else base / name
