"""A place of compiled kernels by the content of their package, wherever it is installed."""

from functools import cache
from hashlib import sha256
from pathlib import Path

from numba import config
from numba.core.caching import UserProvidedCacheLocator


class ByContent(UserProvidedCacheLocator):
    """Every copy of a package uses the same kernels, whatever its place and age."""

    def __init__(self, py_func, py_file):
        super().__init__(py_func, py_file)
        # the outermost folder of the package, which is the last without __init__.py above it
        self.root = module = Path(py_file)
        while (self.root.parent / "__init__.py").exists():
            self.root = self.root.parent
        self.name = "-".join(module.relative_to(self.root.parent).with_suffix("").parts)

    def get_cache_path(self):
        """Return the folder of the kernels of a module."""
        return str(Path(config.CACHE_DIR, self.name))

    def get_source_stamp(self):
        """Return the stamp by which numba judges whether a stored kernel is up to date."""
        return stamp_of(self.root)


@cache
def stamp_of(root):
    """Return a hash of all modules of a package, as a kernel contains the kernels that it calls.

    Microcases are data, which stand beside the package in a checkout and inside it in a wheel.
    """
    stamp = sha256()
    for module in sorted(root.rglob("*.py")) if root.is_dir() else (root,):
        if "microcases" not in module.relative_to(root).parts:
            stamp.update(module.read_bytes())
    return stamp.hexdigest()
