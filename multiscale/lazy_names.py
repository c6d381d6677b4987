"""Names that a package offers, each imported with its module when it is first used."""

import ast
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = ["lazy_names"]


def lazy_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package, from its ``__name__`` and ``__file__``.

    The names stand in the stub ``__init__.pyi`` beside the file, as imports that type checkers read
    too. No name may be the name of a module of the package, whose import would hide it, unless it
    is meant and imported from the package itself.
    """

    @cache
    def modules() -> dict[str, str]:
        stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
        imports = (node for node in stub.body if isinstance(node, ast.ImportFrom))
        return {each.name: str(node.module) for node in imports for each in node.names}

    def names() -> list[str]:
        return sorted(modules())

    def find(name: str) -> Any:
        if name == "__all__":
            return names()
        if name not in modules():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = modules()[name]
        inside = module == package  # a package of the package
        value = (
            import_module(f"{module}.{name}") if inside else getattr(import_module(module), name)
        )
        setattr(sys.modules[package], name, value)
        return value

    return find, names
