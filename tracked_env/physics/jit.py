"""How the kernels are compiled, in one place.

All kernels: kept on disk; division follows IEEE (`error_model="numpy"`, so no hidden
branch); no fastmath, so that a batch of any size gives the same bits as one vehicle. The exception
is `summation`, for loops over the patches of one vehicle. `fastmath=False` must be written out:
what is left open is taken from the caller that is being compiled when a function is compiled first,
and stays in the disk cache, so that bits would depend on what was compiled first; `reassoc` also
deletes the rounding to integers in `exponential`.
`formula` is for the small pure functions (one equation each): they are inlined into the
loop that calls them, which lets the compiler vectorise that loop over vehicles. What a kernel calls
is compiled without an entry for Python, which costs a third of the time; a formula that is called
from Python is compiled for that as well.
`template` is for functions that take compiled functions as arguments: they become part of their
callers before anything is compiled, and are never kept on disk, where they would be keyed by
functions of another process. Large bodies belong there too: every level of compiled functions
around them is optimised as a whole, which takes a second or more each time.
`loop` is for the functions that own such a loop; they release the interpreter lock.

What is compiled is kept on disk under the digest of all source that it is made of (kernel_cache):
no edit and no update ever meets old code.
"""

from collections.abc import Callable
from functools import partial
from inspect import signature
from types import FunctionType
from typing import Any

from llvmlite import ir
from numba import njit, typeof, types
from numba.core import cgutils
from numba.extending import intrinsic

from tracked_env.physics.kernel_cache import KernelCache


def _kept(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator as `numba.njit`, with KernelCache in the place of numba's disk cache."""

    def decorated(function: Callable[..., Any]) -> Any:
        dispatcher: Any = njit(**options)(function)
        dispatcher._cache = KernelCache(dispatcher.py_func)
        return dispatcher

    return decorated


def _inlined(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of functions that are inlined into kernels; options: those of `numba.njit`."""
    options |= {"error_model": "numpy", "forceinline": True}
    compiled = partial(_kept, no_cfunc_wrapper=True, **options)

    def decorated(function: Callable[..., Any]) -> Any:
        inside: Any = FunctionType(
            function.__code__, function.__globals__, function.__name__,
            function.__defaults__, function.__closure__,
        )  # fmt: skip
        inside.__qualname__ = f"inside.{function.__qualname__}"  # its files in the cache
        inside.__module__ = function.__module__
        kernel: Any = compiled(no_cpython_wrapper=True)(inside)
        called: Any = compiled()(function)
        # what numba asks when another kernel calls this one
        called.get_call_template = kernel.get_call_template
        called.get_overload = kernel.get_overload
        return called

    return decorated


formula = _inlined(fastmath=False)
template = partial(njit, error_model="numpy", inline="always")()
loop = _kept(
    error_model="numpy", fastmath=False, nogil=True, boundscheck=False, no_cfunc_wrapper=True
)

# For loops that add up over the patches of ONE vehicle: their order of summation is the choice of
# the compiler, which lets it add several patches at once. The number of patches is the same for one
# vehicle and for many, so the bits are too. Formulas called inside keep their own rounding.
summation = _inlined(fastmath={"reassoc", "contract", "nsz"})


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
    """Ask the processor for the cache line of array[index], an entry that is read soon.

    It waits for nothing, and no result depends on it. index: a tuple of integers.
    """

    def code(context, builder, signature, arguments):
        given, place = signature.args
        found = context.make_array(given)(context, builder, arguments[0])
        at = [
            context.cast(builder, one, kind, types.intp)
            for one, kind in zip(cgutils.unpack_tuple(builder, arguments[1]), place, strict=True)
        ]
        entry = cgutils.get_item_pointer(context, builder, given, found, at, wraparound=False)
        byte, word = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, word, word, word])
        fetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        read, keep, data = (ir.Constant(word, value) for value in (0, 3, 1))
        builder.call(fetch, [builder.bitcast(entry, byte), read, keep, data])
        return context.get_dummy_value()

    return types.void(array, index), code


prefetch: Any = intrinsic(_prefetch)


def bound(kernel: Any, arguments: tuple[Any, ...]) -> Callable[..., Any]:
    """`kernel` for arguments of exactly these types, without looking the types up in each call.

    That look-up costs a twentieth of the step of one vehicle. The types are not checked any more:
    for arguments that are prepared once and kept. A kernel with `*arguments` is returned as it is.
    """
    if any(one.kind is one.VAR_POSITIONAL for one in signature(kernel.py_func).parameters.values()):
        unbound: Callable[..., Any] = kernel
        return unbound
    compiled: Callable[..., Any] = kernel.compile(tuple(typeof(value) for value in arguments))
    return compiled
