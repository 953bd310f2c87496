"""How numba compiles kernels here, and less of it for functions that only become parts of others.

A formula is inlined into the loops that call it, and these are optimised as a whole. Optimising
the formula alone and giving it machine code that never runs is a fifth of the time of a first call;
collecting garbage while nearly everything is kept is a tenth.

Several processes that need the same kernel compile it once: whoever comes second waits for the file
of the first (`claim`). Where the system has no locks of parts of a file, each compiles it.
"""

import gc
import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import blake2b
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

_ENVIRONMENT = "_ZN08NumbaEnv"  # begin of the names of the variables that hold an environment
_KIND = "intermediate"
LONGEST_WAIT = 120.0  # [s] for a kernel that another process compiles
_INTERVAL = 0.02  # [s]
_CLAIMS: set[Path] = set()  # kernels that this process compiles for all


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
    """End the claims of kernels."""
    for path in paths:
        _CLAIMS.discard(path)
        _locks(path.parent)(path, False)


class KernelCompiler(Compiler):
    """Numba's compiler, without collection of garbage while it works."""

    def compile_extra(self, func: Any) -> Any:
        """Result of the compilation of a Python function."""
        enabled = gc.isenabled()
        gc.disable()
        try:
            return super().compile_extra(func)
        except BaseException:
            release(*_CLAIMS)
            raise
        finally:
            if enabled:
                gc.enable()


class FormulaLibrary(JITCodeLibrary):
    """Code in LLVM's intermediate form, to be linked into that of callers; it cannot be run."""

    def _optimize_functions(self, ll_module: Any) -> None:
        # once here what would be done in each caller, and no more
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager(opt=1)
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        module = self._shared_module or self._final_module
        # numba stores the environment of every function in a variable of the running program
        names = [each.name for each in module.global_variables]
        variables = [each for each in names if each.startswith(_ENVIRONMENT)]
        lines = [f"@{name} = common global i8* null" for name in variables]
        self._variables = binding.parse_assembly("\n".join(lines))
        self._codegen._add_module(self._variables)
        self._codegen._engine.finalize_object()
        self._finalized = True

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """What is kept on disk."""
        return self.name, _KIND, self._get_module_for_linking().as_bitcode()


class FormulaCompiler(KernelCompiler):
    """Compiler of functions that are only inlined."""

    def compile_extra(self, func: Any) -> Any:
        """Result of the compilation of a Python function."""
        self.state.library = FormulaLibrary(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        return super().compile_extra(func)


def loading(target: Any) -> Any:
    """What numba needs of a target to load what was kept, a FormulaLibrary, too."""
    codegen = target.codegen()

    def unserialize_library(state: tuple[str, str, Any]) -> Any:
        name, kind, data = state
        if kind != _KIND:
            return codegen.unserialize_library(state)
        library = FormulaLibrary(codegen, name)
        library._final_module = library._shared_module = binding.parse_bitcode(data)
        library._finalize_final_module()
        return library

    loader = SimpleNamespace(unserialize_library=unserialize_library)
    return SimpleNamespace(
        codegen=lambda: loader,
        get_executable=target.get_executable,
        typing_context=target.typing_context,
    )
