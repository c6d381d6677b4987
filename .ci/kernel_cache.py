"""A place of compiled kernels by the content of their modules, wherever these are installed."""

from hashlib import sha256
from pathlib import Path

from numba import config
from numba.core.caching import UserProvidedCacheLocator


class ByContent(UserProvidedCacheLocator):
    """Every copy of a module uses the same kernels, whatever its place and age."""

    def __init__(self, py_func, py_file):
        super().__init__(py_func, py_file)
        self.module = Path(py_file)

    def get_cache_path(self):
        """Return the folder of the kernels of a module."""
        return str(Path(config.CACHE_DIR, f"{self.module.parent.name}-{self.module.stem}"))

    def get_source_stamp(self):
        """Return the stamp by which numba judges whether a stored kernel is up to date."""
        return sha256(self.module.read_bytes()).hexdigest()
