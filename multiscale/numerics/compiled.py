"""Kernels that are compiled once for all processes that share a cache."""

import os
import pickle
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, cached_property, update_wrapper
from hashlib import sha256
from pathlib import Path
from types import CodeType, ModuleType
from typing import IO, TYPE_CHECKING, Any

from multiscale.errors import MultiscaleError

if TYPE_CHECKING:
    from numba.core.caching import FunctionCache

__all__ = ["compiled", "prange", "thread_count", "threads"]

prange = range
"""``numba.prange`` in kernels, once they are compiled."""

LOOP_LAYERS = (
    "__numba_parfor_gufunc",
    "<numba.np.ufunc.wrappers._GufuncWrapper",
    "parallelgufuncwrapper",
)
"""What numba names the code around a parallel loop, which only the kernel of the loop calls."""

NEWEST_TRIED = (0, 68)
"""Newest numba, from 0.61 on, whose parallel loops are known to be right if translated once.

With a newer one kernels are right too, and take longer to compile.
"""

PRANGE_ONLY = {"prange": True} | dict.fromkeys(
    ("comprehension", "fusion", "inplace_binop", "numpy", "reduction", "setitem", "stencil"), False
)
"""What becomes a parallel loop: no array expression, which is short and within one."""

LONGEST_WAIT = 120.0  # s for the process that compiles a kernel, before it is compiled here too


def compiled(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Compile a function at its first call, or load what any process has compiled before.

    Notes
    -----
    The cache of numba has no lock: workers that start together would all compile the same kernels.
    Here the first process locks a file beside the cache of the kernel until its result is there,
    and the others load this result. Without such locks (Windows, some network disks) each process
    compiles for itself.
    """
    if function is None:
        return lambda late: compiled(late, **options)
    return _Kernel(function, options)


def thread_count() -> int:
    """Return the number of threads of parallel kernels."""
    return int(_numba().get_num_threads())


@cache
def _numba() -> Any:
    """Bring numba, with no more threads than the user leaves to OpenMP, unless numba has its own.

    ``NUMBA_NUM_THREADS`` counts before ``OMP_NUM_THREADS``, which numba itself does not read.
    """
    import numba

    left = os.environ.get("OMP_NUM_THREADS", "")
    if "NUMBA_NUM_THREADS" not in os.environ and left.isdigit():
        numba.set_num_threads(max(1, min(int(left), numba.get_num_threads())))
    if numba.version_info.short <= NEWEST_TRIED:
        _translate_loops_once()
    return numba


def _translate_loops_once() -> None:
    """Have a parallel loop optimised and translated as a part of its kernel alone.

    By itself, numba does so for each of the layers around the loop too and throws the result away:
    three quarters of the time to compile a parallel kernel. Elsewhere, as in
    ``guvectorize``, numba calls layers of the same names by themselves and translates them as ever.
    """
    from numba.core import codegen as numba_codegen
    from numba.parfors import parfor_lowering

    kind: Any = numba_codegen.JITCPUCodegen
    create, set_environment = kind.create_library, kind.set_env
    lower = parfor_lowering._lower_parfor_parallel

    def create_library(codegen: Any, name: str, **options: Any) -> Any:
        library = create(codegen, name, **options)
        if name.startswith(LOOP_LAYERS):
            library._optimize_final_module = lambda: None
            library._finalize_final_module = lambda: setattr(library, "_finalized", True)
        return library

    def set_env(codegen: Any, name: str, environment: Any) -> None:
        if codegen._engine.is_symbol_defined(name):  # it is none of a layer
            set_environment(codegen, name, environment)

    def lower_loop(*arguments: Any) -> None:
        before = kind.create_library, kind.set_env
        kind.create_library, kind.set_env = create_library, set_env
        try:
            lower(*arguments)
        finally:
            kind.create_library, kind.set_env = before

    parfor_lowering._lower_parfor_parallel = lower_loop


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Run parallel kernels on so many threads, or on as many as the process may have."""
    numba = _numba()
    before = numba.get_num_threads()
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    try:
        yield
    finally:
        numba.set_num_threads(before)


class _Kernel:
    """A kernel that brings numba with its first use, by a caller or by another kernel."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self._function, self._options = function, options

    @cached_property
    def _dispatcher(self) -> Any:
        numba, names = _numba(), self._function.__globals__
        if names.get("prange") is prange:
            names["prange"] = numba.prange
        options = {"error_model": "numpy", "no_cfunc_wrapper": True} | self._options
        if options.get("parallel"):
            options["parallel"] = PRANGE_ONLY
        dispatcher = numba.njit(**options)(self._function)
        dispatcher._cache = _LockedCache(self)
        return dispatcher

    def __call__(self, *arguments: Any) -> Any:
        return self._dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._dispatcher, name)

    def __reduce__(self) -> str:
        return self._function.__qualname__  # by its name, as functions go to other processes

    @property
    def _numba_type_(self) -> Any:
        """Type by which numba knows this global of other kernels."""
        return self._dispatcher._numba_type_


class _LockedCache:
    """The cache of a kernel, opened at its first call, locked from a miss to the saved result."""

    def __init__(self, kernel: _Kernel) -> None:
        self._kernel, self._function = kernel, kernel._function
        self._lock: IO[bytes] | None = None

    @cached_property
    def _files(self) -> "FunctionCache":
        from numba.core.caching import FunctionCache

        try:
            files = FunctionCache(self._function)
        except RuntimeError as error:
            raise MultiscaleError(
                f"the compiled kernels cannot be kept ({error}); set NUMBA_CACHE_DIR to a folder "
                f"that can be written to"
            ) from error
        content = repr(_content(self._kernel, {}, []))
        files._cache_file._source_stamp = sha256(content.encode()).digest()
        return files

    @property
    def cache_path(self) -> str:
        """Folder of the files."""
        return str(self._files.cache_path)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return a compiled kernel, or None with the lock held."""
        found = self._load(signature, target)
        if found is None and self._lock is None:
            name = f"{self._function.__qualname__}-{self._function.__code__.co_firstlineno}.lock"
            self._lock = _locked(Path(self.cache_path) / name)
            found = self._load(signature, target)
            if found is not None:
                self._unlock()
        return found

    def _load(self, signature: Any, target: Any) -> Any:
        """Load a kernel as numba does, without the tables that serve to compile.

        Numba brings them before it looks into the cache, which takes as long as numba itself. Where
        a kernel is missing its compiler brings them.
        """
        from numba.core.runtime.nrt import rtsys

        rtsys.initialize(target)
        with self._files._guard_against_spurious_io_errors():
            return self._files._load_overload(signature, target)

    def save_overload(self, signature: Any, data: Any) -> None:
        """Save a compiled kernel and give the lock back."""
        try:
            self._files.save_overload(signature, data)
        finally:
            self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def _content(value: Any, names: dict[str, Any], seen: list[_Kernel]) -> Any:
    """Return what a value contributes to compiled code, with all that it reaches."""
    if isinstance(value, _Kernel):
        if value in seen:
            return seen.index(value)
        seen.append(value)
        function = value._function
        options = [(name, _content(value._options[name], names, seen)) for name in value._options]
        own = (function.__qualname__, options, function.__defaults__)
        return own, _content(function.__code__, function.__globals__, seen)
    if isinstance(value, CodeType):
        constants = [_content(each, names, seen) for each in value.co_consts]
        known = [(n, _content(names[n], names, seen)) for n in value.co_names if n in names]
        return value.co_code, value.co_varnames, constants, known
    if isinstance(value, ModuleType | type):  # such as numpy and prange
        return None
    if isinstance(value, set | frozenset):  # in an order that another process has too
        return sorted(map(repr, value))
    return pickle.dumps(value)


def _locked(path: Path) -> IO[bytes] | None:
    """Open a file and lock it until it is closed; None if it cannot be locked."""
    with suppress(ImportError, OSError):  # without locks or a writable folder
        import fcntl

        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("wb")
        limit = time.monotonic() + LONGEST_WAIT
        while time.monotonic() < limit:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(0.02)
            else:
                return file
        file.close()
    return None
