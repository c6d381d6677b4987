"""A cache of kernels by the content of their modules, wherever these are installed."""

from hashlib import sha256
from pathlib import Path

from numba.core import config
from numba.core.caching import UserProvidedCacheLocator


class ByContent(UserProvidedCacheLocator):
    """Kernels of a module are found again by every copy of it, whatever its place and age."""

    def __init__(self, py_func, py_file):
        super().__init__(py_func, py_file)
        source = Path(py_file)
        self._stamp = sha256(source.read_bytes()).hexdigest()
        self._cache_path = str(Path(config.CACHE_DIR, f"{source.parent.name}-{source.stem}"))

    def get_source_stamp(self):
        """Return what numba compares with the stamp of a stored kernel."""
        return self._stamp
