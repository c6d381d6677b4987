"""Kernels that are compiled once for all processes that share a cache."""

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numba
from numba.core.caching import FunctionCache

__all__ = ["compiled"]

LONGEST_WAIT = 120.0  # s for the process that compiles a kernel, before it is compiled here too


def compiled(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Compile a function at its first call, or load what any process has compiled before.

    Parameters
    ----------
    function : callable
        The kernel. Divisions follow IEEE arithmetic, as those of NumPy.
    **options
        Of ``numba.njit``, such as ``parallel`` and ``fastmath``.

    Notes
    -----
    The cache of numba has no lock: workers that start together would all compile the same kernels.
    Here the first process locks a file beside the cache of the kernel until its result is there,
    and the others load this result. Without such locks (Windows, some network disks) each process
    compiles for itself.
    """
    if function is None:
        return lambda late: compiled(late, **options)
    dispatcher = numba.njit(error_model="numpy", cache=True, **options)(function)
    dispatcher._cache = _LockedCache(function)
    return dispatcher


class _LockedCache(FunctionCache):
    """The cache of a kernel, locked from a miss until the result is saved."""

    _lock: IO[bytes] | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = super().load_overload(sig, target_context)
        if found is None and self._lock is None and self._enabled:
            self._lock = _locked(Path(self.cache_path) / f"{self._impl.filename_base}.lock")
            found = super().load_overload(sig, target_context)
            if found is not None:
                self._unlock()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        finally:
            self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def _locked(path: Path) -> IO[bytes] | None:
    """Open a file and lock it until it is closed; None if it cannot be locked."""
    with suppress(ImportError, OSError):
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
