"""A place of compiled kernels by the content of their modules, wherever these are installed."""

import ast
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
        self.root = self.module = Path(py_file)
        while (self.root.parent / "__init__.py").exists():
            self.root = self.root.parent
        self.name = "-".join(self.module.relative_to(self.root.parent).with_suffix("").parts)

    def get_cache_path(self):
        """Return the folder of the kernels of a module."""
        return str(Path(config.CACHE_DIR, self.name))

    def get_source_stamp(self):
        """Return the stamp by which numba judges whether a stored kernel is up to date."""
        return stamp_of(self.root, self.module)


@cache
def stamp_of(root, module):
    """Return a hash of a module and of all that it imports, as a kernel contains what it calls."""
    stamp, found, new = sha256(), set(), {module}
    while new:
        found |= new
        new = set().union(*(imported(root, each) for each in new)) - found
    for each in sorted(found):
        stamp.update(each.read_bytes())
    return stamp.hexdigest()


@cache  # modules of kernels share most of what they import
def imported(root, module):
    """Return the modules of a package that a module imports; all of a package, if it names one."""
    return frozenset(_imported(root, module))


def _imported(root, module):
    for node in ast.walk(ast.parse(module.read_bytes())):
        if isinstance(node, ast.Import | ast.ImportFrom):
            base = [node.module] if isinstance(node, ast.ImportFrom) else []
            for alias in node.names:
                names = ".".join([*base, alias.name]).split(".")
                while names[0] == root.name:
                    place = root.parent.joinpath(*names)
                    if place.with_suffix(".py").is_file():
                        yield place.with_suffix(".py")
                        break
                    if place.is_dir():
                        yield from place.rglob("*.py")
                        break
                    names.pop()
