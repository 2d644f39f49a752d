"""Compiled kernels on disk, named by the code that they were compiled from.

Numba's cache knows a kernel by the file that it stands in. What the kernel calls is compiled into
it, and a change there, in another file, is not noticed: a known limitation of numba. Here the name
of a file holds a hash of the kernel's code, of all functions that it calls, and of the globals that
they read. So a file is right or is not found; comments, docstrings and moved lines change nothing.

Numba chooses the folder: ``NUMBA_CACHE_DIR`` if it is set, else ``__pycache__`` beside the source,
else the user's cache folder. Where none can be written to, kernels are compiled in every process.
A file appears as a whole, and two processes that compile the same kernel write the same file. Files
of earlier code are removed when a kernel is written, so that there are as many as kernels.
"""

from __future__ import annotations

import hashlib
import inspect
import multiprocessing
import pickle
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cache, cached_property
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np

from coopmap_env.core.files import write_atomically
from coopmap_env.core.progress import log

FunctionCache: Any
_Intrinsic: Any
NullCache: Any
BaseTuple: Any
dumps: Any
try:  # these are no public names
    from numba.core.caching import FunctionCache, NullCache
    from numba.core.extending import _Intrinsic
    from numba.core.serialize import dumps
    from numba.core.types import BaseTuple
except ImportError:
    NullCache = None

Dispatcher = Any
"""A function with numba's decorator."""
COMPILING = (
    "coopmap: compiling code that is not yet on disk for this processor, once: seconds, or a "
    "minute or two if nothing is there; `coopmap warm-up` does most of it beforehand"
)
compiled_kernels: list[str] = []
"""Names of those that this process has compiled."""


def attach_cache(dispatcher: Dispatcher, variant: str = "") -> None:
    """Give a kernel its cache; with a numba that has no place for it, warn once and leave it out.

    The files of a second kernel with the code of another have its variant in their names.

    With ``NUMBA_DISABLE_JIT``, a kernel is a plain function, and there is nothing to keep.
    """
    if isinstance(dispatcher, FunctionType):
        return
    if NullCache is None or not isinstance(getattr(dispatcher, "_cache", None), NullCache):
        _warn_of_unknown_numba()
        return
    dispatcher._cache = KernelCache(dispatcher, variant)


@cache
def _warn_of_unknown_numba() -> None:
    warnings.warn(
        f"numba {numba.__version__} keeps compiled functions in a way that this version of coopmap "
        "does not know: its kernels are compiled in every process, which takes a minute; use numba "
        "0.61 to 0.68, or a newer coopmap",
        RuntimeWarning,
        stacklevel=2,
    )


@cache
def _say_that_kernels_are_compiled() -> None:
    """Print one line of progress; in workers none, as the process that started them has its own."""
    is_ray_worker = Path(sys.argv[0]).name == "default_worker.py"
    if multiprocessing.parent_process() is None and not is_ray_worker:
        log(COMPILING)


class KernelCache:
    """What numba asks for a compiled kernel; nothing is done before the first call of the kernel.

    The methods are those of `numba.core.caching._Cache`.
    """

    def __init__(self, dispatcher: Dispatcher, variant: str = "") -> None:
        self._dispatcher = dispatcher
        self._variant = variant

    @cached_property
    def _numba_cache(self) -> Any:
        """Numba's cache of the function, with our files; one that keeps nothing if there is none.

        It chooses the folder, and takes compiled functions apart and together.
        """
        function = self._dispatcher.py_func
        try:
            found = FunctionCache(function)
        except RuntimeError:  # there is no folder to write to, or no source file
            return NullCache()
        if not hasattr(found, "_cache_file"):  # its own files would not follow the callees
            _warn_of_unknown_numba()
            return NullCache()
        parts = [Path(function.__code__.co_filename).stem, function.__qualname__, self._variant]
        name = ".".join(filter(None, parts))
        found._cache_file = KernelFiles(
            Path(found.cache_path), name.replace("<", "").replace(">", ""), self._dispatcher
        )
        return found

    @property
    def cache_path(self) -> Any:
        """Folder of the files, or None."""
        return self._numba_cache.cache_path

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The kernel compiled for a signature; None if numba has to compile it now."""
        found = self._numba_cache.load_overload(signature, target_context)
        if found is None:
            _say_that_kernels_are_compiled()
        return found

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep a compiled kernel; a full disk costs the next process the time to compile it."""
        compiled_kernels.append(self._dispatcher.py_func.__qualname__)
        with suppress(OSError):
            self._numba_cache.save_overload(signature, compiled)

    def enable(self) -> None:
        """Numba's default."""
        self._numba_cache.enable()

    def disable(self) -> None:
        """Neither load nor save."""
        self._numba_cache.disable()

    def flush(self) -> None:
        """Remove all files of the kernel."""
        self._numba_cache.flush()


class KernelFiles:
    """The files of one kernel: one for each signature and processor that it was compiled for."""

    def __init__(self, folder: Path, name: str, dispatcher: Dispatcher) -> None:
        self._folder = folder
        self._name = name
        self._dispatcher = dispatcher

    @cached_property
    def _prefix(self) -> str:
        """Names of the files with the present code begin with it."""
        return f"{self._python}{fingerprint(self._dispatcher)}-"

    @property
    def _python(self) -> str:
        """Names of the files of this version of Python begin with it."""
        return f"{self._name}-{sys.implementation.cache_tag}-"

    def load(self, key: Any) -> Any:
        """What was saved with an equal key; None if there is none, or the file is damaged."""
        try:
            saved_key, compiled = pickle.loads(self._path(key).read_bytes())
        except Exception:  # unpickling a damaged file raises errors of many types
            return None
        return compiled if saved_key == key else None

    def save(self, key: Any, compiled: Any) -> None:
        """Save a compiled kernel, and remove the files of earlier code."""
        write_atomically(self._path(key), dumps((key, compiled)))
        self._remove(lambda name: not name.startswith(self._prefix))

    def flush(self) -> None:
        """Remove all files of this version of Python."""
        self._remove(lambda name: True)

    def _path(self, key: Any) -> Path:
        signature, *rest = key
        parts = [repr(rest), *_describe_types(getattr(signature, "args", signature))]
        return self._folder / f"{self._prefix}{_hash(parts)}.nbc"

    def _remove(self, is_old: Callable[[str], bool]) -> None:
        for path in self._folder.glob(f"{self._name}-*.nb[ci]"):
            # of numba's own cache, which older versions of this package used, there are both
            ours = path.name.startswith(self._python) or path.name[len(self._name) + 1].isdigit()
            if ours and is_old(path.name):
                path.unlink(missing_ok=True)


def fingerprint(function: Any) -> str:
    """Hash of all that the machine code of a kernel depends on, types of arguments apart.

    Parameters
    ----------
    function : callable
        A kernel or a plain function.

    Returns
    -------
    str
        Of the code of the function and of those that it calls, the options of their decorators, the
        constants and the fields of the named tuples that they read, numba, numpy and Python.

    Raises
    ------
    TypeError
        With the function and the name of a global whose value cannot be described.
    """
    versions = [sys.version, numba.__version__, np.__version__]
    return _hash([*versions, *_describe(function, "", set())])


def _describe_types(types: Iterable[Any]) -> Iterator[str]:
    """Text of the types of arguments: numba's own, and the fields of named tuples."""
    for each in types:
        yield str(each)
        if isinstance(each, BaseTuple):
            yield from _describe(getattr(each, "instance_class", tuple), "", set())
            yield from _describe_types(each)


def _hash(parts: list[str]) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:20]


def _describe(value: Any, name: str, seen: set[int]) -> Iterator[str]:
    """Text of a value that a kernel reads, and of what that value depends on."""
    if hasattr(value, "py_func"):
        yield repr(sorted(getattr(value, "targetoptions", {}).items()))
        value = value.py_func
    if isinstance(value, FunctionType):
        if id(value) not in seen:
            seen.add(id(value))
            text, read = _describe_function(value)
            yield text
            for name, part in read:
                yield from _describe(part, f"{value.__module__}.{value.__qualname__}: {name}", seen)
    elif isinstance(value, tuple):
        yield f"{type(value).__qualname__}{len(value)}"
        for part in value:
            yield from _describe(part, name, seen)
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype.descr}{value.shape}{value.tobytes().hex()}"
    elif isinstance(value, type):
        yield f"{value.__module__}.{value.__qualname__}{getattr(value, '_fields', '')}"
    elif isinstance(value, bool | int | float | complex | str | bytes | None | np.generic):
        yield f"{type(value).__name__} {value!r}"
    elif isinstance(value, _Intrinsic):  # it reads builders of machine code: no plain values
        yield inspect.getsource(sys.modules[value.__module__])
    elif isinstance(value, ModuleType | np.ufunc) and _is_versioned(value):
        yield value.__name__
    else:
        raise TypeError(
            f"{name} is of the type {type(value).__name__}: kernels read numbers, strings, tuples, "
            "arrays, named tuple classes, and functions by their own names (from module import f)"
        )


def _is_versioned(value: Any) -> bool:
    """Whether a value changes only with the versions in the fingerprint."""
    root = getattr(value, "__module__", value.__name__).partition(".")[0]
    return isinstance(value, np.ufunc) or root in {"numpy", "numba", *sys.stdlib_module_names}


@cache
def _describe_function(function: FunctionType) -> tuple[str, list[tuple[str, Any]]]:
    """Code of a function, and what it reads from outside: names and values."""
    own = function.__closure__ or ()
    read = list(
        zip(function.__code__.co_freevars, (cell.cell_contents for cell in own), strict=True)
    )
    names = dict.fromkeys(_names(function.__code__))
    read += [(name, function.__globals__[name]) for name in names if name in function.__globals__]
    read += [("default", value) for value in function.__defaults__ or ()]
    return _describe_code(function.__code__, function.__doc__), read


def _names(code: CodeType) -> Iterator[str]:
    """Names of globals, and of attributes: one that is also a global is described in vain."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _describe_code(code: CodeType, doc: str | None = None) -> str:
    """Text of what a code object does: without its file, lines and docstring."""
    constants = [
        _describe_code(value)
        if isinstance(value, CodeType)
        else repr(sorted(map(repr, value)))
        if isinstance(value, frozenset)
        else repr(value)
        for value in code.co_consts
        if doc is None or value != doc
    ]
    names = (code.co_names, code.co_varnames, code.co_cellvars, code.co_freevars)
    sizes = (code.co_argcount, code.co_kwonlyargcount, code.co_flags)
    return repr((code.co_code, constants, names, sizes, code.co_exceptiontable))
