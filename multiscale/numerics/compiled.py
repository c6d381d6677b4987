"""Kernels: functions that numba compiles at their first call."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import RLock
from typing import Any

import numba
from filelock import FileLock

_compiling = RLock()


def compiled(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Return a kernel that runs in parallel with other threads; options as of ``numba.njit``."""
    if function is None:
        return partial(compiled, **options)
    options = options | {"nogil": True, "error_model": "numpy"}
    try:
        kernel = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # there is no such folder
        return numba.njit(**options)(function)
    # numba has no lock on its cache: a single process compiles, the others wait
    name = f"{function.__module__}.{function.__qualname__}.lock"
    lock, compile_kernel = FileLock(Path(kernel.stats.cache_path, name)), kernel.compile

    def compile_once(signature: Any) -> Any:
        with _compiling, lock:
            try:
                return compile_kernel(signature)
            except (AttributeError, ImportError):  # the cache names a class that has moved
                for index in Path(kernel.stats.cache_path).glob("*.nbi"):
                    index.unlink(missing_ok=True)
                return compile_kernel(signature)

    kernel.compile = compile_once
    return kernel
