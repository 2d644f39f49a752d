"""The decorator of all compiled kernels: kept on disk, without the interpreter's lock.

Kernels take arrays and named tuples of arrays, allocate little, draw random numbers from counted
streams (`random_streams`) or as numpy would (`pcg64`), and raise nothing: the function that calls
them validates.

In the busiest loops, indices are unsigned (``np.uint64(i)``): for a signed one, the compiler adds
the test for negative indices, which Python counts from the end.

Numba finds the type of a plain tuple in 0.2 us and that of a named one in 2 us, at every call from
Python. A kernel that is called for each scan takes `PlainTuple` arguments and names their parts
inside (``ScanArrays(*scan)``), which costs nothing there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any, TypeVar

from numba import njit
from numba.core.cpu import CPUTargetOptions

from coopmap_env.core.kernel_cache import attach_cache

Function = TypeVar("Function", bound=Callable[..., object])

PlainTuple = tuple[Any, ...]
"""A named tuple that was made plain at the call."""


def make_plain(named: PlainTuple) -> PlainTuple:
    """A named tuple, and those in it, as plain tuples: numba finds their types faster."""
    return tuple(make_plain(part) if isinstance(part, tuple) else part for part in named)


def _options(counts_references: bool = True, error_model: str = "python") -> dict[str, Any]:
    """All options; numba takes those that are not given from the kernel that calls first.

    None has the wrapper by which C would call it.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": error_model, "no_cfunc_wrapper": True}
    if hasattr(CPUTargetOptions, "_nrt"):  # not public
        options["_nrt"] = counts_references
    return options


_COUNTING = _options()
_BORROWING = {**_options(counts_references=False), "no_cpython_wrapper": True}
_UNCHECKED = _options(error_model="numpy")
_INLINED: dict[str, Any] = {"nogil": True, "inline": "always", "no_cfunc_wrapper": True}


def kernel(function: Function) -> Function:
    """Compile a function when it is first called; to a type checker it stays what it was."""
    return _cached(njit(**_COUNTING)(function))


def borrowing_kernel(function: Function) -> Function:
    """Compile a kernel that makes no array, and whose arrays its caller keeps.

    Numba counts the references to each array that is handed on, with a locked instruction: in
    kernels that pass many arrays to small ones this is half of the time. These do not count. Only
    other kernels call them: a call from Python would keep its arrays for ever.

    So they have no wrapper by which Python would call them, which takes apart all arguments: with
    many arrays, to compile it takes as long as the rest. Where Python calls one all the same, as
    tests do, the same code is compiled as a `kernel`.
    """
    dispatcher = njit(**_BORROWING)(function)
    if not isinstance(dispatcher, FunctionType):  # as with NUMBA_DISABLE_JIT
        _leave_calls_from_python(dispatcher, function)
    return _cached(dispatcher)


def inlined_kernel(function: Function) -> Function:
    """Compile a kernel into its callers, where a call would take longer than what it does.

    In a loop of a kernel that counts references, those to its arrays are counted in each turn: let
    a borrowing kernel have the loop.
    """
    return _cached(njit(**_INLINED)(function))


def unchecked_division_kernel(function: Function) -> Function:
    """Compile a kernel in which 1 / 0 is infinite, as in numpy, instead of an error."""
    return _cached(njit(**_UNCHECKED)(function))


def _leave_calls_from_python(dispatcher: Any, function: Callable[..., object]) -> None:
    """Let a kernel that counts references answer the calls from Python.

    Numba asks `_compile_for_args` what to call when it knows no compiled form for the arguments,
    and `_insert` makes one known.
    """

    @cache
    def counting() -> Any:
        return _cached(njit(**_COUNTING)(function), "called_from_python")

    dispatcher._compile_for_args = lambda *_, **__: counting()
    dispatcher._insert = lambda *_: None


def _cached(dispatcher: Any, variant: str = "") -> Any:
    attach_cache(dispatcher, variant)
    return dispatcher
