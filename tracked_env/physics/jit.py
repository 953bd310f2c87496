"""How the kernels are compiled, in one place.

All kernels: kept on disk (`kernel_cache`); division follows IEEE (`error_model="numpy"`, so no
hidden branch); no fastmath, so that a batch of any size gives the same bits as one vehicle.
What is left open, as `fastmath=False` and `forceinline=False` would be, is taken from the caller
that is being compiled when a function is compiled first, and stays in the disk cache; `reassoc`
also deletes the rounding to integers in `exponential`.
    formula    small pure functions, inlined into the loop that calls them, so that it vectorises
               over vehicles. For kernels it is compiled without machine code, once
               for all constants that it is called with; what Python calls, for that as well.
    contraction   a formula whose products and sums may be rounded as one
    template   functions that take compiled functions as arguments: they become part of their
               callers before anything is compiled, and are never kept on disk. Large bodies belong
               here too: every level of compiled functions around them is optimised as a whole.
    loop       functions that own such a loop; they release the interpreter lock
    summation  loops that add up over the patches of ONE vehicle: their order of summation is the
               choice of the compiler. The number of patches is the same for one vehicle and for
               many, so the bits are too. Formulas called inside keep their own rounding.
A formula is optimised as a part of the loops that call it. Optimising it alone and giving it
machine code that never runs is a fifth of the time of a first call; collecting garbage while nearly
everything is kept is a tenth.
With NUMBA_DISABLE_JIT=1 nothing is compiled: kernels are plain Python, where a debugger can stop.
"""

import gc
from collections.abc import Callable
from functools import partial
from importlib import import_module
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
from llvmlite import binding, ir
from numba import njit, typeof, types
from numba.core import cgutils, config
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.types import unliteral
from numba.extending import intrinsic

from tracked_env.physics.kernel_cache import KernelCache, release

COMPILED = not getattr(config, "DISABLE_JIT", 0)
if not COMPILED:
    np.seterr(all="ignore")  # integers wrap and 1 / 0 is infinite without a warning, as compiled
Decorator = Callable[[Callable[..., Any]], Any]
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
        except BaseException:
            release()
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


def _cached(**options: Any) -> Decorator:
    """Decorator as `numba.njit`, with KernelCache in the place of numba's disk cache."""

    def decorate(function: Any) -> Any:
        if not COMPILED:
            function.py_func = function
            return function
        shared: dict[str, Any] = {
            "error_model": "numpy",
            "no_cfunc_wrapper": True,
            "pipeline_class": KernelCompiler,
        }
        dispatcher: Any = njit(**shared | options)(function)
        dispatcher._cache = KernelCache(dispatcher, loading)
        return dispatcher

    return decorate


def _inlined(**options: Any) -> Decorator:
    """Decorator of functions that are inlined into kernels; options: those of `numba.njit`."""

    def decorate(function: Any) -> Any:
        called: Any = _cached(forceinline=True, **options)(function)
        if not COMPILED:
            return called
        f = function
        inside: Any = FunctionType(
            f.__code__, f.__globals__, f.__name__, f.__defaults__, f.__closure__
        )
        inside.__qualname__ = f"inside.{function.__qualname__}"  # its files in the cache
        inside.__module__ = function.__module__
        within = {"no_cpython_wrapper": True, "pipeline_class": FormulaCompiler}
        kernel: Any = _cached(forceinline=True, **options | within)(inside)
        # what numba asks when another kernel calls this one
        called.get_call_template = lambda types, names: kernel.get_call_template(
            [unliteral(each) for each in types], {n: unliteral(each) for n, each in names.items()}
        )
        called.get_overload = kernel.get_overload
        return called

    return decorate


formula = _inlined(fastmath=False)
summation = _inlined(fastmath={"reassoc", "contract", "nsz"})
template = partial(njit, error_model="numpy", inline="always")()
contraction = _inlined(fastmath={"contract"})
loop = _cached(fastmath=False, forceinline=False, nogil=True, boundscheck=False)


@formula
def copy_entries(source, target):
    """Let target (>= M,) begin with the entries of source (M,).

    Assigning one slice to another takes seconds to compile, most of it for an error message.
    """
    for k in range(source.size):
        target[k] = source[k]


@formula
def copy_table(source, target):
    """Let target (>= M, >= K) begin with the rows of source (M, K), as `copy_entries`."""
    for i in range(source.shape[0]):
        for k in range(source.shape[1]):
            target[i, k] = source[i, k]


@formula
def fill_entries(target, value):
    """Set every entry of target (M,)."""
    for k in range(target.size):
        target[k] = value


def _prefetch(typing_context, array, index):
    """Ask the processor for the cache line of array[index], an entry that is read soon."""

    def code(context, builder, signature, arguments):
        kind, kinds = signature.args
        values = context.make_array(kind)(context, builder, arguments[0])
        place = [
            context.cast(builder, one, each, types.intp)
            for one, each in zip(cgutils.unpack_tuple(builder, arguments[1]), kinds, strict=True)
        ]
        entry = cgutils.get_item_pointer(context, builder, kind, values, place, wraparound=False)
        byte, word = ir.IntType(8).as_pointer(), ir.IntType(32)
        function = ir.FunctionType(ir.VoidType(), [byte, word, word, word])
        fetch = cgutils.get_or_insert_function(builder.module, function, "llvm.prefetch.p0")
        read, stay, data = (ir.Constant(word, value) for value in (0, 3, 1))
        builder.call(fetch, [builder.bitcast(entry, byte), read, stay, data])
        return context.get_dummy_value()

    return types.void(array, index), code


prefetch: Any = intrinsic(_prefetch) if COMPILED else lambda array, index: None


def bound(kernel: Any, arguments: tuple[Any, ...]) -> Any:
    """`kernel` for arguments of exactly these types, without looking the types up in each call.

    That look-up costs a twentieth of the step of one vehicle. The types are not checked any more:
    for arguments that are prepared once and kept.
    """
    return kernel.compile(tuple(map(typeof, arguments))) if COMPILED else kernel


class BoundOnce:
    """A kernel of a module that is `bound` to the types of its first call, anew in each copy.

    All calls must have arguments of the same types and layouts. Looking up the types of arrays of
    records takes longer than many kernels run.
    """

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._entry: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """What the kernel returns."""
        if self._entry is None:
            self._entry = bound(self._kernel, arguments)
        return self._entry(*arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        function = self._kernel.py_func
        return _bound_once, (function.__module__, function.__qualname__)


def _bound_once(module: str, name: str) -> BoundOnce:
    return BoundOnce(getattr(import_module(module), name))
