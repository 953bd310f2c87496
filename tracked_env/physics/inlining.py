"""How numba compiles kernels here, and less of it for functions that only become parts of others.

A formula is inlined into the loops that call it, and these are optimised as a whole. Optimising
the formula alone and giving it machine code that never runs is a fifth of the time of a first call;
collecting garbage while nearly everything is kept is a tenth.
"""

import gc
from typing import Any

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

_ENVIRONMENT = "_ZN08NumbaEnv"  # begin of the names of the variables that hold an environment
_KIND = "intermediate"


class KernelCompiler(Compiler):
    """Numba's compiler, without collection of garbage while it works."""

    def compile_extra(self, func: Any) -> Any:
        """Result of the compilation of a Python function."""
        enabled = gc.isenabled()
        gc.disable()
        try:
            return super().compile_extra(func)
        finally:
            if enabled:
                gc.enable()


class FormulaLibrary(JITCodeLibrary):
    """Code in LLVM's intermediate form, to be linked into that of callers; it cannot be run."""

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

    @classmethod
    def loaded(cls, codegen: Any, name: str, bitcode: bytes) -> "FormulaLibrary":
        """The library that was kept."""
        library = cls(codegen, name)
        library._final_module = library._shared_module = binding.parse_bitcode(bitcode)
        library._finalize_final_module()
        return library


class FormulaCompiler(KernelCompiler):
    """Compiler of functions that are only inlined."""

    def compile_extra(self, func: Any) -> Any:
        """Result of the compilation of a Python function."""
        self.state.library = FormulaLibrary(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        return super().compile_extra(func)


class LoadingTarget:
    """A target of numba that can load a FormulaLibrary, too; all else is that of `target`."""

    def __init__(self, target: Any) -> None:
        self._target = target

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)

    def codegen(self) -> "LoadingTarget":
        """What makes libraries: this object, for the target's own."""
        return LoadingTarget(self._target.codegen())

    def unserialize_library(self, kept: tuple[str, str, Any]) -> Any:
        """Library of what a library was serialized to."""
        name, kind, data = kept
        if kind == _KIND:
            return FormulaLibrary.loaded(self._target, name, data)
        return self._target.unserialize_library(kept)
